//! Lines of our own firmware, chip by chip: sequence, stamp and flags to usable frames and faults.

use super::{ClockMap, FROZEN_AFTER_NS, FROZEN_FRAMES, SampledFrame};
use crate::datastream::ELECTRODES;
use crate::touchline::{BANKS, Content, Flags, Line};
use moca_msgs::Fault;

/// Shortest and longest time between two refreshes of a chip whose oscillator is 10 % off, ns.
const REFRESH_NS: [u64; 2] = [3_600_000, 4_400_000];
/// From the middle of the chip's window (four samples, 1 ms apart) to its refresh, ns: the least age of data.
const WINDOW_NS: u64 = 1_500_000;
/// A larger step of the sequence means that the board restarted, not that so many lines were lost.
const LOST_MAX: u16 = 10_000;

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
    sequence: Option<u16>,
    baseline: Option<[u16; ELECTRODES]>,
    /// Worst age of data when it is read, ns.
    age_ns: u64,
    last: Option<Last>,
    last_line_ns: u64,
    flags: Flags,
    /// Of the first line: an electrode without a plate may never reach its target.
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

/// What one good line gave.
pub(super) struct Taken {
    /// `None` if its data may not be used.
    pub(super) frame: Option<SampledFrame>,
    /// Data lines that never came before it.
    pub(super) lost: u16,
    /// Whether it shows a refresh of its own.
    pub(super) refresh: bool,
}

impl StampedLines {
    /// Takes a data line; `None` for a baseline. `used` are the board's electrodes that carry taxels.
    pub(super) fn take(&mut self, line: &Line, arrival_ns: u64, used: &[bool]) -> Option<Taken> {
        let read_ns = self.clock.loop_ns(line.device_us, arrival_ns);
        let bank = self.banks.get_mut(usize::from(line.bank))?;
        bank.last_line_ns = arrival_ns;
        let flags = match line.content {
            Content::Data(flags) => flags,
            Content::Baseline { age_tenths_ms } => {
                bank.baseline = Some(line.values);
                bank.age_ns = u64::from(age_tenths_ms) * 100_000;
                return None;
            }
        };
        let lost = bank.count(line.sequence);
        bank.flags = flags;
        let refresh = flags.is_new() && !flags.has(Flags::CONTINUES);
        let unusable = [Flags::BUS_FAULT, Flags::SETTLING, Flags::CHIP_RESET, Flags::OVER_CURRENT];
        let usable = !unusable.iter().any(|&flag| flags.has(flag));
        let frame = read_ns.filter(|_| usable).and_then(|read_ns| {
            let first = usize::from(line.bank) * ELECTRODES;
            bank.frame(line, flags, read_ns, arrival_ns, used.get(first..)?)
        });
        Some(Taken { frame, lost, refresh })
    }

    /// When the chip that has been silent longest last sent a line, ns; `None` before any did.
    pub(super) fn oldest_line_ns(&self) -> Option<u64> {
        self.seen().map(|bank| bank.last_line_ns).min()
    }

    /// What the lines' own flags, or data that does not change, say of the chips, the gravest first.
    pub(super) fn fault(&self) -> Option<Fault> {
        let flagged = |flag| self.seen().any(|bank| bank.flags.has(flag));
        if flagged(Flags::CHIP_RESET) {
            Some(Fault::BoardReset)
        } else if flagged(Flags::BUS_FAULT) || self.seen().any(Bank::frozen) {
            Some(Fault::BoardFrozen)
        } else if flagged(Flags::OVER_CURRENT)
            || self.seen().any(|bank| bank.flags.has(Flags::OUT_OF_RANGE) && !bank.out_of_range_at_first)
        {
            Some(Fault::BoardChip)
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
    /// Lines lost before the one with `sequence`.
    fn count(&mut self, sequence: u16) -> u16 {
        let lost = self.sequence.map_or(0, |last| sequence.wrapping_sub(last).wrapping_sub(1));
        self.sequence = Some(sequence);
        if lost < LOST_MAX { lost } else { 0 }
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
        if self.last.is_some_and(same) {
            self.identical = self.identical.saturating_add(1);
        } else {
            (self.identical, self.identical_since_ns) = (0, arrival_ns);
        }
        if self.last.is_none() {
            self.out_of_range_at_first = flags.has(Flags::OUT_OF_RANGE);
        }
        // Without a baseline a tare could not tell a hand; without the age nobody could tell how old this is.
        let baseline = self.baseline?;
        let sampled_at_ns = self.sampled_at_ns(flags, read_ns);
        self.last = Some(Last { fdat: line.values, sampled_at_ns });
        let waited_ns = self.age_ns.saturating_sub(WINDOW_NS) / 2;
        Some(SampledFrame {
            bank: line.bank,
            fdat: line.values,
            baseline,
            sampled_at_ns,
            expected_sample_ns: read_ns.saturating_sub(WINDOW_NS + waited_ns),
            complete_ns: arrival_ns,
        })
    }

    /// The earliest time at which data read at `read_ns` can have been sampled.
    fn sampled_at_ns(&self, flags: Flags, read_ns: u64) -> u64 {
        let by_age_ns = read_ns.saturating_sub(self.age_ns);
        let Some(last) = self.last else { return by_age_ns };
        let by_age_ns = if flags.has(Flags::CONTINUES) {
            // The refresh that the line before began to show: counted once.
            last.sampled_at_ns
        } else if flags.is_new() {
            by_age_ns
        } else {
            // Nothing changed: the chip refreshed to the same values, at latest one refresh ago.
            (last.sampled_at_ns + REFRESH_NS[0]).min(by_age_ns).max(by_age_ns.saturating_sub(REFRESH_NS[1]))
        };
        by_age_ns.max(last.sampled_at_ns)
    }
}
