//! Quality of a model on given trials.

use super::Trial;
use crate::model::{FoamMemory, TaxelModel};
use std::time::Instant;
use std::vec::Vec;

/// Errors of a model in newtons, where it holds, and what one evaluation costs.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Quality {
    /// Samples.
    pub samples: usize,
    /// Root mean square error over everything, N.
    pub rmse_n: f64,
    /// Root mean square error while the force rises, N.
    pub rmse_loading_n: f64,
    /// Root mean square error while it falls, N.
    pub rmse_unloading_n: f64,
    /// Reference over modelled force while the force rises: a foam takes more force in than it gives back.
    pub loading_ratio: f64,
    /// Largest error, N.
    pub worst_n: f64,
    /// The model holds up to these counts below rest.
    pub counts_max: f64,
    /// And up to this force, N.
    pub force_max_n: f64,
}

/// Reference force and model minus reference, N, of every sample in order.
pub fn residuals(model: &TaxelModel, trials: &[Trial]) -> Vec<(f64, f64)> {
    let mut out = Vec::new();
    for trial in trials {
        let mut memory = FoamMemory::default();
        let mut last_s = None;
        for sample in &trial.samples {
            let dt_s = last_s.map_or(0.0, |last_s| sample.time_s - last_s);
            last_s = Some(sample.time_s);
            out.push((sample.force_n, model.force_n(&mut memory, sample.drop, dt_s) - sample.force_n));
        }
    }
    out
}

/// Factor of the modelled forces that comes closest to the reference, from pairs of the reference and the model's error, N; NaN where
/// the model gives no force.
pub fn reference_ratio(residuals_n: &[(f64, f64)]) -> f64 {
    let read = residuals_n.iter().map(|(force_n, error_n)| (force_n, force_n + error_n));
    let (product, square) = read.fold((0.0, 0.0), |(product, square), (force_n, read_n)| {
        (product + force_n * read_n, square + read_n * read_n)
    });
    product / square
}

/// Runs `model` over `trials`.
pub fn quality(model: &TaxelModel, trials: &[Trial]) -> Quality {
    let residuals = residuals(model, trials);
    let (mut rising, mut falling) = (Mean::default(), Mean::default());
    let (mut worst_n, mut loading_n) = (0.0_f64, Vec::new());
    let mut index = 0;
    for trial in trials {
        let mut last_n = 0.0;
        for _ in &trial.samples {
            let (force_n, error_n) = residuals[index];
            if force_n >= last_n {
                rising.add(error_n * error_n);
                loading_n.push((force_n, error_n));
            } else {
                falling.add(error_n * error_n);
            }
            worst_n = worst_n.max(error_n.abs());
            last_n = force_n;
            index += 1;
        }
    }
    let largest = |value: fn(&super::TrialSample) -> f64| {
        trials.iter().flat_map(|trial| &trial.samples).map(value).fold(0.0, f64::max)
    };
    Quality {
        samples: residuals.len(),
        rmse_n: rising.and(&falling).value().sqrt(),
        rmse_loading_n: rising.value().sqrt(),
        rmse_unloading_n: falling.value().sqrt(),
        loading_ratio: reference_ratio(&loading_n),
        worst_n,
        counts_max: largest(|sample| sample.drop),
        force_max_n: largest(|sample| sample.force_n),
    }
}

/// Least time of one evaluation over several passes through `trials`, ns. Reads a clock; reports only.
#[expect(clippy::cast_precision_loss, reason = "times and counts far below 2^53")]
pub fn evaluation_cost_ns(model: &TaxelModel, trials: &[Trial]) -> f64 {
    let count = trials.iter().map(|trial| trial.samples.len()).sum::<usize>().max(1);
    let mut least_ns = f64::INFINITY;
    for _ in 0..20 {
        let start = Instant::now();
        let mut memory = FoamMemory::default();
        let mut sum = 0.0;
        for sample in trials.iter().flat_map(|trial| &trial.samples) {
            sum += core::hint::black_box(model).force_n(&mut memory, sample.drop, 0.0247);
        }
        core::hint::black_box(sum);
        least_ns = least_ns.min(start.elapsed().as_nanos() as f64 / count as f64);
    }
    least_ns
}

#[derive(Default)]
struct Mean {
    sum: f64,
    count: f64,
}

impl Mean {
    fn add(&mut self, value: f64) {
        self.sum += value;
        self.count += 1.0;
    }

    fn and(&self, other: &Self) -> Self {
        Self { sum: self.sum + other.sum, count: self.count + other.count }
    }

    fn value(&self) -> f64 {
        if self.count > 0.0 { self.sum / self.count } else { 0.0 }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::calibration::TrialSample;

    #[test]
    fn loading_ratio_is_of_samples_in_which_force_does_not_fall() {
        let model = TaxelModel::LineThroughZero { newton_per_count: 2.0 };
        // Reference over what the model reads: 1.2 while it rises or stays, 0.8 while it falls.
        let press = |shares: &[(f64, f64)]| Trial {
            samples: shares
                .iter()
                .map(|&(drop, share)| TrialSample { time_s: drop, drop, force_n: 2.0 * share * drop })
                .collect(),
        };
        let presses = [
            press(&[(1.0, 1.2), (10.0, 1.2), (10.0, 1.2), (9.0, 0.8), (5.0, 0.8)]),
            press(&[(3.0, 1.2), (2.0, 0.8)]),
        ];
        let ratio = quality(&model, &presses).loading_ratio;
        assert!((ratio - 1.2).abs() < 1e-12, "{ratio}");
        assert!(quality(&model, &[press(&[(0.0, 1.0)])]).loading_ratio.is_nan(), "no force, no ratio");
    }
}
