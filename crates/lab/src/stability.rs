//! `moca-lab stability`: the whole system at the stiff and extreme ends of its parameters.

use crate::chart::{self, Map};
use crate::drawing::{Colour, Drawing};
use crate::experiment::rig::{Loads, Rig, Row};
use crate::experiment::settings::Settings;
use crate::experiment::{collision, measure};
use crate::parallel;
use anyhow::{Context, Result, ensure};
use moca_msgs::Law;
use moca_msgs::robot::PAPER_COVER;
use moca_sim::Person;
use moca_wbc::contact_stability as theory;
use serde::Serialize;
use std::path::PathBuf;
use std::time::Instant;

/// Simulated time of one case, s.
const RUN_S: f64 = 6.0;
/// Largest force with which the leash lets the flange's reference pull, times the way it can go in [`RUN_S`], is the
/// energy that may come out beside what was moving: N/m and m, see `moca_wbc::reference`.
const LEASH_M: f64 = 0.1;
/// A swing of the force of this share in the last second of contact is an oscillation that lasts.
const LASTING_SWING: f64 = 0.5;
const SENSOR_PERIODS_MS: [f64; 7] = [1.0, 5.0, 10.0, 20.0, 33.0, 50.0, 100.0];
const DAMPINGS: [f64; 7] = [20.0, 40.0, 80.0, 160.0, 320.0, 640.0, 1280.0];

/// Arguments of `moca-lab stability`.
#[derive(clap::Args)]
pub(crate) struct Arguments {
    /// Prints one JSON object.
    #[arg(long)]
    json: bool,
    /// Writes the map (SVG, PNG) and the table (JSON) into this folder.
    #[arg(long, value_name = "DIR")]
    out: Option<PathBuf>,
    /// Sensor for all cases that do not set one: ideal (default) or stock.
    #[arg(long, default_value = "ideal")]
    sensor: String,
}

/// What happened in one case.
#[derive(Clone, Debug, Serialize)]
pub(crate) struct Case {
    name: String,
    /// Every number finite, no MuJoCo warning, no stop.
    pub finite: bool,
    /// Anybody was touched at all.
    contact: bool,
    /// The contact force does not go on swinging.
    pub bounded: bool,
    peak_n: f64,
    /// Work that the cover did on people, less what they did on it, J.
    energy_out_j: f64,
    /// What may come out: see the text of the report.
    budget_j: f64,
    within_budget: bool,
    cpu_s: f64,
    /// Why the robot stopped, if it did.
    stopped: Option<String>,
}

#[derive(Debug, Serialize)]
struct Report {
    budget: &'static str,
    cases: Vec<Case>,
    map: Vec<Cell>,
}

#[derive(Clone, Copy, Debug, Serialize)]
struct Cell {
    sensor_period_ms: f64,
    d_v: f64,
    peak_n: f64,
    bounded: bool,
    /// The least damping that the contact stability law asks for at this period, N·s/m.
    theory_least_d_v: f64,
}

const BUDGET: &str = "energy out <= kinetic energy of robot and virtual mass at contact + leash force x way of the \
                      flange's reference + 1 J";

/// Runs every case and the map.
#[expect(clippy::print_stdout, reason = "the command's output")]
pub(crate) fn run(arguments: &Arguments) -> Result<()> {
    let cases = cases(&arguments.sensor)?;
    let cases = parallel::run("cases", &cases, |(name, trial)| trial.run(name), |_| ());
    let map = map()?;
    if let Some(folder) = &arguments.out {
        std::fs::create_dir_all(folder).with_context(|| format!("cannot create {}", folder.display()))?;
        let drawing = draw(&map);
        std::fs::write(folder.join("stability.svg"), drawing.svg())?;
        std::fs::write(folder.join("stability.png"), drawing.png()?)?;
    }
    let report = Report { budget: BUDGET, cases, map };
    let json = serde_json::to_string_pretty(&report)?;
    if let Some(folder) = &arguments.out {
        std::fs::write(folder.join("stability.json"), &json)?;
    }
    if arguments.json {
        println!("{json}");
    } else {
        println!("{}", text(&report));
    }
    Ok(())
}

/// The map alone, for a report that holds it.
pub(crate) fn map_figure() -> Result<Drawing> {
    Ok(draw(&map()?))
}

