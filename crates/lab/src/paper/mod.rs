//! `moca-lab experiment`: the paper's experiments on the daemon's own loop, in lock-step: deterministic and faster than
//! real time.

mod collision_figure;
pub(crate) mod figure;
pub(crate) mod flange_wrench;
#[cfg(test)]
mod golden;
#[cfg(test)]
mod kept_pushes;
pub(crate) mod late_bases;
mod opposite_hands;
pub(crate) mod push;
pub(crate) mod pushes;
pub(crate) mod real_arm;
pub(crate) mod report;
mod robot_picture;
#[cfg(test)]
mod tests;

use self::figure::{Figure, Layout, Trace};
use crate::study::Answer;
use anyhow::{Result, ensure};
use moca_experiments::run_info::{self, RunInfo};
use moca_experiments::settings::{self, Settings};
use moca_experiments::{closed_loop, collision, keys, measure};
use moca_msgs::Law;
use serde::Serialize;
use std::path::PathBuf;
use std::time::Instant;

/// The paper's experiments, deterministic and faster than real time.
#[derive(clap::Args)]
pub(crate) struct Arguments {
    #[command(subcommand)]
    experiment: Experiment,
}

#[derive(clap::Subcommand)]
enum Experiment {
    /// Presses taxels for 3 s with ramps of 0.3 s under expanded impedance.
    Push {
        /// Taxel, T1 to T11; may be repeated.
        #[arg(long = "taxel", required = true, value_parser = parse_taxel)]
        taxels: Vec<usize>,
        /// Force on each, N.
        #[arg(long, default_value_t = 20.0)]
        newton: f64,
        #[command(flatten)]
        common: Common,
    },
    /// Section IV-B, Fig. 5: expanded impedance, the paper's four pushes and the mirror image of the fourth.
    B1(Common),
    /// Section IV-B, Fig. 6: expanded follow-me, the paper's four pushes.
    B2(Common),
    /// Section IV-C, Fig. 7: the flange is led sideways until the base meets a person.
    Collision(Common),
}

/// Arguments of every experiment.
#[derive(clap::Args, Clone)]
pub(crate) struct Common {
    /// Sets a parameter, e.g. sensor=ideal; may be repeated. A wrong key lists all.
    #[arg(long = "set", value_name = "KEY=VALUE")]
    set: Vec<String>,
    /// Error of a tick, over 25 N and 15 mm, for which physics steps are chosen, e.g. 1e-3: the same as --set accuracy=…
    #[arg(long)]
    accuracy: Option<f64>,
    #[command(flatten)]
    answer: Answer,
    /// Writes figure (SVG, PDF, PNG), trace (CSV) and report (JSON) into this folder.
    #[arg(long, value_name = "DIR")]
    out: Option<PathBuf>,
    #[command(flatten)]
    layout: Layout,
}

fn parse_taxel(text: &str) -> Result<usize, String> {
    keys::taxel(text).map_err(|error| format!("{error:#}"))
}

impl Common {
    fn settings(&self, law: Law, adjust: impl Fn(&mut Settings)) -> Result<Settings> {
        let mut settings = Settings::paper(law);
        adjust(&mut settings);
        settings.set_all(&self.set)?;
        settings.set_all(self.accuracy.map(|accuracy| format!("accuracy={accuracy}")))?;
        settings.check()?;
        Ok(settings)
    }
}

#[derive(Debug, Serialize)]
struct PushReport {
    #[serde(flatten)]
    info: RunInfo,
    taxels: Vec<String>,
    newton: f64,
    /// Measures of the push, without the rest after it.
    #[serde(flatten)]
    measures: measure::Measures,
    outcome: Option<push::Outcome>,
}

