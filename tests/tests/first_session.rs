//! The first session of README.md, typed as it stands there.
#![allow(clippy::unwrap_used, clippy::expect_used, reason = "a test that cannot go on has to stop")]

use moca_tests::Limited;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::time::{Duration, Instant};

/// Ends a test that would hang; nothing passes or fails by how long something took before this.
const HANGS_AFTER: Duration = Duration::from_secs(60);

/// A program of the README, with a runtime folder of its own in place of the user's.
fn mocad(arguments: &[&str], folder: &Path) -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_mocad-under-test"));
    command.args(arguments).env("XDG_RUNTIME_DIR", folder).env("HOME", folder).current_dir(folder);
    command
}

/// Commands of the first session, without their comments.
fn session() -> Vec<Vec<String>> {
    let readme = Path::new(env!("CARGO_MANIFEST_DIR")).join("../README.md");
    let readme = std::fs::read_to_string(readme).unwrap();
    let (_, session) = readme.split_once("A first session").unwrap();
    assert!(
        session.split_once("```sh").unwrap().0.contains("cargo run --release -- --no-hand"),
        "how it is started"
    );
    let (block, _) = session.split_once("```sh\n").unwrap().1.split_once("```").unwrap();
    let words = |line: &str| -> Vec<String> {
        line.split('#').next().unwrap().split_whitespace().skip(1).map(str::to_owned).collect()
    };
    block.lines().inspect(|line| assert!(line.starts_with("mocad "), "{line}")).map(words).collect()
}

#[test]
fn first_session_of_the_readme_works_as_typed() {
    let folder = PathBuf::from(env!("CARGO_TARGET_TMPDIR")).join("first-session");
    let _ = std::fs::remove_dir_all(&folder);
    std::fs::create_dir_all(&folder).unwrap();
    let _daemon = mocad(&["--no-hand"], &folder).stdout(Stdio::null()).start().unwrap();
    let until = Instant::now() + HANGS_AFTER;
    // The law's name stands in another line from the start; the mode is impedance only after the tare.
    let moves = |output: std::process::Output| {
        let text = String::from_utf8_lossy(&output.stdout);
        text.lines().any(|line| line.split_whitespace().eq(["mode", "impedance"]))
    };
    while !moves(mocad(&["status"], &folder).run().unwrap()) {
        assert!(Instant::now() < until, "the daemon never answers");
        std::thread::sleep(Duration::from_millis(100));
    }
    let session = session();
    assert!(session.len() >= 6, "{session:?}");
    for arguments in session {
        let arguments: Vec<&str> = arguments.iter().map(String::as_str).collect();
        let output = mocad(&arguments, &folder).run().unwrap();
        let text = String::from_utf8_lossy(&output.stderr);
        assert!(output.status.success(), "mocad {}: {:?}: {text}", arguments.join(" "), output.status);
        assert!(!output.stdout.is_empty(), "mocad {} prints nothing", arguments.join(" "));
    }
}
