//! What the operating system can do for a loop that must not be late: each step is tried and its result reported.

use crate::config::RealtimeConfig;
use nix::sched::{CpuSet, sched_setaffinity};
use nix::sys::mman::{MlockAllFlags, mlockall};
use nix::unistd::Pid;
use std::fs::{File, OpenOptions};
use std::io::{self, Write};

/// One step and how it went.
#[derive(Debug)]
pub struct Step {
    /// What was tried.
    pub what: String,
    /// Why it failed, if it did.
    pub result: io::Result<()>,
}

/// What holds only while it is kept: dropping it gives the processors back their sleep states.
#[derive(Debug)]
pub struct Held(#[expect(dead_code, reason = "held open, never read")] Option<File>);

/// Tries every wish for the calling thread (memory: for the process).
pub fn apply(wishes: &RealtimeConfig) -> (Vec<Step>, Held) {
    let mut steps = Vec::new();
    let mut tried = |what: String, result: io::Result<()>| steps.push(Step { what, result });
    if wishes.lock_memory {
        let all = MlockAllFlags::MCL_CURRENT | MlockAllFlags::MCL_FUTURE;
        tried("memory locked".into(), mlockall(all).map_err(io::Error::from));
    }
    if let Ok(cpu) = usize::try_from(wishes.cpu) {
        tried(format!("pinned to core {cpu}"), pin(cpu));
    }
    if wishes.priority > 0 {
        tried(format!("SCHED_FIFO {}", wishes.priority), set_fifo(wishes.priority));
    }
    let mut latency = None;
    if wishes.dma_latency {
        let result = hold_dma_latency().map(|file| latency = Some(file));
        tried("processors kept awake (/dev/cpu_dma_latency)".into(), result);
    }
    (steps, Held(latency))
}

fn pin(cpu: usize) -> io::Result<()> {
    let mut set = CpuSet::new();
    set.set(cpu)?;
    Ok(sched_setaffinity(Pid::from_raw(0), &set)?)
}

#[expect(unsafe_code, reason = "no safe wrapper for sched_setscheduler in nix")]
fn set_fifo(priority: u8) -> io::Result<()> {
    let parameters = nix::libc::sched_param { sched_priority: i32::from(priority) };
    // SAFETY: 0 is the calling thread, and the pointer is to a live value that the call only reads.
    let result = unsafe { nix::libc::sched_setscheduler(0, nix::libc::SCHED_FIFO, &raw const parameters) };
    if result == 0 { Ok(()) } else { Err(io::Error::last_os_error()) }
}

fn hold_dma_latency() -> io::Result<File> {
    let mut file = OpenOptions::new().write(true).open("/dev/cpu_dma_latency")?;
    file.write_all(&0_i32.to_ne_bytes())?;
    Ok(file)
}
