//! `moca-lab stability`: the whole system at the stiff and extreme ends of its parameters.

pub(crate) mod contact;
pub(crate) mod maps;
mod single_precision;

use crate::picture::{Picture as _, Width};
use crate::study::{self, Answer, Column};
use anyhow::{Context, Result, ensure};
use moca_experiments::closed_loop::{Loads, Rig, Row};
use moca_experiments::collision;
use moca_experiments::cpu_time;
use moca_experiments::measure;
use moca_experiments::parallel;
use moca_experiments::settings::Settings;
use moca_msgs::Law;
use moca_msgs::robot::resized;
use moca_sim::{BodyPart, Mobility, Person};
use serde::Serialize;
use std::path::PathBuf;

/// Simulated time of one case, s.
const RUN_S: f64 = 6.0;
/// A swing of the force of this share in the last second of contact is an oscillation that lasts.
const LASTING_SWING: f64 = 0.5;
/// Largest force of a contact that counts as bounded, N: what a taxel can read.
const BOUNDED_N: f64 = 150.0;
/// Drift is what the base does from here on, s, in runs that are at least so long, s.
const SETTLED_S: f64 = 20.0;
const DRIFT_SEEN_S: f64 = 60.0;
/// The whole system at the stiff and extreme ends of its parameters.
#[derive(clap::Args)]
pub(crate) struct Arguments {
    #[command(flatten)]
    answer: Answer,
    /// Writes the maps (SVG, PNG) and the table (JSON) into this folder.
    #[arg(long, value_name = "DIR")]
    out: Option<PathBuf>,
    /// Width of the maps.
    #[arg(long, value_enum, default_value_t)]
    width: Width,
    /// Only the tables of the loop in contact: its rate, the age of what it feels, faults, what is not as described, cost.
    #[arg(long)]
    contact: bool,
    /// Sensor for all cases that do not set one: ideal (default) or stock.
    #[arg(long, default_value = "ideal")]
    sensor: String,
}

/// Result of one case.
#[derive(Clone, Debug, Serialize)]
pub(crate) struct Case {
    pub name: String,
    /// Every number finite, no MuJoCo warning, no stop.
    pub finite: bool,
    /// Anybody was touched at all.
    contact: bool,
    /// The contact force stays below [`BOUNDED_N`] and does not go on swinging.
    pub bounded: bool,
    pub peak_n: f64,
    /// Work of the cover on people less theirs on it, over the run, J.
    energy_out_j: f64,
    /// Work of the flange's moving reference over the run, J.
    reference_j: f64,
    /// Most by which the former exceeded the latter at any time, J: within the budget or not.
    excess_j: f64,
    within_budget: bool,
    cpu_s: f64,
    /// Simulated, the start included, s.
    sim_s: f64,
    /// Furthest that the base goes from where it is 20 s after the start, a radian counted as a metre, mm; null for runs
    /// that are shorter than a minute.
    drift_mm: Option<f64>,
    /// Why the robot stopped, if it did.
    pub stopped: Option<String>,
}

#[derive(Debug, Serialize)]
struct Report {
    budget: &'static str,
    cases: Vec<Case>,
    maps: Vec<maps::Map>,
}

/// Energy allowed on top of the reference's work: rounding, sampling and the foam's own memory, J.
const BUDGET_J: f64 = 1.0;
const BUDGET: &str = "at no time may the cover have given people more energy than they gave it, plus the work of the \
                      flange's moving reference (K_d e . v_d) up to then, plus 1 J";

/// Runs every case and the maps.
pub(crate) fn run(arguments: &Arguments) -> Result<()> {
    if arguments.contact {
        let cases = contact::cases()?;
        return arguments
            .answer
            .print(&cases, || Ok(format!("{}\n{}", table(&cases), contact::single_table()?)));
    }
    let cases = all_run(&cases(&arguments.sensor)?)?;
    let maps = maps::all()?;
    if let Some(folder) = &arguments.out {
        std::fs::create_dir_all(folder).with_context(|| format!("cannot create {}", folder.display()))?;
        for map in &maps {
            let drawing = maps::draw(std::slice::from_ref(map), arguments.width);
            let name = format!("stability-{}", map.name);
            drawing.write(&folder.join(name))?;
        }
    }
    let report = Report { budget: BUDGET, cases, maps };
    if let Some(folder) = &arguments.out {
        std::fs::write(folder.join("stability.json"), serde_json::to_string_pretty(&report)?)?;
    }
    arguments.answer.print(&report, || Ok(format!("{}\nbudget: {BUDGET}", table(&report.cases))))
}

