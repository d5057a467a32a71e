//! The running daemon as a dashboard meets it, and a board that goes away and comes back.
#![allow(
    clippy::unwrap_used,
    clippy::expect_used,
    clippy::panic,
    reason = "a test that cannot go on has to stop"
)]

use moca_control::config::{Config, HandConfig};
use moca_lockstep::LockStep;
use moca_lockstep::simulated_robot::free_scene;
use moca_msgs::robot::PANDA;
use moca_msgs::{BoardFault, Fault, Mode, Refusal, Request, Sample, TaxelStatus};
use moca_sim::{PtyBoard, SharedForces, VirtualBoardConfig};
use moca_tactile::serial::{PortSelection, SerialBoard};
use moca_tactile::{Cover, CoverConfig};
use moca_telemetry::net::{Address, Connection, Link, Ports, request_channel, serve};
use moca_telemetry::{ParameterDescription, ParameterValue, RobotDescription};
use moca_tests::{Limited, Program};
use std::path::PathBuf;
use std::process::{Command, Stdio};
use std::sync::Arc;
use std::sync::atomic::{AtomicU32, Ordering};
use std::time::{Duration, Instant};

/// Ends a test that would hang; no test passes or fails by how long something took before this.
const HANGS_AFTER: Duration = Duration::from_secs(60);

struct Daemon {
    _process: Program,
    address: Address,
}

impl Daemon {
    fn start(name: &str) -> Self {
        static NUMBER: AtomicU32 = AtomicU32::new(0);
        let number = NUMBER.fetch_add(1, Ordering::Relaxed);
        let address = Address::Unix(
            std::env::temp_dir().join(format!("moca-remote-{}-{number}.sock", std::process::id())),
        );
        let config = PathBuf::from(env!("CARGO_TARGET_TMPDIR")).join(name);
        let text = format!("[telemetry]\nlisten = \"{address}\"\n[simulation.hand]\ntaxels = []\n");
        std::fs::write(&config, text).unwrap();
        let mut command = Command::new(env!("CARGO_BIN_EXE_mocad-under-test"));
        command.args(["--config", config.to_str().unwrap()]).stdout(Stdio::null());
        Self { _process: command.start().unwrap(), address }
    }
}

impl Daemon {
    /// One that has armed itself after its automatic tare. On a machine so busy that even the virtual board is silent
    /// for too long it rightly stops instead: then another one is started.
    fn armed(name: &str) -> (Self, Connection) {
        for _ in 0..10 {
            let daemon = Self::start(name);
            let connection = Connection::spawn(&daemon.address, || {}).unwrap();
            let settled = |s: &Sample| matches!(s.mode, Mode::Impedance | Mode::ProtectiveStop);
            if wait_for(&connection, "armed or stopped", settled).mode == Mode::Impedance {
                return (daemon, connection);
            }
        }
        panic!("ten daemons stopped before they were armed");
    }
}

/// Polls until a sample satisfies `wanted`.
fn wait_for(connection: &Connection, what: &str, mut wanted: impl FnMut(&Sample) -> bool) -> Sample {
    let until = Instant::now() + HANGS_AFTER;
    let mut last = None;
    while Instant::now() < until {
        connection.alive();
        for sample in connection.poll().samples {
            if wanted(&sample) {
                return sample;
            }
            last = Some(sample);
        }
        std::thread::sleep(Duration::from_millis(5));
    }
    panic!("never saw: {what}; last sample {last:?}");
}

fn answer(connection: &Connection, request: Request) -> moca_msgs::Outcome {
    connection.request(request);
    let until = Instant::now() + HANGS_AFTER;
    while Instant::now() < until {
        if let Some(reply) = connection.poll().replies.first() {
            assert_eq!(reply.request, request);
            return reply.outcome;
        }
        std::thread::sleep(Duration::from_millis(2));
    }
    panic!("no answer to {request:?}");
}

fn mocad(arguments: &[&str]) -> std::process::Output {
    Command::new(env!("CARGO_BIN_EXE_mocad-under-test")).args(arguments).run().unwrap()
}

