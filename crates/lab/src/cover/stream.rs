//! `moca-lab stream`: what the reader makes of a recorded byte stream.

use crate::study::Answer;
use anyhow::{Context, ensure};
use moca_experiments::count;
use moca_figures::progress::Progress;
use moca_msgs::{BoardFault, nanoseconds, seconds};
use moca_tactile::Firmware;
use moca_tactile::board::{BoardMonitor, Diagnosis, MAX_ELECTRODES, STALL_GAP_NS, SampledFrame};
use moca_tactile::datastream::{ELECTRODES, FDAT_MAX};
use moca_tactile::touchline::Flags;
use serde::Serialize;
use std::path::{Path, PathBuf};

/// Reads a recorded Touch Board stream: frames, rate, faults.
#[derive(clap::Args)]
pub(crate) struct Arguments {
    /// The bytes a board sent.
    file: PathBuf,
    /// One line for each read: seconds, bytes read. Without it there is no rate, age or stall.
    #[arg(long)]
    times: Option<PathBuf>,
    #[command(flatten)]
    answer: Answer,
}

/// Contents of a recording.
#[derive(Debug, Serialize)]
struct Report {
    /// Frames that passed every check.
    frames_good: u64,
    /// Frames that failed one; a partial frame at either end counts as neither.
    frames_bad: u64,
    /// Good frames not used: a stall made their age unknown, or the firmware says that their data is not fresh.
    frames_discarded: u64,
    /// Frames that never came, by the gaps in their sequence; a stock board has none.
    frames_lost: u64,
    /// Mean rate of good frames with gaps over 100 ms left out; null without times.
    rate_hz: Option<f64>,
    /// Firmware, from the lines; of a stock board from line spacing, so null without times (12 columns: Pi Cap).
    sketch: Option<&'static str>,
    /// Columns of a line; null without a good frame.
    columns: Option<u8>,
    /// Median over the frames of the worst age that their data can have when they are complete; null without times.
    age_ms: Option<f64>,
    /// State of the board, from its bytes.
    diagnosis: &'static str,
    /// In the order in which they were found.
    faults: Vec<StreamFault>,
}

#[derive(Debug, Serialize)]
struct StreamFault {
    /// When it was found, s; null without times.
    t_s: Option<f64>,
    /// Frames, good and bad, up to and with the one that showed it.
    frame: u64,
    kind: &'static str,
    text: String,
}

/// Reads, reports, prints.
pub(crate) fn run(arguments: &Arguments) -> anyhow::Result<()> {
    let bytes = std::fs::read(&arguments.file)
        .with_context(|| format!("cannot read stream {}", arguments.file.display()))?;
    let reads = match &arguments.times {
        Some(path) => Some(read_times(path, bytes.len())?),
        None => None,
    };
    let mut progress = Progress::new("stream");
    let report = analyse(&bytes, reads.as_deref(), |part| progress.at(part));
    progress.end();
    arguments.answer.print(&report, || Ok(as_text(&report)))
}

/// One read of the recording host.
#[derive(Clone, Copy)]
struct Read {
    arrival_ns: u64,
    bytes: usize,
}

fn read_times(path: &Path, stream_bytes: usize) -> anyhow::Result<Vec<Read>> {
    let text =
        std::fs::read_to_string(path).with_context(|| format!("cannot read times {}", path.display()))?;
    let mut reads = Vec::new();
    let mut last_s = 0.0;
    for (number, line) in text.lines().enumerate() {
        let context = || format!("{}:{}: expected `seconds bytes`, got {line:?}", path.display(), number + 1);
        let (seconds, bytes) = line.trim().split_once(char::is_whitespace).with_context(context)?;
        let seconds: f64 = seconds.parse().with_context(context)?;
        let bytes = bytes.trim().parse().with_context(context)?;
        ensure!(
            (last_s..1e9).contains(&seconds),
            "{}:{}: time {seconds} s is outside {last_s} to 1e9 s (times must not fall)",
            path.display(),
            number + 1
        );
        last_s = seconds;
        reads.push(Read { arrival_ns: nanoseconds(seconds), bytes });
    }
    let total: usize = reads.iter().map(|read| read.bytes).sum();
    ensure!(
        total == stream_bytes,
        "{} accounts for {total} bytes, but the stream has {stream_bytes}",
        path.display()
    );
    Ok(reads)
}

/// Bytes after which a stream without times tells how far it is.
const STRETCH: usize = 1 << 16;

