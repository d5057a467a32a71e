//! One robot or log, and how it is looked at.

use super::view::View;
use crate::logic::{
    model::{Freshness, Model},
    source::{Source, recording::Recording},
};
use moca_msgs::Mode;
use std::path::Path;

/// One robot or log.
pub(super) struct Tab {
    pub(super) source: Source,
    /// Where the daemon listens, or the file.
    pub(super) address: String,
    pub(super) model: Model,
    pub(super) view: View,
    pub(super) recording: Option<Recording>,
}

impl Tab {
    pub(super) fn new(source: Source, address: String) -> Self {
        let mut model = Model::default();
        model.recorded = matches!(source, Source::Log(_));
        Self { source, address, model, view: View::default(), recording: None }
    }

    /// What is written on its button: its name and, of a robot, its mode.
    pub(super) fn name(&self, now_s: f64) -> String {
        let name = &self.model.robot.name;
        let what = if name.is_empty() { &self.address } else { name };
        if self.model.recorded {
            return format!("log of {what}");
        }
        let state = match self.model.freshness(now_s) {
            Freshness::Live => self.model.live_mode(now_s).map_or("no samples", Mode::name),
            Freshness::Silent => "no samples",
            Freshness::Down(_) => "no daemon",
        };
        format!("{what}: {state}")
    }

    /// Takes in what is new.
    pub(super) fn update(&mut self, now_s: f64) {
        let update = self.source.poll(now_s);
        if let Some(recording) = &mut self.recording {
            update.samples.iter().for_each(|sample| recording.add(sample));
        }
        if self.recording.as_ref().is_some_and(|r| !r.is_writing()) {
            self.stop_recording();
        }
        self.model.take(update, now_s);
    }

    /// Starts a recording in `folder`, or ends the one that runs.
    pub(super) fn record(&mut self, folder: &Path) {
        if self.recording.is_some() {
            return self.stop_recording();
        }
        let now_ns = self.model.latest.as_ref().map_or(0, |s| s.time_ns);
        match Recording::start(folder, &self.model.robot, now_ns) {
            Ok(recording) => self.recording = Some(recording),
            Err(error) => self.view.note = Some(error.to_string()),
        }
    }

    fn stop_recording(&mut self) {
        if let Some(recording) = self.recording.take() {
            self.view.note = Some(recording.finish().unwrap_or_else(|error| error));
        }
    }
}
