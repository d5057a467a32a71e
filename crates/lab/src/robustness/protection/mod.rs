//! `moca-lab protection`: what people get to feel under what ships, cell by cell of a random sample of a grid: where,
//! by which board, who, on which foam, how fast.

mod cell;
mod leads;
mod random;
mod table;
mod walk_in;

use anyhow::{Context as _, Result};
use cell::{COLUMNS, Cell, Law, Meeting, PHASES};
pub(crate) use leads::markdown as leads_markdown;
use moca_control::config::ProtectionConfig;
use moca_experiments::TAXELS;
use moca_experiments::bound;
use moca_experiments::campaign::{self, Campaign};
use moca_experiments::closed_loop::{Loads, Rig, Row};
use moca_experiments::collision::{self, approach_m_s};
use moca_experiments::measure::{Measures, peak_force_n};
use moca_experiments::parallel;
use moca_experiments::settings::Settings;
use moca_wbc::contact_barrier::STOP_SHARE;
use std::path::{Path, PathBuf};

/// A contact is watched for so long, s.
const WATCHED_S: f64 = 3.0;
/// A run that has met nobody by then never will, s.
const LONGEST_S: f64 = 12.0;
/// Period at which a run checks if it has seen enough, s.
const LOOK_S: f64 = 0.25;
/// Seed of the order of cells.
const SEED: u64 = 1;
/// Columns after the cell's own.
const RESULTS: &str = "law,approach_m_s,first_touch_n,impact_n,peak_n,peak_after_s,felt_after_s,least_n,taps,grows,again,first_peak_n,later_n,flange_mm,stopped";

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
    #[arg(long, value_name = "N", requires = "out")]
    random: Option<usize>,
    /// Instead: what was drawn for the run with this number, as `moca-lab experiment --set` takes it.
    #[arg(long, value_name = "RUN")]
    drawn: Option<usize>,
    /// Seed of that order, or of what is drawn.
    #[arg(long, default_value_t = SEED)]
    seed: u64,
    /// Part of the rows, as in `sweep`.
    #[arg(long, value_name = "I/N", value_parser = campaign::shard, default_value = "1/1")]
    shard: (usize, usize),
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
#[expect(clippy::print_stdout, reason = "the command's output")]
pub(crate) fn run(arguments: &Arguments) -> Result<()> {
    if let Some(path) = &arguments.table {
        if let Some(summary) = of_random(path)? {
            print!("{summary}");
            return Ok(());
        }
        print!("{}\n{}\n{}", table::of_file(path)?, table::failures(path)?, table::missed(path)?);
        return Ok(());
    }
    if let Some(run) = arguments.drawn {
        print!("{}", random::drawn(arguments.seed, run));
    }
    if arguments.short {
        print!("{}", markdown()?);
    }
    if arguments.walk_in {
        print!("{}", walk_in::markdown()?);
    }
    if arguments.leads {
        print!("{}", leads::markdown()?);
    }
    let Some(out) = &arguments.out else { return Ok(()) };
    if let Some(runs) = arguments.random {
        println!("{}", random::run(out, arguments.shard, runs, arguments.seed)?);
        return Ok(());
    }
    let cells = Cell::sample(arguments.cells, arguments.seed);
    let header = header();
    let rows = cells.len() * Law::ALL.len();
    let campaign = Campaign { out, shard: arguments.shard, rows, header: &header };
    println!("{}", campaign.run(|id| row(&cells, id))?);
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
    let lines = parallel::run("protection", &Cell::short(), short_line, |_| ());
    let mut out = String::from(
        "| place | who moves | board | body | foam | share | robot | seed | m/s | barrier off | barrier on | least | taps | flange | why |\n\
         |---|---|---|---|---|---|---|---|---|---|---|---|---|---|---|\n",
    );
    for line in lines {
        out.push_str(&line?);
    }
    Ok(out)
}

