//! What a run has to say. The runtime neither formats nor prints: it hands notices to a [`Reporter`], and for a terminal
//! [`crate::cli::report`] puts them into words.

use crate::config::Config;
use crate::runtime::realtime;
use crate::runtime::timing::Timing;
use moca_msgs::Sample;
use moca_telemetry::log::LogSummary;
use moca_telemetry::log::records::ParameterChange;
use moca_telemetry::net::Address;
use std::path::Path;
use std::sync::mpsc::Sender;
use std::time::Duration;

/// One thing to say.
#[derive(Clone, Copy)]
pub enum Notice<'a> {
    /// The run begins.
    Begins {
        /// As it runs.
        config: &'a Config,
        /// As fast as possible instead of live.
        lock_step: bool,
    },
    /// There is no robot: the cover alone.
    NoRobot,
    /// The robot is simulated.
    Simulated {
        /// What of it there is, and what presses it.
        config: &'a Config,
        /// Version of MuJoCo.
        mujoco: &'a str,
    },
    /// Where the board is read.
    Board {
        /// Its port; `None` is a board in memory.
        port: Option<&'a str>,
        /// Not a real one.
        simulated: bool,
    },
    /// Telemetry listens.
    Telemetry(&'a Address),
    /// Everything is written to this file.
    Recording(&'a Path),
    /// What the operating system was asked for, and its answer.
    RealTime(&'a realtime::Step),
    /// The loop runs.
    Runs,
    /// One tick.
    Sample(&'a Sample),
    /// A parameter was changed.
    Parameter(&'a ParameterChange),
    /// The flight recorder writes the seconds before a fault.
    FaultLog(&'a Path),
    /// Something that somebody should look after, in words; the run goes on.
    Trouble(&'a str),
    /// What a driver of arm or base says.
    Driver(&'a str),
    /// The log is complete.
    Recorded(&'a LogSummary),
    /// The run is over.
    Ended(&'a Summary<'a>),
}

/// Takes what the drivers of a robot say in words, from threads of their own: it goes to the terminal, to dashboards and into the
/// log. Never from the loop's thread.
pub type DriverWords = Sender<String>;

/// Somebody who is told. It waits for nobody: what cannot be said at once is dropped and counted.
pub trait Reporter {
    /// Takes one notice.
    fn report(&mut self, notice: Notice<'_>);
}

/// Says nothing.
#[derive(Clone, Copy, Debug, Default)]
pub struct Silent;

impl Reporter for Silent {
    fn report(&mut self, _: Notice<'_>) {}
}

/// A run in one screen.
#[derive(Clone, Copy)]
pub struct Summary<'a> {
    /// How long the stages took.
    pub timing: &'a Timing,
    /// Its last sample.
    pub last: &'a Sample,
    /// Ticks run.
    pub ticks: u64,
    /// Missed slots by the stage they are charged to; `None` in lock-step.
    pub overruns_by_stage: Option<[u64; 5]>,
    /// Rust allocations on the loop thread after warm-up.
    pub allocations: Option<u64>,
    /// Samples that clients had no room for.
    pub samples_dropped: u64,
    /// Wall time of the run.
    pub wall: Duration,
}
