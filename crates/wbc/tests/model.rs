//! The model's normal form and its one pass against the same arm in world axes, as its table has it.
#![allow(clippy::unwrap_used, reason = "tests")]

mod world_axes;

use moca_wbc::coupled::CoupledDynamics;
use moca_wbc::opspace::WholeBodyForce;
use moca_wbc::robot::{FR3, LinkInertial, MOCA_MOUNT, PANDA, SUMMIT_XL, UR10E};
use moca_wbc::testing::Numbers;
use moca_wbc::{ArmModel, ArmTable, Mount, Payload};
use world_axes::Arm;

/// Tolerance of every quantity, relative to the largest of its numbers in all states.
const TOLERANCE: f64 = 3e-15;
/// Tolerance of forces for the accelerations that are computed from them.
const SOLVED: f64 = 1e-13;
const STATES: usize = 10_000;

/// Largest difference of each quantity so far, and its largest number or the size of its terms.
#[derive(Default)]
struct Worst(Vec<(&'static str, f64, f64)>);

impl Worst {
    fn compare(&mut self, what: &'static str, values: &[f64], reference: &[f64], made_of: f64) {
        assert_eq!(values.len(), reference.len(), "{what}");
        if !self.0.iter().any(|(name, ..)| *name == what) {
            self.0.push((what, 0.0, made_of));
        }
        for (_, worst, scale) in self.0.iter_mut().filter(|(name, ..)| *name == what) {
            for (value, reference) in values.iter().zip(reference) {
                assert!(value.is_finite() && reference.is_finite(), "{what}: {value} against {reference}");
                *worst = worst.max((value - reference).abs());
                *scale = scale.max(reference.abs());
            }
        }
    }
}

/// The most that is left of forces on base and arm less bias and (M + added)·acceleration.
fn forward<const N: usize>(plant: &CoupledDynamics<N, f64>, base: &[f64; 3], arm: &[f64; N]) -> f64 {
    let force = WholeBodyForce { base: base.map(|f| 30.0 * f), arm: arm.map(|f| 10.0 * f) };
    let added = (&[100.0, 50.0, 20.0], &core::array::from_fn(|i| if i == 1 { 0.3 } else { 0.0 }));
    let (ddq_base, ddq_arm) = plant.acceleration(&force, added).unwrap();
    let coupling = &plant.arm.base_coupling;
    let of_arm: Vec<f64> = (0..N)
        .map(|i| {
            let arm: f64 = (0..N).map(|j| plant.arm.mass[(i, j)] * ddq_arm[j]).sum();
            let base: f64 = (0..3).map(|j| coupling[(i, j)] * ddq_base[j]).sum();
            force.arm[i] - plant.arm.bias[i] - arm - base - added.1[i] * ddq_arm[i]
        })
        .collect();
    let worst_of_arm = of_arm.iter().fold(0.0f64, |most, left| most.max(left.abs()));
    let of_base = |i: usize| {
        let arm: f64 = (0..N).map(|j| coupling[(j, i)] * ddq_arm[j]).sum();
        let base: f64 = (0..3).map(|j| plant.base[(i, j)] * ddq_base[j]).sum();
        force.base[i] - plant.base_bias[i] - arm - base - added.0[i] * ddq_base[i]
    };
    (0..3).map(|i| of_base(i).abs()).fold(worst_of_arm, f64::max)
}

fn check<const N: usize>(name: &str, table: &ArmTable<N>, mount: &Mount, payload: &Payload) {
    let model = ArmModel::<N, f64>::new(table, mount, payload).unwrap();
    // what the torques are made of, at a metre, also of an arm whose axes all stand upright
    let weight_n = 9.81 * table.links.iter().map(|link| link.mass_kg).sum::<f64>();
    let mut numbers = Numbers::from_seed(1);
    let mut worst = Worst::default();
    for _ in 0..STATES {
        let yaw = 4.0 * numbers.next_number();
        let (q, dq): ([f64; N], [f64; N]) = (numbers.array(3.0), numbers.array(2.0));
        let rate: [f64; 3] = numbers.array(1.0);
        let arm = Arm::at(table, mount, payload, yaw, &q);
        let dynamics = model.dynamics(yaw, &q, &dq);
        let kinematics = &dynamics.kinematics;
        worst.compare("tool", kinematics.tool_position.as_slice(), arm.tool_position.as_slice(), 1.0);
        worst.compare("axes", kinematics.tool_rotation.as_slice(), arm.tool_axes.as_slice(), 1.0);
        worst.compare("arm base", kinematics.arm_from_base.as_slice(), arm.arm_from_base.as_slice(), 1.0);
        worst.compare("Jacobian", kinematics.arm_jacobian().as_slice(), arm.jacobian().as_slice(), 1.0);
        let (mass, coupling, gravity) = arm.mass();
        worst.compare("mass", dynamics.mass.as_slice(), mass.as_slice(), 0.0);
        worst.compare("coupling", dynamics.base_coupling.as_slice(), coupling.as_slice(), 0.0);
        worst.compare("gravity", &dynamics.gravity(), &gravity, weight_n);
        worst.compare("bias", &dynamics.bias, &arm.bias(&dq), weight_n);
        let momentum =
            mass * moca_wbc::nalgebra::SVector::from(dq) + coupling * moca_wbc::nalgebra::SVector::from(rate);
        let (observed, drift) = model.momentum(kinematics, &rate, &dq);
        worst.compare("momentum", &observed, momentum.as_slice(), 0.0);
        worst.compare("drift", &drift, &arm.momentum_drift(&rate, &dq), weight_n);
        let plant = CoupledDynamics::new(&model, &SUMMIT_XL, (yaw, &q), (&rate, &dq));
        let (block, base_bias, arm_bias) = arm.coupled(&SUMMIT_XL, &rate, &dq);
        worst.compare("base block", plant.base.as_slice(), block.as_slice(), 0.0);
        worst.compare("base bias", &plant.base_bias, &base_bias, weight_n);
        worst.compare("bias on a moving base", &plant.arm.bias, &arm_bias, weight_n);
        assert_eq!((plant.arm.mass, plant.arm.base_coupling), (dynamics.mass, dynamics.base_coupling));
        let left = forward(&plant, &rate, &dq);
        assert!(left <= SOLVED * weight_n, "{name}: {left:e} of {weight_n}");
        assert_eq!(model.kinematics(yaw, &q), *kinematics);
    }
    for (what, worst, scale) in worst.0 {
        assert!(worst <= TOLERANCE * scale, "{name}, {what}: {:.1e} of {scale:.1}", worst / scale);
    }
}

/// 5 kg with a lever, and a tool that is turned.
const HEAVY: Payload = Payload {
    inertial: LinkInertial {
        mass_kg: 5.0,
        com_m: [0.02, -0.01, 0.15],
        inertia_com: [0.06, 0.002, -0.001, 0.05, 0.003, 0.02],
    },
    tool_origin: [0.01, 0.02, 0.2, 0.3, -0.2, 0.5],
};
const TILTED: Mount = Mount { position_base_m: [0.25, -0.13, 0.4], rpy_rad: [0.5, -0.3, 1.1] };
const ON_A_WALL: Mount = Mount {
    position_base_m: [0.0, 0.3, 0.9],
    rpy_rad: [core::f64::consts::FRAC_PI_2, 0.0, core::f64::consts::PI],
};

#[test]
fn every_table_on_every_mount_is_what_it_is_in_world_axes() {
    for (where_, mount) in [("upright", MOCA_MOUNT), ("tilted", TILTED), ("on a wall", ON_A_WALL)] {
        for (carries, payload) in [("bare", Payload::NONE), ("with 5 kg", HEAVY)] {
            check(&format!("panda {where_} {carries}"), &PANDA, &mount, &payload);
            check(&format!("fr3 {where_} {carries}"), &FR3, &mount, &payload);
            check(&format!("ur10e {where_} {carries}"), &UR10E, &mount, &payload);
        }
    }
}

/// No two axes of it parallel or square, as a URDF from a drawing program has them; its first joint lies.
#[test]
fn so_is_an_arm_whose_axes_are_turned_every_way() {
    let mut numbers = Numbers::from_seed(2);
    let joint_origin = std::array::from_fn(|_| {
        let ([x, y, z], [roll, pitch, yaw]) = (numbers.array(0.3), numbers.array(3.1));
        [x, y, z, roll, pitch, yaw]
    });
    let skewed = ArmTable { joint_origin, flange_origin: [0.1, 0.02, 0.03, -0.4, 2.0, 1.0], ..PANDA };
    check("skewed", &skewed, &TILTED, &HEAVY);
}

/// As a rounded file has it: axes that are almost parallel, where common normals would run away.
#[test]
fn axes_that_are_almost_parallel_lose_no_digit() {
    for tilt in [1e-4, 1e-8, 1e-12, 1e-16] {
        let joint_origin =
            std::array::from_fn(|i| [0.1, 0.05, 0.2, tilt, if i % 2 == 0 { -tilt } else { tilt }, 0.7]);
        check("almost parallel", &ArmTable { joint_origin, ..PANDA }, &MOCA_MOUNT, &Payload::NONE);
    }
}

#[test]
fn base_that_weighs_nothing_along_an_axis_is_refused() {
    let model = ArmModel::<7, f64>::new(&PANDA, &MOCA_MOUNT, &Payload::NONE).unwrap();
    let plant = CoupledDynamics::new(&model, &SUMMIT_XL, (0.3, &PANDA.home_rad), (&[0.0; 3], &[0.0; 7]));
    let force = WholeBodyForce { base: [1.0; 3], arm: [1.0; 7] };
    for axis in 0..3 {
        for share in [-1.0, -1.5, f64::NAN] {
            let mut added = [0.0; 3];
            added[axis] = share * plant.base[(axis, axis)];
            assert_eq!(plant.acceleration(&force, (&added, &[0.0; 7])), None, "axis {axis}, {share}");
        }
    }
}
