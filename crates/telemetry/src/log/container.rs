//! Writes the MCAP file of a log, record by record. Format: <https://mcap.dev/spec>.
//!
//! Three chunks grow side by side, one for each [`Purpose`], and each is compressed as its contents deserve. The index of
//! the chunks waits for the end of the file in some 15 bytes for each. (The `mcap` crate's writer fills one chunk at a time, at one
//! level, and keeps over a kilobyte of index for each second of a log.)

use super::{
    columns::{ColumnReader, unzigzag, varint, zigzag},
    framing::{MAGIC, op},
    purpose::Purpose,
};
use std::{
    collections::BTreeMap,
    io::{self, Write},
};

/// Name of the compression of all chunks.
const COMPRESSION: &str = "zstd";
/// Bytes of a record before its body.
const PREFIX: u64 = 9;
/// Bytes of an index of one channel's messages: its record without entries, and an entry.
const INDEX_RECORD: u64 = PREFIX + 6;
const INDEX_ENTRY: u64 = 16;
/// Bytes after which a chunk ends.
const CHUNK_MAX: usize = 4 << 20;
/// Chunks that grow side by side.
const CHUNKS: usize = Purpose::ALL.len();

/// Earliest and latest time of messages, ns since the Unix epoch; `None` without a message.
type Bounds = Option<[u64; 2]>;

/// An MCAP file that is being written.
pub(super) struct Container<W> {
    output: Output<W>,
    chunks: [OpenChunk; CHUNKS],
    schemas: Kept,
    schema_of: BTreeMap<String, u16>,
    channels: Kept,
    attachments: Kept,
    metadata: Kept,
    index: Index,
    /// Messages of each channel, the first channel's first.
    counts: Vec<u64>,
    bounds: Bounds,
    /// Records on their way to the file.
    records: Vec<u8>,
}

/// Records that the summary holds again.
#[derive(Default)]
struct Kept {
    records: Vec<u8>,
    count: u16,
}

impl Kept {
    /// Adds a record, and returns its number; the first is 1.
    fn add(&mut self, op: u8, body: impl FnOnce(u16, &mut Vec<u8>)) -> (u16, &[u8]) {
        self.count = self.count.saturating_add(1);
        let (number, at) = (self.count, self.records.len());
        record(&mut self.records, op, |records| body(number, records));
        (number, &self.records[at..])
    }
}

/// The file, with the checksum of what it holds.
struct Output<W> {
    to: W,
    at: u64,
    crc: crc32fast::Hasher,
    /// True after an error: what followed would stand behind a hole.
    failed: bool,
}

impl<W: Write> Output<W> {
    fn write(&mut self, bytes: &[u8]) -> io::Result<()> {
        if std::mem::replace(&mut self.failed, true) {
            return Err(io::Error::other("an earlier write failed"));
        }
        self.to.write_all(bytes)?;
        self.failed = false;
        self.crc.update(bytes);
        self.at += bytes.len() as u64;
        Ok(())
    }
}

/// Records of a chunk that is not written yet.
struct OpenChunk {
    compressor: zstd::bulk::Compressor<'static>,
    records: Vec<u8>,
    packed: Vec<u8>,
    bounds: Bounds,
    /// Time and place of each message, of the first channel first.
    messages: Vec<Vec<[u64; 2]>>,
}

impl OpenChunk {
    fn new(purpose: Purpose) -> io::Result<Self> {
        let compressor = zstd::bulk::Compressor::new(purpose.level())?;
        Ok(Self { compressor, records: Vec::new(), packed: Vec::new(), bounds: None, messages: Vec::new() })
    }

    fn message(&mut self, channel: u16, time_ns: u64, data: &[u8]) {
        let place = self.records.len() as u64;
        record(&mut self.records, op::MESSAGE, |body| {
            number(body, channel.to_le_bytes());
            number(body, 0_u32.to_le_bytes());
            number(body, time_ns.to_le_bytes());
            number(body, time_ns.to_le_bytes());
            body.extend_from_slice(data);
        });
        let of = usize::from(channel).saturating_sub(1);
        self.messages.resize_with(self.messages.len().max(of + 1), Vec::new);
        self.messages[of].push([time_ns, place]);
        widen(&mut self.bounds, time_ns);
    }

