//! People and walls in the running scene: where they are, what they do, and what they and the cover do to each other.

use crate::contact::{ContactForce, ContactState, Pressing, Tissue};
use crate::foam::Foam;
use crate::mechanics::Mechanics;
use crate::outline::{Nearest, Outline};
use crate::scene::{Mobility, Person, Scene, Shape};
use moca_msgs::{MAX_TAXELS, TaxelPlacement};
use moca_wbc::rotation::Heading;

/// Room for the largest cover.
const K: usize = MAX_TAXELS;
/// A plane presses a taxel only if it faces it within 60°.
const FACING_COS_MIN: f64 = 0.5;
/// Faster than anybody and the base meet, m/s.
const CLOSING_MAX_M_S: f64 = 10.0;

/// The physics step whose forces are asked for.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Step {
    /// s.
    pub dt_s: f64,
    /// Positions and time are those of its middle and its forces of second order; else those of its start.
    pub from_the_middle: bool,
}

impl Step {
    /// Returns how much closer a body can be at the step's end than where its forces are evaluated, m.
    fn reach_m(self) -> f64 {
        if self.from_the_middle { 0.5 * self.dt_s * CLOSING_MAX_M_S } else { 0.0 }
    }
}

/// The cover at one instant.
pub(crate) struct CoverInstant<'a> {
    taxels: &'a [TaxelPlacement],
    outline: &'a Outline,
    foam: &'a Foam,
    step: Step,
    /// Pose of B in W: x m, y m, yaw rad; sine and cosine of the yaw.
    pose_world: [f64; 3],
    heading: (f64, f64),
    /// Velocity of B in W: m/s, m/s, rad/s.
    velocity_world: [f64; 3],
}

impl<'a> CoverInstant<'a> {
    pub(crate) fn new(
        scene: &'a Scene,
        outline: &'a Outline,
        step: Step,
        (pose_world, velocity_world): ([f64; 3], [f64; 3]),
    ) -> Self {
        Self {
            taxels: &scene.cover,
            outline,
            foam: &scene.foam,
            step,
            pose_world,
            heading: Heading::at(pose_world[2]).sin_cos(),
            velocity_world,
        }
    }

    /// A vector of W in the axes of B, and the other way.
    fn to_base(&self, [x, y]: [f64; 2]) -> [f64; 2] {
        let (sin, cos) = self.heading;
        [cos * x + sin * y, -sin * x + cos * y]
    }

    fn to_world(&self, [x, y]: [f64; 2]) -> [f64; 2] {
        let (sin, cos) = self.heading;
        [cos * x - sin * y, sin * x + cos * y]
    }

    /// A planar velocity or wrench of B's axes in W's.
    pub(crate) fn planar_to_world(&self, [x, y, about_vertical]: [f64; 3]) -> [f64; 3] {
        let [x, y] = self.to_world([x, y]);
        [x, y, about_vertical]
    }

    /// Velocity of a point of B in the axes of B, m/s.
    fn velocity_base(&self, [x, y]: [f64; 2]) -> [f64; 2] {
        let [vx, vy, yaw_rate] = self.velocity_world;
        let [vx, vy] = self.to_base([vx, vy]);
        [vx - yaw_rate * y, vy + yaw_rate * x]
    }
}

/// Readings of the cover at one step.
#[derive(Debug)]
pub(crate) struct Felt {
    /// N, T1 first.
    pub taxel_force_n: [f64; K],
    /// Wrench on the base about its origin, axes of B: N, N, N·m.
    pub wrench_base: [f64; 3],
    /// Mean force over the step, which moves the base.
    pub push_base: [f64; 3],
    /// Normal forces on all bodies and on the one that is pressed hardest, felt by a taxel or not, N.
    pub total_n: f64,
    pub largest_n: f64,
}

impl Felt {
    pub(crate) const NOTHING: Self = Self {
        taxel_force_n: [0.0; K],
        wrench_base: [0.0; 3],
        push_base: [0.0; 3],
        total_n: 0.0,
        largest_n: 0.0,
    };

    /// Forces on taxels at their centres, N, T1 first, each on a body of its own.
    pub(crate) fn sensed(&mut self, scene: &Scene, outline: &Outline, forces_n: &[f64]) {
        // most of the time nobody presses; no early return: several at once
        if !forces_n.iter().fold(false, |any, force_n| any | (*force_n > 0.0)) {
            return;
        }
        for (i, &force_n) in forces_n.iter().enumerate() {
            if force_n > 0.0
                && let Some(taxel) = scene.cover.get(i)
            {
                let ([nx, ny], [x, y]) = (outline.taxel_outward_base(i), taxel.position_base_m);
                let (fx, fy) = (-force_n * nx, -force_n * ny);
                self.taxel_force_n[i] += force_n;
                self.wrench_base[0] += fx;
                self.wrench_base[1] += fy;
                self.wrench_base[2] += x * fy - y * fx;
                self.on_body(force_n);
            }
        }
    }

