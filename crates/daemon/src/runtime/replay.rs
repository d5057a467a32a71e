//! `mocad replay LOG`: the same loop once more, from the recorded states and bytes, compared bit for bit with what it did.

use crate::VERSION;
use crate::config::Config;
use crate::control::assemble::{cover_config, motion, supervisor};
use crate::control::flange_sensor::{FlangeReading, FlangeSensor};
use crate::control::plant::{Plant, Simulated, SourceAge};
use crate::control::stage::Untimed;
use crate::control::tick::ControlLoop;
use crate::record::tick_blocks::{self, ComparedTick, fingerprint};
use crate::record::tick_log::{StateRecord, TickRecord};
use crate::robot::JOINTS;
use anyhow::{Context, Result, anyhow, bail};
use moca_lockstep::board_events::BoardEvents;
use moca_lockstep::touch_board::ByteCover;
use moca_msgs::{
    Actuation, ArmLink, Fault, GripperRequest, GripperState, Outcome, Refusal, RobotState, Sample,
};
use moca_tactile::{BoardEvent, Cover};
use moca_telemetry::log::records::Configuration;
use moca_telemetry::log::{LogReader, Record, shown};
use std::collections::VecDeque;
use std::fmt;
use std::path::PathBuf;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::{Duration, Instant};

/// Events one tick can take, and more.
const RING_EVENTS: usize = 64;
/// Samples that are kept to name a difference: those of a few blocks.
const SHOWN_MAX: usize = 4096;

/// Result of a replay without a difference.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Report {
    /// Ticks run again and compared with their samples.
    pub compared: u64,
    /// Ticks run again whose samples are not in the log: dropped on their way, or behind a cut.
    pub without_sample: u64,
    /// Why the log ends before its end, if it does.
    pub cut: Option<String>,
    /// The log was written by this other version.
    pub other_version: Option<String>,
    /// Wall time.
    pub wall: Duration,
}

/// Returns the sentence about a log that another program wrote.
fn of_another(version: &str) -> String {
    format!("the log is of mocad {version}, this is {VERSION}: differences may be those of the program")
}

impl fmt::Display for Report {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        if let Some(version) = &self.other_version {
            writeln!(f, "{}", of_another(version))?;
        }
        writeln!(
            f,
            "{} ticks compared in {:.2} s, every bit the same",
            self.compared,
            self.wall.as_secs_f64()
        )?;
        if self.without_sample > 0 {
            writeln!(f, "{} ticks more were run without a sample to compare with", self.without_sample)?;
        }
        match &self.cut {
            Some(cut) => writeln!(f, "the log is cut: {cut}"),
            None => Ok(()),
        }
    }
}

/// Why a replay ended early.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Failure {
    /// A tick did something else.
    Differs {
        /// The first that did.
        tick: u64,
        /// Which quantity: a field of the sample, or the answer to the request.
        quantity: String,
        /// In the log.
        recorded: String,
        /// Now.
        replayed: String,
    },
    /// The recorder lost what the next ticks were given: nothing can be said about them.
    Incomplete {
        /// Last tick that was whole.
        after: Option<u64>,
        /// Missing part.
        missing: String,
        /// Ticks compared until there, all the same.
        compared: u64,
    },
    /// The log begins in the middle of a run: what the loop remembered then is not known.
    MidRun {
        /// Its first tick.
        first: u64,
    },
}

impl fmt::Display for Failure {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Differs { tick, quantity, recorded, replayed } => {
                write!(f, "tick {tick} differs in {quantity}: recorded {recorded}, replayed {replayed}")
            }
            Self::Incomplete { after, missing, compared } => {
                let after = after.map_or("the start".to_owned(), |tick| format!("tick {tick}"));
                write!(
                    f,
                    "the log is incomplete after {after}: {missing}; the {compared} ticks up to there are the same, \
                     and nothing can be said about the rest"
                )
            }
            Self::MidRun { first } => write!(
                f,
                "the log begins at tick {first}, in the middle of a run: what the loop remembered then (zero, drift, \
                 targets) is not in it. Record from the start with --record to replay"
            ),
        }
    }
}

impl std::error::Error for Failure {}

/// Runs a log again, or the parts of one in their order.
///
/// # Errors
/// A [`Failure`], or a file that is no log of a run.
pub fn run(parts: &[PathBuf]) -> Result<Report> {
    run_watched(parts, &mut |_| {})
}

