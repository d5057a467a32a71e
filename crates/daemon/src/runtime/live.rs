//! The loop against the wall clock: the timer's, or that of a plant whose datagrams are the clock.

use crate::control::cover::CoverSource;
use crate::control::plant::Plant;
use crate::control::tick::{ControlLoop, Slot};
use crate::runtime::allocations;
use crate::runtime::tick_source::Pace;
use crate::runtime::timing::Stage;
use moca_msgs::{Outcome, Request, Sample};
use nix::sys::time::TimeSpec;
use nix::time::{ClockId, ClockNanosleepFlags, clock_gettime, clock_nanosleep};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::time::{Duration, Instant};

/// Ticks after which everything that allocates once has done so.
pub const WARM_UP_TICKS: u64 = 1000;

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

    /// The same start for the standard library's clock.
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

/// The loop's ends of the rings to its observers.
pub struct Rings {
    /// Samples out; a full ring drops the newest and counts it.
    pub samples: rtrb::Producer<Sample>,
    /// Requests in, each with the number its answer carries.
    pub requests: rtrb::Consumer<(u64, Request)>,
    /// Answers out.
    pub outcomes: rtrb::Producer<(u64, Outcome)>,
}

impl Rings {
    /// At most one request a tick.
    pub fn next_request(&mut self) -> (Option<u64>, Option<Request>) {
        self.requests.pop().ok().unzip()
    }

    /// Hands a sample, and the answer to a request, to whoever watches; waits for nobody.
    pub fn publish(&mut self, sample: &Sample, id: Option<u64>, outcome: Option<Outcome>, shared: &Shared) {
        if let (Some(id), Some(outcome)) = (id, outcome) {
            // A full ring means that nobody waits for answers any more.
            let _ = self.outcomes.push((id, outcome));
        }
        shared.moving.store(sample.mode.moves(), Ordering::Relaxed);
        if !self.samples.is_abandoned() && self.samples.push(sample.clone()).is_err() {
            shared.samples_dropped.fetch_add(1, Ordering::Relaxed);
        }
    }
}

/// Shared with other threads while the loop runs.
#[derive(Debug, Default)]
pub struct Shared {
    /// Set to end the loop after the current tick.
    pub stop: AtomicBool,
    /// Whether a law moves the robot.
    pub moving: Arc<AtomicBool>,
    /// Samples no observer had room for.
    pub samples_dropped: Arc<AtomicU64>,
}

/// What a finished loop leaves behind besides its parts.
#[derive(Clone, Copy, Debug, Default)]
pub struct LiveReport {
    /// Ticks run.
    pub ticks: u64,
    /// Missed slots.
    pub overruns: u64,
    /// Overruns by the stage that took longest in the tick before, in the order of [`Stage::ALL`].
    pub overruns_by_stage: [u64; 5],
    /// Rust allocations on the loop thread after warm-up; `None` if the run ended before.
    pub allocations_after_warm_up: Option<u64>,
}

/// Runs the loop on this thread until `shared.stop` is set or `duration` has passed.
pub fn run<P: Plant, S: CoverSource>(
    control: &mut ControlLoop<P, S>,
    clock: Clock,
    period_ns: u64,
    duration: Option<Duration>,
    rings: &mut Rings,
    shared: &Shared,
) -> LiveReport {
    let end_ns = duration.map_or(u64::MAX, |d| u64::try_from(d.as_nanos()).unwrap_or(u64::MAX));
    let mut pace = Pace::new(clock, period_ns);
    let mut report = LiveReport::default();
    let mut warm = None;
    while !shared.stop.load(Ordering::Relaxed) {
        let Some(woken) = pace.wait(&mut control.plant, end_ns) else { break };
        report.overruns += woken.missed;
        report.overruns_by_stage[woken.missed_by.unwrap_or(control.timing.slowest()) as usize] +=
            woken.missed;
        control.timing.lateness.record(woken.lateness);

        let (id, request) = rings.next_request();
        let slot = Slot {
            tick: woken.tick,
            now_ns: woken.now_ns,
            ticks: 1 + woken.missed,
            lateness_s: woken.lateness.as_secs_f64(),
            overruns: report.overruns,
            stages_ns: control.timing.last_stages_ns(),
        };
        let (sample, outcome) = control.tick(&slot, request);

        rings.publish(&sample, id, outcome, shared);
        control.timing.end(Stage::Publish);

        report.ticks += 1;
        if report.ticks == WARM_UP_TICKS {
            warm = Some(allocations::on_this_thread());
        }
    }
    control.brake();
    report.allocations_after_warm_up = warm.map(|warm| allocations::on_this_thread() - warm);
    report
}
