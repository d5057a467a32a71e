//! Faults of chip and taxel: the values of a line change and it is printed again, so that it stays a good one.

use crate::inject::Random;
use crate::inject::cable_fault::CableFault;
use core::fmt::Write as _;
use moca_tactile::datastream::{ELECTRODES, FDAT_MAX, Line, MAX_COLUMNS, MAX_LINE_BYTES};
use moca_tactile::touchline::{self, Content, Flags};

/// Bytes of a line, spoiled or not.
pub(super) type LineBytes = heapless::Vec<u8, { MAX_LINE_BYTES + 32 }>;
/// The taxel (0 is T1) that the faults of one taxel strike.
pub const STRUCK_TAXEL: usize = 3;
/// A drifting taxel falls by a count in this time, ns.
const DRIFT_COUNT_NS: u64 = 100_000_000;

/// Values of each line as they were at first, and the faults that change them.
#[derive(Debug)]
pub(super) struct Values {
    fault: CableFault,
    at_ns: u64,
    random: Random,
    /// Values of the first stock frame after the strike, by line, for a chip that answers no more.
    first: [Option<heapless::Vec<i32, MAX_COLUMNS>>; 6],
    /// Change of FDAT in this stock frame: DIFF has to agree or the frame is merely a bad one.
    changed: [i32; MAX_COLUMNS],
    /// Values of the first data line and baseline line of our firmware, by chip.
    first_stamped: [[Option<[u16; ELECTRODES]>; 2]; touchline::BANKS],
}

impl Values {
    pub(super) const fn new(fault: CableFault, at_ns: u64, seed: u64) -> Self {
        Self {
            fault,
            at_ns,
            random: Random::new(seed),
            first: [const { None }; 6],
            changed: [0; MAX_COLUMNS],
            first_stamped: [[None; 2]; touchline::BANKS],
        }
    }

    const fn strikes(&self) -> bool {
        use CableFault as F;
        matches!(
            self.fault,
            F::Frozen
                | F::ChipReset
                | F::TaxelStuck
                | F::TaxelDead
                | F::TaxelSaturated
                | F::TaxelNoisy
                | F::TaxelDrifting
                | F::CommonMode
        )
    }

    /// Changes a line of DataStream.
    pub(super) fn spoil_stock(&mut self, line: &mut LineBytes, key: Line, now_ns: u64) {
        let Some(mut values) = parsed(&line[key.key().len()..]).filter(|_| self.strikes()) else { return };
        let place = Line::ALL.iter().position(|one| *one == key).unwrap_or(0);
        let first = self.first[place].get_or_insert_with(|| values.clone()).clone();
        match (self.fault, key) {
            (CableFault::Frozen, _) => values = first,
            (CableFault::ChipReset, _) => values.fill(0),
            (_, Line::Filtered) => {
                self.changed = [0; MAX_COLUMNS];
                for column in 0..values.len() {
                    let new = self.struck(column, values[column], first[column], now_ns);
                    self.changed[column] = new - values[column];
                    values[column] = new;
                }
            }
            (_, Line::Difference) => {
                for (value, changed) in values.iter_mut().zip(self.changed) {
                    *value -= changed;
                }
            }
            _ => {}
        }
        print(line, key, &values);
    }

    /// Changes what a line of our firmware says; `false` if it stays as it is.
    pub(super) fn spoil_stamped(&mut self, line: &mut touchline::Line, now_ns: u64) -> bool {
        if !self.strikes() {
            return false;
        }
        let is_data = matches!(line.content, Content::Data(_));
        let of_chip = self.first_stamped.get_mut(usize::from(line.bank));
        let Some(first) = of_chip.and_then(|first| first.get_mut(usize::from(is_data))) else { return false };
        let first = *first.get_or_insert(line.values);
        match (self.fault, line.content) {
            (CableFault::Frozen, _) => line.values = first,
            (CableFault::ChipReset, content) => {
                line.values = [0; ELECTRODES];
                if let Content::Data(flags) = content {
                    line.content = Content::Data(flags | Flags::CHIP_RESET);
                }
            }
            (_, Content::Data(_)) => {
                for electrode in 0..ELECTRODES {
                    // The faults of one taxel are of the board's own chip.
                    let column = usize::from(line.bank) * ELECTRODES + electrode;
                    let (value, first) = (i32::from(line.values[electrode]), i32::from(first[electrode]));
                    let new = self.struck(column, value, first, now_ns);
                    line.values[electrode] = u16::try_from(new.max(0)).unwrap_or(0).min(FDAT_MAX);
                }
            }
            (_, Content::Baseline { .. }) => return false,
        }
        true
    }

    fn struck(&mut self, column: usize, value: i32, first: i32, now_ns: u64) -> i32 {
        let one = column == STRUCK_TAXEL;
        let noise = i32::try_from(self.random.below(41)).unwrap_or(0) - 20;
        let drift = i32::try_from(now_ns.saturating_sub(self.at_ns) / DRIFT_COUNT_NS).unwrap_or(i32::MAX);
        match self.fault {
            CableFault::TaxelStuck if one => first,
            CableFault::TaxelDead if one => 950,
            CableFault::TaxelSaturated if one => 0,
            CableFault::TaxelNoisy if one => value + noise,
            CableFault::TaxelDrifting if one => value.saturating_sub(drift).max(1),
            CableFault::CommonMode if value > 0 => value - 12,
            _ => value,
        }
    }
}

fn parsed(text: &[u8]) -> Option<heapless::Vec<i32, MAX_COLUMNS>> {
    core::str::from_utf8(text).ok()?.split_ascii_whitespace().map(|word| word.parse().ok()).collect()
}

fn print(line: &mut LineBytes, key: Line, values: &[i32]) {
    line.clear();
    append(line, key.key());
    for (i, value) in values.iter().enumerate() {
        let mut word = heapless::String::<12>::new();
        let space = if i == 0 { "" } else { " " };
        // Twelve characters hold any value with its space.
        let _ = write!(word, "{space}{value}");
        append(line, word.as_bytes());
    }
    append(line, b"\r\n");
}

/// Appends bytes; those beyond the room are lost, as in a full buffer of the operating system.
pub(super) fn append<const N: usize>(line: &mut heapless::Vec<u8, N>, bytes: &[u8]) {
    let room = bytes.len().min(N - line.len());
    let _ = line.extend_from_slice(&bytes[..room]);
}
