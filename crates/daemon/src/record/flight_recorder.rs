//! The flight recorder: when a fault stops the robot, the last seconds write themselves into a log of their own, with
//! configuration, calibration and contact limits. Works on the clients' side of the rings.

use crate::config::{AUTO_FOLDER, Config};
use crate::record::recording::{configuration, parameter_change};
use crate::record::tick_blocks::{Block, BlockBuilder};
use crate::record::tick_log::{PortEvent, StateRecord, TickRecord};
use anyhow::{Context, Result};
use moca_msgs::{Fault, Mode, Sample};
use moca_telemetry::RobotDescription;
use moca_telemetry::audit::Asked;
use moca_telemetry::log::records::Configuration;
use moca_telemetry::log::{LogError, LogWriter, Meta, SerialBytes, create_file};
use moca_telemetry::net::wire::unix_now_ns;
use std::collections::{BTreeMap, VecDeque};
use std::fs::{self, File};
use std::io::BufWriter;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::mpsc::{Receiver, Sender, SyncSender, TrySendError, channel, sync_channel};
use std::thread::JoinHandle;
use std::time::{Duration, UNIX_EPOCH};

/// Length of the past that is kept, ns.
pub const KEPT_NS: u64 = 10_000_000_000;
/// Files kept in the folder.
pub const FILES_MAX: usize = 20;
/// Stops by one cause within so much of each other are one story, ms.
const STORY_MS: u64 = 60_000;
/// Files that may wait for the disk, each with its own seconds of memory.
const JOBS_MAX: usize = 2;

/// `2026-11-25T12-03-04_host-starved.mcap`, UTC; with `fraction` the time to the millisecond.
fn file_name(at_ms: u64, cause: &str, fraction: bool) -> String {
    let at = UNIX_EPOCH + Duration::from_millis(at_ms);
    let stamp = if fraction {
        humantime::format_rfc3339_millis(at).to_string()
    } else {
        humantime::format_rfc3339_seconds(at).to_string()
    };
    format!("{}_{cause}.mcap", stamp.trim_end_matches('Z').replace(':', "-"))
}

/// When a file of this name was written, ms since the Unix epoch, and for which cause; `None` of a file that is not ours.
fn dated(name: &str) -> Option<(u64, &str)> {
    let (stamp, cause) = name.strip_suffix(".mcap")?.split_once('_')?;
    let (day, time) = stamp.split_once('T')?;
    let at = humantime::parse_rfc3339(&format!("{day}T{}Z", time.replace('-', ":"))).ok()?;
    let at_ms = u64::try_from(at.duration_since(UNIX_EPOCH).ok()?.as_millis()).ok()?;
    Fault::has_code(cause).then_some((at_ms, cause))
}

/// Keeps the last [`KEPT_NS`] and writes them at every edge into a stop by a fault.
pub struct FlightRecorder {
    folder: PathBuf,
    meta: Meta,
    kept: Kept,
    stopped: Option<Fault>,
    /// Name of the last file.
    last: String,
    writer: Writer,
}

/// The last seconds. They are tens of megabytes: whoever writes them to a file shares them.
#[derive(Clone, Default)]
struct Kept {
    samples: VecDeque<Arc<Sample>>,
    ticks: VecDeque<Arc<TickRecord>>,
    /// Memories of the loop: the ticks continue from the oldest.
    states: VecDeque<Arc<StateRecord>>,
    /// Requests of clients, and when, ns of loop time.
    asked: VecDeque<(u64, Arc<Asked>)>,
}

impl Kept {
    /// Forgets what is older than [`KEPT_NS`] and not needed to run the rest again.
    fn forget(&mut self, now_ns: u64) {
        let old = |time_ns: u64| now_ns.saturating_sub(time_ns) > KEPT_NS;
        while self.states.get(1).is_some_and(|next| old(next.time_ns)) {
            self.states.pop_front();
        }
        while self.asked.front().is_some_and(|(time_ns, _)| old(*time_ns)) {
            self.asked.pop_front();
        }
        let begin = self.states.front().map_or(u64::MAX, |state| state.tick);
        while self
            .ticks
            .front()
            .is_some_and(|tick| old(tick.input.slot.now_ns) && tick.input.slot.tick <= begin)
        {
            self.ticks.pop_front();
        }
        while self.samples.front().is_some_and(|sample| old(sample.time_ns) && sample.tick <= begin) {
            self.samples.pop_front();
        }
    }

