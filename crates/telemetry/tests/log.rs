//! The log: what is written is read back, whole or cut, by this library and by the `mcap` library alone.
#![cfg(feature = "log")]
#![allow(
    clippy::unwrap_used,
    clippy::float_cmp,
    reason = "test helpers fail by panicking; read back bit by bit"
)]

use moca_msgs::protection::{ContactKind, ContactPhase};
use moca_msgs::{
    ArmLink, ArmMode, BoardFault, ContactEvent, ContactReaction, Fault, Link, Mode, Sample, SpeedLimit,
    SpeedLimitReason, TaxelReading, TaxelStatus,
    board::{Diagnosis, OpenFailure},
    target::{TargetKind, TargetPhase, TargetState},
};
use moca_telemetry::{
    RobotDescription,
    log::{
        LogError, LogFile, LogReader, LogSummary, LogWriter, Meta, Overview, Record, Recorder,
        RecorderOptions, SerialBytes, overview::Happening, part_path, read_log, records, shown,
    },
};
use std::{
    collections::BTreeMap,
    io::{Read, Seek, SeekFrom},
    path::PathBuf,
    sync::{
        Arc,
        atomic::{AtomicU64, Ordering},
    },
};

const START: u64 = 1_790_000_000_000_000_000;

const KINDS: [TargetKind; 5] = [
    TargetKind::Pose,
    TargetKind::Twist,
    TargetKind::Posture,
    TargetKind::BaseVelocity,
    TargetKind::Trajectory,
];
const PHASES: [TargetPhase; 6] = [
    TargetPhase::Moving,
    TargetPhase::Reached,
    TargetPhase::Aged,
    TargetPhase::SetAside,
    TargetPhase::EndedByTouch,
    TargetPhase::Ended,
];

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
            400..450 => Some(BoardFault::Lost.of(1)),
            _ => Some(Fault::TaxelInvalid { taxel: 3, status: TaxelStatus::Stuck }),
        },
        board: if tick % 500 < 400 { Diagnosis::Frames } else { Diagnosis::NotOpen(OpenFailure::Busy) },
        base_pose_world: [value(), value(), value()],
        base_velocity_world: [value(), value(), value()],
        cover_speed_m_s: value(),
        uncovered_way_m: value(),
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
        law: tick.is_multiple_of(2).then_some(moca_msgs::Law::FollowMe),
        contact_reaction: tick.is_multiple_of(7).then_some(ContactReaction::StopDirection),
        link: (tick % 1000 >= 500).then(|| Link {
            arm_age_s: value(),
            base_age_s: value(),
            arm: ArmLink {
                mode: ArmMode::ALL[usize::try_from(tick / 50).unwrap() % ArmMode::ALL.len()],
                success_rate: value(),
                lost: u64::from(tick / 9),
                repeated: u64::from(tick / 11),
                errors: 1 << (tick % 41),
            },
        }),
        target: (tick % 800 >= 300).then(|| TargetState {
            kind: KINDS[usize::try_from(tick / 20).unwrap() % KINDS.len()],
            phase: PHASES[usize::try_from(tick / 20).unwrap() % PHASES.len()],
            progress: value(),
        }),
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
            excess_m_s: value(),
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
        board: u8::from(tick % 2 == 1),
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

/// Returns true if a viewer is shown this tick: each 20 ms, and at every event.
fn is_shown(tick: u32) -> bool {
    let slot = |tick: u32| sample(tick).time_ns / 20_000_000;
    let state = |tick: u32| (sample(tick).mode, sample(tick).fault, sample(tick).board);
    let now = sample(tick);
    let eventful = !now.contact_events.is_empty();
    tick == 0 || eventful || slot(tick - 1) != slot(tick) || state(tick - 1) != state(tick)
}

/// Returns the samples that a viewer is shown of these ticks: the worst timing stands for the ticks that are left out.
fn displayed(ticks: std::ops::Range<u32>) -> Vec<Sample> {
    let mut worst = (0.0_f64, [0; 5]);
    let mut samples = Vec::new();
    for tick in ticks {
        let sample = sample(tick);
        worst.0 = worst.0.max(sample.lateness_s);
        worst.1 = std::array::from_fn(|stage| sample.stages_ns[stage].max(worst.1[stage]));
        if is_shown(tick) {
            let (lateness_s, stages_ns) = std::mem::take(&mut worst);
            samples.push(shown(&Sample { lateness_s, stages_ns, ..sample }));
        }
    }
    samples
}

