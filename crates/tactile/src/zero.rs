//! Zero of the taxels: tare, and slow drift that is followed only while nothing touches.
//!
//! Force comes from FDAT against this zero, never from the chip's DIFF or TOUCH: its baseline absorbs a sustained
//! press.
//!
//! ```
//! use moca_tactile::zero::TaxelZero;
//!
//! let mut zero = TaxelZero { counts: 720.0, tared_counts: 720.0, deviation: 0.7, gain: 1.0 };
//! assert_eq!(zero.drop(692), 28.0); // a press lowers FDAT
//! for _ in 0..250 {
//!     zero.follow(719, 0.004); // a second untouched, one count below: the zero follows slowly
//! }
//! assert!(zero.counts < 720.0 && zero.counts > 719.9 && !zero.drifted());
//! ```

use crate::datastream::FDAT_MAX;
use moca_msgs::TaxelStatus;

/// Frames in one tare (about 1 s at 40 Hz).
pub const TARE_FRAMES: u32 = 40;
/// Least time that they span, ns, so that a fast board averages as long.
pub const TARE_TIME_NS: u64 = 550_000_000;
/// A tare that has not finished in this time is given up, ns.
pub const TARE_TIMEOUT_NS: u64 = 5_000_000_000;
/// Largest standard deviation a tare accepts, counts (stock noise is 0.7).
pub const TARE_NOISE_MAX: f64 = 2.0;
/// A taxel this far below the chip's own baseline, or below the zero it had, counts as touched at a tare, counts.
pub const TARE_TOUCH_COUNTS: f64 = 8.0;
/// Lowest FDAT at which an untouched electrode is still in the chip's linear window (217–807 counts), counts.
pub const LINEAR_MIN: f64 = 217.0;
/// An untouched electrode above this has no plate: an open wire, counts.
pub const OPEN_MIN: f64 = 1000.0;
/// Distance from where a taxel stood at its calibration that a tare still accepts, where the calibration names none,
/// counts: as far as drift is followed.
pub const REST_RANGE_COUNTS: f64 = DRIFT_BUDGET;
/// Largest change of FDAT at rest since the calibration that is scaled away, as a ratio.
pub const GAIN_RATIO_MAX: f64 = 1.25;
/// Largest drift that is followed before the taxel is [`TaxelStatus::Drifted`], counts.
pub const DRIFT_BUDGET: f64 = 10.0;
/// Time constant of drift following, s: slow against any touch.
const DRIFT_TIME_S: f64 = 30.0;
/// Largest rate of drift following, counts/s (1.2 counts/min: a hand that leans gently is not followed away).
const DRIFT_RATE_MAX: f64 = 0.02;

/// Why a tare was refused. The old zero, if any, stays.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub enum TareRefusal {
    /// Someone touches this taxel (0 = T1); counts below its resting value.
    Touched {
        /// 0 is T1.
        taxel: usize,
        /// Counts below baseline or old zero.
        counts: f64,
    },
    /// The reading does not stand still.
    Noisy {
        /// 0 is T1.
        taxel: usize,
        /// Standard deviation over the tare, counts.
        deviation: f64,
    },
    /// The taxel cannot be used.
    Unusable {
        /// 0 is T1.
        taxel: usize,
        /// Why.
        status: TaxelStatus,
    },
    /// The taxel does not stand where it stood untouched at its calibration: somebody touched it all the time, so
    /// that the chip's own baseline knows no better; or the board has changed and must be calibrated again.
    NotAtRest {
        /// 0 is T1.
        taxel: usize,
        /// Mean over the tare, counts.
        counts: f64,
        /// Reading at rest that the calibration expects.
        expected: ExpectedRest,
    },
    /// FDAT at rest is too far from where the taxel was calibrated: calibrate again.
    Gain {
        /// 0 is T1.
        taxel: usize,
        /// FDAT at rest at calibration over FDAT at rest now.
        ratio: f64,
    },
    /// Not enough good frames within [`TARE_TIMEOUT_NS`].
    NoFrames,
    /// A fault of the stream came up during the tare.
    StreamFault,
}

