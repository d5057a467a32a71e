//! The processor: simavr behind a safe interface. All unsafe code of the crate is here.

use crate::mpr121::Chips;
use anyhow::{Context, Result, bail, ensure};
use simavr_ffi as ffi;
use std::ffi::c_void;
use std::path::Path;
use std::ptr;

/// Cycles of the 16 MHz clock in a microsecond.
pub(crate) const CYCLES_PER_US: u64 = 16;
/// Cycles of one bit at 400 kHz.
const I2C_BIT_CYCLES: u64 = 40;
/// Bits of an I²C transfer that simavr leaves out: START, and for a write the address with its acknowledge.
const MISSING_WRITE_BITS: u64 = 10;
const MISSING_READ_BITS: u64 = 1;

// Registers of the ATmega32U4 in data space.
const TWCR: usize = 0xBC;
const TWINT: u8 = 0x80;
const DDRD: usize = 0x2A;
const UDINT: usize = 0xE1;
const UDIEN: usize = 0xE2;
const SOFI: u8 = 1 << 2;
const USB_GENERAL_VECTOR: u8 = 10;

const fn ioctl(name: [u8; 4]) -> u32 {
    u32::from_be_bytes(name)
}

const TWI: u32 = ioctl(*b"twi\0");
const USB: u32 = ioctl(*b"usb ");
const PORT_D: u32 = ioctl(*b"iogD");

/// Flash image of a program.
#[derive(Clone, Debug)]
pub struct Hex(Vec<(usize, Vec<u8>)>);

impl Hex {
    /// Reads an Intel hex file of data and end records.
    pub fn read(path: &Path) -> Result<Self> {
        let text = std::fs::read_to_string(path).with_context(|| format!("read {}", path.display()))?;
        Self::parse(&text).with_context(|| format!("in {}", path.display()))
    }

    fn parse(text: &str) -> Result<Self> {
        let mut records = Vec::new();
        for (number, line) in text.lines().enumerate() {
            let digits =
                line.trim().strip_prefix(':').with_context(|| format!("line {}: no ':'", number + 1))?;
            ensure!(digits.is_ascii() && digits.len() % 2 == 0, "line {}: odd digits", number + 1);
            let bytes = (0..digits.len() / 2)
                .map(|i| u8::from_str_radix(&digits[2 * i..2 * i + 2], 16))
                .collect::<Result<Vec<u8>, _>>()
                .with_context(|| format!("line {}", number + 1))?;
            let sum = bytes.iter().fold(0u8, |sum, byte| sum.wrapping_add(*byte));
            let whole = bytes.len() >= 5 && usize::from(bytes[0]) + 5 == bytes.len() && sum == 0;
            ensure!(whole, "line {}: length or checksum is wrong", number + 1);
            match bytes[3] {
                0 => {
                    let address = usize::from(bytes[1]) << 8 | usize::from(bytes[2]);
                    records.push((address, bytes[4..bytes.len() - 1].to_vec()));
                }
                1 => return Ok(Self(records)),
                kind => bail!("line {}: record type {kind} is not for a 32 KiB flash", number + 1),
            }
        }
        bail!("no end record")
    }
}

/// State that simavr's callbacks may touch. It lies behind a raw pointer: simavr keeps that for the processor's life.
struct Shared {
    avr: *mut ffi::avr_t,
    chips: Chips,
    attached: bool,
    reply: *mut ffi::avr_irq_t,
    selected: Option<u8>,
}

/// An ATmega32U4 with I²C slaves.
pub(crate) struct Mcu {
    avr: *mut ffi::avr_t,
    shared: *mut Shared,
    sda: *mut ffi::avr_irq_t,
    sda_low: bool,
    /// Clocks that a stuck slave has seen; nine free it.
    scl_clocks: u32,
    scl_driven: bool,
}

