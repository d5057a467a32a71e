//! Mode and why, and the buttons.

use super::{requests::PageRequests, theme};
use crate::logic::{
    model::{Freshness, Model},
    requests::{explanation, label},
};
use egui::{Align, Button, Color32, Frame, Layout, Margin, RichText, Theme, Ui, vec2};
use moca_msgs::{Law, Mode, Request, board::Diagnosis};
use moca_telemetry::net::Commander;

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
    ui.horizontal(|ui| {
        mode(ui, model, now_s);
        ui.add_space(4.0);
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
        for request in [Request::Tare, Request::Arm, Request::Disarm, Request::Resume] {
            button(ui, request, false);
        }
        ui.separator();
        for law in [Law::Impedance, Law::FollowMe] {
            button(ui, Request::SelectLaw(law), model.law == law);
        }
        ui.with_layout(Layout::right_to_left(Align::Center), |ui| stop(ui, anybody_to_stop, pressed));
    });
    ui.horizontal(|ui| {
        why(ui, model, address, now_s);
        ui.with_layout(Layout::right_to_left(Align::Center), |ui| {
            for theme in [Theme::Dark, Theme::Light] {
                let chosen = ui.theme() == theme;
                if ui.selectable_label(chosen, if theme == Theme::Dark { "Dark" } else { "Light" }).clicked()
                {
                    ui.set_theme(theme);
                }
            }
            if let Some((text, done)) = model.message(now_s) {
                let colour = if done { ui.visuals().weak_text_color() } else { theme::BAD };
                ui.add(egui::Label::new(RichText::new(text).color(colour)).truncate());
            }
        });
    });
    ui.add_space(2.0);
}

/// The mode of a robot that runs, readable from three metres.
fn mode(ui: &mut Ui, model: &Model, now_s: f64) {
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
                vec2(286.0, 46.0),
                Layout::centered_and_justified(egui::Direction::LeftToRight),
                |ui| ui.label(RichText::new(name).size(38.0).strong().color(Color32::WHITE)),
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

/// One line: what is wrong and what to do, or which robot this is.
fn why(ui: &mut Ui, model: &Model, address: &str, now_s: f64) {
    let (colour, text) = reason(model, address, now_s);
    let colour = colour.unwrap_or_else(|| ui.visuals().text_color());
    ui.label(RichText::new(text).size(18.0).color(colour));
}

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
        let fault = sample.fault.map_or(String::new(), |fault| format!(": {}", fault.text()));
        let text = format!("A recorded run of {name}, then in mode {}{fault}", sample.mode.name());
        return (Some(theme::WARNING), text);
    }
    if let Some(fault) = sample.fault {
        return (Some(theme::BAD), format!("{} {}", fault.text(), fault.remedy()));
    }
    if !matches!(sample.board, Diagnosis::Frames | Diagnosis::NoBoard) {
        return (Some(theme::WARNING), sample.board.text().into());
    }
    let kind = if model.robot.simulated { ", simulated" } else { "" };
    let command = match model.status.commander {
        Commander::Nobody => "",
        Commander::You => " · you have the command",
        Commander::Another => " · another dashboard has the command",
    };
    let cover = if model.robot.uncalibrated.is_empty() { "" } else { " · cover uncalibrated" };
    (None, format!("{} ({}{kind}){command}{cover}", model.robot.name, model.robot.arm.name))
}
