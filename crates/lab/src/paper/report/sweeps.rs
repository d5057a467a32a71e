//! The collision's peak force against one parameter at a time, ideal sensor and stock board.

use super::collision_with;
use crate::numerics::stability::maps::stable_in_theory;
use anyhow::Result;
use moca_experiments::collision;
use moca_experiments::parallel;
use moca_experiments::settings::{Sensor, Settings};
use moca_figures::{Drawing, Panel, Scale, Series};

/// Largest force that the paper calls safe, N.
const SAFE_N: f64 = 25.0;
const HEIGHT: f64 = 190.0;

/// A parameter against which the collision's peak force is shown.
struct Axis {
    key: &'static str,
    label: &'static str,
    scale: Scale,
    values: &'static [f64],
}

const fn axis(key: &'static str, label: &'static str, scale: Scale, values: &'static [f64]) -> Axis {
    Axis { key, label, scale, values }
}

const AXES: [Axis; 9] = [
    axis("speed", "flange speed [m/s]", Scale::Linear, &[0.05, 0.1, 0.15, 0.2, 0.25]),
    axis("person.mass", "person [kg]", Scale::Log, &[1.0, 5.0, 20.0, 75.0, 200.0]),
    axis("person.stiffness", "tissue [N/m]", Scale::Log, &[1e3, 5e3, 2.5e4, 1e5, 1e6]),
    axis("foam.scale", "foam stiffness, 1 is ours", Scale::Log, &[0.25, 0.5, 1.0, 2.0, 4.0]),
    axis("m_v", "virtual mass [kg]", Scale::Log, &[0.1, 0.5, 1.0, 2.0, 4.0, 8.0, 16.0, 32.0, 100.0]),
    axis("d_v", "virtual damping [N·s/m]", Scale::Log, &[20.0, 40.0, 80.0, 160.0, 320.0]),
    axis("sensor.period_ms", "sensor period [ms]", Scale::Log, &[1.0, 5.0, 10.0, 20.0, 33.0, 50.0, 100.0]),
    axis("sensor.delay_ms", "sensor age [ms]", Scale::Linear, &[0.0, 5.0, 10.0, 20.0, 40.0]),
    axis("person.taxel", "taxel", Scale::Linear, &[1.0, 2.0, 3.0, 4.0]),
];

fn settings(sensor: Sensor, axis: &Axis, value: f64) -> Result<Settings> {
    let mut settings = collision_with(sensor);
    let own = format!("{}={value}", axis.key);
    settings.set_all(["person.gap=0.1", "duration=6", "person.steps_away_s=100", &own])?;
    Ok(settings)
}

/// One panel for each axis.
pub(super) fn draw() -> Result<Drawing> {
    let mut inputs = Vec::new();
    for (panel, axis) in AXES.iter().enumerate() {
        for sensor in [Sensor::Ideal, Sensor::Stock] {
            if sensor == Sensor::Stock && axis.key.starts_with("sensor.") {
                continue;
            }
            for &value in axis.values {
                inputs.push((panel, sensor, value, settings(sensor, axis, value)?));
            }
        }
    }
    let report = |(.., settings): &(usize, Sensor, f64, Settings)| Ok(collision::run(settings)?.report);
    let reports = parallel::run("collisions", &inputs, report)?;
    let mut points = vec![[Vec::new(), Vec::new()]; AXES.len()];
    let mut stops = vec![[Vec::new(), Vec::new()]; AXES.len()];
    for ((panel, sensor, value, _), report) in inputs.iter().zip(reports) {
        let board = usize::from(*sensor == Sensor::Stock);
        let peaks = || report.peak_by_phase_n.iter().copied();
        let [least, most] = [peaks().fold(f64::INFINITY, f64::min), peaks().fold(0.0, f64::max)];
        if most > 0.0 {
            points[*panel][board].push([*value, least, most]);
        }
        if report.stopped().is_some() {
            stops[*panel][board].push(*value);
        }
    }
    let mut drawing = Drawing::new(900.0, HEIGHT * 9.0 + 20.0);
    let mut top = 10.0;
    for ((axis, [ideal, stock]), stops) in AXES.iter().zip(points).zip(stops) {
        let line = |i, name, points: Vec<[f64; 3]>| {
            let end = |which: usize| points.iter().map(move |point| [point[0], point[which]]);
            Series::dots(i, name, end(2).collect()).between(end(1).collect(), end(2))
        };
        let mut series = vec![line(0, "ideal, 100 Hz", ideal)];
        if !stock.is_empty() {
            series.push(line(1, "stock board", stock));
        }
        for (name, stops) in ["ideal: stops", "stock board: stops"].into_iter().zip(stops) {
            if !stops.is_empty() {
                series.push(Series::failures(name, stops));
            }
        }
        let boundaries = theory_boundaries(axis)?;
        if !boundaries.is_empty() {
            series.push(Series::marks("theory's boundary"));
        }
        Panel {
            x_scale: axis.scale,
            y_scale: Scale::Log,
            series,
            marks: boundaries,
            levels: vec![(SAFE_N, "UNSAFE above 25 N")],
            ..Panel::new(
                "worst of five phases of the sensor, band down to the least; a cross: the robot stops",
                axis.label,
                "peak force [N]",
            )
        }
        .draw(&mut drawing, [0.0, top], [900.0, HEIGHT]);
        top += HEIGHT;
    }
    Ok(drawing)
}

/// Returns the places along an axis where the contact stability law changes its verdict.
fn theory_boundaries(axis: &Axis) -> Result<Vec<f64>> {
    const STEPS: u32 = 20;
    if axis.key == "person.taxel" {
        return Ok(Vec::new());
    }
    let mut boundaries = Vec::new();
    let mut before: Option<(f64, bool)> = None;
    for pair in axis.values.windows(2) {
        for step in 0..=STEPS {
            let share = f64::from(step) / f64::from(STEPS);
            let value = match axis.scale {
                Scale::Linear => pair[0] + share * (pair[1] - pair[0]),
                Scale::Log => pair[0] * (pair[1] / pair[0]).powf(share),
            };
            let stable = stable_in_theory(&settings(Sensor::Ideal, axis, value)?)?;
            if let Some((last, was)) = before
                && was != stable
            {
                boundaries.push(0.5 * (last + value));
            }
            before = Some((value, stable));
        }
    }
    Ok(boundaries)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sweep_axes_name_existing_keys_and_boundary() {
        for axis in &AXES {
            for value in axis.values {
                settings(Sensor::Ideal, axis, *value).unwrap();
            }
        }
        let period = AXES.iter().find(|axis| axis.key == "sensor.period_ms").unwrap();
        let boundaries = theory_boundaries(period).unwrap();
        assert!(boundaries.len() == 1 && (5.0..20.0).contains(&boundaries[0]), "{boundaries:?}");
    }
}
