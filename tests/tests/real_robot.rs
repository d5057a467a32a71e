//! A real robot at the loop's seam, in lock-step: it comes later than the daemon, has reflexes, loses its base, and its arm
//! is on its own controller whenever nobody has asked for torques.
#![allow(clippy::unwrap_used, clippy::expect_used, reason = "a test that cannot go on has to stop")]
#![allow(clippy::float_cmp, reason = "what does not move stays equal to the bit")]

use moca_control::assemble::{motion, supervisor};
use moca_control::config::{BarrierReadings, Config};
use moca_control::cover::{CoverSource, CoverState};
use moca_control::plant::{Plant, SourceAge};
use moca_control::robot::{JOINTS, Parts, PlantKind, TAXELS};
use moca_control::stage::Untimed;
use moca_control::supervisor::Zero;
use moca_control::tick::{ControlLoop, Ticked};
use moca_control::tick_input::Slot;
use moca_daemon::runtime::live::Shared;
use moca_daemon::runtime::notice::{DriverWords, Notice, Reporter, Silent};
use moca_daemon::runtime::options::Options;
use moca_daemon::runtime::replay;
use moca_daemon::runtime::run::with_plant;
use moca_daemon::runtime::tick_source::Timer;
use moca_msgs::{
    Actuation, ArmLink, ArmMode, Fault, Law, Mode, Outcome, Refusal, Request, RobotCommand, RobotState,
    Sample,
};
use moca_telemetry::log::{LogReader, Record};
use moca_telemetry::net::{Address, Connection};
use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Sender, channel};
use std::time::Duration;

/// Stands as it is told to; remembers the last order.
struct Scripted {
    state: Result<RobotState<JOINTS>, Fault>,
    age: SourceAge,
    link: ArmLink,
    order: Actuation<JOINTS>,
    recoveries: u32,
}

impl Plant for Scripted {
    fn read(&mut self) -> Result<RobotState<JOINTS>, Fault> {
        self.state
    }

    fn age(&self) -> SourceAge {
        self.age
    }

    fn link(&self) -> Option<ArmLink> {
        Some(self.link)
    }

    fn recover(&mut self) -> Outcome {
        self.recoveries += 1;
        Err(Refusal::Recovering)
    }

    fn write(&mut self, actuation: &Actuation<JOINTS>, _ticks: u64) -> Result<(), Fault> {
        self.order = *actuation;
        Ok(())
    }
}

/// A cover that nobody touches; a tare succeeds at once.
struct Quiet(CoverState);

impl CoverSource for Quiet {
    fn read(&mut self, now_ns: u64, felt: &mut CoverState) {
        self.0.poll.reading.sampled_at_ns = Some(now_ns);
        *felt = CoverState { rate_hz: 250.0, ..self.0 };
    }

    fn start_tare(&mut self, _now_ns: u64) {
        self.0.zero = Zero::Valid;
    }
}

struct World {
    control: ControlLoop<Scripted, Quiet>,
    tick: u64,
}

fn at_home() -> RobotState<JOINTS> {
    RobotState::at_rest(Config::default().control.gains.posture_rad)
}

impl World {
    /// A whole robot that has not been reached yet.
    fn new() -> Self {
        let mut config = Config::default();
        config.plant.kind = PlantKind::Robot;
        config.protection.override_speed_limit_m_s = 0.5;
        config.protection.override_statement = "this cover's rate is not what is tested".into();
        let plant = Scripted {
            state: Err(Fault::ArmStale),
            age: SourceAge::default(),
            link: ArmLink::default(),
            order: Actuation::Brake,
            recoveries: 0,
        };
        let cover = Quiet(CoverState { frames_good: 1, zero: Zero::Invalid, ..CoverState::NONE });
        let control = ControlLoop::new(plant, cover, supervisor(&config), motion(&config).unwrap(), 1e-3);
        Self { control, tick: 0 }
    }

    /// Returns the robot, ready to be armed.
    fn ready() -> Self {
        let mut world = Self::new();
        world.control.plant.state = Ok(at_home());
        world.run(10);
        assert_eq!(world.step(None).0.mode, Mode::Ready);
        world
    }

    fn armed() -> Self {
        let mut world = Self::ready();
        assert_eq!(world.step(Some(Request::Arm)).1, Some(Ok(())));
        world.run(10);
        world
    }

