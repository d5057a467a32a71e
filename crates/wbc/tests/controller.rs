//! The step function from outside: entry, doors, limits.
#![allow(clippy::unwrap_used, clippy::float_cmp, reason = "tests; floats that must be bit-equal")]

use moca_wbc::robot::{LinkInertial, MOCA_MOUNT, PANDA, PAPER_COVER};
use moca_wbc::{
    ArmController, ArmInput, BaseController, BaseGuard, BaseInput, ControlError, ControlInput, ControlLaw,
    LimitsHit, WholeBodyController,
};
use moca_wbc::{Parameters, Payload, RobotState};

const LAWS: [ControlLaw; 3] = [ControlLaw::Hold, ControlLaw::Impedance, ControlLaw::FollowMe];

fn controller() -> WholeBodyController<7, 11> {
    WholeBodyController::new(&PANDA, &MOCA_MOUNT, &Payload::NONE, &PAPER_COVER, &Parameters::PAPER).unwrap()
}

fn at_home() -> RobotState<7> {
    RobotState {
        base_pose_world: [0.3, -0.2, 0.4],
        flange_wrench_world: Some([0.0; 6]),
        ..RobotState::at_rest(PANDA.home_rad)
    }
}

fn input(robot: RobotState<7>) -> ControlInput<7, 11> {
    ControlInput::new(robot, [0.0; 11], 1e-3)
}

#[test]
fn law_entered_at_rest_gives_gravity_torques() {
    let controller = controller();
    let gravity = controller.model().dynamics(0.4, &PANDA.home_rad, &[0.0; 7]).gravity();
    for law in LAWS {
        let mut state = controller.enter(law, &at_home()).unwrap();
        let output = controller.step(law, &mut state, &input(at_home())).unwrap();
        for (torque, gravity) in output.command.arm_torque_nm.iter().zip(gravity) {
            assert!((torque - gravity).abs() < 1e-9, "{law:?}: {torque} against {gravity}");
        }
        assert!(output.command.base_velocity_body.iter().all(|v| v.abs() < 1e-12), "{law:?}");
        // follow-me's reference is seen from B and back: equal but for that rounding
        for (is, wanted) in output.flange.position_world.iter().zip(output.flange_desired.position_world) {
            assert!((is - wanted).abs() < 4e-16, "{law:?}: {is} against {wanted}");
        }
    }
}

#[test]
fn held_object_is_carried_like_a_load_and_is_no_own_gravity() {
    let object = LinkInertial { mass_kg: 1.5, com_m: [0.01, -0.02, 0.11], ..Payload::NONE.inertial };
    let tool_origin = [0.02, 0.0, 0.1, 0.3, -0.2, 0.5];
    let tool = Payload {
        inertial: LinkInertial { mass_kg: 0.7, com_m: [0.0, 0.0, 0.04], ..Payload::NONE.inertial },
        tool_origin,
    };
    let whole = |payload: &Payload| -> WholeBodyController<7, 11> {
        WholeBodyController::new(&PANDA, &MOCA_MOUNT, payload, &PAPER_COVER, &Parameters::PAPER).unwrap()
    };
    let bare = whole(&tool);
    let known = whole(&Payload { inertial: tool.inertial.with(&object), ..tool });
    let held = bare.carrying(&PANDA, &MOCA_MOUNT, &tool, &object).unwrap();
    let mut robot = at_home();
    robot.dq_rad_s = [0.1, -0.2, 0.3, 0.05, -0.1, 0.2, -0.3];
    for law in LAWS {
        let command = |controller: &WholeBodyController<7, 11>| {
            let mut state = controller.enter(law, &robot).unwrap();
            controller.step(law, &mut state, &input(robot)).unwrap().command
        };
        let (bare, known, held) = (command(&bare), command(&known), command(&held));
        assert_eq!(held.arm_torque_nm, known.arm_torque_nm, "{law:?}");
        assert_eq!(held.base_velocity_body, known.base_velocity_body, "{law:?}");
        for (held, bare) in held.arm_gravity_nm.iter().zip(bare.arm_gravity_nm) {
            assert!((held - bare).abs() < 1e-12, "{law:?}: {held} against {bare}");
        }
    }
    let none = LinkInertial { mass_kg: 0.0, ..object };
    let again = held.carrying(&PANDA, &MOCA_MOUNT, &tool, &none).unwrap();
    let law = ControlLaw::Impedance;
    let step = |controller: &WholeBodyController<7, 11>| {
        let mut state = controller.enter(law, &robot).unwrap();
        controller.step(law, &mut state, &input(robot)).unwrap().command
    };
    assert_eq!(step(&again), step(&bare), "an object that is gone leaves nothing");
    let heavy = LinkInertial { mass_kg: f64::NAN, ..object };
    assert!(
        bare.carrying(&PANDA, &MOCA_MOUNT, &tool, &LinkInertial { com_m: [f64::NAN; 3], ..object }).is_err()
    );
    assert!(bare.carrying(&PANDA, &MOCA_MOUNT, &tool, &heavy).is_err());
}

