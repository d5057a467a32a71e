//! The board's firmware itself, instruction by instruction, under a simulated cover. It runs in a program of its own
//! (`crates/firmware-sim`), because its processor's simulator is under another licence; this side has the cover's foam.

use anyhow::{Context, Result};
use moca_sim::foam::{Foam, FoamState};
use moca_sim::sensor::IDLE_COUNTS;
use moca_tactile::datastream::ELECTRODES;
use std::io::{self, Read, Write};
use std::path::Path;
use std::process::{Child, ChildStdin, ChildStdout, Command, Stdio};

/// An electrode nobody touches: 5 pF of plate and 12 pF of wire.
const REST_PF: f64 = 17.0;
/// Step of the foam, ns: the chip samples an electrode as often.
pub const STEP_NS: u64 = 1_000_000;
const STEP_S: f64 = 1e-3;
/// Largest packet of the board's USB.
const PACKET: usize = 64;

/// The cover between forces and electrodes.
pub struct Plates {
    foam: Foam,
    states: [FoamState; ELECTRODES],
}

impl Plates {
    /// Plates over `foam` that nobody has touched yet.
    pub fn new(foam: Foam) -> Self {
        Self { foam, states: [FoamState::default(); ELECTRODES] }
    }

    /// Returns the capacitances after one more [`STEP_NS`] of these forces, N; pF as the program reads it.
    pub fn step(&mut self, force_n: &[f64; ELECTRODES]) -> [u8; 4 * ELECTRODES] {
        let mut record = [0; 4 * ELECTRODES];
        let (places, _) = record.as_chunks_mut::<4>();
        for ((place, state), force_n) in places.iter_mut().zip(&mut self.states).zip(force_n) {
            let force_n = if force_n.is_finite() { *force_n } else { 0.0 };
            let deformation_m = state.step_force(&self.foam, force_n, STEP_S);
            // Counts go as 1/C.
            let ratio = IDLE_COUNTS / (IDLE_COUNTS - self.foam.counts_drop(deformation_m));
            #[expect(clippy::cast_possible_truncation, reason = "tens of pF")]
            let picofarad = (REST_PF * ratio) as f32;
            *place = picofarad.to_le_bytes();
        }
        record
    }
}

/// The running program; it ends when this is dropped.
pub struct Program {
    child: Child,
    /// Standard input of the program.
    pub input: ChildStdin,
}

impl Program {
    /// Starts `program` with `arguments`.
    ///
    /// # Errors
    /// It cannot be started.
    pub fn start(program: &Path, arguments: &[&str], output: Stdio) -> Result<Self> {
        let mut child =
            Command::new(program).args(arguments).stdin(Stdio::piped()).stdout(output).spawn().with_context(
                || {
                    format!(
                        "board.port = \"avr\" runs {}: build it with `cargo build --release --manifest-path \
                     crates/firmware-sim/Cargo.toml`, or name it: \"avr:PATH\"",
                        program.display()
                    )
                },
            )?;
        let input = child.stdin.take().context("the program has no input")?;
        Ok(Self { child, input })
    }
}

impl Drop for Program {
    fn drop(&mut self) {
        // It may have ended by itself; either way there is nothing left to do about it.
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

/// The firmware in lock-step: time is an argument. `advance` allocates nothing.
pub struct LockStepFirmware {
    program: Program,
    output: io::BufReader<ChildStdout>,
    plates: Plates,
    now_ns: u64,
}

impl LockStepFirmware {
    /// Starts `program pipe`.
    ///
    /// # Errors
    /// It cannot be started.
    pub fn start(program: &Path, foam: Foam) -> Result<Self> {
        let mut program = Program::start(program, &["pipe"], Stdio::piped())?;
        let output = program.child.stdout.take().context("the program has no output")?;
        Ok(Self { program, output: io::BufReader::new(output), plates: Plates::new(foam), now_ns: 0 })
    }

    /// Lets the board run until `now_ns` with steady forces on its electrodes, N; every packet that its host reads goes to
    /// `sink` with its arrival, ns.
    ///
    /// # Errors
    /// The program is gone.
    pub fn advance(
        &mut self,
        now_ns: u64,
        force_n: &[f64; ELECTRODES],
        sink: &mut impl FnMut(u64, &[u8]),
    ) -> io::Result<()> {
        while self.now_ns < now_ns {
            self.now_ns = now_ns.min(self.now_ns + STEP_NS);
            let mut request = [0; 8 + 4 * ELECTRODES + 2];
            request[..8].copy_from_slice(&(self.now_ns / 1000).to_le_bytes());
            request[8..8 + 4 * ELECTRODES].copy_from_slice(&self.plates.step(force_n));
            self.program.input.write_all(&request)?;
            self.program.input.flush()?;
            self.packets(sink)?;
        }
        Ok(())
    }

    /// Packets of one answer, which an empty one ends.
    fn packets(&mut self, sink: &mut impl FnMut(u64, &[u8])) -> io::Result<()> {
        loop {
            let (mut arrival_us, mut length, mut bytes) = ([0; 8], [0; 2], [0; PACKET]);
            self.output.read_exact(&mut arrival_us)?;
            self.output.read_exact(&mut length)?;
            let length = usize::from(u16::from_le_bytes(length));
            let Some(bytes) = bytes.get_mut(..length) else {
                return Err(io::Error::new(io::ErrorKind::InvalidData, "a packet of more than 64 bytes"));
            };
            if bytes.is_empty() {
                return Ok(());
            }
            self.output.read_exact(bytes)?;
            sink(u64::from_le_bytes(arrival_us) * 1000, bytes);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn electrodes_see_what_gives_the_counts_of_the_foam() {
        let mut plates = Plates::new(Foam::PU_LD30);
        let mut force_n = [0.0; ELECTRODES];
        (force_n[3], force_n[4]) = (50.0, f64::NAN);
        let record = (0..100).map(|_| plates.step(&force_n)).last().unwrap();
        let picofarad: Vec<f64> =
            record.as_chunks::<4>().0.iter().map(|bytes| f64::from(f32::from_le_bytes(*bytes))).collect();
        assert!(picofarad.iter().enumerate().all(|(e, pf)| e == 3 || (pf - REST_PF).abs() < 1e-6));
        let drop = IDLE_COUNTS * (1.0 - REST_PF / picofarad[3]);
        assert!((20.0..40.0).contains(&drop), "50 N are some 28 counts: {drop}");
    }

    #[test]
    fn a_program_that_is_not_there_is_named_with_the_remedy() {
        let error = LockStepFirmware::start(Path::new("/nowhere/firmware-sim"), Foam::PU_LD30).err().unwrap();
        let text = format!("{error:#}");
        assert!(text.contains("/nowhere/firmware-sim") && text.contains("cargo build --release"), "{text}");
    }
}
