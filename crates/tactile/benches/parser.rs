//! Parser throughput beside a bare scan for line feeds of the same bytes: the floor for anything that reads lines.
#![expect(clippy::unwrap_used, reason = "a benchmark")]

use criterion::{Criterion, Throughput, criterion_group, criterion_main};
use moca_tactile::datastream::{Event, Parser};
use moca_tactile::{Chunk, Cover, CoverConfig};
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

criterion_group!(benches, parser);
criterion_main!(benches);
