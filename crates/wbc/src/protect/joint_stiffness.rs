//! Largest stiffness with which joints can be held: a bound from inertia and control period.
//!
//! A held joint has a spring K_i and a damper D_i = 1.4·√(K_i·M_ii). With K = diag(K_i), D = diag(D_i) and the joint-space
//! inertia M, a small motion about the held posture is a sum of modes u. For each, let a = T·uᵀDu/uᵀMu and
//! b = T²·uᵀKu/uᵀMu, T the period. The mode decays, by the Schur–Cohn test of its characteristic polynomial, if
//!
//! | torque acts | robot moves | polynomial in λ | decays if |
//! |---|---|---|---|
//! | at once | in steps (semi-implicit Euler) | λ² − (2 − a − b)λ + 1 − a | b > 0, 2a + b < 4 |
//! | at once | continuously | λ² − (2 − a − b/2)λ + 1 − a + b/2 | 0 < b < 2a, a < 2 |
//! | a period late | in steps | λ³ − 2λ² + (1 + a + b)λ − a | 0 < b < a(1 − a) |
//! | a period late | continuously | λ³ − 2λ² + (1 + a + b/2)λ + b/2 − a | b > 0, a(1 − b/2a)² < 1 − 3b/2a |
//!
//! All four hold where a ≤ α and b ≤ (1 − α)a with α = 1.96/2.96 = 0.66, the largest α that asks no more of the spring than
//! of the damper. M ⪰ W = diag(w_i) with w_i = Λ_i/ρ_i, Λ_i = 1/(M⁻¹)_ii and ρ_i = Σ_j |(M⁻¹)_ij|·√(Λ_iΛ_j), because
//! diag(ρ) − √Λ·M⁻¹·√Λ is diagonally dominant. So T·D_i ≤ α·w_i gives the first condition and T·K_i ≤ (1 − α)·D_i the second.
//! With D_i as above and w_i ≤ M_ii both are √K_i ≤ 0.473·w_i/(T·√M_ii): [`largest`]. T is taken [`SPARE`] times as long as
//! the period, for what the linear model leaves out.

use crate::linalg::Cholesky;
use crate::scalar::{Scalar, of};
use nalgebra::SMatrix;

/// The loop must be stable with a period this many times its own.
pub const SPARE: f64 = 1.25;
/// Damping of a held joint over √(K·M_ii): 0.7 of critical.
const DAMPING: f64 = 1.4;
/// T·√K_i·√M_ii/w_i at the bound: α/1.4.
const REACH: f64 = DAMPING / (1.0 + DAMPING * DAMPING);

/// Largest stable stiffness of each joint of an arm with inertia `mass` kg·m² under a control of `period_s`, N·m/rad, with
/// the damper of [`damping`]; 0 for an inertia that is not positive definite.
///
/// ```
/// use moca_wbc::joint_stiffness::largest;
/// use moca_wbc::nalgebra::Matrix2;
///
/// let mass = Matrix2::<f64>::new(1.0, 0.0, 0.0, 1e-4);
/// let [shoulder, wrist] = largest(&mass, 1e-3);
/// assert!(shoulder > 1e5 && (14.0..15.0).contains(&wrist), "{shoulder}, {wrist} N·m/rad");
/// let [_, slow] = largest(&mass, 4e-3);
/// assert!((wrist / slow - 16.0).abs() < 1e-9, "it goes with the square of the rate");
/// ```
pub fn largest<const N: usize, T: Scalar>(mass: &SMatrix<T, N, N>, period_s: T) -> [T; N] {
    let counted = counted_on(mass);
    let period_s = of::<T>(SPARE) * period_s;
    core::array::from_fn(|i| {
        let root = of::<T>(REACH) * counted[i] / period_s;
        if counted[i] > T::zero() { root * root / mass[(i, i)] } else { T::zero() }
    })
}

/// Largest stable stiffness of a single mass, kg or kg·m², N/m or N·m/rad, with the damper of [`damping`].
#[inline]
pub(crate) fn largest_alone<T: Scalar>(inertia: T, period_s: T) -> T {
    let root = of::<T>(REACH / SPARE) / period_s;
    root * root * inertia
}