    /// Appends the chunk and its indexes to `to`, forgets what it holds, and returns its entry in the index.
    fn end(&mut self, to: &mut Vec<u8>) -> io::Result<Entry> {
        self.packed.clear();
        self.packed.reserve(zstd::zstd_safe::compress_bound(self.records.len()));
        self.compressor.compress_to_buffer(&self.records, &mut self.packed)?;
        let [start_ns, end_ns] = self.bounds.take().unwrap_or_default();
        let size = self.records.len() as u64;
        record(to, op::CHUNK, |body| {
            number(body, start_ns.to_le_bytes());
            number(body, end_ns.to_le_bytes());
            number(body, size.to_le_bytes());
            number(body, crc32fast::hash(&self.records).to_le_bytes());
            text(body, COMPRESSION);
            blob(body, &self.packed);
        });
        let mut counts = Vec::new();
        for (channel, messages) in
            (1_u16..).zip(&mut self.messages).filter(|(_, messages)| !messages.is_empty())
        {
            record(to, op::MESSAGE_INDEX, |body| {
                number(body, channel.to_le_bytes());
                list(body, |body| {
                    messages.iter().flatten().for_each(|value| number(body, value.to_le_bytes()))
                });
            });
            counts.push((channel, messages.len() as u64));
            messages.clear();
        }
        self.records.clear();
        Ok(Entry { start_ns, end_ns, size, packed: self.packed.len() as u64, counts })
    }
}

impl<W: Write> Container<W> {
    /// Begins a file.
    pub(super) fn new(to: W, profile: &str, library: &str) -> io::Result<Self> {
        let [display, board, replay] = Purpose::ALL;
        let mut container = Self {
            output: Output { to, at: 0, crc: crc32fast::Hasher::new(), failed: false },
            chunks: [OpenChunk::new(display)?, OpenChunk::new(board)?, OpenChunk::new(replay)?],
            schemas: Kept::default(),
            schema_of: BTreeMap::new(),
            channels: Kept::default(),
            attachments: Kept::default(),
            metadata: Kept::default(),
            index: Index::default(),
            counts: Vec::new(),
            bounds: None,
            records: Vec::new(),
        };
        container.records.extend_from_slice(&MAGIC);
        record(&mut container.records, op::HEADER, |body| {
            text(body, profile);
            text(body, library);
        });
        container.pass_on()?;
        Ok(container)
    }

    /// Adds a schema and returns its number; one of each name is enough.
    pub(super) fn add_schema(&mut self, name: &str, encoding: &str, data: &[u8]) -> u16 {
        if let Some(number) = self.schema_of.get(name) {
            return *number;
        }
        let (number, record) = self.schemas.add(op::SCHEMA, |id, body| {
            self::number(body, id.to_le_bytes());
            text(body, name);
            text(body, encoding);
            list(body, |body| body.extend_from_slice(data));
        });
        self.chunks[Purpose::Display as usize].records.extend_from_slice(record);
        self.schema_of.insert(name.into(), number);
        number
    }

    /// Adds a channel and returns its number. Schema 0 is of bytes.
    pub(super) fn add_channel(&mut self, schema: u16, topic: &str, encoding: &str) -> u16 {
        let (number, record) = self.channels.add(op::CHANNEL, |id, body| {
            self::number(body, id.to_le_bytes());
            self::number(body, schema.to_le_bytes());
            text(body, topic);
            text(body, encoding);
            list(body, |_| {});
        });
        self.chunks[Purpose::Display as usize].records.extend_from_slice(record);
        self.counts.resize(usize::from(number), 0);
        number
    }

