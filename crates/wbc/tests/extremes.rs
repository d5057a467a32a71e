//! The ends of the range, as the crate's documentation lists them.
#![allow(clippy::unwrap_used, reason = "tests")]

mod common;

use common::{Loop, Push, at_home, flange_error, near};
use moca_wbc::robot::PANDA;
use moca_wbc::testing::accuracy::{self, Reference, admitted};
use moca_wbc::{ControlLaw, Exceeded};
use moca_wbc::{Corrections, ImpedanceGains, Limits, Parameters, RobotState};

const GAINS: ImpedanceGains<7> = ImpedanceGains::PAPER;
const LIMITS: Limits<7> = Limits::for_arm(&PANDA);

fn reference() -> Reference {
    serde_json::from_str(include_str!("../../../tests/fixtures/extremes.json")).unwrap()
}

#[test]
fn lost_digits_stay_below_condition_number() {
    for case in reference().cases {
        let (double, single) =
            (accuracy::accuracy::<f64>(&case).unwrap(), accuracy::accuracy::<f32>(&case).unwrap());
        let allowed = |epsilon: f64, singular: f64| match case.condition {
            Some(condition) => 16.0 * epsilon * condition.min(1.0 / epsilon),
            None => singular,
        };
        let name = &case.name;
        assert!(double.force.max(double.damping) <= allowed(f64::EPSILON, 1e-6), "{name}: {double:?}");
        assert!(
            single.force.max(single.damping) <= allowed(f64::from(f32::EPSILON), 0.1),
            "{name}: {single:?}"
        );
        assert!(double.largest_nm < 50.0 && single.largest_nm < 50.0, "{name}: {double:?} {single:?}");
    }
}

#[test]
fn the_admittance_is_exact_for_every_mass_damping_and_step() {
    for step in reference().admittance {
        let (mass, damping, dt) = (step.mass, step.damping, step.dt);
        assert!(admitted::<f64>(&step) < 1e-15, "{mass} kg {damping} N·s/m {dt} s");
        assert!(admitted::<f32>(&step) < 1e-6, "{mass} kg {damping} N·s/m {dt} s");
    }
}

/// Largest flange error, m, and largest joint rate at the end, rad/s, of 1 s of push and 1 s of rest.
fn survived(parameters: Parameters<7>, robot: RobotState<7>, dt_s: f64, push: &Push) -> (f64, f64) {
    let mut plant = Loop::starting(ControlLaw::Impedance, &parameters, robot, dt_s);
    let (mut worst, rest) = (0.0_f64, Push::default());
    while plant.time_s < 2.0 {
        let output = plant.step(if plant.time_s < 1.0 { push } else { &rest });
        worst = worst.max(flange_error(&output));
        let limits = &parameters.limits;
        for (torque, most) in output.command.arm_torque_nm.iter().zip(limits.torque_nm) {
            assert!(torque.abs() <= most, "{torque} N·m");
        }
        for (velocity, most) in output.command.base_velocity_body.iter().zip(limits.base_velocity) {
            assert!(velocity.abs() <= most, "{velocity}");
        }
    }
    (worst, plant.robot.dq_rad_s.iter().fold(0.0, |most, rate| most.max(rate.abs())))
}

fn with_gains(gains: ImpedanceGains<7>) -> Parameters<7> {
    Parameters { gains, ..Parameters::PAPER }
}

#[test]
fn steps_of_a_tenth_to_ten_milliseconds_push_alike() {
    for dt_s in [1e-4, 1e-3, 1e-2] {
        let parameters = Parameters { limits: Limits { period_s: dt_s, ..LIMITS }, ..Parameters::PAPER };
        let (worst, rate) = survived(parameters, at_home(), dt_s, &Push::taxels(&[6], 20.0));
        assert!(worst < 0.015 && rate < 0.3, "{dt_s} s: {worst} m, {rate} rad/s");
    }
}

#[test]
fn virtual_masses_and_dampings_at_their_ends_stay_bounded() {
    let push = Push::taxels(&[6], 20.0);
    for (mass, damping, most) in [(0.01, 80.0, 0.03), (1000.0, 80.0, 0.001), (4.0, 0.0, 0.015)] {
        let gains = ImpedanceGains { virtual_mass: [mass; 3], virtual_damping: [damping; 3], ..GAINS };
        let (worst, rate) = survived(with_gains(gains), at_home(), 1e-3, &push);
        assert!(worst < most && rate < 0.5, "{mass} kg {damping} N·s/m: {worst} m, {rate} rad/s");
    }
}

