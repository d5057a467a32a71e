//! Controllers of a whole robot, of its base alone and of its arm alone, behind one trait: what a tick asks of any of them.

use crate::barrier::Barrier;
use crate::config::Config;
use crate::loop_state::{ControllerMemory, Memory, OtherRobot};
use crate::recentre::PosturePlace;
use crate::robot::{JOINTS, Parts, TAXELS};
use crate::targets::{Order, Targets, arm_target};
use moca_msgs::robot::{LinkInertial, resized};
use moca_msgs::{
    ArmTable, Fault, Mount, Outcome, ParameterError, Parameters, Payload, Refusal, Request, RobotCommand,
    RobotState, Target, TargetRefusal,
};
use moca_wbc::nalgebra::Matrix3;
use moca_wbc::reference_generator::{ReferenceBounds, Workspace};
use moca_wbc::self_collision::Separation;
use moca_wbc::{
    ArmController, ArmInput, ArmState, BaseController, BaseGuard, BaseInput, BaseState, ControlError,
    ControlInput, ControlLaw, ControlOutput, ControllerState, FlangePose, LimitsHit, WholeBodyController,
};

/// Inputs of a controller in addition to the robot's state.
pub(super) struct LawInput<'a> {
    pub(super) law: ControlLaw,
    pub(super) taxel_force_n: &'a [f64; TAXELS],
    pub(super) guard: &'a BaseGuard<TAXELS>,
    pub(super) dt_s: f64,
}

/// Controller of the parts that a robot has, with what it remembers from tick to tick. What is not written for a part is so for
/// parts that have nothing of the kind.
pub(super) trait Controller: Send {
    /// Contact barrier of the configuration around this controller; `None` without a cover.
    ///
    /// # Errors
    /// A number of the barrier out of range.
    fn barrier(&self, config: &Config) -> Result<Option<Barrier>, ParameterError>;

    /// Takes other parameters from the next step on.
    ///
    /// # Errors
    /// They are at odds with each other; nothing is changed.
    fn set_parameters(&mut self, wanted: &Parameters<JOINTS>) -> Outcome;

    /// Returns what it remembers.
    fn memory(&self) -> ControllerMemory;

    /// Goes on from where `memory` was taken.
    ///
    /// # Errors
    /// It is of a robot with other parts or joints.
    fn restore(&mut self, memory: &ControllerMemory) -> Result<(), OtherRobot>;

    /// Carries `object`, flange's axes, in the hand from the next step on; one without mass is none.
    ///
    /// # Errors
    /// No body; nothing is changed.
    fn carry(&mut self, _: &LinkInertial) -> Result<(), ParameterError> {
        Ok(())
    }

    /// Forgets what it remembers: the next step enters the law from the measured state.
    fn leave(&mut self);

    /// Leads the running law. One that has not been entered yet cannot be led.
    ///
    /// # Errors
    /// A value that is not finite.
    fn lead(
        &mut self,
        order: &Order,
        robot: &RobotState<JOINTS>,
        workspace: &Workspace,
    ) -> Result<(), ControlError>;

    /// One step of a law.
    ///
    /// # Errors
    /// The fault to stop with.
    fn step(
        &mut self,
        robot: &RobotState<JOINTS>,
        input: &LawInput<'_>,
    ) -> Result<ControlOutput<JOINTS>, Fault>;

    /// Pose of the tool on the base with the arm in its posture; `None` unless an arm stands on a base.
    fn posture_place(&self, _: &Parameters<JOINTS>) -> Option<PosturePlace> {
        None
    }

    /// Axes of the tool in W; `None` without an arm.
    fn tool_axes_world(&self, _: &RobotState<JOINTS>) -> Option<Matrix3<f64>> {
        None
    }

    /// Joint torques beside the model's, as the momentum observer estimates them, N·m; `None` before a law was entered.
    fn external_torque_nm(&self) -> Option<[f64; JOINTS]> {
        None
    }

    /// Moves the target with a twist \[m/s; rad/s\]. A law that has not been entered yet has no target.
    ///
    /// # Errors
    /// A value that is not finite.
    fn set_target_twist(&mut self, _: [f64; 6]) -> Result<(), ControlError> {
        Ok(())
    }

    /// Returns true if the last target has been reached, or if there was none.
    fn has_reached(&self) -> bool {
        true
    }

