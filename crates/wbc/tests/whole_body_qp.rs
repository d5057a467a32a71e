//! All limits in one quadratic programme: what it is nearest to, what it keeps, and what happens where it fails.
#![allow(clippy::unwrap_used, clippy::float_cmp, clippy::needless_range_loop, reason = "tests")]

mod common;

use common::{Loop, Push, flange_error};
use moca_qp::{Metric, Row, WorkingSet};
use moca_wbc::guard::CoverOutline;
use moca_wbc::linalg::Cholesky;
use moca_wbc::opspace::{ArmDynamics, BlockWeight, TaskDynamics, WholeBodyForce};
use moca_wbc::robot::{MOCA_MOUNT, PANDA, PAPER_COVER};
use moca_wbc::{
    ArmModel, BaseGuard, ControlInput, ControlLaw, Corrections, Limits, LimitsHit, Parameters, Payload,
    QpUse, RobotState, Scalar, WholeBodyController,
};
use nalgebra::SMatrix;
use proptest::array::{uniform3, uniform6, uniform7, uniform11};
use proptest::prelude::*;

const CORRECTED: Corrections =
    Corrections { null_space_damping: true, base_coupling: true, flange_wrench_feedforward: false };

fn controller<T: Scalar>(corrections: Corrections) -> WholeBodyController<7, 11, T> {
    let parameters = Parameters { corrections, ..Parameters::PAPER };
    WholeBodyController::new(&PANDA, &MOCA_MOUNT, &Payload::NONE, &PAPER_COVER, &parameters).unwrap()
}

prop_compose! {
    /// Anything finite.
    fn any_robot()(
        pose in uniform3(-3.0..3.0),
        velocity in uniform3(-1.0..1.0),
        q in uniform7(-3.0..3.0),
        dq in uniform7(-3.0..3.0),
        torque in uniform7(-90.0..90.0),
    ) -> RobotState<7> {
        RobotState {
            base_pose_world: pose,
            base_velocity_world: velocity,
            q_rad: q,
            dq_rad_s: dq,
            torque_measured_nm: torque,
            flange_wrench_world: None,
        }
    }
}

prop_compose! {
    /// Moving slowly, about home.
    fn calm_robot()(
        yaw in -3.0..3.0,
        velocity in uniform3(-0.1..0.1),
        off in uniform7(-0.3..0.3),
        dq in uniform7(-0.1..0.1),
    ) -> RobotState<7> {
        RobotState {
            base_pose_world: [0.3, -0.2, yaw],
            base_velocity_world: velocity,
            dq_rad_s: dq,
            flange_wrench_world: Some([0.0; 6]),
            ..RobotState::at_rest(core::array::from_fn(|i| PANDA.home_rad[i] + off[i]))
        }
    }
}

