//! Fields for numbers.

use super::theme;
use egui::{DragValue, Response, Stroke, Ui};

/// Draws a field that takes any number and is red while it is outside `range`: what was typed is never made another number.
/// `said` is its accessible name.
pub(super) fn number(ui: &mut Ui, value: &mut f64, [min, max]: [f64; 2], said: &str) -> Response {
    let draw = |ui: &mut Ui| {
        if !(min..=max).contains(value) {
            let visuals = ui.visuals_mut();
            visuals.override_text_color = Some(theme::BAD);
            for widget in
                [&mut visuals.widgets.inactive, &mut visuals.widgets.hovered, &mut visuals.widgets.active]
            {
                widget.bg_stroke = Stroke::new(1.5, theme::BAD);
            }
        }
        // A stroke over the screen changes a value by a part of itself, whatever its size.
        let speed = (value.abs() * 0.005).max((max - min) * 1e-6).max(1e-3);
        let shown = ui.add(DragValue::new(value).speed(speed).max_decimals(4));
        ui.ctx().accesskit_node_builder(shown.id, |node| node.set_label(said));
        shown
    };
    ui.scope(draw).inner
}
