//! `moca-lab faults`: every fault that can be injected, and what the robot does about it with a stock board.
#![expect(clippy::print_stdout, reason = "this is what the command is for")]

#[cfg(test)]
mod tests;

use crate::robustness::trial;
use anyhow::Result;
use moca_daemon::inject::FAULTS;
use moca_experiments::parallel;
use moca_tactile::Firmware;
use serde::Serialize;

/// Every fault that can be injected, the mode it ends in and how many ticks the reaction takes.
#[derive(clap::Args)]
pub(crate) struct Arguments {
    /// Seed of the spoiled bytes and of the board's noise.
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// Print JSON.
    #[arg(long)]
    json: bool,
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

/// The table for the documents.
pub(crate) fn markdown() -> Result<String> {
    let mut table = "| fault | what happens | mode at the end | cause | reaction, ticks | way, mm |\n|---|---|---|---|---|---|\n".to_owned();
    for row in rows(1)? {
        let ticks = row.reaction_ticks.map_or("–".into(), |ticks| ticks.to_string());
        let Row { fault, what, mode, way_mm, .. } = row;
        let cause = row.cause.unwrap_or("–");
        table += &format!("| `{fault}` | {what} | {mode} | {cause} | {ticks} | {way_mm:.1} |\n");
    }
    Ok(table)
}

pub(crate) fn run(arguments: &Arguments) -> Result<()> {
    let rows = rows(arguments.seed)?;
    if arguments.json {
        println!("{}", serde_json::to_string_pretty(&rows)?);
        return Ok(());
    }
    println!(
        "Each fault strikes a moving robot (T6 pressed with 20 N) 3 s into a run of 13 s; a tick is 1 ms.\n"
    );
    println!(
        "{:<20} {:<16} {:<18} {:>9} {:>12} {:>8} {:>7} {:>7}  what happens",
        "fault", "mode at the end", "cause", "reaction", "speed after", "way", "bad", "missed"
    );
    println!(
        "{:<20} {:<16} {:<18} {:>9} {:>12} {:>8} {:>7} {:>7}",
        "", "", "", "ticks", "m/s", "mm", "frames", "slots"
    );
    for row in &rows {
        let ticks = row.reaction_ticks.map_or("-".into(), |ticks| ticks.to_string());
        println!(
            "{:<20} {:<16} {:<18} {:>9} {:>12.4} {:>8.1} {:>7} {:>7}  {}",
            row.fault,
            row.mode,
            row.cause.unwrap_or("-"),
            ticks,
            row.speed_after_m_s,
            row.way_mm,
            row.frames_bad,
            row.overruns,
            row.reported.as_ref().map_or(row.what.into(), |reported| format!("{} ({reported})", row.what)),
        );
    }
    Ok(())
}
