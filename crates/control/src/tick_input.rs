//! Inputs and results of one tick: all that a replay needs besides the board's bytes.

use crate::flange_sensor::FlangeReading;
use crate::plant::SourceAge;
use crate::robot::JOINTS;
use moca_msgs::{ArmLink, Fault, GripperState, Outcome, Request, RobotState, STAGES};
use serde::{Deserialize, Serialize};

/// When a tick runs.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Slot {
    /// Tick count since the loop started.
    pub tick: u64,
    /// Loop time, ns.
    pub now_ns: u64,
    /// Control periods since the last tick: 1, or more after missed slots.
    pub ticks: u64,
    /// Lateness of the wake-up, s.
    pub lateness_s: f64,
    /// Missed slots so far.
    pub overruns: u64,
    /// Duration of each stage of the tick before, ns; only for the sample, not replayed.
    pub stages_ns: [u32; STAGES.len()],
}

/// Everything one tick was given, besides the board's bytes, and what it answered.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct TickInput {
    /// When it ran.
    pub slot: Slot,
    /// Measured state of the plant, or the reason why there is none.
    pub state: Result<RobotState<JOINTS>, Fault>,
    /// Age of that state.
    pub age: SourceAge,
    /// Report of a real arm on itself.
    pub link: Option<ArmLink>,
    /// Newest reading of the flange sensor; `None` without one, or before its first.
    pub flange: Option<FlangeReading>,
    /// Report of the gripper.
    pub gripper: Option<GripperState>,
    /// Request of a client.
    pub request: Option<Request>,
    /// Answer to it.
    pub outcome: Option<Outcome>,
    /// Fault with which the plant refused the order.
    pub refused: Option<Fault>,
    /// Events that the cover has taken from its source since the start, this tick's included.
    pub cover_events: u64,
}

impl Default for TickInput {
    /// Before the first tick: nothing is known.
    fn default() -> Self {
        Self {
            slot: Slot::default(),
            state: Err(Fault::StateInvalid),
            age: SourceAge::default(),
            link: None,
            flange: None,
            gripper: None,
            request: None,
            outcome: None,
            refused: None,
            cover_events: 0,
        }
    }
}
