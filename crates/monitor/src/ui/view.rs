//! What the user has chosen to look at.

use crate::logic::signals::axis::TimeAxis;
use std::collections::BTreeMap;

/// How one robot is looked at.
pub(super) struct View {
    /// The plots' axis of time.
    pub(super) axis: TimeAxis,
    /// Where the mouse points on the axis of time, s of loop time.
    pub(super) cursor_s: Option<f64>,
    /// Force of a push with the mouse, N.
    pub(super) push_n: f64,
    /// What became of the last export or recording.
    pub(super) note: Option<String>,
    /// What is chosen on the page of the calibration.
    pub(super) calibration: CalibrationChoice,
    /// Parameters that were edited and not applied yet, by number.
    pub(super) drafts: BTreeMap<usize, Vec<f64>>,
}

impl Default for View {
    fn default() -> Self {
        Self {
            axis: TimeAxis::default(),
            cursor_s: None,
            push_n: 20.0,
            note: None,
            calibration: CalibrationChoice::default(),
            drafts: BTreeMap::new(),
        }
    }
}

/// What is chosen on the page of the calibration.
pub(super) struct CalibrationChoice {
    /// 0 is T1.
    pub(super) taxel: u8,
    /// Presses of each taxel.
    pub(super) presses: u8,
    /// Place of the model in the fit.
    pub(super) model: usize,
    /// Whether the simulated hand presses.
    pub(super) simulated_press: bool,
    /// Since when, s.
    pub(super) pressing_since_s: Option<f64>,
}

impl Default for CalibrationChoice {
    fn default() -> Self {
        Self { taxel: 0, presses: 3, model: 2, simulated_press: true, pressing_since_s: None }
    }
}
