//! The flight recorder: when a fault stops the robot, the last seconds write themselves into a log of their own, with
//! configuration, calibration and contact limits. Works on the observers' side of the rings.

use crate::config::{AUTO_FOLDER, Config};
use crate::record::recording::{configuration, parameter_change, unix_now_ns};
use crate::record::tick_log::{PortEvent, TickRecord};
use anyhow::{Context, Result};
use moca_msgs::{Fault, Mode, Sample};
use moca_telemetry::RobotDescription;
use moca_telemetry::log::records::Configuration;
use moca_telemetry::log::{LogError, LogWriter, Meta, SerialBytes};
use std::collections::VecDeque;
use std::fs::{self, File};
use std::io::BufWriter;
use std::path::{Path, PathBuf};
use std::thread::JoinHandle;

/// How much of the past is kept, ns.
pub const KEPT_NS: u64 = 10_000_000_000;
/// Files kept in the folder; the oldest goes first.
pub const FILES_MAX: usize = 20;
const PREFIX: &str = "mocad-fault-";

/// Keeps the last [`KEPT_NS`] and writes them at the edge into a stop by a fault.
pub struct FlightRecorder {
    folder: PathBuf,
    meta: Meta,
    configuration: Configuration,
    samples: VecDeque<Sample>,
    ticks: VecDeque<TickRecord>,
    stopped: bool,
    writer: Option<JoinHandle<()>>,
}

impl FlightRecorder {
    /// What the configuration asks for; `None` if it asks for none.
    ///
    /// # Errors
    /// The folder cannot be made, or a file that the configuration names cannot be read.
    pub fn new(config: &Config, description: RobotDescription) -> Result<Option<Self>> {
        let folder = match config.flight_recorder.folder.as_str() {
            "" => return Ok(None),
            AUTO_FOLDER => auto_folder(),
            folder => PathBuf::from(folder),
        };
        fs::create_dir_all(&folder).with_context(|| {
            format!("flight_recorder.folder = {:?}: {}", config.flight_recorder.folder, folder.display())
        })?;
        Ok(Some(Self {
            folder,
            meta: Meta { description, start_unix_ns: unix_now_ns() },
            configuration: configuration(config)?,
            samples: VecDeque::new(),
            ticks: VecDeque::new(),
            stopped: false,
            writer: None,
        }))
    }

    /// Keeps what one tick was given.
    pub fn add_tick(&mut self, record: TickRecord) {
        let now_ns = record.input.slot.now_ns;
        self.ticks.push_back(record);
        while self.ticks.front().is_some_and(|first| now_ns - first.input.slot.now_ns.min(now_ns) > KEPT_NS) {
            self.ticks.pop_front();
        }
    }

    /// Keeps one sample; at the edge into a stop by a fault, writes what is kept and returns the file.
    pub fn add(&mut self, sample: &Sample) -> Option<PathBuf> {
        self.samples.push_back(sample.clone());
        while self
            .samples
            .front()
            .is_some_and(|first| sample.time_ns - first.time_ns.min(sample.time_ns) > KEPT_NS)
        {
            self.samples.pop_front();
        }
        let stopped = matches!(sample.mode, Mode::ProtectiveStop | Mode::Fault);
        let edge = stopped && !std::mem::replace(&mut self.stopped, stopped);
        match sample.fault {
            Some(fault) if edge && fault != Fault::OperatorStop => Some(self.write(sample, fault)),
            _ => None,
        }
    }

    fn write(&mut self, last: &Sample, fault: Fault) -> PathBuf {
        let at_ms = (self.meta.start_unix_ns + last.time_ns) / 1_000_000;
        let path = self.folder.join(format!("{PREFIX}{at_ms}-{}.mcap", fault.code()));
        self.wait();
        let (samples, ticks) =
            (Vec::from_iter(self.samples.iter().cloned()), Vec::from_iter(self.ticks.iter().cloned()));
        let (folder, file) = (self.folder.clone(), path.clone());
        let (meta, configuration) = (self.meta.clone(), self.configuration.clone());
        self.writer = std::thread::Builder::new()
            .name("flight-recorder".into())
            .spawn(move || {
                if let Err(error) = write_log(&file, &meta, &configuration, (&samples, &ticks)) {
                    #[expect(clippy::print_stderr, reason = "the only one left to tell")]
                    {
                        eprintln!("mocad: {}: {error}", file.display());
                    }
                }
                forget_oldest(&folder);
            })
            .ok();
        path
    }

