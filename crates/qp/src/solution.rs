//! Solutions and their working sets.

use crate::scalar::Scalar;

/// One of the two bounds of a [`crate::Row`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Side {
    /// normal·x ≥ lower.
    Lower,
    /// normal·x ≤ upper.
    Upper,
}

/// A row that the solution lies on.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Active<T = f64> {
    /// Its place among the rows.
    pub row: usize,
    /// Its side.
    pub side: Side,
    /// ≥ 0: what the cost falls by per unit that the bound is moved outward.
    pub multiplier: T,
}

/// Rows that a solution lies on: at most as many as variables. Empty is a cold start.
///
/// ```
/// use moca_qp::{Metric, Row, WorkingSet};
///
/// let (metric, rows) = (Metric::diagonal(&[1.0, 1.0])?, [Row::at_most([1.0, 0.0], 0.5)]);
/// let first = metric.nearest(&[1.0, 0.0], &rows, &WorkingSet::EMPTY)?;
/// let next = metric.nearest(&[1.1, 0.0], &rows, &first.working_set())?; // starts where the last one ended
/// assert_eq!((first.iterations, next.iterations, next.x), (1, 0, [0.5, 0.0]));
/// # Ok::<(), moca_qp::QpError>(())
/// ```
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct WorkingSet<const N: usize> {
    pub(crate) rows: [(usize, Side); N],
    pub(crate) count: usize,
}

impl<const N: usize> WorkingSet<N> {
    /// None: a cold start.
    pub const EMPTY: Self = Self { rows: [(0, Side::Lower); N], count: 0 };
}

/// The point of least cost.
///
/// ```
/// use moca_qp::{Metric, Row, Side, WorkingSet};
///
/// let metric = Metric::diagonal(&[2.0])?;
/// let solution = metric.nearest(&[1.0], &[Row::at_most([1.0], 0.25)], &WorkingSet::EMPTY)?;
/// let [active] = solution.active() else { panic!("one row holds it back") };
/// assert_eq!((solution.x, active.row, active.side), ([0.25], 0, Side::Upper));
/// assert!((active.multiplier - 1.5_f64).abs() < 1e-12); // the slope of the cost there: 2 · (1 − 0.25)
/// # Ok::<(), moca_qp::QpError>(())
/// ```
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Solution<const N: usize, T = f64> {
    /// The point.
    pub x: [T; N],
    /// Rows that were taken up or dropped on the way.
    pub iterations: usize,
    pub(crate) active: [Active<T>; N],
    pub(crate) count: usize,
}

impl<const N: usize, T: Scalar> Solution<N, T> {
    /// Rows that the point lies on, with their multipliers.
    pub fn active(&self) -> &[Active<T>] {
        self.active.get(..self.count).unwrap_or_default()
    }

    /// Returns the working set, a start for the next, similar problem.
    pub fn working_set(&self) -> WorkingSet<N> {
        WorkingSet { rows: self.active.map(|active| (active.row, active.side)), count: self.count }
    }
}

/// Why there is no solution.
///
/// ```
/// use moca_qp::{Metric, QpError, Row, WorkingSet};
///
/// let rows = [Row::at_least([1.0], 1.0), Row::at_most([1.0], 0.0)];
/// let refused = Metric::diagonal(&[1.0])?.nearest(&[0.0], &rows, &WorkingSet::EMPTY).unwrap_err();
/// assert!(matches!(refused, QpError::Infeasible { .. }), "{refused}");
/// # Ok::<(), moca_qp::QpError>(())
/// ```
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub enum QpError {
    /// NaN or infinity in what was given, or, for `"solution"`, numbers too large to compute with.
    NotFinite {
        /// `"metric"`, `"target"`, `"row"` or `"solution"`.
        what: &'static str,
        /// Its place.
        index: usize,
    },
    /// The cost is flat or falls for ever along some direction: the Hessian's Cholesky factor has no such pivot.
    NotPositiveDefinite {
        /// The pivot.
        pivot: usize,
    },
    /// This row excludes what the other rows demand, or its own two bounds exclude each other.
    Infeasible {
        /// Its place among the rows.
        row: usize,
    },
    /// Rounding keeps the method from ending: rows that are nearly, but not quite, dependent.
    IterationLimit {
        /// The limit that was reached.
        iterations: usize,
    },
}

impl core::fmt::Display for QpError {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        match self {
            Self::NotFinite { what, index } => write!(f, "{what} {index}: a number is NaN or infinite"),
            Self::NotPositiveDefinite { pivot } => {
                write!(f, "metric: pivot {pivot} of its Cholesky factor is not positive")
            }
            Self::Infeasible { row } => write!(f, "row {row} cannot be kept together with the other rows"),
            Self::IterationLimit { iterations } => write!(f, "no solution within {iterations} iterations"),
        }
    }
}

impl core::error::Error for QpError {}
