//! Everything the dashboard knows.

use super::{
    answers::Answer,
    event::Event,
    requests::{self, request_text},
    signals::{
        history::History,
        panel::{self, Panel},
        timing::Timing,
    },
};
use moca_msgs::{
    GripperRequest, GripperState, Law, Mode, Refusal, Request, Sample, TargetRefusal,
    protection::ContactPhase, seconds,
};
use moca_telemetry::{
    RobotDescription,
    calibration::CalibrationProgress,
    net::{Commander, Link, Reply, Status, Update},
};
use std::{collections::VecDeque, sync::Arc};

/// Events and messages kept.
const MAX_REMEMBERED: usize = 200;
/// Without a sample for this long, what is shown is old, s.
pub const SILENCE_S: f64 = 0.5;

/// Freshness of the shown data.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Freshness {
    /// Samples come.
    Live,
    /// Connected, but no samples come.
    Silent,
    /// No daemon, and why.
    Down(String),
}

/// Everything the dashboard knows. `now_s` is any clock that never runs backwards, s.
pub struct Model {
    /// The robot; the last one seen while the daemon is away.
    pub robot: Arc<RobotDescription>,
    /// The paper's plots.
    pub panels: Vec<Panel>,
    /// The plots of loop and board.
    pub timing_panels: Vec<Panel>,
    /// Timing of loop and board.
    pub timing: Timing,
    /// The plotted signals.
    pub history: History,
    /// The newest sample.
    pub latest: Option<Sample>,
    /// Changes of mode and fault, oldest first.
    pub events: VecDeque<Event>,
    /// Status of this connection at the daemon.
    pub status: Status,
    /// Progress of the calibration.
    pub calibration: CalibrationProgress,
    /// The law that arming leads to, as far as this dashboard knows.
    pub law: Law,
    /// True for a recorded run: it is never old, and cannot be commanded.
    pub recorded: bool,
    link: Link,
    session: u64,
    latest_at_s: f64,
    answers: Vec<Answer>,
    pressed: Option<(u8, f64)>,
}

impl Default for Model {
    fn default() -> Self {
        Self {
            robot: Arc::default(),
            panels: Vec::new(),
            timing_panels: Vec::new(),
            timing: Timing::default(),
            history: History::default(),
            latest: None,
            events: VecDeque::new(),
            status: Status::default(),
            calibration: CalibrationProgress::default(),
            law: Law::default(),
            recorded: false,
            link: Link::Down { reason: "not connected yet".into() },
            session: 0,
            latest_at_s: f64::NEG_INFINITY,
            answers: Vec::new(),
            pressed: None,
        }
    }
}

impl Model {
    /// Takes in what a source delivered.
    pub fn take(&mut self, update: Update, now_s: f64) {
        if let Link::Up { session, description } = &update.link {
            if *session != self.session {
                self.begin(*session, Arc::clone(description));
            } else if !Arc::ptr_eq(&self.robot, description) {
                // A changed parameter is no other robot.
                self.robot = Arc::clone(description);
            }
        }
        if matches!(update.link, Link::Down { .. }) {
            self.pressed = None;
        }
        self.link = update.link;
        self.status = update.status;
        self.calibration = update.calibration;
        for sample in &update.samples {
            self.history.push(sample);
            self.timing.add(sample);
            self.note_event(sample);
        }
        if let Some(last) = update.samples.into_iter().next_back() {
            if last.mode.moves() {
                self.law = if last.mode == Mode::FollowMe { Law::FollowMe } else { Law::Impedance };
            }
            self.latest = Some(last);
            self.latest_at_s = now_s;
        }
        self.answers.extend(update.notices.into_iter().map(Answer::bad));
        for reply in update.replies {
            self.note_reply(reply);
        }
    }

    /// Returns the freshness of the shown data.
    pub fn freshness(&self, now_s: f64) -> Freshness {
        match &self.link {
            Link::Down { reason } => Freshness::Down(reason.clone()),
            Link::Up { .. } if !self.recorded && now_s - self.latest_at_s > SILENCE_S => Freshness::Silent,
            Link::Up { .. } => Freshness::Live,
        }
    }

    /// Time since the last sample came, s; NaN before the first and without a connection.
    pub fn silent_for_s(&self, now_s: f64) -> f64 {
        match self.link {
            Link::Up { .. } if self.latest_at_s.is_finite() => now_s - self.latest_at_s,
            _ => f64::NAN,
        }
    }

    /// The mode, unless what is known of it is old.
    pub fn mode(&self, now_s: f64) -> Option<Mode> {
        let live = self.freshness(now_s) == Freshness::Live;
        self.latest.as_ref().filter(|_| live).map(|s| s.mode)
    }

    /// Returns the gripper as the newest sample has it; `None` of a robot without one.
    pub fn gripper(&self) -> Option<&GripperState> {
        self.latest.as_ref()?.gripper.as_ref()
    }