    fn wait(&mut self) {
        if let Some(writer) = self.writer.take() {
            // It does not panic; if it did, there is nobody left to tell.
            let _ = writer.join();
        }
    }
}

impl Drop for FlightRecorder {
    fn drop(&mut self) {
        self.wait();
    }
}

/// systemd's StateDirectory, or else the user's folder for state (XDG base directories), which outlives a reboot.
fn auto_folder() -> PathBuf {
    let folder = |name: &str| std::env::var_os(name).map(PathBuf::from).filter(|path| path.is_absolute());
    folder("STATE_DIRECTORY")
        .or_else(|| Some(folder("XDG_STATE_HOME")?.join("mocad")))
        .or_else(|| Some(folder("HOME")?.join(".local/state/mocad")))
        .unwrap_or_else(|| std::env::temp_dir().join("mocad-state"))
}

fn write_log(
    path: &Path,
    meta: &Meta,
    configuration: &Configuration,
    (samples, ticks): (&[Sample], &[TickRecord]),
) -> Result<(), LogError> {
    let file = File::create_new(path).map_err(|source| LogError::Open { path: path.into(), source })?;
    let mut log = LogWriter::new(BufWriter::new(file), meta)?;
    log.configuration(configuration)?;
    let mut ticks = ticks.iter().peekable();
    for sample in samples {
        log.sample(sample)?;
        while let Some(record) = ticks.next_if(|record| record.input.slot.tick <= sample.tick) {
            tick(&mut log, record)?;
        }
    }
    log.finish()?;
    Ok(())
}

fn tick(log: &mut LogWriter<BufWriter<File>>, record: &TickRecord) -> Result<(), LogError> {
    let slot = record.input.slot;
    for event in &record.events {
        if let PortEvent::Bytes(arrival_ns, bytes) = event {
            log.serial(&SerialBytes { arrival_ns: *arrival_ns, bytes: bytes.clone() })?;
        }
    }
    if let Some(change) = parameter_change(record) {
        log.parameter(slot.now_ns, &change)?;
    }
    log.replay(slot.now_ns, slot.tick, &record.encode())
}

/// Their names sort by time.
fn forget_oldest(folder: &Path) {
    let Ok(entries) = fs::read_dir(folder) else { return };
    let ours = |path: &PathBuf| {
        path.file_name().and_then(|name| name.to_str()).is_some_and(|name| name.starts_with(PREFIX))
    };
    let mut files: Vec<PathBuf> = entries.filter_map(|entry| Some(entry.ok()?.path())).filter(ours).collect();
    files.sort_unstable();
    let surplus = files.len().saturating_sub(FILES_MAX);
    for file in files.drain(..surplus) {
        // Somebody else may have removed it.
        let _ = fs::remove_file(file);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use moca_telemetry::log::read_log;

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

    #[test]
    fn a_fault_writes_the_last_ten_seconds_once_and_an_operators_stop_nothing() {
        let mut recorder = recorder("once");
        for tick in 0..12_000 {
            assert_eq!(recorder.add(&sample(tick, None)), None);
        }
        let path = recorder.add(&sample(12_000, Some(Fault::BoardLost))).unwrap();
        assert_eq!(recorder.add(&sample(12_001, Some(Fault::BoardLost))), None);
        recorder.add(&sample(12_002, None));
        assert_eq!(recorder.add(&sample(12_003, Some(Fault::OperatorStop))), None);
        recorder.wait();
        let log = read_log(&path).unwrap();
        assert_eq!((log.samples.first().unwrap().tick, log.samples.last().unwrap().tick), (2000, 12_000));
        assert_eq!((log.samples.last().unwrap().fault, log.cut), (Some(Fault::BoardLost), None));
        fs::remove_dir_all(&recorder.folder).unwrap();
    }

    #[test]
    fn the_oldest_files_are_forgotten_and_others_are_not_touched() {
        let recorder = recorder("oldest");
        for i in 0..FILES_MAX + 3 {
            fs::write(recorder.folder.join(format!("{PREFIX}{:03}-x.mcap", i)), "").unwrap();
        }
        fs::write(recorder.folder.join("mine.mcap"), "").unwrap();
        forget_oldest(&recorder.folder);
        assert_eq!(fs::read_dir(&recorder.folder).unwrap().count(), FILES_MAX + 1);
        assert!(!recorder.folder.join(format!("{PREFIX}002-x.mcap")).exists());
        assert!(recorder.folder.join("mine.mcap").exists());
        fs::remove_dir_all(&recorder.folder).unwrap();
    }
}