    /// A force on one body, N.
    fn on_body(&mut self, force_n: f64) {
        self.total_n += force_n;
        self.largest_n = self.largest_n.max(force_n);
    }
}

/// Everybody in the scene.
#[derive(Clone, Debug)]
pub(crate) struct People {
    bodies: Vec<Body>,
    /// They meet the cover on its foam; otherwise the engine's geoms meet.
    on_foam: bool,
    /// Simulation time at which the people's own time begins, s; `None` while they wait.
    begin_s: Option<f64>,
}

#[derive(Clone, Debug)]
struct Body {
    person: Person,
    /// First of two degrees of freedom, if the person can move.
    dof: Option<usize>,
    /// Memory of the contacts: the first is a cylinder's, which keeps it as it moves along the cover; a plane has one
    /// with each taxel.
    contacts: [ContactState; K],
    /// Walking has begun.
    walks: bool,
    /// In the last step.
    touches: bool,
    first_contact_s: Option<f64>,
    /// Outward normal at first contact, world axes: the way the person steps away.
    away_world: [f64; 2],
    /// All forces on the person at this step, world axes, N.
    force_world: [f64; 2],
}

/// Stage of a person's script.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Stage {
    /// The cover's foam, in the last step.
    touches: bool,
    /// Walks or leans.
    has_set_out: bool,
    steps_away: bool,
    has_stepped_away: bool,
}

/// One place where a body and the cover meet, axes of B.
struct Meeting {
    /// Which memory.
    contact: usize,
    /// Depth, m.
    overlap_m: f64,
    point_base: [f64; 2],
    /// Out of the cover, unit.
    outward_base: [f64; 2],
    /// Velocity of the body in W, m/s.
    velocity_world: [f64; 2],
    /// Part of the body's flesh that lies on it.
    part: f64,
}

impl Meeting {
    /// Speed at which the overlap grows, m/s.
    fn closing_m_s(&self, cover: &CoverInstant<'_>) -> f64 {
        let [vx, vy] = cover.to_base(self.velocity_world);
        let [cover_vx, cover_vy] = cover.velocity_base(self.point_base);
        let [nx, ny] = self.outward_base;
        (cover_vx - vx) * nx + (cover_vy - vy) * ny
    }

    /// Depth at the end of the step, m.
    fn overlap_at_end_m(&self, cover: &CoverInstant<'_>) -> f64 {
        let Step { dt_s, from_the_middle } = cover.step;
        let half_m = if from_the_middle { 0.5 * dt_s * self.closing_m_s(cover) } else { 0.0 };
        self.overlap_m + half_m
    }
}

impl People {
    /// `first_dof` is the first degree of freedom after the robot's.
    pub(crate) fn new(scene: &Scene, first_dof: usize) -> Self {
        let mut next_dof = first_dof;
        let bodies = scene.people.iter().map(|&person| {
            let dof = matches!(person.mobility, Mobility::Standing { .. }).then_some(next_dof);
            next_dof += if dof.is_some() { 2 } else { 0 };
            Body {
                person,
                dof,
                contacts: [ContactState::default(); K],
                walks: false,
                touches: false,
                first_contact_s: None,
                away_world: [0.0; 2],
                force_world: [0.0; 2],
            }
        });
        Self { bodies: bodies.collect(), on_foam: !scene.geoms, begin_s: Some(0.0) }
    }

    /// Sets when the people's own time begins.
    pub(crate) fn begin(&mut self, begin_s: Option<f64>) {
        self.begin_s = begin_s;
    }

    fn own_time_s(&self, time_s: f64) -> f64 {
        self.begin_s.map_or(0.0, |begin_s| time_s - begin_s)
    }

    pub(crate) fn position_world(&self, i: usize, time_s: f64, qpos: &[f64]) -> Option<[f64; 2]> {
        let body = self.bodies.get(i)?;
        let [x, y] = body.person.position_world;
        let [dx, dy] = body.displacement(self.own_time_s(time_s), qpos);
        Some([x + dx, y + dy])
    }

