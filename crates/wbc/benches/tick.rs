//! Time of the whole step per law, arm and precision (`tick/*`) and of its parts (`part/*`).
#![allow(clippy::unwrap_used, missing_docs, reason = "benches")]

use criterion::{BenchmarkId, Criterion, criterion_group, criterion_main};
use moca_wbc::contact_barrier::{BarrierInput, BarrierSettings, ContactBarrier, FoamCurve, TaxelSample};
use moca_wbc::limits::TorqueLimits;
use moca_wbc::nalgebra::convert;
use moca_wbc::opspace::{ArmDynamics, AxisWeight, BlockWeight, TaskDynamics, WholeBodyForce};
use moca_wbc::robot::{LinkCapsule, MOCA_MOUNT, PANDA, PANDA_CAPSULES, PAPER_COVER, SUMMIT_XL, UR10E};
use moca_wbc::self_collision::{SelfCollision, Solids};
use moca_wbc::{
    ArmModel, ArmTable, ControlInput, ControlLaw, Corrections, ImpedanceGains, Limits, LimitsHit, Parameters,
    Payload, RobotState, Scalar, WholeBodyController, impedance,
};
use std::hint::black_box;

fn input<const N: usize, T: Scalar>(arm: &ArmTable<N>) -> ControlInput<N, 11, T> {
    let robot = RobotState {
        base_pose_world: [0.3, -0.2, 0.4].map(convert),
        base_velocity_world: [0.1, -0.05, 0.2].map(convert),
        q_rad: arm.home_rad.map(convert),
        dq_rad_s: [0.1; N].map(convert),
        torque_measured_nm: [0.0; N].map(convert),
        flange_wrench_world: None,
    };
    ControlInput::new(robot, [2.0; 11].map(convert), convert(1e-3))
}

fn steps<const N: usize, T: Scalar>(c: &mut Criterion, arm: &ArmTable<N>, name: &str) {
    let mut group = c.benchmark_group("tick");
    let all = Corrections { null_space_damping: true, base_coupling: true, flange_wrench_feedforward: true };
    for (law, corrections, label) in [
        (ControlLaw::Hold, Corrections::LITERAL, "hold"),
        (ControlLaw::Impedance, Corrections::LITERAL, "impedance"),
        (ControlLaw::Impedance, all, "impedance-corrected"),
        (ControlLaw::FollowMe, Corrections::LITERAL, "follow-me"),
    ] {
        let controller = WholeBodyController::<N, 11, T>::new(
            arm,
            &MOCA_MOUNT,
            &Payload::NONE,
            &PAPER_COVER,
            &Parameters { corrections, ..Parameters::for_arm(arm) },
        )
        .unwrap();
        let input = input::<N, T>(arm);
        let mut state = controller.enter(law, &input.robot).unwrap();
        group.bench_function(BenchmarkId::new(label, name), |b| {
            b.iter(|| controller.step(law, &mut state, black_box(&input)).unwrap());
        });
    }
    group.finish();
}

