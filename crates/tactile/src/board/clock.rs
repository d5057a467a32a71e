//! A board's microsecond clock in loop time.

use crate::firmware::LEAST_TRANSPORT_NS;

/// Fastest that a board's clock may run away from the loop's: a full-speed USB device must keep its bit rate, which the
/// same crystal makes, within 0.25 % (USB 2.0, 7.1.11).
const DRIFT_MAX: f64 = 0.0026;
/// Lines that have to agree before the map is used: the first may have waited in a buffer since the port opened.
pub(super) const LEARNING_LINES: u32 = 16;
/// Least time in which they arrive, ns: lines of one burst agree about nothing.
const LEARNING_NS: u64 = 50_000_000;
/// A line that lowers the map by more while it learns shows that those before had waited, ns: it begins again.
const SETTLED_NS: i64 = 1_000_000;
/// A stamp that is further ahead of the loop's clock than this shows that the board's clock jumped, ns. A smaller lead is of
/// lines that all travelled slowly before: the map is lowered by it, and every age rises.
const JUMP_NS: i64 = 100_000_000;
/// After a longer pause the 32-bit stamp may have wrapped unseen (it does every 71.6 minutes): the map starts anew, ns.
const PAUSE_MAX_NS: u64 = 600_000_000_000;

/// Maps stamps to loop time by the running minimum of arrival − stamp: the line that travelled fastest tells the
/// clocks' offset. Between fast lines the minimum rises as the clocks may drift. A clock that jumps ahead by more than
/// 0.1 s, or back, is learned again: [`ClockMap::has_jumped`] until then.
///
/// ```
/// use moca_tactile::board::ClockMap;
///
/// let mut clock = ClockMap::default();
/// for i in 0..40u32 {
///     // The board counts from 5 s; lines arrive 1.2 ms after their stamp, or 3 ms late.
///     let late_ns = if i % 4 == 0 { 0 } else { 3_000_000 };
///     let arrival_ns = u64::from(i) * 4_000_000 + 1_200_000 + late_ns;
///     let read_ns = clock.loop_ns(5_000_000 + i * 4000, arrival_ns);
///     if let Some(read_ns) = read_ns {
///         // the drift that is allowed for is 10 us in 4 ms
///         assert!(read_ns.abs_diff(u64::from(i) * 4_000_000) < 40_000);
///     }
/// }
/// ```
#[derive(Clone, Copy, Debug, Default)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct ClockMap {
    state: Option<State>,
}

#[derive(Clone, Copy, Debug)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
struct State {
    stamp_us: u32,
    arrival_ns: u64,
    /// Stamps since the map began, unwrapped, ns.
    device_ns: u64,
    /// Least arrival − device so far, with drift, ns.
    offset_ns: i64,
    /// Lines since the map began or last had to begin again, and when the first of them arrived.
    lines: u32,
    since_ns: u64,
    learned: bool,
    jumped: bool,
}

impl ClockMap {
    /// Loop time, ns, at which the board took `stamp_us`, for a line that arrived at `arrival_ns`; never later than it
    /// can have been by more than the fastest line was slower than [`LEAST_TRANSPORT_NS`]. `None` while it learns.
    pub fn loop_ns(&mut self, stamp_us: u32, arrival_ns: u64) -> Option<u64> {
        let state = match self.state {
            Some(state) => state.next(stamp_us, arrival_ns),
            None => State::first(stamp_us, arrival_ns, false),
        };
        self.state = Some(state);
        let read_ns = state.device_ns.checked_add_signed(state.offset_ns)?.saturating_sub(LEAST_TRANSPORT_NS);
        state.learned.then_some(read_ns.min(arrival_ns))
    }

    /// Returns true if the board's clock has jumped and too few lines have come since to map it again.
    pub fn has_jumped(&self) -> bool {
        self.state.is_some_and(|state| state.jumped)
    }
}

impl State {
    const fn first(stamp_us: u32, arrival_ns: u64, jumped: bool) -> Self {
        // One wrap of room, so that a map never has to go below 0.
        let device_ns = 1 << 42;
        let offset_ns = difference(arrival_ns, device_ns);
        let since_ns = arrival_ns;
        Self { stamp_us, arrival_ns, device_ns, offset_ns, lines: 1, since_ns, learned: false, jumped }
    }

    fn next(self, stamp_us: u32, arrival_ns: u64) -> Self {
        let pause_ns = arrival_ns.saturating_sub(self.arrival_ns);
        if pause_ns > PAUSE_MAX_NS {
            return Self::first(stamp_us, arrival_ns, false);
        }
        let jumped = self.learned || self.jumped;
        let step_ns = u64::from(stamp_us.wrapping_sub(self.stamp_us)) * 1000;
        // A clock that went back looks like a long way ahead.
        if step_ns > 2 * PAUSE_MAX_NS {
            return Self::first(stamp_us, arrival_ns, jumped);
        }
        let device_ns = self.device_ns + step_ns;
        #[expect(
            clippy::cast_precision_loss,
            clippy::cast_possible_truncation,
            reason = "a thousandth of 20 minutes in ns"
        )]
        let drift_ns = (step_ns as f64 * DRIFT_MAX) as i64;
        let (drifted_ns, measured_ns) = (self.offset_ns + drift_ns, difference(arrival_ns, device_ns));
        let lead_ns = drifted_ns.saturating_sub(measured_ns);
        if self.learned && lead_ns > JUMP_NS {
            return Self::first(stamp_us, arrival_ns, true);
        }
        let again = !self.learned && lead_ns > SETTLED_NS;
        let (lines, since_ns) =
            if again { (1, arrival_ns) } else { (self.lines.saturating_add(1), self.since_ns) };
        let learned =
            self.learned || lines >= LEARNING_LINES && arrival_ns.saturating_sub(since_ns) >= LEARNING_NS;
        Self {
            stamp_us,
            arrival_ns,
            device_ns,
            offset_ns: drifted_ns.min(measured_ns),
            lines,
            since_ns,
            learned,
            jumped: self.jumped && !learned,
        }
    }
}

