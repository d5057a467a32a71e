//! References, switches, live gains, external wrench, other covers: the loop closed over the crate's own dynamics.
#![allow(clippy::unwrap_used, reason = "tests")]

mod common;

use common::{Loop, Push, at_home, flange_error};
use moca_wbc::reference::ERROR_SATURATION_M;
use moca_wbc::robot::{MOCA_MOUNT, PANDA, PAPER_COVER};
use moca_wbc::{ControlInput, ControlLaw, WholeBodyController, cover_wrench};
use moca_wbc::{Corrections, ImpedanceGains, Parameters, Payload, TaxelPlacement};

const ALL: Corrections =
    Corrections { null_space_damping: true, base_coupling: true, flange_wrench_feedforward: true };

#[test]
fn no_switch_of_law_meets_the_torque_rate_limit() {
    let laws = [ControlLaw::Impedance, ControlLaw::FollowMe, ControlLaw::Impedance, ControlLaw::Hold];
    // at home, and with a joint pushed back from the end of its range
    let mut bent = at_home();
    bent.q_rad[5] = PANDA.q_max_rad[5] - 0.05;
    for (corrections, robot) in
        [(Corrections::LITERAL, at_home()), (ALL, at_home()), (Corrections::LITERAL, bent)]
    {
        let parameters = Parameters { corrections, ..Parameters::PAPER };
        let mut plant = Loop::starting(ControlLaw::Hold, &parameters, robot, 1e-3);
        let hand = Push { flange_n: [8.0, -6.0, 10.0], ..Push::taxels(&[1, 6], 10.0) };
        for tick in 0..4000_u32 {
            // a switch every 300 ms, pushed or not, moving or not
            plant.law = laws[usize::try_from(tick / 300).unwrap() % laws.len()];
            let t = f64::from(tick) * 1e-3;
            let output = plant.step(&hand.scaled((0.5 - 0.5 * (1.5 * t).cos()).max(0.0)));
            assert!(!output.limits.torque_rate, "{corrections:?}: tick {tick}, into {:?}", plant.law);
        }
    }
}

#[test]
fn gains_changed_live_arrive_without_a_jolt() {
    let mut plant = Loop::new(ControlLaw::Impedance, &Parameters::PAPER);
    let push = Push { flange_n: [0.0, 0.0, 15.0], ..Push::default() };
    for tick in 0..1500_u32 {
        plant.step(&push.scaled((f64::from(tick) / 300.0).min(1.0)));
    }
    let soft = flange_error(&plant.step(&push));
    let stiffness = ImpedanceGains::PAPER.stiffness.map(|k| 4.0 * k);
    let gains = ImpedanceGains { stiffness, ..ImpedanceGains::PAPER };
    plant.controller = plant.controller.with_parameters(&Parameters { gains, ..Parameters::PAPER }).unwrap();
    for _ in 0..1500 {
        let output = plant.step(&push);
        assert!(!output.limits.torque_rate && !output.limits.torque);
    }
    let stiff = flange_error(&plant.step(&push));
    assert!(
        (soft - 15.0 / 800.0).abs() < 3e-4 && (stiff - 15.0 / 3200.0).abs() < 3e-4,
        "{soft} m, {stiff} m"
    );
}

#[test]
fn a_blocked_robot_is_pulled_no_harder_than_the_saturated_error() {
    let controller = common::controller(&Parameters::PAPER);
    let mut state = controller.enter(ControlLaw::Impedance, &at_home()).unwrap();
    state.set_target_pose([5.0, 0.0, 1.1], [1.0, 0.0, 0.0, 0.0]).unwrap();
    let input = ControlInput::new(at_home(), [0.0; 11], 1e-3);
    let mut early = None;
    let mut last = None;
    for tick in 0..4000 {
        let output = controller.step(ControlLaw::Impedance, &mut state, &input).unwrap();
        if tick == 2500 {
            assert!(output.limits.error_saturation);
            early = Some(output.command.arm_torque_nm);
        }
        last = Some(output.command.arm_torque_nm);
    }
    for (early, last) in early.unwrap().iter().zip(last.unwrap()) {
        assert!((early - last).abs() < 1e-2, "still winding up: {early} to {last} N·m");
    }
}

#[test]
fn moving_target_waits_for_blocked_robot() {
    let controller = common::controller(&Parameters::PAPER);
    let mut state = controller.enter(ControlLaw::Impedance, &at_home()).unwrap();
    state.set_target_twist([0.0, 0.2, 0.0, 0.0, 0.0, 0.0]).unwrap();
    let input = ControlInput::new(at_home(), [0.0; 11], 1e-3);
    let mut output = controller.step(ControlLaw::Impedance, &mut state, &input).unwrap();
    for _ in 0..3000 {
        output = controller.step(ControlLaw::Impedance, &mut state, &input).unwrap();
    }
    let ahead = output.flange_desired.position_world[1] - output.flange.position_world[1];
    assert!((ahead - ERROR_SATURATION_M).abs() < 1e-3, "{ahead} m ahead");

    let mut plant = Loop::new(ControlLaw::Impedance, &Parameters { corrections: ALL, ..Parameters::PAPER });
    let start = plant.step(&Push::default()).flange.position_world[1];
    plant.state.set_target_twist([0.0, 0.2, 0.0, 0.0, 0.0, 0.0]).unwrap();
    let mut output = plant.step(&Push::default());
    for _ in 0..2000 {
        output = plant.step(&Push::default());
    }
    let travelled = output.flange.position_world[1] - start;
    assert!((travelled - 0.4).abs() < 0.01, "{travelled} m in 2 s");
}

