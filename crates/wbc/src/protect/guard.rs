//! Protection of the people around the base: a speed limit for every point of the cover, and touched taxels that must not move
//! outward. Pure; a convex set of velocities that always contains rest.
//!
//! ```
//! use moca_wbc::guard::{BaseGuard, CoverOutline};
//! use moca_wbc::robot::PAPER_COVER;
//!
//! let outline: CoverOutline<11, f64> = CoverOutline::new(&PAPER_COVER)?;
//! let mut guard = BaseGuard::NONE;
//! guard.blocked[5] = true; // a hand on T6: not forward
//! let [x, y, _] = outline.guarded(&guard, &[0.2, 0.1, 0.0]);
//! assert!(x.abs() < 1e-12 && (y - 0.1).abs() < 1e-12, "sideways it may");
//! # Ok::<(), moca_wbc::ParameterError>(())
//! ```

use crate::cover_map::{BODY_M, CoverMap, SAME_SIDE, on_one_side, squared};
use crate::error::{ControlError, finite};
use crate::scalar::{Scalar, of};
use moca_msgs::{ParameterError, TaxelPlacement};
use moca_qp::{Metric, Row, Solution, WorkingSet};

/// Fastest motion outward that still counts as none, m/s and rad/s: rounding, not creep.
pub const STANDSTILL: f64 = 1e-9;

/// Weights of "nearest": x, y, yaw (m²), and the slack that all taxels share.
const NEARNESS: [f64; 4] = [1.0, 1.0, 0.5, 1e4];
/// Largest excess of a taxel that could be kept, m/s: slack is not free.
const SOFTNESS: f64 = 1e-4;
/// Share by which the excess of the worst taxel may grow when the others are looked at: rounding.
const ROUNDING: f64 = 1e-6;
/// Most bodies that are told apart by the sides that they press.
const BODIES: usize = 4;
/// Most touched taxels that are looked at; and as few as it nearly always is.
const MOST: usize = 32;
const FEW: usize = 3;
/// Slowest demand for room, m/s: a late base no longer waits for a walker who is remembered at this speed or less, and a plate that asks
/// for less counts less among those of one body.
pub(crate) const FORGOTTEN_M_S: f64 = 0.003;

/// Bounds on the base in addition to its [`moca_msgs::Limits`]. Velocities in the axes of B.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct BaseGuard<const K: usize, T = f64> {
    /// Largest speed of any point of the cover, m/s.
    pub speed_m_s: Option<T>,
    /// Taxels that must not move outward: neither by translation nor by yaw.
    pub blocked: [bool; K],
    /// Largest speed of each taxel outward, m/s: +∞ for none, below 0 where it has to give way. As
    /// [`crate::contact_barrier`] says it. Where the base cannot keep all of them, it exceeds the worst by the least.
    pub outward_m_s: Option<[T; K]>,
    /// Taxels of one side that have to give way are pressed by one body, which receives the sum of their forces: where the base cannot
    /// keep all of them, it exceeds their mean by the least, and then the worst of them.
    pub one_body: bool,
    /// Least and largest velocity along each axis of B, m/s, m/s, rad/s; standing still is between them. For motions
    /// that no taxel would feel the end of.
    pub bounds_body: Option<[[T; 3]; 2]>,
    /// Bounds for a motion that [`Self::outward_m_s`] demands, as far as it demands it: a detected person gets room where a law on
    /// its own would not go. `None` is no more than `bounds_body`.
    pub room_body: Option<[[T; 3]; 2]>,
    /// Velocity that replaces the law's: m/s, m/s, rad/s.
    pub instead_body: Option<[T; 3]>,
}

impl<const K: usize, T: Scalar> BaseGuard<K, T> {
    /// Everything that the limits allow.
    pub const NONE: Self = Self {
        speed_m_s: None,
        blocked: [false; K],
        outward_m_s: None,
        one_body: false,
        bounds_body: None,
        room_body: None,
        instead_body: None,
    };

    /// Returns the part of it that gives people room: for a base that is to stand.
    pub(crate) fn room(&self) -> Self {
        Self { outward_m_s: self.outward_m_s, one_body: self.one_body, ..Self::NONE }
    }

    /// Returns true if a velocity is within the bounds along the axes.
    fn bounds_permit(&self, velocity: &[T; 3]) -> bool {
        let rounding = of::<T>(STANDSTILL);
        self.bounds_body.is_none_or(|[least, most]| {
            (0..3).all(|i| velocity[i] >= least[i] - rounding && velocity[i] <= most[i] + rounding)
        })
    }

    /// # Errors
    /// A number that is not finite, of a cover of `taxels` taxels, a speed limit below 0, or bounds that forbid standing
    /// still.
    pub(crate) fn check(&self, taxels: usize) -> Result<(), ControlError> {
        finite("guard.instead_body", self.instead_body.as_ref().map_or(&[], |v| &v[..]))?;
        for (index, most) in self.outward_m_s.iter().flatten().take(taxels).enumerate() {
            if !most.is_finite() && *most != of(f64::INFINITY) {
                return Err(ControlError::NotFinite { what: "guard.outward_m_s", index });
            }
        }
        for (what, bounds) in [("guard.bounds_body", &self.bounds_body), ("guard.room_body", &self.room_body)]
        {
            let Some([least, most]) = bounds else { continue };
            for axis in 0..3 {
                let (least, most) = (least[axis], most[axis]);
                if !(least.is_finite() && most.is_finite()) {
                    return finite(what, &[least, most]);
                }
                if least > T::zero() || most < T::zero() {
                    return Err(ControlError::GuardBounds { axis });
                }
            }
        }
        let Some(speed) = self.speed_m_s else { return Ok(()) };
        finite("guard.speed_m_s", &[speed])?;
        if speed >= T::zero() {
            Ok(())
        } else {
            Err(ControlError::GuardSpeed { speed_m_s: nalgebra::try_convert(speed).unwrap_or(f64::NAN) })
        }
    }
}

/// Geometry of the cover: what a [`BaseGuard`] is measured against.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CoverOutline<const K: usize, T> {
    /// Corner of the rectangle round all taxels, x and y, m.
    corner: [T; 2],
    map: CoverMap<K, T>,
    /// Side of each taxel, as seen into it, that leads away from the nearest one round a corner of the cover: 1 left, −1 right, 0 none.
    aside: [i8; K],
    /// Metric of the nearest velocity.
    metric: Metric<4, T>,
}

