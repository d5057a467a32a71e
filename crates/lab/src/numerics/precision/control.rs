//! The controller's side: how often it runs, how eq. (2) is discretised, single precision.

use super::controller;
use crate::paper::push;
use anyhow::Result;
use moca_experiments::closed_loop::Rig;
use moca_experiments::cpu_time;
use moca_experiments::settings::Settings;
use moca_experiments::timed::Timed as _;
use moca_experiments::{JOINTS, TAXELS, free_scene, state_in};
use moca_msgs::{Actuation, Law, RobotState};
use moca_sim::SimPlant;
use moca_wbc::rotation::Heading;
use moca_wbc::testing::reference_file::{explicit_euler, implicit_euler};
use moca_wbc::{ControlInput, ControlLaw};
use serde::Serialize;
use std::fmt;
use std::hint::black_box;

const RATES_HZ: [u32; 6] = [100, 200, 500, 1000, 2000, 4000];
/// Physics step for every control rate, ms.
const PHYSICS_STEP_MS: f64 = 0.25;
/// Equal runs: they differ in nothing but the time they take.
const RUNS: usize = 3;
/// Required accuracy of the control rate: base within this of the finest rate's, mm.
const RATE_WANTED_MM: f64 = 0.1;

#[derive(Clone, Debug, Serialize)]
pub(crate) struct RatePoint {
    pub rate_hz: u32,
    pub flange_max_mm: f64,
    /// Displacement of the base against that of the finest rate, mm.
    pub base_error_mm: f64,
    /// CPU time of the whole tick for a second of simulation, s: the least and the most of [`RUNS`] equal runs.
    pub cpu_s_per_s: f64,
    pub cpu_most_s_per_s: f64,
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
        let mut times = [f64::INFINITY, 0.0];
        for run in 0..RUNS {
            let mut rig = Rig::start(&settings, &settings.free_scene())?;
            let (outcomes, cpu_s) =
                cpu_time::timed(|| push::run(&mut rig, &settings, &[push::single(&[5], 20.0)]));
            let cpu_s = cpu_s / settings.push_s;
            times = [times[0].min(cpu_s), times[1].max(cpu_s)];
            if let (Some(outcome), true) = (outcomes?.pop(), run + 1 == RUNS) {
                runs.push((rate_hz, outcome, times));
            }
        }
    }
    let finest = runs.last().map_or([0.0; 3], |(_, outcome, _)| outcome.base_displacement);
    let point =
        |(rate_hz, outcome, [cpu_s_per_s, cpu_most_s_per_s]): (u32, push::Outcome, [f64; 2])| RatePoint {
            rate_hz,
            flange_max_mm: outcome.flange_max_mm,
            base_error_mm: 1e3 * (outcome.base_displacement[0] - finest[0]).abs(),
            cpu_s_per_s,
            cpu_most_s_per_s,
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

/// Inputs of eq. (2) at a tick: velocity, force sampled now and a tick ago, mass, damping, period.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Tick {
    velocity: f64,
    now: f64,
    before: f64,
    mass: f64,
    damping: f64,
    dt_s: f64,
}

