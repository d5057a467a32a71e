//! The step function from outside: entry, doors, limits.
#![allow(clippy::unwrap_used, clippy::float_cmp, reason = "tests; floats that must be bit-equal")]

use moca_msgs::robot::{MOCA_MOUNT, PANDA, PAPER_COVER};
use moca_msgs::{Parameters, Payload, RobotState};
use moca_wbc::{ControlError, ControlInput, ControlLaw, Controller};

const LAWS: [ControlLaw; 3] = [ControlLaw::Hold, ControlLaw::Impedance, ControlLaw::FollowMe];

fn controller() -> Controller<7, 11> {
    Controller::new(&PANDA, &MOCA_MOUNT, &Payload::NONE, &PAPER_COVER, &Parameters::PAPER).unwrap()
}

fn at_home() -> RobotState<7> {
    RobotState {
        base_pose_world: [0.3, -0.2, 0.4],
        base_velocity_world: [0.0; 3],
        q_rad: PANDA.home_rad,
        dq_rad_s: [0.0; 7],
        torque_measured_nm: [0.0; 7],
        flange_wrench_world: Some([0.0; 6]),
    }
}

fn input(robot: RobotState<7>) -> ControlInput<7, 11> {
    ControlInput { robot, taxel_force_n: [0.0; 11], flange_wrench_world: None, dt_s: 1e-3 }
}

#[test]
fn a_law_entered_at_rest_gives_gravity_torques_and_a_standing_base() {
    let controller = controller();
    let kinematics = controller.model().kinematics(0.4, &PANDA.home_rad);
    let gravity = kinematics.gravity(&controller.model().link_inertias(&kinematics));
    for law in LAWS {
        let mut state = controller.enter(law, &at_home()).unwrap();
        let output = controller.step(law, &mut state, &input(at_home())).unwrap();
        for (torque, gravity) in output.command.arm_torque_nm.iter().zip(gravity) {
            assert!((torque - gravity).abs() < 1e-9, "{law:?}: {torque} against {gravity}");
        }
        assert!(output.command.base_velocity_body.iter().all(|v| v.abs() < 1e-12), "{law:?}");
        assert_eq!(output.flange.position_world, output.flange_desired.position_world);
    }
}

#[test]
fn a_push_on_a_taxel_moves_the_base_away_from_it() {
    let controller = controller();
    for law in [ControlLaw::Impedance, ControlLaw::FollowMe] {
        let mut state = controller.enter(law, &at_home()).unwrap();
        let mut input = input(at_home());
        input.taxel_force_n[5] = 20.0;
        let output = controller.step(law, &mut state, &input).unwrap();
        assert!(output.command.base_velocity_body[0] < 0.0, "{law:?}");
        assert!((output.cover_wrench_base[0] + 20.0).abs() < 1e-12, "{law:?}");
    }
}

#[test]
fn a_number_that_is_not_finite_is_an_error_and_leaves_the_state() {
    let controller = controller();
    let before = controller.enter(ControlLaw::Impedance, &at_home()).unwrap();
    for bad in [f64::NAN, f64::INFINITY, f64::NEG_INFINITY] {
        for place in 0..7 {
            let mut input = input(at_home());
            match place {
                0 => input.robot.base_pose_world[1] = bad,
                1 => input.robot.base_velocity_world[2] = bad,
                2 => input.robot.q_rad[3] = bad,
                3 => input.robot.dq_rad_s[6] = bad,
                4 => input.taxel_force_n[10] = bad,
                5 => input.flange_wrench_world = Some([bad; 6]),
                _ => input.dt_s = bad,
            }
            for law in LAWS {
                let mut state = before;
                let refused = controller.step(law, &mut state, &input);
                assert!(
                    matches!(refused, Err(ControlError::NotFinite { .. })),
                    "{law:?} {place}: {refused:?}"
                );
                assert_eq!(state, before);
            }
        }
    }
}

#[test]
fn a_base_alone_moves_as_the_base_of_the_whole_robot_that_is_led() {
    let controller = controller();
    let mut whole = controller.enter(ControlLaw::FollowMe, &at_home()).unwrap();
    let mut alone = whole;
    let mut input = input(at_home());
    for step in 0..400 {
        input.taxel_force_n[2] = if step < 200 { 20.0 } else { 0.0 };
        input.robot.base_pose_world[2] = 0.4 + 1e-3 * f64::from(step);
        let law = if step < 300 { ControlLaw::FollowMe } else { ControlLaw::Hold };
        let expected = controller.step(law, &mut whole, &input).unwrap();
        let output = controller.step_base(law, &mut alone, &input).unwrap();
        assert_eq!(output.command.base_velocity_body, expected.command.base_velocity_body, "step {step}");
        assert_eq!(output.cover_wrench_base, expected.cover_wrench_base);
        assert_eq!(output.command.arm_torque_nm, [0.0; 7]);
    }
    input.taxel_force_n[0] = f64::NAN;
    assert!(controller.step_base(ControlLaw::Impedance, &mut alone, &input).is_err());
}

#[test]
fn an_arm_without_a_cover_is_the_arm_of_the_whole_robot_untouched() {
    let covered = controller();
    let bare: Controller<7, 0> =
        Controller::new(&PANDA, &MOCA_MOUNT, &Payload::NONE, &[], &Parameters::PAPER).unwrap();
    let mut robot = at_home();
    let mut state = bare.enter(ControlLaw::FollowMe, &robot).unwrap();
    let mut expected = covered.enter(ControlLaw::FollowMe, &robot).unwrap();
    for step in 0..100 {
        robot.q_rad[1] = PANDA.home_rad[1] + 1e-4 * f64::from(step);
        let input = ControlInput { robot, taxel_force_n: [], flange_wrench_world: None, dt_s: 1e-3 };
        let output = bare.step(ControlLaw::FollowMe, &mut state, &input).unwrap();
        let whole = covered.step(ControlLaw::FollowMe, &mut expected, &self::input(robot)).unwrap();
        assert_eq!(output.command, whole.command, "step {step}");
    }
}
