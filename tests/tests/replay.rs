//! Record and replay: an eventful run comes out the same bit for bit, and whatever is not the same is found.
#![allow(
    clippy::unwrap_used,
    clippy::expect_used,
    clippy::panic,
    reason = "a test that cannot go on has to stop"
)]

use moca_control::config::{BarrierReadings, Config, HandConfig};
use moca_control::robot::{FlangeSensorKind, GripperKind};
use moca_daemon::record::flight_recorder::FlightRecorder;
use moca_daemon::record::recording::{configuration, parameter_change};
use moca_daemon::record::tick_blocks::BlockBuilder;
use moca_daemon::record::tick_log::{PortEvent, TickLog, TickLogReader, TickRecord, tick_log};
use moca_daemon::runtime::replay::{self, Failure};
use moca_lockstep::simulated_robot::free_scene;
use moca_lockstep::touch_board::ByteCover;
use moca_lockstep::{LockStep, MemoryBoards};
use moca_msgs::params::CONTROLLER;
use moca_msgs::{
    GripperRequest, Law, Mode, ParameterValues, Request, Sample, Target, TimedTarget, TouchPolicy, Waypoint,
};
use moca_sim::VirtualBoardConfig;
use moca_tactile::Firmware;
use moca_tactile::calibration::Quality;
use moca_tactile::calibration::file::{CalibrationFile, TaxelEntry};
use moca_tactile::model::{MonotoneCurve, TaxelModel};
use moca_telemetry::RobotDescription;
use moca_telemetry::log::records::Configuration;
use moca_telemetry::log::{LogWriter, Meta, read_log};
use std::fs::File;
use std::io::BufWriter;
use std::path::PathBuf;

const GRASP: GripperRequest =
    GripperRequest::Grasp { width_m: 0.05, speed_m_s: 0.1, force_n: 40.0, tolerance_m: 0.005, mass_kg: 0.5 };

struct Run {
    world: LockStep<ByteCover, MemoryBoards>,
    loop_end: TickLog,
    log: TickLogReader,
    records: Vec<TickRecord>,
    samples: Vec<Sample>,
}

impl Run {
    fn start(config: &Config) -> Self {
        let (loop_end, copies, reader) = tick_log();
        let board = VirtualBoardConfig { seed: 1, ..VirtualBoardConfig::default() };
        let world = LockStep::with_board(config, &free_scene(config), board, Some(copies)).unwrap();
        Self { world, loop_end, log: reader, records: Vec::new(), samples: Vec::new() }
    }

    fn ask(&mut self, request: Request) {
        self.step(Some(request));
    }

    fn step(&mut self, request: Option<Request>) {
        self.world.tick(request);
        let ticked = self.world.control.ticked();
        self.loop_end.push(ticked.input, || self.world.control.state());
        self.samples.push(ticked.sample.clone());
        self.records.extend(std::iter::from_fn(|| self.log.next_tick()));
    }

    fn run(&mut self, ticks: usize) -> Mode {
        (0..ticks).for_each(|_| self.step(None));
        self.samples.last().unwrap().mode
    }
}

fn config() -> Config {
    let mut config = Config::default();
    config.simulation.hand = HandConfig::none();
    config
}

fn set(name: &str, values: &[f64]) -> Request {
    let number = CONTROLLER.iter().position(|spec| spec.name == name).unwrap();
    let values = ParameterValues::new(values).unwrap();
    Request::SetParameter { parameter: u8::try_from(number).unwrap(), values }
}

fn write(name: &str, config: &Config, records: &[TickRecord], samples: &[Sample]) -> PathBuf {
    write_as(moca_daemon::VERSION, name, config, records, samples)
}

/// As a program of this version would.
fn write_as(
    version: &str,
    name: &str,
    config: &Config,
    records: &[TickRecord],
    samples: &[Sample],
) -> PathBuf {
    let path = PathBuf::from(env!("CARGO_TARGET_TMPDIR")).join(name);
    let _ = std::fs::remove_file(&path);
    let meta = Meta { description: RobotDescription::paper("test", true), start_unix_ns: 0 };
    let mut log = LogWriter::new(BufWriter::new(File::create_new(&path).unwrap()), &meta).unwrap();
    log.configuration(&Configuration { version: version.into(), ..configuration(config).unwrap() }).unwrap();
    let mut samples = samples.iter().peekable();
    let mut blocks = BlockBuilder::new(1e-3);
    for record in records {
        let slot = record.input.slot;
        let mut block = blocks.tick(record.clone());
        while let Some(sample) = samples.next_if(|sample| sample.tick <= slot.tick) {
            log.sample(sample).unwrap();
            block = block.or(blocks.sample(sample));
        }
        if let Some(change) = parameter_change(record) {
            log.parameter(slot.now_ns, &change).unwrap();
        }
        if let Some((time_ns, block)) = block {
            log.replay(time_ns, &block).unwrap();
        }
    }
    for (time_ns, block) in blocks.finish() {
        log.replay(time_ns, &block).unwrap();
    }
    log.finish().unwrap();
    path
}

