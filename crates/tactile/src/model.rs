//! From counts below zero to newtons.
//!
//! ```
//! use moca_tactile::TaxelModel;
//! use moca_tactile::model::{FoamMemory, MonotoneCurve};
//!
//! let curve = MonotoneCurve::new(&[[10.0, 5.0], [40.0, 50.0]])?; // counts below zero, N
//! assert_eq!(curve.force_n(25.0), 27.5);
//! let mut memory = FoamMemory::default();
//! let force_n = TaxelModel::Monotone(curve).force_n(&mut memory, 40.0, 0.025);
//! assert_eq!(force_n, 50.0);
//! # Ok::<(), moca_tactile::model::CurveError>(())
//! ```

/// Counts by which the paper's PU taxel falls at 100 N (Table I).
pub const PAPER_COUNTS_AT_100N: f64 = 84.0;
/// Most knots of a [`MonotoneCurve`].
pub const MAX_KNOTS: usize = 16;

/// Knots of [`TaxelModel::PU_LD30`], counts below zero.
const PU_LD30_COUNTS: [f64; 10] = [8.0, 12.0, 17.0, 23.0, 29.0, 36.0, 45.0, 55.0, 68.0, 85.0];
/// Forces of the curve, N.
const PU_LD30_FORCE_N: [f64; 10] = [9.62, 19.84, 29.75, 40.74, 50.37, 60.11, 70.62, 80.22, 90.56, 101.12];

/// A monotone piecewise-linear curve through (0, 0): counts below zero to newtons. Beyond its last knot it goes on
/// with the last slope, so a harder press never reads softer.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct MonotoneCurve {
    counts: [f64; MAX_KNOTS],
    force_n: [f64; MAX_KNOTS],
    len: usize,
}

/// Why knots make no curve.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum CurveError {
    /// Fewer than 1 or more than [`MAX_KNOTS`] knots.
    KnotCount(usize),
    /// Knot `index` is not finite, or its counts or force (both from 0) do not rise.
    NotRising {
        /// Counted from 0.
        index: usize,
    },
    /// Relaxing shares must each be at least 0 and together below 1.
    Share {
        /// Their sum.
        sum: f64,
    },
}

impl core::fmt::Display for CurveError {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        match self {
            Self::KnotCount(n) => write!(f, "a monotone curve has 1 to {MAX_KNOTS} knots, got {n}"),
            Self::NotRising { index } => {
                write!(f, "knot {index} of a monotone curve must rise in counts and not fall in force (N)")
            }
            Self::Share { sum } => {
                write!(f, "relaxing shares must each be at least 0 and together below 1, their sum is {sum}")
            }
        }
    }
}

impl core::error::Error for CurveError {}

impl MonotoneCurve {
    /// A curve from (0, 0) through `knots` (counts below zero, N), in rising order.
    pub fn new(knots: &[[f64; 2]]) -> Result<Self, CurveError> {
        if knots.is_empty() || knots.len() > MAX_KNOTS {
            return Err(CurveError::KnotCount(knots.len()));
        }
        let mut curve = Self { counts: [0.0; MAX_KNOTS], force_n: [0.0; MAX_KNOTS], len: knots.len() };
        let mut last = [0.0, 0.0];
        for (index, &[counts, force_n]) in knots.iter().enumerate() {
            if !(counts.is_finite() && force_n.is_finite() && counts > last[0] && force_n >= last[1]) {
                return Err(CurveError::NotRising { index });
            }
            curve.counts[index] = counts;
            curve.force_n[index] = force_n;
            last = [counts, force_n];
        }
        Ok(curve)
    }

    /// A curve whose knots are known to rise.
    const fn fixed<const N: usize>(counts: [f64; N], force_n: [f64; N]) -> Self {
        let mut curve = Self { counts: [0.0; MAX_KNOTS], force_n: [0.0; MAX_KNOTS], len: N };
        let mut i = 0;
        while i < N {
            (curve.counts[i], curve.force_n[i]) = (counts[i], force_n[i]);
            i += 1;
        }
        curve
    }

