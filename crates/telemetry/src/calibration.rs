//! The calibration of a taxel as a client sees it: what it may ask, and how far the daemon has come. The daemon
//! collects, fits and writes the file; a client only shows.
//!
//! ```
//! use moca_telemetry::calibration::CalibrationProgress;
//! let progress = CalibrationProgress::Rest { taxel: 5, frames: 10, frames_wanted: 40 };
//! let CalibrationProgress::Rest { taxel, frames, frames_wanted } = progress else { unreachable!() };
//! assert_eq!(format!("T{}: nobody touch, {frames} of {frames_wanted}", taxel + 1), "T6: nobody touch, 10 of 40");
//! ```

use serde::{Deserialize, Serialize};

/// Request of a client. Only the commander's requests are taken.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum CalibrationRequest {
    /// Begin with one taxel; what was not saved is forgotten.
    Start {
        /// 0 is T1.
        taxel: u8,
        /// Presses wanted, at least 1.
        presses: u8,
    },
    /// Forget what was collected.
    Cancel,
    /// Write the fit of this model (its place in [`CalibrationFit::models`]) into the calibration file.
    Save {
        /// From 0.
        model: u8,
    },
}

/// Progress of a calibration.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub enum CalibrationProgress {
    /// The daemon cannot calibrate, and why.
    Unavailable(String),
    /// Nothing under way.
    #[default]
    Idle,
    /// Nobody may touch the cover.
    Rest {
        /// 0 is T1.
        taxel: u8,
        /// Frames at rest so far.
        frames: u32,
        /// Frames wanted.
        frames_wanted: u32,
    },
    /// Press the taxel slowly and release it.
    Press {
        /// 0 is T1.
        taxel: u8,
        /// Complete presses so far.
        presses: u32,
        /// Presses wanted.
        presses_wanted: u32,
        /// Counts below rest now.
        counts: f64,
        /// Reference force now, N; `None` before the first value.
        force_n: Option<f64>,
    },
    /// Collected and fitted, waiting to be saved.
    Fitted(CalibrationFit),
    /// Written.
    Saved {
        /// The file, on the daemon's machine.
        path: String,
        /// Taxels it holds now, 1 is T1.
        taxels: Vec<u8>,
    },
    /// It did not work, and why.
    Failed(String),
}

/// Fit of a taxel's presses.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct CalibrationFit {
    /// 0 is T1.
    pub taxel: u8,
    /// FDAT at rest, counts.
    pub rest_counts: f64,
    /// Every kind of model, cheapest first.
    pub models: Vec<FittedModel>,
}

/// Quality of one kind of model on the presses.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct FittedModel {
    /// Name shown to users.
    pub name: String,
    /// True if a cover can use it; a line with an intercept reads its intercept when untouched.
    pub usable: bool,
    /// Root mean square error, N.
    pub rmse_n: f64,
    /// Root mean square error while the force rose, N.
    pub rmse_loading_n: f64,
    /// Root mean square error while it fell, N.
    pub rmse_unloading_n: f64,
    /// Largest error, N.
    pub worst_n: f64,
    /// Valid up to this force, N.
    pub force_max_n: f64,
    /// Reference force and model minus reference, N, of some hundred samples.
    pub residuals: Vec<[f32; 2]>,
}
