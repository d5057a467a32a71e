//! `--record`: every sample, every byte of the board and what a replay needs into a log, from the observers' side of the
//! rings.

use crate::config::Config;
use crate::record::tick_log::{PortEvent, TickRecord};
use anyhow::{Context, Result};
use moca_msgs::{Request, Sample, params::CONTROLLER};
use moca_tactile::calibration::read_text;
use moca_telemetry::RobotDescription;
use moca_telemetry::log::records::{Configuration, ParameterChange};
use moca_telemetry::log::{LogSummary, Meta, Recorder, SerialBytes};
use std::fs::File;
use std::io::Write;
use std::path::Path;
use std::time::{Duration, SystemTime, UNIX_EPOCH};

/// Samples on their way to the recorder.
const RING: usize = 4096;
/// How long to wait when the disk is behind.
const WAIT: Duration = Duration::from_millis(1);

/// A log that is being written.
pub struct Recording {
    recorder: Recorder,
    samples: rtrb::Producer<Sample>,
    live: bool,
    lost: u64,
}

impl Recording {
    /// Creates `path`, which must not exist.
    ///
    /// # Errors
    /// The file exists or cannot be created, or the calibration file cannot be read.
    pub fn create(path: &Path, description: RobotDescription, config: &Config, live: bool) -> Result<Self> {
        let file = File::create_new(path).with_context(|| path.display().to_string())?;
        Self::start(file, description, config, live)
    }

    /// The same onto anything that can be written to.
    ///
    /// # Errors
    /// It refuses the first write, or the calibration file cannot be read.
    pub fn start(
        output: impl Write + Send + 'static,
        description: RobotDescription,
        config: &Config,
        live: bool,
    ) -> Result<Self> {
        let (samples, from_here) = rtrb::RingBuffer::new(RING);
        let meta = Meta { description, start_unix_ns: if live { unix_now_ns() } else { 0 } };
        let configuration = configuration(config)?;
        let recorder = Recorder::start(output, &meta, from_here, !live)?;
        recorder.configuration(configuration);
        Ok(Self { recorder, samples, live, lost: 0 })
    }

    /// Adds what one tick was given. A live run does not wait for its disk: what finds no room counts as lost.
    pub fn add_tick(&mut self, record: &TickRecord) {
        let (tick, time_ns) = (record.input.slot.tick, record.input.slot.now_ns);
        for event in &record.events {
            if let PortEvent::Bytes(arrival_ns, bytes) = event {
                let bytes = SerialBytes { arrival_ns: *arrival_ns, bytes: bytes.clone() };
                self.recorder.serial().offer(bytes);
            }
        }
        if let Some(change) = parameter_change(record) {
            self.recorder.parameter(time_ns, change);
        }
        self.lost = record.lost;
        self.recorder.replay(time_ns, tick, record.encode());
    }

    /// Adds one sample, like [`Recording::add_tick`].
    pub fn add(&mut self, sample: &Sample) {
        while !self.live && self.samples.is_full() && self.recorder.is_recording() {
            std::thread::sleep(WAIT);
        }
        // After an error of the disk nobody takes samples any more; `finish` tells it.
        let _ = self.samples.push(sample.clone());
    }

    /// Writes what waits, the index and the end mark. Ticks and board events that found no room count as dropped.
    ///
    /// # Errors
    /// The disk refused a write during the run or now.
    pub fn finish(self) -> Result<LogSummary> {
        let summary = self.recorder.finish()?;
        Ok(LogSummary { serial_dropped: summary.serial_dropped + self.lost, ..summary })
    }
}

/// Now, ns since the Unix epoch.
pub(crate) fn unix_now_ns() -> u64 {
    let now = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default();
    u64::try_from(now.as_nanos()).unwrap_or(0)
}

/// How a run is configured, with the texts of the files that its configuration names.
///
/// # Errors
/// One of them cannot be read.
pub fn configuration(config: &Config) -> Result<Configuration> {
    let text = |path: &str| if path.is_empty() { Ok(String::new()) } else { read_text(Path::new(path)) };
    Ok(Configuration {
        version: env!("CARGO_PKG_VERSION").into(),
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
