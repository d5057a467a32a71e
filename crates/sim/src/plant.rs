//! The plant: an arm on a velocity-controlled base, one control period at a time.

use crate::SimError;
use crate::base_link::{BaseLink, Motion};
use crate::flange_sensor::FlangeSensor;
use crate::gripper::Gripper;
use crate::joint_friction::JointFriction;
use crate::mechanics::{self, Mechanics};
use crate::mjcf::SERVO_DAMPING;
use crate::outline::Outline;
use crate::people::{CoverInstant, Felt, People, Step};
use crate::scene::{Integrator, Robot, Scene};
use crate::stepping::{End, Repeatable, Start, Stepping, StepsSpent};
use moca_msgs::{
    Actuation, GripperRefusal, GripperRequest, GripperState, MAX_JOINTS, MAX_TAXELS, RobotCommand, RobotState,
};

/// Largest push of the wheels before they slip: N, N, N·m (about 0.8 of the weight). ASSUMED.
const TRACTION: [f64; 3] = [1000.0, 1000.0, 400.0];
/// Time constant in which a braked joint comes to rest, s. ASSUMED.
const BRAKE_TIME_S: f64 = 0.02;
/// Largest force of a scripted hand, N.
const PRESS_MAX_N: f64 = 1000.0;
/// Room for the largest cover.
const K: usize = MAX_TAXELS;

/// Last command to the plant.
#[derive(Clone, Copy, Debug)]
enum Command {
    Drive(RobotCommand<MAX_JOINTS>),
    Brake,
}

/// Size of the engine's model of a scene.
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
    /// Size of the constant part (`mjModel`'s buffer), bytes.
    pub model_bytes: usize,
    /// Size of the changing part (`mjData`'s buffer and arena), bytes.
    pub data_bytes: usize,
    /// MuJoCo's arena, bytes.
    pub arena_bytes: usize,
    /// Most of it that a step has used so far, stack included, bytes.
    pub arena_used_bytes: usize,
}

/// The simulated robot with everything that can push it.
#[derive(Debug)]
pub struct SimPlant {
    pub(crate) mechanics: Box<dyn Mechanics>,
    scene: Scene,
    substeps: u32,
    /// Choice of steps for a period, if the scene asks for an accuracy.
    stepping: Option<Stepping>,
    outline: Outline,
    /// First coordinate of base and arm, where they exist.
    base_dof: Option<usize>,
    arm_dof: Option<usize>,
    people: People,
    command: Command,
    base_taken_over: Option<[f64; 3]>,
    /// Share of what is missing by which the outer base servo comes closer in a control period.
    servo_gain: f64,
    /// Velocity that it asks of the wheels, axes of B.
    servo_velocity_body: [f64; 3],
    /// Deceleration of the servo over its acceleration.
    braking: f64,
    link: BaseLink,
    /// Friction and noise of the joints, if there are any.
    friction: Option<JointFriction>,
    /// Sensor at the flange, if there is one.
    flange_sensor: Option<FlangeSensor>,
    /// The gripper, if there is one. Apart, because it is large and rare.
    gripper: Option<Box<Gripper>>,
    pressed_n: [f64; K],
    /// In the last step.
    felt: Felt,
    /// Mean over the steps of the last period.
    taxel_force_mean_n: [f64; K],
    contact_peak_n: f64,
    flange_wrench_world: [f64; 6],
    torque_nm: [f64; MAX_JOINTS],
}

