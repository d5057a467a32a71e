//! A running daemon. Only a call of the program's own is a sign of life: a program that hangs loses the command.

use crate::gripper;
use crate::request::{answered, plain, policy, press, target, waypoints};
use crate::state::State;
use crate::{Disconnected, Refused};
use moca_msgs::{GripperPhase, GripperRequest, GripperState, Outcome, Request, Sample};
use moca_telemetry::net::client::stop_blocking;
use moca_telemetry::net::{Address, Connection, Link, Reply};
use moca_telemetry::{ParameterValue, RobotDescription};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use std::collections::VecDeque;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

/// Longest wait for a daemon to greet, to answer or to send news.
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
    /// True once a request other than a stop was carried out: then this program is responsible for the robot.
    commanded: AtomicBool,
}

fn address_of(text: Option<&str>) -> PyResult<Address> {
    match text {
        Some(text) => text.parse().map_err(|error| PyValueError::new_err(format!("{text}: {error}"))),
        None => Ok(Address::of_this_machine()),
    }
}

/// Stops the robot without being served by its daemon.
#[pyfunction]
#[pyo3(signature = (address=None))]
pub fn stop(py: Python<'_>, address: Option<&str>) -> PyResult<()> {
    let address = address_of(address)?;
    let outcome = py.detach(|| stop_blocking(&address));
    answered(Request::Stop, outcome.map_err(|error| Disconnected::new_err(format!("{address}: {error}")))?)
}

/// Messages of the daemon that have not been read yet.
struct Heard {
    description: Arc<RobotDescription>,
    samples: VecDeque<Sample>,
    replies: VecDeque<Reply>,
    /// Tick of the newest sample, which may have been read already, and its gripper; `None` before the first.
    newest: Option<(u64, Option<GripperState>)>,
}

