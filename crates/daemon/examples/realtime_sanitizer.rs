//! The loop's tick, simulation and publishing included, under RealtimeSanitizer: any allocation, lock or blocking call
//! in it ends this program with a stack.
//!
//! `.ci/rtsan` builds and runs it where the toolchain has the sanitizer's library. Without it nothing is watched, and it
//! says so.
#![expect(clippy::print_stdout, reason = "this is what the program is for")]
#![allow(clippy::expect_used, reason = "a check that cannot go on has to stop")]

use moca_control::config::{Config, HandConfig};
use moca_control::tick::Ticked;
use moca_daemon::record::tick_log::tick_log;
use moca_daemon::runtime::live::{Rings, Shared};
use moca_daemon::runtime::recovery::Recovery;
use moca_lockstep::simulated_robot::free_scene;
use moca_lockstep::touch_board::ByteCover;
use moca_lockstep::{Feed, LockStep, MemoryBoards};
use moca_msgs::{Law, Mode, Request};
use moca_sim::VirtualBoardConfig;
use moca_sim::board::BoardFailure;

/// Ticks in each mode.
const TICKS: u64 = 10_000;

type World = LockStep<ByteCover, MemoryBoards>;

fn main() {
    // What a real-time context must not do, to show that it would be seen.
    if std::env::args().nth(1).as_deref() == Some("--break-it") {
        rtsan_standalone::realtime_enter();
        let on_the_heap = std::hint::black_box(Box::new(0_u8));
        rtsan_standalone::realtime_exit();
        println!("nobody saw the allocation of {on_the_heap}");
        return;
    }
    let mut config = Config::default();
    config.simulation.hand = HandConfig::none();
    (config.startup.arm, config.startup.tare) = (false, false);
    let mut world = LockStep::with_board(&config, &free_scene(&config), VirtualBoardConfig::default(), None)
        .expect("the default scene");
    // A board's line grows with what waits in it; a port of the kernel's has its room from the start.
    Feed::reserve(&mut world.feed);
    watched(&mut world, Mode::Starting, &[]);
    watched(&mut world, Mode::Ready, &[Request::Tare]);
    let press = |force_n| Request::PressTaxel { taxel: 2, force_n };
    watched(&mut world, Mode::Impedance, &[Request::Arm, press(15.0)]);
    watched(&mut world, Mode::FollowMe, &[Request::SelectLaw(Law::FollowMe)]);
    world.feed[0].board().set_fault(Some(BoardFailure::I2cLost));
    watched(&mut world, Mode::ProtectiveStop, &[press(0.0)]);
    world.feed[0].unplug();
    watched(&mut world, Mode::ProtectiveStop, &[]);
}

/// Runs `requests` and the rest of [`TICKS`] in a real-time context; it must end in `mode`.
fn watched(world: &mut World, mode: Mode, requests: &[Request]) {
    let (samples, _client) = rtrb::RingBuffer::new(1024);
    let (_commander, to_loop) = moca_telemetry::net::request_channel();
    let (log, _copies, _reader) = tick_log();
    let (mut rings, shared) = (
        Rings { samples, requests: to_loop, tick_log: Some(log), recovery: Recovery::default() },
        Shared::default(),
    );
    let mut last = None;
    for tick in 0..TICKS {
        let request = usize::try_from(tick).ok().and_then(|i| requests.get(i)).copied();
        rtsan_standalone::realtime_enter();
        world.tick(request);
        let Ticked { sample, input } = world.control.ticked();
        rings.note(input, || world.control.state());
        last = Some(sample.mode);
        rings.publish(sample, Some(tick), input.outcome, &shared);
        rtsan_standalone::realtime_exit();
    }
    assert_eq!(last, Some(mode), "the mode at the end");
    println!("{TICKS} ticks to {}", mode.name());
}