impl SimPlant {
    /// Builds the model of `scene` and puts everything at its start.
    ///
    /// # Errors
    /// A number of the scene outside its range, or a model that its engine refuses.
    pub fn new(scene: &Scene) -> Result<Self, SimError> {
        scene.check()?;
        let has_base = scene.robot != Robot::ArmOnly;
        let has_arm = scene.robot != Robot::BaseOnly;
        let arm_dof = has_arm.then_some(if has_base { 3 } else { 0 });
        let first_person_dof = if has_base { 3 } else { 0 } + if has_arm { scene.arm.joints } else { 0 };
        let substeps = scene.substeps()?;
        let mut plant = Self {
            mechanics: mechanics::of(scene)?,
            scene: scene.clone(),
            substeps,
            stepping: scene.accuracy.map(|accuracy| Stepping::new(accuracy, substeps)),
            outline: Outline::new(scene),
            base_dof: has_base.then_some(0),
            arm_dof,
            people: People::new(scene, first_person_dof),
            command: Command::Brake,
            base_taken_over: None,
            servo_gain: 1.0 - (-scene.control_period_s / scene.base.servo_time_constant_s).exp(),
            servo_velocity_body: [0.0; 3],
            braking: if scene.base_link.deceleration_m_s2 > 0.0 {
                scene.base_link.deceleration_m_s2 / scene.base.acceleration_max_m_s2
            } else {
                1.0
            },
            link: BaseLink::new(&scene.base_link, scene.control_period_s, scene.seed),
            friction: JointFriction::new(&scene.arm_joints, scene.seed),
            flange_sensor: scene.flange_sensor_origin.map(|origin| {
                let (truth, payload) = (&scene.flange_truth, scene.payload.inertial);
                FlangeSensor::new(truth, &origin, payload, scene.control_period_s, scene.seed)
            }),
            gripper: None,
            pressed_n: [0.0; K],
            felt: Felt::NOTHING,
            taxel_force_mean_n: [0.0; K],
            contact_peak_n: 0.0,
            flange_wrench_world: [0.0; 6],
            torque_nm: [0.0; MAX_JOINTS],
        };
        plant.set_state(&scene.base_pose_world, &[0.0; 3], &scene.arm_posture_rad, &[0.0; MAX_JOINTS]);
        // a sensor has been on for longer than its delay
        for _ in 0..plant.flange_sensor.as_ref().map_or(0, FlangeSensor::count) {
            plant.measure_flange();
        }
        if let (Some(object), Some(flange)) = (&scene.gripper, plant.mechanics.flange_pose()) {
            plant.gripper = Some(Box::new(Gripper::new(object, &flange, scene.control_period_s)));
        }
        Ok(plant)
    }

