//! Programs of other machines: `mocad access`, and a daemon that they reach with what it has made.
#![allow(
    clippy::unwrap_used,
    clippy::panic,
    clippy::print_stdout,
    reason = "a test that cannot go on has to stop, and says what it measured"
)]

use moca_telemetry::audit::Asked;
use moca_telemetry::log::{LogReader, Record};
use moca_tests::{Limited, Program};
use nix::sys::signal::Signal;
use serde_json::Value;
use std::io::{BufRead, BufReader};
use std::os::unix::fs::{MetadataExt, PermissionsExt};
use std::path::{Path, PathBuf};
use std::process::{Command, Output, Stdio};
use std::time::{Duration, Instant};

/// Ends a test that would hang; no test passes or fails by how long something took before this.
const HANGS_AFTER: Duration = Duration::from_secs(60);

fn folder(name: &str) -> PathBuf {
    let folder = PathBuf::from(env!("CARGO_TARGET_TMPDIR")).join(format!("access-{name}"));
    let _ = std::fs::remove_dir_all(&folder);
    std::fs::create_dir_all(&folder).unwrap();
    folder
}

fn mocad(within: &Path, arguments: &[&str]) -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_mocad-under-test"));
    command.args(arguments).current_dir(within).env("XDG_STATE_HOME", within.join("state"));
    command
}

/// Exit code and both outputs.
fn said(output: &Output) -> (Option<i32>, String) {
    let text = [&output.stdout, &output.stderr].map(|bytes| String::from_utf8_lossy(bytes).into_owned());
    (output.status.code(), text.concat())
}

fn done(within: &Path, arguments: &[&str]) -> String {
    let (code, text) = said(&mocad(within, arguments).run().unwrap());
    assert_eq!(code, Some(0), "{arguments:?}: {text}");
    text
}

fn refused(within: &Path, arguments: &[&str], reason: &str) {
    let (code, text) = said(&mocad(within, arguments).run().unwrap());
    assert!(code != Some(0) && text.contains(reason), "{arguments:?}: {code:?}: {text}");
}

#[test]
fn certificates_are_made_listed_and_taken_back() {
    let within = folder("list");
    for (name, role) in [("screen", "viewer"), ("lab-pc", "operator"), ("workshop.1", "maintainer")] {
        let text = done(&within, &["access", "new", name, "--role", role]);
        assert!(text.contains(&format!("{name}.pem: role {role}; copy it")), "{text}");
        let file = within.join(format!("{name}.pem"));
        assert_eq!(std::fs::metadata(&file).unwrap().permissions().mode() & 0o777, 0o600);
        let pem = std::fs::read_to_string(file).unwrap();
        assert_eq!(pem.matches("BEGIN CERTIFICATE").count(), 2, "its own and the authority's");
        assert_eq!(pem.matches("BEGIN PRIVATE KEY").count(), 1);
    }
    let listed = done(&within, &["access", "list"]);
    let line = |name: &str| listed.lines().find(|line| line.split_whitespace().nth(1) == Some(name)).unwrap();
    for (name, role) in [("screen", "viewer"), ("lab-pc", "operator"), ("workshop.1", "maintainer")] {
        assert!(line(name).starts_with(role) && line(name).contains("until 20"), "{listed}");
    }
    assert!(done(&within, &["access", "revoke", "lab-pc"]).contains("lab-pc is no longer let in"));
    assert!(!done(&within, &["access", "list"]).contains("lab-pc"));
    // A name that was taken back may be given again.
    std::fs::remove_file(within.join("lab-pc.pem")).unwrap();
    done(&within, &["access", "new", "lab-pc", "--role", "viewer"]);
}

