//! A stop gets through whatever others do, and nobody commands who may only read.
#![cfg(feature = "testing")]
#![allow(clippy::unwrap_used, clippy::panic, clippy::print_stdout, reason = "test helpers fail by panicking")]

use moca_msgs::{Mode, Refusal, Request};
use moca_telemetry::{
    RobotDescription,
    net::{
        Address, Client, Connection, Endpoint, Link, NetError, Ports, Server, Serving, Token,
        client::stop_blocking,
        request_channel, serve,
        testing::{Attack, Siege, stop_latencies},
        wire::{self, FromClient, FromServer, Role},
    },
};
use rtrb::RingBuffer;
use std::{
    io::{Read, Write},
    net::TcpStream,
    os::unix::{fs::PermissionsExt, net::UnixStream},
    path::PathBuf,
    sync::{
        Arc, Mutex,
        atomic::{AtomicBool, Ordering},
    },
    thread::JoinHandle,
    time::{Duration, Instant},
};

/// Only to end a test that would hang: nothing is asserted about times.
const HANG: Duration = Duration::from_secs(60);

/// A server, and a loop of 1 kHz that answers everything with yes and sends samples.
struct Robot {
    server: Server,
    heard: Arc<Mutex<Vec<Request>>>,
    ended: Arc<AtomicBool>,
    ticks: Option<JoinHandle<()>>,
    folder: PathBuf,
}

impl Robot {
    fn new(name: &str, port: bool) -> Self {
        let folder = std::env::temp_dir().join(format!("moca-stop-{}-{name}", std::process::id()));
        std::fs::create_dir_all(&folder).unwrap();
        let (mut samples, from_loop) = RingBuffer::new(4096);
        let (requests, mut asked) = request_channel();
        let ports = Ports {
            samples: from_loop,
            requests,
            ring_dropped: Arc::default(),
            recorder: None,
            calibration: None,
            judge: None,
        };
        let address =
            if port { "127.0.0.1:0".parse().unwrap() } else { Address::Unix(folder.join("telemetry.sock")) };
        let token = Some(Token::read_or_create(&folder.join("token")).unwrap());
        let watch = Some(folder.join("watch.sock"));
        let serving = Serving { mode: 0o600, token, watch, ..Serving::default() };
        let server = serve(&address, serving, RobotDescription::paper("test", true), ports).unwrap();
        let (heard, ended) = (Arc::<Mutex<Vec<Request>>>::default(), Arc::new(AtomicBool::new(false)));
        let (hears, ends) = (Arc::clone(&heard), Arc::clone(&ended));
        let ticks = std::thread::spawn(move || {
            let mut sample = moca_msgs::Sample { mode: Mode::Ready, ..Default::default() };
            while !ends.load(Ordering::Relaxed) {
                if let Some((ticket, request)) = asked.take() {
                    hears.lock().unwrap().push(request);
                    asked.answer(ticket, Ok(()));
                }
                sample.tick += 1;
                let _ = samples.push(sample.clone());
                std::thread::sleep(Duration::from_millis(1));
            }
        });
        Self { server, heard, ended, ticks: Some(ticks), folder }
    }

    fn address(&self) -> &Address {
        self.server.address()
    }

    fn endpoint(&self) -> Endpoint {
        Endpoint { token: Some(self.folder.join("token")), ..self.address().into() }
    }

    fn heard(&self) -> Vec<Request> {
        self.heard.lock().unwrap().clone()
    }

    fn port(&self) -> TcpStream {
        let stream = TcpStream::connect(self.address().tcp().unwrap()).unwrap();
        stream.set_read_timeout(Some(HANG)).unwrap();
        stream
    }
}

impl Drop for Robot {
    fn drop(&mut self) {
        self.ended.store(true, Ordering::Relaxed);
        let _ = self.ticks.take().unwrap().join();
        let _ = std::fs::remove_dir_all(&self.folder);
    }
}

fn wait_for(mut done: impl FnMut() -> bool) {
    let start = Instant::now();
    while !done() {
        assert!(start.elapsed() < HANG, "waited {HANG:?} in vain");
        std::thread::sleep(Duration::from_millis(1));
    }
}

fn connect(endpoint: Endpoint) -> Connection {
    let connection = Connection::spawn(endpoint, || {}).unwrap();
    wait_for(|| matches!(connection.poll().link, Link::Up { .. }));
    connection
}

fn outcome(connection: &Connection, request: Request) -> moca_msgs::Outcome {
    connection.request(request);
    let mut outcome = None;
    wait_for(|| {
        outcome = connection.poll().replies.first().map(|reply| reply.outcome);
        outcome.is_some()
    });
    outcome.unwrap()
}

fn runtime() -> tokio::runtime::Runtime {
    tokio::runtime::Builder::new_current_thread().enable_all().build().unwrap()
}

/// The next frame's payload.
fn frame(stream: &mut impl Read) -> Vec<u8> {
    let mut length = [0; 4];
    stream.read_exact(&mut length).unwrap();
    let mut payload = vec![0; u32::from_be_bytes(length) as usize];
    stream.read_exact(&mut payload).unwrap();
    payload
}

/// Regression test: 32 watchers and a commander in the last place, or 400 connections that sent a length and nothing else,
/// kept every stop out.
#[test]
fn stop_is_obeyed_under_every_attack() {
    for port in [false, true] {
        let robot = Robot::new("attacks", port);
        // Attackers on a port have no token: only what they do before a Hello counts there.
        for attack in Attack::ALL {
            let siege = Siege::begin(robot.address(), attack).unwrap();
            std::thread::sleep(Duration::from_millis(300));
            let before = robot.heard().iter().filter(|request| **request == Request::Stop).count();
            let latencies = stop_latencies(robot.address(), 20).unwrap();
            let after = robot.heard().iter().filter(|request| **request == Request::Stop).count();
            assert!(after >= before + 20, "{}: {before} {after}", attack.name());
            println!(
                "{}, {}: p50 {:?}, largest {:?}",
                robot.address(),
                attack.name(),
                latencies[10],
                latencies[19]
            );
            drop(siege);
        }
    }
}

