//! Which port is the board's: by USB id, and by asking.

use crate::board::OpenFailure;
use crate::touchline::is_note;
use serialport::{ErrorKind, SerialPort, SerialPortType, UsbPortInfo};
use std::boxed::Box;
use std::io;
use std::path::Path;
use std::string::{String, ToString};
use std::time::{Duration, Instant};
use std::vec::Vec;

/// USB vendor and product id of a Touch Board that runs a sketch.
pub const TOUCH_BOARD_USB: (u16, u16) = (0x2a6e, 0x8003);
/// USB id of its bootloader: no sketch runs, and the port must not be opened.
pub const BOOTLOADER_USB: (u16, u16) = (0x2a6e, 0x0003);
/// USB ids that a Touch Board takes on when it is flashed as another board of its kind: Leonardo and Micro, of Arduino
/// and of its twin. Only these are opened and asked: another device might take a question for an order.
pub const ARDUINO_USB: [(u16, u16); 4] =
    [(0x2341, 0x8036), (0x2341, 0x8037), (0x2a03, 0x8036), (0x2a03, 0x8037)];
/// USB CDC ignores it, but 1200 would start the bootloader.
pub(super) const BAUD: u32 = 115_200;
/// Longest wait of one read; also the longest wait for the reader's thread to stop.
pub(super) const READ_TIMEOUT: Duration = Duration::from_millis(50);
/// A board answers `ID?` within one of its lines.
const ANSWER_WITHIN: Duration = Duration::from_millis(400);

/// Which port to open.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub enum PortSelection {
    /// Device path. Two stock boards differ only by their `/dev/serial/by-path`.
    Path(String),
    /// The only board there is: by its USB id, or, if it was flashed as another Arduino, because it answers.
    #[default]
    Any,
    /// The board with our firmware that has this name in its EEPROM.
    Named(String),
}

/// Answer of a port to the request for its name.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) enum Answer {
    /// Our firmware, and its name; `-` for none.
    Moca(String),
    /// Stock DataStream: it answers nothing, and talks all the time.
    Stock,
    /// Nothing that a board says.
    Nothing,
}

/// The port of the board that [`PortSelection::Any`] would open.
///
/// # Errors
/// Why there is none, or which board there is instead.
pub fn look_for_board() -> Result<String, OpenFailure> {
    choose(&usb_ports(), &PortSelection::Any, &mut ask)
}

/// Opens the port of a board, with DTR on: without it a board sends nothing.
///
/// # Errors
/// Why it cannot be opened, or which board there is instead.
pub fn open(selection: &PortSelection, baud: u32) -> Result<Box<dyn SerialPort>, OpenFailure> {
    let path = choose(&usb_ports(), selection, &mut ask)?;
    open_path(&path, baud)
}

fn open_path(path: &str, baud: u32) -> Result<Box<dyn SerialPort>, OpenFailure> {
    let port = serialport::new(path, baud).timeout(READ_TIMEOUT).dtr_on_open(true).open();
    port.map_err(|error| failure(error.kind()))
}

