//! From mode and forces to a command: which law runs in which mode.

use crate::barrier::{Barrier, to_world};
use crate::base_watch::BaseWatch;
use crate::compensation::Compensation;
use crate::config::live::changed;
use crate::config::{Config, RecentrePolicy};
use crate::cover::CoverState;
use crate::foam_recovery::FoamRecovery;
use crate::loop_state::{JointsState, LawState, MotionState, OtherRobot};
use crate::plant::SourceAge;
use crate::protection::{Protected, Protection};
use crate::recentre::{PosturePlace, Recentre};
use crate::robot::{JOINTS, Parts, PlantKind, TAXELS};
use crate::supervisor::Touch;
use crate::targets::{Order, Targets, arm_target};
use crate::uncalibrated::PushCap;
use crate::uncovered::Uncovered;
use moca_msgs::request::ARMING_POSTURE_RAD;
use moca_msgs::robot::resized;
use moca_msgs::{
    Actuation, ContactRow, Fault, Mode, Outcome, ParameterError, ParameterValues, Parameters, PostureOffset,
    Refusal, Request, RobotCommand, RobotState, Target, TargetRefusal, TargetState, TaxelStatus,
};
use moca_wbc::reference_generator::{ReferenceBounds, Workspace};
use moca_wbc::{
    ArmController, ArmInput, ArmState, BaseController, BaseGuard, BaseInput, BaseState, ControlError,
    ControlInput, ControlLaw, ControlOutput, ControllerState, Exceeded, FlangePose, LimitsHit,
    WholeBodyController,
};

/// The controller of the parts that the robot has, with what it remembers from tick to tick, for an arm of `N` joints.
#[expect(clippy::large_enum_variant, reason = "there is one, and it lives as long as the loop")]
enum Controller<const N: usize> {
    Whole(WholeBodyController<N, TAXELS>, Option<ControllerState<N>>),
    Base(BaseController<TAXELS>, BaseState),
    Arm(ArmController<N>, Option<ArmState<N>>),
}

/// The numbers of joints that there are controllers for.
#[expect(clippy::large_enum_variant, reason = "there is one, and it lives as long as the loop")]
enum Joints {
    Six(Controller<6>),
    Seven(Controller<7>),
}

/// Calls the controller of either number of joints.
macro_rules! either {
    ($joints:expr, $controller:ident => $use:expr) => {
        match $joints {
            Joints::Six($controller) => $use,
            Joints::Seven($controller) => $use,
        }
    };
}

/// The controller with its parameters and what protects people from it.
pub struct Motion {
    controller: Joints,
    joints: usize,
    taxels: usize,
    parameters: Parameters<JOINTS>,
    protection: Protection,
    barrier: Option<Barrier>,
    /// Cap of the push where the cover is not calibrated.
    push_cap: Option<PushCap>,
    /// Watch on the base, where its stopping distance is believed.
    base_watch: Option<BaseWatch>,
    /// Guard of the base's sides without a taxel.
    uncovered: Option<Uncovered>,
    targets: Targets,
    recentre: Recentre,
    /// Remains of past forces in the foam; `None` for the laws as published.
    recovery: Option<FoamRecovery>,
    /// Compensation of loads that the arm's model does not know, if it is on.
    compensation: Option<Compensation>,
    parts: Parts,
    /// Protection of the present tick.
    protected: Protected,
    /// A target moves with a twist.
    twisted: bool,
    real: bool,
    deadlines: SourceAge,
}

impl Motion {
    /// Not yet entered: the first command starts from the measured state.
    ///
    /// # Errors
    /// The first parameter or number of the geometry out of range.
    pub fn new(config: &Config, protection: Protection) -> Result<Self, ParameterError> {
        let (parameters, parts) = (config.parameters(), config.plant.parts);
        let (joints, taxels) = (config.arm().joints, config.robot.cover.count());
        let controller = match joints {
            6 => Joints::Six(Controller::new(config, &parameters)?),
            7 => Joints::Seven(Controller::new(config, &parameters)?),
            _ => return Err(other_joints(joints)),
        };
        let barrier = either!(&controller, controller => controller.barrier(config))?;
        let push_cap = PushCap::new(config)?;
        let base_watch = BaseWatch::new(config);
        let uncovered = parts.has_cover().then(|| Uncovered::new(config));
        let protected = Protected::default();
        let targets = Targets::new(config);
        let place = either!(&controller, controller => controller.posture_place(&parameters));
        let recentre = Recentre::new(config, place);
        let recovery = (config.control.recentre == RecentrePolicy::OnRequest).then(FoamRecovery::default);
        let compensation = Compensation::new(config, &parameters);
        let real = config.plant.kind == PlantKind::Robot;
        let deadlines =
            SourceAge { arm_s: config.plant.arm.deadline_s, base_s: config.plant.base.deadline_s };
        Ok(Self {
            controller,
            joints,
            taxels,
            parameters,
            protection,
            barrier,
            push_cap,
            base_watch,
            uncovered,
            targets,
            recentre,
            recovery,
            compensation,
            parts,
            protected,
            twisted: false,
            real,
            deadlines,
        })
    }

