//! Properties of every problem, and the error of every bad input.
#![allow(clippy::unwrap_used, clippy::float_cmp, clippy::cast_possible_truncation, reason = "tests")]
#![allow(clippy::cast_precision_loss, clippy::cast_sign_loss, reason = "tests")]

mod common;

use common::{FAMILIES, Family, Random, dot, metric, optimality_error, problem};
use moca_qp::{Metric, QpError, Row, WorkingSet};
use proptest::prelude::*;

const COLD: WorkingSet<3> = WorkingSet::EMPTY;

fn plain() -> Metric<3> {
    Metric::diagonal(&[1.0; 3]).unwrap()
}

/// The short form of `cargo bench -p moca-qp --bench survey`.
#[test]
fn every_family_ends_optimal_and_within_its_iterations() {
    for family in FAMILIES {
        let mut random = Random::new(9);
        let (mut most, mut worst) = (0, 0.0_f64);
        for _ in 0..2000 {
            let problem = problem::<4>(family, 36, &mut random);
            match metric(&problem).nearest(&problem.target, &problem.rows, &WorkingSet::EMPTY) {
                Ok(solution) if problem.feasible => {
                    most = most.max(solution.iterations);
                    worst = worst.max(optimality_error(&problem, &solution));
                }
                Err(QpError::Infeasible { .. }) if !problem.feasible => {}
                verdict => panic!("{family:?}: {verdict:?}"),
            }
        }
        println!("{family:?}: most iterations {most}, worst optimality error {worst:.1e}");
        assert!(worst < 1e-8, "{family:?}: {worst:e}");
        // what goes round on rounding ends at half the limit, which is 80
        assert!(most <= 40, "{family:?}: {most}");
    }
}

#[test]
fn a_target_that_keeps_the_rows_comes_back_bit_for_bit() {
    let target = [0.1 + 0.2, -1.0 / 3.0, 1e-17];
    let rows = [Row::at_least([1.0, 2.0, 3.0], -5.0), Row::bound(1, -1.0, 1.0)];
    let solution = plain().nearest(&target, &rows, &COLD).unwrap();
    assert_eq!((solution.x, solution.iterations), (target, 0));
    assert!(solution.active().is_empty());
    assert_eq!(plain().nearest(&target, &[], &COLD).unwrap().x, target);
}

#[test]
fn one_slack_is_the_largest_excess_and_own_slacks_are_each_rows() {
    // x ≥ 1 and x ≥ 3 with x ≤ 0: no x keeps either
    let bounds = Row::bound(0, -1.0, 0.0);
    let metric: Metric<3> = Metric::diagonal(&[1.0, 1e4, 1e4]).unwrap();
    let solve = |slacks: [usize; 2]| {
        let row = |bound, slack| Row::at_least([1.0, 0.0, 0.0], bound).softened(slack);
        metric.nearest(&[0.0; 3], &[row(1.0, slacks[0]), row(3.0, slacks[1]), bounds], &COLD).unwrap().x
    };
    let [x, common, unused] = solve([1, 1]);
    assert!(x.abs() < 1e-12 && (common - 3.0).abs() < 1e-12 && unused == 0.0);
    let [x, first, second] = solve([1, 2]);
    assert!(x.abs() < 1e-12 && (first - 1.0).abs() < 1e-12 && (second - 3.0).abs() < 1e-12);
    // from above it is taken away
    let above = [Row::at_most([1.0, 0.0, 0.0], -2.0).softened(1), Row::bound(0, 0.0, 1.0)];
    let [x, slack, _] = metric.nearest(&[0.5, 0.0, 0.0], &above, &COLD).unwrap().x;
    assert!(x.abs() < 1e-12 && (slack - 2.0).abs() < 1e-12);
}