fn choose(
    ports: &[(String, UsbPortInfo)],
    selection: &PortSelection,
    ask: &mut dyn FnMut(&str) -> Answer,
) -> Result<String, OpenFailure> {
    let with = |ids: &[(u16, u16)]| -> Vec<&String> {
        ports.iter().filter(|(_, usb)| ids.contains(&id(usb))).map(|(name, _)| name).collect()
    };
    let (boards, others, bootloaders) =
        (with(&[TOUCH_BOARD_USB]), with(&ARDUINO_USB), with(&[BOOTLOADER_USB]));
    let (found, otherwise) = match selection {
        PortSelection::Path(path) => {
            let real = Path::new(path).canonicalize().unwrap_or_default();
            let waits = bootloaders.iter().any(|name| Path::new(name) == real);
            return if waits { Err(OpenFailure::Bootloader) } else { Ok(path.clone()) };
        }
        PortSelection::Named(wanted) => {
            let named = |name: &&&String| ask(name) == Answer::Moca(wanted.clone());
            let found: Vec<&String> = boards.iter().chain(&others).filter(named).copied().collect();
            (found, OpenFailure::NotFound)
        }
        PortSelection::Any if !boards.is_empty() => (boards, OpenFailure::NotFound),
        PortSelection::Any => {
            let silent = if others.is_empty() { OpenFailure::NotFound } else { OpenFailure::Leonardo };
            let answers = |name: &&String| ask(name) != Answer::Nothing;
            (others.into_iter().filter(answers).collect(), silent)
        }
    };
    match found.as_slice() {
        [name] => Ok((*name).clone()),
        [] if !bootloaders.is_empty() => Err(OpenFailure::Bootloader),
        [] => Err(otherwise),
        _ => Err(OpenFailure::Ambiguous),
    }
}

fn ask(path: &str) -> Answer {
    let Ok(mut port) = open_path(path, BAUD) else { return Answer::Nothing };
    if port.write_all(b"ID?\n").is_err() {
        return Answer::Nothing;
    }
    let (until, mut text, mut buffer) = (Instant::now() + ANSWER_WITHIN, Vec::new(), [0; 256]);
    while Instant::now() < until {
        match port.read(&mut buffer) {
            Ok(count) => text.extend_from_slice(&buffer[..count]),
            Err(error) if error.kind() == io::ErrorKind::TimedOut => {}
            Err(_) => break,
        }
        let answer = answer(&text);
        if matches!(answer, Answer::Moca(_)) {
            return answer;
        }
    }
    answer(&text)
}

/// Returns the sender of `text`.
fn answer(text: &[u8]) -> Answer {
    let lines = || text.split(|&byte| byte == b'\n');
    let identity = lines().filter(|line| is_note(line)).find_map(|line| {
        let text = core::str::from_utf8(line).ok()?.strip_prefix("# moca-touch ")?;
        text.split(' ').skip_while(|word| *word != "name").nth(1).map(ToString::to_string)
    });
    match identity {
        Some(name) => Answer::Moca(name),
        None if lines().any(|line| line.starts_with(b"TOUCH: ")) => Answer::Stock,
        None => Answer::Nothing,
    }
}

/// Every USB serial port of the machine.
fn usb_ports() -> Vec<(String, UsbPortInfo)> {
    // Without this directory (some containers) serialport panics instead of finding no ports.
    if cfg!(target_os = "linux") && !Path::new("/sys/class/tty").is_dir() {
        return Vec::new();
    }
    serialport::available_ports()
        .unwrap_or_default()
        .into_iter()
        .filter_map(|port| match port.port_type {
            SerialPortType::UsbPort(usb) => Some((port.port_name, usb)),
            _ => None,
        })
        .collect()
}

const fn id(usb: &UsbPortInfo) -> (u16, u16) {
    (usb.vid, usb.pid)
}

