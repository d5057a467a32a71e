//! What the user has chosen to look at.

use super::calibrate::Choice;
use crate::logic::TimeAxis;
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
    pub(super) calibration: Choice,
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
            calibration: Choice::default(),
            drafts: BTreeMap::new(),
        }
    }
}
