//! A control step on a machine with nothing: no std, no allocator, no panic runtime. It links, or it does not.
#![no_std]

use moca_wbc::robot::{MOCA_MOUNT, PANDA, PAPER_COVER};
use moca_wbc::{ControlInput, ControlLaw, Parameters, Payload, RobotState, Scalar, WholeBodyController};

#[panic_handler]
fn panic(_: &core::panic::PanicInfo<'_>) -> ! {
    loop {}
}

fn first_torque<T: Scalar>(state: RobotState<7, T>, force_n: [T; 11], dt_s: T) -> Option<T> {
    let controller = WholeBodyController::<7, 11, T>::new(
        &PANDA,
        &MOCA_MOUNT,
        &Payload::NONE,
        &PAPER_COVER,
        &Parameters::PAPER,
    )
    .ok()?;
    let mut memory = controller.enter(ControlLaw::Impedance, &state).ok()?;
    let input = ControlInput::new(state, force_n, dt_s);
    let output = controller.step(ControlLaw::FollowMe, &mut memory, &input).ok()?;
    Some(output.command.arm_torque_nm[0])
}

/// One step in f64, from a state that the optimiser cannot know.
///
/// # Safety
/// `state` and `force_n` must be valid for reads.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn step_f64(
    state: *const RobotState<7, f64>,
    force_n: *const [f64; 11],
    dt_s: f64,
) -> f64 {
    // SAFETY: the caller's promise
    let (state, force_n) = unsafe { (*state, *force_n) };
    first_torque(state, force_n, dt_s).unwrap_or(0.0)
}

/// One step in f32.
///
/// # Safety
/// `state` and `force_n` must be valid for reads.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn step_f32(
    state: *const RobotState<7, f32>,
    force_n: *const [f32; 11],
    dt_s: f32,
) -> f32 {
    // SAFETY: the caller's promise
    let (state, force_n) = unsafe { (*state, *force_n) };
    first_torque(state, force_n, dt_s).unwrap_or(0.0)
}
