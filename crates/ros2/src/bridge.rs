//! The robot for ROS users: a client of the daemon's telemetry like any other, so that the daemon carries nothing of ROS, and
//! who may command is decided where it always is.
//!
//! Out: what every viewer is shown (`/tf`, `/tf_static`, `/joint_states`, `/robot_description`, poses, cover wrench) and
//! [`crate::outputs`]. In: services that ask the loop, targets and motions of a gripper ([`crate::inputs`]), and signs of life.
//! Whoever armed the robot over ROS, or leads it, has to be heard from: any call and any target counts, and any message on
//! `alive`; without one the daemon takes the command away and a moving robot stops. The bridge itself never vouches for anybody.
//! A request to the gripper takes the command only until it is answered, unless a node armed the robot or leads it.
//!
//! A topic gives no answer: why a target or a motion of the gripper is refused is told on `target_refused`.

use crate::cdr;
use crate::inputs::{self, Leader};
use crate::messages::{
    DiagnosticArray, DiagnosticStatus, Empty, Float64MultiArray, GripperCommand, JointState, PoseStamped,
    Text, Time, TriggerResponse, Twist, TwistStamped, WrenchStamped,
};
use crate::outputs;
use crate::transport::{Caller, Qos, ReaderId, ServiceId, Transport, TransportError, WriterId, unix_ns};
use crate::{Message, TypeName};
use moca_msgs::{GripperRequest, Outcome, Request, Sample, TimedTarget};
use moca_telemetry::RobotDescription;
use moca_telemetry::display::{Display, Periods, Sink};
use moca_telemetry::log::{LogError, records::Channel};
use moca_telemetry::net::{Connection, Link, Reply};
use std::collections::BTreeMap;
use std::sync::Arc;
use std::time::{Duration, Instant};

/// Longest wait of a step for calls.
const STEP: Duration = Duration::from_millis(2);
/// Forces and wrenches are sent at most so often, ns of loop time.
const NUMBERS_NS: u64 = 10_000_000;
/// Periods of the topics that every viewer is shown.
const PERIODS: Periods =
    Periods { numbers_ns: DIAGNOSTICS_NS, poses_ns: NUMBERS_NS, fixed_ns: 1_000_000_000 };
/// Diagnostics are sent so often, ns of loop time.
const DIAGNOSTICS_NS: u64 = 1_000_000_000;
/// Topics whose names ROS tools expect; all others are under the prefix.
const GLOBAL: [&str; 4] = ["/tf", "/tf_static", "/joint_states", "/robot_description"];
/// Topics whose last message later nodes receive too.
const LATCHED: [&str; 2] = ["/tf_static", "/robot_description"];
/// Sentences have a log's type, which is no message of ROS nodes.
const LOG: &str = "/log";
const TRIGGER: TypeName = TypeName("std_srvs/srv/Trigger");
/// Services, and what each asks the loop.
const SERVICES: &[(&str, Request)] = &[
    ("tare", Request::Tare),
    ("arm", Request::Arm),
    ("disarm", Request::Disarm),
    ("stop", Request::Stop),
    ("resume", Request::Resume),
    ("end_target", Request::EndTarget),
    ("recentre", Request::Recentre),
    ("gripper/home", Request::Gripper(GripperRequest::Home)),
    ("gripper/release", Request::Gripper(GripperRequest::Release)),
    ("gripper/stop", Request::Gripper(GripperRequest::Stop)),
];
/// Topic of motions of the gripper.
const GRIPPER: &str = "gripper/command";
/// The network is asked so often whether there is one.
const LOOK_AFTER: Duration = Duration::from_secs(1);
/// A refusal is told again after this at the earliest, unless it is another one.
const REFUSALS_EVERY: Duration = Duration::from_millis(100);

/// Names of topics and frames.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct BridgeSettings {
    /// Namespace of topics and services that are not global, such as `/moca`.
    pub prefix: String,
    /// True if `/tf` and `/tf_static` are sent. False where the base's own node places `base_link`.
    pub tf: bool,
}

