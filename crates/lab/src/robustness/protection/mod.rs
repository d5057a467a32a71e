//! `moca-lab protection`: what people get to feel under what ships, cell by cell of a random sample of a grid: where,
//! by which board, who, on which foam, how fast.

mod cell;
mod leads;
mod random;
mod table;
mod walk_in;

use crate::campaign::Shards;
use crate::study;
use anyhow::{Context as _, Result};
use cell::{COLUMNS, Cell, Law, PHASES};
pub(crate) use leads::markdown as leads_markdown;
use moca_experiments::campaign::{Column, Table, cells, names};
use moca_experiments::drawn::Meetings;
use moca_experiments::meeting::{Outcome, WATCHED_S};
use moca_experiments::parallel;
use moca_experiments::settings::Settings;
use std::num::NonZero;
use std::path::{Path, PathBuf};

/// Seed of the order of cells.
const SEED: u64 = 1;
/// Columns after the cell's own and the law.
const RESULTS: &[Column<Outcome>] = &[
    ("approach_m_s", |outcome| format!("{:.4}", outcome.approach_m_s)),
    ("first_touch_n", |outcome| format!("{:.2}", outcome.first_touch_n)),
    ("impact_n", |outcome| format!("{:.2}", outcome.impact_n)),
    ("peak_n", |outcome| format!("{:.2}", outcome.peak_n)),
    ("peak_after_s", |outcome| format!("{:.3}", outcome.peak_after_s)),
    ("felt_after_s", |outcome| format!("{:.3}", outcome.felt_after_s)),
    ("least_n", |outcome| format!("{:.2}", outcome.least_n)),
    ("taps", |outcome| outcome.taps.to_string()),
    ("grows", |outcome| outcome.grows.to_string()),
    ("again", |outcome| outcome.again.to_string()),
    ("first_peak_n", |outcome| format!("{:.2}", outcome.first_peak_n)),
    ("later_n", |outcome| format!("{:.2}", outcome.later_n)),
    ("flange_mm", |outcome| format!("{:.2}", outcome.flange_mm)),
    ("stopped", |outcome| outcome.stopped.clone()),
];

/// Collisions all round the cover, with what ships and with the contact barrier.
#[derive(clap::Args)]
pub(crate) struct Arguments {
    /// CSV file; rows that are already in it are kept and not run again.
    #[arg(long, value_name = "CSV", required_unless_present_any = ["table", "short", "walk_in", "leads", "drawn"])]
    out: Option<PathBuf>,
    /// Number of cells of the grid, in an order that its seed shuffles: a larger number continues a smaller one.
    #[arg(long, default_value_t = 86_184)]
    cells: usize,
    /// Instead: this many meetings drawn at random, robot, base, foam, person, board, lead and walk.
    #[arg(long, value_name = "N")]
    random: Option<NonZero<usize>>,
    /// Instead: what was drawn for the run with this number, as `moca-lab experiment --set` takes it.
    #[arg(long, value_name = "RUN", conflicts_with = "out")]
    drawn: Option<usize>,
    /// Seed of that order, or of what is drawn.
    #[arg(long, default_value_t = SEED)]
    seed: u64,
    #[command(flatten)]
    shards: Shards,
    /// Prints the table of a file instead, and what failed in it.
    #[arg(long, value_name = "CSV")]
    table: Option<PathBuf>,
    /// Instead: 76 cells, every place in each way, with the barrier off and on, as a table.
    #[arg(long)]
    short: bool,
    /// Instead: who walks into the front and on, as a table.
    #[arg(long)]
    walk_in: bool,
    /// Instead: who is driven into at 0.04 to 0.25 m/s, all round, as a table.
    #[arg(long)]
    leads: bool,
}

/// Runs what is missing, or prints what is there.
pub(crate) fn run(arguments: &Arguments) -> Result<()> {
    if let Some(path) = &arguments.table {
        if let Some(summary) = of_random(path)? {
            study::print(&summary);
            return Ok(());
        }
        study::print(&[table::of_file(path)?, table::failures(path)?, table::missed(path)?].join("\n"));
        return Ok(());
    }
    if let Some(run) = arguments.drawn {
        study::print(&Meetings { runs: 1 + run, seed: arguments.seed }.keys(run));
    }
    if arguments.short {
        study::print(&markdown()?);
    }
    if arguments.walk_in {
        study::print(&walk_in::markdown()?);
    }
    if arguments.leads {
        study::print(&leads::markdown()?);
    }
    let Some(out) = &arguments.out else { return Ok(()) };
    let seed = arguments.seed;
    let (table, option, count): (Box<dyn Table>, _, _) = match arguments.random {
        Some(runs) => (Box::new(Meetings { runs: runs.get(), seed }), "--random", runs.get()),
        None => (Box::new(Grid::new(arguments.cells, seed)), "--cells", arguments.cells),
    };
    let command = ["protection", option, &count.to_string(), "--seed", &seed.to_string()].map(str::to_owned);
    arguments.shards.run(&*table, out, &command)?;
    Ok(())
}

