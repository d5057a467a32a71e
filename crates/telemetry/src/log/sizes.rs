//! Account of a log: its run, and its size on a disk by purpose.

use super::{
    LogError, LogFile,
    file::Chunk,
    framing::{self, Message, op},
    purpose::Purpose,
    reader::Record,
    story::Story,
};
use std::collections::BTreeMap;

/// Compression level of the logs of earlier versions, whose parts lie in the same chunks.
const LEVEL_OF_MIXED: i32 = 9;

/// Bytes of a log, its overview and its index in `file` only.
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

/// Account of a log: its run, and its size.
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
/// let account = log.account(&mut |_part| {})?;
/// assert_eq!((account.story.stop_count, account.sizes.replay), (0, 0));
/// assert!(account.sizes.file > account.sizes.display);
/// assert_eq!(log.account_of_chunks(&mut |_part| {})?, account);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Account {
    /// Events of the run.
    pub story: Story,
    /// Size of the file and its parts.
    pub sizes: LogSizes,
}

impl LogFile {
    /// Tells what happened, and how large the log is. A log of this version holds it: only chunks after the last story in it
    /// are read. `progress` hears which part of the file is done, 0 to 1.
    ///
    /// # Errors
    /// A chunk is damaged; the message says where.
    pub fn account(&mut self, progress: &mut dyn FnMut(f64)) -> Result<Account, LogError> {
        match self.last_chapter().cloned() {
            Some((at, chapter)) => self.read_on(chapter.story.into_owned(), chapter.bytes, at, progress),
            None => self.account_of_chunks(progress),
        }
    }

    /// Tells what happened, and how large the log is, from all chunks.
    ///
    /// # Errors
    /// As for [`Self::account`].
    pub fn account_of_chunks(&mut self, progress: &mut dyn FnMut(f64)) -> Result<Account, LogError> {
        self.read_on(Story::default(), [0; 3], 0, progress)
    }

    /// Adds the chunks behind `from`.
    fn read_on(
        &mut self,
        mut story: Story,
        mut bytes: [u64; 3],
        from: u64,
        progress: &mut dyn FnMut(f64),
    ) -> Result<Account, LogError> {
        let separate = self.last_chapter().is_some();
        let mut mixed = Mixed::default();
        let chunks: Vec<Chunk> = self.chunks().iter().filter(|chunk| chunk.at > from).cloned().collect();
        for chunk in chunks {
            if let Some(purpose) = chunk.purposes.single().filter(|_| separate) {
                let bytes = &mut bytes[purpose as usize];
                *bytes = bytes.saturating_add(chunk.length);
                if purpose != Purpose::Display {
                    continue;
                }
            }
            let mut tell = |record| match record {
                Record::Sample(sample) => story.add(&sample),
                Record::Asked(_, asked) => story.asked(&asked),
                _ => {}
            };
            let records = self.read(&chunk).map_err(LogError::Damaged)?;
            self.decode_records(&chunk, &records, &mut tell).map_err(LogError::Damaged)?;
            if !separate {
                mixed.add(&records, &mut bytes).map_err(LogError::Damaged)?;
            }
            progress(self.part_before(&chunk));
        }
        let (start_ns, end_ns) = self.range_ns();
        let (span_ns, [display, board, replay]) = (end_ns.saturating_sub(start_ns), bytes);
        Ok(Account { story, sizes: LogSizes { span_ns, file: self.length(), display, board, replay } })
    }
}

/// Chunks that hold messages of every purpose: each part is counted as if it had been compressed alone.
#[derive(Default)]
struct Mixed {
    purposes: BTreeMap<u16, Purpose>,
}

impl Mixed {
    fn add(&mut self, chunk: &[u8], bytes: &mut [u64; 3]) -> Result<(), String> {
        let mut parts: [Vec<u8>; 3] = Default::default();
        for record in framing::records_in(chunk) {
            let channel = match record.op {
                op::CHANNEL => {
                    let (number, topic) = framing::channel(record.body).ok_or("a channel is damaged")?;
                    self.purposes.insert(number, Purpose::of(topic));
                    number
                }
                op::MESSAGE => Message::parse(record.body).ok_or("a message is damaged")?.channel,
                _ => continue,
            };
            let purpose = self.purposes.get(&channel).copied().unwrap_or(Purpose::Display);
            parts[purpose as usize].extend_from_slice(record.body);
        }
        for (part, bytes) in parts.iter().zip(bytes).filter(|(part, _)| !part.is_empty()) {
            let alone = zstd::bulk::compress(part, LEVEL_OF_MIXED).map_err(|error| error.to_string())?;
            *bytes += alone.len() as u64;
        }
        Ok(())
    }
}
