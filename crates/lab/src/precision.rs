//! `moca-lab precision`: error against run time, for the plant's integration and for the control rate.
//!
//! The commands of one run are recorded on a grid of 1 ms and played back, held over each millisecond, into plants that
//! differ in nothing but integrator and step. The error is the largest difference of the state (base m and rad, arm
//! rad) at the end, and of the peak force.

use crate::chart::{Panel, Scale, Series};
use crate::drawing::Drawing;
use crate::experiment::push;
use crate::experiment::rig::Rig;
use crate::experiment::settings::Settings;
use anyhow::{Context, Result};
use moca_msgs::robot::{MOCA_MOUNT, PANDA, PAPER_COVER, Payload};
use moca_msgs::{Actuation, Law, Parameters, RobotCommand, RobotState};
use moca_sim::foam::FoamLaw;
use moca_sim::{Integrator, Person, Scene, SimPlant};
use moca_wbc::{ControlInput, ControlLaw, Controller};
use serde::Serialize;
use std::path::PathBuf;
use std::time::Instant;

/// Length of a run, ms.
const TICKS: usize = 1000;
const STEPS_MS: [f64; 6] = [1.0, 0.5, 0.25, 0.1, 0.05, 0.02];
/// The reference and the coarser one that shows how far it can be trusted, ms.
const REFERENCE_MS: [f64; 2] = [0.005, 0.01];
const METHODS: [(Integrator, &str); 4] = [
    (Integrator::Euler, "Euler"),
    (Integrator::ImplicitFast, "implicitfast"),
    (Integrator::Implicit, "implicit"),
    (Integrator::RungeKutta4, "RK4"),
];
/// What a user asks of a scene: state and, in contact, peak force.
const WANTED: (f64, f64) = (1e-3, 0.02);
const RATES_HZ: [u32; 6] = [100, 200, 500, 1000, 2000, 4000];

/// Arguments of `moca-lab precision`.
#[derive(clap::Args)]
pub(crate) struct Arguments {
    /// Prints one JSON object.
    #[arg(long)]
    json: bool,
    /// Writes the diagrams (SVG, PNG) and the table (JSON) into this folder.
    #[arg(long, value_name = "DIR")]
    out: Option<PathBuf>,
    /// Only the steps down to 0.1 ms against a reference of 0.02 ms: seconds instead of a minute.
    #[arg(long)]
    quick: bool,
}

#[derive(Clone, Debug, Serialize)]
struct Point {
    scene: &'static str,
    integrator: &'static str,
    step_ms: f64,
    /// CPU time for a second of simulation, s.
    cpu_s_per_s: f64,
    state_error: f64,
    /// Relative error of the peak force; null without contact.
    peak_error: Option<f64>,
    /// MuJoCo's warning; null for a run that ended.
    failed: Option<String>,
}

#[derive(Debug, Serialize)]
struct SceneReport {
    scene: &'static str,
    reference: String,
    /// Difference of the reference from the coarser one: errors below it mean nothing.
    self_consistency: f64,
    peak_self_consistency: Option<f64>,
    points: Vec<Point>,
    recommendation: String,
}

#[derive(Debug, Serialize)]
struct RatePoint {
    rate_hz: u32,
    flange_max_mm: f64,
    base_error_mm: f64,
    cpu_s_per_s: f64,
}

#[derive(Debug, Serialize)]
struct Report {
    scenes: Vec<SceneReport>,
    control_rate: Vec<RatePoint>,
    /// Largest torque of f32 control less that of f64, N·m, over the smooth run; and CPU time per tick of each, ns.
    f32_torque_error_nm: f64,
    f64_tick_ns: f64,
    f32_tick_ns: f64,
}

/// The result of one playback.
struct End {
    state: [f64; 10],
    peak_n: f64,
    cpu_s: f64,
}

struct Recording {
    commands: Vec<RobotCommand<7>>,
    states: Vec<RobotState<7>>,
}

/// Everything, printed and drawn.
#[expect(clippy::print_stdout, reason = "the command's output")]
pub(crate) fn run(arguments: &Arguments) -> Result<()> {
    let report = measure(arguments.quick)?;
    let json = serde_json::to_string_pretty(&report)?;
    if let Some(folder) = &arguments.out {
        std::fs::create_dir_all(folder).with_context(|| format!("cannot create {}", folder.display()))?;
        let drawing = draw(&report);
        std::fs::write(folder.join("precision.svg"), drawing.svg())?;
        std::fs::write(folder.join("precision.png"), drawing.png()?)?;
        std::fs::write(folder.join("precision.json"), &json)?;
    }
    println!("{}", if arguments.json { json } else { text(&report) });
    Ok(())
}

