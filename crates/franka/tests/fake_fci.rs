//! The connection against an arm of our own that speaks FCI on sockets, both versions, in lock-step: nothing here asks a clock
//! but the silence that the client itself waits for.
#![allow(
    clippy::unwrap_used,
    clippy::expect_used,
    clippy::panic,
    reason = "a test that cannot go on has to stop"
)]

use franka::wire::HeaderLayout;
use franka::wire::robot::{ControllerMode, MotionGeneratorMode, RobotCommand, RobotMode, RobotState, v5};
use franka::{ERROR_NAMES, FciVersion, MoveStatus};
use moca_franka::limiter::CHANGE_NM;
use moca_franka::{Fci, Model, REPEATS_MAX, Settings, carried};
use moca_msgs::arm_errors::ARM_ERRORS;
use moca_msgs::{ArmMode, Fault};
use std::io::{Read, Write};
use std::net::{SocketAddr, TcpListener, TcpStream, UdpSocket};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, Sender, channel};
use std::sync::{Arc, Mutex};
use std::time::Duration;
use zerocopy::{FromBytes, IntoBytes};

/// A busy machine is not a dead peer.
const PATIENCE: Duration = Duration::from_secs(60);

/// State of the simulated arm, shared by its sockets.
struct Arm {
    version: FciVersion,
    count: u64,
    mode: RobotMode,
    errors: u64,
    driven: bool,
    tau_j_d: f64,
    client: Option<SocketAddr>,
    commands: Option<TcpStream>,
    /// Number of the Move command that runs.
    move_id: u32,
}

struct Peer {
    arm: Arc<Mutex<Arm>>,
    states: Arc<UdpSocket>,
    address: String,
    /// Commands that have been answered.
    answered: Receiver<CommandKind>,
    /// Whoever connects is turned away.
    gone: Arc<AtomicBool>,
}

impl Arm {
    fn state(&mut self) -> Vec<u8> {
        self.count += 1;
        let (generator, controller) = match (self.driven, self.version) {
            (false, _) => (MotionGeneratorMode::Idle, ControllerMode::Other),
            (true, FciVersion::V10) => (MotionGeneratorMode::None, ControllerMode::ExternalController),
            (true, FciVersion::V5) => {
                (MotionGeneratorMode::JointVelocity, ControllerMode::ExternalController)
            }
        };
        let errors = std::array::from_fn(|bit| u8::from(self.errors >> bit & 1 == 1));
        let (generator, controller, mode) = (generator.to_u8(), controller.to_u8(), self.mode.to_u8());
        match self.version {
            #[expect(clippy::cast_possible_truncation, reason = "as on the wire")]
            FciVersion::V10 => RobotState {
                message_id: self.count.into(),
                tau_J_d: [(self.tau_j_d as f32).into(); 7],
                motion_generator_mode: generator,
                controller_mode: controller,
                robot_mode: mode,
                errors,
                control_command_success_rate: 1.0.into(),
                ..RobotState::default()
            }
            .as_bytes()
            .to_vec(),
            FciVersion::V5 => v5::RobotState {
                message_id: self.count.into(),
                tau_J_d: [self.tau_j_d.into(); 7],
                motion_generator_mode: generator,
                controller_mode: controller,
                robot_mode: mode,
                errors: errors[..].try_into().unwrap(),
                ..v5::RobotState::default()
            }
            .as_bytes()
            .to_vec(),
        }
    }
}

impl Peer {
    fn start(version: FciVersion) -> Self {
        Self::announcing(version, None)
    }

