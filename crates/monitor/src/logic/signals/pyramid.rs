//! Least and greatest values of a growing signal, in blocks of 8, 64, 512 … samples: drawing a minute costs no more
//! than drawing a second, and a spike of one sample is seen at every zoom.

use std::{collections::VecDeque, ops::Range};

/// Samples kept: 65 s at 1 kHz.
pub const CAPACITY: usize = 1 << 16;
/// Blocks of 8 to 8⁵ samples.
const LEVELS: u32 = 5;

/// Extremes of some neighbouring samples.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Block {
    min: f32,
    max: f32,
    /// True if the least value came before the greatest.
    falls_first: bool,
    /// True if a value was missing (NaN): a gap is drawn as a gap.
    gap: bool,
}

impl Block {
    const EMPTY: Self = Self { min: f32::INFINITY, max: f32::NEG_INFINITY, falls_first: true, gap: false };

    fn of(value: f32) -> Self {
        if value.is_finite() {
            Self { min: value, max: value, falls_first: true, gap: false }
        } else {
            Self { gap: true, ..Self::EMPTY }
        }
    }

    fn is_empty(self) -> bool {
        self.min > self.max
    }

    /// This block followed by `next`.
    fn then(self, next: Self) -> Self {
        let falls_first = match (next.min < self.min, next.max > self.max) {
            (true, false) => false,
            (false, true) => true,
            (true, true) => next.falls_first,
            (false, false) => self.falls_first,
        };
        let (min, max) = (self.min.min(next.min), self.max.max(next.max));
        Self { min, max, falls_first, gap: self.gap || next.gap }
    }
}

/// One signal. Samples have consecutive numbers; the oldest are forgotten beyond [`CAPACITY`].
#[derive(Clone, Debug)]
pub struct Pyramid {
    first: u64,
    raw: VecDeque<f32>,
    levels: [Level; LEVELS as usize],
}

#[derive(Clone, Debug, Default)]
struct Level {
    first: u64,
    blocks: VecDeque<Block>,
}

impl Default for Pyramid {
    fn default() -> Self {
        Self { first: 0, raw: VecDeque::new(), levels: std::array::from_fn(|_| Level::default()) }
    }
}

impl Pyramid {
    /// Appends a value; NaN is a gap.
    pub fn push(&mut self, value: f32) {
        let index = self.end();
        self.raw.push_back(value);
        for (shift, level) in (3..).step_by(3).zip(&mut self.levels) {
            let block = index >> shift;
            let one = Block::of(value);
            let present = level.first + level.blocks.len() as u64 == block + 1;
            match level.blocks.back_mut() {
                Some(last) if present => *last = last.then(one),
                _ => {
                    if level.blocks.is_empty() {
                        level.first = block;
                    }
                    level.blocks.push_back(one);
                }
            }
        }
        if self.raw.len() > CAPACITY {
            self.raw.pop_front();
            self.first += 1;
            for (shift, level) in (3..).step_by(3).zip(&mut self.levels) {
                while (level.first + 1) << shift <= self.first {
                    level.blocks.pop_front();
                    level.first += 1;
                }
            }
        }
    }

    /// Number of the oldest sample kept.
    pub fn start(&self) -> u64 {
        self.first
    }

    /// Number that the next sample will get.
    pub fn end(&self) -> u64 {
        self.first + self.raw.len() as u64
    }

    /// The value of one sample, if it is kept.
    pub fn get(&self, index: u64) -> Option<f32> {
        self.raw.get(usize::try_from(index.checked_sub(self.first)?).ok()?).copied()
    }

    /// Gives `emit` points (sample number, value) that draw `range` on `pixels` columns: at most two a column, both
    /// extremes of everything in `range`, and NaN where a value is missing. Columns are fixed to sample numbers, so
    /// that a rolling picture does not flicker.
    pub fn draw(&self, range: Range<u64>, pixels: usize, mut emit: impl FnMut(u64, f32)) {
        let range = range.start.max(self.first)..range.end.min(self.end());
        if range.is_empty() {
            return;
        }
        let count = range.end - range.start;
        let pixels = pixels as u64;
        // Two points a column: as many points as pixels. One column is partly outside.
        let columns = (pixels / 2).saturating_sub(1).max(1);
        if count <= pixels {
            for index in range {
                emit(index, self.get(index).unwrap_or(f32::NAN));
            }
            return;
        }
        let (level, width) = column_width(count.div_ceil(columns));
        for column in range.start / width..=(range.end - 1) / width {
            let samples = (column * width).max(range.start)..((column + 1) * width).min(range.end);
            let block = self.extremes(level, column * width..(column + 1) * width, &range);
            let middle = samples.start.midpoint(samples.end - 1);
            if !block.is_empty() {
                let (early, late) =
                    if block.falls_first { (block.min, block.max) } else { (block.max, block.min) };
                emit(samples.start, early);
                emit(middle, late);
            }
            if block.gap {
                emit(middle, f32::NAN);
            }
        }
    }

    /// Extremes of the samples in both `column` and `range`. Blocks that are not wholly in `range` are looked up
    /// sample by sample, so that nothing outside it shows.
    fn extremes(&self, level: u32, column: Range<u64>, range: &Range<u64>) -> Block {
        let whole = column.start >= range.start && column.end <= range.end;
        if level == 0 || !whole {
            let samples = column.start.max(range.start)..column.end.min(range.end);
            return samples
                .filter_map(|i| self.get(i))
                .fold(Block::EMPTY, |block, value| block.then(Block::of(value)));
        }
        let shift = 3 * level;
        let blocks = &self.levels[level as usize - 1];
        (column.start >> shift..column.end >> shift)
            .filter_map(|b| blocks.blocks.get(usize::try_from(b.checked_sub(blocks.first)?).ok()?))
            .fold(Block::EMPTY, |block, next| block.then(*next))
    }
}

