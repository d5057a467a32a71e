//! The transport from ring to subscriber and from client to loop, over real sockets.
#![cfg(feature = "net")]
#![allow(clippy::unwrap_used, clippy::panic, reason = "test helpers fail by panicking")]

use moca_msgs::{
    Mode, Outcome, Refusal, Request, Sample, Target, TargetRefusal, TimedTarget, TouchPolicy, TwistAxes,
    Waypoint,
};
use moca_telemetry::{
    RobotDescription,
    net::{
        Address, Client, Commander, Connection, Endpoint, Link, NetError, Ports, Reply, RequestReceiver,
        Role, SCHEMA_VERSION, Server, Serving, Token, Update, request_channel, serve,
        server::ServerStats,
        wire::{FromClient, FromServer, encode_from_client},
    },
};
use rtrb::{Producer, RingBuffer};
use std::{
    io::{Read, Write},
    net::{SocketAddr, TcpListener, TcpStream},
    path::PathBuf,
    sync::{
        Arc, OnceLock,
        atomic::{AtomicBool, AtomicU64, Ordering},
    },
    time::{Duration, Instant},
};
use tokio::{io::AsyncWriteExt, net::UnixStream};

const ANY: SocketAddr = SocketAddr::new(std::net::IpAddr::V4(std::net::Ipv4Addr::LOCALHOST), 0);
/// Only to end a test that would hang: nothing is asserted about times.
const HANG: Duration = Duration::from_secs(60);

/// The loop's side of a server.
struct Loop {
    server: Server,
    samples: Producer<Sample>,
    requests: RequestReceiver,
    ring_dropped: Arc<AtomicU64>,
}

/// The token file of the ports of these tests.
fn token() -> PathBuf {
    static MADE: OnceLock<PathBuf> = OnceLock::new();
    let make = || {
        let path = std::env::temp_dir().join(format!("moca-net-{}/token", std::process::id()));
        Token::read_or_create(&path).unwrap();
        path
    };
    MADE.get_or_init(make).clone()
}

fn endpoint(address: &Address) -> Endpoint {
    Endpoint { token: Some(token()), ..address.into() }
}

fn start(address: impl Into<Address>, recorder: Option<Producer<Sample>>) -> Loop {
    let (samples, from_loop) = RingBuffer::new(4096);
    let (to_loop, requests) = request_channel();
    let ring_dropped = Arc::new(AtomicU64::new(0));
    let ports = Ports {
        samples: from_loop,
        requests: to_loop,
        ring_dropped: Arc::clone(&ring_dropped),
        recorder,
        calibration: None,
        judge: None,
    };
    let serving = Serving { mode: 0o600, token: Some(Token::read(&token()).unwrap()), ..Serving::default() };
    let server = serve(&address.into(), serving, RobotDescription::paper("test", true), ports).unwrap();
    Loop { server, samples, requests, ring_dropped }
}

impl Loop {
    fn send(&mut self, ticks: std::ops::Range<u64>) {
        for tick in ticks {
            let mut sample = Sample { tick, mode: Mode::Ready, frame_age_s: 0.02, ..Sample::default() };
            sample.taxels.extend([moca_msgs::TaxelReading::default(); 11]);
            sample.q_rad.extend([0.1; 7]);
            wait_for(|| self.samples.push(sample.clone()).is_ok());
        }
    }

    /// Waits for one request and answers it.
    fn answer(&mut self, outcome: Outcome) -> Request {
        let mut asked = None;
        wait_for(|| {
            asked = self.requests.take();
            asked.is_some()
        });
        let (ticket, request) = asked.unwrap();
        self.requests.answer(ticket, outcome);
        request
    }

    fn port(&self) -> SocketAddr {
        self.server.address().tcp().unwrap()
    }
}

fn wait_for(mut done: impl FnMut() -> bool) {
    let start = Instant::now();
    while !done() {
        assert!(start.elapsed() < HANG, "waited {HANG:?} in vain");
        std::thread::sleep(Duration::from_millis(1));
    }
}

fn connect(address: &Address) -> Connection {
    let connection = Connection::spawn(endpoint(address), || {}).unwrap();
    wait_for(|| matches!(connection.poll().link, Link::Up { .. }));
    connection
}

