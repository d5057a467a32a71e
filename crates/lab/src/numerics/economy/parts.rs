//! Cost of a control step: whole robot, base without an arm, arm without a base.

use anyhow::{Context, Result};
use moca_control::config::Config;
use moca_experiments::cpu_time;
use moca_experiments::timed::{Timed as _, arm_step, base_step};
use moca_wbc::robot::{MOCA_MOUNT, PANDA, PAPER_COVER};
use moca_wbc::{
    ArmController, ArmInput, BaseController, BaseGuard, BaseInput, ControlInput, ControlLaw, Payload,
    RobotState, WholeBodyController,
};
use serde::Serialize;
use std::hint::black_box;

/// CPU time of one control step, µs.
#[derive(Clone, Copy, Debug, Serialize)]
pub(super) struct ControlCost {
    whole_body_us: f64,
    base_alone_us: f64,
    arm_alone_us: f64,
}

impl std::fmt::Display for ControlCost {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(
            f,
            "control: whole-body impedance {:.2} us; base-only needs the admittance, {:.2} us; arm-only the arm's \
             impedance, {:.2} us",
            self.whole_body_us, self.base_alone_us, self.arm_alone_us
        )
    }
}

/// The robot in its home posture, a hand on T6.
pub(super) fn measure(config: &Config) -> Result<ControlCost> {
    let (parameters, guard, dt_s) = (config.parameters().resized(), BaseGuard::NONE, 1e-3);
    let mut taxel_force_n = [0.0; PAPER_COVER.len()];
    taxel_force_n[5] = 10.0;
    let yaw_world_rad = 0.3;
    let robot =
        RobotState { base_pose_world: [0.0, 0.0, yaw_world_rad], ..RobotState::at_rest(PANDA.home_rad) };

    let whole = WholeBodyController::new(&PANDA, &MOCA_MOUNT, &Payload::NONE, &PAPER_COVER, &parameters)?;
    let base = BaseController::new(&PAPER_COVER, &parameters)?;
    let arm = ArmController::new(&PANDA, &MOCA_MOUNT, &Payload::NONE, &parameters)?;
    let mut whole_state = whole.enter(ControlLaw::Impedance, &robot)?;
    let (mut base_state, mut arm_state) = (base.enter(), arm.enter(&robot)?);
    let whole_input = ControlInput::new(robot, taxel_force_n, dt_s);
    let base_input = BaseInput { yaw_world_rad, taxel_force_n, guard, dt_s };
    let arm_input = ArmInput { robot, flange_wrench_world: None, dt_s };
    Ok(ControlCost {
        whole_body_us: fastest_us(|| {
            let output = f64::step(&whole, &mut whole_state, black_box(&whole_input));
            black_box(output.context("whole body")?);
            Ok(())
        })?,
        base_alone_us: fastest_us(|| {
            black_box(base_step(&base, &mut base_state, black_box(&base_input)).context("base alone")?);
            Ok(())
        })?,
        arm_alone_us: fastest_us(|| {
            black_box(arm_step(&arm, &mut arm_state, black_box(&arm_input)).context("arm alone")?);
            Ok(())
        })?,
    })
}

/// CPU time of one call, µs: the least over stretches of 100.
fn fastest_us(mut call: impl FnMut() -> Result<()>) -> Result<f64> {
    let mut best = f64::INFINITY;
    for _ in 0..200 {
        let (done, cpu_s) = cpu_time::timed(|| (0..100).try_for_each(|_| call()));
        done?;
        best = best.min(cpu_s / 100.0);
    }
    Ok(1e6 * best)
}