    /// An arm that says it speaks `only`, which nobody does, if given.
    fn announcing(version: FciVersion, only: Option<u16>) -> Self {
        let listener = TcpListener::bind("127.0.0.1:0").unwrap();
        let address = listener.local_addr().unwrap().to_string();
        let states = Arc::new(UdpSocket::bind("127.0.0.1:0").unwrap());
        states.set_read_timeout(Some(PATIENCE)).unwrap();
        let arm = Arc::new(Mutex::new(Arm {
            version,
            count: 0,
            mode: RobotMode::Idle,
            errors: 0,
            driven: false,
            tau_j_d: 0.0,
            client: None,
            commands: None,
            move_id: 0,
        }));
        let (sender, answered) = channel();
        let (of_thread, udp) = (Arc::clone(&arm), Arc::clone(&states));
        let gone = Arc::new(AtomicBool::new(false));
        let is_gone = Arc::clone(&gone);
        std::thread::spawn(move || {
            for stream in listener.incoming() {
                if is_gone.load(Ordering::Relaxed) {
                    continue;
                }
                serve(stream.unwrap(), &of_thread, &udp, only, &sender);
            }
        });
        Self { arm, states, address, answered, gone }
    }

    fn await_command(&self, kind: CommandKind) {
        while self.answered.recv_timeout(PATIENCE).expect("the client asks for it") != kind {}
    }

    fn say(&self, mode: RobotMode, errors: u64) {
        let mut arm = self.arm.lock().unwrap();
        (arm.mode, arm.errors) = (mode, errors);
        let state = arm.state();
        self.states.send_to(&state, arm.client.unwrap()).unwrap();
    }

    /// The next torque that reaches the arm, and the state that it answers.
    fn torque(&self) -> (u64, f64) {
        let mut bytes = [0; 512];
        let received = self.states.recv(&mut bytes).expect("a torque comes");
        let mut arm = self.arm.lock().unwrap();
        let (id, torque) = match arm.version {
            FciVersion::V10 => {
                let command = RobotCommand::read_from_bytes(&bytes[..received]).unwrap();
                (command.message_id.get(), command.control.tau_J_d[0].get())
            }
            FciVersion::V5 => {
                let command = v5::RobotCommand::read_from_bytes(&bytes[..received]).unwrap();
                (command.message_id.get(), command.control.tau_J_d[0].get())
            }
        };
        arm.tau_j_d = torque;
        (id, torque)
    }

    /// Ends the motion that runs, as a reflex does.
    fn abort(&self, mode: RobotMode, errors: u64) {
        let mut arm = self.arm.lock().unwrap();
        arm.driven = false;
        let id = arm.move_id;
        let command = CommandKind::Move.number(arm.version);
        respond(arm.commands.as_mut().unwrap(), command, id, &[MoveStatus::ReflexAborted.to_u8()]);
        drop(arm);
        self.say(mode, errors);
    }
}

fn respond(stream: &mut TcpStream, command: u32, id: u32, payload: &[u8]) {
    let mut message = HeaderLayout::Robot.encode_header(command, id, payload.len());
    message.extend_from_slice(payload);
    stream.write_all(&message).unwrap();
}

/// Commands that the driver asks for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum CommandKind {
    Connect,
    Move,
    StopMove,
    SetCollisionBehavior,
    AutomaticErrorRecovery,
    GetRobotModel,
}

impl CommandKind {
    /// As both versions of FCI number it; a Panda gives no model.
    const fn number(self, version: FciVersion) -> u32 {
        let (of_v10, of_v5) = match self {
            Self::Connect => (0, 0),
            Self::Move => (1, 1),
            Self::StopMove => (2, 2),
            Self::SetCollisionBehavior => (3, 4),
            Self::AutomaticErrorRecovery => (10, 12),
            Self::GetRobotModel => (11, u32::MAX),
        };
        match version {
            FciVersion::V10 => of_v10,
            FciVersion::V5 => of_v5,
        }
    }
}

const KINDS: [CommandKind; 6] = [
    CommandKind::Connect,
    CommandKind::Move,
    CommandKind::StopMove,
    CommandKind::SetCollisionBehavior,
    CommandKind::AutomaticErrorRecovery,
    CommandKind::GetRobotModel,
];

