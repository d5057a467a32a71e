//! `--record`: every sample and every byte of the board into a log, from the observers' side of the rings.

use anyhow::Result;
use moca_msgs::Sample;
use moca_tactile::BoardEvent;
use moca_telemetry::RobotDescription;
use moca_telemetry::log::{LogSummary, Meta, Recorder, SerialBytes};
use std::path::Path;
use std::time::{Duration, SystemTime, UNIX_EPOCH};

/// Samples and events on their way to the recorder.
const RING: usize = 4096;
/// How long to wait when the disk is behind.
const WAIT: Duration = Duration::from_millis(1);

/// A log that is being written.
pub struct Recording {
    recorder: Recorder,
    samples: rtrb::Producer<Sample>,
    copies: rtrb::Consumer<BoardEvent>,
}

impl Recording {
    /// Creates `path`, which must not exist. The second value is where the loop puts copies of the board's events.
    ///
    /// # Errors
    /// The file exists or cannot be created.
    pub fn create(
        path: &Path,
        description: RobotDescription,
        live: bool,
    ) -> Result<(Self, rtrb::Producer<BoardEvent>)> {
        let start = if live {
            SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default()
        } else {
            Duration::ZERO
        };
        let start_unix_ns = u64::try_from(start.as_nanos()).unwrap_or(0);
        let (samples, from_here) = rtrb::RingBuffer::new(RING);
        let (copies_in, copies) = rtrb::RingBuffer::new(RING);
        let recorder = Recorder::create(path, &Meta { description, start_unix_ns }, from_here)?;
        Ok((Self { recorder, samples, copies }, copies_in))
    }

    /// Adds one sample and the bytes that came before it; waits while the disk is behind (never on the loop's thread
    /// of a live run).
    pub fn add(&mut self, sample: &Sample) {
        while let Ok(event) = self.copies.pop() {
            if let BoardEvent::Bytes(chunk) = event {
                let bytes = SerialBytes { arrival_ns: chunk.arrival_ns, bytes: chunk.bytes().to_vec() };
                self.recorder.serial().offer(bytes);
            }
        }
        while self.samples.is_full() && self.recorder.is_recording() {
            std::thread::sleep(WAIT);
        }
        // After an error of the disk nobody takes samples any more; `finish` tells it.
        let _ = self.samples.push(sample.clone());
    }

    /// Writes what waits, the index and the end mark.
    ///
    /// # Errors
    /// The disk refused a write during the run or now.
    pub fn finish(self) -> Result<LogSummary> {
        Ok(self.recorder.finish()?)
    }
}
