//! The bar under a recorded run: play, look at all of it, jump from event to event.

use super::{requests::PageRequests, theme, view::View};
use crate::logic::{
    format::number,
    source::playback::{Landmark, Playback},
};
use egui::{Button, Pos2, Rangef, Rect, Response, Role, Sense, Stroke, Ui, WidgetInfo, vec2};
use moca_msgs::{Mode, seconds};
use moca_telemetry::log::overview::{Happening, Overview};
use std::ops::Range;

/// Height of the strip, points, and of the marks at its lower edge.
const STRIP: f32 = 44.0;
const MARKS: f32 = 8.0;
/// Shortest stretch that the strip shows, s: the plots show what is shorter.
const SHORTEST_S: f64 = 60.0;
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
        ui.monospace(format!("{} of {} s", number(playback.at_s(), 1), number(playback.range_s().1, 1)));
        pressed.close_log = closable && ui.button("Close log").clicked();
        ui.add(egui::Label::new(egui::RichText::new(playback.title()).weak()).truncate());
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

/// Draws the log at a glance, the largest force of each stretch and a mark for all that happened; gives the instant that was
/// clicked.
fn strip(ui: &mut Ui, playback: &Playback, shown_s: &mut Option<Range<f64>>) -> Option<f64> {
    let (rect, response) = ui.allocate_exact_size(vec2(ui.available_width(), STRIP), Sense::click_and_drag());
    let (first, last) = playback.range_s();
    let whole = first..last.max(first + 1e-3);
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
    Some(strip.time_s(at.x).clamp(first, last))
}

/// What a strip shows, and where.
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

    /// What it shows after what the mouse did: the wheel zooms about it, a double click shows all.
    fn zoomed(&self, ui: &Ui, response: &Response, whole: &Range<f64>) -> Option<Range<f64>> {
        let length_s = self.shown.end - self.shown.start;
        let all_s = whole.end - whole.start;
        if response.double_clicked() {
            return None;
        }
        let mut shown = self.shown.clone();
        if let Some(at) = response.hover_pos() {
            let (scroll, pinch) = ui.input(|i| (i.smooth_scroll_delta.y, i.zoom_delta()));
            let factor = (-f64::from(scroll) * WHEEL).exp() / f64::from(pinch);
            let wanted_s = (length_s * factor).clamp(SHORTEST_S.min(all_s), all_s);
            let about_s = self.time_s(at.x);
            let start = about_s - (about_s - shown.start) * wanted_s / length_s;
            let start = start.clamp(whole.start, whole.end - wanted_s);
            shown = start..start + wanted_s;
        }
        (shown.end - shown.start < 0.999 * all_s).then_some(shown)
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
