//! A plant to close the loop with: the crate's own coupled dynamics, a base that follows its velocity command as a
//! first-order servo with limited acceleration, taxels that are read every 10 ms.
#![allow(
    clippy::unwrap_used,
    unreachable_pub,
    dead_code,
    clippy::needless_range_loop,
    reason = "shared by several tests"
)]

use moca_wbc::coupled::CoupledDynamics;
use moca_wbc::linalg::{Cholesky, times, transpose_times};
use moca_wbc::model::ArmModel;
use moca_wbc::robot::{MOCA_MOUNT, PANDA, PAPER_COVER, SUMMIT_XL};
use moca_wbc::{BaseGuard, ControlInput, ControlLaw, ControlOutput, ControllerState, WholeBodyController};
use moca_wbc::{Parameters, Payload, RobotState};

pub const DT_S: f64 = 1e-3;
const SENSOR_PERIOD_S: f64 = 0.01;
const SUBSTEPS: u32 = 2;

pub fn controller(parameters: &Parameters<7>) -> WholeBodyController<7, 11> {
    WholeBodyController::new(&PANDA, &MOCA_MOUNT, &Payload::NONE, &PAPER_COVER, parameters).unwrap()
}

pub fn at_home() -> RobotState<7> {
    RobotState { flange_wrench_world: Some([0.0; 6]), ..RobotState::at_rest(PANDA.home_rad) }
}

/// Joint angles within 1e-10 rad of `q_rad`, others for each `start`; the first are `q_rad`.
pub fn near(q_rad: [f64; 7], start: u32) -> [f64; 7] {
    let shares = [1.0, -0.7, 0.3, 0.9, -0.2, 0.5, 0.8];
    std::array::from_fn(|i| q_rad[i] + 1e-12 * shares[i] * f64::from(start))
}

/// Forces on the robot at one instant.
#[derive(Clone, Copy, Debug, Default)]
pub struct Push {
    pub taxel_n: [f64; 11],
    pub flange_n: [f64; 3],
}

impl Push {
    pub fn taxels(taxels: &[usize], newton: f64) -> Self {
        let mut push = Self::default();
        taxels.iter().for_each(|t| push.taxel_n[t - 1] = newton);
        push
    }

    pub fn scaled(&self, s: f64) -> Self {
        Self { taxel_n: self.taxel_n.map(|f| f * s), flange_n: self.flange_n.map(|f| f * s) }
    }
}

pub struct Loop {
    pub controller: WholeBodyController<7, 11>,
    pub state: ControllerState<7>,
    pub robot: RobotState<7>,
    pub law: ControlLaw,
    pub time_s: f64,
    pub dt_s: f64,
    pub guard: BaseGuard<11>,
    /// True if the robot estimates the wrench at its flange by itself.
    pub estimates: bool,
    /// True if a command acts one step after the measurement that it answers.
    pub late: bool,
    last: Option<ControlOutput<7>>,
    model: ArmModel<7, f64>,
    held: [f64; 11],
    sum: [f64; 11],
    summed: f64,
}

impl Loop {
    pub fn new(law: ControlLaw, parameters: &Parameters<7>) -> Self {
        Self::starting(law, parameters, at_home(), DT_S)
    }

    pub fn starting(law: ControlLaw, parameters: &Parameters<7>, robot: RobotState<7>, dt_s: f64) -> Self {
        let controller = controller(parameters);
        Self {
            dt_s,
            guard: BaseGuard::NONE,
            estimates: true,
            late: false,
            last: None,
            state: controller.enter(law, &robot).unwrap(),
            controller,
            robot,
            law,
            time_s: 0.0,
            model: ArmModel::new(&PANDA, &MOCA_MOUNT, &Payload::NONE).unwrap(),
            held: [0.0; 11],
            sum: [0.0; 11],
            summed: 0.0,
        }
    }

