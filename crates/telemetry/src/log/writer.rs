//! Samples and bytes in, an MCAP file out.

use super::{
    LogError, SerialBytes,
    records::{
        BoardChange, Channel, Command, Configuration, Contact, Cover, FaultChange, ModeChange,
        ParameterChange, Replay, Robot, Serial, State, Timing, name_of,
    },
};
use crate::RobotDescription;
use mcap::{
    Compression, WriteOptions,
    records::MessageHeader,
    write::{NoSeek, Writer},
};
use moca_msgs::{Fault, Mode, Sample, board::Diagnosis};
use std::{collections::BTreeMap, io::Write};

/// Messages of one chunk, bytes before compression: what a cut can lose, about 0.15 s at 1 kHz.
const CHUNK_BYTES: u64 = 256 * 1024;

/// What a log says about itself.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Meta {
    /// The robot.
    pub description: RobotDescription,
    /// Unix time of loop time 0, ns; 0 for a run that has no place in time.
    pub start_unix_ns: u64,
}

/// What has been written so far.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct LogSummary {
    /// Samples.
    pub samples: u64,
    /// Bytes of the Touch Board.
    pub serial_bytes: u64,
    /// Serial reads that found no room on their way to the recorder.
    pub serial_dropped: u64,
}

/// Writes a log to `W`. Each channel's messages are in order of time.
pub struct LogWriter<W: Write> {
    mcap: Writer<NoSeek<W>>,
    channels: BTreeMap<&'static str, u16>,
    start_unix_ns: u64,
    last: Option<(Mode, Option<Fault>, Diagnosis)>,
    json: Vec<u8>,
    summary: LogSummary,
}

impl<W: Write> LogWriter<W> {
    /// Starts a log: header, schemas and the robot's description go out at once.
    pub fn new(output: W, meta: &Meta) -> Result<Self, LogError> {
        // A writer that may not seek keeps a chunk in memory until it is whole.
        let options = WriteOptions::new()
            .library(concat!("moca-telemetry ", env!("CARGO_PKG_VERSION")))
            .compression(Some(Compression::Lz4))
            .chunk_size(Some(CHUNK_BYTES))
            .disable_seeking(true);
        let mut log = Self {
            mcap: options.create(NoSeek::new(output))?,
            channels: BTreeMap::new(),
            start_unix_ns: meta.start_unix_ns,
            last: None,
            json: Vec::new(),
            summary: LogSummary::default(),
        };
        log.add::<Robot>()?;
        log.add::<State>()?;
        log.add::<Command>()?;
        log.add::<Cover>()?;
        log.add::<Timing>()?;
        log.add::<ModeChange>()?;
        log.add::<FaultChange>()?;
        log.add::<BoardChange>()?;
        log.add::<Contact>()?;
        log.add::<Serial>()?;
        log.add::<Replay>()?;
        log.add::<ParameterChange>()?;
        log.add::<Configuration>()?;
        let json = serde_json::to_string(&meta.description)?;
        let name = meta.description.name.clone();
        log.write(0, &Robot { start_unix_ns: meta.start_unix_ns, name, json })?;
        log.flush()?;
        Ok(log)
    }

    /// Writes one sample: what changed or happened, then state, command, cover and timing.
    pub fn sample(&mut self, sample: &Sample) -> Result<(), LogError> {
        let (tick, time_ns) = (sample.tick, sample.time_ns);
        let last = self.last.replace((sample.mode, sample.fault, sample.board));
        if last.is_none_or(|(mode, ..)| mode != sample.mode) {
            self.write(time_ns, &ModeChange { tick, mode: sample.mode })?;
        }
        if last.and_then(|(_, fault, _)| fault) != sample.fault {
            self.write(time_ns, &FaultChange::new(tick, sample.fault)?)?;
        }
        if last.is_none_or(|(.., board)| board != sample.board) {
            self.write(time_ns, &BoardChange::new(tick, sample.board)?)?;
        }
        for event in &sample.contact_events {
            self.write(time_ns, &Contact::new(tick, event))?;
        }
        self.write(time_ns, &state(sample))?;
        self.write(
            time_ns,
            &Command {
                tick,
                base_velocity_body: sample.base_velocity_command_body,
                arm_torque_nm: sample.arm_torque_nm.to_vec(),
                speed_limit_m_s: sample.speed_limit.m_s,
                speed_limit_reason: sample.speed_limit.reason,
                contact_reaction: name_of(sample.contact_reaction),
            },
        )?;
        self.write(time_ns, &cover(sample))?;
        self.write(
            time_ns,
            &Timing {
                tick,
                lateness_s: sample.lateness_s,
                overruns: sample.overruns,
                stages_ns: sample.stages_ns,
                frames_good: sample.frames_good,
                frames_bad: sample.frames_bad,
            },
        )?;
        self.summary.samples += 1;
        Ok(())
    }

