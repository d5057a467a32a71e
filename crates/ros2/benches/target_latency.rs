//! From a client's call to the first torque that follows it, beside a bare echo of the same size in the same run:
//! `cargo bench -p moca-ros2 --features bridge --bench target_latency -- [TARGETS]` (default 300).
//!
//! The loop is the daemon's, at 1 kHz, with an arm that measures the same in every tick: its torque changes where a target
//! makes it change, and in no other tick. Over TCP, over a Unix socket, and over DDS through the bridge as from a ROS node.
#![allow(clippy::print_stdout, clippy::print_stderr, reason = "a program that prints its result")]

use anyhow::{Context, Result, bail, ensure};
use moca_control::assemble::{motion, supervisor};
use moca_control::config::Config;
use moca_control::plant::Plant;
use moca_control::robot::{JOINTS, Parts};
use moca_control::tick::ControlLoop;
use moca_daemon::runtime::clients::rings;
use moca_daemon::runtime::clock::Clock;
use moca_daemon::runtime::live::{self, Shared};
use moca_daemon::runtime::tick_source::Timer;
use moca_daemon::runtime::timing::Timing;
use moca_lockstep::touch_board::ByteCover;
use moca_msgs::{Actuation, Fault, Mode, Request, RobotState, Target, TimedTarget, TwistAxes};
use moca_ros2::bridge::{Bridge, BridgeSettings};
use moca_ros2::dds::Dds;
use moca_ros2::messages::{Header, Time, Twist, TwistStamped};
use moca_ros2::transport::{Qos, Transport};
use moca_ros2::{Message, cdr};
use moca_telemetry::RobotDescription;
use moca_telemetry::net::{Address, Connection, Link, Serving, serve};
use std::io::{Read, Write};
use std::net::{TcpListener, TcpStream};
use std::os::unix::net::{UnixListener, UnixStream};
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::mpsc::{Receiver, Sender, channel};
use std::thread;
use std::time::{Duration, Instant};

/// Bytes of a target on the wire, its length included, and of an answer.
const TARGET_BYTES: usize = 80;
/// Domain of the nodes, which nobody else should use.
const DOMAIN: u16 = 77;
/// Longest wait for a program to start, and for a target to be followed.
const PATIENCE: Duration = Duration::from_secs(30);
const FOLLOWS_WITHIN: Duration = Duration::from_secs(1);
/// Longest wait of DDS for a message.
const LOOK: Duration = Duration::from_millis(2);

/// Stands still and says when its torque changes.
struct Standing {
    state: RobotState<JOINTS>,
    last: [f64; JOINTS],
    /// Ticks since the torque last changed.
    same: u64,
    quiet: Arc<AtomicU64>,
    changed: Sender<Instant>,
}

impl Plant for Standing {
    fn read(&mut self) -> Result<RobotState<JOINTS>, Fault> {
        Ok(self.state)
    }

    #[expect(clippy::float_cmp, reason = "a torque that is not asked to change is the same to the bit")]
    fn write(&mut self, actuation: &Actuation<JOINTS>, _ticks: u64) -> Result<(), Fault> {
        if let Actuation::Drive(command) = actuation {
            let moves = command.arm_torque_nm != self.last;
            let rested = self.same > 0;
            self.same = if moves { 0 } else { self.same + 1 };
            self.last = command.arm_torque_nm;
            // Before the news: who hears of a change must not find the rest before it.
            self.quiet.store(self.same, Ordering::Release);
            if moves && rested {
                // Who has stopped listening has measured enough.
                let _ = self.changed.send(Instant::now());
            }
        }
        Ok(())
    }
}

/// A way for targets to the robot.
#[derive(Clone, Copy, PartialEq)]
enum Way {
    Tcp,
    Unix,
    Dds,
}

/// Results of the targets.
#[derive(Default)]
struct Measured {
    latencies: Vec<Duration>,
    /// That no torque followed, and stops of the robot.
    unfollowed: usize,
    stops: usize,
}

