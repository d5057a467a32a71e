//! The robot in three dimensions: floor, base with its plates, arm, flange and where it should be, trail, forces. Back to
//! front: nothing but convex bodies, so no depth buffer is needed.

use super::scale::{
    ARC_MAX_RAD, ARC_RAD_PER_NM, ARROW_M_PER_N, ARROW_MAX_M, FLANGE_M_PER_N, FLANGE_M_PER_NM, FULL_COLOUR_N,
};
use crate::logic::{
    camera::{OrbitCamera, Projection},
    format::{number, taxel_name},
    kinematics::{axes, in_world, points_base_m},
    limited::Limited,
    model::Model,
    signals::panel::Signal,
};
use crate::ui::theme;
use egui::{Color32, FontId, Mesh, Painter, Pos2, Rect, Shape, Stroke, Visuals, pos2, vec2};
use moca_msgs::gripper::FRANKA_HAND;
use moca_msgs::{GripperState, Sample, TaxelPlacement, TaxelStatus};

/// Point that the camera looks at, in B, m.
const TARGET_M: [f64; 3] = [0.12, 0.0, 0.5];
/// Distance of the floor's lines and how far they reach, m.
const GRID_M: f64 = 0.5;
const GRID_LINES: i32 = 4;
/// Half width of a plate, its thickness, and its lower and upper edge as shares of the base's height, m.
const PLATE_HALF_M: f64 = 0.09;
const PLATE_THICK_M: f64 = 0.03;
const PLATE_Z: (f64, f64) = (0.25, 0.8);
/// Radius of the arm's links, m.
const LINK_M: f64 = 0.055;
/// Length of the axes of flange and desired flange, m.
const AXIS_M: f64 = 0.12;
/// Place of a gripper's palm on the way from the flange to its fingertips.
const PALM: f64 = 0.55;
/// Duration of the flange's trail, s, and its number of points.
const TRAIL_S: f64 = 10.0;
const TRAIL_POINTS: u64 = 160;
/// Radius of the arc of the base's moment, m.
const ARC_M: f64 = 0.22;
/// Between two texts, points.
const GAP: f32 = 1.0;

/// Draws what `sample` says into the painter's rectangle.
pub(in crate::ui) fn view_3d(
    painter: &Painter,
    visuals: &Visuals,
    model: &Model,
    sample: &Sample,
    camera: OrbitCamera,
) {
    let picture = Picture::new(painter, visuals, sample, camera);
    picture.floor();
    let plates = || model.robot.taxels.iter().enumerate();
    let front = |taxel: &TaxelPlacement| picture.shows_front(taxel);
    for (i, taxel) in plates().filter(|(_, taxel)| !front(taxel)) {
        picture.plate(i, taxel, model, sample);
        picture.press(taxel, model, valid_force_n(sample, i));
    }
    picture.base(model);
    plates().filter(|(_, taxel)| front(taxel)).for_each(|(i, taxel)| picture.plate(i, taxel, model, sample));
    if model.robot.has_arm() {
        picture.trail(model);
        picture.desired(sample);
        picture.arm(model, sample);
    }
    if model.robot.has_robot() {
        picture.wrench(model, sample);
    }
    for (i, taxel) in plates().filter(|(_, taxel)| front(taxel)) {
        picture.press(taxel, model, valid_force_n(sample, i));
    }
    picture.forces(model, sample);
}

struct Picture<'a> {
    painter: &'a Painter,
    rect: Rect,
    view: Projection,
    visuals: &'a Visuals,
    base_world: [f64; 3],
}

impl<'a> Picture<'a> {
    fn new(painter: &'a Painter, visuals: &'a Visuals, sample: &Sample, camera: OrbitCamera) -> Self {
        let base_world = sample.base_pose_world.map(|v| if v.is_finite() { v } else { 0.0 });
        let view = camera.looking_at(in_world(base_world, TARGET_M));
        Self { painter, rect: painter.clip_rect(), view, visuals, base_world }
    }

