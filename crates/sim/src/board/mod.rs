//! A Touch Board that exists only in memory: true forces in, the bytes of its firmware out, at a real board's rate and
//! age. Time is an argument, so a run is as deterministic as its seed.
//!
//! Ages of a stock board's data, as traced from its firmware: foam → chip (a sample each millisecond, FDAT refreshed every
//! 10 ms with their mean) → one I²C read a frame → six lines printed one after the other. Our own firmware: a refresh every
//! 4 ms, a read each millisecond, one line as soon as a value changed.

mod stamped;

use crate::error::{SimError, within};
use crate::foam::{Foam, FoamState};
use crate::sensor::{CoverSensor, Effects, SAMPLE_INTERVAL_NS};
use moca_tactile::Firmware;
use moca_tactile::datastream::{Dialect, ELECTRODES, Frame, Line, MAX_COLUMNS, MAX_LINE_BYTES, emit_line};

use stamped::StampedBoard;

/// The board feels nobody who does not touch it, m to each taxel.
const FAR: [f64; ELECTRODES] = [f64::INFINITY; ELECTRODES];
/// Stock touch and release thresholds, counts.
const THRESHOLDS: (u8, u8) = (40, 20);
/// With the chip lost on I²C a frame takes this percentage of its normal time (17.8 ms for 24.7 ms, traced).
const I2C_LOST_PERCENT: u64 = 72;

/// Kind of a board, and its disturbances.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct VirtualBoardConfig {
    /// Frame rate and age follow from it.
    pub firmware: Firmware,
    /// Foam under the plates; the scene's.
    pub foam: Foam,
    /// Disturbances.
    pub effects: Effects,
    /// Standard deviation of one FDAT value, counts; `None` takes the foam's.
    pub noise_counts: Option<f64>,
    /// Seed of the noise.
    pub seed: u64,
    /// Period of a stock frame if it is not the firmware's, ns, 1 ms to 1 s: every part of the frame takes its share.
    pub frame_period_ns: Option<u64>,
    /// When the first frame is read, ns: the board's phase against the loop.
    pub first_read_ns: u64,
    /// Reading of the board's clock at time 0, us; of our own firmware.
    pub clock_start_us: u32,
}

impl Default for VirtualBoardConfig {
    /// Stock sketch of 2020 over the paper's foam.
    fn default() -> Self {
        Self {
            firmware: Firmware::Stock2018,
            foam: Foam::default(),
            effects: Effects::default(),
            noise_counts: None,
            seed: 1,
            frame_period_ns: None,
            first_read_ns: 5_000_000,
            clock_start_us: 0,
        }
    }
}

/// Fault of a board, as seen on the firmware.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum BoardFailure {
    /// I²C to the chip lost. Stock: good frames go on a little faster, FDAT frozen, thresholds garbage (newer sketch).
    /// Our own firmware says so, 50 times a second.
    I2cLost,
    /// The chip reset. Stock: every value 0 from now on. Our own firmware says so and is back 22 ms later.
    ChipReset,
    /// The bus is stuck: no bytes, the port stays open.
    Silent,
}

/// The board. `advance` allocates nothing.
#[derive(Clone, Debug)]
pub struct VirtualBoard {
    firmware: Firmware,
    /// The board with our own firmware; the fields below are a stock board's.
    stamped: Option<StampedBoard>,
    frame_period_ns: u64,
    foam: Foam,
    foams: [FoamState; ELECTRODES],
    sensor: CoverSensor<ELECTRODES>,
    fault: Option<BoardFailure>,
    frame: Frame,
    next_sample_ns: u64,
    read_ns: u64,
    /// Next line of the current frame to come out; 6 when the frame is done.
    next_line: usize,
}

/// One line's bytes.
struct LineBuffer {
    bytes: [u8; MAX_LINE_BYTES + 2],
    len: usize,
}

impl Extend<u8> for LineBuffer {
    fn extend<I: IntoIterator<Item = u8>>(&mut self, bytes: I) {
        for byte in bytes {
            if let Some(place) = self.bytes.get_mut(self.len) {
                *place = byte;
                self.len += 1;
            }
        }
    }
}

impl VirtualBoard {
    /// A board with nobody touching the cover.
    ///
    /// # Errors
    /// A noise or an effect outside its range.
    pub fn new(config: VirtualBoardConfig) -> Result<Self, SimError> {
        let noise_counts = config.noise_counts.unwrap_or(config.foam.noise_counts);
        let effects = &config.effects;
        config.foam.check()?;
        within("noise_counts", "counts", &[noise_counts], 0.0, 100.0)?;
        within("drift_counts_per_min", "counts/min", &[effects.drift_counts_per_min], -1000.0, 1000.0)?;
        within("crosstalk", "", &[effects.crosstalk], 0.0, 1.0)?;
        within("supply_noise", "", &[effects.supply_noise], 0.0, 0.1)?;
        if let Some(period_ns) = config.frame_period_ns {
            #[expect(clippy::cast_precision_loss, reason = "shown to a person")]
            let value = period_ns as f64;
            within("frame_period_ns", "ns", &[value], 1e6, 1e9)?;
        }
        let sensor = || CoverSensor::new(config.foam, config.effects, config.seed);
        let stamped = (config.firmware == Firmware::Moca).then(|| {
            let sensor = sensor()
                .with_noise(stamped::NOISE_SHARE * noise_counts)
                .with_samples_per_value(stamped::SAMPLES_PER_VALUE);
            StampedBoard::new(config.foam, sensor, config.first_read_ns, config.clock_start_us)
        });
        let mut board = Self {
            firmware: config.firmware,
            stamped,
            frame_period_ns: config.frame_period_ns.unwrap_or(config.firmware.frame_period_ns()),
            foam: config.foam,
            foams: [FoamState::default(); ELECTRODES],
            sensor: sensor().with_noise(noise_counts),
            fault: None,
            frame: Frame { dialect: dialect(config.firmware), ..Frame::default() },
            next_sample_ns: SAMPLE_INTERVAL_NS,
            read_ns: config.first_read_ns,
            next_line: 0,
        };
        // The chip has been running: its first value is there before the first read.
        for _ in 0..crate::sensor::SAMPLES_PER_VALUE {
            board.sensor.sample(&[0.0; ELECTRODES], &FAR);
        }
        board.read_chip();
        Ok(board)
    }

