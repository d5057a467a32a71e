//! Nearest points of segments, and of a segment and a box.

use crate::scalar::{Scalar, between, of};
use nalgebra::Vector3;

/// Squared length below which a segment is a point, m².
const POINT_M2: f64 = 1e-18;
/// Distance below which two points are one, m.
const TOUCHING_M: f64 = 1e-9;

/// Both ends of a segment, m.
pub(super) type Segment<T> = [Vector3<T>; 2];

/// Shortest connection of two solids.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Connection<T> {
    /// Distance of the segments, m; less than 0 inside a box.
    pub(super) distance: T,
    /// Unit vector from the second solid to the first.
    pub(super) normal: Vector3<T>,
    /// Nearest point of the first segment, m.
    pub(super) point: Vector3<T>,
}

/// Connects two segments. Of parallel ones it connects the middle of what lies side by side; where they cross, the normal is
/// perpendicular to both.
#[inline]
pub(super) fn segments<T: Scalar>(first: &Segment<T>, second: &Segment<T>) -> Connection<T> {
    let (zero, one) = (T::zero(), T::one());
    let (along, other) = (first[1] - first[0], second[1] - second[0]);
    let gap = first[0] - second[0];
    let (aa, bb, ab) = (along.norm_squared(), other.norm_squared(), along.dot(&other));
    let (a_gap, b_gap) = (along.dot(&gap), other.dot(&gap));
    let point = of::<T>(POINT_M2);
    let share = |value: T| between(value, zero, one);
    let (s, t) = if aa <= point {
        (zero, if bb <= point { zero } else { share(b_gap / bb) })
    } else if bb <= point {
        (share(-a_gap / aa), zero)
    } else {
        let area = aa * bb - ab * ab;
        let s = if area > aa * bb * T::default_epsilon() * of(64.0) {
            share((ab * b_gap - a_gap * bb) / area)
        } else {
            let (one_end, other_end) = (-a_gap / aa, (ab - a_gap) / aa);
            share((one_end.min(other_end).max(zero) + one_end.max(other_end).min(one)) * of(0.5))
        };
        let t = (ab * s + b_gap) / bb;
        if t < zero {
            (share(-a_gap / aa), zero)
        } else if t > one {
            (share((ab - a_gap) / aa), one)
        } else {
            (s, t)
        }
    };
    let point = first[0] + along * s;
    let apart = point - (second[0] + other * t);
    let distance = apart.norm();
    let normal = if distance > of(TOUCHING_M) { apart / distance } else { across(&along, &other) };
    Connection { distance, normal, point }
}

/// Unit vector across two directions, each of which may be none.
#[cold]
fn across<T: Scalar>(along: &Vector3<T>, other: &Vector3<T>) -> Vector3<T> {
    let candidates = [
        along.cross(other),
        along.cross(&Vector3::x()),
        along.cross(&Vector3::y()),
        other.cross(&Vector3::x()),
        other.cross(&Vector3::y()),
    ];
    let scale = along.norm_squared() + other.norm_squared();
    let found = candidates
        .into_iter()
        .find(|v| v.norm_squared() > of::<T>(1e-12) * scale * scale && v.norm_squared() > T::zero());
    found.map_or_else(Vector3::z, |v| v / v.norm())
}

/// Connects a segment with a box of half lengths `half` about the origin, along the axes. Inside the box the distance is less
/// than 0, and the normal that of the nearest face.
///
/// The squared distance is convex along the segment, and its slope is linear between the crossings of the faces.
pub(super) fn segment_and_box<T: Scalar>(segment: &Segment<T>, half: &Vector3<T>) -> Connection<T> {
    let (zero, one) = (T::zero(), T::one());
    let along = segment[1] - segment[0];
    let excess = |s: T| (segment[0] + along * s).zip_map(half, |x, half| x - between(x, -half, half));
    let slope = |s: T| excess(s).dot(&along);
    let (mut low, mut high) = (zero, one);
    let s = if slope(zero) > zero {
        zero
    } else if slope(one) < zero {
        one
    } else {
        for axis in 0..3 {
            for face in [-half[axis], half[axis]] {
                let crossing = (face - segment[0][axis]) / along[axis];
                if crossing > low && crossing < high {
                    if slope(crossing) <= zero { low = crossing } else { high = crossing }
                }
            }
        }
        let (at_low, at_high) = (slope(low), slope(high));
        let rise = at_high - at_low;
        let share = if rise > zero { between(-at_low / rise, zero, one) } else { of(0.5) };
        low + (high - low) * share
    };
    let (point, excess) = (segment[0] + along * s, excess(s));
    let distance = excess.norm();
    if distance > of(TOUCHING_M) {
        return Connection { distance, normal: excess / distance, point };
    }
    let (mut depth, mut face) = (point[0].abs() - half[0], 0);
    for axis in 1..3 {
        let other = point[axis].abs() - half[axis];
        if other > depth {
            (depth, face) = (other, axis);
        }
    }
    let mut normal = Vector3::zeros();
    normal[face] = if point[face] < zero { -one } else { one };
    Connection { distance: depth, normal, point }
}
