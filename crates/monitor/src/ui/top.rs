//! Mode and why, and the buttons.

use super::{requests::PageRequests, theme};
use crate::logic::{
    format::{board_text, taxel_name},
    model::{Freshness, Model},
    parts::{board_name, has_arm, has_robot, text_parameter},
    requests::{explanation, label},
};
use egui::{Align, Button, Color32, Frame, Label, Layout, Margin, RichText, Theme, Ui, vec2};
use moca_msgs::{Law, Mode, Request, Sample, TaxelStatus, board::Diagnosis};
use moca_telemetry::net::Commander;

/// Narrowest and widest banner, and what the buttons and STOP beside it take, points.
const BANNER: (f32, f32) = (190.0, 310.0);
const BUTTONS: f32 = 540.0;
const STOP: f32 = 186.0;
/// Text that is longer is written smaller, bytes.
const LONG: usize = 160;

/// Draws a button for each robot and log; the chosen one comes to the front.
pub(super) fn tabs(ui: &mut Ui, names: impl Iterator<Item = (String, Option<Mode>)>, shown: &mut usize) {
    ui.add_space(4.0);
    ui.horizontal_wrapped(|ui| {
        for (index, (name, mode)) in names.enumerate() {
            let (dot, _) = ui.allocate_exact_size(vec2(12.0, 12.0), egui::Sense::hover());
            ui.painter().circle_filled(dot.center(), 6.0, theme::mode(mode));
            if ui.selectable_label(*shown == index, RichText::new(name).size(15.0)).clicked() {
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
    let banner = (ui.available_width() - STOP - if narrow { 0.0 } else { BUTTONS }).clamp(BANNER.0, BANNER.1);
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
    let line = vec2(ui.available_width(), 24.0);
    ui.allocate_ui_with_layout(line, Layout::right_to_left(Align::TOP), |ui| {
        for theme in [Theme::Dark, Theme::Light] {
            let chosen = ui.theme() == theme;
            if ui.selectable_label(chosen, if theme == Theme::Dark { "Dark" } else { "Light" }).clicked() {
                ui.set_theme(theme);
            }
        }
        ui.with_layout(Layout::top_down(Align::Min), |ui| {
            let (colour, text) = reason(model, address, now_s);
            let colour = colour.unwrap_or_else(|| ui.visuals().text_color());
            // A list of causes is longer than the name of a robot.
            let size = if text.len() > LONG { 14.0 } else { 18.0 };
            ui.add(Label::new(RichText::new(text).size(size).color(colour)).wrap());
        });
    });
    ui.add_space(2.0);
}

/// A button for each request that makes sense for the parts that the robot has.
fn buttons(ui: &mut Ui, model: &Model, now_s: f64, pressed: &mut PageRequests) {
    let mut button = |ui: &mut Ui, request: Request, selected: bool| {
        let widget = Button::selectable(selected, RichText::new(label(request)).size(15.0))
            .frame_when_inactive(true)
            .min_size(vec2(66.0, 46.0));
        let response = ui.add_enabled(model.allows(request, now_s), widget);
        let hint = explanation(request);
        if response.on_hover_text(hint).on_disabled_hover_text(hint).clicked() {
            pressed.requests.push(request);
        }
    };
    button(ui, Request::Tare, false);
    if !has_robot(&model.robot) {
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
    Frame::new().fill(theme::mode(mode)).corner_radius(4).inner_margin(Margin::symmetric(12, 2)).show(
        ui,
        |ui| {
            ui.allocate_ui_with_layout(
                vec2(width - 24.0, 46.0),
                Layout::centered_and_justified(egui::Direction::LeftToRight),
                |ui| {
                    ui.label(RichText::new(name).size(38.0 * width / BANNER.1).strong().color(Color32::WHITE))
                },
            );
        },
    );
}

/// Stops every robot that is connected, whatever is in front.
fn stop(ui: &mut Ui, enabled: bool, pressed: &mut PageRequests) {
    let text = RichText::new(label(Request::Stop)).size(20.0).strong().color(Color32::WHITE);
    let button = Button::new(text).fill(theme::BAD).min_size(vec2(160.0, 50.0));
    if ui.add_enabled(enabled, button).on_hover_text(explanation(Request::Stop)).clicked() {
        pressed.requests.push(Request::Stop);
    }
}

/// What is wrong and what to do, or which robot this is.
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
        let fault = sample.fault.map_or_else(String::new, |fault| format!(": {fault}"));
        let text = format!("A recorded run of {name}, then in mode {}{fault}", sample.mode.name());
        return (Some(theme::WARNING), text);
    }
    if let Some(fault) = sample.fault {
        let board = sample.fault_board.and_then(|board| board_name(&model.robot, board));
        let board = board.map_or_else(String::new, |board| format!(" {board}."));
        return (Some(theme::BAD), format!("{fault}{board}"));
    }
    if !matches!(sample.board, Diagnosis::Frames | Diagnosis::NoBoard) {
        return (Some(theme::WARNING), board_text(sample.board, text_parameter(&model.robot, "board.port")));
    }
    let kind = if model.robot.simulated { ", simulated" } else { "" };
    let command = match model.status.commander {
        Commander::Nobody => "",
        Commander::You => " · you have the command",
        Commander::Another => " · another dashboard has the command",
    };
    let arm = model.robot.arm_name.as_str();
    let what = match (has_robot(&model.robot), has_arm(&model.robot)) {
        (false, _) => "cover alone",
        (true, false) => "base alone",
        (true, true) => arm,
    };
    let cover = if model.robot.uncalibrated.is_empty() { "" } else { " · cover uncalibrated" };
    (None, format!("{} ({what}{kind}){command}{cover}{}", model.robot.name, masked(sample)))
}

/// The taxels that are out of use, by number.
fn masked(sample: &Sample) -> String {
    let taxels = sample.taxels.iter().enumerate().filter(|(_, taxel)| taxel.status == TaxelStatus::Masked);
    let names: Vec<String> = taxels.map(|(index, _)| taxel_name(index)).collect();
    if names.is_empty() { String::new() } else { format!(" · masked: {}", names.join(", ")) }
}
