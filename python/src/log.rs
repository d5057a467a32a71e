//! A log as columns.

use crate::state::{FIELDS, bytes, numbers};
use moca_msgs::Sample;
use moca_telemetry::log::read_log;
use pyo3::exceptions::{PyKeyError, PyOSError};
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
        let log = py.detach(|| read_log(&path)).map_err(|error| PyOSError::new_err(error.to_string()))?;
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

    /// The names of the columns.
    #[staticmethod]
    fn fields() -> [&'static str; FIELDS.len()] {
        FIELDS
    }

    /// A column row by row, and how many numbers a row has. A sample without them has no number in their place.
    fn column<'py>(&self, py: Python<'py>, field: &str) -> PyResult<(Bound<'py, PyBytes>, usize)> {
        let rows: Option<Vec<Vec<f64>>> = self.samples.iter().map(|sample| numbers(sample, field)).collect();
        let rows = rows.ok_or_else(|| PyKeyError::new_err(field.to_owned()))?;
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