    /// Corners of the side of a plate that a hand touches, one after the other, in the world.
    fn outer_side(&self, taxel: &TaxelPlacement, model: &Model) -> [[f64; 3]; 4] {
        let ([x, y], (sin, cos)) = (taxel.position_base_m, taxel.inward_angle_base_rad.sin_cos());
        let height = model.robot.base_size_m[2];
        let corner = |along: f64, z: f64| {
            let out = PLATE_THICK_M;
            self.in_world([x - out * cos - along * sin, y - out * sin + along * cos, z * height])
        };
        let (low, high) = PLATE_Z;
        [(-PLATE_HALF_M, low), (PLATE_HALF_M, low), (PLATE_HALF_M, high), (-PLATE_HALF_M, high)]
            .map(|(along, z)| corner(along, z))
    }

    /// Returns the place of a point of the world on the screen, and the length of a metre there, points.
    #[expect(clippy::cast_possible_truncation, reason = "screen coordinates")]
    fn at(&self, point: [f64; 3]) -> Option<(Pos2, f32)> {
        let half = f64::from(self.rect.height().min(self.rect.width())) / 2.0;
        let place = self.view.project(point)?;
        let centre = self.rect.center();
        let at = pos2(centre.x + (place.x * half) as f32, centre.y - (place.y * half) as f32);
        Some((at, (self.view.scale(place.depth_m) * half) as f32))
    }

    fn in_world(&self, point_base: [f64; 3]) -> [f64; 3] {
        in_world(self.base_world, point_base)
    }

    fn line(&self, from: [f64; 3], to: [f64; 3], stroke: Stroke) {
        if let (Some((from, _)), Some((to, _))) = (self.at(from), self.at(to)) {
            self.painter.line_segment([from, to], stroke);
        }
    }

    fn floor(&self) {
        let stroke = Stroke::new(0.6, self.visuals.weak_text_color().gamma_multiply(0.5));
        let near = |v: f64| (v / GRID_M).round() * GRID_M;
        let [x0, y0] = [near(self.base_world[0]), near(self.base_world[1])];
        let reach = f64::from(GRID_LINES) * GRID_M;
        for i in -GRID_LINES..=GRID_LINES {
            let by = f64::from(i) * GRID_M;
            self.line([x0 + by, y0 - reach, 0.0], [x0 + by, y0 + reach, 0.0], stroke);
            self.line([x0 - reach, y0 + by, 0.0], [x0 + reach, y0 + by, 0.0], stroke);
        }
    }

    fn base(&self, model: &Model) {
        let [length, width, height] = model.robot.base_size_m;
        let grey = if self.visuals.dark_mode { 95 } else { 215 };
        let stroke = Stroke::new(1.0, self.visuals.weak_text_color());
        self.block(
            [0.0, 0.0],
            0.0,
            [length / 2.0, width / 2.0],
            [0.06, height],
            Color32::from_gray(grey),
            stroke,
        );
        // A wedge on its lid shows which way is forwards.
        let (tip, rear) = (-0.25 * length, -0.36 * length);
        let wedge =
            [[tip, 0.0], [rear, 0.07], [rear, -0.07]].map(|[x, y]| self.at(self.in_world([x, y, height])));
        if let [Some((a, _)), Some((b, _)), Some((c, _))] = wedge {
            let colour = self.visuals.weak_text_color();
            self.painter.add(Shape::convex_polygon(vec![a, b, c], colour, Stroke::NONE));
        }
    }

    /// Returns true if the outer side of a plate faces the camera.
    fn shows_front(&self, taxel: &TaxelPlacement) -> bool {
        let [x, y] = taxel.position_base_m;
        let (sin, cos) = (taxel.inward_angle_base_rad + self.base_world[2]).sin_cos();
        self.view.faces(self.in_world([x, y, 0.25]), [-cos, -sin, 0.0])
    }

    /// A plate in the colour of its force.
    fn plate(&self, index: usize, taxel: &TaxelPlacement, model: &Model, sample: &Sample) {
        let ([x, y], angle) = (taxel.position_base_m, taxel.inward_angle_base_rad);
        let (sin, cos) = angle.sin_cos();
        let out = |by_m: f64| [x - by_m * cos, y - by_m * sin];
        let height = model.robot.base_size_m[2];
        let z = [PLATE_Z.0 * height, PLATE_Z.1 * height];
        let masked = sample.taxels.get(index).is_some_and(|taxel| taxel.status == TaxelStatus::Masked);
        let (fill, stroke) = if let Some(force_n) = valid_force_n(sample, index) {
            (theme::force(force_n, FULL_COLOUR_N, self.visuals), self.visuals.weak_text_color())
        } else if masked {
            (self.visuals.extreme_bg_color, self.visuals.weak_text_color())
        } else {
            (self.visuals.extreme_bg_color, theme::BAD)
        };
        let half = [PLATE_THICK_M / 2.0, PLATE_HALF_M];
        self.block(out(PLATE_THICK_M / 2.0), angle, half, z, fill, Stroke::new(1.0, stroke));
    }

