//! Presses of a frame.

use crate::logic::answers::Answer;
use moca_msgs::Request;
use moca_telemetry::calibration::CalibrationRequest;
use std::path::PathBuf;

/// Everything that was pressed in a frame; carried out when the frame is laid out.
#[derive(Default)]
pub(super) struct PageRequests {
    /// For the loop.
    pub(super) requests: Vec<Request>,
    /// For the calibrator.
    pub(super) calibrate: Option<CalibrationRequest>,
    /// A push of a simulated taxel (0 is T1), N.
    pub(super) push: Option<(u8, f64)>,
    /// Show this log.
    pub(super) open_log: Option<PathBuf>,
    /// Open the window that chooses a log.
    pub(super) choose_log: bool,
    /// Close the log in front.
    pub(super) close_log: bool,
    /// Start or end a recording.
    pub(super) record: bool,
    /// Save what the plots show as a table.
    pub(super) export: bool,
    /// Save the parameters that differ from their defaults.
    pub(super) save_parameters: bool,
    /// Answers to show.
    pub(super) answers: Vec<Answer>,
}
