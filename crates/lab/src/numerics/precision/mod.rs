//! `moca-lab precision`: error against run time, for the plant's integration, the control rate, the admittance's
//! discretisation, single precision and the calibration models. Times are CPU times.

mod control;
mod diagrams;
mod plant;

use crate::cover::characterize;
use crate::picture::{Picture as _, Width};
use anyhow::{Context, Result};
use moca_experiments::{JOINTS, TAXELS};
use moca_msgs::Parameters;
use moca_msgs::robot::{MOCA_MOUNT, PANDA, PAPER_COVER, Payload};
use moca_wbc::WholeBodyController;
use serde::Serialize;
use std::fmt::Write as _;
use std::path::PathBuf;

/// Arguments of `moca-lab precision`.
#[derive(clap::Args)]
pub(crate) struct Arguments {
    /// Prints one JSON object.
    #[arg(long)]
    json: bool,
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
#[expect(clippy::print_stdout, reason = "the command's output")]
pub(crate) fn run(arguments: &Arguments) -> Result<()> {
    let report = measure(arguments.quick)?;
    let json = serde_json::to_string_pretty(&report)?;
    if let Some(folder) = &arguments.out {
        std::fs::create_dir_all(folder).with_context(|| format!("cannot create {}", folder.display()))?;
        diagrams::draw(&report, arguments.width).write(&folder.join("precision"))?;
        std::fs::write(folder.join("precision.json"), &json)?;
    }
    println!("{}", if arguments.json { json } else { text(&report) });
    Ok(())
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

fn controller<T: moca_wbc::Scalar>() -> Result<WholeBodyController<JOINTS, TAXELS, T>> {
    Ok(WholeBodyController::new(&PANDA, &MOCA_MOUNT, &Payload::NONE, &PAPER_COVER, &Parameters::PAPER)?)
}

fn text(report: &Report) -> String {
    let mut out = String::new();
    // Writing to a string cannot fail.
    let _ = write_text(&mut out, report);
    out
}

fn write_text(out: &mut String, report: &Report) -> std::fmt::Result {
    for scene in &report.scenes {
        let own =
            scene.peak_self_consistency.map_or(String::new(), |p| format!(", of the peak force {p:.1e}"));
        let (name, reference) = (scene.scene, &scene.reference);
        writeln!(out, "{name} against {reference}: self-consistency {:.1e}{own}", scene.self_consistency)?;
        for p in &scene.points {
            write!(out, "  {:13} {:5} ms  ", p.integrator, p.step_ms)?;
            match &p.failed {
                Some(why) => writeln!(out, "FAILED: {why}")?,
                None => writeln!(
                    out,
                    "{:9.4} s/s  state {:.1e}  peak {}",
                    p.cpu_s_per_s,
                    p.state_error,
                    p.peak_error.map_or("-".into(), |e| format!("{e:.1e}"))
                )?,
            }
        }
        writeln!(out, "  {}", scene.recommendation)?;
    }
    writeln!(
        out,
        "control rate, T6 20 N, ideal sensor, physics at 0.25 ms: flange, base against 4 kHz, CPU"
    )?;
    for p in &report.control_rate {
        writeln!(
            out,
            "  {:5} Hz  {:6.2} mm  {:7.3} mm  {:.4} s/s",
            p.rate_hz, p.flange_max_mm, p.base_error_mm, p.cpu_s_per_s
        )?;
    }
    writeln!(out, "  {}", report.control_rate_recommendation)?;
    writeln!(
        out,
        "admittance, M/D = 10 ms, from samples up to the present: largest error along the way of base, yaw, flange under a smooth force | a held reading, CPU"
    )?;
    for p in &report.admittance {
        let failed = if p.failed { "  FAILED" } else { "" };
        writeln!(
            out,
            "  {:32} {:5} ms  {:.1e} m {:.1e} rad {:.1e} m | {:.1e} m {:.1e} rad {:.1e} m  {:.1e} s/s{failed}",
            p.method,
            p.step_ms,
            p.smooth.base_m,
            p.smooth.yaw_rad,
            p.smooth.flange_m,
            p.held.base_m,
            p.held.yaw_rad,
            p.held.flange_m,
            p.cpu_s_per_s
        )?;
    }
    writeln!(out, "  {}", report.admittance_recommendation)?;
    writeln!(out, "calibration models on PU LD30, trials not seen: error, one evaluation")?;
    for model in &report.calibration {
        writeln!(out, "  {:22} {:6.2} N  {:6.1} ns", model.model, model.rmse_n, model.cost_ns)?;
    }
    write!(
        out,
        "f32 control: torque off by {:.1e} N.m at most; a tick takes {:.0} ns in f64, {:.0} ns in f32",
        report.f32_torque_error_nm, report.f64_tick_ns, report.f32_tick_ns
    )
}
