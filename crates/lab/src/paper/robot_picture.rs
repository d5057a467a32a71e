//! The robot at moments of a run: base, arm, people and forces from above, and the arm on its base from the right.

use anyhow::{Context, Result};
use moca_experiments::closed_loop::Row;
use moca_experiments::{JOINTS, count};
use moca_figures::{Anchor, BLACK, Colour, Drawing, GREY, PALETTE, RED, text_px};
use moca_sim::{Scene, Shape};
use moca_wbc::ArmModel;
use moca_wbc::rotation::Heading;

/// Largest side of a picture, and the least that leaves room for its name, px.
const PICTURE: f64 = 220.0;
const PICTURE_LEAST: f64 = 108.0;
/// Half of what a picture shows at least, and what it leaves free at its edge, m.
const AROUND_M: f64 = 0.75;
const EDGE_M: f64 = 0.05;
/// Length of the longest arrow, m, and of one at most, m/N.
const ARROW_M: f64 = 0.4;
const ARROW_M_PER_N: f64 = 0.02;
/// An arrow that is shorter than this is seen end-on, m.
const ARROW_MIN_M: f64 = 0.005;
/// Radius of a leg, if the scene does not say who stands there, m.
const LEG_M: f64 = 0.07;
/// Radius of the largest mark, px.
const MARK: f64 = 4.0;
/// Above the pictures, between the rows, and below before the legend with its lines, px.
const TITLE: f64 = 20.0;
const BETWEEN: f64 = 12.0;
const BEFORE_LEGEND: f64 = 24.0;
const LINE: f64 = 16.0;
const HUMAN: Colour = PALETTE[3];
const ARM: Colour = PALETTE[0];

/// A moment of a run that gets a mark and a picture.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Moment {
    pub name: String,
    pub row: usize,
}

/// The robot at one tick.
struct Snapshot<'a> {
    row: &'a Row,
    /// Origins of the arm's base, its joints and the flange, in W, m.
    arm_world: Vec<[f64; 3]>,
}

/// From where it is seen.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Side {
    /// x of W to the right, y up.
    Above,
    /// x of B to the right, z up.
    Right,
}

/// The robot at its start and at a moment.
struct View<'a> {
    scene: &'a Scene,
    start: &'a Snapshot<'a>,
    now: &'a Snapshot<'a>,
    name: &'a str,
    m_per_n: f64,
}

/// One column for each moment.
pub(super) struct Pictures<'a> {
    scene: &'a Scene,
    start: Snapshot<'a>,
    moments: Vec<(&'a str, Snapshot<'a>)>,
    width_px: f64,
    /// Moments beside each other.
    columns: usize,
    side_px: f64,
    px_per_m: f64,
    m_per_n: f64,
    /// Half of what a column shows, and the height that the view from the right does, m.
    half_m: f64,
    height_m: f64,
    has_forces: bool,
}

impl<'a> Pictures<'a> {
    /// # Errors
    /// An arm of another number of joints.
    pub(super) fn new(
        scene: &'a Scene,
        rows: &'a [Row],
        moments: &'a [Moment],
        width_px: f64,
    ) -> Result<Self> {
        let table = scene.arm.table::<JOINTS>().context("an arm of another number of joints")?;
        let model: ArmModel<JOINTS, f64> = ArmModel::new(&table, &scene.mount, &scene.payload)?;
        let at = |row: &'a Row| Snapshot { row, arm_world: arm_world(&model, row) };
        let start = at(rows.first().context("nothing was recorded")?);
        let moments: Vec<_> = moments.iter().map(|m| (m.name.as_str(), at(&rows[m.row]))).collect();
        let all = moments.len().max(1);
        let fit = (1..=all).rev().find(|columns| width_px / count(*columns) >= PICTURE_LEAST).unwrap_or(1);
        // No row of pictures has more than one less than another.
        let columns = all.div_ceil(all.div_ceil(fit));
        let side_px = (width_px / count(columns)).min(PICTURE);
        let largest_n = moments.iter().map(|(_, now)| largest_arrow_n(now.row)).fold(0.0, f64::max);
        let mut pictures = Self {
            scene,
            start,
            moments,
            width_px,
            columns,
            side_px,
            px_per_m: 1.0,
            m_per_n: ARROW_M_PER_N.min(ARROW_M / largest_n.max(1.0)),
            half_m: AROUND_M,
            height_m: 0.0,
            has_forces: largest_n > 0.0,
        };
        let seen = |side: Side| pictures.views().flat_map(move |view| view.points(side)).collect::<Vec<_>>();
        let most =
            |points: &[[f64; 2]], axis: usize| points.iter().map(|p| p[axis].abs()).fold(0.0, f64::max);
        let (above, right) = (seen(Side::Above), seen(Side::Right));
        let half_m = [most(&above, 0), most(&above, 1), most(&right, 0)].into_iter().fold(0.0, f64::max);
        let height_m = most(&right, 1) + EDGE_M;
        pictures.half_m = pictures.half_m.max(half_m + EDGE_M);
        pictures.height_m = height_m;
        pictures.px_per_m = (0.5 * side_px - MARK) / pictures.half_m;
        Ok(pictures)
    }

