//! The loop with every limit becomes unstable where the linearised loop predicts it.
#![allow(clippy::unwrap_used, reason = "tests")]

mod common;

use common::{DT_S, Loop, Push, at_home};
use moca_wbc::loop_stability::{ClosedLoop, Command, NO_GROWTH_PER_S};
use moca_wbc::robot::{FR3, MOCA_MOUNT, PANDA, SUMMIT_XL, UR10E};
use moca_wbc::{ArmTable, ControlLaw, Corrections, Law, Parameters, Payload};

const CORRECTED: Corrections =
    Corrections { null_space_damping: true, base_coupling: true, flange_wrench_feedforward: false };
/// Speed with which every joint is nudged, rad/s.
const NUDGE_RAD_S: f64 = 1e-5;

/// Gains that one number makes larger.
type Gains = fn(f64) -> Parameters<7>;

fn with(change: impl FnOnce(&mut Parameters<7>)) -> Parameters<7> {
    let mut parameters = Parameters { corrections: CORRECTED, ..Parameters::PAPER };
    change(&mut parameters);
    parameters
}

fn growth_per_s(parameters: &Parameters<7>, law: Law, command: Command) -> f64 {
    let servo_s = SUMMIT_XL.servo_time_constant_s;
    let closed = ClosedLoop::new(&PANDA, &MOCA_MOUNT, &Payload::NONE, servo_s, parameters).unwrap();
    closed.growth_per_s(law, command, &PANDA.home_rad).unwrap()
}

/// Largest number below which `gains` are stable.
fn largest(gains: Gains, law: Law, command: Command) -> f64 {
    let stable = |x: f64| growth_per_s(&gains(x), law, command) < NO_GROWTH_PER_S;
    let (mut low, mut high) = (10.0_f64, 30.0_f64);
    assert!(stable(low));
    while stable(high) {
        (low, high) = (high, 1.5 * high);
    }
    for _ in 0..8 {
        let middle = (low * high).sqrt();
        if stable(middle) { low = middle } else { high = middle }
    }
    low
}

/// Fastest joint two seconds after all of them were nudged, rad/s; infinite if the law was ended.
fn left_of_a_nudge(parameters: &Parameters<7>, law: Law, command: Command) -> f64 {
    let mut plant = Loop::starting(ControlLaw::from(law), parameters, at_home(), DT_S);
    plant.late = command == Command::OnePeriodLate;
    for _ in 0..300 {
        plant.step(&Push::default());
    }
    plant.robot.dq_rad_s.iter_mut().for_each(|dq| *dq += NUDGE_RAD_S);
    let mut fastest = 0.0_f64;
    for tick in 0..2000 {
        plant.step(&Push::default());
        if plant.law == ControlLaw::Hold {
            return f64::INFINITY;
        }
        if tick >= 1900 {
            fastest = plant.robot.dq_rad_s.iter().fold(fastest, |most, dq| most.max(dq.abs()));
        }
    }
    fastest
}

/// Just below what is called stable the loop settles, and `margin` times above it a nudge of 1e-5 rad/s grows.
#[expect(clippy::print_stdout, reason = "the figures, with --nocapture")]
fn is_where_it_ends(name: &str, gains: Gains, law: Law, command: Command, margin: f64) {
    let most = largest(gains, law, command);
    let [below, above] = [0.95, margin].map(|share| left_of_a_nudge(&gains(share * most), law, command));
    println!(
        "{law:?}, {name}, {command:?}: {most:.0}; of a nudge {below:.1e} at 0.95 of it, {above:.1e} at {margin}"
    );
    assert!(below < 0.5 * NUDGE_RAD_S, "{name} at 0.95 of {most}: {below} rad/s");
    assert!(above > NUDGE_RAD_S, "{name} at {margin} of {most}: {above} rad/s");
}

fn stiff(k: f64) -> Parameters<7> {
    with(|p| p.gains.stiffness = [k; 6])
}

fn stiff_posture(k: f64) -> Parameters<7> {
    with(|p| p.gains.posture_stiffness = [k; 7])
}

fn damped_posture(d: f64) -> Parameters<7> {
    with(|p| p.gains.posture_damping = [d; 7])
}

#[test]
fn late_command_bound_is_within_a_tenth() {
    for law in [Law::Impedance, Law::FollowMe] {
        is_where_it_ends("stiffness", stiff, law, Command::OnePeriodLate, 1.1);
    }
    is_where_it_ends("posture stiffness", stiff_posture, Law::Impedance, Command::OnePeriodLate, 1.1);
    is_where_it_ends("posture damping", damped_posture, Law::Impedance, Command::OnePeriodLate, 1.1);
}

/// The plant here is stepped twice a period, which bears more than a simulation that is stepped once.
#[test]
fn with_commands_at_once_gains_end_within_half_of_where_it_says() {
    is_where_it_ends("stiffness", stiff, Law::Impedance, Command::AtOnce, 1.5);
    is_where_it_ends("posture damping", damped_posture, Law::Impedance, Command::AtOnce, 1.1);
}

fn of_arm<const N: usize>(arm: &ArmTable<N>, law: Law, command: Command) -> f64 {
    let servo_s = SUMMIT_XL.servo_time_constant_s;
    let parameters = Parameters { corrections: CORRECTED, ..Parameters::for_arm(arm) };
    let closed = ClosedLoop::new(arm, &MOCA_MOUNT, &Payload::NONE, servo_s, &parameters).unwrap();
    closed.growth_per_s(law, command, &arm.home_rad).unwrap()
}

#[test]
fn gains_of_every_arm_are_stable_and_margin_falls() {
    for law in [Law::Impedance, Law::FollowMe] {
        for parameters in [Parameters::PAPER, with(|_| {})] {
            assert!(growth_per_s(&parameters, law, Command::OnePeriodLate) < NO_GROWTH_PER_S);
        }
        assert!(of_arm::<6>(&UR10E, law, Command::OnePeriodLate) < NO_GROWTH_PER_S);
        // its table has no motor behind the light last link
        assert!(of_arm::<7>(&FR3, law, Command::AtOnce) < NO_GROWTH_PER_S);
        assert!(of_arm::<7>(&FR3, law, Command::OnePeriodLate) > NO_GROWTH_PER_S);
    }
    let slow = with(|p| {
        p.gains.stiffness = [400.0; 6];
        p.limits.period_s = 2e-3;
    });
    let fast = with(|p| p.gains.stiffness = [400.0; 6]);
    assert!(growth_per_s(&fast, Law::Impedance, Command::OnePeriodLate) < NO_GROWTH_PER_S);
    assert!(growth_per_s(&slow, Law::Impedance, Command::OnePeriodLate) > NO_GROWTH_PER_S);
}

#[test]
fn a_servo_or_a_posture_that_is_no_number_is_refused() {
    let closed = |servo_s| ClosedLoop::new(&PANDA, &MOCA_MOUNT, &Payload::NONE, servo_s, &Parameters::PAPER);
    for servo_s in [0.0, -1.0, f64::NAN, 11.0] {
        assert!(closed(servo_s).is_err(), "{servo_s}");
    }
    let posture = [f64::NAN; 7];
    let growth = closed(0.015).unwrap().growth_per_s(Law::Impedance, Command::AtOnce, &posture);
    assert!(growth.is_err());
}
