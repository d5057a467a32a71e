//! The base's admittance, eq. (2): M_v·v̇_d + D_v·v_d = τ_v, per axis.

use crate::scalar::Scalar;

/// Velocity after `dt` s under a force that is held, exactly: v ← a·v + (1 − a)·τ/D with a = e^(−D·dt/M), and
/// v + dt·τ/M at D = 0. Stable for every D/M and dt. eq. (2)
#[inline]
pub fn step<T: Scalar>(velocity: T, force: T, mass: T, damping: T, dt_s: T) -> T {
    let x = damping * dt_s / mass;
    // (1 − e^(−x))/x keeps its digits as D → 0
    let mean = if x > T::default_epsilon() { -(-x).exp_m1() / x } else { T::one() };
    velocity + mean * dt_s / mass * (force - damping * velocity)
}
