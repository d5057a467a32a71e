//! The factorisation of the active rows that the method carries along.

use core::ops::Range;

use crate::scalar::{Scalar, add_scaled, dot};

/// Up to so many columns all are added up, with zeros for those that are not meant: that takes a processor less time than
/// a wrong guess at where a loop ends.
const ALL: usize = 4;

/// J = L⁻ᵀQ and S = R⁻¹ with L⁻¹A_W = Q₁R: A_W are the inward normals of the active rows as columns, H = LLᵀ. The first
/// `count` columns of J span the active rows in the metric, the others the directions that move along them.
/// Goldfarb, Idnani 1983, section 4; but R is kept as its inverse and need not be triangular, so that a row comes and
/// goes by one reflection each, and a step is products with vectors, none of which waits for another's division.
#[derive(Clone, Copy)]
pub(crate) struct Factor<const N: usize, T> {
    /// Columns.
    j: [[T; N]; N],
    /// Columns; zero outside the first `count` rows and columns.
    s: [[T; N]; N],
    /// ‖L⁻¹a‖² of each active row.
    squared: [T; N],
    pub(crate) count: usize,
}

/// Directions for one more row.
pub(crate) struct Step<const N: usize, T> {
    /// Jᵀn along the free columns.
    free: [T; N],
    /// Step of x: the steepest towards the row along the active rows.
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
        Self { j: *j, s: [zero; N], squared: zero, count: 0 }
    }

    #[inline]
    pub(crate) fn step(&self, normal: &[T; N]) -> Step<N, T> {
        let d: [T; N] = core::array::from_fn(|c| dot(&self.j[c], normal));
        let free: [T; N] =
            core::array::from_fn(|c| if N > ALL || c >= self.count { d[c] } else { T::NOTHING });
        let mut left = T::NOTHING;
        for c in columns::<N>(self.count..N) {
            left += free[c] * free[c];
        }
        Step {
            primal: combined(&self.j, &free, self.count..N),
            dual: combined(&self.s, &d, 0..self.count),
            squared: dot(&d, &d),
            left,
            free,
        }
    }

    /// Returns true if the new row of `step` pulls at active row `i` by more than rounding.
    #[inline]
    pub(crate) fn coupled(&self, step: &Step<N, T>, i: usize) -> bool {
        step.dual[i] * step.dual[i] * self.squared[i] > T::KEPT * T::KEPT * step.squared
    }

    /// Takes up the row of `step`: one reflection of the free columns.
    #[inline]
    pub(crate) fn add(&mut self, step: &Step<N, T>) {
        let q = self.count;
        let length = T::root_of(step.left);
        let alpha = if step.free[q] > T::NOTHING { -length } else { length };
        let inverse = T::UNIT / alpha;
        // v = d₂ − αe₁, J₂v = primal − α·(first column), 2/vᵀv = 1/(d₂ᵀd₂ − αd₂₁)
        let scale = T::UNIT / (step.left - alpha * step.free[q]);
        let mut v = step.free;
        v[q] -= alpha;
        let mut image = step.primal;
        add_scaled(&mut image, -alpha, &self.j[q]);
        for c in columns::<N>(q..N) {
            add_scaled(&mut self.j[c], -(v[c] * scale), &image);
        }
        self.s[q] = step.dual.map(|dual| -(dual * inverse));
        self.s[q][q] = inverse;
        self.squared[q] = step.squared;
        self.count += 1;
    }

    /// Lets go of active row `k`: one reflection of the active columns turns its row of S into the last axis.
    #[inline]
    pub(crate) fn drop_row(&mut self, k: usize) {
        self.count -= 1;
        let last = self.count;
        let mut v: [T; N] = core::array::from_fn(|c| self.s[c][k]);
        let squared = dot(&v, &v);
        let length = T::root_of(squared);
        let alpha = if v[last] > T::NOTHING { -length } else { length };
        let scale = T::UNIT / (squared - alpha * v[last]);
        v[last] -= alpha;
        let (along_j, along_s) = (combined(&self.j, &v, 0..last + 1), combined(&self.s, &v, 0..last + 1));
        for c in columns::<N>(0..last + 1) {
            add_scaled(&mut self.j[c], -(v[c] * scale), &along_j);
            add_scaled(&mut self.s[c], -(v[c] * scale), &along_s);
            replace_by_last(&mut self.s[c], k, last);
        }
        self.s[last] = [T::NOTHING; N];
        replace_by_last(&mut self.squared, k, last);
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

    /// Returns the smallest step of x, in the metric, that moves each active row inward by its share of `missing`, and its
    /// multipliers.
    #[inline]
    pub(crate) fn onto_rows(&self, missing: &[T; N]) -> ([T; N], [T; N]) {
        let y: [T; N] = core::array::from_fn(|c| dot(&self.s[c], missing));
        (combined(&self.j, &y, 0..self.count), combined(&self.s, &y, 0..self.count))
    }
}

/// Those of `used`, or all.
#[inline]
fn columns<const N: usize>(used: Range<usize>) -> Range<usize> {
    if N > ALL { used } else { 0..N }
}

/// Σ factor · column; outside of `used` one of the two is zero.
#[inline]
fn combined<const N: usize, T: Scalar>(of: &[[T; N]; N], factors: &[T; N], used: Range<usize>) -> [T; N] {
    let mut sum = [T::NOTHING; N];
    for c in columns::<N>(used) {
        add_scaled(&mut sum, factors[c], &of[c]);
    }
    sum
}

/// Entry `last`, the last that is not zero, takes the place of entry `k`.
#[inline]
pub(crate) fn replace_by_last<const N: usize, T: Scalar>(values: &mut [T; N], k: usize, last: usize) {
    values[k] = values[last];
    values[last] = T::NOTHING;
}