    /// Returns true for a real robot, whose arm holds itself on its own controller while it gets no torques.
    pub const fn is_of_a_real_robot(&self) -> bool {
        self.real
    }

    /// Oldest states that are controlled with.
    pub const fn deadlines(&self) -> SourceAge {
        self.deadlines
    }

    /// The joint (0 is the first) of a real arm that is furthest from its posture, and how far, rad, where that is further
    /// than arming allows: the null space would bring it there at once, and the base with it.
    pub fn far_joint(&self, robot: &RobotState<JOINTS>) -> Option<(u8, f64)> {
        if !(self.real && self.parts.has_arm()) {
            return None;
        }
        let posture = &self.parameters.gains.posture_rad[..self.joints];
        let off_rad = (0..).zip(robot.q_rad.iter().zip(posture).map(|(q, wanted)| (q - wanted).abs()));
        off_rad.max_by(|a, b| a.1.total_cmp(&b.1)).filter(|(_, off_rad)| *off_rad > ARMING_POSTURE_RAD)
    }

    /// Returns the number of joints.
    pub const fn joints(&self) -> usize {
        if self.parts.has_arm() { self.joints } else { 0 }
    }

    /// Returns the number of taxels.
    pub const fn taxels(&self) -> usize {
        if self.parts.has_cover() { self.taxels } else { 0 }
    }

    /// Which parts of the robot it moves.
    pub const fn parts(&self) -> Parts {
        self.parts
    }

    /// Finds what protects the people around the base in the tick at `now_ns`; once a tick, before [`Motion::command`].
    pub fn protect(&mut self, now_ns: u64, cover: &CoverState, mode: Mode) {
        if self.parts.has_cover() {
            let limits = &self.parameters.limits;
            self.protection.set_late(self.base_watch.as_ref().map_or(0.0, BaseWatch::late_s));
            self.protection.update(now_ns, cover, limits, mode.moves(), &mut self.protected);
        }
        if let Some(barrier) = &mut self.barrier {
            self.protection.squeezed(now_ns, barrier.rows());
            barrier.take_cover(now_ns, cover, self.protected.speed_limit.m_s);
            // a touch too light for a force is not driven into either
            for (blocked, light) in self.protected.guard.blocked.iter_mut().zip(cover.poll.early.light) {
                *blocked |= light;
            }
        }
        if let Some(cap) = &mut self.push_cap {
            cap.feel(cover);
        }
        if let Some(uncovered) = &mut self.uncovered {
            uncovered.feel(cover);
        }
        self.recentre.feel(cover);
    }

    /// Returns the protection of this tick.
    pub const fn protected(&self) -> &Protected {
        &self.protected
    }

    /// Returns the rows of the contact barrier in this tick, taxel by taxel; empty without one.
    pub fn contact_rows(&self) -> &[ContactRow] {
        self.barrier.as_ref().map_or(&[], |barrier| barrier.rows())
    }

    /// Speed of the fastest point of the cover at the base's measured velocity, m/s; 0 without a cover.
    pub fn cover_speed_m_s(&self, robot: &RobotState<JOINTS>) -> f64 {
        if self.parts.has_cover() { self.protection.cover_speed_m_s(robot) } else { 0.0 }
    }

    /// Way of the base towards a side that no taxel covers since it last rested, m; 0 where all are covered.
    pub fn uncovered_way_m(&self) -> f64 {
        self.uncovered.as_ref().map_or(0.0, Uncovered::way_m)
    }

