//! The records of an MCAP file one after the other, none of them trusted: every length is checked against what is left
//! of the file and against a limit before anything is allocated or skipped. (The `mcap` crate's reader allocates what a
//! damaged length asks for.) Format: <https://mcap.dev/spec>.

use std::io::{self, Read, Seek, SeekFrom};

/// Longest record that is read into memory, bytes; ours have less than 1 MiB.
const MAX_RECORD: u64 = 16 << 20;
/// Largest chunk after decompression, bytes.
const MAX_CHUNK: u64 = 16 << 20;

/// First and last bytes of an MCAP file.
pub(super) const MAGIC: [u8; 8] = *b"\x89MCAP0\r\n";

/// Kinds of records.
pub(super) mod op {
    pub(in crate::log) const HEADER: u8 = 0x01;
    pub(in crate::log) const FOOTER: u8 = 0x02;
    pub(in crate::log) const SCHEMA: u8 = 0x03;
    pub(in crate::log) const CHANNEL: u8 = 0x04;
    pub(in crate::log) const MESSAGE: u8 = 0x05;
    pub(in crate::log) const CHUNK: u8 = 0x06;
    pub(in crate::log) const MESSAGE_INDEX: u8 = 0x07;
    pub(in crate::log) const CHUNK_INDEX: u8 = 0x08;
    pub(in crate::log) const ATTACHMENT: u8 = 0x09;
    pub(in crate::log) const ATTACHMENT_INDEX: u8 = 0x0a;
    pub(in crate::log) const STATISTICS: u8 = 0x0b;
    pub(in crate::log) const METADATA: u8 = 0x0c;
    pub(in crate::log) const METADATA_INDEX: u8 = 0x0d;
    pub(in crate::log) const SUMMARY_OFFSET: u8 = 0x0e;
    pub(in crate::log) const DATA_END: u8 = 0x0f;
}

/// Kind and length before each record.
const PREFIX: u64 = 9;

/// Part of a file between its header and its end.
pub(super) enum Part {
    /// A chunk: its place, its first and last time, and its length in the file, bytes.
    Chunk { at: u64, times: [u64; 2], length: u64 },
    /// An index of the messages that the chunk before has of this channel.
    MessagesOf(u16),
    /// Metadata at this place.
    Metadata { at: u64 },
}

/// A file of records.
pub(super) struct Records<R> {
    input: R,
    at: u64,
    end: u64,
    body: Vec<u8>,
}

/// A record that has been read.
pub(super) struct Record<'a> {
    pub(super) op: u8,
    pub(super) body: &'a [u8],
}

impl<R: Read + Seek> Records<R> {
    /// From `at` to the end of the file.
    pub(super) fn new(mut input: R, at: u64) -> io::Result<Self> {
        let end = input.seek(SeekFrom::End(0))?;
        input.seek(SeekFrom::Start(at))?;
        Ok(Self { input, at, end, body: Vec::new() })
    }

    /// Returns the place of the next record.
    pub(super) const fn at(&self) -> u64 {
        self.at
    }

    /// Length of the file.
    pub(super) const fn end(&self) -> u64 {
        self.end
    }

    /// Goes to a record.
    pub(super) fn seek(&mut self, at: u64) -> io::Result<()> {
        self.input.seek(SeekFrom::Start(at))?;
        self.at = at;
        Ok(())
    }

    /// The next record that is wanted, or what is wrong with the file where it should be; others are skipped unread.
    pub(super) fn next(&mut self, wanted: impl Fn(u8) -> bool) -> Result<Record<'_>, String> {
        loop {
            let (op, length) = self.prefix()?;
            let left = self.end - self.at;
            if length > left {
                return Err(format!(
                    "a record of {length} bytes begins at byte {}, where {left} are left",
                    self.at
                ));
            }
            if !wanted(op) {
                let skip = i64::try_from(length).map_err(|_| "a length is absurd".to_owned())?;
                self.input.seek_relative(skip).map_err(|error| error.to_string())?;
                self.at += length;
                continue;
            }
            let size = usize::try_from(length).ok().filter(|_| length <= MAX_RECORD);
            let size = size.ok_or_else(|| format!("a record of {length} bytes, allowed are {MAX_RECORD}"))?;
            self.body.resize(size, 0);
            self.input.read_exact(&mut self.body).map_err(|error| error.to_string())?;
            self.at += length;
            return Ok(Record { op, body: &self.body });
        }
    }

    /// The next chunk, index of a chunk's messages or metadata, its body left unread; `None` behind the last one.
    pub(super) fn next_part(&mut self) -> Result<Option<Part>, String> {
        loop {
            let at = self.at;
            let (op, length) = self.prefix()?;
            if matches!(op, op::DATA_END | op::FOOTER) {
                return Ok(None);
            }
            if length > self.end - self.at {
                return Err("a record is cut".into());
            }
            let (part, read) = match op {
                op::CHUNK if length >= 16 => {
                    let times = [self.number()?, self.number()?].map(u64::from_le_bytes);
                    (Some(Part::Chunk { at, times, length: PREFIX + length }), 16)
                }
                op::MESSAGE_INDEX if length >= 2 => {
                    (Some(Part::MessagesOf(u16::from_le_bytes(self.number()?))), 2)
                }
                op::METADATA => (Some(Part::Metadata { at }), 0),
                _ => (None, 0),
            };
            let step = i64::try_from(length - read).map_err(|_| "a length is absurd".to_owned())?;
            self.input.seek_relative(step).map_err(|error| error.to_string())?;
            self.at += length;
            if part.is_some() {
                return Ok(part);
            }
        }
    }

    fn number<const N: usize>(&mut self) -> Result<[u8; N], String> {
        let mut bytes = [0; N];
        self.input.read_exact(&mut bytes).map_err(|error| error.to_string())?;
        Ok(bytes)
    }

    /// Kind and length of the next record.
    fn prefix(&mut self) -> Result<(u8, u64), String> {
        if self.end.saturating_sub(self.at) < PREFIX {
            return Err(format!("the file breaks off at byte {}", self.end));
        }
        let mut prefix = [0; 9];
        self.input.read_exact(&mut prefix).map_err(|error| error.to_string())?;
        self.at += PREFIX;
        let [op, length @ ..] = prefix;
        if !(op::HEADER..=op::DATA_END).contains(&op) {
            return Err(format!("no record begins at byte {}", self.at - PREFIX));
        }
        Ok((op, u64::from_le_bytes(length)))
    }
}

