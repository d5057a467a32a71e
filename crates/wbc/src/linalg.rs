//! Small dense kernels with constant sizes. Cholesky is the only factorisation in the control path: it takes a fixed
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
        factor.factorise(&a.data.0).then_some(factor)
    }

    /// Room for a factorisation that is made where it stands: returned, it would be copied.
    fn unset() -> Self {
        let zero = T::zero();
        Self { columns: [[zero; D]; D], diagonal: [zero; D], inverse_diagonal: [zero; D] }
    }

    /// Becomes the factorisation of `a`; false if it is not positive definite or not finite.
    #[inline]
    fn factorise(&mut self, a: &[[T; D]; D]) -> bool {
        let Self { columns, diagonal, inverse_diagonal } = self;
        *columns = *a;
        // no early return: straight-line code is what compilers make fast, and NaN only stays NaN
        let mut definite = true;
        for k in 0..D {
            let pivot = columns[k][k];
            definite &= pivot > T::zero() && pivot.is_finite();
            diagonal[k] = pivot;
            inverse_diagonal[k] = T::one() / pivot;
            for j in k + 1..D {
                let factor = columns[k][j] * inverse_diagonal[k];
                for i in j..D {
                    columns[j][i] -= factor * columns[k][i];
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
        Self::new(a).or_else(|| Self::shifted(a))
    }

    #[cold]
    fn shifted(a: &SMatrix<T, D, D>) -> Option<Self> {
        let trace = a.trace();
        let mut relative = of::<T>(1e-12).max(T::default_epsilon() * of(16.0));
        for _ in 0..3 {
            let mut shifted = *a;
            for i in 0..D {
                shifted[(i, i)] += trace * relative;
            }
            if let Some(factor) = Self::new(&shifted) {
                return Some(factor);
            }
            relative *= of(10.0);
        }
        None
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

    /// out = A⁻¹ = L⁻ᵀ·D⁻¹·L⁻¹.
    #[inline]
    fn write_inverse(&self, out: &mut [[T; D]; D]) {
        let lower = self.solve_lower_rows(&SMatrix::<T, D, D>::identity().data.0);
        let mut scaled = lower;
        for i in 0..D {
            for j in 0..D {
                scaled[i][j] *= self.inverse_diagonal[i];
            }
        }
        for i in 0..D {
            let mut row = [T::zero(); D];
            // L⁻¹ is lower triangular
            for k in i..D {
                subtract_scaled(&mut row, -lower[k][i], &scaled[k]);
            }
            out[i] = row;
        }
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
    for (column, &w) in a.data.0.iter().zip(weights) {
        for (out, &scale) in out.iter_mut().zip(column) {
            let scale = scale * w;
            for (out, &x) in out.iter_mut().zip(column) {
                *out += scale * x;
            }
        }
    }
    SMatrix::from(out)
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
    core::array::from_fn(|i| dot(&a.data.0[i], x))
}

/// A^(−1/2) of a symmetric positive-definite matrix, by the scaled product form of the Denman–Beavers iteration
/// (Cheng, Higham, Kenney, Laub 2001): X ← X·(I + M⁻¹)/2 while M goes to I and X·M^(−1/2) stays what is sought. Once M
/// is near I its series ends it. At most 12 inverses, whatever the input; of an ordinary arm 3.
pub fn inverse_square_root<const D: usize, T: Scalar>(a: &SMatrix<T, D, D>) -> Option<SMatrix<T, D, D>> {
    let (one, half) = (T::one(), of::<T>(0.5));
    // added as a matrix: a number written alone makes the wide loads after it wait
    let half_unit = SMatrix::<T, D, D>::identity().data.0.map(|column| column.map(|unit| half * unit));
    let zero = [[T::zero(); D]; D];
    let (mut m, mut x, mut average, mut error, mut inverse, mut next) =
        (a.data.0, zero, zero, zero, zero, zero);
    let mut factor_m = Cholesky::unset();
    let (mut spread, mut scaled) = (one, one);
    for step in 0..12 {
        if !factor_m.factorise(&m) {
            factor_m = Cholesky::shifted(&SMatrix::from(m))?;
        }
        factor_m.write_inverse(&mut inverse);
        let factor = if step == 0 {
            // near 1/√(λ_min·λ_max), which is the best; M's eigenvalues are then within 1/spread and spread
            let (large, small) = (sum_of_squares(&m), sum_of_squares(&inverse));
            spread = (large * small).sqrt().sqrt();
            (small / large).sqrt().sqrt()
        } else {
            // M is within 1 and the square of this: the best factor is known without a look at it
            spread = (half * (one + half * (spread + one / spread))).sqrt();
            one / spread
        };
        if !(factor > T::zero() && factor.is_finite()) {
            return None;
        }
        scaled *= factor;
        let (of_inverse, of_m) = (half / factor, half * half * factor);
        let of_inverse_next = half * of_inverse;
        for i in 0..D {
            for j in 0..D {
                average[i][j] = of_inverse * inverse[i][j] + half_unit[i][j];
                // the next M less I
                error[i][j] = of_m * m[i][j] + of_inverse_next * inverse[i][j] - half_unit[i][j];
                m[i][j] = error[i][j] + (half_unit[i][j] + half_unit[i][j]);
            }
        }
        if step == 0 {
            x = average;
        } else {
            write_product(&mut next, &x, &average);
            x = next;
        }
        if sum_of_squares(&error) < of(SERIES_FROM * SERIES_FROM) {
            write_series(&mut average, &error);
            write_product(&mut next, &x, &average);
            // the iterates commute, so the limit is symmetric up to rounding
            let half = half * scaled.sqrt();
            return Some(SMatrix::from_fn(|i, j| half * (next[j][i] + next[i][j])));
        }
    }
    None
}

/// Norm of E from which on the series of (I + E)^(−1/2) to the sixth power is exact to rounding.
const SERIES_FROM: f64 = 0.01;

/// out = (I + E)^(−1/2) for a small E: Σ c_k·E^k to the sixth power, as p(E) + E³·q(E).
#[inline]
fn write_series<const D: usize, T: Scalar>(out: &mut [[T; D]; D], e: &[[T; D]; D]) {
    let c = [1.0, -0.5, 0.375, -0.3125, 0.273_437_5, -0.246_093_75, 0.225_585_937_5].map(of::<T>);
    let zero = [[T::zero(); D]; D];
    let (mut square, mut cube, mut q) = (zero, zero, zero);
    write_product(&mut square, e, e);
    write_product(&mut cube, &square, e);
    for i in 0..D {
        for j in 0..D {
            let unit = if i == j { c[3] } else { T::zero() };
            q[i][j] = unit + c[4] * e[i][j] + c[5] * square[i][j] + c[6] * cube[i][j];
        }
    }
    write_product(out, &cube, &q);
    for i in 0..D {
        for j in 0..D {
            let unit = if i == j { c[0] } else { T::zero() };
            out[i][j] += unit + c[1] * e[i][j] + c[2] * square[i][j];
        }
    }
}

/// Squared Frobenius norm.
#[inline]
fn sum_of_squares<const D: usize, T: Scalar>(a: &[[T; D]; D]) -> T {
    let mut lanes = [T::zero(); D];
    for column in a {
        for (lane, &value) in lanes.iter_mut().zip(column) {
            *lane += value * value;
        }
    }
    lanes.into_iter().fold(T::zero(), |sum, lane| sum + lane)
}

/// out = A·B of D×D matrices.
#[inline]
fn write_product<const D: usize, T: Scalar>(out: &mut [[T; D]; D], a: &[[T; D]; D], b: &[[T; D]; D]) {
    for (out, column) in out.iter_mut().zip(b) {
        *out = combined(a, column);
    }
}

/// Σ weights_k·rows_k.
#[inline]
fn combined<const R: usize, const C: usize, T: Scalar>(rows: &[[T; C]; R], weights: &[T; R]) -> [T; C] {
    let mut out = [T::zero(); C];
    for (row, &weight) in rows.iter().zip(weights) {
        for (out, &value) in out.iter_mut().zip(row) {
            *out += weight * value;
        }
    }
    out
}
