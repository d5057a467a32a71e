//! Numbers beside the robot: wrenches and pose, and how healthy connection, loop and board are.

use super::requests::PageRequests;
use super::theme;
use crate::logic::{
    format::{number, speed_limit},
    limited::Limited,
    model::{Freshness, Model, SILENCE_S},
    requests::{explanation, label},
};
use egui::{Align, Button, Grid, Label, Layout, RichText, Role, Sense, Ui, WidgetInfo, pos2, vec2};
use moca_msgs::{ArmMode, Request, Sample, SpeedLimit, seconds};

/// Share of commands that reach an arm in time below which its reflex is near.
const SUCCESS_RATE_LOW: f64 = 0.95;

/// Width from which on two counters stand beside each other, points.
const TWO_COUNTERS: f32 = 378.0;

/// Draws the numbers of the parts that the robot has: wrenches and pose, then gauges, then counters.
/// Where there is little room, the counters are on the page Loop only.
pub(super) fn show(ui: &mut Ui, model: &Model, now_s: f64, little_room: bool, pressed: &mut PageRequests) {
    let Some(sample) = &model.latest else { return };
    let live = model.freshness(now_s) == Freshness::Live;
    ui.add_enabled_ui(live, |ui| {
        if model.robot.has_robot() {
            ui.separator();
            wrenches(ui, model, sample);
        }
        ui.separator();
        gauges(ui, model, sample, now_s);
        posture(ui, model, sample, now_s, pressed);
        if !little_room {
            ui.separator();
            counters(ui, model, sample);
        }
    });
}

fn wrenches(ui: &mut Ui, model: &Model, sample: &Sample) {
    let [fx, fy, mz] = sample.cover_wrench_base;
    let [x, y, yaw] = sample.base_pose_world;
    let [ex, ey, ez, mx, my, flange_mz] = sample.flange_wrench_world;
    let (base, arm) = (model.robot.has_base(), model.robot.has_arm());
    let rows = [
        (base, "Base wrench", [("fx", fx, 1, "N"), ("fy", fy, 1, "N"), ("mz", mz, 1, "N·m")]),
        (base, "Base pose", [("x", x, 3, "m"), ("y", y, 3, "m"), ("yaw", yaw, 3, "rad")]),
        (arm, "Flange force", [("fx", ex, 1, "N"), ("fy", ey, 1, "N"), ("fz", ez, 1, "N")]),
        (arm, "   moment", [("mx", mx, 1, "N·m"), ("my", my, 1, "N·m"), ("mz", flange_mz, 1, "N·m")]),
    ];
    Grid::new("wrench").num_columns(4).spacing([4.0, 1.0]).show(ui, |ui| {
        for (_, name, values) in rows.into_iter().filter(|(has_part, ..)| *has_part) {
            ui.strong(name);
            for (axis, value, decimals, unit) in values {
                value_cell(ui, axis, &number(value, decimals), unit, 96.0);
            }
            ui.end_row();
        }
    });
}

fn gauges(ui: &mut Ui, model: &Model, sample: &Sample, now_s: f64) {
    let robot = &model.robot;
    let deadline_ms = robot.frame_deadline_s * 1e3;
    let ms = |name, value: f64, limit: f64, hint| Gauge { name, value, limit, unit: "ms", decimals: 0, hint };
    Grid::new("gauges").num_columns(3).spacing([10.0, 1.0]).show(ui, |ui| {
        if !model.recorded {
            ms("Connection", model.silent_for_s(now_s) * 1e3, SILENCE_S * 1e3, hints::CONNECTION).show(ui);
        }
        let (value, limit) = (sample.lateness_s * 1e6, robot.period_s * 1e6);
        Gauge { name: "Loop lateness", value, limit, unit: "µs", decimals: 0, hint: hints::LATENESS }
            .show(ui);
        if robot.has_cover() {
            let age_ms = if sample.frame_age_s < 0.0 { f64::NAN } else { sample.frame_age_s * 1e3 };
            ms("Frame age", age_ms, deadline_ms, hints::FRAME_AGE).show(ui);
        }
        if let Some(link) = &sample.link {
            let of = |name: &str| robot.number(name).unwrap_or(f64::NAN);
            if link.arm.mode != ArmMode::NotThere {
                let deadline_ms = of("plant.arm.deadline_s") * 1e3;
                ms("Arm state age", link.arm_age_s * 1e3, deadline_ms, hints::STATE_AGE).show(ui);
            }
            if robot.has_base() {
                let deadline_ms = of("plant.base.deadline_s") * 1e3;
                ms("Base state age", link.base_age_s * 1e3, deadline_ms, hints::STATE_AGE).show(ui);
            }
        }
        if robot.has_base() {
            speeds(ui, model, sample);
        }
    });
    if robot.has_base() {
        let SpeedLimit { m_s, reason } = sample.speed_limit;
        let text = format!("Speed limit {} m/s: {}", number(m_s, 2), speed_limit(reason));
        ui.add(Label::new(text).truncate());
    }
    if let Some(link) = sample.link.filter(|link| link.arm.mode != ArmMode::NotThere) {
        let text = RichText::new(format!("Arm {}", link.arm));
        let odd = !link.arm.mode.follows() || link.arm.success_rate < SUCCESS_RATE_LOW;
        ui.add(Label::new(if odd { text.color(theme::WARNING) } else { text }).truncate());
    }
}

