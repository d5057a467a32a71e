//! A calibration as a dashboard asks for it: beside a real board with a force gauge, and never on a robot that moves.
#![allow(
    clippy::unwrap_used,
    clippy::expect_used,
    clippy::panic,
    reason = "a test that cannot go on has to stop"
)]

use moca_msgs::{Mode, Request};
use moca_sim::{BoardFault, PtyBoard, SharedForces, VirtualBoardConfig};
use moca_tactile::calibration::CalibrationFile;
use moca_telemetry::calibration::{CalibrationProgress, CalibrationRequest};
use moca_telemetry::net::{Address, Connection};
use moca_tests::{Limited, Program};
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::sync::atomic::{AtomicU32, Ordering};
use std::time::{Duration, Instant};

/// Ends a test that would hang; no test passes or fails by how long something took before this.
const HANGS_AFTER: Duration = Duration::from_secs(120);

fn temporary(name: &str) -> PathBuf {
    PathBuf::from(env!("CARGO_TARGET_TMPDIR")).join(format!("{name}-{}", std::process::id()))
}

struct Daemon(#[expect(dead_code, reason = "ends with its owner")] Program);

impl Daemon {
    fn start(name: &str, text: &str) -> (Self, Connection) {
        static NUMBER: AtomicU32 = AtomicU32::new(0);
        let number = NUMBER.fetch_add(1, Ordering::Relaxed);
        let socket = format!("moca-calibration-{}-{number}.sock", std::process::id());
        let address = Address::Unix(std::env::temp_dir().join(socket));
        let config = temporary(name);
        std::fs::write(&config, format!("[telemetry]\nlisten = \"{address}\"\n{text}")).unwrap();
        let mut command = Command::new(env!("CARGO_BIN_EXE_mocad-under-test"));
        let process = command
            .arg("--config")
            .arg(config)
            .current_dir(env!("CARGO_TARGET_TMPDIR"))
            .stdout(Stdio::null())
            .start()
            .unwrap();
        (Self(process), Connection::spawn(address, || {}).unwrap())
    }

    /// One that reaches `wanted` by itself. On a machine so busy that even the virtual board is silent for too long it
    /// rightly stops instead: then another one is started.
    fn reaching(wanted: Mode, name: &str, text: &str) -> (Self, Connection) {
        for _ in 0..10 {
            let (daemon, connection) = Self::start(name, text);
            let mut reached = None;
            until(&connection, "started or stopped", |_, mode| {
                reached = mode;
                mode == Some(wanted) || mode == Some(Mode::ProtectiveStop)
            });
            if reached == Some(wanted) {
                return (daemon, connection);
            }
        }
        panic!("ten daemons stopped before {wanted:?}");
    }
}

/// Polls every 10 ms until `wanted`, which may act on the way.
fn until(
    connection: &Connection,
    what: &str,
    mut wanted: impl FnMut(&CalibrationProgress, Option<Mode>) -> bool,
) {
    let start = Instant::now();
    let (mut mode, mut last) = (None, CalibrationProgress::Idle);
    while start.elapsed() < HANGS_AFTER {
        let update = connection.poll();
        mode = update.samples.last().map(|s| s.mode).or(mode);
        last = update.calibration;
        if wanted(&last, mode) {
            return;
        }
        std::thread::sleep(Duration::from_millis(10));
    }
    panic!("never saw: {what}; {mode:?}, {last:?}");
}

fn virtual_board(name: &str, forces: &SharedForces) -> PtyBoard {
    let forces = SharedForces::clone(forces);
    PtyBoard::spawn(VirtualBoardConfig::default(), forces, &temporary(name)).unwrap()
}

#[test]
fn taxel_without_robot_is_calibrated_with_gauge() {
    let forces = SharedForces::default();
    let board = virtual_board("calibrated-board", &forces);
    // A silent port that says what the gauge says.
    let gauge = virtual_board("gauge", &SharedForces::default());
    gauge.set_fault(Some(BoardFault::Silent));
    // A configuration that names no calibration gets its file in the daemon's folder.
    let _ = std::fs::remove_file(Path::new(env!("CARGO_TARGET_TMPDIR")).join("calibration.toml"));
    let [port, gauge_port] = [&board, &gauge].map(|device| device.path().display().to_string());
    let text = format!(
        "[plant]\nkind = \"none\"\n[board]\nport = \"{port}\"\nname = \"left\"\ngauge = \"{gauge_port}\"\n"
    );
    let (_daemon, connection) = Daemon::reaching(Mode::Ready, "gauge.toml", &text);

    connection.calibrate(CalibrationRequest::Start { taxel: 4, presses: 2 });
    // A person presses T5 with the gauge to 60 N and lets go, slowly enough for foam and board.
    let mut pressing = None;
    let mut press = |progress: &CalibrationProgress| {
        if let CalibrationProgress::Press { .. } = progress {
            pressing.get_or_insert_with(Instant::now);
        }
        let t_s = pressing.map_or(0.0, |since: Instant| since.elapsed().as_secs_f64());
        let force_n = 30.0 * (1.0 - (std::f64::consts::TAU * t_s / 3.0).cos());
        forces[4].store(force_n.to_bits(), Ordering::Relaxed);
        gauge.inject(format!("{force_n:.2} N\r\n").as_bytes());
    };
    let mut fit = None;
    until(&connection, "fitted", |progress, _| {
        press(progress);
        if let CalibrationProgress::Fitted(fitted) = progress {
            fit = Some(fitted.clone());
        }
        assert!(!matches!(progress, CalibrationProgress::Failed(_)), "{progress:?}");
        fit.is_some()
    });
    let fit = fit.unwrap();
    let monotone = &fit.models[2];
    assert_eq!((fit.taxel, monotone.usable), (4, true));
    assert!(monotone.force_max_n > 55.0 && monotone.rmse_n < 6.0, "{monotone:?}");

    connection.calibrate(CalibrationRequest::Save { model: 2 });
    let mut saved = None;
    until(&connection, "saved", |progress, _| {
        if let CalibrationProgress::Saved { path, taxels } = progress {
            saved = Some((path.clone(), taxels.clone()));
        }
        saved.is_some()
    });
    let (path, taxels) = saved.unwrap();
    let read = CalibrationFile::read(Path::new(&path)).unwrap();
    std::fs::remove_file(&path).unwrap();
    assert_eq!((read.board.as_str(), taxels), ("left", vec![5]));

    // The gauge's cable comes out: no reading, no calibration.
    connection.calibrate(CalibrationRequest::Start { taxel: 4, presses: 2 });
    until(&connection, "at rest", |progress, _| {
        gauge.inject(b"0.0\n");
        matches!(progress, CalibrationProgress::Rest { frames: 1.., .. })
    });
    gauge.unplug();
    until(
        &connection,
        "the lost gauge told",
        |progress, _| matches!(progress, CalibrationProgress::Failed(why) if why.contains("force gauge")),
    );
}

#[test]
fn a_robot_that_moves_is_not_calibrated() {
    let (_daemon, connection) =
        Daemon::reaching(Mode::Impedance, "moves.toml", "[simulation.hand]\ntaxels = []\n");
    let start = CalibrationRequest::Start { taxel: 0, presses: 1 };
    let refused = |progress: &CalibrationProgress, _| matches!(progress, CalibrationProgress::Failed(why) if why.contains("disarm"));
    connection.calibrate(start);
    until(&connection, "refused while it moves", refused);
    connection.request(Request::Disarm);
    until(&connection, "ready", |_, mode| mode == Some(Mode::Ready));
    connection.calibrate(start);
    until(&connection, "begun", |progress, _| matches!(progress, CalibrationProgress::Rest { .. }));
    connection.request(Request::Arm);
    until(&connection, "given up when armed", refused);
}
