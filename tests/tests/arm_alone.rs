//! An arm without a cover, as its user runs it: the same in a build that links no serialport (`--features sim`), which
//! refuses a cover that is read live and says what to do.
#![allow(clippy::unwrap_used, reason = "a test that cannot go on has to stop")]

use moca_tests::Limited;
use std::path::PathBuf;
use std::process::{Command, Output};

fn mocad(name: &str, plant: &str, arguments: &[&str]) -> Output {
    configured(name, &format!("[telemetry]\nlisten = \"\"\n[plant]\n{plant}\n"), arguments)
}

fn configured(name: &str, text: &str, arguments: &[&str]) -> Output {
    let path = PathBuf::from(env!("CARGO_TARGET_TMPDIR")).join(format!("arm-alone-{name}.toml"));
    std::fs::write(&path, text).unwrap();
    let mut mocad = Command::new(env!("CARGO_BIN_EXE_mocad-under-test"));
    mocad.args(["--duration", "1", "--config"]).arg(path).args(arguments).run().unwrap()
}

#[test]
fn an_arm_runs_live_and_nothing_is_said_of_a_board() {
    let output = mocad("live", "parts = \"arm\"", &[]);
    let text = String::from_utf8_lossy(&output.stdout);
    assert!(output.status.success(), "{text}{}", String::from_utf8_lossy(&output.stderr));
    assert!(text.contains("on a stand, no cover") && text.contains("impedance"), "{text}");
    assert!(!text.contains("board"), "{text}");
}

#[test]
fn flange_sensor_of_its_own_is_refused_by_mocad() {
    let output = mocad("own", "kind = \"robot\"\nparts = \"arm\"\nflange_sensor = \"own\"", &[]);
    let said = String::from_utf8_lossy(&output.stderr);
    assert!(!output.status.success() && said.contains("has no driver of a flange sensor"), "{said}");
}

#[cfg(not(feature = "tls"))]
#[test]
fn access_of_other_machines_is_refused_without_its_feature() {
    let text = "[plant]\nparts = \"arm\"\n[telemetry]\nlisten = \"\"\ntls = \"127.0.0.1:0\"\n";
    for arguments in [["--check"].as_slice(), &[]] {
        let output = configured("access", text, arguments);
        let said = String::from_utf8_lossy(&output.stderr);
        assert!(!output.status.success(), "{arguments:?} passes");
        for word in ["telemetry.tls", "feature `tls`", "cargo build"] {
            assert!(said.contains(word), "{arguments:?}: {word:?} is not in {said}");
        }
    }
}

#[cfg(not(feature = "board"))]
#[test]
fn a_cover_runs_in_lock_step_and_live_is_refused_by_name() {
    for (name, plant) in
        [("whole", "parts = \"whole\""), ("none", "kind = \"none\"\n[board]\nport = \"auto\"")]
    {
        let output = mocad(name, plant, &[]);
        let text = String::from_utf8_lossy(&output.stderr);
        assert!(!output.status.success(), "{name} runs");
        for word in ["plant.parts", "board.port", "feature `board`", "cargo build"] {
            assert!(text.contains(word), "{name}: {word:?} is not in {text}");
        }
    }
    assert!(mocad("lock-step", "parts = \"whole\"", &["--as-fast-as-possible"]).status.success());
}
