//! The board on a pseudo-terminal, in real time: a program opens it like a real one.

use crate::Board;
use crate::mpr121::ELECTRODES;
use anyhow::{Context, Result};
use nix::fcntl::{FcntlArg, OFlag, fcntl, open};
use nix::poll::{PollFd, PollFlags, PollTimeout, poll};
use nix::pty::{PtyMaster, grantpt, posix_openpt, ptsname_r, unlockpt};
use nix::sys::stat::Mode;
use nix::sys::termios::{SetArg, cfmakeraw, tcgetattr, tcsetattr};
use std::io::Read;
use std::os::fd::AsFd;
use std::path::Path;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};

/// Length of a run.
#[derive(Clone, Copy, Debug)]
pub enum Until {
    /// A number of seconds.
    Seconds(f64),
    /// As long as somebody writes what the electrodes see to stdin: twelve little-endian `f32` of the board's own chip,
    /// pF, each time they change.
    StdinEnds,
}

/// Capacitances read from stdin.
#[derive(Default)]
struct Capacitances {
    changed: Mutex<Option<[f32; ELECTRODES]>>,
    ended: AtomicBool,
}

/// Runs the board behind a link at `path`; how far it fell behind real time at worst.
pub fn run(board: &mut Board, path: &Path, until: Until) -> Result<Duration> {
    let master = plug(path)?;
    let behind = serve(board, &master, until);
    std::fs::remove_file(path).with_context(|| format!("remove {}", path.display()))?;
    behind
}

fn serve(board: &mut Board, master: &PtyMaster, until: Until) -> Result<Duration> {
    let capacitances = Arc::new(Capacitances::default());
    if let Until::StdinEnds = until {
        let shared = Arc::clone(&capacitances);
        std::thread::spawn(move || read_stdin(&shared));
    }
    board.plug_in()?;
    board.set_open(false)?;
    let (start, start_us) = (Instant::now(), board.now_us());
    let (mut is_open, mut behind) = (false, Duration::ZERO);
    let over = |elapsed: Duration| match until {
        Until::Seconds(seconds) => elapsed.as_secs_f64() >= seconds,
        Until::StdinEnds => capacitances.ended.load(Ordering::Acquire),
    };
    while !over(start.elapsed()) {
        let simulated = Duration::from_micros(board.now_us() - start_us);
        match simulated.checked_sub(start.elapsed()) {
            Some(ahead) => std::thread::sleep(ahead),
            None => behind = behind.max(start.elapsed() - simulated),
        }
        let mut watched = [PollFd::new(master.as_fd(), PollFlags::POLLIN)];
        poll(&mut watched, PollTimeout::ZERO).context("poll the pseudo-terminal")?;
        let events = watched[0].revents().unwrap_or(PollFlags::empty());
        let now_open = !events.contains(PollFlags::POLLHUP);
        if now_open != is_open {
            is_open = now_open;
            board.set_open(is_open)?;
        }
        let mut text = [0; 64];
        if events.contains(PollFlags::POLLIN)
            && let Ok(count) = nix::unistd::read(master, &mut text)
        {
            board.send(&text[..count]);
        }
        let changed = capacitances.changed.lock().ok().and_then(|mut changed| changed.take());
        for (electrode, picofarad) in changed.into_iter().flatten().enumerate() {
            if picofarad.is_finite() && picofarad > 0.0 {
                board.set_capacitance_pf(0x5C, electrode, f64::from(picofarad));
            }
        }
        let until_us = board.now_us() + 1000;
        board.step_until(until_us, &mut |_, bytes| {
            if is_open {
                // a host that does not read loses bytes, as with a cable
                let _ = nix::unistd::write(master, bytes);
            }
        })?;
    }
    Ok(behind)
}

fn read_stdin(capacitances: &Capacitances) {
    let mut input = std::io::stdin().lock();
    let mut record = [0; 4 * ELECTRODES];
    while input.read_exact(&mut record).is_ok() {
        let mut values = [0.0; ELECTRODES];
        for (value, bytes) in values.iter_mut().zip(record.as_chunks::<4>().0) {
            *value = f32::from_le_bytes(*bytes);
        }
        if let Ok(mut changed) = capacitances.changed.lock() {
            *changed = Some(values);
        }
    }
    capacitances.ended.store(true, Ordering::Release);
}

fn plug(path: &Path) -> Result<PtyMaster> {
    let flags = OFlag::O_RDWR | OFlag::O_NOCTTY | OFlag::O_CLOEXEC;
    let master = posix_openpt(flags).context("open a pseudo-terminal")?;
    grantpt(&master)?;
    unlockpt(&master)?;
    let name = ptsname_r(&master)?;
    // Opened once and closed: raw bytes for whoever opens it next, and the master knows whether anybody has.
    let slave = open(name.as_str(), flags, Mode::empty())?;
    let mut attributes = tcgetattr(&slave)?;
    cfmakeraw(&mut attributes);
    tcsetattr(&slave, SetArg::TCSANOW, &attributes)?;
    drop(slave);
    fcntl(&master, FcntlArg::F_SETFL(OFlag::O_NONBLOCK))?;
    if path.is_symlink() {
        std::fs::remove_file(path)?;
    }
    std::os::unix::fs::symlink(&name, path).with_context(|| format!("link {}", path.display()))?;
    Ok(master)
}