impl Mcu {
    pub(crate) fn new(hex: &Hex, chips: Chips) -> Result<Self> {
        // SAFETY: each pointer is checked before use and lives as long as `avr`, which `drop` ends; `shared` outlives
        // it. Flash is `flashend + 1` bytes long, and each record is checked against that.
        unsafe {
            let avr = ffi::avr_make_mcu_by_name(c"atmega32u4".as_ptr());
            ensure!(!avr.is_null(), "simavr knows no atmega32u4");
            ffi::avr_init(avr);
            (*avr).frequency = 16_000_000;
            (*avr).set_log(0);
            let flash = std::slice::from_raw_parts_mut((*avr).flash, (*avr).flashend as usize + 1);
            for (address, bytes) in &hex.0 {
                let place = flash.get_mut(*address..address + bytes.len());
                place.context("the program is larger than the flash")?.copy_from_slice(bytes);
            }
            (*avr).codeend = (*avr).flashend;
            let reply = ffi::avr_io_getirq(avr, TWI, ffi::TWI_IRQ_INPUT as i32);
            let requests = ffi::avr_io_getirq(avr, TWI, ffi::TWI_IRQ_OUTPUT as i32);
            let attach = ffi::avr_io_getirq(avr, USB, ffi::USB_IRQ_ATTACH as i32);
            let sda = ffi::avr_io_getirq(avr, PORT_D, 1);
            ensure!(
                ![reply, requests, attach, sda].contains(&ptr::null_mut()),
                "simavr has no I2C, USB or port D here"
            );
            let shared =
                Box::into_raw(Box::new(Shared { avr, chips, attached: false, reply, selected: None }));
            ffi::avr_irq_register_notify(requests, Some(on_i2c), shared.cast());
            ffi::avr_irq_register_notify(attach, Some(on_attach), shared.cast());
            ffi::avr_raise_irq(sda, 0);
            ffi::avr_raise_irq(sda, 1);
            Ok(Self { avr, shared, sda, sda_low: false, scl_clocks: 0, scl_driven: false })
        }
    }

    pub(crate) fn cycle(&self) -> u64 {
        // SAFETY: `avr` is valid for the life of `self`.
        unsafe { (*self.avr).cycle }
    }

    /// One instruction.
    pub(crate) fn run(&mut self) -> Result<()> {
        // SAFETY: `avr` is valid; no reference into `shared` lives across this call.
        let state = unsafe { ffi::avr_run(self.avr) };
        ensure!(
            state != ffi::cpu_Done as i32 && state != ffi::cpu_Crashed as i32,
            "the processor stopped at {} us",
            self.cycle() / CYCLES_PER_US
        );
        Ok(())
    }

    /// Lets a slave hold SDA low until it has seen nine clocks, or releases it.
    pub(crate) fn hold_sda(&mut self, hold: bool) {
        let low = hold && self.scl_clocks < 9;
        if !hold {
            self.scl_clocks = 0;
        }
        if low {
            // The bus never gets free, so the controller never reports.
            *self.register(TWCR) &= !TWINT;
        }
        if low != self.sda_low {
            self.sda_low = low;
            // SAFETY: the interrupt line belongs to `avr`.
            unsafe { ffi::avr_raise_irq(self.sda, u32::from(!low)) };
        }
        let driven = *self.register(DDRD) & 1 != 0;
        if hold && driven && !self.scl_driven {
            self.scl_clocks += 1;
        }
        self.scl_driven = driven;
    }

    /// The host's start of frame.
    pub(crate) fn start_of_frame(&mut self) {
        *self.register(UDINT) |= SOFI;
        if *self.register(UDIEN) & SOFI == 0 {
            return;
        }
        // SAFETY: the table holds `vector_count` valid vectors.
        unsafe {
            let table = &raw const (*self.avr).interrupts;
            for i in 0..usize::from((*table).vector_count) {
                let vector = (*table).vector[i];
                if (*vector).vector == USB_GENERAL_VECTOR {
                    ffi::avr_raise_interrupt(self.avr, vector);
                }
            }
        }
    }

    /// Calls simavr's USB host side. `Ok(n)` for `n` bytes moved.
    pub(crate) fn usb(&mut self, call: UsbCall, pipe: u8, buffer: &mut [u8]) -> Result<usize, UsbAnswer> {
        let mut transfer =
            ffi::avr_io_usb { pipe, sz: buffer.len().min(64) as u32, buf: buffer.as_mut_ptr() };
        // SAFETY: simavr reads or writes at most 64 bytes: the endpoint's size. `read` buffers are that long.
        let answer = unsafe { ffi::avr_ioctl(self.avr, call as u32, (&raw mut transfer).cast()) };
        match answer {
            0 => Ok(transfer.sz as usize),
            -3 => Err(UsbAnswer::Stall),
            _ => Err(UsbAnswer::NotReady),
        }
    }