    /// Returns the stages of all people: forces change at once where a stage changes.
    pub(crate) fn stages(&self, time_s: f64) -> impl Iterator<Item = Stage> {
        let time_s = self.own_time_s(time_s);
        self.bodies.iter().map(move |body| body.stage(time_s))
    }

    /// Lets those begin to walk whose time has come, at full speed: a step that starts at `time_s` and takes its forces in
    /// its middle has to be told before.
    pub(crate) fn set_out(&mut self, time_s: f64, mechanics: &mut dyn Mechanics) {
        let time_s = self.own_time_s(time_s);
        for body in &mut self.bodies {
            let Person { starts_after_s, walk_m_s, towards_robot_world, .. } = body.person;
            if let (Some(dof), false) =
                (body.dof, body.walks || time_s < starts_after_s || self.begin_s.is_none())
            {
                body.walks = true;
                let place = [mechanics.positions()[dof], mechanics.positions()[dof + 1]];
                let rate = [mechanics.rates()[dof], mechanics.rates()[dof + 1]];
                let rate =
                    std::array::from_fn::<_, 2, _>(|axis| rate[axis] + walk_m_s * towards_robot_world[axis]);
                mechanics.put(dof, &place, &rate);
            }
        }
    }

    /// Contact, posture and lean of everybody; adds the contact forces to what is `felt`.
    pub(crate) fn touch(
        &mut self,
        cover: &CoverInstant<'_>,
        time_s: f64,
        qpos: &[f64],
        qvel: &[f64],
        felt: &mut Felt,
    ) {
        let time_s = self.own_time_s(time_s);
        for body in &mut self.bodies {
            (body.force_world, body.touches) = ([0.0; 2], false);
            if self.on_foam {
                body.press(cover, time_s, qpos, qvel, felt);
            }
            body.hold(time_s, cover.step, qpos, qvel);
        }
    }

    /// Writes the forces on those who can move.
    pub(crate) fn write_forces(&self, applied: &mut [f64]) {
        for body in &self.bodies {
            if let Some(dof) = body.dof {
                applied[dof..dof + 2].copy_from_slice(&body.force_world);
            }
        }
    }
}

impl Body {
    /// From the start, m, world axes.
    fn displacement(&self, time_s: f64, qpos: &[f64]) -> [f64; 2] {
        self.dof.map_or_else(|| self.anchor(time_s).0, |dof| [qpos[dof], qpos[dof + 1]])
    }

    /// m/s, world axes.
    fn velocity(&self, time_s: f64, qvel: &[f64]) -> [f64; 2] {
        self.dof.map_or_else(|| self.anchor(time_s).1, |dof| [qvel[dof], qvel[dof + 1]])
    }

    /// Contact with the whole cover.
    fn press(&mut self, cover: &CoverInstant<'_>, time_s: f64, qpos: &[f64], qvel: &[f64], felt: &mut Felt) {
        let [x, y] = self.person.position_world;
        let [dx, dy] = self.displacement(time_s, qpos);
        let [base_x, base_y, _] = cover.pose_world;
        let place_base = cover.to_base([x + dx - base_x, y + dy - base_y]);
        let velocity_world = self.velocity(time_s, qvel);
        match self.person.shape {
            Shape::Cylinder { radius_m }
                if self.person.plates < 2
                    && cover.outline.is_further_than(radius_m + cover.step.reach_m(), place_base) =>
            {
                self.contacts[0].leave(cover.foam, cover.step.dt_s);
            }
            Shape::Cylinder { radius_m } => {
                let nearest = cover.outline.nearest(place_base);
                let plates = self.person.plates;
                if plates > 1 {
                    let plates = cover.outline.plates(&nearest, plates);
                    if plates.iter().any(Option::is_some) {
                        self.press_flat(cover, (&nearest, &plates), radius_m, velocity_world, time_s, felt);
                        return;
                    }
                }
                let meeting = Meeting {
                    contact: 0,
                    overlap_m: radius_m - nearest.distance_m,
                    point_base: nearest.point_base,
                    outward_base: nearest.outward,
                    velocity_world,
                    part: 1.0,
                };
                let force_n = self.meet(cover, &meeting, time_s, felt);
                let overlap_m = meeting.overlap_at_end_m(cover);
                if force_n > 0.0 && overlap_m > 0.0 {
                    let shares = cover.outline.shares(&nearest, overlap_m, radius_m);
                    let taxels_n = felt.taxel_force_n[..cover.taxels.len()].iter_mut();
                    for (taxel_n, share) in taxels_n.zip(&shares.0) {
                        *taxel_n += share * force_n;
                    }
                    felt.on_body(force_n);
                }
            }
            Shape::Plane => {
                let mut all_n = 0.0;
                for taxel in 0..cover.taxels.len() {
                    if let Some(meeting) = self.plane_meeting(cover, place_base, velocity_world, taxel) {
                        let force_n = self.meet(cover, &meeting, time_s, felt);
                        felt.taxel_force_n[taxel] += force_n;
                        all_n += force_n;
                    }
                }
                felt.on_body(all_n);
            }
        }
    }

