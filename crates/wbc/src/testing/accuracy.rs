//! Accuracy at the ends of the range, against a file of results in 80 digits.
//!
//! ```
//! use moca_wbc::testing::accuracy::{Step, admitted};
//!
//! // eq. (2) from rest under 8 N for 0.1 s: with M_v = 4 kg and D_v = 80 N·s/m the speed goes to 0.1 (1 − e⁻²) m/s
//! let after = 0.1 * (1.0 - (-2.0_f64).exp());
//! let step = Step { mass: 4.0, damping: 80.0, dt: 0.1, velocity: 0.0, force: 8.0, after };
//! assert!(admitted::<f64>(&step) < 1e-15, "the error");
//! ```

use crate::opspace::{ArmDynamics, BlockWeight, TaskDynamics, WholeBodyForce};
use crate::{ArmModel, ControlError, Scalar, admittance, impedance};
use moca_msgs::robot::{MOCA_MOUNT, PANDA};
use moca_msgs::{ParameterError, Payload};
use serde::Deserialize;
use std::{string::String, vec::Vec};

/// Results in 80 digits, rounded to f64: the form of `tests/fixtures/extremes.json`.
#[derive(Debug, Deserialize)]
pub struct Reference {
    /// Configurations.
    pub cases: Vec<Case>,
    /// Steps of the admittance.
    pub admittance: Vec<Step>,
}

/// One configuration: eq. (6) and the damping of eq. (10).
#[derive(Debug, Deserialize)]
pub struct Case {
    /// Shown to users.
    pub name: String,
    /// Pose of the base (m, m, rad) and joint angles, rad.
    pub q: [f64; 10],
    /// η_B.
    pub eta_base: f64,
    /// η_A.
    pub eta_arm: f64,
    /// M_v: kg, kg, kg·m².
    pub virtual_mass: [f64; 3],
    /// K_d: N/m, N·m/rad.
    pub stiffness: [f64; 6],
    /// F: N, N·m.
    pub wrench: [f64; 6],
    /// τ_0: N, N, N·m, N·m ×7.
    pub null: [f64; 10],
    /// Condition number of the weighted Λ⁻¹; `None` where it is singular.
    pub condition: Option<f64>,
    /// The result of eq. (6), units as `null`.
    pub force: [f64; 10],
    /// D_d: N·s/m, N·m·s/rad.
    pub damping: Option<[[f64; 6]; 6]>,
}

/// One step of eq. (2).
#[derive(Debug, Deserialize)]
pub struct Step {
    /// kg.
    pub mass: f64,
    /// N·s/m.
    pub damping: f64,
    /// s.
    pub dt: f64,
    /// Before, m/s.
    pub velocity: f64,
    /// Held over the step, N.
    pub force: f64,
    /// After, m/s.
    pub after: f64,
}

/// Errors of one configuration, max|a − ref| / max(max|ref|, 1).
#[derive(Clone, Copy, Debug)]
pub struct Accuracy {
    /// Error of the torques.
    pub force: f64,
    /// Error of the damping matrix; 0 where it has no reference.
    pub damping: f64,
    /// Largest joint torque, N·m.
    pub largest_nm: f64,
}

/// A case that could not be computed.
#[derive(Debug)]
pub enum Failure {
    /// The arm's table.
    Model(ParameterError),
    /// The law.
    Control(ControlError),
}

impl core::fmt::Display for Failure {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        match self {
            Self::Model(error) => error.fmt(f),
            Self::Control(error) => error.fmt(f),
        }
    }
}

impl core::error::Error for Failure {}

impl From<ParameterError> for Failure {
    fn from(error: ParameterError) -> Self {
        Self::Model(error)
    }
}

impl From<ControlError> for Failure {
    fn from(error: ControlError) -> Self {
        Self::Control(error)
    }
}

/// The law and its damping in the scalar `T`, against `case`.
///
/// # Errors
/// An impossible model.
pub fn accuracy<T: Scalar>(case: &Case) -> Result<Accuracy, Failure> {
    let model = ArmModel::<7, T>::new(&PANDA, &MOCA_MOUNT, &Payload::NONE)?;
    let [_, _, yaw, joints @ ..] = case.q.map(nalgebra::convert::<f64, T>);
    let dynamics = model.dynamics(yaw, &joints, &[T::zero(); 7]);
    let arm = ArmDynamics::new(&dynamics)?;
    let task = TaskDynamics::new(case.virtual_mass.map(nalgebra::convert), &arm);
    let [b0, b1, b2, joints @ ..] = case.null.map(nalgebra::convert::<f64, T>);
    let null = WholeBodyForce { base: [b0, b1, b2], arm: joints };
    let weight = BlockWeight::new(nalgebra::convert(case.eta_base), nalgebra::convert(case.eta_arm));
    let force = weight.factor(&task)?.force(&case.wrench.map(nalgebra::convert), &null);
    let values: Vec<f64> = force.base.iter().chain(&force.arm).copied().map(double).collect();
    let damping = match &case.damping {
        None => 0.0,
        Some(reference) => {
            let stiffness = case.stiffness.map(nalgebra::convert);
            let damping =
                impedance::damping(&task.inverse_task_inertia(), &stiffness, nalgebra::convert(0.9))?;
            let values: Vec<f64> = damping.iter().copied().map(double).collect();
            error(&values, reference.as_flattened())
        }
    };
    Ok(Accuracy {
        force: error(&values, &case.force),
        damping,
        largest_nm: values.iter().skip(3).fold(0.0, |most, torque| most.max(torque.abs())),
    })
}

/// One step of eq. (2) in the scalar `T`, against `step`.
pub fn admitted<T: Scalar>(step: &Step) -> f64 {
    let of = nalgebra::convert::<f64, T>;
    let after =
        admittance::step(of(step.velocity), of(step.force), of(step.mass), of(step.damping), of(step.dt));
    error(&[double(after)], &[step.after])
}

fn double<T: Scalar>(value: T) -> f64 {
    nalgebra::try_convert(value).unwrap_or(f64::NAN)
}

fn error(values: &[f64], reference: &[f64]) -> f64 {
    let scale = reference.iter().fold(1.0_f64, |most, r| most.max(r.abs()));
    values.iter().zip(reference).fold(0.0, |worst, (a, r)| {
        let gap = (a - r).abs() / scale;
        // f64::max would drop a NaN
        if gap <= worst { worst } else { gap }
    })
}
