//! Notices of a run. The runtime neither formats nor prints: it hands notices to a [`Reporter`], and for a terminal
//! [`crate::cli::report`] puts them into words.

use crate::config::Config;
use crate::runtime::realtime;
use crate::runtime::timing::Timing;
use moca_msgs::Sample;
use moca_telemetry::log::LogSummary;
use moca_telemetry::log::records::ParameterChange;
use moca_telemetry::net::Address;
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::mpsc::{Receiver, SyncSender, sync_channel};
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
        /// Configuration of the simulated parts and of the scripted hand.
        config: &'a Config,
        /// Version of MuJoCo.
        mujoco: &'a str,
    },
    /// Port of the board.
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
    /// Request to the operating system, and its answer.
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
    /// Message of a driver of arm or base.
    Driver(&'a str),
    /// The log is complete.
    Recorded(&'a LogSummary),
    /// The run is over.
    Ended(&'a Summary<'a>),
}

/// Largest number of unread messages of drivers; they are read every 20 ms.
const WORDS_MAX: usize = 256;

/// Takes what the drivers of a robot say in words, from threads of their own: it goes to the terminal, to dashboards and into the
/// log. Never from the loop's thread.
#[derive(Clone, Debug)]
pub struct DriverWords {
    said: SyncSender<String>,
    dropped: Arc<AtomicU64>,
}

impl DriverWords {
    /// Both ends.
    pub(crate) fn channel() -> (Self, SaidByDrivers) {
        let (said, words) = sync_channel(WORDS_MAX);
        let dropped = Arc::<AtomicU64>::default();
        (Self { said, dropped: Arc::clone(&dropped) }, SaidByDrivers { words, dropped })
    }

    /// Says something; what finds no room is dropped and counted.
    pub fn say(&self, words: impl Into<String>) {
        if self.said.try_send(words.into()).is_err() {
            self.dropped.fetch_add(1, Ordering::Relaxed);
        }
    }
}

/// Unread messages of the drivers.
#[derive(Debug)]
pub(crate) struct SaidByDrivers {
    words: Receiver<String>,
    dropped: Arc<AtomicU64>,
}

impl SaidByDrivers {
    /// The next, oldest first; after them how many found no room.
    pub(crate) fn next(&self) -> Option<String> {
        let dropped = || Some(self.dropped.swap(0, Ordering::Relaxed)).filter(|dropped| *dropped > 0);
        let lost =
            |dropped| format!("the drivers said {dropped} sentences more than the {WORDS_MAX} that are kept");
        self.words.try_recv().ok().or_else(|| dropped().map(lost))
    }
}

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
    /// Durations of the stages.
    pub timing: &'a Timing,
    /// Its last sample.
    pub last: &'a Sample,
    /// Ticks run.
    pub ticks: u64,
    /// Missed slots by the stage they are charged to; `None` in lock-step.
    pub overruns_by_stage: Option<[u64; 5]>,
    /// Stops for a busy PC that a simulated robot has ended by itself.
    pub recoveries: u64,
    /// Rust allocations on the loop thread after warm-up.
    pub allocations: Option<u64>,
    /// Samples that clients had no room for.
    pub samples_dropped: u64,
    /// Wall time of the run.
    pub wall: Duration,
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn talkative_driver_is_bounded_and_drops_are_counted() {
        let (driver, said) = DriverWords::channel();
        for number in 0..WORDS_MAX + 7 {
            driver.say(number.to_string());
        }
        let heard: Vec<_> = std::iter::from_fn(|| said.next()).collect();
        assert_eq!(heard.len(), WORDS_MAX + 1);
        assert_eq!((heard[0].as_str(), heard[WORDS_MAX - 1].as_str()), ("0", &*(WORDS_MAX - 1).to_string()));
        assert!(heard[WORDS_MAX].contains("7 sentences more"), "{}", heard[WORDS_MAX]);
        driver.say("again");
        assert_eq!([said.next(), said.next()], [Some("again".into()), None]);
    }
}
