//! A day without a screen: a running daemon, commanded by `mocad` alone.
#![allow(
    clippy::unwrap_used,
    clippy::expect_used,
    clippy::panic,
    reason = "a test that cannot go on has to stop"
)]

use moca_msgs::{Mode, Refusal, Request, Target, TargetRefusal, TimedTarget, TwistAxes};
use moca_telemetry::net::{Address, Connection, Endpoint, Link};
use moca_tests::{Limited, Program, STARVED};
use nix::sys::signal::Signal;
use serde_json::Value;
use std::io::{BufRead, BufReader};
use std::os::unix::process::ExitStatusExt;
use std::path::PathBuf;
use std::process::{Command, Output, Stdio};
use std::time::{Duration, Instant};

/// Ends a test that would hang; no test passes or fails by how long something took before this.
const HANGS_AFTER: Duration = Duration::from_secs(60);

struct Daemon {
    _process: Program,
    address: String,
}

impl Daemon {
    /// A live one of these parts that arms nothing by itself.
    fn start(name: &str, parts: &str, address: Option<String>) -> Self {
        Self::start_with(name, parts, address, false)
    }

    /// One that arms itself, or does not.
    fn start_with(name: &str, parts: &str, address: Option<String>, arms: bool) -> Self {
        let socket = std::env::temp_dir().join(format!("moca-{}-{name}.sock", std::process::id()));
        let address = address.unwrap_or_else(|| format!("unix:{}", socket.display()));
        let config = PathBuf::from(env!("CARGO_TARGET_TMPDIR")).join(name);
        let text = format!(
            "[telemetry]\nlisten = \"{address}\"\n[startup]\narm = {arms}\n[simulation.hand]\ntaxels = []\n\
             [plant]\nparts = \"{parts}\"\n"
        );
        std::fs::write(&config, text).unwrap();
        let mut command = mocad(&["--config", config.to_str().unwrap()]);
        Self { _process: command.stdout(Stdio::null()).start().unwrap(), address }
    }

    fn mocad(&self, arguments: &[&str]) -> Output {
        mocad(arguments).args(["--address", &self.address]).run().unwrap()
    }

    /// Holds the command until it is told to end.
    fn arm(&self, more: &[&str]) -> Program {
        let mut command = mocad(&["arm", "--address", &self.address]);
        command.args(more).stdout(Stdio::piped()).stderr(Stdio::piped()).start().unwrap()
    }

    fn status(&self) -> Value {
        let output = self.mocad(&["status", "--json"]);
        assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
        serde_json::from_slice(&output.stdout).unwrap()
    }

    fn wait_for(&self, mode: &str) -> Value {
        let until = Instant::now() + HANGS_AFTER;
        loop {
            let status = self.status();
            if status["mode"] == mode {
                return status;
            }
            assert!(Instant::now() < until, "never {mode}: {status}");
        }
    }

    /// Returns the flange position, m in W.
    fn flange(&self) -> [f64; 3] {
        let connection = Connection::spawn(self.address.parse::<Address>().unwrap(), || {}).unwrap();
        let until = Instant::now() + HANGS_AFTER;
        loop {
            if let Some(sample) = connection.poll().samples.last() {
                return sample.flange_position_world;
            }
            assert!(Instant::now() < until, "no sample");
            std::thread::sleep(Duration::from_millis(5));
        }
    }

    fn done(&self, arguments: &[&str]) {
        let output = self.mocad(arguments);
        assert_eq!(
            output.status.code(),
            Some(0),
            "{arguments:?}: {}",
            String::from_utf8_lossy(&output.stderr)
        );
    }

    fn refused(&self, arguments: &[&str], said: &str) {
        let output = self.mocad(arguments);
        let text = String::from_utf8(output.stderr).unwrap();
        assert_eq!(output.status.code(), Some(4), "{arguments:?}: {text}");
        assert!(text.contains(said), "{arguments:?}: {text}");
    }
}

fn mocad(arguments: &[&str]) -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_mocad-under-test"));
    command.args(arguments);
    command
}

fn said(program: Program) -> (Option<i32>, String) {
    let output = program.output().unwrap();
    (output.status.code(), String::from_utf8(output.stderr).unwrap())
}

