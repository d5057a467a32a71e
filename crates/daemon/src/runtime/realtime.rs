//! Settings of the operating system for a loop that must not be late: each is tried and its result reported.

use crate::config::RealtimeConfig;
use nix::sched::{CpuSet, sched_setaffinity};
use nix::sys::mman::{MlockAllFlags, mlockall};
use nix::unistd::Pid;
use std::fs::{File, OpenOptions};
use std::io::{self, Write};

/// The scheduling of a loop that must not wait.
const FIFO: &str = "SCHED_FIFO";

/// One step and how it went.
#[derive(Debug)]
pub struct Step {
    /// Name of the setting.
    pub what: String,
    /// Why it failed, if it did.
    pub result: io::Result<()>,
    /// It is about the priority of a thread.
    pub is_priority: bool,
}

/// Handle that keeps a setting: dropping it gives the processors back their sleep states.
#[derive(Debug)]
pub struct Held(#[expect(dead_code, reason = "held open, never read")] Option<File>);

/// Tries every setting for the calling thread (memory: for the process).
pub fn apply(wishes: &RealtimeConfig) -> (Vec<Step>, Held) {
    let mut steps = Vec::new();
    let mut tried = |what: String, result: io::Result<()>| {
        let is_priority = what.starts_with(FIFO);
        steps.push(Step { what, result, is_priority });
    };
    if let Some(locked) = lock_memory(wishes) {
        tried(locked.what, locked.result);
    }
    if let Ok(cpu) = usize::try_from(wishes.cpu) {
        tried(format!("pinned to core {cpu}"), pin(cpu));
    }
    if wishes.priority > 0 {
        tried(format!("{FIFO} {}", wishes.priority), set_fifo(wishes.priority));
    }
    let mut latency = None;
    if wishes.dma_latency {
        let result = hold_dma_latency().map(|file| latency = Some(file));
        tried("processors kept awake (/dev/cpu_dma_latency)".into(), result);
    }
    (steps, Held(latency))
}

/// Locks the process's memory, if that is wished for.
pub(crate) fn lock_memory(wishes: &RealtimeConfig) -> Option<Step> {
    let all = MlockAllFlags::MCL_CURRENT | MlockAllFlags::MCL_FUTURE;
    let lock = || Step {
        what: "memory locked".into(),
        result: mlockall(all).map_err(io::Error::from),
        is_priority: false,
    };
    wishes.lock_memory.then(lock)
}

/// While it lives the calling thread, and with it every thread that it starts, has a SCHED_FIFO priority.
#[derive(Debug)]
pub struct Raised(bool);

impl Raised {
    /// Raises the calling thread just below a loop of `loop_priority`; a loop of normal scheduling asks for nothing.
    pub fn below(loop_priority: u8) -> (Self, Option<Step>) {
        let Some(priority) = loop_priority.checked_sub(1).filter(|priority| *priority > 0) else {
            return (Self(false), None);
        };
        let result = set_fifo(priority);
        let raised = Self(result.is_ok());
        let what = format!("the board's bytes at {FIFO} {priority}");
        (raised, Some(Step { what, result, is_priority: true }))
    }
}

impl Drop for Raised {
    fn drop(&mut self) {
        if self.0 {
            // Lowering one's own priority is always allowed.
            let _ = set_policy(nix::libc::SCHED_OTHER, 0);
        }
    }
}

fn pin(cpu: usize) -> io::Result<()> {
    let mut set = CpuSet::new();
    set.set(cpu)?;
    Ok(sched_setaffinity(Pid::from_raw(0), &set)?)
}

fn set_fifo(priority: u8) -> io::Result<()> {
    set_policy(nix::libc::SCHED_FIFO, priority)
}

#[expect(unsafe_code, reason = "no safe wrapper for sched_setscheduler in nix")]
fn set_policy(policy: nix::libc::c_int, priority: u8) -> io::Result<()> {
    let parameters = nix::libc::sched_param { sched_priority: i32::from(priority) };
    // SAFETY: 0 is the calling thread, and the pointer is to a live value that the call only reads.
    let result = unsafe { nix::libc::sched_setscheduler(0, policy, &raw const parameters) };
    if result == 0 { Ok(()) } else { Err(io::Error::last_os_error()) }
}

fn hold_dma_latency() -> io::Result<File> {
    let mut file = OpenOptions::new().write(true).open("/dev/cpu_dma_latency")?;
    file.write_all(&0_i32.to_ne_bytes())?;
    Ok(file)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[expect(unsafe_code, reason = "no safe wrapper for sched_getscheduler in nix")]
    fn policy() -> nix::libc::c_int {
        // SAFETY: 0 is the calling thread; the call takes no pointer.
        unsafe { nix::libc::sched_getscheduler(0) }
    }

    /// A thread inherits the settings of its starter; without the right to FIFO nothing changes and the test says so.
    #[test]
    fn threads_started_while_raised_stay_below_loop() {
        assert!(Raised::below(0).1.is_none() && Raised::below(1).1.is_none());
        let (raised, step) = Raised::below(41);
        let step = step.unwrap();
        assert_eq!(step.what, "the board's bytes at SCHED_FIFO 40");
        let expected = if step.result.is_ok() { nix::libc::SCHED_FIFO } else { nix::libc::SCHED_OTHER };
        assert_eq!(std::thread::spawn(policy).join().unwrap(), expected);
        drop(raised);
        assert_eq!((policy(), std::thread::spawn(policy).join().unwrap()), (nix::libc::SCHED_OTHER, 0));
    }
}
