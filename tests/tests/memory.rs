//! Memory of a run and of everything that watches it: what is kept between ticks has a bound.
#![expect(unsafe_code, reason = "an allocator that knows how much is in use")]

use moca_control::config::{Config, HandConfig};
use moca_daemon::record::flight_recorder::FlightRecorder;
use moca_daemon::record::tick_log::tick_log;
use moca_daemon::runtime::clients::rings;
use moca_daemon::runtime::live::Shared;
use moca_lockstep::LockStep;
use moca_lockstep::simulated_robot::free_scene;
use moca_msgs::{Mode, Request, Sample};
use moca_sim::{Engine, VirtualBoardConfig};
use moca_telemetry::RobotDescription;
use moca_telemetry::log::{LogWriter, Meta, SerialBytes};
use moca_telemetry::net::{Address, Connection, serve};
use std::alloc::{GlobalAlloc, Layout, System};
use std::os::unix::net::UnixStream;
use std::sync::Mutex;
use std::sync::atomic::{AtomicI64, Ordering};
use std::time::Duration;

static IN_USE: AtomicI64 = AtomicI64::new(0);

struct Counting;

#[expect(clippy::cast_possible_wrap, reason = "sizes are far below 2^63")]
fn count(more: usize, less: usize) {
    IN_USE.fetch_add(more as i64 - less as i64, Ordering::Relaxed);
}

// SAFETY: every method passes its arguments unchanged to `System`, which upholds the contract of `GlobalAlloc`.
unsafe impl GlobalAlloc for Counting {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        count(layout.size(), 0);
        // SAFETY: the caller upholds the contract of `alloc`.
        unsafe { System.alloc(layout) }
    }

    unsafe fn alloc_zeroed(&self, layout: Layout) -> *mut u8 {
        count(layout.size(), 0);
        // SAFETY: the caller upholds the contract of `alloc_zeroed`.
        unsafe { System.alloc_zeroed(layout) }
    }

    unsafe fn realloc(&self, pointer: *mut u8, layout: Layout, new_size: usize) -> *mut u8 {
        count(new_size, layout.size());
        // SAFETY: the caller upholds the contract of `realloc`.
        unsafe { System.realloc(pointer, layout, new_size) }
    }

    unsafe fn dealloc(&self, pointer: *mut u8, layout: Layout) {
        count(0, layout.size());
        // SAFETY: the caller upholds the contract of `dealloc`.
        unsafe { System.dealloc(pointer, layout) }
    }
}

#[global_allocator]
static ALLOCATOR: Counting = Counting;

/// One at a time: the count is of the whole program.
static ALONE: Mutex<()> = Mutex::new(());

/// Bytes in use once no thread changes them any more.
fn at_rest() -> i64 {
    let mut last = i64::MIN;
    for _ in 0..100 {
        std::thread::sleep(Duration::from_millis(100));
        let now = IN_USE.load(Ordering::Relaxed);
        if now == last {
            break;
        }
        last = now;
    }
    last
}

/// Robot time of a measurement, ticks: more than the flight recorder keeps.
const PERIOD: u64 = 30_000;
const PERIODS: u64 = 5;
/// Growth that is no leak, bytes. A hundred bytes kept of each tick would be 9 MB.
const GROWTH_MAX: i64 = 256 * 1024;

/// A hand, a cable that is pulled, stops by faults with their files, and an operator: what loop and flight recorder hold after
/// two such periods is all that they ever hold.
#[test]
fn memory_of_loop_and_flight_recorder_is_bounded() {
    let _alone = ALONE.lock().unwrap();
    let mut config = Config::default();
    config.simulation.hand = HandConfig::none();
    config.startup.arm = false;
    let folder = std::env::temp_dir().join(format!("mocad-memory-{}", std::process::id()));
    config.flight_recorder.folder = folder.display().to_string();
    let scene = moca_sim::Scene { engine: Engine::Analytic, ..free_scene(&config) };
    let (mut log, events, mut ticks) = tick_log();
    let board = VirtualBoardConfig::default();
    let mut world = LockStep::with_board(&config, &scene, board, Some(events)).unwrap();
    let description = RobotDescription::paper("memory", true);
    let mut flight = FlightRecorder::new(&config, description).unwrap().unwrap();

    let (mut in_use, mut files, mut moved) = (Vec::new(), 0, 0);
    for _ in 0..PERIODS {
        for tick in 0..PERIOD {
            let request = match tick {
                4_000 => Some(Request::Resume),
                4_500 => Some(Request::Arm),
                5_000 => Some(Request::PressTaxel { taxel: 5, force_n: 30.0 }),
                12_000 => Some(Request::PressTaxel { taxel: 5, force_n: 0.0 }),
                20_500 => Some(Request::Tare),
                _ => None,
            };
            match tick {
                15_000 => world.feed[0].unplug(),
                17_000 => world.feed[0].replug(),
                _ => {}
            }
            let (sample, _) = world.step(request);
            let input = world.control.ticked().input;
            log.push(input, || world.control.state());
            while let Some(state) = ticks.next_state() {
                flight.add_state(state);
            }
            while let Some(record) = ticks.next_tick() {
                flight.add_tick(record);
            }
            files += u64::from(flight.add(&sample).is_some());
            moved += u64::from(sample.mode == Mode::Impedance);
        }
        in_use.push(at_rest());
    }
    println!("bytes in use every 30 s: {in_use:?}");
    assert!(files >= PERIODS && moved > PERIODS * PERIOD / 3, "{files} files, {moved} ticks in a law");
    let growth = in_use.iter().skip(2).map(|bytes| bytes - in_use[1]).max().unwrap();
    assert!(growth < GROWTH_MAX, "bytes in use: {in_use:?}");
    drop(flight);
    std::fs::remove_dir_all(folder).unwrap();
}

