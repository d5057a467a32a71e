//! Dependencies between crates: the table of ARCHITECTURE.md, checked against `cargo tree`.
#![allow(clippy::unwrap_used, clippy::expect_used, reason = "a test that cannot read its input has to stop")]

use moca_tests::Limited;
use std::collections::BTreeSet;
use std::process::Command;

/// (crate, what of ours it may use directly, what it may never reach, directly or through others).
const TABLE: &[(&str, &[&str], &[&str])] = &[
    ("moca-msgs", &[], &["nalgebra", "serde", "schemars"]),
    ("moca-figures", &[], &["moca-msgs", "egui", "serde", "resvg"]),
    ("moca-manual", &[], &["moca-msgs", "egui", "serde", "tokio"]),
    ("moca-franka", &["moca-msgs"], &["nalgebra", "egui", "mujoco-rs", "franka-rs"]),
    ("moca-qp", &[], &["moca-msgs", "nalgebra", "serde", "clarabel", "num-traits"]),
    ("moca-telemetry", &["moca-msgs"], &["nalgebra", "egui", "mujoco-rs", "serialport"]),
    ("moca-tactile", &["moca-msgs"], &["nalgebra", "egui", "tokio", "mujoco-rs"]),
    (
        "moca-wbc",
        &["moca-msgs", "moca-qp"],
        &["serde", "log", "tracing", "tokio", "serialport", "mujoco-rs", "egui"],
    ),
    ("moca-ros2", &["moca-manual", "moca-msgs", "moca-telemetry"], &["rustdds", "tokio", "nalgebra", "egui"]),
    ("moca-sim", &["moca-msgs", "moca-tactile", "moca-wbc"], &["egui", "tokio"]),
    (
        "moca-control",
        &["moca-msgs", "moca-telemetry", "moca-tactile", "moca-wbc"],
        &["egui", "moca-sim", "mujoco-rs", "serialport"],
    ),
    (
        "moca-lockstep",
        &["moca-control", "moca-msgs", "moca-tactile"],
        &["egui", "moca-daemon", "clap", "serialport", "mujoco-rs"],
    ),
    (
        "moca-daemon",
        &[
            "moca-control",
            "moca-figures",
            "moca-lockstep",
            "moca-manual",
            "moca-msgs",
            "moca-telemetry",
            "moca-tactile",
            "moca-wbc",
            "moca-sim",
            "moca-ros2",
            "moca-franka",
        ],
        &["egui", "eframe", "resvg", "rustdds", "tungstenite", "moca-monitor", "moca-lab"],
    ),
    (
        "moca-monitor",
        &["moca-manual", "moca-msgs", "moca-telemetry"],
        &["nalgebra", "mujoco-rs", "serialport"],
    ),
    (
        "moca-web",
        &["moca-manual", "moca-msgs", "moca-telemetry"],
        &["nalgebra", "mujoco-rs", "serialport", "egui", "openssl"],
    ),
    ("moca-viewer", &["moca-manual", "moca-telemetry"], &["nalgebra", "mujoco-rs", "serialport", "egui"]),
    (
        "moca-experiments",
        &[
            "moca-control",
            "moca-figures",
            "moca-lockstep",
            "moca-msgs",
            "moca-sim",
            "moca-tactile",
            "moca-wbc",
        ],
        &["egui", "resvg", "skrifa", "pdf-writer", "clap", "moca-daemon", "moca-monitor", "moca-lab"],
    ),
    (
        "moca-lab",
        &[
            "moca-control",
            "moca-experiments",
            "moca-figures",
            "moca-lockstep",
            "moca-manual",
            "moca-msgs",
            "moca-telemetry",
            "moca-tactile",
            "moca-wbc",
            "moca-sim",
            "moca-daemon",
        ],
        &["egui", "eframe", "moca-monitor"],
    ),
];

/// Names of the normal dependencies of `package`, itself left out.
fn tree(package: &str, more: &[&str]) -> BTreeSet<String> {
    let mut command = Command::new(env!("CARGO"));
    command.current_dir(concat!(env!("CARGO_MANIFEST_DIR"), "/.."));
    command.args(["tree", "--offline", "--edges=normal", "--prefix=none", "--package", package]);
    let output = command.args(more).run().expect("cargo tree runs");
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let text = String::from_utf8(output.stdout).unwrap();
    text.lines()
        .filter_map(|line| line.split(' ').next())
        .filter(|name| *name != package)
        .map(Into::into)
        .collect()
}

#[test]
fn every_crate_of_ours_is_in_the_table() {
    let folders = std::fs::read_dir(concat!(env!("CARGO_MANIFEST_DIR"), "/../crates")).unwrap();
    // simavr is GPL-3: its crate is a test tool outside the workspace, which nothing of ours may link.
    let crates: BTreeSet<String> = folders
        .map(|folder| format!("moca-{}", folder.unwrap().file_name().into_string().unwrap()))
        .filter(|name| name != "moca-firmware-sim")
        .collect();
    let listed: BTreeSet<String> = TABLE.iter().map(|(name, ..)| (*name).to_owned()).collect();
    assert_eq!(crates, listed);
}

#[test]
fn dependencies_point_the_way_the_table_says() {
    for (name, may, never) in TABLE {
        for used in tree(name, &["--depth=1"]).iter().filter(|used| used.starts_with("moca-")) {
            assert!(may.contains(&used.as_str()), "{name} may not use {used}");
        }
        let all = tree(name, &[]);
        for banned in *never {
            assert!(!all.contains(*banned), "{name} reaches {banned}");
        }
    }
}

#[test]
fn daemon_links_only_what_its_features_need() {
    let (sim, board): (&[&str], &[&str]) = (&["moca-sim", "mujoco-rs"], &["serialport"]);
    for (features, linked, absent) in [
        ("sim,board", [sim, board].concat(), vec![]),
        ("sim", sim.to_vec(), board.to_vec()),
        ("board", board.to_vec(), sim.to_vec()),
        ("", vec!["moca-wbc"], [sim, board].concat()),
    ] {
        let all = tree("moca-daemon", &["--no-default-features", "--features", features]);
        let reached = |name: &&&str| all.contains(**name);
        assert_eq!(linked.iter().find(|name| !reached(name)), None, "features {features:?}: {all:?}");
        assert_eq!(absent.iter().find(reached), None, "features {features:?}: {all:?}");
    }
}
