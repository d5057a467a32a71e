//! Lossless columns of numbers: what a block of ticks was given, in few bytes after a general compressor.
//!
//! A measured quantity changes little from tick to tick, so a column stores how many representable numbers lie between
//! each value and what its predecessors predict: the high bytes of these distances are zero. They are stored plane by
//! plane, highest bytes first, so that zeros lie beside zeros.
//!
//! ```
//! use moca_telemetry::log::columns::{ColumnReader, ColumnWriter};
//! let angle_rad: Vec<f64> = (0..250).map(|tick| (f64::from(tick) * 1e-3).sin()).collect();
//! let mut writer = ColumnWriter::default();
//! writer.integers(&[5, 6, 7]);
//! writer.numbers(&angle_rad, None);
//! let bytes = writer.finish();
//! let mut reader = ColumnReader::new(&bytes);
//! assert_eq!(reader.integers().unwrap(), [5, 6, 7]);
//! assert_eq!(reader.numbers(None).unwrap(), angle_rad);
//! ```

/// Most values of one column; a reader refuses more.
const MAX_ROWS: usize = 1 << 16;

/// How a value is predicted.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Guess {
    /// As the one before.
    Same = 0,
    /// On the line through the two before.
    Line = 1,
    /// On the parabola through the three before.
    Parabola = 2,
    /// The one before, moved on at its rate.
    Rate = 3,
    /// The same, rounded to single precision.
    RateSingle = 4,
}

impl Guess {
    const ALL: [Self; 5] = [Self::Same, Self::Line, Self::Parabola, Self::Rate, Self::RateSingle];

    fn of(self, before: &[f64], rate: Option<&Rate<'_>>) -> f64 {
        let at = |back: usize| before.len().checked_sub(back).map_or(0.0, |i| before[i]);
        let moved = || rate.map_or(0.0, |rate| rate.foretell(at(1), before.len()));
        match self {
            Self::Same => at(1),
            Self::Line => 2.0 * at(1) - at(2),
            Self::Parabola => 3.0 * (at(1) - at(2)) + at(3),
            Self::Rate => moved(),
            #[expect(
                clippy::cast_possible_truncation,
                reason = "to the nearest single, as the plant's door does"
            )]
            Self::RateSingle => f64::from(moved() as f32),
        }
    }
}

/// What a column changes by: its rate per second, and the time since the row before, s.
#[derive(Clone, Copy, Debug)]
pub struct Rate<'a> {
    /// Rate in each row.
    pub per_s: &'a [f64],
    /// Time since the row before, s.
    pub step_s: &'a [f64],
}

impl Rate<'_> {
    /// A semi-implicit Euler step, as a simulation makes it.
    fn foretell(&self, before: f64, row: usize) -> f64 {
        let at = |values: &[f64]| values.get(row).copied().unwrap_or(0.0);
        before + at(self.step_s) * at(self.per_s)
    }
}

/// Writes columns one after the other.
#[derive(Clone, Debug, Default)]
pub struct ColumnWriter {
    bytes: Vec<u8>,
}

impl ColumnWriter {
    /// A column of counts or times, whose steps are nearly equal.
    pub fn integers(&mut self, values: &[u64]) {
        self.count(values.len() as u64);
        let (mut last, mut step) = (0_u64, 0_u64);
        for &value in values {
            let next = value.wrapping_sub(last);
            self.count(zigzag(next.wrapping_sub(step)));
            (last, step) = (value, next);
        }
    }

    /// A column of numbers, NaN and infinity included; `rate` may help to predict it.
    pub fn numbers(&mut self, values: &[f64], rate: Option<Rate<'_>>) {
        let distances = |guess: Guess| -> Vec<u64> {
            let guessed = (0..values.len()).map(|row| guess.of(&values[..row], rate.as_ref()));
            let pairs = values.iter().zip(guessed);
            pairs.map(|(value, guessed)| zigzag(value.to_bits().wrapping_sub(guessed.to_bits()))).collect()
        };
        let bits = |distances: &Vec<u64>| -> u64 {
            distances.iter().map(|distance| u64::from(u64::BITS - distance.leading_zeros())).sum()
        };
        let usable = if rate.is_some() { &Guess::ALL[..] } else { &Guess::ALL[..3] };
        let best = usable.iter().map(|guess| (*guess, distances(*guess))).min_by_key(|(_, d)| bits(d));
        let (guess, distances) = best.unwrap_or((Guess::Same, Vec::new()));
        self.count(values.len() as u64);
        self.bytes.push(guess as u8);
        for plane in 0..8 {
            self.bytes.extend(distances.iter().map(|distance| distance.to_be_bytes()[plane]));
        }
    }