    /// Changes a parameter (its number in [`moca_msgs::params::CONTROLLER`]) from the next step on; gains reach the law
    /// through a filter.
    ///
    /// # Errors
    /// No such parameter, not live, out of range, or at odds with another one; nothing is changed.
    pub fn set_parameter(&mut self, number: usize, values: &ParameterValues) -> Outcome {
        let wanted = changed(&self.parameters, self.joints, number, values)?;
        either!(&mut self.controller, controller => controller.set_parameters(&wanted))?;
        self.take_parameters(&wanted);
        Ok(())
    }

    /// Returns its memory.
    pub fn state(&self) -> MotionState {
        MotionState {
            controller: match &self.controller {
                Joints::Six(controller) => JointsState::Six(controller.state()),
                Joints::Seven(controller) => JointsState::Seven(controller.state()),
            },
            parameters: self.parameters,
            protection: self.protection.state().clone(),
            barrier: self.barrier.as_ref().map(Barrier::state),
            push_cap: self.push_cap.as_ref().map(PushCap::state),
            base_watch: self.base_watch.as_ref().map(BaseWatch::state),
            uncovered: self.uncovered.as_ref().map(Uncovered::state),
            targets: self.targets.state().clone(),
            recentre: self.recentre.state(),
            recovery: self.recovery,
            compensation: self.compensation.as_ref().map(Compensation::state),
        }
    }

    /// Goes on from where `state` was taken.
    ///
    /// # Errors
    /// It is of another robot than the configuration's.
    pub fn restore(&mut self, state: &MotionState) -> Result<(), OtherRobot> {
        let mut parameters = state.parameters;
        parameters.limits.period_s = self.parameters.limits.period_s;
        either!(&mut self.controller, controller => controller.set_parameters(&parameters))
            .map_err(|_| OtherRobot)?;
        match (&mut self.controller, &state.controller) {
            (Joints::Six(controller), JointsState::Six(state)) => controller.restore(state)?,
            (Joints::Seven(controller), JointsState::Seven(state)) => controller.restore(state)?,
            _ => return Err(OtherRobot),
        }
        self.take_parameters(&parameters);
        self.protection.restore(&state.protection);
        restored(self.barrier.as_mut(), state.barrier.as_ref(), Barrier::restore)?;
        restored(self.push_cap.as_mut(), state.push_cap.as_ref(), PushCap::restore)?;
        restored(self.base_watch.as_mut(), state.base_watch.as_ref(), BaseWatch::restore)?;
        restored(self.uncovered.as_mut(), state.uncovered.as_ref(), Uncovered::restore)?;
        self.targets.restore(&state.targets);
        self.recentre.restore(&state.recentre);
        self.recovery = state.recovery;
        restored(self.compensation.as_mut(), state.compensation.as_ref(), Compensation::restore)?;
        Ok(())
    }

    /// Forgets targets and controller state: the next command is entered anew from the measured state.
    pub fn leave(&mut self) {
        self.twisted = false;
        self.targets.enter(ControlLaw::Hold);
        self.recentre.leave();
        if let Some(barrier) = &mut self.barrier {
            barrier.leave();
        }
        if let Some(compensation) = &mut self.compensation {
            compensation.leave();
        }
        either!(&mut self.controller, controller => controller.leave());
    }

    /// Moves the target of the running law with `twist` \[m/s; rad/s\], axes of the law's reference, until told
    /// otherwise. A law that has not been entered yet has no target to move.
    ///
    /// # Errors
    /// A value that is not finite.
    pub fn set_target_twist(&mut self, twist: [f64; 6]) -> Result<(), ControlError> {
        either!(&mut self.controller, controller => controller.set_target_twist(twist))?;
        self.twisted = twist.iter().any(|value| *value != 0.0);
        Ok(())
    }

    /// Answers a request for a target, or for its end, in `mode`.
    ///
    /// # Errors
    /// Why it is not taken.
    pub fn take_target(
        &mut self,
        now_ns: u64,
        request: &Request,
        mode: Mode,
        robot: &RobotState<JOINTS>,
        touch: Option<Touch>,
    ) -> Outcome {
        let law = law_of(mode);
        self.targets.enter(law);
        if *request == Request::EndTarget {
            self.recentre.end();
        }
        either!(&self.controller, controller => controller.keeps_apart(request, robot, &self.targets))?;
        self.targets.take(now_ns, request, law, &self.parameters.limits.base_velocity, robot, touch)
    }

    fn take_parameters(&mut self, wanted: &Parameters<JOINTS>) {
        self.parameters = *wanted;
        self.recentre.set_place(either!(&self.controller, controller => controller.posture_place(wanted)));
    }