/// MuJoCo's own memory is in C, and not counted.
#[test]
fn robot_of_a_batch_holds_at_most_100_kilobytes() {
    const ROBOTS: i64 = 16;
    let _alone = ALONE.lock().unwrap();
    let config = Config::default();
    let [analytic, mujoco] = [Engine::Analytic, Engine::MuJoCo].map(|engine| {
        let scene = moca_sim::Scene { engine, ..free_scene(&config) };
        let robot = |seed| {
            let board = VirtualBoardConfig { seed, ..VirtualBoardConfig::default() };
            let mut world = Box::new(LockStep::with_board(&config, &scene, board, None).unwrap());
            while !world.tick(None).sample.mode.moves() {}
            world
        };
        // what the first one of a program builds for all is not one robot's
        drop(robot(0));
        let before = IN_USE.load(Ordering::Relaxed);
        let robots: Vec<_> = (0..ROBOTS.unsigned_abs()).map(robot).collect();
        let held = IN_USE.load(Ordering::Relaxed) - before;
        drop(robots);
        held / ROBOTS
    });
    println!("bytes of a robot: analytic {analytic}, MuJoCo {mujoco} and what it holds in C");
    assert!((1_000..=100_000).contains(&analytic), "{analytic} bytes");
}

/// Clients that never read: what waits for them, in the server and in a client's library, has an end.
#[test]
fn memory_of_unread_samples_is_bounded() {
    let _alone = ALONE.lock().unwrap();
    let shared = Shared::default();
    let (mut rings, samples, ports) = rings(&shared);
    let socket = std::env::temp_dir().join(format!("mocad-memory-{}.sock", std::process::id()));
    let address = Address::Unix(socket.clone());
    let server =
        serve(&address, 0o600, RobotDescription::paper("memory", true), ports.with(samples, None)).unwrap();
    let unread = Connection::spawn(server.address().clone(), || {}).unwrap();
    let _deaf = UnixStream::connect(&socket).unwrap();
    let mut in_use = Vec::new();
    for _ in 0..4 {
        for tick in 0..15_000 {
            rings.publish(&Sample { tick, ..Sample::default() }, None, None, &shared);
            if tick.is_multiple_of(50) {
                // The server takes a batch every 10 ms.
                std::thread::sleep(Duration::from_millis(5));
            }
        }
        in_use.push(at_rest());
    }
    let held = unread.poll().samples.len();
    println!("{held} samples, bytes in use every 15000: {in_use:?}");
    assert!(held > 5_000, "{held} samples came");
    let growth = in_use.iter().skip(2).map(|bytes| bytes - in_use[1]).max().unwrap();
    assert!(growth < GROWTH_MAX, "bytes in use: {in_use:?}");
}

/// A log of two hours: nothing of a chunk is kept once it is written but its place.
#[test]
fn memory_of_log_writer_grows_by_less_than_100_bytes_a_second() {
    const SECONDS: u64 = 7200;
    let _alone = ALONE.lock().unwrap();
    let meta = Meta { description: RobotDescription::paper("memory", true), start_unix_ns: 1 };
    let mut log = LogWriter::new(std::io::sink(), &meta).unwrap();
    let mut after_ten_minutes = 0;
    for second in 0..SECONDS {
        let time_ns = second * 1_000_000_000;
        log.sample(&Sample { tick: 1000 * second, time_ns, ..Sample::default() }).unwrap();
        log.serial(&SerialBytes { board: 0, arrival_ns: time_ns, bytes: vec![7; 100] }).unwrap();
        log.replay(time_ns, &second.to_le_bytes().repeat(100)).unwrap();
        if second == 600 {
            after_ten_minutes = IN_USE.load(Ordering::Relaxed);
        }
    }
    let growth = IN_USE.load(Ordering::Relaxed) - after_ten_minutes;
    println!("{growth} bytes more after two hours than after ten minutes");
    assert!(growth < 100 * i64::try_from(SECONDS).unwrap(), "{growth} bytes");
    log.finish().unwrap();
}
