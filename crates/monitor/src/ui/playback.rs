//! The bar under a recorded run: play, look at all of it, jump from event to event.

use super::{requests::PageRequests, row, theme, view::View};
use crate::logic::{
    format::number,
    limited::Limited,
    source::playback::{Landmark, Playback, SPEEDS},
    time_window,
};
use egui::{Button, ComboBox, Pos2, Rangef, Rect, Response, Role, Sense, Stroke, Ui, WidgetInfo, vec2};
use moca_msgs::{Mode, seconds};
use moca_telemetry::log::overview::{Happening, Overview};
use std::ops::Range;

/// Height of the strip, points, and of the marks at its lower edge.
const STRIP: f32 = 44.0;
const MARKS: f32 = 8.0;
/// Zoom of the mouse wheel for each point of scrolling.
const WHEEL: f64 = 0.005;
/// A mark this near to the mouse is named, points.
const REACH: f32 = 5.0;
/// Force that fills the strip if there is no larger one, N.
const LEAST_N: f32 = 20.0;

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
        let button = Button::new(if playing { "Pause" } else { "Play" }).min_size(vec2(64.0, 0.0));
        if ui.add(button).clicked() {
            playback.play(!playing);
        }
        let jumps = [
            ("Previous touch", Landmark::Touch, false),
            ("Next touch", Landmark::Touch, true),
            ("Previous event", Landmark::Event, false),
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
        speed(ui, playback);
        // As wide at the beginning as at the end: what stands beside it stays.
        let end = number(playback.range_s().1, 1);
        ui.monospace(format!("{:>width$} of {end} s", number(playback.at_s(), 1), width = end.len()));
        pressed.close_log = closable && ui.button("Close log").clicked();
        row::rest(ui, egui::RichText::new(playback.title()).weak());
    });
    if let Some(at_s) = strip(ui, playback, &mut view.strip_s) {
        sought = Some(at_s);
    }
    if let Some(at_s) = sought {
        playback.seek(at_s);
        // A held axis would go on showing where the log was before.
        view.axis.follow();
    }
}

/// Draws the choice of the playback's speed.
fn speed(ui: &mut Ui, playback: &mut Playback) {
    let hint = "Speed of the playback; 1 is as fast as it happened";
    let named = |speed: f64| format!("{speed} ×");
    let mut chosen = playback.speed();
    ComboBox::from_id_salt("speed")
        .width(64.0)
        .selected_text(named(chosen))
        .show_ui(ui, |ui| {
            for speed in SPEEDS {
                ui.selectable_value(&mut chosen, speed, named(speed));
            }
        })
        .response
        .on_hover_text(hint);
    playback.set_speed(chosen);
}

/// Draws the log at a glance, the largest force of each stretch and a mark for all that happened; gives the instant that was
/// clicked.
fn strip(ui: &mut Ui, playback: &Playback, shown_s: &mut Option<Range<f64>>) -> Option<f64> {
    let (rect, response) = ui.allocate_exact_size(vec2(ui.available_width(), STRIP), Sense::click_and_drag());
    let (first, last) = playback.range_s();
    let whole = time_window::whole(first, last);
    let shown = shown_s.clone().filter(|s| s.start < whole.end).unwrap_or_else(|| whole.clone());
    let strip = Strip { rect, shown, overview: playback.overview() };
    strip.draw(ui, playback.at_s());
    let label = "Time of the log";
    response.widget_info(|| WidgetInfo::labeled(Role::Slider, true, label));
    *shown_s = strip.zoomed(ui, &response, &whole);
    let at = response.hover_pos().filter(|_| !response.dragged());
    if let Some(at) = at {
        let told = strip.told(at);
        response.clone().on_hover_ui_at_pointer(|ui| {
            ui.label(told);
        });
    }
    let moved = response.dragged() || response.clicked();
    let at = response.interact_pointer_pos().filter(|_| moved)?;
    Some(strip.time_s(at.x).limited(first, last))
}

/// Range and place of a strip.
struct Strip<'a> {
    rect: Rect,
    shown: Range<f64>,
    overview: &'a Overview,
}

