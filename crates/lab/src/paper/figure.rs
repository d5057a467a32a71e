//! Figures 5 to 7: the trace of a run in panels, the moments marked, pictures of the robot at each.

use super::robot_picture::{Moment, Pictures};
use crate::picture::{Picture as _, Width};
use anyhow::{Context, Result, ensure};
use moca_experiments::closed_loop::Row;
use moca_experiments::{JOINTS, TAXELS, count};
use moca_figures::{Anchor, BLACK, Drawing, GREY, Panel, Series, text_px, wrapped};
use moca_sim::Scene;
use std::fmt::Write as _;
use std::ops::Range;
use std::path::Path;

/// Height of a panel's axes, px.
const AXES: f64 = 107.0;
/// Height of a line of moments' names or of the note below the pictures, and room for such lines besides them, px.
const LINE: f64 = 12.0;
const AROUND: f64 = 10.0;
/// Corners along each edge of a band.
const BAND_POINTS: usize = 400;

/// Drawn data: one run, and others of the same experiment that show its spread.
#[derive(Clone, Copy)]
pub(crate) struct Trace<'a> {
    pub rows: &'a [Row],
    /// Each of the same length, or shorter if the robot stopped.
    pub others: &'a [Vec<Row>],
}

/// Appearance of a figure.
#[derive(clap::Args, Clone, Debug, Default)]
pub(crate) struct Layout {
    /// Width of the figure.
    #[arg(long, value_enum, default_value_t)]
    pub width: Width,
    /// Panels to draw, by their letters in the whole figure, e.g. a,d,f.
    #[arg(long, value_name = "LETTERS", value_delimiter = ',')]
    pub panels: Vec<char>,
}

impl Layout {
    /// Keeps the chosen panels of a figure; all of them if none is chosen.
    fn chosen(&self, panels: Vec<Panel>) -> Result<Vec<Panel>> {
        if self.panels.is_empty() {
            return Ok(panels);
        }
        let lettered: Vec<(char, Panel)> = ('a'..='z').zip(panels).collect();
        let last = lettered.last().map_or('a', |(letter, _)| *letter);
        for letter in &self.panels {
            let known = lettered.iter().any(|(one, _)| one == letter);
            ensure!(known, "--panels: no panel {letter}, this figure has a to {last}");
        }
        let chosen = lettered.into_iter().filter(|(letter, _)| self.panels.contains(letter));
        Ok(chosen.map(|(_, panel)| panel).collect())
    }
}

/// Everything of a figure.
pub(crate) struct Figure<'a> {
    pub scene: &'a Scene,
    pub trace: Trace<'a>,
    pub moments: &'a [Moment],
    pub panels: Vec<Panel>,
    /// Difference of the other runs.
    pub another: &'static str,
    /// Why the robot stopped, if it did.
    pub stopped: Option<&'a str>,
}

impl Figure<'_> {
    /// Names of the moments, panels above each other, then the robot at each moment.
    /// Over both columns of a journal the panels stand in pairs.
    pub(crate) fn draw(self, layout: &Layout) -> Result<Drawing> {
        let Self { scene, trace: Trace { rows, others }, moments, panels, another, stopped } = self;
        let panels = layout.chosen(panels)?;
        let columns = if layout.width == Width::Double && panels.len() > 1 { 2 } else { 1 };
        let width = layout.width.px();
        let column = width / count(columns);
        let end_s = rows.last().map(|row| row.t_s);
        let letter = |(i, panel): (usize, Panel)| {
            let mut panel = panel.lettered(i);
            panel.marks = moments.iter().map(|m| rows[m.row].t_s).collect();
            if let (Some(why), Some(end_s)) = (stopped, end_s) {
                let code = why.split(':').next().unwrap_or(why);
                panel.series.push(Series::failures(format!("stops: {code}"), [end_s]));
            }
            panel
        };
        let panels: Vec<Panel> = panels.into_iter().enumerate().map(letter).collect();
        let names = Names::new(moments, column, |moment| {
            panels.first().map_or(0.0, |panel| panel.place(rows[moment.row].t_s, column))
        });
        let header = names.height();
        let tallest = |row: &[Panel]| row.iter().map(|panel| panel.height(column, AXES)).fold(0.0, f64::max);
        let top = header + panels.chunks(columns).map(tallest).sum::<f64>();
        let pictures = Pictures::new(scene, rows, moments, width)?;
        let height = top + pictures.height();
        let note = if others.is_empty() {
            String::new()
        } else {
            format!("bands: least and largest of {} runs, each with another {another}", others.len() + 1)
        };
        let notes = wrapped(&note, width - 16.0);
        let mut drawing = Drawing::new(width, height + LINE * count(notes.len()) + 4.0);
        for i in 0..columns {
            names.draw(&mut drawing, column * count(i));
        }
        let mut y = header;
        for row in panels.chunks(columns) {
            let height = tallest(row);
            for (i, panel) in row.iter().enumerate() {
                panel.draw(&mut drawing, [column * count(i), y], [column, height]);
            }
            y += height;
        }
        pictures.draw(&mut drawing, top);
        for (i, line) in notes.iter().enumerate() {
            drawing.text([8.0, height + 8.0 + LINE * count(i)], Anchor::Start, line, BLACK);
        }
        Ok(drawing)
    }
}

