//! A robot that lacks a part: what is not there is neither simulated, started nor shown, and the rest works as before.
#![allow(clippy::unwrap_used, clippy::expect_used, reason = "a test that cannot go on has to stop")]

use moca_control::config::{Config, HandConfig};
use moca_control::robot::{Arm, Parts};
use moca_lockstep::LockStep;
use moca_lockstep::simulated_robot::free_scene;
use moca_msgs::{BoardFault, Mode, Refusal, Request, Sample};
use moca_sim::{Scene, VirtualBoardConfig};
use moca_tests::Limited;
use std::path::PathBuf;
use std::process::Command;
use std::time::Duration;

/// More than the tare takes: 40 frames at 40.5 Hz.
const TARED_TICKS: u64 = 1500;

fn config(parts: Parts) -> Config {
    let mut config = Config::default();
    config.plant.parts = parts;
    config.simulation.hand = HandConfig::none();
    config
}

fn run(step: &mut dyn FnMut(Option<Request>) -> Sample, ticks: u64) -> Sample {
    (0..ticks).map(|_| step(None)).last().expect("at least one tick")
}

#[test]
fn a_base_alone_gives_way_and_stops_without_its_board() {
    let config = config(Parts::Base);
    let mut world =
        LockStep::with_board(&config, &free_scene(&config), VirtualBoardConfig::default(), None).unwrap();
    let armed = run(&mut |request| world.step(request).0, TARED_TICKS);
    assert_eq!(armed.mode, Mode::Impedance);
    assert!(armed.q_rad.is_empty() && armed.arm_torque_nm.is_empty(), "there is no arm");
    assert_eq!(armed.taxels.len(), 11);
    let press = world.step(Some(Request::PressTaxel { taxel: 5, force_n: 20.0 }));
    assert_eq!(press.1, Some(Ok(())));
    let pressed = run(&mut |request| world.step(request).0, 2000);
    assert!(pressed.base_pose_world[0] < -0.04, "{:?}", pressed.base_pose_world);
    world.feed[0].unplug();
    let stopped = run(&mut |request| world.step(request).0, 500);
    assert_eq!((stopped.mode, stopped.fault), (Mode::ProtectiveStop, Some(BoardFault::Lost.of(0))));
    assert!(stopped.base_velocity_world[0].abs() < 1e-3, "{:?}", stopped.base_velocity_world);
}

#[test]
fn arm_alone_needs_no_board_and_yields_as_spring() {
    let config = config(Parts::Arm);
    let mut world = LockStep::without_cover(&config, &free_scene(&config)).unwrap();
    let armed = run(&mut |request| world.step(request).0, 100);
    assert_eq!((armed.mode, armed.fault), (Mode::Impedance, None), "nothing to wait for");
    assert!(armed.taxels.is_empty() && armed.counts.is_empty(), "there is no cover");
    let no_taxel = world.step(Some(Request::PressTaxel { taxel: 0, force_n: 5.0 })).1;
    assert_eq!(no_taxel, Some(Err(Refusal::OutOfRange)));
    let force_n = 10.0;
    world.control.plant.world.set_flange_wrench_world([force_n, 0.0, 0.0, 0.0, 0.0, 0.0]).unwrap();
    let pulled = run(&mut |request| world.step(request).0, 5000);
    let off_m = pulled.flange_position_world[0] - pulled.flange_desired_position_world[0];
    let spring_m = force_n / config.control.gains.stiffness[0];
    assert!((off_m / spring_m - 1.0).abs() < 0.1, "{off_m} m for a spring's {spring_m} m");
    assert!(pulled.base_pose_world.iter().all(|x| x.abs() < 1e-12), "it stands on a stand");
    world.control.plant.world.set_flange_wrench_world([0.0; 6]).unwrap();
    let back = run(&mut |request| world.step(request).0, 5000);
    let off_m = back.flange_position_world[0] - back.flange_desired_position_world[0];
    assert!(off_m.abs() < 1e-3, "{off_m} m");
    let disarmed = world.step(Some(Request::Disarm));
    assert_eq!((disarmed.0.mode, disarmed.1), (Mode::Ready, Some(Ok(()))));
}

#[test]
fn a_fault_of_a_part_that_is_not_there_is_refused() {
    let folder = PathBuf::from(env!("CARGO_TARGET_TMPDIR"));
    for (name, plant, fault, said) in [
        (
            "arm",
            "parts = \"arm\"",
            "unplugged@1",
            "a robot without a cover has no cable; these apply here: joint-nan",
        ),
        (
            "none",
            "kind = \"none\"\n[board]\nport = \"/dev/none\"",
            "joint-nan@1",
            "only a simulated robot can be made to fail",
        ),
    ] {
        let path = folder.join(format!("inject-{name}.toml"));
        std::fs::write(&path, format!("[plant]\n{plant}\n[telemetry]\nlisten = \"\"\n")).unwrap();
        let output = Command::new(env!("CARGO_BIN_EXE_mocad-under-test"))
            .args(["--duration", "2", "--inject", fault, "--config"])
            .arg(path)
            .run()
            .unwrap();
        let text = String::from_utf8_lossy(&output.stderr);
        assert!(!output.status.success() && text.contains(said), "{name}: {text}");
    }
}

