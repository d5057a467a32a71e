//! The cover: bytes of Touch Boards in, forces with an age and a health out.
//!
//! The layers, from bytes to newtons; each uses only those above it:
//! 1. [`datastream`]: text of the stock sketch to checked [`datastream::Frame`]s and back. [`touchline`]: the same for
//!    the line of our own [`firmware`]. A virtual board needs only these.
//! 2. [`board`]: events of one port; [`board::FrameSource`], the seam for another board or skin; and
//!    [`board::BoardMonitor`], which reads either text and finds faults of the stream.
//! 3. [`zero`]: tare and slow drift. [`health`]: faults of one taxel. [`model`]: counts below zero to newtons.
//! 4. [`cover`]: a [`Cover`] of `K` taxels on one or more boards. **The control loop needs this one.**
//! 5. `serial` (feature): the thread that moves bytes from a port into a ring.
//! 6. `calibration` (feature): fits of a model to trials, calibration files, guided sessions.
//!
//! The core is no_std, allocates nothing and never reads a clock or opens a port: bytes and time (ns of loop time)
//! are arguments, so a serial port, a lock-step board in memory and a replayed recording are the same to it.
#![no_std]
#![forbid(unsafe_code)]

#[cfg(any(feature = "serial", feature = "calibration", test))]
extern crate std;

pub mod board;
#[cfg(feature = "calibration")]
pub mod calibration;
pub mod cover;
pub mod cusum;
pub mod datastream;
pub mod firmware;
pub mod health;
mod lines;
pub mod model;
#[cfg(feature = "serial")]
pub mod serial;
pub mod touchline;
pub mod zero;

#[cfg(doctest)]
#[doc = include_str!("../README.md")]
struct Readme;

pub use board::{BoardEvent, Chunk, CloseReason, FrameSource, OpenFailure};
pub use cover::{Cover, CoverConfig, Electrode, Poll};
pub use firmware::Firmware;
pub use model::TaxelModel;
pub use zero::{TareRefusal, TareStatus};
