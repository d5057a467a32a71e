//! A base behind ROS 2: velocity orders out, odometry in.
//!
//! Frames: the pose is in the odometry's `header.frame_id`, which is our W; it drifts, and slips where the wheels do. The
//! laws are relative to where they started, so that only what changes while they move matters; a target in a map does
//! not belong there. The twist is in the axes of `child_frame_id`, which has to be our B.

pub mod driver;
pub mod odometry;
pub mod order;

pub use driver::{BaseCounts, BaseSettings, BaseState, Ros2Base};