/// Names of the threads of a live daemon.
fn threads(parts: &str) -> Vec<String> {
    let path = PathBuf::from(env!("CARGO_TARGET_TMPDIR")).join(format!("parts-{parts}.toml"));
    std::fs::write(&path, format!("[plant]\nparts = \"{parts}\"\n[telemetry]\nlisten = \"\"\n")).unwrap();
    let daemon = Command::new(env!("CARGO_BIN_EXE_mocad-under-test"))
        .args(["--log-level", "error", "--config"])
        .arg(path)
        .stdout(std::process::Stdio::null())
        .start()
        .unwrap();
    let folder = format!("/proc/{}/task", daemon.id());
    let mut names = Vec::new();
    for _ in 0..500 {
        std::thread::sleep(Duration::from_millis(20));
        names = std::fs::read_dir(&folder)
            .unwrap()
            .filter_map(|task| std::fs::read_to_string(task.ok()?.path().join("comm")).ok())
            .map(|name| name.trim().to_owned())
            .collect();
        // a thread that has just been started has its program's name still
        let unnamed = names.iter().filter(|name| name.starts_with("mocad")).count();
        if names.iter().any(|name| name == "control-loop") && unnamed == 1 {
            break;
        }
    }
    drop(daemon);
    names.sort();
    names
}

#[test]
fn an_arm_alone_starts_no_thread_of_a_board() {
    let arm = ["control-loop", "ctrl-c", "flight-recorder", "mocad-under-tes", "terminal"];
    assert_eq!(threads("arm"), arm);
    // the board, which is simulated, its reader, and who calibrates it
    let mut with_cover = [&arm[..], &["calibrator", "touch-board", "touch-board"]].concat();
    with_cover.sort_unstable();
    for parts in ["base", "whole"] {
        assert_eq!(threads(parts), with_cover, "{parts}");
    }
}

/// The arm further back and tilted, T6 at the rear.
fn moved_geometry() -> Config {
    let mut config = config(Parts::Whole);
    config.robot.mount.position_base_m = [-0.1, 0.15, 0.4];
    config.robot.mount.rpy_rad = [0.1, -0.2, 0.7];
    // T6 moves from the front to the back.
    (config.robot.cover.x_m[5], config.robot.cover.inward_rad[5]) = (-0.489, 0.0);
    config
}

#[test]
fn another_mount_and_cover_are_the_same_to_plant_and_controller() {
    let config = moved_geometry();
    let mut world =
        LockStep::with_board(&config, &free_scene(&config), VirtualBoardConfig::default(), None).unwrap();
    let armed = run(&mut |request| world.step(request).0, TARED_TICKS);
    let [x, y, z] = world.control.plant.world.flange_position_world().unwrap();
    let [cx, cy, cz] = armed.flange_position_world;
    let off_m = (x - cx).hypot(y - cy).hypot(z - cz);
    assert!(off_m < 1e-5, "the controller sees the flange {off_m} m from where it is");
    assert_eq!(world.step(Some(Request::PressTaxel { taxel: 5, force_n: 20.0 })).1, Some(Ok(())));
    let pressed = run(&mut |request| world.step(request).0, 2000);
    assert!(pressed.base_pose_world[0] > 0.02, "a press from behind drives forward: {pressed:?}");
    assert!(
        (pressed.cover_wrench_base[1], pressed.cover_wrench_base[2]) == (0.0, 0.0)
            && pressed.cover_wrench_base[0] > 5.0
    );
}

#[test]
fn an_fr3_is_the_same_arm_to_plant_and_controller() {
    let mut config = config(Parts::Arm);
    config.robot.arm = Arm::built_in("fr3").unwrap();
    let held_off_m = |scene: &Scene| {
        let mut world = LockStep::without_cover(&config, scene).unwrap();
        let held = run(&mut |request| world.step(request).0, 3000);
        let off = |i: usize| held.flange_position_world[i] - held.flange_desired_position_world[i];
        off(0).hypot(off(1)).hypot(off(2))
    };
    let scene = free_scene(&config);
    assert!(held_off_m(&scene) < 1e-6, "{}", held_off_m(&scene));
    // The Panda has other masses: with the FR3's gravity torques it gives way by 2 mm.
    let panda = Scene { arm: *Config::default().arm(), ..scene };
    assert!(held_off_m(&panda) > 1e-3, "{}", held_off_m(&panda));
}

#[test]
fn geometry_of_wrong_taxel_count_is_refused() {
    let error = Config::parse("[robot.cover]\nx_m = [0.1, 0.2]\n").unwrap_err().to_string();
    assert!(error.contains("y_m has 11 elements; robot.cover.x_m has 2"), "{error}");
    let error = Config::parse("[robot.mount]\nposition_base_m = [0.1, nan, 50]\n").unwrap_err().to_string();
    assert!(error.contains("robot.mount.position_base_m = NaN m is outside -5 to 5 m"), "{error}");
}
