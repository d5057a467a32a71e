//! `moca-lab precision`: error against run time, for the plant's integration, the control rate, the admittance's
//! discretisation, single precision and the calibration models. Times are CPU times.

mod control;
mod diagrams;
mod plant;

use crate::cover::characterize;
use crate::picture::{Picture as _, Width};
use crate::study::{Answer, Column, table};
use anyhow::{Context, Result};
use moca_experiments::timed::Controller;
use moca_msgs::Parameters;
use moca_msgs::robot::{MOCA_MOUNT, PANDA, PAPER_COVER, Payload};
use serde::Serialize;
use std::path::PathBuf;

/// Error against run time: integrators and steps, control rate, single precision.
#[derive(clap::Args)]
pub(crate) struct Arguments {
    #[command(flatten)]
    answer: Answer,
    /// Writes the diagrams (SVG, PDF, PNG) and the table (JSON) into this folder.
    #[arg(long, value_name = "DIR")]
    out: Option<PathBuf>,
    /// Width of the diagrams.
    #[arg(long, value_enum, default_value_t)]
    width: Width,
    /// Only steps above 0.1 ms against a reference of 0.02 ms: seconds instead of a minute.
    #[arg(long)]
    quick: bool,
}

#[derive(Debug, Serialize)]
struct Report {
    scenes: Vec<plant::SceneReport>,
    control_rate: Vec<control::RatePoint>,
    control_rate_recommendation: String,
    admittance: Vec<control::AdmittancePoint>,
    admittance_recommendation: String,
    /// Models of the taxel on the cover's foam.
    calibration: Vec<characterize::HeldOut>,
    /// Largest torque of f32 control less that of f64, N·m, over the smooth run; and CPU time per tick of each, ns.
    f32_torque_error_nm: f64,
    f64_tick_ns: f64,
    f32_tick_ns: f64,
}

/// Everything, printed and drawn.
pub(crate) fn run(arguments: &Arguments) -> Result<()> {
    let report = measure(arguments.quick)?;
    if let Some(folder) = &arguments.out {
        std::fs::create_dir_all(folder).with_context(|| format!("cannot create {}", folder.display()))?;
        diagrams::draw(&report, arguments.width).write(&folder.join("precision"))?;
        std::fs::write(folder.join("precision.json"), serde_json::to_string_pretty(&report)?)?;
    }
    arguments.answer.print(&report, || Ok(text(&report)))
}

fn measure(quick: bool) -> Result<Report> {
    let scenes = plant::measure(quick)?;
    let control_rate = control::rates()?;
    let admittance = control::admittance();
    let (f32_torque_error_nm, f64_tick_ns, f32_tick_ns) = control::single_precision()?;
    Ok(Report {
        scenes,
        control_rate_recommendation: control::rate_recommendation(&control_rate),
        control_rate,
        admittance_recommendation: control::admittance_recommendation(&admittance),
        admittance,
        calibration: characterize::models_on_the_cover(if quick { 4 } else { 10 }, 1)?,
        f32_torque_error_nm,
        f64_tick_ns,
        f32_tick_ns,
    })
}

fn controller<T: moca_wbc::Scalar>() -> Result<Controller<T>> {
    Ok(Controller::new(&PANDA, &MOCA_MOUNT, &Payload::NONE, &PAPER_COVER, &Parameters::PAPER)?)
}

const POINTS: &[Column<plant::Point>] = &[
    ("integrator", |p| p.integrator.into()),
    ("step, ms", |p| p.step_ms.to_string()),
    ("CPU, s/s", |p| format!("{:.4}", p.cpu_s_per_s)),
    ("state", |p| p.failed.as_ref().map_or(format!("{:.1e}", p.state_error), |why| format!("FAILED: {why}"))),
    ("peak", |p| p.peak_error.map_or("-".into(), |e| format!("{e:.1e}"))),
];

const RATES: &[Column<control::RatePoint>] = &[
    ("rate, Hz", |p| p.rate_hz.to_string()),
    ("flange, mm", |p| format!("{:.2}", p.flange_max_mm)),
    ("base against 4 kHz, mm", |p| format!("{:.3}", p.base_error_mm)),
    ("CPU, s/s", |p| format!("{:.4}", p.cpu_s_per_s)),
];

const ADMITTANCE: &[Column<control::AdmittancePoint>] = &[
    ("discretisation", |p| p.method.into()),
    ("step, ms", |p| p.step_ms.to_string()),
    ("smooth force: base, yaw, flange", |p| p.smooth.to_string()),
    ("held reading: base, yaw, flange", |p| p.held.to_string()),
    ("CPU, s/s", |p| format!("{:.1e}", p.cpu_s_per_s)),
    ("", |p| if p.failed { "FAILED".into() } else { String::new() }),
];

const MODELS: &[Column<characterize::HeldOut>] = &[
    ("model of PU LD30, trials not seen", |model| model.model.into()),
    ("error, N", |model| format!("{:.2}", model.rmse_n)),
    ("one evaluation, ns", |model| format!("{:.1}", model.cost_ns)),
];

fn text(report: &Report) -> String {
    let scene = |scene: &plant::SceneReport| {
        let own =
            scene.peak_self_consistency.map_or(String::new(), |p| format!(", of the peak force {p:.1e}"));
        let plant::SceneReport { scene, reference, self_consistency, points, recommendation, .. } = scene;
        let points = table(POINTS, points);
        format!(
            "{scene} against {reference}: self-consistency {self_consistency:.1e}{own}\n\n{points}{recommendation}\n\n"
        )
    };
    let [rates, admittance, models] = [
        table(RATES, &report.control_rate),
        table(ADMITTANCE, &report.admittance),
        table(MODELS, &report.calibration),
    ];
    format!(
        "{}control rate, T6 20 N, ideal sensor, physics at 0.25 ms\n\n{rates}{}\n\n\
         admittance, M/D = 10 ms, from samples up to the present: largest error along the way\n\n{admittance}{}\n\n{models}\n\
         f32 control: torque off by {:.1e} N.m at most; a tick takes {:.0} ns in f64, {:.0} ns in f32\n",
        report.scenes.iter().map(scene).collect::<String>(),
        report.control_rate_recommendation,
        report.admittance_recommendation,
        report.f32_torque_error_nm,
        report.f64_tick_ns,
        report.f32_tick_ns
    )
}
