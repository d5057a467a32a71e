//! Link to a real robot: age of its states, and the arm's report on the orders it receives.
//!
//! ```
//! use moca_msgs::link::{ArmLink, ArmMode};
//!
//! let arm = ArmLink { mode: ArmMode::Torque, success_rate: 0.98, ..ArmLink::default() };
//! assert!(arm.mode.follows() && arm.errors == 0);
//! assert_eq!(ArmMode::Reflex.hindrance(), Some(moca_msgs::Fault::ArmReflex));
//! assert_eq!(arm.to_string(), "torque control, success rate 0.98, 0 lost, 0 orders repeated");
//! let stopped = ArmLink { mode: ArmMode::Reflex, errors: 0b1100_0000, ..arm };
//! assert!(stopped.to_string().starts_with("reflex (joint_reflex, cartesian_reflex), success rate"));
//! ```

use crate::{Fault, arm_errors};
use core::fmt;

/// Mode of an arm with a controller of its own.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub enum ArmMode {
    /// Being reached.
    #[default]
    Connecting,
    /// On its own controller; its states come.
    Idle,
    /// Follows our torques.
    Torque,
    /// Stopped by its own reflex until it is recovered.
    Reflex,
    /// Stopped by its user-stop device.
    UserStopped,
    /// Being recovered from a reflex.
    Recovering,
    /// Reached before, silent now.
    Lost,
    /// Reached, but not to be controlled: another version, no FCI, brakes closed.
    Refused,
    /// There is none, or it is simulated.
    NotThere,
}

impl ArmMode {
    /// Every mode.
    pub const ALL: [Self; 9] = [
        Self::Connecting,
        Self::Idle,
        Self::Torque,
        Self::Reflex,
        Self::UserStopped,
        Self::Recovering,
        Self::Lost,
        Self::Refused,
        Self::NotThere,
    ];

    /// Returns true if the arm follows our torques.
    pub const fn follows(self) -> bool {
        matches!(self, Self::Torque)
    }

    /// Returns the fault that keeps the arm from being driven, if any.
    pub const fn hindrance(self) -> Option<Fault> {
        match self {
            Self::Idle | Self::Torque | Self::NotThere => None,
            Self::Connecting | Self::Lost => Some(Fault::ArmStale),
            Self::Reflex | Self::Recovering => Some(Fault::ArmReflex),
            Self::UserStopped => Some(Fault::ArmUserStopped),
            Self::Refused => Some(Fault::ArmRefused),
        }
    }

    /// Name as shown to users.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Connecting => "connecting",
            Self::Idle => "idle",
            Self::Torque => "torque control",
            Self::Reflex => "reflex",
            Self::UserStopped => "user stop",
            Self::Recovering => "recovering",
            Self::Lost => "lost",
            Self::Refused => "refused",
            Self::NotThere => "not there",
        }
    }
}

/// Report of an arm on itself and on the orders that reach it.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct ArmLink {
    /// Mode of the arm.
    pub mode: ArmMode,
    /// Share of the last commands that reached it in time, 0 to 1, as it says itself.
    pub success_rate: f64,
    /// Its states that never came, since the start.
    pub lost: u64,
    /// Orders that were repeated because the loop gave none in time, since the start.
    pub repeated: u64,
    /// Its error flags, bit 0 is the first of its list.
    pub errors: u64,
}

/// `reflex (joint_reflex), success rate 0.98, 3 lost, 4 orders repeated`.
impl fmt::Display for ArmLink {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { mode, success_rate, lost, repeated, errors } = *self;
        f.write_str(mode.name())?;
        let mut end = "";
        for error in arm_errors::set_in(errors) {
            write!(f, "{}{}", if end.is_empty() { " (" } else { ", " }, error.name)?;
            end = ")";
        }
        write!(f, "{end}, success rate {success_rate:.2}, {lost} lost, {repeated} orders repeated")
    }
}

/// The way to a real robot at one tick.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct Link {
    /// Age of the arm's state, s.
    pub arm_age_s: f64,
    /// Age of the base's state, s.
    pub base_age_s: f64,
    /// The arm.
    pub arm: ArmLink,
}
