//! The MPR121 as its data sheet describes it, as far as a firmware can notice: registers, stop and run mode,
//! auto-configuration, charge times, two filters, a refresh electrode by electrode, an oscillator that is off.
//!
//! Assumed, because no text says: a sample takes twice the charge time and nothing else; each electrode's value changes
//! when its own last sample is done; words are not latched.

use std::f64::consts::TAU;

/// Electrodes of one chip.
pub const ELECTRODES: usize = 12;

const SUPPLY_V: f64 = 3.3;
/// Coded values repeat after this many refreshes: a prime, so that every step has an inverse.
const CODES: u64 = 251;
const CODE_BASE: u64 = 515;
const CODE_STEP: u64 = 37;
const CODE_ELECTRODE: u64 = 20;

/// Signal on the electrodes.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Signal {
    /// Each value encodes its refresh, so that a reader can tell its age: see [`Mpr121::sampled_at_us`].
    Coded,
    /// Counts of the capacitance, with this white noise at stock filter settings (10 × 10 samples), counts.
    Counts {
        /// Standard deviation, counts.
        noise: f64,
    },
}

/// One chip.
#[derive(Clone, Debug)]
pub struct Mpr121 {
    registers: [u8; 256],
    pointer: u8,
    running: bool,
    run_start_us: f64,
    refreshes: u64,
    sums: [f64; ELECTRODES],
    samples: u32,
    next_sample_us: f64,
    /// Readings of the previous and of the last refresh; the last one appears electrode by electrode.
    values: [[u16; ELECTRODES]; 2],
    shows_at_us: [f64; ELECTRODES],
    /// Middle of the window of each of the last refreshes, by number.
    centres_us: Vec<f64>,
    capacitance_pf: [f64; ELECTRODES],
    signal: Signal,
    clock: f64,
    random: u64,
    /// Writes that a chip in run mode ignored.
    pub refused_writes: u32,
    /// Does not answer its address.
    pub mute: bool,
    /// REXT is shorted.
    pub over_current: bool,
    /// Auto-configuration failed on electrode 2.
    pub out_of_range: bool,
}

impl Mpr121 {
    /// A chip after power-up. Its millisecond lasts `clock` ms; every electrode has `capacitance_pf`.
    pub fn new(clock: f64, signal: Signal, capacitance_pf: f64, seed: u64) -> Self {
        let mut chip = Self {
            registers: [0; 256],
            pointer: 0,
            running: false,
            run_start_us: 0.0,
            refreshes: 0,
            sums: [0.0; ELECTRODES],
            samples: 0,
            next_sample_us: f64::INFINITY,
            values: [[0; ELECTRODES]; 2],
            shows_at_us: [f64::INFINITY; ELECTRODES],
            centres_us: Vec::new(),
            capacitance_pf: [capacitance_pf; ELECTRODES],
            signal,
            clock,
            random: seed.wrapping_mul(0x9e37_79b9_7f4a_7c15) | 1,
            refused_writes: 0,
            mute: false,
            over_current: false,
            out_of_range: false,
        };
        chip.reset();
        chip
    }

    /// As after a dip of the supply.
    pub fn reset(&mut self) {
        self.registers = [0; 256];
        self.registers[0x5C] = 0x10;
        self.registers[0x5D] = 0x24;
        self.stop();
    }

    /// Sets what an electrode sees from now on, pF.
    pub fn set_capacitance_pf(&mut self, electrode: usize, picofarad: f64) {
        self.capacitance_pf[electrode] = picofarad;
    }

    /// When the value `fdat` of `electrode` was sampled (middle of the window), if it can have been read at `now_us`.
    pub fn sampled_at_us(&self, electrode: usize, fdat: u16, now_us: f64) -> Option<f64> {
        let offset = u64::from(fdat).checked_sub(CODE_BASE).filter(|offset| *offset < CODES)?;
        let electrode_code = u64::try_from(electrode).ok()? * CODE_ELECTRODE;
        let last = u64::try_from(self.centres_us.len()).ok()?;
        (0..last.min(CODES / 2)).map(|back| last - 1 - back).find_map(|refresh| {
            let centre = self.centres_us[usize::try_from(refresh).ok()?] + self.shift_us(electrode);
            let code = (refresh * CODE_STEP + electrode_code) % CODES;
            (code == offset && centre <= now_us).then_some(centre)
        })
    }

