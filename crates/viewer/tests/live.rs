//! A daemon's telemetry through the server to viewers, over real sockets.
#![allow(clippy::unwrap_used, clippy::panic, reason = "test helpers fail by panicking")]

use moca_msgs::{Mode, Sample, TaxelReading, TaxelStatus};
use moca_telemetry::{
    ParameterDescription, ParameterValue, RobotDescription,
    net::{Address, Ports, Server, request_channel, serve as serve_telemetry, wire::unix_now_ns},
};
use moca_viewer::{Options, origin::Origins, serve};
use rtrb::RingBuffer;
use serde_json::{Value, json};
use std::{
    collections::BTreeMap,
    net::{Ipv4Addr, SocketAddr, TcpStream},
    path::{Path, PathBuf},
    sync::{
        Arc,
        atomic::{AtomicBool, AtomicU64, Ordering},
        mpsc,
    },
    thread::JoinHandle,
    time::{Duration, Instant},
};
use tokio_tungstenite::tungstenite::{
    self, Message, WebSocket,
    http::{Request, header},
};

/// Only to end a test that would hang: nothing is asserted about times.
/// What a viewer receives into, bytes.
const RECEIVE_BUFFER: u32 = 16 * 1024;
const HANG: Duration = Duration::from_secs(60);

/// A daemon whose loop gives a sample each millisecond.
struct Daemon {
    stop: Arc<AtomicBool>,
    feeding: Option<JoinHandle<()>>,
    _server: Server,
}

impl Daemon {
    fn start(socket: &Path) -> Self {
        let (mut samples, from_loop) = RingBuffer::new(4096);
        let (requests, _robot) = request_channel();
        let ports = Ports {
            samples: from_loop,
            requests,
            ring_dropped: Arc::new(AtomicU64::new(0)),
            recorder: None,
            calibration: None,
            judge: None,
        };
        let parameter = ParameterDescription {
            name: "control.gains.reactivity".into(),
            max: 10.0,
            live: true,
            value: ParameterValue::Numbers(vec![1.5]),
            ..ParameterDescription::default()
        };
        let robot = RobotDescription {
            parameters: vec![parameter],
            urdf: "<robot name=\"test\"/>".into(),
            ..RobotDescription::paper("test", true)
        };
        let server = serve_telemetry(&Address::Unix(socket.into()), 0o600, robot, ports).unwrap();
        let stop = Arc::new(AtomicBool::new(false));
        let stopped = Arc::clone(&stop);
        let feeding = std::thread::spawn(move || {
            let start = Instant::now();
            let mut tick = 0;
            while !stopped.load(Ordering::Relaxed) {
                // A full ring: nobody takes them any more.
                let _ = samples.push(sample(tick));
                tick += 1;
                let due = start + Duration::from_millis(tick);
                std::thread::sleep(due.saturating_duration_since(Instant::now()));
            }
        });
        Self { stop, feeding: Some(feeding), _server: server }
    }
}

impl Drop for Daemon {
    fn drop(&mut self) {
        self.stop.store(true, Ordering::Relaxed);
        self.feeding.take().unwrap().join().unwrap();
    }
}

fn sample(tick: u64) -> Sample {
    let mut sample = Sample { tick, time_ns: tick * 1_000_000, mode: Mode::Impedance, ..Sample::default() };
    sample.q_rad.extend([0.1; 7]);
    sample.dq_rad_s.extend([0.0; 7]);
    sample.arm_torque_nm.extend([1.0; 7]);
    sample.taxels.extend([TaxelReading { force_n: 3.0, status: TaxelStatus::Ok }; 11]);
    sample.counts.extend([700; 11]);
    sample
}

fn socket(name: &str) -> PathBuf {
    std::env::temp_dir().join(format!("moca-viewer-{}-{name}.sock", std::process::id()))
}

/// A server for the daemon behind `socket`; it ends with the test's process.
fn server(socket: &Path) -> SocketAddr {
    let options = Options {
        daemon: Address::Unix(socket.into()),
        listen: SocketAddr::new(Ipv4Addr::LOCALHOST.into(), 0),
        origins: Origins::default(),
        rate_hz: 200,
    };
    let (told, address) = mpsc::channel();
    std::thread::spawn(move || {
        let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().unwrap();
        runtime.block_on(serve(options, |address| told.send(address).unwrap())).unwrap();
    });
    address.recv_timeout(HANG).unwrap()
}

type Handshake = Result<WebSocket<TcpStream>, tungstenite::Error>;