    /// The mode of a robot that runs; a log has none, whatever it shows.
    pub fn live_mode(&self, now_s: f64) -> Option<Mode> {
        self.mode(now_s).filter(|_| !self.recorded)
    }

    /// Returns true if a running robot is at the other end: it can be stopped, whoever has the command.
    pub fn connected(&self) -> bool {
        !self.recorded && matches!(self.link, Link::Up { .. })
    }

    /// Returns true if a request makes sense now.
    pub fn allows(&self, request: Request, now_s: f64) -> bool {
        let may_ask = if request == Request::Stop { self.connected() } else { self.may_command() };
        may_ask && requests::fits(request, self.mode(now_s))
    }

    /// Returns true if this dashboard has the command, or can take it.
    pub fn may_command(&self) -> bool {
        self.connected() && self.status.commander != Commander::Another
    }

    /// Returns true if a cover reads pushes on the simulated robot: a real board beside it does not.
    pub fn feels_pushes(&self) -> bool {
        let simulated = |port: &str| port.starts_with("virtual") || port == "avr" || port.starts_with("avr:");
        let real = self.robot.text("board.port").is_some_and(|port| !simulated(port));
        self.robot.simulated && !self.robot.taxels.is_empty() && !real
    }

    /// Returns true if taxels can be pushed with the mouse.
    pub fn can_push(&self) -> bool {
        self.feels_pushes() && self.may_command()
    }

    /// Says which taxel the mouse holds pressed and how hard, and gives the requests that make it so.
    pub fn push(&mut self, wanted: Option<(u8, f64)>) -> Vec<Request> {
        let wanted = wanted.filter(|_| self.can_push());
        if wanted == self.pressed {
            return Vec::new();
        }
        let press = |(taxel, force_n)| Request::PressTaxel { taxel, force_n };
        let released = self.pressed.filter(|(taxel, _)| wanted.is_none_or(|(t, _)| t != *taxel));
        self.pressed = wanted;
        released.map(|(taxel, _)| press((taxel, 0.0))).into_iter().chain(wanted.map(press)).collect()
    }

    /// The taxel that the mouse holds pressed.
    pub fn pushed(&self) -> Option<u8> {
        self.pressed.map(|(taxel, _)| taxel)
    }

    /// The answers to requests since the last call.
    pub fn take_answers(&mut self) -> Vec<Answer> {
        std::mem::take(&mut self.answers)
    }

    /// A new daemon: its clock and its ticks start anew, so nothing of the old one can stay on the axes.
    fn begin(&mut self, session: u64, robot: Arc<RobotDescription>) {
        self.session = session;
        self.panels = panel::panels(&robot);
        self.timing_panels = panel::timing_panels();
        let panels = self.panels.iter().chain(&self.timing_panels);
        let signals = panels.flat_map(|p| p.traces.iter().map(|(_, signal)| *signal));
        let signals = signals.collect();
        self.history = if self.recorded { History::of_log(signals) } else { History::new(signals) };
        self.timing = Timing::default();
        self.robot = robot;
        self.latest = None;
        self.latest_at_s = f64::NEG_INFINITY;
        self.events.clear();
        self.law = Law::default();
        self.pressed = None;
    }

    fn note_event(&mut self, sample: &Sample) {
        let (mode, fault, time_s) = (sample.mode, sample.fault, seconds(sample.time_ns));
        let last = self.events.iter().rev().find(|event| event.contact.is_none());
        if last.is_none_or(|last| last.mode != mode || last.fault != fault) {
            self.events.push_back(Event { time_s, mode, fault, contact: None });
        }
        let crossed = sample.contact_events.iter().filter(|c| c.phase == ContactPhase::LimitCrossed);
        self.events.extend(crossed.map(|c| Event { time_s, mode, fault, contact: Some(*c) }));
        while self.events.len() > MAX_REMEMBERED {
            self.events.pop_front();
        }
    }

    /// A refusal as text; a parameter's own with what would be taken.
    fn why(&self, request: Request, refusal: Refusal) -> String {
        match request {
            Request::SetParameter { parameter, .. } => self
                .robot
                .parameters
                .get(usize::from(parameter))
                .map_or_else(|| request.refused(refusal).to_string(), |parameter| parameter.why(refusal)),
            _ => request.refused(refusal).to_string(),
        }
    }

