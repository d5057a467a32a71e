//! The supervisor: which mode the robot is in, and why. Pure: facts and at most one request in, a mode out.
//!
//! Its rules are the rows of [`EDGES`]; an edge that is not there cannot be taken.

use moca_msgs::mode::Clearing;
use moca_msgs::{BoardFault, Fault, Law, Mode, Outcome, Reaction, Refusal, Request};
use serde::{Deserialize, Serialize};

/// Every allowed change of mode. A law is reached only from `Ready` (or from the other law), `Ready` only through a
/// finished tare, a disarm or an explicit resume, and nothing leaves `Fault`.
pub const EDGES: &[(Mode, Mode)] = {
    use Mode::{Fault, FollowMe, Impedance, ProtectiveStop, Ready, Starting, Taring};
    &[
        (Starting, Taring),
        (Starting, ProtectiveStop),
        (Starting, Fault),
        (Taring, Starting),
        (Taring, Ready),
        (Taring, ProtectiveStop),
        (Taring, Fault),
        (Ready, Taring),
        (Ready, Impedance),
        (Ready, FollowMe),
        (Ready, ProtectiveStop),
        (Ready, Fault),
        (Impedance, FollowMe),
        (Impedance, Ready),
        (Impedance, ProtectiveStop),
        (Impedance, Fault),
        (FollowMe, Impedance),
        (FollowMe, Ready),
        (FollowMe, ProtectiveStop),
        (FollowMe, Fault),
        (ProtectiveStop, Taring),
        (ProtectiveStop, Ready),
        (ProtectiveStop, Fault),
    ]
};

/// State of a zero: of the cover, or of all that is tared.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Zero {
    /// None, or no longer valid.
    Invalid,
    /// Being measured.
    Taring,
    /// The last tare was refused (touched or noisy); there is no valid zero.
    Refused,
    /// Valid.
    Valid,
}

impl Zero {
    /// Returns the state of two zeros together: valid if both are, and being measured as long as one is.
    #[must_use]
    pub const fn and(self, other: Self) -> Self {
        match (self, other) {
            (Self::Taring, _) | (_, Self::Taring) => Self::Taring,
            (Self::Refused, _) | (_, Self::Refused) => Self::Refused,
            (Self::Invalid, _) | (_, Self::Invalid) => Self::Invalid,
            (Self::Valid, Self::Valid) => Self::Valid,
        }
    }
}

/// A taxel that feels a force.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Touch {
    /// 0 is T1.
    pub taxel: u8,
    /// N.
    pub force_n: f64,
}

impl Touch {
    /// Returns true if any of the forces, N, is of somebody.
    pub fn is_in(forces_n: &[f64]) -> bool {
        // no early return: several at once
        forces_n.iter().fold(false, |felt, force_n| felt | (*force_n > 0.0))
    }

    /// The strongest of `forces_n`, T1 first; `None` where nothing is felt.
    pub fn strongest(forces_n: &[f64]) -> Option<Self> {
        let felt = (0_u8..).zip(forces_n).filter(|(_, force_n)| **force_n > 0.0);
        felt.max_by(|a, b| a.1.total_cmp(b.1)).map(|(taxel, &force_n)| Self { taxel, force_n })
    }
}

/// Facts at one tick.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Facts {
    /// True once the cover has given a good frame.
    pub cover_seen: bool,
    /// Present fault of the cover.
    pub cover_fault: Option<Fault>,
    /// Zero of cover and flange sensor.
    pub zero: Zero,
    /// Fault that stands for a missing zero.
    pub zero_fault: Fault,
    /// Present fault of the plant or of the controller.
    pub plant_fault: Option<Fault>,
    /// The joint (0 is the first) of a real arm that is too far from its posture to be armed, and how far, rad.
    pub far_joint: Option<(u8, f64)>,
    /// Touch on the cover.
    pub touch: Option<Touch>,
}

/// Actions that the supervisor may take by itself.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Automatic {
    /// Tare as soon as the first good frames arrive.
    pub tare: bool,
    /// Arm once after the first tare, unless an operator has stopped, tared or resumed before. Only ever set for a
    /// simulated robot.
    pub arm: bool,
}

