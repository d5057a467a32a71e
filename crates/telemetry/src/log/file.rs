//! A log that is looked into anywhere: its index and overview are read at once, its chunks when they are shown.

use super::{
    LogError, Overview,
    framing::{self, Fields, Records, op},
    overview::OverviewBuilder,
    reader::{self, Begun, Carried, Decoder, Input, Record},
    writer::OVERVIEW,
};
use crate::RobotDescription;
use mcap::MAGIC;
use moca_msgs::Sample;
use std::{
    io::{Read, Seek},
    path::Path,
};

/// Kind, length and body of a footer.
const FOOTER_BYTES: u64 = 29;

/// A log on disk. Opening reads index and overview; memory does not grow with the length of the run.
///
/// ```
/// use moca_msgs::Sample;
/// use moca_telemetry::log::{LogFile, LogWriter, Meta};
/// let path = std::env::temp_dir().join(format!("moca-doc-{}.mcap", std::process::id()));
/// let mut writer = LogWriter::new(std::fs::File::create(&path)?, &Meta::default())?;
/// for tick in 0..60_000 {
///     writer.sample(&Sample { tick, time_ns: tick * 1_000_000, ..Sample::default() })?;
/// }
/// writer.finish()?;
/// let mut log = LogFile::open(&path)?;
/// assert_eq!(log.overview().map(|overview| overview.spans.len()), Some(60));
/// let second = log.samples(30_000_000_000, 31_000_000_000)?;
/// assert_eq!(second.first().map(|sample| sample.tick), Some(30_000));
/// # std::fs::remove_file(path)?;
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
pub struct LogFile {
    records: Records<Input>,
    decoder: Decoder,
    chunks: Vec<Chunk>,
    overview: Option<Overview>,
    cut: Option<String>,
}

/// Place of a chunk.
#[derive(Clone)]
struct Chunk {
    start_ns: u64,
    end_ns: u64,
    at: u64,
    /// State from the chunks before it; `None` where the chunk holds it itself.
    carried: Option<Box<Carried>>,
}

impl LogFile {
    /// Opens a log. One that is cut has no overview, and its index is put together from its chunks.
    ///
    /// # Errors
    /// The file cannot be read, is no log, or a log of another form.
    pub fn open(path: &Path) -> Result<Self, LogError> {
        Self::over(reader::open_file(path)?, path)
    }

    /// Opens anything that holds the bytes of a log; `path` names it in errors.
    ///
    /// # Errors
    /// As for [`Self::open`].
    pub fn over(input: impl Read + Seek + Send + 'static, path: &Path) -> Result<Self, LogError> {
        let Begun { mut records, ended_well, by_us } = reader::begin(input, path)?;
        let start = records.at();
        let indexed = if ended_well { index(&mut records) } else { Err("the file breaks off".into()) };
        let (chunks, overview, cut) = match indexed {
            Ok((chunks, overview)) if !chunks.is_empty() => (chunks, overview, None),
            indexed => {
                let damaged = |cause| LogError::Open { path: path.into(), cause };
                records.seek(start).map_err(damaged)?;
                let (chunks, whole) = scan(&mut records);
                // a file need not have an index
                let why = indexed.err().filter(|_| !(whole && ended_well));
                (chunks, None, why)
            }
        };
        // others may have left out what an overview that they copied still counts
        let overview = overview.filter(|_| by_us);
        let mut log = Self { records, decoder: Decoder::default(), chunks, overview, cut };
        if by_us {
            // The robot and the channels are in the first chunk.
            if let Some(first) = log.chunks.first().cloned()
                && let Err(why) = log.decode(&first, &mut |_| {})
            {
                log.cut = Some(why);
            }
        } else {
            log.carry();
        }
        // From here on chunks are read in any order: each says all that its samples need.
        let start_unix_ns = log.decoder.start_unix_ns;
        for chunk in &mut log.chunks {
            chunk.start_ns = chunk.start_ns.saturating_sub(start_unix_ns);
            chunk.end_ns = chunk.end_ns.saturating_sub(start_unix_ns);
        }
        Ok(log)
    }

    /// Notes for each chunk what those before it have said; the file ends before one that is damaged.
    fn carry(&mut self) {
        for number in 0..self.chunks.len() {
            let mut chunk = self.chunks[number].clone();
            let carried = Box::new(self.decoder.carried.clone());
            if let Err(why) = self.decode(&chunk, &mut |_| {}) {
                self.cut = Some(why);
                self.chunks.truncate(number);
                return;
            }
            chunk.carried = Some(carried);
            self.chunks[number] = chunk;
        }
    }

    /// The robot.
    pub const fn description(&self) -> &RobotDescription {
        &self.decoder.description
    }

    /// Unix time of loop time 0, ns.
    pub const fn start_unix_ns(&self) -> u64 {
        self.decoder.start_unix_ns
    }

    /// First and last instant, ns of loop time.
    pub fn range_ns(&self) -> (u64, u64) {
        let end = self.chunks.iter().map(|chunk| chunk.end_ns).max();
        // The first chunks hold description and configuration, at time 0 whenever the run begins; the first mark is the mode
        // of the first sample.
        let start = self.overview.as_ref().and_then(|overview| Some(overview.marks.first()?.time_ns));
        (start.unwrap_or(0), end.unwrap_or(0))
    }

    /// The whole run at a glance; `None` if the log was not finished: see [`Self::build_overview`].
    pub const fn overview(&self) -> Option<&Overview> {
        self.overview.as_ref()
    }

    /// Why the log is not whole, if it is not.
    pub fn cut(&self) -> Option<&str> {
        self.cut.as_deref()
    }