/// Reads a stream; `told` hears which part is done, 0 to 1.
fn analyse(bytes: &[u8], reads: Option<&[Read]>, mut told: impl FnMut(f64)) -> Report {
    let mut analysis = Analysis::new(reads.is_some());
    let mut rest = bytes;
    let mut left = |rest: &[u8]| told(1.0 - count(rest.len()) / count(bytes.len().max(1)));
    match reads {
        Some(reads) => {
            for read in reads {
                let (chunk, after) = rest.split_at(read.bytes);
                analysis.chunk(chunk, read.arrival_ns);
                rest = after;
                left(rest);
            }
        }
        None => {
            while !rest.is_empty() {
                let end = line_end(rest, STRETCH);
                let (chunk, after) = rest.split_at(end);
                analysis.chunk(chunk, 0);
                rest = after;
                left(rest);
            }
        }
    }
    analysis.finish()
}

/// Length of the stretch that ends with the first line's end at or after `at`, or with the stream.
fn line_end(bytes: &[u8], at: usize) -> usize {
    let after = bytes.iter().skip(at).position(|&b| b == b'\n');
    after.map_or(bytes.len(), |more| at + more + 1)
}

/// A board monitor fed line by line, so that every fault is seen at the frame that shows it.
struct Analysis {
    timed: bool,
    monitor: BoardMonitor,
    last_arrival_ns: Option<u64>,
    last_good_ns: Option<u64>,
    intervals: u32,
    interval_sum_ns: u64,
    ages_ns: Vec<u64>,
    stream_fault: [bool; 6],
    saturated: [bool; MAX_ELECTRODES],
    faults: Vec<StreamFault>,
}

impl Analysis {
    fn new(timed: bool) -> Self {
        Self {
            timed,
            monitor: BoardMonitor::new([true; MAX_ELECTRODES]),
            last_arrival_ns: None,
            last_good_ns: None,
            intervals: 0,
            interval_sum_ns: 0,
            ages_ns: Vec::new(),
            stream_fault: [false; 6],
            saturated: [false; MAX_ELECTRODES],
            faults: Vec::new(),
        }
    }

    fn chunk(&mut self, chunk: &[u8], arrival_ns: u64) {
        if let Some(last_ns) = self.last_arrival_ns.replace(arrival_ns)
            && arrival_ns - last_ns > STALL_GAP_NS
        {
            let text = format!(
                "No byte was read for {:.3} s: the host stalled or the board paused. The next frame's data is as \
                 old as the gap and is not used.",
                seconds(arrival_ns - last_ns)
            );
            self.report("stall", text);
        }
        for line in chunk.split_inclusive(|&b| b == b'\n') {
            self.line(line, arrival_ns);
        }
    }

    fn line(&mut self, line: &[u8], arrival_ns: u64) {
        let before = *self.monitor.stats();
        let mut rest = line;
        let frame = self.monitor.next_frame(&mut rest, arrival_ns);
        let after = *self.monitor.stats();
        if after.frames_bad > before.frames_bad
            && let Some(why) = self.monitor.last_bad()
        {
            self.report("torn", format!("Bad frame: {why}."));
        }
        if after.frames_good > before.frames_good {
            self.measure_rate(arrival_ns);
            self.stream_faults();
        }
        if let Some(frame) = frame {
            self.ages_ns.push(frame.complete_ns.saturating_sub(frame.sampled_at_ns));
            self.saturation(&frame);
        }
    }

    fn measure_rate(&mut self, arrival_ns: u64) {
        if let Some(last_ns) = self.last_good_ns.replace(arrival_ns) {
            let interval_ns = arrival_ns - last_ns;
            if interval_ns < STALL_GAP_NS {
                self.intervals += 1;
                self.interval_sum_ns += interval_ns;
            }
        }
    }

    /// Reports the onset of each fault that well-formed frames can hide, or that the firmware itself reports.
    fn stream_faults(&mut self) {
        let flags = self.monitor.flags();
        let faults = [
            (self.monitor.is_all_zero(), "all_zero", BoardFault::Reset),
            (self.monitor.is_frozen(), "frozen", BoardFault::Frozen),
            (self.monitor.thresholds_changed(), "thresholds", BoardFault::Thresholds),
            (flags.has(Flags::CHIP_RESET), "chip_reset", BoardFault::Reset),
            (flags.bus_fault(), "bus", BoardFault::Frozen),
            (flags.has(Flags::OVER_CURRENT), "over_current", BoardFault::Chip),
        ];
        for (i, (present, kind, fault)) in faults.into_iter().enumerate() {
            // a reset chip's zeros do not change either: one cause, one fault
            let present = present && !(kind == "frozen" && self.monitor.is_all_zero());
            if present && !self.stream_fault[i] {
                let mut text = fault.text().to_owned();
                if kind == "frozen" {
                    text += &format!(" {} frames were identical.", self.monitor.identical_frames() + 1);
                }
                self.report(kind, text);
            }
            self.stream_fault[i] = present;
        }
    }

