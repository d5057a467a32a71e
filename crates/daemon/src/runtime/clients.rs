//! Everything that watches the loop from outside: reporter, telemetry, log, flight recorder. A live loop waits for none.

use crate::config::live::changed;
use crate::config::stability::Stability;
use crate::config::{AUTO_FOLDER, Config};
use crate::control::unknown_load::UnknownLoadWatch;
use crate::inject::{self, Disk, Strike};
use crate::record::flight_recorder::{FlightRecorder, access_folder};
use crate::record::recording::{Recording, parameter_change};
use crate::record::tick_log::TickLogReader;
use crate::robot::PlantKind;
use crate::runtime::live::{Rings, Shared};
use crate::runtime::notice::{DriverWords, Notice, Reporter, SaidByDrivers};
use crate::runtime::options::Options;
use crate::runtime::recovery::Recovery;
use crate::runtime::watchdog::Heartbeat;
use anyhow::{Context, Result, anyhow};
use moca_lockstep::inject::OutsideFault;
use moca_msgs::robot::AnyArm;
use moca_msgs::{Refusal, Sample};
use moca_telemetry::RobotDescription;
use moca_telemetry::audit::Asked;
use moca_telemetry::log::create_file;
use moca_telemetry::net::{
    self, Address, CalibrationPort, Judge, Ports, ProposedChange, RequestSender, Server, Serving, TlsPort,
    Token,
};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::mpsc::{Receiver, Sender, SyncSender, sync_channel};
use std::time::Duration;

/// Samples a ring to clients holds: four seconds at 1 kHz.
pub(crate) const RING_SAMPLES: usize = 4096;

/// Lines of the audit that wait to be recorded; those beyond them are counted and come later.
const ASKED_MAX: usize = 256;

/// Period at which the terminal looks into its ring.
const LOOK_EVERY: Duration = Duration::from_millis(20);

/// The ends of the rings that belong to telemetry, besides the samples.
pub struct RequestPorts {
    requests: RequestSender,
    samples_dropped: Arc<AtomicU64>,
    pub(crate) calibration: Option<CalibrationPort>,
    pub(crate) audit: Option<SyncSender<Asked>>,
}

impl RequestPorts {
    /// All that telemetry serves.
    pub fn with(self, samples: rtrb::Consumer<Sample>, recorder: Option<rtrb::Producer<Sample>>) -> Ports {
        let Self { requests, samples_dropped, calibration, audit: _ } = self;
        let ring_dropped = samples_dropped;
        Ports { samples, requests, ring_dropped, recorder, calibration, judge: None }
    }
}

/// Lets no parameter through with which the loop would not be stable at the posture of the latest sample.
fn judge(config: &Config) -> Judge {
    let (stability, configured) = (Stability::new(config), config.parameters());
    let joints = config.arm().joints;
    Box::new(move |change: &ProposedChange<'_>| {
        let mut present = configured;
        for (number, values) in change.changed {
            present = changed(&present, joints, usize::from(*number), values)?;
        }
        let number = usize::from(change.parameter);
        changed(&present, joints, number, change.values)?;
        let mut q_rad = configured.gains.posture_rad;
        q_rad.iter_mut().zip(change.q_rad).for_each(|(q, measured)| *q = *measured);
        match stability.nearest_stable(&present, number, change.values, &q_rad) {
            Some(nearest) => Err(Refusal::Unstable { nearest }),
            None => Ok(()),
        }
    })
}

/// Rings between a loop and those who watch it.
pub fn rings(shared: &Shared) -> (Rings, rtrb::Consumer<Sample>, RequestPorts) {
    let (samples, from_loop) = rtrb::RingBuffer::new(RING_SAMPLES);
    let (sender, requests) = net::request_channel();
    let samples_dropped = Arc::clone(&shared.samples_dropped);
    let ports = RequestPorts { requests: sender, samples_dropped, calibration: None, audit: None };
    (Rings { samples, requests, tick_log: None, recovery: Recovery::default() }, from_loop, ports)
}