/// Replays; `progress` receives the share that is done, 0 to 1.
///
/// # Errors
/// As for [`run`].
pub fn run_watched(parts: &[PathBuf], progress: &mut dyn FnMut(f64)) -> Result<Report> {
    let started = Instant::now();
    let mut report = Report::default();
    match compare(parts, progress, &mut report) {
        Ok(()) => Ok(Report { wall: started.elapsed(), ..report }),
        Err(error) => Err(match (&report.other_version, error.downcast_ref()) {
            (Some(version), Some(Failure::Differs { .. })) => error.context(of_another(version)),
            _ => error,
        }),
    }
}

#[expect(clippy::cast_precision_loss, reason = "a share of some files")]
fn compare(parts: &[PathBuf], progress: &mut dyn FnMut(f64), report: &mut Report) -> Result<()> {
    let mut replay: Option<Replay> = None;
    for (number, part) in parts.iter().enumerate() {
        let mut reader = LogReader::open(part)?;
        while let Some(record) = reader.next() {
            progress((number as f64 + reader.part_read()) / parts.len() as f64);
            match (record, &mut replay) {
                (Record::Configuration(configuration), None) => {
                    report.other_version =
                        (configuration.version != VERSION).then(|| configuration.version.clone());
                    replay = Some(Replay::new(&configuration)?);
                }
                (Record::Replay(block), Some(replay)) => {
                    let after =
                        replay.last.map_or("the start".to_owned(), |(tick, _)| format!("tick {tick}"));
                    let ticks = tick_blocks::decode(&block);
                    for tick in ticks.with_context(|| format!("the block after {after} cannot be read"))? {
                        replay.step(&tick, report)?;
                    }
                }
                (Record::LoopState(state), Some(replay)) => replay.begin_with(&state)?,
                (Record::Sample(sample), Some(replay)) => replay.show(*sample),
                _ => {}
            }
        }
        report.cut = reader.cut().map(Into::into);
        if report.cut.is_some() {
            break;
        }
    }
    let replay = match (replay, &report.cut) {
        (Some(replay), _) => replay,
        (None, Some(cut)) => bail!("the log is damaged before its configuration: {cut}"),
        (None, None) => bail!(
            "the log holds no configuration: it was not written by `mocad --record` (a dashboard's recording has samples only)"
        ),
    };
    if let Some(failure) = replay.differs {
        return Err(failure.into());
    }
    let after = replay.last.map(|(tick, _)| tick);
    if let (Some(sample), None) =
        (replay.shown.back().filter(|sample| Some(sample.tick) > after), &report.cut)
    {
        let missing = format!("tick {} has a sample, but what it was given is missing", sample.tick);
        return Err(Failure::Incomplete { after, missing, compared: report.compared }.into());
    }
    if report.compared == 0 {
        bail!("the log holds no tick that could be compared");
    }
    Ok(())
}

struct Replay {
    control: ControlLoop<RecordedPlant, Option<ByteCover>>,
    /// To the cover, one for each board.
    events: Vec<rtrb::Producer<BoardEvent>>,
    /// Tick and number of the last one.
    last: Option<(u64, u64)>,
    /// Board events of the ticks up to there.
    cover_events: u64,
    /// Ticks and events that the recorder had lost before the first tick; `None` before that.
    lost_before: Option<u64>,
    /// Samples of the log for ticks that have not been run yet.
    shown: VecDeque<Sample>,
    /// The first difference, until a sample that is shown names its quantity.
    differs: Option<Failure>,
    _texts: Vec<TemporaryFile>,
}

impl Replay {
    fn new(configuration: &Configuration) -> Result<Self> {
        let mut config = Config::parse(&configuration.toml).context("the log's configuration")?;
        let files = [
            (&configuration.calibration, &mut config.board.calibration),
            (&configuration.contact_limits, &mut config.protection.thresholds),
        ];
        let mut texts = Vec::new();
        for (text, path) in files.into_iter().filter(|(text, _)| !text.is_empty()) {
            let file = TemporaryFile::new(text)?;
            *path = file.0.display().to_string();
            texts.push(file);
        }
        let rings = config.board.port.iter().map(|_| rtrb::RingBuffer::new(RING_EVENTS));
        let (events, from_log): (Vec<_>, Vec<_>) = rings.unzip();
        let cover = if config.plant.parts.has_cover() {
            Some(ByteCover::new(Cover::new(cover_config(&config)?)?, BoardEvents::new(from_log)))
        } else {
            None
        };
        let period_s = 1.0 / f64::from(config.control_loop.rate_hz);
        let control = ControlLoop::new(
            RecordedPlant::default(),
            cover,
            supervisor(&config),
            motion(&config)?,
            period_s,
        );
        Ok(Self {
            control,
            events,
            last: None,
            cover_events: 0,
            lost_before: None,
            shown: VecDeque::new(),
            differs: None,
            _texts: texts,
        })
    }