#[test]
fn exit_code_of_a_grasp_says_if_something_is_held() {
    let parts = "arm\"\ngripper = \"simulated\"\n[simulation.true.object]\nmass_kg = 0.5\nsize_m = 0.05 #\"";
    let daemon = Daemon::start("operate-gripper.toml", parts, None);
    daemon.wait_for("ready");
    let code = |arguments: &[&str]| {
        let output = daemon.mocad(&[&["gripper"], arguments].concat());
        (
            output.status.code(),
            String::from_utf8(output.stdout).unwrap(),
            String::from_utf8(output.stderr).unwrap(),
        )
    };
    let (empty, _, why) = code(&["state"]);
    assert_eq!(empty, Some(7), "{why}");
    let (held, text, _) = code(&["grasp", "0.05", "--speed", "0.1"]);
    assert_eq!((held, text.as_str()), (Some(0), "holding, 50.0 mm between the fingers\n"));
    assert_eq!(code(&["state"]).0, Some(0), "the program has ended, and it is still held");
    daemon.done(&["stop"]);
    assert_eq!(code(&["stop"]).0, Some(0));
    let (_, json, _) = code(&["state", "--json"]);
    let state: Value = serde_json::from_str(&json).unwrap();
    assert_eq!(
        (&state["holding"], &state["phase"], &state["fault"]),
        (&true.into(), &"holding".into(), &Value::Null)
    );
    assert_eq!(daemon.status()["gripper"], state, "kept through a protective stop");
    daemon.refused(&["gripper", "move", "0.09"], "width of the gripper = 0.09 m; allowed: 0 to 0.08 m");
    daemon.refused(&["gripper", "move", "-0.01"], "width of the gripper = -0.01 m; allowed: 0 to 0.08 m");
    let light = ["gripper", "grasp", "0.05", "--mass", "-1"];
    daemon.refused(&light, "mass of the object = -1 kg; allowed: 0 to 2.27 kg");
    daemon.done(&["gripper", "release"]);
    let (none, _, why) = code(&["grasp", "0.02"]);
    assert!(none == Some(7) && why.contains("The object is wider than asked."), "{none:?}: {why}");
    let bare = Daemon::start("operate-no-gripper.toml", "arm", None);
    bare.wait_for("ready");
    bare.refused(&["gripper", "home"], "the robot has no gripper: set plant.gripper");
    assert_eq!(bare.status()["gripper"], Value::Null);
}

#[test]
fn dead_arming_program_stops_robot() {
    // Without a cover: no busy machine can stop it.
    let daemon = Daemon::start("operate-arm.toml", "arm", None);
    let ready = daemon.wait_for("ready");
    assert_eq!((&ready["commander"], &ready["law"]), (&"nobody".into(), &"impedance".into()));
    daemon.done(&["law", "follow-me"]);
    assert_eq!(daemon.status()["law"], "follow-me");
    daemon.refused(&["resume"], "not possible in mode ready");

    // Ctrl-C disarms.
    let held = daemon.arm(&["--law", "impedance"]);
    let armed = daemon.wait_for("impedance");
    assert_eq!(armed["commander"], "another client");
    for others in [&["disarm"][..], &["law", "follow-me"], &["arm"]] {
        daemon.refused(others, "another client has the command");
    }
    held.signal(Signal::SIGINT).unwrap();
    assert_eq!(said(held), (Some(0), String::new()));
    assert_eq!(daemon.wait_for("ready")["commander"], "nobody");

    // Killed without a word: the dead man's switch.
    let mut killed = daemon.arm(&[]);
    daemon.wait_for("impedance");
    killed.kill().unwrap();
    killed.wait().unwrap();
    assert_eq!(daemon.wait_for("protective stop")["fault"]["code"], "operator-lost");
    daemon.done(&["resume"]);

    // Anybody may stop; who armed ends with a code of its own.
    let stopped = daemon.arm(&[]);
    daemon.wait_for("impedance");
    daemon.done(&["stop"]);
    let (code, text) = said(stopped);
    assert!(code == Some(5) && text.contains("the robot stopped"), "{code:?}: {text}");
    assert_eq!(daemon.wait_for("protective stop")["fault"]["code"], "operator-stop");
    daemon.refused(&["arm"], "not possible in mode protective stop");
    daemon.done(&["resume"]);

    let timed = daemon.mocad(&["arm", "--duration", "0.5"]);
    assert_eq!(timed.status.code(), Some(0), "{}", String::from_utf8_lossy(&timed.stderr));
    daemon.wait_for("ready");
}

