//! Calibration of a taxel, step by step: choose, step away, press, look at the residuals, save; or of all, one after
//! the other. The daemon collects,
//! fits and writes; this page shows how far it is.

use super::plots;
use crate::logic::{
    format::{number, taxel_name},
    model::Model,
    simulated_press::slow_press_n,
};
use crate::ui::{
    requests::PageRequests,
    theme,
    view::{CalibrationChoice, View},
};
use egui::{
    Align, Button, Checkbox, ComboBox, DragValue, Grid, Id, Label, Layout, ProgressBar, Rect, RichText,
    ScrollArea, Ui, UiBuilder, vec2,
};
use egui_plot::{AxisHints, HLine, Plot, PlotPoints, Points};
use moca_msgs::Mode;
use moca_telemetry::calibration::{CalibrationFit, CalibrationProgress, CalibrationRequest, FittedModel};

/// Width of a number's column, points.
const COLUMN: f32 = 86.0;
/// From one taxel to the next, where all follow, s.
const BETWEEN_S: f64 = 3.0;
/// Lowest plot of residuals, points.
const PLOT_HEIGHT: f32 = 160.0;
/// Width from which on the residuals stand beside the steps, and the width of these, points.
const WIDE: f32 = 1000.0;
const STEPS: f32 = 640.0;

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
    follow(choice, model, now_s, pressed);
    let room = ui.available_rect_before_wrap();
    if room.width() < WIDE {
        steps(ui, model, choice, now_s, false, pressed);
        return;
    }
    let (left, right) = room.split_left_right_at_x(room.left() + STEPS);
    let builder = |place: Rect| UiBuilder::new().max_rect(place).layout(Layout::top_down(Align::Min));
    steps(&mut ui.new_child(builder(left)), model, choice, now_s, true, pressed);
    let ui = &mut ui.new_child(builder(right.shrink2(vec2(12.0, 0.0))));
    match &progress {
        CalibrationProgress::Fitted(fit) => {
            if let Some(model) = fit.models.get(choice.model) {
                residuals(ui, model);
            }
        }
        _ => {
            ui.centered_and_justified(|ui| {
                ui.weak("The residuals appear here once a taxel has been pressed.")
            });
        }
    }
}

/// Draws the four steps; `beside` of them the residuals have a place of their own.
fn steps(
    ui: &mut Ui,
    model: &Model,
    choice: &mut CalibrationChoice,
    now_s: f64,
    beside: bool,
    pressed: &mut PageRequests,
) {
    let progress = &model.calibration;
    ScrollArea::vertical().auto_shrink([false, false]).show(ui, |ui| {
        step(ui, 1, "Choose a taxel, or all", !busy(progress));
        overview(ui, model, choice);
        start(ui, model, choice, now_s, pressed);
        step(ui, 2, "Step away from the cover", matches!(progress, CalibrationProgress::Rest { .. }));
        if let CalibrationProgress::Rest { frames, frames_wanted, .. } = progress {
            bar(ui, *frames, *frames_wanted, "frames at rest");
        }
        step(ui, 3, "Press slowly and release", matches!(progress, CalibrationProgress::Press { .. }));
        press(ui, model, choice, now_s, pressed);
        step(ui, 4, "Look at the residuals and save", matches!(progress, CalibrationProgress::Fitted(_)));
        match progress {
            CalibrationProgress::Fitted(fit) => {
                fitted(ui, fit, choice, model.may_command(), pressed);
                if let Some(model) = fit.models.get(choice.model).filter(|_| !beside) {
                    residuals(ui, model);
                }
            }
            CalibrationProgress::Saved { path, taxels } => {
                saved(ui, path, taxels, model.robot.taxels.len());
            }
            CalibrationProgress::Failed(why) => {
                ui.colored_label(theme::BAD, format!("That did not work: {why}"));
            }
            _ => {}
        }
        if let Some(at_s) = choice.next_at_s {
            let wait = number((at_s - now_s).max(0.0), 0);
            let text = format!("{} follows in {wait} s: step away from the cover.", taxel_name(choice.taxel));
            ui.label(RichText::new(text).size(17.0).strong());
        }
    });
}

/// The first taxel that is still to be calibrated.
fn next_taxel(choice: &CalibrationChoice, model: &Model) -> Option<u8> {
    let mut all = 0..u8::try_from(model.robot.taxels.len()).unwrap_or(u8::MAX);
    all.find(|taxel| !choice.done.contains(taxel) && !choice.skipped.contains(taxel))
}

/// Notes what has been saved, and goes on to the next taxel if all are to follow.
fn follow(choice: &mut CalibrationChoice, model: &Model, now_s: f64, pressed: &mut PageRequests) {
    if let CalibrationProgress::Saved { taxels, .. } = &model.calibration {
        // They count from 1 there.
        choice.done = taxels.iter().filter_map(|taxel| taxel.checked_sub(1)).collect();
    }
    let between = matches!(model.calibration, CalibrationProgress::Saved { .. } | CalibrationProgress::Idle);
    if !choice.all || !between || !still(model, now_s) {
        choice.next_at_s = None;
        return;
    }
    let Some(next) = next_taxel(choice, model) else {
        choice.all = false;
        choice.next_at_s = None;
        return;
    };
    choice.taxel = next;
    if now_s >= *choice.next_at_s.get_or_insert(now_s + BETWEEN_S) {
        // The daemon's next word, that it measures the rest, ends this; without one it is asked again.
        choice.next_at_s = Some(now_s + BETWEEN_S);
        begin(choice, pressed);
    }
}

