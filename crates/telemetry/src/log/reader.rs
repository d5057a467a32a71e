//! An MCAP file in, samples and bytes out, whole, cut or damaged.

use super::{
    LogError, SerialBytes,
    framing::{self, Fields, MAGIC, Message, Records, op},
    records::{
        BoardChange, Channel, Command, Configuration, Contact, Cover, FaultChange, Gripper, LOOP_STATE_TOPIC,
        Link, ModeChange, REPLAY_TOPIC, Robot, SERIAL_TOPICS, State, Target, Timing, bounded,
    },
    writer::{FORM, FORMS, LIBRARY},
};
use crate::{RobotDescription, audit::Asked};
use moca_msgs::{Fault, Mode, Sample, board::Diagnosis};
use serde::{Deserialize, de::DeserializeOwned};
use std::{
    borrow::Cow,
    collections::{BTreeMap, VecDeque},
    fs::File,
    io::{BufReader, Read, Seek, SeekFrom},
    path::Path,
    sync::Arc,
};

/// One entry of a log.
#[derive(Clone, Debug, PartialEq)]
pub enum Record {
    /// Sample of one tick for a viewer, numbers with seven digits.
    Sample(Box<Sample>),
    /// One read of the Touch Board's port.
    Serial(SerialBytes),
    /// A block of what ticks were given, in the daemon's own form.
    Replay(Vec<u8>),
    /// Memory of the loop where a log begins in the middle of a run, in the daemon's own form.
    LoopState(Vec<u8>),
    /// Configuration of the run.
    Configuration(Box<Configuration>),
    /// Requests of clients and their answer, and when, ns of loop time.
    Asked(u64, Box<Asked>),
}

/// Contents of a whole log for a viewer, in memory: about 75 KB for each second of it.
#[derive(Clone, Debug, Default)]
pub struct Log {
    /// The robot.
    pub description: RobotDescription,
    /// Unix time of loop time 0, ns.
    pub start_unix_ns: u64,
    /// Samples for a viewer, tick by tick.
    pub samples: Vec<Sample>,
    /// Every read of the Touch Board's port.
    pub serial: Vec<SerialBytes>,
    /// Place and reason of the break, if the file is not whole.
    pub cut: Option<String>,
}

/// Reads a log entry by entry; memory is bounded by one chunk.
pub struct LogReader {
    records: Records<Input>,
    decoder: Decoder,
    /// Entries of the present chunk.
    ready: VecDeque<Record>,
    chunks_read: u64,
    ended_well: bool,
    done: bool,
    cut: Option<String>,
}

/// Reads what a viewer shows of a log. One that is cut or damaged gives everything before that, and says so in `cut`.
pub fn read_log(path: &Path) -> Result<Log, LogError> {
    let mut reader = LogReader::open(path)?;
    let mut log = Log::default();
    for record in &mut reader {
        match record {
            Record::Sample(sample) => log.samples.push(*sample),
            Record::Serial(serial) => log.serial.push(serial),
            Record::Replay(_) | Record::LoopState(_) | Record::Configuration(_) | Record::Asked(..) => {}
        }
    }
    log.start_unix_ns = reader.decoder.start_unix_ns;
    log.description = reader.decoder.description;
    log.cut = reader.cut;
    Ok(log)
}

impl LogReader {
    /// Opens a log.
    ///
    /// # Errors
    /// The file cannot be read, is no MCAP file, or a log of another form, which is named.
    pub fn open(path: &Path) -> Result<Self, LogError> {
        Self::over(open_file(path)?, path)
    }

    /// Opens anything that holds the bytes of a log; `path` names it in errors.
    ///
    /// # Errors
    /// As for [`Self::open`].
    pub fn over(input: impl Read + Seek + Send + 'static, path: &Path) -> Result<Self, LogError> {
        let Begun { records, ended_well, .. } = begin(input, path)?;
        Ok(Self {
            records,
            decoder: Decoder::default(),
            ready: VecDeque::new(),
            chunks_read: 0,
            ended_well,
            done: false,
            cut: None,
        })
    }

    /// The robot, known from the first entry on.
    pub fn description(&self) -> &RobotDescription {
        &self.decoder.description
    }

    /// Returns the share of the file that has been read, 0 to 1.
    #[expect(clippy::cast_precision_loss, reason = "a share of a file")]
    pub fn part_read(&self) -> f64 {
        self.records.at() as f64 / self.records.end().max(1) as f64
    }