fn failure(path: &std::path::Path) -> Failure {
    replay::run(&[path.to_owned()]).unwrap_err().downcast::<Failure>().unwrap()
}

#[test]
fn grasp_comes_out_the_same_and_a_changed_one_is_found() {
    let mut config = config();
    config.plant.gripper = GripperKind::Simulated;
    config.simulation.truth.object.mass_kg = 0.5;
    let mut run = Run::start(&config);
    assert_eq!(run.run(1500), Mode::Impedance);
    let wide = GripperRequest::Move { width_m: 1.0, speed_m_s: 0.1 };
    for request in [GRASP, wide, GripperRequest::Stop, GripperRequest::Release] {
        run.ask(Request::Gripper(request));
        run.run(700);
    }
    let held =
        run.samples.iter().filter(|sample| sample.gripper.is_some_and(|state| state.is_holding())).count();
    assert!(held > 1500, "{held}");
    let path = write("gripper.mcap", &config, &run.records, &run.samples);
    assert_eq!(replay::run(std::slice::from_ref(&path)).unwrap().compared, run.samples.len() as u64);
    let logged = read_log(&path).unwrap();
    let shown =
        logged.samples.iter().find(|sample| sample.gripper.is_some_and(|state| state.is_holding())).unwrap();
    assert_eq!(shown.gripper, run.samples[usize::try_from(shown.tick).unwrap()].gripper);

    let mut records = run.records;
    let changed = records
        .iter()
        .position(|record| record.input.gripper.is_some_and(|state| state.is_holding()))
        .unwrap();
    records[changed].input.gripper.as_mut().unwrap().width_m += 1e-15;
    let path = write("gripper-changed.mcap", &config, &records, &run.samples);
    let Failure::Differs { tick, .. } = failure(&path) else { panic!("it differs") };
    assert_eq!(tick, records[changed].input.slot.tick);
}

#[test]
fn a_run_that_is_led_from_outside_comes_out_the_same() {
    let mut run = Run::start(&config());
    assert_eq!(run.run(1500), Mode::Impedance);
    let start = run.samples.last().unwrap().clone();
    let at = |by: f64| {
        let [x, y, z] = start.flange_desired_position_world;
        ([x + by, y - by, z], start.flange_desired_quaternion_world)
    };
    for i in 0..40 {
        let (position_world, quaternion_world) = at(0.002 * f64::from(i));
        run.ask(Request::Target(TimedTarget::new(Target::Pose { position_world, quaternion_world })));
        run.run(30);
    }
    for (index, time_s) in [(0, 0.0), (1, 1.0)] {
        let (position_world, quaternion_world) = at(0.05 * time_s);
        let waypoint = Waypoint { time_s, position_world, quaternion_world };
        run.ask(Request::Waypoint { index, count: 2, waypoint, touch: TouchPolicy::TouchWins });
    }
    run.run(500);
    run.ask(Request::SelectLaw(Law::FollowMe));
    run.run(100);
    let velocity_body = [0.05, 0.0, 0.1];
    run.ask(Request::Target(TimedTarget::new(Target::BaseVelocity { velocity_body })));
    run.run(400);
    let led = run.samples.iter().filter(|sample| sample.target.is_some()).count();
    assert!(led > 1500, "{led}");
    let path = write("led.mcap", &config(), &run.records, &run.samples);
    let report = replay::run(&[path]).unwrap();
    assert_eq!(report.compared, run.samples.len() as u64);
}