/// A stream that receives into little: what a viewer did not read waits at the server.
fn connected(address: SocketAddr) -> TcpStream {
    let runtime = tokio::runtime::Builder::new_current_thread().enable_io().build().unwrap();
    let stream = runtime.block_on(async {
        let socket = tokio::net::TcpSocket::new_v4().unwrap();
        socket.set_recv_buffer_size(RECEIVE_BUFFER).unwrap();
        socket.connect(address).await.unwrap().into_std().unwrap()
    });
    stream.set_nonblocking(false).unwrap();
    stream
}

fn connect(address: SocketAddr, protocol: &str, origin: Option<&str>) -> Handshake {
    let stream = connected(address);
    stream.set_read_timeout(Some(HANG)).unwrap();
    let mut request = Request::get(format!("ws://{address}/"))
        .header(header::HOST, address.to_string())
        .header(header::CONNECTION, "Upgrade")
        .header(header::UPGRADE, "websocket")
        .header(header::SEC_WEBSOCKET_VERSION, "13")
        .header(header::SEC_WEBSOCKET_KEY, "dGhlIHNhbXBsZSBub25jZQ==");
    if !protocol.is_empty() {
        request = request.header(header::SEC_WEBSOCKET_PROTOCOL, protocol);
    }
    if let Some(origin) = origin {
        request = request.header(header::ORIGIN, origin);
    }
    match tungstenite::client(request.body(()).unwrap(), stream) {
        Ok((socket, _)) => Ok(socket),
        Err(tungstenite::HandshakeError::Failure(error)) => Err(error),
        Err(tungstenite::HandshakeError::Interrupted(_)) => panic!("the stream blocks"),
    }
}

struct Viewer {
    socket: WebSocket<TcpStream>,
    /// Number → topic.
    channels: BTreeMap<u64, String>,
}

/// A message of a topic: time, content.
type Data = (String, u64, Vec<u8>);

impl Viewer {
    fn connect(address: SocketAddr) -> Self {
        let socket = connect(address, "foxglove.sdk.v1", None).unwrap();
        Self { socket, channels: BTreeMap::new() }
    }

    fn say(&mut self, message: &Value) {
        self.socket.send(Message::text(message.to_string())).unwrap();
    }

    fn text(&mut self) -> Value {
        loop {
            if let Message::Text(text) = self.socket.read().unwrap() {
                return serde_json::from_str(&text).unwrap();
            }
        }
    }

    /// The next text with this `op`.
    fn wait(&mut self, op: &str) -> Value {
        loop {
            let text = self.text();
            if text["op"] == op {
                return text;
            }
        }
    }

    /// Waits for channels and subscribes to those whose topics are `wanted`, with the channels' numbers.
    fn subscribe(&mut self, wanted: impl Fn(&str) -> bool) {
        loop {
            let advertised = self.wait("advertise");
            let channels = advertised["channels"].as_array().unwrap();
            if channels.is_empty() {
                continue; // No daemon yet.
            }
            let pair = |c: &Value| (c["id"].as_u64().unwrap(), c["topic"].as_str().unwrap().to_owned());
            self.channels = channels.iter().map(pair).filter(|(_, topic)| wanted(topic)).collect();
            break;
        }
        let pairs: Vec<Value> = self.channels.keys().map(|id| json!({ "id": id, "channelId": id })).collect();
        self.say(&json!({ "op": "subscribe", "subscriptions": pairs }));
    }

    fn data(&mut self) -> Data {
        loop {
            if let Message::Binary(frame) = self.socket.read().unwrap() {
                assert_eq!(frame[0], 1);
                let id = u32::from_le_bytes(frame[1..5].try_into().unwrap());
                let time = u64::from_le_bytes(frame[5..13].try_into().unwrap());
                return (self.channels[&u64::from(id)].clone(), time, frame[13..].to_vec());
            }
        }
    }
}

#[test]
fn foreign_pages_and_protocols_are_refused() {
    let address = server(&socket("refused"));
    let refused = |protocol: &str, origin| match connect(address, protocol, origin) {
        Err(tungstenite::Error::Http(response)) => (
            response.status().as_u16(),
            String::from_utf8(response.body().clone().unwrap_or_default()).unwrap(),
        ),
        other => panic!("{protocol} {origin:?}: {:?}", other.map(|_| "let in")),
    };
    let (code, why) = refused("foxglove.sdk.v1", Some("https://evil.example"));
    assert!(code == 403 && why.contains("--allow-origin https://evil.example"), "{code} {why}");
    assert_eq!(refused("foxglove.sdk.v1", Some("null")).0, 403);
    for protocol in ["", "rosbridge", "foxglove.sdk.v2"] {
        let (code, why) = refused(protocol, None);
        assert!(code == 400 && why.contains("foxglove.sdk.v1"), "{protocol}: {code} {why}");
    }
    for origin in [None, Some("http://localhost:8080"), Some("https://app.foxglove.dev")] {
        connect(address, "foxglove.websocket.v1", origin).unwrap();
        connect(address, "other, foxglove.sdk.v1", origin).unwrap();
    }
}

