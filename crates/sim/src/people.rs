//! People and walls in the running scene: where they are, what they do, and what they and the cover do to each other.

use crate::contact::{ContactState, Zones};
use crate::foam::Foam;
use crate::scene::{Mobility, Person, Shape};
use moca_msgs::robot::PAPER_COVER;

const K: usize = PAPER_COVER.len();
/// A plane presses a taxel only if it faces it within 60°.
const FACING_COS_MIN: f64 = 0.5;

/// The cover at one instant.
pub(crate) struct Cover<'a> {
    pub zones: &'a Zones<K>,
    pub foam: &'a Foam,
    /// Physics step, s.
    pub dt_s: f64,
    /// Pose of B in W: x m, y m, yaw rad.
    pub pose_world: [f64; 3],
}

impl Cover<'_> {
    /// A vector of W in the axes of B, and the other way.
    fn to_base(&self, [x, y]: [f64; 2]) -> [f64; 2] {
        let (sin, cos) = self.pose_world[2].sin_cos();
        [cos * x + sin * y, -sin * x + cos * y]
    }

    /// Place in B, m, `offset_m` along the panel from a taxel's centre.
    fn on_panel(&self, taxel: usize, offset_m: f64) -> [f64; 2] {
        let [nx, ny] = self.zones.outward(taxel);
        let [x, y] = self.zones.position_base(taxel);
        [x - offset_m * ny, y + offset_m * nx]
    }

    fn to_world(&self, [x, y]: [f64; 2]) -> [f64; 2] {
        let (sin, cos) = self.pose_world[2].sin_cos();
        [cos * x - sin * y, sin * x + cos * y]
    }
}

/// Everybody in the scene.
#[derive(Clone, Debug)]
pub(crate) struct People {
    bodies: Vec<Body>,
    /// Simulation time at which the people's own time begins, s; `None` while they wait.
    begin_s: Option<f64>,
}

#[derive(Clone, Debug)]
struct Body {
    person: Person,
    /// First of two degrees of freedom, if the person can move.
    dof: Option<usize>,
    /// Memory of the contact with each taxel.
    contacts: [ContactState; K],
    /// Taxel before a cylinder.
    zone: Option<usize>,
    first_contact_s: Option<f64>,
    /// Outward normal at first contact, world axes: the way the person steps away.
    away_world: [f64; 2],
    /// All forces on the person at this step, world axes, N.
    force_world: [f64; 2],
}

/// One place where a body and a taxel meet: depth m, place in B m.
struct Meeting {
    taxel: usize,
    overlap_m: f64,
    point_base: [f64; 2],
}

