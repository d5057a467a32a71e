//! Small dense kernels with constant sizes. Cholesky is what the control path factorises with: it takes a fixed
//! number of steps for any input and refuses what is not positive definite, NaN included.
//!
//! ```
//! use moca_wbc::linalg::Cholesky;
//! use moca_wbc::nalgebra::Matrix2;
//!
//! let factor = Cholesky::new(&Matrix2::new(4.0, 2.0, 2.0, 3.0)).ok_or("not positive definite")?;
//! assert_eq!(factor.solve(&[8.0, 8.0]), [1.0, 2.0]);
//! assert!(Cholesky::new(&Matrix2::new(1.0, 2.0, 2.0, 1.0)).is_none());
//! assert!(Cholesky::new(&Matrix2::new(f64::NAN, 0.0, 0.0, 1.0)).is_none());
//! # Ok::<(), &str>(())
//! ```

use crate::scalar::{Scalar, of};
use nalgebra::SMatrix;

/// A = L·D·Lᵀ of a symmetric positive-definite D×D matrix, L with a unit diagonal: Cholesky without its square roots,
/// which are a chain that everything else waits for.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Cholesky<const D: usize, T> {
    /// Columns of L; only their entries below the diagonal are used.
    columns: [[T; D]; D],
    diagonal: [T; D],
    inverse_diagonal: [T; D],
}

impl<const D: usize, T: Scalar> Cholesky<D, T> {
    /// Factorises the lower triangle of `a`; `None` if it is not positive definite or not finite.
    #[inline]
    pub fn new(a: &SMatrix<T, D, D>) -> Option<Self> {
        let mut factor = Self::unset();
        factor.factorise(a).then_some(factor)
    }

    /// Room for factors that are computed where they stand: returned, they would be copied.
    #[inline]
    pub(crate) fn unset() -> Self {
        let zero = [T::zero(); D];
        Self { columns: [zero; D], diagonal: zero, inverse_diagonal: zero }
    }

    /// Becomes what [`Cholesky::new`] gives; false if that is `None`. Its code is long, and once for all who call it.
    #[inline(never)]
    pub(crate) fn factorise(&mut self, a: &SMatrix<T, D, D>) -> bool {
        let Self { columns, diagonal, inverse_diagonal } = self;
        // no early return: straight-line code is what compilers make fast, and NaN only stays NaN
        let mut definite = true;
        // what is left to do stays in registers: read in pairs just after it was written in others, memory would have to wait
        let mut rest = a.data.0;
        for k in 0..D {
            let (pivot, inverse) = (rest[k][k], T::one() / rest[k][k]);
            // that of an infinite pivot is 0
            definite &= (pivot > T::zero()) & (inverse > T::zero());
            (diagonal[k], inverse_diagonal[k]) = (pivot, inverse);
            for j in k + 1..D {
                let factor = rest[k][j] * inverse;
                for i in j..D {
                    rest[j][i] -= factor * rest[k][i];
                }
                columns[k][j] = factor;
            }
        }
        definite
    }

    /// Diagonal of D.
    #[inline]
    pub fn diagonal(&self) -> &[T; D] {
        &self.diagonal
    }

    /// Diagonal of D⁻¹.
    #[inline]
    pub fn inverse_diagonal(&self) -> &[T; D] {
        &self.inverse_diagonal
    }

    /// As [`Cholesky::new`]; a matrix that is singular to rounding is retried with a shift relative to its trace, so
    /// that a well-conditioned matrix loses nothing. `None` if it is not even positive semi-definite, or not finite.
    #[inline]
    pub fn new_shifted(a: &SMatrix<T, D, D>) -> Option<Self> {
        let mut factor = Self::unset();
        factor.factorise_shifted(a).then_some(factor)
    }

    /// Becomes what [`Cholesky::new_shifted`] gives; false if that is `None`.
    #[inline]
    pub(crate) fn factorise_shifted(&mut self, a: &SMatrix<T, D, D>) -> bool {
        self.factorise(a) || self.shift(a)
    }

    #[cold]
    fn shift(&mut self, a: &SMatrix<T, D, D>) -> bool {
        let trace = a.trace();
        let mut relative = of::<T>(1e-12).max(T::default_epsilon() * of(16.0));
        for _ in 0..3 {
            let mut shifted = *a;
            for i in 0..D {
                shifted[(i, i)] += trace * relative;
            }
            if self.factorise(&shifted) {
                return true;
            }
            relative *= of(10.0);
        }
        false
    }

    /// L⁻¹·b.
    #[inline]
    pub fn solve_lower(&self, b: &[T; D]) -> [T; D] {
        let mut x = *b;
        for i in 0..D {
            for k in 0..i {
                let known = x[k];
                x[i] -= self.columns[k][i] * known;
            }
        }
        x
    }

    /// L⁻¹·B for D rows of C numbers, all columns at once.
    #[inline]
    pub fn solve_lower_rows<const C: usize>(&self, b: &[[T; C]; D]) -> [[T; C]; D] {
        let mut x = *b;
        for i in 0..D {
            let mut row = x[i];
            for k in 0..i {
                subtract_scaled(&mut row, self.columns[k][i], &x[k]);
            }
            x[i] = row;
        }
        x
    }