    fn step(&mut self, request: Option<Request>) -> (Sample, Option<Outcome>) {
        let slot = Slot { tick: self.tick, now_ns: self.tick * 1_000_000, ticks: 1, ..Slot::default() };
        self.tick += 1;
        let Ticked { sample, input } = self.control.tick(&slot, request, &mut Untimed);
        (sample.clone(), input.outcome)
    }

    fn run(&mut self, ticks: u32) -> Sample {
        (0..ticks).map(|_| self.step(None).0).last().unwrap()
    }

    /// The arm's torques, or `None` if it is on its own controller.
    fn driven(&self) -> Option<RobotCommand<JOINTS>> {
        match self.control.plant.order {
            Actuation::Drive(command) => Some(command),
            Actuation::Brake => None,
        }
    }
}

#[test]
fn absent_robot_is_awaited_and_gets_no_torque() {
    let mut world = World::new();
    for absent in [Fault::ArmStale, Fault::ArmUserStopped, Fault::ArmRefused, Fault::BaseStale] {
        world.control.plant.state = Err(absent);
        let sample = world.run(50);
        assert_eq!((sample.mode, sample.fault), (Mode::Starting, Some(absent)));
        assert!(world.driven().is_none());
    }
    // Arm known, base not yet: its part of the state may hold anything.
    let mut arm_only = at_home();
    arm_only.base_pose_world = [f64::NAN; 3];
    (world.control.plant.state, world.control.plant.age.base_s) = (Ok(arm_only), f64::INFINITY);
    let sample = world.run(50);
    assert_eq!((sample.mode, sample.fault), (Mode::Starting, Some(Fault::BaseStale)));
    assert!(world.driven().is_none(), "torque control begins with ready");

    (world.control.plant.state, world.control.plant.age.base_s) = (Ok(at_home()), 0.0);
    let mut modes = Vec::new();
    for _ in 0..10 {
        let mode = world.step(None).0.mode;
        assert_eq!(world.driven().is_some(), mode == Mode::Ready, "{mode:?}");
        modes.push(mode);
    }
    modes.dedup();
    assert_eq!(modes, [Mode::Taring, Mode::Ready], "and a real robot is not armed by itself");
}

#[test]
fn a_reflex_is_recovered_by_resume_and_resumed_by_another() {
    let mut world = World::armed();
    assert!(world.driven().is_some());
    world.control.plant.state = Err(Fault::ArmReflex);
    let (sample, _) = world.step(None);
    assert_eq!((sample.mode, sample.fault), (Mode::ProtectiveStop, Some(Fault::ArmReflex)));
    assert!(world.driven().is_none());

    assert_eq!(world.control.plant.recoveries, 0, "nobody has asked");
    assert_eq!(world.step(Some(Request::Resume)).1, Some(Err(Refusal::Recovering)));
    assert_eq!(world.control.plant.recoveries, 1);

    // It is well again and its states come: still nothing gives it torques.
    world.control.plant.state = Ok(at_home());
    let sample = world.run(100);
    assert_eq!((sample.mode, sample.fault), (Mode::ProtectiveStop, Some(Fault::ArmReflex)));
    assert!(world.driven().is_none(), "torque control begins with resume");
    let (sample, outcome) = world.step(Some(Request::Resume));
    assert_eq!((sample.mode, outcome), (Mode::Ready, Some(Ok(()))));
    let command = world.driven().unwrap();
    assert_eq!(world.control.plant.recoveries, 1);
    for joint in 0..JOINTS {
        let without = command.arm_torque_nm[joint] - command.arm_gravity_nm[joint];
        assert!(without.abs() < 1e-9, "an arm at rest starts with no torque but gravity: {without} N·m");
    }
    let most = command.arm_gravity_nm.iter().fold(0.0, |most: f64, nm| most.max(nm.abs()));
    assert!(most > 10.0, "the arm stands out: {:?}", command.arm_gravity_nm);
}

#[test]
fn a_reflex_before_the_start_is_a_stop_that_can_be_left() {
    let mut world = World::new();
    world.control.plant.state = Err(Fault::ArmReflex);
    assert_eq!(world.step(None).0.mode, Mode::ProtectiveStop);
    assert_eq!(world.step(Some(Request::Resume)).1, Some(Err(Refusal::Recovering)));
    world.control.plant.state = Ok(at_home());
    assert_eq!(world.step(Some(Request::Resume)).1, Some(Err(Refusal::ZeroInvalid)));
    assert_eq!(world.step(Some(Request::Tare)).1, Some(Ok(())));
    assert_eq!(world.run(3).mode, Mode::ProtectiveStop);
    assert!(world.driven().is_none());
    assert_eq!(world.step(Some(Request::Resume)).1, Some(Ok(())));
    assert!(world.driven().is_some());
}

