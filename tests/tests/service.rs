//! The daemon as a service: ready, watchdog, SIGTERM, exit codes.
#![allow(clippy::unwrap_used, reason = "a test that cannot go on has to stop")]

use nix::sys::signal::{Signal, kill};
use nix::unistd::Pid;
use std::os::unix::net::UnixDatagram;
use std::path::PathBuf;
use std::process::{Command, Stdio};
use std::time::Duration;

/// Ends a test that would hang.
const HANGS_AFTER: Duration = Duration::from_secs(60);

fn file(name: &str, text: &str) -> PathBuf {
    let path = PathBuf::from(env!("CARGO_TARGET_TMPDIR")).join(name);
    std::fs::write(&path, text).unwrap();
    path
}

fn mocad() -> Command {
    let mut mocad = Command::new(env!("CARGO_BIN_EXE_mocad-under-test"));
    mocad.stdout(Stdio::piped()).stderr(Stdio::piped());
    mocad
}

#[test]
fn systemd_hears_ready_the_heartbeat_and_the_end() {
    let path = PathBuf::from(env!("CARGO_TARGET_TMPDIR")).join(format!("notify-{}", std::process::id()));
    let _ = std::fs::remove_file(&path);
    let socket = UnixDatagram::bind(&path).unwrap();
    socket.set_read_timeout(Some(HANGS_AFTER)).unwrap();
    let config = file("service.toml", "[telemetry]\nlisten = \"\"\n");
    let mut process = mocad()
        .args(["run", "--log-level", "warning", "--config"])
        .arg(config)
        .env("NOTIFY_SOCKET", &path)
        .env("WATCHDOG_USEC", "200000")
        .spawn()
        .unwrap();
    let hear = || {
        let mut message = [0; 256];
        let length = socket.recv(&mut message).unwrap();
        String::from_utf8_lossy(&message[..length]).into_owned()
    };
    assert!(hear().contains("READY=1"));
    for _ in 0..3 {
        assert_eq!(hear().trim(), "WATCHDOG=1");
    }
    kill(Pid::from_raw(i32::try_from(process.id()).unwrap()), Signal::SIGTERM).unwrap();
    while !hear().contains("STOPPING=1") {}
    assert_eq!(process.wait().unwrap().code(), Some(0), "SIGTERM is the usual end");
}

#[test]
fn exit_codes_tell_a_wrong_configuration_from_another_failure() {
    let wrong = file("wrong.toml", "[loop]\nrate_hz = 5\n");
    assert_eq!(mocad().arg("--config").arg(wrong).output().unwrap().status.code(), Some(2));
    assert_eq!(mocad().arg("--no-such-option").output().unwrap().status.code(), Some(2));
    let elsewhere = ["--as-fast-as-possible", "--duration", "0.1", "--record", "/no/such/folder/x.mcap"];
    assert_eq!(mocad().args(elsewhere).output().unwrap().status.code(), Some(1));
}

/// A disk that is full ends the recording, never the run, and the end of the run says so.
#[test]
fn a_full_disk_costs_the_log_and_is_told() {
    let config = file("full.toml", "[telemetry]\nlisten = \"\"\n");
    let log = PathBuf::from(env!("CARGO_TARGET_TMPDIR")).join(format!("full-{}.mcap", std::process::id()));
    let _ = std::fs::remove_file(&log);
    // A limit on the size of files stands for the full disk: writes beyond 64 blocks fail.
    let limited = "trap '' XFSZ; ulimit -f 64; exec \"$0\" \"$@\"";
    let output = Command::new("sh")
        .args([
            "-c",
            limited,
            env!("CARGO_BIN_EXE_mocad-under-test"),
            "--as-fast-as-possible",
            "--duration",
            "8",
            "--config",
        ])
        .arg(config)
        .arg("--record")
        .arg(&log)
        .output()
        .unwrap();
    let (out, err) = (String::from_utf8_lossy(&output.stdout), String::from_utf8_lossy(&output.stderr));
    assert!(out.contains("8000 in 8.00 s") || out.contains("ticks        8000"), "{out}");
    assert_eq!(output.status.code(), Some(1), "{err}");
    assert!(err.contains(".mcap"), "{err}");
}

#[test]
fn a_board_without_a_robot_is_read_and_nothing_is_armed() {
    let path = PathBuf::from(env!("CARGO_TARGET_TMPDIR")).join(format!("board-{}", std::process::id()));
    let board = moca_sim::PtyBoard::spawn(
        moca_sim::VirtualBoardConfig::default(),
        moca_sim::SharedForces::default(),
        &path,
    );
    let _board = board.unwrap();
    let text = format!(
        "[plant]\nkind = \"none\"\n[board]\nport = \"{}\"\n[telemetry]\nlisten = \"\"\n",
        path.display()
    );
    let config = file("board-only.toml", &text);
    let output = mocad().args(["--duration", "5", "--config"]).arg(config).output().unwrap();
    let out = String::from_utf8_lossy(&output.stdout);
    assert!(out.contains("mode: ready") && !out.contains("mode: impedance"), "{out}");
    let wrong = file("board-only-virtual.toml", "[plant]\nkind = \"none\"\n");
    let output = mocad().args(["--check", "--config"]).arg(wrong).output().unwrap();
    assert_eq!(output.status.code(), Some(2));
    assert!(
        String::from_utf8_lossy(&output.stderr).contains("board.port = \"virtual\" needs a simulated robot")
    );
}

#[test]
fn a_fault_writes_the_seconds_before_it() {
    let folder = PathBuf::from(env!("CARGO_TARGET_TMPDIR")).join(format!("flight-{}", std::process::id()));
    let text = format!("[telemetry]\nlisten = \"\"\n[flight_recorder]\nfolder = \"{}\"\n", folder.display());
    let config = file("flight.toml", &text);
    let output = mocad()
        .args(["--duration", "5", "--inject", "unplugged@3", "--config"])
        .arg(config)
        .output()
        .unwrap();
    let out = String::from_utf8_lossy(&output.stdout);
    let files: Vec<_> = std::fs::read_dir(&folder).unwrap().map(|entry| entry.unwrap().path()).collect();
    let [path] = files.as_slice() else { unreachable!("{files:?}\n{out}") };
    assert!(out.contains(path.to_str().unwrap()), "{out}");
    let log = moca_telemetry::log::read_log(path).unwrap();
    let last = log.samples.last().unwrap();
    assert_eq!((last.fault, log.cut), (Some(moca_msgs::Fault::BoardLost), None));
    assert!(!log.serial.is_empty() && log.samples.iter().any(|sample| sample.mode.moves()));
    std::fs::remove_dir_all(&folder).unwrap();
}
