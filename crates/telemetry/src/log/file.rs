//! A log that is looked into anywhere: its index and overview are read at once, its chunks when they are shown.

use super::{
    LogError, Overview,
    framing::{self, Fields, MAGIC, Part, Records, op},
    overview::OverviewBuilder,
    purpose::{Purpose, Purposes},
    reader::{self, Begun, Carried, Decoder, Input, Record},
    story::Chapter,
    writer::{OVERVIEW, STORY},
};
use crate::RobotDescription;
use moca_msgs::Sample;
use std::{
    collections::BTreeMap,
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
    /// The last story in the file, and its place.
    chapter: Option<(u64, Chapter<'static>)>,
    cut: Option<String>,
}

/// Place of a chunk.
#[derive(Clone)]
pub(super) struct Chunk {
    start_ns: u64,
    end_ns: u64,
    pub(super) at: u64,
    /// Length in the file, bytes.
    pub(super) length: u64,
    /// Purposes of its messages.
    pub(super) purposes: Purposes,
    /// State from the chunks before it; `None` where the chunk holds it itself.
    carried: Option<Box<Carried>>,
}

/// Contents of a file as its end lists them, or as they were found.
#[derive(Default)]
struct Contents {
    chunks: Vec<Chunk>,
    overview: Option<Overview>,
    chapter_at: Option<u64>,
}

/// Purpose of each channel.
type Channels = BTreeMap<u16, Purpose>;

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
        let (contents, cut) = match indexed {
            Ok(contents) if !contents.chunks.is_empty() => (contents, None),
            indexed => {
                let damaged = |cause| LogError::Open { path: path.into(), cause };
                records.seek(start).map_err(damaged)?;
                let channels = first_channels(&mut records);
                records.seek(start).map_err(damaged)?;
                let (contents, whole) = scan(&mut records, &channels, by_us);
                // a file need not have an index
                let why = indexed.err().filter(|_| !(whole && ended_well));
                (contents, why)
            }
        };
        // others may have left out what an overview or a story that they copied still counts
        let Contents { chunks, overview, chapter_at } =
            if by_us { contents } else { Contents { chunks: contents.chunks, ..Contents::default() } };
        let mut log = Self { records, decoder: Decoder::default(), chunks, overview, chapter: None, cut };
        log.chapter = chapter_at.and_then(|at| Some((at, log.chapter(at)?)));
        if let Some((_, chapter)) = &log.chapter {
            log.decoder.name(&chapter.topics);
        }
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

    /// Reads the story at this place; one that is damaged is none.
    fn chapter(&mut self, at: u64) -> Option<Chapter<'static>> {
        self.records.seek(at).ok()?;
        let record = self.records.next(|_| true).ok().filter(|record| record.op == op::METADATA)?;
        let mut fields = Fields(record.body);
        let (name, _length) = (fields.text()?, fields.u32()?);
        let (_, crc, _, json) = (fields.text()?, fields.text()?, fields.text()?, fields.text()?);
        let whole = name == STORY && crc.parse() == Ok(crc32fast::hash(json.as_bytes()));
        if whole { serde_json::from_str(json).ok() } else { None }
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
        let wanted = |chunk: &&Chunk| {
            chunk.purposes.has(Purpose::Display) && chunk.start_ns <= to_ns && chunk.end_ns >= from_ns
        };
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

    /// Hands over the samples for viewers one after the other, with the fields of the records of these topics only; others have
    /// their default. Mode, fault, target, link and contacts are always there. Returns why they end, if that is damage.
    pub fn rows(&mut self, topics: &[&'static str], row: &mut dyn FnMut(&Sample)) -> Option<String> {
        self.decoder.wanted = Some(topics.to_vec());
        let mut read = |record| {
            if let Record::Sample(sample) = record {
                row(&sample);
            }
        };
        let shown = self.chunks_of(Purpose::Display);
        let damage = shown.iter().find_map(|chunk| self.decode(chunk, &mut read).err());
        self.decoder.wanted = None;
        damage
    }

    /// Builds the overview of a log that was not finished, up to where it is damaged; reads all of it. `progress` hears which
    /// part is done, 0 to 1.
    pub fn build_overview(&mut self, progress: &mut dyn FnMut(f64)) -> &Overview {
        let mut builder = OverviewBuilder::default();
        for chunk in self.chunks_of(Purpose::Display) {
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

    /// The last story in the file and its place; `None` in a log of earlier versions.
    pub(super) const fn last_chapter(&self) -> Option<&(u64, Chapter<'static>)> {
        self.chapter.as_ref()
    }

    /// All chunks.
    pub(super) fn chunks(&self) -> &[Chunk] {
        &self.chunks
    }

    /// Chunks that hold messages of this purpose.
    pub(super) fn chunks_of(&self, purpose: Purpose) -> Vec<Chunk> {
        self.chunks.iter().filter(|chunk| chunk.purposes.has(purpose)).cloned().collect()
    }

    /// Returns the share of the file before a chunk, 0 to 1.
    #[expect(clippy::cast_precision_loss, reason = "a share of a file")]
    pub(super) fn part_before(&self, chunk: &Chunk) -> f64 {
        chunk.at as f64 / self.length().max(1) as f64
    }

    pub(super) fn decode(&mut self, chunk: &Chunk, entry: &mut dyn FnMut(Record)) -> Result<(), String> {
        let records = self.read(chunk)?;
        self.decode_records(chunk, &records, entry)
    }

    /// Decodes what [`Self::read`] gave.
    pub(super) fn decode_records(
        &mut self,
        chunk: &Chunk,
        records: &[u8],
        entry: &mut dyn FnMut(Record),
    ) -> Result<(), String> {
        if let Some(carried) = &chunk.carried {
            self.decoder.carried = (**carried).clone();
        }
        self.decoder.decode(records, entry)
    }

    /// Reads the records of a chunk.
    pub(super) fn read(&mut self, chunk: &Chunk) -> Result<Vec<u8>, String> {
        self.records.seek(chunk.at).map_err(|error| error.to_string())?;
        let record = self.records.next(|_| true)?;
        let records =
            if record.op == op::CHUNK { framing::chunk(record.body) } else { Err("no chunk".into()) };
        records.map_err(|why| format!("{why} (at byte {})", chunk.at))
    }
}

/// Contents as the end of the file lists them.
fn index(records: &mut Records<Input>) -> Result<Contents, String> {
    let go = |records: &mut Records<Input>, at: u64| records.seek(at).map_err(|error| error.to_string());
    let footer_at = records.end().checked_sub(FOOTER_BYTES + MAGIC.len() as u64);
    go(records, footer_at.ok_or("the file is too short")?)?;
    let footer = records.next(|_| true)?;
    let summary_at = Fields(footer.body).u64().filter(|at| footer.op == op::FOOTER && *at > 0);
    go(records, summary_at.ok_or("the file has no index")?)?;
    let (mut contents, mut channels, mut overview_at) = (Contents::default(), Channels::new(), None);
    let wanted = [op::CHANNEL, op::CHUNK_INDEX, op::ATTACHMENT_INDEX, op::METADATA_INDEX, op::FOOTER];
    loop {
        let record = records.next(|kind| wanted.contains(&kind))?;
        let mut fields = Fields(record.body);
        match record.op {
            op::CHANNEL => {
                let (number, topic) = framing::channel(record.body).ok_or("a channel is damaged")?;
                channels.insert(number, Purpose::of(topic));
            }
            op::CHUNK_INDEX => {
                contents.chunks.push(listed(fields, &channels).ok_or("the index is damaged")?);
            }
            op::ATTACHMENT_INDEX => {
                let at = fields.u64();
                if fields.take(32).and_then(|_| fields.text()) == Some(OVERVIEW) {
                    overview_at = at;
                }
            }
            op::METADATA_INDEX => {
                let at = fields.u64();
                if fields.take(8).and_then(|_| fields.text()) == Some(STORY) {
                    contents.chapter_at = at;
                }
            }
            _ => break,
        }
    }
    if let Some(at) = overview_at {
        go(records, at)?;
        let overview = overview(records.next(|_| true)?.body);
        contents.overview = Some(overview.ok_or("the overview is damaged")?);
    }
    Ok(contents)
}

/// A chunk as the index lists it.
fn listed(mut fields: Fields<'_>, channels: &Channels) -> Option<Chunk> {
    let (start_ns, end_ns, at, length) = (fields.u64()?, fields.u64()?, fields.u64()?, fields.u64()?);
    let size = usize::try_from(fields.u32()?).ok()?;
    let mut of = Fields(fields.take(size)?);
    let mut purposes = Purposes::default();
    while let Some((channel, _at)) = of.u16().zip(of.u64()) {
        purposes = purposes.and_of(channels.get(&channel));
    }
    Some(Chunk { start_ns, end_ns, at, length, purposes: purposes.or_unknown(), carried: None })
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

/// Channels that the first chunk names.
fn first_channels(records: &mut Records<Input>) -> Channels {
    let first = records.next(|kind| kind == op::CHUNK).and_then(|record| framing::chunk(record.body));
    let first = first.unwrap_or_default();
    let named = framing::records_in(&first).filter(|record| record.op == op::CHANNEL);
    named
        .filter_map(|record| framing::channel(record.body))
        .map(|(n, topic)| (n, Purpose::of(topic)))
        .collect()
}

/// Contents that lie in the file before its damage, and true if there is none. Channels that this library names in the middle of
/// a log are for viewers.
fn scan(records: &mut Records<Input>, channels: &Channels, by_us: bool) -> (Contents, bool) {
    let mut contents = Contents::default();
    let of = |channel| channels.get(&channel).or_else(|| by_us.then_some(&Purpose::Display));
    let whole = loop {
        match records.next_part() {
            Ok(Some(Part::Chunk { at, times: [start_ns, end_ns], length })) => {
                let purposes = Purposes::default();
                contents.chunks.push(Chunk { start_ns, end_ns, at, length, purposes, carried: None });
            }
            Ok(Some(Part::MessagesOf(channel))) => {
                if let Some(chunk) = contents.chunks.last_mut() {
                    chunk.purposes = chunk.purposes.and_of(of(channel));
                }
            }
            Ok(Some(Part::Metadata { at })) => contents.chapter_at = Some(at),
            ended => break ended.is_ok(),
        }
    };
    let mixed = contents.chapter_at.is_none();
    if let Some(last) = contents.chunks.last_mut().filter(|_| !whole && mixed) {
        // A part of its own index may be cut.
        last.purposes = Purposes::UNKNOWN;
    }
    contents.chunks.iter_mut().for_each(|chunk| chunk.purposes = chunk.purposes.or_unknown());
    (contents, whole)
}
