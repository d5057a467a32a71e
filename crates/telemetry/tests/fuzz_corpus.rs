//! The fuzzers' corpus and a thousand seeded mutations of a log, through the same checks.
//!
//! Fuzzing itself: `cd crates/telemetry && cargo +nightly fuzz run log -- -max_total_time=300` (or `from_client`,
//! `from_server`).
#![cfg(all(feature = "log", feature = "net"))]
#![expect(unsafe_code, reason = "an allocator that sees how much is asked of it")]
#![expect(clippy::unwrap_used, clippy::cast_possible_truncation, reason = "tests")]

#[path = "../fuzz/checks.rs"]
mod checks;

use moca_msgs::{Mode, Sample, TaxelReading, TaxelStatus};
use moca_telemetry::RobotDescription;
use moca_telemetry::log::{LogWriter, Meta, SerialBytes};
use moca_telemetry::net::wire;
use std::alloc::{GlobalAlloc, Layout, System};
use std::path::PathBuf;
use std::sync::atomic::{AtomicUsize, Ordering};

/// The largest block that anybody has asked for, bytes.
static LARGEST: AtomicUsize = AtomicUsize::new(0);

struct Watched;

// SAFETY: the system's allocator does the work; noting a size changes nothing.
unsafe impl GlobalAlloc for Watched {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        LARGEST.fetch_max(layout.size(), Ordering::Relaxed);
        // SAFETY: the caller's promise is passed on.
        unsafe { System.alloc(layout) }
    }

    unsafe fn dealloc(&self, block: *mut u8, layout: Layout) {
        // SAFETY: the caller's promise is passed on.
        unsafe { System.dealloc(block, layout) }
    }
}

#[global_allocator]
static ALLOCATOR: Watched = Watched;

fn corpus(target: &str) -> Vec<Vec<u8>> {
    let folder = PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("fuzz/corpus").join(target);
    let entries = std::fs::read_dir(folder).unwrap();
    entries.map(|entry| std::fs::read(entry.unwrap().path()).unwrap()).collect()
}

/// A second and a half of a run with blocks, bytes and a stop.
fn log() -> Vec<u8> {
    let mut bytes = Vec::new();
    let meta = Meta {
        description: RobotDescription::paper("mutated", true),
        start_unix_ns: 1_790_000_000_000_000_000,
    };
    let mut writer = LogWriter::new(&mut bytes, &meta).unwrap();
    for tick in 0..1600_u32 {
        let t = f64::from(tick) * 1e-3;
        let mode = if tick < 1000 { Mode::Impedance } else { Mode::ProtectiveStop };
        let time_ns = u64::from(tick) * 1_000_000;
        let mut sample = Sample { tick: tick.into(), time_ns, mode, ..Sample::default() };
        sample.base_pose_world = [t.sin(), t.cos(), t];
        sample.q_rad.extend([t.sin(); 7]);
        sample.taxels.extend([TaxelReading { force_n: t, status: TaxelStatus::Ok }; 11]);
        writer.sample(&sample).unwrap();
        if tick % 250 == 249 {
            writer.replay(time_ns, &[7; 1000]).unwrap();
        }
        if tick % 25 == 0 {
            writer
                .serial(&SerialBytes { board: 0, arrival_ns: time_ns, bytes: b"TOUCH: 0 0\r\n".to_vec() })
                .unwrap();
        }
    }
    writer.finish().unwrap();
    bytes
}

/// Returns the end of each chunk, and the number of samples before it.
fn chunk_ends(bytes: &[u8]) -> Vec<(usize, usize)> {
    let summary = mcap::Summary::read(bytes).unwrap().unwrap();
    let mut samples = 0;
    let count = |chunk: &mcap::records::ChunkIndex| {
        let messages = summary.stream_chunk(bytes, chunk).unwrap();
        samples += messages.filter(|m| m.as_ref().unwrap().channel.topic == "/timing").count();
        ((chunk.chunk_start_offset + chunk.chunk_length) as usize, samples)
    };
    summary.chunk_indexes.iter().map(count).collect()
}

struct Random(u64);

