//! Base velocities that the arm can follow while its tool stands in the world.
//!
//! A base that gives way for long leaves its tool behind and turns under it, until a joint comes to the end of its range, far
//! from its posture, or has to go too fast for little motion of the base. Before that the base gives way no further. With the
//! wanted velocity s·w (world x, y, yaw), w of length 1, the joints go at s·r to keep the tool in its place,
//! r = −M_A⁻¹J_Aᵀ(J_A·M_A⁻¹J_Aᵀ)⁻¹·J_B·w, and
//!
//! s ≤ s_max = min over the joints i of min(σ·q̇_max,i(q), α·c_i(q))/|r_i|,   c_i not below 0.
//!
//! c_i is the way of joint i, in the direction in which it goes, to where it stands: [`STANDS_BEFORE`] the end of its
//! range, or [`FURTHEST_RAD`] from its posture. Where that bound acts, s follows
//! s_max with the time constant τ: near a singularity s_max changes quickly with the arm's motion in its null space, which a
//! base that starts and stops would excite. A way that is used up so obeys τ·s̈ + ṡ + α·s = 0, whose overshoot at α·τ = ½ is 4 %.
//!
//! An arm that is about to be stretched straight has a way of its own: its mobility μ ([`ArmDynamics::mobility_left`]), 0 in a
//! singular posture. With dμ = ∇μ·r, found by a look ahead, s ≤ α·(μ − μ_min)/(−dμ) for dμ < 0, and σ goes down with μ.
//! Moving away from the singular posture is as free as before.
//!
//! The result is the wanted velocity made shorter, never longer or turned: whoever pushes gives the base less energy than
//! without the bound and gets none back. What the base is not given the arm makes up for like anything that a guard refuses.

use super::joint_pace::JointLimits;
use super::tick::ArmTick;
use crate::error::ControlError;
use crate::opspace::ArmDynamics;
use crate::scalar::{Scalar, of};

/// σ: share of a joint's largest speed that the base's motion may ask for.
const FOLLOWING_SHARE: f64 = 1.0;
/// σ of a stretched arm at least; in between it goes with μ.
const STRETCHED_SHARE: f64 = 0.1;
/// μ below which an arm counts as stretching, and μ at which the base stretches it no further. At home the Panda has 0.157, with
/// joint 4 near its end 0.101, the UR10e 0.071.
const STRETCHES: f64 = 0.1;
const STRETCHED: f64 = 0.04;
/// Motion of the fastest joint by which μ is looked at ahead, rad.
const AHEAD_RAD: f64 = 0.01;
/// α: share of its way that a joint may use up, 1/s.
const WAY_PER_S: f64 = 2.0;
/// τ, s.
const SMOOTH_S: f64 = 0.25;
/// Distance at which a joint stands before the end of its range, of half the range.
const STANDS_BEFORE: f64 = 0.065;
/// Furthest that the base's motion takes a joint from its posture, rad.
const FURTHEST_RAD: f64 = 1.5;
/// With every joint slower than this share of its largest speed and with more way left than this, no bound is near: α allows
/// three times as much.
const SLOW_SHARE: f64 = 0.1;
const FAR_RAD: f64 = 0.35;
/// Lever of a turn beside a translation, m.
const LEVER_M: f64 = 0.7;

/// The arm in one step, as a bound of the base's velocity.
pub(super) struct Follower<'a, const N: usize, T> {
    tick: &'a ArmTick<'a, N, T>,
    arm: &'a ArmDynamics<'a, N, T>,
    limits: JointLimits<'a, N, T>,
    posture_rad: &'a [T; N],
    /// μ.
    mobility: T,
    /// Every joint is slow and has way left, and the arm bends: no bound is near.
    free: bool,
}