/// Answers one connection's commands until it closes; where the client then waits for a state, one follows.
fn serve(
    mut stream: TcpStream,
    arm: &Mutex<Arm>,
    states: &UdpSocket,
    only: Option<u16>,
    answered: &Sender<CommandKind>,
) {
    let mut header = [0; 12];
    while stream.read_exact(&mut header).is_ok() {
        let (command, id, size) = HeaderLayout::Robot.decode_header(&header).unwrap();
        let mut payload = vec![0; usize::try_from(size).unwrap() - header.len()];
        stream.read_exact(&mut payload).unwrap();
        let mut arm = arm.lock().unwrap();
        let is = |kind: &&CommandKind| kind.number(arm.version) == command;
        let kind = *KINDS.iter().find(is).expect("a command that is expected");
        let (mut reply, mut state_follows) = (vec![0], false);
        match kind {
            CommandKind::Connect => {
                let word = |at: usize| u16::from_le_bytes([payload[at], payload[at + 1]]);
                let ours = only.unwrap_or(match arm.version {
                    FciVersion::V10 => 10,
                    FciVersion::V5 => 5,
                });
                reply = vec![u8::from(word(0) != ours)];
                reply.extend(ours.to_le_bytes());
                state_follows = word(0) == ours;
                arm.client = Some(SocketAddr::from(([127, 0, 0, 1], word(2))));
                arm.commands = Some(stream.try_clone().unwrap());
            }
            CommandKind::Move => {
                (arm.driven, arm.mode, arm.move_id) = (true, RobotMode::Move, id);
                reply = vec![MoveStatus::MotionStarted.to_u8()];
                state_follows = true;
            }
            CommandKind::StopMove => {
                arm.driven = false;
                if arm.mode == RobotMode::Move {
                    arm.mode = RobotMode::Idle;
                }
                state_follows = true;
            }
            CommandKind::AutomaticErrorRecovery => (arm.mode, arm.errors) = (RobotMode::Idle, 0),
            CommandKind::GetRobotModel => reply.extend(urdf().into_bytes()),
            _ => {}
        }
        respond(&mut stream, command, id, &reply);
        if state_follows {
            let state = arm.state();
            states.send_to(&state, arm.client.unwrap()).unwrap();
        }
        let _ = answered.send(kind);
    }
}

/// As much of an arm's model as its client reads.
fn urdf() -> String {
    let joint = |number: u32| {
        format!(
            "<joint name=\"fr3_joint{number}\" type=\"revolute\"><limit effort=\"87\" lower=\"-2.8\" upper=\"2.8\" \
             velocity=\"2.62\"/><position_based_velocity_limits deceleration_limit=\"6\" velocity_offset=\"0.3\"/></joint>"
        )
    };
    format!("<robot name=\"fr3\">{}</robot>", (1..=7).map(joint).collect::<String>())
}

fn settings(peer: &Peer) -> Settings {
    Settings {
        host: peer.address.clone(),
        model: None,
        priority: 0,
        collision: ([20.0; 7], [30.0; 6]),
        answer_within: PATIENCE,
        carries_kg: 0.0,
    }
}

fn reached(version: FciVersion) -> (Peer, Fci) {
    let peer = Peer::start(version);
    let arm = Fci::spawn(settings(&peer), |_| {}).unwrap();
    peer.await_command(CommandKind::SetCollisionBehavior);
    (peer, arm)
}

/// Says something until the loop hears of it; the client drops what it reads while it starts and stops.
fn heard(peer: &Peer, arm: &mut Fci, mode: RobotMode, errors: u64) -> u64 {
    loop {
        peer.say(mode, errors);
        if let Some(count) = arm.receive(Duration::from_millis(500)) {
            return count;
        }
    }
}

fn driven(version: FciVersion) -> (Peer, Fci) {
    let (peer, mut arm) = reached(version);
    heard(&peer, &mut arm, RobotMode::Idle, 0);
    assert_eq!(arm.link().mode, ArmMode::Idle);
    arm.drive(&[0.0; 7]);
    heard(&peer, &mut arm, RobotMode::Idle, 0);
    peer.await_command(CommandKind::Move);
    (peer, arm)
}