#[test]
fn viewer_gets_events_and_seven_digits_at_50_hz() {
    let file = TempFile::new("round-trip");
    std::fs::write(&file.0, log(2000)).unwrap();
    let read = read_log(&file.0).unwrap();
    assert_eq!(read.cut, None);
    assert_eq!(read.description, RobotDescription::paper("test", true));
    assert_eq!(read.start_unix_ns, START);
    let expected = displayed(0..2000);
    assert!(read.samples.len() == expected.len() && expected.len() > 1000, "{}", read.samples.len());
    for (read, expected) in read.samples.iter().zip(&expected) {
        assert_eq!(read, expected);
        let exact = sample(u32::try_from(read.tick).unwrap());
        let near = |a: f64, b: f64| (a - b).abs() <= 1e-6 * b.abs() + 1e-9;
        assert!(read.q_rad.iter().zip(&exact.q_rad).all(|(a, b)| near(*a, *b)), "{:?}", exact.q_rad);
        assert_eq!(read.contact_events, exact.contact_events, "to the last bit");
    }
    assert!(read.serial.iter().cloned().eq((0..2000).step_by(25).map(serial)));
}

#[test]
fn blocks_of_ticks_come_back_byte_by_byte_in_their_place() {
    let file = TempFile::new("blocks");
    let mut bytes = Vec::new();
    let mut writer = LogWriter::new(&mut bytes, &meta()).unwrap();
    let block = |i: u32| -> Vec<u8> { (0..1000 + i).map(|j| (i * j).to_le_bytes()[0]).collect() };
    for i in 0..40 {
        (250 * i..250 * i + 250).for_each(|tick| writer.sample(&sample(tick)).unwrap());
        writer.replay(sample(250 * i).time_ns, &block(i)).unwrap();
    }
    writer.finish().unwrap();
    std::fs::write(&file.0, bytes).unwrap();
    let blocks = LogReader::open(&file.0).unwrap().filter_map(|record| match record {
        Record::Replay(block) => Some(block),
        _ => None,
    });
    assert!(blocks.eq((0..40).map(block)));
}

/// Returns a log as earlier versions wrote it: no story, and everything of half a second in one chunk.
fn as_before(log: &[u8]) -> Vec<u8> {
    let mut before = std::io::Cursor::new(Vec::new());
    let options = mcap::WriteOptions::new().profile("moca-s/4").library("moca-telemetry 0.2.0");
    let mut writer = options.chunk_size(None).create(&mut before).unwrap();
    let summary = mcap::Summary::read(log).unwrap().unwrap();
    for chunk in &summary.chunk_indexes {
        let messages = summary.stream_chunk(log, chunk).unwrap().map(Result::unwrap);
        for (number, message) in messages.enumerate() {
            let topic = message.channel.topic.as_str();
            if number == 0 && topic != "/replay" && !topic.starts_with("/serial") {
                writer.flush().unwrap();
            }
            writer.write(&message).unwrap();
        }
    }
    writer.finish().unwrap();
    drop(writer);
    before.into_inner()
}

#[test]
fn log_of_an_earlier_version_is_read_and_told() {
    let now = log(3000);
    let open = |bytes: &[u8]| LogFile::over(std::io::Cursor::new(bytes.to_vec()), "log".as_ref()).unwrap();
    let told = open(&now).account(&mut |_| {}).unwrap();
    let before = as_before(&now);
    let mut file = open(&before);
    assert_eq!(file.samples(0, u64::MAX).unwrap(), displayed(0..3000));
    let account = file.account(&mut |_| {}).unwrap();
    assert_eq!(account.story, told.story);
    assert_eq!(account.sizes.file, before.len() as u64);
    // Each part counts as if it had been compressed alone: nearly as many bytes as it has alone.
    for (before, now) in
        [(account.sizes.display, told.sizes.display), (account.sizes.board, told.sizes.board)]
    {
        assert!(before > now / 2 && before < now * 2, "{account:?} {told:?}");
    }
    assert!(told.story.stop_count == 6 && told.story.touches > 0, "{told:?}");
}

