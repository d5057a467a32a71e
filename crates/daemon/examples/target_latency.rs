//! From a client's call to the first torque that follows it, beside a bare echo of the same size in the same run:
//! `cargo run --release -p moca-daemon --no-default-features --example target_latency -- [TARGETS]` (default 300).
//!
//! The loop is the daemon's, at 1 kHz, with an arm that measures the same in every tick: its torque changes where a target
//! makes it change, and in no other tick. Over TCP and over a Unix socket.
#![allow(clippy::print_stdout, reason = "a program that prints its result")]

use anyhow::{Context, Result, bail, ensure};
use moca_daemon::config::Config;
use moca_daemon::control::plant::Plant;
use moca_daemon::control::tick::ControlLoop;
use moca_daemon::devices::touch_board::ByteCover;
use moca_daemon::robot::{JOINTS, Parts};
use moca_daemon::runtime::assemble::{motion, supervisor};
use moca_daemon::runtime::clients::rings;
use moca_daemon::runtime::clock::Clock;
use moca_daemon::runtime::live::{self, Shared};
use moca_daemon::runtime::tick_source::Timer;
use moca_daemon::runtime::timing::Timing;
use moca_msgs::{Actuation, Fault, Request, RobotState, Target, TimedTarget, TwistAxes};
use moca_telemetry::RobotDescription;
use moca_telemetry::net::{Address, Connection, Link, serve};
use std::io::{Read, Write};
use std::net::{TcpListener, TcpStream};
use std::os::unix::net::{UnixListener, UnixStream};
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::mpsc::{Receiver, Sender, channel};
use std::thread;
use std::time::{Duration, Instant};

/// Bytes of a target on the wire, its length included, and of an answer.
const TARGET_BYTES: usize = 80;

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
            if command.arm_torque_nm == self.last {
                self.same += 1;
            } else {
                if self.same > 0 {
                    // Who has stopped listening has measured enough.
                    let _ = self.changed.send(Instant::now());
                }
                (self.same, self.last) = (0, command.arm_torque_nm);
            }
            self.quiet.store(self.same, Ordering::Relaxed);
        }
        Ok(())
    }
}

fn main() -> Result<()> {
    let targets: usize = std::env::args().nth(1).map_or(Ok(300), |count| count.parse())?;
    let socket = std::env::temp_dir().join(format!("moca-latency-{}.sock", std::process::id()));
    println!("| transport | target to torque p50 | p99 | grown old on the way | bare echo p50 | p99 |");
    println!("|---|---|---|---|---|---|");
    for (name, address) in
        [("TCP", "127.0.0.1:0".into()), ("Unix socket", format!("unix:{}", socket.display()))]
    {
        let measured = through_the_loop(&address.parse()?, targets)?;
        let old = targets - measured.len();
        let latency = percentiles(measured)?;
        let echo = percentiles(echoes(name == "TCP", &socket.with_extension("echo"), targets)?)?;
        println!(
            "| {name} | {} | {} | {old} of {targets} | {} | {} |",
            latency[0], latency[1], echo[0], echo[1]
        );
    }
    Ok(())
}

fn through_the_loop(address: &Address, targets: usize) -> Result<Vec<Duration>> {
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
    let server =
        serve(address, 0o600, RobotDescription::paper("latency", true), requests.with(samples, None))?;
    let stop = Arc::clone(&shared);
    let thread = thread::spawn(move || {
        let mut timer = Timer::new(clock, 1_000_000);
        live::run(&mut control, &mut timer, &mut timing, None, &mut rings, &shared)
    });
    let measured = measure(server.address(), targets, &changes, &quiet);
    stop.stop.store(true, Ordering::Relaxed);
    ensure!(thread.join().is_ok(), "the loop panicked");
    measured
}

fn measure(
    address: &Address,
    targets: usize,
    changes: &Receiver<Instant>,
    quiet: &AtomicU64,
) -> Result<Vec<Duration>> {
    let connection = Connection::spawn(address.clone(), || {})?;
    let until = Instant::now() + Duration::from_secs(5);
    while !matches!(connection.poll().link, Link::Up { .. }) {
        ensure!(Instant::now() < until, "no greeting");
        thread::sleep(Duration::from_millis(1));
    }
    let mut measured = Vec::new();
    for number in 0..targets {
        // Until the reference rests; then at any place between two ticks.
        while quiet.load(Ordering::Relaxed) < 50 {
            connection.alive();
            thread::sleep(Duration::from_millis(1));
        }
        thread::sleep(Duration::from_micros(137 * (number as u64 % 8)));
        while changes.try_recv().is_ok() {}
        let speed = if number % 2 == 0 { 0.02 } else { -0.02 };
        let twist = Target::Twist { axes: TwistAxes::World, twist: [speed, 0.0, 0.0, 0.0, 0.0, 0.0] };
        let target = TimedTarget { age_limit_s: 0.02, ..TimedTarget::new(twist) };
        let called = Instant::now();
        connection.request(Request::Target(target));
        // On a starved machine a target may be too old for the loop when it comes.
        if let Ok(change) = changes.recv_timeout(Duration::from_secs(2)) {
            measured.push(change - called);
        }
        if let Some(refused) = connection.poll().replies.iter().find_map(|reply| reply.outcome.err()) {
            bail!("refused: {refused}");
        }
    }
    Ok(measured)
}

/// There and back, with nothing between.
fn echoes(tcp: bool, socket: &std::path::Path, count: usize) -> Result<Vec<Duration>> {
    if tcp {
        let listener = TcpListener::bind("127.0.0.1:0")?;
        let there = TcpStream::connect(listener.local_addr()?)?;
        there.set_nodelay(true)?;
        let (back, _) = listener.accept()?;
        back.set_nodelay(true)?;
        echo(there, back, count)
    } else {
        let listener = UnixListener::bind(socket)?;
        let there = UnixStream::connect(socket)?;
        let (back, _) = listener.accept()?;
        std::fs::remove_file(socket)?;
        echo(there, back, count)
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

fn percentiles(mut measured: Vec<Duration>) -> Result<[String; 2]> {
    measured.sort_unstable();
    let at = |percent: usize| measured.get((measured.len() * percent / 100).min(measured.len() - 1));
    let text = |duration: &Duration| format!("{:.3} ms", duration.as_secs_f64() * 1e3);
    Ok([at(50).map(text).context("nothing measured")?, at(99).map(text).context("nothing measured")?])
}
