//! From mode and forces to a command: which law runs in which mode.

use crate::barrier::{Barrier, BaseMotion, to_world};
use crate::base_watch::BaseWatch;
use crate::compensation::Compensation;
use crate::config::live::changed;
use crate::config::{Config, RecentrePolicy};
use crate::controller::{self, Controller, LawInput};
use crate::cover::CoverState;
use crate::flange_sensor::{FlangeReading, FlangeWrench};
use crate::foam_recovery::FoamRecovery;
use crate::loop_state::{Beyond, MotionState, OtherRobot};
use crate::plant::SourceAge;
use crate::protection::{Protected, Protection};
use crate::recentre::Recentre;
use crate::robot::{JOINTS, Parts, PlantKind, TAXELS};
use crate::supervisor::{Touch, Zero};
use crate::targets::Targets;
use crate::uncalibrated::PushCap;
use crate::uncovered::Uncovered;
use moca_msgs::request::ARMING_POSTURE_RAD;
use moca_msgs::robot::LinkInertial;
use moca_msgs::{
    Actuation, ContactRow, Fault, GripperState, Mode, Outcome, ParameterError, ParameterValues, Parameters,
    Payload, PostureOffset, Request, RobotState, TargetState, TaxelStatus,
};
use moca_wbc::nalgebra::Matrix3;
use moca_wbc::rotation;
use moca_wbc::{ControlError, ControlLaw, ControlOutput, Exceeded};

/// The controller with its parameters and what protects people from it.
pub struct Motion {
    controller: Box<dyn Controller>,
    joints: usize,
    taxels: usize,
    parameters: Parameters<JOINTS>,
    protection: Protection,
    /// Apart, because it is large and off by default.
    barrier: Option<Box<Barrier>>,
    /// Cap of the push where the cover is not calibrated.
    push_cap: Option<PushCap>,
    /// Watch on the base, where its stopping distance is believed. Apart likewise.
    base_watch: Option<Box<BaseWatch>>,
    /// Guard of the base's sides without a taxel.
    uncovered: Option<Uncovered>,
    targets: Targets,
    recentre: Recentre,
    /// Remains of past forces in the foam; `None` for the laws as published.
    recovery: Option<FoamRecovery>,
    /// Compensation of loads that the arm's model does not know, if it is on.
    compensation: Option<Box<Compensation>>,
    /// Sensor at the flange, if there is one.
    flange: Option<Flange>,
    /// Object in the hand; `None` for none.
    object: Option<LinkInertial>,
    parts: Parts,
    /// Motion of the base in the present tick.
    base: BaseMotion,
    /// Protection of the present tick.
    protected: Protected,
    /// A target moves with a twist.
    twisted: bool,
    real: bool,
    deadlines: SourceAge,
}

/// Sensor at the flange and the axes of the flange in those of the tool.
struct Flange {
    wrench: FlangeWrench,
    tool_from_flange: Matrix3<f64>,
}