fn text(report: &Report) -> String {
    let mut lines = Vec::new();
    for scene in &report.scenes {
        lines.push(format!(
            "{} against {}: self-consistency {:.1e}{}",
            scene.scene,
            scene.reference,
            scene.self_consistency,
            scene.peak_self_consistency.map_or(String::new(), |p| format!(", of the peak force {p:.1e}"))
        ));
        for p in &scene.points {
            lines.push(format!(
                "  {:13} {:5} ms  {:9.4} s/s  state {:.1e}  peak {}  {}",
                p.integrator,
                p.step_ms,
                p.cpu_s_per_s,
                p.state_error,
                p.peak_error.map_or("-".into(), |e| format!("{e:.1e}")),
                p.failed.as_deref().unwrap_or("")
            ));
        }
        lines.push(format!("  {}", scene.recommendation));
    }
    lines.push("control rate, T6 20 N, ideal sensor: flange error, base error against 4 kHz, CPU".into());
    for p in &report.control_rate {
        lines.push(format!(
            "  {:5} Hz  {:6.2} mm  {:7.3} mm  {:.4} s/s",
            p.rate_hz, p.flange_max_mm, p.base_error_mm, p.cpu_s_per_s
        ));
    }
    lines.push(format!(
        "f32 control: torque off by {:.1e} N.m at most; a tick takes {:.0} ns in f64, {:.0} ns in f32",
        report.f32_torque_error_nm, report.f64_tick_ns, report.f32_tick_ns
    ));
    lines.join("\n")
}

/// A scene without contact and one in which the base drives into a person.
fn scenes() -> Result<[Scene; 2]> {
    let smooth = Scene { joint_limits: false, ..Scene::default() };
    let mut person = Person::beside(5, 0.01).context("no T6")?;
    person.steps_away_after_s = None;
    let contact = Scene { people: vec![person], foam: FoamLaw::CollisionAssumed, ..smooth.clone() };
    Ok([smooth, contact])
}

fn measure(quick: bool) -> Result<Report> {
    let [smooth, contact] = scenes()?;
    let free = record(&smooth, None)?;
    let touching = record(&contact, Some([0.12, 0.0, 0.0]))?;
    let (f32_torque_error_nm, f64_tick_ns, f32_tick_ns) = single_precision(&free)?;
    Ok(Report {
        scenes: vec![
            work_precision("smooth", &smooth, &free, quick)?,
            work_precision("contact", &contact, &touching, quick)?,
        ],
        control_rate: control_rate()?,
        f32_torque_error_nm,
        f64_tick_ns,
        f32_tick_ns,
    })
}

/// Commands of a closed loop on the scene at a fine step: a push on T3 moves base and arm; a given `base_velocity`
/// replaces the base's own.
fn record(scene: &Scene, base_velocity: Option<[f64; 3]>) -> Result<Recording> {
    let mut plant = SimPlant::new(&Scene {
        physics_step_s: 1e-4,
        integrator: Some(Integrator::RungeKutta4),
        ..scene.clone()
    })?;
    let controller = controller::<f64>()?;
    let mut state = controller.enter(ControlLaw::Impedance, &plant.state())?;
    let mut recording = Recording { commands: Vec::new(), states: Vec::new() };
    for tick in 0..TICKS {
        let robot = plant.state();
        let mut taxel_force_n = [0.0; 11];
        taxel_force_n[2] = if tick < 400 { 20.0 } else { 0.0 };
        let input = ControlInput { robot, taxel_force_n, flange_wrench_world: None, dt_s: 1e-3 };
        let mut command = controller.step(ControlLaw::Impedance, &mut state, &input)?.command;
        if let Some(base_velocity) = base_velocity {
            command.base_velocity_body = base_velocity;
        }
        plant.apply(&Actuation::Drive(command))?;
        plant.step()?;
        recording.commands.push(command);
        recording.states.push(robot);
    }
    Ok(recording)
}

fn controller<T: moca_wbc::Scalar>() -> Result<Controller<7, 11, T>> {
    Ok(Controller::new(&PANDA, &MOCA_MOUNT, &Payload::NONE, &PAPER_COVER, &Parameters::PAPER)?)
}

