//! Right to command, requests to the loop, and requests without an answer.

use super::requests::{ROOM, RequestSender};
use super::wire::{COMMAND_LEASE, Commander, unix_now_ns};
use crate::RobotDescription;
use moca_msgs::target::check_trajectory;
use moca_msgs::{
    Outcome, ParameterValues, Refusal, Request, TargetRefusal, TimedTarget, TouchPolicy, Waypoint,
    request::PRESS_FORCE_MAX_N,
};
use std::{
    collections::BTreeMap,
    time::{Duration, Instant},
};

/// Longest wait for an answer of the loop.
pub(super) const ANSWER_TIMEOUT: Duration = Duration::from_millis(500);

/// Targets that may be on their way to the loop: beyond them a client sends more than ten for each tick.
const TARGETS_MAX: u8 = 16;

/// Number of a client, unique in a server's life.
pub(super) type ClientId = u64;

/// An answer for a client.
#[derive(Debug, PartialEq)]
pub(super) struct Answer {
    pub(super) client: ClientId,
    pub(super) id: u64,
    /// Request that it answers; of a trajectory its last pose.
    pub(super) request: Request,
    pub(super) outcome: Outcome,
}

/// The request that stands for a whole trajectory: its last pose, or none.
pub(super) fn trajectory(touch: TouchPolicy, waypoints: &[Waypoint]) -> Request {
    let count = u8::try_from(waypoints.len()).unwrap_or(u8::MAX);
    let nowhere = Waypoint { time_s: 0.0, position_world: [0.0; 3], quaternion_world: [0.0, 0.0, 0.0, 1.0] };
    let waypoint = waypoints.last().copied().unwrap_or(nowhere);
    Request::Waypoint { index: count.saturating_sub(1), count, waypoint, touch }
}

/// The client that holds the command or has asked for it.
struct Commanding {
    client: ClientId,
    /// Last sign of life.
    heard: Instant,
    /// True once a request of its own was carried out. Until then it only keeps others from asking meanwhile: one whose requests
    /// are all refused never had the command, and its end is no loss.
    proven: bool,
    /// True if it has hung up before its first answer.
    gone: bool,
}

struct Pending {
    client: ClientId,
    id: u64,
    deadline: Instant,
    request: Request,
    /// First of the requests that this one was split into: the first refusal of any is the answer.
    first_ticket: u64,
}

/// A change of a parameter that somebody asks for.
#[derive(Debug)]
pub struct ProposedChange<'a> {
    /// Its place in the robot's description.
    pub parameter: u8,
    /// All of its elements.
    pub values: &'a ParameterValues,
    /// Parameters that have been changed since the start, or are about to be.
    pub changed: &'a BTreeMap<u8, ParameterValues>,
    /// Joint angles in the latest sample, rad; none before the first or without an arm.
    pub q_rad: &'a [f64],
}