/// Passes on between a daemon and ROS.
pub struct Bridge {
    transport: Box<dyn Transport + Send>,
    settings: BridgeSettings,
    writers: BTreeMap<&'static str, WriterId>,
    taxels: WriterId,
    wrench: WriterId,
    fingers: WriterId,
    gripper_state: WriterId,
    diagnostics: WriterId,
    alive: ReaderId,
    gripper: ReaderId,
    targets: Vec<Input>,
    leader: Leader,
    refused: WriterId,
    told: Option<(String, Instant)>,
    /// True if the robot was armed over ROS: that node is then watched until the robot is disarmed.
    armed: bool,
    services: Vec<(ServiceId, Request)>,
    waiting: Vec<(Request, ServiceId, Caller)>,
    shown: Option<Shown>,
    /// Last reports on the daemon and on the network, and the time of the last look at the network.
    said: [Option<String>; 2],
    looked: Instant,
}

/// A topic of targets.
#[derive(Clone, Copy)]
struct Input {
    name: &'static str,
    reader: ReaderId,
    read: Read,
}

/// One session of a daemon.
struct Shown {
    session: u64,
    robot: Arc<RobotDescription>,
    display: Display,
    fingers: outputs::Fingers,
    next_numbers_ns: u64,
    next_diagnostics_ns: u64,
}

impl Bridge {
    /// Announces topics and services.
    ///
    /// # Errors
    /// A prefix that is no name, or a transport that is gone.
    pub fn new(
        mut transport: Box<dyn Transport + Send>,
        settings: BridgeSettings,
    ) -> Result<Self, TransportError> {
        let name = |name: &str| format!("{}/{name}", settings.prefix);
        let taxels = transport.writer(&name("taxels"), Float64MultiArray::TYPE, Qos::Reliable)?;
        let wrench = transport.writer(&name("flange_wrench"), WrenchStamped::TYPE, Qos::Reliable)?;
        let fingers = transport.writer(&name("gripper/joint_states"), JointState::TYPE, Qos::Reliable)?;
        let gripper_state =
            transport.writer(&name("gripper/state"), DiagnosticStatus::TYPE, Qos::Reliable)?;
        let diagnostics = transport.writer("/diagnostics", DiagnosticArray::TYPE, Qos::Reliable)?;
        let alive = transport.reader(&name("alive"), Empty::TYPE, Qos::BestEffort)?;
        // Of a command that is sent once nothing may be lost.
        let gripper = transport.reader(&name(GRIPPER), GripperCommand::TYPE, Qos::Reliable)?;
        let refused = transport.writer(&name("target_refused"), Text::TYPE, Qos::Reliable)?;
        let mut targets = Vec::new();
        for (topic, of, read) in inputs() {
            let reader = transport.reader(&name(topic), of, Qos::BestEffort)?;
            targets.push(Input { name: topic, reader, read });
        }
        let mut services = Vec::new();
        for &(service, request) in SERVICES {
            services.push((transport.service(&name(service), TRIGGER)?, request));
        }
        Ok(Self {
            transport,
            settings,
            writers: BTreeMap::new(),
            taxels,
            wrench,
            fingers,
            gripper_state,
            diagnostics,
            alive,
            gripper,
            targets,
            leader: Leader::default(),
            refused,
            told: None,
            armed: false,
            services,
            waiting: Vec::new(),
            shown: None,
            said: [None, None],
            looked: Instant::now(),
        })
    }

    /// Passes on what has come either way, and waits a little for more; `say` hears what there is not, daemon or network,
    /// and when it is there again. Both may come and go.
    ///
    /// # Errors
    /// A sample that is no message.
    pub fn step(&mut self, daemon: &Connection, say: impl Fn(&str)) -> Result<(), LogError> {
        let update = daemon.poll();
        let mut down = None;
        match (&update.link, update.samples.last()) {
            (Link::Up { session, description }, Some(newest)) => {
                if self.shown.as_ref().is_none_or(|shown| shown.session != *session) {
                    self.begin(*session, description, newest, unix_ns())?;
                }
                self.show(&update.samples, unix_ns())?;
            }
            (Link::Up { .. }, None) => {}
            (Link::Down { reason }, _) => {
                self.shown = None;
                down = Some(reason.clone());
            }
        }
        tell(&mut self.said[0], down, &say);
        if self.looked.elapsed() > LOOK_AFTER {
            self.looked = Instant::now();
            tell(&mut self.said[1], self.transport.problem(), &say);
        }
        for reply in &update.replies {
            self.answer(reply, daemon);
        }
        self.ask(daemon);
        self.lead(daemon);
        self.transport.wait(STEP);
        Ok(())
    }

