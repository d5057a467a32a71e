//! Targets and motions of a gripper from ROS nodes: what a message asks for, and which node leads.
//!
//! One node leads at a time, as one client commands: a target of another one is refused until the first has been silent for
//! as long as a commander may be. Whether the bridge may command at all is the daemon's to say.

use crate::messages::{GripperCommand, PoseStamped, Time, Twist, TwistStamped, Vector3};
use moca_msgs::{GripperRequest, Target, TimedTarget, TouchPolicy, TwistAxes};
use moca_telemetry::net::wire::COMMAND_LEASE;
use std::time::Instant;

/// The frame of W.
const WORLD: &str = "world";
/// Change of the distance between a gripper's fingers, m/s: a [`GripperCommand`] has no field for it.
const FINGERS_M_S: f64 = 0.05;
/// Tolerance of a grasp's width, m; no field either.
const GRASP_TOLERANCE_M: f64 = 0.005;

/// The flange at a pose, in the frame `world`.
///
/// # Errors
/// Another frame, for whoever sent it.
pub fn pose(message: &PoseStamped) -> Result<TimedTarget, String> {
    let (header, pose) = (&message.header, &message.pose);
    if header.frame_id != WORLD {
        return Err(format!("frame_id {:?}: allowed: \"world\"", header.frame_id));
    }
    let (position_world, quaternion_world) = (pose.position.array(), pose.orientation.array());
    Ok(stamped(Target::Pose { position_world, quaternion_world }, &header.stamp))
}

/// A twist of the flange, in the axes of `world`, `base_link` or `flange`.
///
/// # Errors
/// Another frame, for whoever sent it.
pub fn twist(message: &TwistStamped) -> Result<TimedTarget, String> {
    let axes = match message.header.frame_id.as_str() {
        WORLD => TwistAxes::World,
        "base_link" => TwistAxes::Base,
        "flange" => TwistAxes::Flange,
        other => return Err(format!("frame_id {other:?}: allowed: \"world\", \"base_link\", \"flange\"")),
    };
    let ([x, y, z], [roll, pitch, yaw]) = (message.twist.linear.array(), message.twist.angular.array());
    Ok(stamped(Target::Twist { axes, twist: [x, y, z, roll, pitch, yaw] }, &message.header.stamp))
}

/// A navigation's velocity for the base: it passes through while nobody touches.
///
/// # Errors
/// A motion that a base has not.
pub fn base(Twist { linear, angular }: &Twist) -> Result<TimedTarget, String> {
    let (Vector3 { x, y, z }, Vector3 { x: roll, y: pitch, z: yaw }) = (linear, angular);
    for (name, value) in [("linear.z", z), ("angular.x", roll), ("angular.y", pitch)] {
        if *value != 0.0 {
            return Err(format!("{name} = {value}: allowed: 0, a base moves in the plane"));
        }
    }
    let target = Target::BaseVelocity { velocity_body: [*x, *y, *yaw] };
    Ok(TimedTarget { touch: TouchPolicy::PassThrough, ..TimedTarget::new(target) })
}

/// A motion of a gripper, whose position is that of each finger: half the distance between them. With an effort it is a
/// grasp with that force, without one it only moves the fingers.
pub fn gripper(&GripperCommand { position, max_effort: force_n }: &GripperCommand) -> GripperRequest {
    let (width_m, speed_m_s) = (2.0 * position, FINGERS_M_S);
    if force_n == 0.0 {
        return GripperRequest::Move { width_m, speed_m_s };
    }
    GripperRequest::Grasp { width_m, speed_m_s, force_n, tolerance_m: GRASP_TOLERANCE_M, mass_kg: 0.0 }
}

/// A stamp of 0 is none: it counts from its arrival.
fn stamped(target: Target, stamp: &Time) -> TimedTarget {
    TimedTarget { stamp_unix_ns: stamp.unix_ns(), ..TimedTarget::new(target) }
}

/// Which node leads.
#[derive(Debug, Default)]
pub struct Leader(Option<(Vec<u8>, Instant)>);

impl Leader {
    /// Returns true if a target of the node `who` counts; that node leads from then on.
    ///
    /// ```
    /// use moca_ros2::inputs::Leader;
    /// use std::time::{Duration, Instant};
    ///
    /// let (mut leader, now) = (Leader::default(), Instant::now());
    /// assert!(leader.takes(b"planner", now));
    /// assert!(!leader.takes(b"teleoperation", now + Duration::from_secs(2)));
    /// assert!(leader.takes(b"teleoperation", now + Duration::from_secs(4)), "the planner has gone");
    /// ```
    pub fn takes(&mut self, who: &[u8], now: Instant) -> bool {
        let other = self.leads(now) && self.0.as_ref().is_some_and(|(leader, _)| leader != who);
        if !other {
            self.0 = Some((who.to_vec(), now));
        }
        !other
    }