impl<const K: usize, T: Scalar> CoverOutline<K, T> {
    /// The cover of 0 to `K` taxels, T1 first.
    ///
    /// # Errors
    /// As for [`CoverMap::new`].
    pub fn new(taxels: &[TaxelPlacement]) -> Result<Self, ParameterError> {
        let most = |axis: usize| taxels.iter().fold(0.0_f64, |m, t| m.max(t.position_base_m[axis].abs()));
        let metric = Metric::diagonal(&NEARNESS.map(of)).map_err(|_| ParameterError {
            name: "weights of the nearest motion",
            value: f64::NAN,
            unit: "",
            min: 0.0,
            max: f64::INFINITY,
        })?;
        let map: CoverMap<K, T> = CoverMap::new(taxels)?;
        let aside = core::array::from_fn(|i| from_corner(i, map.columns(), taxels));
        Ok(Self { map, corner: [of(most(0)), of(most(1))], aside, metric })
    }

    /// Returns the map from taxel forces to the wrench on the base.
    pub const fn map(&self) -> &CoverMap<K, T> {
        &self.map
    }

    /// Speed of the fastest point of the cover at a base velocity \[m/s, m/s, rad/s\], m/s: always a corner.
    pub fn fastest(&self, [vx, vy, yaw]: &[T; 3]) -> T {
        let [x, y] = self.corner;
        let [x, y] = [vx.abs() + yaw.abs() * y, vy.abs() + yaw.abs() * x];
        (x * x + y * y).sqrt()
    }

    /// Speed of a taxel (0 is T1) outward, m/s; negative where it moves away from whoever touches it.
    pub fn outward(&self, taxel: usize, [vx, vy, yaw]: &[T; 3]) -> T {
        self.map
            .columns()
            .get(taxel)
            .map_or(T::zero(), |[x, y, lever]| -(*x * *vx + *y * *vy + *lever * *yaw))
    }

    /// Deceleration of a taxel outward, m/s², with all axes of the base at their own.
    pub fn deceleration(&self, taxel: usize, of_axes: &[T; 3]) -> T {
        self.map.columns().get(taxel).map_or(T::zero(), |inward| {
            let [x, y, lever] = [0, 1, 2].map(|j| inward[j].abs() * of_axes[j]);
            x + y + lever
        })
    }

    /// Returns true if no taxel moves outward faster than `most`, m/s.
    pub(crate) fn keeps(&self, most: &[T; K], velocity: &[T; 3]) -> bool {
        most.iter().take(self.map.taxels()).enumerate().all(|(i, most)| self.outward(i, velocity) <= *most)
    }

    /// The velocity nearest to `wanted` between `low` and `high` at which no taxel goes outward faster than `most`, or,
    /// where there is none, at which the worst does by the least, and then the worst of the others: of two plates that a body presses
    /// at their seam, turning may help but one, and so helps the body.
    ///
    /// A body at the end of a plate may also press the one round the corner, which shows it later. Who gets too little room is
    /// therefore also given room along the plate, where that takes none from anybody, as far as the law on its own may go.
    ///
    /// It reads of `guard` the bounds along the axes and if one body presses several plates.
    pub(crate) fn nearest(
        &self,
        most: &[T; K],
        wanted: &[T; 3],
        guard: &BaseGuard<K, T>,
        [low, high]: [&[T; 3]; 2],
    ) -> [T; 3] {
        let rows = || {
            let taxels = self.map.columns().iter().zip(&self.aside).zip(most);
            taxels.filter(|(_, most)| most.is_finite())
        };
        // with bounds of the axes
        if rows().count() <= FEW {
            self.solved::<{ 3 + FEW + BODIES }>(rows(), wanted, guard, [low, high])
        } else {
            self.solved::<{ 3 + MOST + BODIES }>(rows(), wanted, guard, [low, high])
        }
    }

    fn solved<'a, const R: usize>(
        &self,
        taxels: impl Iterator<Item = ((&'a [T; 3], &'a i8), &'a T)>,
        wanted: &[T; 3],
        guard: &BaseGuard<K, T>,
        [low, high]: [&[T; 3]; 2],
    ) -> [T; 3] {
        let mut rows = [Row::bound(0, low[0], high[0]); R];
        let mut aside = [0; R];
        let mut count = 3;
        for j in 1..3 {
            rows[j] = Row::bound(j, low[j], high[j]);
        }
        for (([x, y, lever], side), most) in taxels {
            if count + BODIES == R {
                break;
            }
            rows[count] = Row::at_least([*x, *y, *lever, T::zero()], -*most).softened(3);
            aside[count] = *side;
            count += 1;
        }
        let [x, y, yaw] = *wanted;
        let nearest = |rows: &[Row<4, T>], to: &[T; 4]| self.metric.nearest(to, rows, &WorkingSet::EMPTY);
        let mut solution = nearest(&rows[..count], &[x, y, yaw, T::zero()]);
        if let Ok(first) = &solution {
            let (exceeded, [to_x, to_y]) =
                given_aside(&rows[..count], &aside, first, [x, y], guard.bounds_body.as_ref());
            let given = [to_x, to_y, yaw, T::zero()];
            if guard.one_body
                && exceeded > 0
                && let Some(of_bodies) = self.nearest_of_bodies(&rows, count, first, &given)
            {
                solution = Ok(of_bodies);
            } else if (exceeded > 1 || [to_x, to_y] != [x, y])
                && let Some(worst) = worst(&rows[..count], first)
            {
                harden(&mut rows[worst], first.x[3]);
                solution = nearest(&rows[..count], &given).or(solution);
            }
        }
        // soft rows between bounds always have a nearest point; should rounding ever hide it, the base brakes
        let [x, y, yaw, _] = solution.map_or([T::zero(); 4], |solution| solution.x);
        let inside = |v: T, j: usize| v.clamp(low[j], high[j]);
        [inside(x, 0), inside(y, 1), inside(yaw, 2)]
    }

