//! Problems by family, and the optimality conditions as a judge that knows nothing of the solver.
#![allow(dead_code, missing_docs, unreachable_pub, clippy::unwrap_used, reason = "each user needs a part")]
#![allow(
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    clippy::cast_precision_loss,
    reason = "small counts"
)]

use moca_qp::{Metric, Row, Side, Solution};

/// Repeatable numbers.
pub struct Random(u64);

impl Random {
    pub fn new(seed: u64) -> Self {
        Self(seed.wrapping_mul(0x9E37_79B9_7F4A_7C15) | 1)
    }

    /// 0 to 1.
    pub fn unit(&mut self) -> f64 {
        self.0 ^= self.0 << 13;
        self.0 ^= self.0 >> 7;
        self.0 ^= self.0 << 17;
        (self.0 >> 11) as f64 / (1u64 << 53) as f64
    }

    /// −a to a.
    pub fn within(&mut self, a: f64) -> f64 {
        a * (2.0 * self.unit() - 1.0)
    }

    pub fn below(&mut self, n: usize) -> usize {
        (self.unit() * n as f64) as usize
    }

    pub fn vector<const N: usize>(&mut self, a: f64) -> [f64; N] {
        core::array::from_fn(|_| self.within(a))
    }

    pub fn direction<const N: usize>(&mut self) -> [f64; N] {
        loop {
            let v = self.vector::<N>(1.0);
            let length = dot(&v, &v).sqrt();
            if length > 0.1 {
                return v.map(|x| x / length);
            }
        }
    }
}

pub fn dot<const N: usize>(a: &[f64; N], b: &[f64; N]) -> f64 {
    a.iter().zip(b).map(|(a, b)| a * b).sum()
}

/// Kinds of problems.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Family {
    /// A base of three axes with bounds, and rows of a cover softened by one slack: the last variable.
    Contact,
    /// Any rows round a point that keeps them all.
    Random,
    /// Every row through one point, many of them twice, scaled or reversed.
    Degenerate,
    /// Pairs of rows that differ by 1e-3 to 1e-12, with a millimetre of room.
    Parallel,
    /// Rows that touch a ball, the target far outside: many are active in turn.
    Ball,
    /// Weights over eight decades, rows over six.
    Scaled,
    /// Rows with a positive combination that says 0 ≥ 1.
    Contradictory,
    /// Equalities among the rows, some of them said twice.
    Equal,
}

pub const FAMILIES: [Family; 8] = [
    Family::Contact,
    Family::Random,
    Family::Degenerate,
    Family::Parallel,
    Family::Ball,
    Family::Scaled,
    Family::Contradictory,
    Family::Equal,
];

pub struct Problem<const N: usize> {
    pub hessian: [[f64; N]; N],
    pub target: [f64; N],
    pub rows: Vec<Row<N>>,
    pub feasible: bool,
}

/// Seed of the survey's problems of a family and size.
pub fn survey_seed<const N: usize>(family: Family) -> u64 {
    1 + family as u64 * 1000 + N as u64
}

/// A problem of `family` with about `m` rows.
pub fn problem<const N: usize>(family: Family, m: usize, random: &mut Random) -> Problem<N> {
    let inside: [f64; N] = random.vector(1.0);
    let mut made = Problem {
        hessian: hessian(random),
        target: random.vector(3.0),
        rows: Vec::with_capacity(m + 2),
        feasible: family != Family::Contradictory,
    };
    match family {
        Family::Contact => contact(&mut made, m, random),
        Family::Random => made.rows.extend((0..m).map(|_| row_round(&inside, 1.0, random))),
        Family::Degenerate => {
            while made.rows.len() < m {
                let normal = random.vector::<N>(2.0).map(f64::round);
                let bound = dot(&normal, &inside);
                for _ in 0..=random.below(3) {
                    let scale = [1.0, 3.0, -2.0, 0.1][random.below(4)];
                    let scaled = normal.map(|a| a * scale);
                    made.rows.push(if scale > 0.0 {
                        Row::at_least(scaled, bound * scale)
                    } else {
                        Row::at_most(scaled, bound * scale)
                    });
                }
            }
        }
        Family::Parallel => {
            while made.rows.len() < m {
                let mut row = row_round(&inside, 1.0, random);
                (row.lower, row.upper) = (row.lower - 1e-3, row.upper + 1e-3);
                let by = 10.0_f64.powf(-3.0 - 9.0 * random.unit());
                let normal = core::array::from_fn(|i| row.normal[i] + random.within(by));
                let [lower, upper] =
                    [row.lower, row.upper].map(|b| b + dot(&normal, &inside) - dot(&row.normal, &inside));
                made.rows.extend([row, Row { normal, lower, upper }]);
            }
        }
        Family::Ball => {
            made.target = random.direction::<N>().map(|x| 100.0 * x);
            made.rows.extend((0..m).map(|_| Row::at_most(random.direction(), 1.0)));
        }
        Family::Scaled => {
            let weight: [f64; N] = core::array::from_fn(|_| 10.0_f64.powf(random.within(2.0)));
            for i in 0..N {
                for j in 0..N {
                    made.hessian[i][j] *= weight[i] * weight[j];
                }
            }
            made.rows.extend((0..m).map(|_| {
                let scale = 10.0_f64.powf(random.within(3.0));
                row_round(&inside, scale, random)
            }));
        }
        Family::Contradictory => {
            made.rows.extend((1..m).map(|_| row_round(&inside, 1.0, random)));
            let mut sum = Row::at_least([0.0; N], 0.5 + random.unit());
            for _ in 0..=random.below(2 * N) {
                let row = &made.rows[random.below(made.rows.len())];
                let share = 0.1 + random.unit();
                let (normal, bound) = if row.lower.is_finite() {
                    (row.normal, row.lower)
                } else {
                    (row.normal.map(|a| -a), -row.upper)
                };
                sum.normal = core::array::from_fn(|i| sum.normal[i] - share * normal[i]);
                sum.lower -= share * bound;
            }
            let place = random.below(made.rows.len());
            made.rows.insert(place, sum);
        }
        Family::Equal => {
            for _ in 0..random.below(N) {
                let normal = random.direction();
                let value = dot(&normal, &inside);
                made.rows.push(Row { normal, lower: value, upper: value });
                if random.unit() < 0.3 {
                    made.rows.push(Row {
                        normal: normal.map(|a| -2.0 * a),
                        lower: -2.0 * value,
                        upper: -2.0 * value,
                    });
                }
            }
            made.rows.extend((0..m / 2).map(|_| row_round(&inside, 1.0, random)));
        }
    }
    made
}

