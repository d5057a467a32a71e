//! A scene as data. The model, its joints and the forces that are computed each step follow from it.

use crate::base_link::BaseLink;
use crate::contact::Tissue;
use crate::error::{SimError, within};
use crate::flange_sensor::FlangeSensor;
use crate::foam::Foam;
use crate::joint_friction;
use moca_msgs::robot::{AnyArm, BaseTable, LinkCapsule, Mount, Payload, TaxelPlacement};
use moca_msgs::{MAX_JOINTS, MAX_TAXELS, TrueArm, TrueBase, TrueFlangeSensor, TrueObject};

/// Which parts of the robot exist.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Robot {
    /// The arm on its mobile base.
    #[default]
    MobileManipulator,
    /// The base and its cover; the arm's mass is missing.
    BaseOnly,
    /// The arm on a fixed stand where the base would carry it.
    ArmOnly,
}

/// Physics step: MuJoCo's integrators, and one of second order around them.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Integrator {
    /// Semi-implicit Euler, joint damping implicit. Nothing here damps but joints, so that it is [`Integrator::ImplicitFast`]
    /// to the digit.
    Euler,
    /// Fourth-order Runge–Kutta, everything explicit.
    RungeKutta4,
    /// All velocity derivatives implicit.
    Implicit,
    /// Velocity derivatives without Coriolis terms implicit: the cheapest that is accurate enough in free motion and in
    /// contact (`moca-lab precision`).
    #[default]
    ImplicitFast,
    /// Drift–kick–drift: forces in the middle of the step, damping of servo and postures by the trapezoidal rule, foam by an
    /// L-stable Runge–Kutta method of two stages. Second order at one evaluation a step (`tests/second_order.rs`); what the cover
    /// feels is then the force at the end of the step, not the one at its start.
    Leapfrog,
}

/// Engine that integrates the bodies of a scene.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Engine {
    /// MuJoCo: the reference, and the only one for parts of a robot, other integrators and bodies that meet as geoms.
    #[default]
    MuJoCo,
    /// Base and arm by the model of `moca-wbc`, people as masses: for scenes in which no two rigid bodies meet, at a
    /// fraction of the time. The step is the same to rounding (`tests/engines.rs`).
    Analytic,
}

impl Engine {
    /// Returns the name of the engine, and the reason why a scene runs on it.
    pub const fn reason(self) -> &'static str {
        match self {
            Self::MuJoCo => "MuJoCo: the reference for whatever a scene holds",
            Self::Analytic => "analytic: base, arm and people move, and no two rigid bodies meet",
        }
    }
}

/// Motion of a person who is pushed.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Mobility {
    /// Does not move at all: a wall, or a person held against one.
    Fixed,
    /// A planar mass that a spring and a damper hold to its posture.
    Standing {
        /// Mass, kg.
        mass_kg: f64,
        /// Posture stiffness, N/m.
        stiffness_n_per_m: f64,
        /// Posture damping, N·s/m.
        damping_n_s_per_m: f64,
    },
}

/// Outline that meets the cover.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Shape {
    /// An upright cylinder of this radius, m.
    Cylinder {
        /// m.
        radius_m: f64,
    },
    /// An upright plane through the position, its face towards the robot.
    Plane,
}

/// Body next to the robot.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum BodyPart {
    /// A leg, the collision scene's: 75 kg (ISO/TS 15066), 50 N/mm, 0.07 m.
    #[default]
    Leg,
    /// A thigh: 75 kg and 50 N/mm (ISO/TS 15066), 0.09 m.
    Thigh,
    /// A hand on a loose arm: 0.6 kg and 75 N/mm (ISO/TS 15066), 0.03 m.
    Hand,
    /// A wall: a plane of 10 000 N/mm that does not move.
    Wall,
}