fn main() -> Result<()> {
    let targets: usize = std::env::args()
        .skip(1)
        .find(|argument| argument != "--bench")
        .map_or(Ok(300), |number| number.parse())?;
    let socket = std::env::temp_dir().join(format!("moca-latency-{}.sock", std::process::id()));
    let load = || std::fs::read_to_string("/proc/loadavg");
    println!("{targets} targets each; load average before: {}", load()?.trim());
    println!("| transport | target to torque p50 | p99 | not followed | stops | bare echo p50 | p99 |");
    println!("|---|---|---|---|---|---|---|");
    for (name, way) in [("TCP", Way::Tcp), ("Unix socket", Way::Unix), ("DDS", Way::Dds)] {
        let address = match way {
            Way::Tcp => "127.0.0.1:0".into(),
            Way::Unix | Way::Dds => format!("unix:{}", socket.display()),
        };
        let Measured { latencies, unfollowed, stops } =
            through_the_loop(&address.parse()?, way, targets).with_context(|| name.to_owned())?;
        let latency = percentiles(latencies)?;
        let echo = percentiles(echoes(way, &socket.with_extension("echo"), targets)?)?;
        println!(
            "| {name} | {} | {} | {unfollowed} | {stops} | {} | {} |",
            latency[0], latency[1], echo[0], echo[1]
        );
    }
    println!("load average after: {}", load()?.trim());
    Ok(())
}

fn through_the_loop(address: &Address, way: Way, targets: usize) -> Result<Measured> {
    let mut config = Config::default();
    config.plant.parts = Parts::Arm;
    let state = RobotState {
        base_pose_world: [0.0; 3],
        base_velocity_world: [0.0; 3],
        q_rad: config.control.gains.posture_rad,
        dq_rad_s: [0.0; JOINTS],
        torque_measured_nm: [0.0; JOINTS],
        flange_wrench_world: Some([0.0; 6]),
    };
    let (changed, changes) = channel();
    let quiet = Arc::new(AtomicU64::new(0));
    let plant = Standing { state, last: [0.0; JOINTS], same: 0, quiet: Arc::clone(&quiet), changed };
    let cover: Option<ByteCover> = None;
    let mut control = ControlLoop::new(plant, cover, supervisor(&config), motion(&config)?, 1e-3);
    let (clock, shared, mut timing) = (Clock::start()?, Arc::new(Shared::default()), Timing::new()?);
    let (mut rings, samples, requests) = rings(&shared);
    let server = serve(
        address,
        Serving::this_user()?,
        RobotDescription::paper("latency", true),
        requests.with(samples, None),
    )?;
    let stop = Arc::clone(&shared);
    let thread = thread::spawn(move || {
        let mut timer = Timer::new(clock, 1_000_000);
        live::run(&mut control, &mut timer, &mut timing, None, &mut rings, &shared)
    });
    let robot = Robot { watch: connected(server.address())?, changes, quiet };
    let measured = if way == Way::Dds {
        robot.led_by_a_node(server.address(), targets)
    } else {
        robot.led(targets, |twist| {
            robot
                .watch
                .request(Request::Target(TimedTarget { age_limit_s: 0.02, ..TimedTarget::new(twist) }));
            Ok(())
        })
    };
    stop.stop.store(true, Ordering::Relaxed);
    ensure!(thread.join().is_ok(), "the loop panicked");
    measured
}

fn connected(address: &Address) -> Result<Connection> {
    let connection = Connection::spawn(address.clone(), || {})?;
    let until = Instant::now() + PATIENCE;
    while !matches!(connection.poll().link, Link::Up { .. }) {
        ensure!(Instant::now() < until, "no greeting");
        thread::sleep(Duration::from_millis(1));
    }
    Ok(connection)
}

/// State of the robot as clients see it.
struct Robot {
    watch: Connection,
    changes: Receiver<Instant>,
    quiet: Arc<AtomicU64>,
}