/// Regression test: a refused request took the command, and the end of its program stopped the robot that had armed itself.
#[test]
fn refused_tare_and_arm_leave_a_robot_that_armed_itself_alone() {
    let daemon = Daemon::start_with("operate-itself.toml", "arm", None, true);
    daemon.wait_for("impedance");
    for refused in ["tare", "arm"] {
        daemon.refused(&[refused], "not possible in mode impedance");
    }
    daemon.done(&["law", "follow-me"]);
    daemon.done(&["law", "impedance"]);
    let status = daemon.wait_for("impedance");
    assert_eq!((&status["commander"], &status["fault"]), (&"nobody".into(), &Value::Null));
    // An operator who intervenes ends that.
    daemon.done(&["stop"]);
    daemon.done(&["resume"]);
    daemon.done(&["tare"]);
    assert_eq!(daemon.status()["mode"], "ready");
}

#[test]
fn stop_works_while_every_place_is_taken() {
    let daemon = Daemon::start("operate-full.toml", "arm", None);
    daemon.wait_for("ready");
    let address: Address = daemon.address.parse().unwrap();
    let up = |connection: &Connection| {
        let until = Instant::now() + HANGS_AFTER;
        while !matches!(connection.poll().link, Link::Up { .. }) {
            assert!(Instant::now() < until, "never connected");
            std::thread::sleep(Duration::from_millis(5));
        }
    };
    let watching: Vec<Connection> =
        (0..32).map(|_| Connection::spawn(Endpoint::from(&address).to_watch(), || {}).unwrap()).collect();
    watching.iter().for_each(up);
    let held = daemon.arm(&[]);
    while !watching[0].poll().samples.iter().any(|sample| sample.mode == Mode::Impedance) {
        std::thread::sleep(Duration::from_millis(5));
    }
    let status = daemon.mocad(&["status"]);
    let text = String::from_utf8(status.stderr).unwrap();
    assert!(status.status.code() == Some(1) && text.contains("places and the one for a commander"), "{text}");
    let stopped = daemon.mocad(&["stop"]);
    assert_eq!(stopped.status.code(), Some(0), "{}", String::from_utf8_lossy(&stopped.stderr));
    assert_eq!(said(held).0, Some(5), "the commander is told");
    drop(watching);
    assert_eq!(daemon.wait_for("protective stop")["fault"]["code"], "operator-stop");
}

#[test]
fn frozen_program_loses_command_and_robot_stops() {
    let daemon = Daemon::start("operate-frozen.toml", "arm", None);
    daemon.wait_for("ready");
    let frozen = daemon.arm(&[]);
    daemon.wait_for("impedance");
    frozen.signal(Signal::SIGSTOP).unwrap();
    assert_eq!(daemon.wait_for("protective stop")["fault"]["code"], "operator-lost");
    frozen.signal(Signal::SIGCONT).unwrap();
    assert_eq!(said(frozen).0, Some(5), "it is told when it wakes");
}

#[test]
fn tare_and_status_work_over_unix_socket() {
    let socket = std::env::temp_dir().join(format!("moca-operate-{}.sock", std::process::id()));
    for _ in 0..10 {
        let address = format!("unix:{}", socket.display());
        let daemon = Daemon::start("operate-cover.toml", "whole", Some(address));
        daemon.wait_for("ready");
        let tared = daemon.mocad(&["tare", "--json"]);
        let status = daemon.status();
        if STARVED.iter().any(|code| status["fault"]["code"] == *code) {
            continue;
        }
        assert_eq!(tared.status.code(), Some(0), "{}", String::from_utf8_lossy(&tared.stderr));
        let tared: Value = serde_json::from_slice(&tared.stdout).unwrap();
        assert_eq!(tared["mode"], "ready");
        assert_eq!(tared["taxels"].as_array().unwrap().len(), 11);
        for taxel in tared["taxels"].as_array().unwrap() {
            assert_eq!((&taxel["status"], &taxel["force_n"]), (&"ok".into(), &0.0.into()), "{taxel}");
        }
        assert!(
            tared["frame_age_s"].as_f64().unwrap() > 0.0 && tared["speed_limit_m_s"].as_f64().unwrap() > 0.0
        );
        assert!(tared["flange_error_m"].is_f64() && tared["base_pose_world"]["yaw_rad"].is_f64(), "{tared}");
        let text = String::from_utf8(daemon.mocad(&["status"]).stdout).unwrap();
        assert!(text.starts_with("mode         ready\n") && text.contains("T11 0.0 N"), "{text}");
        return;
    }
    panic!("ten daemons were starved before they were tared");
}

