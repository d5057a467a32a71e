//! The work–precision diagrams.

use super::{Report, control, plant};
use crate::rig::count;
use moca_figures::{BLACK, Drawing, Panel, Scale, Series};

const WIDTH: f64 = 900.0;
const HEIGHT: f64 = 270.0;
const CPU: &str = "CPU time [s per simulated second]";
/// What stands below all of them.
const NOTES: [&str; 2] = [
    "Each dot is a step length or a rate, the longest or slowest on the left. Pale bands: least and most CPU time of equal runs.",
    "A red cross is a run that failed, at the time it took until then; it has no error and stands at the top.",
];

/// All diagrams under each other.
pub(crate) fn draw(report: &Report) -> Drawing {
    let mut panels = Vec::new();
    for scene in &report.scenes {
        panels.extend(plant_panels(scene));
    }
    panels.push(rate_panel(&report.control_rate));
    panels.push(admittance_panel("smooth force", &report.admittance, |p| p.smooth.flange_m));
    panels.push(admittance_panel("reading held for 120 ms", &report.admittance, |p| p.held.flange_m));
    let points = report.calibration.iter().enumerate();
    let series = points.map(|(i, model)| {
        let [x, loading, unloading] = [model.cost_ns, model.rmse_loading_n, model.rmse_unloading_n];
        let dot = Series::dots(i, model.model, vec![[x, model.rmse_n]]);
        let side = |share: f64| vec![[share * x, loading], [share * x, unloading]];
        dot.between(side(0.97), side(1.03).into_iter())
    });
    panels.push(Panel {
        series: series.collect(),
        ..diagram(
            "models of the taxel on PU LD30, trials not seen; bars: loading alone and unloading alone",
            "one evaluation [ns]",
            "RMSE [N]",
        )
    });
    let height = HEIGHT * count(panels.len()) + 10.0;
    let mut drawing = Drawing::new(WIDTH, height + 16.0 * count(NOTES.len()));
    for (i, panel) in panels.iter().enumerate() {
        panel.draw(&mut drawing, [0.0, HEIGHT * count(i) + 6.0], [WIDTH, HEIGHT]);
    }
    for (i, note) in NOTES.iter().enumerate() {
        drawing.text([8.0, height + 6.0 + 16.0 * count(i)], moca_figures::Anchor::Start, note, BLACK);
    }
    drawing
}

fn diagram(title: &str, x: &str, y: &str) -> Panel {
    Panel { x_scale: Scale::Log, y_scale: Scale::Log, ..Panel::new(title, x, y) }
}

/// A line through (least CPU time, most, error) with its band.
fn timed(i: usize, name: &str, points: &[[f64; 3]]) -> Series {
    let least: Vec<[f64; 2]> = points.iter().map(|[least, _, off]| [*least, *off]).collect();
    Series::dots(i, name, least.clone()).between(least, points.iter().map(|[_, most, off]| [*most, *off]))
}

fn plant_panels(scene: &plant::SceneReport) -> Vec<Panel> {
    let panel = |title: String, y: &str, level: f64, pick: &dyn Fn(&plant::Point) -> Option<f64>| {
        let curve = |(i, (_, method)): (usize, &(_, &'static str))| {
            let points = scene.points.iter().filter(|p| p.integrator == *method && p.failed.is_none());
            let points =
                points.filter_map(|p| Some([p.cpu_s_per_s, p.cpu_most_s_per_s, pick(p)?.max(1e-12)]));
            timed(i, method, &points.collect::<Vec<_>>())
        };
        let failed = scene.points.iter().filter(|p| p.failed.is_some());
        let failed = failed
            .map(|p| Series::failures(format!("{} {} ms fails", p.integrator, p.step_ms), [p.cpu_s_per_s]));
        let default = scene.points.iter().find(|p| plant::is_default(p));
        let default = default.and_then(|p| Some([p.cpu_s_per_s, pick(p)?]));
        let mut default = Series::dots(0, "the default", default.into_iter().collect());
        default.colour = BLACK;
        Panel {
            series: plant::METHODS.iter().enumerate().map(curve).chain(failed).chain([default]).collect(),
            levels: vec![(level, "reference's own error")],
            ..diagram(&title, CPU, y)
        }
    };
    let steps = || scene.points.iter().map(|p| p.step_ms);
    let (shortest, longest) = (steps().fold(f64::INFINITY, f64::min), steps().fold(0.0, f64::max));
    let name = format!("{} scene, steps of {longest} to {shortest} ms", scene.scene);
    let title = format!("{name}: error in state after 1 s");
    let mut panels = vec![panel(title, "largest [m, rad]", scene.self_consistency, &|p| Some(p.state_error))];
    if let Some(own) = scene.peak_self_consistency {
        let title = format!("{name}: error in peak force");
        panels.push(panel(title, "share of the force", own, &|p| p.peak_error));
    }
    panels
}

fn rate_panel(points: &[control::RatePoint]) -> Panel {
    let points = points.iter().filter(|p| p.base_error_mm > 0.0);
    let points: Vec<[f64; 3]> =
        points.map(|p| [p.cpu_s_per_s, p.cpu_most_s_per_s, p.base_error_mm]).collect();
    Panel {
        series: vec![timed(0, "100 to 2000 Hz", &points)],
        ..diagram("control rate: way of the base against that at 4 kHz, T6 20 N", CPU, "error [mm]")
    }
}

fn admittance_panel(
    input: &str,
    points: &[control::AdmittancePoint],
    pick: fn(&control::AdmittancePoint) -> f64,
) -> Panel {
    let curve = |(i, (method, _)): (usize, &(&'static str, _))| {
        let own = points.iter().filter(|p| p.method == *method && !p.failed);
        let own = own.map(|p| [p.cpu_s_per_s, p.cpu_most_s_per_s, pick(p).max(1e-16)]);
        timed(i, method, &own.collect::<Vec<_>>())
    };
    let failed = points.iter().filter(|p| p.failed);
    let failed =
        failed.map(|p| Series::failures(format!("{} {} ms fails", p.method, p.step_ms), [p.cpu_s_per_s]));
    Panel {
        series: control::DISCRETISATIONS.iter().enumerate().map(curve).chain(failed).collect(),
        ..diagram(
            &format!("eq. (2), M/D = 10 ms, steps of 60 to 0.1 ms, {input}: way of the flange"),
            CPU,
            "largest error [m]",
        )
    }
}