    /// Answers a request to drive the base back under the arm.
    ///
    /// # Errors
    /// See [`Recentre::request`].
    pub fn recentre(&mut self, touch: Option<Touch>) -> Outcome {
        self.recentre.request(touch)
    }

    /// Displacement of the base from where the arm's posture wants it.
    pub const fn posture_offset(&self) -> Option<PostureOffset> {
        self.recentre.offset()
    }

    /// The last target since the law was entered, and how it stands.
    pub const fn target(&self) -> Option<TargetState> {
        self.targets.shown()
    }

    /// Leads the running law where the target that counts wants it.
    fn lead(
        &mut self,
        now_ns: u64,
        law: ControlLaw,
        robot: &RobotState<JOINTS>,
        touched: bool,
    ) -> Result<(), ControlError> {
        self.targets.enter(law);
        let reached = either!(&self.controller, controller => controller.has_reached());
        let Some(order) = self.targets.advance(now_ns, touched, reached) else { return Ok(()) };
        let workspace = self.targets.workspace();
        either!(&mut self.controller, controller => controller.lead(&order, robot, workspace))
    }

    /// One tick's command in `mode` at `now_ns`, `dt_s` after the last one; it holds in an output with a [`fault_of`].
    /// [`Motion::remember`] follows.
    ///
    /// # Errors
    /// The fault to stop with; the order of that tick must then be [`Actuation::Brake`].
    pub fn command(
        &mut self,
        now_ns: u64,
        mode: Mode,
        robot: &RobotState<JOINTS>,
        forces: &Result<[f64; TAXELS], (usize, TaxelStatus)>,
        dt_s: f64,
    ) -> Result<ControlOutput<JOINTS>, Fault> {
        let law = law_of(mode);
        // Standing still needs no cover; a law never runs on a force that is not there.
        let mut taxel_force_n = match (law, forces) {
            (ControlLaw::Hold, _) => &NO_FORCE,
            (_, Ok(forces)) => forces,
            (_, &Err((taxel, status))) => {
                return Err(Fault::TaxelInvalid { taxel: u8::try_from(taxel).unwrap_or(u8::MAX), status });
            }
        };
        let touched = taxel_force_n[..self.taxels].iter().any(|force_n| *force_n > 0.0);
        self.lead(now_ns, law, robot, touched).map_err(|_| Fault::ControlRefused)?;
        let (guard, deceleration) = (&mut self.protected.guard, self.parameters.limits.base_acceleration);
        if let Some(uncovered) = &mut self.uncovered {
            uncovered.advance(robot, dt_s);
            guard.bounds_body = uncovered.bounds_body(deceleration);
            guard.room_body = uncovered.room_body(deceleration);
        }
        self.recentre.bound(guard, &self.parameters, (law, self.targets.leads()), dt_s);
        let contacts;
        if let Some(barrier) = &mut self.barrier {
            contacts = barrier
                .update(robot, deceleration, law == ControlLaw::Impedance, dt_s)
                .map_err(|_| Fault::ControlRefused)?;
            if law != ControlLaw::Hold {
                taxel_force_n = &contacts.force_n;
            }
            if law == ControlLaw::Impedance {
                let velocity_m_s = to_world(contacts.carried_body_m_s, robot);
                either!(&mut self.controller, controller => controller.carry_target(velocity_m_s, dt_s))
                    .map_err(|_| Fault::ControlRefused)?;
            }
            // who is pressed when a taxel fails is given room even in a stop
            if law != ControlLaw::Hold || contacts.backs_off {
                guard.outward_m_s = Some(contacts.outward_m_s);
            }
        }
        if let Some(cap) = &mut self.push_cap {
            let led = self.targets.leads() || self.twisted;
            cap.advance(robot, deceleration, led, dt_s, &mut guard.blocked);
        }
        let felt_n;
        if let Some(recovery) = &mut self.recovery {
            felt_n = recovery.felt(taxel_force_n, dt_s);
            taxel_force_n = &felt_n;
        }
        let without_friction =
            self.compensation.as_ref().and_then(|compensation| compensation.without_friction(robot));
        let robot = without_friction.as_ref().unwrap_or(robot);
        let input = LawInput { law, taxel_force_n, guard, dt_s };
        let mut output = either!(&mut self.controller, controller => controller.step(robot, &input))?;
        if let Some(compensation) = &mut self.compensation {
            // a robot that says what pushes its flange lets the observer rest
            let observed = robot.flange_wrench_world.is_none();
            let external_nm = either!(&self.controller, controller => controller.external_torque_nm());
            let external_nm = external_nm.as_ref().filter(|_| observed);
            compensation.apply(law, external_nm, &robot.dq_rad_s, dt_s, &mut output.command.arm_torque_nm);
        }
        Ok(output)
    }