    /// The knots after (0, 0): counts below zero, N.
    pub fn knots(&self) -> impl Iterator<Item = [f64; 2]> + '_ {
        self.counts[..self.len].iter().zip(&self.force_n[..self.len]).map(|(&c, &f)| [c, f])
    }

    /// Force at `drop` counts below zero, N; 0 for a drop ≤ 0.
    pub fn force_n(&self, drop: f64) -> f64 {
        if drop <= 0.0 {
            return 0.0;
        }
        let (mut from, mut to) = ([0.0, 0.0], [self.counts[0], self.force_n[0]]);
        for i in 1..self.len {
            if drop <= to[0] {
                break;
            }
            (from, to) = (to, [self.counts[i], self.force_n[i]]);
        }
        from[1] + (drop - from[0]) * (to[1] - from[1]) / (to[0] - from[0])
    }
}

/// Time constants of the compensated foam memory, s: a decade apart, from a tap to a long lean.
pub const MEMORY_TIME_S: [f64; 3] = [0.3, 3.0, 30.0];

/// Quasi-linear viscoelasticity (Fung): counts give the gap, the gap gives the elastic force through a monotone
/// curve, and a share of that force relaxes. F = (1 − Σg)·Fe + Σh, ḣ = g·Ḟe − h/τ, exact for a linear Fe.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct CompensatedCurve {
    elastic: MonotoneCurve,
    share: [f64; 3],
}

/// Memory of a foam, N. All 0 at rest.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct FoamMemory {
    elastic_n: f64,
    relaxing_n: [f64; 3],
}

impl CompensatedCurve {
    /// `elastic`: counts to instantaneous force; `share`: parts of it that relax with [`MEMORY_TIME_S`], each ≥ 0,
    /// together below 1.
    pub fn new(elastic: MonotoneCurve, share: [f64; 3]) -> Result<Self, CurveError> {
        let sum: f64 = share.iter().sum();
        let valid = share.iter().all(|&g| g >= 0.0) && sum < 1.0;
        if valid { Ok(Self { elastic, share }) } else { Err(CurveError::Share { sum }) }
    }

    /// The elastic curve.
    pub const fn elastic(&self) -> &MonotoneCurve {
        &self.elastic
    }

    /// Relaxing shares of the elastic force, for [`MEMORY_TIME_S`].
    pub const fn share(&self) -> [f64; 3] {
        self.share
    }

    fn force_n(&self, memory: &mut FoamMemory, drop: f64, dt_s: f64) -> f64 {
        let elastic_n = self.elastic.force_n(drop);
        let change_n = elastic_n - memory.elastic_n;
        memory.elastic_n = elastic_n;
        let mut force_n = elastic_n;
        for ((relaxing_n, share), time_s) in memory.relaxing_n.iter_mut().zip(self.share).zip(MEMORY_TIME_S) {
            *relaxing_n = relax(*relaxing_n, share * change_n, dt_s / time_s);
            force_n += *relaxing_n - share * elastic_n;
        }
        force_n
    }
}

/// h after a step in which its input rose linearly by `change` over `ratio` time constants.
pub(crate) fn relax(h: f64, change: f64, ratio: f64) -> f64 {
    if ratio <= 0.0 {
        return h + change;
    }
    let decay = libm::exp(-ratio);
    h * decay + change * -libm::expm1(-ratio) / ratio
}

/// A press of this force or more is within [`TaxelModel::assumed_error`] on a cover that has not been calibrated, N;
/// below it noise and hysteresis of the foam are most of the reading.
pub const ASSUMED_ERROR_FROM_N: f64 = 20.0;

/// Calibration of one taxel.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub enum TaxelModel {
    /// F = slope · drop.
    LineThroughZero {
        /// N per count.
        newton_per_count: f64,
    },
    /// The paper's least-squares line. It reads its intercept when untouched: for reporting only.
    LineWithIntercept {
        /// N per count.
        newton_per_count: f64,
        /// N at zero counts.
        intercept_n: f64,
    },
    /// Monotone curve, without memory: loading and unloading read the mean of both.
    Monotone(MonotoneCurve),
    /// Monotone curve with hysteresis and creep of the foam compensated.
    Compensated(CompensatedCurve),
}

impl TaxelModel {
    /// Line through the tared zero and 100 N at 84 counts: the paper's PU taxel.
    pub const PAPER: Self = Self::LineThroughZero { newton_per_count: 100.0 / PAPER_COUNTS_AT_100N };

    /// Monotone curve of the simulated PU LD30 taxel, loading and unloading pooled: the default of a cover that has not
    /// been calibrated. `moca-lab characterize` fits it, and a test there compares.
    pub const PU_LD30: Self = Self::Monotone(MonotoneCurve::fixed(PU_LD30_COUNTS, PU_LD30_FORCE_N));