impl BodyPart {
    /// Outline, tissue and how it yields. Masses and spring constants after ISO/TS 15066, the rest ASSUMED.
    pub const fn data(self) -> (Shape, Tissue, Mobility) {
        let (radius_m, stiffness_n_per_m, mass_kg, posture_damping) = match self {
            Self::Leg => (0.07, 50_000.0, 75.0, 300.0),
            Self::Thigh => (0.09, 50_000.0, 75.0, 300.0),
            Self::Hand => (0.03, 75_000.0, 0.6, 30.0),
            Self::Wall => {
                let hard = Tissue { stiffness_n_per_m: 1e7, damping_n_s_per_m: 0.0 };
                return (Shape::Plane, hard, Mobility::Fixed);
            }
        };
        let mobility =
            Mobility::Standing { mass_kg, stiffness_n_per_m: 800.0, damping_n_s_per_m: posture_damping };
        (Shape::Cylinder { radius_m }, Tissue { stiffness_n_per_m, damping_n_s_per_m: 0.0 }, mobility)
    }
}

impl Mobility {
    /// Way in which a body's own reaction to a force moves it within a step of `dt_s`, m/N; 0 for one that cannot move.
    pub fn yield_m_per_n(self, dt_s: f64) -> f64 {
        match self {
            Self::Standing { mass_kg, .. } => dt_s * dt_s / mass_kg,
            Self::Fixed => 0.0,
        }
    }
}

/// Somebody, or a wall, that can touch the cover.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Person {
    /// Centre (a point of a plane) at the start in W: x, y m.
    pub position_world: [f64; 2],
    /// Unit vector from here to the robot: the way the person walks and leans, and a plane faces.
    pub towards_robot_world: [f64; 2],
    /// Outline.
    pub shape: Shape,
    /// Flesh, in series with the foam.
    pub tissue: Tissue,
    /// Coulomb coefficient between clothes or skin and the cover.
    pub friction: f64,
    /// Motion of the person when pushed.
    pub mobility: Mobility,
    /// When walking and leaning begin, s.
    pub starts_after_s: f64,
    /// Speed of the posture's anchor towards the robot, m/s: 0 stands, more walks.
    pub walk_m_s: f64,
    /// Plates that a cylinder presses at once, each by all of its depth there: a flat body on rigid plates side by side, which does not turn
    /// with the base. One is a body that the plates share, 1 to 3.
    pub plates: u8,
    /// Weight leant towards the robot until the step away, N; nothing for a fixed body.
    pub lean_n: f64,
    /// Time after first contact at which the person steps away from the robot, s; `None` never.
    pub steps_away_after_s: Option<f64>,
}

impl Person {
    /// Speed and length of the step away, m/s and m. ASSUMED.
    pub const STEP_AWAY: (f64, f64) = (1.0, 3.0);
    /// Coulomb coefficient of clothes on the cover's foam. ASSUMED.
    pub const FRICTION: f64 = 0.4;

    /// The collision scene's person, `gap_m` in front of taxel `taxel` (0 is T1) of a robot with this cover at the
    /// world's origin, who steps away 1.5 s after first contact.
    pub fn beside(cover: &[TaxelPlacement], taxel: usize, gap_m: f64) -> Option<Self> {
        Some(Self { steps_away_after_s: Some(1.5), ..Self::part(BodyPart::Leg, cover, taxel, gap_m, 0.0)? })
    }

    /// A body part `gap_m` in front of taxel `taxel` (0 is T1), `offset_m` along the panel (the outward normal turned
    /// by +90°) from the taxel's centre, of a robot at the world's origin; it stands there and stays.
    pub fn part(
        part: BodyPart,
        cover: &[TaxelPlacement],
        taxel: usize,
        gap_m: f64,
        offset_m: f64,
    ) -> Option<Self> {
        let (shape, tissue, mobility) = part.data();
        Self::before(cover, taxel, gap_m, offset_m, shape, tissue, mobility)
    }

    /// Returns a person with an outline, tissue and mobility of its own.
    pub fn before(
        cover: &[TaxelPlacement],
        taxel: usize,
        gap_m: f64,
        offset_m: f64,
        shape: Shape,
        tissue: Tissue,
        mobility: Mobility,
    ) -> Option<Self> {
        let placement = cover.get(taxel)?;
        let (sin, cos) = placement.inward_angle_base_rad.sin_cos();
        let [x, y] = placement.position_base_m;
        let radius_m = match shape {
            Shape::Cylinder { radius_m } => radius_m,
            Shape::Plane => 0.0,
        };
        let away = radius_m + gap_m;
        Some(Self {
            position_world: [x - away * cos + offset_m * sin, y - away * sin - offset_m * cos],
            towards_robot_world: [cos, sin],
            shape,
            tissue,
            friction: Self::FRICTION,
            mobility,
            starts_after_s: 0.0,
            walk_m_s: 0.0,
            plates: 1,
            lean_n: 0.0,
            steps_away_after_s: None,
        })
    }

