//! Self-collision: an arm kept from itself, from the base under it and from the floor.
//!
//! Links and tool are capsules, the base with its cover is a box, the floor a plane. [`SelfCollision::near`] gives the distance of
//! each pair that is near, and its gradient along the joints. [`Near`] makes of them what the laws add: a spring with a damper and a
//! brake on the joints, a push in the null space, and a bound on the speed of a reference. docs/math.md proves what they keep.
//!
//! ```
//! use moca_wbc::robot::{MOCA_MOUNT, PANDA, PANDA_CAPSULES, SUMMIT_XL};
//! use moca_wbc::self_collision::{SelfCollision, Solids};
//! use moca_wbc::{ArmModel, Payload};
//!
//! let solids = Solids { capsules: &PANDA_CAPSULES, tool: None, base_size_m: Some(SUMMIT_XL.size_m) };
//! let guard = SelfCollision::<7, f64>::new(&PANDA, &MOCA_MOUNT, &solids, 0.02)?;
//! let model: ArmModel<7, f64> = ArmModel::new(&PANDA, &MOCA_MOUNT, &Payload::NONE)?;
//! let distance = |q: &[f64; 7]| guard.nearest(&model.kinematics(0.0, q)).map(|nearest| nearest.distance);
//! assert!(distance(&PANDA.home_rad).is_none_or(|m| m > 0.05), "at home there is room");
//! let folded = [0.0, -1.7, 0.0, -3.0, 0.0, 0.1, 0.0];
//! assert!(distance(&folded) < Some(0.02), "here the hand meets the arm");
//! # Ok::<(), moca_wbc::ParameterError>(())
//! ```

mod geometry;
mod predicted;

use crate::chain::{Placement, turn_before};
use crate::joint_stiffness;
use crate::linalg::{Cholesky, dot};
use crate::model::{ArmModel, Kinematics};
use crate::scalar::{Scalar, of};
use geometry::{Connection, Segment};
use moca_msgs::robot::LinkCapsule;
use moca_msgs::{ArmTable, Mount, ParameterError, Payload, RobotPart};
use nalgebra::{Matrix3, SMatrix, Vector3};

/// Most capsules of an arm and its tool.
pub const MAX_CAPSULES: usize = 24;
/// Most pairs of solids.
const MAX_PAIRS: usize = MAX_CAPSULES * (MAX_CAPSULES + 3) / 2;
/// Most pairs that are near at once; of more the nearest count.
const MAX_NEAR: usize = 12;
/// Distance beyond the smallest allowed one at which a pair begins to count, m.
const RANGE_M: f64 = 0.15;
/// Distance beyond the smallest allowed one at which the null space begins to give way, m.
const AVOID_M: f64 = 0.03;
/// Largest allowed distances, m.
pub const DISTANCES_M: [f64; 2] = [0.005, 0.1];
/// γ: what is left of a distance may be used up so fast, 1/s.
pub const APPROACH_PER_S: f64 = 5.0;
/// Share of it at which a reference is led.
const LED_SHARE: f64 = 0.5;
/// κ: an approach that is too fast is braked so fast, 1/s; no more than this share of the loop's rate.
const BRAKE_PER_S: f64 = 150.0;
const BRAKE_SHARE: f64 = 0.3;
/// Stiffness of the spring below the smallest allowed distance, N/m.
pub const STIFFNESS_N_M: f64 = 10_000.0;
/// Stiffness of the push in the null space, N/m.
const AVOID_STIFFNESS_N_M: f64 = 1000.0;
/// Speed of approach that is left of a reference at the smallest allowed distance, m/s.
const STANDSTILL_M_S: f64 = 1e-6;
/// Rounds in which the brakes of all pairs are found.
const ROUNDS: usize = 12;
/// Postures that are drawn to find the pairs that the joints themselves keep apart.
const DRAWS: usize = 256;

/// Solids of a robot.
#[derive(Clone, Copy, Debug)]
pub struct Solids<'a> {
    /// Capsules of the arm.
    pub capsules: &'a [LinkCapsule],
    /// Capsule of the tool: both ends in the flange's axes and the radius, m; `None` without one.
    pub tool: Option<([[f64; 3]; 2], f64)>,
    /// Length, width and height of the base with its cover, m; `None` for an arm on a stand.
    pub base_size_m: Option<[f64; 3]>,
}

