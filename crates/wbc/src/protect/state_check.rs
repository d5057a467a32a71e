//! Checks before a controller computes: a value that is not finite goes no further.

use crate::error::{ControlError, finite};
use crate::scalar::Scalar;
use moca_msgs::RobotState;

/// Errs on the first number of a state that is not finite.
pub(crate) fn check_robot<const N: usize, T: Scalar>(robot: &RobotState<N, T>) -> Result<(), ControlError> {
    finite("base_pose_world", &robot.base_pose_world)?;
    finite("base_velocity_world", &robot.base_velocity_world)?;
    finite("q_rad", &robot.q_rad)?;
    finite("dq_rad_s", &robot.dq_rad_s)?;
    finite("torque_measured_nm", &robot.torque_measured_nm)?;
    check_wrench("robot.flange_wrench_world", robot.flange_wrench_world.as_ref())
}

/// Errs on the first number of a wrench that is not finite.
pub(crate) fn check_wrench<T: Scalar>(
    what: &'static str,
    wrench: Option<&[T; 6]>,
) -> Result<(), ControlError> {
    finite(what, wrench.map_or(&[], |w| &w[..]))
}

/// Errs on a step that is not a positive number.
pub(crate) fn check_step<T: Scalar>(dt_s: T) -> Result<(), ControlError> {
    finite("dt_s", &[dt_s])?;
    if dt_s > T::zero() {
        Ok(())
    } else {
        Err(ControlError::Step { dt_s: nalgebra::try_convert(dt_s).unwrap_or(f64::NAN) })
    }
}