    /// Compares the way of the base, measured `dt_s` after the last one, with its orders.
    ///
    /// # Errors
    /// [`Fault::BaseLate`].
    pub fn watch_base(&mut self, robot: &RobotState<JOINTS>, dt_s: f64) -> Result<(), Fault> {
        let limit_m_s = self.protected.speed_limit.m_s;
        self.base_watch.as_mut().map_or(Ok(()), |watch| watch.travelled(robot, limit_m_s, dt_s))
    }

    /// Takes in what came of [`Motion::command`].
    pub fn remember(
        &mut self,
        mode: Mode,
        robot: &RobotState<JOINTS>,
        output: &ControlOutput<JOINTS>,
        dt_s: f64,
    ) {
        let law = law_of(mode);
        let moves = law != ControlLaw::Hold && output.exceeded.is_none();
        if moves {
            self.recentre.remember(law, robot, output, dt_s);
        }
        if let Some(uncovered) = &mut self.uncovered {
            uncovered.remember(output.limits.guard && !(moves && self.recentre.stands()));
        }
        if let Some(watch) = &mut self.base_watch {
            watch.ordered(&output.command.base_velocity_body);
        }
        if let Some(barrier) = &mut self.barrier {
            barrier.remember(&output.flange, robot);
            barrier.ordered(&output.command.base_velocity_body);
        }
    }
}

/// Lets a part that a robot need not have go on from its state.
///
/// # Errors
/// One of them is missing: the state is of another robot.
fn restored<T, S>(
    part: Option<&mut T>,
    state: Option<&S>,
    restore: impl FnOnce(&mut T, &S),
) -> Result<(), OtherRobot> {
    match (part, state) {
        (Some(part), Some(state)) => restore(part, state),
        (None, None) => {}
        _ => return Err(OtherRobot),
    }
    Ok(())
}

/// Why the robot must stop that gave out `output`, if it must.
pub fn fault_of(output: &ControlOutput<JOINTS>) -> Option<Fault> {
    output.exceeded.map(|exceeded| match exceeded {
        Exceeded::JointSpeed(joint) => Fault::JointSpeed { joint: u8::try_from(joint).unwrap_or(u8::MAX) },
        Exceeded::FlangeSpeed => Fault::FlangeSpeed,
        Exceeded::PoseError => Fault::PoseError,
        Exceeded::Stretched(joint) => Fault::ArmStretched { joint: u8::try_from(joint).unwrap_or(u8::MAX) },
    })
}

/// The law that runs in a mode.
const fn law_of(mode: Mode) -> ControlLaw {
    match mode {
        Mode::Impedance => ControlLaw::Impedance,
        Mode::FollowMe => ControlLaw::FollowMe,
        Mode::Starting | Mode::Taring | Mode::Ready | Mode::ProtectiveStop | Mode::Fault => ControlLaw::Hold,
    }
}

/// Nobody is felt, N.
const NO_FORCE: [f64; TAXELS] = [0.0; TAXELS];

/// Inputs of a controller in addition to the robot's state.
struct LawInput<'a> {
    law: ControlLaw,
    taxel_force_n: &'a [f64; TAXELS],
    guard: &'a BaseGuard<TAXELS>,
    dt_s: f64,
}

/// No controller for so many joints, as an error.
fn other_joints(joints: usize) -> ParameterError {
    #[expect(clippy::cast_precision_loss, reason = "a small count")]
    let value = joints as f64;
    ParameterError { name: "robot.arm", value, unit: "joints", min: 6.0, max: 7.0 }
}

