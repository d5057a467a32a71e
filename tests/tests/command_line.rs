//! The real binary, as a user meets it.
#![allow(
    clippy::unwrap_used,
    clippy::expect_used,
    clippy::panic,
    reason = "a test that cannot go on has to stop"
)]

use moca_tests::Limited;
use std::path::PathBuf;
use std::process::{Command, Output};

fn mocad(arguments: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_mocad-under-test")).args(arguments).run().expect("mocad starts")
}

fn text(bytes: &[u8]) -> String {
    String::from_utf8(bytes.to_vec()).expect("plain text")
}

/// A file of this test's own that holds `contents`.
fn file(name: &str, contents: &str) -> PathBuf {
    let path = PathBuf::from(env!("CARGO_TARGET_TMPDIR")).join(name);
    std::fs::write(&path, contents).unwrap();
    path
}

#[test]
fn stopping_distance_of_a_late_base_is_measured_and_entered() {
    let late = "# ours\n[simulation.true.base]\norder_delay_ms = 50.0\n";
    let config = file("late-base.toml", late);
    let path = config.to_str().unwrap();
    let measured = mocad(&["doctor", "--base", "--config", path]);
    assert!(measured.status.success(), "{}", text(&measured.stderr));
    assert_eq!(std::fs::read_to_string(&config).unwrap(), late, "nothing is written unasked");
    let written = mocad(&["doctor", "--base", "--config", path, "--write"]);
    assert!(written.status.success(), "{}", text(&written.stderr));
    let entered = std::fs::read_to_string(&config).unwrap();
    assert!(entered.starts_with(late), "{entered}");
    let read = moca_control::config::Config::load(&config).unwrap().protection;
    assert!((read.order_delay_ms - 50.0).abs() < 1.0, "{entered}");
    for (speed, distance) in read.stopping_speed_m_s.iter().zip(&read.stopping_distance_m) {
        let least = 0.05 * speed + speed * speed / 6.0;
        assert!((least..least + 0.025 * speed).contains(distance), "{speed} m/s: {distance} m");
    }
    let none = file("no-base.toml", "[plant]\nparts = \"arm\"\n");
    let refused = mocad(&["doctor", "--base", "--config", none.to_str().unwrap()]);
    assert!(!refused.status.success() && text(&refused.stderr).contains("plant.parts"), "{refused:?}");
}

#[test]
fn split_log_replays_and_lone_part_is_named() {
    let config = file("split.toml", NO_TELEMETRY);
    let parts = ["split.mcap", "split-2.mcap", "split-3.mcap"]
        .map(|name| PathBuf::from(env!("CARGO_TARGET_TMPDIR")).join(name));
    parts.iter().for_each(|part| drop(std::fs::remove_file(part)));
    let [one, two, three] = parts.each_ref().map(|part| part.to_str().unwrap());
    let options = ["--as-fast-as-possible", "--duration", "25", "--record-split", "10s", "--record", one];
    let output = mocad(&[&options[..], &["--config", config.to_str().unwrap()]].concat());
    assert!(output.status.success(), "{}", text(&output.stderr));
    let output = mocad(&["replay", one, two, three]);
    assert!(output.status.success(), "{}", text(&output.stderr));
    let told = text(&output.stdout);
    assert!(told.contains("25000 ticks"), "{told}");
    // Where one part ends and the next begins is a matter of blocks: within one of them of every ten seconds.
    let near = |told: &str, words: &str, tick: u64| {
        let after = told.split_once(words).unwrap_or_else(|| panic!("{words:?} is missing in {told}")).1;
        let digits: String = after.chars().take_while(char::is_ascii_digit).collect();
        assert!(digits.parse::<u64>().unwrap().abs_diff(tick) <= 250, "{words:?} {tick}: {told}");
    };
    for (parts, places) in [
        (&[two][..], &[("the log begins at tick ", 10_000)][..]),
        (&[two, one], &[("the log begins at tick ", 10_000)]),
        (&[one, three], &[("incomplete after tick ", 10_000), ("the next tick in it is ", 20_000)]),
    ] {
        let output = mocad(&[&["replay"], parts].concat());
        let told = text(&output.stderr);
        assert_eq!(output.status.code(), Some(1), "{parts:?}: {told}");
        places.iter().for_each(|(words, tick)| near(&told, words, *tick));
    }
    parts.iter().for_each(|part| std::fs::remove_file(part).unwrap());
}

/// No telemetry: several daemons run at once here.
const NO_TELEMETRY: &str = "[telemetry]\nlisten = \"\"\n";

