//! Experiment C: the flange is led sideways, the base follows, and a person stands in its way.

use crate::closed_loop::{Rig, Row};
use crate::measure::{Measures, peak_force_n};
use crate::parallel;
use crate::run_info::{RunInfo, wrench_text};
use crate::settings::{Sensor, Settings};
use anyhow::Result;
use moca_control::robot::FoamKind;
use moca_sim::foam::Foam;
use serde::Serialize;
use std::time::Instant;

/// Sensor phases over which the worst is reported, as shares of the sensor's period.
pub const PHASES: [f64; 5] = [0.0, 0.2, 0.4, 0.6, 0.8];

/// Changes the common settings to those of the collision scene.
pub fn defaults(settings: &mut Settings) {
    settings.foam.material = Foam::COLLISION_ASSUMED;
    settings.config.robot.cover.foam = FoamKind::Hyperbolic; // with the same numbers
}

/// Result of the collision in the worst phase of the sensor.
#[derive(Debug, Serialize)]
pub struct Report {
    #[serde(flatten)]
    info: RunInfo,
    /// Measures of the worst phase.
    #[serde(flatten)]
    pub measures: Measures,
    /// Speed of the touched part of the cover towards the person just before contact, m/s.
    pub approach_m_s: f64,
    /// Lead of the flange over the base along y half a second after the start, m.
    pub arm_leads_m: f64,
    /// Speed of the base along y just before contact, at its least in contact, and a second after it, m/s; null
    /// without contact.
    pub base_y_m_s: Option<[f64; 3]>,
    /// Largest force for each phase of the sensor against the motion, N.
    pub peak_by_phase_n: Vec<f64>,
    /// Verdict of the run; a run that stopped or touched nobody shows no low force.
    pub verdict: &'static str,
}

impl Report {
    /// Why the robot stopped, if it did.
    pub fn stopped(&self) -> Option<&str> {
        self.info.stopped.as_deref()
    }

    /// Simulated time, starting included, s.
    pub const fn sim_s(&self) -> f64 {
        self.info.sim_s
    }

    /// Returns for a stock board the command that gives the README's lower figure.
    fn other_cover(&self) -> &'static str {
        if self.info.sensor == Sensor::Stock.name() {
            "\n  This is a stock Touch Board, too slow for this contact; the README's first row has an ideal 100 Hz cover: add --set \
             sensor=ideal"
        } else {
            ""
        }
    }

    /// Returns the report as the command prints it.
    pub fn text(&self) -> String {
        let list = |values: &[f64]| values.iter().map(|v| format!("{v:.1}")).collect::<Vec<_>>().join(" / ");
        let m = &self.measures;
        let [x, y, yaw] = m.base_displacement;
        let resumes = self.base_y_m_s.map_or(String::new(), |[before, least, after]| {
            format!(
                "; base along y {before:.3} m/s before contact, {least:.3} in it, {after:.3} a second after"
            )
        });
        format!(
            "{}\n  peak force {:.1} N ({}), {:.1} N in the first 0.1 s of contact, {:.1} N in 0.5 s{}\n  peaks {} N, taxels {}, contact at {} s for {:.2} s, approach {:.3} m/s\n  \
             peak by sensor phase {} N\n  flange off by {:.2} mm RMS, {:.2} mm at most; base moved ({x:+.3} m, {y:+.3} m, \
             {yaw:+.3} rad); yaw in contact {:+.1}°\n  wrench in contact {} true, {} sensed\n  \
             arm {:.3} m ahead of the base after 0.5 s{resumes}",
            self.info.head(),
            m.peak_force_n,
            self.verdict,
            m.first_touch_n,
            m.impact_n,
            self.other_cover(),
            list(&m.peaks_n),
            m.contact_taxels.join(", "),
            m.contact_s.map_or("no".into(), |t| format!("{t:.2}")),
            m.contact_time_s,
            self.approach_m_s,
            list(&self.peak_by_phase_n),
            m.flange_rms_mm,
            m.flange_max_mm,
            m.yaw_in_contact_deg,
            wrench_text(&m.wrench_true),
            wrench_text(&m.wrench_sensed),
            self.arm_leads_m,
        )
    }
}

/// A report with the trace of its worst phase.
pub struct Run {
    /// Report of the worst phase.
    pub report: Report,
    /// Rows of the worst phase, one for each tick.
    pub rows: Vec<Row>,
    /// Rows of the other phases.
    pub others: Vec<Vec<Row>>,
}

