//! The controller's side: how often it runs, how eq. (2) is discretised, single precision.

use super::controller;
use crate::paper::push;
use crate::rig::closed_loop::Rig;
use crate::rig::cpu_time;
use crate::rig::settings::Settings;
use crate::rig::{JOINTS, TAXELS, free_scene};
use anyhow::Result;
use moca_msgs::{Actuation, Law, RobotState};
use moca_sim::SimPlant;
use moca_wbc::testing::reference_file::{explicit_euler, implicit_euler};
use moca_wbc::{ControlInput, ControlLaw};
use serde::Serialize;
use std::hint::black_box;

const RATES_HZ: [u32; 6] = [100, 200, 500, 1000, 2000, 4000];
/// Physics step for every control rate, ms.
const PHYSICS_STEP_MS: f64 = 0.25;
/// What is asked of the control rate: base within this of the finest one's, mm.
const RATE_WANTED_MM: f64 = 0.1;

#[derive(Clone, Debug, Serialize)]
pub(crate) struct RatePoint {
    pub rate_hz: u32,
    pub flange_max_mm: f64,
    /// Displacement of the base against that of the finest rate, mm.
    pub base_error_mm: f64,
    /// CPU time of the whole tick for a second of simulation, s.
    pub cpu_s_per_s: f64,
}

/// T6 pressed with 20 N at every rate, the plant's step the same.
pub(crate) fn rates() -> Result<Vec<RatePoint>> {
    let mut runs = Vec::new();
    for rate_hz in RATES_HZ {
        let mut settings = Settings::paper(Law::Impedance);
        for assignment in [
            "sensor=ideal".to_owned(),
            format!("rate_hz={rate_hz}"),
            format!("step_ms={PHYSICS_STEP_MS}"),
            "rest_s=0".into(),
        ] {
            settings.set(&assignment)?;
        }
        let mut rig = Rig::start(&settings, &settings.free_scene())?;
        let (outcomes, cpu_s) =
            cpu_time::timed(|| push::run(&mut rig, &settings, &[push::single(&[5], 20.0)]));
        if let Some(outcome) = outcomes?.pop() {
            runs.push((rate_hz, outcome, cpu_s / settings.push_s));
        }
    }
    let finest = runs.last().map_or([0.0; 3], |(_, outcome, _)| outcome.base_displacement);
    let point = |(rate_hz, outcome, cpu_s_per_s): (u32, push::Outcome, f64)| RatePoint {
        rate_hz,
        flange_max_mm: outcome.flange_max_mm,
        base_error_mm: 1e3 * (outcome.base_displacement[0] - finest[0]).abs(),
        cpu_s_per_s,
    };
    Ok(runs.into_iter().map(point).collect())
}

/// The lowest rate that is accurate enough.
pub(crate) fn rate_recommendation(points: &[RatePoint]) -> String {
    let default_hz = Settings::paper(Law::Impedance).config.control_loop.rate_hz;
    let good = points.iter().find(|p| p.base_error_mm <= RATE_WANTED_MM);
    good.map_or_else(
        || format!("no rate brings the base within {RATE_WANTED_MM} mm of the finest one's way"),
        |best| {
            format!(
                "recommended, the lowest that brings the base within {RATE_WANTED_MM} mm of the finest one's way: {} Hz; the default is {default_hz} Hz",
                best.rate_hz
            )
        },
    )
}

