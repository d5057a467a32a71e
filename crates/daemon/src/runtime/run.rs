//! `mocad run`: puts the parts together, starts the loop, reports what runs.

use crate::calibration::age;
#[cfg(feature = "sim")]
use crate::config::Config;
use crate::control::assemble::{motion, supervisor};
use crate::control::cover::CoverSource;
use crate::control::plant::{NoRobot, Plant};
use crate::control::tick::ControlLoop;
#[cfg(feature = "sim")]
use crate::record::tick_log::TickLogReader;
use crate::record::tick_log::{TickLog, tick_log};
use crate::robot::PlantKind;
use crate::runtime::assemble::{HeldBoard, OpenBoard, Subscribers, open_boards};
use crate::runtime::clients::{Clients, RING_SAMPLES, finish, rings, serve, spoil_telemetry, watch};
use crate::runtime::clock::Clock;
#[cfg(not(all(feature = "sim", feature = "fci", feature = "ros2")))]
use crate::runtime::drivers::check_build;
use crate::runtime::drivers::{Driven, driven};
use crate::runtime::live::{self, LiveReport, Shared};
use crate::runtime::notice::{DriverWords, Notice, Reporter, Summary};
use crate::runtime::options::Options;
use crate::runtime::panics::PanicWatch;
use crate::runtime::realtime;
use crate::runtime::recovery::Recovery;
use crate::runtime::tick_source::{TickSource, Timer};
use crate::runtime::timing::Timing;
use anyhow::{Context, Result, anyhow};
use moca_msgs::{Fault, Mode, Sample};
use moca_telemetry::net::{CalibrationPort, Server};
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant, SystemTime};

/// `--require-realtime` was given and the operating system refused this many settings.
#[derive(Debug)]
pub struct RealtimeRefused(pub usize);

impl std::fmt::Display for RealtimeRefused {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "--require-realtime: {} of the steps above failed", self.0)
    }
}

impl std::error::Error for RealtimeRefused {}

/// The robot was in a fault when the run ended: exit code 6.
#[derive(Debug)]
pub struct EndedInFault(pub Fault);

impl std::fmt::Display for EndedInFault {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "the run ended in a fault: {}", self.0)
    }
}

impl std::error::Error for EndedInFault {}

/// Reports the end of a run, and its fault if it has one.
fn end(summary: &Summary<'_>, reporter: &mut dyn Reporter) -> Result<()> {
    reporter.report(Notice::Ended(summary));
    let stopped = matches!(summary.last.mode, Mode::ProtectiveStop | Mode::Fault);
    summary.last.fault.filter(|_| stopped).map_or(Ok(()), |fault| Err(EndedInFault(fault).into()))
}

/// Runs the daemon until its duration is over or Ctrl-C.
///
/// # Errors
/// A part could not be built: the scene, the board's port, a log file; the disk refused the log; a thread panicked; the run
/// ended in a fault.
pub fn run(options: &Options, reporter: &mut dyn Reporter) -> Result<()> {
    options
        .inject
        .map_or(Ok(()), |injection| injection.check(&options.config))
        .map_err(|why| anyhow!(why))?;
    let shared = Arc::new(Shared::default());
    let signalled = Arc::new(AtomicBool::new(false));
    let (on_signal, told) = (Arc::clone(&shared), Arc::clone(&signalled));
    ctrlc::set_handler(move || {
        told.store(true, Ordering::Relaxed);
        on_signal.stop.store(true, Ordering::Relaxed);
    })
    .context("Ctrl-C handler")?;
    let options = &with_foam_of_its_age(options, reporter)?;
    reporter.report(Notice::Begins { config: &options.config, lock_step: options.lock_step });
    let panics = PanicWatch::start(&shared);
    let result = catch_unwind(AssertUnwindSafe(|| run_plant(options, &shared, reporter)));
    panics.seen()?;
    match result.unwrap_or_else(|_| Err(anyhow!("the run panicked"))) {
        // Whoever ends a stopped robot's program has seen that it is stopped.
        Err(error) if error.is::<EndedInFault>() && signalled.load(Ordering::Relaxed) => Ok(()),
        ended => ended,
    }
}