    /// Goes on from what the loop remembered in the middle of its run.
    fn begin_with(&mut self, state: &[u8]) -> Result<()> {
        if self.last.is_some() {
            return Ok(());
        }
        let state = StateRecord::decode(state)
            .context("what the loop remembered is damaged, or another version's")?;
        self.control.restore(&state.state)?;
        self.last = Some((state.tick, state.number));
        self.cover_events = state.cover_events;
        Ok(())
    }

    /// Notes what the log shows of a tick, to name what differs.
    fn show(&mut self, sample: Sample) {
        self.shown.push_back(sample);
        if self.shown.len() > SHOWN_MAX {
            self.shown.pop_front();
        }
    }

    fn step(&mut self, tick: &ComparedTick, report: &mut Report) -> Result<()> {
        let ComparedTick { record, sample: recorded } = tick;
        let input = &record.input;
        let number = input.slot.tick;
        self.check_whole(record, report.compared)?;
        for (board, event) in &record.events {
            let ring = self.events.get_mut(usize::from(*board));
            let ring = ring.context("bytes of a board that the log's configuration does not name")?;
            // A tick takes fewer events than the ring holds.
            let _ = ring.push(event.into());
        }
        self.control.plant = RecordedPlant {
            state: input.state,
            age: input.age,
            refused: input.refused,
            link: input.link,
            flange: input.flange,
            gripper: input.gripper,
            outcome: input.outcome.unwrap_or(Ok(())),
        };
        let ticked = self.control.tick(&input.slot, input.request, &mut Untimed);
        let (sample, outcome) = (ticked.sample.clone(), ticked.input.outcome);
        self.last = Some((number, record.number));
        self.cover_events = input.cover_events;
        if self.differs.is_some() {
            return self.name_difference(&sample);
        }
        if outcome != input.outcome {
            let (recorded, replayed) = (format!("{:?}", input.outcome), format!("{outcome:?}"));
            let quantity = "the answer to the request".into();
            return Err(Failure::Differs { tick: number, quantity, recorded, replayed }.into());
        }
        match recorded {
            None => report.without_sample += 1,
            Some(recorded) if *recorded == fingerprint(&sample) => report.compared += 1,
            Some(recorded) => {
                let (recorded, replayed) =
                    (format!("{recorded:08x}"), format!("{:08x}", fingerprint(&sample)));
                let quantity = "the fingerprint of the sample: less than a viewer shows".into();
                self.differs = Some(Failure::Differs { tick: number, quantity, recorded, replayed });
                return self.name_difference(&sample);
            }
        }
        Ok(())
    }

    /// Fails with the first quantity that differs in what the log shows, once it shows this tick; or fails without a name
    /// if that says nothing.
    fn name_difference(&mut self, replayed: &Sample) -> Result<()> {
        while self.shown.front().is_some_and(|sample| sample.tick < replayed.tick) {
            self.shown.pop_front();
        }
        if self.shown.front().is_none_or(|sample| sample.tick != replayed.tick) {
            return Ok(());
        }
        let (Some(recorded), Some(mut failure)) = (self.shown.pop_front(), self.differs.take()) else {
            return Ok(());
        };
        // These two are the worst of several ticks in a log.
        let (lateness_s, stages_ns) = (recorded.lateness_s, recorded.stages_ns);
        let replayed = Sample { lateness_s, stages_ns, ..shown(replayed) };
        if let (Failure::Differs { quantity, recorded, replayed, .. }, Some(found)) =
            (&mut failure, difference(&recorded, &replayed)?)
        {
            (*quantity, *recorded, *replayed) = found;
        }
        Err(failure.into())
    }

