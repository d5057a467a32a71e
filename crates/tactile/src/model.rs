//! From counts below zero to newtons.

/// Counts by which the paper's PU taxel falls at 100 N (Table I).
pub const PAPER_COUNTS_AT_100N: f64 = 84.0;
/// Most knots of a [`MonotoneCurve`].
pub const MAX_KNOTS: usize = 16;

/// A monotone piecewise-linear curve through (0, 0): counts below zero to newtons. Beyond its last knot it goes on
/// with the last slope, so a harder press never reads softer.
#[derive(Clone, Copy, Debug, PartialEq)]
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
}

impl core::fmt::Display for CurveError {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        match self {
            Self::KnotCount(n) => write!(f, "a monotone curve has 1 to {MAX_KNOTS} knots, got {n}"),
            Self::NotRising { index } => {
                write!(f, "knot {index} of a monotone curve must rise in counts and not fall in force (N)")
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

/// Calibration of one taxel.
#[derive(Clone, Copy, Debug, PartialEq)]
#[expect(clippy::large_enum_variant, reason = "K fixed-size models live in the cover; boxing would allocate")]
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
    /// Monotone curve.
    Monotone(MonotoneCurve),
}

impl TaxelModel {
    /// Line through the tared zero and 100 N at 84 counts (the paper's PU taxel): the default.
    pub const PAPER: Self = Self::LineThroughZero { newton_per_count: 100.0 / PAPER_COUNTS_AT_100N };

    /// Force at `drop` counts below zero, N, ≥ 0.
    pub fn force_n(&self, drop: f64) -> f64 {
        let force_n = match self {
            Self::LineThroughZero { newton_per_count } => newton_per_count * drop,
            Self::LineWithIntercept { newton_per_count, intercept_n } => {
                newton_per_count * drop + intercept_n
            }
            Self::Monotone(curve) => curve.force_n(drop),
        };
        force_n.max(0.0)
    }
}

impl Default for TaxelModel {
    fn default() -> Self {
        Self::PAPER
    }
}
