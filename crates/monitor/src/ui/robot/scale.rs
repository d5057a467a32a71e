//! Lengths of arrows and strengths of colours, in both pictures of the robot.

/// Length of the arrow of a force on the cover, m for each N, and its greatest length.
pub(super) const ARROW_M_PER_N: f64 = 0.012;
pub(super) const ARROW_MAX_M: f64 = 0.6;
/// Angle of the arc of the base's moment, rad for each N·m, and its greatest angle.
pub(super) const ARC_RAD_PER_NM: f64 = 0.15;
pub(super) const ARC_MAX_RAD: f64 = 5.0;
/// Length of the arrow of the flange's force, m for each N.
pub(super) const FLANGE_M_PER_N: f64 = 0.01;
/// Length of the double arrow of the flange's moment, m for each N·m.
pub(super) const FLANGE_M_PER_NM: f64 = 0.05;
/// A force that fills the colour scale, N.
pub(super) const FULL_COLOUR_N: f64 = 60.0;
