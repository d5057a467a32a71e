//! Experiments B1 and B2: the paper's pushes, in one continuous run each.

use super::figure::{self, Figure, Layout, Trace};
use super::outcome_text;
use super::push::{self, Outcome, Push};
use super::robot_picture::Moment;
use anyhow::Result;
use moca_experiments::closed_loop::{Rig, Row};
use moca_experiments::measure::Measures;
use moca_experiments::parallel;
use moca_experiments::run_info::RunInfo;
use moca_experiments::settings::{Sensor, Settings};
use moca_figures::{Drawing, Panel};
use moca_msgs::Law;
use serde::Serialize;
use std::time::Instant;

/// Seeds added and phases of the sensor as shares of its period; the first is the run itself.
const PHASES: [(u64, f64); 5] = [(0, 0.0), (1, 0.2), (2, 0.4), (3, 0.6), (4, 0.8)];

/// Report of B1 or B2.
#[derive(Debug, Serialize)]
pub(crate) struct Report {
    #[serde(flatten)]
    info: RunInfo,
    /// Measures of the whole run.
    #[serde(flatten)]
    pub measures: Measures,
    /// Each push in its turn.
    pub pushes: Vec<Outcome>,
    /// B2-iii: speed of the base along y for the hand on the cover, the hand at the flange, and both, m/s.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub superposition_m_s: Option<[f64; 3]>,
}

impl Report {
    pub(crate) fn text(&self) -> String {
        let mut lines = vec![self.info.head()];
        lines.extend(self.pushes.iter().map(outcome_text));
        let m = &self.measures;
        lines.push(format!(
            "  whole run: peak force {:.1} N, in contact {:.1} s, flange off by {:.2} mm RMS, {:.2} mm at most",
            m.peak_force_n, m.contact_time_s, m.flange_rms_mm, m.flange_max_mm
        ));
        if let Some([taxel, flange, both]) = self.superposition_m_s {
            lines.push(format!(
                "  superposition: {taxel:.4} m/s (cover) + {flange:.4} m/s (flange) = {:.4}, both together {both:.4} m/s",
                taxel + flange
            ));
        }
        lines.join("\n")
    }
}

/// A report with the trace it was made from.
pub(crate) struct Run {
    pub report: Report,
    pub rows: Vec<Row>,
    pub moments: Vec<Moment>,
}

/// Fig. 5: flange +z 15 N; T1 20 N; T6 20 N; T4 + T8 15 N each; T1 + T11 15 N each.
pub(super) fn pushes_b1() -> [Push; 5] {
    [
        Push::taxels("B1-i flange +z 15 N", &[]).and_flange([0.0, 0.0, 15.0]),
        Push::taxels("B1-ii T1 20 N", &[(0, 20.0)]),
        Push::taxels("B1-iii T6 20 N", &[(5, 20.0)]),
        Push::taxels("B1-iv T4+T8 15 N", &[(3, 15.0), (7, 15.0)]),
        Push::taxels("B1-iv T1+T11 15 N", &[(0, 15.0), (10, 15.0)]),
    ]
}

pub(crate) fn b1(settings: &Settings) -> Result<Run> {
    continuous("b1", settings, &pushes_b1(), None)
}

/// Fig. 6: flange +x 15 N; T1 and T2 + T3 10 N each; hands on cover and flange the same way; the opposite way.
pub(super) fn pushes_b2() -> [Push; 5] {
    [
        Push::taxels("B2-i flange +x 15 N", &[]).and_flange([15.0, 0.0, 0.0]),
        Push::taxels("B2-ii T1 10 N", &[(0, 10.0)]),
        Push::taxels("B2-ii T2+T3 10 N", &[(1, 10.0), (2, 10.0)]),
        Push::taxels("B2-iii T10 10 N, flange +y 10 N", &[(9, 10.0)]).and_flange([0.0, 10.0, 0.0]),
        opposite_hands(),
    ]
}

pub(crate) fn b2(settings: &Settings) -> Result<Run> {
    continuous("b2", settings, &pushes_b2(), Some(superposition(settings)?))
}

/// Runs the pushes in the other phases of the sensor, and with other seeds of a board's noise.
fn others(settings: &Settings, pushes: &[Push]) -> Result<Vec<Vec<Row>>> {
    parallel::run("bands", &PHASES[1..], |(seed, phase)| {
        let mut other = settings.clone();
        other.shift_phase(*phase);
        other.config.simulation.seed = other.config.simulation.seed.wrapping_add(*seed);
        let mut rig = Rig::start(&other, &other.free_scene())?;
        push::run(&mut rig, &other, pushes)?;
        Ok(rig.rows)
    })
}

/// Fig. 5 of one run.
pub(crate) fn figure_5(settings: &Settings, run: &Run, layout: &Layout) -> Result<Drawing> {
    run.draw(settings, &others(settings, &pushes_b1())?, panels_b1, layout)
}

