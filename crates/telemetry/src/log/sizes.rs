//! Size of a log on a disk, by purpose.

use super::{
    LogError, LogFile,
    framing::{self, Message, op},
    records::{LOOP_STATE_TOPIC, REPLAY_TOPIC, SERIAL_TOPICS},
    writer::ZSTD_LEVEL,
};
use std::collections::BTreeMap;

/// Bytes of a log. Its three parts lie in the same chunks; each is counted as if it had been compressed alone.
///
/// ```
/// use moca_msgs::Sample;
/// use moca_telemetry::log::{LogFile, LogWriter, Meta};
/// let mut bytes = Vec::new();
/// let mut writer = LogWriter::new(&mut bytes, &Meta::default())?;
/// for tick in 0..3000 {
///     writer.sample(&Sample { tick, time_ns: tick * 1_000_000, ..Sample::default() })?;
/// }
/// writer.finish()?;
/// let mut log = LogFile::over(std::io::Cursor::new(bytes), "in memory".as_ref())?;
/// let sizes = log.sizes(&mut |_part| {})?;
/// assert!(sizes.display > 10 * sizes.replay, "a replay that is not written costs the name of its channel");
/// assert!(sizes.gigabytes_per_hour(sizes.file) > sizes.gigabytes_per_hour(sizes.display));
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct LogSizes {
    /// Length of the run, ns of loop time.
    pub span_ns: u64,
    /// The whole file, bytes.
    pub file: u64,
    /// Bytes for viewers.
    pub display: u64,
    /// The Touch Boards' bytes, bytes.
    pub board: u64,
    /// Bytes for a replay.
    pub replay: u64,
}

impl LogSizes {
    /// Returns the bytes of this log as GB for each hour of the run; NaN for a run without length.
    #[expect(clippy::cast_precision_loss, reason = "a figure for people")]
    pub fn gigabytes_per_hour(&self, bytes: u64) -> f64 {
        if self.span_ns == 0 { f64::NAN } else { bytes as f64 * 3600.0 / self.span_ns as f64 }
    }
}

/// Purpose of a message.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
enum Purpose {
    Display,
    Board,
    Replay,
}

impl Purpose {
    fn of(topic: &str) -> Self {
        match topic {
            REPLAY_TOPIC | LOOP_STATE_TOPIC => Self::Replay,
            _ if SERIAL_TOPICS.contains(&topic) => Self::Board,
            _ => Self::Display,
        }
    }
}

impl LogFile {
    /// Measures the file; reads all of it. `progress` hears which part is done, 0 to 1.
    ///
    /// # Errors
    /// A chunk is damaged; the message says where.
    pub fn sizes(&mut self, progress: &mut dyn FnMut(f64)) -> Result<LogSizes, LogError> {
        let (start_ns, end_ns) = self.range_ns();
        let mut purposes: BTreeMap<u16, Purpose> = BTreeMap::new();
        let mut bytes: BTreeMap<Purpose, u64> = BTreeMap::new();
        self.each_chunk(progress, &mut |chunk| {
            let mut parts: BTreeMap<Purpose, Vec<u8>> = BTreeMap::new();
            for record in framing::records_in(chunk) {
                let channel = match record.op {
                    op::CHANNEL => {
                        let (number, topic) = framing::channel(record.body).ok_or("a channel is damaged")?;
                        purposes.insert(number, Purpose::of(topic));
                        number
                    }
                    op::MESSAGE => Message::parse(record.body).ok_or("a message is damaged")?.channel,
                    _ => continue,
                };
                let purpose = purposes.get(&channel).copied().unwrap_or(Purpose::Display);
                parts.entry(purpose).or_default().extend_from_slice(record.body);
            }
            for (purpose, part) in parts {
                let alone = zstd::bulk::compress(&part, ZSTD_LEVEL.cast_signed())
                    .map_err(|error| error.to_string())?;
                *bytes.entry(purpose).or_default() += alone.len() as u64;
            }
            Ok(())
        })?;
        let of = |purpose| bytes.get(&purpose).copied().unwrap_or(0);
        Ok(LogSizes {
            span_ns: end_ns.saturating_sub(start_ns),
            file: self.length(),
            display: of(Purpose::Display),
            board: of(Purpose::Board),
            replay: of(Purpose::Replay),
        })
    }
}
