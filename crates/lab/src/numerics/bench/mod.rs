//! `moca-lab bench`: every performance figure as a ratio of two things that ran in turns, with its spread and its error.

mod batch;
mod engines;
mod ticks;

use crate::numerics::economy::{self, Standing};
use crate::study::{self, Column};
use anyhow::{Result, ensure};
use std::fmt::Write as _;
use std::path::{Path, PathBuf};

/// Turns of a short row; a long one takes a third of them.
const TURNS: usize = 45;
/// Sizes of the batches.
const ROBOTS: [usize; 4] = [1, 8, 64, 1024];
/// Folder of the peers' data and program.
const ANCHOR: &str = "target/anchor";
/// Peers of the solver and the command that builds them.
const SOLVERS: &str = "qpmad, eiquadprog and DAQP: `crates/qp/compare/compare.py` builds them and prints the ratios of `moca-qp`";
/// Library that this command builds.
const SOLVERS_LIBRARY: &str = "target/qp-peers/libpeers.so";

/// Prints every performance figure as a ratio taken in turns, with its spread and its error.
#[derive(clap::Args)]
pub(crate) struct Arguments {
    /// Turns of a row, 3 to 10000.
    #[arg(long, default_value_t = TURNS)]
    turns: usize,
    /// Folder that `tests/peers/pinocchio/time` has filled.
    #[arg(long, default_value = ANCHOR)]
    anchor: PathBuf,
}

/// One figure.
struct Row {
    what: String,
    next_to: String,
    /// Speed over that of the other, one for each turn.
    ratios: Vec<f64>,
    error: f64,
    /// Largest allowed error.
    bound: f64,
    /// Unit of the error.
    unit: &'static str,
}

impl Row {
    fn new(what: String, next_to: String, unit: &'static str, bound: f64) -> Self {
        Self { what, next_to, ratios: Vec::new(), error: 0.0, bound, unit }
    }

    /// Takes an error in; NaN stays.
    fn raise_error(&mut self, error: f64) {
        self.error = larger(self.error, error);
    }

    fn quantile(&self, share: f64) -> f64 {
        let mut sorted = self.ratios.clone();
        sorted.sort_by(f64::total_cmp);
        #[expect(
            clippy::cast_possible_truncation,
            clippy::cast_sign_loss,
            reason = "a share of a short list"
        )]
        let place = (moca_experiments::count(sorted.len().saturating_sub(1)) * share).round() as usize;
        sorted.get(place).copied().unwrap_or(f64::NAN)
    }
}

/// Larger error of two; NaN stays, which `f64::max` would drop.
fn larger(largest: f64, error: f64) -> f64 {
    if error <= largest || largest.is_nan() { largest } else { error }
}

/// Rows of a part, and the peers that are missing for others.
#[derive(Default)]
struct Found {
    rows: Vec<Row>,
    missing: Vec<&'static str>,
}

const COLUMNS: &[Column<Row>] = &[
    ("what", |row| row.what.clone()),
    ("next to", |row| row.next_to.clone()),
    ("times as fast, median", |row| format!("{:.2}", row.quantile(0.5))),
    ("quartiles", |row| format!("{:.2} to {:.2}", row.quantile(0.25), row.quantile(0.75))),
    ("turns", |row| row.ratios.len().to_string()),
    ("error", |row| format!("{:.0e} {}", row.error, row.unit)),
    ("allowed", |row| format!("{:.0e}", row.bound)),
];

pub(crate) fn run(arguments: &Arguments) -> Result<()> {
    let turns = arguments.turns;
    ensure!((3..=10_000).contains(&turns), "--turns {turns} is outside 3 to 10000");
    study::print(&text(&measured(turns, &ROBOTS, &arguments.anchor)?, Some(&batch::cost(256)?))?);
    Ok(())
}

/// The table of the documents.
pub(crate) fn markdown() -> Result<String> {
    let found = measured(TURNS, &ROBOTS, Path::new(ANCHOR))?;
    ensure!(
        found.missing.iter().all(|missing| *missing != ticks::MISSING),
        "missing here: {}",
        ticks::MISSING
    );
    // what this machine lacks is nothing that a reader needs
    text(&Found { missing: Vec::new(), ..found }, Some(&batch::cost(256)?)).map(|table| format!("\n{table}"))
}

fn measured(turns: usize, sizes: &[usize], anchor: &Path) -> Result<Found> {
    let long = (turns / 3).max(1);
    let mut found = ticks::found(anchor, long)?;
    found.rows.extend(steps(turns)?);
    found.rows.extend(engines::rows(turns)?);
    found.rows.extend(batch::rows(sizes, long)?);
    if !Path::new(SOLVERS_LIBRARY).exists() {
        found.missing.push(SOLVERS);
    }
    Ok(found)
}

