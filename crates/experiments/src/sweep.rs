//! Many collisions over a grid or a random sample of their settings, one CSV row each.
//!
//! The list of runs follows from the file alone, so every shard knows all of them and takes a contiguous part: the
//! rows of any number of shards, joined in order, are those of one machine. No row holds a time, so no row depends on
//! the machine either.

use crate::campaign::{Column, Table, cells, names};
use crate::collision::{self, Report};
use crate::settings::{Sensor, Settings};
use anyhow::{Result, ensure};
use moca_msgs::Law;
use serde::Deserialize;
use std::collections::BTreeMap;
use std::fmt::Write as _;

/// Most runs of one file.
const RUNS_MAX: usize = 10_000_000;
/// Columns after the run's number and its settings.
const RESULTS: &[Column<Report>] = &[
    ("peak_force_n", |report| format!("{:.6}", report.measures.peak_force_n)),
    ("first_touch_n", |report| format!("{:.6}", report.measures.first_touch_n)),
    ("impact_n", |report| format!("{:.6}", report.measures.impact_n)),
    ("first_peak_n", |report| format!("{:.6}", report.measures.peaks_n.first().copied().unwrap_or(0.0))),
    ("contact_s", |report| report.measures.contact_s.map_or(String::new(), |t| format!("{t:.3}"))),
    ("contact_time_s", |report| format!("{:.3}", report.measures.contact_time_s)),
    ("approach_m_s", |report| format!("{:.6}", report.approach_m_s)),
    ("flange_rms_mm", |report| format!("{:.6}", report.measures.flange_rms_mm)),
    ("flange_max_mm", |report| format!("{:.6}", report.measures.flange_max_mm)),
    ("base_x_m", |report| format!("{:.6}", report.measures.base_displacement[0])),
    ("base_y_m", |report| format!("{:.6}", report.measures.base_displacement[1])),
    ("base_yaw_rad", |report| format!("{:.6}", report.measures.base_displacement[2])),
    ("yaw_in_contact_deg", |report| format!("{:.4}", report.measures.yaw_in_contact_deg)),
    ("stopped", |report| {
        report.stopped().map_or("", |why| why.split(':').next().unwrap_or("stopped")).into()
    }),
];

/// A sweep file.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct Plan {
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

/// A checked plan: any machine can run any of its runs, and gets the same row.
#[derive(Debug)]
pub struct Sweep {
    plan: Plan,
    /// Varied keys, in the order of their columns.
    columns: Vec<String>,
}

impl Sweep {
    /// Reads a plan such as `scenes/sweep.toml`. `accuracy` is the error of a tick, over 25 N and 15 mm, for which
    /// physics steps are chosen in every run; `None` leaves it to the plan.
    ///
    /// # Errors
    /// Text that is no plan, an unknown key, a value outside its range, more than ten million runs.
    pub fn parse(text: &str, accuracy: Option<f64>) -> Result<Self> {
        Self::new(toml::from_str(text)?, accuracy)
    }

    /// Reads a plan that is written as JSON, with the same keys.
    ///
    /// # Errors
    /// As for [`Sweep::parse`].
    pub fn parse_json(text: &str) -> Result<Self> {
        Self::new(serde_json::from_str(text)?, None)
    }

    fn new(mut plan: Plan, accuracy: Option<f64>) -> Result<Self> {
        if let Some(accuracy) = accuracy {
            plan.set.insert("accuracy".into(), accuracy.into());
        }
        plan.check()?;
        let columns = plan.columns();
        Ok(Self { plan, columns })
    }

    /// Varied keys, in the order of their columns.
    pub fn varied(&self) -> &[String] {
        &self.columns
    }

    /// Values of run `id`, one for each varied key.
    pub fn values(&self, id: usize) -> Vec<String> {
        self.plan.values(id)
    }

    /// Engine of a run with these values of the varied keys, and the reason for it.
    ///
    /// # Errors
    /// As for [`Sweep::settings`].
    pub fn engine(&self, values: &[String]) -> Result<String> {
        let settings = self.settings(values)?;
        let scene = settings.collision_scene()?;
        Ok(match scene.needs_mujoco() {
            _ if self.plan.names_engine() => format!("{}; the plan names it", settings.engine.reason()),
            Some(what) => format!("MuJoCo: the scene has {what}"),
            None => settings.engine.reason().to_owned(),
        })
    }