/// Fields of a record, little endian.
pub(super) struct Fields<'a>(pub(super) &'a [u8]);

impl<'a> Fields<'a> {
    pub(super) fn take(&mut self, length: usize) -> Option<&'a [u8]> {
        let (taken, rest) = self.0.split_at_checked(length)?;
        self.0 = rest;
        Some(taken)
    }

    pub(super) fn u8(&mut self) -> Option<u8> {
        Some(self.array::<1>()?[0])
    }

    pub(super) fn u16(&mut self) -> Option<u16> {
        self.array().map(u16::from_le_bytes)
    }

    pub(super) fn u32(&mut self) -> Option<u32> {
        self.array().map(u32::from_le_bytes)
    }

    pub(super) fn u64(&mut self) -> Option<u64> {
        self.array().map(u64::from_le_bytes)
    }

    pub(super) fn text(&mut self) -> Option<&'a str> {
        let length = usize::try_from(self.u32()?).ok()?;
        std::str::from_utf8(self.take(length)?).ok()
    }

    fn array<const N: usize>(&mut self) -> Option<[u8; N]> {
        self.take(N)?.try_into().ok()
    }
}

/// A chunk as it lies in the file.
struct Chunk<'a> {
    /// Length of its records, bytes.
    size: u64,
    /// Checksum of its records; 0 is none.
    crc: u32,
    compression: &'a str,
    records: &'a [u8],
}

impl<'a> Chunk<'a> {
    fn parse(body: &'a [u8]) -> Option<Self> {
        let mut fields = Fields(body);
        let _times = (fields.u64()?, fields.u64()?);
        let (size, crc, compression) = (fields.u64()?, fields.u32()?, fields.text()?);
        let length = usize::try_from(fields.u64()?).ok()?;
        Some(Self { size, crc, compression, records: fields.take(length)? })
    }
}

/// Name of a chunk's compression, where it is one that is not read.
pub(super) fn unread_compression(body: &[u8]) -> Option<&str> {
    let Chunk { compression, .. } = Chunk::parse(body)?;
    (!matches!(compression, "" | "zstd")).then_some(compression)
}

/// Records of a chunk, decompressed, and checked against its checksum if it has one.
pub(super) fn chunk(body: &[u8]) -> Result<Vec<u8>, String> {
    let Chunk { size, crc, compression, records } = Chunk::parse(body).ok_or("a chunk is damaged")?;
    let capacity = usize::try_from(size).ok().filter(|_| size <= MAX_CHUNK);
    let capacity = capacity.ok_or_else(|| format!("a chunk of {size} bytes, allowed are {MAX_CHUNK}"))?;
    let records = match compression {
        "zstd" => zstd::bulk::decompress(records, capacity)
            .map_err(|error| format!("a chunk is damaged: {error}"))?,
        "" => records.to_vec(),
        other => {
            return Err(format!("a chunk is compressed with {other:?}; zstd and no compression are read"));
        }
    };
    // the format's word for a checksum that was not computed is 0
    if records.len() != capacity || (crc != 0 && crc32fast::hash(&records) != crc) {
        return Err("a chunk does not fit its checksum".into());
    }
    Ok(records)
}

/// The records in a chunk, as far as their lengths make sense.
pub(super) fn records_in(mut chunk: &[u8]) -> impl Iterator<Item = Record<'_>> {
    std::iter::from_fn(move || {
        let mut fields = Fields(chunk);
        let op = fields.u8()?;
        let length = usize::try_from(fields.u64()?).ok()?;
        let body = fields.take(length)?;
        chunk = fields.0;
        Some(Record { op, body })
    })
}

/// A message.
pub(super) struct Message<'a> {
    pub(super) channel: u16,
    pub(super) time_ns: u64,
    pub(super) data: &'a [u8],
}

impl<'a> Message<'a> {
    pub(super) fn parse(body: &'a [u8]) -> Option<Self> {
        let mut fields = Fields(body);
        let (channel, _sequence) = (fields.u16()?, fields.u32()?);
        let (time_ns, _published_ns) = (fields.u64()?, fields.u64()?);
        Some(Self { channel, time_ns, data: fields.0 })
    }
}

/// Number and topic of a channel.
pub(super) fn channel(body: &[u8]) -> Option<(u16, &str)> {
    let mut fields = Fields(body);
    let (number, _schema) = (fields.u16()?, fields.u16()?);
    Some((number, fields.text()?))
}