/// One collision for each phase of the sensor; the worst is reported.
pub fn run(settings: &Settings) -> Result<Run> {
    let started = Instant::now();
    let phases: &[f64] = if settings.sensor == Sensor::Off { &PHASES[..1] } else { &PHASES };
    let of_phase = |phase: &f64| {
        let mut shifted = settings.clone();
        shifted.shift_phase(*phase);
        once(&shifted)
    };
    let mut rigs = parallel::run("collision", phases, of_phase)?;
    let peaks: Vec<f64> = rigs.iter().map(|rig| peak_force_n(&rig.rows)).collect();
    let (mut worst, mut most_n) = (0, f64::NEG_INFINITY);
    for (i, peak_n) in peaks.iter().enumerate() {
        if *peak_n > most_n {
            (worst, most_n) = (i, *peak_n);
        }
    }
    let rig = rigs.swap_remove(worst);
    let info = RunInfo::new("collision", settings, &rig, started);
    let report = measure(info, settings, &rig.rows, peaks);
    let others = rigs.into_iter().map(|rig| rig.rows).collect();
    Ok(Run { report, rows: rig.rows, others })
}

/// One collision at the sensor's phase of the settings, measured.
pub fn single(settings: &Settings) -> Result<Report> {
    let started = Instant::now();
    let rig = once(settings)?;
    let info = RunInfo::new("collision", settings, &rig, started);
    let report = measure(info, settings, &rig.rows, Vec::new());
    Ok(Report { peak_by_phase_n: vec![report.measures.peak_force_n], ..report })
}

/// One collision.
pub fn once(settings: &Settings) -> Result<Rig> {
    let mut rig = Rig::start(settings, &settings.collision_scene()?)?;
    rig.move_target(towards_person(settings))?;
    rig.run_unloaded_for(settings.duration_s)?;
    Ok(rig)
}

/// Velocity of the flange's target against the taxel before which the person stands, world axes, m/s.
pub fn towards_person(settings: &Settings) -> [f64; 3] {
    let (sin, cos) =
        settings.config.robot.cover.placements()[settings.person.taxel].inward_angle_base_rad.sin_cos();
    // a panel along an axis is met straight on, without what π leaves to rounding
    [cos, sin, 0.0].map(|inward| if inward.abs() < 1e-12 { 0.0 } else { -inward * settings.speed_m_s })
}

fn measure(info: RunInfo, settings: &Settings, rows: &[Row], peak_by_phase_n: Vec<f64>) -> Report {
    let measures = Measures::of(rows, 1.0 / f64::from(settings.config.control_loop.rate_hz));
    let touching = |row: &Row| row.total_force_n > 0.0;
    let first = rows.iter().position(touching);
    let last = rows.iter().rposition(touching);
    let after = |i: usize, s: f64| rows.iter().skip(i).find(|row| row.t_s >= rows[i].t_s + s).or(rows.last());
    let ahead = |row: &Row| {
        (row.flange_world[1] - rows[0].flange_world[1])
            - (row.base_pose_world[1] - rows[0].base_pose_world[1])
    };
    let verdict = verdict(measures.peak_force_n, info.stopped.is_some());
    Report {
        info,
        measures,
        approach_m_s: first.map_or(0.0, |i| approach_m_s(&rows[i.saturating_sub(1)], settings)),
        arm_leads_m: after(0, 0.5).map_or(0.0, ahead),
        base_y_m_s: first.zip(last).map(|(first, last)| {
            let speed = |row: &Row| row.base_velocity_world[1];
            let least = rows[first..=last].iter().map(speed).fold(f64::INFINITY, f64::min);
            [speed(&rows[first]), least, after(last, 1.0).map_or(0.0, speed)]
        }),
        peak_by_phase_n,
        verdict,
    }
}

/// Returns the verdict on the largest force of a run, and says what a run cannot show.
const fn verdict(peak_n: f64, stopped: bool) -> &'static str {
    if peak_n >= 25.0 {
        "UNSAFE: above 25 N"
    } else if stopped {
        "STOPPED: nothing is shown"
    } else if peak_n <= 0.0 {
        "NO CONTACT: nothing is shown"
    } else {
        "below 25 N"
    }
}

#[cfg(test)]
#[test]
fn a_run_that_stopped_or_touched_nobody_is_not_below_25_n() {
    assert_eq!(verdict(24.2, false), "below 25 N");
    assert_eq!(verdict(25.0, false), "UNSAFE: above 25 N");
    assert_eq!(verdict(400.0, true), "UNSAFE: above 25 N");
    assert!(verdict(3.0, true).starts_with("STOPPED") && verdict(0.0, false).starts_with("NO CONTACT"));
}

/// Speed of the taxel's centre along its outward normal, less the person's own walk, m/s.
pub fn approach_m_s(row: &Row, settings: &Settings) -> f64 {
    let placement = settings.config.robot.cover.placements()[settings.person.taxel];
    let [vx, vy, yaw_rate] = row.base_velocity_true_world;
    let (sin, cos) = row.base_pose_world[2].sin_cos();
    let (body_x, body_y) = (cos * vx + sin * vy, -sin * vx + cos * vy);
    let [x, y] = placement.position_base_m;
    let (vx, vy) = (body_x - yaw_rate * y, body_y + yaw_rate * x);
    let (sin, cos) = placement.inward_angle_base_rad.sin_cos();
    -(vx * cos + vy * sin) + settings.person.walk_m_s
}