    /// The velocity nearest to `given` among those that exceed the worst body's row by the least, then the other bodies', then the worst
    /// plate's: what presses plates of one side is one body. `rows` has `count` rows, the first three of them those of the axes, and
    /// `first` is the nearest to all of them alone.
    ///
    /// The body receives the sum of the forces, so its row is the mean of its plates'. None of them goes outward for it, unless it does in
    /// `first`, nor faster: the body may have let go of that one. A plate that asks for no room is not part of it, and one that asks for
    /// little has a small part: the result depends continuously on the rows.
    #[inline(never)]
    fn nearest_of_bodies<const R: usize>(
        &self,
        rows: &[Row<4, T>; R],
        count: usize,
        first: &Solution<4, T>,
        given: &[T; 4],
    ) -> Option<Solution<4, T>> {
        let mut of_a_body = [false; R];
        let (mut bodies, mut plates, mut end) = (*rows, *rows, count);
        for one in 3..count {
            if end == R {
                break;
            }
            let [to_x, to_y, ..] = rows[one].normal;
            let (mut normal, mut lower, mut weight) = ([T::zero(); 4], T::zero(), T::zero());
            for i in one..count {
                let ([x, y, lever, _], asked) = (rows[i].normal, rows[i].lower);
                if of_a_body[i] || !on_one_side([x, y], [to_x, to_y]) {
                    continue;
                }
                of_a_body[i] = true;
                let share = (asked / of(FORGOTTEN_M_S)).clamp(T::zero(), T::one());
                for (sum, part) in normal.iter_mut().zip([x, y, lever]) {
                    *sum += share * part;
                }
                lower += share * asked;
                weight += share;
                let outward = (asked - excess(&rows[i], first)).min(T::zero());
                bodies[i].lower -= share * (asked - outward);
                bodies[i].normal[3] -= share;
            }
            if weight > T::zero() {
                let mean = Row::at_least(normal.map(|sum| sum / weight), lower / weight);
                (plates[end], bodies[end]) = (mean, mean.softened(3));
                end += 1;
            }
        }
        let nearest = |rows: &[Row<4, T>]| self.metric.nearest(given, rows, &WorkingSet::EMPTY).ok();
        let mut reached = nearest(&bodies[..end])?;
        if let Some(worst) = worst(&bodies[..end], &reached) {
            harden(&mut bodies[worst], reached.x[3]);
            reached = nearest(&bodies[..end]).unwrap_or(reached);
        }
        for body in &mut plates[count..end] {
            let missing = excess(body, &reached).max(T::zero());
            harden(body, missing);
        }
        nearest(&plates[..end]).or(Some(reached))
    }

    /// Translation at `speed` away from all of `touched` together; none where they leave no way out.
    pub fn away_from(&self, touched: &[bool; K], speed: T) -> [T; 3] {
        let (mut x, mut y) = (T::zero(), T::zero());
        for (inward, _) in self.map.columns().iter().zip(touched).filter(|(_, touched)| **touched) {
            x += inward[0];
            y += inward[1];
        }
        let length = (x * x + y * y).sqrt();
        if length < of(1e-6) {
            return [T::zero(); 3];
        }
        [x / length * speed, y / length * speed, T::zero()]
    }

    /// Returns true if `guard` permits the velocity.
    pub fn permits(&self, guard: &BaseGuard<K, T>, velocity: &[T; 3]) -> bool {
        let [vx, vy, yaw] = *velocity;
        let least = -of::<T>(STANDSTILL);
        let rounding = T::one() + of::<T>(4.0) * T::default_epsilon();
        guard.speed_m_s.is_none_or(|most| self.fastest(velocity) <= most * rounding)
            && guard.bounds_permit(velocity)
            && self.blocked(guard).all(|[x, y, lever]| *x * vx + *y * vy >= least && *lever * yaw >= least)
    }

    /// The nearest translation, and the yaw rate or none, that `guard` permits; slowed down as one motion.
    pub fn guarded(&self, guard: &BaseGuard<K, T>, wanted: &[T; 3]) -> [T; 3] {
        let [vx, vy, yaw] = guard.instead_body.unwrap_or(*wanted);
        // the lever of a taxel in the middle of its side is rounding, and has a sign
        let least = -of::<T>(STANDSTILL);
        let turns_out = self.blocked(guard).any(|[_, _, lever]| *lever * yaw < least);
        let [vx, vy] = self.nearest_translation(guard, [vx, vy]);
        let free = [vx, vy, if turns_out { T::zero() } else { yaw }];
        let velocity = self.bounded(guard, free);
        match guard.speed_m_s {
            Some(most) => scaled_to(velocity, self.fastest(&velocity), most),
            None => velocity,
        }
    }

    /// `velocity`, which moves no blocked taxel outward, within the bounds along the axes; its translation ends where the
    /// one is at odds with the other.
    fn bounded(&self, guard: &BaseGuard<K, T>, velocity: [T; 3]) -> [T; 3] {
        let Some([least, most]) = &guard.bounds_body else { return velocity };
        let [x, y, yaw] = core::array::from_fn(|i| velocity[i].clamp(least[i], most[i]));
        let slack = -of::<T>(STANDSTILL);
        if self.blocked(guard).all(|[ux, uy, _]| *ux * x + *uy * y >= slack) {
            [x, y, yaw]
        } else {
            [T::zero(), T::zero(), yaw]
        }
    }

    /// The translation nearest to `wanted` that moves no blocked taxel outward. The permitted ones are a cone, so it is
    /// `wanted` itself, or on one of the cone's two edges, or standing still.
    fn nearest_translation(&self, guard: &BaseGuard<K, T>, wanted: [T; 2]) -> [T; 2] {
        let inward_speed = |[x, y]: [T; 2], [ux, uy, _]: &[T; 3]| *ux * x + *uy * y;
        let least = -of::<T>(STANDSTILL);
        let permitted = |v: [T; 2]| self.blocked(guard).all(|u| inward_speed(v, u) >= least);
        if permitted(wanted) {
            return wanted;
        }
        let mut nearest = [T::zero(); 2];
        let mut most = T::zero();
        for u in self.blocked(guard) {
            let outward = inward_speed(wanted, u);
            let along = [wanted[0] - outward * u[0], wanted[1] - outward * u[1]];
            let squared = along[0] * along[0] + along[1] * along[1];
            if squared > most && permitted(along) {
                (nearest, most) = (along, squared);
            }
        }
        nearest
    }