impl People {
    /// `first_dof` is the first degree of freedom after the robot's.
    pub(crate) fn new(people: &[Person], first_dof: usize) -> Self {
        let mut next_dof = first_dof;
        let bodies = people.iter().map(|&person| {
            let dof = matches!(person.mobility, Mobility::Standing { .. }).then_some(next_dof);
            next_dof += if dof.is_some() { 2 } else { 0 };
            Body {
                person,
                dof,
                contacts: [ContactState::default(); K],
                zone: None,
                first_contact_s: None,
                away_world: [0.0; 2],
                force_world: [0.0; 2],
            }
        });
        Self { bodies: bodies.collect(), begin_s: Some(0.0) }
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

    /// Contact, posture and lean of everybody; adds the contact forces to the taxels, N, and to `base_wrench`, the
    /// wrench on the base in axes of B about its origin.
    pub(crate) fn touch(
        &mut self,
        cover: &Cover<'_>,
        time_s: f64,
        qpos: &[f64],
        qvel: &[f64],
        taxel_force_n: &mut [f64; K],
        base_wrench: &mut [f64; 3],
    ) {
        let time_s = self.own_time_s(time_s);
        for body in &mut self.bodies {
            let offset = body.displacement(time_s, qpos);
            body.force_world = [0.0; 2];
            body.press(cover, offset, time_s, taxel_force_n, base_wrench);
            body.hold(time_s, offset, qvel);
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

    /// Contact with all taxels.
    fn press(
        &mut self,
        cover: &Cover<'_>,
        offset: [f64; 2],
        time_s: f64,
        taxel_force_n: &mut [f64; K],
        base_wrench: &mut [f64; 3],
    ) {
        let [x, y] = self.person.position_world;
        let [base_x, base_y, _] = cover.pose_world;
        let place_base = cover.to_base([x + offset[0] - base_x, y + offset[1] - base_y]);
        match self.person.shape {
            Shape::Cylinder { radius_m } => {
                let zone = cover.zones.find(place_base, 2.0 * radius_m + 0.1);
                if self.zone != zone.map(|zone| zone.taxel) {
                    self.zone = zone.map(|zone| zone.taxel);
                    self.contacts = [ContactState::default(); K];
                }
                if let Some(zone) = zone {
                    let point_base = cover.on_panel(zone.taxel, zone.offset_m);
                    let meeting =
                        Meeting { taxel: zone.taxel, overlap_m: radius_m - zone.distance_m, point_base };
                    self.meet(cover, &meeting, time_s, taxel_force_n, base_wrench);
                }
            }
            Shape::Plane => {
                for taxel in 0..K {
                    if let Some(meeting) = self.plane_meeting(cover, place_base, taxel) {
                        self.meet(cover, &meeting, time_s, taxel_force_n, base_wrench);
                    }
                }
            }
        }
    }

    /// The corner of a taxel that is deepest in a plane, if the taxel faces it.
    fn plane_meeting(&self, cover: &Cover<'_>, place_base: [f64; 2], taxel: usize) -> Option<Meeting> {
        let [nx, ny] = cover.zones.outward(taxel);
        let [fx, fy] = cover.to_base(self.person.towards_robot_world);
        if -(fx * nx + fy * ny) < FACING_COS_MIN {
            return None;
        }
        let half = cover.zones.half_width_m(taxel);
        let depth = |[px, py]: [f64; 2]| -((px - place_base[0]) * fx + (py - place_base[1]) * fy);
        let ends = [cover.on_panel(taxel, -half), cover.on_panel(taxel, half)];
        let point_base = if depth(ends[0]) >= depth(ends[1]) { ends[0] } else { ends[1] };
        Some(Meeting { taxel, overlap_m: depth(point_base), point_base })
    }

    /// Contact forces on both sides: equal, opposite, along the taxel's normal.
    fn meet(
        &mut self,
        cover: &Cover<'_>,
        meeting: &Meeting,
        time_s: f64,
        taxel_force_n: &mut [f64; K],
        base_wrench: &mut [f64; 3],
    ) {
        let &Meeting { taxel, overlap_m, point_base: [px, py] } = meeting;
        let force_n = self.contacts[taxel].step(cover.foam, self.person.tissue, overlap_m, cover.dt_s);
        if force_n <= 0.0 {
            return;
        }
        let [nx, ny] = cover.zones.outward(taxel);
        taxel_force_n[taxel] += force_n;
        base_wrench[0] -= force_n * nx;
        base_wrench[1] -= force_n * ny;
        base_wrench[2] -= force_n * (px * ny - py * nx);
        let away = cover.to_world([nx, ny]);
        self.force_world[0] += force_n * away[0];
        self.force_world[1] += force_n * away[1];
        if self.first_contact_s.is_none() {
            self.first_contact_s = Some(time_s);
            self.away_world = away;
        }
    }

    /// Adds posture and lean of a person who can move.
    fn hold(&mut self, time_s: f64, offset: [f64; 2], qvel: &[f64]) {
        let (Some(dof), Mobility::Standing { stiffness_n_per_m, damping_n_s_per_m, .. }) =
            (self.dof, self.person.mobility)
        else {
            return;
        };
        let (anchor, anchor_velocity) = self.anchor(time_s);
        let leans = time_s >= self.person.starts_after_s && self.stepping_s(time_s) <= 0.0;
        let lean_n = if leans { self.person.lean_n } else { 0.0 };
        for axis in 0..2 {
            self.force_world[axis] += lean_n * self.person.towards_robot_world[axis]
                + stiffness_n_per_m * (anchor[axis] - offset[axis])
                + damping_n_s_per_m * (anchor_velocity[axis] - qvel[dof + axis]);
        }
    }

    /// Time since the step away began, s; not positive before.
    fn stepping_s(&self, time_s: f64) -> f64 {
        match (self.first_contact_s, self.person.steps_away_after_s) {
            (Some(contact_s), Some(after_s)) => time_s - contact_s - after_s,
            _ => 0.0,
        }
    }

    /// Where the posture wants to be: displacement from the start, m, and its velocity, m/s, in W.
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
