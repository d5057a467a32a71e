//! The loop: one tick of the robot, from state and bytes to a command.

use crate::control::cover::{CoverSource, CoverState};
use crate::control::law::{self, Motion, QpTally};
use crate::control::loop_state::{LoopState, OtherRobot};
use crate::control::plant::{Plant, SourceAge};
use crate::control::protection::Protected;
use crate::control::stage::{Stage, StageTimer};
use crate::control::state_check::{Checked, StateCheck};
use crate::control::supervisor::{Facts, Supervisor, Touch};
use crate::control::tick_input::{Slot, TickInput};
use crate::robot::JOINTS;
use heapless::Vec;
use moca_msgs::{
    Actuation, ArmLink, Fault, Link, Mode, Outcome, Refusal, Request, RobotCommand, RobotState, Sample,
};
use moca_wbc::{ControlError, ControlOutput};

/// The parts of a running robot, and nothing that knows how the tick is timed or who watches.
pub struct ControlLoop<P, S> {
    /// The robot.
    pub plant: P,
    /// Its cover.
    pub cover: S,
    state_check: StateCheck,
    supervisor: Supervisor,
    motion: Motion,
    period_s: f64,
    /// A real arm is on its own controller; torque control begins with [`Mode::Ready`].
    arm_released: bool,
    /// Of the present tick.
    protected: Protected,
    /// Why the robot stands, and the board whose fault that is.
    blamed: (Option<Fault>, Option<u8>),
}

/// What one tick leaves behind.
#[derive(Clone, Debug)]
pub struct Ticked {
    /// What a client may see.
    pub sample: Sample,
    /// The answer to the request, if there was one.
    pub outcome: Option<Outcome>,
    /// What a replay needs of it.
    pub input: TickInput,
}

impl<P: Plant, S: CoverSource> ControlLoop<P, S> {
    /// A loop that has not ticked yet.
    pub fn new(plant: P, cover: S, supervisor: Supervisor, motion: Motion, period_s: f64) -> Self {
        let (state_check, protected) = (StateCheck::default(), Protected::default());
        let (arm_released, blamed) = (motion.is_of_a_real_robot(), (None, None));
        Self { plant, cover, state_check, supervisor, motion, period_s, arm_released, protected, blamed }
    }

    /// One tick: read, decide, command, write; `timer` hears of each stage's end.
    pub fn tick(&mut self, slot: &Slot, request: Option<Request>, timer: &mut impl StageTimer) -> Ticked {
        // The bits of a measurement beyond single precision are noise that would fill a log. They are dropped before anything
        // is computed from them, so that a replay does not miss them.
        let exact = self.plant.is_exact();
        let measured = self.plant.read().map(|state| if exact { state } else { state.in_single_precision() });
        let (age, link) = (self.plant.age(), self.plant.link());
        let (deadlines, elapsed_s) = (self.motion.deadlines(), self.elapsed_s(slot));
        let robot = match measured {
            Ok(state) => self.state_check.check(state, age, deadlines, elapsed_s),
            Err(fault) => Checked::none(fault),
        };
        timer.end(Stage::Read);

        let cover = self.cover.read(slot.now_ns);
        timer.end(Stage::Cover);

        let (outcome, output) = self.decide(slot, &robot, &cover, request);
        let actuation = self.actuation(&robot, output.as_ref());
        timer.end(Stage::Control);

        let refused = self.plant.write(&actuation, slot.ticks).err();
        if let Some(fault) = refused {
            self.supervisor.stop_for(fault);
        }
        timer.end(Stage::Write);

        self.blame(&cover);
        Ticked {
            sample: self.sample(slot, (robot.state.as_ref(), age, link), &cover, &actuation, output.as_ref()),
            outcome,
            input: TickInput {
                slot: *slot,
                state: measured,
                age,
                link,
                request,
                outcome,
                refused,
                cover_events: cover.events,
            },
        }
    }

    /// What the loop remembers between this tick and the next: a copy, for which nothing is allocated.
    pub fn state(&self) -> LoopState {
        let Self { plant: _, cover, state_check, supervisor, motion, arm_released, blamed, .. } = self;
        let (state_check, supervisor, blamed) = (*state_check, *supervisor, *blamed);
        let (arm_released, motion, cover) = (*arm_released, motion.state(), cover.state());
        LoopState { state_check, supervisor, arm_released, blamed, motion, cover }
    }

    /// Goes on from where `state` was taken.
    ///
    /// # Errors
    /// It is of another robot than the configuration's.
    pub fn restore(&mut self, state: &LoopState) -> Result<(), OtherRobot> {
        self.motion.restore(&state.motion)?;
        (self.state_check, self.supervisor, self.blamed) =
            (state.state_check, state.supervisor, state.blamed);
        self.arm_released = state.arm_released;
        self.cover.restore(&state.cover);
        Ok(())
    }

