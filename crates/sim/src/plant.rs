//! The plant: an arm on a velocity-controlled base, one control period at a time.

use crate::mjcf::{BASE_SERVO_DAMPING, FLANGE, YAW_SERVO_DAMPING, mjcf};
use crate::outline::Outline;
use crate::people::{CoverInstant, Felt, People};
use crate::scene::outward_base;
use crate::scene::{Robot, Scene};
use crate::{SimError, quiet};
use moca_msgs::{Actuation, MAX_JOINTS, MAX_TAXELS, RobotCommand, RobotState};
use mujoco_rs::prelude::{MjData, MjModel, MjtWarning};

/// What the wheels can push before they slip: N, N, N·m (about 0.8 of the weight). ASSUMED.
const TRACTION: [f64; 3] = [1000.0, 1000.0, 400.0];
/// Time constant in which a braked joint comes to rest, s. ASSUMED.
const BRAKE_TIME_S: f64 = 0.02;
/// Largest force of a scripted hand, N.
const PRESS_MAX_N: f64 = 1000.0;
/// Room for the largest cover.
const K: usize = MAX_TAXELS;

/// What the plant was last told.
#[derive(Clone, Copy, Debug)]
enum Command {
    Drive(RobotCommand<MAX_JOINTS>),
    Brake,
}

/// How large MuJoCo's model of a scene is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ModelSize {
    /// Degrees of freedom.
    pub dofs: usize,
    /// Bodies, the world included.
    pub bodies: usize,
    /// Geoms.
    pub geoms: usize,
    /// Sensors.
    pub sensors: usize,
    /// `mjModel`'s buffer, bytes.
    pub model_bytes: usize,
    /// `mjData`'s buffer and arena, bytes.
    pub data_bytes: usize,
    /// The arena, bytes.
    pub arena_bytes: usize,
    /// Most of it that a step has used so far, stack included, bytes.
    pub arena_used_bytes: usize,
}

/// The simulated robot with everything that can push it.
#[derive(Debug)]
pub struct SimPlant {
    data: MjData<Box<MjModel>>,
    scene: Scene,
    substeps: u32,
    outline: Outline,
    /// First degree of freedom of base and arm, and the flange's body, where they exist.
    base_dof: Option<usize>,
    arm_dof: Option<usize>,
    flange_body: Option<usize>,
    people: People,
    command: Command,
    /// Velocity that the outer base servo asks of the wheels, axes of B.
    servo_velocity_body: [f64; 3],
    pressed_n: [f64; K],
    taxel_force_n: [f64; K],
    cover_wrench_base: [f64; 3],
    contact_total_n: f64,
    contact_largest_n: f64,
    contact_peak_n: f64,
    flange_wrench_world: [f64; 6],
    torque_nm: [f64; MAX_JOINTS],
    /// Scratch for the dense mass matrix, nv × nv.
    mass: Vec<f64>,
}

impl SimPlant {
    /// Builds the model of `scene` and puts everything at its start.
    ///
    /// # Errors
    /// A number of the scene outside its range, or a model that MuJoCo refuses.
    pub fn new(scene: &Scene) -> Result<Self, SimError> {
        scene.check()?;
        quiet::install();
        let xml = mjcf(scene).map_err(|error| SimError::Model(error.to_string()))?;
        let refused = |error: &dyn std::fmt::Display| SimError::Model(error.to_string());
        let model = MjModel::from_xml_string(&xml).map_err(|error| refused(&error))?;
        let nv = usize::try_from(model.ffi().nv).unwrap_or(0);
        let flange_body = model.body(FLANGE).map(|info| info.id);
        let data = MjData::try_new(Box::new(model)).map_err(|error| refused(&error))?;
        let has_base = scene.robot != Robot::ArmOnly;
        let has_arm = scene.robot != Robot::BaseOnly;
        let arm_dof = has_arm.then_some(if has_base { 3 } else { 0 });
        let first_person_dof = if has_base { 3 } else { 0 } + if has_arm { scene.arm.joints } else { 0 };
        let mut plant = Self {
            data,
            scene: scene.clone(),
            substeps: scene.substeps()?,
            outline: Outline::new(scene),
            base_dof: has_base.then_some(0),
            arm_dof,
            flange_body,
            people: People::new(&scene.people, first_person_dof),
            command: Command::Brake,
            servo_velocity_body: [0.0; 3],
            pressed_n: [0.0; K],
            taxel_force_n: [0.0; K],
            cover_wrench_base: [0.0; 3],
            contact_total_n: 0.0,
            contact_largest_n: 0.0,
            contact_peak_n: 0.0,
            flange_wrench_world: [0.0; 6],
            torque_nm: [0.0; MAX_JOINTS],
            mass: vec![0.0; nv * nv],
        };
        plant.set_state(&scene.base_pose_world, &[0.0; 3], &scene.arm_posture_rad, &[0.0; MAX_JOINTS]);
        Ok(plant)
    }

