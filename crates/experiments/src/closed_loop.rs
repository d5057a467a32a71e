//! The robot of an experiment: the daemon's own loop in lock-step, loads from a script, one row a tick.

use crate::settings::{Sensor, Settings};
use crate::{JOINTS, TAXELS, commissioning};
use anyhow::{Result, bail, ensure};
use moca_control::cover::CoverSource;
use moca_control::plant::Simulated;
use moca_lockstep::ideal_cover::IdealCover;
use moca_lockstep::inject::Injection;
use moca_lockstep::simulated_robot::{self, SimulatedRobot};
use moca_lockstep::touch_board::ByteCover;
use moca_lockstep::{Feed, LockStep, MemoryBoards, TrueForces};
use moca_msgs::{Mode, Sample, TaxelStatus, seconds};
use moca_sim::Scene;
use moca_sim::StepsSpent;

/// Longest time from power-up to a moving law, s of simulation.
const START_WITHIN_S: f64 = 30.0;

/// Loads on the robot at one instant.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Loads {
    /// Scripted hands on the cover, N, T1 first.
    pub taxel_n: [f64; TAXELS],
    /// Wrench at the flange, world axes [N; N·m].
    pub flange_world: [f64; 6],
}

impl Loads {
    /// Returns the loads, `factor` times as strong.
    pub fn scaled(&self, factor: f64) -> Self {
        Self {
            taxel_n: self.taxel_n.map(|f| f * factor),
            flange_world: self.flange_world.map(|f| f * factor),
        }
    }
}

/// One tick of an experiment.
#[derive(Clone, Debug, PartialEq)]
pub struct Row {
    /// Time since the robot was armed, s.
    pub t_s: f64,
    /// Pose of the base in W: m, m, rad.
    pub base_pose_world: [f64; 3],
    /// Velocity of the base in W: m/s, m/s, rad/s.
    pub base_velocity_world: [f64; 3],
    /// True velocity of the base in W, whatever odometry reports: m/s, m/s, rad/s.
    pub base_velocity_true_world: [f64; 3],
    /// Commanded velocity of the base, axes of B: m/s, m/s, rad/s.
    pub base_command_body: [f64; 3],
    /// Joint angles, rad.
    pub q_rad: [f64; JOINTS],
    /// Position of the flange in W, m.
    pub flange_world: [f64; 3],
    /// Orientation of the flange in W, quaternion x, y, z, w.
    pub flange_quaternion: [f64; 4],
    /// Desired position of the flange in W, m.
    pub flange_desired_world: [f64; 3],
    /// Wrench on the robot about the flange origin: true, and as the controller believes.
    pub flange_wrench_world: [f64; 6],
    /// Wrench about the flange origin as the controller believes it, world axes \[N; N·m\].
    pub flange_wrench_felt_world: [f64; 6],
    /// Wrench of the cover on the robot, axes and origin of B: true, and as the controller believes.
    pub wrench_true: [f64; 3],
    /// Wrench of the cover as the controller believes it, axes and origin of B: N, N, N·m.
    pub wrench_sensed: [f64; 3],
    /// True force on each taxel, N, T1 first.
    pub force_true: [f64; TAXELS],
    /// Force that each taxel reads, N, T1 first; NaN where the reading is not healthy.
    pub force_sensed: [f64; TAXELS],
    /// Sum of the true forces on everybody, felt by a taxel or not, and the one on the body pressed hardest, N.
    pub total_force_n: f64,
    /// True force on the body that is pressed hardest, N.
    pub largest_force_n: f64,
    /// Position of the person in W, m; `None` without one.
    pub person_world: Option<[f64; 2]>,
    /// Taxels at which the contact barrier holds somebody for pressing, however lightly.
    pub pressed: [bool; TAXELS],
}

impl Row {
    /// Distance of the flange from where it is wanted, m.
    pub fn flange_error_m(&self) -> f64 {
        let [x, y, z] = std::array::from_fn(|i| self.flange_world[i] - self.flange_desired_world[i]);
        (x * x + y * y + z * z).sqrt()
    }
}

