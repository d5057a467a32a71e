//! The plant: whatever has a base and an arm. The only line that simulation and robot do not share.

use crate::config::JOINTS;
use moca_msgs::{Actuation, Fault, Outcome, Refusal, RobotState};
use serde::{Deserialize, Serialize};
use std::time::Duration;

/// How old the parts of a measured state are.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct SourceAge {
    /// Age of the arm's part, s.
    pub arm_s: f64,
    /// Age of the base's part, s.
    pub base_s: f64,
}

/// No robot at all: it stands still and carries out nothing.
#[derive(Clone, Copy, Debug)]
pub struct NoRobot(RobotState<JOINTS>);

impl NoRobot {
    /// Shown to observers with its arm at `q_rad`.
    pub const fn at(q_rad: [f64; JOINTS]) -> Self {
        Self(RobotState {
            base_pose_world: [0.0; 3],
            base_velocity_world: [0.0; 3],
            q_rad,
            dq_rad_s: [0.0; JOINTS],
            torque_measured_nm: [0.0; JOINTS],
            flange_wrench_world: None,
        })
    }
}

impl Plant for NoRobot {
    fn read(&mut self) -> Result<RobotState<JOINTS>, Fault> {
        Ok(self.0)
    }

    fn write(&mut self, _actuation: &Actuation<JOINTS>, _ticks: u64) -> Result<(), Fault> {
        Ok(())
    }
}

/// What a plant that is the loop's clock says about time.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Beat {
    /// A datagram, with the plant's own count of control periods: one more each period, lost datagrams included.
    Count(u64),
    /// None in time.
    Missing,
}

/// A robot, simulated or real.
pub trait Plant {
    /// Waits for the next datagram of a plant that is the loop's clock, at most `timeout`; the newest counts. `None` is
    /// a plant without a clock: a timer drives the loop.
    fn beat(&mut self, _timeout: Duration) -> Option<Beat> {
        None
    }

    /// The state measured at this tick.
    ///
    /// # Errors
    /// The fault that the supervisor has to react to, [`Fault::PlantLost`] for one that no longer answers.
    fn read(&mut self) -> Result<RobotState<JOINTS>, Fault>;

    /// Age of the state that [`Plant::read`] last gave.
    fn age(&self) -> SourceAge {
        SourceAge::default()
    }

    /// Carries out an order that stands for `ticks` control periods (more than 1 after missed slots).
    ///
    /// # Errors
    /// As for [`Plant::read`].
    fn write(&mut self, actuation: &Actuation<JOINTS>, ticks: u64) -> Result<(), Fault>;

    /// Presses a taxel (0 is T1) with a steady force, N.
    ///
    /// # Errors
    /// [`Refusal::NotSimulated`] on a real robot, [`Refusal::OutOfRange`] for a taxel or force that does not exist.
    fn press(&mut self, _taxel: usize, _force_n: f64) -> Outcome {
        Err(Refusal::NotSimulated)
    }
}