    fn blocked<'a>(&'a self, guard: &'a BaseGuard<K, T>) -> impl Iterator<Item = &'a [T; 3]> {
        self.map
            .columns()
            .iter()
            .zip(&guard.blocked)
            .filter(|(_, blocked)| **blocked)
            .map(|(inward, _)| inward)
    }
}

/// Number of taxels' rows that a nearest velocity exceeds, and the translation `wanted` with room along their plates: as fast as
/// each misses room, and within `bounds`, unless more was wanted.
fn given_aside<T: Scalar>(
    rows: &[Row<4, T>],
    aside: &[i8],
    nearest: &Solution<4, T>,
    wanted: [T; 2],
    bounds: Option<&[[T; 3]; 2]>,
) -> (usize, [T; 2]) {
    let (mut exceeded, mut given) = (0, wanted);
    for (row, side) in rows.iter().zip(aside).skip(3) {
        let missing = excess(row, nearest);
        if missing > of(SOFTNESS) {
            exceeded += 1;
            let ([x, y, ..], side) = (row.normal, of::<T>(f64::from(*side)));
            given[0] -= side * y * missing;
            given[1] += side * x * missing;
        }
    }
    if let Some([least, most]) = bounds {
        for (axis, wanted) in wanted.into_iter().enumerate() {
            given[axis] = given[axis].clamp(least[axis].min(wanted), most[axis].max(wanted));
        }
    }
    (exceeded, given)
}

/// Returns the row, of those that share the slack in full, that holds a nearest velocity back the most.
fn worst<T: Scalar>(rows: &[Row<4, T>], nearest: &Solution<4, T>) -> Option<usize> {
    let soft = nearest.active().iter().filter(|active| rows[active.row].normal[3] >= T::one());
    let worst =
        soft.reduce(|worst, active| if active.multiplier > worst.multiplier { active } else { worst });
    worst.map(|worst| worst.row)
}

/// Makes a row one that may be exceeded by `excess_m_s` and no more.
fn harden<T: Scalar>(row: &mut Row<4, T>, excess_m_s: T) {
    row.normal[3] = T::zero();
    row.lower -= excess_m_s * of(1.0 + ROUNDING);
}

/// Speed outward by which a taxel's row is exceeded, m/s.
fn excess<T: Scalar>(row: &Row<4, T>, nearest: &Solution<4, T>) -> T {
    let ([x, y, yaw, _], [to_x, to_y, lever, _]) = (nearest.x, row.normal);
    row.lower - (to_x * x + to_y * y + lever * yaw)
}

/// Returns the side of taxel `i` that leads away from the nearest one round a corner: 1 left, −1 right, 0 where no body reaches both.
fn from_corner<T: Scalar>(i: usize, columns: &[[T; 3]], taxels: &[TaxelPlacement]) -> i8 {
    let Some(([x, y, _], here)) = columns.get(i).zip(taxels.get(i)) else { return 0 };
    let (mut nearest, mut aside) = (BODY_M * BODY_M, 0);
    for ([to_x, to_y, _], there) in columns.iter().zip(taxels) {
        let apart = squared(&here.position_base_m, &there.position_base_m);
        if (*x * *to_x + *y * *to_y).abs() < of(SAME_SIDE) && apart <= nearest {
            (nearest, aside) = (apart, if *x * *to_y > *y * *to_x { 1 } else { -1 });
        }
    }
    aside
}

fn scaled_to<T: Scalar>(velocity: [T; 3], speed: T, most: T) -> [T; 3] {
    if speed <= most { velocity } else { velocity.map(|v| v * (most / speed)) }
}

#[cfg(test)]
#[expect(clippy::float_cmp, reason = "what is not touched keeps its bits")]
mod tests {
    use super::*;
    use moca_msgs::robot::PAPER_COVER;

    fn outline() -> CoverOutline<11, f64> {
        CoverOutline::new(&PAPER_COVER).unwrap()
    }

    fn blocking(taxels: &[usize]) -> BaseGuard<11> {
        BaseGuard { blocked: core::array::from_fn(|i| taxels.contains(&i)), ..BaseGuard::NONE }
    }

    /// T1 of a cover that has no other: on the rounded corner, forward and left; inward is backwards and to the right.
    const CORNER: TaxelPlacement =
        TaxelPlacement { position_base_m: [0.4, 0.3], inward_angle_base_rad: -0.75 * core::f64::consts::PI };

    fn on_a_corner() -> CoverOutline<11, f64> {
        CoverOutline::new(&[CORNER]).unwrap()
    }

    const MOTIONS: [[f64; 3]; 5] =
        [[0.3, -0.2, 0.0], [0.3, -0.2, 0.5], [-0.1, 0.4, 0.7], [-0.2, -0.1, -0.6], [0.0, 0.1, -0.2]];

    fn velocity_of([x, y]: [f64; 2], [vx, vy, yaw]: [f64; 3]) -> [f64; 2] {
        [vx - yaw * y, vy + yaw * x]
    }

    #[test]
    fn fastest_point_is_a_corner() {
        for motion in MOTIONS {
            let speeds = [[1.0, 1.0], [1.0, -1.0], [-1.0, 1.0], [-1.0, -1.0]].map(|[side, end]| {
                let [x, y] = velocity_of([0.489 * side, 0.388 * end], motion);
                x.hypot(y)
            });
            let fastest = speeds.into_iter().fold(0.0, f64::max);
            assert!((outline().fastest(&motion) - fastest).abs() < 1e-12, "{motion:?}");
        }
    }