    /// Why the log ended before its end, and how much of the file is missing, once the iterator has ended.
    pub fn cut(&self) -> Option<&str> {
        self.cut.as_deref()
    }

    /// Reads one more chunk; `false` at the end of the messages.
    fn read_chunk(&mut self) -> Result<bool, String> {
        let record = self.records.next(|kind| matches!(kind, op::CHUNK | op::DATA_END | op::FOOTER))?;
        if record.op != op::CHUNK {
            return self.compare_with_index().map(|()| false);
        }
        let chunk = framing::chunk(record.body)?;
        self.chunks_read += 1;
        self.decoder.decode(&chunk, &mut |record| self.ready.push_back(record))?;
        Ok(true)
    }
}

impl LogReader {
    /// Behind the last chunk: whether the index lists as many as were found.
    fn compare_with_index(&mut self) -> Result<(), String> {
        if !self.ended_well {
            return Err("the file breaks off in its index".into());
        }
        let mut listed = 0;
        while self.records.next(|kind| matches!(kind, op::CHUNK_INDEX | op::FOOTER))?.op == op::CHUNK_INDEX {
            listed += 1;
        }
        let found = self.chunks_read;
        // a file need not have an index
        if listed == found || listed == 0 {
            Ok(())
        } else {
            Err(format!("{found} of {listed} chunks were found"))
        }
    }
}

impl Iterator for LogReader {
    type Item = Record;

    fn next(&mut self) -> Option<Record> {
        while self.ready.is_empty() && !self.done {
            let before = self.records.at();
            match self.read_chunk() {
                Ok(more) => self.done = !more,
                Err(why) => {
                    self.done = true;
                    let missing = self.records.end() - before;
                    self.cut = Some(format!("{why}; the last {missing} bytes of the file are not read"));
                }
            }
        }
        self.ready.pop_front()
    }
}

/// Input of a log.
pub(super) type Input = BufReader<Box<dyn ReadSeek>>;

/// Bytes that are read anywhere.
pub(super) trait ReadSeek: Read + Seek + Send {}

impl<T: Read + Seek + Send> ReadSeek for T {}

/// A file; a FIFO, a device or a folder is none, and would never end.
pub(super) fn open_file(path: &Path) -> Result<File, LogError> {
    let open = |cause| LogError::Open { path: path.into(), cause };
    if !std::fs::metadata(path).map_err(open)?.is_file() {
        return Err(LogError::NotMcap(path.into()));
    }
    File::open(path).map_err(open)
}

/// Begin and end of a log.
pub(super) struct Begun {
    /// Its records, the header first.
    pub(super) records: Records<Input>,
    /// True if it ends as an MCAP file should.
    pub(super) ended_well: bool,
    /// True if this library wrote it: its chunks then can be read in any order.
    pub(super) by_us: bool,
}

/// Opens a log, or says in one sentence why it is none.
pub(super) fn begin(input: impl Read + Seek + Send + 'static, path: &Path) -> Result<Begun, LogError> {
    let open = |cause| LogError::Open { path: path.into(), cause };
    let mut input: Input = BufReader::new(Box::new(input));
    let mut magic = [0; MAGIC.len()];
    if input.read_exact(&mut magic).is_err() || magic != MAGIC {
        return Err(LogError::NotMcap(path.into()));
    }
    let start = magic.len() as u64;
    let length = input.seek(SeekFrom::End(0)).map_err(open)?;
    input.seek(SeekFrom::Start(length - start)).map_err(open)?;
    input.read_exact(&mut magic).map_err(open)?;
    let ended_well = length > start && magic == MAGIC;
    let mut records = Records::new(input, start).map_err(open)?;
    let by_us = header(&mut records, path)?;
    first_chunk(&mut records, path)?;
    records.seek(start).map_err(open)?;
    Ok(Begun { records, ended_well, by_us })
}

