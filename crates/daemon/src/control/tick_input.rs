//! What one tick was given and what came of it: all that a replay needs besides the board's bytes.

use crate::control::plant::SourceAge;
use crate::robot::JOINTS;
use moca_msgs::{ArmLink, Fault, Outcome, Request, RobotState, STAGES};
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
    /// How late the tick woke, s.
    pub lateness_s: f64,
    /// Missed slots so far.
    pub overruns: u64,
    /// How long each stage of the tick before took, ns; only for the sample, and not replayed.
    pub stages_ns: [u32; STAGES.len()],
}

/// Everything one tick was given, besides the board's bytes, and what it answered.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct TickInput {
    /// When it ran.
    pub slot: Slot,
    /// What the plant measured, or why it did not.
    pub state: Result<RobotState<JOINTS>, Fault>,
    /// How old that was.
    pub age: SourceAge,
    /// What a real arm said about itself.
    pub link: Option<ArmLink>,
    /// What was asked.
    pub request: Option<Request>,
    /// What was answered.
    pub outcome: Option<Outcome>,
    /// What the plant said to the order.
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
            request: None,
            outcome: None,
            refused: None,
            cover_events: 0,
        }
    }
}