/// The campaign that the documents hold: `--out` goes on with it.
const CAMPAIGN: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/../../docs/data/protection.csv");

/// Summary of that campaign, the cells whose taps grow, and the reasons of forces above the limit.
pub(crate) fn campaign_markdown() -> Result<String> {
    let path = Path::new(CAMPAIGN);
    Ok([table::of_file(path)?, table::growth(path)?, table::failures(path)?].join("\n"))
}

/// Summary of a file of meetings drawn at random; `None` for the file of another campaign.
fn of_random(path: &Path) -> Result<Option<String>> {
    let text = table::read(path)?;
    let drawn = text.lines().next().is_some_and(|header| header.contains(",limit_m_s,"));
    if drawn { table::entries(&text, random::markdown).map(Some) } else { Ok(None) }
}

/// Summary of the campaign of meetings drawn at random.
pub(crate) fn random_markdown() -> Result<String> {
    of_random(Path::new(random::CAMPAIGN))?.context("the file is of another campaign")
}

/// Phases that the short table looks at.
const SHORT_PHASES: u32 = 2;

/// The short table: a cell a line, under the speed limit alone and with the barrier.
pub(crate) fn markdown() -> Result<String> {
    let lines = parallel::run("protection", &Cell::short(), short_line)?;
    let mut out = String::from(
        "| place | who moves | board | body | foam | share | robot | seed | m/s | barrier off | barrier on | least | taps | flange | why |\n\
         |---|---|---|---|---|---|---|---|---|---|---|---|---|---|---|\n",
    );
    out.push_str(&lines.concat());
    Ok(out)
}

fn short_line(cell: &Cell) -> Result<String> {
    let limited = cell.worst(Law::SpeedLimit, SHORT_PHASES)?;
    let kept = cell.worst(Law::Barrier, SHORT_PHASES)?;
    let stopped = |outcome: &Outcome| if outcome.stopped.is_empty() { "" } else { ", stop" };
    let row = format!("0,{},{},{}", cell.columns()?, Law::Barrier.name(), cells(RESULTS, &kept));
    Ok(format!(
        "| {} | {:.0} N{} | {:.1} N{} | {:.1} N | {} | {:.1} mm | {} |\n",
        cell.columns()?.replace(',', " | "),
        limited.peak_n,
        stopped(&limited),
        kept.peak_n,
        stopped(&kept),
        kept.least_n,
        kept.taps,
        kept.flange_mm,
        table::why(&row)?
    ))
}

/// A cell of a table under one law, in the phases that the table takes the worst of.
pub(crate) struct Printed {
    pub name: String,
    pub phases: Vec<Settings>,
    cell: Cell,
}

impl Printed {
    fn of(cell: Cell, law: Law, phases: u32) -> Result<Self> {
        let phases = (0..PHASES).step_by((PHASES / phases) as usize).map(|phase| cell.settings(law, phase));
        Ok(Self { name: cell.words(), phases: phases.collect::<Result<_>>()?, cell })
    }

    /// Largest force, N, and distance of the flange, mm.
    pub(crate) fn figures(&self, settings: &Settings) -> Result<[f64; 2]> {
        let outcome = self.cell.outcome(settings)?;
        Ok([outcome.peak_n, outcome.flange_mm])
    }
}

/// Every ninth cell of the short table, as its test runs them.
pub(crate) fn of_the_short_table(barrier: bool) -> Result<Vec<Printed>> {
    let law = if barrier { Law::Barrier } else { Law::SpeedLimit };
    Cell::short().into_iter().step_by(9).map(|cell| Printed::of(cell, law, SHORT_PHASES)).collect()
}

/// The first cells of the campaign under the barrier.
pub(crate) fn of_the_campaign(cells: usize) -> Result<Vec<Printed>> {
    Cell::sample(cells, SEED).into_iter().map(|cell| Printed::of(cell, Law::Barrier, PHASES)).collect()
}

/// Table of the grid: a row for each cell and law.
struct Grid {
    cells: Vec<Cell>,
}

impl Grid {
    fn new(cells: usize, seed: u64) -> Self {
        Self { cells: Cell::sample(cells, seed) }
    }
}

