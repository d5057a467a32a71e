//! Robots of a batch in single precision, or several side by side in one register, next to one after another in `f64`.
//!
//! `moca.SimBatch` steps its robots one after another in `f64`. Neither of the others doubles the speed of a batch:
//! - Only the law and the engine can be computed in lanes. The cover's bytes, supervision and records of a whole tick
//!   (`cargo bench -p moca-daemon --bench loop`) cannot.
//! - Robots that are pressed in different places take different branches of limits and guards. Lanes compute both sides.
//!
//! Raced here is what suits lanes best, because it has no branch: from joint angles and mass matrix to J_A·M_A⁻¹·J_Aᵀ. `--bench tick`
//! has whole steps of the law in `f32`.
//!
//! `RUSTFLAGS="-C target-cpu=x86-64-v3" cargo bench -p moca-wbc --bench lanes`: the flags give AVX2 to the crate `wide` as well.
#![allow(clippy::unwrap_used, clippy::print_stdout, reason = "a program")]

use moca_wbc::linalg::{Cholesky, weighted_outer};
use moca_wbc::nalgebra::{SMatrix, convert};
use moca_wbc::robot::PANDA;
use moca_wbc::{ArmModel, Mount, Payload, Scalar};
use std::array::from_fn;
use std::hint::black_box;
use std::ops::{Add, Div, Mul, Sub};
use std::time::Instant;
use wide::{f32x8, f64x4};

/// As many as the widest register holds.
const ROBOTS: usize = 8;
/// Turns of a race, and times that each side computes all robots in one.
const TURNS: usize = 2000;
const TIMES: usize = 8;

/// Joint angles, rad, and mass matrix, kg·m².
type Given<T> = ([T; 7], [[T; 7]; 7]);
type Answer<T> = [[T; 6]; 6];

/// J_A·M_A⁻¹·J_Aᵀ with the crate's own functions.
#[inline(never)]
fn one<T: Scalar>(model: &ArmModel<7, T>, (q, mass): &Given<T>) -> Answer<T> {
    let kinematics = model.kinematics(convert(0.0), q);
    let factor = Cholesky::new(&SMatrix::from(*mass)).unwrap();
    let reduced = SMatrix::from(factor.solve_lower_rows(&kinematics.arm_jacobian().data.0));
    weighted_outer(&reduced, factor.inverse_diagonal()).data.0
}

/// A number of each of several robots.
trait Lanes: Copy + Add<Output = Self> + Sub<Output = Self> + Mul<Output = Self> + Div<Output = Self> {
    const LANES: usize;
    /// Takes the first of them.
    fn of(robots: [f64; ROBOTS]) -> Self;
    fn sine_and_cosine(self) -> (Self, Self);
    fn robots(self) -> Vec<f64>;
}

impl Lanes for f64x4 {
    const LANES: usize = 4;

    #[inline]
    fn of([a, b, c, d, ..]: [f64; ROBOTS]) -> Self {
        Self::new([a, b, c, d])
    }

    #[inline]
    fn sine_and_cosine(self) -> (Self, Self) {
        self.sin_cos()
    }

    fn robots(self) -> Vec<f64> {
        self.to_array().into()
    }
}

impl Lanes for f32x8 {
    const LANES: usize = 8;

    #[inline]
    #[expect(clippy::cast_possible_truncation, reason = "to the nearest single")]
    fn of(robots: [f64; ROBOTS]) -> Self {
        Self::new(robots.map(|value| value as f32))
    }

    #[inline]
    fn sine_and_cosine(self) -> (Self, Self) {
        self.sin_cos()
    }

    fn robots(self) -> Vec<f64> {
        self.to_array().map(f64::from).into()
    }
}

/// As [`one`] for all lanes: the Panda's joints stand on each other with a turn about x, `twists`. Only the lower half is filled.
#[inline(never)]
#[expect(clippy::needless_range_loop, reason = "iterators are not unrolled here, and half as fast")]
fn side_by_side<T: Lanes>(twists: &[[T; 2]; 7], (q, mass): &Given<T>) -> Answer<T> {
    let all = |value| T::of([value; ROBOTS]);
    let (nought, unit) = (all(0.0), all(1.0));
    let moved = |from: [T; 3], axes: &[[T; 3]; 3], by: [f64; 3]| -> [T; 3] {
        from_fn(|k| from[k] + axes[0][k] * all(by[0]) + axes[1][k] * all(by[1]) + axes[2][k] * all(by[2]))
    };
    let mut axes = [[unit, nought, nought], [nought, unit, nought], [nought, nought, unit]];
    let (mut point, mut joints) = ([nought; 3], [([nought; 3], [nought; 3]); 7]);
    for (i, [dx, dy, dz, ..]) in PANDA.joint_origin.into_iter().enumerate() {
        point = moved(point, &axes, [dx, dy, dz]);
        let ([s, c], (sin, cos), [x, y, z]) = (twists[i], q[i].sine_and_cosine(), axes);
        let across: [T; 3] = from_fn(|k| y[k] * c + z[k] * s);
        let along = from_fn(|k| z[k] * c - y[k] * s);
        axes = [from_fn(|k| x[k] * cos + across[k] * sin), from_fn(|k| across[k] * cos - x[k] * sin), along];
        joints[i] = (along, point);
    }
    let [dx, dy, dz, ..] = PANDA.flange_origin;
    let flange = moved(point, &axes, [dx, dy, dz]);
    // rows of L⁻¹·J_Aᵀ with M_A = L·D·Lᵀ
    let mut rows = joints.map(|([ax, ay, az], joint)| {
        let [x, y, z]: [T; 3] = from_fn(|k| flange[k] - joint[k]);
        [ay * z - az * y, az * x - ax * z, ax * y - ay * x, ax, ay, az]
    });
    let (mut columns, mut sum) = (*mass, [[nought; 6]; 6]);
    for k in 0..7 {
        let inverse = unit / columns[k][k];
        for j in k + 1..7 {
            let factor = columns[k][j] * inverse;
            for i in j..7 {
                columns[j][i] = columns[j][i] - factor * columns[k][i];
            }
            rows[j] = from_fn(|i| rows[j][i] - factor * rows[k][i]);
        }
        for j in 0..6 {
            let scaled = rows[k][j] * inverse;
            for i in j..6 {
                sum[j][i] = sum[j][i] + scaled * rows[k][i];
            }
        }
    }
    sum
}

