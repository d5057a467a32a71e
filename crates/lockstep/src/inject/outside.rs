//! Faults outside the loop: the disk, a subscriber, a panel, a setting.

use moca_msgs::{ParameterValues, Request};

/// Fault outside the loop.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[expect(missing_docs, reason = "each is described once, in the table of inject/mod.rs")]
pub enum OutsideFault {
    DiskFull,
    DiskSlow,
    SubscriberStalled,
    SubscriberGone,
    SocketGarbage,
    PanelGone,
    ParameterNan,
    ParameterAbsurd,
    Panic,
}

impl OutsideFault {
    /// Returns true if it strikes the disk that a log is written to.
    pub const fn is_of_disk(self) -> bool {
        matches!(self, Self::DiskFull | Self::DiskSlow)
    }

    /// The request by which it reaches the loop, if it does.
    pub fn request(self) -> Option<Request> {
        let set = |value: f64| Request::SetParameter {
            parameter: 0,
            values: ParameterValues::new(&[value; 3]).unwrap_or_default(),
        };
        match self {
            Self::PanelGone => Some(Request::OperatorLost),
            Self::ParameterNan => Some(set(f64::NAN)),
            Self::ParameterAbsurd => Some(set(1e12)),
            _ => None,
        }
    }
}
