//! Calibration of a taxel, step by step: choose, step away, press, look at the residuals, save. The daemon collects,
//! fits and writes; this page shows how far it is.

use super::plots;
use crate::logic::{format::number, model::Model, simulated_press::slow_press_n};
use crate::ui::{
    requests::PageRequests,
    theme,
    view::{CalibrationChoice, View},
};
use egui::{
    Align, Button, Checkbox, ComboBox, Grid, Id, Label, Layout, ProgressBar, RichText, Slider, Ui, vec2,
};
use egui_plot::{AxisHints, HLine, Plot, PlotPoints, Points};
use moca_msgs::Mode;
use moca_telemetry::calibration::{CalibrationFit, CalibrationProgress, CalibrationRequest, FittedModel};

/// Width of a number's column, points.
const COLUMN: f32 = 86.0;
/// Lowest plot of residuals, points.
const PLOT_HEIGHT: f32 = 160.0;

/// Draws the page and notes what was pressed.
pub(super) fn show(ui: &mut Ui, model: &Model, view: &mut View, now_s: f64, pressed: &mut PageRequests) {
    let choice = &mut view.calibration;
    let progress = &model.calibration;
    if model.recorded {
        ui.label("A taxel is calibrated beside a running daemon: this is a recorded run.");
        return;
    }
    if let CalibrationProgress::Unavailable(why) = progress {
        ui.label(format!("This daemon cannot calibrate from here: {why}."));
        return;
    }
    step(ui, 1, "Choose a taxel", !busy(progress));
    start(ui, model, choice, now_s, pressed);
    step(ui, 2, "Step away from the cover", matches!(progress, CalibrationProgress::Rest { .. }));
    if let CalibrationProgress::Rest { frames, frames_wanted, .. } = progress {
        bar(ui, *frames, *frames_wanted, "frames at rest");
    }
    step(ui, 3, "Press slowly and release", matches!(progress, CalibrationProgress::Press { .. }));
    press(ui, model, choice, now_s, pressed);
    step(ui, 4, "Look at the residuals and save", matches!(progress, CalibrationProgress::Fitted(_)));
    match progress {
        CalibrationProgress::Fitted(fit) => fitted(ui, fit, choice, model.may_command(), pressed),
        CalibrationProgress::Saved { path, taxels } => saved(ui, path, taxels, model.robot.taxels.len()),
        CalibrationProgress::Failed(why) => {
            ui.colored_label(theme::BAD, format!("That did not work: {why}"));
        }
        _ => {}
    }
}

fn busy(progress: &CalibrationProgress) -> bool {
    matches!(
        progress,
        CalibrationProgress::Rest { .. } | CalibrationProgress::Press { .. } | CalibrationProgress::Fitted(_)
    )
}

fn step(ui: &mut Ui, number: u32, title: &str, now: bool) {
    ui.add_space(6.0);
    let text = RichText::new(format!("{number}  {title}")).size(17.0);
    ui.label(if now { text.strong().color(theme::strong(ui.visuals())) } else { text.weak() });
}

fn start(ui: &mut Ui, model: &Model, choice: &mut CalibrationChoice, now_s: f64, pressed: &mut PageRequests) {
    let still = model.mode(now_s).is_some_and(|m| matches!(m, Mode::Ready | Mode::ProtectiveStop));
    let busy = busy(&model.calibration);
    ui.horizontal(|ui| {
        ui.add_enabled_ui(!busy, |ui| {
            let label = ui.label("Taxel");
            let name = |taxel: u8| format!("T{}", u16::from(taxel) + 1);
            let chosen = ComboBox::from_id_salt("taxel").width(64.0).selected_text(name(choice.taxel));
            let shown = chosen.show_ui(ui, |ui| {
                for taxel in 0..u8::try_from(model.robot.taxels.len()).unwrap_or(u8::MAX) {
                    ui.selectable_value(&mut choice.taxel, taxel, name(taxel));
                }
            });
            shown.response.labelled_by(label.id);
            let label = ui.label("Presses");
            ui.add(Slider::new(&mut choice.presses, 1..=10)).labelled_by(label.id);
        });
        let button = Button::new("Start calibration");
        let hint = "The robot must hold still: disarm it first";
        if ui
            .add_enabled(!busy && still && model.may_command(), button)
            .on_disabled_hover_text(hint)
            .clicked()
        {
            let (taxel, presses) = (choice.taxel, choice.presses);
            pressed.calibrate = Some(CalibrationRequest::Start { taxel, presses });
        }
        if ui.add_enabled(busy, Button::new("Cancel calibration")).clicked() {
            pressed.calibrate = Some(CalibrationRequest::Cancel);
        }
    });
    if !still && !busy && model.mode(now_s).is_some() {
        ui.colored_label(theme::WARNING, "The robot must hold still while a taxel is calibrated: disarm it.");
    }
}

