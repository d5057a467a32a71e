//! Random secrets, and what is stored of them.

use anyhow::Context;
use ring::{
    digest,
    rand::{SecureRandom, SystemRandom},
};
use std::fmt::Write as _;

/// Letters of a code: no I, L, O or U, which are misread.
const LETTERS: &[u8; 32] = b"0123456789ABCDEFGHJKMNPQRSTVWXYZ";
/// Letters of a code: 40 random bits.
pub(super) const CODE_LETTERS: usize = 8;

/// SHA-256 in hexadecimal. A secret of 256 random bits needs no slow hash, nor does a code that lives for two minutes.
pub(super) fn sha256(bytes: &[u8]) -> String {
    hex(digest::digest(&digest::SHA256, bytes).as_ref())
}

/// A secret of 256 random bits in hexadecimal.
pub(super) fn token() -> anyhow::Result<String> {
    Ok(hex(&random::<32>()?))
}

/// A code that a person reads and types.
pub(super) fn code() -> anyhow::Result<String> {
    let bytes = random::<CODE_LETTERS>()?;
    Ok(bytes.iter().map(|byte| char::from(LETTERS[usize::from(byte & 31)])).collect())
}

fn random<const N: usize>() -> anyhow::Result<[u8; N]> {
    let mut bytes = [0; N];
    SystemRandom::new().fill(&mut bytes).ok().context("the system gives no random numbers")?;
    Ok(bytes)
}

fn hex(bytes: &[u8]) -> String {
    bytes.iter().fold(String::with_capacity(2 * bytes.len()), |mut text, byte| {
        // Writing to a string cannot fail.
        let _ = write!(text, "{byte:02x}");
        text
    })
}