#[test]
fn half_open_handshake_is_closed_and_its_stop_is_still_heard() {
    let robot = Robot::new("half-open", false);
    let Address::Unix(path) = robot.address() else { panic!("a socket file") };
    let mut silent = UnixStream::connect(path).unwrap();
    silent.set_read_timeout(Some(HANG)).unwrap();
    silent.write_all(&[0, 0, 0, 40]).unwrap();
    let mut rest = Vec::new();
    // The daemon hangs up; without that the read would time out.
    silent.read_to_end(&mut rest).unwrap();
    assert_eq!(robot.server.stats().clients, 0, "it never was one");
    assert_eq!(stop_blocking(robot.address()).unwrap(), Ok(()));
    assert_eq!(robot.heard(), [Request::Stop]);
}

#[test]
fn refused_client_is_told_at_once_and_still_stops_the_robot() {
    let robot = Robot::new("refused", false);
    let watching: Vec<Connection> = (0..32).map(|_| connect(robot.endpoint().to_watch())).collect();
    let commander = connect(robot.endpoint());
    assert_eq!(outcome(&commander, Request::Arm), Ok(()));
    let one_more = Connection::spawn(robot.endpoint(), || {}).unwrap();
    wait_for(|| one_more.refusal().is_some());
    assert!(one_more.refusal().unwrap().contains("places and the one for a commander are taken"));
    assert_eq!(outcome(&one_more, Request::Arm), Err(Refusal::NoAnswer));
    assert_eq!(outcome(&one_more, Request::Stop), Ok(()));
    assert_eq!(robot.heard(), [Request::Arm, Request::Stop]);
    // An observer does not get the last place either.
    drop(commander);
    wait_for(|| robot.server.stats().clients == 32);
    let observer = runtime().block_on(Client::connect(robot.endpoint().to_watch())).err().unwrap();
    assert!(matches!(observer, NetError::Refused(_)), "{observer}");
    drop(watching);
}

#[test]
fn observer_reads_and_stops_and_commands_nothing() {
    let robot = Robot::new("observer", false);
    let shows = robot.folder.join("watch.sock");
    assert_eq!(std::fs::metadata(&shows).unwrap().permissions().mode() & 0o777, 0o666);
    // Over its own socket it is an observer whatever it says, over the operators' if it says so.
    let endpoints = [Endpoint::from(Address::Unix(shows)), robot.endpoint().to_watch()];
    for endpoint in endpoints {
        let before = robot.heard().len();
        let observer = connect(endpoint);
        wait_for(|| !observer.poll().samples.is_empty());
        for request in [Request::Tare, Request::Arm, Request::Disarm, Request::Resume] {
            assert_eq!(outcome(&observer, request), Err(Refusal::ReadOnly), "{request:?}");
        }
        observer.release();
        assert_eq!(outcome(&observer, Request::Stop), Ok(()));
        drop(observer);
        assert_eq!(robot.heard()[before..], [Request::Stop]);
    }
}

#[test]
fn port_admits_nobody_without_its_token_but_a_stop() {
    let robot = Robot::new("token", true);
    let other = robot.folder.join("other");
    Token::read_or_create(&other).unwrap();
    let refused = |token: Option<PathBuf>| {
        let endpoint = Endpoint { token, ..robot.endpoint() };
        runtime().block_on(Client::connect(endpoint)).err().unwrap().to_string()
    };
    assert!(refused(Some(other)).contains("wrong token"));
    assert!(refused(None).contains("needs a token"));
    assert!(refused(Some(robot.folder.join("none"))).contains("none: No such file"));
    assert_eq!(robot.heard(), [], "nobody got in");
    assert_eq!(stop_blocking(robot.address()).unwrap(), Ok(()));
    assert_eq!(outcome(&connect(robot.endpoint()), Request::Tare), Ok(()));
}

/// Whoever has heard a whole session cannot hold it again.
#[test]
fn replayed_session_is_refused() {
    let robot = Robot::new("replay", true);
    let mut genuine = robot.port();
    let challenge = wire::decode_greeting(&frame(&mut genuine)).unwrap();
    assert!(challenge.token_needed);
    let token = Token::read(&robot.folder.join("token")).unwrap();
    let hello = FromClient::Hello { role: Role::Operator, proof: Some(token.proof(&challenge.nonce)) };
    let mut session = wire::encode_from_client(&hello).unwrap();
    session.extend(wire::encode_from_client(&FromClient::Request { id: 1, request: Request::Arm }).unwrap());
    genuine.write_all(&session).unwrap();
    wait_for(|| robot.heard() == [Request::Arm]);
    drop(genuine);
    wait_for(|| robot.heard() == [Request::Arm, Request::OperatorLost]);

    let mut replayed = robot.port();
    let again = wire::decode_greeting(&frame(&mut replayed)).unwrap();
    assert_ne!(again.nonce, challenge.nonce);
    replayed.write_all(&session).unwrap();
    let said = wire::decode_from_server(&frame(&mut replayed)).unwrap();
    assert!(matches!(&said, FromServer::Goodbye(why) if why.contains("wrong token")), "{said:?}");
    assert_eq!(stop_blocking(robot.address()).unwrap(), Ok(()));
    assert_eq!(robot.heard(), [Request::Arm, Request::OperatorLost, Request::Stop], "nothing armed it again");
}
