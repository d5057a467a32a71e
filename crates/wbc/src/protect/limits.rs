//! Limits on what leaves the controllers: pure functions, each with a property test that nothing gets past it.
//!
//! ```
//! use moca_wbc::limits::TorqueLimits;
//! use moca_wbc::robot::PANDA;
//! use moca_wbc::{Limits, LimitsHit};
//!
//! let limits = TorqueLimits::<7, f64>::from(&Limits::for_arm(&PANDA));
//! let mut hit = LimitsHit::NONE;
//! let torque = limits.limited(&[50.0; 7], &[0.0; 7], 1e-3, &mut hit);
//! assert_eq!(torque[..4], [1.0; 4], "1000 N·m/s for a millisecond");
//! assert_eq!(torque[6], 12.0 / 50.0, "and the others in proportion");
//! assert!(hit.torque_rate && hit.torque, "the wrist has 12 N·m");
//! ```

use crate::guard::{BaseGuard, CoverOutline};
use crate::joint_stiffness;
use crate::scalar::{Scalar, all, between, of, same};
use moca_msgs::{ArmTable, Limits};
use nalgebra::SMatrix;

/// Share of the joint torque limit with which the repulsion pushes at the joint limit itself.
const REPULSION_AT_LIMIT: f64 = 1.0;
/// Distance from a joint limit at which the repulsion begins, rad.
pub const REPULSION_BAND_RAD: f64 = 0.15;

/// Which limits an output met.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct LimitsHit {
    /// A joint torque.
    pub torque: bool,
    /// A joint torque's rate.
    pub torque_rate: bool,
    /// The base's velocity along an axis of B.
    pub base_velocity: bool,
    /// The base's acceleration along an axis of B.
    pub base_acceleration: bool,
    /// A taxel's force: negative, or larger than is believed.
    pub taxel_force: bool,
    /// The speed of the cover, or a touched taxel ([`crate::guard::BaseGuard`]).
    pub guard: bool,
    /// A touched taxel's speed outward: the base does something else than the law wants.
    pub contact: bool,
    /// A joint is in the band before its limit and is pushed back.
    pub joint_range: bool,
    /// The base does not go as the law wants, because the arm could not follow it.
    pub arm_reach: bool,
    /// The pose error is longer than the law acts on ([`crate::reference::ERROR_SATURATION_M`]).
    pub error_saturation: bool,
}

impl LimitsHit {
    /// None was met.
    pub const NONE: Self = Self {
        torque: false,
        torque_rate: false,
        base_velocity: false,
        base_acceleration: false,
        taxel_force: false,
        guard: false,
        contact: false,
        joint_range: false,
        arm_reach: false,
        error_saturation: false,
    };
}

/// Limits of the arm's torques in the scalar of the computation, units as in [`Limits`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TorqueLimits<const N: usize, T> {
    torque: [T; N],
    torque_rate: T,
    period_s: T,
}

impl<const N: usize, T: Scalar> From<&Limits<N>> for TorqueLimits<N, T> {
    fn from(limits: &Limits<N>) -> Self {
        Self {
            torque: all(&limits.torque_nm),
            torque_rate: of(limits.torque_rate_nm_s),
            period_s: of(limits.period_s),
        }
    }
}

impl<const N: usize, T: Scalar> TorqueLimits<N, T> {
    /// `wanted` inside the torque limits and no further from `last` than the rate allows, N·m. A late step may not
    /// change more than a punctual one, because the robot sees one change at one instant.
    ///
    /// A step that is too large for one joint is made smaller for all: what the task asks of the joints together, cut joint
    /// by joint, would be torques that move the arm in its null space.
    pub fn limited(&self, wanted: &[T; N], last: &[T; N], dt_s: T, hit: &mut LimitsHit) -> [T; N] {
        let (change, most) = (self.change(dt_s), &self.torque);
        let last: [T; N] = core::array::from_fn(|i| between(last[i], -most[i], most[i]));
        let inside: [T; N] = core::array::from_fn(|i| clamp(wanted[i], -most[i], most[i], &mut hit.torque));
        let largest =
            inside.iter().zip(last).fold(T::zero(), |most, (&to, from)| most.max((to - from).abs()));
        if largest <= change {
            return inside;
        }
        hit.torque_rate = true;
        let share = change / largest;
        core::array::from_fn(|i| {
            let step = between((inside[i] - last[i]) * share, -change, change);
            between(last[i] + step, -most[i], most[i])
        })
    }

