//! A Franka Hand against one of our own that speaks its protocol on sockets: every answer in every state.
#![allow(clippy::unwrap_used, clippy::panic, reason = "a test that cannot go on has to stop")]

use franka::wire::gripper::{
    GRIPPER_VERSION, GripperCommand, GripperCommandResponse, GripperConnectRequest, GripperConnectResponse,
    GripperState as WireState,
};
use franka::wire::{GRIPPER_HEADER_LEN, HeaderLayout};
use moca_franka::Hand;
use moca_msgs::{GripperFault, GripperPhase, GripperRequest, GripperState};
use std::io::{Read, Write};
use std::net::{SocketAddr, TcpListener, TcpStream, UdpSocket};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex};
use std::time::Duration;
use zerocopy::{FromBytes, IntoBytes};

/// Reads of a state after which something that should have happened never will.
const LOOKS: usize = 2000;

/// State of the simulated hand, shared by its sockets.
struct Inside {
    width_m: f64,
    grasped: bool,
    /// Status with which the next command is answered; `None` lets it run.
    status: Option<u16>,
    commands: Vec<u16>,
    version: u16,
    client: Option<SocketAddr>,
}

struct Peer {
    inside: Arc<Mutex<Inside>>,
    address: String,
    /// Set: nothing is sent any more.
    unplugged: Arc<AtomicBool>,
}

fn read(stream: &mut TcpStream) -> Option<(u16, u32, Vec<u8>)> {
    let mut header = [0; GRIPPER_HEADER_LEN];
    stream.read_exact(&mut header).ok()?;
    let (command, id, size) = HeaderLayout::Gripper.decode_header(&header).unwrap();
    let mut payload = vec![0; usize::try_from(size).unwrap() - GRIPPER_HEADER_LEN];
    stream.read_exact(&mut payload).ok()?;
    Some((u16::try_from(command).unwrap(), id, payload))
}

fn respond(stream: &mut TcpStream, command: u16, id: u32, payload: &[u8]) {
    let mut message = HeaderLayout::Gripper.encode_header(u32::from(command), id, payload.len());
    message.extend_from_slice(payload);
    // One that has hung up needs no answer.
    let _ = stream.write_all(&message);
}

fn serve(mut stream: TcpStream, inside: &Arc<Mutex<Inside>>) {
    let Some((command, id, payload)) = read(&mut stream) else { return };
    let asked = GripperConnectRequest::read_from_bytes(&payload).unwrap();
    let version = inside.lock().unwrap().version;
    let status = u16::from(version != asked.version.get());
    respond(
        &mut stream,
        command,
        id,
        GripperConnectResponse { status: status.into(), version: version.into() }.as_bytes(),
    );
    let to = SocketAddr::new(stream.peer_addr().unwrap().ip(), asked.udp_port.get());
    inside.lock().unwrap().client = Some(to);
    while let Some((command, id, _)) = read(&mut stream) {
        inside.lock().unwrap().commands.push(command);
        let (mut stream, inside) = (stream.try_clone().unwrap(), Arc::clone(inside));
        std::thread::spawn(move || {
            loop {
                if let Some(status) = inside.lock().unwrap().status {
                    respond(
                        &mut stream,
                        command,
                        id,
                        GripperCommandResponse { status: status.into() }.as_bytes(),
                    );
                    return;
                }
                std::thread::sleep(Duration::from_millis(1));
            }
        });
    }
}

impl Peer {
    fn start(version: u16) -> Self {
        let listener = TcpListener::bind("127.0.0.1:0").unwrap();
        let address = listener.local_addr().unwrap().to_string();
        let inside = Inside {
            width_m: 0.08,
            grasped: false,
            status: Some(0),
            commands: vec![],
            version,
            client: None,
        };
        let (inside, unplugged) = (Arc::new(Mutex::new(inside)), Arc::new(AtomicBool::new(false)));
        let (of_streams, gone) = (Arc::clone(&inside), Arc::clone(&unplugged));
        std::thread::spawn(move || {
            for stream in listener.incoming() {
                if !gone.load(Ordering::Relaxed) {
                    let inside = Arc::clone(&of_streams);
                    std::thread::spawn(move || serve(stream.unwrap(), &inside));
                }
            }
        });
        let (of_states, gone) = (Arc::clone(&inside), Arc::clone(&unplugged));
        std::thread::spawn(move || {
            let socket = UdpSocket::bind("127.0.0.1:0").unwrap();
            for message_id in 0_u32.. {
                std::thread::sleep(Duration::from_millis(2));
                let inside = of_states.lock().unwrap();
                let Some(to) = inside.client.filter(|_| !gone.load(Ordering::Relaxed)) else { continue };
                let state = WireState {
                    message_id: message_id.into(),
                    width: inside.width_m.into(),
                    max_width: 0.0798.into(),
                    is_grasped: inside.grasped.into(),
                    temperature: 30.into(),
                };
                let _ = socket.send_to(state.as_bytes(), to);
            }
        });
        Self { inside, address, unplugged }
    }

    fn hand(&self) -> Hand {
        Hand::new(&self.address, |_| ())
    }

    fn set(&self, set: impl FnOnce(&mut Inside)) {
        set(&mut self.inside.lock().unwrap());
    }
}

fn wait(hand: &mut Hand, until: impl Fn(&GripperState) -> bool) -> GripperState {
    for _ in 0..LOOKS {
        if let Some(state) = hand.read().filter(&until) {
            return state;
        }
    }
    panic!("never")
}

fn rests(hand: &mut Hand) -> GripperState {
    wait(hand, |state| state.phase != GripperPhase::Moving)
}

const GRASP: GripperRequest =
    GripperRequest::Grasp { width_m: 0.05, speed_m_s: 0.05, force_n: 40.0, tolerance_m: 0.005, mass_kg: 0.0 };