#[test]
fn purposes_have_chunks_of_their_own_and_index_lists_them() {
    let mut bytes = Vec::new();
    let mut writer = LogWriter::new(&mut bytes, &meta()).unwrap();
    for tick in 0..3000 {
        writer.sample(&sample(tick)).unwrap();
        if tick % 25 == 0 {
            writer.serial(&serial(tick)).unwrap();
            writer.replay(sample(tick).time_ns, &[7; 90]).unwrap();
        }
    }
    writer.finish().unwrap();
    let summary = mcap::Summary::read(&bytes).unwrap().unwrap();
    let mut messages = 0;
    let mut kinds = [0; 3];
    for chunk in &summary.chunk_indexes {
        let topics: std::collections::BTreeSet<String> = summary
            .stream_chunk(&bytes, chunk)
            .unwrap()
            .map(|message| {
                messages += 1;
                let message = message.unwrap();
                assert!((chunk.message_start_time..=chunk.message_end_time).contains(&message.log_time));
                message.channel.topic.clone()
            })
            .collect();
        assert_eq!(chunk.message_index_offsets.len(), topics.len());
        let indexed = summary.read_message_indexes(&bytes, chunk).unwrap();
        assert!(indexed.keys().all(|channel| topics.contains(&channel.topic)));
        let of =
            |topic: &str| usize::from(topic == "/replay") * 2 + usize::from(topic.starts_with("/serial"));
        let kind = topics.iter().map(|topic| of(topic)).collect::<std::collections::BTreeSet<_>>();
        assert_eq!(kind.len(), 1, "{topics:?}");
        kinds[*kind.first().unwrap()] += 1;
    }
    assert!(kinds.iter().all(|count| *count >= 5), "{kinds:?}");
    let statistics = summary.stats.as_ref().unwrap();
    assert_eq!(statistics.message_count, messages);
    assert_eq!(usize::try_from(statistics.chunk_count).unwrap(), summary.chunk_indexes.len());
    let [story, ..] = &summary.metadata_indexes[..] else { panic!("no story") };
    assert_eq!(story.name, "story");
}

/// Fields of records that are not asked for keep their default; rows and everything else stay.
#[test]
fn rows_have_the_fields_that_are_asked_for() {
    let bytes = log(1000);
    let mut file = LogFile::over(std::io::Cursor::new(bytes), "rows".as_ref()).unwrap();
    let mut rows = Vec::new();
    assert_eq!(file.rows(&["/cover"], &mut |row| rows.push(row.clone())), None);
    let expected = displayed(0..1000);
    assert_eq!(rows.len(), expected.len());
    for (row, expected) in rows.iter().zip(&expected) {
        assert_eq!((row.time_ns, row.mode, row.fault), (expected.time_ns, expected.mode, expected.fault));
        assert_eq!((&row.taxels, &row.counts), (&expected.taxels, &expected.counts));
        assert_eq!((row.target, &row.contact_events), (expected.target, &expected.contact_events));
        assert!(row.q_rad.is_empty() && row.overruns == 0 && row.speed_limit.m_s == 0.0, "{row:?}");
    }
    // And a log that is asked again for everything has it.
    assert_eq!(file.samples(0, u64::MAX).unwrap(), expected);
}

#[test]
fn an_old_log_is_refused_by_the_name_of_its_form() {
    let file = TempFile::new("old");
    let mut bytes = Vec::new();
    let mut old =
        mcap::WriteOptions::new().profile("moca-s/2").create(std::io::Cursor::new(&mut bytes)).unwrap();
    old.finish().unwrap();
    drop(old);
    std::fs::write(&file.0, bytes).unwrap();
    let refused = read_log(&file.0).unwrap_err().to_string();
    assert!(refused.contains("is a log of form moca-s/2, this program reads moca-s/4"), "{refused}");
    assert!(matches!(LogFile::open(&file.0), Err(LogError::OtherForm { .. })));
}

