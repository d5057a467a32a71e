//! The log: what is written is read back, whole or cut, by this library and by the `mcap` library alone.
#![cfg(feature = "log")]
#![allow(
    clippy::unwrap_used,
    clippy::float_cmp,
    reason = "test helpers fail by panicking; read back bit by bit"
)]

use moca_msgs::protection::{ContactKind, ContactPhase};
use moca_msgs::{
    ContactEvent, ContactReaction, Fault, Mode, Sample, SpeedLimit, SpeedLimitReason, TaxelReading,
    TaxelStatus,
    board::{Diagnosis, OpenFailure},
};
use moca_telemetry::{
    RobotDescription,
    log::{LogError, LogSummary, LogWriter, Meta, Recorder, SerialBytes, read_log, records},
};
use std::{collections::BTreeMap, path::PathBuf};

const START: u64 = 1_790_000_000_000_000_000;

/// A path of its own for each test, removed at the end.
struct TempFile(PathBuf);

impl TempFile {
    fn new(name: &str) -> Self {
        let path = std::env::temp_dir().join(format!("moca-log-{}-{name}.mcap", std::process::id()));
        let _ = std::fs::remove_file(&path);
        Self(path)
    }
}

impl Drop for TempFile {
    fn drop(&mut self) {
        let _ = std::fs::remove_file(&self.0);
    }
}

fn meta() -> Meta {
    Meta { description: RobotDescription::paper("test", true), start_unix_ns: START }
}

/// A sample in which no two numbers are equal and none is round.
fn sample(tick: u32) -> Sample {
    let mut next = f64::from(tick) * std::f64::consts::PI;
    let mut value = || {
        next = (next * 1.37 + 0.1).sin();
        next
    };
    let mut s = Sample {
        tick: u64::from(tick),
        time_ns: u64::from(tick) * 1_000_003,
        mode: if tick % 500 < 400 { Mode::Impedance } else { Mode::ProtectiveStop },
        fault: match tick % 500 {
            0..400 => None,
            400..450 => Some(Fault::BoardLost),
            _ => Some(Fault::TaxelInvalid { taxel: 3, status: TaxelStatus::Stuck }),
        },
        board: if tick % 500 < 400 { Diagnosis::Frames } else { Diagnosis::NotOpen(OpenFailure::Busy) },
        base_pose_world: [value(), value(), value()],
        base_velocity_world: [value(), value(), value()],
        cover_speed_m_s: value(),
        base_velocity_command_body: [value(), value(), value()],
        flange_position_world: [value(), value(), value()],
        flange_quaternion_world: [value(), value(), value(), value()],
        flange_desired_position_world: [value(), value(), value()],
        flange_desired_quaternion_world: [value(), value(), value(), value()],
        flange_wrench_world: [value(), value(), value(), value(), value(), value()],
        cover_wrench_base: [value(), value(), value()],
        frame_age_s: value(),
        frame_rate_hz: value(),
        frames_good: u64::from(tick / 25),
        frames_bad: u64::from(tick / 1000),
        lateness_s: value(),
        overruns: u64::from(tick / 700),
        stages_ns: std::array::from_fn(|i| tick + u32::try_from(i).unwrap()),
        speed_limit: SpeedLimit { m_s: value(), reason: SpeedLimitReason::BoardRate },
        contact_reaction: tick.is_multiple_of(7).then_some(ContactReaction::StopDirection),
        ..Sample::default()
    };
    for taxel in 0..u8::try_from(tick % 50 % 4).unwrap() {
        let event = ContactEvent {
            taxel,
            phase: ContactPhase::Finished,
            kind: ContactKind::QuasiStatic,
            started_ns: 7,
            duration_s: value(),
            peak_n: value(),
            clamp_mean_n: value(),
            clamp_max_n: value(),
            impulse_n_s: value(),
            crossed_n: (taxel > 0).then(|| value().abs() + 1.0),
            reaction: (taxel > 0).then_some(ContactReaction::Retreat),
        };
        s.contact_events.push(event).unwrap();
    }
    for _ in 0..7 {
        s.q_rad.push(value()).unwrap();
        s.dq_rad_s.push(value()).unwrap();
        s.arm_torque_nm.push(value()).unwrap();
    }
    for i in 0..11 {
        s.taxels.push(TaxelReading { force_n: value(), status: TaxelStatus::Ok }).unwrap();
        s.counts.push(700 + i).unwrap();
    }
    s
}

