//! Rotations: matrices inside, unit quaternions (x, y, z, w) at the edge.
//!
//! ```
//! use moca_wbc::nalgebra::Vector3;
//! use moca_wbc::rotation;
//!
//! let turn = Vector3::new(0.1_f64, -0.2, 0.3);
//! assert!((rotation::log(&rotation::exp(&turn)) - turn).norm() < 1e-15);
//! let [x, y, z, w] = rotation::to_quaternion(&rotation::exp(&turn));
//! assert_eq!(rotation::from_quaternion([x, y, z, w]), rotation::from_quaternion([-x, -y, -z, -w]));
//! ```

use crate::error::{ControlError, finite};
use crate::scalar::{Scalar, of};
use crate::spatial::Turn;
use nalgebra::{Matrix3, Vector3};

/// R = Rz(yaw)·Ry(pitch)·Rx(roll), angles in rad.
pub fn from_rpy<T: Scalar>([roll, pitch, yaw]: [T; 3]) -> Matrix3<T> {
    let ((sr, cr), (sp, cp), (sy, cy)) = (roll.sin_cos(), pitch.sin_cos(), yaw.sin_cos());
    Matrix3::new(
        cy * cp,
        cy * sp * sr - sy * cr,
        cy * sp * cr + sy * sr,
        sy * cp,
        sy * sp * sr + cy * cr,
        sy * sp * cr - cy * sr,
        -sp,
        cp * sr,
        cp * cr,
    )
}

impl<T> From<Turn<T>> for Heading<T> {
    fn from(Turn { sin, cos }: Turn<T>) -> Self {
        Self { sin, cos }
    }
}

/// A rotation about the vertical: from B to W.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Heading<T> {
    sin: T,
    cos: T,
}

impl<T: Scalar> Heading<T> {
    /// Returns the rotation of a base at `yaw`, rad.
    #[inline]
    pub fn at(yaw: T) -> Self {
        let (sin, cos) = yaw.sin_cos_abreast();
        Self { sin, cos }
    }

    /// Sine and cosine of the yaw.
    #[inline]
    pub const fn sin_cos(&self) -> (T, T) {
        (self.sin, self.cos)
    }

    /// Room for a heading: no direction at all.
    pub(crate) fn unset() -> Self {
        Self { sin: T::zero(), cos: T::zero() }
    }

    /// A planar wrench or velocity in the axes of B, in W: the moment or yaw rate does not change.
    #[inline]
    pub fn to_world(&self, [x, y, z]: [T; 3]) -> [T; 3] {
        [self.cos * x - self.sin * y, self.sin * x + self.cos * y, z]
    }

    /// The way back from [`Self::to_world`].
    #[inline]
    pub fn to_base(&self, [x, y, z]: [T; 3]) -> [T; 3] {
        [self.cos * x + self.sin * y, self.cos * y - self.sin * x, z]
    }

    /// Axes of B in W.
    #[inline]
    pub fn matrix(&self) -> Matrix3<T> {
        let (s, c, zero) = (self.sin, self.cos, T::zero());
        Matrix3::new(c, -s, zero, s, c, zero, zero, zero, T::one())
    }
}

/// Both halves of a twist or wrench in other axes, about the same point.
///
/// ```
/// use moca_wbc::rotation::{Heading, turned};
///
/// let facing_left = Heading::at(std::f64::consts::FRAC_PI_2).matrix();
/// let [fx, fy, ..] = turned(&facing_left, &[10.0, 0.0, 0.0, 0.0, 0.0, 0.0]);
/// assert!(fx.abs() < 1e-12 && (fy - 10.0).abs() < 1e-12);
/// ```
pub fn turned<T: Scalar>(rotation: &Matrix3<T>, &[vx, vy, vz, wx, wy, wz]: &[T; 6]) -> [T; 6] {
    let (v, w) = (rotation * Vector3::new(vx, vy, vz), rotation * Vector3::new(wx, wy, wz));
    [v.x, v.y, v.z, w.x, w.y, w.z]
}

/// Unit quaternion (x, y, z, w), w ≥ 0, of a rotation matrix (Shepperd's method: accurate at any angle).
pub fn to_quaternion<T: Scalar>(r: &Matrix3<T>) -> [T; 4] {
    let (d0, d1, d2) = (r[(0, 0)], r[(1, 1)], r[(2, 2)]);
    let trace = d0 + d1 + d2;
    // a component of four times its square less 1, and the factor of what the others are found from
    let parts = |less_one: T| {
        let root = (T::one() + less_one).max(T::zero()).sqrt();
        (root * of(0.5), of::<T>(0.5) / root)
    };
    let mut q = if trace >= d0.max(d1).max(d2) {
        let (w, by) = parts(trace);
        [(r[(2, 1)] - r[(1, 2)]) * by, (r[(0, 2)] - r[(2, 0)]) * by, (r[(1, 0)] - r[(0, 1)]) * by, w]
    } else if d0 >= d1 && d0 >= d2 {
        let (x, by) = parts(d0 - d1 - d2);
        [x, (r[(0, 1)] + r[(1, 0)]) * by, (r[(0, 2)] + r[(2, 0)]) * by, (r[(2, 1)] - r[(1, 2)]) * by]
    } else if d1 >= d2 {
        let (y, by) = parts(d1 - d0 - d2);
        [(r[(0, 1)] + r[(1, 0)]) * by, y, (r[(1, 2)] + r[(2, 1)]) * by, (r[(0, 2)] - r[(2, 0)]) * by]
    } else {
        let (z, by) = parts(d2 - d0 - d1);
        [(r[(0, 2)] + r[(2, 0)]) * by, (r[(1, 2)] + r[(2, 1)]) * by, z, (r[(1, 0)] - r[(0, 1)]) * by]
    };
    if q[3] < T::zero() {
        q = q.map(|x| -x);
    }
    q
}

