//! The base's admittance, eq. (2): M_v·v̇_d + D_v·v_d = τ_v, per axis.
//!
//! ```
//! use moca_wbc::admittance::step;
//!
//! // 20 N on 4 kg and 80 N·s/m: exact for any step, so one of 1 s ends where 1000 of 1 ms do
//! let (mass, damping) = (4.0, 80.0);
//! let at_once: f64 = step(0.0, 20.0, mass, damping, 1.0);
//! let in_steps = (0..1000).fold(0.0, |v, _| step(v, 20.0, mass, damping, 1e-3));
//! assert!((at_once - in_steps).abs() < 1e-12 && (at_once - 0.25).abs() < 1e-8);
//! ```

use crate::error::ControlError;
use crate::gains::BaseGains;
use crate::linalg::{Cholesky, times};
use crate::opspace::BlockWeighted;
use crate::scalar::Scalar;
use nalgebra::Matrix3;

/// Velocity after `dt` s under a force that is held, exactly: v ← a·v + (1 − a)·τ/D with a = e^(−D·dt/M), and
/// v + dt·τ/M at D = 0. Stable for every D/M and dt. eq. (2)
#[inline]
pub fn step<T: Scalar>(velocity: T, force: T, mass: T, damping: T, dt_s: T) -> T {
    stepped(velocity, force, mass, damping, dt_s, mean_share(mass, damping, dt_s))
}

/// [`step`] of a known [`mean_share`].
#[inline]
fn stepped<T: Scalar>(velocity: T, force: T, mass: T, damping: T, dt_s: T, share: T) -> T {
    velocity + share * dt_s / mass * (force - damping * velocity)
}

/// Mean acceleration of [`step`] over its `dt_s`, of the one at its start: (1 − e^(−x))/x with x = D·dt/M.
#[inline]
fn mean_share<T: Scalar>(mass: T, damping: T, dt_s: T) -> T {
    let x = damping * dt_s / mass;
    // keeps its digits as D → 0
    if x > T::default_epsilon() { -(-x).exp_m1() / x } else { T::one() }
}

/// Exact zero-order hold of eq. (2) on all three axes: velocities, and mean accelerations of those at the start.
pub(crate) fn admitted<T: Scalar>(
    gains: &BaseGains<T>,
    velocity: &[T; 3],
    force: &[T; 3],
    dt_s: T,
) -> ([T; 3], [T; 3]) {
    let (mass, damping) = (&gains.virtual_mass, &gains.virtual_damping);
    let share = |i: usize| mean_share(mass[i], damping[i], dt_s);
    let x = share(0);
    // most bases are alike along x and y, and an exponential is not cheap
    let y = if mass[0] == mass[1] && damping[0] == damping[1] { x } else { share(1) };
    let shares = [x, y, share(2)];
    (core::array::from_fn(|i| stepped(velocity[i], force[i], mass[i], damping[i], dt_s, shares[i])), shares)
}

/// eq. (2) with its damping moved into τ_0: M_v·v̇ = τ_v − S·M_v⁻¹·D_v·v, S the free base mass. Implicit in v, because
/// S couples the axes: (M_v/dt + Q·S·Q)·Q·v⁺ = Q·(M_v·v/dt + τ_v) with Q = (M_v⁻¹D_v)^½ is symmetric and stable for
/// every D/M and dt.
pub(crate) fn damped_in_null_space<const N: usize, T: Scalar>(
    weighted: &BlockWeighted<'_, N, T>,
    gains: &BaseGains<T>,
    velocity: &[T; 3],
    force: &[T; 3],
    dt_s: T,
) -> Result<[T; 3], ControlError> {
    let mass = &gains.virtual_mass;
    let free = weighted.free_base_mass();
    let q: [T; 3] = core::array::from_fn(|i| (gains.virtual_damping[i] / mass[i]).sqrt());
    let mut system = Matrix3::from_fn(|i, j| q[i] * free[(i, j)] * q[j]);
    for i in 0..3 {
        system[(i, i)] += mass[i] / dt_s;
    }
    let factor =
        Cholesky::new_shifted(&system).ok_or(ControlError::NotPositiveDefinite { what: "base damping" })?;
    let z = factor.solve(&core::array::from_fn(|i| q[i] * (mass[i] / dt_s * velocity[i] + force[i])));
    let drag = times(&free, &core::array::from_fn(|i| q[i] * z[i]));
    Ok(core::array::from_fn(|i| velocity[i] + dt_s / mass[i] * (force[i] - drag[i])))
}
