//! Cold and warm solves: a cover's contacts (3 axes and a slack) and dense problems of 10 variables.
#![allow(clippy::unwrap_used, missing_docs, reason = "benches")]

#[path = "../tests/common/mod.rs"]
mod common;

use common::{Family, Problem, Random, metric, problem};
use criterion::{Criterion, criterion_group, criterion_main};
use moca_qp::{Metric, Row, WorkingSet};
use std::hint::black_box;

/// A base at 0.2 m/s, `touched` of its taxels demanding less, bounds of what one step can change.
fn touched_cover(touched: usize) -> Problem<4> {
    let mut made = problem::<4>(Family::Contact, 3, &mut Random::new(1));
    made.target = [0.2, 0.05, 0.1, 0.0];
    made.rows = vec![Row::bound(0, 0.195, 0.201), Row::bound(1, 0.045, 0.051), Row::bound(2, 0.09, 0.11)];
    for i in 0..touched {
        #[expect(clippy::cast_precision_loss, reason = "a small count")]
        let angle = 0.6 * i as f64;
        let normal = [-angle.cos(), -angle.sin(), 0.3 * angle.sin(), 0.0];
        made.rows.push(Row::at_least(normal, -0.05).softened(3));
    }
    made
}

fn pair<const N: usize>(c: &mut Criterion, name: &str, problems: &[Problem<N>]) {
    let prepared: Vec<(Metric<N>, &Problem<N>, WorkingSet<N>)> = problems
        .iter()
        .map(|problem| {
            let metric = metric(problem);
            let cold = metric.nearest(&problem.target, &problem.rows, &WorkingSet::EMPTY).unwrap();
            (metric, problem, cold.working_set())
        })
        .collect();
    let mut group = c.benchmark_group(name);
    for (start, warm) in [("cold", false), ("warm", true)] {
        group.bench_function(start, |b| {
            let mut next = prepared.iter().cycle();
            b.iter(|| {
                let (metric, problem, from) = next.next().unwrap();
                let from = if warm { *from } else { WorkingSet::EMPTY };
                black_box(metric.nearest(&problem.target, &problem.rows, &from)).unwrap()
            });
        });
    }
    group.finish();
}

fn solves(c: &mut Criterion) {
    for touched in [1, 2, 3, 11, 33] {
        pair(c, &format!("cover/{touched}_touched"), &[touched_cover(touched)]);
    }
    let mut random = Random::new(5);
    let mut hundred =
        |family| -> Vec<_> { (0..100).map(|_| problem::<4>(family, 36, &mut random)).collect() };
    pair(c, "4x36/contact", &hundred(Family::Contact));
    pair(c, "4x36/random", &hundred(Family::Random));
    let mut random = Random::new(5);
    let dense: Vec<_> = (0..100).map(|_| problem::<10>(Family::Random, 30, &mut random)).collect();
    pair(c, "10x30/random", &dense);
}

criterion_group!(benches, solves);
criterion_main!(benches);