fn parts<const N: usize, T: Scalar>(c: &mut Criterion, arm: &ArmTable<N>, name: &str) {
    let mut group = c.benchmark_group("part");
    let model = ArmModel::<N, T>::new(arm, &MOCA_MOUNT, &Payload::NONE).unwrap();
    let (yaw, q, dq) = (convert(0.4), arm.home_rad.map(convert), [0.1; N].map(convert));
    group.bench_function(BenchmarkId::new("kinematics", name), |b| {
        b.iter(|| model.kinematics(black_box(yaw), black_box(&q)));
    });
    group.bench_function(BenchmarkId::new("dynamics", name), |b| {
        b.iter(|| model.dynamics(black_box(yaw), black_box(&q), black_box(&dq)));
    });
    let dynamics = model.dynamics(yaw, &q, &dq);
    let base_velocity = [0.1, -0.05, 0.2].map(convert);
    group.bench_function(BenchmarkId::new("momentum", name), |b| {
        b.iter(|| {
            let (base_velocity, dynamics) = (black_box(&base_velocity), black_box(&dynamics));
            model.momentum(&dynamics.kinematics, base_velocity, &dq)
        });
    });
    let virtual_mass = [4.0, 4.0, 2.0].map(convert);
    let wrench = [1.0, -2.0, 3.0, 0.1, 0.2, -0.3].map(convert);
    let null = WholeBodyForce { base: [5.0, 1.0, -2.0].map(convert), arm: [1.0; N].map(convert) };
    let block = BlockWeight::<T>::new(convert(3.0), convert(1.0));
    group.bench_function(BenchmarkId::new("law-block-h", name), |b| {
        b.iter(|| {
            let arm = ArmDynamics::new(black_box(&dynamics)).unwrap();
            let task = TaskDynamics::new(virtual_mass, &arm);
            block.factor(&task).unwrap().force(black_box(&wrench), black_box(&null))
        });
    });
    let general = AxisWeight::<N, T>::new([1.0, 1.2, 0.8], [0.9; N]).unwrap();
    group.bench_function(BenchmarkId::new("law-general-h", name), |b| {
        b.iter(|| {
            let arm = ArmDynamics::new(black_box(&dynamics)).unwrap();
            let task = TaskDynamics::new(virtual_mass, &arm);
            general.force(&task, black_box(&wrench), black_box(&null)).unwrap()
        });
    });
    let arm_dynamics = ArmDynamics::new(&dynamics).unwrap();
    let inverse_task_inertia = TaskDynamics::new(virtual_mass, &arm_dynamics).inverse_task_inertia();
    let stiffness = ImpedanceGains::PAPER.stiffness.map(convert);
    group.bench_function(BenchmarkId::new("damping-design", name), |b| {
        b.iter(|| impedance::damping(black_box(&inverse_task_inertia), &stiffness, convert(0.9)).unwrap());
    });
    let limits = TorqueLimits::<N, T>::from(&Limits::for_arm(arm));
    group.bench_function(BenchmarkId::new("limits", name), |b| {
        b.iter(|| {
            let mut hit = LimitsHit::default();
            let torque = limits.limited(black_box(&null.arm), black_box(&dq), convert(1e-3), &mut hit);
            (torque, hit)
        });
    });
    group.finish();
}

/// A whole step with and without the contact barrier, of a robot with both corrections that it is used with.
fn barrier(c: &mut Criterion) {
    let mut group = c.benchmark_group("barrier");
    let corrections = Corrections { null_space_damping: true, base_coupling: true, ..Corrections::LITERAL };
    let parameters = Parameters { corrections, ..Parameters::for_arm(&PANDA) };
    let controller =
        WholeBodyController::<7, 11>::new(&PANDA, &MOCA_MOUNT, &Payload::NONE, &PAPER_COVER, &parameters)
            .unwrap();
    let foam = FoamCurve::Hyperbolic { stiffness_n_m: 2105.0, thickness_m: 0.015 };
    let settings = BarrierSettings::new(foam, foam, 25.0, 0.015).unwrap();
    for (name, on, touched, speed, order_delay_s) in [
        ("off", false, 0, 0.0, 0.0),
        ("nobody touches", true, 0, 0.0, 0.0),
        ("one taxel touched", true, 1, 0.0, 0.0),
        ("one taxel touched, orders 50 ms late", true, 1, 0.0, 0.05),
        ("one taxel touched, orders 100 ms late", true, 1, 0.0, 0.1),
        ("driven into one", true, 1, 0.2, 0.0),
        ("driven into three", true, 3, 0.2, 0.0),
    ] {
        let settings = settings.with_late_orders(order_delay_s, 0.0, 0.0).unwrap();
        let mut barrier = ContactBarrier::<11>::new(&PAPER_COVER, &settings).unwrap();
        let mut input = input::<7, f64>(&PANDA);
        input.robot.base_velocity_world = [speed, 0.0, 0.0];
        input.taxel_force_n =
            core::array::from_fn(|i| if (5..5 + touched).contains(&i) { 10.0 } else { 0.0 });
        let mut state = controller.enter(ControlLaw::Impedance, &input.robot).unwrap();
        state.set_target_twist([speed, 0.0, 0.0, 0.0, 0.0, 0.0]).unwrap();
        let mut age_s = 0.0;
        group.bench_function(name, |b| {
            b.iter(|| {
                // a frame every 10 ms
                age_s = if age_s > 0.0095 { 0.001 } else { age_s + 0.001 };
                let mut input = *black_box(&input);
                if on {
                    let samples = input.taxel_force_n.map(|force_n| Some(TaxelSample { force_n, age_s }));
                    let measured =
                        BarrierInput::new(samples, input.robot.base_velocity_world, [3.0, 3.0, 6.0], 1e-3);
                    let contacts = barrier.update(&measured).unwrap();
                    input.taxel_force_n = contacts.force_n;
                    input.guard.outward_m_s = Some(contacts.outward_m_s);
                }
                let output = controller.step(ControlLaw::Impedance, &mut state, &input).unwrap();
                barrier.ordered(&output.command.base_velocity_body).unwrap();
                output
            });
        });
    }
    group.finish();
}