#[test]
fn both_versions_get_torques_within_the_rate() {
    for version in [FciVersion::V10, FciVersion::V5] {
        let (peer, mut arm) = driven(version);
        let mut last = 0.0;
        for tick in 0..200 {
            let count = heard(&peer, &mut arm, RobotMode::Move, 0);
            assert_eq!(arm.link().mode, ArmMode::Torque);
            arm.drive(&[5.0; 7]);
            let (answers, torque) = peer.torque();
            assert_eq!(answers, count, "tick {tick}");
            assert!((torque - last).abs() <= CHANGE_NM + 1e-6, "{last} to {torque} N·m");
            last = torque;
        }
        assert!((last - 5.0).abs() < 1e-9);
        let link = arm.link();
        assert_eq!((link.repeated, link.errors), (0, 0));
        // The loop lets go: the arm's own controller takes over.
        heard(&peer, &mut arm, RobotMode::Move, 0);
        arm.brake();
        peer.await_command(CommandKind::StopMove);
        heard(&peer, &mut arm, RobotMode::Idle, 0);
        assert_eq!(arm.link().mode, ArmMode::Idle);
    }
}

#[test]
fn a_reflex_ends_torque_control_and_is_recovered_when_asked() {
    let (peer, mut arm) = driven(FciVersion::V10);
    heard(&peer, &mut arm, RobotMode::Move, 0);
    arm.drive(&[0.0; 7]);
    peer.torque();
    peer.abort(RobotMode::Reflex, 1 << 6);
    peer.await_command(CommandKind::StopMove);
    arm.brake();
    heard(&peer, &mut arm, RobotMode::Reflex, 1 << 6);
    let link = arm.link();
    assert_eq!((link.mode, link.errors), (ArmMode::Reflex, 1 << 6));
    assert_eq!(ARM_ERRORS[6].name, "joint_reflex");

    arm.recover();
    heard(&peer, &mut arm, RobotMode::Reflex, 1 << 6);
    peer.await_command(CommandKind::AutomaticErrorRecovery);
    heard(&peer, &mut arm, RobotMode::Idle, 0);
    assert_eq!((arm.link().mode, arm.link().errors), (ArmMode::Idle, 0));
    arm.drive(&[0.0; 7]);
    heard(&peer, &mut arm, RobotMode::Idle, 0);
    peer.await_command(CommandKind::Move);
}

#[test]
fn every_error_in_every_mode_is_known_with_its_state() {
    assert!(ARM_ERRORS.iter().map(|error| error.name).eq(ERROR_NAMES), "our table is the client's");
    let (peer, mut arm) = reached(FciVersion::V10);
    for bit in 0..ARM_ERRORS.len() {
        for (said, expected) in [
            (RobotMode::Other, ArmMode::Reflex),
            (RobotMode::Idle, ArmMode::Reflex),
            (RobotMode::Guiding, ArmMode::Reflex),
            (RobotMode::Move, ArmMode::Reflex),
            (RobotMode::Reflex, ArmMode::Reflex),
            (RobotMode::UserStopped, ArmMode::UserStopped),
            (RobotMode::AutomaticErrorRecovery, ArmMode::Recovering),
        ] {
            heard(&peer, &mut arm, said, 1 << bit);
            assert_eq!((arm.link().mode, arm.link().errors), (expected, 1 << bit), "{said:?}");
        }
    }
    for said in [RobotMode::Other, RobotMode::Guiding, RobotMode::Move] {
        heard(&peer, &mut arm, said, 0);
        assert_eq!(arm.link().mode, ArmMode::Refused, "{said:?}");
    }
}