    /// Takes the target along, world axes, m/s.
    ///
    /// # Errors
    /// A value that is not finite.
    fn carry_target(&mut self, _velocity_world_m_s: [f64; 2], _dt_s: f64) -> Result<(), ControlError> {
        Ok(())
    }

    /// Refuses a target that leads two parts of the robot too near to each other; without a guard it takes each.
    ///
    /// # Errors
    /// The two parts and their distance.
    fn keeps_apart(&self, _: &Request, _: &RobotState<JOINTS>, _: &Targets) -> Result<(), TargetRefusal> {
        Ok(())
    }
}

/// Controller of the configured parts.
///
/// # Errors
/// The first parameter or number of the geometry out of range, and an arm of so many joints that there is no controller for it.
pub(super) fn of(
    config: &Config,
    parameters: &Parameters<JOINTS>,
) -> Result<Box<dyn Controller>, ParameterError> {
    let joints = config.arm().joints;
    Ok(match (config.plant.parts, joints) {
        (Parts::Base, _) => Box::new(Base::new(config, parameters)?),
        (Parts::Whole, 6) => Box::new(Whole::<6>::new(config, parameters)?),
        (Parts::Whole, 7) => Box::new(Whole::<7>::new(config, parameters)?),
        (Parts::Arm, 6) => Box::new(Arm::<6>::new(config, parameters)?),
        (Parts::Arm, 7) => Box::new(Arm::<7>::new(config, parameters)?),
        _ => return Err(other_joints(joints)),
    })
}

/// No controller for so many joints, as an error.
fn other_joints(joints: usize) -> ParameterError {
    #[expect(clippy::cast_precision_loss, reason = "a small count")]
    let value = joints as f64;
    ParameterError { name: "robot.arm", value, unit: "joints", min: 6.0, max: 7.0 }
}

/// Tables of an arm of `N` joints, for a model with another load.
struct ArmTables<const N: usize> {
    arm: ArmTable<N>,
    mount: Mount,
    payload: Payload,
}

impl<const N: usize> ArmTables<N> {
    fn new(config: &Config) -> Result<Self, ParameterError> {
        let arm = config.arm().table::<N>().ok_or(other_joints(config.arm().joints))?;
        Ok(Self { arm, mount: config.robot.mount, payload: config.robot.payload() })
    }
}

/// An arm of `N` joints on a base with a cover.
struct Whole<const N: usize> {
    tables: ArmTables<N>,
    controller: WholeBodyController<N, TAXELS>,
    state: Option<ControllerState<N>>,
}

impl<const N: usize> Whole<N> {
    fn new(config: &Config, parameters: &Parameters<JOINTS>) -> Result<Self, ParameterError> {
        let (tables, taxels) = (ArmTables::new(config)?, config.robot.cover.placements());
        let ArmTables { arm, mount, payload } = &tables;
        let whole = WholeBodyController::new(arm, mount, payload, &taxels, &parameters.resized())?;
        let guard = config.self_collision()?;
        let controller = guard.map_or(whole, |guard| whole.with_self_collision(guard));
        Ok(Self { tables, controller, state: None })
    }
}

