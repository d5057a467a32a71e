//! The controllers, each one step function: measurements in, command inside every limit out. [`BaseController`] and
//! [`ArmController`] stand alone; [`WholeBodyController`] is made of the two.
//!
//! A controller is constant. Everything that changes from step to step is its state, which belongs to the caller; other
//! parameters are another controller for the same state ([`WholeBodyController::with_parameters`]).
//!
//! ```
//! use moca_wbc::robot::{MOCA_MOUNT, PANDA, PAPER_COVER};
//! use moca_wbc::{ControlInput, ControlLaw, Parameters, Payload, RobotState, WholeBodyController};
//!
//! let mut parameters = Parameters::PAPER;
//! let mut controller: WholeBodyController<7, 11> =
//!     WholeBodyController::new(&PANDA, &MOCA_MOUNT, &Payload::NONE, &PAPER_COVER, &parameters)?;
//! let robot = RobotState::at_rest(PANDA.home_rad);
//! let mut state = controller.enter(ControlLaw::FollowMe, &robot)?;
//! controller.step(ControlLaw::FollowMe, &mut state, &ControlInput::new(robot, [0.0; 11], 1e-3))?;
//! // changed while running: the state goes on, the gain arrives through a filter
//! parameters.gains.stiffness = [1600.0, 1600.0, 1600.0, 80.0, 80.0, 80.0];
//! controller = controller.with_parameters(&parameters)?;
//! controller.step(ControlLaw::FollowMe, &mut state, &ControlInput::new(robot, [0.0; 11], 1e-3))?;
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

mod arm;
mod arm_state;
mod base;
mod followed;
mod joint_pace;
mod law;
mod lead;
mod led;
mod tick;
mod whole_body;

pub use arm::{ArmController, ArmInput, ArmOutput};
pub use arm_state::ArmState;
pub use base::{BaseController, BaseInput, BaseOutput, BaseState};
pub use law::ControlLaw;
pub use lead::Target;
pub use whole_body::{ControlInput, ControlOutput, ControllerState, WholeBodyController};

use crate::reference::Pose;
use crate::rotation;
use crate::scalar::Scalar;
use moca_msgs::{ParameterError, Parameters};

/// Longest step that is integrated, s: after a longer gap old forces are not made up for.
pub const LONGEST_STEP_S: f64 = 0.01;
/// Time constant with which the torque carried over a change of law fades, s.
pub const CARRY_FADE_S: f64 = 0.2;
/// Least virtual mass, kg or kg·m², with [`moca_msgs::Corrections::null_space_damping`].
pub const LIGHTEST_DAMPED_BASE: f64 = 0.5;

/// Pose of the controlled frame E in W.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FlangePose<T = f64> {
    /// Position, m.
    pub position_world: [T; 3],
    /// Unit quaternion x, y, z, w.
    pub quaternion_world: [T; 4],
}

impl<T: Scalar> From<&Pose<T>> for FlangePose<T> {
    fn from(pose: &Pose<T>) -> Self {
        Self {
            position_world: pose.position.into(),
            quaternion_world: rotation::to_quaternion(&pose.rotation),
        }
    }
}

/// The first parameter out of range.
fn check<const N: usize>(parameters: &Parameters<N>) -> Result<(), ParameterError> {
    let mut first = Ok(());
    parameters.check(|error| {
        if first.is_ok() {
            first = Err(error);
        }
    });
    first
}