    /// Contact of a flat body with `plates`: it does not turn with the base, which presses one deeper than the other when it does.
    fn press_flat(
        &mut self,
        cover: &CoverInstant<'_>,
        (nearest, plates): (&Nearest, &[Option<[f64; 2]>; K]),
        radius_m: f64,
        velocity_world: [f64; 2],
        time_s: f64,
        felt: &mut Felt,
    ) {
        let [fx, fy] = cover.to_base(self.person.towards_robot_world);
        let [x, y] = nearest.point_base;
        #[expect(clippy::cast_precision_loss, reason = "three at most")]
        let part = 1.0 / plates.iter().flatten().count() as f64;
        let mut all_n = 0.0;
        for (taxel, plate) in plates.iter().enumerate().take(cover.taxels.len()) {
            let Some(point_base) = *plate else {
                self.contacts[taxel].leave(cover.foam, cover.step.dt_s);
                continue;
            };
            let tilted_m = (point_base[0] - x) * fx + (point_base[1] - y) * fy;
            let meeting = Meeting {
                contact: taxel,
                overlap_m: radius_m - nearest.distance_m - tilted_m,
                point_base,
                outward_base: nearest.outward,
                velocity_world,
                part,
            };
            let force_n = self.meet(cover, &meeting, time_s, felt);
            felt.taxel_force_n[taxel] += force_n;
            all_n += force_n;
        }
        felt.on_body(all_n);
    }

    /// The end of a taxel that is deepest in a plane, if the taxel faces it.
    fn plane_meeting(
        &self,
        cover: &CoverInstant<'_>,
        place_base: [f64; 2],
        velocity_world: [f64; 2],
        taxel: usize,
    ) -> Option<Meeting> {
        let outward_base = cover.outline.taxel_outward_base(taxel);
        let [nx, ny] = outward_base;
        let [fx, fy] = cover.to_base(self.person.towards_robot_world);
        if -(fx * nx + fy * ny) < FACING_COS_MIN {
            return None;
        }
        let depth = |[px, py]: [f64; 2]| -((px - place_base[0]) * fx + (py - place_base[1]) * fy);
        let [start, end] = cover.outline.ends(taxel)?;
        let point_base = if depth(start) >= depth(end) { start } else { end };
        Some(Meeting {
            contact: taxel,
            overlap_m: depth(point_base),
            point_base,
            outward_base,
            velocity_world,
            part: 1.0,
        })
    }

    /// Forces on both sides, equal and opposite; gives the one along the cover's normal, N.
    fn meet(&mut self, cover: &CoverInstant<'_>, meeting: &Meeting, time_s: f64, felt: &mut Felt) -> f64 {
        let &Meeting { contact, overlap_m, point_base: [px, py], outward_base: [nx, ny], .. } = meeting;
        let [vx, vy] = cover.to_base(meeting.velocity_world);
        let [cover_vx, cover_vy] = cover.velocity_base(meeting.point_base);
        let Step { dt_s, from_the_middle } = cover.step;
        let tissue = self.person.tissue;
        let pressing = Pressing {
            foam: cover.foam,
            tissue: Tissue {
                stiffness_n_per_m: meeting.part * tissue.stiffness_n_per_m,
                damping_n_s_per_m: meeting.part * tissue.damping_n_s_per_m,
            },
            friction: self.person.friction,
            overlap_m,
            sliding_m_s: (vy - cover_vy) * nx - (vx - cover_vx) * ny,
            dt_s,
            yield_m_per_n: self.person.mobility.yield_m_per_n(dt_s) / meeting.part,
        };
        let closing_m_s = meeting.closing_m_s(cover);
        let (mean, end) = if from_the_middle {
            self.contacts[contact].second_order(&pressing, closing_m_s)
        } else {
            let force = self.contacts[contact].step(&pressing);
            (force, force)
        };
        if mean.normal_n <= 0.0 && end.normal_n <= 0.0 {
            return 0.0;
        }
        // Along the cover is the outward normal turned by +90°.
        let on_body = |force: ContactForce| {
            [force.normal_n * nx - force.along_n * ny, force.normal_n * ny + force.along_n * nx]
        };
        for (wrench, force) in [(&mut felt.wrench_base, end), (&mut felt.push_base, mean)] {
            let [fx, fy] = on_body(force);
            wrench[0] -= fx;
            wrench[1] -= fy;
            wrench[2] -= px * fy - py * fx;
        }
        let [on_x, on_y] = cover.to_world(on_body(mean));
        self.force_world[0] += on_x;
        self.force_world[1] += on_y;
        self.touches = true;
        if self.first_contact_s.is_none() {
            let touched_for_s =
                if from_the_middle && closing_m_s > 0.0 { overlap_m / closing_m_s } else { 0.0 };
            self.first_contact_s = Some(time_s - touched_for_s.clamp(-0.5 * dt_s, 0.5 * dt_s));
            self.away_world = cover.to_world([nx, ny]);
        }
        end.normal_n
    }

