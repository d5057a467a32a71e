//! Scripted pushes, one or several in a row, and what is measured of each.

use anyhow::Result;
use moca_experiments::TAXELS;
use moca_experiments::closed_loop::{Loads, Rig, Row};
use moca_experiments::measure::{difference, rms};
use moca_experiments::parallel::Count;
use moca_experiments::settings::Settings;
use serde::Serialize;

/// One push: what is pressed and how hard at the plateau. The force at the flange is given in the axes that B has when
/// the push starts: the person walks round with the robot.
#[derive(Clone, Debug)]
pub(crate) struct Push {
    /// As the paper numbers it, or what is pressed.
    pub name: String,
    pub loads: Loads,
}

impl Push {
    /// Hands on taxels (0 is T1), N.
    pub(crate) fn taxels(name: &str, pressed: &[(usize, f64)]) -> Self {
        let mut loads = Loads::default();
        for &(taxel, force_n) in pressed {
            loads.taxel_n[taxel] = force_n;
        }
        Self { name: name.to_owned(), loads }
    }

    /// Adds a force at the flange, axes of B at its start, N.
    #[must_use]
    pub(crate) fn and_flange(mut self, force_base: [f64; 3]) -> Self {
        self.loads.flange_world[..3].copy_from_slice(&force_base);
        self
    }

    /// With the flange's force in world axes for a base that faces `yaw` rad.
    fn turned(&self, yaw: f64) -> Self {
        let (sin, cos) = yaw.sin_cos();
        let [fx, fy, ..] = self.loads.flange_world;
        let mut turned = self.clone();
        turned.loads.flange_world[0] = cos * fx - sin * fy;
        turned.loads.flange_world[1] = sin * fx + cos * fy;
        turned
    }

    /// Returns the push with its forces `scale` times as large.
    fn scaled(mut self, scale: f64) -> Self {
        self.loads = self.loads.scaled(scale);
        self
    }

    /// Loads `t_s` after the start of a push of `length_s` with ramps of `ramp_s` at both ends.
    pub(crate) fn at(&self, t_s: f64, length_s: f64, ramp_s: f64) -> Loads {
        let rising = t_s / ramp_s;
        let falling = (length_s - t_s) / ramp_s;
        self.loads.scaled(rising.min(falling).clamp(0.0, 1.0))
    }
}

/// Result of a push. Poses and velocities in W, wrenches in the axes of B about its origin.
#[derive(Clone, Debug, Serialize)]
pub(crate) struct Outcome {
    pub name: String,
    /// Pose at the end of the ramp-down minus at the start: m, m, rad.
    pub base_displacement: [f64; 3],
    /// Largest and root-mean-square distance of the flange from its target, mm.
    pub flange_max_mm: f64,
    pub flange_rms_mm: f64,
    /// Mean over the plateau: N, N, N·m.
    pub wrench_true: [f64; 3],
    pub wrench_sensed: [f64; 3],
    /// Force at the flange, axes of W, mean over the plateau: true, and as the controller believes, N.
    pub flange_true_n: [f64; 3],
    pub flange_felt_n: [f64; 3],
    /// At the end of the plateau: m/s, m/s, rad/s.
    pub base_velocity: [f64; 3],
    /// Displacement of the flange from its place at the start at the end of the plateau, m.
    pub flange_displacement: [f64; 3],
    /// Largest change of an arm joint left at the end of the following rest, rad.
    pub arm_residual_rad: f64,
}

/// Pushes one after the other on one robot, each followed by a rest.
pub(crate) fn run(rig: &mut Rig, settings: &Settings, pushes: &[Push]) -> Result<Vec<Outcome>> {
    let mut outcomes = Vec::new();
    let mut count = Count::new("pushes", pushes.len());
    for push in pushes {
        let first = rig.rows.len();
        let yaw = rig.rows.last().map_or(0.0, |row| row.base_pose_world[2]);
        let turned = push.turned(yaw).scaled(settings.push_scale);
        rig.run_for(settings.push_s, |t_s| turned.at(t_s, settings.push_s, settings.ramp_s))?;
        let last = rig.rows.len();
        rig.run_for(settings.rest_s, |_| Loads::default())?;
        if rig.stopped.is_some() {
            break;
        }
        outcomes.push(measure(push, &rig.rows, first, last, settings));
        count.one_more();
    }
    Ok(outcomes)
}

/// Measures rows `first..last`; the rows after them are the rest.
fn measure(push: &Push, rows: &[Row], first: usize, last: usize, settings: &Settings) -> Outcome {
    let window = &rows[first..last];
    let start = &window[0];
    let start_s = start.t_s;
    let on_plateau = settings.ramp_s..settings.push_s - settings.ramp_s;
    let plateau: Vec<&Row> = window.iter().filter(|row| on_plateau.contains(&(row.t_s - start_s))).collect();
    // The first row after the push shows the state at its end; with no rest the last row is one tick earlier.
    let end = rows.get(last).unwrap_or(&rows[last - 1]);
    let plateau_end = plateau.last().map_or(start, |row| row);
    let after = rows.last().unwrap_or(end);
    Outcome {
        name: push.name.clone(),
        base_displacement: difference(&end.base_pose_world, &start.base_pose_world),
        flange_max_mm: 1e3 * window.iter().map(Row::flange_error_m).fold(0.0, f64::max),
        flange_rms_mm: 1e3 * rms(window.iter().map(Row::flange_error_m)),
        wrench_true: mean(plateau.iter().map(|row| row.wrench_true)),
        wrench_sensed: mean(plateau.iter().map(|row| row.wrench_sensed)),
        flange_true_n: mean(plateau.iter().map(|row| force(&row.flange_wrench_world))),
        flange_felt_n: mean(plateau.iter().map(|row| force(&row.flange_wrench_felt_world))),
        base_velocity: plateau_end.base_velocity_world,
        flange_displacement: difference(&plateau_end.flange_world, &start.flange_world),
        arm_residual_rad: (0..7).map(|i| (after.q_rad[i] - start.q_rad[i]).abs()).fold(0.0, f64::max),
    }
}

const fn force(&[x, y, z, ..]: &[f64; 6]) -> [f64; 3] {
    [x, y, z]
}

fn mean(values: impl Iterator<Item = [f64; 3]>) -> [f64; 3] {
    let (sum, count) =
        values.fold(([0.0; 3], 0.0), |(sum, count), v| (std::array::from_fn(|i| sum[i] + v[i]), count + 1.0));
    if count > 0.0 { sum.map(|s| s / count) } else { [f64::NAN; 3] }
}

/// `T4+T8` for the taxels that are pressed.
pub(crate) fn pressed_name(taxels: &[usize]) -> String {
    taxels.iter().map(|taxel| format!("T{}", taxel + 1)).collect::<Vec<_>>().join("+")
}

/// Every taxel of `taxels` pressed with `newton`.
pub(crate) fn single(taxels: &[usize], newton: f64) -> Push {
    let pressed: Vec<(usize, f64)> =
        taxels.iter().filter(|taxel| **taxel < TAXELS).map(|&taxel| (taxel, newton)).collect();
    Push::taxels(&pressed_name(taxels), &pressed)
}
