//! Parameter tables: a struct whose fields are declared once, each with sentence, type, default, unit, range and whether
//! it can be changed live. From that one row come the field, its key in the configuration file, its line in the schema,
//! its live setting and its name in the laboratory.
//!
//! ```
//! moca_msgs::parameter_table! {
//!     /// What a brake does.
//!     #[derive(Clone, Debug, PartialEq)]
//!     pub struct Brake in "plant.brake" {
//!         /// Largest deceleration.
//!         deceleration_m_s2: f64 = 3.0 => [.range(0.1, 10.0).units(&["m/s²"]).live()];
//!         /// Whether it also holds.
//!         holds: bool = true;
//!     }
//! }
//! assert_eq!(Brake::ROWS[0].name, "plant.brake.deceleration_m_s2");
//! assert_eq!(Brake::ROWS[1].description, "Whether it also holds.");
//! assert!(Brake::default().holds);
//! ```

#[cfg(feature = "alloc")]
use alloc::{borrow::ToOwned, string::String, vec::Vec};

/// Values that a parameter may hold.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ParameterKind {
    /// A number, or a list of them.
    Number,
    /// A whole number, or a list of them.
    Integer,
    /// True or false; 1 or 0 where it travels as a number.
    Flag,
    /// Text.
    Text,
    /// One of these words.
    Choice(&'static [&'static str]),
}

/// Number of elements of a parameter.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Size {
    /// One, written without brackets.
    One,
    /// A list of exactly this many.
    Exactly(usize),
    /// A list with one element for each joint of the arm.
    Joints,
    /// A list of up to this many.
    AtMost(usize),
}

/// One row of a parameter table.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ParameterSpec {
    /// Dotted name as in the configuration file.
    pub name: &'static str,
    /// Values that it may hold.
    pub kind: ParameterKind,
    /// Number of elements.
    pub size: Size,
    /// Unit of each element, or one for all of them; empty where there is none.
    pub units: &'static [&'static str],
    /// Smallest allowed value; of no meaning for text and choices.
    pub min: f64,
    /// Largest allowed value.
    pub max: f64,
    /// True if it can be changed while the loop runs.
    pub live: bool,
    /// Short name in the laboratory; empty where only the dotted name is used.
    pub lab: &'static str,
    /// One line for the user.
    pub description: &'static str,
}

impl ParameterSpec {
    /// A row for a field of type `T`: any value of a flag, text or choice, any whole number from 0, any number.
    pub const fn of<T: Typed>(name: &'static str, description: &'static str) -> Self {
        let (min, max) = match T::KIND {
            ParameterKind::Flag => (0.0, 1.0),
            ParameterKind::Number => (f64::MIN, f64::MAX),
            ParameterKind::Integer => (0.0, 9e15),
            ParameterKind::Text | ParameterKind::Choice(_) => (0.0, 0.0),
        };
        let description = description.trim_ascii();
        Self { name, kind: T::KIND, size: T::SIZE, units: &[], min, max, live: false, lab: "", description }
    }

    /// Returns the row with its smallest and largest allowed value.
    #[must_use]
    pub const fn range(self, min: f64, max: f64) -> Self {
        Self { min, max, ..self }
    }

