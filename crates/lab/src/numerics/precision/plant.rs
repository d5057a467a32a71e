//! Integrators and steps of the plant: error in state and in peak force against CPU time.
//!
//! The controller runs every 4 ms whatever the physics step: the control input is held on one grid, and runs differ in
//! nothing but integrator and step.

use super::controller;
use anyhow::{Context, Result};
use moca_experiments::TAXELS;
use moca_experiments::count;
use moca_experiments::cpu_time;
use moca_experiments::free_scene;
use moca_experiments::timed::Timed as _;
use moca_figures::progress::Progress;
use moca_msgs::Actuation;
use moca_sim::foam::Foam;
use moca_sim::{Integrator, Person, Scene, SimPlant};
use moca_wbc::{ControlInput, ControlLaw};
use serde::Serialize;

/// Control period, s, and number of them: 1 s.
const GRID_S: f64 = 4e-3;
const TICKS: u32 = 250;
const STEPS_MS: [f64; 8] = [4.0, 2.0, 1.0, 0.5, 0.25, 0.1, 0.05, 0.02];
/// The reference and the coarser one that shows how far it can be trusted, ms.
const REFERENCE_MS: [f64; 2] = [0.005, 0.01];
/// In the order of preference where they cost the same.
pub(crate) const METHODS: [(Integrator, &str); 4] = [
    (Integrator::ImplicitFast, "implicitfast"),
    (Integrator::Euler, "Euler"),
    (Integrator::Implicit, "implicit"),
    (Integrator::RungeKutta4, "RK4"),
];
/// Accuracy asked of a scene: error of the state (m, rad) and, in contact, of the peak force as a share of it.
const WANTED: (f64, f64) = (1e-3, 0.01);
/// A tick of the daemon is 1 ms: a recommended step fits into it.
const STEP_MAX_MS: f64 = 1.0;
/// Costs closer than this factor count as the same.
const SAME_COST: f64 = 1.5;
/// Equal runs: they differ in nothing but the time they take.
const RUNS: usize = 3;
/// Further from the reference than this, m or rad, is a failure, whatever MuJoCo says.
const FAILED_FROM: f64 = 1.0;

#[derive(Clone, Debug, Serialize)]
pub(crate) struct Point {
    pub integrator: &'static str,
    pub step_ms: f64,
    /// CPU time of the plant for a second of simulation, s: the least and the most of [`RUNS`] equal runs; of a failed one,
    /// until it failed.
    pub cpu_s_per_s: f64,
    pub cpu_most_s_per_s: f64,
    /// Largest difference at the end: base m and rad, arm rad.
    pub state_error: f64,
    /// Largest difference of the base's place at the end, m.
    pub place_error_m: f64,
    /// Largest difference of the angles of base and arm at the end, rad.
    pub angle_error_rad: f64,
    /// Relative error of the peak force; null without contact.
    pub peak_error: Option<f64>,
    /// Why it counts as failed.
    pub failed: Option<String>,
}

#[derive(Debug, Serialize)]
pub(crate) struct SceneReport {
    pub scene: &'static str,
    pub reference: String,
    /// Difference of the reference from the coarser one: errors below it mean nothing.
    pub self_consistency: f64,
    pub self_consistency_m: f64,
    pub self_consistency_rad: f64,
    pub peak_self_consistency: Option<f64>,
    pub points: Vec<Point>,
    pub recommendation: String,
    /// True if the recommended setting is the default of scenes.
    pub is_default: bool,
}

/// End of one run.
struct End {
    state: [f64; 10],
    peak_n: f64,
    cpu_s: f64,
}

/// Free motion after a push, and a base that drives into a person.
pub(crate) fn measure(quick: bool) -> Result<Vec<SceneReport>> {
    let smooth = Scene { joint_limits: false, control_period_s: GRID_S, ..free_scene() };
    let person =
        Person { steps_away_after_s: None, ..Person::beside(&smooth.cover, 5, 0.01).context("no T6")? };
    let contact = Scene { people: vec![person], foam: Foam::COLLISION_ASSUMED, ..smooth.clone() };
    Ok(vec![
        work_precision("smooth", &smooth, None, quick)?,
        work_precision("contact", &contact, Some([0.12, 0.0, 0.0]), quick)?,
    ])
}