    /// Adds a message of a channel of this purpose; the time is ns since the Unix epoch.
    pub(super) fn message(
        &mut self,
        purpose: Purpose,
        channel: u16,
        time_ns: u64,
        data: &[u8],
    ) -> io::Result<()> {
        self.chunks[purpose as usize].message(channel, time_ns, data);
        widen(&mut self.bounds, time_ns);
        if let Some(count) = self.counts.get_mut(usize::from(channel).saturating_sub(1)) {
            *count += 1;
        }
        if self.chunks[purpose as usize].records.len() < CHUNK_MAX { Ok(()) } else { self.end_chunk(purpose) }
    }

    /// Ends the chunks and hands them to the operating system.
    pub(super) fn flush(&mut self) -> io::Result<()> {
        Purpose::ALL.into_iter().try_for_each(|purpose| self.end_chunk(purpose))?;
        self.output.to.flush()
    }

    fn end_chunk(&mut self, purpose: Purpose) -> io::Result<()> {
        let chunk = &mut self.chunks[purpose as usize];
        if chunk.records.is_empty() {
            return Ok(());
        }
        let entry = chunk.end(&mut self.records)?;
        let at = self.output.at;
        self.pass_on()?;
        self.index.add(purpose, at, entry);
        Ok(())
    }

    /// Bytes of the chunks of each purpose that are written, in the order of [`Purpose::ALL`].
    pub(super) const fn sizes(&self) -> [u64; CHUNKS] {
        self.index.sizes
    }

    /// Writes a metadata record between chunks; call it after [`Self::flush`].
    pub(super) fn metadata(&mut self, name: &str, entries: &[(&str, &str)]) -> io::Result<()> {
        record(&mut self.records, op::METADATA, |body| {
            text(body, name);
            list(body, |body| {
                for (key, value) in entries {
                    text(body, key);
                    text(body, value);
                }
            });
        });
        let place = [self.output.at, self.records.len() as u64];
        self.pass_on()?;
        self.metadata.add(op::METADATA_INDEX, |_, body| {
            place.iter().for_each(|value| number(body, value.to_le_bytes()));
            text(body, name);
        });
        Ok(())
    }

    /// Writes an attachment between chunks; call it after [`Self::flush`]. The time is ns since the Unix epoch.
    pub(super) fn attach(
        &mut self,
        time_ns: u64,
        name: &str,
        media_type: &str,
        data: &[u8],
    ) -> io::Result<()> {
        record(&mut self.records, op::ATTACHMENT, |body| {
            let start = body.len();
            number(body, time_ns.to_le_bytes());
            number(body, time_ns.to_le_bytes());
            text(body, name);
            text(body, media_type);
            blob(body, data);
            let crc = crc32fast::hash(&body[start..]);
            number(body, crc.to_le_bytes());
        });
        let fields = [self.output.at, self.records.len() as u64, time_ns, time_ns, data.len() as u64];
        self.pass_on()?;
        self.attachments.add(op::ATTACHMENT_INDEX, |_, body| {
            fields.iter().for_each(|value| number(body, value.to_le_bytes()));
            text(body, name);
            text(body, media_type);
        });
        Ok(())
    }

    /// Ends the file: its last chunks, its summary and its end mark.
    pub(super) fn finish(&mut self) -> io::Result<()> {
        self.flush()?;
        let crc = self.output.crc.clone().finalize();
        record(&mut self.records, op::DATA_END, |body| number(body, crc.to_le_bytes()));
        self.pass_on()?;
        let summary_at = self.output.at;
        self.output.crc.reset();
        let statistics = self.statistics();
        let mut offsets = Vec::new();
        let groups = [
            (op::SCHEMA, std::mem::take(&mut self.schemas.records)),
            (op::CHANNEL, std::mem::take(&mut self.channels.records)),
            (op::STATISTICS, statistics),
            (op::CHUNK_INDEX, Vec::new()),
            (op::ATTACHMENT_INDEX, std::mem::take(&mut self.attachments.records)),
            (op::METADATA_INDEX, std::mem::take(&mut self.metadata.records)),
        ];
        for (op, records) in groups {
            let at = self.output.at;
            self.output.write(&records)?;
            if op == op::CHUNK_INDEX {
                for entry in self.index.entries() {
                    entry.write(&mut self.records);
                    self.output.write(&self.records)?;
                    self.records.clear();
                }
            }
            let length = self.output.at - at;
            if length > 0 {
                record(&mut offsets, op::SUMMARY_OFFSET, |body| {
                    body.push(op);
                    number(body, at.to_le_bytes());
                    number(body, length.to_le_bytes());
                });
            }
        }
        let offsets_at = self.output.at;
        self.output.write(&offsets)?;
        // The checksum of the summary includes the footer up to itself.
        self.records.push(op::FOOTER);
        [20, summary_at, offsets_at]
            .iter()
            .for_each(|value: &u64| number(&mut self.records, value.to_le_bytes()));
        self.pass_on()?;
        let crc = self.output.crc.clone().finalize();
        number(&mut self.records, crc.to_le_bytes());
        self.records.extend_from_slice(&MAGIC);
        self.pass_on()?;
        self.output.to.flush()
    }

