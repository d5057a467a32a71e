//! Least-squares fits of each kind of model, pooled over trials, loading and unloading.

use super::{Quality, Trial, TrialSample};
use crate::model::{
    CompensatedCurve, CurveError, MAX_KNOTS, MEMORY_TIME_S, MonotoneCurve, TaxelModel, relax,
};
use std::vec::Vec;

/// Knots of a fitted curve.
const KNOTS: usize = 10;
/// Smallest distance of two knots, counts: below it quantisation decides.
const KNOT_DISTANCE: f64 = 1.0;
/// Alternations between elastic curve and relaxing shares.
const COMPENSATION_ROUNDS: usize = 20;
/// Fewest samples of a fit.
pub const SAMPLES_MIN: usize = 50;
/// Smallest span of counts that a fit accepts.
pub const SPAN_MIN: f64 = 3.0;

/// The kinds of model a fit can give.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ModelKind {
    /// The paper's: F = a + b·s. For reporting; it reads `a` when untouched.
    LineWithIntercept,
    /// F = b·s.
    LineThroughZero,
    /// Monotone curve through zero.
    Monotone,
    /// Monotone curve with hysteresis and creep compensated.
    Compensated,
}

impl ModelKind {
    /// Every kind, cheapest first.
    pub const ALL: [Self; 4] =
        [Self::LineWithIntercept, Self::LineThroughZero, Self::Monotone, Self::Compensated];
}

/// Why trials cannot be fitted.
#[derive(Clone, Debug, PartialEq)]
pub enum FitError {
    /// Fewer than [`SAMPLES_MIN`] samples.
    TooFewSamples(usize),
    /// A number that is not finite, a negative force below −5 N, or time that does not rise.
    BadSample {
        /// From 0.
        trial: usize,
        /// From 0.
        sample: usize,
    },
    /// Counts span less than [`SPAN_MIN`]: nothing was pressed, or the wrong electrode was read.
    NoSpan {
        /// Largest counts below rest.
        counts: f64,
    },
    /// Counts do not rise with the force.
    NotRising,
    /// The fitted curve is none.
    Curve(CurveError),
}

impl core::fmt::Display for FitError {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        match self {
            Self::TooFewSamples(n) => write!(f, "{n} samples are too few to fit: at least {SAMPLES_MIN}"),
            Self::BadSample { trial, sample } => write!(
                f,
                "sample {sample} of trial {trial}: time must rise, counts and force (N, at least -5) be finite"
            ),
            Self::NoSpan { counts } => write!(
                f,
                "the press reached {counts:.1} counts below rest, at least {SPAN_MIN} are needed: was the right \
                 taxel pressed?"
            ),
            Self::NotRising => {
                write!(f, "counts do not rise with the reference force: check its sign and timing")
            }
            Self::Curve(error) => write!(f, "{error}"),
        }
    }
}

impl core::error::Error for FitError {}

/// Fits one kind of model to every sample of every trial and says how good it is.
pub fn fit(kind: ModelKind, trials: &[Trial]) -> Result<(TaxelModel, Quality), FitError> {
    check(trials)?;
    let model = match kind {
        ModelKind::LineWithIntercept => line(trials)?,
        ModelKind::LineThroughZero => line_through_zero(trials)?,
        ModelKind::Monotone => {
            let knots = knots(trials);
            let columns = knots_columns(trials, &knots);
            TaxelModel::Monotone(curve(&knots, &non_negative_least_squares(&columns, &forces(trials)))?)
        }
        ModelKind::Compensated => compensated(trials)?,
    };
    Ok((model, super::quality::quality(&model, trials)))
}

fn samples(trials: &[Trial]) -> impl Iterator<Item = &TrialSample> {
    trials.iter().flat_map(|trial| &trial.samples)
}

fn forces(trials: &[Trial]) -> Vec<f64> {
    samples(trials).map(|sample| sample.force_n).collect()
}

