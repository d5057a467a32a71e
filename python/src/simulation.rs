//! A simulated robot in lock-step: bytes, law and plant as in `mocad --as-fast-as-possible`.

use crate::gripper;
use crate::request::{answered, counted, plain, policy, press, target, waypoints};
use crate::state::State;
use crate::world::{World, configuration};
use moca_msgs::target::MAX_WAYPOINTS;
use moca_msgs::{GripperRequest, GripperState, Refusal, Request};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use std::path::PathBuf;
use std::sync::{Mutex, PoisonError};

/// Ticks between two looks for Ctrl-C.
const SIGNALS_EVERY: u64 = 1000;

/// A robot; other Python threads run while it steps.
#[pyclass(module = "moca._moca")]
pub struct Simulation {
    // Python asks for a type that threads may share. Only `&mut self` reaches the robot, so no lock is ever taken.
    world: Mutex<World>,
    period_s: f64,
    /// Number of taxels.
    taxels: usize,
}

#[pymethods]
impl Simulation {
    #[new]
    #[pyo3(signature = (path=None, toml=None, seed=None))]
    fn new(path: Option<PathBuf>, toml: Option<&str>, seed: Option<u64>) -> PyResult<Self> {
        let mut config = configuration(path.as_deref(), toml)?;
        if let Some(seed) = seed {
            config.simulation.seed = seed;
        }
        let taxels = config.robot.cover.count();
        let period_s = 1.0 / f64::from(config.control_loop.rate_hz);
        let world = World::new(&config).map_err(PyValueError::new_err)?;
        Ok(Self { world: Mutex::new(world), period_s, taxels })
    }

    #[getter]
    fn period_s(&self) -> f64 {
        self.period_s
    }

    /// Steps a number of ticks and returns the last one's state.
    fn step(&mut self, py: Python<'_>, ticks: u64) -> PyResult<State> {
        if ticks == 0 {
            return Err(PyValueError::new_err("ticks = 0: allowed: 1 or more"));
        }
        let mut left = ticks - 1;
        let world = self.world();
        loop {
            py.check_signals()?;
            let now = left.min(SIGNALS_EVERY);
            left -= now;
            let last = py.detach(|| {
                for _ in 0..now {
                    world.tick(None);
                }
                (left == 0).then(|| world.tick(None).sample.clone())
            });
            if let Some(sample) = last {
                return Ok(State(sample));
            }
        }
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

    /// Asks the gripper, and steps until its fingers rest, or one tick if `wait` is false. Returns true if an object is held.
    fn gripper(&mut self, py: Python<'_>, name: &str, values: Vec<f64>, wait: bool) -> PyResult<bool> {
        let asked = gripper::request(name, &values)?;
        let begun = self.ask(Request::Gripper(asked))?.0.gripper.ok_or_else(gripper::missing)?;
        let state = if wait { self.rest(py, begun)? } else { begun };
        gripper::held(asked, &state)
    }

    fn gripper_state(&mut self) -> PyResult<gripper::Fields> {
        self.world().gripper().as_ref().map(gripper::fields).ok_or_else(gripper::missing)
    }
}

impl Simulation {
    fn world(&mut self) -> &mut World {
        self.world.get_mut().unwrap_or_else(PoisonError::into_inner)
    }

    /// Steps until the fingers, which `state` is of, rest. A signal stops them.
    fn rest(&mut self, py: Python<'_>, mut state: GripperState) -> PyResult<GripperState> {
        while gripper::moves(&state) {
            py.check_signals().inspect_err(|_| {
                // The signal is what the caller hears of.
                let _ = self.ask(Request::Gripper(GripperRequest::Stop));
            })?;
            let world = self.world();
            py.detach(|| {
                for _ in 0..SIGNALS_EVERY {
                    if !gripper::moves(&state) {
                        break;
                    }
                    state = world.tick(None).sample.gripper.unwrap_or_default();
                }
            });
        }
        Ok(state)
    }

    /// A request takes a tick.
    fn ask(&mut self, request: Request) -> PyResult<State> {
        let ticked = self.world().tick(Some(request));
        answered(request, ticked.input.outcome.unwrap_or(Err(Refusal::NoAnswer)))?;
        Ok(State(ticked.sample.clone()))
    }
}
