//! Rigid-body inertias about one point, in one set of axes: ten numbers instead of a 6×6 matrix (Featherstone 2008).

use crate::scalar::{Scalar, of};
use core::ops::Add;
use nalgebra::{Matrix3, Vector3};

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
    /// From mass, centre of mass relative to the reference point, and inertia about the centre of mass.
    pub(crate) fn about(mass: T, com: &Vector3<T>, inertia_com: &[T; 6]) -> Self {
        let centred = Self { mass, first_moment: Vector3::zeros(), rotational: *inertia_com };
        centred.moved(com)
    }

    /// About the point from which the present one is `step` away.
    #[inline]
    pub(crate) fn moved(&self, step: &Vector3<T>) -> Self {
        let middle = self.first_moment + step * (self.mass * of(0.5));
        let mut moved = *self;
        moved.rotational = shifted(&self.rotational, &middle, step);
        moved.first_moment += step * self.mass;
        moved
    }

    /// In the axes in which the present ones are `rotation`.
    #[inline]
    pub(crate) fn rotated(&self, rotation: &Matrix3<T>) -> Self {
        Self {
            mass: self.mass,
            first_moment: rotation * self.first_moment,
            rotational: rotate_symmetric(rotation, &self.rotational),
        }
    }
}

impl<T: Scalar> Add for Inertia<T> {
    type Output = Self;
    fn add(self, other: Self) -> Self {
        Self {
            mass: self.mass + other.mass,
            first_moment: self.first_moment + other.first_moment,
            rotational: sum(&self.rotational, &other.rotational),
        }
    }
}

/// Part of a link's inertia that resists the turning of its joint and of those before it. The rest (its mass, and a thin rod
/// along the joint's axis) moves as if it sat on the link before, and is counted there. No turning link has a mass then,
/// and the recursions are shorter.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct TurningInertia<T> {
    /// Mass × centre of mass, about the frame's origin.
    pub first_moment: Vector3<T>,
    /// Rotational inertia about the frame's origin: xx, xy, xz, yy, yz, zz.
    pub rotational: [T; 6],
}

impl<T: Scalar> TurningInertia<T> {
    pub(crate) fn zero() -> Self {
        Self { first_moment: Vector3::zeros(), rotational: [T::zero(); 6] }
    }

    /// Parts `body` into what turns with a joint about z, and what the joint's turning does not change.
    pub(crate) fn parted(body: &Inertia<T>) -> (Self, Inertia<T>) {
        let zero = T::zero();
        let [xx, xy, xz, yy, yz, zz] = body.rotational;
        let h = &body.first_moment;
        let turning =
            Self { first_moment: Vector3::new(h.x, h.y, zero), rotational: [xx - yy, xy, xz, zero, yz, zz] };
        let rod = Inertia {
            mass: body.mass,
            first_moment: Vector3::new(zero, zero, h.z),
            rotational: [yy, zero, zero, yy, zero, zero],
        };
        (turning, rod)
    }

    /// ∫ r·rᵀ dm about the frame's origin: xx, xy, xz, yy, yz, zz.
    pub(crate) fn second_moment(&self) -> [T; 6] {
        let [xx, xy, xz, yy, yz, zz] = self.rotational;
        let half = (xx + yy + zz) * of(0.5);
        [half - xx, -xy, -xz, half - yy, -yz, half - zz]
    }
}

impl<T: Scalar> Add for TurningInertia<T> {
    type Output = Self;
    #[inline]
    fn add(self, other: Self) -> Self {
        Self {
            first_moment: self.first_moment + other.first_moment,
            rotational: sum(&self.rotational, &other.rotational),
        }
    }
}

/// Sines and cosines of angles, rad. How many is not known here, so that compilers leave the loop a loop.
#[inline(never)]
fn sin_cos<T: Scalar>(angles: &[T], sines: &mut [T], cosines: &mut [T]) {
    for ((angle, sin), cos) in angles.iter().zip(sines).zip(cosines) {
        (*sin, *cos) = angle.sin_cos_abreast();
    }
}

/// Sine and cosine of a turn about a coordinate axis.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Turn<T> {
    pub sin: T,
    pub cos: T,
}

impl<T: Scalar> Turn<T> {
    #[inline]
    pub(crate) fn by(angle: T) -> Self {
        let (sin, cos) = angle.sin_cos();
        Self { sin, cos }
    }

    /// By each of `angles`, rad, and by one before them: several at once.
    #[inline]
    pub(crate) fn all<const N: usize>(first: T, angles: &[T; N]) -> (Self, [Self; N]) {
        // two registers of doubles
        const LANES: usize = 8;
        let mut turns = [Self { sin: T::zero(), cos: T::one() }; N];
        let mut of_first = Self { sin: T::zero(), cos: T::one() };
        for group in 0..=N / LANES {
            let angles: [T; LANES] = core::array::from_fn(|lane| match LANES * group + lane {
                i if (1..=N).contains(&i) => angles[i - 1],
                _ => first,
            });
            let (mut sines, mut cosines) = ([T::zero(); LANES], [T::zero(); LANES]);
            sin_cos(&angles, &mut sines, &mut cosines);
            for lane in 0..LANES {
                let (turn, i) = (Self { sin: sines[lane], cos: cosines[lane] }, LANES * group + lane);
                if i == 0 {
                    of_first = turn;
                } else if i <= N {
                    turns[i - 1] = turn;
                }
            }
        }
        (of_first, turns)
    }