/// A long run with few events: what a day looks like.
fn calm(tick: u64) -> Sample {
    let t = f64::from(u32::try_from(tick).unwrap()) * 1e-3;
    let mut sample = Sample { tick, time_ns: tick * 1_000_000, mode: Mode::Impedance, ..Sample::default() };
    sample.base_pose_world = [t.sin(), t.cos(), 0.1 * t];
    sample.q_rad.extend([t.sin(); 7]);
    sample.flange_position_world = [0.5, 0.0, 0.9];
    sample.flange_desired_position_world = [0.5, 0.0, if tick == 1_234_567 { 0.95 } else { 0.9 }];
    let force_n = if tick % 600_000 < 2000 { 20.0 } else { 0.0 };
    sample.taxels.extend([TaxelReading { force_n, status: TaxelStatus::Ok }; 11]);
    sample
}

#[test]
fn a_log_is_looked_into_anywhere_and_only_what_is_shown_is_read() {
    let file = TempFile::new("anywhere");
    let mut writer = LogWriter::new(std::fs::File::create(&file.0).unwrap(), &meta()).unwrap();
    let mut fault = None;
    for tick in 0..60_000 {
        if tick == 30_000 {
            fault = Some(BoardFault::Lost.of(0));
        }
        let mode = if fault.is_some() { Mode::ProtectiveStop } else { Mode::Impedance };
        writer.sample(&Sample { mode, fault, ..calm(tick) }).unwrap();
    }
    writer.finish().unwrap();
    let mut log = LogFile::open(&file.0).unwrap();
    assert_eq!((log.cut(), log.start_unix_ns()), (None, START));
    assert_eq!(*log.description(), RobotDescription::paper("test", true));
    assert_eq!(log.range_ns(), (0, 59_980_000_000));
    // A jump to anywhere knows mode and fault, which changed long before.
    let late = log.samples(45_000_000_000, 46_000_000_000).unwrap();
    assert_eq!((late.len(), late[0].tick, late[50].tick), (51, 45_000, 46_000));
    assert!(late.iter().all(|s| (s.mode, s.fault) == (Mode::ProtectiveStop, Some(BoardFault::Lost.of(0)))));
    let early = log.samples(0, 1_000_000_000).unwrap();
    assert!(
        early.iter().all(|s| (s.mode, s.fault) == (Mode::Impedance, None)),
        "and what came later is forgotten"
    );
    let whole = log.overview().unwrap().clone();
    assert_eq!(whole.spans.len(), 60);
    let marked: Vec<_> = whole.marks.iter().map(|mark| (mark.time_ns, mark.what)).collect();
    assert!(marked.contains(&(30_000_000_000, Happening::Fault(BoardFault::Lost.of(0)))), "{marked:?}");

    // A log that was not finished: the same from its chunks.
    let bytes = std::fs::read(&file.0).unwrap();
    std::fs::write(&file.0, &bytes[..bytes.len() / 2]).unwrap();
    let mut log = LogFile::open(&file.0).unwrap();
    assert!(log.cut().is_some() && log.overview().is_none());
    let (_, end_ns) = log.range_ns();
    assert!(end_ns > 10_000_000_000);
    assert_eq!(log.samples(5_000_000_000, 6_000_000_000).unwrap().len(), 51);
    let mut heard = Vec::new();
    let rebuilt = log.build_overview(&mut |part| heard.push(part)).clone();
    assert!(heard.is_sorted() && heard.last().is_some_and(|part| *part > 0.4));
    let same = rebuilt.spans.len() - 1;
    assert_eq!(rebuilt.spans[..same], whole.spans[..same]);
}

/// A file that counts what is read of it.
struct Counted(std::fs::File, Arc<AtomicU64>);

impl Read for Counted {
    fn read(&mut self, bytes: &mut [u8]) -> std::io::Result<usize> {
        let read = self.0.read(bytes)?;
        self.1.fetch_add(read as u64, Ordering::Relaxed);
        Ok(read)
    }
}

impl Seek for Counted {
    fn seek(&mut self, to: SeekFrom) -> std::io::Result<u64> {
        self.0.seek(to)
    }
}

