//! Time of the whole step per law, arm and precision (`tick/*`) and of its parts (`part/*`).
#![allow(clippy::unwrap_used, missing_docs, reason = "benches")]

use criterion::{BenchmarkId, Criterion, criterion_group, criterion_main};
use moca_msgs::robot::{MOCA_MOUNT, PANDA, PAPER_COVER, UR10E};
use moca_msgs::{ArmTable, Corrections, ImpedanceGains, Limits, Parameters, Payload, RobotState};
use moca_wbc::limits::OutputLimits;
use moca_wbc::opspace::{AxisWeight, BlockWeight, TaskDynamics, WholeBodyForce};
use moca_wbc::{ArmModel, ControlInput, ControlLaw, Controller, LimitsHit, Scalar, impedance};
use nalgebra::convert;
use std::hint::black_box;

/// The paper's parameters for an arm of any number of joints.
fn parameters<const N: usize>(arm: &ArmTable<N>, corrections: Corrections) -> Parameters<N> {
    let (gains, limits) = (ImpedanceGains::PAPER, Limits::PANDA_ON_SUMMIT);
    Parameters {
        gains: ImpedanceGains {
            virtual_mass: gains.virtual_mass,
            virtual_damping: gains.virtual_damping,
            stiffness: gains.stiffness,
            damping_ratio: gains.damping_ratio,
            eta_base: gains.eta_base,
            eta_arm: gains.eta_arm,
            posture_stiffness: [50.0; N],
            posture_damping: [5.0; N],
            posture_rad: arm.home_rad,
            reactivity: gains.reactivity,
        },
        corrections,
        limits: Limits {
            torque_nm: arm.torque_max_nm,
            torque_rate_nm_s: limits.torque_rate_nm_s,
            base_velocity: limits.base_velocity,
            base_acceleration: limits.base_acceleration,
            taxel_force_n: limits.taxel_force_n,
            period_s: limits.period_s,
        },
    }
}

fn input<const N: usize, T: Scalar>(arm: &ArmTable<N>) -> ControlInput<N, 11, T> {
    ControlInput {
        robot: RobotState {
            base_pose_world: [0.3, -0.2, 0.4].map(convert),
            base_velocity_world: [0.1, -0.05, 0.2].map(convert),
            q_rad: arm.home_rad.map(convert),
            dq_rad_s: [0.1; N].map(convert),
            torque_measured_nm: [0.0; N].map(convert),
            flange_wrench_world: None,
        },
        taxel_force_n: [2.0; 11].map(convert),
        flange_wrench_world: None,
        dt_s: convert(1e-3),
    }
}

fn steps<const N: usize, T: Scalar>(c: &mut Criterion, arm: &ArmTable<N>, name: &str) {
    let mut group = c.benchmark_group("tick");
    let all = Corrections { null_space_damping: true, base_coupling: true, flange_feed: true };
    for (law, corrections, label) in [
        (ControlLaw::Hold, Corrections::LITERAL, "hold"),
        (ControlLaw::Impedance, Corrections::LITERAL, "impedance"),
        (ControlLaw::Impedance, all, "impedance-corrected"),
        (ControlLaw::FollowMe, Corrections::LITERAL, "follow-me"),
    ] {
        let controller = Controller::<N, 11, T>::new(
            arm,
            &MOCA_MOUNT,
            &Payload::NONE,
            &PAPER_COVER,
            &parameters(arm, corrections),
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
    let kinematics = model.kinematics(yaw, &q);
    group.bench_function(BenchmarkId::new("link-inertias", name), |b| {
        b.iter(|| model.link_inertias(black_box(&kinematics)));
    });
    let inertias = model.link_inertias(&kinematics);
    group.bench_function(BenchmarkId::new("mass-matrix", name), |b| {
        b.iter(|| black_box(&kinematics).mass_matrix(black_box(&inertias)));
    });
    group.bench_function(BenchmarkId::new("bias", name), |b| {
        b.iter(|| black_box(&kinematics).bias(black_box(&inertias), black_box(&dq)));
    });
    let mass = kinematics.mass_matrix(&inertias).arm;
    let jacobians = (kinematics.base_jacobian(), kinematics.arm_jacobian());
    let virtual_mass = [4.0, 4.0, 2.0].map(convert);
    let wrench = [1.0, -2.0, 3.0, 0.1, 0.2, -0.3].map(convert);
    let null = WholeBodyForce { base: [5.0, 1.0, -2.0].map(convert), arm: [1.0; N].map(convert) };
    let block = BlockWeight::<T>::new(convert(3.0), convert(1.0));
    group.bench_function(BenchmarkId::new("law-block-h", name), |b| {
        b.iter(|| {
            let (base, arm) = *black_box(&jacobians);
            let task = TaskDynamics::new(base, arm, virtual_mass, black_box(&mass)).unwrap();
            block.factor(&task).unwrap().force(black_box(&wrench), black_box(&null))
        });
    });
    let general = AxisWeight::<N, T>::new([1.0, 1.2, 0.8], [0.9; N]).unwrap();
    group.bench_function(BenchmarkId::new("law-general-h", name), |b| {
        b.iter(|| {
            let (base, arm) = *black_box(&jacobians);
            let task = TaskDynamics::new(base, arm, virtual_mass, black_box(&mass)).unwrap();
            general.force(&task, black_box(&wrench), black_box(&null)).unwrap()
        });
    });
    let mobility = TaskDynamics::new(jacobians.0, jacobians.1, virtual_mass, &mass).unwrap().mobility();
    let stiffness = ImpedanceGains::PAPER.stiffness.map(convert);
    group.bench_function(BenchmarkId::new("damping-design", name), |b| {
        b.iter(|| impedance::damping(black_box(&mobility), &stiffness, convert(0.9)).unwrap());
    });
    let limits = OutputLimits::<N, T>::from(&parameters(arm, Corrections::LITERAL).limits);
    group.bench_function(BenchmarkId::new("limits", name), |b| {
        b.iter(|| {
            let mut hit = LimitsHit::default();
            let torque = limits.torque(black_box(&null.arm), black_box(&dq), convert(1e-3), &mut hit);
            (torque, hit)
        });
    });
    group.finish();
}

fn benches(c: &mut Criterion) {
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
