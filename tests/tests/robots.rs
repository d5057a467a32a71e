//! Other robots than the paper's run from configuration alone: 6 and 7 joints, covers of 4 to 48 taxels, a base and an
//! arm of one's own.
#![allow(
    clippy::unwrap_used,
    clippy::panic,
    clippy::expect_used,
    reason = "a test that cannot go on has to stop"
)]

use moca_control::config::{Config, HandConfig};
use moca_control::cover::CoverSource;
use moca_control::robot::{Arm, BaseDriver, PlantKind};
use moca_lockstep::ideal_cover::IdealCover;
use moca_lockstep::simulated_robot::free_scene;
use moca_lockstep::virtual_boards::board_config;
use moca_lockstep::{Feed, LockStep};
use moca_msgs::params::CONTROLLER;
use moca_msgs::{Mode, Outcome, ParameterValues, Refusal, Request, Sample};
use std::f64::consts::TAU;
use std::path::PathBuf;

/// More than the tare takes: 40 frames at 40.5 Hz.
const TARED_TICKS: u64 = 1500;
const PRESS_N: f64 = 20.0;

fn example(name: &str) -> Config {
    let path = PathBuf::from(concat!(env!("CARGO_MANIFEST_DIR"), "/../examples/robots")).join(name);
    let config = Config::load(&path).unwrap_or_else(|error| panic!("{}:\n{error}", path.display()));
    Config {
        simulation: moca_control::config::SimulationConfig { hand: HandConfig::none(), ..Default::default() },
        ..config
    }
}

fn run<S: CoverSource, F: Feed<S>>(world: &mut LockStep<S, F>, ticks: u64) -> Sample {
    (0..ticks).map(|_| world.step(None).0).last().expect("at least one tick")
}

/// Presses each taxel in turn; the base must give way along the press each time, and the flange, where there is one,
/// keep its place within 8 mm (a Panda with these gains: 6 mm).
fn every_taxel_pushes_its_way<S: CoverSource, F: Feed<S>>(config: &Config, mut world: LockStep<S, F>) {
    let armed = run(&mut world, TARED_TICKS);
    assert_eq!((armed.mode, armed.fault), (Mode::Impedance, None));
    let taxels = config.robot.cover.placements();
    let has_arm = config.plant.parts.has_arm();
    assert_eq!((armed.taxels.len(), armed.counts.len()), (taxels.len(), taxels.len()));
    assert_eq!(armed.q_rad.len(), if has_arm { config.arm().joints } else { 0 });
    assert_eq!(armed.arm_torque_nm.len(), armed.q_rad.len());
    for (i, taxel) in taxels.iter().enumerate() {
        let before = run(&mut world, 1500);
        let pressed = |force_n| Some(Request::PressTaxel { taxel: u8::try_from(i).unwrap(), force_n });
        assert_eq!(world.step(pressed(PRESS_N)).1, Some(Ok(())), "T{}", i + 1);
        let after = run(&mut world, 600);
        assert!(after.taxels[i].force_n > 10.0, "T{} feels {:?}", i + 1, after.taxels[i]);
        let yaw = before.base_pose_world[2] + taxel.inward_angle_base_rad;
        let moved = |k: usize| after.base_pose_world[k] - before.base_pose_world[k];
        let (along, across) =
            (moved(0) * yaw.cos() + moved(1) * yaw.sin(), moved(1) * yaw.cos() - moved(0) * yaw.sin());
        assert!(along > 0.01 && across.abs() < 0.3 * along, "T{}: {along} m along, {across} m across", i + 1);
        let off = |k: usize| after.flange_position_world[k] - after.flange_desired_position_world[k];
        assert!(off(0).hypot(off(1)).hypot(off(2)) < 0.008, "T{}: {} {} {}", i + 1, off(0), off(1), off(2));
        world.step(pressed(0.0));
        assert_eq!(run(&mut world, 1).mode, Mode::Impedance, "T{}", i + 1);
    }
}