    /// See [`Motion::set_target_twist`].
    ///
    /// # Errors
    /// A value that is not finite.
    pub fn set_target_twist(&mut self, twist: [f64; 6]) -> Result<(), ControlError> {
        self.motion.set_target_twist(twist)
    }

    /// See [`Motion::keep_limits_by_qp`].
    #[cfg(feature = "qp")]
    pub fn keep_limits_by_qp(&mut self) {
        self.motion.keep_limits_by_qp();
    }

    /// See [`Motion::by_qp`].
    pub const fn by_qp(&self) -> Option<QpTally> {
        self.motion.by_qp()
    }

    /// The last order of a run: nobody commands the robot from here on.
    pub fn brake(&mut self) {
        // Whether it still listens or not, there is nothing left to do about it.
        let _ = self.plant.write(&Actuation::Brake, 1);
    }

    fn elapsed_s(&self, slot: &Slot) -> f64 {
        #[expect(clippy::cast_precision_loss, reason = "a count of missed slots")]
        let ticks = slot.ticks as f64;
        self.period_s * ticks
    }

    /// Remembers whose fault a stop is for as long as it lasts: the board may be well again by then.
    fn blame(&mut self, cover: &CoverState) {
        let cause = self.supervisor.cause();
        if cause != self.blamed.0 {
            self.blamed = (cause, cover.fault_board.filter(|_| cause.is_some() && cause == cover.fault));
        }
    }

    /// The mode, the answer to `request`, and the law's output; no output is the brake.
    fn decide(
        &mut self,
        slot: &Slot,
        robot: &Checked,
        cover: &CoverState,
        request: Option<Request>,
    ) -> (Option<Outcome>, Option<ControlOutput<JOINTS>>) {
        let facts = Facts {
            cover_seen: cover.frames_good > 0 || !self.motion.parts().has_cover(),
            cover_fault: cover.fault,
            zero: cover.zero,
            plant_fault: robot.fault,
            far_joint: robot.state.as_ref().and_then(|state| self.motion.far_joint(state)),
            touch: cover.forces.ok().and_then(|forces_n| Touch::strongest(&forces_n)),
        };
        let decision = self.supervisor.step(&facts, request);
        if decision.start_tare {
            self.cover.start_tare(slot.now_ns);
        }
        let outcome = decision
            .carry_out
            .map(|request| self.carry_out(request, slot.now_ns, decision.mode, robot, facts.touch))
            .or(decision.outcome);
        match self.command(slot, robot, cover, decision.mode) {
            Ok(output) => (outcome, output),
            Err(fault) => {
                self.supervisor.stop_for(fault);
                (outcome, None)
            }
        }
    }

    /// What the supervisor permits and a part of the robot has to do.
    fn carry_out(
        &mut self,
        request: Request,
        now_ns: u64,
        mode: Mode,
        robot: &Checked,
        touch: Option<Touch>,
    ) -> Outcome {
        match request {
            Request::Target(_) | Request::Waypoint { .. } | Request::EndTarget => match &robot.state {
                Some(robot) => self.motion.take_target(now_ns, &request, mode, robot, touch),
                None => Err(Refusal::Mode(mode)),
            },
            Request::PressTaxel { taxel, force_n } => {
                let world = self.plant.simulated().ok_or(Refusal::NotSimulated)?;
                world.press(usize::from(taxel), force_n)
            }
            Request::Resume => self.plant.recover(),
            Request::MaskTaxel { taxel, masked } => self.cover.mask(usize::from(taxel), masked),
            Request::SetParameter { parameter, values } => {
                self.motion.set_parameter(usize::from(parameter), &values)
            }
            _ => Err(Refusal::Mode(self.supervisor.mode())),
        }
    }

    fn command(
        &mut self,
        slot: &Slot,
        robot: &Checked,
        cover: &CoverState,
        mode: Mode,
    ) -> Result<Option<ControlOutput<JOINTS>>, Fault> {
        self.protected = self.motion.protect(slot.now_ns, cover, mode);
        self.release_arm(robot, mode);
        let (Some(robot), false) = (&robot.state, mode == Mode::Fault) else {
            // Whatever runs next starts from where the robot then is.
            self.motion.leave();
            return Ok(None);
        };
        let (output, stop) =
            self.motion.command(slot.now_ns, mode, robot, &cover.forces, self.elapsed_s(slot))?;
        if let Some(fault) = stop {
            self.supervisor.stop_for(fault);
        }
        Ok(Some(output))
    }

