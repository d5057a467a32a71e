//! `moca-lab docs --only peers`: the closed loop beside the same one on engines, and with a controller, that are not ours.
//!
//! Results of the others are in `tests/fixtures/peers`, written by `tests/peers/run`. One is discrete like ours and
//! compared at the same step. The other is continuous and compared with our limit of small steps.

use crate::paper::{push, push::Push};
use anyhow::{Context, Result, bail, ensure};
use moca_experiments::closed_loop::{Rig, Row};
use moca_experiments::collision;
use moca_experiments::parallel;
use moca_experiments::settings::Settings;
use moca_msgs::Law;
use std::fmt::Write as _;

const FOLDER: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/../../tests/fixtures/peers");
const COLUMNS: &str = "t_s,base_x_m,base_y_m,base_yaw_rad,flange_x_m,flange_y_m,flange_z_m,taxel_n";
/// Ticks from one row of a file to the next.
const EVERY: usize = 20;
/// The two steps that the table's limit is taken from, ms.
const SMALL_MS: [f64; 2] = [1.0 / 64.0, 1.0 / 128.0];
/// Phase of the peers' sensor at the start of the run.
const THEIR_PHASE: &str = "sensor.phase_ms=8";
/// Setting for a continuous plant: where a leg begins to slip, its force has no derivative.
const WITHOUT_FRICTION: &str = "person.friction=0";

const EXPERIMENTS: [&str; 3] = ["push", "b2-i", "collision"];

/// One run, or the limit of some.
#[derive(Clone, Debug)]
struct Trace {
    peak_n: f64,
    flange_rms_mm: f64,
    /// As [`COLUMNS`].
    rows: Vec<[f64; 8]>,
}

/// Largest differences along two runs.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Apart {
    base_m: f64,
    yaw_rad: f64,
    flange_m: f64,
    force_n: f64,
}

impl Trace {
    fn read(engine: &str, experiment: &str) -> Result<Self> {
        let path = format!("{FOLDER}/{engine}-{experiment}.csv");
        let text = std::fs::read_to_string(&path).with_context(|| format!("cannot read {path}"))?;
        let named = |name: &str| -> Result<f64> {
            let line = text.lines().find_map(|line| line.strip_prefix(&format!("# {name}=")));
            line.with_context(|| format!("{path} has no {name}"))?.parse().context("not a number")
        };
        let mut lines = text.lines().filter(|line| !line.starts_with('#'));
        ensure!(lines.next() == Some(COLUMNS), "{path}: expected the columns {COLUMNS}");
        let rows = lines.map(|line| -> Result<[f64; 8]> {
            let values: Vec<f64> = line.split(',').map(str::parse).collect::<Result<_, _>>()?;
            <[f64; 8]>::try_from(values).map_err(|values| anyhow::anyhow!("{path}: {} values", values.len()))
        });
        Ok(Self {
            peak_n: named("peak_n")?,
            flange_rms_mm: named("flange_rms_mm")?,
            rows: rows.collect::<Result<_>>()?,
        })
    }

    /// Our own loop.
    fn run(experiment: &str, assignments: &[String]) -> Result<Self> {
        let law = if experiment == "b2-i" { Law::FollowMe } else { Law::Impedance };
        let mut settings = Settings::paper(law);
        if experiment == "collision" {
            collision::defaults(&mut settings);
        }
        settings.set_all(["sensor=ideal", "duration=5", THEIR_PHASE])?;
        settings.set_all(assignments)?;
        let (rig, taxel) = match experiment {
            "collision" => (collision::once(&settings)?, 0),
            "push" => (pushed(&settings, &push::single(&[5], 20.0))?, 5),
            "b2-i" => (pushed(&settings, &Push::taxels("", &[]).and_flange([15.0, 0.0, 0.0]))?, 0),
            _ => bail!("{experiment}: not one of {}", EXPERIMENTS.join(", ")),
        };
        ensure!(rig.stopped.is_none(), "the robot stopped: {:?}", rig.stopped);
        let force_n = |row: &Row| row.force_true[taxel];
        let row = |row: &Row| {
            let ([x, y, yaw], [fx, fy, fz]) = (row.base_pose_world, row.flange_world);
            [row.t_s, x, y, yaw, fx, fy, fz, force_n(row)]
        };
        Ok(Self {
            peak_n: rig.rows.iter().map(force_n).fold(0.0, f64::max),
            flange_rms_mm: 1e3 * moca_experiments::measure::rms(rig.rows.iter().map(Row::flange_error_m)),
            rows: rig.rows.iter().step_by(EVERY).map(row).collect(),
        })
    }

    /// Returns the limit of our loop from two steps of which one is half the other: its error is of first order in the step.
    fn limit(experiment: &str, steps_ms: [f64; 2]) -> Result<Self> {
        let at = |step_ms: &f64| {
            Self::run(
                experiment,
                &["engine=analytic".into(), WITHOUT_FRICTION.into(), format!("step_ms={step_ms}")],
            )
        };
        let runs = parallel::run("limit", &steps_ms, at)?;
        let [coarse, fine] = &runs[..] else { bail!("two steps") };
        let towards = |coarse: f64, fine: f64| 2.0 * fine - coarse;
        let row = |(a, b): (&[f64; 8], &[f64; 8])| std::array::from_fn(|i| towards(a[i], b[i]));
        Ok(Self {
            peak_n: towards(coarse.peak_n, fine.peak_n),
            flange_rms_mm: towards(coarse.flange_rms_mm, fine.flange_rms_mm),
            rows: coarse.rows.iter().zip(&fine.rows).map(row).collect(),
        })
    }

