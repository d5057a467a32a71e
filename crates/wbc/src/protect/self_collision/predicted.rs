//! Posture in which an arm reaches a pose.

use super::SelfCollision;
use crate::linalg::{Cholesky, times, transpose_times};
use crate::model::ArmModel;
use crate::rotation;
use crate::scalar::{Scalar, between, of};
use nalgebra::{Matrix3, SMatrix, Vector3};

/// Most steps to a pose.
const STEPS: usize = 80;
/// Largest part of an error that one step makes up for, m or rad.
const ERROR_MAX: f64 = 0.2;
/// Damping of the steps: (m/rad)².
const DAMPING: f64 = 1e-4;
/// Largest change of a joint in one step, rad.
const STEP_MAX_RAD: f64 = 0.2;
/// Share of the way to the null space's posture in one step.
const POSTURE_SHARE: f64 = 0.05;
/// Change of a joint in one step for each metre by which a distance is too small, rad/m, along its gradient.
const AWAY_PER_M: f64 = 4.0;
/// Errors with which a pose counts as reached, m or rad.
const REACHED: f64 = 2e-3;
/// Change of every joint in a step after which no more is made, rad.
const SETTLED_RAD: f64 = 1e-3;

impl<const N: usize, T: Scalar> SelfCollision<N, T> {
    /// Posture in which an arm that stands in `from` reaches a pose of its tool, relative to A in world axes; the null space goes
    /// to `posture` and away from what is near. `None` if it does not get there.
    ///
    /// Damped least squares in at most 80 steps: the way of a law's differential kinematics, without its dynamics.
    pub fn predicted(
        &self,
        model: &ArmModel<N, T>,
        yaw: T,
        (from, posture): (&[T; N], &[T; N]),
        (position, axes): (&Vector3<T>, &Matrix3<T>),
    ) -> Option<[T; N]> {
        let mut q = *from;
        let mut reached = false;
        for _ in 0..STEPS {
            let kinematics = model.kinematics(yaw, &q);
            let along = position - kinematics.tool_position;
            let about = rotation::error(&kinematics.tool_rotation, axes);
            reached = along.norm() < of(REACHED) && about.norm() < of(REACHED);
            let limited = |v: Vector3<T>| v * (of::<T>(ERROR_MAX) / v.norm().max(of(ERROR_MAX)));
            let (along, about) = (limited(along), limited(about));
            let mut away: [T; N] = core::array::from_fn(|i| (posture[i] - q[i]) * of(POSTURE_SHARE));
            if let Some(nearest) = self.nearest(&kinematics) {
                let push = (self.least() + self.least() - nearest.distance).max(T::zero()) * of(AWAY_PER_M);
                for (away, gradient) in away.iter_mut().zip(&nearest.gradient) {
                    *away += *gradient * push;
                }
            }
            let jacobian = kinematics.arm_jacobian();
            let moved = times(jacobian, &away);
            let wanted = [along.x, along.y, along.z, about.x, about.y, about.z];
            let mut square: SMatrix<T, 6, 6> = jacobian * jacobian.transpose();
            for i in 0..6 {
                square[(i, i)] += of(DAMPING);
            }
            let factor = Cholesky::new(&square)?;
            let step =
                transpose_times(jacobian, &factor.solve(&core::array::from_fn(|i| wanted[i] - moved[i])));
            let mut largest = T::zero();
            for i in 0..N {
                let change = between(away[i] + step[i], -of::<T>(STEP_MAX_RAD), of(STEP_MAX_RAD));
                let next = between(q[i] + change, self.q_min[i], self.q_max[i]);
                largest = largest.max((next - q[i]).abs());
                q[i] = next;
            }
            if reached && largest < of(SETTLED_RAD) {
                break;
            }
        }
        reached.then_some(q)
    }
}