    #[test]
    fn outward_speed_and_braking_use_the_taxel_place() {
        for placements in [&PAPER_COVER[..], &[CORNER]] {
            let outline: CoverOutline<11, f64> = CoverOutline::new(placements).unwrap();
            for (taxel, placement) in placements.iter().enumerate() {
                let outward_of = |motion: [f64; 3]| {
                    let [x, y] = velocity_of(placement.position_base_m, motion);
                    let (sin, cos) = placement.inward_angle_base_rad.sin_cos();
                    -(x * cos + y * sin)
                };
                for motion in MOTIONS {
                    let outward = outline.outward(taxel, &motion);
                    assert!((outward - outward_of(motion)).abs() < 1e-12, "T{} in {motion:?}", taxel + 1);
                }
                let axes = [2.0, 3.0, 5.0];
                let most = (0..8_u32)
                    .map(|signs| [0, 1, 2].map(|j| if signs >> j & 1 == 0 { axes[j] } else { -axes[j] }))
                    .fold(0.0_f64, |most, change| most.max(outward_of(change)));
                let deceleration = outline.deceleration(taxel, &axes);
                assert!((deceleration - most).abs() < 1e-12, "T{}: {deceleration}", taxel + 1);
            }
        }
    }

    #[test]
    fn outward_speed_row_is_exact_and_skips_bare_places() {
        let outline = on_a_corner();
        let motion = [0.3, -0.2, 0.5];
        let outward = outline.outward(0, &motion);
        let most = |of_taxel: f64| core::array::from_fn(|i| if i == 0 { of_taxel } else { -1.0 });
        assert!(outline.keeps(&most(outward), &motion) && outline.keeps(&most(f64::INFINITY), &motion));
        assert!(!outline.keeps(&most(outward - 1e-9), &motion));
        assert!(!outline.keeps(&most(-0.1), &[0.0; 3]), "it has to give way");
    }

    /// T6 is in front; T2 and T3 are on the left, as far behind the middle as before it.
    #[test]
    fn nearest_motion_keeps_rows_and_gives_way() {
        let nearest = |most: &[(usize, f64)], wanted: [f64; 3]| {
            let mut outward_m_s = [f64::INFINITY; 11];
            most.iter().for_each(|(taxel, speed)| outward_m_s[*taxel] = *speed);
            outline().nearest(&outward_m_s, &wanted, &BaseGuard::NONE, [&[-1.0; 3], &[1.0; 3]])
        };
        // a soft bound gives by a ten-thousandth of what it takes away
        let near = |a: [f64; 3], b: [f64; 3]| a.iter().zip(b).all(|(a, b)| (a - b).abs() < 1e-4);
        for (most, wanted, expected) in [
            (&[][..], [0.3, 0.2, 0.4], [0.3, 0.2, 0.4]),
            (&[(5, 0.1)], [0.3, 0.2, 0.4], [0.1, 0.2, 0.4]),
            (&[(5, 0.1), (1, 0.05), (2, 0.05)], [0.3, 0.2, 0.0], [0.1, 0.05, 0.0]),
            (&[(5, -0.1)], [0.0, 0.2, 0.0], [-0.1, 0.2, 0.0]),
            // more than nearly always are limited, and only the last of them acts
            (&[(1, 0.9), (2, 0.9), (3, 0.9), (5, 0.1)], [0.3, 0.2, 0.0], [0.1, 0.2, 0.0]),
        ] {
            let kept = nearest(most, wanted);
            assert!(near(kept, expected), "{most:?}: {kept:?}");
        }
    }

    /// Nearest motion in one step from rest, the taxels going outward no faster than this.
    fn step(most: &[(usize, f64)], wanted: [f64; 3], bounds_body: Option<[[f64; 3]; 2]>) -> [f64; 3] {
        step_within(&BaseGuard { bounds_body, ..BaseGuard::NONE }, most, wanted)
    }

    fn step_within(guard: &BaseGuard<11>, most: &[(usize, f64)], wanted: [f64; 3]) -> [f64; 3] {
        let mut outward_m_s = [f64::INFINITY; 11];
        most.iter().for_each(|(taxel, speed)| outward_m_s[*taxel] = *speed);
        let limits = [&[-0.003, -0.003, -0.006], &[0.003, 0.003, 0.006]];
        outline().nearest(&outward_m_s, &wanted, guard, limits)
    }

    /// T6 is in the middle of the front, where turning does nothing, T5 left and T7 right of it.
    #[test]
    fn nearest_motion_helps_each_that_gets_too_little_room() {
        let near = |a: [f64; 3], b: [f64; 3]| a.iter().zip(b).all(|(a, b)| (a - b).abs() < 1e-5);
        let lever_m = outline().outward(6, &[0.0, 0.0, 1.0]);
        for (most, expected) in [
            // a body at their seam: T6 cannot get more than 3 mm/s, T7 gets more by turning
            (&[(5, -0.2), (6, -0.2)][..], [-0.003, 0.003, -0.006]),
            (&[(5, -0.2), (4, -0.2)], [-0.003, -0.003, 0.006]),
            // no more than it asks for
            (&[(5, -0.2), (6, -0.003 - 0.002 * lever_m)], [-0.003, 0.002 * lever_m, -0.002]),
            // what turning gives one it takes from the other
            (&[(4, -0.2), (5, -0.2), (6, -0.2)], [-0.003, 0.0, 0.0]),
            // the worst gets all that it can, although turning would be better for T5
            (&[(6, -0.3), (4, -0.2)], [-0.003, 0.003, -0.006]),
            (&[(6, -0.2), (4, -0.3)], [-0.003, -0.003, 0.006]),
            // alone
            (&[(6, -0.2)], [-0.003, 0.003, -0.006]),
            (&[(5, -0.2)], [-0.003, 0.0, 0.0]),
        ] {
            let kept = step(most, [0.0; 3], None);
            assert!(near(kept, expected), "{most:?}: {kept:?}");
        }
        // a turn that is wanted ends where it takes room from the other
        let kept = step(&[(5, -0.2), (6, -0.003)], [0.0, 0.0, 0.006], None);
        assert!(near(kept, [-0.003, 0.006 * lever_m, 0.0]), "{kept:?}");
    }

    /// The paper's cover, turned on its base.
    fn turned(angle_rad: f64) -> [TaxelPlacement; 11] {
        PAPER_COVER.map(|taxel| {
            let ([x, y], (sin, cos)) = (taxel.position_base_m, angle_rad.sin_cos());
            let inward_angle_base_rad = taxel.inward_angle_base_rad + angle_rad;
            TaxelPlacement { position_base_m: [cos * x - sin * y, sin * x + cos * y], inward_angle_base_rad }
        })
    }