impl Robot {
    /// Sends targets one by one, each to a reference that rests.
    fn led(&self, targets: usize, mut send: impl FnMut(Target) -> Result<()>) -> Result<Measured> {
        let mut measured = Measured::default();
        self.settle(&mut measured)?;
        for number in 0..targets {
            // At any place between two ticks.
            thread::sleep(Duration::from_micros(137 * (number as u64 % 8)));
            while self.changes.try_recv().is_ok() {}
            let speed = if number % 2 == 0 { 0.02 } else { -0.02 };
            let called = Instant::now();
            send(Target::Twist { axes: TwistAxes::World, twist: [speed, 0.0, 0.0, 0.0, 0.0, 0.0] })?;
            match self.changes.recv_timeout(FOLLOWS_WITHIN) {
                Ok(change) => measured.latencies.push(change - called),
                Err(_) => measured.unfollowed += 1,
            }
            self.settle(&mut measured)?;
        }
        Ok(measured)
    }

    /// Waits until a law moves the robot and its reference rests. A machine so busy that the robot stops has it armed again.
    fn settle(&self, measured: &mut Measured) -> Result<()> {
        let until = Instant::now() + PATIENCE;
        let mut moves = None;
        while moves == Some(false) || self.quiet.load(Ordering::Acquire) < 50 {
            ensure!(Instant::now() < until, "the reference never rests");
            self.watch.alive();
            let update = self.watch.poll();
            if let Some(refused) = update.replies.iter().find_map(|reply| reply.outcome.err()) {
                eprintln!("refused: {refused}");
            }
            if let Some(sample) = update.samples.last() {
                if sample.mode == Mode::ProtectiveStop && moves != Some(false) {
                    eprintln!("stopped: {:?}", sample.fault);
                    measured.stops += 1;
                    self.watch.request(Request::Resume);
                }
                if sample.mode == Mode::Ready && moves == Some(false) {
                    self.watch.request(Request::Arm);
                    self.watch.release();
                }
                moves = Some(sample.mode.moves());
            }
            thread::sleep(Duration::from_millis(1));
        }
        Ok(())
    }

    /// Leads the robot from a ROS node, through the bridge.
    fn led_by_a_node(&self, daemon: &Address, targets: usize) -> Result<Measured> {
        let mut node = Dds::join(DOMAIN, &[])?;
        let writer = node.writer("/moca/target_twist", TwistStamped::TYPE, Qos::Reliable)?;
        let settings = BridgeSettings { prefix: "/moca".into(), tf: true };
        let (mut bridge, client) =
            (Bridge::new(Box::new(Dds::join(DOMAIN, &[])?), settings)?, connected(daemon)?);
        let ended = Arc::new(AtomicBool::new(false));
        let ends = Arc::clone(&ended);
        let thread = thread::spawn(move || {
            while !ends.load(Ordering::Relaxed) {
                bridge.step(&client, |reason| eprintln!("{reason}"))?;
            }
            Ok::<_, moca_telemetry::log::LogError>(())
        });
        let mut send = |target| {
            let Target::Twist { twist: [x, y, z, roll, pitch, yaw], .. } = target else { bail!("no twist") };
            let twist = Twist { linear: [x, y, z].into(), angular: [roll, pitch, yaw].into() };
            let header = Header { stamp: Time::from_unix_ns(0), frame_id: "world".into() };
            Ok(node.write(writer, &cdr::encode(&TwistStamped { header, twist }))?)
        };
        // Until the two have found each other.
        let until = Instant::now() + PATIENCE;
        self.settle(&mut Measured::default())?;
        while self.quiet.load(Ordering::Acquire) > 0 {
            ensure!(Instant::now() < until, "the bridge hears no target");
            send(Target::Twist { axes: TwistAxes::World, twist: [0.001, 0.0, 0.0, 0.0, 0.0, 0.0] })?;
            thread::sleep(Duration::from_millis(100));
        }
        let measured = self.led(targets, send);
        ended.store(true, Ordering::Relaxed);
        match thread.join() {
            Ok(bridged) => bridged?,
            Err(_) => bail!("the bridge panicked"),
        }
        measured
    }
}

