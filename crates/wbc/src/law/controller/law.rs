//! Which law drives the robot.

use moca_msgs::Law;

/// Law that drives the robot in one step.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub enum ControlLaw {
    /// Base to a stop within its limits; arm holds the posture it had when the law was entered.
    #[default]
    Hold,
    /// Expanded Cartesian impedance, eqs. (6)–(11).
    Impedance,
    /// Expanded follow-me, eqs. (12)–(16).
    FollowMe,
}

impl From<Law> for ControlLaw {
    fn from(law: Law) -> Self {
        match law {
            Law::Impedance => Self::Impedance,
            Law::FollowMe => Self::FollowMe,
        }
    }
}