/// Polls until `count` samples are there.
fn receive(connection: &Connection, count: usize) -> (Vec<u64>, Update) {
    let mut ticks = Vec::new();
    let mut last = connection.poll();
    wait_for(|| {
        ticks.extend(last.samples.iter().map(|s| s.tick));
        ticks.len() >= count || {
            last = connection.poll();
            false
        }
    });
    (ticks, last)
}

fn reply(connection: &Connection) -> Reply {
    let mut reply = None;
    wait_for(|| {
        reply = connection.poll().replies.first().copied();
        reply.is_some()
    });
    reply.unwrap()
}

#[test]
fn subscribers_get_geometry_then_every_sample() {
    let mut robot = start(ANY, None);
    let subscribers: Vec<_> = (0..3).map(|_| connect(robot.server.address())).collect();
    robot.ring_dropped.store(7, Ordering::Relaxed);
    robot.send(0..2000);
    for subscriber in &subscribers {
        let (ticks, update) = receive(subscriber, 2000);
        assert!(ticks.iter().copied().eq(0..2000));
        assert_eq!(update.status.ring_dropped, 7);
        assert_eq!(update.status.client_dropped, 0);
        let Link::Up { description, .. } = update.link else { panic!("link is down") };
        assert_eq!(*description, RobotDescription::paper("test", true));
    }
}

#[test]
fn a_stopped_subscriber_costs_the_others_nothing_and_is_dropped() {
    let mut robot = start(ANY, None);
    let healthy = connect(robot.server.address());
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().unwrap();
    let mut stopped = runtime.block_on(Client::connect(endpoint(robot.server.address()))).unwrap();
    wait_for(|| robot.server.stats().clients == 2);
    let mut next = 0;
    // The kernel buffers some of it before the queue starts to fill.
    while robot.server.stats().clients == 2 {
        assert!(next < 10_000_000, "a stopped subscriber was never dropped");
        robot.send(next..next + 500);
        let (ticks, update) = receive(&healthy, 500);
        assert!(ticks.iter().copied().eq(next..next + 500), "the healthy subscriber lost samples");
        assert_eq!(update.status.client_dropped, 0);
        next += 500;
    }
    let ServerStats { client_dropped, longest_queue, .. } = robot.server.stats();
    assert!(client_dropped > 0 && longest_queue <= 64, "{client_dropped} dropped, queue of {longest_queue}");

    // When it reads again it gets what was on its way, without a gap, and then the end.
    let mut received = 0;
    let end = loop {
        match runtime.block_on(stopped.incoming.next()) {
            Ok(FromServer::Batch(batch)) => {
                assert_eq!(batch.samples.first().map(|sample| sample.tick), Some(received));
                received += batch.samples.len() as u64;
            }
            Ok(_) => {}
            Err(error) => break error,
        }
    };
    assert!(matches!(end, NetError::Closed), "{end}");
    assert!(received > 0 && received < next);
}

#[test]
fn watcher_in_commander_place_is_asked_to_leave() {
    let mut robot = start(ANY, None);
    let watching: Vec<_> = (0..32).map(|_| connect(robot.server.address())).collect();
    wait_for(|| robot.server.stats().clients == 32);
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().unwrap();
    let last_words = |client: &mut Client| loop {
        match runtime.block_on(client.incoming.next()) {
            Ok(FromServer::Goodbye(reason)) => return reason,
            Ok(_) => {}
            Err(error) => return error.to_string(),
        }
    };
    let mut one_more = runtime.block_on(Client::connect(endpoint(robot.server.address()))).unwrap();
    let reason = last_words(&mut one_more);
    assert!(reason.contains("the last place is kept for a commander"), "{reason}");
    drop(one_more);
    wait_for(|| robot.server.stats().clients == 32);

    let mut commander = runtime.block_on(Client::connect(endpoint(robot.server.address()))).unwrap();
    runtime.block_on(commander.outgoing.request(1, Request::Tare)).unwrap();
    assert_eq!(robot.answer(Ok(())), Request::Tare);
    let full = runtime.block_on(Client::connect(endpoint(robot.server.address()))).err().unwrap();
    assert!(matches!(&full, NetError::Refused(reason) if reason.contains("are taken")), "{full}");
    drop(watching);
    wait_for(|| robot.server.stats().clients == 1);
    runtime.block_on(commander.outgoing.request(2, Request::Stop)).unwrap();
    assert_eq!(robot.answer(Ok(())), Request::Stop);
}

