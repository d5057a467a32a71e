//! Devices that may come in, and what they may ask.
//!
//! Layers: [`role`] (the one table of requests and roles) · `secret` (random numbers and hashes) · [`devices`] (paired
//! devices and one-time codes) · `authority` (the robot's own certificate authority).

pub(crate) mod authority;
pub mod devices;
pub mod role;
mod secret;

pub use role::Role;