/// serialport reports a port that another program holds as `NoDevice`.
fn failure(kind: ErrorKind) -> OpenFailure {
    match kind {
        ErrorKind::NoDevice => OpenFailure::Busy,
        ErrorKind::Io(io::ErrorKind::NotFound) => OpenFailure::NotFound,
        ErrorKind::Io(io::ErrorKind::PermissionDenied) => OpenFailure::PermissionDenied,
        _ => OpenFailure::Other,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const LEONARDO: (u16, u16) = ARDUINO_USB[0];
    const OTHER: (u16, u16) = (0x0403, 0x6001);

    fn usb((vid, pid): (u16, u16)) -> UsbPortInfo {
        UsbPortInfo { vid, pid, serial_number: None, manufacturer: None, product: None }
    }

    fn ports(ids: &[(u16, u16)]) -> Vec<(String, UsbPortInfo)> {
        ids.iter().enumerate().map(|(i, &id)| (std::format!("/dev/ttyACM{i}"), usb(id))).collect()
    }

    /// The choice among `ids`, each of which gives the answer beside it; asking a stranger is a mistake.
    fn chosen(selection: &PortSelection, ids: &[((u16, u16), Answer)]) -> Result<String, OpenFailure> {
        let ports = ports(&ids.iter().map(|(id, _)| *id).collect::<Vec<_>>());
        choose(&ports, selection, &mut |asked| {
            let i = ports.iter().position(|(name, _)| name == asked).unwrap();
            assert_ne!(ids[i].0, OTHER, "a device of another kind was asked");
            ids[i].1.clone()
        })
    }

    #[test]
    fn the_board_is_told_from_bootloader_strangers_and_its_double() {
        let nothing = Answer::Nothing;
        let any = |ids: &[(u16, u16)]| {
            chosen(&PortSelection::Any, &ids.iter().map(|id| (*id, nothing.clone())).collect::<Vec<_>>())
        };
        assert_eq!(any(&[OTHER, TOUCH_BOARD_USB]), Ok("/dev/ttyACM1".to_string()));
        assert_eq!(any(&[OTHER, BOOTLOADER_USB, LEONARDO]), Err(OpenFailure::Bootloader));
        assert_eq!(any(&[LEONARDO]), Err(OpenFailure::Leonardo), "it does not answer");
        assert_eq!(any(&[TOUCH_BOARD_USB, TOUCH_BOARD_USB]), Err(OpenFailure::Ambiguous));
        assert_eq!(any(&[OTHER]), Err(OpenFailure::NotFound));
    }

    #[test]
    fn board_with_other_usb_id_is_found_by_its_answer() {
        let (moca, stock) = (Answer::Moca("-".to_string()), Answer::Stock);
        for answer in [moca.clone(), stock] {
            let ids = [(OTHER, Answer::Nothing), (LEONARDO, Answer::Nothing), (ARDUINO_USB[1], answer)];
            assert_eq!(chosen(&PortSelection::Any, &ids), Ok("/dev/ttyACM2".to_string()));
        }
        let two = [(LEONARDO, moca.clone()), (LEONARDO, moca)];
        assert_eq!(chosen(&PortSelection::Any, &two), Err(OpenFailure::Ambiguous));
    }

    #[test]
    fn two_boards_are_told_apart_by_their_names() {
        let named = |name: &str| Answer::Moca(name.to_string());
        let ids =
            [(TOUCH_BOARD_USB, named("left")), (LEONARDO, named("right")), (TOUCH_BOARD_USB, Answer::Stock)];
        let by_name = |name: &str| chosen(&PortSelection::Named(name.to_string()), &ids);
        assert_eq!(by_name("left"), Ok("/dev/ttyACM0".to_string()));
        assert_eq!(by_name("right"), Ok("/dev/ttyACM1".to_string()));
        assert_eq!(by_name("rear"), Err(OpenFailure::NotFound));
    }

    #[test]
    fn an_answer_counts_only_whole() {
        let text = b"45 2C8 00\n# moca-touch 1 chips C name - 695E\nC 0001";
        assert_eq!(answer(text), Answer::Moca("-".to_string()));
        assert_eq!(answer(b"# moca-touch 1 chips C name - 695F\n"), Answer::Nothing);
        assert_eq!(answer(b"34 4\r\nTOUCH: 0 0 0"), Answer::Stock);
    }

    #[test]
    fn the_operating_system_s_answers_are_told_apart() {
        for (kind, expected) in [
            (ErrorKind::NoDevice, OpenFailure::Busy),
            (ErrorKind::Io(io::ErrorKind::NotFound), OpenFailure::NotFound),
            (ErrorKind::Io(io::ErrorKind::PermissionDenied), OpenFailure::PermissionDenied),
            (ErrorKind::Unknown, OpenFailure::Other),
        ] {
            assert_eq!(failure(kind), expected);
        }
    }
}