#[test]
fn rows_that_exclude_each_other_are_named() {
    let rows = [Row::at_least([1.0, 0.0, 0.0], 1.0), Row::at_most([2.0, 0.0, 0.0], 1.0)];
    assert!(matches!(plain().nearest(&[0.0; 3], &rows, &COLD), Err(QpError::Infeasible { .. })));
    let crossed = [Row::bound(0, 1.0, 0.5)];
    assert_eq!(plain().nearest(&[0.0; 3], &crossed, &COLD), Err(QpError::Infeasible { row: 0 }));
    let nothing = [Row::at_least([0.0; 3], -1.0), Row::at_least([0.0; 3], 1.0)];
    assert_eq!(plain().nearest(&[0.0; 3], &nothing, &COLD), Err(QpError::Infeasible { row: 1 }));
    let error = QpError::Infeasible { row: 1 };
    assert_eq!(error.to_string(), "row 1 cannot be kept together with the other rows");
}

#[test]
fn what_is_no_number_is_an_error_wherever_it_stands() {
    let fine = Row::at_least([1.0, 0.0, 0.0], 1.0);
    for bad in [f64::NAN, f64::INFINITY, f64::NEG_INFINITY] {
        let not_finite = |what, index| Err(QpError::NotFinite { what, index });
        assert_eq!(plain().nearest(&[0.0, bad, 0.0], &[fine], &COLD), not_finite("target", 1));
        let normal = Row::at_least([0.0, bad, 0.0], 1.0);
        assert_eq!(plain().nearest(&[0.0; 3], &[fine, normal], &COLD), not_finite("row", 1));
        let mut hessian = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];
        hessian[2][1] = bad;
        assert_eq!(Metric::new(&hessian).unwrap_err(), QpError::NotFinite { what: "metric", index: 2 });
        assert!(Metric::diagonal(&[1.0, bad, 1.0]).is_err());
    }
    for row in [
        Row::at_least([1.0, 0.0, 0.0], f64::NAN),
        Row::at_most([1.0, 0.0, 0.0], f64::NAN),
        Row::at_least([1.0, 0.0, 0.0], f64::INFINITY),
        Row::at_most([1.0, 0.0, 0.0], f64::NEG_INFINITY),
        Row { normal: [1.0, 0.0, 0.0], lower: f64::INFINITY, upper: f64::NEG_INFINITY },
        Row { normal: [1.0, f64::NAN, 0.0], lower: 1.0, upper: 0.0 },
        // as processors make it of 0/0
        Row::at_least([1.0, -f64::NAN, 0.0], 0.0),
    ] {
        // alone, and among as many as are looked at side by side
        for (rows, index) in [(vec![row], 0), (vec![fine, fine, row, fine, fine], 2)] {
            let found = plain().nearest(&[0.0; 3], &rows, &COLD);
            assert_eq!(found, Err(QpError::NotFinite { what: "row", index }), "{row:?}");
        }
    }
    for (normal, bound) in [(1e-200, 1e200), (0.0, 1.0), (0.0, 1e300)] {
        for rows in [1, 4] {
            let huge = vec![Row::at_least([normal, 0.0, 0.0], bound); rows];
            assert!(plain().nearest(&[0.0; 3], &huge, &COLD).is_err());
        }
    }
}

#[test]
fn a_cost_without_a_least_is_refused() {
    assert_eq!(Metric::diagonal(&[1.0, 0.0]), Err(QpError::NotPositiveDefinite { pivot: 1 }));
    let flat = [[1.0, 1.0], [1.0, 1.0]];
    assert_eq!(Metric::new(&flat), Err(QpError::NotPositiveDefinite { pivot: 1 }));
    assert_eq!(Metric::new(&[[-1.0]]), Err(QpError::NotPositiveDefinite { pivot: 0 }));
}

#[test]
fn the_minimum_of_a_gradient_is_where_the_slope_vanishes() {
    let mut random = Random::new(4);
    let problem = problem::<5>(Family::Random, 3, &mut random);
    let gradient = random.vector::<5>(2.0);
    let x = metric(&problem).minimum(&gradient);
    for (row, gradient) in problem.hessian.iter().zip(gradient) {
        assert!((dot(row, &x) + gradient).abs() < 1e-12);
    }
}