impl Strip<'_> {
    #[expect(clippy::cast_possible_truncation, reason = "a place on the screen")]
    fn x(&self, time_s: f64) -> f32 {
        let part = (time_s - self.shown.start) / (self.shown.end - self.shown.start);
        egui::lerp(self.rect.x_range(), part as f32)
    }

    fn time_s(&self, x: f32) -> f64 {
        let part = f64::from((x - self.rect.left()) / self.rect.width());
        self.shown.start + part * (self.shown.end - self.shown.start)
    }

    fn draw(&self, ui: &Ui, at_s: f64) {
        let painter = ui.painter_at(self.rect);
        let visuals = ui.visuals();
        painter.rect_filled(self.rect, 3.0, visuals.extreme_bg_color);
        let span_s = seconds(self.overview.span_ns);
        let spans = self.overview.spans.iter().map(|span| (seconds(span.start_ns), span.force_n));
        let visible =
            |&(start_s, _): &(f64, f32)| start_s + span_s > self.shown.start && start_s < self.shown.end;
        let most_n = self.overview.spans.iter().map(|span| span.force_n).fold(LEAST_N, f32::max);
        let floor = self.rect.bottom() - MARKS;
        for (start_s, force_n) in spans.filter(visible).filter(|(_, force_n)| *force_n > 0.0) {
            let (left, right) = (self.x(start_s), self.x(start_s + span_s));
            let top = egui::remap(force_n, 0.0..=most_n, floor..=self.rect.top() + 2.0);
            // What is narrower than a point is still seen.
            let bar = Rect::from_x_y_ranges(left..=right.max(left + 1.0), top..=floor);
            painter.rect_filled(bar, 0.0, theme::curve(0));
        }
        for mark in &self.overview.marks {
            let (colour, from) = match mark.what {
                Happening::Touch => (theme::curve(0), floor),
                Happening::LimitCrossed => (theme::WARNING, self.rect.center().y),
                Happening::Mode(Mode::ProtectiveStop | Mode::Fault) | Happening::Fault(_) => {
                    (theme::BAD, self.rect.top())
                }
                Happening::Mode(mode) => (theme::mode(Some(mode)), floor),
            };
            let time_s = seconds(mark.time_ns);
            if self.shown.contains(&time_s) {
                painter.vline(
                    self.x(time_s),
                    Rangef::new(from, self.rect.bottom()),
                    Stroke::new(1.0, colour),
                );
            }
        }
        painter.vline(self.x(at_s), self.rect.y_range(), Stroke::new(2.0, theme::strong(visuals)));
    }

    /// Returns its range after the mouse's gesture: the wheel zooms about the mouse, a double click shows all.
    fn zoomed(&self, ui: &Ui, response: &Response, whole: &Range<f64>) -> Option<Range<f64>> {
        if response.double_clicked() {
            return None;
        }
        let (about_s, factor) = response.hover_pos().map_or((self.shown.start, 1.0), |at| {
            let (scroll, pinch) = ui.input(|i| (i.smooth_scroll_delta.y, i.zoom_delta()));
            (self.time_s(at.x), (-f64::from(scroll) * WHEEL).exp() / f64::from(pinch))
        });
        time_window::zoomed(&self.shown, whole, about_s, factor)
    }

    /// The instant at the mouse, and what happened there.
    fn told(&self, at: Pos2) -> String {
        let near = |time_s: f64| (self.x(time_s) - at.x).abs();
        let marks = self.overview.marks.iter().map(|mark| (near(seconds(mark.time_ns)), mark));
        let nearest = marks.filter(|(far, _)| *far <= REACH).min_by(|a, b| a.0.total_cmp(&b.0));
        let time = format!("{} s", number(self.time_s(at.x), 1));
        match nearest {
            Some((_, mark)) => format!("{time}\n{} s: {}", number(seconds(mark.time_ns), 3), name(mark.what)),
            None => time,
        }
    }
}

/// One line for the user.
fn name(what: Happening) -> String {
    match what {
        Happening::Touch => "touch".into(),
        Happening::LimitCrossed => "a contact crossed a limit".into(),
        Happening::Mode(mode) => mode.name().into(),
        Happening::Fault(fault) => fault.to_string(),
    }
}
