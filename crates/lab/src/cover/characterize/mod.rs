//! `moca-lab characterize`: section IV-A on simulated foams. Table I with the paper's figures beside ours, Table II
//! with its units put right, Figure 4, and what better models gain on trials they have not seen.

mod figure;
mod tables;
mod trials;

use crate::picture::{Picture as _, Width};
use crate::study::Answer;
use anyhow::{Context, ensure};
use moca_experiments::parallel::Count;
use moca_sim::foam::Foam;
use moca_tactile::calibration::quality::{evaluation_cost_ns, quality};
use moca_tactile::calibration::{ModelKind, Trial, TrialSample, fit, residuals};
use moca_tactile::model::{ASSUMED_ERROR_FROM_N, TaxelModel};
use serde::Serialize;
use std::path::{Path, PathBuf};
use trials::{Protocol, Recording};

/// Ten trials of four foams: Tables I and II, Figure 4, what better calibrations gain.
#[derive(clap::Args)]
pub(crate) struct Arguments {
    /// Trials of each material; the first half is fitted, the rest held out.
    #[arg(long, default_value_t = 10)]
    trials: usize,
    /// Seed of the sensor's noise and of the ramps' spread.
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// Folder for the figures.
    #[arg(long, default_value = "out/characterize")]
    out: PathBuf,
    /// Width of Figure 4.
    #[arg(long, value_enum, default_value_t)]
    width: Width,
    #[command(flatten)]
    answer: Answer,
}

/// One material's results.
#[derive(Debug, Serialize)]
struct Material {
    name: &'static str,
    /// Mean over trials.
    table: TableRow,
    /// Published figures of the same cells.
    paper: TableRow,
    held_out: Vec<HeldOut>,
}

/// One row of Table I.
#[derive(Clone, Copy, Debug, Serialize)]
struct TableRow {
    /// Largest deformation of a trial, mm; the paper prints none for CC.
    deformation_mm: Option<f64>,
    /// Counts at the largest deformation, before noise.
    counts: f64,
    /// RMSE of the line F(Δx), N.
    rmse_deformation_n: f64,
    /// RMSE of the line F(Δs), N.
    rmse_counts_n: f64,
}

/// A model fitted to the first half of the trials, judged on what it has not seen.
#[derive(Clone, Debug, Serialize)]
pub(crate) struct HeldOut {
    pub model: &'static str,
    /// The other half of the trials, N.
    pub rmse_n: f64,
    pub rmse_loading_n: f64,
    pub rmse_unloading_n: f64,
    /// Ramps of 3 s with a pause of 10 s at 60 N, N.
    rmse_other_protocol_n: f64,
    /// Reading of the untouched taxel, N.
    untouched_n: f64,
    /// One evaluation, ns.
    pub cost_ns: f64,
}

/// Simulates, fits, prints, draws.
pub(crate) fn run(arguments: &Arguments) -> anyhow::Result<()> {
    ensure!((2..=100).contains(&arguments.trials), "--trials must be 2 to 100, got {}", arguments.trials);
    let (recordings, materials) = simulate(arguments.trials, arguments.seed)?;
    std::fs::create_dir_all(&arguments.out)
        .with_context(|| format!("cannot create {}", arguments.out.display()))?;
    figure::figure_4(&recordings, arguments.width).write(&arguments.out.join("figure4"))?;
    residual_plots(&recordings[0], &arguments.out)?;
    arguments.answer.print(&materials, || {
        let mut text = tables::report(&materials, arguments.trials, &arguments.out);
        for (name, model) in [("PU LD30", TaxelModel::PU_LD30), ("paper", TaxelModel::PAPER)] {
            text += &format!(
                "Assumed and not calibrated, model {name}: a press of {ASSUMED_ERROR_FROM_N} N or more reads up to {:.0} % off on \
                 PU LD30 of nominal stiffness +- 10 %.\n",
                100.0 * assumed_error(&model)
            );
        }
        Ok(text)
    })
}

/// Tables I and II as text and Figure 4 as SVG, for a report that holds them.
pub(crate) fn tables_and_figure_4(trials: usize, seed: u64) -> anyhow::Result<(String, String)> {
    let (recordings, materials) = simulate(trials, seed)?;
    let figure_4 = figure::figure_4(&recordings, Width::Screen).svg();
    Ok((tables::report(&materials, trials, Path::new("out/characterize")), figure_4))
}

