//! A file that grows by what is written to it and by nothing else.

use std::fs::File;
use std::io::{self, Write};

/// Refuses to write on once somebody else has made the file shorter: what follows would stand behind a hole.
pub(super) struct OwnFile {
    file: File,
    written: u64,
}

impl OwnFile {
    /// A file that is empty.
    pub(super) const fn new(file: File) -> Self {
        Self { file, written: 0 }
    }
}

impl Write for OwnFile {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        let found = self.file.metadata()?.len();
        if found < self.written {
            return Err(io::Error::other(format!(
                "another program truncated it to {found} of {} bytes; what it held is lost",
                self.written
            )));
        }
        let written = self.file.write(bytes)?;
        self.written += u64::try_from(written).unwrap_or(u64::MAX);
        Ok(written)
    }

    fn flush(&mut self) -> io::Result<()> {
        self.file.flush()
    }
}