/// `a − b`; both are loop times, far below 2⁶³ ns.
const fn difference(a: u64, b: u64) -> i64 {
    a.wrapping_sub(b).cast_signed()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A board whose clock runs `rate` times the loop's, from `start_us`; line every 4 ms, lateness from `late_ns`.
    /// Largest errors of the map, early and late, ns.
    fn errors(rate: f64, start_us: u32, lines: u32, late_ns: impl Fn(u32) -> u64) -> (i64, i64) {
        let mut clock = ClockMap::default();
        let (mut early, mut late) = (0, 0);
        for i in 0..lines {
            let read_ns = 1_000_000_000 + u64::from(i) * 4_000_000;
            #[expect(
                clippy::cast_possible_truncation,
                clippy::cast_sign_loss,
                reason = "test times are short"
            )]
            let stamp_us = start_us.wrapping_add((f64::from(i) * 4000.0 * rate) as u32);
            let mapped = clock.loop_ns(stamp_us, read_ns + LEAST_TRANSPORT_NS + late_ns(i));
            if let Some(mapped) = mapped {
                let error = difference(mapped, read_ns);
                (early, late) = (early.min(error), late.max(error));
            }
        }
        (early, late)
    }

    #[test]
    fn specified_jitter_and_drift_leave_100_us_error() {
        for rate in [0.9975, 0.9999, 1.0, 1.0001, 1.0025] {
            let (early, late) = errors(rate, 7, 20_000, |i| u64::from(i * 7919 % 11) * 200_000);
            assert!(early > -300_000 && late < 300_000, "rate {rate}: {early} {late} ns");
        }
    }

    #[test]
    fn the_wrap_of_the_board_s_clock_changes_nothing() {
        let jitter = |i: u32| u64::from(i % 5) * 300_000;
        let before_the_wrap = errors(1.0, u32::MAX - 10_000_000, 20_000, jitter);
        assert_eq!(before_the_wrap, errors(1.0, 0, 20_000, jitter));
    }

    #[test]
    fn lines_that_waited_for_a_stalled_host_are_as_old_as_they_are() {
        let mut clock = ClockMap::default();
        for i in 0..100u32 {
            clock.loop_ns(i * 4000, u64::from(i) * 4_000_000 + LEAST_TRANSPORT_NS);
        }
        // 0.4 s in a buffer
        let read_ns = clock.loop_ns(400_000, 800_000_000).unwrap();
        assert!(read_ns.abs_diff(400_000_000) < 20_000, "{read_ns}");
    }

    /// A map of a board that sends a line every 4 ms, and when the last one arrived.
    fn learned() -> (ClockMap, u32, u64) {
        let mut clock = ClockMap::default();
        for i in 0..100u32 {
            clock.loop_ns(i * 4000, u64::from(i) * 4_000_000 + LEAST_TRANSPORT_NS);
        }
        (clock, 99 * 4000, 99 * 4_000_000 + LEAST_TRANSPORT_NS)
    }

    #[test]
    fn clock_that_jumps_is_not_mapped_until_its_lines_agree() {
        for (jump_us, jumps) in [(10_000_000, true), (-10_000_000, true), (-4001, true), (90_000, false)] {
            let (mut clock, stamp_us, arrival_ns) = learned();
            let after = stamp_us.wrapping_add_signed(4000 + jump_us);
            let mapped = clock.loop_ns(after, arrival_ns + 4_000_000);
            assert_eq!((clock.has_jumped(), mapped.is_none()), (jumps, jumps), "{jump_us} us");
            for i in 1..LEARNING_LINES {
                assert_eq!(clock.has_jumped(), jumps, "{jump_us} us, line {i}");
                clock.loop_ns(after + i * 4000, arrival_ns + 4_000_000 * u64::from(i + 1));
            }
            assert!(!clock.has_jumped(), "{jump_us} us: learned again");
        }
    }

    #[test]
    fn lines_of_one_burst_teach_nothing() {
        let mut clock = ClockMap::default();
        for i in 0..60u32 {
            assert_eq!(clock.loop_ns(i * 4000, 1_000_000_000), None, "line {i} had waited");
        }
        for i in 60..100u32 {
            let arrival_ns = 1_000_000_000 + u64::from(i - 59) * 4_000_000;
            if let Some(read_ns) = clock.loop_ns(i * 4000, arrival_ns) {
                assert!(i >= 60 + 12 && read_ns.abs_diff(arrival_ns - LEAST_TRANSPORT_NS) < 20_000);
            }
        }
        assert!(clock.loop_ns(400_000, 1_164_000_000).is_some());
    }

    #[test]
    fn a_board_that_restarted_is_learned_anew() {
        let mut clock = ClockMap::default();
        for i in 0..100u32 {
            clock.loop_ns(3_000_000_000 + i * 4000, u64::from(i) * 4_000_000 + LEAST_TRANSPORT_NS);
        }
        assert_eq!(clock.loop_ns(1000, 600_000_000), None);
        for i in 0..100u32 {
            let arrival_ns = 604_000_000 + u64::from(i) * 4_000_000;
            if let Some(read_ns) = clock.loop_ns(5000 + i * 4000, arrival_ns) {
                assert!(read_ns.abs_diff(arrival_ns - LEAST_TRANSPORT_NS) < 20_000);
            }
        }
    }
}
