//! Real arms, bases and grippers as the loop's plant, and the ports that boards and gauges are read from.

pub mod force_gauge;
#[cfg(feature = "fci")]
pub mod franka_arm;
#[cfg(feature = "fci")]
pub(crate) mod franka_hand;
pub mod gripper;
#[cfg(feature = "sim")]
pub mod live_firmware;
#[cfg_attr(not(feature = "board"), path = "ports_absent.rs")]
pub(crate) mod ports;
#[cfg(feature = "ros2")]
pub mod ros2_base;
#[cfg(feature = "fci")]
pub mod stand_in_base;
