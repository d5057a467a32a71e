//! Tables I and II as text, and what may be concluded from them.

use super::{HeldOut, Material, TableRow};
use crate::study::{self, Column, table};
use moca_sim::foam::Foam;
use std::path::Path;

/// Plate of a taxel, m². Table II prints 4 × 18 **mm**; only centimetres give the counts of Table I.
const PLATE_M2: f64 = 0.04 * 0.18;
/// Permittivity of vacuum, F/m.
const EPSILON_0: f64 = 8.854_187_8e-12;
/// Relative permittivity of an open-celled foam: air to a third more. ASSUMED.
const RELATIVE_PERMITTIVITY: [f64; 2] = [1.0, 1.3];

/// Published cells of Table I, in the order of [`Foam::PAPER`].
pub(super) const PAPER: [TableRow; 4] = [
    TableRow { deformation_mm: Some(11.4), counts: 84.0, rmse_deformation_n: 4.064, rmse_counts_n: 5.96 },
    TableRow { deformation_mm: None, counts: 70.0, rmse_deformation_n: 4.790, rmse_counts_n: 11.32 },
    TableRow { deformation_mm: Some(3.0), counts: 5.0, rmse_deformation_n: 1.612, rmse_counts_n: 14.37 },
    TableRow { deformation_mm: Some(2.9), counts: 4.0, rmse_deformation_n: 1.587, rmse_counts_n: 17.91 },
];

/// The whole report.
pub(super) fn report(materials: &[Material], trials: usize, folder: &Path) -> String {
    let held_out: Vec<(&'static str, HeldOut)> = materials
        .iter()
        .flat_map(|material| material.held_out.iter().map(|held_out| (material.name, held_out.clone())))
        .collect();
    let [table_1, table_2, held_out] =
        [table(TABLE_1, materials), table(TABLE_2, &Foam::PAPER), table(HELD_OUT, &held_out)];
    let (build, folder) = (if cfg!(debug_assertions) { "debug" } else { "release" }, folder.display());
    study::aligned(&format!(
        "TABLE I: {trials} simulated trials a material, ramps 0-100-0 N, 10 s each way (ours / paper)\n\n{table_1}\n\
         RMSEs are newtons (14.37 and 17.91 exceed the 5- and 4-count spans). Line with intercept, loading and \
         unloading pooled.\nFITTED, so no evidence: every cell of this table. Gap, span and the two RMSEs of a row \
         fixed the foam's constants;\nCC and PE are phenomenological, CC's 11.4 mm and PE 3 mm's gap are assumed.\n\
         PREDICTED: the shape of the curves, loading against unloading, what other models and other ramps give \
         (below).\n\n\
         TABLE II with its units put right: plate 4 x 18 cm = 72 cm2 (printed as mm: 0.7 cm2, C(0) = 0.04 pF, a \
         hundredth of\nwhat 84 counts need). C = eps A / d, eq. (1), for a relative permittivity of 1.0 to 1.3 \
         (ASSUMED).\n\n{table_2}\n\
         HELD OUT: fitted to the first half of the trials; RMSE [N] on the other half and on ramps of 3 s with a \
         10 s pause.\nThe compensated model has the simulator's own structure (other time constants): a real foam \
         will gain less.\n\n{held_out}\n\
         Costs are the least of 20 passes in this {build} build. PE gives 4 to 5 counts: there the line with \
         intercept has the\nsmallest RMSE only because it reads 20 N untouched; no model makes such a taxel usable.\n\n\
         Figures: {folder}/figure4.svg and .png (mean lines, one standard deviation, loading and unloading apart),\n\
         {folder}/residuals-*.svg and .png (PU). Bands hold noise, quantisation and a 3 % spread of ramp times (ASSUMED).\n"
    ))
}

const TABLE_1: &[Column<Material>] = &[
    ("material", |m| m.name.into()),
    ("dx max [mm]", |m| {
        let paper_mm = m.paper.deformation_mm.map_or_else(|| "NA".to_owned(), |mm| format!("{mm:.1}"));
        format!("{:.2} / {paper_mm}", m.table.deformation_mm.unwrap_or(f64::NAN))
    }),
    ("ds at dx max", |m| format!("{:.1} / {:.0}", m.table.counts, m.paper.counts)),
    ("RMSE of F(dx) [N]", |m| beside(m.table.rmse_deformation_n, m.paper.rmse_deformation_n)),
    ("RMSE of F(ds) [N]", |m| beside(m.table.rmse_counts_n, m.paper.rmse_counts_n)),
];

fn beside(ours: f64, paper: f64) -> String {
    format!("{ours:.3} / {paper:.3}, {:+.1} %", 100.0 * (ours / paper - 1.0))
}

const TABLE_2: &[Column<Foam>] = &[
    ("material", |foam| foam.name.into()),
    ("gap [mm]", |foam| format!("{:.1}", 1e3 * foam.gap_m)),
    ("C(0) [pF]", |foam| range(capacitance_pf(foam.gap_m))),
    ("C at 100 N [pF]", |foam| range(capacitance_pf(foam.gap_left_m(foam.deformation_at_100n_m)))),
    // a = C_plate / (C_plate + C_rest): what the counts say about everything that is not the plate
    ("implied rest of E. [pF]", |foam| {
        range(capacitance_pf(foam.gap_m).map(|plate| plate * (1.0 / foam.sensitivity - 1.0)))
    }),
];

fn capacitance_pf(gap_m: f64) -> [f64; 2] {
    RELATIVE_PERMITTIVITY.map(|k| 1e12 * k * EPSILON_0 * PLATE_M2 / gap_m)
}

fn range([low, high]: [f64; 2]) -> String {
    format!("{low:.1} - {high:.1}")
}

const HELD_OUT: &[Column<(&str, HeldOut)>] = &[
    ("material", |(material, _)| (*material).into()),
    ("model", |(_, h)| h.model.into()),
    ("all", |(_, h)| format!("{:.2}", h.rmse_n)),
    ("loading", |(_, h)| format!("{:.2}", h.rmse_loading_n)),
    ("unloading", |(_, h)| format!("{:.2}", h.rmse_unloading_n)),
    ("other ramps", |(_, h)| format!("{:.2}", h.rmse_other_protocol_n)),
    ("untouched [N]", |(_, h)| format!("{:.1}", h.untouched_n)),
    ("cost [ns]", |(_, h)| format!("{:.0}", h.cost_ns)),
];