    /// Whether a real arm is left to its own controller in this tick. It is until the robot is ready for the first time, and
    /// after a stop in which it could not be driven until somebody resumes: nothing else gives it torques again.
    fn release_arm(&mut self, robot: &Checked, mode: Mode) {
        let released = match mode {
            Mode::Ready | Mode::Impedance | Mode::FollowMe => false,
            Mode::Starting | Mode::Fault => true,
            Mode::Taring | Mode::ProtectiveStop => self.arm_released || robot.state.is_none(),
        };
        self.arm_released = released && self.motion.is_of_a_real_robot();
        if self.arm_released {
            self.motion.leave();
        }
    }

    /// The order to each part. A base whose state is old stands, whatever the arm does.
    fn actuation(&self, robot: &Checked, output: Option<&ControlOutput<JOINTS>>) -> Actuation<JOINTS> {
        match law::actuation(output) {
            Actuation::Drive(_) if self.arm_released => Actuation::Brake,
            Actuation::Drive(command) if robot.fault.is_some() => {
                Actuation::Drive(RobotCommand { base_velocity_body: [0.0; 3], ..command })
            }
            actuation => actuation,
        }
    }

    #[expect(
        clippy::field_reassign_with_default,
        reason = "a sample is large with its lists: put together elsewhere it would be copied"
    )]
    fn sample(
        &self,
        slot: &Slot,
        (robot, age, link): (Option<&RobotState<JOINTS>>, SourceAge, Option<ArmLink>),
        cover: &CoverState,
        actuation: &Actuation<JOINTS>,
        output: Option<&ControlOutput<JOINTS>>,
    ) -> Sample {
        let age_s = cover.reading.age_s(slot.now_ns);
        let mut sample = Sample::default();
        sample.tick = slot.tick;
        sample.time_ns = slot.now_ns;
        sample.mode = self.supervisor.mode();
        (sample.fault, sample.fault_board) = self.blamed;
        sample.law = Some(self.supervisor.law());
        sample.frame_age_s = age_s.unwrap_or(-1.0);
        sample.frame_rate_hz = cover.rate_hz;
        (sample.frames_good, sample.frames_bad) = (cover.frames_good, cover.frames_bad);
        sample.board = cover.board;
        sample.lateness_s = slot.lateness_s;
        sample.overruns = slot.overruns;
        sample.stages_ns = slot.stages_ns;
        sample.speed_limit = self.protected.speed_limit;
        sample.contact_reaction = self.protected.reaction;
        fill(&mut sample.contact_events, &self.protected.events);
        fill(&mut sample.contact_rows, self.motion.contact_rows());
        sample.target = self.motion.target();
        sample.link = link.map(|arm| Link { arm_age_s: age.arm_s, base_age_s: age.base_s, arm });
        let (parts, joints) = (self.motion.parts(), ..self.motion.joints());
        if parts.has_cover() {
            let taxels = ..self.motion.taxels();
            fill(&mut sample.taxels, &cover.reading.taxels[taxels]);
            fill(&mut sample.counts, &cover.counts[taxels]);
        }
        if let Some(robot) = robot {
            sample.base_pose_world = robot.base_pose_world;
            sample.base_velocity_world = robot.base_velocity_world;
            sample.cover_speed_m_s = self.motion.cover_speed_m_s(robot);
            sample.uncovered_way_m = self.motion.uncovered_way_m();
        }
        if let Some(robot) = robot.filter(|_| parts.has_arm()) {
            fill(&mut sample.q_rad, &robot.q_rad[joints]);
            fill(&mut sample.dq_rad_s, &robot.dq_rad_s[joints]);
        }
        if let Actuation::Drive(command) = actuation {
            sample.base_velocity_command_body = command.base_velocity_body;
            if parts.has_arm() {
                fill(&mut sample.arm_torque_nm, &command.arm_torque_nm[joints]);
            }
        }
        if let Some(output) = output {
            sample.cover_wrench_base = output.cover_wrench_base;
        }
        if let Some(output) = output.filter(|_| parts.has_arm()) {
            sample.flange_wrench_world = output.flange_wrench_world;
            sample.flange_position_world = output.flange.position_world;
            sample.flange_quaternion_world = output.flange.quaternion_world;
            sample.flange_desired_position_world = output.flange_desired.position_world;
            sample.flange_desired_quaternion_world = output.flange_desired.quaternion_world;
        }
        sample
    }
}

