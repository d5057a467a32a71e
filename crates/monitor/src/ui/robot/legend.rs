//! What the arrows and marks of the robot's pictures are.

use crate::logic::{
    model::Model,
    parts::{has_arm, has_robot},
};
use crate::ui::theme;
use egui::{Align, Color32, Layout, RichText, Sense, Stroke, Ui, vec2};

/// Width of a letter, points.
const LETTER: f32 = 5.6;

/// How a thing is drawn.
#[derive(Clone, Copy)]
enum Mark {
    Arrow,
    Dot,
    Cross,
}

/// Draws each mark with its name.
pub(in crate::ui) fn legend(ui: &mut Ui, model: &Model) {
    if !has_robot(&model.robot) {
        return;
    }
    let hint = "Arrow and arc: force and moment on the base, as the cover feels them";
    entry(ui, Mark::Arrow, theme::WRENCH, "on the base", hint);
    if has_arm(&model.robot) {
        entry(ui, Mark::Arrow, theme::FLANGE_WRENCH, "on the flange", "Arrow: force on the flange");
        entry(ui, Mark::Dot, theme::curve(0), "flange", "Where the flange is");
        entry(ui, Mark::Cross, theme::curve(3), "desired", "Where the flange should be");
    }
}

fn entry(ui: &mut Ui, mark: Mark, colour: Color32, text: &str, hint: &str) {
    #[expect(clippy::cast_precision_loss, reason = "a handful of letters")]
    let size = vec2(22.0 + LETTER * text.len() as f32, 16.0);
    // A row that wraps asks for the size first.
    ui.allocate_ui_with_layout(size, Layout::left_to_right(Align::Center), |ui| {
        ui.spacing_mut().item_spacing.x = 4.0;
        let (response, painter) = ui.allocate_painter(vec2(18.0, 14.0), Sense::hover());
        let (centre, stroke) = (response.rect.center(), Stroke::new(2.5, colour));
        match mark {
            Mark::Arrow => painter.arrow(centre - vec2(8.0, 0.0), vec2(16.0, 0.0), stroke),
            Mark::Dot => {
                painter.circle_filled(centre, 5.0, colour);
            }
            Mark::Cross => {
                for arm in [vec2(6.0, 0.0), vec2(0.0, 6.0)] {
                    painter.line_segment([centre - arm, centre + arm], stroke);
                }
            }
        }
        ui.label(RichText::new(text).size(11.5)).on_hover_text(hint);
    });
}
