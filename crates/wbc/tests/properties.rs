//! Properties that hold for any input.
#![allow(clippy::unwrap_used, clippy::float_cmp, clippy::needless_range_loop, reason = "tests")]

use moca_wbc::guard::{BaseGuard, CoverOutline};
use moca_wbc::limits::{BaseLimits, JointRepulsion, REPULSION_BAND_RAD, TorqueLimits};
use moca_wbc::opspace::{ArmDynamics, AxisWeight, BlockWeight, TaskDynamics, WholeBodyForce};
use moca_wbc::robot::{MOCA_MOUNT, PANDA, PAPER_COVER};
use moca_wbc::square_root::inverse_square_root;
use moca_wbc::{
    ArmModel, ControlError, ControlInput, ControlLaw, LimitsHit, WholeBodyController, admittance,
};
use moca_wbc::{Corrections, Limits, Parameters, Payload, RobotState};
use nalgebra::SMatrix;
use proptest::array::{uniform3, uniform6, uniform7, uniform11};
use proptest::prelude::*;

/// Ordinary numbers, absurd ones, and no numbers.
fn any_number() -> impl Strategy<Value = f64> {
    prop_oneof![
        20 => -10.0..10.0,
        4 => -1e6..1e6,
        1 => Just(1e300),
        1 => Just(f64::NAN),
        1 => Just(f64::INFINITY),
        1 => Just(f64::NEG_INFINITY),
    ]
}

fn ordinary(most: f64) -> impl Strategy<Value = f64> {
    -most..most
}

prop_compose! {
    fn any_input(hostile: bool)(
        pose in uniform3(ordinary(3.0)),
        velocity in uniform3(ordinary(1.0)),
        q in uniform7(ordinary(3.0)),
        dq in uniform7(ordinary(3.0)),
        torque in uniform7(ordinary(90.0)),
        force in uniform11(ordinary(1e4)),
        wrench in prop::option::of(uniform6(ordinary(200.0))),
        dt in prop_oneof![Just(1e-3), 1e-4..0.05, Just(1.0)],
        spoiled in 0..9_usize,
        spoiler in any_number(),
        spoil in any::<bool>(),
    ) -> ControlInput<7, 11> {
        let robot = RobotState {
            base_pose_world: pose,
            base_velocity_world: velocity,
            q_rad: q,
            dq_rad_s: dq,
            torque_measured_nm: torque,
            flange_wrench_world: None,
        };
        let mut input = ControlInput { flange_wrench_world: wrench, ..ControlInput::new(robot, force, dt) };
        if hostile && spoil {
            match spoiled {
                0 => input.robot.base_pose_world[2] = spoiler,
                1 => input.robot.base_velocity_world[0] = spoiler,
                2 => input.robot.q_rad[1] = spoiler,
                3 => input.robot.dq_rad_s[2] = spoiler,
                4 => input.robot.torque_measured_nm[3] = spoiler,
                5 => input.taxel_force_n[0] = spoiler,
                6 => input.flange_wrench_world = Some([spoiler; 6]),
                7 => input.robot.flange_wrench_world = Some([spoiler; 6]),
                _ => input.dt_s = spoiler,
            }
        }
        input
    }
}

fn any_law() -> impl Strategy<Value = ControlLaw> {
    prop_oneof![Just(ControlLaw::Hold), Just(ControlLaw::Impedance), Just(ControlLaw::FollowMe)]
}