/// Decision of one step.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Decision {
    /// Mode of this tick.
    pub mode: Mode,
    /// True if the tare has to be started now.
    pub start_tare: bool,
    /// Answer to the request, if there was one and the supervisor has answered it.
    pub outcome: Option<Outcome>,
    /// A request that is permitted in this mode and that a part of the robot has to carry out and answer.
    pub carry_out: Option<Request>,
}

/// The mode and what led to it.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Supervisor {
    mode: Mode,
    cause: Option<Fault>,
    law: Law,
    automatic: Automatic,
    before_tare: Mode,
    start_tare: bool,
    /// The stop can be resumed only after a tare.
    tare_owed: bool,
    robot: bool,
}

impl Supervisor {
    /// In [`Mode::Starting`].
    pub const fn new(law: Law, automatic: Automatic) -> Self {
        Self {
            mode: Mode::Starting,
            cause: None,
            law,
            automatic,
            before_tare: Mode::Starting,
            start_tare: false,
            tare_owed: false,
            robot: true,
        }
    }

    /// Returns the supervisor of a setup in which nothing can be armed.
    #[must_use]
    pub const fn without_robot(self) -> Self {
        Self { robot: false, automatic: Automatic { arm: false, ..self.automatic }, ..self }
    }

    /// Current mode.
    pub const fn mode(&self) -> Mode {
        self.mode
    }

    /// The selected law.
    pub const fn law(&self) -> Law {
        self.law
    }

    /// Why the robot is stopped, or what it is waiting for.
    pub const fn cause(&self) -> Option<Fault> {
        self.cause
    }

    /// One tick: faults first, then the operator, then what happens by itself.
    pub fn step(&mut self, facts: &Facts, request: Option<Request>) -> Decision {
        self.start_tare = false;
        self.react(facts);
        let (outcome, carry_out) = match request {
            None => (None, None),
            Some(request) if !request.taken_in().contains(&self.mode) => {
                (Some(Err(Refusal::Mode(self.mode))), None)
            }
            Some(
                request @ (Request::PressTaxel { .. }
                | Request::MaskTaxel { .. }
                | Request::SetParameter { .. }
                | Request::Target(_)
                | Request::Waypoint { .. }
                | Request::EndTarget
                | Request::Recentre
                | Request::Gripper(_)),
            ) => (None, Some(request)),
            Some(Request::Resume) if facts.plant_fault == Some(Fault::ArmReflex) => {
                (None, Some(Request::Resume))
            }
            Some(request) => (Some(self.answer(request, facts)), None),
        };
        // From then on somebody is responsible: only a request of theirs arms the robot.
        let intervenes =
            matches!(request, Some(Request::Stop | Request::OperatorLost | Request::Tare | Request::Resume));
        if intervenes && (carry_out.is_some() || outcome == Some(Ok(()))) {
            self.automatic.arm = false;
        }
        self.proceed(facts);
        Decision { mode: self.mode, start_tare: self.start_tare, outcome, carry_out }
    }

    /// Stops in the running tick for a fault that was found after [`Supervisor::step`]: by the controller or in the
    /// plant's answer to the order.
    pub fn stop_for(&mut self, fault: Fault) {
        self.stop(fault);
    }