#[test]
fn mistakes_are_refused_with_a_remedy_and_change_nothing() {
    let within = folder("mistakes");
    done(&within, &["access", "new", "lab-pc", "--role", "operator"]);
    let before = done(&within, &["access", "list"]);
    let new = |name, role, reason: &str| refused(&within, &["access", "new", name, "--role", role], reason);
    new("lab-pc", "viewer", "\"lab-pc\" has a certificate: revoke that first");
    new("lab pc", "viewer", "allowed: 1 to 40 letters, digits and any of - _ .");
    let long = "x".repeat(41);
    new(&long, "viewer", "allowed: 1 to 40 letters");
    new("other", "root", "allowed: viewer, operator, maintainer");
    refused(&within, &["access", "new", "other"], "--role");
    // A file that is there is not overwritten, and its name stays free.
    std::fs::write(within.join("there.pem"), "mine").unwrap();
    new("there", "viewer", "there.pem");
    assert_eq!(std::fs::read_to_string(within.join("there.pem")).unwrap(), "mine");
    refused(&within, &["access", "revoke", "nobody"], "nobody is called \"nobody\": see mocad access list");
    assert_eq!(done(&within, &["access", "list"]), before);
    // A list that cannot be read is said with its file.
    let list = within.join("state/mocad/access/access.json");
    std::fs::write(&list, "{").unwrap();
    for arguments in [&["access", "list"][..], &["access", "revoke", "lab-pc"]] {
        refused(&within, arguments, "access.json");
    }
    assert_eq!(std::fs::read_to_string(list).unwrap(), "{", "it is left for a person to mend");
}

/// A daemon without a cover, which no busy machine can stop, and its port for other machines.
struct Robot {
    process: Program,
    within: PathBuf,
    tls: String,
    own: String,
}

impl Robot {
    fn start(name: &str) -> Self {
        Self::start_with(name, &[])
    }

    fn start_with(name: &str, more: &[&str]) -> Self {
        let within = folder(name);
        let socket = std::env::temp_dir().join(format!("moca-access-{}-{name}.sock", std::process::id()));
        let own = format!("unix:{}", socket.display());
        let text = format!(
            "[telemetry]\nlisten = \"{own}\"\ntls = \"127.0.0.1:0\"\n[startup]\narm = false\n\
             [simulation.hand]\ntaxels = []\n[plant]\nparts = \"arm\"\n"
        );
        std::fs::write(within.join("mocad.toml"), text).unwrap();
        let mut process =
            mocad(&within, &["--config", "mocad.toml"]).args(more).stdout(Stdio::piped()).start().unwrap();
        let mut lines = BufReader::new(process.stdout.take().unwrap()).lines().map(Result::unwrap);
        let port = |line: &String| line.contains("tls://");
        let line = lines.find(port).unwrap();
        let tls = line.split_whitespace().find(|word| word.starts_with("tls://")).unwrap().to_owned();
        // A pipe that nobody reads would end the daemon.
        std::thread::spawn(move || lines.for_each(drop));
        Self { process, within, tls, own }
    }

    /// `mocad` of another machine with this certificate.
    fn remote(&self, certificate: &Path, arguments: &[&str]) -> Command {
        let mut command = mocad(&self.within, arguments);
        command.args(["--address", &self.tls]).env("MOCA_ACCESS_FILE", certificate);
        command
    }

    fn certificate(&self, name: &str, role: &str) -> PathBuf {
        done(&self.within, &["access", "new", name, "--role", role]);
        self.within.join(format!("{name}.pem"))
    }

    fn mode(&self) -> String {
        let text = done(&self.within, &["status", "--json", "--address", &self.own]);
        serde_json::from_str::<Value>(&text).unwrap()["mode"].as_str().unwrap().to_owned()
    }

    fn wait_for(&self, mode: &str) {
        let until = Instant::now() + HANGS_AFTER;
        while self.mode() != mode {
            assert!(Instant::now() < until, "never {mode}: {}", self.mode());
        }
    }
}

#[test]
fn certificate_file_is_a_programs_identity() {
    let robot = Robot::start("identity");
    robot.wait_for("ready");
    let (viewer, operator) = (robot.certificate("screen", "viewer"), robot.certificate("lab-pc", "operator"));
    let run =
        |certificate: &Path, arguments: &[&str]| said(&robot.remote(certificate, arguments).run().unwrap());
    for certificate in [&viewer, &operator] {
        assert_eq!(run(certificate, &["status"]).0, Some(0));
    }
    let (code, text) = run(&viewer, &["law", "follow-me"]);
    assert!(code == Some(4) && text.contains("a certificate of a higher role"), "{code:?}: {text}");
    assert_eq!(run(&operator, &["law", "follow-me"]).0, Some(0));
    // Files that are no identity: none, one that others read, one of another robot.
    let (code, text) = run(&robot.within.join("none.pem"), &["status"]);
    assert!(code != Some(0) && text.contains("none.pem: No such file"), "{text}");
    std::fs::set_permissions(&viewer, std::fs::Permissions::from_mode(0o640)).unwrap();
    let (code, text) = run(&viewer, &["status"]);
    assert!(code != Some(0) && text.contains("0640") && text.contains("chmod 600"), "{text}");
    let elsewhere = folder("elsewhere");
    done(&elsewhere, &["access", "new", "lab-pc", "--role", "operator"]);
    let (code, text) = run(&elsewhere.join("lab-pc.pem"), &["status"]);
    assert!(code != Some(0) && text.contains("certificate"), "{text}");
    // Everybody with a certificate stops the robot.
    std::fs::set_permissions(&viewer, std::fs::Permissions::from_mode(0o600)).unwrap();
    assert_eq!(run(&viewer, &["stop"]).0, Some(0));
    robot.wait_for("protective stop");
}