prop_compose! {
    fn any_guard()(
        speed in prop::option::of(0.0..0.3),
        blocked in uniform11(prop::bool::weighted(0.1)),
        outward in prop::option::of(uniform11(prop_oneof![3 => Just(f64::INFINITY), 1 => -0.1..0.1])),
        bounds in prop::option::of(0.0..0.1),
        instead in prop::option::weighted(0.1, uniform3(-0.1..0.1)),
    ) -> BaseGuard<11> {
        BaseGuard {
            speed_m_s: speed,
            blocked,
            outward_m_s: outward,
            bounds_body: bounds.map(|most: f64| [[-most; 3], [0.3; 3]]),
            room_body: bounds.map(|_| [[-0.3; 3], [0.3; 3]]),
            instead_body: instead,
        }
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(200))]

    /// eq. (6) by another way: of all forces on base and arm with the wanted wrench at the tool the nearest to τ_0 in W, with the
    /// wrench as six rows of a quadratic programme.
    #[test]
    fn the_closed_form_is_the_optimum_without_bounds(
        robot in calm_robot(),
        wrench in uniform6(-30.0..30.0),
        null_base in uniform3(-50.0..50.0),
        null_arm in uniform7(-5.0..5.0),
        eta in 0.3..5.0,
    ) {
        let model: ArmModel<7, f64> = ArmModel::new(&PANDA, &MOCA_MOUNT, &Payload::NONE).unwrap();
        let dynamics = model.dynamics(robot.base_pose_world[2], &robot.q_rad, &robot.dq_rad_s);
        let arm = ArmDynamics::new(&dynamics).unwrap();
        let virtual_mass = [4.0, 4.0, 2.0];
        let task = TaskDynamics::new(virtual_mass, &arm);
        let null = WholeBodyForce { base: null_base, arm: null_arm };
        let closed = BlockWeight::new(eta, 1.0).factor(&task).unwrap().force(&wrench, &null);

        let mass = Cholesky::new(&dynamics.mass).unwrap();
        let mut weight = [[0.0; 10]; 10];
        let unit = |i: usize| core::array::from_fn(|j| f64::from(u8::from(i == j)));
        for i in 0..3 {
            weight[i][i] = eta * eta / virtual_mass[i];
        }
        let mut feels = [[0.0; 10]; 6];
        for i in 0..10 {
            let force = WholeBodyForce {
                base: core::array::from_fn(|j| f64::from(u8::from(i == j))),
                arm: if i < 3 { [0.0; 7] } else { unit(i - 3) },
            };
            if i >= 3 {
                weight[i][3..].copy_from_slice(&mass.solve(&force.arm));
            }
            for (row, value) in feels.iter_mut().zip(task.acceleration(&force)) {
                row[i] = value;
            }
        }
        let inverse: SMatrix<f64, 6, 6> = task.inverse_task_inertia();
        let wanted = moca_wbc::linalg::times(&inverse, &wrench);
        let rows: [Row<10>; 6] =
            core::array::from_fn(|i| Row { normal: feels[i], lower: wanted[i], upper: wanted[i] });
        let mut target = [0.0; 10];
        target[..3].copy_from_slice(&null_base);
        target[3..].copy_from_slice(&null_arm);
        let solved = Metric::new(&weight).unwrap().nearest(&target, &rows, &WorkingSet::EMPTY).unwrap().x;
        let size = closed.base.iter().chain(&closed.arm).fold(0.0_f64, |most, f| most.max(f.abs()));
        for (a, b) in closed.base.iter().chain(&closed.arm).zip(&solved) {
            prop_assert!((a - b).abs() <= 1e-9 * size, "{a} {b}");
        }
    }

    /// Without an active limit there is nothing to solve.
    #[test]
    fn a_law_that_keeps_all_limits_is_the_same_to_the_bit(
        robot in calm_robot(),
        taxels in uniform11(0.0..3.0),
        follow_me in any::<bool>(),
        corrected in any::<bool>(),
    ) {
        let law = if follow_me { ControlLaw::FollowMe } else { ControlLaw::Impedance };
        let controller = controller::<f64>(if corrected { CORRECTED } else { Corrections::LITERAL });
        let mut state = controller.enter(law, &robot).unwrap();
        let mut used = QpUse::default();
        for _ in 0..5 {
            let (mut by_qp, input) = (state, ControlInput::new(robot, taxels, 1e-3));
            let closed = controller.step(law, &mut state, &input).unwrap();
            let output = controller.step_by_qp(law, &mut by_qp, &input, &mut used).unwrap();
            prop_assert_eq!(used.programmes == 0, output.limits == LimitsHit::NONE, "{:?}", output.limits);
            if closed.limits == LimitsHit::NONE && !output.limits.joint_range {
                prop_assert_eq!(used, QpUse::default());
                prop_assert_eq!(output, closed);
                prop_assert_eq!(by_qp, state);
            }
            state = by_qp;
        }
    }

    /// A base that a guard keeps from giving way: the arm makes up for it with the torques of the closed form.
    #[test]
    fn what_a_guard_refuses_the_base_the_arm_makes_up_for(
        robot in calm_robot(),
        taxels in uniform11(0.0..2.0),
        corrected in any::<bool>(),
    ) {
        let law = ControlLaw::Impedance;
        let mut controller_parameters = Parameters::PAPER;
        controller_parameters.corrections = if corrected { CORRECTED } else { Corrections::LITERAL };
        // so much that it is the guard alone that takes something from the law
        controller_parameters.limits.torque_rate_nm_s = 1e5;
        let controller: WholeBodyController<7, 11> =
            WholeBodyController::new(&PANDA, &MOCA_MOUNT, &Payload::NONE, &PAPER_COVER, &controller_parameters)
                .unwrap();
        let guard = BaseGuard { speed_m_s: Some(0.0), ..BaseGuard::NONE };
        let mut state = controller.enter(law, &robot).unwrap();
        let mut input = ControlInput::new(robot, taxels, 1e-3);
        controller.step(law, &mut state, &input).unwrap();
        input.guard = guard;
        let (mut free, mut by_qp) = (state, state);
        let unguarded = controller.step(law, &mut free, &ControlInput { guard: BaseGuard::NONE, ..input }).unwrap();
        let closed = controller.step(law, &mut state, &input).unwrap();
        let mut used = QpUse::default();
        let output = controller.step_by_qp(law, &mut by_qp, &input, &mut used).unwrap();
        prop_assert_eq!(output.command.base_velocity_body, closed.command.base_velocity_body);
        let torque = |i: usize| [&output, &closed, &unguarded].map(|output| output.command.arm_torque_nm[i]);
        let made_up = (0..7).fold(0.0_f64, |most, i| most.max((torque(i)[1] - torque(i)[2]).abs()));
        for i in 0..7 {
            let [by_qp, closed, _] = torque(i);
            // the task's weight is finite
            prop_assert!((by_qp - closed).abs() <= 0.01 * made_up + 1e-9, "{by_qp} {closed} {made_up}");
        }
    }

    /// Whatever comes, the command is inside every limit, the base inside its guard, and the programme does not fail.
    #[test]
    fn no_input_gets_a_command_past_the_limits(
        steps in prop::collection::vec((any_robot(), uniform11(0.0..200.0), any_guard(), any::<bool>()), 1..20),
        corrected in any::<bool>(),
    ) {
        let limits = Limits::for_arm(&PANDA);
        let controller = controller::<f64>(if corrected { CORRECTED } else { Corrections::LITERAL });
        let outline: CoverOutline<11, f64> = CoverOutline::new(&PAPER_COVER).unwrap();
        let home = RobotState::at_rest(PANDA.home_rad);
        let mut state = controller.enter(ControlLaw::Impedance, &home).unwrap();
        let mut last: Option<moca_wbc::RobotCommand<7>> = None;
        for (robot, force, guard, follow_me) in steps {
            let law = if follow_me { ControlLaw::FollowMe } else { ControlLaw::Impedance };
            let (mut used, mut alone) = (QpUse::default(), state);
            let input = ControlInput { guard, ..ControlInput::new(robot, force, 1e-3) };
            let Ok(output) = controller.step_by_qp(law, &mut state, &input, &mut used) else { continue };
            prop_assert!(!used.fell_back, "{used:?}");
            prop_assert!(used.programmes <= 2);
            let command = output.command;
            for i in 0..7 {
                prop_assert!(command.arm_torque_nm[i].abs() <= limits.torque_nm[i]);
                if let Some(last) = last {
                    let change = (command.arm_torque_nm[i] - last.arm_torque_nm[i]).abs();
                    prop_assert!(change <= limits.torque_rate_nm_s * 1e-3 + 1e-9, "{change} N·m");
                }
            }
            for i in 0..3 {
                prop_assert!(command.base_velocity_body[i].abs() <= limits.base_velocity[i]);
                let last = last.map_or(0.0, |last| last.base_velocity_body[i]);
                let change = (command.base_velocity_body[i] - last).abs();
                prop_assert!(change <= limits.base_acceleration[i] * 1e-3 + 1e-12, "{change}");
            }
            // what the closed form can keep of the guard, this can
            if output.exceeded.is_none() {
                let closed = controller.step(law, &mut alone, &input).unwrap().command.base_velocity_body;
                prop_assert!(!outline.permits(&guard, &closed) || outline.permits(&guard, &command.base_velocity_body)
                    || guard.outward_m_s.is_some());
            }
            last = Some(command);
        }
    }
}

