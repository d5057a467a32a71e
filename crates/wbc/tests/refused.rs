//! Refused base motion never reaches the arm, and a forbidden arm motion ends the law.
#![allow(clippy::unwrap_used, clippy::float_cmp, reason = "tests; a standing base is zero to the bit")]

mod common;

use common::{Loop, Push, at_home, controller, flange_error};
use moca_wbc::limits::JointSpeeds;
use moca_wbc::opspace::ArmDynamics;
use moca_wbc::robot::{FR3, MOCA_MOUNT, PANDA};
use moca_wbc::{
    ArmController, ArmInput, ArmModel, BaseGuard, ControlInput, ControlLaw, Corrections, Exceeded,
    ImpedanceGains, Limits, Parameters, Payload, RobotState,
};
use proptest::array::{uniform3, uniform7};
use proptest::prelude::*;

proptest! {
    #![proptest_config(ProptestConfig::with_cases(200))]

    #[test]
    fn the_tool_gets_the_acceleration_that_the_base_was_refused(
        q in uniform7(-2.0..2.0_f64),
        yaw in -3.0..3.0_f64,
        refused in uniform3(-500.0..500.0_f64),
    ) {
        let model = ArmModel::<7, f64>::new(&PANDA, &MOCA_MOUNT, &Payload::NONE).unwrap();
        let dynamics = model.dynamics(yaw, &q, &[0.0; 7]);
        let arm = ArmDynamics::new(&dynamics).unwrap();
        let smallest = arm.inverse_task_inertia().symmetric_eigenvalues().min();
        prop_assume!(smallest > 0.05);
        let given = arm.acceleration(&arm.torque_for_refused(&refused).unwrap());
        let missed = dynamics.kinematics.twist_from_base(&refused);
        let scale = missed.iter().fold(1.0_f64, |most, a| most.max(a.abs()));
        for (given, missed) in given.iter().zip(missed) {
            prop_assert!((given - missed).abs() <= 1e-9 * scale, "{given} for {missed}");
        }
    }
}

#[test]
fn an_upright_arm_is_asked_for_no_torque_without_bound() {
    for scale in [0.0, 1e-8, 1e-4, 1e-2] {
        let q = [0.3, 1.0, -0.4, -0.8, 0.6, 0.9, -0.2].map(|q: f64| q * scale);
        let model = ArmModel::<7, f64>::new(&PANDA, &MOCA_MOUNT, &Payload::NONE).unwrap();
        let dynamics = model.dynamics(0.2, &q, &[0.0; 7]);
        let arm = ArmDynamics::new(&dynamics).unwrap();
        let torque = arm.torque_for_refused(&[5.0, -5.0, 2.0]).unwrap();
        let most = torque.iter().fold(0.0_f64, |most, torque| most.max(torque.abs()));
        assert!(most < 500.0, "{scale} rad: {most} N·m for 5 m/s²");
    }
}

/// From the home posture the elbow opens through a posture in which the tool cannot follow the base along one direction.
#[test]
fn nor_is_an_arm_whose_elbow_passes_a_singularity() {
    let model = ArmModel::<7, f64>::new(&PANDA, &MOCA_MOUNT, &Payload::NONE).unwrap();
    let (mut most, mut exact) = (0.0_f64, 0.0_f64);
    for step in 0..4000 {
        let mut q = PANDA.home_rad;
        q[3] = -0.3 - 1e-4 * f64::from(step);
        let dynamics = model.dynamics(0.2, &q, &[0.0; 7]);
        let arm = ArmDynamics::new(&dynamics).unwrap();
        let refused = [5.0, 0.0, 0.0];
        let torque = arm.torque_for_refused(&refused).unwrap();
        most = torque.iter().fold(most, |most, torque| most.max(torque.abs()));
        let missed = nalgebra::SVector::from(dynamics.kinematics.twist_from_base(&refused));
        let wrench = arm.inverse_task_inertia().lu().solve(&missed).unwrap();
        exact = exact.max((dynamics.kinematics.arm_jacobian().transpose() * wrench).amax());
    }
    assert!(most < 200.0 && exact > 1e5, "{most} N·m for 5 m/s², {exact} N·m exactly");
}

