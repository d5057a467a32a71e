//! Small dense kernels with constant sizes. Cholesky is the only factorisation in the control path: it takes a fixed
//! number of steps for any input and refuses what is not positive definite, NaN included.

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
        let mut columns = a.data.0;
        let (mut diagonal, mut inverse_diagonal) = ([T::zero(); D], [T::zero(); D]);
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
        definite.then_some(Self { columns, diagonal, inverse_diagonal })
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

    /// A⁻¹ = L⁻ᵀ·D⁻¹·L⁻¹.
    #[inline]
    pub fn inverse(&self) -> SMatrix<T, D, D> {
        let rows = self.solve_lower_rows(&SMatrix::<T, D, D>::identity().data.0);
        weighted_outer(&SMatrix::from(rows), &self.inverse_diagonal)
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
    let mut out = [T::zero(); R];
    for (column, &x) in a.data.0.iter().zip(x) {
        for (out, &a) in out.iter_mut().zip(column) {
            *out += a * x;
        }
    }
    out
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
/// is near I its series ends it. At most 12 inverses, whatever the input.
pub fn inverse_square_root<const D: usize, T: Scalar>(a: &SMatrix<T, D, D>) -> Option<SMatrix<T, D, D>> {
    let (half, quarter) = (of::<T>(0.5), of::<T>(0.25));
    // added as matrices: a number written alone makes the wide loads after it wait
    let unit = SMatrix::<T, D, D>::identity();
    let half_unit = unit * half;
    let (mut m, mut x) = (*a, unit);
    let (mut scale, mut scaled) = (true, T::one());
    for step in 0..12 {
        let inverse = Cholesky::new_shifted(&m)?.inverse();
        let mut factor = T::one();
        if scale {
            // near 1/√(λ_min·λ_max), which is the best
            let ratio: T = sum_of_squares(&inverse.data.0) / sum_of_squares(&m.data.0);
            factor = ratio.sqrt().sqrt();
            if !(factor > T::zero() && factor.is_finite()) {
                return None;
            }
            scaled *= factor;
        }
        let of_inverse = half / factor;
        let average = inverse.zip_map(&half_unit, |inverse, half_unit| of_inverse * inverse + half_unit);
        let (of_m, of_inverse) = (quarter * factor, half * of_inverse);
        // the next M less I
        let error = m.zip_zip_map(&inverse, &half_unit, |m, inverse, half_unit| {
            of_m * m + of_inverse * inverse - half_unit
        });
        m = error + unit;
        x = if step == 0 { average } else { product(&x, &average) };
        let squared = sum_of_squares(&error.data.0);
        if squared * squared * squared < T::default_epsilon() * T::default_epsilon() {
            // M^(−1/2) = I − E/2 + 3/8·E² − … with E = M − I
            let series = product(&error, &error).zip_zip_map(&error, &unit, |square, error, unit| {
                of::<T>(0.375) * square - half * error + unit
            });
            x = product(&x, &series);
            break;
        }
        scale = squared > quarter;
    }
    // the iterates commute, so the limit is symmetric up to rounding
    let half = half * scaled.sqrt();
    Some(SMatrix::from_fn(|i, j| half * (x[(i, j)] + x[(j, i)])))
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

/// A·B of D×D matrices.
#[inline]
fn product<const D: usize, T: Scalar>(a: &SMatrix<T, D, D>, b: &SMatrix<T, D, D>) -> SMatrix<T, D, D> {
    let mut out = [[T::zero(); D]; D];
    for (out, column) in out.iter_mut().zip(&b.data.0) {
        *out = times(a, column);
    }
    SMatrix::from(out)
}
