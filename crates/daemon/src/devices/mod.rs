//! What can stand behind the loop's traits: Touch Board, ideal cover, simulated robot; and the ports they are read from.

pub mod board_events;
#[cfg(feature = "sim")]
pub mod firmware_board;
pub mod force_gauge;
#[cfg(feature = "sim")]
pub mod ideal_cover;
#[cfg_attr(not(feature = "board"), path = "ports_absent.rs")]
pub(crate) mod ports;
#[cfg(feature = "ros2")]
pub mod ros2_base;
pub mod scripted_press;
#[cfg(feature = "sim")]
pub mod simulated_robot;
pub mod touch_board;
