//! Figure 4.

use super::trials::{Recording, Sample};
use crate::picture::Width;
use moca_figures::{Drawing, Panel, Series};
use moca_sim::foam::Foam;
use moca_sim::sensor::IDLE_COUNTS;

/// Force bins of the mean lines.
const BINS: usize = 50;
/// Width of one panel on a screen, px.
const SCREEN: f64 = 680.0;
/// Height of the axes, as a share of a panel's width.
const AXES: f64 = 0.53;
/// Room above the panels and between those that stand over each other, px.
const BETWEEN: f64 = 4.0;

/// Force over deformation and force over counts: means of all presses of all trials, bands of one standard
/// deviation along x; loading and unloading apart.
/// The panels stand beside each other, in one column over each other.
pub(super) fn figure_4(recordings: &[Vec<Recording>], width: Width) -> Drawing {
    let x_labels = ["deformation [mm]", "counts below rest"];
    let titles = [
        "force over deformation: loading strong, unloading pale",
        "force over counts: means, bands of one standard deviation",
    ];
    let values: [fn(&Sample) -> f64; 2] =
        [|sample| 1e3 * sample.deformation_m, |sample| IDLE_COUNTS - f64::from(sample.fdat)];
    let mut panels = Vec::new();
    for (i, ((title, x_label), value)) in titles.into_iter().zip(x_labels).zip(values).enumerate() {
        let mut panel = Panel::new(title, x_label, "force [N]");
        for (colour, (foam, recordings)) in Foam::PAPER.into_iter().zip(recordings).enumerate() {
            for rising in [true, false] {
                let curve = mean_curve(recordings, rising, value);
                let shifted = |sign: f64| {
                    curve.iter().map(move |&(force_n, mean, deviation)| [mean + sign * deviation, force_n])
                };
                let series = Series::line(colour, foam.name, shifted(0.0).collect());
                let upper: Vec<[f64; 2]> = shifted(1.0).collect();
                let series = series.between(shifted(-1.0).collect(), upper.into_iter());
                panel.series.push(if rising { series } else { series.pale() });
            }
        }
        panels.push(panel.lettered(i));
    }
    let (panel_width, over) = match width {
        Width::Screen => (SCREEN, false),
        Width::Single => (width.px(), true),
        Width::Double => (0.5 * width.px(), false),
    };
    let heights = panels.iter().map(|panel| panel.height(panel_width, AXES * panel_width));
    let height = heights.fold(0.0, f64::max) + BETWEEN;
    let size = if over { [panel_width, 2.0 * height] } else { [2.0 * panel_width, height] };
    let mut drawing = Drawing::new(size[0], size[1] + BETWEEN);
    for (panel, i) in panels.iter().zip(0u32..) {
        let place = f64::from(i);
        let origin = if over { [0.0, place * height + BETWEEN] } else { [place * panel_width, BETWEEN] };
        panel.draw(&mut drawing, origin, [panel_width, height - BETWEEN]);
    }
    drawing
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