#[test]
fn parameter_set_by_command_line_is_seen_by_clients() {
    let daemon = Daemon::start("parameters.toml");
    let connection = Connection::spawn(&daemon.address, || {}).unwrap();
    wait_for(&connection, "a sample", |_| true);
    let value = || match connection.poll().link {
        Link::Up { description, .. } => {
            let named = |p: &&ParameterDescription| p.name == "control.gains.virtual_mass";
            description.parameters.iter().find(named).unwrap().value.clone()
        }
        Link::Down { reason } => panic!("{reason}"),
    };
    assert_eq!(value(), ParameterValue::Numbers(vec![4.0, 4.0, 2.0]));
    let address = daemon.address.to_string();
    let set = mocad(&["params", "set", "virtual_mass", "[8, 8, 4]", "--address", &address]);
    assert!(set.status.success(), "{}", String::from_utf8_lossy(&set.stderr));
    // A client that comes later is told as well.
    let listed = mocad(&["params", "list", "virtual_mass", "--address", &address]);
    let listed = String::from_utf8(listed.stdout).unwrap();
    assert!(listed.contains("control.gains.virtual_mass = [8.0, 8.0, 4.0] kg, kg, kg·m²"), "{listed}");
    assert!(listed.contains("(live; 0.01 to 1000; default [4.0, 4.0, 2.0])"), "{listed}");
    let until = Instant::now() + HANGS_AFTER;
    while value() != ParameterValue::Numbers(vec![8.0, 8.0, 4.0]) {
        assert!(Instant::now() < until, "the client never saw the new value");
        std::thread::sleep(Duration::from_millis(5));
    }
    for (name, new, said) in [
        ("damping_ratio", "7", "control.gains.damping_ratio = 7 is outside 0 to 5"),
        (
            "virtual_mass",
            "[8, 8, 2000]",
            "control.gains.virtual_mass = 2000 kg·m² is outside 0.01 to 1000 kg·m²",
        ),
        ("virtual_mass", "8", "control.gains.virtual_mass has 3 elements, not 1"),
        ("virtual_mass", "[0.1, 8, 8]", "null_space_damping needs a virtual mass of 0.5 kg or more"),
        ("torque_nm", "[1, 1, 1, 1, 1, 1, 1]", "limits.torque_nm is read at the start only"),
        ("rate_hz", "500", "loop.rate_hz is read at the start only"),
        ("nonsense", "1", "no parameter is called nonsense"),
    ] {
        let refused = mocad(&["params", "set", name, new, "--address", &address]);
        let text = String::from_utf8(refused.stderr).unwrap();
        assert_eq!(refused.status.code(), Some(4), "{name} = {new}: {text}");
        assert!(text.contains(said), "{name} = {new}: {text}");
    }
}

#[test]
fn second_client_may_only_stop() {
    let (daemon, one) = Daemon::armed("remote.toml");
    let other = Connection::spawn(&daemon.address, || {}).unwrap();
    wait_for(&other, "the same", |s| s.mode == Mode::Impedance);

    assert_eq!(answer(&one, Request::PressTaxel { taxel: 5, force_n: 20.0 }), Ok(()));
    wait_for(&one, "the base gives way", |s| s.taxels[5].force_n > 5.0 && s.base_pose_world[0] < -0.02);
    assert_eq!(answer(&one, Request::PressTaxel { taxel: 11, force_n: 20.0 }), Err(Refusal::OutOfRange));
    assert_eq!(answer(&one, Request::PressTaxel { taxel: 5, force_n: 1e9 }), Err(Refusal::OutOfRange));

    assert_eq!(answer(&other, Request::Disarm), Err(Refusal::NotCommander));
    assert_eq!(answer(&other, Request::Stop), Ok(()), "stop is taken from anyone");
    let stopped = wait_for(&one, "protective stop", |s| s.mode == Mode::ProtectiveStop);
    assert_eq!(stopped.fault, Some(Fault::OperatorStop));

    assert_eq!(answer(&one, Request::PressTaxel { taxel: 5, force_n: 0.0 }), Ok(()));
    assert_eq!(answer(&one, Request::Arm), Err(Refusal::Mode(Mode::ProtectiveStop)));
    assert_eq!(answer(&one, Request::Resume), Ok(()));
    wait_for(&one, "nobody touches it", |s| s.taxels.iter().all(|taxel| taxel.force_n == 0.0));
    assert_eq!(answer(&one, Request::Arm), Ok(()));
    wait_for(&one, "armed again", |s| s.mode == Mode::Impedance);
}

