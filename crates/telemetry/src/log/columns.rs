//! Lossless columns of numbers: what a block of ticks was given, in few bytes after a general compressor.
//!
//! A measured quantity changes little from tick to tick, so a column stores how many representable numbers lie between each
//! value and what its predecessors predict: the high bytes of these distances are zero. They are stored plane by plane,
//! highest bytes first, without the planes that are all zero, so that small bytes lie beside small ones. Numbers that are
//! all multiples of one power of two, as a rounded measurement is, or whole nanoseconds in seconds, are counted in it: near
//! zero, where doubles lie close, the distances stay small.
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
const MAX_ROWS: usize = 1 << 12;

/// Prediction of a value.
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
    /// Prediction by a rate, rounded to single precision.
    RateSingle = 4,
    /// On the cubic through the four before.
    Cubic = 5,
    /// On the polynomial through the five before.
    Quartic = 6,
    /// On the polynomial through the six before.
    Quintic = 7,
}

impl Guess {
    /// Predictions without a rate, ordered by the number of earlier values.
    const PLAIN: [Self; 6] =
        [Self::Same, Self::Line, Self::Parabola, Self::Cubic, Self::Quartic, Self::Quintic];
    const OF_INTEGERS: [Self; 2] = [Self::Same, Self::Line];
    const ALL: [Self; 8] = [
        Self::Same,
        Self::Line,
        Self::Parabola,
        Self::Rate,
        Self::RateSingle,
        Self::Cubic,
        Self::Quartic,
        Self::Quintic,
    ];

    fn of(self, before: &[f64], rate: Option<&Rate<'_>>) -> f64 {
        let moved = || rate.map_or(0.0, |rate| rate.foretell(last::<1>(before)[0], before.len()));
        match self {
            Self::Same => same(last(before)),
            Self::Line => line(last(before)),
            Self::Parabola => parabola(last(before)),
            // Until there are as many before, as there are.
            Self::Cubic | Self::Quartic | Self::Quintic if before.len() < self.needs() => {
                parabola(last(before))
            }
            Self::Cubic => cubic(last(before)),
            Self::Quartic => quartic(last(before)),
            Self::Quintic => quintic(last(before)),
            Self::Rate => moved(),
            Self::RateSingle => single(moved()),
        }
    }
}

/// The last values, the latest at the end; 0 where there are none.
fn last<const N: usize>(values: &[f64]) -> [f64; N] {
    let mut found = [0.0; N];
    let some = values.len().min(N);
    found[N - some..].copy_from_slice(&values[values.len() - some..]);
    found
}

const fn same([a]: [f64; 1]) -> f64 {
    a
}

const fn line([b, a]: [f64; 2]) -> f64 {
    2.0 * a - b
}

const fn parabola([c, b, a]: [f64; 3]) -> f64 {
    3.0 * (a - b) + c
}

const fn cubic([d, c, b, a]: [f64; 4]) -> f64 {
    4.0 * (a + c) - 6.0 * b - d
}

const fn quartic([e, d, c, b, a]: [f64; 5]) -> f64 {
    5.0 * (a - d) - 10.0 * (b - c) + e
}

const fn quintic([f, e, d, c, b, a]: [f64; 6]) -> f64 {
    6.0 * (a + e) - 15.0 * (b + d) + 20.0 * c - f
}

#[expect(clippy::cast_possible_truncation, reason = "to the nearest single")]
const fn single(value: f64) -> f64 {
    (value as f32) as f64
}

impl Guess {
    /// Returns the number of earlier values that it uses.
    const fn needs(self) -> usize {
        match self {
            Self::Same | Self::Rate | Self::RateSingle => 1,
            Self::Line => 2,
            Self::Parabola => 3,
            Self::Cubic => 4,
            Self::Quartic => 5,
            Self::Quintic => 6,
        }
    }

    /// Predicts counts, exactly; with fewer earlier values it uses those that exist.
    fn of_counts(self, before: &[i64]) -> i64 {
        const BINOMIAL: [[i64; 6]; 6] = [
            [1, 0, 0, 0, 0, 0],
            [2, -1, 0, 0, 0, 0],
            [3, -3, 1, 0, 0, 0],
            [4, -6, 4, -1, 0, 0],
            [5, -10, 10, -5, 1, 0],
            [6, -15, 20, -15, 6, -1],
        ];
        let Some(row) = self.needs().min(before.len()).checked_sub(1) else { return 0 };
        let terms = before.iter().rev().zip(BINOMIAL[row]);
        terms.fold(0, |sum: i64, (value, factor)| sum.wrapping_add(value.wrapping_mul(factor)))
    }
}

/// Numbers that are counts of one unit.
struct Grid {
    /// Halvings of 1 that make the unit, or [`NANO`].
    halvings: u8,
    counts: Vec<i64>,
}

