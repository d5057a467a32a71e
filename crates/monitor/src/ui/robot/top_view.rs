//! The robot from above, to scale, on a floor with a grid of half a metre: base, ring of taxels, arm, flange, and the
//! wrench on the base. x of the world points up.

use super::legend::legend;
use super::scale::{ARC_MAX_RAD, ARC_RAD_PER_NM, ARROW_M_PER_N, ARROW_MAX_M, FLANGE_M_PER_N, FULL_COLOUR_N};
use crate::logic::{
    format::{number, taxel_name},
    kinematics,
    limited::Limited,
    model::{Freshness, Model},
};
use crate::ui::{theme, view::View};
use egui::{
    Align2, Color32, FontId, Id, Key, Painter, Pos2, Rect, Sense, Shape, Slider, Stroke, Ui, Vec2,
    WidgetInfo, pos2, vec2,
};
use moca_msgs::TaxelPlacement;
use moca_msgs::{Sample, TaxelStatus, request::PRESS_FORCE_MAX_N};

/// Least and greatest height of the picture, points.
const HEIGHT: (f32, f32) = (165.0, 640.0);
/// Height of a number beside a taxel that nobody touches, m: three stand beside each other in front.
const SMALL_M: f64 = 0.075;
/// Below so many points for a metre three numbers do not stand beside each other.
const CROWDED: f64 = 120.0;
/// Room for a taxel's number and force beside the base, points.
const LABEL: f32 = 84.0;
/// Room above it, points.
const LABEL_ABOVE: f32 = 56.0;
/// Half of a taxel's length along the cover, m.
const TAXEL_HALF_M: f64 = 0.09;
/// Thickness of a taxel, m.
const TAXEL_THICK_M: f64 = 0.03;
/// Length of a bar, m for each N.
const BAR_M_PER_N: f64 = 0.0025;
/// Radius of the arc of the base's moment, m.
const ARC_RADIUS_M: f64 = 0.17;

/// Mapping of the world and of the base to the screen.
struct Camera {
    centre: Pos2,
    points_per_m: f64,
    base_world: [f64; 3],
}

impl Camera {
    #[expect(clippy::cast_possible_truncation, reason = "screen coordinates")]
    fn offset(&self, [x, y]: [f64; 2]) -> Vec2 {
        vec2((-y * self.points_per_m) as f32, (-x * self.points_per_m) as f32)
    }

    /// A point of the world.
    fn world(&self, [x, y]: [f64; 2]) -> Pos2 {
        self.centre + self.offset([x - self.base_world[0], y - self.base_world[1]])
    }

    /// A direction of the base, with its length.
    fn direction(&self, [x, y]: [f64; 2]) -> Vec2 {
        let (sin, cos) = self.base_world[2].sin_cos();
        self.offset([cos * x - sin * y, sin * x + cos * y])
    }

    /// A point of the base.
    fn base(&self, point: [f64; 2]) -> Pos2 {
        self.centre + self.direction(point)
    }
}

