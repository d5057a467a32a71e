//! The whole loop with an arm behind a line that loses one to three datagrams in a row, either way, while people press the
//! cover at random. What reaches the arm stays within the change of torque that it takes, and no joint that a law moves gets
//! faster than the arm allows where it is.

use anyhow::{Result, ensure};
use moca_control::assemble::{motion, supervisor};
use moca_control::plant::Plant;
use moca_control::robot::{JOINTS, PlantKind, TAXELS};
use moca_control::stage::Untimed;
use moca_control::tick::ControlLoop;
use moca_control::tick_input::Slot;
use moca_experiments::unattended;
use moca_franka::limiter::{ARM_CHANGE_NM, TorqueLimiter};
use moca_lockstep::ideal_cover::IdealCover;
use moca_lockstep::inject::Random;
use moca_lockstep::simulated_robot::free_scene;
use moca_msgs::{Actuation, Fault, Law, Mode, Request, RobotCommand, RobotState};
use moca_sim::SimPlant;
use moca_wbc::limits::JointSpeeds;

/// Longest run of datagrams that are lost.
const LOST_MAX: usize = 3;
/// One in so many states, and one in so many orders, begins such a run.
const LOST_ONE_IN: usize = 20;
/// Largest press, N.
const PRESS_MAX_N: usize = 80;
/// Longest press, and longest pause between two, ticks.
const PRESS_TICKS: usize = 1500;

/// Observations.
#[derive(Debug, Default)]
struct Report {
    /// Milliseconds of the arm.
    ticks: u64,
    /// Number of them with a law in command.
    driven: u64,
    states_lost: u64,
    orders_lost: u64,
    presses: u64,
    /// Largest change of a torque from one millisecond to the next where it arrived, as a rate.
    largest_rate_nm_s: f64,
    /// Share of the arm's largest speed where it is: 1 is all of it.
    largest_share_of_joint_speed: f64,
}

/// A simulated robot whose arm hears some of the orders.
struct Line {
    world: SimPlant,
    limiter: TorqueLimiter,
    /// Torques of the arm, without gravity, N·m.
    has_nm: [f64; moca_franka::JOINTS],
    random: Random,
    lose_orders: usize,
    report: Report,
}

impl Line {
    /// Returns the number of datagrams that are lost now in a row.
    fn burst(&mut self) -> usize {
        if self.random.one_in(LOST_ONE_IN) { 1 + self.random.below(LOST_MAX) } else { 0 }
    }

    fn arrive(&mut self, sent_nm: [f64; moca_franka::JOINTS]) {
        if self.lose_orders == 0 {
            self.lose_orders = self.burst();
        }
        if self.lose_orders > 0 {
            self.lose_orders -= 1;
            self.report.orders_lost += 1;
            return;
        }
        for (has, sent) in self.has_nm.iter_mut().zip(sent_nm) {
            let rate_nm_s = 1e3 * (sent - *has).abs();
            self.report.largest_rate_nm_s = self.report.largest_rate_nm_s.max(rate_nm_s);
            *has = sent;
        }
    }

    /// One millisecond of the arm, with the torque that it has.
    fn step(&mut self, moves: bool, speeds: &JointSpeeds<JOINTS, f64>) -> Result<()> {
        self.world.step()?;
        self.report.ticks += 1;
        if moves {
            let state = self.world.state();
            let share = speeds.share(&state.q_rad, &state.dq_rad_s);
            self.report.driven += 1;
            self.report.largest_share_of_joint_speed = self.report.largest_share_of_joint_speed.max(share);
        }
        Ok(())
    }
}

impl Plant for Line {
    fn read(&mut self) -> Result<RobotState<JOINTS>, Fault> {
        Ok(self.world.state())
    }

    fn write(&mut self, actuation: &Actuation<JOINTS>, _: u64) -> Result<(), Fault> {
        let Actuation::Drive(command) = actuation else {
            (self.limiter, self.has_nm) = (TorqueLimiter::new(), [0.0; moca_franka::JOINTS]);
            return self.world.apply(&Actuation::<JOINTS>::Brake).map_err(|_| Fault::ControlRefused);
        };
        let (torque_nm, gravity_nm) = (&command.arm_torque_nm, &command.arm_gravity_nm);
        let wanted_nm = std::array::from_fn(|i| torque_nm[i] - gravity_nm[i]);
        // The arm says in single precision what it has.
        #[expect(clippy::cast_possible_truncation, reason = "as on the wire")]
        let received_nm = self.has_nm.map(|torque| f64::from(torque as f32));
        let sent_nm = self.limiter.limit(&wanted_nm, &received_nm);
        self.arrive(sent_nm);
        let mut command = RobotCommand { arm_torque_nm: *gravity_nm, ..*command };
        command.arm_torque_nm.iter_mut().zip(self.has_nm).for_each(|(torque, has)| *torque += has);
        self.world.apply(&Actuation::Drive(command)).map_err(|_| Fault::ControlRefused)
    }
}