    fn react(&mut self, facts: &Facts) {
        let awaited = facts.plant_fault.filter(|fault| self.mode == Mode::Starting && fault.is_absence());
        if let Some(fault) = facts.plant_fault.filter(|_| awaited.is_none()) {
            self.stop(fault);
        }
        match self.mode {
            Mode::Fault => {}
            // Nothing moves yet: say what is missing and wait for it.
            Mode::Starting => {
                let refused = (facts.zero == Zero::Refused).then_some(facts.zero_fault);
                self.cause = awaited.or(facts.cover_fault).or(refused);
            }
            Mode::Taring | Mode::Ready | Mode::Impedance | Mode::FollowMe => {
                let taring = self.mode == Mode::Taring;
                if let Some(fault) = facts.cover_fault.filter(|fault| !(taring && fault.a_tare_may_end_it()))
                {
                    self.stop(fault);
                } else if self.mode != Mode::Taring && facts.zero != Zero::Valid {
                    self.stop(facts.zero_fault);
                }
            }
            // The first cause stays until resume, unless it was the operator's and a real one has come since, or the cover
            // now needs a tare which that cause does not speak of.
            Mode::ProtectiveStop => {
                let asked = matches!(self.cause, None | Some(Fault::OperatorStop));
                let no_zero = matches!(facts.zero, Zero::Invalid | Zero::Refused).then_some(facts.zero_fault);
                let cover =
                    facts.cover_fault.filter(|_| asked).or(facts.cover_fault.or(no_zero).filter(|fault| {
                        let silent = matches!(
                            self.cause,
                            Some(Fault::Board {
                                fault: BoardFault::Silent | BoardFault::Slow | BoardFault::HostStarved,
                                ..
                            })
                        );
                        (asked || silent) && fault.clearing() == Clearing::Tare
                    }));
                if cover.is_some() {
                    self.blame(cover);
                }
            }
        }
    }

    /// Answers a request that is taken in this mode.
    fn answer(&mut self, request: Request, facts: &Facts) -> Outcome {
        match request {
            Request::Stop => {
                if self.mode != Mode::ProtectiveStop {
                    self.stop(Fault::OperatorStop);
                }
                Ok(())
            }
            Request::OperatorLost => {
                if self.mode.moves() {
                    self.stop(Fault::OperatorLost);
                }
                Ok(())
            }
            Request::Tare => self.tare(facts),
            Request::Arm if !self.robot => Err(Refusal::NoRobot),
            Request::Arm => {
                if let Some(Touch { taxel, force_n }) = facts.touch {
                    return Err(Refusal::Touched { taxel, force_n });
                }
                if let Some((joint, off_rad)) = facts.far_joint {
                    return Err(Refusal::FarFromPosture { joint, off_rad });
                }
                self.go(self.law.into());
                Ok(())
            }
            Request::Disarm => {
                self.go(Mode::Ready);
                Ok(())
            }
            Request::SelectLaw(law) => {
                self.law = law;
                if self.mode.moves() && self.mode != law.into() {
                    self.go(law.into());
                }
                Ok(())
            }
            Request::Resume => self.resume(facts),
            Request::PressTaxel { .. }
            | Request::MaskTaxel { .. }
            | Request::SetParameter { .. }
            | Request::Target(_)
            | Request::Waypoint { .. }
            | Request::EndTarget
            | Request::Recentre
            | Request::Gripper(_) => Err(Refusal::Mode(self.mode)),
        }
    }

    fn resume(&mut self, facts: &Facts) -> Outcome {
        if let Some(fault) = facts.plant_fault.or(facts.cover_fault) {
            return Err(Refusal::CauseRemains(fault));
        }
        if facts.zero != Zero::Valid || self.tare_owed {
            return Err(Refusal::ZeroInvalid);
        }
        self.go(Mode::Ready);
        Ok(())
    }

    fn tare(&mut self, facts: &Facts) -> Outcome {
        let cover_fault = facts.cover_fault.filter(|fault| !fault.a_tare_may_end_it());
        if let Some(fault) = facts.plant_fault.or(cover_fault) {
            return Err(Refusal::CauseRemains(fault));
        }
        if !facts.cover_seen {
            return Err(Refusal::Mode(self.mode));
        }
        self.before_tare = self.mode;
        self.go(Mode::Taring);
        self.start_tare = true;
        Ok(())
    }

