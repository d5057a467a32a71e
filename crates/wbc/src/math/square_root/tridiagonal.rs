//! V·T·Vᵀ with a tridiagonal T: Householder reflections (Golub and Van Loan, Matrix Computations, 8.3.1).

use crate::linalg::dot;
use crate::scalar::{Scalar, of};

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
    /// Reduces a symmetric matrix by reflections, from its first column on.
    #[inline]
    pub(super) fn of(a: &[[T; D]; D]) -> Self {
        let zero = T::zero();
        let mut rest = *a;
        let mut t = Self { diagonal: [zero; D], beside: [zero; D], reflections: [([zero; D], zero); D] };
        for k in 0..D.saturating_sub(2) {
            let (v, beta) = &mut t.reflections[k];
            *v = rest[k];
            v[..=k].fill(zero);
            let (first, length) = (v[k + 1], dot(v, v).sqrt());
            let reflected = if first > zero { -length } else { length };
            t.beside[k] = reflected;
            let half = length * length - first * reflected;
            if half > zero {
                v[k + 1] = first - reflected;
                *beta = T::one() / half;
                reflect(&mut rest, v, *beta, [k + 1; 2]);
            }
        }
        t.diagonal = core::array::from_fn(|i| rest[i][i]);
        if D > 1 {
            t.beside[D - 2] = rest[D - 2][D - 1];
        }
        t
    }

    pub(super) fn trace(&self) -> T {
        self.diagonal.iter().fold(T::zero(), |sum, &d| sum + d)
    }

    /// Turns a symmetric F to V·F·Vᵀ.
    #[inline]
    pub(super) fn turn_back(&self, f: &mut [[T; D]; D]) {
        for (k, (v, beta)) in self.reflections[..D.saturating_sub(2)].iter().enumerate().rev() {
            reflect(f, v, *beta, [k + 1, 0]);
        }
    }

    /// V·F.
    pub(super) fn turned(&self, mut f: [[T; D]; D]) -> [[T; D]; D] {
        for (v, beta) in self.reflections.iter().rev() {
            for column in &mut f {
                let share = dot(v, column) * *beta;
                *column = core::array::from_fn(|i| column[i] - share * v[i]);
            }
        }
        f
    }
}

/// (I − β·v·vᵀ)·A·(I − β·v·vᵀ) of a symmetric A, of its columns from `first` on; v is zero before its row `begins`.
#[inline(never)]
fn reflect<const D: usize, T: Scalar>(a: &mut [[T; D]; D], v: &[T; D], beta: T, [begins, first]: [usize; 2]) {
    let mut p = [T::zero(); D];
    for j in begins..D {
        p = core::array::from_fn(|i| p[i] + a[j][i] * v[j]);
    }
    let share = dot(&p, v) * beta * of(0.5);
    let w: [T; D] = core::array::from_fn(|i| (p[i] - share * v[i]) * beta);
    for j in first..D {
        let (v_j, w_j) = (v[j], w[j]);
        a[j] = core::array::from_fn(|i| a[j][i] - (v[i] * w_j + w[i] * v_j));
    }
}
