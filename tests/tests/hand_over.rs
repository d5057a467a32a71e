//! The tutorial that picks up a box and hands it over while somebody leans on the robot, as its reader runs it.
#![allow(clippy::unwrap_used, clippy::panic, reason = "a test that cannot go on has to stop")]

use moca_msgs::Sample;
use moca_telemetry::log::read_log;
use moca_tests::{Limited, Program, STARVED};
use nix::sys::signal::Signal;
use serde_json::Value;
use std::io::Write;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::time::{Duration, Instant};

const ROOT: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/..");
const MOCAD: &str = env!("CARGO_BIN_EXE_mocad-under-test");
/// Ends a test that would hang.
const HANGS_AFTER: Duration = Duration::from_secs(60);

/// The tutorial's robot, whose programs find each other in `folder`.
fn robot(folder: &Path, log: &Path) -> Program {
    let config = Path::new(ROOT).join("examples/hand-over/robot.toml");
    let mut command = Command::new(MOCAD);
    command.arg("--config").arg(config).arg("--record").arg(log).env("XDG_RUNTIME_DIR", folder);
    command.stdout(Stdio::null()).start().unwrap()
}

fn status(folder: &Path) -> Value {
    let output = Command::new(MOCAD).args(["status", "--json"]).env("XDG_RUNTIME_DIR", folder).run().unwrap();
    serde_json::from_slice(&output.stdout).unwrap_or_default()
}

/// Runs the script while somebody leans; `None` on a machine that is too busy for it.
fn handed_over(name: &str) -> Option<Vec<Sample>> {
    // A socket's path is short.
    let folder = std::env::temp_dir().join(format!("moca-{}-{name}", std::process::id()));
    std::fs::create_dir_all(&folder).unwrap();
    let log = PathBuf::from(env!("CARGO_TARGET_TMPDIR")).join(format!("{name}.mcap"));
    let _ = std::fs::remove_file(&log);
    let robot = robot(&folder, &log);
    let until = Instant::now() + HANGS_AFTER;
    while status(&folder)["mode"] != "impedance" {
        assert!(Instant::now() < until, "it never arms itself: {}", status(&folder));
    }
    let mut script = Command::new("bash");
    script.arg(Path::new(ROOT).join("examples/hand-over/hand-over.sh"));
    script.env("MOCAD", MOCAD).env("XDG_RUNTIME_DIR", &folder);
    let mut script =
        script.stdin(Stdio::piped()).stdout(Stdio::piped()).stderr(Stdio::piped()).start().unwrap();
    // The person takes the box at once.
    script.stdin.take().unwrap().write_all(b"\n").unwrap();
    let output = script.output().unwrap();
    let end = status(&folder);
    robot.signal(Signal::SIGINT).unwrap();
    assert!(robot.end().unwrap().success());
    std::fs::remove_dir_all(&folder).unwrap();
    if STARVED.iter().any(|code| end["fault"]["code"] == *code) {
        return None;
    }
    assert!(output.status.success(), "{}\n{end}", String::from_utf8_lossy(&output.stderr));
    Some(read_log(&log).unwrap().samples)
}

#[test]
fn box_is_handed_over_while_somebody_leans_on_the_robot() {
    let tries = ["hand-over-1", "hand-over-2", "hand-over-3"];
    let Some(samples) = tries.into_iter().find_map(handed_over) else {
        panic!("three robots were starved");
    };
    assert!(samples.iter().all(|sample| sample.fault.is_none()));
    let held: Vec<&Sample> = samples
        .iter()
        .filter(|sample| {
            sample.gripper.is_some_and(|gripper| gripper.is_holding() && gripper.object_kg > 0.0)
        })
        .collect();
    let heights = held.iter().map(|sample| sample.flange_position_world[2]);
    let [lowest_m, highest_m] =
        heights.fold([f64::MAX, f64::MIN], |[low, high], z| [low.min(z), high.max(z)]);
    assert!(lowest_m < 0.92 && highest_m > 1.04, "lifted from {lowest_m} m to {highest_m} m");
    let sideways_m = held.last().unwrap().flange_position_world[1];
    assert!((sideways_m + 0.3).abs() < 0.02, "handed over at y = {sideways_m} m");
    let leant = held.iter().filter(|sample| sample.taxels.iter().any(|taxel| taxel.force_n > 10.0)).count();
    assert!(2 * leant > held.len(), "{leant} of {} samples with the box are leant on", held.len());
    let base = |sample: &Sample| sample.base_pose_world;
    let ways_m = held.iter().map(|sample| {
        let ([x, y, _], [x0, y0, _]) = (base(sample), base(held[0]));
        f64::hypot(x - x0, y - y0)
    });
    let way_m = ways_m.fold(0.0, f64::max);
    println!(
        "lifted by {:.3} m, leant on in {leant} of {} samples, the base gave way by {way_m:.3} m",
        highest_m - lowest_m,
        held.len()
    );
    assert!(way_m > 0.1, "the base gives way by {way_m} m");
    let end = samples.last().unwrap();
    let gripper = end.gripper.unwrap();
    assert!(!gripper.is_holding() && gripper.width_m > 0.079, "{gripper}");
}
