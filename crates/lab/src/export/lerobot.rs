//! A LeRobot data set, version 3.0: frames in Parquet, what they are in `meta/`.
//! Format: <https://huggingface.co/docs/lerobot/lerobot-dataset-v3>.

use crate::export::frames::{Frame, episodes, frames};
use crate::export::parquet_file::{Column, Values, write};
use crate::export::quantities::{
    Parts, Quantity, action, base, forces, join_quaternions, joint_state, state, torque, valid,
};
use anyhow::{Context, Result, ensure};
use moca_daemon::cli::progress::Progress;
use moca_msgs::Sample;
use serde_json::{Map, Value, json};
use std::path::{Path, PathBuf};

/// Arguments of `moca-lab export lerobot`.
#[derive(clap::Args)]
pub(crate) struct Arguments {
    /// Logs of the same robot.
    #[arg(required = true)]
    logs: Vec<PathBuf>,
    /// Folder of the data set; it must not exist.
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
    /// Frames each second; a log has 50.
    #[arg(long, default_value_t = 50, value_parser = clap::value_parser!(u32).range(1..=50))]
    fps: u32,
    /// Task of the robot in words, for policies that read them.
    #[arg(long, default_value = "give way to touch")]
    task: String,
}

const DATA: &str = "data/chunk-000/file-000.parquet";
const EPISODES: &str = "meta/episodes/chunk-000/file-000.parquet";
/// Features that are numbers of a sample.
const OF_SAMPLES: [(&str, fn(Parts) -> Vec<Quantity>); 5] = [
    ("observation.state", state),
    ("observation.base", |_| base()),
    ("observation.joints", joint_state),
    ("observation.torque", torque),
    ("action", action),
];
/// Quantiles that LeRobot's statistics have.
const QUANTILES: [(&str, f64); 5] = [("q01", 0.01), ("q10", 0.1), ("q50", 0.5), ("q90", 0.9), ("q99", 0.99)];

/// Writes the data set and says what is in it.
pub(super) fn run(arguments: &Arguments) -> Result<String> {
    let Arguments { logs, out, fps, task } = arguments;
    ensure!(!out.exists(), "{} exists", out.display());
    let mut set: Option<Set> = None;
    let mut progress = Progress::new("export");
    for (number, log) in logs.iter().enumerate() {
        let mut run = super::read(log)?;
        let parts = Parts::of(&run.description, &run.samples);
        let set = set.get_or_insert_with(|| Set::new(*fps, parts, &run.description.arm_name));
        ensure!(
            set.parts == parts,
            "{}: {} joints and {} taxels, the logs before have {} and {}",
            log.display(),
            parts.joints,
            parts.taxels,
            set.parts.joints,
            set.parts.taxels
        );
        join_quaternions(&mut run.samples);
        let before = set.lengths.len();
        // A robot that waits or brakes does not do the task, and what it was told before it was armed is nothing.
        let whole: Vec<Quantity> = OF_SAMPLES.iter().flat_map(|(_, of)| of(parts)).collect();
        let learned = |sample: &Sample| sample.mode.moves() && whole.iter().all(|q| q.of(sample).is_finite());
        episodes(&run.samples, learned).for_each(|stretch| set.add(&frames(stretch, *fps)));
        ensure!(set.lengths.len() > before, "{}: no law was in control", log.display());
        progress.count(number + 1, logs.len());
    }
    progress.end();
    let set = set.context("no logs")?;
    set.write(out, task).with_context(|| format!("cannot write {}", out.display()))?;
    let frames = set.index();
    Ok(format!("{}: {} episodes, {frames} frames at {fps} Hz", out.display(), set.lengths.len()))
}

/// Name, type and shape of a column.
struct Feature {
    column: Column,
    names: Vec<String>,
}

impl Feature {
    fn new(name: &str, names: Vec<String>, values: Values) -> Self {
        // A list of one is a number there.
        let column = if names.len() > 1 {
            Column::lists(name, names.len(), values)
        } else {
            Column::new(name, values)
        };
        Self { column, names }
    }