/// Judges a change of a parameter. It may take some milliseconds: the loop does not wait for it.
pub type Judge = Box<dyn FnMut(&ProposedChange<'_>) -> Outcome + Send>;

/// The way from many clients to one loop.
pub(super) struct Desk {
    judge: Option<Judge>,
    q_rad: Vec<f64>,
    requests: RequestSender,
    taxels: usize,
    commander: Option<Commanding>,
    /// True if the robot may move with nobody in command: it arms itself, and no operator has intervened since the start.
    self_armed: bool,
    /// Leases of clients that asked for one of their own.
    leases: BTreeMap<ClientId, Duration>,
    /// Taxels the commander holds pressed, let go when it leaves.
    pressed: Vec<u8>,
    /// Taxels to be let go as soon as there is room for the request.
    let_go: Vec<u8>,
    pending: BTreeMap<u64, Pending>,
    next_ticket: u64,
    /// Requests that the loop has not answered.
    unanswered: usize,
    /// Changes of parameters on their way: kept until the loop answers, however late.
    changes: BTreeMap<u64, (u8, ParameterValues)>,
    parameters: BTreeMap<u8, ParameterValues>,
}

impl Desk {
    pub(super) fn new(
        requests: RequestSender,
        description: &RobotDescription,
        judge: Option<Judge>,
        self_armed: bool,
    ) -> Self {
        Self {
            self_armed,
            judge,
            q_rad: Vec::new(),
            requests,
            taxels: description.taxels.len(),
            commander: None,
            leases: BTreeMap::new(),
            pressed: Vec::new(),
            let_go: Vec::new(),
            pending: BTreeMap::new(),
            next_ticket: 0,
            unanswered: 0,
            changes: BTreeMap::new(),
            parameters: BTreeMap::new(),
        }
    }

    /// Gives the command to a client unless another has it; whether this one has it now.
    pub(super) fn claim(&mut self, client: ClientId, now: Instant) -> bool {
        let free = self.is_free_for(client);
        if free {
            self.commander = Some(Commanding { client, heard: now, proven: true, gone: false });
        }
        free
    }

    fn is_free_for(&self, client: ClientId) -> bool {
        self.commander.as_ref().is_none_or(|c| c.client == client)
    }

    /// Keeps others from commanding until the loop has answered a request of this client.
    fn reserve(&mut self, client: ClientId, now: Instant) {
        let asks = || Commanding { client, heard: now, proven: false, gone: false };
        self.commander.get_or_insert_with(asks).heard = now;
    }

    /// The command after an answer to `client`: a first request that is carried out gives it, a refusal leaves it free.
    fn settle(&mut self, client: ClientId, carried_out: bool) {
        let asks = |pending: &Pending| pending.client == client && pending.request != Request::Stop;
        let waits = self.pending.values().any(asks);
        let Some(commander) = self.commander.as_mut().filter(|c| c.client == client && !c.proven) else {
            return;
        };
        commander.proven = carried_out;
        if carried_out && commander.gone {
            self.lose(client);
        } else if !carried_out && !waits {
            self.vacate();
        }
    }

    /// Passes a request on to the loop, or refuses it at once.
    pub(super) fn ask(
        &mut self,
        client: ClientId,
        id: u64,
        mut request: Request,
        now: Instant,
    ) -> Option<Answer> {
        let asked = request;
        let refuse = |refusal| Some(Answer { client, id, request: asked, outcome: Err(refusal) });
        if request != Request::Stop && !self.is_free_for(client) {
            return refuse(Refusal::NotCommander);
        }
        if let Request::Target(target) = &mut request
            && let Err(refusal) = self.check_target(target)
        {
            return refuse(refusal.into());
        }
        if matches!(request, Request::Waypoint { .. }) {
            return refuse(TargetRefusal::OutOfTurn.into());
        }
        if let Request::PressTaxel { taxel, force_n } = request {
            if usize::from(taxel) >= self.taxels || !(0.0..=PRESS_FORCE_MAX_N).contains(&force_n) {
                return refuse(Refusal::OutOfRange);
            }
            self.pressed.retain(|t| *t != taxel);
            self.let_go.retain(|t| *t != taxel);
            if force_n > 0.0 {
                self.pressed.push(taxel);
            }
        }
        if let (Request::SetParameter { parameter, values }, Some(judge)) = (&request, &mut self.judge) {
            let mut changed = self.parameters.clone();
            changed.extend(self.changes.values().copied());
            let (parameter, q_rad) = (*parameter, self.q_rad.as_slice());
            let change = ProposedChange { parameter, values, changed: &changed, q_rad };
            if let Err(refusal) = judge(&change) {
                return refuse(refusal);
            }
        }
        // The answer tells whether the value has changed: it must find room on its way back.
        let changes = matches!(request, Request::SetParameter { .. });
        if changes && 2 * self.unanswered >= ROOM {
            return refuse(Refusal::NoAnswer);
        }
        if !self.submit(request) {
            return refuse(Refusal::NoAnswer);
        }
        if request != Request::Stop {
            self.reserve(client, now);
        }
        let (deadline, first_ticket) = (now + ANSWER_TIMEOUT, self.next_ticket);
        self.pending.insert(self.next_ticket, Pending { client, id, deadline, request, first_ticket });
        None
    }

    /// Passes a trajectory on to the loop, pose by pose, or refuses it at once. The answer to its last pose is the answer
    /// to it: after one that is refused all others are out of turn.
    pub(super) fn ask_trajectory(
        &mut self,
        client: ClientId,
        id: u64,
        touch: TouchPolicy,
        waypoints: &[Waypoint],
        now: Instant,
    ) -> Option<Answer> {
        let request = trajectory(touch, waypoints);
        let refuse = |refusal| Some(Answer { client, id, request, outcome: Err(refusal) });
        if !self.is_free_for(client) {
            return refuse(Refusal::NotCommander);
        }
        if let Err(refusal) = check_trajectory(waypoints) {
            return refuse(refusal.into());
        }
        if self.unanswered + waypoints.len() > ROOM {
            return refuse(TargetRefusal::TooMany { most: TARGETS_MAX }.into());
        }
        let count = u8::try_from(waypoints.len()).unwrap_or(u8::MAX);
        let first_ticket = self.next_ticket + 1;
        for (index, waypoint) in (0..count).zip(waypoints) {
            let request = Request::Waypoint { index, count, waypoint: *waypoint, touch };
            if !self.submit(request) {
                return refuse(Refusal::NoAnswer);
            }
            if index + 1 == count {
                self.reserve(client, now);
                let deadline = now + ANSWER_TIMEOUT;
                self.pending
                    .insert(self.next_ticket, Pending { client, id, deadline, request, first_ticket });
            }
        }
        None
    }

    /// Dates a target by the daemon's clock, and refuses what the loop need not hear of.
    fn check_target(&self, timed: &mut TimedTarget) -> Result<(), TargetRefusal> {
        timed.age_s = match timed.stamp_unix_ns {
            0 => 0.0,
            stamp => {
                let now = unix_now_ns();
                moca_msgs::seconds(now.saturating_sub(stamp)) - moca_msgs::seconds(stamp.saturating_sub(now))
            }
        };
        timed.check()?;
        timed.check_age()?;
        if self.unanswered >= usize::from(TARGETS_MAX) {
            return Err(TargetRefusal::TooMany { most: TARGETS_MAX });
        }
        Ok(())
    }

    /// Notes the joint angles of the latest sample, rad.
    pub(super) fn see_posture(&mut self, q_rad: &[f64]) {
        q_rad.clone_into(&mut self.q_rad);
    }

    /// Takes the command from a client that has gone without giving it back. A moving robot stops, whoever armed it: with
    /// its commander the person who watched it is gone. One that waits for its first answer is judged by that answer, and
    /// meanwhile nothing that it asked for sets the robot in motion.
    pub(super) fn lose(&mut self, client: ClientId) {
        let Some(commander) = self.commander.as_mut().filter(|c| c.client == client) else { return };
        if commander.proven {
            self.self_armed = false;
            self.submit(Request::OperatorLost);
            self.vacate();
        } else {
            commander.gone = true;
            self.next_ticket += 1;
            self.requests.withdraw(self.next_ticket);
        }
    }

    /// Sets how long a client may be silent while it commands.
    pub(super) fn set_lease(&mut self, client: ClientId, lease: Duration) {
        self.leases.insert(client, lease);
    }

    /// Forgets a client whose connection has ended.
    pub(super) fn forget(&mut self, client: ClientId) {
        self.lose(client);
        self.leases.remove(&client);
    }

    /// Takes the command from a client that gives it back. Nothing moves without somebody responsible: an armed robot is
    /// disarmed, unless it armed itself and no operator has intervened.
    pub(super) fn release(&mut self, client: ClientId) {
        if !self.is_commander(client) {
            return;
        }
        let arms = |pending: &Pending| pending.client == client && pending.request == Request::Arm;
        let stays = self.self_armed && !self.pending.values().any(arms);
        // Without room in the queue the robot stops at once instead.
        if !stays && !self.submit(Request::Disarm) {
            self.submit(Request::OperatorLost);
        }
        self.vacate();
    }

    fn vacate(&mut self) {
        self.commander = None;
        self.let_go.append(&mut self.pressed);
        self.let_go_of_taxels();
    }

    /// Returns true if this client holds the command.
    pub(super) fn is_commander(&self, client: ClientId) -> bool {
        self.commander.as_ref().is_some_and(|c| c.client == client)
    }

    fn let_go_of_taxels(&mut self) {
        while let Some(&taxel) = self.let_go.last() {
            if !self.submit(Request::PressTaxel { taxel, force_n: 0.0 }) {
                break;
            }
            self.let_go.pop();
        }
    }

    /// Notes a sign of life.
    pub(super) fn hear(&mut self, client: ClientId, now: Instant) {
        if let Some(commander) = self.commander.as_mut().filter(|c| c.client == client) {
            commander.heard = now;
        }
    }

    /// Returns the loop's answers, and the requests that it failed to answer in time. Takes the command from a silent client.
    pub(super) fn answers(&mut self, now: Instant) -> Vec<Answer> {
        let silent = self.commander.as_ref().filter(|commander| {
            let lease = self.leases.get(&commander.client).copied().unwrap_or(COMMAND_LEASE);
            now.saturating_duration_since(commander.heard) > lease
        });
        let silent = silent.map(|commander| commander.client);
        if let Some(client) = silent {
            self.lose(client);
        }
        self.let_go_of_taxels();
        let mut answers = Vec::new();
        while let Some((ticket, outcome)) = self.requests.outcome() {
            self.unanswered = self.unanswered.saturating_sub(1);
            if let (Some((number, values)), Ok(())) = (self.changes.remove(&ticket), outcome) {
                self.parameters.insert(number, values);
            }
            if let (Err(refusal), false) = (outcome, self.pending.contains_key(&ticket)) {
                self.refuse_split(ticket, refusal, &mut answers);
            }
            if let Some(answered) = self.pending.remove(&ticket) {
                if answered.request == Request::Stop {
                    // Those that it overtook wanted the same.
                    let overtaken =
                        self.pending.extract_if(..ticket, |_, pending| pending.request == Request::Stop);
                    answers.extend(overtaken.map(|(_, p)| Answer {
                        client: p.client,
                        id: p.id,
                        request: p.request,
                        outcome,
                    }));
                }
                self.close(answered, outcome, outcome.is_ok(), &mut answers);
            }
        }
        // Tickets rise with time, so the first that is not yet due ends the search.
        while let Some(first) = self.pending.first_entry() {
            if first.get().deadline > now {
                break;
            }
            let late = first.remove();
            // The loop may still carry it out: whoever asked is responsible for it.
            self.close(late, Err(Refusal::NoAnswer), true, &mut answers);
        }
        answers
    }

    /// Notes the end of a request, and who commands after it. One that nobody answered may have been carried out.
    fn close(
        &mut self,
        pending: Pending,
        outcome: Outcome,
        maybe_carried_out: bool,
        answers: &mut Vec<Answer>,
    ) {
        let Pending { client, id, request, .. } = pending;
        answers.push(Answer { client, id, request, outcome });
        let intervenes = matches!(
            request,
            Request::Stop | Request::Tare | Request::Resume | Request::Arm | Request::Disarm
        );
        self.self_armed &= !(maybe_carried_out && intervenes);
        if request != Request::Stop {
            self.settle(client, maybe_carried_out);
        }
    }

    /// Answers a request of several parts as soon as one of them is refused.
    fn refuse_split(&mut self, ticket: u64, refusal: Refusal, answers: &mut Vec<Answer>) {
        let whole = self.pending.range(ticket..).next().map(|(last, pending)| (*last, pending.first_ticket));
        if let Some((last, first)) = whole
            && (first..last).contains(&ticket)
            && let Some(whole) = self.pending.remove(&last)
        {
            self.close(whole, Err(refusal), false, answers);
        }
    }

    /// Present values of the parameters that have been changed.
    pub(super) fn parameters(&self) -> &BTreeMap<u8, ParameterValues> {
        &self.parameters
    }

    /// Returns true if an answer is awaited.
    pub(super) fn waits(&self) -> bool {
        !self.pending.is_empty()
    }

    /// Returns the holder of the command, as `client` sees it.
    pub(super) fn commander_seen_by(&self, client: ClientId) -> Commander {
        match &self.commander {
            None => Commander::Nobody,
            Some(c) if c.client == client => Commander::You,
            Some(_) => Commander::Another,
        }
    }

    fn submit(&mut self, request: Request) -> bool {
        self.next_ticket += 1;
        let submitted = self.requests.submit(self.next_ticket, request);
        self.unanswered += usize::from(submitted);
        if let (Request::SetParameter { parameter, values }, true) = (request, submitted) {
            self.changes.insert(self.next_ticket, (parameter, values));
        }
        submitted
    }
}

#[cfg(test)]
#[allow(clippy::unwrap_used, clippy::panic, reason = "a test that cannot go on has to stop")]
mod tests {
    use super::super::requests::{RequestReceiver, request_channel};
    use super::*;
    use moca_msgs::{ParameterValues, target::MAX_WAYPOINTS};

    fn desk() -> (Desk, RequestReceiver) {
        let (requests, robot) = request_channel();
        (Desk::new(requests, &RobotDescription::paper("test", true), None, false), robot)
    }

    fn asked(robot: &mut RequestReceiver) -> Option<Request> {
        robot.take().map(|(_, request)| request)
    }

    /// Asks, and has the loop carry it out.
    fn carried_out(desk: &mut Desk, robot: &mut RequestReceiver, request: Request, now: Instant) {
        assert_eq!(desk.ask(1, 0, request, now), None);
        let (ticket, taken) = robot.take().unwrap();
        assert_eq!(taken, request);
        robot.answer(ticket, Ok(()));
        assert_eq!(desk.answers(now).len(), 1);
    }

    #[test]
    fn a_commander_that_falls_silent_loses_the_command_and_lets_go() {
        let (mut desk, mut robot) = desk();
        let start = Instant::now();
        let press = Request::PressTaxel { taxel: 2, force_n: 10.0 };
        carried_out(&mut desk, &mut robot, press, start);

        let alive = start + COMMAND_LEASE;
        desk.hear(1, alive);
        desk.answers(alive + COMMAND_LEASE);
        assert_eq!(desk.commander_seen_by(1), Commander::You, "a sign of life keeps the command");
        desk.hear(2, alive + COMMAND_LEASE);
        desk.answers(alive + COMMAND_LEASE + Duration::from_millis(1));
        assert_eq!(desk.commander_seen_by(1), Commander::Nobody);
        assert_eq!(asked(&mut robot), Some(Request::OperatorLost));
        assert_eq!(asked(&mut robot), Some(Request::PressTaxel { taxel: 2, force_n: 0.0 }));
        assert_eq!(desk.ask(2, 1, Request::Tare, alive + COMMAND_LEASE), None);
    }

    #[test]
    fn commander_with_a_lease_of_its_own_loses_the_command_after_it() {
        let (mut desk, mut robot) = desk();
        let start = Instant::now();
        let lease = Duration::from_millis(200);
        desk.set_lease(1, lease);
        carried_out(&mut desk, &mut robot, Request::Arm, start);
        desk.answers(start + lease);
        assert_eq!(desk.commander_seen_by(1), Commander::You);
        desk.answers(start + lease + Duration::from_millis(1));
        assert_eq!(asked(&mut robot), Some(Request::OperatorLost));
        // A late sign of life does not bring the command back, and the lease is of one connection only.
        desk.hear(1, start + lease + Duration::from_millis(2));
        assert_eq!(desk.commander_seen_by(1), Commander::Nobody);
        desk.forget(1);
        let later = start + Duration::from_secs(1);
        assert_eq!(desk.ask(1, 2, Request::Tare, later), None);
        desk.answers(later + COMMAND_LEASE);
        assert_eq!(desk.commander_seen_by(1), Commander::You);
    }

    fn refusal(answer: Option<Answer>) -> Option<Refusal> {
        answer.and_then(|answer| answer.outcome.err())
    }

    #[test]
    fn one_client_commands_and_any_other_may_only_stop_the_robot() {
        let (mut desk, mut robot) = desk();
        let now = Instant::now();
        assert_eq!(desk.commander_seen_by(1), Commander::Nobody);
        assert_eq!(desk.ask(2, 1, Request::Stop, now), None, "who stops the robot need not command it");
        assert_eq!((asked(&mut robot), desk.commander_seen_by(2)), (Some(Request::Stop), Commander::Nobody));
        assert!(desk.claim(1, now) && desk.claim(1, now) && !desk.claim(2, now));
        assert_eq!((desk.is_commander(1), desk.is_commander(2)), (true, false));
        assert_eq!(
            (desk.commander_seen_by(1), desk.commander_seen_by(2)),
            (Commander::You, Commander::Another)
        );
        let refused = Answer { client: 2, id: 5, request: Request::Arm, outcome: Err(Refusal::NotCommander) };
        assert_eq!(desk.ask(2, 5, Request::Arm, now), Some(refused));
        // an onlooker's going is no loss
        desk.release(2);
        desk.lose(2);
        assert_eq!((asked(&mut robot), desk.commander_seen_by(1)), (None, Commander::You));
        desk.release(1);
        assert_eq!((asked(&mut robot), asked(&mut robot)), (Some(Request::Disarm), None));
        assert!(desk.claim(2, now), "who gives the command back leaves it to the next");
    }

    #[test]
    fn a_press_is_of_a_taxel_there_is_with_a_force_it_may_have() {
        let (mut desk, mut robot) = desk();
        let now = Instant::now();
        let mut press = |taxel, force_n| {
            let answer = desk.ask(1, 1, Request::PressTaxel { taxel, force_n }, now);
            (refusal(answer), asked(&mut robot).is_some())
        };
        for (taxel, force_n) in [(11, 5.0), (0, -0.1), (0, 1.001 * PRESS_FORCE_MAX_N), (0, f64::NAN)] {
            assert_eq!(
                press(taxel, force_n),
                (Some(Refusal::OutOfRange), false),
                "T{} {force_n} N",
                taxel + 1
            );
        }
        for (taxel, force_n) in [(10, 5.0), (0, 0.0), (0, PRESS_FORCE_MAX_N)] {
            assert_eq!(press(taxel, force_n), (None, true), "T{} {force_n} N", taxel + 1);
        }
    }

    #[test]
    fn who_leaves_lets_go_of_what_it_holds_and_of_nothing_else() {
        let press = |taxel, force_n| Request::PressTaxel { taxel, force_n };
        let (mut desk, mut robot) = desk();
        let now = Instant::now();
        for request in [press(3, 10.0), press(2, 10.0), press(2, 0.0)] {
            assert_eq!(desk.ask(1, 1, request, now), None);
            assert_eq!(asked(&mut robot), Some(request));
        }
        desk.release(1);
        assert_eq!(asked(&mut robot), Some(Request::Disarm));
        assert_eq!((asked(&mut robot), asked(&mut robot)), (Some(press(3, 0.0)), None));

        // No room when it leaves; the next one presses the same taxel before there is.
        for taxel in [4, 5] {
            desk.ask(1, 1, press(taxel, 10.0), now);
        }
        while refusal(desk.ask(1, 1, Request::Disarm, now)).is_none() {}
        desk.release(1);
        while asked(&mut robot).is_some() {}
        assert_eq!(desk.ask(2, 1, press(4, 20.0), now), None);
        assert_eq!(asked(&mut robot), Some(press(4, 20.0)));
        desk.answers(now);
        assert_eq!((asked(&mut robot), asked(&mut robot)), (Some(press(5, 0.0)), None));
    }

    #[test]
    fn every_request_is_answered_or_times_out() {
        let (mut desk, mut robot) = desk();
        let start = Instant::now();
        assert!(!desk.waits());
        for id in [7, 8] {
            assert_eq!(desk.ask(1, id, Request::Disarm, start), None);
        }
        let (ticket, _) = robot.take().unwrap();
        robot.answer(ticket, Err(Refusal::NoRobot));
        let almost = start + ANSWER_TIMEOUT - Duration::from_millis(1);
        assert_eq!(
            desk.answers(almost),
            [Answer { client: 1, id: 7, request: Request::Disarm, outcome: Err(Refusal::NoRobot) }]
        );
        assert!(desk.waits());
        let late = desk.answers(start + ANSWER_TIMEOUT);
        assert_eq!(
            late,
            [Answer { client: 1, id: 8, request: Request::Disarm, outcome: Err(Refusal::NoAnswer) }]
        );
        assert!(!desk.waits());
    }

    #[test]
    fn parameter_changes_leave_room_for_other_requests() {
        let (mut desk, mut robot) = desk();
        let now = Instant::now();
        let values = ParameterValues::new(&[2.0]).unwrap();
        let change = Request::SetParameter { parameter: 3, values };
        for _ in 0..ROOM / 2 {
            assert_eq!(desk.ask(1, 1, change, now), None);
        }
        assert_eq!(refusal(desk.ask(1, 1, change, now)), Some(Refusal::NoAnswer));
        assert_eq!(desk.ask(1, 1, Request::Disarm, now), None);
        for _ in 0..2 {
            let (ticket, _) = robot.take().unwrap();
            robot.answer(ticket, Ok(()));
        }
        desk.answers(now);
        assert_eq!(desk.ask(1, 1, change, now), None, "two are answered");
        assert_eq!(refusal(desk.ask(1, 1, change, now)), Some(Refusal::NoAnswer));
    }

    #[test]
    fn change_is_judged_with_posture_and_pending_changes() {
        let (requests, mut robot) = request_channel();
        let judge: Judge = Box::new(|change| {
            let bent = change.q_rad.first().is_some_and(|q_rad| *q_rad > 1.0);
            if bent || change.changed.contains_key(&9) { Err(Refusal::OutOfRange) } else { Ok(()) }
        });
        let mut desk = Desk::new(requests, &RobotDescription::paper("test", true), Some(judge), false);
        let now = Instant::now();
        let change = |desk: &mut Desk, parameter| {
            let values = ParameterValues::new(&[2.0]).unwrap();
            refusal(desk.ask(1, 1, Request::SetParameter { parameter, values }, now))
        };
        assert_eq!(change(&mut desk, 3), None);
        desk.see_posture(&[1.5]);
        assert_eq!(change(&mut desk, 3), Some(Refusal::OutOfRange));
        desk.see_posture(&[0.5]);
        assert_eq!(change(&mut desk, 9), None);
        assert_eq!(change(&mut desk, 3), Some(Refusal::OutOfRange), "another one is on its way");
        assert_eq!(std::iter::from_fn(|| asked(&mut robot)).count(), 2, "what is refused does not leave");
    }

    #[test]
    fn vanished_commander_stops_and_released_one_disarms() {
        // The robot may have armed itself, or an earlier commander did.
        for request in [Request::Arm, Request::SelectLaw(moca_msgs::Law::FollowMe), Request::Tare] {
            for (releases, expected) in [(false, Request::OperatorLost), (true, Request::Disarm)] {
                let (mut desk, mut robot) = desk();
                carried_out(&mut desk, &mut robot, request, Instant::now());
                if releases {
                    desk.release(1);
                }
                desk.lose(1);
                let heard: Vec<Request> = std::iter::from_fn(|| asked(&mut robot)).collect();
                assert_eq!(heard, [expected], "{request:?}");
            }
        }
    }

    #[test]
    fn refused_request_takes_no_command() {
        let now = Instant::now();
        for hangs_up_first in [false, true] {
            let (mut desk, mut robot) = desk();
            assert_eq!(desk.ask(1, 1, Request::Tare, now), None);
            assert_eq!(refusal(desk.ask(2, 1, Request::Tare, now)), Some(Refusal::NotCommander), "meanwhile");
            let (ticket, _) = robot.take().unwrap();
            robot.answer(ticket, Err(Refusal::Mode(moca_msgs::Mode::Impedance)));
            if hangs_up_first {
                desk.lose(1);
            }
            assert_eq!(desk.answers(now).len(), 1);
            desk.lose(1);
            assert_eq!((asked(&mut robot), desk.commander_seen_by(2)), (None, Commander::Nobody));
        }
        // Nor does what the loop never hears of take the command.
        let (mut desk, mut robot) = desk();
        let nowhere = Request::PressTaxel { taxel: 99, force_n: 1.0 };
        assert_eq!(refusal(desk.ask(1, 1, nowhere, now)), Some(Refusal::OutOfRange));
        assert!(desk.ask_trajectory(1, 1, TouchPolicy::TouchWins, &[], now).is_some());
        desk.lose(1);
        assert_eq!((asked(&mut robot), desk.commander_seen_by(2)), (None, Commander::Nobody));
    }

    #[test]
    fn client_that_hangs_up_before_its_answer_leaves_no_armed_robot() {
        let now = Instant::now();
        // The loop has taken the request, has not yet, or does not answer in time.
        for (taken, answered) in [(true, true), (false, true), (true, false)] {
            let (mut desk, mut robot) = desk();
            assert_eq!(desk.ask(1, 1, Request::Arm, now), None);
            let ticket = if taken { robot.take().map(|(ticket, _)| ticket) } else { None };
            desk.lose(1);
            if let Some(ticket) = ticket.filter(|_| answered) {
                robot.answer(ticket, Ok(()));
            }
            if !taken {
                assert_eq!(robot.take(), None, "nothing arms the robot any more");
            }
            desk.answers(if answered { now } else { now + ANSWER_TIMEOUT });
            assert_eq!(asked(&mut robot), taken.then_some(Request::OperatorLost), "{taken} {answered}");
            assert_eq!(desk.commander_seen_by(2), Commander::Nobody);
        }
    }

    #[test]
    fn self_armed_robot_stays_armed_until_operator_intervenes() {
        let now = Instant::now();
        let law = Request::SelectLaw(moca_msgs::Law::FollowMe);
        for intervention in [Request::Stop, Request::Tare, Request::Resume, Request::Arm, Request::Disarm] {
            let (requests, mut robot) = request_channel();
            let mut desk = Desk::new(requests, &RobotDescription::paper("test", true), None, true);
            carried_out(&mut desk, &mut robot, law, now);
            desk.release(1);
            assert_eq!(asked(&mut robot), None, "startup.arm says so");
            assert_eq!(desk.ask(1, 1, intervention, now), None);
            let (ticket, _) = robot.take().unwrap();
            robot.answer(ticket, Err(Refusal::ZeroInvalid));
            desk.answers(now);
            carried_out(&mut desk, &mut robot, law, now);
            desk.release(1);
            assert_eq!(asked(&mut robot), None, "a refused request changes nothing");
            carried_out(&mut desk, &mut robot, intervention, now);
            carried_out(&mut desk, &mut robot, law, now);
            desk.release(1);
            assert_eq!(asked(&mut robot), Some(Request::Disarm), "{intervention:?}");
        }
        // One that asks to arm and leaves before the answer.
        let (requests, mut robot) = request_channel();
        let mut desk = Desk::new(requests, &RobotDescription::paper("test", true), None, true);
        desk.ask(1, 1, Request::Arm, now);
        desk.release(1);
        let heard: Vec<Request> = std::iter::from_fn(|| asked(&mut robot)).collect();
        assert_eq!(heard, [Request::Arm, Request::Disarm]);
    }

    #[test]
    fn release_behind_a_full_queue_stops_the_robot() {
        let (mut desk, mut robot) = desk();
        let now = Instant::now();
        while refusal(desk.ask(1, 1, Request::EndTarget, now)).is_none() {}
        desk.release(1);
        assert_eq!(asked(&mut robot), Some(Request::OperatorLost));
    }

    #[test]
    fn flood_never_delays_stop_or_lost_operator() {
        let now = Instant::now();
        let press = Request::PressTaxel { taxel: 4, force_n: 20.0 };
        for by_stop in [false, true] {
            let (mut desk, mut robot) = desk();
            carried_out(&mut desk, &mut robot, press, now);
            for id in 0..50 {
                desk.ask(1, id, Request::Disarm, now);
                desk.ask(1, id, Request::Resume, now);
                desk.ask(1, id, Request::Arm, now);
            }
            let stop = if by_stop { Request::Stop } else { Request::OperatorLost };
            if by_stop {
                assert_eq!(desk.ask(2, 1, Request::Stop, now), None);
            }
            desk.lose(1);
            assert_eq!(asked(&mut robot), Some(stop));
            if by_stop {
                assert_eq!(asked(&mut robot), Some(Request::OperatorLost));
            }
            let rest: Vec<Request> = std::iter::from_fn(|| asked(&mut robot)).collect();
            assert!(!rest.is_empty() && rest.iter().all(|r| *r == Request::Disarm), "armed again: {rest:?}");
            desk.answers(now);
            assert_eq!(
                asked(&mut robot),
                Some(Request::PressTaxel { taxel: 4, force_n: 0.0 }),
                "held for ever"
            );
        }
    }

    #[test]
    fn stops_that_overtake_each_other_are_all_answered() {
        let (mut desk, mut robot) = desk();
        let now = Instant::now();
        for client in 1..=3 {
            desk.ask(client, 7, Request::Stop, now);
        }
        let (ticket, request) = robot.take().unwrap();
        assert_eq!((request, robot.take()), (Request::Stop, None));
        robot.answer(ticket, Ok(()));
        let mut answered: Vec<ClientId> = desk.answers(now).iter().map(|answer| answer.client).collect();
        answered.sort_unstable();
        assert_eq!(answered, [1, 2, 3]);
    }

    fn twist(speed: f64) -> TimedTarget {
        let twist = [speed, 0.0, 0.0, 0.0, 0.0, 0.0];
        TimedTarget::new(moca_msgs::Target::Twist { axes: moca_msgs::TwistAxes::World, twist })
    }

    #[test]
    fn of_a_flood_of_targets_the_newest_counts_and_a_stop_passes_it() {
        let (mut desk, mut robot) = desk();
        let now = Instant::now();
        // 10 kHz for a tenth of a second, a loop of 1 kHz that answers at once
        let (mut taken, mut overtaken, mut refused) = (0, 0, 0);
        for id in 0..1000_u32 {
            let target = twist(0.1 * f64::from(id) / 1000.0);
            match desk.ask(1, u64::from(id), Request::Target(target), now).map(|answer| answer.outcome) {
                Some(Err(Refusal::Target(TargetRefusal::TooMany { most: TARGETS_MAX }))) => refused += 1,
                other => assert_eq!(other, None),
            }
            if id % 10 == 9 {
                let (ticket, request) = robot.take().unwrap();
                assert_eq!(request, Request::Target(target), "the newest");
                robot.answer(ticket, Ok(()));
                assert_eq!(robot.take(), None, "one for a tick");
                for answer in desk.answers(now) {
                    match answer.outcome {
                        Ok(()) => taken += 1,
                        Err(refusal) => {
                            assert_eq!(refusal, Refusal::Target(TargetRefusal::Overtaken));
                            overtaken += 1;
                        }
                    }
                }
            }
        }
        assert_eq!((taken, overtaken, refused), (100, 900, 0));
        // a loop that takes none: the queue is bounded, the rest is told so
        let told = (0..100).filter_map(|id| desk.ask(1, id, Request::Target(twist(0.1)), now)).count();
        assert_eq!(told, 100 - usize::from(TARGETS_MAX));
        desk.ask(2, 1, Request::Stop, now);
        assert_eq!(asked(&mut robot), Some(Request::Stop));
    }

    #[test]
    fn an_end_behind_a_target_ends_it() {
        let (mut desk, mut robot) = desk();
        let now = Instant::now();
        desk.ask(1, 1, Request::Target(twist(0.1)), now);
        desk.ask(1, 2, Request::EndTarget, now);
        assert_eq!(asked(&mut robot), Some(Request::EndTarget));
        assert_eq!(asked(&mut robot), None);
        let outcome = desk.answers(now).pop().unwrap().outcome;
        assert_eq!(outcome, Err(Refusal::Target(TargetRefusal::Overtaken)));
    }

    #[test]
    fn targets_are_dated_by_the_daemons_clock_and_one_client_writes() {
        let (mut desk, mut robot) = desk();
        let now = Instant::now();
        let stamped = |ago_s: f64| {
            #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "some nanoseconds")]
            let stamp_unix_ns = unix_now_ns().saturating_sub((ago_s * 1e9) as u64);
            Request::Target(TimedTarget { stamp_unix_ns, age_s: -7.0, ..twist(0.1) })
        };
        assert_eq!(desk.ask(1, 1, stamped(0.1), now), None);
        let Some(Request::Target(TimedTarget { age_s, .. })) = asked(&mut robot) else {
            panic!("the target goes on to the loop")
        };
        assert!((0.1..60.0).contains(&age_s), "{age_s}");
        let refusal = |desk: &mut Desk, client, request| {
            desk.ask(client, 2, request, now).unwrap().outcome.unwrap_err().to_string()
        };
        assert!(refusal(&mut desk, 1, stamped(90.0)).starts_with("age of the target = 90."));
        let ahead = TimedTarget { stamp_unix_ns: unix_now_ns() + 90_000_000_000, ..twist(0.1) };
        assert!(refusal(&mut desk, 1, Request::Target(ahead)).starts_with("age of the target = -"));
        assert_eq!(
            refusal(&mut desk, 1, Request::Target(twist(f64::NAN))),
            "linear speed x is not a finite number"
        );
        assert!(refusal(&mut desk, 2, Request::Target(twist(0.1))).starts_with("another client"));
        assert_eq!(asked(&mut robot), None, "no refused target reaches the loop");
    }

    #[test]
    fn trajectory_is_answered_once() {
        let waypoint =
            |time_s| Waypoint { time_s, position_world: [0.0; 3], quaternion_world: [0.0, 0.0, 0.0, 1.0] };
        let now = Instant::now();
        for refused in [None, Some(0), Some(2)] {
            let (mut desk, mut robot) = desk();
            let poses = [waypoint(0.0), waypoint(1.0), waypoint(2.0)];
            assert_eq!(desk.ask_trajectory(1, 9, TouchPolicy::TouchWins, &poses, now), None);
            for index in 0..3_u8 {
                let (ticket, request) = robot.take().unwrap();
                assert!(matches!(request, Request::Waypoint { index: i, count: 3, .. } if i == index));
                let refusal = Refusal::Target(TargetRefusal::NoSuchPart);
                robot.answer(ticket, if refused == Some(index) { Err(refusal) } else { Ok(()) });
            }
            let answers = desk.answers(now);
            assert_eq!(answers.len(), 1);
            assert_eq!((answers[0].id, answers[0].outcome.is_ok()), (9, refused.is_none()));
        }
        let (mut desk, mut robot) = desk();
        let backwards = [waypoint(1.0), waypoint(0.0)];
        let answer = desk.ask_trajectory(1, 9, TouchPolicy::TouchWins, &backwards, now).unwrap();
        assert!(answer.outcome.unwrap_err().to_string().starts_with("time of a pose"));
        assert!(desk.ask_trajectory(1, 9, TouchPolicy::TouchWins, &[], now).unwrap().outcome.is_err());
        // a client cannot feed poses past that check
        let request =
            Request::Waypoint { index: 0, count: 1, waypoint: waypoint(0.0), touch: TouchPolicy::TouchWins };
        assert!(desk.ask(1, 1, request, now).unwrap().outcome.is_err());
        assert_eq!(asked(&mut robot), None);
    }

    #[test]
    fn trajectory_is_queued_whole_and_not_refused_for_others() {
        let waypoint =
            |time_s| Waypoint { time_s, position_world: [0.0; 3], quaternion_world: [0.0, 0.0, 0.0, 1.0] };
        let trajectory = |count: u8| (0..count).map(|i| waypoint(f64::from(i))).collect::<Vec<_>>();
        let ask = |desk: &mut Desk, count, now| {
            desk.ask_trajectory(1, 9, TouchPolicy::TouchWins, &trajectory(count), now)
        };
        let (mut desk, mut robot) = desk();
        let now = Instant::now();
        // what the loop refuses without anybody waiting for it any more is no refusal of the trajectory behind it
        assert_eq!(desk.ask(1, 1, Request::Disarm, now), None);
        let later = now + ANSWER_TIMEOUT;
        desk.hear(1, later);
        assert_eq!(desk.answers(later).len(), 1);
        assert_eq!(ask(&mut desk, 2, later), None);
        let (ticket, _) = robot.take().unwrap();
        robot.answer(ticket, Err(Refusal::NoRobot));
        let end = later + ANSWER_TIMEOUT;
        desk.hear(1, end);
        assert_eq!(desk.answers(end - Duration::from_millis(1)), []);
        let late = desk.answers(end);
        assert_eq!(late.len(), 1);
        assert_eq!((late[0].client, late[0].id, late[0].outcome), (1, 9, Err(Refusal::NoAnswer)));
        assert!(matches!(late[0].request, Request::Waypoint { .. }));
        // its two poses are still on their way, with what follows one more than leaves room for the longest trajectory
        let longest = u8::try_from(MAX_WAYPOINTS).unwrap();
        for _ in 0..ROOM - MAX_WAYPOINTS - 1 {
            assert_eq!(desk.ask(1, 1, Request::Disarm, end), None);
        }
        let too_many = Refusal::Target(TargetRefusal::TooMany { most: TARGETS_MAX });
        assert_eq!(refusal(ask(&mut desk, longest, end)), Some(too_many));
        let (ticket, _) = robot.take().unwrap();
        robot.answer(ticket, Ok(()));
        desk.answers(end);
        assert_eq!(ask(&mut desk, longest, end), None);
    }

    #[test]
    fn a_parameter_counts_as_changed_once_the_loop_says_so() {
        let (mut desk, mut robot) = desk();
        let values = ParameterValues::new(&[2.0]).unwrap();
        let now = Instant::now();
        desk.ask(1, 1, Request::SetParameter { parameter: 3, values }, now);
        let (ticket, _) = robot.take().unwrap();
        desk.answers(now);
        assert!(desk.parameters().is_empty());
        robot.answer(ticket, Ok(()));
        desk.answers(now);
        assert_eq!(desk.parameters().get(&3), Some(&values));
    }
}