/// Rotation matrix of a quaternion (x, y, z, w) of any non-zero length; q and −q give the same matrix.
pub fn from_quaternion<T: Scalar>([x, y, z, w]: [T; 4]) -> Matrix3<T> {
    let two = of::<T>(2.0);
    let s = two / (x * x + y * y + z * z + w * w);
    Matrix3::new(
        T::one() - s * (y * y + z * z),
        s * (x * y - z * w),
        s * (x * z + y * w),
        s * (x * y + z * w),
        T::one() - s * (x * x + z * z),
        s * (y * z - x * w),
        s * (x * z - y * w),
        s * (y * z + x * w),
        T::one() - s * (x * x + y * y),
    )
}

/// Returns the rotation of a quaternion (x, y, z, w) from elsewhere.
///
/// # Errors
/// A value that is not finite, a length that is not 1.
pub(crate) fn from_unit_quaternion<T: Scalar>(quaternion: [T; 4]) -> Result<Matrix3<T>, ControlError> {
    finite("target quaternion", &quaternion)?;
    let norm = quaternion.iter().fold(T::zero(), |sum, x| sum + *x * *x).sqrt();
    if !(of::<T>(0.999)..=of(1.001)).contains(&norm) {
        return Err(ControlError::NotUnit { norm: nalgebra::try_convert(norm).unwrap_or(f64::NAN) });
    }
    Ok(from_quaternion(quaternion))
}

/// Orientation error R·log(Rᵀ·R_d) = log(R_d·Rᵀ), rad, in the axes in which both are given, length in \[0, π\].
/// At exactly π one of the two axes is taken; the result is finite for every pair. eq. (10)
pub fn error<T: Scalar>(actual: &Matrix3<T>, desired: &Matrix3<T>) -> Vector3<T> {
    log(&(desired * actual.transpose()))
}

/// Square of a sine below which [`log`] takes the arc sine's series: 3.4°. What it leaves out is below 4e-17.
const SMALL: f64 = 3.6e-3;

/// Rotation vector of a rotation matrix, rad.
pub fn log<T: Scalar>(r: &Matrix3<T>) -> Vector3<T> {
    let axis =
        Vector3::new(r[(2, 1)] - r[(1, 2)], r[(0, 2)] - r[(2, 0)], r[(1, 0)] - r[(0, 1)]) * of::<T>(0.5);
    let square = axis.norm_squared();
    if square < of(SMALL) && r.trace() > T::one() {
        return axis * arc_over_sine(square);
    }
    let [x, y, z, w] = to_quaternion(r);
    let v = Vector3::new(x, y, z);
    let sine = v.norm();
    v * (of::<T>(2.0) * sine.atan2(w) / sine)
}

/// An angle over its sine, of the square of a small sine.
#[inline]
fn arc_over_sine<T: Scalar>(square: T) -> T {
    const SERIES: [f64; 6] = [63.0 / 2816.0, 35.0 / 1152.0, 5.0 / 112.0, 3.0 / 40.0, 1.0 / 6.0, 1.0];
    SERIES.iter().fold(T::zero(), |sum, &term| sum * square + of(term))
}

/// Rotation matrix of a rotation vector, rad.
pub fn exp<T: Scalar>(v: &Vector3<T>) -> Matrix3<T> {
    let half = v * of::<T>(0.5);
    let angle = half.norm();
    let (s, c) = angle.sin_cos();
    let sinc = if angle < T::default_epsilon() { T::one() } else { s / angle };
    let q = half * sinc;
    from_quaternion([q.x, q.y, q.z, c])
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn logarithm_is_the_vector_of_the_turn_on_both_sides_of_small() {
        let axis = Vector3::new(0.36, -0.48, 0.8);
        for angle in [0.0, 1e-12, 1e-3, 0.03, 0.0599, 0.0602, 0.5, 1.6, 3.0, 3.1, 3.13] {
            let wanted = axis * angle;
            let apart = (log(&exp(&wanted)) - wanted).norm();
            assert!(apart < 4e-16 + 4e-15 * angle, "{angle}: {apart}");
        }
        let edge: f64 = SMALL.sqrt();
        assert!((arc_over_sine(SMALL) * edge / edge.asin() - 1.0).abs() < 3e-16);
    }
}
