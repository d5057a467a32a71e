//! The recordings of a stock board: counts, inverse, chunking, faults with their times.
#![expect(clippy::unwrap_used, reason = "tests")]

use moca_msgs::{BoardFault, Fault};
use moca_tactile::{Cover, CoverConfig};
use moca_tactile::{
    Firmware,
    datastream::{Event, MAX_LINE_BYTES, Parser, emit},
};
use std::path::PathBuf;

const RECORDINGS: [(&str, u64, u64); 4] = [
    ("datastream-2020", 202, 0),
    ("datastream-2020-host-stall", 160, 1),
    ("datastream-2020-i2c-lost", 289, 0),
    ("datastream-2020-chip-reset", 223, 0),
];

fn fixture(name: &str) -> PathBuf {
    PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("../../tests/fixtures/recordings").join(name)
}

fn bytes(name: &str) -> Vec<u8> {
    std::fs::read(fixture(&format!("{name}.txt"))).unwrap()
}

/// (arrival ns, bytes read) of every read.
fn reads(name: &str) -> Vec<(u64, usize)> {
    let text = std::fs::read_to_string(fixture(&format!("{name}.times"))).unwrap();
    text.lines()
        .map(|line| {
            let (seconds, count) = line.split_once(' ').unwrap();
            let nanoseconds = seconds.parse::<f64>().unwrap() * 1e9;
            #[expect(
                clippy::cast_possible_truncation,
                clippy::cast_sign_loss,
                reason = "6 s of positive time"
            )]
            (nanoseconds as u64, count.parse().unwrap())
        })
        .collect()
}

fn events(bytes: &[u8], chunk: usize) -> Vec<Event> {
    let mut parser = Parser::new();
    let mut events = Vec::new();
    for mut chunk in bytes.chunks(chunk) {
        while let Some(event) = parser.next_event(&mut chunk, 0) {
            events.push(event);
        }
    }
    events
}

/// Replays a recording through a cover; calls `each` after every read.
fn replay(name: &str, mut each: impl FnMut(u64, &mut Cover<11>)) -> Cover<11> {
    let bytes = bytes(name);
    let mut cover = Cover::new(CoverConfig::default()).unwrap();
    let mut start = 0;
    for (arrival_ns, count) in reads(name) {
        cover.push(0, &bytes[start..start + count], arrival_ns);
        start += count;
        each(arrival_ns, &mut cover);
    }
    assert_eq!(start, bytes.len());
    cover
}

#[test]
fn well_formed_frames_are_counted() {
    for (name, good, bad) in RECORDINGS {
        let cover = replay(name, |_, _| {});
        let stats = *cover.boards().next().unwrap().stats();
        assert_eq!((stats.frames_good, stats.frames_bad), (good, bad), "{name}");
    }
}

#[test]
fn emitting_every_good_frame_gives_back_its_bytes() {
    for (name, good, _) in RECORDINGS {
        let stream = bytes(name);
        let mut searched = 0;
        let mut found = 0;
        for event in events(&stream, 64) {
            if let Event::Frame(stamped) = event {
                let mut out = Vec::new();
                emit(&stamped.frame, &mut out);
                let at = stream[searched..].windows(out.len()).position(|w| w == out);
                searched += at.unwrap() + out.len();
                found += 1;
            }
        }
        assert_eq!(found, good, "{name}");
    }
    // the undisturbed recording is nothing but frames, so the whole file comes back
    let stream = bytes("datastream-2020");
    let mut out = Vec::new();
    for event in events(&stream, stream.len()) {
        if let Event::Frame(stamped) = event {
            emit(&stamped.frame, &mut out);
        }
    }
    assert_eq!(out, stream);
}

#[test]
fn chunking_changes_nothing() {
    for (name, ..) in RECORDINGS {
        let stream = bytes(name);
        let whole = events(&stream, stream.len());
        for chunk in [1, 2, 7, 64, MAX_LINE_BYTES, 1000] {
            assert_eq!(events(&stream, chunk), whole, "{name} in chunks of {chunk}");
        }
    }
}

#[test]
fn rate_and_generation_are_measured() {
    let cover = replay("datastream-2020", |_, _| {});
    let board = cover.boards().next().unwrap();
    assert_eq!(board.firmware(), Some(Firmware::Stock2018));
    assert!((board.rate_hz() - 40.5).abs() < 0.7, "{}", board.rate_hz());
}

/// Loop time of the first read after which the cover reports `fault`, and of the last read before the cause.
fn first_fault(name: &str, fault: Fault) -> Option<u64> {
    let mut at_ns = None;
    replay(name, |arrival_ns, cover| {
        if at_ns.is_none() && cover.poll(arrival_ns).fault == Some(fault) {
            at_ns = Some(arrival_ns);
        }
    });
    at_ns
}

#[test]
fn frozen_data_is_found_within_15_frames() {
    let at_ns = first_fault("datastream-2020-i2c-lost", BoardFault::Frozen.of(0)).unwrap();
    let mut frames_since_change = 0;
    let mut last = [0; 11];
    let mut frames = 0;
    replay("datastream-2020-i2c-lost", |arrival_ns, cover| {
        let good = cover.boards().next().unwrap().stats().frames_good;
        if arrival_ns <= at_ns && good > frames {
            frames_since_change =
                if cover.counts() == last { frames_since_change + good - frames } else { 0 };
            last = cover.counts();
            frames = good;
        }
    });
    assert!((1..=15).contains(&frames_since_change), "{frames_since_change}");
}

#[test]
fn a_reset_chip_is_found_in_the_first_zero_frame() {
    let at_ns = first_fault("datastream-2020-chip-reset", BoardFault::Reset.of(0)).unwrap();
    let mut zero_frame_ns = None;
    replay("datastream-2020-chip-reset", |arrival_ns, cover| {
        let started = cover.boards().next().unwrap().stats().frames_good > 0;
        if zero_frame_ns.is_none() && started && cover.counts() == [0; 11] {
            zero_frame_ns = Some(arrival_ns);
        }
    });
    assert_eq!(zero_frame_ns, Some(at_ns));
}

#[test]
fn changed_thresholds_are_a_fault_of_the_stream() {
    assert!(first_fault("datastream-2020-i2c-lost", BoardFault::Thresholds.of(0)).is_some());
    assert!(first_fault("datastream-2020", BoardFault::Thresholds.of(0)).is_none());
}

#[test]
fn a_host_stall_discards_old_data_and_silence_shows_meanwhile() {
    let mut silent = false;
    let mut last_ns = 0;
    let cover = replay("datastream-2020-host-stall", |arrival_ns, cover| {
        if arrival_ns - last_ns > 500_000_000 && last_ns > 0 {
            let mut before = cover.clone();
            silent |= before.poll(arrival_ns).fault == Some(BoardFault::Silent.of(0));
        }
        last_ns = arrival_ns;
    });
    let stats = *cover.boards().next().unwrap().stats();
    assert!(silent);
    assert_eq!((stats.stalls, stats.frames_discarded), (1, 1));
}
