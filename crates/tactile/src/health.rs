//! Faults of one taxel, from its counts frame by frame.
//!
//! ```
//! use moca_tactile::health::TaxelHealth;
//! use moca_msgs::TaxelStatus;
//!
//! let mut health = TaxelHealth::default();
//! for i in 0..100u16 {
//!     health.update(720 + i % 2, None, 4.0, 0.0247);
//! }
//! assert_eq!(health.status(None), None);
//! health.update(1023, None, 4.0, 0.0247);
//! assert_eq!(health.status(None), Some(TaxelStatus::Saturated));
//! ```

use crate::datastream::FDAT_MAX;
use crate::zero::{LINEAR_MIN, OPEN_MIN, TaxelZero};
use moca_msgs::TaxelStatus;

/// Consecutive identical values that make a taxel stuck while its neighbours move (1.5 s at 40 Hz).
pub const STUCK_FRAMES: u32 = 60;
/// Least time that they span, s, so that a fast board needs more of them.
const STUCK_TIME_S: f64 = 0.85;
/// Below this deviation at the tare an electrode is too quiet for [`STUCK_FRAMES`] to mean anything, counts.
const STUCK_NEEDS_DEVIATION: f64 = 0.3;
/// Counts above zero that only a lost plate can give.
pub const DEAD_RISE_COUNTS: f64 = 40.0;
/// Consecutive frames above [`DEAD_RISE_COUNTS`] that make a taxel dead.
pub const DEAD_FRAMES: u32 = 3;
/// Consecutive frames above zero by more than the contact threshold that show a zero taken under a hand (0.2 s at
/// 40 Hz: noise that a tare accepts does it less than once in 10⁹ frames).
pub const ABOVE_ZERO_FRAMES: u32 = 8;
/// Least time that they span, s.
const ABOVE_ZERO_TIME_S: f64 = 0.11;
/// Standard deviation that makes a taxel noisy, counts (stock noise is 0.7; a tare accepts 2). Found within
/// 100 frames.
pub const NOISY_DEVIATION: f64 = 4.0;
/// Largest distance from the median that counts, counts, so that one hard tap is not noise.
const MEDIAN_DISTANCE_MAX: f64 = 7.0;
/// Mean distance of a value from the median of itself and its two neighbours over σ for white noise: 1/√π. Motion in one
/// direction, however fast, cancels in it: a hand that leans hard is no noise.
const MEDIAN_DISTANCE_PER_DEVIATION: f64 = 0.564_189_583_5;
/// Largest drop between two frames of a taxel that is pressed to the end of the linear window, counts: 150 N within half a second
/// lower it by 40 a frame of the stock board. A lost wire lowers it by hundreds.
const PRESSED_STEP_COUNTS: f64 = 60.0;
/// Weight of one frame in the noise mean.
const NOISE_WEIGHT: f64 = 1.0 / 32.0;

/// Running health of one taxel.
#[derive(Clone, Copy, Debug, Default)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct TaxelHealth {
    previous: [u16; 2],
    frames: u32,
    same: u32,
    same_s: f64,
    risen: u32,
    above_zero: u32,
    above_zero_s: f64,
    median_distance: f64,
    latest: u16,
    /// True while counts below the linear window were reached from it step by step: somebody presses to its end.
    pressed_on: bool,
}

