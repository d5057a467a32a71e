//! Parser throughput beside a bare scan for line feeds of the same bytes, the floor for anything that reads lines; and
//! what a control tick pays.
#![expect(clippy::unwrap_used, reason = "a benchmark")]

use criterion::{Criterion, Throughput, criterion_group, criterion_main};
use moca_tactile::datastream::{Event, Frame, MAX_COLUMNS, Parser, emit};
use moca_tactile::{Chunk, Cover, CoverConfig, Firmware};
use std::hint::black_box;

fn parser(criterion: &mut Criterion) {
    let path = concat!(env!("CARGO_MANIFEST_DIR"), "/../../tests/fixtures/recordings/datastream-2020.txt");
    let bytes = std::fs::read(path).unwrap();
    let mut group = criterion.benchmark_group("datastream");
    group.throughput(Throughput::Bytes(bytes.len() as u64));
    group.bench_function("memchr line scan", |b| {
        b.iter(|| memchr::memchr_iter(b'\n', black_box(&bytes)).count());
    });
    for (name, chunk) in [("parse, one piece", bytes.len()), ("parse, 64-byte chunks", 64)] {
        group.bench_function(name, |b| {
            b.iter(|| {
                let mut parser = Parser::new();
                let mut good = 0;
                for mut piece in black_box(&bytes).chunks(chunk) {
                    while let Some(event) = parser.next_event(&mut piece, 0) {
                        good += u32::from(matches!(event, Event::Frame(_)));
                    }
                }
                good
            });
        });
    }
    group.bench_function("cover, 64-byte chunks", |b| {
        b.iter(|| {
            let mut cover = Cover::<11>::new(CoverConfig::default()).unwrap();
            for (i, piece) in (0u64..).zip(black_box(&bytes).chunks(Chunk::CAPACITY / 4)) {
                cover.push(0, piece, i * 5_600_000);
            }
            cover.poll(0).fault
        });
    });
    group.finish();
}

/// Cost of the cover to a control tick, on average over ticks with and without bytes: the bytes of a stock board within the
/// millisecond go in, and the forces are read.
fn tick(criterion: &mut Criterion) {
    let mut frame = Frame { filtered: [720; MAX_COLUMNS], baseline: [720; MAX_COLUMNS], ..Frame::default() };
    let mut frames = Vec::new();
    // A cover without any noise would be taken for a broken one.
    for noise in [0, 1] {
        frame.filtered[5] = 690 + noise;
        let mut bytes = Vec::new();
        emit(&frame, &mut bytes);
        frames.push(bytes);
    }
    let ticks = Firmware::Stock2018.frame_period_ns().div_ceil(1_000_000);
    let mut cover = Cover::<11>::new(CoverConfig::default()).unwrap();
    let mut tick = 0;
    let mut step = move || {
        let (number, part) = (usize::try_from(tick / ticks).unwrap(), usize::try_from(tick % ticks).unwrap());
        let bytes = &frames[number % 2];
        let size = bytes.len().div_ceil(usize::try_from(ticks).unwrap());
        tick += 1;
        cover.push(0, bytes.chunks(size).nth(part).unwrap_or_default(), tick * 1_000_000);
        cover.poll(tick * 1_000_000).reading
    };
    for _ in 0..5000 {
        step();
    }
    let reading = step();
    assert!(reading.sampled_at_ns.is_some() && reading.taxels.len() == 11, "{reading:?}");
    criterion.bench_function("cover/tick", |b| b.iter(&mut step));
}

criterion_group!(benches, parser, tick);
criterion_main!(benches);
