//! The closed loops whose figures are printed, each as its table runs it.

use super::{Figure, Scene, Step, Variation};
use crate::cover::{characterize, map};
use crate::numerics::{barrier, stability};
use crate::paper::push::{self, Outcome, Push};
use crate::paper::report::{collision_under_barrier, collision_with, with};
use crate::paper::{opposite_hands, pushes};
use crate::robustness::protection;
use anyhow::Result;
use moca_experiments::closed_loop::Rig;
use moca_experiments::collision;
use moca_experiments::settings::{Sensor, Settings};
use moca_msgs::Law;

/// Trials of Table I.
const TRIALS: usize = 10;
/// Cells of the campaign that are looked at.
const CAMPAIGN: usize = 12;
/// One in so many cells of the map of safe speeds.
const OF_MAP: usize = 12;

fn figure(item: &str, what: &'static str, digits: usize, value: f64) -> Figure {
    Figure { item: item.to_owned(), what, digits, value }
}

/// Function that makes the scenes of a group.
pub(super) type Scenes = fn() -> Result<Vec<Scene>>;

/// All that is printed, in the order of the documents.
pub(super) const GROUPS: &[(&str, Scenes)] = &[
    ("C, 100 Hz sensor", || collision_of(ideal(&[])?)),
    ("C with null-space damping", || collision_of(ideal(&["null_space_damping=true"])?)),
    ("C with a stock Touch Board", || collision_of(collision_with(Sensor::Stock))),
    ("C with the contact barrier", || collision_of(collision_under_barrier()?)),
    ("C without the cover", || collision_of(collision_with(Sensor::Off))),
    ("C at T2", || peak_of(ideal(&["person.taxel=T2"])?)),
    ("C at T3", || peak_of(ideal(&["person.taxel=T3"])?)),
    ("C at T4", || peak_of(ideal(&["person.taxel=T4"])?)),
    ("a person walks in", || collision_of(ideal(&["speed=0", "person.walk=0.2"])?)),
    ("B1", || Ok(vec![in_a_row(&with(Law::Impedance, Sensor::Ideal), pushes::pushes_b1())])),
    ("single pushes, with and without corrections", corrected),
    ("B2", || Ok(vec![in_a_row(&with(Law::FollowMe, Sensor::Ideal), pushes::pushes_b2())])),
    ("B2, observed", || {
        let observed = Settings { flange_observed: true, ..with(Law::FollowMe, Sensor::Ideal) };
        Ok(vec![in_a_row(&observed, pushes::pushes_b2())])
    }),
    ("B2-iii, hands that add up", sums),
    ("Table I", table_1),
    ("pushes, barrier off and on", || {
        Ok(pushes::under_barrier()?
            .into_iter()
            .map(|(settings, pushes)| in_a_row(&settings, pushes))
            .collect())
    }),
    ("hands that cancel", opposite),
    ("the loop in contact", contact),
    ("a leg of 50 N/mm at T6, barrier off", || Ok(hardest(barrier::before("T6", false)?))),
    ("a leg of 50 N/mm at T6, barrier on", || Ok(hardest(barrier::before("T6", true)?))),
    ("cells of the short table, barrier off", || Ok(met(protection::of_the_short_table(false)?))),
    ("cells of the short table, barrier on", || Ok(met(protection::of_the_short_table(true)?))),
    ("cells of the campaign, barrier on", || Ok(met(protection::of_the_campaign(CAMPAIGN)?))),
    ("the map of safe speeds, led at the law's", || Ok(hardest(map::at_the_law_s_speed(OF_MAP)?))),
];

impl Scene {
    /// A loop in these phases, the worst of which is printed.
    fn worst_of(
        phases: Vec<Settings>,
        figures: impl Fn(&Settings) -> Result<Vec<Figure>> + Send + Sync + 'static,
    ) -> Self {
        let seeds = phases.iter().any(|settings| settings.sensor == Sensor::Stock);
        let count =
            if phases.iter().any(|settings| settings.sensor == Sensor::Off) { 0 } else { phases.len() };
        let run = move |variation: Variation| figures(&varied(&phases[variation.phase], variation)?);
        Self { phases: count, worst: true, seeds, run: Box::new(run) }
    }

    /// A loop whose first of five phases is printed.
    fn first_of(
        settings: &Settings,
        figures: impl Fn(&Settings) -> Result<Vec<Figure>> + Send + Sync + 'static,
    ) -> Self {
        Self { worst: false, ..Self::worst_of(five_phases(settings), figures) }
    }
}

