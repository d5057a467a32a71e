//! An MCAP file in, samples and bytes out, whole or cut.

use super::{
    LogError, SerialBytes,
    records::{
        BoardChange, Channel, Command, Configuration, Contact, Cover, FaultChange, ModeChange, Replay, Robot,
        Serial, State, Timing,
    },
};
use crate::RobotDescription;
use mcap::{McapResult, Message, io::MessageReader, sans_io::LinearReaderOptions};
use moca_msgs::{Fault, Mode, Sample, TaxelReading, board::Diagnosis};
use serde::de::DeserializeOwned;
use std::{
    fs::File,
    io::{BufReader, Read, Seek, SeekFrom},
    path::Path,
};

/// One entry of a log.
#[derive(Clone, Debug, PartialEq)]
pub enum Record {
    /// One tick.
    Sample(Box<Sample>),
    /// One read of the Touch Board's port.
    Serial(SerialBytes),
    /// What a replay needs of one tick.
    Replay {
        /// Tick count.
        tick: u64,
        /// The daemon's own record.
        bytes: Vec<u8>,
    },
    /// How the run was configured.
    Configuration(Box<Configuration>),
}

/// A whole log in memory: about 1.5 KB a sample.
#[derive(Clone, Debug, Default)]
pub struct Log {
    /// The robot.
    pub description: RobotDescription,
    /// Unix time of loop time 0, ns.
    pub start_unix_ns: u64,
    /// Every sample.
    pub samples: Vec<Sample>,
    /// Every read of the Touch Board's port.
    pub serial: Vec<SerialBytes>,
    /// Where the file breaks off and why, if it is not whole.
    pub cut: Option<String>,
}

/// Reads a log entry by entry; memory is bounded by one chunk.
pub struct LogReader {
    messages: MessageReader<BufReader<File>>,
    description: RobotDescription,
    start_unix_ns: u64,
    mode: Mode,
    fault: Option<Fault>,
    board: Diagnosis,
    partial: Partial,
    ended_well: bool,
    cut: Option<String>,
}

/// The messages of one tick as they come in.
#[derive(Default)]
struct Partial {
    state: Option<State>,
    command: Option<Command>,
    cover: Option<Cover>,
    contacts: Vec<Contact>,
}

/// Reads all of a log. A log that was cut gives everything up to its last whole chunk, and says so in `cut`.
pub fn read_log(path: &Path) -> Result<Log, LogError> {
    let mut reader = LogReader::open(path)?;
    let mut log = Log::default();
    for record in &mut reader {
        match record {
            Record::Sample(sample) => log.samples.push(*sample),
            Record::Serial(serial) => log.serial.push(serial),
            Record::Replay { .. } | Record::Configuration(_) => {}
        }
    }
    log.description = reader.description;
    log.start_unix_ns = reader.start_unix_ns;
    log.cut = reader.cut;
    Ok(log)
}

impl LogReader {
    /// Opens a log.
    pub fn open(path: &Path) -> Result<Self, LogError> {
        let open = |source| LogError::Open { path: path.into(), source };
        let mut file = File::open(path).map_err(open)?;
        let mut magic = [0; mcap::MAGIC.len()];
        if file.read_exact(&mut magic).is_err() || magic != mcap::MAGIC {
            return Err(LogError::NotMcap(path.into()));
        }
        let length = file.seek(SeekFrom::End(0)).map_err(open)?;
        file.seek(SeekFrom::Start(length - magic.len() as u64)).map_err(open)?;
        file.read_exact(&mut magic).map_err(open)?;
        file.rewind().map_err(open)?;
        // Validated before it is read, a damaged chunk gives nothing rather than something wrong.
        let options = LinearReaderOptions::default()
            .with_skip_end_magic(true)
            .with_validate_chunk_crcs(true)
            .with_prevalidate_chunk_crcs(true);
        Ok(Self {
            messages: MessageReader::new_with_options(BufReader::new(file), options),
            description: RobotDescription::default(),
            start_unix_ns: 0,
            mode: Mode::default(),
            fault: None,
            board: Diagnosis::default(),
            partial: Partial::default(),
            ended_well: length > magic.len() as u64 && magic == mcap::MAGIC,
            cut: None,
        })
    }

    /// The robot, known from the first entry on.
    pub fn description(&self) -> &RobotDescription {
        &self.description
    }

    /// Why the log ended before its end, once the iterator has.
    pub fn cut(&self) -> Option<&str> {
        self.cut.as_deref()
    }