/// Bare steps of the collision's scene, with all that it does not need and without.
fn steps(turns: usize) -> Result<Vec<Row>> {
    let (scenes, [until_touch, rounding]) = economy::leaner()?;
    let mut robots = scenes.iter().map(Standing::new).collect::<Result<Vec<_>>>()?;
    let mut rows = [
        Row::new(
            "step of the lean scene, MuJoCo".into(),
            "with geoms and sensors".into(),
            "m, rad until a touch",
            0.0,
        ),
        Row::new(
            "step of the lean scene, analytic".into(),
            "bare `mj_step`".into(),
            "m, rad",
            economy::ROUNDED.0,
        ),
    ];
    rows[0].raise_error(until_touch);
    rows[1].raise_error(rounding);
    for _ in 0..turns {
        let mut step_s = [0.0; 3];
        for (step_s, robot) in step_s.iter_mut().zip(&mut robots) {
            *step_s = robot.step_s()?;
        }
        rows[0].ratios.push(step_s[0] / step_s[1]);
        rows[1].ratios.push(step_s[1] / step_s[2]);
    }
    Ok(rows.into())
}

/// Table, memory of a robot, and what is missing.
///
/// # Errors
/// A row whose error is beyond its bound.
fn text(found: &Found, robot: Option<&batch::Cost>) -> Result<String> {
    for Row { what, next_to, error, bound, unit, .. } in &found.rows {
        ensure!(error <= bound, "{what} next to {next_to}: {error:.1e} {unit}, more than {bound:.0e}");
    }
    let mut text = study::table(COLUMNS, &found.rows);
    if let Some(batch::Cost { kilobytes, build_ms }) = robot {
        write!(
            text,
            "\nA robot of a batch holds {kilobytes:.0} kB and takes {build_ms:.2} ms of CPU to build.\n"
        )?;
    }
    for missing in &found.missing {
        write!(text, "\nMissing here: {missing}.\n")?;
    }
    Ok(text)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Sizes that a test can step.
    const FEW: [usize; 2] = [1, 8];

    #[test]
    fn bench_has_every_row_of_the_documents_and_names_missing_peers() {
        let found = measured(3, &FEW, Path::new("no such folder")).unwrap();
        let printed = text(&found, None).unwrap();
        for row in &found.rows {
            assert!(row.error <= row.bound, "{}: {}", row.what, row.error);
            assert!(row.ratios.iter().all(|ratio| ratio.is_finite() && *ratio > 0.0), "{:?}", row.ratios);
        }
        assert!(
            printed.contains("Missing here: Pinocchio") && printed.contains("tests/peers/pinocchio/time")
        );
        let results = include_str!("../../../../../docs/results.md");
        let table = results.split("<!-- end of bench -->").next().unwrap();
        let table = table.rsplit("<!-- moca-lab docs bench").next().unwrap();
        let shown: Vec<&str> = table
            .lines()
            .filter_map(study::cells)
            .map(|cells| cells[0])
            .filter(|what| *what != "what" && !what.starts_with("---"))
            .collect();
        let larger = ROBOTS.iter().filter(|size| !FEW.contains(size)).map(|size| batch::name(*size));
        let ours: Vec<String> = found.rows.iter().map(|row| row.what.clone()).chain(larger).collect();
        let of_peers = |what: &&&str| what.starts_with("our whole-body tick");
        let rest: Vec<&&str> = shown.iter().filter(|what| !of_peers(what)).collect();
        assert_eq!(rest, ours.iter().map(String::as_str).collect::<Vec<_>>().iter().collect::<Vec<_>>());
    }

    #[test]
    fn error_beyond_its_bound_or_not_a_number_is_refused() {
        for error in [2.0, f64::NAN] {
            let mut row = Row::new("a".into(), "b".into(), "m", 1.0);
            row.raise_error(0.5);
            row.raise_error(error);
            row.raise_error(0.5);
            let found = Found { rows: vec![row], ..Found::default() };
            assert!(text(&found, None).unwrap_err().to_string().contains("more than"), "{error}");
        }
    }

    #[test]
    fn quartiles_are_those_of_the_turns() {
        let mut row = Row::new("a".into(), "b".into(), "m", 1.0);
        row.ratios = vec![5.0, 1.0, 4.0, 2.0, 3.0];
        assert_eq!((COLUMNS[2].1(&row), COLUMNS[3].1(&row)), ("3.00".into(), "2.00 to 4.00".into()));
    }
}
