//! A base behind ROS 2: velocity orders out, odometry in.

pub mod odometry;
pub mod order;