    /// The state that a replay of the rest begins with; `None` where the run's own beginning is there, or no state.
    fn begin(&self) -> Option<&StateRecord> {
        let mid_run = self.ticks.front().is_none_or(|first| first.number > 0);
        self.states.front().filter(|_| mid_run).map(Arc::as_ref)
    }
}

/// Requests to the writing thread, and its messages.
struct Writer {
    jobs: SyncSender<Job>,
    say: Sender<String>,
    said: Receiver<String>,
    thread: Option<JoinHandle<()>>,
}

struct Job {
    path: PathBuf,
    kept: Kept,
}

impl FlightRecorder {
    /// Starts the configured recorder; `None` if none is configured.
    ///
    /// # Errors
    /// The folder cannot be made or written, a file that the configuration names cannot be read, or no thread.
    pub fn new(config: &Config, description: RobotDescription) -> Result<Option<Self>> {
        let folder = match config.flight_recorder.folder.as_str() {
            "" => return Ok(None),
            AUTO_FOLDER => auto_folder(),
            folder => PathBuf::from(folder),
        };
        let meta = Meta { description, start_unix_ns: unix_now_ns() };
        let (configuration, period_s) =
            (configuration(config)?, 1.0 / f64::from(config.control_loop.rate_hz));
        // Said now rather than when a fault needs it.
        fs::create_dir_all(&folder).and_then(|()| probe(&folder)).with_context(|| {
            format!("flight_recorder.folder = {:?}: {}", config.flight_recorder.folder, folder.display())
        })?;
        let writer = Writer::start(folder.clone(), meta.clone(), configuration, period_s)?;
        Ok(Some(Self { folder, meta, kept: Kept::default(), stopped: None, last: String::new(), writer }))
    }

    /// Keeps what one tick was given.
    pub fn add_tick(&mut self, record: TickRecord) {
        let now_ns = record.input.slot.now_ns;
        self.kept.ticks.push_back(Arc::new(record));
        self.kept.forget(now_ns);
    }

    /// Keeps what the loop remembered.
    pub fn add_state(&mut self, state: StateRecord) {
        self.kept.states.push_back(Arc::new(state));
    }

    /// Keeps what clients asked and were answered.
    pub fn add_asked(&mut self, time_ns: u64, asked: Asked) {
        self.kept.asked.push_back((time_ns, Arc::new(asked)));
    }

    /// Keeps one sample; at the edge into a stop by a fault, lets a thread write what is kept and returns the file.
    pub fn add(&mut self, sample: &Sample) -> Option<PathBuf> {
        let now_ns = sample.time_ns;
        self.kept.samples.push_back(Arc::new(sample.clone()));
        self.kept.forget(now_ns);
        let stopped = matches!(sample.mode, Mode::ProtectiveStop | Mode::Fault);
        let fault = sample.fault.filter(|fault| stopped && *fault != Fault::OperatorStop);
        let before = std::mem::replace(&mut self.stopped, fault);
        let fault = fault.filter(|fault| before.map(Fault::code) != Some(fault.code()))?;
        let at_ms = (self.meta.start_unix_ns + now_ns) / 1_000_000;
        let mut name = file_name(at_ms, fault.code(), false);
        if name == self.last {
            name = file_name(at_ms, fault.code(), true);
        } else {
            self.last.clone_from(&name);
        }
        let path = self.folder.join(name);
        let said = self.writer.write(Job { path: path.clone(), kept: self.kept.clone() });
        said.then_some(path)
    }

    /// Returns the trouble with the files since the last call.
    pub fn trouble(&mut self) -> Option<String> {
        self.writer.said.try_recv().ok()
    }
}