#[test]
fn the_default_run_says_what_runs_and_ends_with_a_summary() {
    let config = file("live.toml", NO_TELEMETRY);
    // On a machine so busy that even the virtual board is silent for too long the robot rightly stops: then once more.
    let run = |_| mocad(&["run", "--duration", "3", "--config", config.to_str().unwrap()]);
    let armed = |output: &Output| text(&output.stdout).contains("mode: impedance");
    let output = (0..5).map(run).find(armed).expect("one of five runs is armed");
    let shown = text(&output.stdout);
    assert!(output.status.success(), "{shown}{}", text(&output.stderr));
    for expected in [
        "simulated Franka Emika Panda on SUMMIT-XL (MuJoCo 3.17.0)",
        "expanded Cartesian impedance",
        "1000 Hz",
        "virtual Touch Board",
        "mode: impedance",
        "good frames, 0 bad",
        "lateness",
        "allocations  0 on the loop thread after warm-up",
    ] {
        assert!(shown.contains(expected), "{expected:?} is missing in\n{shown}");
    }
}

#[test]
fn without_the_scripted_hand_nobody_presses() {
    let config = file("no-hand.toml", NO_TELEMETRY);
    let options = ["--as-fast-as-possible", "--duration", "9", "--config", config.to_str().unwrap()];
    let base = |output: &Output| -> String {
        let lines = text(&output.stdout);
        lines.lines().rev().find(|line| line.trim_start().starts_with("base ")).expect("a summary").to_owned()
    };
    let pressed = mocad(&options);
    assert!(
        text(&pressed.stdout).contains("a scripted hand presses T6, T2, T10"),
        "it says who moves the base"
    );
    let alone = mocad(&[&options[..], &["--no-hand"]].concat());
    assert!(!text(&alone.stdout).contains("scripted hand"));
    assert!(base(&alone).contains("x +0.000 m, y +0.000 m"), "{}", base(&alone));
    assert!(!base(&pressed).contains("x +0.000 m, y +0.000 m"), "{}", base(&pressed));
}

#[test]
fn a_lock_step_run_writes_the_same_command_log_twice() {
    let config = file("lockstep.toml", NO_TELEMETRY);
    let log = |name: &str| {
        let path = file(name, "");
        let arguments = ["--as-fast-as-possible", "--duration", "5", "--command-log", path.to_str().unwrap()];
        let output = mocad(&[&arguments[..], &["--config", config.to_str().unwrap()]].concat());
        assert!(output.status.success(), "{}", text(&output.stderr));
        std::fs::read(path).unwrap()
    };
    let first = log("first.csv");
    assert_eq!(first.iter().filter(|&&byte| byte == b'\n').count(), 5001);
    assert!(first == log("second.csv"), "two runs with one seed differ");
}

#[test]
fn accuracy_runs_in_lock_step_and_is_refused_live() {
    let config = file("accuracy.toml", &format!("{NO_TELEMETRY}[simulation]\naccuracy = 1e-3\n"));
    let arguments = ["--duration", "3", "--config", config.to_str().unwrap()];
    let live = mocad(&arguments);
    let said = text(&live.stderr);
    assert!(!live.status.success() && said.contains("a live loop takes steps of one length"), "{said}");
    let output = mocad(&[&arguments[..], &["--as-fast-as-possible"]].concat());
    assert!(output.status.success(), "{}", text(&output.stderr));
    assert!(text(&output.stdout).contains("mode: impedance"), "{}", text(&output.stdout));
}

#[test]
fn a_bad_configuration_is_refused_with_every_mistake() {
    let path = file("bad.toml", "[control.gains]\nvirtual_mass = [nan, 4.0, 2.0]\n[loop]\nrate_hz = 7\n");
    let output = mocad(&["--config", path.to_str().unwrap()]);
    let said = text(&output.stderr);
    assert!(!output.status.success());
    assert!(said.contains("line 2: control.gains.virtual_mass = NaN kg"), "{said}");
    assert!(said.contains("line 4: loop.rate_hz = 7 Hz is outside 100 to 10000 Hz"), "{said}");

    let unknown = file("unknown.toml", "[loop]\nrate = 1000\n");
    let output = mocad(&["--check", "--config", unknown.to_str().unwrap()]);
    assert!(!output.status.success());
    assert!(text(&output.stderr).contains("unknown key loop.rate; allowed here: rate_hz"));
}