#[test]
fn a_flood_of_requests_and_a_closed_socket_stop_the_robot() {
    let mut robot = start(ANY, None);
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().unwrap();
    let mut client = runtime.block_on(Client::connect(endpoint(robot.server.address()))).unwrap();
    runtime.block_on(async {
        for id in 0..75 {
            client.outgoing.request(2 * id, Request::Resume).await.unwrap();
            client.outgoing.request(2 * id + 1, Request::Arm).await.unwrap();
        }
    });
    drop(client);
    wait_for(|| robot.server.stats().clients == 0);
    // Nothing was carried out, so nobody is lost, unless half a second without an answer leaves that open.
    while let Some((_, request)) = robot.requests.take() {
        assert_eq!(request, Request::OperatorLost, "nothing that was asked before arms it");
    }
}

/// Asks for a target again and again, as fast as the socket takes it, and reads every answer; how many were taken and refused.
async fn flood(client: Client, asks: u64) -> [u64; 2] {
    let Client { mut incoming, mut outgoing, .. } = client;
    let twist = Target::Twist { axes: TwistAxes::World, twist: [0.0, 0.01, 0.0, 0.0, 0.0, 0.0] };
    let asking = async {
        for id in 0..asks {
            outgoing.request(id, Request::Target(TimedTarget::new(twist))).await.unwrap();
        }
    };
    let reading = async {
        let mut counts = [0, 0];
        while counts.iter().sum::<u64>() < asks {
            if let FromServer::Reply { outcome, .. } = incoming.next().await.unwrap() {
                counts[usize::from(outcome.is_err())] += 1;
                let known = TargetRefusal::TooMany { most: 16 };
                assert!(
                    outcome.is_ok()
                        || [TargetRefusal::Overtaken, known].map(|why| Err(why.into())).contains(&outcome),
                    "{outcome:?}"
                );
            }
        }
        counts
    };
    tokio::join!(asking, reading).1
}

#[test]
fn flooding_commander_is_answered_and_keeps_command() {
    let socket = std::env::temp_dir().join(format!("moca-flood-{}.sock", std::process::id()));
    for address in [Address::from(ANY), Address::Unix(socket)] {
        let Loop { server, samples: _samples, mut requests, .. } = start(address, None);
        let ended = Arc::new(AtomicBool::new(false));
        let ends = Arc::clone(&ended);
        let ticks = std::thread::spawn(move || {
            let mut others = Vec::new();
            while !ends.load(Ordering::Relaxed) {
                while let Some((ticket, request)) = requests.take() {
                    requests.answer(ticket, Ok(()));
                    if !matches!(request, Request::Target(_)) {
                        others.push(request);
                    }
                }
                std::thread::sleep(Duration::from_millis(1));
            }
            others
        });
        let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().unwrap();
        let [taken, refused] = runtime.block_on(async {
            let client = Client::connect(endpoint(server.address())).await.unwrap();
            flood(client, 20_000).await
        });
        assert!(taken > 0 && refused > 0, "{taken} taken, {refused} refused");
        // Only its end was the loss of its command, and nothing that it asked before.
        let onlooker = connect(server.address());
        wait_for(|| server.stats().clients == 1);
        onlooker.request(Request::Stop);
        assert_eq!(reply(&onlooker).outcome, Ok(()));
        ended.store(true, Ordering::Relaxed);
        let heard = ticks.join().unwrap();
        let each = [Request::OperatorLost, Request::Stop].iter().all(|request| heard.contains(request));
        assert!(each && heard.len() == 2, "{}: {heard:?}", server.address());
    }
}