    /// Calls and signs of life go to the daemon; nothing else keeps the command.
    fn ask(&mut self, daemon: &Connection) {
        while self.transport.take(self.alive).is_some() {
            daemon.alive();
        }
        for (service, request) in self.services.clone() {
            while let Some((caller, _)) = self.transport.take_call(service) {
                daemon.alive();
                daemon.request(request);
                self.waiting.push((request, service, caller));
            }
        }
        while let Some((_, payload)) = self.transport.take_from_node(self.gripper) {
            match decoded(&payload) {
                Ok(command) => {
                    daemon.alive();
                    daemon.request(Request::Gripper(inputs::gripper(&command)));
                }
                Err(why) => self.refuse(&format!("{GRIPPER}: {why}")),
            }
        }
    }

    /// Targets go to the daemon; they are signs of life of the node that leads.
    fn lead(&mut self, daemon: &Connection) {
        for Input { name, reader, read } in self.targets.clone() {
            while let Some((node, payload)) = self.transport.take_from_node(reader) {
                // Who sends nothing that can be read does not lead.
                match read(&payload) {
                    Ok(target) if self.leader.takes(&node, Instant::now()) => {
                        daemon.alive();
                        daemon.request(Request::Target(target));
                    }
                    Ok(_) => self.refuse(&format!("{name}: another node leads")),
                    Err(why) => self.refuse(&format!("{name}: {why}")),
                }
            }
        }
    }

    fn refuse(&mut self, why: &str) {
        let now = Instant::now();
        let again = self.told.as_ref().is_some_and(|(told, at)| told == why && now - *at < REFUSALS_EVERY);
        if !again {
            self.told = Some((why.to_owned(), now));
            send(self.transport.as_mut(), self.refused, &Text { data: why.to_owned() });
        }
    }

    fn answer(&mut self, reply: &Reply, daemon: &Connection) {
        if let (Request::Target(timed), Err(refusal)) = (reply.request, reply.outcome) {
            let why = reply.request.refused(refusal);
            return self.refuse(&format!("{}: {why}", timed.target.kind().name()));
        }
        if let Request::Gripper(asked) = reply.request {
            // Arm and base do without this node as before: another client may want them. Who waits for an answer may have armed.
            let others = self.waiting.iter().any(|(request, ..)| !matches!(request, Request::Gripper(_)));
            if !(self.armed || others || self.leader.leads(Instant::now())) {
                daemon.release();
            }
            let is_motion = matches!(asked, GripperRequest::Move { .. } | GripperRequest::Grasp { .. });
            if let (true, Err(refusal)) = (is_motion, reply.outcome) {
                return self.refuse(&format!("{GRIPPER}: {}", reply.request.refused(refusal)));
            }
        }
        let asked = self.waiting.iter().position(|(request, ..)| *request == reply.request);
        let Some((request, service, caller)) = asked.map(|i| self.waiting.remove(i)) else { return };
        if reply.outcome.is_ok() {
            self.armed = match request {
                Request::Arm => true,
                Request::Disarm | Request::Stop => false,
                _ => self.armed,
            };
            // The robot stands, or does without this node as before: somebody else may want it.
            if matches!(request, Request::Disarm | Request::Stop | Request::EndTarget) && !self.armed {
                self.leader.release();
                daemon.release();
            }
        }
        // A caller who has gone waits for none.
        let _ = self.transport.answer(service, &caller, &cdr::encode(&response(request, reply.outcome)));
    }

    fn begin(
        &mut self,
        session: u64,
        robot: &Arc<RobotDescription>,
        newest: &Sample,
        now_unix_ns: u64,
    ) -> Result<(), LogError> {
        let start_unix_ns = now_unix_ns.saturating_sub(newest.time_ns);
        let display = Display::new(robot, start_unix_ns, PERIODS);
        let mut to = ToRos {
            transport: self.transport.as_mut(),
            writers: &mut self.writers,
            settings: &self.settings,
        };
        display.begin(&mut to)?;
        let robot = Arc::clone(robot);
        let (fingers, next_numbers_ns, next_diagnostics_ns) = Default::default();
        self.shown = Some(Shown { session, robot, display, fingers, next_numbers_ns, next_diagnostics_ns });
        Ok(())
    }

