//! `moca-lab docs --only late-bases`: the paper's collision on two foams, with bases whose orders are late.

use super::report::collision_with;
use anyhow::{Result, ensure};
use moca_control::robot::FoamKind;
use moca_experiments::collision;
use moca_experiments::parallel;
use moca_experiments::settings::{Sensor, Settings};
use moca_sim::foam::Foam;
use moca_tactile::Firmware;
use std::fmt::Write as _;

/// Delays of an order on its way to the base's servo, ms.
const DELAYS_MS: [f64; 4] = [0.0, 20.0, 50.0, 100.0];
/// Distance to the person under the barrier, m: a slow base arrives within the run.
const GAP_M: f64 = 0.05;

/// A cell of the table: what the cover is made of, how late the base is, and who controls it.
struct Case {
    foam: (&'static str, Foam, FoamKind),
    delay_ms: f64,
    barrier: bool,
}

impl Case {
    fn all() -> Vec<Self> {
        let foams = [
            ("assumed", Foam::COLLISION_ASSUMED, FoamKind::Hyperbolic),
            ("PU LD30", Foam::PU_LD30, FoamKind::PuLd30),
        ];
        let mut cases = Vec::new();
        for foam in foams {
            for delay_ms in DELAYS_MS {
                cases.extend([false, true].map(|barrier| Self { foam, delay_ms, barrier }));
            }
        }
        cases
    }

    /// The paper's law with the ideal 100 Hz cover, or the contact barrier with our firmware's board and a base whose stopping
    /// distance was measured.
    fn settings(&self) -> Result<Settings> {
        let mut settings = collision_with(Sensor::Ideal);
        (settings.foam.material, settings.config.robot.cover.foam) = (self.foam.1, self.foam.2);
        settings.config.simulation.truth.base.order_delay_ms = self.delay_ms;
        if self.barrier {
            (settings.sensor, settings.firmware) = (Sensor::Stock, Firmware::Moca);
            settings.set("law=barrier")?;
            settings.belief_measured = true;
            settings.person.gap_m = GAP_M;
        }
        Ok(settings)
    }

    /// Speed at the touch, m/s, and largest force in 0.1 s and in all, N.
    fn figures(&self) -> Result<[f64; 3]> {
        let run = collision::run(&self.settings()?)?;
        let measures = &run.report.measures;
        ensure!(measures.first_touch_n > 0.0, "nobody is met");
        let peak_n = run.report.peak_by_phase_n.iter().copied().fold(0.0, f64::max);
        Ok([run.report.approach_m_s, measures.first_touch_n, peak_n])
    }
}

/// The table.
pub(crate) fn markdown() -> Result<String> {
    let cases = Case::all();
    let mut figures = parallel::run("late bases", &cases, Case::figures)?.into_iter();
    let mut out = String::from(
        "| foam | base late by, ms | paper's law meets at, m/s | in 0.1 s, N | largest, N | barrier meets at, m/s | in 0.1 s, N | largest, N |\n\
         |---|---|---|---|---|---|---|---|\n",
    );
    for case in cases.iter().step_by(2) {
        // Writing to a string cannot fail.
        let _ = write!(out, "| {} | {} |", case.foam.0, case.delay_ms);
        for [met_m_s, touch_n, peak_n] in figures.by_ref().take(2) {
            let _ = write!(out, " {met_m_s:.3} | {touch_n:.1} | {peak_n:.1} |");
        }
        out.push('\n');
    }
    Ok(out)
}

#[cfg(test)]
mod tests {
    #[test]
    fn barrier_keeps_its_limit_on_every_late_base() {
        // Another test compares the document's table with this one.
        let table = crate::docs::shown("late-bases").unwrap_or_else(|| super::markdown().unwrap());
        let rows = || {
            table
                .lines()
                .filter(|line| line.starts_with("| "))
                .skip(1)
                .map(|line| line.split('|').map(str::trim).collect::<Vec<_>>())
        };
        assert_eq!(rows().count(), 8);
        for row in rows() {
            let [paper_n, barrier_n] = [5, 8].map(|column: usize| row[column].parse::<f64>().unwrap());
            assert!(barrier_n < 25.0, "{row:?}");
            assert!(paper_n > 25.0 || (row[1], row[2]) == ("assumed", "0"), "{row:?}");
        }
    }
}