pub(crate) fn serve(
    config: &Config,
    address: &Address,
    samples: rtrb::Consumer<Sample>,
    recorder: Option<rtrb::Producer<Sample>>,
    mut ports: RequestPorts,
    reporter: &mut dyn Reporter,
) -> Result<Server> {
    let serving = Serving { audit: ports.audit.take(), ..serving(config, address)? };
    let ports = Ports { judge: Some(judge(config)), ..ports.with(samples, recorder) };
    let served = net::serve(address, serving, description(config), ports);
    let server = served.with_context(|| {
        format!("telemetry.listen = \"{address}\" (if another mocad runs, choose another address, port 0 for any, or \"\")")
    })?;
    reporter.report(Notice::Telemetry(server.address()));
    if let Some(address) = server.tls_address() {
        reporter.report(Notice::Telemetry(address));
    }
    Ok(server)
}

/// Returns the rules by which clients are admitted.
fn serving(config: &Config, address: &Address) -> Result<Serving> {
    let token = match address {
        Address::Tcp(_) => {
            let path = config.token_path().context("telemetry.token: no home folder; name a file")?;
            Some(Token::read_or_create(&path).context("telemetry.token")?)
        }
        Address::Unix(_) | Address::Tls { .. } => None,
    };
    Ok(Serving {
        mode: config.telemetry.socket_mode().unwrap_or_default(),
        token,
        watch: config.watch_socket(),
        tls: tls_port(config)?,
        self_armed: config.startup.arm && config.plant.kind == PlantKind::Simulated,
        audit: None,
    })
}

/// Returns the port for programs of other machines; its certificates are made if there are none.
fn tls_port(config: &Config) -> Result<Option<TlsPort>> {
    if config.telemetry.tls.is_empty() {
        return Ok(None);
    }
    let listen = config.telemetry.tls.parse().context("telemetry.tls")?;
    let folder = access_folder();
    #[cfg(feature = "tls")]
    moca_telemetry::net::tls::Access::open(&folder).context("telemetry.tls")?;
    Ok(Some(TlsPort { listen, folder }))
}

/// Describes the robot of a configuration to clients.
pub(crate) fn description(config: &Config) -> RobotDescription {
    let limits = &config.parameters().limits;
    let mut robot = RobotDescription {
        name: config.robot.name.clone(),
        simulated: config.plant.kind == PlantKind::Simulated,
        period_s: 1.0 / f64::from(config.control_loop.rate_hz),
        base_size_m: config.robot.base.size_m,
        arm_name: config.robot.arm.name.clone(),
        arm: *config.arm(),
        mount: config.robot.mount,
        taxels: config.robot.cover.placements(),
        frame_deadline_s: Duration::from_nanos(moca_tactile::board::SILENT_AFTER_NS).as_secs_f64(),
        taxel_force_max_n: limits.taxel_force_n,
        base_velocity_max: limits.base_velocity,
        parameters: crate::config::schema::describe(config),
        speed_override: config.protection.override_statement.clone(),
        uncalibrated: config.uncalibrated().unwrap_or_default(),
        urdf: crate::config::urdf::urdf(&config.robot, config.plant.parts),
    };
    if !config.plant.parts.has_arm() {
        (robot.arm_name, robot.arm) = (String::new(), AnyArm::NONE);
    }
    if !config.plant.parts.has_cover() {
        robot.taxels.clear();
    }
    robot
}

fn recording(
    options: &Options,
    strike: Option<&Strike>,
    reporter: &mut dyn Reporter,
) -> Result<Option<Recording>> {
    let spoiled = options.outside_fault().filter(|fault| fault.is_of_disk());
    let Some(path) = &options.record else {
        return spoiled.map_or(Ok(None), |_| Err(anyhow!("a fault of the disk needs a log: --record FILE")));
    };
    let (config, live) = (&options.config, !options.lock_step);
    let recording = match spoiled.zip(strike) {
        None => Recording::create(path, options.record_split, description(config), config, live)?,
        Some((fault, strike)) => {
            let file = create_file(path).with_context(|| path.display().to_string())?;
            Recording::start(Disk::new(file, fault, strike.clone()), description(config), config, live)?
        }
    };
    reporter.report(Notice::Recording(path));
    Ok(Some(recording))
}