    pub fn step(&mut self, push: &Push) -> ControlOutput<7> {
        for (sum, force) in self.sum.iter_mut().zip(push.taxel_n) {
            *sum += force;
        }
        self.summed += 1.0;
        if self.summed * self.dt_s >= SENSOR_PERIOD_S - 1e-9 {
            self.held = self.sum.map(|sum| sum / self.summed);
            (self.sum, self.summed) = ([0.0; 11], 0.0);
        }
        let [fx, fy, fz] = push.flange_n;
        let robot = RobotState {
            flange_wrench_world: self.estimates.then_some([fx, fy, fz, 0.0, 0.0, 0.0]),
            ..self.robot
        };
        let input = ControlInput { guard: self.guard, ..ControlInput::new(robot, self.held, self.dt_s) };
        let output = self.controller.step(self.law, &mut self.state, &input).unwrap();
        if output.exceeded.is_some() {
            self.law = ControlLaw::Hold;
        }
        let before = self.last.replace(output).filter(|_| self.late);
        let acting = before.unwrap_or(output);
        for _ in 0..SUBSTEPS {
            self.integrate(&acting, push.flange_n, self.dt_s / f64::from(SUBSTEPS));
        }
        self.robot.torque_measured_nm = output.command.arm_torque_nm;
        self.time_s += self.dt_s;
        output
    }

    fn integrate(&mut self, output: &ControlOutput<7>, flange_n: [f64; 3], dt: f64) {
        let robot = &mut self.robot;
        let (s, c) = robot.base_pose_world[2].sin_cos();
        let [vx, vy, wz] = output.command.base_velocity_body;
        let command = [c * vx - s * vy, s * vx + c * vy, wz];
        let most = [
            SUMMIT_XL.acceleration_max_m_s2,
            SUMMIT_XL.acceleration_max_m_s2,
            SUMMIT_XL.yaw_acceleration_max_rad_s2,
        ];
        let base_acceleration: [f64; 3] = core::array::from_fn(|i| {
            let wanted = (command[i] - robot.base_velocity_world[i]) / SUMMIT_XL.servo_time_constant_s;
            wanted.clamp(-most[i], most[i])
        });
        let dynamics = CoupledDynamics::new(
            &self.model,
            &SUMMIT_XL,
            (robot.base_pose_world[2], &robot.q_rad),
            (&robot.base_velocity_world, &robot.dq_rad_s),
        );
        let [fx, fy, fz] = flange_n;
        let external = transpose_times(dynamics.arm.kinematics.arm_jacobian(), &[fx, fy, fz, 0.0, 0.0, 0.0]);
        let coupled = times(&dynamics.arm.base_coupling, &base_acceleration);
        let torque = core::array::from_fn(|i| {
            output.command.arm_torque_nm[i] + external[i] - dynamics.arm.bias[i] - coupled[i]
        });
        let ddq = Cholesky::new(&dynamics.arm.mass).unwrap().solve(&torque);
        for i in 0..3 {
            robot.base_velocity_world[i] += dt * base_acceleration[i];
            robot.base_pose_world[i] += dt * robot.base_velocity_world[i];
        }
        for i in 0..7 {
            robot.dq_rad_s[i] += dt * ddq[i];
            robot.q_rad[i] += dt * robot.dq_rad_s[i];
        }
    }

    /// A push of 3 s with ramps of 0.3 s: base displacement at its end and largest flange error, m.
    pub fn push(&mut self, push: &Push) -> ([f64; 3], f64) {
        let start = self.robot.base_pose_world;
        let mut worst = 0.0_f64;
        for tick in 0..3000 {
            let t = f64::from(tick) * DT_S;
            let output = self.step(&push.scaled((t / 0.3).min((3.0 - t) / 0.3).min(1.0)));
            worst = worst.max(flange_error(&output));
        }
        let end = self.robot.base_pose_world;
        (core::array::from_fn(|i| end[i] - start[i]), worst)
    }
}

pub fn flange_error(output: &ControlOutput<7>) -> f64 {
    let (a, b) = (output.flange.position_world, output.flange_desired.position_world);
    (0..3).map(|i| (a[i] - b[i]).powi(2)).sum::<f64>().sqrt()
}