    fn check(&self) -> Result<(), SimError> {
        within("person.position_world", "m", &self.position_world, -1e3, 1e3)?;
        within("person.towards_robot", "", &self.towards_robot_world, -1.0, 1.0)?;
        if let Shape::Cylinder { radius_m } = self.shape {
            within("person.radius", "m", &[radius_m], 0.005, 1e3)?;
        }
        within("person.stiffness", "N/m", &[self.tissue.stiffness_n_per_m], 1.0, 1e9)?;
        within("person.damping", "N·s/m", &[self.tissue.damping_n_s_per_m], 0.0, 1e5)?;
        within("person.friction", "", &[self.friction], 0.0, 2.0)?;
        within("person.starts_after", "s", &[self.starts_after_s], 0.0, 1e6)?;
        within("person.walk", "m/s", &[self.walk_m_s], -5.0, 5.0)?;
        within("person.lean", "N", &[self.lean_n], 0.0, 1e3)?;
        within("person.plates", "", &[f64::from(self.plates)], 1.0, 3.0)?;
        if let Mobility::Standing { mass_kg, stiffness_n_per_m, damping_n_s_per_m } = self.mobility {
            within("person.mass", "kg", &[mass_kg], 0.1, 1e4)?;
            within("person.posture_stiffness", "N/m", &[stiffness_n_per_m], 0.0, 1e7)?;
            within("person.posture_damping", "N·s/m", &[damping_n_s_per_m], 0.0, 1e5)?;
        }
        self.steps_away_after_s
            .map_or(Ok(()), |after_s| within("person.steps_away", "s", &[after_s], 0.0, 1e3))
    }
}

/// Everything a simulation holds.
#[derive(Clone, Debug, PartialEq)]
pub struct Scene {
    /// Which parts of the robot exist.
    pub robot: Robot,
    /// Pose of B in W at the start: x m, y m, yaw rad.
    pub base_pose_world: [f64; 3],
    /// The arm.
    pub arm: AnyArm,
    /// Arm joint angles at the start, rad; entries beyond the last joint are of no meaning.
    pub arm_posture_rad: [f64; MAX_JOINTS],
    /// Payload fixed to the flange.
    pub payload: Payload,
    /// A gripper on the flange, without a mass of its own, and the object that it can grasp; `None` is no gripper.
    pub gripper: Option<TrueObject>,
    /// Friction and torque noise of its joints; its masses are already those of `arm` and `payload`.
    pub arm_joints: TrueArm,
    /// The arm's mechanical joint limits.
    pub joint_limits: bool,
    /// A sensor that reports the true wrench at the flange as the robot's own estimate.
    pub flange_sensor: bool,
    /// Place of a force-torque sensor between flange and payload, in the flange's axes: x, y, z m; roll, pitch, yaw rad. `None`
    /// without one.
    pub flange_sensor_origin: Option<[f64; 6]>,
    /// Errors of that sensor.
    pub flange_truth: TrueFlangeSensor,
    /// Foam of the cover.
    pub foam: Foam,
    /// The scene as a user of MuJoCo alone would write it: floor, base, links and people as geoms that collide, a touch
    /// sensor at every taxel, and the joint and flange sensors that a controller reads. People then meet the base in
    /// MuJoCo's contacts and not on the foam; until somebody touches it the trajectory is the same. It is what scene
    /// economy is measured against.
    pub geoms: bool,
    /// Capsules of the arm's links, which meet each other, the base out to its taxels and the floor as MuJoCo's geoms; a link beyond
    /// the last joint's is the flange. Empty for an arm without a shape.
    pub capsules: Vec<LinkCapsule>,
    /// Pairs of links whose capsules pass through each other; links that a joint connects do anyway. 0 stands on the base.
    pub apart: Vec<[usize; 2]>,
    /// The base: its body and its velocity servo, first order and limited in acceleration in the axes of B.
    pub base: BaseTable,
    /// The way from a command to that servo, its deceleration, and odometry.
    pub base_link: TrueBase,
    /// Seed of the jitter and noise on that way, and of the torque noise of the arm.
    pub seed: u64,
    /// Place of the arm on it.
    pub mount: Mount,
    /// Places of the taxels on it, up to [`MAX_TAXELS`].
    pub cover: Vec<TaxelPlacement>,
    /// People and walls.
    pub people: Vec<Person>,
    /// Time between two commands, s.
    pub control_period_s: f64,
    /// Physics step, s; the control period is a whole number of them.
    pub physics_step_s: f64,
    /// Integrator.
    pub integrator: Integrator,
    /// Engine that integrates.
    pub engine: Engine,
    /// Error of a control period that is asked for: each is stepped with n and with 2n steps, and n doubles until both agree
    /// within this share of 25 N and of 15 mm (mrad). `None` takes `physics_step_s` as it is; else that is the longest step,
    /// and the integrator [`Integrator::Leapfrog`].
    pub accuracy: Option<f64>,
}

