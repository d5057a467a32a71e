//! Maps of peak force and swing over two parameters, with the contact stability law drawn over them.

use super::{Trial, trial};
use crate::picture::Width;
use crate::study::{self, Column};
use anyhow::Result;
use moca_experiments::count;
use moca_experiments::parallel;
use moca_experiments::settings::Settings;
use moca_figures::{Colour, Drawing, number};
use moca_wbc::contact_stability as theory;
use serde::Serialize;

/// Force at which foam and tissue are linearised, N.
const LINEARISED_AT_N: f64 = 20.0;
const CELL: [f64; 2] = [86.0, 40.0];
/// Width on a screen, and room to either side on paper, px.
const SCREEN: f64 = 760.0;
const MARGIN: f64 = 4.0;
/// Phases of the sensor, as shares of its period.
const PHASES: [f64; 3] = [0.0, 1.0 / 3.0, 2.0 / 3.0];

/// One parameter of a map: what `--set` is told for a value, label, values.
struct Axis {
    assignments: &'static str,
    label: &'static str,
    values: &'static [f64],
}

const DAMPING: Axis = Axis {
    assignments: "d_v={}",
    label: "virtual damping d_v [N·s/m]",
    values: &[20.0, 40.0, 80.0, 160.0, 320.0, 640.0, 1280.0],
};

/// File name, x, y.
const MAPS: [(&str, Axis, Axis); 3] = [
    (
        "period",
        Axis {
            assignments: "sensor.period_ms={}",
            label: "sensor period [ms]",
            values: &[1.0, 5.0, 10.0, 20.0, 33.0, 50.0, 100.0],
        },
        DAMPING,
    ),
    (
        "stiffness",
        Axis {
            assignments: "foam.scale=10000;person.stiffness={}",
            label: "contact stiffness [N/m]",
            values: &[1e2, 1e3, 3e3, 1e4, 1e5, 1e6, 1e7],
        },
        DAMPING,
    ),
    (
        "mass",
        Axis {
            assignments: "m_v={}",
            label: "virtual mass [kg]",
            values: &[0.01, 0.1, 1.0, 4.0, 10.0, 100.0, 1000.0],
        },
        Axis {
            assignments: "sensor.delay_ms={}",
            label: "delay [ms]",
            values: &[0.0, 5.0, 10.0, 20.0, 40.0, 70.0, 100.0],
        },
    ),
];

/// One map, y by y.
#[derive(Clone, Debug, Serialize)]
pub(crate) struct Map {
    pub name: &'static str,
    x: &'static str,
    y: &'static str,
    x_values: &'static [f64],
    y_values: &'static [f64],
    cells: Vec<Cell>,
}

#[derive(Clone, Copy, Debug, Serialize)]
struct Cell {
    x: f64,
    y: f64,
    /// Least and most of the sensor's phases.
    peak_n: [f64; 2],
    /// In every phase.
    bounded: bool,
    /// The robot stopped by itself in one of them.
    stopped: bool,
    /// Verdict of the contact stability law.
    theory_stable: bool,
}

/// Runs all maps.
pub(crate) fn all() -> Result<Vec<Map>> {
    MAPS.iter().map(|(name, x, y)| map(name, x, y)).collect()
}

fn map(name: &'static str, x: &'static Axis, y: &'static Axis) -> Result<Map> {
    let places: Vec<[f64; 2]> = y.values.iter().flat_map(|v| x.values.iter().map(|u| [*u, *v])).collect();
    let cells = parallel::run(&format!("map {name}"), &places, |[u, v]| cell(x, y, *u, *v))?;
    Ok(Map { name, x: x.label, y: y.label, x_values: x.values, y_values: y.values, cells })
}

fn cell(x: &Axis, y: &Axis, u: f64, v: f64) -> Result<Cell> {
    let assign = |axis: &Axis, value: f64| {
        axis.assignments.replace("{}", &value.to_string()).split(';').map(str::to_owned).collect::<Vec<_>>()
    };
    let trial = trial("ideal", &[assign(x, u), assign(y, v)].concat())?;
    let cases = PHASES.map(|phase| {
        let mut trial: Trial = trial.clone();
        trial.settings.shift_phase(phase);
        trial.run("")
    });
    let peaks = || cases.iter().map(|case| case.peak_n);
    Ok(Cell {
        x: u,
        y: v,
        peak_n: [peaks().fold(f64::INFINITY, f64::min), peaks().fold(0.0, f64::max)],
        bounded: cases.iter().all(|case| case.bounded),
        stopped: cases.iter().any(|case| case.stopped.is_some()),
        theory_stable: stable_in_theory(&trial.settings)?,
    })
}