    /// Reads the samples for viewers from `from_ns` to `to_ns`, ns of loop time, both included: only the chunks that hold them are read.
    ///
    /// # Errors
    /// A chunk is damaged; the message says where.
    pub fn samples(&mut self, from_ns: u64, to_ns: u64) -> Result<Vec<Sample>, LogError> {
        let wanted = |chunk: &&Chunk| chunk.start_ns <= to_ns && chunk.end_ns >= from_ns;
        let chunks: Vec<Chunk> = self.chunks.iter().filter(wanted).cloned().collect();
        let mut samples = Vec::new();
        for chunk in chunks {
            self.decode(&chunk, &mut |record| match record {
                Record::Sample(sample) if (from_ns..=to_ns).contains(&sample.time_ns) => {
                    samples.push(*sample)
                }
                _ => {}
            })
            .map_err(LogError::Damaged)?;
        }
        Ok(samples)
    }

    /// Builds the overview of a log that was not finished, up to where it is damaged; reads all of it. `progress` hears which
    /// part is done, 0 to 1.
    pub fn build_overview(&mut self, progress: &mut dyn FnMut(f64)) -> &Overview {
        let mut builder = OverviewBuilder::default();
        let chunks = self.chunks.clone();
        for chunk in chunks {
            let decoded = self.decode(&chunk, &mut |record| {
                if let Record::Sample(sample) = record {
                    builder.add(&sample);
                }
            });
            if let Err(why) = decoded {
                self.cut = Some(why);
                break;
            }
            progress(self.part_before(&chunk));
        }
        self.overview.insert(builder.finish())
    }

    /// Length of the file, bytes.
    pub(super) const fn length(&self) -> u64 {
        self.records.end()
    }

    /// Hands over the records of one chunk after the other.
    pub(super) fn each_chunk(
        &mut self,
        progress: &mut dyn FnMut(f64),
        take: &mut dyn FnMut(&[u8]) -> Result<(), String>,
    ) -> Result<(), LogError> {
        for chunk in self.chunks.clone() {
            self.read(&chunk).and_then(|records| take(&records)).map_err(LogError::Damaged)?;
            progress(self.part_before(&chunk));
        }
        Ok(())
    }

    /// Returns the share of the file before a chunk, 0 to 1.
    #[expect(clippy::cast_precision_loss, reason = "a share of a file")]
    fn part_before(&self, chunk: &Chunk) -> f64 {
        chunk.at as f64 / self.length().max(1) as f64
    }

    fn decode(&mut self, chunk: &Chunk, entry: &mut dyn FnMut(Record)) -> Result<(), String> {
        let records = self.read(chunk)?;
        if let Some(carried) = &chunk.carried {
            self.decoder.carried = (**carried).clone();
        }
        self.decoder.decode(&records, entry)
    }

    fn read(&mut self, chunk: &Chunk) -> Result<Vec<u8>, String> {
        self.records.seek(chunk.at).map_err(|error| error.to_string())?;
        let record = self.records.next(|_| true)?;
        let records =
            if record.op == op::CHUNK { framing::chunk(record.body) } else { Err("no chunk".into()) };
        records.map_err(|why| format!("{why} (at byte {})", chunk.at))
    }
}

/// Chunks and overview as the end of the file lists them.
fn index(records: &mut Records<Input>) -> Result<(Vec<Chunk>, Option<Overview>), String> {
    let go = |records: &mut Records<Input>, at: u64| records.seek(at).map_err(|error| error.to_string());
    let footer_at = records.end().checked_sub(FOOTER_BYTES + MAGIC.len() as u64);
    go(records, footer_at.ok_or("the file is too short")?)?;
    let footer = records.next(|_| true)?;
    let summary_at = Fields(footer.body).u64().filter(|at| footer.op == op::FOOTER && *at > 0);
    go(records, summary_at.ok_or("the file has no index")?)?;
    let (mut chunks, mut overview_at) = (Vec::new(), None);
    loop {
        let record =
            records.next(|kind| matches!(kind, op::CHUNK_INDEX | op::ATTACHMENT_INDEX | op::FOOTER))?;
        let mut fields = Fields(record.body);
        match record.op {
            op::CHUNK_INDEX => {
                let entry = (fields.u64(), fields.u64(), fields.u64());
                let (Some(start_ns), Some(end_ns), Some(at)) = entry else {
                    return Err("the index is damaged".into());
                };
                chunks.push(Chunk { start_ns, end_ns, at, carried: None });
            }
            op::ATTACHMENT_INDEX => {
                let at = fields.u64();
                if fields.take(32).and_then(|_| fields.text()) == Some(OVERVIEW) {
                    overview_at = at;
                }
            }
            _ => break,
        }
    }
    let overview = overview_at.map(|at| {
        go(records, at)?;
        overview(records.next(|_| true)?.body).ok_or_else(|| "the overview is damaged".to_owned())
    });
    Ok((chunks, overview.transpose()?))
}

fn overview(attachment: &[u8]) -> Option<Overview> {
    let (body, crc) = attachment.split_last_chunk::<4>()?;
    let mut fields = Fields(body);
    let _times = (fields.u64()?, fields.u64()?);
    let _names = (fields.text()?, fields.text()?);
    let length = usize::try_from(fields.u64()?).ok()?;
    let data = fields.take(length)?;
    (crc32fast::hash(body) == u32::from_le_bytes(*crc)).then(|| serde_json::from_slice(data).ok())?
}

/// The chunks that lie in the file before its damage, and whether there is none.
fn scan(records: &mut Records<Input>) -> (Vec<Chunk>, bool) {
    let mut chunks = Vec::new();
    loop {
        match records.next_chunk() {
            Ok(Some((at, [start_ns, end_ns]))) => {
                chunks.push(Chunk { start_ns, end_ns, at, carried: None });
            }
            ended => return (chunks, ended.is_ok()),
        }
    }
}
