//! Events of a board's reader besides frames.
#![allow(clippy::unwrap_used, reason = "a test that cannot go on has to stop")]

use moca_msgs::BoardFault;
use moca_tactile::Firmware;
use moca_tactile::board::{
    BoardEvent, BoardMonitor, Diagnosis, FROZEN_FRAMES, FrameSource, MAX_ELECTRODES, OpenFailure,
    SILENT_AFTER_NS, STALL_GAP_NS, SampledFrame,
};
use moca_tactile::datastream::{BadFrame, Frame, Line, emit, emit_line};
use moca_tactile::touchline::{self, Content, Flags};

const PERIOD_NS: u64 = 24_700_000;

struct Stream {
    board: BoardMonitor,
    now_ns: u64,
}

impl Stream {
    fn new() -> Self {
        Self { board: BoardMonitor::new([true; MAX_ELECTRODES]), now_ns: 0 }
    }

    fn take(&mut self, mut bytes: &[u8]) -> Option<SampledFrame> {
        let mut last = None;
        while let Some(frame) = self.board.next_frame(&mut bytes, self.now_ns) {
            last = Some(frame);
        }
        last
    }

    fn send(&mut self, frame: &Frame) -> Option<SampledFrame> {
        self.now_ns += PERIOD_NS;
        let mut bytes = Vec::new();
        emit(frame, &mut bytes);
        self.take(&bytes)
    }

    fn line(&mut self, frame: &Frame, line: Line) {
        let mut bytes = Vec::new();
        emit_line(frame, line, &mut bytes);
        assert_eq!(self.take(&bytes), None);
    }
}

fn counts(filtered: u16) -> Frame {
    Frame { filtered: [filtered; 13], baseline: [720; 13], ..Frame::default() }
}

#[test]
fn each_thing_that_is_wrong_shows_in_its_own_place_and_ends() {
    let mut stream = Stream::new();
    stream.board.opened();
    stream.board.opened();
    assert_eq!(stream.board.stats().connections, 2);
    assert_eq!(
        (stream.board.columns(), stream.board.last_bad(), stream.board.firmware()),
        (None, None, None)
    );
    for filtered in [720, 721] {
        assert!(stream.send(&counts(filtered)).is_some());
        assert!(
            !stream.board.is_all_zero() && !stream.board.is_frozen() && !stream.board.thresholds_changed()
        );
    }
    assert_eq!(stream.board.columns(), Some(13));
    assert_eq!(FrameSource::firmware(&stream.board), Some(Firmware::Stock2015));
    assert_eq!(stream.board.fault(stream.now_ns), None);

    stream.send(&counts(0));
    assert!(stream.board.is_all_zero());
    assert_eq!(stream.board.fault(stream.now_ns), Some(BoardFault::Reset));
    stream.send(&Frame { touch_threshold: [9; 13], ..counts(722) });
    assert!(stream.board.thresholds_changed() && !stream.board.is_all_zero());
    assert_eq!(stream.board.fault(stream.now_ns), Some(BoardFault::Thresholds));

    stream.send(&counts(720));
    for repeated in 1..FROZEN_FRAMES {
        assert_eq!(
            (stream.board.is_frozen(), stream.board.fault(stream.now_ns)),
            (false, None),
            "{repeated}"
        );
        stream.send(&counts(720));
        assert_eq!(stream.board.identical_frames(), repeated);
    }
    assert!(stream.board.is_frozen());
    assert_eq!(stream.board.fault(stream.now_ns), Some(BoardFault::Frozen));
    stream.send(&counts(721));
    assert_eq!((stream.board.identical_frames(), stream.board.is_frozen()), (0, false));

    stream.line(&counts(720), Line::Touch);
    stream.line(&counts(720), Line::Filtered);
    let torn = BadFrame::Torn { expected: Line::TouchThreshold };
    assert_eq!((stream.board.last_bad(), stream.board.stats().frames_bad), (Some(torn), 1));
}

#[test]
fn pending_frame_is_announced_if_age_is_known() {
    let mut stream = Stream::new();
    let begin = [Line::Touch, Line::TouchThreshold, Line::ReleaseThreshold];
    let data_of = |stream: &mut Stream, filtered: u16| {
        stream.now_ns += PERIOD_NS;
        for line in begin {
            stream.line(&counts(filtered), line);
            assert_eq!(stream.board.early(), None, "{line:?}");
        }
        stream.line(&counts(filtered), Line::Filtered);
        let early = stream.board.early();
        for line in [Line::Baseline, Line::Difference] {
            let mut bytes = Vec::new();
            emit_line(&counts(filtered), line, &mut bytes);
            if let (Some(early), Some(whole)) = (early, stream.take(&bytes)) {
                assert_eq!(early.sampled_at_ns, whole.sampled_at_ns, "the whole frame is no younger");
            }
        }
        assert_eq!(stream.board.early(), None, "it is complete");
        early.map(|early| early.fdat[11])
    };
    assert_eq!(data_of(&mut stream, 700), None, "nothing has shown yet that this is a board of ours");
    assert_eq!(data_of(&mut stream, 690), Some(690));
    stream.now_ns += STALL_GAP_NS;
    assert_eq!(data_of(&mut stream, 680), None, "it may have waited in the host");
    assert_eq!(data_of(&mut stream, 670), Some(670));
    FrameSource::event(&mut stream.board, &BoardEvent::Gap { at_ns: stream.now_ns, bytes_lost: 7 });
    assert_eq!((data_of(&mut stream, 660), stream.board.stats().bytes_lost), (None, 7));
}