fn run_plant(options: &Options, shared: &Arc<Shared>, reporter: &mut dyn Reporter) -> Result<()> {
    match (options.config.plant.kind, options.lock_step) {
        (PlantKind::None, true) => {
            Err(anyhow!("plant.kind = \"none\" runs live only: lock-step simulates its board"))
        }
        (PlantKind::Robot, true) => {
            Err(anyhow!("plant.kind = \"robot\" runs live only: a real robot goes at its own pace"))
        }
        (PlantKind::Robot, false) => {
            let run = live_robot(options, shared, reporter)?;
            end(&run.summary(), reporter)
        }
        (PlantKind::None, false) => {
            let run = live_board_only(options, shared, reporter)?;
            end(&run.summary(), reporter)
        }
        #[cfg(feature = "sim")]
        (PlantKind::Simulated, true) => lock_step(options, shared, reporter),
        #[cfg(feature = "sim")]
        (PlantKind::Simulated, false) => {
            let run = live_simulated(options, shared, reporter)?;
            end(&run.summary(), reporter)
        }
        #[cfg(not(feature = "sim"))]
        (PlantKind::Simulated, _) => not_built(options).map(drop),
    }
}

#[cfg(feature = "sim")]
fn introduce_simulation(config: &Config, reporter: &mut dyn Reporter) {
    reporter.report(Notice::Simulated { config, mujoco: moca_sim::mujoco_version() });
}

/// A finished live run.
#[derive(Debug)]
pub struct LiveRun {
    /// Durations of the stages.
    pub timing: Timing,
    /// Ticks, overruns, allocations.
    pub report: LiveReport,
    last: Sample,
    samples_dropped: u64,
    wall: Duration,
}