/// Starts the telemetry client that causes the fault that the command line asks for, if a client can cause it.
pub(crate) fn spoil_telemetry(
    options: &Options,
    server: Option<&Server>,
    strike: Option<&Strike>,
) -> Result<()> {
    // In lock-step the part of a fault that reaches the loop is requested in its own tick: no socket is as punctual.
    let by_socket = |fault: &OutsideFault| {
        !(fault.is_of_disk()
            || *fault == OutsideFault::Panic
            || options.lock_step && fault.request().is_some())
    };
    let fault = options.outside_fault().filter(by_socket);
    let (Some(fault), Some(strike)) = (fault, strike) else { return Ok(()) };
    let server = server.context("a fault of telemetry needs telemetry.listen")?;
    Ok(inject::client(fault, server.address(), strike.clone(), options.config.simulation.seed)?)
}

/// The flight recorder that the configuration asks for. A folder that it names must be there; where it leaves the choice,
/// a run without that folder is still a run.
fn flight_recorder(config: &Config, reporter: &mut dyn Reporter) -> Result<Option<FlightRecorder>> {
    match FlightRecorder::new(config, description(config)) {
        Err(error) if config.flight_recorder.folder == AUTO_FOLDER => {
            reporter.report(Notice::Trouble(&format!("no flight recorder: {error:#}")));
            Ok(None)
        }
        recorder => recorder,
    }
}

/// Receivers of the loop's record of each tick.
pub(crate) struct Clients {
    pub(crate) strike: Option<Strike>,
    pub(crate) recording: Option<Recording>,
    panics: bool,
    flight: Option<FlightRecorder>,
    ticks: TickLogReader,
    unknown_load: UnknownLoadWatch,
    /// Messages of a real robot's drivers.
    drivers: (DriverWords, SaidByDrivers),
    /// Sender of notices about the disk to dashboards.
    pub(crate) notices: Option<Sender<String>>,
    /// Requests of telemetry's clients and their answers.
    asked: (SyncSender<Asked>, Receiver<Asked>),
    /// Loop time of the last sample, ns.
    now_ns: u64,
}

impl Clients {
    /// Those that the command line and the configuration ask for. In lock-step nothing is lost by starting over with
    /// `--record`, so no flight recorder runs.
    pub(crate) fn new(options: &Options, ticks: TickLogReader, reporter: &mut dyn Reporter) -> Result<Self> {
        let strike = options.strike();
        let recording = recording(options, strike.as_ref(), reporter)?;
        let flight = if options.lock_step { None } else { flight_recorder(&options.config, reporter)? };
        let panics = options.outside_fault() == Some(OutsideFault::Panic);
        let (drivers, asked) = (DriverWords::channel(), sync_channel(ASKED_MAX));
        let (unknown_load, notices) = (UnknownLoadWatch::default(), None);
        Ok(Self {
            strike,
            recording,
            panics,
            flight,
            ticks,
            unknown_load,
            drivers,
            notices,
            asked,
            now_ns: 0,
        })
    }

    /// Returns the place for what clients of telemetry ask.
    pub(crate) fn audit(&self) -> SyncSender<Asked> {
        self.asked.0.clone()
    }

    /// Records what clients have asked since the last call, with the time of the last sample.
    pub(crate) fn take_asked(&mut self) {
        for asked in self.asked.1.try_iter() {
            if let Some(flight) = &mut self.flight {
                flight.add_asked(self.now_ns, asked.clone());
            }
            if let Some(recording) = &self.recording {
                recording.add_asked(self.now_ns, asked);
            }
        }
    }

