//! Scrolling plots with one axis of time and one cursor.

use super::{app::View, theme};
use crate::logic::{
    Model, Panel,
    history::Curve,
    panel::{column_name, round_marks, vertical_range},
    words::number,
};
use egui::{Align, Button, Id, Layout, Rect, RichText, Ui, UiBuilder, Vec2, vec2};
use egui_plot::{GridInput, GridMark, Line, Plot, PlotPoints, VLine};
use moca_msgs::Mode;

/// Lengths of the axis of time, s.
const WINDOWS_S: [f64; 4] = [5.0, 10.0, 30.0, 60.0];
/// Room for the right half of the last mark's text, points.
const RIGHT_MARGIN: f32 = 8.0;
/// Height of a plot's heading, points.
const HEADING: f32 = 20.0;

/// Draws every plot.
pub(super) fn show(ui: &mut Ui, model: &Model, view: &mut View) {
    toolbar(ui, model, view);
    let Some(newest_s) = model.history.end_s() else {
        ui.centered_and_justified(|ui| ui.weak("Plots appear here once samples come."));
        return;
    };
    let end_s = view.paused_at_s.unwrap_or(newest_s);
    let spacing = ui.spacing().item_spacing;
    let rows = model.panels.len().div_ceil(2).max(1);
    #[expect(clippy::cast_precision_loss, reason = "a handful of rows")]
    let size = vec2(
        (ui.available_width() - spacing.x) / 2.0 - RIGHT_MARGIN,
        ((ui.available_height() - spacing.y * (rows as f32 - 1.0)) / rows as f32).max(90.0),
    );
    let mut pointed_at_s = None;
    let corner = ui.available_rect_before_wrap().min;
    let pitch = size + spacing + vec2(RIGHT_MARGIN, 0.0);
    for (index, panel) in model.panels.iter().enumerate() {
        #[expect(clippy::cast_precision_loss, reason = "a handful of rows")]
        let cell = vec2((index % 2) as f32, (index / 2) as f32) * pitch;
        let builder = UiBuilder::new().max_rect(Rect::from_min_size(corner + cell, size));
        let plotted = Plotted { panel, end_s, view, model, id: Id::unique(("plot", index)) };
        let shown =
            ui.scope_builder(builder.layout(Layout::top_down(Align::Min)), |ui| plotted.show(ui, size));
        pointed_at_s = shown.inner.or(pointed_at_s);
    }
    view.cursor_s = pointed_at_s;
}

fn toolbar(ui: &mut Ui, model: &Model, view: &mut View) {
    ui.horizontal(|ui| {
        ui.label("Show the last");
        for window_s in WINDOWS_S {
            let chosen = view.window_s.total_cmp(&window_s).is_eq();
            if ui.selectable_label(chosen, format!("{window_s:.0} s")).clicked() {
                view.window_s = window_s;
            }
        }
        ui.separator();
        let mut paused = view.paused_at_s.is_some();
        if ui
            .toggle_value(&mut paused, "Pause plots")
            .on_hover_text("Data is still recorded behind it")
            .changed()
        {
            view.paused_at_s = model.history.end_s().filter(|_| paused);
        }
        if let Some(paused_s) = view.paused_at_s {
            let behind_s = model.history.end_s().map_or(0.0, |end| (end - paused_s).max(0.0));
            ui.colored_label(theme::WARNING, format!("paused, {behind_s:.0} s behind"));
        }
        ui.separator();
        let export = Button::new("Export CSV");
        let hint = "Save every sample of what is shown to a file in the current folder";
        if ui.add_enabled(!model.history.is_empty(), export).on_hover_text(hint).clicked() {
            view.exported = Some(self::export(model, view));
        }
        if let Some(exported) = &view.exported {
            ui.weak(exported);
        }
    });
}

/// Saves what is shown and says where, or why not.
fn export(model: &Model, view: &View) -> String {
    let end_s = view.paused_at_s.or(model.history.end_s()).unwrap_or(0.0);
    let window_s = end_s - view.window_s..end_s;
    let table = model.history.csv(window_s, |signal| column_name(&model.panels, signal));
    let path = format!("{}-{end_s:.3}s.csv", model.robot.name.replace(|c: char| !c.is_alphanumeric(), "-"));
    match std::fs::write(&path, table) {
        Ok(()) => format!("saved {path}"),
        Err(error) => format!("cannot save {path}: {error}"),
    }
}

/// One plot of the page.
struct Plotted<'a> {
    panel: &'a Panel,
    end_s: f64,
    view: &'a View,
    model: &'a Model,
    id: Id,
}

