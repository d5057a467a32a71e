//! B2-iv, hands that cancel, as each board feels them.

use super::push::{self, Outcome};
use super::pushes;
use anyhow::{Context, Result};
use moca_experiments::closed_loop::Rig;
use moca_experiments::settings::Settings;
use moca_msgs::Law;

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

#[cfg(test)]
#[test]
fn opposite_hands_cancel_only_with_the_true_force() {
    let cases: Vec<_> =
        COVERS.iter().flat_map(|cover| ["true", "observed"].map(|flange| (*cover, flange))).collect();
    let run =
        |((_, cover), flange): &((_, &[&str]), &str)| felt(&settings(cover, &format!("flange={flange}"))?);
    let runs = moca_experiments::parallel::run("hands", &cases, run).unwrap();
    for (((cover, _), flange), Felt { outcome, uncancelled_n }) in cases.iter().zip(runs) {
        let [x, y, _] = outcome.base_displacement;
        let (drift_m, hand_n) = (x.hypot(y), -outcome.wrench_sensed[0]);
        let name = format!("{cover}, flange {flange}: {uncancelled_n} N, {outcome:?}");
        assert!((outcome.flange_felt_n[0] - 15.0).abs() < 0.1, "{name}");
        if *cover == "the true force" {
            assert!((hand_n - 15.0).abs() < 0.1 && uncancelled_n < 0.1 && drift_m < 2e-3, "{name}");
        } else {
            // foam creeps: a held hand reads too low
            assert!((9.8..11.5).contains(&hand_n) && (6.3..6.9).contains(&uncancelled_n), "{name}");
            assert!((0.12..0.18).contains(&drift_m), "{name}");
        }
    }
}
