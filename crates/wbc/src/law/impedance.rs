//! Expanded Cartesian impedance, eqs. (10)–(11): the wrench at the tool and the null-space forces.
//!
//! ```
//! use moca_wbc::impedance::{damping, pose_error, wrench};
//! use moca_wbc::nalgebra::{Matrix3, SMatrix, Vector3};
//!
//! let (here, axes) = (Vector3::new(0.5, 0.0, 1.0), Matrix3::identity());
//! let error = pose_error((&here, &axes), (&Vector3::new(0.5, 0.0, 1.01), &axes));
//! let stiffness = [800.0, 800.0, 800.0, 40.0, 40.0, 40.0];
//! let inverse_task_inertia = SMatrix::<f64, 6, 6>::identity() * 0.25; // 4 kg, 4 kg·m²
//! let damping = damping(&inverse_task_inertia, &stiffness, 1.0)?;
//! let force = wrench(&stiffness, &damping, &error, &[0.0; 6]);
//! assert!((force[2] - 8.0).abs() < 1e-9, "N for a centimetre");
//! # Ok::<(), moca_wbc::ControlError>(())
//! ```

use crate::error::ControlError;
use crate::linalg::{Cholesky, times};
use crate::rotation;
use crate::scalar::{Scalar, of};
use crate::square_root::times_inverse_square_root;
use nalgebra::{Matrix3, SMatrix, Vector3};

/// Pose error \[p_d − p; R·log(Rᵀ·R_d)\], m and rad, in the axes in which both poses are given. eq. (10)
#[inline]
pub fn pose_error<T: Scalar>(
    (position, rotation): (&Vector3<T>, &Matrix3<T>),
    (desired_position, desired_rotation): (&Vector3<T>, &Matrix3<T>),
) -> [T; 6] {
    let linear = desired_position - position;
    let angular = rotation::error(rotation, desired_rotation);
    [linear.x, linear.y, linear.z, angular.x, angular.y, angular.z]
}

/// D_d = A√K + √K·A with A = ζ·Λ^½, from Λ⁻¹ = J M⁻¹ Jᵀ and the stiffness (N/m, N·m/rad). eq. (10)
///
/// Near a singularity that sum can be indefinite: it would feed energy in. The symmetric product 2·K^¼·A·K^¼, which is
/// the same wherever A and K commute, then stands in.
///
/// # Errors
/// [`ControlError::NotPositiveDefinite`] if Λ⁻¹ is not even semi-definite (NaN).
pub fn damping<T: Scalar>(
    inverse_task_inertia: &SMatrix<T, 6, 6>,
    stiffness: &[T; 6],
    ratio: T,
) -> Result<SMatrix<T, 6, 6>, ControlError> {
    design(&mut inverse_task_inertia.clone(), &stiffness.map(nalgebra::ComplexField::sqrt), ratio)
}

/// D_d of Λ⁻¹ and √K; nothing of Λ⁻¹ is left.
#[cold]
#[inline(never)]
fn design<T: Scalar>(
    inverse_task_inertia: &mut SMatrix<T, 6, 6>,
    k: &[T; 6],
    ratio: T,
) -> Result<SMatrix<T, 6, 6>, ControlError> {
    let mut root = SMatrix::<T, 6, 6>::identity().data.0;
    if !times_inverse_square_root(inverse_task_inertia, &mut root) {
        return Err(NOT_DEFINITE);
    }
    // column by column, which compilers take at once; so they do not take `from_fn`
    let column = |j: usize| core::array::from_fn(|i| ratio * root[j][i] * (k[i] + k[j]));
    let mut sum = SMatrix::<T, 6, 6>::from(core::array::from_fn(column));
    let (diagonal, margin) = (sum.diagonal(), sum.trace() * T::default_epsilon());
    for i in 0..6 {
        sum[(i, i)] += margin;
    }
    let definite = Cholesky::unset().factorise(&sum);
    sum.set_diagonal(&diagonal);
    if definite {
        return Ok(sum);
    }
    let q = k.map(nalgebra::ComplexField::sqrt);
    Ok(SMatrix::from_fn(|i, j| of::<T>(2.0) * ratio * q[i] * root[j][i] * q[j]))
}

