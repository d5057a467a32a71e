//! A minute of every plotted signal, on one axis of time.

use super::{
    panel::Signal,
    pyramid::{CAPACITY, Pyramid},
};
use moca_msgs::{Sample, seconds};
use std::{collections::VecDeque, ops::Range};

/// A longer time without a sample of a loop is a gap, s. A slot that the loop missed is none: nothing happened in it.
const GAP_S: f64 = 0.02;
/// Gap of a log, which shows a sample each 20 ms.
const LOG_GAP_S: f64 = 0.05;

/// Signals over time.
#[derive(Clone, Debug, Default)]
pub struct History {
    signals: Vec<Signal>,
    columns: Vec<Pyramid>,
    /// Time of each sample, s of loop time, never falling.
    times_s: VecDeque<f64>,
    /// Shortest interval that is a gap, s.
    gap_s: f64,
}

/// Curve of one signal.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Curve {
    /// Unbroken pieces of (time s, value); a gap lies between two pieces.
    pub pieces: Vec<Vec<[f64; 2]>>,
    /// Least and greatest value, if there is any.
    pub extremes: Option<(f64, f64)>,
}

impl History {
    /// An empty history of `signals` of a loop.
    pub fn new(signals: Vec<Signal>) -> Self {
        let columns = signals.iter().map(|_| Pyramid::default()).collect();
        Self { signals, columns, times_s: VecDeque::new(), gap_s: GAP_S }
    }

    /// An empty history of `signals` of a log.
    pub fn of_log(signals: Vec<Signal>) -> Self {
        Self { gap_s: LOG_GAP_S, ..Self::new(signals) }
    }

    /// Appends a sample. One that is older than the last, which no healthy daemon sends, is left out.
    pub fn push(&mut self, sample: &Sample) {
        let time_s = seconds(sample.time_ns);
        if let Some(last_s) = self.end_s() {
            if time_s <= last_s {
                return;
            }
            if time_s - last_s > self.gap_s {
                self.append(last_s.midpoint(time_s), |_| f64::NAN);
            }
        }
        self.append(time_s, |signal| signal.value(sample));
    }

    /// Time of the oldest sample kept, s of loop time.
    pub fn start_s(&self) -> Option<f64> {
        self.times_s.front().copied()
    }

    /// Time of the newest sample, s of loop time.
    pub fn end_s(&self) -> Option<f64> {
        self.times_s.back().copied()
    }

    /// Samples kept.
    pub fn len(&self) -> usize {
        self.times_s.len()
    }

    /// Returns true if nothing is kept.
    pub fn is_empty(&self) -> bool {
        self.times_s.is_empty()
    }

    /// Returns the curve of `signal` in `window_s` on `pixels` columns; times are relative to the window's end.
    pub fn curve(&self, signal: Signal, window_s: Range<f64>, pixels: usize) -> Curve {
        let mut curve = Curve::default();
        let Some(column) = self.column(signal) else {
            return curve;
        };
        let mut piece = Vec::new();
        // With a neighbour on each side: lines go on to the edges, and between two samples there is one.
        let Range { start, end } = self.indices(&window_s);
        column.draw(start.saturating_sub(1)..end + 1, pixels, |index, value| {
            if value.is_finite() {
                let value = f64::from(value);
                let (min, max) = curve.extremes.unwrap_or((value, value));
                curve.extremes = Some((min.min(value), max.max(value)));
                piece.push([self.time_s(index) - window_s.end, value]);
            } else if !piece.is_empty() {
                curve.pieces.push(std::mem::take(&mut piece));
            }
        });
        if !piece.is_empty() {
            curve.pieces.push(piece);
        }
        curve
    }

    /// Value of `signal` at the last sample not after `time_s`; `None` in a gap or outside what is kept.
    pub fn value_at(&self, signal: Signal, time_s: f64) -> Option<f64> {
        let after = self.times_s.partition_point(|t| *t <= time_s);
        let index = self.start() + (after.checked_sub(1)? as u64);
        self.column(signal)?.get(index).map(f64::from).filter(|v| v.is_finite())
    }

    /// Every sample in `window_s` as a table: time in s, then each signal under the name that `name` gives it. What is
    /// missing is an empty field.
    pub fn csv(&self, window_s: Range<f64>, name: impl Fn(Signal) -> String) -> String {
        let mut table = String::from("time_s");
        for signal in &self.signals {
            table.push(',');
            table.push_str(&name(*signal));
        }
        table.push('\n');
        for index in self.indices(&window_s) {
            table.push_str(&format!("{:.6}", self.time_s(index)));
            for column in &self.columns {
                let value = column.get(index).filter(|v| v.is_finite());
                table.push_str(&value.map_or(",".into(), |v| format!(",{v}")));
            }
            table.push('\n');
        }
        table
    }

