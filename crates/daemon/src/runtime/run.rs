//! `mocad run`: puts the parts together, starts the loop, shows what runs.
#![expect(clippy::print_stdout, reason = "this module is what the user sees on the terminal")]

use crate::cli::report::{Level, Summary};
use crate::config::{AUTO_PORT, Config, Parts, PlantKind};
use crate::control::cover::CoverSource;
use crate::control::plant::{NoRobot, Plant};
use crate::control::protection;
use crate::control::tick::ControlLoop;
use crate::inject::{Injection, OutsideFault, Strike, What};
use crate::record::tick_log::tape;
use crate::runtime::assemble::{OpenBoard, Taps, motion, open_board, supervisor};
use crate::runtime::clients::{Observers, RING_SAMPLES, finish, rings, serve, spoil_telemetry, watch};
use crate::runtime::live::{self, Clock, LiveReport, Shared};
use crate::runtime::realtime;
use crate::runtime::timing::{Distribution, Timing};
use anyhow::{Context, Result, anyhow};
use moca_msgs::{Law, Sample};
use moca_telemetry::net::CalibrationPort;
use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

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
    /// A fault on purpose (simulated robot only).
    pub inject: Option<Injection>,
    /// How much the terminal shows of a run.
    pub log_level: Level,
    /// Whether a refused wish to the operating system ends the run before it starts.
    pub require_realtime: bool,
}

impl Options {
    pub(crate) fn outside_fault(&self) -> Option<OutsideFault> {
        match self.inject?.fault.what {
            What::Outside(fault) => Some(fault),
            _ => None,
        }
    }

    pub(crate) fn strike(&self) -> Option<Strike> {
        self.inject.map(|injection| Strike::new(injection.at_ns))
    }
}

/// `--require-realtime` was given and the operating system refused this many wishes.
#[derive(Debug)]
pub struct RealtimeRefused(pub usize);

impl std::fmt::Display for RealtimeRefused {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "--require-realtime: {} of the steps above failed", self.0)
    }
}

impl std::error::Error for RealtimeRefused {}

/// Runs the daemon until its duration is over or Ctrl-C.
///
/// # Errors
/// A part could not be built: the scene, the board's port, a log file.
pub fn run(options: &Options) -> Result<()> {
    check_injection(options)?;
    let shared = Arc::new(Shared::default());
    let on_signal = Arc::clone(&shared);
    ctrlc::set_handler(move || on_signal.stop.store(true, Ordering::Relaxed)).context("Ctrl-C handler")?;
    introduce(options);
    match (options.config.plant.kind, options.lock_step) {
        (PlantKind::None, true) => {
            Err(anyhow!("plant.kind = \"none\" runs live only: lock-step simulates its board"))
        }
        (PlantKind::None, false) => {
            live_board_only(options, &shared).map(|run| println!("{}", run.summary()))
        }
        #[cfg(feature = "sim")]
        (PlantKind::Simulated, true) => lock_step(options, &shared),
        #[cfg(feature = "sim")]
        (PlantKind::Simulated, false) => {
            live_simulated(options, &shared).map(|run| println!("{}", run.summary()))
        }
        #[cfg(not(feature = "sim"))]
        (PlantKind::Simulated, _) => Err(anyhow!(
            "plant.kind = \"simulated\" needs a build with the feature `sim` (cargo run --release); \
             this build has no simulation{}",
            if cfg!(feature = "board") { " and runs a Touch Board alone: plant.kind = \"none\"" } else { "" }
        )),
    }
}

/// A fault of a part that this run lacks would be no fault at all.
fn check_injection(options: &Options) -> Result<()> {
    let (Some(injection), plant) = (&options.inject, &options.config.plant) else { return Ok(()) };
    let name = injection.fault.name;
    match injection.fault.what {
        What::Cable(_) if !plant.parts.has_cover() => {
            Err(anyhow!("--inject {name}: plant.parts = \"arm\" has no cover and no cable to spoil"))
        }
        What::Plant(_) | What::MissedSlots(_) if plant.kind == PlantKind::None => {
            Err(anyhow!("--inject {name}: plant.kind = \"none\" has no robot that could fail"))
        }
        _ => Ok(()),
    }
}

fn introduce(options: &Options) {
    let config = &options.config;
    println!("mocad {}: robot {:?}", env!("CARGO_PKG_VERSION"), config.robot);
    let law = match (config.plant.parts, config.startup.law) {
        (Parts::Base, _) => "admittance of the base alone (the base gives way)",
        (Parts::Arm, _) => "Cartesian impedance of the arm alone (the flange keeps its place)",
        (Parts::Whole, Law::Impedance) => {
            "expanded Cartesian impedance (the flange keeps its place, the base gives way)"
        }
        (Parts::Whole, Law::FollowMe) => "expanded follow-me (base and arm follow the hand)",
    };
    let pace = if options.lock_step { "in lock-step, as fast as possible" } else { "live" };
    println!("  controller  {law}, {} Hz, {pace}", config.control_loop.rate_hz);
    if config.plant.parts.has_cover() {
        println!("  protection  {}", protection::introduction(config));
    }
}

