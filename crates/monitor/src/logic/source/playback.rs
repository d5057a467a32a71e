//! A log, played at the speed at which it was recorded. Only what is shown of it is in memory.

use super::log_thread::{LogThread, Opened, Stretch, Told};
use crate::logic::limited::Limited;
use moca_msgs::{Sample, nanoseconds, seconds};
use moca_telemetry::{
    RobotDescription,
    log::{
        Overview,
        overview::{Happening, Mark, OverviewBuilder},
    },
    net::{Link, Update},
};
use std::{path::PathBuf, sync::Arc, time::Instant};

/// Length of the past before the chosen instant that is shown, ns.
const SHOWN_NS: u64 = 60_000_000_000;
/// Length that is read ahead of it, ns; half of it is left when the next stretch is requested.
const AHEAD_NS: u64 = 10_000_000_000;
/// Speeds at which a log can run, slowest first; 1 is as fast as it happened.
pub const SPEEDS: [f64; 6] = [0.1, 0.5, 1.0, 2.0, 5.0, 10.0];

/// A log and the instant of it that is shown.
pub struct Playback {
    path: PathBuf,
    robot: Arc<RobotDescription>,
    overview: Overview,
    range_ns: (u64, u64),
    note: String,
    reading: Option<Reading>,
    held: Held,
    state: State,
}

/// A file that is being read.
struct Reading {
    thread: LogThread,
    began: Instant,
    /// Which part has been looked through, until the log is open.
    opening: Option<f64>,
    /// True while a stretch is on its way.
    asked: bool,
}

/// Samples in memory.
#[derive(Default)]
struct Held {
    stretch: Option<Stretch>,
    samples: Vec<Sample>,
}

/// Landmark that a log can be searched for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Landmark {
    /// A change of mode or fault, or a contact that crossed a limit.
    Event,
    /// A hand on an untouched cover.
    Touch,
}

impl Landmark {
    fn is(self, mark: &Mark) -> bool {
        (mark.what == Happening::Touch) == (self == Self::Touch)
    }
}

struct State {
    failure: Option<String>,
    session: u64,
    at_s: f64,
    /// Robot time for each time of the wall.
    speed: f64,
    playing: bool,
    last_poll_s: Option<f64>,
    /// Until when samples have been given out in this session, ns.
    given_ns: Option<u64>,
}

impl Playback {
    /// Starts to read `path`; `wake` is called when something of it has been read.
    pub fn open(path: PathBuf, wake: impl Fn() + Send + 'static) -> std::io::Result<Self> {
        let thread = LogThread::start(path.clone(), wake)?;
        let reading = Reading { thread, began: Instant::now(), opening: Some(0.0), asked: false };
        Ok(Self::new(path, Some(reading)))
    }

    /// Plays samples that are already there.
    pub fn of(robot: RobotDescription, samples: Vec<Sample>) -> Self {
        let mut playback = Self::new(PathBuf::new(), None);
        let mut overview = OverviewBuilder::default();
        samples.iter().for_each(|sample| overview.add(sample));
        let time = |sample: Option<&Sample>| sample.map_or(0, |sample| sample.time_ns);
        let range_ns = (time(samples.first()), time(samples.last()));
        let overview = overview.finish();
        playback.take_opened(Opened { robot, range_ns, overview, note: String::new() });
        playback.held = Held { stretch: Some(range_ns.0..=range_ns.1), samples };
        playback
    }

    fn new(path: PathBuf, reading: Option<Reading>) -> Self {
        let state = State {
            failure: None,
            session: 1,
            at_s: 0.0,
            speed: 1.0,
            playing: true,
            last_poll_s: None,
            given_ns: None,
        };
        Self {
            path,
            robot: Arc::default(),
            overview: Overview::default(),
            range_ns: (0, 0),
            note: String::new(),
            reading,
            held: Held::default(),
            state,
        }
    }

    /// First and last instant of the log, s of loop time.
    pub fn range_s(&self) -> (f64, f64) {
        (seconds(self.range_ns.0), seconds(self.range_ns.1))
    }

    /// The whole log at a glance.
    pub const fn overview(&self) -> &Overview {
        &self.overview
    }

    /// The instant that is shown, s of loop time.
    pub fn at_s(&self) -> f64 {
        self.state.at_s
    }

    /// Shows another instant.
    pub fn seek(&mut self, at_s: f64) {
        let (first, last) = self.range_s();
        self.state.at_s = at_s.limited(first, last);
        // Going back needs a new history; going on a little does not.
        self.state.given_ns = None;
    }

    /// Robot time for each time of the wall.
    pub fn speed(&self) -> f64 {
        self.state.speed
    }

