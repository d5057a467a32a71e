//! Files that a user names: a pipe that nobody fills, or a device without an end, is an error and not a wait.

use std::format;
use std::fs::OpenOptions;
use std::io::{self, ErrorKind, Read};
use std::os::unix::fs::OpenOptionsExt;
use std::path::Path;
use std::string::String;
use std::vec::Vec;

/// Longest file that is read, bytes: a hundred times a calibration of 24 taxels.
pub const TEXT_BYTES_MAX: u64 = 1 << 20;
/// `O_NONBLOCK` of Linux: opening a FIFO does not wait for who writes into it.
const NON_BLOCKING: i32 = 0o4000;

/// The text of a regular file of at most [`TEXT_BYTES_MAX`].
///
/// # Errors
/// As for [`read_bytes`], and text that is not UTF-8.
pub fn read_text(path: &Path) -> io::Result<String> {
    let bytes = read_bytes(path, TEXT_BYTES_MAX)?;
    String::from_utf8(bytes).map_err(|error| io::Error::new(ErrorKind::InvalidData, error))
}

/// The bytes of a regular file of at most `bytes_max`.
///
/// # Errors
/// The operating system's, and a file that is not regular or too long.
pub fn read_bytes(path: &Path, bytes_max: u64) -> io::Result<Vec<u8>> {
    let file = OpenOptions::new().read(true).custom_flags(NON_BLOCKING).open(path)?;
    let wrong = |what: String| io::Error::new(ErrorKind::InvalidInput, what);
    if !file.metadata()?.is_file() {
        return Err(wrong("not a regular file (a folder, pipe or device)".into()));
    }
    let mut bytes = Vec::new();
    file.take(bytes_max.saturating_add(1)).read_to_end(&mut bytes)?;
    if u64::try_from(bytes.len()).unwrap_or(u64::MAX) > bytes_max {
        return Err(wrong(format!("longer than {bytes_max} bytes")));
    }
    Ok(bytes)
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::string::ToString;
    use std::{env, fs, process};

    #[test]
    fn what_never_ends_or_never_begins_is_an_error() {
        let said = |path: &str| read_text(Path::new(path)).unwrap_err().to_string();
        assert!(said("/dev/zero").contains("not a regular file"));
        assert!(said("/").contains("not a regular file"));
        let fifo = env::temp_dir().join(format!("moca-fifo-{}", process::id()));
        let _ = fs::remove_file(&fifo);
        assert!(process::Command::new("mkfifo").arg(&fifo).status().unwrap().success());
        assert!(said(&fifo.display().to_string()).contains("not a regular file"));
        fs::remove_file(&fifo).unwrap();
        let long = env::temp_dir().join(format!("moca-long-{}", process::id()));
        fs::File::create(&long).unwrap().set_len(1 << 40).unwrap();
        assert!(said(&long.display().to_string()).contains("longer than 1048576 bytes"));
        fs::write(&long, "schema = 1").unwrap();
        assert_eq!(read_text(&long).unwrap(), "schema = 1");
        fs::remove_file(&long).unwrap();
    }
}