#[test]
fn ratios_of_the_weights_at_their_ends_stay_bounded() {
    let push = Push::taxels(&[6], 20.0);
    for eta_base in [1e-3, 1e-2, 1e2, 1e3] {
        let (worst, rate) =
            survived(with_gains(ImpedanceGains { eta_base, ..GAINS }), at_home(), 1e-3, &push);
        assert!(worst < 0.03 && rate < 0.5, "{eta_base}: {worst} m, {rate} rad/s");
    }
}

const STIFFEST: [f64; 6] = [1e5, 1e5, 1e5, 5e3, 5e3, 5e3];

#[test]
fn the_stiffest_flange_rings_below_a_fifth_of_a_millimetre() {
    let gains = ImpedanceGains { stiffness: STIFFEST, ..GAINS };
    let (worst, rate) = survived(with_gains(gains), at_home(), 1e-3, &Push::taxels(&[6], 20.0));
    assert!(worst < 2e-4 && rate < 0.3, "{worst} m, {rate} rad/s");
}

/// One start shows little: the last digits of it decide how far a flange rings.
#[test]
fn the_stiffest_flange_rings_below_a_millimetre_from_50_starts() {
    let gains = ImpedanceGains { stiffness: STIFFEST, ..GAINS };
    let mut within_a_fifth = 0;
    for start in 0..50 {
        let robot = RobotState { q_rad: near(PANDA.home_rad, start), ..at_home() };
        let (worst, rate) = survived(with_gains(gains), robot, 1e-3, &Push::taxels(&[6], 20.0));
        assert!(worst < 1e-3 && rate < 0.3, "start {start}: {worst} m, {rate} rad/s");
        within_a_fifth += u32::from(worst < 2e-4);
    }
    assert!(within_a_fifth >= 40, "{within_a_fifth} of 50 within 0.2 mm");
}

#[test]
fn upright_arm_leaves_singularity_until_it_is_stretched() {
    for scale in [0.0, 1e-8, 1e-4, 1e-2] {
        let q_rad = [0.3, 1.0, -0.4, -0.8, 0.6, 0.9, -0.2].map(|q: f64| q * scale);
        let robot = RobotState { q_rad, ..at_home() };
        let (worst, rate) = survived(Parameters::PAPER, robot, 1e-3, &Push::default());
        assert!(worst < 0.02 && rate < 0.5, "{scale} rad: {worst} m, {rate} rad/s");
        let mut plant = Loop::starting(ControlLaw::Impedance, &Parameters::PAPER, robot, 1e-3);
        let stop = (0..2000).find_map(|_| plant.step(&Push::default()).exceeded);
        assert_eq!(stop, Some(Exceeded::Stretched(3)), "{scale} rad");
    }
}

#[test]
fn ten_kilonewtons_are_clamped_to_largest_force() {
    let (worst, _) = survived(Parameters::PAPER, at_home(), 1e-3, &Push::taxels(&[1], 1e4));
    let (believed, _) =
        survived(Parameters::PAPER, at_home(), 1e-3, &Push::taxels(&[1], LIMITS.taxel_force_n));
    assert!((worst - believed).abs() < 1e-12 && worst < 0.15, "{worst} m against {believed} m");
}

#[test]
fn half_turn_target_is_reached_within_limits() {
    let mut plant = Loop::new(ControlLaw::Impedance, &Parameters::PAPER);
    let home = plant.step(&Push::default()).flange;
    let [x, y, z, w] = home.quaternion_world;
    let turn = std::f64::consts::PI;
    let turned = {
        let (s, c) = (-0.5 * turn).sin_cos();
        // home · Rz(−π): the way on which the last joint has room
        [x * c + y * s, y * c - x * s, z * c + w * s, w * c - z * s]
    };
    plant.state.set_target_pose(home.position_world, turned).unwrap();
    let mut output = plant.step(&Push::default());
    let mut fastest = 0.0_f64;
    for _ in 0..6000 {
        output = plant.step(&Push::default());
        fastest = plant.robot.dq_rad_s.iter().fold(fastest, |most, rate| most.max(rate.abs()));
    }
    assert!(fastest < 2.61, "{fastest} rad/s");
    let overlap: f64 = output.flange.quaternion_world.iter().zip(turned).map(|(a, b)| a * b).sum();
    assert!(overlap.abs() > (0.5_f64 * 0.05).cos(), "{} rad short", 2.0 * overlap.abs().acos());
    assert!(flange_error(&output) < 0.05, "{} m", flange_error(&output));
}

#[test]
fn a_light_virtual_base_without_outer_damping_is_refused() {
    let gains = ImpedanceGains { virtual_mass: [0.1; 3], ..GAINS };
    let corrections = Corrections { null_space_damping: true, ..Corrections::LITERAL };
    let controller = common::controller(&Parameters::PAPER);
    let refused = controller.with_parameters(&Parameters { corrections, ..with_gains(gains) });
    assert_eq!(refused.unwrap_err().name, "virtual_mass with null_space_damping");
}
