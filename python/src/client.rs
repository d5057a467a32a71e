//! A running daemon. Only a call of the program's own is a sign of life: a program that hangs loses the command.

use crate::request::{answered, plain, policy, target, waypoints};
use crate::state::State;
use crate::{Disconnected, Refused};
use moca_msgs::{Outcome, Request, Sample};
use moca_telemetry::net::{Address, Connection, Link, Update};
use moca_telemetry::{ParameterValue, RobotDescription};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use std::collections::VecDeque;
use std::sync::Arc;
use std::time::{Duration, Instant};

/// How long a daemon may take to greet, to answer or to say something new.
const PATIENCE: Duration = Duration::from_secs(3);
const LOOK_EVERY: Duration = Duration::from_micros(200);

#[pyclass(module = "moca._moca")]
pub struct Client {
    connection: Connection,
    description: Arc<RobotDescription>,
    samples: VecDeque<Sample>,
}

#[pymethods]
impl Client {
    #[new]
    fn new(py: Python<'_>, address: &str) -> PyResult<Self> {
        let address: Address =
            address.parse().map_err(|error| PyValueError::new_err(format!("{address}: {error}")))?;
        let connection = Connection::spawn(address.clone(), || {}).map_err(|e| Disconnected::new_err(e.to_string()))?;
        let until = Instant::now() + PATIENCE;
        loop {
            match connection.poll().link {
                Link::Up { description, .. } => {
                    return Ok(Self { connection, description, samples: VecDeque::new() });
                }
                Link::Down { reason } if Instant::now() >= until => {
                    return Err(Disconnected::new_err(format!("{address}: {reason}")));
                }
                Link::Down { .. } => py.detach(|| std::thread::sleep(LOOK_EVERY)),
            }
            py.check_signals()?;
        }
    }

    #[getter]
    fn name(&self) -> &str {
        &self.description.name
    }

    /// Name, present value and unit of each parameter.
    fn parameters(&mut self) -> PyResult<Vec<(String, Vec<f64>, String)>> {
        self.poll()?;
        let numbers = self.description.parameters.iter().filter_map(|parameter| match &parameter.value {
            ParameterValue::Numbers(values) => {
                Some((parameter.name.clone(), values.clone(), parameter.units.join(", ")))
            }
            ParameterValue::Text(_) => None,
        });
        Ok(numbers.collect())
    }

    fn set_parameter(&mut self, py: Python<'_>, name: &str, values: Vec<f64>) -> PyResult<()> {
        let found = self.description.parameters.iter().position(|parameter| parameter.name == name);
        let number = found.ok_or_else(|| PyValueError::new_err(format!("no parameter is called {name:?}")))?;
        let values = self.description.parameters[number].checked(&values).map_err(PyValueError::new_err)?;
        let parameter = u8::try_from(number).map_err(|error| PyValueError::new_err(error.to_string()))?;
        let outcome = self.ask(py, Request::SetParameter { parameter, values })?;
        let parameter = &self.description.parameters[number];
        outcome.map_err(|refusal| Refused::new_err(parameter.why(refusal)))
    }

    /// The next state; every one of them, in order, as long as it is asked for at least once in ten seconds.
    fn next(&mut self, py: Python<'_>) -> PyResult<State> {
        let until = Instant::now() + PATIENCE;
        loop {
            if let Some(sample) = self.samples.pop_front() {
                self.connection.alive();
                return Ok(State(sample));
            }
            self.poll()?;
            if self.samples.is_empty() {
                if Instant::now() >= until {
                    return Err(Disconnected::new_err("the daemon sends nothing new"));
                }
                py.detach(|| std::thread::sleep(LOOK_EVERY));
                py.check_signals()?;
            }
        }
    }

    /// The newest state; those before it are skipped.
    fn latest(&mut self, py: Python<'_>) -> PyResult<State> {
        self.poll()?;
        match self.samples.drain(..).last() {
            Some(sample) => Ok(State(sample)),
            None => self.next(py),
        }
    }

    fn request(&mut self, py: Python<'_>, name: &str) -> PyResult<()> {
        answered(self.ask(py, plain(name)?)?)
    }

    fn target(
        &mut self,
        py: Python<'_>,
        kind: &str,
        values: Vec<f64>,
        stamp_unix_ns: u64,
        age_limit_s: f64,
        touch: &str,
    ) -> PyResult<()> {
        answered(self.ask(py, target(kind, &values, stamp_unix_ns, age_limit_s, touch)?)?)
    }

    fn trajectory(&mut self, py: Python<'_>, rows: Vec<f64>, touch: &str) -> PyResult<()> {
        let (waypoints, touch) = (waypoints(&rows)?, policy(touch)?);
        if waypoints.is_empty() {
            return Err(PyValueError::new_err("a trajectory without poses"));
        }
        self.connection.trajectory(touch, waypoints);
        answered(self.answer(py)?)
    }

    fn press(&mut self, py: Python<'_>, taxel: u8, force_n: f64) -> PyResult<()> {
        answered(self.ask(py, Request::PressTaxel { taxel, force_n })?)
    }

    /// Gives the command back.
    fn release(&self) {
        self.connection.release();
    }
}

impl Client {
    fn ask(&mut self, py: Python<'_>, request: Request) -> PyResult<Outcome> {
        self.connection.request(request);
        self.answer(py)
    }

    /// The answer to the only request on its way.
    fn answer(&mut self, py: Python<'_>) -> PyResult<Outcome> {
        let until = Instant::now() + PATIENCE;
        while Instant::now() < until {
            if let Some(reply) = self.poll()?.replies.first() {
                return Ok(reply.outcome);
            }
            py.detach(|| std::thread::sleep(LOOK_EVERY));
            py.check_signals()?;
        }
        Err(Disconnected::new_err("the daemon does not answer"))
    }

    fn poll(&mut self) -> PyResult<Update> {
        self.connection.alive();
        let mut update = self.connection.poll();
        match &update.link {
            Link::Up { description, .. } => self.description = Arc::clone(description),
            Link::Down { reason } => return Err(Disconnected::new_err(reason.clone())),
        }
        self.samples.extend(update.samples.drain(..));
        let excess = self.samples.len().saturating_sub(10_000);
        self.samples.drain(..excess);
        Ok(update)
    }
}