    fn apart(&self, other: &Self) -> Result<Apart> {
        let (ours, theirs) = (self.rows.len(), other.rows.len());
        ensure!(ours == theirs && ours > 100, "{ours} rows against {theirs}");
        Ok(self.rows.iter().zip(&other.rows).fold(Apart::default(), |apart, (a, b)| {
            let off = |i: usize| (a[i] - b[i]).abs();
            Apart {
                base_m: apart.base_m.max(off(1).hypot(off(2))),
                yaw_rad: apart.yaw_rad.max(off(3)),
                flange_m: apart.flange_m.max(off(4).hypot(off(5)).hypot(off(6))),
                force_n: apart.force_n.max(off(7)),
            }
        }))
    }
}

fn pushed(settings: &Settings, push: &Push) -> Result<Rig> {
    let mut rig = Rig::start(settings, &settings.free_scene())?;
    push::run(&mut rig, settings, std::slice::from_ref(push))?;
    Ok(rig)
}

/// Ours in one way beside theirs.
struct Compared {
    ours: Trace,
    theirs: Trace,
    apart: Apart,
}

/// Which run of ours stands beside which of theirs.
enum Way {
    /// Step for step.
    Discrete,
    /// Our limit next to the continuous one; two steps, ms.
    Limit([f64; 2]),
    /// Error of the default step.
    DefaultStep,
}

fn compared(experiment: &str, way: &Way) -> Result<Compared> {
    let (peer, ours) = match way {
        Way::Discrete => ("mujoco_pinocchio", Trace::run(experiment, &[])?),
        Way::Limit(steps_ms) => ("drake", Trace::limit(experiment, *steps_ms)?),
        Way::DefaultStep => ("drake", Trace::run(experiment, &[WITHOUT_FRICTION.into()])?),
    };
    let theirs = Trace::read(peer, experiment)?;
    let apart = ours.apart(&theirs)?;
    Ok(Compared { ours, theirs, apart })
}

/// The table.
pub(crate) fn markdown() -> Result<String> {
    let mut out = String::from(
        "| experiment | beside | ours | base, m | yaw, rad | flange, m | force, N | flange RMS, mm: ours, theirs | \
         largest force, N: ours, theirs |\n|---|---|---|---|---|---|---|---|---|\n",
    );
    for experiment in EXPERIMENTS {
        for (names, way) in [
            ("mujoco_pinocchio | 1 ms, as theirs", Way::Discrete),
            ("drake | limit of small steps", Way::Limit(SMALL_MS)),
            ("drake | 1 ms, the default", Way::DefaultStep),
        ] {
            let Compared { ours, theirs, apart } = compared(experiment, &way)?;
            let Apart { base_m, yaw_rad, flange_m, force_n } = apart;
            // Writing to a string cannot fail.
            let _ = writeln!(
                out,
                "| {experiment} | {names} | {base_m:.0e} | {yaw_rad:.0e} | {flange_m:.0e} | {force_n:.0e} | \
                 {:.5}, {:.5} | {:.5}, {:.5} |",
                ours.flange_rms_mm, theirs.flange_rms_mm, ours.peak_n, theirs.peak_n
            );
        }
    }
    Ok(out)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Same step, other model, other law, other contact code: rounding is all that may differ.
    #[test]
    fn the_independent_discrete_loop_goes_the_same_way() {
        for experiment in EXPERIMENTS {
            let Compared { ours, theirs, apart } = compared(experiment, &Way::Discrete).unwrap();
            println!("{experiment}: {apart:?}, peak {} and {} N", ours.peak_n, theirs.peak_n);
            assert!(
                apart.base_m < 1e-9 && apart.yaw_rad < 1e-9 && apart.flange_m < 1e-9,
                "{experiment}: {apart:?}"
            );
            assert!(apart.force_n < 1e-7, "{experiment}: {apart:?}");
        }
    }

    /// Drake integrates the same robot with error control: nothing of MuJoCo and none of our integration. What steps of
    /// 1/16 and 1/32 ms leave of the collision's limit is of second order; those of the table are four times as small.
    #[test]
    fn limit_of_small_steps_matches_drake() {
        for (experiment, within) in [("push", 1e-7), ("b2-i", 1e-7), ("collision", 4e-6)] {
            let way = Way::Limit([1.0 / 16.0, 1.0 / 32.0]);
            let Compared { ours, theirs, apart } = compared(experiment, &way).unwrap();
            println!("{experiment}: {apart:?}, peak {} and {} N", ours.peak_n, theirs.peak_n);
            let Apart { base_m, yaw_rad, flange_m, .. } = apart;
            assert!(base_m < within && yaw_rad < within && flange_m < within, "{experiment}: {apart:?}");
            let off = (ours.peak_n - theirs.peak_n).abs();
            assert!(off <= 2e-5 * theirs.peak_n, "{} {}", ours.peak_n, theirs.peak_n);
        }
    }
}
