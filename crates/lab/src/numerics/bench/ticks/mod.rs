//! Whole-body tick on the data of an independent implementation, in turns with others' ticks on the same data.
//!
//! The folder holds model.csv, params.csv, inputs.csv and ref.csv as `tests/peers/pinocchio/generate.py` writes them, and the
//! program `tick` of the others. Our side is [`moca_experiments::timed::ticks`].

mod data;

use super::{Found, Row, larger};
use anyhow::{Context as _, Result, ensure};
use data::Anchor;
use moca_experiments::timed::ticks::{Input, Ticker};
use moca_experiments::{JOINTS, count};
use moca_wbc::ControlError;
use moca_wbc::model::Dynamics;
use moca_wbc::opspace::WholeBodyForce;
use serde::Deserialize;
use std::hint::black_box;
use std::path::Path;
use std::process::Command;
use std::time::Instant;

/// Largest relative error of a torque.
const TOLERANCE: f64 = 1e-9;
/// Passes over all inputs in a turn.
const PASSES: usize = 20;
/// Peers of this part and the command that installs and builds them.
pub(super) const MISSING: &str =
    "Pinocchio, CasADi and CppADCodeGen: `tests/peers/pinocchio/time target/anchor` installs and builds them";

/// Time of another implementation's tick, as its program prints it.
#[derive(Deserialize)]
struct Peer {
    name: String,
    ns_median: f64,
    rel_error: f64,
}

/// Rows of our tick next to each peer's, or the name of what is missing in `folder`.
pub(super) fn found(folder: &Path, turns: usize) -> Result<Found> {
    let program = folder.join("tick");
    if !program.exists() {
        return Ok(Found { missing: vec![MISSING], ..Found::default() });
    }
    let anchor = Anchor::read(folder)?;
    let mut rows: Vec<Row> = Vec::new();
    for _ in 0..turns {
        let ours = [passes(&anchor, Ticker::general)?, passes(&anchor, Ticker::block)?];
        for (i, peer) in peers(&program, folder)?.into_iter().enumerate() {
            let (law, tick) =
                if peer.name.ends_with("general-h") { ("any H", &ours[0]) } else { ("block H", &ours[1]) };
            if rows.len() == i {
                let what = format!("our whole-body tick, {law}");
                rows.push(Row::new(what, peer.name, "of the largest torque", TOLERANCE));
            }
            rows[i].ratios.push(peer.ns_median / tick.ns_median);
            rows[i].raise_error(tick.rel_error);
            rows[i].raise_error(peer.rel_error);
        }
    }
    Ok(Found { rows, ..Found::default() })
}

fn peers(program: &Path, folder: &Path) -> Result<Vec<Peer>> {
    let done = Command::new(program).arg(folder).arg(PASSES.to_string()).output()?;
    ensure!(done.status.success(), "{}: {}", program.display(), String::from_utf8_lossy(&done.stderr));
    let text = String::from_utf8(done.stdout)?;
    text.lines()
        .map(|line| {
            serde_json::from_str(line).with_context(|| format!("{} printed {line}", program.display()))
        })
        .collect()
}

/// Time and largest relative error of our own tick.
struct Own {
    ns_median: f64,
    rel_error: f64,
}

fn passes(
    anchor: &Anchor,
    tick: impl Fn(
        &Ticker,
        &mut Dynamics<JOINTS, f64>,
        &Input,
    ) -> Result<WholeBodyForce<JOINTS, f64>, ControlError>,
) -> Result<Own> {
    let mut room = Dynamics::unset();
    let mut rel_error = 0.0_f64;
    for (input, reference) in anchor.inputs.iter().zip(&anchor.references) {
        rel_error = larger(rel_error, relative_error(&tick(&anchor.ticker, &mut room, input)?, reference));
    }
    let mut ns = Vec::with_capacity(PASSES);
    for _ in 0..PASSES {
        let start = Instant::now();
        for input in &anchor.inputs {
            black_box(tick(black_box(&anchor.ticker), black_box(&mut room), black_box(input))?);
        }
        ns.push(start.elapsed().as_secs_f64() * 1e9 / count(anchor.inputs.len()));
    }
    ns.sort_by(f64::total_cmp);
    Ok(Own { ns_median: ns[PASSES / 2], rel_error })
}

/// max|τ − ref| / max|ref| of one row.
fn relative_error(force: &WholeBodyForce<JOINTS, f64>, reference: &[f64; 10]) -> f64 {
    let scale = reference.iter().fold(0.0_f64, |most, r| most.max(r.abs()));
    let values = force.base.iter().chain(&force.arm).zip(reference);
    values.fold(0.0, |worst, (value, reference)| larger(worst, (value - reference).abs() / scale))
}
