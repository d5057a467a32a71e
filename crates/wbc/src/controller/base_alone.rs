//! A base without an arm: the cover on anything that is driven by velocities.

use super::{Controller, LONGEST_STEP_S};
use crate::admittance::admitted;
use crate::error::{ControlError, finite};
use crate::rotation::Heading;
use crate::scalar::{Scalar, of};
use crate::state::{ControlInput, ControlLaw, ControlOutput, ControllerState, FlangePose};
use moca_msgs::RobotCommand;

impl<const N: usize, const K: usize, T: Scalar> Controller<N, K, T> {
    /// [`Controller::step`] for a base that carries no arm: eq. (2) on the cover's wrench, which is what both laws come
    /// to. The arm's model is not evaluated; torques and flange are those of no arm: zero, at the origin.
    ///
    /// # Errors
    /// As for [`Controller::step`].
    pub fn step_base(
        &self,
        law: ControlLaw,
        state: &mut ControllerState<N, T>,
        input: &ControlInput<N, K, T>,
    ) -> Result<ControlOutput<N, T>, ControlError> {
        let (cover_wrench_base, mut hit) = self.feel(input)?;
        let dt_s = input.dt_s.min(of(LONGEST_STEP_S));
        let mut gains = state.gains;
        gains.approach(&self.gains, dt_s);
        let heading = Heading::at(input.robot.base_pose_world[2]);
        let wanted_world = match law {
            ControlLaw::Hold => [T::zero(); 3],
            ControlLaw::Impedance | ControlLaw::FollowMe => {
                let force = heading.to_world(cover_wrench_base).map(|f| gains.reactivity * f);
                admitted(&gains, &heading.to_world(state.base_velocity_body), &force, dt_s)
            }
        };
        let base_velocity_body =
            self.guarded(law, &heading, wanted_world, &state.base_velocity_body, dt_s, &mut hit);
        finite("base velocity command", &base_velocity_body)?;
        (state.law, state.gains, state.base_velocity_body) = (law, gains, base_velocity_body);
        let nowhere =
            FlangePose { position_world: [T::zero(); 3], quaternion_world: [0.0, 0.0, 0.0, 1.0].map(of) };
        Ok(ControlOutput {
            command: RobotCommand { base_velocity_body, arm_torque_nm: [T::zero(); N] },
            cover_wrench_base,
            flange_wrench_world: [T::zero(); 6],
            flange: nowhere,
            flange_desired: nowhere,
            limits: hit,
        })
    }
}