#[test]
fn who_asks_and_reads_no_answer_is_closed_and_the_robot_stops() {
    let socket = std::env::temp_dir().join(format!("moca-deaf-{}.sock", std::process::id()));
    let mut robot = start(Address::Unix(socket.clone()), None);
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().unwrap();
    let hello = encode_from_client(&FromClient::Hello { role: Role::Operator, proof: None }).unwrap();
    let ask = encode_from_client(&FromClient::Request { id: 1, request: Request::Arm }).unwrap();
    let asking = async {
        let mut stream = UnixStream::connect(&socket).await.unwrap();
        stream.write_all(&hello).await.unwrap();
        while stream.write_all(&ask).await.is_ok() {}
    };
    runtime.block_on(async { tokio::time::timeout(HANG, asking).await }).unwrap();
    wait_for(|| robot.server.stats().clients == 0);
    wait_for(|| robot.requests.take().is_some_and(|(_, request)| request == Request::OperatorLost));
}

#[test]
fn a_notice_reaches_who_is_there_and_who_comes_later() {
    let robot = start(ANY, None);
    let notice = |client: &Connection| {
        let mut notices = Vec::new();
        wait_for(|| {
            notices.extend(client.poll().notices);
            !notices.is_empty()
        });
        notices
    };
    let there = connect(robot.server.address());
    robot.server.notices().send("the disk is full".into()).unwrap();
    assert_eq!(notice(&there), ["the disk is full"]);
    let later = Connection::spawn(endpoint(robot.server.address()), || {}).unwrap();
    assert_eq!(notice(&later), ["the disk is full"]);
}

#[test]
fn invalid_trajectory_is_refused_before_sending() {
    let mut robot = start(ANY, None);
    let client = connect(robot.server.address());
    let pose = |k: u32| Waypoint {
        time_s: f64::from(k),
        position_world: [0.5, 0.0, 0.8],
        quaternion_world: [1.0, 0.0, 0.0, 0.0],
    };
    for count in [33, 64, 1000] {
        client.trajectory(TouchPolicy::TouchWins, (0..count).map(pose).collect());
        let refused = reply(&client).outcome.unwrap_err().to_string();
        assert!(refused.contains(&format!("number of poses = {count} is outside 1 to 32")), "{refused}");
    }
    client.request(Request::Tare);
    assert_eq!(robot.answer(Ok(())), Request::Tare);
    assert_eq!(reply(&client).outcome, Ok(()), "nobody was cut off");

    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().unwrap();
    let mut bare = runtime.block_on(Client::connect(endpoint(robot.server.address()))).unwrap();
    let long = bare.outgoing.trajectory(1, TouchPolicy::TouchWins, (0..1000).map(pose).collect());
    assert!(matches!(runtime.block_on(long), Err(NetError::FrameTooLong { max: 4096, .. })));
}

#[test]
fn a_unix_socket_has_its_mode_and_serves_like_a_port() {
    use std::os::unix::fs::{FileTypeExt, PermissionsExt};
    let path = std::env::temp_dir().join(format!("moca-telemetry-{}.sock", std::process::id()));
    let address = Address::Unix(path.clone());
    std::fs::write(&path, "not ours").unwrap();
    let ports = || Ports {
        samples: RingBuffer::new(1).1,
        requests: request_channel().0,
        ring_dropped: Arc::default(),
        recorder: None,
        calibration: None,
        judge: None,
    };
    let refused = serve(&address, 0o600, RobotDescription::default(), ports());
    assert!(refused.err().unwrap().to_string().contains("no socket"), "another's file is not replaced");
    std::fs::remove_file(&path).unwrap();
    // What a killed daemon leaves behind.
    drop(std::os::unix::net::UnixListener::bind(&path).unwrap());

    let mut robot = start(address.clone(), None);
    let metadata = std::fs::metadata(&path).unwrap();
    assert!(metadata.file_type().is_socket());
    assert_eq!(metadata.permissions().mode() & 0o777, 0o600);
    let second = serve(&address, 0o600, RobotDescription::default(), ports());
    assert!(second.err().unwrap().to_string().contains("another daemon"));
    let client = connect(&address);
    robot.send(0..100);
    assert!(receive(&client, 100).0.into_iter().eq(0..100));
    client.request(Request::Stop);
    assert_eq!(robot.answer(Ok(())), Request::Stop);
    drop(robot);
    assert!(!path.exists(), "the file goes with the server");
}

