//! Implementations of the loop's traits: Touch Board, ideal cover, simulated robot; and the ports they are read from.

pub mod board_events;
#[cfg(feature = "sim")]
pub mod firmware_board;
pub mod force_gauge;
#[cfg(feature = "fci")]
pub mod franka_arm;
#[cfg(feature = "sim")]
pub mod ideal_cover;
#[cfg_attr(not(feature = "board"), path = "ports_absent.rs")]
pub(crate) mod ports;
#[cfg(feature = "ros2")]
pub mod ros2_base;
pub mod scripted_press;
#[cfg(feature = "sim")]
pub mod simulated_robot;
#[cfg(feature = "fci")]
pub mod stand_in_base;
pub mod touch_board;
