//! A Franka arm over FCI, for a loop that never waits.
//!
//! FCI demands an answer to each of its datagrams within a millisecond, and its client blocks for up to seconds where it
//! connects, starts, stops, recovers or has lost the arm. So the connection has a thread of its own (`Fci`, feature
//! `fci`): the newest state goes to the loop and the newest order back as latest values, without lock or ring. An order that
//! does not come in time is replaced by the last one, counted, and after [`REPEATS_MAX`] in a row the arm is left to its own
//! controller.
//!
//! Decisions that need no connection are pure functions in [`limiter`], [`mode`], [`count`] and
//! [`wrench`].

#[cfg(feature = "fci")]
mod carried;
pub mod count;
#[cfg(feature = "fci")]
mod fci;
#[cfg(feature = "fci")]
mod hand;
pub mod limiter;
pub mod mode;
mod model;
pub mod wrench;

#[cfg(feature = "fci")]
pub use carried::{Carried, carried};
#[cfg(feature = "fci")]
pub use fci::{ArmState, CARRIES_APART_KG, Fci, Settings};
#[cfg(feature = "fci")]
pub use hand::Hand;

pub use model::Model;

/// Joints of every arm that speaks FCI.
pub const JOINTS: usize = 7;

/// Orders repeated in a row before the arm is left to its own controller: the arm itself gives up a line that is silent for as
/// many milliseconds.
pub const REPEATS_MAX: u32 = 20;