/// Draws the robot `height` points high, with what belongs to it below, and returns the taxel that is pressed with mouse or
/// keyboard, with the force chosen for it, N.
pub(in crate::ui) fn show(
    ui: &mut Ui,
    model: &Model,
    view: &mut View,
    now_s: f64,
    height: f32,
) -> Option<(u8, f64)> {
    let size = vec2(ui.available_width(), self::height(height));
    let (response, painter) = ui.allocate_painter(size, Sense::hover());
    let rect = response.rect;
    painter.rect_filled(rect, 4.0, ui.visuals().extreme_bg_color);
    let Some(sample) = &model.latest else {
        let text = "The robot appears here once its daemon runs.";
        painter.text(
            rect.center(),
            Align2::CENTER_CENTER,
            text,
            FontId::proportional(15.0),
            ui.visuals().text_color(),
        );
        return None;
    };
    let camera = Camera {
        centre: rect.center() + vec2(0.0, 6.0),
        points_per_m: points_per_m(rect, model.robot.base_size_m),
        base_world: sample.base_pose_world.map(|v| if v.is_finite() { v } else { 0.0 }),
    };
    let mut pushed = None;
    ui.scope(|ui| {
        if model.freshness(now_s) != Freshness::Live {
            ui.set_opacity(0.4);
        }
        let painter = ui.painter_at(rect);
        floor(&painter, &camera, rect, ui.visuals().weak_text_color());
        base(&painter, &camera, model, ui.visuals());
        for (index, taxel) in model.robot.taxels.iter().enumerate() {
            let at = Taxel { index, description: *taxel, camera: &camera };
            if at.show(ui, &painter, sample, model) {
                pushed = u8::try_from(index).ok().map(|i| (i, view.push_n));
            }
        }
        if model.robot.has_arm() {
            arm_and_flange(&painter, &camera, model, sample, ui.visuals());
            flange_force(&painter, &camera, sample);
        }
        if model.robot.has_robot() {
            wrench(&painter, &camera, sample.cover_wrench_base);
        }
        age(&painter, rect, sample, model, ui.visuals());
    });
    ui.horizontal_wrapped(|ui| legend(ui, model, false));
    if model.feels_pushes() && !model.recorded {
        ui.horizontal(|ui| {
            let label = ui.label("Press and hold a taxel to push with");
            let slider =
                Slider::new(&mut view.push_n, 1.0..=PRESS_FORCE_MAX_N).suffix(" N").fixed_decimals(0);
            let hint = "Force of a push. With the keyboard: Tab to a taxel, then hold Enter";
            ui.add(slider.logarithmic(true)).labelled_by(label.id).on_hover_text(hint);
        });
    }
    pushed
}

/// Height of the picture where `height` points are left for it.
pub(in crate::ui) fn height(height: f32) -> f32 {
    height.limited(HEIGHT.0, HEIGHT.1)
}

/// As large as the base with the numbers beside it fits, however it is turned.
fn points_per_m(rect: Rect, [length, width, _]: [f64; 3]) -> f64 {
    let half_m = length.max(width) / 2.0 + TAXEL_THICK_M;
    let wide = f64::from((rect.width() / 2.0 - LABEL).max(40.0)) / half_m;
    let high = f64::from((rect.height() / 2.0 - LABEL_ABOVE).max(40.0)) / half_m;
    wide.min(high)
}

fn floor(painter: &Painter, camera: &Camera, rect: Rect, colour: Color32) {
    const STEP_M: f64 = 0.5;
    let stroke = Stroke::new(0.5, colour.gamma_multiply(0.45));
    let [x0, y0, _] = camera.base_world;
    for i in -3..=3 {
        let x = camera.world([((x0 / STEP_M).round() + f64::from(i)) * STEP_M, y0]).y;
        let y = camera.world([x0, ((y0 / STEP_M).round() + f64::from(i)) * STEP_M]).x;
        painter.hline(rect.x_range(), x, stroke);
        painter.vline(y, rect.y_range(), stroke);
    }
    let corner = rect.left_bottom() + vec2(6.0, -4.0);
    painter.text(corner, Align2::LEFT_BOTTOM, "grid 0.5 m", FontId::proportional(11.0), colour);
}

fn base(painter: &Painter, camera: &Camera, model: &Model, visuals: &egui::Visuals) {
    let [length, width, _] = model.robot.base_size_m.map(|side| side / 2.0);
    let corners = [[length, width], [length, -width], [-length, -width], [-length, width]];
    let corners = corners.map(|corner| camera.base(corner));
    let stroke = Stroke::new(1.5, visuals.text_color());
    painter.add(Shape::convex_polygon(corners.to_vec(), visuals.panel_fill, stroke));
    // A wedge shows which way is forwards.
    let rear = -0.75 * length;
    let wedge = [[rear + 0.1, 0.0], [rear, 0.06], [rear, -0.06]].map(|point| camera.base(point));
    painter.add(Shape::convex_polygon(wedge.to_vec(), visuals.weak_text_color(), Stroke::NONE));
}

