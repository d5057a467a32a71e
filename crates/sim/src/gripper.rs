//! Two fingers on the flange and a cube that they can grasp, lift, drop and lose: a quasi-static model, once per control period.
//!
//! The fingers move at the speed that was asked for and stop at the cube. Held, the cube is a load on the flange, the same on both
//! engines. It follows the hand while its tangential load, m·|a - g| across the closing direction, is within the friction of two
//! fingers, 2·μ·F; beyond it slides with Coulomb friction, and is lost where the middle of the fingers leaves its face. Left alone
//! it falls, onto the support on which it stood or onto the floor; held, it meets neither.

use moca_msgs::gripper::{FRANKA_HAND, GripperTable, RELEASE_M_S};
use moca_msgs::robot::LinkInertial;
use moca_msgs::{GripperFault, GripperPhase, GripperRefusal, GripperRequest, GripperState, TrueObject};
use moca_wbc::nalgebra::Matrix3;

/// Free fall, m/s².
const GRAVITY_WORLD: [f64; 3] = [0.0, 0.0, -9.81];

/// Pose of the flange in the world.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct FlangePose {
    /// Origin, m.
    pub(crate) position_world: [f64; 3],
    /// Axes, row by row.
    pub(crate) axes_world: [[f64; 3]; 3],
}

impl FlangePose {
    /// Axes as columns.
    pub(crate) fn axes(&self) -> Matrix3<f64> {
        Matrix3::from_fn(|row, column| self.axes_world[row][column])
    }

    fn vector_world(&self, flange: &[f64; 3]) -> [f64; 3] {
        self.axes_world.map(|row| dot(&row, flange))
    }

    fn vector_flange(&self, world: &[f64; 3]) -> [f64; 3] {
        std::array::from_fn(|column| (0..3).map(|row| self.axes_world[row][column] * world[row]).sum())
    }

    fn point_world(&self, flange: &[f64; 3]) -> [f64; 3] {
        plus(&self.position_world, 1.0, &self.vector_world(flange))
    }
}

fn dot(a: &[f64; 3], b: &[f64; 3]) -> f64 {
    a.iter().zip(b).map(|(a, b)| a * b).sum()
}

fn norm(a: &[f64; 3]) -> f64 {
    dot(a, a).sqrt()
}

/// Returns a + k·b.
fn plus(a: &[f64; 3], k: f64, b: &[f64; 3]) -> [f64; 3] {
    std::array::from_fn(|i| a[i] + k * b[i])
}

/// Returns the part of `v` across the unit vector `axis`.
fn across(v: &[f64; 3], axis: &[f64; 3]) -> [f64; 3] {
    plus(v, -dot(v, axis), axis)
}

/// Motion of the fingers.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Motion {
    /// None.
    Rest,
    /// To a width.
    To { width_m: f64, speed_m_s: f64 },
    /// Until they meet the cube or each other.
    Close { asked_m: f64, tolerance_m: f64, grip: Grip },
    /// Open, close, open; how many of them are done.
    Home { done: usize },
}

/// Hold of the fingers on the cube.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Grip {
    force_n: f64,
    speed_m_s: f64,
}

/// Place of the cube.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Place {
    /// It stands with its centre there, m.
    Standing { position_world: [f64; 3] },
    /// Between the fingers: its centre, m, and its velocity relative to the hand, m/s.
    Held { position_flange: [f64; 3], sliding_world: [f64; 3] },
    /// It falls: m, m/s.
    Falling { position_world: [f64; 3], velocity_world: [f64; 3] },
}

/// A simulated gripper and the cube.
#[derive(Clone, Debug)]
pub(crate) struct Gripper {
    table: GripperTable,
    object: TrueObject,
    period_s: f64,
    width_m: f64,
    motion: Motion,
    grip: Option<Grip>,
    holding: bool,
    fault: Option<GripperFault>,
    requests: u32,
    /// Mass that the last grasp told, kg.
    told_kg: f64,
    /// Place of the cube; `None` without one.
    place: Option<Place>,
    /// Centre of the cube where its support stands, m.
    support_world: [f64; 3],
    /// Pose of the flange, position of the fingertips, m, and their velocity, m/s, in the last period.
    last: (FlangePose, [f64; 3], [f64; 3]),
    plugged: bool,
}

impl Gripper {
    /// Opens the fingers of a hand on a flange at rest. A cube of which no place is given is between them.
    pub(crate) fn new(object: &TrueObject, flange: &FlangePose, period_s: f64) -> Self {
        let table = FRANKA_HAND;
        let tip_world = flange.point_world(&table.tip_flange_m);
        let given = object.position_world_m.iter().any(|coordinate| coordinate.abs() > 0.0);
        let position_world = if given { object.position_world_m } else { tip_world };
        Self {
            table,
            object: *object,
            period_s,
            width_m: table.width_max_m,
            motion: Motion::Rest,
            grip: None,
            holding: false,
            fault: None,
            requests: 0,
            told_kg: 0.0,
            place: (object.mass_kg > 0.0).then_some(Place::Standing { position_world }),
            support_world: position_world,
            last: (*flange, tip_world, [0.0; 3]),
            plugged: true,
        }
    }