    fn change(&self, dt_s: T) -> T {
        self.torque_rate * dt_s.min(self.period_s)
    }
}

/// Limits of the base and of what its cover is believed, in the scalar of the computation, units as in [`Limits`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct BaseLimits<T> {
    velocity: [T; 3],
    acceleration: [T; 3],
    taxel_force: T,
    period_s: T,
}

impl<const N: usize, T: Scalar> From<&Limits<N>> for BaseLimits<T> {
    fn from(limits: &Limits<N>) -> Self {
        Self {
            velocity: all(&limits.base_velocity),
            acceleration: all(&limits.base_acceleration),
            taxel_force: of(limits.taxel_force_n),
            period_s: of(limits.period_s),
        }
    }
}

impl<T: Scalar> BaseLimits<T> {
    /// Largest speed along each axis of B.
    pub(crate) fn velocity_max(&self) -> &[T; 3] {
        &self.velocity
    }

    /// Largest change of the velocity along axis `i` in a step of `dt_s`; as for torques, a late step earns no more
    /// than a punctual one.
    fn change(&self, i: usize, dt_s: T) -> T {
        self.acceleration[i] * dt_s.min(self.period_s)
    }

    /// `wanted` (axes of B) inside the base's limits and no further from `last` than its acceleration allows.
    pub fn velocity(&self, wanted: &[T; 3], last: &[T; 3], dt_s: T, hit: &mut LimitsHit) -> [T; 3] {
        core::array::from_fn(|i| {
            let most = self.velocity[i];
            let change = self.change(i, dt_s);
            let inside = clamp(wanted[i], -most, most, &mut hit.base_velocity);
            // a limit that was lowered is approached with the allowed acceleration
            clamp(inside, last[i] - change, last[i] + change, &mut hit.base_acceleration)
        })
    }

    /// Least and largest velocity of each axis in one step from `last`.
    fn reachable(&self, last: &[T; 3], dt_s: T) -> ([T; 3], [T; 3]) {
        let bound = |sign: T| {
            core::array::from_fn(|i| {
                let change = self.change(i, dt_s);
                (sign * self.velocity[i]).clamp(last[i] - change, last[i] + change)
            })
        };
        (bound(-T::one()), bound(T::one()))
    }

    /// As [`Self::velocity`], and inside `guard` as soon as the acceleration allows. A guard that has nothing to
    /// object to changes no bit; else the velocity goes straight to what it permits, because only on the straight line
    /// between two permitted velocities is every one permitted.
    pub fn guarded_velocity<const K: usize>(
        &self,
        outline: &CoverOutline<K, T>,
        guard: &BaseGuard<K, T>,
        wanted: &[T; 3],
        last: &[T; 3],
        dt_s: T,
        hit: &mut LimitsHit,
    ) -> [T; 3] {
        let Some(most) = &guard.outward_m_s else {
            return self.guarded_alone(outline, guard, wanted, last, dt_s, hit);
        };
        let mut free_hit = *hit;
        let free = self.guarded_alone(outline, guard, wanted, last, dt_s, &mut free_hit);
        if outline.keeps(most, &free) {
            *hit = free_hit;
            return free;
        }
        (hit.guard, hit.contact) = (true, true);
        let plain = if guard.instead_body.is_none() && outline.permits(guard, wanted) {
            *wanted
        } else {
            outline.guarded(guard, wanted)
        };
        let (low, high) = self.room(guard, last, dt_s);
        outline.nearest(most, &plain, guard, [&low, &high])
    }

    /// Least and largest velocity of each axis in one step from `last` where somebody is given room.
    pub(crate) fn room<const K: usize>(
        &self,
        guard: &BaseGuard<K, T>,
        last: &[T; 3],
        dt_s: T,
    ) -> ([T; 3], [T; 3]) {
        let (mut low, mut high) = self.reachable(last, dt_s);
        if let Some([least, largest]) = guard.room_body.as_ref().or(guard.bounds_body.as_ref()) {
            for i in 0..3 {
                let (slowest, fastest) = (low[i], high[i]);
                low[i] = least[i].clamp(slowest, fastest);
                high[i] = largest[i].clamp(slowest, fastest);
            }
        }
        (low, high)
    }

