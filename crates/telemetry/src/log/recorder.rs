//! A log writer on a thread of its own.

use super::{
    LogError, SerialBytes, create_file,
    own_file::OwnFile,
    records::{Configuration, DriverWords, ParameterChange},
    writer::{LogSummary, LogWriter, Meta},
};
use crate::audit::Asked;
use moca_msgs::Sample;
use rtrb::Consumer;
use std::{
    io::{BufWriter, Write},
    path::{Path, PathBuf},
    sync::{
        Arc, OnceLock,
        atomic::{AtomicBool, AtomicU64, Ordering},
        mpsc::{Receiver, SyncSender, sync_channel},
    },
    thread::JoinHandle,
    time::{Duration, Instant},
};

/// Entry for the recorder other than a sample.
enum Entry {
    Serial(SerialBytes),
    Replay { time_ns: u64, block: Vec<u8> },
    Parameter { time_ns: u64, change: ParameterChange },
    Driver { time_ns: u64, words: DriverWords },
    Asked { time_ns: u64, asked: Asked },
    Configuration(Box<Configuration>),
}

/// Most entries that wait for the recorder: over 10 s of a Touch Board.
const MAX_ENTRIES: usize = 4096;
/// Period at which the rings are read: they hold four seconds, and each wake-up costs.
const POLL: Duration = Duration::from_millis(50);
/// Period of a run that has no clock, which would wait for the recorder.
const POLL_WITHOUT_CLOCK: Duration = Duration::from_millis(5);
/// After how long a chunk is ended that a loop which stands still leaves unfinished. A loop that runs ends each after half a
/// second of its own time: to end one between would cost a log its repeated first records.
const FLUSH_AFTER: Duration = Duration::from_secs(1);

/// Options of a recorder.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct RecorderOptions {
    /// Without room entries wait for the disk instead of being dropped and counted: for a run that has no clock.
    pub wait: bool,
    /// Begin another file after so much loop time; see [`part_path`].
    pub split: Option<Duration>,
}

/// Records samples, the board's bytes and what a replay needs until [`Recorder::finish`].
pub struct Recorder {
    entries: SyncSender<Entry>,
    dropped: Arc<AtomicU64>,
    failure: Arc<OnceLock<String>>,
    wait: bool,
    stop: Arc<AtomicBool>,
    thread: JoinHandle<Result<LogSummary, LogError>>,
}

type Output = BufWriter<Box<dyn Write + Send>>;
/// Opens part N of a log, the first being 1.
type Parts = Box<dyn FnMut(u64) -> Result<Output, LogError> + Send>;

/// The file of part `number` of a log that is split: `run.mcap`, `run-2.mcap`, `run-3.mcap`, ….
pub fn part_path(path: &Path, number: u64) -> PathBuf {
    if number <= 1 {
        return path.into();
    }
    let stem = path.file_stem().unwrap_or_default().to_string_lossy();
    let extension = path.extension().map(|e| format!(".{}", e.to_string_lossy())).unwrap_or_default();
    path.with_file_name(format!("{stem}-{number}{extension}"))
}

impl Recorder {
    /// Creates `path`, which must not exist, and records every sample of `samples` into it.
    ///
    /// # Errors
    /// The file exists, cannot be created or refuses the first write; or no thread.
    pub fn create(
        path: &Path,
        meta: &Meta,
        samples: Consumer<Sample>,
        options: RecorderOptions,
    ) -> Result<Self, LogError> {
        let path = path.to_owned();
        let parts = move |number| {
            let path = part_path(&path, number);
            let file = create_file(&path).map_err(|cause| LogError::Create { path, cause })?;
            Ok(BufWriter::new(Box::new(OwnFile::new(file)) as Box<dyn Write + Send>))
        };
        Self::start_parts(Box::new(parts), meta, samples, options)
    }

    /// Records onto anything that can be written to, in one part.
    ///
    /// # Errors
    /// As for [`Self::create`].
    pub fn start(
        output: impl Write + Send + 'static,
        meta: &Meta,
        samples: Consumer<Sample>,
        wait: bool,
    ) -> Result<Self, LogError> {
        let mut output: Option<Box<dyn Write + Send>> = Some(Box::new(output));
        let parts = move |_| output.take().map(BufWriter::new).ok_or(LogError::Panicked);
        Self::start_parts(Box::new(parts), meta, samples, RecorderOptions { wait, split: None })
    }

    fn start_parts(
        mut parts: Parts,
        meta: &Meta,
        samples: Consumer<Sample>,
        options: RecorderOptions,
    ) -> Result<Self, LogError> {
        let log = LogWriter::new(parts(1)?, meta)?;
        let (sender, entries) = sync_channel(MAX_ENTRIES);
        let dropped = Arc::new(AtomicU64::new(0));
        let stop = Arc::new(AtomicBool::new(false));
        let failure = Arc::new(OnceLock::new());
        let (thread_stop, thread_dropped) = (Arc::clone(&stop), Arc::clone(&dropped));
        let thread_failure = Arc::clone(&failure);
        let split_ns = options.split.map(|split| u64::try_from(split.as_nanos()).unwrap_or(u64::MAX));
        let mut writer = PartWriter {
            log,
            parts,
            meta: meta.clone(),
            waits: options.wait,
            split_ns,
            began_ns: None,
            part: 1,
            before: LogSummary::default(),
            configuration: None,
        };
        let thread = std::thread::Builder::new()
            .name("recorder".into())
            .spawn(move || {
                let end = writer.record(samples, &entries, &thread_stop);
                let finished = end.and_then(|()| writer.finish(thread_dropped.load(Ordering::Relaxed)));
                if let Err(error) = &finished {
                    // Set once, here.
                    let _ = thread_failure.set(error.to_string());
                }
                finished
            })
            .map_err(LogError::Thread)?;
        Ok(Self { entries: sender, dropped, failure, wait: options.wait, stop, thread })
    }