#[test]
fn a_stale_base_stands_while_the_arm_is_held() {
    let mut world = World::armed();
    let mut forces = [0.0; TAXELS];
    forces[5] = 20.0;
    world.control.cover.0.poll.reading.taxels[5].force_n = 20.0;
    world.control.cover.0.poll.forces = Ok(forces);
    world.run(200);
    let moving = world.driven().unwrap();
    assert!(moving.base_velocity_body[0].abs() > 1e-3, "{:?}", moving.base_velocity_body);

    world.control.plant.age.base_s = 0.2;
    let (sample, _) = world.step(None);
    assert_eq!((sample.mode, sample.fault), (Mode::ProtectiveStop, Some(Fault::BaseStale)));
    let held = world.driven().expect("the arm is well");
    assert_eq!((held.base_velocity_body, sample.base_velocity_command_body), ([0.0; 3], [0.0; 3]));
    let step = |joint: usize| (held.arm_torque_nm[joint] - moving.arm_torque_nm[joint]).abs();
    assert!((0..JOINTS).all(|joint| step(joint) <= 1.0 + 1e-9), "1000 N·m/s");
    assert_eq!(world.step(Some(Request::Resume)).1, Some(Err(Refusal::CauseRemains(Fault::BaseStale))));
    assert!(world.run(500).base_velocity_command_body == [0.0; 3] && world.driven().is_some());

    // A stale arm leaves nothing to hold; the base stands too, and the arm's return alone changes nothing.
    world.control.plant.age = SourceAge { arm_s: 0.02, base_s: 0.0 };
    assert!(world.run(1).fault == Some(Fault::BaseStale) && world.driven().is_none());
    world.control.plant.age = SourceAge::default();
    world.run(100);
    assert!(world.driven().is_none());
    assert_eq!(world.step(Some(Request::Resume)).1, Some(Ok(())));
    assert!(world.driven().is_some());
}

#[test]
fn an_arm_far_from_its_posture_is_not_armed() {
    let mut world = World::ready();
    let mut away = at_home();
    away.q_rad[3] += 0.3;
    for step in 1..=10 {
        let mut state = at_home();
        state.q_rad[3] += 0.03 * f64::from(step);
        world.control.plant.state = Ok(state);
        world.step(None);
    }
    let (sample, outcome) = world.step(Some(Request::Arm));
    let Some(Err(refusal @ Refusal::FarFromPosture { joint: 3, off_rad })) = outcome else {
        panic!("{outcome:?}");
    };
    assert!((off_rad - 0.3).abs() < 1e-6 && sample.mode == Mode::Ready);
    assert!(refusal.to_string().contains("joint 4 is 0.30 rad"), "{refusal}");
    // The posture is a live parameter: where the arm is, is allowed.
    let number = moca_msgs::params::CONTROLLER.iter().position(|row| row.name == "control.gains.posture_rad");
    let values = moca_msgs::ParameterValues::new(&away.q_rad[..7]).unwrap();
    let parameter = u8::try_from(number.unwrap()).unwrap();
    assert_eq!(world.step(Some(Request::SetParameter { parameter, values })).1, Some(Ok(())));
    assert_eq!(world.step(Some(Request::SelectLaw(Law::FollowMe))).1, Some(Ok(())));
    assert_eq!(world.step(Some(Request::Arm)).1, Some(Ok(())));
}

#[test]
fn arm_is_armed_only_within_0_1_rad_of_posture() {
    for (off_rad, armed) in [(0.10, true), (0.11, false)] {
        // Just inside: what the loop is given has single precision.
        for (joint, sign) in [(0, 1.0), (3, 1.0), (6, -1.0)] {
            let mut world = World::new();
            let mut state = at_home();
            state.q_rad[joint] += sign * (off_rad - 1e-6);
            world.control.plant.state = Ok(state);
            assert_eq!(world.run(10).mode, Mode::Ready);
            let outcome = world.step(Some(Request::Arm)).1.unwrap();
            assert_eq!(outcome.is_ok(), armed, "{off_rad} rad, joint {joint}: {outcome:?}");
            let refused =
                matches!(outcome, Err(Refusal::FarFromPosture { joint: j, .. }) if usize::from(j) == joint);
            assert_eq!(refused, !armed, "{outcome:?}");
        }
    }
}

