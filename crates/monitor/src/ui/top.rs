//! Mode and why, and the buttons.

use super::{requests::PageRequests, row, theme};
use crate::logic::{
    format::taxel_name,
    gripper::object,
    limited::Limited,
    model::{Freshness, Model},
    requests::{explanation, label},
};
use egui::{
    Align, Button, Color32, Context, FontId, Label, Layout, Rect, RichText, Sense, Theme, Ui, UiBuilder,
    pos2, vec2,
};
use moca_msgs::{GripperState, Law, Mode, Request, Sample, TaxelStatus, board::Diagnosis};
use moca_telemetry::net::Commander;

/// Narrowest and widest banner, and what the buttons and STOP beside it take, points.
const BANNER: (f32, f32) = (190.0, 310.0);
const BUTTONS: f32 = 540.0;
const STOP: f32 = 186.0;
const BANNER_HEIGHT: f32 = 50.0;
/// Height of a line of the banner as a share of its letters.
const LINE: f32 = 1.2;
/// Size of a tab's letters, points.
const TAB: f32 = 15.0;
/// Steps of the size of everything, and its range.
const ZOOM_STEP: f32 = 0.1;
const ZOOM: (f32, f32) = (0.7, 2.5);

/// A robot or log as its button shows it.
pub(super) struct TabName {
    /// Text on the button.
    pub(super) name: String,
    /// The longest that is ever written on it: the buttons beside it stay where they are.
    pub(super) longest: String,
    /// Its mode, which colours its dot.
    pub(super) mode: Option<Mode>,
}

/// Draws a button for each robot and log; the chosen one comes to the front.
pub(super) fn tabs(ui: &mut Ui, names: impl Iterator<Item = TabName>, shown: &mut usize) {
    ui.add_space(4.0);
    ui.horizontal_wrapped(|ui| {
        for (index, TabName { name, longest, mode }) in names.enumerate() {
            let (dot, _) = ui.allocate_exact_size(vec2(12.0, 12.0), egui::Sense::hover());
            ui.painter().circle_filled(dot.center(), 6.0, theme::mode(mode));
            let colour = ui.visuals().text_color();
            let widest = ui.painter().layout_no_wrap(longest, FontId::proportional(TAB), colour).size().x;
            let width = widest + 2.0 * ui.spacing().button_padding.x;
            let button = Button::selectable(*shown == index, RichText::new(name).size(TAB));
            if ui.add(button.min_size(vec2(width, 0.0))).clicked() {
                *shown = index;
            }
        }
    });
}

/// Draws the top of the window and notes which buttons were pressed.
pub(super) fn show(
    ui: &mut Ui,
    model: &Model,
    address: &str,
    now_s: f64,
    anybody_to_stop: bool,
    pressed: &mut PageRequests,
) {
    ui.add_space(4.0);
    let narrow = ui.available_width() < BUTTONS + STOP + BANNER.0;
    let banner =
        (ui.available_width() - STOP - if narrow { 0.0 } else { BUTTONS }).limited(BANNER.0, BANNER.1);
    ui.horizontal(|ui| {
        mode(ui, model, now_s, banner);
        if !narrow {
            buttons(ui, model, now_s, pressed);
        }
        ui.with_layout(Layout::right_to_left(Align::Center), |ui| stop(ui, anybody_to_stop, pressed));
    });
    if narrow {
        ui.horizontal_wrapped(|ui| buttons(ui, model, now_s, pressed));
    }
    let (line, _) = ui.allocate_exact_size(vec2(ui.available_width(), row::PLACE), Sense::hover());
    let layout = Layout::right_to_left(Align::TOP);
    let ui = &mut ui.new_child(UiBuilder::new().max_rect(line).layout(layout));
    looks(ui);
    let (colour, text) = reason(model, address, now_s);
    let colour = colour.unwrap_or_else(|| ui.visuals().text_color());
    let rest = Rect::from_min_max(line.min, pos2(ui.cursor().right(), line.bottom()));
    row::in_place(ui, rest, &text, colour);
}

/// Light or dark, and how large everything is.
fn looks(ui: &mut Ui) {
    for theme in [Theme::Dark, Theme::Light] {
        let chosen = ui.theme() == theme;
        if ui.selectable_label(chosen, if theme == Theme::Dark { "Dark" } else { "Light" }).clicked() {
            ui.set_theme(theme);
        }
    }
    for (label, step) in [("A+", ZOOM_STEP), ("A−", -ZOOM_STEP)] {
        let hint =
            format!("Size of everything: {:.0} %. Ctrl + and Ctrl − do it too.", 100.0 * ui.zoom_factor());
        if ui.button(label).on_hover_text(hint).clicked() {
            set_zoom(ui, ui.zoom_factor() + step);
        }
    }
}

/// Sets the size of everything, 1 is the desktop's.
pub(super) fn set_zoom(ctx: &Context, zoom: f32) {
    ctx.set_zoom_factor(zoom.limited(ZOOM.0, ZOOM.1));
}