/// D_d·ė of [`damping`], mostly without the matrix; nothing of `inverse_task_inertia` is left.
///
/// # Errors
/// As for [`damping`].
#[inline]
pub(crate) fn damped<T: Scalar>(
    inverse_task_inertia: &mut SMatrix<T, 6, 6>,
    stiffness: &[T; 6],
    ratio: T,
    rate: &[T; 6],
) -> Result<[T; 6], ControlError> {
    let k = stiffness.map(nalgebra::ComplexField::sqrt);
    if !sum_is_definite(inverse_task_inertia, &k) {
        return Ok(times(&design(inverse_task_inertia, &k, ratio)?, rate));
    }
    let mut both = core::array::from_fn(|i| [rate[i], k[i] * rate[i]]);
    if !times_inverse_square_root(inverse_task_inertia, &mut both) {
        return Err(NOT_DEFINITE);
    }
    Ok(core::array::from_fn(|i| ratio * (k[i] * both[i][0] + both[i][1])))
}

const NOT_DEFINITE: ControlError = ControlError::NotPositiveDefinite { what: "J M⁻¹ Jᵀ" };

/// Returns true if A√K + √K·A, A = Λ^½, is certainly positive definite: for one stiffness t² along all axes and one r² about all, and a
/// Λ⁻¹ that stays definite with its mixed block (1 + γ²)/(1 − γ²) times as large, γ = ((√t − √r)/(√t + √r))².
///
/// Between two A⁻¹ the sum is √K·A⁻¹ + A⁻¹√K. But for positive factors of its rows and columns that is A⁻¹ − γ·J·A⁻¹·J, J = diag(1, −1).
/// Roots keep the order of matrices (Löwner 1934), so A⁻¹ is above γ·J·A⁻¹·J if its square Λ⁻¹ is above γ²·J·Λ⁻¹·J: that
/// condition, but for a factor. For a Λ⁻¹ of two axes it is necessary as well.
#[inline]
fn sum_is_definite<T: Scalar>(inverse_task_inertia: &SMatrix<T, 6, 6>, k: &[T; 6]) -> bool {
    let [t, t_y, t_z, r, r_y, r_z] = *k;
    if !((t == t_y) & (t == t_z) & (r == r_y) & (r == r_z)) {
        return false;
    }
    let (sum, root) = (t + r, (t * r).sqrt());
    // (√t − √r)² and (√t + √r)²
    let (less, more) = (sum - (root + root), sum + (root + root));
    let (less, more) = (less * less, more * more);
    let larger = (more + less) / (more - less);
    let mut mixed = *inverse_task_inertia;
    for j in 0..3 {
        for i in 3..6 {
            mixed[(i, j)] *= larger;
        }
    }
    Cholesky::unset().factorise(&mixed)
}

/// F = K·e + D·ė. eq. (10)
#[inline]
pub fn wrench<T: Scalar>(
    stiffness: &[T; 6],
    damping: &SMatrix<T, 6, 6>,
    error: &[T; 6],
    error_rate: &[T; 6],
) -> [T; 6] {
    let damped = times(damping, error_rate);
    core::array::from_fn(|i| stiffness[i] * error[i] + damped[i])
}