    fn views(&self) -> impl Iterator<Item = View<'_>> {
        self.moments.iter().map(|(name, now)| View {
            scene: self.scene,
            start: &self.start,
            now,
            name,
            m_per_n: self.m_per_n,
        })
    }

    /// Returns the height of all rows with their legend, px.
    pub(super) fn height(&self) -> f64 {
        let lines = self.legend().last().map_or(1.0, |(_, [_, line])| line + 1.0);
        self.row_height() * count(self.moments.len().div_ceil(self.columns)) + BEFORE_LEGEND + LINE * lines
    }

    /// Height of a row of moments: the view from above, and that from the right.
    fn row_height(&self) -> f64 {
        TITLE + self.side_px + BETWEEN + self.px_per_m * self.height_m
    }

    /// All rows, their upper edge at `top`.
    pub(super) fn draw(&self, drawing: &mut Drawing, top: f64) {
        for (i, view) in self.views().enumerate() {
            let middle = (count(i % self.columns) + 0.5) * self.side_px;
            let top = top + self.row_height() * count(i / self.columns);
            let floor = top + self.row_height();
            drawing.text([middle, top + 14.0], Anchor::Middle, view.name, BLACK);
            let above = Picture {
                side: Side::Above,
                origin_px: [middle, top + TITLE + 0.5 * self.side_px],
                px_per_m: self.px_per_m,
            };
            above.draw(drawing, &view, self.half_m);
            Picture { side: Side::Right, origin_px: [middle, floor], ..above }.draw(
                drawing,
                &view,
                self.half_m,
            );
            let half = 0.5 * self.side_px - 6.0;
            drawing.line(&[[middle - half, floor], [middle + half, floor]], 1.0, GREY);
        }
        let rows = count(self.moments.len().div_ceil(self.columns));
        let first = top + self.row_height() * rows + BEFORE_LEGEND + 2.0;
        for (entry, [x, line]) in self.legend() {
            let y = first + LINE * line;
            let text_x = match entry.mark {
                Mark::Arrow => {
                    let length_px = self.ten_n_px();
                    arrow(drawing, [x, y - 4.0], [x + length_px, y - 4.0]);
                    x + length_px + 6.0
                }
                Mark::Colour(colour) => {
                    drawing.rectangle([x, y - 9.0], [10.0, 10.0], colour);
                    x + 15.0
                }
                Mark::None => x,
            };
            drawing.text([text_x, y], Anchor::Start, entry.meaning, BLACK);
        }
    }

    /// Length of an arrow of 10 N, px.
    fn ten_n_px(&self) -> f64 {
        10.0 * self.m_per_n * self.px_per_m
    }

    /// Entries of the legend, each with its left end, px, and its line.
    fn legend(&self) -> Vec<(Entry, [f64; 2])> {
        let force = self.has_forces.then_some(Entry { mark: Mark::Arrow, meaning: "10 N on the robot" });
        let someone = self.moments.iter().any(|(_, now)| now.row.person_world.is_some());
        let leg = someone.then_some(Entry { mark: Mark::Colour(HUMAN), meaning: "leg" });
        let robot = [
            Entry { mark: Mark::Colour(ARM), meaning: "arm" },
            Entry { mark: Mark::Colour(GREY), meaning: "at the start" },
        ];
        let views = ["above: from above, world axes;", "below: from the right, axes of the base"]
            .map(|meaning| Entry { mark: Mark::None, meaning });
        let (mut x, mut line) = (LEGEND_X, 0.0);
        let place = |entry: Entry| {
            let mark = match entry.mark {
                Mark::Arrow => self.ten_n_px() + 6.0,
                Mark::Colour(_) => 15.0,
                Mark::None => 0.0,
            };
            let room = mark + text_px(entry.meaning.chars().count());
            if x > LEGEND_X && x + room > self.width_px {
                (x, line) = (LEGEND_X, line + 1.0);
            }
            let at = [x, line];
            x += room + if entry.mark == Mark::None { 2.0 } else { 14.0 };
            (entry, at)
        };
        force.into_iter().chain(robot).chain(leg).chain(views).map(place).collect()
    }
}