/// One taxel of the ring.
struct Taxel<'a> {
    index: usize,
    description: TaxelPlacement,
    camera: &'a Camera,
}

impl Taxel<'_> {
    /// Draws it and returns whether the mouse presses it.
    fn show(&self, ui: &Ui, painter: &Painter, sample: &Sample, model: &Model) -> bool {
        let reading = sample.taxels.get(self.index).copied().unwrap_or_default();
        let name = taxel_name(self.index);
        let valid = reading.status == TaxelStatus::Ok;
        let force_n = if valid && reading.force_n.is_finite() { reading.force_n } else { 0.0 };

        let response = ui.interact(self.rect(), Id::unique(("taxel", self.index)), Sense::click_and_drag());
        let enabled = model.can_push();
        response.widget_info(|| WidgetInfo::labeled(egui::Role::Button, enabled, format!("Push {name}")));
        let by_key = response.has_focus() && ui.input(|i| i.key_down(Key::Enter));
        let pressed = enabled && (response.is_pointer_button_down_on() || by_key);

        let colour =
            if valid { theme::force(force_n, FULL_COLOUR_N, ui.visuals()) } else { Color32::TRANSPARENT };
        let marked = enabled && (response.hovered() || response.has_focus());
        let outline = match (pressed, marked, valid) {
            (true, ..) => Stroke::new(2.5, theme::strong(ui.visuals())),
            (_, true, _) => Stroke::new(1.5, theme::strong(ui.visuals())),
            (.., false) if reading.status == TaxelStatus::Masked => {
                Stroke::new(1.5, ui.visuals().weak_text_color())
            }
            (.., false) => Stroke::new(1.5, theme::BAD),
            _ => Stroke::new(0.5, ui.visuals().weak_text_color()),
        };
        let bar = (force_n * BAR_M_PER_N).min(0.3);
        painter.add(Shape::convex_polygon(self.block(0.0, bar), colour.gamma_multiply(0.6), Stroke::NONE));
        painter.add(Shape::convex_polygon(self.block(-TAXEL_THICK_M, 0.0), colour, outline));
        self.age(painter, sample.frame_age_s / model.robot.frame_deadline_s);

        let value = if valid { format!("{} N", number(force_n, 1)) } else { reading.status.name().into() };
        let masked = reading.status == TaxelStatus::Masked;
        let colour = match (valid, masked) {
            (true, _) => theme::strong(ui.visuals()),
            (_, true) => ui.visuals().weak_text_color(),
            _ => theme::BAD,
        };
        let [x, y, _] = sample.flange_position_world;
        self.label(painter, self.camera.world([x, y]), (&name, &value), colour, force_n > 0.0);
        let health = reading.status.name();
        let counts = sample.counts.get(self.index).map_or("–".into(), u16::to_string);
        if !pressed {
            let age = number(sample.frame_age_s.max(0.0) * 1e3, 0);
            response.on_hover_text(format!("{name}: {health}, {counts} counts, {age} ms old"));
        }
        pressed
    }

    /// A line along the taxel as long as its data is old: the whole taxel is the deadline.
    fn age(&self, painter: &Painter, part: f64) {
        let colour = theme::share(part);
        let ([x, y], angle) = (self.description.position_base_m, self.description.inward_angle_base_rad);
        let (sin, cos) = angle.sin_cos();
        let half = TAXEL_HALF_M * part.limited(0.0, 1.0);
        let out = TAXEL_THICK_M + 0.014;
        let end = |along: f64| self.camera.base([x - out * cos - along * sin, y - out * sin + along * cos]);
        painter.line_segment([end(-half), end(half)], Stroke::new(2.5, colour));
    }

    /// Corners of a block over the taxel's length, between two distances from the cover, inwards positive, m.
    fn block(&self, from_m: f64, to_m: f64) -> Vec<Pos2> {
        let ([x, y], angle) = (self.description.position_base_m, self.description.inward_angle_base_rad);
        let (sin, cos) = angle.sin_cos();
        let corner =
            |along: f64, inward: f64| [x + inward * cos - along * sin, y + inward * sin + along * cos];
        let half = TAXEL_HALF_M;
        [(half, from_m), (-half, from_m), (-half, to_m), (half, to_m)]
            .map(|(along, inward)| self.camera.base(corner(along, inward)))
            .to_vec()
    }

    /// Returns the area in which the mouse takes hold of it.
    fn rect(&self) -> Rect {
        Rect::from_points(&self.block(-2.0 * TAXEL_THICK_M, TAXEL_THICK_M))
    }

    /// Number and value outside the cover, and outside the flange where that is in the way.
    fn label(
        &self,
        painter: &Painter,
        flange: Pos2,
        (name, value): (&str, &str),
        colour: Color32,
        touched: bool,
    ) {
        let (sin, cos) = self.description.inward_angle_base_rad.sin_cos();
        let outward = self.camera.direction([-cos, -sin]).normalized();
        let mut at = self.camera.base(self.description.position_base_m) + outward * 24.0;
        if Rect::from_center_size(at + outward * 20.0, vec2(60.0, 60.0)).contains(flange) {
            at += outward * ((flange - at).dot(outward) + 12.0);
        }
        // Who is touched is read from afar.
        #[expect(clippy::cast_possible_truncation, reason = "a size on the screen")]
        let small = (self.camera.points_per_m * SMALL_M).limited(10.0, 13.0) as f32;
        let font = FontId::proportional(if touched { 18.0 } else { small });
        let width = |text: &str| painter.layout_no_wrap(text.to_owned(), font.clone(), colour).size().x;
        let picture = painter.clip_rect();
        if outward.x.abs() > outward.y.abs() {
            let (align, text) = if outward.x > 0.0 {
                (Align2::LEFT_CENTER, format!("{name}  {value}"))
            } else {
                (Align2::RIGHT_CENTER, format!("{value}  {name}"))
            };
            // Whatever pushes a number outward, the picture still shows it whole.
            let (left, right) = if outward.x > 0.0 { (0.0, width(&text)) } else { (width(&text), 0.0) };
            at.x = at.x.limited(picture.left() + left, picture.right() - right);
            painter.text(at, align, text, font, colour);
        } else {
            // Two texts, because the lines of one would not be centred on each other.
            let (align, line) = if outward.y > 0.0 {
                (Align2::CENTER_TOP, font.size + 2.0)
            } else {
                (Align2::CENTER_BOTTOM, -font.size - 2.0)
            };
            // In a small picture neighbours would write over each other: who is not touched has a name only.
            let small_picture = self.camera.points_per_m < CROWDED;
            if small_picture && touched {
                at += outward * (small + 2.0);
                let high = 1.4 * font.size;
                at.y = at.y.limited(picture.top() + high, picture.bottom() - high);
                painter.text(at, align, format!("{name}  {value}"), font, colour);
                return;
            }
            // So would words of health that are longer than the taxel; its colour and its hint tell them too.
            let wide = !value.ends_with(" N")
                && f64::from(width(value)) > 2.0 * TAXEL_HALF_M * self.camera.points_per_m;
            let crowded = !touched && (small_picture || wide);
            let line = if crowded { 0.0 } else { line };
            let high = line.abs() + 1.4 * font.size;
            at.y = at.y.limited(picture.top() + high, picture.bottom() - high);
            if !crowded {
                painter.text(at, align, value, font.clone(), colour);
            }
            painter.text(at + vec2(0.0, line), align, name, font, colour);
        }
    }
}

