//! Figure 4 and pictures in general.

use super::trials::{Recording, Sample};
use anyhow::Context;
use moca_sim::foam::Foam;
use moca_sim::sensor::IDLE_COUNTS;
use moca_tactile::calibration::chart::{COLOURS, Chart, side_by_side};
use resvg::{tiny_skia, usvg};
use std::path::Path;

/// Force bins of the mean lines.
const BINS: usize = 50;
/// Pixels for each unit of the SVG.
const SCALE: f32 = 2.0;

/// Force over deformation and force over counts: means of all presses of all trials, bands of one standard
/// deviation along x; loading and unloading apart.
pub(super) fn figure_4(recordings: &[Vec<Recording>]) -> String {
    let x_labels = ["deformation [mm]", "counts below rest"];
    let titles = ["Force over deformation", "Force over counts"];
    let values: [fn(&Sample) -> f64; 2] =
        [|sample| 1e3 * sample.deformation_m, |sample| IDLE_COUNTS - f64::from(sample.fdat)];
    let charts: Vec<Chart> = (0..2)
        .map(|panel| {
            let value = values[panel];
            let largest = recordings.iter().flatten().flat_map(|r| &r.samples).map(value).fold(0.0, f64::max);
            let labels = [x_labels[panel], "force [N]"];
            let mut chart = Chart::new(titles[panel], labels, [0.0, 1.08 * largest], [0.0, 105.0]);
            for ((foam, recordings), colour) in Foam::PAPER.into_iter().zip(recordings).zip(COLOURS) {
                for rising in [true, false] {
                    let curve = mean_curve(recordings, rising, value);
                    let shifted = |sign: f64| -> Vec<_> {
                        curve
                            .iter()
                            .map(|&(force_n, mean, deviation)| (mean + sign * deviation, force_n))
                            .collect()
                    };
                    chart.band(colour, &shifted(-1.0), &shifted(1.0));
                    let name = if rising { foam.name } else { "" };
                    chart.line(name, colour, shifted(0.0));
                }
            }
            chart
        })
        .collect();
    side_by_side(&charts)
}

/// (force, mean, standard deviation) of `value` in each force bin.
fn mean_curve(recordings: &[Recording], rising: bool, value: fn(&Sample) -> f64) -> Vec<(f64, f64, f64)> {
    #[expect(clippy::cast_precision_loss, reason = "50 bins")]
    let width_n = 100.0 / BINS as f64;
    let mut bins = vec![[0.0; 4]; BINS];
    for recording in recordings {
        for pair in recording.samples.windows(2) {
            let sample = &pair[1];
            if (sample.force_n > pair[0].force_n) == rising {
                #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "0 to 100 N")]
                let bin = ((sample.force_n / width_n) as usize).min(BINS - 1);
                let v = value(sample);
                for (sum, term) in bins[bin].iter_mut().zip([1.0, sample.force_n, v, v * v]) {
                    *sum += term;
                }
            }
        }
    }
    bins.into_iter()
        .filter(|bin| bin[0] > 1.0)
        .map(|[count, force, sum, squares]| {
            let mean = sum / count;
            (force / count, mean, (squares / count - mean * mean).max(0.0).sqrt())
        })
        .collect()
}

/// Writes `path`.svg and `path`.png.
pub(crate) fn write(svg: &str, path: &Path) -> anyhow::Result<()> {
    let (svg_path, png_path) = (path.with_extension("svg"), path.with_extension("png"));
    std::fs::write(&svg_path, svg).with_context(|| format!("cannot write {}", svg_path.display()))?;
    std::fs::write(&png_path, png(svg)?).with_context(|| format!("cannot write {}", png_path.display()))
}

/// A picture of an SVG with the system's fonts.
pub(crate) fn png(svg: &str) -> anyhow::Result<Vec<u8>> {
    let mut options = usvg::Options::default();
    options.fontdb_mut().load_system_fonts();
    let tree = usvg::Tree::from_str(svg, &options)?;
    let size = tree.size().to_int_size().scale_by(SCALE).context("an empty picture")?;
    let mut pixmap = tiny_skia::Pixmap::new(size.width(), size.height()).context("an empty picture")?;
    resvg::render(&tree, tiny_skia::Transform::from_scale(SCALE, SCALE), &mut pixmap.as_mut());
    Ok(pixmap.encode_png()?)
}