/// The level to read and the width of a column that is at least `samples` wide: one to eight whole blocks.
fn column_width(samples: u64) -> (u32, u64) {
    let level = (samples.ilog2() / 3).min(LEVELS);
    let block = 1 << (3 * level);
    (level, samples.div_ceil(block) * block)
}

#[cfg(test)]
#[expect(clippy::float_cmp, reason = "values are copied or round, not computed")]
mod tests {
    use super::*;

    fn draw(pyramid: &Pyramid, range: Range<u64>, pixels: usize) -> Vec<(u64, f32)> {
        let mut points = Vec::new();
        pyramid.draw(range, pixels, |index, value| points.push((index, value)));
        points
    }

    fn filled(count: u64, value: impl Fn(u64) -> f32) -> Pyramid {
        let mut pyramid = Pyramid::default();
        for i in 0..count {
            pyramid.push(value(i));
        }
        pyramid
    }

    const WINDOWS: [u64; 12] = [1, 2, 7, 8, 63, 65, 400, 1000, 5000, 10_000, 30_000, 60_000];
    const PIXELS: [usize; 5] = [1, 10, 157, 600, 2000];

    #[test]
    fn a_spike_of_one_sample_is_seen_at_every_zoom_and_nowhere_else() {
        const COUNT: u64 = 60_000;
        for spike in [0, 1, 511, 512, 29_999, 40_007, 59_998, 59_999] {
            let pyramid = filled(COUNT, |i| if i == spike { 40.0 } else { 0.0 });
            for (window, pixels) in WINDOWS.into_iter().flat_map(|w| PIXELS.map(|p| (w, p))) {
                for start in [0, spike.saturating_sub(window / 2), spike, COUNT - window] {
                    let range = start..(start + window).min(COUNT);
                    let points = draw(&pyramid, range.clone(), pixels);
                    let seen = points.iter().any(|(_, value)| *value > 39.0);
                    assert_eq!(
                        seen,
                        range.contains(&spike),
                        "spike at {spike} in {range:?} on {pixels} pixels"
                    );
                }
            }
        }
    }

    #[test]
    fn at_most_two_points_a_pixel_in_order_and_inside_the_window() {
        // A gap in every tenth sample is the worst case.
        let pyramid = filled(60_000, |i| if i % 10 == 0 { f32::NAN } else { (i % 977) as f32 });
        for (window, pixels) in WINDOWS.into_iter().flat_map(|w| PIXELS.map(|p| (w, p))) {
            for start in [0, 1234, 60_000 - window] {
                let range = start..(start + window).min(60_000);
                let points = draw(&pyramid, range.clone(), pixels);
                // One column on fewer than three pixels cannot do with less than a column's three points, twice.
                assert!(points.len() <= (2 * pixels).max(6), "{} points on {pixels} pixels", points.len());
                assert!(points.is_sorted_by_key(|(index, _)| *index));
                assert!(points.iter().all(|(index, _)| range.contains(index)));
            }
        }
    }

    #[test]
    fn a_gap_is_neither_bridged_nor_does_it_swallow_its_neighbours() {
        for gap in [100..101, 100..5000] {
            let pyramid = filled(60_000, |i| if gap.contains(&i) { f32::NAN } else { 3.0 });
            for (window, pixels) in WINDOWS.into_iter().flat_map(|w| PIXELS.map(|p| (w, p))) {
                let points = draw(&pyramid, 0..window, pixels);
                let broken = points.iter().any(|(_, value)| value.is_nan());
                assert_eq!(broken, window > gap.start, "{window} samples on {pixels} pixels");
                let (left, right) = (points.first().unwrap().1, points.last().unwrap().1);
                assert!(left == 3.0, "the value before the gap is drawn");
                assert!(window < gap.end + window / 2 || right == 3.0 || right.is_nan());
            }
        }
    }

    #[test]
    fn extremes_are_exact_when_the_oldest_are_forgotten() {
        let count = CAPACITY as u64 + 12_345;
        let value = |i: u64| ((i * 7919) % 10_007) as f32;
        let pyramid = filled(count, value);
        assert_eq!(pyramid.end() - pyramid.start(), CAPACITY as u64);
        for (start, end) in [(0, count), (pyramid.start(), pyramid.start() + 999), (30_000, 60_001)] {
            let kept = start.max(pyramid.start())..end;
            let expected =
                kept.clone().map(value).fold((f32::MAX, f32::MIN), |(a, b), v| (a.min(v), b.max(v)));
            let points = draw(&pyramid, start..end, 300);
            let drawn = points.iter().fold((f32::MAX, f32::MIN), |(a, b), (_, v)| (a.min(*v), b.max(*v)));
            assert_eq!(drawn, expected);
        }
    }

    #[test]
    fn columns_do_not_move_while_the_picture_rolls() {
        let pyramid = filled(50_000, |i| (i as f32 * 0.01).sin());
        let inner = |start: u64| {
            let points = draw(&pyramid, start..start + 40_000, 200);
            let border = start + 2000..start + 38_000;
            points
                .into_iter()
                .filter(|(i, _)| border.contains(i))
                .collect::<std::collections::BTreeMap<_, _>>()
                .into_keys()
                .collect::<std::collections::BTreeSet<_>>()
        };
        let (a, b) = (inner(1000), inner(1010));
        assert!(a.symmetric_difference(&b).count() <= 2, "inner columns moved");
    }
}