/// A way to take eq. (2) over a tick, with nothing that a controller cannot know.
type Discretisation = (&'static str, fn(Tick) -> f64);

pub(crate) const DISCRETISATIONS: [Discretisation; 6] = [
    ("exact hold (ours)", |k| moca_wbc::admittance::step(k.velocity, k.now, k.mass, k.damping, k.dt_s)),
    ("explicit Euler", |k| explicit_euler(k.velocity, k.now, k.mass, k.damping, k.dt_s)),
    ("implicit Euler", |k| implicit_euler(k.velocity, k.now, k.mass, k.damping, k.dt_s)),
    // Of the stretch that has just passed: the force at its end is the present sample.
    ("Tustin, to the present", |k| {
        let half = 0.5 * k.dt_s * k.damping / k.mass;
        ((1.0 - half) * k.velocity + 0.5 * k.dt_s / k.mass * (k.before + k.now)) / (1.0 + half)
    }),
    ("first-order hold, to the present", |k| linear(&k, k.before, k.now)),
    ("first-order hold, extrapolated", |k| linear(&k, k.now, 2.0 * k.now - k.before)),
];

/// Exact for a force that goes from `from` to `to` over the tick on a line.
fn linear(k: &Tick, from: f64, to: f64) -> f64 {
    let x = k.dt_s * k.damping / k.mass;
    let decay = (-x).exp();
    let end = (1.0 - decay) / x;
    k.velocity * decay + (from * (end - decay) + to * (1.0 - end)) / k.damping
}

/// Each divides the hold.
const ADMITTANCE_STEPS_MS: [f64; 8] = [0.1, 0.3, 1.0, 3.0, 10.0, 20.0, 30.0, 60.0];
/// The control period of the product, ms.
const TICK_MS: f64 = 1.0;
/// Virtual mass and damping along x and y and about the vertical: a light base, where steps are not small against
/// M/D = 10 ms. kg, kg·m²; N·s/m, N·m·s.
const LIGHT: ([f64; 3], [f64; 3]) = ([0.8, 0.8, 0.6], [80.0, 80.0, 60.0]);
/// Largest force along each axis: N, N, N·m.
const PUSH: [f64; 3] = [20.0, 12.0, 9.0];
/// Flange from the origin of B, m: the Panda's in its home posture, as the arm keeps it.
const FLANGE_BASE_M: [f64; 3] = [0.61, 0.0, 0.0];
const ADMITTANCE_S: f64 = 3.0;
/// Poses are compared this often, s.
const COMPARED_EVERY_S: f64 = 60e-3;

/// Largest errors along a trajectory.
#[derive(Clone, Copy, Debug, Default, Serialize)]
pub(crate) struct Off {
    pub base_m: f64,
    pub yaw_rad: f64,
    pub flange_m: f64,
}

impl fmt::Display for Off {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{:.1e} m, {:.1e} rad, {:.1e} m", self.base_m, self.yaw_rad, self.flange_m)
    }
}

impl Off {
    /// Takes in what the pose (x, y, yaw) is off `exact`.
    fn take(&mut self, pose: &[f64; 3], exact: &[f64; 3]) {
        let apart = |a: [f64; 2], b: [f64; 2]| (a[0] - b[0]).hypot(a[1] - b[1]);
        // a NaN stays
        let larger = |most: f64, off: f64| if off > most || off.is_nan() { off } else { most };
        self.base_m = larger(self.base_m, apart([pose[0], pose[1]], [exact[0], exact[1]]));
        self.yaw_rad = larger(self.yaw_rad, (pose[2] - exact[2]).abs());
        self.flange_m = larger(self.flange_m, apart(flange(pose), flange(exact)));
    }

    fn failed(&self) -> bool {
        [self.base_m, self.yaw_rad, self.flange_m].iter().any(|off| off.is_nan() || *off > 1.0)
    }
}

fn flange([x, y, yaw]: &[f64; 3]) -> [f64; 2] {
    let [fx, fy, _] = Heading::at(*yaw).to_world(FLANGE_BASE_M);
    [x + fx, y + fy]
}

#[derive(Clone, Debug, Serialize)]
pub(crate) struct AdmittancePoint {
    pub method: &'static str,
    pub step_ms: f64,
    /// CPU time of one axis for a second of simulation, s: of the three the quickest and the slowest.
    pub cpu_s_per_s: f64,
    pub cpu_most_s_per_s: f64,
    /// Error of a base that follows each ordered velocity, against the exact one: under a smooth force, and under a reading
    /// that is held for 120 ms.
    pub smooth: Off,
    pub held: Off,
    pub failed: bool,
}

/// Every discretisation at every step.
pub(crate) fn admittance() -> Vec<AdmittancePoint> {
    let (smooth, held) = (exact_poses(&Smooth), exact_poses(&Held));
    let all = DISCRETISATIONS.iter().flat_map(|method| ADMITTANCE_STEPS_MS.map(|step_ms| (method, step_ms)));
    all.map(|((method, step), step_ms)| {
        let (smooth, cpu_s) = admittance_error(*step, 1e-3 * step_ms, &Smooth, &smooth);
        let (held, _) = admittance_error(*step, 1e-3 * step_ms, &Held, &held);
        let failed = smooth.failed() || held.failed();
        let [cpu_s_per_s, cpu_most_s_per_s] = cpu_s.map(|cpu_s| cpu_s / ADMITTANCE_S);
        AdmittancePoint { method, step_ms, cpu_s_per_s, cpu_most_s_per_s, smooth, held, failed }
    })
    .collect()
}

