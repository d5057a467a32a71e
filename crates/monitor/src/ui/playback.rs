//! The bar under a recorded run: play, scrub, jump from event to event.

use crate::logic::{playback::Playback, words::number};
use egui::{Button, Slider, Ui};

/// Draws the bar.
pub(super) fn show(ui: &mut Ui, playback: &mut Playback) {
    ui.horizontal(|ui| {
        let playing = playback.playing();
        if ui.button(if playing { "Hold" } else { "Play" }).clicked() {
            playback.play(!playing);
        }
        for (label, forwards) in [("Last event", false), ("Next event", true)] {
            let event = playback.event(forwards);
            if ui.add_enabled(event.is_some(), Button::new(label)).clicked()
                && let Some(at_s) = event
            {
                // A little later, so that the event is in the picture and not on its edge.
                playback.seek(at_s + 0.2);
                playback.play(false);
            }
        }
        let (first, last) = playback.range_s();
        let mut at_s = playback.at_s();
        ui.spacing_mut().slider_width = (ui.available_width() - 420.0).max(120.0);
        let slider = Slider::new(&mut at_s, first..=last.max(first + 1e-3)).show_value(false);
        if ui.add(slider).on_hover_text("Instant of the log").changed() {
            playback.seek(at_s);
        }
        ui.monospace(format!("{} of {} s", number(playback.at_s(), 1), number(last, 1)));
        ui.weak(playback.title());
    });
}