    /// Takes a request.
    ///
    /// # Errors
    /// A number out of range, or a hand that is unplugged.
    pub(crate) fn request(&mut self, request: &GripperRequest) -> Result<(), GripperRefusal> {
        if !self.plugged {
            return Err(GripperRefusal::Silent);
        }
        request.check(&self.table)?;
        self.motion = match *request {
            GripperRequest::Home => Motion::Home { done: 0 },
            GripperRequest::Move { width_m, speed_m_s } => Motion::To { width_m, speed_m_s },
            GripperRequest::Grasp { width_m, speed_m_s, force_n, tolerance_m, mass_kg } => {
                self.told_kg = mass_kg;
                Motion::Close { asked_m: width_m, tolerance_m, grip: Grip { force_n, speed_m_s } }
            }
            GripperRequest::Release => Motion::To { width_m: self.table.width_max_m, speed_m_s: RELEASE_M_S },
            GripperRequest::Stop => Motion::Rest,
        };
        self.fault = None;
        self.requests += 1;
        Ok(())
    }

    /// Pulls the hand's plug: the fingers stay as they are, and nobody hears of them.
    pub(crate) const fn unplug(&mut self) {
        self.plugged = false;
    }

    /// Returns what the hand reports.
    pub(crate) fn state(&self) -> GripperState {
        let phase = match self.motion {
            _ if !self.plugged => GripperPhase::Unknown,
            Motion::Rest if self.holding => GripperPhase::Holding,
            Motion::Rest => GripperPhase::Resting,
            _ => GripperPhase::Moving,
        };
        GripperState {
            width_m: self.width_m,
            width_max_m: self.table.width_max_m,
            phase,
            requests: self.requests,
            fault: if self.plugged { self.fault } else { Some(GripperFault::Unplugged) },
            object_kg: if self.holding { self.told_kg } else { 0.0 },
            object_flange_m: self.table.tip_flange_m,
        }
    }

    /// Returns the centre of the cube, m.
    pub(crate) fn object_position_world(&self) -> Option<[f64; 3]> {
        self.place.map(|place| match place {
            Place::Standing { position_world } | Place::Falling { position_world, .. } => position_world,
            Place::Held { position_flange, .. } => self.last.0.point_world(&position_flange),
        })
    }

    /// Returns what hangs on the flange.
    pub(crate) const fn load(&self) -> LinkInertial {
        match self.place {
            Some(Place::Held { position_flange, .. }) => self.object.at(position_flange),
            _ => TrueObject::NONE.at([0.0; 3]),
        }
    }

    /// Starts with the flange at rest there, after somebody put the robot elsewhere.
    pub(crate) fn put(&mut self, flange: &FlangePose) {
        self.last = (*flange, flange.point_world(&self.table.tip_flange_m), [0.0; 3]);
    }

    /// One control period, with the flange there at its start.
    pub(crate) fn advance(&mut self, flange: &FlangePose) {
        let tip_world = flange.point_world(&self.table.tip_flange_m);
        let (_, last_tip_world, last_velocity_world) = self.last;
        let per_s = 1.0 / self.period_s;
        let velocity_world = plus(&tip_world, -1.0, &last_tip_world).map(|way| way * per_s);
        let acceleration_world =
            plus(&velocity_world, -1.0, &last_velocity_world).map(|change| change * per_s);
        self.last = (*flange, tip_world, velocity_world);
        self.move_fingers();
        match self.place {
            Some(Place::Held { position_flange, sliding_world }) => {
                self.carry(position_flange, sliding_world, acceleration_world);
            }
            Some(Place::Falling { position_world, velocity_world }) => {
                self.place = Some(self.fall(position_world, velocity_world));
            }
            Some(Place::Standing { .. }) | None => {}
        }
    }

    /// Moves the fingers by one period, and stops them at their width or at the cube.
    fn move_fingers(&mut self) {
        let widest_m = self.table.width_max_m;
        let (target_m, speed_m_s) = match self.motion {
            Motion::Rest => return,
            Motion::To { width_m, speed_m_s } => (width_m, speed_m_s),
            Motion::Close { grip, .. } => (0.0, grip.speed_m_s),
            Motion::Home { done: 1 } => (0.0, RELEASE_M_S),
            Motion::Home { .. } => (widest_m, RELEASE_M_S),
        };
        let step_m = speed_m_s * self.period_s;
        let width_m = self.width_m + (target_m - self.width_m).clamp(-step_m, step_m);
        let blocked = self.is_between() && width_m < self.object.size_m;
        self.width_m = if blocked { self.object.size_m } else { width_m };
        if self.width_m > self.object.size_m {
            self.let_go();
        }
        if blocked || (self.width_m - target_m).abs() <= 0.0 {
            self.finish(blocked);
        }
    }

