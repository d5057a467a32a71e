//! Expanded follow-me: one hand on the cover, one at the flange of a UR10e; the base follows their sum.
//!
//! Another arm is another table: nothing else changes. The plant is a base that does what it is told under an arm that
//! stands still, which is what follow-me's base sees of it.
#![allow(clippy::print_stdout, reason = "an example shows its result")]

use moca_wbc::robot::{MOCA_MOUNT, PAPER_COVER, UR10E};
use moca_wbc::{ControlInput, ControlLaw, Parameters, Payload, RobotState, WholeBodyController};

const DT_S: f64 = 1e-3;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let parameters = Parameters::for_arm(&UR10E);
    let controller: WholeBodyController<6, 11> =
        WholeBodyController::new(&UR10E, &MOCA_MOUNT, &Payload::NONE, &PAPER_COVER, &parameters)?;
    let mut robot = RobotState::at_rest(UR10E.home_rad);
    let mut state = controller.enter(ControlLaw::FollowMe, &robot)?;
    println!("{:>5} {:>26} {:>34}", "t [s]", "cover, flange x [N]", "base x, y [m], yaw [rad]");
    for tick in 0..4000_u32 {
        let t = f64::from(tick) * DT_S;
        let mut taxel_force_n = [0.0; 11];
        // the front taxel first, then the flange against it
        taxel_force_n[5] = if t < 3.0 { 10.0 } else { 0.0 };
        let pull = if t > 1.0 { 10.0 } else { 0.0 };
        let input = ControlInput {
            flange_wrench_world: Some([pull, 0.0, 0.0, 0.0, 0.0, 0.0]),
            ..ControlInput::new(robot, taxel_force_n, DT_S)
        };
        let output = controller.step(ControlLaw::FollowMe, &mut state, &input)?;
        if tick % 500 == 0 {
            let [x, y, yaw] = robot.base_pose_world;
            println!("{t:5.1} {:13.1} {pull:12.1} {x:16.4} {y:8.4} {yaw:8.4}", output.cover_wrench_base[0]);
        }
        let (s, c) = robot.base_pose_world[2].sin_cos();
        let [vx, vy, wz] = output.command.base_velocity_body;
        robot.base_velocity_world = [c * vx - s * vy, s * vx + c * vy, wz];
        for (pose, velocity) in robot.base_pose_world.iter_mut().zip(robot.base_velocity_world) {
            *pose += DT_S * velocity;
        }
    }
    Ok(())
}