    /// Measured state; entries beyond the arm's last joint are zero, [`RobotState::resized`] cuts them. The flange wrench is the true one if the scene has a sensor for it, else `None`.
    pub fn state(&self) -> RobotState<MAX_JOINTS> {
        let (qpos, qvel) = (self.data.qpos(), self.data.qvel());
        let mut state = RobotState {
            base_pose_world: self.scene.base_pose_world,
            base_velocity_world: [0.0; 3],
            q_rad: self.scene.arm_posture_rad,
            dq_rad_s: [0.0; MAX_JOINTS],
            torque_measured_nm: self.torque_nm,
            flange_wrench_world: self.scene.flange_sensor.then_some(self.flange_wrench_world),
        };
        if let Some(dof) = self.base_dof {
            state.base_pose_world.copy_from_slice(&qpos[dof..dof + 3]);
            state.base_velocity_world.copy_from_slice(&qvel[dof..dof + 3]);
        }
        if let Some(dof) = self.arm_dof {
            let joints = self.scene.arm.joints;
            state.q_rad[..joints].copy_from_slice(&qpos[dof..dof + joints]);
            state.dq_rad_s[..joints].copy_from_slice(&qvel[dof..dof + joints]);
        }
        state
    }

    /// Takes a command for the following steps. Until the first one the plant brakes.
    ///
    /// # Errors
    /// A value that is not finite; the plant then brakes.
    pub fn apply<const N: usize>(&mut self, actuation: &Actuation<N>) -> Result<(), SimError> {
        self.command = Command::Brake;
        if let Actuation::Drive(command) = actuation {
            finite("base velocity", &command.base_velocity_body)?;
            finite("arm torque", &command.arm_torque_nm)?;
            self.command = Command::Drive(command.resized());
        }
        Ok(())
    }

    /// The base has heard no command for too long: it stops, the arm goes on as told.
    pub fn stop_base(&mut self) {
        if let Command::Drive(command) = &mut self.command {
            command.base_velocity_body = [0.0; 3];
        }
    }

    /// One control period: as many physics steps as the scene asks for.
    ///
    /// # Errors
    /// Any MuJoCo warning (NaN, divergence, full buffers); the state is then no longer to be trusted.
    pub fn step(&mut self) -> Result<(), SimError> {
        self.advance_base_servo();
        for _ in 0..self.substeps {
            self.load();
            self.data.step();
            self.check()?;
        }
        Ok(())
    }

    /// How large the model is.
    pub fn model_size(&self) -> ModelSize {
        let count = |n: i64| usize::try_from(n).unwrap_or(0);
        let model = self.data.model().ffi();
        ModelSize {
            dofs: count(model.nv),
            bodies: count(model.nbody),
            geoms: count(model.ngeom),
            sensors: count(model.nsensor),
            model_bytes: count(model.nbuffer),
            data_bytes: count(self.data.nbuffer()) + count(self.data.narena()),
            arena_bytes: count(self.data.narena()),
            arena_used_bytes: count(self.data.maxuse_arena()) + count(self.data.maxuse_stack()),
        }
    }

    /// One `mj_step` and nothing else: what MuJoCo alone costs on this model.
    pub fn bare_step(&mut self) {
        self.data.step();
    }

    /// A scripted hand: presses `taxel` (0 is T1) with a steady `force_n` along its inward normal until told otherwise.
    ///
    /// # Errors
    /// A taxel that does not exist, or a force outside 0 to 1000 N.
    pub fn press(&mut self, taxel: usize, force_n: f64) -> Result<(), SimError> {
        let taxels = self.scene.cover.len();
        let Some(pressed) = self.pressed_n.get_mut(taxel).filter(|_| taxel < taxels) else {
            #[expect(clippy::cast_precision_loss, reason = "shown to a person")]
            let (value, max) = (taxel as f64 + 1.0, taxels as f64);
            return Err(SimError::Load { name: "taxel", value, min: 1.0, max });
        };
        if !(0.0..=PRESS_MAX_N).contains(&force_n) {
            return Err(SimError::Load { name: "press, N", value: force_n, min: 0.0, max: PRESS_MAX_N });
        }
        *pressed = force_n;
        Ok(())
    }

    /// A steady wrench on the robot about the flange origin, world axes \[N; N·m\].
    ///
    /// # Errors
    /// A value that is not finite; the wrench before stays.
    pub fn set_flange_wrench_world(&mut self, wrench: [f64; 6]) -> Result<(), SimError> {
        finite("flange wrench", &wrench)?;
        self.flange_wrench_world = wrench;
        Ok(())
    }

