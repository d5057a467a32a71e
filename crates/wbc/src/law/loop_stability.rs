//! Stability of a robot at rest: discrete-time stability of a law with its gains and its period, for a robot in a
//! posture.
//!
//! One period of controller and robot together is linearised at rest by central differences of the very code that runs.
//! Its state is base pose, base velocity, last base command, q, q̇ and last torque; it grows as ρᵗ, ρ the spectral radius.
//! The robot is the arm's rigid-body model on a base that follows its command with the servo's lag and whose
//! acceleration the arm feels. It is asked of two robots, and the worse one counts: one that moves on between the
//! control's instants, and one that is stepped as a simulation is (semi-implicit Euler).
//!
//! Hold is one of the laws: an arm stops and tares in it.
//!
//! [`ClosedLoop::compensated_growth_per_s`] asks the same of an arm that is not the one believed, on a base that stands, while
//! the slow part of the momentum observer's estimate is commanded against.
//!
//! Not in it: limits (they act on large motions), the wrench that a robot estimates at its flange, whoever touches the
//! cover ([`crate::contact_stability`]). Analysis, not control: f64 only, and every loop takes a fixed number of steps.
//!
//! ```
//! use moca_wbc::loop_stability::{Command, ClosedLoop};
//! use moca_wbc::robot::{MOCA_MOUNT, PANDA, SUMMIT_XL};
//! use moca_wbc::{Law, Parameters, Payload};
//!
//! let mut parameters = Parameters::PAPER;
//! let grows = |parameters: &Parameters<7>| {
//!     let servo_s = SUMMIT_XL.servo_time_constant_s;
//!     let closed = ClosedLoop::new(&PANDA, &MOCA_MOUNT, &Payload::NONE, servo_s, parameters)?;
//!     Ok::<_, Box<dyn std::error::Error>>(closed.growth_per_s(Law::Impedance, Command::OnePeriodLate, &PANDA.home_rad)?)
//! };
//! assert!(grows(&parameters)? < 0.1, "the paper's gains settle");
//! parameters.gains.stiffness = [1e5; 6];
//! assert!(grows(&parameters)? > 100.0, "1/s: the arm would shake itself apart");
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

use crate::controller::{ControlInput, ControlLaw, ControllerState, WholeBodyController};
use crate::error::ControlError;
use crate::linalg::{Cholesky, times};
use crate::model::ArmModel;
use crate::momentum_observer::OBSERVER_LAG_S;
use moca_msgs::robot::PAPER_COVER;
use moca_msgs::{ArmTable, MAX_JOINTS, Mount, ParameterError, Parameters, Payload, RobotState};
#[allow(unused_imports, reason = "where std is linked, f64 has these methods by itself")]
use nalgebra::ComplexField as _;
use nalgebra::SMatrix;

/// Growth that counts as none, 1/s: rounding in the differences, and motions that nothing holds back or drives.
pub const NO_GROWTH_PER_S: f64 = 0.1;

/// Step of the central differences: m, rad, m/s, rad/s, N·m. At rest every limit is far away from it.
const DIFFERENCE: f64 = 1e-6;
/// Squarings of the matrix: ρ is then exact to a few 1e-7.
const SQUARINGS: u32 = 24;
/// Base pose, base velocity, last command; q, q̇, last torque.
const STATES: usize = 9 + 3 * MAX_JOINTS;

/// When a command acts.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Command {
    /// At the instant of the measurement that it answers: in lock-step.
    AtOnce,
    /// At the next one: a robot at the end of a network. What is stable so has a period of delay to spare.
    OnePeriodLate,
}

/// Motion of the robot from one control instant to the next.
#[derive(Clone, Copy, Debug)]
enum Motion {
    Continuous,
    Stepped,
}

/// A controller and the robot that it moves.
#[derive(Clone, Copy, Debug)]
pub struct ClosedLoop<const N: usize> {
    controller: WholeBodyController<N, 1>,
    servo_s: f64,
    period_s: f64,
}

/// One instant of the loop.
#[derive(Clone, Copy)]
struct Instant<const N: usize> {
    robot: RobotState<N>,
    command_body: [f64; 3],
    torque_nm: [f64; N],
}