#[cfg(test)]
#[test]
fn flight_goes_along_its_wrench_up_to_its_retreat() {
    let flight = Flight {
        row: 7,
        wrench_base: [-10.0, 0.5, 2.0],
        turns: true,
        acceleration: [3.0, 3.0, 6.0],
        fastest: [0.5, 0.5, 0.2],
        retreat_m_s: 0.3,
    };
    let near = |a: [f64; 3], b: [f64; 3]| a.iter().zip(b).all(|(a, b)| (a - b).abs() < 1e-12);
    let after = |flight: Flight, ticks: usize| {
        (0..ticks).fold([0.1, 0.02, 0.0], |order, _| flight.order_body(&order, 1e-3))
    };
    assert!(near(after(flight, 1), [0.097, 0.02, 0.006]));
    assert!(near(after(Flight { turns: false, ..flight }, 20), [0.04, 0.02, 0.0]));
    let [x, y, yaw] = after(flight, 500);
    assert!(
        near([0.0, y, yaw], [0.0, 0.02, 0.2]) && (-0.264..-0.25).contains(&x),
        "0.3 m/s are left of it: {x}"
    );
}

enum SensorModel {
    Board(Box<LockStep<ByteCover, MemoryBoards>>),
    True(Box<LockStep<IdealCover, TrueForces>>),
}

/// A robot that is armed and standing still, and what has happened to it since.
pub struct Rig {
    cover: SensorModel,
    period_s: f64,
    /// Loads of the last tick.
    loads: Loads,
    /// Every tick since the robot was armed.
    pub rows: Vec<Row>,
    /// Why the robot stopped, if it did.
    pub stopped: Option<String>,
    /// Rate of good frames, Hz (stock board).
    pub frame_rate_hz: f64,
    /// Simulated time, starting included, s.
    pub sim_s: f64,
    /// Orders of the base that are not the controller's,
    pub flight: Option<Flight>,
    /// and the last of them, axes of B, m/s, m/s, rad/s.
    fled_body: Option<[f64; 3]>,
}

/// Flight of the base, whatever its controller orders: all that a law could do.
#[derive(Clone, Copy, Debug)]
pub struct Flight {
    /// Row from which on the base flees.
    pub row: usize,
    /// Wrench along which it goes away, axes and origin of B, N, N, N·m.
    pub wrench_base: [f64; 3],
    /// It also turns away.
    pub turns: bool,
    /// Change of the order along each axis, m/s², m/s², rad/s².
    pub acceleration: [f64; 3],
    /// Fastest order along each axis, m/s, m/s, rad/s.
    pub fastest: [f64; 3],
    /// Fastest retreat along the wrench, m/s.
    pub retreat_m_s: f64,
}

impl Flight {
    /// Order of a tick, axes of B, after `last_body`.
    fn order_body(&self, last_body: &[f64; 3], period_s: f64) -> [f64; 3] {
        let [x_n, y_n, turn_nm] = self.wrench_base;
        let force_n = x_n.hypot(y_n);
        let retreat = (0..3).map(|axis| self.wrench_base[axis] * last_body[axis]).sum::<f64>();
        if retreat >= self.retreat_m_s * force_n {
            return *last_body;
        }
        let along =
            |component: f64, least: f64| if component.abs() < least { 0.0 } else { component.signum() };
        let turn = if self.turns { along(turn_nm, 0.02 * force_n) } else { 0.0 };
        let away = [along(x_n, 0.1 * force_n), along(y_n, 0.1 * force_n), turn];
        std::array::from_fn(|axis| {
            let order = last_body[axis] + away[axis] * self.acceleration[axis] * period_s;
            order.clamp(-self.fastest[axis], self.fastest[axis])
        })
    }
}

/// Steps until a law moves the robot, and returns the sample that says so.
///
/// # Errors
/// A robot that is not armed within 30 s.
pub fn armed<S: CoverSource, F: Feed<S>>(world: &mut LockStep<S, F>) -> Result<Sample> {
    loop {
        let (sample, _) = world.step(None);
        if sample.mode.moves() {
            return Ok(sample);
        }
        let in_time = seconds(sample.time_ns) < START_WITHIN_S;
        ensure!(in_time, "the robot was not armed within {START_WITHIN_S} s: {:?}", sample.fault);
    }
}