const MOVE: GripperRequest = GripperRequest::Move { width_m: 0.02, speed_m_s: 0.05 };

#[test]
fn every_answer_to_every_command_in_every_state_is_understood() {
    let peer = Peer::start(GRIPPER_VERSION);
    let mut hand = peer.hand();
    rests(&mut hand);
    let (success, fail, unsuccessful, aborted, unknown) = (0, 1, 2, 3, 99);
    for (request, command) in [
        (GripperRequest::Home, GripperCommand::Homing),
        (GRASP, GripperCommand::Grasp),
        (MOVE, GripperCommand::Move),
        (GripperRequest::Release, GripperCommand::Move),
        (GripperRequest::Stop, GripperCommand::Stop),
    ] {
        for status in [success, fail, unsuccessful, aborted, unknown] {
            for (grasped, width_m) in [(false, 0.0), (false, 0.03), (false, 0.07), (true, 0.05)] {
                peer.set(|inside| {
                    (inside.status, inside.grasped, inside.width_m) = (None, grasped, width_m);
                    inside.commands.clear();
                });
                hand.begin(&request);
                assert_eq!(hand.read().unwrap().phase, GripperPhase::Moving, "{request:?}");
                peer.set(|inside| inside.status = Some(status));
                let state = rests(&mut hand);
                let is_grasp = request == GRASP;
                let fault = match (status, width_m) {
                    (0, _) => None,
                    (2, width) if is_grasp && width <= 0.0 => Some(GripperFault::NothingGrasped),
                    (2, width) if is_grasp && width < 0.045 => Some(GripperFault::TooSmall),
                    (2, width) if is_grasp && width > 0.055 => Some(GripperFault::TooLarge),
                    (2, _) if is_grasp => Some(GripperFault::Failed),
                    (2, _) => Some(GripperFault::Blocked),
                    (3, _) => Some(GripperFault::Aborted),
                    _ => Some(GripperFault::Failed),
                };
                let phase = if grasped { GripperPhase::Holding } else { GripperPhase::Resting };
                assert_eq!((state.phase, state.fault), (phase, fault), "{request:?}, {status}, {width_m}");
                assert_eq!(peer.inside.lock().unwrap().commands, [command.to_u16()]);
            }
        }
    }
}

#[test]
fn hand_that_holds_says_so_to_a_restarted_program() {
    let peer = Peer::start(GRIPPER_VERSION);
    peer.set(|inside| (inside.grasped, inside.width_m) = (true, 0.05));
    for _ in 0..2 {
        let state = rests(&mut peer.hand());
        assert_eq!((state.phase, state.fault), (GripperPhase::Holding, None));
        assert!((state.width_m - 0.05).abs() < 1e-12 && (state.width_max_m - 0.0798).abs() < 1e-12);
    }
    assert!(peer.inside.lock().unwrap().commands.is_empty(), "nothing is asked of it by itself");
}

#[test]
fn object_that_is_gone_without_a_request_is_lost() {
    let peer = Peer::start(GRIPPER_VERSION);
    let mut hand = peer.hand();
    rests(&mut hand);
    peer.set(|inside| (inside.grasped, inside.width_m) = (true, 0.05));
    hand.begin(&GRASP);
    assert!(wait(&mut hand, |state| state.phase == GripperPhase::Holding).fault.is_none());
    peer.set(|inside| (inside.grasped, inside.width_m) = (false, 0.0));
    let lost = wait(&mut hand, |state| state.phase == GripperPhase::Resting);
    assert_eq!(lost.fault, Some(GripperFault::Lost));
    hand.begin(&GripperRequest::Release);
    assert_eq!(wait(&mut hand, |state| state.fault.is_none()).fault, None, "a request ends it");
}

#[test]
fn unplugged_hand_answers_nothing_and_is_found_again_holding() {
    let peer = Peer::start(GRIPPER_VERSION);
    let mut hand = peer.hand();
    peer.set(|inside| (inside.grasped, inside.width_m) = (true, 0.05));
    rests(&mut hand);
    peer.unplugged.store(true, Ordering::Relaxed);
    assert!((0..LOOKS).any(|_| hand.read().is_none()));
    peer.unplugged.store(false, Ordering::Relaxed);
    let mut found = None;
    while found.is_none() {
        found = hand.read();
        std::thread::sleep(Duration::from_millis(1));
    }
    assert_eq!(found.map(|state| state.phase), Some(GripperPhase::Holding));
}

#[test]
fn later_request_replaces_the_one_that_runs() {
    let peer = Peer::start(GRIPPER_VERSION);
    let mut hand = peer.hand();
    rests(&mut hand);
    peer.set(|inside| inside.status = None);
    hand.begin(&MOVE);
    hand.begin(&GripperRequest::Stop);
    assert_eq!(hand.read().unwrap().phase, GripperPhase::Moving);
    peer.set(|inside| inside.status = Some(0));
    assert_eq!(rests(&mut hand).fault, None);
    let mut commands = peer.inside.lock().unwrap().commands.clone();
    commands.sort_unstable();
    assert_eq!(commands, [GripperCommand::Move, GripperCommand::Stop].map(GripperCommand::to_u16));
}

#[test]
fn hand_of_another_version_is_named_and_not_driven() {
    let peer = Peer::start(GRIPPER_VERSION + 1);
    let said = Arc::new(Mutex::new(String::new()));
    let heard = Arc::clone(&said);
    let mut hand = Hand::new(&peer.address, move |text| heard.lock().unwrap().push_str(text));
    assert!(hand.read().is_none());
    let said = said.lock().unwrap();
    assert!(said.contains("server version: 4, library version: 3"), "{said}");
}
