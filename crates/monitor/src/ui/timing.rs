//! Loop and board: histograms of how late they were, and the same over time.

use super::{View, plots, theme};
use crate::logic::{Histogram, Model, words::number};
use egui::{Align, Grid, Id, Layout, RichText, Role, Ui, WidgetInfo, vec2};
use egui_plot::{AxisHints, Bar, BarChart, GridInput, GridMark, Plot, VLine};

/// Height of the histograms, points.
const HEIGHT: f32 = 190.0;
/// Width that makes room for one more thing beside another, points.
const GAP: f32 = 16.0;
/// Width of a quantile, points.
const CELL: f32 = 56.0;

/// Draws the page.
pub(super) fn show(ui: &mut Ui, model: &Model, view: &mut View) {
    let timing = &model.timing;
    let period_us = model.robot.period_s * 1e6;
    let histograms = [
        ("Loop lateness", "µs", &timing.lateness_us, period_us, "one period"),
        ("From tick to tick", "µs", &timing.period_us, period_us, "the period asked for"),
        ("Age of cover data", "ms", &timing.frame_age_ms, model.robot.frame_deadline_s * 1e3, "the deadline"),
    ];
    let width = (ui.available_width() - 2.0 * GAP) / 3.0;
    ui.horizontal(|ui| {
        ui.spacing_mut().item_spacing.x = GAP;
        for (title, unit, histogram, limit, limit_name) in histograms {
            ui.allocate_ui_with_layout(vec2(width, HEIGHT + 100.0), Layout::top_down(Align::Min), |ui| {
                ui.spacing_mut().item_spacing.x = 6.0;
                ui.horizontal(|ui| {
                    ui.strong(title);
                    ui.weak(format!("{unit}, share of {} ticks", histogram.total()));
                });
                chart(ui, title, histogram, limit, width);
                ui.weak(format!("line: {limit_name}, {} {unit}", number(limit, 0)));
                quantiles(ui, title, histogram, unit);
            });
        }
    });
    ui.separator();
    plots::toolbar(ui, model, view);
    plots::show(ui, model, &model.timing_panels, 2, view);
}

/// Bars over a logarithmic axis; a bar's height is the logarithm of its share, so that one tick in 10⁵ is seen.
fn chart(ui: &mut Ui, title: &str, histogram: &Histogram, limit: f64, width: f32) {
    #[expect(clippy::cast_precision_loss, reason = "counts are far below 2^53")]
    let total = histogram.total().max(1) as f64;
    let bars = histogram.bins().filter(|(.., count)| *count > 0).map(|(from, to, count)| {
        #[expect(clippy::cast_precision_loss, reason = "counts are far below 2^53")]
        let decades = (count as f64 / total).log10() + DECADES;
        let (from, to) = (from.log10(), to.log10());
        Bar::new(from.midpoint(to), decades.max(0.05)).width(to - from)
    });
    let chart = BarChart::new(title, bars.collect()).color(theme::curve(0)).allow_hover(false);
    let (first, last) = histogram.bins().fold((f64::NAN, 0.0), |(first, _): (f64, f64), (from, to, _)| {
        (if first.is_nan() { from.log10() } else { first }, to.log10())
    });
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
            plot.set_plot_bounds_x(first..=last);
            plot.set_plot_bounds_y(0.0..=DECADES + 0.2);
            plot.bar_chart(chart);
            plot.vline(VLine::new("", limit.log10()).color(theme::WARNING).width(1.5).allow_hover(false));
        });
    let label = format!("Histogram {title}");
    shown.response.widget_info(|| WidgetInfo::labeled(Role::Figure, true, &label));
}

/// Decades of the share that are shown: down to one tick in 10⁵.
const DECADES: f64 = 5.0;

fn decades(input: GridInput) -> Vec<GridMark> {
    let (low, high) = input.bounds;
    let marks = (0..12).map(|i| low.ceil() + f64::from(i)).take_while(|value| *value <= high);
    marks.map(|value| GridMark { value, step_size: 1.0 }).collect()
}

fn quantiles(ui: &mut Ui, title: &str, histogram: &Histogram, unit: &str) {
    let part = |part| histogram.quantile(part);
    let values = [("p50", part(0.5)), ("p99", part(0.99)), ("p99.9", part(0.999)), ("max", histogram.max())];
    let cell = |ui: &mut Ui, text: RichText| {
        ui.allocate_ui_with_layout(vec2(CELL, 18.0), Layout::right_to_left(Align::Center), |ui| {
            ui.set_min_width(CELL);
            ui.label(text);
        });
    };
    Grid::new(("quantiles", title)).num_columns(4).spacing([4.0, 2.0]).show(ui, |ui| {
        for (name, _) in values {
            cell(ui, RichText::new(name).weak());
        }
        ui.end_row();
        for (_, value) in values {
            cell(ui, RichText::new(number(value, usize::from(value < 10.0))).monospace());
        }
        ui.weak(unit);
        ui.end_row();
    });
}
