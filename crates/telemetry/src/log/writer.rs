//! Samples and bytes in, an MCAP file out.

use super::{
    LogError, SerialBytes,
    overview::OverviewBuilder,
    records::{
        BoardChange, Channel, Command, Configuration, Contact, Cover, FaultChange, LOOP_STATE_TOPIC, Link,
        ModeChange, ParameterChange, REPLAY_TOPIC, Robot, SERIAL_TOPICS, State, Timing, name_of,
        seven_digits,
    },
};
use crate::RobotDescription;
use mcap::{
    Attachment, Compression, WriteOptions,
    records::MessageHeader,
    write::{NoSeek, Writer},
};
use moca_msgs::{Fault, Mode, STAGES, Sample, board::Diagnosis};
use std::{collections::BTreeMap, io::Write};

/// Number that a channel of bytes has where others have their schema's.
const NO_SCHEMA: u16 = 0;
/// Name of this form in a file's header; a reader refuses others by name.
pub(super) const FORM: &str = "moca-s/2";
/// What a cut can lose, ns of loop time.
const CHUNK_NS: u64 = 500_000_000;
/// Bytes after which a chunk ends all the same.
const CHUNK_BYTES: u64 = 4 << 20;
/// How often a sample is written for viewers, ns: 50 Hz.
const DISPLAY_PERIOD_NS: u64 = 20_000_000;
/// Name of the overview among a log's attachments.
pub(super) const OVERVIEW: &str = "overview.json";

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

/// What changes now and then: mode, fault with the board that it is of, and what is known of the board.
type Situation = (Mode, (Option<Fault>, Option<u8>), Diagnosis);

/// Writes a log to `W`. Each channel's messages are in order of time.
pub struct LogWriter<W: Write> {
    mcap: Writer<NoSeek<W>>,
    channels: BTreeMap<&'static str, u16>,
    start_unix_ns: u64,
    last: Option<Situation>,
    /// Loop time at which the present chunk began; `None` before its first sample.
    chunk_ns: Option<u64>,
    next_display_ns: u64,
    /// Largest lateness, s, and stages, ns, since the last sample that was written.
    worst: (f64, [u32; STAGES.len()]),
    overview: OverviewBuilder,
    json: Vec<u8>,
    summary: LogSummary,
}

impl<W: Write> LogWriter<W> {
    /// Starts a log: header, schemas and the robot's description go out at once.
    pub fn new(output: W, meta: &Meta) -> Result<Self, LogError> {
        // A writer that may not seek keeps a chunk in memory until it is whole.
        let options = WriteOptions::new()
            .profile(FORM)
            .library(concat!("moca-telemetry ", env!("CARGO_PKG_VERSION")))
            .compression(Some(Compression::Zstd))
            .chunk_size(Some(CHUNK_BYTES))
            .disable_seeking(true);
        let mut log = Self {
            mcap: options.create(NoSeek::new(output))?,
            channels: BTreeMap::new(),
            start_unix_ns: meta.start_unix_ns,
            last: None,
            chunk_ns: None,
            next_display_ns: 0,
            worst: Default::default(),
            overview: OverviewBuilder::default(),
            json: Vec::new(),
            summary: LogSummary::default(),
        };
        log.add::<Robot>()?;
        log.add::<State>()?;
        log.add::<Command>()?;
        log.add::<Link>()?;
        log.add::<Cover>()?;
        log.add::<Timing>()?;
        log.add::<ModeChange>()?;
        log.add::<FaultChange>()?;
        log.add::<BoardChange>()?;
        log.add::<Contact>()?;
        log.add::<ParameterChange>()?;
        log.add::<Configuration>()?;
        for topic in SERIAL_TOPICS.into_iter().chain([LOOP_STATE_TOPIC, REPLAY_TOPIC]) {
            let channel =
                log.mcap.add_channel(NO_SCHEMA, topic, "application/octet-stream", &BTreeMap::new())?;
            log.channels.insert(topic, channel);
        }
        let json = serde_json::to_string(&meta.description)?;
        let name = meta.description.name.clone();
        log.write(0, &Robot { start_unix_ns: meta.start_unix_ns, name, json })?;
        log.flush()?;
        Ok(log)
    }

