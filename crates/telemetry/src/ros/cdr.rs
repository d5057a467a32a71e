//! CDR, version 1, as ROS 2 puts it on the wire: four bytes that say the byte order, then each field at a multiple of its
//! own size.
//!
//! ```
//! use moca_telemetry::ros::cdr::{self, CdrError};
//! use moca_telemetry::ros::messages::{Twist, Vector3};
//!
//! let twist = Twist { linear: Vector3 { x: 0.1, ..Vector3::default() }, ..Twist::default() };
//! let bytes = cdr::encode(&twist);
//! assert_eq!(cdr::decode::<Twist>(&bytes), Ok(twist));
//! assert_eq!(cdr::decode::<Twist>(&bytes[..20]), Err(CdrError::Truncated { at: 16, wanted: 8 }));
//! ```

use super::definition::Definitions;

/// Header of all our payloads: little-endian, no options.
const LITTLE_ENDIAN: [u8; 4] = [0, 1, 0, 0];
/// Bytes that a transport may append to fill a word.
const PADDING_MAX: usize = 3;

/// Why bytes are not the message that they should be.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum CdrError {
    /// A payload begins with 0, 0 (big-endian) or 0, 1 (little-endian), and two bytes more.
    #[error("payload does not begin as CDR version 1 does")]
    Encoding,
    /// The message ends within a field.
    #[error("{wanted} bytes wanted at byte {at}, and the message ends before")]
    Truncated {
        /// Place, counted from the first field.
        at: usize,
        /// Number of bytes needed.
        wanted: usize,
    },
    /// The message is longer than its type.
    #[error("{bytes} bytes are left over: another type")]
    LeftOver {
        /// Number of bytes.
        bytes: usize,
    },
    /// A text is not UTF-8 with a zero behind it.
    #[error("text at byte {at} is not UTF-8 that ends with 0")]
    Text {
        /// Place, counted from the first field.
        at: usize,
    },
    /// A flag is neither 0 nor 1.
    #[error("flag at byte {at} is {value}; allowed: 0 or 1")]
    Flag {
        /// Place, counted from the first field.
        at: usize,
        /// Invalid value.
        value: u8,
    },
}

/// Type of a message's field.
pub trait Field {
    /// Its type in a definition.
    fn ros_type() -> String;
    /// Appends this value.
    fn write(&self, to: &mut Writer);
    /// Adds the definitions of the messages that it is made of.
    fn define(_types: &mut Definitions) {}
}

/// Adds a field of a message to its definition; the function that picks it says what it is.
pub(crate) fn define<M, F: Field>(types: &mut Definitions, message: usize, name: &str, _: fn(&M) -> &F) {
    types.line(message, name, &F::ros_type());
    F::define(types);
}

/// A field that comes in as well.
pub trait Decode: Field + Sized {
    /// Least number of bytes on the wire: what a list's announced length is held against before memory is taken.
    const BYTES_MIN: usize;
    /// Takes the next value.
    ///
    /// # Errors
    /// The bytes do not encode this type.
    fn read(from: &mut Reader<'_>) -> Result<Self, CdrError>;
}

/// A payload: byte order, then the message.
pub fn encode(message: &impl Field) -> Vec<u8> {
    let mut writer = Writer::default();
    writer.encode(message);
    writer.bytes
}

/// The message of a whole payload.
///
/// # Errors
/// Bytes that are not exactly one message of this type.
pub fn decode<T: Decode>(payload: &[u8]) -> Result<T, CdrError> {
    let mut reader = Reader::new(payload)?;
    let message = T::read(&mut reader)?;
    let bytes = reader.body.len() - reader.at;
    if bytes > PADDING_MAX { Err(CdrError::LeftOver { bytes }) } else { Ok(message) }
}

/// Payloads, one after the other in the same memory.
#[derive(Clone, Debug, Default)]
pub struct Writer {
    bytes: Vec<u8>,
    /// True if numbers keep only the precision of an `f32`: the rest is noise that no compressor can take out.
    rounded: bool,
}

impl Writer {
    /// For messages that are kept: with 24 bits of each number.
    pub const fn rounded() -> Self {
        Self { bytes: Vec::new(), rounded: true }
    }

    /// The payload of `message`.
    pub fn encode(&mut self, message: &impl Field) -> &[u8] {
        self.bytes.clear();
        self.bytes.extend(LITTLE_ENDIAN);
        message.write(self);
        &self.bytes
    }

    /// A number lies at a multiple of its own size, counted from the first field.
    fn put<const N: usize>(&mut self, value: [u8; N]) {
        let at = self.bytes.len() - LITTLE_ENDIAN.len();
        self.bytes.resize(LITTLE_ENDIAN.len() + at.next_multiple_of(N), 0);
        self.bytes.extend(value);
    }

    fn count(&mut self, count: usize) {
        // A message of 4 GiB could not be sent either.
        self.put(u32::try_from(count).unwrap_or(u32::MAX).to_le_bytes());
    }
}

/// A payload that is read.
#[derive(Debug)]
pub struct Reader<'a> {
    body: &'a [u8],
    at: usize,
    big_endian: bool,
}

impl<'a> Reader<'a> {
    fn new(payload: &'a [u8]) -> Result<Self, CdrError> {
        let (start, body) = payload.split_first_chunk::<4>().ok_or(CdrError::Encoding)?;
        let big_endian = match start {
            [0, 0, ..] => true,
            [0, 1, ..] => false,
            _ => return Err(CdrError::Encoding),
        };
        Ok(Self { body, at: 0, big_endian })
    }