/// Mark of a column of counts, with the guess's number.
const GRID: u8 = 0x80;
/// Finest unit, as halvings of 1, and largest count.
const HALVINGS_MAX: u8 = 40;
const COUNT_MAX: f64 = 4_503_599_627_370_496.0;
/// In place of halvings: the unit is a billionth, as of a time in s that was whole ns.
const NANO: u8 = 0xff;

impl Grid {
    /// The coarsest on which every value lies, to the bit.
    fn of(values: &[f64]) -> Option<Self> {
        let mut halvings = 0;
        for value in values {
            while !on_grid(*value, halvings) {
                halvings += 1;
                if halvings > HALVINGS_MAX || !value.is_finite() {
                    return Self::counted_in(NANO, values);
                }
            }
        }
        // A finer unit than the first values asked for: all of them lie on it.
        Self::counted_in(halvings, values)
    }

    fn counted_in(halvings: u8, values: &[f64]) -> Option<Self> {
        let counts = || values.iter().map(|value| count_of(*value, halvings)).collect();
        values.iter().all(|value| on_grid(*value, halvings)).then(|| Self { halvings, counts: counts() })
    }
}

/// 1, halved so often.
const fn unit(halvings: u8) -> f64 {
    f64::from_bits((1023 - halvings as u64) << 52)
}

#[expect(clippy::cast_possible_truncation, reason = "below 2^52 where it counts")]
fn count_of(value: f64, halvings: u8) -> i64 {
    if halvings == NANO { (value * 1e9).round() as i64 } else { (value / unit(halvings)) as i64 }
}

#[expect(clippy::cast_precision_loss, reason = "below 2^52")]
fn value_of(count: i64, halvings: u8) -> f64 {
    if halvings == NANO { count as f64 / 1e9 } else { count as f64 * unit(halvings) }
}

fn on_grid(value: f64, halvings: u8) -> bool {
    let count = count_of(value, halvings);
    // What has no such count saturates.
    value_of(count, halvings).to_bits() == value.to_bits() && value_of(count, 0).abs() < COUNT_MAX
}

/// Rate of a column per second, and the time since the row before, s.
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

/// Form of a column whose distances have the fewest bits.
#[derive(Clone, Debug, Default)]
struct Cheapest {
    form: [u8; 2],
    /// Bits of its distances; `u64::MAX` before the first form.
    bits: u64,
    distances: Vec<u64>,
    /// Distances of the form that is tried.
    tried: Vec<u64>,
}

impl Cheapest {
    /// Begins a column.
    fn begin(&mut self) {
        self.bits = u64::MAX;
        self.distances.clear();
    }

    /// Tries a form, up to where it has as many bits as the cheapest.
    fn offer(&mut self, form: [u8; 2], distances: impl Iterator<Item = u64>) {
        let mut bits = 0;
        self.tried.clear();
        for distance in distances {
            bits += u64::from(u64::BITS - distance.leading_zeros());
            self.tried.push(distance);
            if bits >= self.bits {
                return;
            }
        }
        if bits < self.bits {
            (self.form, self.bits) = (form, bits);
            std::mem::swap(&mut self.distances, &mut self.tried);
        }
    }

    /// Tries a prediction from the `N` values before each.
    fn offer_guess<const N: usize>(&mut self, values: &[f64], guess: Guess, of: impl Fn([f64; N]) -> f64) {
        let head =
            values.iter().take(N).enumerate().map(|(row, value)| (value, guess.of(&values[..row], None)));
        let rest = values.iter().skip(N).zip(values.windows(N));
        let rest = rest.map(|(value, before)| (value, of(last(before))));
        self.offer([guess as u8, 0], head.chain(rest).map(|(value, guessed)| distance(*value, guessed)));
    }

    fn offer_numbers(&mut self, values: &[f64], guess: Guess, rate: Option<&Rate<'_>>) {
        let rated = |rounded: fn(f64) -> f64| {
            let before = [0.0].iter().chain(values);
            values.iter().zip(before).enumerate().map(move |(row, (value, before))| {
                let guessed = rate.map_or(0.0, |rate| rate.foretell(*before, row));
                distance(*value, rounded(guessed))
            })
        };
        match guess {
            Guess::Same => self.offer_guess(values, guess, same),
            Guess::Line => self.offer_guess(values, guess, line),
            Guess::Parabola => self.offer_guess(values, guess, parabola),
            Guess::Cubic => self.offer_guess(values, guess, cubic),
            Guess::Quartic => self.offer_guess(values, guess, quartic),
            Guess::Quintic => self.offer_guess(values, guess, quintic),
            Guess::Rate => self.offer([guess as u8, 0], rated(|value| value)),
            Guess::RateSingle => self.offer([guess as u8, 0], rated(single)),
        }
    }