#[cfg(feature = "sim")]
fn introduce_simulation(config: &Config) {
    let (arm, mujoco) = (config.arm().name, moca_sim::mujoco_version());
    let robot = match config.plant.parts {
        Parts::Whole => format!("{arm} on SUMMIT-XL"),
        Parts::Base => "SUMMIT-XL without an arm".into(),
        Parts::Arm => format!("{arm} on a stand, no cover"),
    };
    println!("  plant       simulated {robot} (MuJoCo {mujoco})");
    let hand = &config.simulation.hand;
    if config.plant.parts.has_cover() && !hand.taxels.is_empty() {
        let taxels: Vec<String> = hand.taxels.iter().map(|taxel| format!("T{taxel}")).collect();
        println!(
            "  hand        presses {} with {} N, every {} s",
            taxels.join(", "),
            hand.force_n,
            hand.every_s
        );
    }
}

/// A finished live run.
#[derive(Debug)]
pub struct LiveRun {
    /// How long the stages took.
    pub timing: Timing,
    /// Ticks, overruns, allocations.
    pub report: LiveReport,
    frame_age: Distribution,
    last: Sample,
    samples_dropped: u64,
    wall: Duration,
}

impl LiveRun {
    fn summary(&self) -> Summary<'_> {
        Summary {
            timing: &self.timing,
            frame_age: &self.frame_age,
            last: &self.last,
            ticks: self.report.ticks,
            overruns_by_stage: Some(self.report.overruns_by_stage),
            allocations: self.report.allocations_after_warm_up,
            samples_dropped: self.samples_dropped,
            wall: self.wall,
        }
    }
}

/// Runs the simulated robot against the wall clock until `shared.stop` is set or the duration is over.
///
/// # Errors
/// As for [`run`].
#[cfg(feature = "sim")]
pub fn live_simulated(options: &Options, shared: &Arc<Shared>) -> Result<LiveRun> {
    introduce_simulation(&options.config);
    let clock = Clock::start()?;
    let (tape, copies, tape_reader) = tape();
    let observers = Observers::new(options, tape_reader)?;
    let taps = Taps { copies: Some(copies), moving: Arc::clone(&shared.moving), reference: None };
    let mut robot =
        crate::runtime::assemble::assemble(&options.config, clock, options.inject.as_ref(), taps)?;
    robot.control.tape = Some(tape);
    let virtual_board = if robot.virtual_board.is_some() { " (virtual Touch Board)" } else { "" };
    let calibration = robot.board.as_mut().and_then(|board| {
        println!("  board       {}{virtual_board}", shown(&board.port));
        board.calibration.take()
    });
    live(options, robot.control, clock, (observers, calibration), shared)
}

/// Runs the loop with a Touch Board and no robot: what the cover feels, for observers and logs.
fn live_board_only(options: &Options, shared: &Arc<Shared>) -> Result<LiveRun> {
    let config = &options.config;
    println!("  plant       none: the cover alone, nothing moves");
    let clock = Clock::start()?;
    let (tape, copies, tape_reader) = tape();
    let observers = Observers::new(options, tape_reader)?;
    let port = config.board.port.clone();
    let taps = Taps { copies: Some(copies), ..Taps::default() };
    let OpenBoard { cover, mut held } = open_board(config, clock, port, options.inject.as_ref(), taps)?;
    println!("  board       {}", shown(&held.port));
    let period_s = 1.0 / f64::from(config.control_loop.rate_hz);
    let plant = NoRobot::at(config.control.gains.posture_rad);
    let mut control = ControlLoop::new(plant, cover, supervisor(config), motion(config)?, period_s)?;
    control.tape = Some(tape);
    live(options, control, clock, (observers, held.calibration.take()), shared)
}

fn shown(port: &str) -> &str {
    if port == AUTO_PORT { "the only Touch Board on USB" } else { port }
}

/// Runs a finished loop on a thread of its own and shows it on this one.
fn live<P: Plant + Send, S: CoverSource + Send>(
    options: &Options,
    mut control: ControlLoop<P, S>,
    clock: Clock,
    (mut observers, calibration): (Observers, Option<CalibrationPort>),
    shared: &Arc<Shared>,
) -> Result<LiveRun> {
    let config = &options.config;
    let (mut rings, from_loop, mut request_ports) = rings(shared);
    request_ports.calibration = calibration;
    let (tap, mut watched) = rtrb::RingBuffer::new(RING_SAMPLES);
    let server = match config.telemetry_address() {
        Some(address) => Some(serve(config, address, from_loop, Some(tap), request_ports)?),
        None => {
            watched = from_loop;
            None
        }
    };
    spoil_telemetry(options, server.as_ref(), observers.strike.as_ref())?;
    let done = AtomicBool::new(false);
    let started = Instant::now();
    let (report, last) = std::thread::scope(|scope| -> Result<(LiveReport, Sample)> {
        let control = &mut control;
        let done = &done;
        let (steps_sender, steps) = std::sync::mpsc::channel();
        let in_loop_thread = move || {
            let (steps, _held) = realtime::apply(&config.realtime());
            let refused = steps.iter().any(|step| step.result.is_err());
            let run = !(refused && options.require_realtime);
            // The receiver waits for exactly this.
            let _ = steps_sender.send(steps);
            let report = if run {
                live::run(control, clock, config.period_ns(), options.duration, &mut rings, shared)
            } else {
                LiveReport::default()
            };
            done.store(true, Ordering::Release);
            report
        };
        let thread =
            std::thread::Builder::new().name("control-loop".into()).spawn_scoped(scope, in_loop_thread)?;
        let refused = report_realtime(&steps.recv().unwrap_or_default());
        println!("Ctrl-C stops it.");
        let last = watch(&mut watched, &mut observers, options.log_level, done);
        let report = thread.join().map_err(|_| anyhow!("the loop's thread panicked"))?;
        if options.require_realtime && refused > 0 {
            return Err(RealtimeRefused(refused).into());
        }
        Ok((report, last))
    })?;
    finish(observers.recording, options)?;
    Ok(LiveRun {
        timing: control.timing,
        frame_age: control.frame_age,
        report,
        last,
        samples_dropped: shared.samples_dropped.load(Ordering::Relaxed),
        wall: started.elapsed(),
    })
}

