//! The cover as a table: every taxel's force, counts, age and health, and whether it is in use.

use crate::logic::{
    format::{number, taxel_name},
    model::Model,
};
use crate::ui::{requests::PageRequests, theme};
use egui::{Align, Button, Grid, Label, Layout, RichText, ScrollArea, Ui, vec2};
use moca_msgs::protection::NO_ROOM_M_S;
use moca_msgs::{Request, Sample, TaxelStatus};

/// Width of a column, points.
const COLUMN: f32 = 78.0;

/// Draws the page and notes which masks were pressed.
pub(super) fn show(ui: &mut Ui, model: &Model, now_s: f64, pressed: &mut PageRequests) {
    let Some(sample) = &model.latest else {
        ui.weak("The cover appears here once samples come.");
        return;
    };
    let may_mask = model.allows(Request::MaskTaxel { taxel: 0, masked: true }, now_s);
    ui.horizontal_wrapped(|ui| {
        ui.strong("Taxels");
        let why = match model.mode(now_s) {
            Some(m) if m.moves() => "Disarm to change masks.",
            _ => {
                "What a masked taxel means is board.mask_policy; a restart brings the configured masks back."
            }
        };
        ui.weak(why);
    });
    if !model.robot.uncalibrated.is_empty() {
        ui.add(Label::new(RichText::new(&model.robot.uncalibrated).color(theme::WARNING)).wrap());
    }
    ScrollArea::both().show(ui, |ui| {
        table(ui, model, sample, may_mask, pressed);
        contacts(ui, sample);
    });
}

/// Shows the bounds of the contact barrier on touched taxels, and the base's motion.
fn contacts(ui: &mut Ui, sample: &Sample) {
    if sample.contact_rows.is_empty() {
        return;
    }
    ui.separator();
    ui.strong("Contact barrier");
    Grid::new("contacts").striped(true).spacing([10.0, 3.0]).show(ui, |ui| {
        for heading in ["Taxel", "Depth mm", "Person m/s", "Allowed m/s", "Outward m/s", "Too fast m/s"] {
            cell(ui, RichText::new(heading).weak());
        }
        ui.end_row();
        for row in &sample.contact_rows {
            let speed = |m_s: f64| RichText::new(number(m_s, 3)).monospace();
            cell(ui, RichText::new(taxel_name(usize::from(row.taxel))).strong());
            cell(ui, RichText::new(number(1e3 * row.depth_m, 1)).monospace());
            cell(ui, speed(row.person_m_s));
            cell(ui, speed(row.allowed_m_s));
            cell(ui, speed(row.outward_m_s));
            let exceeded = row.excess_m_s > NO_ROOM_M_S;
            let excess = speed(row.excess_m_s);
            cell(ui, if exceeded { excess.color(theme::BAD) } else { excess });
            ui.end_row();
        }
    });
}

fn table(ui: &mut Ui, model: &Model, sample: &Sample, may_mask: bool, pressed: &mut PageRequests) {
    Grid::new("taxels").striped(true).spacing([10.0, 3.0]).show(ui, |ui| {
        for heading in ["Taxel", "Force N", "Counts", "Age ms", "Health"] {
            cell(ui, RichText::new(heading).weak());
        }
        ui.weak("In use");
        ui.end_row();
        for index in 0..model.robot.taxels.len() {
            if let Some(request) = row(ui, sample, index, may_mask) {
                pressed.requests.push(request);
            }
        }
    });
}

fn row(ui: &mut Ui, sample: &Sample, index: usize, may_mask: bool) -> Option<Request> {
    let reading = sample.taxels.get(index).copied().unwrap_or_default();
    let valid = reading.status == TaxelStatus::Ok;
    let masked = reading.status == TaxelStatus::Masked;
    let name = taxel_name(index);
    let age_ms = if sample.frame_age_s < 0.0 { f64::NAN } else { sample.frame_age_s * 1e3 };
    let colour = match (valid, masked) {
        (true, _) => theme::GOOD,
        (_, true) => ui.visuals().weak_text_color(),
        _ => theme::BAD,
    };
    cell(ui, RichText::new(name.as_str()).strong());
    cell(ui, RichText::new(number(if valid { reading.force_n } else { f64::NAN }, 1)).monospace());
    cell(ui, RichText::new(sample.counts.get(index).map_or("–".into(), u16::to_string)).monospace());
    cell(ui, RichText::new(number(age_ms, 0)).monospace());
    cell(ui, RichText::new(reading.status.name()).color(colour));
    let label = format!("{} {name}", if masked { "Use" } else { "Mask" });
    let clicked = ui.add_enabled(may_mask, Button::new(label).min_size(vec2(84.0, 0.0))).clicked();
    ui.end_row();
    clicked.then_some(Request::MaskTaxel { taxel: u8::try_from(index).ok()?, masked: !masked })
}

fn cell(ui: &mut Ui, text: RichText) {
    ui.allocate_ui_with_layout(vec2(COLUMN, 20.0), Layout::right_to_left(Align::Center), |ui| {
        ui.set_min_width(COLUMN);
        ui.label(text);
    });
}
