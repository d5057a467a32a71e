//! The robot at hand: how many joints and taxels it has, and which of its parts there are.

use serde::{Deserialize, Serialize};

/// Joints of the arm this daemon drives.
pub const JOINTS: usize = 7;
/// Taxels of the cover this daemon reads.
pub const TAXELS: usize = 11;

/// Which parts the robot has. What it lacks is neither simulated, started nor shown.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Parts {
    /// Base with cover, and arm.
    Whole,
    /// The base with its cover: both laws follow the hand.
    Base,
    /// The arm on a stand, without a cover: both laws hold the flange where it is.
    Arm,
}

impl Parts {
    /// Whether there is a base, and with it a cover.
    pub const fn has_cover(self) -> bool {
        !matches!(self, Self::Arm)
    }

    /// Whether there is an arm.
    pub const fn has_arm(self) -> bool {
        !matches!(self, Self::Base)
    }
}