fn check(trials: &[Trial]) -> Result<(), FitError> {
    let count = samples(trials).count();
    if count < SAMPLES_MIN {
        return Err(FitError::TooFewSamples(count));
    }
    for (trial, Trial { samples }) in trials.iter().enumerate() {
        let mut last_s = f64::NEG_INFINITY;
        for (index, sample) in samples.iter().enumerate() {
            let finite = sample.drop.is_finite() && sample.force_n.is_finite() && sample.time_s.is_finite();
            if !finite || sample.force_n < -5.0 || sample.time_s <= last_s {
                return Err(FitError::BadSample { trial, sample: index });
            }
            last_s = sample.time_s;
        }
    }
    let counts = samples(trials).map(|sample| sample.drop).fold(0.0, f64::max);
    if counts < SPAN_MIN { Err(FitError::NoSpan { counts }) } else { Ok(()) }
}

#[expect(clippy::cast_precision_loss, reason = "sample counts are far below 2^53")]
fn line(trials: &[Trial]) -> Result<TaxelModel, FitError> {
    let count = samples(trials).count() as f64;
    let mean_drop = samples(trials).map(|s| s.drop).sum::<f64>() / count;
    let mean_force = samples(trials).map(|s| s.force_n).sum::<f64>() / count;
    let (mut square, mut product) = (0.0, 0.0);
    for sample in samples(trials) {
        square += (sample.drop - mean_drop) * (sample.drop - mean_drop);
        product += (sample.drop - mean_drop) * (sample.force_n - mean_force);
    }
    let newton_per_count = product / square;
    if newton_per_count.is_nan() || newton_per_count <= 0.0 {
        return Err(FitError::NotRising);
    }
    let intercept_n = mean_force - newton_per_count * mean_drop;
    Ok(TaxelModel::LineWithIntercept { newton_per_count, intercept_n })
}

fn line_through_zero(trials: &[Trial]) -> Result<TaxelModel, FitError> {
    let square: f64 = samples(trials).map(|s| s.drop * s.drop).sum();
    let product: f64 = samples(trials).map(|s| s.drop * s.force_n).sum();
    let newton_per_count = product / square;
    if newton_per_count.is_nan() || newton_per_count <= 0.0 {
        return Err(FitError::NotRising);
    }
    Ok(TaxelModel::LineThroughZero { newton_per_count })
}

/// Knots at equal shares of the pressed samples, so that each segment is supported by data.
fn knots(trials: &[Trial]) -> Vec<f64> {
    let mut drops: Vec<f64> = samples(trials).map(|s| s.drop).filter(|&drop| drop > 0.0).collect();
    drops.sort_by(f64::total_cmp);
    let mut knots: Vec<f64> = Vec::with_capacity(MAX_KNOTS);
    for i in 1..=KNOTS {
        let knot = drops[(i * drops.len() / KNOTS).saturating_sub(1)];
        if knot >= knots.last().copied().unwrap_or(0.0) + KNOT_DISTANCE {
            knots.push(knot);
        }
    }
    knots
}

/// Returns the progress of `drop` through segment `segment` of the knots, 0 to 1; the last segment continues.
fn ramp(knots: &[f64], segment: usize, drop: f64) -> f64 {
    let from = if segment == 0 { 0.0 } else { knots[segment - 1] };
    let along = (drop.max(0.0) - from) / (knots[segment] - from);
    if segment + 1 == knots.len() { along.max(0.0) } else { along.clamp(0.0, 1.0) }
}

fn knots_columns(trials: &[Trial], knots: &[f64]) -> Vec<Vec<f64>> {
    (0..knots.len()).map(|j| samples(trials).map(|s| ramp(knots, j, s.drop)).collect()).collect()
}

/// The curve whose force rises by `rises_n` from knot to knot.
fn curve(knots: &[f64], rises_n: &[f64]) -> Result<MonotoneCurve, FitError> {
    let mut force_n = 0.0;
    let points: Vec<[f64; 2]> = knots
        .iter()
        .zip(rises_n)
        .map(|(&knot, rise)| {
            force_n += rise;
            [knot, force_n]
        })
        .collect();
    if force_n <= 0.0 {
        return Err(FitError::NotRising);
    }
    MonotoneCurve::new(&points).map_err(FitError::Curve)
}

