//! Requests to a gripper by name, its state for Python, and the end of a request.

use crate::Refused;
use crate::request::exactly;
use moca_msgs::{GripperPhase, GripperRefusal, GripperRequest, GripperState};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;

/// Fields of `moca.GripperState`, in its order.
pub(crate) type Fields = (f64, f64, &'static str, bool, f64, Option<String>);

/// Returns the fields of a state.
pub(crate) fn fields(state: &GripperState) -> Fields {
    let fault = state.fault.map(|fault| fault.to_string());
    (state.width_m, state.width_max_m, state.phase.name(), state.is_holding(), state.object_kg, fault)
}

/// Returns what a robot without a gripper raises.
pub(crate) fn missing() -> PyErr {
    Refused::new_err(GripperRefusal::NoGripper.to_string())
}

/// Returns the request with a name and its numbers.
///
/// # Errors
/// `ValueError`: an unknown name, or other numbers than it takes.
pub(crate) fn request(name: &str, values: &[f64]) -> PyResult<GripperRequest> {
    let plain = |request| exactly(values, name).map(|[]| request);
    match name {
        "home" => plain(GripperRequest::Home),
        "release" => plain(GripperRequest::Release),
        "stop" => plain(GripperRequest::Stop),
        "move" => {
            let [width_m, speed_m_s] = exactly(values, "a width in m and a speed in m/s")?;
            Ok(GripperRequest::Move { width_m, speed_m_s })
        }
        "grasp" => {
            let [width_m, speed_m_s, force_n, tolerance_m, mass_kg] =
                exactly(values, "a grasp's width, speed, force, tolerance and mass")?;
            Ok(GripperRequest::Grasp { width_m, speed_m_s, force_n, tolerance_m, mass_kg })
        }
        _ => Err(PyValueError::new_err(format!(
            "no request to the gripper is called {name:?}; allowed: home, move, grasp, release, stop"
        ))),
    }
}

/// Returns true while the fingers move.
pub(crate) const fn moves(state: &GripperState) -> bool {
    matches!(state.phase, GripperPhase::Moving)
}

/// Returns true if an object is held in `state`, the latest one after `asked`.
///
/// # Errors
/// `Refused`: a fault. A grasp without an object is none, unless the gripper does not answer.
pub(crate) fn held(asked: GripperRequest, state: &GripperState) -> PyResult<bool> {
    let tells = matches!(asked, GripperRequest::Grasp { .. }) && state.phase != GripperPhase::Unknown;
    match state.fault {
        Some(fault) if !tells => Err(Refused::new_err(fault.to_string())),
        _ => Ok(state.is_holding()),
    }
}