    /// Lets it run at another of [`SPEEDS`].
    pub fn set_speed(&mut self, speed: f64) {
        self.state.speed = speed.limited(SPEEDS[0], SPEEDS[SPEEDS.len() - 1]);
    }

    /// Returns true if it runs.
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

    /// The next `what` after the shown instant (`forwards`), or the last one before it, s of loop time. The mode that the log
    /// begins with is no event.
    pub fn find(&self, what: Landmark, forwards: bool) -> Option<f64> {
        let first = self.range_s().0;
        let marks = self.overview.marks.iter().filter(|mark| what.is(mark));
        let mut times = marks.map(|mark| seconds(mark.time_ns)).filter(|time_s| *time_s > first);
        if forwards {
            times.find(|time_s| *time_s > self.at_s() + 1e-6)
        } else {
            times.take_while(|time_s| *time_s < self.at_s() - 1e-6).last()
        }
    }

    /// The file, and what is missing of it.
    pub fn title(&self) -> String {
        format!("{} {}", self.path.display(), self.note)
    }

    fn take_opened(&mut self, opened: Opened) {
        let Opened { robot, range_ns, overview, note } = opened;
        self.robot = Arc::new(robot);
        (self.range_ns, self.overview, self.note) = (range_ns, overview, note);
        self.state.at_s = self.range_s().0;
    }

    fn hear(&mut self) {
        while let Some(told) = self.reading.as_ref().and_then(|reading| reading.thread.next()) {
            let Some(reading) = &mut self.reading else { return };
            match told {
                Told::Progress(part) => reading.opening = Some(part),
                Told::Opened(opened) => {
                    reading.opening = None;
                    self.take_opened(*opened);
                }
                Told::Samples(stretch, samples) => {
                    reading.asked = false;
                    self.held.take(stretch, samples);
                }
                Told::Failed(failure) => self.state.failure = Some(failure),
            }
        }
    }

    /// Asks for what will be shown next and is not in memory.
    fn ask(&mut self) {
        let at_ns = nanoseconds(self.state.at_s);
        let last_ns = self.range_ns.1;
        let Some(reading) = self.reading.as_mut().filter(|r| r.opening.is_none() && !r.asked) else { return };
        let until_ns = at_ns.saturating_add(AHEAD_NS).min(last_ns);
        let wanted = match &self.held.stretch {
            Some(held) if held.contains(&at_ns) => {
                let near = *held.end() < at_ns.saturating_add(AHEAD_NS / 2).min(last_ns);
                near.then(|| held.end().saturating_add(1)..=until_ns)
            }
            _ => Some(at_ns.saturating_sub(SHOWN_NS)..=until_ns),
        };
        if let Some(stretch) = wanted {
            reading.asked = true;
            reading.thread.ask(stretch);
        }
    }

    /// Returns the news since the last call, at the speed at which they happened; `now_s` never runs backwards, s.
    pub fn poll(&mut self, now_s: f64) -> Update {
        self.hear();
        let elapsed_s = self.state.last_poll_s.map_or(0.0, |last| now_s - last);
        self.state.last_poll_s = Some(now_s);
        let held_to_ns = self.held.until(nanoseconds(self.state.at_s));
        if let (true, Some(held_to_ns)) = (self.state.playing, held_to_ns) {
            let end_s = self.range_s().1;
            // What is not read yet is waited for.
            self.state.at_s =
                (self.state.at_s + self.state.speed * elapsed_s).min(end_s).min(seconds(held_to_ns));
            self.state.playing = self.state.at_s < end_s;
        }
        self.ask();
        let samples = if held_to_ns.is_some() { self.give() } else { Vec::new() };
        Update::new(self.link(), samples)
    }

    /// The samples up to the shown instant that have not been given out: after a jump, those of the minute before it.
    fn give(&mut self) -> Vec<Sample> {
        let at_ns = nanoseconds(self.state.at_s);
        if self.state.given_ns.is_none() {
            self.state.session += 1;
        }
        let given = self.state.given_ns.replace(at_ns);
        let from_ns =
            given.or_else(|| at_ns.checked_sub(SHOWN_NS)).map_or(0, |before_ns| before_ns.saturating_add(1));
        let place = |time_ns: u64| self.held.samples.partition_point(|sample| sample.time_ns < time_ns);
        self.held.samples.get(place(from_ns)..place(at_ns.saturating_add(1))).unwrap_or_default().to_vec()
    }

    fn link(&self) -> Link {
        if let Some(reason) = self.state.failure.clone() {
            return Link::Down { reason };
        }
        let path = self.path.display();
        match &self.reading {
            Some(Reading { opening: Some(part), began, .. }) => Link::Down {
                reason: format!("reading {path} …{}", how_far(*part, began.elapsed().as_secs_f64())),
            },
            _ => Link::Up { session: self.state.session, description: Arc::clone(&self.robot) },
        }
    }
}

