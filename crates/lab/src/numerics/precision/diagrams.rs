//! The work–precision diagrams.

use super::{Report, control, plant};
use crate::picture::Width;
use moca_experiments::count;
use moca_figures::{BLACK, Drawing, Panel, Scale, Series, wrapped};

/// Height of a diagram's axes, px.
const AXES: f64 = 212.0;
const LINE: f64 = 16.0;
const CPU: &str = "CPU time [s per simulated second]";
/// Notes below all diagrams.
const NOTES: [&str; 2] = [
    "Each dot is a step length or a rate, the longest or slowest on the left. Pale bands: least and most CPU time of equal runs.",
    "A red cross is a run that failed, at the time it took until then; it has no error and stands at the top.",
];

/// All diagrams under each other.
pub(crate) fn draw(report: &Report, width: Width) -> Drawing {
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
    let width = width.px();
    let panels: Vec<Panel> = panels.into_iter().enumerate().map(|(i, panel)| panel.lettered(i)).collect();
    let notes: Vec<String> = NOTES.iter().flat_map(|note| wrapped(note, width - LINE)).collect();
    let height = panels.iter().map(|panel| panel.height(width, AXES)).sum::<f64>() + 10.0;
    let mut drawing = Drawing::new(width, height + LINE * count(notes.len()));
    let mut y = 6.0;
    for panel in &panels {
        let panel_height = panel.height(width, AXES);
        panel.draw(&mut drawing, [0.0, y], [width, panel_height]);
        y += panel_height;
    }
    for (i, note) in notes.iter().enumerate() {
        drawing.text([8.0, height + 6.0 + LINE * count(i)], moca_figures::Anchor::Start, note, BLACK);
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
    let place = panel(
        format!("{name}: error of the base's place after 1 s"),
        "largest [m]",
        scene.self_consistency_m,
        &|p| Some(p.place_error_m),
    );
    let angles = panel(
        format!("{name}: error of the angles of base and arm after 1 s"),
        "largest [rad]",
        scene.self_consistency_rad,
        &|p| Some(p.angle_error_rad),
    );
    let mut panels = vec![place, angles];
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lengths_angles_and_forces_have_diagrams_of_their_own() {
        let scene = plant::SceneReport {
            scene: "contact",
            reference: String::new(),
            self_consistency: 1e-6,
            self_consistency_m: 1e-7,
            self_consistency_rad: 1e-6,
            peak_self_consistency: Some(1e-6),
            points: Vec::new(),
            recommendation: String::new(),
            is_default: true,
        };
        let labels: Vec<String> = plant_panels(&scene).into_iter().map(|panel| panel.y_label).collect();
        assert_eq!(labels, ["largest [m]", "largest [rad]", "share of the force"]);
    }
}
