//! The loop: one tick of the robot, from state and bytes to a command.

use crate::cover::{CoverSource, CoverState};
use crate::flange_sensor::{FlangeReading, FlangeSensor};
use crate::law::{self, Motion};
use crate::loop_state::{LoopState, OtherRobot};
use crate::plant::{Plant, SourceAge};
use crate::robot::JOINTS;
use crate::stage::{Stage, StageTimer};
use crate::state_check::{Checked, StateCheck};
use crate::supervisor::{Facts, Supervisor, Touch, Zero};
use crate::tick_input::{Slot, TickInput};
use heapless::Vec;
use moca_msgs::{
    Actuation, ArmLink, Fault, Link, Mode, Outcome, Refusal, Request, RobotCommand, RobotState, Sample,
};
use moca_wbc::{ControlError, ControlOutput, FlangePose};

/// The parts of a running robot, and nothing that knows how the tick is timed or who watches.
pub struct ControlLoop<P, S> {
    /// The robot.
    pub plant: P,
    /// Its cover.
    pub cover: S,
    /// Somebody reads all that a tick leaves behind. Else it writes neither its input nor what the sample says beside the robot's
    /// motion, mode and touch.
    pub watched: bool,
    /// State of the cover in this tick.
    felt: CoverState,
    state_check: StateCheck,
    supervisor: Supervisor,
    motion: Motion,
    period_s: f64,
    /// A real arm is on its own controller; torque control begins with [`Mode::Ready`].
    arm_released: bool,
    /// Why the robot stands, and the board whose fault that is.
    ticked: Ticked,
}

/// Results of one tick.
#[derive(Clone, Debug, Default)]
pub struct Ticked {
    /// Sample for the clients.
    pub sample: Sample,
    /// Input of the tick for a replay, with the answer to the request.
    pub input: TickInput,
}

impl<P: Plant, S: CoverSource> ControlLoop<P, S> {
    /// A loop that has not ticked yet.
    pub fn new(plant: P, cover: S, supervisor: Supervisor, motion: Motion, period_s: f64) -> Self {
        let (state_check, ticked) = (StateCheck::default(), Ticked::default());
        let arm_released = motion.is_of_a_real_robot();
        let felt = CoverState::NONE;
        Self {
            plant,
            cover,
            watched: true,
            felt,
            state_check,
            supervisor,
            motion,
            period_s,
            arm_released,
            ticked,
        }
    }

    /// One tick: read, decide, command, write; `timer` hears of each stage's end. What it leaves behind stays where it is:
    /// it is large.
    pub fn tick(&mut self, slot: &Slot, request: Option<Request>, timer: &mut impl StageTimer) -> &Ticked {
        timer.begin();
        let mut measured = self.measured();
        if self.watched {
            // as it came
            self.ticked.input.state = measured;
        }
        let (age, link) = (self.plant.age(), self.plant.link());
        let (deadlines, elapsed_s) = (self.motion.deadlines(), self.elapsed_s(slot));
        let mut robot = match &mut measured {
            Ok(state) => self.state_check.check(state, age, deadlines, elapsed_s),
            Err(fault) => Checked::none(*fault),
        };
        let flange = self.flange_reading();
        let flange_fault = self.motion.feel_flange(flange, robot.state.as_deref_mut(), elapsed_s).err();
        if let Some(state) = &robot.state {
            self.motion.see(state);
        }
        timer.end(Stage::Read);

        self.cover.read(slot.now_ns, &mut self.felt);
        timer.end(Stage::Cover);

        let (outcome, mode) = self.decide(slot, (&robot, flange_fault), request);
        self.motion.protect(slot.now_ns, &self.felt, mode);
        self.release_arm(&robot, mode);
        let dt_s = self.elapsed_s(slot);
        // large, and nowhere copied
        let output = match robot.state.as_deref().filter(|_| mode != Mode::Fault) {
            Some(state) => self.motion.command(slot.now_ns, mode, state, &self.felt.poll.forces, dt_s),
            None => Err(robot.fault.unwrap_or(Fault::StateInvalid)),
        };
        self.heed(&robot, &output, mode, dt_s);
        let output = output.as_ref().ok();
        let actuation = self.actuation(&robot, output);
        timer.end(Stage::Control);

        let refused = self.plant.write(&actuation, slot.ticks).err();
        if let Some(fault) = refused {
            self.supervisor.stop_for(fault);
        }
        let gripper = self.plant.gripper();
        self.motion.carry(gripper.as_ref());
        timer.end(Stage::Write);

        self.show(robot.state.as_deref(), &actuation, output);
        if !self.watched {
            return &self.ticked;
        }
        self.show_rest(slot, (robot.state.as_deref(), age, link), &actuation);
        self.ticked.sample.gripper = gripper;
        let input = &mut self.ticked.input;
        (input.slot, input.age, input.link, input.flange, input.gripper) =
            (*slot, age, link, flange, gripper);
        (input.request, input.outcome, input.refused) = (request, outcome, refused);
        input.cover_events = self.felt.events;
        &self.ticked
    }

