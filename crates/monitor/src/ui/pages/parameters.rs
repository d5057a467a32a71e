//! Parameters with unit, range and default: those of the controllers can be changed while the loop runs.

use crate::logic::model::Model;
use crate::ui::{requests::PageRequests, theme, view::View};
use egui::{Button, Checkbox, CollapsingHeader, DragValue, Grid, Label, RichText, ScrollArea, Ui};
use moca_msgs::Request;
use moca_telemetry::{ParameterDescription, ParameterForm, ParameterValue};

/// Width of one element's field, points.
const FIELD: f32 = 62.0;

/// Draws the page and notes what was pressed.
pub(super) fn show(ui: &mut Ui, model: &Model, view: &mut View, pressed: &mut PageRequests) {
    if model.robot.parameters.is_empty() {
        ui.weak("No parameters are known: no daemon, or a log from before they were recorded.");
        return;
    }
    let may_change = model.may_command();
    ui.weak("Drag a number or type it, then apply it: the loop takes it at its next tick. A restart brings back the file.");
    ScrollArea::vertical().auto_shrink([false, false]).show(ui, |ui| {
        let listed = || model.robot.parameters.iter().enumerate();
        Grid::new("live parameters").striped(true).num_columns(3).spacing([12.0, 4.0]).show(ui, |ui| {
            for (number, parameter) in listed().filter(|(_, p)| p.live) {
                row(ui, number, parameter, may_change, view, pressed);
            }
        });
        CollapsingHeader::new("Read at the start only: change the configuration file").show(ui, |ui| {
            Grid::new("other parameters").striped(true).num_columns(3).spacing([12.0, 3.0]).show(ui, |ui| {
                for (_, parameter) in listed().filter(|(_, p)| !p.live) {
                    ui.label(&parameter.name).on_hover_text(&parameter.description);
                    let value = parameter.shown(&parameter.value);
                    ui.add(Label::new(RichText::new(value).monospace()).truncate());
                    ui.weak(units(parameter));
                    ui.end_row();
                }
            });
        });
    });
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
    let changed = parameter.value != parameter.default;
    let name = RichText::new(short).strong();
    ui.label(if changed { name.color(theme::WARNING) } else { name }).on_hover_text(&parameter.name);
    let mut draft = view.drafts.get(&number).cloned().unwrap_or_else(|| present.clone());
    ui.add_enabled_ui(may_change, |ui| fields(ui, parameter, short, &mut draft));
    let differs = draft != *present;
    ui.horizontal(|ui| {
        if ui.add_enabled(differs && may_change, Button::new(format!("Apply {short}"))).clicked() {
            match (parameter.checked(&draft), u8::try_from(number)) {
                (Ok(values), Ok(parameter)) => {
                    pressed.requests.push(Request::SetParameter { parameter, values });
                    view.drafts.remove(&number);
                }
                (Err(error), _) => view.note = Some(error),
                (_, Err(error)) => view.note = Some(error.to_string()),
            }
        } else if ui.add_enabled(differs, Button::new("Undo")).clicked() || !differs {
            view.drafts.remove(&number);
        } else {
            view.drafts.insert(number, draft);
        }
    });
    ui.end_row();
    ui.label("");
    let text = format!("{}{}", range(parameter), parameter.description);
    let hint = format!("{}, default {}", parameter.name, parameter.shown(&parameter.default));
    ui.add(Label::new(RichText::new(text).weak().size(11.5)).extend()).on_hover_text(hint);
    ui.end_row();
}

fn fields(ui: &mut Ui, parameter: &ParameterDescription, short: &str, draft: &mut [f64]) {
    ui.horizontal(|ui| {
        ui.spacing_mut().interact_size.x = FIELD;
        ui.spacing_mut().item_spacing.x = 4.0;
        for (element, value) in draft.iter_mut().enumerate() {
            let said = format!("{short} {}", element + 1);
            if parameter.form == ParameterForm::Flag {
                let mut on = *value > 0.5;
                let shown = ui.add(Checkbox::without_text(&mut on));
                shown.widget_info(|| egui::WidgetInfo::selected(egui::Role::CheckBox, true, on, &said));
                *value = f64::from(u8::from(on));
                continue;
            }
            // A stroke over the screen changes a value by a part of itself, whatever its size.
            let speed = (value.abs() * 0.005).max((parameter.max - parameter.min) * 1e-6).max(1e-3);
            let field =
                DragValue::new(value).range(parameter.min..=parameter.max).speed(speed).max_decimals(4);
            let shown = ui.add(field);
            let number = shown.id;
            ui.ctx().accesskit_node_builder(number, |node| node.set_label(said.as_str()));
            shown.on_hover_text(format!(
                "{said}: {} to {} {}",
                parameter.min,
                parameter.max,
                parameter.unit(element)
            ));
        }
    });
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