#[test]
fn the_arms_own_estimate_of_a_push_is_what_the_law_yields_to() {
    let [pulled, pushed] = [20.0, -20.0].map(|force_n| {
        let mut world = World::ready();
        assert_eq!(world.step(Some(Request::SelectLaw(Law::FollowMe))).1, Some(Ok(())));
        assert_eq!(world.step(Some(Request::Arm)).1, Some(Ok(())));
        let push = [force_n, 0.0, 0.0, 0.0, 0.0, 0.0];
        world.control.plant.state.as_mut().unwrap().flange_wrench_world = Some(push);
        let sample = world.run(200);
        assert_eq!(sample.flange_wrench_world, push);
        world.driven().unwrap().base_velocity_body[0]
    });
    assert!(pulled > 0.01 && pushed < -0.01, "the base follows the hand: {pulled} and {pushed} m/s");
}

#[test]
fn what_is_known_of_the_way_to_the_arm_is_in_every_sample() {
    let mut world = World::ready();
    let arm = ArmLink { mode: ArmMode::Torque, success_rate: 0.97, lost: 3, repeated: 2, errors: 1 << 40 };
    world.control.plant.link = arm;
    world.control.plant.age = SourceAge { arm_s: 0.004, base_s: 0.05 };
    let link = world.run(1).link.unwrap();
    assert_eq!((link.arm, link.arm_age_s, link.base_age_s), (arm, 0.004, 0.05));
}

/// A robot whose arm has a reflex as soon as somebody wants it.
struct Falls(Scripted, Arc<AtomicBool>);

impl Plant for Falls {
    fn read(&mut self) -> Result<RobotState<JOINTS>, Fault> {
        if self.1.load(Ordering::Relaxed) { Err(Fault::ArmReflex) } else { self.0.read() }
    }

    fn link(&self) -> Option<ArmLink> {
        self.0.link()
    }

    fn write(&mut self, actuation: &Actuation<JOINTS>, ticks: u64) -> Result<(), Fault> {
        self.0.write(actuation, ticks)
    }
}

/// Passes on where telemetry listens and where the last seconds are written.
struct Places(Sender<Address>, Sender<PathBuf>);

impl Reporter for Places {
    fn report(&mut self, notice: Notice<'_>) {
        match notice {
            Notice::Telemetry(address) => self.0.send(address.clone()).unwrap(),
            Notice::FaultLog(path) => self.1.send(path.into()).unwrap(),
            _ => {}
        }
    }
}

#[test]
fn a_robot_of_ones_own_has_telemetry_and_a_flight_recorder() {
    let mut config = Config::default();
    (config.plant.kind, config.plant.parts) = (PlantKind::Robot, Parts::Arm);
    let socket = std::env::temp_dir().join(format!("moca-own-{}.sock", std::process::id()));
    config.telemetry.listen = Address::Unix(socket).to_string();
    let folder = std::env::temp_dir().join(format!("moca-own-flight-{}", std::process::id()));
    config.flight_recorder.folder = folder.display().to_string();
    (config.realtime.priority, config.realtime.lock_memory, config.realtime.dma_latency) = (0, false, false);
    let options = Options { config, ..Options::default() };
    let arm = ArmLink { mode: ArmMode::Torque, success_rate: 0.5, ..ArmLink::default() };
    let (shared, falls) = (Arc::new(Shared::default()), Arc::new(AtomicBool::new(false)));
    let (addresses, address) = channel();
    let (paths, path) = channel();
    let (stop, fall) = (Arc::clone(&shared), Arc::clone(&falls));
    let log = std::thread::scope(|scope| {
        scope.spawn(move || {
            let client = Connection::spawn(address.recv().unwrap(), || {}).unwrap();
            let seen = |mode: Mode| {
                while !client.poll().samples.iter().any(|s| s.mode == mode && s.link.unwrap().arm == arm) {
                    std::thread::sleep(Duration::from_millis(1));
                }
            };
            seen(Mode::Ready);
            fall.store(true, Ordering::Relaxed);
            seen(Mode::ProtectiveStop);
            path.recv().unwrap();
            stop.stop.store(true, Ordering::Relaxed);
        });
        let connect = |_: &DriverWords| {
            let (age, order) = (SourceAge::default(), Actuation::Brake);
            let robot = Scripted { state: Ok(at_home()), age, link: arm, order, recoveries: 0 };
            Ok(Falls(robot, Arc::clone(&falls)))
        };
        with_plant(&options, connect, Timer::new, &shared, &mut Places(addresses, paths)).unwrap();
        let mut files = std::fs::read_dir(&folder).unwrap();
        files.find_map(|file| file.ok().filter(|f| f.path().to_string_lossy().ends_with("arm-reflex.mcap")))
    });
    let log = log.expect("the seconds before the reflex").path();
    let mut modes = Vec::new();
    for record in &mut LogReader::open(&log).unwrap() {
        if let Record::Sample(sample) = record {
            modes.push((sample.mode, sample.fault));
        }
    }
    assert!(modes.contains(&(Mode::Ready, None)), "what was before");
    assert_eq!(modes.last(), Some(&(Mode::ProtectiveStop, Some(Fault::ArmReflex))));
    std::fs::remove_dir_all(&folder).unwrap();
}