fn arm_and_flange(
    painter: &Painter,
    camera: &Camera,
    model: &Model,
    sample: &Sample,
    visuals: &egui::Visuals,
) {
    let points: Vec<Pos2> = kinematics::points_base_m(&model.robot, &sample.q_rad)
        .into_iter()
        .map(|[x, y, _]| camera.base([x, y]))
        .filter(|p| p.x.is_finite() && p.y.is_finite())
        .collect();
    let colour = visuals.text_color();
    painter.add(Shape::line(points.clone(), Stroke::new(6.0, colour.gamma_multiply(0.55))));
    for point in &points {
        painter.circle_filled(*point, 4.0, colour);
    }
    let [x, y, _] = sample.flange_position_world;
    painter.circle(camera.world([x, y]), 6.0, theme::curve(0), Stroke::new(1.5, visuals.panel_fill));
    // The cross is where the flange should be.
    let [x, y, _] = sample.flange_desired_position_world;
    let (centre, stroke) = (camera.world([x, y]), Stroke::new(2.0, theme::curve(3)));
    for arm in [vec2(9.0, 0.0), vec2(0.0, 9.0)] {
        painter.line_segment([centre - arm, centre + arm], stroke);
    }
}

/// Arrow of the horizontal force on the flange.
fn flange_force(painter: &Painter, camera: &Camera, sample: &Sample) {
    let [fx, fy, ..] = sample.flange_wrench_world;
    let force = fx.hypot(fy);
    if force > 1.0 {
        let length = (force * FLANGE_M_PER_N).min(ARROW_MAX_M) / force;
        let [x, y, _] = sample.flange_position_world;
        let stroke = Stroke::new(3.0, theme::FLANGE_WRENCH);
        painter.arrow(camera.world([x, y]), camera.offset([fx * length, fy * length]), stroke);
    }
}

