//! `moca-lab faults`: every fault that can be injected, and what the robot does about it with a stock board.

#[cfg(test)]
mod tests;

use crate::robustness::trial;
use crate::study::{self, Answer, Column};
use anyhow::Result;
use moca_experiments::parallel;
use moca_lockstep::inject::FAULTS;
use moca_tactile::Firmware;
use serde::Serialize;

/// Every fault that can be injected, the mode it ends in and how many ticks the reaction takes.
#[derive(clap::Args)]
pub(crate) struct Arguments {
    /// Seed of the spoiled bytes and of the board's noise.
    #[arg(long, default_value_t = 1)]
    seed: u64,
    #[command(flatten)]
    answer: Answer,
}

#[derive(Serialize)]
struct Row {
    fault: &'static str,
    what: &'static str,
    mode: &'static str,
    cause: Option<&'static str>,
    reaction_ticks: Option<u64>,
    speed_after_m_s: f64,
    way_mm: f64,
    frames_bad: u64,
    overruns: u64,
    reported: Option<String>,
}

fn rows(seed: u64) -> Result<Vec<Row>> {
    let stock = Firmware::Stock2018;
    parallel::run("faults", FAULTS, |fault| {
        let trial = trial::run(*fault, stock, seed, 10_000)?;
        Ok(Row {
            fault: trial.fault.name,
            what: trial.fault.text,
            mode: trial.mode.name(),
            cause: trial.cause.map(|cause| cause.code()),
            reaction_ticks: trial.reaction_ticks,
            speed_after_m_s: trial.speed_after_m_s,
            way_mm: trial.way_m * 1e3,
            frames_bad: trial.frames_bad,
            overruns: trial.overruns,
            reported: trial.reported,
        })
    })
}

const COLUMNS: [Column<Row>; 6] = [
    ("fault", |row| format!("`{}`", row.fault)),
    ("what happens", |row| row.what.into()),
    ("mode at the end", |row| row.mode.into()),
    ("cause", |row| row.cause.unwrap_or("–").into()),
    ("reaction, ticks", |row| row.reaction_ticks.map_or("–".into(), |ticks| ticks.to_string())),
    ("way, mm", |row| format!("{:.1}", row.way_mm)),
];

/// Columns that only the command prints.
const MORE: [Column<Row>; 4] = [
    ("speed after, m/s", |row| format!("{:.4}", row.speed_after_m_s)),
    ("bad frames", |row| row.frames_bad.to_string()),
    ("missed slots", |row| row.overruns.to_string()),
    ("reported", |row| row.reported.clone().unwrap_or_default()),
];

/// The table for the documents.
pub(crate) fn markdown() -> Result<String> {
    Ok(study::table(&COLUMNS, &rows(1)?))
}

pub(crate) fn run(arguments: &Arguments) -> Result<()> {
    let (rows, columns) = (rows(arguments.seed)?, [&COLUMNS[..], &MORE].concat());
    let head =
        "Each fault strikes a moving robot (T6 pressed with 20 N) 3 s into a run of 13 s; a tick is 1 ms.";
    arguments.answer.print(&rows, || Ok(format!("{head}\n\n{}", study::table(&columns, &rows))))
}