    fn saturation(&mut self, frame: &SampledFrame) {
        for (own, &fdat) in frame.fdat.iter().enumerate() {
            let electrode = usize::from(frame.bank) * ELECTRODES + own;
            let saturated = (fdat == 0 || fdat == FDAT_MAX) && !self.monitor.is_all_zero();
            if saturated && !self.saturated[electrode] {
                self.report(
                    "saturated",
                    format!("Electrode E{electrode} reads {fdat}, an end of its range."),
                );
            }
            self.saturated[electrode] = saturated;
        }
    }

    fn report(&mut self, kind: &'static str, text: String) {
        let stats = self.monitor.stats();
        let t_s = self.last_arrival_ns.filter(|_| self.timed).map(seconds);
        self.faults.push(StreamFault { t_s, frame: stats.frames_good + stats.frames_bad, kind, text });
    }

    fn finish(mut self) -> Report {
        let diagnosis = self.monitor.diagnosis();
        let kind = match diagnosis {
            Diagnosis::WrongSketch => Some("wrong_sketch"),
            Diagnosis::ChipInitFailed => Some("chip_init"),
            Diagnosis::Unknown => Some("no_frames"),
            Diagnosis::Silent => Some("silent"),
            Diagnosis::Frames | Diagnosis::NoBoard | Diagnosis::NotOpen(_) | Diagnosis::Disconnected => None,
        };
        if let Some(kind) = kind {
            self.report(kind, diagnosis.text().to_owned());
        }
        self.ages_ns.sort_unstable();
        let median_age_ns = self.ages_ns.get(self.ages_ns.len() / 2).copied();
        let stats = *self.monitor.stats();
        let columns = self.monitor.columns();
        Report {
            frames_good: stats.frames_good,
            frames_bad: stats.frames_bad,
            frames_discarded: stats.frames_discarded,
            frames_lost: stats.frames_lost,
            rate_hz: (self.timed && self.intervals > 0)
                .then(|| f64::from(self.intervals) / seconds(self.interval_sum_ns)),
            sketch: self
                .monitor
                .firmware()
                .filter(|firmware| self.timed || matches!(firmware, Firmware::PiCap | Firmware::Moca))
                .map(Firmware::name),
            columns,
            age_ms: median_age_ns.filter(|_| self.timed).map(|age_ns| 1e3 * seconds(age_ns)),
            diagnosis: diagnosis.text(),
            faults: self.faults,
        }
    }
}

