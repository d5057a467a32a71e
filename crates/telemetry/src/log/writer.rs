//! Samples and bytes in, an MCAP file out.

use super::{
    LogError, SerialBytes,
    container::Container,
    overview::OverviewBuilder,
    purpose::Purpose,
    records::{
        Channel, Configuration, DriverWords, LOOP_STATE_TOPIC, ParameterChange, REPLAY_TOPIC, Robot,
        SERIAL_TOPICS,
    },
    story::{Chapter, Story},
};
use crate::{
    RobotDescription,
    audit::Asked,
    display::{Display, Periods, Sink},
    ros::{self, Message, cdr},
};
use moca_msgs::Sample;
use std::{borrow::Cow, collections::BTreeMap, io::Write};

/// Number that a channel of bytes has where others have their schema's.
const NO_SCHEMA: u16 = 0;
/// Name of this form in a file's header; a reader refuses others by name.
pub(super) const FORM: &str = "moca-s/4";
/// Common beginning of the names of all forms.
pub(super) const FORMS: &str = "moca-s/";
/// Beginning of the library's name in a log's header.
pub(super) const LIBRARY: &str = "moca-telemetry ";
/// Largest loss by a cut, ns of loop time.
const CHUNK_NS: u64 = 500_000_000;
/// Time between two states of the story in a log, ns of loop time.
const CHAPTER_NS: u64 = 60_000_000_000;
/// Periods of samples for viewers: numbers at 50 Hz, everything else at 10 Hz. At 50 Hz transforms and joints would be as large as all
/// numbers together. A seeking reader finds the last of each message before that time.
const PERIODS: Periods = Periods { numbers_ns: 20_000_000, poses_ns: 100_000_000, fixed_ns: 600_000_000_000 };
/// Name of the overview among a log's attachments.
pub(super) const OVERVIEW: &str = "overview.json";
/// Name of the metadata that hold the story so far.
pub(super) const STORY: &str = "story";
/// Name of the robot's URDF among the attachments.
const ROBOT: &str = "robot.urdf";

/// Description of a log in itself.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Meta {
    /// The robot.
    pub description: RobotDescription,
    /// Unix time of loop time 0, ns; 0 for a run that has no place in time.
    pub start_unix_ns: u64,
}

/// Contents written so far.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct LogSummary {
    /// Samples given.
    pub samples: u64,
    /// Samples written for viewers.
    pub displayed: u64,
    /// Bytes of the Touch Board.
    pub serial_bytes: u64,
    /// Entries that found no room on their way to the recorder.
    pub dropped: u64,
}

impl LogSummary {
    pub(super) const fn plus(self, other: &Self) -> Self {
        Self {
            samples: self.samples + other.samples,
            displayed: self.displayed + other.displayed,
            serial_bytes: self.serial_bytes + other.serial_bytes,
            dropped: self.dropped + other.dropped,
        }
    }
}

/// Writes a log to `W`. Each channel's messages are in order of time.
pub struct LogWriter<W: Write> {
    channels: Channels<W>,
    display: Display,
    /// Loop time at which the present chunk began; `None` before its first sample.
    chunk_ns: Option<u64>,
    overview: OverviewBuilder,
    story: Story,
    /// Loop time from which the story so far is due again, ns.
    next_chapter_ns: u64,
    summary: LogSummary,
}

/// The file, and where in it each kind of message goes.
struct Channels<W: Write> {
    file: Container<W>,
    by_topic: BTreeMap<&'static str, (u16, Purpose)>,
    start_unix_ns: u64,
    json: Vec<u8>,
    cdr: cdr::Writer,
}