fn header() -> String {
    format!("run,{COLUMNS},law,{}", names(RESULTS))
}

impl Table for Grid {
    fn rows(&self) -> usize {
        self.cells.len() * Law::ALL.len()
    }

    fn header(&self) -> String {
        header()
    }

    fn words(&self) -> Vec<&str> {
        vec!["place", "meeting", "board", "person", "truth", "law", "grows", "again", "stopped"]
    }

    fn row(&self, id: usize) -> Result<String> {
        let (cell, law) = (&self.cells[id / Law::ALL.len()], Law::ALL[id % Law::ALL.len()]);
        let outcome = cell.worst(law, PHASES)?;
        Ok(format!("{id},{},{},{}", cell.columns()?, law.name(), cells(RESULTS, &outcome)))
    }
}

/// Outcomes of cells.
impl Cell {
    /// The worst of some of the phases, evenly apart.
    fn worst(&self, law: Law, phases: u32) -> Result<Outcome> {
        let mut worst = Outcome::default();
        for phase in (0..PHASES).step_by((PHASES / phases.clamp(1, PHASES)) as usize) {
            let one = self.outcome(&self.settings(law, phase)?)?;
            let (taps, grows) = (worst.taps.max(one.taps), worst.grows | one.grows);
            let again = worst.again | one.again;
            let flange_mm = worst.flange_mm.max(one.flange_mm);
            let stopped = if one.stopped.is_empty() { worst.stopped.clone() } else { one.stopped.clone() };
            let [first_touch_n, impact_n] =
                [worst.first_touch_n.max(one.first_touch_n), worst.impact_n.max(one.impact_n)];
            let [first_peak_n, later_n] =
                [worst.first_peak_n.max(one.first_peak_n), worst.later_n.max(one.later_n)];
            if phase == 0 || one.peak_n > worst.peak_n {
                worst = one;
            }
            let peaks = Outcome { first_touch_n, impact_n, first_peak_n, later_n, ..worst };
            worst = Outcome { taps, grows, again, flange_mm, stopped, ..peaks };
        }
        Ok(worst)
    }

    fn outcome(&self, settings: &Settings) -> Result<Outcome> {
        Outcome::of(self.meeting, &self.meeting_there(), settings, WATCHED_S)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_larger_sample_goes_on_where_a_smaller_one_ended() {
        let places = |count: usize| -> Vec<String> {
            Cell::sample(count, 1).iter().map(|cell| cell.columns().unwrap()).collect()
        };
        let (some, all) = (places(40), places(usize::MAX));
        assert_eq!(some[..], all[..40]);
        assert_eq!(all.len(), 86_184);
        let distinct: std::collections::BTreeSet<&String> = all.iter().collect();
        assert_eq!(distinct.len(), all.len());
        for cell in Cell::sample(40, 1) {
            assert!(cell.bound_m_s().unwrap() > 0.0);
        }
        let values = |cells: &[Cell], column: usize| -> std::collections::BTreeSet<String> {
            let lines = cells.iter().map(|cell| cell.columns().unwrap());
            lines.map(|line| line.split(',').nth(column).unwrap().to_owned()).collect()
        };
        let (short, grid) = (Cell::short(), Cell::sample(usize::MAX, 1));
        for column in 0..6 {
            assert_eq!(values(&short, column), values(&grid, column), "column {column}");
        }
    }

    /// All of them take minutes: every ninth is run, and has to come out as the document has it.
    #[test]
    fn cells_of_the_short_table_come_out_as_the_document_has_them() {
        let Some(shown) = crate::docs::shown("protection-short") else { return };
        assert_eq!(shown.lines().filter(|line| line.starts_with("| ")).count(), 1 + Cell::short().len());
        let cells: Vec<Cell> = Cell::short().into_iter().step_by(9).collect();
        for line in parallel::run("protection", &cells, short_line).unwrap() {
            // An empty cell has one space in a table that was a CSV file.
            let line = line.replace("|  |", "| |");
            assert!(shown.contains(&line), "`moca-lab docs --only protection-short` writes it anew: {line}");
        }
    }

    #[test]
    fn first_cells_of_campaign_match_its_file() {
        if crate::docs::shown("protection-campaign").is_none() {
            return; // where sines are rounded in another way, last digits are others
        }
        let text = std::fs::read_to_string(CAMPAIGN).unwrap();
        let grid = Grid::new(62, 1);
        // each way of meeting, each law, and plates that are pressed to the end of what a board can read
        for id in [0, 1, 9, 37, 183] {
            let fresh = grid.row(id).unwrap();
            assert!(text.lines().any(|line| line == fresh), "{fresh}");
        }
    }
}
