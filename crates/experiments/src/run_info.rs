//! Information about a run that every experiment prints.

use crate::closed_loop;
use crate::settings::{self, Settings};
use serde::Serialize;
use std::time::Instant;

/// Information that every experiment prints about its run.
#[derive(Clone, Debug, Serialize)]
pub struct RunInfo {
    /// Name of the experiment.
    pub experiment: &'static str,
    /// Name of the cover's sensor.
    pub sensor: &'static str,
    /// Name of the foam.
    pub foam: &'static str,
    /// Source of the wrench at the flange.
    pub flange: &'static str,
    /// Engine that integrated the scene, and the reason for it.
    pub engine: &'static str,
    /// Steps taken for the requested `accuracy`, of the reported phase; null for steps of one length.
    steps: Option<Steps>,
    /// Frames of the stock board, Hz; null without one.
    pub frame_rate_hz: Option<f64>,
    /// Why the robot stopped; null if it did not.
    pub stopped: Option<String>,
    /// Simulated time, starting included, s.
    pub sim_s: f64,
    /// Wall-clock time, s: of a collision the five phases together.
    pub wall_s: f64,
}

/// Cost of the chosen physics steps.
#[derive(Clone, Debug, Serialize)]
struct Steps {
    accuracy: f64,
    /// Steps a tick, those of the estimates included, and those whose result was kept.
    per_tick: f64,
    kept_per_tick: f64,
    /// Ticks in which the most steps that are tried were not enough.
    ticks_missed: u64,
}

impl Steps {
    fn of(settings: &Settings, rig: &closed_loop::Rig) -> Option<Self> {
        let spent = rig.steps_spent()?;
        #[expect(clippy::cast_precision_loss, reason = "counts of one run")]
        let per_tick = |steps: u64| steps as f64 / spent.periods.max(1) as f64;
        Some(Self {
            accuracy: settings.config.simulation.accuracy,
            per_tick: per_tick(spent.steps),
            kept_per_tick: per_tick(spent.kept),
            ticks_missed: spent.missed,
        })
    }

    fn text(&self) -> String {
        format!(
            "\n  accuracy {:.0e}: {:.2} physics steps a tick, {:.2} of them kept, {} ticks not within it",
            self.accuracy, self.per_tick, self.kept_per_tick, self.ticks_missed
        )
    }
}

impl RunInfo {
    /// Gathers it after the run that began at `started`.
    pub fn new(
        experiment: &'static str,
        settings: &Settings,
        rig: &closed_loop::Rig,
        started: Instant,
    ) -> Self {
        Self {
            experiment,
            sensor: settings.sensor.name(),
            foam: settings.foam.material.name,
            flange: settings.flange_source(),
            engine: settings.engine.reason(),
            steps: Steps::of(settings, rig),
            frame_rate_hz: (settings.sensor == settings::Sensor::Stock).then_some(rig.frame_rate_hz),
            stopped: rig.stopped.clone(),
            sim_s: rig.sim_s,
            wall_s: started.elapsed().as_secs_f64(),
        }
    }

    /// Lines that begin the text of an experiment.
    pub fn head(&self) -> String {
        let rate = self.frame_rate_hz.map_or(String::new(), |rate| format!(" at {rate:.1} frames/s"));
        let stopped = self.stopped.as_ref().map_or(String::new(), |why| format!("\n  STOPPED: {why}"));
        let steps = self.steps.as_ref().map_or(String::new(), Steps::text);
        format!(
            "{}: sensor {}{rate}, wrench at the flange {}, foam {}, {:.1} s simulated in {:.2} s\n  on {}{steps}{stopped}",
            self.experiment, self.sensor, self.flange, self.foam, self.sim_s, self.wall_s, self.engine
        )
    }
}

/// Text of a wrench: N, N, N·m.
pub fn wrench_text([fx, fy, mz]: &[f64; 3]) -> String {
    format!("({fx:8.3} N, {fy:8.3} N, {mz:8.3} N·m)")
}
