//! A part of the window whose drawing fails is left out and named; the others, and STOP, go on.

use super::theme;
use egui::{Label, RichText, Ui};
use std::any::Any;
use std::collections::BTreeMap;
use std::panic::{AssertUnwindSafe, catch_unwind};

/// The parts whose drawing has failed, each with its message.
#[derive(Debug, Default)]
pub(super) struct Guard(BTreeMap<&'static str, String>);

impl Guard {
    /// Draws `part`, or says that it cannot be drawn and why. A part that failed is drawn again when the user asks for it.
    pub(super) fn draw(&mut self, ui: &mut Ui, part: &'static str, draw: impl FnOnce(&mut Ui)) {
        if let Some(failure) = self.0.get(part) {
            if failed(ui, part, failure) {
                self.0.remove(part);
                ui.request_repaint();
            }
            return;
        }
        // What it leaves half done is what is shown, never what is asked of a robot.
        let drawn = catch_unwind(AssertUnwindSafe(|| {
            ui.scope(draw);
        }));
        if let Err(payload) = drawn {
            self.0.insert(part, message(payload.as_ref()));
            ui.request_repaint();
        }
    }
}

/// Says what has failed; returns whether it is to be tried again.
fn failed(ui: &mut Ui, part: &str, failure: &str) -> bool {
    let text = format!("{part} cannot be drawn: {failure}. STOP works. Please report this message.");
    ui.add(Label::new(RichText::new(text).color(theme::BAD)).wrap());
    ui.button(format!("Draw {part} again")).clicked()
}

/// Text of a panic.
fn message(payload: &(dyn Any + Send)) -> String {
    let text = payload.downcast_ref::<String>().map(String::as_str);
    let text = text.or_else(|| payload.downcast_ref::<&'static str>().copied());
    text.unwrap_or("an error without a message").to_owned()
}

#[cfg(test)]
mod tests {
    use super::*;
    use egui::{CentralPanel, Grid, Panel, ScrollArea};
    use egui_kittest::{Harness, kittest::Queryable};

    #[derive(Default)]
    struct Window {
        guard: Guard,
        works: bool,
        stops: u32,
    }

    fn draw(ui: &mut Ui, window: &mut Window) {
        Panel::top("top").show(ui, |ui| {
            if ui.button("STOP").clicked() {
                window.stops += 1;
            }
        });
        let Window { guard, works, .. } = window;
        Panel::left("left").show(ui, |ui| guard.draw(ui, "the robot", |ui| drop(ui.label("robot"))));
        CentralPanel::default().show(ui, |ui| {
            guard.draw(ui, "the page", |ui| {
                ScrollArea::both().show(ui, |ui| {
                    Grid::new("grid").show(ui, |ui| {
                        ui.label("one");
                        assert!(*works, "the bounds cross");
                        ui.label("two");
                    });
                });
            });
        });
    }

    #[test]
    fn a_page_that_panics_is_named_and_stop_goes_on() {
        let mut harness = Harness::builder().build_ui_state(draw, Window::default());
        for stops in 0..5 {
            harness.run_steps(2);
            assert_eq!(harness.state().stops, stops);
            assert!(harness.query_by_label("robot").is_some());
            assert!(
                harness
                    .query_by_label_contains("the page cannot be drawn: the bounds cross. STOP works")
                    .is_some()
            );
            harness.get_by_label("STOP").click();
        }
        harness.get_by_label("Draw the page again").click();
        harness.run_steps(4);
        assert!(harness.query_by_label_contains("cannot be drawn").is_some(), "it fails again");
        harness.state_mut().works = true;
        harness.get_by_label("Draw the page again").click();
        harness.run_steps(4);
        assert!(
            harness.query_by_label("two").is_some() && harness.query_by_label_contains("cannot").is_none()
        );
    }
}