    /// Records one read of the Touch Board's port.
    pub fn serial(&self, serial: SerialBytes) {
        self.put(Entry::Serial(serial));
    }

    /// Records how the run is configured.
    pub fn configuration(&self, configuration: Configuration) {
        self.put(Entry::Configuration(Box::new(configuration)));
    }

    /// Records a block of what ticks were given.
    pub fn replay(&self, time_ns: u64, block: Vec<u8>) {
        self.put(Entry::Replay { time_ns, block });
    }

    /// Records a change of a parameter.
    pub fn parameter(&self, time_ns: u64, change: ParameterChange) {
        self.put(Entry::Parameter { time_ns, change });
    }

    /// Records what a driver of the robot said.
    pub fn driver(&self, time_ns: u64, text: &str) {
        self.put(Entry::Driver { time_ns, words: DriverWords { text: text.into() } });
    }

    /// Records what clients asked and were answered.
    pub fn asked(&self, time_ns: u64, asked: Asked) {
        self.put(Entry::Asked { time_ns, asked });
    }

    fn put(&self, entry: Entry) {
        // After an error of the disk nobody takes entries any more; `failure` tells it.
        let sent =
            if self.wait { self.entries.send(entry).is_ok() } else { self.entries.try_send(entry).is_ok() };
        if !sent {
            self.dropped.fetch_add(1, Ordering::Relaxed);
        }
    }

    /// Returns true while it records; `false` after an error.
    pub fn is_recording(&self) -> bool {
        !self.thread.is_finished()
    }

    /// Why it no longer records, as soon as that is so.
    pub fn failure(&self) -> Option<&str> {
        self.failure.get().map(String::as_str)
    }

    /// Writes what is still waiting, index and end mark. Call it when nothing fills the ring any more.
    ///
    /// # Errors
    /// The disk refused a write during the run or now.
    pub fn finish(self) -> Result<LogSummary, LogError> {
        self.stop.store(true, Ordering::Release);
        self.thread.join().map_err(|_| LogError::Panicked)?
    }
}

/// Work of the recorder's thread.
struct PartWriter {
    log: LogWriter<Output>,
    parts: Parts,
    meta: Meta,
    /// True if the run has no clock, so that a chunk may take its time.
    waits: bool,
    split_ns: Option<u64>,
    /// Loop time of the first sample in the present part.
    began_ns: Option<u64>,
    part: u64,
    /// Contents of the parts before.
    before: LogSummary,
    configuration: Option<Box<Configuration>>,
}

impl PartWriter {
    fn record(
        &mut self,
        mut samples: Consumer<Sample>,
        entries: &Receiver<Entry>,
        stop: &AtomicBool,
    ) -> Result<(), LogError> {
        let (mut chunk, mut since) = (self.log.chunk_ns(), Instant::now());
        loop {
            // Looked at before draining: what was there when the stop came is written.
            let last_round = stop.load(Ordering::Acquire);
            while let Ok(sample) = samples.pop() {
                if self.is_long_enough(sample.time_ns) {
                    // What came before goes into the part before, and how the run is configured is known to the next.
                    self.write_all(entries)?;
                    self.turn_over(sample.time_ns)?;
                }
                self.log.sample(&sample)?;
            }
            self.write_all(entries)?;
            if last_round {
                return Ok(());
            }
            if self.log.chunk_ns() != chunk {
                (chunk, since) = (self.log.chunk_ns(), Instant::now());
            } else if !self.waits && since.elapsed() >= FLUSH_AFTER {
                self.log.flush()?;
                since = Instant::now();
            }
            std::thread::sleep(if self.waits { POLL_WITHOUT_CLOCK } else { POLL });
        }
    }

    fn write_all(&mut self, entries: &Receiver<Entry>) -> Result<(), LogError> {
        entries.try_iter().try_for_each(|entry| self.write(entry))
    }

    fn write(&mut self, entry: Entry) -> Result<(), LogError> {
        match entry {
            Entry::Serial(bytes) => self.log.serial(&bytes),
            Entry::Replay { time_ns, block } => self.log.replay(time_ns, &block),
            Entry::Parameter { time_ns, change } => self.log.parameter(time_ns, &change),
            Entry::Driver { time_ns, words } => self.log.driver(time_ns, &words),
            Entry::Asked { time_ns, asked } => self.log.asked(time_ns, &asked),
            Entry::Configuration(configuration) => {
                let written = self.log.configuration(&configuration);
                self.configuration = Some(configuration);
                written
            }
        }
    }

    /// Returns true if a sample of this time begins the next part.
    fn is_long_enough(&mut self, now_ns: u64) -> bool {
        let began_ns = *self.began_ns.get_or_insert(now_ns);
        self.split_ns.is_some_and(|split_ns| now_ns.saturating_sub(began_ns) >= split_ns)
    }

    /// Begins the next part.
    fn turn_over(&mut self, now_ns: u64) -> Result<(), LogError> {
        self.part += 1;
        let next = LogWriter::new((self.parts)(self.part)?, &self.meta)?;
        let written = std::mem::replace(&mut self.log, next).finish()?;
        self.before = self.before.plus(&written);
        self.began_ns = Some(now_ns);
        if let Some(configuration) = &self.configuration {
            self.log.configuration(configuration)?;
        }
        Ok(())
    }

    fn finish(self, dropped: u64) -> Result<LogSummary, LogError> {
        let mut summary = self.before.plus(&self.log.finish()?);
        summary.dropped = dropped;
        Ok(summary)
    }
}