#[test]
fn run_with_flange_sensor_replays_bit_equal() {
    let mut config = config();
    config.startup.law = Law::FollowMe;
    config.plant.flange_sensor = FlangeSensorKind::Simulated;
    config.robot.tool.mass_kg = 1.0;
    let truth = &mut config.simulation.truth.flange_sensor;
    (truth.bias_n, truth.noise_n, truth.drift_n_s, truth.delay_ms) = ([5.0, -3.0, 8.0], 0.3, 0.01, 3.0);
    let mut run = Run::start(&config);
    assert_eq!(run.run(1500), Mode::FollowMe);
    run.world.control.plant.world.set_flange_wrench_world([0.0, 15.0, 0.0, 0.0, 0.0, 0.0]).unwrap();
    run.run(600);
    run.world.control.plant.set_flange_sensor_silent(true);
    assert_eq!(run.run(50), Mode::ProtectiveStop);
    run.world.control.plant.set_flange_sensor_silent(false);
    run.world.control.plant.world.set_flange_wrench_world([0.0; 6]).unwrap();
    run.run(1500);
    run.ask(Request::Tare);
    run.run(1300);
    run.ask(Request::Resume);
    run.ask(Request::Arm);
    let mode = run.run(200);
    assert_eq!((mode, run.samples.last().unwrap().fault), (Mode::FollowMe, None));
    let path = write("flange.mcap", &config, &run.records, &run.samples);
    assert_eq!(replay::run(&[path]).unwrap().compared, run.samples.len() as u64);

    let mut records = run.records;
    let reading = records[1800].input.flange.as_mut().unwrap();
    reading.wrench[1] += 1e-9;
    let changed = write("flange-changed.mcap", &config, &records, &run.samples);
    assert!(matches!(failure(&changed), Failure::Differs { tick: 1800, .. }));
}

#[test]
fn run_with_faults_and_live_changes_replays_bit_equal() {
    let mut run = Run::start(&config());
    assert_eq!(run.run(1500), Mode::Impedance);
    run.ask(Request::PressTaxel { taxel: 5, force_n: 20.0 });
    run.run(300);
    run.ask(set("control.gains.stiffness", &[300.0, 300.0, 300.0, 20.0, 20.0, 20.0]));
    run.ask(set("control.gains.damping_ratio", &[9.0]));
    run.run(100);
    run.ask(set("control.corrections.null_space_damping", &[0.0]));
    run.ask(Request::SelectLaw(Law::FollowMe));
    assert_eq!(run.run(200), Mode::FollowMe);
    run.world.feed[0].inject(b"\r\nFDAT: 1 2 6658 4\r\nDIFF: -");
    run.world.feed[0].unplug();
    assert_eq!(run.run(200), Mode::ProtectiveStop);
    run.ask(Request::Resume);
    run.ask(Request::PressTaxel { taxel: 5, force_n: 0.0 });
    run.world.feed[0].replug();
    run.run(500);
    run.ask(Request::MaskTaxel { taxel: 2, masked: true });
    run.ask(Request::MaskTaxel { taxel: 2, masked: false });
    run.ask(Request::Tare);
    run.run(1300);
    run.ask(Request::Resume);
    run.ask(Request::Arm);
    assert_eq!(run.run(200), Mode::FollowMe);
    run.ask(Request::Stop);
    assert_eq!(run.run(50), Mode::ProtectiveStop);
    let path = write("eventful.mcap", &config(), &run.records, &run.samples);
    let report = replay::run(std::slice::from_ref(&path)).unwrap();
    assert_eq!((report.compared, report.without_sample, report.cut), (run.samples.len() as u64, 0, None));

    // A log that ends anywhere is compared up to there.
    let bytes = std::fs::read(&path).unwrap();
    std::fs::write(&path, &bytes[..bytes.len() / 3]).unwrap();
    let report = replay::run(std::slice::from_ref(&path)).unwrap();
    assert!(report.cut.is_some() && report.compared > 500, "{report}");
}