/// One instant of an arm whose unknown load is compensated.
#[derive(Clone, Copy)]
struct Compensated<const N: usize> {
    robot: RobotState<N>,
    /// Integral of the momentum observer, N·m·s.
    observed: [f64; N],
    /// Load that is commanded against, N·m.
    load_nm: [f64; N],
}

impl<const N: usize> Compensated<N> {
    /// One of the 4N numbers of the state.
    fn element(&mut self, number: usize) -> &mut f64 {
        let joint = number % N;
        match number / N {
            0 => &mut self.robot.q_rad[joint],
            1 => &mut self.robot.dq_rad_s[joint],
            2 => &mut self.observed[joint],
            _ => &mut self.load_nm[joint],
        }
    }
}

impl<const N: usize> ClosedLoop<N> {
    /// An arm on a base with a velocity servo of time constant `servo_s`, under the gains, corrections and period of
    /// `parameters`.
    ///
    /// # Errors
    /// The first number that is not finite or out of range.
    pub fn new(
        arm: &ArmTable<N>,
        mount: &Mount,
        payload: &Payload,
        servo_s: f64,
        parameters: &Parameters<N>,
    ) -> Result<Self, ParameterError> {
        const { assert!(N <= MAX_JOINTS) };
        if !(1e-6..=10.0).contains(&servo_s) {
            return Err(ParameterError { name: "servo", value: servo_s, unit: "s", min: 1e-6, max: 10.0 });
        }
        let mut wide = *parameters;
        wide.limits.torque_nm = [1e3; N];
        wide.limits.torque_rate_nm_s = 1e5;
        wide.limits.base_velocity = [3.0; 3];
        wide.limits.base_acceleration = [50.0; 3];
        let [taxel, ..] = PAPER_COVER;
        let controller = WholeBodyController::new(arm, mount, payload, &[taxel], &wide)?;
        Ok(Self { controller, servo_s, period_s: parameters.limits.period_s })
    }

    /// Returns the growth rate of the fastest growing small motion about rest at `q_rad` under `law`, 1/s. Below
    /// [`NO_GROWTH_PER_S`] the loop is stable.
    ///
    /// # Errors
    /// A posture that is not finite.
    pub fn growth_per_s(
        &self,
        law: impl Into<ControlLaw>,
        command: Command,
        q_rad: &[f64; N],
    ) -> Result<f64, ControlError> {
        let law = law.into();
        let mut worst = f64::NEG_INFINITY;
        for motion in [Motion::Continuous, Motion::Stepped] {
            let period = self.linearised(law, command, motion, q_rad)?;
            worst = worst.max(log_spectral_radius(period) / self.period_s);
        }
        Ok(worst)
    }

    /// Returns the growth rate of the fastest growing small motion of `plant` about rest at `q_rad` under `law`, on a standing base,
    /// 1/s. The law believes in the arm of this loop. A first-order filter with time constant `time_s`, s, of the momentum
    /// observer's estimate is taken from its torques.
    ///
    /// # Errors
    /// A posture that is not finite.
    pub fn compensated_growth_per_s(
        &self,
        law: impl Into<ControlLaw>,
        plant: &ArmModel<N, f64>,
        time_s: f64,
        q_rad: &[f64; N],
    ) -> Result<f64, ControlError> {
        let law = law.into();
        let robot = RobotState { flange_wrench_world: Some([0.0; 6]), ..RobotState::at_rest(*q_rad) };
        let mut entered = self.controller.enter(law, &robot)?;
        self.controller.step(law, &mut entered, &ControlInput::new(robot, [0.0], self.period_s))?;
        let believed = self.controller.model().dynamics(0.0, q_rad, &[0.0; N]).bias;
        let gravity = plant.dynamics(0.0, q_rad, &[0.0; N]).bias;
        let load_nm = core::array::from_fn(|i| believed[i] - gravity[i]);
        let observed = load_nm.map(|load| -OBSERVER_LAG_S * load);
        let rest = Compensated { robot, observed, load_nm };
        let mut period = SMatrix::<f64, STATES, STATES>::zeros();
        for column in 0..4 * N {
            let moved = |by: f64| {
                let mut instant = rest;
                *instant.element(column) += by;
                self.compensated(law, &entered, plant, time_s, &instant)
            };
            let (mut up, mut down) = (moved(DIFFERENCE)?, moved(-DIFFERENCE)?);
            for row in 0..4 * N {
                period[(row, column)] = (*up.element(row) - *down.element(row)) / (2.0 * DIFFERENCE);
            }
        }
        Ok(log_spectral_radius(period) / self.period_s)
    }

