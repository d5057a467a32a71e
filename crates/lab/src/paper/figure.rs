//! Figures 5 to 7: the trace of a run in panels, the moments marked, a picture of the robot from above at each.

use crate::figures::chart::{Panel, Series};
use crate::figures::drawing::{Anchor, BLACK, Drawing, GREY, PALETTE, RED};
use crate::rig::closed_loop::{Row, TAXELS};
use anyhow::{Context, Result};
use moca_sim::Scene;
use std::fmt::Write as _;
use std::path::Path;

const WIDTH: f64 = 900.0;
const PANEL_HEIGHT: f64 = 150.0;
/// Strip above the panels for the names of the moments.
const HEADER: f64 = 34.0;
/// Largest side of a picture.
const PICTURE: f64 = 220.0;
/// Half of what a picture shows around the robot at least, m.
const AROUND_M: f64 = 0.75;
/// Length of an arrow, m/N.
const ARROW_M_PER_N: f64 = 0.02;

/// A moment of a run that gets a mark and a picture.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Moment {
    pub name: String,
    pub row: usize,
}

/// Names of the moments, panels above each other, then one picture for each moment.
pub(crate) fn draw(scene: &Scene, rows: &[Row], moments: &[Moment], panels: Vec<Panel>) -> Drawing {
    let count = |n: usize| f64::from(u32::try_from(n).unwrap_or(u32::MAX));
    let top = HEADER + PANEL_HEIGHT * count(panels.len());
    let side = (WIDTH / count(moments.len().max(1))).min(PICTURE);
    let mut drawing = Drawing::new(WIDTH, top + side + 26.0);
    let at = |moment: &Moment| panels.first().map_or(0.0, |panel| panel.place(rows[moment.row].t_s, WIDTH));
    let mut taken = [f64::NEG_INFINITY; 2];
    for moment in moments {
        let x = at(moment);
        // Names that would run into each other go into the second lane.
        let lane = usize::from(x < taken[0]);
        taken[lane] = x + 8.0 * count(moment.name.chars().count()) + 6.0;
        drawing.text([x, 12.0 + 12.0 * count(lane)], Anchor::Start, &moment.name, BLACK);
        drawing.line(&[[x, 16.0 + 12.0 * count(lane)], [x, HEADER + 16.0]], 1.0, GREY);
    }
    for (i, mut panel) in panels.into_iter().enumerate() {
        panel.marks = moments.iter().map(|m| rows[m.row].t_s).collect();
        panel.draw(&mut drawing, [0.0, HEADER + PANEL_HEIGHT * count(i)], [WIDTH, PANEL_HEIGHT]);
    }
    let half_m = moments.iter().map(|m| half_extent_m(&rows[0], &rows[m.row])).fold(AROUND_M, f64::max);
    for (i, moment) in moments.iter().enumerate() {
        let centre = [(count(i) + 0.5) * side, top + 20.0 + 0.5 * side];
        drawing.text([centre[0], top + 14.0], Anchor::Middle, &moment.name, BLACK);
        let picture = Picture::new(scene, centre, 0.5 * side / half_m, half_m, &rows[0], &rows[moment.row]);
        picture.draw(&mut drawing, &rows[0], &rows[moment.row]);
    }
    drawing
}

/// Half side of a square that holds the robot at its start and now, m.
fn half_extent_m(start: &Row, now: &Row) -> f64 {
    let way = |axis: usize| 0.5 * (now.base_pose_world[axis] - start.base_pose_world[axis]).abs();
    AROUND_M + way(0).max(way(1))
}

/// The robot from above, x of the world to the right, y up; the start in grey.
struct Picture<'a> {
    scene: &'a Scene,
    centre_px: [f64; 2],
    px_per_m: f64,
    /// Place of the world in the middle, m, and half of what is shown.
    middle_m: [f64; 2],
    half_m: f64,
}

impl<'a> Picture<'a> {
    fn new(
        scene: &'a Scene,
        centre_px: [f64; 2],
        px_per_m: f64,
        half_m: f64,
        start: &Row,
        now: &Row,
    ) -> Self {
        let middle_m =
            std::array::from_fn(|axis| 0.5 * (start.base_pose_world[axis] + now.base_pose_world[axis]));
        Self { scene, centre_px, px_per_m, middle_m, half_m }
    }

    fn at(&self, [x, y]: [f64; 2]) -> [f64; 2] {
        [
            self.centre_px[0] + self.px_per_m * (x - self.middle_m[0]),
            self.centre_px[1] - self.px_per_m * (y - self.middle_m[1]),
        ]
    }