    /// Takes one sample. What changed or happened is written with its tick; the rest as often as a viewer can show it, and
    /// whenever something happened.
    pub fn sample(&mut self, sample: &Sample) -> Result<(), LogError> {
        let time_ns = sample.time_ns;
        if self.chunk_ns.is_some_and(|began| time_ns.saturating_sub(began) >= CHUNK_NS) {
            self.flush()?;
        }
        let eventful = self.changes(sample)? || !sample.contact_events.is_empty();
        for event in &sample.contact_events {
            self.write(time_ns, &Contact::new(sample.tick, event))?;
        }
        self.overview.add(sample);
        self.summary.samples += 1;
        let (lateness_s, stages_ns) = &mut self.worst;
        *lateness_s = worse(*lateness_s, sample.lateness_s);
        stages_ns.iter_mut().zip(sample.stages_ns).for_each(|(worst, now)| *worst = now.max(*worst));
        if eventful || time_ns >= self.next_display_ns {
            self.next_display_ns = time_ns - time_ns % DISPLAY_PERIOD_NS + DISPLAY_PERIOD_NS;
            self.display(sample)?;
        }
        Ok(())
    }

    /// Writes mode, fault and board where they changed, and at the beginning of each chunk, so that it can be read alone;
    /// whether one changed.
    fn changes(&mut self, sample: &Sample) -> Result<bool, LogError> {
        let (tick, time_ns) = (sample.tick, sample.time_ns);
        let fault = (sample.fault, sample.fault_board);
        let now = (sample.mode, fault, sample.board);
        let last = self.last.replace(now);
        let again = self.chunk_ns.is_none();
        if again || last.is_none_or(|(mode, ..)| mode != sample.mode) {
            self.write(time_ns, &ModeChange { tick, mode: sample.mode })?;
        }
        if again || last.map_or((None, None), |(_, fault, _)| fault) != fault {
            self.write(time_ns, &FaultChange::new(tick, sample.fault, sample.fault_board)?)?;
        }
        if again || last.is_none_or(|(.., board)| board != sample.board) {
            self.write(time_ns, &BoardChange::new(tick, sample.board)?)?;
        }
        self.chunk_ns.get_or_insert(time_ns);
        Ok(last != Some(now))
    }

    fn display(&mut self, sample: &Sample) -> Result<(), LogError> {
        let (lateness_s, stages_ns) = std::mem::take(&mut self.worst);
        let shown = shown(&Sample { lateness_s, stages_ns, ..sample.clone() });
        let time_ns = shown.time_ns;
        self.write(time_ns, &state(&shown))?;
        self.write(time_ns, &command(&shown))?;
        self.write(time_ns, &cover(&shown))?;
        if let Some(link) = &shown.link {
            self.write(time_ns, &Link::new(shown.tick, link))?;
        }
        self.write(time_ns, &timing(&shown))?;
        self.summary.displayed += 1;
        Ok(())
    }

    /// Writes how the run is configured.
    pub fn configuration(&mut self, configuration: &Configuration) -> Result<(), LogError> {
        self.write(0, configuration)?;
        self.flush()
    }

    /// Writes a block of what ticks were given, in the daemon's own form.
    pub fn replay(&mut self, time_ns: u64, block: &[u8]) -> Result<(), LogError> {
        self.write_bytes(REPLAY_TOPIC, time_ns, block)
    }

    /// Writes what the loop remembered when the log begins, in the daemon's own form.
    pub fn loop_state(&mut self, time_ns: u64, state: &[u8]) -> Result<(), LogError> {
        self.write_bytes(LOOP_STATE_TOPIC, time_ns, state)
    }

    /// Writes a change of a parameter.
    pub fn parameter(&mut self, time_ns: u64, change: &ParameterChange) -> Result<(), LogError> {
        self.write(time_ns, change)
    }

    /// Writes one read of a Touch Board's port; a board beyond the last channel has none.
    pub fn serial(&mut self, serial: &SerialBytes) -> Result<(), LogError> {
        self.summary.serial_bytes += serial.bytes.len() as u64;
        match SERIAL_TOPICS.get(usize::from(serial.board)) {
            Some(topic) => self.write_bytes(topic, serial.arrival_ns, &serial.bytes),
            None => Ok(()),
        }
    }

    /// Ends the present chunk and hands it to the operating system.
    pub fn flush(&mut self) -> Result<(), LogError> {
        self.chunk_ns = None;
        Ok(self.mcap.flush()?)
    }