    #[test]
    fn sides_are_told_apart_however_the_cover_is_turned() {
        for angle_rad in [0.0, 0.4, 1.2, 2.5, 4.0, 5.5_f64] {
            let inward = |from_rad: f64| {
                let (y, x) = (angle_rad + from_rad).sin_cos();
                [x, y]
            };
            for (apart_rad, expected) in
                [(0.0, true), (0.79, true), (-0.79, true), (0.8, false), (-0.8, false), (3.1, false)]
            {
                assert_eq!(on_one_side(inward(0.0), inward(apart_rad)), expected, "{angle_rad} {apart_rad}");
            }
        }
    }

    /// T2 is behind the middle of its side, T3 and T4 are before it, T4 furthest.
    #[test]
    fn nearest_motion_gives_one_body_room_on_all_its_plates() {
        let one_body = BaseGuard { one_body: true, ..BaseGuard::NONE };
        let near = |a: [f64; 3], b: [f64; 3]| a.iter().zip(b).all(|(a, b)| (a - b).abs() < 1e-5);
        let mean_m_s =
            |kept: &[f64; 3]| [1, 2, 3].map(|taxel| outline().outward(taxel, kept)).iter().sum::<f64>() / 3.0;
        // turning gives T3 and T4 more than it takes from T2
        let pressed = [(1, -0.2), (2, -0.2), (3, -0.2)];
        let alone = step(&pressed, [0.0; 3], None);
        assert!(near(alone, [-0.003, -0.003, 0.0]), "{alone:?}");
        let kept = step_within(&one_body, &pressed, [0.0; 3]);
        assert!(near(kept, [-0.003, -0.003, -0.006]), "{kept:?}");
        assert!(mean_m_s(&kept) < 1.1 * mean_m_s(&alone));
        // no more than the mean needs, the rest is for the worst of them: T2, for which turning is no help
        let limits = [&[-0.1; 3], &[0.1; 3]];
        let mut most = [f64::INFINITY; 11];
        (most[1], most[2], most[3]) = (-0.12, -0.1, -0.09);
        let needed_m_s = mean_m_s(&outline().nearest(&most, &[0.0; 3], &one_body, limits));
        assert!((needed_m_s + 0.31 / 3.0).abs() < 2e-5, "{needed_m_s}");
        let alone_m_s = mean_m_s(&outline().nearest(&most, &[0.0; 3], &BaseGuard::NONE, limits));
        assert!(alone_m_s > -0.099, "{alone_m_s}");
        // none of them goes outward for it: the base that may not go away does not turn into T2
        let mut most = [f64::INFINITY; 11];
        (most[1], most[2], most[3]) = (-0.2, -0.2, -0.2);
        let stuck = [&[-0.003, 0.0, -0.006], &[0.003, 0.0, 0.006]];
        let kept = outline().nearest(&most, &[0.0; 3], &one_body, stuck);
        assert!(kept[2].abs() < 1e-5, "{kept:?}");
        // unless it does already
        let braking = [&[-0.003, 0.0, -0.016], &[0.003, 0.0, -0.01]];
        let kept = outline().nearest(&most, &[0.0; 3], &one_body, braking);
        assert!((kept[2] + 0.01).abs() < 1e-5, "{kept:?}");
        // a plate that hardly asks for room counts as little
        let kept = step_within(&one_body, &[(1, -1e-5), (2, -0.2), (3, -0.2)], [0.0; 3]);
        assert!(near(kept, [-0.003, -0.003, -0.006]), "{kept:?}");
        // plates of two sides are pressed by two, and one plate by one
        for most in [&[(5, -0.2), (1, -0.2)][..], &[(6, -0.2)], &[(6, -0.2), (5, 0.0)]] {
            let (of_bodies, of_plates) = (step_within(&one_body, most, [0.0; 3]), step(most, [0.0; 3], None));
            assert!(near(of_bodies, of_plates), "{most:?}: {of_bodies:?} {of_plates:?}");
        }
        // who asks for little on another side gets that, and the body on this one all
        let mut most = [f64::INFINITY; 11];
        (most[0], most[1], most[5]) = (-0.2, -0.2, -0.02);
        let [x, y, yaw] = outline().nearest(&most, &[0.0; 3], &one_body, limits);
        assert!((x + 0.02).abs() < 1e-4 && y <= -0.1 && yaw > 0.0999, "{x} {y} {yaw}");
        // a cover that is turned on its base has the same sides
        for angle_rad in [0.4, 1.2, 2.5, 4.0, 5.5] {
            let outline: CoverOutline<11, f64> = CoverOutline::new(&turned(angle_rad)).unwrap();
            let mut most = [f64::INFINITY; 11];
            (most[1], most[2], most[3]) = (-0.2, -0.2, -0.2);
            let kept = outline.nearest(&most, &[0.0; 3], &one_body, limits);
            let mean_m_s =
                |kept: &[f64; 3]| [1, 2, 3].map(|i| outline.outward(i, kept)).iter().sum::<f64>() / 3.0;
            let axes = [[0.1, 0.0, 0.0], [0.0, 0.1, 0.0], [0.0, 0.0, 0.1]];
            let best_m_s: f64 = axes.iter().map(|axis| mean_m_s(axis).abs()).sum();
            assert!((mean_m_s(&kept) + best_m_s).abs() < 1e-5, "{angle_rad}: {kept:?} {best_m_s}");
        }
        // a base that is to stand gives it that room too
        let stopped = BaseGuard { speed_m_s: Some(0.0), ..one_body }.room();
        assert_eq!(stopped, one_body);
        // where all can be kept nothing changes
        let within = [(1, -0.002), (2, -0.001)];
        assert_eq!(step_within(&one_body, &within, [0.0; 3]), step(&within, [0.0; 3], None));
    }

