//! Tactile whole-body control of a mobile manipulator.
#![no_std]
#![forbid(unsafe_code)]
#![expect(clippy::needless_range_loop, reason = "matrix algorithms read as in the books: by index")]

pub mod admittance;
pub mod contact_stability;
mod controller;
pub mod coupled;
pub mod cover;
mod error;
pub mod follow_me;
mod gains;
pub mod impedance;
pub mod limits;
pub mod linalg;
pub mod model;
pub mod observer;
pub mod opspace;
pub mod reference;
pub mod rotation;
mod scalar;
mod spatial;
mod state;

pub use controller::{CARRY_FADE_S, Controller, LIGHTEST_DAMPED_BASE, LONGEST_STEP_S};
pub use cover::cover_wrench;
pub use error::ControlError;
pub use gains::{GAIN_FILTER_S, Gains};
pub use limits::LimitsHit;
pub use model::ArmModel;
pub use scalar::Scalar;
pub use state::{ControlInput, ControlLaw, ControlOutput, ControllerState, FlangePose};