    /// Returns the largest error of a press of [`ASSUMED_ERROR_FROM_N`] or more where this model was assumed and not measured, as a
    /// share of the force: simulated PU LD30, as soft and as stiff as nominal ± 10 %, pressed and
    /// released (`moca-lab characterize` prints it). The error on another foam may be larger.
    pub fn assumed_error(&self) -> f64 {
        if *self == Self::PU_LD30 { 0.50 } else { 0.55 }
    }

    /// Force at `drop` counts below zero after `dt_s` since the last call, N, ≥ 0. `memory` belongs to the taxel;
    /// call it for every frame, with a drop of 0 while nothing touches.
    pub fn force_n(&self, memory: &mut FoamMemory, drop: f64, dt_s: f64) -> f64 {
        let force_n = match self {
            Self::LineThroughZero { newton_per_count } => newton_per_count * drop,
            Self::LineWithIntercept { newton_per_count, intercept_n } => {
                newton_per_count * drop + intercept_n
            }
            Self::Monotone(curve) => curve.force_n(drop),
            Self::Compensated(curve) => curve.force_n(memory, drop, dt_s),
        };
        force_n.max(0.0)
    }

    /// Name as in calibration files and reports.
    pub const fn name(&self) -> &'static str {
        match self {
            Self::LineThroughZero { .. } => "line-through-zero",
            Self::LineWithIntercept { .. } => "line-with-intercept",
            Self::Monotone(_) => "monotone",
            Self::Compensated(_) => "compensated",
        }
    }
}

impl Default for TaxelModel {
    fn default() -> Self {
        Self::PU_LD30
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn curve() -> MonotoneCurve {
        MonotoneCurve::new(&[[4.0, 5.0], [28.0, 50.0], [84.0, 100.0]]).unwrap()
    }

    #[test]
    fn a_curve_passes_its_knots_and_goes_on_with_its_last_slope() {
        let curve = curve();
        for (drop, force_n) in
            [(-3.0, 0.0), (0.0, 0.0), (2.0, 2.5), (4.0, 5.0), (16.0, 27.5), (84.0, 100.0), (140.0, 150.0)]
        {
            assert!((curve.force_n(drop) - force_n).abs() < 1e-12, "{drop}");
        }
    }

    #[test]
    fn the_assumed_curve_is_a_curve() {
        let TaxelModel::Monotone(curve) = TaxelModel::PU_LD30 else { panic!("a curve") };
        let knots: std::vec::Vec<[f64; 2]> = curve.knots().collect();
        assert_eq!(MonotoneCurve::new(&knots), Ok(curve));
        assert_eq!(knots.len(), 10);
    }

    #[test]
    fn knots_that_fall_or_are_no_numbers_are_refused() {
        assert_eq!(MonotoneCurve::new(&[]), Err(CurveError::KnotCount(0)));
        assert_eq!(MonotoneCurve::new(&[[1.0, 1.0]; 17]), Err(CurveError::KnotCount(17)));
        for bad in [[4.0, 6.0], [5.0, 4.9], [f64::NAN, 6.0], [6.0, f64::INFINITY]] {
            assert_eq!(MonotoneCurve::new(&[[4.0, 5.0], bad]), Err(CurveError::NotRising { index: 1 }));
        }
        assert!(CompensatedCurve::new(curve(), [0.5, 0.3, 0.2]).is_err());
        assert!(CompensatedCurve::new(curve(), [f64::NAN, 0.0, 0.0]).is_err());
    }

    #[test]
    fn a_held_gap_reads_less_and_less_down_to_the_lasting_share() {
        let model = TaxelModel::Compensated(CompensatedCurve::new(curve(), [0.1, 0.05, 0.05]).unwrap());
        let mut memory = FoamMemory::default();
        let first_n = model.force_n(&mut memory, 28.0, 1e-9);
        assert!((first_n - 50.0).abs() < 1e-6);
        let mut last_n = first_n;
        for _ in 0..3000 {
            let force_n = model.force_n(&mut memory, 28.0, 0.1);
            assert!(force_n <= last_n);
            last_n = force_n;
        }
        assert!((last_n - 40.0).abs() < 0.01, "{last_n}");
        assert!(model.force_n(&mut memory, 0.0, 0.025) <= 0.0, "a foam never pulls");
    }
}
