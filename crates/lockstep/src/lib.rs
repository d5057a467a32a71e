//! A robot whose ticks the caller makes: the cover behind its rings of bytes, the simulated robot, and faults on purpose.
//! No thread, no clock: time is a count of ticks, and the same seed gives the same bits.
//!
//! - [`LockStep`] runs the loop of `moca-control` on the simulated robot, as fast as the computer allows.
//! - [`touch_board`] makes readings of a board's bytes, live too; [`board_events`] are the rings that bring them.
//! - [`inject`] names every fault that can be caused, and spoils bytes and states.
//!
//! ```
//! # #[cfg(feature = "sim")]
//! # fn main() -> anyhow::Result<()> {
//! use moca_control::config::Config;
//! use moca_lockstep::simulated_robot::free_scene;
//! use moca_lockstep::virtual_boards::board_config;
//! use moca_lockstep::LockStep;
//!
//! let config = Config::default();
//! let mut world = LockStep::with_board(&config, &free_scene(&config), board_config(&config), None)?;
//! let first_ns = world.tick(None).sample.time_ns;
//! assert_eq!(world.tick(None).sample.time_ns, first_ns + config.period_ns());
//! # Ok(())
//! # }
//! # #[cfg(not(feature = "sim"))]
//! # fn main() {}
//! ```

pub mod board_events;
#[cfg(feature = "sim")]
pub mod firmware_board;
#[cfg(feature = "sim")]
pub mod ideal_cover;
pub mod inject;
#[cfg(feature = "sim")]
mod lockstep;
#[cfg(feature = "sim")]
mod scripted_press;
#[cfg(feature = "sim")]
pub mod simulated_robot;
pub mod touch_board;
#[cfg(feature = "sim")]
pub mod virtual_boards;

#[cfg(feature = "sim")]
pub use lockstep::{Feed, LockStep, MemoryBoard, MemoryBoards, NoCover, PipedFirmware, TrueForces};
