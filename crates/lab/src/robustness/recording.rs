//! `moca-lab recording`: what a log costs, next to the robot whose log it is.

use super::soak::in_use_kib;
use crate::study::Answer;
use anyhow::{Context, Result, ensure};
use moca_control::config::Config;
use moca_control::tick::Ticked;
use moca_daemon::record::recording::Recording;
use moca_daemon::record::tick_log::tick_log;
use moca_experiments::cpu_time::{of_process_s, timed};
use moca_figures::progress::Progress;
use moca_lockstep::LockStep;
use moca_lockstep::simulated_robot::free_scene;
use moca_sim::VirtualBoardConfig;
use moca_telemetry::RobotDescription;
use moca_telemetry::log::records::{Channel, Command, Cover, State, Timing};
use moca_telemetry::log::{Account, LogFile};
use serde::Serialize;
use std::path::{Path, PathBuf};

/// Ticks of a second of robot time.
const SECOND: u64 = 1000;

/// Prints the cost of a log to the PC, next to the robot whose log it is: writing it, `mocad log`, columns, memory.
#[derive(clap::Args)]
pub(crate) struct Arguments {
    /// Robot time, s, 10 to 86400.
    #[arg(long, default_value_t = 120)]
    seconds: u64,
    #[command(flatten)]
    answer: Answer,
}

/// Costs of a log, CPU time by this program's own account.
#[derive(Clone, Debug, Default, Serialize)]
struct Costs {
    robot_s: f64,
    /// Simulated robot and its loop, ms for each second of the robot.
    robot_ms: f64,
    /// Recording all of it, ms for each second of the robot.
    recording_ms: f64,
    /// `mocad log` from the story that the log holds, ms.
    indexed_ms: f64,
    /// `mocad log` from all chunks, s for each hour of the log.
    scanned_s: f64,
    /// One record's columns, and all of them, s for each hour of the log.
    record_s: f64,
    columns_s: f64,
    /// Memory in use by the recorder after half of the run, and its growth in the second half, bytes for each second.
    memory_kib: u64,
    growth_bytes_s: f64,
    /// Size of the log, GB an hour.
    gigabytes_hour: f64,
}

pub(crate) fn run(arguments: &Arguments) -> Result<()> {
    let seconds = arguments.seconds;
    ensure!((10..=86_400).contains(&seconds), "--seconds {seconds} s is outside 10 to 86400 s");
    let (costs, _) = measure(seconds)?;
    arguments.answer.print(&costs, || Ok(text(&costs)))
}

fn text(costs: &Costs) -> String {
    let Costs { robot_s, robot_ms, recording_ms, indexed_ms, scanned_s, record_s, columns_s, .. } = costs;
    let (of_robot, slower) = (recording_ms / robot_ms, scanned_s * 1e3 * robot_s / 3600.0 / indexed_ms);
    let Costs { memory_kib, growth_bytes_s, gigabytes_hour, .. } = costs;
    format!(
        "{robot_s:.0} s of robot time, CPU time\n\
         robot        {robot_ms:6.2} ms a second\n\
         recording    {recording_ms:6.2} ms a second: {of_robot:.2} of the robot's\n\
         mocad log    {indexed_ms:6.2} ms, from all chunks {scanned_s:.2} s an hour: {slower:.0} times\n\
         columns      {record_s:6.2} s an hour for one record, {columns_s:.2} s for all\n\
         memory       {memory_kib:6} KiB, and {growth_bytes_s:.0} bytes a second\n\
         size         {gigabytes_hour:6.3} GB an hour\n"
    )
}

/// A log that is removed at the end.
struct Temporary(PathBuf);

impl Drop for Temporary {
    fn drop(&mut self) {
        // It may not have been created.
        let _ = std::fs::remove_file(&self.0);
    }
}

/// Records a run and reads it; returns what the log tells as well.
fn measure(seconds: u64) -> Result<(Costs, Account)> {
    let path = std::env::temp_dir().join(format!("moca-recording-{}.mcap", std::process::id()));
    let file = Temporary(path);
    let mut costs = write(&file.0, seconds)?;
    let account = read(&file.0, &mut costs)?;
    Ok((costs, account))
}