fn five_phases(settings: &Settings) -> Vec<Settings> {
    let at = |phase: &f64| {
        let mut settings = settings.clone();
        settings.shift_phase(*phase);
        settings
    };
    collision::PHASES.iter().map(at).collect()
}

fn varied(settings: &Settings, Variation { seed, step, .. }: Variation) -> Result<Settings> {
    let mut settings = settings.clone();
    settings.config.simulation.seed = settings.config.simulation.seed.wrapping_add(seed);
    // the engines agree to the last digits that are shown
    let limit = |step: &'static str| ["engine=analytic", "integrator=leapfrog", step];
    match step {
        Step::Printed => {}
        Step::Half => settings.step_ms *= 0.5,
        Step::Before => settings.set_all(limit("step_ms=0.25"))?,
        Step::Limit => settings.set_all(limit("step_ms=0.125"))?,
    }
    Ok(settings)
}

fn ideal(assignments: &[&str]) -> Result<Settings> {
    let mut settings = collision_with(Sensor::Ideal);
    settings.set_all(assignments)?;
    Ok(settings)
}

fn collision_of(settings: Settings) -> Result<Vec<Scene>> {
    settings.check()?;
    Ok(vec![Scene::worst_of(five_phases(&settings), |settings| collision_figures("", settings))])
}

fn peak_of(settings: Settings) -> Result<Vec<Scene>> {
    settings.check()?;
    Ok(vec![Scene::worst_of(five_phases(&settings), |settings| peak("", settings))])
}

fn peak(item: &str, settings: &Settings) -> Result<Vec<Figure>> {
    Ok(collision_figures(item, settings)?.drain(..1).collect())
}

fn collision_figures(item: &str, settings: &Settings) -> Result<Vec<Figure>> {
    let m = collision::single(settings)?.measures;
    let [x, y, yaw] = m.base_displacement;
    Ok(vec![
        figure(item, "peak force, N", 3, m.peak_force_n),
        figure(item, "in the first 0.1 s, N", 3, m.first_touch_n),
        figure(item, "in contact for, s", 3, m.contact_time_s),
        figure(item, "flange RMS, mm", 3, m.flange_rms_mm),
        figure(item, "flange at most, mm", 3, m.flange_max_mm),
        figure(item, "way of the base, mm", 2, 1e3 * x.hypot(y)),
        figure(item, "turn of the base, mrad", 2, 1e3 * yaw),
    ])
}

/// Adds the measured force as a figure if the sensor does not read the true one.
fn outcome_figures(outcome: &Outcome, settings: &Settings) -> Vec<Figure> {
    let [x, y, yaw] = outcome.base_displacement;
    let [fx, fy, fz] = outcome.flange_displacement;
    let item = &outcome.name;
    let mut figures = vec![
        figure(item, "way of the base, mm", 3, 1e3 * x.hypot(y)),
        figure(item, "turn of the base, mrad", 3, 1e3 * yaw),
        figure(item, "flange from its start, mm", 3, 1e3 * fx.hypot(fy).hypot(fz)),
        figure(item, "flange RMS, mm", 3, outcome.flange_rms_mm),
        figure(item, "flange at most, mm", 3, outcome.flange_max_mm),
    ];
    if settings.flange_observed {
        let [x, y, z] = outcome.flange_felt_n;
        figures.push(figure(item, "force felt at the flange, N", 3, x.hypot(y).hypot(z)));
    }
    if settings.sensor == Sensor::Stock {
        let [x, y, _] = outcome.wrench_sensed;
        figures.push(figure(item, "force felt on the cover, N", 3, x.hypot(y)));
    }
    figures
}

/// These pushes one after the other.
fn push_figures(settings: &Settings, pushes: &[Push]) -> Result<Vec<Figure>> {
    let mut rig = Rig::start(settings, &settings.free_scene())?;
    let outcomes = push::run(&mut rig, settings, pushes)?;
    Ok(outcomes.iter().flat_map(|outcome| outcome_figures(outcome, settings)).collect())
}

fn hardest(cells: Vec<(String, Vec<Settings>)>) -> Vec<Scene> {
    let scene = |(item, phases): (String, Vec<Settings>)| {
        Scene::worst_of(phases, move |settings| peak(&item, settings))
    };
    cells.into_iter().map(scene).collect()
}

