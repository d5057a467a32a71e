//! Every fault that can be injected, against the whole chain in lock-step: none lost, none hung, none goes on moving.

use crate::robustness::trial::{self, Trial};
use moca_daemon::runtime::allocations::CountingAllocator;
use moca_lockstep::inject::{CableFault, FAULTS, FaultSite, Injection, Named};
use moca_msgs::{Fault, Mode};
use moca_tactile::Firmware;
use std::collections::BTreeSet;

#[global_allocator]
static ALLOCATOR: CountingAllocator = CountingAllocator;

const SILENT_TICKS: u64 = 150;
const FROZEN_TICKS: u64 = 15 * 25;
/// Faults that may add displacement to the motion of the pressing hand.
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
                FAULTS
                    .iter()
                    .for_each(|fault| check(&trial::run(*fault, Firmware::Stock2018, seed, ticks).unwrap()))
            });
        }
    });
}

/// Ticks after the strike that leave time for the slowest reaction.
const DIALECT_TICKS: u64 = 2600;
/// Codes that may be named with our firmware, an empty one where the robot goes on. A line that comes twice is refused,
/// one that is missing is counted, and the rest is in time.
fn expected_of_ours(name: &str) -> &'static [&'static str] {
    match name {
        "line-repeated" | "slow-board" | "taxel-drifting" | "byte-lost" | "bit-flipped" => &[""],
        "garbage" => &["", "board-silent"],
        "line-missing" => &["board-slow"],
        "unplugged" | "replugged" | "port-refused" => &["board-lost"],
        "frozen" => &["board-frozen"],
        "chip-reset" => &["board-reset"],
        "common-mode" => &["board-common-mode"],
        "taxel-stuck" | "taxel-dead" | "taxel-saturated" | "taxel-noisy" => &["taxel-invalid"],
        _ => &["board-silent"],
    }
}

#[test]
fn every_fault_of_the_cable_changes_the_run_of_every_firmware() {
    let of_cable = |fault: &&Named| matches!(fault.site, FaultSite::Cable(_));
    let none = Named { site: FaultSite::MissedSlots(0), ..FAULTS[0] };
    std::thread::scope(|scope| {
        for firmware in Firmware::ALL {
            scope.spawn(move || {
                let run =
                    |fault, ticks| trial::run(fault, firmware, 1, ticks).map_err(|error| error.to_string());
                let untouched = |ticks| run(none, ticks).unwrap().digest;
                let (short, long) = (untouched(DIALECT_TICKS), untouched(2 * DIALECT_TICKS));
                for fault in FAULTS.iter().filter(of_cable) {
                    let name = fault.name;
                    // Baselines are missed after three seconds.
                    let (ticks, untouched) = if name == "line-missing" {
                        (2 * DIALECT_TICKS, long)
                    } else {
                        (DIALECT_TICKS, short)
                    };
                    match run(*fault, ticks) {
                        Ok(trial) => {
                            assert_ne!(trial.digest, untouched, "{firmware:?}: {name} changes nothing");
                            let cause = trial.cause.map_or("", Fault::code);
                            let fits = expected_of_ours(name).contains(&cause);
                            assert!(firmware != Firmware::Moca || fits, "{name} ended with {cause:?}");
                        }
                        Err(why) => {
                            assert_eq!((firmware, name), (Firmware::Moca, "thresholds"), "{why}");
                            assert!(why.contains("these apply here: garbage, torn-line,"), "{why}");
                        }
                    }
                }
            });
        }
    });
}

#[test]
fn every_fault_of_the_cable_has_its_name() {
    let of_cable: BTreeSet<String> = FAULTS
        .iter()
        .filter_map(|fault| match fault.site {
            FaultSite::Cable(fault) => Some(format!("{fault:?}")),
            _ => None,
        })
        .collect();
    assert_eq!(of_cable.len(), 1 + CableFault::CommonMode as usize);
}

#[test]
fn unknown_fault_is_refused_with_list() {
    let injection: Injection = "unplugged@2.5".parse().unwrap();
    assert_eq!((injection.fault.name, injection.at_ns), ("unplugged", 2_500_000_000));
    assert!("unplugged".parse::<Injection>().unwrap_err().contains("NAME@SECONDS"));
    assert!("gremlin@1".parse::<Injection>().unwrap_err().contains("host-stall"));
    assert!("silent@-1".parse::<Injection>().is_err());
}