    /// Applies the guard without the rows of touched taxels.
    fn guarded_alone<const K: usize>(
        &self,
        outline: &CoverOutline<K, T>,
        guard: &BaseGuard<K, T>,
        wanted: &[T; 3],
        last: &[T; 3],
        dt_s: T,
        hit: &mut LimitsHit,
    ) -> [T; 3] {
        let mut unguarded_hit = *hit;
        let unguarded = self.velocity(wanted, last, dt_s, &mut unguarded_hit);
        if guard.instead_body.is_none() && outline.permits(guard, &unguarded) {
            *hit = unguarded_hit;
            return unguarded;
        }
        hit.guard = true;
        let mut target = outline.guarded(guard, wanted);
        for i in 0..3 {
            let most = self.velocity[i];
            if target[i].abs() > most {
                hit.base_velocity = true;
                target = target.map(|v| v * (most / target[i].abs()));
            }
        }
        let mut share = T::one();
        for i in 0..3 {
            let change = self.change(i, dt_s);
            let distance = (target[i] - last[i]).abs();
            if distance > change {
                hit.base_acceleration = true;
                share = share.min(change / distance);
            }
        }
        core::array::from_fn(|i| last[i] + (target[i] - last[i]) * share)
    }

    /// A taxel's force inside 0 to the largest that is believed, N.
    #[inline]
    pub fn taxel_force(&self, force_n: T, hit: &mut LimitsHit) -> T {
        clamp(force_n, T::zero(), self.taxel_force, &mut hit.taxel_force)
    }
}

/// A motion that no law goes on with: stop, and hold.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Exceeded {
    /// A joint (0 is the first) is faster than the arm allows where it is.
    JointSpeed(usize),
    /// The controlled frame is faster than [`Limits::flange_speed_m_s`].
    FlangeSpeed,
    /// It is further from where it is wanted than [`Limits::pose_error_m`] or [`Limits::pose_error_rad`].
    PoseError,
    /// A joint (0 is the first) runs away near a singular posture, in which the law cannot hold the tool.
    Stretched(usize),
}

/// Largest speed that counts as standing at the end of a joint's range, rad/s: noise of the measurement.
pub const JOINT_STANDSTILL_RAD_S: f64 = 0.02;

/// Joint speeds that the arm itself enforces.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct JointSpeeds<const N: usize, T> {
    most: [T; N],
    /// Ends of the range, offset and twice the deceleration of [`moca_msgs::robot::SpeedEnvelope`].
    envelope: Option<[[T; 4]; N]>,
}

impl<const N: usize, T: Scalar> JointSpeeds<N, T> {
    /// Those of `arm`.
    pub fn new(arm: &ArmTable<N>) -> Self {
        Self {
            most: all(&arm.dq_max_rad_s),
            envelope: arm.speed_envelope.map(|envelope| {
                core::array::from_fn(|i| {
                    let (offset, deceleration) = (envelope.offset_rad_s[i], envelope.deceleration_rad_s2[i]);
                    [arm.q_min_rad[i], arm.q_max_rad[i], offset, 2.0 * deceleration].map(of)
                })
            }),
        }
    }

    /// Largest speed of joint `i` at `q` rad in the direction of `dq`, rad/s.
    pub fn largest(&self, i: usize, q: T, dq: T) -> T {
        let Some(envelope) = &self.envelope else { return self.most[i] };
        let [low, high, offset, twice_deceleration] = envelope[i];
        let distance = if dq > T::zero() { high - q } else { q - low };
        let braked = (twice_deceleration * distance.max(T::zero())).sqrt() - offset;
        self.most[i].min(braked.max(of(JOINT_STANDSTILL_RAD_S)))
    }

    /// Returns the largest share of its speed limit that a joint has: 1 is all of it.
    pub fn share(&self, q: &[T; N], dq: &[T; N]) -> T {
        (0..N).fold(T::zero(), |most, i| most.max(dq[i].abs() / self.largest(i, q[i], dq[i])))
    }

    /// The fastest joint for its largest speed, and its share of that.
    pub fn fastest(&self, q: &[T; N], dq: &[T; N]) -> (usize, T) {
        (0..N).fold((0, T::zero()), |(fastest, most), i| {
            let share = dq[i].abs() / self.largest(i, q[i], dq[i]);
            if share > most { (i, share) } else { (fastest, most) }
        })
    }