impl<'a, const N: usize, T: Scalar> Follower<'a, N, T> {
    #[inline]
    pub(super) fn new(
        tick: &'a ArmTick<'a, N, T>,
        arm: &'a ArmDynamics<'a, N, T>,
        limits: JointLimits<'a, N, T>,
        posture_rad: &'a [T; N],
    ) -> Self {
        let mut follower =
            Self { tick, arm, limits, posture_rad, mobility: arm.mobility_left(), free: false };
        let robot = tick.robot;
        let far = |i: usize| follower.way(i, T::one()).min(follower.way(i, -T::one())) > of(FAR_RAD);
        follower.free = follower.bends()
            && (0..N).all(far)
            && limits.speeds.share(&robot.q_rad, &robot.dq_rad_s) < of(SLOW_SHARE);
        follower
    }

    fn bends(&self) -> bool {
        self.mobility > of(STRETCHES)
    }

    /// c_i in the given direction, rad.
    fn way(&self, i: usize, direction: T) -> T {
        let (q, repulsion) = (self.tick.robot.q_rad[i], self.limits.repulsion);
        let off = of::<T>(FURTHEST_RAD) - (q - self.posture_rad[i]) * direction;
        let both = repulsion.way(i, q, direction) + repulsion.way(i, q, -direction);
        off.min(repulsion.way(i, q, direction) - both * of(0.5 * STANDS_BEFORE))
    }

    /// Returns the part of the base velocity `wanted` (world x, y, yaw) that the arm can follow after `before`; `None` for all
    /// of it.
    ///
    /// # Errors
    /// [`ControlError::NotPositiveDefinite`] if Λ⁻¹ is not even semi-definite (NaN).
    pub(super) fn followed(&self, wanted: &[T; 3], before: &[T; 3]) -> Result<Option<[T; 3]>, ControlError> {
        if self.free {
            return Ok(None);
        }
        let product = |[ax, ay, a]: &[T; 3], [bx, by, b]: &[T; 3]| {
            *ax * *bx + *ay * *by + of::<T>(LEVER_M * LEVER_M) * *a * *b
        };
        let speed = product(wanted, wanted).sqrt();
        if speed <= T::default_epsilon() {
            return Ok(None);
        }
        let tick = self.tick;
        let rates = self
            .arm
            .response(&self.arm.bearable_task_inertia()?.solve(&tick.kinematics.twist_from_base(wanted)))
            .map(|rate| -rate);
        let following =
            (self.mobility / of(STRETCHES)).max(of(STRETCHED_SHARE)).min(of::<T>(FOLLOWING_SHARE));
        let mut share = (0..N).fold(of::<T>(f64::INFINITY), |share, i| {
            let (q, direction) = (tick.robot.q_rad[i], rates[i].signum());
            let most = (following * self.limits.speeds.largest(i, q, direction))
                .min(of::<T>(WAY_PER_S) * self.way(i, direction))
                .max(T::zero());
            share.min(most / rates[i].abs().max(T::default_epsilon()))
        });
        if !self.bends() {
            share = share.min(self.stretching(&rates)?);
        }
        if share >= T::one() {
            return Ok(None);
        }
        let (allowed, last) = (share * speed, (product(wanted, before) / speed).max(T::zero()));
        let smooth = last + (allowed - last) * (tick.dt_s / of(SMOOTH_S)).min(T::one());
        let kept = (smooth / speed).min(T::one());
        Ok(Some(wanted.map(|v| v * kept)))
    }

    /// Largest share of the joint rates `rates` rad/s that the arm may go at before it is stretched.
    fn stretching(&self, rates: &[T; N]) -> Result<T, ControlError> {
        let fastest = rates.iter().fold(T::default_epsilon(), |most, rate| most.max(rate.abs()));
        let ahead_s = of::<T>(AHEAD_RAD) / fastest;
        let robot = self.tick.robot;
        let ahead_rad = core::array::from_fn(|i| robot.q_rad[i] + rates[i] * ahead_s);
        let ahead = self.tick.model.dynamics(robot.base_pose_world[2], &ahead_rad, &[T::zero(); N]);
        let lost_per_s = (self.mobility - ArmDynamics::new(&ahead)?.mobility_left()) / ahead_s;
        let way = (self.mobility - of(STRETCHED)).max(T::zero());
        Ok(if lost_per_s > T::zero() { of::<T>(WAY_PER_S) * way / lost_per_s } else { of(f64::INFINITY) })
    }
}
