//! The board on a pseudo-terminal, in real time: a program opens it like a real one.

use crate::Board;
use anyhow::{Context, Result};
use nix::fcntl::{FcntlArg, OFlag, fcntl, open};
use nix::poll::{PollFd, PollFlags, PollTimeout, poll};
use nix::pty::{PtyMaster, grantpt, posix_openpt, ptsname_r, unlockpt};
use nix::sys::stat::Mode;
use nix::sys::termios::{SetArg, cfmakeraw, tcgetattr, tcsetattr};
use std::os::fd::AsFd;
use std::path::Path;
use std::time::{Duration, Instant};

/// Runs the board behind a link at `path` for `seconds`; how far it fell behind real time at worst.
pub fn run(board: &mut Board, path: &Path, seconds: f64) -> Result<Duration> {
    let master = plug(path)?;
    board.plug_in()?;
    board.set_open(false)?;
    let (start, start_us) = (Instant::now(), board.now_us());
    let (mut is_open, mut behind) = (false, Duration::ZERO);
    while start.elapsed().as_secs_f64() < seconds {
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
            && let Ok(count) = nix::unistd::read(&master, &mut text)
        {
            board.send(&text[..count]);
        }
        let until_us = board.now_us() + 1000;
        board.step_until(until_us, &mut |_, bytes| {
            if is_open {
                // a host that does not read loses bytes, as with a cable
                let _ = nix::unistd::write(&master, bytes);
            }
        })?;
    }
    std::fs::remove_file(path).with_context(|| format!("remove {}", path.display()))?;
    Ok(behind)
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
