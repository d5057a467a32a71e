//! A log as columns.

use crate::state::{bytes, field as known, no_field};
use moca_msgs::Sample;
use moca_telemetry::log::{LogError, read_log};
use pyo3::exceptions::{PyKeyError, PyValueError};
use pyo3::prelude::*;
use pyo3::types::PyBytes;
use std::path::PathBuf;

#[pyclass(frozen, module = "moca._moca")]
pub struct Log {
    samples: Vec<Sample>,
    cut: Option<String>,
    name: String,
    start_unix_ns: u64,
}

#[pymethods]
impl Log {
    #[new]
    fn new(py: Python<'_>, path: PathBuf) -> PyResult<Self> {
        let log = py.detach(|| read_log(&path)).map_err(|error| unreadable(&error))?;
        let (samples, cut, start_unix_ns) = (log.samples, log.cut, log.start_unix_ns);
        Ok(Self { samples, cut, name: log.description.name, start_unix_ns })
    }

    #[getter]
    fn cut(&self) -> Option<&str> {
        self.cut.as_deref()
    }

    #[getter]
    fn name(&self) -> &str {
        &self.name
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

    /// The mode of each row.
    fn modes(&self) -> Vec<&'static str> {
        self.samples.iter().map(|sample| sample.mode.name()).collect()
    }
}

/// The built-in exception of a file that is missing or must not be read; of one that is no log a `ValueError`.
fn unreadable(error: &LogError) -> PyErr {
    match error {
        LogError::Open { cause, .. } => std::io::Error::new(cause.kind(), error.to_string()).into(),
        _ => PyValueError::new_err(error.to_string()),
    }
}