    fn draw(&self, drawing: &mut Drawing, start: &Row, row: &Row) {
        let [hx, hy] = [0.5 * self.scene.base.size_m[0], 0.5 * self.scene.base.size_m[1]];
        let corners = [[hx, hy], [-hx, hy], [-hx, -hy], [hx, -hy], [hx, hy]];
        for (pose, width, colour) in [(&start.base_pose_world, 1.0, GREY), (&row.base_pose_world, 2.0, BLACK)]
        {
            drawing.line(&corners.map(|corner| self.at(to_world(pose, corner))), width, colour);
        }
        let base = &row.base_pose_world;
        let nose = [[hx, -0.06], [hx + 0.07, 0.0], [hx, 0.06]];
        drawing.line(&nose.map(|point| self.at(to_world(base, point))), 1.5, BLACK);
        let [x, y, _] = self.scene.mount.position_base_m;
        let mount = to_world(base, [x, y]);
        let flange = [row.flange_world[0], row.flange_world[1]];
        drawing.line(&[self.at(mount), self.at(flange)], 3.0, PALETTE[0]);
        drawing.circle(self.at(flange), 4.0, PALETTE[0]);
        let shown = |p: &[f64; 2]| (0..2).all(|i| (p[i] - self.middle_m[i]).abs() < self.half_m - 0.07);
        if let Some(person) = row.person_world.filter(shown) {
            drawing.circle(self.at(person), 0.07 * self.px_per_m, PALETTE[3]);
        }
        self.forces(drawing, row);
    }

    fn forces(&self, drawing: &mut Drawing, row: &Row) {
        let base = &row.base_pose_world;
        for (taxel, force_n) in self.scene.cover.iter().zip(row.force_true) {
            if force_n > 0.0 {
                let (sin, cos) = taxel.inward_angle_base_rad.sin_cos();
                let [x, y] = taxel.position_base_m;
                let length = force_n * ARROW_M_PER_N;
                let tail = to_world(base, [x - length * cos, y - length * sin]);
                arrow(drawing, self.at(tail), self.at(to_world(base, [x, y])));
            }
        }
        let [fx, fy, fz, ..] = row.flange_wrench_world;
        let flange = [row.flange_world[0], row.flange_world[1]];
        let head = self.at(flange);
        if fx.hypot(fy) > 0.0 {
            arrow(drawing, self.at([flange[0] - fx * ARROW_M_PER_N, flange[1] - fy * ARROW_M_PER_N]), head);
        } else if fz > 0.0 {
            drawing.text([head[0] + 8.0, head[1] + 4.0], Anchor::Start, "up", RED);
        }
    }
}

fn arrow(drawing: &mut Drawing, tail: [f64; 2], head: [f64; 2]) {
    drawing.line(&[tail, head], 2.0, RED);
    drawing.circle(head, 3.5, RED);
}

fn to_world([px, py, yaw]: &[f64; 3], [x, y]: [f64; 2]) -> [f64; 2] {
    let (sin, cos) = yaw.sin_cos();
    [px + cos * x - sin * y, py + sin * x + cos * y]
}

fn series(i: usize, name: &str, rows: &[Row], pick: impl Fn(&Row) -> f64) -> Series {
    Series::line(i, name, rows.iter().map(|row| [row.t_s, pick(row)]).collect())
}

fn panel(title: &str, unit: &str, series: Vec<Series>) -> Panel {
    Panel { series, ..Panel::new(title, "t [s]", unit) }
}

/// Forces of the taxels that are touched at all: true, and what is sensed in a paler colour.
pub(crate) fn taxel_forces(rows: &[Row]) -> Panel {
    let touched = (0..TAXELS).filter(|&i| rows.iter().any(|row| row.force_true[i] > 0.0));
    let (mut sensed, mut lines) = (Vec::new(), Vec::new());
    for (n, i) in touched.enumerate() {
        sensed.push(series(n, "", rows, |row| row.force_sensed[i]).pale());
        lines.push(series(n, &format!("T{}", i + 1), rows, |row| row.force_true[i]));
    }
    sensed.append(&mut lines);
    panel("force on the cover: true (strong) and sensed (pale)", "N", sensed)
}

/// τ_v,ext as the controller has it, axes of B.
pub(crate) fn cover_wrench(rows: &[Row]) -> Panel {
    panel(
        "cover wrench, eq. (4), as sensed",
        "N, N, N·m",
        vec![
            series(0, "f_x", rows, |row| row.wrench_sensed[0]),
            series(1, "f_y", rows, |row| row.wrench_sensed[1]),
            series(2, "m_z", rows, |row| row.wrench_sensed[2]),
        ],
    )
}

/// Force at the flange in its own axes.
pub(crate) fn flange_force(rows: &[Row], own_axes: bool) -> Panel {
    let pick = |axis: usize| {
        move |row: &Row| {
            let [x, y, z, ..] = row.flange_wrench_world;
            if own_axes { to_own_axes(&row.flange_quaternion, [x, y, z])[axis] } else { [x, y, z][axis] }
        }
    };
    let title = if own_axes { "force at the flange, flange axes" } else { "force at the flange, world axes" };
    panel(
        title,
        "N",
        vec![series(0, "x", rows, pick(0)), series(1, "y", rows, pick(1)), series(2, "z", rows, pick(2))],
    )
}

/// v of the world's axes in those of a frame with orientation q (x, y, z, w).
fn to_own_axes([qx, qy, qz, w]: &[f64; 4], v: [f64; 3]) -> [f64; 3] {
    // v' = v + 2 w (u × v) + 2 u × (u × v), with the conjugate's u.
    let u = [-qx, -qy, -qz];
    let t = cross(&u, &v).map(|c| 2.0 * c);
    let ut = cross(&u, &t);
    std::array::from_fn(|i| v[i] + w * t[i] + ut[i])
}

