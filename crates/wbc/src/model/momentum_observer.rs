//! External torques from the arm's momentum (De Luca 2003): no acceleration is measured and no mass matrix inverted.
//!
//! p = M_A q̇_A + M_AB q̇_B obeys ṗ = τ + Cᵀq̇ − g + τ_ext, so r = K·(p − ∫(τ + Cᵀq̇ − g + r)) follows τ_ext with a
//! first-order lag of 1/K. The base's motion is in p: an accelerating base is not mistaken for a push.
//!
//! ```
//! use moca_wbc::momentum_observer::MomentumObserver;
//!
//! // one joint of 2 kg·m² that a hand turns with 3 N·m while its motor does nothing
//! let mut observer = MomentumObserver::<1, f64>::new();
//! for tick in 0..200 {
//!     let momentum = 3.0 * 1e-3 * f64::from(tick);
//!     observer.update(&([momentum], [0.0]), &[0.0], &[0.0], 1e-3);
//! }
//! assert!((observer.external_torque()[0] - 3.0).abs() < 1e-3);
//! ```

use crate::scalar::{Scalar, of};

/// Lag of the estimate, s.
pub const OBSERVER_LAG_S: f64 = 0.02;

/// State of the observer.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(
    feature = "serde",
    derive(serde::Serialize, serde::Deserialize),
    serde(bound = "T: crate::Scalar")
)]
pub struct MomentumObserver<const N: usize, T> {
    /// ∫(τ + Cᵀq̇ − g + r) + p(0), N·m·s.
    #[cfg_attr(feature = "serde", serde(with = "serde_big_array::BigArray"))]
    integral: [T; N],
    /// r, N·m.
    #[cfg_attr(feature = "serde", serde(with = "serde_big_array::BigArray"))]
    residual: [T; N],
    started: bool,
}

impl<const N: usize, T: Scalar> MomentumObserver<N, T> {
    /// An observer that takes its first momentum as the undisturbed one.
    pub fn new() -> Self {
        Self { integral: [T::zero(); N], residual: [T::zero(); N], started: false }
    }

    /// Keeps the estimate where the model changes: the next momentum is taken as that of the same motion with other masses.
    pub const fn change_model(&mut self) {
        self.started = false;
    }

    /// One step: momentum and its drift Cᵀq̇ now ([`crate::ArmModel::momentum`]), gravity torques now, and the joint torques that
    /// acted since the last step. Implicit in r: stable for every step.
    pub fn update(
        &mut self,
        (momentum, drift): &([T; N], [T; N]),
        gravity: &[T; N],
        torque: &[T; N],
        dt_s: T,
    ) {
        let gain = T::one() / of(OBSERVER_LAG_S);
        if !self.started {
            self.integral = core::array::from_fn(|i| momentum[i] - self.residual[i] / gain);
            self.started = true;
            return;
        }
        for i in 0..N {
            let predicted = self.integral[i] + dt_s * (torque[i] + drift[i] - gravity[i]);
            self.residual[i] = gain * (momentum[i] - predicted) / (T::one() + gain * dt_s);
            self.integral[i] = predicted + dt_s * self.residual[i];
        }
    }

    /// Estimated external joint torques, N·m, on the robot: M q̈ + C q̇ + g = τ + r.
    pub fn external_torque(&self) -> &[T; N] {
        &self.residual
    }
}

impl<const N: usize, T: Scalar> Default for MomentumObserver<N, T> {
    fn default() -> Self {
        Self::new()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn other_masses_of_a_moving_arm_are_no_push() {
        let mut observer = MomentumObserver::<1, f64>::new();
        let step = |observer: &mut MomentumObserver<1, f64>, momentum: f64| {
            observer.update(&([momentum], [0.0]), &[0.0], &[0.0], 1e-3);
            observer.external_torque()[0]
        };
        for tick in 0..200 {
            step(&mut observer, 3.0 * 1e-3 * f64::from(tick));
        }
        let before = observer.external_torque()[0];
        observer.change_model();
        // The load doubles the momentum; the push goes on.
        let momentum = |tick: i32| 2.0 * 3.0 * 1e-3 * 199.0 + 3.0 * 1e-3 * f64::from(tick);
        assert_eq!(step(&mut observer, momentum(1)).to_bits(), before.to_bits());
        for tick in 2..400 {
            let external_nm = step(&mut observer, momentum(tick));
            assert!((external_nm - 3.0).abs() < 1e-3, "tick {tick}: {external_nm}");
        }
    }
}
