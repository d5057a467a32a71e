//! Many simulated robots that step together on several threads, their numbers in arrays that numpy shares.

use crate::request::{press, target};
use crate::state::{NumberField, fields};
use crate::world::{World, configuration, varied};
use moca_control::config::Config;
use moca_msgs::{Mode, Request, Sample};
use pyo3::exceptions::{PyRuntimeError, PyValueError};
use pyo3::prelude::*;
use pyo3::types::PyDict;
use std::path::PathBuf;
use std::sync::atomic::{AtomicU64, AtomicUsize, Ordering::Relaxed};
use std::sync::mpsc::{Receiver, Sender, channel};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

/// Longest time from power-up to a law in control, s of simulation.
const CONTROL_WITHIN_S: f64 = 10.0;
/// Most robots of a batch.
const ROBOTS_MAX: usize = 100_000;
/// Ticks of all robots between two looks for Ctrl-C.
const SIGNALS_EVERY: usize = 100_000;
/// Age limit of a target, s.
const AGE_LIMIT_S: f64 = 0.2;
/// Numbers of a press: taxel (1 is T1, 0 presses nothing) and force, N.
const PRESS: usize = 2;

/// Doubles that Rust and numpy share. Both sides read and write whole words, so no number is ever torn.
#[pyclass(frozen, skip_from_py_object, module = "moca._moca")]
#[derive(Clone)]
pub struct Shared {
    words: Arc<[AtomicU64]>,
    shape: Vec<usize>,
    read_only: bool,
}

impl Shared {
    fn new(shape: Vec<usize>, read_only: bool) -> Self {
        let nan = || AtomicU64::new(f64::NAN.to_bits());
        let words = std::iter::repeat_with(nan).take(shape.iter().product()).collect();
        Self { words, shape, read_only }
    }

    /// Numbers of one robot.
    fn row(&self, robot: usize) -> &[AtomicU64] {
        let width = self.shape.get(1).copied().unwrap_or(1);
        self.words.get(robot * width..(robot + 1) * width).unwrap_or_default()
    }

    fn read(&self, robot: usize) -> Vec<f64> {
        self.row(robot).iter().map(|word| f64::from_bits(word.load(Relaxed))).collect()
    }

    /// Writes the numbers of one robot; a part that has no state yet is not a number.
    fn write(&self, robot: usize, numbers: &[f64]) {
        let missing = std::iter::repeat(&f64::NAN);
        for (word, number) in self.row(robot).iter().zip(numbers.iter().chain(missing)) {
            word.store(number.to_bits(), Relaxed);
        }
    }
}

#[pymethods]
impl Shared {
    /// Description of the memory for `numpy.asarray`, which keeps this object alive.
    #[getter(__array_interface__)]
    fn array_interface<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        let interface = PyDict::new(py);
        interface.set_item("version", 3)?;
        interface.set_item("shape", pyo3::types::PyTuple::new(py, &self.shape)?)?;
        interface.set_item("typestr", if cfg!(target_endian = "little") { "<f8" } else { ">f8" })?;
        interface.set_item("data", (self.words.as_ptr().addr(), self.read_only))?;
        Ok(interface)
    }
}

struct Robot {
    world: World,
    mode: Mode,
    fault: Option<String>,
    /// Why the last request was refused, if it was.
    refused: Option<String>,
}

/// Work for all robots; each thread takes the next robot until there is none left.
#[derive(Clone)]
enum Job {
    /// New robots with these seeds and configurations, stepped until a law is in control.
    Reset(Arc<[Option<(u64, Arc<Config>)>]>),
    /// A number of ticks, the first of which take the requests of each robot.
    Step { ticks: u64, requests: Arc<[[Option<Request>; 2]]> },
}

/// A robot of the batch and the reason for which its job failed.
type Failure = (usize, PyErr);

struct Fleet {
    config: Arc<Config>,
    robots: Vec<Mutex<Option<Robot>>>,
    fields: Vec<(NumberField, Shared)>,
    next: AtomicUsize,
}