    /// Tail and tip of the arrow on a plate that is pressed with so much, in the world.
    fn arrow_of(&self, taxel: &TaxelPlacement, model: &Model, force_n: f64) -> [[f64; 3]; 2] {
        let ([x, y], (sin, cos)) = (taxel.position_base_m, taxel.inward_angle_base_rad.sin_cos());
        let z = PLATE_Z.0.midpoint(PLATE_Z.1) * model.robot.base_size_m[2];
        let out = |by_m: f64| self.in_world([x - by_m * cos, y - by_m * sin, z]);
        let length = (force_n * ARROW_M_PER_N).min(ARROW_MAX_M);
        [out(PLATE_THICK_M + length), out(PLATE_THICK_M)]
    }

    /// An arrow on a plate, if it is pressed.
    fn press(&self, taxel: &TaxelPlacement, model: &Model, force_n: Option<f64>) {
        if let Some(force_n) = force_n.filter(|force_n| *force_n > 0.0) {
            let [tail, tip] = self.arrow_of(taxel, model, force_n);
            self.arrow(tail, tip, theme::BAD);
        }
    }

    /// Number and force of each plate that is pressed at the tail of its arrow, none over another nor outside.
    fn forces(&self, model: &Model, sample: &Sample) {
        let mut taken: Vec<Rect> = Vec::new();
        for (index, taxel) in model.robot.taxels.iter().enumerate() {
            let pressed = valid_force_n(sample, index).filter(|force_n| *force_n > 0.0);
            let Some(force_n) = pressed else { continue };
            let [tail, tip] = self.arrow_of(taxel, model, force_n).map(|end| self.at(end));
            let (Some((tail, _)), Some((tip, _))) = (tail, tip) else { continue };
            let (text, font) =
                (format!("{} {} N", taxel_name(index), number(force_n, 1)), FontId::proportional(16.0));
            let galley = self.painter.layout_no_wrap(text, font, theme::strong(self.visuals));
            let away = if tail.x < tip.x { -8.0 - galley.size().x } else { 8.0 };
            let corner = tail + vec2(away, -galley.size().y / 2.0);
            let place = free(Rect::from_min_size(corner, galley.size()), self.rect, &taken);
            taken.push(place);
            self.painter.galley(place.min, galley, Color32::PLACEHOLDER);
        }
    }

    /// An upright block in B: its middle, the direction of its first half width, both half widths, bottom and top.
    fn block(
        &self,
        [x, y]: [f64; 2],
        angle_rad: f64,
        [along, across]: [f64; 2],
        [bottom, top]: [f64; 2],
        fill: Color32,
        stroke: Stroke,
    ) {
        let (sin, cos) = angle_rad.sin_cos();
        let corner = |a: f64, c: f64, z: f64| {
            self.in_world([x + a * along * cos - c * across * sin, y + a * along * sin + c * across * cos, z])
        };
        let side = |a: f64, c: f64| {
            let (sin, cos) = (angle_rad + self.base_world[2]).sin_cos();
            [a * cos - c * sin, a * sin + c * cos, 0.0]
        };
        let walls = [(1.0, 0.0), (0.0, 1.0), (-1.0, 0.0), (0.0, -1.0)].map(|(a, c)| {
            // The wall with this normal reaches from its one edge to its other.
            let (one, other) = ((a - c, c + a), (a + c, c - a));
            let corners = [
                corner(one.0, one.1, bottom),
                corner(one.0, one.1, top),
                corner(other.0, other.1, top),
                corner(other.0, other.1, bottom),
            ];
            (corners, side(a, c), if c.abs() > 0.5 { 0.86 } else { 0.74 })
        });
        let lid =
            [corner(1.0, 1.0, top), corner(1.0, -1.0, top), corner(-1.0, -1.0, top), corner(-1.0, 1.0, top)];
        for (corners, normal, light) in walls.into_iter().chain([(lid, [0.0, 0.0, 1.0], 1.0)]) {
            if !self.view.faces(corners[0], normal) {
                continue;
            }
            let points: Vec<Pos2> = corners.iter().filter_map(|c| Some(self.at(*c)?.0)).collect();
            if points.len() == corners.len() {
                self.face(&points, lit(fill, light), stroke);
            }
        }
    }