    /// The compensated arm a period later, stepped as a simulation is.
    fn compensated(
        &self,
        law: ControlLaw,
        entered: &ControllerState<N>,
        plant: &ArmModel<N, f64>,
        time_s: f64,
        before: &Compensated<N>,
    ) -> Result<Compensated<N>, ControlError> {
        let (mut state, dt_s) = (*entered, self.period_s);
        let input = ControlInput::new(before.robot, [0.0], dt_s);
        let wanted = self.controller.step(law, &mut state, &input)?.command.arm_torque_nm;
        let torque: [f64; N] = core::array::from_fn(|i| wanted[i] - before.load_nm[i]);
        let mut next = *before;
        let (q, dq) = (&mut next.robot.q_rad, &mut next.robot.dq_rad_s);
        let dynamics = plant.dynamics(0.0, q, dq);
        let free = core::array::from_fn(|i| torque[i] - dynamics.bias[i]);
        let mass = Cholesky::new(&dynamics.mass).ok_or(ControlError::NotPositiveDefinite { what: "M_A" })?;
        for (i, acceleration) in mass.solve(&free).into_iter().enumerate() {
            dq[i] += dt_s * acceleration;
            q[i] += dt_s * dq[i];
        }
        // the observer's own step, with the model that the law believes in
        let model = self.controller.model();
        let believed = model.dynamics(0.0, q, dq);
        let (momentum, drift) = model.momentum(&believed.kinematics, &[0.0; 3], dq);
        let gravity = believed.gravity();
        let share = -(-dt_s / time_s).exp_m1();
        for i in 0..N {
            let predicted = before.observed[i] + dt_s * (torque[i] + drift[i] - gravity[i]);
            let residual = (momentum[i] - predicted) / (OBSERVER_LAG_S + dt_s);
            next.observed[i] = predicted + dt_s * residual;
            next.load_nm[i] += share * (residual - next.load_nm[i]);
        }
        Ok(next)
    }

    fn linearised(
        &self,
        law: ControlLaw,
        command: Command,
        motion: Motion,
        q_rad: &[f64; N],
    ) -> Result<SMatrix<f64, STATES, STATES>, ControlError> {
        let robot = RobotState { flange_wrench_world: Some([0.0; 6]), ..RobotState::at_rest(*q_rad) };
        let mut entered = self.controller.enter(law, &robot)?;
        // the first step of a law carries on the torque before it, whatever it would answer
        let first =
            self.controller.step(law, &mut entered, &ControlInput::new(robot, [0.0], self.period_s))?;
        let rest = Instant { robot, command_body: [0.0; 3], torque_nm: first.command.arm_torque_nm };
        let mut period = SMatrix::<f64, STATES, STATES>::zeros();
        for column in 0..9 + 3 * N {
            let moved = |by: f64| {
                let mut instant = rest;
                *instant.element(column) += by;
                self.after_a_period(law, &entered, command, motion, &instant)
            };
            let (mut up, mut down) = (moved(DIFFERENCE)?, moved(-DIFFERENCE)?);
            for row in 0..9 + 3 * N {
                period[(row, column)] = (*up.element(row) - *down.element(row)) / (2.0 * DIFFERENCE);
            }
        }
        Ok(period)
    }

    fn after_a_period(
        &self,
        law: ControlLaw,
        entered: &ControllerState<N>,
        command: Command,
        motion: Motion,
        before: &Instant<N>,
    ) -> Result<Instant<N>, ControlError> {
        let mut state = *entered;
        state.set_base_velocity_body(before.command_body);
        let input = ControlInput::new(before.robot, [0.0], self.period_s);
        let answer = self.controller.step(law, &mut state, &input)?.command;
        let (torque, base) = match command {
            Command::AtOnce => (&answer.arm_torque_nm, answer.base_velocity_body),
            Command::OnePeriodLate => (&before.torque_nm, before.command_body),
        };
        Ok(Instant {
            robot: self.moved(motion, &before.robot, torque, base)?,
            command_body: answer.base_velocity_body,
            torque_nm: answer.arm_torque_nm,
        })
    }

