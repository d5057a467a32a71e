//! Joint speeds of an arm whose tool is led, and the resulting limit on the tool's motion.
//!
//! A tool within its bounds can have joints beyond theirs: near a singular posture, before the end of a range where the arm
//! allows less, in the null space of a posture that is far away. Two things keep the joints of a led arm to what they may do.
//!
//! **Who leads plans for it.** Three motions add up: that of the reference's twist, of the spring that makes up for an error,
//! and of the null space towards its posture. Each is planned at a share c of the largest speeds: the twist's joint rates at
//! c, the error at what a critically damped spring reaches from rest, e·ω/e = c, the posture's error at K_0·e/D_0 = c. A
//! critically damped law overshoots a step of the twist by e⁻², so the sum is (3 + e⁻²)·c, and below 1 for c < 0.319:
//! [`LED_SHARE`] is 0.3. With two of the three used up nothing is led on ([`WAITING_SHARE`]). Superposition holds for a
//! posture; where the arm's inertia changes on the way it is a plan and no bound.
//!
//! **A barrier holds them to it** ([`braking_torque`]), whatever moves them. With the arm's own M and bias, the acceleration
//! that a torque gives the joints is known, and of a joint that goes in the direction s that
//!
//! q̈·s ≤ κ·(w(q + q̇/κ) − q̇·s),   w(q) = min(σ·q̇_max(q), α·(way to the end − δ)), not below 0
//!
//! is demanded. w is concave towards the end of a range, so w(q + q̇/κ) ≤ w(q) + w′·q̇/κ, and the gap g = w − q̇·s obeys
//! ġ ≥ −κ·g: a joint that is slower than w stays so, and one at the end of its range stands δ before it. What brakes is found
//! for all joints together: δτ with s·δτ ≤ 0 for each (it only takes energy), zero where the demand is met without, else as
//! large as meets it; M⁻¹ is positive definite, so there is one such δτ and Gauss and Seidel's rounds go there.
//!
//! The demand does not know forces that no model has, nor that torques change by no more than R N·m/s. A joint that
//! accelerates with a needs a·m/R to stop doing so, and gains a²·m/(2R). The margin 1 − σ covers that up to
//! a = √(2R(1 − σ)·q̇_max/m), 30 rad/s² for 1 kg·m² at 2.2 rad/s. κ is far below what a loop of 1 kHz bears that answers a step
//! late (1000/s, of which a third would be prudent), and so large that a plan at c, whose spring accelerates with e·c·ω·q̇_max
//! at most, is not touched: κ·(σ − c) > e·c·ω for ω below 30/s.

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
/// Smallest share of a speed at the end of a range.
const LEAST_ROOM: f64 = 1e-3;
/// Share of their largest speeds that the joints of a led arm are held to, whatever moves them.
pub(super) const HELD_SHARE: f64 = 0.8;
/// κ: what is left of that may be used up so fast, 1/s.
const APPROACH_PER_S: f64 = 50.0;
/// α: a joint may use up its way to the end of its range so fast, 1/s.
const WAY_PER_S: f64 = 10.0;
/// δ: where a joint stands before the end of its range, rad.
const STANDS_BEFORE_RAD: f64 = 0.01;
/// Rounds in which the braking torques of all joints are found.
const ROUNDS: usize = 4;
/// 1/e: a critically damped spring makes up for an error e with e·ω/e at most.
const CRITICAL_SPEED: f64 = 0.367_879_441_171_442_33;