    /// A convex face and its edges one by one: a polygon's feathered outline has spikes where the face is seen from its edge.
    fn face(&self, corners: &[Pos2], fill: Color32, stroke: Stroke) {
        let mut mesh = Mesh::default();
        corners.iter().for_each(|corner| mesh.colored_vertex(*corner, fill));
        (2..).zip(corners.iter().skip(2)).for_each(|(third, _)| mesh.add_triangle(0, third - 1, third));
        self.painter.add(Shape::mesh(mesh));
        for (from, to) in corners.iter().zip(corners.iter().cycle().skip(1)) {
            self.painter.line_segment([*from, *to], stroke);
        }
    }

    /// Links as thick lines with their joints, the farthest first; then the flange with its axes.
    fn arm(&self, model: &Model, sample: &Sample) {
        let points: Vec<[f64; 3]> =
            points_base_m(&model.robot, &sample.q_rad).into_iter().map(|p| self.in_world(p)).collect();
        let (fill, edge) = if self.visuals.dark_mode {
            (Color32::from_gray(200), Color32::from_gray(60))
        } else {
            (Color32::from_gray(245), Color32::from_gray(110))
        };
        let mut links: Vec<_> = points
            .windows(2)
            .filter_map(|ends| Some((self.at(*ends.first()?)?, self.at(*ends.get(1)?)?)))
            .collect();
        // What is farther away is smaller.
        links.sort_by(|a, b| (a.0.1 + a.1.1).total_cmp(&(b.0.1 + b.1.1)));
        for ((from, from_scale), (to, to_scale)) in links {
            #[expect(clippy::cast_possible_truncation, reason = "a width on the screen")]
            let width = 2.0 * LINK_M as f32 * from_scale.midpoint(to_scale);
            for (width, colour) in [(width + 2.5, edge), (width, fill)] {
                self.painter.line_segment([from, to], Stroke::new(width, colour));
                self.painter.circle_filled(from, width / 2.0, colour);
                self.painter.circle_filled(to, width / 2.0, colour);
            }
            self.painter.circle_filled(to, width * 0.28, edge);
        }
        if let Some(flange) = points.last() {
            if self.axes(*flange, sample.flange_quaternion_world, 3.0, 1.0)
                && let Some(gripper) = &sample.gripper
            {
                self.fingers(*flange, sample.flange_quaternion_world, gripper);
            }
            let [fx, fy, fz, mx, my, mz] = sample.flange_wrench_world;
            if let Some(to) = tip(*flange, [fx, fy, fz], 1.0, FLANGE_M_PER_N) {
                self.arrow(*flange, to, theme::FLANGE_WRENCH);
            }
            if let Some(to) = tip(*flange, [mx, my, mz], 0.3, FLANGE_M_PER_NM) {
                // Two heads tell a moment from a force.
                let neck = std::array::from_fn(|i| flange[i] + 0.75 * (to[i] - flange[i]));
                self.arrow(*flange, to, theme::FLANGE_MOMENT);
                self.arrow(*flange, neck, theme::FLANGE_MOMENT);
            }
        }
    }

