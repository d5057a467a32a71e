//! The terminal as one more client: its own thread writes, so that a terminal that stops reading or goes away costs
//! lines and nothing else.

use crate::cli::report::{Level, Report, lines_of};
use crate::runtime::notice::{Notice, Reporter};
use moca_figures::progress::Progress;
use std::io::{self, IsTerminal, Write};
use std::sync::mpsc::{Receiver, RecvTimeoutError, SyncSender, TrySendError, sync_channel};
use std::time::{Duration, Instant};

/// Lines on their way to the terminal: a run of 15 minutes at a line a second.
const QUEUE_LINES: usize = 1024;
/// Longest wait of the end of a run, or of the program, for a terminal that does not read.
const PATIENCE: Duration = Duration::from_secs(1);
/// Period at which a run that may wait looks for room.
const LOOK_EVERY: Duration = Duration::from_millis(1);

/// Formats what a run has to say and hands it to the thread that writes.
pub struct Terminal {
    report: Report,
    lines: Option<SyncSender<String>>,
    written: Receiver<()>,
    may_wait: bool,
    lost: u64,
    /// Progress and duration of a run whose lines go elsewhere.
    progress: Option<(Progress, Duration)>,
}

impl Terminal {
    /// Standard output. A run that `may_wait` (lock-step) loses no line to a reader that is only slow.
    ///
    /// # Errors
    /// No thread.
    pub fn stdout(level: Level, may_wait: bool) -> io::Result<Self> {
        Self::onto(io::stdout(), level, may_wait)
    }

    /// Writes onto anything that can be written to.
    ///
    /// # Errors
    /// No thread.
    pub fn onto(output: impl Write + Send + 'static, level: Level, may_wait: bool) -> io::Result<Self> {
        let (lines, queue) = sync_channel(QUEUE_LINES);
        let (done, written) = sync_channel(0);
        std::thread::Builder::new()
            .name("terminal".into())
            .spawn(move || write_lines(&queue, output, done))?;
        Ok(Self {
            report: Report::new(level),
            lines: Some(lines),
            written,
            may_wait,
            lost: 0,
            progress: None,
        })
    }

    /// Shows on standard error how much of `duration` of robot time is over, if the lines that say so are not on the terminal.
    pub fn show_progress(&mut self, duration: Duration) {
        if !io::stdout().is_terminal() {
            self.progress = Some((Progress::new("run"), duration));
        }
    }

    /// Lines that found no room.
    pub const fn lost(&self) -> u64 {
        self.lost
    }

    fn say(&mut self, line: String) {
        if self.lost > 0 {
            let lost = format!("({} lines lost: the terminal did not take them)", self.lost);
            if !self.offer(lost) {
                self.lost += 1;
                return;
            }
            self.lost = 0;
        }
        if !self.offer(line) {
            self.lost += 1;
        }
    }

    /// Returns true if the line was taken. A terminal that has gone takes everything.
    fn offer(&mut self, mut line: String) -> bool {
        let Some(lines) = &self.lines else { return true };
        let until = Instant::now() + if self.may_wait { PATIENCE } else { Duration::ZERO };
        loop {
            line = match lines.try_send(line) {
                Ok(()) | Err(TrySendError::Disconnected(_)) => return true,
                Err(TrySendError::Full(line)) => line,
            };
            if Instant::now() >= until {
                // Who has not read for so long is not slow but stalled.
                self.may_wait = false;
                return false;
            }
            std::thread::sleep(LOOK_EVERY);
        }
    }
}

impl Reporter for Terminal {
    fn report(&mut self, notice: Notice<'_>) {
        if let (Notice::Sample(sample), Some((progress, duration))) = (notice, &mut self.progress) {
            progress.at(moca_msgs::seconds(sample.time_ns) / duration.as_secs_f64().max(1e-9));
        }
        for line in lines_of(&mut self.report, notice) {
            self.say(line);
        }
    }
}

impl Drop for Terminal {
    /// Waits a moment for what is still to be written.
    fn drop(&mut self) {
        self.lines = None;
        let _ = self.written.recv_timeout(PATIENCE) == Err(RecvTimeoutError::Timeout);
    }
}

/// Writes until there are no more lines, or nobody reads them. Dropping `done` says that it has ended.
fn write_lines(queue: &Receiver<String>, mut output: impl Write, done: SyncSender<()>) {
    for line in queue {
        if writeln!(output, "{line}").and_then(|()| output.flush()).is_err() {
            break;
        }
    }
    drop(done);
}

