//! The simulated robot as a plant, and the shared forces its virtual board reads.

use crate::inject::{FaultSite, Injection, PlantFault, PlantSpoiler};
use crate::scripted_press::scripted_press;
use moca_control::config::{Config, HandConfig};
use moca_control::flange_sensor::{FlangeReading, FlangeSensor};
use moca_control::plant::{Plant, Simulated, SourceAge};
use moca_control::robot::{CoverTable, FlangeSensorKind, FoamKind, GripperKind, JOINTS, Parts, TAXELS};
use moca_control::stopping::{Ladder, Stop};
use moca_msgs::request::PRESS_FORCE_MAX_N;
use moca_msgs::{
    Actuation, Fault, GripperRequest, GripperState, Outcome, Refusal, RobotCommand, RobotState, TrueArm,
};
use moca_sim::foam::{ElasticLaw, Foam};
use moca_sim::scene::Robot;
use moca_sim::{Engine, Integrator, Scene, SharedForces, SimError, SimPlant};
use moca_tactile::cover::Electrode;
use std::collections::VecDeque;
use std::sync::atomic::Ordering;
use std::time::Duration;

/// After a longer stall the simulation falls behind the wall clock instead of freezing the loop.
const CATCH_UP_MAX_TICKS: u64 = 20;

/// Longest physics step, s.
const STEP_MAX_S: f64 = 1e-3;

/// The free robot with the parts it has, as `[simulation.true]` has it, stepped at the control rate of `config`.
pub fn free_scene(config: &Config) -> Scene {
    let control_period_s = 1.0 / f64::from(config.control_loop.rate_hz);
    let substeps = (control_period_s / STEP_MAX_S - 1e-9).ceil().max(1.0);
    let robot = match config.plant.parts {
        Parts::Whole => Robot::MobileManipulator,
        Parts::Base => Robot::BaseOnly,
        Parts::Arm => Robot::ArmOnly,
    };
    let truth = &config.simulation.truth;
    let base = truth.base.applied(&config.robot.base);
    let accuracy = Some(config.simulation.accuracy).filter(|accuracy| *accuracy > 0.0);
    Scene {
        robot,
        accuracy,
        integrator: if accuracy.is_some() { Integrator::Leapfrog } else { Integrator::default() },
        arm_posture_rad: config.control.gains.posture_rad,
        payload: config.robot.payload().with(&truth.arm.tool()),
        arm_joints: truth.arm,
        gripper: (config.plant.gripper == GripperKind::Simulated).then_some(truth.object),
        foam: true_foam(config),
        control_period_s,
        physics_step_s: control_period_s / substeps,
        base_link: truth.base,
        flange_sensor_origin: (config.plant.flange_sensor == FlangeSensorKind::Simulated)
            .then_some(config.plant.flange_sensor_origin),
        flange_truth: truth.flange_sensor,
        seed: config.simulation.seed,
        ..Scene::new(
            &truth.arm.applied(config.arm()),
            &base,
            &config.robot.mount,
            &config.robot.cover.placements(),
        )
    }
}

/// The foam that is really under the cover.
pub fn true_foam(config: &Config) -> Foam {
    let truth = &config.simulation.truth.foam;
    let cover = &config.robot.cover;
    foam(truth.kind.0.unwrap_or(cover.foam), cover).as_is(truth)
}

/// Control periods by which readings are older than the controller is told.
pub fn extra_age_ticks(config: &Config) -> usize {
    let ticks = 1e-3 * config.simulation.truth.sensor.extra_age_ms * f64::from(config.control_loop.rate_hz);
    #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "a second at most")]
    let ticks = ticks.round() as usize;
    ticks
}

/// True forces on their way to a board, N: as many as readings are ticks too old.
pub(crate) struct LateForces<const N: usize> {
    on_their_way: VecDeque<[f64; N]>,
    ticks: usize,
}

impl<const N: usize> LateForces<N> {
    pub(crate) fn new(config: &Config) -> Self {
        let ticks = extra_age_ticks(config);
        Self { on_their_way: VecDeque::with_capacity(ticks + 1), ticks }
    }

