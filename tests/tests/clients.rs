//! Clients cannot change what the loop commands.
#![allow(clippy::unwrap_used, clippy::expect_used, reason = "a test that cannot go on has to stop")]

use moca_telemetry::net::{Address, Connection};
use moca_tests::{Limited, Program};
use std::os::unix::net::UnixStream;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::time::{Duration, Instant};

fn socket(name: &str) -> Address {
    Address::Unix(std::env::temp_dir().join(format!("moca-clients-{}-{name}.sock", std::process::id())))
}

fn scratch(name: &str) -> PathBuf {
    PathBuf::from(env!("CARGO_TARGET_TMPDIR")).join(name)
}

fn lock_step(listen: &Address, log: &Path) -> Program {
    let config = log.with_extension("toml");
    std::fs::write(&config, format!("[telemetry]\nlisten = \"{listen}\"\n")).unwrap();
    let mut command = Command::new(env!("CARGO_BIN_EXE_mocad-under-test"));
    command.args(["--as-fast-as-possible", "--duration", "30", "--config", config.to_str().unwrap()]);
    command.args(["--command-log", log.to_str().unwrap()]);
    command.stdout(Stdio::piped()).start().unwrap()
}

fn end(program: Program) -> String {
    let output = program.output().unwrap();
    assert!(output.status.success());
    String::from_utf8(output.stdout).unwrap()
}

fn connected(address: &Address) -> UnixStream {
    let Address::Unix(path) = address else { unreachable!("a socket file") };
    let until = Instant::now() + Duration::from_secs(20);
    loop {
        match UnixStream::connect(path) {
            Ok(stream) => return stream,
            Err(error) => assert!(Instant::now() < until, "{error}"),
        }
        std::thread::sleep(Duration::from_millis(2));
    }
}

#[test]
fn the_command_log_is_the_same_with_no_client_and_with_three() {
    let alone = scratch("alone.csv");
    end(lock_step(&socket("alone"), &alone));

    let watched = scratch("watched.csv");
    let address = socket("watched");
    let child = lock_step(&address, &watched);
    let stopped = connected(&address); // connects and never reads a byte
    let killed = Connection::spawn(&address, || {}).unwrap();
    let healthy = Connection::spawn(&address, || {}).unwrap();
    let mut seen = 0;
    let until = Instant::now() + Duration::from_secs(60);
    while seen < 200 {
        seen += healthy.poll().samples.len();
        assert!(Instant::now() < until, "the healthy client saw {seen} samples");
        std::thread::sleep(Duration::from_millis(1));
    }
    drop(killed);
    let said = end(child);
    drop((stopped, healthy));

    assert!(said.contains("samples dropped"), "{said}");
    let logs = [std::fs::read(alone).unwrap(), std::fs::read(watched).unwrap()];
    assert_eq!(logs[0].iter().filter(|&&byte| byte == b'\n').count(), 30_001);
    assert!(logs[0] == logs[1], "a client changed a command");
}