impl Held {
    /// Takes a stretch that was read; what lies more than a minute before it is forgotten.
    fn take(&mut self, stretch: Stretch, samples: Vec<Sample>) {
        match &self.stretch {
            Some(held) if *stretch.start() == held.end().saturating_add(1) => {
                let from_ns = stretch.start().saturating_sub(SHOWN_NS + AHEAD_NS).max(*held.start());
                self.stretch = Some(from_ns..=*stretch.end());
                self.samples.retain(|sample| sample.time_ns >= from_ns);
                self.samples.extend(samples);
            }
            _ => (self.stretch, self.samples) = (Some(stretch), samples),
        }
    }

    /// Until when what follows `at_ns` is in memory.
    fn until(&self, at_ns: u64) -> Option<u64> {
        self.stretch.as_ref().filter(|held| held.contains(&at_ns)).map(|held| *held.end())
    }
}

/// Describes progress and remaining time of a longer task.
fn how_far(part: f64, elapsed_s: f64) -> String {
    if part <= 0.0 || elapsed_s < 1.0 {
        return String::new();
    }
    format!(" {:.0} %, {:.0} s left", 100.0 * part, (elapsed_s * (1.0 / part - 1.0)).max(1.0))
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
    fn speed_of_two_shows_twice_as_much_of_the_log() {
        let mut playback = log(200);
        playback.set_speed(2.0);
        playback.poll(5.0);
        playback.poll(6.0);
        assert!((playback.at_s() - 2.0).abs() < 1e-9);
        playback.set_speed(f64::NAN);
        assert!((playback.speed() - 0.1).abs() < 1e-9, "what is no number is the slowest");
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
        use moca_msgs::{TaxelReading, TaxelStatus};
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
        let (sender, done) = std::sync::mpsc::channel();
        let path = std::env::temp_dir().join("moca-monitor-no-such-log.mcap");
        let mut playback = Playback::open(path, move || {
            let _ = sender.send(());
        })
        .unwrap();
        done.recv().unwrap();
        let update = playback.poll(0.0);
        assert!(matches!(update.link, Link::Down { reason } if reason.contains("cannot open the log")));
    }

    /// Half an hour in a file, looked into at its end: only a minute and a little is in memory.
    #[test]
    fn a_long_log_is_read_where_it_is_shown() {
        use moca_telemetry::log::{LogWriter, Meta};
        let path = std::env::temp_dir().join(format!("moca-playback-{}.mcap", std::process::id()));
        let description = RobotDescription::paper("logged", false);
        let meta = Meta { description, start_unix_ns: 0 };
        let mut log = LogWriter::new(std::fs::File::create(&path).unwrap(), &meta).unwrap();
        for shown in 0..90_000 {
            let mode = if shown < 85_000 { Mode::Ready } else { Mode::Impedance };
            let sample = Sample { tick: 20 * shown, time_ns: shown * 20_000_000, mode, ..Sample::default() };
            log.sample(&sample).unwrap();
        }
        log.finish().unwrap();
        let (sender, woken) = std::sync::mpsc::channel();
        let mut playback = Playback::open(path.clone(), move || {
            let _ = sender.send(());
        })
        .unwrap();
        playback.play(false);
        let until = |playback: &mut Playback, tick: u64| loop {
            let update = playback.poll(0.0);
            if let Some(last) = update.samples.last() {
                assert_eq!(last.tick, tick);
                break (session(&update), update.samples.len());
            }
            woken.recv_timeout(std::time::Duration::from_secs(60)).unwrap();
        };
        assert_eq!(until(&mut playback, 0).1, 1, "it begins at the beginning");
        let event_s = playback.find(Landmark::Event, true).unwrap();
        assert!((event_s - 1700.0).abs() < 1e-9);
        playback.seek(event_s);
        let (before, shown) = until(&mut playback, 1_700_000);
        assert_eq!(shown, 3000, "the minute before it");
        assert!(playback.held.samples.len() <= 3501, "{}", playback.held.samples.len());
        playback.seek(10.0);
        let (after, shown) = until(&mut playback, 10_000);
        assert!(shown == 501 && after > before);
        // On from there without a gap, however late the next stretch comes.
        playback.play(true);
        let mut ticks = Vec::new();
        let mut now_s = 0.0;
        while playback.at_s() < 40.0 {
            now_s += 0.5;
            ticks.extend(playback.poll(now_s).samples.iter().map(|sample| sample.tick));
            std::thread::sleep(std::time::Duration::from_millis(1));
        }
        assert!(ticks.windows(2).all(|pair| pair[1] - pair[0] == 20) && ticks[0] == 10_020, "{ticks:?}");
        std::fs::remove_file(path).unwrap();
    }
}