#[test]
fn one_commander_at_a_time_but_anyone_may_stop() {
    let mut robot = start(ANY, None);
    let first = connect(robot.server.address());
    let second = connect(robot.server.address());

    first.request(Request::Arm);
    assert_eq!(robot.answer(Ok(())), Request::Arm);
    assert_eq!(reply(&first), Reply { request: Request::Arm, outcome: Ok(()) });

    second.request(Request::Disarm);
    assert_eq!(reply(&second).outcome, Err(Refusal::NotCommander));
    second.request(Request::Stop);
    assert_eq!(robot.answer(Ok(())), Request::Stop);
    assert_eq!(reply(&second), Reply { request: Request::Stop, outcome: Ok(()) });

    robot.send(0..10);
    assert_eq!(receive(&first, 10).1.status.commander, Commander::You);
    assert_eq!(receive(&second, 10).1.status.commander, Commander::Another);

    first.release();
    assert_eq!(robot.answer(Ok(())), Request::Disarm, "nothing moves without somebody responsible");
    wait_for(|| {
        second.request(Request::Tare);
        let mut taken = false;
        wait_for(|| {
            if let Some((ticket, _)) = robot.requests.take() {
                robot.requests.answer(ticket, Err(Refusal::Mode(Mode::Impedance)));
            }
            second.poll().replies.first().is_some_and(|r| {
                taken = r.outcome == Err(Refusal::Mode(Mode::Impedance));
                true
            })
        });
        taken
    });
}

/// Samples are on their way to a client that gives the command back and hangs up at once: writing to it fails before its last words are
/// read. Which of the two the server meets first is chance, hence the many rounds.
#[test]
fn last_words_of_client_that_hangs_up_are_heard() {
    let mut robot = start(ANY, None);
    for round in 0..40 {
        let client = connect(robot.server.address());
        client.request(Request::Arm);
        assert_eq!(robot.answer(Ok(())), Request::Arm);
        assert_eq!(reply(&client).outcome, Ok(()));
        robot.send(2000 * round..2000 * round + 1000);
        client.release();
        drop(client);
        robot.send(2000 * round + 1000..2000 * round + 2000);
        assert_eq!(robot.answer(Ok(())), Request::Disarm, "round {round}");
        wait_for(|| robot.server.stats().clients == 0);
    }
}

#[test]
fn a_commander_that_vanishes_lets_go_of_the_taxels_it_pressed() {
    let mut robot = start(ANY, None);
    let first = connect(robot.server.address());
    let press = Request::PressTaxel { taxel: 5, force_n: 20.0 };
    first.request(press);
    assert_eq!(robot.answer(Ok(())), press);
    assert_eq!(reply(&first).outcome, Ok(()));
    drop(first);
    assert_eq!(robot.answer(Ok(())), Request::OperatorLost, "whoever commands is watched");
    assert_eq!(robot.answer(Ok(())), Request::PressTaxel { taxel: 5, force_n: 0.0 });
    let second = connect(robot.server.address());
    second.request(Request::Tare);
    assert_eq!(robot.answer(Ok(())), Request::Tare);
}

#[test]
fn silent_owner_loses_the_command() {
    let mut robot = start(ANY, None);
    let hung = connect(robot.server.address());
    hung.alive();
    hung.request(Request::Arm);
    assert_eq!(robot.answer(Ok(())), Request::Arm);
    // Its network thread lives on, and its owner never calls `alive` again.
    assert_eq!(robot.answer(Ok(())), Request::OperatorLost);
    let other = connect(robot.server.address());
    other.request(Request::Resume);
    assert_eq!(robot.answer(Ok(())), Request::Resume);
}

#[test]
fn numbers_out_of_range_do_not_reach_the_loop() {
    let mut robot = start(ANY, None);
    let client = connect(robot.server.address());
    for (taxel, force_n) in [(11, 1.0), (0, f64::NAN), (0, f64::INFINITY), (0, -1.0), (0, 200.1)] {
        client.request(Request::PressTaxel { taxel, force_n });
        assert_eq!(reply(&client).outcome, Err(Refusal::OutOfRange), "T{} at {force_n} N", taxel + 1);
    }
    assert!(robot.requests.take().is_none());
}

