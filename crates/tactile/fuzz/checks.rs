//! Invariants for every input; shared by the fuzz targets and by the ordinary test that replays the corpus.

use moca_msgs::Fault;
use moca_tactile::board::{BoardMonitor, FrameSource, MAX_ELECTRODES, voids_zero};
use moca_tactile::datastream::{Event, Frame, Parser, emit};
use moca_tactile::touchline::{self, Content, Flags};
use moca_tactile::{BoardEvent, Chunk, Cover, CoverConfig};

/// Any bytes in any chunking give the events of the same bytes in one piece; good frames come back byte for byte;
/// one good frame after the garbage resynchronises; a cover fed with it all answers without a force it cannot know.
pub(crate) fn stream(data: &[u8]) {
    let Some((&seed, bytes)) = data.split_first() else { return };
    let whole = events(bytes, &mut |_| usize::MAX);
    let mut state = u32::from(seed);
    let chunked = events(bytes, &mut |_| {
        state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        1 + (state >> 24) as usize
    });
    assert_eq!(whole, chunked, "chunking changed the events");
    for event in &whole {
        if let Event::Frame(stamped) = event {
            let mut out = Vec::new();
            emit(&stamped.frame, &mut out);
            assert!(contains(bytes, &out), "a good frame was not emitted as it came");
        }
    }
    resynchronises(bytes);
    feed_cover(bytes, seed);
    stamped_lines(bytes);
}

/// Lines of our own firmware that arrive whole and say whatever the bytes make them say: no frame is younger than its line,
/// a fault that voids the zero leaves none, and no force is made up.
fn stamped_lines(bytes: &[u8]) {
    let mut cover = Cover::<11>::new(CoverConfig::default()).unwrap();
    let mut board = BoardMonitor::new([true; MAX_ELECTRODES]);
    let (mut now_ns, mut sequence, mut device_us) = (0u64, 0u16, 0u32);
    cover.start_tare(0);
    for record in bytes.chunks_exact(8) {
        let [kind, skip, step, wait, value, flags, high, low] = [0, 1, 2, 3, 4, 5, 6, 7].map(|i| record[i]);
        // Mostly a healthy board: 4 ms from line to line, each with the next number.
        let jump = u32::from_le_bytes([low, high, 0, 0]) << (kind >> 4);
        now_ns += if wait < 200 { 4_000_000 } else { u64::from(wait - 200) * 10_000_000 };
        device_us = device_us.wrapping_add(if step < 200 { 4000 } else { jump });
        sequence = sequence.wrapping_add(if skip < 200 { 1 } else { u16::from_le_bytes([low, high]) });
        let data = Content::Data(Flags(if flags < 200 { flags & 3 } else { flags }));
        let content = if kind & 7 == 7 { Content::Baseline { age_tenths_ms: flags } } else { data };
        let values = core::array::from_fn(|e| (700 + 4 * u16::from(value) * u16::from(e == 5)) & 1023);
        let line = touchline::Line { bank: u8::from(kind & 8 != 0), sequence, device_us, values, content };
        let mut text = Vec::new();
        touchline::emit(&line, &mut text);
        assert_eq!(touchline::parse(&text[..touchline::LINE_BYTES]), Ok(line));
        cover.push(0, &text, now_ns);
        let mut rest = text.as_slice();
        while let Some(frame) = FrameSource::next_frame(&mut board, &mut rest, now_ns) {
            assert!(frame.sampled_at_ns <= frame.expected_sample_ns && frame.expected_sample_ns <= now_ns);
        }
        let poll = cover.poll(now_ns);
        if let Ok(forces) = poll.forces {
            assert!(cover.zero_valid() && forces.iter().all(|f| f.is_finite() && *f >= 0.0));
            assert!(poll.reading.sampled_at_ns.is_some_and(|sampled_ns| sampled_ns <= now_ns));
        }
        assert!(
            !(matches!(poll.fault, Some(Fault::Board { fault, .. }) if voids_zero(fault))
                && cover.zero_valid()),
            "a zero outlives {:?}",
            poll.fault
        );
    }
}

/// A calibration file is refused or understood, and what is understood is written back the same.
pub(crate) fn calibration_file(data: &[u8]) {
    use moca_tactile::calibration::CalibrationFile;
    let Ok(text) = core::str::from_utf8(data) else { return };
    let Ok(file) = CalibrationFile::parse(text) else { return };
    let mut config = CoverConfig::<4>::default();
    if file.apply(&file.board, &mut config).is_ok() {
        let again = CalibrationFile::parse(&file.to_toml().unwrap()).unwrap();
        assert_eq!(again, file);
        for model in &config.models {
            let force_n = model.force_n(&mut Default::default(), 50.0, 0.025);
            assert!(force_n >= 0.0, "a model read {force_n} N");
        }
    }
}

fn events(bytes: &[u8], next_chunk: &mut dyn FnMut(usize) -> usize) -> Vec<Event> {
    let mut parser = Parser::new();
    let mut events = Vec::new();
    let mut at = 0;
    while at < bytes.len() {
        let end = at + next_chunk(at).min(bytes.len() - at);
        let mut chunk = &bytes[at..end];
        while let Some(event) = parser.next_event(&mut chunk, 0) {
            events.push(event);
        }
        at = end;
    }
    events
}

fn contains(stream: &[u8], frame: &[u8]) -> bool {
    stream.windows(frame.len()).any(|window| window == frame)
}

fn resynchronises(garbage: &[u8]) {
    let frame = Frame { filtered: [621; 13], baseline: [700; 13], ..Frame::default() };
    let mut bytes = garbage.to_vec();
    bytes.push(b'\n');
    emit(&frame, &mut bytes);
    let last = events(&bytes, &mut |_| usize::MAX).pop();
    assert!(
        matches!(last, Some(Event::Frame(stamped)) if stamped.frame == frame),
        "lost after garbage: {last:?}"
    );
}

fn feed_cover(bytes: &[u8], seed: u8) {
    let mut cover = Cover::<11>::new(CoverConfig::default()).unwrap();
    let mut now_ns = 0;
    for (i, piece) in bytes.chunks(200).enumerate() {
        now_ns += u64::from(seed) * 1_000_000;
        match i % 7 {
            5 => cover.event(0, &BoardEvent::Gap { at_ns: now_ns, bytes_lost: 3 }),
            6 => cover.start_tare(now_ns),
            _ => {}
        }
        cover.event(0, &BoardEvent::Bytes(Chunk::new(now_ns, piece)));
        let poll = cover.poll(now_ns);
        if let Ok(forces) = poll.forces {
            assert!(cover.zero_valid() && forces.iter().all(|f| f.is_finite() && *f >= 0.0));
        }
        assert!(poll.forces.is_ok() || poll.fault.is_some(), "no force and no fault");
    }
}