#[test]
fn leaning_moves_flange_and_joints_within_limits() {
    for force_n in [20.0, 150.0, 200.0] {
        let (_daemon, client) = Daemon::armed("leaning.toml");
        let first = wait_for(&client, "a sample", |s| s.mode == Mode::Impedance);
        assert_eq!(answer(&client, Request::PressTaxel { taxel: 5, force_n }), Ok(()));
        let (mut moving, mut worst_m, mut joint_share, mut base_m) = (0, 0.0_f64, 0.0_f64, 0.0_f64);
        let mut see = |s: &Sample| {
            if s.mode.moves() {
                moving += 1;
                let off_m = |i: usize| s.flange_position_world[i] - first.flange_position_world[i];
                worst_m = worst_m.max((0..3).map(|i| off_m(i).powi(2)).sum::<f64>().sqrt());
                base_m = base_m.max(first.base_pose_world[0] - s.base_pose_world[0]);
            }
            let share = |(dq, most): (&f64, f64)| dq.abs() / most;
            joint_share = s.dq_rad_s.iter().zip(PANDA.dq_max_rad_s).map(share).fold(joint_share, f64::max);
            s.tick > first.tick + 3000 || !s.mode.moves()
        };
        let last = wait_for(&client, "three seconds of it, or a stop", &mut see);
        println!(
            "{force_n} N: {moving} samples, flange {:.2} mm, joints {:.0} %, base {base_m:.3} m, {:?}",
            1e3 * worst_m,
            100.0 * joint_share,
            last.fault
        );
        // 200 N saturate the taxel; a board that is late on a busy machine is a rightful stop, too
        let thrown =
            matches!(last.fault, Some(Fault::JointSpeed { .. } | Fault::FlangeSpeed | Fault::PoseError));
        assert!(!thrown && moving > if last.mode.moves() { 1000 } else { 0 }, "{moving}, {:?}", last.fault);
        assert!(worst_m < 0.010 && joint_share < 1.0, "{worst_m} m, {joint_share}");
    }
}

#[test]
fn unstable_change_is_refused_with_stable_value() {
    let (daemon, client) = Daemon::armed("unstable.toml");
    let address = daemon.address.to_string();
    let set = |name: &str, value: &str| {
        let output = mocad(&["params", "set", name, value, "--address", &address]);
        (output.status.success(), String::from_utf8(output.stderr).unwrap())
    };
    let (done, said) = set("stiffness", "[1e5, 1e5, 1e5, 1e5, 1e5, 1e5]");
    println!("{said}");
    assert!(
        !done && said.contains("not stable with this robot at this rate and posture; on the way there ["),
        "{said}"
    );
    assert!(said.contains("its range is 0 to 100000 N/m"), "{said}");
    let (done, said) = set("posture_stiffness", "[1e4, 1e4, 1e4, 1e4, 1e4, 1e4, 1e4]");
    assert!(!done && said.contains("not stable"), "{said}");
    let (done, said) = set("stiffness", "[1000, 1000, 1000, 60, 60, 60]");
    assert!(done, "{said}");
    wait_for(&client, "it still runs", |s| s.mode == Mode::Impedance);
}

