//! Experiment C: the flange is led sideways, the base follows, and a person stands in its way.

use super::figure::{self, Moment};
use super::push::{difference, rms};
use super::rig::{Loads, Rig, Row, TAXELS};
use super::settings::{Sensor, Settings};
use super::{RunInfo, head};
use crate::chart::Panel;
use anyhow::Result;
use moca_sim::foam::FoamLaw;
use serde::Serialize;
use std::time::Instant;

/// A peak lower than this is a graze, N.
const PEAK_MIN_N: f64 = 2.0;
/// Sensor phases over which the worst is reported, as shares of the sensor's period.
const PHASES: [f64; 5] = [0.0, 0.2, 0.4, 0.6, 0.8];

/// What the collision scene changes of the common settings.
pub(crate) fn defaults(settings: &mut Settings) {
    settings.foam = FoamLaw::CollisionAssumed;
}

/// What the collision did: worst phase of the sensor.
#[derive(Debug, Serialize)]
pub(crate) struct Report {
    #[serde(flatten)]
    info: RunInfo,
    /// Largest force on any taxel, N.
    pub peak_force_n: f64,
    /// Local maxima of the total force from first contact on, N, in time order.
    pub peaks_n: Vec<f64>,
    /// Taxels that were touched, in the order of the cover.
    pub contact_taxels: Vec<String>,
    /// First contact, s after the motion's start; null without one.
    pub contact_s: Option<f64>,
    /// Time in contact, s.
    pub contact_time_s: f64,
    /// Speed of the touched part of the cover towards the person just before contact, m/s.
    pub approach_m_s: f64,
    pub flange_rms_mm: f64,
    pub flange_max_mm: f64,
    pub base_displacement: [f64; 3],
    /// Turn of the base from first to last contact, degrees.
    pub yaw_in_contact_deg: f64,
    /// Means while in contact, axes of B about its origin: N, N, N·m.
    pub wrench_true: [f64; 3],
    pub wrench_sensed: [f64; 3],
    /// Largest force for each phase of the sensor against the motion, N.
    pub peak_by_phase_n: Vec<f64>,
    /// A stock board is outside the bound of contact stability: label of the result.
    pub verdict: &'static str,
}

impl Report {
    /// Why the robot stopped, if it did.
    pub(crate) fn stopped(&self) -> Option<&str> {
        self.info.stopped.as_deref()
    }

    pub(crate) fn text(&self) -> String {
        let list = |values: &[f64]| values.iter().map(|v| format!("{v:.1}")).collect::<Vec<_>>().join(" / ");
        format!(
            "{}\n  peak force {:.1} N ({}), peaks {} N, taxels {}, contact at {} s for {:.2} s, approach {:.3} m/s\n  \
             peak by sensor phase {} N\n  flange off by {:.2} mm RMS, {:.2} mm at most; base moved ({:+.3} m, {:+.3} m, \
             {:+.3} rad); yaw in contact {:+.1}°",
            head(&self.info),
            self.peak_force_n,
            self.verdict,
            list(&self.peaks_n),
            self.contact_taxels.join(", "),
            self.contact_s.map_or("no".into(), |t| format!("{t:.2}")),
            self.contact_time_s,
            self.approach_m_s,
            list(&self.peak_by_phase_n),
            self.flange_rms_mm,
            self.flange_max_mm,
            self.base_displacement[0],
            self.base_displacement[1],
            self.base_displacement[2],
            self.yaw_in_contact_deg,
        )
    }
}

/// A report with the trace of its worst phase.
pub(crate) struct Run {
    pub report: Report,
    pub rows: Vec<Row>,
    pub moments: Vec<Moment>,
}

/// One collision for each phase of the sensor; the worst is reported.
pub(crate) fn run(settings: &Settings) -> Result<Run> {
    let started = Instant::now();
    let period_ms = match settings.sensor {
        Sensor::Stock => 1e-6 * to_f64(settings.sketch.frame_period_ns()),
        Sensor::Ideal | Sensor::Off => settings.sensor_period_ms,
    };
    let phases: &[f64] = if settings.sensor == Sensor::Off { &PHASES[..1] } else { &PHASES };
    let mut worst: Option<(f64, Rig)> = None;
    let mut peaks = Vec::new();
    for phase in phases {
        let mut shifted = settings.clone();
        shifted.sensor_phase_ms += phase * period_ms;
        let rig = once(&shifted)?;
        let peak_n = peak_force_n(&rig.rows);
        peaks.push(peak_n);
        if worst.as_ref().is_none_or(|(most, _)| peak_n > *most) {
            worst = Some((peak_n, rig));
        }
    }
    let Some((_, rig)) = worst else { anyhow::bail!("no phase was run") };
    let info = RunInfo::new("collision", settings, &rig, started);
    let report = measure(info, settings, &rig.rows, peaks);
    Ok(Run { report, moments: moments(&rig.rows), rows: rig.rows })
}

/// One collision at the sensor's phase of the settings, measured.
pub(crate) fn single(settings: &Settings) -> Result<Report> {
    let started = Instant::now();
    let rig = once(settings)?;
    let peak_n = peak_force_n(&rig.rows);
    Ok(measure(RunInfo::new("collision", settings, &rig, started), settings, &rig.rows, vec![peak_n]))
}