impl Rig {
    /// Builds the scene, lets the daemon tare and arm, and waits out the sensor's phase.
    ///
    /// # Errors
    /// A setting outside its range, or a robot that is not ready within 30 s.
    pub fn start(settings: &Settings, scene: &Scene) -> Result<Self> {
        settings.check()?;
        let mut config = settings.config.clone();
        if settings.belief_measured {
            commissioning::commission(&mut config, scene)?;
        }
        let period_s = scene.control_period_s;
        let ticks = |ms: f64| whole(ms * 1e-3 / period_s);
        let cover = match settings.sensor {
            Sensor::Stock => {
                let mut lock_step = LockStep::with_board(&config, scene, settings.board(), None)?;
                lock_step.control.watched = false;
                SensorModel::Board(Box::new(lock_step))
            }
            Sensor::Ideal | Sensor::Off => {
                if settings.sensor == Sensor::Off {
                    config.control.gains.reactivity = 0.0;
                }
                let ideal =
                    IdealCover::new(ticks(settings.period_ms()), simulated_robot::extra_age_ticks(&config));
                let mut lock_step = LockStep::with_true_forces(&config, scene, ideal)?;
                lock_step.feed = settings.sensor_samples;
                lock_step.control.watched = false;
                SensorModel::True(Box::new(lock_step))
            }
        };
        let mut rig = Self {
            cover,
            period_s,
            loads: Loads::default(),
            rows: Vec::new(),
            stopped: None,
            frame_rate_hz: 0.0,
            sim_s: 0.0,
            flight: None,
            fled_body: None,
        };
        rig.robot().world.set_people_waiting(true);
        loop {
            let mode = rig.tick()?;
            if mode.moves() {
                break;
            }
            // what is missing at the start is waited for: a tool that nobody told of makes the arm sag, which refuses a tare
            let cause = rig.stopped.take().filter(|_| matches!(mode, Mode::ProtectiveStop | Mode::Fault));
            if let Some(cause) = cause {
                bail!("the robot stopped before it was armed: {cause}");
            }
            ensure!(rig.sim_s < START_WITHIN_S, "the robot was not armed within {START_WITHIN_S} s");
        }
        rig.run_unloaded_for(1e-3 * settings.sensor_phase_ms)?;
        rig.rows.clear();
        rig.robot().world.set_people_waiting(false);
        Ok(rig)
    }

    /// Runs on for `duration_s` under `loads`, a function of the time since the last row before, s. Ends early if the
    /// robot stops.
    pub fn run_for(&mut self, duration_s: f64, loads: impl Fn(f64) -> Loads) -> Result<()> {
        self.run(duration_s, |rig, t_s| rig.push(&loads(t_s)))
    }

    /// Runs on for `duration_s` without a load by the script, as [`Self::run_for`].
    pub fn run_unloaded_for(&mut self, duration_s: f64) -> Result<()> {
        self.push(&Loads::default())?;
        self.run(duration_s, |_, _| Ok(()))
    }

    /// Runs on for `duration_s`; `load` is told the time before each tick.
    fn run(&mut self, duration_s: f64, load: impl Fn(&mut Self, f64) -> Result<()>) -> Result<()> {
        let ticks = whole(duration_s / self.period_s);
        self.rows.reserve(usize::try_from(ticks)?);
        for tick in 0..ticks {
            #[expect(clippy::cast_precision_loss, reason = "tick counts are far below 2^53")]
            let t_s = tick as f64 * self.period_s;
            load(self, t_s)?;
            self.tick()?;
            if self.stopped.is_some() {
                break;
            }
        }
        Ok(())
    }

    /// Moves the flange's target with this velocity, m/s, world axes, from now on.
    pub fn move_target(&mut self, velocity_world: [f64; 3]) -> Result<()> {
        let [x, y, z] = velocity_world;
        self.set_target_twist([x, y, z, 0.0, 0.0, 0.0])
    }

    /// Moves the flange's target with this twist, world axes \[m/s; rad/s\], from now on.
    ///
    /// # Errors
    /// A value that is not finite.
    pub fn set_target_twist(&mut self, twist: [f64; 6]) -> Result<()> {
        match &mut self.cover {
            SensorModel::Board(lock_step) => lock_step.control.set_target_twist(twist)?,
            SensorModel::True(lock_step) => lock_step.control.set_target_twist(twist)?,
        }
        Ok(())
    }

    /// Lets a fault strike at the loop's time that it names.
    pub fn inject(&mut self, injection: &Injection) {
        match &mut self.cover {
            SensorModel::Board(lock_step) => lock_step.inject(injection, 1),
            SensorModel::True(lock_step) => lock_step.inject(injection, 1),
        }
    }

    /// Makes the plant's state not a number, as a bug in it would.
    pub fn break_state(&mut self) {
        let state = self.robot().world.state();
        let mut base = state.base_pose_world;
        base[0] = f64::NAN;
        self.robot().world.set_state(&base, &state.base_velocity_world, &state.q_rad, &state.dq_rad_s);
    }

    /// Returns the cost of the physics steps that `accuracy` asked for; `None` for steps of one length.
    pub fn steps_spent(&self) -> Option<StepsSpent> {
        match &self.cover {
            SensorModel::Board(lock_step) => lock_step.control.plant.world.steps_spent(),
            SensorModel::True(lock_step) => lock_step.control.plant.world.steps_spent(),
        }
    }