    /// The robot a period later.
    fn moved(
        &self,
        motion: Motion,
        robot: &RobotState<N>,
        torque_nm: &[f64; N],
        command_body: [f64; 3],
    ) -> Result<RobotState<N>, ControlError> {
        let dt_s = self.period_s;
        let model = self.controller.model();
        let dynamics = model.dynamics(robot.base_pose_world[2], &robot.q_rad, &robot.dq_rad_s);
        let command = dynamics.kinematics.heading.to_world(command_body);
        let share = -(-dt_s / self.servo_s).exp_m1();
        let mut next = *robot;
        let base: [f64; 3] =
            core::array::from_fn(|i| share / dt_s * (command[i] - robot.base_velocity_world[i]));
        let carried = times(&dynamics.base_coupling, &base);
        let free = core::array::from_fn(|i| torque_nm[i] - dynamics.bias[i] - carried[i]);
        let arm = Cholesky::new(&dynamics.mass).ok_or(ControlError::NotPositiveDefinite { what: "M_A" })?;
        let arm = arm.solve(&free);
        // half a period less of the change of speed is what continuous motion has gone
        let late_s = match motion {
            Motion::Continuous => 0.5 * dt_s,
            Motion::Stepped => 0.0,
        };
        for (i, acceleration) in base.into_iter().enumerate() {
            next.base_velocity_world[i] += dt_s * acceleration;
            next.base_pose_world[i] += dt_s * (next.base_velocity_world[i] - late_s * acceleration);
        }
        for (i, acceleration) in arm.into_iter().enumerate() {
            next.dq_rad_s[i] += dt_s * acceleration;
            next.q_rad[i] += dt_s * (next.dq_rad_s[i] - late_s * acceleration);
        }
        Ok(next)
    }
}

impl<const N: usize> Instant<N> {
    /// One of the 9 + 3N numbers of the state.
    fn element(&mut self, number: usize) -> &mut f64 {
        match number {
            0..3 => &mut self.robot.base_pose_world[number],
            3..6 => &mut self.robot.base_velocity_world[number - 3],
            6..9 => &mut self.command_body[number - 6],
            _ => {
                let joint = (number - 9) % N;
                match (number - 9) / N {
                    0 => &mut self.robot.q_rad[joint],
                    1 => &mut self.robot.dq_rad_s[joint],
                    _ => &mut self.torque_nm[joint],
                }
            }
        }
    }
}

/// ln ρ by repeated squaring: ρ = lim ‖Aᵏ‖^(1/k), k = 2, 4, 8 …
fn log_spectral_radius(mut power: SMatrix<f64, STATES, STATES>) -> f64 {
    let (mut log, mut share) = (0.0, 1.0);
    for _ in 0..SQUARINGS {
        let norm = power.norm();
        if norm <= 0.0 {
            return f64::NEG_INFINITY;
        }
        power /= norm;
        log += share * norm.ln();
        share *= 0.5;
        power = power * power;
    }
    log
}

#[cfg(test)]
mod tests {
    use super::*;
    use moca_msgs::TrueArm;
    use moca_msgs::robot::{AnyArm, MOCA_MOUNT, PANDA, SUMMIT_XL, UR10E};

    /// Growth under hold of a small motion, 1/s: the worse of a command at once and one that is a period late.
    fn held<const N: usize>(arm: &ArmTable<N>, rate_hz: f64, q_rad: &[f64; N]) -> f64 {
        let mut parameters = Parameters::for_arm(arm);
        parameters.limits.period_s = 1.0 / rate_hz;
        let servo_s = SUMMIT_XL.servo_time_constant_s;
        let closed = ClosedLoop::new(arm, &MOCA_MOUNT, &Payload::NONE, servo_s, &parameters).unwrap();
        [Command::AtOnce, Command::OnePeriodLate]
            .map(|command| closed.growth_per_s(ControlLaw::Hold, command, q_rad).unwrap())
            .into_iter()
            .fold(f64::NEG_INFINITY, f64::max)
    }

