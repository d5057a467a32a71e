//! `moca-lab economy`: what a scene costs when it holds everything, and when it holds only what it needs.

mod parts;

use crate::study::{self, Answer, Column};
use anyhow::Result;
use moca_experiments::JOINTS;
use moca_experiments::closed_loop::armed;
use moca_experiments::collision;
use moca_experiments::cpu_time;
use moca_experiments::free_scene;
use moca_experiments::parallel::Count;
use moca_experiments::settings::Settings;
use moca_experiments::timed::loop_tick;
use moca_lockstep::LockStep;
use moca_msgs::robot::PANDA;
use moca_msgs::{Actuation, Law, RobotCommand};
use moca_sim::{Engine, ModelSize, Robot, Scene, SimPlant};
use serde::Serialize;
use std::time::Instant;

/// Ticks of the trajectories that are compared and timed.
const TICKS: usize = 1500;
/// Passes of which the fastest counts.
const PASSES: usize = 5;

/// Prints the cost of a scene with everything in it and with only what it needs.
#[derive(clap::Args)]
pub(crate) struct Arguments {
    #[command(flatten)]
    answer: Answer,
}

/// One scene beside the one that a user of MuJoCo would write.
#[derive(Clone, Debug, Serialize)]
struct Row {
    scene: &'static str,
    left_out: &'static str,
    /// Engine that integrates, and the reason for it.
    engine: &'static str,
    #[serde(flatten)]
    size: Size,
    start_up_ms: f64,
    step_us: f64,
    /// Cost of a step over the first scene's.
    of_geoms: f64,
    /// Largest difference from its reference over the run: base m and rad, arm rad.
    difference: f64,
    /// Largest allowed difference, and the reason for it.
    tolerance: f64,
    because: &'static str,
    agrees: bool,
}

#[derive(Clone, Copy, Debug, Serialize)]
struct Size {
    dofs: usize,
    bodies: usize,
    geoms: usize,
    sensors: usize,
    model_bytes: usize,
    data_bytes: usize,
}

impl From<ModelSize> for Size {
    fn from(m: ModelSize) -> Self {
        Self {
            dofs: m.dofs,
            bodies: m.bodies,
            geoms: m.geoms,
            sensors: m.sensors,
            model_bytes: m.model_bytes,
            data_bytes: m.data_bytes,
        }
    }
}

#[derive(Debug, Serialize)]
struct Report {
    scenes: Vec<Row>,
    ticks: Vec<TickCost>,
    control: parts::ControlCost,
}

/// Plant, board's bytes, reader and controller in one tick, and the bare step of the same model.
#[derive(Debug, Serialize)]
struct TickCost {
    scene: &'static str,
    bare_step_us: f64,
    whole_tick_us: f64,
    on_top_us: f64,
    /// Share of the whole tick.
    on_top_share: f64,
}

impl TickCost {
    fn of(name: &'static str, scene: &Scene) -> Result<Self> {
        let bare_step_us = bare_step_us(scene)?;
        let whole_tick_us = whole_tick_us(scene)?;
        let on_top_us = whole_tick_us - bare_step_us;
        let on_top_share = on_top_us / whole_tick_us;
        Ok(Self { scene: name, bare_step_us, whole_tick_us, on_top_us, on_top_share })
    }
}

/// Builds, runs, compares and times every scene.
pub(crate) fn run(arguments: &Arguments) -> Result<()> {
    let report = measure()?;
    arguments.answer.print(&report, || {
        let Report { scenes, ticks, control } = &report;
        let [scenes, parts] = [COSTS, PARTS].map(|columns| study::table(columns, scenes));
        let ticks = study::table(TICK_COSTS, ticks);
        Ok(format!("{scenes}\n{parts}\n{ticks}a tick: plant, bytes, reader, control\n\n{control}"))
    })
}

const COSTS: &[Column<Row>] = &[
    ("scene", |row| row.scene.into()),
    ("dofs", |row| row.size.dofs.to_string()),
    ("geoms", |row| row.size.geoms.to_string()),
    ("sensors", |row| row.size.sensors.to_string()),
    ("model, kB", |row| (row.size.model_bytes / 1024).to_string()),
    ("data, kB", |row| (row.size.data_bytes / 1024).to_string()),
    ("start, ms", |row| format!("{:.2}", row.start_up_ms)),
    ("step, µs", |row| format!("{:.2}", row.step_us)),
    ("of geoms", |row| format!("{:.2}", row.of_geoms)),
];