/// Capsule in the axes of its link in the model's normal form; of link 0 in the axes of B, relative to A.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Capsule<T> {
    /// Link that carries it.
    body: usize,
    ends: Segment<T>,
    radius: T,
    /// Half of its length, radius included.
    half: T,
    part: RobotPart,
}

/// The second solid of a pair.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Other {
    Capsule(u8),
    Base,
    Floor,
}

/// Solids of one robot and the pairs of them that can meet.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SelfCollision<const N: usize, T> {
    least: T,
    capsules: [Capsule<T>; MAX_CAPSULES],
    capsule_count: usize,
    /// Half lengths of the base's box.
    half_base: Vector3<T>,
    pairs: [(u8, Other); MAX_PAIRS],
    pair_count: usize,
    q_min: [T; N],
    q_max: [T; N],
}

/// Distance of two parts.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Separation<const N: usize, T> {
    /// The two parts.
    pub parts: [RobotPart; 2],
    /// Their distance, m; less than 0 where they overlap.
    pub distance: T,
    /// Its change with each joint, m/rad.
    pub gradient: [T; N],
}

impl<const N: usize, T: Scalar> SelfCollision<N, T> {
    /// Guard of `arm` on `mount` that keeps the parts `least_m` apart. Links that a joint connects are left out, and pairs that are
    /// nearer than that in more than half of all postures: the joints keep them apart, and their capsules are too coarse.
    ///
    /// # Errors
    /// A number of the solids out of range: a link that the arm does not have, a radius, more than [`MAX_CAPSULES`] capsules, a
    /// distance outside [`DISTANCES_M`].
    pub fn new(
        arm: &ArmTable<N>,
        mount: &Mount,
        solids: &Solids<'_>,
        least_m: f64,
    ) -> Result<Self, ParameterError> {
        check(N, solids, least_m)?;
        let mut guard = Self::empty(arm, least_m);
        if let Some([length, width, height]) = solids.base_size_m {
            guard.half_base = Vector3::new(length, width, height).map(|v| of(0.5 * v));
        }
        let mount_axes =
            Placement::of(&[0.0, 0.0, 0.0, mount.rpy_rad[0], mount.rpy_rad[1], mount.rpy_rad[2]]).rotation;
        for capsule in solids.capsules {
            // the model's links are turned about their joints
            let axes = match capsule.link {
                0 => mount_axes,
                link => arm
                    .joint_origin
                    .get(link)
                    .map_or_else(Matrix3::identity, |next| turn_before(next).transpose()),
            };
            let ends = capsule.ends_m.map(|end| axes * Vector3::from(end));
            let part = RobotPart::Link(u8::try_from(capsule.link).unwrap_or(u8::MAX));
            guard.add(capsule.link, &ends, capsule.radius_m, part);
        }
        if let Some((ends, radius_m)) = solids.tool {
            let flange = Placement::of(&arm.flange_origin);
            let ends = ends.map(|end| flange.origin + flange.rotation * Vector3::from(end));
            guard.add(N, &ends, radius_m, RobotPart::Tool);
        }
        guard.pair_up(solids.base_size_m.is_some());
        let model = ArmModel::<N, T>::new(arm, mount, &Payload::NONE)?;
        guard.leave_out_overlaps(&model);
        Ok(guard)
    }

    fn empty(arm: &ArmTable<N>, least_m: f64) -> Self {
        let zero = T::zero();
        let none =
            Capsule { body: 0, ends: [Vector3::zeros(); 2], radius: zero, half: zero, part: RobotPart::Tool };
        Self {
            least: of(least_m),
            capsules: [none; MAX_CAPSULES],
            capsule_count: 0,
            half_base: Vector3::zeros(),
            pairs: [(0, Other::Floor); MAX_PAIRS],
            pair_count: 0,
            q_min: arm.q_min_rad.map(of),
            q_max: arm.q_max_rad.map(of),
        }
    }

    fn add(&mut self, body: usize, ends: &Segment<f64>, radius_m: f64, part: RobotPart) {
        let half = of(0.5 * (ends[1] - ends[0]).norm() + radius_m);
        if let Some(place) = self.capsules.get_mut(self.capsule_count) {
            *place = Capsule { body, ends: ends.map(|end| end.map(of)), radius: of(radius_m), half, part };
            self.capsule_count += 1;
        }
    }