/// Reading of an untouched taxel, from its calibration: a second opinion on every tare.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct ExpectedRest {
    /// FDAT, counts.
    pub counts: f64,
    /// A tare within this distance of it is believed, counts.
    pub range_counts: f64,
}

/// Quality of a zero.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct TareQuality {
    /// Frames averaged.
    pub frames: u32,
    /// Largest standard deviation of a taxel, counts.
    pub worst_deviation: f64,
    /// When the tare finished, ns of loop time.
    pub finished_ns: u64,
}

/// Progress of a tare.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub enum TareStatus {
    /// Never asked for, or void since the board was re-enumerated.
    #[default]
    None,
    /// Frames are being averaged.
    InProgress {
        /// Frames so far, of [`TARE_FRAMES`] per board.
        frames: u32,
    },
    /// Done; the zero is valid.
    Done(TareQuality),
    /// Refused.
    Refused(TareRefusal),
}

/// Zero of one taxel.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct TaxelZero {
    /// FDAT at rest, drift followed, counts.
    pub counts: f64,
    /// FDAT at rest when it was tared, counts.
    pub tared_counts: f64,
    /// Standard deviation at the tare, counts.
    pub deviation: f64,
    /// FDAT at rest when the taxel was calibrated over FDAT at rest now: scales counts to the calibration's.
    pub gain: f64,
}

impl TaxelZero {
    /// Counts below zero: positive under a press.
    pub fn drop(&self, fdat: u16) -> f64 {
        self.counts - f64::from(fdat)
    }

    /// Follows slow drift. Only for frames in which nothing touches the cover.
    pub fn follow(&mut self, fdat: u16, dt_s: f64) {
        let error = f64::from(fdat) - self.counts;
        let limit = DRIFT_RATE_MAX * dt_s;
        self.counts += (error * dt_s / DRIFT_TIME_S).clamp(-limit, limit);
    }

    /// Returns true if the zero has moved further than its budget since the tare.
    pub fn drifted(&self) -> bool {
        libm::fabs(self.counts - self.tared_counts) > DRIFT_BUDGET
    }
}

/// Running mean and deviation of one taxel during a tare.
#[derive(Clone, Copy, Debug, Default)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub(crate) struct TareSum {
    pub(crate) frames: u32,
    mean: f64,
    squares: f64,
    baseline_mean: f64,
}

impl TareSum {
    pub(crate) fn add(&mut self, fdat: u16, baseline: u16) {
        self.frames += 1;
        let (value, weight) = (f64::from(fdat), 1.0 / f64::from(self.frames));
        let delta = value - self.mean;
        self.mean += delta * weight;
        self.squares += delta * (value - self.mean);
        self.baseline_mean += (f64::from(baseline) - self.baseline_mean) * weight;
    }

