//! Everything that watches the loop from outside: terminal, telemetry, log, flight recorder. A live loop waits for none.
#![expect(clippy::print_stdout, reason = "this module is what the user sees on the terminal")]

use crate::cli::report::{Console, Level};
use crate::config::{Config, PlantKind};
use crate::inject::{self, Disk, OutsideFault, Strike};
use crate::record::flight_recorder::FlightRecorder;
use crate::record::recording::{Recording, parameter_change};
use crate::record::tick_log::TapeReader;
use crate::runtime::live::{Rings, Shared};
use crate::runtime::run::Options;
use crate::runtime::watchdog::Heartbeat;
use anyhow::{Context, Result, anyhow};
use moca_msgs::{Outcome, Request, Sample, robot};
use moca_telemetry::RobotDescription;
use moca_telemetry::description::ArmDescription;
use moca_telemetry::net::{self, CalibrationPort, Ports, Server};
use std::fs::File;
use std::net::SocketAddr;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::time::Duration;

/// Samples a ring to observers holds: four seconds at 1 kHz.
pub(crate) const RING_SAMPLES: usize = 4096;

/// Requests and answers on their way.
const RING_REQUESTS: usize = 64;

/// How often the terminal looks into its ring.
const LOOK_EVERY: Duration = Duration::from_millis(20);

/// The ends of the rings that belong to telemetry, besides the samples.
pub(crate) struct RequestPorts {
    requests: rtrb::Producer<(u64, Request)>,
    outcomes: rtrb::Consumer<(u64, Outcome)>,
    samples_dropped: Arc<AtomicU64>,
    pub(crate) calibration: Option<CalibrationPort>,
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

pub(crate) fn serve(
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
    let parameters = crate::config::schema::describe(config);
    let robot = RobotDescription::new(
        &config.robot,
        config.plant.kind == PlantKind::Simulated,
        1.0 / f64::from(config.control_loop.rate_hz),
        &robot::SUMMIT_XL,
        &config.mount(),
        config.arm(),
        &config.taxels(),
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
pub(crate) fn spoil_telemetry(
    options: &Options,
    server: Option<&Server>,
    strike: Option<&Strike>,
) -> Result<()> {
    // In lock-step what reaches the loop of a fault is asked of it in its tick: no socket is as punctual.
    let by_socket =
        |fault: &OutsideFault| !(fault.is_of_disk() || options.lock_step && fault.request().is_some());
    let fault = options.outside_fault().filter(by_socket);
    let (Some(fault), Some(strike)) = (fault, strike) else { return Ok(()) };
    let server = server.context("a fault of telemetry needs telemetry.listen")?;
    Ok(inject::client(fault, server.address(), strike.clone(), options.config.simulation.seed)?)
}

/// Who takes what the loop notes of each tick.
pub(crate) struct Observers {
    pub(crate) strike: Option<Strike>,
    pub(crate) recording: Option<Recording>,
    flight: Option<FlightRecorder>,
    tape: TapeReader,
}

impl Observers {
    /// Those that the command line and the configuration ask for. In lock-step nothing is lost by starting over with
    /// `--record`, so no flight recorder runs.
    pub(crate) fn new(options: &Options, tape: TapeReader) -> Result<Self> {
        let strike = options.strike();
        let recording = recording(options, strike.as_ref())?;
        let flight = if options.lock_step {
            None
        } else {
            FlightRecorder::new(&options.config, description(&options.config))?
        };
        Ok(Self { strike, recording, flight, tape })
    }

    pub(crate) fn see(&mut self, sample: &Sample) {
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

pub(crate) fn finish(recording: Option<Recording>, options: &Options) -> Result<()> {
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
pub(crate) fn watch(
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
