//! Times of this crate beside other solvers on the same problems, in one process, problem by problem in turn:
//! `cargo bench -p moca-qp --bench compare -- LIBRARY`. `compare/compare.py` builds the library of the others and runs this.
//!
//! Cold is everything from Hessian, gradient and rows on, factors included. Warm is the same problem with another gradient:
//! each keeps what it can keep. Of the others the time over ours is printed, the median over the problems (10 to 90 % of them).
//! One judge for all: how far the point is from the conditions that the nearest one meets.
#![allow(clippy::unwrap_used, clippy::print_stdout, reason = "a program")]
#![allow(unsafe_code, reason = "the other solvers are a library in C")]
#![allow(clippy::missing_transmute_annotations, reason = "the field that is filled states the type")]

#[path = "../tests/common/mod.rs"]
mod common;
#[path = "compare/judge.rs"]
mod judge;

use common::{Family, Problem, Random, dot, metric, problem};
use moca_qp::{Metric, WorkingSet};
use std::ffi::{CString, c_char, c_int, c_void};
use std::hint::black_box;
use std::time::Instant;

/// Timed solves of each problem, of which the least counts.
const REPETITIONS: usize = 7;
const OTHERS: [&str; 3] = ["qpmad", "eiquadprog", "DAQP"];
const RTLD_NOW: c_int = 2;

unsafe extern "C" {
    fn dlopen(path: *const c_char, flags: c_int) -> *mut c_void;
    fn dlsym(library: *mut c_void, name: *const c_char) -> *mut c_void;
}

/// Functions of `compare/peers.cpp`.
#[derive(Clone, Copy)]
struct Others {
    new: unsafe extern "C" fn(c_int, c_int, *const f64, *const f64) -> *mut c_void,
    gradient: unsafe extern "C" fn(*mut c_void, *const f64),
    solve: unsafe extern "C" fn(*mut c_void, c_int, c_int, *mut f64) -> f64,
    keep: unsafe extern "C" fn(*mut c_void),
    free: unsafe extern "C" fn(*mut c_void),
}

impl Others {
    fn load(path: &str) -> Self {
        let path = CString::new(path).unwrap();
        // SAFETY: the library is the one that compare.py builds from compare/peers.cpp; names and types are those there.
        unsafe {
            let library = dlopen(path.as_ptr(), RTLD_NOW);
            assert!(!library.is_null(), "{path:?} is no library");
            let function = |name: &std::ffi::CStr| {
                let address = dlsym(library, name.as_ptr());
                assert!(!address.is_null(), "{path:?} has no {name:?}");
                address
            };
            Self {
                new: std::mem::transmute::<*mut c_void, _>(function(c"peer_new")),
                gradient: std::mem::transmute::<*mut c_void, _>(function(c"peer_gradient")),
                solve: std::mem::transmute::<*mut c_void, _>(function(c"peer_solve")),
                keep: std::mem::transmute::<*mut c_void, _>(function(c"peer_keep")),
                free: std::mem::transmute::<*mut c_void, _>(function(c"peer_free")),
            }
        }
    }
}

/// Times and errors of one solver on one set.
#[derive(Default)]
struct Figures {
    cold_ns: Vec<f64>,
    warm_ns: Vec<f64>,
    errors: Vec<f64>,
    /// Their times over ours.
    cold: Vec<f64>,
    warm: Vec<f64>,
    /// Problems that it did not solve.
    refused: usize,
}