/// A program with a driver of its own gets the foam that its calibration's age leaves, and is told.
#[test]
fn own_robot_without_a_calibration_has_an_old_foam() {
    struct Troubles(Vec<String>);
    impl Reporter for Troubles {
        fn report(&mut self, notice: Notice<'_>) {
            if let Notice::Trouble(words) = notice {
                self.0.push(words.into());
            }
        }
    }
    for (stated, told) in [(0.0, true), (1.2, false)] {
        let mut config = Config::default();
        config.plant.kind = PlantKind::Robot;
        config.protection.contact_barrier = BarrierReadings::PuLd30;
        config.protection.foam_credible = stated;
        config.telemetry.listen = String::new();
        config.flight_recorder.folder = String::new();
        (config.realtime.priority, config.realtime.lock_memory, config.realtime.dma_latency) =
            (0, false, false);
        let options = Options { config, ..Options::default() };
        let connect = |_: &DriverWords| Err::<Scripted, _>(anyhow::anyhow!("nobody is there"));
        let mut troubles = Troubles(Vec::new());
        let why = with_plant(&options, connect, Timer::new, &Arc::default(), &mut troubles).unwrap_err();
        assert!(why.to_string().contains("nobody is there"), "{why}");
        assert_eq!(
            troubles.0.iter().any(|words| words.contains("1.5 times as stiff")),
            told,
            "{:?}",
            troubles.0
        );
    }
}

#[test]
fn a_robot_of_ones_own_is_recorded_and_replayed_with_its_link() {
    let mut config = Config::default();
    (config.plant.kind, config.plant.parts) = (PlantKind::Robot, Parts::Arm);
    config.telemetry.listen = String::new();
    config.flight_recorder.folder = String::new();
    (config.realtime.priority, config.realtime.lock_memory, config.realtime.dma_latency) = (0, false, false);
    let log = std::env::temp_dir().join(format!("moca-own-robot-{}.mcap", std::process::id()));
    let _ = std::fs::remove_file(&log);
    let duration = Some(Duration::from_millis(700));
    let options = Options { config, duration, record: Some(log.clone()), ..Options::default() };
    let arm = ArmLink { mode: ArmMode::Torque, success_rate: 0.5, lost: 7, ..ArmLink::default() };
    let connect = |words: &DriverWords| {
        words.say("arm: it is there");
        let (age, order) = (SourceAge::default(), Actuation::Brake);
        Ok(Scripted { state: Ok(at_home()), age, link: arm, order, recoveries: 0 })
    };
    let run = with_plant(&options, connect, Timer::new, &Arc::new(Shared::default()), &mut Silent).unwrap();
    let mut links = 0;
    for record in &mut LogReader::open(&log).unwrap() {
        if let Record::Sample(sample) = record {
            assert_eq!(sample.link.unwrap().arm, arm);
            links += 1;
        }
    }
    assert!(links > 0);
    let report = replay::run(std::slice::from_ref(&log)).unwrap();
    assert_eq!(report.compared + report.without_sample, run.report.ticks);
    std::fs::remove_file(&log).unwrap();
}