    /// Ends a motion at its width, or at the cube.
    fn finish(&mut self, blocked: bool) {
        match std::mem::replace(&mut self.motion, Motion::Rest) {
            Motion::Close { asked_m, tolerance_m, grip } => {
                self.fault = GripperFault::of_grasp(asked_m, tolerance_m, self.width_m);
                self.holding = blocked && self.fault.is_none();
                self.grip = blocked.then_some(grip);
                if blocked {
                    self.take_hold();
                }
            }
            _ if blocked => self.fault = Some(GripperFault::Blocked),
            Motion::Home { done } if done < 2 => self.motion = Motion::Home { done: done + 1 },
            Motion::Home { .. } | Motion::To { .. } | Motion::Rest => {}
        }
    }

    /// Returns true if the fingers would meet the cube when they close.
    fn is_between(&self) -> bool {
        let Some(Place::Standing { position_world }) = self.place else {
            return matches!(self.place, Some(Place::Held { .. }));
        };
        let away = plus(
            &self.last.0.vector_flange(&plus(&position_world, -1.0, &self.last.0.position_world)),
            -1.0,
            &self.table.tip_flange_m,
        );
        let along_m = dot(&away, &self.table.closing_flange).abs();
        let fits = self.width_m >= self.object.size_m && along_m < 0.5 * self.width_m;
        fits && self.is_on_face(&away)
    }

    /// Returns true if the middle of the fingers is on a face of the cube that is `away_flange` from it, m.
    fn is_on_face(&self, away_flange: &[f64; 3]) -> bool {
        norm(&across(away_flange, &self.table.closing_flange)) <= 0.5 * self.object.size_m
    }

    /// The fingers push the cube into their middle.
    fn take_hold(&mut self) {
        if let Some(Place::Standing { position_world }) = self.place {
            let (flange, tip, axis) = (&self.last.0, &self.table.tip_flange_m, &self.table.closing_flange);
            let at = flange.vector_flange(&plus(&position_world, -1.0, &flange.position_world));
            let position_flange = plus(tip, 1.0, &across(&plus(&at, -1.0, tip), axis));
            self.place = Some(Place::Held { position_flange, sliding_world: [0.0; 3] });
        }
    }

    /// The fingers leave the cube: it falls with the speed that it has.
    fn let_go(&mut self) {
        (self.grip, self.holding) = (None, false);
        if let Some(Place::Held { position_flange, sliding_world }) = self.place {
            let (flange, _, velocity_world) = &self.last;
            self.place = Some(Place::Falling {
                position_world: flange.point_world(&position_flange),
                velocity_world: plus(velocity_world, 1.0, &sliding_world),
            });
        }
    }

    /// Coulomb friction: it takes as much of the sliding as its limit allows.
    fn carry(&mut self, position_flange: [f64; 3], sliding_world: [f64; 3], acceleration_world: [f64; 3]) {
        let Some(grip) = self.grip else { return };
        let axis_world = self.last.0.vector_world(&self.table.closing_flange);
        let needed_world = across(&plus(&acceleration_world, -1.0, &GRAVITY_WORLD), &axis_world);
        let friction_m_s = 2.0 * self.object.friction * grip.force_n / self.object.mass_kg * self.period_s;
        let free_world = plus(&across(&sliding_world, &axis_world), -self.period_s, &needed_world);
        let speed_m_s = norm(&free_world);
        let left = if speed_m_s > friction_m_s { 1.0 - friction_m_s / speed_m_s } else { 0.0 };
        let sliding_world = free_world.map(|speed| left * speed);
        let slid = self.last.0.vector_flange(&sliding_world);
        let position_flange = plus(&position_flange, self.period_s, &slid);
        self.place = Some(Place::Held { position_flange, sliding_world });
        if !self.is_on_face(&plus(&position_flange, -1.0, &self.table.tip_flange_m)) {
            let was_held = self.holding;
            self.let_go();
            self.motion = Motion::To { width_m: 0.0, speed_m_s: grip.speed_m_s };
            if was_held {
                self.fault = Some(GripperFault::Lost);
            }
        }
    }

    /// One period of free fall, onto the support on which the cube stood at the start or onto the floor.
    fn fall(&self, position_world: [f64; 3], velocity_world: [f64; 3]) -> Place {
        let velocity_world = plus(&velocity_world, self.period_s, &GRAVITY_WORLD);
        let next = plus(&position_world, self.period_s, &velocity_world);
        let half_m = 0.5 * self.object.size_m;
        let [away_x, away_y, above] = plus(&position_world, -1.0, &self.support_world);
        let supported = away_x.abs() <= half_m && away_y.abs() <= half_m && above > -half_m;
        let ground_m = if supported { self.support_world[2] } else { half_m };
        if next[2] > ground_m {
            return Place::Falling { position_world: next, velocity_world };
        }
        Place::Standing { position_world: [next[0], next[1], ground_m] }
    }
}
