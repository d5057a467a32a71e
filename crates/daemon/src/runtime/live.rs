//! The loop against the wall clock: the timer's, or that of a plant whose datagrams are the clock.

use crate::control::cover::CoverSource;
use crate::control::loop_state::LoopState;
use crate::control::plant::Plant;
use crate::control::stage::{Stage, StageTimer};
use crate::control::tick::{ControlLoop, Ticked};
use crate::control::tick_input::{Slot, TickInput};
use crate::record::tick_log::TickLog;
use crate::runtime::allocations;
use crate::runtime::recovery::Recovery;
use crate::runtime::tick_source::TickSource;
use crate::runtime::timing::Timing;
use moca_msgs::{Outcome, Request, Sample};
use moca_telemetry::net::RequestReceiver;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::time::Duration;

/// Ticks after which everything that allocates once has done so.
pub const WARM_UP_TICKS: u64 = 1000;

/// The loop's ends of the rings to its clients.
pub struct Rings {
    /// Samples out; a full ring drops the newest and counts it.
    pub samples: rtrb::Producer<Sample>,
    /// Requests in, answers out.
    pub requests: RequestReceiver,
    /// Log of each tick's inputs, if somebody records it.
    pub tick_log: Option<TickLog>,
    /// Requests of a simulated robot's own.
    pub recovery: Recovery,
}

impl Rings {
    /// At most one request a tick; without a ticket the robot's own.
    pub fn next_request(&mut self) -> (Option<u64>, Option<Request>) {
        let (id, asked) = self.requests.take().unzip();
        (id, self.recovery.next(asked))
    }

    /// Notes what a tick was given, if somebody records it, and now and then what the loop remembers after it.
    pub fn note(&mut self, input: &TickInput, state: impl FnOnce() -> LoopState) {
        if let Some(tick_log) = &mut self.tick_log {
            tick_log.push(*input, state);
        }
    }

    /// Hands a sample, and the answer to a request, to whoever watches; waits for nobody.
    pub fn publish(&mut self, sample: &Sample, id: Option<u64>, outcome: Option<Outcome>, shared: &Shared) {
        if let (Some(id), Some(outcome)) = (id, outcome) {
            self.requests.answer(id, outcome);
        }
        self.recovery.see(sample);
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
    /// True while a law moves the robot.
    pub moving: Arc<AtomicBool>,
    /// Samples no client had room for.
    pub samples_dropped: Arc<AtomicU64>,
    /// A count that the clients' thread raises whenever it runs, at normal priority: while it is starved, so is the
    /// kernel's work for a port.
    pub pulse: Arc<AtomicU64>,
}

/// Results of a finished loop besides its parts.
#[derive(Clone, Copy, Debug, Default)]
pub struct LiveReport {
    /// Ticks run.
    pub ticks: u64,
    /// Missed slots.
    pub overruns: u64,
    /// Overruns by the stage that took longest in the tick before, in the order of [`Stage::ALL`].
    pub overruns_by_stage: [u64; 5],
    /// Stops for a busy PC that a simulated robot has ended by itself.
    pub recoveries: u64,
    /// Rust allocations on the loop thread after warm-up; `None` if the run ended before.
    pub allocations_after_warm_up: Option<u64>,
}

/// Orders the robot to brake when the loop ends, whichever way.
struct BrakeAtEnd<'a, P: Plant, S: CoverSource>(&'a mut ControlLoop<P, S>);

impl<P: Plant, S: CoverSource> Drop for BrakeAtEnd<'_, P, S> {
    fn drop(&mut self) {
        // A second panic while the first unwinds would end the process before its log is closed.
        let _ = catch_unwind(AssertUnwindSafe(|| self.0.brake()));
    }
}

/// Runs the loop on this thread until `shared.stop` is set or `duration` has passed.
pub fn run<P: Plant, S: CoverSource>(
    control: &mut ControlLoop<P, S>,
    ticks: &mut impl TickSource<P>,
    timing: &mut Timing,
    duration: Option<Duration>,
    rings: &mut Rings,
    shared: &Shared,
) -> LiveReport {
    let end_ns = duration.map_or(u64::MAX, |d| u64::try_from(d.as_nanos()).unwrap_or(u64::MAX));
    let mut report = LiveReport::default();
    let mut warm = None;
    let guard = BrakeAtEnd(control);
    let control = &mut *guard.0;
    while !shared.stop.load(Ordering::Relaxed) {
        let Some(tick) = ticks.wait(&mut control.plant, end_ns) else { break };
        report.overruns += tick.missed;
        report.overruns_by_stage[tick.missed_by.unwrap_or(timing.slowest()) as usize] += tick.missed;
        timing.lateness.record(tick.lateness);

        let (id, request) = rings.next_request();
        let slot = Slot {
            tick: tick.number,
            now_ns: tick.now_ns,
            ticks: 1 + tick.missed,
            lateness_s: tick.lateness.as_secs_f64(),
            overruns: report.overruns,
            stages_ns: timing.last_stages_ns(),
        };
        control.tick(&slot, request, timing);
        let Ticked { sample, input } = control.ticked();
        timing.count_frame_age(sample.frame_age_s);
        rings.note(input, || control.state());
        rings.publish(sample, id, input.outcome, shared);
        timing.end(Stage::Publish);

        report.ticks += 1;
        if report.ticks == WARM_UP_TICKS {
            warm = Some(allocations::on_this_thread());
        }
    }
    drop(guard);
    report.recoveries = rings.recovery.count();
    report.allocations_after_warm_up = warm.map(|warm| allocations::on_this_thread() - warm);
    report
}