/// Table I with steps of the foam that are `finer` times shorter: each material with its largest deformation, mm, the counts
/// there, and the RMSE of both lines, N.
pub(crate) fn table_1(finer: u32, trials: usize, seed: u64) -> anyhow::Result<Vec<(&'static str, [f64; 4])>> {
    let row = |foam: &Foam| {
        let steps = finer * trials::STEPS;
        let row = table_row(foam, &trials::record_in_steps(foam, Protocol::Ramps, trials, seed, steps))?;
        let deformation_mm = row.deformation_mm.unwrap_or(f64::NAN);
        Ok((foam.name, [deformation_mm, row.counts, row.rmse_deformation_n, row.rmse_counts_n]))
    };
    Foam::PAPER.iter().map(row).collect()
}

/// Every calibration model on the cover's own foam.
pub(crate) fn models_on_the_cover(trials: usize, seed: u64) -> anyhow::Result<Vec<HeldOut>> {
    let foam = Foam::default();
    held_out(&foam, &trials::record(&foam, Protocol::Ramps, trials, seed), seed)
}

fn simulate(trials: usize, seed: u64) -> anyhow::Result<(Vec<Vec<Recording>>, Vec<Material>)> {
    let recordings: Vec<Vec<Recording>> =
        Foam::PAPER.iter().map(|foam| trials::record(foam, Protocol::Ramps, trials, seed)).collect();
    let mut count = Count::new("characterize", Foam::PAPER.len());
    let materials = Foam::PAPER
        .iter()
        .zip(tables::PAPER)
        .zip(&recordings)
        .map(|((foam, paper), recordings)| {
            let (table, held_out) = (table_row(foam, recordings)?, held_out(foam, recordings, seed)?);
            count.one_more();
            Ok(Material { name: foam.name, table, paper, held_out })
        })
        .collect::<anyhow::Result<Vec<_>>>()?;
    Ok((recordings, materials))
}

/// Every model, fitted to the first half of the recordings.
fn held_out(foam: &Foam, recordings: &[Recording], seed: u64) -> anyhow::Result<Vec<HeldOut>> {
    let (fitted, held_out) = recordings.split_at(recordings.len() / 2);
    let fitted: Vec<Trial> = fitted.iter().map(Recording::trial).collect();
    let held_out: Vec<Trial> = held_out.iter().map(Recording::trial).collect();
    let other: Vec<Trial> = trials::record(foam, Protocol::FastWithPause, 3, seed ^ 0x5eed)
        .iter()
        .map(Recording::trial)
        .collect();
    let judge = |kind| {
        let (model, _) = fit(kind, &fitted).with_context(|| foam.name)?;
        let seen = quality(&model, &held_out);
        Ok(HeldOut {
            model: model.name(),
            rmse_n: seen.rmse_n,
            rmse_loading_n: seen.rmse_loading_n,
            rmse_unloading_n: seen.rmse_unloading_n,
            rmse_other_protocol_n: quality(&model, &other).rmse_n,
            untouched_n: model.force_n(&mut moca_tactile::model::FoamMemory::default(), 0.0, 0.0),
            cost_ns: evaluation_cost_ns(&model, &held_out),
        })
    };
    ModelKind::ALL.into_iter().map(judge).collect()
}

/// Largest error of a model that was assumed, over forces it states one for, as a share of the force.
fn assumed_error(model: &TaxelModel) -> f64 {
    let mut worst: f64 = 0.0;
    for stiffness in [0.9, 1.0, 1.1] {
        let foam = Foam::default().stiffened(stiffness);
        for protocol in [Protocol::Ramps, Protocol::FastWithPause] {
            let trials: Vec<Trial> =
                trials::record(&foam, protocol, 3, 7).iter().map(Recording::trial).collect();
            for (force_n, error_n) in moca_tactile::calibration::residuals(model, &trials) {
                if force_n >= ASSUMED_ERROR_FROM_N {
                    worst = worst.max(error_n.abs() / force_n);
                }
            }
        }
    }
    worst
}

/// Means over trials; both lines are fitted to each trial as the paper does.
fn table_row(foam: &Foam, recordings: &[Recording]) -> anyhow::Result<TableRow> {
    #[expect(clippy::cast_precision_loss, reason = "at most 100")]
    let count = recordings.len() as f64;
    let mut row =
        TableRow { deformation_mm: Some(0.0), counts: 0.0, rmse_deformation_n: 0.0, rmse_counts_n: 0.0 };
    for recording in recordings {
        let deepest_m = recording.samples.iter().map(|s| s.deformation_m).fold(0.0, f64::max);
        row.deformation_mm = row.deformation_mm.map(|sum| sum + 1e3 * deepest_m / count);
        row.counts += foam.counts_drop(deepest_m) / count;
        row.rmse_deformation_n += line_rmse_n(&recording.deformation_trial())? / count;
        row.rmse_counts_n += line_rmse_n(&recording.trial())? / count;
    }
    Ok(row)
}

