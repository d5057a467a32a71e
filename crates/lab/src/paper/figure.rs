//! Figures 5 to 7: the trace of a run in panels, the moments marked, a picture of the robot from above at each.

use crate::picture::Picture as _;
use crate::rig::closed_loop::Row;
use crate::rig::{JOINTS, TAXELS};
use anyhow::{Context, Result};
use moca_figures::{Anchor, BLACK, Drawing, GREY, PALETTE, Panel, RED, Series};
use moca_sim::{Scene, Shape};
use std::fmt::Write as _;
use std::path::Path;

const WIDTH: f64 = 900.0;
const PANEL_HEIGHT: f64 = 165.0;
/// Strip above the panels for the names of the moments.
const HEADER: f64 = 34.0;
/// Largest side of a picture.
const PICTURE: f64 = 220.0;
/// Half of what a picture shows at least, and what it leaves free at its edge, m.
const AROUND_M: f64 = 0.75;
const EDGE_M: f64 = 0.05;
/// Length of the longest arrow, m, and of one at most, m/N.
const ARROW_M: f64 = 0.4;
const ARROW_M_PER_N: f64 = 0.02;
/// Radius of a leg, if the scene does not say who stands there, m.
const LEG_M: f64 = 0.07;

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
    let mut drawing = Drawing::new(WIDTH, top + side + 44.0);
    let at = |moment: &Moment| panels.first().map_or(0.0, |panel| panel.place(rows[moment.row].t_s, WIDTH));
    let mut taken = [f64::NEG_INFINITY; 2];
    for moment in moments {
        let x = at(moment);
        // Names that would run into each other go into the second lane.
        let lane = usize::from(x < taken[0]);
        taken[lane] = x + 7.0 * count(moment.name.chars().count()) + 6.0;
        drawing.text([x, 12.0 + 12.0 * count(lane)], Anchor::Start, &moment.name, BLACK);
        drawing.line(&[[x, 16.0 + 12.0 * count(lane)], [x, HEADER + 16.0]], 1.0, GREY);
    }
    for (i, mut panel) in panels.into_iter().enumerate() {
        panel.marks = moments.iter().map(|m| rows[m.row].t_s).collect();
        panel.draw(&mut drawing, [0.0, HEADER + PANEL_HEIGHT * count(i)], [WIDTH, PANEL_HEIGHT]);
    }
    let largest_n = moments.iter().map(|m| largest_arrow_n(&rows[m.row])).fold(0.0, f64::max);
    let m_per_n = ARROW_M_PER_N.min(ARROW_M / largest_n.max(1.0));
    let views: Vec<View> =
        moments.iter().map(|m| View { scene, start: &rows[0], now: &rows[m.row], m_per_n }).collect();
    let half_m = views.iter().map(View::half_extent_m).fold(AROUND_M, f64::max);
    for (i, (moment, view)) in moments.iter().zip(views).enumerate() {
        let centre_px = [(count(i) + 0.5) * side, top + 20.0 + 0.5 * side];
        drawing.text([centre_px[0], top + 14.0], Anchor::Middle, &moment.name, BLACK);
        Picture { view, centre_px, px_per_m: 0.5 * side / half_m, half_m }.draw(&mut drawing);
    }
    if largest_n > 0.0 {
        let [x, y] = [8.0, top + side + 36.0];
        let length_px = 10.0 * m_per_n * 0.5 * side / half_m;
        arrow(&mut drawing, [x, y - 4.0], [x + length_px, y - 4.0]);
        drawing.text([x + length_px + 10.0, y], Anchor::Start, "10 N; grey: where the base started", BLACK);
    }
    drawing
}

/// Longest arrow of a picture, N.
fn largest_arrow_n(row: &Row) -> f64 {
    let [fx, fy, ..] = row.flange_wrench_world;
    row.force_true.into_iter().fold(fx.hypot(fy), f64::max)
}

/// What a picture is of.
#[derive(Clone, Copy)]
struct View<'a> {
    scene: &'a Scene,
    start: &'a Row,
    now: &'a Row,
    m_per_n: f64,
}