    /// Turn with both multiplied by a sign: a half turn more for −1.
    #[inline]
    pub(crate) fn times(&self, sign: T) -> Self {
        Self { sin: self.sin * sign, cos: self.cos * sign }
    }

    /// The way back.
    #[inline]
    pub(crate) fn back(&self) -> Self {
        Self { sin: -self.sin, cos: self.cos }
    }

    /// Rx·v.
    #[inline]
    pub(crate) fn about_x(&self, v: &Vector3<T>) -> Vector3<T> {
        let Self { sin, cos } = *self;
        Vector3::new(v.x, cos * v.y - sin * v.z, sin * v.y + cos * v.z)
    }

    /// Rz·v.
    #[inline]
    pub(crate) fn about_z(&self, v: &Vector3<T>) -> Vector3<T> {
        let Self { sin, cos } = *self;
        Vector3::new(cos * v.x - sin * v.y, sin * v.x + cos * v.y, v.z)
    }

    /// `axes`·Rx: a frame turned about its own x axis.
    #[inline]
    pub(crate) fn frame_about_x(&self, axes: &Matrix3<T>) -> Matrix3<T> {
        let (y, z) = (axes.column(1), axes.column(2));
        let (turned_y, turned_z) = (y * self.cos + z * self.sin, z * self.cos - y * self.sin);
        Matrix3::from_columns(&[axes.column(0).into_owned(), turned_y, turned_z])
    }

    /// `axes`·Rz: a frame turned about its own z axis.
    #[inline]
    pub(crate) fn frame_about_z(&self, axes: &Matrix3<T>) -> Matrix3<T> {
        let (x, y) = (axes.column(0), axes.column(1));
        let (turned_x, turned_y) = (x * self.cos + y * self.sin, y * self.cos - x * self.sin);
        Matrix3::from_columns(&[turned_x, turned_y, axes.column(2).into_owned()])
    }

    /// Rx·I·Rxᵀ: what the turn takes from yy it gives to zz.
    #[inline]
    pub(crate) fn tensor_about_x(&self, &[xx, xy, xz, yy, yz, zz]: &[T; 6]) -> [T; 6] {
        let Self { sin, cos } = *self;
        let (a, b) = (cos * yy - sin * yz, cos * yz - sin * zz);
        let turned = cos * a - sin * b;
        [xx, cos * xy - sin * xz, sin * xy + cos * xz, turned, sin * a + cos * b, yy + zz - turned]
    }

    /// Rz·I·Rzᵀ: what the turn takes from xx it gives to yy.
    #[inline]
    pub(crate) fn tensor_about_z(&self, &[xx, xy, xz, yy, yz, zz]: &[T; 6]) -> [T; 6] {
        let Self { sin, cos } = *self;
        let (a, b) = (cos * xx - sin * xy, cos * xy - sin * yy);
        let turned = cos * a - sin * b;
        [turned, sin * a + cos * b, cos * xz - sin * yz, xx + yy - turned, sin * xz + cos * yz, zz]
    }
}

/// The inertia `of` a body with first moment h about a point from which the present one is `step` away, but for its mass:
/// I + 2·(s·h)·1 − s·hᵀ − h·sᵀ.
#[inline]
pub(crate) fn shifted<T: Scalar>(
    &[xx, xy, xz, yy, yz, zz]: &[T; 6],
    h: &Vector3<T>,
    step: &Vector3<T>,
) -> [T; 6] {
    let (x, y, z) = (h.x * step.x, h.y * step.y, h.z * step.z);
    let (x, y, z) = (x + x, y + y, z + z);
    [
        xx + (y + z),
        xy - (h.x * step.y + h.y * step.x),
        xz - (h.x * step.z + h.z * step.x),
        yy + (x + z),
        yz - (h.y * step.z + h.z * step.y),
        zz + (x + y),
    ]
}

#[inline]
fn sum<T: Scalar>(a: &[T; 6], b: &[T; 6]) -> [T; 6] {
    core::array::from_fn(|i| a[i] + b[i])
}

/// S·v of a symmetric 3×3 matrix (xx, xy, xz, yy, yz, zz).
#[inline]
pub(crate) fn symmetric_times<T: Scalar>(&[xx, xy, xz, yy, yz, zz]: &[T; 6], v: &Vector3<T>) -> Vector3<T> {
    Vector3::new(
        xx * v.x + xy * v.y + xz * v.z,
        xy * v.x + yy * v.y + yz * v.z,
        xz * v.x + yz * v.y + zz * v.z,
    )
}

/// R·S·Rᵀ of a symmetric 3×3 matrix (xx, xy, xz, yy, yz, zz).
#[inline]
pub(crate) fn rotate_symmetric<T: Scalar>(r: &Matrix3<T>, &[xx, xy, xz, yy, yz, zz]: &[T; 6]) -> [T; 6] {
    let turned = r * Matrix3::new(xx, xy, xz, xy, yy, yz, xz, yz, zz) * r.transpose();
    [turned[(0, 0)], turned[(1, 0)], turned[(2, 0)], turned[(1, 1)], turned[(2, 1)], turned[(2, 2)]]
}
