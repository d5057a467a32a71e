//! `mocad doctor --board`: what one board on the desk does, beside what its simulation says it should do; a report to send
//! back. See docs/what-no-hardware-has-confirmed.md.
#![expect(clippy::print_stdout, reason = "this module is what the user sees on the terminal")]

use crate::config::{AUTO_PORT, Config};
use crate::devices::ports;
use anyhow::{Context, Result, bail};
use moca_figures::progress;
use moca_tactile::Firmware;
use moca_tactile::board::{BoardMonitor, MAX_ELECTRODES};
use moca_tactile::datastream::ELECTRODES;
use moca_tactile::touchline::{Content, Flags, is_note, parse};
use std::io::ErrorKind;
use std::time::{Duration, Instant};

/// Questions to the board.
const QUESTIONS: [&str; 4] = ["ID?", "SET?", "THR?", "STAT?"];
/// Nothing is measured before the port has settled.
const SETTLE: Duration = Duration::from_millis(1500);

/// Listens to each board of the configuration for `length` and prints its report.
///
/// # Errors
/// A port cannot be opened, or is lost.
pub(super) fn run(config: &Config, length: Duration) -> Result<()> {
    let looked_for = [AUTO_PORT.to_owned()];
    let ports = if config.board.port.are_virtual() { &looked_for[..] } else { &config.board.port };
    ports.iter().try_for_each(|port| listen(port, length))
}

fn listen(port: &str, length: Duration) -> Result<()> {
    let mut line = ports::talk(port)?;
    for question in QUESTIONS {
        line.write_all(format!("{question}\n").as_bytes())
            .with_context(|| format!("ask {port} {question}"))?;
        std::thread::sleep(Duration::from_millis(30));
    }
    println!("Listening to the board at {port:?} for {:.0} s. Nobody may touch it.", length.as_secs_f64());
    let bar = progress::during(port, SETTLE + length);
    let (start, mut bench, mut buffer) = (Instant::now(), Bench::new(), [0; 512]);
    while start.elapsed() < SETTLE + length {
        match line.read(&mut buffer) {
            Ok(0) => bail!("the board at {port:?} was unplugged"),
            Ok(count) => {
                let arrival_ns = u64::try_from(start.elapsed().as_nanos()).unwrap_or(u64::MAX);
                // What waited in a buffer meanwhile came all at once.
                if start.elapsed() >= SETTLE {
                    bench.take(&buffer[..count], arrival_ns);
                } else {
                    bench.answers(&buffer[..count]);
                }
            }
            Err(error) if matches!(error.kind(), ErrorKind::TimedOut | ErrorKind::Interrupted) => {}
            Err(error) => return Err(error).with_context(|| format!("read {port}")),
        }
    }
    drop(bar);
    print!("{}", bench.report());
    Ok(())
}

/// Everything that is counted. Pure: bytes and arrival times in, text out.
struct Bench {
    monitor: BoardMonitor,
    text: Vec<u8>,
    notes: Vec<String>,
    /// (arrival ns, stamp us) of each data line.
    stamps: Vec<(u64, u32)>,
    refreshes: u64,
    continued: u64,
    bank_of_first: Option<u8>,
    last_refresh_ns: Option<u64>,
    longest_ns: u64,
    noise: [Noise; MAX_ELECTRODES],
}

/// Welford's running variance.
#[derive(Clone, Copy, Default)]
struct Noise {
    count: f64,
    mean: f64,
    squares: f64,
}

impl Noise {
    fn take(&mut self, value: f64) {
        self.count += 1.0;
        let delta = value - self.mean;
        self.mean += delta / self.count;
        self.squares += delta * (value - self.mean);
    }

    fn deviation(&self) -> f64 {
        (self.squares / (self.count - 1.0).max(1.0)).sqrt()
    }
}