    fn take(&mut self, message: &Message<'_>) -> Result<Option<Record>, serde_json::Error> {
        match message.channel.topic.as_str() {
            Robot::TOPIC => {
                let robot: Robot = parse(message)?;
                self.start_unix_ns = robot.start_unix_ns;
                self.description = serde_json::from_str(&robot.json)?;
            }
            ModeChange::TOPIC => self.mode = parse::<ModeChange>(message)?.mode,
            FaultChange::TOPIC => self.fault = parse::<FaultChange>(message)?.fault()?,
            BoardChange::TOPIC => self.board = parse::<BoardChange>(message)?.board()?,
            State::TOPIC => self.partial.state = Some(parse(message)?),
            Command::TOPIC => self.partial.command = Some(parse(message)?),
            Cover::TOPIC => self.partial.cover = Some(parse(message)?),
            Contact::TOPIC => self.partial.contacts.push(parse(message)?),
            Timing::TOPIC => return Ok(self.complete(message.log_time, &parse(message)?)),
            Serial::TOPIC => return Ok(Some(Record::Serial(serial(&parse(message)?)))),
            Replay::TOPIC => {
                let replay: Replay = parse(message)?;
                return Ok(Some(Record::Replay { tick: replay.tick, bytes: bytes(&replay.hex) }));
            }
            Configuration::TOPIC => return Ok(Some(Record::Configuration(Box::new(parse(message)?)))),
            _ => {} // Channels that others have added are not ours to judge.
        }
        Ok(None)
    }

    /// The sample, if all messages of its tick are there; `Timing` is the last one written.
    fn complete(&mut self, log_time: u64, timing: &Timing) -> Option<Record> {
        let Partial { state, command, cover, contacts } = std::mem::take(&mut self.partial);
        let (state, command, cover) = (state?, command?, cover?);
        if [state.tick, command.tick, cover.tick] != [timing.tick; 3] {
            return None;
        }
        let (speed_limit, contact_reaction) = (command.speed_limit(), command.contact_reaction());
        let events = contacts.iter().filter(|contact| contact.tick == timing.tick).map(Contact::event);
        let readings = cover.force_n.iter().zip(&cover.status);
        Some(Record::Sample(Box::new(Sample {
            tick: timing.tick,
            time_ns: log_time.saturating_sub(self.start_unix_ns),
            mode: self.mode,
            fault: self.fault,
            base_pose_world: state.base_pose_world,
            base_velocity_world: state.base_velocity_world,
            cover_speed_m_s: state.cover_speed_m_s,
            base_velocity_command_body: command.base_velocity_body,
            q_rad: bounded(state.q_rad),
            dq_rad_s: bounded(state.dq_rad_s),
            arm_torque_nm: bounded(command.arm_torque_nm),
            flange_position_world: state.flange_position_world,
            flange_quaternion_world: state.flange_quaternion_world,
            flange_desired_position_world: state.flange_desired_position_world,
            flange_desired_quaternion_world: state.flange_desired_quaternion_world,
            flange_wrench_world: state.flange_wrench_world,
            cover_wrench_base: cover.wrench_base,
            taxels: bounded(readings.map(|(&force_n, &status)| TaxelReading { force_n, status })),
            counts: bounded(cover.counts),
            frame_age_s: cover.frame_age_s,
            frame_rate_hz: cover.frame_rate_hz,
            frames_good: timing.frames_good,
            frames_bad: timing.frames_bad,
            board: self.board,
            speed_limit,
            contact_reaction,
            contact_events: bounded(events),
            lateness_s: timing.lateness_s,
            overruns: timing.overruns,
            stages_ns: timing.stages_ns,
        })))
    }
}

impl Iterator for LogReader {
    type Item = Record;

    fn next(&mut self) -> Option<Record> {
        if self.cut.is_some() {
            return None;
        }
        loop {
            let message: Option<McapResult<Message<'_>>> = self.messages.next();
            let damage = match message {
                Some(Ok(message)) => match self.take(&message) {
                    Ok(Some(record)) => return Some(record),
                    Ok(None) => continue,
                    Err(error) => format!("a message of {} is not ours: {error}", message.channel.topic),
                },
                Some(Err(error)) => format!("the file breaks off or is damaged: {error}"),
                None if self.ended_well => return None,
                None => "the file breaks off after a whole chunk".into(),
            };
            self.cut = Some(damage);
            return None;
        }
    }
}

/// As many as a sample holds: a file from elsewhere may have more.
fn bounded<T, const N: usize>(values: impl IntoIterator<Item = T>) -> heapless::Vec<T, N> {
    values.into_iter().take(N).collect()
}

fn parse<C: DeserializeOwned>(message: &Message<'_>) -> Result<C, serde_json::Error> {
    serde_json::from_slice(&message.data)
}

fn serial(record: &Serial) -> SerialBytes {
    SerialBytes { arrival_ns: record.arrival_ns, bytes: bytes(&record.hex) }
}

/// Digits that are not hexadecimal, which this library never writes, end the bytes.
fn bytes(hex: &str) -> Vec<u8> {
    let digits = hex.as_bytes().chunks_exact(2);
    let byte = |pair: &[u8]| u8::from_str_radix(std::str::from_utf8(pair).ok()?, 16).ok();
    digits.map_while(byte).collect()
}
