//! A log as columns.

use crate::state::{bytes, field as known, no_field};
use moca_msgs::{Fault, Mode, Sample};
use moca_telemetry::log::{LogError, read_log};
use pyo3::exceptions::{PyKeyError, PyValueError};
use pyo3::prelude::*;
use pyo3::types::PyBytes;
use std::path::PathBuf;

/// Name of a column of words, and its word in a row; empty where there is none.
type Words = (&'static str, fn(&Sample) -> &'static str);

const WORDS: [Words; 3] = [
    ("mode", |sample| sample.mode.name()),
    ("law", |sample| sample.law.map_or("", |law| Mode::from(law).name())),
    ("fault_code", |sample| sample.fault.map_or("", Fault::code)),
];

#[pyclass(frozen, module = "moca._moca")]
pub struct Log {
    samples: Vec<Sample>,
    cut: Option<String>,
    name: String,
    arm: String,
    start_unix_ns: u64,
}

#[pymethods]
impl Log {
    #[new]
    fn new(py: Python<'_>, path: PathBuf) -> PyResult<Self> {
        let log = py.detach(|| read_log(&path)).map_err(|error| unreadable(&error))?;
        let (samples, cut, start_unix_ns) = (log.samples, log.cut, log.start_unix_ns);
        Ok(Self { samples, cut, name: log.description.name, arm: log.description.arm_name, start_unix_ns })
    }

    #[getter]
    fn cut(&self) -> Option<&str> {
        self.cut.as_deref()
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

    fn __len__(&self) -> usize {
        self.samples.len()
    }

    /// A column row by row, and how many numbers a row has. A sample without them has no number in their place.
    fn column<'py>(&self, py: Python<'py>, field: &str) -> PyResult<(Bound<'py, PyBytes>, usize)> {
        let of = known(field).ok_or_else(|| PyKeyError::new_err(no_field(field)))?.of;
        let rows: Vec<Vec<f64>> = self.samples.iter().map(of).collect();
        let width = rows.iter().map(Vec::len).max().unwrap_or(0);
        let mut values = Vec::with_capacity(rows.len() * width);
        for row in &rows {
            values.extend_from_slice(row);
            values.resize(values.len() + width - row.len(), f64::NAN);
        }
        Ok((bytes(py, &values), width))
    }

    /// Names of the columns of words.
    #[staticmethod]
    fn word_fields() -> Vec<&'static str> {
        WORDS.iter().map(|(name, _)| *name).collect()
    }

    /// The word of each row; empty where there is none.
    fn words(&self, field: &str) -> PyResult<Vec<&'static str>> {
        let (_, of) = WORDS
            .iter()
            .find(|(name, _)| *name == field)
            .ok_or_else(|| PyKeyError::new_err(no_field(field)))?;
        Ok(self.samples.iter().map(of).collect())
    }

    /// True for each row in which a law drives the robot.
    fn moves(&self) -> Vec<bool> {
        self.samples.iter().map(|sample| sample.mode.moves()).collect()
    }
}

/// The built-in exception of a file that is missing or must not be read; of one that is no log a `ValueError`.
fn unreadable(error: &LogError) -> PyErr {
    match error {
        LogError::Open { cause, .. } => std::io::Error::new(cause.kind(), error.to_string()).into(),
        _ => PyValueError::new_err(error.to_string()),
    }
}
