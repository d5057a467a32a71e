//! The virtual Touch Board on a pseudo-terminal, in real time: a program opens it like a real one.

use crate::board::{BoardFailure, VirtualBoard, VirtualBoardConfig};
use crate::{SimError, error::os};
use moca_tactile::datastream::ELECTRODES;
use nix::fcntl::{FcntlArg, OFlag, fcntl, open};
use nix::poll::{PollFd, PollFlags, PollTimeout, poll};
use nix::pty::{PtyMaster, grantpt, posix_openpt, ptsname_r, unlockpt};
use nix::sys::stat::Mode;
use nix::sys::termios::{SetArg, cfmakeraw, tcgetattr, tcsetattr};
use std::os::fd::AsFd;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::mpsc::{Receiver, Sender, TryRecvError, channel};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};
use std::{env, fs, process};

/// True forces on the electrodes of one board, N, as the bits of an `f64`, T1 first.
pub type SharedForces = Arc<[AtomicU64; ELECTRODES]>;

/// Wake-up period of the board's thread.
const WAKE: Duration = Duration::from_millis(1);

/// Command of a test or demonstration to the board.
enum Command {
    Unplug,
    Replug,
    Fault(Option<BoardFailure>),
    Bytes(Vec<u8>),
}

/// A board that runs in a thread of its own until it is dropped.
#[derive(Debug)]
pub struct PtyBoard {
    path: PathBuf,
    commands: Option<Sender<Command>>,
    pulse: Arc<AtomicU64>,
    thread: Option<JoinHandle<()>>,
}

impl PtyBoard {
    /// A path of this process's own for its board with this number (0 is the first) in `$XDG_RUNTIME_DIR`, or else in
    /// the folder for temporary files.
    pub fn default_path(board: usize) -> PathBuf {
        let folder = env::var_os("XDG_RUNTIME_DIR").map(PathBuf::from).filter(|folder| folder.is_dir());
        folder.unwrap_or_else(env::temp_dir).join(match board {
            0 => format!("moca-touch-board-{}", process::id()),
            more => format!("moca-touch-board-{}-{}", process::id(), more + 1),
        })
    }

    /// Starts the board and makes `path` a symbolic link to its port. The link keeps its name when the board is
    /// unplugged and plugged in again, as `/dev/serial/by-path` does.
    ///
    /// # Errors
    /// A configuration outside its range, no pseudo-terminal, or a path that cannot be linked.
    pub fn spawn(config: VirtualBoardConfig, forces: SharedForces, path: &Path) -> Result<Self, SimError> {
        let board = VirtualBoard::new(config)?;
        let port = Port::open(path)?;
        let (commands, received) = channel();
        let pulse = Arc::new(AtomicU64::new(0));
        let beats = Arc::clone(&pulse);
        let thread = std::thread::Builder::new()
            .name("touch-board".into())
            .spawn(move || run(board, port, &forces, &received, &beats))
            .map_err(|error| os("start the board's thread", &error))?;
        Ok(Self { path: path.to_owned(), commands: Some(commands), pulse, thread: Some(thread) })
    }

    /// A count that the board's thread raises whenever it runs, every millisecond.
    pub fn pulse(&self) -> Arc<AtomicU64> {
        Arc::clone(&self.pulse)
    }

    /// Returns the path of the port.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Pulls the cable: the port hangs up and its link vanishes.
    pub fn unplug(&self) {
        self.send(Command::Unplug);
    }

    /// Plugs it in again: a new port under the same link.
    pub fn replug(&self) {
        self.send(Command::Replug);
    }

    /// Makes the board fail, or heals it.
    pub fn set_fault(&self, fault: Option<BoardFailure>) {
        self.send(Command::Fault(fault));
    }

    /// Puts `bytes` on the line as they are.
    pub fn inject(&self, bytes: &[u8]) {
        self.send(Command::Bytes(bytes.to_vec()));
    }

    fn send(&self, command: Command) {
        if let Some(commands) = &self.commands {
            // Fails only if the thread is gone, which ends every command anyway.
            let _ = commands.send(command);
        }
    }
}

impl Drop for PtyBoard {
    fn drop(&mut self) {
        self.commands = None;
        if let Some(thread) = self.thread.take() {
            // The thread does not panic; if it did, there is nobody left to tell.
            let _ = thread.join();
        }
    }
}

