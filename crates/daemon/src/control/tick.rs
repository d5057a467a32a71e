//! The loop: one tick of the robot, from state and bytes to a command.

use crate::config::JOINTS;
use crate::control::cover::{CoverSource, CoverState};
use crate::control::law::{self, Motion};
use crate::control::plant::Plant;
use crate::control::protection::Protected;
use crate::control::state_check::StateDoor;
use crate::control::supervisor::{Facts, Supervisor};
use crate::record::tick_log::{Tape, TickInput};
use crate::runtime::timing::{Distribution, Stage, Timing};
use heapless::Vec;
use moca_msgs::{Actuation, Fault, Mode, Outcome, Refusal, Request, RobotState, STAGES, Sample};
use moca_wbc::{ControlError, ControlOutput};
use serde::{Deserialize, Serialize};

/// When a tick runs.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Slot {
    /// Tick count since the loop started.
    pub tick: u64,
    /// Loop time, ns.
    pub now_ns: u64,
    /// Control periods since the last tick: 1, or more after missed slots.
    pub ticks: u64,
    /// How late the tick woke, s.
    pub lateness_s: f64,
    /// Missed slots so far.
    pub overruns: u64,
    /// How long each stage of the tick before took, ns; an input, so that a replay says the same.
    pub stages_ns: [u32; STAGES.len()],
}

/// The parts of a running robot, and nothing that knows how the tick is timed or who watches.
pub struct ControlLoop<P, S> {
    /// The robot.
    pub plant: P,
    /// Its cover.
    pub cover: S,
    /// How long the stages took.
    pub timing: Timing,
    /// Age of the cover's data at each tick.
    pub frame_age: Distribution,
    /// Where each tick's inputs go, if somebody records them.
    pub tape: Option<Tape>,
    door: StateDoor,
    supervisor: Supervisor,
    motion: Motion,
    period_s: f64,
    refused: Option<Fault>,
    protected: Protected,
}

impl<P: Plant, S: CoverSource> ControlLoop<P, S> {
    /// A loop that has not ticked yet.
    ///
    /// # Errors
    /// See [`Timing::new`].
    pub fn new(
        plant: P,
        cover: S,
        supervisor: Supervisor,
        motion: Motion,
        period_s: f64,
    ) -> Result<Self, hdrhistogram::CreationError> {
        let (timing, frame_age) = (Timing::new()?, Distribution::new()?);
        let (door, protected) = (StateDoor::default(), Protected::default());
        Ok(Self {
            plant,
            cover,
            timing,
            frame_age,
            tape: None,
            door,
            supervisor,
            motion,
            period_s,
            refused: None,
            protected,
        })
    }

