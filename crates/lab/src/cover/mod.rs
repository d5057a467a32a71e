//! The cover: foams and calibrations, from touch to force, thresholds, recorded streams.

pub(crate) mod characterize;
#[cfg(test)]
mod detection;
pub(crate) mod latency;
pub(crate) mod map;
#[cfg(test)]
mod other_senses;
pub(crate) mod stream;
pub(crate) mod threshold;