/// Ours and the others on one problem and on its neighbour, in turn.
fn compare<const N: usize>(
    made: &Problem<N>,
    other: &[f64; N],
    others: Option<Others>,
    figures: &mut [Figures],
) {
    let gradient = |target: &[f64; N]| made.hessian.map(|row| -dot(&row, target));
    let (first, second) = (gradient(&made.target), gradient(other));
    let kept = metric(made);
    let from = kept.nearest(&made.target, &made.rows, &WorkingSet::EMPTY).unwrap().working_set();
    let mut ours = [[0.0; N]; 2];
    let cold = |x: &mut [f64; N]| {
        let began = Instant::now();
        let metric = Metric::new(black_box(&made.hessian)).unwrap();
        let solution = metric.nearest(&metric.minimum(black_box(&first)), &made.rows, &WorkingSet::EMPTY);
        let ns = began.elapsed().as_secs_f64() * 1e9;
        *x = black_box(solution).unwrap().x;
        ns
    };
    let warm = |x: &mut [f64; N]| {
        let began = Instant::now();
        let solution = kept.nearest(&kept.minimum(black_box(&second)), &made.rows, &from);
        let ns = began.elapsed().as_secs_f64() * 1e9;
        *x = black_box(solution).unwrap().x;
        ns
    };
    let rows: Vec<f64> =
        made.rows.iter().flat_map(|row| row.normal.into_iter().chain([row.lower, row.upper])).collect();
    let hessian: Vec<f64> = made.hessian.iter().flatten().copied().collect();
    let size = |value: usize| c_int::try_from(value).unwrap();
    let mut least = [[f64::INFINITY; 2]; 1 + OTHERS.len()];
    let mut theirs = [[[0.0; N]; 2]; OTHERS.len()];
    // SAFETY: sizes are those of the arrays; the problem is freed once, at the end.
    let peer = others
        .map(|o| (o, unsafe { (o.new)(size(N), size(made.rows.len()), hessian.as_ptr(), rows.as_ptr()) }));
    for (way, target) in [&first, &second].into_iter().enumerate() {
        if let Some((o, p)) = peer {
            // SAFETY: as above.
            unsafe {
                if way == 1 {
                    (o.keep)(p);
                }
                (o.gradient)(p, target.as_ptr());
            }
        }
        for _ in 0..REPETITIONS {
            let ns = if way == 0 { cold(&mut ours[0]) } else { warm(&mut ours[1]) };
            least[0][way] = least[0][way].min(ns);
            for (which, x) in theirs.iter_mut().enumerate() {
                let Some((o, p)) = peer else { continue };
                // SAFETY: as above; x has N numbers.
                let ns = unsafe { (o.solve)(p, size(which), size(way), x[way].as_mut_ptr()) };
                least[1 + which][way] = least[1 + which][way].min(ns);
            }
        }
    }
    if let Some((o, p)) = peer {
        // SAFETY: as above.
        unsafe { (o.free)(p) };
    }
    let error = |x: &[[f64; N]; 2]| judge::error(made, &first, &x[0]).max(judge::error(made, &second, &x[1]));
    for (i, figures) in figures.iter_mut().enumerate() {
        if !least[i].iter().all(|ns| ns.is_finite()) {
            figures.refused += 1;
            continue;
        }
        figures.cold_ns.push(least[i][0]);
        figures.warm_ns.push(least[i][1]);
        figures.cold.push(least[i][0] / least[0][0]);
        figures.warm.push(least[i][1] / least[0][1]);
        figures.errors.push(error(if i == 0 { &ours } else { &theirs[i - 1] }));
    }
}

fn quantile(values: &[f64], share: usize) -> f64 {
    let mut sorted = values.to_vec();
    sorted.sort_by(f64::total_cmp);
    sorted[(sorted.len() - 1) * share / 100]
}

fn set<const N: usize>(name: &str, family: Family, rows: usize, problems: usize, others: Option<Others>) {
    let mut random = Random::new(3);
    let count = 1 + if others.is_some() { OTHERS.len() } else { 0 };
    let mut figures: Vec<Figures> = (0..count).map(|_| Figures::default()).collect();
    for _ in 0..problems {
        let made = problem::<N>(family, rows, &mut random);
        let other = made.target.map(|value| value * (1.0 + random.within(0.02)));
        compare(&made, &other, others, &mut figures);
    }
    let [ours, theirs @ ..] = &figures[..] else { return };
    let spread = |ratios: &[f64]| -> String {
        let [low, middle, high] = [10, 50, 90].map(|share| quantile(ratios, share));
        format!("{middle:.2} ({low:.2} to {high:.2})")
    };
    let cells =
        |cell: &dyn Fn(&Figures) -> String| theirs.iter().map(|f| cell(f) + " | ").collect::<String>();
    for (way, ours, ratios) in [
        ("cold", &ours.cold_ns, cells(&|f| spread(&f.cold))),
        ("warm", &ours.warm_ns, cells(&|f| spread(&f.warm))),
    ] {
        println!(
            "| {name} {way} | {:.2}, {:.2} | {ratios}",
            quantile(ours, 50) / 1e3,
            quantile(ours, 99) / 1e3
        );
    }
    let error = |f: &Figures| match f.refused {
        0 => format!("{:.0e}", quantile(&f.errors, 99)),
        refused => format!("{:.0e}, {refused} refused", quantile(&f.errors, 99)),
    };
    println!("| {name} error | {} | {}", error(ours), cells(&error));
}

fn main() {
    let library = std::env::args().skip(1).find(|argument| argument != "--bench");
    let others = library.as_deref().map(Others::load);
    if others.is_none() {
        println!("the others are missing: crates/qp/compare/compare.py builds them and runs this");
    }
    println!("| problems | moca-qp: µs, median and 99 % | qpmad | eiquadprog | DAQP |");
    println!("|---|---|---|---|---|");
    set::<4>("contact 4 × 36", Family::Contact, 36, 1000, others);
    set::<4>("random 4 × 36", Family::Random, 36, 1000, others);
    set::<10>("random 10 × 30", Family::Random, 30, 600, others);
    set::<10>("random 10 × 100", Family::Random, 100, 400, others);
    set::<20>("random 20 × 60", Family::Random, 60, 300, others);
    set::<20>("random 20 × 100", Family::Random, 100, 300, others);
    set::<10>("random 10 × 200", Family::Random, 200, 300, others);
    set::<40>("random 40 × 120", Family::Random, 120, 100, others);
}