/// Returns true if this library wrote the file, if its header is that of a log.
fn header(records: &mut Records<Input>, path: &Path) -> Result<bool, LogError> {
    let nothing = LogError::Nothing { path: path.into(), why: "ends within its header" };
    let Ok(header) = records.next(|_| true) else { return Err(nothing) };
    if header.op != op::HEADER {
        return Err(LogError::NotMcap(path.into()));
    }
    let mut fields = Fields(header.body);
    let (Some(form), Some(library)) = (fields.text(), fields.text()) else { return Err(nothing) };
    match form {
        FORM => Ok(library.starts_with(LIBRARY)),
        _ if form.starts_with(FORMS) => Err(LogError::OtherForm { path: path.into(), theirs: form.into() }),
        _ => Err(LogError::OtherProfile { path: path.into(), profile: form.into() }),
    }
}

/// Fails unless the first messages lie in a chunk that can be read.
fn first_chunk(records: &mut Records<Input>, path: &Path) -> Result<(), LogError> {
    let wanted = |kind| matches!(kind, op::CHUNK | op::MESSAGE | op::DATA_END | op::FOOTER);
    let why = match records.next(wanted) {
        Ok(framing::Record { op: op::CHUNK, body }) => {
            return framing::unread_compression(body).map_or(Ok(()), |compression| {
                Err(LogError::OtherCompression { path: path.into(), compression: compression.into() })
            });
        }
        Ok(framing::Record { op: op::MESSAGE, .. }) => return Err(LogError::NotInChunks(path.into())),
        Ok(_) => "holds no messages",
        Err(_) => "ends within its first chunk",
    };
    Err(LogError::Nothing { path: path.into(), why })
}

/// Turns messages into entries; remembers what later messages leave unsaid.
#[derive(Clone, Default)]
pub(super) struct Decoder {
    topics: BTreeMap<u16, Arc<str>>,
    /// Topics of the records whose fields are wanted; `None`: all.
    pub(super) wanted: Option<Vec<&'static str>>,
    pub(super) description: RobotDescription,
    pub(super) start_unix_ns: u64,
    pub(super) carried: Carried,
}

/// State that a message leaves out because earlier ones hold it.
#[derive(Clone, Default)]
pub(super) struct Carried {
    mode: Mode,
    fault: Option<Fault>,
    board: Diagnosis,
    partial: Partial,
}

/// The messages of one tick as they come in.
#[derive(Clone, Default)]
struct Partial {
    state: Held<State>,
    command: Held<Command>,
    cover: Held<Cover>,
    contacts: Vec<Contact>,
    link: Option<Link>,
    target: Option<Target>,
    gripper: Option<Gripper>,
}

/// A record of a sample and its tick; only its tick, if its fields are not wanted.
type Held<C> = Option<(u64, Option<C>)>;

impl Decoder {
    /// Learns the topics of channels.
    pub(super) fn name(&mut self, topics: &BTreeMap<u16, Cow<'_, str>>) {
        self.topics.extend(topics.iter().map(|(channel, topic)| (*channel, topic.as_ref().into())));
    }

    /// Hands over every entry of a chunk, up to the first foreign message.
    pub(super) fn decode(&mut self, chunk: &[u8], entry: &mut dyn FnMut(Record)) -> Result<(), String> {
        for record in framing::records_in(chunk) {
            match record.op {
                op::CHANNEL => {
                    let (number, topic) = framing::channel(record.body).ok_or("a channel is damaged")?;
                    self.topics.insert(number, topic.into());
                }
                op::MESSAGE => {
                    let message = Message::parse(record.body).ok_or("a message is damaged")?;
                    // Channels that others have added are not ours to judge.
                    let Some(topic) = self.topics.get(&message.channel).cloned() else { continue };
                    let taken = self.take(&topic, &message);
                    if let Some(taken) =
                        taken.map_err(|error| format!("a message of {topic} is not ours: {error}"))?
                    {
                        entry(taken);
                    }
                }
                _ => {}
            }
        }
        Ok(())
    }

