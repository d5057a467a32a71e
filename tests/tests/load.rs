//! Identification of the load at the flange: six postures with the flange bare, then with the load.
#![allow(clippy::unwrap_used, clippy::expect_used, reason = "a test that cannot go on has to stop")]

use moca_control::config::{Config, HandConfig};
use moca_control::load_identification::{Belief, Identified, Measured, Sweeps, identify};
use moca_control::unknown_load::UnknownLoadWatch;
use moca_lockstep::LockStep;
use moca_lockstep::ideal_cover::IdealCover;
use moca_lockstep::simulated_robot::free_scene;
use moca_msgs::{Law, Mode, ParameterValues, Request, Sample, Target, TimedTarget};
use std::collections::VecDeque;

/// Ticks between two targets: 50 a second.
const SEND_EVERY: u64 = 20;
/// Ticks over which a joint's speed is a mean.
const AVERAGED: usize = 500;
const AVERAGED_S: f64 = 0.5;

/// A robot whose arm is 5 % heavier than its model, has friction, and reports no torque exactly.
fn config(seed: u64) -> Config {
    let mut config = Config::default();
    config.simulation.hand = HandConfig::none();
    config.startup.law = Law::Impedance;
    config.simulation.seed = seed;
    let arm = &mut config.simulation.truth.arm;
    (arm.mass_scale, arm.joint_friction_nm, arm.torque_noise_nm) = (1.05, 1.0, 0.3);
    config
}

/// Sweeps of a robot, with the fastest joint of all, rad/s: friction lets a joint rest and catch up, so a mean is taken.
fn measured(config: &Config) -> (Measured, f64) {
    let mut world = LockStep::with_true_forces(config, &free_scene(config), IdealCover::new(1, 0)).unwrap();
    let mut sample: Sample = (0..3000).map(|_| world.step(None).0).last().unwrap();
    assert_eq!(sample.mode, Mode::Impedance);
    let (start_m, mut furthest_m) = (sample.flange_position_world, 0.0_f64);
    let mut past = VecDeque::new();
    let (mut sweeps, mut fastest_rad_s, mut tick) = (Sweeps::from(&sample).unwrap(), 0.0_f64, 0);
    while let Some(posture_rad) = sweeps.step(&sample).unwrap() {
        let target = TimedTarget::new(Target::Posture(ParameterValues::new(&posture_rad).unwrap()));
        let (next, answer) = world.step((tick % SEND_EVERY == 0).then_some(Request::Target(target)));
        assert!(answer.is_none_or(|answer| answer.is_ok()), "{answer:?}");
        let ways_m = next.flange_position_world.iter().zip(start_m).map(|(at, start)| (at - start).abs());
        furthest_m = ways_m.fold(furthest_m, f64::max);
        past.push_back(next.q_rad.clone());
        if past.len() > AVERAGED {
            let before = past.pop_front().unwrap();
            let ways = next.q_rad.iter().zip(&before).map(|(q, before)| (q - before).abs() / AVERAGED_S);
            fastest_rad_s = ways.fold(fastest_rad_s, f64::max);
        }
        (sample, tick) = (next, tick + 1);
    }
    assert!(furthest_m < 0.2, "{furthest_m} m");
    (sweeps.measured(&config.robot.tool.origin).unwrap(), fastest_rad_s)
}

/// Masses that are named in 12 s of a robot at rest, kg.
fn named(config: &Config) -> Vec<f64> {
    let mut world = LockStep::with_true_forces(config, &free_scene(config), IdealCover::new(1, 0)).unwrap();
    let mut watch = UnknownLoadWatch::default();
    let loads = (0..15_000).filter_map(|_| watch.see(&world.step(None).0));
    loads.map(|load| load.mass_kg).collect()
}

#[test]
fn unknown_load_is_named_and_friction_is_not() {
    for law in [Law::Impedance, Law::FollowMe] {
        let with = |tool_mass_kg| {
            let mut config = config(1);
            (config.startup.law, config.simulation.truth.arm.mass_scale) = (law, 1.0);
            (config.simulation.truth.arm.tool_mass_kg, config.simulation.truth.arm.tool_com_m) =
                (tool_mass_kg, [0.02, -0.01, 0.06]);
            named(&config)
        };
        let (none, one, half) = (with(0.0), with(1.0), with(0.5));
        println!("{law:?}: {none:?}, 0.5 kg {half:?}, 1 kg {one:?}");
        assert!(none.is_empty(), "{law:?}: friction of 1 N·m and noise of 0.3 N·m");
        for (named, mass_kg) in [(one, 1.0), (half, 0.5)] {
            assert!(
                named.len() == 1 && (named[0] - mass_kg).abs() < 0.25,
                "{law:?}: {mass_kg} kg is {named:?}"
            );
        }
    }
}

#[test]
fn load_is_identified_on_an_arm_that_is_not_the_one_believed() {
    let bare = config(1);
    let mut loaded = config(2);
    (loaded.simulation.truth.arm.tool_mass_kg, loaded.simulation.truth.arm.tool_com_m) =
        (1.0, [0.02, -0.01, 0.06]);
    let ((bare, _), (loaded, fastest_rad_s)) = (measured(&bare), measured(&loaded));
    let Identified { mass_kg, com_m, residual } =
        identify(&bare, &loaded, Belief::default(), Belief::default()).unwrap();
    assert!((mass_kg - 1.0).abs() < 0.03, "{mass_kg} kg");
    for (com, truth) in com_m.iter().zip([0.02, -0.01, 0.06]) {
        assert!((com - truth).abs() < 5e-3, "{com_m:?} m");
    }
    assert!(residual[0] < 0.2 && residual[1] < 0.05, "{residual:?} N, N·m");
    assert!(fastest_rad_s < 0.1, "{fastest_rad_s} rad/s");
}