    /// Returns true if a node leads.
    pub fn leads(&self, now: Instant) -> bool {
        self.0.as_ref().is_some_and(|(_, heard)| now.saturating_duration_since(*heard) < COMMAND_LEASE)
    }

    /// Nobody does.
    pub fn release(&mut self) {
        self.0 = None;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::messages::{Header, Pose};
    use moca_msgs::gripper::FRANKA_HAND;

    fn header(frame_id: &str) -> Header {
        Header { stamp: Time { sec: 1_700_000_000, nanosec: 5 }, frame_id: frame_id.into() }
    }

    #[test]
    fn effort_makes_a_grasp_of_a_motion() {
        let asked = |position, max_effort| gripper(&GripperCommand { position, max_effort });
        assert_eq!(asked(0.04, 0.0), GripperRequest::Move { width_m: 0.08, speed_m_s: 0.05 });
        let (width_m, speed_m_s, tolerance_m, mass_kg) = (0.05, 0.05, 0.005, 0.0);
        let grasp = GripperRequest::Grasp { width_m, speed_m_s, force_n: 40.0, tolerance_m, mass_kg };
        assert_eq!(asked(0.025, 40.0), grasp);
        for (position, max_effort, said) in [
            (0.08, 0.0, "width of the gripper = 0.16 m; allowed: 0 to 0.08 m"),
            (f64::NAN, 0.0, "width of the gripper = NaN m; allowed: 0 to 0.08 m"),
            (0.025, f64::NAN, "force of the gripper = NaN N; allowed: 1 to 70 N"),
            (0.025, -40.0, "force of the gripper = -40 N; allowed: 1 to 70 N"),
        ] {
            assert_eq!(asked(position, max_effort).check(&FRANKA_HAND).unwrap_err().to_string(), said);
        }
    }

    #[test]
    fn node_leads_until_it_has_been_silent_or_is_released() {
        let (mut leader, now) = (Leader::default(), Instant::now());
        assert!(!leader.leads(now));
        assert!(leader.takes(b"planner", now));
        assert!(leader.leads(now + COMMAND_LEASE / 2) && !leader.leads(now + COMMAND_LEASE));
        leader.release();
        assert!(!leader.leads(now));
    }

    #[test]
    fn target_uses_its_frame_and_stamp() {
        let message = PoseStamped { header: header("world"), pose: Pose::default() };
        let timed = pose(&message).unwrap();
        assert_eq!(timed.stamp_unix_ns, 1_700_000_000_000_000_005);
        assert!(matches!(timed.target, Target::Pose { .. }) && timed.touch == TouchPolicy::TouchWins);
        let said = pose(&PoseStamped { header: header("map"), ..message }).unwrap_err();
        assert_eq!(said, "frame_id \"map\": allowed: \"world\"");

        let turn = Twist { linear: Vector3::from([0.1, 0.0, 0.0]), angular: Vector3::from([0.0, 0.0, 0.2]) };
        for (frame, axes) in
            [("world", TwistAxes::World), ("base_link", TwistAxes::Base), ("flange", TwistAxes::Flange)]
        {
            let message = TwistStamped { header: header(frame), twist: turn.clone() };
            let wanted = Target::Twist { axes, twist: [0.1, 0.0, 0.0, 0.0, 0.0, 0.2] };
            assert_eq!(twist(&message).unwrap().target, wanted);
        }
        let message = TwistStamped { header: header(""), twist: turn.clone() };
        assert!(twist(&message).unwrap_err().starts_with("frame_id \"\": allowed:"));

        let driven = base(&turn).unwrap();
        assert_eq!(driven.target, Target::BaseVelocity { velocity_body: [0.1, 0.0, 0.2] });
        assert_eq!((driven.touch, driven.stamp_unix_ns), (TouchPolicy::PassThrough, 0));
        for wrong in [Vector3::from([0.0, 0.0, 0.1]), Vector3::from([0.0, 0.0, f64::NAN])] {
            let said = base(&Twist { linear: wrong, ..turn.clone() }).unwrap_err();
            assert!(said.starts_with("linear.z = "), "{said}");
        }
    }
}