    /// At 250 Hz, or with a strong wrist, hold used to be unstable: its stiffness was twice the torque limit.
    #[test]
    fn held_arm_settles_whatever_its_rate_and_torque_limit() {
        for strong in [false, true] {
            let mut arm = UR10E;
            arm.torque_max_nm[5] = if strong { 1000.0 } else { UR10E.torque_max_nm[5] };
            for rate_hz in [100.0, 250.0, 333.0, 1000.0] {
                for q_rad in [UR10E.home_rad, [0.3, -1.0, 0.02, 1.0, -0.01, 2.0]] {
                    let growth = held(&arm, rate_hz, &q_rad);
                    assert!(growth < NO_GROWTH_PER_S, "{strong} {rate_hz} Hz {q_rad:?}: {growth} /s");
                }
            }
        }
        assert!(held(&PANDA, 100.0, &PANDA.home_rad) < NO_GROWTH_PER_S);
    }

    #[test]
    fn panda_hold_at_1_khz_has_full_stiffness() {
        let model = crate::ArmModel::<7, f64>::new(&PANDA, &MOCA_MOUNT, &Payload::NONE).unwrap();
        let mass = model.dynamics(0.0, &PANDA.home_rad, &[0.0; 7]).mass;
        let most = crate::joint_stiffness::largest(&mass, 1e-3);
        assert!((0..7).all(|i| most[i] > 2.0 * PANDA.torque_max_nm[i]), "{most:?} N·m/rad");
    }

    /// Growth of an arm whose links are `scale` times as heavy as believed and which carries a tool, the worst law's, 1/s.
    fn compensated(scale: f64, tool_kg: f64, time_s: f64, q_rad: &[f64; 7]) -> f64 {
        let truth = TrueArm { mass_scale: scale, tool_mass_kg: tool_kg, ..TrueArm::AS_DESCRIBED };
        let heavy = truth.applied(&AnyArm::of(&PANDA)).table::<7>().unwrap();
        let payload = Payload { inertial: truth.tool(), ..Payload::NONE };
        let plant = ArmModel::new(&heavy, &MOCA_MOUNT, &payload).unwrap();
        let parameters = Parameters::for_arm(&PANDA);
        let servo_s = SUMMIT_XL.servo_time_constant_s;
        let closed = ClosedLoop::new(&PANDA, &MOCA_MOUNT, &Payload::NONE, servo_s, &parameters).unwrap();
        [ControlLaw::Impedance, ControlLaw::FollowMe, ControlLaw::Hold]
            .map(|law| closed.compensated_growth_per_s(law, &plant, time_s, q_rad).unwrap())
            .into_iter()
            .fold(f64::NEG_INFINITY, f64::max)
    }

    #[test]
    fn compensated_arm_settles_a_quarter_off_with_3_kg() {
        let postures = [PANDA.home_rad, [0.5, -0.2, 0.3, -1.8, 0.4, 1.2, 0.0]];
        for q_rad in postures {
            for (scale, tool_kg) in [(0.75, 0.0), (1.0, 0.0), (1.25, 3.0)] {
                for time_s in [0.1, 0.5, 2.0] {
                    let growth = compensated(scale, tool_kg, time_s, &q_rad);
                    assert!(
                        growth < NO_GROWTH_PER_S,
                        "{scale} {tool_kg} kg {time_s} s {q_rad:?}: {growth} /s"
                    );
                }
            }
        }
        let fast = compensated(4.0, 20.0, 1e-3, &PANDA.home_rad);
        assert!(fast > 1.0, "a load that is learnt too fast shakes a much heavier arm: {fast} /s");
    }

    #[test]
    fn the_spectral_radius_of_a_rotation_that_grows_is_its_factor() {
        let mut a = SMatrix::<f64, STATES, STATES>::zeros();
        let (s, c) = 0.3_f64.sin_cos();
        (a[(0, 0)], a[(0, 1)], a[(1, 0)], a[(1, 1)]) = (1.01 * c, -1.01 * s, 1.01 * s, 1.01 * c);
        a[(2, 2)] = 0.5;
        a[(0, 2)] = 1e3; // far from normal
        assert!((log_spectral_radius(a) - 1.01_f64.ln()).abs() < 1e-5);
        // what coasts grows, but not as a power
        let mut coasting = SMatrix::<f64, STATES, STATES>::zeros();
        (coasting[(0, 0)], coasting[(0, 1)], coasting[(1, 1)]) = (1.0, 1e-3, 1.0);
        assert!(log_spectral_radius(coasting).abs() < 1e-5);
    }
}