/// Returns the torque to add to `torque`, N·m, so that no joint of a led arm gets faster than its bound.
pub(super) fn braking_torque<const N: usize, T: Scalar>(
    tick: &ArmTick<'_, N, T>,
    arm: &ArmDynamics<'_, N, T>,
    JointLimits { speeds, repulsion }: JointLimits<'_, N, T>,
    torque: &[T; N],
) -> [T; N] {
    let robot = tick.robot;
    let mut braking = [T::zero(); N];
    let pushed_back = (0..N).any(|i| repulsion.pushes(i, robot.q_rad[i]));
    if !pushed_back && speeds.share(&robot.q_rad, &robot.dq_rad_s) < of(LED_SHARE) {
        return braking;
    }
    let bias = &tick.dynamics.bias;
    let mut acceleration = arm.joint_acceleration(&core::array::from_fn(|i| torque[i] - bias[i]));
    let (kappa, held) = (of::<T>(APPROACH_PER_S), of::<T>(HELD_SHARE));
    let directions: [T; N] =
        core::array::from_fn(|i| (robot.dq_rad_s[i] + acceleration[i] * tick.dt_s).signum());
    let most: [T; N] = core::array::from_fn(|i| {
        let (dq, direction) = (robot.dq_rad_s[i], directions[i]);
        let q = robot.q_rad[i] + dq / kappa;
        let way = repulsion.way(i, q, direction) - of(STANDS_BEFORE_RAD);
        let held = (held * speeds.largest(i, q, direction)).min(of::<T>(WAY_PER_S) * way).max(T::zero());
        kappa * (held - dq * direction)
    });
    let response: [[T; N]; N] = core::array::from_fn(|i| {
        arm.joint_acceleration(&core::array::from_fn(|j| if i == j { T::one() } else { T::zero() }))
    });
    // Projected Gauss-Seidel: each joint brakes for what is left of its own excess.
    for _ in 0..ROUNDS {
        for i in 0..N {
            let excess = directions[i] * acceleration[i] - most[i];
            let wanted = braking[i] * directions[i] - excess / response[i][i];
            let change = wanted.min(T::zero()) * directions[i] - braking[i];
            if change != T::zero() {
                braking[i] += change;
                for j in 0..N {
                    acceleration[j] += response[i][j] * change;
                }
            }
        }
    }
    braking
}

/// The joint rates that the law gives an arm whose tool it moves: q̇ = M⁻¹Jᵀ(J·M⁻¹Jᵀ)⁻¹·ν, on a standing base.
pub(super) struct JointPace<'a, const N: usize, T> {
    arm: &'a ArmDynamics<'a, N, T>,
    task_inertia: Cholesky<6, T>,
    /// Rate at which the law reduces an error along and about each axis of W, 1/s.
    catches_up: [T; 6],
    limits: JointLimits<'a, N, T>,
    q_rad: &'a [T; N],
}

/// Limits of the joints where they are.
#[derive(Clone, Copy)]
pub(super) struct JointLimits<'a, const N: usize, T> {
    pub(super) speeds: &'a JointSpeeds<N, T>,
    pub(super) repulsion: &'a JointRepulsion<N, T>,
}

impl<'a, const N: usize, T: Scalar> JointPace<'a, N, T> {
    /// Computes the limits of an arm at joint angles `q_rad` under a law of this stiffness, N/m and N·m/rad.
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

    /// Returns the largest share of its speed limit that a joint has when the tool has this twist, world axes: 1 is all of it. Towards
    /// the end of a range less and less is allowed: where the arm is pushed back it is not led on.
    pub(super) fn share(&self, twist_world: &[T; 6]) -> T {
        let dq_rad_s = self.rates(twist_world);
        let JointLimits { speeds, repulsion } = self.limits;
        (0..N).fold(T::zero(), |most, i| {
            let (q, dq) = (self.q_rad[i], dq_rad_s[i]);
            let room = repulsion.room(i, q, dq).max(of(LEAST_ROOM));
            most.max(dq.abs() / (room * speeds.largest(i, q, dq)))
        })
    }

    /// Returns the joint rates that the law gives a tool with this twist, rad/s.
    pub(super) fn rates(&self, twist_world: &[T; 6]) -> [T; N] {
        self.arm.response(&self.task_inertia.solve(twist_world))
    }

    /// Returns that share where the law makes up for this error \[m; rad\], world axes, from rest.
    pub(super) fn share_to_catch_up(&self, error_world: &[T; 6]) -> T {
        self.share(&core::array::from_fn(|i| error_world[i] * self.catches_up[i]))
    }
}