    fn statistics(&self) -> Vec<u8> {
        let mut statistics = Vec::new();
        record(&mut statistics, op::STATISTICS, |body| {
            number(body, self.counts.iter().sum::<u64>().to_le_bytes());
            number(body, self.schemas.count.to_le_bytes());
            for count in [self.channels.count, self.attachments.count, self.metadata.count] {
                number(body, u32::from(count).to_le_bytes());
            }
            number(body, self.index.count.to_le_bytes());
            self.bounds.unwrap_or_default().iter().for_each(|bound| number(body, bound.to_le_bytes()));
            list(body, |body| {
                for (channel, count) in (1_u16..).zip(&self.counts).filter(|(_, count)| **count > 0) {
                    number(body, channel.to_le_bytes());
                    number(body, count.to_le_bytes());
                }
            });
        });
        statistics
    }

    /// Writes the records that wait.
    fn pass_on(&mut self) -> io::Result<()> {
        let written = self.output.write(&self.records);
        self.records.clear();
        written
    }
}

/// A chunk in the file's index.
#[derive(Clone, Debug, Default, PartialEq)]
struct Entry {
    start_ns: u64,
    end_ns: u64,
    /// Bytes of its records, and compressed.
    size: u64,
    packed: u64,
    /// Messages of each of its channels.
    counts: Vec<(u16, u64)>,
}

impl Entry {
    /// Length of the chunk's own record, bytes.
    const fn length(&self) -> u64 {
        PREFIX + 40 + COMPRESSION.len() as u64 + self.packed
    }

    /// Length of the records that index its messages, bytes.
    fn index_length(&self) -> u64 {
        self.counts.iter().map(|(_, count)| INDEX_RECORD + INDEX_ENTRY * count).sum()
    }
}

/// An entry, and the place of its chunk in the file.
struct Placed {
    at: u64,
    entry: Entry,
}

impl Placed {
    fn write(&self, to: &mut Vec<u8>) {
        let Self { at, entry } = self;
        record(to, op::CHUNK_INDEX, |body| {
            for value in [entry.start_ns, entry.end_ns, *at, entry.length()] {
                number(body, value.to_le_bytes());
            }
            list(body, |body| {
                let mut at = at + entry.length();
                for (channel, count) in &entry.counts {
                    number(body, channel.to_le_bytes());
                    number(body, at.to_le_bytes());
                    at += INDEX_RECORD + INDEX_ENTRY * count;
                }
            });
            number(body, entry.index_length().to_le_bytes());
            text(body, COMPRESSION);
            number(body, entry.packed.to_le_bytes());
            number(body, entry.size.to_le_bytes());
        });
    }
}

/// Index of the chunks, as differences from the chunk of the same purpose before: most have as many messages of each channel.
#[derive(Default)]
struct Index {
    bytes: Vec<u8>,
    count: u32,
    last: Last,
    /// Bytes of the chunks of each purpose, their indexes not counted.
    sizes: [u64; CHUNKS],
}

/// Entries from which the next one is told.
#[derive(Default)]
struct Last {
    /// End of the last chunk and its indexes.
    at: u64,
    of_purpose: [Entry; CHUNKS],
}

/// Mark of an entry with other numbers of messages than the one before.
const OTHER_COUNTS: u64 = 4;