fn text(report: &Report) -> String {
    let mut lines = vec![format!(
        "{:44} {:>7} {:>8} {:>9} {:>9} {:>9} {:>7}",
        "case", "finite", "bounded", "peak N", "out J", "budget J", "CPU s"
    )];
    for case in &report.cases {
        lines.push(format!(
            "{:44} {:>7} {:>8} {:>9.1} {:>9.3} {:>8.1}{} {:>7.2} {}",
            case.name,
            word(case.finite),
            if case.contact || !case.finite { word(case.bounded) } else { "no touch" },
            case.peak_n,
            case.energy_out_j,
            case.budget_j,
            if case.within_budget { ' ' } else { '!' },
            case.cpu_s,
            case.stopped.as_deref().unwrap_or("")
        ));
    }
    lines.push(format!("budget: {}", report.budget));
    lines.join("\n")
}

const fn word(yes: bool) -> &'static str {
    if yes { "yes" } else { "NO" }
}

/// One case: settings, and what they cannot say.
#[derive(Clone, Debug)]
struct Trial {
    settings: Settings,
    special: Special,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Special {
    None,
    /// A second person on the other side.
    BothSides,
    /// The arm starts stretched upwards.
    Upright,
    /// The plant's state becomes NaN after one second.
    NotANumber,
}

impl Trial {
    fn run(&self, name: &str) -> Case {
        let started = Instant::now();
        match self.simulate() {
            Ok(rig) => judge(name, &self.settings, &rig, started.elapsed().as_secs_f64()),
            Err(error) => Case {
                name: name.to_owned(),
                finite: false,
                contact: false,
                bounded: false,
                peak_n: f64::NAN,
                energy_out_j: f64::NAN,
                budget_j: f64::NAN,
                within_budget: false,
                cpu_s: started.elapsed().as_secs_f64(),
                stopped: Some(format!("{error:#}")),
            },
        }
    }

