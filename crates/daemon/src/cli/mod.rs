//! Commands on a terminal besides the loop, and the report of a run.

#[cfg(feature = "tls")]
pub mod access;
mod board_report;
pub mod calibrate;
pub mod doctor;
#[cfg(feature = "fci")]
mod doctor_arm;
#[cfg(feature = "ros2")]
mod doctor_base;
mod doctor_stops;
mod finding;
pub mod log;
mod log_story;
mod network;
pub mod operate;
pub mod operator;
pub mod params;
pub mod progress;
pub mod remote;
pub mod report;
mod status;
pub mod target;
pub mod terminal;
