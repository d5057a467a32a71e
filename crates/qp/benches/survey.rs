//! Solves random and adversarial problems by the million and prints the worst of each family:
//! `cargo bench -p moca-qp --bench survey -- 10000000`; a family's name after the number is that one only.
#![allow(clippy::unwrap_used, clippy::print_stdout, clippy::cast_possible_truncation, reason = "a program")]
#![allow(clippy::cast_sign_loss, clippy::cast_precision_loss, clippy::indexing_slicing, reason = "a program")]

#[path = "../tests/common/mod.rs"]
mod common;

use common::{FAMILIES, Family, Problem, Random, metric, optimality_error, problem, survey_seed};
use moca_qp::{QpError, WorkingSet};
use std::time::Instant;

#[derive(Default)]
struct Tally {
    problems: usize,
    steps: Vec<usize>,
    cold_ns: Vec<u32>,
    warm_ns: Vec<u32>,
    worst_error: f64,
    above: usize,
    wrong_verdicts: usize,
    unended: usize,
}

fn once<const N: usize>(tally: &mut Tally, problem: &Problem<N>) {
    let metric = metric(problem);
    let began = Instant::now();
    let solved = metric.nearest(&problem.target, &problem.rows, &WorkingSet::EMPTY);
    let cold = began.elapsed();
    tally.problems += 1;
    match solved {
        Ok(solution) if problem.feasible => {
            tally.cold_ns.push(cold.as_nanos() as u32);
            let from = solution.working_set();
            let began = Instant::now();
            let again = std::hint::black_box(metric.nearest(&problem.target, &problem.rows, &from));
            tally.warm_ns.push(began.elapsed().as_nanos() as u32);
            tally.wrong_verdicts += usize::from(again.is_err());
            let error = optimality_error(problem, &solution);
            tally.worst_error = tally.worst_error.max(error);
            tally.above += usize::from(error > 1e-9);
            let steps = solution.iterations;
            tally.steps.resize(tally.steps.len().max(steps + 1), 0);
            tally.steps[steps] += 1;
        }
        Err(QpError::IterationLimit { .. }) => tally.unended += 1,
        Err(QpError::Infeasible { .. }) if !problem.feasible => {}
        _ => tally.wrong_verdicts += 1,
    }
}

fn median(steps: &[usize]) -> usize {
    let half = steps.iter().sum::<usize>() / 2;
    let mut seen = 0;
    steps
        .iter()
        .position(|count| {
            seen += count;
            seen > half
        })
        .unwrap_or(0)
}

fn share(sorted: &[u32], of_all: f64) -> u32 {
    sorted.get((of_all * (sorted.len().max(1) - 1) as f64) as usize).copied().unwrap_or(0)
}

fn family<const N: usize>(family: Family, rows: usize, count: usize) {
    let mut tally = Tally::default();
    let mut random = Random::new(survey_seed::<N>(family));
    for _ in 0..count {
        once(&mut tally, &problem::<N>(family, rows, &mut random));
    }
    tally.cold_ns.sort_unstable();
    tally.warm_ns.sort_unstable();
    println!(
        "{:<14} {N:>2} x {rows:<3} {:>9} problems, steps {} most {:>3}, error {:.1e} ({} above 1e-9), wrong {}, unended {}; \
         cold {} {} ns, warm {} {} ns (median, 99 %)",
        format!("{family:?}"),
        tally.problems,
        median(&tally.steps),
        tally.steps.len().saturating_sub(1),
        tally.worst_error,
        tally.above,
        tally.wrong_verdicts,
        tally.unended,
        share(&tally.cold_ns, 0.5),
        share(&tally.cold_ns, 0.99),
        share(&tally.warm_ns, 0.5),
        share(&tally.warm_ns, 0.99),
    );
}

fn main() {
    let mut arguments = std::env::args().skip(1).filter(|argument| argument != "--bench");
    let count: usize = arguments.next().map_or(100_000, |count| count.parse().unwrap());
    let only = arguments.next();
    let families =
        FAMILIES.into_iter().filter(|kind| only.as_ref().is_none_or(|name| *name == format!("{kind:?}")));
    let each = count / (3 * FAMILIES.len());
    for kind in families {
        family::<4>(kind, 36, each);
        family::<7>(kind, 20, each);
        family::<10>(kind, 30, each);
    }
}