#[test]
fn dead_leading_program_stops_robot() {
    let daemon = Daemon::start("operate-target.toml", "arm", None);
    daemon.wait_for("ready");
    let start = daemon.flange();
    let [x, y, z] = start.map(|v| v.to_string());
    daemon.refused(&["target", "pose", &x, &y, &z], "not possible in mode ready");
    let higher = (start[2] + 0.03).to_string();
    let led = daemon.mocad(&["target", "pose", &x, &y, &higher, "--arm", "--json"]);
    assert_eq!(led.status.code(), Some(0), "{}", String::from_utf8_lossy(&led.stderr));
    let led: Value = serde_json::from_slice(&led.stdout).unwrap();
    assert_eq!(
        (&led["target"]["kind"], &led["target"]["phase"]),
        (&"pose".into(), &"reached".into()),
        "{led}"
    );
    let raised = daemon.wait_for("ready");
    assert_eq!((&raised["target"], &raised["commander"]), (&Value::Null, &"nobody".into()));
    assert!((daemon.flange()[2] - start[2] - 0.03).abs() < 5e-3);

    for (target, said) in [
        (&["twist", "0.5", "0", "0", "0", "0", "0"][..], "linear speed x = 0.500000 m/s"),
        (&["twist", "nan", "0", "0", "0", "0", "0"], "linear speed x is not a finite number"),
        (&["pose", "5", "0", "1"], "distance from the arm's shoulder"),
        (&["pose", "0", "0", "0.1"], "depth inside the base"),
        (&["posture", "0", "0", "0"], "number of joints"),
        (&["base", "0.1", "0", "0"], "the robot has no such part"),
    ] {
        let arguments: Vec<&str> = ["target"].iter().chain(target).copied().chain(["--arm"]).collect();
        daemon.refused(&arguments, said);
        daemon.wait_for("ready");
    }

    let far = (start[2] - 0.3).to_string();
    daemon.refused(
        &["target", "pose", &x, &y, &far, "--arm", "--timeout", "0.2"],
        "not reached in 0.2 s, 0 % of it",
    );
    daemon.wait_for("ready");

    let folder = PathBuf::from(env!("CARGO_TARGET_TMPDIR"));
    let file = folder.join("operate-target.csv");
    let pose = |time_s: f64, dy: f64| format!("{time_s},{x},{},{higher},1,0,0,0\n", start[1] + dy);
    std::fs::write(&file, format!("# t,x,y,z,q\n{}{}", pose(0.0, 0.0), pose(0.5, 0.02))).unwrap();
    daemon.done(&["target", "trajectory", file.to_str().unwrap(), "--arm"]);
    std::fs::write(&file, "0,1,2\n").unwrap();
    let wrong = daemon.mocad(&["target", "trajectory", file.to_str().unwrap()]);
    let text = String::from_utf8(wrong.stderr).unwrap();
    assert!(wrong.status.code() == Some(1) && text.contains("operate-target.csv:1: allowed: time"), "{text}");

    // between two targets, without a word
    daemon.wait_for("ready");
    let mut command =
        mocad(&["target", "twist", "0", "0.01", "0", "0", "0", "0", "--duration", "60", "--arm"]);
    let mut killed = command.args(["--address", &daemon.address]).start().unwrap();
    let until = Instant::now() + HANGS_AFTER;
    while daemon.wait_for("impedance")["target"]["phase"] != "moving" {
        assert!(Instant::now() < until, "it is never led");
    }
    daemon.refused(&["target", "twist", "0", "0.01", "0", "0", "0", "0"], "another client has the command");
    killed.kill().unwrap();
    killed.wait().unwrap();
    assert_eq!(daemon.wait_for("protective stop")["fault"]["code"], "operator-lost");
}