    fn note_reply(&mut self, reply: Reply) {
        let asked = request_text(reply.request);
        let answer = match reply.outcome {
            // It is answered when the fingers begin to move; their state tells the end.
            Ok(()) if matches!(reply.request, Request::Gripper(request) if request != GripperRequest::Stop) => {
                Answer::good(format!("{asked}: begun"))
            }
            Ok(()) => Answer::good(format!("{asked}: done")),
            Err(refusal) => Answer::bad(format!("{asked}: refused, {}", self.why(reply.request, refusal))),
        };
        if let (Request::SelectLaw(law), Ok(())) = (reply.request, reply.outcome) {
            self.law = law;
        }
        // Pushing with the mouse speaks for itself unless it fails.
        // What is asked many times a second is seen on the robot.
        let many = matches!(reply.request, Request::PressTaxel { .. } | Request::Target(_));
        let overtaken = matches!(reply.outcome, Err(Refusal::Target(TargetRefusal::Overtaken)));
        if !(many && (reply.outcome.is_ok() || overtaken)) {
            self.answers.push(answer);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use moca_telemetry::{ParameterDescription, ParameterValue};

    fn up(session: u64) -> Link {
        Link::Up { session, description: Arc::new(RobotDescription::paper("test", true)) }
    }

    fn sample(tick: u64, mode: Mode) -> Sample {
        Sample { tick, time_ns: tick * 1_000_000, mode, ..Sample::default() }
    }

    fn ready() -> Model {
        let mut model = Model::default();
        model.take(Update::new(up(1), vec![sample(0, Mode::Ready), sample(1, Mode::Ready)]), 10.0);
        model
    }

    #[test]
    fn what_is_old_is_not_shown_as_new() {
        let mut model = ready();
        assert_eq!((model.freshness(10.1), model.mode(10.1)), (Freshness::Live, Some(Mode::Ready)));
        assert_eq!((model.freshness(10.6), model.mode(10.6)), (Freshness::Silent, None));
        assert!(!model.allows(Request::Arm, 10.6) && model.allows(Request::Stop, 10.6));
        model.take(Update::new(Link::Down { reason: "gone".into() }, vec![]), 10.7);
        assert_eq!(model.freshness(10.7), Freshness::Down("gone".into()));
        assert!(model.latest.is_some(), "the last picture stays");
    }

    #[test]
    fn a_restarted_daemon_starts_a_new_history() {
        let mut model = ready();
        assert_eq!(model.history.len(), 2);
        model.take(Update::new(up(2), vec![sample(0, Mode::Starting)]), 11.0);
        assert_eq!((model.history.len(), model.events.len()), (1, 1));
        assert_eq!(model.mode(11.0), Some(Mode::Starting));
    }

    #[test]
    fn each_change_of_mode_is_one_event() {
        let mut model = ready();
        let modes = [Mode::Impedance, Mode::Impedance, Mode::ProtectiveStop, Mode::ProtectiveStop];
        model.take(Update::new(up(1), (2..).zip(modes).map(|(t, m)| sample(t, m)).collect()), 10.2);
        let seen: Vec<_> = model.events.iter().map(|e| (e.time_s, e.mode)).collect();
        assert_eq!(seen, [(0.0, Mode::Ready), (0.002, Mode::Impedance), (0.004, Mode::ProtectiveStop)]);
    }

    #[test]
    fn pushing_moves_from_taxel_to_taxel_and_always_lets_go() {
        let press = |taxel, force_n| Request::PressTaxel { taxel, force_n };
        let mut model = ready();
        assert_eq!(model.push(Some((5, 20.0))), [press(5, 20.0)]);
        assert_eq!(model.push(Some((5, 20.0))), [], "nothing new, nothing sent");
        assert_eq!(model.push(Some((5, 30.0))), [press(5, 30.0)]);
        assert_eq!(model.push(Some((6, 30.0))), [press(5, 0.0), press(6, 30.0)]);
        assert_eq!(model.push(None), [press(6, 0.0)]);
        assert_eq!(model.push(None), []);
    }

    #[test]
    fn a_real_board_feels_no_simulated_hand() {
        for (port, feels) in [("virtual", true), ("auto", false), ("/dev/ttyACM0", false)] {
            let mut model = ready();
            let value = ParameterValue::Text(port.into());
            let parameter = ParameterDescription { name: "board.port".into(), value, ..Default::default() };
            model.robot = Arc::new(RobotDescription {
                parameters: vec![parameter],
                ..RobotDescription::paper("test", true)
            });
            assert_eq!(model.can_push(), feels, "{port}");
            assert_eq!(model.push(Some((5, 20.0))).is_empty(), !feels, "{port}");
        }
    }

    #[test]
    fn a_refusal_says_why_and_a_law_counts_once_it_is_accepted() {
        let mut model = ready();
        let reply = |request, outcome| Update {
            replies: vec![Reply { request, outcome }],
            ..Update::new(up(1), vec![])
        };
        let select = Request::SelectLaw(Law::FollowMe);
        model.take(reply(select, Err(Refusal::NotCommander)), 10.1);
        assert_eq!(model.law, Law::Impedance);
        let answers = model.take_answers();
        let [Answer { text, good: false }] = answers.as_slice() else { panic!("{answers:?}") };
        assert!(text.starts_with("Law follow-me: refused, another client"), "{text}");
        model.take(reply(select, Ok(())), 10.2);
        assert_eq!(model.law, Law::FollowMe);
        assert_eq!(model.take_answers(), [Answer::good("Law follow-me: done")]);
    }
}