fn short_line(cell: &Cell) -> Result<String> {
    let limited = Outcome::of(cell, Law::SpeedLimit, SHORT_PHASES)?;
    let kept = Outcome::of(cell, Law::Barrier, SHORT_PHASES)?;
    let stopped = |outcome: &Outcome| if outcome.stopped.is_empty() { "" } else { ", stop" };
    let row = format!("0,{},{},{}", cell.columns()?, Law::Barrier.name(), kept.columns());
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
        let outcome = Outcome::of_run(&self.cell, settings)?;
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

fn header() -> String {
    format!("run,{COLUMNS},{RESULTS}")
}

/// A cell under one of the laws.
fn row(cells: &[Cell], id: usize) -> Result<String> {
    let (cell, law) = (&cells[id / Law::ALL.len()], Law::ALL[id % Law::ALL.len()]);
    let outcome = Outcome::of(cell, law, PHASES)?;
    Ok(format!("{id},{},{},{}", cell.columns()?, law.name(), outcome.columns()))
}

/// Returns true if a later tap is harder than a first one, by more than 2 %, and than the base itself may press.
fn grows(first_peak_n: f64, later_n: f64) -> bool {
    later_n > 1.02 * first_peak_n.max(STOP_SHARE * ProtectionConfig::default().force_limit_n)
}

/// The first of some forces, and the largest of the others, N.
fn first_and_later(forces_n: &[f64]) -> [f64; 2] {
    let [first, later @ ..] = forces_n else { return [0.0; 2] };
    [*first, later.iter().copied().fold(0.0, f64::max)]
}

/// Result of a cell's worst phase; flange, taps and stops of any phase.
#[derive(Clone, Debug, Default)]
struct Outcome {
    approach_m_s: f64,
    first_touch_n: f64,
    impact_n: f64,
    peak_n: f64,
    /// From the first touch, s.
    peak_after_s: f64,
    /// From the first touch until the cover feels anything, s.
    felt_after_s: f64,
    /// From the first touch until the law bounds the base for it, s; NaN if it never does.
    noticed_after_s: f64,
    /// Force that remains when the base does its utmost from that reading on, N.
    least_n: f64,
    taps: usize,
    /// A later peak is higher than the first of the same phase, and than the base itself may press.
    grows: bool,
    /// A later contact is harder than the first of the same phase: somebody was let go of in between.
    again: bool,
    /// Highest first peak, and highest later one, N.
    first_peak_n: f64,
    later_n: f64,
    flange_mm: f64,
    stopped: String,
}

impl Outcome {
    /// The worst of some of the phases, evenly apart.
    fn of(cell: &Cell, law: Law, phases: u32) -> Result<Self> {
        let mut worst = Self::default();
        for phase in (0..PHASES).step_by((PHASES / phases.clamp(1, PHASES)) as usize) {
            let one = Self::of_phase(cell, law, phase)?;
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
            let peaks = Self { first_touch_n, impact_n, first_peak_n, later_n, ..worst };
            worst = Self { taps, grows, again, flange_mm, stopped, ..peaks };
        }
        Ok(worst)
    }

    fn of_phase(cell: &Cell, law: Law, phase: u32) -> Result<Self> {
        Self::of_run(cell, &cell.settings(law, phase)?)
    }

    fn of_run(cell: &Cell, settings: &Settings) -> Result<Self> {
        Self::of_meeting(cell.meeting, &cell.meeting_there(), settings)
    }

    /// Lets somebody meet the robot as `meeting` says, `there` being cover, body and base as they are.
    fn of_meeting(meeting: Meeting, there: &bound::Meeting, settings: &Settings) -> Result<Self> {
        let mut rig = Rig::start(settings, &settings.collision_scene()?)?;
        if meeting != Meeting::ByHand {
            rig.move_target(collision::towards_person(settings))?;
        }
        let touching = |row: &Row| row.total_force_n > 0.0;
        let mut first = None;
        loop {
            match rig.rows.last().map(|row| meeting.hand(settings, row)) {
                Some(hand) => rig.run_for(LOOK_S, hand)?,
                None => rig.run_for(LOOK_S, |_| Loads::default())?,
            }
            first = first.or_else(|| rig.rows.iter().position(touching));
            let seen_s =
                first.map_or(0.0, |first| rig.rows.last().map_or(0.0, |row| row.t_s) - rig.rows[first].t_s);
            if rig.stopped.is_some() || rig.sim_s > LONGEST_S || seen_s > WATCHED_S {
                break;
            }
        }
        let stopped = rig.stopped.as_deref().map_or("", |why| why.split(':').next().unwrap_or("stopped"));
        let stopped = stopped.to_owned();
        let Some(first) = first else { return Ok(Self { stopped, ..Self::default() }) };
        let rows = &rig.rows;
        let measures = Measures::of(rows, 1e-3);
        let since = |row: &Row| row.t_s - rows[first].t_s;
        let contact = &rows[first..];
        let most = contact.iter().max_by(|a, b| a.largest_force_n.total_cmp(&b.largest_force_n));
        let felt = contact.iter().find(|row| (0..TAXELS).any(|i| row.force_sensed[i] > 0.0));
        // a false alarm before the touch is none of it
        let alarmed = first == 0 || rows[first - 1].is_bounded;
        let noticed = contact.iter().find(|row| !alarmed && row.is_bounded).or(felt);
        let closing_m_s = approach_m_s(&rows[first.saturating_sub(1)], settings);
        let felt_after_s = felt.map_or(f64::NAN, since);
        let [first_peak_n, later_n] = first_and_later(&measures.peaks_n);
        let [first_contact_n, again_n] = first_and_later(&measures.contacts_n);
        Ok(Self {
            approach_m_s: closing_m_s,
            first_touch_n: measures.first_touch_n,
            impact_n: measures.impact_n,
            peak_n: peak_force_n(rows),
            peak_after_s: most.map_or(0.0, since),
            felt_after_s,
            noticed_after_s: noticed.map_or(f64::NAN, since),
            least_n: there.least_n(closing_m_s, felt_after_s),
            taps: measures.peaks_n.len(),
            grows: grows(first_peak_n, later_n),
            again: grows(first_contact_n, again_n),
            first_peak_n,
            later_n,
            flange_mm: measures.flange_max_mm,
            stopped,
        })
    }

    fn columns(&self) -> String {
        format!(
            "{:.4},{:.2},{:.2},{:.2},{:.3},{:.3},{:.2},{},{},{},{:.2},{:.2},{:.2},{}",
            self.approach_m_s,
            self.first_touch_n,
            self.impact_n,
            self.peak_n,
            self.peak_after_s,
            self.felt_after_s,
            self.least_n,
            self.taps,
            self.grows,
            self.again,
            self.first_peak_n,
            self.later_n,
            self.flange_mm,
            self.stopped
        )
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
        for line in parallel::run("protection", &cells, short_line, |_| ()) {
            // An empty cell has one space in a table that was a CSV file.
            let line = line.unwrap().replace("|  |", "| |");
            assert!(shown.contains(&line), "`moca-lab docs --only protection-short` writes it anew: {line}");
        }
    }

    #[test]
    fn first_cells_of_campaign_match_its_file() {
        if crate::docs::shown("protection-campaign").is_none() {
            return; // where sines are rounded in another way, last digits are others
        }
        let text = std::fs::read_to_string(CAMPAIGN).unwrap();
        let cells = Cell::sample(2, 1);
        // under the barrier
        for id in [1, 4] {
            let fresh = row(&cells, id).unwrap();
            assert!(text.lines().any(|line| line == fresh), "{fresh}");
        }
    }
}
