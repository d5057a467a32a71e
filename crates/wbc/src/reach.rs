//! How far from the shoulder a tool may be while the base goes away and the arm holds it in its place.
//!
//! ```
//! use moca_wbc::reach::ArmReach;
//! use moca_wbc::robot::{MOCA_MOUNT, PANDA};
//! use moca_wbc::{ArmModel, Payload};
//!
//! let model = ArmModel::new(&PANDA, &MOCA_MOUNT, &Payload::NONE)?;
//! let reach = ArmReach::new(&PANDA, &model, &PANDA.home_rad, 0.3);
//! let [from_m, to_m] = reach.radius_m;
//! assert!(from_m > 0.5 && to_m < 0.65, "at home the flange is 0.31 m from the shoulder, and the elbow is straight at 0.70 m");
//! // with the tool half a metre ahead of the middle of the base all is well, with 0.9 m it has to come along
//! assert_eq!([0.5, 0.9].map(|x_m| reach.used(&[x_m, 0.0]).0), [0.0, 1.0]);
//! # Ok::<(), moca_wbc::ParameterError>(())
//! ```

use crate::limits::JointSpeeds;
use crate::linalg::{Cholesky, transpose_times};
use crate::model::ArmModel;
use crate::scalar::{Scalar, of};
use moca_msgs::ArmTable;

/// Shares of its largest speed that the fastest joint has where the reach begins to end, and where it has ended.
const PACE: [f64; 2] = [0.5, 0.8];
/// Way between two postures that are looked at, m,
const STEP_M: f64 = 0.005;
/// and most of them: no arm is longer.
const STEPS: usize = 1000;

/// From the shoulder, about whose upright axis the first joint turns, to the tool, seen from above: where the elbow gets straight
/// it has to go fast for little way.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ArmReach {
    /// Origin of the arm's base A, axes of B, m.
    pub shoulder_base_m: [f64; 2],
    /// Distance at which the reach begins to end, and at which it has ended, m: 0 where it has from the start.
    pub radius_m: [f64; 2],
}

impl ArmReach {
    /// Of `arm` whose shoulder goes straight away from the tool at `speed_m_s`, from `posture_rad` on; the tool keeps its height
    /// and its axes. Found once, posture by posture.
    pub fn new<const N: usize>(
        arm: &ArmTable<N>,
        model: &ArmModel<N, f64>,
        posture_rad: &[f64; N],
        speed_m_s: f64,
    ) -> Self {
        let (_, shoulder) = model.mount();
        let speeds = JointSpeeds::new(arm);
        let within = |q: &[f64; N]| (0..N).all(|i| (arm.q_min_rad[i]..=arm.q_max_rad[i]).contains(&q[i]));
        let mut radius_m = [0.0; 2];
        let mut q = *posture_rad;
        for _ in 0..STEPS {
            let Some((at_m, rates)) = outwards(model, &q).filter(|_| within(&q)) else { break };
            let pace = speeds.share(&q, &rates.map(|rate| rate * speed_m_s));
            for (radius_m, most) in radius_m.iter_mut().zip(PACE) {
                *radius_m = if pace <= most { at_m } else { *radius_m };
            }
            // by the rates in the middle of the step, whose error is of third order
            let middle = core::array::from_fn(|i| q[i] + 0.5 * STEP_M * rates[i]);
            let Some((_, rates)) = outwards(model, &middle).filter(|_| pace <= 1.0) else { break };
            q = core::array::from_fn(|i| q[i] + STEP_M * rates[i]);
        }
        Self { shoulder_base_m: [shoulder.x, shoulder.y], radius_m }
    }

    /// How much of the last part of the reach a tool at `tool_base_m` (axes of B, m) uses, 0 to 1, and the direction from the
    /// shoulder to it.
    pub fn used<T: Scalar>(&self, tool_base_m: &[T; 2]) -> (T, [T; 2]) {
        let [x, y]: [T; 2] = core::array::from_fn(|i| tool_base_m[i] - of(self.shoulder_base_m[i]));
        let radius = (x * x + y * y).sqrt().max(T::default_epsilon());
        let [from, to] = self.radius_m.map(of::<T>);
        let share = (radius - from) / (to - from).max(T::default_epsilon());
        (share.clamp(T::zero(), T::one()), [x / radius, y / radius])
    }
}

/// How far the tool is from the shoulder, m, and the joint rates that take it further away, rad/m. `None` where none do.
fn outwards<const N: usize>(model: &ArmModel<N, f64>, q: &[f64; N]) -> Option<(f64, [f64; N])> {
    let kinematics = model.kinematics(0.0, q);
    let (jacobian, tool) = (kinematics.arm_jacobian(), kinematics.tool_position);
    let radius = tool.x.hypot(tool.y).max(f64::MIN_POSITIVE);
    let twist = [tool.x / radius, tool.y / radius, 0.0, 0.0, 0.0, 0.0];
    let factor = Cholesky::new(&(jacobian * jacobian.transpose()))?;
    Some((radius, transpose_times(jacobian, &factor.solve(&twist))))
}