#[pymethods]
impl Client {
    /// Without an address the service's socket, or where there is none that of this user's `mocad`.
    #[new]
    #[pyo3(signature = (address=None))]
    fn new(py: Python<'_>, address: Option<&str>) -> PyResult<Self> {
        let address = address_of(address)?;
        let connection =
            Connection::spawn(address.clone(), || {}).map_err(|e| Disconnected::new_err(e.to_string()))?;
        let until = Instant::now() + PATIENCE;
        loop {
            if let Some(reason) = connection.refusal() {
                return Err(Disconnected::new_err(format!("{address}: {reason}")));
            }
            match connection.poll().link {
                Link::Up { description, .. } => {
                    let (samples, replies, newest) = Default::default();
                    let heard = Mutex::new(Heard { description, samples, replies, newest });
                    let (connection, commanded) = (Mutex::new(Some(Arc::new(connection))), false.into());
                    return Ok(Self { connection, heard, commanded });
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
        let number = found.ok_or_else(|| PyValueError::new_err(no_parameter(&description, name)))?;
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
        let newest = self.poll()?.samples.drain(..).next_back();
        newest.map_or_else(|| self.next(py), |sample| Ok(State(sample)))
    }

    fn request(&self, py: Python<'_>, name: &str) -> PyResult<()> {
        self.obey(py, plain(name)?)
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
        self.obey(py, target(kind, &values, stamp_unix_ns, age_limit_s, touch)?)
    }

    fn trajectory(&self, py: Python<'_>, rows: Vec<f64>, touch: &str) -> PyResult<()> {
        let (waypoints, touch) = (waypoints(&rows)?, policy(touch)?);
        self.connection()?.trajectory(touch, waypoints);
        let Reply { request, outcome } =
            self.answer(py, |reply| matches!(reply.request, Request::Waypoint { .. }))?;
        answered(request, outcome)
    }

    fn press(&self, py: Python<'_>, taxel: u8, force_n: f64) -> PyResult<()> {
        let count = self.heard().description.taxels.len();
        self.obey(py, press(taxel, force_n, count)?)
    }

    /// Asks the gripper, and waits until its fingers rest, or only until they begin if `wait` is false. Returns true if an object is
    /// held. A signal stops the fingers.
    fn gripper(&self, py: Python<'_>, name: &str, values: Vec<f64>, wait: bool) -> PyResult<bool> {
        let asked = gripper::request(name, &values)?;
        let state = self.move_fingers(py, asked, wait).inspect_err(|error| {
            if !(error.is_instance_of::<Refused>(py) || error.is_instance_of::<Disconnected>(py)) {
                // The signal is what the caller hears of.
                let _ = self.move_fingers(py, GripperRequest::Stop, true);
            }
        })?;
        gripper::held(asked, &state)
    }

    fn gripper_state(&self, py: Python<'_>) -> PyResult<gripper::Fields> {
        Ok(gripper::fields(&self.fingers(py, |_| true)?))
    }

    /// Gives the command back.
    fn release(&self) -> PyResult<()> {
        self.connection()?.release();
        Ok(())
    }

    /// Disarms, gives the command back and ends the connection: all of it has been sent when this returns.
    fn close(&self, py: Python<'_>) {
        if let Some(connection) = self.take() {
            // One that has only looked on changes nothing. Whoever commands meanwhile is the daemon's to judge.
            if self.commanded.load(Ordering::Relaxed) {
                connection.request(Request::Disarm);
            }
            connection.release();
            py.detach(|| drop(connection));
        }
    }

    /// Ends the connection without a word: a robot that this program commands stops.
    fn abandon(&self, py: Python<'_>) {
        if let Some(connection) = self.take() {
            py.detach(|| drop(connection));
        }
    }
}

impl Client {
    fn take(&self) -> Option<Arc<Connection>> {
        self.connection.lock().unwrap_or_else(PoisonError::into_inner).take()
    }

    fn heard(&self) -> MutexGuard<'_, Heard> {
        self.heard.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn connection(&self) -> PyResult<Arc<Connection>> {
        let connection = self.connection.lock().unwrap_or_else(PoisonError::into_inner);
        connection.clone().ok_or_else(|| Disconnected::new_err("the connection is closed"))
    }

    fn ask(&self, py: Python<'_>, request: Request) -> PyResult<Outcome> {
        self.connection()?.request(request);
        Ok(self.answer(py, |reply| reply.answers(&request))?.outcome)
    }

    /// Asks the gripper. Returns its state once the fingers rest, or once they have begun if `wait` is false.
    fn move_fingers(&self, py: Python<'_>, asked: GripperRequest, wait: bool) -> PyResult<GripperState> {
        let before = self.fingers(py, |_| true)?.requests;
        self.obey(py, Request::Gripper(asked))?;
        // Samples from before the answer may come after it.
        let begun = |state: &GripperState| state.requests != before || state.phase == GripperPhase::Unknown;
        self.fingers(py, |state| begun(state) && !(wait && gripper::moves(state)))
    }

    /// Waits for a report of the gripper that is wanted, as long as the daemon sends anything.
    fn fingers(&self, py: Python<'_>, is_wanted: impl Fn(&GripperState) -> bool) -> PyResult<GripperState> {
        let (mut tick, mut until) = (None, Instant::now() + PATIENCE);
        loop {
            let newest = self.poll()?.newest;
            if let Some((_, state)) = newest {
                let state = state.ok_or_else(gripper::missing)?;
                if is_wanted(&state) {
                    return Ok(state);
                }
            }
            let newest_tick = newest.map(|(tick, _)| tick);
            if newest_tick != tick {
                (tick, until) = (newest_tick, Instant::now() + PATIENCE);
            }
            self.wait(py, until, "the daemon sends nothing new")?;
        }
    }

    fn obey(&self, py: Python<'_>, request: Request) -> PyResult<()> {
        answered(request, self.ask(py, request)?)
    }

    /// The answer to the request that is meant, whatever else is on its way.
    fn answer(&self, py: Python<'_>, is_meant: impl Fn(&Reply) -> bool) -> PyResult<Reply> {
        let until = Instant::now() + PATIENCE;
        loop {
            let mut heard = self.poll()?;
            let place = heard.replies.iter().position(&is_meant);
            if let Some(reply) = place.and_then(|place| heard.replies.remove(place)) {
                if reply.outcome.is_ok() && reply.request != Request::Stop {
                    self.commanded.store(true, Ordering::Relaxed);
                }
                return Ok(reply);
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
        let newest = update.samples.last().map(|sample| (sample.tick, sample.gripper));
        heard.newest = newest.or(heard.newest);
        heard.samples.extend(update.samples);
        let excess = heard.samples.len().saturating_sub(10_000);
        heard.samples.drain(..excess);
        heard.replies.extend(update.replies);
        let excess = heard.replies.len().saturating_sub(MAX_REPLIES);
        heard.replies.drain(..excess);
        Ok(heard)
    }
}

/// Error text of an unknown parameter, with those of a like name, or else all that can be changed.
fn no_parameter(robot: &RobotDescription, name: &str) -> String {
    let last = name.rsplit('.').next().unwrap_or_default();
    let names = |wanted: &dyn Fn(&str) -> bool| -> Vec<String> {
        let live = robot.parameters.iter().filter(|parameter| parameter.live);
        live.map(|parameter| parameter.name.clone()).filter(|known| wanted(known)).collect()
    };
    let like = names(&|known| !last.is_empty() && known.contains(last));
    let allowed = if like.is_empty() { names(&|_| true) } else { like };
    format!("no parameter is called {name:?}; allowed: {}", allowed.join(", "))
}