/// A way to take eq. (2) over a step: velocity, forces at the step's start and end, mass, damping, step.
type Discretisation = (&'static str, fn(f64, [f64; 2], f64, f64, f64) -> f64);

pub(crate) const DISCRETISATIONS: [Discretisation; 5] = [
    ("exact hold (ours)", |v, [f, _], m, d, dt| moca_wbc::admittance::step(v, f, m, d, dt)),
    ("explicit Euler", |v, [f, _], m, d, dt| explicit_euler(v, f, m, d, dt)),
    ("implicit Euler", |v, [_, f], m, d, dt| implicit_euler(v, f, m, d, dt)),
    ("Tustin", |v, [f, g], m, d, dt| {
        let half = 0.5 * dt * d / m;
        ((1.0 - half) * v + 0.5 * dt / m * (f + g)) / (1.0 + half)
    }),
    ("first-order hold", |v, [f, g], m, d, dt| {
        // Exact for a force that is linear over the step.
        let x = dt * d / m;
        let decay = (-x).exp();
        let end = 1.0 / x - decay / x;
        v * decay + (f * (end - decay) + g * (1.0 - end)) / d
    }),
];
/// Each divides the hold.
const ADMITTANCE_STEPS_MS: [f64; 8] = [0.1, 0.3, 1.0, 3.0, 10.0, 20.0, 30.0, 60.0];
/// Virtual mass and damping: a light base, where steps are not small against M/D = 10 ms. kg, N·s/m.
const LIGHT: (f64, f64) = (0.8, 80.0);
const ADMITTANCE_S: f64 = 3.0;

#[derive(Clone, Debug, Serialize)]
pub(crate) struct AdmittancePoint {
    pub method: &'static str,
    pub step_ms: f64,
    /// CPU time for a second of simulation, s.
    pub cpu_s_per_s: f64,
    /// Largest error of the velocity, m/s: against a smooth force, and against a reading held for 120 ms.
    pub smooth_error_m_s: f64,
    pub held_error_m_s: f64,
    pub failed: bool,
}

/// Every discretisation at every step.
pub(crate) fn admittance() -> Vec<AdmittancePoint> {
    let all = DISCRETISATIONS.iter().flat_map(|method| ADMITTANCE_STEPS_MS.map(|step_ms| (method, step_ms)));
    all.map(|((method, step), step_ms)| {
        let (smooth_error_m_s, cpu_s) = admittance_error(*step, 1e-3 * step_ms, &Smooth);
        let (held_error_m_s, _) = admittance_error(*step, 1e-3 * step_ms, &Held);
        let failed = [smooth_error_m_s, held_error_m_s].iter().any(|e| e.is_nan() || *e > 1.0);
        AdmittancePoint {
            method,
            step_ms,
            cpu_s_per_s: cpu_s / ADMITTANCE_S,
            smooth_error_m_s,
            held_error_m_s,
            failed,
        }
    })
    .collect()
}

/// The cheapest discretisation that takes a held reading, which is what a sensor gives, without error.
pub(crate) fn admittance_recommendation(points: &[AdmittancePoint]) -> String {
    let total = |method: &str, pick: fn(&AdmittancePoint) -> f64| -> f64 {
        points.iter().filter(|p| p.method == method).map(pick).sum()
    };
    let exact = DISCRETISATIONS.iter().filter(|(method, _)| total(method, |p| p.held_error_m_s) < 1e-9);
    let cheapest =
        exact.min_by(|(a, _), (b, _)| total(a, |p| p.cpu_s_per_s).total_cmp(&total(b, |p| p.cpu_s_per_s)));
    cheapest.map_or_else(
        || "no discretisation takes a held reading without error".to_owned(),
        |(method, _)| format!("recommended, the cheapest that takes a held reading without error: {method}"),
    )
}

trait Push {
    /// Force from `t_s` on, and at the end of a step that ends at `t_s`, N.
    fn from(&self, t_s: f64) -> f64;
    fn until(&self, t_s: f64) -> f64;
    /// Exact velocity, m/s.
    fn velocity(&self, t_s: f64) -> f64;
}

/// 20 N sin(ω t), 1 Hz.
struct Smooth;
/// A reading that is held: 20 N in every other stretch of 120 ms.
struct Held;

const OMEGA: f64 = std::f64::consts::TAU;
const HOLD_S: f64 = 0.12;

impl Push for Smooth {
    fn from(&self, t_s: f64) -> f64 {
        20.0 * (OMEGA * t_s).sin()
    }
    fn until(&self, t_s: f64) -> f64 {
        self.from(t_s)
    }
    fn velocity(&self, t_s: f64) -> f64 {
        let (m, d) = LIGHT;
        let (sin, cos) = (OMEGA * t_s).sin_cos();
        let scale = 20.0 / (d * d + (m * OMEGA).powi(2));
        scale * (d * sin - m * OMEGA * cos + m * OMEGA * (-d * t_s / m).exp())
    }
}

impl Push for Held {
    fn from(&self, t_s: f64) -> f64 {
        if (t_s / HOLD_S + 1e-9).floor().rem_euclid(2.0) < 0.5 { 20.0 } else { 0.0 }
    }
    fn until(&self, t_s: f64) -> f64 {
        self.from(t_s - 1e-6)
    }
    fn velocity(&self, t_s: f64) -> f64 {
        let (m, d) = LIGHT;
        let (mut v, mut start_s) = (0.0, 0.0);
        while start_s < t_s - 1e-12 {
            let length_s = HOLD_S.min(t_s - start_s);
            let target = self.from(start_s) / d;
            v = target + (v - target) * (-d * length_s / m).exp();
            start_s += HOLD_S;
        }
        v
    }
}

/// Largest error of the velocity, m/s, and the CPU time of the steps, s.
fn admittance_error(
    step: fn(f64, [f64; 2], f64, f64, f64) -> f64,
    dt_s: f64,
    push: &impl Push,
) -> (f64, f64) {
    let (m, d) = LIGHT;
    #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "30 to 30 000 steps")]
    let count = (ADMITTANCE_S / dt_s).round() as u32;
    let time = |i: u32| f64::from(i) * dt_s;
    let forces: Vec<[f64; 2]> = (0..count).map(|i| [push.from(time(i)), push.until(time(i + 1))]).collect();
    let mut velocities = vec![0.0; forces.len()];
    let mut least_s = f64::INFINITY;
    for _ in 0..5 {
        let ((), cpu_s) = cpu_time::timed(|| {
            let mut v = 0.0;
            for (force, velocity) in forces.iter().zip(&mut velocities) {
                v = step(black_box(v), *force, m, d, dt_s);
                *velocity = v;
            }
        });
        least_s = least_s.min(cpu_s);
    }
    let worst = (1..).zip(&velocities).map(|(i, v)| (v - push.velocity(time(i))).abs());
    (worst.fold(0.0, |worst, off| if off > worst || off.is_nan() { off } else { worst }), least_s)
}

/// Both precisions over a second of motion after a push: largest difference of torque, N·m, and CPU time per tick, ns.
pub(crate) fn single_precision() -> Result<(f64, f64, f64)> {
    let states = states()?;
    let (double, single) = (controller::<f64>()?, controller::<f32>()?);
    let Some(first) = states.first() else { return Ok((f64::NAN, f64::NAN, f64::NAN)) };
    let inputs: Vec<_> = states.iter().map(|robot| ControlInput::new(*robot, [0.0; TAXELS], 1e-3)).collect();
    let inputs32: Vec<_> =
        states.iter().map(|robot| ControlInput::new(narrow(robot), [0.0; TAXELS], 1e-3)).collect();
    let (mut worst, mut least) = (0.0f64, [f64::INFINITY; 2]);
    for _ in 0..5 {
        let mut state = double.enter(ControlLaw::Impedance, first)?;
        let mut state32 = single.enter(ControlLaw::Impedance, &narrow(first))?;
        let (torques, cpu_s) = cpu_time::timed(|| {
            let step =
                |input| Ok(double.step(ControlLaw::Impedance, &mut state, input)?.command.arm_torque_nm);
            inputs.iter().map(step).collect::<Result<Vec<_>>>()
        });
        let (torques32, cpu32_s) = cpu_time::timed(|| {
            let step =
                |input| Ok(single.step(ControlLaw::Impedance, &mut state32, input)?.command.arm_torque_nm);
            inputs32.iter().map(step).collect::<Result<Vec<_>>>()
        });
        least = [least[0].min(cpu_s), least[1].min(cpu32_s)];
        for (a, b) in torques?.iter().flatten().zip(torques32?.iter().flatten()) {
            worst = worst.max((a - f64::from(*b)).abs());
        }
    }
    #[expect(clippy::cast_precision_loss, reason = "a thousand")]
    let per_tick = 1e9 / states.len() as f64;
    Ok((worst, per_tick * least[0], per_tick * least[1]))
}

/// States of the robot for a second, T3 pressed with 20 N for the first 0.4 s.
fn states() -> Result<Vec<RobotState<JOINTS>>> {
    let mut plant = SimPlant::new(&free_scene())?;
    let controller = controller::<f64>()?;
    let mut state = controller.enter(ControlLaw::Impedance, &plant.state().resized())?;
    let mut states = Vec::new();
    for tick in 0..1000 {
        let robot = plant.state().resized();
        let mut taxel_force_n = [0.0; TAXELS];
        taxel_force_n[2] = if tick < 400 { 20.0 } else { 0.0 };
        let input = ControlInput::new(robot, taxel_force_n, 1e-3);
        plant
            .apply(&Actuation::Drive(controller.step(ControlLaw::Impedance, &mut state, &input)?.command))?;
        plant.step()?;
        states.push(robot);
    }
    Ok(states)
}

fn narrow(robot: &RobotState<JOINTS>) -> RobotState<JOINTS, f32> {
    #[expect(clippy::cast_possible_truncation, reason = "single precision is what is being measured")]
    let f = |v: f64| v as f32;
    RobotState {
        base_pose_world: robot.base_pose_world.map(f),
        base_velocity_world: robot.base_velocity_world.map(f),
        q_rad: robot.q_rad.map(f),
        dq_rad_s: robot.dq_rad_s.map(f),
        torque_measured_nm: robot.torque_measured_nm.map(f),
        flange_wrench_world: robot.flange_wrench_world.map(|w| w.map(f)),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_exact_hold_is_exact_for_a_held_reading_and_explicit_euler_fails_where_theory_says() {
        let points = admittance();
        let at = |method: &str, step_ms: f64| {
            let wanted = |p: &&AdmittancePoint| p.method == method && (p.step_ms - step_ms).abs() < 1e-9;
            points.iter().find(wanted).cloned().unwrap()
        };
        for step_ms in [0.1, 0.3, 1.0, 10.0, 30.0, 60.0] {
            assert!(at("exact hold (ours)", step_ms).held_error_m_s < 1e-10, "{step_ms} ms");
        }
        // dt D/M > 2 from 20 ms on.
        assert!(at("explicit Euler", 30.0).failed && !at("explicit Euler", 10.0).failed);
        for (method, order) in
            [("exact hold (ours)", 1), ("implicit Euler", 1), ("Tustin", 2), ("first-order hold", 2)]
        {
            let ratio = at(method, 1.0).smooth_error_m_s / at(method, 0.1).smooth_error_m_s;
            let expected = 10f64.powi(order);
            assert!((0.5 * expected..2.0 * expected).contains(&ratio), "{method}: {ratio}");
        }
    }

    #[test]
    fn single_precision_costs_less_than_10_millinewtonmetres() {
        let (error_nm, ..) = single_precision().unwrap();
        assert!(error_nm > 0.0 && error_nm < 1e-2, "{error_nm}");
    }
}
