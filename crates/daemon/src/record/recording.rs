//! `--record`: every sample, every byte of the boards and what a replay needs into a log, from the clients' side of the
//! rings.

use crate::config::Config;
use crate::record::tick_blocks::BlockBuilder;
use crate::record::tick_log::{PortEvent, TickRecord};
use anyhow::Result;
use moca_msgs::{Request, Sample, params::CONTROLLER};
use moca_tactile::calibration::read_text;
use moca_telemetry::RobotDescription;
use moca_telemetry::audit::Asked;
use moca_telemetry::log::records::{Configuration, ParameterChange};
use moca_telemetry::log::{LogError, LogSummary, Meta, Recorder, RecorderOptions, SerialBytes};
use moca_telemetry::net::wire::unix_now_ns;
use std::io::Write;
use std::path::Path;
use std::time::Duration;

/// Samples on their way to the recorder.
const RING: usize = 4096;
/// A board's bytes of so long are one message of the log, ns: hundreds of reads a second would each pay for its own.
const TOGETHER_NS: u64 = 100_000_000;
/// Wait while the disk is behind.
const WAIT: Duration = Duration::from_millis(1);

/// A log that is being written.
pub struct Recording {
    recorder: Recorder,
    samples: rtrb::Producer<Sample>,
    blocks: BlockBuilder,
    /// Bytes that wait for more of their board.
    bytes: Vec<SerialBytes>,
    live: bool,
    lost: u64,
    told: bool,
}

impl Recording {
    /// Creates `path`, which must not exist, and another file each `split` of loop time.
    ///
    /// # Errors
    /// The file exists or cannot be created, or the calibration file cannot be read.
    pub fn create(
        path: &Path,
        split: Option<Duration>,
        description: RobotDescription,
        config: &Config,
        live: bool,
    ) -> Result<Self> {
        Self::with(description, config, live, |meta, samples| {
            let options = RecorderOptions { wait: !live, split };
            Recorder::create(path, meta, samples, options)
        })
    }

    /// Records onto anything that can be written to.
    ///
    /// # Errors
    /// It refuses the first write, or the calibration file cannot be read.
    pub fn start(
        output: impl Write + Send + 'static,
        description: RobotDescription,
        config: &Config,
        live: bool,
    ) -> Result<Self> {
        Self::with(description, config, live, |meta, samples| Recorder::start(output, meta, samples, !live))
    }

    fn with(
        description: RobotDescription,
        config: &Config,
        live: bool,
        recorder: impl FnOnce(&Meta, rtrb::Consumer<Sample>) -> Result<Recorder, LogError>,
    ) -> Result<Self> {
        let (samples, from_here) = rtrb::RingBuffer::new(RING);
        let meta = Meta { description, start_unix_ns: if live { unix_now_ns() } else { 0 } };
        let configuration = configuration(config)?;
        let recorder = recorder(&meta, from_here)?;
        recorder.configuration(configuration);
        let blocks = BlockBuilder::new(1.0 / f64::from(config.control_loop.rate_hz));
        Ok(Self { recorder, samples, blocks, bytes: Vec::new(), live, lost: 0, told: false })
    }

    /// Adds what one tick was given. A live run does not wait for its disk: what finds no room counts as lost.
    pub fn add_tick(&mut self, record: &TickRecord) {
        let time_ns = record.input.slot.now_ns;
        for (board, event) in &record.events {
            if let PortEvent::Bytes(arrival_ns, bytes) = event {
                self.add_bytes(*board, *arrival_ns, bytes);
            }
        }
        if let Some(change) = parameter_change(record) {
            self.recorder.parameter(time_ns, change);
        }
        self.lost = record.lost;
        if let Some((time_ns, block)) = self.blocks.tick(record.clone()) {
            self.recorder.replay(time_ns, block);
        }
    }

    /// Adds what was read of a board; each read's own time is in the blocks.
    fn add_bytes(&mut self, board: u8, arrival_ns: u64, bytes: &[u8]) {
        match self.bytes.iter_mut().find(|waiting| waiting.board == board) {
            Some(waiting) if arrival_ns.saturating_sub(waiting.arrival_ns) < TOGETHER_NS => {
                waiting.bytes.extend_from_slice(bytes);
            }
            Some(waiting) => {
                let next = SerialBytes { board, arrival_ns, bytes: bytes.to_vec() };
                self.recorder.serial(std::mem::replace(waiting, next));
            }
            None => self.bytes.push(SerialBytes { board, arrival_ns, bytes: bytes.to_vec() }),
        }
    }

    /// Adds one sample, like [`Recording::add_tick`].
    pub fn add(&mut self, sample: &Sample) {
        while !self.live && self.samples.is_full() && self.recorder.is_recording() {
            std::thread::sleep(WAIT);
        }
        // After an error of the disk nobody takes samples any more; `trouble` tells it.
        let _ = self.samples.push(sample.clone());
        if let Some((time_ns, block)) = self.blocks.sample(sample) {
            self.recorder.replay(time_ns, block);
        }
    }

    /// Adds what a driver of the robot said.
    pub fn add_words(&self, time_ns: u64, words: &str) {
        self.recorder.driver(time_ns, words);
    }

    /// Adds what clients asked and were answered.
    pub fn add_asked(&self, time_ns: u64, asked: Asked) {
        self.recorder.asked(time_ns, asked);
    }

    /// Why nothing is recorded any more: once, as soon as that is so.
    pub fn trouble(&mut self) -> Option<String> {
        let failure = self.recorder.failure().filter(|_| !self.told)?.to_owned();
        self.told = true;
        Some(failure)
    }

    /// Writes what waits, the index and the end mark. Ticks and board events that found no room count as dropped.
    ///
    /// # Errors
    /// The disk refused a write during the run or now.
    pub fn finish(mut self) -> Result<LogSummary> {
        for (time_ns, block) in self.blocks.finish() {
            self.recorder.replay(time_ns, block);
        }
        std::mem::take(&mut self.bytes).into_iter().for_each(|bytes| self.recorder.serial(bytes));
        let summary = self.recorder.finish()?;
        Ok(LogSummary { dropped: summary.dropped + self.lost, ..summary })
    }
}

/// Returns the configuration of a run, with the texts of the files that it names.
///
/// # Errors
/// One of them cannot be read.
pub fn configuration(config: &Config) -> Result<Configuration> {
    let text = |path: &str| if path.is_empty() { Ok(String::new()) } else { read_text(Path::new(path)) };
    Ok(Configuration {
        version: crate::VERSION.into(),
        toml: toml::to_string(&config.to_toml())?,
        calibration: text(&config.board.calibration)?,
        contact_limits: text(&config.protection.thresholds)?,
    })
}

/// The change of a parameter that this tick accepted, if it did.
pub fn parameter_change(record: &TickRecord) -> Option<ParameterChange> {
    let (Some(Request::SetParameter { parameter, values }), Some(Ok(()))) =
        (record.input.request, record.input.outcome)
    else {
        return None;
    };
    let name = CONTROLLER.get(usize::from(parameter))?.name.to_owned();
    Some(ParameterChange { tick: record.input.slot.tick, name, values: values.as_slice().to_vec() })
}
