//! The Touch Board's firmware in simavr, its MPR121s on the I²C bus and a host on its USB: capacitances in, the bytes a
//! host reads out, in lock-step.
//!
//! ```no_run
//! use moca_firmware_sim::{Board, Hex};
//!
//! let mut board = Board::new(&Hex::read("firmware/moca_touch/moca_touch.hex".as_ref())?, &Default::default())?;
//! board.plug_in()?;
//! board.set_capacitance_pf(0x5C, 5, 20.0);
//! board.step_until(2_000_000, &mut |arrival_us, bytes| println!("{arrival_us} us: {} bytes", bytes.len()));
//! # anyhow::Ok(())
//! ```
//!
//! Exactly simulated: the processor, its clock, the USB device controller (one bank an endpoint), I²C bit times.
//! Modelled: the chip ([`mpr121`]) and the host's polling. simavr lacks the START and address bits of an I²C
//! write and the USB start of frame; both are added here.
//!
//! simavr is GPL-3: this crate is a test tool, outside the workspace, and no other crate links it.

pub mod board;
pub mod faults;
pub mod identity;
mod mcu;
pub mod measure;
pub mod mpr121;
pub mod pipe;
pub mod terminal;
mod usb;

pub use board::{Board, Settings};
pub use mcu::Hex;
