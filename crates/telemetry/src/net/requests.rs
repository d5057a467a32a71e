//! Requests on their way to the loop: a bounded ring, and beside it two flags for what must not wait behind a full one.

use moca_msgs::{GripperRequest, Outcome, Refusal, Request, TargetRefusal};
use rtrb::{Consumer, Producer, RingBuffer};
use std::sync::{
    Arc,
    atomic::{AtomicU64, Ordering},
};

/// Requests and answers on their way.
pub(super) const ROOM: usize = 64;

/// The first two hold the ticket of the last request of their kind that the loop has not taken, 0 without one. Tickets
/// begin at 1.
#[derive(Debug, Default)]
struct Urgent {
    stop: AtomicU64,
    operator_lost: AtomicU64,
    /// Requests before this ticket have no effect any more.
    withdrawn: AtomicU64,
}

/// The end of those who ask.
#[derive(Debug)]
pub struct RequestSender {
    requests: Producer<(u64, Request)>,
    outcomes: Consumer<(u64, Outcome)>,
    urgent: Arc<Urgent>,
}

/// The loop's end: no call waits or allocates.
#[derive(Debug)]
pub struct RequestReceiver {
    requests: Consumer<(u64, Request)>,
    outcomes: Producer<(u64, Outcome)>,
    urgent: Arc<Urgent>,
    /// Ticket of the last stop: what was asked before it must not set the robot in motion after it.
    stopped_at: u64,
}

/// The way from those who ask to the loop and back.
///
/// ```
/// use moca_msgs::Request;
/// let (mut asks, mut answers) = moca_telemetry::net::request_channel();
/// for ticket in 1..=150 {
///     asks.submit(ticket, Request::Arm);
/// }
/// asks.submit(151, Request::Stop);
/// assert_eq!(answers.take(), Some((151, Request::Stop)), "no queue is too full for it");
/// assert_eq!(answers.take(), None, "nothing arms the robot afterwards");
/// ```
pub fn request_channel() -> (RequestSender, RequestReceiver) {
    let (requests, from_sender) = RingBuffer::new(ROOM);
    // As much again for the answers to stops, which need no room in the other ring.
    let (outcomes, from_receiver) = RingBuffer::new(2 * ROOM);
    let urgent = Arc::new(Urgent::default());
    let receiver =
        RequestReceiver { requests: from_sender, outcomes, urgent: Arc::clone(&urgent), stopped_at: 0 };
    (RequestSender { requests, outcomes: from_receiver, urgent }, receiver)
}

impl RequestSender {
    /// Submits a request; `false` without room, which [`Request::Stop`] and [`Request::OperatorLost`] always have.
    /// `ticket` is above 0 and above every ticket before. Of several stops that the loop has not taken yet it answers the
    /// last one, for all.
    pub fn submit(&mut self, ticket: u64, request: Request) -> bool {
        match request {
            Request::Stop => self.urgent.stop.store(ticket, Ordering::Release),
            Request::OperatorLost => self.urgent.operator_lost.store(ticket, Ordering::Release),
            _ => return self.requests.push((ticket, request)).is_ok(),
        }
        true
    }

    /// Withdraws what was asked before `ticket` and would set the robot in motion: the loop refuses it with
    /// [`Refusal::Stopped`]. A robot that moves goes on.
    pub fn withdraw(&mut self, ticket: u64) {
        self.urgent.withdrawn.fetch_max(ticket, Ordering::AcqRel);
    }

    /// The loop's next answer.
    pub fn outcome(&mut self) -> Option<(u64, Outcome)> {
        self.outcomes.pop().ok()
    }
}

impl RequestReceiver {
    /// The next request with its ticket: a stop before everything else.
    pub fn take(&mut self) -> Option<(u64, Request)> {
        let urgent =
            [(&self.urgent.stop, Request::Stop), (&self.urgent.operator_lost, Request::OperatorLost)];
        for (flag, request) in urgent {
            let ticket = flag.swap(0, Ordering::AcqRel);
            if ticket > 0 {
                self.stopped_at = self.stopped_at.max(ticket);
                return Some((ticket, request));
            }
        }
        self.stopped_at = self.stopped_at.max(self.urgent.withdrawn.load(Ordering::Acquire));
        while let Ok((ticket, request)) = self.requests.pop() {
            // Of targets that come faster than ticks the newest counts.
            if matches!(request, Request::Target(_)) && self.leads_next() {
                self.answer(ticket, Err(Refusal::Target(TargetRefusal::Overtaken)));
                continue;
            }
            let moves = match request {
                Request::Arm | Request::Resume | Request::Recentre => true,
                Request::Gripper(request) => request != GripperRequest::Stop,
                _ => false,
            };
            if !(moves && ticket < self.stopped_at) {
                return Some((ticket, request));
            }
            self.answer(ticket, Err(Refusal::Stopped));
        }
        None
    }

    /// Returns true if the next request in the ring sets or ends a target.
    fn leads_next(&self) -> bool {
        self.requests.peek().is_ok_and(|(_, next)| matches!(next, Request::Target(_) | Request::EndTarget))
    }

    /// Answers the request with this ticket.
    pub fn answer(&mut self, ticket: u64, outcome: Outcome) {
        // A full ring means that nobody waits for answers any more.
        let _ = self.outcomes.push((ticket, outcome));
    }
}