prop_compose! {
    fn any_guard()(
        speed in prop::option::of(0.0..0.6_f64),
        blocked in prop::collection::vec(prop::bool::weighted(0.15), 11),
        bounds in prop::option::weighted(0.3, (uniform3(0.0..0.3_f64), uniform3(0.0..0.3_f64))),
        instead in prop::option::weighted(0.2, uniform3(ordinary(0.5))),
    ) -> BaseGuard<11> {
        BaseGuard {
            speed_m_s: speed,
            blocked: std::array::from_fn(|i| blocked[i]),
            bounds_body: bounds.map(|(least, most)| [least.map(|v| -v), most]),
            instead_body: instead,
            ..BaseGuard::NONE
        }
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(2000))]

    #[test]
    fn no_velocity_passes_guard_or_limits(
        guard in any_guard(),
        steps in prop::collection::vec(uniform3(ordinary(2.0)), 1..60),
        start in uniform3(ordinary(0.5)),
    ) {
        let limits: BaseLimits<f64> = BaseLimits::from(&Limits::for_arm(&PANDA));
        let outline = CoverOutline::new(&PAPER_COVER).unwrap();
        let most = Limits::for_arm(&PANDA);
        let mut last = start;
        let mut inside = outline.permits(&guard, &last);
        for wanted in steps {
            let mut hit = LimitsHit::default();
            let next = limits.guarded_velocity(&outline, &guard, &wanted, &last, 1e-3, &mut hit);
            for i in 0..3 {
                prop_assert!(next[i].abs() <= most.base_velocity[i].max(last[i].abs()) + 1e-12);
                prop_assert!((next[i] - last[i]).abs() <= most.base_acceleration[i] * 1e-3 + 1e-12);
            }
            if inside {
                let speed = outline.fastest(&next);
                prop_assert!(guard.speed_m_s.is_none_or(|limit| speed <= limit + 1e-9), "{speed}");
                if let Some([least, most]) = guard.bounds_body {
                    for i in 0..3 {
                        prop_assert!(next[i] >= least[i] - 1e-8 && next[i] <= most[i] + 1e-8, "{next:?}");
                    }
                }
                for taxel in (0..11).filter(|taxel| guard.blocked[*taxel]) {
                    prop_assert!(outline.outward(taxel, &next) <= 1e-8, "T{} {next:?}", taxel + 1);
                }
            }
            inside |= outline.permits(&guard, &next);
            last = next;
        }
        // whatever it started from: half a second of the allowed acceleration is enough to be inside
        let wanted = [2.0, -2.0, 2.0];
        for _ in 0..600 {
            last = limits.guarded_velocity(&outline, &guard, &wanted, &last, 1e-3, &mut LimitsHit::default());
        }
        let speed = outline.fastest(&last);
        prop_assert!(guard.speed_m_s.is_none_or(|limit| speed <= limit + 1e-9), "{speed}");
    }

    #[test]
    fn a_guard_with_nothing_to_object_to_changes_no_bit(
        wanted in uniform3(ordinary(2.0)),
        last in uniform3(ordinary(0.5)),
    ) {
        let limits: BaseLimits<f64> = BaseLimits::from(&Limits::for_arm(&PANDA));
        let outline = CoverOutline::<11, f64>::new(&PAPER_COVER).unwrap();
        let (mut free, mut guarded) = (LimitsHit::default(), LimitsHit::default());
        let without = limits.velocity(&wanted, &last, 1e-3, &mut free);
        let guard = BaseGuard { speed_m_s: Some(3.0), ..BaseGuard::NONE };
        let with = limits.guarded_velocity(&outline, &guard, &wanted, &last, 1e-3, &mut guarded);
        prop_assert_eq!(with.map(f64::to_bits), without.map(f64::to_bits));
        prop_assert_eq!(free, guarded);
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]

    #[test]
    fn no_input_gets_a_command_past_the_limits(
        steps in prop::collection::vec((any_law(), any_input(true)), 1..40),
        corrected in any::<bool>(),
    ) {
        let limits = Limits::for_arm(&PANDA);
        let corrections = Corrections { null_space_damping: corrected, base_coupling: corrected, flange_wrench_feedforward: corrected };
        let parameters = Parameters { corrections, ..Parameters::PAPER };
        let controller: WholeBodyController<7, 11> =
            WholeBodyController::new(&PANDA, &MOCA_MOUNT, &Payload::NONE, &PAPER_COVER, &parameters).unwrap();
        let home = RobotState::at_rest(PANDA.home_rad);
        let mut state = controller.enter(ControlLaw::Hold, &home).unwrap();
        let mut last: Option<moca_wbc::RobotCommand<7>> = None;
        for (law, input) in steps {
            let before = state;
            match controller.step(law, &mut state, &input) {
                Ok(output) => {
                    let command = output.command;
                    let credited = input.dt_s.min(limits.period_s) * (1.0 + 1e-9);
                    for i in 0..7 {
                        prop_assert!(command.arm_torque_nm[i].abs() <= limits.torque_nm[i]);
                        if let Some(last) = last {
                            let change = (command.arm_torque_nm[i] - last.arm_torque_nm[i]).abs();
                            prop_assert!(change <= limits.torque_rate_nm_s * credited + 1e-9, "{change} N·m");
                        }
                    }
                    for i in 0..3 {
                        prop_assert!(command.base_velocity_body[i].abs() <= limits.base_velocity[i]);
                        let last = last.map_or(0.0, |last| last.base_velocity_body[i]);
                        let change = (command.base_velocity_body[i] - last).abs();
                        prop_assert!(change <= limits.base_acceleration[i] * credited + 1e-12, "{change}");
                    }
                    last = Some(command);
                }
                // an error, not a number; and nothing remembered of it
                Err(_) => prop_assert_eq!(state, before),
            }
        }
    }

    #[test]
    fn finite_inputs_of_ordinary_size_are_never_refused(law in any_law(), input in any_input(false)) {
        let controller: WholeBodyController<7, 11> =
            WholeBodyController::new(&PANDA, &MOCA_MOUNT, &Payload::NONE, &PAPER_COVER, &Parameters::PAPER).unwrap();
        let mut state = controller.enter(law, &input.robot).unwrap();
        prop_assert!(controller.step(law, &mut state, &input).is_ok());
    }

    #[test]
    fn single_precision_keeps_the_same_limits(law in any_law(), input in any_input(false)) {
        let controller: WholeBodyController<7, 11, f32> =
            WholeBodyController::new(&PANDA, &MOCA_MOUNT, &Payload::NONE, &PAPER_COVER, &Parameters::PAPER).unwrap();
        let of = |x: f64| nalgebra::convert::<f64, f32>(x);
        let robot = RobotState {
            base_pose_world: input.robot.base_pose_world.map(of),
            base_velocity_world: input.robot.base_velocity_world.map(of),
            q_rad: input.robot.q_rad.map(of),
            dq_rad_s: input.robot.dq_rad_s.map(of),
            torque_measured_nm: input.robot.torque_measured_nm.map(of),
            flange_wrench_world: None,
        };
        let mut state = controller.enter(law, &robot).unwrap();
        let input = ControlInput::new(robot, input.taxel_force_n.map(of), of(input.dt_s));
        let output = controller.step(law, &mut state, &input).unwrap();
        for (torque, most) in output.command.arm_torque_nm.iter().zip(PANDA.torque_max_nm) {
            prop_assert!(f64::from(torque.abs()) <= most);
        }
    }

    #[test]
    fn a_missed_tick_credits_no_more_than_one(wanted in uniform7(ordinary(200.0)), last in uniform7(ordinary(12.0))) {
        let limits = TorqueLimits::<7, f64>::from(&Limits::for_arm(&PANDA));
        let mut hit = LimitsHit::default();
        let punctual = limits.limited(&wanted, &last, 1e-3, &mut hit);
        let late = limits.limited(&wanted, &last, 2e-3, &mut hit);
        prop_assert_eq!(punctual, late);
        let half = limits.limited(&wanted, &last, 0.5e-3, &mut hit);
        for i in 0..7 {
            prop_assert!((half[i] - last[i]).abs() <= 0.5 + 1e-12);
        }
    }

    #[test]
    fn the_weighted_torques_keep_their_identities(
        q in uniform7(ordinary(2.5)),
        yaw in ordinary(3.0),
        wrench in uniform6(ordinary(50.0)),
        null_base in uniform3(ordinary(20.0)),
        null_arm in uniform7(ordinary(20.0)),
        eta in 0.05..20.0,
    ) {
        let model = ArmModel::<7, f64>::new(&PANDA, &MOCA_MOUNT, &Payload::NONE).unwrap();
        let dynamics = model.dynamics(yaw, &q, &[0.0; 7]);
        let arm = ArmDynamics::new(&dynamics).unwrap();
        let task = TaskDynamics::new([4.0, 4.0, 2.0], &arm);
        let null = WholeBodyForce { base: null_base, arm: null_arm };
        let inverse = task.inverse_task_inertia();
        prop_assert!((inverse - inverse.transpose()).amax() < 1e-12, "{inverse}");
        prop_assume!(inverse.symmetric_eigenvalues().min() > 1e-4);
        let weighted = BlockWeight::new(eta, 1.0).factor(&task).unwrap();
        let force = weighted.force(&wrench, &null);
        close(&task.wrench(&force).unwrap(), &wrench, 1e-7)?;
        let free = weighted.force(&[0.0; 6], &null);
        close(&task.acceleration(&free), &[0.0; 6], 1e-7)?;
        // only the ratio of the gains matters, and a block is a special case of a gain per axis
        let scaled = BlockWeight::new(7.0 * eta, 7.0).factor(&task).unwrap().force(&wrench, &null);
        close(&scaled.arm, &force.arm, 1e-7)?;
        let general = AxisWeight::new([eta; 3], [1.0; 7]).unwrap().force(&task, &wrench, &null).unwrap();
        close(&general.arm, &force.arm, 1e-6)?;
        close(&general.base, &force.base, 1e-6)?;
        // H = I is the classic operational-space law: τ_0 + Jᵀ(F − J̄ᵀτ_0)
        let classic = BlockWeight::new(1.0, 1.0).factor(&task).unwrap().force(&wrench, &null);
        let left: [f64; 6] = {
            let achieved = task.wrench(&null).unwrap();
            core::array::from_fn(|i| wrench[i] - achieved[i])
        };
        let arm = moca_wbc::linalg::transpose_times(dynamics.kinematics.arm_jacobian(), &left);
        close(&classic.arm, &core::array::from_fn::<f64, 7, _>(|i| null_arm[i] + arm[i]), 1e-6)?;
    }

    #[test]
    fn the_joint_repulsion_never_adds_energy(
        centre in -0.1..0.1_f64,
        swing in uniform3(-0.2..0.2_f64),
        phase in uniform3(0.0..core::f64::consts::TAU),
        joint in 0..7_usize,
        high in any::<bool>(),
    ) {
        let repulsion = JointRepulsion::<7, f64>::new(&PANDA);
        let edge = if high { PANDA.q_max_rad[joint] - REPULSION_BAND_RAD } else { PANDA.q_min_rad[joint] + REPULSION_BAND_RAD };
        let at = |t: f64| -> (f64, f64) {
            let mut q = (edge + centre, 0.0);
            for k in 0..3_u8 {
                let w = f64::from(k + 1);
                q.0 += swing[usize::from(k)] * (w * t + phase[usize::from(k)]).sin();
                q.1 += swing[usize::from(k)] * w * (w * t + phase[usize::from(k)]).cos();
            }
            q
        };
        let steps = 4000_u32;
        let dt = core::f64::consts::TAU / f64::from(steps);
        let mut work = 0.0;
        for step in 0..steps {
            let (mut q, mut dq) = (PANDA.home_rad, [0.0; 7]);
            (q[joint], dq[joint]) = at(f64::from(step) * dt);
            work += repulsion.torque(&q, &dq, &(0.5 * SMatrix::identity()), 1e-3)[joint] * dq[joint] * dt;
        }
        // a closed path: what the spring stored it has given back, what the damper took is gone
        prop_assert!(work <= 1e-3, "{work} J gained");
    }

    #[test]
    fn the_admittance_never_overshoots_its_final_velocity(
        v in ordinary(2.0), force in ordinary(500.0), mass in 0.01..1000.0, damping in 1.0..1e5, dt in 1e-4..1.0,
    ) {
        let after: f64 = admittance::step(v, force, mass, damping, dt);
        let end = force / damping;
        prop_assert!(after >= v.min(end) - 1e-12 && after <= v.max(end) + 1e-12);
    }

    #[test]
    fn the_inverse_square_root_is_one(values in prop::collection::vec(ordinary(1.0), 36), spread in 0.0..4.0) {
        let g = SMatrix::<f64, 6, 6>::from_row_slice(&values);
        let scale = SMatrix::<f64, 6, 6>::from_diagonal(&nalgebra::SVector::from_fn(|i, _| 10f64.powf(spread * [0.0, 0.2, 0.4, 0.6, 0.8, 1.0][i])));
        let a = scale * (g * g.transpose() + SMatrix::identity() * 0.01) * scale;
        let x = inverse_square_root(&a).unwrap();
        let eigenvalues = a.symmetric_eigenvalues();
        let condition = eigenvalues.max() / eigenvalues.min();
        let gap = (x * a * x - SMatrix::identity()).norm();
        prop_assert!(gap < 1e-12 * condition.max(1.0), "{gap} at condition {condition:.1e}");
    }
}

fn close(values: &[f64], reference: &[f64], tolerance: f64) -> Result<(), TestCaseError> {
    let scale = reference.iter().fold(1.0_f64, |most, r| most.max(r.abs()));
    for (value, reference) in values.iter().zip(reference) {
        prop_assert!((value - reference).abs() <= tolerance * scale, "{value} against {reference}");
    }
    Ok(())
}

#[test]
fn a_gain_out_of_range_is_named() {
    for bad in [0.0, -1.0, 1e4, f64::NAN, f64::INFINITY] {
        assert_eq!(AxisWeight::<7, f64>::new([1.0, bad, 1.0], [1.0; 7]).unwrap_err().name, "eta");
    }
    let step = ControlError::Step { dt_s: 0.0 };
    assert_eq!(step.to_string(), "time since the last step = 0 s is not above 0 s");
}