impl Fleet {
    fn robot(&self, index: usize) -> MutexGuard<'_, Option<Robot>> {
        // Nobody waits: a thread takes a robot that no other one has.
        self.robots[index].lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn work(&self, job: &Job) -> Option<Failure> {
        let mut first: Option<Failure> = None;
        loop {
            let index = self.next.fetch_add(1, Relaxed);
            if index >= self.robots.len() {
                return first;
            }
            match job {
                Job::Reset(starts) => {
                    let start = starts[index].as_ref();
                    let done = start.map_or(Ok(()), |(seed, config)| self.reset(index, *seed, config));
                    first = first.or(done.err().map(|error| (index, error)));
                }
                Job::Step { ticks, requests } => self.step(index, *ticks, requests.get(index)),
            }
        }
    }

    fn reset(&self, index: usize, seed: u64, config: &Config) -> PyResult<()> {
        let (robot, sample) = started(config, seed)?;
        self.show(index, &sample);
        *self.robot(index) = Some(robot);
        Ok(())
    }

    /// Steps a robot. One that refuses a request steps on without it.
    fn step(&self, index: usize, ticks: u64, requests: Option<&[Option<Request>; 2]>) {
        let mut place = self.robot(index);
        let Some(robot) = place.as_mut() else { return };
        if requests.is_some() {
            robot.refused = None;
        }
        let mut requests = requests.into_iter().flatten().flatten();
        for left in (0..ticks).rev() {
            let request = requests.next();
            let ticked = robot.world.tick(request.copied());
            if let (Some(request), Some(Err(refusal))) = (request, ticked.input.outcome) {
                robot.refused = Some(request.refused(refusal).to_string());
            }
            if left == 0 {
                self.show(index, &ticked.sample);
                robot.mode = ticked.sample.mode;
                robot.fault = ticked.sample.fault.map(|fault| fault.to_string());
            }
        }
    }

    fn show(&self, index: usize, sample: &Sample) {
        for (field, shared) in &self.fields {
            shared.write(index, &(field.of)(sample));
        }
    }
}

/// A robot whose law is in control, and its sample.
fn started(config: &Config, seed: u64) -> PyResult<(Robot, Sample)> {
    let mut config = config.clone();
    config.simulation.seed = seed;
    let mut world = World::new(&config).map_err(PyValueError::new_err)?;
    let mut ticks = CONTROL_WITHIN_S * f64::from(config.control_loop.rate_hz);
    loop {
        let sample = &world.tick(None).sample;
        if sample.mode.moves() {
            let (mode, sample) = (sample.mode, sample.clone());
            return Ok((Robot { world, mode, fault: None, refused: None }, sample));
        }
        ticks -= 1.0;
        if ticks <= 0.0 {
            let why = sample.fault.map_or(String::new(), |fault| format!(" ({fault})"));
            return Err(PyRuntimeError::new_err(format!(
                "the robot is {}{why} after {CONTROL_WITHIN_S} s: a batch needs startup.arm = true and a robot that starts",
                sample.mode.name()
            )));
        }
    }
}

struct Worker {
    jobs: Sender<Job>,
    done: Mutex<Receiver<Option<Failure>>>,
}

impl Worker {
    fn start(fleet: &Arc<Fleet>) -> Self {
        let (jobs, todo) = channel::<Job>();
        let (results, done) = channel();
        let fleet = Arc::clone(fleet);
        std::thread::spawn(move || {
            while let Ok(job) = todo.recv() {
                if results.send(fleet.work(&job)).is_err() {
                    return;
                }
            }
        });
        Self { jobs, done: Mutex::new(done) }
    }

    fn result(&self) -> Option<Failure> {
        let received = self.done.lock().unwrap_or_else(PoisonError::into_inner).recv();
        received.unwrap_or_else(|_| Some((0, PyRuntimeError::new_err("a thread of the batch has ended"))))
    }
}

/// Robots that step together; other Python threads run meanwhile.
#[pyclass(module = "moca._moca")]
pub struct Batch {
    fleet: Arc<Fleet>,
    /// Threads besides the caller's.
    workers: Vec<Worker>,
    kind: String,
    targets: Shared,
    presses: Shared,
    taxels: usize,
}

