//! The gripper: its state, and requests to its fingers. Without a gripper there is no such page.

use super::jog;
use crate::logic::{
    gripper::{Draft, object, width},
    model::{Freshness, Model},
    requests::{explanation, label},
};
use crate::ui::{field, requests::PageRequests, row, theme, view::View};
use egui::{Button, Grid, RichText, ScrollArea, Ui, vec2};
use moca_msgs::{GripperRequest, GripperState, Request};

/// Size of a button, points.
const BUTTON: [f32; 2] = [86.0, 40.0];
/// Draws the page and notes what was pressed.
pub(super) fn show(ui: &mut Ui, model: &Model, view: &mut View, now_s: f64, pressed: &mut PageRequests) {
    let Some(gripper) = model.gripper() else {
        ui.weak("This robot has no gripper: set plant.gripper, restart the daemon.");
        return;
    };
    ScrollArea::vertical().auto_shrink([false, false]).show(ui, |ui| {
        let live = model.freshness(now_s) == Freshness::Live;
        ui.strong(if live { "Gripper" } else { "Gripper, as last known" });
        ui.add_enabled_ui(live, |ui| state(ui, gripper));
        if !model.recorded {
            requests(ui, model, gripper, &mut view.gripper, now_s, pressed);
            ui.separator();
            // The flange is led to what is grasped.
            jog::show(ui, model, view, now_s, pressed);
        }
    });
}

/// Draws the buttons and the numbers of the next motion.
fn requests(
    ui: &mut Ui,
    model: &Model,
    gripper: &GripperState,
    draft: &mut Draft,
    now_s: f64,
    pressed: &mut PageRequests,
) {
    let mut button = |ui: &mut Ui, request: GripperRequest| {
        let refused = request.check(&gripper.table()).err();
        let asked = Request::Gripper(request);
        let widget = Button::new(label(asked)).min_size(BUTTON.into());
        let response = ui.add_enabled(refused.is_none() && model.allows(asked, now_s), widget);
        let hint = explanation(asked);
        let why_not = refused.map_or_else(|| hint.to_owned(), |refused| format!("{hint}\n{refused}"));
        if response.on_hover_text(hint).on_disabled_hover_text(why_not).clicked() {
            pressed.requests.push(asked);
        }
    };
    ui.horizontal_wrapped(|ui| {
        [GripperRequest::Home, GripperRequest::Release, GripperRequest::Stop]
            .into_iter()
            .for_each(|request| button(ui, request));
    });
    Grid::new("gripper numbers").num_columns(3).spacing([10.0, 4.0]).show(ui, |ui| {
        for entry in draft.fields(&gripper.table()) {
            let [min, max] = entry.range;
            let said = format!("Gripper {}", entry.name.to_lowercase());
            ui.label(entry.name);
            field::number(ui, entry.value, entry.range, &said);
            let allowed = RichText::new(format!("{min} to {max} {}", entry.unit));
            let outside = !(min..=max).contains(entry.value);
            ui.label(if outside { allowed.color(theme::BAD).strong() } else { allowed.weak() });
            ui.end_row();
        }
    });
    ui.horizontal_wrapped(|ui| {
        [draft.motion(), draft.grasp()].into_iter().for_each(|request| button(ui, request));
    });
}

/// Shows the state, and the fault with its remedy in a place of fixed size: no button moves when it comes.
fn state(ui: &mut Ui, gripper: &GripperState) {
    let rows =
        [("Phase", gripper.phase.name().to_owned()), ("Width", width(gripper)), ("Object", object(gripper))];
    Grid::new("gripper").num_columns(2).spacing([10.0, 2.0]).show(ui, |ui| {
        for (name, value) in rows {
            ui.weak(name);
            ui.label(RichText::new(value).size(16.0).strong());
            ui.end_row();
        }
    });
    let (_, place) = ui.allocate_space(vec2(ui.available_width(), row::PLACE));
    if let Some(fault) = gripper.fault {
        row::in_place(ui, place, &fault.to_string(), theme::BAD);
    }
}
