//! The line of our own firmware, on what that firmware sent in its simulation (`firmware-sim record`).
#![allow(clippy::unwrap_used, clippy::panic, reason = "a test that cannot go on has to stop")]

use moca_msgs::BoardFault;
use moca_tactile::board::{BoardMonitor, Diagnosis, MAX_ELECTRODES, SampledFrame};
use moca_tactile::datastream;
use moca_tactile::touchline::{BadLine, Content, Flags, Line, emit, is_note, parse};
use moca_tactile::{Cover, CoverConfig, Firmware};
use std::path::PathBuf;

fn recording(name: &str) -> PathBuf {
    PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("../../tests/fixtures/recordings").join(name)
}

fn bytes(name: &str) -> Vec<u8> {
    std::fs::read(recording(name).with_extension("txt")).unwrap()
}

/// (arrival ns, bytes) of each read.
fn reads(name: &str) -> Vec<(u64, Vec<u8>)> {
    let stream = bytes(name);
    let times = std::fs::read_to_string(recording(name).with_extension("times")).unwrap();
    let mut at = 0;
    times
        .lines()
        .map(|line| {
            let (seconds, count) = line.split_once(' ').unwrap();
            let count: usize = count.parse().unwrap();
            #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "a few seconds")]
            let arrival_ns = (seconds.parse::<f64>().unwrap() * 1e9).round() as u64;
            at += count;
            (arrival_ns, stream[at - count..at].to_vec())
        })
        .collect()
}

fn lines(name: &str) -> Vec<Vec<u8>> {
    bytes(name).split(|&byte| byte == b'\n').filter(|line| line.len() == 60).map(<[u8]>::to_vec).collect()
}

fn frames(board: &mut BoardMonitor, bytes: &[u8], arrival_ns: u64) -> Vec<SampledFrame> {
    let mut rest = bytes;
    std::iter::from_fn(|| board.next_frame(&mut rest, arrival_ns)).collect()
}

/// A board whose clock map and baseline are known, and when its last line arrived, ns.
fn running() -> (BoardMonitor, u64) {
    let mut board = BoardMonitor::new([true; MAX_ELECTRODES]);
    let mut last_ns = 0;
    for (arrival_ns, bytes) in reads("moca-touch").into_iter().take(600) {
        frames(&mut board, &bytes, arrival_ns);
        last_ns = arrival_ns;
    }
    assert_eq!((board.fault(last_ns), board.diagnosis()), (None, Diagnosis::Frames));
    (board, last_ns)
}

#[test]
fn every_recorded_line_is_read_and_written_back_byte_for_byte() {
    for name in ["moca-touch", "moca-touch-two-chips"] {
        let lines = lines(name);
        assert!(lines.len() > 900, "{name}: {} lines", lines.len());
        for line in lines {
            let mut again = Vec::new();
            emit(&parse(&line).unwrap(), &mut again);
            assert_eq!(again.strip_suffix(b"\n").unwrap(), line);
        }
    }
}

#[test]
fn no_single_bit_flip_of_a_line_is_accepted() {
    let (mut tried, lines) = (0, lines("moca-touch"));
    for line in lines.iter().step_by(lines.len() / 108).take(108) {
        for bit in 0..8 * line.len() {
            let mut damaged = line.clone();
            damaged[bit / 8] ^= 1 << (bit % 8);
            assert!(parse(&damaged).is_err(), "{:?}", String::from_utf8_lossy(&damaged));
            tried += 1;
        }
    }
    assert_eq!(tried, 51_840);
}

#[test]
fn what_is_wrong_with_a_line_is_said() {
    let line = lines("moca-touch").pop().unwrap();
    assert_eq!(parse(&line[1..]), Err(BadLine::Shape));
    let mut digit = line.clone();
    digit[20] = if digit[20] == b'0' { b'1' } else { b'0' };
    assert_eq!(parse(&digit), Err(BadLine::Checksum));
    let mut large = Vec::new();
    let values = [1024; 12];
    emit(&Line { values, ..parse(&line).unwrap() }, &mut large);
    assert_eq!(parse(&large[..60]), Err(BadLine::OutOfRange { electrode: 0 }));
    assert!(is_note(b"# moca-touch 1 chips C name - 695E"), "as the firmware answered in its simulation");
    assert!(!is_note(b"# moca-touch 1 chips D name - 695E"));
}

