//! One tick of the loop in memory: Touch Board bytes in, command out.
//!
//! `loop/tick` is the whole tick with the simulated robot; `loop/bytes_to_command` leaves the plant out, as on a robot
//! that only has to be told; `loop/plant` is the bare physics step, so that the difference is what the software costs.
#![allow(clippy::unwrap_used, missing_docs, reason = "a benchmark stops at the first surprise")]

use criterion::{Criterion, criterion_group, criterion_main};
use moca_control::assemble::{cover_config, motion, supervisor};
use moca_control::config::{Config, HandConfig};
use moca_control::plant::Plant;
use moca_control::robot::JOINTS;
use moca_control::stage::Untimed;
use moca_control::tick::ControlLoop;
use moca_control::tick_input::Slot;
use moca_lockstep::LockStep;
use moca_lockstep::board_events::BoardEvents;
use moca_lockstep::simulated_robot::free_scene;
use moca_lockstep::touch_board::ByteCover;
use moca_msgs::{Actuation, Fault, Mode, Request, RobotState};
use moca_sim::VirtualBoardConfig;
use moca_tactile::{BoardEvent, Cover};
use std::hint::black_box;

/// A robot that stands in its home posture whatever it is told.
struct StandingRobot(RobotState<JOINTS>);

impl Plant for StandingRobot {
    fn read(&mut self) -> Result<RobotState<JOINTS>, Fault> {
        Ok(self.0)
    }

    fn write(&mut self, actuation: &Actuation<JOINTS>, _ticks: u64) -> Result<(), Fault> {
        black_box(actuation);
        Ok(())
    }
}

fn config() -> Config {
    let mut config = Config::default();
    config.simulation.hand = HandConfig::none();
    config
}

/// The bytes of every tick of a run with one taxel pressed, recorded once.
fn recorded_events(ticks: u64) -> Vec<Vec<BoardEvent>> {
    let (copies, mut out) = rtrb::RingBuffer::new(64);
    let mut world =
        LockStep::with_board(&config(), &free_scene(&config()), VirtualBoardConfig::default(), Some(copies))
            .unwrap();
    (0..ticks)
        .map(|tick| {
            let request = (tick == 2000).then_some(Request::PressTaxel { taxel: 5, force_n: 20.0 });
            world.step(request);
            std::iter::from_fn(|| out.pop().ok().map(|copy| copy.event)).collect()
        })
        .collect()
}

fn bench(criterion: &mut Criterion) {
    let mut group = criterion.benchmark_group("loop");

    group.bench_function("bytes_to_command", |bencher| {
        let events = recorded_events(6000);
        let (mut cable, consumer) = rtrb::RingBuffer::new(64);
        let cover = ByteCover::new(
            Cover::new(cover_config(&config()).unwrap()).unwrap(),
            BoardEvents::new([consumer]),
        );
        let world =
            LockStep::with_board(&config(), &free_scene(&config()), VirtualBoardConfig::default(), None)
                .unwrap();
        let standing = StandingRobot(world.control.plant.world.state());
        let config = config();
        let mut control =
            ControlLoop::new(standing, cover, supervisor(&config), motion(&config).unwrap(), 1e-3);
        let mut tick = 0_u64;
        let mut run = |cable: &mut rtrb::Producer<BoardEvent>| {
            // After the recording its last second repeats; the frame under way at the seam is torn.
            let index = usize::try_from(if tick < 6000 { tick } else { 5012 + (tick - 6000) % 988 }).unwrap();
            let now_ns = tick * 1_000_000;
            for event in &events[index] {
                let event = match event {
                    BoardEvent::Bytes(chunk) => {
                        BoardEvent::Bytes(moca_tactile::board::Chunk::new(now_ns, chunk.bytes()))
                    }
                    other => *other,
                };
                cable.push(event).unwrap();
            }
            let slot = Slot { tick, now_ns, ticks: 1, ..Slot::default() };
            tick += 1;
            control.tick(&slot, None, &mut Untimed).sample.clone()
        };
        for _ in 0..6000 {
            run(&mut cable);
        }
        let mut last = run(&mut cable);
        bencher.iter(|| last = run(&mut cable));
        assert_eq!(last.mode, Mode::Impedance, "the law ran to the end, no fault crept in");
        assert!(last.frames_bad <= 1 + last.tick.saturating_sub(6000) / 988, "only frames at a seam are bad");
    });

    // What a log is given once a second, so that its last ticks can be run again.
    group.bench_function("state", |bencher| {
        let mut world =
            LockStep::with_board(&config(), &free_scene(&config()), VirtualBoardConfig::default(), None)
                .unwrap();
        for _ in 0..2000 {
            world.step(None);
        }
        bencher.iter(|| black_box(world.control.state()));
    });

    group.bench_function("tick", |bencher| {
        let mut world =
            LockStep::with_board(&config(), &free_scene(&config()), VirtualBoardConfig::default(), None)
                .unwrap();
        for _ in 0..2000 {
            world.step(None);
        }
        bencher.iter(|| black_box(world.step(None)));
    });

    group.bench_function("plant", |bencher| {
        let mut world =
            LockStep::with_board(&config(), &free_scene(&config()), VirtualBoardConfig::default(), None)
                .unwrap();
        for _ in 0..2000 {
            world.step(None);
        }
        let plant = &mut world.control.plant.world;
        bencher.iter(|| plant.step().unwrap());
    });
    group.finish();
}

criterion_group!(benches, bench);
criterion_main!(benches);