const COLUMNS: &[Column<Map>] = &[
    ("map", |map| map.name.into()),
    ("cells with a touch", |map| map.touched().count().to_string()),
    ("bounded, the law says no", |map| {
        map.touched().filter(|cell| cell.bounded && !cell.theory_stable).count().to_string()
    }),
    ("not bounded, the law says yes", |map| map.touched().filter(|cell| cell.at_odds()).count().to_string()),
    ("these are", |map| {
        let named: Vec<String> =
            map.touched().filter(|cell| cell.at_odds()).map(|cell| cell.words(map)).collect();
        named.join("; ")
    }),
];

/// Lists the cells in which simulation and law disagree, map by map.
pub(crate) fn markdown() -> Result<String> {
    Ok(study::table(COLUMNS, &all()?))
}

impl Map {
    fn touched(&self) -> impl Iterator<Item = &Cell> {
        self.cells.iter().filter(|cell| cell.peak_n[1] > 0.0)
    }
}

impl Cell {
    /// The law calls it stable, and it is not.
    const fn at_odds(&self) -> bool {
        self.theory_stable && !self.bounded
    }

    fn words(&self, map: &Map) -> String {
        let stops = if self.stopped { ", stops" } else { "" };
        format!("{} {}, {} {}: {:.0} N{stops}", map.x, self.x, map.y, self.y, self.peak_n[1])
    }
}

/// The contact stability law for virtual mass and damping as the person's taxel feels them, foam and tissue linearised.
pub(crate) fn stable_in_theory(settings: &Settings) -> Result<bool> {
    let gains = &settings.config.control.gains;
    let taxel = &settings.config.robot.cover.placements()[settings.person.taxel];
    let foam = settings.true_foam();
    let foam_n_m = foam.stiffness_n_per_m(foam.deformation_m(LINEARISED_AT_N));
    let stiffness = 1.0 / (1.0 / foam_n_m + 1.0 / settings.person.tissue_stiffness());
    // The foam's damper acts for the share of the deformation that is the foam's.
    let damping = foam.damping_time_s * foam_n_m * (stiffness / foam_n_m).powi(2);
    let contact = theory::Contact {
        stiffness_n_m: stiffness,
        damping_n_s_m: damping,
        delay_s: theory::reading_delay_s(
            1e-3 * settings.config.simulation.truth.sensor.extra_age_ms,
            1e-3 * settings.period_ms(),
            1.0 / f64::from(settings.config.control_loop.rate_hz),
        ),
        servo_s: settings.config.robot.base.servo_time_constant_s,
    };
    let mass = theory::at_taxel(&gains.virtual_mass, taxel);
    let damping = theory::at_taxel(&gains.virtual_damping, taxel);
    Ok(theory::margin(mass, damping, &contact)?.stable)
}

/// The maps under each other.
pub(crate) fn draw(maps: &[Map], width: Width) -> Drawing {
    let fit_px = (width != Width::Screen).then(|| width.px() - 2.0 * MARGIN);
    let maps: Vec<moca_figures::Map> = maps.iter().map(|map| shown(map, fit_px)).collect();
    let height = maps.iter().map(|map| map.height(CELL)).fold(0.0, f64::max) + 20.0;
    let whole = if width == Width::Screen { SCREEN } else { width.px() };
    let mut drawing = Drawing::new(whole, height * count(maps.len()));
    let left = if width == Width::Screen { 14.0 } else { MARGIN };
    for (i, map) in maps.iter().enumerate() {
        map.draw(&mut drawing, [left, 10.0 + height * count(i)], CELL);
    }
    drawing
}

const SAFE: Colour = [190, 225, 190];
const HARD: Colour = [245, 225, 170];
const UNBOUNDED: Colour = [235, 165, 155];
const UNTOUCHED: Colour = [228, 228, 228];