impl LiveRun {
    fn summary(&self) -> Summary<'_> {
        Summary {
            timing: &self.timing,
            last: &self.last,
            ticks: self.report.ticks,
            overruns_by_stage: Some(self.report.overruns_by_stage),
            recoveries: self.report.recoveries,
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
pub fn live_simulated(
    options: &Options,
    shared: &Arc<Shared>,
    reporter: &mut dyn Reporter,
) -> Result<LiveRun> {
    anyhow::ensure!(
        options.config.simulation.accuracy <= 0.0,
        "simulation.accuracy = {}: a live loop takes steps of one length, for it has one period for each and a step that is \
         repeated until it is exact enough may take longer; add --as-fast-as-possible, or set it to 0",
        options.config.simulation.accuracy
    );
    introduce_simulation(&options.config, reporter);
    let clock = Clock::start()?;
    let (log, copies, log_reader) = tick_log();
    let clients = Clients::new(options, log_reader, reporter)?;
    let subscribers = Subscribers {
        copies: Some(copies),
        moving: Arc::clone(&shared.moving),
        pulses: vec![Arc::clone(&shared.pulse)],
        ..Subscribers::default()
    };
    let mut robot =
        crate::runtime::assemble::assemble(&options.config, clock, options.inject.as_ref(), subscribers)?;
    let simulated = options.config.board.port.are_simulated();
    let calibration = robot.board.as_mut().and_then(|board| {
        report_board(board, simulated, reporter);
        board.calibration.take()
    });
    live(options, robot.control, (clock, log), Timer::new, (clients, calibration), shared, reporter)
}

/// Runs a robot of the caller's until `shared.stop` is set or the duration is over, with telemetry, log and flight recorder
/// as `mocad` has them. `connect` is called once, after the process's memory is locked: what answers to a robot every
/// millisecond must not wait for pages. What its drivers have to say in words goes to the sender that it is given. `ticks`
/// is [`PlantTicks::new`](crate::runtime::tick_source::PlantTicks::new) for a plant whose datagrams are the loop's clock,
/// else [`Timer::new`]. The configuration says `plant.kind = "robot"`.
///
/// # Errors
/// As for [`run`], and what `connect` says.
pub fn with_plant<P: Plant + Send, T: TickSource<P>>(
    options: &Options,
    connect: impl FnOnce(&DriverWords) -> Result<P>,
    ticks: impl FnOnce(Clock, u64) -> T + Send,
    shared: &Arc<Shared>,
    reporter: &mut dyn Reporter,
) -> Result<LiveRun> {
    let options = with_locked_memory(&with_foam_of_its_age(options, reporter)?, reporter)?;
    let config = &options.config;
    let clock = Clock::start()?;
    let (log, copies, log_reader) = tick_log();
    let clients = Clients::new(&options, log_reader, reporter)?;
    let plant = connect(&clients.driver_words())?;
    let (mut cover, mut held, mut calibration) = (None, None, None);
    if config.plant.parts.has_cover() {
        let subscribers = Subscribers {
            copies: Some(copies),
            moving: Arc::clone(&shared.moving),
            pulses: vec![Arc::clone(&shared.pulse)],
            ..Subscribers::default()
        };
        let ports = config.board.port.to_vec();
        let mut open = open_boards(config, clock, ports, options.inject.as_ref(), subscribers)?;
        calibration = open.held.calibration.take();
        report_board(&open.held, false, reporter);
        (cover, held) = (Some(open.cover), Some(open.held));
    }
    let period_s = 1.0 / f64::from(config.control_loop.rate_hz);
    let control = ControlLoop::new(plant, cover, supervisor(config), motion(config)?, period_s);
    let run = live(&options, control, (clock, log), ticks, (clients, calibration), shared, reporter);
    drop(held);
    run
}

/// Takes the foam's credible stiffness from the age of its calibration, where the options leave it open, and says so.
fn with_foam_of_its_age(options: &Options, reporter: &mut dyn Reporter) -> Result<Options> {
    let mut options = options.clone();
    if let Some(aged) = age::settle(&mut options.config, SystemTime::now())? {
        reporter.report(Notice::Trouble(&aged));
    }
    Ok(options)
}

/// Locks the process's memory, if that is wished for and not done; the options say so no more.
fn with_locked_memory(options: &Options, reporter: &mut dyn Reporter) -> Result<Options> {
    let mut options = options.clone();
    if let Some(step) = realtime::lock_memory(&options.config.realtime) {
        reporter.report(Notice::RealTime(&step));
        if options.require_realtime && step.result.is_err() {
            return Err(RealtimeRefused(1).into());
        }
        options.config.realtime.lock_memory = false;
    }
    Ok(options)
}

/// Runs the real robot that the configuration names.
fn live_robot(options: &Options, shared: &Arc<Shared>, reporter: &mut dyn Reporter) -> Result<LiveRun> {
    match driven(&options.config)? {
        Driven::Arm => live_fci(options, shared, reporter),
        Driven::Whole => live_whole(options, shared, reporter),
        Driven::SimulatedArm => live_simulated_arm(options, shared, reporter),
        Driven::Base => live_base(options, shared, reporter),
    }
}

/// The answer of a build that has no such driver.
#[cfg(not(all(feature = "sim", feature = "fci", feature = "ros2")))]
fn not_built(options: &Options) -> Result<LiveRun> {
    check_build(&options.config)?;
    Err(anyhow!("this build has no such driver"))
}

/// Returns the function with which a driver reports a message.
#[cfg(any(feature = "fci", feature = "ros2"))]
fn saying(words: &DriverWords, part: &'static str) -> impl FnMut(&str) + Send + 'static {
    let words = words.clone();
    move |text| words.say(format!("{part}: {text}"))
}

/// No arm on a base behind ROS 2.
#[cfg(feature = "ros2")]
fn live_base(options: &Options, shared: &Arc<Shared>, reporter: &mut dyn Reporter) -> Result<LiveRun> {
    use crate::devices::ros2_base::{OnRos2Base, connect};
    let no_arm = NoRobot::at(options.config.control.gains.posture_rad);
    let connect =
        |words: &DriverWords| Ok(OnRos2Base::new(no_arm, connect(&options.config, saying(words, "base"))?));
    with_plant(options, connect, Timer::new, shared, reporter)
}

#[cfg(all(feature = "fci", feature = "ros2"))]
fn live_whole(options: &Options, shared: &Arc<Shared>, reporter: &mut dyn Reporter) -> Result<LiveRun> {
    use crate::devices::franka_arm::{FrankaArm, ask_for_payload};
    use crate::devices::gripper::WithGripper;
    use crate::devices::ros2_base::{OnRos2Base, connect};
    // Asking is a first connection: it has to find the memory locked.
    let options = &mut with_locked_memory(options, reporter)?;
    ask_for_payload(&mut options.config)?;
    let connect = |words: &DriverWords| {
        let arm = FrankaArm::connect(&options.config, saying(words, "arm"))?;
        let arm = WithGripper::new(arm, hand(&options.config, words)?);
        Ok(OnRos2Base::new(arm, connect(&options.config, saying(words, "base"))?))
    };
    with_plant(options, connect, crate::runtime::tick_source::PlantTicks::new, shared, reporter)
}

/// A simulated arm on a base behind ROS 2. It feels nothing of how its base moves.
#[cfg(all(feature = "sim", feature = "ros2"))]
fn live_simulated_arm(
    options: &Options,
    shared: &Arc<Shared>,
    reporter: &mut dyn Reporter,
) -> Result<LiveRun> {
    use crate::config::{HandConfig, SimulationConfig};
    use crate::devices::ros2_base::{OnRos2Base, connect};
    use moca_lockstep::simulated_robot::{SimulatedRobot, free_scene};
    // Whoever presses does so on the real cover.
    let config = Config {
        simulation: SimulationConfig { hand: HandConfig::none(), ..options.config.simulation.clone() },
        ..options.config.clone()
    };
    let connect = |words: &DriverWords| {
        let arm = SimulatedRobot::new(&config, &free_scene(&config), Vec::new())?;
        saying(words, "arm")(&format!("simulated by MuJoCo {}", moca_sim::mujoco_version()));
        Ok(OnRos2Base::new(arm, connect(&options.config, saying(words, "base"))?))
    };
    with_plant(options, connect, Timer::new, shared, reporter)
}

#[cfg(not(all(feature = "sim", feature = "ros2")))]
fn live_simulated_arm(options: &Options, _: &Arc<Shared>, _: &mut dyn Reporter) -> Result<LiveRun> {
    not_built(options)
}

#[cfg(not(feature = "ros2"))]
fn live_base(options: &Options, _: &Arc<Shared>, _: &mut dyn Reporter) -> Result<LiveRun> {
    not_built(options)
}

#[cfg(not(all(feature = "fci", feature = "ros2")))]
fn live_whole(options: &Options, _: &Arc<Shared>, _: &mut dyn Reporter) -> Result<LiveRun> {
    not_built(options)
}

#[cfg(not(feature = "fci"))]
fn live_fci(options: &Options, _: &Arc<Shared>, _: &mut dyn Reporter) -> Result<LiveRun> {
    not_built(options)
}

/// Returns the hand of the configured arm, if there is one.
#[cfg(feature = "fci")]
fn hand(
    config: &crate::config::Config,
    words: &DriverWords,
) -> Result<Option<crate::devices::gripper::GripperThread>> {
    crate::devices::franka_hand::connect(config, saying(words, "gripper"))
}

#[cfg(feature = "fci")]
fn live_fci(options: &Options, shared: &Arc<Shared>, reporter: &mut dyn Reporter) -> Result<LiveRun> {
    use crate::devices::franka_arm::{FrankaArm, ask_for_payload};
    use crate::devices::gripper::WithGripper;
    // As in `live_whole`.
    let options = &mut with_locked_memory(options, reporter)?;
    ask_for_payload(&mut options.config)?;
    let connect = |words: &DriverWords| {
        let arm = FrankaArm::connect(&options.config, saying(words, "arm"))?;
        Ok(WithGripper::new(arm, hand(&options.config, words)?))
    };
    with_plant(options, connect, crate::runtime::tick_source::PlantTicks::new, shared, reporter)
}

fn report_board(board: &HeldBoard, simulated: bool, reporter: &mut dyn Reporter) {
    reporter.report(Notice::Board { port: Some(&board.ports), simulated });
    if let Some(step) = &board.priority {
        reporter.report(Notice::RealTime(step));
    }
}

/// Runs the loop with a Touch Board and no robot: what the cover feels, for clients and logs.
fn live_board_only(options: &Options, shared: &Arc<Shared>, reporter: &mut dyn Reporter) -> Result<LiveRun> {
    let config = &options.config;
    reporter.report(Notice::NoRobot);
    let clock = Clock::start()?;
    let (log, copies, log_reader) = tick_log();
    let clients = Clients::new(options, log_reader, reporter)?;
    let ports = config.board.port.to_vec();
    let pulses = vec![Arc::clone(&shared.pulse)];
    let subscribers = Subscribers { copies: Some(copies), pulses, ..Subscribers::default() };
    let OpenBoard { cover, mut held } =
        open_boards(config, clock, ports, options.inject.as_ref(), subscribers)?;
    report_board(&held, false, reporter);
    let period_s = 1.0 / f64::from(config.control_loop.rate_hz);
    let plant = NoRobot::at(config.control.gains.posture_rad);
    let control = ControlLoop::new(plant, cover, supervisor(config), motion(config)?, period_s);
    live(options, control, (clock, log), Timer::new, (clients, held.calibration.take()), shared, reporter)
}

/// Tells the thread that watches when the loop has ended, whichever way.
struct DoneAtEnd<'a>(&'a AtomicBool);

impl Drop for DoneAtEnd<'_> {
    fn drop(&mut self) {
        self.0.store(true, Ordering::Release);
    }
}

/// Runs a finished loop on a thread of its own and passes on from this one what it says. The log is closed however it
/// ends.
fn live<P: Plant + Send, S: CoverSource + Send, T: TickSource<P>>(
    options: &Options,
    mut control: ControlLoop<P, S>,
    (clock, log): (Clock, TickLog),
    ticks: impl FnOnce(Clock, u64) -> T + Send,
    (mut clients, calibration): (Clients, Option<CalibrationPort>),
    shared: &Arc<Shared>,
    reporter: &mut dyn Reporter,
) -> Result<LiveRun> {
    let config = &options.config;
    let (mut rings, from_loop, mut request_ports) = rings(shared);
    (request_ports.calibration, request_ports.audit) = (calibration, Some(clients.audit()));
    rings.tick_log = Some(log);
    rings.recovery = Recovery::of(config);
    let mut timing = Timing::new()?;
    let (tap, mut watched) = rtrb::RingBuffer::new(RING_SAMPLES);
    let server = match config.telemetry_address() {
        Some(address) => Some(serve(config, &address, from_loop, Some(tap), request_ports, reporter)?),
        None => {
            watched = from_loop;
            None
        }
    };
    clients.notices = server.as_ref().map(Server::notices);
    spoil_telemetry(options, server.as_ref(), clients.strike.as_ref())?;
    let done = AtomicBool::new(false);
    let started = Instant::now();
    let ended = std::thread::scope(|scope| -> Result<(LiveReport, Sample)> {
        let (control, timing) = (&mut control, &mut timing);
        let done = &done;
        let (steps_sender, steps) = std::sync::mpsc::channel();
        let in_loop_thread = move || {
            let _done = DoneAtEnd(done);
            let (steps, _held) = realtime::apply(&config.realtime);
            let refused = steps.iter().any(|step| step.result.is_err());
            let run = !(refused && options.require_realtime);
            // The receiver waits for exactly this.
            let _ = steps_sender.send(steps);
            if run {
                let mut ticks = ticks(clock, config.period_ns());
                live::run(control, &mut ticks, timing, options.duration, &mut rings, shared)
            } else {
                LiveReport::default()
            }
        };
        let thread =
            std::thread::Builder::new().name("control-loop".into()).spawn_scoped(scope, in_loop_thread)?;
        let watched = catch_unwind(AssertUnwindSafe(|| {
            let refused = report_realtime(&steps.recv().unwrap_or_default(), reporter);
            reporter.report(Notice::Runs);
            (refused, watch(&mut watched, &mut clients, reporter, (done, &shared.pulse)))
        }));
        if watched.is_err() {
            shared.stop.store(true, Ordering::Relaxed);
        }
        let report = thread.join().map_err(|_| anyhow!("the loop's thread panicked"))?;
        let (refused, last) = watched.map_err(|_| anyhow!("the thread of the clients panicked"))?;
        if options.require_realtime && refused > 0 {
            return Err(RealtimeRefused(refused).into());
        }
        Ok((report, last))
    });
    // Its last lines belong into the log.
    drop(server);
    clients.take_asked();
    let closed = finish(clients.recording, options, reporter);
    let (report, last) = ended?;
    closed?;
    Ok(LiveRun {
        timing,
        report,
        last,
        samples_dropped: shared.samples_dropped.load(Ordering::Relaxed),
        wall: started.elapsed(),
    })
}

fn report_realtime(steps: &[realtime::Step], reporter: &mut dyn Reporter) -> usize {
    for step in steps {
        reporter.report(Notice::RealTime(step));
    }
    steps.iter().filter(|step| step.result.is_err()).count()
}

#[cfg(feature = "sim")]
fn lock_step(options: &Options, shared: &Arc<Shared>, reporter: &mut dyn Reporter) -> Result<()> {
    use moca_lockstep::LockStep;

    let config = &options.config;
    introduce_simulation(config, reporter);
    let scene = moca_lockstep::simulated_robot::free_scene(config);
    let (log, copies, log_reader) = tick_log();
    if let Some(program) = config.board.port.firmware_program() {
        let world = LockStep::with_firmware(config, &scene, &program, Some(copies))?;
        reporter.report(Notice::Board { port: Some(&config.board.port.to_string()), simulated: true });
        run_lock_step(options, world, (log, log_reader), shared, reporter)
    } else if config.plant.parts.has_cover() {
        reporter.report(Notice::Board { port: None, simulated: true });
        let world = LockStep::with_board(
            config,
            &scene,
            moca_lockstep::virtual_boards::board_config(config),
            Some(copies),
        )?;
        run_lock_step(options, world, (log, log_reader), shared, reporter)
    } else {
        let world = LockStep::without_cover(config, &scene)?;
        run_lock_step(options, world, (log, log_reader), shared, reporter)
    }
}

#[cfg(feature = "sim")]
fn run_lock_step<S: CoverSource, F: moca_lockstep::Feed<S>>(
    options: &Options,
    mut world: moca_lockstep::LockStep<S, F>,
    (tick_log, log_reader): (TickLog, TickLogReader),
    shared: &Arc<Shared>,
    reporter: &mut dyn Reporter,
) -> Result<()> {
    use crate::control::tick::Ticked;
    use crate::record::command_csv;
    use crate::runtime::allocations;
    use std::fs::File;
    use std::io::{BufWriter, Write};

    let config = &options.config;
    if let Some(injection) = &options.inject {
        world.inject(injection, config.simulation.seed);
    }
    let mut clients = Clients::new(options, log_reader, reporter)?;
    let mut log = None;
    if let Some(path) = &options.command_log {
        let file = File::create(path).with_context(|| path.display().to_string())?;
        let mut writer = BufWriter::new(file);
        command_csv::write_header(&mut writer)?;
        log = Some(writer);
    }
    let (mut rings, from_loop, mut request_ports) = rings(shared);
    request_ports.audit = Some(clients.audit());
    rings.tick_log = Some(tick_log);
    let server = match config.telemetry_address() {
        Some(address) => Some(serve(config, &address, from_loop, None, request_ports, reporter)?),
        None => None,
    };
    clients.notices = server.as_ref().map(Server::notices);
    spoil_telemetry(options, server.as_ref(), clients.strike.as_ref())?;
    let (mut last, mut ticks) = (Sample::default(), 0);
    let (mut timing, mut allocated, mut warm) = (Timing::new()?, 0, false);
    let end_ns = options.duration.map_or(u64::MAX, |d| u64::try_from(d.as_nanos()).unwrap_or(u64::MAX));
    let started = Instant::now();
    let run = || -> Result<()> {
        while ticks * config.period_ns() < end_ns && !shared.stop.load(Ordering::Relaxed) {
            let before = allocations::on_this_thread();
            let (id, request) = rings.next_request();
            world.tick_timed(request, &mut timing);
            let Ticked { sample, input } = world.control.ticked();
            timing.count_frame_age(sample.frame_age_s);
            rings.note(input, || world.control.state());
            last.clone_from(sample);
            rings.publish(&last, id, input.outcome, shared);
            ticks += 1;
            warm |= ticks > live::WARM_UP_TICKS;
            allocated += if warm { allocations::on_this_thread() - before } else { 0 };
            if let Some(log) = &mut log {
                command_csv::write_row(log, &last)?;
            }
            clients.see(&last, reporter);
        }
        log.as_mut().map_or(Ok(()), |log| Ok(log.flush()?))
    };
    // A log is closed whichever way the run ends.
    let ended = catch_unwind(AssertUnwindSafe(run)).unwrap_or_else(|_| Err(anyhow!("the run panicked")));
    if ended.is_err() {
        let closed = finish(clients.recording, options, reporter);
        return ended.and(closed);
    }
    let summary = Summary {
        timing: &timing,
        last: &last,
        ticks,
        overruns_by_stage: None,
        recoveries: 0,
        allocations: warm.then_some(allocated),
        samples_dropped: shared.samples_dropped.load(Ordering::Relaxed),
        wall: started.elapsed(),
    };
    let ended = end(&summary, reporter);
    drop(server);
    clients.take_asked();
    finish(clients.recording, options, reporter)?;
    ended
}

#[cfg(all(test, feature = "fci"))]
mod tests {
    use super::*;
    use crate::robot::{ArmDriver, Believed, Parts};
    use std::net::TcpListener;
    use std::sync::mpsc::{Sender, channel};

