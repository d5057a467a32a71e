//! Parameters as a client sees them: schema, default, present value.
//!
//! ```
//! use moca_telemetry::{ParameterDescription, ParameterValue};
//! let parameter = ParameterDescription {
//!     name: "control.gains.damping_ratio".into(),
//!     max: 5.0,
//!     live: true,
//!     value: ParameterValue::Numbers(vec![0.9]),
//!     ..ParameterDescription::default()
//! };
//! assert!(parameter.checked(&[1.2]).is_ok());
//! assert_eq!(parameter.checked(&[7.0]).unwrap_err(), "control.gains.damping_ratio = 7 is outside 0 to 5");
//! ```

use moca_msgs::{ParameterValues, Refusal};
use serde::{Deserialize, Serialize};
use std::fmt;

/// One parameter.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct ParameterDescription {
    /// Dotted name as in the configuration file.
    pub name: String,
    /// Values that it may hold.
    pub form: ParameterForm,
    /// Unit of each element, or one for all; empty where there is none.
    pub units: Vec<String>,
    /// Smallest allowed value; of no meaning for text and choices.
    pub min: f64,
    /// Largest allowed value.
    pub max: f64,
    /// True if it can be changed while the loop runs.
    pub live: bool,
    /// One line for the user.
    pub description: String,
    /// Value it has where the configuration says nothing.
    pub default: ParameterValue,
    /// Value it has now.
    pub value: ParameterValue,
}

/// Values that a parameter may hold.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub enum ParameterForm {
    /// A number, or a list of them.
    #[default]
    Number,
    /// A whole number, or a list of them.
    Integer,
    /// True or false, as 1 or 0.
    Flag,
    /// Text.
    Text,
    /// One of these words.
    Choice(Vec<String>),
}

/// Value of a parameter.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub enum ParameterValue {
    /// Its elements.
    Numbers(Vec<f64>),
    /// Text, or the chosen word.
    Text(String),
}

impl Default for ParameterValue {
    fn default() -> Self {
        Self::Numbers(Vec::new())
    }
}

impl ParameterDescription {
    /// Unit of an element.
    pub fn unit(&self, element: usize) -> &str {
        self.units.get(element).or(self.units.last()).map_or("", String::as_str)
    }

    /// `values` as they travel in [`moca_msgs::Request::SetParameter`].
    ///
    /// # Errors
    /// For the user: name, value, unit and what is allowed.
    pub fn checked(&self, values: &[f64]) -> Result<ParameterValues, String> {
        let name = &self.name;
        let ParameterValue::Numbers(present) = &self.value else {
            return Err(format!("{name} is text, which is read at the start only"));
        };
        if !self.live {
            return Err(format!("{name} is read at the start only: change it in the configuration file"));
        }
        if values.len() != present.len() {
            return Err(format!("{name} has {} elements, not {}", present.len(), values.len()));
        }
        for (element, &value) in values.iter().enumerate() {
            let whole = self.form == ParameterForm::Number || value % 1.0 == 0.0;
            if !(value >= self.min && value <= self.max && whole) {
                let unit = self.unit(element);
                let space = if unit.is_empty() { "" } else { " " };
                let (min, max) = (self.min, self.max);
                return Err(format!("{name} = {value}{space}{unit} is outside {min} to {max}{space}{unit}"));
            }
        }
        ParameterValues::new(values).ok_or_else(|| format!("{name} has too many elements to travel"))
    }

    /// Why [`moca_msgs::Refusal::Unstable`] refused a value: what is stable, unit and range.
    pub fn unstable(&self, nearest: &ParameterValues) -> String {
        let units = self.units.join(", ");
        let space = if units.is_empty() { "" } else { " " };
        let range = format!("its range is {} to {}{space}{units}", self.min, self.max);
        match nearest.as_slice() {
            [] => format!(
                "not stable with this robot at this rate and posture, nor are the present values ({range})"
            ),
            stable => {
                let stable = ParameterValue::Numbers(stable.iter().map(|x| four_digits(*x)).collect());
                let stable = self.shown(&stable);
                format!(
                    "not stable with this robot at this rate and posture; on the way there {stable}{space}{units} \
                     still is ({range})"
                )
            }
        }
    }

    /// Why a change of this parameter was refused, for people.
    pub fn why(&self, refusal: Refusal) -> String {
        match refusal {
            Refusal::Unstable { nearest } => self.unstable(&nearest),
            _ => refusal.to_string(),
        }
    }

    /// A value as in the configuration file.
    pub fn shown(&self, value: &ParameterValue) -> String {
        match (value, &self.form) {
            (ParameterValue::Numbers(numbers), ParameterForm::Flag) => {
                if numbers.first().is_some_and(|flag| *flag > 0.5) { "true".into() } else { "false".into() }
            }
            _ => value.to_string(),
        }
    }
}

/// A number with four digits, for people.
fn four_digits(number: f64) -> f64 {
    format!("{number:.3e}").parse().unwrap_or(number)
}

impl fmt::Display for ParameterValue {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Text(text) => write!(f, "{text:?}"),
            Self::Numbers(numbers) => match numbers.as_slice() {
                [one] => write!(f, "{one}"),
                many => write!(f, "{many:?}"),
            },
        }
    }
}