    /// The first joint that is too fast.
    pub fn exceeded(&self, q: &[T; N], dq: &[T; N]) -> Option<usize> {
        (0..N).find(|&i| dq[i].abs() > self.largest(i, q[i], dq[i]))
    }
}

/// Limits on the motion of the controlled frame, in the scalar of the computation, units as in [`Limits`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FlangeLimits<T> {
    speed: T,
    error_m: T,
    error_rad: T,
}

impl<const N: usize, T: Scalar> From<&Limits<N>> for FlangeLimits<T> {
    fn from(limits: &Limits<N>) -> Self {
        Self {
            speed: of(limits.flange_speed_m_s),
            error_m: of(limits.pose_error_m),
            error_rad: of(limits.pose_error_rad),
        }
    }
}

impl<T: Scalar> FlangeLimits<T> {
    /// Returns the limit that a speed, m/s, or a pose error \[m; rad\] exceeds.
    pub fn exceeded(&self, speed_m_s: T, error: &[T; 6]) -> Option<Exceeded> {
        if speed_m_s > self.speed {
            Some(Exceeded::FlangeSpeed)
        } else if self.share(error) > T::one() {
            Some(Exceeded::PoseError)
        } else {
            None
        }
    }

    /// Pose error \[m; rad\] as a share of its limit: the larger one, of position and orientation.
    pub fn share(&self, error: &[T; 6]) -> T {
        let [x, y, z, rx, ry, rz] = *error;
        let length = |x: T, y: T, z: T| (x * x + y * y + z * z).sqrt();
        (length(x, y, z) / self.error_m).max(length(rx, ry, rz) / self.error_rad)
    }
}

/// Push away from the ends of the joints' ranges: a one-sided spring with a damper, so that it stores and spends energy
/// but never adds any.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct JointRepulsion<const N: usize, T> {
    begin_low: [T; N],
    begin_high: [T; N],
    /// N·m/rad.
    stiffness: [T; N],
    band: [T; N],
}

impl<const N: usize, T: Scalar> JointRepulsion<N, T> {
    /// From the ranges and torque limits of `arm`: it begins [`REPULSION_BAND_RAD`] before a limit and reaches the joint
    /// torque limit there, where inertia and period allow so stiff a spring.
    pub fn new(arm: &ArmTable<N>) -> Self {
        // half the range at most, so that the two bands never overlap
        let band = |i: usize| (0.5 * (arm.q_max_rad[i] - arm.q_min_rad[i])).clamp(0.01, REPULSION_BAND_RAD);
        Self {
            begin_low: core::array::from_fn(|i| of(arm.q_min_rad[i] + band(i))),
            begin_high: core::array::from_fn(|i| of(arm.q_max_rad[i] - band(i))),
            band: core::array::from_fn(|i| of(band(i))),
            stiffness: core::array::from_fn(|i| of(REPULSION_AT_LIMIT * arm.torque_max_nm[i] / band(i))),
        }
    }

    /// The way of joint `i` to the end of its range in the direction of `dq`, rad.
    pub fn way(&self, i: usize, q: T, dq: T) -> T {
        let band = self.band[i];
        if dq > T::zero() { self.begin_high[i] + band - q } else { q - self.begin_low[i] + band }
    }

    /// Width of the band before either end of joint `i` in which it is pushed back, rad.
    pub fn band(&self, i: usize) -> T {
        self.band[i]
    }

    /// Distance of joint `i` at `q` rad to the nearer of its two bands, rad; negative inside one.
    pub fn clearance(&self, i: usize, q: T) -> T {
        (q - self.begin_low[i]).min(self.begin_high[i] - q)
    }

    /// Returns the remaining share of that distance, from 1 two bands before the end to 0 at it.
    pub fn room(&self, i: usize, q: T, dq: T) -> T {
        let band = self.band[i];
        (self.way(i, q, dq) / (band + band)).clamp(T::zero(), T::one())
    }

    /// Returns true if joint `i` is so near to an end of its range that it is pushed back.
    pub fn pushes(&self, i: usize, q: T) -> bool {
        q < self.begin_low[i] || q > self.begin_high[i]
    }

