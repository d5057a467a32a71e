//! `moca-lab economy`: what a scene costs when it holds everything, and when it holds only what it needs.

mod parts;

use crate::paper::collision;
use crate::rig::JOINTS;
use crate::rig::cpu_time;
use crate::rig::free_scene;
use crate::rig::settings::Settings;
use anyhow::Result;
use moca_daemon::runtime::lockstep::LockStep;
use moca_msgs::robot::PANDA;
use moca_msgs::{Actuation, Law, RobotCommand};
use moca_sim::{ModelSize, Robot, Scene, SimPlant};
use serde::Serialize;
use std::time::Instant;

/// Ticks of the trajectories that are compared and timed.
const TICKS: usize = 1500;
/// Passes of which the fastest counts.
const PASSES: usize = 5;

/// Arguments of `moca-lab economy`.
#[derive(clap::Args)]
pub(crate) struct Arguments {
    /// Prints one JSON object.
    #[arg(long)]
    json: bool,
}

/// One scene beside the full one.
#[derive(Clone, Debug, Serialize)]
struct Row {
    scene: &'static str,
    left_out: &'static str,
    #[serde(flatten)]
    size: Size,
    start_up_ms: f64,
    step_us: f64,
    /// Cost of a step over the full scene's.
    of_full: f64,
    target: Option<f64>,
    /// Largest difference from the full scene over the run: base m and rad, arm rad.
    difference: f64,
    /// What that difference may be, and why.
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

/// Plant, board's bytes, reader and controller in one tick, over the bare `mj_step` of the same model.
#[derive(Debug, Serialize)]
struct TickCost {
    scene: &'static str,
    bare_step_us: f64,
    whole_tick_us: f64,
    whole_of_bare: f64,
    target: f64,
    met: bool,
}

impl TickCost {
    const TARGET: f64 = 1.5;