fn as_text(report: &Report) -> String {
    let number = |value: Option<f64>, unit: &str| match value {
        Some(value) => format!("{value:.2} {unit}"),
        None => "not known without --times".to_owned(),
    };
    let mut text = format!(
        "frames: {} good, {} bad, {} not used, {} lost\nrate: {}\nage of the data when a frame is complete: {}\n\
         sketch: {}\ncolumns: {}\n{}\n",
        report.frames_good,
        report.frames_bad,
        report.frames_discarded,
        report.frames_lost,
        number(report.rate_hz, "Hz"),
        number(report.age_ms, "ms at worst"),
        report.sketch.unwrap_or("not known"),
        report.columns.map_or_else(|| "not known".to_owned(), |columns| columns.to_string()),
        report.diagnosis,
    );
    for fault in &report.faults {
        let at = match fault.t_s {
            Some(t_s) => format!("{t_s:.3} s"),
            None => format!("frame {}", fault.frame),
        };
        text += &format!("fault at {at}: {}: {}\n", fault.kind, fault.text);
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;
    use moca_experiments::TAXELS;
    use moca_sim::board::{BoardFailure, VirtualBoard, VirtualBoardConfig};

    fn report(name: &str, timed: bool) -> Report {
        let folder = PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("../../tests/fixtures/recordings");
        let bytes = std::fs::read(folder.join(format!("{name}.txt"))).unwrap();
        let times = folder.join(format!("{name}.times"));
        let reads = timed.then(|| read_times(&times, bytes.len()).unwrap());
        analyse(&bytes, reads.as_deref(), |_| ())
    }

    fn kinds(report: &Report) -> Vec<&str> {
        report.faults.iter().map(|fault| fault.kind).collect()
    }

    #[test]
    fn the_four_recordings_read_as_documented() {
        for timed in [false, true] {
            for (name, good, bad, expected) in [
                ("datastream-2020", 202, 0, vec![]),
                ("datastream-2020-host-stall", 160, 1, vec!["stall", "torn"]),
                ("datastream-2020-i2c-lost", 289, 0, vec!["thresholds", "frozen"]),
                ("datastream-2020-chip-reset", 223, 0, vec!["thresholds", "all_zero"]),
            ] {
                let report = report(name, timed);
                assert_eq!((report.frames_good, report.frames_bad), (good, bad), "{name}");
                let mut found = kinds(&report);
                let mut expected = expected;
                expected.retain(|&kind| timed || kind != "stall");
                found.sort_unstable();
                expected.sort_unstable();
                assert_eq!(found, expected, "{name}: {:?}", report.faults);
                assert_eq!(report.rate_hz.is_some(), timed);
                assert!(report.faults.iter().all(|fault| fault.t_s.is_some() == timed));
            }
        }
    }

    #[test]
    fn progress_rises_to_one_and_does_not_change_the_report() {
        let once = report("datastream-2020-i2c-lost", false);
        let folder = PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("../../tests/fixtures/recordings");
        let bytes = std::fs::read(folder.join("datastream-2020.txt")).unwrap().repeat(20);
        let mut parts = Vec::new();
        let report = analyse(&bytes, None, |part| parts.push(part));
        assert!(report.frames_good > once.frames_good);
        assert!(parts.len() > 2 && parts.is_sorted(), "{parts:?}");
        assert!((parts[parts.len() - 1] - 1.0).abs() < 1e-12, "{parts:?}");
    }

    #[test]
    fn rate_age_and_sketch_of_the_stock_board() {
        let report = report("datastream-2020", true);
        assert!((report.rate_hz.unwrap() - 40.5).abs() < 0.5, "{report:?}");
        assert_eq!(report.sketch, Some("stock-2018"));
        let age_ms = report.age_ms.unwrap();
        assert!(
            (age_ms - 35.0).abs() < 1.5,
            "20 ms from read to DIFF and up to 15 ms in the chip, got {age_ms}"
        );
    }

    #[test]
    fn a_factory_board_and_noise_are_named() {
        let factory = analyse(b"pin 3 was just touched\r\npin 3 was just released\r\n", None, |_| ());
        assert_eq!(kinds(&factory), ["wrong_sketch"]);
        assert_eq!(kinds(&analyse(b"\x00\xff\x80hello\n", None, |_| ())), ["no_frames"]);
        assert_eq!(kinds(&analyse(b"", None, |_| ())), ["silent"]);
        assert_eq!(kinds(&analyse(&[b'7'; 100_000], None, |_| ())), ["no_frames"]);
    }

    /// 4 s of a virtual board, read each millisecond; `fault` strikes after 2 s.
    fn record(sketch: Firmware, fault: Option<BoardFailure>) -> (Vec<u8>, Vec<Read>) {
        let mut board =
            VirtualBoard::new(VirtualBoardConfig { firmware: sketch, ..Default::default() }).unwrap();
        let (mut bytes, mut reads) = (Vec::new(), Vec::new());
        for millisecond in 1..4000 {
            if millisecond == 2000 {
                board.set_fault(fault);
            }
            let arrival_ns = millisecond * 1_000_000;
            let before = bytes.len();
            board.advance(arrival_ns, &[0.0; TAXELS], &mut |line| bytes.extend_from_slice(line));
            if bytes.len() > before {
                reads.push(Read { arrival_ns, bytes: bytes.len() - before });
            }
        }
        (bytes, reads)
    }

    #[test]
    fn other_generations_are_recognised_and_fail_in_their_own_way() {
        use Firmware::{PiCap, Stock2015, Stock2018};
        for (sketch, rate_hz, columns) in [(Stock2015, 67.5, 13), (Stock2018, 40.5, 13), (PiCap, 67.5, 12)] {
            let (bytes, reads) = record(sketch, None);
            let report = analyse(&bytes, Some(&reads), |_| ());
            assert!((report.rate_hz.unwrap() / rate_hz - 1.0).abs() < 0.02, "{report:?}");
            assert_eq!((report.sketch, report.columns), (Some(sketch.name()), Some(columns)));
            assert!(report.faults.is_empty() && report.frames_bad == 0, "{report:?}");
            let untimed = analyse(&bytes, None, |_| ());
            assert_eq!(untimed.frames_good, report.frames_good);

            let (bytes, reads) = record(sketch, Some(BoardFailure::ChipReset));
            assert!(kinds(&analyse(&bytes, Some(&reads), |_| ())).contains(&"all_zero"));
            let (bytes, reads) = record(sketch, Some(BoardFailure::I2cLost));
            let report = analyse(&bytes, Some(&reads), |_| ());
            assert!(kinds(&report).contains(&"frozen"), "{report:?}");
            assert_eq!(
                kinds(&report).contains(&"thresholds"),
                sketch == Stock2018,
                "older sketches keep theirs"
            );
        }
    }
}
