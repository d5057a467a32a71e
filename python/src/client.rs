//! A running daemon. Only a call of the program's own is a sign of life: a program that hangs loses the command.

use crate::request::{answered, plain, policy, target, waypoints};
use crate::state::State;
use crate::{Disconnected, Refused};
use moca_msgs::{Outcome, Request, Sample};
use moca_telemetry::net::{Address, Connection, Link, Reply};
use moca_telemetry::{ParameterValue, RobotDescription};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use std::collections::VecDeque;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

/// How long a daemon may take to greet, to answer or to say something new.
const PATIENCE: Duration = Duration::from_secs(3);
const LOOK_EVERY: Duration = Duration::from_micros(200);

/// Answers that nobody took are forgotten beyond so many.
const MAX_REPLIES: usize = 64;

/// Threads may share it: one may stop the robot while another one waits for a state.
#[pyclass(frozen, module = "moca._moca")]
pub struct Client {
    /// Nothing once it is closed.
    connection: Mutex<Option<Arc<Connection>>>,
    heard: Mutex<Heard>,
}

/// What the daemon has said and nobody has taken yet.
struct Heard {
    description: Arc<RobotDescription>,
    samples: VecDeque<Sample>,
    replies: VecDeque<Reply>,
}

#[pymethods]
impl Client {
    /// Without an address the service's socket, or where there is none the port that `mocad` listens at.
    #[new]
    #[pyo3(signature = (address=None))]
    fn new(py: Python<'_>, address: Option<&str>) -> PyResult<Self> {
        let address: Address = match address {
            Some(text) => text.parse().map_err(|error| PyValueError::new_err(format!("{text}: {error}")))?,
            None => Address::of_this_machine(),
        };
        let connection =
            Connection::spawn(address.clone(), || {}).map_err(|e| Disconnected::new_err(e.to_string()))?;
        let until = Instant::now() + PATIENCE;
        loop {
            match connection.poll().link {
                Link::Up { description, .. } => {
                    let (samples, replies) = Default::default();
                    let heard = Mutex::new(Heard { description, samples, replies });
                    return Ok(Self { connection: Mutex::new(Some(Arc::new(connection))), heard });
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
    fn name(&self) -> String {
        self.heard().description.name.to_string()
    }

    /// Name, present value and unit of each parameter.
    fn parameters(&self) -> PyResult<Vec<(String, Vec<f64>, String)>> {
        let description = Arc::clone(&self.poll()?.description);
        let numbers = description.parameters.iter().filter_map(|parameter| match &parameter.value {
            ParameterValue::Numbers(values) => {
                Some((parameter.name.clone(), values.clone(), parameter.units.join(", ")))
            }
            ParameterValue::Text(_) => None,
        });
        Ok(numbers.collect())
    }

    fn set_parameter(&self, py: Python<'_>, name: &str, values: Vec<f64>) -> PyResult<()> {
        let description = Arc::clone(&self.heard().description);
        let found = description.parameters.iter().position(|parameter| parameter.name == name);
        let number =
            found.ok_or_else(|| PyValueError::new_err(format!("no parameter is called {name:?}")))?;
        let values = description.parameters[number].checked(&values).map_err(PyValueError::new_err)?;
        let parameter = u8::try_from(number).map_err(|error| PyValueError::new_err(error.to_string()))?;
        let outcome = self.ask(py, Request::SetParameter { parameter, values })?;
        let parameter = &description.parameters[number];
        outcome.map_err(|refusal| Refused::new_err(parameter.why(refusal)))
    }

    /// The next state; every one of them, in order, as long as it is asked for at least once in ten seconds.
    fn next(&self, py: Python<'_>) -> PyResult<State> {
        let until = Instant::now() + PATIENCE;
        loop {
            if let Some(sample) = self.heard().samples.pop_front() {
                self.connection()?.alive();
                return Ok(State(sample));
            }
            if self.poll()?.samples.is_empty() {
                self.wait(py, until, "the daemon sends nothing new")?;
            }
        }
    }

    /// The newest state; those before it are skipped.
    fn latest(&self, py: Python<'_>) -> PyResult<State> {
        let newest = self.poll()?.samples.drain(..).last();
        newest.map_or_else(|| self.next(py), |sample| Ok(State(sample)))
    }

    fn request(&self, py: Python<'_>, name: &str) -> PyResult<()> {
        answered(self.ask(py, plain(name)?)?)
    }

    fn target(
        &self,
        py: Python<'_>,
        kind: &str,
        values: Vec<f64>,
        stamp_unix_ns: u64,
        age_limit_s: f64,
        touch: &str,
    ) -> PyResult<()> {
        answered(self.ask(py, target(kind, &values, stamp_unix_ns, age_limit_s, touch)?)?)
    }

    fn trajectory(&self, py: Python<'_>, rows: Vec<f64>, touch: &str) -> PyResult<()> {
        let (waypoints, touch) = (waypoints(&rows)?, policy(touch)?);
        if waypoints.is_empty() {
            return Err(PyValueError::new_err("a trajectory without poses"));
        }
        self.connection()?.trajectory(touch, waypoints);
        answered(self.answer(py, |request| matches!(request, Request::Waypoint { .. }))?)
    }

    fn press(&self, py: Python<'_>, taxel: u8, force_n: f64) -> PyResult<()> {
        answered(self.ask(py, Request::PressTaxel { taxel, force_n })?)
    }

    /// Gives the command back.
    fn release(&self) -> PyResult<()> {
        self.connection()?.release();
        Ok(())
    }

    /// Gives the command back and ends the connection: what was said before has been sent when this returns.
    fn close(&self, py: Python<'_>) {
        let connection = self.connection.lock().unwrap_or_else(PoisonError::into_inner).take();
        if let Some(connection) = connection {
            connection.release();
            py.detach(|| drop(connection));
        }
    }
}

impl Client {
    fn heard(&self) -> MutexGuard<'_, Heard> {
        self.heard.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn connection(&self) -> PyResult<Arc<Connection>> {
        let connection = self.connection.lock().unwrap_or_else(PoisonError::into_inner);
        connection.clone().ok_or_else(|| Disconnected::new_err("the connection is closed"))
    }

    fn ask(&self, py: Python<'_>, request: Request) -> PyResult<Outcome> {
        self.connection()?.request(request);
        self.answer(py, |asked| *asked == request)
    }

    /// The answer to the request that is meant, whatever else is on its way.
    fn answer(&self, py: Python<'_>, is_meant: impl Fn(&Request) -> bool) -> PyResult<Outcome> {
        let until = Instant::now() + PATIENCE;
        loop {
            let mut heard = self.poll()?;
            let place = heard.replies.iter().position(|reply| is_meant(&reply.request));
            if let Some(reply) = place.and_then(|place| heard.replies.remove(place)) {
                return Ok(reply.outcome);
            }
            drop(heard);
            self.wait(py, until, "the daemon does not answer")?;
        }
    }

    /// Lets other threads run for a moment.
    fn wait(&self, py: Python<'_>, until: Instant, why: &'static str) -> PyResult<()> {
        if Instant::now() >= until {
            return Err(Disconnected::new_err(why));
        }
        py.detach(|| std::thread::sleep(LOOK_EVERY));
        py.check_signals()
    }

    fn poll(&self) -> PyResult<MutexGuard<'_, Heard>> {
        let connection = self.connection()?;
        connection.alive();
        let mut heard = self.heard();
        let update = connection.poll();
        match update.link {
            Link::Up { description, .. } => heard.description = description,
            Link::Down { reason } => return Err(Disconnected::new_err(reason)),
        }
        heard.samples.extend(update.samples);
        let excess = heard.samples.len().saturating_sub(10_000);
        heard.samples.drain(..excess);
        heard.replies.extend(update.replies);
        let excess = heard.replies.len().saturating_sub(MAX_REPLIES);
        heard.replies.drain(..excess);
        Ok(heard)
    }
}
