//! A touch too light for one frame: Page's sequential test (CUSUM, Biometrika 41, 1954) over consecutive frames.
//!
//! A threshold on one frame hides what stays below it however long. The sum of what each frame lies below zero, less a
//! reference, drifts down while nothing touches and up under a touch; it alarms at a height that noise of the deviation
//! measured at the tare reaches less than once an hour (`moca-lab docs --only detection`). What it finds is that somebody is
//! there, not how hard: it may hold a base back and gives no force.
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
/// Least deviation that is believed, counts: a whole count's own, with some noise to dither it.
pub const LEAST_DEVIATION: f64 = 0.5;

/// The test of one taxel.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct Cusum {
    /// Over the deviation.
    sum: f64,
    touched: bool,
}

impl Cusum {
    /// Takes one frame, `below` counts below zero, of a taxel whose noise had this `deviation` at the tare; whether
    /// somebody touches it: from the alarm until the sum is gone again.
    pub fn update(&mut self, below: f64, deviation: f64) -> bool {
        let step = below / deviation.max(LEAST_DEVIATION) - REFERENCE;
        self.sum = (self.sum + step).clamp(0.0, ALARM);
        self.touched = self.sum >= ALARM || (self.touched && self.sum > 0.0);
        self.touched
    }

    /// Whether somebody touched it at the last frame.
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