impl<W: Write> LogWriter<W> {
    /// Starts a log: header, schemas and the robot's description go out at once.
    pub fn new(output: W, meta: &Meta) -> Result<Self, LogError> {
        let channels = Channels {
            file: Container::new(output, FORM, concat!("moca-telemetry ", env!("CARGO_PKG_VERSION")))?,
            by_topic: BTreeMap::new(),
            start_unix_ns: meta.start_unix_ns,
            json: Vec::new(),
            cdr: cdr::Writer::rounded(),
        };
        let mut log = Self {
            channels,
            display: Display::new(&meta.description, meta.start_unix_ns, PERIODS),
            chunk_ns: None,
            overview: OverviewBuilder::default(),
            story: Story::default(),
            next_chapter_ns: CHAPTER_NS,
            summary: LogSummary::default(),
        };
        let to = &mut log.channels;
        to.add_record::<Robot>()?;
        to.add_record::<ParameterChange>()?;
        to.add_record::<Configuration>()?;
        for topic in SERIAL_TOPICS.into_iter().chain([LOOP_STATE_TOPIC, REPLAY_TOPIC]) {
            to.add(NO_SCHEMA, topic, "application/octet-stream");
        }
        let json = serde_json::to_string(&meta.description)?;
        let name = meta.description.name.clone();
        to.write(0, &Robot { start_unix_ns: meta.start_unix_ns, name, json })?;
        log.display.begin(to)?;
        log.flush()?;
        log.tell()?;
        if !meta.description.urdf.is_empty() {
            log.attach(ROBOT, "application/xml", meta.description.urdf.as_bytes())?;
        }
        Ok(log)
    }

    /// Takes one sample. What changed or happened is written with its tick; the rest as often as a viewer can show it, and
    /// whenever something happened.
    pub fn sample(&mut self, sample: &Sample) -> Result<(), LogError> {
        let time_ns = sample.time_ns;
        if self.chunk_ns.is_some_and(|began| time_ns.saturating_sub(began) >= CHUNK_NS) {
            self.flush()?;
            self.chapter(time_ns)?;
        }
        // A chunk can be read alone.
        let again = self.chunk_ns.is_none();
        if let Some(shown) = self.display.sample(sample, again, &mut self.channels)? {
            self.story.add(shown);
            self.summary.displayed += 1;
        }
        self.chunk_ns.get_or_insert(time_ns);
        self.overview.add(sample);
        self.summary.samples += 1;
        Ok(())
    }

    /// Writes the story so far, once in [`CHAPTER_NS`]; the chunks before it hold all of it.
    fn chapter(&mut self, now_ns: u64) -> Result<(), LogError> {
        if now_ns < self.next_chapter_ns {
            return Ok(());
        }
        self.next_chapter_ns = now_ns - now_ns % CHAPTER_NS + CHAPTER_NS;
        self.tell()
    }

    fn tell(&mut self) -> Result<(), LogError> {
        let named =
            self.channels.by_topic.iter().map(|(topic, (channel, _))| (*channel, Cow::Borrowed(*topic)));
        let (story, bytes) = (Cow::Borrowed(&self.story), self.channels.file.sizes());
        let chapter = Chapter { story, bytes, topics: named.collect() };
        let json = serde_json::to_string(&chapter)?;
        let crc = crc32fast::hash(json.as_bytes()).to_string();
        Ok(self.channels.file.metadata(STORY, &[("crc32", &crc), ("json", &json)])?)
    }

    /// Loop time at which the present chunk began, ns; `None` before its first sample.
    pub(super) const fn chunk_ns(&self) -> Option<u64> {
        self.chunk_ns
    }

    /// Writes how the run is configured.
    pub fn configuration(&mut self, configuration: &Configuration) -> Result<(), LogError> {
        self.channels.write(0, configuration)?;
        self.flush()
    }

    /// Writes a block of what ticks were given, in the daemon's own form.
    pub fn replay(&mut self, time_ns: u64, block: &[u8]) -> Result<(), LogError> {
        self.channels.write_bytes(REPLAY_TOPIC, time_ns, block)
    }

    /// Writes what the loop remembered when the log begins, in the daemon's own form.
    pub fn loop_state(&mut self, time_ns: u64, state: &[u8]) -> Result<(), LogError> {
        self.channels.write_bytes(LOOP_STATE_TOPIC, time_ns, state)
    }

    /// Writes a change of a parameter.
    pub fn parameter(&mut self, time_ns: u64, change: &ParameterChange) -> Result<(), LogError> {
        self.channels.write(time_ns, change)
    }

    /// Writes what a driver of the robot said; a log of a robot without drivers has no such channel.
    pub fn driver(&mut self, time_ns: u64, words: &DriverWords) -> Result<(), LogError> {
        self.write_rarely(time_ns, words)
    }

