//! How fast the joints go with a tool that is led, and what that leaves of its way.
//!
//! A tool within its bounds can have joints beyond theirs: near a singular posture, before the end of a range where the arm
//! allows less, in the null space of a posture that is far away. Who leads it keeps each of the three to [`LED_SHARE`] of
//! what the joints may do, so that together they stay below it: the twist of the reference, what the law's spring would
//! reach if all that holds the tool back gave way, and the pull of the posture. What the three do together all the same is
//! slowed down joint by joint ([`slowing_torque`]), by dampers that only take energy.

use super::tick::ArmTick;
use crate::error::ControlError;
use crate::limits::{JointRepulsion, JointSpeeds};
use crate::linalg::Cholesky;
use crate::opspace::ArmDynamics;
use crate::scalar::{Scalar, of};

/// Share of their largest speeds at which joints are led.
pub(super) const LED_SHARE: f64 = 0.3;
/// Share beyond which they are led no further, whatever moves them.
pub(super) const WAITING_SHARE: f64 = 2.0 * LED_SHARE;
/// What is left of a speed at the end of a range.
const LEAST_ROOM: f64 = 1e-3;
/// Share from which a damper slows a joint that is led.
const SLOWING_SHARE: f64 = 0.4;
/// How fast it does, 1/s: a third of what an inertia bears in a loop of 1 kHz that answers a step late.
const SLOWING_PER_S: f64 = 300.0;
/// 1/e: a critically damped spring makes up for an error e with e·ω/e at most.
const CRITICAL_SPEED: f64 = 0.367_879_441_171_442_33;

/// Torques that slow down the joints of a led arm that are faster than [`SLOWING_SHARE`] of what they may be, N·m.
pub(super) fn slowing_torque<const N: usize, T: Scalar>(
    tick: &ArmTick<'_, N, T>,
    speeds: &JointSpeeds<N, T>,
) -> [T; N] {
    let robot = tick.robot;
    core::array::from_fn(|i| {
        let dq = robot.dq_rad_s[i];
        let free = of::<T>(SLOWING_SHARE) * speeds.largest(i, robot.q_rad[i], dq);
        let beyond = (dq.abs() - free).max(T::zero()).copysign(dq);
        -of::<T>(SLOWING_PER_S) * tick.dynamics.mass[(i, i)] * beyond
    })
}

/// The joint rates that the law gives an arm whose tool it moves: q̇ = M⁻¹Jᵀ(J·M⁻¹Jᵀ)⁻¹·ν, on a standing base.
pub(super) struct JointPace<'a, const N: usize, T> {
    arm: &'a ArmDynamics<'a, N, T>,
    task_inertia: Cholesky<6, T>,
    /// How fast the law makes up for an error along and about each axis of W, 1/s.
    catches_up: [T; 6],
    limits: JointLimits<'a, N, T>,
    q_rad: &'a [T; N],
}

/// What joints may do where they are.
#[derive(Clone, Copy)]
pub(super) struct JointLimits<'a, const N: usize, T> {
    pub(super) speeds: &'a JointSpeeds<N, T>,
    pub(super) repulsion: &'a JointRepulsion<N, T>,
}

impl<'a, const N: usize, T: Scalar> JointPace<'a, N, T> {
    /// Of an arm at joint angles `q_rad` under a law of this stiffness, N/m and N·m/rad.
    ///
    /// # Errors
    /// [`ControlError::NotPositiveDefinite`] if Λ⁻¹ is not even semi-definite (NaN).
    pub(super) fn at(
        arm: &'a ArmDynamics<'a, N, T>,
        q_rad: &'a [T; N],
        stiffness: &[T; 6],
        limits: JointLimits<'a, N, T>,
    ) -> Result<Self, ControlError> {
        let mobility = arm.inverse_task_inertia();
        let catches_up = core::array::from_fn(|i| {
            of::<T>(CRITICAL_SPEED) * (stiffness[i] * mobility[(i, i)]).max(T::zero()).sqrt()
        });
        Ok(Self { arm, task_inertia: arm.task_inertia()?, catches_up, limits, q_rad })
    }

    /// How much of its largest speed the fastest joint has when the tool has this twist, world axes: 1 is all of it. Towards
    /// the end of a range less and less is allowed: where the arm is pushed back nobody leads it on.
    pub(super) fn share(&self, twist_world: &[T; 6]) -> T {
        let dq_rad_s = self.arm.response(&self.task_inertia.solve(twist_world));
        let JointLimits { speeds, repulsion } = self.limits;
        (0..N).fold(T::zero(), |most, i| {
            let (q, dq) = (self.q_rad[i], dq_rad_s[i]);
            let room = repulsion.room(i, q, dq).max(of(LEAST_ROOM));
            most.max(dq.abs() / (room * speeds.largest(i, q, dq)))
        })
    }

    /// The same where the law makes up for this error \[m; rad\], world axes, from rest.
    pub(super) fn share_to_catch_up(&self, error_world: &[T; 6]) -> T {
        self.share(&core::array::from_fn(|i| error_world[i] * self.catches_up[i]))
    }
}
