//! The solver against two that share nothing with it: every set of active rows tried in turn, and Clarabel's interior
//! point.
#![allow(clippy::unwrap_used, clippy::cast_precision_loss, clippy::print_stdout, reason = "tests")]
#![allow(clippy::needless_range_loop, reason = "matrix algorithms read as in the books: by index")]
#![allow(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "tests")]

mod common;

use clarabel::algebra::CscMatrix;
use clarabel::solver::{DefaultSettingsBuilder, DefaultSolver, IPSolver, SolverStatus, SupportedConeT};
use common::{FAMILIES, Family, Problem, Random, dot, metric, optimality_error, problem, survey_seed};
use moca_qp::WorkingSet;

/// Rows as normal·x ≥ bound, one for each finite side.
fn sides<const N: usize>(problem: &Problem<N>) -> Vec<([f64; N], f64)> {
    let mut sides = Vec::new();
    for row in &problem.rows {
        if row.lower.is_finite() {
            sides.push((row.normal, row.lower));
        }
        if row.upper.is_finite() {
            sides.push((row.normal.map(|a| -a), -row.upper));
        }
    }
    sides
}

/// Solves the square system with its right side in the last column, by Gauss with pivoting; `None` if singular.
fn gauss(mut a: Vec<Vec<f64>>) -> Option<Vec<f64>> {
    let n = a.len();
    for k in 0..n {
        let pivot = (k..n).max_by(|&i, &j| a[i][k].abs().total_cmp(&a[j][k].abs()))?;
        a.swap(k, pivot);
        if a[k][k].abs() < 1e-11 {
            return None;
        }
        for i in k + 1..n {
            let factor = a[i][k] / a[k][k];
            for j in k..=n {
                a[i][j] -= factor * a[k][j];
            }
        }
    }
    let mut x = vec![0.0; n];
    for i in (0..n).rev() {
        x[i] = (a[i][n] - (i + 1..n).map(|j| a[i][j] * x[j]).sum::<f64>()) / a[i][i];
    }
    Some(x)
}

/// The cheapest point that keeps the rows among those that each set of at most `N` sides, held as equalities, gives.
fn enumerated<const N: usize>(problem: &Problem<N>) -> Option<([f64; N], f64)> {
    let sides = sides(problem);
    let mut best: Option<([f64; N], f64)> = None;
    let mut set: Vec<usize> = Vec::new();
    loop {
        // stationarity of H(x − t) = Σ u a and a·x = b
        let size = N + set.len();
        let mut system = vec![vec![0.0; size + 1]; size];
        for i in 0..N {
            system[i][..N].copy_from_slice(&problem.hessian[i]);
            system[i][size] = dot(&problem.hessian[i], &problem.target);
            for (k, &s) in set.iter().enumerate() {
                system[i][N + k] = -sides[s].0[i];
                system[N + k][i] = sides[s].0[i];
                system[N + k][size] = sides[s].1;
            }
        }
        if let Some(solution) = gauss(system) {
            let x: [f64; N] = core::array::from_fn(|i| solution[i]);
            if sides.iter().all(|(a, b)| dot(a, &x) >= b - 1e-9) {
                let cost = cost(problem, &x);
                if best.is_none_or(|(_, least)| cost < least) {
                    best = Some((x, cost));
                }
            }
        }
        // the next set, in the order of a depth-first walk
        let next = set.last().map_or(0, |last| last + 1);
        if set.len() < N && next < sides.len() {
            set.push(next);
            continue;
        }
        loop {
            match set.pop() {
                None => return best,
                Some(last) if last + 1 < sides.len() => {
                    set.push(last + 1);
                    break;
                }
                Some(_) => {}
            }
        }
    }
}

fn cost<const N: usize>(problem: &Problem<N>, x: &[f64; N]) -> f64 {
    let off: [f64; N] = core::array::from_fn(|i| x[i] - problem.target[i]);
    (0..N).map(|i| 0.5 * off[i] * dot(&problem.hessian[i], &off)).sum()
}

fn against_enumeration<const N: usize>(rows: usize, count: usize) {
    let mut random = Random::new(N as u64);
    let mut worst = 0.0_f64;
    let mut solved = 0;
    for k in 0..count {
        // the enumeration itself has no digits left for rows that are nearly parallel or of many sizes
        let family = [Family::Random, Family::Contact, Family::Ball, Family::Degenerate][k % 4];
        let problem = problem::<N>(family, rows, &mut random);
        let found = metric(&problem).nearest(&problem.target, &problem.rows, &WorkingSet::EMPTY).unwrap();
        let (x, least) = enumerated(&problem).unwrap();
        let size = x.iter().map(|x| x.abs()).fold(1.0, f64::max);
        let off = x.iter().zip(&found.x).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max) / size;
        assert!(off < 1e-7, "{family:?} {k}: {:?} against {x:?}", found.x);
        let dearer = (cost(&problem, &found.x) - least) / least.max(1.0);
        worst = worst.max(dearer.abs());
        solved += 1;
    }
    println!("{N} variables: {solved} problems, worst relative difference of cost {worst:.1e}");
    assert!(worst < 1e-9, "{worst:e}");
}

