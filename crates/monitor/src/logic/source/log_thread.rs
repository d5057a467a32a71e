//! A log read on a thread of its own: opened by its index, then stretch by stretch as they are shown.

use moca_msgs::Sample;
use moca_telemetry::{
    RobotDescription,
    log::{LogFile, Overview},
};
use std::{
    ops::RangeInclusive,
    path::{Path, PathBuf},
    sync::mpsc::{Receiver, Sender, channel},
};

/// A stretch of loop time, ns.
pub(super) type Stretch = RangeInclusive<u64>;

/// Message of the thread.
pub(super) enum Told {
    /// Which part of the file has been looked through, 0 to 1: one that was not finished has no overview.
    Progress(f64),
    /// The log is open.
    Opened(Box<Opened>),
    /// Samples for a viewer of a requested stretch.
    Samples(Stretch, Vec<Sample>),
    /// It cannot be read (on).
    Failed(String),
}

/// Facts about a log before any of it is shown.
pub(super) struct Opened {
    pub(super) robot: RobotDescription,
    pub(super) range_ns: (u64, u64),
    pub(super) overview: Overview,
    /// Missing part of it.
    pub(super) note: String,
}

/// The thread; it ends with this.
pub(super) struct LogThread {
    asked: Sender<Stretch>,
    told: Receiver<Told>,
}

impl LogThread {
    /// Opens `path`; `wake` is called whenever there is something new.
    pub(super) fn start(path: PathBuf, wake: impl Fn() + Send + 'static) -> std::io::Result<Self> {
        let ((asked, stretches), (answers, told)) = (channel(), channel());
        std::thread::Builder::new().name("log reader".into()).spawn(move || {
            let tell = |what: Told| {
                let heard = answers.send(what).is_ok();
                wake();
                heard
            };
            if let Err(failure) = serve(&path, &stretches, &tell) {
                tell(Told::Failed(failure));
            }
        })?;
        Ok(Self { asked, told })
    }

    /// Asks for a stretch; it comes with a later [`Self::next`].
    pub(super) fn ask(&self, stretch: Stretch) {
        // A thread that has failed has said so.
        let _ = self.asked.send(stretch);
    }

    /// Returns the next message.
    pub(super) fn next(&self) -> Option<Told> {
        self.told.try_recv().ok()
    }
}

/// Opens the log and reads what is asked for until nobody listens any more.
fn serve(path: &Path, stretches: &Receiver<Stretch>, tell: &dyn Fn(Told) -> bool) -> Result<(), String> {
    let mut log = LogFile::open(path).map_err(|error| error.to_string())?;
    if log.overview().is_none() {
        let mut told = 0.0;
        log.build_overview(&mut |part| {
            if part - told > 0.01 {
                told = part;
                tell(Told::Progress(part));
            }
        });
    }
    let note = log.cut().map_or_else(String::new, |cut| format!("({cut})"));
    let overview = log.overview().cloned().unwrap_or_default();
    if overview.spans.is_empty() {
        return Err(format!("{} holds no samples {note}", path.display()));
    }
    let (robot, range_ns) = (log.description().clone(), log.range_ns());
    tell(Told::Opened(Box::new(Opened { robot, range_ns, overview, note })));
    for stretch in stretches {
        let samples = log.samples(*stretch.start(), *stretch.end()).map_err(|error| error.to_string())?;
        if !tell(Told::Samples(stretch, samples)) {
            break;
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    /// As `mocad log`, `mocad replay` and Python say it.
    #[test]
    fn log_that_ends_within_its_header_is_refused_as_such() {
        let path = std::env::temp_dir().join(format!("moca-monitor-{}.mcap", std::process::id()));
        std::fs::write(&path, [0x89, b'M', b'C', b'A', b'P', 0x30, b'\r', b'\n']).unwrap();
        let (_asked, stretches) = channel();
        let said = serve(&path, &stretches, &|_| true).unwrap_err();
        std::fs::remove_file(&path).unwrap();
        assert_eq!(said, format!("{} ends within its header: nothing in it can be read", path.display()));
    }
}