/// Names the best discretisation that fails at no step: the smallest flange error at the product's period, for the worse
/// of both forces.
pub(crate) fn admittance_recommendation(points: &[AdmittancePoint]) -> String {
    let sound =
        DISCRETISATIONS.iter().filter(|(name, _)| points.iter().all(|p| p.method != *name || !p.failed));
    let at_tick = sound.filter_map(|(name, _)| {
        points.iter().find(|p| p.method == *name && (p.step_ms - TICK_MS).abs() < 1e-9)
    });
    let worse = |p: &AdmittancePoint| p.smooth.flange_m.max(p.held.flange_m);
    at_tick.min_by(|a, b| worse(a).total_cmp(&worse(b))).map_or_else(
        || "no discretisation is sound at every step".to_owned(),
        |best| {
            format!(
                "recommended, of those that fail at no step the one whose flange goes least astray at {TICK_MS} ms ({:.1e} m): {}",
                worse(best),
                best.method
            )
        },
    )
}

trait Push {
    /// Share of [`PUSH`] that acts from `t_s` on, and what a sample at that instant says.
    fn share(&self, t_s: f64) -> f64;
    /// Exact velocity over [`PUSH`]'s, m/s for 1 N, of mass and damping.
    fn velocity(&self, t_s: f64, mass: f64, damping: f64) -> f64;
}

/// sin(ω t), 1 Hz.
struct Smooth;
/// A reading that is held: all or nothing in turn, 120 ms each.
struct Held;

const OMEGA: f64 = std::f64::consts::TAU;
const HOLD_S: f64 = 0.12;

impl Push for Smooth {
    fn share(&self, t_s: f64) -> f64 {
        (OMEGA * t_s).sin()
    }
    fn velocity(&self, t_s: f64, m: f64, d: f64) -> f64 {
        let (sin, cos) = (OMEGA * t_s).sin_cos();
        let scale = 1.0 / (d * d + (m * OMEGA).powi(2));
        scale * (d * sin - m * OMEGA * cos + m * OMEGA * (-d * t_s / m).exp())
    }
}

impl Push for Held {
    fn share(&self, t_s: f64) -> f64 {
        if (t_s / HOLD_S + 1e-9).floor().rem_euclid(2.0) < 0.5 { 1.0 } else { 0.0 }
    }
    fn velocity(&self, t_s: f64, m: f64, d: f64) -> f64 {
        let (mut v, mut start_s) = (0.0, 0.0);
        while start_s < t_s - 1e-12 {
            let length_s = HOLD_S.min(t_s - start_s);
            let target = self.share(start_s) / d;
            v = target + (v - target) * (-d * length_s / m).exp();
            start_s += HOLD_S;
        }
        v
    }
}

/// Pose after `dt_s` at a velocity in its own axes.
fn moved([x, y, yaw]: [f64; 3], velocity_body: [f64; 3], dt_s: f64) -> [f64; 3] {
    // the chord of the arc, half way turned
    let half = 0.5 * velocity_body[2] * dt_s;
    let way = dt_s * if half.abs() > 1e-9 { half.sin() / half } else { 1.0 };
    let [vx, vy, rate] = Heading::at(yaw + half).to_world(velocity_body);
    [x + way * vx, y + way * vy, yaw + rate * dt_s]
}

/// Poses of a base that does what eq. (2) says, every [`COMPARED_EVERY_S`]; Simpson's mean velocity over 20 µs is good to
/// rounding.
fn exact_poses(push: &impl Push) -> Vec<[f64; 3]> {
    const FINE: u32 = 3000;
    let (mass, damping) = LIGHT;
    let velocity =
        |t_s: f64| -> [f64; 3] { std::array::from_fn(|i| PUSH[i] * push.velocity(t_s, mass[i], damping[i])) };
    let fine_s = COMPARED_EVERY_S / f64::from(FINE);
    let (mut pose, mut poses, mut at_start) = ([0.0; 3], Vec::new(), velocity(0.0));
    for i in 0..rounded(ADMITTANCE_S / fine_s) {
        let t_s = f64::from(i) * fine_s;
        let (middle, end) = (velocity(t_s + 0.5 * fine_s), velocity(t_s + fine_s));
        let mean = std::array::from_fn(|k| (at_start[k] + 4.0 * middle[k] + end[k]) / 6.0);
        (pose, at_start) = (moved(pose, mean, fine_s), end);
        if (i + 1) % FINE == 0 {
            poses.push(pose);
        }
    }
    poses
}