    /// Returns the row with the unit of each element, or one for all.
    #[must_use]
    pub const fn units(self, units: &'static [&'static str]) -> Self {
        Self { units, ..self }
    }

    /// Returns the row with one element for each joint of the arm.
    #[must_use]
    pub const fn per_joint(self) -> Self {
        Self { size: Size::Joints, ..self }
    }

    /// Returns the row, changeable while the loop runs.
    #[must_use]
    pub const fn live(self) -> Self {
        Self { live: true, ..self }
    }

    /// Returns the row with a short name in the laboratory.
    #[must_use]
    pub const fn lab(self, lab: &'static str) -> Self {
        Self { lab, ..self }
    }

    /// Unit of an element.
    pub fn unit(&self, element: usize) -> &'static str {
        self.units.get(element).or(self.units.last()).copied().unwrap_or("")
    }

    /// The first element of `values` outside the range, as an error that names it. NaN and infinity always are.
    ///
    /// # Errors
    /// Value, unit and range of the offending element.
    pub fn check(&self, values: &[f64]) -> Result<(), ParameterError> {
        for (element, &value) in values.iter().enumerate() {
            let whole = matches!(self.kind, ParameterKind::Number) || value % 1.0 == 0.0;
            if !(value >= self.min && value <= self.max && whole) {
                let (name, unit) = (self.name, self.unit(element));
                return Err(ParameterError { name, value, unit, min: self.min, max: self.max });
            }
        }
        Ok(())
    }
}

/// A parameter outside its range: which, its value, its unit and what is allowed.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ParameterError {
    /// Dotted name as in the configuration file.
    pub name: &'static str,
    /// The offending value.
    pub value: f64,
    /// Its unit.
    pub unit: &'static str,
    /// Smallest allowed value.
    pub min: f64,
    /// Largest allowed value.
    pub max: f64,
}

impl core::fmt::Display for ParameterError {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        let Self { name, value, unit, min, max } = self;
        let space = if unit.is_empty() { "" } else { " " };
        write!(f, "{name} = {value}{space}{unit} is outside {min} to {max}{space}{unit}")
    }
}

impl core::error::Error for ParameterError {}

/// The value of a field, whatever its type.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum FieldValue<'a> {
    /// Its elements; a flag is 1 or 0.
    Numbers(&'a [f64]),
    /// Text, or the chosen word.
    Text(&'a str),
    /// Several texts.
    Texts(&'a [&'a str]),
}

/// Type of a field, with the values that it may hold.
pub trait Typed {
    /// Kind of its elements.
    const KIND: ParameterKind;
    /// Number of elements.
    const SIZE: Size;
}