    pub(crate) fn attached(&mut self) -> bool {
        // SAFETY: `shared` is valid; the reference ends here.
        unsafe { (*self.shared).attached }
    }

    pub(crate) fn detach(&mut self) {
        // SAFETY: as above.
        unsafe { (*self.shared).attached = false }
    }

    pub(crate) fn chips(&mut self) -> &mut Chips {
        // SAFETY: callbacks run only inside `run` and `usb`, which need `&mut self` as this does.
        unsafe { &mut (*self.shared).chips }
    }

    fn register(&mut self, address: usize) -> &mut u8 {
        // SAFETY: data space of an ATmega32U4 is larger than any address used here.
        unsafe { &mut *(*self.avr).data.add(address) }
    }
}

impl Drop for Mcu {
    fn drop(&mut self) {
        // SAFETY: the processor goes first, so no callback can reach `shared` any more.
        unsafe {
            ffi::avr_terminate(self.avr);
            drop(Box::from_raw(self.shared));
        }
    }
}

#[derive(Clone, Copy, Debug)]
#[repr(u32)]
pub(crate) enum UsbCall {
    Write = ioctl(*b"usbw"),
    Read = ioctl(*b"usbr"),
    Setup = ioctl(*b"usbs"),
    Reset = ioctl(*b"usbR"),
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum UsbAnswer {
    NotReady,
    Stall,
}

unsafe extern "C" fn on_attach(_irq: *mut ffi::avr_irq_t, _value: u32, shared: *mut c_void) {
    // SAFETY: registered with a pointer to `Shared`, which outlives the processor.
    unsafe { (*shared.cast::<Shared>()).attached = true }
}

unsafe extern "C" fn on_i2c(_irq: *mut ffi::avr_irq_t, value: u32, shared: *mut c_void) {
    // The message: bytes unused, condition, address, data of avr_twi_msg_t, from the lowest.
    let [_, condition, address, data] = value.to_le_bytes();
    let condition = u32::from(condition);
    // SAFETY: as above; simavr calls this from `run`, in which no other reference to `Shared` lives.
    let shared = unsafe { &mut *shared.cast::<Shared>() };
    let avr = shared.avr;
    // SAFETY: the processor that called is valid.
    let now_us = unsafe { (*avr).cycle } as f64 / CYCLES_PER_US as f64;
    if condition & ffi::TWI_COND_STOP != 0 {
        shared.selected = None;
    }
    if condition & ffi::TWI_COND_START != 0 {
        let bits = if address & 1 == 0 { MISSING_WRITE_BITS } else { MISSING_READ_BITS };
        // SAFETY: as above. The processor waits for the bus meanwhile, so time passing is all it can notice.
        unsafe { (*avr).cycle += bits * I2C_BIT_CYCLES };
        shared.selected = shared.chips.select(address, now_us).then_some(address >> 1);
        if shared.selected.is_some() {
            answer(shared.reply, ffi::TWI_COND_ACK, address, 1);
        }
        return;
    }
    let Some(chip) = shared.selected else { return };
    if condition & ffi::TWI_COND_WRITE != 0 {
        answer(shared.reply, ffi::TWI_COND_ACK, address, 1);
        shared.chips.write(chip, data, now_us);
    }
    if condition & ffi::TWI_COND_READ != 0 {
        let data = shared.chips.read(chip, now_us);
        answer(shared.reply, ffi::TWI_COND_READ, address, data);
    }
}

fn answer(reply: *mut ffi::avr_irq_t, condition: u32, address: u8, data: u8) {
    // SAFETY: `reply` is an interrupt line of the processor that called.
    unsafe { ffi::avr_raise_irq(reply, ffi::avr_twi_irq_msg(condition as u8, address, data)) }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_hex_file_is_checked() {
        assert_eq!(Hex::parse(":0100100055 9A".replace(' ', "").as_str()).is_err(), true, "no end record");
        let hex = Hex::parse(":01001000559A\n:00000001FF\n").unwrap();
        assert_eq!(hex.0, vec![(0x10, vec![0x55])]);
        assert!(Hex::parse(":01001000559B\n:00000001FF\n").is_err(), "a wrong checksum");
    }
}
