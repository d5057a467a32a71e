//! Devices that may come in. What each may ask says the table of [`moca_telemetry::net::access`], the daemon's own.
//!
//! Layers: `secret` (random numbers and hashes) · [`devices`] (paired devices and one-time codes) · `authority` (the robot's own
//! certificate authority).

pub(crate) mod authority;
pub mod devices;
mod secret;

pub use moca_telemetry::net::access::Role;
