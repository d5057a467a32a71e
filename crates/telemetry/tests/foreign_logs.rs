//! Logs that other programs have written again, and MCAP files that are no logs: read, or refused in one true sentence.
#![cfg(feature = "log")]
#![allow(
    clippy::unwrap_used,
    clippy::float_cmp,
    reason = "test helpers fail by panicking; read back bit by bit"
)]

use mcap::{Compression, MessageStream, WriteOptions, Writer};
use moca_msgs::{BoardFault, Mode, Sample, TaxelReading, TaxelStatus};
use moca_telemetry::RobotDescription;
use moca_telemetry::log::{LogError, LogFile, LogReader, LogWriter, Meta, Record};
use std::io::Cursor;
use std::path::Path;

const FORM: &str = "moca-s/4";

fn sample(tick: u32) -> Sample {
    let fault = (tick >= 2000).then_some(BoardFault::Lost.of(0));
    let mode = if fault.is_some() { Mode::ProtectiveStop } else { Mode::Impedance };
    let time_ns = u64::from(tick) * 1_000_000;
    let mut sample = Sample { tick: u64::from(tick), time_ns, mode, fault, ..Sample::default() };
    sample.q_rad.extend([f64::from(tick) * 1e-3; 7]);
    sample.taxels.extend([TaxelReading { force_n: 0.0, status: TaxelStatus::Ok }; 11]);
    sample
}

/// Three seconds with a fault at 2 s.
fn ours() -> Vec<u8> {
    let mut bytes = Vec::new();
    let meta =
        Meta { description: RobotDescription::paper("test", true), start_unix_ns: 1_790_000_000_000_000_000 };
    let mut writer = LogWriter::new(&mut bytes, &meta).unwrap();
    (0..3000).for_each(|tick| writer.sample(&sample(tick)).unwrap());
    writer.finish().unwrap();
    bytes
}

/// A log written again message by message, as the tools of others do.
fn rewritten(log: &[u8], options: WriteOptions) -> Vec<u8> {
    let mut out = Cursor::new(Vec::new());
    let mut writer = Writer::with_options(&mut out, options.library("another program")).unwrap();
    for message in MessageStream::new(log).unwrap() {
        writer.write(&message.unwrap()).unwrap();
    }
    writer.finish().unwrap();
    drop(writer);
    out.into_inner()
}

fn open(bytes: &[u8]) -> Result<LogFile, LogError> {
    LogFile::over(Cursor::new(bytes.to_vec()), Path::new("foreign.mcap"))
}

/// Returns the samples of one reader after the other, and the reason why it ends.
fn read(bytes: &[u8]) -> Result<(Vec<Sample>, Option<String>), LogError> {
    let mut reader = LogReader::over(Cursor::new(bytes.to_vec()), Path::new("foreign.mcap"))?;
    let mut samples = Vec::new();
    for record in &mut reader {
        if let Record::Sample(sample) = record {
            samples.push(*sample);
        }
    }
    Ok((samples, reader.cut().map(Into::into)))
}

#[test]
fn log_that_another_program_wrote_again_reads_the_same() {
    let log = ours();
    let (expected, cut) = read(&log).unwrap();
    assert!(expected.len() > 100 && cut.is_none());
    let options = || WriteOptions::new().profile(FORM);
    let bare = options().emit_summary_records(false).emit_summary_offsets(false).calculate_chunk_crcs(false);
    for (name, options) in [
        ("zstd", options().compression(Some(Compression::Zstd))),
        ("not compressed", options().compression(None)),
        ("chunks that divide a tick", options().compression(None).chunk_size(Some(2000))),
        ("no checksums", options().compression(None).calculate_chunk_crcs(false).chunk_size(Some(9000))),
        ("no index", bare.compression(Some(Compression::Zstd)).chunk_size(Some(9000))),
    ] {
        let bytes = rewritten(&log, options);
        assert!(read(&bytes).unwrap() == (expected.clone(), None), "{name}: one after the other");
        let mut file = open(&bytes).unwrap();
        assert_eq!(file.cut(), None, "{name}");
        for (from_ns, to_ns) in [(2_500_000_000, 2_600_000_000), (500_000_000, 600_000_000), (0, u64::MAX)] {
            let wanted = |sample: &&Sample| (from_ns..=to_ns).contains(&sample.time_ns);
            let expected: Vec<&Sample> = expected.iter().filter(wanted).collect();
            let found = file.samples(from_ns, to_ns).unwrap();
            assert!(found.iter().eq(expected), "{name}: a look at {from_ns} to {to_ns} ns");
        }
        assert!(file.overview().is_none(), "{name}: an overview says only of its own file what is in it");
        assert_eq!(file.build_overview(&mut |_| {}).spans.len(), 3, "{name}");
    }
}