    /// Tries predictions of counts, each from one more count before than the last.
    fn offer_counts(&mut self, mut counts: Vec<i64>, forms: impl Iterator<Item = [u8; 2]>) {
        for (order, form) in (1..).zip(forms) {
            // Rows that have fewer before them are foretold from those.
            for row in (order..counts.len()).rev() {
                counts[row] = counts[row].wrapping_sub(counts[row - 1]);
            }
            self.offer(form, counts.iter().map(|count| zigzag(count.cast_unsigned())));
        }
    }
}

/// Representable numbers between a value and its prediction.
const fn distance(value: f64, guessed: f64) -> u64 {
    zigzag(value.to_bits().wrapping_sub(guessed.to_bits()))
}

/// Writes columns one after the other.
#[derive(Clone, Debug, Default)]
pub struct ColumnWriter {
    bytes: Vec<u8>,
    cheapest: Cheapest,
}

impl ColumnWriter {
    /// A column of counts or times: those that stay or go on in equal steps cost nothing.
    pub fn integers(&mut self, values: &[u64]) {
        let counts = values.iter().map(|value| value.cast_signed()).collect();
        self.cheapest.begin();
        self.cheapest.offer_counts(counts, Guess::OF_INTEGERS.iter().map(|guess| [*guess as u8, 0]));
        self.put(values.len(), 1);
    }

    /// A column of numbers, NaN and infinity included; `rate` may help to predict it.
    pub fn numbers(&mut self, values: &[f64], rate: Option<Rate<'_>>) {
        let usable = if rate.is_some() { &Guess::ALL[..] } else { &Guess::PLAIN[..] };
        self.cheapest.begin();
        for guess in usable {
            self.cheapest.offer_numbers(values, *guess, rate.as_ref());
        }
        if let Some(Grid { halvings, counts }) = Grid::of(values) {
            let form = |guess: &Guess| [GRID | *guess as u8, halvings];
            self.cheapest.offer_counts(counts, Guess::PLAIN.iter().map(form));
        }
        self.put(values.len(), if self.cheapest.form[0] & GRID == 0 { 1 } else { 2 });
    }

    /// Writes the cheapest form: as many bytes of its name, number of planes, then those planes.
    fn put(&mut self, rows: usize, name: usize) {
        self.count(rows as u64);
        let Cheapest { form, distances, .. } = &self.cheapest;
        self.bytes.extend_from_slice(&form[..name]);
        let widest = distances.iter().fold(0, |all, distance| all | distance);
        let unused = widest.leading_zeros() as usize / 8;
        self.bytes.push((8 - unused).to_le_bytes()[0]);
        for plane in unused..8 {
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

    fn count(&mut self, value: u64) {
        varint(&mut self.bytes, value);
    }
}

/// Appends a number with seven bits a byte, lowest first.
pub(super) fn varint(to: &mut Vec<u8>, mut value: u64) {
    while value >= 0x80 {
        to.push(value.to_le_bytes()[0] | 0x80);
        value >>= 7;
    }
    to.push(value.to_le_bytes()[0]);
}

/// Truncated or corrupt column data, or data of another writer.
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
    /// Damage; no length in the bytes makes this allocate more than a few times their size, or 32 KiB.
    pub fn integers(&mut self) -> Result<Vec<u64>, DamagedColumns> {
        let rows = self.rows()?;
        let form = *self.take(1)?.first().ok_or(DamagedColumns)?;
        let guess =
            Guess::OF_INTEGERS.into_iter().find(|known| *known as u8 == form).ok_or(DamagedColumns)?;
        Ok(self.counts(rows, guess)?.into_iter().map(i64::cast_unsigned).collect())
    }

    fn counts(&mut self, rows: usize, guess: Guess) -> Result<Vec<i64>, DamagedColumns> {
        let mut counts: Vec<i64> = Vec::with_capacity(rows);
        for distance in self.distances(rows)? {
            counts.push(guess.of_counts(&counts).wrapping_add(distance.cast_signed()));
        }
        Ok(counts)
    }

    /// The next column of numbers; `rate` as it was written with.
    ///
    /// # Errors
    /// As for [`Self::integers`].
    pub fn numbers(&mut self, rate: Option<Rate<'_>>) -> Result<Vec<f64>, DamagedColumns> {
        let rows = self.rows()?;
        let form = *self.take(1)?.first().ok_or(DamagedColumns)?;
        let guess =
            Guess::ALL.into_iter().find(|known| *known as u8 == form & !GRID).ok_or(DamagedColumns)?;
        if form & GRID != 0 {
            let known = |halvings: &&u8| **halvings <= HALVINGS_MAX || **halvings == NANO;
            let halvings = *self.take(1)?.first().filter(known).ok_or(DamagedColumns)?;
            let counts = self.counts(rows, guess)?;
            return Ok(counts.into_iter().map(|count| value_of(count, halvings)).collect());
        }
        let mut values = Vec::with_capacity(rows);
        for distance in self.distances(rows)? {
            let guessed = guess.of(&values, rate.as_ref()).to_bits();
            values.push(f64::from_bits(guessed.wrapping_add(distance)));
        }
        Ok(values)
    }

    /// Distances from what was foretold, out of their planes.
    fn distances(&mut self, rows: usize) -> Result<impl Iterator<Item = u64> + use<'a>, DamagedColumns> {
        let used = usize::from(*self.take(1)?.first().filter(|used| **used <= 8).ok_or(DamagedColumns)?);
        let planes = self.take(used * rows)?;
        let distance = move |row: usize| {
            (0..used).fold(0, |high: u64, plane| high << 8 | u64::from(planes[plane * rows + row]))
        };
        Ok((0..rows).map(move |row| unzigzag(distance(row))))
    }

