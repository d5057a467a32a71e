//! The collision and campaigns, by the code of `moca-lab`.

use anyhow::{Error, Result};
use moca_experiments::campaign::{Campaign, Table};
use moca_experiments::collision;
use moca_experiments::drawn::Meetings;
use moca_experiments::settings::Settings;
use moca_experiments::sweep::Sweep;
use moca_figures::progress;
use moca_msgs::Law;
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use std::path::PathBuf;

fn wrong(error: &Error) -> PyErr {
    PyValueError::new_err(format!("{error:#}"))
}

/// A checked table of runs. Each row follows from the table and the run's number alone.
#[pyclass(frozen, module = "moca._moca")]
pub struct Plan(Box<dyn Table>);

impl Plan {
    fn of(sweep: Result<Sweep>) -> PyResult<Self> {
        sweep.map(|sweep| Self(Box::new(sweep))).map_err(|error| wrong(&error))
    }
}

#[pymethods]
impl Plan {
    /// A sweep, written as TOML.
    #[staticmethod]
    fn toml(text: &str) -> PyResult<Self> {
        Self::of(Sweep::parse(text, None))
    }

    /// A sweep, written as JSON.
    #[staticmethod]
    fn json(text: &str) -> PyResult<Self> {
        Self::of(Sweep::parse_json(text))
    }

    /// Meetings drawn at random.
    #[staticmethod]
    fn drawn(runs: usize, seed: u64) -> Self {
        Self(Box::new(Meetings { runs, seed }))
    }

    fn __len__(&self) -> usize {
        self.0.rows()
    }

    /// First line of the file.
    fn header(&self) -> String {
        self.0.header()
    }

    /// Columns that hold words, not numbers.
    fn words(&self) -> Vec<&str> {
        self.0.words()
    }

    /// Makes some runs and returns their lines.
    fn rows(&self, py: Python<'_>, begin: usize, end: usize) -> PyResult<Vec<String>> {
        if begin > end || end > self.0.rows() {
            return Err(PyValueError::new_err(format!(
                "rows {begin} to {end}: allowed: 0 to {}",
                self.0.rows()
            )));
        }
        let rows = py.detach(|| (begin..end).map(|id| self.0.row(id)).collect::<Result<Vec<_>>>());
        rows.map_err(|error| wrong(&error))
    }

    /// Prepares a file for the next row and returns the number of rows that it holds.
    fn open(&self, out: PathBuf) -> PyResult<usize> {
        let opened = Campaign { table: &*self.0, out: &out, shard: (1, 1) }.open();
        opened.map(|(_, rows, _)| rows).map_err(|error| wrong(&error))
    }
}

/// Runs an experiment with keys of `moca-lab experiment --set` and returns its report as JSON.
#[pyfunction]
pub fn experiment(py: Python<'_>, name: &str, set: Vec<String>) -> PyResult<String> {
    if name != "collision" {
        return Err(PyValueError::new_err(format!("no experiment is called {name:?}; allowed: collision")));
    }
    let run = || {
        progress::be_quiet();
        let mut settings = Settings::paper(Law::Impedance);
        collision::defaults(&mut settings);
        settings.set_all(set)?;
        settings.check()?;
        Ok(serde_json::to_string(&collision::run(&settings)?.report)?)
    };
    py.detach(run).map_err(|error: Error| wrong(&error))
}