const PARTS: &[Column<Row>] = &[
    ("scene", |row| row.scene.into()),
    ("agrees", |row| if row.agrees { "yes".into() } else { "NO".into() }),
    ("differs by", |row| format!("{:.1e}", row.difference)),
    ("allowed", |row| format!("{:.0e}: {}", row.tolerance, row.because)),
    ("left out", |row| row.left_out.into()),
    ("engine", |row| row.engine.into()),
];

const TICK_COSTS: &[Column<TickCost>] = &[
    ("scene", |tick| tick.scene.into()),
    ("whole simulated tick, µs", |tick| format!("{:.2}", tick.whole_tick_us)),
    ("bare step, µs", |tick| format!("{:.2}", tick.bare_step_us)),
    ("on top, µs", |tick| format!("{:.2}", tick.on_top_us)),
    ("on top, %", |tick| format!("{:.0}", 100.0 * tick.on_top_share)),
];

/// The collision as a user of MuJoCo would write it: see scenes/geoms.toml.
fn with_geoms() -> Result<Scene> {
    let mut settings = Settings::paper(Law::Impedance);
    collision::defaults(&mut settings);
    for line in include_str!("../../../../../scenes/geoms.toml").lines().map(str::trim) {
        if let (false, Some((key, value))) = (line.starts_with('#'), line.split_once('=')) {
            let bare = |text: &str| text.trim().trim_matches('"').to_owned();
            settings.set(&format!("{}={}", bare(key), bare(value)))?;
        }
    }
    Ok(Scene { geoms: true, ..settings.collision_scene()? })
}

/// A scene, what it leaves out, and what its trajectory is compared with.
struct Case<'a> {
    name: &'static str,
    left_out: &'static str,
    scene: &'a Scene,
    reference: &'a Scene,
    /// Contacts are of another kind than the reference's: compared until the first.
    until_touch: bool,
    tolerance: f64,
    because: &'static str,
}

const SAME: (f64, &str) = (0.0, "nothing numerical differs");
/// Difference that rounding leaves over a run.
pub(crate) const ROUNDED: (f64, &str) = (1e-9, "rounding: the same step by another model");

fn measure() -> Result<Report> {
    let (scenes, ticks) = scenes(true)?;
    let control = parts::measure(&Settings::paper(Law::Impedance).config)?;
    Ok(Report { scenes, ticks, control })
}

/// Every scene beside its reference, and its whole ticks if they are to be `timed`.
fn scenes(timed: bool) -> Result<(Vec<Row>, Vec<TickCost>)> {
    let analytic = |scene: &Scene| Scene { engine: Engine::Analytic, ..scene.clone() };
    let geoms = with_geoms()?;
    let contact = Scene { geoms: false, flange_sensor: false, ..geoms.clone() };
    let free = Scene { people: Vec::new(), ..contact.clone() };
    let alone = Scene { people: Vec::new(), ..geoms.clone() };
    let (base_only, arm_only) =
        (Scene { robot: Robot::BaseOnly, ..free.clone() }, Scene { robot: Robot::ArmOnly, ..free.clone() });
    let (contact_analytic, free_analytic) = (analytic(&contact), analytic(&free));
    let case = |name, left_out, scene, reference, (tolerance, because)| Case {
        name,
        left_out,
        scene,
        reference,
        until_touch: name == "contact",
        tolerance,
        because,
    };
    let cases = [
        case("geoms", "nothing", &geoms, &geoms, (0.0, "itself")),
        case(
            "contact",
            "geoms with their collision detection, contacts and sensors",
            &contact,
            &geoms,
            (0.0, "until the touch nothing numerical differs; then foam instead of hard bodies"),
        ),
        case("contact, analytic", "the above and MuJoCo", &contact_analytic, &contact, ROUNDED),
        case("free", "geoms, sensors and the person", &free, &alone, SAME),
        case("free, analytic", "the above and MuJoCo", &free_analytic, &free, ROUNDED),
        case(
            "base-only",
            "geoms, sensors, the person and the arm",
            &base_only,
            &alone,
            (1e-2, "the arm's recoil is missing"),
        ),
        case(
            "arm-only",
            "geoms, sensors, the person and the base",
            &arm_only,
            &alone,
            (1e-2, "the base's give is missing"),
        ),
    ];
    let whole = |case: &&Case<'_>| timed && case.scene.robot == Robot::MobileManipulator;
    let mut count = Count::new("economy", cases.len() + cases.iter().filter(whole).count());
    let mut scenes = Vec::new();
    for case in &cases {
        scenes.push(compare(case)?);
        count.one_more();
    }
    let most = scenes[0].step_us;
    for row in &mut scenes {
        row.of_geoms = row.step_us / most;
    }
    // a base or an arm alone has another loop: their law's cost stands beside
    let mut ticks = Vec::new();
    for case in cases.iter().filter(whole) {
        ticks.push(TickCost::of(case.name, case.scene)?);
        count.one_more();
    }
    Ok((scenes, ticks))
}