impl Scene {
    /// Accuracies that can be asked for.
    pub const ACCURACY: (f64, f64) = (1e-7, 0.1);

    /// The free robot in its home posture: no people, no flange sensor.
    pub fn new(arm: &AnyArm, base: &BaseTable, mount: &Mount, cover: &[TaxelPlacement]) -> Self {
        Self {
            robot: Robot::MobileManipulator,
            base_pose_world: [0.0; 3],
            arm: *arm,
            arm_posture_rad: arm.table.home_rad,
            payload: Payload::NONE,
            gripper: None,
            arm_joints: TrueArm::AS_DESCRIBED,
            joint_limits: true,
            flange_sensor: false,
            flange_sensor_origin: None,
            flange_truth: TrueFlangeSensor::default(),
            foam: Foam::default(),
            geoms: false,
            capsules: Vec::new(),
            apart: Vec::new(),
            base: *base,
            base_link: TrueBase::AS_DESCRIBED,
            seed: 1,
            mount: *mount,
            cover: cover.to_vec(),
            people: Vec::new(),
            control_period_s: 1e-3,
            physics_step_s: 1e-3,
            integrator: Integrator::default(),
            engine: Engine::default(),
            accuracy: None,
        }
    }

    /// Returns true if there is an object that can become a load of the arm.
    pub(crate) fn has_object(&self) -> bool {
        self.gripper.is_some_and(|object| object.mass_kg > 0.0)
    }

