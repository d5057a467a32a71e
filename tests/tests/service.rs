//! The daemon as a service: ready, watchdog, SIGTERM, exit codes.
#![allow(clippy::unwrap_used, reason = "a test that cannot go on has to stop")]

use nix::sys::signal::{Signal, kill};
use nix::unistd::Pid;
use std::io::Write;
use std::os::fd::OwnedFd;
use std::os::unix::net::UnixDatagram;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

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

/// What the parts of a real robot ask of the operating system, and what the unit's sandbox lets through. No systemd runs here:
/// this is the text.
#[test]
fn the_unit_lets_a_real_robots_drivers_through() {
    let unit = include_str!("../../systemd/mocad.service");
    let value = |key: &str| unit.lines().find_map(|line| line.strip_prefix(key)?.strip_prefix('='));
    assert_eq!(value("LimitRTPRIO"), Some("99"), "the arm's client asks for it first");
    assert_eq!(value("LimitMEMLOCK"), Some("infinity"));
    let families: Vec<_> = value("RestrictAddressFamilies").unwrap().split(' ').collect();
    for needed in ["AF_UNIX", "AF_INET", "AF_NETLINK"] {
        assert!(
            families.contains(&needed),
            "{needed}: telemetry, FCI and DDS, the networks of this PC: {families:?}"
        );
    }
    assert_eq!(value("After"), Some("network-online.target"), "arm and base are behind the network");
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

fn wait(process: &mut Child, what: &str) -> Option<i32> {
    let until = Instant::now() + HANGS_AFTER;
    while Instant::now() < until {
        if let Some(status) = process.try_wait().unwrap() {
            return status.code();
        }
        std::thread::sleep(Duration::from_millis(20));
    }
    process.kill().unwrap();
    unreachable!("{what}: still running after {HANGS_AFTER:?}");
}

/// A log of its own for a run, and its configuration with neither telemetry nor flight recorder.
fn recorded(name: &str) -> (Vec<String>, PathBuf) {
    let text = "[telemetry]\nlisten = \"\"\n[flight_recorder]\nfolder = \"\"\n";
    let config = file(&format!("{name}.toml"), text);
    let log = PathBuf::from(env!("CARGO_TARGET_TMPDIR")).join(format!("{name}-{}.mcap", std::process::id()));
    let _ = std::fs::remove_file(&log);
    let words = ["--config", config.to_str().unwrap(), "--record", log.to_str().unwrap()];
    (words.map(Into::into).to_vec(), log)
}

fn is_closed(log: &Path) -> usize {
    let read = moca_telemetry::log::read_log(log).unwrap();
    assert_eq!(read.cut, None, "the log has its end mark");
    std::fs::remove_file(log).unwrap();
    read.samples.len()
}

#[test]
fn a_terminal_that_goes_away_ends_nothing() {
    let (arguments, log) = recorded("closed-stdout");
    let (reads, writes) = std::io::pipe().unwrap();
    drop(reads);
    let mut process = mocad().args(["--duration", "3"]).args(arguments).stdout(writes).spawn().unwrap();
    assert_eq!(wait(&mut process, "closed stdout"), Some(0));
    assert!(is_closed(&log) > 50);
}

#[test]
fn a_terminal_that_stops_reading_blocks_nothing_and_sigterm_still_ends_the_run() {
    let (arguments, log) = recorded("stalled-stdout");
    let (_reads, mut writes) = std::io::pipe().unwrap();
    let fd = OwnedFd::from(writes.try_clone().unwrap());
    nix::fcntl::fcntl(&fd, nix::fcntl::FcntlArg::F_SETFL(nix::fcntl::OFlag::O_NONBLOCK)).unwrap();
    while writes.write(&[b'.'; 4096]).is_ok() {}
    while writes.write(b".").is_ok() {}
    nix::fcntl::fcntl(&fd, nix::fcntl::FcntlArg::F_SETFL(nix::fcntl::OFlag::empty())).unwrap();

    let mut process = mocad().args(arguments).stdout(writes).spawn().unwrap();
    std::thread::sleep(Duration::from_secs(4));
    kill(Pid::from_raw(i32::try_from(process.id()).unwrap()), Signal::SIGTERM).unwrap();
    assert_eq!(wait(&mut process, "stalled stdout"), Some(0));
    assert!(is_closed(&log) > 50, "clients were fed all the time");
}

#[test]
fn a_panic_on_any_thread_ends_the_run_with_its_log_closed_and_its_words() {
    let faults = [("panic-loop", "injected into the loop"), ("panic-client", "injected into a client")];
    let lock_step: &[&str] = &["--as-fast-as-possible", "--duration", "60"];
    for ((fault, words), how) in faults.into_iter().flat_map(|fault| [(fault, &[][..]), (fault, lock_step)]) {
        let (arguments, log) = recorded(fault);
        let mut process =
            mocad().args(["--inject", &format!("{fault}@1.5")]).args(how).args(arguments).spawn().unwrap();
        assert_eq!(wait(&mut process, fault), Some(1));
        let output = process.wait_with_output().unwrap();
        let said = String::from_utf8_lossy(&output.stderr);
        assert!(said.contains(words) && said.contains("thread"), "{fault}: {said}");
        assert!(is_closed(&log) > 10, "{fault}");
    }
}

/// Without a handler SIGXFSZ ends a process; nobody outside has to know that.
#[test]
fn a_file_at_its_size_limit_ends_the_log_and_not_the_run_and_is_said_at_once() {
    let (arguments, log) = recorded("file-limit");
    // 128 blocks of 512 or 1024 bytes: a log's first seconds have more.
    let command = format!(
        "ulimit -f 128; exec {} --duration 5 {}",
        env!("CARGO_BIN_EXE_mocad-under-test"),
        arguments.join(" ")
    );
    let output = Command::new("sh").args(["-c", &command]).output().unwrap();
    let out = String::from_utf8_lossy(&output.stdout);
    assert_eq!(output.status.code(), Some(1), "no signal ended it: {output:?}");
    let said = out.find("nothing is recorded any more: cannot write the log");
    let ended = out.rfind(" ticks").unwrap_or(out.len());
    assert!(said.is_some_and(|said| said < ended), "not said while the run went on: {out}");
    let read = moca_telemetry::log::read_log(&log).unwrap();
    assert!(read.cut.is_some() && !read.samples.is_empty(), "{:?}", read.cut);
    std::fs::remove_file(log).unwrap();
}

#[test]
fn a_service_listens_on_a_socket_file_with_its_mode() {
    use std::os::unix::fs::{FileTypeExt, PermissionsExt};
    // A socket's path has at most 107 bytes.
    let folder = std::env::temp_dir().join(format!("mocad-run-{}", std::process::id()));
    std::fs::create_dir_all(&folder).unwrap();
    let socket = folder.join("telemetry.sock");
    let config = file("socket.toml", "[telemetry]\nmode = \"0640\"\n[flight_recorder]\nfolder = \"\"\n");
    let mut process = mocad()
        .arg("--config")
        .arg(config)
        .env("RUNTIME_DIRECTORY", &folder)
        .stdout(Stdio::null())
        .spawn()
        .unwrap();
    let until = Instant::now() + HANGS_AFTER;
    while !socket.exists() {
        assert!(Instant::now() < until, "no socket");
        std::thread::sleep(Duration::from_millis(10));
    }
    let metadata = std::fs::metadata(&socket).unwrap();
    assert!(metadata.file_type().is_socket());
    assert_eq!(metadata.permissions().mode() & 0o777, 0o640);
    let address = format!("unix:{}", socket.display());
    let listed = mocad().args(["params", "list", "damping_ratio", "--address", &address]).output().unwrap();
    assert!(String::from_utf8_lossy(&listed.stdout).contains("damping_ratio"), "{listed:?}");
    kill(Pid::from_raw(i32::try_from(process.id()).unwrap()), Signal::SIGTERM).unwrap();
    assert_eq!(wait(&mut process, "socket file"), Some(0));
    assert!(!socket.exists(), "the socket goes with the daemon");
    std::fs::remove_dir_all(folder).unwrap();
}