fn report_realtime(steps: &[realtime::Step]) -> usize {
    for step in steps {
        match &step.result {
            Ok(()) => println!("  real time   {}: yes", step.what),
            Err(error) => println!("  real time   {}: no ({error})", step.what),
        }
    }
    steps.iter().filter(|step| step.result.is_err()).count()
}

#[cfg(feature = "sim")]
fn lock_step(options: &Options, shared: &Arc<Shared>) -> Result<()> {
    use crate::runtime::lockstep::LockStep;

    let config = &options.config;
    introduce_simulation(config);
    let scene = crate::devices::simulated_robot::free_scene(config);
    let (tape, copies, tape_reader) = tape();
    if config.plant.parts.has_cover() {
        println!("  board       virtual Touch Board in memory");
        let world = LockStep::with_board(
            config,
            &scene,
            crate::runtime::assemble::board_config(config),
            Some(copies),
        )?;
        run_lock_step(options, world, (tape, tape_reader), shared)
    } else {
        let world = LockStep::without_cover(config, &scene)?;
        run_lock_step(options, world, (tape, tape_reader), shared)
    }
}

#[cfg(feature = "sim")]
fn run_lock_step<S: CoverSource, F: crate::runtime::lockstep::Feed<S>>(
    options: &Options,
    mut world: crate::runtime::lockstep::LockStep<S, F>,
    (tape, tape_reader): (crate::record::tick_log::Tape, crate::record::tick_log::TapeReader),
    shared: &Arc<Shared>,
) -> Result<()> {
    use crate::record::command_csv;
    use crate::runtime::allocations;
    use std::fs::File;
    use std::io::{BufWriter, Write};

    let config = &options.config;
    world.control.tape = Some(tape);
    if let Some(injection) = &options.inject {
        world.inject(injection, config.simulation.seed);
    }
    let mut observers = Observers::new(options, tape_reader)?;
    let mut log = None;
    if let Some(path) = &options.command_log {
        let file = File::create(path).with_context(|| path.display().to_string())?;
        let mut writer = BufWriter::new(file);
        command_csv::write_header(&mut writer)?;
        log = Some(writer);
    }
    let (mut rings, from_loop, request_ports) = rings(shared);
    let server = match config.telemetry_address() {
        Some(address) => Some(serve(config, address, from_loop, None, request_ports)?),
        None => None,
    };
    spoil_telemetry(options, server.as_ref(), observers.strike.as_ref())?;
    let (mut console, mut last, mut ticks) =
        (crate::cli::report::Console::new(options.log_level), Sample::default(), 0);
    let (mut allocated, mut warm) = (0, false);
    let end_ns = options.duration.map_or(u64::MAX, |d| u64::try_from(d.as_nanos()).unwrap_or(u64::MAX));
    let started = Instant::now();
    while ticks * config.period_ns() < end_ns && !shared.stop.load(Ordering::Relaxed) {
        let before = allocations::on_this_thread();
        let (id, request) = rings.next_request();
        let (sample, outcome) = world.step(request);
        last = sample;
        rings.publish(&last, id, outcome, shared);
        ticks += 1;
        warm |= ticks > live::WARM_UP_TICKS;
        allocated += if warm { allocations::on_this_thread() - before } else { 0 };
        if let Some(log) = &mut log {
            command_csv::write_row(log, &last)?;
        }
        observers.see(&last);
        for line in console.lines(&last) {
            println!("{line}");
        }
    }
    if let Some(log) = &mut log {
        log.flush()?;
    }
    let summary = Summary {
        timing: &world.control.timing,
        frame_age: &world.control.frame_age,
        last: &last,
        ticks,
        overruns_by_stage: None,
        allocations: warm.then_some(allocated),
        samples_dropped: shared.samples_dropped.load(Ordering::Relaxed),
        wall: started.elapsed(),
    };
    println!("{summary}");
    finish(observers.recording, options)
}