#[test]
fn hanging_loop_repeats_torque_then_releases_arm() {
    let peer = Peer::start(FciVersion::V10);
    let settings = Settings { answer_within: Duration::from_micros(600), ..settings(&peer) };
    let mut arm = Fci::spawn(settings, |_| {}).unwrap();
    peer.await_command(CommandKind::SetCollisionBehavior);
    heard(&peer, &mut arm, RobotMode::Idle, 0);
    arm.drive(&[0.5; 7]);
    heard(&peer, &mut arm, RobotMode::Idle, 0);
    peer.await_command(CommandKind::Move);
    let mut torques = Vec::new();
    for _ in 0..REPEATS_MAX {
        heard(&peer, &mut arm, RobotMode::Move, 0);
        torques.push(peer.torque().1);
    }
    assert!(torques.windows(2).all(|pair| (pair[1] - pair[0]).abs() < 1e-6), "{torques:?}");
    assert_eq!(arm.link().repeated, u64::from(REPEATS_MAX));
    heard(&peer, &mut arm, RobotMode::Move, 0);
    peer.await_command(CommandKind::StopMove);
    // The loop goes on as if nothing had been: torque control begins again only after it let go.
    for _ in 0..5 {
        heard(&peer, &mut arm, RobotMode::Idle, 0);
        assert_eq!(arm.link().mode, ArmMode::Refused);
        arm.drive(&[0.5; 7]);
    }
    assert_eq!(peer.answered.try_recv().ok(), None, "nothing is asked of the arm");
    arm.brake();
    heard(&peer, &mut arm, RobotMode::Idle, 0);
    assert_eq!(arm.link().mode, ArmMode::Idle);
    arm.drive(&[0.5; 7]);
    heard(&peer, &mut arm, RobotMode::Idle, 0);
    peer.await_command(CommandKind::Move);
}

#[test]
fn an_old_wish_recovers_no_later_reflex() {
    let (peer, mut arm) = reached(FciVersion::V10);
    heard(&peer, &mut arm, RobotMode::Reflex, 1 << 6);
    arm.recover();
    heard(&peer, &mut arm, RobotMode::Idle, 0);
    heard(&peer, &mut arm, RobotMode::Reflex, 1 << 6);
    heard(&peer, &mut arm, RobotMode::Reflex, 1 << 6);
    let asked: Vec<_> = peer.answered.try_iter().collect();
    assert!(!asked.contains(&CommandKind::AutomaticErrorRecovery), "{asked:?}");
    assert_eq!(arm.link().mode, ArmMode::Reflex);
}

#[test]
fn an_arm_that_accepts_and_says_nothing_holds_nobody_up() {
    let listener = std::net::TcpListener::bind("127.0.0.1:0").unwrap();
    let peer = Peer::start(FciVersion::V10);
    let host = listener.local_addr().unwrap().to_string();
    let arm = Fci::spawn(Settings { host, ..settings(&peer) }, |_| {}).unwrap();
    let _silent = listener.accept().unwrap();
    let (sender, dropped) = channel();
    std::thread::spawn(move || {
        drop(arm);
        let _ = sender.send(());
    });
    dropped.recv_timeout(PATIENCE).expect("the drop comes to an end");
}

#[test]
fn a_silent_arm_is_lost_and_one_that_begins_anew_is_found_again() {
    let (peer, mut arm) = driven(FciVersion::V10);
    heard(&peer, &mut arm, RobotMode::Move, 0);
    arm.drive(&[0.0; 7]);
    peer.torque();
    // Not a word more, until the client gives up and comes back.
    arm.brake();
    {
        let mut arm = peer.arm.lock().unwrap();
        (arm.count, arm.driven, arm.mode) = (0, false, RobotMode::Idle);
    }
    peer.await_command(CommandKind::SetCollisionBehavior);
    let count = heard(&peer, &mut arm, RobotMode::Idle, 0);
    assert!(count < 10, "the arm counts anew: {count}");
    assert_eq!((arm.link().mode, arm.link().lost), (ArmMode::Idle, 0));
}

#[test]
fn another_version_is_refused_with_the_one_to_install() {
    let peer = Peer::announcing(FciVersion::V10, Some(8));
    let (sender, said) = channel();
    let _arm = Fci::spawn(settings(&peer), move |text| drop(sender.send(text.to_owned()))).unwrap();
    let text = said.recv_timeout(PATIENCE).unwrap();
    assert!(text.contains("speaks FCI 8; this program speaks 10") && text.contains("install"), "{text}");
}