fn rounded(count: f64) -> u32 {
    #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "up to 150 000 steps")]
    let count = count.round() as u32;
    count
}

/// Largest errors of the trajectory, and the CPU time of one axis, the quickest and the slowest, s.
fn admittance_error(
    step: fn(Tick) -> f64,
    dt_s: f64,
    push: &impl Push,
    exact: &[[f64; 3]],
) -> (Off, [f64; 2]) {
    let (mass, damping) = LIGHT;
    let count = rounded(ADMITTANCE_S / dt_s);
    // what was sampled before the start is what is sampled there
    let shares: Vec<f64> = (0..=count).map(|i| push.share((f64::from(i) - 1.0).max(0.0) * dt_s)).collect();
    let mut ordered = [const { Vec::new() }; 3];
    let mut times_s = [f64::INFINITY, 0.0];
    for (axis, ordered) in ordered.iter_mut().enumerate() {
        let run = || {
            let mut velocity = 0.0;
            let next = |pair: &[f64]| {
                let (before, now) = (PUSH[axis] * pair[0], PUSH[axis] * pair[1]);
                let tick = Tick {
                    velocity: black_box(velocity),
                    now,
                    before,
                    mass: mass[axis],
                    damping: damping[axis],
                    dt_s,
                };
                velocity = step(tick);
                velocity
            };
            shares.windows(2).map(next).collect::<Vec<f64>>()
        };
        let (velocities, cpu_s) = cpu_time::timed(run);
        (*ordered, times_s) = (velocities, [times_s[0].min(cpu_s), times_s[1].max(cpu_s)]);
    }
    let every = rounded(COMPARED_EVERY_S / dt_s);
    let (mut pose, mut off) = ([0.0; 3], Off::default());
    for i in 0..count {
        let velocity = std::array::from_fn(|axis| ordered[axis][i as usize]);
        pose = moved(pose, velocity, dt_s);
        if (i + 1) % every == 0 {
            off.take(&pose, &exact[((i + 1) / every - 1) as usize]);
        }
    }
    (off, times_s)
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
            let step = |input| Ok(f64::step(&double, &mut state, input)?.command.arm_torque_nm);
            inputs.iter().map(step).collect::<Result<Vec<_>>>()
        });
        let (torques32, cpu32_s) = cpu_time::timed(|| {
            let step = |input| Ok(f32::step(&single, &mut state32, input)?.command.arm_torque_nm);
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
        plant.apply(&Actuation::Drive(f64::step(&controller, &mut state, &input)?.command))?;
        plant.step()?;
        states.push(robot);
    }
    Ok(states)
}

fn narrow(robot: &RobotState<JOINTS>) -> RobotState<JOINTS, f32> {
    #[expect(clippy::cast_possible_truncation, reason = "single precision is what is being measured")]
    state_in(robot, |value| value as f32)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn exact_hold_has_least_error_and_euler_fails_as_predicted() {
        let points = admittance();
        let at = |method: &str, step_ms: f64| {
            let wanted = |p: &&AdmittancePoint| p.method == method && (p.step_ms - step_ms).abs() < 1e-9;
            points.iter().find(wanted).cloned().unwrap()
        };
        for point in &points {
            println!("{point:?}");
        }
        // dt D/M > 2 from 20 ms on.
        assert!(at("explicit Euler", 30.0).failed && !at("explicit Euler", 10.0).failed);
        assert!(
            admittance_recommendation(&points).ends_with("exact hold (ours)"),
            "{}",
            admittance_recommendation(&points)
        );
        // Of the smooth force the half tick that a held order leads makes up for the half tick that a held force lags.
        for (method, order) in
            [("exact hold (ours)", 2), ("Tustin, to the present", 1), ("first-order hold, extrapolated", 1)]
        {
            let ratio = at(method, 1.0).smooth.flange_m / at(method, 0.1).smooth.flange_m;
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