/// A signal through one unit-gain relaxing branch, trial by trial from rest.
fn relaxed(trials: &[Trial], signal: &[f64], time_s: f64) -> Vec<f64> {
    let mut out = Vec::with_capacity(signal.len());
    let mut values = signal.iter();
    for trial in trials {
        let (mut h, mut last, mut last_s) = (0.0, 0.0, None);
        for (sample, &value) in trial.samples.iter().zip(&mut values) {
            let dt_s = last_s.map_or(0.0, |last_s| sample.time_s - last_s);
            h = relax(h, value - last, dt_s / time_s);
            (last, last_s) = (value, Some(sample.time_s));
            out.push(h);
        }
    }
    out
}

/// F = Fe − Σ g (Fe − h\[Fe\]) is linear in the curve for given shares and linear in the shares for a given curve:
/// solved by turns.
fn compensated(trials: &[Trial]) -> Result<TaxelModel, FitError> {
    let knots = knots(trials);
    let force_n = forces(trials);
    let plain = knots_columns(trials, &knots);
    let branches: [Vec<Vec<f64>>; 3] =
        MEMORY_TIME_S.map(|time_s| plain.iter().map(|column| relaxed(trials, column, time_s)).collect());
    let mut share = [0.0; 3];
    let mut rises = Vec::new();
    for _ in 0..COMPENSATION_ROUNDS {
        let held = 1.0 - share.iter().sum::<f64>();
        let columns: Vec<Vec<f64>> = (0..knots.len())
            .map(|j| {
                (0..force_n.len())
                    .map(|k| held * plain[j][k] + (0..3).map(|b| share[b] * branches[b][j][k]).sum::<f64>())
                    .collect()
            })
            .collect();
        rises = non_negative_least_squares(&columns, &force_n);
        let combine = |columns: &[Vec<f64>], k: usize| -> f64 {
            columns.iter().zip(&rises).map(|(column, rise)| rise * column[k]).sum()
        };
        let elastic: Vec<f64> = (0..force_n.len()).map(|k| combine(&plain, k)).collect();
        let losses: Vec<Vec<f64>> = branches
            .iter()
            .map(|branch| (0..force_n.len()).map(|k| elastic[k] - combine(branch, k)).collect())
            .collect();
        let missing: Vec<f64> = elastic.iter().zip(&force_n).map(|(e, f)| e - f).collect();
        let found = non_negative_least_squares(&losses, &missing);
        let sum: f64 = found.iter().sum();
        let scale = if sum > SHARE_MAX { SHARE_MAX / sum } else { 1.0 };
        share = [found[0] * scale, found[1] * scale, found[2] * scale];
    }
    let curve = CompensatedCurve::new(curve(&knots, &rises)?, share).map_err(FitError::Curve)?;
    Ok(TaxelModel::Compensated(curve))
}

/// Largest relaxing share: beyond it a foam would hold nothing.
const SHARE_MAX: f64 = 0.9;