/// The first row is the one that the point is farthest from, in any unit: exact for powers of 4.
#[test]
fn the_unit_of_a_row_changes_nothing() {
    let mut random = Random::new(12);
    for family in [Family::Contact, Family::Random, Family::Ball] {
        for _ in 0..200 {
            let mut problem = problem::<4>(family, 36, &mut random);
            let metric = metric(&problem);
            let plain = metric.nearest(&problem.target, &problem.rows, &WorkingSet::EMPTY).unwrap();
            for row in &mut problem.rows {
                let unit = [0.0625, 0.25, 1.0, 4.0, 1024.0][random.below(5)];
                let [lower, upper] = [row.lower, row.upper].map(|bound| bound * unit);
                *row = Row { normal: row.normal.map(|a| a * unit), lower, upper };
            }
            let scaled = metric.nearest(&problem.target, &problem.rows, &WorkingSet::EMPTY).unwrap();
            assert_eq!((scaled.x, scaled.iterations), (plain.x, plain.iterations), "{family:?}");
        }
    }
}

#[test]
fn hundreds_of_rows_are_solved_like_a_few() {
    let mut random = Random::new(13);
    for family in [Family::Random, Family::Ball, Family::Scaled] {
        let mut iterations = [0, 0];
        for _ in 0..200 {
            let mut problem = problem::<4>(family, 300, &mut random);
            let metric = metric(&problem);
            let found = metric.nearest(&problem.target, &problem.rows, &WorkingSet::EMPTY).unwrap();
            assert!(optimality_error(&problem, &found) < 1e-9);
            let warm = metric.nearest(&problem.target, &problem.rows, &found.working_set()).unwrap();
            assert!(warm.iterations <= 2 && optimality_error(&problem, &warm) < 1e-9);
            // the active ones at the other end
            problem.rows.reverse();
            let turned = metric.nearest(&problem.target, &problem.rows, &WorkingSet::EMPTY).unwrap();
            assert!(optimality_error(&problem, &turned) < 1e-9);
            iterations = [iterations[0] + found.iterations, iterations[1] + turned.iterations];
        }
        assert!(iterations[0].abs_diff(iterations[1]) * 20 < iterations[0], "{family:?}: {iterations:?}");
        assert!(iterations[0] < 200 * 20, "{family:?}: {iterations:?}");
    }
}

/// Their squares are not: 1e200² is infinite, and (1e-200)² is 0.
#[test]
fn finite_coefficients_of_any_size_are_accepted() {
    for size in [1e200, 1e-200] {
        let kept = [Row::at_least([size, 0.0, 0.0], -size), Row::at_most([0.0, size, size], size)];
        for rows in [kept.to_vec(), [kept, kept].concat()] {
            assert_eq!(plain().nearest(&[0.5, 0.25, 0.25], &rows, &COLD).unwrap().x, [0.5, 0.25, 0.25]);
        }
    }
}

#[test]
fn a_working_set_of_another_problem_does_no_harm() {
    let mut random = Random::new(11);
    for _ in 0..2000 {
        let (a, b) =
            (problem::<4>(Family::Random, 20, &mut random), problem::<4>(Family::Degenerate, 9, &mut random));
        let from = metric(&a).nearest(&a.target, &a.rows, &WorkingSet::EMPTY).unwrap().working_set();
        let warm = metric(&b).nearest(&b.target, &b.rows, &from).unwrap();
        assert!(optimality_error(&b, &warm) < 1e-9);
    }
}

