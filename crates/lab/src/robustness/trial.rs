//! One injected fault against the whole chain in lock-step: what the robot does about it, and how soon.

use anyhow::{Result, ensure};
use moca_control::config::Config;
use moca_control::tick::Ticked;
use moca_daemon::inject::{Disk, Strike, client};
use moca_daemon::record::recording::Recording;
use moca_daemon::record::tick_log::{TickLog, TickLogReader, tick_log};
use moca_daemon::runtime::allocations;
use moca_daemon::runtime::clients::rings;
use moca_daemon::runtime::live::{Rings, Shared};
use moca_experiments::unattended;
use moca_lockstep::LockStep;
use moca_lockstep::inject::{FaultSite, Injection, Named};
use moca_lockstep::simulated_robot::free_scene;
use moca_msgs::{Fault, Law, Mode, Outcome, Request, Sample};
use moca_sim::VirtualBoardConfig;
use moca_tactile::Firmware;
use moca_telemetry::RobotDescription;
use moca_telemetry::net::{self, Address, Server};
use std::hash::{DefaultHasher, Hash, Hasher};
use std::sync::atomic::{AtomicU64, Ordering};

/// Numbers the sockets of trials that run side by side.
static TRIALS: AtomicU64 = AtomicU64::new(0);

/// The hand presses from here on, so that the robot moves when the fault strikes, ticks.
const PRESS_TICK: u64 = 2000;
const STRIKE_TICK: u64 = 3000;
/// Time for which the robot has to stand after its stop, ticks.
const STAND_TICKS: u64 = 500;
/// Ticks between two samples in the digest.
const DIGEST_TICKS: u64 = 20;
const PRESSED_TAXEL: u8 = 5;
const PRESS_N: f64 = 20.0;

/// Result of one fault.
#[derive(Clone, Debug)]
pub(crate) struct Trial {
    /// The fault.
    pub(crate) fault: Named,
    /// Control periods from the strike to the stop; `None` if the robot went on.
    pub(crate) reaction_ticks: Option<u64>,
    /// Mode at the end.
    pub(crate) mode: Mode,
    /// Cause that was named first.
    pub(crate) cause: Option<Fault>,
    /// Largest base speed once the robot had time to stand, m/s; at the end if it never stopped.
    pub(crate) speed_after_m_s: f64,
    /// Way of the base from the strike to the end, m.
    pub(crate) way_m: f64,
    /// Frames rejected after the strike.
    pub(crate) frames_bad: u64,
    /// Missed slots after the strike.
    pub(crate) overruns: u64,
    /// Rust allocations on the loop's thread after the strike.
    pub(crate) allocations: u64,
    /// Message or answer to clients, where the fault is outside the loop.
    pub(crate) reported: Option<String>,
    /// Digest of the samples from the strike on: two runs that differ have two.
    pub(crate) digest: u64,
}

/// Observer of a trial: a log, telemetry, or none.
enum Watcher {
    Nobody,
    Log(Box<Recording>, TickLogReader),
    Telemetry(Box<Rings>, Server),
}

impl Watcher {
    fn new(site: FaultSite, config: &Config, strike: &Strike, seed: u64) -> Result<(Self, Option<TickLog>)> {
        let FaultSite::Outside(fault) = site else { return Ok((Self::Nobody, None)) };
        if fault.request().is_some() {
            return Ok((Self::Nobody, None));
        }
        let description = RobotDescription::paper("trial", true);
        if fault.is_of_disk() {
            let (log, _, reader) = tick_log();
            let disk = Disk::new(std::io::sink(), fault, strike.clone());
            let recording = Recording::start(disk, description, config, false)?;
            return Ok((Self::Log(Box::new(recording), reader), Some(log)));
        }
        let (rings, samples, ports) = rings(&Shared::default());
        let number = TRIALS.fetch_add(1, Ordering::Relaxed);
        let socket = std::env::temp_dir().join(format!("moca-trial-{}-{number}.sock", std::process::id()));
        let server = net::serve(&Address::Unix(socket), 0o600, description, ports.with(samples, None))?;
        client(fault, server.address(), strike.clone(), seed)?;
        Ok((Self::Telemetry(Box::new(rings), server), None))
    }

    /// Shows it one tick.
    fn see(&mut self, sample: &Sample, shared: &Shared) {
        match self {
            Self::Nobody => {}
            Self::Telemetry(rings, _) => rings.publish(sample, None, None, shared),
            Self::Log(recording, reader) => {
                while let Some(record) = reader.next_tick() {
                    recording.add_tick(&record);
                }
                recording.add(sample);
            }
        }
    }