/// Fig. 6 of one run.
pub(crate) fn figure_6(settings: &Settings, run: &Run, layout: &Layout) -> Result<Drawing> {
    run.draw(settings, &others(settings, &pushes_b2())?, panels_b2, layout)
}

impl Run {
    fn draw(
        &self,
        settings: &Settings,
        others: &[Vec<Row>],
        panels: fn(Trace<'_>) -> Vec<Panel>,
        layout: &Layout,
    ) -> Result<Drawing> {
        let trace = Trace { rows: &self.rows, others };
        let another = match settings.sensor {
            Sensor::Stock => "phase of the board and another seed of its noise",
            Sensor::Ideal | Sensor::Off => "phase of the sensor",
        };
        let scene = &settings.free_scene();
        let (moments, panels, stopped) =
            (&self.moments[..], panels(trace), self.report.info.stopped.as_deref());
        Figure { scene, trace, moments, panels, another, stopped }.draw(layout)
    }
}

/// B2-iv: hands on cover and flange against each other, on one line.
pub(super) fn opposite_hands() -> Push {
    Push::taxels("B2-iv T6 15 N, flange +x 15 N", &[(5, 15.0)]).and_flange([15.0, 0.0, 0.0])
}

/// Pushes of either law, each with the contact barrier off and on, felt by a board with our firmware.
pub(super) fn under_barrier() -> Result<Vec<(Settings, [Push; 5])>> {
    let mut runs = Vec::new();
    for (law, pushes) in [(Law::Impedance, pushes_b1()), (Law::FollowMe, pushes_b2())] {
        for barrier in ["barrier=off", "barrier=pu-ld30"] {
            let mut settings = Settings::paper(law);
            settings.set_all(["board.model=pu-ld30", "sensor.firmware=moca", barrier])?;
            runs.push((settings, pushes.clone()));
        }
    }
    Ok(runs)
}

/// B2-iii from the home posture: each hand alone, then both; both act along x = 0.12 m and the flange's line.
pub(super) fn superposition(settings: &Settings) -> Result<[f64; 3]> {
    let cover = Push::taxels("cover", &[(9, 10.0)]);
    let flange = Push::taxels("flange", &[]).and_flange([0.0, 10.0, 0.0]);
    let both = cover.clone().and_flange([0.0, 10.0, 0.0]);
    let mut speeds = [0.0; 3];
    for (speed, push) in speeds.iter_mut().zip([cover, flange, both]) {
        let mut rig = Rig::start(settings, &settings.free_scene())?;
        push::run(&mut rig, settings, &[push])?;
        *speed = rig.rows.iter().map(|row| row.base_velocity_world[1]).fold(0.0, f64::max);
    }
    Ok(speeds)
}

fn continuous(
    name: &'static str,
    settings: &Settings,
    pushes: &[Push],
    superposition_m_s: Option<[f64; 3]>,
) -> Result<Run> {
    let started = Instant::now();
    let mut rig = Rig::start(settings, &settings.free_scene())?;
    let outcomes = push::run(&mut rig, settings, pushes)?;
    let rows = &rig.rows;
    let report = Report {
        info: RunInfo::new(name, settings, &rig, started),
        measures: Measures::of(rows, 1.0 / f64::from(settings.config.control_loop.rate_hz)),
        pushes: outcomes,
        superposition_m_s,
    };
    let mut moments = middles(&rig.rows, pushes.len(), settings.rest_s);
    for (moment, push) in moments.iter_mut().zip(pushes) {
        // "B2-ii T2+T3 10 N" without the force.
        let words = push.name.split(' ').take(2).filter(|word| !word.starts_with("flange"));
        moment.name = words.collect::<Vec<_>>().join(" ");
    }
    Ok(Run { report, rows: rig.rows, moments })
}

/// The middle of each of `count` equal pushes, each followed by a rest of `rest_s`.
pub(crate) fn middles(rows: &[Row], count: usize, rest_s: f64) -> Vec<Moment> {
    let each = rows.len() / count.max(1);
    let length_s =
        rows.last().map_or(0.0, |row| row.t_s) / f64::from(u32::try_from(count.max(1)).unwrap_or(1));
    (0..count)
        .map(|i| {
            let middle_s =
                length_s * f64::from(u32::try_from(i).unwrap_or(0)) + 0.5 * (length_s - rest_s).max(0.0);
            let row = rows.partition_point(|row| row.t_s < middle_s).min(rows.len().saturating_sub(1));
            Moment { name: format!("{}", i + 1), row: row.max(i * each) }
        })
        .collect()
}

/// Panels of Fig. 5.
pub(crate) fn panels_b1(trace: Trace<'_>) -> Vec<Panel> {
    figure::panels(figure::flange_force(trace, false), trace)
}

/// Panels of Fig. 6.
fn panels_b2(trace: Trace<'_>) -> Vec<Panel> {
    let mut panels = panels_b1(trace);
    panels.insert(1, figure::flange_force(trace, true));
    panels
}