/// Ends the program quietly once nobody reads its output (`… | head`), as other programs do. Not for a loop: it outlives its
/// terminal.
pub fn end_with_the_reader() {
    use nix::sys::signal::{SigHandler, Signal, signal};
    #[expect(
        unsafe_code,
        reason = "a signal's disposition is set before any thread runs; no handler is installed"
    )]
    // SAFETY: no handler is installed.
    let restored = unsafe { signal(Signal::SIGPIPE, SigHandler::SigDfl) };
    // The signal exists on every Unix.
    let _ = restored;
}

/// Says on standard error why the program ends, unless nobody takes it.
pub fn last_words(words: &str) {
    let (done, written) = sync_channel::<()>(0);
    let words = format!("mocad: {words}\n");
    let thread = std::thread::Builder::new().name("last-words".into()).spawn(move || {
        // Nobody is left to hear that this failed.
        let _ = io::stderr().write_all(words.as_bytes());
        drop(done);
    });
    if thread.is_ok() {
        let _ = written.recv_timeout(PATIENCE);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use moca_msgs::{Mode, Sample};
    use std::sync::{Arc, Condvar, Mutex};

    #[derive(Default)]
    struct Flow {
        open: bool,
        waiting: bool,
        written: Vec<u8>,
    }

    /// An output that blocks until it is opened.
    #[derive(Clone, Default)]
    struct Valve(Arc<(Mutex<Flow>, Condvar)>);

    impl Valve {
        fn open(&self) {
            self.0.0.lock().unwrap().open = true;
            self.0.1.notify_all();
        }

        fn text(&self) -> String {
            String::from_utf8(self.0.0.lock().unwrap().written.clone()).unwrap()
        }
    }

    impl Write for Valve {
        fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
            self.0.0.lock().unwrap().waiting = true;
            let mut flow = self.0.1.wait_while(self.0.0.lock().unwrap(), |flow| !flow.open).unwrap();
            flow.written.extend_from_slice(bytes);
            Ok(bytes.len())
        }

        fn flush(&mut self) -> io::Result<()> {
            Ok(())
        }
    }

    fn changes_of_mode(terminal: &mut Terminal, count: u64) {
        for tick in 0..count {
            let mode = if tick % 2 == 0 { Mode::Ready } else { Mode::Impedance };
            terminal.report(Notice::Sample(&Sample { tick, mode, ..Sample::default() }));
        }
    }

    #[test]
    fn a_stalled_terminal_costs_lines_which_are_counted_and_told() {
        let valve = Valve::default();
        let mut terminal = Terminal::onto(valve.clone(), Level::Info, false).unwrap();
        while !valve.0.0.lock().unwrap().waiting {
            changes_of_mode(&mut terminal, 1);
            std::thread::sleep(Duration::from_millis(1));
        }
        changes_of_mode(&mut terminal, 5000);
        assert!(terminal.lost() > 3000, "{}", terminal.lost());
        valve.open();
        let until = Instant::now() + Duration::from_secs(20);
        while !valve.text().contains("lines lost") && Instant::now() < until {
            std::thread::sleep(Duration::from_millis(5));
            changes_of_mode(&mut terminal, 2);
        }
        drop(terminal);
        assert!(valve.text().contains("lines lost"), "{}", valve.text());
    }

    #[test]
    fn blocked_terminal_does_not_delay_exit() {
        let mut terminal = Terminal::onto(Valve::default(), Level::Info, true).unwrap();
        changes_of_mode(&mut terminal, 5000);
        assert!(terminal.lost() > 0, "even a run that may wait goes on");
        drop(terminal);
    }

    #[test]
    fn a_terminal_that_has_gone_is_no_error() {
        struct Gone;
        impl Write for Gone {
            fn write(&mut self, _: &[u8]) -> io::Result<usize> {
                Err(io::ErrorKind::BrokenPipe.into())
            }

            fn flush(&mut self) -> io::Result<()> {
                Ok(())
            }
        }
        let mut terminal = Terminal::onto(Gone, Level::Info, true).unwrap();
        changes_of_mode(&mut terminal, 5000);
        assert!(terminal.lost() <= 1, "{}", terminal.lost());
    }
}
