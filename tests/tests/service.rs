//! The daemon as a service: ready, watchdog, SIGTERM, exit codes.
#![allow(clippy::unwrap_used, reason = "a test that cannot go on has to stop")]

use moca_tests::Limited;
use nix::sys::signal::Signal;
use std::io::Write;
use std::os::fd::OwnedFd;
use std::os::unix::net::UnixDatagram;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
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
    let process = mocad()
        .args(["run", "--log-level", "warning", "--config"])
        .arg(config)
        .env("NOTIFY_SOCKET", &path)
        .env("WATCHDOG_USEC", "200000")
        .start()
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
    process.signal(Signal::SIGTERM).unwrap();
    while !hear().contains("STOPPING=1") {}
    assert_eq!(process.end().unwrap().code(), Some(0), "SIGTERM is the usual end");
}

/// Requests of a real robot's parts to the operating system, and the unit's sandbox. No systemd runs here: this is the
/// text.
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
    assert_eq!(mocad().arg("--config").arg(wrong).run().unwrap().status.code(), Some(2));
    assert_eq!(mocad().arg("--no-such-option").run().unwrap().status.code(), Some(2));
    let elsewhere = ["--as-fast-as-possible", "--duration", "0.1", "--record", "/no/such/folder/x.mcap"];
    assert_eq!(mocad().args(elsewhere).run().unwrap().status.code(), Some(1));
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
        .run()
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
    let output = mocad().args(["--duration", "5", "--config"]).arg(config).run().unwrap();
    let out = String::from_utf8_lossy(&output.stdout);
    assert!(out.contains("mode: ready") && !out.contains("mode: impedance"), "{out}");
    let wrong = file("board-only-virtual.toml", "[plant]\nkind = \"none\"\n");
    let output = mocad().args(["--check", "--config"]).arg(wrong).run().unwrap();
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
    let output =
        mocad().args(["--duration", "5", "--inject", "unplugged@3", "--config"]).arg(config).run().unwrap();
    let out = String::from_utf8_lossy(&output.stdout);
    let files: Vec<_> = std::fs::read_dir(&folder).unwrap().map(|entry| entry.unwrap().path()).collect();
    let [path] = files.as_slice() else { unreachable!("{files:?}\n{out}") };
    assert!(out.contains(path.to_str().unwrap()), "{out}");
    let log = moca_telemetry::log::read_log(path).unwrap();
    let last = log.samples.last().unwrap();
    assert_eq!((last.fault, log.cut), (Some(moca_msgs::BoardFault::Lost.of(0)), None));
    assert!(!log.serial.is_empty() && log.samples.iter().any(|sample| sample.mode.moves()));
    std::fs::remove_dir_all(&folder).unwrap();
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
    let process = mocad().args(["--duration", "3"]).args(arguments).stdout(writes).start().unwrap();
    assert_eq!(process.end().unwrap().code(), Some(0));
    assert!(is_closed(&log) > 50);
}

#[test]
fn blocked_terminal_does_not_stop_run_or_sigterm() {
    let (arguments, log) = recorded("stalled-stdout");
    let (_reads, mut writes) = std::io::pipe().unwrap();
    let fd = OwnedFd::from(writes.try_clone().unwrap());
    nix::fcntl::fcntl(&fd, nix::fcntl::FcntlArg::F_SETFL(nix::fcntl::OFlag::O_NONBLOCK)).unwrap();
    while writes.write(&[b'.'; 4096]).is_ok() {}
    while writes.write(b".").is_ok() {}
    nix::fcntl::fcntl(&fd, nix::fcntl::FcntlArg::F_SETFL(nix::fcntl::OFlag::empty())).unwrap();

    let process = mocad().args(arguments).stdout(writes).start().unwrap();
    std::thread::sleep(Duration::from_secs(4));
    process.signal(Signal::SIGTERM).unwrap();
    assert_eq!(process.end().unwrap().code(), Some(0));
    assert!(is_closed(&log) > 50, "clients were fed all the time");
}

#[test]
fn panic_on_any_thread_ends_run_and_closes_log() {
    let faults = [("panic-loop", "injected into the loop"), ("panic-client", "injected into a client")];
    let lock_step: &[&str] = &["--as-fast-as-possible", "--duration", "60"];
    for ((fault, words), how) in faults.into_iter().flat_map(|fault| [(fault, &[][..]), (fault, lock_step)]) {
        let (arguments, log) = recorded(fault);
        let process =
            mocad().args(["--inject", &format!("{fault}@1.5")]).args(how).args(arguments).start().unwrap();
        let output = process.output().unwrap();
        assert_eq!(output.status.code(), Some(1), "{fault}");
        let said = String::from_utf8_lossy(&output.stderr);
        assert!(said.contains(words) && said.contains("thread"), "{fault}: {said}");
        assert!(is_closed(&log) > 10, "{fault}");
    }
}