fn serial(tick: u32) -> SerialBytes {
    SerialBytes {
        arrival_ns: u64::from(tick) * 1_000_003,
        bytes: vec![0, 0xff, b'\n', tick.to_le_bytes()[0]],
    }
}

/// A finished log of `count` samples and a serial read every 25, in memory.
fn log(count: u32) -> Vec<u8> {
    let mut bytes = Vec::new();
    let mut writer = LogWriter::new(&mut bytes, &meta()).unwrap();
    for tick in 0..count {
        writer.sample(&sample(tick)).unwrap();
        if tick % 25 == 0 {
            writer.serial(&serial(tick)).unwrap();
        }
    }
    writer.finish().unwrap();
    bytes
}

#[test]
fn every_sample_comes_back_bit_by_bit() {
    let file = TempFile::new("round-trip");
    std::fs::write(&file.0, log(2000)).unwrap();
    let read = read_log(&file.0).unwrap();
    assert_eq!(read.cut, None);
    assert_eq!(read.description, RobotDescription::paper("test", true));
    assert_eq!(read.start_unix_ns, START);
    assert_eq!(read.samples.len(), 2000);
    for (tick, read) in (0..).zip(&read.samples) {
        assert_eq!(*read, sample(tick));
    }
    assert!(read.serial.iter().cloned().eq((0..2000).step_by(25).map(serial)));
}

#[test]
fn a_value_that_is_no_number_stays_one() {
    let file = TempFile::new("nan");
    let mut bytes = Vec::new();
    let mut writer = LogWriter::new(&mut bytes, &meta()).unwrap();
    let mut bad = sample(1);
    bad.base_pose_world[1] = f64::NAN;
    bad.q_rad[3] = f64::INFINITY;
    bad.lateness_s = f64::NAN;
    writer.sample(&bad).unwrap();
    writer.finish().unwrap();
    std::fs::write(&file.0, bytes).unwrap();
    let read = read_log(&file.0).unwrap();
    assert_eq!(read.cut, None);
    let read = &read.samples[0];
    assert!(read.base_pose_world[1].is_nan() && read.q_rad[3].is_nan() && read.lateness_s.is_nan());
    assert_eq!(read.base_pose_world[0], bad.base_pose_world[0]);
}

/// Where each chunk of `bytes` ends, and how many samples the file holds up to there, as the `mcap` library sees it.
fn chunk_ends(bytes: &[u8]) -> Vec<(usize, usize)> {
    let summary = mcap::Summary::read(bytes).unwrap().unwrap();
    let mut samples = 0;
    summary
        .chunk_indexes
        .iter()
        .map(|chunk| {
            let timing = summary.stream_chunk(bytes, chunk).unwrap();
            samples += timing.filter(|m| m.as_ref().unwrap().channel.topic == "/timing").count();
            (usize::try_from(chunk.chunk_start_offset + chunk.chunk_length).unwrap(), samples)
        })
        .collect()
}

#[test]
fn a_cut_anywhere_gives_everything_up_to_the_last_whole_chunk() {
    let bytes = log(420);
    let ends = chunk_ends(&bytes);
    assert!(ends.len() >= 4, "{} chunks: too few to cut between", ends.len());
    let file = TempFile::new("cut");
    // Every byte around each chunk's end, and a coarse comb over everything else.
    let near_an_end = |cut: usize| ends.iter().any(|(end, _)| cut.abs_diff(*end) <= 6);
    let cuts = (0..bytes.len()).filter(|&cut| cut < 16 || near_an_end(cut) || cut % 19_973 == 0);
    let mut tried = 0;
    for cut in cuts {
        std::fs::write(&file.0, &bytes[..cut]).unwrap();
        if cut < 8 {
            assert!(matches!(read_log(&file.0), Err(LogError::NotMcap(_))), "cut at {cut}");
            continue;
        }
        let read = read_log(&file.0).unwrap();
        let whole = |cut| ends.iter().rev().find(|(end, _)| *end <= cut).map_or(0, |(_, samples)| *samples);
        // A chunk that misses only LZ4's end mark of 4 bytes is whole too: its checksum fits.
        let allowed = [whole(cut), whole(cut + 4)];
        assert!(allowed.contains(&read.samples.len()), "cut at {cut}: {} samples", read.samples.len());
        assert!((0..).zip(&read.samples).all(|(tick, s)| *s == sample(tick)), "cut at {cut}");
        assert!(read.cut.is_some(), "cut at {cut} went unnoticed");
        tried += 1;
    }
    assert!(tried > 50);
}