    /// Sends the forces of this tick off, and returns those that arrive in it: none before the first do.
    pub(crate) fn pass(&mut self, now_n: [f64; N]) -> [f64; N] {
        self.on_their_way.push_back(now_n);
        let arrives = self.on_their_way.len() > self.ticks;
        if arrives { self.on_their_way.pop_front() } else { None }.unwrap_or([0.0; N])
    }
}

/// Foam of a kind, hyperbolic with the numbers of `cover`.
fn foam(kind: FoamKind, cover: &CoverTable) -> Foam {
    match kind {
        FoamKind::PuLd30 => Foam::PU_LD30,
        FoamKind::Cc => Foam::CC,
        FoamKind::Pe5 => Foam::PE5,
        FoamKind::Pe3 => Foam::PE3,
        FoamKind::Hyperbolic => Foam {
            gap_m: cover.foam_thickness_m,
            elastic: ElasticLaw::Hyperbolic { stiffness_n_per_m: cover.foam_stiffness_n_m },
            ..Foam::COLLISION_ASSUMED
        },
    }
}

/// Drives the base of `scene` alone, with nobody near, through the ladder of [`Ladder`].
///
/// # Errors
/// A scene that cannot be built, and a base that does not go as it is told.
pub fn stops(config: &Config, scene: &Scene) -> anyhow::Result<Vec<Stop>> {
    let alone = Scene {
        robot: Robot::BaseOnly,
        people: Vec::new(),
        engine: Engine::MuJoCo,
        accuracy: None,
        arm_joints: TrueArm::AS_DESCRIBED,
        gripper: None,
        ..scene.clone()
    };
    let mut base = SimPlant::new(&alone)?;
    let mut ladder = Ladder::new(config.limits.base_acceleration[0], alone.control_period_s);
    while let Some(forward_m_s) = ladder.tick(base.state().base_pose_world[0])? {
        base.apply(&Actuation::Drive(RobotCommand::<JOINTS> {
            base_velocity_body: [forward_m_s, 0.0, 0.0],
            arm_torque_nm: [0.0; JOINTS],
            arm_gravity_nm: [0.0; JOINTS],
        }))?;
        base.step()?;
    }
    Ok(ladder.stops().collect())
}

/// MuJoCo behind the [`Plant`] trait, with the hands that press it.
pub struct SimulatedRobot {
    /// The simulated world.
    pub world: SimPlant,
    hand: HandConfig,
    covered: bool,
    asked_n: [f64; TAXELS],
    /// The taxel that the scripted hand pressed in the last step.
    scripted: Option<usize>,
    taxels: usize,
    wiring: Vec<Electrode>,
    command_timeout_s: f64,
    spoiler: Option<PlantSpoiler>,
    stall: Option<(u64, u64)>,
    /// Tick at which the gripper's plug is pulled.
    unplug_at: Option<u64>,
    shared: Vec<SharedForces>,
    late: LateForces<TAXELS>,
    period_s: f64,
    ticks: u64,
    measured: bool,
    /// Last reading of a flange sensor that has fallen silent, and its tick.
    silent_flange: Option<([f64; 6], u64)>,
}

impl SimulatedRobot {
    /// Builds the scene; the forces of each virtual board are told to `shared`.
    ///
    /// # Errors
    /// MuJoCo refused the scene.
    pub fn new(config: &Config, scene: &Scene, shared: Vec<SharedForces>) -> Result<Self, SimError> {
        let world = SimPlant::new(scene)?;
        let period_s = 1.0 / f64::from(config.control_loop.rate_hz);
        let covered = config.plant.parts.has_cover();
        let hand = if covered { config.simulation.hand.clone() } else { HandConfig::none() };
        Ok(Self {
            world,
            hand,
            covered,
            asked_n: [0.0; TAXELS],
            scripted: None,
            taxels: config.robot.cover.count(),
            wiring: config.robot.cover.wiring(),
            command_timeout_s: config.robot.base.command_timeout_s,
            spoiler: None,
            stall: None,
            unplug_at: None,
            shared,
            late: LateForces::new(config),
            period_s,
            ticks: 0,
            measured: false,
            silent_flange: None,
        })
    }

