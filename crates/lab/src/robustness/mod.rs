//! Faults on purpose, hours of random handling, and what watching costs.

pub(crate) mod clients;
pub(crate) mod faults;
pub(crate) mod joint_limits;
pub(crate) mod lean;
pub(crate) mod lost_packets;
pub(crate) mod protection;
pub(crate) mod soak;
pub(crate) mod targets;
mod trial;