#[test]
fn every_active_set_enumerated_gives_the_same_point() {
    against_enumeration::<2>(12, 400);
    against_enumeration::<3>(10, 120);
    against_enumeration::<4>(8, 60);
    against_enumeration::<5>(8, 16);
    against_enumeration::<6>(7, 8);
    against_enumeration::<7>(7, 4);
}

fn clarabel<const N: usize>(problem: &Problem<N>) -> ([f64; N], SolverStatus) {
    let sides = sides(problem);
    let p = CscMatrix::from(&problem.hessian.map(|row| row.to_vec()).to_vec()).to_triu();
    let q: Vec<f64> = problem.hessian.iter().map(|row| -dot(row, &problem.target)).collect();
    // −a·x + s = −b, s ≥ 0
    let a = CscMatrix::from(&sides.iter().map(|(a, _)| a.map(|a| -a).to_vec()).collect::<Vec<_>>());
    let b: Vec<f64> = sides.iter().map(|(_, b)| -b).collect();
    let settings = DefaultSettingsBuilder::default()
        .verbose(false)
        .tol_gap_abs(1e-11)
        .tol_gap_rel(1e-11)
        .tol_feas(1e-11)
        .max_iter(200)
        .build()
        .unwrap();
    let cones = [SupportedConeT::NonnegativeConeT(b.len())];
    let mut solver = DefaultSolver::new(&p, &q, &a, &b, &cones, settings).unwrap();
    solver.solve();
    (core::array::from_fn(|i| solver.solution.x[i]), solver.solution.status)
}

fn against_clarabel<const N: usize>(family: Family, rows: usize, count: usize) {
    let mut random = Random::new(77 + N as u64);
    let (mut worst, mut compared) = (0.0_f64, 0);
    for k in 0..count {
        let problem = problem::<N>(family, rows, &mut random);
        let found = metric(&problem).nearest(&problem.target, &problem.rows, &WorkingSet::EMPTY);
        let (x, status) = clarabel(&problem);
        if !problem.feasible {
            assert_eq!(status, SolverStatus::PrimalInfeasible);
            assert!(matches!(found, Err(moca_qp::QpError::Infeasible { .. })), "{family:?} {k}: {found:?}");
            compared += 1;
            continue;
        }
        let found = found.unwrap();
        if status != SolverStatus::Solved {
            continue; // it ends "almost solved" where it cannot reach its own tolerance
        }
        let (ours, theirs) = (cost(&problem, &found.x), cost(&problem, &x));
        worst = worst.max((ours - theirs) / theirs.abs().max(1.0));
        compared += 1;
    }
    println!("{family:?}, {N} variables, {rows} rows: {compared} of {count} compared, worst {worst:.1e}");
    assert!(compared * 2 > count, "{compared} of {count}");
    assert!(worst < 1e-9, "{family:?}: dearer than Clarabel by {worst:e}");
}

#[test]
fn clarabel_finds_no_better_point_and_no_other_verdict() {
    for family in FAMILIES {
        against_clarabel::<10>(family, 30, 60);
    }
    against_clarabel::<20>(Family::Random, 40, 30);
    against_clarabel::<20>(Family::Ball, 60, 30);
}

/// Most iterations and worst error of the survey's first problems of a kind.
fn surveyed<const N: usize>(family: Family, rows: usize) -> (usize, f64) {
    let mut random = Random::new(survey_seed::<N>(family));
    let (mut most, mut worst) = (0, 0.0_f64);
    for _ in 0..2000 {
        let problem = problem::<N>(family, rows, &mut random);
        if let Ok(solution) = metric(&problem).nearest(&problem.target, &problem.rows, &WorkingSet::EMPTY) {
            assert!(problem.feasible, "{family:?}: a point for a contradiction");
            most = most.max(solution.iterations);
            worst = worst.max(optimality_error(&problem, &solution));
        }
    }
    (most, worst)
}

/// The README's table is of ten million problems; the first of the same ones stay within it.
#[test]
fn the_survey_in_the_readme_bounds_its_first_problems() {
    let readme = include_str!("../README.md");
    for family in FAMILIES {
        let row = format!("| {} |", format!("{family:?}").to_lowercase());
        let row = readme.lines().find(|line| line.starts_with(&row)).unwrap();
        let columns: Vec<&str> = row.split('|').map(str::trim).collect();
        let most: Vec<usize> = columns[3].split(", ").filter_map(|most| most.parse().ok()).collect();
        let worst = columns[4].split(' ').next().and_then(|worst| worst.parse().ok()).unwrap_or(0.0);
        let found = [surveyed::<4>(family, 36), surveyed::<7>(family, 20), surveyed::<10>(family, 30)];
        for (i, (iterations, error)) in found.into_iter().enumerate() {
            assert!(iterations <= most.get(i).copied().unwrap_or(0), "{row}: {iterations}");
            assert!(error <= worst, "{row}: {error:e}");
        }
    }
}
