//! The secret that admits to a TCP listener: every user of the machine reaches a port, only its owner reads the file.
//!
//! The daemon sends each connection a number of its own, and the client answers with a keyed hash of it: the secret never
//! crosses the wire, and the bytes of one connection admit to no other.
//!
//! ```
//! use moca_telemetry::net::Token;
//! let token = Token::from_secret(b"correct horse battery staple");
//! let proof = token.proof(&[7; 32]);
//! assert!(token.admits(&[7; 32], &proof));
//! assert!(!token.admits(&[8; 32], &proof), "a proof counts on one connection");
//! ```

use super::NetError;
use std::{
    env, fmt,
    fs::{DirBuilder, File, OpenOptions},
    io::{self, Read, Write},
    os::unix::fs::{DirBuilderExt, MetadataExt, OpenOptionsExt},
    path::{Path, PathBuf},
};

/// Environment variable with the path of a token file, for daemon and clients.
pub const TOKEN_VARIABLE: &str = "MOCA_TOKEN_FILE";
/// Fewest bytes of a secret: fewer can be guessed.
const SECRET_MIN: usize = 16;
/// Most bytes of a token file that are read.
const SECRET_MAX: u64 = 4096;
/// Separates this use of the secret from any other use of the same file.
const CONTEXT: &str = "MOCA-S telemetry token, version 1";

/// A shared secret.
#[derive(Clone, PartialEq, Eq)]
pub struct Token([u8; 32]);

impl fmt::Debug for Token {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("Token(hidden)")
    }
}

impl Token {
    /// A token of the bytes of a secret.
    pub fn from_secret(secret: &[u8]) -> Self {
        Self(blake3::derive_key(CONTEXT, secret))
    }

    /// A token that nobody else knows.
    ///
    /// # Errors
    /// The operating system has no random bytes.
    pub fn random() -> io::Result<Self> {
        random().map(Self)
    }

    /// Reads a token file.
    ///
    /// # Errors
    /// A file that is missing, that others than its owner may open, or that holds too little.
    pub fn read(path: &Path) -> Result<Self, NetError> {
        let wrong = |why: String| NetError::Token { path: path.into(), why };
        let mut file = File::open(path).map_err(|error| wrong(error.to_string()))?;
        let metadata = file.metadata().map_err(|error| wrong(error.to_string()))?;
        let mode = metadata.mode() & 0o777;
        if !metadata.is_file() {
            return Err(wrong("not a regular file".into()));
        }
        if mode & 0o077 != 0 {
            return Err(wrong(format!(
                "mode {mode:04o}; allowed: 0600, so that only its owner reads it: chmod 600"
            )));
        }
        let mut secret = Vec::new();
        let read = Read::by_ref(&mut file).take(SECRET_MAX).read_to_end(&mut secret);
        read.map_err(|error| wrong(error.to_string()))?;
        let secret = secret.trim_ascii();
        if secret.len() < SECRET_MIN {
            let length = secret.len();
            return Err(wrong(format!("{length} bytes; allowed: {SECRET_MIN} to {SECRET_MAX} random ones")));
        }
        Ok(Self::from_secret(secret))
    }

    /// Reads a token file, or makes one of mode 0600 with a random secret where there is none.
    ///
    /// # Errors
    /// As [`Self::read`], or a file that cannot be made.
    pub fn read_or_create(path: &Path) -> Result<Self, NetError> {
        match create(path) {
            Err(error) if error.kind() != io::ErrorKind::AlreadyExists => {
                Err(NetError::Token { path: path.into(), why: format!("cannot be made: {error}") })
            }
            _ => Self::read(path),
        }
    }

    /// Returns the default place of a user's token: `$MOCA_TOKEN_FILE`, or `mocad/token` in `$XDG_CONFIG_HOME`
    /// (`~/.config`).
    pub fn default_path() -> Option<PathBuf> {
        named_path(TOKEN_VARIABLE, "token")
    }

    /// The answer to a connection's challenge.
    pub fn proof(&self, nonce: &[u8; 32]) -> [u8; 32] {
        *blake3::keyed_hash(&self.0, nonce).as_bytes()
    }

    /// Returns true if a proof belongs to this token and this challenge; a wrong proof takes as long as the right one.
    pub fn admits(&self, nonce: &[u8; 32], proof: &[u8; 32]) -> bool {
        blake3::keyed_hash(&self.0, nonce) == blake3::Hash::from_bytes(*proof)
    }
}

/// Returns the file that a variable names, or `mocad/FILE` in `$XDG_CONFIG_HOME` (`~/.config`).
pub(super) fn named_path(variable: &str, file: &str) -> Option<PathBuf> {
    let folder = |variable| env::var_os(variable).map(PathBuf::from).filter(|path| path.is_absolute());
    folder(variable).or_else(|| {
        let config = folder("XDG_CONFIG_HOME").or_else(|| Some(folder("HOME")?.join(".config")));
        Some(config?.join("mocad").join(file))
    })
}

/// Random bytes from the operating system.
fn random() -> io::Result<[u8; 32]> {
    let mut bytes = [0; 32];
    File::open("/dev/urandom")?.read_exact(&mut bytes)?;
    Ok(bytes)
}

fn create(path: &Path) -> io::Result<()> {
    if path.exists() {
        return Ok(());
    }
    if let Some(folder) = path.parent() {
        DirBuilder::new().recursive(true).mode(0o700).create(folder)?;
    }
    let mut file = OpenOptions::new().write(true).create_new(true).mode(0o600).open(path)?;
    let secret: String = random()?.iter().map(|byte| format!("{byte:02x}")).collect();
    writeln!(file, "{secret}")
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::os::unix::fs::PermissionsExt;

    #[test]
    fn readable_token_file_is_refused_with_path_and_mode() {
        let path = std::env::temp_dir().join(format!("moca-token-{}/token", std::process::id()));
        let made = Token::read_or_create(&path).unwrap();
        assert_eq!(std::fs::metadata(&path).unwrap().permissions().mode() & 0o777, 0o600);
        assert_eq!(Token::read_or_create(&path).unwrap(), made, "made once");
        for mode in [0o640, 0o604, 0o660] {
            std::fs::set_permissions(&path, std::fs::Permissions::from_mode(mode)).unwrap();
            let said = Token::read(&path).unwrap_err().to_string();
            assert!(said.contains(path.to_str().unwrap()) && said.contains(&format!("{mode:04o}")), "{said}");
        }
        std::fs::set_permissions(&path, std::fs::Permissions::from_mode(0o600)).unwrap();
        std::fs::write(&path, "short\n").unwrap();
        assert!(Token::read(&path).unwrap_err().to_string().contains("5 bytes"));
        std::fs::remove_dir_all(path.parent().unwrap()).unwrap();
        assert!(Token::read(&path).unwrap_err().to_string().contains("No such file"));
    }
}