#[test]
fn a_loop_that_does_not_answer_is_reported() {
    let robot = start(ANY, None);
    let client = connect(robot.server.address());
    client.request(Request::Tare);
    assert_eq!(reply(&client).outcome, Err(Refusal::NoAnswer));
    drop(robot);
    wait_for(|| matches!(client.poll().link, Link::Down { .. }));
    client.request(Request::Stop);
    assert_eq!(reply(&client), Reply { request: Request::Stop, outcome: Err(Refusal::NoAnswer) });
}

#[test]
fn the_connection_comes_back_when_the_daemon_does() {
    let mut robot = start(ANY, None);
    let address = robot.server.address().clone();
    let connection = connect(&address);
    robot.send(0..100);
    receive(&connection, 100);
    let Link::Up { session, .. } = connection.poll().link else { panic!("link is down") };
    drop(robot);
    wait_for(|| matches!(connection.poll().link, Link::Down { .. }));
    let mut robot = start(address, None);
    wait_for(|| matches!(connection.poll().link, Link::Up { session: s, .. } if s == session + 1));
    robot.send(0..100);
    assert!(receive(&connection, 100).0.into_iter().eq(0..100));
}

#[test]
fn the_recorder_gets_every_sample_even_those_of_the_last_moment() {
    let (recorder, mut recorded) = RingBuffer::new(300);
    let mut robot = start(ANY, Some(recorder));
    let reader = std::thread::spawn(move || {
        let mut ticks = Vec::new();
        while !(recorded.is_empty() && recorded.is_abandoned()) {
            match recorded.pop() {
                Ok(sample) => ticks.push(sample.tick),
                Err(_) => std::thread::sleep(Duration::from_micros(100)),
            }
        }
        ticks
    });
    robot.send(0..10_000);
    drop(robot.server);
    assert!(reader.join().unwrap().into_iter().eq(0..10_000));
}

#[test]
fn other_versions_and_other_programs_are_told_apart() {
    let version = SCHEMA_VERSION + 1;
    let mut other_version = b"\0\0\0\x08MOCA".to_vec();
    other_version.extend(version.to_be_bytes());
    let cases = [
        (other_version, format!("speaks telemetry schema {version}")),
        (b"\0\0\0\x08SSH-2.0-".to_vec(), "not a MOCA-S daemon".into()),
        (b"HTTP/1.1 400".to_vec(), "allowed are at most".into()),
        (b"".to_vec(), "the daemon closed the connection".into()),
    ];
    for (bytes, message) in cases {
        let listener = TcpListener::bind(ANY).unwrap();
        let address = listener.local_addr().unwrap();
        let connection = Connection::spawn(address, || {}).unwrap();
        let (mut stream, _) = listener.accept().unwrap();
        stream.write_all(&bytes).unwrap();
        drop(stream);
        let mut reason = String::new();
        wait_for(|| match connection.poll().link {
            Link::Down { reason: r } if r != "not connected yet" => {
                reason = r;
                true
            }
            _ => false,
        });
        assert!(reason.contains(&message), "{reason}");
    }
}

#[test]
fn client_sending_garbage_is_closed_alone() {
    let mut robot = start(ANY, None);
    let healthy = connect(robot.server.address());
    for garbage in [&b"GET / HTTP/1.1\r\n\r\n"[..], &[0, 0, 0, 3, 0xff, 0xff, 0xff]] {
        let mut stream = TcpStream::connect(robot.port()).unwrap();
        stream.write_all(garbage).unwrap();
        let mut rest = Vec::new();
        // The server closes; the reset that may come with it is as good an end as any.
        let _ = stream.read_to_end(&mut rest);
        assert!(rest.len() < 4096);
    }
    wait_for(|| robot.server.stats().clients == 1);
    robot.send(0..10);
    assert!(receive(&healthy, 10).0.into_iter().eq(0..10));
    assert!(robot.requests.take().is_none());
}

#[test]
fn only_loopback_is_served() {
    let (_, samples) = RingBuffer::new(1);
    let (requests, _robot) = request_channel();
    let ring_dropped = Arc::default();
    let ports = Ports { samples, requests, ring_dropped, recorder: None, calibration: None, judge: None };
    let refused = serve(&"0.0.0.0:0".parse().unwrap(), 0o600, RobotDescription::default(), ports);
    assert!(matches!(refused.err(), Some(NetError::NotLoopback(_))));
}