impl<const N: usize> Controller<N> {
    fn new(config: &Config, parameters: &Parameters<JOINTS>) -> Result<Self, ParameterError> {
        let arm = &config.arm().table::<N>().ok_or(other_joints(config.arm().joints))?;
        let (parameters, taxels) = (parameters.resized::<N>(), config.robot.cover.placements());
        let (mount, payload, guard) = (config.robot.mount, config.robot.payload(), config.self_collision()?);
        Ok(match config.plant.parts {
            Parts::Whole => {
                let whole = WholeBodyController::new(arm, &mount, &payload, &taxels, &parameters)?;
                Self::Whole(guard.map_or(whole, |guard| whole.with_self_collision(guard)), None)
            }
            Parts::Base => {
                let base = BaseController::new(&taxels, &parameters)?;
                let state = base.enter();
                Self::Base(base, state)
            }
            Parts::Arm => {
                let alone = ArmController::new(arm, &mount, &payload, &parameters)?;
                Self::Arm(guard.map_or(alone, |guard| alone.with_self_collision(guard)), None)
            }
        })
    }

    fn barrier(&self, config: &Config) -> Result<Option<Barrier>, ParameterError> {
        match self {
            Self::Whole(whole, _) => Barrier::new(config, Some(whole.model())),
            Self::Base(..) => Barrier::new::<N>(config, None),
            Self::Arm(..) => Ok(None),
        }
    }

    fn set_parameters(&mut self, wanted: &Parameters<JOINTS>) -> Outcome {
        let wanted = wanted.resized::<N>();
        match self {
            Self::Whole(controller, _) => replace(controller, controller.with_parameters(&wanted)),
            Self::Base(controller, _) => replace(controller, controller.with_parameters(&wanted)),
            Self::Arm(controller, _) => replace(controller, controller.with_parameters(&wanted)),
        }
    }

    /// Pose of the tool on the base with the arm in its posture; `None` unless an arm stands on a base.
    fn posture_place(&self, parameters: &Parameters<JOINTS>) -> Option<PosturePlace> {
        let Self::Whole(whole, _) = self else { return None };
        let kinematics = whole.model().kinematics(0.0, &parameters.resized::<N>().gains.posture_rad);
        let (position_base, rotation_base) = (kinematics.tool_from_base(), kinematics.tool_rotation);
        Some(PosturePlace { position_base, rotation_base })
    }

    /// Joint torques beside the model's, as the momentum observer estimates them, N·m; `None` without an arm.
    fn external_torque_nm(&self) -> Option<[f64; JOINTS]> {
        match self {
            Self::Whole(_, Some(state)) => Some(resized(state.external_torque_nm())),
            Self::Arm(_, Some(state)) => Some(resized(state.external_torque_nm())),
            Self::Whole(_, None) | Self::Arm(_, None) | Self::Base(..) => None,
        }
    }

    const fn state(&self) -> LawState<N> {
        match self {
            Self::Whole(_, state) => LawState::Whole(*state),
            Self::Base(_, state) => LawState::Base(*state),
            Self::Arm(_, state) => LawState::Arm(*state),
        }
    }

    fn restore(&mut self, state: &LawState<N>) -> Result<(), OtherRobot> {
        match (self, state) {
            (Self::Whole(_, to), LawState::Whole(from)) => *to = *from,
            (Self::Base(_, to), LawState::Base(from)) => *to = *from,
            (Self::Arm(_, to), LawState::Arm(from)) => *to = *from,
            _ => return Err(OtherRobot),
        }
        Ok(())
    }

    fn leave(&mut self) {
        match self {
            Self::Whole(_, state) => *state = None,
            Self::Base(controller, state) => *state = controller.enter(),
            Self::Arm(_, state) => *state = None,
        }
    }

    fn set_target_twist(&mut self, twist: [f64; 6]) -> Result<(), ControlError> {
        match self {
            Self::Whole(_, Some(state)) => state.set_target_twist(twist),
            Self::Arm(_, Some(state)) => state.set_target_twist(twist),
            Self::Whole(_, None) | Self::Arm(_, None) | Self::Base(..) => Ok(()),
        }
    }

    fn has_reached(&self) -> bool {
        match self {
            Self::Whole(_, Some(state)) => state.has_reached(),
            Self::Arm(_, Some(state)) => state.has_reached(),
            Self::Whole(_, None) | Self::Arm(_, None) | Self::Base(..) => true,
        }
    }