/// Without a handler SIGXFSZ ends a process; nobody outside has to know that.
#[test]
fn file_size_limit_ends_log_but_not_run() {
    let (arguments, log) = recorded("file-limit");
    // 128 blocks of 512 or 1024 bytes: a log's first seconds have more.
    let command = format!(
        "ulimit -f 128; exec {} --duration 5 {}",
        env!("CARGO_BIN_EXE_mocad-under-test"),
        arguments.join(" ")
    );
    let output = Command::new("sh").args(["-c", &command]).run().unwrap();
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
    let process = mocad()
        .arg("--config")
        .arg(config)
        .env("RUNTIME_DIRECTORY", &folder)
        .stdout(Stdio::null())
        .start()
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
    let shows = folder.join("watch.sock");
    assert_eq!(std::fs::metadata(&shows).unwrap().permissions().mode() & 0o777, 0o666);
    let read_only = format!("unix:{}", shows.display());
    let refused = mocad().args(["tare", "--address", &read_only]).run().unwrap();
    assert_eq!(refused.status.code(), Some(4), "{refused:?}");
    let stopped = mocad().args(["stop", "--address", &read_only]).run().unwrap();
    assert_eq!(stopped.status.code(), Some(0), "{stopped:?}");
    let listed = mocad().args(["params", "list", "damping_ratio", "--address", &address]).run().unwrap();
    assert!(String::from_utf8_lossy(&listed.stdout).contains("damping_ratio"), "{listed:?}");
    process.signal(Signal::SIGTERM).unwrap();
    assert_eq!(process.end().unwrap().code(), Some(0));
    assert!(!socket.exists() && !shows.exists(), "the sockets go with the daemon");
    std::fs::remove_dir_all(folder).unwrap();
}

#[test]
fn default_run_listens_on_a_socket_file_of_its_user_alone() {
    use std::os::unix::fs::PermissionsExt;
    let folder = std::env::temp_dir().join(format!("mocad-user-{}", std::process::id()));
    std::fs::create_dir_all(&folder).unwrap();
    let config = file("user.toml", "[flight_recorder]\nfolder = \"\"\n[simulation.hand]\ntaxels = []\n");
    let mine = |mut command: Command| {
        command.env("XDG_RUNTIME_DIR", &folder).env_remove("RUNTIME_DIRECTORY");
        command
    };
    let process = mine(mocad()).arg("--config").arg(config).stdout(Stdio::null()).start().unwrap();
    let socket = folder.join("mocad/telemetry.sock");
    let until = Instant::now() + HANGS_AFTER;
    while !socket.exists() {
        assert!(Instant::now() < until, "no socket");
        std::thread::sleep(Duration::from_millis(10));
    }
    let mode = |path: &Path| std::fs::metadata(path).unwrap().permissions().mode() & 0o777;
    assert_eq!((mode(&socket), mode(&folder.join("mocad"))), (0o600, 0o700));
    // Clients look there by themselves.
    let address = format!("unix:{}", socket.display());
    assert!(
        String::from_utf8_lossy(&mine(mocad()).args(["stop", "--help"]).run().unwrap().stdout)
            .contains(&address)
    );
    assert_eq!(mine(mocad()).arg("stop").run().unwrap().status.code(), Some(0));
    assert_eq!(mine(mocad()).arg("status").run().unwrap().status.code(), Some(0));
    process.signal(Signal::SIGTERM).unwrap();
    assert_eq!(process.end().unwrap().code(), Some(0));
    std::fs::remove_dir_all(folder).unwrap();
}

#[test]
fn port_is_served_with_a_token_file_of_mode_0600_only() {
    use std::os::unix::fs::PermissionsExt;
    let token = PathBuf::from(env!("CARGO_TARGET_TMPDIR")).join(format!("token-{}", std::process::id()));
    let _ = std::fs::remove_file(&token);
    let text = format!(
        "[telemetry]\nlisten = \"127.0.0.1:0\"\ntoken = \"{}\"\n[flight_recorder]\nfolder = \"\"\n",
        token.display()
    );
    let config = file("port.toml", &text);
    let run = || {
        mocad().args(["--as-fast-as-possible", "--duration", "0.1", "--config"]).arg(&config).run().unwrap()
    };
    let made = run();
    assert_eq!(made.status.code(), Some(0), "{made:?}");
    assert_eq!(std::fs::metadata(&token).unwrap().permissions().mode() & 0o777, 0o600);
    std::fs::set_permissions(&token, std::fs::Permissions::from_mode(0o644)).unwrap();
    let refused = run();
    let said = String::from_utf8_lossy(&refused.stderr);
    assert!(
        !refused.status.success() && said.contains("0644") && said.contains(token.to_str().unwrap()),
        "{said}"
    );
    std::fs::remove_file(token).unwrap();
}

#[test]
fn recording_is_not_for_every_user() {
    use std::os::unix::fs::PermissionsExt;
    let (arguments, log) = recorded("mode");
    let run = mocad().args(["--as-fast-as-possible", "--duration", "0.2"]).args(arguments).run().unwrap();
    assert_eq!(run.status.code(), Some(0), "{run:?}");
    assert_eq!(std::fs::metadata(&log).unwrap().permissions().mode() & 0o137, 0, "0640 or stricter");
    std::fs::remove_file(log).unwrap();
}