    fn proceed(&mut self, facts: &Facts) {
        match self.mode {
            Mode::Starting if self.automatic.tare && facts.cover_seen => {
                // A refusal here is an open cause (react has named it): try again at the next tick.
                let _ = self.tare(facts);
            }
            Mode::Taring if !self.start_tare => match (facts.zero, self.before_tare) {
                (Zero::Taring, _) => {}
                (Zero::Valid, Mode::ProtectiveStop) => {
                    self.tare_owed = false;
                    self.go(Mode::ProtectiveStop);
                }
                (Zero::Valid, _) => {
                    self.go(Mode::Ready);
                    let free = facts.touch.is_none() && facts.far_joint.is_none();
                    if self.automatic.arm && facts.cover_fault.is_none() && free {
                        self.automatic.arm = false;
                        self.go(self.law.into());
                    }
                }
                (Zero::Invalid | Zero::Refused, Mode::Starting) => {
                    self.go(Mode::Starting);
                }
                (Zero::Invalid | Zero::Refused, _) => self.stop(facts.zero_fault),
            },
            _ => {}
        }
    }

    fn stop(&mut self, fault: Fault) {
        let target = match fault.reaction() {
            Reaction::ProtectiveStop => Mode::ProtectiveStop,
            Reaction::Fault => Mode::Fault,
        };
        if self.mode != target && self.mode != Mode::Fault {
            self.go(target);
            self.blame(Some(fault));
        }
    }

    fn blame(&mut self, cause: Option<Fault>) {
        self.cause = cause;
        self.tare_owed |= cause.is_some_and(|fault| fault.clearing() == Clearing::Tare);
    }

