//! A base behind ROS 2: velocity orders out, odometry in.
//!
//! Frames: the pose is in the odometry's `header.frame_id`, which is our W; it drifts, and slips where the wheels do. The
//! laws are relative to where they started, so that only what changes while they move matters; a target in a map does
//! not belong there. The twist is in the axes of `child_frame_id`, which has to be our B.

pub mod driver;
pub mod odometry;
pub mod order;
pub mod timeout;

use crate::cdr;
use crate::messages::Odometry;

pub use driver::{BaseCounts, BaseSettings, BaseState, Reliable, Ros2Base};

/// Returns the speed in an odometry message, in any direction, m/s; `None` if the payload is not odometry.
pub(crate) fn odometry_velocity(payload: &[u8]) -> Option<f64> {
    let twist = cdr::decode::<Odometry>(payload).ok()?.twist.twist;
    let speed = twist.linear.x.hypot(twist.linear.y);
    speed.is_finite().then_some(speed)
}