/// Runs one experiment, prints what it shows, and writes its figure if a folder is given.
pub(crate) fn run(arguments: &Arguments) -> Result<()> {
    match &arguments.experiment {
        Experiment::Push { taxels, newton, common } => {
            let settings = common.settings(Law::Impedance, |_| ())?;
            let (report, rows) = push_report(taxels, *newton, &settings)?;
            let draw = || {
                let trace = Trace { rows: &rows, others: &[] };
                let stopped = report.info.stopped.as_deref();
                let (scene, moments) = (&settings.free_scene(), &pushes::middles(&rows, 1, 0.0)[..]);
                let panels = pushes::panels_b1(trace);
                Figure { scene, trace, moments, panels, another: "", stopped }.draw(&common.layout)
            };
            finish(common, "push", &report, &rows, draw, || push_text(&report))
        }
        Experiment::B1(common) => {
            let settings = common.settings(Law::Impedance, |_| ())?;
            let run = pushes::b1(&settings)?;
            let draw = || pushes::figure_5(&settings, &run, &common.layout);
            finish(common, "b1", &run.report, &run.rows, draw, || run.report.text())
        }
        Experiment::B2(common) => {
            let settings = common.settings(Law::FollowMe, |_| ())?;
            let run = pushes::b2(&settings)?;
            // The paper's base follows what its arm estimates; the true wrench beside it shows what that costs.
            let mut other = settings.clone();
            let is_true = settings.flange_source() == "true";
            other.set(if is_true { "flange=observed" } else { "flange=true" })?;
            let beside = pushes::b2(&other)?.report;
            let report = Beside { own: &run.report, beside: &beside };
            let draw = || pushes::figure_6(&settings, &run, &common.layout);
            let text = || format!("{}\nbeside it {}", run.report.text(), beside.text());
            finish(common, "b2", &report, &run.rows, draw, text)
        }
        Experiment::Collision(common) => {
            let settings = common.settings(Law::Impedance, collision::defaults)?;
            let run = collision::run(&settings)?;
            // Each experiment is shown with the true force and with a stock board's bytes: one without the other misleads.
            let sensor = match settings.sensor {
                settings::Sensor::Stock => settings::Sensor::Ideal,
                settings::Sensor::Ideal | settings::Sensor::Off => settings::Sensor::Stock,
            };
            let beside = collision::run(&Settings { sensor, ..settings.clone() })?.report;
            let report = Beside { own: &run.report, beside: &beside };
            let draw = || {
                let (moments, scene) = (collision_figure::moments(&run.rows), settings.free_scene());
                collision_figure::figure(&run, &moments, &scene).draw(&common.layout)
            };
            let text = || format!("{}\nbeside it {}", run.report.text(), beside.text());
            finish(common, "collision", &report, &run.rows, draw, text)
        }
    }
}

/// An experiment, and the same one felt in the other way.
#[derive(Debug, Serialize)]
struct Beside<'a, T: Serialize> {
    #[serde(flatten)]
    own: &'a T,
    beside: &'a T,
}

fn push_report(
    taxels: &[usize],
    newton: f64,
    settings: &Settings,
) -> Result<(PushReport, Vec<closed_loop::Row>)> {
    ensure!((0.0..=200.0).contains(&newton), "--newton {newton} N is outside 0 to 200 N");
    let started = Instant::now();
    let mut rig = closed_loop::Rig::start(settings, &settings.free_scene())?;
    let outcome = push::run(&mut rig, settings, &[push::single(taxels, newton)])?.pop();
    let period_s = 1.0 / f64::from(settings.config.control_loop.rate_hz);
    let pushed = rig.rows.partition_point(|row| row.t_s <= settings.push_s + 0.5 * period_s);
    let report = PushReport {
        info: RunInfo::new("push", settings, &rig, started),
        taxels: taxels.iter().map(|taxel| format!("T{}", taxel + 1)).collect(),
        newton,
        measures: measure::Measures::of(&rig.rows[..pushed], period_s),
        outcome,
    };
    Ok((report, rig.rows))
}

fn finish(
    common: &Common,
    name: &str,
    report: &impl Serialize,
    rows: &[closed_loop::Row],
    draw: impl Fn() -> Result<moca_figures::Drawing>,
    text: impl Fn() -> String,
) -> Result<()> {
    if let Some(folder) = &common.out {
        ensure!(!rows.is_empty(), "nothing was recorded");
        figure::write(folder, name, &draw()?, rows, report)?;
    }
    common.answer.print(report, || Ok(text()))
}

fn push_text(report: &PushReport) -> String {
    let head = report.info.head();
    match &report.outcome {
        Some(outcome) => format!("{head}\n{}", outcome_text(outcome)),
        None => head,
    }
}

fn outcome_text(outcome: &push::Outcome) -> String {
    let [x, y, yaw] = outcome.base_displacement;
    format!(
        "  {:24} base moved ({x:+.4} m, {y:+.4} m, {yaw:+.4} rad), flange off by {:.2} mm at most, {:.2} mm RMS\n  \
         {:24} wrench on the base {} true, {} sensed; force at the flange {} true, {} felt",
        outcome.name,
        outcome.flange_max_mm,
        outcome.flange_rms_mm,
        "",
        run_info::wrench_text(&outcome.wrench_true),
        run_info::wrench_text(&outcome.wrench_sensed),
        force_text(&outcome.flange_true_n),
        force_text(&outcome.flange_felt_n),
    )
}

fn force_text([x, y, z]: &[f64; 3]) -> String {
    format!("({x:.2}, {y:.2}, {z:.2}) N")
}