/// Displacement of the base from where the arm's posture wants it, and the button that brings it back.
fn posture(ui: &mut Ui, model: &Model, sample: &Sample, now_s: f64, pressed: &mut PageRequests) {
    let Some(posture) = sample.posture.filter(|posture| posture.recentring || posture.is_large()) else {
        return;
    };
    ui.horizontal(|ui| {
        ui.label(format!("Base {posture}"));
        let button = Button::new(label(Request::Recentre));
        let response = ui.add_enabled(!posture.recentring && model.allows(Request::Recentre, now_s), button);
        let hint = explanation(Request::Recentre);
        if response.on_hover_text(hint).on_disabled_hover_text(hint).clicked() {
            pressed.requests.push(Request::Recentre);
        }
    });
}

/// Draws the gauges of the base's speeds, and of its way towards a side without a taxel.
fn speeds(ui: &mut Ui, model: &Model, sample: &Sample) {
    let robot = &model.robot;
    let [x, y, yaw] = sample.base_velocity_world;
    let [x_max, y_max, yaw_max] = robot.base_velocity_max;
    let gauge = |name, value, limit, unit, hint| Gauge { name, value, limit, unit, decimals: 2, hint };
    gauge("Cover speed", sample.cover_speed_m_s, sample.speed_limit.m_s, "m/s", hints::COVER_SPEED).show(ui);
    if let Some(most_m) = robot.number("protection.uncovered_m") {
        gauge("Uncovered way", sample.uncovered_way_m, most_m, "m", hints::UNCOVERED).show(ui);
    }
    gauge("Base speed", x.hypot(y), x_max.min(y_max), "m/s", hints::BASE_SPEED).show(ui);
    gauge("Base turning", yaw.abs(), yaw_max, "rad/s", hints::BASE_SPEED).show(ui);
}

/// Shows the counters since the start.
pub(super) fn counters(ui: &mut Ui, model: &Model, sample: &Sample) {
    let dropped = model.status.ring_dropped + model.status.client_dropped;
    let counters = [
        ("Frame rate", number(sample.frame_rate_hz, 1), "Hz", false),
        ("Frames good", sample.frames_good.to_string(), "", false),
        ("Loop overruns", sample.overruns.to_string(), "", sample.overruns > 0),
        ("Frames bad", sample.frames_bad.to_string(), "", sample.frames_bad > 0),
        ("Samples lost", dropped.to_string(), "", dropped > 0),
        ("Run time", number(seconds(sample.time_ns), 0), "s", false),
    ];
    let columns = if ui.available_width() < TWO_COUNTERS { 1 } else { 2 };
    Grid::new(ui.scope_id().with("counters")).spacing([10.0, 1.0]).show(ui, |ui| {
        for row in counters.chunks(columns) {
            row.iter().for_each(|(name, value, unit, odd)| counter(ui, name, value, unit, *odd));
            ui.end_row();
        }
    });
}

/// Axis, right-aligned number, unit, in a cell of fixed width so that nothing jumps.
fn value_cell(ui: &mut Ui, axis: &str, value: &str, unit: &str, width: f32) {
    ui.allocate_ui_with_layout(vec2(width, 18.0), Layout::left_to_right(Align::Center), |ui| {
        ui.spacing_mut().item_spacing.x = 3.0;
        ui.weak(axis);
        ui.with_layout(Layout::right_to_left(Align::Center), |ui| {
            ui.allocate_ui_with_layout(vec2(26.0, 18.0), Layout::left_to_right(Align::Center), |ui| {
                ui.weak(unit)
            });
            ui.monospace(value);
        });
    });
}