/// Names of the moments above the panels, in as many lanes as keep them apart.
struct Names<'a> {
    /// Place of the moment, left end of its name, lane, name.
    placed: Vec<(f64, f64, usize, &'a str)>,
    lanes: usize,
}

impl<'a> Names<'a> {
    fn new(moments: &'a [Moment], width: f64, place: impl Fn(&Moment) -> f64) -> Self {
        let mut taken: Vec<Vec<[f64; 2]>> = Vec::new();
        let placed = moments.iter().map(|moment| {
            let at = place(moment);
            let room = text_px(moment.name.chars().count());
            let left = at.min(width - room).max(0.0);
            let free =
                |lane: &Vec<[f64; 2]>| lane.iter().all(|[from, to]| left >= *to || left + room <= *from);
            let lane = taken.iter().position(free).unwrap_or(taken.len());
            if lane == taken.len() {
                taken.push(Vec::new());
            }
            taken[lane].push([left, left + room + 6.0]);
            (at, left, lane, moment.name.as_str())
        });
        let placed = placed.collect();
        Self { placed, lanes: taken.len() }
    }

    fn height(&self) -> f64 {
        AROUND + LINE * count(self.lanes)
    }

    /// Draws them over the column that begins at `x0`.
    fn draw(&self, drawing: &mut Drawing, x0: f64) {
        for (at, left, lane, name) in &self.placed {
            let (y, at) = (LINE * count(lane + 1), x0 + at);
            drawing.text([x0 + left, y], Anchor::Start, name, BLACK);
            drawing.line(&[[at, y + 4.0], [at, self.height() + 2.0]], 1.0, GREY);
        }
    }
}

/// The panels that Figs. 5 to 7 have in common, below the one that tells what is done to the robot.
pub(crate) fn panels(first: Panel, trace: Trace<'_>) -> Vec<Panel> {
    vec![
        first,
        taxel_forces(trace),
        cover_force(trace),
        cover_moment(trace),
        flange_position(trace),
        flange_error(trace),
        base_position(trace),
        base_yaw(trace),
        base_velocity(trace),
        base_turning(trace),
    ]
}

/// A line with the band of the other runs.
fn series(i: usize, name: &str, trace: Trace<'_>, pick: impl Fn(&Row) -> f64) -> Series {
    let line = Series::line(i, name, trace.rows.iter().map(|row| [row.t_s, pick(row)]).collect());
    if trace.others.is_empty() {
        return line;
    }
    let every = trace.rows.len().div_ceil(BAND_POINTS).max(1);
    let bounds = (0..trace.rows.len()).step_by(every).map(|i| {
        let row = &trace.rows[i];
        let all = trace.others.iter().filter_map(|run| run.get(i)).chain([row]).map(&pick);
        let ends = |[least, most]: [f64; 2], value: f64| [least.min(value), most.max(value)];
        (row.t_s, all.fold([f64::INFINITY, f64::NEG_INFINITY], ends))
    });
    let bounds: Vec<_> = bounds.collect();
    let end = |which: usize| bounds.iter().map(move |(t_s, ends)| [*t_s, ends[which]]);
    line.between(end(0).collect(), end(1))
}

fn panel(title: &str, unit: &str, series: Vec<Series>) -> Panel {
    Panel { series, ..Panel::new(title, "t [s]", unit) }
}

/// Forces of the taxels that are touched at all: true, and what is sensed in a paler colour.
pub(crate) fn taxel_forces(trace: Trace<'_>) -> Panel {
    let touched = (0..TAXELS).filter(|&i| trace.rows.iter().any(|row| row.force_true[i] > 0.0));
    let (mut sensed, mut lines) = (Vec::new(), Vec::new());
    for (n, i) in touched.enumerate() {
        sensed.push(series(n, "", trace, |row| row.force_sensed[i]).pale());
        lines.push(series(n, &format!("T{}", i + 1), trace, |row| row.force_true[i]));
    }
    sensed.append(&mut lines);
    panel("force of hands and people on the cover, inward: true (strong) and sensed (pale)", "N", sensed)
}

