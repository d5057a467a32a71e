//! Writes problems for `compare/compare.py` and prints the times of this crate on them, cold, each problem once:
//! `cargo bench -p moca-qp --bench compare -- FILE`, an absolute path.
//!
//! The file is little-endian f64: for each of the sets count, N, rows; then for each problem H, −H·target, and for each
//! row its normal, lower and upper bound; last the nearest point.
#![allow(clippy::unwrap_used, clippy::print_stdout, reason = "a program")]
#![allow(clippy::cast_precision_loss, reason = "small counts")]

#[path = "../tests/common/mod.rs"]
mod common;

use common::{Family, Problem, Random, dot, metric, problem};
use moca_qp::{Metric, WorkingSet};
use std::hint::black_box;
use std::time::Instant;

const PROBLEMS: usize = 2000;

fn set<const N: usize>(name: &str, family: Family, rows: usize, file: &mut Vec<f64>) {
    let mut random = Random::new(3);
    let problems: Vec<(Metric<N>, Problem<N>)> = (0..PROBLEMS)
        .map(|_| problem::<N>(family, rows, &mut random))
        .map(|problem| (metric(&problem), problem))
        .collect();
    let mut nanoseconds = Vec::new();
    file.extend([PROBLEMS as f64, N as f64, rows as f64]);
    for (metric, problem) in &problems {
        let mut best = f64::INFINITY;
        for _ in 0..5 {
            let began = Instant::now();
            let _ = black_box(metric.nearest(black_box(&problem.target), &problem.rows, &WorkingSet::EMPTY));
            best = best.min(began.elapsed().as_secs_f64());
        }
        nanoseconds.push(best * 1e9);
        file.extend(problem.hessian.iter().flatten());
        file.extend(problem.hessian.iter().map(|row| -dot(row, &problem.target)));
        for row in &problem.rows {
            file.extend(row.normal);
            file.extend([row.lower.max(-1e30), row.upper.min(1e30)]);
        }
        file.extend(metric.nearest(&problem.target, &problem.rows, &WorkingSet::EMPTY).unwrap().x);
    }
    nanoseconds.sort_by(f64::total_cmp);
    let [median, most, worst] =
        [PROBLEMS / 2, PROBLEMS * 99 / 100, PROBLEMS - 1].map(|i| nanoseconds[i] / 1e3);
    println!("{name:<14} moca-qp              median {median:7.2}  99 % {most:7.2}  worst {worst:7.2} us");
}

fn main() {
    let Some(path) = std::env::args().skip(1).find(|argument| argument != "--bench") else {
        println!("usage: cargo bench -p moca-qp --bench compare -- FILE");
        return;
    };
    let mut file = Vec::new();
    set::<4>("contact 4x36", Family::Contact, 36, &mut file);
    set::<4>("random 4x36", Family::Random, 36, &mut file);
    set::<10>("random 10x30", Family::Random, 30, &mut file);
    std::fs::write(path, file.iter().flat_map(|value| value.to_le_bytes()).collect::<Vec<_>>()).unwrap();
}