    pub(crate) fn see(&mut self, sample: &Sample, reporter: &mut dyn Reporter) {
        reporter.report(Notice::Sample(sample));
        if let Some(strike) = &self.strike {
            strike.see(sample.time_ns);
            if self.panics {
                strike.panic();
            }
        }
        self.take_ticks(reporter);
        self.now_ns = sample.time_ns;
        if let Some(load) = self.unknown_load.see(sample) {
            self.say(sample.time_ns, load.to_string(), reporter);
        }
        self.take_asked();
        if let Some(recording) = &mut self.recording {
            recording.add(sample);
        }
        if let Some(path) = self.flight.as_mut().and_then(|flight| flight.add(sample)) {
            reporter.report(Notice::FaultLog(&path));
        }
        let recording = self.recording.as_mut().and_then(Recording::trouble);
        let recording = recording.map(|why| format!("nothing is recorded any more: {why}"));
        let flight = self.flight.as_mut().and_then(FlightRecorder::trouble);
        let flight = flight.map(|why| format!("the flight recorder failed: {why}"));
        for trouble in recording.into_iter().chain(flight) {
            reporter.report(Notice::Trouble(&trouble));
            self.show(trouble);
        }
    }

    /// Shows words in dashboards.
    fn show(&self, words: String) {
        if let Some(notices) = &self.notices {
            // A server that has ended has nobody to tell.
            let _ = notices.send(words);
        }
    }

    /// Returns the sender of the drivers' messages.
    pub(crate) fn driver_words(&self) -> DriverWords {
        self.drivers.0.clone()
    }

    /// Passes on what the drivers have said.
    fn take_words(&mut self, time_ns: u64, reporter: &mut dyn Reporter) {
        while let Some(words) = self.drivers.1.next() {
            self.say(time_ns, words, reporter);
        }
    }

    /// Says `words` of the robot on the terminal, in the log and in dashboards.
    fn say(&mut self, time_ns: u64, words: String, reporter: &mut dyn Reporter) {
        reporter.report(Notice::Driver(&words));
        if let Some(recording) = &mut self.recording {
            recording.add_words(time_ns, &words);
        }
        self.show(words);
    }

    /// Passes on what has been noted since the last call.
    fn take_ticks(&mut self, reporter: &mut dyn Reporter) {
        while let Some(state) = self.ticks.next_state() {
            if let Some(flight) = &mut self.flight {
                flight.add_state(state);
            }
        }
        while let Some(record) = self.ticks.next_tick() {
            if let Some(change) = parameter_change(&record) {
                reporter.report(Notice::Parameter(&change));
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

/// Closes the log.
pub(crate) fn finish(
    recording: Option<Recording>,
    options: &Options,
    reporter: &mut dyn Reporter,
) -> Result<()> {
    if let (Some(recording), Some(path)) = (recording, &options.record) {
        let summary = recording.finish().with_context(|| path.display().to_string())?;
        reporter.report(Notice::Recorded(&summary));
    }
    Ok(())
}

/// Passes samples to the clients until `done` is set and the ring is empty; returns the last one.
pub(crate) fn watch(
    samples: &mut rtrb::Consumer<Sample>,
    clients: &mut Clients,
    reporter: &mut dyn Reporter,
    (done, pulse): (&AtomicBool, &AtomicU64),
) -> Sample {
    let (mut last, mut heartbeat) = (Sample::default(), Heartbeat::new());
    loop {
        if !samples.is_empty() {
            heartbeat.beat();
        }
        pulse.fetch_add(1, Ordering::Relaxed);
        let finished = done.load(Ordering::Acquire);
        while let Ok(sample) = samples.pop() {
            clients.see(&sample, reporter);
            last = sample;
        }
        clients.take_ticks(reporter);
        clients.take_words(last.time_ns, reporter);
        if finished {
            return last;
        }
        std::thread::sleep(LOOK_EVERY);
    }
}