    /// First filter, second filter (samples) and time of a scan, us.
    pub fn filters(&self) -> (u32, u32, f64) {
        (self.first_filter(), self.second_filter(), self.scan_us(ELECTRODES))
    }

    /// Charge currents and times of the electrodes: what decides the gain.
    pub fn gain(&self) -> [u8; 20] {
        let mut gain = [0; 20];
        gain.copy_from_slice(&self.registers[0x5F..0x73]);
        gain
    }

    fn first_filter(&self) -> u32 {
        [6, 10, 18, 34][usize::from(self.registers[0x5C] >> 6)]
    }

    fn second_filter(&self) -> u32 {
        [4, 6, 10, 18][usize::from(self.registers[0x5D] >> 3 & 3)]
    }

    fn sample_interval_us(&self) -> f64 {
        1000.0 * f64::from(1u32 << (self.registers[0x5D] & 7)) * self.clock
    }

    fn charge_time_us(&self, electrode: usize) -> f64 {
        let own = self.registers[0x6C + electrode / 2] >> (4 * (electrode % 2)) & 7;
        let code = if own == 0 { self.registers[0x5D] >> 5 } else { own };
        0.5 * f64::from(1u32 << code.saturating_sub(1))
    }

    fn charge_current_ua(&self, electrode: usize) -> f64 {
        let own = self.registers[0x5F + electrode] & 63;
        f64::from(if own == 0 { self.registers[0x5C] & 63 } else { own })
    }

    /// Time that the first `electrodes` of a scan take, us.
    fn scan_us(&self, electrodes: usize) -> f64 {
        (0..electrodes).map(|e| f64::from(self.first_filter()) * 2.0 * self.charge_time_us(e)).sum()
    }

    /// Middle of an electrode's samples after the beginning of their scan, us.
    fn shift_us(&self, electrode: usize) -> f64 {
        0.5 * (self.scan_us(electrode) + self.scan_us(electrode + 1))
    }

    fn stop(&mut self) {
        self.running = false;
        self.next_sample_us = f64::INFINITY;
        self.samples = 0;
        self.sums = [0.0; ELECTRODES];
        self.values = [[0; ELECTRODES]; 2];
        self.shows_at_us = [f64::INFINITY; ELECTRODES];
    }

    fn start(&mut self, now_us: f64) {
        self.stop();
        self.running = true;
        let mut begin_us = now_us;
        if self.registers[0x7B] & 1 != 0 {
            self.configure();
            begin_us += 5000.0;
        }
        self.run_start_us = begin_us;
        self.next_sample_us = begin_us;
    }

    /// Current and time of each electrode that bring it nearest to the target.
    fn configure(&mut self) {
        let target = f64::from(self.registers[0x7F]) * 4.0;
        for electrode in 0..ELECTRODES {
            let fitting = (1u8..=7).find_map(|code| {
                let time_us = 0.5 * f64::from(1u32 << (code - 1));
                let current = target * SUPPLY_V * self.capacitance_pf[electrode] / 1024.0 / time_us;
                (current <= 63.0).then_some((code, current.round() as u8))
            });
            let Some((code, current)) = fitting else {
                self.registers[0x02 + electrode / 8] |= 1 << (electrode % 8);
                continue;
            };
            self.registers[0x5F + electrode] = current;
            let pair = &mut self.registers[0x6C + electrode / 2];
            let shift = 4 * (electrode % 2);
            *pair = *pair & !(7 << shift) | code << shift;
        }
    }