    /// Bytes as they are.
    pub fn blob(&mut self, bytes: &[u8]) {
        self.count(bytes.len() as u64);
        self.bytes.extend_from_slice(bytes);
    }

    /// All columns.
    pub fn finish(self) -> Vec<u8> {
        self.bytes
    }

    /// Seven bits a byte, lowest first.
    fn count(&mut self, mut value: u64) {
        while value >= 0x80 {
            self.bytes.push(value.to_le_bytes()[0] | 0x80);
            value >>= 7;
        }
        self.bytes.push(value.to_le_bytes()[0]);
    }
}

/// Columns that are none: cut, damaged, or written by something else.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("columns of numbers are damaged")]
pub struct DamagedColumns;

/// Reads columns in the order in which they were written.
#[derive(Clone, Debug)]
pub struct ColumnReader<'a> {
    bytes: &'a [u8],
}

impl<'a> ColumnReader<'a> {
    /// Over what [`ColumnWriter::finish`] gave.
    pub const fn new(bytes: &'a [u8]) -> Self {
        Self { bytes }
    }

    /// The next column of integers.
    ///
    /// # Errors
    /// Damage; no length in the bytes makes this allocate more than a few times their size.
    pub fn integers(&mut self) -> Result<Vec<u64>, DamagedColumns> {
        // Each takes a byte at least.
        let rows = self.rows(1)?;
        let (mut last, mut step) = (0_u64, 0_u64);
        let mut values = Vec::with_capacity(rows);
        for _ in 0..rows {
            step = step.wrapping_add(unzigzag(self.count()?));
            last = last.wrapping_add(step);
            values.push(last);
        }
        Ok(values)
    }

    /// The next column of numbers; `rate` as it was written with.
    ///
    /// # Errors
    /// As for [`Self::integers`].
    pub fn numbers(&mut self, rate: Option<Rate<'_>>) -> Result<Vec<f64>, DamagedColumns> {
        let rows = self.rows(8)?;
        let guess = *self.take(1)?.first().ok_or(DamagedColumns)?;
        let guess = Guess::ALL.into_iter().find(|known| *known as u8 == guess).ok_or(DamagedColumns)?;
        let planes = self.take(8 * rows)?;
        let mut values = Vec::with_capacity(rows);
        for row in 0..rows {
            let distance = std::array::from_fn(|plane| planes[plane * rows + row]);
            let guessed = guess.of(&values, rate.as_ref()).to_bits();
            values.push(f64::from_bits(guessed.wrapping_add(unzigzag(u64::from_be_bytes(distance)))));
        }
        Ok(values)
    }

    /// The next bytes.
    ///
    /// # Errors
    /// As for [`Self::integers`].
    pub fn blob(&mut self) -> Result<&'a [u8], DamagedColumns> {
        let length = usize::try_from(self.count()?).map_err(|_| DamagedColumns)?;
        self.take(length)
    }

    /// A number of rows, each of at least so many bytes, that these bytes can hold.
    fn rows(&mut self, bytes_each: usize) -> Result<usize, DamagedColumns> {
        let rows = usize::try_from(self.count()?).map_err(|_| DamagedColumns)?;
        if rows > MAX_ROWS || rows * bytes_each > self.bytes.len() { Err(DamagedColumns) } else { Ok(rows) }
    }

    fn count(&mut self) -> Result<u64, DamagedColumns> {
        let mut value = 0;
        for shift in (0..u64::BITS).step_by(7) {
            let byte = *self.take(1)?.first().ok_or(DamagedColumns)?;
            value |= u64::from(byte & 0x7f) << shift;
            if byte < 0x80 {
                return Ok(value);
            }
        }
        Err(DamagedColumns)
    }

    fn take(&mut self, length: usize) -> Result<&'a [u8], DamagedColumns> {
        let (taken, rest) = self.bytes.split_at_checked(length).ok_or(DamagedColumns)?;
        self.bytes = rest;
        Ok(taken)
    }
}