/// A row that `inside` keeps, by nothing or by up to 1.
fn row_round<const N: usize>(inside: &[f64; N], scale: f64, random: &mut Random) -> Row<N> {
    let normal = random.vector::<N>(1.0).map(|a| a * scale);
    let along = dot(&normal, inside);
    let mut room = || if random.unit() < 0.2 { 0.0 } else { scale * random.unit() };
    let (below, above) = (along - room(), along + room());
    match random.below(3) {
        0 => Row { normal, lower: below, upper: above },
        1 => Row::at_least(normal, below),
        _ => Row::at_most(normal, above),
    }
}

fn hessian<const N: usize>(random: &mut Random) -> [[f64; N]; N] {
    let a: [[f64; N]; N] = core::array::from_fn(|_| random.vector(1.0));
    core::array::from_fn(|i| core::array::from_fn(|j| dot(&a[i], &a[j]) + if i == j { 0.1 } else { 0.0 }))
}

fn contact<const N: usize>(made: &mut Problem<N>, m: usize, random: &mut Random) {
    let slack = N - 1;
    made.hessian = core::array::from_fn(|i| {
        core::array::from_fn(|j| if i == j { if i == slack { 1e4 } else { 1.0 } } else { 0.0 })
    });
    made.target[slack] = 0.0;
    for i in 0..slack {
        let middle = random.within(0.5);
        made.rows.push(Row::bound(i, middle - 0.003, middle + 0.003));
    }
    while made.rows.len() < m {
        let (sin, cos) = random.within(std::f64::consts::PI).sin_cos();
        let mut normal = [0.0; N];
        for (i, value) in [cos, sin, random.within(0.5)].into_iter().enumerate().take(slack) {
            normal[i] = value;
        }
        made.rows.push(Row::at_least(normal, random.within(0.3)).softened(slack));
    }
}

/// Largest relative error of the conditions that the nearest point, and no other, meets: the rows are kept, the cost
/// falls only along active ones, whose bounds the point is on, and which push.
pub fn optimality_error<const N: usize>(problem: &Problem<N>, solution: &Solution<N>) -> f64 {
    let x = &solution.x;
    let size = |row: &Row<N>, bound: f64| -> f64 {
        bound.abs() + row.normal.iter().zip(x).map(|(a, x)| (a * x).abs()).sum::<f64>() + f64::MIN_POSITIVE
    };
    let mut worst = 0.0_f64;
    for row in &problem.rows {
        let along = dot(&row.normal, x);
        for (outside, bound) in [(row.lower - along, row.lower), (along - row.upper, row.upper)] {
            if bound.is_finite() {
                worst = worst.max(outside / size(row, bound));
            }
        }
    }
    let off: [f64; N] = core::array::from_fn(|i| x[i] - problem.target[i]);
    let mut slope: [f64; N] = core::array::from_fn(|i| dot(&problem.hessian[i], &off));
    let mut terms: [f64; N] =
        core::array::from_fn(|i| (0..N).map(|j| (problem.hessian[i][j] * off[j]).abs()).sum());
    for active in solution.active() {
        let row = &problem.rows[active.row];
        let (sign, bound) = match active.side {
            Side::Lower => (1.0, row.lower),
            Side::Upper => (-1.0, row.upper),
        };
        worst = worst.max((dot(&row.normal, x) - bound).abs() / size(row, bound));
        if active.multiplier < 0.0 {
            let scale = row.normal.iter().map(|a| (a * active.multiplier).abs()).fold(0.0, f64::max);
            let slopes = terms.iter().copied().fold(f64::MIN_POSITIVE, f64::max);
            worst = worst.max(scale / slopes);
        }
        for i in 0..N {
            slope[i] -= sign * active.multiplier * row.normal[i];
            terms[i] += (active.multiplier * row.normal[i]).abs();
        }
    }
    let scale = terms.iter().copied().fold(f64::MIN_POSITIVE, f64::max);
    slope.iter().fold(worst, |worst, slope| worst.max(slope.abs() / scale))
}

pub fn metric<const N: usize>(problem: &Problem<N>) -> Metric<N> {
    Metric::new(&problem.hessian).unwrap()
}
