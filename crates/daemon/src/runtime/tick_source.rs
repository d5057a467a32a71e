//! What makes the next tick happen: the loop's own timer, or a plant whose datagrams are the clock.

use crate::control::plant::{Beat, Plant};
use crate::runtime::live::Clock;
use crate::runtime::schedule::Schedule;
use crate::runtime::timing::Stage;
use std::time::Duration;

/// Periods without a datagram after which the loop ticks all the same, so that a silent plant is a stop and not a wait.
const BEAT_TIMEOUT_PERIODS: u32 = 5;

/// Periods that a plant's count may run ahead of the time that has passed; beyond, or back, it has started anew.
const COUNT_AHEAD_MAX: u64 = 1000;

/// A tick that is due.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Woken {
    /// Its number.
    pub tick: u64,
    /// Loop time, ns.
    pub now_ns: u64,
    /// Slots skipped since the tick before.
    pub missed: u64,
    /// Who is to blame for them; `None` is the stage that took longest in the tick before.
    pub missed_by: Option<Stage>,
    /// How late it comes.
    pub lateness: Duration,
}

/// Waits for one tick after the other.
#[derive(Debug)]
pub struct Pace {
    clock: Clock,
    schedule: Schedule,
    period_ns: u64,
    last: Option<Last>,
}

#[derive(Clone, Copy, Debug)]
struct Last {
    tick: u64,
    now_ns: u64,
    /// What has to be added to the plant's count to give the tick; known from its first datagram on.
    offset: Option<u64>,
}

impl Pace {
    /// Nothing has ticked yet.
    pub fn new(clock: Clock, period_ns: u64) -> Self {
        let schedule = Schedule::starting_after(clock.now_ns(), period_ns);
        Self { clock, schedule, period_ns: period_ns.max(1), last: None }
    }

    /// Waits until the plant's datagram has come or the timer's deadline has passed; `None` where that is after `end_ns`.
    pub fn wait<P: Plant>(&mut self, plant: &mut P, end_ns: u64) -> Option<Woken> {
        let timeout = Duration::from_nanos(self.period_ns) * BEAT_TIMEOUT_PERIODS;
        let asked_ns = self.clock.now_ns();
        let woken = match plant.beat(timeout) {
            Some(beat) => self.at_beat(beat, asked_ns),
            None => self.at_deadline(end_ns)?,
        };
        (woken.now_ns < end_ns).then_some(woken)
    }

    fn at_deadline(&mut self, end_ns: u64) -> Option<Woken> {
        let missed = if self.last.is_some() { self.schedule.advance(self.clock.now_ns()) } else { 0 };
        let (tick, deadline_ns) = (self.schedule.slot(), self.schedule.deadline_ns());
        if deadline_ns >= end_ns {
            return None;
        }
        let now_ns = self.clock.sleep_until(deadline_ns);
        self.last = Some(Last { tick, now_ns, offset: None });
        let lateness = Duration::from_nanos(now_ns.saturating_sub(deadline_ns));
        Some(Woken { tick, now_ns, missed, missed_by: None, lateness })
    }

    fn at_beat(&mut self, beat: Beat, asked_ns: u64) -> Woken {
        let now_ns = self.clock.now_ns();
        let Some(last) = self.last else {
            let (tick, offset) = match beat {
                Beat::Count(count) => (count, Some(0)),
                Beat::Missing => (0, None),
            };
            self.last = Some(Last { tick, now_ns, offset });
            return Woken { tick, now_ns, missed: 0, missed_by: None, lateness: Duration::ZERO };
        };
        let next = last.tick + 1;
        let elapsed = now_ns.saturating_sub(last.now_ns) / self.period_ns;
        let furthest = next + elapsed + COUNT_AHEAD_MAX;
        let counted = |count: u64, offset: u64| {
            let tick = count.wrapping_add(offset);
            (next..=furthest).contains(&tick).then_some((tick, Some(offset)))
        };
        let (tick, offset) = match beat {
            Beat::Count(count) => last
                .offset
                .and_then(|offset| counted(count, offset))
                .unwrap_or((next, Some(next.wrapping_sub(count)))),
            Beat::Missing => (next.max(last.tick + elapsed), last.offset),
        };
        let missed = tick - next;
        let due_ns = last.now_ns + (missed + 1) * self.period_ns;
        self.last = Some(Last { tick, now_ns, offset });
        let lateness = Duration::from_nanos(now_ns.saturating_sub(due_ns));
        // Asked in time, the datagram did not come; asked too late, the stages before took too long.
        let missed_by = (asked_ns <= last.now_ns + self.period_ns).then_some(Stage::Read);
        Woken { tick, now_ns, missed, missed_by, lateness }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn at(pace: &mut Pace, beat: Beat) -> (u64, u64) {
        let asked_ns = pace.clock.now_ns();
        let woken = pace.at_beat(beat, asked_ns);
        (woken.tick, woken.missed)
    }

    #[test]
    fn ticks_follow_the_plants_count_and_never_go_back() {
        // A period far longer than this test: only counts move the ticks.
        let mut pace = Pace::new(Clock::start().unwrap(), 1_000_000_000_000);
        assert_eq!(at(&mut pace, Beat::Count(7)), (7, 0));
        assert_eq!(at(&mut pace, Beat::Count(8)), (8, 0));
        assert_eq!(at(&mut pace, Beat::Count(12)), (12, 3));
        assert_eq!(at(&mut pace, Beat::Count(12)), (13, 0), "the same count twice");
        assert_eq!(at(&mut pace, Beat::Missing), (14, 0));
        assert_eq!(at(&mut pace, Beat::Count(3)), (15, 0), "the plant started anew");
        assert_eq!(at(&mut pace, Beat::Count(5)), (17, 1));
        assert_eq!(at(&mut pace, Beat::Count(u64::MAX)), (18, 0), "no count that can be");
        assert_eq!(at(&mut pace, Beat::Count(u64::MAX)), (19, 0));
    }

    #[test]
    fn a_plant_that_is_silent_at_first_gets_the_ticks_from_its_first_datagram_on() {
        let mut pace = Pace::new(Clock::start().unwrap(), 1_000_000_000_000);
        assert_eq!(at(&mut pace, Beat::Missing), (0, 0));
        assert_eq!(at(&mut pace, Beat::Missing), (1, 0));
        assert_eq!(at(&mut pace, Beat::Count(0)), (2, 0));
        assert_eq!(at(&mut pace, Beat::Count(2)), (4, 1));
    }
}