/// If the programme fails, here because single precision loses a stretched arm's metric, the limits are kept one after the
/// other, and the step reports it.
#[test]
fn a_programme_that_fails_leaves_the_limits_to_the_closed_form() {
    let controller = controller::<f32>(CORRECTED);
    let mut fell_back = 0;
    for step in 0..200_u8 {
        let robot: RobotState<7, f32> = RobotState {
            base_pose_world: [0.0; 3],
            base_velocity_world: [0.0; 3],
            q_rad: core::array::from_fn(|i| 2.0 * (f32::from(step) * (1.0 + i as f32)).sin()),
            dq_rad_s: [0.0; 7],
            torque_measured_nm: [0.0; 7],
            flange_wrench_world: None,
        };
        let mut state = controller.enter(ControlLaw::Impedance, &robot).unwrap();
        let mut input = ControlInput::new(robot, [0.0; 11], 1e-3_f32);
        input.taxel_force_n[5] = 200.0;
        let (mut closed_state, mut used) = (state, QpUse::default());
        let output = controller.step_by_qp(ControlLaw::Impedance, &mut state, &input, &mut used).unwrap();
        for (torque, most) in output.command.arm_torque_nm.iter().zip(PANDA.torque_max_nm) {
            assert!(f64::from(torque.abs()) <= most);
        }
        if used.fell_back {
            let closed = controller.step(ControlLaw::Impedance, &mut closed_state, &input).unwrap();
            assert_eq!((output, state), (closed, closed_state));
            fell_back += 1;
        }
    }
    assert!((1..100).contains(&fell_back), "{fell_back}");
}

/// Leant on for a second, joint 4 between the end of its range and where the repulsion from it begins.
#[test]
fn near_the_end_of_a_range_the_flange_keeps_its_place() {
    let posture = [0.0, -1.2, 0.0, -2.95, 0.0, 1.75, 0.785];
    let worst = |by_qp: bool| {
        let mut parameters = Parameters { corrections: CORRECTED, ..Parameters::PAPER };
        parameters.gains.posture_rad = posture;
        let robot = RobotState { flange_wrench_world: Some([0.0; 6]), ..RobotState::at_rest(posture) };
        let mut run = Loop::starting(ControlLaw::Impedance, &parameters, robot, 1e-3);
        run.guard.speed_m_s = Some(0.1);
        run.by_qp = by_qp.then(QpUse::default);
        (1..1000).fold(0.0_f64, |worst, tick| {
            let push = Push::taxels(&[6], 40.0).scaled((f64::from(tick) / 300.0).min(1.0));
            let output = run.step(&push);
            assert!(output.exceeded.is_none() && !run.by_qp.is_some_and(|used| used.fell_back));
            assert!(run.robot.q_rad[3] > PANDA.q_min_rad[3]);
            worst.max(flange_error(&output))
        })
    };
    let [one_by_one, together] = [worst(false), worst(true)];
    assert!(together < 5e-4 && one_by_one > 2e-3, "{together} {one_by_one}");
}
