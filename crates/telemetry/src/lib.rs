//! The only place that knows a transport or a log format.
//!
//! - [`audit`]: who asked the robot for what.
//! - [`description`]: what a client must know once to draw the robot and read its samples.
//! - `ros` (feature `ros`): messages of ROS 2 as bytes, both ways, and their definitions.
//! - [`parameter`]: the schema of parameters with present values.
//! - `net` (feature `net`): server and client over TCP or a Unix socket: batches of samples out, requests in.
//! - `log` (feature `log`): MCAP writer and reader: every sample, every byte of the Touch Board.
//! - `display` (feature `log`): what people are shown, in a log and live: messages that every viewer knows.
//!
//! Neither touches the loop: samples come through a bounded `rtrb` ring that this crate drains on threads of its
//! own. A program that only watches needs [`net::Connection`]; one that records needs [`log::Recorder`].
//!
//! This crate refuses to know: control laws, the Touch Board's format, and who draws.

pub mod audit;
pub mod calibration;
pub mod description;
#[cfg(feature = "log")]
pub mod display;
#[cfg(feature = "log")]
pub mod log;
#[cfg(feature = "net")]
pub mod net;
pub mod parameter;
#[cfg(feature = "ros")]
pub mod ros;

pub use description::RobotDescription;
pub use parameter::{ParameterDescription, ParameterForm, ParameterValue};
