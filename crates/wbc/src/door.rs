//! The doors of the controllers: what is not a finite number goes no further.

use crate::error::{ControlError, finite};
use crate::scalar::Scalar;
use crate::state::ControlInput;
use moca_msgs::RobotState;

/// Errs on the first number of a state that is not finite.
pub(crate) fn check_robot<const N: usize, T: Scalar>(robot: &RobotState<N, T>) -> Result<(), ControlError> {
    finite("base_pose_world", &robot.base_pose_world)?;
    finite("base_velocity_world", &robot.base_velocity_world)?;
    finite("q_rad", &robot.q_rad)?;
    finite("dq_rad_s", &robot.dq_rad_s)?;
    finite("torque_measured_nm", &robot.torque_measured_nm)?;
    finite("robot.flange_wrench_world", robot.flange_wrench_world.as_ref().map_or(&[], |w| &w[..]))
}

/// Errs on the first number of an input that is not finite, and on a step that is not positive.
pub(crate) fn check_input<const N: usize, const K: usize, T: Scalar>(
    input: &ControlInput<N, K, T>,
) -> Result<(), ControlError> {
    check_step(input.dt_s)?;
    check_robot(&input.robot)?;
    finite("taxel_force_n", &input.taxel_force_n)?;
    finite("flange_wrench_world", input.flange_wrench_world.as_ref().map_or(&[], |w| &w[..]))
}

fn check_step<T: Scalar>(dt_s: T) -> Result<(), ControlError> {
    finite("dt_s", &[dt_s])?;
    if dt_s > T::zero() {
        Ok(())
    } else {
        Err(ControlError::Step { dt_s: nalgebra::try_convert(dt_s).unwrap_or(f64::NAN) })
    }
}
