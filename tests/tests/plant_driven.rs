//! A loop without a timer: an arm's datagrams are its clock, as with a robot that waits for a torque to each state.
#![allow(clippy::unwrap_used, clippy::expect_used, reason = "a test that cannot go on has to stop")]

use moca_control::assemble::{motion, supervisor};
use moca_control::config::Config;
use moca_control::plant::{Datagram, Plant, PlantClock, SourceAge};
use moca_control::robot::{JOINTS, Parts};
use moca_control::stage::Stage;
use moca_control::tick::ControlLoop;
use moca_daemon::runtime::clock::Clock;
use moca_daemon::runtime::live::{self, Rings, Shared};
use moca_daemon::runtime::recovery::Recovery;
use moca_daemon::runtime::tick_source::PlantTicks;
use moca_daemon::runtime::timing::Timing;
use moca_lockstep::touch_board::ByteCover;
use moca_msgs::{Actuation, Fault, Mode, RobotState, Sample, robot};
use std::net::UdpSocket;
use std::sync::atomic::Ordering;
use std::time::Duration;

const PERIOD_NS: u64 = 1_000_000;
/// Longest wait for a datagram, in periods: a busy machine is not a silent arm.
const PATIENCE: u32 = 60;
const BRAKE: f64 = f64::NAN;

/// The loop's end of the line: a count and seven angles come in, seven torques go out.
struct DatagramArm {
    socket: UdpSocket,
    state: RobotState<7>,
    /// Time waited in vain since the last datagram, as asked for.
    silent: Duration,
    /// States after which reading one panics.
    reads_left: u64,
}

impl DatagramArm {
    fn datagram(&mut self) -> Option<u64> {
        let mut bytes = [0; 64];
        (self.socket.recv(&mut bytes).ok()? == bytes.len()).then(|| {
            for (q, field) in self.state.q_rad.iter_mut().zip(bytes[8..].chunks_exact(8)) {
                *q = f64::from_le_bytes(field.try_into().unwrap());
            }
            u64::from_le_bytes(bytes[..8].try_into().unwrap())
        })
    }
}

impl PlantClock for DatagramArm {
    fn receive(&mut self, timeout: Duration) -> Datagram {
        self.socket.set_read_timeout(Some(timeout * PATIENCE)).unwrap();
        let count = self.datagram();
        self.silent = if count.is_some() { Duration::ZERO } else { self.silent + timeout };
        count.map_or(Datagram::Missing, Datagram::Count)
    }
}

impl Plant for DatagramArm {
    fn read(&mut self) -> Result<RobotState<JOINTS>, Fault> {
        self.reads_left = self.reads_left.checked_sub(1).expect("this arm's driver has an error");
        Ok(self.state.resized())
    }

    fn age(&self) -> SourceAge {
        SourceAge { arm_s: self.silent.as_secs_f64(), base_s: 0.0 }
    }

    fn write(&mut self, actuation: &Actuation<JOINTS>, _ticks: u64) -> Result<(), Fault> {
        let torque_nm = match actuation {
            Actuation::Drive(command) => command.resized().arm_torque_nm,
            Actuation::Brake => [BRAKE; 7],
        };
        let bytes: Vec<u8> = torque_nm.iter().flat_map(|torque| torque.to_le_bytes()).collect();
        self.socket.send(&bytes).map(|_| ()).map_err(|_| Fault::PlantLost)
    }
}

/// The arm's end: sends a state, then waits for its torque; nothing here asks a clock.
struct Robot(UdpSocket);

impl Robot {
    fn exchange(&self, count: u64) -> f64 {
        let state = robot::PANDA.home_rad;
        let bytes: Vec<u8> =
            count.to_le_bytes().into_iter().chain(state.iter().flat_map(|q| q.to_le_bytes())).collect();
        self.0.send(&bytes).unwrap();
        self.torque()
    }

    fn torque(&self) -> f64 {
        let mut bytes = [0; 56];
        assert_eq!(self.0.recv(&mut bytes).unwrap(), bytes.len());
        f64::from_le_bytes(bytes[8..16].try_into().unwrap())
    }
}

