//! `board.port`: the ports of the boards under the cover, one text or a list of them.

use moca_msgs::table::{Field, FieldValue, ParameterKind, Size, Typed};
use moca_tactile::cover::MAX_BOARDS;
use std::fmt;
use std::ops::Deref;
use std::path::PathBuf;

/// The virtual Touch Board.
const VIRTUAL_PORT: &str = "virtual";
/// Looks for a Touch Board's USB id.
pub const AUTO_PORT: &str = "auto";
/// Looks for the board with the name that follows, in its EEPROM.
pub const NAMED_PORT: &str = "name:";
/// The firmware itself, in the program that follows after a colon, or in [`FIRMWARE_SIM`].
const FIRMWARE_PORT: &str = "avr";
/// The program that runs the firmware, where `crates/firmware-sim/README.md` builds it.
const FIRMWARE_SIM: &str = "crates/firmware-sim/target/release/firmware-sim";

/// Ports of the boards under a cover, the first board's first.
///
/// ```
/// use moca_control::config::Config;
///
/// let one = Config::parse("board.port = \"virtual\"").unwrap();
/// assert!(one.board.port.are_virtual());
/// let two = "board.port = [\"name:left\", \"name:right\"]\nrobot.cover.board = [1,1,1,1,1,1,2,2,2,2,2]";
/// assert_eq!(Config::parse(two).unwrap().board.port.to_string(), "name:left, name:right");
/// ```
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Ports(Vec<String>);

impl Ports {
    /// Returns true if the boards are virtual.
    pub fn are_virtual(&self) -> bool {
        self.0.iter().all(|port| port == VIRTUAL_PORT)
    }

    /// The program that runs the firmware under the simulated cover, if that is the board.
    pub fn firmware_program(&self) -> Option<PathBuf> {
        let program = self.0.first()?.strip_prefix(FIRMWARE_PORT)?;
        match program.strip_prefix(':') {
            Some(path) => Some(path.into()),
            None => program.is_empty().then(|| FIRMWARE_SIM.into()),
        }
    }

    /// Returns true if the boards read a simulated cover.
    pub fn are_simulated(&self) -> bool {
        self.are_virtual() || self.firmware_program().is_some()
    }
}

impl Default for Ports {
    fn default() -> Self {
        VIRTUAL_PORT.into()
    }
}

impl From<&str> for Ports {
    fn from(port: &str) -> Self {
        Self(vec![port.into()])
    }
}

impl Deref for Ports {
    type Target = [String];

    fn deref(&self) -> &[String] {
        &self.0
    }
}

impl fmt::Display for Ports {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.0.join(", "))
    }
}

impl Typed for Ports {
    const KIND: ParameterKind = ParameterKind::Text;
    const SIZE: Size = Size::AtMost(MAX_BOARDS);
}

impl Field for Ports {
    fn see(&self, see: &mut dyn FnMut(FieldValue<'_>)) {
        let texts: Vec<&str> = self.0.iter().map(String::as_str).collect();
        see(FieldValue::Texts(&texts));
    }

    fn take(&mut self, value: FieldValue<'_>) -> bool {
        match value {
            FieldValue::Text(text) => self.0 = vec![text.into()],
            FieldValue::Texts(texts) if !texts.is_empty() => {
                self.0 = texts.iter().map(|text| (*text).into()).collect();
            }
            FieldValue::Texts(_) | FieldValue::Numbers(_) => return false,
        }
        true
    }
}
