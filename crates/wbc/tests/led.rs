//! A tool that is led anywhere, with the loop closed over the crate's own coupled dynamics: no joint passes its speed.
#![allow(clippy::unwrap_used, reason = "tests")]

mod common;

use common::{Loop, Push};
use moca_wbc::limits::JointSpeeds;
use moca_wbc::reference_generator::{ReferenceBounds, Workspace};
use moca_wbc::robot::PANDA;
use moca_wbc::{ControlLaw, Corrections, FlangePose, Parameters, Target, TwistAxes, rotation};
use proptest::prelude::*;
use proptest::test_runner::{Config, RngAlgorithm, TestRng, TestRunner};

const WORKSPACE: Workspace =
    Workspace { shoulder_base_m: [0.125, 0.0, 0.823], reach_m: 1.195, base_size_m: [0.78, 0.67, 0.55] };
const PARAMETERS: Parameters<7> = Parameters {
    corrections: Corrections { null_space_damping: true, base_coupling: true, ..Corrections::LITERAL },
    ..Parameters::PAPER
};

/// A target from nine numbers between -1 and 1: a pose anywhere within reach, the fastest twist of some axes, a posture.
fn target(kind: usize, by: &[f64; 9], robot: &Loop) -> Target<7> {
    match kind {
        0 | 1 => {
            let [bx, by_, yaw] = robot.robot.base_pose_world;
            let reach = WORKSPACE.reach_m / 3.0_f64.sqrt();
            let from_base = std::array::from_fn(|i| WORKSPACE.shoulder_base_m[i] + reach * by[i]);
            let [x, y, z] = rotation::Heading::at(yaw).to_world(from_base);
            let length = by[3..7].iter().map(|v| v * v).sum::<f64>().sqrt().max(1e-3);
            let quaternion_world =
                std::array::from_fn(|i| if length > 1e-3 { by[3 + i] / length } else { 0.5 });
            Target::Pose(FlangePose { position_world: [bx + x, by_ + y, z], quaternion_world })
        }
        2 => {
            let axes = match by[6] {
                ..-0.33 => TwistAxes::World,
                ..0.33 => TwistAxes::Base,
                _ => TwistAxes::Flange,
            };
            let most = |i| if i < 3 { 0.25_f64 } else { 1.0 };
            Target::Twist { axes, twist: std::array::from_fn(|i| most(i) * by[i].signum()) }
        }
        _ => Target::Posture(std::array::from_fn(|i| {
            let (low, high) = (PANDA.q_min_rad[i] + 0.15, PANDA.q_max_rad[i] - 0.15);
            0.5 * (low + high + by[i] * (high - low))
        })),
    }
}

#[test]
fn led_tool_passes_no_joint_speed_and_ends_no_law() {
    let speeds = JointSpeeds::<7, f64>::new(&PANDA);
    let ways = prop::collection::vec((0..4_usize, prop::array::uniform9(-1.0..1.0_f64), 500..2500_u32), 10);
    for law in [ControlLaw::FollowMe, ControlLaw::Impedance] {
        // The same ways in every run: a way that fails in one run in a thousand would be noise in the others.
        let config = Config { cases: 4, failure_persistence: None, ..Config::default() };
        let mut runner = TestRunner::new_with_rng(config, TestRng::deterministic_rng(RngAlgorithm::ChaCha));
        let fastest = std::cell::Cell::new(0.0_f64);
        let result = runner.run(&ways, |ways| {
            let mut robot = Loop::new(law, &PARAMETERS);
            for (kind, by, ticks) in ways {
                let target = target(kind, &by, &robot);
                let state = robot.robot;
                robot.state.lead(&target, &state, &ReferenceBounds::DEFAULT, Some(&WORKSPACE)).unwrap();
                for tick in 0..ticks {
                    let output = robot.step(&Push::default());
                    let share = speeds.share(&robot.robot.q_rad, &robot.robot.dq_rad_s);
                    fastest.set(fastest.get().max(share));
                    prop_assert!(
                        output.exceeded.is_none() && share <= 1.0,
                        "{share} of the speed after {tick} steps to {target:?}: {:?}",
                        output.exceeded
                    );
                }
            }
            Ok(())
        });
        assert!(result.is_ok(), "{law:?}: {result:?}");
        assert!(fastest.get() > 0.25, "{law:?}: they were led about: {}", fastest.get());
    }
}

#[test]
fn taken_over_reference_keeps_its_speed() {
    let mut robot = Loop::new(ControlLaw::FollowMe, &PARAMETERS);
    let mut posture = PANDA.home_rad;
    for (i, q) in posture.iter_mut().enumerate() {
        *q += [0.8, 0.5, 0.5, -0.5, 0.5, 0.5, 0.5][i];
    }
    let lead = |robot: &mut Loop, target| {
        let state = robot.robot;
        robot.state.lead(&target, &state, &ReferenceBounds::DEFAULT, Some(&WORKSPACE)).unwrap();
    };
    lead(&mut robot, Target::Posture(posture));
    let place = |robot: &mut Loop| robot.step(&Push::default()).flange_desired.position_world;
    let speed = |robot: &mut Loop| {
        let (a, b) = (place(robot), place(robot));
        (0..3).map(|i| (b[i] - a[i]).powi(2)).sum::<f64>().sqrt() / common::DT_S
    };
    for _ in 0..600 {
        place(&mut robot);
    }
    let before = speed(&mut robot);
    assert!(before > 0.2, "{before} m/s");
    lead(&mut robot, Target::Twist { axes: TwistAxes::World, twist: [0.0; 6] });
    // three steps of 20 m/s³ change less than a thousandth of a metre in a second
    let after = speed(&mut robot);
    assert!((after - before).abs() < 2e-3, "{before} m/s before, {after} m/s after");
}