    fn simulate(&self) -> Result<Rig> {
        let settings = &self.settings;
        let mut scene = settings.collision_scene()?;
        match self.special {
            Special::BothSides => {
                let opposite = Person::beside(7, settings.person.gap_m).context("no T8")?;
                scene.people.push(opposite);
            }
            Special::Upright => scene.arm_posture_rad = [0.0, 0.0, 0.0, -0.0699, 0.0, 0.0, 0.0],
            Special::None | Special::NotANumber => {}
        }
        let mut rig = Rig::start(settings, &scene)?;
        rig.move_target([0.0, settings.speed_m_s, 0.0])?;
        if self.special == Special::NotANumber {
            rig.run_for(1.0, |_| Loads::default())?;
            rig.break_state();
        }
        rig.run_for(settings.duration_s, |_| Loads::default())?;
        Ok(rig)
    }
}

/// Judges a run by its trace.
fn judge(name: &str, settings: &Settings, rig: &Rig, cpu_s: f64) -> Case {
    let rows = &rig.rows;
    let dt_s = 1.0 / f64::from(settings.config.control_loop.rate_hz);
    let finite = rig.stopped.is_none()
        && rows.iter().all(|row| row.base_pose_world.iter().chain(&row.q_rad).all(|v| v.is_finite()));
    let mut energy_out_j = 0.0;
    let mut moving_j: f64 = 0.0;
    for row in rows {
        let power_in = power_w(row);
        if power_in.is_finite() {
            energy_out_j -= power_in * dt_s;
        }
        moving_j = moving_j.max(kinetic_j(row, settings));
    }
    let stiffness = settings.config.control.gains.stiffness[0];
    let way_m = settings.speed_m_s * settings.duration_s;
    let budget_j = moving_j + stiffness * LEASH_M * way_m + 1.0;
    Case {
        name: name.to_owned(),
        finite,
        contact: rows.iter().any(|row| row.total_force_n() > 0.0),
        bounded: finite && !swings_on(rows, dt_s),
        peak_n: measure::peak_force_n(rows),
        energy_out_j,
        budget_j,
        within_budget: energy_out_j <= budget_j,
        cpu_s,
        stopped: rig.stopped.clone(),
    }
}

/// Power of the cover's contact forces on the base, W.
fn power_w(row: &Row) -> f64 {
    let [vx, vy, yaw_rate] = row.base_velocity_world;
    let (sin, cos) = row.base_pose_world[2].sin_cos();
    let [fx, fy, mz] = row.wrench_true;
    fx * (cos * vx + sin * vy) + fy * (-sin * vx + cos * vy) + mz * yaw_rate
}

/// Robot (as one body about its base) and virtual mass, J.
fn kinetic_j(row: &Row, settings: &Settings) -> f64 {
    let [vx, vy, yaw_rate] = row.base_velocity_world;
    let [mx, my, inertia] = settings.config.control.gains.virtual_mass;
    let robot_kg = moca_msgs::robot::SUMMIT_XL.mass_kg + 17.0;
    0.5 * ((robot_kg + mx) * vx * vx + (robot_kg + my) * vy * vy + (20.0 + inertia) * yaw_rate * yaw_rate)
}

/// Whether the force still swings between nothing and itself in the last second of the first contact's time.
fn swings_on(rows: &[Row], dt_s: f64) -> bool {
    #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "rows of one second")]
    let second = (1.0 / dt_s) as usize;
    let Some(first) = rows.iter().position(|row| row.total_force_n() > 0.0) else { return false };
    let last = rows.iter().rposition(|row| row.total_force_n() > 0.0).unwrap_or(first);
    if last < first + 2 * second {
        return false;
    }
    let range = |rows: &[Row]| {
        rows.iter().map(Row::total_force_n).fold([f64::INFINITY, 0.0f64], |[l, h], f| [l.min(f), h.max(f)])
    };
    let [early_low, early_high] = range(&rows[first..first + second]);
    let [late_low, late_high] = range(&rows[last - second..last]);
    // A shrinking or a settled swing is bounded; one that keeps its size and lets go of the person again and again is not.
    late_high - late_low > LASTING_SWING * (early_high - early_low).max(1.0) && late_high > 2.0
}

fn trial(sensor: &str, assignments: &[String]) -> Result<Trial> {
    let mut settings = Settings::paper(Law::Impedance);
    collision::defaults(&mut settings);
    let common = [
        format!("sensor={sensor}"),
        "person.gap=0.1".into(),
        format!("duration={RUN_S}"),
        "person.steps_away_s=100".into(),
    ];
    for assignment in common.iter().chain(assignments) {
        settings.set(assignment)?;
    }
    Ok(Trial { settings, special: Special::None })
}

/// Every axis from end to end, the rest as in the collision scene with a person who stays.
fn cases(sensor: &str) -> Result<Vec<(String, Trial)>> {
    ensure!(sensor == "ideal" || sensor == "stock", "--sensor {sensor} is not one of ideal, stock");
    let axes: [(&str, &str, &[f64]); 9] = [
        ("contact stiffness N/m", "foam.scale=10000;person.stiffness={}", &[1e2, 1e3, 1e4, 1e5, 1e6, 1e7]),
        ("person kg", "person.mass={}", &[1.0, 10.0, 75.0, 200.0]),
        ("flange m/s", "speed={}", &[0.05, 0.1, 0.2, 0.25]),
        ("person walks m/s", "speed=0;person.gap=0.5;person.walk={}", &[0.05, 0.2, 0.5, 1.0, 2.0]),
        ("sensor period ms", "sensor.period_ms={}", &SENSOR_PERIODS_MS),
        ("sensor delay ms", "sensor.delay_ms={}", &[0.0, 10.0, 20.0, 40.0, 100.0]),
        ("K_d N/m", "k_d={}", &[100.0, 800.0, 3000.0, 1e4, 1e5]),
        ("eta_b", "eta_b={}", &[0.1, 0.3, 1.0, 3.0, 10.0, 100.0]),
        ("virtual mass kg", "m_v={}", &[0.01, 0.1, 1.0, 4.0, 10.0, 100.0, 1000.0]),
    ];
    let mut cases = Vec::new();
    for (name, template, values) in axes {
        for value in values {
            let text = template.replace("{}", &value.to_string());
            let assignments: Vec<String> = text.split(';').map(str::to_owned).collect();
            cases.push((format!("{name} = {value}"), trial(sensor, &assignments)?));
        }
    }
    for (step_ms, rate_hz) in
        [(0.05, 1000), (0.1, 1000), (0.5, 1000), (1.0, 1000), (2.0, 500), (5.0, 200), (10.0, 100)]
    {
        let assignments =
            [format!("step_ms={step_ms}"), format!("rate_hz={rate_hz}"), "sensor.period_ms=10".into()];
        cases.push((format!("step ms = {step_ms} at {rate_hz} Hz"), trial(sensor, &assignments)?));
    }
    let plain = |assignments: &[&str]| {
        trial(sensor, &assignments.iter().map(|a| (*a).to_owned()).collect::<Vec<_>>())
    };
    cases.push(("foam bottoms out".into(), plain(&["foam.scale=0.05"])?));
    cases.push(("person held against a wall".into(), plain(&["person.fixed=true"])?));
    cases.push((
        "hard pillar".into(),
        plain(&["person.fixed=true", "person.radius=0.3", "foam.scale=1000", "person.stiffness=1e6"])?,
    ));
    for (name, special) in [
        ("people on both sides", Special::BothSides),
        ("arm upright", Special::Upright),
        ("NaN in the plant", Special::NotANumber),
    ] {
        cases.push((name.into(), Trial { special, ..plain(&[])? }));
    }
    Ok(cases)
}

/// Peak force and swing over sensor period and virtual damping, with the least damping of the theory.
fn map() -> Result<Vec<Cell>> {
    let mut inputs = Vec::new();
    for d_v in DAMPINGS {
        for period_ms in SENSOR_PERIODS_MS {
            let assignments = [format!("d_v={d_v}"), format!("sensor.period_ms={period_ms}")];
            inputs.push((period_ms, d_v, trial("ideal", &assignments)?));
        }
    }
    let cells = parallel::run("map", &inputs, |(_, _, trial)| trial.run(""), |_| ());
    inputs
        .iter()
        .zip(cells)
        .map(|((period_ms, d_v, trial), case)| {
            Ok(Cell {
                sensor_period_ms: *period_ms,
                d_v: *d_v,
                peak_n: case.peak_n,
                bounded: case.bounded,
                theory_least_d_v: least_linear_damping(*period_ms, &trial.settings)?,
            })
        })
        .collect()
}

/// The linear virtual damping at which T1 just reaches the least damping of the contact law, N·s/m; NaN if its lever arm
/// alone lets it give way too easily for any.
fn least_linear_damping(period_ms: f64, settings: &Settings) -> Result<f64> {
    let gains = &settings.config.control.gains;
    let taxel = &PAPER_COVER[settings.person.taxel];
    let stiffness = 1.0
        / (1.0 / settings.foam.stiffness_n_per_m(settings.foam.deformation_m(20.0))
            + 1.0 / settings.person.tissue_stiffness());
    let contact = theory::Contact {
        stiffness_n_m: stiffness,
        damping_n_s_m: 0.005 * stiffness,
        delay_s: theory::reading_delay_s(0.0, 1e-3 * period_ms, 1e-3),
        servo_s: moca_msgs::robot::SUMMIT_XL.servo_time_constant_s,
    };
    let mass = theory::at_taxel(&gains.virtual_mass, taxel);
    let least = theory::least_damping(mass, &contact)?;
    let arm = taxel.position_base_m[0];
    let yaw = arm * arm / gains.virtual_damping[2];
    let rest = 1.0 / least - yaw;
    Ok(if rest > 0.0 { 1.0 / rest } else { f64::NAN })
}

fn draw(cells: &[Cell]) -> Drawing {
    let mut drawing = Drawing::new(760.0, 400.0);
    let shown = cells
        .iter()
        .map(|cell| {
            (colour(cell), if cell.peak_n > 0.0 { format!("{:.0}", cell.peak_n) } else { "none".into() })
        })
        .collect();
    let boundary = SENSOR_PERIODS_MS
        .iter()
        .enumerate()
        .filter_map(|(column, period)| {
            let cell = cells.iter().find(|cell| (cell.sensor_period_ms - period).abs() < 1e-9)?;
            let rows = (cell.theory_least_d_v / DAMPINGS[0]).log2();
            let column = f64::from(u32::try_from(column).ok()?);
            rows.is_finite().then_some([column, rows.clamp(-0.5, 6.5)])
        })
        .collect();
    Map {
        title: "peak force [N] on a person; red: it goes on swinging; line: contact stability law".into(),
        x_label: "sensor period [ms]".into(),
        y_label: "d_v [N.s/m]".into(),
        x: SENSOR_PERIODS_MS.iter().map(|v| chart::number(*v)).collect(),
        y: DAMPINGS.iter().map(|v| chart::number(*v)).collect(),
        cells: shown,
        boundary,
    }
    .draw(&mut drawing, [20.0, 20.0], [86.0, 40.0]);
    drawing
}

fn colour(cell: &Cell) -> Colour {
    match (cell.bounded, cell.peak_n < 25.0) {
        (true, true) => [190, 225, 190],
        (true, false) => [245, 225, 170],
        (false, _) => [235, 165, 155],
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn case(name: &str) -> Case {
        let cases = cases("ideal").unwrap();
        let (name, trial) = cases.iter().find(|(n, _)| n == name).unwrap();
        trial.run(name)
    }

    #[test]
    fn a_fast_sensor_is_bounded_and_a_slow_one_swings() {
        let fast = case("sensor period ms = 5");
        assert!(fast.finite && fast.bounded && fast.within_budget, "{fast:?}");
        let slow = case("sensor period ms = 100");
        assert!(slow.finite && !slow.bounded && slow.peak_n > 2.0 * fast.peak_n, "{slow:?}");
    }

    #[test]
    fn nan_in_the_plant_stops_the_robot_and_nothing_else_does() {
        let broken = case("NaN in the plant");
        assert!(!broken.finite && broken.stopped.is_some(), "{broken:?}");
        assert!(case("arm upright").stopped.is_none());
    }
}
