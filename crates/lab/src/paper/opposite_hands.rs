//! `moca-lab docs --only opposite-hands`: B2-iv, hands that cancel, as each board feels them.

use super::push::{self, Outcome};
use super::pushes;
use anyhow::{Context, Result};
use moca_experiments::closed_loop::Rig;
use moca_experiments::parallel;
use moca_experiments::settings::Settings;
use moca_msgs::Law;
use std::fmt::Write as _;

/// Sensors of the cover, and the curve with which each reads a force from a count.
pub(super) const COVERS: &[(&str, &[&str])] = &[
    ("the true force", &["sensor=ideal"]),
    ("stock-2018, the paper's line", &["sensor.firmware=stock-2018"]),
    ("stock-2015, the paper's line", &["sensor.firmware=stock-2015"]),
    ("moca, the paper's line", &["sensor.firmware=moca"]),
    ("stock-2018, the foam's own curve", &["sensor.firmware=stock-2018", "board.model=pu-ld30"]),
    ("stock-2015, the foam's own curve", &["sensor.firmware=stock-2015", "board.model=pu-ld30"]),
    ("moca, the foam's own curve", &["sensor.firmware=moca", "board.model=pu-ld30"]),
];

/// B2-iv from the home posture.
pub(super) struct Felt {
    pub outcome: Outcome,
    /// Largest sum of what is felt of both hands once the ramp is over, N: a dead band below it moves.
    pub uncancelled_n: f64,
}

pub(super) fn settings(assignments: &[&str], flange: &str) -> Result<Settings> {
    let mut settings = Settings::paper(Law::FollowMe);
    settings.set_all(assignments.iter().chain([&flange]))?;
    Ok(settings)
}

pub(super) fn felt(settings: &Settings) -> Result<Felt> {
    let mut rig = Rig::start(settings, &settings.free_scene())?;
    let outcome = push::run(&mut rig, settings, &[pushes::opposite_hands()])?.pop();
    let pressed = rig.rows.iter().filter(|row| (1.0..settings.push_s - settings.ramp_s).contains(&row.t_s));
    let sum_n = pressed.map(|row| (row.wrench_sensed[0] + row.flange_wrench_felt_world[0]).abs());
    let uncancelled_n = sum_n.fold(0.0, f64::max);
    Ok(Felt { outcome: outcome.context("the robot stopped")?, uncancelled_n })
}

/// The table.
pub(crate) fn markdown() -> Result<String> {
    let flanges = [("true", "flange=true"), ("observed", "flange=observed")];
    let cases: Vec<_> = COVERS.iter().flat_map(|cover| flanges.map(|flange| (cover, flange))).collect();
    let runs = parallel::run(
        "opposite hands",
        &cases,
        |((_, cover), (_, flange))| felt(&settings(cover, flange)?),
        |_| (),
    );
    let mut out = String::from(
        "| cover felt by | flange | hand on T6 felt as | hand at the flange felt as | does not cancel | base drifts in 3 s |\n\
         |---|---|---|---|---|---|\n",
    );
    for (((cover, _), (flange, _)), run) in cases.iter().zip(runs) {
        let Felt { outcome, uncancelled_n } = run?;
        let [x, y, _] = outcome.base_displacement;
        // Writing to a string cannot fail.
        let _ = writeln!(
            out,
            "| {cover} | {flange} | {:.1} N | {:.1} N | {uncancelled_n:.1} N | {:.0} mm |",
            -outcome.wrench_sensed[0],
            outcome.flange_felt_n[0],
            1e3 * x.hypot(y)
        );
    }
    Ok(out)
}
