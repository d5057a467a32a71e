//! Answers in the lower right corner, each in full.

use super::theme;
use crate::logic::answers::{Answer, Answers};
use egui::{Align2, Area, Context, Frame, Id, Label, Order, RichText, Stroke, vec2};

/// Widest text, points.
const WIDTH: f32 = 380.0;

/// Draws what is on the screen at `now_s`.
pub(super) fn show(ctx: &Context, answers: &mut Answers, now_s: f64) {
    let shown: Vec<Answer> = answers.at(now_s).cloned().collect();
    if shown.is_empty() {
        return;
    }
    let mut dismissed = None;
    let area = Area::new(Id::unique("answers")).order(Order::Foreground);
    area.anchor(Align2::RIGHT_BOTTOM, vec2(-12.0, -12.0)).show(ctx, |ui| {
        for (index, answer) in shown.iter().enumerate() {
            let colour = if answer.good { theme::GOOD } else { theme::BAD };
            Frame::popup(ui.style()).stroke(Stroke::new(2.0, colour)).show(ui, |ui| {
                ui.set_max_width(WIDTH);
                ui.horizontal_top(|ui| {
                    if ui.small_button("×").on_hover_text("Dismiss").clicked() {
                        dismissed = Some(index);
                    }
                    ui.add(Label::new(RichText::new(answer.text.as_str()).size(15.0)).wrap());
                });
            });
        }
    });
    if let Some(index) = dismissed {
        answers.dismiss(index);
    }
}
