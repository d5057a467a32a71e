//! Targets from ROS nodes: what a message asks for, and which node leads.
//!
//! One node leads at a time, as one client commands: a target of another one is refused until the first has been silent for
//! as long as a commander may be. Whether the bridge may command at all is the daemon's to say.

use crate::messages::{PoseStamped, Time, Twist, TwistStamped, Vector3};
use moca_msgs::{Target, TimedTarget, TouchPolicy, TwistAxes};
use moca_telemetry::net::wire::COMMAND_LEASE;
use std::time::Instant;

/// The frame of W.
const WORLD: &str = "world";

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
        let other = self.0.as_ref().is_some_and(|(leader, heard)| {
            leader != who && now.saturating_duration_since(*heard) < COMMAND_LEASE
        });
        if !other {
            self.0 = Some((who.to_vec(), now));
        }
        !other
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

    fn header(frame_id: &str) -> Header {
        Header { stamp: Time { sec: 1_700_000_000, nanosec: 5 }, frame_id: frame_id.into() }
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