/// There and back, with nothing between.
fn echoes(way: Way, socket: &Path, count: usize) -> Result<Vec<Duration>> {
    match way {
        Way::Tcp => {
            let listener = TcpListener::bind("127.0.0.1:0")?;
            let there = TcpStream::connect(listener.local_addr()?)?;
            there.set_nodelay(true)?;
            let (back, _) = listener.accept()?;
            back.set_nodelay(true)?;
            echo(there, back, count)
        }
        Way::Unix => {
            let listener = UnixListener::bind(socket)?;
            let there = UnixStream::connect(socket)?;
            let (back, _) = listener.accept()?;
            std::fs::remove_file(socket)?;
            echo(there, back, count)
        }
        Way::Dds => echo_between_nodes(count),
    }
}

fn echo<S: Read + Write + Send + 'static>(mut there: S, mut back: S, count: usize) -> Result<Vec<Duration>> {
    let thread = thread::spawn(move || -> std::io::Result<()> {
        let mut bytes = [0; TARGET_BYTES];
        loop {
            back.read_exact(&mut bytes)?;
            back.write_all(&bytes)?;
        }
    });
    let mut bytes = [7; TARGET_BYTES];
    let mut measured = Vec::new();
    for _ in 0..count {
        thread::sleep(Duration::from_millis(5));
        let called = Instant::now();
        there.write_all(&bytes)?;
        there.read_exact(&mut bytes)?;
        measured.push(called.elapsed());
    }
    drop(there);
    // It ends when nobody speaks to it any more.
    let _ = thread.join();
    Ok(measured)
}

fn echo_between_nodes(count: usize) -> Result<Vec<Duration>> {
    let payload = cdr::encode(&TwistStamped::default());
    let ended = Arc::new(AtomicBool::new(false));
    let ends = Arc::clone(&ended);
    let mut there = Dds::join(DOMAIN, &[])?;
    let mut back = Dds::join(DOMAIN, &[])?;
    let asks = there.writer("/moca/echo", TwistStamped::TYPE, Qos::Reliable)?;
    let answers = there.reader("/moca/echoed", TwistStamped::TYPE, Qos::BestEffort)?;
    let asked = back.reader("/moca/echo", TwistStamped::TYPE, Qos::BestEffort)?;
    let answered = back.writer("/moca/echoed", TwistStamped::TYPE, Qos::Reliable)?;
    let thread = thread::spawn(move || {
        while !ends.load(Ordering::Relaxed) {
            back.wait(LOOK);
            while let Some(payload) = back.take(asked) {
                back.write(answered, &payload)?;
            }
        }
        Ok::<_, moca_ros2::transport::TransportError>(())
    });
    let mut measured = Vec::new();
    let until = Instant::now() + PATIENCE;
    while measured.len() < count {
        thread::sleep(Duration::from_millis(5));
        while there.take(answers).is_some() {}
        let called = Instant::now();
        there.write(asks, &payload)?;
        // Before the two have found each other nobody answers.
        while called.elapsed() < FOLLOWS_WITHIN / 10 {
            there.wait(LOOK);
            if there.take(answers).is_some() {
                measured.push(called.elapsed());
                break;
            }
        }
        ensure!(!measured.is_empty() || Instant::now() < until, "no echo");
    }
    ended.store(true, Ordering::Relaxed);
    match thread.join() {
        Ok(echoed) => echoed?,
        Err(_) => bail!("the echo panicked"),
    }
    Ok(measured)
}

fn percentiles(mut measured: Vec<Duration>) -> Result<[String; 2]> {
    measured.sort_unstable();
    let at =
        |percent: usize| measured.get((measured.len() * percent / 100).min(measured.len().saturating_sub(1)));
    let text = |duration: &Duration| format!("{:.2} ms", duration.as_secs_f64() * 1e3);
    Ok([at(50).map(text).context("nothing measured")?, at(99).map(text).context("nothing measured")?])
}
