//! The dashboard: shows a robot, and passes on what its operator asks. It decides nothing.
//!
//! - [`logic`]: what to show and what to ask, as plain data; knows no egui.
//! - [`ui`]: how it looks.
//!
//! This crate refuses to know: control laws, simulation, the Touch Board. The daemon tares, fits and answers.

pub mod logic;
pub mod ui;