#[test]
fn one_bit_is_found_and_a_loss_is_not_taken_for_a_difference() {
    const AT: usize = 1600;
    let mut run = Run::start(&config());
    run.run(1500);
    run.ask(Request::PressTaxel { taxel: 5, force_n: 20.0 });
    assert_eq!(run.run(300), Mode::Impedance);
    let Run { records, samples, .. } = run;
    let flip = |value: &mut f64| *value = f64::from_bits(value.to_bits() ^ 1);

    let mut tampered = records.clone();
    flip(&mut tampered[AT].input.state.as_mut().unwrap().q_rad[3]);
    let found = failure(&write("state.mcap", &config(), &tampered, &samples));
    assert!(matches!(&found, Failure::Differs { tick, .. } if *tick == AT as u64), "{found}");

    // The last bit is found, though the log does not show it; what it shows is named.
    let mut tampered = samples.clone();
    flip(&mut tampered[AT].arm_torque_nm[6]);
    let found = failure(&write("command.mcap", &config(), &records, &tampered));
    let named = matches!(&found, Failure::Differs { tick, quantity, .. } if *tick == AT as u64 && quantity.contains("fingerprint"));
    assert!(named, "{found}");
    tampered[AT].arm_torque_nm[6] += 1e-3;
    let found = failure(&write("visible.mcap", &config(), &records, &tampered));
    let named = matches!(&found, Failure::Differs { tick, quantity, .. } if *tick == AT as u64 && quantity == "arm_torque_nm");
    assert!(named, "{found}");

    // Of another program a difference is said to be perhaps the program's; a loss is not.
    let told = |records: &[TickRecord]| {
        let path = write_as("0.0.9+x86-64-v3", "other_program.mcap", &config(), records, &tampered);
        format!("{:#}", replay::run(&[path]).unwrap_err())
    };
    let differs = told(&records);
    assert!(differs.contains("of mocad 0.0.9+x86-64-v3") && differs.contains("arm_torque_nm"), "{differs}");
    let incomplete = told(&[&records[..AT - 1], &records[AT..]].concat());
    assert!(incomplete.contains("incomplete") && !incomplete.contains("0.0.9"), "{incomplete}");

    let mut tampered = records.clone();
    let bytes =
        tampered[AT..].iter_mut().flat_map(|record| &mut record.events).find_map(|event| match event {
            (_, PortEvent::Bytes(_, bytes)) => bytes.iter_mut().find(|byte| byte.is_ascii_digit()),
            _ => None,
        });
    *bytes.unwrap() ^= 1;
    let found = failure(&write("bytes.mcap", &config(), &tampered, &samples));
    assert!(matches!(&found, Failure::Differs { tick, .. } if *tick >= AT as u64), "{found}");

    let mut lost = records.clone();
    lost.remove(AT);
    let found = failure(&write("lost_tick.mcap", &config(), &lost, &samples));
    let expected = Some(AT as u64 - 1);
    assert!(matches!(&found, Failure::Incomplete { after, .. } if *after == expected), "{found}");

    let mut lost = records.clone();
    let record = lost[AT..].iter_mut().find(|record| !record.events.is_empty()).unwrap();
    record.events.pop();
    let found = failure(&write("lost_bytes.mcap", &config(), &lost, &samples));
    assert!(matches!(&found, Failure::Incomplete { .. }), "{found}");

    let found = failure(&write("mid_run.mcap", &config(), &records[AT..], &samples[AT..]));
    assert_eq!(found, Failure::MidRun { first: AT as u64 });

    let mut gap = samples.clone();
    gap.remove(AT);
    let report = replay::run(&[write("no_sample.mcap", &config(), &records, &gap)]).unwrap();
    assert_eq!((report.compared, report.without_sample), (samples.len() as u64 - 1, 1));
}

/// A run that depends on every file its configuration names; the log has to hold them, for they may be gone.
#[test]
fn calibration_contact_limits_and_geometry_are_in_the_log() {
    let file = |name: &str, text: &str| {
        let path = PathBuf::from(env!("CARGO_TARGET_TMPDIR")).join(name);
        std::fs::write(&path, text).unwrap();
        path
    };
    let mut calibration = CalibrationFile::new("front", Firmware::Stock2018, "2026-01-31", "PU LD30");
    let curve = MonotoneCurve::new(&[[4.0, 5.0], [30.0, 45.0], [84.0, 100.0]]).unwrap();
    let quality = Quality {
        samples: 700,
        rmse_n: 2.0,
        rmse_loading_n: 2.0,
        rmse_unloading_n: 2.0,
        loading_ratio: 1.0,
        worst_n: 9.0,
        counts_max: 84.0,
        force_max_n: 100.0,
    };
    for number in 1..=11 {
        calibration.taxel.push(TaxelEntry::new(number, 719.6, &TaxelModel::Monotone(curve), &quality));
    }
    let files = [
        file("replay-calibration.toml", &calibration.to_toml().unwrap()),
        file("replay-limits.toml", "source = \"a test\"\n[T6]\ntransient_n = 12.0\nquasi_static_n = 12.0\n"),
    ];
    let mut config = config();
    config.board.name = "front".into();
    config.board.calibration = files[0].display().to_string();
    config.protection.thresholds = files[1].display().to_string();
    config.protection.uncalibrated_statement = "a simulated cover, in a test".into();
    config.robot.mount.rpy_rad = [0.0, 0.0, 0.5];

    let mut run = Run::start(&config);
    assert_eq!(run.run(1500), Mode::Impedance);
    run.ask(Request::PressTaxel { taxel: 5, force_n: 25.0 });
    run.run(700);
    assert!(run.samples.iter().any(|sample| sample.contact_reaction.is_some()), "no limit was crossed");
    let path = write("files.mcap", &config, &run.records, &run.samples);
    for file in &files {
        std::fs::remove_file(file).unwrap();
    }
    let report = replay::run(std::slice::from_ref(&path)).unwrap();
    assert_eq!((report.compared, report.without_sample), (run.samples.len() as u64, 0));

    // Without one of them the run is another one: the comparison can fail.
    config.protection.thresholds = String::new();
    config.board.calibration = String::new();
    let other = write("no_files.mcap", &config, &run.records, &run.samples);
    assert!(matches!(failure(&other), Failure::Differs { .. }));
}