/// Left end of the legend, px.
const LEGEND_X: f64 = 8.0;

/// Mark before an entry of the legend.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Mark {
    Arrow,
    Colour(Colour),
    None,
}

/// Entry of the legend.
struct Entry {
    mark: Mark,
    meaning: &'static str,
}

fn arm_world(model: &ArmModel<JOINTS, f64>, row: &Row) -> Vec<[f64; 3]> {
    let [x, y, yaw] = row.base_pose_world;
    let kinematics = model.kinematics(yaw, &row.q_rad);
    let mut points = vec![nalgebra::Vector3::zeros()];
    points.extend(kinematics.joint_positions());
    points.push(kinematics.flange_position);
    let root = kinematics.arm_from_base + nalgebra::Vector3::new(x, y, 0.0);
    points.into_iter().map(|point| (root + point).into()).collect()
}

/// Longest arrow of a picture, N.
fn largest_arrow_n(row: &Row) -> f64 {
    let [fx, fy, fz, ..] = row.flange_wrench_world;
    row.force_true.into_iter().fold(fx.hypot(fy).hypot(fz), f64::max)
}

impl Snapshot<'_> {
    fn flange_world(&self) -> [f64; 3] {
        self.arm_world.last().copied().unwrap_or_default()
    }

    fn to_world(&self, [x, y]: [f64; 2], z: f64) -> [f64; 3] {
        let [px, py, yaw] = self.row.base_pose_world;
        let [x, y, z] = Heading::at(yaw).to_world([x, y, z]);
        [px + x, py + y, z]
    }

    /// Outline of the base, closed, in W, m.
    fn base_world(&self, scene: &Scene, side: Side) -> [[f64; 3]; 5] {
        let [hx, hy, height] = [0.5 * scene.base.size_m[0], 0.5 * scene.base.size_m[1], scene.base.size_m[2]];
        match side {
            Side::Above => [[hx, hy], [-hx, hy], [-hx, -hy], [hx, -hy], [hx, hy]]
                .map(|corner| self.to_world(corner, 0.0)),
            Side::Right => [(hx, 0.0), (-hx, 0.0), (-hx, height), (hx, height), (hx, 0.0)]
                .map(|(x, z)| self.to_world([x, 0.0], z)),
        }
    }
}