/// The controller feels a push on T3; a given `base_velocity` replaces the base's own.
fn play(scene: &Scene, integrator: Integrator, step_ms: f64, base_velocity: Option<[f64; 3]>) -> Result<End> {
    let mut plant = SimPlant::new(&Scene { integrator, physics_step_s: 1e-3 * step_ms, ..scene.clone() })?;
    let controller = controller::<f64>()?;
    let mut state = controller.enter(ControlLaw::Impedance, &plant.state().resized())?;
    let mut cpu_s = 0.0;
    for tick in 0..TICKS {
        let robot = plant.state().resized();
        let mut taxel_force_n = [0.0; TAXELS];
        taxel_force_n[2] = if tick < 100 { 20.0 } else { 0.0 };
        let input = ControlInput::new(robot, taxel_force_n, GRID_S);
        let mut command = f64::step(&controller, &mut state, &input)?.command;
        if let Some(base_velocity) = base_velocity {
            command.base_velocity_body = base_velocity;
        }
        plant.apply(&Actuation::Drive(command))?;
        let (stepped, step_s) = cpu_time::timed(|| plant.step());
        stepped?;
        cpu_s += step_s;
    }
    let end = plant.state();
    let mut state = [0.0; 10];
    state[..3].copy_from_slice(&end.base_pose_world);
    state[3..].copy_from_slice(&end.q_rad[..7]);
    Ok(End { state, peak_n: plant.contact_peak_true_n(), cpu_s })
}

/// Evaluations of the dynamics for each millisecond: what a run costs beside another.
fn steps(integrator: Integrator, step_ms: f64) -> f64 {
    if integrator == Integrator::RungeKutta4 { 4.0 / step_ms } else { 1.0 / step_ms }
}

/// Elements of the state that are lengths, m; the others are angles, rad.
const LENGTHS: usize = 2;

fn distance(a: &End, b: &End) -> f64 {
    let [place_m, angle_rad] = distances(a, b);
    place_m.max(angle_rad)
}

/// Largest difference of the lengths, m, and of the angles, rad.
fn distances(a: &End, b: &End) -> [f64; 2] {
    let all: Vec<f64> = a.state.iter().zip(b.state).map(|(a, b)| (a - b).abs()).collect();
    let (lengths, angles) = all.split_at(LENGTHS);
    [lengths, angles].map(|part| part.iter().copied().fold(0.0, f64::max))
}

fn work_precision(
    name: &'static str,
    scene: &Scene,
    base_velocity: Option<[f64; 3]>,
    quick: bool,
) -> Result<SceneReport> {
    let [fine, coarse] = if quick { [0.02, 0.05] } else { REFERENCE_MS };
    let steps_ms = || STEPS_MS.into_iter().filter(|step| !quick || *step > 0.1);
    let all = METHODS.into_iter().flat_map(|(integrator, _)| steps_ms().map(move |ms| steps(integrator, ms)));
    let all = count(RUNS) * all.sum::<f64>()
        + steps(Integrator::RungeKutta4, fine)
        + steps(Integrator::RungeKutta4, coarse);
    let (mut progress, mut done) = (Progress::new(format!("precision, {name}")), 0.0);
    let mut play = |integrator, step_ms| {
        let (end, cpu_s) = cpu_time::timed(|| play(scene, integrator, step_ms, base_velocity));
        done += steps(integrator, step_ms);
        progress.at(done / all);
        (end, cpu_s)
    };
    let reference = play(Integrator::RungeKutta4, fine).0?;
    let check = play(Integrator::RungeKutta4, coarse).0?;
    let touches = reference.peak_n > 0.0;
    let peak_off = |end: &End| touches.then(|| (end.peak_n / reference.peak_n - 1.0).abs());
    let mut points = Vec::new();
    for (integrator, method) in METHODS {
        for step_ms in steps_ms() {
            let mut point = Point {
                integrator: method,
                step_ms,
                cpu_s_per_s: f64::INFINITY,
                cpu_most_s_per_s: 0.0,
                state_error: f64::NAN,
                place_error_m: f64::NAN,
                angle_error_rad: f64::NAN,
                peak_error: None,
                failed: None,
            };
            let mut take = |cpu_s: f64| {
                point.cpu_s_per_s = point.cpu_s_per_s.min(cpu_s);
                point.cpu_most_s_per_s = point.cpu_most_s_per_s.max(cpu_s);
            };
            let mut ends = Vec::new();
            for _ in 0..RUNS {
                let (end, cpu_s) = play(integrator, step_ms);
                take(end.as_ref().map_or(cpu_s, |end| end.cpu_s));
                ends.push(end);
            }
            match ends.pop().context("no run")? {
                Ok(end) => {
                    point.state_error = distance(&end, &reference);
                    [point.place_error_m, point.angle_error_rad] = distances(&end, &reference);
                    point.peak_error = peak_off(&end);
                    let far = point.state_error.is_nan() || point.state_error > FAILED_FROM;
                    point.failed = far.then(|| "far from the reference".to_owned());
                }
                Err(error) => point.failed = Some(format!("{error:#}")),
            }
            points.push(point);
        }
    }
    let best = recommended(&points, |point| point.cpu_s_per_s);
    let [self_consistency_m, self_consistency_rad] = distances(&check, &reference);
    Ok(SceneReport {
        scene: name,
        reference: format!("RK4 at {fine} ms"),
        self_consistency: distance(&check, &reference),
        self_consistency_m,
        self_consistency_rad,
        peak_self_consistency: peak_off(&check),
        recommendation: recommendation(best),
        is_default: best.is_some_and(is_default),
        points,
    })
}

