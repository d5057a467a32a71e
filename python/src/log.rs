//! A log as columns, read when they are asked for.

use crate::state::{NumberField, bytes, field as known, fields, no_field};
use moca_msgs::{Fault, GripperFault, Mode, Sample};
use moca_telemetry::log::records::{Channel, Command};
use moca_telemetry::log::{LogError, LogFile};
use pyo3::exceptions::{PyKeyError, PyValueError};
use pyo3::prelude::*;
use pyo3::types::PyBytes;
use std::collections::HashMap;
use std::path::PathBuf;
use std::sync::{Mutex, MutexGuard, PoisonError};

/// A column of words.
struct Words {
    name: &'static str,
    /// Topic of its record in a log; empty where every row has it.
    topic: &'static str,
    /// Its word in a row; empty where there is none.
    of: fn(&Sample) -> &'static str,
}

const WORDS: [Words; 5] = [
    Words { name: "mode", topic: "", of: |sample| sample.mode.name() },
    Words {
        name: "law",
        topic: Command::TOPIC,
        of: |sample| sample.law.map_or("", |law| Mode::from(law).name()),
    },
    Words { name: "fault_code", topic: "", of: |sample| sample.fault.map_or("", Fault::code) },
    Words {
        name: "gripper_phase",
        topic: "",
        of: |sample| sample.gripper.map_or("", |gripper| gripper.phase.name()),
    },
    Words {
        name: "gripper_fault_code",
        topic: "",
        of: |sample| sample.gripper.and_then(|gripper| gripper.fault).map_or("", GripperFault::code),
    },
];

#[pyclass(frozen, module = "moca._moca")]
pub struct Log {
    name: String,
    arm: String,
    start_unix_ns: u64,
    columns: Mutex<Columns>,
}

/// The columns that have been read.
struct Columns {
    file: LogFile,
    /// Topics whose columns are there.
    topics: Vec<&'static str>,
    /// Rows of numbers, one after the other, and the length of each.
    numbers: HashMap<&'static str, Rows>,
    words: HashMap<&'static str, Vec<&'static str>>,
    /// True for each row in which a law drives the robot.
    moves: Vec<bool>,
    cut: Option<String>,
}

#[derive(Default)]
struct Rows {
    values: Vec<f64>,
    /// Numbers of each row: where they change, the row and the new number.
    widths: Vec<(usize, usize)>,
    rows: usize,
}

impl Rows {
    fn push(&mut self, row: &[f64]) {
        if self.widths.last().is_none_or(|(_, width)| *width != row.len()) {
            self.widths.push((self.rows, row.len()));
        }
        self.rows += 1;
        self.values.extend_from_slice(row);
    }

    /// Numbers of the longest row.
    fn width(&self) -> usize {
        self.widths.iter().map(|(_, width)| *width).max().unwrap_or(0)
    }

    /// All rows, each filled up to the longest with what is not a number.
    fn filled(&self) -> Vec<f64> {
        let longest = self.width();
        let ends = self.widths.iter().skip(1).map(|(row, _)| *row).chain([self.rows]);
        let (mut rest, mut filled) = (&self.values[..], Vec::with_capacity(self.rows * longest));
        for ((begin, width), end) in self.widths.iter().zip(ends) {
            for _ in *begin..end {
                let (row, others) = rest.split_at(*width);
                filled.extend_from_slice(row);
                filled.resize(filled.len() + longest - width, f64::NAN);
                rest = others;
            }
        }
        filled
    }
}