    /// Writes how the run is configured.
    pub fn configuration(&mut self, configuration: &Configuration) -> Result<(), LogError> {
        self.write(0, configuration)?;
        self.flush()
    }

    /// Writes what a replay needs of one tick.
    pub fn replay(&mut self, time_ns: u64, tick: u64, bytes: &[u8]) -> Result<(), LogError> {
        self.write(time_ns, &Replay { tick, hex: hex(bytes) })
    }

    /// Writes a change of a parameter.
    pub fn parameter(&mut self, time_ns: u64, change: &ParameterChange) -> Result<(), LogError> {
        self.write(time_ns, change)
    }

    /// Writes one read of the Touch Board's port.
    pub fn serial(&mut self, serial: &SerialBytes) -> Result<(), LogError> {
        let hex = hex(&serial.bytes);
        self.summary.serial_bytes += serial.bytes.len() as u64;
        self.write(serial.arrival_ns, &Serial { arrival_ns: serial.arrival_ns, hex })
    }

    /// Notes serial reads that were lost before they came here.
    pub(super) fn note_serial_dropped(&mut self, dropped: u64) {
        self.summary.serial_dropped = dropped;
    }

    /// Ends the present chunk and hands it to the operating system.
    pub fn flush(&mut self) -> Result<(), LogError> {
        Ok(self.mcap.flush()?)
    }

    /// Writes index and end mark. A log that is dropped instead is finished too, but without a word if that fails.
    pub fn finish(mut self) -> Result<LogSummary, LogError> {
        self.mcap.finish()?;
        self.mcap.into_inner().into_inner().flush().map_err(mcap::McapError::from)?;
        Ok(self.summary)
    }

    fn add<C: Channel>(&mut self) -> Result<(), LogError> {
        let name = format!("moca{}", C::TOPIC.replace('/', "."));
        let schema = self.mcap.add_schema(&name, "jsonschema", &C::schema()?)?;
        let channel = self.mcap.add_channel(schema, C::TOPIC, "json", &BTreeMap::new())?;
        self.channels.insert(C::TOPIC, channel);
        Ok(())
    }

    fn write<C: Channel>(&mut self, time_ns: u64, record: &C) -> Result<(), LogError> {
        let Some(&channel_id) = self.channels.get(C::TOPIC) else {
            return Ok(()); // Every channel is added by `new`.
        };
        self.json.clear();
        serde_json::to_writer(&mut self.json, record)?;
        let time = self.start_unix_ns.saturating_add(time_ns);
        let header = MessageHeader { channel_id, sequence: 0, log_time: time, publish_time: time };
        Ok(self.mcap.write_to_known_channel(&header, &self.json)?)
    }
}

/// Two digits a byte.
fn hex(bytes: &[u8]) -> String {
    let digit = |nibble: u8| char::from(b"0123456789abcdef"[usize::from(nibble & 15)]);
    bytes.iter().flat_map(|byte| [digit(byte >> 4), digit(*byte)]).collect()
}

fn state(sample: &Sample) -> State {
    State {
        tick: sample.tick,
        base_pose_world: sample.base_pose_world,
        base_velocity_world: sample.base_velocity_world,
        cover_speed_m_s: sample.cover_speed_m_s,
        q_rad: sample.q_rad.to_vec(),
        dq_rad_s: sample.dq_rad_s.to_vec(),
        flange_position_world: sample.flange_position_world,
        flange_quaternion_world: sample.flange_quaternion_world,
        flange_desired_position_world: sample.flange_desired_position_world,
        flange_desired_quaternion_world: sample.flange_desired_quaternion_world,
        flange_wrench_world: sample.flange_wrench_world,
    }
}

fn cover(sample: &Sample) -> Cover {
    Cover {
        tick: sample.tick,
        force_n: sample.taxels.iter().map(|t| t.force_n).collect(),
        status: sample.taxels.iter().map(|t| t.status).collect(),
        counts: sample.counts.to_vec(),
        wrench_base: sample.cover_wrench_base,
        frame_age_s: sample.frame_age_s,
        frame_rate_hz: sample.frame_rate_hz,
    }
}