/// Returns the log of a flight recorder beside a lock-step run at its first stop, if that comes within `ticks`.
fn flight_log(name: &str, world: &mut Run, recorder: &mut FlightRecorder, ticks: usize) -> PathBuf {
    for _ in 0..ticks {
        if let Some(path) = world.watched(None, recorder) {
            return path;
        }
    }
    unreachable!("{name}: no stop within {ticks} ticks");
}

impl Run {
    /// One tick, which a flight recorder hears of as it does beside a live loop.
    fn watched(&mut self, request: Option<Request>, recorder: &mut FlightRecorder) -> Option<PathBuf> {
        self.world.tick(request);
        let ticked = self.world.control.ticked();
        self.loop_end.push(ticked.input, || self.world.control.state());
        while let Some(state) = self.log.next_state() {
            recorder.add_state(state);
        }
        while let Some(record) = self.log.next_tick() {
            recorder.add_tick(record);
        }
        recorder.add(&ticked.sample)
    }
}

/// Whatever the loop remembers matters here: a law, live parameters on their way through their filter, a touch, a mask,
/// a zero that was taken twice, contacts, a barrier.
#[test]
fn the_last_seconds_of_a_long_run_run_again_whatever_stopped_it() {
    for (fault, law, barrier) in [
        ("unplugged", Law::Impedance, false),
        ("bit-flipped", Law::FollowMe, false),
        ("taxel-noisy", Law::Impedance, true),
        ("command-refused", Law::FollowMe, true),
        ("base-stale", Law::Impedance, false),
    ] {
        let mut config = config();
        // Held from long before the first state that the log keeps.
        config.plant.gripper = GripperKind::Simulated;
        config.simulation.truth.object.mass_kg = 0.5;
        let folder = PathBuf::from(env!("CARGO_TARGET_TMPDIR"))
            .join(format!("replayed-flight-{fault}-{}", std::process::id()));
        config.flight_recorder.folder = folder.display().to_string();
        if barrier {
            config.protection.contact_barrier = BarrierReadings::PuLd30;
        }
        let mut recorder =
            FlightRecorder::new(&config, RobotDescription::paper("test", true)).unwrap().unwrap();
        let mut run = Run::start(&config);
        run.world.inject(&format!("{fault}@13.4").parse().unwrap(), 5);
        let asked = [
            (1500, set("control.gains.stiffness", &[300.0, 300.0, 300.0, 20.0, 20.0, 20.0])),
            (1550, Request::Gripper(GRASP)),
            (1600, Request::Disarm),
            (1700, Request::Tare),
            (3000, Request::Arm),
            (3100, Request::SelectLaw(law)),
            (12_000, Request::PressTaxel { taxel: 5, force_n: 20.0 }),
            (13_300, set("control.gains.damping_ratio", &[0.9])),
        ];
        for tick in 0..13_400 {
            let request = asked.iter().find(|(at, _)| *at == tick).map(|(_, request)| *request);
            assert_eq!(run.watched(request, &mut recorder), None, "{fault}: tick {tick}");
        }
        let path = flight_log(fault, &mut run, &mut recorder, 1600);
        drop(recorder);
        let report =
            replay::run(std::slice::from_ref(&path)).unwrap_or_else(|error| panic!("{fault}: {error:#}"));
        assert!(report.compared > 10_000 && report.compared < 11_010, "{fault}: {report}");
        assert_eq!((report.without_sample, report.cut), (0, None), "{fault}");
        let log = read_log(&path).unwrap();
        assert!(
            log.samples[0].tick > 2300 && log.samples.iter().any(|sample| sample.mode == law.into()),
            "{fault}"
        );
        assert!(log.samples.iter().all(|sample| sample.gripper.is_some_and(|hand| hand.object_kg > 0.0)));
        std::fs::remove_dir_all(folder).unwrap();
    }
}