    struct Told(Sender<String>);

    impl Reporter for Told {
        fn report(&mut self, notice: Notice<'_>) {
            if let Notice::RealTime(step) = notice {
                // The test that listens has failed.
                let _ = self.0.send(step.what.clone());
            }
        }
    }

    #[test]
    fn the_memory_is_locked_before_the_arm_is_asked_what_it_carries() {
        let arm = TcpListener::bind("127.0.0.1:0").unwrap();
        let (told, order) = channel();
        let mut config = Config::default();
        (config.plant.kind, config.plant.parts) = (PlantKind::Robot, Parts::Arm);
        (config.plant.arm.driver, config.plant.arm.payload) = (ArmDriver::Fci, Believed::Arm);
        config.plant.arm.host = arm.local_addr().unwrap().to_string();
        config.realtime.lock_memory = true;
        let asked = told.clone();
        std::thread::spawn(move || {
            // Hangs up: the arm cannot be asked.
            drop(arm.accept());
            asked.send("asked".into()).unwrap();
        });
        let options = Options { config, ..Options::default() };
        let why = live_robot(&options, &Arc::default(), &mut Told(told)).unwrap_err();
        let _ = nix::sys::mman::munlockall();
        assert!(why.to_string().contains("plant.arm.payload"), "{why}");
        assert_eq!([order.recv().unwrap(), order.recv().unwrap()], ["memory locked", "asked"]);
    }
}
