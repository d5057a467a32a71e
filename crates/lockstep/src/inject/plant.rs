//! A robot whose answers are spoiled.

use moca_control::plant::SourceAge;
use moca_control::robot::JOINTS;
use moca_msgs::{Fault, RobotState};

const JUMP_RAD: f64 = 0.5;
const JUMP_M: f64 = 0.5;

/// Fault of the robot.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[expect(missing_docs, reason = "each is described once, in the table of inject/mod.rs")]
pub enum PlantFault {
    JointNan,
    JointRateInfinite,
    JointJump,
    BaseNan,
    BaseJump,
    Lost,
    Refused,
    ArmStale,
    BaseStale,
    GripperUnplugged,
    Panic,
}

impl PlantFault {
    /// Returns true for a fault of the arm alone.
    pub(super) const fn is_of_arm(self) -> bool {
        matches!(self, Self::JointNan | Self::JointRateInfinite | Self::JointJump | Self::ArmStale)
    }

    /// Returns true for a fault of the base alone.
    pub(super) const fn is_of_base(self) -> bool {
        matches!(self, Self::BaseNan | Self::BaseJump | Self::BaseStale)
    }
}

/// Spoils what a plant says from its strike on.
#[derive(Clone, Copy, Debug)]
pub struct PlantSpoiler {
    fault: PlantFault,
    at_tick: u64,
    ticks: u64,
    last_good: Option<RobotState<JOINTS>>,
    stale_s: f64,
}

impl PlantSpoiler {
    /// `fault` strikes at `at_tick`.
    pub const fn new(fault: PlantFault, at_tick: u64) -> Self {
        Self { fault, at_tick, ticks: 0, last_good: None, stale_s: 0.0 }
    }

    /// The state as the loop gets to see it.
    ///
    /// # Errors
    /// [`Fault::PlantLost`] once [`PlantFault::Lost`] has struck.
    pub fn read(&mut self, mut state: RobotState<JOINTS>) -> Result<RobotState<JOINTS>, Fault> {
        if self.ticks < self.at_tick {
            self.last_good = Some(state);
            return Ok(state);
        }
        match self.fault {
            PlantFault::JointNan => state.q_rad[2] = f64::NAN,
            PlantFault::JointRateInfinite => state.dq_rad_s[4] = f64::INFINITY,
            PlantFault::JointJump => state.q_rad[1] += JUMP_RAD,
            PlantFault::BaseNan => state.base_pose_world[1] = f64::NAN,
            PlantFault::BaseJump => state.base_pose_world[0] += JUMP_M,
            PlantFault::Lost => return Err(Fault::PlantLost),
            PlantFault::Refused | PlantFault::GripperUnplugged => {}
            #[expect(clippy::panic, reason = "this is the fault")]
            PlantFault::Panic => panic!("injected into the loop"),
            PlantFault::ArmStale => {
                if let Some(last) = self.last_good {
                    (state.q_rad, state.dq_rad_s) = (last.q_rad, last.dq_rad_s);
                }
            }
            PlantFault::BaseStale => {
                if let Some(last) = self.last_good {
                    state.base_pose_world = last.base_pose_world;
                    state.base_velocity_world = last.base_velocity_world;
                }
            }
        }
        Ok(state)
    }

    /// Age of that state.
    pub fn age(&self) -> SourceAge {
        match self.fault {
            PlantFault::ArmStale => SourceAge { arm_s: self.stale_s, base_s: 0.0 },
            PlantFault::BaseStale => SourceAge { arm_s: 0.0, base_s: self.stale_s },
            _ => SourceAge::default(),
        }
    }

    /// Counts `ticks` control periods of `period_s`; gives the plant's answer to a command.
    ///
    /// # Errors
    /// [`Fault::ControlRefused`] once [`PlantFault::Refused`] has struck.
    pub fn write(&mut self, ticks: u64, period_s: f64) -> Result<(), Fault> {
        let struck = self.ticks >= self.at_tick;
        self.ticks += ticks;
        if !struck {
            return Ok(());
        }
        #[expect(clippy::cast_precision_loss, reason = "a count of missed slots")]
        let elapsed_s = ticks as f64 * period_s;
        self.stale_s += elapsed_s;
        if self.fault == PlantFault::Refused { Err(Fault::ControlRefused) } else { Ok(()) }
    }
}