    /// Pairs of all solids that no joint connects.
    fn pair_up(&mut self, has_base: bool) {
        let capsules = self.capsules;
        for (i, capsule) in (0..).zip(&capsules[..self.capsule_count]) {
            for (k, other) in (0..i).zip(&capsules) {
                if capsule.body.abs_diff(other.body) > 1 {
                    let (first, second) = if capsule.body > other.body { (i, k) } else { (k, i) };
                    self.pair(first, Other::Capsule(second));
                }
            }
            if capsule.body > 1 {
                self.pair(i, Other::Floor);
                if has_base {
                    self.pair(i, Other::Base);
                }
            }
        }
    }

    fn pair(&mut self, first: u8, second: Other) {
        if let Some(place) = self.pairs.get_mut(self.pair_count) {
            *place = (first, second);
            self.pair_count += 1;
        }
    }

    /// Leaves out pairs of links that are too near in more than half of all postures.
    fn leave_out_overlaps(&mut self, model: &ArmModel<N, T>) {
        // the fractional parts of multiples of these roots fill the space of the joints evenly
        const ROOTS: [f64; 8] = [
            core::f64::consts::SQRT_2,
            1.732_050_81,
            2.236_067_98,
            2.645_751_31,
            3.316_624_79,
            3.605_551_28,
            4.123_105_63,
            4.358_898_94,
        ];
        let mut near = [0_usize; MAX_PAIRS];
        for draw in 0..DRAWS {
            #[expect(clippy::cast_precision_loss, reason = "a small count")]
            let number = draw as f64;
            let q = core::array::from_fn(|i| {
                let multiple = number * ROOTS[i % ROOTS.len()];
                let share = of::<T>(multiple - nalgebra::ComplexField::floor(multiple));
                self.q_min[i] + (self.q_max[i] - self.q_min[i]) * share
            });
            let kinematics = model.kinematics(T::zero(), &q);
            let placed = self.placed(&kinematics);
            for (count, pair) in near.iter_mut().zip(&self.pairs[..self.pair_count]) {
                *count += usize::from(self.distance(&placed, *pair).0 < self.least);
            }
        }
        let (pairs, count) = (self.pairs, self.pair_count);
        self.pair_count = 0;
        for (near, (first, second)) in near.into_iter().zip(&pairs[..count]) {
            let both_move = !matches!(second, Other::Base | Other::Floor)
                && self.capsules[usize::from(*first)].part != RobotPart::Tool;
            if !both_move || near <= DRAWS / 2 {
                self.pair(*first, *second);
            }
        }
    }

    /// Number of pairs of solids that are compared.
    pub fn pairs(&self) -> usize {
        self.pair_count
    }

    /// Pairs of links that are compared, by their numbers; 0 is what stands on the base.
    pub fn compares(&self, link: usize, other: usize) -> bool {
        self.pairs[..self.pair_count].iter().any(|&(first, second)| {
            let Other::Capsule(second) = second else { return false };
            let bodies = [first, second].map(|capsule| self.capsules[usize::from(capsule)].body);
            bodies == [link, other] || bodies == [other, link]
        })
    }

    /// Smallest allowed distance, m.
    pub fn least(&self) -> T {
        self.least
    }