fn fill<T: Clone, const N: usize>(list: &mut Vec<T, N>, values: &[T]) {
    // The capacities of a sample exceed this robot's numbers of joints and taxels.
    let _ = list.extend_from_slice(&values[..values.len().min(N)]);
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::Config;
    use crate::control::plant::SourceAge;
    use crate::control::stage::Untimed;
    use crate::control::supervisor::Zero;
    use crate::runtime::assemble::{motion, supervisor};
    use moca_msgs::TaxelStatus;

    /// Stands still; remembers the last order and refuses it if told to.
    struct Standing {
        brakes: bool,
        refuses: bool,
    }

    impl Plant for Standing {
        fn read(&mut self) -> Result<RobotState<JOINTS>, Fault> {
            Ok(RobotState::at_rest(Config::default().control.gains.posture_rad))
        }

        fn age(&self) -> SourceAge {
            SourceAge::default()
        }

        fn write(&mut self, actuation: &Actuation<JOINTS>, _ticks: u64) -> Result<(), Fault> {
            self.brakes = matches!(actuation, Actuation::Brake);
            if self.refuses { Err(Fault::ControlRefused) } else { Ok(()) }
        }
    }

    struct Scripted(CoverState);

    impl CoverSource for Scripted {
        fn read(&mut self, _now_ns: u64) -> CoverState {
            self.0
        }

        fn start_tare(&mut self, _now_ns: u64) {
            self.0.zero = Zero::Taring;
        }
    }

    fn armed() -> ControlLoop<Standing, Scripted> {
        let config = Config::default();
        let cover = Scripted(CoverState { frames_good: 1, zero: Zero::Invalid, ..CoverState::NONE });
        let plant = Standing { brakes: false, refuses: false };
        let mut control = ControlLoop::new(plant, cover, supervisor(&config), motion(&config).unwrap(), 1e-3);
        step(&mut control, 0);
        control.cover.0.zero = Zero::Valid;
        assert_eq!(step(&mut control, 1).mode, Mode::Impedance);
        control
    }

    fn step(control: &mut ControlLoop<Standing, Scripted>, tick: u64) -> Sample {
        let slot = Slot { tick, now_ns: tick * 1_000_000, ticks: 1, ..Slot::default() };
        control.tick(&slot, None, &mut Untimed).sample
    }

    #[test]
    fn what_the_controller_refuses_stops_the_robot_in_the_same_tick() {
        let mut control = armed();
        assert!(!control.plant.brakes);
        control.cover.0.forces = Err((3, TaxelStatus::Saturated));
        let sample = step(&mut control, 2);
        assert!(control.plant.brakes);
        let fault = Fault::TaxelInvalid { taxel: 3, status: TaxelStatus::Saturated };
        assert_eq!((sample.mode, sample.fault), (Mode::ProtectiveStop, Some(fault)));
    }

    /// With a barrier the person who presses a taxel that fails is given room before the robot stands; the plant of this
    /// test never moves, so that only the time ends it.
    #[test]
    fn a_stop_for_a_touched_taxel_makes_room_first() {
        let mut config = Config::default();
        config.set("protection.contact_barrier", &"pu-ld30".into()).unwrap();
        let cover = Scripted(CoverState { frames_good: 1, zero: Zero::Invalid, ..CoverState::NONE });
        let plant = Standing { brakes: false, refuses: false };
        let mut control = ControlLoop::new(plant, cover, supervisor(&config), motion(&config).unwrap(), 1e-3);
        step(&mut control, 0);
        control.cover.0.zero = Zero::Valid;
        let feel = |control: &mut ControlLoop<Standing, Scripted>, tick: u64, force_n: f64| {
            control.cover.0.reading.sampled_at_ns = Some(tick * 1_000_000);
            control.cover.0.reading.taxels[5].force_n = force_n;
            step(control, tick)
        };
        for tick in 1..100 {
            assert_eq!(feel(&mut control, tick, if tick < 50 { 0.0 } else { 10.0 }).mode, Mode::Impedance);
        }
        let status = TaxelStatus::Saturated;
        let fault = Fault::TaxelInvalid { taxel: 5, status };
        control.cover.0.reading.taxels[5].status = status;
        control.cover.0.forces = Err((5, status));
        control.cover.0.fault = Some(fault);
        let backwards: std::vec::Vec<f64> = (100..2100)
            .map(|tick| {
                let sample = feel(&mut control, tick, 0.0);
                assert_eq!((sample.mode, sample.fault), (Mode::ProtectiveStop, Some(fault)));
                sample.base_velocity_command_body[0]
            })
            .collect();
        assert!(backwards[200] < -0.2 && backwards.iter().all(|v| *v <= 0.0 && *v >= -0.3 - 1e-9));
        assert!(backwards[1000..].iter().all(|v| v.abs() < 1e-12), "and stands");
    }

    #[test]
    fn what_the_plant_refuses_is_in_the_sample_of_that_tick() {
        let mut control = armed();
        control.plant.refuses = true;
        let sample = step(&mut control, 2);
        assert_eq!(sample.fault, Some(Fault::ControlRefused));
        assert!(!sample.mode.moves());
        step(&mut control, 3);
        assert!(control.plant.brakes);
    }
}
