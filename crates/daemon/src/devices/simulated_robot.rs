//! The simulated robot as a plant, and the shared forces its virtual board reads.

use crate::config::{Config, HandConfig};
use crate::control::plant::{Plant, Simulated, SourceAge};
use crate::devices::scripted_press::scripted_press;
use crate::inject::{FaultSite, Injection, PlantSpoiler};
use crate::robot::{FoamKind, JOINTS, Parts, TAXELS};
use moca_msgs::request::PRESS_FORCE_MAX_N;
use moca_msgs::{Actuation, Fault, Outcome, Refusal, RobotState};
use moca_sim::foam::{ElasticLaw, Foam};
use moca_sim::scene::Robot;
use moca_sim::{Integrator, Scene, SharedForces, SimError, SimPlant};
use moca_tactile::cover::Electrode;
use std::sync::atomic::Ordering;
use std::time::Duration;

/// After a longer stall the simulation falls behind the wall clock instead of freezing the loop.
const CATCH_UP_MAX_TICKS: u64 = 20;

/// Longest physics step, s.
const STEP_MAX_S: f64 = 1e-3;

/// The free robot with the parts it has, stepped at the control rate of `config`.
pub fn free_scene(config: &Config) -> Scene {
    let control_period_s = 1.0 / f64::from(config.control_loop.rate_hz);
    let substeps = (control_period_s / STEP_MAX_S - 1e-9).ceil().max(1.0);
    let robot = match config.plant.parts {
        Parts::Whole => Robot::MobileManipulator,
        Parts::Base => Robot::BaseOnly,
        Parts::Arm => Robot::ArmOnly,
    };
    let accuracy = Some(config.simulation.accuracy).filter(|accuracy| *accuracy > 0.0);
    Scene {
        robot,
        accuracy,
        integrator: if accuracy.is_some() { Integrator::Leapfrog } else { Integrator::default() },
        arm_posture_rad: config.control.gains.posture_rad,
        payload: config.robot.payload(),
        foam: foam(config),
        control_period_s,
        physics_step_s: control_period_s / substeps,
        ..Scene::new(config.arm(), &config.robot.base, &config.robot.mount, &config.robot.cover.placements())
    }
}

/// The foam under the cover.
pub fn foam(config: &Config) -> Foam {
    match config.robot.cover.foam {
        FoamKind::PuLd30 => Foam::PU_LD30,
        FoamKind::Cc => Foam::CC,
        FoamKind::Pe5 => Foam::PE5,
        FoamKind::Pe3 => Foam::PE3,
        FoamKind::Hyperbolic => {
            let cover = &config.robot.cover;
            Foam {
                gap_m: cover.foam_thickness_m,
                elastic: ElasticLaw::Hyperbolic { stiffness_n_per_m: cover.foam_stiffness_n_m },
                ..Foam::COLLISION_ASSUMED
            }
        }
    }
}

/// MuJoCo behind the [`Plant`] trait, with the hands that press it.
pub struct SimulatedRobot {
    /// The simulated world.
    pub world: SimPlant,
    hand: HandConfig,
    covered: bool,
    asked_n: [f64; TAXELS],
    /// The taxel that the scripted hand pressed in the last step.
    scripted: Option<usize>,
    taxels: usize,
    wiring: Vec<Electrode>,
    command_timeout_s: f64,
    spoiler: Option<PlantSpoiler>,
    stall: Option<(u64, u64)>,
    shared: Vec<SharedForces>,
    period_s: f64,
    ticks: u64,
    measured: bool,
}

impl SimulatedRobot {
    /// Builds the scene; the forces of each virtual board are told to `shared`.
    ///
    /// # Errors
    /// MuJoCo refused the scene.
    pub fn new(config: &Config, scene: &Scene, shared: Vec<SharedForces>) -> Result<Self, SimError> {
        let world = SimPlant::new(scene)?;
        let period_s = 1.0 / f64::from(config.control_loop.rate_hz);
        let covered = config.plant.parts.has_cover();
        let hand = if covered { config.simulation.hand.clone() } else { HandConfig::none() };
        Ok(Self {
            world,
            hand,
            covered,
            asked_n: [0.0; TAXELS],
            scripted: None,
            taxels: config.robot.cover.count(),
            wiring: config.robot.cover.wiring(),
            command_timeout_s: config.robot.base.command_timeout_s,
            spoiler: None,
            stall: None,
            shared,
            period_s,
            ticks: 0,
            measured: false,
        })
    }