impl View<'_> {
    /// Tail and head of every force, in W, m.
    fn arrows_world(&self) -> Vec<[[f64; 3]; 2]> {
        let (row, middle_m) = (self.now.row, 0.5 * self.scene.base.size_m[2]);
        let pressed = self.scene.cover.iter().zip(row.force_true).filter(|(_, force_n)| *force_n > 0.0);
        let mut arrows: Vec<_> = pressed
            .map(|(taxel, force_n)| {
                let (sin, cos) = taxel.inward_angle_base_rad.sin_cos();
                let ([x, y], length) = (taxel.position_base_m, force_n * self.m_per_n);
                [[x - length * cos, y - length * sin], [x, y]].map(|point| self.now.to_world(point, middle_m))
            })
            .collect();
        let [fx, fy, fz, ..] = row.flange_wrench_world;
        let at = self.now.flange_world();
        let force = [fx, fy, fz];
        arrows.push([std::array::from_fn(|axis| at[axis] - force[axis] * self.m_per_n), at]);
        arrows
    }

    /// A point of `of` where it is seen, m, from the middle of the picture (from the right: from the floor under the base).
    fn seen(&self, side: Side, of: &Snapshot<'_>, [x, y, z]: [f64; 3]) -> [f64; 2] {
        let (start, now) = (&self.start.row.base_pose_world, &self.now.row.base_pose_world);
        match side {
            Side::Above => [x - 0.5 * (start[0] + now[0]), y - 0.5 * (start[1] + now[1])],
            Side::Right => {
                let [base_x, base_y, yaw] = of.row.base_pose_world;
                let [ahead, _, z] = Heading::at(yaw).to_base([x - base_x, y - base_y, z]);
                [ahead, z]
            }
        }
    }

    /// Tail and head of every force that is not seen end-on, m.
    fn arrows(&self, side: Side) -> Vec<[[f64; 2]; 2]> {
        let seen = self.arrows_world().into_iter().map(|ends| ends.map(|end| self.seen(side, self.now, end)));
        seen.filter(|[tail, head]| (head[0] - tail[0]).hypot(head[1] - tail[1]) > ARROW_MIN_M).collect()
    }

    /// Everything that has to be inside, but people, m.
    fn points(&self, side: Side) -> Vec<[f64; 2]> {
        let robots = [self.start, self.now].into_iter().flat_map(|robot| {
            let points =
                robot.base_world(self.scene, side).into_iter().chain(robot.arm_world.iter().copied());
            points.map(|point| self.seen(side, robot, point)).collect::<Vec<_>>()
        });
        robots.chain(self.arrows(side).into_iter().flatten()).collect()
    }
}

/// Place of a view on the sheet.
struct Picture {
    side: Side,
    origin_px: [f64; 2],
    px_per_m: f64,
}

impl Picture {
    fn at(&self, [x, y]: [f64; 2]) -> [f64; 2] {
        [self.origin_px[0] + self.px_per_m * x, self.origin_px[1] - self.px_per_m * y]
    }

    fn draw(&self, drawing: &mut Drawing, view: &View<'_>, half_m: f64) {
        let robots = [(view.start, 1.0, GREY, GREY), (view.now, 2.0, BLACK, ARM)];
        for (robot, width, base, arm) in robots {
            let on_sheet = |points: &[[f64; 3]]| -> Vec<[f64; 2]> {
                points.iter().map(|point| self.at(view.seen(self.side, robot, *point))).collect()
            };
            drawing.line(&on_sheet(&robot.base_world(view.scene, self.side)), width, base);
            let links = on_sheet(&robot.arm_world);
            drawing.line(&links, 1.5 * width, arm);
            for joint in &links {
                drawing.circle(*joint, width, arm, 1.0);
            }
            if let Some(flange) = links.last() {
                drawing.circle(*flange, 2.0 * width, arm, 1.0);
            }
        }
        if self.side == Side::Above {
            let front = 0.5 * view.scene.base.size_m[0];
            let nose = [[front - 0.07, -0.06], [front, 0.0], [front - 0.07, 0.06]];
            let nose = nose.map(|point| view.seen(self.side, view.now, view.now.to_world(point, 0.0)));
            drawing.line(&nose.map(|point| self.at(point)), 1.5, BLACK);
            self.person(drawing, view, half_m);
        }
        for [tail, head] in view.arrows(self.side) {
            arrow(drawing, self.at(tail), self.at(head));
        }
    }