fn ideal(config: &Config) -> LockStep<IdealCover, moca_lockstep::TrueForces> {
    LockStep::with_true_forces(config, &free_scene(config), IdealCover::new(25, 0)).unwrap()
}

#[test]
fn a_ur10e_with_twenty_taxels_runs_from_its_file() {
    let config = example("ur10e-20-taxels.toml");
    assert_eq!((config.arm().joints, config.robot.cover.count()), (6, 20));
    every_taxel_pushes_its_way(&config, ideal(&config));
}

/// The arm of a URDF file: in the controller, in MuJoCo, in the description and in the log's configuration.
#[test]
fn an_arm_from_a_urdf_file_runs_as_the_built_in_one_does() {
    let config = example("arm-from-urdf.toml");
    assert_eq!((config.arm().joints, config.robot.arm.name.as_str()), (6, "UR10e of ur10e.urdf"));
    every_taxel_pushes_its_way(&config, ideal(&config));
    let again = Config::parse(&toml::to_string(&config.to_toml()).unwrap()).unwrap();
    assert_eq!(again, config, "a log's configuration needs no file");

    let mut built_in = Config::parse("[robot]\narm = \"ur10e\"\n").unwrap();
    built_in.simulation.hand = HandConfig::none();
    built_in.control = config.control.clone();
    let [of_file, of_table] = [&config, &built_in].map(|config| run(&mut ideal(config), 3000));
    for (file, table) in of_file.arm_torque_nm.iter().zip(&of_table.arm_torque_nm) {
        assert!((file - table).abs() < 1e-9, "{file} {table} N·m");
    }
}

#[test]
fn its_taxels_run_from_the_bytes_of_two_boards_to_motion() {
    let config = example("ur10e-20-taxels.toml");
    let world = LockStep::with_board(&config, &free_scene(&config), board_config(&config), None).unwrap();
    every_taxel_pushes_its_way(&config, world);
}

#[test]
fn four_taxels_on_scattered_electrodes_move_base() {
    let config = example("base-4-taxels.toml");
    let world = LockStep::with_board(&config, &free_scene(&config), board_config(&config), None).unwrap();
    every_taxel_pushes_its_way(&config, world);
}

#[test]
fn shipped_ros_2_bases_give_way_to_every_taxel() {
    for (name, stamped) in [("mecanum-ros2.toml", true), ("holonomic-ros2.toml", false)] {
        let mut config = example(name);
        assert_eq!(config.plant.base.driver, BaseDriver::Ros2);
        assert_eq!(config.plant.base.ros2.stamped, stamped);
        config.plant.kind = PlantKind::Simulated;
        every_taxel_pushes_its_way(&config, ideal(&config));
    }
}

#[test]
fn an_fr3_with_forty_eight_taxels_runs_from_configuration() {
    let mut text = String::from("[robot]\narm = \"fr3\"\n[robot.cover]\n");
    let round = |f: &dyn Fn(f64) -> f64| {
        let list: Vec<String> = (0..48).map(|i| format!("{:?}", f(TAU * f64::from(i) / 48.0))).collect();
        format!("[{}]\n", list.join(", "))
    };
    text += &format!("x_m = {}", round(&|angle| 0.5 * angle.cos()));
    text += &format!("y_m = {}", round(&|angle| 0.5 * angle.sin()));
    text += &format!("inward_rad = {}", round(&|angle| angle - TAU / 2.0));
    text += "[simulation.hand]\ntaxels = []\n";
    let refused = Config::parse(&text).unwrap_err().to_string();
    let one_chip = "robot.cover.electrode = 12 of T13: a virtual Touch Board has electrodes 0 to 11";
    assert!(refused.contains(one_chip), "{refused}");
    let config = Config::parse(&(text + "[board]\nport = \"auto\"\n")).unwrap();
    let mut world = ideal(&config);
    let armed = run(&mut world, TARED_TICKS);
    assert_eq!((armed.mode, armed.taxels.len(), armed.q_rad.len()), (Mode::Impedance, 48, 7));
    world.step(Some(Request::PressTaxel { taxel: 47, force_n: PRESS_N }));
    let pressed = run(&mut world, 1000);
    assert!(pressed.base_pose_world[0] < -0.02 && pressed.taxels[47].force_n > 10.0, "{pressed:?}");
    let beyond = world.step(Some(Request::PressTaxel { taxel: 48, force_n: 1.0 })).1;
    assert_eq!(beyond, Some(Err(Refusal::OutOfRange)));
    let mask = world.step(Some(Request::MaskTaxel { taxel: 48, masked: true })).1;
    assert!(mask.is_some_and(|outcome| outcome.is_err()), "{mask:?}");
}