    /// Samples of `signals` together, about `count` of them at equal distances over `window_s`, oldest first; one with a
    /// value that is missing is left out.
    pub fn sampled<const N: usize>(
        &self,
        signals: [Signal; N],
        window_s: Range<f64>,
        count: u64,
    ) -> Vec<[f64; N]> {
        let range = self.indices(&window_s);
        let columns = signals.map(|signal| self.column(signal));
        let step = ((range.end - range.start) / count.max(1)).max(1);
        let value =
            |column: Option<&Pyramid>, index| column.and_then(|c| c.get(index)).map_or(f64::NAN, f64::from);
        // At multiples of the step, so that a rolling picture does not flicker.
        (range.start.div_ceil(step)..range.end.div_ceil(step))
            .map(|i| columns.map(|column| value(column, i * step)))
            .filter(|values| values.iter().all(|value| value.is_finite()))
            .collect()
    }

    /// Samples kept of `window_s`.
    pub fn count(&self, window_s: Range<f64>) -> u64 {
        let range = self.indices(&window_s);
        range.end - range.start
    }

    fn append(&mut self, time_s: f64, value: impl Fn(Signal) -> f64) {
        for (column, signal) in self.columns.iter_mut().zip(&self.signals) {
            #[expect(clippy::cast_possible_truncation, reason = "f32 resolves far more than a screen shows")]
            column.push(value(*signal) as f32);
        }
        self.times_s.push_back(time_s);
        if self.times_s.len() > CAPACITY {
            self.times_s.pop_front();
        }
    }

    fn column(&self, signal: Signal) -> Option<&Pyramid> {
        self.columns.get(self.signals.iter().position(|s| *s == signal)?)
    }

    fn start(&self) -> u64 {
        self.columns.first().map_or(0, Pyramid::start)
    }

    fn indices(&self, window_s: &Range<f64>) -> Range<u64> {
        let from = self.times_s.partition_point(|t| *t < window_s.start) as u64;
        let to = self.times_s.partition_point(|t| *t <= window_s.end) as u64;
        self.start() + from..self.start() + to
    }

    fn time_s(&self, index: u64) -> f64 {
        let at = usize::try_from(index - self.start()).unwrap_or(usize::MAX);
        self.times_s.get(at).copied().unwrap_or(f64::NAN)
    }
}

/// Leaves out points that lie within `tolerance` (vertically) of the line between those that stay: what a screen
/// cannot show costs no triangles. The first and the last point stay.
pub fn thinned(points: &[[f64; 2]], tolerance: f64) -> Vec<[f64; 2]> {
    let Some((&first, rest)) = points.split_first() else { return Vec::new() };
    let (mut kept, mut anchor, mut last) = (vec![first], first, first);
    let (mut low, mut high) = (f64::NEG_INFINITY, f64::INFINITY);
    for &point in rest {
        let slope = |from: [f64; 2], offset: f64| (point[1] + offset - from[1]) / (point[0] - from[0]);
        if point[0] <= last[0] || !(low..=high).contains(&slope(anchor, 0.0)) {
            kept.push(last);
            (anchor, low, high) = (last, f64::NEG_INFINITY, f64::INFINITY);
        }
        // After a vertical line, whose slope is infinite, nothing goes straight on.
        low = low.max(slope(anchor, -tolerance));
        high = high.min(slope(anchor, tolerance));
        last = point;
    }
    kept.push(last);
    kept.dedup();
    kept
}

#[cfg(test)]
mod tests {
    use super::*;

    fn sample(tick: u64, force_x: f64) -> Sample {
        Sample {
            tick,
            time_ns: tick * 1_000_000,
            cover_wrench_base: [force_x, 0.0, 0.0],
            ..Sample::default()
        }
    }

    const FORCE: Signal = Signal::CoverWrench(0);

    #[test]
    fn lost_samples_leave_gap_missed_slots_do_not() {
        let mut history = History::new(vec![FORCE]);
        for tick in (0..50).chain(52..100).chain(200..300) {
            history.push(&sample(tick, 1.0));
        }
        for pixels in [20, 50, 1000] {
            let curve = history.curve(FORCE, 0.0..0.299, pixels);
            assert_eq!(curve.pieces.len(), 2, "on {pixels} pixels");
            assert_eq!(curve.extremes, Some((1.0, 1.0)));
        }
        assert_eq!(history.value_at(FORCE, 0.0505), Some(1.0));
        assert_eq!(history.value_at(FORCE, 0.180), None, "inside the gap");
    }