fn begin(choice: &CalibrationChoice, pressed: &mut PageRequests) {
    let CalibrationChoice { taxel, presses, .. } = *choice;
    pressed.calibrate = Some(CalibrationRequest::Start { taxel, presses });
}

fn still(model: &Model, now_s: f64) -> bool {
    model.mode(now_s).is_some_and(|mode| matches!(mode, Mode::Ready | Mode::ProtectiveStop))
}

/// The taxel that is being calibrated.
fn current(progress: &CalibrationProgress) -> Option<u8> {
    match progress {
        CalibrationProgress::Rest { taxel, .. } | CalibrationProgress::Press { taxel, .. } => Some(*taxel),
        CalibrationProgress::Fitted(fit) => Some(fit.taxel),
        _ => None,
    }
}

/// Every taxel, and which are done.
fn overview(ui: &mut Ui, model: &Model, choice: &CalibrationChoice) {
    let now = current(&model.calibration);
    ui.horizontal_wrapped(|ui| {
        for taxel in 0..u8::try_from(model.robot.taxels.len()).unwrap_or(u8::MAX) {
            let name = taxel_name(taxel);
            let text = if now == Some(taxel) {
                RichText::new(format!("{name} now")).strong().color(theme::WARNING)
            } else if choice.done.contains(&taxel) {
                RichText::new(format!("{name} done")).color(theme::GOOD)
            } else if choice.skipped.contains(&taxel) {
                RichText::new(format!("{name} left out")).weak()
            } else {
                RichText::new(name).weak()
            };
            ui.label(text);
        }
    });
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

/// Which taxel, and how many presses.
fn choose(ui: &mut Ui, model: &Model, choice: &mut CalibrationChoice) {
    let label = ui.label("Taxel");
    let chosen = ComboBox::from_id_salt("taxel").width(64.0).selected_text(taxel_name(choice.taxel));
    let shown = chosen.show_ui(ui, |ui| {
        for taxel in 0..u8::try_from(model.robot.taxels.len()).unwrap_or(u8::MAX) {
            ui.selectable_value(&mut choice.taxel, taxel, taxel_name(taxel));
        }
    });
    shown.response.labelled_by(label.id);
    let label = ui.label("Presses");
    ui.add(DragValue::new(&mut choice.presses).range(1..=10)).labelled_by(label.id);
}

fn start(ui: &mut Ui, model: &Model, choice: &mut CalibrationChoice, now_s: f64, pressed: &mut PageRequests) {
    let (still, busy) = (still(model, now_s), busy(&model.calibration));
    ui.add_enabled_ui(!busy, |ui| ui.horizontal_wrapped(|ui| choose(ui, model, choice)));
    ui.horizontal_wrapped(|ui| {
        let may_start = !busy && still && model.may_command() && choice.next_at_s.is_none();
        let hint = "The robot must hold still: disarm it first";
        let button = ui.add_enabled(may_start, Button::new("Start calibration"));
        if button.on_disabled_hover_text(hint).clicked() {
            begin(choice, pressed);
        }
        let button = ui.add_enabled(may_start, Button::new("Calibrate all"));
        if button.on_hover_text("Every taxel that is not done, one after the other").clicked() {
            choice.all = true;
            choice.skipped.clear();
            if let Some(first) = next_taxel(choice, model) {
                choice.taxel = first;
                begin(choice, pressed);
                choice.next_at_s = Some(now_s + BETWEEN_S);
            }
        }
        if choice.all {
            let taxel = current(&model.calibration).unwrap_or(choice.taxel);
            if ui.button(format!("Leave out {}", taxel_name(taxel))).clicked() {
                choice.skipped.insert(taxel);
                choice.next_at_s = None;
                pressed.calibrate = busy.then_some(CalibrationRequest::Cancel);
            }
        }
        if ui.add_enabled(busy || choice.all, Button::new("Cancel calibration")).clicked() {
            choice.all = false;
            choice.next_at_s = None;
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
    bar(ui, *presses, *presses_wanted, &format!("presses of {}", taxel_name(*taxel)));
    let force = force_n.map_or("no reading of the reference yet".into(), |n| format!("{} N", number(n, 1)));
    ui.monospace(format!("{:>5} counts below rest   reference {force}", number(*counts, 0)));
    if !model.can_push() {
        ui.weak("Press with the force gauge, square on the middle of the plate: slowly up, slowly down.");
        return;
    }
    ui.add(Checkbox::new(&mut choice.simulated_press, "Let a simulated hand press"));
    if choice.simulated_press {
        let since_s = *choice.pressing_since_s.get_or_insert(now_s);
        pressed.push.get_or_insert((*taxel, slow_press_n(now_s - since_s)));
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
    if choice.model_chosen_for != Some(fit.taxel) {
        choice.model_chosen_for = Some(fit.taxel);
        choice.model = best(fit);
    }
    let (taxel, rest) = (taxel_name(fit.taxel), number(fit.rest_counts, 1));
    ui.label(format!("{taxel}: {rest} counts at rest. Choose the model to save:"));
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
        choice.model_chosen_for = None;
        pressed.calibrate = u8::try_from(choice.model).ok().map(|model| CalibrationRequest::Save { model });
    }
}

/// Place of the model that a cover can use with the least error.
fn best(fit: &CalibrationFit) -> usize {
    let usable = fit.models.iter().enumerate().filter(|(_, model)| model.usable);
    usable.min_by(|(_, a), (_, b)| a.rmse_n.total_cmp(&b.rmse_n)).map_or(0, |(index, _)| index)
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