impl Writer {
    fn start(folder: PathBuf, meta: Meta, configuration: Configuration, period_s: f64) -> Result<Self> {
        let (jobs, from_recorder) = sync_channel::<Job>(JOBS_MAX);
        let (say, said) = channel();
        let from_thread = say.clone();
        let thread = std::thread::Builder::new().name("flight-recorder".into()).spawn(move || {
            for Job { path, kept } in from_recorder {
                if let Err(error) = write_log(&path, &meta, &configuration, period_s, &kept) {
                    // Nobody listens any more once the daemon ends.
                    let _ = from_thread.send(format!("{}: {error}", path.display()));
                }
                forget_surplus(&folder);
            }
        })?;
        Ok(Self { jobs, say, said, thread: Some(thread) })
    }

    /// Returns true if there is room for one more: the disk may be slower than the faults.
    fn write(&self, job: Job) -> bool {
        let Err(refused) = self.jobs.try_send(job) else { return true };
        let (TrySendError::Full(job) | TrySendError::Disconnected(job)) = refused;
        // The receiver lives as long as this.
        let _ = self.say.send(format!("{}: not written, the disk is behind", job.path.display()));
        false
    }
}

impl Drop for Writer {
    fn drop(&mut self) {
        // The thread ends with the last job.
        (self.jobs, _) = sync_channel(1);
        if let Some(thread) = self.thread.take() {
            // It does not panic; if it did, there is nobody left to tell.
            let _ = thread.join();
        }
    }
}

/// Checks that a file can be created there.
fn probe(folder: &Path) -> std::io::Result<()> {
    let path = folder.join(format!(".mocad-{}", std::process::id()));
    File::create(&path)?;
    fs::remove_file(path)
}

/// systemd's StateDirectory, or else the user's folder for state (XDG base directories), which outlives a reboot.
pub(crate) fn auto_folder() -> PathBuf {
    let folder = |name: &str| std::env::var_os(name).map(PathBuf::from).filter(|path| path.is_absolute());
    folder("STATE_DIRECTORY")
        .or_else(|| Some(folder("XDG_STATE_HOME")?.join("mocad")))
        .or_else(|| Some(folder("HOME")?.join(".local/state/mocad")))
        .unwrap_or_else(|| std::env::temp_dir().join("mocad-state"))
}

/// Folder of the certificates of programs on other machines.
pub(crate) fn access_folder() -> PathBuf {
    auto_folder().join("access")
}

fn write_log(
    path: &Path,
    meta: &Meta,
    configuration: &Configuration,
    period_s: f64,
    kept: &Kept,
) -> Result<(), LogError> {
    let file = create_file(path).map_err(|cause| LogError::Create { path: path.into(), cause })?;
    let mut log = LogWriter::new(BufWriter::new(file), meta)?;
    log.configuration(configuration)?;
    let mut blocks = BlockBuilder::new(period_s);
    let begin = kept.begin();
    if let Some(state) = begin {
        log.loop_state(state.time_ns, &state.encode())?;
    }
    let first = begin.map_or(0, |state| state.number + 1);
    let mut ticks = kept.ticks.iter().skip_while(|record| record.number < first).peekable();
    let mut asked = kept.asked.iter().peekable();
    for sample in &kept.samples {
        log.sample(sample)?;
        while let Some((time_ns, asked)) = asked.next_if(|(time_ns, _)| *time_ns <= sample.time_ns) {
            log.asked(*time_ns, asked)?;
        }
        while let Some(record) = ticks.next_if(|record| record.input.slot.tick <= sample.tick) {
            tick(&mut log, record)?;
            write_block(&mut log, blocks.tick(TickRecord::clone(record)))?;
        }
        write_block(&mut log, blocks.sample(sample))?;
    }
    for block in blocks.finish() {
        write_block(&mut log, Some(block))?;
    }
    log.finish()?;
    Ok(())
}

