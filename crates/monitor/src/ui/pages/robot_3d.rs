//! The robot in three dimensions: drag turns it, the wheel zooms.

use crate::logic::{camera::OrbitCamera, model::Freshness, model::Model};
use crate::ui::{robot, view::View};
use egui::{Sense, Ui, vec2};

/// Turn of the camera for each point of dragging, rad.
const TURN: f64 = 0.008;
/// Zoom of the mouse wheel for each point of scrolling.
const WHEEL: f64 = 0.003;

/// Draws the page.
pub(super) fn show(ui: &mut Ui, model: &Model, view: &mut View, now_s: f64) {
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
        robot::legend(ui, model);
    });
    let (response, painter) =
        ui.allocate_painter(ui.available_size().max(vec2(100.0, 100.0)), Sense::click_and_drag());
    response.widget_info(|| egui::WidgetInfo::labeled(egui::Role::Figure, true, "The robot in 3-D"));
    if response.dragged() {
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
    let mut painter = painter;
    if model.freshness(now_s) != Freshness::Live {
        painter.set_opacity(0.4);
    }
    robot::view_3d(&painter, ui.visuals(), model, sample, view.camera);
}
