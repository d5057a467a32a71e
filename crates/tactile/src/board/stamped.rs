//! Lines of our own firmware, chip by chip: sequence, stamp and flags to usable frames and faults.

use super::clock::LEARNING_LINES;
use super::{ClockMap, FROZEN_AFTER_NS, FROZEN_FRAMES, SampledFrame};
use crate::datastream::ELECTRODES;
use crate::touchline::{BANKS, Content, Flags, Line};
use moca_msgs::BoardFault;

/// Shortest and longest time between two refreshes of a chip whose oscillator is 10 % off, ns.
const REFRESH_NS: [u64; 2] = [3_600_000, 4_400_000];
/// From the middle of the chip's window (four samples, 1 ms apart) to its refresh, ns: the least age of data.
const WINDOW_NS: u64 = 1_500_000;
/// Shortest time between two reads of a chip, us: its registers alone take 0.7 ms on the bus.
const READ_LEAST_US: u32 = 700;
/// Without a line of baselines for this long, neither a hand at a tare nor the age of data can be told, ns. The firmware
/// sends one a second at latest.
const BASELINE_MAX_NS: u64 = 3_000_000_000;

/// Every chip of one board.
#[derive(Clone, Debug, Default)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub(super) struct StampedLines {
    clock: ClockMap,
    banks: [Bank; BANKS],
}

#[derive(Clone, Copy, Debug, Default)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
struct Bank {
    /// Number and stamp of the last data line.
    sequence: Option<(u16, u32)>,
    /// Lines to come that are not used, because the numbers jumped.
    distrusted: u32,
    baseline: Option<[u16; ELECTRODES]>,
    baseline_ns: u64,
    /// Worst age of data when it is read, ns.
    age_ns: u64,
    last: Option<Last>,
    last_line_ns: u64,
    flags: Flags,
    /// Out-of-range flag of the first line: an electrode without a plate may never reach its target.
    out_of_range_at_first: bool,
    identical: u32,
    identical_since_ns: u64,
}

#[derive(Clone, Copy, Debug)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
struct Last {
    fdat: [u16; ELECTRODES],
    sampled_at_ns: u64,
}

/// Meaning of a line's number.
enum Step {
    /// This many lines before it never came.
    Lost(u16),
    /// It has come already.
    Repeated,
    /// More lines are missing than the board can have sent: it restarted, or its lines are not its own.
    Jumped,
}

/// A data line that has come already.
pub(super) struct Repeated;

/// Contents of one good line.
pub(super) struct Taken {
    /// `None` if its data may not be used.
    pub(super) frame: Option<SampledFrame>,
    /// Data lines that never came before it.
    pub(super) lost: u16,
    /// True if it shows a refresh of its own.
    pub(super) refresh: bool,
}

impl StampedLines {
    /// Takes a line; `None` for a baseline. `used` are the board's electrodes that carry taxels.
    ///
    /// # Errors
    /// The line has come already.
    pub(super) fn take(
        &mut self,
        line: &Line,
        arrival_ns: u64,
        used: &[bool],
    ) -> Result<Option<Taken>, Repeated> {
        let bank = self.banks.get_mut(usize::from(line.bank)).ok_or(Repeated)?;
        let flags = match line.content {
            Content::Data(flags) => flags,
            Content::Baseline { age_tenths_ms } => {
                self.clock.loop_ns(line.device_us, arrival_ns);
                (bank.baseline, bank.baseline_ns) = (Some(line.values), arrival_ns);
                bank.age_ns = (u64::from(age_tenths_ms) * 100_000).max(WINDOW_NS);
                return Ok(None);
            }
        };
        let lost = match bank.count(line.sequence, line.device_us) {
            Step::Repeated => return Err(Repeated),
            Step::Lost(lost) => lost,
            Step::Jumped => {
                bank.distrusted = LEARNING_LINES;
                0
            }
        };
        let read_ns = self.clock.loop_ns(line.device_us, arrival_ns);
        bank.last_line_ns = arrival_ns;
        bank.flags = flags;
        let refresh = flags.is_new() && !flags.has(Flags::CONTINUES);
        let unusable = [Flags::BUS_FAULT, Flags::SETTLING, Flags::CHIP_RESET, Flags::OVER_CURRENT];
        let usable = !unusable.iter().any(|&flag| flags.has(flag)) && bank.distrusted == 0;
        bank.distrusted = bank.distrusted.saturating_sub(1);
        let frame = read_ns.filter(|_| usable).and_then(|read_ns| {
            let first = usize::from(line.bank) * ELECTRODES;
            bank.frame(line, flags, read_ns, arrival_ns, used.get(first..)?)
        });
        Ok(Some(Taken { frame, lost, refresh }))
    }

    /// When the chip that has been silent longest last sent a line, ns; `None` before any did.
    pub(super) fn oldest_line_ns(&self) -> Option<u64> {
        self.seen().map(|bank| bank.last_line_ns).min()
    }

