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

    /// Reduces a symmetric matrix by reflections, from its first column on; nothing of it is left.
    #[inline]
    pub(super) fn reduce(&mut self, rest: &mut [[T; D]; D]) {
        const { assert!(D <= LARGEST, "what `reflect` knows") }
        let (t, zero) = (self, T::zero());
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
                reflect(rest, v, *beta, k, Columns::Last);
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

    /// Turns a symmetric F to V·F·Vᵀ.
    #[inline]
    pub(super) fn turn_back(&self, f: &mut [[T; D]; D]) {
        for (k, (v, beta)) in self.reflections[..D.saturating_sub(2)].iter().enumerate().rev() {
            reflect(f, v, *beta, k, Columns::All);
            for j in k + 1..D {
                f[j][k] = f[k][j];
            }
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

/// Rows of the largest matrix.
pub(super) const LARGEST: usize = 6;

/// Columns of a reflected matrix that are wanted.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Columns {
    All,
    /// Those in which both sides change.
    Last,
}

/// (I − β·v·vᵀ)·A·(I − β·v·vᵀ) of a symmetric A, in its last rows: v is zero down to its entry `k`.
#[inline]
fn reflect<const D: usize, T: Scalar>(a: &mut [[T; D]; D], v: &[T; D], beta: T, k: usize, columns: Columns) {
    match D - 1 - k {
        1 => reflect_last::<1, D, T>(a, v, beta, columns),
        2 => reflect_last::<2, D, T>(a, v, beta, columns),
        3 => reflect_last::<3, D, T>(a, v, beta, columns),
        4 => reflect_last::<4, D, T>(a, v, beta, columns),
        _ => reflect_last::<5, D, T>(a, v, beta, columns),
    }
}

/// [`reflect`] of the last W rows and columns: their number is known, so that nothing is computed of those before. The same
/// code turns there and back.
#[inline(never)]
fn reflect_last<const W: usize, const D: usize, T: Scalar>(
    a: &mut [[T; D]; D],
    v: &[T; D],
    beta: T,
    columns: Columns,
) {
    let Some(v) = v.last_chunk::<W>() else { return };
    let (before, last) = a.split_at_mut(D - W);
    if columns == Columns::All {
        for column in before {
            let Some(rows) = column.last_chunk_mut::<W>() else { return };
            let share = dot(v, rows) * beta;
            *rows = core::array::from_fn(|i| rows[i] - v[i] * share);
        }
    }
    let mut p = [T::zero(); W];
    for (column, &v_j) in last.iter().zip(v) {
        let Some(rows) = column.last_chunk::<W>() else { return };
        p = core::array::from_fn(|i| p[i] + rows[i] * v_j);
    }
    let share = dot(&p, v) * beta * of(0.5);
    let w: [T; W] = core::array::from_fn(|i| (p[i] - share * v[i]) * beta);
    for (column, (&v_j, &w_j)) in last.iter_mut().zip(v.iter().zip(&w)) {
        let Some(rows) = column.last_chunk_mut::<W>() else { return };
        *rows = core::array::from_fn(|i| rows[i] - (v[i] * w_j + w[i] * v_j));
    }
}