/// Sends `burst` targets every two milliseconds, which `other` tries as well; a loop of 1 kHz takes the newest.
fn flood(floods: &Connection, other: &Connection, burst: u32) {
    let until = Instant::now() + HANGS_AFTER;
    let (mut asked, mut taken, mut overtaken, mut unsent, mut refused) = (0, 0, 0, 0, 0);
    let twist = Target::Twist { axes: TwistAxes::World, twist: [0.0, 0.01, 0.0, 0.0, 0.0, 0.0] };
    while taken < 200 || asked < 250 * burst || taken + overtaken + unsent < asked {
        assert!(Instant::now() < until, "never through with its flood");
        floods.alive();
        if taken < 200 || asked < 250 * burst {
            for _ in 0..burst {
                floods.request(Request::Target(TimedTarget::new(twist)));
            }
            asked += burst;
            other.request(Request::Target(TimedTarget::new(twist)));
        }
        let update = floods.poll();
        assert!(matches!(update.link, Link::Up { .. }), "{:?}", update.link);
        assert!(
            update.samples.iter().all(|sample| sample.mode == Mode::Impedance),
            "{:?}",
            update.samples.last()
        );
        for reply in update.replies.iter().filter(|reply| matches!(reply.request, Request::Target(_))) {
            match reply.outcome {
                Ok(()) => taken += 1,
                Err(Refusal::Target(TargetRefusal::Overtaken | TargetRefusal::TooMany { .. })) => {
                    overtaken += 1
                }
                // The connection's own queue is full: it never left this program.
                Err(Refusal::NoAnswer) => unsent += 1,
                Err(refusal) => panic!("{refusal}"),
            }
        }
        for reply in other.poll().replies {
            assert!(
                matches!(
                    reply.outcome,
                    Err(Refusal::NotCommander
                        | Refusal::NoAnswer
                        | Refusal::Target(TargetRefusal::TooMany { .. }))
                ),
                "a second program: {:?}",
                reply.outcome
            );
            refused += u32::from(reply.outcome == Err(Refusal::NotCommander));
        }
        std::thread::sleep(Duration::from_millis(2));
    }
    assert!(overtaken > 0 && refused > 0, "{taken} taken, {overtaken} overtaken, {refused} refused");
}

#[test]
fn target_flood_is_answered_and_second_program_refused() {
    let daemon = Daemon::start("operate-flood.toml", "arm", None);
    daemon.wait_for("ready");
    let start = daemon.flange();
    let connect = || Connection::spawn(daemon.address.parse::<Address>().unwrap(), || {}).unwrap();
    let (floods, other) = (connect(), connect());
    let until = Instant::now() + HANGS_AFTER;
    let waited = |what: &str| assert!(Instant::now() < until, "never {what}");
    for connection in [&floods, &other] {
        while !matches!(connection.poll().link, Link::Up { .. }) {
            waited("connected");
        }
    }
    floods.request(Request::Arm);
    while !floods.poll().samples.iter().any(|sample| sample.mode == Mode::Impedance) {
        floods.alive();
        waited("armed");
    }
    // 10 and 50 kHz.
    for burst in [20, 100] {
        flood(&floods, &other, burst);
    }
    assert!(daemon.flange()[1] > start[1], "it was led all the while");
    floods.request(Request::Disarm);
    daemon.wait_for("ready");
}

#[test]
fn watch_tells_every_change_until_it_is_ended() {
    let daemon = Daemon::start("operate-watch.toml", "arm", None);
    daemon.wait_for("ready");
    let mut command = mocad(&["watch", "--json", "--address", &daemon.address]);
    let mut watching = command.stdout(Stdio::piped()).stderr(Stdio::piped()).start().unwrap();
    let lines = BufReader::new(watching.stdout.take().unwrap()).lines();
    let mut modes = lines.map(|line| {
        let status: Value = serde_json::from_str(&line.unwrap()).unwrap();
        status["mode"].as_str().unwrap().to_owned()
    });
    let mut wait_for = |wanted: &str| assert!(modes.any(|mode| mode == wanted), "{wanted}");
    wait_for("ready");
    daemon.done(&["stop"]);
    wait_for("protective stop");
    daemon.done(&["resume"]);
    wait_for("ready");
    // who only watches holds nothing
    assert_eq!(daemon.status()["commander"], "nobody");
    // Who is started in the background, as under nohup, ignores SIGINT for good.
    watching.signal(Signal::SIGTERM).unwrap();
    assert_eq!(watching.end().unwrap().signal(), Some(Signal::SIGTERM as i32));
}

#[test]
fn without_a_daemon_or_a_reader_it_ends_with_a_word_or_quietly() {
    let output = mocad(&["status", "--address", "unix:/no/such/socket"]).run().unwrap();
    let text = String::from_utf8(output.stderr).unwrap();
    assert_eq!(output.status.code(), Some(1), "{text}");
    assert!(text.contains("is a daemon running"), "{text}");

    // As `mocad params schema | head` does, in the worst moment: before anything is read.
    for command in [&["params", "schema"][..], &["default-config"], &["params", "list", "--offline"]] {
        let mut child = mocad(command).stdout(Stdio::piped()).stderr(Stdio::piped()).start().unwrap();
        drop(child.stdout.take());
        assert_eq!(said(child).1, "", "{command:?}");
    }
}
