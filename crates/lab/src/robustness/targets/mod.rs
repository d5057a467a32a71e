//! Random requests of another program for flange, arm and base: no stop, no limit passed.

mod client;

use anyhow::{Context, Result, ensure};
use client::Client;
use moca_control::config::{Config, HandConfig};
use moca_experiments::closed_loop::armed;
use moca_experiments::{JOINTS, parallel};
use moca_lockstep::LockStep;
use moca_lockstep::ideal_cover::IdealCover;
use moca_lockstep::simulated_robot::free_scene;
use moca_msgs::{ArmTable, Fault, Law, Limits, Sample};
use moca_wbc::limits::JointSpeeds;
use std::collections::BTreeSet;

/// Time for which each program asks, s.
const SECONDS: f64 = 20.0;

/// A program that commands an arm.
#[derive(Clone, Copy, Debug)]
struct Cell {
    arm: &'static str,
    law: Law,
    seed: u64,
}

/// Every quantity is of what is allowed: 1 is the limit.
#[derive(Debug, Default)]
struct Outcome {
    joint_speed: f64,
    joint_range: f64,
    torque: f64,
    torque_step: f64,
    flange_speed: f64,
    pose_error: f64,
    base_speed: f64,
    /// Targets that were taken, with their kinds, and that were refused.
    taken: u64,
    kinds: BTreeSet<&'static str>,
    refused: u64,
    /// Wrong answers to a program.
    wrong: Vec<String>,
    /// Why the robot stopped, if it did, and when, s.
    stopped: Option<(Fault, f64)>,
}

impl Outcome {
    fn passed(&self) -> bool {
        let joints = [self.joint_speed, self.joint_range, self.torque, self.torque_step];
        let shares = [self.flange_speed, self.pose_error, self.base_speed];
        let inside = joints.iter().chain(&shares).all(|share| *share <= 1.0 + 1e-9);
        inside && self.stopped.is_none() && self.wrong.is_empty()
    }
}

/// One program that commands a robot.
fn led(cell: &Cell) -> Result<Outcome> {
    let mut config = Config::parse(&format!("robot.arm = \"{}\"\n", cell.arm))?;
    config.simulation.hand = HandConfig::none();
    config.startup.law = cell.law;
    let scene = free_scene(&config);
    let cover = IdealCover::new(1, 0);
    let mut world = LockStep::with_true_forces(&config, &scene, cover)?;
    let mut sample = armed(&mut world).with_context(|| format!("{cell:?}"))?;
    let arm = config.arm().table().context("an arm of another number of joints")?;
    let mut client = Client::new(&config, cell.law, arm, cell.seed);
    let mut watch = Watch::new(&config, arm, &sample);
    let mut t_s = 0.0;
    while t_s < SECONDS && watch.worst.stopped.is_none() {
        let request = client.ask(&sample);
        let (next, answer) = world.step(request);
        client.hear(request, answer, &mut watch.worst);
        sample = next;
        watch.see(&sample, t_s).with_context(|| format!("{cell:?} at {t_s:.3} s"))?;
        t_s += watch.limits.period_s;
    }
    Ok(watch.worst)
}

/// Measures taken tick by tick.
struct Watch {
    arm: ArmTable<JOINTS>,
    limits: Limits<JOINTS>,
    speeds: JointSpeeds<JOINTS, f64>,
    last: Sample,
    worst: Outcome,
}

impl Watch {
    fn new(config: &Config, arm: ArmTable<JOINTS>, first: &Sample) -> Self {
        let limits = config.parameters().resized().limits;
        let speeds = JointSpeeds::new(&arm);
        Self { arm, limits, speeds, last: first.clone(), worst: Outcome::default() }
    }

    fn see(&mut self, sample: &Sample, t_s: f64) -> Result<()> {
        ensure!(sample.q_rad.len() == JOINTS, "the robot gave no state: {:?}", sample.fault);
        let Self { arm, limits, speeds, last, worst } = self;
        let raise = |worst: &mut f64, share: f64| *worst = worst.max(share);
        for i in 0..JOINTS {
            let (q, dq, torque) = (sample.q_rad[i], sample.dq_rad_s[i], sample.arm_torque_nm[i]);
            raise(&mut worst.joint_speed, dq.abs() / speeds.largest(i, q, dq));
            let (low, high) = (arm.q_min_rad[i], arm.q_max_rad[i]);
            raise(&mut worst.joint_range, (2.0 * q - low - high).abs() / (high - low));
            raise(&mut worst.torque, torque.abs() / limits.torque_nm[i]);
            let step = (torque - last.arm_torque_nm[i]).abs();
            raise(&mut worst.torque_step, step / (limits.torque_rate_nm_s * limits.period_s));
        }
        let (place, before) = (sample.flange_position_world, last.flange_position_world);
        raise(&mut worst.flange_speed, distance(place, before) / limits.period_s / limits.flange_speed_m_s);
        let error = distance(place, sample.flange_desired_position_world) / limits.pose_error_m;
        raise(&mut worst.pose_error, error);
        for (speed, most) in sample.base_velocity_command_body.iter().zip(limits.base_velocity) {
            raise(&mut worst.base_speed, speed.abs() / most);
        }
        if let (None, Some(fault)) = (worst.stopped, sample.fault) {
            worst.stopped = Some((fault, t_s));
        }
        *last = sample.clone();
        Ok(())
    }
}

fn distance(a: [f64; 3], b: [f64; 3]) -> f64 {
    (0..3).map(|i| (a[i] - b[i]).powi(2)).sum::<f64>().sqrt()
}

#[test]
fn random_targets_pass_no_limit_and_cause_no_stop() {
    let mut cells = Vec::new();
    for arm in ["panda", "fr3"] {
        for law in [Law::Impedance, Law::FollowMe] {
            cells.extend([1, 2].map(|seed| Cell { arm, law, seed }));
        }
    }
    let outcomes = parallel::run("targets", &cells, led).unwrap();
    for (cell, outcome) in cells.iter().zip(&outcomes) {
        assert!(outcome.passed(), "{cell:?}: {outcome:?}");
    }
    // The robot was led about, up to near what it may do, and refused what it should.
    let most = |of: fn(&Outcome) -> f64| outcomes.iter().map(of).fold(0.0, f64::max);
    assert!(most(|o| o.joint_speed) > 0.4 && most(|o| o.flange_speed) > 0.3, "{outcomes:?}");
    let sum = |of: fn(&Outcome) -> u64| outcomes.iter().map(of).sum::<u64>();
    let (taken, refused) = (sum(|o| o.taken), sum(|o| o.refused));
    assert!(taken > 400 && refused >= 10, "{taken} taken, {refused} refused");
    let kinds: BTreeSet<_> = outcomes.iter().flat_map(|o| &o.kinds).collect();
    assert!(kinds.is_superset(&BTreeSet::from([&"pose", &"posture", &"trajectory", &"twist"])), "{kinds:?}");
}
