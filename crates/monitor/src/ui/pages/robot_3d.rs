//! The robot in three dimensions: drag turns it, the wheel zooms, a plate of a simulated robot can be pressed.

use crate::logic::{
    camera::OrbitCamera,
    format::{number, taxel_name},
    model::{Freshness, Model},
};
use crate::ui::{requests::PageRequests, robot, view::View};
use egui::{CursorIcon, Painter, Pos2, Response, Sense, Ui, vec2};

/// Turn of the camera for each point of dragging, rad.
const TURN: f64 = 0.008;
/// Zoom of the mouse wheel for each point of scrolling.
const WHEEL: f64 = 0.003;
/// Strength of the veil over what is old.
const VEIL: f32 = 0.6;

/// Draws the page.
pub(super) fn show(ui: &mut Ui, model: &Model, view: &mut View, now_s: f64, pressed: &mut PageRequests) {
    ui.horizontal_wrapped(|ui| {
        ui.label("From");
        let places =
            [("Corner", OrbitCamera::default()), ("Top", OrbitCamera::TOP), ("Side", OrbitCamera::SIDE)];
        for (name, camera) in places {
            if ui.selectable_label(view.camera == camera, name).clicked() {
                view.camera = camera;
            }
        }
        ui.separator();
        robot::legend(ui, model, true);
    });
    let (response, painter) =
        ui.allocate_painter(ui.available_size().max(vec2(100.0, 100.0)), Sense::click_and_drag());
    response.widget_info(|| egui::WidgetInfo::labeled(egui::Role::Figure, true, "The robot in 3-D"));
    press(ui, &response, &painter, model, view, pressed);
    if response.dragged() && view.held_plate.is_none() {
        let drag = response.drag_delta();
        view.camera.orbit(-f64::from(drag.x) * TURN, f64::from(drag.y) * TURN);
    }
    if response.hovered() {
        let (scroll, pinch) = ui.input(|i| (i.smooth_scroll_delta.y, i.zoom_delta()));
        view.camera.zoom((-f64::from(scroll) * WHEEL).exp() / f64::from(pinch));
    }
    if response.double_clicked() {
        view.camera = OrbitCamera::default();
    }
    // No background of its own: filling it costs a software rasteriser more than the robot does.
    let Some(sample) = &model.latest else { return };
    robot::view_3d(&painter, ui.visuals(), model, sample, view.camera);
    if model.freshness(now_s) != Freshness::Live {
        // A veil over the whole: bodies that let light through would show their hidden edges.
        painter.rect_filled(painter.clip_rect(), 0.0, ui.visuals().panel_fill.gamma_multiply(VEIL));
    }
}

/// Notes which plate the mouse holds pressed, if this robot can be pressed.
fn press(
    ui: &Ui,
    response: &Response,
    painter: &Painter,
    model: &Model,
    view: &mut View,
    pressed: &mut PageRequests,
) {
    let Some(sample) = model.latest.as_ref().filter(|_| model.can_push()) else {
        view.held_plate = None;
        return;
    };
    let under = |place: Pos2| {
        let taxel = robot::plate_at(painter, ui.visuals(), model, sample, view.camera, place)?;
        u8::try_from(taxel).ok()
    };
    let pointed = response.hover_pos().and_then(under);
    if !response.is_pointer_button_down_on() {
        view.held_plate = None;
        if let Some(taxel) = pointed {
            let text =
                format!("Press and hold to push {} with {} N", taxel_name(taxel), number(view.push_n, 0));
            response.clone().on_hover_text_at_pointer(text).on_hover_cursor(CursorIcon::PointingHand);
        }
    } else if ui.input(|i| i.pointer.primary_pressed()) {
        view.held_plate = response.interact_pointer_pos().and_then(under);
    }
    pressed.push = view.held_plate.map(|taxel| (taxel, view.push_n)).or(pressed.push);
}