    /// True force on each taxel over the last physics step, N, T1 first.
    pub fn taxel_force_true_n(&self) -> &[f64] {
        &self.taxel_force_n[..self.scene.cover.len()]
    }

    /// Sum of the normal forces on everybody who touches the cover, felt by a taxel or not, over the last physics step, N.
    pub fn contact_total_true_n(&self) -> f64 {
        self.contact_total_n
    }

    /// Normal force on the body that is pressed hardest, over the last physics step, N: on a seam more than any taxel's.
    pub fn contact_largest_true_n(&self) -> f64 {
        self.contact_largest_n
    }

    /// The largest of these over every physics step so far, N.
    pub fn contact_peak_true_n(&self) -> f64 {
        self.contact_peak_n
    }

    /// True wrench of everything that touches the cover on the base over the last physics step, where it acts and with
    /// its friction, axes and origin of B: N, N, N·m. (Eq. (4) places every force at its taxel's centre.)
    pub fn cover_wrench_true_base(&self) -> [f64; 3] {
        self.cover_wrench_base
    }

    /// Flange origin in W, m, as of the start of the last physics step; `None` without an arm.
    pub fn flange_position_world(&self) -> Option<[f64; 3]> {
        self.flange_body.and_then(|body| self.data.xpos().get(body).copied())
    }

    /// Centre of person `i` (a point of a wall) in W, m.
    pub fn person_position_world(&self, i: usize) -> Option<[f64; 2]> {
        self.people.position_world(i, self.data.time(), self.data.qpos())
    }

    /// Makes the people wait where they are, or lets their time begin now. Without a call it begins with the simulation.
    pub fn set_people_waiting(&mut self, waiting: bool) {
        self.people.begin((!waiting).then(|| self.data.time()));
    }

    /// Simulation time, s.
    pub fn time_s(&self) -> f64 {
        self.data.time()
    }

    /// Puts base and arm (joint angles and rates, rad and rad/s; what is not given stays) into a state and brings every
    /// derived quantity up to date.
    pub fn set_state(&mut self, base: &[f64; 3], base_rate: &[f64; 3], q: &[f64], dq: &[f64]) {
        if let Some(dof) = self.base_dof {
            self.data.qpos_mut()[dof..dof + 3].copy_from_slice(base);
            self.data.qvel_mut()[dof..dof + 3].copy_from_slice(base_rate);
        }
        if let Some(dof) = self.arm_dof {
            let joints = dof..dof + self.scene.arm.joints;
            self.data.qpos_mut()[joints.clone()].iter_mut().zip(q).for_each(|(place, q)| *place = *q);
            self.data.qvel_mut()[joints].iter_mut().zip(dq).for_each(|(place, dq)| *place = *dq);
        }
        self.data.forward();
    }

    /// Joint-space inertia matrix of the whole plant (row-major, base then arm then people) as of the start of the
    /// last physics step, and its side length.
    pub fn full_mass_matrix(&mut self) -> (&[f64], usize) {
        let nv = self.data.qvel().len();
        if self.data.full_m(&mut self.mass).is_err() {
            self.mass.fill(f64::NAN);
        }
        (&self.mass, nv)
    }

    /// Coriolis, centrifugal and gravity terms, same order.
    pub fn bias(&self) -> &[f64] {
        self.data.qfrc_bias()
    }

    /// Outer servo of the base: first order, limited in acceleration, in the axes of B, once per control period.
    fn advance_base_servo(&mut self) {
        let target = match &self.command {
            Command::Drive(command) => command.base_velocity_body,
            Command::Brake => [0.0; 3],
        };
        let dt_s = self.scene.control_period_s;
        let base = &self.scene.base;
        let gain = 1.0 - (-dt_s / base.servo_time_constant_s).exp();
        let (linear, yaw) = (base.acceleration_max_m_s2, base.yaw_acceleration_max_rad_s2);
        for (i, limit) in [linear, linear, yaw].into_iter().enumerate() {
            let change = gain * (target[i] - self.servo_velocity_body[i]);
            self.servo_velocity_body[i] += change.clamp(-limit * dt_s, limit * dt_s);
        }
    }

