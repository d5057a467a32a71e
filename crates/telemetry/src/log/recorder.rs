//! A log writer on a thread of its own.

use super::{
    LogError, SerialBytes,
    records::{Configuration, ParameterChange},
    writer::{LogSummary, LogWriter, Meta},
};
use moca_msgs::Sample;
use rtrb::Consumer;
use std::{
    fs::File,
    io::{BufWriter, Write},
    path::Path,
    sync::{
        Arc,
        atomic::{AtomicBool, AtomicU64, Ordering},
        mpsc::{Receiver, SyncSender, sync_channel},
    },
    thread::JoinHandle,
    time::{Duration, Instant},
};

/// What reaches the recorder besides samples.
enum Entry {
    Serial(SerialBytes),
    Replay { time_ns: u64, tick: u64, bytes: Vec<u8> },
    Parameter { time_ns: u64, change: ParameterChange },
    Configuration(Box<Configuration>),
}

/// Most entries that wait for the recorder: over 10 s of a Touch Board.
const MAX_SERIAL: usize = 4096;
/// How often the rings are looked at.
const POLL: Duration = Duration::from_millis(5);
/// How often an unfinished chunk is ended, so that a slow loop's samples are not held back.
const FLUSH_PERIOD: Duration = Duration::from_millis(500);

/// Records samples and serial bytes to a file until [`Recorder::finish`].
pub struct Recorder {
    serial: SerialInput,
    entries_wait: bool,
    stop: Arc<AtomicBool>,
    thread: JoinHandle<Result<LogSummary, LogError>>,
}

/// Where the Touch Board's bytes go; never blocks.
#[derive(Clone, Debug)]
pub struct SerialInput {
    sender: SyncSender<Entry>,
    dropped: Arc<AtomicU64>,
}

impl SerialInput {
    /// Hands one read over; without room it is dropped and counted.
    pub fn offer(&self, serial: SerialBytes) {
        if self.sender.try_send(Entry::Serial(serial)).is_err() {
            self.dropped.fetch_add(1, Ordering::Relaxed);
        }
    }
}

impl Recorder {
    /// Creates `path`, which must not exist, and records every sample of `samples` into it.
    pub fn create(path: &Path, meta: &Meta, samples: Consumer<Sample>) -> Result<Self, LogError> {
        let file = File::create_new(path).map_err(|source| LogError::Create { path: path.into(), source })?;
        Self::start(file, meta, samples, false)
    }

    /// The same onto anything that can be written to. Without room entries wait for the disk, or are dropped and counted.
    pub fn start(
        output: impl Write + Send + 'static,
        meta: &Meta,
        samples: Consumer<Sample>,
        entries_wait: bool,
    ) -> Result<Self, LogError> {
        let log = LogWriter::new(BufWriter::new(output), meta)?;
        let (sender, serial) = sync_channel(MAX_SERIAL);
        let dropped = Arc::new(AtomicU64::new(0));
        let stop = Arc::new(AtomicBool::new(false));
        let (thread_stop, thread_dropped) = (Arc::clone(&stop), Arc::clone(&dropped));
        let thread = std::thread::Builder::new()
            .name("recorder".into())
            .spawn(move || record(log, samples, &serial, &thread_dropped, &thread_stop))
            .map_err(LogError::Thread)?;
        Ok(Self { serial: SerialInput { sender, dropped }, entries_wait, stop, thread })
    }

    /// Where the Touch Board's bytes go.
    pub fn serial(&self) -> SerialInput {
        self.serial.clone()
    }

    /// Records how the run is configured.
    pub fn configuration(&self, configuration: Configuration) {
        self.put(Entry::Configuration(Box::new(configuration)));
    }

    /// Records what a replay needs of one tick.
    pub fn replay(&self, time_ns: u64, tick: u64, bytes: Vec<u8>) {
        self.put(Entry::Replay { time_ns, tick, bytes });
    }

    /// Records a change of a parameter.
    pub fn parameter(&self, time_ns: u64, change: ParameterChange) {
        self.put(Entry::Parameter { time_ns, change });
    }

    fn put(&self, entry: Entry) {
        // After an error of the disk nobody takes entries any more; `finish` tells it.
        let sent = if self.entries_wait {
            self.serial.sender.send(entry).is_ok()
        } else {
            self.serial.sender.try_send(entry).is_ok()
        };
        if !sent {
            self.serial.dropped.fetch_add(1, Ordering::Relaxed);
        }
    }

    /// Whether it still records; `false` after an error, which [`Self::finish`] tells.
    pub fn is_recording(&self) -> bool {
        !self.thread.is_finished()
    }

    /// Writes what is still waiting, index and end mark. Call it when nothing fills the ring any more.
    pub fn finish(self) -> Result<LogSummary, LogError> {
        self.stop.store(true, Ordering::Release);
        self.thread.join().map_err(|_| LogError::Panicked)?
    }
}

fn record<W: Write>(
    mut log: LogWriter<W>,
    mut samples: Consumer<Sample>,
    entries: &Receiver<Entry>,
    serial_dropped: &AtomicU64,
    stop: &AtomicBool,
) -> Result<LogSummary, LogError> {
    let mut flushed = Instant::now();
    loop {
        // Looked at before draining: what was there when the stop came is written.
        let last_round = stop.load(Ordering::Acquire);
        while let Ok(sample) = samples.pop() {
            log.sample(&sample)?;
        }
        for entry in entries.try_iter() {
            match entry {
                Entry::Serial(bytes) => log.serial(&bytes)?,
                Entry::Replay { time_ns, tick, bytes } => log.replay(time_ns, tick, &bytes)?,
                Entry::Parameter { time_ns, change } => log.parameter(time_ns, &change)?,
                Entry::Configuration(configuration) => log.configuration(&configuration)?,
            }
        }
        if last_round {
            log.note_serial_dropped(serial_dropped.load(Ordering::Relaxed));
            return log.finish();
        }
        if flushed.elapsed() >= FLUSH_PERIOD {
            log.flush()?;
            flushed = Instant::now();
        }
        std::thread::sleep(POLL);
    }
}