impl<const N: usize> Controller for Whole<N>
where
    Option<ControllerState<N>>: Memory,
{
    fn barrier(&self, config: &Config) -> Result<Option<Barrier>, ParameterError> {
        Barrier::new(config, Some(self.controller.model()))
    }

    fn set_parameters(&mut self, wanted: &Parameters<JOINTS>) -> Outcome {
        replace(&mut self.controller, |controller| controller.with_parameters(&wanted.resized()))
    }

    fn memory(&self) -> ControllerMemory {
        self.state.into()
    }

    fn restore(&mut self, memory: &ControllerMemory) -> Result<(), OtherRobot> {
        self.state = memory.try_into()?;
        Ok(())
    }

    fn carry(&mut self, object: &LinkInertial) -> Result<(), ParameterError> {
        let ArmTables { arm, mount, payload } = &self.tables;
        self.controller = self.controller.carrying(arm, mount, payload, object)?;
        if let Some(state) = &mut self.state {
            state.change_model();
        }
        Ok(())
    }

    fn leave(&mut self) {
        self.state = None;
    }

    fn lead(
        &mut self,
        order: &Order,
        robot: &RobotState<JOINTS>,
        workspace: &Workspace,
    ) -> Result<(), ControlError> {
        let Some(state) = &mut self.state else { return Ok(()) };
        let target = arm_target(order).unwrap_or(moca_wbc::Target::Hold);
        state.lead(&target, &robot.resized(), &ReferenceBounds::DEFAULT, Some(workspace))?;
        state.lead_base(base_velocity_body(order))
    }

    fn step(
        &mut self,
        robot: &RobotState<JOINTS>,
        input: &LawInput<'_>,
    ) -> Result<ControlOutput<JOINTS>, Fault> {
        let &LawInput { law, taxel_force_n, guard, dt_s } = input;
        let input = ControlInput {
            robot: robot.resized(),
            taxel_force_n: *taxel_force_n,
            flange_wrench_world: None,
            // nothing is copied of a list that only a barrier gives
            guard: BaseGuard { outward_m_s: guard.outward_m_s.as_ref().copied(), ..*guard },
            dt_s,
        };
        let state = entered(&mut self.state, || self.controller.enter(law, &input.robot))?;
        match &self.controller.step(law, state, &input) {
            Ok(output) => Ok(ControlOutput {
                command: output.command.resized(),
                cover_wrench_base: output.cover_wrench_base,
                flange_wrench_world: output.flange_wrench_world,
                flange: output.flange,
                flange_desired: output.flange_desired,
                limits: output.limits,
                exceeded: output.exceeded,
            }),
            Err(_) => Err(Fault::ControlRefused),
        }
    }

    fn posture_place(&self, parameters: &Parameters<JOINTS>) -> Option<PosturePlace> {
        let posture_rad = &parameters.resized::<N>().gains.posture_rad;
        let kinematics = self.controller.model().kinematics(0.0, posture_rad);
        let (position_base, rotation_base) = (kinematics.tool_from_base(), kinematics.tool_rotation);
        Some(PosturePlace { position_base, rotation_base })
    }

    fn tool_axes_world(&self, robot: &RobotState<JOINTS>) -> Option<Matrix3<f64>> {
        let [_, _, yaw] = robot.base_pose_world;
        Some(self.controller.model().kinematics(yaw, &robot.resized::<N>().q_rad).tool_rotation)
    }

    fn external_torque_nm(&self) -> Option<[f64; JOINTS]> {
        self.state.as_ref().map(|state| resized(state.external_torque_nm()))
    }

    fn set_target_twist(&mut self, twist: [f64; 6]) -> Result<(), ControlError> {
        self.state.as_mut().map_or(Ok(()), |state| state.set_target_twist(twist))
    }

    fn has_reached(&self) -> bool {
        self.state.as_ref().is_none_or(ControllerState::has_reached)
    }

    fn carry_target(&mut self, velocity_world_m_s: [f64; 2], dt_s: f64) -> Result<(), ControlError> {
        self.state.as_mut().map_or(Ok(()), |state| state.carry_target(velocity_world_m_s, dt_s))
    }

    fn keeps_apart(
        &self,
        request: &Request,
        robot: &RobotState<JOINTS>,
        targets: &Targets,
    ) -> Result<(), TargetRefusal> {
        let (least_m, robot) = (self.controller.smallest_distance(), robot.resized());
        far_enough(least_m, request, targets, |target| self.controller.too_near_at(target, &robot))
    }
}

/// A base with a cover.
struct Base {
    controller: BaseController<TAXELS>,
    state: BaseState,
}

impl Base {
    fn new(config: &Config, parameters: &Parameters<JOINTS>) -> Result<Self, ParameterError> {
        let controller = BaseController::new(&config.robot.cover.placements(), parameters)?;
        let state = controller.enter();
        Ok(Self { controller, state })
    }
}

impl Controller for Base {
    fn barrier(&self, config: &Config) -> Result<Option<Barrier>, ParameterError> {
        Barrier::new::<JOINTS>(config, None)
    }

    fn set_parameters(&mut self, wanted: &Parameters<JOINTS>) -> Outcome {
        replace(&mut self.controller, |controller| controller.with_parameters(wanted))
    }

    fn memory(&self) -> ControllerMemory {
        self.state.into()
    }

    fn restore(&mut self, memory: &ControllerMemory) -> Result<(), OtherRobot> {
        self.state = memory.try_into()?;
        Ok(())
    }

    fn leave(&mut self) {
        self.state = self.controller.enter();
    }

    fn lead(&mut self, order: &Order, _: &RobotState<JOINTS>, _: &Workspace) -> Result<(), ControlError> {
        self.state.lead(base_velocity_body(order))
    }