/// Arm part of τ_0: K_0·(q_0 − q) − D_0·q̇, N·m. eq. (11)
#[inline]
pub fn posture_torque<const N: usize, T: Scalar>(
    stiffness: &[T; N],
    damping: &[T; N],
    posture: &[T; N],
    q: &[T; N],
    dq: &[T; N],
) -> [T; N] {
    core::array::from_fn(|i| stiffness[i] * (posture[i] - q[i]) - damping[i] * dq[i])
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::{Matrix6, Vector6};

    const STIFFNESS: [f64; 6] = [800.0, 800.0, 800.0, 40.0, 40.0, 40.0];

    /// Inverse inertias in which `share` times as much couples translation and rotation as does not.
    fn inertias(share: f64) -> impl Iterator<Item = Matrix6<f64>> {
        let alone = Matrix6::from_diagonal(&Vector6::from([0.3, 0.25, 0.1, 2.0, 3.0, 5.0]));
        (1..200_u32).map(move |seed| {
            let entry = |i: u32, k: u32| (f64::from(seed) * (1.7 + 2.3 * f64::from(6 * k + i))).sin();
            (0..7).fold(alone, |sum, k| {
                let scale = |i: usize| if i < 3 { 0.2 } else { 1.0 };
                let column = Vector6::from_fn(|i, _| entry(u32::try_from(i).unwrap(), k) * scale(i));
                sum + column * column.transpose() * share
            })
        })
    }

    /// Smallest eigenvalue of A√K + √K·A over the largest.
    fn least(inverse: &Matrix6<f64>, stiffness: &[f64; 6]) -> f64 {
        let root = crate::square_root::inverse_square_root(inverse).unwrap();
        let k = Matrix6::from_diagonal(&Vector6::from(stiffness.map(f64::sqrt)));
        let values = (root * k + k * root).symmetric_eigenvalues();
        values.min() / values.max()
    }

    #[test]
    fn damped_rate_is_the_damping_times_it() {
        let rate = [0.3, -0.2, 0.1, 1.0, -0.7, 0.4];
        let uneven = [800.0, 400.0, 800.0, 40.0, 40.0, 40.0];
        for (share, stiffness) in [(0.1, STIFFNESS), (10.0, STIFFNESS), (1e5, STIFFNESS), (1.0, uneven)] {
            for inverse in inertias(share) {
                let damping = damping(&inverse, &stiffness, 0.9).unwrap();
                let wanted = damping * Vector6::from(rate);
                let is = damped(&mut inverse.clone(), &stiffness, 0.9, &rate).unwrap();
                let apart = (Vector6::from(is) - wanted).amax() / damping.amax();
                assert!(apart < 1e-14, "{share}: {apart}");
            }
        }
        assert!(damped(&mut (-Matrix6::identity()), &STIFFNESS, 0.9, &rate).is_err());
    }

    #[test]
    fn sum_said_to_be_definite_is_so_and_most_are() {
        let k = STIFFNESS.map(f64::sqrt);
        // of 199: how many are definite, and of how many of those it is said
        for (share, all) in [(0.1, [199, 199]), (1.0, [199, 199]), (10.0, [199, 196]), (1e5, [0, 0])] {
            let (mut definite, mut said) = (0, 0);
            for inverse in inertias(share) {
                let is_said = sum_is_definite(&inverse, &k);
                let is = least(&inverse, &STIFFNESS) > 0.0;
                assert!(is || !is_said, "{share}: {inverse}");
                definite += u32::from(is);
                said += u32::from(is_said);
            }
            assert_eq!([definite, said], all, "{share}");
        }
    }

    #[test]
    fn symmetric_product_stands_in_for_a_sum_that_is_not_definite() {
        let q = Matrix6::from_diagonal(&Vector6::from(STIFFNESS.map(|k| k.sqrt().sqrt())));
        for inverse in inertias(1e5) {
            let root = crate::square_root::inverse_square_root(&inverse).unwrap();
            let wanted = q * root * q * 1.8;
            let damping = damping(&inverse, &STIFFNESS, 0.9).unwrap();
            assert!((damping - wanted).amax() < 1e-13 * wanted.amax(), "{damping}");
        }
    }

    #[test]
    fn sum_of_two_axes_is_definite_up_to_the_bound() {
        for stiffness in [STIFFNESS, [9.0, 9.0, 9.0, 900.0, 900.0, 900.0]] {
            let k = stiffness.map(f64::sqrt);
            let (t, r) = (k[0].sqrt(), k[3].sqrt());
            let gamma = ((t - r) / (t + r)).powi(2);
            let bound = (1.0 - gamma * gamma) / (1.0 + gamma * gamma);
            for (coupling, definite) in [(bound - 1e-6, true), (bound + 1e-6, false)] {
                let mut inverse = Matrix6::identity();
                (inverse[(4, 1)], inverse[(1, 4)]) = (coupling, coupling);
                assert_eq!(sum_is_definite(&inverse, &k), definite, "{coupling}");
                assert_eq!(least(&inverse, &stiffness) > 0.0, definite, "{coupling}");
            }
        }
        let uneven = [3.0, 3.0, 4.0, 1.0, 1.0, 1.0];
        assert!(!sum_is_definite(&Matrix6::identity(), &uneven), "of three values it is not known");
        assert!(!sum_is_definite(&Matrix6::identity(), &[3.0, 3.0, 3.0, 1.0, 2.0, 1.0]));
    }
}
