//! The work–precision diagrams.

use super::{Report, control, plant};
use moca_figures::{Drawing, Panel, Scale, Series};

const HEIGHT: f64 = 270.0;

/// All diagrams under each other.
pub(crate) fn draw(report: &Report) -> Drawing {
    let mut panels = Vec::new();
    for scene in &report.scenes {
        panels.extend(plant_panels(scene));
    }
    panels.push(rate_panel(&report.control_rate));
    panels.push(admittance_panel("smooth force", &report.admittance, |p| p.smooth_error_m_s));
    panels.push(admittance_panel("reading held for 120 ms", &report.admittance, |p| p.held_error_m_s));
    let points = report.calibration.iter().enumerate();
    let series = points.map(|(i, model)| Series::dots(i, model.model, vec![[model.cost_ns, model.rmse_n]]));
    panels.push(Panel {
        series: series.collect(),
        ..diagram("calibration models, PU LD30, trials not seen", "ns", "RMSE [N]")
    });
    let count = |n: usize| f64::from(u32::try_from(n).unwrap_or(u32::MAX));
    let mut drawing = Drawing::new(900.0, HEIGHT * count(panels.len()) + 10.0);
    for (i, panel) in panels.iter().enumerate() {
        panel.draw(&mut drawing, [0.0, HEIGHT * count(i) + 6.0], [900.0, HEIGHT]);
    }
    drawing
}

fn diagram(title: &str, x: &str, y: &str) -> Panel {
    Panel { x_scale: Scale::Log, y_scale: Scale::Log, ..Panel::new(title, x, y) }
}

fn plant_panels(scene: &plant::SceneReport) -> Vec<Panel> {
    let panel = |title: String, y: &str, level: f64, pick: &dyn Fn(&plant::Point) -> Option<f64>| {
        let curve = |(i, (_, method)): (usize, &(_, &'static str))| {
            let points = scene.points.iter().filter(|p| p.integrator == *method && p.failed.is_none());
            let points = points.filter_map(|p| Some([p.cpu_s_per_s, pick(p)?.max(1e-12)]));
            Series::dots(i, *method, points.collect())
        };
        let failed = scene.points.iter().filter(|p| p.failed.is_some());
        let failed = failed
            .map(|p| Series::failures(format!("{} {} ms fails", p.integrator, p.step_ms), [p.cpu_s_per_s]));
        Panel {
            series: plant::METHODS.iter().enumerate().map(curve).chain(failed).collect(),
            levels: vec![(level, "reference's own error")],
            ..diagram(&title, "CPU s per s", y)
        }
    };
    let name = scene.scene;
    let title = format!("{name} scene: error in state after 1 s");
    let mut panels = vec![panel(title, "m, rad", scene.self_consistency, &|p| Some(p.state_error))];
    if let Some(own) = scene.peak_self_consistency {
        panels.push(panel(format!("{name} scene: error in peak force"), "relative", own, &|p| p.peak_error));
    }
    panels
}

fn rate_panel(points: &[control::RatePoint]) -> Panel {
    let points = points.iter().filter(|p| p.base_error_mm > 0.0).map(|p| [p.cpu_s_per_s, p.base_error_mm]);
    Panel {
        series: vec![Series::dots(0, "100 to 2000 Hz", points.collect())],
        ..diagram("control rate: base against that at 4 kHz, T6 20 N", "CPU s per s", "mm")
    }
}

fn admittance_panel(
    input: &str,
    points: &[control::AdmittancePoint],
    pick: fn(&control::AdmittancePoint) -> f64,
) -> Panel {
    let curve = |(i, (method, _)): (usize, &(&'static str, _))| {
        let own = points.iter().filter(|p| p.method == *method && !p.failed);
        Series::dots(i, *method, own.map(|p| [p.cpu_s_per_s, pick(p).max(1e-16)]).collect())
    };
    let failed = points.iter().filter(|p| p.failed);
    let failed =
        failed.map(|p| Series::failures(format!("{} {} ms fails", p.method, p.step_ms), [p.cpu_s_per_s]));
    Panel {
        series: control::DISCRETISATIONS.iter().enumerate().map(curve).chain(failed).collect(),
        ..diagram(&format!("eq. (2), M/D = 10 ms, {input}"), "CPU s per s", "m/s")
    }
}