/// Force of τ_v,ext as the controller has it, axes of B.
fn cover_force(trace: Trace<'_>) -> Panel {
    panel(
        "force of the cover on the base, eq. (4), axes of the base, as sensed",
        "N",
        vec![
            series(0, "f_x", trace, |row| row.wrench_sensed[0]),
            series(1, "f_y", trace, |row| row.wrench_sensed[1]),
        ],
    )
}

/// Moment of τ_v,ext as the controller has it.
fn cover_moment(trace: Trace<'_>) -> Panel {
    let moment = series(2, "m_z", trace, |row| row.wrench_sensed[2]);
    panel("moment of the cover on the base, eq. (4), as sensed", "N·m", vec![moment])
}

/// Force of the hand on the flange, in its own axes or the world's, and in a paler colour what the controller takes it for.
pub(crate) fn flange_force(trace: Trace<'_>, own_axes: bool) -> Panel {
    let pick = |wrench: fn(&Row) -> &[f64; 6], axis: usize| {
        move |row: &Row| {
            let &[x, y, z, ..] = wrench(row);
            if own_axes { to_own_axes(&row.flange_quaternion, [x, y, z])[axis] } else { [x, y, z][axis] }
        }
    };
    let mut lines = Vec::new();
    for (axis, name) in ["x", "y", "z"].into_iter().enumerate() {
        lines.push(series(axis, "", trace, pick(|row| &row.flange_wrench_felt_world, axis)).pale());
        lines.push(series(axis, name, trace, pick(|row| &row.flange_wrench_world, axis)));
    }
    let axes = if own_axes { "flange axes" } else { "world axes" };
    panel(&format!("force of the hand on the flange, {axes}: true (strong) and felt (pale)"), "N", lines)
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

/// Draws the flange's position and, in a paler colour, the desired one, from its start.
fn flange_position(trace: Trace<'_>) -> Panel {
    let start = trace.rows[0].flange_world;
    let mut lines = Vec::new();
    for (axis, name) in ["x", "y", "z"].into_iter().enumerate() {
        lines.push(series(axis, "", trace, |row| row.flange_desired_world[axis] - start[axis]).pale());
        lines.push(series(axis, name, trace, |row| row.flange_world[axis] - start[axis]));
    }
    panel("flange from its start, world axes: actual (strong) and desired (pale)", "m", lines)
}

/// p − p_d of the flange.
pub(crate) fn flange_error(trace: Trace<'_>) -> Panel {
    let pick = |axis: usize| move |row: &Row| 1e3 * (row.flange_world[axis] - row.flange_desired_world[axis]);
    panel(
        "flange from where it is wanted, world axes",
        "mm",
        vec![series(0, "x", trace, pick(0)), series(1, "y", trace, pick(1)), series(2, "z", trace, pick(2))],
    )
}

/// Velocity of flange and base along y: which leads, and that the base resumes.
pub(crate) fn lead(trace: Trace<'_>) -> Panel {
    /// Ticks over which the flange's velocity is taken.
    const SPAN: usize = 20;
    let flange = trace.rows.iter().zip(trace.rows.iter().skip(SPAN)).map(|(before, after)| {
        [after.t_s, (after.flange_world[1] - before.flange_world[1]) / (after.t_s - before.t_s)]
    });
    panel(
        "who leads: velocity along y",
        "m/s",
        vec![
            Series::line(0, "flange", flange.collect()),
            series(1, "base", trace, |row| row.base_velocity_world[1]),
        ],
    )
}

/// Elements x, y, yaw of the base's pose and velocity.
const BASE: [&str; 3] = ["x", "y", "yaw"];

/// Elements of the base's pose from its start.
fn base_from_start(trace: Trace<'_>, axes: Range<usize>) -> Vec<Series> {
    let start = trace.rows[0].base_pose_world;
    axes.map(|axis| series(axis, BASE[axis], trace, |row| row.base_pose_world[axis] - start[axis])).collect()
}

/// Position of the base from its start.
fn base_position(trace: Trace<'_>) -> Panel {
    panel("base displacement, world axes", "m", base_from_start(trace, 0..2))
}

/// Turn of the base from its start.
fn base_yaw(trace: Trace<'_>) -> Panel {
    panel("base rotation", "rad", base_from_start(trace, 2..3))
}

/// Elements of the base's velocity, and in a paler colour those of the one that it is told.
fn base_rates(trace: Trace<'_>, axes: Range<usize>) -> Vec<Series> {
    let both = |axis: usize| {
        let commanded = series(axis, "", trace, move |row| command_world(row)[axis]).pale();
        [commanded, series(axis, BASE[axis], trace, move |row| row.base_velocity_world[axis])]
    };
    axes.flat_map(both).collect()
}

/// Linear velocity of the base.
fn base_velocity(trace: Trace<'_>) -> Panel {
    let title = "base velocity, world axes: actual (strong) and commanded (pale)";
    panel(title, "m/s", base_rates(trace, 0..2))
}

/// Yaw rate of the base.
fn base_turning(trace: Trace<'_>) -> Panel {
    panel("base yaw rate: actual (strong) and commanded (pale)", "rad/s", base_rates(trace, 2..3))
}

/// The base's command in world axes, m/s, m/s, rad/s.
fn command_world(row: &Row) -> [f64; 3] {
    let (sin, cos) = row.base_pose_world[2].sin_cos();
    let [x, y, yaw_rate] = row.base_command_body;
    [cos * x - sin * y, sin * x + cos * y, yaw_rate]
}

/// Writes NAME.svg, NAME.pdf, NAME.png, NAME.csv and NAME.json into `folder`.
pub(crate) fn write(
    folder: &Path,
    name: &str,
    drawing: &Drawing,
    rows: &[Row],
    report: &impl serde::Serialize,
) -> Result<()> {
    std::fs::create_dir_all(folder).with_context(|| format!("cannot create {}", folder.display()))?;
    drawing.write(&folder.join(name))?;
    for (ending, bytes) in [("csv", csv(rows).into_bytes()), ("json", serde_json::to_vec_pretty(report)?)] {
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
    out.push_str(",flange_x_m,flange_y_m,flange_z_m,desired_x_m,desired_y_m,desired_z_m,flange_fx_n,flange_fy_n,flange_fz_n,flange_fx_felt_n,flange_fy_felt_n,flange_fz_felt_n");
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
        let values = values.chain(&row.flange_wrench_world[..3]).chain(&row.flange_wrench_felt_world[..3]);
        let values = values.chain(&row.wrench_true);
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
    use crate::paper::tests::row;

    #[test]
    fn a_force_is_turned_into_the_frame_and_not_out_of_it() {
        let half = std::f64::consts::FRAC_1_SQRT_2;
        // A frame turned by +90° about z has its x axis along the world's y.
        let seen = to_own_axes(&[0.0, 0.0, half, half], [0.0, 2.0, 0.0]);
        assert!((seen[0] - 2.0).abs() < 1e-12 && seen[1].abs() < 1e-12, "{seen:?}");
    }

    #[test]
    fn each_panel_of_a_figure_has_one_quantity() {
        let rows = [row(0.0, [0.0; 3], 0.0), row(0.1, [0.1; 3], 0.0)];
        let trace = Trace { rows: &rows, others: &[] };
        let panels = panels(taxel_forces(trace), trace);
        assert_eq!(panels.len(), 10);
        for panel in panels {
            assert!(!panel.y_label.contains(','), "{}: {}", panel.title, panel.y_label);
        }
    }

    #[test]
    fn chosen_panels_are_kept_and_unknown_letter_is_named() {
        let panels = || vec![panel("first", "N", Vec::new()), panel("second", "m", Vec::new())];
        let layout = |letters: &[char]| Layout { panels: letters.to_vec(), ..Layout::default() };
        let kept = |letters: &[char]| layout(letters).chosen(panels()).map(|kept| kept.len());
        assert_eq!((kept(&[]).unwrap(), kept(&['b']).unwrap()), (2, 1));
        let error = kept(&['b', 'c']).unwrap_err().to_string();
        assert_eq!(error, "--panels: no panel c, this figure has a to b");
    }

    #[test]
    fn trace_names_every_value_and_uses_world_axes() {
        let mut turned = row(0.25, [1.0, 2.0, std::f64::consts::FRAC_PI_2], 0.0);
        (turned.base_command_body, turned.q_rad[6]) = ([0.3, 0.1, -0.2], 0.7);
        let text = csv(&[turned]);
        let [names, values] = text.lines().collect::<Vec<_>>().try_into().unwrap();
        let of: std::collections::BTreeMap<_, _> = names.split(',').zip(values.split(',')).collect();
        assert_eq!(names.split(',').count(), values.split(',').count());
        assert_eq!((of["commanded_vx_m_s"], of["commanded_vy_m_s"]), ("-0.100000", "0.300000"));
        assert_eq!((of["commanded_yaw_rate_rad_s"], of["q7_rad"]), ("-0.200000", "0.700000"));
    }
}