impl Bench {
    fn new() -> Self {
        Self {
            monitor: BoardMonitor::new([true; MAX_ELECTRODES]),
            text: Vec::new(),
            notes: Vec::new(),
            stamps: Vec::new(),
            refreshes: 0,
            continued: 0,
            bank_of_first: None,
            last_refresh_ns: None,
            longest_ns: 0,
            noise: [Noise::default(); MAX_ELECTRODES],
        }
    }

    fn take(&mut self, bytes: &[u8], arrival_ns: u64) {
        let mut rest = bytes;
        while let Some(frame) = self.monitor.next_frame(&mut rest, arrival_ns) {
            let first = usize::from(frame.bank) * ELECTRODES;
            for (noise, fdat) in self.noise[first..].iter_mut().zip(frame.fdat) {
                noise.take(f64::from(fdat));
            }
        }
        for line in self.lines(bytes) {
            if let Ok(line) = parse(&line)
                && let Content::Data(flags) = line.content
                && line.bank == *self.bank_of_first.get_or_insert(line.bank)
            {
                self.data(arrival_ns, line.device_us, flags);
            }
        }
    }

    /// Takes answers alone.
    fn answers(&mut self, bytes: &[u8]) {
        self.lines(bytes);
    }

    /// The lines that `bytes` end; answers among them are kept.
    fn lines(&mut self, bytes: &[u8]) -> Vec<Vec<u8>> {
        let mut lines = Vec::new();
        for &byte in bytes {
            // a line of any board is shorter
            match byte {
                b'\n' => lines.push(std::mem::take(&mut self.text)),
                _ if self.text.len() < 256 => self.text.push(byte),
                _ => {}
            }
        }
        let notes = lines.iter().filter(|line| is_note(line));
        self.notes.extend(notes.map(|line| String::from_utf8_lossy(&line[..line.len() - 5]).into_owned()));
        lines
    }

    fn data(&mut self, arrival_ns: u64, device_us: u32, flags: Flags) {
        self.stamps.push((arrival_ns, device_us));
        if flags.has(Flags::CONTINUES) {
            self.continued += 1;
        } else if flags.is_new() {
            self.refreshes += 1;
            if let Some(last_ns) = self.last_refresh_ns.replace(arrival_ns) {
                self.longest_ns = self.longest_ns.max(arrival_ns - last_ns);
            }
        }
    }

    /// Arrival − stamp of each line, us, and the drift of the board's clock against this PC's, ppm.
    fn transport(&self) -> (Vec<f64>, f64) {
        let Some(&(_, first_us)) = self.stamps.first() else { return (Vec::new(), 0.0) };
        let offsets: Vec<(f64, f64)> = self
            .stamps
            .iter()
            .map(|(arrival_ns, us)| {
                let device_us = f64::from(us.wrapping_sub(first_us));
                #[expect(clippy::cast_precision_loss, reason = "minutes in ns")]
                let arrival_us = *arrival_ns as f64 * 1e-3;
                (device_us, arrival_us - device_us)
            })
            .collect();
        // the fastest line of the first and of the last quarter
        let quarter = offsets.len().div_ceil(4);
        let fastest = |part: &[(f64, f64)]| {
            part.iter()
                .copied()
                .fold((0.0, f64::INFINITY), |best, one| if one.1 < best.1 { one } else { best })
        };
        let (begin, end) = (fastest(&offsets[..quarter]), fastest(&offsets[offsets.len() - quarter..]));
        let drift = (end.1 - begin.1) / (end.0 - begin.0).max(1.0);
        let mut late: Vec<f64> =
            offsets.iter().map(|(us, offset)| offset - begin.1 - drift * (us - begin.0)).collect();
        late.sort_unstable_by(f64::total_cmp);
        (late, 1e6 * drift)
    }

