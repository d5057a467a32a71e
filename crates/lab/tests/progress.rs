//! A command of more than two seconds shows a bar with the remaining time on a terminal, and nowhere else.
#![allow(clippy::unwrap_used, reason = "a test that cannot go on has to stop")]

use nix::pty::openpty;
use std::io::Read as _;
use std::process::{Command, Stdio};

/// Standard error of a command that takes twice three seconds on any machine: it measures a live loop.
fn shown(options: &[&str], terminal: bool) -> String {
    let mut command = Command::new("timeout");
    command
        .args(["-s", "KILL", "240", env!("CARGO_BIN_EXE_moca-lab"), "clients", "--seconds", "3"])
        .args(options);
    command.stdin(Stdio::null()).stdout(Stdio::null());
    if !terminal {
        return String::from_utf8(command.stderr(Stdio::piped()).output().unwrap().stderr).unwrap();
    }
    let pty = openpty(None, None).unwrap();
    let mut child = command.stderr(Stdio::from(pty.slave)).spawn().unwrap();
    // This process's copy of the terminal's other end goes with the command: then reading ends.
    drop(command);
    let mut shown = Vec::new();
    let mut master = std::fs::File::from(pty.master);
    let mut part = [0; 4096];
    while let Ok(length @ 1..) = master.read(&mut part) {
        shown.extend_from_slice(&part[..length]);
    }
    assert!(child.wait().unwrap().success());
    String::from_utf8(shown).unwrap()
}

#[test]
fn bar_is_shown_on_a_terminal_and_nowhere_else() {
    let bar = shown(&[], true);
    assert!(bar.contains("clients [#") && bar.contains(" left"), "{bar:?}");
    assert!(bar.ends_with("\r\u{1b}[K"), "the bar goes away: {bar:?}");
    for (options, terminal) in [(&[][..], false), (&["--quiet"], true)] {
        let shown = shown(options, terminal);
        assert!(!shown.contains('[') && !shown.contains(" left"), "{options:?}: {shown:?}");
    }
}