/// The guard against self-collision: its distances alone, ten pairs and all of them, and in a step of a robot at home and folded.
fn self_collision(c: &mut Criterion) {
    let mut group = c.benchmark_group("self-collision");
    let guard = |capsules: &[LinkCapsule]| {
        let solids = Solids { capsules, tool: None, base_size_m: Some(SUMMIT_XL.size_m) };
        SelfCollision::<7, f64>::new(&PANDA, &MOCA_MOUNT, &solids, 0.02).unwrap()
    };
    // the hand and the forearm before the base, the column and the floor: ten pairs
    let ten: Vec<LinkCapsule> = [0, 5, 7, 8].map(|i| PANDA_CAPSULES[i]).into();
    let model = ArmModel::<7, f64>::new(&PANDA, &MOCA_MOUNT, &Payload::NONE).unwrap();
    let folded = [0.0, -1.2, 0.0, -2.9, 0.0, 1.0, 0.0];
    for (posture, q) in [("home", PANDA.home_rad), ("folded", folded)] {
        let kinematics = model.kinematics(0.4, &q);
        for guard in [guard(&ten), guard(&PANDA_CAPSULES)] {
            let name = format!("{} pairs", guard.pairs());
            group.bench_function(BenchmarkId::new(name, posture), |b| {
                b.iter(|| guard.nearest(black_box(&kinematics)));
            });
        }
        let parameters = Parameters::for_arm(&PANDA);
        let controller =
            WholeBodyController::<7, 11>::new(&PANDA, &MOCA_MOUNT, &Payload::NONE, &PAPER_COVER, &parameters)
                .unwrap();
        for (name, controller) in
            [("step without", controller), ("step", controller.with_self_collision(guard(&PANDA_CAPSULES)))]
        {
            let mut input = input::<7, f64>(&PANDA);
            input.robot.q_rad = q;
            let mut state = controller.enter(ControlLaw::Impedance, &input.robot).unwrap();
            group.bench_function(BenchmarkId::new(name, posture), |b| {
                b.iter(|| controller.step(ControlLaw::Impedance, &mut state, black_box(&input)).unwrap());
            });
        }
    }
    group.finish();
}

fn benches(c: &mut Criterion) {
    barrier(c);
    self_collision(c);
    steps::<7, f64>(c, &PANDA, "panda-f64");
    steps::<7, f32>(c, &PANDA, "panda-f32");
    steps::<6, f64>(c, &UR10E, "ur10e-f64");
    steps::<6, f32>(c, &UR10E, "ur10e-f32");
    parts::<7, f64>(c, &PANDA, "panda-f64");
    parts::<7, f32>(c, &PANDA, "panda-f32");
    parts::<6, f64>(c, &UR10E, "ur10e-f64");
    parts::<6, f32>(c, &UR10E, "ur10e-f32");
}

criterion_group!(all, benches);
criterion_main!(all);