fn shown(map: &Map, fit_px: Option<f64>) -> moca_figures::Map {
    let cells = map.cells.iter().map(|cell| {
        let [least, most] = cell.peak_n.map(|n| format!("{n:.0}"));
        let force = if least == most { most } else { format!("{least}–{most}") };
        let text = if cell.peak_n[1] > 0.0 { force } else { "–".into() };
        (colour(cell), if cell.stopped { format!("{text} stop") } else { text })
    });
    moca_figures::Map {
        title: "peak force [N], least and most of three phases of the sensor; the line is the boundary of the contact stability law"
            .into(),
        x_label: map.x.into(),
        y_label: map.y.into(),
        x: map.x_values.iter().map(|v| number(*v)).collect(),
        y: map.y_values.iter().map(|v| number(*v)).collect(),
        cells: cells.collect(),
        sides: map.cells.iter().map(|cell| cell.theory_stable).collect(),
        legend: vec![
            (SAFE, "bounded, below 25 N"),
            (HARD, "bounded, 25 to 150 N"),
            (UNBOUNDED, "above 150 N, swings on or stops"),
            (UNTOUCHED, "no touch"),
        ],
        fit_px,
    }
}

const fn colour(cell: &Cell) -> Colour {
    if cell.peak_n[1] <= 0.0 {
        return UNTOUCHED;
    }
    match (cell.bounded, cell.peak_n[1] < 25.0) {
        (true, true) => SAFE,
        (true, false) => HARD,
        (false, _) => UNBOUNDED,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::picture::Picture as _;

    #[test]
    fn maps_keep_every_width_with_texts_inside() {
        for (name, x, y) in &MAPS {
            let cell = |x, y, i: usize| Cell {
                x,
                y,
                peak_n: [[8.0, 8.0], [116.0, 1234.0]][i % 2],
                bounded: i.is_multiple_of(2),
                stopped: i.is_multiple_of(3),
                theory_stable: i.is_multiple_of(2),
            };
            let places = y.values.iter().flat_map(|v| x.values.iter().map(|u| (*u, *v))).enumerate();
            let cells = places.map(|(i, (u, v))| cell(u, v, i)).collect();
            let map = Map { name, x: x.label, y: y.label, x_values: x.values, y_values: y.values, cells };
            for width in [Width::Screen, Width::Single, Width::Double] {
                let drawing = draw(std::slice::from_ref(&map), width);
                assert_eq!(drawing.texts_outside().unwrap(), Vec::<String>::new(), "{name}, {width:?}");
                let wanted = if width == Width::Screen { SCREEN } else { width.px() };
                assert!((drawing.size()[0] - wanted).abs() < 1e-9, "{name}, {width:?}");
            }
        }
    }

    #[test]
    fn theory_and_simulation_agree_on_either_side_of_the_boundary() {
        for (period_ms, stable) in [(5.0, true), (33.0, false)] {
            let trial =
                trial("ideal", &["d_v=80".to_owned(), format!("sensor.period_ms={period_ms}")]).unwrap();
            assert_eq!(stable_in_theory(&trial.settings).unwrap(), stable, "theory, {period_ms} ms");
            let case = trial.run("");
            assert_eq!(case.bounded, stable, "{period_ms} ms: {case:?}");
        }
    }
}

/// All of them take a minute: the cells at odds with the law are run again.
#[cfg(test)]
#[test]
fn unsafe_cells_of_contact_law_match_table() {
    let Some(shown) = crate::docs::shown("stability-maps") else { return };
    let mut named = 0;
    for (name, x, y) in &MAPS {
        let row = shown.lines().find(|line| line.starts_with(&format!("| {name} |"))).unwrap();
        let map = Map { name, x: x.label, y: y.label, x_values: x.values, y_values: y.values, cells: vec![] };
        for words in
            row.split('|').nth(5).unwrap().split("; ").map(str::trim).filter(|words| !words.is_empty())
        {
            let value = |label: &str| -> f64 {
                let (_, rest) = words.split_once(&format!("{label} ")).unwrap();
                rest.split([',', ':']).next().unwrap().parse().unwrap()
            };
            let cell = cell(x, y, value(x.label), value(y.label)).unwrap();
            assert!(cell.at_odds(), "{words}");
            assert_eq!(cell.words(&map), words);
            named += 1;
        }
    }
    assert!(named > 0);
}