fn compare(case: &Case<'_>) -> Result<Row> {
    let &Case { scene, reference, .. } = case;
    let drives = scene.robot != Robot::ArmOnly;
    let started = Instant::now();
    let size = SimPlant::new(scene)?.model_size().into();
    let start_up_ms = 1e3 * started.elapsed().as_secs_f64();
    let (own, step_us) = fastest(scene, drives)?;
    let other = trajectory(reference, drives)?.0;
    let difference = difference(&own, &other, scene.robot, case.until_touch);
    Ok(Row {
        scene: case.name,
        left_out: case.left_out,
        engine: scene.engine.reason(),
        size,
        start_up_ms,
        step_us,
        of_geoms: 1.0,
        difference,
        tolerance: case.tolerance,
        because: case.because,
        agrees: difference <= case.tolerance,
    })
}

/// One tick of a trajectory.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Place {
    /// Base pose and arm angles, m, rad.
    robot: [f64; 10],
    touched: bool,
}

/// Largest difference of what both have, m, rad.
fn difference(own: &[Place], other: &[Place], robot: Robot, until_touch: bool) -> f64 {
    let compares = |i: &usize| match robot {
        Robot::MobileManipulator => true,
        Robot::BaseOnly => *i < 3,
        Robot::ArmOnly => *i >= 3,
    };
    own.iter()
        .zip(other)
        .take_while(|(a, b)| !until_touch || !(a.touched || b.touched))
        .flat_map(|(a, b)| (0..10).filter(compares).map(move |i| (a.robot[i] - b.robot[i]).abs()))
        .fold(0.0, f64::max)
}

/// Scenes of the collision from the one with geoms to the leanest, and the largest difference of each to the one before, m, rad:
/// the first pair until somebody is touched.
pub(crate) fn leaner() -> Result<([Scene; 3], [f64; 2])> {
    let geoms = with_geoms()?;
    let contact = Scene { geoms: false, flange_sensor: false, ..geoms.clone() };
    let analytic = Scene { engine: Engine::Analytic, ..contact.clone() };
    let scenes = [geoms, contact, analytic];
    let [geoms, contact, analytic] = [0, 1, 2].map(|i| trajectory(&scenes[i], true));
    let (contact, whole) = (contact?.0, Robot::MobileManipulator);
    let apart =
        [difference(&contact, &geoms?.0, whole, true), difference(&analytic?.0, &contact, whole, false)];
    Ok((scenes, apart))
}

/// The trajectory, and the mean over its ticks of the least time of that tick in [`PASSES`] passes, µs: what others do
/// on this machine hits no tick in every pass.
fn fastest(scene: &Scene, drives: bool) -> Result<(Vec<Place>, f64)> {
    let (trace, mut least) = trajectory(scene, drives)?;
    for _ in 1..PASSES {
        for (least, now) in least.iter_mut().zip(trajectory(scene, drives)?.1) {
            *least = least.min(now);
        }
    }
    Ok((trace, 1e6 * least.iter().sum::<f64>() / f64::from(u32::try_from(TICKS)?)))
}

/// Base pose and arm angles, and how long each step took, s.
fn trajectory(scene: &Scene, drives: bool) -> Result<(Vec<Place>, Vec<f64>)> {
    let mut plant = SimPlant::new(scene)?;
    let (mut trace, mut times_s) = (Vec::with_capacity(TICKS), Vec::with_capacity(TICKS));
    let hold = gravity(scene)?;
    for tick in 0..TICKS {
        let state = plant.state();
        let mut arm_torque_nm = hold;
        for (i, torque) in arm_torque_nm.iter_mut().enumerate() {
            let stiffness = [90.0, 90.0, 90.0, 90.0, 45.0, 30.0, 15.0][i];
            *torque += stiffness * (PANDA.home_rad[i] - state.q_rad[i]) - stiffness / 9.0 * state.dq_rad_s[i];
        }
        let speed = if drives && tick > 100 { 0.15 } else { 0.0 };
        let command = RobotCommand {
            base_velocity_body: [0.0, speed, 0.0],
            arm_torque_nm,
            arm_gravity_nm: [0.0; JOINTS],
        };
        plant.apply(&Actuation::Drive(command))?;
        let started = Instant::now();
        plant.step()?;
        times_s.push(started.elapsed().as_secs_f64());
        let [x, y, yaw] = state.base_pose_world;
        let mut row = [x, y, yaw, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0];
        row[3..].copy_from_slice(&state.q_rad[..7]);
        trace.push(Place { robot: row, touched: plant.contact_total_true_n() > 0.0 });
    }
    Ok((trace, times_s))
}

