//! Progress of a task that takes more than two seconds, with the remaining time: a bar on standard error, if that is a
//! terminal and `--quiet` was not given.
//!
//! ```
//! use moca_figures::progress::Progress;
//! let mut progress = Progress::new("reading");
//! for part in 0..100 {
//!     progress.at(f64::from(part) / 100.0);
//! }
//! // Nothing has been shown: it took no two seconds.
//! progress.end();
//! ```

use std::io::{IsTerminal, Write};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{RecvTimeoutError, SyncSender, sync_channel};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

/// Duration below which a task shows no progress.
const QUIET: Duration = Duration::from_secs(2);
/// Period of a bar's update.
const BAR_EVERY: Duration = Duration::from_millis(200);
/// Cells of a bar.
const CELLS: usize = 30;

/// `--quiet` was given.
static QUIET_ASKED: AtomicBool = AtomicBool::new(false);

/// A progress that may be shown is under way: what is part of it shows no bar of its own.
static UNDER_WAY: AtomicBool = AtomicBool::new(false);

/// Shows no bar from now on.
pub fn be_quiet() {
    QUIET_ASKED.store(true, Ordering::Relaxed);
}

/// Shows how far one thing has come. A progress within another one, on whichever thread, is not shown.
#[derive(Debug)]
pub struct Progress {
    what: String,
    began: Instant,
    /// When it was shown last.
    shown: Option<Instant>,
    /// Standard error is a terminal, bars are wanted, and no other progress is under way.
    visible: bool,
}

impl Progress {
    /// Starts the progress of `what`.
    pub fn new(what: impl Into<String>) -> Self {
        let wanted = std::io::stderr().is_terminal() && !QUIET_ASKED.load(Ordering::Relaxed);
        let visible = wanted && !UNDER_WAY.swap(true, Ordering::Relaxed);
        Self { what: what.into(), began: Instant::now(), shown: None, visible }
    }

    /// `part` of it is done, 0 to 1.
    pub fn at(&mut self, part: f64) {
        let now = Instant::now();
        let elapsed = now - self.began;
        if !self.visible || !due(elapsed, self.shown.map(|last| now - last)) {
            return;
        }
        self.shown = Some(now);
        let text = line(&self.what, part, elapsed);
        let mut output = std::io::stderr();
        // A terminal that went away is no reason to stop.
        let _ = write!(output, "\r{text}\x1b[K");
        let _ = output.flush();
    }

    /// `done` of `all` are done.
    #[expect(clippy::cast_precision_loss, reason = "a share")]
    pub fn count(&mut self, done: usize, all: usize) {
        self.at(done as f64 / all.max(1) as f64);
    }

    /// All of it is done, or given up: a bar goes away.
    pub fn end(self) {}
}

impl Drop for Progress {
    fn drop(&mut self) {
        if self.shown.is_some() {
            let _ = write!(std::io::stderr(), "\r\x1b[K");
        }
        if self.visible {
            UNDER_WAY.store(false, Ordering::Relaxed);
        }
    }
}

/// Returns true if it is time to show something.
fn due(elapsed: Duration, since_shown: Option<Duration>) -> bool {
    elapsed >= QUIET && since_shown.is_none_or(|since| since >= BAR_EVERY)
}

/// Shows for `length` how much of it is over, from a thread of its own, until what it gives is dropped.
pub fn during(what: impl Into<String>, length: Duration) -> During {
    let began = Instant::now();
    following(what, move || began.elapsed().as_secs_f64() / length.as_secs_f64().max(1e-3))
}

/// Shows the `part` that is done, 0 to 1, from a thread of its own, until what it gives is dropped. For a task whose
/// steps take long: the bar is there before the first of them is done.
pub fn following(what: impl Into<String>, part: impl Fn() -> f64 + Send + 'static) -> During {
    let mut progress = Progress::new(what);
    let (end, ended) = sync_channel::<()>(0);
    let thread = progress.visible.then(|| {
        std::thread::spawn(move || {
            while ended.recv_timeout(BAR_EVERY) == Err(RecvTimeoutError::Timeout) {
                progress.at(part());
            }
        })
    });
    During { end: Some(end), thread }
}

/// A bar of a thread of its own.
#[derive(Debug)]
pub struct During {
    end: Option<SyncSender<()>>,
    thread: Option<JoinHandle<()>>,
}

impl Drop for During {
    fn drop(&mut self) {
        self.end = None;
        if let Some(thread) = self.thread.take() {
            // It only writes; if it panicked, the bar is gone.
            let _ = thread.join();
        }
    }
}

fn line(what: &str, part: f64, elapsed: Duration) -> String {
    let part = if part.is_finite() { part.clamp(0.0, 1.0) } else { 0.0 };
    let left = if part > 0.0 { time_left(elapsed.as_secs_f64() * (1.0 / part - 1.0)) } else { String::new() };
    format!("{what} {} {:.0} %{left}", cells(part), 100.0 * part)
}

/// `[####....]` with a share of it filled, 0 to 1.
pub fn cells(part: f64) -> String {
    #[expect(
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss,
        clippy::cast_precision_loss,
        reason = "between 0 and 30"
    )]
    let filled = (part.clamp(0.0, 1.0) * CELLS as f64) as usize;
    format!("[{}{}]", "#".repeat(filled), ".".repeat(CELLS - filled))
}

/// `, 3 min left`: no more digits than a guess has.
fn time_left(seconds: f64) -> String {
    match seconds {
        ..100.0 => format!(", {:.0} s left", seconds.max(1.0)),
        ..6000.0 => format!(", {:.0} min left", seconds / 60.0),
        _ => format!(", {:.1} h left", seconds / 3600.0),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bar_appears_after_two_seconds_and_moves_five_times_each() {
        let ms = Duration::from_millis;
        assert!(!due(ms(1999), None) && due(ms(2000), None));
        assert!(!due(ms(2100), Some(ms(100))) && due(ms(2200), Some(ms(200))));
    }

    #[test]
    fn a_bar_says_how_much_is_left() {
        let of = |part, seconds| line("sweep", part, Duration::from_secs(seconds));
        assert_eq!(of(0.5, 600), "sweep [###############...............] 50 %, 10 min left");
        assert!(of(0.25, 10).ends_with("] 25 %, 30 s left"));
        assert!(of(0.0, 10).ends_with("] 0 %") && of(f64::NAN, 10).ends_with("] 0 %"));
        assert!(of(0.1, 3600).ends_with("] 10 %, 9.0 h left"));
        assert!(of(1.5, 10).ends_with("] 100 %, 1 s left"));
    }

    #[test]
    fn a_pipe_gets_no_bar() {
        // Standard error of a test is a pipe or a file, or else it was asked to be quiet.
        be_quiet();
        let mut progress = Progress::new("test");
        progress.began -= Duration::from_secs(60);
        progress.at(0.5);
        assert!(progress.shown.is_none());
        drop(during("test", Duration::from_secs(60)));
    }
}
