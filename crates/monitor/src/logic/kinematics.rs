//! Forward kinematics of the arm, from the joint frames of the robot's description.

use moca_telemetry::RobotDescription;

/// A rotation and a translation: x ↦ R x + p.
#[derive(Clone, Copy)]
struct Pose {
    rotation: [[f64; 3]; 3],
    position: [f64; 3],
}

impl Pose {
    /// x, y, z m; roll, pitch, yaw rad, R = Rz·Ry·Rx.
    fn from_origin([x, y, z, roll, pitch, yaw]: [f64; 6]) -> Self {
        let ((sr, cr), (sp, cp), (sy, cy)) = (roll.sin_cos(), pitch.sin_cos(), yaw.sin_cos());
        let rotation = [
            [cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr],
            [sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr],
            [-sp, cp * sr, cp * cr],
        ];
        Self { rotation, position: [x, y, z] }
    }

    fn then(self, next: Self) -> Self {
        let row = |i: usize, v: [f64; 3]| (0..3).map(|k| self.rotation[i][k] * v[k]).sum::<f64>();
        let column = |j: usize| [next.rotation[0][j], next.rotation[1][j], next.rotation[2][j]];
        Self {
            rotation: std::array::from_fn(|i| std::array::from_fn(|j| row(i, column(j)))),
            position: std::array::from_fn(|i| self.position[i] + row(i, next.position)),
        }
    }
}

/// A point of the base in the world; `pose_world` is that of the base: m, m, rad.
pub fn in_world(pose_world: [f64; 3], [x, y, z]: [f64; 3]) -> [f64; 3] {
    let [x0, y0, yaw] = pose_world;
    let (sin, cos) = yaw.sin_cos();
    [x0 + cos * x - sin * y, y0 + sin * x + cos * y, z]
}

/// The axes of a frame as a unit quaternion x, y, z, w gives its orientation: x, y and z axis as unit vectors.
pub fn axes([x, y, z, w]: [f64; 4]) -> [[f64; 3]; 3] {
    [
        [1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y + z * w), 2.0 * (x * z - y * w)],
        [2.0 * (x * y - z * w), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z + x * w)],
        [2.0 * (x * z + y * w), 2.0 * (y * z - x * w), 1.0 - 2.0 * (x * x + y * y)],
    ]
}

/// Origins of the arm's base, of each joint and of the flange, in B, m. Joints without an angle stay at 0.
pub fn points_base_m(description: &RobotDescription, q_rad: &[f64]) -> Vec<[f64; 3]> {
    let (arm, mount) = (&description.arm, &description.mount);
    let ([x, y, z], [roll, pitch, yaw]) = (mount.position_base_m, mount.rpy_rad);
    let mut pose = Pose::from_origin([x, y, z, roll, pitch, yaw]);
    let mut points = vec![pose.position];
    for (i, origin) in arm.table.joint_origin.iter().take(arm.joints).enumerate() {
        let turn = Pose::from_origin([0.0, 0.0, 0.0, 0.0, 0.0, q_rad.get(i).copied().unwrap_or(0.0)]);
        pose = pose.then(Pose::from_origin(*origin)).then(turn);
        points.push(pose.position);
    }
    points.push(pose.then(Pose::from_origin(arm.table.flange_origin)).position);
    points
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn quarter_turn_takes_front_left_and_x_to_y() {
        let front = in_world([1.0, 2.0, std::f64::consts::FRAC_PI_2], [0.5, 0.0, 0.3]);
        let half = std::f64::consts::FRAC_1_SQRT_2;
        let [x, y, z] = axes([0.0, 0.0, half, half]);
        let expected =
            [([1.0, 2.5, 0.3], front), ([0.0, 1.0, 0.0], x), ([-1.0, 0.0, 0.0], y), ([0.0, 0.0, 1.0], z)];
        for (expected, actual) in expected {
            assert!(expected.iter().zip(actual).all(|(a, b)| (a - b).abs() < 1e-12), "{actual:?}");
        }
    }

    #[test]
    fn the_flange_of_a_panda_at_home_is_where_its_maker_says() {
        // libfranka's start posture: O_T_EE has (0.3069, 0, 0.4869) for a hand 0.1034 m below the flange.
        let robot = RobotDescription::paper("test", true);
        let points = points_base_m(&robot, &moca_msgs::robot::PANDA.home_rad);
        assert_eq!(points.len(), 9);
        let flange = points[8];
        for (value, expected) in flange.into_iter().zip([0.20 + 0.3069, 0.0, 0.51 + 0.4869 + 0.1034]) {
            assert!((value - expected).abs() < 1e-3, "{flange:?}");
        }
    }
}