    fn take(&mut self, topic: &str, message: &Message<'_>) -> Result<Option<Record>, serde_json::Error> {
        match topic {
            Robot::TOPIC => {
                let robot: Robot = parse(message)?;
                self.start_unix_ns = robot.start_unix_ns;
                self.description = serde_json::from_str(&robot.json)?;
            }
            ModeChange::TOPIC => self.carried.mode = parse::<ModeChange>(message)?.mode,
            FaultChange::TOPIC => {
                self.carried.fault = parse::<FaultChange>(message)?.fault()?;
            }
            BoardChange::TOPIC => self.carried.board = parse::<BoardChange>(message)?.board()?,
            State::TOPIC => self.carried.partial.state = self.held::<State>(message)?,
            Command::TOPIC => self.carried.partial.command = self.held::<Command>(message)?,
            Link::TOPIC => self.carried.partial.link = Some(parse(message)?),
            Target::TOPIC => self.carried.partial.target = Some(parse(message)?),
            Gripper::TOPIC => self.carried.partial.gripper = Some(parse(message)?),
            Cover::TOPIC => self.carried.partial.cover = self.held::<Cover>(message)?,
            Contact::TOPIC => self.carried.partial.contacts.push(parse(message)?),
            Timing::TOPIC => {
                let timing = self.held::<Timing>(message)?;
                return Ok(self.complete(message.time_ns, timing));
            }
            LOOP_STATE_TOPIC => return Ok(Some(Record::LoopState(message.data.to_vec()))),
            REPLAY_TOPIC => return Ok(Some(Record::Replay(message.data.to_vec()))),
            Configuration::TOPIC => return Ok(Some(Record::Configuration(Box::new(parse(message)?)))),
            Asked::TOPIC => {
                let time_ns = message.time_ns.saturating_sub(self.start_unix_ns);
                return Ok(Some(Record::Asked(time_ns, Box::new(parse(message)?))));
            }
            _ => {
                let board = (0u8..).zip(SERIAL_TOPICS).find_map(|(board, of)| (of == topic).then_some(board));
                let arrival_ns = message.time_ns.saturating_sub(self.start_unix_ns);
                let bytes = || message.data.to_vec();
                return Ok(
                    board.map(|board| Record::Serial(SerialBytes { board, arrival_ns, bytes: bytes() }))
                );
            }
        }
        Ok(None)
    }

    /// Reads a record of a sample, or only its tick.
    fn held<C: Channel + DeserializeOwned>(
        &self,
        message: &Message<'_>,
    ) -> Result<Held<C>, serde_json::Error> {
        let tick = match tick_of(message.data) {
            Some(tick) => tick,
            None => parse::<Ticked>(message)?.tick,
        };
        let is_wanted = self.wanted.as_ref().is_none_or(|wanted| wanted.contains(&C::TOPIC));
        Ok(Some((tick, if is_wanted { Some(parse(message)?) } else { None })))
    }

    /// The sample, if all messages of its tick are there; `Timing` is the last one written.
    fn complete(&mut self, log_time: u64, timing: Held<Timing>) -> Option<Record> {
        let Partial { state, command, cover, contacts, link, target, gripper } =
            std::mem::take(&mut self.carried.partial);
        let ((tick, timing), (of_state, state)) = (timing?, state?);
        let ((of_command, command), (of_cover, cover)) = (command?, cover?);
        if [of_state, of_command, of_cover] != [tick; 3] {
            return None;
        }
        let events = contacts.iter().filter(|contact| contact.tick == tick).map(Contact::event);
        let mut sample = Sample {
            tick,
            time_ns: log_time.saturating_sub(self.start_unix_ns),
            mode: self.carried.mode,
            fault: self.carried.fault,
            board: self.carried.board,
            contact_events: bounded(events),
            target: target.filter(|target| target.tick == tick).map(|target| target.state()),
            gripper: gripper.filter(|gripper| gripper.tick == tick).map(|gripper| gripper.state()),
            link: link.filter(|link| link.tick == tick).map(|link| link.link()),
            ..Sample::default()
        };
        state.into_iter().for_each(|state| state.give(&mut sample));
        command.into_iter().for_each(|command| command.give(&mut sample));
        cover.into_iter().for_each(|cover| cover.give(&mut sample));
        timing.into_iter().for_each(|timing| timing.give(&mut sample));
        Some(Record::Sample(Box::new(sample)))
    }
}

/// A record of which only the tick is read.
#[derive(Deserialize)]
struct Ticked {
    tick: u64,
}

/// The tick of a record as this library writes it: its first field.
fn tick_of(json: &[u8]) -> Option<u64> {
    let digits = json.strip_prefix(b"{\"tick\":")?;
    let end = digits.iter().position(|byte| !byte.is_ascii_digit())?;
    std::str::from_utf8(&digits[..end]).ok()?.parse().ok()
}

fn parse<C: DeserializeOwned>(message: &Message<'_>) -> Result<C, serde_json::Error> {
    serde_json::from_slice(message.data)
}