#[test]
fn eight_hour_log_opens_by_index() {
    const SECONDS: u64 = 8 * 3600;
    let file = TempFile::new("eight-hours");
    let output = std::io::BufWriter::new(std::fs::File::create(&file.0).unwrap());
    let mut writer = LogWriter::new(output, &meta()).unwrap();
    for second in 0..SECONDS {
        writer.sample(&calm(1000 * second)).unwrap();
        // What a replay needs is most of a file.
        writer.replay(second * 1_000_000_000, &second.to_le_bytes().repeat(100)).unwrap();
    }
    writer.finish().unwrap();
    let size = std::fs::metadata(&file.0).unwrap().len();
    let read = Arc::new(AtomicU64::new(0));
    let counted = Counted(std::fs::File::open(&file.0).unwrap(), Arc::clone(&read));
    let mut log = LogFile::over(counted, &file.0).unwrap();
    assert_eq!((log.cut(), log.overview().unwrap().spans.len() as u64), (None, SECONDS));
    let opened = read.swap(0, Ordering::Relaxed);
    assert!(opened < 16 << 20 && opened < size / 2, "opening read {opened} of {size} bytes");
    let middle_ns = SECONDS / 2 * 1_000_000_000;
    let minute = log.samples(middle_ns, middle_ns + 59_000_000_000).unwrap();
    assert_eq!((minute.len(), minute[0].time_ns), (60, middle_ns));
    let looked = read.load(Ordering::Relaxed);
    assert!(looked < size / 50, "a minute of eight hours read {looked} of {size} bytes");
}

#[test]
fn the_overview_of_a_day_keeps_a_single_bad_tick() {
    let mut builder = moca_telemetry::log::overview::OverviewBuilder::default();
    (0..2_000_000)
        .step_by(20)
        .chain([1_234_567])
        .collect::<std::collections::BTreeSet<u64>>()
        .into_iter()
        .for_each(|tick| builder.add(&calm(tick)));
    let Overview { spans, marks, .. } = builder.finish();
    let worst = spans.iter().max_by(|a, b| a.flange_error_m.total_cmp(&b.flange_error_m)).unwrap();
    assert_eq!(worst.start_ns, 1_234_000_000_000);
    assert!((worst.flange_error_m - 0.05).abs() < 1e-6);
    let touches = marks.iter().filter(|mark| mark.what == Happening::Touch).count();
    assert_eq!(touches, 3, "that at the beginning is none: nobody saw the cover untouched before");
}

#[test]
fn a_log_that_is_split_is_whole_in_each_part() {
    let file = TempFile::new("split");
    let parts: Vec<_> = (1..=4).map(|number| part_path(&file.0, number)).collect();
    parts.iter().for_each(|part| drop(std::fs::remove_file(part)));
    let (mut to_recorder, samples) = rtrb::RingBuffer::new(64);
    let split = Some(std::time::Duration::from_secs(2));
    let recorder =
        Recorder::create(&file.0, &meta(), samples, RecorderOptions { wait: true, split }).unwrap();
    recorder.configuration(records::Configuration { toml: "x = 1".into(), ..Default::default() });
    for tick in 0..7000 {
        while to_recorder.push(calm(tick)).is_err() {
            std::thread::yield_now();
        }
    }
    let summary = recorder.finish().unwrap();
    assert_eq!((summary.samples, summary.displayed, summary.dropped), (7000, 350, 0));
    let mut next = 0;
    for part in &parts {
        let log = read_log(part).unwrap();
        assert_eq!((log.cut, &*log.description.name), (None, "test"));
        assert_eq!(log.samples[0].tick, next, "no tick lies between two parts");
        next += 2000;
        let configured = LogReader::open(part)
            .unwrap()
            .any(|r| matches!(r, Record::Configuration(c) if c.toml == "x = 1"));
        assert!(configured);
        std::fs::remove_file(part).unwrap();
    }
}

#[test]
fn a_disk_that_refuses_is_told_at_once() {
    struct Full(usize);
    impl std::io::Write for Full {
        fn write(&mut self, bytes: &[u8]) -> std::io::Result<usize> {
            self.0 = self.0.checked_sub(bytes.len()).ok_or(std::io::ErrorKind::StorageFull)?;
            Ok(bytes.len())
        }
        fn flush(&mut self) -> std::io::Result<()> {
            Ok(())
        }
    }
    let (mut to_recorder, samples) = rtrb::RingBuffer::new(64);
    let recorder = Recorder::start(Full(100_000), &meta(), samples, false).unwrap();
    assert_eq!(recorder.failure(), None);
    let mut tick = 0;
    while recorder.failure().is_none() {
        if to_recorder.push(calm(tick)).is_ok() {
            tick += 1;
        } else {
            std::thread::yield_now();
        }
    }
    assert!(
        recorder.failure().is_some_and(|why| why.contains("no storage space")),
        "{:?}",
        recorder.failure()
    );
    assert!(recorder.finish().is_err());
}

