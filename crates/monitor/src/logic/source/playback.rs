//! A log, played at the speed at which it was recorded.

use moca_msgs::{Sample, TaxelStatus, protection::ContactPhase, seconds};
use moca_telemetry::{
    RobotDescription,
    calibration::CalibrationProgress,
    log::{LogReader, Record},
    net::{Link, Status, Update},
};
use std::{
    path::PathBuf,
    sync::{
        Arc,
        mpsc::{Receiver, TryRecvError, channel},
    },
};

/// Samples of a log that are kept in memory, over 16 minutes at 1 kHz and 1.4 GB: the first ones.
const MAX_SAMPLES: usize = 1_000_000;
/// What is shown before the chosen instant, s.
const SHOWN_S: f64 = 60.0;

/// A log and the instant of it that is shown.
pub struct Playback {
    path: PathBuf,
    loading: Option<Receiver<Result<Loaded, String>>>,
    log: Loaded,
    state: State,
}

/// What a log can be searched for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Landmark {
    /// A change of mode or fault, or a contact that crossed a limit.
    Event,
    /// A hand on an untouched cover.
    Touch,
}

impl Landmark {
    fn is_between(self, a: &Sample, b: &Sample) -> bool {
        let crossed = |s: &Sample| s.contact_events.iter().any(|c| c.phase == ContactPhase::LimitCrossed);
        let felt = |s: &Sample| s.taxels.iter().any(|t| t.status == TaxelStatus::Ok && t.force_n > 0.0);
        match self {
            Self::Event => (a.mode, a.fault) != (b.mode, b.fault) || crossed(b),
            Self::Touch => felt(b) && !felt(a),
        }
    }
}

#[derive(Default)]
struct Loaded {
    robot: Arc<RobotDescription>,
    samples: Vec<Sample>,
    /// When what happened, s of loop time, in order.
    events_s: Vec<f64>,
    touches_s: Vec<f64>,
    note: String,
}

impl Loaded {
    fn new(robot: RobotDescription, samples: Vec<Sample>, note: String) -> Self {
        let times = |what: Landmark| {
            let found = samples.windows(2).filter_map(|pair| match pair {
                [a, b] if what.is_between(a, b) => Some(seconds(b.time_ns)),
                _ => None,
            });
            found.collect()
        };
        let (events_s, touches_s) = (times(Landmark::Event), times(Landmark::Touch));
        Self { robot: Arc::new(robot), samples, events_s, touches_s, note }
    }
}

struct State {
    failure: Option<String>,
    session: u64,
    at_s: f64,
    playing: bool,
    last_poll_s: Option<f64>,
    /// Samples already given out in this session.
    given: Option<usize>,
}

impl Playback {
    /// Starts to read `path`; `wake` is called when that is done.
    pub fn open(path: PathBuf, wake: impl FnOnce() + Send + 'static) -> std::io::Result<Self> {
        let (sender, loading) = channel();
        let from = path.clone();
        std::thread::Builder::new().name("log reader".into()).spawn(move || {
            // The window may have been closed meanwhile.
            let _ = sender.send(load(&from));
            wake();
        })?;
        Ok(Self::new(path, Some(loading), Loaded::default()))
    }

    /// Plays samples that are already there.
    pub fn of(robot: RobotDescription, samples: Vec<Sample>) -> Self {
        Self::new(PathBuf::new(), None, Loaded::new(robot, samples, String::new()))
    }

    fn new(path: PathBuf, loading: Option<Receiver<Result<Loaded, String>>>, log: Loaded) -> Self {
        let state =
            State { failure: None, session: 1, at_s: 0.0, playing: true, last_poll_s: None, given: None };
        let mut playback = Self { path, loading, log, state };
        playback.state.at_s = playback.range_s().0;
        playback
    }

