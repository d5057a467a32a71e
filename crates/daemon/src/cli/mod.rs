//! Commands on a terminal besides the loop, and the report of a run.

#[cfg(feature = "tls")]
pub mod access;
pub mod calibrate;
pub mod doctor;
pub mod log;
mod log_story;
pub mod operate;
pub mod operator;
pub mod params;
pub mod progress;
pub mod remote;
pub mod report;
mod status;
pub mod target;
pub mod terminal;