    /// T4 and T5, and T7 and T11, are round a corner in front. T6 is in the middle there, T1 and T8 at the ends behind.
    #[test]
    fn nearest_motion_gives_room_along_a_plate_at_a_corner() {
        let near = |a: [f64; 2], b: [f64; 2]| a.iter().zip(b).all(|(a, b)| (a - b).abs() < 1e-6);
        for (taxel, expected) in [
            (3, [-0.003, -0.003]),
            (4, [-0.003, -0.003]),
            (6, [-0.003, 0.003]),
            (10, [-0.003, 0.003]),
            (5, [-0.003, 0.0]),
            (0, [0.0, -0.003]),
            (7, [0.0, 0.003]),
        ] {
            let [x, y, _] = step(&[(taxel, -0.2)], [0.0; 3], None);
            assert!(near([x, y], expected), "T{}: {x} {y}", taxel + 1);
        }
        // no body reaches round the end of a plate that has none beside it there, or to the other side of a narrow base
        let at = |x: f64, y: f64, angle: f64| TaxelPlacement {
            position_base_m: [x, y],
            inward_angle_base_rad: angle * core::f64::consts::PI,
        };
        let narrow: CoverOutline<11, f64> =
            CoverOutline::new(&[at(0.3, 0.1, -0.5), at(0.3, -0.1, 0.5), at(0.6, 0.3, 1.0)]).unwrap();
        assert_eq!(narrow.aside, [0; 11]);
        // who gets the room that is needed gets no more
        let lever_m = outline().outward(10, &[0.0, 0.0, 1.0]);
        let [x, _, _] = step(&[(10, -0.003 + 0.006 * lever_m)], [0.0; 3], None);
        assert!(x.abs() < 1e-6, "{x}");
        // as fast as room is missing
        let [x, _, _] = step(&[(10, -0.004 + 0.006 * lever_m)], [0.0; 3], None);
        assert!((x + 0.001).abs() < 1e-5, "{x}");
        let lever_m = outline().outward(6, &[0.0, 0.0, 1.0]);
        let [_, y, _] = step(&[(6, -0.004 - 0.006 * lever_m)], [0.0; 3], None);
        assert!((y - 0.001).abs() < 1e-5, "{y}");
        // a cover that is turned on its base has the same corners
        let turned: CoverOutline<11, f64> = CoverOutline::new(&turned(0.4)).unwrap();
        assert_eq!(turned.aside, outline().aside);
        assert_eq!(turned.aside, [0, 0, 0, -1, 1, 0, -1, 0, 0, 0, 1]);
        // somebody else stands there
        let kept = step(&[(6, -0.2), (1, 0.001)], [0.0; 3], None);
        assert!((outline().outward(1, &kept) - 0.001).abs() < 2e-5 && kept[0] <= -0.003, "{kept:?}");
        // the law on its own may go no further that way, unless it already does
        let bounds = [[-0.001, -1.0, -1.0], [0.002, 1.0, 1.0]];
        let [x, _, _] = step(&[(10, -0.2)], [0.0; 3], Some(bounds));
        assert!((x + 0.001).abs() < 1e-6, "{x}");
        let [x, _, _] = step(&[(10, -0.2)], [-0.002, 0.0, 0.0], Some(bounds));
        assert!((x + 0.002).abs() < 1e-6, "{x}");
    }