    /// Adds posture and lean of a person who can move. Who begins to walk walks at full speed from the first step on.
    fn hold(&mut self, time_s: f64, step: Step, qpos: &[f64], qvel: &[f64]) {
        let (Some(dof), Mobility::Standing { mass_kg, stiffness_n_per_m, damping_n_s_per_m }) =
            (self.dof, self.person.mobility)
        else {
            return;
        };
        let offset = self.displacement(time_s, qpos);
        let (anchor, mut anchor_velocity) = self.anchor(time_s);
        if step.from_the_middle {
            // on average over the step, in which a stride may begin or end
            let [start, end] = [-0.5, 0.5].map(|share| self.anchor(time_s + share * step.dt_s).0);
            anchor_velocity = std::array::from_fn(|axis| (end[axis] - start[axis]) / step.dt_s);
        }
        let leans = time_s >= self.person.starts_after_s && self.stepping_s(time_s) <= 0.0;
        let lean_n = if leans { self.person.lean_n } else { 0.0 };
        let starts = !self.walks && !step.from_the_middle && time_s > self.person.starts_after_s;
        self.walks |= starts;
        let start_n = if starts { mass_kg * self.person.walk_m_s / step.dt_s } else { 0.0 };
        for axis in 0..2 {
            self.force_world[axis] += (lean_n + start_n) * self.person.towards_robot_world[axis]
                + stiffness_n_per_m * (anchor[axis] - offset[axis])
                + damping_n_s_per_m * (anchor_velocity[axis] - qvel[dof + axis]);
            if step.from_the_middle {
                // half of the damping acts on the speed at the step's end: the trapezoidal rule
                self.force_world[axis] /= 1.0 + 0.5 * step.dt_s * damping_n_s_per_m / mass_kg;
            }
        }
    }

    /// Time since the step away began, s; not positive before.
    fn stepping_s(&self, time_s: f64) -> f64 {
        match (self.first_contact_s, self.person.steps_away_after_s) {
            (Some(contact_s), Some(after_s)) => time_s - contact_s - after_s,
            _ => 0.0,
        }
    }

    fn stage(&self, time_s: f64) -> Stage {
        let (step_speed, step_length) = Person::STEP_AWAY;
        let stepping_s = self.stepping_s(time_s);
        Stage {
            touches: self.touches,
            has_set_out: time_s >= self.person.starts_after_s,
            steps_away: stepping_s > 0.0,
            has_stepped_away: step_speed * stepping_s >= step_length,
        }
    }

    /// Returns the target of the posture: displacement from the start, m, and its velocity, m/s, in W.
    fn anchor(&self, time_s: f64) -> ([f64; 2], [f64; 2]) {
        let walked_s = (time_s - self.person.starts_after_s).max(0.0);
        let speed = if walked_s > 0.0 { self.person.walk_m_s } else { 0.0 };
        let [tx, ty] = self.person.towards_robot_world;
        let mut position = [tx * speed * walked_s, ty * speed * walked_s];
        let mut velocity = [tx * speed, ty * speed];
        let (step_speed, step_length) = Person::STEP_AWAY;
        let stride = (step_speed * self.stepping_s(time_s).max(0.0)).min(step_length);
        let moving = if stride > 0.0 && stride < step_length { step_speed } else { 0.0 };
        for axis in 0..2 {
            position[axis] += stride * self.away_world[axis];
            velocity[axis] += moving * self.away_world[axis];
        }
        (position, velocity)
    }
}
