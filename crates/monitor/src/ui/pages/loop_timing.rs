//! Loop and board: histograms of how late they were and of each stage of a tick, and the same over time.

use super::plots;
use crate::logic::limited::Limited;
use crate::logic::{format::number, model::Model, signals::histogram::Histogram};
use crate::ui::{gauges, requests::PageRequests, theme, view::View};
use egui::{Align, Color32, Grid, Id, Label, Layout, RichText, Role, ScrollArea, Ui, WidgetInfo, vec2};
use egui_plot::{AxisHints, GridInput, GridMark, Line, Plot, PlotPoints, VLine};
use moca_msgs::STAGES;

/// Height of the histograms, points.
const HEIGHT: f32 = 130.0;
/// Heading, legend and quantiles of a histogram, points.
const AROUND: f32 = 108.0;
/// Width that makes room for one more thing beside another, points.
const GAP: f32 = 16.0;
/// Narrowest histogram, points.
const NARROW: f32 = 245.0;
/// Lowest height of the plots below, points.
const PLOTS: f32 = 170.0;
/// Narrowest and widest quantile, points.
const CELL: (f32, f32) = (34.0, 50.0);
/// Width of the stages' quantiles, points.
const TABLE: f32 = 330.0;

/// Draws the page.
pub(super) fn show(ui: &mut Ui, model: &Model, view: &mut View, pressed: &mut PageRequests) {
    if model.timing.lateness_us.total() == 0 {
        ui.weak("How late loop and board were appears here once samples come.");
        return;
    }
    let (height, top) = (ui.available_height(), ui.cursor().top());
    ScrollArea::vertical().auto_shrink([false, false]).show(ui, |ui| {
        histograms(ui, model);
        ui.separator();
        plots::toolbar(ui, model, view, pressed);
        // What the window leaves, or as much as can be read.
        let left = (height - (ui.cursor().top() - top)).max(PLOTS);
        ui.allocate_ui(vec2(ui.available_width(), left), |ui| {
            ui.set_max_height(left);
            plots::show(ui, model, &model.timing_panels, 2, view);
        });
    });
}

/// As many beside each other as the window has room for.
fn histograms(ui: &mut Ui, model: &Model) {
    let timing = &model.timing;
    let period_us = model.robot.period_s * 1e6;
    let histograms = [
        ("Loop lateness", "µs", &timing.lateness_us, period_us, "one period"),
        ("From tick to tick", "µs", &timing.period_us, period_us, "the period asked for"),
        ("Age of cover data", "ms", &timing.frame_age_ms, model.robot.frame_deadline_s * 1e3, "the deadline"),
    ];
    let available = ui.available_width();
    let columns = if available > 3.0 * NARROW { 3.0 } else { 1.0 };
    let width = available / columns - GAP;
    ui.horizontal_wrapped(|ui| {
        ui.spacing_mut().item_spacing.x = GAP;
        // A log shows no two ticks in a row, and not every robot has a cover.
        for (title, unit, histogram, limit, limit_name) in histograms.into_iter().filter(|h| h.2.total() > 0)
        {
            column(ui, width, |ui| {
                heading(ui, title, unit, histogram);
                chart(ui, title, &[(histogram, theme::curve(0))], limit, width);
                ui.weak(format!("line: {limit_name}, {} {unit}", number(limit, 0)));
                quantiles(ui, title, &[("", unit, histogram)]);
            });
        }
    });
    let (stages, title) = (&timing.stages_us, "Stages of a tick");
    let wide = if available > TABLE + NARROW { available - TABLE - 2.0 * GAP } else { available - GAP };
    ui.horizontal_wrapped(|ui| {
        ui.spacing_mut().item_spacing.x = GAP;
        column(ui, wide, |ui| {
            heading(ui, title, "µs", &stages[0]);
            let curves: Vec<_> = stages.iter().enumerate().map(|(i, h)| (h, theme::curve(i))).collect();
            chart(ui, title, &curves, period_us, wide);
            ui.weak(format!("line: one period, {} µs", number(period_us, 0)));
            if let Some(sample) = &model.latest {
                gauges::counters(ui, model, sample);
            }
        });
        column(ui, TABLE.min(available), |ui| {
            let rows: Vec<_> = STAGES.iter().zip(stages).map(|(name, h)| (*name, "µs", h)).collect();
            quantiles(ui, title, &rows);
            if stages[0].total() == 0 {
                ui.weak("This run was not timed.");
            }
        });
    });
}

fn column(ui: &mut Ui, width: f32, contents: impl FnOnce(&mut Ui)) {
    ui.allocate_ui_with_layout(vec2(width, HEIGHT + AROUND), Layout::top_down(Align::Min), |ui| {
        ui.spacing_mut().item_spacing.x = 6.0;
        ui.set_max_width(width);
        contents(ui);
    });
}

fn heading(ui: &mut Ui, title: &str, unit: &str, histogram: &Histogram) {
    ui.strong(title);
    ui.add(
        Label::new(RichText::new(format!("{unit}, share of {} ticks", histogram.total())).weak()).truncate(),
    );
}

