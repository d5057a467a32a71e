//! Source of the next tick: the loop's own timer, or a plant whose datagrams are the clock.

use crate::control::plant::{Datagram, PlantClock};
use crate::control::stage::Stage;
use crate::runtime::clock::Clock;
use crate::runtime::schedule::Schedule;
use std::time::Duration;

/// Periods without a datagram after which the loop ticks all the same, so that a silent plant is a stop and not a wait.
const DATAGRAM_TIMEOUT_PERIODS: u32 = 5;
/// Periods that a plant's count may run ahead of the time that has passed; beyond, or back, it has started anew.
const COUNT_AHEAD_MAX: u64 = 1000;

/// A tick that is due.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Tick {
    /// Its number.
    pub number: u64,
    /// Loop time, ns.
    pub now_ns: u64,
    /// Slots skipped since the tick before.
    pub missed: u64,
    /// Stage that caused the missed slots; `None` is the stage that took longest in the tick before.
    pub missed_by: Option<Stage>,
    /// Lateness of the tick.
    pub lateness: Duration,
}

/// Says when the next tick is due.
pub trait TickSource<P> {
    /// Waits for the next tick; `None` where that is after `end_ns`.
    fn wait(&mut self, plant: &mut P, end_ns: u64) -> Option<Tick>;
}

/// The loop's own timer: one tick a period at absolute deadlines.
#[derive(Debug)]
pub struct Timer {
    clock: Clock,
    schedule: Schedule,
    started: bool,
}

impl Timer {
    /// Nothing has ticked yet.
    pub fn new(clock: Clock, period_ns: u64) -> Self {
        Self { clock, schedule: Schedule::starting_after(clock.now_ns(), period_ns), started: false }
    }
}

impl<P> TickSource<P> for Timer {
    fn wait(&mut self, _plant: &mut P, end_ns: u64) -> Option<Tick> {
        let missed = if self.started { self.schedule.advance(self.clock.now_ns()) } else { 0 };
        let (number, deadline_ns) = (self.schedule.slot(), self.schedule.deadline_ns());
        if deadline_ns >= end_ns {
            return None;
        }
        let now_ns = self.clock.sleep_until(deadline_ns);
        self.started = true;
        let lateness = Duration::from_nanos(now_ns.saturating_sub(deadline_ns));
        (now_ns < end_ns).then_some(Tick { number, now_ns, missed, missed_by: None, lateness })
    }
}

/// The plant's datagrams: one tick for each, at the plant's own count.
#[derive(Debug)]
pub struct PlantTicks {
    clock: Clock,
    period_ns: u64,
    last: Option<Last>,
}

#[derive(Clone, Copy, Debug)]
struct Last {
    number: u64,
    now_ns: u64,
    /// Offset from the plant's count to the tick; known from its first datagram on.
    offset: Option<u64>,
}

impl PlantTicks {
    /// Nothing has ticked yet.
    pub fn new(clock: Clock, period_ns: u64) -> Self {
        Self { clock, period_ns: period_ns.max(1), last: None }
    }

    fn tick(&mut self, datagram: Datagram, asked_ns: u64) -> Tick {
        let now_ns = self.clock.now_ns();
        let Some(last) = self.last else {
            // The plant's own count may begin anywhere; the loop's begins at 0.
            let offset = match datagram {
                Datagram::Count(count) => Some(0_u64.wrapping_sub(count)),
                Datagram::Missing => None,
            };
            self.last = Some(Last { number: 0, now_ns, offset });
            return Tick { number: 0, now_ns, missed: 0, missed_by: None, lateness: Duration::ZERO };
        };
        let next = last.number + 1;
        let elapsed = now_ns.saturating_sub(last.now_ns) / self.period_ns;
        let furthest = next.saturating_add(elapsed).saturating_add(COUNT_AHEAD_MAX);
        let counted = |count: u64, offset: u64| {
            let number = count.wrapping_add(offset);
            (next..=furthest).contains(&number).then_some((number, Some(offset)))
        };
        let (number, offset) = match datagram {
            Datagram::Count(count) => last
                .offset
                .and_then(|offset| counted(count, offset))
                .unwrap_or((next, Some(next.wrapping_sub(count)))),
            Datagram::Missing => (next.max(last.number + elapsed), last.offset),
        };
        let missed = number - next;
        let due_ns = last.now_ns + (missed + 1) * self.period_ns;
        self.last = Some(Last { number, now_ns, offset });
        let lateness = Duration::from_nanos(now_ns.saturating_sub(due_ns));
        // Asked in time, the datagram did not come; asked too late, the stages before took too long.
        let missed_by = (asked_ns <= last.now_ns + self.period_ns).then_some(Stage::Read);
        Tick { number, now_ns, missed, missed_by, lateness }
    }
}

impl<P: PlantClock> TickSource<P> for PlantTicks {
    fn wait(&mut self, plant: &mut P, end_ns: u64) -> Option<Tick> {
        let asked_ns = self.clock.now_ns();
        let datagram = plant.receive(Duration::from_nanos(self.period_ns) * DATAGRAM_TIMEOUT_PERIODS);
        let tick = self.tick(datagram, asked_ns);
        (tick.now_ns < end_ns).then_some(tick)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn at(ticks: &mut PlantTicks, datagram: Datagram) -> (u64, u64) {
        let asked_ns = ticks.clock.now_ns();
        let tick = ticks.tick(datagram, asked_ns);
        (tick.number, tick.missed)
    }

    #[test]
    fn ticks_follow_the_plants_count_and_never_go_back() {
        // A period far longer than this test: only counts move the ticks.
        let mut ticks = PlantTicks::new(Clock::start().unwrap(), 1_000_000_000_000);
        assert_eq!(at(&mut ticks, Datagram::Count(7)), (0, 0), "the loop's own count begins at 0");
        assert_eq!(at(&mut ticks, Datagram::Count(8)), (1, 0));
        assert_eq!(at(&mut ticks, Datagram::Count(12)), (5, 3));
        assert_eq!(at(&mut ticks, Datagram::Count(12)), (6, 0), "the same count twice");
        assert_eq!(at(&mut ticks, Datagram::Missing), (7, 0));
        assert_eq!(at(&mut ticks, Datagram::Count(3)), (8, 0), "the plant started anew");
        assert_eq!(at(&mut ticks, Datagram::Count(5)), (10, 1));
        assert_eq!(at(&mut ticks, Datagram::Count(u64::MAX)), (11, 0), "no count that can be");
        assert_eq!(at(&mut ticks, Datagram::Count(u64::MAX)), (12, 0));
    }

    #[test]
    fn a_plants_first_count_may_be_the_largest() {
        let mut ticks = PlantTicks::new(Clock::start().unwrap(), 1_000_000_000_000);
        assert_eq!(at(&mut ticks, Datagram::Count(u64::MAX)), (0, 0));
        assert_eq!(at(&mut ticks, Datagram::Count(0)), (1, 0), "it wraps round");
        assert_eq!(at(&mut ticks, Datagram::Count(2)), (3, 1));
    }

    #[test]
    fn silent_plant_gets_ticks_from_first_datagram() {
        let mut ticks = PlantTicks::new(Clock::start().unwrap(), 1_000_000_000_000);
        assert_eq!(at(&mut ticks, Datagram::Missing), (0, 0));
        assert_eq!(at(&mut ticks, Datagram::Missing), (1, 0));
        assert_eq!(at(&mut ticks, Datagram::Count(0)), (2, 0));
        assert_eq!(at(&mut ticks, Datagram::Count(2)), (4, 1));
    }
}