/// Pressed taxel and end of the press.
#[derive(Default)]
struct Hand {
    taxel: usize,
    force_n: f64,
    until: u64,
}

impl Hand {
    fn at(&mut self, now: u64, line: &mut Line, taxels: usize) -> Result<()> {
        if now < self.until {
            return Ok(());
        }
        line.world.press(self.taxel, 0.0)?;
        let pressed = self.force_n > 0.0;
        let below = |line: &mut Line, limit| line.random.below(limit);
        self.until = now + 1 + u64::try_from(below(line, PRESS_TICKS))?;
        self.taxel = below(line, taxels);
        self.force_n = if pressed { 0.0 } else { f64::from(u32::try_from(1 + below(line, PRESS_MAX_N))?) };
        line.report.presses += u64::from(!pressed);
        Ok(line.world.press(self.taxel, self.force_n)?)
    }
}

/// Runs one robot for `ticks` milliseconds of the arm.
fn campaign(ticks: u64, seed: u64) -> Result<Report> {
    let mut config = unattended(Law::Impedance);
    config.plant.kind = PlantKind::Robot;
    config.protection.override_speed_limit_m_s = 0.3;
    config.protection.override_statement = "an ideal cover has no rate".into();
    let world = SimPlant::new(&free_scene(&config))?;
    let (limiter, has_nm) = (TorqueLimiter::new(), [0.0; moca_franka::JOINTS]);
    let (random, report) = (Random::new(seed), Report::default());
    let line = Line { world, limiter, has_nm, random, lose_orders: 0, report };
    let cover = IdealCover::new(4, 0);
    let mut control = ControlLoop::new(line, cover, supervisor(&config), motion(&config)?, 1e-3);
    let speeds = JointSpeeds::new(&config.arm().table);
    let (taxels, mut hand, mut mode, mut moves) =
        (config.robot.cover.count(), Hand::default(), Mode::Starting, false);
    let mut number = 0;
    while control.plant.report.ticks < ticks {
        let lost = control.plant.burst();
        control.plant.report.states_lost += u64::try_from(lost)?;
        for _ in 0..lost {
            control.plant.step(moves, &speeds)?;
        }
        let elapsed = control.plant.report.ticks;
        hand.at(elapsed, &mut control.plant, taxels)?;
        let mut forces_n = [0.0; TAXELS];
        forces_n.iter_mut().zip(control.plant.world.taxel_force_true_n()).for_each(|(felt, n)| *felt = *n);
        let now_ns = elapsed * 1_000_000;
        control.cover.take_forces(now_ns, &forces_n);
        let request = match mode {
            Mode::ProtectiveStop => Some(Request::Resume),
            Mode::Ready if forces_n.iter().all(|force_n| *force_n <= 0.0) => Some(Request::Arm),
            Mode::Impedance if control.plant.random.one_in(20_000) => Some(Request::SelectLaw(Law::FollowMe)),
            Mode::FollowMe if control.plant.random.one_in(20_000) => Some(Request::SelectLaw(Law::Impedance)),
            _ => None,
        };
        let slot = Slot { tick: number, now_ns, ticks: 1 + u64::try_from(lost)?, ..Slot::default() };
        number += 1;
        let sample = control.tick(&slot, request, &mut Untimed).sample.clone();
        ensure!(sample.mode != Mode::Fault, "{:?} after {elapsed} ms", sample.fault);
        (mode, moves) = (sample.mode, sample.mode.moves());
        control.plant.step(moves, &speeds)?;
    }
    Ok(control.plant.report)
}

#[test]
fn lost_packets_keep_torque_rate_and_speeds_in_limits() {
    let report = campaign(60_000, 7).unwrap();
    assert!(report.largest_rate_nm_s <= 1e3 * ARM_CHANGE_NM, "reached the arm: {report:?}");
    assert!(report.largest_share_of_joint_speed <= 1.0, "{report:?}");
    assert!(report.states_lost > 2000 && report.orders_lost > 2000 && report.presses > 20, "{report:?}");
    assert!(
        report.driven > 40_000 && report.largest_rate_nm_s > 100.0,
        "a run that shows nothing: {report:?}"
    );
}