/// Histograms over a logarithmic axis; the height is the logarithm of the share, so that one tick in 10⁵ is seen.
fn chart(ui: &mut Ui, title: &str, histograms: &[(&Histogram, Color32)], limit: f64, width: f32) {
    let ends = |(from, to, _): (f64, f64, u64)| (from.log10(), to.log10());
    let edges: Vec<_> = histograms.first().map_or_else(Vec::new, |(h, _)| h.bins().map(ends).collect());
    let (Some(first), Some(last)) = (edges.first(), edges.last()) else { return };
    let shown = Plot::new(title)
        .id(Id::unique(("histogram", title)))
        .width(width)
        .height(HEIGHT)
        .allow_zoom(false)
        .allow_drag(false)
        .allow_scroll(false)
        .allow_boxed_zoom(false)
        .show_x(false)
        .show_y(false)
        .grid_spacing(plots::LABELS)
        .grid_color(ui.visuals().weak_text_color().gamma_multiply(plots::GRID))
        .x_grid_spacer(decades)
        .y_grid_spacer(decades)
        .custom_x_axes(vec![AxisHints::new_x().label_spacing(plots::LABELS).formatter(|mark, range| {
            let at_end = mark.value <= range.start() + 1e-9 || mark.value >= range.end() - 1e-9;
            let text = || number(10f64.powf(mark.value), usize::from(mark.value < 0.0));
            if at_end { String::new() } else { text() }
        })])
        .custom_y_axes(vec![AxisHints::new_y().label_spacing(plots::LABELS).min_thickness(56.0).formatter(
            |mark, _| {
                let percent = 10f64.powf(mark.value - DECADES + 2.0);
                let decimals = (0..3).find(|d| percent * 10f64.powi(*d) > 0.99).unwrap_or(3);
                format!("{} %", number(percent, usize::try_from(decimals).unwrap_or(0)))
            },
        )])
        .show(ui, |plot| {
            plot.set_plot_bounds_x(first.0..=last.1);
            plot.set_plot_bounds_y(0.0..=DECADES + 0.2);
            for (histogram, colour) in histograms {
                let outline = Line::new(title, PlotPoints::from(outline(histogram))).allow_band(false);
                plot.line(outline.color(*colour).width(1.5).allow_hover(false));
            }
            plot.vline(VLine::new("", limit.log10()).color(theme::WARNING).width(1.5).allow_hover(false));
        });
    let label = format!("Histogram {title}");
    shown.response.widget_info(|| WidgetInfo::labeled(Role::Figure, true, &label));
}

/// Steps along the tops of the bins, both axes logarithmic.
fn outline(histogram: &Histogram) -> Vec<[f64; 2]> {
    #[expect(clippy::cast_precision_loss, reason = "counts are far below 2^53")]
    let total = histogram.total().max(1) as f64;
    let steps = histogram.bins().flat_map(|(from, to, count)| {
        #[expect(clippy::cast_precision_loss, reason = "counts are far below 2^53")]
        let share = count as f64 / total;
        let height = if count > 0 { (share.log10() + DECADES).max(0.05) } else { 0.0 };
        [[from.log10(), height], [to.log10(), height]]
    });
    steps.collect()
}

/// Decades of the share that are shown: down to one tick in 10⁵.
const DECADES: f64 = 5.0;

fn decades(input: GridInput) -> Vec<GridMark> {
    let (low, high) = input.bounds;
    let marks = (0..12).map(|i| low.ceil() + f64::from(i)).take_while(|value| *value <= high);
    marks.map(|value| GridMark { value, step_size: 1.0 }).collect()
}

/// A row for each histogram: its name in the colour of its curve, unless it has none, and its quantiles.
fn quantiles(ui: &mut Ui, title: &str, rows: &[(&str, &str, &Histogram)]) {
    let named = rows.iter().any(|(name, ..)| !name.is_empty());
    // Beside four quantiles stand unit and name.
    let beside = if named { 110.0 } else { 34.0 };
    let width = ((ui.available_width() - beside) / 4.0 - 4.0).limited(CELL.0, CELL.1);
    let cell = |ui: &mut Ui, text: RichText| {
        ui.allocate_ui_with_layout(vec2(width, 18.0), Layout::right_to_left(Align::Center), |ui| {
            ui.set_min_width(width);
            ui.label(text);
        });
    };
    Grid::new(("quantiles", title)).min_col_width(0.0).spacing([4.0, 2.0]).show(ui, |ui| {
        if named {
            ui.label("");
        }
        for name in ["p50", "p99", "p99.9", "max"] {
            cell(ui, RichText::new(name).weak());
        }
        ui.end_row();
        for (index, (name, unit, histogram)) in rows.iter().enumerate() {
            if named {
                ui.label(RichText::new(*name).color(theme::curve(index)).strong());
            }
            let [p50, p99, p999] = [0.5, 0.99, 0.999].map(|part| histogram.quantile(part));
            for value in [p50, p99, p999, histogram.max()] {
                cell(ui, RichText::new(number(value, usize::from(value < 10.0))).monospace());
            }
            ui.weak(*unit);
            ui.end_row();
        }
    });
}