/// Frames of a stream whose bytes arrive as fast as they were sent, `size` at a time: values and baselines of the last 400.
fn last_frames(board: &mut BoardMonitor, stream: &[u8], size: usize) -> Vec<([u16; 12], [u16; 12])> {
    let mut sent = 0;
    let mut taken = Vec::new();
    for chunk in stream.chunks(size) {
        sent += chunk.len() as u64;
        let arrived = frames(board, chunk, sent * 4_000_000_000 / stream.len() as u64);
        taken.extend(arrived.iter().map(|frame| (frame.fdat, frame.baseline)));
    }
    taken.split_off(taken.len() - 400)
}

#[test]
fn a_recording_is_one_stream_however_it_is_cut() {
    let stream = bytes("moca-touch");
    let whole = last_frames(&mut BoardMonitor::new([true; MAX_ELECTRODES]), &stream, 61);
    for size in [1, 7, 64, 1000] {
        let mut board = BoardMonitor::new([true; MAX_ELECTRODES]);
        assert!(last_frames(&mut board, &stream, size) == whole, "chunks of {size}");
        assert_eq!((board.stats().frames_bad, board.stats().frames_lost), (0, 0));
    }
}

#[test]
fn the_recording_has_its_rate_age_and_firmware() {
    let mut board = BoardMonitor::new([true; MAX_ELECTRODES]);
    let (mut last, mut hold_ns, mut age_ns) = (0, 0, 0);
    for (arrival_ns, bytes) in reads("moca-touch") {
        for frame in frames(&mut board, &bytes, arrival_ns) {
            assert!(frame.sampled_at_ns <= frame.expected_sample_ns, "{frame:?}");
            if frame.sampled_at_ns != last {
                age_ns = age_ns.max(frame.complete_ns - frame.sampled_at_ns);
                hold_ns = if last == 0 { 0 } else { hold_ns.max(frame.complete_ns - last) };
                last = frame.sampled_at_ns;
            }
        }
    }
    println!("{:.1} Hz, age {age_ns} ns, held to {hold_ns} ns", board.rate_hz());
    assert_eq!(board.firmware(), Some(Firmware::Moca));
    assert!((board.rate_hz() - 246.8).abs() < 5.0, "{}", board.rate_hz());
    let said_ns = Firmware::Moca.worst_hold_ns();
    assert!(hold_ns <= said_ns + 500_000 && hold_ns > said_ns - 2_000_000, "{hold_ns}, said {said_ns}");
}

/// A running board, and lines that go on where it is, each with the time at which it arrives.
struct Continued {
    board: BoardMonitor,
    now_ns: u64,
    next: Line,
}

impl Continued {
    fn new() -> Self {
        let (board, now_ns) = running();
        let sent: Vec<u8> = reads("moca-touch").into_iter().take(600).flat_map(|(_, bytes)| bytes).collect();
        let mut data = sent.split(|&byte| byte == b'\n').filter_map(|line| parse(line).ok());
        let next = data.rfind(|line| matches!(line.content, Content::Data(_))).unwrap();
        Self { board, now_ns, next }
    }

    /// Sends a line 4 ms after the last one, with the next number, stamp and values; `change` spoils it.
    fn send(&mut self, change: impl FnOnce(&mut Line)) -> Vec<SampledFrame> {
        self.now_ns += 4_000_000;
        self.next.sequence = self.next.sequence.wrapping_add(1);
        self.next.device_us = self.next.device_us.wrapping_add(4000);
        self.next.values[0] ^= 1;
        self.next.content = Content::Data(Flags::NEW);
        let mut line = self.next;
        change(&mut line);
        let mut bytes = Vec::new();
        emit(&line, &mut bytes);
        frames(&mut self.board, &bytes, self.now_ns)
    }

    fn fault(&self) -> Option<BoardFault> {
        self.board.fault(self.now_ns)
    }
}

#[test]
fn a_torn_line_costs_one_frame_and_a_lost_one_is_counted() {
    let mut stream = Continued::new();
    assert_eq!(stream.send(|_| {}).len(), 1);
    let before = *stream.board.stats();
    frames(&mut stream.board, b"C 0258 0024A5B4 2C82C82C72C82C8\n", stream.now_ns);
    stream.next.sequence += 1;
    stream.next.device_us += 4000;
    stream.now_ns += 4_000_000;
    assert_eq!(stream.send(|_| {}).len(), 1);
    let after = *stream.board.stats();
    assert_eq!((after.frames_bad - before.frames_bad, after.frames_lost - before.frames_lost), (1, 1));
}

