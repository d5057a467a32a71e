//! One robot or log, and how it is looked at.

use super::{guard::Guard, top::TabName, view::View};
use crate::logic::{
    answers::Answer,
    model::{Freshness, Model},
    signals::panel::column_name,
    source::{
        Source,
        recording::{Recording, plain, utc_stamp_now},
    },
    tuning::changed_as_toml,
};
use moca_msgs::Mode;
use std::path::Path;

/// One robot or log.
pub(super) struct Tab {
    pub(super) source: Source,
    /// Address of the daemon, or the file.
    pub(super) address: String,
    pub(super) model: Model,
    pub(super) view: View,
    /// Parts that could not be drawn.
    pub(super) guard: Guard,
    pub(super) recording: Option<Recording>,
    answers: Vec<Answer>,
}

impl Tab {
    pub(super) fn new(source: Source, address: String) -> Self {
        let mut model = Model::default();
        model.recorded = matches!(source, Source::Log(_));
        Self {
            source,
            address,
            model,
            view: View::default(),
            guard: Guard::default(),
            recording: None,
            answers: Vec::new(),
        }
    }

    /// Returns the label of its button: its name and, of a robot, its mode.
    pub(super) fn name(&self, now_s: f64) -> TabName {
        let name = &self.model.robot.name;
        let what = if name.is_empty() { &self.address } else { name };
        let mode = self.model.live_mode(now_s);
        if self.model.recorded {
            let name = format!("log of {what}");
            return TabName { longest: name.clone(), name, mode };
        }
        let state = match self.model.freshness(now_s) {
            Freshness::Live => self.model.live_mode(now_s).map_or("no samples", Mode::name),
            Freshness::Silent => "no samples",
            Freshness::Down(_) => "no daemon",
        };
        let longest = format!("{what}: {}", Mode::ProtectiveStop.name());
        TabName { name: format!("{what}: {state}"), longest, mode }
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
            Err(error) => self.answers.push(Answer::bad(error.to_string())),
        }
    }

    fn stop_recording(&mut self) {
        if let Some(recording) = self.recording.take() {
            self.answers.push(recording.finish().into());
        }
    }

    /// Returns the answers since the last call.
    pub(super) fn take_answers(&mut self) -> Vec<Answer> {
        let mut answers = std::mem::take(&mut self.answers);
        answers.append(&mut self.model.take_answers());
        answers
    }

    /// Saves every sample of what the plots show as a table in `folder`, and says where, or why not.
    pub(super) fn export(&mut self, folder: &Path) {
        let answer = self.exported(folder);
        self.answers.push(answer.into());
    }

    fn exported(&self, folder: &Path) -> Result<String, String> {
        let (model, history) = (&self.model, self.view.history(&self.model));
        let newest_s = history.end_s().unwrap_or(0.0);
        let window_s = self.view.axis.window_s(newest_s);
        if history.count(window_s.clone()) == 0 {
            let (from, to) = (window_s.start, window_s.end);
            return Err(format!("Nothing is exported: there is no sample from {from:.3} to {to:.3} s."));
        }
        let table = history.csv(window_s.clone(), |signal| {
            column_name(model.panels.iter().chain(&model.timing_panels), signal)
        });
        save(&folder.join(format!("{}-{:.3}s.csv", plain(&model.robot.name), window_s.end)), &table)
    }

    /// Saves the parameters that differ from their defaults in `folder`, and says where, or why not.
    pub(super) fn save_parameters(&mut self, folder: &Path) {
        let saved = match changed_as_toml(&self.model.robot) {
            None => Err("Nothing is saved: every parameter has its default.".to_owned()),
            Some((text, count)) => {
                let name = format!("{}-{}.toml", plain(&self.model.robot.name), utc_stamp_now());
                save(&folder.join(name), &text).map(|saved| {
                    format!("{saved}: {count} values that differ from the defaults, for `mocad --config`")
                })
            }
        };
        self.answers.push(saved.into());
    }
}

fn save(path: &Path, text: &str) -> Result<String, String> {
    match std::fs::write(path, text) {
        Ok(()) => Ok(format!("saved {}", path.display())),
        Err(error) => Err(format!("cannot save {}: {error}", path.display())),
    }
}
