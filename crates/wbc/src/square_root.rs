//! A^(−1/2) of a small symmetric positive-definite matrix, by its eigenvalues: V·diag(λ^(−1/2))·Vᵀ.
//!
//! Householder reflections make A tridiagonal, implicit QR steps with Wilkinson's shift make that diagonal (Golub and Van
//! Loan, Matrix Computations, 8.3): a 6×6 matrix takes 4 reflections and about 9 steps. Both only turn the matrix, so
//! the result errs by ε times the condition of A, as that of any method that does not know A's factors. An iteration on
//! inverses of the whole matrix does four times the arithmetic, and its end has to be told from its middle.
//!
//! ```
//! use moca_wbc::nalgebra::Matrix2;
//! use moca_wbc::square_root::inverse_square_root;
//!
//! let a = Matrix2::new(5.0, 4.0, 4.0, 5.0); // eigenvalues 9 and 1
//! let root = inverse_square_root(&a).ok_or("not positive definite")?;
//! assert!((root * a * root - Matrix2::identity()).amax() < 1e-14);
//! assert!(inverse_square_root(&Matrix2::new(1.0, 2.0, 2.0, 1.0)).is_none());
//! assert!(inverse_square_root(&Matrix2::new(f64::NAN, 0.0, 0.0, 1.0)).is_none());
//! # Ok::<(), &str>(())
//! ```

use crate::linalg::dot;
use crate::scalar::{Scalar, of};
use nalgebra::SMatrix;

/// Steps after which it is given up, of each row of the matrix. A step costs a row, seldom two.
const MOST_STEPS: usize = 8;

/// A^(−1/2) of a symmetric positive-definite matrix; `None` if it is not even semi-definite, or not finite. A direction
/// whose eigenvalue is lost in rounding, below 16·ε of the trace, is taken to have that one.
#[inline(never)]
pub fn inverse_square_root<const D: usize, T: Scalar>(a: &SMatrix<T, D, D>) -> Option<SMatrix<T, D, D>> {
    let trace = a.trace();
    if !(trace > T::zero() && trace.is_finite()) {
        return None;
    }
    let mut turned = Tridiagonal::of(&a.data.0);
    if !turned.is_made_diagonal() {
        return None;
    }
    let least = trace * T::default_epsilon() * of(16.0);
    let mut columns = turned.vectors;
    for (column, &value) in columns.iter_mut().zip(&turned.diagonal) {
        // not a number is never diagonal
        if value < -least * of(100.0) {
            return None;
        }
        let scale = T::one() / value.max(least).sqrt().sqrt();
        *column = column.map(|x| x * scale);
    }
    let unit = [T::one(); D];
    Some(crate::linalg::weighted_outer(&SMatrix::from(columns), &unit))
}

/// V·T·Vᵀ with a symmetric tridiagonal T.
struct Tridiagonal<const D: usize, T> {
    diagonal: [T; D],
    /// Beside the diagonal; the last one stands beside nothing.
    beside: [T; D],
    /// Columns of V.
    vectors: [[T; D]; D],
}

impl<const D: usize, T: Scalar> Tridiagonal<D, T> {
    /// Of a symmetric matrix: from its first column on, each is reflected to what T has of it.
    fn of(a: &[[T; D]; D]) -> Self {
        let zero = T::zero();
        let mut rest = *a;
        let mut t =
            Self { diagonal: [zero; D], beside: [zero; D], vectors: SMatrix::<T, D, D>::identity().data.0 };
        for k in 0..D.saturating_sub(2) {
            // I − β·v·vᵀ, v zero down to the diagonal: columns stay whole, and those before are done with
            let mut v = rest[k];
            v[..=k].fill(zero);
            let (first, length) = (v[k + 1], dot(&v, &v).sqrt());
            let reflected = if first > zero { -length } else { length };
            t.beside[k] = reflected;
            let half = length * length - first * reflected;
            if half <= zero {
                continue;
            }
            v[k + 1] = first - reflected;
            let beta = T::one() / half;
            let (mut p, mut u) = ([zero; D], [zero; D]);
            for j in k + 1..D {
                p = core::array::from_fn(|i| p[i] + rest[j][i] * v[j]);
                u = core::array::from_fn(|i| u[i] + t.vectors[j][i] * v[j]);
            }
            let share = dot(&p, &v) * beta * of(0.5);
            let w: [T; D] = core::array::from_fn(|i| (p[i] - share * v[i]) * beta);
            for j in k + 1..D {
                let (v_j, w_j) = (v[j], w[j]);
                rest[j] = core::array::from_fn(|i| rest[j][i] - (v[i] * w_j + w[i] * v_j));
                let scale = beta * v_j;
                t.vectors[j] = core::array::from_fn(|i| t.vectors[j][i] - u[i] * scale);
            }
        }
        t.diagonal = core::array::from_fn(|i| rest[i][i]);
        if D > 1 {
            t.beside[D - 2] = rest[D - 2][D - 1];
        }
        t
    }

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

    /// Whether what stands between row `i` and the one before is lost in rounding.
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
