//! V·T·Vᵀ with a tridiagonal T: Householder reflections (Golub and Van Loan, Matrix Computations, 8.3.1).

use super::in_pairs;
use crate::scalar::{Scalar, of};

/// Rows of the largest matrix.
pub(super) const LARGEST: usize = 6;
/// For each row 1 behind it, else 0. A product with it takes several numbers at once, a choice between them does not.
const BEHIND: [[f64; LARGEST]; LARGEST] = {
    let mut behind = [[0.0; LARGEST]; LARGEST];
    let mut k = 0;
    while k < LARGEST {
        let mut i = k + 1;
        while i < LARGEST {
            behind[k][i] = 1.0;
            i += 1;
        }
        k += 1;
    }
    behind
};
/// For each row 1 at the next one.
const NEXT: [[f64; LARGEST]; LARGEST] = {
    let mut next = [[0.0; LARGEST]; LARGEST];
    let mut k = 1;
    while k < LARGEST {
        next[k - 1][k] = 1.0;
        k += 1;
    }
    next
};

/// A symmetric matrix as reflections of a tridiagonal one.
pub(super) struct Tridiagonal<const D: usize, T> {
    pub(super) diagonal: [T; D],
    /// Beside the diagonal; the last one stands beside nothing.
    pub(super) beside: [T; D],
    /// v and β of the reflections I − β·v·vᵀ, the first one of which was the first to be made; v is zero down to the
    /// diagonal, and β of those that are not needed.
    reflections: [([T; D], T); D],
}

impl<const D: usize, T: Scalar> Tridiagonal<D, T> {
    #[cfg(test)]
    pub(super) fn of(a: &[[T; D]; D]) -> Self {
        let mut t = Self::unset();
        t.reduce(&mut a.clone());
        t
    }

    /// Room for a matrix that is reduced where it stands: returned, it would be copied.
    #[inline]
    pub(super) fn unset() -> Self {
        let zero = T::zero();
        Self { diagonal: [zero; D], beside: [zero; D], reflections: [([zero; D], zero); D] }
    }

    /// Reduces a symmetric matrix A by reflections, from its first column on; nothing of it is left.
    ///
    /// With x for what is to be reflected onto α·e, v = x − α·e and A·v = A·x − α·A·e: the products with A do not wait for the
    /// root in α.
    #[inline]
    pub(super) fn reduce(&mut self, rest: &mut [[T; D]; D]) {
        const { assert!(D <= LARGEST, "rows that the tables have") }
        let t = self;
        for k in 0..D.saturating_sub(2) {
            let (column, next) = (&rest[k], &rest[k + 1]);
            let x: [T; D] = core::array::from_fn(|i| column[i] * of(BEHIND[k][i]));
            let mut ax = [T::zero(); D];
            for j in k + 1..D {
                ax = core::array::from_fn(|i| ax[i] + rest[j][i] * x[j]);
            }
            let (first, square, along) = (x[k + 1], in_pairs(&x, &x), in_pairs(&x, &ax));
            let length = square.sqrt();
            let alpha = if first > T::zero() { -length } else { length };
            t.beside[k] = alpha;
            let half = square + first.abs() * length;
            if half > T::zero() {
                let (v, beta) = &mut t.reflections[k];
                *beta = T::one() / half;
                *v = core::array::from_fn(|i| x[i] - alpha * of(NEXT[k][i]));
                // vᵀ·A·v
                let along = along - alpha * (ax[k + 1] + ax[k + 1] - alpha * next[k + 1]);
                let share = *beta * *beta * (along * of(0.5));
                let w: [T; D] = core::array::from_fn(|i| (ax[i] - alpha * next[i]) * *beta - share * v[i]);
                for j in k + 1..D {
                    let (v_j, w_j) = (v[j], w[j]);
                    rest[j] = core::array::from_fn(|i| rest[j][i] - (v[i] * w_j + w[i] * v_j));
                }
            }
        }
        t.diagonal = core::array::from_fn(|i| rest[i][i]);
        if D > 1 {
            t.beside[D - 2] = rest[D - 2][D - 1];
        }
    }

    pub(super) fn trace(&self) -> T {
        self.diagonal.iter().fold(T::zero(), |sum, &d| sum + d)
    }

    /// Vᵀ·B for D rows of C numbers.
    #[inline]
    pub(super) fn turn_there<const C: usize>(&self, b: &mut [[T; C]; D]) {
        turn_there(b, &self.reflections[..D.saturating_sub(2)]);
    }

    /// V·B for D rows of C numbers.
    #[inline]
    pub(super) fn turn_back<const C: usize>(&self, b: &mut [[T; C]; D]) {
        turn_back(b, &self.reflections[..D.saturating_sub(2)]);
    }
}

// How many reflections there are is not known here, so that compilers leave the loop a loop: short code, and B in registers.

#[inline(never)]
fn turn_there<const C: usize, const D: usize, T: Scalar>(b: &mut [[T; C]; D], reflections: &[([T; D], T)]) {
    *b = reflections.iter().fold(*b, reflected);
}

#[inline(never)]
fn turn_back<const C: usize, const D: usize, T: Scalar>(b: &mut [[T; C]; D], reflections: &[([T; D], T)]) {
    *b = reflections.iter().rev().fold(*b, reflected);
}

/// (I − β·v·vᵀ)·B.
#[inline(always)]
fn reflected<const C: usize, const D: usize, T: Scalar>(
    b: [[T; C]; D],
    (v, beta): &([T; D], T),
) -> [[T; C]; D] {
    // every other product apart, as in `in_pairs`
    let mut sums = [[T::zero(); C]; 2];
    for i in 0..D {
        sums[i % 2] = core::array::from_fn(|c| sums[i % 2][c] + v[i] * b[i][c]);
    }
    let share: [T; C] = core::array::from_fn(|c| (sums[0][c] + sums[1][c]) * *beta);
    core::array::from_fn(|i| core::array::from_fn(|c| b[i][c] - v[i] * share[c]))
}