/// One collision.
pub(crate) fn once(settings: &Settings) -> Result<Rig> {
    let mut rig = Rig::start(settings, &settings.collision_scene()?)?;
    rig.move_target([0.0, settings.speed_m_s, 0.0])?;
    rig.run_for(settings.duration_s, |_| Loads::default())?;
    Ok(rig)
}

/// Largest force on any taxel, N.
pub(crate) fn peak_force_n(rows: &[Row]) -> f64 {
    rows.iter().flat_map(|row| row.force_true).fold(0.0, f64::max)
}

/// The arm leads; first contact; the first peak; the base has resumed.
fn moments(rows: &[Row]) -> Vec<Moment> {
    let last = rows.len().saturating_sub(1);
    let touching = |row: &Row| row.total_force_n() > 0.0;
    let contact = rows.iter().position(touching).unwrap_or(last);
    let end = rows.iter().rposition(touching).unwrap_or(last);
    let peak = (contact..=end.min(last))
        .max_by(|&a, &b| rows[a].total_force_n().total_cmp(&rows[b].total_force_n()))
        .unwrap_or(last);
    [
        ("arm leads", last.min(500)),
        ("contact", contact),
        ("largest force", peak),
        ("base resumes", last.min(end + 1000)),
    ]
    .map(|(name, row)| Moment { name: name.to_owned(), row })
    .to_vec()
}

/// Panels of Fig. 7.
pub(crate) fn panels(rows: &[Row]) -> Vec<Panel> {
    vec![
        figure::lead(rows),
        figure::taxel_forces(rows),
        figure::cover_wrench(rows),
        figure::flange_error(rows),
        figure::base_pose(rows),
        figure::base_velocity(rows),
    ]
}

fn measure(info: RunInfo, settings: &Settings, rows: &[Row], peak_by_phase_n: Vec<f64>) -> Report {
    let touching: Vec<usize> = (0..rows.len()).filter(|&i| rows[i].total_force_n() > 0.0).collect();
    let first = touching.first().copied();
    let last = touching.last().copied();
    let mean = |pick: fn(&Row) -> [f64; 3]| {
        let count = to_f64(touching.len() as u64).max(1.0);
        let mut sum = [0.0; 3];
        for &i in &touching {
            let value = pick(&rows[i]);
            sum = std::array::from_fn(|axis| sum[axis] + value[axis]);
        }
        sum.map(|s| s / count)
    };
    let errors = || rows.iter().map(Row::flange_error_m);
    let peak = peak_force_n(rows);
    Report {
        info,
        peak_force_n: peak,
        peaks_n: peaks(rows),
        contact_taxels: (0..TAXELS)
            .filter(|&taxel| rows.iter().any(|row| row.force_true[taxel] > 0.0))
            .map(|taxel| format!("T{}", taxel + 1))
            .collect(),
        contact_s: first.map(|i| rows[i].t_s),
        contact_time_s: 1e-3 * to_f64(touching.len() as u64),
        approach_m_s: first.map_or(0.0, |i| approach_m_s(&rows[i.saturating_sub(1)], settings)),
        flange_rms_mm: 1e3 * rms(errors()),
        flange_max_mm: 1e3 * errors().fold(0.0, f64::max),
        base_displacement: match (rows.first(), rows.last()) {
            (Some(first), Some(last)) => difference(&last.base_pose_world, &first.base_pose_world),
            _ => [0.0; 3],
        },
        yaw_in_contact_deg: match (first, last) {
            (Some(first), Some(last)) => {
                (rows[last].base_pose_world[2] - rows[first].base_pose_world[2]).to_degrees()
            }
            _ => 0.0,
        },
        wrench_true: mean(|row| row.wrench_true),
        wrench_sensed: mean(|row| row.wrench_sensed),
        peak_by_phase_n,
        verdict: if peak < 25.0 { "below 25 N" } else { "UNSAFE: above 25 N" },
    }
}

/// Speed of the taxel's centre along its outward normal, less the person's own walk, m/s.
fn approach_m_s(row: &Row, settings: &Settings) -> f64 {
    let placement = moca_msgs::robot::PAPER_COVER[settings.person.taxel];
    let [vx, vy, yaw_rate] = row.base_velocity_world;
    let (sin, cos) = row.base_pose_world[2].sin_cos();
    let (body_x, body_y) = (cos * vx + sin * vy, -sin * vx + cos * vy);
    let [x, y] = placement.position_base_m;
    let (vx, vy) = (body_x - yaw_rate * y, body_y + yaw_rate * x);
    let (sin, cos) = placement.inward_angle_base_rad.sin_cos();
    -(vx * cos + vy * sin) + settings.person.walk_m_s
}

/// Local maxima of the total force above a graze, N, each the largest between two dips of a fifth of it.
fn peaks(rows: &[Row]) -> Vec<f64> {
    let mut found = Vec::new();
    let (mut most, mut rising) = (0.0f64, true);
    let mut least = f64::INFINITY;
    for force_n in rows.iter().map(Row::total_force_n) {
        if rising {
            most = most.max(force_n);
            if most > PEAK_MIN_N && force_n < 0.8 * most {
                found.push(most);
                (rising, least) = (false, force_n);
            }
        } else {
            least = least.min(force_n);
            if force_n > PEAK_MIN_N && force_n > 1.25 * least {
                (rising, most) = (true, force_n);
            }
        }
    }
    found
}

fn to_f64(value: u64) -> f64 {
    #[expect(clippy::cast_precision_loss, reason = "counts and nanoseconds of one run")]
    let value = value as f64;
    value
}
