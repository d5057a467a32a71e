//! Mode and why, and the buttons.

use super::theme;
use crate::logic::{Action, Model, model::Freshness};
use egui::{Align, Button, Color32, Frame, Layout, Margin, RichText, Theme, Ui, vec2};
use moca_msgs::{Law, Mode, board::Diagnosis};
use moca_telemetry::net::Commander;

/// Which robot or log is in front.
pub(super) fn robots(ui: &mut Ui, names: impl Iterator<Item = (String, Option<Mode>)>, shown: &mut usize) {
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
pub(super) fn show(ui: &mut Ui, model: &Model, address: &str, now_s: f64, asked: &mut Vec<Action>) {
    ui.add_space(4.0);
    ui.horizontal(|ui| {
        mode(ui, model, now_s);
        ui.add_space(4.0);
        let mut button = |ui: &mut Ui, action: Action, selected: bool| {
            let widget = Button::selectable(selected, RichText::new(action.label()).size(15.0))
                .frame_when_inactive(true)
                .min_size(vec2(66.0, 46.0));
            let response = ui.add_enabled(model.allows(action, now_s), widget);
            if response
                .on_hover_text(action.explanation())
                .on_disabled_hover_text(action.explanation())
                .clicked()
            {
                asked.push(action);
            }
        };
        button(ui, Action::Tare, false);
        button(ui, Action::Arm, false);
        button(ui, Action::Disarm, false);
        button(ui, Action::Resume, false);
        ui.separator();
        for law in [Law::Impedance, Law::FollowMe] {
            button(ui, Action::Select(law), model.law == law);
        }
        ui.with_layout(Layout::right_to_left(Align::Center), |ui| stop(ui, model, now_s, asked));
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

/// The mode, readable from three metres.
fn mode(ui: &mut Ui, model: &Model, now_s: f64) {
    let mode = model.mode(now_s);
    let name = match model.freshness(now_s) {
        Freshness::Live => mode.map_or("–", moca_msgs::Mode::name),
        Freshness::Silent => "no samples",
        Freshness::Down(_) if model.recorded => "log",
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

fn stop(ui: &mut Ui, model: &Model, now_s: f64, asked: &mut Vec<Action>) {
    let label = RichText::new(Action::Stop.label()).size(20.0).strong().color(Color32::WHITE);
    let enabled = model.allows(Action::Stop, now_s);
    let button = Button::new(label).fill(theme::BAD).min_size(vec2(160.0, 50.0));
    if ui.add_enabled(enabled, button).on_hover_text(Action::Stop.explanation()).clicked() {
        asked.push(Action::Stop);
    }
}

/// One line in plain words: what is wrong and what to do, or that all is well.
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
    if let Some(fault) = sample.fault {
        return (Some(theme::BAD), format!("{} {}", fault.text(), fault.remedy()));
    }
    if !matches!(sample.board, Diagnosis::Frames | Diagnosis::NoBoard) {
        return (Some(theme::WARNING), sample.board.text().into());
    }
    if model.recorded {
        let text = format!("A recorded run of {}: nothing here can be commanded.", model.robot.name);
        return (Some(theme::WARNING), text);
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
