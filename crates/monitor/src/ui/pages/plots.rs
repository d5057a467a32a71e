//! Plots with one axis of time and one cursor.

use crate::logic::{
    event::nearest,
    format::number,
    model::Model,
    signals::{
        axis::TimeAxis,
        history::{Curve, thinned},
        panel::{Panel, Signal, round_marks, vertical_range},
    },
};
use crate::ui::{requests::PageRequests, row, theme, view::View};
use egui::{
    Align, Color32, Id, Layout, PointerButton, Rangef, Rect, RichText, Role, ScrollArea, Ui, UiBuilder, Vec2,
    WidgetInfo, containers::scroll_area::ScrollSource, vec2,
};
use egui_plot::{AxisHints, GridInput, GridMark, Line, LineStyle, Plot, PlotPoints, PlotResponse, VLine};
use moca_msgs::Mode;
use std::ops::Range;

/// Stretches of time that have a button, s.
const SPANS_S: [f64; 4] = [5.0, 10.0, 30.0, 60.0];
/// One press of a zoom button.
const ZOOM: f64 = 0.5;
/// Zoom of the mouse wheel for each point of scrolling.
const WHEEL: f64 = 0.005;
/// Room for the right half of the last mark's text, points.
const RIGHT_MARGIN: f32 = 8.0;
/// Height of a plot's heading, points.
const HEADING: f32 = 18.0;
/// Height of the marks under the lowest plots, points.
const MARKS: f32 = 18.0;
/// Left free below, or rounding would call for a scroll bar, points.
const SPARE: f32 = 6.0;
/// Marks of an axis at most, and the distance of two of them from which on they are drawn in full, points.
const MARKS_X: f64 = 5.0;
const MARKS_Y: f64 = 4.0;
pub(super) const LABELS: Rangef = Rangef { min: 1.0, max: 12.0 };
/// Strength of the grid beside weak text.
pub(super) const GRID: f32 = 0.35;
/// Height that is not seen, points.
const UNSEEN: f64 = 0.25;
/// Width below which plots have one column, points.
const NARROW: f32 = 480.0;
/// Lowest plot with its heading, points.
const LOWEST: f32 = 70.0;
/// Width from which on a heading has room for values, points.
const WIDE: f32 = 330.0;
/// An event this near to the cursor is named, points.
const EVENT_REACH: f64 = 6.0;

/// Draws `panels` in `columns`.
pub(super) fn show(ui: &mut Ui, model: &Model, panels: &[Panel], columns: usize, view: &mut View) {
    view.keep_while_paused(model);
    let history = view.history(model);
    let (Some(oldest_s), Some(newest_s)) = (history.start_s(), history.end_s()) else {
        ui.centered_and_justified(|ui| ui.weak("Plots appear here once samples come."));
        return;
    };
    let columns = if ui.available_width() < NARROW { 1 } else { columns.min(panels.len()).max(1) };
    let spacing = ui.spacing().item_spacing;
    let rows = panels.len().div_ceil(columns).max(1);
    #[expect(clippy::cast_precision_loss, reason = "a handful of rows and columns")]
    let (rows_f, columns_f) = (rows as f32, columns as f32);
    let size = vec2(
        (ui.available_width() - spacing.x * (columns_f - 1.0)) / columns_f - RIGHT_MARGIN,
        ((ui.available_height() - MARKS - SPARE - spacing.y * (rows_f - 1.0)) / rows_f).max(LOWEST),
    );
    // Where the lowest plots do not fit; the wheel zooms.
    let area = ScrollArea::vertical().scroll_source(ScrollSource::SCROLL_BAR).auto_shrink([false, false]);
    let cells = Cells { panels, columns, size, range_s: oldest_s..newest_s };
    let (axis, pointed_at_s) = area.show(ui, |ui| cells.show(ui, model, view)).inner;
    view.cursor_s = pointed_at_s;
    view.axis = axis;
    view.keep_while_paused(model);
}

/// Places of the plots on their page.
struct Cells<'a> {
    panels: &'a [Panel],
    columns: usize,
    /// Size of a plot with its heading.
    size: Vec2,
    /// Range that is kept, s of loop time.
    range_s: Range<f64>,
}