    fn finish(self, dropped: u64) -> Option<String> {
        match self {
            Self::Nobody => None,
            Self::Log(recording, _) => Some(match recording.finish() {
                Ok(summary) => format!("{} samples are in the log", summary.samples),
                Err(error) => format!("{error:#}"),
            }),
            Self::Telemetry(_, server) => {
                let dropped = dropped + server.stats().client_dropped;
                Some(format!("{dropped} samples dropped for clients"))
            }
        }
    }
}

/// Runs `fault` with its bytes spoiled by `seed`, until `ticks` after its strike, on a virtual board with `firmware`.
///
/// # Errors
/// The scene could not be built, the fault cannot strike there, or the robot did not move before the strike, which would show
/// nothing.
pub(crate) fn run(fault: Named, firmware: Firmware, seed: u64, ticks: u64) -> Result<Trial> {
    let end_tick = STRIKE_TICK + ticks;
    let mut config = unattended(Law::Impedance);
    config.simulation.seed = seed;
    config.board.firmware = firmware;
    let board = VirtualBoardConfig { seed, firmware, ..VirtualBoardConfig::default() };
    let mut world = LockStep::with_board(&config, &free_scene(&config), board, None)?;
    let at_ns = STRIKE_TICK * config.period_ns();
    let injection = Injection { fault, at_ns };
    injection.check(&config).map_err(anyhow::Error::msg)?;
    world.inject(&injection, seed);
    let (strike, shared) = (Strike::new(at_ns), Shared::default());
    let (mut watcher, mut log) = Watcher::new(fault.site, &config, &strike, seed)?;
    let mut step = |world: &mut LockStep<_, _>, request| {
        world.tick(request);
        let Ticked { sample, input } = world.control.ticked();
        if let Some(log) = &mut log {
            log.push(*input, || world.control.state());
        }
        (sample.clone(), input.outcome)
    };

    let mut before = Sample::default();
    for tick in 0..STRIKE_TICK {
        let press = Request::PressTaxel { taxel: PRESSED_TAXEL, force_n: PRESS_N };
        before = step(&mut world, (tick == PRESS_TICK).then_some(press)).0;
        watcher.see(&before, &shared);
    }
    ensure!(
        before.mode == Mode::Impedance && speed(&before) > 0.01,
        "the robot did not move before the strike: {:?}, {:?}, {:.4} m/s",
        before.mode,
        before.fault,
        speed(&before)
    );

    let mut trial = Trial {
        fault,
        reaction_ticks: None,
        mode: before.mode,
        cause: None,
        speed_after_m_s: 0.0,
        way_m: 0.0,
        frames_bad: 0,
        overruns: 0,
        allocations: 0,
        reported: None,
        digest: 0,
    };
    let mut digest = DefaultHasher::new();
    let mut last = before.clone();
    let mut pose = before.base_pose_world;
    while last.tick < end_tick {
        let counted = allocations::on_this_thread();
        let (sample, outcome) = step(&mut world, None);
        trial.allocations += allocations::on_this_thread() - counted;
        strike.see(sample.time_ns);
        watcher.see(&sample, &shared);
        trial.reported = outcome.map(answered).or(trial.reported);
        last = sample;
        if last.tick.is_multiple_of(DIGEST_TICKS) {
            format!("{last:?}").hash(&mut digest);
        }
        if trial.reaction_ticks.is_none() && !last.mode.moves() {
            trial.reaction_ticks = Some(last.tick - STRIKE_TICK);
            trial.cause = last.fault;
        }
        let stands_from = trial.reaction_ticks.map(|ticks| STRIKE_TICK + ticks + STAND_TICKS);
        // The world itself, not the state that the fault may have spoiled.
        let [vx, vy, _] = world.control.plant.world.state().base_velocity_world;
        if stands_from.map_or(last.tick >= end_tick, |from| last.tick >= from) {
            trial.speed_after_m_s = trial.speed_after_m_s.max(vx.hypot(vy));
        }
        pose = world.control.plant.world.state().base_pose_world;
    }
    trial.reported = watcher.finish(shared.samples_dropped.load(Ordering::Relaxed)).or(trial.reported);
    trial.way_m = (pose[0] - before.base_pose_world[0]).hypot(pose[1] - before.base_pose_world[1]);
    trial.mode = last.mode;
    trial.frames_bad = last.frames_bad - before.frames_bad;
    trial.overruns = last.overruns - before.overruns;
    trial.digest = digest.finish();
    Ok(trial)
}

fn answered(outcome: Outcome) -> String {
    outcome.map_or_else(|refusal| format!("refused: {refusal:?}"), |()| "done".into())
}

fn speed(sample: &Sample) -> f64 {
    sample.base_velocity_world[0].hypot(sample.base_velocity_world[1])
}
