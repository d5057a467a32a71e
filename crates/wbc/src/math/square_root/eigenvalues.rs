//! V·diag(λ^(−1/2))·Vᵀ: implicit QR steps with Wilkinson's shift make T diagonal (Golub and Van Loan, Matrix Computations,
//! 8.3.3), a 6×6 matrix in about 9. Slower than the poles, and for any condition.

use super::tridiagonal::Tridiagonal;
use crate::linalg::{combined, weighted_outer};
use crate::scalar::{Scalar, of};
use nalgebra::SMatrix;

/// Steps after which it is given up, of each row of the matrix. A step costs a row, seldom two.
const MOST_STEPS: usize = 8;

/// B, D rows of C numbers, becomes T^(−1/2)·B of a tridiagonal T; false if that has no root.
#[cold]
#[inline(never)]
pub(super) fn times_inverse_square_root<const C: usize, const D: usize, T: Scalar>(
    t: &Tridiagonal<D, T>,
    b: &mut [[T; C]; D],
) -> bool {
    let trace = t.trace();
    if !(trace > T::zero() && trace.is_finite()) {
        return false;
    }
    let vectors = SMatrix::<T, D, D>::identity().data.0;
    let mut eigen = Eigen { diagonal: t.diagonal, beside: t.beside, vectors };
    if !eigen.is_made_diagonal() {
        return false;
    }
    let least = trace * T::default_epsilon() * of(16.0);
    let mut columns = eigen.vectors;
    for (column, &value) in columns.iter_mut().zip(&eigen.diagonal) {
        // not a number is never diagonal
        if value < -least * of(100.0) {
            return false;
        }
        let scale = T::one() / value.max(least).sqrt().sqrt();
        *column = column.map(|x| x * scale);
    }
    let root = weighted_outer(&SMatrix::from(columns), &[T::one(); D]);
    *b = root.data.0.map(|row| combined(b, &row));
    true
}

/// V·T·Vᵀ on the way to a diagonal T.
struct Eigen<const D: usize, T> {
    diagonal: [T; D],
    beside: [T; D],
    /// Columns of V.
    vectors: [[T; D]; D],
}

impl<const D: usize, T: Scalar> Eigen<D, T> {
    /// Turns T until nothing stands beside its diagonal; false if that takes too long, as it does with NaN.
    fn is_made_diagonal(&mut self) -> bool {
        let mut last = D - 1;
        for _ in 0..MOST_STEPS * D {
            while last > 0 && self.is_split_before(last) {
                last -= 1;
            }
            if last == 0 {
                return true;
            }
            let mut first = last - 1;
            while first > 0 && !self.is_split_before(first) {
                first -= 1;
            }
            self.step(first, last);
        }
        false
    }

    /// Returns true if the element between row `i` and the one before is lost in rounding.
    #[inline]
    fn is_split_before(&self, i: usize) -> bool {
        let [d, before] = [self.diagonal[i], self.diagonal[i - 1]];
        self.beside[i - 1].abs() <= T::default_epsilon() * (d.abs() + before.abs())
    }

    /// One implicit QR step on the rows `first` to `last`: the shift is the eigenvalue of the last two that is nearer to the
    /// last.
    #[inline]
    fn step(&mut self, first: usize, last: usize) {
        let Self { diagonal, beside, vectors } = self;
        let coupling = beside[last - 1];
        let half = (diagonal[last - 1] - diagonal[last]) * of(0.5);
        let root = (half * half + coupling * coupling).sqrt();
        let far = if half < T::zero() { half - root } else { half + root };
        let shift = diagonal[last] - coupling * coupling / far;
        // what is to be turned away, and how far the row has been turned by the rotation before
        let (mut x, mut z) = (diagonal[first] - shift, beside[first]);
        for k in first..last {
            let length = (x * x + z * z).sqrt();
            if length <= T::zero() {
                break;
            }
            let inverse = T::one() / length;
            let (cos, sin) = (x * inverse, z * inverse);
            if k > first {
                beside[k - 1] = length;
            }
            let (a, b, c) = (diagonal[k], beside[k], diagonal[k + 1]);
            // c − a is what the rotation shares out, and twice b
            let share = sin * (c - a) + (cos + cos) * b;
            let moved = sin * share;
            diagonal[k] = a + moved;
            diagonal[k + 1] = c - moved;
            x = cos * share - b;
            beside[k] = x;
            if k + 1 < last {
                z = sin * beside[k + 1];
                beside[k + 1] *= cos;
            }
            let (v, w) = (vectors[k], vectors[k + 1]);
            vectors[k] = core::array::from_fn(|i| cos * v[i] + sin * w[i]);
            vectors[k + 1] = core::array::from_fn(|i| cos * w[i] - sin * v[i]);
        }
    }
}
