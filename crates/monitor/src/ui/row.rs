//! Rows whose buttons stay where they are while texts beside them change.

use egui::{
    Align, Color32, FontId, Galley, Label, Layout, Rect, RichText, Ui, UiBuilder, text::LayoutJob, vec2,
};
use std::sync::Arc;

/// Narrowest text that says anything, points.
const NARROWEST: f32 = 40.0;
/// Height of a place for a text of any length, points.
pub(super) const PLACE: f32 = 44.0;
/// Rows of such a text at most, and the sizes of its letters, points.
const ROWS: usize = 3;
const SIZES: [f32; 4] = [18.0, 15.0, 13.0, 11.5];

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

/// Writes a text of any length into `place`, smaller if need be; the rest of a longer one is in its hint.
pub(super) fn in_place(ui: &mut Ui, place: Rect, text: &str, colour: Color32) {
    let layout = Layout::top_down(Align::Min);
    let ui = &mut ui.new_child(UiBuilder::new().max_rect(place).layout(layout));
    let room = place.size();
    let laid_out = |size: f32| {
        let mut job = LayoutJob::simple(text.to_owned(), FontId::proportional(size), colour, room.x);
        // A smallest line is 1.25 of its letters high.
        job.wrap.max_rows = ROWS;
        ui.painter().layout_job(job)
    };
    let fits = |galley: &Arc<Galley>| !galley.elided && galley.size().y <= room.y;
    let mut galleys = SIZES.into_iter().map(laid_out);
    let galley = galleys.find(fits);
    let whole = galley.is_some();
    let galley = galley.unwrap_or_else(|| laid_out(SIZES[SIZES.len() - 1]));
    let label = ui.add(Label::new(galley).selectable(false));
    if !whole {
        label.on_hover_text(text);
    }
}
