//! State of a board, from its port and its bytes, in plain words.
//!
//! ```
//! use moca_msgs::board::{Diagnosis, OpenFailure};
//!
//! let seen = Diagnosis::NotOpen(OpenFailure::Bootloader);
//! assert!(seen.text().contains("press reset once"), "what to do about it");
//! ```

/// Why a port could not be opened.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub enum OpenFailure {
    /// No such path, or no board with the wanted USB id.
    NotFound,
    /// The user may not open the port: not in group `dialout`, or the udev rule is missing.
    PermissionDenied,
    /// Another program has the port.
    Busy,
    /// The board waits in its bootloader (USB 2A6E:0003): no sketch runs.
    Bootloader,
    /// Only an Arduino of the board's kind (USB 2341:8036 and relatives) is there, and it does not answer as a board.
    Leonardo,
    /// Several boards match: name one by path.
    Ambiguous,
    /// Any other answer of the operating system.
    Other,
}

impl OpenFailure {
    /// One sentence with the remedy.
    pub const fn text(self) -> &'static str {
        match self {
            Self::NotFound => "No Touch Board found: check cable, power switch and port path.",
            Self::PermissionDenied => {
                "The port may not be opened: install udev/70-moca-touch-board.rules and join group dialout."
            }
            Self::Busy => {
                "Another program has the port open: close it (Arduino's serial monitor? ModemManager?)."
            }
            Self::Bootloader => {
                "The board waits in its bootloader (USB 2A6E:0003): press reset once, or flash DataStream."
            }
            Self::Leonardo => {
                "Only an Arduino (Leonardo or Micro) is connected, and it does not answer as a Touch Board: flash \
                 firmware/moca_touch, or name its port by path."
            }
            Self::Ambiguous => {
                "Several boards match and their serial numbers are empty: name each by its /dev/serial/by-path."
            }
            Self::Other => "The operating system refused to open the port.",
        }
    }
}

/// Sketch of a board, from its bytes, when there are no frames.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub enum Diagnosis {
    /// Good frames come.
    Frames,
    /// The port is not open, and this is why.
    NotOpen(OpenFailure),
    /// It was open and closed.
    Disconnected,
    /// Text of the factory sketch.
    WrongSketch,
    /// DataStream says that its sensor chip does not answer.
    ChipInitFailed,
    /// Bytes that are no known text.
    Unknown,
    /// The port is open and nothing comes.
    #[default]
    Silent,
    /// The robot has no cover.
    NoBoard,
}

impl Diagnosis {
    /// Returns the sentence for the user. The causes of silence look the same from outside; they share one list, in the order
    /// in which to check them.
    pub const fn text(self) -> &'static str {
        match self {
            Self::Frames => "The board sends good frames.",
            Self::NotOpen(why) => why.text(),
            Self::NoBoard => "This robot has no cover and reads no board.",
            Self::Disconnected => "The board was unplugged or lost power.",
            Self::WrongSketch => {
                "The board runs its factory sketch (touch events only): flash the library example DataStream once."
            }
            Self::ChipInitFailed => {
                "The board's sensor chip does not answer: check for shorted electrodes, then power-cycle the board."
            }
            Self::Unknown => {
                "Bytes come, but they are no DataStream frames: another sketch or another device. Flash the library \
                 example DataStream, or check the port path."
            }
            Self::Silent => {
                "The port is open but silent. Check in this order: \
                 1. it has just booted (first byte after about 1 s): wait 2 s; \
                 2. the sensor chip did not start (its message is printed before the port opens): power-cycle; \
                 3. a sketch that prints nothing: flash the library example DataStream; \
                 4. the I2C bus is stuck: power-cycle with the electrodes unplugged, then plug them in one by one; \
                 5. DTR is not asserted (another program or a hub changed it): replug without a hub."
            }
        }
    }
}