fn cross(a: &[f64; 3], b: &[f64; 3]) -> [f64; 3] {
    [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
}

/// p − p_d of the flange.
pub(crate) fn flange_error(rows: &[Row]) -> Panel {
    let pick = |axis: usize| move |row: &Row| 1e3 * (row.flange_world[axis] - row.flange_desired_world[axis]);
    panel(
        "flange from where it is wanted, world axes",
        "mm",
        vec![series(0, "x", rows, pick(0)), series(1, "y", rows, pick(1)), series(2, "z", rows, pick(2))],
    )
}

/// Velocity of flange and base along y: which leads, and that the base resumes.
pub(crate) fn lead(rows: &[Row]) -> Panel {
    /// Ticks over which the flange's velocity is taken.
    const SPAN: usize = 20;
    let flange = rows.iter().zip(rows.iter().skip(SPAN)).map(|(before, after)| {
        [after.t_s, (after.flange_world[1] - before.flange_world[1]) / (after.t_s - before.t_s)]
    });
    panel(
        "who leads: velocity along y",
        "m/s",
        vec![
            Series::line(0, "flange", flange.collect()),
            series(1, "base", rows, |row| row.base_velocity_world[1]),
        ],
    )
}

/// Pose of the base from its start.
pub(crate) fn base_pose(rows: &[Row]) -> Panel {
    let start = rows[0].base_pose_world;
    let pick = |axis: usize| move |row: &Row| row.base_pose_world[axis] - start[axis];
    panel(
        "base displacement, world axes",
        "m, m, rad",
        vec![series(0, "x", rows, pick(0)), series(1, "y", rows, pick(1)), series(2, "yaw", rows, pick(2))],
    )
}

/// Velocity of the base.
pub(crate) fn base_velocity(rows: &[Row]) -> Panel {
    let pick = |axis: usize| move |row: &Row| row.base_velocity_world[axis];
    panel(
        "base velocity, world axes",
        "m/s, m/s, rad/s",
        vec![series(0, "x", rows, pick(0)), series(1, "y", rows, pick(1)), series(2, "yaw", rows, pick(2))],
    )
}

/// Writes NAME.svg, NAME.png, NAME.csv and NAME.json into `folder`.
pub(crate) fn write(
    folder: &Path,
    name: &str,
    drawing: &Drawing,
    rows: &[Row],
    report: &impl serde::Serialize,
) -> Result<()> {
    std::fs::create_dir_all(folder).with_context(|| format!("cannot create {}", folder.display()))?;
    for (ending, bytes) in [
        ("svg", drawing.svg().into_bytes()),
        ("png", drawing.png()?),
        ("csv", csv(rows).into_bytes()),
        ("json", serde_json::to_vec_pretty(report)?),
    ] {
        let path = folder.join(format!("{name}.{ending}"));
        std::fs::write(&path, bytes).with_context(|| format!("cannot write {}", path.display()))?;
    }
    Ok(())
}

/// The trace: one line a tick.
fn csv(rows: &[Row]) -> String {
    let mut out =
        String::from("t_s,base_x_m,base_y_m,base_yaw_rad,base_vx_m_s,base_vy_m_s,base_yaw_rate_rad_s");
    out.push_str(",flange_x_m,flange_y_m,flange_z_m,desired_x_m,desired_y_m,desired_z_m,flange_fx_n,flange_fy_n,flange_fz_n");
    out.push_str(",fx_true_n,fy_true_n,mz_true_nm,fx_sensed_n,fy_sensed_n,mz_sensed_nm");
    for kind in ["true", "sensed"] {
        for taxel in 1..=TAXELS {
            // Writing to a string cannot fail.
            let _ = write!(out, ",t{taxel}_{kind}_n");
        }
    }
    out.push('\n');
    for row in rows {
        let _ = write!(out, "{:.3}", row.t_s);
        let values = row.base_pose_world.iter().chain(&row.base_velocity_world);
        let values = values.chain(&row.flange_world).chain(&row.flange_desired_world);
        let values = values.chain(&row.flange_wrench_world[..3]).chain(&row.wrench_true);
        for value in values.chain(&row.wrench_sensed).chain(&row.force_true).chain(&row.force_sensed) {
            let _ = write!(out, ",{value:.6}");
        }
        out.push('\n');
    }
    out
}

#[cfg(test)]
mod tests {
    use super::to_own_axes;

    #[test]
    fn a_force_is_turned_into_the_frame_and_not_out_of_it() {
        let half = std::f64::consts::FRAC_1_SQRT_2;
        // A frame turned by +90° about z has its x axis along the world's y.
        let seen = to_own_axes(&[0.0, 0.0, half, half], [0.0, 2.0, 0.0]);
        assert!((seen[0] - 2.0).abs() < 1e-12 && seen[1].abs() < 1e-12, "{seen:?}");
    }
}