    /// Shows what came at `now_unix_ns`.
    fn show(&mut self, samples: &[Sample], now_unix_ns: u64) -> Result<(), LogError> {
        let (Some(shown), Some(newest)) = (&mut self.shown, samples.last()) else { return Ok(()) };
        shown.display.follow_clock(now_unix_ns, newest.time_ns);
        let start_unix_ns = shown.display.start_unix_ns();
        for sample in samples {
            let mut to = ToRos {
                transport: self.transport.as_mut(),
                writers: &mut self.writers,
                settings: &self.settings,
            };
            shown.display.sample(sample, false, &mut to)?;
            let (now_ns, stamp) =
                (sample.time_ns, Time::from_unix_ns(start_unix_ns.saturating_add(sample.time_ns)));
            if now_ns >= shown.next_numbers_ns {
                shown.next_numbers_ns = now_ns + NUMBERS_NS;
                if !sample.taxels.is_empty() {
                    send(self.transport.as_mut(), self.taxels, &outputs::taxels(sample));
                }
                if !sample.q_rad.is_empty() {
                    let wrench = outputs::flange_wrench(sample, stamp.clone());
                    send(self.transport.as_mut(), self.wrench, &wrench);
                }
                if let Some(state) = &sample.gripper {
                    if let Some(joints) = shown.fingers.after(now_ns, state, stamp.clone()) {
                        send(self.transport.as_mut(), self.fingers, &joints);
                    }
                    let state = outputs::gripper(&shown.robot.name, state);
                    send(self.transport.as_mut(), self.gripper_state, &state);
                }
            }
            if now_ns >= shown.next_diagnostics_ns {
                shown.next_diagnostics_ns = now_ns + DIAGNOSTICS_NS;
                let message = outputs::diagnostics(&shown.robot.name, sample, stamp);
                send(self.transport.as_mut(), self.diagnostics, &message);
            }
        }
        Ok(())
    }
}

/// Reader of a payload, or the reason why it is refused.
type Read = fn(&[u8]) -> Result<TimedTarget, String>;

/// Topics of targets, their types, and what is made of a payload.
fn inputs() -> [(&'static str, TypeName, Read); 4] {
    [
        ("target_pose", PoseStamped::TYPE, |bytes| inputs::pose(&decoded(bytes)?)),
        ("target_twist", TwistStamped::TYPE, |bytes| inputs::twist(&decoded(bytes)?)),
        ("cmd_vel", Twist::TYPE, |bytes| inputs::base(&decoded(bytes)?)),
        ("cmd_vel_stamped", TwistStamped::TYPE, |bytes| {
            let TwistStamped { header, twist } = decoded(bytes)?;
            inputs::base(&twist).map(|timed| TimedTarget { stamp_unix_ns: header.stamp.unix_ns(), ..timed })
        }),
    ]
}

fn decoded<M: cdr::Decode>(bytes: &[u8]) -> Result<M, String> {
    cdr::decode(bytes).map_err(|error| error.to_string())
}

/// Returns the answer to the caller of a service.
fn response(request: Request, outcome: Outcome) -> TriggerResponse {
    let message = outcome.map_or_else(|refusal| request.refused(refusal).to_string(), |()| "done".to_owned());
    TriggerResponse { success: outcome.is_ok(), message }
}

/// Sends a message, or drops it: the next one supersedes it.
fn send<M: cdr::Field>(transport: &mut dyn Transport, to: WriterId, message: &M) {
    let _ = transport.write(to, &cdr::encode(message));
}

/// Says what there is not, once, and when it is there again.
fn tell(said: &mut Option<String>, now: Option<String>, say: &impl Fn(&str)) {
    match (&now, &*said) {
        (Some(reason), _) if now != *said => say(reason),
        (None, Some(reason)) => say(&format!("over: {reason}")),
        _ => {}
    }
    *said = now;
}

/// The messages that ROS nodes know, as topics.
struct ToRos<'a> {
    transport: &'a mut dyn Transport,
    writers: &'a mut BTreeMap<&'static str, WriterId>,
    settings: &'a BridgeSettings,
}