    fn width(&self) -> usize {
        self.column.width.unwrap_or(1)
    }

    fn dtype(&self) -> &'static str {
        match self.column.values {
            Values::Singles(_) => "float32",
            Values::Doubles(_) => "float64",
            Values::Integers(_) => "int64",
            Values::Flags(_) => "bool",
            Values::Texts(_) => "string",
        }
    }

    fn json(&self) -> Value {
        let names = if self.names.len() > 1 { json!(self.names) } else { Value::Null };
        json!({"dtype": self.dtype(), "shape": [self.width()], "names": names})
    }

    /// Row by row, as numbers.
    fn value(&self, row: usize, element: usize) -> f64 {
        let i = row * self.width() + element;
        match &self.column.values {
            Values::Singles(v) => v[i].into(),
            Values::Doubles(v) => v[i],
            #[expect(clippy::cast_precision_loss, reason = "counts of frames")]
            Values::Integers(v) => v[i] as f64,
            Values::Flags(v) => u8::from(v[i]).into(),
            Values::Texts(_) => f64::NAN,
        }
    }

    /// Each statistic of some rows, element by element.
    fn statistics(&self, rows: std::ops::Range<usize>) -> Vec<(&'static str, Vec<f64>)> {
        let mut all: Vec<(&'static str, Vec<f64>)> = ["min", "max", "mean", "std"]
            .into_iter()
            .chain(QUANTILES.map(|(name, _)| name))
            .map(|n| (n, vec![]))
            .collect();
        for element in 0..self.width() {
            let mut values: Vec<f64> = rows.clone().map(|row| self.value(row, element)).collect();
            values.sort_by(f64::total_cmp);
            #[expect(clippy::cast_precision_loss, reason = "counts of frames")]
            let count = values.len().max(1) as f64;
            let mean = values.iter().sum::<f64>() / count;
            let variance = values.iter().map(|value| (value - mean).powi(2)).sum::<f64>() / count;
            let at = |part: f64| quantile(&values, part);
            let results = [at(0.0), at(1.0), mean, variance.sqrt()]
                .into_iter()
                .chain(QUANTILES.map(|(_, part)| at(part)));
            all.iter_mut().zip(results).for_each(|((_, list), result)| list.push(result));
        }
        all
    }
}

/// Returns a quantile of sorted values, interpolated between neighbours.
#[expect(
    clippy::cast_precision_loss,
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    reason = "a place in a list"
)]
fn quantile(sorted: &[f64], part: f64) -> f64 {
    let Some(last) = sorted.len().checked_sub(1) else { return f64::NAN };
    let place = part * last as f64;
    let (below, share) = (place.floor(), place.fract());
    let at = |i: usize| sorted[i.min(last)];
    at(below as usize) * (1.0 - share) + at(below as usize + 1) * share
}

/// A data set that is being put together.
struct Set {
    fps: u32,
    parts: Parts,
    robot: String,
    features: Vec<Feature>,
    /// Frames of each episode.
    lengths: Vec<usize>,
}

impl Set {
    fn new(fps: u32, parts: Parts, robot: &str) -> Self {
        let names = |quantities: Vec<Quantity>| quantities.into_iter().map(|q| q.name).collect::<Vec<_>>();
        let taxels: Vec<String> = (1..=parts.taxels).map(|i| format!("t{i}")).collect();
        let singles = |name: &str, names: Vec<String>| Feature::new(name, names, Values::Singles(vec![]));
        let integers = |name: &str| Feature::new(name, vec![], Values::Integers(vec![]));
        let mut features: Vec<Feature> = OF_SAMPLES
            .iter()
            .map(|(name, of)| singles(name, names(of(parts))))
            .filter(|feature| !feature.names.is_empty())
            .collect();
        if parts.taxels > 0 {
            features.push(singles("observation.tactile.force", taxels.clone()));
            features.push(Feature::new("observation.tactile.valid", taxels, Values::Flags(vec![])));
            features.push(singles("observation.tactile.age", vec![]));
        }
        features.push(singles("timestamp", vec![]));
        features.extend(["frame_index", "episode_index", "index", "task_index"].map(integers));
        Self { fps, parts, robot: robot.into(), features, lengths: Vec::new() }
    }