/// The board's end of the cable.
struct Port {
    path: PathBuf,
    master: Option<PtyMaster>,
}

impl Port {
    fn open(path: &Path) -> Result<Self, SimError> {
        let mut port = Self { path: path.to_owned(), master: None };
        port.plug()?;
        Ok(port)
    }

    fn plug(&mut self) -> Result<(), SimError> {
        let failed = |error: nix::Error| os("open a pseudo-terminal", &error.into());
        let master = posix_openpt(OFlag::O_RDWR | OFlag::O_NOCTTY | OFlag::O_CLOEXEC).map_err(failed)?;
        grantpt(&master).map_err(failed)?;
        unlockpt(&master).map_err(failed)?;
        let name = ptsname_r(&master).map_err(failed)?;
        // Opened once and closed: raw bytes for whoever opens it next, and from now on the master knows (POLLHUP)
        // whether anybody has.
        let slave = open(name.as_str(), OFlag::O_RDWR | OFlag::O_NOCTTY | OFlag::O_CLOEXEC, Mode::empty())
            .map_err(failed)?;
        let mut attributes = tcgetattr(&slave).map_err(failed)?;
        cfmakeraw(&mut attributes);
        tcsetattr(&slave, SetArg::TCSANOW, &attributes).map_err(failed)?;
        drop(slave);
        fcntl(&master, FcntlArg::F_SETFL(OFlag::O_NONBLOCK)).map_err(failed)?;
        link(&self.path, Path::new(&name))?;
        self.master = Some(master);
        Ok(())
    }

    fn unplug(&mut self) {
        if self.master.take().is_some() {
            // Somebody else may have removed it: the cable is out either way.
            let _ = fs::remove_file(&self.path);
        }
    }

    /// A board sends nothing while nobody has opened its port, and loses what a stalled host does not take.
    fn write(&self, bytes: &[u8]) {
        let Some(master) = &self.master else { return };
        let mut watched = [PollFd::new(master.as_fd(), PollFlags::POLLOUT)];
        let listening = poll(&mut watched, PollTimeout::ZERO).is_ok()
            && watched[0].revents().is_some_and(|events| {
                events.contains(PollFlags::POLLOUT) && !events.contains(PollFlags::POLLHUP)
            });
        if listening {
            let _ = nix::unistd::write(master, bytes);
        }
    }
}

impl Drop for Port {
    fn drop(&mut self) {
        self.unplug();
    }
}

/// Points the link at the port in one step; refuses to replace anything but a link.
fn link(path: &Path, port: &Path) -> Result<(), SimError> {
    let action = format!("link '{}'", path.display());
    let failed = |error: std::io::Error| os(&action, &error);
    if fs::symlink_metadata(path).is_ok_and(|found| !found.is_symlink()) {
        return Err(failed(std::io::ErrorKind::AlreadyExists.into()));
    }
    let fresh = path.with_extension(format!("{}.new", process::id()));
    std::os::unix::fs::symlink(port, &fresh).map_err(failed)?;
    fs::rename(&fresh, path).map_err(failed)
}

fn run(
    mut board: VirtualBoard,
    mut port: Port,
    forces: &SharedForces,
    commands: &Receiver<Command>,
    pulse: &AtomicU64,
) {
    let start = Instant::now();
    loop {
        pulse.fetch_add(1, Ordering::Relaxed);
        match commands.try_recv() {
            Ok(Command::Unplug) => port.unplug(),
            Ok(Command::Replug) => {
                port.unplug();
                if let Err(error) = port.plug() {
                    eprintln!("virtual Touch Board: {error}");
                }
            }
            Ok(Command::Fault(fault)) => board.set_fault(fault),
            Ok(Command::Bytes(bytes)) => port.write(&bytes),
            Err(TryRecvError::Empty) => {
                let force_n =
                    forces.each_ref().map(|force_n| f64::from_bits(force_n.load(Ordering::Relaxed)));
                let now_ns = u64::try_from(start.elapsed().as_nanos()).unwrap_or(u64::MAX);
                board.advance(now_ns, &force_n, &mut |bytes: &[u8]| port.write(bytes));
                std::thread::sleep(WAKE);
            }
            Err(TryRecvError::Disconnected) => return,
        }
    }
}
