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
use crate::linalg::Cholesky;
use crate::rotation;
use crate::scalar::{Scalar, of};
use crate::square_root::become_inverse_square_root;
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
#[inline]
pub fn damping<T: Scalar>(
    inverse_task_inertia: &SMatrix<T, 6, 6>,
    stiffness: &[T; 6],
    ratio: T,
) -> Result<SMatrix<T, 6, 6>, ControlError> {
    let mut root = *inverse_task_inertia;
    damping_of(&mut root, stiffness, ratio)
}

/// [`damping`] of a matrix that nobody needs any longer; it becomes its inverse square root.
#[inline]
pub(crate) fn damping_of<T: Scalar>(
    root: &mut SMatrix<T, 6, 6>,
    stiffness: &[T; 6],
    ratio: T,
) -> Result<SMatrix<T, 6, 6>, ControlError> {
    if !become_inverse_square_root(root) {
        return Err(ControlError::NotPositiveDefinite { what: "J M⁻¹ Jᵀ" });
    }
    let k = stiffness.map(nalgebra::ComplexField::sqrt);
    // column by column, which compilers take at once; so they do not take `from_fn`
    let column = |j: usize| core::array::from_fn(|i| ratio * root[(i, j)] * (k[i] + k[j]));
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
    Ok(SMatrix::from_fn(|i, j| of::<T>(2.0) * ratio * q[i] * root[(i, j)] * q[j]))
}

/// F = K·e + D·ė. eq. (10)
#[inline]
pub fn wrench<T: Scalar>(
    stiffness: &[T; 6],
    damping: &SMatrix<T, 6, 6>,
    error: &[T; 6],
    error_rate: &[T; 6],
) -> [T; 6] {
    let damped = crate::linalg::times(damping, error_rate);
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
