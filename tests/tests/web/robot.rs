//! The daemon's program and a gateway for it.

use super::browser::Browser;
use moca_telemetry::audit::Asked;
use moca_telemetry::log::{LogReader, Record};
use moca_telemetry::net::Address;
use moca_tests::{Limited, Program};
use moca_web::{Options, SiteCertificate, access::Role, serve};
use nix::sys::signal::Signal;
use std::{
    net::SocketAddr,
    path::{Path, PathBuf},
    process::{Command, Stdio},
    sync::mpsc,
    time::Duration,
};

/// A daemon that is ready to be armed, and a gateway that ends with the test's process.
pub(crate) struct Robot {
    daemon: Program,
    folder: PathBuf,
    pub(crate) gateway: SocketAddr,
}

impl Robot {
    pub(crate) fn start(name: &str) -> Self {
        Self::start_with(name, None, false, "")
    }

    /// One that records its log.
    pub(crate) fn start_recorded(name: &str) -> Self {
        Self::start_with(name, None, true, "")
    }

    /// One with a gripper, and a cube of 50 mm and 0.5 kg between its fingers.
    pub(crate) fn start_with_gripper(name: &str) -> Self {
        let more = "[plant]\ngripper = \"simulated\"\n[simulation.true.object]\nmass_kg = 0.5\n";
        Self::start_with(name, None, false, more)
    }

    /// A gateway with a certificate of the site's own, or one by the robot's authority; the robot's configuration ends with
    /// `more`.
    pub(crate) fn start_with(name: &str, site: Option<SiteCertificate>, recorded: bool, more: &str) -> Self {
        let folder = PathBuf::from(env!("CARGO_TARGET_TMPDIR")).join(format!("web-{name}"));
        let _ = std::fs::remove_dir_all(&folder);
        std::fs::create_dir_all(folder.join("logs")).unwrap();
        let socket = std::env::temp_dir().join(format!("moca-web-{}-{name}.sock", std::process::id()));
        let config = folder.join("mocad.toml");
        let text = format!(
            "[telemetry]\nlisten = \"unix:{}\"\n[startup]\narm = false\n[simulation.hand]\ntaxels = []\n{more}",
            socket.display()
        );
        std::fs::write(&config, text).unwrap();
        let daemon = spawn(&folder, recorded);
        let options = Options {
            daemon: Address::Unix(socket),
            listen: ([127, 0, 0, 1], 0).into(),
            names: vec!["localhost".into(), "127.0.0.1".into()],
            state: folder.join("state"),
            logs: folder.join("logs"),
            robots: Vec::new(),
            site,
            // A busy machine is no lost link.
            lease: Duration::from_millis(1000),
        };
        let (told, listening) = mpsc::channel();
        std::thread::spawn(move || {
            let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().unwrap();
            runtime.block_on(serve(options, |listening| told.send(listening.address).unwrap())).unwrap();
        });
        let gateway = listening.recv_timeout(Duration::from_secs(60)).unwrap();
        Self { daemon, folder, gateway }
    }

    /// Ends the daemon and starts it again.
    pub(crate) fn restart(&mut self) {
        let _ = self.daemon.kill();
        let _ = self.daemon.wait();
        self.daemon = spawn(&self.folder, false);
    }

    /// Ends a daemon that records, and returns what its log has of requests.
    pub(crate) fn asked(self) -> Vec<Asked> {
        let Self { daemon, folder, .. } = self;
        daemon.signal(Signal::SIGINT).unwrap();
        daemon.end().unwrap();
        let records = LogReader::open(&folder.join("run.mcap")).unwrap();
        let asked = |record| if let Record::Asked(_, asked) = record { Some(*asked) } else { None };
        records.filter_map(asked).collect()
    }

    pub(crate) fn state(&self) -> PathBuf {
        self.folder.join("state")
    }

    pub(crate) fn logs(&self) -> PathBuf {
        self.folder.join("logs")
    }

    pub(crate) fn browser(&self) -> Browser {
        Browser::new(self.gateway, &self.state())
    }

    pub(crate) async fn paired(&self, role: Role, name: &str) -> Browser {
        Browser::paired(self.gateway, &self.state(), role, name).await
    }

    /// Lines of the audit that contain both texts.
    pub(crate) fn audited(&self, who: &str, what: &str) -> usize {
        audit(&self.state()).lines().filter(|line| line.contains(who) && line.contains(what)).count()
    }
}

fn audit(state: &Path) -> String {
    std::fs::read_to_string(state.join("audit.jsonl")).unwrap_or_default()
}

fn spawn(folder: &Path, recorded: bool) -> Program {
    let mut command = Command::new(env!("CARGO_BIN_EXE_mocad-under-test"));
    command.arg("--config").arg(folder.join("mocad.toml"));
    if recorded {
        command.arg("--record").arg(folder.join("run.mcap"));
    }
    command.stdout(Stdio::null()).stderr(Stdio::null()).start().unwrap()
}
