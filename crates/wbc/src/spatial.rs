//! Compact spatial algebra: twists, wrenches and rigid-body inertias about one point, in one set of axes
//! (Featherstone 2008, with the ten numbers of an inertia instead of a 6×6 matrix).

use crate::scalar::Scalar;
use core::ops::{Add, AddAssign};
use nalgebra::{Matrix3, Vector3};

/// Spatial velocity or acceleration about the reference point.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Motion<T> {
    pub angular: Vector3<T>,
    pub linear: Vector3<T>,
}

/// Spatial force or momentum about the reference point.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Force<T> {
    pub force: Vector3<T>,
    pub moment: Vector3<T>,
}

impl<T: Scalar> Motion<T> {
    pub(crate) fn zero() -> Self {
        Self { angular: Vector3::zeros(), linear: Vector3::zeros() }
    }

    /// Turning about `axis` through `point`, both relative to the reference point.
    #[inline]
    pub(crate) fn revolute(axis: &Vector3<T>, point: &Vector3<T>) -> Self {
        Self { angular: *axis, linear: point.cross(axis) }
    }

    #[inline]
    pub(crate) fn scaled(&self, s: T) -> Self {
        Self { angular: self.angular * s, linear: self.linear * s }
    }

    /// self × other: rate of `other` as it is carried along by `self`.
    #[inline]
    pub(crate) fn cross(&self, other: &Self) -> Self {
        Self {
            angular: self.angular.cross(&other.angular),
            linear: self.angular.cross(&other.linear) + self.linear.cross(&other.angular),
        }
    }

    /// self ×* momentum: rate of a momentum that is carried along by `self`.
    #[inline]
    pub(crate) fn cross_force(&self, h: &Force<T>) -> Force<T> {
        Force {
            force: self.angular.cross(&h.force),
            moment: self.angular.cross(&h.moment) + self.linear.cross(&h.force),
        }
    }

    /// Power of `f` along `self`.
    #[inline]
    pub(crate) fn dot(&self, f: &Force<T>) -> T {
        self.angular.dot(&f.moment) + self.linear.dot(&f.force)
    }
}

impl<T: Scalar> Add for Motion<T> {
    type Output = Self;
    #[inline]
    fn add(self, other: Self) -> Self {
        Self { angular: self.angular + other.angular, linear: self.linear + other.linear }
    }
}

impl<T: Scalar> Force<T> {
    pub(crate) fn zero() -> Self {
        Self { force: Vector3::zeros(), moment: Vector3::zeros() }
    }
}

impl<T: Scalar> Add for Force<T> {
    type Output = Self;
    #[inline]
    fn add(self, other: Self) -> Self {
        Self { force: self.force + other.force, moment: self.moment + other.moment }
    }
}

impl<T: Scalar> AddAssign for Force<T> {
    #[inline]
    fn add_assign(&mut self, other: Self) {
        *self = *self + other;
    }
}

/// Rigid-body inertia about the reference point.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Inertia<T> {
    pub mass: T,
    /// Mass × centre of mass.
    pub first_moment: Vector3<T>,
    /// Rotational inertia about the reference point: xx, xy, xz, yy, yz, zz.
    pub rotational: [T; 6],
}

impl<T: Scalar> Inertia<T> {
    pub(crate) fn zero() -> Self {
        Self { mass: T::zero(), first_moment: Vector3::zeros(), rotational: [T::zero(); 6] }
    }

    /// From mass, centre of mass relative to the reference point, and inertia about the centre of mass.
    #[inline]
    pub(crate) fn about(mass: T, com: &Vector3<T>, inertia_com: &[T; 6]) -> Self {
        let h = com * mass;
        let [xx, xy, xz, yy, yz, zz] = *inertia_com;
        let (hxx, hyy, hzz) = (h.x * com.x, h.y * com.y, h.z * com.z);
        Self {
            mass,
            first_moment: h,
            rotational: [
                xx + hyy + hzz,
                xy - h.x * com.y,
                xz - h.x * com.z,
                yy + hxx + hzz,
                yz - h.y * com.z,
                zz + hxx + hyy,
            ],
        }
    }

    #[inline]
    pub(crate) fn times(&self, v: &Motion<T>) -> Force<T> {
        let [xx, xy, xz, yy, yz, zz] = self.rotational;
        let w = &v.angular;
        let turned = Vector3::new(
            xx * w.x + xy * w.y + xz * w.z,
            xy * w.x + yy * w.y + yz * w.z,
            xz * w.x + yz * w.y + zz * w.z,
        );
        Force {
            force: v.linear * self.mass + w.cross(&self.first_moment),
            moment: turned + self.first_moment.cross(&v.linear),
        }
    }
}

impl<T: Scalar> Inertia<T> {
    /// I·a + v ×* I·v: the force that gives `acceleration` at `velocity`.
    #[inline]
    pub(crate) fn rate_of_momentum(&self, velocity: &Motion<T>, acceleration: &Motion<T>) -> Force<T> {
        self.times(acceleration) + velocity.cross_force(&self.times(velocity))
    }
}

impl<T: Scalar> Add for Inertia<T> {
    type Output = Self;
    #[inline]
    fn add(self, other: Self) -> Self {
        let mut rotational = self.rotational;
        for (a, b) in rotational.iter_mut().zip(other.rotational) {
            *a += b;
        }
        Self {
            mass: self.mass + other.mass,
            first_moment: self.first_moment + other.first_moment,
            rotational,
        }
    }
}

/// R·I·Rᵀ of a symmetric 3×3 matrix (xx, xy, xz, yy, yz, zz).
#[inline]
pub(crate) fn rotate_symmetric<T: Scalar>(r: &Matrix3<T>, [xx, xy, xz, yy, yz, zz]: &[T; 6]) -> [T; 6] {
    let (xx, xy, xz, yy, yz, zz) = (*xx, *xy, *xz, *yy, *yz, *zz);
    let row = |i: usize| {
        let (a, b, c) = (r[(i, 0)], r[(i, 1)], r[(i, 2)]);
        [a * xx + b * xy + c * xz, a * xy + b * yy + c * yz, a * xz + b * yz + c * zz]
    };
    let dot = |b: &[T; 3], i: usize| b[0] * r[(i, 0)] + b[1] * r[(i, 1)] + b[2] * r[(i, 2)];
    let (b0, b1, b2) = (row(0), row(1), row(2));
    [dot(&b0, 0), dot(&b0, 1), dot(&b0, 2), dot(&b1, 1), dot(&b1, 2), dot(&b2, 2)]
}