#[test]
fn what_our_firmware_says_of_its_chips_is_there_to_be_read() {
    let mut stream = Stream::new();
    assert_eq!((stream.board.flags(), stream.board.chips()), (Flags::default(), 0));
    stream.send(&counts(700));
    for (bank, sequence, flags) in
        [(0, 1, Flags::SETTLING), (0, 4, Flags::SETTLING), (1, 1, Flags::OUT_OF_RANGE)]
    {
        let content = Content::Data(flags);
        let line = touchline::Line {
            bank,
            sequence,
            device_us: 5000 * u32::from(sequence),
            values: [700; 12],
            content,
        };
        let mut bytes = Vec::new();
        touchline::emit(&line, &mut bytes);
        assert_eq!(stream.take(&bytes), None, "its clock is not known yet");
        stream.now_ns += STALL_GAP_NS + 1;
    }
    assert!(stream.board.flags().has(Flags::SETTLING) && stream.board.flags().has(Flags::OUT_OF_RANGE));
    assert!(!stream.board.flags().has(Flags::BUS_FAULT));
    assert_eq!((stream.board.chips(), stream.board.firmware()), (2, Some(Firmware::Moca)));
    let note = b"# moca-touch 1";
    let sum = (0..=0xffff_u16).map(|sum| format!("{} {sum:04X}", String::from_utf8_lossy(note)));
    let note = sum.into_iter().find(|note| touchline::is_note(note.as_bytes())).unwrap();
    stream.take(format!("{note}\n").as_bytes());
    assert_eq!(stream.board.diagnosis(), Diagnosis::Frames, "an answer of the board's is no silence");
    // What was counted before the board was known for ours stays.
    let stats = stream.board.stats();
    let counted = (stats.frames_good, stats.frames_lost, stats.frames_discarded, stats.stalls);
    assert_eq!(counted, (4, 2, 3, 3));
}

#[test]
fn our_board_in_datastream_keeps_counts_and_clock() {
    let mut stream = Stream::new();
    let content = Content::Data(Flags::default());
    let line = touchline::Line { bank: 0, sequence: 1, device_us: 5, values: [700; 12], content };
    let mut bytes = Vec::new();
    touchline::emit(&line, &mut bytes);
    stream.take(&bytes);
    assert_eq!(stream.board.firmware(), Some(Firmware::Moca));
    let counted = stream.board.stats().frames_good;
    stream.now_ns += PERIOD_NS;
    stream.line(&counts(700), Line::Touch);
    assert_eq!((stream.board.firmware(), stream.board.stats().frames_good), (None, counted));
    // A chunk that comes later than any frame's is a stall.
    stream.now_ns += STALL_GAP_NS + 1;
    stream.line(&counts(700), Line::Touch);
    assert_eq!(stream.board.stats().stalls, 1);
    stream.now_ns += STALL_GAP_NS;
    stream.line(&counts(700), Line::Touch);
    assert_eq!(stream.board.stats().stalls, 1);
}

#[test]
fn a_port_that_does_not_open_is_a_lost_board_that_says_why() {
    let mut stream = Stream::new();
    stream.send(&counts(700));
    stream.board.open_failed(OpenFailure::Busy);
    assert_eq!(stream.board.diagnosis(), Diagnosis::NotOpen(OpenFailure::Busy));
    assert_eq!(stream.board.fault(stream.now_ns), Some(BoardFault::Lost));
}

#[test]
fn what_another_sketch_writes_says_which_one_it_is() {
    for (text, diagnosis) in [
        ("pin 3 was just touched", Diagnosis::WrongSketch),
        ("error setting up MPR121", Diagnosis::ChipInitFailed),
        ("good morning", Diagnosis::Unknown),
    ] {
        let mut stream = Stream::new();
        stream.take(b"\r\n");
        stream.take(format!("{text}\r\n").as_bytes());
        assert_eq!(stream.board.diagnosis(), diagnosis, "{text}");
        stream.take(b"good morning\r\n");
        assert_eq!(stream.board.diagnosis(), diagnosis, "what is known already says more");
    }
}

#[test]
fn bytes_without_frames_become_not_a_touch_board() {
    let mut stream = Stream::new();
    assert_eq!(stream.take(&[b'~'; 1200]), None);
    assert_eq!(stream.board.diagnosis(), Diagnosis::Silent);
    assert_eq!(stream.take(b"~"), None);
    assert_eq!(stream.board.diagnosis(), Diagnosis::Unknown);
    assert_eq!(stream.board.fault(SILENT_AFTER_NS), None);
    assert_eq!(stream.board.fault(SILENT_AFTER_NS + 1), Some(BoardFault::Silent));
}
