//! Expanded impedance: a hand leans on the left side, the base gives way, the flange keeps its place.
//!
//! The plant is the smallest that closes the loop: a base that does what it is told, an arm integrated with the
//! crate's own mass matrix.
#![allow(clippy::print_stdout, reason = "an example shows its result")]

use moca_wbc::linalg::{Cholesky, times};
use moca_wbc::robot::{MOCA_MOUNT, PANDA, PAPER_COVER};
use moca_wbc::{
    ControlInput, ControlLaw, Corrections, Parameters, Payload, RobotCommand, RobotState, WholeBodyController,
};

const DT_S: f64 = 1e-3;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let corrections = Corrections { null_space_damping: true, base_coupling: true, ..Corrections::LITERAL };
    let parameters = Parameters { corrections, ..Parameters::PAPER };
    let controller: WholeBodyController<7, 11> =
        WholeBodyController::new(&PANDA, &MOCA_MOUNT, &Payload::NONE, &PAPER_COVER, &parameters)?;
    let mut robot = RobotState { flange_wrench_world: Some([0.0; 6]), ..RobotState::at_rest(PANDA.home_rad) };
    let mut state = controller.enter(ControlLaw::Impedance, &robot)?;
    println!(
        "{:>5} {:>28} {:>22} {:>12}",
        "t [s]", "base x, y [m], yaw [rad]", "flange error [mm]", "on T2 [N]"
    );
    for tick in 0..3000_u32 {
        let t = f64::from(tick) * DT_S;
        let mut taxel_force_n = [0.0; 11];
        taxel_force_n[1] = 15.0 * (t / 0.3).min((3.0 - t) / 0.3).min(1.0);
        let input = ControlInput::new(robot, taxel_force_n, DT_S);
        let output = controller.step(ControlLaw::Impedance, &mut state, &input)?;
        if tick % 300 == 0 {
            let [x, y, yaw] = robot.base_pose_world;
            let (actual, desired) = (output.flange.position_world, output.flange_desired.position_world);
            let error = (0..3).map(|i| (actual[i] - desired[i]).powi(2)).sum::<f64>().sqrt() * 1e3;
            println!("{t:5.1} {x:9.4} {y:9.4} {yaw:8.4} {error:22.2} {:12.1}", taxel_force_n[1]);
        }
        move_plant(&controller, &mut robot, &output.command)?;
    }
    Ok(())
}

/// Base follows its command at once; M q̈_A + M_AB q̈_B + C q̇ + g = τ.
fn move_plant(
    controller: &WholeBodyController<7, 11>,
    robot: &mut RobotState<7>,
    command: &RobotCommand<7>,
) -> Result<(), &'static str> {
    let (s, c) = robot.base_pose_world[2].sin_cos();
    let [vx, vy, wz] = command.base_velocity_body;
    let velocity = [c * vx - s * vy, s * vx + c * vy, wz];
    let acceleration: [f64; 3] = std::array::from_fn(|i| (velocity[i] - robot.base_velocity_world[i]) / DT_S);
    let dynamics = controller.model().dynamics(robot.base_pose_world[2], &robot.q_rad, &robot.dq_rad_s);
    let coupled = times(&dynamics.base_coupling, &acceleration);
    let torque = std::array::from_fn(|i| command.arm_torque_nm[i] - dynamics.bias[i] - coupled[i]);
    let ddq = Cholesky::new(&dynamics.mass).ok_or("mass matrix")?.solve(&torque);
    for (i, ddq) in ddq.into_iter().enumerate() {
        robot.dq_rad_s[i] += DT_S * ddq;
        robot.q_rad[i] += DT_S * robot.dq_rad_s[i];
    }
    robot.base_velocity_world = velocity;
    for (pose, velocity) in robot.base_pose_world.iter_mut().zip(velocity) {
        *pose += DT_S * velocity;
    }
    robot.torque_measured_nm = command.arm_torque_nm;
    Ok(())
}