    /// Some rows within reach and some beyond it, equal ones among them, and others a little off.
    #[test]
    fn nearest_motion_depends_continuously_on_its_rows() {
        let mut seed = 1_u64;
        let mut uniform = move || {
            seed = seed.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1);
            f64::from((seed >> 32) as u32) / f64::from(u32::MAX)
        };
        let outline = outline();
        for case in 0..4000 {
            let first = case % 11;
            let rows = 2 + case / 11 % 3;
            let equal = (case / 33 % 3 == 0).then(&mut uniform);
            let mut most = [f64::INFINITY; 11];
            for i in first..first + rows {
                most[i % 11] = -0.3 * equal.unwrap_or_else(&mut uniform);
            }
            let guard = BaseGuard { one_body: case % 2 == 0, ..BaseGuard::NONE };
            let low = [-0.003, -0.003, -0.006].map(|v| v * 10.0_f64.powf(2.0 * uniform()));
            let wanted = [0.1, 0.1, 0.2].map(|v| v * (uniform() - 0.5));
            let mut nearest = |off: f64| {
                let most = most.map(|m| m + off * (uniform() - 0.5));
                outline.nearest(&most, &wanted, &guard, [&low, &low.map(|v| -v)])
            };
            let (here, beside) = (nearest(0.0), nearest(1e-7));
            let change = here.iter().zip(beside).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
            assert!(change < 1e-5, "{most:?} {low:?} {wanted:?}: {here:?} {beside:?}");
        }
    }

    #[test]
    fn the_fastest_point_of_a_turning_base_is_a_corner() {
        let corner = 0.489_f64.hypot(0.388);
        assert!((outline().fastest(&[0.0, 0.0, -1.0]) - corner).abs() < 1e-12);
        assert!((outline().fastest(&[0.3, -0.4, 0.0]) - 0.5).abs() < 1e-12);
        assert!((outline().fastest(&[0.1, 0.0, 1.0]) - (0.1 + 0.388_f64).hypot(0.489)).abs() < 1e-12);
    }

    #[test]
    fn a_speed_limit_slows_a_motion_down_as_one() {
        let guard = BaseGuard { speed_m_s: Some(0.05), ..BaseGuard::NONE };
        let slowed = outline().guarded(&guard, &[0.3, -0.1, 0.4]);
        assert!((outline().fastest(&slowed) - 0.05).abs() < 1e-12);
        assert!(
            (slowed[1] / slowed[0] + 1.0 / 3.0).abs() < 1e-12
                && (slowed[2] / slowed[0] - 4.0 / 3.0).abs() < 1e-12
        );
    }

    /// T6 is in front (inward is −x), T3 on the left and forward of the middle (inward is −y).
    #[test]
    fn a_blocked_taxel_stops_its_own_direction_only() {
        let outline = outline();
        let [vx, vy, yaw] = outline.guarded(&blocking(&[5]), &[0.2, 0.1, 0.3]);
        assert!(vx.abs() < 1e-12 && (vy - 0.1).abs() < 1e-12 && (yaw - 0.3).abs() < 1e-12);
        assert_eq!(outline.guarded(&blocking(&[5]), &[-0.2, 0.1, 0.0]), [-0.2, 0.1, 0.0]);
        // to the left is into the hand at T3, and so is turning left
        let [vx, vy, yaw] = outline.guarded(&blocking(&[2]), &[0.2, 0.1, 0.3]);
        assert!((vx - 0.2).abs() < 1e-12 && vy.abs() < 1e-12 && yaw == 0.0);
        let [.., yaw] = outline.guarded(&blocking(&[2]), &[0.0, 0.0, -0.3]);
        assert_eq!(yaw, -0.3);
        // in the middle of the front a turn goes past the hand, either way
        assert_eq!(outline.guarded(&blocking(&[5]), &[0.0, 0.0, -0.3]), [0.0, 0.0, -0.3]);
        // forward is into the hand; to the right, however slowly, is not
        let [vx, vy, _] = outline.guarded(&blocking(&[5]), &[0.2, -0.1, 0.0]);
        assert!(vx.abs() < 1e-12 && (vy + 0.1).abs() < 1e-12, "{vx} {vy}");
    }

    #[test]
    fn rest_and_exact_limit_are_permitted() {
        let outline = outline();
        let hands: [usize; 11] = core::array::from_fn(|i| i);
        for zero in [0.0, -0.0] {
            assert!(outline.permits(&blocking(&hands), &[zero; 3]));
        }
        let limited = BaseGuard { speed_m_s: Some(0.05), ..BaseGuard::NONE };
        assert!(outline.permits(&limited, &[0.05, 0.0, 0.0]));
        assert!(!outline.permits(&limited, &[0.05 + 1e-9, 0.0, 0.0]));
        // forward and to the left only
        let ahead = BaseGuard { bounds_body: Some([[0.0; 3], [0.2; 3]]), ..BaseGuard::NONE };
        assert!(ahead.check(11).is_ok() && outline.permits(&ahead, &[0.2, 0.0, 0.2]));
        assert!(!outline.permits(&ahead, &[0.2, 0.0, 0.2 + 1e-8]));
        let behind = BaseGuard { bounds_body: Some([[-0.2; 3], [0.0; 3]]), ..BaseGuard::NONE };
        assert!(behind.check(11).is_ok() && outline.permits(&behind, &[-0.2, 0.0, -0.2]));
    }

    /// A hand on the corner allows to the right as much as forward; a bound takes some of the way to the right.
    #[test]
    fn a_translation_ends_where_a_bound_would_turn_it_into_the_hand() {
        let outline = on_a_corner();
        let kept = |least: [f64; 3], most: [f64; 3], wanted: [f64; 3]| {
            outline.guarded(&BaseGuard { bounds_body: Some([least, most]), ..blocking(&[0]) }, &wanted)
        };
        assert_eq!(kept([-9.0, -0.1, -9.0], [9.0; 3], [0.2, -0.3, 0.0]), [0.0; 3]);
        assert_eq!(kept([-9.0; 3], [0.1, 9.0, 9.0], [0.2, -0.3, 0.0]), [0.1, -0.3, 0.0]);
    }

    #[test]
    fn hands_on_both_sides_leave_the_way_between_them() {
        let [vx, vy, _] = outline().guarded(&blocking(&[1, 8]), &[0.1, 0.2, 0.0]);
        assert!((vx - 0.1).abs() < 1e-12 && vy.abs() < 1e-12);
        let still = outline().guarded(&blocking(&[1, 8, 5]), &[0.1, 0.2, 0.0]);
        assert!(still.iter().all(|v| v.abs() < 1e-9), "{still:?}");
    }

    #[test]
    fn the_way_out_is_away_from_all_of_them() {
        let touched = |taxels: &[usize]| blocking(taxels).blocked;
        let [vx, vy, yaw] = outline().away_from(&touched(&[2, 5]), 0.05);
        assert!((vx + vy + 0.05 * 2.0_f64.sqrt()).abs() < 1e-12 && (vx - vy).abs() < 1e-12 && yaw == 0.0);
        assert_eq!(outline().away_from(&touched(&[1, 8]), 0.05), [0.0; 3], "between two hands there is none");
        assert_eq!(outline().away_from(&[false; 11], 0.05), [0.0; 3]);
    }

    #[test]
    fn what_is_bounded_along_an_axis_goes_on_along_the_others() {
        let outline = outline();
        let bounded = |blocked: &[usize], wanted: [f64; 3]| {
            let bounds_body = Some([[-0.02, -9.0, -9.0], [9.0; 3]]);
            let guard = BaseGuard { bounds_body, ..blocking(blocked) };
            assert!(guard.check(11).is_ok());
            let kept = outline.guarded(&guard, &wanted);
            assert!(outline.permits(&guard, &kept), "{kept:?}");
            assert_eq!(outline.permits(&guard, &wanted), kept == wanted, "{wanted:?}");
            kept
        };
        assert_eq!(bounded(&[], [-0.1, 0.2, 0.3]), [-0.02, 0.2, 0.3]);
        assert_eq!(bounded(&[], [0.1, 0.2, 0.3]), [0.1, 0.2, 0.3]);
        // a hand at T3 as well: neither backwards nor to the left
        assert_eq!(bounded(&[2], [-0.1, 0.2, -0.3]), [-0.02, 0.0, -0.3]);
        for bounds in [[[0.1; 3], [0.2; 3]], [[-0.2; 3], [-0.1; 3]], [[f64::NAN; 3], [0.1; 3]]] {
            assert!(BaseGuard { bounds_body: Some(bounds), ..BaseGuard::<11>::NONE }.check(11).is_err());
        }
    }

    #[test]
    fn numbers_that_are_none_are_refused() {
        for bad in [f64::NAN, f64::INFINITY, -1.0] {
            assert!(BaseGuard { speed_m_s: Some(bad), ..BaseGuard::<11>::NONE }.check(11).is_err());
        }
        let guard = BaseGuard { instead_body: Some([0.0, f64::NAN, 0.0]), ..BaseGuard::<11>::NONE };
        assert!(guard.check(11).is_err());
        assert!(BaseGuard::<11>::NONE.check(11).is_ok());
        let outward = |most| BaseGuard { outward_m_s: Some([0.1, most]), ..BaseGuard::<2>::NONE }.check(2);
        assert!(outward(f64::INFINITY).is_ok() && outward(-0.3).is_ok());
        assert!(outward(f64::NAN).is_err() && outward(f64::NEG_INFINITY).is_err());
    }
}
