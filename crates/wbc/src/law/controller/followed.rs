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

/// Returns the part of the base velocity `wanted` (world x, y, yaw) that the arm can follow after `before`; `None` for all of it.
///
/// # Errors
/// [`ControlError::NotPositiveDefinite`] if Λ⁻¹ is not even semi-definite (NaN).
#[inline]
pub(super) fn followed<const N: usize, T: Scalar>(
    tick: &ArmTick<'_, N, T>,
    arm: &ArmDynamics<'_, N, T>,
    (limits, posture_rad): (JointLimits<'_, N, T>, &[T; N]),
    (wanted, before): (&[T; 3], &[T; 3]),
) -> Result<Option<[T; 3]>, ControlError> {
    let JointLimits { speeds, repulsion } = limits;
    let robot = tick.robot;
    let way = |i: usize, direction: T| {
        let q = robot.q_rad[i];
        let off = of::<T>(FURTHEST_RAD) - (q - posture_rad[i]) * direction;
        let both = repulsion.way(i, q, direction) + repulsion.way(i, q, -direction);
        off.min(repulsion.way(i, q, direction) - both * of(0.5 * STANDS_BEFORE))
    };
    let far = |i: usize| way(i, T::one()).min(way(i, -T::one())) > of(FAR_RAD);
    let mobility = arm.mobility_left();
    let bends = mobility > of(STRETCHES);
    if bends && (0..N).all(far) && speeds.share(&robot.q_rad, &robot.dq_rad_s) < of(SLOW_SHARE) {
        return Ok(None);
    }
    let product = |[ax, ay, a]: &[T; 3], [bx, by, b]: &[T; 3]| {
        *ax * *bx + *ay * *by + of::<T>(LEVER_M * LEVER_M) * *a * *b
    };
    let speed = product(wanted, wanted).sqrt();
    if speed <= T::default_epsilon() {
        return Ok(None);
    }
    let rates = arm
        .response(&arm.bearable_task_inertia()?.solve(&tick.kinematics.twist_from_base(wanted)))
        .map(|rate| -rate);
    let following = (mobility / of(STRETCHES)).max(of(STRETCHED_SHARE)).min(of::<T>(FOLLOWING_SHARE));
    let mut share = (0..N).fold(of::<T>(f64::INFINITY), |share, i| {
        let (q, direction) = (robot.q_rad[i], rates[i].signum());
        let most = (following * speeds.largest(i, q, direction))
            .min(of::<T>(WAY_PER_S) * way(i, direction))
            .max(T::zero());
        share.min(most / rates[i].abs().max(T::default_epsilon()))
    });
    if !bends {
        share = share.min(stretching(tick, &rates, mobility)?);
    }
    if share >= T::one() {
        return Ok(None);
    }
    let (allowed, last) = (share * speed, (product(wanted, before) / speed).max(T::zero()));
    let smooth = last + (allowed - last) * (tick.dt_s / of(SMOOTH_S)).min(T::one());
    let kept = (smooth / speed).min(T::one());
    Ok(Some(wanted.map(|v| v * kept)))
}

/// Largest share of the joint rates `rates` rad/s that the arm may go at before it is stretched, of which `mobility` is left.
fn stretching<const N: usize, T: Scalar>(
    tick: &ArmTick<'_, N, T>,
    rates: &[T; N],
    mobility: T,
) -> Result<T, ControlError> {
    let fastest = rates.iter().fold(T::default_epsilon(), |most, rate| most.max(rate.abs()));
    let ahead_s = of::<T>(AHEAD_RAD) / fastest;
    let ahead_rad = core::array::from_fn(|i| tick.robot.q_rad[i] + rates[i] * ahead_s);
    let ahead = tick.model.dynamics(tick.robot.base_pose_world[2], &ahead_rad, &[T::zero(); N]);
    let lost_per_s = (mobility - ArmDynamics::new(&ahead)?.mobility_left()) / ahead_s;
    let way = (mobility - of(STRETCHED)).max(T::zero());
    Ok(if lost_per_s > T::zero() { of::<T>(WAY_PER_S) * way / lost_per_s } else { of(f64::INFINITY) })
}