/// A button for each request that makes sense for the parts that the robot has.
fn buttons(ui: &mut Ui, model: &Model, now_s: f64, pressed: &mut PageRequests) {
    let mut button = |ui: &mut Ui, request: Request, selected: bool| {
        let widget = Button::selectable(selected, RichText::new(label(request)).size(15.0))
            .frame_when_inactive(true)
            .min_size(vec2(66.0, 46.0));
        let response = ui.add_enabled(model.allows(request, now_s), widget);
        let hint = explanation(request);
        let why_not = model.mode(now_s).and_then(|mode| request.remedy_in(mode));
        let why_not = why_not.map_or_else(|| hint.to_owned(), |remedy| format!("{hint}\nNot now: {remedy}."));
        if response.on_hover_text(hint).on_disabled_hover_text(why_not).clicked() {
            pressed.requests.push(request);
        }
    };
    button(ui, Request::Tare, false);
    if !model.robot.has_robot() {
        return;
    }
    for request in [Request::Arm, Request::Disarm, Request::Resume] {
        button(ui, request, false);
    }
    ui.separator();
    for law in [Law::Impedance, Law::FollowMe] {
        button(ui, Request::SelectLaw(law), model.law == law);
    }
}

/// The mode of a robot that runs, readable from three metres.
fn mode(ui: &mut Ui, model: &Model, now_s: f64, width: f32) {
    let mode = model.live_mode(now_s);
    let name = match model.freshness(now_s) {
        _ if model.recorded => "recorded",
        Freshness::Live => mode.map_or("–", Mode::name),
        Freshness::Silent => "no samples",
        Freshness::Down(_) => "no daemon",
    };
    let (rect, _) = ui.allocate_exact_size(vec2(width, BANNER_HEIGHT), Sense::hover());
    ui.painter().rect_filled(rect, 4.0, theme::mode(mode));
    let armed = mode.is_some_and(Mode::moves) && !model.recorded;
    let lines: &[(&str, f32)] = if armed { &[("ARMED", 24.0), (name, 16.0)] } else { &[(name, 38.0)] };
    let scale = width / BANNER.1;
    let height: f32 = lines.iter().map(|(_, size)| LINE * size * scale).sum();
    let mut top = rect.center().y - height / 2.0;
    for (text, size) in lines {
        let line = Rect::from_min_size(pos2(rect.left(), top), vec2(rect.width(), LINE * size * scale));
        let text = RichText::new(*text).size(size * scale).strong().color(Color32::WHITE);
        ui.put(line, Label::new(text).selectable(false).truncate());
        top = line.bottom();
    }
}

/// Stops every robot that is connected, whatever is in front.
fn stop(ui: &mut Ui, enabled: bool, pressed: &mut PageRequests) {
    let text = RichText::new(label(Request::Stop)).size(20.0).strong().color(Color32::WHITE);
    let button = Button::new(text).fill(theme::BAD).min_size(vec2(160.0, 50.0));
    if ui.add_enabled(enabled, button).on_hover_text(explanation(Request::Stop)).clicked() {
        pressed.requests.push(Request::Stop);
    }
}

/// Returns the fault with its remedy, or the name of the robot.
fn reason(model: &Model, address: &str, now_s: f64) -> (Option<Color32>, String) {
    match model.freshness(now_s) {
        Freshness::Down(reason) => {
            if model.recorded {
                return (Some(theme::WARNING), reason);
            }
            let text = format!(
                "No daemon at {address} ({reason}). Start it with `cargo run --release`; trying again …"
            );
            return (Some(theme::BAD), text);
        }
        Freshness::Silent => {
            let text = "Connected, but no samples come: what is shown is old.";
            return (Some(theme::BAD), text.into());
        }
        Freshness::Live => {}
    }
    let Some(sample) = &model.latest else {
        return (None, String::new());
    };
    if model.recorded {
        let name = &model.robot.name;
        let fault = sample.fault.map(|fault| model.robot.fault_text(fault));
        let fault = fault.map_or_else(String::new, |fault| format!(": {fault}"));
        let text = format!("A recorded run of {name}, then in mode {}{fault}", sample.mode.name());
        return (Some(theme::WARNING), text);
    }
    if let Some(fault) = sample.fault {
        return (Some(theme::BAD), model.robot.fault_text(fault));
    }
    if !matches!(sample.board, Diagnosis::Frames | Diagnosis::NoBoard) {
        return (Some(theme::WARNING), model.robot.board_text(sample.board));
    }
    if let Some(fault) = sample.gripper.and_then(|gripper| gripper.fault) {
        return (Some(theme::WARNING), fault.to_string());
    }
    let kind = if model.robot.simulated { ", simulated" } else { "" };
    let command = match model.status.commander {
        Commander::Nobody => "",
        Commander::You => " · you have the command",
        Commander::Another => " · another dashboard has the command",
    };
    let arm = model.robot.arm_name.as_str();
    let what = match (model.robot.has_robot(), model.robot.has_arm()) {
        (false, _) => "cover alone",
        (true, false) => "base alone",
        (true, true) => arm,
    };
    let cover = if model.robot.uncalibrated.is_empty() { "" } else { " · cover uncalibrated" };
    let held = sample.gripper.filter(GripperState::is_holding);
    let held = held.map_or_else(String::new, |gripper| format!(" · object {}", object(&gripper)));
    (None, format!("{} ({what}{kind}){command}{cover}{}{held}", model.robot.name, masked(sample)))
}

/// The taxels that are out of use, by number.
fn masked(sample: &Sample) -> String {
    let taxels = sample.taxels.iter().enumerate().filter(|(_, taxel)| taxel.status == TaxelStatus::Masked);
    let names: Vec<String> = taxels.map(|(index, _)| taxel_name(index)).collect();
    if names.is_empty() { String::new() } else { format!(" · masked: {}", names.join(", ")) }
}