/// Largest flange error, m, and largest share of a joint's speed limit, of a press of 2 s.
fn pressed(corrections: Corrections, reactivity: f64, push: &Push) -> (f64, f64) {
    let gains = ImpedanceGains { reactivity, ..ImpedanceGains::PAPER };
    let parameters = Parameters { gains, corrections, ..Parameters::PAPER };
    let mut plant = Loop::new(ControlLaw::Impedance, &parameters);
    plant.guard = BaseGuard { speed_m_s: Some(0.037), ..BaseGuard::NONE };
    let speeds = JointSpeeds::<7, f64>::new(&PANDA);
    let (mut furthest, mut fastest) = (0.0_f64, 0.0_f64);
    for tick in 0..2000_u32 {
        let output = plant.step(&push.scaled((f64::from(tick) / 50.0).min(1.0)));
        assert_eq!(output.exceeded, None, "tick {tick}");
        furthest = furthest.max(flange_error(&output));
        for i in 0..7 {
            let (q, dq) = (plant.robot.q_rad[i], plant.robot.dq_rad_s[i]);
            fastest = fastest.max(dq.abs() / speeds.largest(i, q, dq));
        }
    }
    (furthest, fastest)
}

#[test]
fn a_lean_that_the_guard_takes_away_does_not_throw_the_arm() {
    let damped = Corrections { null_space_damping: true, ..Corrections::LITERAL };
    let all = Corrections { base_coupling: true, flange_wrench_feedforward: true, ..damped };
    for corrections in [Corrections::LITERAL, damped, all] {
        for (taxel, force_n, reactivity) in
            [(6, 100.0, 1.0), (1, 200.0, 1.0), (6, 200.0, 10.0), (7, 60.0, 10.0)]
        {
            let (furthest, fastest) = pressed(corrections, reactivity, &Push::taxels(&[taxel], force_n));
            assert!(
                furthest < 0.006 && fastest < 0.3,
                "{corrections:?} T{taxel} {force_n} N × {reactivity}: {furthest} m, {fastest} of the joint's limit"
            );
        }
    }
}

#[test]
fn a_joint_that_is_too_fast_ends_the_law_in_its_step() {
    let controller = controller(&Parameters::PAPER);
    for law in [ControlLaw::Impedance, ControlLaw::FollowMe] {
        let mut state = controller.enter(law, &at_home()).unwrap();
        let mut robot = at_home();
        robot.dq_rad_s[4] = -2.62;
        let output = controller.step(law, &mut state, &ControlInput::new(robot, [20.0; 11], 1e-3)).unwrap();
        assert_eq!(output.exceeded, Some(Exceeded::JointSpeed(4)), "{law:?}");
        assert_eq!(output.command.base_velocity_body, [0.0; 3]);
        assert_eq!(state.law(), ControlLaw::Hold);
        robot.dq_rad_s[4] = -2.60;
        let mut state = controller.enter(law, &at_home()).unwrap();
        let output = controller.step(law, &mut state, &ControlInput::new(robot, [0.0; 11], 1e-3)).unwrap();
        assert_eq!(output.exceeded, None, "{law:?}");
    }
}