#[test]
fn check_says_that_it_passed_or_names_a_missing_driver() {
    let good = file("good.toml", NO_TELEMETRY);
    let output = mocad(&["--check", "--config", good.to_str().unwrap()]);
    let told = text(&output.stdout);
    assert!(output.status.success() && told.contains("good.toml: no mistakes"), "{told}");

    let arm =
        "[plant]\nkind = \"robot\"\nparts = \"arm\"\n[plant.arm]\ndriver = \"fci\"\nhost = \"127.0.0.1\"\n";
    let path = file("no-driver.toml", arm);
    let output = mocad(&["--check", "--config", path.to_str().unwrap()]);
    let said = text(&output.stderr);
    assert_eq!(output.status.code(), Some(2), "{said}");
    assert!(said.contains("needs a build with the feature `fci`"), "{said}");
}

#[test]
fn a_missing_file_and_a_bad_duration_are_named() {
    let output = mocad(&["--config", "/nowhere/mocad.toml"]);
    assert!(!output.status.success() && text(&output.stderr).contains("/nowhere/mocad.toml"));
    for duration in ["-1", "nan", "1e300"] {
        let output = mocad(&[&format!("--duration={duration}")]);
        assert!(!output.status.success() && text(&output.stderr).contains("--duration"), "{duration}");
    }
}

#[test]
fn a_missing_port_is_named_with_what_to_check_and_nothing_moves() {
    let config =
        file("no_port.toml", &format!("{NO_TELEMETRY}[board]\nport = \"/dev/moca-no-such-board\"\n"));
    let output = mocad(&["--duration", "2.5", "--config", config.to_str().unwrap()]);
    let shown = text(&output.stdout);
    assert!(
        output.status.success(),
        "it waits for the board until its time is over: {}",
        text(&output.stderr)
    );
    let advice =
        "The board's port /dev/moca-no-such-board does not exist: check cable, power switch and board.port";
    assert!(shown.contains(advice), "{shown}");
    assert!(shown.contains("  mode         starting"), "{shown}");
    assert!(shown.contains("  base         x +0.000 m, y +0.000 m, yaw +0.0°"), "{shown}");
}

#[test]
fn a_calibration_that_is_missing_or_of_another_board_is_refused() {
    let missing = file("no_calibration.toml", "[board]\ncalibration = \"/nowhere/cover.toml\"\n");
    let output = mocad(&["--config", missing.to_str().unwrap()]);
    assert!(!output.status.success() && text(&output.stderr).contains("/nowhere/cover.toml"));
}

#[test]
fn a_live_recording_replays_bit_for_bit() {
    let config = file("recorded.toml", NO_TELEMETRY);
    let log = PathBuf::from(env!("CARGO_TARGET_TMPDIR")).join("live.mcap");
    let _ = std::fs::remove_file(&log);
    let (config, log) = (config.to_str().unwrap(), log.to_str().unwrap());
    let run = mocad(&["run", "--duration", "3", "--config", config, "--record", log]);
    assert!(run.status.success(), "{}", text(&run.stderr));
    let replayed = mocad(&["replay", log]);
    let (shown, said) = (text(&replayed.stdout), text(&replayed.stderr));
    assert!(replayed.status.success() && shown.contains("every bit the same"), "{shown}{said}");
}

#[test]
fn endless_or_silent_file_is_refused_by_name() {
    let fifo = PathBuf::from(env!("CARGO_TARGET_TMPDIR")).join(format!("fifo-{}", std::process::id()));
    let _ = std::fs::remove_file(&fifo);
    assert!(Command::new("mkfifo").arg(&fifo).status().unwrap().success());
    let named = |text: String| file("devices.toml", &text).display().to_string();
    let zero = named("[board]\ncalibration = \"/dev/zero\"\n".into());
    for path in ["/dev/zero", fifo.to_str().unwrap(), &zero] {
        let output = mocad(&["--check", "--config", path]);
        let said = text(&output.stderr);
        assert_eq!(output.status.code(), Some(2), "{path}: {said}");
        assert!(said.contains("not a regular file"), "{path}: {said}");
    }
}

#[test]
fn unwritable_home_costs_only_the_flight_recorder() {
    let config = file("no-home.toml", NO_TELEMETRY);
    let output = Command::new(env!("CARGO_BIN_EXE_mocad-under-test"))
        .args(["--duration", "1", "--config", config.to_str().unwrap()])
        .env("HOME", "/proc")
        .env_remove("XDG_STATE_HOME")
        .env_remove("STATE_DIRECTORY")
        .run()
        .unwrap();
    let shown = text(&output.stdout);
    assert!(output.status.success(), "{shown}{}", text(&output.stderr));
    assert!(shown.contains("no flight recorder") && shown.contains("/proc/.local"), "{shown}");
}
