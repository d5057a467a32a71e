//! The dashboard without a display: every control, by its accessible label, sends its command.
#![allow(clippy::unwrap_used, clippy::panic, reason = "test helpers fail by panicking")]

mod bench;
mod calibration;
mod commanding;
mod fleet;
mod gripper;
mod layout;
mod logs;
mod parameters;
mod plots;
mod states;
