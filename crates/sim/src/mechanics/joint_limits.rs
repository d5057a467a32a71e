//! Joint limits as MuJoCo has them by default: a joint beyond its end is pushed back by a spring and a damper that are
//! scaled by what the joint weighs in the home of its coordinates, never pulled. Of the accelerations that the pushes make
//! it takes those of least constraint (Gauss): <https://mujoco.readthedocs.io/en/stable/computation/index.html>.

use crate::SimError;
use moca_msgs::ArmTable;
use moca_wbc::coupled::CoupledDynamics;
use moca_wbc::opspace::WholeBodyForce;

/// Time constant, s, and damping ratio with which a violation goes back (`solref`).
const REFERENCE: (f64, f64) = (0.02, 1.0);
/// Impedance at the limit and beyond `WIDTH_RAD` of violation; the change between is two parabolas (`solimp`).
const IMPEDANCE: (f64, f64) = (0.9, 0.95);
const WIDTH_RAD: f64 = 0.001;
/// A set of pushes that turns up again is not the solution; there are few joints and fewer sets.
const SETS_MAX: usize = 32;

/// Ends of `N` joints.
#[derive(Debug)]
pub(super) struct JointLimits<const N: usize> {
    min_rad: [f64; N],
    max_rad: [f64; N],
    /// Diagonal of the inverse mass matrix of base and arm, all coordinates at zero, 1/(kg·m²).
    inverse_weight: [f64; N],
    /// `REFERENCE` as a spring and a damper of unit mass, 1/s² and 1/s.
    stiffness: f64,
    damping: f64,
}

/// A joint beyond its end.
#[derive(Clone, Copy, Debug)]
struct Push {
    /// +1 at the lower end, −1 at the upper.
    direction: f64,
    /// Acceleration back into the range that is wanted, rad/s².
    wanted: f64,
    /// Force for what is missing of it, kg·m².
    weight: f64,
}

impl<const N: usize> JointLimits<N> {
    /// `at_zero` is the plant with all its coordinates and rates at zero.
    pub(super) fn new(
        arm: &ArmTable<N>,
        at_zero: &CoupledDynamics<N, f64>,
        step_s: f64,
    ) -> Result<Self, SimError> {
        let mut inverse_weight = [0.0; N];
        for (i, weight) in inverse_weight.iter_mut().enumerate() {
            let mut unit = WholeBodyForce { base: at_zero.base_bias, arm: at_zero.arm.bias };
            unit.arm[i] += 1.0;
            let (_, acceleration) = at_zero.acceleration(&unit, (&[0.0; 3], &[0.0; N])).ok_or_else(|| {
                SimError::Model("the arm's mass matrix is not positive definite".to_owned())
            })?;
            *weight = acceleration[i];
        }
        let (time_s, ratio) = (REFERENCE.0.max(2.0 * step_s), REFERENCE.1);
        let of_impedance = IMPEDANCE.1 * time_s;
        Ok(Self {
            min_rad: arm.q_min_rad,
            max_rad: arm.q_max_rad,
            inverse_weight,
            stiffness: 1.0 / (of_impedance * ratio).powi(2),
            damping: 2.0 / of_impedance,
        })
    }

    /// Torques on the joints under `force` on everything, N·m; `None` while no joint is beyond its end.
    pub(super) fn torque_nm(
        &self,
        plant: &CoupledDynamics<N, f64>,
        force: &WholeBodyForce<N, f64>,
        q: &[f64; N],
        dq: &[f64; N],
    ) -> Option<[f64; N]> {
        if (0..N).all(|i| self.min_rad[i] <= q[i] && q[i] <= self.max_rad[i]) {
            return None;
        }
        let pushes: [Option<Push>; N] = std::array::from_fn(|i| self.push(i, q[i], dq[i]));
        let mut acts = [false; N];
        let mut acceleration = plant.acceleration(force, (&[0.0; 3], &[0.0; N]))?.1;
        for _ in 0..SETS_MAX {
            let next = std::array::from_fn(|i| {
                pushes[i].is_some_and(|push| push.direction * acceleration[i] < push.wanted)
            });
            if next == acts {
                break;
            }
            acts = next;
            let (mut pushed, mut added) = (*force, [0.0; N]);
            for (i, push) in pushes.iter().enumerate().filter(|(i, _)| acts[*i]) {
                if let Some(push) = push {
                    pushed.arm[i] += push.direction * push.weight * push.wanted;
                    added[i] = push.weight;
                }
            }
            acceleration = plant.acceleration(&pushed, (&[0.0; 3], &added))?.1;
        }
        Some(std::array::from_fn(|i| match pushes[i] {
            Some(push) if acts[i] => {
                push.direction * push.weight * (push.wanted - push.direction * acceleration[i])
            }
            _ => 0.0,
        }))
    }

    fn push(&self, i: usize, q: f64, dq: f64) -> Option<Push> {
        let (direction, beyond) = if q < self.min_rad[i] {
            (1.0, self.min_rad[i] - q)
        } else if q > self.max_rad[i] {
            (-1.0, q - self.max_rad[i])
        } else {
            return None;
        };
        let impedance = impedance(beyond);
        Some(Push {
            direction,
            wanted: self.stiffness * impedance * beyond - self.damping * direction * dq,
            weight: impedance / ((1.0 - impedance) * self.inverse_weight[i]),
        })
    }
}

/// Share of a violation's acceleration that the limit has a say in.
fn impedance(beyond_rad: f64) -> f64 {
    let x = beyond_rad / WIDTH_RAD;
    let (least, most) = IMPEDANCE;
    if x >= 1.0 {
        return most;
    }
    let rise = if x <= 0.5 { 2.0 * x * x } else { 1.0 - 2.0 * (1.0 - x) * (1.0 - x) };
    least + rise * (most - least)
}
