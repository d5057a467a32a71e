//! A sample, as bytes of doubles under the names of its fields.

use moca_msgs::{Sample, seconds};
use pyo3::exceptions::PyAttributeError;
use pyo3::prelude::*;
use pyo3::types::PyBytes;

/// One tick of a robot.
#[pyclass(frozen, module = "moca._moca")]
pub struct State(pub(crate) Sample);

/// Numbers of a sample by the name of their field; `None` for a name that there is not.
pub(crate) fn numbers(sample: &Sample, field: &str) -> Option<Vec<f64>> {
    Some(match field {
        "time_s" => vec![seconds(sample.time_ns)],
        "base_pose_world" => sample.base_pose_world.to_vec(),
        "base_velocity_world" => sample.base_velocity_world.to_vec(),
        "base_velocity_command_body" => sample.base_velocity_command_body.to_vec(),
        "cover_speed_m_s" => vec![sample.cover_speed_m_s],
        "speed_limit_m_s" => vec![sample.speed_limit.m_s],
        "q_rad" => sample.q_rad.to_vec(),
        "dq_rad_s" => sample.dq_rad_s.to_vec(),
        "arm_torque_nm" => sample.arm_torque_nm.to_vec(),
        "flange_position_world" => sample.flange_position_world.to_vec(),
        "flange_quaternion_world" => sample.flange_quaternion_world.to_vec(),
        "flange_desired_position_world" => sample.flange_desired_position_world.to_vec(),
        "flange_desired_quaternion_world" => sample.flange_desired_quaternion_world.to_vec(),
        "flange_wrench_world" => sample.flange_wrench_world.to_vec(),
        "cover_wrench_base" => sample.cover_wrench_base.to_vec(),
        // Stale or dead is not zero: what is not known is no number.
        "taxel_force_n" => sample
            .taxels
            .iter()
            .map(|taxel| if taxel.status == moca_msgs::TaxelStatus::Ok { taxel.force_n } else { f64::NAN })
            .collect(),
        "frame_age_s" => vec![if sample.frame_age_s < 0.0 { f64::NAN } else { sample.frame_age_s }],
        "target_progress" => vec![sample.target.map_or(f64::NAN, |target| target.progress)],
        _ => return None,
    })
}

/// The names that [`numbers`] knows.
pub(crate) const FIELDS: [&str; 18] = [
    "time_s",
    "base_pose_world",
    "base_velocity_world",
    "base_velocity_command_body",
    "cover_speed_m_s",
    "speed_limit_m_s",
    "q_rad",
    "dq_rad_s",
    "arm_torque_nm",
    "flange_position_world",
    "flange_quaternion_world",
    "flange_desired_position_world",
    "flange_desired_quaternion_world",
    "flange_wrench_world",
    "cover_wrench_base",
    "taxel_force_n",
    "frame_age_s",
    "target_progress",
];

/// Doubles as bytes, for `numpy.frombuffer`.
pub(crate) fn bytes<'py>(py: Python<'py>, values: &[f64]) -> Bound<'py, PyBytes> {
    let bytes: Vec<u8> = values.iter().flat_map(|value| value.to_ne_bytes()).collect();
    PyBytes::new(py, &bytes)
}

#[pymethods]
impl State {
    /// The numbers of a field.
    fn numbers<'py>(&self, py: Python<'py>, field: &str) -> PyResult<Bound<'py, PyBytes>> {
        let values = numbers(&self.0, field).ok_or_else(|| PyAttributeError::new_err(field.to_owned()))?;
        Ok(bytes(py, &values))
    }

    #[getter]
    fn tick(&self) -> u64 {
        self.0.tick
    }

    #[getter]
    fn overruns(&self) -> u64 {
        self.0.overruns
    }

    #[getter]
    fn mode(&self) -> &'static str {
        self.0.mode.name()
    }

    #[getter]
    fn law(&self) -> Option<&'static str> {
        self.0.law.map(|law| moca_msgs::Mode::from(law).name())
    }

    #[getter]
    fn fault(&self) -> Option<String> {
        self.0.fault.map(|fault| fault.to_string())
    }

    #[getter]
    fn target(&self) -> Option<(&'static str, &'static str)> {
        self.0.target.map(|target| (target.kind.name(), target.phase.name()))
    }
}