#[test]
fn recording_that_is_truncated_is_reported() {
    let file = TempFile::new("truncated");
    let (mut samples, from_loop) = rtrb::RingBuffer::new(64);
    let recorder = Recorder::create(&file.0, &meta(), from_loop, RecorderOptions::default()).unwrap();
    let shorten = || std::fs::OpenOptions::new().write(true).open(&file.0).and_then(|log| log.set_len(0));
    let mut tick = 0;
    while recorder.failure().is_none() {
        // A chunk ends each half second of the loop's time.
        if samples.push(sample(tick)).is_ok() {
            tick += 20;
        }
        if tick > 20_000 {
            shorten().unwrap();
        }
        assert!(tick < 10_000_000, "nothing was said of a file that is cut all the time");
    }
    let said = recorder.finish().unwrap_err().to_string();
    assert!(said.contains("another program truncated it to 0 of "), "{said}");
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
    assert_eq!(read.base_pose_world[0], shown(&bad).base_pose_world[0]);
}

/// Returns the end of each chunk of `bytes`, and the number of samples up to there, as the `mcap` library sees it.
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
    let bytes = log(1600);
    let ends = chunk_ends(&bytes);
    let expected = displayed(0..1600);
    assert!(ends.len() >= 4, "{} chunks: too few to cut between", ends.len());
    let file = TempFile::new("cut");
    // Every byte around each chunk's end, and a coarse comb over everything else.
    let near_an_end = |cut: usize| ends.iter().any(|(end, _)| cut.abs_diff(*end) <= 6);
    let cuts = (0..bytes.len()).filter(|&cut| cut < 16 || near_an_end(cut) || cut % 19_973 == 0);
    let mut tried = 0;
    for cut in cuts {
        std::fs::write(&file.0, &bytes[..cut]).unwrap();
        if cut < ends[0].0 {
            let refused = read_log(&file.0).unwrap_err();
            assert!(refused.is_of_no_log(), "cut at {cut}: {refused}");
            assert_eq!(matches!(refused, LogError::NotMcap(_)), cut < 8, "cut at {cut}: {refused}");
            continue;
        }
        let read = read_log(&file.0).unwrap();
        let whole = |cut| ends.iter().rev().find(|(end, _)| *end <= cut).map_or(0, |(_, samples)| *samples);
        assert_eq!(read.samples.len(), whole(cut), "cut at {cut}");
        assert!(read.samples == expected[..read.samples.len()], "cut at {cut}");
        assert!(read.cut.is_some(), "cut at {cut} went unnoticed");
        tried += 1;
    }
    assert!(tried > 50);
}

#[test]
fn a_damaged_chunk_gives_nothing_rather_than_something_wrong() {
    let mut bytes = log(3000);
    let ends = chunk_ends(&bytes);
    let fourth = mcap::Summary::read(&bytes).unwrap().unwrap().chunk_indexes[3].chunk_start_offset;
    bytes[usize::try_from(fourth).unwrap() + 1000] ^= 0x40;
    let file = TempFile::new("damaged");
    std::fs::write(&file.0, &bytes).unwrap();
    let read = read_log(&file.0).unwrap();
    assert_eq!(read.samples.len(), ends[2].1);
    assert!(read.cut.is_some());
}