impl View<'_> {
    /// Outline of the base at a pose, closed, in W, m.
    fn base(&self, pose: &[f64; 3]) -> [[f64; 2]; 5] {
        let [hx, hy] = [0.5 * self.scene.base.size_m[0], 0.5 * self.scene.base.size_m[1]];
        [[hx, hy], [-hx, hy], [-hx, -hy], [hx, -hy], [hx, hy]].map(|corner| to_world(pose, corner))
    }

    fn flange(&self) -> [f64; 2] {
        [self.now.flange_world[0], self.now.flange_world[1]]
    }

    /// Tail and head of every force, in W, m.
    fn arrows(&self) -> Vec<[[f64; 2]; 2]> {
        let base = &self.now.base_pose_world;
        let pressed = self.scene.cover.iter().zip(self.now.force_true).filter(|(_, force_n)| *force_n > 0.0);
        let mut arrows: Vec<_> = pressed
            .map(|(taxel, force_n)| {
                let (sin, cos) = taxel.inward_angle_base_rad.sin_cos();
                let [x, y] = taxel.position_base_m;
                let length = force_n * self.m_per_n;
                [[x - length * cos, y - length * sin], [x, y]].map(|point| to_world(base, point))
            })
            .collect();
        let [fx, fy, ..] = self.now.flange_wrench_world;
        if fx.hypot(fy) > 0.0 {
            let [x, y] = self.flange();
            arrows.push([[x - fx * self.m_per_n, y - fy * self.m_per_n], [x, y]]);
        }
        arrows
    }

    /// Place of the world in the middle of the picture, m.
    fn middle(&self) -> [f64; 2] {
        let (start, now) = (&self.start.base_pose_world, &self.now.base_pose_world);
        std::array::from_fn(|axis| 0.5 * (start[axis] + now[axis]))
    }

    /// Half side of a square that holds the robot at its start and now with every arrow, m.
    fn half_extent_m(&self) -> f64 {
        let middle = self.middle();
        let base = [&self.start.base_pose_world, &self.now.base_pose_world].map(|pose| self.base(pose));
        let points = base.iter().flatten().copied().chain([self.flange()]);
        let points = points.chain(self.arrows().into_iter().flatten());
        let away = |p: [f64; 2]| (p[0] - middle[0]).abs().max((p[1] - middle[1]).abs());
        EDGE_M + points.map(away).fold(0.0, f64::max)
    }
}

/// The robot from above, x of the world to the right, y up; the start in grey.
struct Picture<'a> {
    view: View<'a>,
    centre_px: [f64; 2],
    px_per_m: f64,
    /// Half of what is shown, m.
    half_m: f64,
}

impl Picture<'_> {
    fn at(&self, [x, y]: [f64; 2]) -> [f64; 2] {
        let [middle_x, middle_y] = self.view.middle();
        [
            self.centre_px[0] + self.px_per_m * (x - middle_x),
            self.centre_px[1] - self.px_per_m * (y - middle_y),
        ]
    }

    fn draw(&self, drawing: &mut Drawing) {
        let View { scene, start, now, .. } = self.view;
        let base = &now.base_pose_world;
        for (pose, width, colour) in [(&start.base_pose_world, 1.0, GREY), (base, 2.0, BLACK)] {
            drawing.line(&self.view.base(pose).map(|corner| self.at(corner)), width, colour);
        }
        let front = 0.5 * scene.base.size_m[0];
        let nose = [[front - 0.07, -0.06], [front, 0.0], [front - 0.07, 0.06]];
        drawing.line(&nose.map(|point| self.at(to_world(base, point))), 1.5, BLACK);
        let [x, y, _] = scene.mount.position_base_m;
        let (mount, flange) = (self.at(to_world(base, [x, y])), self.at(self.view.flange()));
        drawing.line(&[mount, flange], 3.0, PALETTE[0]);
        drawing.circle(flange, 4.0, PALETTE[0], 1.0);
        let radius_m = match scene.people.first().map(|person| person.shape) {
            Some(Shape::Cylinder { radius_m }) => radius_m,
            _ => LEG_M,
        };
        let middle = self.view.middle();
        let shown = |p: &[f64; 2]| (0..2).all(|i| (p[i] - middle[i]).abs() < self.half_m - radius_m);
        if let Some(person) = now.person_world.filter(shown) {
            drawing.circle(self.at(person), radius_m * self.px_per_m, PALETTE[3], 1.0);
        }
        for [tail, head] in self.view.arrows() {
            arrow(drawing, self.at(tail), self.at(head));
        }
        let [fx, fy, fz, ..] = now.flange_wrench_world;
        if fx.hypot(fy) <= 0.0 && fz > 0.0 {
            drawing.text([flange[0] + 8.0, flange[1] + 4.0], Anchor::Start, "up", RED);
        }
    }
}