    /// Returns the most severe fault of the chips, from the lines' own flags, stamps and numbers, or from data that does not
    /// change.
    pub(super) fn fault(&self) -> Option<BoardFault> {
        let flagged = |flag| self.seen().any(|bank| bank.flags.has(flag));
        let jumped = self.clock.has_jumped() || self.seen().any(|bank| bank.distrusted > 0);
        if flagged(Flags::CHIP_RESET) || jumped {
            Some(BoardFault::Reset)
        } else if flagged(Flags::BUS_FAULT) || self.seen().any(Bank::frozen) {
            Some(BoardFault::Frozen)
        } else if flagged(Flags::OVER_CURRENT)
            || self.seen().any(|bank| bank.flags.has(Flags::OUT_OF_RANGE) && !bank.out_of_range_at_first)
        {
            Some(BoardFault::Chip)
        } else {
            None
        }
    }

    /// Flags of every chip's last line together.
    pub(super) fn flags(&self) -> Flags {
        self.seen().fold(Flags::default(), |all, bank| all | bank.flags)
    }

    /// Chips that have sent a line.
    pub(super) fn chips(&self) -> usize {
        self.seen().count()
    }

    fn seen(&self) -> impl Iterator<Item = &Bank> {
        self.banks.iter().filter(|bank| bank.sequence.is_some())
    }
}

impl Bank {
    /// Judges the number of a data line that was read at `device_us` of the board's clock.
    fn count(&mut self, sequence: u16, device_us: u32) -> Step {
        let Some((last, last_us)) = self.sequence.replace((sequence, device_us)) else {
            return Step::Lost(0);
        };
        let lost = match sequence.wrapping_sub(last).checked_sub(1) {
            None => return Step::Repeated,
            Some(lost) => lost,
        };
        let credible = device_us.wrapping_sub(last_us) / READ_LEAST_US;
        if u32::from(lost) <= credible { Step::Lost(lost) } else { Step::Jumped }
    }

    fn frozen(&self) -> bool {
        self.identical + 1 >= FROZEN_FRAMES
            && self.last_line_ns.saturating_sub(self.identical_since_ns) >= FROZEN_AFTER_NS
    }

    fn frame(
        &mut self,
        line: &Line,
        flags: Flags,
        read_ns: u64,
        arrival_ns: u64,
        used: &[bool],
    ) -> Option<SampledFrame> {
        let same = |last: Last| (0..ELECTRODES).all(|e| !used[e] || last.fdat[e] == line.values[e]);
        // Data that is called new and is what it was may be what it was: one refresh older.
        let repeats = self.last.is_some_and(|last| last.fdat == line.values);
        if self.last.is_some_and(same) {
            self.identical = self.identical.saturating_add(1);
        } else {
            (self.identical, self.identical_since_ns) = (0, arrival_ns);
        }
        if self.last.is_none() {
            self.out_of_range_at_first = flags.has(Flags::OUT_OF_RANGE);
        }
        // Without a baseline a tare could not tell a hand; without the age nobody could tell how old this is.
        let recent = arrival_ns.saturating_sub(self.baseline_ns) <= BASELINE_MAX_NS;
        let baseline = self.baseline.filter(|_| recent)?;
        let waited_ns = self.age_ns.saturating_sub(WINDOW_NS) / 2;
        let expected_sample_ns = read_ns.saturating_sub(WINDOW_NS + waited_ns);
        // The line before may have been dated by a clock map that has since learned better: no bound is later than what is expected.
        let sampled_at_ns = self.sampled_at_ns(flags, repeats, read_ns).min(expected_sample_ns);
        self.last = Some(Last { fdat: line.values, sampled_at_ns });
        Some(SampledFrame {
            bank: line.bank,
            fdat: line.values,
            baseline,
            sampled_at_ns,
            expected_sample_ns,
            complete_ns: arrival_ns,
        })
    }

    /// The earliest time at which data read at `read_ns` can have been sampled.
    fn sampled_at_ns(&self, flags: Flags, repeats: bool, read_ns: u64) -> u64 {
        let by_age_ns = read_ns.saturating_sub(self.age_ns);
        let Some(last) = self.last else { return by_age_ns };
        let by_age_ns = if flags.has(Flags::CONTINUES) {
            // The refresh that the line before began to show: counted once.
            last.sampled_at_ns
        } else if flags.is_new() && repeats {
            by_age_ns.saturating_sub(REFRESH_NS[1])
        } else if flags.is_new() {
            by_age_ns
        } else {
            // Nothing changed: the chip refreshed to the same values, at latest one refresh ago.
            (last.sampled_at_ns + REFRESH_NS[0]).min(by_age_ns).max(by_age_ns.saturating_sub(REFRESH_NS[1]))
        };
        by_age_ns.max(last.sampled_at_ns)
    }
}