impl TaxelHealth {
    /// Takes one frame's FDAT, `dt_s` after the one before; `contact_counts` is the threshold of a touch.
    pub fn update(&mut self, fdat: u16, zero: Option<&TaxelZero>, contact_counts: f64, dt_s: f64) {
        let same = self.frames > 0 && fdat == self.previous[0];
        self.same = if same { self.same.saturating_add(1) } else { 0 };
        self.same_s = if same { self.same_s + dt_s } else { 0.0 };
        if self.frames >= 2 {
            let [one, two] = self.previous.map(f64::from);
            let three = f64::from(fdat);
            let median = one.clamp(two.min(three), two.max(three));
            let distance = libm::fabs(one - median).min(MEDIAN_DISTANCE_MAX);
            self.median_distance += NOISE_WEIGHT * (distance - self.median_distance);
        }
        let (counts, before) = (f64::from(fdat), f64::from(self.previous[0]));
        let step = self.frames > 0 && before - counts <= PRESSED_STEP_COUNTS;
        self.pressed_on =
            counts < LINEAR_MIN && fdat > 0 && step && (before >= LINEAR_MIN || self.pressed_on);
        let rise = zero.map_or(0.0, |zero| -zero.drop(fdat));
        self.risen = if rise > DEAD_RISE_COUNTS { self.risen.saturating_add(1) } else { 0 };
        let above = zero.is_some_and(|zero| zero.gain * rise > contact_counts);
        self.above_zero = if above { self.above_zero.saturating_add(1) } else { 0 };
        self.above_zero_s = if above { self.above_zero_s + dt_s } else { 0.0 };
        self.previous = [fdat, self.previous[0]];
        self.latest = fdat;
        self.frames = self.frames.saturating_add(1);
    }

    /// Estimated standard deviation of the noise, counts.
    pub fn deviation(&self) -> f64 {
        self.median_distance / MEDIAN_DISTANCE_PER_DEVIATION
    }

    /// Returns true if the taxel has stood above its zero by a touch, but not by a lost plate: the person who touched it at the tare
    /// has left, and a press of the same force would read as zero.
    pub fn zero_too_low(&self) -> bool {
        let long = self.above_zero >= ABOVE_ZERO_FRAMES && self.above_zero_s >= ABOVE_ZERO_TIME_S;
        long && self.risen == 0
    }