    /// Joint torques of an arm with inertia `mass` under a control of `period_s`, N·m: a spring that is no stiffer than
    /// [`joint_stiffness`] allows, and a damper of 0.7 of critical.
    #[inline]
    pub fn torque(&self, q: &[T; N], dq: &[T; N], mass: &SMatrix<T, N, N>, period_s: T) -> [T; N] {
        let inside: [T; N] =
            core::array::from_fn(|i| q[i] - between(q[i], self.begin_low[i], self.begin_high[i]));
        let none = [T::zero(); N];
        if same(&inside, &none) {
            return none;
        }
        let most = joint_stiffness::largest(mass, period_s);
        core::array::from_fn(|i| {
            let inside = inside[i];
            if inside == T::zero() {
                return T::zero();
            }
            // the damper fades in over the band, or entering it would be a step of torque
            let depth = (inside.abs() / self.band[i]).min(T::one());
            let stiffness = self.stiffness[i].min(most[i]);
            let damping = joint_stiffness::damping(stiffness, mass[(i, i)]) * depth;
            -stiffness * inside - damping * dq[i]
        })
    }
}

fn clamp<T: Scalar>(value: T, min: T, max: T, hit: &mut bool) -> T {
    *hit |= value < min || value > max;
    between(value, min, max)
}

#[cfg(test)]
mod tests {
    use super::*;
    use moca_msgs::robot::{PANDA, PAPER_COVER};

    /// Drives the base while its cover allows T6, in front, a given outward speed, m/s.
    fn driven(
        outward_m_s: Option<f64>,
        instead_body: Option<[f64; 3]>,
        wanted: [f64; 3],
        last: [f64; 3],
    ) -> ([f64; 3], LimitsHit) {
        let limits = Limits {
            base_velocity: [0.3, 0.3, 0.5],
            base_acceleration: [1000.0; 3],
            ..Limits::for_arm(&PANDA)
        };
        let outline: CoverOutline<11, f64> = CoverOutline::new(&PAPER_COVER).unwrap();
        let outward_m_s =
            outward_m_s.map(|most| core::array::from_fn(|i| if i == 5 { most } else { f64::INFINITY }));
        let guard = BaseGuard { outward_m_s, instead_body, ..BaseGuard::NONE };
        let mut hit = LimitsHit::NONE;
        let velocity =
            BaseLimits::from(&limits).guarded_velocity(&outline, &guard, &wanted, &last, 1e-3, &mut hit);
        (velocity, hit)
    }

    fn near(a: [f64; 3], b: [f64; 3]) -> bool {
        a.iter().zip(b).all(|(a, b)| (a - b).abs() < 1e-4)
    }

    #[test]
    fn request_beyond_limit_counts_one_hit() {
        let (velocity, hit) = driven(None, None, [0.3, -0.3, 0.5], [0.0; 3]);
        assert!(near(velocity, [0.3, -0.3, 0.5]) && hit == LimitsHit::NONE, "{velocity:?} {hit:?}");
        for wanted in [[9.0, 0.0, 0.0], [0.0, -9.0, 0.0], [9.0, -9.0, 0.0]] {
            let (velocity, hit) = driven(None, None, wanted, [0.0; 3]);
            assert!(
                near(velocity, wanted.map(|v| 0.3 * v / 9.0)) && hit.base_velocity,
                "{velocity:?} {hit:?}"
            );
        }
    }

    #[test]
    fn a_taxel_s_limit_and_the_base_s_own_hold_together() {
        let (velocity, hit) = driven(Some(0.1), None, [0.6, 0.6, -0.9], [0.0; 3]);
        assert!(near(velocity, [0.1, 0.3, -0.5]) && hit.guard && hit.contact, "{velocity:?} {hit:?}");
        let (velocity, hit) = driven(Some(0.1), None, [0.1, 0.2, 0.0], [0.0; 3]);
        assert!(near(velocity, [0.1, 0.2, 0.0]) && !hit.guard && !hit.contact, "{velocity:?} {hit:?}");
    }

    #[test]
    fn what_the_guard_orders_instead_is_what_a_taxel_s_limit_bounds() {
        let (velocity, _) = driven(Some(0.1), Some([0.25, 0.0, 0.0]), [0.0, 0.2, 0.0], [0.0; 3]);
        assert!(near(velocity, [0.1, 0.0, 0.0]), "{velocity:?}");
    }