    fn step(
        &mut self,
        robot: &RobotState<JOINTS>,
        input: &LawInput<'_>,
    ) -> Result<ControlOutput<JOINTS>, Fault> {
        let &LawInput { law, taxel_force_n, guard, dt_s } = input;
        let yaw_world_rad = robot.base_pose_world[2];
        let input = BaseInput { yaw_world_rad, taxel_force_n: *taxel_force_n, guard: *guard, dt_s };
        let output = match law {
            ControlLaw::Hold => self.controller.hold(&mut self.state, &input),
            ControlLaw::Impedance | ControlLaw::FollowMe => self.controller.step(&mut self.state, &input),
        }
        .map_err(|_| Fault::ControlRefused)?;
        Ok(ControlOutput {
            command: RobotCommand { base_velocity_body: output.velocity_body, ..WITHOUT_PARTS.command },
            cover_wrench_base: output.cover_wrench_base,
            limits: output.limits,
            ..WITHOUT_PARTS
        })
    }
}

/// An arm of `N` joints on a stand.
struct Arm<const N: usize> {
    tables: ArmTables<N>,
    controller: ArmController<N>,
    state: Option<ArmState<N>>,
}

impl<const N: usize> Arm<N> {
    fn new(config: &Config, parameters: &Parameters<JOINTS>) -> Result<Self, ParameterError> {
        let tables = ArmTables::new(config)?;
        let ArmTables { arm, mount, payload } = &tables;
        let alone = ArmController::new(arm, mount, payload, &parameters.resized())?;
        let guard = config.self_collision()?;
        let controller = guard.map_or(alone, |guard| alone.with_self_collision(guard));
        Ok(Self { tables, controller, state: None })
    }
}

impl<const N: usize> Controller for Arm<N>
where
    Option<ArmState<N>>: Memory,
{
    fn barrier(&self, _: &Config) -> Result<Option<Barrier>, ParameterError> {
        Ok(None)
    }

    fn set_parameters(&mut self, wanted: &Parameters<JOINTS>) -> Outcome {
        replace(&mut self.controller, |controller| controller.with_parameters(&wanted.resized()))
    }

    fn memory(&self) -> ControllerMemory {
        self.state.into()
    }

    fn restore(&mut self, memory: &ControllerMemory) -> Result<(), OtherRobot> {
        self.state = memory.try_into()?;
        Ok(())
    }

    fn carry(&mut self, object: &LinkInertial) -> Result<(), ParameterError> {
        let ArmTables { arm, mount, payload } = &self.tables;
        self.controller = self.controller.carrying(arm, mount, payload, object)?;
        if let Some(state) = &mut self.state {
            state.change_model();
        }
        Ok(())
    }

    fn leave(&mut self) {
        self.state = None;
    }

    fn lead(
        &mut self,
        order: &Order,
        robot: &RobotState<JOINTS>,
        workspace: &Workspace,
    ) -> Result<(), ControlError> {
        let Some(state) = &mut self.state else { return Ok(()) };
        let target = arm_target(order).unwrap_or(moca_wbc::Target::Hold);
        state.lead(&target, &robot.resized(), &ReferenceBounds::DEFAULT, Some(workspace))
    }

    fn step(
        &mut self,
        robot: &RobotState<JOINTS>,
        input: &LawInput<'_>,
    ) -> Result<ControlOutput<JOINTS>, Fault> {
        let &LawInput { law, dt_s, .. } = input;
        let input = ArmInput { robot: robot.resized(), flange_wrench_world: None, dt_s };
        let state = entered(&mut self.state, || self.controller.enter(&input.robot))?;
        let output = match law {
            ControlLaw::Hold => self.controller.hold(state, &input),
            ControlLaw::Impedance | ControlLaw::FollowMe => self.controller.step(state, &input),
        }
        .map_err(|_| Fault::ControlRefused)?;
        Ok(ControlOutput {
            command: RobotCommand {
                base_velocity_body: [0.0; 3],
                arm_torque_nm: resized(&output.torque_nm),
                arm_gravity_nm: resized(&output.gravity_nm),
            },
            flange_wrench_world: output.flange_wrench_world,
            flange: output.flange,
            flange_desired: output.flange_desired,
            limits: output.limits,
            exceeded: output.exceeded,
            ..WITHOUT_PARTS
        })
    }

    fn tool_axes_world(&self, robot: &RobotState<JOINTS>) -> Option<Matrix3<f64>> {
        let [_, _, yaw] = robot.base_pose_world;
        Some(self.controller.model().kinematics(yaw, &robot.resized::<N>().q_rad).tool_rotation)
    }

    fn external_torque_nm(&self) -> Option<[f64; JOINTS]> {
        self.state.as_ref().map(|state| resized(state.external_torque_nm()))
    }

    fn set_target_twist(&mut self, twist: [f64; 6]) -> Result<(), ControlError> {
        self.state.as_mut().map_or(Ok(()), |state| state.set_target_twist(twist))
    }

    fn has_reached(&self) -> bool {
        self.state.as_ref().is_none_or(ArmState::has_reached)
    }

    fn keeps_apart(
        &self,
        request: &Request,
        robot: &RobotState<JOINTS>,
        targets: &Targets,
    ) -> Result<(), TargetRefusal> {
        let (least_m, robot) = (self.controller.smallest_distance(), robot.resized());
        far_enough(least_m, request, targets, |target| self.controller.too_near_at(target, &robot))
    }
}