    /// The next bytes.
    ///
    /// # Errors
    /// As for [`Self::integers`].
    pub fn blob(&mut self) -> Result<&'a [u8], DamagedColumns> {
        let length = usize::try_from(self.count()?).map_err(|_| DamagedColumns)?;
        self.take(length)
    }

    /// A number of rows that a column may have.
    fn rows(&mut self) -> Result<usize, DamagedColumns> {
        let rows = usize::try_from(self.count()?).map_err(|_| DamagedColumns)?;
        if rows > MAX_ROWS { Err(DamagedColumns) } else { Ok(rows) }
    }

    /// The next number of [`varint`].
    pub(super) fn count(&mut self) -> Result<u64, DamagedColumns> {
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
pub(super) const fn zigzag(distance: u64) -> u64 {
    (distance << 1) ^ (distance >> 63).wrapping_neg()
}

pub(super) const fn unzigzag(number: u64) -> u64 {
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
            // Length, guess, which planes there are, and the planes of the first value only.
            assert!(bytes.iter().filter(|byte| **byte != 0).count() < 13, "single {single}: {bytes:?}");
        }
    }

    #[test]
    fn a_rounded_measurement_costs_its_noise_and_not_its_digits() {
        // Noise of some 16 steps of a millionth about zero: half a byte each, where doubles would take six.
        let noisy: Vec<f64> = (0..250_i32).map(|i| f64::from((i * 7919) % 17 - 8) * unit(20)).collect();
        let smooth: Vec<f64> = (0..250).map(|i| (f64::from(i) * 0.01).sin()).collect();
        let mut writer = ColumnWriter::default();
        writer.numbers(&noisy, None);
        let planes = writer.bytes.clone();
        assert_eq!(planes.len(), 2 + 2 + 1 + 250, "only the lowest plane is in use");
        writer.numbers(&smooth, None);
        writer.numbers(&[1.0, -0.0], None);
        let bytes = writer.finish();
        let mut reader = ColumnReader::new(&bytes);
        assert_eq!(reader.numbers(None).unwrap(), noisy);
        assert_eq!(reader.numbers(None).unwrap(), smooth);
        assert!(reader.numbers(None).unwrap()[1].is_sign_negative());
    }

    #[test]
    fn times_in_whole_nanoseconds_and_counts_cost_their_noise() {
        // Some 20 µs late, give or take 8: two bytes each, where doubles would take seven.
        let late_ns: Vec<u64> = (0..250_u64).map(|i| 12_000 + i * 7919 % 16_384).collect();
        let late_s: Vec<f64> = late_ns.iter().map(|ns| moca_msgs::seconds(*ns)).collect();
        let mut writer = ColumnWriter::default();
        writer.numbers(&late_s, None);
        let used = writer.bytes.iter().filter(|byte| **byte != 0).count();
        writer.integers(&late_ns);
        let both = writer.bytes.iter().filter(|byte| **byte != 0).count();
        assert!(used <= 2 * 250 + 8 && both <= 2 * used, "{used}, {both}");
        let bytes = writer.finish();
        let mut reader = ColumnReader::new(&bytes);
        assert_eq!(reader.numbers(None).unwrap(), late_s);
        assert_eq!(reader.integers().unwrap(), late_ns);
    }

    #[test]
    fn a_smooth_signal_is_foretold_by_many_before_it() {
        let smooth: Vec<f64> = (0..250).map(|i| (f64::from(i) * 0.01).sin()).collect();
        let used = |values: &[f64]| {
            let mut writer = ColumnWriter::default();
            writer.numbers(values, None);
            writer.bytes.iter().filter(|byte| **byte != 0).count()
        };
        assert!(used(&smooth) < 3 * 250, "{}", used(&smooth));
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