    #[test]
    fn guarded_order_keeps_direction_and_speed_limit() {
        let (velocity, hit) = driven(None, Some([0.6, -0.2, 0.0]), [0.0; 3], [0.0; 3]);
        assert!(near(velocity, [0.3, -0.1, 0.0]) && hit.guard && hit.base_velocity, "{velocity:?} {hit:?}");
        // as fast as it may go, and as much faster in one step as it may become: 1 m/s
        let (velocity, hit) = driven(None, Some([0.3, 0.0, 0.0]), [0.0; 3], [-0.7, 0.0, 0.0]);
        assert!(near(velocity, [0.3, 0.0, 0.0]) && hit.guard, "{velocity:?} {hit:?}");
        assert!(!hit.base_velocity && !hit.base_acceleration, "{hit:?}");
    }

    #[test]
    fn a_motion_at_its_limit_goes_on_and_beyond_it_stops() {
        let own = Limits::for_arm(&PANDA);
        let limits = FlangeLimits::<f64>::from(&own);
        // 3, 4 and 12 are the sides of a box whose diagonal is 13
        let error = |metres: f64, radians: f64| {
            let along = |of_all: f64| [3.0, 4.0, 12.0].map(|side| side / 13.0 * of_all);
            let ([x, y, z], [rx, ry, rz]) = (along(metres), along(radians));
            [x, y, z, rx, ry, rz]
        };
        let (metres, radians) = (own.pose_error_m, own.pose_error_rad);
        for (speed_m_s, error, exceeded) in [
            (own.flange_speed_m_s, error(0.999 * metres, 0.999 * radians), None),
            (1.001 * own.flange_speed_m_s, error(0.0, 0.0), Some(Exceeded::FlangeSpeed)),
            (0.0, error(1.001 * metres, 0.0), Some(Exceeded::PoseError)),
            (0.0, error(0.0, 1.001 * radians), Some(Exceeded::PoseError)),
            (0.0, [metres, 0.0, 0.0, 0.0, 0.0, radians], None),
        ] {
            assert_eq!(limits.exceeded(speed_m_s, &error), exceeded, "{speed_m_s} m/s, {error:?}");
        }
        let joints = JointSpeeds::<7, f64>::new(&PANDA);
        let mut dq = [0.0; 7];
        dq[3] = -joints.largest(3, PANDA.home_rad[3], -1.0);
        assert_eq!(joints.exceeded(&PANDA.home_rad, &dq), None);
        (dq[1], dq[3]) = (0.25 * joints.largest(1, PANDA.home_rad[1], 1.0), 0.5 * dq[3]);
        assert!((joints.share(&PANDA.home_rad, &dq) - 0.5).abs() < 1e-12, "of the fastest");
        dq[3] *= 2.0 * 1.001;
        assert_eq!(joints.exceeded(&PANDA.home_rad, &dq), Some(3));
    }

    #[test]
    fn the_room_before_the_end_of_a_range_is_used_up_there() {
        let repulsion = JointRepulsion::<7, f64>::new(&PANDA);
        let (low, high) = (PANDA.q_min_rad[3], PANDA.q_max_rad[3]);
        for (before_end, room) in
            [(1.0, 1.0), (2.0 * REPULSION_BAND_RAD, 1.0), (0.15, 0.5), (0.0, 0.0), (-0.1, 0.0)]
        {
            assert!((repulsion.room(3, high - before_end, 1.0) - room).abs() < 1e-9, "{before_end}");
            assert!((repulsion.room(3, low + before_end, -1.0) - room).abs() < 1e-9, "{before_end}");
        }
        assert!((repulsion.room(3, high, -1.0) - 1.0).abs() < 1e-9, "the way back is free");
        // it pushes back from where it exerts a torque on, and not at its beginning
        let (begin_low, begin_high) = (repulsion.begin_low[3], repulsion.begin_high[3]);
        for (q, pushes) in [(begin_low - 1e-6, true), (begin_high + 1e-6, true), (0.5 * (low + high), false)]
        {
            assert_eq!(repulsion.pushes(3, q), pushes, "{q}");
        }
        assert!(!repulsion.pushes(3, begin_low) && !repulsion.pushes(3, begin_high));
        let (up, down) = (repulsion.way(3, high - 0.2, 1.0), repulsion.way(3, high - 0.2, -1.0));
        assert!((up - 0.2).abs() < 1e-9 && (down - (high - 0.2 - low)).abs() < 1e-9, "{up}, {down}");
    }

