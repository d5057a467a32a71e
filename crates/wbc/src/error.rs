//! Why a controller refused.

/// An input that a controller refuses, or a state it cannot compute with. The caller's state is left as it was.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum ControlError {
    /// A value that is NaN or infinite.
    NotFinite {
        /// Which input or result.
        what: &'static str,
        /// Place in it, from 0.
        index: usize,
    },
    /// Time since the last step not above 0 s.
    Step {
        /// Given period, s.
        dt_s: f64,
    },
    /// Speed limit of a guard below 0 m/s.
    GuardSpeed {
        /// Given speed, m/s.
        speed_m_s: f64,
    },
    /// Bounds of a guard within which the base may not stand still.
    GuardBounds {
        /// Axis of B: 0 is x, 1 is y, 2 is yaw.
        axis: usize,
    },
    /// Quaternion whose length is not 1.
    NotUnit {
        /// Given norm.
        norm: f64,
    },
    /// A matrix that must be positive definite is not: the model's inertias are impossible.
    NotPositiveDefinite {
        /// Which matrix.
        what: &'static str,
    },
}

impl core::fmt::Display for ControlError {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        match self {
            Self::NotFinite { what, index } => write!(f, "{what}[{index}] is not a finite number"),
            Self::Step { dt_s } => write!(f, "time since the last step = {dt_s} s is not above 0 s"),
            Self::GuardSpeed { speed_m_s } => write!(f, "guard speed = {speed_m_s} m/s is below 0 m/s"),
            Self::GuardBounds { axis } => {
                write!(f, "guard bounds along axis {axis} of B leave out 0")
            }
            Self::NotUnit { norm } => write!(f, "quaternion of length {norm} is outside 0.999 to 1.001"),
            Self::NotPositiveDefinite { what } => write!(f, "{what} is not positive definite"),
        }
    }
}

impl core::error::Error for ControlError {}

/// Errs on the first value that is NaN or infinite.
pub(crate) fn finite<T: crate::Scalar>(what: &'static str, values: &[T]) -> Result<(), ControlError> {
    // without a branch for each of them, which a good step never takes: 0 times a number is 0, times any other value NaN
    if values.iter().fold(T::zero(), |sum, value| sum + *value * T::zero()) == T::zero() {
        return Ok(());
    }
    match values.iter().position(|value| !value.is_finite()) {
        None => Ok(()),
        Some(index) => Err(ControlError::NotFinite { what, index }),
    }
}