/// The cheapest setting that meets the wanted error.
pub(crate) fn recommended(points: &[Point], cost: impl Fn(&Point) -> f64) -> Option<&Point> {
    let (state, peak) = WANTED;
    let good = || {
        points.iter().filter(|p| {
            p.failed.is_none()
                && p.step_ms <= STEP_MAX_MS
                && p.state_error <= state
                && p.peak_error.is_none_or(|e| e <= peak)
        })
    };
    let least = good().map(&cost).fold(f64::INFINITY, f64::min);
    good().find(|p| cost(p) <= SAME_COST * least)
}

pub(crate) fn is_default(best: &Point) -> bool {
    let default = free_scene();
    METHODS.iter().any(|(integrator, name)| *integrator == default.integrator && *name == best.integrator)
        && (best.step_ms - 1e3 * default.physics_step_s).abs() < 1e-9
}

fn recommendation(best: Option<&Point>) -> String {
    let (state, peak) = WANTED;
    let asked = format!("state within {state:.0e} m, rad and peak force within {:.0} %", 100.0 * peak);
    match best {
        Some(best) => format!(
            "recommended, the cheapest with {asked} at steps up to {STEP_MAX_MS} ms: {} at {} ms ({:.4} s/s){}",
            best.integrator,
            best.step_ms,
            best.cpu_s_per_s,
            if is_default(best) { ", the default" } else { "; the default is another" }
        ),
        None => format!("no setting reaches {asked}"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_default_is_what_the_diagram_recommends_and_failures_show() {
        let scenes = measure(true).unwrap();
        for scene in &scenes {
            // Evaluations of the dynamics per second instead of a clock: a test does not measure time.
            let evaluations = |p: &Point| match p.integrator {
                "RK4" => 4.0 / p.step_ms,
                "implicit" => 2.0 / p.step_ms,
                _ => 1.0 / p.step_ms,
            };
            let best = recommended(&scene.points, evaluations).unwrap();
            assert!(is_default(best), "{}: {best:?}", scene.scene);
            let figures = match best.peak_error {
                None => format!("{:.0e} m, rad in free motion", best.state_error),
                Some(peak) => format!("{:.0e} m, rad and {:.1} %", best.state_error, 100.0 * peak),
            };
            assert!(include_str!("../../../../../docs/results.md").contains(&figures), "no longer {figures}");
            assert!(scene.self_consistency < 0.1 * best.state_error, "{} {best:?}", scene.self_consistency);
            let at = |method: &str, step_ms: f64| {
                let wanted = |p: &&Point| p.integrator == method && (p.step_ms - step_ms).abs() < 1e-9;
                scene.points.iter().find(wanted).cloned().unwrap()
            };
            assert!(at("RK4", 4.0).failed.is_some(), "the base's inner servo is too stiff for it");
            let (euler, rk4) = (at("Euler", 0.5), at("RK4", 0.5));
            match (euler.peak_error, rk4.peak_error) {
                // A contact force that is held over a step makes the explicit method gain energy.
                (Some(euler), Some(rk4)) => assert!(rk4 > 2.0 * euler, "{rk4} {euler}"),
                _ => assert!(rk4.state_error < 0.2 * euler.state_error, "{rk4:?} {euler:?}"),
            }
        }
    }
}