    /// Places every capsule: world axes, relative to A.
    #[inline]
    fn placed<'a>(&self, kinematics: &'a Kinematics<N, T>) -> Placed<'a, N, T> {
        let mut ends = [[Vector3::zeros(); 2]; MAX_CAPSULES];
        for (ends, capsule) in ends.iter_mut().zip(&self.capsules[..self.capsule_count]) {
            let (axes, origin) = kinematics.link(capsule.body);
            *ends = capsule.ends.map(|end| origin + axes * end);
        }
        Placed { kinematics, ends }
    }

    /// Returns true for a pair that a glance shows to be further apart than `range`.
    #[inline]
    fn is_far(&self, placed: &Placed<'_, N, T>, (first, second): (u8, Other), range: T) -> bool {
        let first = usize::from(first);
        let bound = self.capsules[first].half + range;
        match second {
            Other::Capsule(second) => {
                let second = usize::from(second);
                let bound = bound + self.capsules[second].half;
                let ([a, b], [c, d]) = (&placed.ends[first], &placed.ends[second]);
                // twice the distance of the middles
                (a + b - c - d).norm_squared() > of::<T>(4.0) * bound * bound
            }
            Other::Base => {
                let [a, b] = placed.ends[first].map(|end| placed.in_base(&end));
                let middle: Vector3<T> = (a + b) * of::<T>(0.5);
                let top = self.half_base.z + self.half_base.z;
                let beyond = (middle.x.abs() - self.half_base.x).max(middle.y.abs() - self.half_base.y);
                beyond.max(middle.z - top) > bound
            }
            Other::Floor => {
                let [a, b] = &placed.ends[first];
                of::<T>(0.5) * (a.z + b.z) + placed.kinematics.arm_from_base.z > bound
            }
        }
    }

    /// Distance of a pair, and the connection of its axes in world axes, relative to A.
    #[inline]
    fn distance(&self, placed: &Placed<'_, N, T>, (first, second): (u8, Other)) -> (T, Connection<T>) {
        let first = usize::from(first);
        let (segment, radius) = (&placed.ends[first], self.capsules[first].radius);
        match second {
            Other::Capsule(second) => {
                let second = usize::from(second);
                let connection = geometry::segments(segment, &placed.ends[second]);
                (connection.distance - radius - self.capsules[second].radius, connection)
            }
            Other::Base => {
                let middle = Vector3::new(T::zero(), T::zero(), self.half_base.z);
                let seen = segment.map(|end| placed.in_base(&end) - middle);
                let connection = geometry::segment_and_box(&seen, &self.half_base);
                let heading = &placed.kinematics.heading;
                let world = |v: Vector3<T>| Vector3::from(heading.to_world(v.into()));
                let point = world(connection.point + middle) - placed.kinematics.arm_from_base;
                let connection = Connection { normal: world(connection.normal), point, ..connection };
                (connection.distance - radius, connection)
            }
            Other::Floor => {
                let [a, b] = segment;
                let point = if a.z < b.z { *a } else { *b };
                let distance = point.z + placed.kinematics.arm_from_base.z;
                (distance - radius, Connection { distance, normal: Vector3::z(), point })
            }
        }
    }

    /// Change of a pair's distance with each joint, m/rad. A joint that moves both solids changes nothing.
    #[inline]
    fn gradient(
        &self,
        kinematics: &Kinematics<N, T>,
        (first, second): (u8, Other),
        connection: &Connection<T>,
    ) -> [T; N] {
        let body = self.capsules[usize::from(first)].body;
        let still = match second {
            Other::Capsule(second) => self.capsules[usize::from(second)].body,
            Other::Base | Other::Floor => 0,
        };
        let mut gradient = [T::zero(); N];
        for joint in still..body.min(N) {
            let (axis, origin) = kinematics.joint(joint);
            gradient[joint] = axis.dot(&(connection.point - origin).cross(&connection.normal));
        }
        gradient
    }

    /// Hands every pair that is nearer than `range` to `take`.
    #[inline]
    fn each_within(
        &self,
        kinematics: &Kinematics<N, T>,
        range: T,
        mut take: impl FnMut((u8, Other), T, &Connection<T>),
    ) {
        let placed = self.placed(kinematics);
        for &pair in &self.pairs[..self.pair_count] {
            if self.is_far(&placed, pair, range) {
                continue;
            }
            let (distance, connection) = self.distance(&placed, pair);
            if distance < range {
                take(pair, distance, &connection);
            }
        }
    }

    fn parts(&self, (first, second): (u8, Other)) -> [RobotPart; 2] {
        let part = |capsule: u8| self.capsules[usize::from(capsule)].part;
        let second = match second {
            Other::Capsule(second) => part(second),
            Other::Base => RobotPart::Base,
            Other::Floor => RobotPart::Floor,
        };
        [part(first), second]
    }

    /// Returns the two parts that are nearest to each other; `None` where all are further apart than the smallest allowed distance
    /// and 0.15 m. The joint angles must be finite.
    pub fn nearest(&self, kinematics: &Kinematics<N, T>) -> Option<Separation<N, T>> {
        let mut nearest: Option<Separation<N, T>> = None;
        self.each_within(kinematics, self.least + of(RANGE_M), |pair, distance, connection| {
            if nearest.as_ref().is_none_or(|nearest| distance < nearest.distance) {
                let gradient = self.gradient(kinematics, pair, connection);
                nearest = Some(Separation { parts: self.parts(pair), distance, gradient });
            }
        });
        nearest
    }

    /// The pairs that are near in this tick, of an arm with inertia `mass`; `None` for none.
    pub fn near(&self, kinematics: &Kinematics<N, T>, mass: &SMatrix<T, N, N>) -> Option<Near<N, T>> {
        let none = Row {
            distance: T::zero(),
            gradient: [T::zero(); N],
            response: [T::zero(); N],
            mobility: T::zero(),
        };
        let mut near = Near { rows: [none; MAX_NEAR], count: 0, least: self.least };
        self.each_within(kinematics, self.least + of(RANGE_M), |pair, distance, connection| {
            let gradient = self.gradient(kinematics, pair, connection);
            near.insert(Row { distance, gradient, ..none });
        });
        if near.count == 0 {
            return None;
        }
        let mass = Cholesky::new(mass)?;
        for row in &mut near.rows[..near.count] {
            row.response = mass.solve(&row.gradient);
            row.mobility = dot(&row.gradient, &row.response);
        }
        Some(near)
    }
}

