//! Memory of an arm's controller.

use super::law::ControlLaw;
use super::lead::Lead;
use crate::gains::ArmGains;
use crate::momentum_observer::MomentumObserver;
use crate::reference::{HeldBack, Reference};
use crate::scalar::Scalar;
use moca_msgs::RobotState;

/// Memory of an [`super::ArmController`] between steps.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(
    feature = "serde",
    derive(serde::Serialize, serde::Deserialize),
    serde(bound = "T: crate::Scalar")
)]
pub struct ArmState<const N: usize, T = f64> {
    pub(super) law: ControlLaw,
    pub(super) reference: Reference<T>,
    /// Base motion that was refused in the last step, for a tool that the base carries along.
    pub(super) held_back: Option<HeldBack<T>>,
    /// Null-space posture on its way to the configured one, rad; while a posture is held, that one.
    #[cfg_attr(feature = "serde", serde(with = "serde_big_array::BigArray"))]
    pub(super) posture_rad: [T; N],
    pub(super) gains: ArmGains<N, T>,
    #[cfg_attr(feature = "serde", serde(with = "serde_big_array::BigArray"))]
    pub(super) torque_nm: [T; N],
    /// Rest of the torque step that a change of law would have been, N·m.
    #[cfg_attr(feature = "serde", serde(with = "serde_big_array::BigArray"))]
    pub(super) carried_nm: [T; N],
    /// Law or corrections have changed and `carried_nm` is not known yet.
    pub(super) entering: bool,
    pub(super) observer: MomentumObserver<N, T>,
    /// External lead of the reference; `None` costs a step nothing.
    pub(super) lead: Option<Lead<N, T>>,
}

impl<const N: usize, T: Scalar> ArmState<N, T> {
    /// Returns a copy that costs nothing for an absent lead, which is half of the state.
    #[inline]
    pub(super) fn kept(&self) -> Self {
        Self { lead: self.lead.as_ref().copied(), ..*self }
    }

    /// Holds the measured posture from the next step on, with nothing carried over of a motion that must not go on: its torques would fade
    /// for [`super::CARRY_FADE_S`], and drive the joints meanwhile.
    pub(super) fn hold_at_once(&mut self, robot: &RobotState<N, T>) {
        (self.law, self.entering, self.held_back, self.lead) = (ControlLaw::Hold, false, None, None);
        (self.posture_rad, self.carried_nm) = (robot.q_rad, [T::zero(); N]);
    }
}