    /// A law that has not been entered yet cannot be led.
    fn lead(
        &mut self,
        order: &Order,
        robot: &RobotState<JOINTS>,
        workspace: &Workspace,
    ) -> Result<(), ControlError> {
        let (robot, bounds) = (robot.resized(), &ReferenceBounds::DEFAULT);
        let velocity_body = match order {
            Order::To(Target::BaseVelocity { velocity_body }) => *velocity_body,
            _ => [0.0; 3],
        };
        let target = arm_target(order).unwrap_or(moca_wbc::Target::Hold);
        match self {
            Self::Whole(_, Some(state)) => {
                state.lead(&target, &robot, bounds, Some(workspace))?;
                state.lead_base(velocity_body)
            }
            Self::Arm(_, Some(state)) => state.lead(&target, &robot, bounds, Some(workspace)),
            Self::Base(_, state) => state.lead(velocity_body),
            Self::Whole(_, None) | Self::Arm(_, None) => Ok(()),
        }
    }

    /// Refuses a target that leads two parts of the robot too near to each other; without a guard it takes each.
    fn keeps_apart(
        &self,
        request: &Request,
        robot: &RobotState<JOINTS>,
        targets: &Targets,
    ) -> Result<(), TargetRefusal> {
        let least_m = match self {
            Self::Whole(controller, _) => controller.smallest_distance(),
            Self::Arm(controller, _) => controller.smallest_distance(),
            Self::Base(..) => None,
        };
        let Some(least_m) = least_m else { return Ok(()) };
        let robot = robot.resized();
        let keeps = |order: Order| {
            let nearest = arm_target(&order).and_then(|target| match self {
                Self::Whole(controller, _) => controller.too_near_at(&target, &robot),
                Self::Arm(controller, _) => controller.too_near_at(&target, &robot),
                Self::Base(..) => None,
            });
            nearest.map_or(Ok(()), |nearest| {
                Err(TargetRefusal::TooNear { parts: nearest.parts, distance_m: nearest.distance, least_m })
            })
        };
        targets.led_through(request).into_iter().flatten().try_for_each(|target| keeps(Order::To(target)))
    }

    fn carry_target(&mut self, velocity_world_m_s: [f64; 2], dt_s: f64) -> Result<(), ControlError> {
        match self {
            Self::Whole(_, Some(state)) => state.carry_target(velocity_world_m_s, dt_s),
            Self::Whole(_, None) | Self::Arm(..) | Self::Base(..) => Ok(()),
        }
    }

    fn step(
        &mut self,
        robot: &RobotState<JOINTS>,
        input: &LawInput<'_>,
    ) -> Result<ControlOutput<JOINTS>, Fault> {
        let &LawInput { law, taxel_force_n, guard, dt_s } = input;
        match self {
            Self::Whole(controller, state) => {
                let input = ControlInput {
                    robot: robot.resized(),
                    taxel_force_n: *taxel_force_n,
                    flange_wrench_world: None,
                    guard: *guard,
                    dt_s,
                };
                let state = entered(state, || controller.enter(law, &input.robot))?;
                match &controller.step(law, state, &input) {
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
            Self::Base(controller, state) => {
                let yaw_world_rad = robot.base_pose_world[2];
                let input = BaseInput { yaw_world_rad, taxel_force_n: *taxel_force_n, guard: *guard, dt_s };
                match law {
                    ControlLaw::Hold => controller.hold(state, &input),
                    ControlLaw::Impedance | ControlLaw::FollowMe => controller.step(state, &input),
                }
                .map_err(|_| Fault::ControlRefused)
                .map(|output| ControlOutput {
                    command: RobotCommand {
                        base_velocity_body: output.velocity_body,
                        ..WITHOUT_PARTS.command
                    },
                    cover_wrench_base: output.cover_wrench_base,
                    limits: output.limits,
                    ..WITHOUT_PARTS
                })
            }
            Self::Arm(controller, state) => {
                let input = ArmInput { robot: robot.resized(), flange_wrench_world: None, dt_s };
                let state = entered(state, || controller.enter(&input.robot))?;
                match law {
                    ControlLaw::Hold => controller.hold(state, &input),
                    ControlLaw::Impedance | ControlLaw::FollowMe => controller.step(state, &input),
                }
                .map_err(|_| Fault::ControlRefused)
                .map(|output| ControlOutput {
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
        }
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

fn replace<C>(controller: &mut C, next: Result<C, ParameterError>) -> Outcome {
    *controller = next.map_err(|_| Refusal::Conflict)?;
    Ok(())
}

/// The order that carries a controller's output, or the brake when there is none.
pub fn actuation(output: Option<&ControlOutput<JOINTS>>) -> Actuation<JOINTS> {
    output.map_or(Actuation::Brake, |output| Actuation::Drive(output.command))
}
