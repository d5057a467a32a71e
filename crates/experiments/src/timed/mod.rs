//! Steps and ticks that others time (feature `timed`).
//!
//! They are compiled here and generic no more. This crate is one codegen unit, as those of the loop are. A program of several
//! units would time calls within a step that the loop does not make.

pub mod ticks;

use crate::{JOINTS, TAXELS};
use moca_lockstep::touch_board::ByteCover;
use moca_lockstep::{LockStep, MemoryBoards};
use moca_wbc::testing::steps::Steps;
use moca_wbc::{
    ArmController, ArmInput, ArmOutput, ArmState, BaseController, BaseInput, BaseOutput, BaseState,
    ControlError, ControlInput, ControlLaw, ControlOutput, ControllerState, Scalar, WholeBodyController,
};

/// Controller of the paper's robot.
pub type Controller<T = f64> = WholeBodyController<JOINTS, TAXELS, T>;

/// Scalar of a controller whose steps are timed.
pub trait Timed: Scalar {
    /// Makes one step under [`ControlLaw::Impedance`].
    ///
    /// # Errors
    /// As [`WholeBodyController::step`].
    fn step(
        controller: &Controller<Self>,
        state: &mut ControllerState<JOINTS, Self>,
        input: &ControlInput<JOINTS, TAXELS, Self>,
    ) -> Result<ControlOutput<JOINTS, Self>, ControlError>;
}

impl Timed for f64 {
    fn step(
        controller: &Controller,
        state: &mut ControllerState<JOINTS>,
        input: &ControlInput<JOINTS, TAXELS>,
    ) -> Result<ControlOutput<JOINTS>, ControlError> {
        controller.step(ControlLaw::Impedance, state, input)
    }
}

impl Timed for f32 {
    fn step(
        controller: &Controller<Self>,
        state: &mut ControllerState<JOINTS, Self>,
        input: &ControlInput<JOINTS, TAXELS, Self>,
    ) -> Result<ControlOutput<JOINTS, Self>, ControlError> {
        controller.step(ControlLaw::Impedance, state, input)
    }
}

/// Makes one step of a base without an arm.
///
/// # Errors
/// As [`BaseController::step`].
pub fn base_step(
    controller: &BaseController<TAXELS>,
    state: &mut BaseState,
    input: &BaseInput<TAXELS>,
) -> Result<BaseOutput, ControlError> {
    controller.step(state, input)
}

/// Makes one step of an arm without a base.
///
/// # Errors
/// As [`ArmController::step`].
pub fn arm_step(
    controller: &ArmController<JOINTS>,
    state: &mut ArmState<JOINTS>,
    input: &ArmInput<JOINTS>,
) -> Result<ArmOutput<JOINTS>, ControlError> {
    controller.step(state, input)
}

/// Makes one step of one of the robots.
///
/// # Errors
/// As [`Steps::step`].
pub fn robot_step(steps: &mut Steps, robot: usize) -> Result<ControlOutput<JOINTS>, ControlError> {
    steps.step(robot)
}

/// Makes one tick of the whole loop on a board in memory.
pub fn loop_tick(world: &mut LockStep<ByteCover, MemoryBoards>) {
    world.tick(None);
}