    /// Frames so far.
    fn index(&self) -> usize {
        self.lengths.iter().sum()
    }

    #[expect(
        clippy::cast_possible_wrap,
        clippy::cast_possible_truncation,
        clippy::cast_precision_loss,
        reason = "counts of frames; LeRobot's numbers are single"
    )]
    fn add(&mut self, frames: &[Frame<'_>]) {
        let (before, episode, parts, fps) =
            (self.index(), self.lengths.len(), self.parts, f64::from(self.fps));
        for feature in &mut self.features {
            let singles = |quantities: Vec<Quantity>| -> Vec<f32> {
                frames.iter().flat_map(|f| quantities.iter().map(|q| q.of(f.sample) as f32)).collect()
            };
            let of_samples = OF_SAMPLES.iter().find(|(name, _)| *name == feature.column.name);
            match (feature.column.name.as_str(), &mut feature.column.values) {
                // One NaN would spoil all that is learned: a force that means nothing is 0, and `valid` says so.
                ("observation.tactile.force", Values::Singles(v)) => {
                    v.extend(singles(forces(parts)).into_iter().map(|n| if n.is_finite() { n } else { 0.0 }))
                }
                ("observation.tactile.valid", Values::Flags(v)) => v.extend(
                    frames.iter().flat_map(|f| (0..parts.taxels).map(|taxel| valid(f.sample, taxel))),
                ),
                ("observation.tactile.age", Values::Singles(v)) => {
                    v.extend(frames.iter().map(|f| age_s(f) as f32));
                }
                ("timestamp", Values::Singles(v)) => {
                    v.extend((0..frames.len()).map(|i| (i as f64 / fps) as f32));
                }
                ("frame_index", Values::Integers(v)) => v.extend((0..frames.len()).map(|i| i as i64)),
                ("episode_index", Values::Integers(v)) => v.extend(frames.iter().map(|_| episode as i64)),
                ("index", Values::Integers(v)) => v.extend((before..before + frames.len()).map(|i| i as i64)),
                ("task_index", Values::Integers(v)) => v.extend(frames.iter().map(|_| 0)),
                (_, Values::Singles(v)) => {
                    v.extend(of_samples.into_iter().flat_map(|(_, of)| singles(of(parts))))
                }
                _ => {}
            }
        }
        self.lengths.push(frames.len());
    }

    fn write(&self, out: &Path, task: &str) -> Result<()> {
        for file in [DATA, EPISODES] {
            std::fs::create_dir_all(out.join(file).parent().context("a path in a folder")?)?;
        }
        let columns: Vec<Column> = self.features.iter().map(|feature| feature.column.clone()).collect();
        write(&out.join(DATA), &columns, &[], &self.lengths)?;
        write(&out.join(EPISODES), &self.episodes(task), &[], &[self.lengths.len()])?;
        self.write_tasks(out, task)?;
        let text = |value: &Value| serde_json::to_string_pretty(value);
        std::fs::write(out.join("meta/info.json"), text(&self.info())?)?;
        std::fs::write(out.join("meta/stats.json"), text(&self.stats())?)?;
        Ok(())
    }

    fn info(&self) -> Value {
        let features: Map<String, Value> =
            self.features.iter().map(|feature| (feature.column.name.clone(), feature.json())).collect();
        json!({
            "codebase_version": "v3.0",
            "robot_type": self.robot,
            "total_episodes": self.lengths.len(),
            "total_frames": self.index(),
            "total_tasks": 1,
            "chunks_size": 1000,
            "data_files_size_in_mb": 100,
            "video_files_size_in_mb": 200,
            "fps": self.fps,
            "splits": {"train": format!("0:{}", self.lengths.len())},
            "data_path": "data/chunk-{chunk_index:03d}/file-{file_index:03d}.parquet",
            "video_path": null,
            "features": features,
        })
    }

    fn stats(&self) -> Value {
        let of = |feature: &Feature| {
            let statistics = feature.statistics(0..self.index()).into_iter();
            let mut all: Map<String, Value> =
                statistics.map(|(name, list)| (name.into(), json!(list))).collect();
            all.insert("count".into(), json!([self.index()]));
            (feature.column.name.clone(), Value::Object(all))
        };
        Value::Object(self.features.iter().map(of).collect())
    }

    /// One row an episode: where it lies, and its statistics.
    #[expect(clippy::cast_possible_wrap, reason = "counts of frames")]
    fn episodes(&self, task: &str) -> Vec<Column> {
        let mut from = 0;
        let ranges: Vec<_> = self
            .lengths
            .iter()
            .map(|length| {
                from += length;
                from - length..from
            })
            .collect();
        let integers = |name: &str, of: &dyn Fn(usize) -> usize| {
            Column::new(name, Values::Integers((0..ranges.len()).map(|i| of(i) as i64).collect()))
        };
        let mut columns = vec![
            integers("episode_index", &|i| i),
            Column::lists("tasks", 1, Values::Texts(vec![task.to_owned(); ranges.len()])),
            integers("length", &|i| ranges[i].len()),
            integers("data/chunk_index", &|_| 0),
            integers("data/file_index", &|_| 0),
            integers("dataset_from_index", &|i| ranges[i].start),
            integers("dataset_to_index", &|i| ranges[i].end),
            integers("meta/episodes/chunk_index", &|_| 0),
            integers("meta/episodes/file_index", &|_| 0),
        ];
        for feature in &self.features {
            let name = |statistic: &str| format!("stats/{}/{statistic}", feature.column.name);
            let mut lists: Vec<(&str, Vec<f64>)> = Vec::new();
            for range in &ranges {
                for (place, (statistic, values)) in feature.statistics(range.clone()).into_iter().enumerate()
                {
                    match lists.get_mut(place) {
                        Some((_, list)) => list.extend(values),
                        None => lists.push((statistic, values)),
                    }
                }
            }
            let lists = lists.into_iter();
            columns.extend(
                lists.map(|(of, list)| Column::lists(&name(of), feature.width(), Values::Doubles(list))),
            );
            let counts = ranges.iter().map(|range| range.len() as i64).collect();
            columns.push(Column::lists(&name("count"), 1, Values::Integers(counts)));
        }
        columns
    }

    /// The words of each task, which pandas takes as the table's index.
    fn write_tasks(&self, out: &Path, task: &str) -> Result<()> {
        let column = |name: &str, pandas: &str, numpy: &str| json!({"name": name, "field_name": name, "pandas_type": pandas, "numpy_type": numpy, "metadata": null});
        let pandas = json!({
            "index_columns": ["task"],
            "column_indexes": [],
            "columns": [column("task_index", "int64", "int64"), column("task", "unicode", "object")],
            "creator": {"library": "moca-lab", "version": env!("CARGO_PKG_VERSION")},
            "pandas_version": "2.0.0",
        });
        let columns = [
            Column::new("task_index", Values::Integers(vec![0])),
            Column::new("task", Values::Texts(vec![task.to_owned()])),
        ];
        write(&out.join("meta/tasks.parquet"), &columns, &[("pandas", pandas.to_string())], &[1])
    }
}

/// Age of the cover's data at a frame, s; below zero before the first.
fn age_s(frame: &Frame<'_>) -> f64 {
    let then_s = frame.sample.frame_age_s;
    if then_s < 0.0 || !then_s.is_finite() { -1.0 } else { then_s + frame.age_s }
}