    /// Writes overview, index and end mark. A log that is dropped instead has its index too, but no overview, and nobody
    /// hears of it if that fails.
    pub fn finish(mut self) -> Result<LogSummary, LogError> {
        self.flush()?;
        let data = serde_json::to_vec(self.overview.overview())?;
        let overview = Attachment {
            log_time: self.start_unix_ns,
            create_time: self.start_unix_ns,
            name: OVERVIEW.into(),
            media_type: "application/json".into(),
            data: data.into(),
        };
        self.mcap.attach(&overview)?;
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
        let mut json = std::mem::take(&mut self.json);
        json.clear();
        let written = serde_json::to_writer(&mut json, record).map_err(LogError::from);
        let written = written.and_then(|()| self.write_bytes(C::TOPIC, time_ns, &json));
        self.json = json;
        written
    }

    fn write_bytes(&mut self, topic: &str, time_ns: u64, bytes: &[u8]) -> Result<(), LogError> {
        let Some(&channel_id) = self.channels.get(topic) else {
            return Ok(()); // Every channel is added by `new`.
        };
        let time = self.start_unix_ns.saturating_add(time_ns);
        let header = MessageHeader { channel_id, sequence: 0, log_time: time, publish_time: time };
        Ok(self.mcap.write_to_known_channel(&header, bytes)?)
    }
}

/// The larger of two; what is no number stays one.
fn worse(a: f64, b: f64) -> f64 {
    if a.is_nan() || b.is_nan() { f64::NAN } else { a.max(b) }
}

/// A sample as a log shows it: its numbers with seven digits, the events of its contacts in full.
pub fn shown(sample: &Sample) -> Sample {
    let mut shown = sample.clone();
    let lists: [&mut [f64]; 11] = [
        &mut shown.base_pose_world,
        &mut shown.base_velocity_world,
        &mut shown.base_velocity_command_body,
        &mut shown.q_rad,
        &mut shown.dq_rad_s,
        &mut shown.arm_torque_nm,
        &mut shown.flange_position_world,
        &mut shown.flange_quaternion_world,
        &mut shown.flange_desired_position_world,
        &mut shown.flange_desired_quaternion_world,
        &mut shown.flange_wrench_world,
    ];
    let singles = [
        &mut shown.cover_speed_m_s,
        &mut shown.uncovered_way_m,
        &mut shown.frame_age_s,
        &mut shown.frame_rate_hz,
        &mut shown.speed_limit.m_s,
        &mut shown.lateness_s,
    ];
    let forces = shown.taxels.iter_mut().map(|taxel| &mut taxel.force_n);
    let link = shown
        .link
        .iter_mut()
        .flat_map(|link| [&mut link.arm_age_s, &mut link.base_age_s, &mut link.arm.success_rate]);
    let numbers = lists
        .into_iter()
        .flatten()
        .chain(&mut shown.cover_wrench_base)
        .chain(forces)
        .chain(singles)
        .chain(link);
    numbers.for_each(|number| *number = seven_digits(*number));
    shown
}

fn state(sample: &Sample) -> State {
    State {
        tick: sample.tick,
        base_pose_world: sample.base_pose_world,
        base_velocity_world: sample.base_velocity_world,
        cover_speed_m_s: sample.cover_speed_m_s,
        uncovered_way_m: sample.uncovered_way_m,
        q_rad: sample.q_rad.to_vec(),
        dq_rad_s: sample.dq_rad_s.to_vec(),
        flange_position_world: sample.flange_position_world,
        flange_quaternion_world: sample.flange_quaternion_world,
        flange_desired_position_world: sample.flange_desired_position_world,
        flange_desired_quaternion_world: sample.flange_desired_quaternion_world,
        flange_wrench_world: sample.flange_wrench_world,
    }
}

fn command(sample: &Sample) -> Command {
    Command {
        tick: sample.tick,
        base_velocity_body: sample.base_velocity_command_body,
        arm_torque_nm: sample.arm_torque_nm.to_vec(),
        speed_limit_m_s: sample.speed_limit.m_s,
        speed_limit_reason: sample.speed_limit.reason,
        law: sample.law.map_or("", |law| Mode::from(law).name()).into(),
        contact_reaction: name_of(sample.contact_reaction),
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

fn timing(sample: &Sample) -> Timing {
    Timing {
        tick: sample.tick,
        lateness_s: sample.lateness_s,
        overruns: sample.overruns,
        stages_ns: sample.stages_ns,
        frames_good: sample.frames_good,
        frames_bad: sample.frames_bad,
    }
}
