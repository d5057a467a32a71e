//! `moca-lab sweep FILE`: many runs of one experiment over a grid or a random sample of its settings, one CSV row each.
//!
//! The list of runs follows from the file alone, so every shard knows all of them and takes a contiguous part: the
//! rows of any number of shards, joined in order, are those of one machine. No row holds a time, so no row depends on
//! the machine either.

use crate::numerics::economy;
use crate::paper::collision::{self, Report};
use crate::rig::campaign::{self, Campaign};
use crate::rig::settings::Settings;
use anyhow::{Context, Result, ensure};
use moca_msgs::Law;
use moca_sim::{Engine, Scene};
use serde::Deserialize;
use std::collections::BTreeMap;
use std::fmt::Write as _;
use std::path::PathBuf;

/// Most runs of one file.
const RUNS_MAX: usize = 10_000_000;
/// Columns after the run's number and its settings.
const RESULTS: &str = "peak_force_n,first_touch_n,impact_n,first_peak_n,contact_s,contact_time_s,approach_m_s,flange_rms_mm,flange_max_mm,\
                       base_x_m,base_y_m,base_yaw_rad,yaw_in_contact_deg,stopped";

/// Arguments of `moca-lab sweep`.
#[derive(clap::Args)]
pub(crate) struct Arguments {
    /// Plan of the sweep: see scenes/sweep.toml.
    file: PathBuf,
    /// CSV file; rows that are already in it are kept and not run again.
    #[arg(long, value_name = "CSV")]
    out: PathBuf,
    /// Error of a tick, over 25 N and 15 mm, for which physics steps are chosen in every run, e.g. 1e-3.
    #[arg(long)]
    accuracy: Option<f64>,
    /// Part of the runs, e.g. 2/8 for the second of eight; joined in order the parts are the whole.
    #[arg(long, value_name = "I/N", value_parser = campaign::shard, default_value = "1/1")]
    shard: (usize, usize),
}

/// A sweep file.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Plan {
    /// Settings of every run.
    #[serde(default)]
    set: BTreeMap<String, toml::Value>,
    /// Key → values: every combination is run, the last key fastest.
    #[serde(default)]
    grid: BTreeMap<String, Vec<toml::Value>>,
    /// A random sample for every point of the grid.
    random: Option<Random>,
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct Random {
    samples: usize,
    seed: u64,
    /// Key → [from, to], uniform.
    #[serde(default)]
    uniform: BTreeMap<String, [f64; 2]>,
    /// Key → [from, to], uniform in the logarithm.
    #[serde(default)]
    log: BTreeMap<String, [f64; 2]>,
}

impl Plan {
    /// Names of the varied keys, in the order of their columns.
    pub(super) fn columns(&self) -> Vec<String> {
        let random = self.random.iter().flat_map(|r| r.uniform.keys().chain(r.log.keys()));
        self.grid.keys().chain(random).cloned().collect()
    }

    fn points(&self) -> usize {
        self.grid.values().fold(1usize, |product, values| product.saturating_mul(values.len()))
    }

    pub(super) fn runs(&self) -> usize {
        self.points().saturating_mul(self.random.as_ref().map_or(1, |r| r.samples))
    }

    /// Values of run `id`, one for each column.
    pub(super) fn values(&self, id: usize) -> Vec<String> {
        let samples = self.random.as_ref().map_or(1, |r| r.samples.max(1));
        let mut point = id / samples;
        let mut values = vec![String::new(); self.grid.len()];
        for (value, (_, allowed)) in values.iter_mut().zip(&self.grid).rev() {
            *value = plain(&allowed[point % allowed.len()]);
            point /= allowed.len();
        }
        if let Some(random) = &self.random {
            // A stream of its own for every run: no run depends on which others this machine makes.
            let mut draw =
                moca_sim::sensor::Noise::new(random.seed ^ (id as u64).wrapping_mul(0xd134_2543_de82_ef95));
            for [from, to] in random.uniform.values() {
                values.push((from + (to - from) * draw.uniform()).to_string());
            }
            for [from, to] in random.log.values() {
                values.push((from * (to / from).powf(draw.uniform())).to_string());
            }
        }
        values
    }

    pub(super) fn settings(&self, columns: &[String], values: &[String]) -> Result<Settings> {
        let mut settings = Settings::paper(Law::Impedance);
        collision::defaults(&mut settings);
        settings.sensor = crate::rig::settings::Sensor::Ideal;
        for (key, value) in &self.set {
            settings.set(&format!("{key}={}", plain(value)))?;
        }
        for (key, value) in columns.iter().zip(values) {
            settings.set(&format!("{key}={value}"))?;
        }
        settings.check()?;
        Ok(settings)
    }

    fn check(&self) -> Result<()> {
        for (key, values) in &self.grid {
            ensure!(!values.is_empty(), "[grid] {key} has no values");
        }
        if let Some(random) = &self.random {
            ensure!(random.samples > 0, "[random] samples must be at least 1");
            for (key, [from, to]) in random.log.iter() {
                ensure!(
                    *from > 0.0 && to > from,
                    "[random.log] {key} = [{from}, {to}] is not a range above 0"
                );
            }
        }
        ensure!(self.runs() <= RUNS_MAX, "{} runs are more than {RUNS_MAX}", self.runs());
        // A wrong key or value shows at the first run and not after hours.
        let columns = self.columns();
        for id in [0, self.runs() - 1] {
            self.settings(&columns, &self.values(id))?;
        }
        Ok(())
    }
}

fn plain(value: &toml::Value) -> String {
    match value {
        toml::Value::String(text) => text.clone(),
        toml::Value::Array(list) => list.iter().map(plain).collect::<Vec<_>>().join(","),
        other => other.to_string(),
    }
}