    /// Checks that nothing was lost between the last tick and this one.
    fn check_whole(&mut self, record: &TickRecord, compared: u64) -> Result<(), Failure> {
        let input = &record.input;
        let after = self.last.map(|(tick, _)| tick);
        let incomplete = |missing| Err(Failure::Incomplete { after, missing, compared });
        match self.last {
            None if record.number > 0 && record.lost == 0 => {
                return Err(Failure::MidRun { first: input.slot.tick });
            }
            Some((_, number)) if number + 1 != record.number => {
                return incomplete(format!("the next tick in it is {}", input.slot.tick));
            }
            _ => {}
        }
        let lost_before = if self.last.is_some() { record.lost } else { 0 };
        let lost = record.lost.saturating_sub(*self.lost_before.get_or_insert(lost_before));
        let took = input.cover_events.saturating_sub(self.cover_events);
        if lost > 0 || took != record.events.len() as u64 {
            let missing = "the recorder had no room for ticks or bytes of the board (a slow disk?)";
            return incomplete(missing.into());
        }
        Ok(())
    }
}

/// The first field in which two samples differ, and its values.
fn difference(recorded: &Sample, replayed: &Sample) -> Result<Option<(String, String, String)>> {
    // The shortest text that reads back to the same bits differs where a bit does.
    if serde_json::to_vec(recorded)? == serde_json::to_vec(replayed)? {
        return Ok(None);
    }
    let fields = |sample| match serde_json::to_value(sample)? {
        serde_json::Value::Object(fields) => Ok(fields),
        _ => Err(anyhow!("a sample is no object")),
    };
    let (recorded, replayed) = (fields(recorded)?, fields(replayed)?);
    let differing = recorded.iter().find_map(|(name, value)| {
        let other = replayed.get(name)?.to_string();
        let value = value.to_string();
        (value != other).then(|| (name.clone(), value, other))
    });
    differing.map(Some).context("samples differ in no field")
}

/// Gives what was measured; takes every order.
struct RecordedPlant {
    state: Result<RobotState<JOINTS>, Fault>,
    age: SourceAge,
    refused: Option<Fault>,
    link: Option<ArmLink>,
    flange: Option<FlangeReading>,
    gripper: Option<GripperState>,
    /// Answer that only the robot can give.
    outcome: Outcome,
}

impl Default for RecordedPlant {
    fn default() -> Self {
        let (state, outcome) = (Err(Fault::PlantLost), Err(Refusal::NotSimulated));
        let age = SourceAge::default();
        Self { state, age, refused: None, link: None, flange: None, gripper: None, outcome }
    }
}

impl Plant for RecordedPlant {
    fn read(&mut self) -> Result<RobotState<JOINTS>, Fault> {
        self.state
    }

    fn age(&self) -> SourceAge {
        self.age
    }

    fn link(&self) -> Option<ArmLink> {
        self.link
    }

    fn recover(&mut self) -> Outcome {
        self.outcome
    }

    fn gripper(&mut self) -> Option<GripperState> {
        self.gripper
    }

    fn request_gripper(&mut self, _request: &GripperRequest) -> Outcome {
        self.outcome
    }

    fn write(&mut self, _actuation: &Actuation<JOINTS>, _ticks: u64) -> Result<(), Fault> {
        self.refused.map_or(Ok(()), Err)
    }

    fn flange_sensor(&mut self) -> Option<&mut dyn FlangeSensor> {
        Some(self)
    }

    fn simulated(&mut self) -> Option<&mut dyn Simulated> {
        Some(self)
    }
}

impl FlangeSensor for RecordedPlant {
    fn latest(&mut self) -> Option<FlangeReading> {
        self.flange
    }
}

impl Simulated for RecordedPlant {
    fn press(&mut self, _taxel: usize, _force_n: f64) -> Outcome {
        self.outcome
    }
}

/// A text of the log as the file that the configuration names.
struct TemporaryFile(PathBuf);

impl TemporaryFile {
    fn new(text: &str) -> Result<Self> {
        static NEXT: AtomicU64 = AtomicU64::new(0);
        let number = NEXT.fetch_add(1, Ordering::Relaxed);
        let name = format!("mocad-replay-{}-{number}.toml", std::process::id());
        let path = std::env::temp_dir().join(name);
        std::fs::write(&path, text).with_context(|| path.display().to_string())?;
        Ok(Self(path))
    }
}

impl Drop for TemporaryFile {
    fn drop(&mut self) {
        // A file left behind in the temporary folder does no harm.
        let _ = std::fs::remove_file(&self.0);
    }
}
