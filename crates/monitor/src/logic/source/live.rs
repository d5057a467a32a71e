//! A robot that runs.

use moca_msgs::Request;
use moca_telemetry::{
    calibration::CalibrationRequest,
    net::{Connection, Update},
};

/// A daemon, as the dashboard talks to it.
pub trait Live {
    /// Everything new since the last call; never waits.
    fn poll(&mut self) -> Update;
    /// A picture has been drawn: whoever commands still sees the robot. Without it the daemon takes the command away.
    fn alive(&mut self);
    /// Asks the loop; the answer comes with a later [`Self::poll`].
    fn request(&mut self, request: Request);
    /// Asks the daemon's calibrator.
    fn calibrate(&mut self, request: CalibrationRequest);
}

impl Live for Connection {
    fn poll(&mut self) -> Update {
        Connection::poll(self)
    }

    fn alive(&mut self) {
        Connection::alive(self);
    }

    fn request(&mut self, request: Request) {
        Connection::request(self, request);
    }

    fn calibrate(&mut self, request: CalibrationRequest) {
        Connection::calibrate(self, request);
    }
}