#[test]
fn every_topic_comes_and_what_was_said_once_comes_to_the_late() {
    let path = socket("topics");
    let _daemon = Daemon::start(&path);
    let mut viewer = Viewer::connect(server(&path));
    viewer.subscribe(|_| true);
    let mut seen: BTreeMap<String, usize> = BTreeMap::new();
    // Each second what does not change is said again; faults, contacts and targets did not happen, links are of real robots.
    let often =
        |seen: &BTreeMap<String, usize>, topic: &str, times| seen.get(topic).is_some_and(|n| *n >= times);
    while !(often(&seen, "/scene/robot", 3) && often(&seen, "/tf_static", 3) && often(&seen, "/mode", 3)) {
        let (topic, _, content) = viewer.data();
        assert_eq!(content[..4], [0, 1, 0, 0], "{topic}");
        *seen.entry(topic).or_default() += 1;
    }
    for topic in viewer.channels.values() {
        let comes = !["/contact", "/link", "/log", "/target"].contains(&topic.as_str());
        assert_eq!(seen.contains_key(topic), comes, "{topic}: {seen:?}");
    }
    assert_eq!(seen["/robot_description"], 1);
    assert!(seen["/state"] > seen["/tf"], "numbers come with each tick, poses at 100 Hz: {seen:?}");
}

/// Every topic that a layout names, alone or as `/topic.field[index]`.
fn named_in(layout: &Value, names: &mut Vec<String>) {
    let mut take = |text: &str| names.extend(text.starts_with('/').then(|| text.to_owned()));
    match layout {
        Value::String(text) => take(text),
        Value::Array(all) => all.iter().for_each(|part| named_in(part, names)),
        Value::Object(all) => {
            all.keys().for_each(|key| take(key));
            all.values().for_each(|part| named_in(part, names));
        }
        _ => {}
    }
}

#[test]
fn shipped_layout_names_existing_fields() {
    let layout = concat!(env!("CARGO_MANIFEST_DIR"), "/../../examples/foxglove-layout.json");
    let mut names = Vec::new();
    named_in(&serde_json::from_str(&std::fs::read_to_string(layout).unwrap()).unwrap(), &mut names);
    assert!(names.len() > 15, "{names:?}");
    let path = socket("layout");
    let _daemon = Daemon::start(&path);
    let mut viewer = Viewer::connect(server(&path));
    let channels = loop {
        let channels = viewer.wait("advertise")["channels"].as_array().unwrap().clone();
        if !channels.is_empty() {
            break channels;
        }
    };
    for name in names {
        let (topic, field) = name.split_once('.').unwrap_or((&name, ""));
        let channel = channels.iter().find(|channel| channel["topic"] == topic);
        let schema = channel.unwrap_or_else(|| panic!("{name}"))["schema"].as_str().unwrap().to_owned();
        let field = field.split('[').next().unwrap();
        // `type name` on a line of its own.
        let known = schema.lines().any(|line| line.split(' ').nth(1) == Some(field));
        assert!(field.is_empty() || known, "{name} in {schema}");
    }
}

#[test]
fn parameters_are_read_and_never_written() {
    let path = socket("parameters");
    let _daemon = Daemon::start(&path);
    let mut viewer = Viewer::connect(server(&path));
    viewer.subscribe(|topic| topic == "/mode");
    let parameter = json!({ "name": "control.gains.reactivity", "value": 1.5, "type": "float64" });
    viewer.say(&json!({ "op": "getParameters", "parameterNames": [], "id": "all" }));
    let values = viewer.wait("parameterValues");
    assert_eq!((&values["id"], &values["parameters"]), (&json!("all"), &json!([parameter])));
    let asked = json!({ "name": "control.gains.reactivity", "value": 7.5 });
    viewer.say(&json!({ "op": "setParameters", "parameters": [asked], "id": "set" }));
    assert!(viewer.wait("status")["message"].as_str().unwrap().contains("only be read"));
    let values = viewer.wait("parameterValues");
    assert_eq!((&values["id"], &values["parameters"]), (&json!("set"), &json!([parameter])));
}