    /// Returns the results of the last tick.
    pub const fn ticked(&self) -> &Ticked {
        &self.ticked
    }

    /// Returns a copy of the loop's memory between this tick and the next, without allocating.
    pub fn state(&self) -> LoopState {
        let Self { plant: _, cover, state_check, supervisor, motion, arm_released, .. } = self;
        let (state_check, supervisor) = (*state_check, *supervisor);
        let (arm_released, motion, cover) = (*arm_released, motion.state(), cover.state());
        LoopState { state_check, supervisor, arm_released, motion, cover }
    }

    /// Goes on from where `state` was taken.
    ///
    /// # Errors
    /// It is of another robot than the configuration's.
    pub fn restore(&mut self, state: &LoopState) -> Result<(), OtherRobot> {
        self.motion.restore(&state.motion)?;
        (self.state_check, self.supervisor) = (state.state_check, state.supervisor);
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

    /// The last order of a run: nobody commands the robot from here on.
    pub fn brake(&mut self) {
        // Whether it still listens or not, there is nothing left to do about it.
        let _ = self.plant.write(&Actuation::Brake, 1);
    }

    /// The bits of a measurement beyond single precision are noise that would fill a log. They are dropped before anything
    /// is computed from them, so that a replay does not miss them.
    fn measured(&mut self) -> Result<RobotState<JOINTS>, Fault> {
        if self.plant.is_exact() {
            return self.plant.read();
        }
        self.plant.read().map(|state| state.in_single_precision())
    }

    /// The newest reading of the flange sensor, rounded as [`Self::measured`] does, where there is one.
    fn flange_reading(&mut self) -> Option<FlangeReading> {
        if !self.motion.has_flange_sensor() {
            return None;
        }
        let exact = self.plant.is_exact();
        let FlangeReading { wrench, age_s } = self.plant.flange_sensor().and_then(FlangeSensor::latest)?;
        #[expect(
            clippy::cast_possible_truncation,
            reason = "to the nearest single; what is too large becomes infinite"
        )]
        let single = |value: f64| if exact { value } else { f64::from(value as f32) };
        Some(FlangeReading { wrench: wrench.map(single), age_s })
    }

    fn elapsed_s(&self, slot: &Slot) -> f64 {
        #[expect(clippy::cast_precision_loss, reason = "a count of missed slots")]
        let ticks = slot.ticks as f64;
        self.period_s * ticks
    }

    /// The answer to `request`, and the mode.
    fn decide(
        &mut self,
        slot: &Slot,
        (robot, flange_fault): (&Checked<'_>, Option<Fault>),
        request: Option<Request>,
    ) -> (Option<Outcome>, Mode) {
        let cover = &self.felt;
        let taxels = ..self.motion.taxels();
        let (flange_zero, no_zero) = self.motion.flange_zero();
        let of_cover = matches!(cover.zero, Zero::Invalid | Zero::Refused);
        let facts = Facts {
            cover_seen: cover.frames_good > 0 || !self.motion.parts().has_cover(),
            cover_fault: cover.poll.fault,
            zero: cover.zero.and(flange_zero),
            zero_fault: if of_cover { Fault::ZeroInvalid } else { no_zero },
            plant_fault: robot.fault.or(flange_fault),
            far_joint: robot.state.as_ref().and_then(|state| self.motion.far_joint(state)),
            touch: cover.poll.forces.as_ref().ok().and_then(|forces_n| Touch::strongest(&forces_n[taxels])),
        };
        let decision = self.supervisor.step(&facts, request);
        if decision.start_tare {
            self.cover.start_tare(slot.now_ns);
            self.motion.tare_flange();
        }
        let outcome = decision
            .carry_out
            .map(|request| self.carry_out(request, slot.now_ns, decision.mode, robot, facts.touch))
            .or(decision.outcome);
        (outcome, decision.mode)
    }

    /// Carries out a permitted request in the part of the robot that it concerns.
    fn carry_out(
        &mut self,
        request: Request,
        now_ns: u64,
        mode: Mode,
        robot: &Checked<'_>,
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
            Request::Recentre => self.motion.recentre(touch),
            Request::Gripper(request) => self.plant.request_gripper(&request),
            Request::MaskTaxel { taxel, masked } => self.cover.mask(usize::from(taxel), masked),
            Request::SetParameter { parameter, values } => {
                self.motion.set_parameter(usize::from(parameter), &values)
            }
            _ => Err(Refusal::Mode(self.supervisor.mode())),
        }
    }

    /// Takes in the law's output in `mode`; without one the robot brakes.
    fn heed(
        &mut self,
        robot: &Checked<'_>,
        output: &Result<ControlOutput<JOINTS>, Fault>,
        mode: Mode,
        dt_s: f64,
    ) {
        let (Some(robot), false) = (&robot.state, mode == Mode::Fault) else {
            // Whatever runs next starts from where the robot then is.
            return self.motion.leave();
        };
        let stop = match output {
            Ok(output) => {
                let late = self.motion.watch_base(robot, dt_s).err();
                self.motion.remember(mode, robot, output, dt_s);
                law::fault_of(output).or(late)
            }
            Err(fault) => Some(*fault),
        };
        if let Some(fault) = stop {
            self.supervisor.stop_for(fault);
        }
    }

    /// Leaves a real arm to its own controller in this tick if needed: until the robot is ready for the first time, and after a stop
    /// in which it could not be driven, until somebody resumes. Nothing else gives it torques again.
    fn release_arm(&mut self, robot: &Checked<'_>, mode: Mode) {
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
    fn actuation(&self, robot: &Checked<'_>, output: Option<&ControlOutput<JOINTS>>) -> Actuation<JOINTS> {
        match law::actuation(output) {
            Actuation::Drive(_) if self.arm_released => Actuation::Brake,
            Actuation::Drive(command) if robot.fault.is_some() => {
                Actuation::Drive(RobotCommand { base_velocity_body: [0.0; 3], ..command })
            }
            actuation => actuation,
        }
    }

    /// Writes the robot's motion, mode and touch into the sample; put together elsewhere it would be copied.
    fn show(
        &mut self,
        robot: Option<&RobotState<JOINTS>>,
        actuation: &Actuation<JOINTS>,
        output: Option<&ControlOutput<JOINTS>>,
    ) {
        let Self { supervisor, motion, felt: cover, ticked: Ticked { sample, .. }, .. } = self;
        sample.mode = supervisor.mode();
        sample.fault = supervisor.cause();

        let (taxels, joints) = (..motion.taxels(), ..motion.joints());
        fill(&mut sample.taxels, &cover.poll.reading.taxels[taxels]);
        sample.frame_rate_hz = cover.rate_hz;
        fill(&mut sample.contact_rows, motion.contact_rows());

        sample.base_pose_world = robot.map_or([0.0; 3], |robot| robot.base_pose_world);
        sample.base_velocity_world = robot.map_or([0.0; 3], |robot| robot.base_velocity_world);
        fill(&mut sample.q_rad, robot.map_or(&[], |robot| &robot.q_rad[joints]));

        let command = command_of(actuation);
        sample.base_velocity_command_body = command.map_or([0.0; 3], |command| command.base_velocity_body);
        sample.cover_wrench_base = output.map_or([0.0; 3], |output| output.cover_wrench_base);

        let arm = output.filter(|_| motion.parts().has_arm());
        sample.flange_wrench_world = arm.map_or([0.0; 6], |output| output.flange_wrench_world);
        let flange = arm.map_or(&NOWHERE, |output| &output.flange);
        sample.flange_position_world = flange.position_world;
        sample.flange_quaternion_world = flange.quaternion_world;
        let desired = arm.map_or(&NOWHERE, |output| &output.flange_desired);
        sample.flange_desired_position_world = desired.position_world;
        sample.flange_desired_quaternion_world = desired.quaternion_world;
    }

    /// Writes every other field of the sample.
    fn show_rest(
        &mut self,
        slot: &Slot,
        (robot, age, link): (Option<&RobotState<JOINTS>>, SourceAge, Option<ArmLink>),
        actuation: &Actuation<JOINTS>,
    ) {
        let Self { supervisor, motion, felt: cover, ticked: Ticked { sample, .. }, .. } = self;
        sample.tick = slot.tick;
        sample.time_ns = slot.now_ns;
        sample.lateness_s = slot.lateness_s;
        sample.overruns = slot.overruns;
        sample.stages_ns = slot.stages_ns;
        sample.law = Some(supervisor.law());
        sample.target = motion.target();
        sample.posture = motion.posture_offset();
        sample.link = link.map(|arm| Link { arm_age_s: age.arm_s, base_age_s: age.base_s, arm });

        let (taxels, joints) = (..motion.taxels(), ..motion.joints());
        fill(&mut sample.counts, &cover.counts[taxels]);
        sample.frame_age_s = cover.poll.reading.age_s(slot.now_ns).unwrap_or(-1.0);
        (sample.frames_good, sample.frames_bad) = (cover.frames_good, cover.frames_bad);
        sample.board = cover.board;

        let protected = motion.protected();
        sample.speed_limit = protected.speed_limit;
        sample.contact_reaction = protected.reaction;
        fill(&mut sample.contact_events, &protected.events);

        sample.cover_speed_m_s = robot.map_or(0.0, |_| motion.cover_speed_m_s());
        sample.uncovered_way_m = robot.map_or(0.0, |_| motion.uncovered_way_m());
        fill(&mut sample.dq_rad_s, robot.map_or(&[], |robot| &robot.dq_rad_s[joints]));
        let command = command_of(actuation);
        fill(&mut sample.arm_torque_nm, command.map_or(&[], |command| &command.arm_torque_nm[joints]));
    }
}

