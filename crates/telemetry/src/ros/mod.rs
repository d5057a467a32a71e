//! The messages of ROS 2: names and definitions, fields, and the bytes that carry them. A message lists its fields once;
//! bytes and definition both come from that list.
//!
//! - [`cdr`]: numbers, texts and lists as bytes, both ways.
//! - [`messages`]: the messages that a robot exchanges with others.
//! - [`definition()`]: how to read a message.

pub mod cdr;
mod definition;
pub mod messages;

pub use definition::{Definitions, TypeName};

/// A message with a name.
pub trait Message: cdr::Field {
    /// Its name.
    const TYPE: TypeName;
}

/// The definition of a message and of every message within it, as a `ros2msg` schema.
///
/// ```
/// use moca_telemetry::ros::{definition, messages::Twist};
///
/// assert!(definition::<Twist>().starts_with("geometry_msgs/Vector3 linear\ngeometry_msgs/Vector3 angular\n"));
/// ```
pub fn definition<M: Message>() -> String {
    let mut types = Definitions::default();
    M::define(&mut types);
    types.text()
}

/// Words of a closed list travel as their names.
macro_rules! names {
    ($($words:ty),*) => {
        $(impl $crate::ros::cdr::Field for $words {
            fn ros_type() -> String {
                str::ros_type()
            }

            fn write(&self, to: &mut $crate::ros::cdr::Writer) {
                self.name().write(to);
            }
        })*
    };
}
pub(crate) use names;

/// The fields of a message in their order; forgetting one does not compile.
macro_rules! message {
    ($name:literal $message:ident { $($field:ident),* $(,)? }) => {
        impl $crate::ros::cdr::Field for $message {
            fn ros_type() -> String {
                <Self as $crate::ros::Message>::TYPE.short()
            }

            fn write(&self, to: &mut $crate::ros::cdr::Writer) {
                let Self { $($field),* } = self;
                $($field.write(to);)*
            }

            fn define(types: &mut $crate::ros::Definitions) {
                if let Some(at) = types.begin(<Self as $crate::ros::Message>::TYPE) {
                    $($crate::ros::cdr::define(types, at, stringify!($field), |message: &Self| &message.$field);)*
                }
            }
        }

        impl $crate::ros::Message for $message {
            const TYPE: $crate::ros::TypeName = $crate::ros::TypeName($name);
        }
    };
    ($name:literal = $(#[$doc:meta])* $vis:vis struct $message:ident {
        $($(#[$field_doc:meta])* $field:ident: $type:ty),* $(,)?
    }) => {
        $(#[$doc])*
        #[derive(Clone, Debug, Default, PartialEq)]
        $vis struct $message { $($(#[$field_doc])* $vis $field: $type),* }

        $crate::ros::message! { $name $message { $($field),* } }

        impl $crate::ros::cdr::Decode for $message {
            const BYTES_MIN: usize = 0 $(+ <$type as $crate::ros::cdr::Decode>::BYTES_MIN)*;

            fn read(
                from: &mut $crate::ros::cdr::Reader<'_>,
            ) -> Result<Self, $crate::ros::cdr::CdrError> {
                Ok(Self { $($field: $crate::ros::cdr::Decode::read(from)?),* })
            }
        }
    };
}
pub(crate) use message;