impl Cells<'_> {
    /// Draws every plot; gives the axis after what the mouse did, and where it points, s of loop time.
    fn show(&self, ui: &mut Ui, model: &Model, view: &View) -> (TimeAxis, Option<f64>) {
        let Self { panels, columns, size, .. } = *self;
        let Range { start: oldest_s, end: newest_s } = self.range_s;
        let corner = ui.available_rect_before_wrap().min;
        let pitch = size + ui.spacing().item_spacing + vec2(RIGHT_MARGIN, 0.0);
        let (mut pointed_at_s, mut axis) = (None, view.axis);
        for (index, panel) in panels.iter().enumerate() {
            #[expect(clippy::cast_precision_loss, reason = "a handful of rows and columns")]
            let cell = vec2((index % columns) as f32, (index / columns) as f32) * pitch;
            let lowest = index + columns >= panels.len();
            let size = if lowest { size + vec2(0.0, MARKS) } else { size };
            let builder = UiBuilder::new().max_rect(Rect::from_min_size(corner + cell, size));
            let plotted = Plotted { panel, end_s: axis.end_s(newest_s), view, model, lowest, width: size.x };
            let gesture = ui
                .scope_builder(builder.layout(Layout::top_down(Align::Min)), |ui| plotted.show(ui, size))
                .inner;
            pointed_at_s = gesture.pointed_at_s.or(pointed_at_s);
            gesture.apply(&mut axis, oldest_s, newest_s);
        }
        (axis, pointed_at_s)
    }
}

/// Stretch of time, pause, zoom, export.
pub(super) fn toolbar(ui: &mut Ui, model: &Model, view: &mut View, pressed: &mut PageRequests) {
    ui.horizontal_wrapped(|ui| {
        ui.label("Show the last");
        for span_s in SPANS_S {
            let chosen = view.axis.span_s().total_cmp(&span_s).is_eq();
            if ui.selectable_label(chosen, format!("{span_s:.0} s")).clicked() {
                view.axis.show(span_s);
            }
        }
        let newest_s = model.history.end_s().unwrap_or(0.0);
        let about_s = view.axis.end_s(newest_s) - view.axis.span_s() / 2.0;
        let hint = "The mouse wheel over a plot zooms too; dragging moves; a double click goes back to now";
        for (label, factor) in [("Zoom in", ZOOM), ("Zoom out", 1.0 / ZOOM)] {
            if ui.button(label).on_hover_text(hint).clicked() {
                view.axis.zoom(factor, about_s);
            }
        }
        let mut paused = view.axis.held();
        let pause = ui.toggle_value(&mut paused, "Pause plots");
        if pause.on_hover_text("What is shown stays; new data is taken in behind it").changed() {
            if paused {
                view.axis.hold(newest_s);
            } else {
                view.axis.follow();
            }
        }
        view.keep_while_paused(model);
        let hint = "Save every sample of what is shown to a table in the folder of the recordings";
        pressed.export |= ui.button("Export CSV").on_hover_text(hint).clicked();
        if view.axis.held() {
            let behind_s = (newest_s - view.axis.end_s(newest_s)).max(0.0);
            row::rest(ui, RichText::new(format!("paused, {behind_s:.0} s behind")).color(theme::WARNING));
        }
    });
}

/// Gesture of the mouse on a plot.
#[derive(Default)]
struct Gesture {
    pointed_at_s: Option<f64>,
    zoom: Option<f64>,
    pan_s: f64,
    reset: bool,
}

impl Gesture {
    fn apply(self, axis: &mut TimeAxis, oldest_s: f64, newest_s: f64) {
        if self.reset {
            *axis = TimeAxis::default();
        }
        if self.pan_s.abs() > 0.0 {
            axis.pan(self.pan_s, oldest_s..newest_s);
        }
        if let (Some(factor), Some(about_s)) = (self.zoom, self.pointed_at_s) {
            axis.zoom(factor, about_s);
        }
    }
}

/// One plot of the page.
struct Plotted<'a> {
    panel: &'a Panel,
    end_s: f64,
    view: &'a View,
    model: &'a Model,
    /// True if the axis of time is written under it.
    lowest: bool,
    /// Width of plot and heading, points.
    width: f32,
}