/// Flange of a robot without an arm.
const NOWHERE: FlangePose = FlangePose { position_world: [0.0; 3], quaternion_world: [0.0; 4] };

const fn command_of(actuation: &Actuation<JOINTS>) -> Option<&RobotCommand<JOINTS>> {
    match actuation {
        Actuation::Drive(command) => Some(command),
        Actuation::Brake => None,
    }
}

fn fill<T: Clone, const N: usize>(list: &mut Vec<T, N>, values: &[T]) {
    list.clear();
    // The capacities of a sample exceed this robot's numbers of joints and taxels.
    let _ = list.extend_from_slice(&values[..values.len().min(N)]);
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::assemble::{motion, supervisor};
    use crate::config::Config;
    use crate::plant::SourceAge;
    use crate::robot::FlangeSensorKind;
    use crate::stage::Untimed;
    use moca_msgs::BoardFault;
    use moca_msgs::mode::FlangeTare;
    use moca_msgs::{TaxelReading, TaxelStatus};

    /// Stands still; remembers the last order and refuses it if told to. Its flange sensor, if it has one, trembles by 2^-10 N.
    #[derive(Default)]
    struct Standing {
        brakes: bool,
        refuses: bool,
        lost: bool,
        flange: Option<[f64; 6]>,
        trembled: bool,
        torque_nm: [f64; JOINTS],
    }

    impl FlangeSensor for Standing {
        fn latest(&mut self) -> Option<FlangeReading> {
            self.trembled = !self.trembled;
            let mut wrench = self.flange?;
            wrench[2] += if self.trembled { 2.0_f64.powi(-10) } else { 0.0 };
            Some(FlangeReading { wrench, age_s: 0.0 })
        }
    }

    impl Plant for Standing {
        fn read(&mut self) -> Result<RobotState<JOINTS>, Fault> {
            if self.lost {
                return Err(Fault::PlantLost);
            }
            let state = RobotState::at_rest(Config::default().control.gains.posture_rad);
            let Some(_) = self.flange else { return Ok(state) };
            Ok(RobotState {
                flange_wrench_world: Some([99.0; 6]),
                torque_measured_nm: self.torque_nm,
                ..state
            })
        }

        fn flange_sensor(&mut self) -> Option<&mut dyn FlangeSensor> {
            Some(self)
        }

        fn age(&self) -> SourceAge {
            SourceAge::default()
        }

        fn write(&mut self, actuation: &Actuation<JOINTS>, _ticks: u64) -> Result<(), Fault> {
            self.brakes = matches!(actuation, Actuation::Brake);
            if let Actuation::Drive(command) = actuation {
                self.torque_nm = command.arm_torque_nm;
            }
            if self.refuses { Err(Fault::ControlRefused) } else { Ok(()) }
        }
    }

    struct Scripted(CoverState);

    impl CoverSource for Scripted {
        fn read(&mut self, _now_ns: u64, felt: &mut CoverState) {
            *felt = self.0;
        }

        fn start_tare(&mut self, _now_ns: u64) {
            self.0.zero = Zero::Taring;
        }
    }

    fn armed() -> ControlLoop<Standing, Scripted> {
        let config = Config::default();
        let cover = Scripted(CoverState { frames_good: 1, zero: Zero::Invalid, ..CoverState::NONE });
        let plant = Standing::default();
        let mut control = ControlLoop::new(plant, cover, supervisor(&config), motion(&config).unwrap(), 1e-3);
        step(&mut control, 0);
        control.cover.0.zero = Zero::Valid;
        assert_eq!(step(&mut control, 1).mode, Mode::Impedance);
        control
    }

    fn step(control: &mut ControlLoop<Standing, Scripted>, tick: u64) -> Sample {
        let slot = Slot { tick, now_ns: tick * 1_000_000, ticks: 1, ..Slot::default() };
        control.tick(&slot, None, &mut Untimed).sample.clone()
    }

    #[test]
    fn what_the_controller_refuses_stops_the_robot_in_the_same_tick() {
        let mut control = armed();
        assert!(!control.plant.brakes);
        control.cover.0.poll.forces = Err((3, TaxelStatus::Saturated));
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
        let plant = Standing::default();
        let mut control = ControlLoop::new(plant, cover, supervisor(&config), motion(&config).unwrap(), 1e-3);
        step(&mut control, 0);
        control.cover.0.zero = Zero::Valid;
        let feel = |control: &mut ControlLoop<Standing, Scripted>, tick: u64, force_n: f64| {
            control.cover.0.poll.reading.sampled_at_ns = Some(tick * 1_000_000);
            control.cover.0.poll.reading.taxels[5].force_n = force_n;
            step(control, tick)
        };
        for tick in 1..100 {
            assert_eq!(feel(&mut control, tick, if tick < 50 { 0.0 } else { 10.0 }).mode, Mode::Impedance);
        }
        let status = TaxelStatus::Saturated;
        let fault = Fault::TaxelInvalid { taxel: 5, status };
        control.cover.0.poll.reading.taxels[5].status = status;
        control.cover.0.poll.forces = Err((5, status));
        control.cover.0.poll.fault = Some(fault);
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
    fn nothing_of_the_last_tick_is_left_in_a_sample() {
        let (mut used, mut fresh) = (armed(), armed());
        for control in [&mut used, &mut fresh] {
            control.plant.lost = true;
            control.cover.0 = CoverState::NONE;
            control.cover.0.poll.fault = Some(BoardFault::Silent.of(0));
        }
        fresh.ticked = Ticked::default();
        let sample = step(&mut used, 2);
        assert_eq!(sample, step(&mut fresh, 2));
        assert!(sample.q_rad.is_empty() && sample.arm_torque_nm.is_empty(), "none is not zero");
    }

    #[test]
    fn unwatched_tick_tells_motion_mode_and_touch_as_ever() {
        let (mut watched, mut alone) = (armed(), armed());
        alone.watched = false;
        let touched = TaxelReading { force_n: 4.0, status: TaxelStatus::Ok };
        for control in [&mut watched, &mut alone] {
            control.cover.0.poll.reading.taxels[2] = touched;
            control.plant.torque_nm = [1.0; JOINTS];
        }
        let (before, shown) = (alone.ticked().clone(), step(&mut watched, 9));
        let told = step(&mut alone, 9);
        assert_eq!(told.taxels[2], touched);
        assert_eq!((told.mode, &told.taxels, &told.q_rad), (shown.mode, &shown.taxels, &shown.q_rad));
        let flange = |sample: &Sample| (sample.flange_position_world, sample.flange_desired_position_world);
        assert_eq!(flange(&told), flange(&shown));
        let base = |sample: &Sample| (sample.base_pose_world, sample.base_velocity_command_body);
        assert_eq!(base(&told), base(&shown));
        assert_eq!((told.tick, alone.ticked().input), (before.sample.tick, before.input), "not written");
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

    /// A robot with a flange sensor, whose cover is tared.
    fn with_flange_sensor(wrench: [f64; 6]) -> ControlLoop<Standing, Scripted> {
        let mut config = Config::default();
        config.plant.flange_sensor = FlangeSensorKind::Simulated;
        let cover = Scripted(CoverState { frames_good: 1, zero: Zero::Invalid, ..CoverState::NONE });
        let plant = Standing { flange: Some(wrench), ..Standing::default() };
        let mut control = ControlLoop::new(plant, cover, supervisor(&config), motion(&config).unwrap(), 1e-3);
        step(&mut control, 0);
        control.cover.0.zero = Zero::Valid;
        control
    }

    #[test]
    fn flange_sensor_is_not_used_before_its_tare() {
        let mut control = with_flange_sensor([3.0, 4.0, 12.0, 0.1, 0.2, 0.3]);
        for tick in 1..500 {
            let sample = step(&mut control, tick);
            assert_eq!((sample.mode, sample.fault), (Mode::Taring, None), "tick {tick}");
            // what the momentum observer makes of an arm that stands
            let most = if tick < 200 { 90.0 } else { 1.0 };
            assert!(sample.flange_wrench_world.iter().all(|value| value.abs() < most), "{sample:?}");
        }
        for tick in 500..510 {
            step(&mut control, tick);
        }
        control.plant.flange = Some([3.0, 4.0, 17.0, 0.1, 0.2, 0.3]);
        let sample = step(&mut control, 510);
        assert_eq!(sample.mode, Mode::Impedance);
        let [x, y, z, ..] = sample.flange_wrench_world;
        assert!((x.hypot(y).hypot(z) - 5.0).abs() < 1e-2, "{:?}", sample.flange_wrench_world);
        control.plant.flange = None;
        let sample = step(&mut control, 511);
        assert_eq!((sample.mode, sample.fault), (Mode::ProtectiveStop, Some(Fault::FlangeSensorStale)));
    }

    #[test]
    fn refused_flange_tare_stops_with_its_reason() {
        let mut control = with_flange_sensor([0.0; 6]);
        for tick in 1..520_u64 {
            let off_n = if tick.is_multiple_of(2) { 4.0 } else { -4.0 };
            control.plant.flange = Some([off_n, 0.0, 0.0, 0.0, 0.0, 0.0]);
            step(&mut control, tick);
        }
        let fault = control.ticked().sample.fault;
        assert!(
            matches!(fault, Some(Fault::FlangeZeroInvalid { why: FlangeTare::Noisy { axis: 0..3, .. } })),
            "{fault:?}"
        );
        control.cover.0.zero = Zero::Refused;
        control.plant.flange = Some([0.0; 6]);
        let again = Some(Request::Tare);
        control.tick(
            &Slot { tick: 520, now_ns: 520_000_000, ticks: 1, ..Slot::default() },
            again,
            &mut Untimed,
        );
        control.cover.0.zero = Zero::Refused;
        let faults: std::vec::Vec<_> = (521..1100).map(|tick| step(&mut control, tick).fault).collect();
        assert_eq!(faults.last(), Some(&Some(Fault::ZeroInvalid)), "the cover's own refusal");
    }

    #[test]
    fn reading_is_rounded_to_single_precision_before_it_is_used() {
        let mut control = with_flange_sensor([0.1, -0.2, 0.0, 1e-3, 0.0, 7.0]);
        step(&mut control, 1);
        let single = [f64::from(0.1_f32), f64::from(-0.2_f32), 0.0, f64::from(1e-3_f32), 0.0, 7.0];
        let mut read = control.ticked().input.flange.unwrap().wrench;
        read[2] = 0.0; // it trembles
        assert_eq!(read.map(f64::to_bits), single.map(f64::to_bits));
        control.plant.flange = Some([1e300, 0.0, 0.0, 0.0, 0.0, 0.0]);
        let fault = step(&mut control, 2).fault;
        assert_eq!(fault, Some(Fault::FlangeSensorRange { axis: 0, milli: i32::MAX, milli_max: 300_000 }));
    }

    #[test]
    fn lost_state_interrupts_flange_tare() {
        let mut control = with_flange_sensor([0.0; 6]);
        step(&mut control, 1);
        assert_eq!(control.motion.flange_zero().0, Zero::Taring);
        assert_eq!(control.motion.feel_flange(None, None, 1e-3), Ok(()));
        assert_eq!(control.motion.flange_zero().0, Zero::Invalid);
    }
}