#[test]
fn live_parameters_have_as_many_elements_as_the_arm_has_joints() {
    let config = example("ur10e-20-taxels.toml");
    let mut world = ideal(&config);
    run(&mut world, 100);
    let row = |name: &str| CONTROLLER.iter().position(|spec| spec.name.ends_with(name)).unwrap();
    let mut set = |name: &str, values: &[f64]| -> Option<Outcome> {
        let (parameter, values) = (u8::try_from(row(name)).unwrap(), ParameterValues::new(values).unwrap());
        world.step(Some(Request::SetParameter { parameter, values })).1
    };
    assert_eq!(set("posture_stiffness", &[50.0; 6]), Some(Ok(())));
    assert_eq!(set("posture_stiffness", &[50.0; 7]), Some(Err(Refusal::OutOfRange)));
    assert_eq!(set("base_velocity", &[0.3, 0.3, 0.3]), Some(Ok(())));
    let error =
        Config::parse("[robot]\narm = \"ur10e\"\n[control.gains]\nposture_rad = [0, 0, 0, 0, 0, 0, 0]\n");
    assert_eq!(
        error.unwrap_err().mistakes,
        ["line 4: control.gains.posture_rad = a list of 7; expected a list of 6 numbers, one for each joint"]
    );
}

/// Plant and controller both know the arm's load: the arm neither rises nor sags.
#[test]
fn tool_and_load_are_carried() {
    let carried = "[robot.tool]\nmass_kg = 1.0\ncom_m = [0.0, 0.0, 0.05]\ninertia_com = [0.002, 0.0, 0.0, 0.002, 0.0, 0.001]\norigin = [0.0, 0.0, 0.1, 0.0, 0.0, 0.0]\n\
                   [robot.load]\nmass_kg = 1.5\ncom_m = [0.02, 0.0, 0.1]\n[plant]\nparts = \"arm\"\n";
    let config = Config::parse(carried).unwrap();
    let sag_m = |scene: &moca_sim::Scene| {
        let mut world = LockStep::without_cover(&config, scene).unwrap();
        let held = run(&mut world, 3000);
        let off = |i: usize| held.flange_position_world[i] - held.flange_desired_position_world[i];
        off(0).hypot(off(1)).hypot(off(2))
    };
    let scene = free_scene(&config);
    assert!(sag_m(&scene) < 1e-6, "{}", sag_m(&scene));
    let bare = moca_sim::Scene { payload: moca_msgs::Payload::NONE, ..scene };
    assert!(sag_m(&bare) > 1e-3, "a controller that carries what is not there lifts: {}", sag_m(&bare));
}

#[test]
fn every_built_in_arm_has_a_controller() {
    for name in Arm::built_in_names() {
        let config =
            Config::parse(&format!("[robot]\narm = \"{name}\"\n[plant]\nparts = \"arm\"\n")).unwrap();
        let mut world = LockStep::without_cover(&config, &free_scene(&config)).unwrap();
        assert_eq!(run(&mut world, 200).mode, Mode::Impedance, "{name}");
    }
}