#[test]
fn flange_beyond_limits_ends_law_in_its_step() {
    let controller = controller(&Parameters::PAPER);
    let mut fast = at_home();
    fast.base_velocity_world = [0.0, 1.01, 0.0];
    let mut far = at_home();
    far.base_pose_world = [0.21, 0.0, 0.0];
    let mut turned = at_home();
    turned.q_rad[6] += 0.81;
    for (robot, exceeded) in
        [(fast, Exceeded::FlangeSpeed), (far, Exceeded::PoseError), (turned, Exceeded::PoseError)]
    {
        let mut state = controller.enter(ControlLaw::Impedance, &at_home()).unwrap();
        let input = ControlInput::new(robot, [0.0; 11], 1e-3);
        let output = controller.step(ControlLaw::Impedance, &mut state, &input).unwrap();
        assert_eq!(output.exceeded, Some(exceeded));
        let mut state = controller.enter(ControlLaw::Hold, &at_home()).unwrap();
        let output = controller.step(ControlLaw::Hold, &mut state, &input).unwrap();
        assert_eq!(output.exceeded, None, "a posture is held whatever moves it");
    }
    let mut near = at_home();
    near.base_pose_world = [0.19, 0.0, 0.0];
    let mut state = controller.enter(ControlLaw::Impedance, &at_home()).unwrap();
    let input = ControlInput::new(near, [0.0; 11], 1e-3);
    let output = controller.step(ControlLaw::Impedance, &mut state, &input).unwrap();
    assert!(output.exceeded.is_none() && output.limits.error_saturation);

    let arm: ArmController<7> =
        ArmController::new(&PANDA, &MOCA_MOUNT, &Payload::NONE, &Parameters::PAPER).unwrap();
    let mut state = arm.enter(&at_home()).unwrap();
    let input = ArmInput { robot: turned, flange_wrench_world: None, dt_s: 1e-3 };
    assert_eq!(arm.step(&mut state, &input).unwrap().exceeded, Some(Exceeded::PoseError));
}

/// By hand from the rows of `joint_limits.yaml`.
#[test]
fn joints_of_an_fr3_are_slower_before_the_ends_of_their_ranges() {
    let (fr3, panda) = (JointSpeeds::<7, f64>::new(&FR3), JointSpeeds::<7, f64>::new(&PANDA));
    let close = |value: f64, reference: f64| assert!((value - reference).abs() < 1e-9, "{value} {reference}");
    close(fr3.largest(0, 0.0, 1.0), 2.62);
    close(fr3.largest(0, 2.4007, 1.0), (12.0_f64 * 0.5).sqrt() - 0.652);
    close(fr3.largest(0, 2.4007, -1.0), 2.62);
    close(fr3.largest(3, -2.977, -1.0), (8.0_f64 * 0.1).sqrt() - 0.3542);
    close(fr3.largest(6, 3.0508, 1.0), 0.02);
    close(fr3.largest(6, 4.0, 1.0), 0.02);
    close(panda.largest(6, 2.8973, 1.0), 2.61);
    let mut q = FR3.home_rad;
    assert_eq!(fr3.exceeded(&q, &[0.0; 7]), None);
    q[1] = 1.8;
    let mut dq = [0.0; 7];
    dq[1] = 0.3;
    assert_eq!(fr3.exceeded(&q, &dq), Some(1));
    dq[1] = -0.3;
    assert_eq!(fr3.exceeded(&q, &dq), None);
}

#[test]
fn limits_of_a_motion_are_those_that_are_configured() {
    let limits = Limits { pose_error_m: 0.01, ..Limits::for_arm(&PANDA) };
    let controller = controller(&Parameters { limits, ..Parameters::PAPER });
    let mut state = controller.enter(ControlLaw::Impedance, &at_home()).unwrap();
    let mut moved: RobotState<7> = at_home();
    moved.base_pose_world = [0.011, 0.0, 0.0];
    let input = ControlInput::new(moved, [0.0; 11], 1e-3);
    let output = controller.step(ControlLaw::Impedance, &mut state, &input).unwrap();
    assert_eq!(output.exceeded, Some(Exceeded::PoseError));
    let wider = controller.with_parameters(&Parameters::PAPER).unwrap();
    let mut state = wider.enter(ControlLaw::Impedance, &at_home()).unwrap();
    assert_eq!(wider.step(ControlLaw::Impedance, &mut state, &input).unwrap().exceeded, None);
}
