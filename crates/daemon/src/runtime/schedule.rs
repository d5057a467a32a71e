//! When the next tick is due: absolute deadlines; a missed slot is skipped and counted, never caught up.

/// Slots of one period each, counted from the start of the loop.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Schedule {
    period_ns: u64,
    slot: u64,
}

impl Schedule {
    /// Starts before slot 0. A period of 0 is taken as 1 ns.
    pub const fn new(period_ns: u64) -> Self {
        Self { period_ns: if period_ns == 0 { 1 } else { period_ns }, slot: 0 }
    }

    /// Starts at the first slot that is due after `now_ns`.
    pub const fn starting_after(now_ns: u64, period_ns: u64) -> Self {
        let mut schedule = Self::new(period_ns);
        schedule.advance(now_ns);
        schedule
    }

    /// The slot that is due next.
    pub const fn slot(&self) -> u64 {
        self.slot
    }

    /// When it is due, ns of loop time.
    pub const fn deadline_ns(&self) -> u64 {
        self.slot * self.period_ns
    }

    /// Moves on after a tick that ended at `now_ns`: to the next slot, or, when its deadline has already passed, to
    /// the first one that has not. Returns how many slots were skipped.
    pub const fn advance(&mut self, now_ns: u64) -> u64 {
        let next = self.slot + 1;
        let first_due = now_ns.div_ceil(self.period_ns);
        let missed = first_due.saturating_sub(next);
        self.slot = next + missed;
        missed
    }
}

#[cfg(test)]
mod tests {
    use super::Schedule;

    const MS: u64 = 1_000_000;

    #[test]
    fn a_tick_in_time_moves_to_the_next_slot() {
        let mut schedule = Schedule::new(MS);
        assert_eq!(schedule.deadline_ns(), 0);
        assert_eq!(schedule.advance(300_000), 0);
        assert_eq!(schedule.deadline_ns(), MS);
    }

    #[test]
    fn a_tick_that_ends_on_the_next_deadline_has_missed_nothing() {
        let mut schedule = Schedule::new(MS);
        assert_eq!(schedule.advance(MS), 0);
        assert_eq!(schedule.slot(), 1);
    }

    #[test]
    fn a_loop_that_starts_late_has_missed_nothing_yet() {
        let schedule = Schedule::starting_after(33 * MS + 5, MS);
        assert_eq!((schedule.slot(), schedule.deadline_ns()), (34, 34 * MS));
    }

    #[test]
    fn missed_slots_are_skipped_and_counted() {
        let mut schedule = Schedule::new(MS);
        assert_eq!(schedule.advance(3 * MS + 1), 3, "slots 1, 2 and 3 are gone");
        assert_eq!(schedule.deadline_ns(), 4 * MS, "the phase is kept: no burst, no drift");
        assert_eq!(schedule.advance(4 * MS + 1), 0);
    }
}
