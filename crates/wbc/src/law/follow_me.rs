//! Expanded follow-me, eqs. (12)–(16): a hand at the flange or on the cover leads the base, the arm keeps its pose on it.
//!
//! The arm's part, eq. (15), is [`crate::opspace::ArmDynamics::torque`].
//!
//! ```
//! use moca_wbc::follow_me::{base_wrench, moved};
//! use moca_wbc::nalgebra::{Matrix3, Vector3};
//!
//! // 10 N sideways at a flange half a metre in front of the arm base, which stands 0.2 m in front of B
//! let about_arm = moved(&[0.0, 10.0, 0.0, 0.0, 0.0, 0.0], &Vector3::new(0.5, 0.0, 0.6));
//! let led = base_wrench(&Matrix3::identity(), &Vector3::new(0.2, 0.0, 0.5), &about_arm);
//! assert_eq!(led, [0.0, 10.0, 7.0], "N, N, N·m about B");
//! ```

use crate::scalar::Scalar;
use nalgebra::{Matrix3, Vector3};

/// A wrench at `point` (relative to the new reference point, same axes) taken about the new reference point: the
/// moment gains point × force. Eq. (12) needs F_A,ext about the arm base, not about the flange.
#[inline]
pub fn moved<T: Scalar>(wrench: &[T; 6], point: &Vector3<T>) -> [T; 6] {
    let [fx, fy, fz, mx, my, mz] = *wrench;
    let moment = Vector3::new(mx, my, mz) + point.cross(&Vector3::new(fx, fy, fz));
    [fx, fy, fz, moment.x, moment.y, moment.z]
}

/// ᴮT_A·Ψ·F_A,ext: the part of a wrench at the arm base (axes of A) that a planar base can follow, \[N, N, N·m\] in B
/// about its origin. Ψ keeps f_x, f_y and m_z; T_A turns them to B and adds the moment r × f of the mount. For a mount
/// that is tilted as well as turned the wrench is turned to B before Ψ. eqs. (12)–(14)
#[inline]
pub fn base_wrench<T: Scalar>(
    mount_rotation: &Matrix3<T>,
    mount_position: &Vector3<T>,
    wrench_arm: &[T; 6],
) -> [T; 3] {
    let [fx, fy, fz, mx, my, mz] = *wrench_arm;
    let force = mount_rotation * Vector3::new(fx, fy, fz);
    let moment = mount_rotation * Vector3::new(mx, my, mz);
    let lever_moment = mount_position.x * force.y - mount_position.y * force.x;
    [force.x, force.y, moment.z + lever_moment]
}
