//! `moca-lab tick`: what a control step costs, hot, cold and live.
//!
//! A loop of 1 kHz runs cold: between two steps the rest of the system has the caches. So a step is timed twice, one after
//! the other and with [`REPLACED_BYTES`] written in between, and what it needs of any machine is counted where valgrind is
//! installed: instructions, bytes of code and data. `--live S` runs the daemon's loop with the simulated robot and says
//! what its control stage took.

mod steps;

use crate::study::Answer;
use serde::Serialize;
use std::fmt::Write as _;

/// Timed passes over all robots.
const PASSES: usize = 400;
/// Written between two cold steps: more than a core's own caches hold.
pub(crate) const REPLACED_BYTES: usize = 8 << 20;

/// Writes the limits of `.ci/size` as a table for the documents.
pub(crate) fn markdown() -> anyhow::Result<String> {
    let mut table =
        String::from("\n| step | instructions | code, bytes | data, bytes |\n|---|---|---|---|\n");
    for row in include_str!("../../../../../.ci/size.tsv").lines().skip(1) {
        let [case, instructions, code, _, data] = row.split('\t').collect::<Vec<_>>()[..] else {
            anyhow::bail!("{row}: no case with four numbers")
        };
        writeln!(table, "| {case} | {instructions} | {code} | {data} |")?;
    }
    Ok(table)
}

/// Prints the cost of a control step: hot, cold and live.
#[derive(clap::Args)]
pub(crate) struct Arguments {
    /// Runs the live loop for so many seconds, 2 to 600.
    #[arg(long, value_name = "SECONDS")]
    live: Option<f64>,
    #[command(flatten)]
    answer: Answer,
    /// Only runs the steps of one case, for a program that watches.
    #[arg(long, hide = true)]
    marked: Option<String>,
}

#[derive(Serialize)]
struct Report {
    steps: Vec<steps::Row>,
    live: Option<steps::Live>,
}

/// Measures every step, and the live loop if it is asked for.
pub(crate) fn run(arguments: &Arguments) -> anyhow::Result<()> {
    if let Some(case) = &arguments.marked {
        return steps::marked(case);
    }
    let report = Report { steps: steps::measured()?, live: arguments.live.map(steps::live).transpose()? };
    arguments.answer.print(&report, || Ok(steps::table(&report.steps, report.live.as_ref())))
}