    /// First and last instant of the log, s of loop time.
    pub fn range_s(&self) -> (f64, f64) {
        let time = |sample: Option<&Sample>| sample.map_or(0.0, |s| seconds(s.time_ns));
        (time(self.log.samples.first()), time(self.log.samples.last()))
    }

    /// The instant that is shown, s of loop time.
    pub fn at_s(&self) -> f64 {
        self.state.at_s
    }

    /// Shows another instant.
    pub fn seek(&mut self, at_s: f64) {
        let (first, last) = self.range_s();
        self.state.at_s = at_s.clamp(first, last);
        // Going back needs a new history; going on a little does not.
        self.state.given = None;
        self.state.session += 1;
    }

    /// Whether it runs.
    pub fn playing(&self) -> bool {
        self.state.playing
    }

    /// Lets it run, or stand still. At the end it starts from the beginning.
    pub fn play(&mut self, playing: bool) {
        self.state.playing = playing;
        if playing && self.at_s() >= self.range_s().1 {
            self.seek(self.range_s().0);
        }
    }

    /// The next `what` after the shown instant (`forwards`), or the last one before it, s of loop time.
    pub fn find(&self, what: Landmark, forwards: bool) -> Option<f64> {
        let times = match what {
            Landmark::Event => &self.log.events_s,
            Landmark::Touch => &self.log.touches_s,
        };
        if forwards {
            times.get(times.partition_point(|t| *t <= self.at_s() + 1e-6)).copied()
        } else {
            times.get(times.partition_point(|t| *t < self.at_s() - 1e-6).checked_sub(1)?).copied()
        }
    }

    /// The file, and what is missing of it.
    pub fn title(&self) -> String {
        format!("{} {}", self.path.display(), self.log.note)
    }

    fn take_loaded(&mut self) {
        let Some(loading) = &self.loading else { return };
        match loading.try_recv() {
            Ok(Ok(log)) => {
                self.log = log;
                self.state.at_s = self.range_s().0;
            }
            Ok(Err(failure)) => self.state.failure = Some(failure),
            Err(TryRecvError::Empty) => return,
            Err(TryRecvError::Disconnected) => {
                self.state.failure = Some("reading the log was given up".into())
            }
        }
        self.loading = None;
    }

    /// What happened since the last call, at the speed at which it happened; `now_s` never runs backwards, s.
    pub fn poll(&mut self, now_s: f64) -> Update {
        self.take_loaded();
        let elapsed_s = self.state.last_poll_s.map_or(0.0, |last| now_s - last);
        self.state.last_poll_s = Some(now_s);
        if self.state.playing && self.loading.is_none() {
            let end_s = self.range_s().1;
            self.state.at_s = (self.state.at_s + elapsed_s).min(end_s);
            self.state.playing = self.state.at_s < end_s;
        }
        let samples = &self.log.samples;
        let until = |time_s: f64| samples.partition_point(|s| seconds(s.time_ns) <= time_s);
        let to = until(self.state.at_s);
        let from = self.state.given.unwrap_or_else(|| until(self.state.at_s - SHOWN_S)).min(to);
        self.state.given = Some(to);
        let link = match (&self.state.failure, &self.loading) {
            (Some(failure), _) => Link::Down { reason: failure.clone() },
            (None, Some(_)) => Link::Down { reason: format!("reading {} …", self.path.display()) },
            (None, None) => {
                Link::Up { session: self.state.session, description: Arc::clone(&self.log.robot) }
            }
        };
        Update {
            link,
            status: Status::default(),
            samples: samples.get(from..to).unwrap_or_default().to_vec(),
            replies: Vec::new(),
            calibration: CalibrationProgress::Idle,
            notices: Vec::new(),
            unread_dropped: 0,
        }
    }
}

