//! The arm's own estimate of what pushes it, moved from the point that it speaks of to the flange: pure.
//!
//! ```
//! use moca_franka::wrench::{Pose, at_flange};
//!
//! let identity: Pose = [1., 0., 0., 0., 0., 1., 0., 0., 0., 0., 1., 0., 0., 0., 0., 1.];
//! let mut hand = identity;
//! hand[14] = 0.1; // its hand is 0.1 m along the flange's z axis
//! let push = [10.0, 0.0, 0.0, 0.0, 0.0, 0.0]; // 10 N along x at the hand
//! assert_eq!(at_flange(&push, &hand, &hand, &identity), [10.0, 0.0, 0.0, 0.0, 1.0, 0.0]);
//! ```

/// A homogeneous transform, 4×4, column by column.
pub type Pose = [f64; 16];

/// `wrench_k` \[N; N·m\] about the origin of the stiffness frame K, in the axes of the arm's base, as the same about the
/// flange's origin. `base_hand` is the hand's pose in the base, `flange_hand` in the flange, `hand_k` K's in the hand.
pub fn at_flange(wrench_k: &[f64; 6], base_hand: &Pose, flange_hand: &Pose, hand_k: &Pose) -> [f64; 6] {
    // From the flange's origin to K's, in the axes of the hand, then of the base.
    let from_flange = turned_back(flange_hand, place(flange_hand));
    let in_hand: [f64; 3] = core::array::from_fn(|i| place(hand_k)[i] + from_flange[i]);
    let [rx, ry, rz] = turned(base_hand, in_hand);
    let [fx, fy, fz, mx, my, mz] = *wrench_k;
    [fx, fy, fz, mx + ry * fz - rz * fy, my + rz * fx - rx * fz, mz + rx * fy - ry * fx]
}

const fn place(pose: &Pose) -> [f64; 3] {
    [pose[12], pose[13], pose[14]]
}

fn turned(pose: &Pose, v: [f64; 3]) -> [f64; 3] {
    core::array::from_fn(|row| (0..3).map(|column| pose[4 * column + row] * v[column]).sum())
}

fn turned_back(pose: &Pose, v: [f64; 3]) -> [f64; 3] {
    core::array::from_fn(|row| (0..3).map(|column| pose[4 * row + column] * v[column]).sum())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn pose(rpy: [f64; 3], place: [f64; 3]) -> Pose {
        let [(sr, cr), (sp, cp), (sy, cy)] = rpy.map(f64::sin_cos);
        let [x, y, z] = place;
        [
            cy * cp,
            sy * cp,
            -sp,
            0.0,
            cy * sp * sr - sy * cr,
            sy * sp * sr + cy * cr,
            cp * sr,
            0.0,
            cy * sp * cr + sy * sr,
            sy * sp * cr - cy * sr,
            cp * cr,
            0.0,
            x,
            y,
            z,
            1.0,
        ]
    }

    /// The power of a wrench on a rigid body is the same about any of its points.
    #[test]
    fn the_power_of_a_motion_is_the_same_about_both_points() {
        let (base_hand, flange_hand) =
            (pose([0.3, -1.1, 2.0], [0.4, 0.1, 0.5]), pose([0.1, 0.2, -0.78], [0.01, 0.02, 0.1]));
        let hand_k = pose([0.5, 0.0, 0.0], [0.03, -0.01, 0.05]);
        let wrench_k = [3.0, -7.0, 11.0, 0.5, -0.2, 0.9];
        let wrench = at_flange(&wrench_k, &base_hand, &flange_hand, &hand_k);
        // K's origin seen from the flange's, in the base: hand minus the way back to the flange, plus the way to K.
        let back = turned_back(&flange_hand, place(&flange_hand));
        let ways = [turned(&base_hand, back), turned(&base_hand, place(&hand_k))];
        let r: [f64; 3] = core::array::from_fn(|i| ways[0][i] + ways[1][i]);
        let (v, w) = ([0.2, 0.5, -0.1], [1.0, -0.4, 0.7]);
        let v_k = [
            v[0] + w[1] * r[2] - w[2] * r[1],
            v[1] + w[2] * r[0] - w[0] * r[2],
            v[2] + w[0] * r[1] - w[1] * r[0],
        ];
        let power = |wrench: [f64; 6], v: [f64; 3]| {
            (0..3).map(|i| wrench[i] * v[i] + wrench[3 + i] * w[i]).sum::<f64>()
        };
        assert!((power(wrench, v) - power(wrench_k, v_k)).abs() < 1e-12);
    }
}
