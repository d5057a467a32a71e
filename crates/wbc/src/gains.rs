//! Gains in the scalar of the computation; a change reaches the law through a first-order filter.

use crate::scalar::{Scalar, all, of};
use moca_msgs::ImpedanceGains;

/// Time constant with which new gains take effect, s.
pub const GAIN_FILTER_S: f64 = 0.1;

/// Gains of [`ImpedanceGains`] as the law uses them, units as there.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Gains<const N: usize, T> {
    pub(crate) virtual_mass: [T; 3],
    pub(crate) virtual_damping: [T; 3],
    pub(crate) stiffness: [T; 6],
    pub(crate) damping_ratio: T,
    pub(crate) eta_base: T,
    pub(crate) eta_arm: T,
    pub(crate) posture_stiffness: [T; N],
    pub(crate) posture_damping: [T; N],
    pub(crate) reactivity: T,
}

impl<const N: usize, T: Scalar> From<&ImpedanceGains<N>> for Gains<N, T> {
    fn from(gains: &ImpedanceGains<N>) -> Self {
        Self {
            virtual_mass: all(&gains.virtual_mass),
            virtual_damping: all(&gains.virtual_damping),
            stiffness: all(&gains.stiffness),
            damping_ratio: of(gains.damping_ratio),
            eta_base: of(gains.eta_base),
            eta_arm: of(gains.eta_arm),
            posture_stiffness: all(&gains.posture_stiffness),
            posture_damping: all(&gains.posture_damping),
            reactivity: of(gains.reactivity),
        }
    }
}

impl<const N: usize, T: Scalar> Gains<N, T> {
    /// One step of `dt_s` towards `target`. Gains in range stay in range: every step is a convex combination.
    pub(crate) fn approach(&mut self, target: &Self, dt_s: T) {
        if self == target {
            return;
        }
        let share = -(-dt_s / of(GAIN_FILTER_S)).exp_m1();
        let step = |now: &mut T, target: &T| {
            let gap = *target - *now;
            // close enough to be the same for every purpose: end the filter
            *now = if gap.abs() <= target.abs() * of(1e-6) { *target } else { *now + share * gap };
        };
        let pairs = [
            (&mut self.virtual_mass[..], &target.virtual_mass[..]),
            (&mut self.virtual_damping, &target.virtual_damping),
            (&mut self.stiffness, &target.stiffness),
            (&mut self.posture_stiffness, &target.posture_stiffness),
            (&mut self.posture_damping, &target.posture_damping),
        ];
        for (now, target) in pairs {
            now.iter_mut().zip(target).for_each(|(now, target)| step(now, target));
        }
        step(&mut self.damping_ratio, &target.damping_ratio);
        step(&mut self.eta_base, &target.eta_base);
        step(&mut self.eta_arm, &target.eta_arm);
        step(&mut self.reactivity, &target.reactivity);
    }
}
