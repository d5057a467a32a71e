//! A touch too light for one frame: Page's sequential test (CUSUM, Biometrika 41, 1954) over consecutive frames.
//!
//! A threshold on one frame hides what stays below it however long. The sum of what each frame lies below zero, less a
//! reference, drifts down while nothing touches and up under a touch; it alarms at a height that noise of the deviation
//! measured at the tare reaches less than once an hour (tests of `crates/lab/src/cover/detection.rs`). What it finds is that somebody is
//! there, not how hard: it may hold a base back and gives no force. Of a foam that recovers from a touch zero is not known, nor of
//! any while drift is not followed: what it rests at is followed then, quickly down and slowly up.
//!
//! ```
//! use moca_tactile::cusum::Cusum;
//!
//! let mut test = Cusum::default();
//! let frames = (1..100).find(|_| test.update(1.8, 0.75)); // 1.8 counts, in each frame less than half a threshold
//! assert_eq!(frames, Some(6));
//! ```

/// Counts that every frame is expected to lie below zero at least, over the deviation at the tare: half of the lightest
/// touch that is looked for.
pub const REFERENCE: f64 = 1.0;
/// Height of the alarm over the deviation at the tare.
pub const ALARM: f64 = 8.0;
/// Height from which on an alarm is certain, over the deviation. Noise takes the sum there 39 times less often than to an alarm on a
/// stock board, and 270 times on one with our firmware.
pub const CERTAIN: f64 = 12.0;
/// Time in which the rest of a recovering foam follows counts that fall, as they do, and
const FALLS_S: f64 = 0.15;
/// that rise, as they do under the next touch, s.
const RISES_S: f64 = 1.0;
/// Depth of noise followed this way below its own mean, over the deviation: the values of a normal distribution above it weigh
/// RISES_S/FALLS_S times as much as those below.
const FOLLOWS_BELOW: f64 = 0.75;
/// Depth of the rest below zero once the foam has recovered except for half a deviation, over the deviation.
const RECOVERED_BELOW: f64 = FOLLOWS_BELOW - 0.5;
/// Least deviation that is believed, counts: a whole count's own, with some noise to dither it.
pub const LEAST_DEVIATION: f64 = 0.5;

/// The test of one taxel.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct Cusum {
    /// Over the deviation.
    sum: f64,
    touched: bool,
    /// Sum that may rise to [`CERTAIN`], over the deviation.
    high: f64,
    certain: bool,
    /// Rest of the foam, counts below zero, while it is not zero.
    rest: Option<f64>,
}

impl Cusum {
    /// Starts from a foam that recovers from a touch, which ended `below` counts below zero.
    pub const fn recovering_from(below: f64) -> Self {
        Self { sum: 0.0, touched: false, high: 0.0, certain: false, rest: Some(below) }
    }

    /// Returns true if the foam has recovered, as far as a taxel can tell whose noise had this `deviation` at the tare.
    pub fn has_recovered(&self, deviation: f64) -> bool {
        self.rest.is_none_or(|rest| rest <= -RECOVERED_BELOW * deviation.max(LEAST_DEVIATION))
    }

    /// Takes one frame, `below` counts below zero, of a taxel whose noise had this `deviation` at the tare; whether
    /// somebody touches it: from the alarm until the sum is gone again.
    pub fn update(&mut self, below: f64, deviation: f64) -> bool {
        self.rest = None;
        self.add(below / deviation.max(LEAST_DEVIATION))
    }

    /// Updates while zero is not known, `dt_s` after the frame before: the depth below the present rest
    /// counts.
    pub fn update_recovering(&mut self, below: f64, deviation: f64, dt_s: f64) -> bool {
        let rest = self.rest.unwrap_or(0.0);
        let follows_s = if below < rest { FALLS_S } else { RISES_S };
        let rest = rest + (below - rest) * dt_s / (dt_s + follows_s);
        self.rest = Some(rest);
        self.add((below - rest) / deviation.max(LEAST_DEVIATION) - FOLLOWS_BELOW)
    }

