//! A log of what this dashboard receives. The daemon's own (`mocad --record`) also holds the board's bytes and misses
//! nothing when the dashboard is slow.

use moca_msgs::{Sample, seconds};
use moca_telemetry::{
    RobotDescription,
    log::{LogError, Meta, Recorder, RecorderOptions},
};
use std::{
    path::{Path, PathBuf},
    time::{Duration, SystemTime, UNIX_EPOCH},
};

/// Samples on their way to the disk: four seconds at 1 kHz.
const RING: usize = 4096;

/// A log that is being written.
pub struct Recording {
    path: PathBuf,
    recorder: Recorder,
    samples: rtrb::Producer<Sample>,
    offered: u64,
    dropped: u64,
    first_s: f64,
    last_s: f64,
}

impl Recording {
    /// Creates a log of `robot` in `folder`, named after the robot and the time; loop time `now_ns` is now.
    ///
    /// # Errors
    /// The file cannot be created.
    pub fn start(folder: &Path, robot: &RobotDescription, now_ns: u64) -> Result<Self, LogError> {
        let now = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default();
        let start = now.saturating_sub(Duration::from_nanos(now_ns));
        let start_unix_ns = u64::try_from(start.as_nanos()).unwrap_or(0);
        let path = folder.join(format!("{}-{}.mcap", plain(&robot.name), utc_stamp_now()));
        let (samples, from_here) = rtrb::RingBuffer::new(RING);
        let meta = Meta { description: robot.clone(), start_unix_ns };
        let recorder = Recorder::create(&path, &meta, from_here, RecorderOptions::default())?;
        let at_s = seconds(now_ns);
        Ok(Self { path, recorder, samples, offered: 0, dropped: 0, first_s: at_s, last_s: at_s })
    }

    /// Adds a sample; without room, which a full disk or a slow one leaves, it is dropped and counted.
    pub fn add(&mut self, sample: &Sample) {
        self.offered += 1;
        self.last_s = seconds(sample.time_ns);
        self.dropped += u64::from(self.samples.push(sample.clone()).is_err());
    }

    /// Returns true while it writes; `false` after an error of the disk, which [`Self::finish`] returns.
    pub fn is_writing(&self) -> bool {
        self.recorder.is_recording()
    }

    /// Describes its progress.
    pub fn progress(&self) -> String {
        let lost = if self.dropped > 0 { format!(", {} lost", self.dropped) } else { String::new() };
        format!("recording {}: {:.0} s{lost}", self.path.display(), self.last_s - self.first_s)
    }

    /// Ends the file and says what is in it, or what went wrong.
    pub fn finish(self) -> Result<String, String> {
        let (path, dropped) = (self.path.display().to_string(), self.dropped);
        let summary = self.recorder.finish().map_err(|error| format!("{path}: {error}"))?;
        let lost = if dropped > 0 { format!(", {dropped} lost: the disk is slow") } else { String::new() };
        Ok(format!("saved {path}: {} samples{lost}", summary.samples))
    }
}

/// A name that is a file's name everywhere.
pub fn plain(name: &str) -> String {
    name.replace(|c: char| !c.is_alphanumeric(), "-")
}

/// Now as `YYYYMMDD-HHMMSS` in UTC, for a file's name.
pub fn utc_stamp_now() -> String {
    utc_stamp(SystemTime::now())
}

fn utc_stamp(time: SystemTime) -> String {
    let stamp = humantime::format_rfc3339_seconds(time).to_string();
    stamp.replace(['-', ':', 'Z'], "").replace('T', "-")
}

#[cfg(test)]
mod tests {
    use super::*;
    use moca_telemetry::log::read_log;

    #[test]
    fn what_was_received_is_in_the_file_under_the_robot_s_name() {
        let folder = std::env::temp_dir().join(format!("moca-recording-{}", std::process::id()));
        std::fs::create_dir_all(&folder).unwrap();
        let robot = RobotDescription::paper("lab 1", true);
        let mut recording = Recording::start(&folder, &robot, 5_000_000_000).unwrap();
        for tick in 5000..5300 {
            recording.add(&Sample { tick, time_ns: tick * 1_000_000, ..Sample::default() });
        }
        let path = recording.path.clone();
        assert!(path.file_name().unwrap().to_str().unwrap().starts_with("lab-1-20"));
        assert!(recording.finish().unwrap().contains("300 samples"));
        let log = read_log(&path).unwrap();
        assert_eq!((log.description.name.as_str(), log.samples.len(), log.cut), ("lab 1", 15, None));
        assert_eq!((log.samples[0].tick, log.samples[0].time_ns), (5000, 5_000_000_000));
        std::fs::remove_dir_all(&folder).unwrap();
    }

    #[test]
    fn a_folder_that_cannot_be_written_is_an_error() {
        let robot = RobotDescription::paper("lab", true);
        assert!(Recording::start(Path::new("/no/such/folder"), &robot, 0).is_err());
    }

    #[test]
    fn a_stamp_is_date_and_time_without_signs() {
        let leap_day = UNIX_EPOCH + Duration::from_secs(951_782_400 + 3661);
        assert_eq!(utc_stamp(leap_day), "20000229-010101");
    }
}
