//! The line of our own firmware, on what that firmware sent in its simulation (`firmware-sim record`).
#![allow(clippy::unwrap_used, clippy::panic, reason = "a test that cannot go on has to stop")]

use moca_msgs::Fault;
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

#[test]
fn a_recording_is_one_stream_however_it_is_cut() {
    let whole = frames(&mut BoardMonitor::new([true; MAX_ELECTRODES]), &bytes("moca-touch"), 0);
    for size in [1, 7, 64, 1000] {
        let mut board = BoardMonitor::new([true; MAX_ELECTRODES]);
        let stream = bytes("moca-touch");
        let cut: Vec<_> = stream.chunks(size).flat_map(|chunk| frames(&mut board, chunk, 0)).collect();
        assert_eq!(cut, whole, "chunks of {size}");
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

#[test]
fn a_torn_line_costs_one_frame_and_a_lost_one_is_counted() {
    let (mut board, mut now_ns) = running();
    let before = *board.stats();
    let all = lines("moca-touch");
    let at = all.iter().position(|line| parse(line).unwrap().sequence == 800).unwrap();
    let send = |board: &mut BoardMonitor, line: &[u8], now_ns: &mut u64| {
        *now_ns += 4_000_000;
        frames(board, &[line, b"\n"].concat(), *now_ns)
    };
    let first = board.stats().frames_lost;
    send(&mut board, &all[at], &mut now_ns);
    let jump = board.stats().frames_lost - first;
    send(&mut board, &all[at + 1][..40], &mut now_ns);
    send(&mut board, &all[at + 2], &mut now_ns);
    let after = *board.stats();
    assert_eq!((after.frames_bad - before.frames_bad, after.frames_lost - before.frames_lost - jump), (1, 1));
}

#[test]
fn each_flag_is_a_fault_of_its_own_and_ends_with_it() {
    let (board, now_ns) = running();
    let last = lines("moca-touch")
        .into_iter()
        .map(|line| parse(&line).unwrap())
        .rfind(|line| matches!(line.content, Content::Data(flags) if flags.is_new()));
    let template = last.unwrap();
    for (flag, fault) in [
        (Flags::BUS_FAULT, Some(Fault::BoardFrozen)),
        (Flags::CHIP_RESET, Some(Fault::BoardReset)),
        (Flags::OVER_CURRENT, Some(Fault::BoardChip)),
        (Flags::OUT_OF_RANGE, Some(Fault::BoardChip)),
        (Flags::DROPPED, None),
        (Flags::NEW, None),
    ] {
        let mut board = board.clone();
        let mut bytes = Vec::new();
        emit(&Line { content: Content::Data(flag), ..template }, &mut bytes);
        frames(&mut board, &bytes, now_ns + 4_000_000);
        assert_eq!(board.fault(now_ns + 4_000_000), fault, "{flag:?}");
        let mut bytes = Vec::new();
        emit(&Line { content: Content::Data(Flags::NEW), ..template }, &mut bytes);
        frames(&mut board, &bytes, now_ns + 8_000_000);
        assert_eq!(board.fault(now_ns + 8_000_000), None, "{flag:?}");
    }
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