#[test]
fn slow_viewer_blocks_nobody_and_sees_no_stale_data() {
    let path = socket("mute");
    let _daemon = Daemon::start(&path);
    let address = server(&path);
    let (mut mute, mut healthy) = (Viewer::connect(address), Viewer::connect(address));
    mute.subscribe(|_| true);
    let (_, began, _) = mute.data();
    healthy.subscribe(|topic| topic == "/state");
    // Four seconds of a run for the healthy one; more than the buffers of the other one hold.
    let mut last = 0;
    while last < began + 4_000_000_000 {
        let (_, time, _) = healthy.data();
        assert!(time >= last);
        last = time;
    }
    let asleep_until = last;
    let (mut told, mut old_bytes, mut oldest_after_gap) = (false, 0, None);
    for read in 0.. {
        if oldest_after_gap.is_some() && told {
            break;
        }
        assert!(read < 100_000, "nobody says that messages were left out: told {told}, {oldest_after_gap:?}");
        match mute.socket.read().unwrap() {
            Message::Text(text) => told |= text.contains("messages were left out"),
            Message::Binary(frame) => {
                let time = u64::from_le_bytes(frame[5..13].try_into().unwrap());
                if time + 500_000_000 < asleep_until {
                    assert_eq!(oldest_after_gap, None, "the past comes after the present");
                    old_bytes += frame.len();
                } else {
                    oldest_after_gap.get_or_insert(time);
                }
            }
            _ => {}
        }
    }
    // Only what the kernel held on both sides, which may be more than it was asked for.
    assert!(old_bytes < 512 * 1024, "{old_bytes}");
}

#[test]
fn a_thousand_frames_of_garbage_hurt_nobody() {
    let path = socket("garbage");
    let _daemon = Daemon::start(&path);
    let address = server(&path);
    let (mut rude, mut polite) = (Viewer::connect(address), Viewer::connect(address));
    polite.subscribe(|topic| topic == "/tf");
    for i in 0..1000_u32 {
        let noise: Vec<u8> =
            (0..i % 97).map(|j| (i.wrapping_mul(2_654_435_761) >> (j % 24)).to_le_bytes()[0]).collect();
        let message = match i % 4 {
            0 => Message::binary(noise),
            1 => Message::text(String::from_utf8_lossy(&noise).into_owned()),
            2 => Message::text(
                json!({ "op": "subscribe", "subscriptions": [{ "id": i, "channelId": 9999 }] }).to_string(),
            ),
            _ => Message::text(json!({ "op": "callService", "serviceId": i }).to_string()),
        };
        rude.socket.send(message).unwrap();
    }
    let why = rude.wait("status");
    assert_eq!(why["level"], 1, "{why}");
    rude.say(
        &json!({ "op": "getParameters", "parameterNames": ["control.gains.reactivity"], "id": "after" }),
    );
    assert_eq!(rude.wait("parameterValues")["id"], "after");
    for _ in 0..10 {
        assert_eq!(polite.data().0, "/tf");
    }
    // Broken frames end that connection and no other.
    use std::io::Write;
    rude.socket.get_mut().write_all(&[0xff; 64]).unwrap();
    while rude.socket.read().is_ok() {}
    assert_eq!(polite.data().0, "/tf");
}

#[test]
fn topics_come_and_go_with_the_daemon() {
    let path = socket("restart");
    let first = Daemon::start(&path);
    let mut viewer = Viewer::connect(server(&path));
    let session = viewer.wait("serverInfo")["sessionId"].clone();
    viewer.subscribe(|topic| topic == "/tf");
    viewer.data();
    drop(first);
    let gone = viewer.wait("unadvertise");
    assert!(gone["channelIds"].as_array().unwrap().len() > 10, "{gone}");
    assert_eq!(viewer.wait("status")["level"], 2);
    // Who comes now hears it too.
    let before_ns = unix_now_ns();
    let _second = Daemon::start(&path);
    assert_ne!(viewer.wait("serverInfo")["sessionId"], session);
    viewer.subscribe(|topic| topic == "/tf");
    let (_, time, _) = viewer.data();
    assert!(time > before_ns, "data of the daemon before");
}

#[test]
fn other_machines_do_not_get_in() {
    let options = Options {
        daemon: Address::of_this_machine(),
        listen: SocketAddr::new(Ipv4Addr::UNSPECIFIED.into(), 0),
        origins: Origins::default(),
        rate_hz: 100,
    };
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().unwrap();
    let refused = runtime.block_on(serve(options, |_| panic!("it listens"))).unwrap_err();
    assert!(refused.to_string().contains("loopback"), "{refused}");
}