impl Motion {
    /// Not yet entered: the first command starts from the measured state.
    ///
    /// # Errors
    /// The first parameter or number of the geometry out of range.
    pub fn new(config: &Config, protection: Protection) -> Result<Self, ParameterError> {
        let (parameters, parts) = (config.parameters(), config.plant.parts);
        let (joints, taxels) = (config.arm().joints, config.robot.cover.count());
        let controller = controller::of(config, &parameters)?;
        let barrier = controller.barrier(config)?.map(Box::new);
        let push_cap = PushCap::new(config)?;
        let base_watch = BaseWatch::new(config).map(Box::new);
        let uncovered = parts.has_cover().then(|| Uncovered::new(config));
        let protected = Protected::default();
        let targets = Targets::new(config);
        let place = controller.posture_place(&parameters);
        let recentre = Recentre::new(config, place);
        let recovery = (config.control.recentre == RecentrePolicy::OnRequest).then(FoamRecovery::default);
        let compensation = Compensation::new(config, &parameters).map(Box::new);
        let [.., roll, pitch, yaw] = config.robot.payload().tool_origin;
        let tool_from_flange = rotation::from_rpy([roll, pitch, yaw]).transpose();
        let flange = FlangeWrench::new(config).map(|wrench| Flange { wrench, tool_from_flange });
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
            flange,
            object: None,
            parts,
            base: BaseMotion::default(),
            protected,
            twisted: false,
            real,
            deadlines,
        })
    }

    /// Returns true if the wrench at the flange is a sensor's.
    pub const fn has_flange_sensor(&self) -> bool {
        self.flange.is_some()
    }

    /// Puts the external wrench from a reading of the flange sensor, `dt_s` after the last one, into a measured state. Without a
    /// sensor the state stays; without a state a tare is interrupted.
    ///
    /// # Errors
    /// As for [`FlangeWrench::feel`]; the state is then without a wrench.
    pub fn feel_flange(
        &mut self,
        reading: Option<FlangeReading>,
        robot: Option<&mut RobotState<JOINTS>>,
        dt_s: f64,
    ) -> Result<(), Fault> {
        let Some(Flange { wrench, tool_from_flange }) = &mut self.flange else { return Ok(()) };
        let Some(robot) = robot else {
            wrench.interrupt_tare();
            return Ok(());
        };
        robot.flange_wrench_world = None;
        let Some(tool_axes) = self.controller.tool_axes_world(robot) else { return Ok(()) };
        robot.flange_wrench_world = wrench.feel(reading, robot, &(tool_axes * *tool_from_flange), dt_s)?;
        Ok(())
    }

    /// Carries what the gripper holds, a point mass between the fingertips, from the next command on. No gripper holds nothing.
    pub fn carry(&mut self, gripper: Option<&GripperState>) {
        let held = gripper.filter(|gripper| gripper.object_kg > 0.0);
        let object = held.map(|gripper| LinkInertial::point(gripper.object_kg, gripper.object_flange_m));
        if object != self.object {
            // A driver's report of what is no body changes nothing.
            let _ = self.take_object(object);
        }
    }

    fn take_object(&mut self, object: Option<LinkInertial>) -> Result<(), ParameterError> {
        let body = object.unwrap_or(Payload::NONE.inertial);
        self.controller.carry(&body)?;
        if let Some(flange) = &mut self.flange {
            flange.wrench.carry(&body);
        }
        self.object = object;
        Ok(())
    }

    /// Begins a tare of the flange sensor.
    pub fn tare_flange(&mut self) {
        if let Some(flange) = &mut self.flange {
            flange.wrench.start_tare();
        }
    }

    /// State of the flange sensor's zero, with the fault that stands for a missing one; valid without a sensor.
    pub fn flange_zero(&self) -> (Zero, Fault) {
        self.flange.as_ref().map_or((Zero::Valid, Fault::ZeroInvalid), |flange| flange.wrench.zero())
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
        let mut touched = false;
        if self.parts.has_cover() {
            let limits = &self.parameters.limits;
            self.protection.set_late(self.base_watch.as_deref().map_or(0.0, BaseWatch::late_s));
            touched = self.protection.update(now_ns, cover, limits, mode.moves(), &mut self.protected);
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
            uncovered.feel(cover, touched);
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

    /// Takes in the state of this tick; once a tick, before [`Motion::command`].
    pub fn see(&mut self, robot: &RobotState<JOINTS>) {
        self.base = BaseMotion::of(robot);
    }

    /// Speed of the fastest point of the cover at the base's measured velocity, m/s; 0 without a cover.
    pub fn cover_speed_m_s(&self) -> f64 {
        if self.parts.has_cover() { self.protection.cover_speed_m_s(&self.base.velocity_body) } else { 0.0 }
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
        self.controller.set_parameters(&wanted)?;
        self.take_parameters(&wanted);
        Ok(())
    }

    /// Returns its memory.
    pub fn state(&self) -> MotionState {
        MotionState {
            controller: self.controller.memory(),
            parameters: self.parameters,
            protection: self.protection.state().clone(),
            barrier: self.barrier.as_deref().map(Barrier::state),
            push_cap: self.push_cap.as_ref().map(PushCap::state),
            base_watch: self.base_watch.as_deref().map(BaseWatch::state),
            uncovered: self.uncovered.as_ref().map(Uncovered::state),
            targets: self.targets.state().clone(),
            recentre: self.recentre.state(),
            recovery: self.recovery,
            compensation: self.compensation.as_deref().map(Compensation::state),
            beyond: Beyond {
                flange: self.flange.as_ref().map(|flange| flange.wrench.state()),
                object: self.object,
                doubtful_way: self.barrier.as_deref().and_then(Barrier::doubtful_way),
            },
        }
    }

    /// Goes on from where `state` was taken.
    ///
    /// # Errors
    /// It is of another robot than the configuration's.
    pub fn restore(&mut self, state: &MotionState) -> Result<(), OtherRobot> {
        let mut parameters = state.parameters;
        parameters.limits.period_s = self.parameters.limits.period_s;
        self.controller.set_parameters(&parameters).map_err(|_| OtherRobot)?;
        self.take_object(state.beyond.object).map_err(|_| OtherRobot)?;
        self.controller.restore(&state.controller)?;
        self.take_parameters(&parameters);
        self.protection.restore(&state.protection);
        let doubtful_way = state.beyond.doubtful_way.as_ref();
        restored(self.barrier.as_deref_mut(), state.barrier.as_ref(), |barrier, state| {
            barrier.restore(state, doubtful_way);
        })?;
        restored(self.push_cap.as_mut(), state.push_cap.as_ref(), PushCap::restore)?;
        restored(self.base_watch.as_deref_mut(), state.base_watch.as_ref(), BaseWatch::restore)?;
        restored(self.uncovered.as_mut(), state.uncovered.as_ref(), Uncovered::restore)?;
        self.targets.restore(&state.targets);
        self.recentre.restore(&state.recentre);
        self.recovery = state.recovery;
        restored(self.compensation.as_deref_mut(), state.compensation.as_ref(), Compensation::restore)?;
        let flange = self.flange.as_mut().map(|flange| &mut flange.wrench);
        restored(flange, state.beyond.flange.as_ref(), FlangeWrench::restore)?;
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
        self.controller.leave();
    }

    /// Moves the target of the running law with `twist` \[m/s; rad/s\], axes of the law's reference, until told
    /// otherwise. A law that has not been entered yet has no target to move.
    ///
    /// # Errors
    /// A value that is not finite.
    pub fn set_target_twist(&mut self, twist: [f64; 6]) -> Result<(), ControlError> {
        self.controller.set_target_twist(twist)?;
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
        self.controller.keeps_apart(request, robot, &self.targets)?;
        self.targets.take(now_ns, request, law, &self.parameters.limits.base_velocity, robot, touch)
    }

    fn take_parameters(&mut self, wanted: &Parameters<JOINTS>) {
        self.parameters = *wanted;
        self.recentre.set_place(self.controller.posture_place(wanted));
    }

    /// Answers a request to drive the base back under the arm.
    ///
    /// # Errors
    /// See [`Recentre::request`].
    pub fn recentre(&mut self, touch: Option<Touch>) -> Outcome {
        self.recentre.request(touch)
    }

    /// Displacement of the base from where the arm's posture wants it.
    pub fn posture_offset(&self) -> Option<PostureOffset> {
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
        let reached = self.controller.has_reached();
        let Some(order) = self.targets.advance(now_ns, touched, reached) else { return Ok(()) };
        self.controller.lead(&order, robot, self.targets.workspace())
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
        let touched = Touch::is_in(&taxel_force_n[..self.taxels]);
        self.lead(now_ns, law, robot, touched).map_err(|_| Fault::ControlRefused)?;
        let (guard, deceleration) = (&mut self.protected.guard, self.parameters.limits.base_acceleration);
        if let Some(uncovered) = &mut self.uncovered {
            uncovered.advance(self.base.velocity_body, dt_s);
            guard.bounds_body = uncovered.bounds_body(deceleration);
            // room is for whom the barrier detects
            guard.room_body = self.barrier.as_ref().and_then(|_| uncovered.room_body(deceleration));
        }
        self.recentre.bound(guard, &self.parameters, (law, self.targets.leads()), dt_s);
        let contacts;
        if let Some(barrier) = &mut self.barrier {
            contacts = barrier
                .update(self.base.velocity_body, deceleration, law == ControlLaw::Impedance, dt_s)
                .map_err(|_| Fault::ControlRefused)?;
            if law != ControlLaw::Hold {
                taxel_force_n = &contacts.force_n;
            }
            if law == ControlLaw::Impedance {
                let velocity_m_s = to_world(contacts.carried_body_m_s, robot);
                self.controller.carry_target(velocity_m_s, dt_s).map_err(|_| Fault::ControlRefused)?;
            }
            // who is pressed when a taxel fails is given room even in a stop
            if law != ControlLaw::Hold || contacts.backs_off {
                guard.outward_m_s = Some(contacts.outward_m_s);
                guard.one_body = contacts.one_body;
            }
        }
        if let Some(cap) = &mut self.push_cap {
            let led = self.targets.leads() || self.twisted;
            cap.advance(self.base.velocity_body, deceleration, led, dt_s, &mut guard.blocked);
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
        // given on as it comes: it is large
        let Some(compensation) = &mut self.compensation else { return self.controller.step(robot, &input) };
        let mut output = self.controller.step(robot, &input)?;
        // a robot that says what pushes its flange lets the observer rest
        let observed = robot.flange_wrench_world.is_none();
        let external_nm = self.controller.external_torque_nm();
        let external_nm = external_nm.as_ref().filter(|_| observed);
        compensation.apply(law, external_nm, &robot.dq_rad_s, dt_s, &mut output.command.arm_torque_nm);
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
            self.recentre.remember(law, (robot.base_pose_world, self.base.turn), output, dt_s);
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

/// The order that carries a controller's output, or the brake when there is none.
pub fn actuation(output: Option<&ControlOutput<JOINTS>>) -> Actuation<JOINTS> {
    output.map_or(Actuation::Brake, |output| Actuation::Drive(output.command))
}