impl Plotted<'_> {
    /// Draws it and returns where the mouse points on the axis of time, s of loop time.
    fn show(&self, ui: &mut Ui, size: Vec2) -> Option<f64> {
        self.heading(ui);
        let window_s = self.end_s - self.view.window_s..self.end_s;
        #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "a width on the screen")]
        let pixels = (size.x * ui.pixels_per_point()).max(1.0) as usize;
        let curves: Vec<Curve> = self
            .panel
            .traces
            .iter()
            .map(|(_, signal)| self.model.history.curve(*signal, window_s.clone(), pixels))
            .collect();
        let extremes = curves.iter().filter_map(|c| c.extremes).reduce(|a, b| (a.0.min(b.0), a.1.max(b.1)));
        let (low, high) = vertical_range(extremes, self.panel.least_span);
        let weak = ui.visuals().weak_text_color();
        let plot = Plot::new("plot")
            .id(self.id)
            .width(size.x)
            .height(size.y - HEADING - ui.spacing().item_spacing.y)
            .allow_zoom(false)
            .allow_drag(false)
            .allow_scroll(false)
            .allow_boxed_zoom(false)
            .allow_double_click_reset(false)
            .show_x(false)
            .show_y(false)
            .y_axis_label(self.panel.unit)
            .y_axis_min_width(50.0)
            .x_grid_spacer(marks)
            .y_grid_spacer(marks)
            .x_axis_formatter(|mark, range| {
                // At the left end it would run into the vertical axis.
                let at_left_end = mark.value <= range.start() + 1e-9;
                if at_left_end { String::new() } else { format!("{} s", number(mark.value, 0)) }
            })
            .y_axis_formatter(|mark, _| number(mark.value, decimals_for(mark.step_size)));
        let cursor = self.view.cursor_s.map(|at_s| at_s - self.end_s);
        let shown = plot.show(ui, |plot| {
            plot.set_plot_bounds_x(-self.view.window_s..=0.0);
            plot.set_plot_bounds_y(low..=high);
            for event in self.model.events.iter().filter(|e| window_s.contains(&e.time_s)) {
                let colour = if event.fault.is_some() || event.mode == Mode::ProtectiveStop {
                    theme::BAD
                } else {
                    theme::mode(Some(event.mode))
                };
                plot.vline(
                    VLine::new("", event.time_s - self.end_s).color(colour).width(1.0).allow_hover(false),
                );
            }
            for (index, (curve, (name, _))) in curves.into_iter().zip(&self.panel.traces).enumerate() {
                for piece in curve.pieces {
                    let line = Line::new(name.as_str(), PlotPoints::from(piece));
                    plot.line(line.color(theme::curve(index)).width(1.5).allow_hover(false));
                }
            }
            if let Some(at) = cursor {
                plot.vline(VLine::new("", at).color(weak).width(1.0).allow_hover(false));
            }
        });
        let pointer = shown.response.hover_pos()?;
        let at = shown.transform.value_from_position(pointer).x;
        (-self.view.window_s..=0.0).contains(&at).then_some(at + self.end_s)
    }

    /// Title, unit, and each curve's name in its colour with its value under the cursor, or the newest.
    fn heading(&self, ui: &mut Ui) {
        let at_s = self.view.cursor_s.unwrap_or(self.end_s);
        ui.allocate_ui(vec2(ui.available_width(), HEADING), |ui| {
            ui.horizontal(|ui| {
                ui.spacing_mut().item_spacing.x = 6.0;
                ui.strong(self.panel.title);
                ui.weak(self.panel.unit);
                // A dozen values would not fit; those are beside the taxels themselves.
                let with_values = self.panel.traces.len() <= 3;
                for (index, (name, signal)) in self.panel.traces.iter().enumerate() {
                    let colour = theme::curve(index);
                    if with_values {
                        let value = self.model.history.value_at(*signal, at_s).unwrap_or(f64::NAN);
                        let value = number(value, self.panel.decimals);
                        ui.label(RichText::new(name).color(colour).strong());
                        ui.label(RichText::new(format!("{value:>6}")).monospace());
                        ui.add_space(6.0);
                    } else {
                        ui.label(RichText::new(name).color(colour).strong().size(11.5));
                    }
                }
            });
        });
    }
}

/// A few marks at round values.
fn marks(input: GridInput) -> Vec<GridMark> {
    let (values, step_size) = round_marks(input.bounds.0, input.bounds.1);
    values.into_iter().map(|value| GridMark { value, step_size }).collect()
}

/// Digits after the point that a grid of `step` needs.
fn decimals_for(step: f64) -> usize {
    (0..6).find(|d| step * 10f64.powi(*d) >= 0.999).and_then(|d| usize::try_from(d).ok()).unwrap_or(6)
}