    /// Tells of its state what a real robot's sensors would ([`RobotState::in_single_precision`]), so that a log of it costs
    /// what theirs does.
    #[must_use]
    pub const fn as_sensors_tell(mut self) -> Self {
        self.measured = true;
        self
    }

    /// Lets the robot fail, or in real time stall the loop; other faults do nothing here.
    pub fn inject(&mut self, injection: &Injection) {
        let period = Duration::from_secs_f64(self.period_s).as_nanos().max(1);
        let at_tick = u64::try_from(u128::from(injection.at_ns) / period).unwrap_or(u64::MAX);
        match injection.fault.site {
            FaultSite::Plant(PlantFault::GripperUnplugged) => self.unplug_at = Some(at_tick),
            FaultSite::Plant(fault) => self.spoiler = Some(PlantSpoiler::new(fault, at_tick)),
            FaultSite::MissedSlots(slots) => self.stall = Some((at_tick, slots)),
            FaultSite::Cable(_) | FaultSite::Outside(_) => {}
        }
    }

    /// Makes the flange sensor repeat its present reading, which gets older, or renew it again. No effect without a sensor.
    pub fn set_flange_sensor_silent(&mut self, silent: bool) {
        let last = self.world.flange_reading().filter(|_| silent);
        self.silent_flange = last.map(|wrench| (wrench, self.ticks));
    }

    fn tell_boards(&mut self) {
        if self.shared.is_empty() {
            return;
        }
        let mut now_n = [0.0; TAXELS];
        for (now_n, force_n) in now_n.iter_mut().zip(self.world.taxel_force_true_n()) {
            *now_n = *force_n;
        }
        for (wire, force_n) in self.wiring.iter().zip(self.late.pass(now_n)) {
            let board = self.shared.get(usize::from(wire.board));
            if let Some(cell) = board.and_then(|forces| forces.get(usize::from(wire.electrode))) {
                cell.store(force_n.to_bits(), Ordering::Relaxed);
            }
        }
    }

    fn step(&mut self) -> Result<(), SimError> {
        #[expect(clippy::cast_precision_loss, reason = "tick counts are far below 2^53")]
        let scripted = scripted_press(&self.hand, self.ticks as f64 * self.period_s);
        let let_go = self.scripted.map(|taxel| (taxel, 0.0));
        for (taxel, force_n) in let_go.into_iter().chain(scripted) {
            self.world.press(taxel, self.asked_n.get(taxel).unwrap_or(&0.0) + force_n)?;
        }
        self.scripted = scripted.map(|(taxel, _)| taxel);
        if self.unplug_at.is_some_and(|at| self.ticks >= at) {
            self.world.unplug_gripper();
        }
        self.ticks += 1;
        self.world.step()
    }
}

impl FlangeSensor for SimulatedRobot {
    fn latest(&mut self) -> Option<FlangeReading> {
        let Some((wrench, since)) = self.silent_flange else {
            return self.world.flange_reading().map(|wrench| FlangeReading { wrench, age_s: 0.0 });
        };
        #[expect(clippy::cast_precision_loss, reason = "tick counts are far below 2^53")]
        let age_s = (self.ticks - since) as f64 * self.period_s;
        Some(FlangeReading { wrench, age_s })
    }
}

impl Plant for SimulatedRobot {
    fn read(&mut self) -> Result<RobotState<JOINTS>, Fault> {
        match &mut self.spoiler {
            Some(spoiler) => spoiler.read(self.world.state()),
            None => Ok(self.world.state()),
        }
    }

    fn flange_sensor(&mut self) -> Option<&mut dyn FlangeSensor> {
        Some(self)
    }

    fn age(&self) -> SourceAge {
        self.spoiler.as_ref().map(PlantSpoiler::age).unwrap_or_default()
    }

    fn write(&mut self, actuation: &Actuation<JOINTS>, ticks: u64) -> Result<(), Fault> {
        self.world.apply(actuation).map_err(|_| Fault::ControlRefused)?;
        for tick in 0..ticks.min(CATCH_UP_MAX_TICKS) {
            #[expect(clippy::cast_precision_loss, reason = "at most twenty")]
            if tick as f64 * self.period_s >= self.command_timeout_s {
                self.world.stop_base();
            }
            self.step().map_err(|_| Fault::PlantLost)?;
        }
        if !self.shared.is_empty() {
            self.tell_boards();
        }
        if let Some((_, slots)) = self.stall.take_if(|(at, _)| self.ticks >= *at) {
            #[expect(clippy::cast_precision_loss, reason = "a count of missed slots")]
            std::thread::sleep(Duration::from_secs_f64(slots as f64 * self.period_s));
        }
        self.spoiler.as_mut().map_or(Ok(()), |spoiler| spoiler.write(ticks, self.period_s))
    }