#[test]
fn arm_that_takes_hold_of_an_object_feels_no_push() {
    let object = LinkInertial { mass_kg: 1.5, com_m: [0.0, 0.0, 0.1], ..Payload::NONE.inertial };
    let arm: ArmController<7> =
        ArmController::new(&PANDA, &MOCA_MOUNT, &Payload::NONE, &Parameters::PAPER).unwrap();
    let loaded = arm.carrying(&PANDA, &MOCA_MOUNT, &Payload::NONE, &object).unwrap();
    // A steady motion with the torques that either model asks for: nobody pushes.
    let dq_rad_s = [0.1, -0.2, 0.3, 0.05, -0.1, 0.2, -0.3];
    let run = |tells: bool| {
        let mut robot = RobotState { dq_rad_s, ..RobotState::at_rest(PANDA.home_rad) };
        let mut state = arm.enter(&robot).unwrap();
        let mut most_nm = 0.0_f64;
        for tick in 0..60 {
            let controller = if tick < 30 { &arm } else { &loaded };
            if tick == 30 && tells {
                state.change_model();
            }
            robot.torque_measured_nm = controller.model().dynamics(0.0, &robot.q_rad, &dq_rad_s).bias;
            // momentum of a steady motion changes with the posture; this short one hardly turns
            controller.hold(&mut state, &ArmInput { robot, flange_wrench_world: None, dt_s: 1e-3 }).unwrap();
            if tick >= 30 {
                most_nm = state.external_torque_nm().iter().map(|nm| nm.abs()).fold(most_nm, f64::max);
            }
        }
        most_nm
    };
    let (told, untold) = (run(true), run(false));
    assert!(told < 0.2 * untold && untold > 1.0, "{told} N·m, {untold} N·m");
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
fn base_alone_moves_as_base_of_led_robot() {
    let controller = controller();
    let base: BaseController<11> = BaseController::new(&PAPER_COVER, &Parameters::PAPER).unwrap();
    let mut whole = controller.enter(ControlLaw::FollowMe, &at_home()).unwrap();
    let mut alone = base.enter();
    let mut input = input(at_home());
    input.guard = BaseGuard { speed_m_s: Some(0.1), ..BaseGuard::NONE };
    for step in 0..400 {
        input.taxel_force_n[2] = if step < 200 { 20.0 } else { 0.0 };
        input.robot.base_pose_world[2] = 0.4 + 1e-3 * f64::from(step);
        let (taxel_force_n, yaw_world_rad) = (input.taxel_force_n, input.robot.base_pose_world[2]);
        let base_input = BaseInput { yaw_world_rad, taxel_force_n, guard: input.guard, dt_s: input.dt_s };
        let law = if step < 300 { ControlLaw::FollowMe } else { ControlLaw::Hold };
        let expected = controller.step(law, &mut whole, &input).unwrap();
        let output = match law {
            ControlLaw::Hold => base.hold(&mut alone, &base_input).unwrap(),
            _ => base.step(&mut alone, &base_input).unwrap(),
        };
        assert_eq!(output.velocity_body, expected.command.base_velocity_body, "step {step}");
        assert_eq!(output.cover_wrench_base, expected.cover_wrench_base, "step {step}");
        let of_the_base = LimitsHit { joint_range: false, ..expected.limits };
        assert_eq!(output.limits, LimitsHit { torque_rate: false, ..of_the_base });
    }
    let bad =
        BaseInput { yaw_world_rad: 0.0, taxel_force_n: [f64::NAN; 11], guard: BaseGuard::NONE, dt_s: 1e-3 };
    let before = alone;
    assert!(base.step(&mut alone, &bad).is_err());
    assert!(
        base.step(&mut alone, &BaseInput { yaw_world_rad: f64::NAN, taxel_force_n: [0.0; 11], ..bad })
            .is_err()
    );
    assert_eq!(alone, before);
}

#[test]
fn an_arm_alone_is_the_arm_of_the_whole_robot_untouched() {
    let whole = controller();
    let arm: ArmController<7> =
        ArmController::new(&PANDA, &MOCA_MOUNT, &Payload::NONE, &Parameters::PAPER).unwrap();
    let mut robot = at_home();
    let mut state = arm.enter(&robot).unwrap();
    let mut expected = whole.enter(ControlLaw::FollowMe, &robot).unwrap();
    for step in 0..200 {
        robot.q_rad[1] = PANDA.home_rad[1] + 1e-4 * f64::from(step);
        let input = ArmInput { robot, flange_wrench_world: None, dt_s: 1e-3 };
        let law = if step < 100 { ControlLaw::FollowMe } else { ControlLaw::Hold };
        let output = match law {
            ControlLaw::Hold => arm.hold(&mut state, &input).unwrap(),
            _ => arm.step(&mut state, &input).unwrap(),
        };
        let whole = whole.step(law, &mut expected, &self::input(robot)).unwrap();
        assert_eq!(output.torque_nm, whole.command.arm_torque_nm, "step {step}");
        assert_eq!((output.flange, output.flange_desired), (whole.flange, whole.flange_desired));
    }
}

#[test]
fn invalid_guard_is_refused_guard_holds_one_step() {
    let controller = controller();
    let before = controller.enter(ControlLaw::Impedance, &at_home()).unwrap();
    let mut pressed = input(at_home());
    pressed.taxel_force_n[5] = 20.0;
    let blocked = BaseGuard { speed_m_s: Some(0.0), ..BaseGuard::NONE };
    let mut state = before;
    let held = controller
        .step(ControlLaw::Impedance, &mut state, &ControlInput { guard: blocked, ..pressed })
        .unwrap();
    assert_eq!(held.command.base_velocity_body, [0.0; 3]);
    assert!(held.limits.guard);
    let free = controller.step(ControlLaw::Impedance, &mut state, &pressed).unwrap();
    assert!(free.command.base_velocity_body[0] < 0.0 && !free.limits.guard);
    let mut state = before;
    let negative = BaseGuard { speed_m_s: Some(-0.1), ..BaseGuard::NONE };
    let refused =
        controller.step(ControlLaw::Impedance, &mut state, &ControlInput { guard: negative, ..pressed });
    assert_eq!(refused, Err(ControlError::GuardSpeed { speed_m_s: -0.1 }));
    let nowhere = BaseGuard { instead_body: Some([0.0, f64::NAN, 0.0]), ..BaseGuard::NONE };
    let refused =
        controller.step(ControlLaw::Impedance, &mut state, &ControlInput { guard: nowhere, ..pressed });
    assert_eq!(refused, Err(ControlError::NotFinite { what: "guard.instead_body", index: 1 }));
    assert_eq!(state, before);
}

/// A controller with room for 48 taxels gives the same bits as one with room for its own.
#[test]
fn unused_taxel_room_changes_no_bit() {
    const ROOM: usize = 48;
    let roomy: WholeBodyController<7, ROOM> =
        WholeBodyController::new(&PANDA, &MOCA_MOUNT, &Payload::NONE, &PAPER_COVER, &Parameters::PAPER)
            .unwrap();
    let exact = controller();
    for law in LAWS {
        let (mut state, mut roomy_state) =
            (exact.enter(law, &at_home()).unwrap(), roomy.enter(law, &at_home()).unwrap());
        let mut input = input(at_home());
        let mut roomy_input = ControlInput::new(at_home(), [f64::NAN; ROOM], 1e-3);
        roomy_input.guard.blocked = [true; ROOM];
        roomy_input.guard.outward_m_s = Some([f64::NAN; ROOM]);
        input.guard.outward_m_s = Some([f64::INFINITY; 11]);
        for step in 0..50 {
            for i in 0..11 {
                let (force_n, most_m_s) = (f64::from(step % 7) + 0.3, 0.02 * f64::from(step) - 0.2);
                (input.taxel_force_n[i], roomy_input.taxel_force_n[i]) = (force_n, force_n);
                let (blocked, outward) = (i == 7, [f64::INFINITY, most_m_s][usize::from(i == 5)]);
                (input.guard.blocked[i], roomy_input.guard.blocked[i]) = (blocked, blocked);
                input.guard.outward_m_s.as_mut().unwrap()[i] = outward;
                roomy_input.guard.outward_m_s.as_mut().unwrap()[i] = outward;
            }
            let output = exact.step(law, &mut state, &input).unwrap();
            assert_eq!(output, roomy.step(law, &mut roomy_state, &roomy_input).unwrap(), "{law:?} {step}");
        }
    }
}

#[test]
fn cover_with_too_many_taxels_is_refused() {
    let of = |count: usize| BaseController::<11>::new(&PAPER_COVER[..count], &Parameters::PAPER).unwrap();
    for count in [0, 1, 11] {
        let input =
            BaseInput { yaw_world_rad: 0.0, taxel_force_n: [20.0; 11], guard: BaseGuard::NONE, dt_s: 1e-3 };
        let controller = of(count);
        let wrench = controller.step(&mut controller.enter(), &input).unwrap().cover_wrench_base;
        let alone: [f64; 11] = core::array::from_fn(|i| if i < count { 20.0 } else { 0.0 });
        assert_eq!(wrench, moca_wbc::cover_wrench(&PAPER_COVER, &alone));
    }
    let refused = BaseController::<4>::new(&PAPER_COVER, &Parameters::PAPER).unwrap_err();
    assert_eq!(refused.to_string(), "number of taxels = 11 is outside 0 to 4");
}

/// Torques that a law wanted when it was ended would fade for a fifth of a second, and drive the joints meanwhile.
#[test]
fn torques_of_a_law_that_has_ended_drive_no_joint_on() {
    let whole = controller();
    let arm: ArmController<7> =
        ArmController::new(&PANDA, &MOCA_MOUNT, &Payload::NONE, &Parameters::PAPER).unwrap();
    let mut robot = at_home();
    let mut state = whole.enter(ControlLaw::FollowMe, &robot).unwrap();
    let mut of_arm = arm.enter(&robot).unwrap();
    let of = |robot| ArmInput { robot, flange_wrench_world: None, dt_s: 1e-3 };
    for step in 0..30 {
        // the tool is away from its place, and the law pulls
        robot.q_rad[1] = PANDA.home_rad[1] + if step > 0 { 0.02 } else { 0.0 };
        whole.step(ControlLaw::FollowMe, &mut state, &input(robot)).unwrap();
        arm.step(&mut of_arm, &of(robot)).unwrap();
    }
    let gravity = whole.model().dynamics(0.4, &robot.q_rad, &[0.0; 7]).gravity();
    let off_nm = |torque_nm: [f64; 7]| (0..7).map(|i| (torque_nm[i] - gravity[i]).abs()).fold(0.0, f64::max);
    let pulling = whole.step(ControlLaw::FollowMe, &mut state, &input(robot)).unwrap();
    assert!(off_nm(pulling.command.arm_torque_nm) > 3.0, "{pulling:?}");
    let mut too_fast = robot;
    too_fast.dq_rad_s[6] = 3.0;
    let ended = whole.step(ControlLaw::FollowMe, &mut state, &input(too_fast)).unwrap();
    let of_arm_ended = arm.step(&mut of_arm, &of(too_fast)).unwrap();
    assert!(ended.exceeded.is_some() && of_arm_ended.exceeded == ended.exceeded, "{ended:?}");
    assert_eq!(state.law(), ControlLaw::Hold);
    for _ in 0..40 {
        let held = whole.step(ControlLaw::Hold, &mut state, &input(robot)).unwrap();
        let of_arm_held = arm.hold(&mut of_arm, &of(robot)).unwrap();
        if off_nm(held.command.arm_torque_nm) < 1e-6 && off_nm(of_arm_held.torque_nm) < 1e-6 {
            return;
        }
    }
    panic!("the posture is held with other torques than gravity's 40 ms later: {state:?}");
}