impl Random {
    fn below(&mut self, limit: usize) -> usize {
        self.0 = self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (self.0 >> 33) as usize % limit
    }
}

/// A flipped bit, a byte, a length or a piece that is not what it was; the first byte that differs.
fn mutate(bytes: &mut Vec<u8>, random: &mut Random) -> usize {
    let at = random.below(bytes.len() - 16);
    match random.below(5) {
        0 => bytes[at] ^= 1 << random.below(8),
        1 => bytes[at] = random.below(256) as u8,
        2 => {
            bytes[at..at + 8].copy_from_slice(&[[0xff; 8], [0, 0, 0, 0, 0, 2, 0, 0], [0; 8]][random.below(3)])
        }
        3 => drop(bytes.drain(at..at + 1 + random.below(15))),
        _ => drop(bytes.splice(at..at, std::iter::repeat_n(0x5a, 1 + random.below(40)))),
    }
    at
}

#[test]
fn the_corpus_passes() {
    for (target, check) in [
        ("from_client", checks::from_client as fn(&[u8])),
        ("from_server", checks::from_server),
        ("log", checks::log),
    ] {
        let inputs = corpus(target);
        assert!(!inputs.is_empty(), "{target}");
        inputs.iter().for_each(|input| check(input));
    }
}

#[test]
fn damaged_log_keeps_everything_before_the_damage() {
    // `MUTATIONS=100000` for longer.
    let mutations = std::env::var("MUTATIONS").map_or(1000, |count| count.parse().unwrap());
    let whole = log();
    let ends = chunk_ends(&whole);
    let (all, None) = checks::samples_of(&whole).unwrap() else { unreachable!("the log itself is whole") };
    let mut random = Random(1);
    let (mut refused, mut cut) = (0, 0);
    LARGEST.store(0, Ordering::Relaxed);
    for number in 0..mutations {
        let mut bytes = whole.clone();
        let at = mutate(&mut bytes, &mut random);
        checks::log(&bytes);
        let Ok((ticks, said)) = checks::samples_of(&bytes) else {
            assert!(at < ends[0].0, "mutation {number} at {at}: a log whose beginning is whole was refused");
            refused += 1;
            continue;
        };
        let kept = ends.iter().rev().find(|(end, _)| *end <= at).map_or(0, |(_, samples)| *samples);
        assert!(ticks.len() >= kept, "mutation {number} at {at}: {} of {kept} samples", ticks.len());
        assert!(ticks == all[..ticks.len()], "mutation {number} at {at}: samples that never were");
        assert!(
            said.is_some() || ticks.len() == all.len(),
            "mutation {number} at {at}: samples missing in silence"
        );
        cut += usize::from(said.is_some());
    }
    assert!(cut > mutations / 2, "{cut} of {mutations} noticed, {refused} refused");
    let largest = LARGEST.load(Ordering::Relaxed);
    assert!(largest <= 32 << 20, "a damaged length made somebody allocate {largest} bytes");
}

#[test]
fn noise_from_either_side_of_the_wire_is_refused_or_understood() {
    let mut random = Random(2);
    let mut seeds: Vec<Vec<u8>> = ["from_client", "from_server"].into_iter().flat_map(corpus).collect();
    let mut sample = Sample { tick: 7, mode: Mode::Impedance, ..Sample::default() };
    sample.q_rad.extend([0.5; 7]);
    sample.taxels.extend([TaxelReading { force_n: 3.0, status: TaxelStatus::Ok }; 11]);
    let batch = wire::Batch { sent_unix_ns: 1, samples: vec![sample; 3] };
    seeds.push(wire::encode(&wire::FromServer::Batch(batch)).unwrap()[4..].to_vec());
    for _ in 0..2000 {
        let mut bytes = seeds[random.below(seeds.len())].clone();
        for _ in 0..=random.below(4) {
            let at = random.below(bytes.len());
            bytes[at] = random.below(256) as u8;
        }
        bytes.truncate(1 + random.below(bytes.len()));
        checks::from_client(&bytes);
        checks::from_server(&bytes);
    }
}
