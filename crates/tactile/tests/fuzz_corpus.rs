//! The fuzzers' corpus and seeded damage to a recording, through the same checks.
//!
//! Fuzzing itself: `cd crates/tactile && cargo +nightly fuzz run stream -- -max_total_time=300`.
#![cfg(feature = "calibration")]
#![expect(clippy::unwrap_used, clippy::cast_possible_truncation, reason = "tests")]

#[path = "../fuzz/checks.rs"]
mod checks;

use std::path::PathBuf;

fn folder(name: &str) -> PathBuf {
    PathBuf::from(env!("CARGO_MANIFEST_DIR")).join(name)
}

fn corpus(target: &str) -> Vec<Vec<u8>> {
    let entries = std::fs::read_dir(folder("fuzz/corpus").join(target)).unwrap();
    entries.map(|entry| std::fs::read(entry.unwrap().path()).unwrap()).collect()
}

#[test]
fn the_corpus_passes() {
    let streams = corpus("stream");
    assert!(!streams.is_empty());
    streams.iter().for_each(|input| checks::stream(input));
    let files = corpus("calibration_file");
    assert!(!files.is_empty());
    files.iter().for_each(|input| checks::calibration_file(input));
}

#[test]
fn damaged_recordings_pass() {
    let recording = std::fs::read(folder("../../tests/fixtures/recordings/datastream-2020.txt")).unwrap();
    let mut state: u64 = 1;
    let mut next = |limit: usize| {
        state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (state >> 33) as usize % limit
    };
    for _ in 0..200 {
        let start = next(recording.len() - 2000);
        let mut piece = recording[start..start + 2000].to_vec();
        for _ in 0..next(6) {
            let at = next(piece.len());
            match next(4) {
                0 => piece[at] = next(256) as u8,
                1 => drop(piece.drain(at..(at + next(90)).min(piece.len()))),
                2 => piece.insert(at, b"0123456789- \r\n"[next(14)]),
                _ => piece.truncate(at.max(300)),
            }
        }
        piece.insert(0, next(256) as u8);
        checks::stream(&piece);
    }
}

#[test]
fn ten_megabytes_without_a_newline_and_then_a_frame() {
    use moca_tactile::datastream::{Event, Frame, Parser, emit};
    let mut parser = Parser::new();
    let endless = vec![b'7'; 1 << 20];
    for _ in 0..10 {
        assert_eq!(parser.next_event(&mut endless.as_slice(), 0), None);
    }
    let mut bytes = vec![b'\n'];
    emit(&Frame::default(), &mut bytes);
    assert!(matches!(parser.next_event(&mut bytes.as_slice(), 0), Some(Event::Frame(_))));
    assert!(size_of::<Parser>() < 512, "{} bytes, on no heap", size_of::<Parser>());
}
