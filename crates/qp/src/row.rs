//! Rows: the constraints of a problem.

use crate::scalar::{Scalar, dot, is_number};
use crate::solution::{QpError, Side};

/// lower ≤ normal·x ≤ upper. The unit is the caller's; a side without a bound is −∞ or +∞.
///
/// ```
/// use moca_qp::Row;
///
/// let speed = Row::bound(0, -0.2, 0.2); // of two variables, the first
/// assert_eq!((speed.normal, speed.lower, speed.upper), ([1.0, 0.0], -0.2, 0.2));
/// let wall = Row::at_most([1.0, 0.0], 0.1).softened(1); // by the second, which is its slack: x − s ≤ 0.1
/// assert_eq!(wall.normal, [1.0, -1.0]);
/// ```
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Row<const N: usize, T = f64> {
    /// Coefficients of x.
    pub normal: [T; N],
    /// Least normal·x.
    pub lower: T,
    /// Largest normal·x.
    pub upper: T,
}

impl<const N: usize, T: Scalar> Row<N, T> {
    /// normal·x ≥ lower.
    pub fn at_least(normal: [T; N], lower: T) -> Self {
        Self { normal, lower, upper: T::UNBOUNDED }
    }

    /// normal·x ≤ upper.
    pub fn at_most(normal: [T; N], upper: T) -> Self {
        Self { normal, lower: -T::UNBOUNDED, upper }
    }

    /// lower ≤ x\[variable\] ≤ upper. No variable of that number: a row of zeros, which only a bound that excludes 0
    /// makes infeasible.
    pub fn bound(variable: usize, lower: T, upper: T) -> Self {
        let normal = core::array::from_fn(|i| if i == variable { T::UNIT } else { T::NOTHING });
        Self { normal, lower, upper }
    }

    /// Softened by x\[slack\]: a·x + s ≥ lower, or a·x − s ≤ upper. Rows that name one variable share one slack, which
    /// then is the *largest* excess of them; a row with a variable of its own has its own. The variable's weight in the
    /// metric is the price of its square, its target is 0. A row with two sides needs a slack of its own.
    #[must_use]
    pub fn softened(mut self, slack: usize) -> Self {
        if let Some(coefficient) = self.normal.get_mut(slack) {
            *coefficient = if self.lower > -T::UNBOUNDED { T::UNIT } else { -T::UNIT };
        }
        self
    }

    /// Returns the distance of x outside the row; negative inside.
    #[inline]
    pub(crate) fn violation(&self, x: &[T; N]) -> T {
        let along = dot(&self.normal, x);
        let (below, above) = (self.lower - along, along - self.upper);
        if below > above { below } else { above }
    }

    /// The side of [`Self::violation`].
    #[inline]
    pub(crate) fn violated_side(&self, x: &[T; N]) -> Side {
        if self.violation_at(x, Side::Lower) > self.violation_at(x, Side::Upper) {
            Side::Lower
        } else {
            Side::Upper
        }
    }

    /// Returns the distance of x outside the row on `side`.
    #[inline]
    pub(crate) fn violation_at(&self, x: &[T; N], side: Side) -> T {
        match side {
            Side::Lower => self.lower - dot(&self.normal, x),
            Side::Upper => dot(&self.normal, x) - self.upper,
        }
    }

    /// Sum of the sizes of the terms of [`Self::violation`]: what its rounding is measured by.
    #[inline]
    pub(crate) fn size(&self, x: &[T; N]) -> T {
        let mut size = T::size_of(self.bound_at(self.violated_side(x)));
        for i in 0..N {
            size += T::size_of(self.normal[i] * x[i]);
        }
        size
    }

    pub(crate) fn bound_at(&self, side: Side) -> T {
        match side {
            Side::Lower => self.lower,
            Side::Upper => self.upper,
        }
    }

    /// The normal that points inward at `side`.
    #[inline]
    pub(crate) fn inward(&self, side: Side) -> [T; N] {
        match side {
            Side::Lower => self.normal,
            Side::Upper => self.normal.map(|a| -a),
        }
    }

    /// By which violations of rows are compared: about 1/‖normal‖, so that the unit of a row does not matter.
    #[inline]
    pub(crate) fn weight(&self) -> T {
        T::about_inverse_root(dot(&self.normal, &self.normal))
    }

    /// Returns true if the bounds are infinite or finite, and leave something between them: NaN is not ≥ 0, and ∞ − ∞ is NaN.
    #[inline]
    pub(crate) fn bounds_make_sense(&self) -> bool {
        self.upper - self.lower >= T::NOTHING
    }

    /// Returns true if the bounds are ordered and all coefficients are finite.
    pub(crate) fn makes_sense(&self) -> bool {
        self.bounds_make_sense() && self.normal.iter().all(|a| is_number(*a))
    }

    /// Returns true if the row says nothing of x: it is kept or not, whatever x is.
    pub(crate) fn is_of_zeros(&self) -> bool {
        self.normal.iter().all(|a| *a == T::NOTHING)
    }

    /// Returns the error of an invalid row.
    pub(crate) fn error(&self, row: usize) -> QpError {
        let numbers = self.normal.iter().chain([&self.lower, &self.upper]).all(|a| is_number(*a));
        // numbers that make no sense are bounds that exclude each other
        if numbers { QpError::Infeasible { row } } else { QpError::NotFinite { what: "row", index: row } }
    }
}
