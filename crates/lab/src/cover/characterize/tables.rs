//! Tables I and II as text, and what may be concluded from them.

use super::{Material, TableRow};
use moca_sim::foam::Foam;
use std::fmt::Write;
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
    let mut out = String::new();
    table_1(&mut out, materials, trials);
    table_2(&mut out);
    held_out(&mut out, materials);
    // writing to a String cannot fail
    let _ = writeln!(
        out,
        "\nFigures: {0}/figure4.svg and .png (mean lines, one standard deviation, loading and unloading apart),\n\
         {0}/residuals-*.svg and .png (PU). Bands hold noise, quantisation and a 3 % spread of ramp times (ASSUMED).",
        folder.display()
    );
    out
}

fn table_1(out: &mut String, materials: &[Material], trials: usize) {
    let _ = writeln!(
        out,
        "TABLE I: {trials} simulated trials a material, ramps 0-100-0 N, 10 s each way (ours / paper)\n\n\
         {:<14}{:>16}{:>16}{:>20}{:>7}{:>20}{:>7}",
        "material", "dx max [mm]", "ds at dx max", "RMSE of F(dx) [N]", "", "RMSE of F(ds) [N]", ""
    );
    for Material { name, table, paper, .. } in materials {
        let cell = |ours: f64, paper: f64| (format!("{ours:.3} / {paper:.3}"), 100.0 * (ours / paper - 1.0));
        let (deformation, deformation_off) = cell(table.rmse_deformation_n, paper.rmse_deformation_n);
        let (counts, counts_off) = cell(table.rmse_counts_n, paper.rmse_counts_n);
        let paper_mm = paper.deformation_mm.map_or_else(|| "NA".to_owned(), |mm| format!("{mm:.1}"));
        let _ = writeln!(
            out,
            "{name:<14}{:>16}{:>16}{deformation:>20}{deformation_off:>+6.1}%{counts:>20}{counts_off:>+6.1}%",
            format!("{:.2} / {paper_mm}", table.deformation_mm.unwrap_or(f64::NAN)),
            format!("{:.1} / {:.0}", table.counts, paper.counts),
        );
    }
    let _ = writeln!(
        out,
        "\nRMSEs are newtons (14.37 and 17.91 exceed the 5- and 4-count spans). Line with intercept, loading and \
         unloading pooled.\nFITTED, so no evidence: every cell of this table. Gap, span and the two RMSEs of a row \
         fixed the foam's constants;\nCC and PE are phenomenological, CC's 11.4 mm and PE 3 mm's gap are assumed.\n\
         PREDICTED: the shape of the curves, loading against unloading, what other models and other ramps give \
         (below)."
    );
}

fn table_2(out: &mut String) {
    let _ = writeln!(
        out,
        "\nTABLE II with its units put right: plate 4 x 18 cm = 72 cm2 (printed as mm: 0.7 cm2, C(0) = 0.04 pF, a \
         hundredth of\nwhat 84 counts need). C = eps A / d, eq. (1), for a relative permittivity of 1.0 to 1.3 \
         (ASSUMED).\n\n{:<14}{:>10}{:>16}{:>18}{:>29}",
        "material", "gap [mm]", "C(0) [pF]", "C at 100 N [pF]", "implied rest of E. [pF]"
    );
    for foam in Foam::PAPER {
        let capacitance_pf =
            |gap_m: f64| RELATIVE_PERMITTIVITY.map(|k| 1e12 * k * EPSILON_0 * PLATE_M2 / gap_m);
        let at_rest = capacitance_pf(foam.gap_m);
        let pressed = capacitance_pf(foam.gap_left_m(foam.deformation_at_100n_m));
        // a = C_plate / (C_plate + C_rest): what the counts say about everything that is not the plate
        let rest = at_rest.map(|plate| plate * (1.0 / foam.sensitivity - 1.0));
        let range = |[low, high]: [f64; 2]| format!("{low:.1} - {high:.1}");
        let _ = writeln!(
            out,
            "{:<14}{:>10.1}{:>16}{:>18}{:>26}",
            foam.name,
            1e3 * foam.gap_m,
            range(at_rest),
            range(pressed),
            range(rest)
        );
    }
}

fn held_out(out: &mut String, materials: &[Material]) {
    let _ = writeln!(
        out,
        "\nHELD OUT: fitted to the first half of the trials; RMSE [N] on the other half and on ramps of 3 s with a \
         10 s pause.\nThe compensated model has the simulator's own structure (other time constants): a real foam \
         will gain less.\n\n{:<14}{:<21}{:>8}{:>10}{:>11}{:>13}{:>15}{:>10}",
        "material", "model", "all", "loading", "unloading", "other ramps", "untouched [N]", "cost [ns]"
    );
    for material in materials {
        for h in &material.held_out {
            let _ = writeln!(
                out,
                "{:<14}{:<21}{:>8.2}{:>10.2}{:>11.2}{:>13.2}{:>15.1}{:>10.0}",
                material.name,
                h.model,
                h.rmse_n,
                h.rmse_loading_n,
                h.rmse_unloading_n,
                h.rmse_other_protocol_n,
                h.untouched_n,
                h.cost_ns
            );
        }
    }
    let build = if cfg!(debug_assertions) { "debug" } else { "release" };
    let _ = writeln!(
        out,
        "\nCosts are the least of 20 passes in this {build} build. PE gives 4 to 5 counts: there the line with \
         intercept has the\nsmallest RMSE only because it reads 20 N untouched; no model makes such a taxel usable."
    );
}
