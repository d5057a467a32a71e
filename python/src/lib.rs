//! The Python package `moca`, half of it: what `moca/__init__.py` gives names, units and numpy arrays to.

mod batch;
mod client;
mod gripper;
mod log;
mod request;
mod simulation;
mod state;
mod sweep;
mod world;

use pyo3::prelude::*;

pyo3::create_exception!(
    _moca,
    Refused,
    pyo3::exceptions::PyRuntimeError,
    "The robot does not do what it was asked."
);
pyo3::create_exception!(
    _moca,
    Disconnected,
    pyo3::exceptions::PyConnectionError,
    "There is no daemon, or no more."
);

#[pymodule]
fn _moca(module: &Bound<'_, PyModule>) -> PyResult<()> {
    module.add("Refused", module.py().get_type::<Refused>())?;
    module.add("Disconnected", module.py().get_type::<Disconnected>())?;
    module.add_function(wrap_pyfunction!(client::stop, module)?)?;
    module.add_function(wrap_pyfunction!(sweep::experiment, module)?)?;
    module.add_class::<sweep::Plan>()?;
    module.add_class::<state::State>()?;
    module.add_class::<client::Client>()?;
    module.add_class::<log::Log>()?;
    module.add_class::<simulation::Simulation>()?;
    module.add_class::<batch::Shared>()?;
    module.add_class::<batch::Batch>()
}
