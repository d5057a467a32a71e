//! Messages to a service manager: ready, the loop's heartbeat, the end. Does nothing where there is none.

use sd_notify::NotifyState;
use std::time::{Duration, Instant};

/// Feeds systemd's watchdog as long as the loop beats.
#[derive(Debug)]
pub struct Heartbeat {
    every: Option<Duration>,
    fed: Option<Instant>,
}

impl Heartbeat {
    /// Reads from the environment whether anybody listens.
    pub fn new() -> Self {
        // Half of the time-out, as sd_watchdog_enabled(3) asks for.
        Self { every: sd_notify::watchdog_enabled().map(|timeout| timeout / 2), fed: None }
    }

    /// The loop has ticked since the last call.
    pub fn beat(&mut self) {
        let now = Instant::now();
        match self.fed {
            None => tell(&[NotifyState::Ready, NotifyState::Watchdog]),
            Some(fed) if self.every.is_some_and(|every| now - fed >= every) => tell(&[NotifyState::Watchdog]),
            Some(_) => return,
        }
        self.fed = Some(now);
    }
}

impl Default for Heartbeat {
    fn default() -> Self {
        Self::new()
    }
}

impl Drop for Heartbeat {
    fn drop(&mut self) {
        tell(&[NotifyState::Stopping]);
    }
}

fn tell(state: &[NotifyState<'_>]) {
    // A service manager that went away cannot be told so.
    let _ = sd_notify::notify(state);
}