/// Prints how many times as fast the second one is, in turns, and its largest error to the first one's largest number.
fn race(
    name: &str,
    errors: impl Iterator<Item = (f64, f64)>,
    mut first: impl FnMut(),
    mut second: impl FnMut(),
) {
    let seconds = |all_robots: &mut dyn FnMut()| {
        let start = Instant::now();
        (0..TIMES).for_each(|_| all_robots());
        start.elapsed().as_secs_f64()
    };
    let mut ratios: Vec<f64> = (0..TURNS).map(|_| seconds(&mut first) / seconds(&mut second)).collect();
    ratios.sort_by(f64::total_cmp);
    let [low, median, high] = [1, 2, 3].map(|quarter| ratios[quarter * TURNS / 4]);
    let (error, most) = errors
        .fold((0.0_f64, 0.0_f64), |(error, most), (a, b)| (error.max((a - b).abs()), most.max(a.abs())));
    println!("{name}: {median:.2} times as fast ({low:.2} to {high:.2}), error {:.0e}", error / most);
}

/// Lower half of a symmetric matrix.
fn lower<T: Copy>(a: &Answer<T>) -> impl Iterator<Item = T> + use<'_, T> {
    a.iter().enumerate().flat_map(|(j, column)| column[j..].iter().copied())
}

fn lanes<T: Lanes>(name: &str, model: &ArmModel<7, f64>, given: &[Given<f64>; ROBOTS]) {
    let packed: Vec<Given<T>> = (0..ROBOTS / T::LANES)
        .map(|pack| {
            let robot = |lane: usize| &given[(pack * T::LANES + lane) % ROBOTS];
            let q = from_fn(|i| T::of(from_fn(|lane| robot(lane).0[i])));
            (q, from_fn(|j| from_fn(|i| T::of(from_fn(|lane| robot(lane).1[j][i])))))
        })
        .collect();
    let twists = PANDA
        .joint_origin
        .map(|[.., roll, _, _]| [roll.sin(), roll.cos()].map(|value| T::of([value; ROBOTS])));
    let answers: Vec<Vec<Vec<f64>>> =
        packed.iter().map(|given| lower(&side_by_side(&twists, given)).map(T::robots).collect()).collect();
    let errors = given.iter().enumerate().flat_map(|(robot, given)| {
        let theirs = answers[robot / T::LANES].iter().map(move |value| value[robot % T::LANES]);
        lower(&one(model, given)).zip(theirs).collect::<Vec<_>>()
    });
    race(
        name,
        errors,
        || given.iter().for_each(|given| _ = black_box(one(model, black_box(given)))),
        || packed.iter().for_each(|given| _ = black_box(side_by_side(&twists, black_box(given)))),
    );
}

fn main() {
    let mount = Mount { position_base_m: [0.0; 3], rpy_rad: [0.0; 3] };
    let model = ArmModel::<7, f64>::new(&PANDA, &mount, &Payload::NONE).unwrap();
    let mut phase = 0.0_f64;
    let given = [(); ROBOTS].map(|()| {
        let q = PANDA.home_rad.map(|home| {
            phase += 1.3;
            home + 0.05 * phase.sin()
        });
        (q, model.dynamics(0.0, &q, &[0.0; 7]).mass.data.0)
    });
    let single_model = ArmModel::<7, f32>::new(&PANDA, &mount, &Payload::NONE).unwrap();
    let single = given.map(|(q, mass)| (q.map(convert), mass.map(|column| column.map(convert))));
    let errors = given.iter().zip(&single).flat_map(|(given, single)| {
        let theirs = one::<f32>(&single_model, single);
        lower(&one(&model, given)).zip(lower(&theirs).map(f64::from)).collect::<Vec<_>>()
    });
    race(
        "f32",
        errors,
        || given.iter().for_each(|given| _ = black_box(one(&model, black_box(given)))),
        || single.iter().for_each(|given| _ = black_box(one::<f32>(&single_model, black_box(given)))),
    );
    lanes::<f64x4>("f64x4", &model, &given);
    lanes::<f32x8>("f32x8", &model, &given);
}