    /// The zero, or why it cannot be one. `old` is the zero so far, if it is valid;
    /// `expected` is where the taxel stood at its calibration, if there was one.
    pub(crate) fn finish(
        &self,
        taxel: usize,
        old: Option<&TaxelZero>,
        expected: Option<&ExpectedRest>,
    ) -> Result<TaxelZero, TareRefusal> {
        let unusable = |status| Err(TareRefusal::Unusable { taxel, status });
        if self.mean >= f64::from(FDAT_MAX) {
            return unusable(TaxelStatus::Saturated);
        }
        if self.mean >= OPEN_MIN {
            return unusable(TaxelStatus::Dead);
        }
        if self.mean < LINEAR_MIN {
            return unusable(TaxelStatus::Saturated);
        }
        let deviation = libm::sqrt(self.squares / f64::from(self.frames.max(2) - 1));
        if deviation > TARE_NOISE_MAX {
            return Err(TareRefusal::Noisy { taxel, deviation });
        }
        let below_old = old.map_or(0.0, |zero| zero.counts - self.mean);
        let counts = below_old.max(self.baseline_mean - self.mean);
        if counts > TARE_TOUCH_COUNTS {
            return Err(TareRefusal::Touched { taxel, counts });
        }
        if let Some(&expected) = expected
            && libm::fabs(self.mean - expected.counts) > expected.range_counts
        {
            return Err(TareRefusal::NotAtRest { taxel, counts: self.mean, expected });
        }
        let gain = expected.map_or(1.0, |expected| expected.counts / self.mean);
        if !(1.0 / GAIN_RATIO_MAX..=GAIN_RATIO_MAX).contains(&gain) {
            return Err(TareRefusal::Gain { taxel, ratio: gain });
        }
        Ok(TaxelZero { counts: self.mean, tared_counts: self.mean, deviation, gain })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A tare over `frames`, FDAT and baseline.
    fn tared(frames: &[(u16, u16)]) -> Result<TaxelZero, TareRefusal> {
        let mut sum = TareSum::default();
        frames.iter().for_each(|(fdat, baseline)| sum.add(*fdat, *baseline));
        sum.finish(4, None, None)
    }

    #[test]
    fn tare_takes_mean_and_deviation_within_bounds() {
        let zero = tared(&[(719, 720), (721, 724), (720, 716), (720, 720)]).unwrap();
        assert!((zero.counts - 720.0).abs() < 1e-9 && (zero.deviation - (2.0_f64 / 3.0).sqrt()).abs() < 1e-9);
        // The baseline's mean decides, not its last value.
        assert!(tared(&[(720, 728), (720, 728)]).is_ok(), "8 counts below");
        let touched = tared(&[(720, 728), (720, 729)]);
        assert_eq!(touched, Err(TareRefusal::Touched { taxel: 4, counts: 8.5 }));
        let unusable = |status| Err(TareRefusal::Unusable { taxel: 4, status });
        for (fdat, expected) in [
            (216, unusable(TaxelStatus::Saturated)),
            (1000, unusable(TaxelStatus::Dead)),
            (1023, unusable(TaxelStatus::Saturated)),
        ] {
            assert_eq!(tared(&[(fdat, fdat)]), expected);
        }
        assert!(tared(&[(217, 217)]).is_ok() && tared(&[(999, 999)]).is_ok());
        let noisy = TareSum {
            frames: 2,
            mean: 700.0,
            squares: TARE_NOISE_MAX * TARE_NOISE_MAX,
            baseline_mean: 700.0,
        };
        assert!(noisy.finish(4, None, None).is_ok(), "a deviation of exactly the bound");
        let noisy = TareSum { squares: 1.01 * noisy.squares, ..noisy };
        assert!(matches!(noisy.finish(4, None, None), Err(TareRefusal::Noisy { taxel: 4, .. })));
        let expected = ExpectedRest { counts: 730.0, range_counts: 10.0 };
        let still = TareSum { frames: 2, mean: 720.0, squares: 0.0, baseline_mean: 720.0 };
        assert!(still.finish(4, None, Some(&expected)).is_ok(), "as far from its rest as it may be");
    }

    #[test]
    fn a_zero_may_move_as_far_as_its_budget() {
        let moved = |counts| TaxelZero { counts, tared_counts: 720.0, deviation: 0.7, gain: 1.0 }.drifted();
        let budget = 720.0 - DRIFT_BUDGET;
        assert_eq!([budget, budget - 0.01, 720.0 + DRIFT_BUDGET + 0.01].map(moved), [false, true, true]);
    }

    #[test]
    fn drift_is_followed_up_to_its_rate_limit() {
        let zero = TaxelZero { counts: 700.0, tared_counts: 700.0, deviation: 0.7, gain: 1.0 };
        // One whole count at 0.1 s: the limit is 0.002 counts, 1/300 of the error would be 0.0033.
        let (mut slow, mut fast) = (TaxelZero { counts: 700.7, ..zero }, zero);
        slow.follow(701, 0.1);
        assert!((slow.counts - (700.7 + 0.3 / 300.0)).abs() < 1e-9, "{slow:?}");
        fast.follow(690, 0.1);
        assert!((fast.counts - (700.0 - 0.002)).abs() < 1e-9, "{fast:?}");
    }
}
