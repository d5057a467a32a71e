//! Options of a run on the command line.

use crate::config::Config;
use crate::inject::Strike;
use moca_lockstep::inject::{FaultSite, Injection, OutsideFault};
use std::path::PathBuf;
use std::time::Duration;

/// Options of a run.
#[derive(Clone, Debug, Default)]
pub struct Options {
    /// Checked configuration.
    pub config: Config,
    /// Robot time after which the run ends.
    pub duration: Option<Duration>,
    /// Lock-step instead of real time.
    pub lock_step: bool,
    /// File of the command log (lock-step only).
    pub command_log: Option<PathBuf>,
    /// File of the MCAP log.
    pub record: Option<PathBuf>,
    /// After how much robot time another log file begins.
    pub record_split: Option<Duration>,
    /// A fault on purpose (simulated robot only).
    pub inject: Option<Injection>,
    /// True if the run ends before it starts when the operating system refuses a setting of `[realtime]`.
    pub require_realtime: bool,
}

impl Options {
    pub(crate) fn outside_fault(&self) -> Option<OutsideFault> {
        match self.inject?.fault.site {
            FaultSite::Outside(fault) => Some(fault),
            _ => None,
        }
    }

    pub(crate) fn strike(&self) -> Option<Strike> {
        self.inject.map(|injection| Strike::new(injection.at_ns))
    }
}