    /// Returns the feature of this scene that needs MuJoCo; `None` if [`Engine::Analytic`] can run it.
    pub fn needs_mujoco(&self) -> Option<&'static str> {
        match (self.robot, self.integrator, self.arm.joints) {
            _ if self.geoms => Some("geoms and sensors"),
            _ if !self.capsules.is_empty() => Some("an arm with a shape"),
            (Robot::BaseOnly, ..) => Some("a base without its arm"),
            (Robot::ArmOnly, ..) => Some("an arm without its base"),
            (_, Integrator::RungeKutta4 | Integrator::Implicit, _) => {
                Some("an integrator other than Euler and implicitfast")
            }
            (.., 6 | 7) => None,
            _ => Some("an arm of neither six nor seven joints"),
        }
    }

    /// Returns the cheapest engine that can run this scene, whatever engine it names.
    pub fn needed_engine(&self) -> Engine {
        if self.needs_mujoco().is_some() { Engine::MuJoCo } else { Engine::Analytic }
    }

    /// Checks every number; NaN and infinity are outside every range.
    ///
    /// # Errors
    /// The first value outside its range, or a period that is not a whole number of steps.
    pub fn check(&self) -> Result<(), SimError> {
        within("base_pose_world", "m, m, rad", &self.base_pose_world, -1e3, 1e3)?;
        within("arm_posture_rad", "rad", &self.arm_posture_rad, -7.0, 7.0)?;
        within("control_period_s", "s", &[self.control_period_s], 1e-5, 0.1)?;
        within("physics_step_s", "s", &[self.physics_step_s], 1e-6, 0.1)?;
        self.foam.check()?;
        within("base.mass", "kg", &[self.base.mass_kg], 1.0, 1e5)?;
        within("base.inertia", "kg·m²", &self.base.inertia_com_diagonal, 1e-3, 1e6)?;
        within("base.size", "m", &self.base.size_m, 0.1, 100.0)?;
        within("mount.position", "m", &self.mount.position_base_m, -10.0, 10.0)?;
        within("mount.rpy", "rad", &self.mount.rpy_rad, -7.0, 7.0)?;
        #[expect(clippy::cast_precision_loss, reason = "small counts")]
        within("cover", "taxels", &[self.cover.len() as f64], 0.0, MAX_TAXELS as f64)?;
        within("payload.mass", "kg", &[self.payload.inertial.mass_kg], 0.0, 1e3)?;
        if let Some(object) = &self.gripper {
            within("object.mass", "kg", &[object.mass_kg], 0.0, 20.0)?;
            within("object.size", "m", &[object.size_m], 0.005, 0.5)?;
            within("object.friction", "", &[object.friction], 0.0, 2.0)?;
            within("object.position_world", "m", &object.position_world_m, -1e3, 1e3)?;
            if self.robot == Robot::BaseOnly {
                return Err(SimError::Unsupported { what: "a gripper", why: "the scene has no arm" });
            }
        }
        for capsule in &self.capsules {
            within("capsule.ends", "m", capsule.ends_m.as_flattened(), -10.0, 10.0)?;
            within("capsule.radius", "m", &[capsule.radius_m], 1e-3, 1.0)?;
        }
        for taxel in &self.cover {
            within("taxel.position", "m", &taxel.position_base_m, -10.0, 10.0)?;
            within("taxel.inward", "rad", &[taxel.inward_angle_base_rad], -7.0, 7.0)?;
        }
        if !self.people.is_empty() {
            // A cover that does not go round the origin of B encloses nothing that a person could touch.
            for taxel in &self.cover {
                let ([nx, ny], [x, y]) = (outward_base(taxel), taxel.position_base_m);
                within("taxel.distance_outward", "m", &[nx * x + ny * y], 2.0 * self.foam.gap_m, 15.0)?;
            }
        }
        if let Some(accuracy) = self.accuracy {
            within("accuracy", "", &[accuracy], Self::ACCURACY.0, Self::ACCURACY.1)?;
        }
        let second_order = self.integrator == Integrator::Leapfrog;
        if second_order && self.geoms {
            return Err(SimError::Unsupported {
                what: "leapfrog with geoms",
                why: "MuJoCo's contacts take no forces in the middle of a step",
            });
        }
        if self.accuracy.is_some() && !second_order {
            return Err(SimError::Unsupported {
                what: "an accuracy with this integrator",
                why: "only leapfrog is of second order in contact, and its halved step estimates the error",
            });
        }
        let is_explicit = self.integrator == Integrator::RungeKutta4;
        joint_friction::check(&self.arm_joints, is_explicit, self.robot != Robot::BaseOnly)?;
        FlangeSensor::check(&self.flange_truth, self.flange_sensor_origin.as_ref())?;
        within("base.servo_time_constant", "s", &[self.base.servo_time_constant_s], 1e-4, 10.0)?;
        let (linear, yaw) = (self.base.acceleration_max_m_s2, self.base.yaw_acceleration_max_rad_s2);
        within("base.acceleration", "m/s², rad/s²", &[linear, yaw], 1e-3, 1e4)?;
        BaseLink::check(&self.base_link)?;
        self.people.iter().try_for_each(Person::check)?;
        self.substeps().map(|_| ())
    }

    /// Physics steps in one control period.
    ///
    /// # Errors
    /// If it is not a whole number, at least 1.
    pub fn substeps(&self) -> Result<u32, SimError> {
        let ratio = self.control_period_s / self.physics_step_s;
        let whole = ratio.round();
        if !(1.0..=1e5).contains(&whole) || (ratio - whole).abs() > 1e-6 {
            return Err(SimError::Period { period_s: self.control_period_s, step_s: self.physics_step_s });
        }
        #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "within 1 to 1e5")]
        let substeps = whole as u32;
        Ok(substeps)
    }
}

/// Direction out of the cover at a taxel, unit, axes of B.
pub(crate) fn outward_base(taxel: &TaxelPlacement) -> [f64; 2] {
    let (sin, cos) = taxel.inward_angle_base_rad.sin_cos();
    [-cos, -sin]
}
