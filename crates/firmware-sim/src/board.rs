//! The board on a desk: processor, chips, cable, and what can be done to them.

use crate::identity::Identity;
use crate::mcu::{CYCLES_PER_US, Hex, Mcu};
use crate::mpr121::{Chips, Mpr121, Signal};
use anyhow::Result;

/// Settings of a simulated board.
#[derive(Clone, Debug, PartialEq)]
pub struct Settings {
    /// Addresses of the chips on its bus; the board's own is 0x5C.
    pub chips: Vec<u8>,
    /// Duration of one millisecond of the chips' oscillators, ms.
    pub chip_clock: f64,
    /// Capacitance of every electrode at rest (plate 5 pF and wire), pF.
    pub capacitance_pf: f64,
    /// Signal on the electrodes.
    pub signal: Signal,
    /// Time between two polls of the USB host, us.
    pub poll_us: u64,
    /// Seed of the noise.
    pub seed: u64,
}

impl Default for Settings {
    /// The board alone, 12 pF of wire, an oscillator 1.3 % slow, a host that polls each millisecond.
    fn default() -> Self {
        Self {
            chips: vec![0x5C],
            chip_clock: 1.013,
            capacitance_pf: 17.0,
            signal: Signal::Counts { noise: 0.7 },
            poll_us: 1000,
            seed: 1,
        }
    }
}

/// A firmware that runs.
pub struct Board {
    pub(crate) mcu: Mcu,
    poll_us: u64,
    next_poll_cycle: u64,
    next_frame_cycle: u64,
    next_sample_us: f64,
    to_device: Vec<u8>,
    connected: bool,
    /// The host does not poll.
    pub stalled: bool,
    /// A slave holds SDA low until it has seen nine clocks.
    pub sda_stuck: bool,
}

impl Board {
    /// A board that was just switched on.
    pub fn new(hex: &Hex, settings: &Settings) -> Result<Self> {
        let mut chips = Chips::default();
        for (i, &address) in settings.chips.iter().enumerate() {
            let seed = settings.seed.wrapping_add(i as u64);
            let chip = Mpr121::new(settings.chip_clock, settings.signal, settings.capacitance_pf, seed);
            chips.add(address, chip);
        }
        Ok(Self {
            mcu: Mcu::new(hex, chips)?,
            poll_us: settings.poll_us.max(1),
            next_poll_cycle: 0,
            next_frame_cycle: 0,
            next_sample_us: 0.0,
            to_device: Vec::new(),
            connected: false,
            stalled: false,
            sda_stuck: false,
        })
    }

    /// Connects the USB cable and opens the port.
    pub fn plug_in(&mut self) -> Result<Identity> {
        let identity = self.enumerate()?;
        self.set_open(true)?;
        self.connected = true;
        // The host's phase against the board is nobody's choice; a third of a millisecond is as good as any.
        self.next_poll_cycle = self.mcu.cycle() + 333 * CYCLES_PER_US;
        Ok(identity)
    }

    /// Time since power-up, us.
    pub fn now_us(&self) -> u64 {
        self.mcu.cycle() / CYCLES_PER_US
    }

    /// The chips on the bus.
    pub fn chips(&mut self) -> &mut Chips {
        self.mcu.chips()
    }

    /// Sets what an electrode sees from now on; nothing if there is no such chip.
    pub fn set_capacitance_pf(&mut self, chip: u8, electrode: usize, picofarad: f64) {
        if let Some(chip) = self.mcu.chips().at(chip) {
            chip.set_capacitance_pf(electrode, picofarad);
        }
    }

    /// Queues bytes for the device, as a program writes them to the port.
    pub fn send(&mut self, bytes: &[u8]) {
        self.to_device.extend_from_slice(bytes);
    }

    /// Lets everything run until `us` after power-up; what the host reads goes to `sink` with its arrival time, us.
    pub fn step_until(&mut self, us: u64, sink: &mut dyn FnMut(u64, &[u8])) -> Result<()> {
        while self.now_us() < us {
            let target = (us * CYCLES_PER_US).min(self.next_poll_cycle);
            self.run_cycles(target)?;
            if self.connected && self.mcu.cycle() >= self.next_poll_cycle {
                self.next_poll_cycle += self.poll_us * CYCLES_PER_US;
                self.exchange(sink);
            } else if !self.connected {
                self.next_poll_cycle = u64::MAX;
            }
        }
        Ok(())
    }

    fn exchange(&mut self, sink: &mut dyn FnMut(u64, &[u8])) {
        if !self.to_device.is_empty() {
            let bytes = std::mem::take(&mut self.to_device);
            let taken = self.offer(&bytes);
            self.to_device = bytes[taken..].to_vec();
        }
        if self.stalled {
            return;
        }
        let mut packet = [0; 64];
        if let Some(count) = self.poll(&mut packet) {
            sink(self.now_us(), &packet[..count]);
        }
    }

    pub(crate) fn run_us(&mut self, us: u64) -> Result<()> {
        self.run_cycles(self.mcu.cycle() + us * CYCLES_PER_US)
    }

    fn run_cycles(&mut self, until: u64) -> Result<()> {
        while self.mcu.cycle() < until {
            self.mcu.run()?;
            let cycle = self.mcu.cycle();
            self.mcu.hold_sda(self.sda_stuck);
            if cycle >= self.next_frame_cycle {
                self.next_frame_cycle = cycle - cycle % (1000 * CYCLES_PER_US) + 1000 * CYCLES_PER_US;
                if self.mcu.attached() {
                    self.mcu.start_of_frame();
                }
                // At least once a frame, so that samples are taken with the capacitance of their time.
                let now_us = cycle as f64 / CYCLES_PER_US as f64;
                self.mcu.chips().iter_mut().for_each(|chip| chip.advance(now_us));
                self.next_sample_us = self.mcu.chips().next_sample_us();
            } else if cycle as f64 >= self.next_sample_us * CYCLES_PER_US as f64 {
                let now_us = cycle as f64 / CYCLES_PER_US as f64;
                self.mcu.chips().iter_mut().for_each(|chip| chip.advance(now_us));
                self.next_sample_us = self.mcu.chips().next_sample_us();
            }
        }
        Ok(())
    }

    /// Opens the port at 1200 baud and closes it again: the core's request for the bootloader. How long until the
    /// device attached anew, us; `None` if it did not within a second.
    pub fn touch_1200(&mut self) -> Result<Option<u64>> {
        self.set_baud(1200)?;
        self.set_open(false)?;
        self.connected = false;
        self.mcu.detach();
        let begin_us = self.now_us();
        while self.now_us() < begin_us + 1_000_000 {
            if self.mcu.attached() {
                return Ok(Some(self.now_us() - begin_us));
            }
            self.run_us(100)?;
        }
        Ok(None)
    }
}
