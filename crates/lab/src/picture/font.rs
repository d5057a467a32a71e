//! The font of pictures, and the reasons why there is none.

use std::fmt;

/// DejaVu Sans, reduced to what figures need (assets/LICENSE-DejaVu).
pub(super) const FONT: &[u8] = include_bytes!("../../assets/DejaVuSans-subset.ttf");

/// Why there is no picture.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) enum PictureError {
    /// The embedded font lacks a character.
    NoGlyph {
        /// Which.
        character: char,
        /// In what.
        text: String,
    },
    /// The renderer refused.
    Render(String),
}

impl fmt::Display for PictureError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::NoGlyph { character, text } => {
                write!(f, "the embedded font has no glyph for '{character}' of \"{text}\"")
            }
            Self::Render(why) => write!(f, "cannot draw the picture: {why}"),
        }
    }
}

impl std::error::Error for PictureError {}

pub(super) fn refused(why: &dyn fmt::Display) -> PictureError {
    PictureError::Render(why.to_string())
}