    /// Measured state; the joint torque is the commanded one, whatever friction and noise make of it. Entries beyond the arm's last joint are zero, [`RobotState::resized`] cuts them. The flange wrench
    /// is the true one if the scene has a sensor for it, else `None`.
    pub fn state(&self) -> RobotState<MAX_JOINTS> {
        let (qpos, qvel) = (self.mechanics.positions(), self.mechanics.rates());
        let (mut q_rad, mut dq_rad_s) = (self.scene.arm_posture_rad, [0.0; MAX_JOINTS]);
        if let Some(dof) = self.arm_dof {
            let joints = ..self.scene.arm.joints;
            q_rad[joints].copy_from_slice(&qpos[dof..][joints]);
            dq_rad_s[joints].copy_from_slice(&qvel[dof..][joints]);
        }
        let (base_pose_world, base_velocity_world) = match self.base_motion() {
            Some(motion) => {
                let Motion { pose, velocity } = self.link.reported(motion);
                (pose, velocity)
            }
            None => (self.scene.base_pose_world, [0.0; 3]),
        };
        RobotState {
            base_pose_world,
            base_velocity_world,
            q_rad,
            dq_rad_s,
            torque_measured_nm: self.torque_nm,
            flange_wrench_world: self.scene.flange_sensor.then_some(self.flange_wrench_world),
        }
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

    /// Orders the base this velocity instead of the controller's from now on, as a joystick does: axes of B, m/s, m/s, rad/s. `None`
    /// gives it back.
    ///
    /// # Errors
    /// A velocity that is not finite.
    pub fn take_over_base(&mut self, velocity_body: Option<[f64; 3]>) -> Result<(), SimError> {
        finite("base velocity", &velocity_body.unwrap_or_default())?;
        self.base_taken_over = velocity_body;
        Ok(())
    }

    /// The base has heard no command for too long: it stops, the arm goes on as told.
    pub fn stop_base(&mut self) {
        if let Command::Drive(command) = &mut self.command {
            command.base_velocity_body = [0.0; 3];
        }
    }

    /// One control period: as many physics steps as the scene, or the accuracy it asks for, takes.
    ///
    /// # Errors
    /// Any warning of the engine (NaN, divergence, full buffers); the state is then no longer to be trusted.
    pub fn step(&mut self) -> Result<(), SimError> {
        self.advance_base_servo();
        if let Some(friction) = &mut self.friction {
            friction.next_period(self.scene.arm.joints);
        }
        self.advance_gripper()?;
        match self.stepping.take() {
            Some(mut stepping) => {
                let result = stepping.period(self, self.scene.control_period_s);
                self.stepping = Some(stepping);
                result?;
            }
            None => self.run(self.substeps, self.scene.physics_step_s)?,
        }
        if let Some(motion) = self.base_motion() {
            self.link.moved(motion);
        }
        self.measure_flange();
        Ok(())
    }

    fn measure_flange(&mut self) {
        let Some(sensor) = &mut self.flange_sensor else { return };
        if let Some(flange) = self.mechanics.flange_pose() {
            sensor.measure(&self.flange_wrench_world, &flange.axes());
        }
    }

    /// Moves fingers and object; what hangs on the flange changes between two periods only.
    fn advance_gripper(&mut self) -> Result<(), SimError> {
        let Some(gripper) = &mut self.gripper else { return Ok(()) };
        let Some(flange) = self.mechanics.flange_pose() else { return Ok(()) };
        let before = gripper.load();
        gripper.advance(&flange);
        let load = gripper.load();
        if load == before {
            return Ok(());
        }
        if let Some(sensor) = &mut self.flange_sensor {
            sensor.carry(self.scene.payload.inertial.with(&load));
        }
        self.mechanics.set_load(&load)
    }

    /// Hands a request to the gripper.
    ///
    /// # Errors
    /// There is none, it is unplugged, or a number is out of range.
    pub fn request_gripper(&mut self, request: &GripperRequest) -> Result<(), GripperRefusal> {
        self.gripper.as_mut().ok_or(GripperRefusal::NoGripper)?.request(request)
    }

    /// Returns what the gripper reports; `None` without one.
    pub fn gripper(&self) -> Option<GripperState> {
        self.gripper.as_ref().map(|gripper| gripper.state())
    }

    /// Pulls the gripper's plug: its fingers stay as they are, and it answers no more.
    pub fn unplug_gripper(&mut self) {
        if let Some(gripper) = &mut self.gripper {
            gripper.unplug();
        }
    }

    /// Centre of the object that the gripper can grasp, m; `None` without one.
    pub fn object_position_world(&self) -> Option<[f64; 3]> {
        self.gripper.as_ref()?.object_position_world()
    }

    /// True motion of the base, if there is one.
    fn base_motion(&self) -> Option<Motion> {
        let (qpos, qvel) = (self.mechanics.positions(), self.mechanics.rates());
        self.base_dof.map(|dof| Motion { pose: planar(qpos, dof), velocity: planar(qvel, dof) })
    }

    /// Returns the cost of the steps that an accuracy asked for; `None` for steps of one length.
    pub fn steps_spent(&self) -> Option<StepsSpent> {
        self.stepping.as_ref().map(|stepping| stepping.spent)
    }

    fn physics_step(&mut self, dt_s: f64) -> Result<(), SimError> {
        if self.scene.integrator != Integrator::Leapfrog {
            self.load(Step { dt_s, from_the_middle: false });
            return self.mechanics.step();
        }
        self.people.set_out(self.mechanics.time_s(), &mut *self.mechanics);
        self.mechanics.drift(0.5 * dt_s);
        self.load(Step { dt_s, from_the_middle: true });
        self.mechanics.step()?;
        // the engine moves the middle by a whole step at the new rates
        self.mechanics.drift(-0.5 * dt_s);
        Ok(())
    }

    /// Returns the size of the model.
    pub fn model_size(&self) -> ModelSize {
        self.mechanics.size()
    }

    /// One step of the engine under the forces of the last one: what it alone costs on this model.
    ///
    /// # Errors
    /// As for [`SimPlant::step`].
    pub fn bare_step(&mut self) -> Result<(), SimError> {
        self.mechanics.step()
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

    /// Newest reading of the sensor at the flange, its own axes about its origin \[N; N·m\]; `None` without sensor or arm. It
    /// has the flange's orientation as of the start of its period's last physics step.
    pub fn flange_reading(&self) -> Option<[f64; 6]> {
        self.flange_sensor.as_ref().and_then(FlangeSensor::latest)
    }

    /// True force on each taxel over the last physics step (under [`Integrator::Leapfrog`] at its end), N, T1 first.
    pub fn taxel_force_true_n(&self) -> &[f64] {
        &self.felt.taxel_force_n[..self.scene.cover.len()]
    }

    /// Mean of these over the physics steps of the last control period, N: what a sensor that averages would say, however
    /// often anybody asks it.
    pub fn taxel_force_mean_n(&self) -> &[f64] {
        &self.taxel_force_mean_n[..self.scene.cover.len()]
    }

    /// Sum of the normal forces on everybody who touches the cover, felt by a taxel or not, over the last physics step, N.
    pub fn contact_total_true_n(&self) -> f64 {
        self.felt.total_n
    }

    /// Normal force on the body that is pressed hardest, over the last physics step, N: on a seam more than any taxel's.
    pub fn contact_largest_true_n(&self) -> f64 {
        self.felt.largest_n
    }

    /// The largest of these over every physics step so far, N.
    pub fn contact_peak_true_n(&self) -> f64 {
        self.contact_peak_n
    }

    /// Number of contacts between geoms of the scene in the last physics step.
    pub fn contacts(&self) -> usize {
        self.mechanics.contacts()
    }

    /// True wrench of everything that touches the cover on the base over the last physics step, where it acts and with
    /// its friction, axes and origin of B: N, N, N·m. (Eq. (4) places every force at its taxel's centre.)
    pub fn cover_wrench_true_base(&self) -> [f64; 3] {
        self.felt.wrench_base
    }

    /// Flange origin in W, m, as of the start of the last physics step; `None` without an arm.
    pub fn flange_position_world(&self) -> Option<[f64; 3]> {
        self.mechanics.flange_pose().map(|flange| flange.position_world)
    }

    /// Centre of person `i` (a point of a wall) in W, m.
    pub fn person_position_world(&self, i: usize) -> Option<[f64; 2]> {
        self.people.position_world(i, self.mechanics.time_s(), self.mechanics.positions())
    }

    /// Makes the people wait where they are, or lets their time begin now. Without a call it begins with the simulation.
    pub fn set_people_waiting(&mut self, waiting: bool) {
        self.people.begin((!waiting).then(|| self.mechanics.time_s()));
    }

    /// True pose of the base, whatever odometry reports: x m, y m, yaw rad.
    pub fn true_base_pose_world(&self) -> [f64; 3] {
        self.base_motion().map_or(self.scene.base_pose_world, |motion| motion.pose)
    }

    /// True velocity of the base, whatever odometry reports: m/s, m/s, rad/s.
    pub fn true_base_velocity_world(&self) -> [f64; 3] {
        self.base_motion().map_or([0.0; 3], |motion| motion.velocity)
    }

    /// Simulation time, s.
    pub fn time_s(&self) -> f64 {
        self.mechanics.time_s()
    }

    /// Puts base and arm (joint angles and rates, rad and rad/s; what is not given stays) into a state and brings every
    /// derived quantity up to date.
    pub fn set_state(&mut self, base: &[f64; 3], base_rate: &[f64; 3], q: &[f64], dq: &[f64]) {
        if let Some(dof) = self.base_dof {
            self.mechanics.put(dof, base, base_rate);
        }
        if let Some(dof) = self.arm_dof {
            let joints = self.scene.arm.joints;
            self.mechanics.put(dof, &q[..q.len().min(joints)], &dq[..dq.len().min(joints)]);
        }
        self.mechanics.refresh();
        if let Some(motion) = self.base_motion() {
            self.link.put(motion);
        }
        if let (Some(gripper), Some(flange)) = (&mut self.gripper, self.mechanics.flange_pose()) {
            gripper.put(&flange);
        }
    }

    /// Joint-space inertia matrix of the whole plant (row-major, base then arm then people) as of the start of the
    /// last physics step, and its side length.
    pub fn full_mass_matrix(&mut self) -> (&[f64], usize) {
        let side = self.mechanics.rates().len();
        (self.mechanics.mass_matrix(), side)
    }

    /// Momentum of base and arm along x and y of W, and about the vertical through the base's origin, as of the start of the last
    /// physics step: kg·m/s, kg·m/s, kg·m²/s. Zero without a base.
    pub fn momentum_world(&mut self) -> [f64; 3] {
        let Some(base) = self.base_dof else { return [0.0; 3] };
        let rates = self.mechanics.rates().to_vec();
        let robot = self.arm_dof.map_or(base + 3, |arm| arm + self.scene.arm.joints);
        let (matrix, side) = self.full_mass_matrix();
        std::array::from_fn(|i| {
            let row = &matrix[(base + i) * side..][..robot];
            row.iter().zip(&rates).map(|(m, rate)| m * rate).sum()
        })
    }

    /// Coriolis, centrifugal and gravity terms, same order.
    pub fn bias(&self) -> &[f64] {
        self.mechanics.bias()
    }

    /// Outer servo of the base: first order, limited in acceleration and deceleration, in the axes of B, once per control
    /// period.
    fn advance_base_servo(&mut self) {
        let target = self.link.order(match (&self.base_taken_over, &self.command) {
            (Some(velocity_body), _) => *velocity_body,
            (None, Command::Drive(command)) => command.base_velocity_body,
            (None, Command::Brake) => [0.0; 3],
        });
        let dt_s = self.scene.control_period_s;
        let base = &self.scene.base;
        let (linear, yaw) = (base.acceleration_max_m_s2, base.yaw_acceleration_max_rad_s2);
        for (i, limit) in [linear, linear, yaw].into_iter().enumerate() {
            let change = self.servo_gain * (target[i] - self.servo_velocity_body[i]);
            let brakes = change * self.servo_velocity_body[i] < 0.0;
            let limit = if brakes { limit * self.braking } else { limit };
            self.servo_velocity_body[i] += change.clamp(-limit * dt_s, limit * dt_s);
        }
    }

    /// Writes every force of one physics step.
    fn load(&mut self, step: Step) {
        let mechanics = &mut self.mechanics;
        let (pose_world, velocity_world) = match self.base_dof {
            Some(dof) => (planar(mechanics.positions(), dof), planar(mechanics.rates(), dof)),
            None => (self.scene.base_pose_world, [0.0; 3]),
        };
        let cover = CoverInstant::new(&self.scene, &self.outline, step, (pose_world, velocity_world));
        let felt = &mut self.felt;
        *felt = Felt::NOTHING;
        felt.sensed(&self.scene, &self.outline, &self.pressed_n[..self.scene.cover.len()]);
        felt.push_base = felt.wrench_base;
        let time_s = mechanics.time_s() + if step.from_the_middle { 0.5 * step.dt_s } else { 0.0 };
        self.people.touch(&cover, time_s, mechanics.positions(), mechanics.rates(), felt);
        self.people.write_forces(mechanics.forces_mut());
        if self.scene.geoms {
            // forces between geoms act already
            felt.sensed(&self.scene, &self.outline, mechanics.touched_n());
        }
        self.contact_peak_n = self.contact_peak_n.max(felt.largest_n);

        if let Some(dof) = self.base_dof {
            let (push_world, wanted_world) =
                (cover.planar_to_world(felt.push_base), cover.planar_to_world(self.servo_velocity_body));
            let force = mechanics.forces_mut();
            for i in 0..3 {
                // The joint's own damping (implicit in the integrator) is the other half of the servo; by the trapezoidal rule
                // it is but half of that.
                let held = SERVO_DAMPING[i] * velocity_world[i];
                let servo =
                    (SERVO_DAMPING[i] * wanted_world[i] - held).clamp(-TRACTION[i], TRACTION[i]) + held;
                let at_start = if step.from_the_middle { 0.5 * held } else { 0.0 };
                force[dof + i] = servo - at_start + push_world[i];
            }
        }
        if let Some(dof) = self.arm_dof {
            self.torque_nm = match &self.command {
                Command::Drive(command) => command.arm_torque_nm,
                Command::Brake => self.brake_torque_nm(dof),
            };
            let joints = self.scene.arm.joints;
            self.mechanics.forces_mut()[dof..dof + joints].copy_from_slice(&self.torque_nm[..joints]);
            if let Some(friction) = &self.friction {
                let damping = friction.damping(&self.mechanics.rates()[dof..dof + joints]);
                self.mechanics.set_damping(dof, &damping[..joints]);
                let torque = &mut self.mechanics.forces_mut()[dof..dof + joints];
                for (torque, unreported) in torque.iter_mut().zip(friction.unreported_nm) {
                    *torque += unreported;
                }
            }
            self.mechanics.set_flange_wrench_world(&self.flange_wrench_world);
        }
    }

    /// Gravity compensation and a torque that takes the speed out of every joint in [`BRAKE_TIME_S`].
    fn brake_torque_nm(&mut self, dof: usize) -> [f64; MAX_JOINTS] {
        let joints = self.scene.arm.joints;
        let dq = self.state().dq_rad_s;
        let mut torque = [0.0; MAX_JOINTS];
        torque[..joints].copy_from_slice(&self.bias()[dof..dof + joints]);
        let (mass, side) = self.full_mass_matrix();
        for (i, torque) in torque[..joints].iter_mut().enumerate() {
            let row = &mass[(dof + i) * side + dof..(dof + i) * side + dof + joints];
            *torque -= row.iter().zip(dq).map(|(m, dq)| m * dq).sum::<f64>() / BRAKE_TIME_S;
        }
        torque
    }
}

impl Repeatable for SimPlant {
    fn start(&self) -> Start {
        Start {
            time_s: self.mechanics.time_s(),
            positions: self.mechanics.positions().to_vec(),
            rates: self.mechanics.rates().to_vec(),
            people: self.people.clone(),
            contact_peak_n: self.contact_peak_true_n(),
        }
    }

    fn put_back(&mut self, start: &Start) {
        self.mechanics.put(0, &start.positions, &start.rates);
        self.mechanics.set_time_s(start.time_s);
        self.people.clone_from(&start.people);
        self.contact_peak_n = start.contact_peak_n;
    }

    fn run(&mut self, steps: u32, step_s: f64) -> Result<(), SimError> {
        if self.scene.accuracy.is_some() {
            self.mechanics.set_step_s(step_s);
        }
        let taxels = self.scene.cover.len();
        self.taxel_force_mean_n[..taxels].fill(0.0);
        for _ in 0..steps {
            self.physics_step(step_s)?;
            let forces_n = &self.felt.taxel_force_n;
            for (mean, force_n) in self.taxel_force_mean_n[..taxels].iter_mut().zip(forces_n) {
                *mean += force_n / f64::from(steps);
            }
        }
        Ok(())
    }

    fn end(&self) -> End {
        let mut forces_n = self.taxel_force_true_n().to_vec();
        forces_n.push(self.contact_largest_true_n());
        let stages = self.people.stages(self.mechanics.time_s()).collect();
        End { positions: self.mechanics.positions().to_vec(), forces_n, stages }
    }
}

/// Three coordinates from `first` on.
fn planar(values: &[f64], first: usize) -> [f64; 3] {
    let values = &values[first..first + 3];
    [values[0], values[1], values[2]]
}

fn finite<const N: usize>(name: &'static str, values: &[f64; N]) -> Result<(), SimError> {
    // no early return: several at once
    if values.iter().fold(true, |finite, value| finite & value.is_finite()) {
        return Ok(());
    }
    match values.iter().find(|value| !value.is_finite()) {
        Some(&value) => Err(SimError::Command { name, value }),
        None => Ok(()),
    }
}
