//! The board behind a pipe, in lock-step: a program writes how far to go and what the electrodes see, and reads what
//! the host would have read. So a program under another licence can use the firmware without linking it.
//!
//! Little-endian. Request: `until_us: u64`, twelve `f32` capacitances of the board's own chip in pF, `count: u16` and as
//! many bytes for the device. Answer: packets `arrival_us: u64, count: u16` and as many bytes, ended by a packet with
//! count 0. Times count from the opening of the port.

use crate::Board;
use crate::mpr121::ELECTRODES;
use anyhow::{Context, Result};
use std::io::{ErrorKind, Read, Write};

/// Serves requests until `input` ends.
pub fn serve(board: &mut Board, input: &mut impl Read, output: &mut impl Write) -> Result<()> {
    board.plug_in()?;
    let start_us = board.now_us();
    loop {
        let mut head = [0; 8 + 4 * ELECTRODES + 2];
        match input.read_exact(&mut head) {
            Ok(()) => {}
            Err(error) if error.kind() == ErrorKind::UnexpectedEof => return Ok(()),
            Err(error) => return Err(error).context("read a request"),
        }
        let until_us = u64::from_le_bytes(head[..8].try_into()?);
        for electrode in 0..ELECTRODES {
            let at = 8 + 4 * electrode;
            let picofarad = f64::from(f32::from_le_bytes(head[at..at + 4].try_into()?));
            if picofarad.is_finite() && picofarad > 0.0 {
                board.set_capacitance_pf(0x5C, electrode, picofarad);
            }
        }
        let mut text = vec![0; usize::from(u16::from_le_bytes(head[56..58].try_into()?))];
        input.read_exact(&mut text).context("read bytes for the device")?;
        board.send(&text);
        let mut answer = Vec::new();
        board.step_until(start_us + until_us, &mut |arrival_us, bytes| {
            answer.extend_from_slice(&(arrival_us - start_us).to_le_bytes());
            answer.extend_from_slice(&(bytes.len() as u16).to_le_bytes());
            answer.extend_from_slice(bytes);
        })?;
        answer.extend_from_slice(&(board.now_us() - start_us).to_le_bytes());
        answer.extend_from_slice(&0u16.to_le_bytes());
        output.write_all(&answer).and_then(|()| output.flush()).context("write an answer")?;
    }
}