impl Columns {
    /// Reads the columns of these topics that are not there yet, in one pass.
    fn load(&mut self, topics: &[&'static str]) {
        let first = self.topics.is_empty();
        let begun: &[&str] = if first { &[""] } else { &[] };
        let wanted = begun.iter().chain(topics).filter(|topic| !self.topics.contains(*topic));
        let wanted: Vec<&'static str> = wanted.copied().collect();
        if wanted.is_empty() {
            return;
        }
        let numbers: Vec<NumberField> = fields().into_iter().filter(|f| wanted.contains(&f.topic)).collect();
        let words: Vec<&Words> = WORDS.iter().filter(|words| wanted.contains(&words.topic)).collect();
        let mut rows: Vec<Rows> = numbers.iter().map(|_| Rows::default()).collect();
        let mut said: Vec<Vec<&'static str>> = words.iter().map(|_| Vec::new()).collect();
        let Self { file, moves, .. } = self;
        let damage = file.rows(&wanted, &mut |sample| {
            rows.iter_mut().zip(&numbers).for_each(|(rows, field)| rows.push(&(field.of)(sample)));
            said.iter_mut().zip(&words).for_each(|(said, words)| said.push((words.of)(sample)));
            if first {
                moves.push(sample.mode.moves());
            }
        });
        self.cut = self.cut.take().or(damage);
        self.numbers.extend(numbers.iter().map(|field| field.name).zip(rows));
        self.words.extend(words.iter().map(|words| words.name).zip(said));
        self.topics.extend(wanted);
    }
}

impl Log {
    /// Columns with those of these topics. They are read while other Python threads run.
    fn with(&self, py: Python<'_>, topics: &[&'static str]) -> MutexGuard<'_, Columns> {
        let columns = || self.columns.lock().unwrap_or_else(PoisonError::into_inner);
        py.detach(|| columns().load(topics));
        columns()
    }
}

#[pymethods]
impl Log {
    #[new]
    fn new(py: Python<'_>, path: PathBuf) -> PyResult<Self> {
        let file = py.detach(|| LogFile::open(&path)).map_err(|error| unreadable(&error))?;
        let (description, start_unix_ns) = (file.description(), file.start_unix_ns());
        let (name, arm) = (description.name.clone(), description.arm_name.clone());
        let cut = file.cut().map(Into::into);
        let (numbers, words) = Default::default();
        let columns = Columns { file, topics: Vec::new(), numbers, words, moves: Vec::new(), cut };
        Ok(Self { name, arm, start_unix_ns, columns: Mutex::new(columns) })
    }

    #[getter]
    fn cut(&self, py: Python<'_>) -> Option<String> {
        self.with(py, &[]).cut.clone()
    }

    #[getter]
    fn name(&self) -> &str {
        &self.name
    }

    /// Name of the arm.
    #[getter]
    fn arm(&self) -> &str {
        &self.arm
    }

    #[getter]
    fn start_unix_ns(&self) -> u64 {
        self.start_unix_ns
    }

    fn __len__(&self, py: Python<'_>) -> usize {
        self.with(py, &[]).moves.len()
    }

    /// Reads all columns at once: for who wants most of them, this is faster than one after the other.
    fn load(&self, py: Python<'_>) {
        let topics: Vec<&'static str> = fields().into_iter().map(|field| field.topic).collect();
        drop(self.with(py, &unique(topics)));
    }

    /// A column row by row, and how many numbers a row has. A sample without them has no number in their place.
    fn column<'py>(&self, py: Python<'py>, field: &str) -> PyResult<(Bound<'py, PyBytes>, usize)> {
        let known = known(field).ok_or_else(|| PyKeyError::new_err(no_field(field)))?;
        let columns = self.with(py, &[known.topic]);
        let rows = &columns.numbers[known.name];
        Ok((bytes(py, &rows.filled()), rows.width()))
    }

    /// Names of the columns of words.
    #[staticmethod]
    fn word_fields() -> Vec<&'static str> {
        WORDS.iter().map(|words| words.name).collect()
    }

    /// The word of each row; empty where there is none.
    fn words(&self, py: Python<'_>, field: &str) -> PyResult<Vec<&'static str>> {
        let words = WORDS
            .iter()
            .find(|words| words.name == field)
            .ok_or_else(|| PyKeyError::new_err(no_field(field)))?;
        Ok(self.with(py, &[words.topic]).words[words.name].clone())
    }

    /// True for each row in which a law drives the robot.
    fn moves(&self, py: Python<'_>) -> Vec<bool> {
        self.with(py, &[]).moves.clone()
    }
}

/// Each topic once.
fn unique(mut topics: Vec<&'static str>) -> Vec<&'static str> {
    topics.sort_unstable();
    topics.dedup();
    topics
}

/// The built-in exception of a file that is missing or must not be read; of one that is no log a `ValueError`.
fn unreadable(error: &LogError) -> PyErr {
    match error {
        LogError::Open { cause, .. } => std::io::Error::new(cause.kind(), error.to_string()).into(),
        _ => PyValueError::new_err(error.to_string()),
    }
}