#[test]
fn a_damaged_chunk_gives_nothing_rather_than_something_wrong() {
    let mut bytes = log(700);
    let ends = chunk_ends(&bytes);
    let third = mcap::Summary::read(&bytes).unwrap().unwrap().chunk_indexes[2].chunk_start_offset;
    bytes[usize::try_from(third).unwrap() + 1000] ^= 0x40;
    let file = TempFile::new("damaged");
    std::fs::write(&file.0, &bytes).unwrap();
    let read = read_log(&file.0).unwrap();
    assert_eq!(read.samples.len(), ends[1].1);
    assert!(read.cut.is_some());
}

#[test]
fn the_mcap_library_alone_finds_schemas_and_messages() {
    let bytes = log(1000);
    let mut counts = BTreeMap::new();
    for message in mcap::MessageStream::new(&bytes).unwrap() {
        let message = message.unwrap();
        let schema = message.channel.schema.as_ref().unwrap();
        assert_eq!(
            (schema.encoding.as_str(), message.channel.message_encoding.as_str()),
            ("jsonschema", "json")
        );
        let schema: serde_json::Value = serde_json::from_slice(&schema.data).unwrap();
        let body: serde_json::Value = serde_json::from_slice(&message.data).unwrap();
        assert_eq!(schema["type"], "object");
        assert!(!schema.to_string().contains("$ref"), "viewers read schemas without references");
        for (key, value) in body.as_object().unwrap() {
            let kind = schema["properties"][key]["type"].as_str().unwrap();
            let fits = match kind {
                "array" => value.is_array(),
                "string" => value.is_string(),
                "integer" => value.is_u64(),
                "number" => value.is_number(),
                _ => false,
            };
            assert!(fits, "{} {key}: {value} is no {kind}", message.channel.topic);
        }
        *counts.entry(message.channel.topic.clone()).or_insert(0) += 1;
    }
    for topic in ["/state", "/command", "/cover", "/timing"] {
        assert_eq!(counts[topic], 1000, "{topic}");
    }
    assert_eq!((counts["/mode"], counts["/fault"], counts["/board"], counts["/serial"]), (4, 5, 4, 40));
    let summary = mcap::Summary::read(&bytes).unwrap().unwrap();
    assert!(summary.chunk_indexes.iter().all(|c| c.uncompressed_size <= 256 * 1024 + 4096));
}

#[test]
fn the_recorder_writes_what_waits_when_it_is_told_to_finish() {
    let file = TempFile::new("recorder");
    let (mut to_recorder, samples) = rtrb::RingBuffer::new(64);
    let recorder = Recorder::create(&file.0, &meta(), samples).unwrap();
    let input = recorder.serial();
    for tick in 0..1000 {
        while to_recorder.push(sample(tick)).is_err() {
            std::thread::yield_now();
        }
    }
    input.offer(serial(7));
    assert!(recorder.is_recording());
    let summary = recorder.finish().unwrap();
    assert_eq!(summary, LogSummary { samples: 1000, serial_bytes: 4, serial_dropped: 0 });
    let read = read_log(&file.0).unwrap();
    assert_eq!((read.samples.len(), read.serial, read.cut), (1000, vec![serial(7)], None));
}

#[test]
fn an_existing_file_is_not_overwritten_and_other_files_are_refused() {
    let file = TempFile::new("existing");
    std::fs::write(&file.0, "somebody's thesis, not a log").unwrap();
    let (_, samples) = rtrb::RingBuffer::new(1);
    let refused = Recorder::create(&file.0, &meta(), samples).err().unwrap();
    assert!(matches!(refused, LogError::Create { .. }), "{refused}");
    assert!(matches!(read_log(&file.0), Err(LogError::NotMcap(_))));
    assert!(matches!(read_log(&file.0.with_extension("none")), Err(LogError::Open { .. })));
}

#[test]
fn the_fault_channel_says_what_to_do() {
    let change = records::FaultChange::new(1, Some(Fault::BoardLost)).unwrap();
    assert_eq!((change.code.as_str(), change.remedy.as_str()), ("board-lost", Fault::BoardLost.remedy()));
    assert_eq!(change.fault().unwrap(), Some(Fault::BoardLost));
    assert_eq!(records::FaultChange::new(1, None).unwrap().fault().unwrap(), None);
}
