//! A scene as data. The model, its joints and the forces that are computed each step follow from it.

use crate::SimError;
use crate::foam::FoamLaw;
use moca_msgs::robot::{PANDA, PAPER_COVER};

/// Which parts of the robot exist.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Robot {
    /// Panda on its mobile base.
    #[default]
    MobileManipulator,
    /// The base and its cover; the arm's mass is missing.
    BaseOnly,
    /// The arm on a fixed stand where the base would carry it.
    ArmOnly,
}

/// MuJoCo's integrators.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Integrator {
    /// Semi-implicit Euler, joint damping implicit.
    Euler,
    /// Fourth-order Runge–Kutta, everything explicit.
    RungeKutta4,
    /// All velocity derivatives implicit.
    Implicit,
    /// Velocity derivatives without Coriolis terms implicit.
    #[default]
    ImplicitFast,
}

/// How a person moves when pushed.
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

/// An upright cylinder (a leg) that can touch the cover.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Person {
    /// Centre at the start in W: x, y m.
    pub position_world: [f64; 2],
    /// Velocity of the posture's anchor in W, m/s: 0 stands, more walks.
    pub velocity_world: [f64; 2],
    /// Radius, m.
    pub radius_m: f64,
    /// Stiffness of the tissue, in series with the foam, N/m.
    pub tissue_stiffness_n_per_m: f64,
    /// How the person yields.
    pub mobility: Mobility,
    /// Time after first contact at which the person steps away from the robot, s; `None` never.
    pub steps_away_after_s: Option<f64>,
}

impl Person {
    /// Speed and length of the step away, m/s and m. ASSUMED.
    pub const STEP_AWAY: (f64, f64) = (1.0, 3.0);

    /// The collision scene's person (75 kg, 50 N/mm, leg of 0.07 m radius), `gap_m` in front of taxel `taxel`
    /// (0 is T1) of a robot at the world's origin. Mass after ISO/TS 15066, the rest ASSUMED.
    pub fn beside(taxel: usize, gap_m: f64) -> Option<Self> {
        let placement = PAPER_COVER.get(taxel)?;
        let radius_m = 0.07;
        let (sin, cos) = placement.inward_angle_base_rad.sin_cos();
        let [x, y] = placement.position_base_m;
        let away = radius_m + gap_m;
        Some(Self {
            position_world: [x - away * cos, y - away * sin],
            velocity_world: [0.0; 2],
            radius_m,
            tissue_stiffness_n_per_m: 50_000.0,
            mobility: Mobility::Standing {
                mass_kg: 75.0,
                stiffness_n_per_m: 800.0,
                damping_n_s_per_m: 300.0,
            },
            steps_away_after_s: Some(1.5),
        })
    }
}

/// Everything a simulation holds.
#[derive(Clone, Debug, PartialEq)]
pub struct Scene {
    /// Which parts of the robot exist.
    pub robot: Robot,
    /// Pose of B in W at the start: x m, y m, yaw rad.
    pub base_pose_world: [f64; 3],
    /// Arm joint angles at the start, rad.
    pub arm_posture_rad: [f64; 7],
    /// The arm's mechanical joint limits.
    pub joint_limits: bool,
    /// A sensor that reports the true wrench at the flange as the robot's own estimate.
    pub flange_sensor: bool,
    /// Foam of the cover.
    pub foam: FoamLaw,
    /// Stiffness of the foam over its law's.
    pub foam_scale: f64,
    /// Everything a model of this robot could hold, needed or not: geoms with collision detection, sensors, energy.
    /// It changes no trajectory; it is what scene economy is measured against.
    pub everything: bool,
    /// People and walls.
    pub people: Vec<Person>,
    /// Time between two commands, s.
    pub control_period_s: f64,
    /// Physics step, s; the control period is a whole number of them.
    pub physics_step_s: f64,
    /// Integrator.
    pub integrator: Integrator,
}

impl Default for Scene {
    /// The free robot in its home posture: no people, no flange sensor.
    fn default() -> Self {
        Self {
            robot: Robot::MobileManipulator,
            base_pose_world: [0.0; 3],
            arm_posture_rad: PANDA.home_rad,
            joint_limits: true,
            flange_sensor: false,
            foam: FoamLaw::default(),
            foam_scale: 1.0,
            everything: false,
            people: Vec::new(),
            control_period_s: 1e-3,
            physics_step_s: 1e-3,
            integrator: Integrator::default(),
        }
    }
}

impl Scene {
    /// Checks every number; NaN and infinity are outside every range.
    ///
    /// # Errors
    /// The first value outside its range, or a period that is not a whole number of steps.
    pub fn check(&self) -> Result<(), SimError> {
        let within = |name, unit, values: &[f64], min: f64, max: f64| match values
            .iter()
            .find(|v| !(**v >= min && **v <= max))
        {
            Some(&value) => Err(SimError::Scene { name, value, unit, min, max }),
            None => Ok(()),
        };
        within("base_pose_world", "m, m, rad", &self.base_pose_world, -1e3, 1e3)?;
        within("arm_posture_rad", "rad", &self.arm_posture_rad, -7.0, 7.0)?;
        within("control_period_s", "s", &[self.control_period_s], 1e-5, 0.1)?;
        within("physics_step_s", "s", &[self.physics_step_s], 1e-6, 0.1)?;
        within("foam_scale", "", &[self.foam_scale], 1e-3, 1e5)?;
        for person in &self.people {
            within("person.position_world", "m", &person.position_world, -1e3, 1e3)?;
            within("person.velocity_world", "m/s", &person.velocity_world, -5.0, 5.0)?;
            within("person.radius_m", "m", &[person.radius_m], 0.005, 1e3)?;
            within("person.tissue_stiffness", "N/m", &[person.tissue_stiffness_n_per_m], 1.0, 1e9)?;
            if let Mobility::Standing { mass_kg, stiffness_n_per_m, damping_n_s_per_m } = person.mobility {
                within("person.mass", "kg", &[mass_kg], 0.1, 1e4)?;
                within("person.posture_stiffness", "N/m", &[stiffness_n_per_m], 0.0, 1e7)?;
                within("person.posture_damping", "N·s/m", &[damping_n_s_per_m], 0.0, 1e5)?;
            }
            if let Some(after_s) = person.steps_away_after_s {
                within("person.steps_away_after", "s", &[after_s], 0.0, 1e3)?;
            }
        }
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