#[test]
fn wrong_arm_is_refused_by_name_and_gets_no_order() {
    for (version, found, wanted) in
        [(FciVersion::V10, Model::Fr3, Model::Panda), (FciVersion::V5, Model::Panda, Model::Fr3)]
    {
        let peer = Peer::start(version);
        let (sender, said) = channel();
        let other = Settings { model: Some(wanted), ..settings(&peer) };
        let mut arm = Fci::spawn(other, move |text| drop(sender.send(text.to_owned()))).unwrap();
        arm.drive(&[0.0; 7]);
        let text = said.recv_timeout(PATIENCE).unwrap();
        assert!(text.contains(found.name()) && text.contains(wanted.name()), "{text}");
        assert!(text.contains(&format!("robot.arm = \"{}\"", found.key())), "{text}");
        // It is tried again, and refused again, and nothing but the connection was asked for.
        let mut asked = Vec::new();
        while asked.iter().filter(|kind| **kind == CommandKind::Connect).count() < 3 {
            asked.push(peer.answered.recv_timeout(PATIENCE).unwrap());
        }
        assert_eq!((arm.link().mode, arm.version()), (ArmMode::Refused, Some(found.version())));
        assert_eq!(said.try_recv().ok(), None, "said once");
        let harmless = |kind: &CommandKind| matches!(kind, CommandKind::Connect | CommandKind::GetRobotModel);
        assert!(asked.iter().all(harmless), "{asked:?}");

        let peer = Peer::start(version);
        let same = Settings { model: Some(found), ..settings(&peer) };
        let mut arm = Fci::spawn(same, |_| {}).unwrap();
        peer.await_command(CommandKind::SetCollisionBehavior);
        heard(&peer, &mut arm, RobotMode::Idle, 0);
        assert_eq!(arm.link().mode, ArmMode::Idle);
    }
}

#[test]
fn missing_payload_report_times_out() {
    let silent = TcpListener::bind("127.0.0.1:0").unwrap();
    let host = silent.local_addr().unwrap().to_string();
    let why = carried(&host, Duration::from_millis(50)).unwrap_err();
    assert!(why.contains("not answered within 0.05 s") && why.contains(&host), "{why}");
    let peer = Peer::start(FciVersion::V10);
    std::thread::scope(|scope| {
        let asked = scope.spawn(|| carried(&peer.address, PATIENCE));
        peer.await_command(CommandKind::Connect);
        while !asked.is_finished() {
            peer.say(RobotMode::Idle, 0);
            std::thread::yield_now();
        }
        assert_eq!(asked.join().unwrap().map(|carried| carried.tool.mass_kg), Ok(0.0));
    });
}

#[test]
fn silent_arm_is_lost_and_not_driven_after_recovery() {
    let (peer, mut arm) = driven(FciVersion::V10);
    heard(&peer, &mut arm, RobotMode::Move, 0);
    arm.drive(&[0.0; 7]);
    peer.torque();
    // Nobody is there any more: no state comes, and who knocks is not let in.
    peer.gone.store(true, Ordering::Relaxed);
    while arm.link().mode != ArmMode::Lost {
        arm.receive(Duration::from_millis(50));
    }
    assert_eq!(arm.link().mode.hindrance(), Some(Fault::ArmStale));
    peer.gone.store(false, Ordering::Relaxed);
    {
        let mut arm = peer.arm.lock().unwrap();
        (arm.driven, arm.mode) = (false, RobotMode::AutomaticErrorRecovery);
    }
    peer.await_command(CommandKind::SetCollisionBehavior);
    // Although the loop still drives: torque control begins when the recovery has ended, and not before.
    while peer.answered.try_recv().is_ok() {}
    for _ in 0..5 {
        heard(&peer, &mut arm, RobotMode::AutomaticErrorRecovery, 0);
        let mode = arm.link().mode;
        assert_eq!((mode, mode.hindrance()), (ArmMode::Recovering, Some(Fault::ArmReflex)));
        arm.drive(&[0.0; 7]);
    }
    assert_eq!(peer.answered.try_recv().ok(), None, "nothing is asked of an arm that recovers");
    arm.brake();
    heard(&peer, &mut arm, RobotMode::Idle, 0);
    assert_eq!(arm.link().mode, ArmMode::Idle);
}