#[test]
fn targets_that_are_not_poses_are_refused() {
    let controller = common::controller(&Parameters::PAPER);
    let mut state = controller.enter(ControlLaw::Impedance, &at_home()).unwrap();
    let before = state;
    assert!(state.set_target_pose([f64::NAN, 0.0, 0.0], [0.0, 0.0, 0.0, 1.0]).is_err());
    assert!(state.set_target_pose([0.0; 3], [0.0, 0.0, 0.0, 2.0]).is_err());
    assert!(state.set_target_pose([0.0; 3], [0.0; 4]).is_err());
    assert!(state.set_target_twist([f64::INFINITY; 6]).is_err());
    assert_eq!(state, before);
}

#[test]
fn observer_finds_flange_push_with_sign_and_point() {
    let mut plant = Loop::new(ControlLaw::Impedance, &Parameters::PAPER);
    plant.estimates = false;
    for flange_n in [[0.0, 0.0, 15.0], [12.0, 0.0, 0.0], [0.0, -10.0, 5.0]] {
        let push = Push { flange_n, ..Push::default() };
        let mut output = plant.step(&push);
        for _ in 0..1500 {
            output = plant.step(&push);
        }
        for i in 0..3 {
            let force = output.flange_wrench_world[i];
            assert!((force - flange_n[i]).abs() < 0.3, "axis {i}: {force} N of {flange_n:?}");
            let moment = output.flange_wrench_world[3 + i];
            assert!(moment.abs() < 0.1, "axis {i}: {moment} N·m of a force through the flange");
        }
    }
}

#[test]
fn accelerating_base_is_no_flange_push() {
    let mut plant = Loop::new(ControlLaw::FollowMe, &Parameters::PAPER);
    plant.estimates = false;
    let mut worst = 0.0_f64;
    for tick in 0..1500_u32 {
        let ramp = (f64::from(tick) / 300.0).min(1.0);
        let output = plant.step(&Push::taxels(&[2, 3], 10.0).scaled(ramp));
        for force in &output.flange_wrench_world[..3] {
            worst = worst.max(force.abs());
        }
    }
    assert!(plant.robot.base_velocity_world[1] < -0.1, "the base did not move");
    assert!(worst < 0.5, "{worst} N imagined");
}

/// The paper's 11 taxels and a rear row: more than one board has channels for.
fn with_rear_row() -> [TaxelPlacement; 15] {
    core::array::from_fn(|i| match PAPER_COVER.get(i) {
        Some(taxel) => *taxel,
        None => {
            let row = f64::from(u32::try_from(i - 11).unwrap());
            TaxelPlacement { position_base_m: [-0.489, 0.3 - 0.2 * row], inward_angle_base_rad: 0.0 }
        }
    })
}

#[test]
fn a_rear_row_pushes_the_base_forwards() {
    let cover = with_rear_row();
    let mut force = [0.0; 15];
    force[11] = 10.0;
    let [x, y, moment] = cover_wrench(&cover, &force);
    assert!(
        (x - 10.0_f64).abs() < 1e-12 && y.abs() < 1e-12 && (moment + 3.0).abs() < 1e-12,
        "{x} {y} {moment}"
    );
    let controller: WholeBodyController<7, 15> =
        WholeBodyController::new(&PANDA, &MOCA_MOUNT, &Payload::NONE, &cover, &Parameters::PAPER).unwrap();
    let mut state = controller.enter(ControlLaw::FollowMe, &at_home()).unwrap();
    let input = ControlInput::new(at_home(), force, 1e-3);
    let output = controller.step(ControlLaw::FollowMe, &mut state, &input).unwrap();
    assert!(output.command.base_velocity_body[0] > 0.0);
}

#[test]
fn reactivity_scales_what_a_push_on_the_cover_does() {
    let displaced = |reactivity: f64| {
        let gains = ImpedanceGains { reactivity, ..ImpedanceGains::PAPER };
        let mut plant = Loop::new(ControlLaw::FollowMe, &Parameters { gains, ..Parameters::PAPER });
        for _ in 0..500 {
            plant.step(&Push::taxels(&[6], 5.0));
        }
        plant.robot.base_pose_world[0]
    };
    let (none, one, two) = (displaced(0.0), displaced(1.0), displaced(2.0));
    assert!(none.abs() < 1e-9 && (two / one - 2.0).abs() < 0.05, "{none} {one} {two}");
}
