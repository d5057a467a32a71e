//! Parameters with unit, range and default: those of the controllers can be changed while the loop runs.

use crate::logic::{
    answers::Answer,
    model::Model,
    tuning::{element_name, is_changed},
};
use crate::ui::{field, requests::PageRequests, theme, view::View};
use egui::{Align, Button, Checkbox, CollapsingHeader, Grid, Label, Layout, RichText, ScrollArea, Ui, vec2};
use moca_msgs::{ParameterValues, Request};
use moca_telemetry::{ParameterDescription, ParameterForm, ParameterValue};

/// Width of one element's field, points.
const FIELD: f32 = 62.0;
/// Height of a row, points.
const ROW: f32 = 26.0;
/// Width of a letter of an element's name, points.
const LETTER: f32 = 6.5;

/// Draws the page and notes what was pressed.
pub(super) fn show(ui: &mut Ui, model: &Model, view: &mut View, pressed: &mut PageRequests) {
    let parameters = &model.robot.parameters;
    if parameters.is_empty() {
        ui.weak("No parameters are known: no daemon, or a log from before they were recorded.");
        return;
    }
    toolbar(ui, model, view, pressed);
    let text = "Drag a number or type it, then apply it: the loop takes it at its next tick. A restart brings back the \
                file: save what you have tuned. Orange is not the default.";
    ui.add(Label::new(RichText::new(text).weak()).wrap());
    ScrollArea::vertical().auto_shrink([false, false]).show(ui, |ui| {
        let listed = || parameters.iter().enumerate();
        for (number, parameter) in listed().filter(|(_, p)| p.live) {
            row(ui, number, parameter, model.may_command(), view, pressed);
            ui.separator();
        }
        CollapsingHeader::new("Read at the start only").show(ui, |ui| {
            ui.weak("They are changed in the configuration file.");
            Grid::new("other parameters").striped(true).num_columns(3).spacing([12.0, 3.0]).show(ui, |ui| {
                for (_, parameter) in listed().filter(|(_, p)| !p.live) {
                    ui.label(named(&parameter.name, parameter)).on_hover_text(hint(parameter));
                    let value = parameter.shown(&parameter.value);
                    ui.add(Label::new(RichText::new(value).monospace()).truncate());
                    ui.weak(units(parameter));
                    ui.end_row();
                }
            });
        });
    });
}

/// Shows the actions on all of them.
fn toolbar(ui: &mut Ui, model: &Model, view: &mut View, pressed: &mut PageRequests) {
    let parameters = &model.robot.parameters;
    ui.horizontal_wrapped(|ui| {
        let save = "Save every value that differs from its default as a TOML file for `mocad --config`";
        pressed.save_parameters |= ui.button("Save as TOML").on_hover_text(save).clicked();
        let reset: Vec<_> = parameters.iter().enumerate().filter(|(_, p)| p.live && is_changed(p)).collect();
        let label = format!("Defaults for all ({})", reset.len());
        let button = Button::new(label).min_size(vec2(150.0, 0.0));
        let button = ui.add_enabled(model.may_command() && !reset.is_empty(), button);
        if button.on_hover_text("Puts the defaults into the fields; apply them to use them").clicked() {
            for (number, parameter) in reset {
                if let ParameterValue::Numbers(default) = &parameter.default {
                    view.drafts.insert(number, default.clone());
                }
            }
        }
        let label = format!("Apply all ({})", view.drafts.len());
        let button = Button::new(label).min_size(vec2(110.0, 0.0));
        if ui.add_enabled(model.may_command() && !view.drafts.is_empty(), button).clicked() {
            for (number, draft) in std::mem::take(&mut view.drafts) {
                let Some(parameter) = parameters.get(number) else { continue };
                match parameter.checked(&draft) {
                    Ok(values) => apply(number, values, pressed),
                    Err(error) => {
                        pressed.answers.push(Answer::bad(error));
                        view.drafts.insert(number, draft);
                    }
                }
            }
        }
    });
}

fn apply(number: usize, values: ParameterValues, pressed: &mut PageRequests) {
    match u8::try_from(number) {
        Ok(parameter) => pressed.requests.push(Request::SetParameter { parameter, values }),
        Err(error) => pressed.answers.push(Answer::bad(error.to_string())),
    }
}