#[test]
fn vanished_flooding_client_leaves_robot_stopped() {
    let mut config = Config::default();
    config.simulation.hand = HandConfig::none();
    let mut world =
        LockStep::with_board(&config, &free_scene(&config), VirtualBoardConfig::default(), None).unwrap();
    let mut mode = Mode::Starting;
    while mode != Mode::Impedance {
        mode = world.step(None).0.mode;
    }
    let (sender, mut requests) = request_channel();
    let samples = rtrb::RingBuffer::new(1).1;
    let ports = Ports {
        samples,
        requests: sender,
        ring_dropped: Arc::default(),
        recorder: None,
        calibration: None,
        judge: None,
    };
    let socket = std::env::temp_dir().join(format!("moca-flooded-{}.sock", std::process::id()));
    let server =
        serve(&Address::Unix(socket), 0o600, RobotDescription::paper("flooded", true), ports).unwrap();
    let client = Connection::spawn(server.address().clone(), || {}).unwrap();
    let until = Instant::now() + HANGS_AFTER;
    while !matches!(client.poll().link, Link::Up { .. }) {
        assert!(Instant::now() < until, "never connected");
    }
    // The loop takes none of them for now: its ring of 64 is full long before the end.
    for _ in 0..3 {
        [Request::Disarm, Request::Resume, Request::Arm]
            .iter()
            .cycle()
            .take(50)
            .for_each(|r| client.request(*r));
        std::thread::sleep(Duration::from_millis(100));
    }
    drop(client);
    while server.stats().clients > 0 {
        assert!(Instant::now() < until, "the server never noticed");
    }
    for _ in 0..200 {
        let (ticket, request) = requests.take().unzip();
        let (sample, outcome) = world.step(request);
        if let Some((ticket, outcome)) = ticket.zip(outcome) {
            requests.answer(ticket, outcome);
        }
        assert!(!sample.mode.moves(), "{:?}", sample.mode);
    }
}

#[test]
fn a_board_that_is_plugged_in_again_is_found_and_needs_a_tare() {
    let path = PathBuf::from(env!("CARGO_TARGET_TMPDIR")).join("touch-board");
    let board = PtyBoard::spawn(VirtualBoardConfig::default(), SharedForces::default(), &path).unwrap();
    let start = Instant::now();
    let port = PortSelection::Path(path.display().to_string());
    let (_reader, mut events) = SerialBoard::spawn(port, start).unwrap();
    let mut cover = Cover::<11>::new(CoverConfig::default()).unwrap();
    let mut wait = |cover: &mut Cover<11>, what: &str, wanted: &dyn Fn(&Cover<11>, Option<Fault>) -> bool| {
        while start.elapsed() < HANGS_AFTER {
            while let Ok(event) = events.pop() {
                cover.event(0, &event);
            }
            let now_ns = u64::try_from(start.elapsed().as_nanos()).unwrap();
            let poll = cover.poll(now_ns);
            if wanted(cover, poll.fault) {
                return now_ns;
            }
            std::thread::sleep(Duration::from_millis(1));
        }
        panic!("never saw: {what}");
    };
    let frames = |cover: &Cover<11>| cover.boards().next().unwrap().stats().frames_good;

    let now_ns = wait(&mut cover, "frames", &|cover, _| frames(cover) > 3);
    cover.start_tare(now_ns);
    wait(&mut cover, "a valid zero and no fault", &|cover, fault| cover.zero_valid() && fault.is_none());

    board.unplug();
    wait(&mut cover, "the port is lost", &|_, fault| fault == Some(BoardFault::Lost.of(0)));
    let link = std::fs::symlink_metadata(&path).map(|metadata| metadata.is_symlink());
    board.replug();
    let before = frames(&cover);
    let now_ns = wait(&mut cover, "frames again", &|cover, _| frames(cover) > before + 3);
    assert!(!cover.zero_valid(), "zero and gain are void after re-enumeration");
    assert!(cover.poll(now_ns).reading.taxels.iter().all(|taxel| taxel.status == TaxelStatus::NoZero));
    assert!(
        std::fs::symlink_metadata(&path).unwrap().is_symlink(),
        "the port kept its name; while away: {link:?}"
    );
    cover.start_tare(now_ns);
    wait(&mut cover, "a valid zero and no fault", &|cover, fault| cover.zero_valid() && fault.is_none());
}