/// Minimises |Σ x_j·column_j − target|² over x ≥ 0 by coordinate descent on the normal equations, which converges
/// for every convex problem of this kind; at most [`MAX_KNOTS`] unknowns.
fn non_negative_least_squares(columns: &[Vec<f64>], target: &[f64]) -> Vec<f64> {
    const SWEEPS: usize = 5000;
    let dot = |a: &[f64], b: &[f64]| -> f64 { a.iter().zip(b).map(|(a, b)| a * b).sum() };
    let gram: Vec<Vec<f64>> = columns.iter().map(|a| columns.iter().map(|b| dot(a, b)).collect()).collect();
    let right: Vec<f64> = columns.iter().map(|column| dot(column, target)).collect();
    let mut x = std::vec![0.0; columns.len()];
    for _ in 0..SWEEPS {
        let mut largest: f64 = 0.0;
        for j in 0..x.len() {
            if gram[j][j] <= 0.0 {
                continue;
            }
            let next = f64::max(0.0, x[j] + (right[j] - dot(&gram[j], &x)) / gram[j][j]);
            largest = largest.max((next - x[j]).abs());
            x[j] = next;
        }
        let scale = x.iter().fold(0.0, |a: f64, &b| a.max(b));
        if largest <= 1e-12 * scale {
            break;
        }
    }
    x
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::model::FoamMemory;

    /// Ramps 0 → 100 → 0 N over a model run forwards: counts first, force from them.
    fn trial_of(model: &TaxelModel, peak: f64) -> Trial {
        let mut memory = FoamMemory::default();
        let mut samples = Vec::new();
        for i in 0..1400u32 {
            let phase = f64::from(i % 700) / 350.0;
            let drop = peak * (1.0 - (phase - 1.0).abs());
            let dt_s = if i == 0 { 0.0 } else { 0.0286 };
            let force_n = model.force_n(&mut memory, drop, dt_s);
            samples.push(TrialSample { time_s: f64::from(i) * 0.0286, drop, force_n });
        }
        Trial { samples }
    }

    #[test]
    fn every_model_is_found_again_in_its_own_data() {
        let elastic = MonotoneCurve::new(&[[10.0, 20.0], [40.0, 70.0], [84.0, 110.0]]).unwrap();
        for (kind, model, worst_n) in [
            (ModelKind::LineThroughZero, TaxelModel::PAPER, 1e-9),
            (
                ModelKind::LineWithIntercept,
                TaxelModel::LineWithIntercept { newton_per_count: 1.29, intercept_n: 7.1 },
                1e-9,
            ),
            (ModelKind::Monotone, TaxelModel::Monotone(elastic), 1.5),
            (
                ModelKind::Compensated,
                TaxelModel::Compensated(CompensatedCurve::new(elastic, [0.08, 0.07, 0.05]).unwrap()),
                1.5,
            ),
        ] {
            let trials = [trial_of(&model, 84.0)];
            let (_, quality) = fit(kind, &trials).unwrap();
            assert!(quality.rmse_n < worst_n, "{kind:?}: {quality:?}");
        }
    }

    #[test]
    fn compensation_removes_hysteresis_that_a_curve_cannot() {
        let elastic = MonotoneCurve::new(&[[10.0, 20.0], [40.0, 70.0], [84.0, 110.0]]).unwrap();
        let share = [0.10, 0.10, 0.05];
        let trials =
            [trial_of(&TaxelModel::Compensated(CompensatedCurve::new(elastic, share).unwrap()), 84.0)];
        let (_, curve) = fit(ModelKind::Monotone, &trials).unwrap();
        let (_, compensated) = fit(ModelKind::Compensated, &trials).unwrap();
        assert!(compensated.rmse_n < 0.3 * curve.rmse_n, "{compensated:?} {curve:?}");
    }

    #[test]
    fn useless_trials_are_refused_with_their_reason() {
        assert_eq!(fit(ModelKind::Monotone, &[]), Err(FitError::TooFewSamples(0)));
        let mut trial = trial_of(&TaxelModel::PAPER, 2.0);
        assert!(matches!(fit(ModelKind::Monotone, &[trial.clone()]), Err(FitError::NoSpan { .. })));
        trial.samples[7].force_n = f64::NAN;
        let bad = FitError::BadSample { trial: 0, sample: 7 };
        assert_eq!(fit(ModelKind::Monotone, &[trial]), Err(bad));
        let mut trial = trial_of(&TaxelModel::PAPER, 84.0);
        let highest = trial.samples.len();
        for (i, sample) in trial.samples.iter_mut().enumerate() {
            sample.force_n = if i * 2 < highest { 84.0 - sample.drop } else { 0.0 };
        }
        assert_eq!(fit(ModelKind::LineWithIntercept, &[trial]), Err(FitError::NotRising));
    }
}
