//! `mocad run`: puts the parts together, starts the loop, shows what runs.
#![expect(clippy::print_stdout, reason = "this module is what the user sees on the terminal")]

use crate::byte_cover::ByteCover;
use crate::calibrator::{self, Reference};
use crate::config::{Config, Parts, PlantKind, TAXELS};
use crate::console::{Console, Level, Summary};
use crate::contact_limits;
use crate::control_loop::ControlLoop;
use crate::cover_source::CoverSource;
use crate::flight::FlightRecorder;
use crate::gauge::Gauge;
use crate::inject::{self, Cable, Disk, Injection, Named, OutsideFault, Strike, What};
use crate::live::{self, Clock, LiveReport, Rings, Shared};
use crate::motion::Motion;
use crate::plant::{NoRobot, Plant};
use crate::protection::{self, Protection};
use crate::realtime;
use crate::recording::{Recording, parameter_change};
use crate::service::Heartbeat;
use crate::supervisor::{Automatic, Supervisor};
use crate::tape::{TapeReader, tape};
use crate::timing::{Distribution, Timing};
use anyhow::{Context, Result, anyhow};
use moca_msgs::{Law, Outcome, Request, Sample, robot};
use moca_tactile::serial::{PortSelection, SerialBoard};
use moca_tactile::{BoardEvent, Cover};
use moca_telemetry::description::ArmDescription;
use moca_telemetry::net::{self, CalibrationPort, Ports};
use moca_telemetry::{RobotDescription, net::Server};
use std::fs::File;
use std::net::SocketAddr;
use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::time::{Duration, Instant};

/// Samples a ring to observers holds: four seconds at 1 kHz.
const RING_SAMPLES: usize = 4096;
/// Requests and answers on their way.
const RING_REQUESTS: usize = 64;
/// Events on their way to the calibrator: over ten seconds of a Touch Board.
const RING_EVENTS: usize = 4096;
/// How often the terminal looks into its ring.
const LOOK_EVERY: Duration = Duration::from_millis(20);

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
    fn outside_fault(&self) -> Option<OutsideFault> {
        match self.inject?.fault.what {
            What::Outside(fault) => Some(fault),
            _ => None,
        }
    }

    fn strike(&self) -> Option<Strike> {
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
             this build has no simulation and runs a Touch Board alone: plant.kind = \"none\""
        )),
    }
}

/// The supervisor that the configuration asks for.
pub fn supervisor(config: &Config) -> Supervisor {
    let simulated = config.plant.kind == PlantKind::Simulated;
    let automatic = Automatic { tare: config.startup.tare, arm: config.startup.arm && simulated };
    let supervisor = Supervisor::new(config.startup.law, automatic);
    if config.plant.kind == PlantKind::None { supervisor.without_robot() } else { supervisor }
}

/// The controller and the protection that the configuration asks for.
///
/// # Errors
/// A parameter outside its range, every mistake in the file of contact limits.
pub fn motion(config: &Config) -> Result<Motion> {
    let parameters = config.parameters();
    let controller = moca_wbc::Controller::new(
        &robot::PANDA,
        &robot::MOCA_MOUNT,
        &robot::Payload::NONE,
        &robot::PAPER_COVER,
        &parameters,
    )?;
    let thresholds = &config.protection.thresholds;
    let limits =
        if thresholds.is_empty() { Default::default() } else { contact_limits::load(thresholds.as_ref())? };
    Ok(Motion::new(controller, parameters, Protection::new(config, limits), config.plant.parts))
}

