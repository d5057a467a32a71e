//! Poses of every frame of the robot. Frames have the names of the links in the robot's URDF; `world` is where the base
//! started and `flange_desired` the desired flange.

use crate::RobotDescription;
use crate::ros::messages::{
    Header, JointState, Pose, PoseStamped, TFMessage, Time, Transform, TransformStamped, Wrench,
    WrenchStamped,
};
use moca_msgs::Sample;

pub(super) const WORLD: &str = "world";
pub(super) const BASE: &str = "base_link";
pub(super) const DESIRED: &str = "flange_desired";
const FLANGE: &str = "flange";
const UNTURNED: [f64; 4] = [0.0, 0.0, 0.0, 1.0];

/// Link `i` of the arm; 0 stands on the base.
pub(super) fn link(i: usize) -> String {
    format!("arm_link{i}")
}

/// Taxel `i`, 0 is T1.
pub(super) fn taxel(i: usize) -> String {
    format!("taxel_{}", i + 1)
}

/// R = Rz·Ry·Rx as a quaternion x, y, z, w.
fn from_rpy([roll, pitch, yaw]: [f64; 3]) -> [f64; 4] {
    let ((sr, cr), (sp, cp), (sy, cy)) =
        ((roll / 2.0).sin_cos(), (pitch / 2.0).sin_cos(), (yaw / 2.0).sin_cos());
    [
        sr * cp * cy - cr * sp * sy,
        cr * sp * cy + sr * cp * sy,
        cr * cp * sy - sr * sp * cy,
        cr * cp * cy + sr * sp * sy,
    ]
}

/// First `b`, then `a`.
fn product([ax, ay, az, aw]: [f64; 4], [bx, by, bz, bw]: [f64; 4]) -> [f64; 4] {
    [
        aw * bx + ax * bw + ay * bz - az * by,
        aw * by - ax * bz + ay * bw + az * bx,
        aw * bz + ax * by - ay * bx + az * bw,
        aw * bw - ax * bx - ay * by - az * bz,
    ]
}

fn transform(
    at: &Time,
    parent: &str,
    child: String,
    translation: [f64; 3],
    rotation: [f64; 4],
) -> TransformStamped {
    TransformStamped {
        header: Header::new(at, parent),
        child_frame_id: child,
        transform: Transform { translation: translation.into(), rotation: rotation.into() },
    }
}

fn split([x, y, z, roll, pitch, yaw]: [f64; 6]) -> ([f64; 3], [f64; 4]) {
    ([x, y, z], from_rpy([roll, pitch, yaw]))
}

/// Returns the fixed frames: the arm on the base, the flange on the last link, the taxels on the base.
pub(super) fn fixed(robot: &RobotDescription, at: &Time) -> TFMessage {
    let mut transforms = Vec::new();
    if has_arm(robot) {
        let turn = from_rpy(robot.mount.rpy_rad);
        transforms.push(transform(at, BASE, link(0), robot.mount.position_base_m, turn));
        let (place, turn) = split(robot.arm.table.flange_origin);
        let last = link(robot.arm.joints);
        transforms.push(transform(at, &last, FLANGE.into(), place, turn));
    }
    for (i, placement) in robot.taxels.iter().enumerate() {
        let [x, y] = placement.position_base_m;
        let turn = from_rpy([0.0, 0.0, placement.inward_angle_base_rad]);
        transforms.push(transform(at, BASE, taxel(i), [x, y, robot.base_size_m[2] / 2.0], turn));
    }
    TFMessage { transforms }
}

/// Returns the moving frames: the base, the links, the desired flange.
pub(super) fn moving(robot: &RobotDescription, sample: &Sample, at: &Time) -> TFMessage {
    let [x, y, yaw] = sample.base_pose_world;
    let mut transforms = vec![transform(at, WORLD, BASE.into(), [x, y, 0.0], from_rpy([0.0, 0.0, yaw]))];
    for (i, (origin, q_rad)) in joint_origins(robot).iter().zip(&sample.q_rad).enumerate() {
        let (place, turn) = split(*origin);
        let turn = product(turn, from_rpy([0.0, 0.0, *q_rad]));
        transforms.push(transform(at, &link(i), link(i + 1), place, turn));
    }
    if has_arm(robot) {
        let (place, turn) = (sample.flange_desired_position_world, sample.flange_desired_quaternion_world);
        transforms.push(transform(at, WORLD, DESIRED.into(), place, unit_or_unturned(turn)));
    }
    TFMessage { transforms }
}

