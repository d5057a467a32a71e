//! Who may command, what is asked of the loop, and what it has not answered yet.

use super::wire::{COMMAND_LEASE, Commander};
use crate::RobotDescription;
use moca_msgs::{Outcome, ParameterValues, Refusal, Request, request::PRESS_FORCE_MAX_N};
use rtrb::{Consumer, Producer};
use std::{
    collections::BTreeMap,
    time::{Duration, Instant},
};

/// How long the loop may take to answer.
pub(super) const ANSWER_TIMEOUT: Duration = Duration::from_millis(500);

/// Number of a client, unique in a server's life.
pub(super) type ClientId = u64;

/// An answer for a client.
#[derive(Debug, PartialEq)]
pub(super) struct Answer {
    pub(super) client: ClientId,
    pub(super) id: u64,
    pub(super) outcome: Outcome,
}

/// Who holds the command, and when it was last heard.
struct Commanding {
    client: ClientId,
    heard: Instant,
}

struct Pending {
    client: ClientId,
    id: u64,
    deadline: Instant,
}

/// The way from many clients to one loop.
pub(super) struct Desk {
    requests: Producer<(u64, Request)>,
    outcomes: Consumer<(u64, Outcome)>,
    taxels: usize,
    commander: Option<Commanding>,
    /// Who armed the robot, as long as it holds the command.
    armed_by: Option<ClientId>,
    /// Taxels the commander holds pressed, let go when it leaves.
    pressed: Vec<u8>,
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
        requests: Producer<(u64, Request)>,
        outcomes: Consumer<(u64, Outcome)>,
        description: &RobotDescription,
    ) -> Self {
        let taxels = description.taxels.len();
        let pending = BTreeMap::new();
        Self {
            requests,
            outcomes,
            taxels,
            commander: None,
            armed_by: None,
            pressed: Vec::new(),
            pending,
            next_ticket: 0,
            unanswered: 0,
            changes: BTreeMap::new(),
            parameters: BTreeMap::new(),
        }
    }

    /// Gives the command to a client unless another has it; whether this one has it now.
    pub(super) fn claim(&mut self, client: ClientId, now: Instant) -> bool {
        let free = self.commander.as_ref().is_none_or(|c| c.client == client);
        if free {
            self.commander = Some(Commanding { client, heard: now });
        }
        free
    }

    /// Passes a request on to the loop, or refuses it at once.
    pub(super) fn ask(
        &mut self,
        client: ClientId,
        id: u64,
        request: Request,
        now: Instant,
    ) -> Option<Answer> {
        let refuse = |refusal| Some(Answer { client, id, outcome: Err(refusal) });
        if request != Request::Stop && !self.claim(client, now) {
            return refuse(Refusal::NotCommander);
        }
        if request == Request::Arm {
            self.armed_by = Some(client);
        }
        if let Request::PressTaxel { taxel, force_n } = request {
            if usize::from(taxel) >= self.taxels || !(0.0..=PRESS_FORCE_MAX_N).contains(&force_n) {
                return refuse(Refusal::OutOfRange);
            }
            self.pressed.retain(|t| *t != taxel);
            if force_n > 0.0 {
                self.pressed.push(taxel);
            }
        }
        // The answer tells whether the value has changed: it must find room on its way back.
        let changes = matches!(request, Request::SetParameter { .. });
        if changes && 2 * self.unanswered >= self.outcomes.buffer().capacity() {
            return refuse(Refusal::NoAnswer);
        }
        if !self.submit(request) {
            return refuse(Refusal::NoAnswer);
        }
        self.pending.insert(self.next_ticket, Pending { client, id, deadline: now + ANSWER_TIMEOUT });
        None
    }

    /// Takes the command from a client that has gone without giving it back; if it armed the robot, the robot stops.
    pub(super) fn lose(&mut self, client: ClientId) {
        if self.armed_by == Some(client) {
            self.submit(Request::OperatorLost);
        }
        self.release(client);
    }

    /// Takes the command from a client that gives it back.
    pub(super) fn release(&mut self, client: ClientId) {
        if self.commander.as_ref().is_some_and(|c| c.client == client) {
            self.commander = None;
            self.armed_by = None;
            for taxel in std::mem::take(&mut self.pressed) {
                self.submit(Request::PressTaxel { taxel, force_n: 0.0 });
            }
        }
    }

    /// Notes a sign of life.
    pub(super) fn hear(&mut self, client: ClientId, now: Instant) {
        if let Some(commander) = self.commander.as_mut().filter(|c| c.client == client) {
            commander.heard = now;
        }
    }

    /// What the loop has answered, and what it has failed to answer in time. Takes the command from a silent client.
    pub(super) fn answers(&mut self, now: Instant) -> Vec<Answer> {
        let silent =
            self.commander.as_ref().filter(|c| now.saturating_duration_since(c.heard) > COMMAND_LEASE);
        if let Some(client) = silent.map(|c| c.client) {
            self.lose(client);
        }
        let mut answers = Vec::new();
        while let Ok((ticket, outcome)) = self.outcomes.pop() {
            self.unanswered = self.unanswered.saturating_sub(1);
            if let (Some((number, values)), Ok(())) = (self.changes.remove(&ticket), outcome) {
                self.parameters.insert(number, values);
            }
            if let Some(Pending { client, id, .. }) = self.pending.remove(&ticket) {
                answers.push(Answer { client, id, outcome });
            }
        }
        // Tickets rise with time, so the first that is not yet due ends the search.
        while let Some(first) = self.pending.first_entry() {
            if first.get().deadline > now {
                break;
            }
            let Pending { client, id, .. } = first.remove();
            answers.push(Answer { client, id, outcome: Err(Refusal::NoAnswer) });
        }
        answers
    }

    /// Present values of the parameters that have been changed.
    pub(super) fn parameters(&self) -> &BTreeMap<u8, ParameterValues> {
        &self.parameters
    }

    /// Whether an answer is awaited.
    pub(super) fn waits(&self) -> bool {
        !self.pending.is_empty()
    }

    /// Who holds the command, as `client` sees it.
    pub(super) fn commander_seen_by(&self, client: ClientId) -> Commander {
        match &self.commander {
            None => Commander::Nobody,
            Some(c) if c.client == client => Commander::You,
            Some(_) => Commander::Another,
        }
    }

    fn submit(&mut self, request: Request) -> bool {
        self.next_ticket += 1;
        let submitted = self.requests.push((self.next_ticket, request)).is_ok();
        self.unanswered += usize::from(submitted);
        if let (Request::SetParameter { parameter, values }, true) = (request, submitted) {
            self.changes.insert(self.next_ticket, (parameter, values));
        }
        submitted
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rtrb::RingBuffer;

    #[test]
    fn a_commander_that_falls_silent_loses_the_command_and_lets_go() {
        let (to_loop, mut requests) = RingBuffer::new(8);
        let (_outcomes, answers) = RingBuffer::new(8);
        let mut desk = Desk::new(to_loop, answers, &RobotDescription::paper("test", true));
        let start = Instant::now();
        let press = Request::PressTaxel { taxel: 2, force_n: 10.0 };
        assert_eq!(desk.ask(1, 1, press, start), None);
        assert_eq!(requests.pop().unwrap().1, press);

        let alive = start + COMMAND_LEASE;
        desk.hear(1, alive);
        desk.answers(alive + COMMAND_LEASE);
        assert_eq!(desk.commander_seen_by(1), Commander::You, "a sign of life keeps the command");
        desk.hear(2, alive + COMMAND_LEASE);
        desk.answers(alive + COMMAND_LEASE + Duration::from_millis(1));
        assert_eq!(desk.commander_seen_by(1), Commander::Nobody);
        assert_eq!(requests.pop().unwrap().1, Request::PressTaxel { taxel: 2, force_n: 0.0 });
        assert_eq!(desk.ask(2, 1, Request::Tare, alive + COMMAND_LEASE), None);
    }

    #[test]
    fn who_armed_the_robot_and_vanishes_stops_it_and_who_gives_it_back_does_not() {
        for (gives_back, stops) in [(false, true), (true, false)] {
            let (to_loop, mut requests) = RingBuffer::new(8);
            let (_outcomes, answers) = RingBuffer::new(8);
            let mut desk = Desk::new(to_loop, answers, &RobotDescription::paper("test", true));
            desk.ask(1, 1, Request::Arm, Instant::now());
            assert_eq!(requests.pop().unwrap().1, Request::Arm);
            if gives_back {
                desk.release(1);
            }
            desk.lose(1);
            assert_eq!(requests.pop().is_ok_and(|(_, request)| request == Request::OperatorLost), stops);
        }
    }
}