    fn add(&mut self, deviations: f64) -> bool {
        self.sum = (self.sum + deviations - REFERENCE).clamp(0.0, ALARM);
        self.touched = self.sum >= ALARM || (self.touched && self.sum > 0.0);
        let high = (self.high + deviations - REFERENCE).min(CERTAIN);
        self.high = if self.sum > 0.0 { high } else { 0.0 };
        self.certain = self.touched && (self.certain || self.high >= CERTAIN);
        self.touched
    }

    /// Returns true if the touch is certain: its sum has risen to [`CERTAIN`].
    pub const fn is_certain(&self) -> bool {
        self.certain
    }

    /// Returns true if the sum has risen to half of an alarm: no touch by itself, but beside one.
    pub const fn is_halfway(&self) -> bool {
        self.sum >= 0.5 * ALARM
    }

    /// Returns true if the last frame showed a touch.
    pub const fn touched(&self) -> bool {
        self.touched
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_lies_at_zero_or_above_never_alarms_and_forgets() {
        let mut test = Cusum::default();
        assert!(!(0..1000).any(|_| test.update(0.7, 0.7)), "as far below as the reference");
        for _ in 0..1000 {
            test.update(-50.0, 0.7);
        }
        assert_eq!(test, Cusum::default(), "a rise leaves no debt");
        assert!(test.update(6.4, 0.7) && test.touched(), "one frame of more than nine deviations");
        let held = (1..100).find(|_| !test.update(0.0, 0.7));
        assert_eq!((held, test), (Some(8), Cusum::default()), "held until the sum is gone");
        assert!(test.update(6.4, 0.7) && !test.is_certain(), "an alarm may be a false one");
        assert!(test.update(4.2, 0.7) && test.is_certain(), "five deviations more are none");
        assert!((0..7).all(|_| test.update(0.0, 0.7) && test.is_certain()), "until the touch is over");
        assert!(!test.update(0.0, 0.7) && !test.is_certain());
    }

    #[test]
    fn a_recovering_foam_is_measured_from_where_it_rests() {
        let mut test = Cusum::recovering_from(2.0);
        assert!(!(0..400_u16).any(|i| test.update_recovering(
            2.0 * (-f64::from(i) / 100.0).exp(),
            0.7,
            0.01
        )));
        assert!(test.sum <= 0.0, "nothing is left of it");
        // as fast down as it is slow up
        let step = |to: f64| {
            let mut test = Cusum::recovering_from(1.0);
            test.update_recovering(to, 0.7, 0.01);
            test.rest.unwrap() - 1.0
        };
        assert!((step(0.0) + 0.01 / 0.16).abs() < 1e-12 && (step(2.0) - 0.01 / 1.01).abs() < 1e-12);
        // three counts more, each frame's less than the sum needs
        let frames = (1..100).find(|_| test.update_recovering(3.0, 0.7, 0.01));
        assert_eq!(frames, Some(4));
        let held = Cusum { rest: Some(-0.175), ..test };
        assert!(!test.has_recovered(0.7) && held.has_recovered(0.7) && !held.has_recovered(0.8));
        assert!(
            Cusum { rest: Some(-0.125), ..test }.has_recovered(0.1),
            "the least deviation that is believed"
        );
        test.update(0.0, 0.7);
        assert!(test.has_recovered(0.7) && test.rest.is_none());
        let mut dull = Cusum::default();
        assert!(!(0..1000).any(|_| dull.update_recovering(0.7 * (REFERENCE + FOLLOWS_BELOW), 0.7, 1e-6)));
    }

    #[test]
    fn the_deviation_is_the_measure_down_to_a_least_one() {
        let frames = |below: f64, deviation: f64| {
            let mut test = Cusum::default();
            (1..1000).find(|_| test.update(below, deviation))
        };
        assert_eq!((frames(2.0, 1.0), frames(4.0, 2.0)), (Some(8), Some(8)));
        assert_eq!(frames(1.0, 0.0), frames(1.0, LEAST_DEVIATION));
        assert_eq!(frames(1.0, 1.0), None);
    }
}
