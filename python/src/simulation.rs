//! A simulated robot in lock-step: bytes, law and plant as in `mocad --as-fast-as-possible`.

use crate::request::{answered, counted, plain, policy, press, target, waypoints};
use crate::state::State;
use moca_control::config::Config;
use moca_daemon::devices::simulated_robot::free_scene;
use moca_daemon::devices::touch_board::ByteCover;
use moca_daemon::runtime::assemble::board_config;
use moca_daemon::runtime::lockstep::{LockStep, MemoryBoards, NoCover};
use moca_msgs::target::MAX_WAYPOINTS;
use moca_msgs::{Outcome, Refusal, Request, Sample};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use std::path::PathBuf;

/// Ticks between two looks for Ctrl-C.
const SIGNALS_EVERY: u64 = 1000;

enum World {
    Covered(LockStep<ByteCover, MemoryBoards>),
    Bare(LockStep<Option<ByteCover>, NoCover>),
}

/// Not to be handed from thread to thread: the physics is one thread's.
#[pyclass(unsendable, module = "moca._moca")]
pub struct Simulation {
    world: World,
    period_s: f64,
    /// Number of taxels.
    taxels: usize,
}

#[pymethods]
impl Simulation {
    #[new]
    #[pyo3(signature = (path=None, toml=None, seed=None))]
    fn new(path: Option<PathBuf>, toml: Option<&str>, seed: Option<u64>) -> PyResult<Self> {
        let wrong = |error: String| PyValueError::new_err(error);
        let mut config = match (path, toml) {
            (None, None) => Config::default(),
            (Some(path), None) => {
                // A missing file is Python's own exception.
                std::fs::metadata(&path).map_err(|error| {
                    std::io::Error::new(error.kind(), format!("{}: {error}", path.display()))
                })?;
                Config::load(&path).map_err(|error| wrong(format!("{}:\n{error}", path.display())))?
            }
            (None, Some(text)) => Config::parse(text).map_err(|error| wrong(error.to_string()))?,
            (Some(_), Some(_)) => return Err(wrong("a file or a text, not both".into())),
        };
        if let Some(seed) = seed {
            config.simulation.seed = seed;
        }
        let taxels = config.robot.cover.count();
        let scene = free_scene(&config);
        let world = if config.plant.parts.has_cover() {
            LockStep::with_board(&config, &scene, board_config(&config), None)
                .map(|w| World::Covered(w.untimed()))
        } else {
            LockStep::without_cover(&config, &scene).map(|w| World::Bare(w.untimed()))
        };
        let period_s = 1.0 / f64::from(config.control_loop.rate_hz);
        Ok(Self { world: world.map_err(|error| wrong(format!("{error:#}")))?, period_s, taxels })
    }

    #[getter]
    fn period_s(&self) -> f64 {
        self.period_s
    }

    /// Steps a number of ticks and returns the last one's state.
    fn step(&mut self, py: Python<'_>, ticks: u64) -> PyResult<State> {
        let mut last = None;
        for done in 0..ticks {
            if done % SIGNALS_EVERY == 0 {
                py.check_signals()?;
            }
            last = Some(self.tick(None).0);
        }
        last.map(State).ok_or_else(|| PyValueError::new_err("ticks = 0: allowed: 1 or more"))
    }

    fn request(&mut self, name: &str) -> PyResult<State> {
        self.ask(plain(name)?)
    }

    fn target(&mut self, kind: &str, values: Vec<f64>, age_limit_s: f64, touch: &str) -> PyResult<State> {
        // Lock-step knows no clock: a target is decided in the tick that takes it.
        self.ask(target(kind, &values, 0, age_limit_s, touch)?)
    }

    fn trajectory(&mut self, rows: Vec<f64>, touch: &str) -> PyResult<State> {
        let (waypoints, touch) = (waypoints(&rows)?, policy(touch)?);
        let few = || counted(waypoints.len(), "poses of a trajectory", MAX_WAYPOINTS);
        let count = u8::try_from(waypoints.len()).map_err(|_| few())?;
        let mut last = None;
        for (index, waypoint) in (0..count).zip(&waypoints) {
            last = Some(self.ask(Request::Waypoint { index, count, waypoint: *waypoint, touch })?);
        }
        last.ok_or_else(few)
    }

    fn press(&mut self, taxel: u8, force_n: f64) -> PyResult<State> {
        self.ask(press(taxel, force_n, self.taxels)?)
    }
}

impl Simulation {
    fn tick(&mut self, request: Option<Request>) -> (Sample, Option<Outcome>) {
        match &mut self.world {
            World::Covered(world) => world.step(request),
            World::Bare(world) => world.step(request),
        }
    }

    /// A request takes a tick.
    fn ask(&mut self, request: Request) -> PyResult<State> {
        let (sample, outcome) = self.tick(Some(request));
        answered(request, outcome.unwrap_or(Err(Refusal::NoAnswer)))?;
        Ok(State(sample))
    }
}