    fn report(&self) -> String {
        let stats = self.monitor.stats();
        let firmware = self.monitor.firmware();
        let mut rows = vec![
            ("firmware", firmware.map_or("none recognised", Firmware::name).to_owned(), "moca"),
            ("diagnosis", self.monitor.diagnosis().text().to_owned(), ""),
            ("frames a second", format!("{:.1}", self.monitor.rate_hz()), "247 (moca), 40.5 or 67.5 (stock)"),
            (
                "frames good, bad, lost",
                format!("{}, {}, {}", stats.frames_good, stats.frames_bad, stats.frames_lost),
                "0 bad, 0 lost",
            ),
        ];
        if firmware == Some(Firmware::Moca) {
            let (late, drift_ppm) = self.transport();
            let share = |q: f64| {
                #[expect(
                    clippy::cast_possible_truncation,
                    clippy::cast_sign_loss,
                    clippy::cast_precision_loss,
                    reason = "an index"
                )]
                let place = (q * (late.len().max(1) - 1) as f64) as usize;
                late.get(place).copied().unwrap_or(f64::NAN) * 1e-3
            };
            #[expect(clippy::cast_precision_loss, reason = "counts of a few minutes")]
            let continued = 100.0 * self.continued as f64 / (self.refreshes + self.continued).max(1) as f64;
            #[expect(clippy::cast_precision_loss, reason = "below a minute")]
            let longest_ms = self.longest_ns as f64 * 1e-6;
            rows.extend([
                ("longest between refreshes", format!("{longest_ms:.1} ms"), "at most 6 ms"),
                ("lines that continue one", format!("{continued:.1} %"), "8 %"),
                ("board's clock", format!("{drift_ppm:+.0} ppm"), "within 2500"),
                (
                    "later than the fastest line",
                    format!("50 % {:.2}, 99 % {:.2}, largest {:.2} ms", share(0.5), share(0.99), share(1.0)),
                    "about 0.5, 1.0, 1.1",
                ),
                ("flags of the last lines", format!("{:02X}", self.monitor.flags().0), "01 or 03"),
            ]);
        }
        let mut out = String::from("\nBOARD REPORT\n");
        for (what, found, expected) in rows {
            let expected =
                if expected.is_empty() { String::new() } else { format!("   (expected: {expected})") };
            out += &format!("  {what:<28}{found}{expected}\n");
        }
        for (electrode, noise) in self.noise.iter().enumerate().filter(|(_, noise)| noise.count > 1.0) {
            out += &format!(
                "  E{electrode:<3} at rest {:>7.1} counts, noise {:.2} (expected: 0.6 to 0.8)\n",
                noise.mean,
                noise.deviation()
            );
        }
        match self.notes.as_slice() {
            [] => out += "  no answer to ID? SET? THR? STAT? (a stock board gives none)\n",
            notes => notes.iter().for_each(|note| out += &format!("  {note}\n")),
        }
        out
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_report_of_a_recorded_stream_names_what_was_asked_for() {
        let folder = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("../../tests/fixtures/recordings");
        let stream = std::fs::read(folder.join("moca-touch.txt")).unwrap();
        let times = std::fs::read_to_string(folder.join("moca-touch.times")).unwrap();
        let (mut bench, mut at) = (Bench::new(), 0);
        for line in times.lines() {
            let (seconds, count) = line.split_once(' ').unwrap();
            let count: usize = count.parse().unwrap();
            #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "a few seconds")]
            let arrival_ns = (seconds.parse::<f64>().unwrap() * 1e9) as u64;
            bench.take(&stream[at..at + count], arrival_ns);
            at += count;
        }
        bench.take(b"# moca-touch 1 chips C name - 695E\n", 4_000_000_000);
        let report = bench.report();
        println!("{report}");
        let (late, drift_ppm) = bench.transport();
        assert!(drift_ppm.abs() < 60.0, "one clock in the simulation: {drift_ppm} ppm");
        assert!(
            late.first().is_some_and(|us| us.abs() < 60.0) && late.last().is_some_and(|us| *us < 2_000.0)
        );
        assert!((0.5..0.9).contains(&bench.noise[0].deviation()), "{}", bench.noise[0].deviation());
        for part in ["moca", "ppm", "E11", "# moca-touch 1 chips C name -"] {
            assert!(report.contains(part), "{part}: {report}");
        }
    }
}