proptest! {
    #[test]
    fn order_and_start_change_the_time_only(seed in any::<u64>(), kind in 0..FAMILIES.len(), turn in 0..12_usize) {
        let mut random = Random::new(seed);
        let mut problem = problem::<5>(FAMILIES[kind], 12, &mut random);
        let metric = metric(&problem);
        let cold = metric.nearest(&problem.target, &problem.rows, &WorkingSet::EMPTY);
        prop_assert_eq!(cold.is_ok(), problem.feasible);
        let Ok(cold) = cold else { return Ok(()) };
        let warm = metric.nearest(&problem.target, &problem.rows, &cold.working_set()).unwrap();
        prop_assert!(warm.iterations <= 2, "{}", warm.iterations);
        let turn = turn % problem.rows.len();
        problem.rows.rotate_left(turn);
        let turned = metric.nearest(&problem.target, &problem.rows, &WorkingSet::EMPTY).unwrap();
        let size = cold.x.iter().fold(1.0_f64, |size, x| size.max(x.abs()));
        for i in 0..5 {
            prop_assert!((warm.x[i] - cold.x[i]).abs() < 1e-7 * size, "{:?} {:?}", warm.x, cold.x);
            prop_assert!((turned.x[i] - cold.x[i]).abs() < 1e-7 * size, "{:?} {:?}", turned.x, cold.x);
        }
    }

    #[test]
    fn single_precision_agrees_to_its_digits(seed in any::<u64>()) {
        let mut random = Random::new(seed);
        let problem = problem::<4>(Family::Contact, 14, &mut random);
        let exact = metric(&problem).nearest(&problem.target, &problem.rows, &WorkingSet::EMPTY).unwrap();
        let weights: [f32; 4] = core::array::from_fn(|i| problem.hessian[i][i] as f32);
        let rows: Vec<Row<4, f32>> = problem.rows.iter().map(|row| Row {
            normal: row.normal.map(|a| a as f32), lower: row.lower as f32, upper: row.upper as f32,
        }).collect();
        let short = Metric::diagonal(&weights).unwrap()
            .nearest(&problem.target.map(|x| x as f32), &rows, &WorkingSet::EMPTY).unwrap();
        for i in 0..4 {
            prop_assert!((f64::from(short.x[i]) - exact.x[i]).abs() < 2e-4, "{:?} {:?}", short.x, exact.x);
        }
    }
}

/// The rounding of a difference excluded 0, and the whole problem was called infeasible.
#[test]
fn row_of_zeros_is_kept_where_its_bound_is_rounding() {
    let wall = Row::at_most([1.0, 0.0, 0.0], 0.5);
    let zeros = |lower: f64, upper: f64| Row { normal: [0.0; 3], lower, upper };
    let alone = plain().nearest(&[1.0, 0.0, 2.0], &[wall], &COLD).unwrap().x;
    // in a block, next to the blocks, and behind those whose weights are kept
    for before in [0, 3, 5, 63, 66, 90] {
        let solve = |row| {
            let mut rows = vec![wall; before];
            rows.extend([row, wall]);
            plain().nearest(&[1.0, 0.0, 2.0], &rows, &COLD)
        };
        let none = f64::INFINITY;
        for (lower, upper) in [(-none, -7e-18), (7e-18, none), (-2e-14, -1e-14), (-1.0, 1.0), (0.0, 0.0)] {
            let solution = solve(zeros(lower, upper)).unwrap();
            assert_eq!(solution.x, alone, "{before} {lower} {upper}: it says nothing of x");
        }
        for (lower, upper) in [(-none, -1e-12), (1e-12, none), (1.0, 2.0)] {
            let verdict = solve(zeros(lower, upper));
            assert_eq!(
                verdict.map(|found| found.x),
                Err(QpError::Infeasible { row: before }),
                "{lower} {upper}"
            );
        }
    }
    // the largest number of the problem is what rounding is measured by
    let far = |target: f64| plain().nearest(&[target, 0.0, 0.0], &[zeros(1e-12, f64::INFINITY)], &COLD);
    assert!(far(1.0).is_err() && far(1e3).is_ok());
    let single = Metric::<2, f32>::diagonal(&[1.0; 2]).unwrap();
    let row = |bound: f32| [Row::at_most([0.0, 0.0], bound)];
    let solve = |bound| single.nearest(&[1.0, 0.0], &row(bound), &WorkingSet::EMPTY);
    assert!(solve(-1e-7).is_ok() && solve(-1e-4).is_err());
}