impl Plotted<'_> {
    /// Draws it and says what the mouse did.
    fn show(&self, ui: &mut Ui, size: Vec2) -> Gesture {
        self.heading(ui);
        let span_s = self.view.axis.span_s();
        let window_s = self.end_s - span_s..self.end_s;
        #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "a width on the screen")]
        let pixels = (size.x * ui.pixels_per_point()).max(1.0) as usize;
        let curve = |(_, signal): &(String, _)| {
            self.view.history(self.model).curve(*signal, window_s.clone(), pixels)
        };
        let curves: Vec<Curve> = self.panel.traces.iter().map(curve).collect();
        let extremes = curves.iter().filter_map(|c| c.extremes).reduce(|a, b| (a.0.min(b.0), a.1.max(b.1)));
        let (low, high) = vertical_range(extremes, self.panel.least_span);
        let tolerance = UNSEEN * (high - low) / f64::from(size.y);
        let weak = ui.visuals().weak_text_color();
        let cursor = self.view.cursor_s.map(|at_s| at_s - self.end_s);
        let shown = self
            .frame(vec2(size.x, size.y - HEADING - ui.spacing().item_spacing.y), weak.gamma_multiply(GRID))
            .show(ui, |plot| {
                plot.set_plot_bounds_x(-span_s..=0.0);
                plot.set_plot_bounds_y(low..=high);
                for event in self.view.events(self.model).iter().filter(|e| window_s.contains(&e.time_s)) {
                    let stopped = event.fault.is_some() || event.mode == Mode::ProtectiveStop;
                    let colour = if stopped { theme::BAD } else { theme::mode(Some(event.mode)) };
                    plot.vline(
                        VLine::new("", event.time_s - self.end_s).color(colour).width(1.0).allow_hover(false),
                    );
                }
                for (index, (curve, (name, signal))) in curves.into_iter().zip(&self.panel.traces).enumerate()
                {
                    let (style, width) = if signal.is_desired() {
                        (LineStyle::dashed_dense(), 1.0)
                    } else {
                        (LineStyle::Solid, 1.5)
                    };
                    for piece in curve.pieces {
                        let points = PlotPoints::from(thinned(&piece, tolerance));
                        // A band would fill what lies between two points that are far apart.
                        let line = Line::new(name.as_str(), points).allow_band(false);
                        let line = line.style(style).width(width);
                        plot.line(line.color(self.colour(index)).allow_hover(false));
                    }
                }
                if let Some(at) = cursor {
                    plot.vline(VLine::new("", at).color(weak).width(1.0).allow_hover(false));
                }
            });
        let label = format!("Plot {} in {}", self.panel.title, self.panel.unit);
        shown.response.widget_info(|| WidgetInfo::labeled(Role::Figure, true, &label));
        self.gesture(ui, &shown)
    }

    fn frame(&self, size: Vec2, grid: Color32) -> Plot<'_> {
        Plot::new("plot")
            .id(Id::unique(("plot", self.panel.title)))
            .width(size.x)
            .height(size.y)
            // What the mouse does moves every plot, so the plot itself does nothing with it.
            .allow_zoom(false)
            .allow_drag(false)
            .allow_scroll(false)
            .allow_boxed_zoom(false)
            .allow_double_click_reset(false)
            .show_x(false)
            .show_y(false)
            .show_axes([self.lowest, true])
            // A few marks at round values, all of them as plain to read.
            .grid_spacing(LABELS)
            .grid_color(grid)
            .x_grid_spacer(|input| marks(input, MARKS_X))
            .y_grid_spacer(|input| marks(input, MARKS_Y))
            .custom_x_axes(vec![AxisHints::new_x().label_spacing(LABELS).formatter(|mark, range| {
                // At the left end it would run into the vertical axis.
                let at_left_end = mark.value <= range.start() + 1e-9;
                let text = || format!("{} s", number(mark.value, decimals_for(mark.step_size)));
                if at_left_end { String::new() } else { text() }
            })])
            .custom_y_axes(vec![
                AxisHints::new_y()
                    .label(self.panel.unit)
                    .label_spacing(LABELS)
                    .min_thickness(58.0)
                    .formatter(|mark, _| number(mark.value, decimals_for(mark.step_size))),
            ])
    }

    /// Returns the colour of a curve: measured and desired values have the same one.
    fn colour(&self, index: usize) -> Color32 {
        let desired_before = self.panel.traces.iter().take(index + 1).filter(|(_, s)| s.is_desired()).count();
        theme::curve(index - desired_before)
    }

    fn gesture(&self, ui: &Ui, shown: &PlotResponse<()>) -> Gesture {
        let response = &shown.response;
        let mut gesture = Gesture { reset: response.double_clicked(), ..Gesture::default() };
        let seconds_a_point = 1.0 / shown.transform.dpos_dvalue_x();
        if response.dragged_by(PointerButton::Primary) {
            gesture.pan_s = -f64::from(response.drag_delta().x) * seconds_a_point;
        }
        let Some(pointer) = response.hover_pos() else { return gesture };
        let at_s = shown.transform.value_from_position(pointer).x + self.end_s;
        if !(self.end_s - self.view.axis.span_s()..=self.end_s).contains(&at_s) {
            return gesture;
        }
        gesture.pointed_at_s = Some(at_s);
        let (scroll, pinch) = ui.input(|i| (i.smooth_scroll_delta.y, i.zoom_delta()));
        let factor = (-f64::from(scroll) * WHEEL).exp() / f64::from(pinch);
        gesture.zoom = ((factor - 1.0).abs() > 1e-6).then_some(factor);
        response.clone().on_hover_ui_at_pointer(|ui| self.values(ui, at_s, EVENT_REACH * seconds_a_point));
        gesture
    }

    /// Time, every value that is not zero and the event under the cursor.
    fn values(&self, ui: &mut Ui, at_s: f64, reach_s: f64) {
        ui.monospace(format!("{} s", number(at_s, 3)));
        let Panel { decimals, unit, .. } = *self.panel;
        let zero = number(0.0, decimals);
        let mut zeros = 0;
        for (index, (name, signal)) in self.panel.traces.iter().enumerate() {
            let value = number(self.value(*signal, at_s), decimals);
            if value == zero {
                zeros += 1;
                continue;
            }
            let text = format!("{value:>9} {unit} {name}");
            ui.label(RichText::new(text).monospace().color(self.colour(index)));
        }
        if zeros > 0 {
            let rest = if zeros == self.panel.traces.len() { "all" } else { "the others" };
            ui.label(RichText::new(format!("{zero:>9} {unit} {rest}")).monospace().weak());
        }
        if let Some(event) = nearest(self.view.events(self.model), at_s, reach_s) {
            ui.label(event.text());
        }
    }

    /// Value of a signal; NaN where it is missing.
    fn value(&self, signal: Signal, at_s: f64) -> f64 {
        self.view.history(self.model).value_at(signal, at_s).unwrap_or(f64::NAN)
    }

    /// Title, unit, and each curve's name in its colour with its value under the cursor, or the newest.
    fn heading(&self, ui: &mut Ui) {
        let at_s = self.view.cursor_s.unwrap_or(self.end_s);
        ui.allocate_ui(vec2(self.width, HEADING), |ui| {
            ui.set_clip_rect(ui.max_rect().intersect(ui.clip_rect()));
            ui.horizontal(|ui| {
                ui.spacing_mut().item_spacing.x = 6.0;
                ui.strong(self.panel.title);
                if self.width > WIDE {
                    ui.weak(self.panel.unit);
                } else {
                    ui.spacing_mut().item_spacing.x = 3.0;
                }
                let actual = || self.panel.traces.iter().enumerate().filter(|(_, (_, s))| !s.is_desired());
                // A dozen values would not fit; those are beside the taxels themselves and under the cursor.
                let with_values = actual().count() <= 3 && self.width > WIDE;
                for (index, (name, signal)) in actual() {
                    let colour = self.colour(index);
                    if with_values {
                        let value = number(self.value(*signal, at_s), self.panel.decimals);
                        ui.label(RichText::new(name).color(colour).strong());
                        ui.label(RichText::new(format!("{value:>6}")).monospace());
                    } else {
                        let size = if self.width > WIDE { 11.5 } else { 10.0 };
                        ui.label(RichText::new(name).color(colour).strong().size(size));
                    }
                }
            });
        });
    }
}

/// A few marks at round values.
pub(super) fn marks(input: GridInput, most: f64) -> Vec<GridMark> {
    let (values, step_size) = round_marks(input.bounds.0, input.bounds.1, most);
    values.into_iter().map(|value| GridMark { value, step_size }).collect()
}

/// Digits after the point that a grid of `step` needs.
fn decimals_for(step: f64) -> usize {
    (0..6).find(|d| step * 10f64.powi(*d) >= 0.999).and_then(|d| usize::try_from(d).ok()).unwrap_or(6)
}