    fn gripper(&mut self) -> Option<GripperState> {
        self.world.gripper()
    }

    fn request_gripper(&mut self, request: &GripperRequest) -> Outcome {
        Ok(self.world.request_gripper(request)?)
    }

    fn simulated(&mut self) -> Option<&mut dyn Simulated> {
        Some(self)
    }

    fn is_exact(&mut self) -> bool {
        !self.measured
    }
}

impl Simulated for SimulatedRobot {
    fn press(&mut self, taxel: usize, force_n: f64) -> Outcome {
        let is_there = self.covered && taxel < self.taxels;
        let asked = self.asked_n.get_mut(taxel).filter(|_| is_there).ok_or(Refusal::OutOfRange)?;
        if !(0.0..=PRESS_FORCE_MAX_N).contains(&force_n) {
            return Err(Refusal::OutOfRange);
        }
        *asked = force_n;
        self.world.press(taxel, force_n).map_err(|_| Refusal::OutOfRange)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use moca_control::barrier::{curves, pressed, struck};
    use moca_msgs::RobotCommand;
    use moca_tactile::TaxelModel;
    use moca_tactile::model::FoamMemory;

    #[test]
    fn one_tick_is_one_control_period_at_every_rate() {
        for rate_hz in [100, 300, 1000, 4000] {
            let mut config = Config::default();
            config.control_loop.rate_hz = rate_hz;
            let mut robot = SimulatedRobot::new(&config, &free_scene(&config), Vec::new()).unwrap();
            for _ in 0..rate_hz {
                robot.step().unwrap();
            }
            assert!((robot.world.time_s() - 1.0).abs() < 1e-6, "{rate_hz} Hz: {} s", robot.world.time_s());
        }
    }

    /// Speeds of the base, m/s, tick by tick from an order of 0.1 m/s on, as it is and as it is reported.
    fn starts(change: &str, value: f64) -> [Vec<f64>; 2] {
        let mut config = Config::default();
        config.set(&format!("simulation.true.base.{change}"), &value.into()).unwrap();
        let scene = Scene { robot: Robot::BaseOnly, ..free_scene(&config) };
        let mut robot = SimulatedRobot::new(&config, &scene, Vec::new()).unwrap();
        let zero = [0.0; JOINTS];
        let order =
            RobotCommand { base_velocity_body: [0.1, 0.0, 0.0], arm_torque_nm: zero, arm_gravity_nm: zero };
        let mut speeds = [vec![], vec![]];
        let mut last_m = 0.0;
        for _ in 0..300 {
            robot.write(&Actuation::Drive(order), 1).unwrap();
            let true_m = robot.world.true_base_pose_world()[0];
            speeds[0].push((true_m - last_m) / 1e-3);
            last_m = true_m;
            speeds[1].push(robot.read().unwrap().base_velocity_world[0]);
        }
        speeds
    }

    #[test]
    fn late_orders_and_odometry_shift_base_by_their_delay() {
        let moves = |speeds: &[f64]| speeds.iter().position(|speed| *speed > 0.05).unwrap();
        let [driven, reported] = starts("order_delay_ms", 0.0);
        let [late, late_reported] = starts("order_delay_ms", 50.0);
        assert_eq!(
            (late[50..].to_vec(), late_reported[50..].to_vec()),
            (driven[..250].to_vec(), reported[..250].to_vec())
        );
        let [driven_too, seen_late] = starts("odometry_delay_ms", 30.0);
        assert_eq!((&driven_too, &seen_late[30..]), (&driven, &reported[..270]));
        let [slow, _] = starts("servo_ms", 100.0);
        assert!(moves(&slow) > moves(&driven) + 30, "{} {}", moves(&slow), moves(&driven));
    }

    #[test]
    fn a_reading_of_pu_ld30_says_how_close_the_plates_are() {
        let mut config = Config::default();
        config.set("protection.contact_barrier", &"pu-ld30".into()).unwrap();
        let assumed = curves(&config).unwrap().0;
        config.set("protection.contact_barrier", &"auto".into()).unwrap();
        config.board.calibration = "cover.toml".into();
        assert_eq!(curves(&config).unwrap().0, assumed, "a calibration of the same foam");
        let slow = pressed(&config.robot.cover);
        let mut worst_pressed = 0.0_f64;
        for tenths in 5..=115 {
            let depth_m = 1e-4 * f64::from(tenths);
            let counts = Foam::PU_LD30.counts_drop(depth_m);
            let reading_n = TaxelModel::PU_LD30.force_n(&mut FoamMemory::default(), counts, 0.0);
            let off_m = assumed.depth_m(reading_n) - depth_m;
            assert!(off_m.abs() < 0.1e-3, "{depth_m} m: {off_m} m off at {reading_n} N");
            worst_pressed = worst_pressed.min(slow.depth_m(reading_n) - depth_m);
        }
        assert!(
            worst_pressed < -0.5e-3,
            "by the foam under a steady force it would be {worst_pressed} m off"
        );
        config.set("robot.cover.foam", &"cc".into()).unwrap();
        assert_eq!(curves(&config).unwrap().0, pressed(&config.robot.cover));
    }

    #[test]
    fn true_foam_is_another_than_the_one_believed() {
        let mut config = Config::default();
        for (key, value) in [("kind", toml::Value::from("pe5")), ("scale", 1.5.into()), ("creep", 0.2.into())]
        {
            config.set(&format!("simulation.true.foam.{key}"), &value).unwrap();
        }
        let (foam, believed) = (free_scene(&config).foam, Foam::PE5);
        let ratio = foam.elastic_force_n(1e-3) / believed.elastic_force_n(1e-3);
        assert!((ratio - 1.5).abs() < 1e-12 && (foam.relaxation - believed.relaxation - 0.2).abs() < 1e-12);
        assert_eq!(crate::virtual_boards::board_config(&config).foam, foam, "the board reads that foam");
        config.set("simulation.true.foam.creep", &0.9.into()).unwrap();
        assert!(free_scene(&config).foam.relaxation < 1.0, "a foam keeps some of its force");
    }

    #[test]
    fn boards_feel_a_force_as_much_later_as_it_is_too_old() {
        for late_ticks in [0, 7] {
            let mut config = Config::default();
            config.simulation.hand = HandConfig::none();
            config.set("simulation.true.sensor.extra_age_ms", &f64::from(late_ticks).into()).unwrap();
            let shared: SharedForces = Default::default();
            let mut robot = SimulatedRobot::new(&config, &free_scene(&config), vec![shared.clone()]).unwrap();
            robot.press(5, 20.0).unwrap();
            let felt = |robot: &mut SimulatedRobot| {
                robot.write(&Actuation::Brake, 1).unwrap();
                f64::from_bits(shared[5].load(Ordering::Relaxed))
            };
            let ticks = (0..50).take_while(|_| felt(&mut robot) <= 0.0).count();
            assert_eq!(ticks, usize::try_from(late_ticks).unwrap());
        }
    }

    #[test]
    fn every_foam_yields_as_the_simulated_one() {
        for name in ["pu-ld30", "cc", "pe5", "pe3", "hyperbolic"] {
            let mut config = Config::default();
            config.set("robot.cover.foam", &name.into()).unwrap();
            let (cover, simulated) = (&config.robot.cover, true_foam(&config));
            for force_n in [2.0, 25.0, 130.0] {
                let off_m = struck(cover).depth_m(force_n) - simulated.deformation_m(force_n);
                assert!(off_m.abs() < 1e-6, "{name}, {force_n} N: {off_m} m");
                let relaxes = name != "hyperbolic";
                let off_m = pressed(cover).depth_m(force_n) - simulated.ramp_deformation_m(force_n);
                assert!(!relaxes || off_m.abs() < 1e-6, "{name}, {force_n} N pressed: {off_m} m");
            }
        }
    }
}
