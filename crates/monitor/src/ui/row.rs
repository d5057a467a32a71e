//! Rows whose buttons stay where they are while texts beside them change.

use egui::{Align, Label, Layout, RichText, Ui, vec2};

/// Narrowest text that says anything, points.
const NARROWEST: f32 = 40.0;

/// Writes `text` into what is left of the row, cut off at its end: a row that wraps stays one row.
pub(super) fn rest(ui: &mut Ui, text: impl Into<RichText>) {
    let room = ui.max_rect().right() - ui.cursor().left();
    if room >= NARROWEST {
        let size = vec2(room, ui.spacing().interact_size.y);
        ui.allocate_ui_with_layout(size, Layout::left_to_right(Align::Center), |ui| {
            ui.add(Label::new(text.into()).truncate());
        });
    }
}