fn connected() -> (DatagramArm, Robot) {
    let (ours, theirs) = (UdpSocket::bind("127.0.0.1:0").unwrap(), UdpSocket::bind("127.0.0.1:0").unwrap());
    ours.connect(theirs.local_addr().unwrap()).unwrap();
    theirs.connect(ours.local_addr().unwrap()).unwrap();
    theirs.set_read_timeout(Some(Duration::from_secs(60))).unwrap();
    let state = RobotState::at_rest(robot::PANDA.home_rad);
    (DatagramArm { socket: ours, state, silent: Duration::ZERO, reads_left: u64::MAX }, Robot(theirs))
}

#[test]
fn arm_datagrams_drive_loop_and_silence_stops_it() {
    let (plant, robot) = connected();
    let mut config = Config::default();
    config.plant.parts = Parts::Arm;
    let cover: Option<ByteCover> = None;
    let mut control = ControlLoop::new(plant, cover, supervisor(&config), motion(&config).unwrap(), 1e-3);
    let (samples, mut watched) = rtrb::RingBuffer::new(1 << 14);
    let (_sender, requests) = moca_telemetry::net::request_channel();
    let mut rings = Rings { samples, requests, tick_log: None, recovery: Recovery::default() };
    let mut ticks = PlantTicks::new(Clock::start().unwrap(), PERIOD_NS);
    let mut timing = Timing::new().unwrap();
    let shared = Shared::default();
    let next = |watched: &mut rtrb::Consumer<Sample>| loop {
        match watched.pop() {
            Ok(sample) => break sample,
            Err(_) => std::thread::yield_now(),
        }
    };

    let report = std::thread::scope(|scope| {
        let run = scope.spawn(|| live::run(&mut control, &mut ticks, &mut timing, None, &mut rings, &shared));
        // Every datagram is one tick, with the plant's own count.
        let mut held = 0.0;
        for count in 0..500 {
            held = robot.exchange(count);
        }
        assert!(held.is_finite() && held != 0.0, "the arm is held: {held} N·m at joint 2");
        let mut sample = next(&mut watched);
        while sample.tick < 499 {
            sample = next(&mut watched);
        }
        assert_eq!((sample.tick, sample.mode), (499, Mode::Impedance));
        let rounded = robot::PANDA.home_rad.map(|q_rad| (q_rad * 1_048_576.0).round() / 1_048_576.0);
        assert!(rounded != robot::PANDA.home_rad && sample.q_rad == rounded, "{:?}", sample.q_rad);
        let before = sample.overruns;

        robot.exchange(504);
        let sample = next(&mut watched);
        assert_eq!((sample.tick, sample.overruns), (504, before + 4), "four datagrams were lost");

        // Silence: the loop ticks on its own until the arm's state is too old, and then it brakes.
        while robot.torque().is_finite() {}
        let mut sample = next(&mut watched);
        while sample.mode.moves() {
            sample = next(&mut watched);
        }
        assert_eq!((sample.mode, sample.fault), (Mode::ProtectiveStop, Some(Fault::ArmStale)));

        shared.stop.store(true, Ordering::Relaxed);
        run.join().unwrap()
    });
    assert!(report.overruns_by_stage[Stage::Read as usize] >= 4, "{report:?}");
}

#[test]
fn a_panic_in_the_loop_brakes_the_robot_and_ends_the_loop() {
    let (mut plant, robot) = connected();
    plant.reads_left = 50;
    let mut config = Config::default();
    config.plant.parts = Parts::Arm;
    let cover: Option<ByteCover> = None;
    let mut control = ControlLoop::new(plant, cover, supervisor(&config), motion(&config).unwrap(), 1e-3);
    let (samples, _watched) = rtrb::RingBuffer::new(1 << 10);
    let (_sender, requests) = moca_telemetry::net::request_channel();
    let mut rings = Rings { samples, requests, tick_log: None, recovery: Recovery::default() };
    let mut ticks = PlantTicks::new(Clock::start().unwrap(), PERIOD_NS);
    let mut timing = Timing::new().unwrap();
    let shared = Shared::default();
    std::thread::scope(|scope| {
        let run = scope.spawn(|| live::run(&mut control, &mut ticks, &mut timing, None, &mut rings, &shared));
        for count in 0..50 {
            robot.exchange(count);
        }
        assert!(robot.exchange(50).is_nan(), "the last order is to brake");
        assert!(run.join().is_err());
    });
}