#[pymethods]
impl Batch {
    #[new]
    fn new(
        path: Option<PathBuf>,
        toml: Option<&str>,
        robots: usize,
        threads: Option<usize>,
        kind: String,
    ) -> PyResult<Self> {
        let config = configuration(path.as_deref(), toml)?;
        if robots == 0 || robots > ROBOTS_MAX {
            return Err(PyValueError::new_err(format!("robots = {robots}: allowed: 1 to {ROBOTS_MAX}")));
        }
        let cores = std::thread::available_parallelism().map_or(1, std::num::NonZero::get);
        let threads = threads.unwrap_or_else(|| cores.min(robots));
        if threads == 0 || threads > robots {
            return Err(PyValueError::new_err(format!(
                "threads = {threads}: allowed: 1 to the number of robots, {robots}"
            )));
        }
        let (_, sample) = started(&config, config.simulation.seed)?;
        let shared = |field: NumberField| {
            let width = (field.of)(&sample).len();
            let shape = if field.single { vec![robots] } else { vec![robots, width] };
            (field, Shared::new(shape, true))
        };
        let width = match kind.as_str() {
            "base" => 3,
            "pose" => 7,
            "posture" => sample.q_rad.len(),
            _ => 6,
        };
        // Refuses an unknown kind.
        target(&kind, &vec![0.0; width], 0, AGE_LIMIT_S, touch(&kind))?;
        let taxels = config.robot.cover.count();
        let fleet = Arc::new(Fleet {
            config: Arc::new(config),
            robots: (0..robots).map(|_| Mutex::new(None)).collect(),
            fields: fields().into_iter().map(shared).collect(),
            next: AtomicUsize::new(0),
        });
        let workers = (1..threads).map(|_| Worker::start(&fleet)).collect();
        let targets = Shared::new(vec![robots, width], false);
        let presses = Shared::new(vec![robots, PRESS], false);
        Ok(Self { fleet, workers, kind, targets, presses, taxels })
    }

    /// Targets of the next step, a row for each robot; a row without numbers asks for nothing.
    #[getter]
    fn targets(&self) -> Shared {
        self.targets.clone()
    }

    /// Presses of the next step, rows of taxel and force.
    #[getter]
    fn presses(&self) -> Shared {
        self.presses.clone()
    }

    /// Each field of numbers with its array.
    fn fields(&self) -> Vec<(&'static str, Shared)> {
        self.fleet.fields.iter().map(|(field, shared)| (field.name, shared.clone())).collect()
    }

