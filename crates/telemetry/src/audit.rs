//! Lines of the robot's own audit: who asked it for something, and what came of it.

use serde::{Deserialize, Serialize};

/// [`Asked::what`] of a client that comes.
pub const CONNECT: &str = "connect";
/// [`Asked::what`] of a client that goes.
pub const LEAVE: &str = "leave";

/// Requests of one client that had one answer, in the second before. A log has them in `/audit`.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "log", derive(schemars::JsonSchema))]
pub struct Asked {
    /// Client: `certificate NAME`, `user NUMBER` of the robot's computer, `port` or `machine ADDRESS`; after it the one for whom it
    /// says that it speaks.
    pub who: String,
    /// Request, with taxel, parameter or law.
    pub what: String,
    /// True if it was carried out.
    pub accepted: bool,
    /// Reason of a refusal; the role of one that connects.
    pub answer: String,
    /// Number of requests that this line stands for, at least 1.
    pub times: u64,
}

impl Asked {
    /// Returns true if something was asked of the robot, or somebody was not let in: coming and going is no request.
    pub fn is_request(&self) -> bool {
        !(self.accepted && [CONNECT, LEAVE].contains(&self.what.as_str()))
    }
}