    fn bytes(&mut self, count: usize) -> Result<&'a [u8], CdrError> {
        let end = self.at.checked_add(count).filter(|end| *end <= self.body.len());
        let end = end.ok_or(CdrError::Truncated { at: self.at, wanted: count })?;
        let bytes = &self.body[self.at..end];
        self.at = end;
        Ok(bytes)
    }

    fn take<const N: usize>(&mut self) -> Result<[u8; N], CdrError> {
        let padding = self.at.next_multiple_of(N) - self.at;
        if self.body.len() - self.at < padding {
            return Err(CdrError::Truncated { at: self.at, wanted: N });
        }
        self.at += padding;
        let mut value = [0; N];
        value.copy_from_slice(self.bytes(N)?);
        if self.big_endian {
            value.reverse();
        }
        Ok(value)
    }

    /// An announced number of elements, each of at least `bytes_min` bytes.
    fn count(&mut self, bytes_min: usize) -> Result<usize, CdrError> {
        let count = usize::try_from(u32::from_le_bytes(self.take()?)).unwrap_or(usize::MAX);
        let wanted = count.saturating_mul(bytes_min.max(1));
        if wanted > self.body.len() - self.at {
            return Err(CdrError::Truncated { at: self.at, wanted });
        }
        Ok(count)
    }
}

macro_rules! number {
    ($($type:ty => $ros:literal),*) => {$(
        impl Field for $type {
            fn ros_type() -> String {
                $ros.into()
            }

            fn write(&self, to: &mut Writer) {
                to.put(self.to_le_bytes());
            }
        }

        impl Decode for $type {
            const BYTES_MIN: usize = size_of::<$type>();

            fn read(from: &mut Reader<'_>) -> Result<Self, CdrError> {
                Ok(Self::from_le_bytes(from.take()?))
            }
        }
    )*};
}
number!(
    u8 => "uint8", u16 => "uint16", u32 => "uint32", u64 => "uint64", i32 => "int32", i64 => "int64", f32 => "float32"
);

impl Field for f64 {
    fn ros_type() -> String {
        "float64".into()
    }

    fn write(&self, to: &mut Writer) {
        #[expect(clippy::cast_possible_truncation, reason = "rounding is what is asked for")]
        let number = if to.rounded { Self::from(*self as f32) } else { *self };
        to.put(number.to_le_bytes());
    }
}

impl Decode for f64 {
    const BYTES_MIN: usize = 8;

    fn read(from: &mut Reader<'_>) -> Result<Self, CdrError> {
        Ok(Self::from_le_bytes(from.take()?))
    }
}

impl Field for bool {
    fn ros_type() -> String {
        "bool".into()
    }

    fn write(&self, to: &mut Writer) {
        to.put([u8::from(*self)]);
    }
}

impl Decode for bool {
    const BYTES_MIN: usize = 1;

    fn read(from: &mut Reader<'_>) -> Result<Self, CdrError> {
        let at = from.at;
        match u8::read(from)? {
            0 => Ok(false),
            1 => Ok(true),
            value => Err(CdrError::Flag { at, value }),
        }
    }
}

impl Field for str {
    fn ros_type() -> String {
        "string".into()
    }

    fn write(&self, to: &mut Writer) {
        to.count(self.len() + 1);
        to.bytes.extend(self.as_bytes());
        to.bytes.push(0);
    }
}

impl Field for String {
    fn ros_type() -> String {
        str::ros_type()
    }

    fn write(&self, to: &mut Writer) {
        self.as_str().write(to);
    }
}

impl Decode for String {
    const BYTES_MIN: usize = 4;

    fn read(from: &mut Reader<'_>) -> Result<Self, CdrError> {
        let count = from.count(1)?;
        let at = from.at;
        let bytes = from.bytes(count)?;
        // Some writers announce an empty text as no bytes at all.
        let text = if count == 0 { Some(&[][..]) } else { bytes.strip_suffix(&[0]) };
        text.and_then(|text| Self::from_utf8(text.to_vec()).ok()).ok_or(CdrError::Text { at })
    }
}

impl<F: Field> Field for Vec<F> {
    fn ros_type() -> String {
        format!("{}[]", F::ros_type())
    }

    fn write(&self, to: &mut Writer) {
        to.count(self.len());
        self.iter().for_each(|element| element.write(to));
    }

    fn define(types: &mut Definitions) {
        F::define(types);
    }
}

impl<F: Decode> Decode for Vec<F> {
    const BYTES_MIN: usize = 4;

    fn read(from: &mut Reader<'_>) -> Result<Self, CdrError> {
        let count = from.count(F::BYTES_MIN)?;
        (0..count).map(|_| F::read(from)).collect()
    }
}

impl<F: Field, const N: usize> Field for [F; N] {
    fn ros_type() -> String {
        format!("{}[{N}]", F::ros_type())
    }

    fn write(&self, to: &mut Writer) {
        self.iter().for_each(|element| element.write(to));
    }

    fn define(types: &mut Definitions) {
        F::define(types);
    }
}

impl<F: Decode + Copy + Default, const N: usize> Decode for [F; N] {
    const BYTES_MIN: usize = N * F::BYTES_MIN;

    fn read(from: &mut Reader<'_>) -> Result<Self, CdrError> {
        let mut elements = [F::default(); N];
        for element in &mut elements {
            *element = F::read(from)?;
        }
        Ok(elements)
    }
}