    fn go(&mut self, to: Mode) {
        if EDGES.contains(&(self.mode, to)) {
            if matches!(to, Mode::Ready | Mode::Impedance | Mode::FollowMe) {
                self.cause = None;
            }
            self.mode = to;
        } else {
            debug_assert!(false, "no edge from {:?} to {to:?}", self.mode);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use moca_msgs::TaxelStatus;

    const GOOD: Facts = Facts {
        cover_seen: true,
        cover_fault: None,
        zero: Zero::Valid,
        zero_fault: Fault::ZeroInvalid,
        plant_fault: None,
        far_joint: None,
        touch: None,
    };
    const DRIFTED: Fault = Fault::TaxelInvalid { taxel: 3, status: TaxelStatus::Drifted };
    const HAND: Touch = Touch { taxel: 5, force_n: 12.0 };
    const ALL_MODES: [Mode; 7] = [
        Mode::Starting,
        Mode::Taring,
        Mode::Ready,
        Mode::Impedance,
        Mode::FollowMe,
        Mode::ProtectiveStop,
        Mode::Fault,
    ];
    const REQUESTS: [Option<Request>; 9] = [
        None,
        Some(Request::Tare),
        Some(Request::Arm),
        Some(Request::Disarm),
        Some(Request::SelectLaw(Law::FollowMe)),
        Some(Request::SelectLaw(Law::Impedance)),
        Some(Request::Stop),
        Some(Request::OperatorLost),
        Some(Request::Resume),
    ];
    const FACTS: [Facts; 13] = [
        Facts { cover_seen: false, zero: Zero::Invalid, ..GOOD },
        Facts { zero: Zero::Invalid, ..GOOD },
        Facts { zero: Zero::Taring, ..GOOD },
        Facts { zero: Zero::Refused, ..GOOD },
        GOOD,
        Facts { cover_fault: Some(BoardFault::Silent.of(0)), ..GOOD },
        Facts { cover_fault: Some(DRIFTED), ..GOOD },
        Facts { touch: Some(HAND), ..GOOD },
        Facts { plant_fault: Some(Fault::StateInvalid), ..GOOD },
        Facts { plant_fault: Some(Fault::BaseStale), ..GOOD },
        Facts { plant_fault: Some(Fault::ArmReflex), ..GOOD },
        Facts { plant_fault: Some(Fault::ArmRefused), zero: Zero::Invalid, ..GOOD },
        Facts { far_joint: Some((3, 0.3)), ..GOOD },
    ];

    #[test]
    fn touch_is_in_forces_of_which_any_is_above_zero() {
        for (forces_n, expected) in
            [(&[][..], false), (&[0.0, -1.0], false), (&[0.0, 0.1], true), (&[2.0, 3.0], true)]
        {
            assert_eq!(Touch::is_in(forces_n), expected, "{forces_n:?}");
            assert_eq!(Touch::strongest(forces_n).is_some(), expected, "{forces_n:?}");
        }
    }

    #[test]
    fn zeros_together_are_the_one_that_is_further_from_valid() {
        use Zero::{Invalid, Refused, Taring, Valid};
        // from the one that decides to the one that decides nothing
        let order = [Taring, Refused, Invalid, Valid];
        for (i, one) in order.into_iter().enumerate() {
            for (j, other) in order.into_iter().enumerate() {
                assert_eq!(one.and(other), order[i.min(j)], "{one:?} {other:?}");
            }
        }
    }

    fn manual() -> Supervisor {
        Supervisor::new(Law::Impedance, Automatic::default())
    }

    fn run(supervisor: &mut Supervisor, steps: &[(Facts, Option<Request>)]) -> Decision {
        let mut last = None;
        for (facts, request) in steps {
            last = Some(supervisor.step(facts, *request));
        }
        last.expect("at least one step")
    }

    fn armed() -> Supervisor {
        let mut supervisor = manual();
        let taring = Facts { zero: Zero::Taring, ..GOOD };
        let steps = [
            (Facts { zero: Zero::Invalid, ..GOOD }, Some(Request::Tare)),
            (taring, None),
            (GOOD, None),
            (GOOD, Some(Request::Arm)),
        ];
        assert_eq!(run(&mut supervisor, &steps).mode, Mode::Impedance);
        supervisor
    }

    /// A state of the walk.
    #[derive(Clone, Copy, PartialEq)]
    struct Visited {
        supervisor: Supervisor,
        /// True if the robot may move: arming was requested since the last stop, or is automatic and nothing forbids it.
        asked: bool,
        /// True if an operator has stopped, tared or resumed since the start.
        intervened: bool,
    }

    /// One step of the walk.
    fn checked(visited: Visited, facts: &Facts, request: Option<Request>) -> Visited {
        let Visited { supervisor, asked, intervened } = visited;
        let mut next = supervisor;
        let before = next.mode();
        let decision = next.step(facts, request);
        let mode = decision.mode;
        let accepted = decision.carry_out.is_some() || decision.outcome == Some(Ok(()));
        let intervenes =
            matches!(request, Some(Request::Stop | Request::OperatorLost | Request::Tare | Request::Resume));
        let intervened = intervened || accepted && intervenes;
        let stopped = matches!(mode, Mode::ProtectiveStop | Mode::Fault);
        let by_itself = supervisor.automatic.arm && mode.moves() && !before.moves();
        assert!(
            !(by_itself && intervened && request != Some(Request::Arm)),
            "armed itself after an operator"
        );
        assert!(!(intervened && next.automatic.arm), "an operator intervened, and arming is still automatic");
        let asked = !stopped && (asked || by_itself || request == Some(Request::Arm));
        if mode.moves() {
            assert!(asked, "motion that nobody asked for since the last stop");
            assert_eq!((facts.cover_fault, facts.plant_fault), (None, None), "motion under a fault");
            assert_eq!(facts.zero, Zero::Valid, "motion without a zero");
        }
        if mode.moves() && !before.moves() {
            assert_eq!(facts.touch, None, "armed under a hand");
            assert_eq!(facts.far_joint, None, "armed far from the posture");
        }
        if before == Mode::Fault {
            assert_eq!(mode, Mode::Fault, "fault is left only by a restart");
        }
        if matches!(request, Some(Request::Stop | Request::OperatorLost)) && before != Mode::Fault {
            assert!(!mode.moves(), "stop ignored");
        }
        if stopped {
            assert!(next.cause().is_some(), "a stop without a cause");
        }
        Visited { supervisor: next, asked, intervened }
    }

    #[test]
    fn no_sequence_moves_without_zero_and_arming_or_skips_a_stop() {
        // Facts are adversarial: any of them in any order. A valid zero comes only from a tare (crates/tactile).
        let by_itself = Supervisor::new(Law::Impedance, Automatic { tare: true, arm: true });
        let start = |supervisor| Visited { supervisor, asked: false, intervened: false };
        let mut states = vec![start(manual()), start(by_itself)];
        let mut next = 0;
        while let Some(&visited) = states.get(next) {
            next += 1;
            for facts in FACTS {
                for request in REQUESTS {
                    let reached = checked(visited, &facts, request);
                    if !states.contains(&reached) {
                        states.push(reached);
                    }
                }
            }
        }
        for mode in [Mode::Impedance, Mode::FollowMe, Mode::ProtectiveStop, Mode::Fault, Mode::Ready] {
            assert!(
                states.iter().any(|visited| visited.supervisor.mode() == mode),
                "{mode:?} was never reached"
            );
        }
        assert!(states.len() > 100, "only {} states: the walk shows little", states.len());
    }

    #[test]
    fn request_outside_its_modes_is_refused_by_name() {
        let of_parts = [
            Request::PressTaxel { taxel: 0, force_n: 1.0 },
            Request::MaskTaxel { taxel: 0, masked: true },
            Request::SetParameter { parameter: 0, values: moca_msgs::ParameterValues::default() },
            Request::Recentre,
        ];
        let requests = REQUESTS.into_iter().flatten().chain(of_parts);
        for request in requests {
            for mode in ALL_MODES {
                let mut supervisor = Supervisor { mode, ..manual() };
                let facts =
                    Facts { zero: if mode == Mode::Taring { Zero::Taring } else { Zero::Valid }, ..GOOD };
                let decision = supervisor.step(&facts, Some(request));
                let refused = decision.outcome == Some(Err(Refusal::Mode(mode)));
                assert_eq!(refused, !request.taken_in().contains(&mode), "{request:?} in {mode:?}");
            }
        }
    }

    #[test]
    fn a_cover_fault_stops_and_resume_waits_for_cause_and_zero() {
        let mut supervisor = armed();
        let lost = Facts { cover_fault: Some(BoardFault::Lost.of(0)), zero: Zero::Invalid, ..GOOD };
        assert_eq!(supervisor.step(&lost, None).mode, Mode::ProtectiveStop);
        assert_eq!(supervisor.cause(), Some(BoardFault::Lost.of(0)));
        let refused = supervisor.step(&lost, Some(Request::Resume)).outcome;
        assert_eq!(refused, Some(Err(Refusal::CauseRemains(BoardFault::Lost.of(0)))));
        let back = Facts { zero: Zero::Invalid, ..GOOD };
        assert_eq!(supervisor.step(&back, Some(Request::Resume)).outcome, Some(Err(Refusal::ZeroInvalid)));
        let decision = supervisor.step(&back, Some(Request::Tare));
        assert!(decision.start_tare && decision.mode == Mode::Taring);
        let steps = [(Facts { zero: Zero::Taring, ..GOOD }, None), (GOOD, None)];
        assert_eq!(run(&mut supervisor, &steps).mode, Mode::ProtectiveStop, "a tare alone does not resume");
        assert_eq!(supervisor.step(&GOOD, Some(Request::Resume)).mode, Mode::Ready);
        assert_eq!(supervisor.cause(), None);
    }

    fn ask(supervisor: &mut Supervisor, facts: Facts, request: Request) -> Outcome {
        supervisor.step(&facts, Some(request)).outcome.expect("an answer")
    }

    fn tared(supervisor: &mut Supervisor, at_first: Facts) -> Mode {
        assert_eq!(ask(supervisor, at_first, Request::Tare), Ok(()));
        run(supervisor, &[(Facts { zero: Zero::Taring, ..at_first }, None), (GOOD, None)]).mode
    }

    #[test]
    fn out_of_a_reflex_the_arm_itself_is_asked_to_resume() {
        let mut supervisor = armed();
        let reflex = Facts { plant_fault: Some(Fault::ArmReflex), ..GOOD };
        assert_eq!(supervisor.step(&reflex, None).mode, Mode::ProtectiveStop);
        let decision = supervisor.step(&reflex, Some(Request::Resume));
        assert_eq!((decision.outcome, decision.carry_out), (None, Some(Request::Resume)));
        assert_eq!(decision.mode, Mode::ProtectiveStop);
        let decision = supervisor.step(&GOOD, Some(Request::Resume));
        assert_eq!((decision.outcome, decision.carry_out), (Some(Ok(())), None));
        assert_eq!(decision.mode, Mode::Ready);
    }

    #[test]
    fn nobody_arms_a_robot_that_is_being_touched() {
        let touched = Facts { touch: Touch::strongest(&[0.0, 3.0, 12.0, 12.0, 0.0]), ..GOOD };
        let refusal = Err(Refusal::Touched { taxel: 3, force_n: 12.0 });
        let mut supervisor = armed();
        assert_eq!(ask(&mut supervisor, touched, Request::Disarm), Ok(()));
        assert_eq!(ask(&mut supervisor, touched, Request::Arm), refusal);
        assert_eq!(ask(&mut supervisor, GOOD, Request::Arm), Ok(()));
        assert_eq!(
            ask(&mut supervisor, touched, Request::SelectLaw(Law::FollowMe)),
            Ok(()),
            "a law may change"
        );
        assert_eq!(supervisor.law(), Law::FollowMe);
        assert_eq!(ask(&mut supervisor, touched, Request::Stop), Ok(()));
        assert_eq!(ask(&mut supervisor, touched, Request::Resume), Ok(()), "which moves nothing");
        assert_eq!(ask(&mut supervisor, touched, Request::Arm), refusal);
        assert_eq!(supervisor.mode(), Mode::Ready);
        assert_eq!(Touch::strongest(&[0.0; 11]), None);
    }

    #[test]
    fn what_a_stop_demands_is_what_its_text_says() {
        // A taxel that comes back by itself: its text asks for a tare, so resuming does too.
        let mut supervisor = armed();
        supervisor.step(&Facts { cover_fault: Some(DRIFTED), ..GOOD }, None);
        assert_eq!(ask(&mut supervisor, GOOD, Request::Resume), Err(Refusal::ZeroInvalid));
        assert_eq!(tared(&mut supervisor, GOOD), Mode::ProtectiveStop);
        assert_eq!(ask(&mut supervisor, GOOD, Request::Resume), Ok(()));

        // Silence: the text asks for nothing but frames.
        let mut supervisor = armed();
        supervisor.step(&Facts { cover_fault: Some(BoardFault::Silent.of(0)), ..GOOD }, None);
        assert_eq!(ask(&mut supervisor, GOOD, Request::Resume), Ok(()));

        // An operator's stop during the tare that a fault demands does not make up for it.
        let mut supervisor = armed();
        supervisor.step(&Facts { cover_fault: Some(DRIFTED), ..GOOD }, None);
        assert_eq!(ask(&mut supervisor, GOOD, Request::Tare), Ok(()));
        let taring = Facts { zero: Zero::Taring, ..GOOD };
        assert_eq!(ask(&mut supervisor, taring, Request::Stop), Ok(()));
        assert_eq!(ask(&mut supervisor, GOOD, Request::Resume), Err(Refusal::ZeroInvalid));

        // Where a tare has become necessary since, the text says so.
        let mut supervisor = armed();
        supervisor.step(&Facts { cover_fault: Some(BoardFault::Silent.of(0)), ..GOOD }, None);
        supervisor.step(&Facts { zero: Zero::Invalid, ..GOOD }, None);
        assert_eq!(supervisor.cause(), Some(Fault::ZeroInvalid));

        // What stopped the robot for another reason stays the reason.
        let mut supervisor = armed();
        supervisor.step(&Facts { plant_fault: Some(Fault::BaseStale), ..GOOD }, None);
        supervisor.step(&Facts { zero: Zero::Invalid, ..GOOD }, None);
        assert_eq!(supervisor.cause(), Some(Fault::BaseStale));
    }

    #[test]
    fn tare_is_refused_where_it_cannot_end_the_fault() {
        let mut supervisor = armed();
        let drifted = Facts { cover_fault: Some(DRIFTED), ..GOOD };
        supervisor.step(&drifted, None);
        assert_eq!(tared(&mut supervisor, drifted), Mode::ProtectiveStop);
        assert_eq!(ask(&mut supervisor, GOOD, Request::Resume), Ok(()));

        let frozen = Facts { cover_fault: Some(BoardFault::Frozen.of(0)), ..GOOD };
        supervisor.step(&frozen, None);
        assert_eq!(
            ask(&mut supervisor, frozen, Request::Tare),
            Err(Refusal::CauseRemains(BoardFault::Frozen.of(0)))
        );
    }

    #[test]
    fn nothing_is_tared_that_nobody_asked_for() {
        let mut supervisor = manual();
        assert_eq!(run(&mut supervisor, &[(GOOD, None), (GOOD, None)]).mode, Mode::Starting);
    }

    #[test]
    fn without_a_robot_the_cover_is_tared_and_nothing_is_armed() {
        let mut supervisor =
            Supervisor::new(Law::Impedance, Automatic { tare: true, arm: true }).without_robot();
        let zero = |zero| Facts { zero, ..GOOD };
        let steps = [(zero(Zero::Invalid), None), (zero(Zero::Taring), None), (zero(Zero::Valid), None)];
        assert_eq!(run(&mut supervisor, &steps).mode, Mode::Ready);
        assert_eq!(supervisor.step(&GOOD, Some(Request::Arm)).outcome, Some(Err(Refusal::NoRobot)));
    }

    #[test]
    fn automatic_arming_happens_once() {
        let mut supervisor = Supervisor::new(Law::Impedance, Automatic { tare: true, arm: true });
        let zero = |zero| Facts { zero, ..GOOD };
        let steps = [(zero(Zero::Invalid), None), (zero(Zero::Taring), None), (zero(Zero::Valid), None)];
        assert_eq!(run(&mut supervisor, &steps).mode, Mode::Impedance);
        supervisor.step(&GOOD, Some(Request::Stop));
        assert_eq!(supervisor.step(&GOOD, Some(Request::Resume)).mode, Mode::Ready);
        assert_eq!(supervisor.step(&GOOD, None).mode, Mode::Ready);
    }

    /// Regression test: a robot stopped before its first tare had finished armed itself at a later tare.
    #[test]
    fn operator_that_stops_tares_or_resumes_ends_automatic_arming() {
        let start = || Supervisor::new(Law::Impedance, Automatic { tare: true, arm: true });
        let zero = |zero| Facts { zero, ..GOOD };
        let mut supervisor = start();
        run(&mut supervisor, &[(zero(Zero::Invalid), None), (zero(Zero::Taring), Some(Request::Stop))]);
        assert_eq!(tared(&mut supervisor, zero(Zero::Invalid)), Mode::ProtectiveStop);
        assert_eq!(ask(&mut supervisor, GOOD, Request::Resume), Ok(()));
        assert_eq!(tared(&mut supervisor, GOOD), Mode::Ready, "armed itself");

        // A hand on the cover put automatic arming off; the operator's tare does not make up for it.
        let mut supervisor = start();
        let touched = Facts { touch: Some(HAND), ..GOOD };
        run(&mut supervisor, &[(zero(Zero::Invalid), None), (zero(Zero::Taring), None), (touched, None)]);
        assert_eq!(tared(&mut supervisor, GOOD), Mode::Ready, "armed itself");
    }

    #[test]
    fn a_refused_tare_at_start_is_named_and_tried_again() {
        let mut supervisor = Supervisor::new(Law::Impedance, Automatic { tare: true, arm: false });
        let zero = |zero| Facts { zero, ..GOOD };
        run(&mut supervisor, &[(zero(Zero::Invalid), None), (zero(Zero::Taring), None)]);
        assert_eq!(supervisor.step(&zero(Zero::Refused), None).mode, Mode::Starting);
        let again = supervisor.step(&zero(Zero::Refused), None);
        assert!(again.start_tare);
        assert_eq!(supervisor.cause(), Some(Fault::ZeroInvalid));
    }
}