    /// Draws two fingers, what connects them and a cube for what they hold; they close as those of a Franka Hand.
    fn fingers(&self, flange: [f64; 3], quaternion: [f64; 4], gripper: &GripperState) {
        let axes = axes(quaternion);
        let world = |flange_m: [f64; 3]| -> [f64; 3] {
            std::array::from_fn(|i| flange[i] + (0..3).map(|k| axes[k][i] * flange_m[k]).sum::<f64>())
        };
        let [tip, closing] = [gripper.object_flange_m, FRANKA_HAND.closing_flange];
        let point =
            |share: f64, apart_m: f64| world(std::array::from_fn(|k| share * tip[k] + apart_m * closing[k]));
        let colour = theme::strong(self.visuals);
        let (wide, half) = (0.5 * gripper.width_max_m, 0.5 * gripper.width_m);
        self.line(point(PALM, -wide), point(PALM, wide), Stroke::new(3.0, colour));
        for apart_m in [-half, half] {
            self.line(point(PALM, apart_m), point(1.0, apart_m), Stroke::new(5.0, colour));
        }
        if gripper.is_holding() {
            let [c0, c1, _] = closing;
            let edges = [closing, [-c1, c0, 0.0], [0.0, 0.0, 1.0]];
            let corner = |corner: usize| {
                let side = |axis: usize| if corner >> axis & 1 == 0 { -half } else { half };
                world(std::array::from_fn(|k| {
                    tip[k] + (0..3).map(|axis| side(axis) * edges[axis][k]).sum::<f64>()
                }))
            };
            for one in 0..8 {
                for other in (0..3).map(|axis| one | 1 << axis).filter(|other| *other != one) {
                    self.line(corner(one), corner(other), Stroke::new(2.0, colour));
                }
            }
        }
    }

    /// Draws the desired flange: its axes, pale, in a ring.
    fn desired(&self, sample: &Sample) {
        let at = sample.flange_desired_position_world;
        if self.axes(at, sample.flange_desired_quaternion_world, 5.0, 0.45)
            && let Some((centre, scale)) = self.at(at)
        {
            self.painter.circle_stroke(centre, 0.07 * scale, Stroke::new(2.0, theme::curve(3)));
        }
    }

    /// The axes of a frame; none without an orientation, which only an entered law has. Whether they were drawn.
    fn axes(&self, origin: [f64; 3], quaternion: [f64; 4], width: f32, opacity: f32) -> bool {
        let length: f64 = quaternion.iter().map(|part| part * part).sum();
        let known = (length - 1.0).abs() < 0.1;
        if known {
            let colours = [theme::BAD, theme::GOOD, theme::curve(0)];
            for (axis, colour) in axes(quaternion).into_iter().zip(colours) {
                let end = std::array::from_fn(|i| origin[i] + AXIS_M * axis[i]);
                self.line(origin, end, Stroke::new(width, colour.gamma_multiply(opacity)));
            }
        }
        known
    }

    /// The way of the flange in the last seconds, paler the longer ago.
    fn trail(&self, model: &Model) {
        let end_s = model.history.end_s().unwrap_or(0.0);
        let window_s = end_s - TRAIL_S..end_s;
        let points = model.history.sampled([0, 1, 2].map(Signal::Flange), window_s, TRAIL_POINTS);
        let places: Vec<Pos2> = points.iter().filter_map(|point| Some(self.at(*point)?.0)).collect();
        let pieces: u8 = 4;
        let length = places.len().div_ceil(usize::from(pieces)).max(1);
        for (piece, opacity) in places.chunks(length).zip(1..=pieces) {
            let colour = theme::curve(0).gamma_multiply(f32::from(opacity) / f32::from(pieces));
            self.painter.add(Shape::line(piece.to_vec(), Stroke::new(2.0, colour)));
        }
    }

    /// Force and moment that the cover exerts on the base, above its lid.
    fn wrench(&self, model: &Model, sample: &Sample) {
        let [fx, fy, mz] = sample.cover_wrench_base;
        let z = model.robot.base_size_m[2] + 0.02;
        let force_n = fx.hypot(fy);
        if force_n > 0.1 {
            let length = (force_n * ARROW_M_PER_N).min(ARROW_MAX_M) / force_n;
            let to = self.in_world([fx * length, fy * length, z]);
            self.arrow(self.in_world([0.0, 0.0, z]), to, theme::WRENCH);
        }
        let angle = (mz * ARC_RAD_PER_NM).limited(-ARC_MAX_RAD, ARC_MAX_RAD);
        if angle.abs() > 0.03 {
            let at = |part: f64| {
                let (sin, cos) = (angle * part).sin_cos();
                self.in_world([ARC_M * cos, ARC_M * sin, z])
            };
            let stroke = Stroke::new(4.0, theme::MOMENT);
            (0..24).for_each(|i| self.line(at(f64::from(i) / 25.0), at(f64::from(i + 1) / 25.0), stroke));
            self.arrow(at(0.96), at(1.0), theme::MOMENT);
        }
    }

