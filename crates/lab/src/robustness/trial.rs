//! One injected fault against the whole chain in lock-step: what the robot does about it, and how soon.

use anyhow::{Context, Result, ensure};
use moca_daemon::config::{Config, HandConfig};
use moca_daemon::control::tick::Ticked;
use moca_daemon::devices::simulated_robot::free_scene;
use moca_daemon::inject::{Disk, FaultSite, Injection, Named, Strike, client};
use moca_daemon::record::recording::Recording;
use moca_daemon::record::tick_log::{TickLog, TickLogReader, tick_log};
use moca_daemon::runtime::allocations;
use moca_daemon::runtime::clients::rings;
use moca_daemon::runtime::live::{Rings, Shared};
use moca_daemon::runtime::lockstep::LockStep;
use moca_msgs::{Fault, Mode, Outcome, Request, Sample};
use moca_sim::VirtualBoardConfig;
use moca_telemetry::RobotDescription;
use moca_telemetry::net::{self, Server};
use std::net::{Ipv4Addr, SocketAddr};
use std::sync::atomic::Ordering;

/// The hand presses from here on, so that the robot moves when the fault strikes, ticks.
const PRESS_TICK: u64 = 2000;
const STRIKE_TICK: u64 = 3000;
/// How long after its stop the robot has to stand, ticks.
const STAND_TICKS: u64 = 500;
const PRESSED_TAXEL: u8 = 5;
const PRESS_N: f64 = 20.0;

/// What became of one fault.
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
    /// What clients are sent or answered, where the fault is outside the loop.
    pub(crate) reported: Option<String>,
}

/// Who watches a trial: a log, telemetry, or nobody.
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
        let server = net::serve(
            &SocketAddr::from((Ipv4Addr::LOCALHOST, 0)).into(),
            0o600,
            description,
            ports.with(samples, None),
        )?;
        let address = server.address().tcp().context("a port")?;
        client(fault, address, strike.clone(), seed)?;
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

/// Runs `fault` with its bytes spoiled by `seed`, until `ticks` after its strike.
///
/// # Errors
/// The scene could not be built, or the robot did not move before the strike, which would show nothing.
pub(crate) fn run(fault: Named, seed: u64, ticks: u64) -> Result<Trial> {
    let end_tick = STRIKE_TICK + ticks;
    let mut config = Config::default();
    config.simulation.hand = HandConfig::none();
    config.simulation.seed = seed;
    let board = VirtualBoardConfig { seed, ..VirtualBoardConfig::default() };
    let mut world = LockStep::with_board(&config, &free_scene(&config), board, None)?;
    let at_ns = STRIKE_TICK * config.period_ns();
    world.inject(&Injection { fault, at_ns }, seed);
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
    };
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
    Ok(trial)
}

fn answered(outcome: Outcome) -> String {
    outcome.map_or_else(|refusal| format!("refused: {refusal:?}"), |()| "done".into())
}

fn speed(sample: &Sample) -> f64 {
    sample.base_velocity_world[0].hypot(sample.base_velocity_world[1])
}