/// RMSE of the least-squares line itself, N: a taxel's model never reads below zero, the paper's line does.
fn line_rmse_n(trial: &Trial) -> anyhow::Result<f64> {
    let (model, _) = fit(ModelKind::LineWithIntercept, std::slice::from_ref(trial))?;
    let TaxelModel::LineWithIntercept { newton_per_count, intercept_n } = model else {
        anyhow::bail!("a line was asked for");
    };
    let square = |s: &TrialSample| (newton_per_count * s.drop + intercept_n - s.force_n).powi(2);
    #[expect(clippy::cast_precision_loss, reason = "some thousand samples")]
    let count = trial.samples.len() as f64;
    Ok((trial.samples.iter().map(square).sum::<f64>() / count).sqrt())
}

/// Residuals of every model on PU, the cover's foam.
fn residual_plots(recordings: &[Recording], folder: &Path) -> anyhow::Result<()> {
    let trials: Vec<Trial> = recordings.iter().map(Recording::trial).collect();
    for kind in ModelKind::ALL {
        let (model, quality) = fit(kind, &trials)?;
        let title = format!("PU LD30, {}: RMSE {:.2} N", model.name(), quality.rmse_n);
        let drawing = moca_figures::residuals(&title, "N", &residuals(&model, &trials));
        drawing.write(&folder.join(format!("residuals-{}", TaxelModel::name(&model))))?;
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn materials() -> Vec<Material> {
        simulate(10, 1).unwrap().1
    }

    #[test]
    fn fitted_cells_are_within_3_percent_on_unseen_trials() {
        for material in materials() {
            let (ours, paper) = (material.table, material.paper);
            for (ours_n, paper_n) in [
                (ours.rmse_deformation_n, paper.rmse_deformation_n),
                (ours.rmse_counts_n, paper.rmse_counts_n),
            ] {
                assert!(
                    (ours_n / paper_n - 1.0).abs() < 0.03,
                    "{}: {ours_n} against {paper_n}",
                    material.name
                );
            }
            let rmse = |name: &str| material.held_out.iter().find(|h| h.model == name).unwrap().rmse_n;
            if paper.counts > 10.0 {
                assert!(rmse("monotone") < 0.6 * rmse("line-with-intercept"), "{material:?}");
                assert!(rmse("compensated") < 0.8 * rmse("monotone"), "{material:?}");
            } else {
                assert!(rmse("monotone") < rmse("line-through-zero"), "{material:?}");
            }
        }
    }

    #[test]
    fn uncalibrated_curve_has_stated_error() {
        let foam = Foam::default();
        let trials: Vec<Trial> =
            trials::record(&foam, Protocol::Ramps, 10, 1).iter().map(Recording::trial).collect();
        let (fitted, quality) = fit(ModelKind::Monotone, &trials).unwrap();
        let (TaxelModel::Monotone(fitted), TaxelModel::Monotone(shipped)) = (fitted, TaxelModel::PU_LD30)
        else {
            panic!("two curves")
        };
        for (fitted, shipped) in fitted.knots().zip(shipped.knots()) {
            assert!(
                fitted[0].to_bits() == shipped[0].to_bits() && (fitted[1] - shipped[1]).abs() <= 0.006,
                "{fitted:?} {shipped:?}"
            );
        }
        assert!((quality.rmse_n - 2.2).abs() < 0.05, "{quality:?}");
        for model in [TaxelModel::PU_LD30, TaxelModel::PAPER] {
            let (worst, stated) = (assumed_error(&model), model.assumed_error());
            assert!(worst <= stated && worst > stated - 0.05, "{model:?}: {worst} against {stated}");
        }
    }

    #[test]
    fn figure_4_becomes_a_picture() {
        let recordings: Vec<_> =
            Foam::PAPER.iter().map(|foam| trials::record(foam, Protocol::Ramps, 2, 1)).collect();
        for width in [Width::Screen, Width::Single, Width::Double] {
            let drawing = figure::figure_4(&recordings, width);
            assert!(drawing.png().unwrap().len() > 10_000);
            assert_eq!(drawing.texts_outside().unwrap(), Vec::<String>::new(), "{width:?}");
            assert!(drawing.texts().any(|text| text.starts_with("(b) ")));
            let screen = width == Width::Screen;
            assert!(screen || (drawing.size()[0] - width.px()).abs() < 1e-9, "{width:?}");
        }
    }
}