    /// Writes every force of one physics step.
    fn load(&mut self) {
        let state = self.state();
        let (sin, cos) = state.base_pose_world[2].sin_cos();
        let cover = CoverInstant {
            taxels: &self.scene.cover,
            outline: &self.outline,
            foam: &self.scene.foam,
            dt_s: self.scene.physics_step_s,
            pose_world: state.base_pose_world,
            velocity_world: state.base_velocity_world,
        };
        let mut felt = Felt {
            taxel_force_n: self.pressed_n,
            wrench_base: pressed_wrench(&self.scene, &self.pressed_n),
            total_n: self.pressed_n.iter().sum(),
            largest_n: self.pressed_n.into_iter().fold(0.0, f64::max),
        };
        self.people.touch(&cover, self.data.time(), self.data.qpos(), self.data.qvel(), &mut felt);
        (self.taxel_force_n, self.cover_wrench_base) = (felt.taxel_force_n, felt.wrench_base);
        self.people.write_forces(self.data.qfrc_applied_mut());
        (self.contact_total_n, self.contact_largest_n) = (felt.total_n, felt.largest_n);
        self.contact_peak_n = self.contact_peak_n.max(felt.largest_n);
        let [fx, fy, mz] = self.cover_wrench_base;
        let push_world = [cos * fx - sin * fy, sin * fx + cos * fy, mz];

        if let Some(dof) = self.base_dof {
            let [vx, vy, yaw_rate] = self.servo_velocity_body;
            let velocity = [cos * vx - sin * vy, sin * vx + cos * vy, yaw_rate];
            let damping = [BASE_SERVO_DAMPING, BASE_SERVO_DAMPING, YAW_SERVO_DAMPING];
            let force = self.data.qfrc_applied_mut();
            for i in 0..3 {
                // The joint's own damping (implicit in the integrator) is the other half of the servo.
                let held = damping[i] * state.base_velocity_world[i];
                let servo = (damping[i] * velocity[i] - held).clamp(-TRACTION[i], TRACTION[i]) + held;
                force[dof + i] = servo + push_world[i];
            }
        }
        if let Some(dof) = self.arm_dof {
            match self.command {
                Command::Drive(command) => self.torque_nm = command.arm_torque_nm,
                Command::Brake => self.torque_nm = self.brake_torque_nm(dof, &state.dq_rad_s),
            }
            let joints = self.scene.arm.joints;
            self.data.qfrc_applied_mut()[dof..dof + joints].copy_from_slice(&self.torque_nm[..joints]);
        }
        if let Some(body) = self.flange_body {
            self.data.xfrc_applied_mut()[body] = self.flange_wrench_world;
        }
    }

    /// Gravity compensation and a torque that takes the speed out of every joint in [`BRAKE_TIME_S`].
    fn brake_torque_nm(&mut self, dof: usize, dq: &[f64; MAX_JOINTS]) -> [f64; MAX_JOINTS] {
        let joints = self.scene.arm.joints;
        let mut torque = [0.0; MAX_JOINTS];
        torque[..joints].copy_from_slice(&self.data.qfrc_bias()[dof..dof + joints]);
        let (mass, nv) = self.full_mass_matrix();
        for (i, torque) in torque[..joints].iter_mut().enumerate() {
            let row = &mass[(dof + i) * nv + dof..(dof + i) * nv + dof + joints];
            *torque -= row.iter().zip(dq).map(|(m, dq)| m * dq).sum::<f64>() / BRAKE_TIME_S;
        }
        torque
    }

    fn check(&self) -> Result<(), SimError> {
        const WATCHED: [(MjtWarning, &str); 6] = [
            (MjtWarning::mjWARN_BADQPOS, "a position is not a number or too large"),
            (MjtWarning::mjWARN_BADQVEL, "a velocity is not a number or too large"),
            (MjtWarning::mjWARN_BADQACC, "an acceleration is not a number or too large"),
            (MjtWarning::mjWARN_INERTIA, "the inertia matrix is close to singular"),
            (MjtWarning::mjWARN_CONTACTFULL, "the contact buffer is full"),
            (MjtWarning::mjWARN_CNSTRFULL, "the constraint buffer is full"),
        ];
        let raised = self.data.warning();
        match WATCHED.iter().find(|(kind, _)| raised[*kind as usize].number > 0) {
            Some((_, warning)) => Err(SimError::Unstable { warning, time_s: self.data.time() }),
            None => Ok(()),
        }
    }
}

/// Wrench on the base of hands that press taxels at their centres, axes and origin of B: N, N, N·m.
fn pressed_wrench(scene: &Scene, pressed_n: &[f64; K]) -> [f64; 3] {
    let mut wrench = [0.0; 3];
    for (taxel, force_n) in scene.cover.iter().zip(pressed_n) {
        let [nx, ny] = outward_base(taxel);
        let [x, y] = taxel.position_base_m;
        let (fx, fy) = (-force_n * nx, -force_n * ny);
        wrench[0] += fx;
        wrench[1] += fy;
        wrench[2] += x * fy - y * fx;
    }
    wrench
}

fn finite(name: &'static str, values: &[f64]) -> Result<(), SimError> {
    match values.iter().find(|value| !value.is_finite()) {
        Some(&value) => Err(SimError::Command { name, value }),
        None => Ok(()),
    }
}