    /// Writes what clients asked and were answered; a log of a robot without clients has no such channel.
    pub fn asked(&mut self, time_ns: u64, asked: &Asked) -> Result<(), LogError> {
        self.story.asked(asked);
        self.write_rarely(time_ns, asked)
    }

    fn write_rarely<C: Channel>(&mut self, time_ns: u64, record: &C) -> Result<(), LogError> {
        if !self.channels.by_topic.contains_key(C::TOPIC) {
            self.channels.add_record::<C>()?;
        }
        self.channels.write(time_ns, record)
    }

    /// Writes one read of a Touch Board's port; a board beyond the last channel has none.
    pub fn serial(&mut self, serial: &SerialBytes) -> Result<(), LogError> {
        self.summary.serial_bytes += serial.bytes.len() as u64;
        match SERIAL_TOPICS.get(usize::from(serial.board)) {
            Some(topic) => self.channels.write_bytes(topic, serial.arrival_ns, &serial.bytes),
            None => Ok(()),
        }
    }

    /// Ends the present chunk and hands it to the operating system.
    pub fn flush(&mut self) -> Result<(), LogError> {
        self.chunk_ns = None;
        Ok(self.channels.file.flush()?)
    }

    /// Writes story, overview, index and end mark. A log that is dropped instead ends as if it had been cut there.
    pub fn finish(mut self) -> Result<LogSummary, LogError> {
        self.flush()?;
        self.tell()?;
        let data = serde_json::to_vec(self.overview.overview())?;
        self.attach(OVERVIEW, "application/json", &data)?;
        self.channels.file.finish()?;
        Ok(self.summary)
    }

    fn attach(&mut self, name: &str, media_type: &str, data: &[u8]) -> Result<(), LogError> {
        Ok(self.channels.file.attach(self.channels.start_unix_ns, name, media_type, data)?)
    }
}

impl<W: Write> Channels<W> {
    fn add(&mut self, schema: u16, topic: &'static str, encoding: &str) {
        let channel = self.file.add_channel(schema, topic, encoding);
        self.by_topic.insert(topic, (channel, Purpose::of(topic)));
    }

    fn add_record<C: Channel>(&mut self) -> Result<(), LogError> {
        let name = format!("moca{}", C::TOPIC.replace('/', "."));
        let schema = self.file.add_schema(&name, "jsonschema", &C::schema()?);
        self.add(schema, C::TOPIC, "json");
        Ok(())
    }

    fn write<C: Channel>(&mut self, time_ns: u64, record: &C) -> Result<(), LogError> {
        let mut json = std::mem::take(&mut self.json);
        json.clear();
        let written = serde_json::to_writer(&mut json, record).map_err(LogError::from);
        let written = written.and_then(|()| self.write_bytes(C::TOPIC, time_ns, &json));
        self.json = json;
        written
    }

    fn write_bytes(&mut self, topic: &str, time_ns: u64, bytes: &[u8]) -> Result<(), LogError> {
        let Some((channel, purpose)) = self.by_topic.get(topic) else {
            return Ok(()); // Every channel is added before it is written.
        };
        Ok(self.file.message(*purpose, *channel, self.start_unix_ns.saturating_add(time_ns), bytes)?)
    }
}

/// Records as JSON, which this crate reads back; messages that only viewers read as ROS 2 has them.
impl<W: Write> Sink for Channels<W> {
    fn offer_record<C: Channel + Message>(&mut self) -> Result<(), LogError> {
        self.add_record::<C>()
    }

    fn offer<M: Message>(&mut self, topic: &'static str) -> Result<(), LogError> {
        let schema = self.file.add_schema(M::TYPE.0, "ros2msg", ros::definition::<M>().as_bytes());
        self.add(schema, topic, "cdr");
        Ok(())
    }

    fn record<C: Channel + Message>(&mut self, time_ns: u64, record: &C) -> Result<(), LogError> {
        self.write(time_ns, record)
    }

    fn message<M: Message>(
        &mut self,
        topic: &'static str,
        time_ns: u64,
        message: &M,
    ) -> Result<(), LogError> {
        let mut cdr = std::mem::take(&mut self.cdr);
        let written = self.write_bytes(topic, time_ns, cdr.encode(message));
        self.cdr = cdr;
        written
    }
}
