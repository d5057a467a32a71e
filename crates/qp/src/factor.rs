//! The factorisation of the active rows that the method carries along.

use crate::scalar::{Scalar, add_scaled, dot};

/// J = L⁻ᵀQ and R with L⁻¹A_W = Q₁R: A_W are the inward normals of the active rows as columns, H = LLᵀ. The first
/// `count` columns of J span the active rows in the metric, the others the directions that move along them.
/// Goldfarb, Idnani 1983, section 4.
#[derive(Clone, Copy)]
pub(crate) struct Factor<const N: usize, T> {
    /// Columns.
    j: [[T; N]; N],
    /// Columns, upper triangular.
    r: [[T; N]; N],
    /// 1/R_ii.
    inverse: [T; N],
    /// ‖L⁻¹a‖² of each active row.
    squared: [T; N],
    pub(crate) count: usize,
}

/// Directions for one more row.
pub(crate) struct Step<const N: usize, T> {
    /// Jᵀn.
    d: [T; N],
    /// Of x: the steepest towards the row along the active ones.
    pub(crate) primal: [T; N],
    /// By which each active multiplier falls.
    pub(crate) dual: [T; N],
    /// ‖L⁻¹n‖², and the part of it that the active rows leave.
    pub(crate) squared: T,
    pub(crate) left: T,
}

impl<const N: usize, T: Scalar> Factor<N, T> {
    /// No rows; `j` = L⁻ᵀ as columns.
    pub(crate) fn new(j: &[[T; N]; N]) -> Self {
        let zero = [T::NOTHING; N];
        Self { j: *j, r: [zero; N], inverse: zero, squared: zero, count: 0 }
    }

    pub(crate) fn step(&self, normal: &[T; N]) -> Step<N, T> {
        let d: [T; N] = core::array::from_fn(|c| dot(&self.j[c], normal));
        let mut step =
            Step { d, primal: [T::NOTHING; N], dual: [T::NOTHING; N], squared: T::NOTHING, left: T::NOTHING };
        for c in self.count..N {
            add_scaled(&mut step.primal, d[c], &self.j[c]);
            step.left += d[c] * d[c];
        }
        step.squared = step.left;
        for c in 0..self.count {
            step.squared += d[c] * d[c];
        }
        step.dual = self.solve(d);
        step
    }

    /// R⁻¹ of the first `count` entries.
    fn solve(&self, mut d: [T; N]) -> [T; N] {
        for c in (0..self.count).rev() {
            d[c] *= self.inverse[c];
            for i in 0..c {
                d[i] -= self.r[c][i] * d[c];
            }
        }
        d
    }

    /// How strongly the new row of `step` pulls at active row `i`: cosine-like, squared and without unit.
    pub(crate) fn coupling_squared(&self, step: &Step<N, T>, i: usize) -> T {
        step.dual[i] * step.dual[i] * self.squared[i] / step.squared
    }

    /// Takes up the row of `step`: one Householder reflection of the free columns.
    pub(crate) fn add(&mut self, step: &Step<N, T>) {
        let q = self.count;
        let mut column = step.d;
        let length = T::root_of(step.left);
        let alpha = if step.d[q] > T::NOTHING { -length } else { length };
        // v = d₂ − αe₁, J₂v = primal − α·(first column)
        let denominator = step.left - alpha * step.d[q];
        let mut image = step.primal;
        add_scaled(&mut image, -alpha, &self.j[q]);
        for c in q..N {
            let v = if c == q { step.d[c] - alpha } else { step.d[c] };
            add_scaled(&mut self.j[c], -(v / denominator), &image);
        }
        column[q] = alpha;
        self.r[q] = column;
        self.inverse[q] = T::UNIT / alpha;
        self.squared[q] = step.squared;
        self.count += 1;
    }

    /// Lets go of active row `k`: Givens rotations close the gap in R.
    pub(crate) fn drop_row(&mut self, k: usize) {
        self.count -= 1;
        for c in k..self.count {
            self.r[c] = self.r[c + 1];
            self.squared[c] = self.squared[c + 1];
        }
        for c in k..self.count {
            let (a, b) = (self.r[c][c], self.r[c][c + 1]);
            let length = T::root_of(a * a + b * b);
            let inverse = T::UNIT / length;
            let (cos, sin) = (a * inverse, b * inverse);
            self.inverse[c] = inverse;
            for column in &mut self.r[c..self.count] {
                let (a, b) = (column[c], column[c + 1]);
                (column[c], column[c + 1]) = (cos * a + sin * b, cos * b - sin * a);
            }
            for i in 0..N {
                let (a, b) = (self.j[c][i], self.j[c + 1][i]);
                (self.j[c][i], self.j[c + 1][i]) = (cos * a + sin * b, cos * b - sin * a);
            }
        }
    }

    /// The active row whose multiplier is negative by more than rounding, and by most.
    pub(crate) fn pulling(&self, multipliers: &[T; N]) -> Option<usize> {
        let (mut push, mut pull, mut at) = (T::NOTHING, T::NOTHING, None);
        for i in 0..self.count {
            let squared = multipliers[i] * multipliers[i] * self.squared[i];
            if multipliers[i] >= T::NOTHING {
                push = if squared > push { squared } else { push };
            } else if squared > pull {
                (pull, at) = (squared, Some(i));
            }
        }
        at.filter(|_| pull > T::KEPT * T::KEPT * push)
    }

    /// The point nearest to `target` *on* the active rows that it misses by `missing`, and their multipliers.
    pub(crate) fn on_rows(&self, target: &[T; N], missing: &[T; N]) -> ([T; N], [T; N]) {
        let mut y = [T::NOTHING; N];
        let mut x = *target;
        for c in 0..self.count {
            let mut sum = missing[c];
            for i in 0..c {
                sum -= self.r[c][i] * y[i];
            }
            y[c] = sum * self.inverse[c];
            add_scaled(&mut x, y[c], &self.j[c]);
        }
        (x, self.solve(y))
    }
}
