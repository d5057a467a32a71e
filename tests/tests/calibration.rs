//! A calibration as a dashboard asks for it: beside a real board with a force gauge, and never on a robot that moves.
#![allow(
    clippy::unwrap_used,
    clippy::expect_used,
    clippy::panic,
    reason = "a test that cannot go on has to stop"
)]

use moca_msgs::{Mode, Request};
use moca_sim::{BoardFailure, PtyBoard, SharedForces, VirtualBoardConfig};
use moca_tactile::calibration::CalibrationFile;
use moca_telemetry::calibration::{CalibrationProgress, CalibrationRequest};
use moca_telemetry::net::{Address, Connection};
use moca_tests::{Limited, Program};
use std::io::Read;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::sync::atomic::{AtomicU32, Ordering};
use std::sync::mpsc;
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

/// A board under these forces, and a silent port that says what a test lets a gauge say.
fn board_and_gauge(name: &str) -> (SharedForces, PtyBoard, PtyBoard) {
    let forces = SharedForces::default();
    let board = virtual_board(&format!("{name}-board"), &forces);
    let gauge = virtual_board(&format!("{name}-gauge"), &SharedForces::default());
    gauge.set_fault(Some(BoardFailure::Silent));
    (forces, board, gauge)
}

#[test]
fn taxel_without_robot_is_calibrated_with_gauge() {
    let (forces, board, gauge) = board_and_gauge("calibrated");
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

/// Runs `mocad calibrate`; `press` gets the time since the terminal asked for a press, s, `None` before. Returns what it said on the
/// terminal, and whether it succeeded.
fn calibrate(arguments: &[&str], mut press: impl FnMut(Option<f64>)) -> (String, bool) {
    let mut process = Command::new(env!("CARGO_BIN_EXE_mocad-under-test"))
        .arg("calibrate")
        .args(arguments)
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .start()
        .unwrap();
    let (mut stdout, mut stderr) = (process.stdout.take().unwrap(), process.stderr.take().unwrap());
    let (told, heard) = mpsc::channel();
    let reader = std::thread::spawn(move || {
        let mut bytes = [0; 256];
        while let Ok(count @ 1..) = stdout.read(&mut bytes) {
            let _ = told.send(bytes[..count].to_vec());
        }
    });
    let (mut said, mut asked) = (Vec::new(), None);
    let status = loop {
        said.extend(heard.try_iter().flatten());
        if asked.is_none() && String::from_utf8_lossy(&said).contains("0 of 2") {
            asked = Some(Instant::now());
        }
        press(asked.map(|since| since.elapsed().as_secs_f64()));
        if let Some(status) = process.try_wait().unwrap() {
            break status;
        }
        std::thread::sleep(Duration::from_millis(10));
    };
    reader.join().unwrap();
    said.extend(heard.try_iter().flatten());
    stderr.read_to_end(&mut said).unwrap();
    (String::from_utf8_lossy(&said).into_owned(), status.success())
}

#[test]
fn known_weight_renews_date_of_foam_that_is_as_calibrated() {
    let (forces, board, gauge) = board_and_gauge("weighed");
    let file = temporary("weighed.toml");
    let _ = std::fs::remove_file(&file);
    let [port, gauge_port, out] = [board.path(), gauge.path(), &file].map(|path| path.display().to_string());
    let press = |force_n: f64| forces[4].store(force_n.to_bits(), Ordering::Relaxed);
    let taxel = ["--port", &port, "--taxels", "5:4", "--presses", "2", "--board", "left", "--out", &out];
    let (said, done) = calibrate(&[&taxel[..], &["--gauge", &gauge_port]].concat(), |t_s| {
        let force_n = 30.0 * (1.0 - (std::f64::consts::TAU * t_s.unwrap_or(0.0) / 3.0).cos());
        press(force_n);
        gauge.inject(format!("{force_n:.2} N\r\n").as_bytes());
    });
    assert!(done, "{said}");
    press(0.0);
    let mut calibrated = CalibrationFile::read(&file).unwrap();
    calibrated.date = "2020-02-29".into();
    calibrated.write(&file).unwrap();
    // 4 kg, on for five seconds and off for three
    let weigh = |weight_n: f64| {
        calibrate(&[&taxel[..], &["--check", "--mass", "4"]].concat(), |t_s| {
            press(if t_s.is_some_and(|t_s| t_s % 8.0 < 5.0) { weight_n } else { 0.0 });
        })
    };
    let (said, done) = weigh(1.3 * 39.2);
    assert!(!done && said.contains("times as stiff as calibrated; allowed: 0.9 to 1.1"), "{said}");
    assert_eq!(CalibrationFile::read(&file).unwrap().date, "2020-02-29", "a refused check changes nothing");
    press(0.0);
    let (said, done) = weigh(39.2);
    assert!(done && said.contains("times the calibrated force"), "{said}");
    assert_ne!(CalibrationFile::read(&file).unwrap().date, "2020-02-29", "{said}");
    std::fs::remove_file(&file).unwrap();
}