/// Capsules in one configuration.
struct Placed<'a, const N: usize, T> {
    kinematics: &'a Kinematics<N, T>,
    ends: [Segment<T>; MAX_CAPSULES],
}

impl<const N: usize, T: Scalar> Placed<'_, N, T> {
    /// A point in the axes of B, relative to B.
    #[inline]
    fn in_base(&self, point: &Vector3<T>) -> Vector3<T> {
        let from_base = point + self.kinematics.arm_from_base;
        self.kinematics.heading.to_base(from_base.into()).into()
    }
}

/// One pair that is near.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Row<const N: usize, T> {
    distance: T,
    gradient: [T; N],
    /// M⁻¹·gradient.
    response: [T; N],
    /// gradient·M⁻¹·gradient: 1/mass along the distance.
    mobility: T,
}

/// Pairs that are near in one tick.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Near<const N: usize, T> {
    rows: [Row<N, T>; MAX_NEAR],
    count: usize,
    least: T,
}

impl<const N: usize, T: Scalar> Near<N, T> {
    /// Adds a pair; of more than there is room for the furthest is left out.
    fn insert(&mut self, row: Row<N, T>) {
        if let Some(place) = self.rows.get_mut(self.count) {
            *place = row;
            self.count += 1;
            return;
        }
        let mut furthest = 0;
        for i in 1..MAX_NEAR {
            if self.rows[i].distance > self.rows[furthest].distance {
                furthest = i;
            }
        }
        if row.distance < self.rows[furthest].distance {
            self.rows[furthest] = row;
        }
    }

    fn rows(&self) -> &[Row<N, T>] {
        &self.rows[..self.count]
    }

    /// Joint torques that push apart what is nearer than allowed, N·m: a spring of [`STIFFNESS_N_M`] along each distance, with a
    /// damper of 0.7 of critical that fades in over the allowed distance. They store and spend energy and never add any.
    pub fn repulsion(&self, dq: &[T; N], period_s: T) -> [T; N] {
        self.springs(dq, self.least, self.least, of(STIFFNESS_N_M), period_s)
    }

    /// Torques for the null space, N·m: a softer spring that begins 0.03 m earlier.
    pub fn avoidance(&self, dq: &[T; N], period_s: T) -> [T; N] {
        self.springs(dq, self.least + of(AVOID_M), of(AVOID_M), of(AVOID_STIFFNESS_N_M), period_s)
    }

    fn springs(&self, dq: &[T; N], begin: T, band: T, stiffness: T, period_s: T) -> [T; N] {
        let mut torque = [T::zero(); N];
        for row in self.rows() {
            let depth = begin - row.distance;
            // a distance that no joint changes is not pushed
            if depth <= T::zero() || row.mobility <= T::default_epsilon() {
                continue;
            }
            let inertia = T::one() / row.mobility;
            let stiffness = stiffness.min(joint_stiffness::largest_alone(inertia, period_s));
            let damping = joint_stiffness::damping(stiffness, inertia) * (depth / band).min(T::one());
            // it never pulls what moves apart together
            let force = (stiffness * depth - damping * dot(&row.gradient, dq)).max(T::zero());
            add(&mut torque, &row.gradient, force);
        }
        torque
    }

