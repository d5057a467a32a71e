//! Reach: how far the base may leave its tool behind, which the arm holds in its place.
//!
//! ```
//! use moca_wbc::reach::ArmReach;
//! use moca_wbc::robot::{MOCA_MOUNT, PANDA};
//! use moca_wbc::{ArmModel, Payload};
//!
//! let model = ArmModel::new(&PANDA, &MOCA_MOUNT, &Payload::NONE)?;
//! let reach = ArmReach::new(&PANDA, &model, &PANDA.home_rad, 0.3);
//! let [from_m, to_m] = reach.stretch_m;
//! assert!(from_m > 0.2 && to_m < 0.35, "at home the flange is 0.40 m from where the elbow is straight");
//! // from its place half a metre ahead of the middle of the base the tool may stay behind by 0.2 m, but not by 0.4 m
//! assert_eq!([0.7, 0.9].map(|x_m| reach.used(&[x_m, 0.0]).0), [0.0, 1.0]);
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

/// From the tool's place over the base to the tool, seen from above: where the elbow gets straight it has to go fast for little
/// way.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ArmReach {
    /// Home place of the tool: with the arm in its posture, axes of B, m.
    pub place_base_m: [f64; 2],
    /// Distances from there at which the reach begins to end, and has ended, m: 0 where it has from the start.
    pub stretch_m: [f64; 2],
}

impl ArmReach {
    /// Computes the reach of `arm` whose shoulder goes straight away from the tool at `speed_m_s`, from `posture_rad` on. The tool
    /// keeps its height and its axes. Computed once, posture by posture.
    pub fn new<const N: usize>(
        arm: &ArmTable<N>,
        model: &ArmModel<N, f64>,
        posture_rad: &[f64; N],
        speed_m_s: f64,
    ) -> Self {
        let speeds = JointSpeeds::new(arm);
        let within = |q: &[f64; N]| (0..N).all(|i| (arm.q_min_rad[i]..=arm.q_max_rad[i]).contains(&q[i]));
        let place = model.kinematics(0.0, posture_rad).tool_from_base();
        let (mut stretch_m, mut gone_m) = ([0.0; 2], 0.0);
        let mut q = *posture_rad;
        for _ in 0..STEPS {
            let Some(rates) = outwards(model, &q).filter(|_| within(&q)) else { break };
            let pace = speeds.share(&q, &rates.map(|rate| rate * speed_m_s));
            for (stretch_m, most) in stretch_m.iter_mut().zip(PACE) {
                *stretch_m = if pace <= most { gone_m } else { *stretch_m };
            }
            // by the rates in the middle of the step, whose error is of third order
            let middle = core::array::from_fn(|i| q[i] + 0.5 * STEP_M * rates[i]);
            let Some(rates) = outwards(model, &middle).filter(|_| pace <= 1.0) else { break };
            q = core::array::from_fn(|i| q[i] + STEP_M * rates[i]);
            gone_m += STEP_M;
        }
        Self { place_base_m: [place.x, place.y], stretch_m }
    }

    /// Returns the share of the last part of the reach that a tool at `tool_base_m` (axes of B, m) uses, 0 to 1, and the direction
    /// to it from its place.
    pub fn used<T: Scalar>(&self, tool_base_m: &[T; 2]) -> (T, [T; 2]) {
        let [x, y]: [T; 2] = core::array::from_fn(|i| tool_base_m[i] - of(self.place_base_m[i]));
        let stretch = (x * x + y * y).sqrt().max(T::default_epsilon());
        let [from, to] = self.stretch_m.map(of::<T>);
        let share = (stretch - from) / (to - from).max(T::default_epsilon());
        (share.clamp(T::zero(), T::one()), [x / stretch, y / stretch])
    }
}

/// Joint rates that take the tool straight away from the shoulder, rad/m. `None` where none do.
fn outwards<const N: usize>(model: &ArmModel<N, f64>, q: &[f64; N]) -> Option<[f64; N]> {
    let kinematics = model.kinematics(0.0, q);
    let (jacobian, tool) = (kinematics.arm_jacobian(), kinematics.tool_position);
    let radius = tool.xy().norm().max(f64::MIN_POSITIVE);
    let twist = [tool.x / radius, tool.y / radius, 0.0, 0.0, 0.0, 0.0];
    let factor = Cholesky::new(&(jacobian * jacobian.transpose()))?;
    Some(transpose_times(jacobian, &factor.solve(&twist)))
}