/// One in `step` cases of the table, run.
pub(crate) fn one_in(step: usize) -> Result<Vec<Case>> {
    all_run(&cases("ideal")?.into_iter().step_by(step).collect::<Vec<_>>())
}

fn all_run(cases: &[(String, Trial)]) -> Result<Vec<Case>> {
    parallel::run("cases", cases, |(name, trial)| Ok(trial.run(name)))
}

impl Case {
    /// Returns true if the case shows a contact.
    pub(crate) const fn touched(&self) -> bool {
        self.contact || !self.finite
    }

    /// Which case stopped the robot, and the cause.
    pub(crate) fn stop(&self) -> Option<String> {
        let why = self.stopped.as_ref()?;
        Some(format!("{}: {}", self.name, why.split(':').next().unwrap_or(why)))
    }
}

/// Every case as a table in Markdown.
pub(crate) fn markdown() -> Result<String> {
    let cases = one_in(1)?;
    let listed = |names: Vec<String>| format!("{} ({})", names.len(), names.join(", "));
    let named = |pick: &dyn Fn(&&Case) -> bool| {
        listed(cases.iter().filter(pick).map(|case| case.name.clone()).collect())
    };
    let touched = |case: &&Case| case.touched();
    Ok(format!(
        "| of {} cases | |\n|---|---|\n| nobody was touched | {} |\n| bounded: below {BOUNDED_N} N, not swinging on | {} |\n\
         | not bounded | {} |\n| the robot stopped by itself | {} |\n\
         | bounded, but gave out more energy than the budget | {} |\n",
        cases.len(),
        named(&|case| !touched(case)),
        cases.iter().filter(|case| touched(case) && case.bounded).count(),
        named(&|case| touched(case) && !case.bounded),
        listed(cases.iter().filter_map(Case::stop).collect()),
        named(&|case| case.bounded && !case.within_budget),
    ))
}

const COLUMNS: &[Column<Case>] = &[
    ("case", |case| case.name.clone()),
    ("finite", |case| word(case.finite).into()),
    ("bounded", |case| if case.touched() { word(case.bounded).into() } else { "no touch".into() }),
    ("peak, N", |case| format!("{:.1}", case.peak_n)),
    ("out, J", |case| format!("{:.2}", case.energy_out_j)),
    ("reference, J", |case| format!("{:.2}", case.reference_j)),
    ("excess, J", |case| format!("{:.3}", case.excess_j)),
    ("budget", |case| if case.within_budget { "within".into() } else { "OVER".into() }),
    ("CPU, s", |case| format!("{:.2}", case.cpu_s)),
    ("stopped", |case| case.stopped.clone().unwrap_or_default()),
];

fn table(cases: &[Case]) -> String {
    let table = study::table(COLUMNS, cases);
    format!(
        "{table}bounded: below {BOUNDED_N} N and not swinging on; CPU: of the whole run, {RUN_S} s unless named\n"
    )
}

const fn word(yes: bool) -> &'static str {
    if yes { "yes" } else { "NO" }
}