fn play(scene: &Scene, integrator: Integrator, step_ms: f64, recording: &Recording) -> Result<End> {
    let mut plant = SimPlant::new(&Scene {
        integrator: Some(integrator),
        physics_step_s: 1e-3 * step_ms,
        ..scene.clone()
    })?;
    let started = Instant::now();
    let mut peak_n: f64 = 0.0;
    for command in &recording.commands {
        plant.apply(&Actuation::Drive(*command))?;
        plant.step()?;
        peak_n = plant.taxel_force_true_n().into_iter().fold(peak_n, f64::max);
    }
    let cpu_s = started.elapsed().as_secs_f64();
    let end = plant.state();
    let mut state = [0.0; 10];
    state[..3].copy_from_slice(&end.base_pose_world);
    state[3..].copy_from_slice(&end.q_rad);
    Ok(End { state, peak_n, cpu_s })
}

fn distance(a: &End, b: &End) -> f64 {
    a.state.iter().zip(b.state).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max)
}

fn work_precision(
    name: &'static str,
    scene: &Scene,
    recording: &Recording,
    quick: bool,
) -> Result<SceneReport> {
    let [fine, coarse] = if quick { [0.02, 0.05] } else { REFERENCE_MS };
    let steps: Vec<f64> =
        STEPS_MS.into_iter().filter(|step| *step > 2.0 * coarse || !quick && *step > coarse).collect();
    let reference = play(scene, Integrator::RungeKutta4, fine, recording)?;
    let check = play(scene, Integrator::RungeKutta4, coarse, recording)?;
    let touches = reference.peak_n > 0.0;
    let peak_off = |end: &End| touches.then(|| (end.peak_n / reference.peak_n - 1.0).abs());
    let mut points = Vec::new();
    for (integrator, method) in METHODS {
        for &step_ms in &steps {
            let point = |cpu, state_error, peak_error, failed| Point {
                scene: name,
                integrator: method,
                step_ms,
                cpu_s_per_s: cpu,
                state_error,
                peak_error,
                failed,
            };
            points.push(match play(scene, integrator, step_ms, recording) {
                Ok(end) => point(end.cpu_s, distance(&end, &reference), peak_off(&end), None),
                Err(error) => point(f64::NAN, f64::NAN, None, Some(format!("{error:#}"))),
            });
        }
    }
    let recommendation = recommend(&points);
    Ok(SceneReport {
        scene: name,
        reference: format!("RK4 at {fine} ms"),
        self_consistency: distance(&check, &reference),
        peak_self_consistency: peak_off(&check),
        points,
        recommendation,
    })
}

/// The cheapest setting that meets the wanted error.
fn recommend(points: &[Point]) -> String {
    let (state, peak) = WANTED;
    let good = |p: &&Point| p.state_error <= state && p.peak_error.is_none_or(|e| e <= peak);
    match points.iter().filter(good).min_by(|a, b| a.cpu_s_per_s.total_cmp(&b.cpu_s_per_s)) {
        Some(best) => format!(
            "cheapest with a state error of {state:.0e} and a peak force within {:.0} %: {} at {} ms ({:.4} s/s)",
            100.0 * peak,
            best.integrator,
            best.step_ms,
            best.cpu_s_per_s
        ),
        None => format!(
            "no setting reaches a state error of {state:.0e} and a peak force within {:.0} %",
            100.0 * peak
        ),
    }
}

fn control_rate() -> Result<Vec<RatePoint>> {
    let mut runs = Vec::new();
    for rate_hz in RATES_HZ {
        let mut settings = Settings::paper(Law::Impedance);
        let step_ms = (1e3 / f64::from(rate_hz)).min(1.0);
        for assignment in [
            "sensor=ideal".to_owned(),
            format!("rate_hz={rate_hz}"),
            format!("step_ms={step_ms}"),
            "rest_s=0".into(),
        ] {
            settings.set(&assignment)?;
        }
        let mut rig = Rig::start(&settings, &settings.free_scene())?;
        let started = Instant::now();
        let outcome = push::run(&mut rig, &settings, &[push::single(&[5], 20.0)])?.pop();
        let cpu_s = started.elapsed().as_secs_f64();
        if let Some(outcome) = outcome {
            runs.push((rate_hz, outcome, cpu_s / settings.push_s));
        }
    }
    let finest = runs.last().map_or([0.0; 3], |(_, outcome, _)| outcome.base_displacement);
    Ok(runs
        .into_iter()
        .map(|(rate_hz, outcome, cpu_s_per_s)| RatePoint {
            rate_hz,
            flange_max_mm: outcome.flange_max_mm,
            base_error_mm: 1e3 * (outcome.base_displacement[0] - finest[0]).abs(),
            cpu_s_per_s,
        })
        .collect())
}

