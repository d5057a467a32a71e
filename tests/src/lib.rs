//! Programs under test, none of which outlives its test or hangs it: each is ended after [`LIMIT`], with its owner at the
//! latest. That no test depends on how long something takes is its own business; this only ends what would never end.

use nix::sys::signal::{Signal, kill};
use nix::unistd::Pid;
use std::io;
use std::ops::{Deref, DerefMut};
use std::process::{Child, Command, ExitStatus, Output, Stdio};
use std::sync::mpsc::{self, RecvTimeoutError, Sender};
use std::thread::{self, JoinHandle};
use std::time::Duration;

/// Time limit of a program: far longer than any test needs, on a busy machine too.
pub const LIMIT: Duration = Duration::from_secs(240);

/// Codes of the faults of a machine that is too busy for a live board; a test then tries another robot.
pub const STARVED: [&str; 3] = ["board-silent", "board-slow", "host-starved"];

/// A command that runs for [`LIMIT`] at most.
pub trait Limited {
    /// Starts it.
    ///
    /// # Errors
    /// The program cannot be started.
    fn start(&mut self) -> io::Result<Program>;

    /// Runs it to its end, which is what it wrote and its exit code.
    ///
    /// # Errors
    /// The program cannot be started, or had to be killed.
    fn run(&mut self) -> io::Result<Output>;
}

impl Limited for Command {
    fn start(&mut self) -> io::Result<Program> {
        Program::start(self, LIMIT)
    }

    fn run(&mut self) -> io::Result<Output> {
        self.stdin(Stdio::null()).stdout(Stdio::piped()).stderr(Stdio::piped()).start()?.output()
    }
}

/// A running program.
pub struct Program {
    child: Option<Child>,
    /// A thread that keeps the time: one that waits for the program reads its pipes until they close.
    watch: Watch,
}

struct Watch {
    ended: Option<Sender<()>>,
    thread: Option<JoinHandle<bool>>,
}

impl Watch {
    fn start(pid: Pid, limit: Duration) -> Self {
        let (ended, told) = mpsc::channel();
        let thread = thread::spawn(move || {
            let hangs = told.recv_timeout(limit) == Err(RecvTimeoutError::Timeout);
            hangs && kill(pid, Signal::SIGKILL).is_ok()
        });
        Self { ended: Some(ended), thread: Some(thread) }
    }

    /// Stops the clock; true if the program had to be killed.
    fn stop(&mut self) -> bool {
        drop(self.ended.take());
        self.thread.take().is_some_and(|thread| thread.join().unwrap_or(false))
    }
}

impl Program {
    fn start(command: &mut Command, limit: Duration) -> io::Result<Self> {
        let child = command.spawn()?;
        let pid = Pid::from_raw(i32::try_from(child.id()).map_err(io::Error::other)?);
        Ok(Self { child: Some(child), watch: Watch::start(pid, limit) })
    }

    /// Sends a signal.
    ///
    /// # Errors
    /// The program has ended.
    pub fn signal(&self, signal: Signal) -> io::Result<()> {
        let pid = i32::try_from(self.id()).map_err(io::Error::other)?;
        Ok(kill(Pid::from_raw(pid), signal)?)
    }

    /// Waits for its end.
    ///
    /// # Errors
    /// It had to be killed.
    pub fn end(mut self) -> io::Result<ExitStatus> {
        let status = self.wait()?;
        self.judged(status)
    }

    /// Waits for its end, reading what it still writes.
    ///
    /// # Errors
    /// It had to be killed.
    pub fn output(mut self) -> io::Result<Output> {
        let child = self.child.take().ok_or(io::ErrorKind::NotFound)?;
        let output = child.wait_with_output()?;
        self.judged(output)
    }

    fn judged<T>(&mut self, ended: T) -> io::Result<T> {
        if self.watch.stop() {
            Err(io::Error::other(format!("killed after {LIMIT:?}: it hangs")))
        } else {
            Ok(ended)
        }
    }
}

impl Deref for Program {
    type Target = Child;

    #[expect(clippy::expect_used, reason = "a child is taken by what consumes the program")]
    fn deref(&self) -> &Child {
        self.child.as_ref().expect("running")
    }
}

impl DerefMut for Program {
    #[expect(clippy::expect_used, reason = "a child is taken by what consumes the program")]
    fn deref_mut(&mut self) -> &mut Child {
        self.child.as_mut().expect("running")
    }
}

impl Drop for Program {
    fn drop(&mut self) {
        // The watch first: a process that has been waited for may have given its number to another.
        let _ = self.watch.stop();
        if let Some(child) = &mut self.child {
            let _ = child.kill();
            let _ = child.wait();
        }
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, reason = "a test that cannot go on has to stop")]

    use super::*;

    #[test]
    fn hanging_program_is_killed_and_reported() {
        let mut command = Command::new("sleep");
        let program = Program::start(command.arg("1000").stdout(Stdio::piped()), Duration::from_millis(50));
        assert!(program.unwrap().output().unwrap_err().to_string().contains("hangs"));
        let program = Program::start(&mut command, Duration::from_millis(50)).unwrap();
        assert!(program.end().unwrap_err().to_string().contains("hangs"));
    }

    #[test]
    fn forgotten_program_ends_with_its_owner() {
        let program = Command::new("sleep").arg("1000").start().unwrap();
        let folder = format!("/proc/{}", program.id());
        drop(program);
        assert!(!std::path::Path::new(&folder).exists());
    }

    #[test]
    fn output_and_code_of_ended_program_are_returned() {
        let output = Command::new("sh").args(["-c", "echo out; echo err >&2; exit 3"]).run().unwrap();
        assert_eq!((output.stdout.as_slice(), output.stderr.as_slice()), (&b"out\n"[..], &b"err\n"[..]));
        assert_eq!(output.status.code(), Some(3));
    }
}
