//! The judge of all solvers: it sees a point and nothing of how that was found.

use crate::common::{Problem, dot};
use moca_qp::Row;

/// Share of its terms within which a row counts as one that the point lies on.
const ON: f64 = 1e-7;
const SWEEPS: usize = 8;

/// Largest relative error of the conditions of the nearest point: rows are kept, and the slope Hx + f is a sum of inward normals
/// of rows that the point lies on, none of which pulls.
pub(crate) fn error<const N: usize>(problem: &Problem<N>, gradient: &[f64; N], x: &[f64; N]) -> f64 {
    let terms = |row: &Row<N>| -> f64 { row.normal.iter().zip(x).map(|(a, x)| (a * x).abs()).sum() };
    let (mut worst, mut normals) = (0.0_f64, Vec::new());
    for row in &problem.rows {
        let along = dot(&row.normal, x);
        for (inside, bound, sign) in
            [(along - row.lower, row.lower, 1.0), (row.upper - along, row.upper, -1.0)]
        {
            if !bound.is_finite() {
                continue;
            }
            let size = bound.abs() + terms(row) + f64::MIN_POSITIVE;
            worst = worst.max(-inside / size);
            if inside < ON * size {
                normals.push(row.normal.map(|a| sign * a));
            }
        }
    }
    let slope: [f64; N] = core::array::from_fn(|i| dot(&problem.hessian[i], x) + gradient[i]);
    let scale = (0..N).map(|i| {
        problem.hessian[i].iter().zip(x).map(|(h, x)| (h * x).abs()).sum::<f64>() + gradient[i].abs()
    });
    let scale = scale.fold(f64::MIN_POSITIVE, f64::max);
    let left = without_pushes(slope, &normals);
    left.iter().fold(worst, |worst, left| worst.max(left.abs() / scale))
}

/// Rest of `slope` beside the nearest sum of non-negative multiples of `normals` (Lawson, Hanson 1974, chapter 23).
fn without_pushes<const N: usize>(slope: [f64; N], normals: &[[f64; N]]) -> [f64; N] {
    let mut weights = vec![0.0; normals.len()];
    let mut used: Vec<usize> = Vec::new();
    let mut left = slope;
    for _ in 0..3 * normals.len() + 3 {
        let pull = |i: &usize| dot(&normals[*i], &left) / dot(&normals[*i], &normals[*i]).sqrt();
        let free = (0..normals.len()).filter(|i| !used.contains(i));
        let Some(next) = free.max_by(|a, b| pull(a).total_cmp(&pull(b))) else { break };
        if used.len() == N || pull(&next) <= 1e-13 * dot(&slope, &slope).sqrt() {
            break;
        }
        used.push(next);
        loop {
            let wanted = least_squares(&slope, normals, &used);
            if wanted.iter().all(|w| *w > 0.0) {
                used.iter().zip(&wanted).for_each(|(i, w)| weights[*i] = *w);
                break;
            }
            let share = used
                .iter()
                .zip(&wanted)
                .filter(|(_, w)| **w <= 0.0)
                .map(|(i, w)| weights[*i] / (weights[*i] - w));
            let share = share.fold(1.0, f64::min);
            used.iter().zip(&wanted).for_each(|(i, w)| weights[*i] += share * (w - weights[*i]));
            used.retain(|i| weights[*i] > 1e-300);
            if used.is_empty() {
                break;
            }
        }
        left = rest(&slope, normals, &used, &weights);
    }
    left
}

fn rest<const N: usize>(slope: &[f64; N], normals: &[[f64; N]], used: &[usize], weights: &[f64]) -> [f64; N] {
    core::array::from_fn(|k| slope[k] - used.iter().map(|i| weights[*i] * normals[*i][k]).sum::<f64>())
}

/// Weights of the used normals whose sum is nearest to `slope`, by Gram and Schmidt, refined on what is left.
fn least_squares<const N: usize>(slope: &[f64; N], normals: &[[f64; N]], used: &[usize]) -> Vec<f64> {
    let count = used.len();
    let (mut q, mut r) = (Vec::new(), vec![vec![0.0; count]; count]);
    for (j, i) in used.iter().enumerate() {
        let mut v = normals[*i];
        for _ in 0..2 {
            for (k, q) in q.iter().enumerate() {
                let along = dot(q, &v);
                r[k][j] += along;
                (0..N).for_each(|n| v[n] -= along * q[n]);
            }
        }
        r[j][j] = dot(&v, &v).sqrt().max(f64::MIN_POSITIVE);
        q.push(v.map(|value| value / r[j][j]));
    }
    let mut weights = vec![0.0; normals.len()];
    for _ in 0..SWEEPS {
        let left = rest(slope, normals, used, &weights);
        let mut more: Vec<f64> = q.iter().map(|q: &[f64; N]| dot(q, &left)).collect();
        for j in (0..count).rev() {
            for k in j + 1..count {
                more[j] -= r[j][k] * more[k];
            }
            more[j] /= r[j][j];
        }
        used.iter().zip(&more).for_each(|(i, more)| weights[*i] += more);
    }
    used.iter().map(|i| weights[*i]).collect()
}
