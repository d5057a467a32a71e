//! Gains in the scalar of the computation; a change reaches the law through a first-order filter.

use crate::scalar::{Scalar, all, of, same};
use moca_msgs::ImpedanceGains;

/// Time constant with which new gains take effect, s.
pub const GAIN_FILTER_S: f64 = 0.1;

/// Gains of the base's admittance, eq. (2), units as in [`ImpedanceGains`].
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub(crate) struct BaseGains<T> {
    pub(crate) virtual_mass: [T; 3],
    pub(crate) virtual_damping: [T; 3],
    pub(crate) reactivity: T,
}

/// Gains of the arm's impedance, eqs. (10) and (11), units as in [`ImpedanceGains`].
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub(crate) struct ArmGains<const N: usize, T> {
    pub(crate) stiffness: [T; 6],
    pub(crate) damping_ratio: T,
    #[cfg_attr(feature = "serde", serde(with = "serde_big_array::BigArray"))]
    pub(crate) posture_stiffness: [T; N],
    #[cfg_attr(feature = "serde", serde(with = "serde_big_array::BigArray"))]
    pub(crate) posture_damping: [T; N],
}

impl<const N: usize, T: Scalar> From<&ImpedanceGains<N>> for BaseGains<T> {
    fn from(gains: &ImpedanceGains<N>) -> Self {
        Self {
            virtual_mass: all(&gains.virtual_mass),
            virtual_damping: all(&gains.virtual_damping),
            reactivity: of(gains.reactivity),
        }
    }
}

impl<const N: usize, T: Scalar> From<&ImpedanceGains<N>> for ArmGains<N, T> {
    fn from(gains: &ImpedanceGains<N>) -> Self {
        Self {
            stiffness: all(&gains.stiffness),
            damping_ratio: of(gains.damping_ratio),
            posture_stiffness: all(&gains.posture_stiffness),
            posture_damping: all(&gains.posture_damping),
        }
    }
}

impl<T: Scalar> BaseGains<T> {
    /// One step of `dt_s` towards `target`.
    pub(crate) fn approach(&mut self, target: &Self, dt_s: T) {
        if same(&self.virtual_mass, &target.virtual_mass)
            & same(&self.virtual_damping, &target.virtual_damping)
            & (self.reactivity == target.reactivity)
        {
            return;
        }
        approach(&mut self.virtual_mass, &target.virtual_mass, dt_s);
        approach(&mut self.virtual_damping, &target.virtual_damping, dt_s);
        approach(core::slice::from_mut(&mut self.reactivity), &[target.reactivity], dt_s);
    }
}

impl<const N: usize, T: Scalar> ArmGains<N, T> {
    /// One step of `dt_s` towards `target`.
    pub(crate) fn approach(&mut self, target: &Self, dt_s: T) {
        if same(&self.stiffness, &target.stiffness)
            & same(&self.posture_stiffness, &target.posture_stiffness)
            & same(&self.posture_damping, &target.posture_damping)
            & (self.damping_ratio == target.damping_ratio)
        {
            return;
        }
        approach(&mut self.stiffness, &target.stiffness, dt_s);
        approach(&mut self.posture_stiffness, &target.posture_stiffness, dt_s);
        approach(&mut self.posture_damping, &target.posture_damping, dt_s);
        approach(core::slice::from_mut(&mut self.damping_ratio), &[target.damping_ratio], dt_s);
    }
}

/// One step of `dt_s` of the filter. Gains in range stay in range: every step is a convex combination.
pub(crate) fn approach<T: Scalar>(now: &mut [T], target: &[T], dt_s: T) {
    let share = -(-dt_s / of(GAIN_FILTER_S)).exp_m1();
    for (now, &target) in now.iter_mut().zip(target) {
        let gap = target - *now;
        // close enough to be the same for every purpose: end the filter
        *now = if gap.abs() <= target.abs() * of(1e-6) { target } else { *now + share * gap };
    }
}