impl Index {
    fn add(&mut self, purpose: Purpose, at: u64, entry: Entry) {
        let last = &mut self.last.of_purpose[purpose as usize];
        let other = entry.counts != last.counts;
        let mark = purpose as u64 | if other { OTHER_COUNTS } else { 0 };
        // A board's bytes are noted when their read is complete: their times may be before those of the chunk before.
        let since_ns = entry.start_ns.wrapping_sub(last.end_ns);
        let lasts_ns = entry.end_ns - entry.start_ns;
        let values = [mark, at - self.last.at, zigzag(since_ns), lasts_ns, entry.size, entry.packed];
        values.iter().for_each(|value| varint(&mut self.bytes, *value));
        if other {
            varint(&mut self.bytes, entry.counts.len() as u64);
            for (channel, count) in &entry.counts {
                varint(&mut self.bytes, u64::from(*channel));
                varint(&mut self.bytes, *count);
            }
        }
        self.count += 1;
        self.sizes[purpose as usize] += entry.length();
        self.last.at = at + entry.length() + entry.index_length();
        *last = entry;
    }

    /// The entries in the order in which they were added.
    fn entries(&self) -> impl Iterator<Item = Placed> {
        let (mut rest, mut last) = (ColumnReader::new(&self.bytes), Last::default());
        (0..self.count).map_while(move |_| last.next(&mut rest))
    }
}

impl Last {
    /// Reads the next entry.
    fn next(&mut self, rest: &mut ColumnReader<'_>) -> Option<Placed> {
        let mut value = || rest.count().ok();
        let mark = value()?;
        let before = self.of_purpose.get_mut(usize::try_from(mark % OTHER_COUNTS).ok()?)?;
        let at = self.at + value()?;
        let start_ns = before.end_ns.wrapping_add(unzigzag(value()?));
        let (lasts_ns, size, packed) = (value()?, value()?, value()?);
        let mut counts = std::mem::take(&mut before.counts);
        if mark & OTHER_COUNTS != 0 {
            let channels = value()?;
            let pair = |_| Some((u16::try_from(value()?).ok()?, value()?));
            counts = (0..channels).map(pair).collect::<Option<_>>()?;
        }
        let entry = Entry { start_ns, end_ns: start_ns + lasts_ns, size, packed, counts };
        self.at = at + entry.length() + entry.index_length();
        before.clone_from(&entry);
        Some(Placed { at, entry })
    }
}

fn widen(bounds: &mut Bounds, time_ns: u64) {
    let [first, last] = bounds.unwrap_or([time_ns; 2]);
    *bounds = Some([first.min(time_ns), last.max(time_ns)]);
}

/// Appends a record.
fn record(to: &mut Vec<u8>, op: u8, body: impl FnOnce(&mut Vec<u8>)) {
    to.push(op);
    let length_at = to.len();
    number(to, 0_u64.to_le_bytes());
    body(to);
    let length = (to.len() - length_at - 8) as u64;
    to[length_at..length_at + 8].copy_from_slice(&length.to_le_bytes());
}

fn number<const N: usize>(to: &mut Vec<u8>, bytes: [u8; N]) {
    to.extend_from_slice(&bytes);
}

/// Appends what has its length before it in four bytes.
fn list(to: &mut Vec<u8>, items: impl FnOnce(&mut Vec<u8>)) {
    let length_at = to.len();
    number(to, 0_u32.to_le_bytes());
    items(to);
    // A list of 4 GiB could not be read either.
    let length = u32::try_from(to.len() - length_at - 4).unwrap_or(u32::MAX);
    to[length_at..length_at + 4].copy_from_slice(&length.to_le_bytes());
}

fn text(to: &mut Vec<u8>, text: &str) {
    list(to, |to| to.extend_from_slice(text.as_bytes()));
}

/// Appends what has its length before it in eight bytes.
fn blob(to: &mut Vec<u8>, bytes: &[u8]) {
    number(to, (bytes.len() as u64).to_le_bytes());
    to.extend_from_slice(bytes);
}