    /// Tells of its state what a real robot's sensors would ([`RobotState::in_single_precision`]), so that a log of it costs
    /// what theirs does.
    #[must_use]
    pub const fn as_sensors_tell(mut self) -> Self {
        self.measured = true;
        self
    }

    /// Lets the robot fail, or in real time stall the loop; other faults do nothing here.
    pub fn inject(&mut self, injection: &Injection) {
        let period = Duration::from_secs_f64(self.period_s).as_nanos().max(1);
        let at_tick = u64::try_from(u128::from(injection.at_ns) / period).unwrap_or(u64::MAX);
        match injection.fault.site {
            FaultSite::Plant(fault) => self.spoiler = Some(PlantSpoiler::new(fault, at_tick)),
            FaultSite::MissedSlots(slots) => self.stall = Some((at_tick, slots)),
            FaultSite::Cable(_) | FaultSite::Outside(_) => {}
        }
    }

    fn tell_boards(&self) {
        for (wire, force_n) in self.wiring.iter().zip(self.world.taxel_force_true_n()) {
            let board = self.shared.get(usize::from(wire.board));
            if let Some(cell) = board.and_then(|forces| forces.get(usize::from(wire.electrode))) {
                cell.store(force_n.to_bits(), Ordering::Relaxed);
            }
        }
    }

    fn step(&mut self) -> Result<(), SimError> {
        #[expect(clippy::cast_precision_loss, reason = "tick counts are far below 2^53")]
        let scripted = scripted_press(&self.hand, self.ticks as f64 * self.period_s);
        let let_go = self.scripted.map(|taxel| (taxel, 0.0));
        for (taxel, force_n) in let_go.into_iter().chain(scripted) {
            self.world.press(taxel, self.asked_n.get(taxel).unwrap_or(&0.0) + force_n)?;
        }
        self.scripted = scripted.map(|(taxel, _)| taxel);
        self.ticks += 1;
        self.world.step()
    }
}

impl Plant for SimulatedRobot {
    fn read(&mut self) -> Result<RobotState<JOINTS>, Fault> {
        match &mut self.spoiler {
            Some(spoiler) => spoiler.read(self.world.state()),
            None => Ok(self.world.state()),
        }
    }

    fn age(&self) -> SourceAge {
        self.spoiler.as_ref().map(PlantSpoiler::age).unwrap_or_default()
    }

    fn write(&mut self, actuation: &Actuation<JOINTS>, ticks: u64) -> Result<(), Fault> {
        self.world.apply(actuation).map_err(|_| Fault::ControlRefused)?;
        for tick in 0..ticks.min(CATCH_UP_MAX_TICKS) {
            #[expect(clippy::cast_precision_loss, reason = "at most twenty")]
            if tick as f64 * self.period_s >= self.command_timeout_s {
                self.world.stop_base();
            }
            self.step().map_err(|_| Fault::PlantLost)?;
        }
        if !self.shared.is_empty() {
            self.tell_boards();
        }
        if let Some((_, slots)) = self.stall.take_if(|(at, _)| self.ticks >= *at) {
            #[expect(clippy::cast_precision_loss, reason = "a count of missed slots")]
            std::thread::sleep(Duration::from_secs_f64(slots as f64 * self.period_s));
        }
        self.spoiler.as_mut().map_or(Ok(()), |spoiler| spoiler.write(ticks, self.period_s))
    }

    fn simulated(&mut self) -> Option<&mut dyn Simulated> {
        Some(self)
    }

    fn is_exact(&mut self) -> bool {
        !self.measured
    }
}

impl Simulated for SimulatedRobot {
    fn press(&mut self, taxel: usize, force_n: f64) -> Outcome {
        let is_there = self.covered && taxel < self.taxels;
        let asked = self.asked_n.get_mut(taxel).filter(|_| is_there).ok_or(Refusal::OutOfRange)?;
        if !(0.0..=PRESS_FORCE_MAX_N).contains(&force_n) {
            return Err(Refusal::OutOfRange);
        }
        *asked = force_n;
        self.world.press(taxel, force_n).map_err(|_| Refusal::OutOfRange)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn one_tick_is_one_control_period_at_every_rate() {
        for rate_hz in [100, 300, 1000, 4000] {
            let mut config = Config::default();
            config.control_loop.rate_hz = rate_hz;
            let mut robot = SimulatedRobot::new(&config, &free_scene(&config), Vec::new()).unwrap();
            for _ in 0..rate_hz {
                robot.step().unwrap();
            }
            assert!((robot.world.time_s() - 1.0).abs() < 1e-6, "{rate_hz} Hz: {} s", robot.world.time_s());
        }
    }
}
