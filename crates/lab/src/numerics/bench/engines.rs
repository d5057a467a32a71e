//! Collisions of `scenes/sweep.toml` on either engine beside as many bare steps of MuJoCo, in turn: what slows the machine down
//! meanwhile slows them all.

use super::Row;
use crate::numerics::economy::Standing;
use anyhow::Result;
use moca_experiments::campaign::Table as _;
use moca_experiments::collision;
use moca_experiments::cpu_time;
use moca_experiments::sweep::Sweep;
use moca_sim::Engine;

const PLAN: &str = include_str!("../../../../../scenes/sweep.toml");
/// Largest difference of the two engines' peak forces, N.
const PEAK_APART_N: f64 = 1e-9;
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

/// Rows of both engines from so many collisions of the plan.
pub(super) fn rows(runs: usize) -> Result<Vec<Row>> {
    let sweep = Sweep::parse(PLAN, None)?;
    let mut rows = ENGINES.map(|(_, name)| {
        Row::new(
            format!("collision of a sweep, {name}"),
            "as many bare `mj_step`".into(),
            "N of peak force",
            PEAK_APART_N,
        )
    });
    for turn in 0..runs {
        let turn = Turn::of(&sweep, turn * (sweep.rows() / runs).max(1) % sweep.rows())?;
        for (row, ratio) in rows.iter_mut().zip(turn.of_bare) {
            row.ratios.push(ratio);
            row.raise_error((turn.peak_n[0] - turn.peak_n[1]).abs());
        }
    }
    Ok(rows.into())
}

#[cfg(test)]
#[test]
fn collisions_of_the_plan_peak_alike_on_both_engines() {
    let sweep = Sweep::parse(PLAN, None).unwrap();
    for id in [0, sweep.rows() - 1] {
        let turn = Turn::of(&sweep, id).unwrap();
        let [analytic_n, mujoco_n] = turn.peak_n;
        assert!(
            mujoco_n > 1.0 && (analytic_n - mujoco_n).abs() < PEAK_APART_N,
            "run {id}: {:?}",
            turn.peak_n
        );
        assert!(turn.of_bare.iter().all(|ratio| ratio.is_finite() && *ratio > 0.0), "{:?}", turn.of_bare);
    }
}
