//! `moca-lab … | head`: a reader that goes ends the program without a word.
#![allow(clippy::unwrap_used, reason = "a test that cannot go on has to stop")]

use std::process::{Command, Stdio};

#[test]
fn nobody_reads_on_and_nothing_panics() {
    let recordings = concat!(env!("CARGO_MANIFEST_DIR"), "/../../tests/fixtures/recordings");
    let stream = format!("{recordings}/datastream-2020.txt");
    for arguments in [&["stream", &stream][..], &["experiment", "--help"]] {
        let mut command = Command::new("timeout");
        let mut child = command
            .args(["-s", "KILL", "240", env!("CARGO_BIN_EXE_moca-lab")])
            .args(arguments)
            .stdout(Stdio::piped())
            .stderr(Stdio::piped())
            .spawn()
            .unwrap();
        // In the worst moment: before anything is printed.
        drop(child.stdout.take());
        let output = child.wait_with_output().unwrap();
        assert_eq!(String::from_utf8_lossy(&output.stderr), "", "{arguments:?}");
    }
}