#[test]
fn each_flag_is_a_fault_of_its_own_and_ends_with_it() {
    for (flag, fault) in [
        (Flags::BUS_FAULT, Some(BoardFault::Frozen)),
        (Flags::CHIP_RESET, Some(BoardFault::Reset)),
        (Flags::OVER_CURRENT, Some(BoardFault::Chip)),
        (Flags::OUT_OF_RANGE, Some(BoardFault::Chip)),
        (Flags::DROPPED, None),
        (Flags::NEW, None),
    ] {
        let mut stream = Continued::new();
        stream.send(|line| line.content = Content::Data(flag));
        assert_eq!(stream.fault(), fault, "{flag:?}");
        stream.send(|_| {});
        assert_eq!(stream.fault(), None, "{flag:?}");
    }
}

#[test]
fn jump_of_clock_or_number_is_a_restart_until_16_lines_agree() {
    type Spoil = fn(&mut Line);
    let spoils: [(&str, Spoil); 6] = [
        ("clock 10 s ahead", |line| line.device_us = line.device_us.wrapping_add(10_000_000)),
        ("clock 10 s back", |line| line.device_us = line.device_us.wrapping_sub(10_000_000)),
        ("clock 100 ms back", |line| line.device_us = line.device_us.wrapping_sub(100_000)),
        ("10 lines skipped in 4 ms", |line| line.sequence = line.sequence.wrapping_add(10)),
        ("60 000 lines skipped", |line| line.sequence = line.sequence.wrapping_add(60_000)),
        ("5 lines back", |line| line.sequence = line.sequence.wrapping_sub(5)),
    ];
    for (name, spoil) in spoils {
        let mut stream = Continued::new();
        assert_eq!((stream.send(|_| {}).len(), stream.fault()), (1, None), "{name}");
        spoil(&mut stream.next);
        for line in 0..15 {
            assert_eq!(stream.send(|_| {}), [], "{name}, line {line}");
            assert_eq!(stream.fault(), Some(BoardFault::Reset), "{name}, line {line}");
        }
        for _ in 0..3 {
            stream.send(|_| {});
        }
        assert_eq!((stream.send(|_| {}).len(), stream.fault()), (1, None), "{name}: believed again");
    }
}

#[test]
fn jump_of_clock_or_number_voids_the_zero() {
    for jump_us in [0, 10_000_000] {
        let mut cover = Cover::<11>::new(CoverConfig::default()).unwrap();
        for (arrival_ns, bytes) in reads("moca-touch") {
            if (1_000_000_000..1_004_000_000).contains(&arrival_ns) {
                cover.start_tare(arrival_ns);
            }
            let mut spoiled = Vec::new();
            for line in bytes.split(|&byte| byte == b'\n').filter_map(|line| parse(line).ok()) {
                let ahead_us = if arrival_ns > 3_000_000_000 { jump_us } else { 0 };
                emit(&Line { device_us: line.device_us.wrapping_add(ahead_us), ..line }, &mut spoiled);
            }
            cover.push(0, &spoiled, arrival_ns);
        }
        assert_eq!(cover.zero_valid(), jump_us == 0, "clock {jump_us} us ahead");
    }
}

#[test]
fn delayed_lines_are_as_old_as_their_stamps_say() {
    let mut stream = Continued::new();
    let on_time = stream.send(|_| {})[0];
    stream.now_ns += 100_000_000;
    for _ in 0..5 {
        let late = stream.send(|_| {})[0];
        let older_ns =
            (late.complete_ns - late.sampled_at_ns) - (on_time.complete_ns - on_time.sampled_at_ns);
        assert!(older_ns.abs_diff(100_000_000) < 100_000, "{older_ns} ns");
        assert_eq!(stream.fault(), None);
    }
}

#[test]
fn repeated_number_is_refused_and_nothing_else_is_silence() {
    let mut stream = Continued::new();
    stream.send(|_| {});
    let (before, number) = (*stream.board.stats(), stream.next.sequence);
    for i in 0..31 {
        assert_eq!(stream.fault(), None, "after {i} lines");
        // a stamp of its own, and other values
        assert_eq!(stream.send(|line| line.sequence = number), [], "line {i}");
    }
    assert_eq!(stream.fault(), Some(BoardFault::Silent));
    let after = *stream.board.stats();
    assert_eq!((after.frames_bad - before.frames_bad, after.frames_good - before.frames_good), (31, 0));
}