    /// The taxel's fault, if it has one.
    pub fn status(&self, zero: Option<&TaxelZero>) -> Option<TaxelStatus> {
        let fdat = f64::from(self.latest);
        let lively = zero.is_some_and(|zero| zero.deviation > STUCK_NEEDS_DEVIATION);
        if self.latest == 0 || self.latest == FDAT_MAX || fdat < LINEAR_MIN && !self.pressed_on {
            Some(TaxelStatus::Saturated)
        } else if self.risen >= DEAD_FRAMES || fdat >= OPEN_MIN {
            Some(TaxelStatus::Dead)
        } else if lively && self.same >= STUCK_FRAMES && self.same_s >= STUCK_TIME_S {
            Some(TaxelStatus::Stuck)
        } else if self.deviation() > NOISY_DEVIATION {
            Some(TaxelStatus::Noisy)
        } else if zero.is_some_and(TaxelZero::drifted) {
            Some(TaxelStatus::Drifted)
        } else {
            None
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const ZERO: TaxelZero = TaxelZero { counts: 720.0, tared_counts: 720.0, deviation: 0.7, gain: 1.0 };

    /// After `frames` frames of `fdat`, `dt_s` apart.
    fn after(frames: u32, fdat: u16, dt_s: f64, zero: TaxelZero) -> Option<TaxelStatus> {
        let mut health = TaxelHealth::default();
        (0..frames).for_each(|_| health.update(fdat, Some(&zero), 4.0, dt_s));
        health.status(Some(&zero))
    }

    #[test]
    fn counts_outside_linear_window_are_saturated() {
        for (fdat, status) in [
            (0, Some(TaxelStatus::Saturated)),
            (1, Some(TaxelStatus::Saturated)),
            (216, Some(TaxelStatus::Saturated)),
            (217, None),
            (999, None),
            (1000, Some(TaxelStatus::Dead)),
            (1022, Some(TaxelStatus::Dead)),
            (1023, Some(TaxelStatus::Saturated)),
        ] {
            assert_eq!(after(1, fdat, 0.025, ZERO), status, "{fdat} counts");
        }
    }

    #[test]
    fn taxel_pressed_beyond_its_window_step_by_step_is_well() {
        let status = |counts: &[u16]| {
            let mut health = TaxelHealth::default();
            counts.iter().for_each(|&fdat| health.update(fdat, Some(&ZERO), 4.0, 0.025));
            health.status(Some(&ZERO))
        };
        let saturated = Some(TaxelStatus::Saturated);
        for (counts, expected) in [
            (&[230, 210][..], None),
            (&[230, 210, 190, 140, 80, 20, 1], None),
            (&[217, 157], None),
            (&[217, 156], saturated),
            (&[720, 210], saturated),
            (&[210], saturated),
            (&[210, 209], saturated),
            (&[230, 210, 60, 60], saturated),
            (&[230, 210, 60, 0], saturated),
            (&[230, 190, 140, 80, 20, 0], saturated),
            (&[230, 210, 1023], saturated),
            (&[230, 210, 230, 400, 720], None),
            (&[230, 180, 130, 80, 20, 200], None),
        ] {
            assert_eq!(status(counts), expected, "{counts:?}");
        }
    }

    #[test]
    fn lively_taxel_becomes_stuck_quiet_one_never() {
        // The first frame repeats nothing.
        for (frames, dt_s, stuck) in
            [(60, 0.1, false), (61, 0.1, true), (200, 0.004, false), (215, 0.004, true), (4, 1.0, false)]
        {
            let expected = stuck.then_some(TaxelStatus::Stuck);
            assert_eq!(after(frames, 720, dt_s, ZERO), expected, "{frames} frames of {dt_s} s");
        }
        let quiet = TaxelZero { deviation: STUCK_NEEDS_DEVIATION, ..ZERO };
        assert_eq!(after(1000, 720, 0.025, quiet), None);
    }

    #[test]
    fn rise_beyond_bound_is_lost_plate_or_bad_zero() {
        for (fdat, status) in [(760, None), (761, Some(TaxelStatus::Dead))] {
            assert_eq!(after(DEAD_FRAMES, fdat, 0.025, ZERO), status, "{fdat} counts");
        }
        let too_low = |fdat: u16| {
            let mut health = TaxelHealth::default();
            (0..40).for_each(|_| health.update(fdat, Some(&ZERO), 4.0, 0.025));
            health.zero_too_low()
        };
        assert_eq!([724, 725, 760, 761].map(too_low), [false, true, true, false]);
    }

    /// After 60 frames 4 ms apart of a hand that presses from 720 counts nearly to the end of the range within `time_s`, with
    /// this much noise on it.
    fn leaned(time_s: f64, noise: f64) -> (Option<TaxelStatus>, bool) {
        let (mut health, mut state, mut noisy) = (TaxelHealth::default(), 1u32, false);
        for frame in 0..60u16 {
            state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            let uniform = f64::from(state >> 8) / f64::from(1u32 << 23) - 1.0;
            let fdat = 230.0 + 490.0 * libm::exp(-0.004 * f64::from(frame) / time_s) + 1.7 * noise * uniform;
            #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "217 to 800")]
            health.update(fdat as u16, Some(&ZERO), 4.0, 0.004);
            noisy |= health.status(Some(&ZERO)) == Some(TaxelStatus::Noisy);
        }
        (health.status(Some(&ZERO)), noisy)
    }

    #[test]
    fn hard_and_quick_lean_is_not_noise_and_noise_under_it_is() {
        for time_s in [0.005, 0.02, 0.05, 0.2] {
            assert_eq!(leaned(time_s, 0.7), (None, false), "{time_s} s");
            assert!(leaned(time_s, 8.0).1, "{time_s} s");
        }
    }

    #[test]
    fn noise_at_its_bound_is_borne_and_beyond_it_is_not() {
        let noisy = |deviation: f64| TaxelHealth {
            latest: 720,
            median_distance: deviation * MEDIAN_DISTANCE_PER_DEVIATION,
            ..TaxelHealth::default()
        };
        let bound = noisy(NOISY_DEVIATION);
        assert_eq!((bound.deviation().to_bits(), bound.status(None)), (NOISY_DEVIATION.to_bits(), None));
        assert_eq!(noisy(1.001 * NOISY_DEVIATION).status(None), Some(TaxelStatus::Noisy));
    }
}
