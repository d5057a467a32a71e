//! What a controller is given, keeps and gives back. Constant configuration is [`crate::Controller`]; everything that
//! changes is here and belongs to the caller.

use crate::error::ControlError;
use crate::gains::Gains;
use crate::limits::LimitsHit;
use crate::observer::MomentumObserver;
use crate::reference::Reference;
use crate::scalar::Scalar;
use moca_msgs::{Corrections, Law, RobotCommand, RobotState};

/// What drives the robot in one step.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum ControlLaw {
    /// Base to a stop within its limits; arm holds the posture it had when the law was entered.
    #[default]
    Hold,
    /// Expanded Cartesian impedance, eqs. (6)–(11).
    Impedance,
    /// Expanded follow-me, eqs. (12)–(16).
    FollowMe,
}

impl From<Law> for ControlLaw {
    fn from(law: Law) -> Self {
        match law {
            Law::Impedance => Self::Impedance,
            Law::FollowMe => Self::FollowMe,
        }
    }
}

/// One step's measurements.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ControlInput<const N: usize, const K: usize, T = f64> {
    /// State of base and arm.
    pub robot: RobotState<N, T>,
    /// Compression force of each taxel, N, T1 first.
    pub taxel_force_n: [T; K],
    /// Wrench on the robot about the flange origin, world axes \[N; N·m\]. `None` takes the robot's own estimate, and
    /// where there is none the momentum observer's.
    pub flange_wrench_world: Option<[T; 6]>,
    /// Time since the last step, s, > 0.
    pub dt_s: T,
}

/// Pose of the controlled frame E in W.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FlangePose<T = f64> {
    /// Position, m.
    pub position_world: [T; 3],
    /// Unit quaternion x, y, z, w.
    pub quaternion_world: [T; 4],
}

/// One step's result.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ControlOutput<const N: usize, T = f64> {
    /// Inside every limit.
    pub command: RobotCommand<N, T>,
    /// Cover wrench, eq. (4): \[N, N, N·m\] in B about its origin.
    pub cover_wrench_base: [T; 3],
    /// The external wrench the law used: on the robot about the flange origin, world axes \[N; N·m\].
    pub flange_wrench_world: [T; 6],
    /// Where the controlled frame E (flange, or tool if one is set) is.
    pub flange: FlangePose<T>,
    /// Where it is wanted.
    pub flange_desired: FlangePose<T>,
    /// Limits that were met.
    pub limits: LimitsHit,
}

/// Everything a controller remembers between steps.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ControllerState<const N: usize, T = f64> {
    pub(crate) law: ControlLaw,
    pub(crate) reference: Reference<T>,
    /// Null-space posture on its way to the configured one, rad; in [`ControlLaw::Hold`] the posture held.
    pub(crate) posture_rad: [T; N],
    pub(crate) gains: Gains<N, T>,
    /// As of the last step: a change is entered like a change of law.
    pub(crate) corrections: Corrections,
    /// v_d of eq. (2) as last commanded: axes of B.
    pub(crate) base_velocity_body: [T; 3],
    pub(crate) torque_nm: [T; N],
    /// What is left of the torque step that a change of law would have been, N·m.
    pub(crate) carried_nm: [T; N],
    /// Law or corrections have changed and `carried_nm` is not known yet.
    pub(crate) entering: bool,
    pub(crate) observer: MomentumObserver<N, T>,
}

impl<const N: usize, T: Scalar> ControllerState<N, T> {
    /// The law of the last step.
    pub fn law(&self) -> ControlLaw {
        self.law
    }

    /// Wants the controlled frame at `position` m with axes `quaternion` (x, y, z, w): in W for
    /// [`ControlLaw::Impedance`], in B for [`ControlLaw::FollowMe`]. The reference travels there at
    /// [`crate::reference::REFERENCE_SPEED_M_S`] and [`crate::reference::REFERENCE_SPEED_RAD_S`]; a change of law
    /// forgets the target.
    ///
    /// # Errors
    /// A value that is not finite, or a quaternion that is not of length 1.
    pub fn set_target_pose(&mut self, position: [T; 3], quaternion: [T; 4]) -> Result<(), ControlError> {
        self.reference.set_pose(position, quaternion)
    }

    /// Moves the target with `twist` \[m/s; rad/s\] until told otherwise, axes as for
    /// [`ControllerState::set_target_pose`]; it waits while the controlled frame is a leash behind. A faster twist than
    /// the reference's speeds is slowed to them.
    ///
    /// # Errors
    /// A value that is not finite.
    pub fn set_target_twist(&mut self, twist: [T; 6]) -> Result<(), ControlError> {
        self.reference.set_twist(twist)
    }

    /// Estimated external joint torques of the momentum observer, N·m, on the robot.
    pub fn external_torque_nm(&self) -> &[T; N] {
        self.observer.external_torque()
    }
}