fn row(
    ui: &mut Ui,
    number: usize,
    parameter: &ParameterDescription,
    may_change: bool,
    view: &mut View,
    pressed: &mut PageRequests,
) {
    let ParameterValue::Numbers(present) = &parameter.value else { return };
    let short = parameter.name.rsplit('.').next().unwrap_or_default();
    let mut draft = view.drafts.remove(&number).unwrap_or_else(|| present.clone());
    ui.horizontal_wrapped(|ui| {
        ui.spacing_mut().interact_size.y = ROW;
        ui.label(named(short, parameter).strong()).on_hover_text(hint(parameter));
        fields(ui, parameter, short, may_change, &mut draft);
        let (differs, checked) = (draft != *present, parameter.checked(&draft));
        let button = Button::new(format!("Apply {short}"));
        let clicked = ui.add_enabled(differs && checked.is_ok() && may_change, button).clicked();
        if ui.add_enabled(differs, Button::new("Undo")).clicked() {
            draft.clone_from(present);
        }
        if let ParameterValue::Numbers(default) = &parameter.default
            && *default != draft
            && ui.add_enabled(may_change, Button::new(format!("Default {short}"))).clicked()
        {
            draft.clone_from(default);
        }
        if let (true, Ok(values)) = (clicked, checked) {
            apply(number, values, pressed);
            draft.clone_from(present);
        }
    });
    if let Err(error) = parameter.checked(&draft) {
        ui.add(Label::new(RichText::new(error).color(theme::BAD)).wrap());
    }
    let text = format!("{}{}", range(parameter), parameter.description);
    ui.add(Label::new(RichText::new(text).weak().size(11.5)).wrap()).on_hover_text(hint(parameter));
    if draft != *present {
        view.drafts.insert(number, draft);
    }
}

/// A name that shows whether the value is the default.
fn named(name: &str, parameter: &ParameterDescription) -> RichText {
    let text = RichText::new(name);
    if is_changed(parameter) { text.color(theme::WARNING) } else { text }
}

fn hint(parameter: &ParameterDescription) -> String {
    let ParameterDescription { name, description, default, .. } = parameter;
    format!("{name}, default {}\n{description}", parameter.shown(default))
}

fn fields(ui: &mut Ui, parameter: &ParameterDescription, short: &str, may_change: bool, draft: &mut [f64]) {
    for (element, value) in draft.iter_mut().enumerate() {
        let name = element_name(parameter, element);
        let said = format!("{short} {}", if name.is_empty() { "value" } else { &name });
        // Name and field stay together where the row is wrapped, which asks for their size first.
        #[expect(clippy::cast_precision_loss, reason = "a handful of letters")]
        let size = vec2(FIELD + 8.0 + LETTER * name.len() as f32, ROW);
        ui.allocate_ui_with_layout(size, Layout::left_to_right(Align::Center), |ui| {
            if !may_change {
                ui.disable();
            }
            ui.spacing_mut().interact_size.x = FIELD;
            ui.spacing_mut().item_spacing.x = 4.0;
            if !name.is_empty() {
                ui.weak(&name);
            }
            if parameter.form == ParameterForm::Flag {
                let mut on = *value > 0.5;
                let shown = ui.add(Checkbox::without_text(&mut on));
                shown.widget_info(|| egui::WidgetInfo::selected(egui::Role::CheckBox, true, on, &said));
                *value = f64::from(u8::from(on));
            } else {
                let (min, max) = (parameter.min, parameter.max);
                let hint = format!("{said}: {min} to {max} {}", parameter.unit(element));
                field::number(ui, value, [min, max], &said).on_hover_text(hint);
            }
        });
    }
}

fn range(parameter: &ParameterDescription) -> String {
    match parameter.form {
        ParameterForm::Flag => String::new(),
        _ => format!("{} to {} {} · ", parameter.min, parameter.max, units(parameter)),
    }
}

fn units(parameter: &ParameterDescription) -> String {
    let mut units = parameter.units.clone();
    units.dedup();
    units.join(", ")
}