fn counter(ui: &mut Ui, name: &str, value: &str, unit: &str, conspicuous: bool) {
    ui.label(name);
    ui.allocate_ui_with_layout(vec2(84.0, 18.0), Layout::right_to_left(Align::Center), |ui| {
        ui.set_min_size(vec2(84.0, 18.0));
        ui.spacing_mut().item_spacing.x = 3.0;
        ui.allocate_ui_with_layout(vec2(16.0, 18.0), Layout::left_to_right(Align::Center), |ui| {
            ui.weak(unit)
        });
        let text = RichText::new(value).monospace();
        ui.label(if conspicuous { text.color(theme::WARNING) } else { text });
    });
}

/// A bar from 0 to one and a half times `limit`, with a mark at `limit`.
struct Gauge {
    name: &'static str,
    value: f64,
    limit: f64,
    unit: &'static str,
    decimals: usize,
    /// Normal values, and what to do about others.
    hint: &'static str,
}

impl Gauge {
    fn show(&self, ui: &mut Ui) {
        let Self { name, value, limit, unit, decimals, hint } = *self;
        let [now, most] = [value, limit].map(|value| number(value, decimals));
        let explained = format!("{name}: {now} {unit}, limit {most} {unit}\n{hint}");
        ui.label(name).on_hover_text(&explained);
        let (response, painter) = ui.allocate_painter(vec2(120.0, 12.0), Sense::hover());
        let rect = response.rect;
        #[expect(clippy::cast_possible_truncation, reason = "a fraction")]
        let part = if value.is_finite() && limit > 0.0 {
            (value / (1.5 * limit)).limited(0.0, 1.0) as f32
        } else {
            0.0
        };
        let colour = theme::share(if limit > 0.0 { value / limit } else { f64::NAN });
        painter.rect_filled(rect, 2.0, ui.visuals().extreme_bg_color);
        let mut bar = rect;
        bar.set_width(rect.width() * part);
        painter.rect_filled(bar, 2.0, colour);
        let mark = rect.left() + rect.width() / 1.5;
        let stroke = (1.5, ui.visuals().text_color());
        painter.line_segment([pos2(mark, rect.top()), pos2(mark, rect.bottom())], stroke);
        let said = format!("{name} {now} {unit} of {most}");
        response.widget_info(|| WidgetInfo::labeled(Role::Meter, true, &said));
        response.on_hover_text(explained);
        ui.allocate_ui_with_layout(vec2(150.0, 18.0), Layout::left_to_right(Align::Center), |ui| {
            ui.spacing_mut().item_spacing.x = 3.0;
            let over = limit > 0.0 && value >= theme::OVER * limit;
            let text = RichText::new(format!("{now:>6} {unit:<6}")).monospace();
            ui.label(if over { text.color(theme::BAD) } else { text });
            ui.weak(format!("of {most}"));
        });
        ui.end_row();
    }
}

/// Normal values of the gauges, and what to do about others.
mod hints {
    pub(super) const CONNECTION: &str = "Time since the last sample. Normal: below 50 ms. Above the limit what is shown is old: look at the network.";
    pub(super) const LATENESS: &str = "How late the loop woke. Normal: below a tenth of the limit, one period. More: end other programs, or \
                                       give the loop real-time rights (`mocad doctor`).";
    pub(super) const FRAME_AGE: &str = "Age of the cover's data. Normal: below half of the limit. At the limit the robot stops: look at cable, board \
                                        and this PC's load.";
    pub(super) const STATE_AGE: &str = "Age of what the robot said last. Normal: a few ms. At the limit the robot stops: look at its network.";
    pub(super) const COVER_SPEED: &str = "Speed of the cover's fastest point. Normal: below the limit, which is slower the older the board's data \
                                          is; the line below says why.";
    pub(super) const UNCOVERED: &str = "How far the base has gone towards a side without a taxel. Normal: 0. Near the limit it slows down: touch \
                                        or lead it elsewhere.";
    pub(super) const BASE_SPEED: &str = "Speed of the base's middle. Normal: up to the limit. Over it for long: stop, and look at the base's driver.";
}
