//! A USB host: attaches the device, sets it up as a serial port, polls it.

use crate::board::Board;
use crate::identity::Identity;
use crate::mcu::{UsbAnswer, UsbCall};
use anyhow::{Context, Result, bail, ensure};

/// Bulk endpoints of the Arduino core's serial port.
const TO_DEVICE: u8 = 2;
const FROM_DEVICE: u8 = 3;
/// One packet.
const PACKET: usize = 64;

struct Request {
    kind: u8,
    request: u8,
    value: u16,
    length: u16,
}

impl Board {
    /// Waits for the device, resets it, reads its descriptors, gives it an address and a configuration, and sets the
    /// line to 115 200 baud. DTR stays off.
    pub(crate) fn enumerate(&mut self) -> Result<Identity> {
        for _ in 0..100_000 {
            if self.mcu.attached() {
                break;
            }
            self.run_us(100)?;
        }
        ensure!(self.mcu.attached(), "no device attached within 10 s");
        self.run_us(5_000)?;
        self.mcu.usb(UsbCall::Reset, 0, &mut []).ok().context("USB reset")?;
        self.run_us(5_000)?;
        let device = self.control_in(&Request { kind: 0x80, request: 6, value: 0x0100, length: 18 })?;
        ensure!(device.len() == 18, "device descriptor of {} bytes", device.len());
        self.control_out(&Request { kind: 0x00, request: 5, value: 7, length: 0 }, &mut [])?;
        self.run_us(2_000)?;
        let head = self.control_in(&Request { kind: 0x80, request: 6, value: 0x0200, length: 9 })?;
        ensure!(head.len() == 9, "configuration descriptor of {} bytes", head.len());
        self.control_out(&Request { kind: 0x00, request: 9, value: 1, length: 0 }, &mut [])?;
        self.set_baud(115_200)?;
        let word = |at: usize| u16::from_le_bytes([device[at], device[at + 1]]);
        Ok(Identity { vendor: word(8), product: word(10), interfaces: head[4] })
    }

    /// Sets the line's speed, as a host does when a program opens the port.
    pub fn set_baud(&mut self, baud: u32) -> Result<()> {
        let [a, b, c, d] = baud.to_le_bytes();
        let mut coding = [a, b, c, d, 0, 0, 8];
        self.control_out(&Request { kind: 0x21, request: 0x20, value: 0, length: 7 }, &mut coding)
    }

    /// Opens (DTR and RTS on) or closes the port.
    pub fn set_open(&mut self, open: bool) -> Result<()> {
        let value = if open { 3 } else { 0 };
        self.control_out(&Request { kind: 0x21, request: 0x22, value, length: 0 }, &mut [])
    }

    /// One poll of the device's data; `None` if it has none.
    pub(crate) fn poll(&mut self, buffer: &mut [u8; PACKET]) -> Option<usize> {
        self.mcu.usb(UsbCall::Read, FROM_DEVICE, buffer).ok().filter(|count| *count > 0)
    }

    /// Offers the device a packet; how many bytes it took.
    pub(crate) fn offer(&mut self, bytes: &[u8]) -> usize {
        let mut packet = [0; PACKET];
        let count = bytes.len().min(PACKET);
        packet[..count].copy_from_slice(&bytes[..count]);
        self.mcu.usb(UsbCall::Write, TO_DEVICE, &mut packet[..count]).map_or(0, |_| count)
    }

    fn setup(&mut self, request: &Request) -> Result<()> {
        let (value, length) = (request.value.to_le_bytes(), request.length.to_le_bytes());
        let mut packet = [request.kind, request.request, value[0], value[1], 0, 0, length[0], length[1]];
        self.mcu.usb(UsbCall::Setup, 0, &mut packet).ok().context("USB setup packet refused")?;
        Ok(())
    }

    fn control_in(&mut self, request: &Request) -> Result<Vec<u8>> {
        self.setup(request)?;
        let mut data = Vec::new();
        for _ in 0..2_000 {
            self.run_us(30)?;
            let mut packet = [0; PACKET];
            match self.mcu.usb(UsbCall::Read, 0, &mut packet) {
                Ok(count) => {
                    data.extend_from_slice(&packet[..count]);
                    if count < PACKET || data.len() >= usize::from(request.length) {
                        self.run_us(30)?;
                        self.status_out()?;
                        return Ok(data);
                    }
                }
                Err(UsbAnswer::NotReady) => {}
                Err(UsbAnswer::Stall) => bail!("the device refused request {}", request.request),
            }
        }
        bail!("no answer to request {}", request.request)
    }

    fn status_out(&mut self) -> Result<()> {
        for _ in 0..200 {
            if self.mcu.usb(UsbCall::Write, 0, &mut []).is_ok() {
                break;
            }
            self.run_us(30)?;
        }
        self.run_us(100)
    }

    fn control_out(&mut self, request: &Request, data: &mut [u8]) -> Result<()> {
        self.setup(request)?;
        if !data.is_empty() {
            self.run_us(100)?;
            for _ in 0..200 {
                if self.mcu.usb(UsbCall::Write, 0, data).is_ok() {
                    break;
                }
                self.run_us(30)?;
            }
        }
        for _ in 0..2_000 {
            self.run_us(30)?;
            match self.mcu.usb(UsbCall::Read, 0, &mut [0; PACKET]) {
                Ok(_) => return Ok(()),
                Err(UsbAnswer::NotReady) => {}
                Err(UsbAnswer::Stall) => bail!("the device refused request {}", request.request),
            }
        }
        bail!("no status for request {}", request.request)
    }
}