/// Both precisions over the states of a recording: largest difference of torque, N·m, and time per tick, ns.
fn single_precision(recording: &Recording) -> Result<(f64, f64, f64)> {
    let (double, single) = (controller::<f64>()?, controller::<f32>()?);
    let first = recording.states.first().context("an empty recording")?;
    let mut state = double.enter(ControlLaw::Impedance, first)?;
    let mut state32 = single.enter(ControlLaw::Impedance, &narrow(first))?;
    let mut worst: f64 = 0.0;
    let (mut ns, mut ns32) = (0u128, 0u128);
    for robot in &recording.states {
        let input =
            ControlInput { robot: *robot, taxel_force_n: [0.0; 11], flange_wrench_world: None, dt_s: 1e-3 };
        let input32 = ControlInput {
            robot: narrow(robot),
            taxel_force_n: [0.0; 11],
            flange_wrench_world: None,
            dt_s: 1e-3,
        };
        let started = Instant::now();
        let a = double.step(ControlLaw::Impedance, &mut state, &input)?;
        ns += started.elapsed().as_nanos();
        let started = Instant::now();
        let b = single.step(ControlLaw::Impedance, &mut state32, &input32)?;
        ns32 += started.elapsed().as_nanos();
        for (a, b) in a.command.arm_torque_nm.iter().zip(b.command.arm_torque_nm) {
            worst = worst.max((a - f64::from(b)).abs());
        }
    }
    #[expect(clippy::cast_precision_loss, reason = "nanoseconds of a second")]
    let mean = |ns: u128| ns as f64 / recording.states.len() as f64;
    Ok((worst, mean(ns), mean(ns32)))
}

fn narrow(robot: &RobotState<7>) -> RobotState<7, f32> {
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

fn draw(report: &Report) -> Drawing {
    let mut drawing = Drawing::new(900.0, 920.0);
    let mut top = 10.0;
    let mut diagram = |title: String, y: &str, pick: &dyn Fn(&Point) -> Option<f64>, scene: &SceneReport| {
        let series = METHODS.iter().enumerate().map(|(i, (_, method))| {
            let points = scene.points.iter().filter(|p| p.integrator == *method);
            let points = points.filter_map(|p| Some([p.cpu_s_per_s, pick(p)?.max(1e-16)]));
            Series::line(i, *method, points.collect())
        });
        Panel {
            x_scale: Scale::Log,
            y_scale: Scale::Log,
            series: series.collect(),
            ..Panel::new(&title, "CPU s per s", y)
        }
        .draw(&mut drawing, [0.0, top], [900.0, 290.0]);
        top += 300.0;
    };
    for scene in &report.scenes {
        let title = format!(
            "{} scene: error in state after 1 s (reference good to {:.0e})",
            scene.scene, scene.self_consistency
        );
        diagram(title, "m, rad", &|p| Some(p.state_error), scene);
        if let Some(own) = scene.peak_self_consistency {
            let title = format!("{} scene: error in peak force (reference good to {own:.0e})", scene.scene);
            diagram(title, "relative", &|p| p.peak_error, scene);
        }
    }
    drawing
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn higher_order_pays_in_a_smooth_scene_and_contact_forces_are_close_at_a_millisecond() {
        let [smooth, contact] = scenes().unwrap();
        let free = record(&smooth, None).unwrap();
        let touching = record(&contact, Some([0.12, 0.0, 0.0])).unwrap();
        let smooth = &work_precision("smooth", &smooth, &free, true).unwrap();
        let contact = &work_precision("contact", &contact, &touching, true).unwrap();
        let at = |scene: &SceneReport, method: &str, step_ms: f64| {
            scene
                .points
                .iter()
                .find(|p| p.integrator == method && (p.step_ms - step_ms).abs() < 1e-9)
                .cloned()
                .unwrap()
        };
        let (euler, rk4) = (at(smooth, "Euler", 0.5), at(smooth, "RK4", 0.5));
        assert!(rk4.state_error < 0.01 * euler.state_error, "{rk4:?} {euler:?}");
        assert!(smooth.self_consistency < rk4.state_error.max(1e-9), "{}", smooth.self_consistency);
        let default = at(contact, "implicitfast", 1.0);
        assert!(default.peak_error.unwrap() < 0.05 && default.state_error < 2e-2, "{default:?}");
        let (f32_torque_error_nm, ..) = single_precision(&free).unwrap();
        assert!(f32_torque_error_nm < 1e-2, "{f32_torque_error_nm}");
    }
}
