//! The pages in the middle of the window.

use super::{View, calibrate, cover, files::FilesAsked, parameters, plots, theme, timing};
use crate::logic::{Model, Recording};
use egui::{Align, Layout, RichText, Ui};
use moca_msgs::Request;
use moca_telemetry::calibration::CalibrationRequest;

/// A page.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Page {
    /// The paper's plots.
    #[default]
    Plots,
    /// How well loop and board keep time.
    Loop,
    /// Parameters of the daemon.
    Parameters,
    /// Taxels and masks.
    Cover,
    /// Calibration of a taxel.
    Calibrate,
}

/// What a page wants of the daemon.
#[derive(Default)]
pub(super) struct Asked {
    /// Of the loop.
    pub(super) requests: Vec<Request>,
    /// Of the calibrator.
    pub(super) calibrate: Option<CalibrationRequest>,
    /// A push of a simulated taxel (0 is T1), N.
    pub(super) push: Option<(u8, f64)>,
}

impl Page {
    /// In the order of their tabs.
    pub const ALL: [Self; 5] = [Self::Plots, Self::Loop, Self::Parameters, Self::Cover, Self::Calibrate];

    /// What is written on its tab.
    pub fn name(self) -> &'static str {
        match self {
            Self::Plots => "Plots",
            Self::Loop => "Loop",
            Self::Parameters => "Parameters",
            Self::Cover => "Cover",
            Self::Calibrate => "Calibrate",
        }
    }

    /// The page whose tab says `name`.
    pub fn named(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|page| page.name().eq_ignore_ascii_case(name))
    }

    /// Draws the tabs, and what is done with files.
    pub(super) fn tabs(
        &mut self,
        ui: &mut Ui,
        model: &Model,
        recording: Option<&Recording>,
        view: &View,
        asked: &mut FilesAsked,
    ) {
        ui.horizontal(|ui| {
            for page in Self::ALL {
                if ui.selectable_label(*self == page, RichText::new(page.name()).size(15.0)).clicked() {
                    *self = page;
                }
            }
            ui.with_layout(Layout::right_to_left(Align::Center), |ui| {
                if ui.button("Open log").on_hover_text("Show a recorded run beside the robots").clicked() {
                    asked.choose = true;
                }
                if !model.recorded {
                    let label = if recording.is_some() { "Stop recording" } else { "Record" };
                    let hint = "Write every sample this window receives to an MCAP file. \
                                `mocad --record` also keeps the board's bytes.";
                    let possible = recording.is_some() || model.latest.is_some();
                    let button = ui.add_enabled(possible, egui::Button::new(label)).on_hover_text(hint);
                    asked.record = button.clicked();
                }
                let (text, colour) = match (recording, &view.note) {
                    (Some(recording), _) => (recording.progress(), theme::BAD),
                    (None, Some(note)) => (note.clone(), ui.visuals().weak_text_color()),
                    (None, None) => return,
                };
                ui.add(egui::Label::new(RichText::new(text).color(colour)).truncate());
            });
        });
    }

    /// Draws the page and notes what is to be asked of the daemon.
    pub(super) fn show(self, ui: &mut Ui, model: &Model, view: &mut View, now_s: f64, asked: &mut Asked) {
        match self {
            Self::Plots => {
                plots::toolbar(ui, model, view);
                plots::show(ui, model, &model.panels, 2, view);
            }
            Self::Loop => timing::show(ui, model, view),
            Self::Parameters => parameters::show(ui, model, view, asked),
            Self::Cover => cover::show(ui, model, now_s, &mut asked.requests),
            Self::Calibrate => calibrate::show(ui, model, view, now_s, asked),
        }
    }
}
