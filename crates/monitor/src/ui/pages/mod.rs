//! The pages in the middle of the window.

mod calibrate;
mod cover;
mod gripper;
mod jog;
mod loop_timing;
mod parameters;
mod plots;
mod robot_3d;

use super::{requests::PageRequests, row, theme, view::View};
use crate::logic::{model::Model, source::recording::Recording};
use egui::{RichText, Ui, Vec2};

/// Size of the button whose text changes, points.
const RECORD: Vec2 = Vec2::new(118.0, 0.0);

/// A page.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Page {
    /// The paper's plots.
    #[default]
    Plots,
    /// The robot in three dimensions.
    Robot3d,
    /// State of the gripper and requests to it.
    Gripper,
    /// Timing of loop and board.
    Loop,
    /// Parameters of the daemon.
    Parameters,
    /// Taxels and masks.
    Cover,
    /// Calibration of a taxel.
    Calibrate,
}

impl Page {
    /// In the order of their tabs.
    pub const ALL: [Self; 7] = [
        Self::Plots,
        Self::Robot3d,
        Self::Gripper,
        Self::Loop,
        Self::Parameters,
        Self::Cover,
        Self::Calibrate,
    ];

    /// Returns the label of its tab.
    pub fn name(self) -> &'static str {
        match self {
            Self::Plots => "Plots",
            Self::Robot3d => "3-D",
            Self::Gripper => "Gripper",
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
        pressed: &mut PageRequests,
    ) {
        ui.horizontal_wrapped(|ui| {
            for page in Self::ALL {
                // Left in front of another robot, the page says that this one has no gripper.
                if page == Self::Gripper && *self != page && model.gripper().is_none() {
                    continue;
                }
                if ui.selectable_label(*self == page, RichText::new(page.name()).size(15.0)).clicked() {
                    *self = page;
                }
            }
            ui.separator();
            if !model.recorded {
                let label = if recording.is_some() { "Stop recording" } else { "Record" };
                let hint = "Write every sample this window receives to an MCAP file. \
                            `mocad --record` also keeps the board's bytes.";
                let possible = recording.is_some() || model.latest.is_some();
                let button =
                    ui.add_enabled(possible, egui::Button::new(label).min_size(RECORD)).on_hover_text(hint);
                pressed.record = button.clicked();
            }
            if ui.button("Open log").on_hover_text("Show a recorded run beside the robots").clicked() {
                pressed.choose_log = true;
            }
            if let Some(recording) = recording {
                row::rest(ui, RichText::new(recording.progress()).color(theme::BAD));
            }
        });
    }

    /// Draws the page and notes what was pressed.
    pub(super) fn show(
        self,
        ui: &mut Ui,
        model: &Model,
        view: &mut View,
        now_s: f64,
        pressed: &mut PageRequests,
    ) {
        match self {
            Self::Plots => {
                plots::toolbar(ui, model, view, pressed);
                plots::show(ui, model, &model.panels, 2, view);
            }
            Self::Robot3d => {
                jog::show(ui, model, view, now_s, pressed);
                robot_3d::show(ui, model, view, now_s, pressed);
            }
            Self::Gripper => gripper::show(ui, model, view, now_s, pressed),
            Self::Loop => loop_timing::show(ui, model, view, pressed),
            Self::Parameters => parameters::show(ui, model, view, pressed),
            Self::Cover => cover::show(ui, model, now_s, pressed),
            Self::Calibrate => calibrate::show(ui, model, view, now_s, pressed),
        }
    }
}
