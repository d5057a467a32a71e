//! Everything that can go wrong in a simulation.

use thiserror::Error;

/// Why a plant could not be built or stepped.
#[derive(Clone, Debug, PartialEq, Error)]
pub enum SimError {
    /// A number of the scene is outside its range.
    #[error("scene: {name} = {value} {unit} is outside {min} to {max} {unit}")]
    Scene {
        /// Name of the field.
        name: &'static str,
        /// The offending value.
        value: f64,
        /// Its unit.
        unit: &'static str,
        /// Smallest allowed value.
        min: f64,
        /// Largest allowed value.
        max: f64,
    },
    /// The control period is not a whole number of physics steps.
    #[error("scene: control period {period_s} s is not a whole number of physics steps of {step_s} s")]
    Period {
        /// Control period, s.
        period_s: f64,
        /// Physics step, s.
        step_s: f64,
    },
    /// The analytic engine was asked for what only MuJoCo can do.
    #[error("the analytic engine cannot do {what}: take MuJoCo")]
    NeedsMuJoCo {
        /// Name of the object.
        what: &'static str,
    },
    /// Two parts of a scene that do not go together.
    #[error("scene: {what} is not possible: {why}")]
    Unsupported {
        /// Which.
        what: &'static str,
        /// Why.
        why: &'static str,
    },
    /// The engine refused the model.
    #[error("the engine refused the model: {0}")]
    Model(String),
    /// A command that is not a number; nothing of it was applied.
    #[error("command: {name} = {value} is not finite")]
    Command {
        /// Which value.
        name: &'static str,
        /// The offending value.
        value: f64,
    },
    /// A force or wrench from outside that is not usable.
    #[error("{name} = {value} is outside {min} to {max}")]
    Load {
        /// Which value.
        name: &'static str,
        /// The offending value.
        value: f64,
        /// Smallest allowed value.
        min: f64,
        /// Largest allowed value.
        max: f64,
    },
    /// The operating system refused something.
    #[error("cannot {action}: {reason}")]
    Os {
        /// Attempted action.
        action: String,
        /// Message of the system.
        reason: String,
    },
    /// The engine raised a warning: the state is no longer to be trusted.
    #[error("simulation failed at t = {time_s} s: {warning}")]
    Unstable {
        /// Text of the warning.
        warning: &'static str,
        /// Simulation time, s.
        time_s: f64,
    },
}

/// An error of the operating system, with what was tried.
pub(crate) fn os(action: &str, error: &std::io::Error) -> SimError {
    SimError::Os { action: action.to_owned(), reason: error.to_string() }
}

/// The first of `values` outside its range; NaN and infinity are outside every range.
pub(crate) fn within(
    name: &'static str,
    unit: &'static str,
    values: &[f64],
    min: f64,
    max: f64,
) -> Result<(), SimError> {
    match values.iter().find(|v| !(**v >= min && **v <= max)) {
        Some(&value) => Err(SimError::Scene { name, value, unit, min, max }),
        None => Ok(()),
    }
}
