//! Timing of loop and board.

use super::{histogram::Histogram, panel::Signal};
use moca_msgs::{STAGES, Sample, seconds};

/// Timing of loop and board, since the connection was made.
#[derive(Clone, Debug)]
pub struct Timing {
    /// Lateness of the loop's wake-up, µs.
    pub lateness_us: Histogram,
    /// From one tick to the next, µs.
    pub period_us: Histogram,
    /// Age of the cover's data, ms.
    pub frame_age_ms: Histogram,
    /// Each stage of a tick, µs, in the order of [`STAGES`].
    pub stages_us: [Histogram; STAGES.len()],
    last_tick: Option<(u64, f64)>,
}

impl Default for Timing {
    fn default() -> Self {
        Self {
            lateness_us: Histogram::new(1.0),
            period_us: Histogram::new(10.0),
            frame_age_ms: Histogram::new(0.1),
            stages_us: std::array::from_fn(|_| Histogram::new(0.1)),
            last_tick: None,
        }
    }
}

impl Timing {
    /// Counts a sample.
    pub fn add(&mut self, sample: &Sample) {
        // The loop's schedule is exact; what varies is when a tick wakes.
        let woke_s = seconds(sample.time_ns);
        if let Some((tick, last_s)) = self.last_tick.replace((sample.tick, woke_s))
            && sample.tick == tick + 1
        {
            self.period_us.add((woke_s - last_s) * 1e6);
        }
        self.lateness_us.add(Signal::LatenessUs.value(sample));
        self.frame_age_ms.add(Signal::FrameAgeMs.value(sample));
        // All zero is a tick that nobody timed, such as the first.
        if sample.stages_ns.iter().any(|ns| *ns > 0) {
            for (histogram, ns) in self.stages_us.iter_mut().zip(sample.stages_ns) {
                histogram.add(f64::from(ns) * 1e-3);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn stages_are_counted_separately_without_untimed() {
        let mut timing = Timing::default();
        for stages_ns in [[0; 5], [900, 5_000, 20_000, 300_000, 0], [900, 5_000, 20_000, 900_000, 700]] {
            timing.add(&Sample { stages_ns, ..Sample::default() });
        }
        assert_eq!(timing.stages_us.each_ref().map(Histogram::total), [2; 5]);
        assert!((timing.stages_us[3].max() - 900.0).abs() < 1e-9);
        assert!((timing.stages_us[1].quantile(0.5) - 5.0).abs() < 1e-9);
    }

    #[test]
    fn a_lost_sample_is_not_a_long_period() {
        let mut timing = Timing::default();
        for (tick, time_us) in [(0, 0), (1, 1000), (2, 2040), (9, 9000), (10, 10_000)] {
            timing.add(&Sample { tick, time_ns: time_us * 1000, frame_age_s: -1.0, ..Sample::default() });
        }
        assert_eq!(timing.period_us.total(), 3);
        assert!(timing.period_us.max() < 1100.0);
        assert_eq!((timing.lateness_us.total(), timing.frame_age_ms.total()), (5, 0));
    }
}