    #[test]
    fn exported_window_has_all_samples_without_missing() {
        let mut history = History::new(vec![FORCE, Signal::FrameAgeMs]);
        for tick in 0..100 {
            history.push(&Sample { frame_age_s: if tick == 51 { -1.0 } else { 0.025 }, ..sample(tick, 1.5) });
        }
        let table = history.csv(0.050..0.052, |signal| format!("{signal:?}"));
        let expected = "time_s,CoverWrench(0),FrameAgeMs\n0.050000,1.5,25\n0.051000,1.5,\n0.052000,1.5,25\n";
        assert_eq!(table, expected);
    }

    #[test]
    fn signals_are_sampled_together_and_what_is_missing_is_left_out() {
        let mut history = History::new(vec![FORCE, Signal::FrameAgeMs]);
        for tick in 0..1000_u32 {
            let frame_age_s = if tick < 500 { -1.0 } else { f64::from(tick) * 1e-3 };
            history.push(&Sample { frame_age_s, ..sample(tick.into(), f64::from(tick)) });
        }
        let points = history.sampled([FORCE, Signal::FrameAgeMs], 0.0..2.0, 100);
        assert_eq!(points.len(), 50);
        assert!(points.iter().all(|[force, age_ms]| (force - age_ms).abs() < 1e-3), "of the same sample");
        assert_eq!((history.count(0.1..0.2), history.count(5.0..9.0)), (101, 0));
    }

    #[test]
    fn times_are_relative_to_the_end_of_the_window() {
        let mut history = History::new(vec![FORCE]);
        (0..1000).for_each(|tick| history.push(&sample(tick, 2.0)));
        let curve = history.curve(FORCE, 0.5..0.999, 10_000);
        let piece = &curve.pieces[0];
        // With the neighbour before it.
        assert!((piece[0][0] + 0.5).abs() < 1e-9 && piece[piece.len() - 1][0].abs() < 1e-9);
    }

    #[test]
    fn thinning_moves_no_point_by_more_than_the_tolerance() {
        let noisy = |i: u32| {
            let t = f64::from(i);
            let noise = (t * 12.9898).sin() * 43_758.545;
            [t * 0.01, (t * 0.02).sin() * 20.0 + (noise - noise.floor()) * 0.2]
        };
        let mut spiked: Vec<_> = (0..2000).map(noisy).collect();
        spiked[777][1] = 50.0;
        spiked[900][0] = spiked[899][0];
        let flat: Vec<_> = (0..1000).map(|i| [f64::from(i), 3.0]).collect();
        for (points, most) in [(&spiked, 600), (&flat, 2), (&vec![[1.0, 2.0]], 1), (&vec![], 0)] {
            let kept = thinned(points, 0.25);
            assert!(kept.len() <= most, "{} of {}", kept.len(), points.len());
            for point in points {
                let nearest = kept.windows(2).filter(|w| (w[0][0]..=w[1][0]).contains(&point[0])).map(|w| {
                    if w[1][0] > w[0][0] {
                        let along = (point[0] - w[0][0]) / (w[1][0] - w[0][0]);
                        (w[0][1] + along * (w[1][1] - w[0][1]) - point[1]).abs()
                    } else {
                        (w[0][1] - point[1]).abs().min((w[1][1] - point[1]).abs())
                    }
                });
                let off = nearest.fold(f64::INFINITY, f64::min);
                assert!(kept.len() < 2 || off <= 0.25 + 1e-9, "{point:?} is off by {off}");
            }
        }
        assert!(thinned(&spiked, 0.25).contains(&spiked[777]), "the spike stays where it was");
    }

    #[test]
    fn a_sample_from_the_past_is_left_out_and_memory_is_bounded() {
        let mut history = History::new(vec![FORCE]);
        (0..70_000).for_each(|tick| history.push(&sample(tick, 0.0)));
        history.push(&sample(5, 9.0));
        assert_eq!(history.len(), CAPACITY);
        assert_eq!(history.end_s(), Some(69.999));
        assert_eq!(history.curve(FORCE, 0.0..70.0, 100).extremes, Some((0.0, 0.0)));
    }
}
