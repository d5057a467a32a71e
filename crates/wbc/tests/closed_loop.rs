//! The paper's pushes with the loop closed over the crate's own coupled dynamics: what each correction is worth.
//! Bounds are those of the experiments in simulation; the plant here has no contact and no sensor but a 10 ms hold.
#![allow(clippy::unwrap_used, reason = "tests")]

mod common;

use common::{Loop, Push, flange_error};
use moca_wbc::ControlLaw;
use moca_wbc::robot::PANDA;
use moca_wbc::{Corrections, Parameters};

const LITERAL: Corrections = Corrections::LITERAL;
const DAMPED: Corrections = Corrections { null_space_damping: true, ..LITERAL };
const COUPLED: Corrections = Corrections { base_coupling: true, ..DAMPED };

/// Base displacement (m, m, rad) and largest flange error, mm.
fn pushed(corrections: Corrections, push: &Push) -> ([f64; 3], f64) {
    let parameters = Parameters { corrections, ..Parameters::PAPER };
    let (displacement, error) = Loop::new(ControlLaw::Impedance, &parameters).push(push);
    (displacement, error * 1e3)
}

fn led(push: &Push) -> ([f64; 3], [f64; 7]) {
    let mut robot = Loop::new(ControlLaw::FollowMe, &Parameters::PAPER);
    let (displacement, _) = robot.push(push);
    for _ in 0..1000 {
        robot.step(&Push::default());
    }
    (displacement, core::array::from_fn(|i| robot.robot.q_rad[i] - PANDA.home_rad[i]))
}

fn flange(x: f64, y: f64, z: f64) -> Push {
    Push { flange_n: [x, y, z], ..Push::default() }
}

#[test]
fn a_vertical_push_at_the_flange_meets_the_cartesian_stiffness() {
    let (_, error) = pushed(LITERAL, &flange(0.0, 0.0, 15.0));
    assert!((error - 18.75).abs() < 0.3, "{error} mm");
}

#[test]
fn rear_corner_push_turns_base_and_flange_stays() {
    for (corrections, most) in [(LITERAL, 10.0), (DAMPED, 2.5), (COUPLED, 1.0)] {
        let ([_, y, yaw], error) = pushed(corrections, &Push::taxels(&[1], 20.0));
        assert!(y < -0.2 && yaw > 0.2 && error < most, "{corrections:?}: {y} m, {yaw} rad, {error} mm");
    }
}

#[test]
fn a_push_at_the_front_is_a_pure_translation() {
    for (corrections, most) in [(LITERAL, 15.0), (DAMPED, 3.0), (COUPLED, 1.0)] {
        let ([x, y, yaw], error) = pushed(corrections, &Push::taxels(&[6], 20.0));
        assert!(x < -0.05 && y.abs() < 2e-3 && yaw.abs() < 2e-3, "{corrections:?}: {x} {y} {yaw}");
        assert!(error < most, "{corrections:?}: {error} mm");
    }
}

#[test]
fn opposite_corners_are_opposite_pure_yaw_torques() {
    let ([x, y, yaw], _) = pushed(LITERAL, &Push::taxels(&[4, 8], 15.0));
    let ([mirrored_x, mirrored_y, mirrored_yaw], _) = pushed(LITERAL, &Push::taxels(&[1, 11], 15.0));
    assert!(yaw < -0.25, "{yaw} rad");
    assert!(
        (yaw + mirrored_yaw).abs() < 1e-3 && (y + mirrored_y).abs() < 1e-3 && (x - mirrored_x).abs() < 1e-3
    );
}

#[test]
fn base_follows_lateral_push_only_with_feedforward() {
    let push = flange(0.0, 15.0, 0.0);
    let ([_, against, _], error) = pushed(LITERAL, &push);
    assert!(against < 0.0 && error < 10.0, "literal: {against} m, {error} mm");
    let ([_, with, _], error) = pushed(Corrections { flange_wrench_feedforward: true, ..COUPLED }, &push);
    assert!(with > 0.1 && (error - 18.75).abs() < 0.3, "fed: {with} m, {error} mm");
}

#[test]
fn a_hand_at_the_flange_leads_the_base_and_the_arm_returns() {
    let ([x, y, yaw], posture) = led(&flange(15.0, 0.0, 0.0));
    assert!(x > 0.3 && y.abs() < 1e-3 && yaw.abs() < 1e-3, "{x} {y} {yaw}");
    assert!(posture.iter().all(|gap| gap.abs() < 1e-3), "{posture:?} rad");
}

#[test]
fn hands_on_the_cover_and_at_the_flange_add_up() {
    let ([_, y, yaw], _) = led(&Push::taxels(&[2, 3], 10.0));
    assert!(y < -0.3 && yaw.abs() < 1e-3, "{y} m {yaw} rad");
    let ([cover, ..], _) = led(&Push::taxels(&[6], 10.0));
    let ([hand, ..], _) = led(&flange(-10.0, 0.0, 0.0));
    let ([both, ..], _) = led(&Push { flange_n: [-10.0, 0.0, 0.0], ..Push::taxels(&[6], 10.0) });
    assert!((both - cover - hand).abs() < 0.01 * both.abs(), "{both} against {cover} + {hand}");
    let ([opposed, ..], _) = led(&Push { flange_n: [15.0, 0.0, 0.0], ..Push::taxels(&[6], 15.0) });
    assert!(opposed.abs() < 5e-3, "{opposed} m");
}

#[test]
fn a_held_push_comes_to_rest_inside_the_joint_limits() {
    for corrections in [LITERAL, COUPLED] {
        let parameters = Parameters { corrections, ..Parameters::PAPER };
        let mut robot = Loop::new(ControlLaw::Impedance, &parameters);
        let push = Push::taxels(&[6], 20.0);
        let mut worst = 0.0_f64;
        for _ in 0..15_000 {
            worst = worst.max(flange_error(&robot.step(&push)));
            for (i, q) in robot.robot.q_rad.iter().enumerate() {
                assert!((PANDA.q_min_rad[i]..=PANDA.q_max_rad[i]).contains(q), "joint {i} at {q} rad");
            }
        }
        let speed = robot.robot.base_velocity_world;
        assert!(worst < 0.015, "flange error {worst} m");
        assert!(speed.iter().all(|v| v.abs() < 1e-6), "still moving: {speed:?}");
        assert!(robot.robot.base_pose_world[0] > -0.2, "not held back: {:?}", robot.robot.base_pose_world);
    }
}

/// The crate's documentation quotes the errors of these pushes.
#[test]
fn the_documented_errors_are_those_of_this_loop() {
    let page: Vec<_> =
        include_str!("../src/lib.rs").lines().filter_map(|line| line.strip_prefix("//! ")).collect();
    let page = page.join(" ");
    let of = |corrections| [1, 6].map(|taxel| pushed(corrections, &Push::taxels(&[taxel], 20.0)).1);
    let [literal, damped, coupled] = [LITERAL, DAMPED, COUPLED].map(of);
    let fed = Corrections { flange_wrench_feedforward: true, ..COUPLED };
    let [alone, with] = [LITERAL, fed].map(|corrections| pushed(corrections, &flange(0.0, 15.0, 0.0)).1);
    for said in [
        format!("literal {:.1} and {:.1} mm", literal[0], literal[1]),
        format!("`null_space_damping` {:.1} and {:.1} mm", damped[0], damped[1]),
        format!("`base_coupling` as well {:.2} and {:.2} mm", coupled[0], coupled[1]),
        format!("move it {alone:.1} mm"),
        format!("the flange moves {with:.1} mm"),
    ] {
        assert!(page.contains(&said), "{said}");
    }
}