    /// Mode of each robot.
    fn modes(&self) -> Vec<Option<&'static str>> {
        self.each(|robot| robot.mode.name())
    }

    /// Why each robot is stopped, if it is.
    fn faults(&self) -> Vec<Option<String>> {
        self.each(|robot| robot.fault.clone()).into_iter().map(Option::flatten).collect()
    }

    /// Why each robot refused its last request, if it did.
    fn refusals(&self) -> Vec<Option<String>> {
        self.each(|robot| robot.refused.clone()).into_iter().map(Option::flatten).collect()
    }

    /// Puts new robots in the places that have a seed. `settings` has assignments for each robot, or is empty.
    fn reset(&mut self, py: Python<'_>, seeds: Vec<Option<u64>>, settings: Vec<Vec<String>>) -> PyResult<()> {
        let robots = self.fleet.robots.len();
        if seeds.len() != robots || !(settings.is_empty() || settings.len() == robots) {
            return Err(PyValueError::new_err(format!(
                "{} seeds and {} settings for {robots} robots",
                seeds.len(),
                settings.len()
            )));
        }
        let start = |(index, seed): (usize, Option<u64>)| {
            let Some(seed) = seed else { return Ok(None) };
            let config = match settings.get(index) {
                Some(own) if !own.is_empty() => varied(&self.fleet.config, own)
                    .map_err(|error| PyValueError::new_err(format!("robot {index}: {error:#}")))?
                    .into(),
                _ => Arc::clone(&self.fleet.config),
            };
            Ok(Some((seed, config)))
        };
        let starts = seeds.into_iter().enumerate().map(start).collect::<PyResult<_>>()?;
        self.run(py, &Job::Reset(starts))
    }

    /// Steps every robot, with the targets and presses that the arrays hold.
    fn step(&mut self, py: Python<'_>, ticks: u64, targets: bool, presses: bool) -> PyResult<()> {
        if let Some(index) = (0..self.fleet.robots.len()).find(|index| self.fleet.robot(*index).is_none()) {
            return Err(PyValueError::new_err(format!("robot {index} has no state yet: reset it first")));
        }
        let requests: Vec<_> = (0..self.fleet.robots.len())
            .map(|index| Ok([self.press(index, presses)?, self.target(index, targets)?]))
            .collect::<PyResult<_>>()?;
        let fewest = requests
            .iter()
            .map(|both: &[Option<Request>; 2]| both.iter().flatten().count())
            .max()
            .unwrap_or(0);
        if ticks < fewest.max(1) as u64 {
            return Err(PyValueError::new_err(format!(
                "ticks = {ticks}: allowed: {} or more, one for each request",
                fewest.max(1)
            )));
        }
        let (mut left, mut requests) = (ticks, requests.into());
        let most = (SIGNALS_EVERY / self.fleet.robots.len()).max(2) as u64;
        while left > 0 {
            py.check_signals()?;
            let now = left.min(most);
            left -= now;
            self.run(py, &Job::Step { ticks: now, requests })?;
            requests = [].into();
        }
        Ok(())
    }
}

impl Batch {
    fn each<T>(&self, of: impl Fn(&Robot) -> T) -> Vec<Option<T>> {
        (0..self.fleet.robots.len()).map(|index| self.fleet.robot(index).as_ref().map(&of)).collect()
    }

    fn target(&self, index: usize, wanted: bool) -> PyResult<Option<Request>> {
        let values = if wanted { self.targets.read(index) } else { Vec::new() };
        if values.iter().all(|value| value.is_nan()) {
            return Ok(None);
        }
        target(&self.kind, &values, 0, AGE_LIMIT_S, touch(&self.kind)).map(Some)
    }

    fn press(&self, index: usize, wanted: bool) -> PyResult<Option<Request>> {
        if !wanted {
            return Ok(None);
        }
        let [taxel, force_n]: [f64; PRESS] = self.presses.read(index).try_into().unwrap_or_default();
        if taxel == 0.0 {
            return Ok(None);
        }
        let numbers = 1..=self.taxels;
        let number =
            numbers.filter_map(|number| u8::try_from(number).ok()).find(|number| f64::from(*number) == taxel);
        let number = number.map(|number| number - 1).ok_or_else(|| {
            let most = self.taxels;
            PyValueError::new_err(format!(
                "robot {index}, taxel {taxel}: allowed: 1 (T1) to {most} (T{most}), 0 for none"
            ))
        })?;
        press(number, force_n, self.taxels).map(Some)
    }

    /// Lets all threads work. Of several failures the robot with the lowest number is reported.
    fn run(&self, py: Python<'_>, job: &Job) -> PyResult<()> {
        let failed = py.detach(|| {
            self.fleet.next.store(0, Relaxed);
            for worker in &self.workers {
                // A thread that has ended is reported by its missing result.
                let _ = worker.jobs.send(job.clone());
            }
            let mine = self.fleet.work(job);
            let others = self.workers.iter().map(Worker::result).collect::<Vec<_>>();
            std::iter::once(mine).chain(others).flatten().min_by_key(|(index, _)| *index)
        });
        let Some((index, error)) = failed else { return Ok(()) };
        let text = format!("robot {index}: {}", error.value(py));
        Err(PyErr::from_type(error.get_type(py), text))
    }
}

/// Touch policy of a kind of target: the base gives way, the flange's target waits.
fn touch(kind: &str) -> &'static str {
    if kind == "base" { "pass-through" } else { "wins" }
}