#[test]
fn the_mcap_library_alone_finds_schemas_and_messages() {
    let bytes = log(1000);
    let mut counts = BTreeMap::new();
    for message in mcap::MessageStream::new(&bytes).unwrap() {
        let message = message.unwrap();
        *counts.entry(message.channel.topic.clone()).or_insert(0) += 1;
        let Some(schema) = message.channel.schema.as_ref() else {
            assert_eq!(message.channel.message_encoding, "application/octet-stream");
            continue;
        };
        if message.channel.message_encoding == "cdr" {
            assert_eq!(schema.encoding, "ros2msg");
            assert_eq!(message.data[..4], [0, 1, 0, 0], "{}", message.channel.topic);
            continue;
        }
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
    }
    for topic in ["/tf", "/joint_states", "/flange", "/flange_desired", "/cover_wrench"] {
        assert_eq!(counts[topic], 10, "{topic}");
    }
    assert_eq!((counts["/tf_static"], counts["/scene/robot"]), (1, 1));
    for topic in ["/state", "/command", "/cover", "/timing"] {
        assert_eq!(counts[topic], displayed(0..1000).len(), "{topic}");
    }
    // Each chunk begins with all three; the second one where they change anyway.
    assert_eq!((counts["/mode"], counts["/fault"], counts["/board"]), (4, 6, 4));
    assert_eq!((counts["/serial"], counts["/serial/2"]), (20, 20));
    let summary = mcap::Summary::read(&bytes).unwrap().unwrap();
    assert_eq!(summary.attachment_indexes.len(), 1);
}

#[test]
fn the_recorder_writes_what_waits_when_it_is_told_to_finish() {
    let file = TempFile::new("recorder");
    let (mut to_recorder, samples) = rtrb::RingBuffer::new(64);
    let recorder = Recorder::create(&file.0, &meta(), samples, RecorderOptions::default()).unwrap();
    for tick in 0..1000 {
        while to_recorder.push(sample(tick)).is_err() {
            std::thread::yield_now();
        }
    }
    recorder.serial(serial(7));
    assert!(recorder.is_recording());
    let summary = recorder.finish().unwrap();
    let displayed = displayed(0..1000);
    let shown = displayed.len() as u64;
    assert_eq!(summary, LogSummary { samples: 1000, displayed: shown, serial_bytes: 4, dropped: 0 });
    let read = read_log(&file.0).unwrap();
    assert_eq!((read.samples, read.serial, read.cut), (displayed, vec![serial(7)], None));
}

#[test]
fn existing_file_is_kept_and_foreign_file_refused() {
    let file = TempFile::new("existing");
    std::fs::write(&file.0, "somebody's thesis, not a log").unwrap();
    let (_, samples) = rtrb::RingBuffer::new(1);
    let refused = Recorder::create(&file.0, &meta(), samples, RecorderOptions::default()).err().unwrap();
    assert!(matches!(refused, LogError::Create { .. }), "{refused}");
    assert!(matches!(read_log(&file.0), Err(LogError::NotMcap(_))));
    assert!(matches!(read_log(&file.0.with_extension("none")), Err(LogError::Open { .. })));
}

#[test]
fn the_fault_channel_says_what_to_do() {
    let change = records::FaultChange::new(1, Some(BoardFault::Lost.of(0))).unwrap();
    assert_eq!(
        (change.code.as_str(), change.remedy.as_str()),
        ("board-lost", BoardFault::Lost.of(0).remedy())
    );
    assert_eq!(change.fault().unwrap(), Some(BoardFault::Lost.of(0)));
    assert_eq!(records::FaultChange::new(1, None).unwrap().fault().unwrap(), None);
    // The words of logs that had the board beside the fault, and of those before, which had one board.
    let change = records::FaultChange::new(1, Some(BoardFault::Slow.of(1))).unwrap();
    assert_eq!((change.board, change.json.as_str()), (2, "\"BoardSlow\""));
    assert_eq!(change.fault().unwrap(), Some(BoardFault::Slow.of(1)));
    assert_eq!(records::FaultChange { board: 0, ..change }.fault().unwrap(), Some(BoardFault::Slow.of(0)));
}

#[test]
fn what_is_no_file_is_no_log_and_is_not_waited_for() {
    let pipe = TempFile::new("pipe");
    assert!(std::process::Command::new("mkfifo").arg(&pipe.0).status().unwrap().success());
    for path in [pipe.0.as_path(), "/dev/zero".as_ref(), std::env::temp_dir().as_path()] {
        let Err(error) = LogReader::open(path) else { panic!("{} was taken for a log", path.display()) };
        assert!(error.to_string().contains(&path.display().to_string()), "{error}");
        assert!(read_log(path).is_err() && LogFile::open(path).is_err(), "{}", path.display());
    }
}
