//! What must hold for every input; shared by the fuzz targets and by the ordinary test that replays the corpus.

use moca_tactile::datastream::{Event, Frame, Parser, emit};
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