    fn robot(&mut self) -> &mut SimulatedRobot {
        match &mut self.cover {
            SensorModel::Board(lock_step) => &mut lock_step.control.plant,
            SensorModel::True(lock_step) => &mut lock_step.control.plant,
        }
    }

    fn push(&mut self, loads: &Loads) -> Result<()> {
        if *loads == self.loads {
            return Ok(());
        }
        let robot = self.robot();
        for (taxel, &force_n) in loads.taxel_n.iter().enumerate() {
            if robot.press(taxel, force_n).is_err() {
                bail!("a scripted hand cannot press T{} with {force_n} N", taxel + 1);
            }
        }
        robot.world.set_flange_wrench_world(loads.flange_world)?;
        self.loads = *loads;
        Ok(())
    }

    /// One tick, and the mode after it.
    fn tick(&mut self) -> Result<Mode> {
        if let Some(flight) = self.flight.filter(|flight| flight.row <= self.rows.len())
            && let Some(last) = self.rows.last()
        {
            let last_body = self.fled_body.unwrap_or(last.base_command_body);
            let order_body = flight.order_body(&last_body, self.period_s);
            self.fled_body = Some(order_body);
            self.robot().world.take_over_base(Some(order_body))?;
        }
        let robot = self.robot();
        let force_true = fixed(robot.world.taxel_force_true_n());
        let wrench_true = robot.world.cover_wrench_true_base();
        let total_force_n = robot.world.contact_total_true_n();
        let largest_force_n = robot.world.contact_largest_true_n();
        let person_world = robot.world.person_position_world(0);
        let base_velocity_true_world = robot.world.true_base_velocity_world();
        let ticked = match &mut self.cover {
            SensorModel::Board(lock_step) => lock_step.tick(None),
            SensorModel::True(lock_step) => lock_step.tick(None),
        };
        // nobody watches: of the sample only motion, mode and touch are of this tick
        let sample = &ticked.sample;
        self.sim_s += self.period_s;
        self.frame_rate_hz = sample.frame_rate_hz;
        if let Some(fault) = sample.fault {
            self.stopped = Some(format!("{}: {}", fault.code(), fault.text()));
        }
        if sample.q_rad.is_empty() {
            return Ok(sample.mode); // no state was accepted, and none is not zero
        }
        #[expect(clippy::cast_precision_loss, reason = "tick counts are far below 2^53")]
        let t_s = self.rows.len() as f64 * self.period_s;
        // a row made before its place is would be copied
        self.rows.extend(std::iter::once_with(|| Row {
            t_s,
            base_pose_world: sample.base_pose_world,
            base_velocity_world: sample.base_velocity_world,
            base_velocity_true_world,
            base_command_body: sample.base_velocity_command_body,
            q_rad: fixed(&sample.q_rad),
            flange_world: sample.flange_position_world,
            flange_quaternion: sample.flange_quaternion_world,
            flange_desired_world: sample.flange_desired_position_world,
            flange_wrench_world: self.loads.flange_world,
            flange_wrench_felt_world: sample.flange_wrench_world,
            wrench_true,
            wrench_sensed: sample.cover_wrench_base,
            force_true,
            force_sensed: sensed(sample),
            total_force_n,
            largest_force_n,
            person_world,
            pressed: pressed(sample),
        }));
        Ok(sample.mode)
    }
}

fn sensed(sample: &Sample) -> [f64; TAXELS] {
    let mut felt_n = [f64::NAN; TAXELS];
    for (felt_n, taxel) in felt_n.iter_mut().zip(&sample.taxels) {
        *felt_n = if taxel.status == TaxelStatus::Ok { taxel.force_n } else { f64::NAN };
    }
    felt_n
}

fn pressed(sample: &Sample) -> [bool; TAXELS] {
    let mut pressed = [false; TAXELS];
    for row in sample.contact_rows.iter().filter(|row| row.depth_m > 0.0) {
        if let Some(pressed) = pressed.get_mut(usize::from(row.taxel)) {
            *pressed = true;
        }
    }
    pressed
}

fn fixed<const N: usize>(values: &[f64]) -> [f64; N] {
    if let Some(values) = values.first_chunk() {
        return *values;
    }
    std::array::from_fn(|i| values.get(i).copied().unwrap_or(f64::NAN))
}

/// Nearest whole number of ticks.
fn whole(ticks: f64) -> u64 {
    #[expect(
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss,
        reason = "saturates; durations are small"
    )]
    let whole = ticks.round() as u64;
    whole
}