/// Largest stable damping α·w_i/T of each joint, for a spring of at most (1 − α)/T times as much, N·m·s/rad; 0 for an inertia that
/// is not positive definite.
pub fn largest_damping<const N: usize, T: Scalar>(mass: &SMatrix<T, N, N>, period_s: T) -> [T; N] {
    let most = of::<T>(DAMPING * REACH) / (of::<T>(SPARE) * period_s);
    counted_on(mass).map(|counted| most * counted)
}

/// Damping of a joint with this stiffness and inertia M_ii, N·m·s/rad.
#[inline]
pub fn damping<T: Scalar>(stiffness: T, inertia: T) -> T {
    of::<T>(DAMPING) * (stiffness * inertia.max(T::zero())).sqrt()
}

/// Inertia w_i of each joint whatever the others do, kg·m²: M ⪰ diag(w).
fn counted_on<const N: usize, T: Scalar>(mass: &SMatrix<T, N, N>) -> [T; N] {
    let Some(factor) = Cholesky::new(mass) else { return [T::zero(); N] };
    let mut inverse = [[T::zero(); N]; N];
    for (i, column) in inverse.iter_mut().enumerate() {
        let mut unit = [T::zero(); N];
        unit[i] = T::one();
        *column = factor.solve(&unit);
    }
    let alone: [T; N] = core::array::from_fn(|i| T::one() / inverse[i][i]);
    core::array::from_fn(|i| {
        let coupled = (0..N)
            .fold(T::zero(), |sum, j| sum + inverse[i][j].abs() * (alone[i].abs() * alone[j].abs()).sqrt());
        alone[i] / coupled
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::{Matrix2, SVector};

    /// Largest |λ| of a held joint of 1 kg·m², the torque `late` periods late, by running it.
    fn grows(stiffness: f64, period_s: f64, late: usize, continuous: bool) -> bool {
        let (mut q, mut dq, mut sent) = (1e-3, 0.0, [0.0; 2]);
        let damping = damping(stiffness, 1.0);
        for _ in 0..20_000 {
            sent = [-stiffness * q - damping * dq, sent[0]];
            let before: f64 = dq;
            dq += period_s * sent[late];
            q += period_s * if continuous { 0.5 * (before + dq) } else { dq };
            if q.abs() > 1.0 {
                return true;
            }
        }
        false
    }

    #[test]
    fn bound_without_its_spare_is_where_a_late_joint_turns_unstable() {
        let period_s = 2e-3;
        let [bound] = largest(&SMatrix::<f64, 1, 1>::new(1.0), period_s / SPARE);
        for (late, continuous) in [(0, false), (0, true), (1, false), (1, true)] {
            assert!(!grows(0.999 * bound, period_s, late, continuous), "{late} {continuous}");
        }
        assert!(grows(1.01 * bound, period_s, 1, false), "the bound is no smaller than it has to be");
    }

    #[test]
    fn largest_damping_follows_from_largest_stiffness() {
        let mass = Matrix2::new(2.0, 0.0, 0.0, 3e-4);
        let (stiffness, most) = (largest(&mass, 4e-3), largest_damping(&mass, 4e-3));
        for i in 0..2 {
            assert!((damping(stiffness[i], mass[(i, i)]) / most[i] - 1.0_f64).abs() < 1e-12, "{most:?}");
        }
    }

    #[test]
    #[expect(clippy::float_cmp, reason = "no rounding: the inertia itself, and zeros")]
    fn inertia_counted_on_is_below_the_inertia_in_every_direction() {
        for coupling in [-0.9, -0.3, 0.0, 0.5, 0.99] {
            let mass = Matrix2::new(2.0, coupling * 0.02, coupling * 0.02, 2e-4);
            let [a, b] = counted_on(&mass);
            let rest = mass - Matrix2::from_diagonal(&SVector::from([a, b]));
            assert!(rest.symmetric_eigenvalues().min() >= -1e-12 && a > 0.0 && b > 0.0, "{coupling}: {rest}");
        }
        assert_eq!(counted_on(&Matrix2::new(2.0, 0.0, 0.0, 3e-4)), [2.0, 3e-4]);
        assert_eq!(largest(&Matrix2::new(1.0, 2.0, 2.0, 1.0), 1e-3), [0.0; 2]);
        assert_eq!(largest(&Matrix2::new(f64::NAN, 0.0, 0.0, 1.0), 1e-3), [0.0; 2]);
    }
}