    /// Joint torques to add to `torque` (N·m, without what carries the arm), so that no distance is used up faster than
    /// [`APPROACH_PER_S`] allows. They brake what approaches, and only that.
    ///
    /// With d̈ = ∇d·M⁻¹τ, of each pair d̈ ≥ −κ(ḋ + γ·h) − γ·ḋ is demanded, h = d − least, not below 0. One that still moves
    /// apart may come back as fast. A force along ∇d of each pair meets it, found for all pairs together in a fixed number
    /// of rounds.
    pub fn braking(&self, dq: &[T; N], torque: &[T; N], dt_s: T) -> [T; N] {
        let kappa = of::<T>(BRAKE_PER_S).min(of::<T>(BRAKE_SHARE) / dt_s);
        let mut short = [T::zero(); MAX_NEAR];
        let mut any = false;
        for (short, row) in short.iter_mut().zip(self.rows()) {
            let rate = dot(&row.gradient, dq);
            let acceleration = dot(&row.response, torque);
            if rate + acceleration * dt_s < T::zero() && row.mobility > T::default_epsilon() {
                let left = (row.distance - self.least).max(T::zero());
                let gamma = of::<T>(APPROACH_PER_S);
                let least = -kappa * (rate + gamma * left) - gamma * rate;
                // what still moves apart is not pushed on: the step as a whole gains nothing
                let least = if rate > T::zero() { least.min(of::<T>(-2.0) * rate / dt_s) } else { least };
                *short = least - acceleration;
                any |= *short > T::zero();
            }
        }
        let mut braking = [T::zero(); N];
        if !any {
            return braking;
        }
        let mut force = [T::zero(); MAX_NEAR];
        for _ in 0..ROUNDS {
            for (i, row) in self.rows().iter().enumerate() {
                if short[i] <= T::zero() {
                    continue;
                }
                let left = short[i] - dot(&row.response, &braking);
                let wanted = (force[i] + left / row.mobility).max(T::zero());
                add(&mut braking, &row.gradient, wanted - force[i]);
                force[i] = wanted;
            }
        }
        braking
    }

    /// Returns the factor by which these joint rates, rad/s, use up a distance faster than a reference may; 1 is as fast as
    /// allowed. At the smallest allowed distance a reference comes to rest.
    pub fn too_fast(&self, dq: &[T; N]) -> T {
        let gamma = of::<T>(LED_SHARE * APPROACH_PER_S);
        self.rows().iter().fold(T::zero(), |most, row| {
            let left = (row.distance - self.least).max(T::zero());
            most.max(-dot(&row.gradient, dq) / (gamma * left).max(of(STANDSTILL_M_S)))
        })
    }
}

/// torque += gradient·force.
#[inline]
fn add<const N: usize, T: Scalar>(torque: &mut [T; N], gradient: &[T; N], force: T) {
    for (torque, gradient) in torque.iter_mut().zip(gradient) {
        *torque += *gradient * force;
    }
}

/// The first number of the solids out of range.
fn check(joints: usize, solids: &Solids<'_>, least_m: f64) -> Result<(), ParameterError> {
    let within = |name, unit, value: f64, min: f64, max: f64| {
        if value >= min && value <= max {
            Ok(())
        } else {
            Err(ParameterError { name, value, unit, min, max })
        }
    };
    #[expect(clippy::cast_precision_loss, reason = "small counts")]
    let [count, most, joints] =
        [solids.capsules.len() + usize::from(solids.tool.is_some()), MAX_CAPSULES, joints]
            .map(|count| count as f64);
    within("capsules", "", count, 1.0, most)?;
    within("smallest distance", "m", least_m, DISTANCES_M[0], DISTANCES_M[1])?;
    let capsule = |ends_m: &[[f64; 3]; 2], radius_m| {
        within("capsule radius", "m", radius_m, 1e-3, 1.0)?;
        ends_m.iter().flatten().try_for_each(|value| within("capsule end", "m", *value, -10.0, 10.0))
    };
    for LinkCapsule { link, ends_m, radius_m } in solids.capsules {
        #[expect(clippy::cast_precision_loss, reason = "a small count")]
        within("capsule link", "", *link as f64, 0.0, joints)?;
        capsule(ends_m, *radius_m)?;
    }
    if let Some((ends_m, radius_m)) = &solids.tool {
        capsule(ends_m, *radius_m)?;
    }
    solids.base_size_m.iter().flatten().try_for_each(|length| within("base size", "m", *length, 0.01, 100.0))
}

#[cfg(test)]
mod tests;