#[test]
fn data_called_new_that_is_what_it_was_is_not_younger_for_it() {
    let mut stream = Continued::new();
    let first = stream.send(|_| {})[0];
    // the same values again, 1 ms later, with a number and a stamp of their own
    stream.next.values[0] ^= 1;
    stream.next.device_us -= 3000;
    stream.now_ns -= 3_000_000;
    let again = stream.send(|_| {})[0];
    assert_eq!(again.fdat, first.fdat);
    assert_eq!((again.complete_ns, again.sampled_at_ns), (stream.now_ns, first.sampled_at_ns));
}

#[test]
fn without_a_line_of_baselines_for_3_s_nothing_is_used() {
    let mut stream = Continued::new();
    let used: usize = (0..1000).map(|_| stream.send(|_| {}).len()).sum();
    assert!((700..=750).contains(&used), "{used} of 1000 lines");
}

#[test]
fn two_lines_of_one_refresh_have_one_sample_time() {
    let mut board = BoardMonitor::new([true; MAX_ELECTRODES]);
    let mut pairs = 0;
    let mut last: Option<SampledFrame> = None;
    for (arrival_ns, bytes) in reads("moca-touch") {
        let continues = bytes.split(|&b| b == b'\n').any(|line| {
            matches!(parse(line).map(|line| line.content), Ok(Content::Data(flags)) if flags.has(Flags::CONTINUES))
        });
        for frame in frames(&mut board, &bytes, arrival_ns) {
            if let Some(before) = last.filter(|_| continues) {
                assert_eq!(frame.sampled_at_ns, before.sampled_at_ns);
                pairs += 1;
            }
            last = Some(frame);
        }
    }
    assert!(pairs > 20, "{pairs} pairs");
}

#[test]
fn a_board_told_to_speak_datastream_is_read_on() {
    let (mut board, now_ns) = running();
    let frame = datastream::Frame { filtered: [700; 13], baseline: [700; 13], ..Default::default() };
    let mut stock = Vec::new();
    datastream::emit(&frame, &mut stock);
    let read = frames(&mut board, &stock, now_ns + 20_000_000);
    assert_eq!(read.len(), 1);
    assert_eq!(board.fault(now_ns + 20_000_000), None);
    let (line, mut back) = (lines("moca-touch").pop().unwrap(), Vec::new());
    back.extend_from_slice(&line);
    back.push(b'\n');
    frames(&mut board, &back, now_ns + 24_000_000);
    assert_eq!(board.firmware(), Some(Firmware::Moca));
}

#[test]
fn twenty_taxels_on_two_chips_feel_what_each_chip_sends() {
    // by default the eight are on a second board
    let mut cover = Cover::<20>::new(CoverConfig::default()).unwrap();
    // twelve on the board's own chip, eight on the second
    let mut config = CoverConfig::<20>::default();
    for (number, wire) in (0u8..).zip(&mut config.wiring) {
        (wire.board, wire.electrode) = (0, number);
    }
    let mut two_chips = Cover::<20>::new(config).unwrap();
    let mut largest_n = [0.0f64; 20];
    for (arrival_ns, bytes) in reads("moca-touch-two-chips") {
        cover.push(0, &bytes, arrival_ns);
        two_chips.push(0, &bytes, arrival_ns);
        if arrival_ns > 1_000_000_000 && arrival_ns < 1_010_000_000 {
            two_chips.start_tare(arrival_ns);
        }
        if arrival_ns > 1_900_000_000 {
            let poll = two_chips.poll(arrival_ns);
            let forces =
                poll.forces.unwrap_or_else(|why| panic!("{why:?} at {arrival_ns}: {:?}", poll.fault));
            for (largest, force) in largest_n.iter_mut().zip(forces) {
                *largest = largest.max(force);
            }
        }
    }
    assert!(largest_n[5] > 20.0, "E5 of the first chip was pressed: {largest_n:?}");
    assert!(largest_n.iter().enumerate().all(|(i, force)| i == 5 || *force == 0.0), "{largest_n:?}");
    assert_eq!(two_chips.boards().next().unwrap().chips(), 2);
    assert!(cover.poll(2_500_000_000).forces.is_err(), "wired to a second board that nobody hears");
}
