//! The stages of one tick. The tick says when each ends; who wants to know how long it took reads a clock then.

use moca_msgs::STAGES;

/// Stages of one tick, in the order in which the data flows.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Stage {
    /// Plant → robot state.
    Read,
    /// Bytes → frames → forces.
    Cover,
    /// Mode and command.
    Control,
    /// Command → plant (in simulation this includes the physics step).
    Write,
    /// Sample → clients' ring.
    Publish,
}

impl Stage {
    /// All stages, in order.
    pub const ALL: [Self; 5] = [Self::Read, Self::Cover, Self::Control, Self::Write, Self::Publish];

    /// Name as shown to users.
    pub const fn name(self) -> &'static str {
        STAGES[self as usize]
    }
}

/// Is told when a tick begins, and when a stage of it ends.
pub trait StageTimer {
    /// A tick begins; its first stage starts here.
    fn begin(&mut self);

    /// `stage` is over; the next one starts here.
    fn end(&mut self, stage: Stage);
}

/// Measures nothing: for a replay, and for runs that nobody asks how long their ticks took.
#[derive(Clone, Copy, Debug, Default)]
pub struct Untimed;

impl StageTimer for Untimed {
    fn begin(&mut self) {}

    fn end(&mut self, _stage: Stage) {}
}