fn tick(log: &mut LogWriter<BufWriter<File>>, record: &TickRecord) -> Result<(), LogError> {
    for (board, event) in &record.events {
        if let PortEvent::Bytes(arrival_ns, bytes) = event {
            let (board, arrival_ns) = (*board, *arrival_ns);
            log.serial(&SerialBytes { board, arrival_ns, bytes: bytes.clone() })?;
        }
    }
    parameter_change(record).map_or(Ok(()), |change| log.parameter(record.input.slot.now_ns, &change))
}

fn write_block(log: &mut LogWriter<BufWriter<File>>, block: Option<Block>) -> Result<(), LogError> {
    block.map_or(Ok(()), |(time_ns, block)| log.replay(time_ns, &block))
}

/// A file of ours: when, ms since the Unix epoch, and where.
type Dated = (u64, PathBuf);

/// Beyond [`FILES_MAX`] files one goes of the cause that has most of them, so that a cause that comes and goes does not push
/// out the one file of another. Of one cause the first file tells most, so a later one goes; otherwise the oldest.
fn forget_surplus(folder: &Path) {
    let Ok(entries) = fs::read_dir(folder) else { return };
    let mut by_cause: BTreeMap<String, Vec<Dated>> = BTreeMap::new();
    for path in entries.filter_map(|entry| Some(entry.ok()?.path())) {
        let name = path.file_name().and_then(|name| name.to_str()).unwrap_or_default();
        if let Some((at_ms, cause)) = dated(name) {
            by_cause.entry(cause.to_owned()).or_default().push((at_ms, path));
        }
    }
    by_cause.values_mut().for_each(|files| files.sort_unstable());
    while by_cause.values().map(Vec::len).sum::<usize>() > FILES_MAX {
        let Some(files) = by_cause.values_mut().max_by_key(|files| files.len()) else { return };
        let follows = |pair: &[Dated]| pair[1].0 - pair[0].0 < STORY_MS;
        let goes = files.windows(2).position(follows).map_or(0, |first| first + 1);
        // Somebody else may have removed it.
        let _ = fs::remove_file(files.remove(goes).1);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::record::tick_blocks::decode;
    use crate::record::tick_log::tests::{input, state};
    use moca_msgs::BoardFault;
    use moca_telemetry::log::{LogReader, Record, read_log};

    fn recorder(name: &str) -> FlightRecorder {
        let mut config = Config::default();
        let folder = std::env::temp_dir().join(format!("mocad-flight-{name}-{}", std::process::id()));
        let _ = fs::remove_dir_all(&folder);
        config.flight_recorder.folder = folder.display().to_string();
        FlightRecorder::new(&config, RobotDescription::paper("test", true)).unwrap().unwrap()
    }

    fn sample(tick: u64, fault: Option<Fault>) -> Sample {
        let mode = if fault.is_some() { Mode::ProtectiveStop } else { Mode::Impedance };
        Sample { tick, time_ns: tick * 1_000_000, mode, fault, ..Sample::default() }
    }

    /// Reports the tick at a number of milliseconds, the `number`th of its run; each reads one byte of the board.
    fn tell(recorder: &mut FlightRecorder, tick: u64, number: u64, fault: Option<Fault>) -> Option<PathBuf> {
        if tick.is_multiple_of(1000) {
            let time_ns = tick * 1_000_000;
            recorder.add_state(StateRecord { number, tick, time_ns, cover_events: 0, state: state() });
        }
        let events = vec![(0, PortEvent::Bytes(tick, vec![7]))];
        recorder.add_tick(TickRecord { input: input(tick, 0), number, lost: 0, events });
        recorder.add(&sample(tick, fault))
    }

    /// First tick, last tick and count of what a log holds: of states of the loop, of ticks to run again, of samples.
    fn held(path: &Path) -> [(u64, u64, usize); 3] {
        let (mut states, mut ticks, mut samples) = (Vec::new(), Vec::new(), Vec::new());
        for record in LogReader::open(path).unwrap() {
            match record {
                Record::LoopState(bytes) => {
                    states.push(StateRecord::decode(&bytes).unwrap().tick);
                }
                Record::Replay(block) => {
                    ticks.extend(decode(&block).unwrap().iter().map(|tick| tick.record.input.slot.tick));
                }
                Record::Sample(sample) => samples.push(sample.tick),
                _ => {}
            }
        }
        [states, ticks, samples].map(|all| {
            (all.first().copied().unwrap_or_default(), all.last().copied().unwrap_or_default(), all.len())
        })
    }

    #[test]
    fn last_ten_seconds_replay_from_stored_state() {
        let mut recorder = recorder("again");
        let start_ms = recorder.meta.start_unix_ns / 1_000_000;
        for tick in 0..25_000 {
            assert_eq!(tell(&mut recorder, tick, tick, None), None);
        }
        let path = tell(&mut recorder, 25_000, 25_000, Some(BoardFault::Lost.of(0))).unwrap();
        let name = path.file_name().unwrap().to_string_lossy().into_owned();
        let folder = recorder.folder.clone();
        // Who goes waits until the file is whole.
        drop(recorder);
        // 15.0 s is not more than ten seconds ago: what the loop remembered at 15 s is not needed, that at 14 s is not old.
        let [states, ticks, samples] = held(&path);
        assert_eq!(states, (14_000, 14_000, 1));
        assert_eq!(ticks, (14_001, 25_000, 11_000));
        assert_eq!(samples.1, 25_000);
        assert!(samples.0 <= 14_001 && samples.0 >= 14_000, "{samples:?}");
        let log = read_log(&path).unwrap();
        assert_eq!((log.cut, log.serial.len()), (None, ticks.2), "every byte that the ticks were given");
        let (at_ms, code) = dated(&name).unwrap();
        assert!(at_ms.abs_diff(start_ms + 25_000) <= 1000 && code == "board-lost", "{name}");
        fs::remove_dir_all(folder).unwrap();
    }

    #[test]
    fn requests_of_last_ten_seconds_are_in_the_file() {
        let mut recorder = recorder("asked");
        for tick in 0..=20_000 {
            if tick % 5000 == 0 {
                let (who, what) = (format!("certificate {tick}"), "tare".into());
                let asked = Asked { who, what, accepted: true, answer: String::new(), times: 1 };
                recorder.add_asked(tick * 1_000_000, asked);
            }
            tell(&mut recorder, tick, tick, None);
        }
        let path = tell(&mut recorder, 20_001, 20_001, Some(BoardFault::Lost.of(0))).unwrap();
        let folder = recorder.folder.clone();
        drop(recorder);
        let records = LogReader::open(&path).unwrap();
        let asked = records.filter_map(|record| match record {
            Record::Asked(time_ns, asked) => Some((time_ns / 1_000_000, asked.who)),
            _ => None,
        });
        let expected = [15_000, 20_000].map(|tick| (tick, format!("certificate {tick}")));
        assert_eq!(asked.collect::<Vec<_>>(), expected);
        fs::remove_dir_all(folder).unwrap();
    }

    #[test]
    fn memory_is_bounded_and_shared_with_the_file_writer() {
        let mut recorder = recorder("memory");
        let (jobs, disk) = sync_channel(JOBS_MAX);
        let (say, said) = channel();
        recorder.writer = Writer { jobs, say, said, thread: None };
        let mut rooms = Vec::new();
        for tick in 0..60_000 {
            let fault = (tick % 20_000 == 19_999).then_some(BoardFault::Silent.of(0));
            tell(&mut recorder, tick, tick, fault);
            let Kept { samples, ticks, states, asked: _ } = &recorder.kept;
            assert!(samples.len() <= 11_001 && ticks.len() <= 11_001 && states.len() <= 12);
            if tick % 20_000 == 19_999 {
                rooms.push((samples.capacity(), ticks.capacity(), states.capacity()));
                if let Ok(Job { kept, .. }) = disk.try_recv() {
                    // One allocation a record, whoever holds it: none is copied for the file.
                    let shared = |(here, there): (&Arc<Sample>, &Arc<Sample>)| Arc::ptr_eq(here, there);
                    assert!(samples.iter().zip(&kept.samples).all(shared));
                    assert!(ticks.iter().zip(&kept.ticks).all(|(here, there)| Arc::ptr_eq(here, there)));
                }
            }
        }
        assert!(rooms.windows(2).all(|pair| pair[0] == pair[1]), "it grows: {rooms:?}");
        fs::remove_dir_all(&recorder.folder).unwrap();
    }

    #[test]
    fn short_run_is_written_from_its_first_known_state() {
        for (lost, begins, state) in [(0, 0, None), (500, 1001, Some(1000))] {
            let mut recorder = recorder(&format!("short-{lost}"));
            for tick in lost..3000 {
                tell(&mut recorder, tick, tick, None);
            }
            let path = tell(&mut recorder, 3000, 3000, Some(BoardFault::Lost.of(0))).unwrap();
            let folder = recorder.folder.clone();
            drop(recorder);
            let [states, ticks, _] = held(&path);
            assert_eq!((states.0, states.2 > 0), (state.unwrap_or_default(), state.is_some()));
            assert_eq!((ticks.0, ticks.1), (begins, 3000));
            fs::remove_dir_all(folder).unwrap();
        }
    }

    #[test]
    fn a_file_that_the_disk_has_no_time_for_is_said() {
        let mut recorder = recorder("behind");
        let (jobs, _disk) = sync_channel(1);
        let (say, said) = channel();
        recorder.writer = Writer { jobs, say, said, thread: None };
        assert!(recorder.add(&sample(1, Some(BoardFault::Lost.of(0)))).is_some());
        assert_eq!(recorder.trouble(), None);
        assert_eq!(recorder.add(&sample(2, Some(BoardFault::Silent.of(0)))), None, "there is no such file");
        let said = recorder.trouble().expect("a file is missing");
        assert!(said.contains("board-silent") && said.contains("the disk is behind"), "{said}");
        fs::remove_dir_all(&recorder.folder).unwrap();
    }

    /// Waits until the thread has written what it was asked for: a finished file is followed by one that is not asked for.
    fn settled(recorder: &FlightRecorder) {
        let done = recorder.folder.join("done");
        let _ = fs::remove_file(&done);
        while recorder.writer.jobs.send(Job { path: done.clone(), kept: Kept::default() }).is_err() {}
        while !done.exists() {
            std::thread::yield_now();
        }
        fs::remove_file(done).unwrap();
    }

    #[test]
    fn fault_writes_ten_seconds_once_operator_stop_nothing() {
        let mut recorder = recorder("once");
        for tick in 0..12_000 {
            assert_eq!(recorder.add(&sample(tick, None)), None);
        }
        let path = recorder.add(&sample(12_000, Some(BoardFault::Lost.of(0)))).unwrap();
        assert_eq!(recorder.add(&sample(12_001, Some(BoardFault::Lost.of(0)))), None);
        recorder.add(&sample(12_002, None));
        assert_eq!(recorder.add(&sample(12_003, Some(Fault::OperatorStop))), None);
        settled(&recorder);
        let log = read_log(&path).unwrap();
        assert_eq!((log.samples.first().unwrap().tick, log.samples.last().unwrap().tick), (2000, 12_000));
        assert_eq!((log.samples.last().unwrap().fault, log.cut), (Some(BoardFault::Lost.of(0)), None));
        fs::remove_dir_all(&recorder.folder).unwrap();
    }

    #[test]
    fn flapping_cause_displaces_no_other_file() {
        let mut recorder = recorder("flapping");
        let mut files = Vec::new();
        let mut lost = None;
        // The board is silent every five seconds, and lost once.
        for round in 0..60 {
            recorder.add(&sample(5000 * round, None));
            files.extend(recorder.add(&sample(5000 * round + 500, Some(BoardFault::Silent.of(0)))));
            if round == 30 {
                lost = recorder.add(&sample(5000 * round + 600, Some(BoardFault::Lost.of(0))));
            }
            // Without a loop's pace the disk would be behind.
            settled(&recorder);
        }
        assert_eq!(files.len(), 60, "each stop has its own");
        assert!(
            lost.expect("another cause is another stop").exists(),
            "the file that matters was pushed out"
        );
        assert!(files[0].exists(), "how it began was pushed out");
        assert!(files[59].exists());
        assert_eq!(fs::read_dir(&recorder.folder).unwrap().count(), FILES_MAX);
        assert_eq!(recorder.trouble(), None);
        fs::remove_dir_all(&recorder.folder).unwrap();
    }

    #[test]
    fn a_folder_that_cannot_be_written_is_said_at_once() {
        let mut recorder = recorder("gone");
        fs::remove_dir_all(&recorder.folder).unwrap();
        recorder.add(&sample(1, Some(BoardFault::Lost.of(0)))).unwrap();
        let said = recorder.writer.said.recv().unwrap();
        assert!(said.contains("cannot create the log") && said.contains("board-lost"), "{said}");

        // One that cannot be made, and one that is there and takes no file.
        for folder in ["/proc/mocad", "/proc"] {
            let mut config = Config::default();
            config.flight_recorder.folder = folder.into();
            let refused = FlightRecorder::new(&config, RobotDescription::default()).err().unwrap();
            assert!(format!("{refused:#}").contains(folder), "{refused:#}");
        }
        assert!(auto_folder().is_absolute(), "wherever mocad is started");
    }

    #[test]
    fn second_file_of_a_series_is_removed_first() {
        const BEGIN_MS: u64 = 1_700_000_000_000;
        let recorder = recorder("stories");
        let file = |at_ms: u64| recorder.folder.join(file_name(BEGIN_MS + at_ms, "board-slow", true));
        let remain = |times_ms: &[u64]| -> Vec<u64> {
            times_ms.iter().for_each(|at_ms| fs::write(file(*at_ms), "").unwrap());
            forget_surplus(&recorder.folder);
            let (remain, gone): (Vec<u64>, Vec<u64>) =
                times_ms.iter().partition(|at_ms| file(**at_ms).exists());
            assert_eq!(remain.len(), FILES_MAX);
            remain.iter().for_each(|at_ms| fs::remove_file(file(*at_ms)).unwrap());
            gone
        };
        let every_minute: Vec<u64> = (0..=FILES_MAX as u64).map(|i| i * STORY_MS).collect();
        assert_eq!(remain(&every_minute), [0]);
        let mut once_sooner = every_minute;
        once_sooner[5] -= 1;
        assert_eq!(remain(&once_sooner), [5 * STORY_MS - 1]);
        fs::remove_dir_all(&recorder.folder).unwrap();
    }

    #[test]
    fn a_file_is_named_after_date_and_cause() {
        let name = file_name(1_764_072_184_512, "host-starved", false);
        assert_eq!(name, "2025-11-25T12-03-04_host-starved.mcap");
        assert_eq!(dated(&name), Some((1_764_072_184_000, "host-starved")));
        let fine = file_name(1_764_072_184_512, "host-starved", true);
        assert_eq!(dated(&fine), Some((1_764_072_184_512, "host-starved")));
        for other in ["run.mcap", "2025-11-25T12-03-04_demo.mcap", "2025-11-25_host-starved.mcap"] {
            assert_eq!(dated(other), None, "{other}");
        }
    }

    #[test]
    fn surplus_files_go_and_others_are_not_touched() {
        let recorder = recorder("oldest");
        let of = |at_ms: u64, cause: &str| recorder.folder.join(file_name(at_ms, cause, true));
        for i in 0..FILES_MAX as u64 + 3 {
            fs::write(of(i, "board-slow"), "").unwrap();
        }
        fs::write(of(0, "board-lost"), "").unwrap();
        fs::write(recorder.folder.join("mine.mcap"), "").unwrap();
        forget_surplus(&recorder.folder);
        assert_eq!(fs::read_dir(&recorder.folder).unwrap().count(), FILES_MAX + 1);
        assert!(!of(3, "board-slow").exists());
        assert!(of(0, "board-lost").exists());
        assert!(recorder.folder.join("mine.mcap").exists());
        fs::remove_dir_all(&recorder.folder).unwrap();
    }
}