/// The cover that the configuration asks for.
///
/// # Errors
/// The calibration file cannot be used.
pub fn cover_config(config: &Config) -> Result<moca_tactile::CoverConfig<TAXELS>> {
    config.cover().with_context(|| format!("board.calibration = {:?}", config.board.calibration))
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
    let (arm, mujoco) = (robot::PANDA.name, moca_sim::mujoco_version());
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

#[cfg(feature = "sim")]
fn board_config(config: &Config) -> moca_sim::VirtualBoardConfig {
    moca_sim::VirtualBoardConfig { seed: config.simulation.seed, ..Default::default() }
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
    let strike = options.strike();
    let recording = recording(options, strike.as_ref())?;
    let (tape, copies, tape_reader) = tape();
    let taps = Taps { copies: Some(copies), moving: Arc::clone(&shared.moving), reference: None };
    let mut robot = assemble(&options.config, clock, options.inject.as_ref(), taps)?;
    robot.control.tape = Some(tape);
    let virtual_board = if robot.virtual_board.is_some() { " (virtual Touch Board)" } else { "" };
    let calibration = robot.board.as_mut().and_then(|board| {
        println!("  board       {}{virtual_board}", shown(&board.port));
        board.calibration.take()
    });
    let flight = FlightRecorder::new(&options.config, description(&options.config))?;
    let observers = Observers { strike, recording, flight, tape: tape_reader };
    live(options, robot.control, clock, (observers, calibration), shared)
}

/// A simulated robot with everything that a live loop needs; the board and its reader end with it.
#[cfg(feature = "sim")]
pub(crate) struct Assembled {
    pub(crate) control: ControlLoop<crate::simulated::SimulatedRobot, Option<ByteCover>>,
    virtual_board: Option<moca_sim::PtyBoard>,
    board: Option<HeldBoard>,
}

#[cfg(feature = "sim")]
pub(crate) fn assemble(
    config: &Config,
    clock: Clock,
    injection: Option<&Injection>,
    mut taps: Taps,
) -> Result<Assembled> {
    use crate::simulated::{SimulatedRobot, free_scene};
    use moca_sim::PtyBoard;

    let (mut forces, mut virtual_board) = (None, None);
    let mut port = config.port_selection();
    if config.plant.parts.has_cover() && config.board.port == crate::config::VIRTUAL_PORT {
        let true_forces = moca_sim::SharedForces::default();
        let board =
            PtyBoard::spawn(board_config(config), Arc::clone(&true_forces), &PtyBoard::default_path())?;
        port = PortSelection::Path(board.path().display().to_string());
        (forces, virtual_board) = (Some(true_forces), Some(board));
    }
    taps.reference = forces.clone().map(|forces| {
        let force_n = move |taxel| Some(f64::from_bits(forces.get::<usize>(taxel)?.load(Ordering::Relaxed)));
        Reference::Simulated(Box::new(force_n))
    });
    let (cover, board) = if config.plant.parts.has_cover() {
        let open = open_board(config, clock, port, injection, taps)?;
        (Some(open.cover), Some(open.held))
    } else {
        (None, None)
    };
    let mut plant = SimulatedRobot::new(config, &free_scene(config), forces)?;
    if let Some(injection) = injection {
        plant.inject(injection);
    }
    let period_s = 1.0 / f64::from(config.control_loop.rate_hz);
    let control = ControlLoop::new(plant, cover, supervisor(config), motion(config)?, period_s)?;
    Ok(Assembled { control, virtual_board, board })
}

/// Who else gets what the board says, and what they need for it.
#[derive(Default)]
pub(crate) struct Taps {
    copies: Option<rtrb::Producer<BoardEvent>>,
    moving: Arc<AtomicBool>,
    reference: Option<Reference>,
}

/// What stands between a Touch Board's port and the loop.
struct OpenBoard {
    cover: ByteCover,
    held: HeldBoard,
}

/// The parts of it that only have to live as long as the loop.
pub(crate) struct HeldBoard {
    port: PortSelection,
    calibration: Option<CalibrationPort>,
    _threads: (calibrator::Calibrator, SerialBoard),
}

fn open_board(
    config: &Config,
    clock: Clock,
    port: PortSelection,
    injection: Option<&Injection>,
    Taps { copies, moving, mut reference }: Taps,
) -> Result<OpenBoard> {
    let (serial, mut events) = SerialBoard::spawn(port.clone(), clock.instant())?;
    if let Some(Injection { fault: Named { what: What::Cable(fault), .. }, at_ns }) = injection {
        events = inject::relay(Cable::new(*fault, *at_ns, config.simulation.seed), events, clock)?;
    }
    let cover_config = cover_config(config)?;
    let (to_calibrator, calibrator_events) = rtrb::RingBuffer::new(RING_EVENTS);
    let settings = calibrator::Settings {
        path: calibrator::file(config),
        board: config.board.name.clone(),
        wiring: cover_config.wiring,
    };
    if !config.board.gauge.is_empty() {
        let gauge = Gauge::open(&config.board.gauge, config.board.gauge_baud, clock.instant())?;
        reference = Some(Reference::Gauge(gauge));
    }
    let now_ns = move || clock.now_ns();
    let (calibrator, calibration) =
        calibrator::spawn(settings, calibrator_events, reference, moving, now_ns)?;
    let cover = ByteCover::new(Cover::new(cover_config)?, events, copies).with_calibrator(to_calibrator);
    let held = HeldBoard { port, calibration: Some(calibration), _threads: (calibrator, serial) };
    Ok(OpenBoard { cover, held })
}

/// Runs the loop with a Touch Board and no robot: what the cover feels, for observers and logs.
fn live_board_only(options: &Options, shared: &Arc<Shared>) -> Result<LiveRun> {
    let config = &options.config;
    println!("  plant       none: the cover alone, nothing moves");
    let clock = Clock::start()?;
    let strike = options.strike();
    let recording = recording(options, strike.as_ref())?;
    let (tape, copies, tape_reader) = tape();
    let port = config.port_selection();
    let taps = Taps { copies: Some(copies), ..Taps::default() };
    let OpenBoard { cover, mut held } = open_board(config, clock, port, options.inject.as_ref(), taps)?;
    println!("  board       {}", shown(&held.port));
    let period_s = 1.0 / f64::from(config.control_loop.rate_hz);
    let plant = NoRobot::at(config.control.gains.posture_rad);
    let mut control = ControlLoop::new(plant, cover, supervisor(config), motion(config)?, period_s)?;
    control.tape = Some(tape);
    let flight = FlightRecorder::new(config, description(config))?;
    let observers = Observers { strike, recording, flight, tape: tape_reader };
    live(options, control, clock, (observers, held.calibration.take()), shared)
}

fn shown(port: &PortSelection) -> String {
    match port {
        PortSelection::Path(path) => path.clone(),
        PortSelection::Usb(vendor, product) => format!("the port with USB id {vendor:04x}:{product:04x}"),
    }
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

/// The ends of the rings that belong to telemetry, besides the samples.
pub(crate) struct RequestPorts {
    requests: rtrb::Producer<(u64, Request)>,
    outcomes: rtrb::Consumer<(u64, Outcome)>,
    samples_dropped: Arc<AtomicU64>,
    calibration: Option<CalibrationPort>,
}

impl RequestPorts {
    /// All that telemetry serves.
    pub(crate) fn with(
        self,
        samples: rtrb::Consumer<Sample>,
        recorder: Option<rtrb::Producer<Sample>>,
    ) -> Ports {
        let Self { requests, outcomes, samples_dropped, calibration } = self;
        Ports { samples, requests, outcomes, ring_dropped: samples_dropped, recorder, calibration }
    }
}

pub(crate) fn rings(shared: &Shared) -> (Rings, rtrb::Consumer<Sample>, RequestPorts) {
    let (samples, from_loop) = rtrb::RingBuffer::new(RING_SAMPLES);
    let (request_in, requests) = rtrb::RingBuffer::new(RING_REQUESTS);
    let (outcomes, outcome_out) = rtrb::RingBuffer::new(RING_REQUESTS);
    let samples_dropped = Arc::clone(&shared.samples_dropped);
    let ports =
        RequestPorts { requests: request_in, outcomes: outcome_out, samples_dropped, calibration: None };
    (Rings { samples, requests, outcomes }, from_loop, ports)
}

fn serve(
    config: &Config,
    address: SocketAddr,
    samples: rtrb::Consumer<Sample>,
    recorder: Option<rtrb::Producer<Sample>>,
    ports: RequestPorts,
) -> Result<Server> {
    let server = net::serve(address, description(config), ports.with(samples, recorder)).with_context(|| {
        format!("telemetry.listen = \"{address}\" (if another mocad runs, choose another port, 0 for any, or \"\")")
    })?;
    println!("  telemetry   {} (dashboard: cargo run --release --bin moca-monitor)", server.address());
    Ok(server)
}

fn description(config: &Config) -> RobotDescription {
    let parameters = crate::parameters::describe(config);
    let robot = RobotDescription::new(
        &config.robot,
        config.plant.kind == PlantKind::Simulated,
        1.0 / f64::from(config.control_loop.rate_hz),
        &robot::SUMMIT_XL,
        &robot::MOCA_MOUNT,
        &robot::PANDA,
        &robot::PAPER_COVER,
        &config.parameters().limits,
        Duration::from_nanos(moca_tactile::board::SILENT_AFTER_NS).as_secs_f64(),
    );
    let speed_override = config.protection.override_statement.clone();
    let mut robot = RobotDescription { parameters, speed_override, ..robot };
    if !config.plant.parts.has_arm() {
        robot.arm = ArmDescription { name: "no arm".into(), ..ArmDescription::default() };
    }
    if !config.plant.parts.has_cover() {
        robot.taxels.clear();
    }
    robot
}

fn recording(options: &Options, strike: Option<&Strike>) -> Result<Option<Recording>> {
    let spoiled = options.outside_fault().filter(|fault| fault.is_of_disk());
    let Some(path) = &options.record else {
        return spoiled.map_or(Ok(None), |_| Err(anyhow!("a fault of the disk needs a log: --record FILE")));
    };
    let (config, live) = (&options.config, !options.lock_step);
    let recording = match spoiled.zip(strike) {
        None => Recording::create(path, description(config), config, live)?,
        Some((fault, strike)) => {
            let file = File::create_new(path).with_context(|| path.display().to_string())?;
            Recording::start(Disk::new(file, fault, strike.clone()), description(config), config, live)?
        }
    };
    println!("  record      {}", path.display());
    Ok(Some(recording))
}

/// Lets a telemetry client do the fault that the command line asks for, if it is one of those.
fn spoil_telemetry(options: &Options, server: Option<&Server>, strike: Option<&Strike>) -> Result<()> {
    let fault = options.outside_fault().filter(|fault| !fault.is_of_disk());
    let (Some(fault), Some(strike)) = (fault, strike) else { return Ok(()) };
    let server = server.context("a fault of telemetry needs telemetry.listen")?;
    Ok(inject::client(fault, server.address(), strike.clone(), options.config.simulation.seed)?)
}

/// Who takes what the loop notes of each tick.
struct Observers {
    strike: Option<Strike>,
    recording: Option<Recording>,
    flight: Option<FlightRecorder>,
    tape: TapeReader,
}

impl Observers {
    fn see(&mut self, sample: &Sample) {
        if let Some(strike) = &self.strike {
            strike.see(sample.time_ns);
        }
        self.take_ticks();
        if let Some(recording) = &mut self.recording {
            recording.add(sample);
        }
        if let Some(path) = self.flight.as_mut().and_then(|flight| flight.add(sample)) {
            println!("  the seconds before it: {}", path.display());
        }
    }

    /// Passes on what has been noted since the last call.
    fn take_ticks(&mut self) {
        while let Some(record) = self.tape.next_tick() {
            if let Some(change) = parameter_change(&record) {
                println!("[tick {}] parameter {} = {:?}", change.tick, change.name, change.values);
            }
            if let Some(recording) = &mut self.recording {
                recording.add_tick(&record);
            }
            if let Some(flight) = &mut self.flight {
                flight.add_tick(record);
            }
        }
    }
}

fn finish(recording: Option<Recording>, options: &Options) -> Result<()> {
    if let (Some(recording), Some(path)) = (recording, &options.record) {
        let summary = recording.finish().with_context(|| path.display().to_string())?;
        println!("recorded {} samples and {} bytes of the board", summary.samples, summary.serial_bytes);
        if summary.serial_dropped > 0 {
            println!(
                "  {} ticks or reads of the board found no room on their way to the disk",
                summary.serial_dropped
            );
        }
    }
    Ok(())
}

/// Shows samples on the terminal until `done` is set and the ring is empty; returns the last one.
fn watch(
    samples: &mut rtrb::Consumer<Sample>,
    observers: &mut Observers,
    log_level: Level,
    done: &AtomicBool,
) -> Sample {
    let (mut console, mut last) = (Console::new(log_level), Sample::default());
    let mut heartbeat = Heartbeat::new();
    loop {
        if !samples.is_empty() {
            heartbeat.beat();
        }
        let finished = done.load(Ordering::Acquire);
        while let Ok(sample) = samples.pop() {
            for line in console.lines(&sample) {
                println!("{line}");
            }
            observers.see(&sample);
            last = sample;
        }
        observers.take_ticks();
        if finished {
            return last;
        }
        std::thread::sleep(LOOK_EVERY);
    }
}

#[cfg(feature = "sim")]
fn lock_step(options: &Options, shared: &Arc<Shared>) -> Result<()> {
    use crate::lockstep::LockStep;

    let config = &options.config;
    introduce_simulation(config);
    let scene = crate::simulated::free_scene(config);
    let (tape, copies, tape_reader) = tape();
    if config.plant.parts.has_cover() {
        println!("  board       virtual Touch Board in memory");
        let mut world = LockStep::with_board(config, &scene, board_config(config), Some(copies))?;
        if let Some(injection) = &options.inject {
            world.inject(injection, config.simulation.seed);
        }
        run_lock_step(options, world, (tape, tape_reader), shared)
    } else {
        let mut world = LockStep::without_cover(config, &scene)?;
        if let Some(injection) = &options.inject {
            world.control.plant.inject(injection);
        }
        run_lock_step(options, world, (tape, tape_reader), shared)
    }
}

#[cfg(feature = "sim")]
fn run_lock_step<S: CoverSource, F: crate::lockstep::Feed<S>>(
    options: &Options,
    mut world: crate::lockstep::LockStep<S, F>,
    (tape, tape_reader): (crate::tape::Tape, TapeReader),
    shared: &Arc<Shared>,
) -> Result<()> {
    use crate::{allocations, command_log};
    use std::fs::File;
    use std::io::{BufWriter, Write};

    let config = &options.config;
    world.control.tape = Some(tape);
    let strike = options.strike();
    let recording = recording(options, strike.as_ref())?;
    let mut observers = Observers { strike, recording, flight: None, tape: tape_reader };
    let mut log = None;
    if let Some(path) = &options.command_log {
        let file = File::create(path).with_context(|| path.display().to_string())?;
        let mut writer = BufWriter::new(file);
        command_log::write_header(&mut writer)?;
        log = Some(writer);
    }
    let (mut rings, from_loop, request_ports) = rings(shared);
    let server = match config.telemetry_address() {
        Some(address) => Some(serve(config, address, from_loop, None, request_ports)?),
        None => None,
    };
    spoil_telemetry(options, server.as_ref(), observers.strike.as_ref())?;
    let (mut console, mut last, mut ticks) = (Console::new(options.log_level), Sample::default(), 0);
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
            command_log::write_row(log, &last)?;
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