fn press(ui: &mut Ui, model: &Model, choice: &mut CalibrationChoice, now_s: f64, pressed: &mut PageRequests) {
    let CalibrationProgress::Press { taxel, presses, presses_wanted, counts, force_n } = &model.calibration
    else {
        choice.pressing_since_s = None;
        return;
    };
    bar(ui, *presses, *presses_wanted, &format!("presses of T{}", u16::from(*taxel) + 1));
    let force = force_n.map_or("no reading of the reference yet".into(), |n| format!("{} N", number(n, 1)));
    ui.monospace(format!("{:>5} counts below rest   reference {force}", number(*counts, 0)));
    if !model.can_push() {
        ui.weak("Press with the force gauge, square on the middle of the plate: slowly up, slowly down.");
        return;
    }
    ui.add(Checkbox::new(&mut choice.simulated_press, "Let a simulated hand press"));
    if choice.simulated_press {
        let since_s = *choice.pressing_since_s.get_or_insert(now_s);
        pressed.push = Some((*taxel, slow_press_n(now_s - since_s)));
    } else {
        choice.pressing_since_s = None;
        ui.weak("Press the taxel of the ring with the mouse; change the force in between.");
    }
}

fn bar(ui: &mut Ui, done: u32, wanted: u32, what: &str) {
    #[expect(clippy::cast_precision_loss, reason = "a few dozen")]
    let part = done as f32 / wanted.max(1) as f32;
    let text = format!("{} of {wanted} {what}", done.min(wanted));
    ui.add(ProgressBar::new(part).desired_width(420.0).text(text));
}

fn fitted(
    ui: &mut Ui,
    fit: &CalibrationFit,
    choice: &mut CalibrationChoice,
    may_save: bool,
    pressed: &mut PageRequests,
) {
    let (taxel, rest) = (u16::from(fit.taxel) + 1, number(fit.rest_counts, 1));
    ui.label(format!("T{taxel}: {rest} counts at rest. Choose the model to save:"));
    let cell = |ui: &mut Ui, text: RichText| {
        ui.allocate_ui_with_layout(vec2(COLUMN, 18.0), Layout::right_to_left(Align::Center), |ui| {
            ui.set_min_width(COLUMN);
            ui.label(text);
        });
    };
    Grid::new("models").num_columns(6).spacing([8.0, 3.0]).show(ui, |ui| {
        ui.weak("Model");
        for heading in ["RMSE N", "loading N", "unloading N", "worst N", "valid to N"] {
            cell(ui, RichText::new(heading).weak());
        }
        ui.end_row();
        for (index, model) in fit.models.iter().enumerate() {
            let radio = egui::RadioButton::new(choice.model == index, model.name.as_str());
            let hint = "Reads its intercept when untouched: for reporting only";
            if ui.add_enabled(model.usable, radio).on_disabled_hover_text(hint).clicked() {
                choice.model = index;
            }
            let FittedModel { rmse_n, rmse_loading_n, rmse_unloading_n, worst_n, force_max_n, .. } = model;
            let values =
                [(rmse_n, 2), (rmse_loading_n, 2), (rmse_unloading_n, 2), (worst_n, 1), (force_max_n, 0)];
            for (value, decimals) in values {
                cell(ui, RichText::new(number(*value, decimals)).monospace());
            }
            ui.end_row();
        }
    });
    let Some(model) = fit.models.get(choice.model) else { return };
    if ui.add_enabled(may_save && model.usable, Button::new("Save calibration")).clicked() {
        pressed.calibrate = u8::try_from(choice.model).ok().map(|model| CalibrationRequest::Save { model });
    }
    residuals(ui, model);
}

/// Model minus reference over the reference's force.
fn residuals(ui: &mut Ui, model: &FittedModel) {
    let points = model.residuals.iter().map(|&[force, error]| [f64::from(force), f64::from(error)]).collect();
    let worst = model.worst_n.max(1.0) * 1.1;
    let axis = |hints: AxisHints<'static>, label: &str| {
        hints.label(label).label_spacing(plots::LABELS).formatter(|mark, _| number(mark.value, 0))
    };
    Plot::new("residuals")
        .id(Id::unique("residuals"))
        .height((ui.available_height() - 8.0).max(PLOT_HEIGHT))
        .allow_zoom(false)
        .allow_drag(false)
        .allow_scroll(false)
        .allow_boxed_zoom(false)
        .x_grid_spacer(|input| plots::marks(input, 8.0))
        .y_grid_spacer(|input| plots::marks(input, 5.0))
        .grid_spacing(plots::LABELS)
        .grid_color(ui.visuals().weak_text_color().gamma_multiply(plots::GRID))
        .custom_x_axes(vec![axis(AxisHints::new_x(), "reference force N")])
        .custom_y_axes(vec![axis(AxisHints::new_y().min_thickness(44.0), "model − reference N")])
        .show(ui, |plot| {
            plot.set_plot_bounds_x(0.0..=model.force_max_n.max(1.0) * 1.02);
            plot.set_plot_bounds_y(-worst..=worst);
            plot.hline(HLine::new("", 0.0).color(theme::GOOD).width(1.0).allow_hover(false));
            let points = Points::new("residual", PlotPoints::new(points));
            plot.points(points.radius(2.0).color(theme::curve(0)));
        });
}

fn saved(ui: &mut Ui, path: &str, taxels: &[u8], wanted: usize) {
    let names = taxels.iter().map(|t| format!("T{t}")).collect::<Vec<_>>().join(", ");
    ui.colored_label(theme::GOOD, format!("Saved {path} with {names}."));
    let text = if taxels.len() < wanted {
        format!(
            "The daemon takes the file once all {wanted} taxels are in it: choose the next one above. \
             Saving adds to the file."
        )
    } else {
        "Name it in board.calibration and start the daemon again to use it.".into()
    };
    ui.add(Label::new(text).wrap());
}