#[test]
fn name_revoked_while_it_commands_stops_the_robot() {
    let robot = Robot::start("revoked");
    robot.wait_for("ready");
    let operator = robot.certificate("lab-pc", "operator");
    let held =
        robot.remote(&operator, &["arm"]).stdout(Stdio::piped()).stderr(Stdio::piped()).start().unwrap();
    robot.wait_for("impedance");
    let revoked = Instant::now();
    done(&robot.within, &["access", "revoke", "lab-pc"]);
    robot.wait_for("protective stop");
    println!(
        "revoked while it commands: stopped {} ms after the command began",
        revoked.elapsed().as_millis()
    );
    let (code, text) = said(&held.output().unwrap());
    assert_ne!(code, Some(0), "{text}");
    let (code, text) = said(&robot.remote(&operator, &["status"]).run().unwrap());
    assert!(code != Some(0) && text.contains("not on the robot's list"), "{text}");
}

/// The audit of a log.
fn audit(log: &Path) -> Vec<Asked> {
    let records = LogReader::open(log).unwrap();
    records
        .filter_map(|record| if let Record::Asked(_, asked) = record { Some(*asked) } else { None })
        .collect()
}

/// Number of requests that were answered so.
fn times(audit: &[Asked], who: &str, what: &str, accepted: bool) -> u64 {
    let same = |line: &&Asked| line.who == who && line.what == what && line.accepted == accepted;
    audit.iter().filter(same).map(|line| line.times).sum()
}

#[test]
fn requests_and_answers_are_in_the_robots_log() {
    let robot = Robot::start_with("audit", &["--record", "run.mcap"]);
    robot.wait_for("ready");
    let (viewer, operator) = (robot.certificate("screen", "viewer"), robot.certificate("lab-pc", "operator"));
    let run = |certificate: &Path, arguments: &[&str]| robot.remote(certificate, arguments).run().unwrap();
    run(&viewer, &["tare"]);
    for law in ["follow-me", "impedance", "follow-me"] {
        run(&operator, &["law", law]);
    }
    run(&operator, &["resume"]);
    run(&operator, &["stop"]);
    done(&robot.within, &["resume", "--address", &robot.own]);
    // Of no robot's list.
    done(&robot.within, &["access", "revoke", "lab-pc"]);
    run(&operator, &["status"]);
    robot.process.signal(Signal::SIGINT).unwrap();
    let Robot { process, within, .. } = robot;
    assert!(process.end().unwrap().success());
    let log = within.join("run.mcap");
    let audit = audit(&log);
    let (screen, lab_pc) = ("certificate screen", "certificate lab-pc");
    let user = format!("user {}", std::fs::metadata("/proc/self").unwrap().uid());
    for (who, what, accepted, expected) in [
        (screen, "tare", false, 1),
        (lab_pc, "law follow-me", true, 2),
        (lab_pc, "law impedance", true, 1),
        (lab_pc, "resume", false, 1),
        (lab_pc, "stop", true, 1),
        (&user, "resume", true, 1),
    ] {
        assert_eq!(times(&audit, who, what, accepted), expected, "{who}: {what}: {audit:#?}");
    }
    let line = |what: &str| audit.iter().find(|line| line.what == what && !line.accepted).unwrap();
    assert!(line("tare").answer.contains("a certificate of a higher role"), "{:?}", line("tare"));
    assert!(line("connect").answer.contains("not on the robot's list"), "{:?}", line("connect"));
    assert!(line("connect").who.starts_with("machine 127.0.0.1"), "{:?}", line("connect"));
    let mut connected = audit.iter().filter(|line| line.who == lab_pc && line.what == "connect");
    assert!(connected.any(|line| line.answer == "operator"));
    let text = done(&within, &["log", log.to_str().unwrap()]);
    assert!(text.contains("certificate screen: ") && text.contains(", 1 refused"), "{text}");
}