    fn arrow(&self, from: [f64; 3], to: [f64; 3], colour: Color32) {
        let (Some((from, _)), Some((to, _))) = (self.at(from), self.at(to)) else { return };
        let along = (to - from).normalized();
        let across = along.rot90();
        let neck = to - along * 11.0;
        if (to - from).length() > 11.0 {
            self.painter.line_segment([from, neck], Stroke::new(4.0, colour));
        }
        let head = vec![to, neck + across * 6.5, neck - across * 6.5];
        self.painter.add(Shape::convex_polygon(head, colour, Stroke::NONE));
    }
}

/// Tip of the arrow of a force or moment that is longer than `least`, drawn from `tail`.
fn tip(tail: [f64; 3], vector: [f64; 3], least: f64, m_per_unit: f64) -> Option<[f64; 3]> {
    let [x, y, z] = vector;
    let size = x.hypot(y).hypot(z);
    let scale = (size * m_per_unit).min(ARROW_MAX_M) / size;
    (size > least && scale.is_finite()).then(|| std::array::from_fn(|i| tail[i] + scale * vector[i]))
}

/// The plate whose outer side is seen at a place of a picture, 0 is T1.
pub(in crate::ui) fn plate_at(
    painter: &Painter,
    visuals: &Visuals,
    model: &Model,
    sample: &Sample,
    camera: OrbitCamera,
    place: Pos2,
) -> Option<usize> {
    let picture = Picture::new(painter, visuals, sample, camera);
    let plates = model.robot.taxels.iter().enumerate().filter(|(_, taxel)| picture.shows_front(taxel));
    let hit = |(_, taxel): &(usize, &TaxelPlacement)| {
        let corners = picture.outer_side(taxel, model).map(|corner| Some(picture.at(corner)?.0));
        let [Some(a), Some(b), Some(c), Some(d)] = corners else { return false };
        let side = |from: Pos2, to: Pos2| (to - from).rot90().dot(place - from);
        let sides = [side(a, b), side(b, c), side(c, d), side(d, a)];
        sides.iter().all(|side| *side >= 0.0) || sides.iter().all(|side| *side <= 0.0)
    };
    plates.filter(hit).map(|(index, _)| index).next()
}

/// Returns a free place for a text inside `picture`, near `wanted`: below or above the texts that are there already.
fn free(wanted: Rect, picture: Rect, taken: &[Rect]) -> Rect {
    let most = (picture.max - wanted.size()).max(picture.min);
    let inside = Rect::from_min_size(wanted.min.min(most).max(picture.min), wanted.size());
    let moved = |down: bool| {
        let mut place = inside;
        while let Some(other) = taken.iter().find(|other| other.intersects(place)) {
            let by =
                if down { other.bottom() + GAP - place.top() } else { other.top() - GAP - place.bottom() };
            place = place.translate(vec2(0.0, by));
        }
        place
    };
    let below = moved(true);
    if picture.contains_rect(below) { below } else { moved(false) }
}

/// Force of a taxel with a valid reading, N.
fn valid_force_n(sample: &Sample, taxel: usize) -> Option<f64> {
    let reading = sample.taxels.get(taxel)?;
    (reading.status == TaxelStatus::Ok && reading.force_n.is_finite()).then_some(reading.force_n)
}

/// A colour on a side that has this share of the light.
fn lit(colour: Color32, light: f32) -> Color32 {
    let [r, g, b, a] = colour.to_srgba_unmultiplied();
    #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "a share of a byte")]
    let dim = |part: u8| (f32::from(part) * light) as u8;
    Color32::from_rgba_unmultiplied(dim(r), dim(g), dim(b), a)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn texts_stand_beside_each_other_and_in_the_picture() {
        let picture = Rect::from_min_size(pos2(0.0, 0.0), vec2(200.0, 100.0));
        let size = vec2(60.0, 18.0);
        for corner in [[20.0, 40.0], [-30.0, -5.0], [190.0, 95.0]] {
            let mut taken = Vec::new();
            for nudge in 0_u8..4 {
                let wanted = Rect::from_min_size(pos2(corner[0], corner[1] + f32::from(nudge)), size);
                let place = free(wanted, picture, &taken);
                assert!(picture.contains_rect(place), "{place:?}");
                assert!(taken.iter().all(|other: &Rect| !other.intersects(place)), "{place:?} in {taken:?}");
                taken.push(place);
            }
        }
    }
}