/// Shows the age of the cover's data.
fn age(painter: &Painter, rect: Rect, sample: &Sample, model: &Model, visuals: &egui::Visuals) {
    let deadline_s = model.robot.frame_deadline_s;
    let (text, colour) = match sample.frame_age_s {
        _ if model.robot.taxels.is_empty() => ("no cover".to_owned(), visuals.weak_text_color()),
        age_s if age_s < 0.0 => ("no data from the cover yet".to_owned(), visuals.weak_text_color()),
        age_s if age_s < deadline_s => {
            (format!("cover {} ms old", number(age_s * 1e3, 0)), visuals.weak_text_color())
        }
        age_s => (format!("cover {} s old", number(age_s, 1)), theme::BAD),
    };
    let corner = rect.right_bottom() + vec2(-6.0, -4.0);
    painter.text(corner, Align2::RIGHT_BOTTOM, text, FontId::proportional(11.0), colour);
}

/// Arrow of the force and arc of the moment that the cover exerts on the base.
fn wrench(painter: &Painter, camera: &Camera, [fx, fy, mz]: [f64; 3]) {
    let stroke = Stroke::new(4.0, theme::WRENCH);
    let force = fx.hypot(fy);
    if force > 0.1 {
        let length = (force * ARROW_M_PER_N).min(ARROW_MAX_M) / force;
        painter.arrow(camera.centre, camera.direction([fx * length, fy * length]), stroke);
    }
    let angle = (mz * ARC_RAD_PER_NM).limited(-ARC_MAX_RAD, ARC_MAX_RAD);
    if angle.abs() > 0.03 {
        let at = |part: f64| {
            let (sin, cos) = (angle * part).sin_cos();
            camera.base([ARC_RADIUS_M * cos, ARC_RADIUS_M * sin])
        };
        let points: Vec<Pos2> = (0..=32).map(|i| at(f64::from(i) / 32.0)).collect();
        let (last, tip) = (at(0.97), at(1.0));
        painter.add(Shape::line(points, Stroke::new(4.0, theme::MOMENT)));
        let along = (tip - last).normalized();
        let across = vec2(-along.y, along.x);
        let head = [tip + along * 11.0, tip + across * 8.0, tip - across * 8.0];
        painter.add(Shape::convex_polygon(
            head.map(|p| pos2(p.x, p.y)).to_vec(),
            theme::MOMENT,
            Stroke::NONE,
        ));
    }
}