    /// Settings of a run with these values of the varied keys. The scene decides the engine unless the plan names one.
    ///
    /// # Errors
    /// A value outside its range.
    pub fn settings(&self, values: &[String]) -> Result<Settings> {
        self.plan.settings(&self.columns, values)
    }
}

impl Table for Sweep {
    fn rows(&self) -> usize {
        self.plan.runs()
    }

    fn header(&self) -> String {
        let varied: String = self.columns.iter().map(|key| format!("{key},")).collect();
        format!("run,{varied}{}", names(RESULTS))
    }

    fn words(&self) -> Vec<&str> {
        let word = |values: &[toml::Value]| values.iter().any(|value| plain(value).parse::<f64>().is_err());
        let keys = self.plan.grid.iter().filter(|(_, values)| word(values)).map(|(key, _)| key.as_str());
        keys.chain(["stopped"]).collect()
    }

    fn row(&self, id: usize) -> Result<String> {
        let values = self.values(id);
        let report = collision::single(&self.settings(&values)?)?;
        let mut line = id.to_string();
        for value in values.iter().map(|value| quoted(value)).chain([cells(RESULTS, &report)]) {
            // Writing to a string cannot fail.
            let _ = write!(line, ",{value}");
        }
        Ok(line)
    }
}

fn quoted(value: &str) -> String {
    if value.contains(',') { format!("\"{value}\"") } else { value.to_owned() }
}

impl Plan {
    fn columns(&self) -> Vec<String> {
        let random = self.random.iter().flat_map(|r| r.uniform.keys().chain(r.log.keys()));
        self.grid.keys().chain(random).cloned().collect()
    }

    fn points(&self) -> usize {
        self.grid.values().fold(1usize, |product, values| product.saturating_mul(values.len()))
    }

    fn runs(&self) -> usize {
        self.points().saturating_mul(self.random.as_ref().map_or(1, |r| r.samples))
    }

    /// Values of run `id`, one for each column.
    fn values(&self, id: usize) -> Vec<String> {
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

    fn settings(&self, columns: &[String], values: &[String]) -> Result<Settings> {
        let mut settings = Settings::paper(Law::Impedance);
        collision::defaults(&mut settings);
        settings.sensor = Sensor::Ideal;
        for (key, value) in &self.set {
            settings.set(&format!("{key}={}", plain(value)))?;
        }
        for (key, value) in columns.iter().zip(values) {
            settings.set(&format!("{key}={value}"))?;
        }
        if !self.names_engine() {
            settings.engine = settings.collision_scene()?.needed_engine();
        }
        settings.check()?;
        Ok(settings)
    }

    fn names_engine(&self) -> bool {
        self.set.contains_key("engine") || self.grid.contains_key("engine")
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

#[cfg(test)]
mod tests {
    use super::Sweep;
    use moca_sim::Engine;

    #[test]
    fn wrong_plan_is_refused_before_anything_runs() {
        for (text, part) in [
            ("[grid]\nmass = [1]\n", "unknown key mass"),
            ("[grid]\nd_v = []\n", "no values"),
            ("[grid]\nd_v = [-1]\n", "outside 0"),
            ("[random]\nsamples = 0\nseed = 1\n", "at least 1"),
            ("[grids]\n", "unknown field"),
        ] {
            let error = format!("{:#}", Sweep::parse(text, None).unwrap_err());
            assert!(error.contains(part), "{text}: {error}");
        }
    }

    #[test]
    fn scene_decides_the_engine_unless_the_plan_names_one() {
        for (text, engine, why) in [
            ("", Engine::Analytic, "analytic: base, arm and people move"),
            ("[set]\nintegrator = \"rk4\"\n", Engine::MuJoCo, "MuJoCo: the scene has an integrator other"),
            ("[set]\nengine = \"mujoco\"\n", Engine::MuJoCo, "whatever a scene holds; the plan names it"),
            ("[grid]\nengine = [\"analytic\"]\n", Engine::Analytic, "rigid bodies meet; the plan names it"),
        ] {
            let sweep = Sweep::parse(text, None).unwrap();
            let values = sweep.values(0);
            assert_eq!(sweep.settings(&values).unwrap().engine, engine, "{text}");
            let said = sweep.engine(&values).unwrap();
            assert!(said.contains(why), "{text}: {said}");
        }
    }
}
