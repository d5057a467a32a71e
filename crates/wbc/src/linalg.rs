//! Small dense kernels with constant sizes. Cholesky is the only factorisation in the control path: it takes a fixed
//! number of steps for any input and refuses what is not positive definite, NaN included.

use crate::scalar::{Scalar, of};
use nalgebra::SMatrix;

/// A = L·Lᵀ of a symmetric positive-definite D×D matrix.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Cholesky<const D: usize, T> {
    /// Rows of L; only the lower triangle is used.
    rows: [[T; D]; D],
    /// 1 / diagonal of L.
    inverse_diagonal: [T; D],
}

impl<const D: usize, T: Scalar> Cholesky<D, T> {
    /// Factorises the lower triangle of `a`; `None` if it is not positive definite or not finite.
    #[inline]
    pub fn new(a: &SMatrix<T, D, D>) -> Option<Self> {
        let a = &a.data.0;
        let mut rows = [[T::zero(); D]; D];
        let mut inverse_diagonal = [T::zero(); D];
        for i in 0..D {
            for j in 0..i {
                let mut sum = a[j][i];
                for k in 0..j {
                    sum -= rows[i][k] * rows[j][k];
                }
                rows[i][j] = sum * inverse_diagonal[j];
            }
            let mut pivot = a[i][i];
            for k in 0..i {
                pivot -= rows[i][k] * rows[i][k];
            }
            if !(pivot > T::zero() && pivot.is_finite()) {
                return None;
            }
            rows[i][i] = pivot.sqrt();
            inverse_diagonal[i] = T::one() / rows[i][i];
        }
        Some(Self { rows, inverse_diagonal })
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
            let mut sum = x[i];
            for k in 0..i {
                sum -= self.rows[i][k] * x[k];
            }
            x[i] = sum * self.inverse_diagonal[i];
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
                subtract_scaled(&mut row, self.rows[i][k], &x[k]);
            }
            x[i] = row.map(|value| value * self.inverse_diagonal[i]);
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
                subtract_scaled(&mut row, self.rows[k][i], &x[k]);
            }
            x[i] = row.map(|value| value * self.inverse_diagonal[i]);
        }
        x
    }

    /// L⁻ᵀ·b.
    #[inline]
    pub fn solve_upper(&self, b: &[T; D]) -> [T; D] {
        let mut x = *b;
        for i in (0..D).rev() {
            let mut sum = x[i];
            for k in i + 1..D {
                sum -= self.rows[k][i] * x[k];
            }
            x[i] = sum * self.inverse_diagonal[i];
        }
        x
    }

    /// A⁻¹·b.
    #[inline]
    pub fn solve(&self, b: &[T; D]) -> [T; D] {
        self.solve_upper(&self.solve_lower(b))
    }

    /// L·b.
    #[inline]
    pub fn times(&self, b: &[T; D]) -> [T; D] {
        core::array::from_fn(|i| {
            let mut sum = T::zero();
            for k in 0..=i {
                sum += self.rows[i][k] * b[k];
            }
            sum
        })
    }

    /// Lᵀ·B for D rows of C numbers.
    #[inline]
    pub fn transpose_times_rows<const C: usize>(&self, b: &[[T; C]; D]) -> [[T; C]; D] {
        core::array::from_fn(|i| {
            let mut row = [T::zero(); C];
            for k in i..D {
                subtract_scaled(&mut row, -self.rows[k][i], &b[k]);
            }
            row
        })
    }

    /// A⁻¹, exactly symmetric.
    #[inline]
    pub fn inverse(&self) -> SMatrix<T, D, D> {
        let mut lower_inverse = [[T::zero(); D]; D];
        for (i, column) in lower_inverse.iter_mut().enumerate() {
            let mut unit = [T::zero(); D];
            unit[i] = T::one();
            *column = self.solve_lower(&unit);
        }
        gram(&SMatrix::<T, D, D>::from(lower_inverse))
    }

    /// det A.
    #[inline]
    pub fn determinant(&self) -> T {
        let mut product = T::one();
        for i in 0..D {
            product *= self.rows[i][i] * self.rows[i][i];
        }
        product
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

/// AᵀA of an R×C matrix, exactly symmetric.
#[inline]
pub fn gram<const R: usize, const C: usize, T: Scalar>(a: &SMatrix<T, R, C>) -> SMatrix<T, C, C> {
    let columns = &a.data.0;
    let mut out = [[T::zero(); C]; C];
    for i in 0..C {
        for j in 0..=i {
            let value = dot(&columns[i], &columns[j]);
            out[i][j] = value;
            out[j][i] = value;
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
/// (Cheng, Higham, Kenney, Laub 2001): at most 12 Cholesky inverses, whatever the input.
pub fn inverse_square_root<const D: usize, T: Scalar>(a: &SMatrix<T, D, D>) -> Option<SMatrix<T, D, D>> {
    let half = of::<T>(0.5);
    let tolerance = T::default_epsilon().sqrt();
    let root_power = of::<T>(-0.5) / of(f64::from(u32::try_from(D).ok()?));
    let mut m = *a;
    let mut x = SMatrix::<T, D, D>::identity();
    let mut scale = true;
    for _ in 0..12 {
        let factor = Cholesky::new_shifted(&m)?;
        let mut inverse = factor.inverse();
        if scale {
            let mu2 = factor.determinant().powf(root_power + root_power);
            if !(mu2 > T::zero() && mu2.is_finite()) {
                return None;
            }
            m *= mu2;
            inverse /= mu2;
            x *= mu2.sqrt();
        }
        let mut distance = T::zero();
        let mut average = inverse;
        for i in 0..D {
            average[(i, i)] += T::one();
            for j in 0..D {
                let target = if i == j { T::one() } else { T::zero() };
                distance = distance.max((m[(i, j)] - target).abs());
                m[(i, j)] = half * (m[(i, j)] + inverse[(i, j)]) * half;
            }
            m[(i, i)] += half;
        }
        x = product(&x, &average) * half;
        if distance < tolerance {
            break;
        }
        scale = distance > of(0.1);
    }
    // the iterates commute, so the limit is symmetric up to rounding
    Some(SMatrix::from_fn(|i, j| half * (x[(i, j)] + x[(j, i)])))
}

/// A·B of D×D matrices.
#[inline]
fn product<const D: usize, T: Scalar>(a: &SMatrix<T, D, D>, b: &SMatrix<T, D, D>) -> SMatrix<T, D, D> {
    SMatrix::from(b.data.0.map(|column| times(a, &column)))
}
