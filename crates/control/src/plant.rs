//! The plant: whatever has a base and an arm. The only line that simulation and robot do not share.

use crate::flange_sensor::FlangeSensor;
use crate::robot::JOINTS;
use moca_msgs::{
    Actuation, ArmLink, Fault, GripperRefusal, GripperRequest, GripperState, Outcome, Refusal, RobotState,
};
use serde::{Deserialize, Serialize};
use std::time::Duration;

/// Ages of the parts of a measured state.
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
    /// Shown to clients with its arm at `q_rad`.
    pub const fn at(q_rad: [f64; JOINTS]) -> Self {
        Self(RobotState::at_rest(q_rad))
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

/// A robot, simulated or real.
pub trait Plant {
    /// The state measured at this tick. A part whose state is old is judged by its age: where the arm is known and the base
    /// is not, this is a state.
    ///
    /// # Errors
    /// The fault that the supervisor has to react to: [`Fault::ArmReflex`] and its like for an arm that does not let itself
    /// be controlled now, [`Fault::PlantLost`] for a robot that no longer answers and needs a restart.
    fn read(&mut self) -> Result<RobotState<JOINTS>, Fault>;

    /// Age of the state that [`Plant::read`] last gave.
    fn age(&self) -> SourceAge {
        SourceAge::default()
    }

    /// Returns the report of a real arm on itself and on the link to it.
    fn link(&self) -> Option<ArmLink> {
        None
    }

    /// Begins to recover the arm from its reflex; asked for once for each resume, and answered at once: the recovery ends
    /// when [`Plant::read`] gives a state again.
    ///
    /// # Errors
    /// [`Refusal::Recovering`] if it has begun, else why not.
    fn recover(&mut self) -> Outcome {
        Err(Refusal::CauseRemains(Fault::ArmReflex))
    }

    /// Returns what a gripper on the flange reports at this tick; `None` without one.
    fn gripper(&mut self) -> Option<GripperState> {
        None
    }

    /// Hands a request to the gripper, and waits for nothing: its end is seen in [`Plant::gripper`].
    ///
    /// # Errors
    /// [`Refusal::Gripper`] for a request that it does not take.
    fn request_gripper(&mut self, _request: &GripperRequest) -> Outcome {
        Err(GripperRefusal::NoGripper.into())
    }

    /// Carries out an order that stands for `ticks` control periods (more than 1 after missed slots).
    ///
    /// # Errors
    /// As for [`Plant::read`].
    fn write(&mut self, actuation: &Actuation<JOINTS>, ticks: u64) -> Result<(), Fault>;

    /// Returns the force-torque sensor at the flange, where `plant.flange_sensor` declares one.
    fn flange_sensor(&mut self) -> Option<&mut dyn FlangeSensor> {
        None
    }

    /// Returns the requests that only a simulated robot takes.
    fn simulated(&mut self) -> Option<&mut dyn Simulated> {
        None
    }

    /// Returns true if every bit of its state counts; else the loop rounds it to what sensors measure.
    fn is_exact(&mut self) -> bool {
        self.simulated().is_some()
    }
}

/// A robot in a simulated world.
pub trait Simulated {
    /// Presses a taxel (0 is T1) with a steady force, N.
    ///
    /// # Errors
    /// [`Refusal::OutOfRange`] for a taxel or force that does not exist.
    fn press(&mut self, taxel: usize, force_n: f64) -> Outcome;
}

/// Time of a plant that is the loop's clock.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Datagram {
    /// One came, with the plant's own count of control periods: one more each period, lost datagrams included.
    Count(u64),
    /// None came in time.
    Missing,
}

/// A robot whose datagrams are the loop's clock.
pub trait PlantClock: Plant {
    /// Waits for the next datagram, at most `timeout`; the newest counts.
    fn receive(&mut self, timeout: Duration) -> Datagram;
}
