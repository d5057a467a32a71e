//! Attacks on a robot in lock-step.

use super::{Kind, Row};
use crate::robustness::cover_speed::{Inertia, Pushes};
use crate::robustness::hands::{Hands, press};
use crate::robustness::watch::{Findings, STOP_TICKS, Watch};
use anyhow::Result;
use moca_experiments::unattended;
use moca_lockstep::simulated_robot::free_scene;
use moca_lockstep::touch_board::ByteCover;
use moca_lockstep::{LockStep, MemoryBoards};
use moca_msgs::{Law, Mode, Request};
use moca_sim::VirtualBoardConfig;

/// Ticks of a second, and the length of one.
const SECOND: u64 = 1000;
const PERIOD_S: f64 = 1e-3;
/// Power-up, tare and arming take less.
const START_TICKS: u64 = 6 * SECOND;
/// Ticks in which a lean reaches its force.
const RISE_TICKS: u64 = SECOND / 2;
/// After a lean or program nobody touches the robot for so long, ticks: the base has to rest for most of it.
const CALM_TICKS: u64 = 12 * SECOND;
/// An operator brings the robot back to a law within this, ticks.
const EXIT_TICKS: u64 = 30 * SECOND;
/// In a program everybody lets go for a while this often, ticks.
const CALM_EVERY: u64 = 120 * SECOND;

struct World {
    world: LockStep<ByteCover, MemoryBoards>,
    watch: Watch,
    inertia: Inertia,
    hands: Hands,
    law: Law,
    tick: u64,
}

impl World {
    fn new(row: &Row) -> Result<Self> {
        let mut config = unattended(row.law);
        config.simulation.seed = row.seed;
        config.startup.arm = false;
        config.board.firmware = row.firmware;
        let board =
            VirtualBoardConfig { seed: row.seed, firmware: row.firmware, ..VirtualBoardConfig::default() };
        let world = LockStep::with_board(&config, &free_scene(&config), board, None)?;
        let hands = Hands::new(row.seed).with_programs(&config);
        Ok(Self {
            world,
            watch: Watch::new(&config)?,
            inertia: Inertia::default(),
            hands,
            law: row.law,
            tick: 0,
        })
    }

    /// One tick with this request and, without it, whatever the hands ask.
    fn step(&mut self, request: Option<Request>, leaned: bool) {
        let by_hand = || self.hands.act(self.tick, &mut self.world, self.watch.last.as_ref());
        let request = request.or_else(by_hand);
        let (sample, _) = self.world.step(request);
        let touches = leaned || !self.hands.touches_nothing();
        let plant = &mut self.world.control.plant.world;
        let inertia_world = self.inertia.after(plant, PERIOD_S);
        let pushes = Pushes { taxel_force_n: plant.taxel_force_mean_n(), inertia_world };
        self.watch.look(&sample, request, touches, &pushes);
        self.tick += 1;
    }

    fn mode(&self) -> Mode {
        self.watch.last.as_ref().map_or(Mode::Starting, |sample| sample.mode)
    }

    /// Nobody touches, nothing breaks, and only the operator acts until the law of the row moves the robot.
    fn recover(&mut self) {
        self.hands.calm_down(self.tick);
        let begin = self.tick;
        while !(self.mode().moves() && self.hands.touches_nothing()) {
            if self.tick - begin > EXIT_TICKS {
                let last = self.watch.last.as_ref();
                let (mode, fault) = last.map(|sample| (sample.mode, sample.fault)).unwrap_or_default();
                self.watch.findings.violation(format!("no way out of {mode:?} ({fault:?}) in 30 s"));
                return;
            }
            self.step(None, false);
        }
        self.step(Some(Request::SelectLaw(self.law)), false);
    }

    /// Nobody does anything: the base rests.
    fn calm(&mut self, ticks: u64) {
        self.hands.calm_down(self.tick);
        (0..ticks).for_each(|_| self.step(None, false));
    }

    /// A stop in whatever mode, obeyed in time, and the way back.
    fn stop(&mut self, leaned: bool) {
        self.step(Some(Request::Stop), leaned);
        (0..=STOP_TICKS).for_each(|_| self.step(None, leaned));
    }

    fn lean(&mut self, taxel: usize, force_n: f64, ticks: u64) {
        let place = taxel - 1;
        for tick in 0..ticks {
            let rise = u32::try_from(tick.min(RISE_TICKS)).unwrap_or(0);
            let force_n = force_n * f64::from(rise) / 500.0;
            let request = (tick <= RISE_TICKS).then(|| press(place, force_n));
            // Whoever leans goes on, whatever the robot does.
            self.step(request, true);
        }
        self.step(Some(press(place, 0.0)), false);
    }

    fn program(&mut self, ticks: u64) {
        for tick in 0..ticks {
            if tick % CALM_EVERY == CALM_EVERY - 1 {
                self.recover();
                self.calm(CALM_TICKS);
                self.hands.wake_up(self.tick);
            }
            self.step(None, false);
        }
    }

    fn storm(&mut self, ticks: u64) {
        self.step(Some(press(5, 30.0)), true);
        for _ in 0..ticks {
            let request = self.hands.hasty();
            self.step(Some(request), true);
        }
        self.step(Some(press(5, 0.0)), false);
    }
}

/// Runs one row.
///
/// # Errors
/// The scene could not be built.
pub(super) fn run(row: &Row) -> Result<Findings> {
    #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "10 to 36 000 s")]
    let ticks = (row.seconds * 1e3) as u64;
    let mut world = World::new(row)?;
    world.calm(START_TICKS);
    world.recover();
    match row.kind {
        Kind::Lean { taxel, force_n } => world.lean(taxel, force_n, ticks),
        Kind::Storm => world.storm(ticks),
        Kind::Program | Kind::Network(_) => {
            world.hands.wake_up(world.tick);
            world.program(ticks);
        }
    }
    // The base rests where it was let go, and the robot comes back from wherever it ended.
    world.calm(CALM_TICKS);
    world.recover();
    world.stop(false);
    world.recover();
    Ok(world.watch.findings)
}
