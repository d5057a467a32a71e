//! Calibration of taxels: raw counts against a reference force, to a [`crate::TaxelModel`] and how good it is.
//!
//! 1. [`Trial`]: one recording of counts below rest beside a reference force.
//! 2. [`mod@fit`]: least squares for each kind of model; [`quality`]: its errors in newtons, range and cost.
//! 3. [`mod@file`]: TOML files that say for which board they hold, and refuse any other.
//! 4. [`session`]: the guided steps of a calibration, with time and bytes as arguments.
//!
//! ```
//! use moca_tactile::calibration::{ModelKind, Trial, TrialSample, fit};
//!
//! // a press and release on a taxel of 2 N for each count
//! let sample = |i: u32| {
//!     let drop = f64::from(if i < 50 { i } else { 100 - i });
//!     TrialSample { time_s: 0.02 * f64::from(i), drop, force_n: 2.0 * drop }
//! };
//! let trial = Trial { samples: (0..=100).map(sample).collect() };
//! let (_model, quality) = fit(ModelKind::LineThroughZero, &[trial])?;
//! assert!(quality.worst_n < 1e-9 && quality.samples == 101);
//! # Ok::<(), moca_tactile::calibration::FitError>(())
//! ```

pub mod file;
pub mod fit;
pub mod quality;
pub mod session;
pub mod text_file;

pub use file::CalibrationFile;
pub use fit::{FitError, ModelKind, fit};
pub use quality::{Quality, reference_ratio, residuals};
pub use text_file::{read_bytes, read_text};

use std::vec::Vec;

/// One instant of a trial.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TrialSample {
    /// Since the start of the trial, s; rises from sample to sample.
    pub time_s: f64,
    /// Counts below FDAT at rest.
    pub drop: f64,
    /// Reference force, N, ≥ 0.
    pub force_n: f64,
}

/// One press-and-release recording of one taxel. It starts at rest: the foam remembers nothing.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Trial {
    /// In order of time.
    pub samples: Vec<TrialSample>,
}

impl Trial {
    /// Pairs counts with the reference force at the moment each was **sampled**, by linear interpolation; counts
    /// outside the reference's time are left out. `counts`: (s, FDAT), `force`: (s, N), both in order of time.
    pub fn align(counts: &[(f64, u16)], rest_counts: f64, force: &[(f64, f64)]) -> Self {
        let mut samples = Vec::with_capacity(counts.len());
        let mut next = 0;
        for &(time_s, fdat) in counts {
            while next < force.len() && force[next].0 < time_s {
                next += 1;
            }
            let Some((&(t0, f0), &(t1, f1))) =
                next.checked_sub(1).and_then(|i| force.get(i)).zip(force.get(next))
            else {
                continue;
            };
            let force_n = f0 + (f1 - f0) * (time_s - t0) / (t1 - t0);
            samples.push(TrialSample { time_s, drop: rest_counts - f64::from(fdat), force_n });
        }
        Self { samples }
    }
}