    /// Takes every sample that is due until `now_us`.
    pub fn advance(&mut self, now_us: f64) {
        while self.next_sample_us <= now_us {
            for (sum, picofarad) in self.sums.iter_mut().zip(self.capacitance_pf) {
                *sum += picofarad;
            }
            self.samples += 1;
            if self.samples == self.second_filter() {
                self.refresh();
            }
            self.next_sample_us += self.sample_interval_us();
        }
    }

    fn refresh(&mut self) {
        let samples = f64::from(self.samples);
        let window_us = (samples - 1.0) * self.sample_interval_us();
        self.centres_us.push(self.next_sample_us - 0.5 * window_us);
        self.values[0] = self.values[1];
        for electrode in 0..ELECTRODES {
            self.values[1][electrode] = match self.signal {
                Signal::Coded => self.code(electrode),
                Signal::Counts { noise } => self.counts(electrode, self.sums[electrode] / samples, noise),
            };
            self.shows_at_us[electrode] = self.next_sample_us + self.scan_us(electrode + 1);
        }
        self.refreshes += 1;
        self.samples = 0;
        self.sums = [0.0; ELECTRODES];
    }

    fn code(&self, electrode: usize) -> u16 {
        let refresh = self.centres_us.len() as u64 - 1;
        let code = CODE_BASE + (refresh * CODE_STEP + electrode as u64 * CODE_ELECTRODE) % CODES;
        code as u16
    }

    fn counts(&mut self, electrode: usize, picofarad: f64, noise: f64) -> u16 {
        let charge = self.charge_current_ua(electrode) * self.charge_time_us(electrode);
        let samples = f64::from(self.first_filter() * self.second_filter());
        let counts =
            charge * 1024.0 / (SUPPLY_V * picofarad) + noise * (100.0 / samples).sqrt() * self.normal();
        counts.round().clamp(0.0, 1023.0) as u16
    }

    fn uniform(&mut self) -> f64 {
        self.random ^= self.random << 13;
        self.random ^= self.random >> 7;
        self.random ^= self.random << 17;
        (self.random >> 11) as f64 / 9_007_199_254_740_992.0
    }

    fn normal(&mut self) -> f64 {
        (-2.0 * (self.uniform() + 1e-18).ln()).sqrt() * (TAU * self.uniform()).cos()
    }

    fn fdat(&self, electrode: usize, now_us: f64) -> u16 {
        self.values[usize::from(now_us >= self.shows_at_us[electrode])][electrode]
    }

    fn write(&mut self, register: u8, value: u8, now_us: f64) {
        if register == 0x80 {
            if value == 0x63 {
                self.reset();
            }
            return;
        }
        // ECR and GPIO alone are writable in run mode.
        if self.running && register != 0x5E && !(0x73..=0x7A).contains(&register) {
            self.refused_writes += 1;
            return;
        }
        self.registers[usize::from(register)] = value;
        if register == 0x5E {
            match (self.running, value & 0x3F != 0) {
                (false, true) => self.start(now_us),
                (true, false) => self.stop(),
                _ => {}
            }
        }
    }

    fn read(&self, register: u8, now_us: f64) -> u8 {
        let own = self.registers[usize::from(register)];
        match register {
            0x01 if self.over_current => own | 0x80,
            0x02 if self.out_of_range => own | 0x04,
            0x04..=0x1B => {
                let word = self.fdat(usize::from(register - 4) / 2, now_us).to_le_bytes();
                word[usize::from(register % 2)]
            }
            // The baseline follows at once: nobody presses for minutes here.
            0x1E..=0x29 => (self.values[0][usize::from(register - 0x1E)] >> 2) as u8,
            _ => own,
        }
    }
}

/// The chips of one bus.
#[derive(Clone, Debug, Default)]
pub struct Chips(Vec<(u8, Mpr121, Transfer)>);

#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
enum Transfer {
    #[default]
    Register,
    Data,
}