/// One case: settings, and what they cannot say.
#[derive(Clone, Debug)]
pub(crate) struct Trial {
    pub settings: Settings,
    pub special: Special,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Special {
    None,
    /// A second person on the other side.
    BothSides,
    /// A wall close to the other side: the base cannot give way.
    Blocked,
    /// The arm starts stretched upwards.
    Upright,
    /// A fault of `mocad --inject` strikes when somebody is first touched.
    Fault(&'static str),
    /// The plant's state becomes NaN after one second.
    NotANumber,
}

impl Trial {
    pub(crate) fn run(&self, name: &str) -> Case {
        let (rig, cpu_s) = cpu_time::timed(|| self.simulate());
        match rig {
            Ok(rig) => judge(name, &self.settings, &rig, cpu_s),
            Err(error) => Case {
                name: name.to_owned(),
                finite: false,
                contact: false,
                bounded: false,
                peak_n: f64::NAN,
                energy_out_j: f64::NAN,
                reference_j: f64::NAN,
                excess_j: f64::NAN,
                within_budget: false,
                cpu_s,
                sim_s: f64::NAN,
                drift_mm: None,
                stopped: Some(format!("{error:#}")),
            },
        }
    }

    fn simulate(&self) -> Result<Rig> {
        let settings = &self.settings;
        let mut scene = settings.collision_scene()?;
        match self.special {
            Special::BothSides => {
                let mut opposite = Person::beside(&scene.cover, 7, settings.person.gap_m).context("no T8")?;
                if settings.person.fixed {
                    opposite.mobility = Mobility::Fixed;
                }
                scene.people.push(opposite);
            }
            Special::Blocked => {
                scene
                    .people
                    .push(Person::part(BodyPart::Wall, &scene.cover, 9, 0.005, 0.0).context("no T10")?);
            }
            Special::Upright => scene.arm_posture_rad = resized(&[0.0, 0.0, 0.0, -0.0699, 0.0, 0.0, 0.0]),
            Special::None | Special::NotANumber | Special::Fault(_) => {}
        }
        let mut rig = Rig::start(settings, &scene)?;
        rig.move_target(collision::towards_person(settings))?;
        if let Special::Fault(fault) = self.special {
            // at the very touch, when the peak is still to come
            while rig.rows.last().is_none_or(|row| row.total_force_n <= 0.0) && rig.stopped.is_none() {
                ensure!(rig.rows.len() < 10_000, "nobody was touched that {fault} could strike");
                rig.run_for(1e-3, |_| Loads::default())?;
            }
            let injection = format!("{fault}@{}", rig.sim_s).parse();
            rig.inject(&injection.map_err(|error: String| anyhow::anyhow!(error))?);
        }
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
    let [mut energy_out_j, mut reference_j, mut excess_j] = [0.0f64; 3];
    for pair in rows.windows(2) {
        let (out_w, reference_w) = (-power_w(&pair[0]), reference_w(pair, settings, dt_s));
        if out_w.is_finite() && reference_w.is_finite() {
            energy_out_j += out_w * dt_s;
            reference_j += reference_w * dt_s;
            excess_j = excess_j.max(energy_out_j - reference_j.max(0.0));
        }
    }
    Case {
        name: name.to_owned(),
        finite,
        contact: rows.iter().any(|row| row.total_force_n > 0.0),
        bounded: finite && measure::peak_force_n(rows) < BOUNDED_N && !swings_on(rows, dt_s),
        peak_n: measure::peak_force_n(rows),
        energy_out_j,
        reference_j,
        excess_j,
        within_budget: excess_j <= BUDGET_J,
        cpu_s,
        sim_s: rig.sim_s,
        drift_mm: drift_mm(rows),
        stopped: rig.stopped.clone(),
    }
}

fn drift_mm(rows: &[Row]) -> Option<f64> {
    let long = rows.last().is_some_and(|row| row.t_s > DRIFT_SEEN_S);
    let settled = rows.partition_point(|row| row.t_s < SETTLED_S);
    let start = rows.get(settled).filter(|_| long)?.base_pose_world;
    let away = |row: &Row| {
        let [x, y, yaw] = std::array::from_fn(|i| row.base_pose_world[i] - start[i]);
        f64::hypot(x, y).hypot(yaw)
    };
    Some(1e3 * rows[settled..].iter().map(away).fold(0.0, f64::max))
}

/// Power of the cover's contact forces on the base, W.
fn power_w(row: &Row) -> f64 {
    let [vx, vy, yaw_rate] = row.base_velocity_world;
    let (sin, cos) = row.base_pose_world[2].sin_cos();
    let [fx, fy, mz] = row.wrench_true;
    fx * (cos * vx + sin * vy) + fy * (-sin * vx + cos * vy) + mz * yaw_rate
}

/// Power of the impedance's spring on its moving reference, K_d e · v_d, W.
fn reference_w(pair: &[Row], settings: &Settings, dt_s: f64) -> f64 {
    let stiffness = settings.config.control.gains.stiffness;
    (0..3)
        .map(|axis| {
            let way_m = pair[1].flange_desired_world[axis] - pair[0].flange_desired_world[axis];
            stiffness[axis] * (pair[0].flange_desired_world[axis] - pair[0].flange_world[axis]) * way_m / dt_s
        })
        .sum()
}

/// Returns true if the force still swings down to zero in the last second of the first contact's time.
fn swings_on(rows: &[Row], dt_s: f64) -> bool {
    #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "rows of one second")]
    let second = (1.0 / dt_s) as usize;
    let Some(first) = rows.iter().position(|row| row.total_force_n > 0.0) else { return false };
    let last = rows.iter().rposition(|row| row.total_force_n > 0.0).unwrap_or(first);
    if last < first + 2 * second {
        return false;
    }
    let range = |rows: &[Row]| {
        rows.iter()
            .map(|row| row.total_force_n)
            .fold([f64::INFINITY, 0.0f64], |[l, h], f| [l.min(f), h.max(f)])
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
    settings.set_all(common.iter().chain(assignments))?;
    Ok(Trial { settings, special: Special::None })
}

/// Every axis from end to end, the rest as in the collision scene with a person who stays.
fn cases(sensor: &str) -> Result<Vec<(String, Trial)>> {
    ensure!(sensor == "ideal" || sensor == "stock", "--sensor {sensor} is not one of ideal, stock");
    let axes: [(&str, &str, &[f64]); 9] = [
        ("contact stiffness N/m", "foam.scale=10000;person.stiffness={}", &[1e2, 1e3, 1e4, 1e5, 1e6, 1e7]),
        ("person kg", "person.mass={}", &[1.0, 10.0, 75.0, 200.0]),
        ("flange m/s", "speed={}", &[0.05, 0.1, 0.2, 0.25]),
        ("person walks m/s", "speed=0;person.walk={}", &[0.05, 0.2, 0.5, 1.0, 2.0]),
        ("sensor period ms", "sensor.period_ms={}", &[1.0, 5.0, 10.0, 20.0, 33.0, 50.0, 100.0]),
        ("sensor delay ms", "sensor.delay_ms={}", &[0.0, 10.0, 20.0, 40.0, 100.0]),
        ("K_d N/m", "k_d={}", &[100.0, 800.0, 3000.0, 1e4, 1e5]),
        ("eta_b/eta_a", "eta_b={}", &[0.1, 0.3, 1.0, 3.0, 10.0, 100.0]),
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
    cases.push(("a wall".into(), plain(&["person.kind=wall"])?));
    cases.push(("person held against a wall".into(), plain(&["person.fixed=true"])?));
    cases.push((
        "person walks into the blocked robot".into(),
        Trial { special: Special::Blocked, ..plain(&["speed=0", "person.walk=0.2"])? },
    ));
    cases.push((
        "hard pillar".into(),
        plain(&["person.fixed=true", "person.radius=0.3", "foam.scale=1000", "person.stiffness=1e6"])?,
    ));
    for (name, special) in [
        ("people on both sides", Special::BothSides),
        ("base blocked by a wall on its other side", Special::Blocked),
        ("arm upright", Special::Upright),
        ("NaN in the plant", Special::NotANumber),
    ] {
        cases.push((name.into(), Trial { special, ..plain(&[])? }));
    }
    Ok(cases)
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
    fn energy_stays_in_budget_only_in_stable_contact() {
        for name in
            ["sensor period ms = 5", "base blocked by a wall on its other side", "people on both sides"]
        {
            let case = case(name);
            assert!(case.finite && case.bounded && case.within_budget && case.peak_n < 25.0, "{case:?}");
            assert!(case.contact && case.reference_j > 1.0, "{case:?}");
        }
        for name in ["contact stiffness N/m = 1000000", "eta_b/eta_a = 0.1"] {
            let case = case(name);
            assert!(case.finite && !case.bounded && !case.within_budget, "{case:?}");
        }
    }

    #[test]
    fn nan_or_fast_joint_stops_the_robot() {
        let broken = case("NaN in the plant");
        assert!(!broken.finite && broken.stopped.is_some(), "{broken:?}");
        // Joint 4 passes what a Panda's own controller allows.
        let upright = case("arm upright");
        assert!(upright.stopped.as_deref().is_some_and(|why| why.contains("joint-speed")), "{upright:?}");
    }
}