pub(super) fn has_arm(robot: &RobotDescription) -> bool {
    robot.arm.joints > 0
}

/// Each joint's frame in its parent link.
pub(super) fn joint_origins(robot: &RobotDescription) -> &[[f64; 6]] {
    robot.arm.table.joint_origin.get(..robot.arm.joints).unwrap_or_default()
}

/// Before the first tick of a law nothing is desired, and its quaternion is zero: viewers refuse an invalid rotation.
fn unit_or_unturned(quaternion: [f64; 4]) -> [f64; 4] {
    if quaternion.iter().any(|part| *part != 0.0) { quaternion } else { UNTURNED }
}

/// The flange, measured.
pub(super) fn flange(sample: &Sample, at: &Time) -> PoseStamped {
    pose(at, sample.flange_position_world, sample.flange_quaternion_world)
}

/// The flange, wanted.
pub(super) fn flange_desired(sample: &Sample, at: &Time) -> PoseStamped {
    pose(at, sample.flange_desired_position_world, sample.flange_desired_quaternion_world)
}

fn pose(at: &Time, position: [f64; 3], orientation: [f64; 4]) -> PoseStamped {
    let orientation = unit_or_unturned(orientation).into();
    PoseStamped { header: Header::new(at, WORLD), pose: Pose { position: position.into(), orientation } }
}

/// The wrench of the cover in the base's frame.
pub(super) fn cover_wrench(sample: &Sample, at: &Time) -> WrenchStamped {
    let [fx, fy, mz] = sample.cover_wrench_base;
    let wrench = Wrench { force: [fx, fy, 0.0].into(), torque: [0.0, 0.0, mz].into() };
    WrenchStamped { header: Header::new(at, BASE), wrench }
}

/// Angles, rates and commanded torques of the joints.
pub(super) fn joints(sample: &Sample, at: &Time) -> JointState {
    JointState {
        header: Header::new(at, ""),
        name: (1..=sample.q_rad.len()).map(|i| format!("arm_joint{i}")).collect(),
        position: sample.q_rad.to_vec(),
        velocity: sample.dq_rad_s.to_vec(),
        effort: sample.arm_torque_nm.to_vec(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use moca_msgs::robot::PANDA;

    fn turned([x, y, z, w]: [f64; 4], [a, b, c]: [f64; 3]) -> [f64; 3] {
        // v + 2 u × (u × v + w v)
        let t = [y * c - z * b + w * a, z * a - x * c + w * b, x * b - y * a + w * c];
        [a + 2.0 * (y * t[2] - z * t[1]), b + 2.0 * (z * t[0] - x * t[2]), c + 2.0 * (x * t[1] - y * t[0])]
    }

    /// A frame's origin in the world, through every transform on the way.
    fn origin(tree: &[TransformStamped], mut frame: String) -> [f64; 3] {
        let mut point = [0.0; 3];
        while frame != WORLD {
            let step = tree.iter().find(|step| step.child_frame_id == frame).unwrap();
            let Quaternion { x, y, z, w } = step.transform.rotation;
            let at = &step.transform.translation;
            let turned = turned([x, y, z, w], point);
            point = [turned[0] + at.x, turned[1] + at.y, turned[2] + at.z];
            frame = step.header.frame_id.clone();
        }
        point
    }

    use crate::ros::messages::Quaternion;

    #[test]
    fn the_tree_of_frames_leads_to_the_flange() {
        let robot = RobotDescription::paper("test", true);
        let mut sample =
            Sample { base_pose_world: [1.0, 2.0, std::f64::consts::FRAC_PI_2], ..Sample::default() };
        sample.q_rad.extend(PANDA.home_rad);
        let at = Time::default();
        let tree = [fixed(&robot, &at).transforms, moving(&robot, &sample, &at).transforms].concat();
        // libfranka's start posture: O_T_EE has (0.3069, 0, 0.4869) for a hand 0.1034 m below the flange; a base that
        // has turned to the left has it on its left.
        let expected = [1.0, 2.0 + 0.20 + 0.3069, 0.51 + 0.4869 + 0.1034];
        let flange = origin(&tree, FLANGE.into());
        assert!(flange.iter().zip(expected).all(|(a, b)| (a - b).abs() < 1e-3), "{flange:?}");
        let front = origin(&tree, taxel(5));
        assert!(front.iter().zip([1.0, 2.489]).all(|(a, b)| (a - b).abs() < 1e-12), "{front:?}");
    }
}