impl Sink for ToRos<'_> {
    /// Records are types of our own: they are in the log, and for viewers.
    fn offer_record<C: Channel + Message>(&mut self) -> Result<(), LogError> {
        Ok(())
    }

    fn offer<M: Message>(&mut self, topic: &'static str) -> Result<(), LogError> {
        let hidden = topic == LOG || !self.settings.tf && topic.starts_with("/tf");
        if hidden || self.writers.contains_key(topic) {
            return Ok(());
        }
        let prefix = if GLOBAL.contains(&topic) { "" } else { &self.settings.prefix };
        let qos = if LATCHED.contains(&topic) { Qos::Latched } else { Qos::Reliable };
        // A topic that cannot be announced is missed by whoever looks for it; the others go on.
        if let Ok(writer) = self.transport.writer(&format!("{prefix}{topic}"), M::TYPE, qos) {
            self.writers.insert(topic, writer);
        }
        Ok(())
    }

    fn record<C: Channel + Message>(&mut self, _: u64, _: &C) -> Result<(), LogError> {
        Ok(())
    }

    fn message<M: Message>(&mut self, topic: &'static str, _: u64, message: &M) -> Result<(), LogError> {
        if let Some(writer) = self.writers.get(topic) {
            send(self.transport, *writer, message);
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::messages::{Header, Vector3};
    use crate::transport::memory::Memory;
    use moca_msgs::{Target, TwistAxes};
    use moca_telemetry::net::Address;
    use std::sync::mpsc;

    const MS: u64 = 1_000_000;
    const SECOND: u64 = 1000 * MS;

    fn bridge(memory: Memory) -> Bridge {
        let settings = BridgeSettings { prefix: "/moca".into(), tf: true };
        Bridge::new(Box::new(memory), settings).unwrap()
    }

    /// A daemon that does not run: every request has the answer that there is none.
    fn nobody(test: &str) -> Connection {
        let nowhere = std::env::temp_dir().join(format!("moca-ros2-{}-{test}.sock", std::process::id()));
        Connection::spawn(Address::Unix(nowhere), || {}).unwrap()
    }

    #[test]
    fn who_sends_what_cannot_be_read_does_not_take_the_lead() {
        let sent = |node: &str, frame_id: &str, x| {
            let header = Header { frame_id: frame_id.into(), ..Header::default() };
            let twist = Twist { linear: Vector3::from([x, 0.0, 0.0]), ..Twist::default() };
            let payload = cdr::encode(&TwistStamped { header, twist });
            ("/moca/target_twist".to_owned(), node.as_bytes().to_vec(), payload)
        };
        let mut cut = sent("joystick", "world", 0.5);
        cut.2.truncate(20);
        let from_nodes = vec![
            cut,
            sent("joystick", "map", 0.4),
            sent("planner", "world", 0.1),
            sent("joystick", "world", 0.2),
            sent("planner", "world", 0.3),
        ];
        let mut bridge = bridge(Memory { from_nodes, ..Memory::default() });
        let daemon = nobody("lead");
        bridge.lead(&daemon);
        let asked = daemon.poll().replies.into_iter().map(|reply| reply.request);
        let wanted = [0.1, 0.3].map(|x| {
            let twist = [x, 0.0, 0.0, 0.0, 0.0, 0.0];
            Request::Target(TimedTarget::new(Target::Twist { axes: TwistAxes::World, twist }))
        });
        assert_eq!(asked.collect::<Vec<_>>(), wanted, "what the planner wants, and it alone");
    }

    #[test]
    fn motion_of_the_gripper_is_asked_and_its_refusal_is_told() {
        let sent = |position, max_effort| {
            let payload = cdr::encode(&GripperCommand { position, max_effort });
            ("/moca/gripper/command".to_owned(), b"planner".to_vec(), payload)
        };
        let mut cut = sent(0.02, 0.0);
        cut.2.truncate(12);
        let (heard, written) = mpsc::channel();
        let from_nodes = vec![cut, sent(0.02, 0.0), sent(0.025, 40.0)];
        let mut bridge = bridge(Memory { from_nodes, heard: Some(heard), ..Memory::default() });
        let daemon = nobody("gripper");
        bridge.ask(&daemon);
        let replies = daemon.poll().replies;
        let (speed_m_s, tolerance_m, mass_kg) = (0.05, 0.005, 0.0);
        let grasp = GripperRequest::Grasp { width_m: 0.05, speed_m_s, force_n: 40.0, tolerance_m, mass_kg };
        let wanted = [GripperRequest::Move { width_m: 0.04, speed_m_s }, grasp].map(Request::Gripper);
        assert_eq!(replies.iter().map(|reply| reply.request).collect::<Vec<_>>(), wanted);
        for reply in &replies {
            bridge.answer(reply, &daemon);
        }
        bridge.answer(&Reply { outcome: Ok(()), ..replies[0] }, &daemon);
        let told: Vec<_> =
            written.try_iter().map(|payload| cdr::decode::<Text>(&payload).unwrap().data).collect();
        assert!(told.len() == 2 && told[0].starts_with("gripper/command: "), "{told:?}");
        let no_answer = wanted[1].refused(moca_msgs::Refusal::NoAnswer);
        assert_eq!(told[1], format!("gripper/command: {no_answer}"), "both in the same words, so once");
    }

    #[test]
    fn fingers_and_state_are_sent_with_the_numbers() {
        let (heard, written) = mpsc::channel();
        let mut bridge = bridge(Memory { heard: Some(heard), ..Memory::default() });
        let robot = Arc::new(RobotDescription::paper("test", true));
        let start = 1_790_000_000 * SECOND;
        let gripper = Some(moca_msgs::GripperState { width_m: 0.05, ..Default::default() });
        for (gripper, sent) in [(None, 0), (gripper, 10)] {
            let sample = |time_ns| Sample { time_ns, gripper, ..Sample::default() };
            bridge.begin(1, &robot, &sample(0), start).unwrap();
            for ms in 0..100 {
                bridge.show(&[sample(ms * MS)], start + ms * MS).unwrap();
            }
            let payloads: Vec<_> = written.try_iter().collect();
            let joints = payloads.iter().filter_map(|payload| cdr::decode::<JointState>(payload).ok());
            let fingers: Vec<_> =
                joints.filter(|joints| joints.name == ["finger_joint1", "finger_joint2"]).collect();
            let states = payloads.iter().filter_map(|payload| cdr::decode::<DiagnosticStatus>(payload).ok());
            assert_eq!((fingers.len(), states.count()), (sent, sent));
            assert!(fingers.iter().all(|joints| joints.position == [0.025; 2]));
            assert!(fingers.iter().enumerate().all(|(at, joints)| {
                joints.header.stamp.unix_ns() == start + 10 * MS * u64::try_from(at).unwrap()
            }));
        }
    }

    #[test]
    fn stamps_follow_a_clock_that_is_set_and_ticks_that_are_lost() {
        let (heard, written) = mpsc::channel();
        let mut bridge = bridge(Memory { heard: Some(heard), ..Memory::default() });
        let robot = Arc::new(RobotDescription::paper("test", true));
        let sample = |time_ns| {
            let mut sample = Sample { time_ns, ..Sample::default() };
            sample.q_rad.extend([0.1; 7]);
            sample
        };
        let start = 1_790_000_000 * SECOND;
        bridge.begin(1, &robot, &sample(0), start).unwrap();
        let mut loop_ns = 0;
        // Set back, set ahead or without ticks: what the clock says when a sample of that loop time comes.
        for behind_s in [0, -30, 0, 12] {
            let mut stamp = 0;
            for arrival in 0..250_u64 {
                loop_ns += 10 * MS;
                // One that comes late says nothing.
                let late_ns = if arrival % 5 == 0 { 80_000_000 } else { 0 };
                let now = (start + loop_ns).saturating_add_signed(behind_s * 1_000_000_000 + late_ns);
                bridge.show(&[sample(loop_ns)], now).unwrap();
                // The flange's wrench comes last, but for diagnostics.
                let stamps =
                    written.try_iter().filter_map(|payload| cdr::decode::<WrenchStamped>(&payload).ok());
                stamp = stamps.last().map_or(stamp, |wrench| wrench.header.stamp.unix_ns());
            }
            let wanted = (start + loop_ns).saturating_add_signed(behind_s * 1_000_000_000);
            assert_eq!(stamp, wanted, "{behind_s} s");
        }
    }
}