/// A field of a parameter table.
pub trait Field {
    /// Shows its value to `see`, once.
    fn see(&self, see: &mut dyn FnMut(FieldValue<'_>));

    /// Takes a value; `false` for one that this type cannot hold, and nothing is changed. Ranges are not its business.
    fn take(&mut self, value: FieldValue<'_>) -> bool;
}

impl Typed for f64 {
    const KIND: ParameterKind = ParameterKind::Number;
    const SIZE: Size = Size::One;
}

impl Field for f64 {
    fn see(&self, see: &mut dyn FnMut(FieldValue<'_>)) {
        see(FieldValue::Numbers(&[*self]));
    }

    fn take(&mut self, value: FieldValue<'_>) -> bool {
        let FieldValue::Numbers(&[value]) = value else { return false };
        *self = value;
        true
    }
}

impl<const N: usize> Typed for [f64; N] {
    const KIND: ParameterKind = ParameterKind::Number;
    const SIZE: Size = Size::Exactly(N);
}

impl<const N: usize> Field for [f64; N] {
    fn see(&self, see: &mut dyn FnMut(FieldValue<'_>)) {
        see(FieldValue::Numbers(self));
    }

    fn take(&mut self, value: FieldValue<'_>) -> bool {
        let FieldValue::Numbers(values) = value else { return false };
        let Ok(values) = values.try_into() else { return false };
        *self = values;
        true
    }
}

impl Typed for bool {
    const KIND: ParameterKind = ParameterKind::Flag;
    const SIZE: Size = Size::One;
}

impl Field for bool {
    fn see(&self, see: &mut dyn FnMut(FieldValue<'_>)) {
        see(FieldValue::Numbers(&[f64::from(u8::from(*self))]));
    }

    fn take(&mut self, value: FieldValue<'_>) -> bool {
        let FieldValue::Numbers(&[value]) = value else { return false };
        *self = value > 0.5;
        true
    }
}

macro_rules! whole_numbers {
    ($($type:ty),*) => { $(
        impl Typed for $type {
            const KIND: ParameterKind = ParameterKind::Integer;
            const SIZE: Size = Size::One;
        }

        impl Field for $type {
            fn see(&self, see: &mut dyn FnMut(FieldValue<'_>)) {
                #[allow(clippy::cast_precision_loss, clippy::cast_lossless, reason = "ranges end below 2^53")]
                see(FieldValue::Numbers(&[*self as f64]));
            }

            fn take(&mut self, value: FieldValue<'_>) -> bool {
                let FieldValue::Numbers(&[value]) = value else { return false };
                #[allow(
                    clippy::cast_possible_truncation,
                    clippy::cast_sign_loss,
                    clippy::cast_precision_loss,
                    clippy::cast_lossless,
                    clippy::float_cmp,
                    reason = "a value that does not come back unchanged is refused"
                )]
                {
                    let whole = value as $type;
                    let fits = whole as f64 == value;
                    if fits {
                        *self = whole;
                    }
                    fits
                }
            }
        }
    )* };
}

whole_numbers!(u8, u32, u64, usize, i32);

#[cfg(feature = "alloc")]
impl Typed for String {
    const KIND: ParameterKind = ParameterKind::Text;
    const SIZE: Size = Size::One;
}

#[cfg(feature = "alloc")]
impl Field for String {
    fn see(&self, see: &mut dyn FnMut(FieldValue<'_>)) {
        see(FieldValue::Text(self));
    }

    fn take(&mut self, value: FieldValue<'_>) -> bool {
        let FieldValue::Text(text) = value else { return false };
        text.clone_into(self);
        true
    }
}

#[cfg(feature = "alloc")]
impl<T: Typed> Typed for Vec<T> {
    const KIND: ParameterKind = T::KIND;
    const SIZE: Size = Size::AtMost(crate::MAX_TAXELS);
}

#[cfg(feature = "alloc")]
impl<T: Typed + Field + Default> Field for Vec<T> {
    fn see(&self, see: &mut dyn FnMut(FieldValue<'_>)) {
        let mut numbers = Vec::with_capacity(self.len());
        for one in self {
            one.see(&mut |value| {
                if let FieldValue::Numbers(&[number]) = value {
                    numbers.push(number);
                }
            });
        }
        see(FieldValue::Numbers(&numbers));
    }

    fn take(&mut self, value: FieldValue<'_>) -> bool {
        let FieldValue::Numbers(values) = value else { return false };
        let mut taken = Self::with_capacity(values.len());
        for &value in values {
            let mut one = T::default();
            if !one.take(FieldValue::Numbers(&[value])) {
                return false;
            }
            taken.push(one);
        }
        *self = taken;
        true
    }
}

/// Makes an enum a field that holds one word: `choice!(Law { Impedance: "impedance", FollowMe: "follow-me" });`.
#[macro_export]
macro_rules! choice {
    ($Type:ty { $($Variant:ident: $word:literal),* $(,)? }) => {
        impl $crate::table::Typed for $Type {
            const KIND: $crate::table::ParameterKind = $crate::table::ParameterKind::Choice(&[$($word),*]);
            const SIZE: $crate::table::Size = $crate::table::Size::One;
        }

        impl $crate::table::Field for $Type {
            fn see(&self, see: &mut dyn FnMut($crate::table::FieldValue<'_>)) {
                see($crate::table::FieldValue::Text(match self { $(Self::$Variant => $word),* }));
            }

            fn take(&mut self, value: $crate::table::FieldValue<'_>) -> bool {
                *self = match value {
                    $($crate::table::FieldValue::Text($word) => Self::$Variant,)*
                    _ => return false,
                };
                true
            }
        }
    };
}

/// Declares a parameter table; see [`crate::table`]. `Name<const N: usize> in "section", for_arm(arm)` makes a table
/// whose defaults may be those of an arm's table; `besides { … }` adds fields that are no parameters.
#[macro_export]
macro_rules! parameter_table {
    (
        $(#[$meta:meta])* pub struct $Name:ident in $section:literal { $($rows:tt)* }
        $(besides { $($besides:tt)* })?
    ) => {
        $crate::parameter_table!(
            @table [$(#[$meta])*] $Name [] [] $section { $($rows)* } { $($($besides)*)? }
        );
        impl Default for $Name {
            fn default() -> Self {
                $crate::parameter_table!(@new { $($rows)* } { $($($besides)*)? })
            }
        }
    };
    (
        $(#[$meta:meta])* pub struct $Name:ident<const $N:ident: usize> in $section:literal, $make:ident($arm:ident) {
            $($rows:tt)*
        }
        $(besides { $($besides:tt)* })?
    ) => {
        $crate::parameter_table!(
            @table [$(#[$meta])*] $Name [const $N: usize] [$N] $section { $($rows)* } { $($($besides)*)? }
        );
        impl<const $N: usize> $Name<$N> {
            /// The defaults for this arm.
            #[allow(unused_variables, reason = "not every table has a default of the arm's")]
            pub const fn $make($arm: &$crate::ArmTable<$N>) -> Self {
                $crate::parameter_table!(@new { $($rows)* } { $($($besides)*)? })
            }
        }
    };
    (@new
        { $( $(#[doc = $about:literal])+ $field:ident: $type:ty = $default:expr $(=> [$($attribute:tt)*])?; )* }
        { $( $(#[$other_meta:meta])* $other:ident: $other_type:ty = $other_default:expr; )* }
    ) => {
        Self { $($field: $default,)* $($other: $other_default,)* }
    };
    (@table [$($meta:tt)*] $Name:ident [$($generics:tt)*] [$($arguments:tt)*] $section:literal
        { $( $(#[doc = $about:literal])+ $field:ident: $type:ty = $default:expr $(=> [$($attribute:tt)*])?; )* }
        { $( $(#[$other_meta:meta])* $other:ident: $other_type:ty = $other_default:expr; )* }
    ) => {
        $($meta)*
        pub struct $Name<$($generics)*> {
            $( $(#[doc = $about])+ pub $field: $type, )*
            $( $(#[$other_meta])* pub $other: $other_type, )*
        }

        impl<$($generics)*> $Name<$($arguments)*> {
            /// The rows of this table, in the order of its fields.
            pub const ROWS: &'static [$crate::table::ParameterSpec] = &[$(
                $crate::table::ParameterSpec::of::<$type>(
                    concat!($section, ".", stringify!($field)),
                    concat!($($about),+),
                )$($($attribute)*)?
            ),*];

            /// Hands every field with its row to `visit`, in the order of the rows.
            pub fn each(
                &mut self,
                visit: &mut dyn FnMut(&'static $crate::table::ParameterSpec, &mut dyn $crate::table::Field),
            ) {
                let mut rows = Self::ROWS.iter();
                $(
                    if let Some(row) = rows.next() {
                        visit(row, &mut self.$field);
                    }
                )*
            }
        }
    };
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn unrepresentable_value_is_refused_without_change() {
        let (mut number, mut three, mut byte, mut flag) = (1.0, [1.0; 3], 7_u8, true);
        assert!(!number.take(FieldValue::Numbers(&[1.0, 2.0])));
        assert!(!three.take(FieldValue::Numbers(&[1.0, 2.0])) && !three.take(FieldValue::Numbers(&[0.0; 4])));
        for bad in [-1.0, 256.0, 0.5, f64::NAN, f64::INFINITY] {
            assert!(!byte.take(FieldValue::Numbers(&[bad])), "{bad}");
        }
        assert!(!flag.take(FieldValue::Text("true")));
        assert_eq!((number, three, byte, flag), (1.0, [1.0; 3], 7, true));
    }
}
