//! A Franka Hand: its commands, each on a thread that waits for the answer, and its states.

use franka::{FrankaError, Gripper};
use moca_msgs::gripper::{FRANKA_HAND, RELEASE_M_S};
use moca_msgs::{GripperFault, GripperPhase, GripperRequest, GripperState};
use std::sync::Arc;
use std::sync::mpsc::{Receiver, TryRecvError, channel};
use std::time::{Duration, Instant};

/// Time between two attempts to reach the hand.
const PAUSE: Duration = Duration::from_secs(1);

/// End of a command.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum End {
    Done,
    Unsuccessful,
    Failed,
    Aborted,
    Broken,
}

/// A hand on an arm. Every function may wait for up to a second.
pub struct Hand {
    host: String,
    hand: Option<Arc<Gripper>>,
    next_try: Instant,
    /// The latest request, and where its end comes from while it runs.
    request: Option<GripperRequest>,
    running: Option<Receiver<End>>,
    fault: Option<GripperFault>,
    holds: bool,
    /// Largest width that the hand reports, m.
    widest_m: f64,
    say: Box<dyn FnMut(&str) + Send>,
    said_last: String,
}

impl Hand {
    /// A hand of the arm at `host`; it is reached with the first [`Hand::read`]. `say` hears in words what happens to the line.
    pub fn new(host: &str, say: impl FnMut(&str) + Send + 'static) -> Self {
        Self {
            host: host.into(),
            hand: None,
            next_try: Instant::now(),
            request: None,
            running: None,
            fault: None,
            holds: false,
            widest_m: FRANKA_HAND.width_max_m,
            say: Box::new(say),
            said_last: String::new(),
        }
    }

    /// Sends a request. The hand ends the one before.
    pub fn begin(&mut self, request: &GripperRequest) {
        let Some(hand) = self.hand.clone() else { return };
        let (request, widest_m, (end, running)) = (*request, self.widest_m, channel());
        (self.request, self.fault) = (Some(request), None);
        let waits = std::thread::Builder::new().name("hand".into());
        let spawned = waits.spawn(move || {
            // Nobody waits for the end of a request that another one has replaced.
            let _ = end.send(carried_out(&hand, &request, widest_m));
        });
        match spawned {
            Ok(_) => self.running = Some(running),
            Err(_) => self.fault = Some(GripperFault::Failed),
        }
    }

    /// Waits for the hand's next state; `None` if it does not answer.
    pub fn read(&mut self) -> Option<GripperState> {
        let hand = self.reached()?;
        // Before the state: one from before the end would say nothing of it.
        let end = self.running.as_ref().map(Receiver::try_recv);
        let state = match hand.read_once() {
            Ok(state) => state,
            Err(error) => return self.lost(&error),
        };
        self.widest_m = state.max_width;
        match end {
            Some(Err(TryRecvError::Empty)) => return Some(self.state(&state, GripperPhase::Moving)),
            Some(Ok(End::Broken) | Err(TryRecvError::Disconnected)) => {
                (self.hand, self.running) = (None, None);
                return None;
            }
            Some(Ok(_)) | None => {}
        }
        if let Some(Ok(end)) = end {
            self.running = None;
            self.fault = self.fault_of(end, state.width);
        } else if self.holds && !state.is_grasped && self.fault.is_none() {
            self.fault = Some(GripperFault::Lost);
        }
        self.holds = state.is_grasped;
        let phase = if state.is_grasped { GripperPhase::Holding } else { GripperPhase::Resting };
        Some(self.state(&state, phase))
    }

    fn state(&self, state: &franka::GripperState, phase: GripperPhase) -> GripperState {
        let (width_m, width_max_m) = (state.width, state.max_width);
        GripperState { width_m, width_max_m, phase, fault: self.fault, ..GripperState::default() }
    }

    /// Returns what went wrong with the latest request.
    fn fault_of(&self, end: End, width_m: f64) -> Option<GripperFault> {
        match (end, self.request) {
            (End::Done | End::Broken, _) => None,
            (End::Unsuccessful, Some(GripperRequest::Grasp { width_m: asked_m, tolerance_m, .. })) => {
                GripperFault::of_grasp(asked_m, tolerance_m, width_m).or(Some(GripperFault::Failed))
            }
            (End::Unsuccessful, _) => Some(GripperFault::Blocked),
            (End::Failed, _) => Some(GripperFault::Failed),
            (End::Aborted, _) => Some(GripperFault::Aborted),
        }
    }

    /// Returns the connection. Where there is none, it is tried once in [`PAUSE`].
    fn reached(&mut self) -> Option<Arc<Gripper>> {
        if self.hand.is_none() && Instant::now() >= self.next_try {
            self.next_try = Instant::now() + PAUSE;
            match Gripper::new(&self.host) {
                Ok(hand) => {
                    self.tell(format!("{}: reached, version {}", self.host, hand.server_version()));
                    (self.running, self.holds, self.fault) = (None, false, None);
                    self.hand = Some(Arc::new(hand));
                }
                Err(error) => self.tell(format!("{}: {error}", self.host)),
            }
        }
        self.hand.clone()
    }

    fn lost(&mut self, error: &FrankaError) -> Option<GripperState> {
        self.tell(format!("{}: {error}", self.host));
        self.hand = None;
        None
    }

    /// Says something once, until something else is to be said.
    fn tell(&mut self, text: String) {
        if self.said_last != text {
            (self.say)(&text);
            self.said_last = text;
        }
    }
}

fn carried_out(hand: &Gripper, request: &GripperRequest, widest_m: f64) -> End {
    let answer = match *request {
        GripperRequest::Home => hand.homing(),
        GripperRequest::Move { width_m, speed_m_s } => hand.move_gripper(width_m, speed_m_s),
        GripperRequest::Grasp { width_m, speed_m_s, force_n, tolerance_m, mass_kg: _ } => {
            hand.grasp(width_m, speed_m_s, force_n, tolerance_m, tolerance_m)
        }
        GripperRequest::Release => hand.move_gripper(widest_m, RELEASE_M_S),
        GripperRequest::Stop => hand.stop(),
    };
    match answer {
        Ok(true) => End::Done,
        Ok(false) => End::Unsuccessful,
        Err(FrankaError::Command(why)) if why.contains("aborted") => End::Aborted,
        Err(FrankaError::Command(_) | FrankaError::Protocol(_)) => End::Failed,
        Err(_) => End::Broken,
    }
}