/// Torques that hold the home posture, N·m: the same for every scene.
fn gravity(scene: &Scene) -> Result<[f64; JOINTS]> {
    let plant = SimPlant::new(&Scene { arm_posture_rad: scene.arm_posture_rad, ..free_scene() })?;
    let mut torque = [0.0; JOINTS];
    torque.copy_from_slice(&plant.bias()[3..10]);
    Ok(torque)
}

/// Robot that stands and holds itself, whose engine alone is stepped.
pub(crate) struct Standing {
    plant: SimPlant,
    scene: Scene,
    hold: RobotCommand<JOINTS>,
}

impl Standing {
    /// Bare steps of a stretch: in many more of them it would begin to fall.
    pub(crate) const STRETCH: u32 = 50;

    /// Builds the robot of `scene`.
    pub(crate) fn new(scene: &Scene) -> Result<Self> {
        let arm_gravity_nm = gravity(scene)?;
        let hold =
            RobotCommand { base_velocity_body: [0.0; 3], arm_torque_nm: arm_gravity_nm, arm_gravity_nm };
        Ok(Self { plant: SimPlant::new(scene)?, scene: scene.clone(), hold })
    }

    /// CPU time of a step in a stretch, s.
    pub(crate) fn step_s(&mut self) -> Result<f64> {
        let (plant, scene) = (&mut self.plant, &self.scene);
        plant.set_state(&scene.base_pose_world, &[0.0; 3], &scene.arm_posture_rad, &[0.0; JOINTS]);
        plant.apply(&Actuation::Drive(self.hold))?;
        plant.step()?;
        let (stepped, cpu_s) = cpu_time::timed(|| (0..Self::STRETCH).try_for_each(|_| plant.bare_step()));
        stepped?;
        Ok(cpu_s / f64::from(Self::STRETCH))
    }
}

/// CPU time of one bare step of the robot as it stands and holds itself, µs: the least over 100 stretches.
pub(crate) fn bare_step_us(scene: &Scene) -> Result<f64> {
    let mut standing = Standing::new(scene)?;
    let mut best = f64::INFINITY;
    for _ in 0..100 {
        best = best.min(standing.step_s()?);
    }
    Ok(1e6 * best)
}

/// One tick of the daemon's loop on a stock board in memory, armed and moving.
fn whole_tick_us(scene: &Scene) -> Result<f64> {
    let settings = Settings::paper(Law::Impedance);
    let mut lock_step = LockStep::with_board(&settings.config, scene, settings.board(), None)?;
    armed(&mut lock_step)?;
    let mut best = f64::INFINITY;
    for _ in 0..100 {
        let ((), cpu_s) = cpu_time::timed(|| {
            for _ in 0..50 {
                loop_tick(&mut lock_step);
            }
        });
        best = best.min(cpu_s / 50.0);
    }
    Ok(1e6 * best)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn scene_without_geoms_is_bit_equal_until_contact() {
        let geoms = with_geoms().unwrap();
        let size = SimPlant::new(&geoms).unwrap().model_size();
        assert_eq!((size.geoms, size.sensors), (10, 33));
        let pruned = Scene { geoms: false, ..geoms.clone() };
        let size = SimPlant::new(&pruned).unwrap().model_size();
        assert_eq!((size.geoms, size.sensors), (0, 0));
        let (a, b) = (trajectory(&geoms, true).unwrap().0, trajectory(&pruned, true).unwrap().0);
        let touched_at = |trace: &[Place]| trace.iter().position(|place| place.touched).unwrap();
        assert_eq!(difference(&a, &b, Robot::MobileManipulator, true).to_bits(), 0);
        let (hard, soft) = (touched_at(&a), touched_at(&b));
        assert!(hard.abs_diff(soft) <= 1 && (200..800).contains(&soft), "{hard} {soft}");
        assert!(a[TICKS - 1].robot[1] > 0.05 && b[TICKS - 1].robot[1] > 0.05, "the base was driven");
    }

    #[test]
    fn every_scene_goes_where_its_reference_goes() {
        for case in scenes(false).unwrap().0 {
            assert!(case.agrees, "{}: {:e} is more than {:e}", case.scene, case.difference, case.tolerance);
        }
    }
}
