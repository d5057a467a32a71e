//! The bar under a recorded run: play, scrub, jump from event to event.

use super::{requests::PageRequests, view::View};
use crate::logic::{
    format::number,
    source::playback::{Landmark, Playback},
};
use egui::{Button, Slider, Ui};

/// Draws the bar and notes whether the log is to be closed.
pub(super) fn show(
    ui: &mut Ui,
    playback: &mut Playback,
    view: &mut View,
    closable: bool,
    pressed: &mut PageRequests,
) {
    let mut sought = None;
    ui.horizontal_wrapped(|ui| {
        let playing = playback.playing();
        if ui.button(if playing { "Pause" } else { "Play" }).clicked() {
            playback.play(!playing);
        }
        let jumps = [
            ("Last touch", Landmark::Touch, false),
            ("Next touch", Landmark::Touch, true),
            ("Last event", Landmark::Event, false),
            ("Next event", Landmark::Event, true),
        ];
        for (label, what, forwards) in jumps {
            let event = playback.find(what, forwards);
            if ui.add_enabled(event.is_some(), Button::new(label)).clicked()
                && let Some(at_s) = event
            {
                // A little later, so that the event is in the picture and not on its edge.
                sought = Some(at_s + 0.2);
                playback.play(false);
            }
        }
        let (first, last) = playback.range_s();
        let mut at_s = playback.at_s();
        // Room for the label before it and the time behind it.
        ui.spacing_mut().slider_width = (ui.available_width() - 220.0).max(120.0);
        let slider = Slider::new(&mut at_s, first..=last.max(first + 1e-3)).show_value(false);
        let label = ui.label("Time");
        if ui.add(slider).labelled_by(label.id).on_hover_text("Time of the log").changed() {
            sought = Some(at_s);
        }
        ui.monospace(format!("{} of {} s", number(playback.at_s(), 1), number(last, 1)));
        pressed.close_log = closable && ui.button("Close log").clicked();
        ui.add(egui::Label::new(egui::RichText::new(playback.title()).weak()).truncate());
    });
    if let Some(at_s) = sought {
        playback.seek(at_s);
        // A held axis would go on showing where the log was before.
        view.axis.follow();
    }
}
