//! The law in single precision, in contact: the same closed loop with either scalar, side by side.

use anyhow::{Context, Result};
use moca_control::cover::{CoverSource, CoverState};
use moca_experiments::collision;
use moca_experiments::cpu_time;
use moca_experiments::settings::Settings;
use moca_experiments::timed::{Controller, Timed};
use moca_experiments::{JOINTS, TAXELS, count, state_in};
use moca_lockstep::ideal_cover::IdealCover;
use moca_msgs::robot::{MOCA_MOUNT, PANDA, PAPER_COVER, Payload};
use moca_msgs::{Actuation, RobotCommand, RobotState};
use moca_sim::SimPlant;
use moca_wbc::{ControlInput, ControlLaw};

/// Result of a run.
pub(super) struct Run {
    /// Pose of the base at each tick: m, m, rad; and the largest force on one body over it, N.
    poses: Vec<[f64; 3]>,
    forces_n: Vec<f64>,
    /// Flange position at each tick, axes of W, m.
    flange_m: Vec<[f64; 3]>,
    pub peak_n: f64,
}

impl Run {
    /// Largest differences along the way: base, m; yaw, rad; flange, m; force, N.
    pub(super) fn off(&self, other: &Self) -> [f64; 4] {
        let most = |offs: &mut dyn Iterator<Item = f64>| offs.fold(0.0, f64::max);
        let poses = || self.poses.iter().zip(&other.poses);
        let apart =
            |a: &[f64; 3], b: &[f64; 3]| a.iter().zip(b).map(|(a, b)| (a - b).powi(2)).sum::<f64>().sqrt();
        [
            most(&mut poses().map(|(a, b)| (a[0] - b[0]).hypot(a[1] - b[1]))),
            most(&mut poses().map(|(a, b)| (a[2] - b[2]).abs())),
            most(&mut self.flange_m.iter().zip(&other.flange_m).map(|(a, b)| apart(a, b))),
            most(&mut self.forces_n.iter().zip(&other.forces_n).map(|(a, b)| (a - b).abs())),
        ]
    }
}

/// The collision with the ideal sensor: all that the law is told and remembers is in the scalar `T`, the plant in f64.
pub(super) fn run<T: Timed>(settings: &Settings, narrow: fn(f64) -> T, widen: fn(T) -> f64) -> Result<Run> {
    let scene = settings.collision_scene()?;
    let (mut plant, parameters) = (SimPlant::new(&scene)?, settings.config.parameters());
    let law = Controller::<T>::new(&PANDA, &MOCA_MOUNT, &Payload::NONE, &PAPER_COVER, &parameters.resized())?;
    let rate_hz = f64::from(settings.config.control_loop.rate_hz);
    let state = |plant: &SimPlant| -> RobotState<JOINTS, T> { state_in(&plant.state().resized(), narrow) };
    let mut memory = law.enter(ControlLaw::Impedance, &state(&plant))?;
    let [x, y, z] = collision::towards_person(settings);
    memory.set_target_twist([x, y, z, 0.0, 0.0, 0.0].map(narrow))?;
    #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "some thousand ticks")]
    let [ticks, period] =
        [settings.duration_s * rate_hz, 1e-3 * settings.period_ms() * rate_hz].map(|n| n.round() as u64);
    let (mut cover, mut felt) = (IdealCover::new(period, 0), CoverState::NONE);
    let (mut poses, mut forces_n, mut flange_m) = (Vec::new(), Vec::new(), Vec::new());
    for tick in 0..ticks {
        #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "some seconds")]
        let now_ns = (1e9 * count(usize::try_from(tick)?) / rate_hz) as u64;
        cover.take_forces(now_ns, plant.taxel_force_mean_n());
        cover.read(now_ns, &mut felt);
        let felt_n = felt.poll.forces.ok().context("a cover that always feels")?;
        let input = ControlInput::new(state(&plant), taxels(&felt_n, narrow), narrow(1.0 / rate_hz));
        let output = T::step(&law, &mut memory, &input)?;
        plant.apply(&Actuation::Drive(RobotCommand {
            base_velocity_body: output.command.base_velocity_body.map(widen),
            arm_torque_nm: output.command.arm_torque_nm.map(widen),
            arm_gravity_nm: output.command.arm_gravity_nm.map(widen),
        }))?;
        plant.step()?;
        poses.push(plant.state().base_pose_world);
        forces_n.push(plant.contact_largest_true_n());
        flange_m.push(output.flange.position_world.map(widen));
    }
    Ok(Run { poses, forces_n, flange_m, peak_n: plant.contact_peak_true_n() })
}

fn taxels<T>(force_n: &[f64], narrow: fn(f64) -> T) -> [T; TAXELS] {
    std::array::from_fn(|i| narrow(force_n[i]))
}

/// In f64 and in f32, each with its CPU time, s.
pub(super) fn both(settings: &Settings) -> Result<[(Run, f64); 2]> {
    #[expect(clippy::cast_possible_truncation, reason = "single precision is what is being measured")]
    let (single, single_s) = cpu_time::timed(|| run::<f32>(settings, |value| value as f32, f64::from));
    let (double, double_s) = cpu_time::timed(|| run::<f64>(settings, |value| value, |value| value));
    Ok([(double?, double_s), (single?, single_s)])
}
