//! Whole steps of the controllers: hot, cold, live, and what they need of any machine.

use super::{PASSES, REPLACED_BYTES};
use crate::study::{self, Column};
use anyhow::{Result, anyhow, ensure};
use moca_control::config::Config;
use moca_control::stage::Stage;
use moca_daemon::runtime::live::Shared;
use moca_daemon::runtime::notice::Silent;
use moca_daemon::runtime::options::Options;
use moca_daemon::runtime::run::live_simulated;
use moca_experiments::parallel::Count;
use moca_experiments::timed::robot_step;
use moca_figures::progress;
use moca_wbc::testing::footprint::{self, Footprint};
use moca_wbc::testing::steps::{Case, Steps};
use serde::Serialize;
use std::hint::black_box;
use std::sync::Arc;
use std::time::{Duration, Instant};

/// Rounds over the robots with replaced caches.
const COLD_ROUNDS: usize = 8;

/// One law.
#[derive(Serialize)]
pub(super) struct Row {
    name: &'static str,
    hot_ns_least: f64,
    hot_ns_median: f64,
    cold_ns_median: f64,
    /// Instructions of a step, if valgrind is installed.
    instructions: Option<u64>,
    code_bytes: Option<u64>,
    code_lines_bytes: Option<u64>,
    data_lines_bytes: Option<u64>,
}

/// The control stage of the live loop, simulated robot, one period after the other.
#[derive(Serialize)]
pub(super) struct Live {
    control_us_p50: f64,
    control_us_p99: f64,
    ticks: u64,
}

/// Steps between marks, for [`footprint::measured`].
pub(super) fn marked(case: &str) -> Result<()> {
    let case = Case::named(case).ok_or_else(|| anyhow!("there is no case {case}"))?;
    footprint::marked(case).map_err(|error| anyhow!("{error}"))
}

pub(super) fn measured() -> Result<Vec<Row>> {
    let mut count = Count::new("tick", Case::ALL.len());
    let one = |case| {
        let row = row(case);
        count.one_more();
        row
    };
    Case::ALL.into_iter().map(one).collect()
}

fn row(case: Case) -> Result<Row> {
    let mut steps = Steps::new(case).map_err(|error| anyhow!("{error}"))?;
    let mut passes = Vec::with_capacity(PASSES);
    for _ in 0..PASSES {
        let start = Instant::now();
        for robot in 0..Steps::ROBOTS {
            black_box(robot_step(&mut steps, robot)?);
        }
        #[expect(clippy::cast_precision_loss, reason = "a small constant")]
        passes.push(start.elapsed().as_secs_f64() * 1e9 / Steps::ROBOTS as f64);
    }
    passes.sort_by(f64::total_cmp);
    let mut cold = Vec::with_capacity(COLD_ROUNDS * Steps::ROBOTS);
    let mut others = vec![0_u8; REPLACED_BYTES];
    for robot in (0..COLD_ROUNDS).flat_map(|_| 0..Steps::ROBOTS) {
        others.iter_mut().step_by(64).for_each(|byte| *byte = byte.wrapping_add(1));
        black_box(&mut others);
        let start = Instant::now();
        black_box(robot_step(&mut steps, robot)?);
        cold.push(start.elapsed().as_secs_f64() * 1e9);
    }
    cold.sort_by(f64::total_cmp);
    let program = std::env::current_exe()?;
    let counted = footprint::measured(&program, &["tick", "--marked", case.name()]);
    let counted: Option<Footprint> = counted.map_err(|error| anyhow!("{error}"))?;
    Ok(Row {
        name: case.name(),
        hot_ns_least: passes[0],
        hot_ns_median: passes[PASSES / 2],
        cold_ns_median: cold[cold.len() / 2],
        instructions: counted.map(|counted| counted.instructions),
        code_bytes: counted.map(|counted| counted.code_bytes),
        code_lines_bytes: counted.map(|counted| counted.code_lines_bytes),
        data_lines_bytes: counted.map(|counted| counted.data_lines_bytes),
    })
}

pub(super) fn live(seconds: f64) -> Result<Live> {
    ensure!((2.0..=600.0).contains(&seconds), "--live {seconds} s is outside 2 to 600 s");
    let mut config = Config::default();
    config.telemetry.listen = String::new();
    let options = Options { config, duration: Some(Duration::from_secs_f64(seconds)), ..Options::default() };
    let bar = progress::during("live", Duration::from_secs_f64(seconds));
    let run = live_simulated(&options, &Arc::new(Shared::default()), &mut Silent)?;
    drop(bar);
    let control = &run.timing.stages[Stage::Control as usize];
    Ok(Live {
        control_us_p50: control.quantile_us(0.5),
        control_us_p99: control.quantile_us(0.99),
        ticks: run.report.ticks,
    })
}

const COLUMNS: &[Column<Row>] = &[
    ("step", |row| row.name.into()),
    ("ns least", |row| format!("{:.0}", row.hot_ns_least)),
    ("ns median", |row| format!("{:.0}", row.hot_ns_median)),
    ("ns cold", |row| format!("{:.0}", row.cold_ns_median)),
    ("instructions", |row| counted(row.instructions)),
    ("code bytes", |row| counted(row.code_bytes)),
    ("code lines", |row| counted(row.code_lines_bytes)),
    ("data lines", |row| counted(row.data_lines_bytes)),
];

fn counted(count: Option<u64>) -> String {
    count.map_or("-".into(), |count| count.to_string())
}

pub(super) fn table(rows: &[Row], live: Option<&Live>) -> String {
    let live = live.map_or_else(String::new, |Live { control_us_p50, control_us_p99, ticks }| {
        format!("live, {ticks} ticks: control stage p50 {control_us_p50:.1} µs, p99 {control_us_p99:.1} µs\n")
    });
    let table = study::table(COLUMNS, rows);
    format!("{table}lines: bytes of the cache lines of 64 bytes that a step touches\n{live}")
}