fn load(path: &std::path::Path) -> Result<Loaded, String> {
    let mut reader = LogReader::open(path).map_err(|error| error.to_string())?;
    let mut samples = Vec::new();
    let mut note = String::new();
    for record in &mut reader {
        if let Record::Sample(sample) = record {
            if samples.len() == MAX_SAMPLES {
                note = format!("(only its first {MAX_SAMPLES} samples)");
                break;
            }
            samples.push(*sample);
        }
    }
    if let Some(cut) = reader.cut() {
        note = format!("({cut})");
    }
    if samples.is_empty() {
        return Err(format!("{} holds no samples {note}", path.display()));
    }
    Ok(Loaded::new(reader.description().clone(), samples, note))
}

#[cfg(test)]
mod tests {
    use super::*;
    use moca_msgs::Mode;

    fn log(seconds: u64) -> Playback {
        let samples = (0..seconds * 100).map(|tick| Sample {
            tick,
            time_ns: tick * 10_000_000,
            mode: if tick < 5000 { Mode::Ready } else { Mode::Impedance },
            ..Sample::default()
        });
        Playback::of(RobotDescription::paper("logged", false), samples.collect())
    }

    fn session(update: &Update) -> u64 {
        match update.link {
            Link::Up { session, .. } => session,
            Link::Down { .. } => 0,
        }
    }

    #[test]
    fn it_runs_as_fast_as_it_happened_and_gives_every_sample_once() {
        let mut playback = log(200);
        let mut ticks = Vec::new();
        for now_s in [5.0, 5.5, 5.6, 7.0] {
            ticks.extend(playback.poll(now_s).samples.iter().map(|s| s.tick));
        }
        assert!(ticks.into_iter().eq(0..=200));
    }

    #[test]
    fn a_jump_shows_the_minute_before_it_as_a_new_session() {
        let mut playback = log(200);
        playback.play(false);
        let before = session(&playback.poll(0.0));
        playback.seek(100.0);
        let update = playback.poll(1.0);
        assert_eq!(session(&update), before + 1);
        assert_eq!((update.samples[0].tick, update.samples[update.samples.len() - 1].tick), (4001, 10_000));
        assert!(playback.poll(2.0).samples.is_empty(), "it stands still");
        assert!((playback.at_s() - 100.0).abs() < 1e-9);
    }

    #[test]
    fn events_are_found_in_both_directions() {
        let mut playback = log(200);
        assert_eq!(playback.find(Landmark::Event, true), Some(50.0));
        assert_eq!(playback.find(Landmark::Event, false), None);
        playback.seek(120.0);
        assert_eq!(playback.find(Landmark::Event, true), None);
        assert_eq!(playback.find(Landmark::Event, false), Some(50.0));
    }

    #[test]
    fn each_touch_of_an_untouched_cover_is_found_once() {
        use moca_msgs::TaxelReading;
        let touched = |tick: u64| (1000..1200).contains(&tick) || (3000..3001).contains(&tick);
        let samples = (0..5000).map(|tick| {
            let mut sample = Sample { tick, time_ns: tick * 1_000_000, ..Sample::default() };
            let force_n = if touched(tick) { 12.0 } else { 0.0 };
            sample.taxels.push(TaxelReading { force_n, status: TaxelStatus::Ok }).unwrap();
            sample
        });
        let mut playback = Playback::of(RobotDescription::paper("logged", false), samples.collect());
        assert_eq!(playback.find(Landmark::Touch, true), Some(1.0));
        playback.seek(1.2);
        assert_eq!(playback.find(Landmark::Touch, true), Some(3.0));
        assert_eq!(playback.find(Landmark::Touch, false), Some(1.0));
        assert_eq!(playback.find(Landmark::Event, true), None);
    }

    #[test]
    fn a_file_that_is_no_log_is_told() {
        let (sender, done) = channel();
        let path = std::env::temp_dir().join("moca-monitor-no-such-log.mcap");
        let mut playback = Playback::open(path, move || sender.send(()).unwrap()).unwrap();
        done.recv().unwrap();
        let update = playback.poll(0.0);
        assert!(matches!(update.link, Link::Down { reason } if reason.contains("cannot open the log")));
    }
}