    /// Makes the board fail, or heals it.
    pub fn set_fault(&mut self, fault: Option<BoardFailure>) {
        self.fault = fault;
    }

    /// Lets the board run until `now_ns` with steady true forces on its electrodes (N, T1 first; no more than it has)
    /// and gives every line to `sink` once it is completely out. A force that is not finite counts as none.
    pub fn advance(&mut self, now_ns: u64, force_n: &[f64], sink: &mut impl FnMut(&[u8])) {
        if let Some(stamped) = &mut self.stamped {
            return stamped.advance(now_ns, force_n, self.fault, sink);
        }
        loop {
            let line_ns = self.next_line_ns();
            let next_ns = self.next_sample_ns.min(line_ns);
            if next_ns > now_ns {
                return;
            }
            if self.next_sample_ns <= line_ns {
                self.sample(force_n);
            } else {
                self.print_line(sink);
            }
        }
    }

    /// When the next line is out, or the next frame is read if all lines are, ns.
    fn next_line_ns(&self) -> u64 {
        let after_read_ns = match self.firmware.line_offset_ns().get(self.next_line) {
            Some(&offset_ns) => offset_ns,
            None => self.firmware.frame_period_ns(),
        };
        self.read_ns + self.hurried(after_read_ns)
    }

    /// A part of a frame as this board takes it; without an answer from the chip every part is quicker.
    fn hurried(&self, of_sketch_ns: u64) -> u64 {
        let normal_ns = of_sketch_ns * self.frame_period_ns / self.firmware.frame_period_ns();
        match self.fault {
            Some(BoardFailure::I2cLost) => normal_ns * I2C_LOST_PERCENT / 100,
            _ => normal_ns,
        }
    }

    fn sample(&mut self, force_n: &[f64]) {
        const DT_S: f64 = 1e-3;
        let mut deformation_m = [0.0; ELECTRODES];
        for (i, (foam, force_n)) in self.foams.iter_mut().zip(force_n).enumerate() {
            let force_n = if force_n.is_finite() { *force_n } else { 0.0 };
            deformation_m[i] = foam.step_force(&self.foam, force_n, DT_S);
        }
        self.sensor.sample(&deformation_m, &FAR);
        self.next_sample_ns += SAMPLE_INTERVAL_NS;
    }

    fn print_line(&mut self, sink: &mut impl FnMut(&[u8])) {
        let Some(&line) = Line::ALL.get(self.next_line) else {
            self.read_ns += self.hurried(self.firmware.frame_period_ns());
            self.next_line = 0;
            self.read_chip();
            return;
        };
        self.next_line += 1;
        if self.fault == Some(BoardFailure::Silent) {
            return;
        }
        let mut buffer = LineBuffer { bytes: [0; MAX_LINE_BYTES + 2], len: 0 };
        emit_line(&self.frame, line, &mut buffer);
        sink(&buffer.bytes[..buffer.len]);
    }

    /// The sketch's I²C read of all registers.
    fn read_chip(&mut self) {
        match self.fault {
            Some(BoardFailure::ChipReset) => {
                self.frame = Frame { dialect: self.frame.dialect, ..Frame::default() };
            }
            Some(BoardFailure::I2cLost) => {
                if self.firmware == Firmware::Stock2018 {
                    let garbage: [u8; MAX_COLUMNS] = [0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12];
                    self.frame.touch_threshold = garbage;
                    self.frame.release_threshold = garbage;
                }
            }
            Some(BoardFailure::Silent) | None => self.read_healthy_chip(),
        }
    }

    fn read_healthy_chip(&mut self) {
        let columns = usize::from(self.frame.dialect.columns);
        let (touch, release) = THRESHOLDS;
        self.frame.touch_threshold[..columns].fill(touch);
        self.frame.release_threshold[..columns].fill(release);
        self.frame.filtered[..ELECTRODES].copy_from_slice(self.sensor.fdat());
        self.frame.baseline[..ELECTRODES].copy_from_slice(&self.sensor.baseline());
        for column in 0..ELECTRODES {
            let threshold = if self.frame.touched[column] { release } else { touch };
            self.frame.touched[column] = self.frame.difference(column) >= i16::from(threshold);
        }
    }
}

const fn dialect(firmware: Firmware) -> Dialect {
    match firmware {
        Firmware::PiCap => Dialect::PI_CAP,
        _ => Dialect::TOUCH_BOARD,
    }
}