    /// One tick: read, feel, decide, command, write; returns what an observer may see and the answer to `request`.
    pub fn tick(&mut self, slot: &Slot, request: Option<Request>) -> (Sample, Option<Outcome>) {
        self.timing.start();
        let measured = self.plant.read();
        let age = self.plant.age();
        let robot = measured.and_then(|state| self.door.check(state, age, self.elapsed_s(slot)));
        self.timing.end(Stage::Read);

        let cover = self.cover.read(slot.now_ns);
        self.timing.end(Stage::Cover);

        let (outcome, output) = self.decide(slot, &robot, &cover, request);
        let actuation = law::actuation(output.as_ref());
        self.timing.end(Stage::Control);

        let refused = self.plant.write(&actuation, slot.ticks).err();
        self.refused = refused.or(self.refused);
        if let Some(tape) = &mut self.tape {
            let state = measured.map(Into::into);
            let input = TickInput {
                slot: *slot,
                state,
                age,
                request,
                outcome,
                refused,
                events: 0,
                number: 0,
                lost: 0,
            };
            tape.push(input, self.cover.copied());
        }
        self.timing.end(Stage::Write);

        (self.sample(slot, robot.ok().as_ref(), &cover, &actuation, output.as_ref()), outcome)
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

    fn elapsed_s(&self, slot: &Slot) -> f64 {
        #[expect(clippy::cast_precision_loss, reason = "a count of missed slots")]
        let ticks = slot.ticks as f64;
        self.period_s * ticks
    }

    fn decide(
        &mut self,
        slot: &Slot,
        robot: &Result<RobotState<JOINTS>, Fault>,
        cover: &CoverState,
        request: Option<Request>,
    ) -> (Option<Outcome>, Option<ControlOutput<JOINTS>>) {
        let facts = Facts {
            cover_seen: cover.frames_good > 0 || !self.motion.parts().has_cover(),
            cover_fault: cover.fault,
            zero: cover.zero,
            plant_fault: robot.err().or(self.refused.take()),
        };
        let (asked, pressed) = match request {
            Some(Request::PressTaxel { taxel, force_n }) => {
                (None, Some(self.plant.press(usize::from(taxel), force_n)))
            }
            Some(Request::MaskTaxel { taxel, masked }) => {
                let outcome = match self.supervisor.mode() {
                    mode if mode.moves() => Err(Refusal::Mode(mode)),
                    _ => self.cover.mask(usize::from(taxel), masked),
                };
                (None, Some(outcome))
            }
            Some(Request::SetParameter { parameter, values }) => {
                (None, Some(self.motion.set_parameter(usize::from(parameter), &values)))
            }
            request => (request, None),
        };
        let decision = self.supervisor.step(&facts, asked);
        if decision.start_tare {
            self.cover.start_tare(slot.now_ns);
        }
        let outcome = decision.outcome.or(pressed);
        match self.motion.protect(slot.now_ns, cover, decision.mode) {
            Ok(protected) => self.protected = protected,
            Err(fault) => {
                self.refused = Some(fault);
                return (outcome, None);
            }
        }
        let (Ok(robot), false) = (robot, decision.mode == Mode::Fault) else {
            // Whatever runs next starts from where the robot then is.
            self.motion.leave();
            return (outcome, None);
        };
        match self.motion.command(decision.mode, robot, &cover.forces, self.elapsed_s(slot)) {
            Ok(output) => (outcome, Some(output)),
            Err(fault) => {
                self.refused = Some(fault);
                (outcome, None)
            }
        }
    }

    fn sample(
        &mut self,
        slot: &Slot,
        robot: Option<&RobotState<JOINTS>>,
        cover: &CoverState,
        actuation: &Actuation<JOINTS>,
        output: Option<&ControlOutput<JOINTS>>,
    ) -> Sample {
        let age_s = cover.reading.age_s(slot.now_ns);
        if let Some(age_s) = age_s.filter(|_| self.timing.is_on()) {
            self.frame_age.record(std::time::Duration::from_secs_f64(age_s));
        }
        let mut sample = Sample {
            tick: slot.tick,
            time_ns: slot.now_ns,
            mode: self.supervisor.mode(),
            fault: self.supervisor.cause(),
            frame_age_s: age_s.unwrap_or(-1.0),
            frame_rate_hz: cover.rate_hz,
            frames_good: cover.frames_good,
            frames_bad: cover.frames_bad,
            board: cover.board,
            lateness_s: slot.lateness_s,
            overruns: slot.overruns,
            stages_ns: slot.stages_ns,
            speed_limit: self.protected.speed_limit,
            contact_reaction: self.protected.reaction,
            contact_events: self.protected.events.clone(),
            ..Sample::default()
        };
        let parts = self.motion.parts();
        if parts.has_cover() {
            sample.taxels = vec_of(&cover.reading.taxels);
            sample.counts = vec_of(&cover.counts);
        }
        if let Some(robot) = robot {
            sample.base_pose_world = robot.base_pose_world;
            sample.base_velocity_world = robot.base_velocity_world;
            sample.cover_speed_m_s = self.motion.cover_speed_m_s(robot);
        }
        if let Some(robot) = robot.filter(|_| parts.has_arm()) {
            sample.q_rad = vec_of(&robot.q_rad);
            sample.dq_rad_s = vec_of(&robot.dq_rad_s);
        }
        if let Actuation::Drive(command) = actuation {
            sample.base_velocity_command_body = command.base_velocity_body;
            if parts.has_arm() {
                sample.arm_torque_nm = vec_of(&command.arm_torque_nm);
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

fn vec_of<T: Clone, const N: usize>(values: &[T]) -> Vec<T, N> {
    // The capacities of a sample exceed this robot's numbers of joints and taxels.
    Vec::from_slice(&values[..values.len().min(N)]).unwrap_or_default()
}
