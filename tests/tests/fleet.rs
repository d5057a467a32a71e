//! Several daemons at a glance.
#![allow(
    clippy::unwrap_used,
    clippy::expect_used,
    clippy::panic,
    reason = "a test that cannot go on has to stop"
)]

use moca_msgs::{Fault, Mode, Request};
use moca_telemetry::net::{
    Connection,
    fleet::{Fleet, Watched, parse},
};
use std::{
    path::PathBuf,
    process::{Child, Command, Stdio},
    time::{Duration, Instant},
};

/// Ends a test that would hang; no test passes or fails by how long something took before this.
const HANGS_AFTER: Duration = Duration::from_secs(60);

struct Robot {
    daemon: Child,
    config: PathBuf,
    address: String,
}

impl Robot {
    fn start(name: &str) -> Self {
        let socket = std::env::temp_dir().join(format!("moca-fleet-{}-{name}.sock", std::process::id()));
        let address = format!("unix:{}", socket.display());
        let config = PathBuf::from(env!("CARGO_TARGET_TMPDIR")).join(format!("fleet-{name}.toml"));
        let text = format!(
            "[robot]\nname = \"{name}\"\n[telemetry]\nlisten = \"{address}\"\n[startup]\narm = false\n\
             [simulation.hand]\ntaxels = []\n"
        );
        std::fs::write(&config, text).unwrap();
        Self { daemon: spawn(&config), config, address }
    }

    fn restart(&mut self) {
        self.daemon = spawn(&self.config);
    }

    fn kill(&mut self) {
        let _ = self.daemon.kill();
        let _ = self.daemon.wait();
    }
}

impl Drop for Robot {
    fn drop(&mut self) {
        self.kill();
    }
}

fn spawn(config: &PathBuf) -> Child {
    let mut command = Command::new(env!("CARGO_BIN_EXE_mocad-under-test"));
    command.arg("--config").arg(config).stdout(Stdio::null()).stderr(Stdio::null()).spawn().unwrap()
}

fn wait_for(fleet: &mut Fleet, what: &str, wanted: impl Fn(&[Watched]) -> bool) {
    let until = Instant::now() + HANGS_AFTER;
    while !wanted(fleet.poll()) {
        assert!(Instant::now() < until, "never saw: {what}");
        std::thread::sleep(Duration::from_millis(20));
    }
}

#[test]
fn killed_robot_is_seen_to_go_and_return_and_the_other_stays() {
    let (mut one, two) = (Robot::start("one"), Robot::start("two"));
    let entry =
        |name: &str, address: &str| format!("[[robot]]\nname = \"{name}\"\naddress = \"{address}\"\n");
    let list = entry("one", &one.address) + &entry("two", &two.address);
    let mut fleet = Fleet::watch(parse(&list).unwrap()).unwrap();
    let mode = |robot: &Watched| robot.glance.map(|glance| glance.mode);
    wait_for(&mut fleet, "both ready", |robots| robots.iter().all(|robot| mode(robot) == Some(Mode::Ready)));
    one.kill();
    wait_for(&mut fleet, "one is away", |robots| {
        robots[0].glance.is_none() && mode(&robots[1]) == Some(Mode::Ready)
    });
    assert!(!fleet.poll()[0].why.is_empty(), "the reason is said");
    one.restart();
    wait_for(&mut fleet, "one is back", |robots| mode(&robots[0]) == Some(Mode::Ready));
    // A stop of one robot never touches another.
    let commander =
        Connection::spawn(one.address.parse::<moca_telemetry::net::Address>().unwrap(), || {}).unwrap();
    let until = Instant::now() + HANGS_AFTER;
    while !matches!(commander.poll().link, moca_telemetry::net::Link::Up { .. }) {
        assert!(Instant::now() < until, "never connected");
        std::thread::sleep(Duration::from_millis(5));
    }
    commander.request(Request::Stop);
    wait_for(&mut fleet, "one has stopped", |robots| mode(&robots[0]) == Some(Mode::ProtectiveStop));
    let robots = fleet.poll();
    assert_eq!(robots[0].glance.and_then(|glance| glance.fault), Some(Fault::OperatorStop));
    assert_eq!(mode(&robots[1]), Some(Mode::Ready));
}
