//! Invariants for every input; shared by the fuzz targets and by the ordinary tests.

use moca_telemetry::log::{LogError, LogFile, LogReader, Record};
use moca_telemetry::net::wire;
use std::io::Cursor;
use std::path::Path;

/// A client's bytes are refused or decoded, and what is decoded encodes to the same meaning.
pub(crate) fn from_client(data: &[u8]) {
    let Ok(message) = wire::decode_from_client(data) else { return };
    let again = wire::encode(&message).unwrap();
    let back = wire::decode_from_client(&again[4..]).unwrap();
    assert_eq!(wire::encode(&back).unwrap(), again, "{message:?}");
}

/// Bytes of a server, its greeting first.
pub(crate) fn from_server(data: &[u8]) {
    // Either it greets or it says why not: any answer will do, for any bytes.
    let _ = wire::decode_greeting(data);
    let Ok(message) = wire::decode_from_server(data) else { return };
    let again = wire::encode(&message).unwrap();
    let back = wire::decode_from_server(&again[4..]).unwrap();
    assert_eq!(wire::encode(&back).unwrap(), again);
}

/// A log is refused or read to its end, one way and the other.
pub(crate) fn log(data: &[u8]) {
    let read = samples_of(data);
    let Ok(mut file) = LogFile::over(Cursor::new(data.to_vec()), Path::new("fuzzed")) else {
        assert!(read.is_err(), "one reader takes what the other refuses");
        return;
    };
    let (from_ns, to_ns) = file.range_ns();
    // Damage is an error here, and the overview is built up to it.
    let _ = file.samples(from_ns, to_ns.min(from_ns.saturating_add(2_000_000_000)));
    file.build_overview(&mut |_| {});
    let _ = file.account(&mut |_| {});
    let _ = file.rows(&["/state"], &mut |_| {});
}

/// Ticks of the samples that can be read, and why there are no more.
pub(crate) fn samples_of(data: &[u8]) -> Result<(Vec<u64>, Option<String>), LogError> {
    let mut reader = LogReader::over(Cursor::new(data.to_vec()), Path::new("fuzzed"))?;
    let mut ticks = Vec::new();
    for record in &mut reader {
        if let Record::Sample(sample) = record {
            ticks.push(sample.tick);
        }
    }
    Ok((ticks, reader.cut().map(Into::into)))
}