fn write(path: &Path, seconds: u64) -> Result<Costs> {
    let config = Config::default();
    let (mut log, events, mut reader) = tick_log();
    let board = VirtualBoardConfig::default();
    let mut world = LockStep::with_board(&config, &free_scene(&config), board, Some(events))?;
    let description = RobotDescription::paper("recording", true);
    let mut progress = Progress::new("recording");
    let before_kib = in_use_kib();
    let begin_s = of_process_s();
    let mut recording = Recording::create(path, None, description, &config, false)?;
    let (mut robot_s, mut half) = (0.0, (0, 0));
    for second in 0..seconds {
        // The robot's second first, then its record: each has the caches to itself, as on cores of their own.
        let (samples, spent_s) = timed(|| {
            let step = |_| {
                world.tick(None);
                let Ticked { sample, input } = world.control.ticked();
                let sample = sample.clone();
                log.push(*input, || world.control.state());
                sample
            };
            (0..SECOND).map(step).collect::<Vec<_>>()
        });
        robot_s += spent_s;
        while reader.next_state().is_some() {}
        let mut samples = samples.iter();
        while let Some(record) = reader.next_tick() {
            recording.add_tick(&record);
            samples.next().into_iter().for_each(|sample| recording.add(sample));
        }
        if second == seconds / 2 {
            half = (second, in_use_kib());
        }
        progress.count(usize::try_from(second)?, usize::try_from(seconds)?);
    }
    let grown_kib = in_use_kib().saturating_sub(half.1);
    let summary = recording.finish()?;
    progress.end();
    ensure!(summary.samples == seconds * SECOND, "{} samples of {seconds} s were recorded", summary.samples);
    let (run_s, all_s) = (float(seconds), of_process_s() - begin_s);
    Ok(Costs {
        robot_s: run_s,
        robot_ms: 1e3 * robot_s / run_s,
        recording_ms: 1e3 * (all_s - robot_s) / run_s,
        memory_kib: half.1.saturating_sub(before_kib),
        growth_bytes_s: 1024.0 * float(grown_kib) / float(seconds - half.0),
        ..Costs::default()
    })
}

fn read(path: &Path, costs: &mut Costs) -> Result<Account> {
    let hours = costs.robot_s / 3600.0;
    let (indexed, spent_s) = timed(|| LogFile::open(path)?.account(&mut |_| {}));
    costs.indexed_ms = 1e3 * spent_s;
    let (scanned, spent_s) = timed(|| LogFile::open(path)?.account_of_chunks(&mut |_| {}));
    costs.scanned_s = spent_s / hours;
    let (indexed, scanned) = (indexed?, scanned?);
    ensure!(indexed == scanned, "the log holds another story than its chunks tell");
    costs.gigabytes_hour = indexed.sizes.gigabytes_per_hour(indexed.sizes.file);
    let all = [State::TOPIC, Command::TOPIC, Cover::TOPIC, Timing::TOPIC];
    costs.record_s = columns_s(path, &all[..1])? / hours;
    costs.columns_s = columns_s(path, &all)? / hours;
    Ok(indexed)
}

/// CPU time of reading these records of a log, s.
fn columns_s(path: &Path, topics: &[&'static str]) -> Result<f64> {
    let mut log = LogFile::open(path)?;
    let mut rows = 0_u64;
    let (damage, spent_s) = timed(|| log.rows(topics, &mut |_| rows += 1));
    damage.map_or(Ok(()), Err).map_err(anyhow::Error::msg)?;
    (rows > 0).then_some(spent_s).context("the log has no rows")
}

#[expect(clippy::cast_precision_loss, reason = "figures for people")]
const fn float(count: u64) -> f64 {
    count as f64
}

#[cfg(test)]
mod tests {
    #[test]
    fn recorded_run_tells_the_same_from_story_and_chunks() {
        let (costs, account) = super::measure(10).unwrap();
        assert!(account.story.touches > 0, "{account:?}");
        assert!(account.sizes.replay > 0 && account.sizes.board > 0, "{account:?}");
        assert!(costs.recording_ms > 0.0 && costs.columns_s > 0.0, "{costs:?}");
    }
}