/// Refuses a request whose targets lead two parts closer to each other than `least_m`; `None` takes each.
fn far_enough<const N: usize>(
    least_m: Option<f64>,
    request: &Request,
    targets: &Targets,
    too_near_at: impl Fn(&moca_wbc::Target<N>) -> Option<Separation<N, f64>>,
) -> Result<(), TargetRefusal> {
    let Some(least_m) = least_m else { return Ok(()) };
    targets.led_through(request).into_iter().flatten().try_for_each(|target| {
        let nearest = arm_target(&Order::To(target)).and_then(|target| too_near_at(&target));
        nearest.map_or(Ok(()), |nearest| {
            Err(TargetRefusal::TooNear { parts: nearest.parts, distance_m: nearest.distance, least_m })
        })
    })
}

/// Velocity that an order gives the base, axes of B; zero of one that is for the arm.
const fn base_velocity_body(order: &Order) -> [f64; 3] {
    match order {
        Order::To(Target::BaseVelocity { velocity_body }) => *velocity_body,
        _ => [0.0; 3],
    }
}

/// Output for the parts that a robot lacks.
pub(super) const WITHOUT_PARTS: ControlOutput<JOINTS> = {
    const NOWHERE: FlangePose =
        FlangePose { position_world: [0.0; 3], quaternion_world: [0.0, 0.0, 0.0, 1.0] };
    ControlOutput {
        command: RobotCommand {
            base_velocity_body: [0.0; 3],
            arm_torque_nm: [0.0; JOINTS],
            arm_gravity_nm: [0.0; JOINTS],
        },
        cover_wrench_base: [0.0; 3],
        flange_wrench_world: [0.0; 6],
        flange: NOWHERE,
        flange_desired: NOWHERE,
        limits: LimitsHit::NONE,
        exceeded: None,
    }
};

/// The state, entered if it is not there yet.
fn entered<S>(
    state: &mut Option<S>,
    enter: impl FnOnce() -> Result<S, ControlError>,
) -> Result<&mut S, Fault> {
    match state {
        Some(state) => Ok(state),
        None => Ok(state.insert(enter().map_err(|_| Fault::StateInvalid)?)),
    }
}

fn replace<C>(controller: &mut C, next: impl FnOnce(&C) -> Result<C, ParameterError>) -> Outcome {
    *controller = next(controller).map_err(|_| Refusal::Conflict)?;
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn controller(arm: &str, parts: &str) -> Box<dyn Controller> {
        let config = Config::parse(&format!("robot.arm = \"{arm}\"\nplant.parts = \"{parts}\"\n")).unwrap();
        of(&config, &config.parameters()).unwrap()
    }

    #[test]
    fn a_memory_fits_the_same_parts_and_joints_alone() {
        let all =
            [("panda", "whole"), ("ur10e", "whole"), ("panda", "arm"), ("ur10e", "arm"), ("panda", "base")];
        for one in all {
            for other in all {
                let memory = controller(other.0, other.1).memory();
                let fits = controller(one.0, one.1).restore(&memory).is_ok();
                assert_eq!(fits, one == other, "{one:?} {other:?}");
            }
        }
        let base = controller("ur10e", "base").memory();
        assert!(controller("panda", "base").restore(&base).is_ok(), "a base alone has no arm");
    }
}
