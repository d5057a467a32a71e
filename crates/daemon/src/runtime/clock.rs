//! Loop time.

use nix::sys::time::TimeSpec;
use nix::time::{ClockId, ClockNanosleepFlags, clock_gettime, clock_nanosleep};
use std::time::{Duration, Instant};

/// Loop time: CLOCK_MONOTONIC since the loop's start.
#[derive(Clone, Copy, Debug)]
pub struct Clock {
    start: Duration,
    instant: Instant,
}

impl Clock {
    /// Starts now.
    ///
    /// # Errors
    /// The operating system has no CLOCK_MONOTONIC.
    pub fn start() -> nix::Result<Self> {
        Ok(Self { start: monotonic()?, instant: Instant::now() })
    }

    /// Returns the start as an instant of the standard library.
    pub const fn instant(&self) -> Instant {
        self.instant
    }

    /// Loop time, ns.
    pub fn now_ns(&self) -> u64 {
        let now = monotonic().unwrap_or(self.start);
        u64::try_from(now.saturating_sub(self.start).as_nanos()).unwrap_or(u64::MAX)
    }

    /// Sleeps until an absolute deadline; a signal does not end the sleep. Returns the loop time of waking, ns.
    pub(crate) fn sleep_until(&self, deadline_ns: u64) -> u64 {
        let until = TimeSpec::from_duration(self.start + Duration::from_nanos(deadline_ns));
        while clock_nanosleep(ClockId::CLOCK_MONOTONIC, ClockNanosleepFlags::TIMER_ABSTIME, &until)
            == Err(nix::errno::Errno::EINTR)
        {}
        self.now_ns()
    }
}

fn monotonic() -> nix::Result<Duration> {
    clock_gettime(ClockId::CLOCK_MONOTONIC).map(Duration::from)
}