    fn of(name: &'static str, scene: &Scene) -> Result<Self> {
        let bare_step_us = bare_step_us(scene)?;
        let whole_tick_us = whole_tick_us(scene)?;
        let whole_of_bare = whole_tick_us / bare_step_us;
        let met = whole_of_bare <= Self::TARGET;
        Ok(Self { scene: name, bare_step_us, whole_tick_us, whole_of_bare, target: Self::TARGET, met })
    }
}

/// Builds, runs, compares and times every scene.
#[expect(clippy::print_stdout, reason = "the command's output")]
pub(crate) fn run(arguments: &Arguments) -> Result<()> {
    let report = measure()?;
    if arguments.json {
        println!("{}", serde_json::to_string_pretty(&report)?);
        return Ok(());
    }
    println!(
        "{:16} {:>5} {:>6} {:>6} {:>8} {:>9} {:>9} {:>9} {:>8} {:>8} {:>9}  differs by (allowed; why)",
        "scene",
        "dofs",
        "geoms",
        "sensor",
        "model kB",
        "data kB",
        "start ms",
        "step us",
        "of full",
        "target",
        "agrees"
    );
    for row in &report.scenes {
        println!(
            "{:16} {:>5} {:>6} {:>6} {:>8} {:>9} {:>9.2} {:>9.2} {:>8.2} {:>8} {:>9}  {:.1e} ({:.0e}; {})\n{:16} left out: {}",
            row.scene,
            row.size.dofs,
            row.size.geoms,
            row.size.sensors,
            row.size.model_bytes / 1024,
            row.size.data_bytes / 1024,
            row.start_up_ms,
            row.step_us,
            row.of_full,
            row.target.map_or(String::new(), |t| format!("{t}")),
            if row.agrees { "yes" } else { "NO" },
            row.difference,
            row.tolerance,
            row.because,
            "",
            row.left_out
        );
    }
    println!("whole simulated tick (plant, bytes, reader, control) over the bare mj_step of the same model:");
    for tick in &report.ticks {
        println!(
            "{:16} {:>6.2} us / {:>5.2} us = {:.2}  target {}: {}",
            tick.scene,
            tick.whole_tick_us,
            tick.bare_step_us,
            tick.whole_of_bare,
            tick.target,
            if tick.met { "met" } else { "MISSED" }
        );
    }
    println!("{}", report.control);
    Ok(())
}

/// The scene of row C, with everything: see scenes/full.toml.
fn full() -> Result<Scene> {
    let mut settings = Settings::paper(Law::Impedance);
    collision::defaults(&mut settings);
    for line in include_str!("../../../../../scenes/full.toml").lines().map(str::trim) {
        if let (false, Some((key, value))) = (line.starts_with('#'), line.split_once('=')) {
            let bare = |text: &str| text.trim().trim_matches('"').to_owned();
            settings.set(&format!("{}={}", bare(key), bare(value)))?;
        }
    }
    Ok(Scene { everything: true, ..settings.collision_scene()? })
}

fn measure() -> Result<Report> {
    let full = full()?;
    let pruned = Scene { everything: false, flange_sensor: false, ..full.clone() };
    let free = Scene { people: Vec::new(), ..pruned.clone() };
    let alone = Scene { people: Vec::new(), ..full.clone() };
    let (base_only, arm_only) =
        (Scene { robot: Robot::BaseOnly, ..free.clone() }, Scene { robot: Robot::ArmOnly, ..free.clone() });
    let everything = "floor, hull and link geoms with collision detection, 11 touch pads, 54 sensors, energy";
    let mut scenes = vec![
        compare("full", "nothing", &full, &full, true, None, (0.0, "itself"))?,
        compare("contact", everything, &pruned, &full, true, Some(0.8), (0.0, "nothing numerical differs"))?,
        compare(
            "free",
            "the above and the person",
            &free,
            &alone,
            true,
            Some(0.7),
            (0.0, "nothing numerical differs"),
        )?,
        compare(
            "base-only",
            "the above and the arm",
            &base_only,
            &alone,
            true,
            None,
            (1e-2, "the arm's recoil is missing"),
        )?,
        compare(
            "arm-only",
            "the above and the base",
            &arm_only,
            &alone,
            false,
            None,
            (1e-2, "the base's give is missing"),
        )?,
    ];
    let most = scenes[0].step_us;
    for row in &mut scenes {
        row.of_full = row.step_us / most;
    }
    let ticks = [("full", &full), ("contact", &pruned), ("free", &free)];
    let ticks = ticks.into_iter().map(|(name, scene)| TickCost::of(name, scene)).collect::<Result<_>>()?;
    let control = parts::measure(&Settings::paper(Law::Impedance).config)?;
    Ok(Report { scenes, ticks, control })
}

fn compare(
    name: &'static str,
    left_out: &'static str,
    scene: &Scene,
    reference: &Scene,
    drives: bool,
    target: Option<f64>,
    (tolerance, because): (f64, &'static str),
) -> Result<Row> {
    let started = Instant::now();
    let size = SimPlant::new(scene)?.model_size().into();
    let start_up_ms = 1e3 * started.elapsed().as_secs_f64();
    let (own, step_us) = fastest(scene, drives)?;
    let (other, _) = trajectory(reference, drives)?;
    let compares = |i: usize| match scene.robot {
        Robot::MobileManipulator => true,
        Robot::BaseOnly => i < 3,
        Robot::ArmOnly => i >= 3,
    };
    let difference = own
        .iter()
        .zip(&other)
        .flat_map(|(a, b)| (0..10).filter(|&i| compares(i)).map(move |i| (a[i] - b[i]).abs()))
        .fold(0.0, f64::max);
    let agrees = difference <= tolerance;
    Ok(Row {
        scene: name,
        left_out,
        size,
        start_up_ms,
        step_us,
        of_full: 1.0,
        target,
        difference,
        tolerance,
        because,
        agrees,
    })
}

/// The trajectory, and the mean over its ticks of the least time of that tick in [`PASSES`] passes, µs: what others do
/// on this machine hits no tick in every pass.
fn fastest(scene: &Scene, drives: bool) -> Result<(Vec<[f64; 10]>, f64)> {
    let (trace, mut least) = trajectory(scene, drives)?;
    for _ in 1..PASSES {
        for (least, now) in least.iter_mut().zip(trajectory(scene, drives)?.1) {
            *least = least.min(now);
        }
    }
    Ok((trace, 1e6 * least.iter().sum::<f64>() / f64::from(u32::try_from(TICKS)?)))
}

/// Base pose and arm angles, and how long each step took, s.
fn trajectory(scene: &Scene, drives: bool) -> Result<(Vec<[f64; 10]>, Vec<f64>)> {
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
        trace.push(row);
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

/// CPU time of one `mj_step` of the robot as it stands and holds itself, µs: the least over stretches of 50.
pub(crate) fn bare_step_us(scene: &Scene) -> Result<f64> {
    const STRETCH: u32 = 50;
    let mut plant = SimPlant::new(scene)?;
    let arm_gravity_nm = gravity(scene)?;
    let hold = RobotCommand { base_velocity_body: [0.0; 3], arm_torque_nm: arm_gravity_nm, arm_gravity_nm };
    let mut best = f64::INFINITY;
    for _ in 0..100 {
        plant.set_state(&scene.base_pose_world, &[0.0; 3], &scene.arm_posture_rad, &[0.0; JOINTS]);
        plant.apply(&Actuation::Drive(hold))?;
        plant.step()?;
        let ((), cpu_s) = cpu_time::timed(|| (0..STRETCH).for_each(|_| plant.bare_step()));
        best = best.min(cpu_s / f64::from(STRETCH));
    }
    Ok(1e6 * best)
}

/// One tick of the daemon's loop on a stock board in memory, armed and moving.
fn whole_tick_us(scene: &Scene) -> Result<f64> {
    let settings = Settings::paper(Law::Impedance);
    let mut lock_step = LockStep::with_board(&settings.config, scene, settings.board(), None)?.untimed();
    let mut ticks = 0;
    while !lock_step.step(None).0.mode.moves() {
        ticks += 1;
        anyhow::ensure!(ticks < 30_000, "the robot was not armed within 30 s");
    }
    let mut best = f64::INFINITY;
    for _ in 0..100 {
        let ((), cpu_s) = cpu_time::timed(|| {
            for _ in 0..50 {
                lock_step.step(None);
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
    fn a_pruned_scene_gives_the_full_scene_s_trajectory_to_the_bit() {
        let full = full().unwrap();
        assert!(SimPlant::new(&full).unwrap().model_size().sensors > 40);
        let pruned = Scene { everything: false, ..full.clone() };
        let size = SimPlant::new(&pruned).unwrap().model_size();
        assert_eq!((size.geoms, size.sensors), (0, 0));
        let (a, b) = (trajectory(&full, true).unwrap().0, trajectory(&pruned, true).unwrap().0);
        assert_eq!(a, b);
        assert!(a[TICKS - 1][1] > 0.05, "the base was driven");
    }
}
