//! Messages as ROS 2 writes them: common data representation, little-endian, version 1, and the definition that says how to
//! read them. A message lists its fields once; bytes and definition both come from that list.

use std::fmt::Write;

/// What a field of a message can be.
pub trait Field {
    /// Its type in a definition.
    fn ros_type() -> String;
    /// Appends it.
    fn write(&self, to: &mut Cdr);
    /// Adds the definitions of the messages that it is made of.
    fn define(_types: &mut Definitions) {}
}

/// A message with a name.
pub trait Message: Field {
    /// Package, `msg` and type: `geometry_msgs/msg/PoseStamped`.
    const NAME: &'static str;
}

/// The definition of a message and of every message within it, as a `ros2msg` schema.
pub fn definition<M: Message>() -> String {
    let mut types = Definitions::default();
    M::define(&mut types);
    let mut text = String::new();
    for (i, (name, fields)) in types.0.iter().enumerate() {
        if i > 0 {
            // a String takes everything
            let _ = write!(text, "{:=<80}\nMSG: {}\n", "", short(name));
        }
        text.push_str(fields);
    }
    text
}

/// A name as definitions have it: without `msg`.
pub(super) fn short(name: &str) -> String {
    name.replace("/msg/", "/")
}

/// Messages and the lines of their fields, the outermost first.
#[derive(Default)]
pub struct Definitions(Vec<(&'static str, String)>);

impl Definitions {
    /// Where the fields of a message go; `None` if they are there.
    pub(super) fn begin(&mut self, name: &'static str) -> Option<usize> {
        if self.0.iter().any(|(known, _)| *known == name) {
            return None;
        }
        self.0.push((name, String::new()));
        Some(self.0.len() - 1)
    }

    /// Adds a field; the function that picks it says what it is.
    pub(super) fn field<M, F: Field>(&mut self, message: usize, name: &str, _: fn(&M) -> &F) {
        let name = name.trim_start_matches("r#");
        // a String takes everything
        let _ = writeln!(self.0[message].1, "{} {name}", F::ros_type());
        F::define(self);
    }
}

/// Bytes of one message after the other.
#[derive(Clone, Debug, Default)]
pub struct Cdr {
    bytes: Vec<u8>,
    /// Whether numbers keep only the precision of an `f32`: the rest is noise that no compressor can take out.
    rounded: bool,
}

/// Version 1 of the representation, little-endian, no options.
const ENCAPSULATION: [u8; 4] = [0, 1, 0, 0];

impl Cdr {
    /// For messages that are kept: with 24 bits of each number.
    pub const fn rounded() -> Self {
        Self { bytes: Vec::new(), rounded: true }
    }

    /// The bytes of `message`.
    pub fn encode(&mut self, message: &impl Message) -> &[u8] {
        self.bytes.clear();
        self.bytes.extend(ENCAPSULATION);
        message.write(self);
        &self.bytes
    }

    /// A primitive lies at a multiple of its own size, counted from the end of the encapsulation.
    fn put<const N: usize>(&mut self, bytes: [u8; N]) {
        let begun = self.bytes.len() - ENCAPSULATION.len();
        self.bytes.resize(begun.next_multiple_of(N) + ENCAPSULATION.len(), 0);
        self.bytes.extend(bytes);
    }

    fn length(&mut self, length: usize) {
        self.put(u32::try_from(length).unwrap_or(u32::MAX).to_le_bytes());
    }

    fn text(&mut self, text: &str) {
        self.length(text.len() + 1);
        self.bytes.extend(text.as_bytes());
        self.bytes.push(0);
    }
}

macro_rules! primitive {
    ($($rust:ty => $ros:literal),*) => {
        $(impl Field for $rust {
            fn ros_type() -> String {
                $ros.into()
            }

            fn write(&self, to: &mut Cdr) {
                to.put(self.to_le_bytes());
            }
        })*
    };
}

primitive!(u8 => "uint8", u16 => "uint16", u32 => "uint32", u64 => "uint64", i32 => "int32", f32 => "float32");

impl Field for f64 {
    fn ros_type() -> String {
        "float64".into()
    }

    fn write(&self, to: &mut Cdr) {
        #[expect(clippy::cast_possible_truncation, reason = "rounding is what is asked for")]
        let number = if to.rounded { Self::from(*self as f32) } else { *self };
        to.put(number.to_le_bytes());
    }
}

impl Field for bool {
    fn ros_type() -> String {
        "bool".into()
    }

    fn write(&self, to: &mut Cdr) {
        to.put([u8::from(*self)]);
    }
}

impl Field for String {
    fn ros_type() -> String {
        "string".into()
    }

    fn write(&self, to: &mut Cdr) {
        to.text(self);
    }
}

impl<F: Field> Field for Vec<F> {
    fn ros_type() -> String {
        format!("{}[]", F::ros_type())
    }

    fn write(&self, to: &mut Cdr) {
        to.length(self.len());
        self.iter().for_each(|element| element.write(to));
    }

    fn define(types: &mut Definitions) {
        F::define(types);
    }
}

impl<F: Field, const N: usize> Field for [F; N] {
    fn ros_type() -> String {
        format!("{}[{N}]", F::ros_type())
    }

    fn write(&self, to: &mut Cdr) {
        self.iter().for_each(|element| element.write(to));
    }

    fn define(types: &mut Definitions) {
        F::define(types);
    }
}

/// Words of a closed list travel as their names.
macro_rules! names {
    ($($words:ty),*) => {
        $(impl $crate::display::cdr::Field for $words {
            fn ros_type() -> String {
                "string".into()
            }

            fn write(&self, to: &mut $crate::display::cdr::Cdr) {
                self.name().to_owned().write(to);
            }
        })*
    };
}
pub(super) use names;

/// The fields of a message in their order; forgetting one does not compile.
macro_rules! message {
    ($name:literal $message:ident { $($field:ident),* $(,)? }) => {
        impl $crate::display::cdr::Field for $message {
            fn ros_type() -> String {
                $crate::display::cdr::short($name)
            }

            fn write(&self, to: &mut $crate::display::cdr::Cdr) {
                let Self { $($field),* } = self;
                $($field.write(to);)*
            }

            fn define(types: &mut $crate::display::cdr::Definitions) {
                if let Some(at) = types.begin($name) {
                    $(types.field(at, stringify!($field), |message: &Self| &message.$field);)*
                }
            }
        }

        impl $crate::display::cdr::Message for $message {
            const NAME: &'static str = $name;
        }
    };
    ($name:literal = $(#[$doc:meta])* struct $message:ident { $($field:ident: $type:ty),* $(,)? }) => {
        $(#[$doc])*
        #[derive(Clone, Debug, Default, PartialEq)]
        pub(super) struct $message {
            $(pub(super) $field: $type),*
        }

        $crate::display::cdr::message! { $name $message { $($field),* } }
    };
}
pub(super) use message;