    fn person(&self, drawing: &mut Drawing, view: &View<'_>, half_m: f64) {
        let radius_m = match view.scene.people.first().map(|person| person.shape) {
            Some(Shape::Cylinder { radius_m }) => radius_m,
            _ => LEG_M,
        };
        let place = view.now.row.person_world.map(|[x, y]| view.seen(Side::Above, view.now, [x, y, 0.0]));
        if let Some(person) = place.filter(|p| p.iter().all(|v| v.abs() < half_m - radius_m)) {
            drawing.circle(self.at(person), radius_m * self.px_per_m, HUMAN, 1.0);
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::paper::figure::{self, Figure, Layout, Trace};
    use crate::paper::tests::row;
    use crate::picture::{Picture as _, Width};
    use moca_experiments::free_scene;

    fn moments(names: [&str; 4]) -> Vec<Moment> {
        names.iter().zip([0, 10, 20, 49]).map(|(name, row)| Moment { name: (*name).into(), row }).collect()
    }

    #[test]
    fn picture_stays_in_bounds_for_any_push() {
        for force_n in [0.5, 20.0, 155.0, 2000.0] {
            let rows: Vec<Row> =
                (0u32..50).map(|i| row(f64::from(i), [0.03 * f64::from(i), -0.02, 0.02], force_n)).collect();
            let moments = moments(["the arm leads", "contact", "largest force", "the base resumes"]);
            let scene = free_scene();
            for width in [Width::Screen, Width::Single, Width::Double] {
                let trace = Trace { rows: &rows, others: std::slice::from_ref(&rows) };
                let figure = Figure {
                    scene: &scene,
                    trace,
                    moments: &moments,
                    panels: figure::panels(figure::flange_force(trace, true), trace),
                    another: "phase of the board and another seed of its noise",
                    stopped: Some("joint-speed: too fast"),
                };
                let layout = Layout { width, ..Layout::default() };
                let drawing = figure.draw(&layout).unwrap();
                assert_eq!(drawing.texts_outside().unwrap(), Vec::<String>::new(), "{width:?}");
                assert!((drawing.size()[0] - width.px()).abs() < 1e-9);
                assert!(drawing.texts().any(|text| text == "stops: joint-speed"));
                let width = width.px();
                let pictures = Pictures::new(&scene, &rows, &moments, width).unwrap();
                for view in pictures.views() {
                    for [x, y] in view.points(Side::Above) {
                        assert!(x.abs().max(y.abs()) < pictures.half_m, "{force_n} N");
                    }
                    for [x, z] in view.points(Side::Right) {
                        assert!(
                            x.abs() < pictures.half_m && (0.0..pictures.height_m).contains(&z),
                            "{force_n} N"
                        );
                    }
                }
                let mut alone = Drawing::new(width, pictures.height());
                pictures.draw(&mut alone, 0.0);
                let [left, top, right, bottom] = alone.extent().unwrap();
                assert!(
                    left >= 0.0 && top >= 0.0 && right <= width && bottom <= pictures.height(),
                    "{force_n} N"
                );
            }
        }
    }

    #[test]
    fn the_arm_ends_where_the_sample_has_the_flange() {
        let settings = moca_experiments::settings::Settings::paper(moca_msgs::Law::Impedance);
        let mut rig = moca_experiments::closed_loop::Rig::start(&settings, &settings.free_scene()).unwrap();
        crate::paper::push::run(&mut rig, &settings, &[crate::paper::push::single(&[0], 20.0)]).unwrap();
        let (scene, moments) = (settings.free_scene(), moments(["a", "b", "c", "d"]));
        let pictures = Pictures::new(&scene, &rig.rows, &moments, 900.0).unwrap();
        for (_, now) in &pictures.moments {
            let off = now.flange_world().into_iter().zip(now.row.flange_world).map(|(a, b)| (a - b).abs());
            assert!(off.fold(0.0, f64::max) < 1e-12, "{:?} {:?}", now.flange_world(), now.row.flange_world);
            // Shoulder, elbow and wrist of a Panda stand over one another: 333 mm, 316 mm, 384 mm.
            let way = |i: usize, j: usize| {
                let (a, b) = (now.arm_world[i], now.arm_world[j]);
                (a[0] - b[0]).hypot(a[1] - b[1]).hypot(a[2] - b[2])
            };
            assert!((way(0, 1) - 0.333).abs() < 1e-9 && (way(2, 3) - 0.316).abs() < 1e-9);
        }
    }
}
