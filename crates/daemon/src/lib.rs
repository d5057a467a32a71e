//! The daemon of MOCA-S: the only place where its parts meet.
//!
//! From the inside out:
//! 1. [`control_loop`]: one tick: read the plant, feel the cover, decide the mode, command, write.
//! 2. [`supervisor`]: which mode, and why; [`motion`]: which law, and how it is entered; [`protection`]: how fast the
//!    base may go and what it does when touched too hard ([`contact_events`], [`contact_limits`]).
//! 3. [`live`] and [`lockstep`]: who calls the tick: the wall clock ([`pace`], [`schedule`]) or a caller that wants every
//!    tick now, deterministic.
//! 4. [`plant`], [`cover_source`]: what a robot and a cover are to the loop; [`simulated`], [`byte_cover`],
//!    [`ideal_cover`]: those there are; `board_port` opens serial ports (feature `board`, else nothing does).
//! 5. [`door`]: what of the robot's state is let in; [`inject`]: faults on purpose.
//! 6. [`config`], [`parameters`], [`assemble`]: from a file to the parts; [`run`] and its observers ([`console`],
//!    [`recording`], [`flight`], [`tape`], [`replay`], [`params_command`]): what a user sees of it.
//!
//! The loop refuses to know who watches it: samples leave through a bounded ring, requests arrive through another.

pub mod allocations;
pub mod assemble;
#[cfg_attr(not(feature = "board"), path = "board_port_absent.rs")]
mod board_port;
pub mod byte_cover;
pub mod calibrate;
pub mod calibrator;
pub mod command_log;
pub mod config;
pub mod console;
pub mod contact_events;
pub mod contact_limits;
pub mod control_loop;
pub mod cover_source;
pub mod doctor;
pub mod door;
pub mod flight;
pub mod gauge;
pub mod hand;
#[cfg(feature = "sim")]
pub mod ideal_cover;
pub mod inject;
pub mod live;
#[cfg(feature = "sim")]
pub mod lockstep;
pub mod motion;
mod observers;
pub mod pace;
pub mod parameters;
pub mod params_command;
pub mod plant;
pub mod protection;
pub mod realtime;
pub mod recording;
pub mod replay;
pub mod run;
pub mod schedule;
pub mod service;
#[cfg(feature = "sim")]
pub mod simulated;
pub mod supervisor;
pub mod tape;
pub mod timing;
