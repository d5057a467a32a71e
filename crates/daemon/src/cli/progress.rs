//! How far something has come that takes its time: a bar on a terminal, a line now and then elsewhere, on standard error.
//!
//! ```
//! use moca_daemon::cli::progress::Progress;
//! let mut progress = Progress::new("reading");
//! for part in 0..100 {
//!     progress.at(f64::from(part) / 100.0);
//! }
//! // Nothing has been shown: it took no two seconds.
//! progress.end();
//! ```

use std::io::{IsTerminal, Write};
use std::time::{Duration, Instant};

/// What takes no longer is not spoken of.
const QUIET: Duration = Duration::from_secs(2);
/// How often a bar moves.
const BAR_EVERY: Duration = Duration::from_millis(200);
/// How often a file or a pipe gets a line.
const LINE_EVERY: Duration = Duration::from_secs(20);
/// Cells of a bar.
const CELLS: usize = 30;

/// Shows how far one thing has come.
#[derive(Debug)]
pub struct Progress {
    what: String,
    began: Instant,
    /// When it was shown last, and whether as a bar.
    shown: Option<Instant>,
    terminal: bool,
}

impl Progress {
    /// Of `what`, which begins now.
    pub fn new(what: impl Into<String>) -> Self {
        let terminal = std::io::stderr().is_terminal();
        Self { what: what.into(), began: Instant::now(), shown: None, terminal }
    }

    /// `part` of it is done, 0 to 1.
    pub fn at(&mut self, part: f64) {
        let now = Instant::now();
        let elapsed = now - self.began;
        if !due(elapsed, self.shown.map(|last| now - last), self.terminal) {
            return;
        }
        self.shown = Some(now);
        let text = line(&self.what, part, elapsed, self.terminal);
        let mut output = std::io::stderr();
        // A terminal that went away is no reason to stop.
        let _ = if self.terminal { write!(output, "\r{text}\x1b[K") } else { writeln!(output, "{text}") };
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
        if self.terminal && self.shown.is_some() {
            let _ = write!(std::io::stderr(), "\r\x1b[K");
        }
    }
}

/// Whether it is time to show something.
fn due(elapsed: Duration, since_shown: Option<Duration>, terminal: bool) -> bool {
    let every = if terminal { BAR_EVERY } else { LINE_EVERY };
    elapsed >= QUIET && since_shown.is_none_or(|since| since >= every)
}

fn line(what: &str, part: f64, elapsed: Duration, bar: bool) -> String {
    let part = if part.is_finite() { part.clamp(0.0, 1.0) } else { 0.0 };
    let left = if part > 0.0 { time_left(elapsed.as_secs_f64() * (1.0 / part - 1.0)) } else { String::new() };
    let percent = 100.0 * part;
    if !bar {
        return format!("{what}: {percent:.0} %{left}");
    }
    #[expect(
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss,
        clippy::cast_precision_loss,
        reason = "between 0 and 30"
    )]
    let filled = (part * CELLS as f64) as usize;
    format!("{what} [{}{}] {percent:.0} %{left}", "#".repeat(filled), ".".repeat(CELLS - filled))
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
    fn what_is_quick_is_silent_and_a_file_gets_few_lines() {
        let ms = Duration::from_millis;
        assert!(!due(ms(1999), None, true) && due(ms(2000), None, true));
        assert!(!due(ms(2100), Some(ms(100)), true) && due(ms(2200), Some(ms(200)), true));
        assert!(due(ms(2000), None, false) && !due(ms(12_000), Some(ms(10_000)), false));
    }

    #[test]
    fn it_says_how_much_is_left() {
        let after = |seconds: u64| Duration::from_secs(seconds);
        assert_eq!(line("sweep", 0.25, after(10), false), "sweep: 25 %, 30 s left");
        assert_eq!(line("sweep", 0.0, after(10), false), "sweep: 0 %");
        assert_eq!(line("sweep", f64::NAN, after(10), false), "sweep: 0 %");
        assert_eq!(
            line("sweep", 0.5, after(600), true),
            "sweep [###############...............] 50 %, 10 min left"
        );
        assert_eq!(line("sweep", 0.1, after(3600), false), "sweep: 10 %, 9.0 h left");
        assert_eq!(line("sweep", 1.5, after(10), false), "sweep: 100 %, 1 s left");
    }
}
