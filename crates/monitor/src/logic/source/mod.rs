//! Sources of samples: a running robot ([`live`]) or a log ([`playback`]); [`recording`] writes a log.

pub mod live;
mod log_thread;
pub mod playback;
pub mod recording;

use live::Live;
use moca_telemetry::net::Update;
use playback::Playback;

/// Source of samples.
pub enum Source {
    /// A robot that runs: it takes requests.
    Live(Box<dyn Live>),
    /// A log: it takes none.
    Log(Box<Playback>),
}

impl Source {
    /// Everything new; `now_s` never runs backwards, s.
    pub fn poll(&mut self, now_s: f64) -> Update {
        match self {
            Self::Live(robot) => robot.poll(),
            Self::Log(log) => log.poll(now_s),
        }
    }

    /// The robot, if it runs.
    pub fn live(&mut self) -> Option<&mut dyn Live> {
        match self {
            Self::Live(robot) => Some(robot.as_mut()),
            Self::Log(_) => None,
        }
    }

    /// The log, if it is one.
    pub fn log(&mut self) -> Option<&mut Playback> {
        match self {
            Self::Live(_) => None,
            Self::Log(log) => Some(log),
        }
    }
}

impl<L: Live + 'static> From<L> for Source {
    fn from(robot: L) -> Self {
        Self::Live(Box::new(robot))
    }
}

impl From<Playback> for Source {
    fn from(log: Playback) -> Self {
        Self::Log(Box::new(log))
    }
}