/// Runs what is missing of this shard.
#[expect(clippy::print_stdout, reason = "the command's output")]
pub(crate) fn run(arguments: &Arguments) -> Result<()> {
    let text = std::fs::read_to_string(&arguments.file)
        .with_context(|| format!("cannot read {}", arguments.file.display()))?;
    let mut plan: Plan = toml::from_str(&text).with_context(|| format!("{}", arguments.file.display()))?;
    if let Some(accuracy) = arguments.accuracy {
        plan.set.insert("accuracy".into(), accuracy.into());
    }
    plan.check().with_context(|| format!("{}", arguments.file.display()))?;
    let columns = plan.columns();
    let campaign =
        Campaign { out: &arguments.out, shard: arguments.shard, rows: plan.runs(), header: &header(&plan) };
    let ran = campaign.run(|id| row(&plan, &columns, id))?;
    println!("{ran}");
    println!(
        "{:.1} runs per second of CPU; for the same simulated time bare mj_step of the same scene would allow {:.1}, the \
         bare step of its engine {:.1}\n{}",
        ran.per_cpu_s(),
        bare_runs_per_cpu_s(&plan, Some(Engine::MuJoCo))?,
        bare_runs_per_cpu_s(&plan, None)?,
        plan.settings(&columns, &plan.values(0))?.engine.reason(),
    );
    Ok(())
}

fn header(plan: &Plan) -> String {
    let mut line = String::from("run");
    for column in plan.columns() {
        // Writing to a string cannot fail.
        let _ = write!(line, ",{column}");
    }
    format!("{line},{RESULTS}")
}

/// One run as a CSV row.
fn row(plan: &Plan, columns: &[String], id: usize) -> Result<String> {
    let values = plan.values(id);
    let settings = plan.settings(columns, &values)?;
    let report = collision::single(&settings)?;
    let values = values.iter().map(|v| if v.contains(',') { format!("\"{v}\"") } else { v.clone() });
    let mut line = id.to_string();
    for value in values.chain(std::iter::once(results(&report))) {
        let _ = write!(line, ",{value}");
    }
    Ok(line)
}

fn results(report: &Report) -> String {
    let [x, y, yaw] = report.measures.base_displacement;
    format!(
        "{:.6},{:.6},{:.6},{:.6},{},{:.3},{:.6},{:.6},{:.6},{x:.6},{y:.6},{yaw:.6},{:.4},{}",
        report.measures.peak_force_n,
        report.measures.first_touch_n,
        report.measures.impact_n,
        report.measures.peaks_n.first().copied().unwrap_or(0.0),
        report.measures.contact_s.map_or(String::new(), |t| format!("{t:.3}")),
        report.measures.contact_time_s,
        report.approach_m_s,
        report.measures.flange_rms_mm,
        report.measures.flange_max_mm,
        report.measures.yaw_in_contact_deg,
        report.stopped().map_or("", |why| why.split(':').next().unwrap_or("stopped")),
    )
}

/// Runs per second of CPU time if a run were nothing but steps of this engine, or of the plan's.
fn bare_runs_per_cpu_s(plan: &Plan, engine: Option<Engine>) -> Result<f64> {
    let settings = plan.settings(&plan.columns(), &plan.values(0))?;
    let scene = settings.collision_scene()?;
    let scene = Scene { engine: engine.unwrap_or(scene.engine), ..scene };
    let step_s = 1e-6 * economy::bare_step_us(&scene)?;
    Ok(settings.step_ms / (1e3 * settings.duration_s * step_s))
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::path::Path;

    const PLAN: &str = "[set]\nduration = 0.6\n\"person.gap\" = 0.001\nspeed = 0.25\n[grid]\nd_v = [40, 80]\n\
                        m_v = [2, 4]\n[random]\nsamples = 2\nseed = 5\n[random.log]\n\"person.mass\" = [10, 100]\n";

    fn sweep(folder: &Path, name: &str, shard: (usize, usize)) -> String {
        let file = folder.join("plan.toml");
        std::fs::write(&file, PLAN).unwrap();
        let out = folder.join(name);
        run(&Arguments { file, out: out.clone(), accuracy: None, shard }).unwrap();
        std::fs::read_to_string(out).unwrap()
    }

    #[test]
    fn shards_joined_are_the_whole_and_an_interrupted_run_goes_on() {
        let folder = std::env::temp_dir().join(format!("moca-sweep-{}", std::process::id()));
        std::fs::create_dir_all(&folder).unwrap();
        let whole = sweep(&folder, "whole.csv", (1, 1));
        assert_eq!(whole.lines().count(), 9);
        let joined: String = (1..=3).map(|i| sweep(&folder, &format!("{i}.csv"), (i, 3))).collect();
        assert_eq!(joined, whole);
        // Cut within the fifth row, as a killed process leaves it.
        let cut = whole.match_indices('\n').nth(4).unwrap().0 + 12;
        std::fs::write(folder.join("cut.csv"), &whole[..cut]).unwrap();
        assert_eq!(sweep(&folder, "cut.csv", (1, 1)), whole);
        std::fs::remove_dir_all(&folder).unwrap();
    }

    #[test]
    fn a_wrong_plan_is_refused_before_anything_runs() {
        for (text, part) in [
            ("[grid]\nmass = [1]\n", "unknown key mass"),
            ("[grid]\nd_v = []\n", "no values"),
            ("[grid]\nd_v = [-1]\n", "outside 0"),
            ("[random]\nsamples = 0\nseed = 1\n", "at least 1"),
        ] {
            let plan: Plan = toml::from_str(text).unwrap();
            let error = format!("{:#}", plan.check().unwrap_err());
            assert!(error.contains(part), "{text}: {error}");
        }
        assert!(toml::from_str::<Plan>("[grids]\n").is_err());
    }
}
