//! Legend of the arrows and marks in the robot's pictures.

use crate::logic::model::Model;
use crate::ui::theme;
use egui::{Align, Color32, Layout, RichText, Sense, Shape, Stroke, Ui, vec2};

/// Width of a letter, points.
const LETTER: f32 = 5.6;

/// Mark of a thing.
#[derive(Clone, Copy)]
enum Mark {
    Arrow,
    /// Two heads: a moment about its line, as of a right-handed screw.
    DoubleArrow,
    Arc,
    Dot,
    Cross,
}

/// Draws each mark with its name; the moment on the flange is a mark of the picture `in_3d` only.
pub(in crate::ui) fn legend(ui: &mut Ui, model: &Model, in_3d: bool) {
    if !model.robot.has_robot() {
        return;
    }
    let of_cover = "as the cover feels it";
    entry(ui, Mark::Arrow, theme::WRENCH, "base force", &format!("Force on the base, N, {of_cover}"));
    entry(
        ui,
        Mark::Arc,
        theme::MOMENT,
        "base moment",
        &format!("Moment on the base about z, N·m, {of_cover}"),
    );
    if model.robot.has_arm() {
        entry(ui, Mark::Arrow, theme::FLANGE_WRENCH, "flange force", "Force on the flange, N");
        if in_3d {
            let hint =
                "Moment on the flange, N·m: the flange is turned about this line, clockwise seen along it";
            entry(ui, Mark::DoubleArrow, theme::FLANGE_MOMENT, "flange moment", hint);
        }
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
            Mark::DoubleArrow => {
                painter.arrow(centre - vec2(8.0, 0.0), vec2(16.0, 0.0), stroke);
                painter.arrow(centre - vec2(8.0, 0.0), vec2(10.0, 0.0), stroke);
            }
            Mark::Arc => {
                let at = |part: u8| {
                    let (sin, cos) = (f32::from(part) * 0.5 - 0.6).sin_cos();
                    centre + vec2(6.0 * cos, -6.0 * sin)
                };
                painter.add(Shape::line((0..=9).map(at).collect(), stroke));
                painter.arrow(at(9), at(9) - at(8), stroke);
            }
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
