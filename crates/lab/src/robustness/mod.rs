//! Faults on purpose, hours of random handling, and what watching costs.

pub(crate) mod attack;
pub(crate) mod clients;
mod cover_speed;
pub(crate) mod faults;
mod hands;
pub(crate) mod lean;
pub(crate) mod long_lean;
#[cfg(test)]
mod lost_packets;
pub(crate) mod protection;
#[cfg(test)]
mod recentre;
pub(crate) mod recording;
pub(crate) mod self_collision;
pub(crate) mod soak;
#[cfg(test)]
mod targets;
mod trial;
mod watch;
