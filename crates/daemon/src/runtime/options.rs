//! What the command line asks of a run.

use crate::config::Config;
use crate::inject::{FaultSite, Injection, OutsideFault, Strike};
use std::path::PathBuf;
use std::time::Duration;

/// What the command line asks for.
#[derive(Clone, Debug, Default)]
pub struct Options {
    /// Checked configuration.
    pub config: Config,
    /// Robot time after which the run ends.
    pub duration: Option<Duration>,
    /// Lock-step instead of real time.
    pub lock_step: bool,
    /// Where the command log goes (lock-step only).
    pub command_log: Option<PathBuf>,
    /// Where the MCAP log goes.
    pub record: Option<PathBuf>,
    /// After how much robot time another log file begins.
    pub record_split: Option<Duration>,
    /// A fault on purpose (simulated robot only).
    pub inject: Option<Injection>,
    /// Whether the run ends before it starts if the operating system refuses a setting of `[realtime]`.
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