    /// L⁻ᵀ·B for D rows of C numbers, all columns at once.
    #[inline]
    pub fn solve_upper_rows<const C: usize>(&self, b: &[[T; C]; D]) -> [[T; C]; D] {
        let mut x = *b;
        for i in (0..D).rev() {
            let mut row = x[i];
            for k in i + 1..D {
                subtract_scaled(&mut row, self.columns[i][k], &x[k]);
            }
            x[i] = row;
        }
        x
    }

    /// A⁻¹·b.
    #[inline]
    pub fn solve(&self, b: &[T; D]) -> [T; D] {
        let mut x = self.solve_lower(b);
        for i in (0..D).rev() {
            let mut sum = x[i] * self.inverse_diagonal[i];
            for k in i + 1..D {
                sum -= self.columns[i][k] * x[k];
            }
            x[i] = sum;
        }
        x
    }

    /// L·b.
    #[inline]
    pub fn times(&self, b: &[T; D]) -> [T; D] {
        core::array::from_fn(|i| {
            let mut sum = b[i];
            for k in 0..i {
                sum += self.columns[k][i] * b[k];
            }
            sum
        })
    }

    /// Lᵀ·B for D rows of C numbers.
    #[inline]
    pub fn transpose_times_rows<const C: usize>(&self, b: &[[T; C]; D]) -> [[T; C]; D] {
        core::array::from_fn(|i| {
            let mut row = b[i];
            for k in i + 1..D {
                subtract_scaled(&mut row, -self.columns[i][k], &b[k]);
            }
            row
        })
    }
}

/// aᵀ·b.
#[inline]
pub fn dot<const D: usize, T: Scalar>(a: &[T; D], b: &[T; D]) -> T {
    let mut sum = a[0] * b[0];
    for i in 1..D {
        sum += a[i] * b[i];
    }
    sum
}

/// row − factor·other, in place.
#[inline]
fn subtract_scaled<const C: usize, T: Scalar>(row: &mut [T; C], factor: T, other: &[T; C]) {
    for (a, &b) in row.iter_mut().zip(other) {
        *a -= factor * b;
    }
}

/// A·diag(w)·Aᵀ of an R×C matrix.
#[inline]
pub fn weighted_outer<const R: usize, const C: usize, T: Scalar>(
    a: &SMatrix<T, R, C>,
    weights: &[T; C],
) -> SMatrix<T, R, R> {
    let mut out = [[T::zero(); R]; R];
    // as many at once as there are registers for
    add_outer::<0, 2, R, T>(&mut out, &a.data.0, weights);
    add_outer::<2, R, R, T>(&mut out, &a.data.0, weights);
    for j in 0..R {
        for i in 0..j / 2 * 2 {
            out[j][i] = out[i][j];
        }
    }
    SMatrix::from(out)
}

/// Adds Σ weights_k·columns_k·columns_kᵀ to the columns FROM to TO, at and below the diagonal. How many there are to add is not known
/// here, so that compilers leave the loop a loop.
#[inline(never)]
fn add_outer<const FROM: usize, const TO: usize, const R: usize, T: Scalar>(
    out: &mut [[T; R]; R],
    columns: &[[T; R]],
    weights: &[T],
) {
    for (column, &weight) in columns.iter().zip(weights) {
        for j in FROM..TO.min(R) {
            let scale = column[j] * weight;
            // in pairs: above the diagonal there is one more now and then
            for i in j / 2 * 2..R {
                out[j][i] += scale * column[i];
            }
        }
    }
}

/// A·x for an R×C matrix.
#[inline]
pub fn times<const R: usize, const C: usize, T: Scalar>(a: &SMatrix<T, R, C>, x: &[T; C]) -> [T; R] {
    combined(&a.data.0, x)
}

/// Aᵀ·x for an R×C matrix.
#[inline]
pub fn transpose_times<const R: usize, const C: usize, T: Scalar>(
    a: &SMatrix<T, R, C>,
    x: &[T; R],
) -> [T; C] {
    let mut out = [T::zero(); C];
    dots(&mut out, &a.data.0, x);
    out
}

/// Products of columns with x. How many there are is not known here, so that compilers leave the loop a loop.
#[inline(never)]
fn dots<const R: usize, T: Scalar>(out: &mut [T], columns: &[[T; R]], x: &[T; R]) {
    for (out, column) in out.iter_mut().zip(columns) {
        *out = dot(column, x);
    }
}

/// Σ weights_k·rows_k.
#[inline]
pub(crate) fn combined<const R: usize, const C: usize, T: Scalar>(
    rows: &[[T; C]; R],
    weights: &[T; R],
) -> [T; C] {
    let mut out = [T::zero(); C];
    for (row, &weight) in rows.iter().zip(weights) {
        for (out, &value) in out.iter_mut().zip(row) {
            *out += weight * value;
        }
    }
    out
}