fn in_a_row(settings: &Settings, pushes: [Push; 5]) -> Scene {
    Scene::first_of(settings, move |settings| push_figures(settings, &pushes))
}

fn corrected() -> Result<Vec<Scene>> {
    let mut corrected = Vec::new();
    for (law, assignments) in [
        ("literal", &[][..]),
        ("null-space damping", &["null_space_damping=true"]),
        ("null-space damping and coupling", &["null_space_damping=true", "base_coupling=true"]),
        ("feedforward", &["flange_wrench_feedforward=true"]),
    ] {
        let mut settings = with(Law::Impedance, Sensor::Ideal);
        settings.set_all(assignments)?;
        let sideways = Push::taxels("flange +y 15 N", &[]).and_flange([0.0, 15.0, 0.0]);
        for mut push in [push::single(&[0], 20.0), push::single(&[5], 20.0), sideways] {
            push.name = format!("{}, {law}", push.name);
            corrected.push(Scene::first_of(&settings, move |settings| {
                push_figures(settings, std::slice::from_ref(&push))
            }));
        }
    }
    Ok(corrected)
}

fn sums() -> Result<Vec<Scene>> {
    let names = ["hand on the cover", "hand at the flange", "both"];
    let scene = Scene::first_of(&with(Law::FollowMe, Sensor::Ideal), move |settings| {
        let speeds = pushes::superposition(settings)?;
        Ok(names.iter().zip(speeds).map(|(name, m_s)| figure(name, "largest speed, m/s", 5, m_s)).collect())
    });
    Ok(vec![scene])
}

/// Nothing moves there but the foam, and no sensor has a phase: steps are those of its creep between two samples.
fn table_1() -> Result<Vec<Scene>> {
    let run = |variation: Variation| {
        let finer = match variation.step {
            Step::Printed => 1,
            Step::Half => 2,
            Step::Before => 16,
            Step::Limit => 32,
        };
        let mut figures = Vec::new();
        for (foam, [deformation_mm, counts, line_n, counts_n]) in
            characterize::table_1(finer, TRIALS, 1 + variation.seed)?
        {
            figures.extend([
                figure(foam, "deformation, mm", 3, deformation_mm),
                figure(foam, "counts at 100 N", 2, counts),
                figure(foam, "RMSE of F(Δx), N", 4, line_n),
                figure(foam, "RMSE of F(Δs), N", 4, counts_n),
            ]);
        }
        Ok(figures)
    };
    Ok(vec![Scene { phases: 0, worst: false, seeds: true, run: Box::new(run) }])
}

fn opposite() -> Result<Vec<Scene>> {
    let mut opposite = Vec::new();
    for (cover, assignments) in opposite_hands::COVERS {
        for flange in ["flange=true", "flange=observed"] {
            let item = format!("{cover}, {flange}");
            let settings = opposite_hands::settings(assignments, flange)?;
            opposite.push(Scene::first_of(&settings, move |settings| {
                let felt = opposite_hands::felt(settings)?;
                let [x, y, _] = felt.outcome.base_displacement;
                Ok(vec![
                    figure(&item, "drift of the base, mm", 2, 1e3 * x.hypot(y)),
                    figure(&item, "hand on T6 felt as, N", 3, -felt.outcome.wrench_sensed[0]),
                    figure(&item, "does not cancel, N", 3, felt.uncancelled_n),
                ])
            }));
        }
    }
    Ok(opposite)
}

fn contact() -> Result<Vec<Scene>> {
    let scene = |(name, trial): (String, stability::Trial)| {
        Scene::first_of(&trial.settings.clone(), move |settings| {
            let case = stability::Trial { settings: settings.clone(), ..trial.clone() }.run(&name);
            let what = if case.bounded { "peak force, N" } else { "peak of one that swings on or stops, N" };
            Ok(vec![figure(&name, what, 2, case.peak_n)])
        })
    };
    Ok(stability::contact::trials()?.into_iter().map(scene).collect())
}

fn met(cells: Vec<protection::Printed>) -> Vec<Scene> {
    let scene = |cell: protection::Printed| {
        Scene::worst_of(cell.phases.clone(), move |settings| {
            let [peak_n, flange_mm] = cell.figures(settings)?;
            Ok(vec![
                figure(&cell.name, "peak force, N", 2, peak_n),
                figure(&cell.name, "flange at most, mm", 2, flange_mm),
            ])
        })
    };
    cells.into_iter().map(scene).collect()
}
