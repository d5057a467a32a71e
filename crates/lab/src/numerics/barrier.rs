//! Benefit of the contact barrier: the sweeps of `scenes/barrier-*.toml` as the table of docs/math.md.

use anyhow::{Context, Result};
use moca_experiments::campaign::Table as _;
use moca_experiments::collision;
use moca_experiments::parallel;
use moca_experiments::settings::Settings;
use moca_experiments::sweep::Sweep;
use std::fmt::Write as _;

/// A row of the table: the sensor and the person, and the runs that stand for them.
const ROWS: [(&str, &str, &str); 4] = [
    ("100 Hz, 50 N/mm", IDEAL, "50000"),
    ("100 Hz, rigid", IDEAL, "10000000"),
    ("stock, 50 N/mm", STOCK, "50000"),
    ("stock, rigid", STOCK, "10000000"),
];
const IDEAL: &str = include_str!("../../../../scenes/barrier-ideal.toml");
const STOCK: &str = include_str!("../../../../scenes/barrier-stock.toml");

/// A run that is asked for: its cell, and who is met when.
struct Planned {
    cell: (usize, bool),
    met: String,
    settings: Settings,
}

/// One run: the cell it belongs to, who was met when, and what came of it.
struct Run {
    cell: (usize, bool),
    met: String,
    approach_m_s: f64,
    peak_n: f64,
    flange_mm: f64,
    stopped: bool,
}

/// The collisions that the cells of a table name, beside them: each cell with what it begins with now.
#[cfg(test)]
pub(crate) fn named_by(shown: &str) -> Result<Vec<(String, String)>> {
    let cell = |row: usize, on: bool| {
        let line = shown.lines().find(|line| line.starts_with(&format!("| {} |", ROWS[row].0)));
        line.and_then(|line| line.split(" | ").nth(if on { 2 } else { 3 })).unwrap_or_default()
    };
    let runs = runs(|row, on, met| cell(row, on).contains(&format!("({met})")))?;
    Ok(runs.iter().map(|run| (cell(run.cell.0, run.cell.1).to_owned(), peak(run))).collect())
}

/// Runs of the table before `taxel` on a leg of 50 N/mm, with the barrier on or off: name, and one run a phase.
pub(crate) fn before(taxel: &str, barrier: bool) -> Result<Vec<(String, Vec<Settings>)>> {
    let mut cells = Vec::new();
    for (row, (name, ..)) in ROWS.iter().enumerate().filter(|(_, (_, _, stiffness))| *stiffness == "50000") {
        let runs = plan(|other, on, met| other == row && on == barrier && met.starts_with(taxel))?;
        cells.push(((*name).to_owned(), runs.into_iter().map(|run| run.settings).collect()));
    }
    Ok(cells)
}

/// The runs that `chosen` picks by row, whether the barrier is on, and who is met when: not yet run.
fn plan(chosen: impl Fn(usize, bool, &str) -> bool) -> Result<Vec<Planned>> {
    let mut todo = Vec::new();
    for (row, (_, plan, stiffness)) in ROWS.into_iter().enumerate() {
        let plan = Sweep::parse(plan, None)?;
        let columns = plan.varied();
        for values in (0..plan.rows()).map(|id| plan.values(id)) {
            let value = |key: &str| {
                let place = columns.iter().position(|column| column == key);
                place.and_then(|place| values.get(place)).context("a plan without this key")
            };
            let on = value("barrier")? != "off";
            let met = format!("{}, {} ms", value("person.taxel")?, value("sensor.phase_ms")?);
            if value("person.stiffness")? == stiffness && chosen(row, on, &met) {
                todo.push(Planned { cell: (row, on), met, settings: plan.settings(&values)? });
            }
        }
    }
    Ok(todo)
}

/// Results of the chosen runs.
fn runs(chosen: impl Fn(usize, bool, &str) -> bool) -> Result<Vec<Run>> {
    let run = |planned: &Planned| {
        let report = collision::single(&planned.settings)?;
        Ok(Run {
            cell: planned.cell,
            met: planned.met.clone(),
            approach_m_s: report.approach_m_s,
            peak_n: report.measures.peak_force_n,
            flange_mm: report.measures.flange_max_mm,
            stopped: report.stopped().is_some(),
        })
    };
    parallel::run("collisions", &plan(chosen)?, run)
}

/// Force of the hardest run as the table has it.
fn peak(run: &Run) -> String {
    let digits = usize::from(run.peak_n < 100.0);
    format!("**{:.digits$} N** ({})", run.peak_n, run.met)
}

/// The table in Markdown: speeds at the touch under the barrier; of each cell the hardest run with who was met when, and
/// the largest error of the flange.
pub(crate) fn markdown() -> Result<String> {
    let runs = runs(|_, _, _| true)?;
    let mut out = String::from("| sensor, leg | touched at | barrier | without |\n|---|---|---|---|\n");
    for (row, (name, ..)) in ROWS.into_iter().enumerate() {
        let speeds = || runs.iter().filter(|run| run.cell == (row, true)).map(|run| run.approach_m_s);
        let (least, most) = (speeds().fold(f64::INFINITY, f64::min), speeds().fold(0.0, f64::max));
        let mut cells = vec![format!("{least:.3} to {most:.3} m/s")];
        for on in [true, false] {
            let of_cell = || runs.iter().filter(|run| run.cell == (row, on));
            let hardest = of_cell().max_by(|a, b| a.peak_n.total_cmp(&b.peak_n)).context("no runs")?;
            let flange_mm = of_cell().map(|run| run.flange_mm).fold(0.0, f64::max);
            let stops = match of_cell().filter(|run| run.stopped).count() {
                0 => String::new(),
                stops => format!("; {stops} of {} end in a stop", of_cell().count()),
            };
            cells.push(format!("{}, {flange_mm:.1} mm{stops}", peak(hardest)));
        }
        // Writing to a string cannot fail.
        let _ = writeln!(out, "| {name} | {} |", cells.join(" | "));
    }
    Ok(out)
}