impl Chips {
    /// Puts a chip on the bus at a 7-bit address.
    pub fn add(&mut self, address: u8, chip: Mpr121) {
        self.0.push((address, chip, Transfer::default()));
    }

    /// The chip at an address.
    pub fn at(&mut self, address: u8) -> Option<&mut Mpr121> {
        self.entry(address).map(|(_, chip, _)| chip)
    }

    /// Every chip.
    pub fn iter_mut(&mut self) -> impl Iterator<Item = &mut Mpr121> {
        self.0.iter_mut().map(|(_, chip, _)| chip)
    }

    /// When the next sample of any chip is due, us.
    pub fn next_sample_us(&self) -> f64 {
        self.0.iter().map(|(_, chip, _)| chip.next_sample_us).fold(f64::INFINITY, f64::min)
    }

    fn entry(&mut self, address: u8) -> Option<&mut (u8, Mpr121, Transfer)> {
        self.0.iter_mut().find(|(own, ..)| *own == address)
    }

    /// Returns true if a chip acknowledges the address byte.
    pub(crate) fn select(&mut self, address_and_direction: u8, now_us: f64) -> bool {
        match self.entry(address_and_direction >> 1) {
            Some((_, chip, transfer)) if !chip.mute => {
                chip.advance(now_us);
                *transfer = if address_and_direction & 1 == 0 { Transfer::Register } else { Transfer::Data };
                true
            }
            _ => false,
        }
    }

    pub(crate) fn write(&mut self, address: u8, value: u8, now_us: f64) {
        let Some((_, chip, transfer)) = self.entry(address) else { return };
        match *transfer {
            Transfer::Register => {
                chip.pointer = value;
                *transfer = Transfer::Data;
            }
            Transfer::Data => {
                chip.write(chip.pointer, value, now_us);
                chip.pointer = chip.pointer.wrapping_add(1);
            }
        }
    }

    pub(crate) fn read(&mut self, address: u8, now_us: f64) -> u8 {
        let Some((_, chip, _)) = self.entry(address) else { return 0xFF };
        chip.advance(now_us);
        let value = chip.read(chip.pointer, now_us);
        chip.pointer = chip.pointer.wrapping_add(1);
        value
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn running(signal: Signal) -> Mpr121 {
        let mut chip = Mpr121::new(1.0, signal, 17.0, 1);
        for (register, value) in [(0x5C, 0xD0), (0x5D, 0x20), (0x7F, 180), (0x7B, 1), (0x5E, 0xCC)] {
            chip.write(register, value, 0.0);
        }
        chip
    }

    #[test]
    fn auto_configuration_brings_the_counts_to_the_target() {
        let mut chip = running(Signal::Counts { noise: 0.0 });
        chip.advance(20_000.0);
        let fdat = chip.fdat(0, 20_000.0);
        assert!(fdat.abs_diff(720) < 20, "{fdat}");
        assert_eq!(chip.filters(), (34, 4, 816.0), "17 pF are charged in 1 us");
    }

    #[test]
    fn a_value_tells_its_refresh_for_any_electrode() {
        let mut chip = running(Signal::Coded);
        chip.advance(1_000_000.0);
        for electrode in 0..ELECTRODES {
            let fdat = chip.fdat(electrode, 1_000_000.0);
            let age_us = 1_000_000.0 - chip.sampled_at_us(electrode, fdat, 1_000_000.0).unwrap();
            assert!((1_500.0..6_500.0).contains(&age_us), "electrode {electrode}: {age_us} us");
        }
    }

    #[test]
    fn run_mode_refuses_writes_and_a_reset_reads_zero() {
        let mut chip = running(Signal::Counts { noise: 0.0 });
        chip.write(0x5D, 0x24, 10_000.0);
        assert_eq!((chip.refused_writes, chip.read(0x5D, 10_000.0)), (1, 0x20));
        chip.reset();
        chip.advance(100_000.0);
        assert_eq!((chip.fdat(3, 100_000.0), chip.read(0x5D, 100_000.0)), (0, 0x24));
    }
}
