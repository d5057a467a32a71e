//! Collisions of `scenes/sweep.toml` on either engine beside as many bare steps of MuJoCo, in turn: what slows the machine down
//! meanwhile slows them all.

use super::Standing;
use crate::study::{self, Column};
use anyhow::{Context, Result};
use moca_experiments::campaign::Table as _;
use moca_experiments::collision;
use moca_experiments::cpu_time;
use moca_experiments::parallel::Count;
use moca_experiments::sweep::Sweep;
use moca_sim::Engine;

const PLAN: &str = include_str!("../../../../../scenes/sweep.toml");
const ENGINES: [(Engine, &str); 2] = [(Engine::Analytic, "analytic"), (Engine::MuJoCo, "MuJoCo")];

/// One collision on each of [`ENGINES`].
struct Turn {
    /// CPU time of as many bare steps over that of the run.
    of_bare: [f64; 2],
    /// Largest force on the person, N.
    peak_n: [f64; 2],
}

impl Turn {
    fn of(sweep: &Sweep, id: usize) -> Result<Self> {
        let mut settings = sweep.settings(&sweep.values(id))?;
        let mut turn = Self { of_bare: [0.0; 2], peak_n: [0.0; 2] };
        for (i, (engine, _)) in ENGINES.into_iter().enumerate() {
            settings.engine = Engine::MuJoCo;
            let mut standing = Standing::new(&settings.collision_scene()?)?;
            settings.engine = engine;
            let (report, run_s) = cpu_time::timed(|| collision::single(&settings));
            let report = report?;
            let steps = report.sim_s() / (1e-3 * settings.step_ms);
            let stretches = (steps / f64::from(Standing::STRETCH)).ceil();
            let (mut bare_s, mut stretch) = (0.0, 0.0);
            while stretch < stretches {
                bare_s += standing.step_s()? * steps / stretches;
                stretch += 1.0;
            }
            turn.of_bare[i] = bare_s / run_s;
            turn.peak_n[i] = report.measures.peak_force_n;
        }
        Ok(turn)
    }
}

/// An engine's name, and the ratios of its runs from the least to the most.
const COLUMNS: &[Column<(&str, Vec<f64>)>] = &[
    ("engine", |(name, _)| (*name).into()),
    ("runs per CPU time over those of bare `mj_step`, median", |(_, of)| format!("{:.2}", of[of.len() / 2])),
    ("least", |(_, of)| format!("{:.2}", of[0])),
    ("most", |(_, of)| format!("{:.2}", of[of.len() - 1])),
];

/// A row for each engine, from so many collisions of the plan.
pub(super) fn markdown(runs: usize) -> Result<String> {
    let sweep = Sweep::parse(PLAN, None)?;
    let mut progress = Count::new("engines", runs);
    let mut turns = Vec::new();
    for turn in 0..runs {
        turns.push(Turn::of(&sweep, turn * (sweep.rows() / runs).max(1) % sweep.rows())?);
        progress.one_more();
    }
    let apart_n = turns.iter().map(|turn| (turn.peak_n[0] - turn.peak_n[1]).abs()).fold(0.0, f64::max);
    let ratios = |(i, (_, name)): (usize, (Engine, &'static str))| {
        let mut ratios: Vec<f64> = turns.iter().map(|turn| turn.of_bare[i]).collect();
        ratios.sort_unstable_by(f64::total_cmp);
        (name, ratios)
    };
    let table = study::table(COLUMNS, &ENGINES.into_iter().enumerate().map(ratios).collect::<Vec<_>>());
    let most_n = turns.iter().map(|turn| turn.peak_n[0]).reduce(f64::max).context("no run")?;
    Ok(format!(
        "{table}\n{runs} collisions. Their peak forces, {most_n:.1} N at most, differ by {apart_n:.1e} N at most.\n"
    ))
}

#[cfg(test)]
#[test]
fn collisions_of_the_plan_peak_alike_on_both_engines() {
    let sweep = Sweep::parse(PLAN, None).unwrap();
    for id in [0, sweep.rows() - 1] {
        let turn = Turn::of(&sweep, id).unwrap();
        let [analytic_n, mujoco_n] = turn.peak_n;
        assert!(mujoco_n > 1.0 && (analytic_n - mujoco_n).abs() < 1e-9, "run {id}: {:?}", turn.peak_n);
        assert!(turn.of_bare.iter().all(|ratio| ratio.is_finite() && *ratio > 0.0), "{:?}", turn.of_bare);
    }
}
