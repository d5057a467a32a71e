//! `moca-lab experiment`: the paper's experiments on the daemon's own loop, in lock-step: deterministic and faster than
//! real time.

pub(crate) mod collision;
pub(crate) mod figure;
#[cfg(test)]
mod golden;
pub(crate) mod push;
pub(crate) mod pushes;
pub(crate) mod report;
#[cfg(test)]
mod tests;

use crate::rig::settings::{self, Settings};
use crate::rig::{closed_loop, keys, measure};
use anyhow::{Result, ensure};
use moca_msgs::Law;
use serde::Serialize;
use std::path::PathBuf;
use std::time::Instant;

/// Arguments of `moca-lab experiment`.
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

/// What every experiment takes.
#[derive(clap::Args, Clone)]
pub(crate) struct Common {
    /// Sets a parameter, e.g. sensor=ideal; may be repeated. A wrong key lists all.
    #[arg(long = "set", value_name = "KEY=VALUE")]
    set: Vec<String>,
    /// Prints one JSON object.
    #[arg(long)]
    json: bool,
    /// Writes figure (SVG, PNG), trace (CSV) and report (JSON) into this folder.
    #[arg(long, value_name = "DIR")]
    out: Option<PathBuf>,
}

fn parse_taxel(text: &str) -> Result<usize, String> {
    keys::taxel(text).map_err(|error| format!("{error:#}"))
}

impl Common {
    fn settings(&self, law: Law, adjust: impl Fn(&mut Settings)) -> Result<Settings> {
        let mut settings = Settings::paper(law);
        adjust(&mut settings);
        for assignment in &self.set {
            settings.set(assignment)?;
        }
        settings.check()?;
        Ok(settings)
    }
}

/// What every experiment says of its run.
#[derive(Clone, Debug, Serialize)]
pub(crate) struct RunInfo {
    experiment: &'static str,
    sensor: &'static str,
    foam: &'static str,
    /// What integrated the scene, and why.
    engine: &'static str,
    /// Frames of the stock board, Hz; null without one.
    frame_rate_hz: Option<f64>,
    /// Why the robot stopped; null if it did not.
    stopped: Option<String>,
    /// Simulated time, starting included, s.
    sim_s: f64,
    /// Wall-clock time of the run, s.
    wall_s: f64,
}

impl RunInfo {
    fn new(experiment: &'static str, settings: &Settings, rig: &closed_loop::Rig, started: Instant) -> Self {
        Self {
            experiment,
            sensor: settings.sensor.name(),
            foam: settings.foam.material.name,
            engine: settings.engine.reason(),
            frame_rate_hz: (settings.sensor == settings::Sensor::Stock).then_some(rig.frame_rate_hz),
            stopped: rig.stopped.clone(),
            sim_s: rig.sim_s,
            wall_s: started.elapsed().as_secs_f64(),
        }
    }
}

#[derive(Debug, Serialize)]
struct PushReport {
    #[serde(flatten)]
    info: RunInfo,
    taxels: Vec<String>,
    newton: f64,
    /// Of the push, the rest after it left out.
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
                figure::draw(
                    &settings.free_scene(),
                    &rows,
                    &pushes::middles(&rows, 1, 0.0),
                    pushes::panels_b1(&rows),
                )
            };
            finish(common, "push", &report, &rows, draw, || push_text(&report))
        }
        Experiment::B1(common) => {
            let settings = common.settings(Law::Impedance, |_| ())?;
            let run = pushes::b1(&settings)?;
            let draw = || {
                figure::draw(&settings.free_scene(), &run.rows, &run.moments, pushes::panels_b1(&run.rows))
            };
            finish(common, "b1", &run.report, &run.rows, draw, || run.report.text())
        }
        Experiment::B2(common) => {
            let settings = common.settings(Law::FollowMe, |_| ())?;
            let run = pushes::b2(&settings)?;
            let draw = || {
                figure::draw(&settings.free_scene(), &run.rows, &run.moments, pushes::panels_b2(&run.rows))
            };
            finish(common, "b2", &run.report, &run.rows, draw, || run.report.text())
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
            let report = CollisionReport { own: &run.report, beside: &beside };
            let draw = || {
                figure::draw(&settings.free_scene(), &run.rows, &run.moments, collision::panels(&run.rows))
            };
            let text = || format!("{}\nbeside it {}", run.report.text(), beside.text());
            finish(common, "collision", &report, &run.rows, draw, text)
        }
    }
}

/// A collision, and the same one felt in the other way.
#[derive(Debug, Serialize)]
struct CollisionReport<'a> {
    #[serde(flatten)]
    own: &'a collision::Report,
    beside: &'a collision::Report,
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
    draw: impl Fn() -> moca_figures::Drawing,
    text: impl Fn() -> String,
) -> Result<()> {
    if let Some(folder) = &common.out {
        ensure!(!rows.is_empty(), "nothing was recorded");
        figure::write(folder, name, &draw(), rows, report)?;
    }
    print(common.json, report, text)
}

#[expect(clippy::print_stdout, reason = "the command's output")]
fn print(json: bool, report: &impl Serialize, text: impl Fn() -> String) -> Result<()> {
    if json {
        println!("{}", serde_json::to_string_pretty(report)?);
    } else {
        println!("{}", text());
    }
    Ok(())
}

fn push_text(report: &PushReport) -> String {
    let head = head(&report.info);
    match &report.outcome {
        Some(outcome) => format!("{head}\n{}", outcome_text(outcome)),
        None => head,
    }
}

fn head(info: &RunInfo) -> String {
    let rate = info.frame_rate_hz.map_or(String::new(), |rate| format!(" at {rate:.1} frames/s"));
    let stopped = info.stopped.as_ref().map_or(String::new(), |why| format!("\n  STOPPED: {why}"));
    format!(
        "{}: sensor {}{rate}, foam {}, {:.1} s simulated in {:.2} s\n  on {}{stopped}",
        info.experiment, info.sensor, info.foam, info.sim_s, info.wall_s, info.engine
    )
}

fn outcome_text(outcome: &push::Outcome) -> String {
    let [x, y, yaw] = outcome.base_displacement;
    format!(
        "  {:24} base moved ({x:+.4} m, {y:+.4} m, {yaw:+.4} rad), flange off by {:.2} mm at most, {:.2} mm RMS\n  \
         {:24} wrench on the base {} true, {} sensed",
        outcome.name,
        outcome.flange_max_mm,
        outcome.flange_rms_mm,
        "",
        wrench_text(&outcome.wrench_true),
        wrench_text(&outcome.wrench_sensed)
    )
}

fn wrench_text([fx, fy, mz]: &[f64; 3]) -> String {
    format!("({fx:8.3} N, {fy:8.3} N, {mz:8.3} N·m)")
}
