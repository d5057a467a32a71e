//! The simulated robot.

pub mod foam;
pub mod sensor;