/// Small distances of either sign to small numbers.
const fn zigzag(distance: u64) -> u64 {
    (distance << 1) ^ (distance >> 63).wrapping_neg()
}

const fn unzigzag(number: u64) -> u64 {
    (number >> 1) ^ (number & 1).wrapping_neg()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_bit_of_every_number_comes_back() {
        let odd =
            [0.0, -0.0, 1.0, f64::NAN, f64::from_bits(0x7ff8_0000_0000_0123), f64::INFINITY, -1e308, 5e-324];
        let per_s: Vec<f64> = (0..odd.len()).map(|i| i as f64).collect();
        let step_s = vec![1e-3; odd.len()];
        for rate in [None, Some(Rate { per_s: &per_s, step_s: &step_s })] {
            let mut writer = ColumnWriter::default();
            writer.numbers(&odd, rate);
            writer.integers(&[0, u64::MAX, 1, u64::MAX / 2]);
            writer.blob(b"bytes");
            writer.numbers(&[], rate);
            let bytes = writer.finish();
            let mut reader = ColumnReader::new(&bytes);
            let back = reader.numbers(rate).unwrap();
            assert!(back.iter().map(|v| v.to_bits()).eq(odd.iter().map(|v| v.to_bits())));
            assert_eq!(reader.integers().unwrap(), [0, u64::MAX, 1, u64::MAX / 2]);
            assert_eq!(reader.blob().unwrap(), b"bytes");
            assert!(reader.numbers(rate).unwrap().is_empty());
        }
    }

    #[test]
    fn an_angle_that_its_rate_foretells_costs_nothing() {
        let per_s: Vec<f64> = (0..250).map(|tick| (f64::from(tick) * 0.01).cos()).collect();
        let step_s = vec![1e-3; 250];
        for single in [false, true] {
            let mut angle = vec![0.3_f32.into()];
            for row in 1..250 {
                let next: f64 = angle[row - 1] + step_s[row] * per_s[row];
                #[expect(clippy::cast_possible_truncation, reason = "rounding to f32 is what is tested")]
                let rounded = f64::from(next as f32);
                angle.push(if single { rounded } else { next });
            }
            let mut writer = ColumnWriter::default();
            writer.numbers(&angle, Some(Rate { per_s: &per_s, step_s: &step_s }));
            let bytes = writer.finish();
            // Length, guess, and the planes of the first value only.
            assert!(bytes.iter().filter(|byte| **byte != 0).count() < 12, "single {single}: {bytes:?}");
        }
    }

    #[test]
    fn damage_is_refused_and_allocates_nothing_large() {
        let mut writer = ColumnWriter::default();
        writer.integers(&[1, 2, 3]);
        writer.numbers(&[1.0, 2.0], None);
        writer.blob(b"xyz");
        let whole = writer.finish();
        for end in 0..whole.len() {
            let mut reader = ColumnReader::new(&whole[..end]);
            let read = reader.integers().and_then(|_| reader.numbers(None)).and_then(|_| reader.blob());
            assert_eq!(read, Err(DamagedColumns), "cut at {end}");
        }
        let huge = [0xff, 0xff, 0xff, 0xff, 0xff, 0xff, 0xff, 0xff, 0xff, 0x01, 0, 0];
        assert_eq!(ColumnReader::new(&huge).integers(), Err(DamagedColumns));
        assert_eq!(ColumnReader::new(&huge).numbers(None), Err(DamagedColumns));
        assert_eq!(ColumnReader::new(&huge).blob(), Err(DamagedColumns));
        assert_eq!(ColumnReader::new(&[0xff; 12]).integers(), Err(DamagedColumns));
    }
}
