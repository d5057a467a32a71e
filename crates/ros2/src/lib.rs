//! ROS 2 without a ROS installation: messages as CDR, a velocity-controlled base behind `cmd_vel` and `odom`, and what
//! ROS users see of the robot.
//!
//! Without a feature this crate is pure: [`cdr`] and [`messages`], [`base::order`] (what is sent, and zero when the loop
//! hangs) and [`base::odometry`] (what is believed) as functions of time given as an argument. The transports are
//! features: `dds`, `zenoh`.

#![cfg_attr(
    test,
    allow(
        clippy::unwrap_used,
        clippy::expect_used,
        clippy::panic,
        reason = "tests stop at the first surprise"
    )
)]

pub mod base;
#[cfg(feature = "bridge")]
pub mod bridge;
#[cfg(feature = "dds")]
pub mod dds;
#[cfg(feature = "bridge")]
pub mod inputs;
pub mod network;
pub mod outputs;
pub mod rmw_zenoh;
pub mod transport;
#[cfg(feature = "zenoh")]
pub mod zenoh;

pub use moca_telemetry::ros::{Message, TypeName, cdr, messages};