    #[test]
    fn rate_limited_torque_keeps_its_direction() {
        let limits = TorqueLimits::<7, f64>::from(&Limits::for_arm(&PANDA));
        let last = [3.0, -2.0, 0.5, 80.0, -1.0, 0.0, 4.0];
        let way = [30.0, -12.0, 0.3, 7.0, 6.0, -2.5, 1.5];
        let wanted: [f64; 7] = core::array::from_fn(|i| last[i] + way[i]);
        let mut hit = LimitsHit::NONE;
        let sent = limits.limited(&wanted, &last, 1e-3, &mut hit);
        assert!(hit.torque_rate && !hit.torque);
        for i in 0..7 {
            assert!((sent[i] - last[i] - way[i] / 30.0).abs() < 1e-14, "{i}: {sent:?}");
        }
        // what is not too fast is what was wanted, to the bit
        let near = last.map(|torque| torque + 0.3);
        let mut hit = LimitsHit::NONE;
        assert_eq!(limits.limited(&near, &last, 1e-3, &mut hit).map(f64::to_bits), near.map(f64::to_bits));
        assert_eq!(hit, LimitsHit::NONE);
        // NaN must reach the check that refuses it
        let mut bad = wanted;
        bad[2] = f64::NAN;
        assert!(limits.limited(&bad, &last, 1e-3, &mut LimitsHit::default())[2].is_nan());
    }

    #[test]
    fn end_of_a_range_is_softer_where_inertia_or_rate_is_low() {
        let repulsion = JointRepulsion::<7, f64>::new(&PANDA);
        let mut q_rad = PANDA.home_rad;
        q_rad[6] = PANDA.q_max_rad[6];
        for (inertia, period_s) in [(1e-4, 1e-3), (0.8, 1e-1)] {
            let mass = inertia * SMatrix::<f64, 7, 7>::identity();
            let pushed_nm = repulsion.torque(&q_rad, &[0.0; 7], &mass, period_s)[6];
            let expected_nm = -joint_stiffness::largest(&mass, period_s)[6] * REPULSION_BAND_RAD;
            assert!((pushed_nm - expected_nm).abs() < 1e-12, "{pushed_nm} {expected_nm}");
            assert!(pushed_nm > -0.7 * PANDA.torque_max_nm[6], "{inertia} kg·m², {period_s} s: {pushed_nm}");
        }
    }

    #[test]
    fn range_end_pushes_with_joint_torque_and_damping() {
        let repulsion = JointRepulsion::<7, f64>::new(&PANDA);
        let pushed = |q: f64, dq: f64| {
            let (mut q_rad, mut dq_rad_s) = (PANDA.home_rad, [0.0; 7]);
            (q_rad[3], dq_rad_s[3]) = (q, dq);
            repulsion.torque(&q_rad, &dq_rad_s, &(0.8 * SMatrix::identity()), 1e-3)[3]
        };
        let (low, high, most_nm) = (PANDA.q_min_rad[3], PANDA.q_max_rad[3], PANDA.torque_max_nm[3]);
        let close = |a: f64, b: f64| (a - b).abs() < 1e-9 * most_nm;
        assert!(close(pushed(high, 0.0), -most_nm) && close(pushed(low, 0.0), most_nm));
        assert!(close(pushed(low + 0.5 * REPULSION_BAND_RAD, 0.0), 0.5 * most_nm), "a spring");
        assert!(close(pushed(high - REPULSION_BAND_RAD, 1.0), 0.0), "where it begins nothing jumps");
        // critical is 2·√(k·m); the damper has grown to half of its own in the middle of the band
        let damper = 0.7 * 2.0 * (most_nm / REPULSION_BAND_RAD * 0.8).sqrt();
        for (into_band, dq) in [(1.0, 0.3), (1.0, -0.3), (0.5, 0.3)] {
            let q = high - (1.0 - into_band) * REPULSION_BAND_RAD;
            let expected = -into_band * (most_nm + damper * dq);
            assert!(close(pushed(q, dq), expected), "{into_band} {dq}: {}", pushed(q, dq));
        }
        let beyond = -most_nm * 1.2 - damper * 0.3;
        assert!(close(pushed(high + 0.2 * REPULSION_BAND_RAD, 0.3), beyond), "and no more than that");
    }
}
