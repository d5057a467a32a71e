//! The board's firmware on a pseudo-terminal, in real time as far as this PC can: it needs most of a core.

use anyhow::Result;
use moca_lockstep::firmware_board::{Plates, Program, STEP_NS};
use moca_sim::SharedForces;
use moca_sim::foam::Foam;
use std::io::Write;
use std::path::{Path, PathBuf};
use std::process::Stdio;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

const STEP: Duration = Duration::from_nanos(STEP_NS);

/// The running firmware and the thread that tells it what its electrodes see.
pub struct LiveFirmware {
    path: PathBuf,
    pulse: Arc<AtomicU64>,
    stop: Arc<AtomicBool>,
    thread: Option<JoinHandle<()>>,
}

impl LiveFirmware {
    /// Starts `program terminal PATH`, and a thread that tells it what the electrodes see.
    ///
    /// # Errors
    /// The program or the thread cannot be started.
    pub fn start(program: &Path, foam: Foam, forces: SharedForces, path: &Path) -> Result<Self> {
        let link = path.display().to_string();
        let mut program = Program::start(program, &["terminal", "--stdin", &link], Stdio::null())?;
        let (stop, pulse) = (Arc::new(AtomicBool::new(false)), Arc::new(AtomicU64::new(0)));
        let (stopped, beats) = (Arc::clone(&stop), Arc::clone(&pulse));
        let mut plates = Plates::new(foam);
        let feed = move || {
            let mut due = Instant::now();
            while !stopped.load(Ordering::Relaxed) {
                beats.fetch_add(1, Ordering::Relaxed);
                let force_n = forces.each_ref().map(|cell| f64::from_bits(cell.load(Ordering::Relaxed)));
                if program.input.write_all(&plates.step(&force_n)).is_err() {
                    return; // The program has ended: its port is gone, and the reader says so.
                }
                due += STEP;
                std::thread::sleep(due.saturating_duration_since(Instant::now()));
            }
        };
        let thread = std::thread::Builder::new().name("cover-plates".into()).spawn(feed)?;
        Ok(Self { path: path.to_owned(), pulse, stop, thread: Some(thread) })
    }

    /// A count that the thread raises whenever it runs, every millisecond.
    pub fn pulse(&self) -> Arc<AtomicU64> {
        Arc::clone(&self.pulse)
    }
}

impl Drop for LiveFirmware {
    fn drop(&mut self) {
        self.stop.store(true, Ordering::Relaxed);
        if let Some(thread) = self.thread.take() {
            // The thread does not panic; if it did, there is nobody left to tell.
            let _ = thread.join();
        }
        // The program was ended before it could remove its link.
        let _ = std::fs::remove_file(&self.path);
    }
}