#[test]
fn checksum_of_a_chunk_is_looked_at_where_it_has_one() {
    let bare = || WriteOptions::new().profile(FORM).compression(None);
    for (options, noticed) in [(bare(), true), (bare().calculate_chunk_crcs(false), false)] {
        let mut bytes = rewritten(&ours(), options);
        let number = bytes.windows(7).position(|bytes| bytes == b"\"q_rad\"").unwrap();
        let digit = bytes[number..].iter().position(u8::is_ascii_digit).unwrap();
        bytes[number + digit] = b'7';
        assert_eq!(read(&bytes).unwrap().1.is_some(), noticed);
    }
}

/// A record: kind, length, body.
fn record(op: u8, body: &[u8]) -> Vec<u8> {
    [&[op], &u64::try_from(body.len()).unwrap().to_le_bytes()[..], body].concat()
}

fn text(text: &str) -> Vec<u8> {
    [&u32::try_from(text.len()).unwrap().to_le_bytes()[..], text.as_bytes()].concat()
}

/// A file with this header and these records after it.
fn file(profile: &str, records: &[u8]) -> Vec<u8> {
    let header = record(1, &[text(profile), text("by hand")].concat());
    [mcap::MAGIC, &header, records].concat()
}

#[test]
fn file_that_is_no_log_is_refused_in_one_true_sentence() {
    let log = ours();
    let lz4 = record(6, &[&[0; 28][..], &text("lz4"), &[0; 8]].concat());
    let again = |profile: &str| rewritten(&log, WriteOptions::new().profile(profile));
    let first_chunk = log.windows(4).position(|bytes| bytes == b"zstd").unwrap();
    for (bytes, said) in [
        (b"#ROSBAG V2.0\n".to_vec(), "foreign.mcap is not an MCAP file"),
        (mcap::MAGIC.to_vec(), "foreign.mcap ends within its header: nothing in it can be read"),
        (log[..30].to_vec(), "foreign.mcap ends within its header: nothing in it can be read"),
        (
            log[..first_chunk + 50].to_vec(),
            "foreign.mcap ends within its first chunk: nothing in it can be read",
        ),
        (file(FORM, &[]), "foreign.mcap ends within its first chunk: nothing in it can be read"),
        (file(FORM, &record(15, &[0; 4])), "foreign.mcap holds no messages: nothing in it can be read"),
        (
            again("ros2"),
            "foreign.mcap is an MCAP file of another program, with the profile \"ros2\", a log's is moca-s/4",
        ),
        (
            again(""),
            "foreign.mcap is an MCAP file without a profile (a log of form moca-s/1, or one that another program has \
             written again), a log's is moca-s/4",
        ),
        (
            again("moca-s/3"),
            "foreign.mcap is a log of form moca-s/3, this program reads moca-s/4: use the version that wrote it",
        ),
        (
            rewritten(&log, WriteOptions::new().profile(FORM).use_chunks(false)),
            "foreign.mcap holds messages outside of chunks, which no log does: write it again in chunks, such as with \
             `mcap compress`",
        ),
        (
            file(FORM, &lz4),
            "foreign.mcap is compressed with lz4, a log with zstd: write it again with `mcap compress --compression zstd`",
        ),
    ] {
        let error = read(&bytes).unwrap_err();
        assert_eq!(error.to_string(), said);
        assert_eq!(open(&bytes).err().unwrap().to_string(), said, "one reader says what the other does");
        assert!(error.is_of_no_log(), "{said}");
    }
    assert!(!LogError::Panicked.is_of_no_log());
}
