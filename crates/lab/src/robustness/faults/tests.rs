//! Every fault that can be injected, against the whole chain in lock-step: none lost, none hung, none goes on moving.

use crate::robustness::trial::{self, Trial};
use moca_daemon::inject::{FAULTS, Injection};
use moca_daemon::runtime::allocations::CountingAllocator;
use moca_msgs::{Fault, Mode};

#[global_allocator]
static ALLOCATOR: CountingAllocator = CountingAllocator;

const SILENT_TICKS: u64 = 150;
const FROZEN_TICKS: u64 = 15 * 25;
/// What goes on: the way a fault may add to the motion that the pressing hand asks for anyway.
const RIDES: &[&str] = &[
    "slow-board",
    "missed-slot",
    "missed-20-slots",
    "missed-500-slots",
    "disk-full",
    "disk-slow",
    "subscriber-stalled",
    "subscriber-gone",
    "socket-garbage",
    "parameter-nan",
    "parameter-absurd",
];
/// A taxel that slowly drifts down is, to any reader, a hand that slowly presses: the robot gives way to it.
const LOOKS_LIKE_A_HAND: &str = "taxel-drifting";

/// Largest number of ticks to the stop, and the code that may be named.
fn expected(name: &str) -> (u64, &'static [&'static str]) {
    match name {
        "unplugged" | "replugged" | "port-refused" => (1, &["board-lost"]),
        "frozen" => (FROZEN_TICKS, &["board-frozen"]),
        "chip-reset" => (60, &["board-reset"]),
        // Three frames, the last of which is printed 25 ms after its read.
        "common-mode" => (100, &["board-common-mode"]),
        "thresholds" => (60, &["board-thresholds"]),
        "taxel-stuck" => (60 * 25 + 50, &["taxel-invalid"]),
        "taxel-dead" => (100, &["taxel-invalid"]),
        "taxel-saturated" => (60, &["taxel-invalid"]),
        "taxel-noisy" => (100 * 25, &["taxel-invalid"]),
        "joint-nan" | "joint-rate-infinite" | "joint-jump" | "base-nan" | "base-jump" => {
            (1, &["state-invalid"])
        }
        "panel-gone" => (1, &["operator-lost"]),
        "plant-lost" => (1, &["plant-lost"]),
        "command-refused" => (1, &["control-refused"]),
        "arm-stale" => (11, &["arm-stale"]),
        "base-stale" => (101, &["base-stale"]),
        // One frame in three comes through whole, and each starts the deadline of silence anew.
        "byte-lost" | "bit-flipped" => (500, &["board-silent", "board-thresholds", "taxel-invalid"]),
        // Spoiled lines: silence at the latest, changed thresholds if a spoiled line still passes as a frame.
        _ => (SILENT_TICKS, &["board-silent", "board-thresholds"]),
    }
}

fn check(trial: &Trial) {
    let name = trial.fault.name;
    assert_eq!(trial.allocations, 0, "{name}: allocations on the loop's thread");
    let reported = trial.reported.as_deref().unwrap_or_default();
    let expected_words = match name {
        "disk-full" => "no storage space",
        "disk-slow" => "samples are in the log",
        "parameter-nan" | "parameter-absurd" => "refused",
        "panel-gone" => "done",
        "subscriber-stalled" | "subscriber-gone" | "socket-garbage" => "dropped for clients",
        _ => "",
    };
    assert!(reported.contains(expected_words), "{name}: reported {reported:?}");
    if RIDES.contains(&name) || name == LOOKS_LIKE_A_HAND {
        assert_eq!((trial.mode, trial.cause), (Mode::Impedance, None), "{name}");
        assert!(!name.starts_with("missed") || trial.overruns > 0, "{name}: not counted");
        return;
    }
    let (ticks, causes) = expected(name);
    let reaction = trial.reaction_ticks.unwrap_or_else(|| unreachable_in_test(name));
    assert!(reaction <= ticks, "{name}: stopped after {reaction} ticks, allowed {ticks}");
    let cause = trial.cause.map(Fault::code).unwrap();
    assert!(causes.contains(&cause), "{name} was taken for {cause}");
    let stop = if trial.cause.is_some_and(|cause| cause.reaction() == moca_msgs::Reaction::Fault) {
        Mode::Fault
    } else {
        Mode::ProtectiveStop
    };
    assert_eq!(trial.mode, stop, "{name}: a stop is left only by request");
    assert!(
        trial.speed_after_m_s < 2e-3,
        "{name}: {} m/s half a second after the stop",
        trial.speed_after_m_s
    );
}

fn unreachable_in_test(name: &str) -> u64 {
    panic!("{name}: the robot went on")
}

#[test]
fn every_injected_fault_ends_where_the_table_says_in_its_time() {
    assert!(FAULTS.len() >= 48, "{}", FAULTS.len());
    // Two seeds, on two threads: the spoiled bytes differ, what comes of them may not.
    std::thread::scope(|scope| {
        for (seed, ticks) in [(1, 10_000), (2, 4000)] {
            scope.spawn(move || {
                FAULTS.iter().for_each(|fault| check(&trial::run(*fault, seed, ticks).unwrap()))
            });
        }
    });
}

#[test]
fn a_fault_is_named_on_the_command_line_or_refused_with_what_there_is() {
    let injection: Injection = "unplugged@2.5".parse().unwrap();
    assert_eq!((injection.fault.name, injection.at_ns), ("unplugged", 2_500_000_000));
    assert!("unplugged".parse::<Injection>().unwrap_err().contains("NAME@SECONDS"));
    assert!("gremlin@1".parse::<Injection>().unwrap_err().contains("host-stall"));
    assert!("silent@-1".parse::<Injection>().is_err());
}