fn arrow(drawing: &mut Drawing, tail: [f64; 2], head: [f64; 2]) {
    let (x, y) = (head[0] - tail[0], head[1] - tail[1]);
    let length = x.hypot(y).max(1e-9);
    let (x, y) = (x / length, y / length);
    let size = length.min(8.0);
    let back = [head[0] - size * x, head[1] - size * y];
    drawing.line(&[tail, back], 2.0, RED);
    let half = 0.45 * size;
    let barb = |side: f64| [back[0] - side * half * y, back[1] + side * half * x];
    drawing.area(&[head, barb(1.0), barb(-1.0)], RED, 1.0);
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

/// Where the flange is, and in a paler colour where it is wanted, from its start.
pub(crate) fn flange_position(rows: &[Row]) -> Panel {
    let start = rows[0].flange_world;
    let mut lines = Vec::new();
    for (axis, name) in ["x", "y", "z"].into_iter().enumerate() {
        lines.push(series(axis, "", rows, |row| row.flange_desired_world[axis] - start[axis]).pale());
        lines.push(series(axis, name, rows, |row| row.flange_world[axis] - start[axis]));
    }
    panel("flange from its start, world axes: actual (strong) and desired (pale)", "m", lines)
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

/// Velocity of the base, and in a paler colour the one that it is told.
pub(crate) fn base_velocity(rows: &[Row]) -> Panel {
    let mut lines = Vec::new();
    for (axis, name) in ["x", "y", "yaw"].into_iter().enumerate() {
        lines.push(series(axis, "", rows, |row| command_world(row)[axis]).pale());
        lines.push(series(axis, name, rows, |row| row.base_velocity_world[axis]));
    }
    panel("base velocity, world axes: actual (strong) and commanded (pale)", "m/s, m/s, rad/s", lines)
}

/// The base's command in world axes, m/s, m/s, rad/s.
fn command_world(row: &Row) -> [f64; 3] {
    let (sin, cos) = row.base_pose_world[2].sin_cos();
    let [x, y, yaw_rate] = row.base_command_body;
    [cos * x - sin * y, sin * x + cos * y, yaw_rate]
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
        ("csv", csv(rows).into_bytes()),
        ("json", serde_json::to_vec_pretty(report)?),
        ("svg", drawing.svg().into_bytes()),
        ("png", drawing.png()?),
    ] {
        let path = folder.join(format!("{name}.{ending}"));
        std::fs::write(&path, bytes).with_context(|| format!("cannot write {}", path.display()))?;
    }
    Ok(())
}

/// The trace: one line a tick; velocities in world axes.
fn csv(rows: &[Row]) -> String {
    let mut out =
        String::from("t_s,base_x_m,base_y_m,base_yaw_rad,base_vx_m_s,base_vy_m_s,base_yaw_rate_rad_s");
    out.push_str(",commanded_vx_m_s,commanded_vy_m_s,commanded_yaw_rate_rad_s");
    for joint in 1..=JOINTS {
        // Writing to a string cannot fail.
        let _ = write!(out, ",q{joint}_rad");
    }
    out.push_str(",flange_x_m,flange_y_m,flange_z_m,desired_x_m,desired_y_m,desired_z_m,flange_fx_n,flange_fy_n,flange_fz_n");
    out.push_str(",fx_true_n,fy_true_n,mz_true_nm,fx_sensed_n,fy_sensed_n,mz_sensed_nm");
    for kind in ["true", "sensed"] {
        for taxel in 1..=TAXELS {
            let _ = write!(out, ",t{taxel}_{kind}_n");
        }
    }
    out.push('\n');
    for row in rows {
        let _ = write!(out, "{:.3}", row.t_s);
        let commanded = command_world(row);
        let values = row.base_pose_world.iter().chain(&row.base_velocity_world);
        let values = values.chain(&commanded).chain(&row.q_rad);
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
    use super::*;
    use crate::rig::free_scene;

    #[test]
    fn a_force_is_turned_into_the_frame_and_not_out_of_it() {
        let half = std::f64::consts::FRAC_1_SQRT_2;
        // A frame turned by +90° about z has its x axis along the world's y.
        let seen = to_own_axes(&[0.0, 0.0, half, half], [0.0, 2.0, 0.0]);
        assert!((seen[0] - 2.0).abs() < 1e-12 && seen[1].abs() < 1e-12, "{seen:?}");
    }

    fn row(t_s: f64, base_pose_world: [f64; 3], force_n: f64) -> Row {
        let mut force_true = [0.0; TAXELS];
        (force_true[0], force_true[5]) = (force_n, 0.3 * force_n);
        Row {
            t_s,
            base_pose_world,
            base_velocity_world: [0.0; 3],
            base_command_body: [0.0; 3],
            q_rad: [0.0; JOINTS],
            flange_world: [base_pose_world[0] + 0.75, base_pose_world[1], 0.9],
            flange_quaternion: [0.0, 0.0, 0.0, 1.0],
            flange_desired_world: [0.75, 0.0, 0.9],
            flange_wrench_world: [0.0, force_n, 0.0, 0.0, 0.0, 0.0],
            wrench_true: [0.0; 3],
            wrench_sensed: [0.0; 3],
            force_true,
            force_sensed: force_true,
            total_force_n: force_n,
            largest_force_n: force_n,
            person_world: Some([0.0, 0.5]),
        }
    }

    #[test]
    fn the_trace_has_a_name_for_each_value_and_the_command_in_the_worlds_axes() {
        let mut turned = row(0.25, [1.0, 2.0, std::f64::consts::FRAC_PI_2], 0.0);
        (turned.base_command_body, turned.q_rad[6]) = ([0.3, 0.1, -0.2], 0.7);
        let text = csv(&[turned]);
        let [names, values] = text.lines().collect::<Vec<_>>().try_into().unwrap();
        let of: std::collections::BTreeMap<_, _> = names.split(',').zip(values.split(',')).collect();
        assert_eq!(names.split(',').count(), values.split(',').count());
        assert_eq!((of["commanded_vx_m_s"], of["commanded_vy_m_s"]), ("-0.100000", "0.300000"));
        assert_eq!((of["commanded_yaw_rate_rad_s"], of["q7_rad"]), ("-0.200000", "0.700000"));
    }

    #[test]
    fn arrows_and_texts_stay_in_their_picture_however_hard_and_far_the_push() {
        for force_n in [0.5, 20.0, 155.0, 2000.0] {
            let rows: Vec<Row> =
                (0u32..50).map(|i| row(f64::from(i), [0.03 * f64::from(i), -0.02, 0.02], force_n)).collect();
            let names = ["the arm leads", "contact", "largest force", "the base resumes"];
            let moments: Vec<Moment> = names
                .iter()
                .zip([0, 10, 20, 49])
                .map(|(name, row)| Moment { name: (*name).into(), row })
                .collect();
            let drawing =
                draw(&free_scene(), &rows, &moments, vec![taxel_forces(&rows), flange_error(&rows)]);
            assert_eq!(drawing.texts_outside().unwrap(), Vec::<String>::new());
            let view =
                View { scene: &free_scene(), start: &rows[0], now: &rows[49], m_per_n: ARROW_M / force_n };
            let [middle_x, middle_y] = view.middle();
            for [x, y] in view.arrows().into_iter().flatten() {
                assert!((x - middle_x).abs().max((y - middle_y).abs()) < view.half_extent_m());
            }
            let top = HEADER + PANEL_HEIGHT * 2.0;
            let [left, _, right, bottom] = drawing.extent().unwrap();
            assert!(left >= 0.0 && right <= WIDTH && bottom <= top + PICTURE + 44.0, "{force_n} N");
        }
    }
}
