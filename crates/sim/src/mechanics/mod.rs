//! Bodies that move in a scene, as generalised coordinates: x, y, yaw of the base, joint angles of the arm, then x, y of every
//! movable person; only what the scene holds. Forces of servos, hands, people and foam come from outside.

mod analytic;
mod joint_limits;
mod mujoco;

use crate::gripper::FlangePose;
use crate::scene::{Engine, Scene};
use crate::{ModelSize, SimError};
use moca_msgs::robot::LinkInertial;

/// Errors of a state, in the order in which they are checked.
const BAD_POSITION: &str = "a position is not a number or too large";
const BAD_RATE: &str = "a velocity is not a number or too large";
const BAD_ACCELERATION: &str = "an acceleration is not a number or too large";
const SINGULAR: &str = "the inertia matrix is close to singular";

/// Bodies under forces, one physics step at a time.
pub(crate) trait Mechanics: std::fmt::Debug + Send {
    /// s since the start.
    fn time_s(&self) -> f64;

    /// m, rad.
    fn positions(&self) -> &[f64];

    /// m/s, rad/s.
    fn rates(&self) -> &[f64];

    /// Puts the coordinates from `first` on to these positions and rates; [`Mechanics::refresh`] follows.
    fn put(&mut self, first: usize, positions: &[f64], rates: &[f64]);

    /// Moves every coordinate by its rate times `dt_s`, s; neither rates nor time change.
    fn drift(&mut self, dt_s: f64);

    /// Length of the steps to come, s.
    fn set_step_s(&mut self, step_s: f64);

    /// Puts the clock to `time_s`, s.
    fn set_time_s(&mut self, time_s: f64);

    /// Brings mass matrix, bias and the flange's place up to the state.
    fn refresh(&mut self);

    /// Forces from outside on each coordinate, N, N·m.
    fn forces_mut(&mut self) -> &mut [f64];

    /// Damping of the arm's joints from coordinate `first` on, N·m·s/rad; it acts on the rates at the end of the step.
    fn set_damping(&mut self, first: usize, damping: &[f64]);

    /// Wrench on the flange about its origin, world axes \[N; N·m\].
    fn set_flange_wrench_world(&mut self, wrench: &[f64; 6]);

    /// One physics step.
    ///
    /// # Errors
    /// A state that is not to be trusted any more.
    fn step(&mut self) -> Result<(), SimError>;

    /// Coriolis, centrifugal and gravity forces as of the start of the last step, N, N·m.
    fn bias(&self) -> &[f64];

    /// Mass matrix as of the start of the last step, row-major.
    fn mass_matrix(&mut self) -> &[f64];

    /// Pose of the flange as of the start of the last step; `None` without an arm.
    fn flange_pose(&self) -> Option<FlangePose>;

    /// Hangs a cube on the flange of a scene with an object, in the flange's axes; the one before is gone.
    ///
    /// # Errors
    /// An inertia that the engine refuses.
    fn set_load(&mut self, load: &LinkInertial) -> Result<(), SimError>;

    /// Returns the readings of the touch sensors of a scene with geoms in the last step, N, T1 first.
    fn touched_n(&self) -> &[f64] {
        &[]
    }

    /// Number of contacts between geoms in the last step.
    fn contacts(&self) -> usize {
        0
    }

    /// Returns the size of its model.
    fn size(&self) -> ModelSize;
}

/// The mechanics that `scene` asks for.
pub(crate) fn of(scene: &Scene) -> Result<Box<dyn Mechanics>, SimError> {
    match scene.engine {
        Engine::MuJoCo => Ok(Box::new(mujoco::MuJoCo::new(scene)?)),
        Engine::Analytic => analytic::of(scene),
    }
}
