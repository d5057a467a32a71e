//! A sample, as bytes of doubles under the names of its fields.

use crate::gripper;
use moca_msgs::{
    ContactReaction, Law, STAGES, Sample, SpeedLimit, TaxelReading, TaxelStatus, sample_table, seconds,
};
use moca_telemetry::log::records::{Channel, Command, Cover};
use pyo3::exceptions::PyAttributeError;
use pyo3::prelude::*;
use pyo3::types::PyBytes;

/// One tick of a robot.
#[pyclass(frozen, module = "moca._moca")]
pub struct State(pub(crate) Sample);

/// The field of numbers with this name.
pub(crate) fn field(name: &str) -> Option<NumberField> {
    fields().into_iter().find(|field| field.name == name)
}

/// A field of numbers.
#[derive(Clone, Copy)]
pub(crate) struct NumberField {
    pub(crate) name: &'static str,
    /// True for one number, false for a list of them.
    pub(crate) single: bool,
    /// Topic of its record in a log; empty where every row has it.
    pub(crate) topic: &'static str,
    pub(crate) of: fn(&Sample) -> Vec<f64>,
}

/// Numbers that no field of a sample has as they are. Stale or dead is not zero: what is not known is no number.
const MADE: [NumberField; 6] = [
    NumberField { name: "time_s", single: true, topic: "", of: |sample| vec![seconds(sample.time_ns)] },
    NumberField {
        name: "speed_limit_m_s",
        single: true,
        topic: Command::TOPIC,
        of: |sample| vec![sample.speed_limit.m_s],
    },
    NumberField {
        name: "target_progress",
        single: true,
        topic: "",
        of: |sample| vec![sample.target.map_or(f64::NAN, |target| target.progress)],
    },
    NumberField {
        name: "gripper_width_m",
        single: true,
        topic: "",
        of: |sample| vec![sample.gripper.map_or(f64::NAN, |gripper| gripper.width_m)],
    },
    NumberField {
        name: "gripper_object_kg",
        single: true,
        topic: "",
        of: |sample| vec![sample.gripper.map_or(f64::NAN, |gripper| gripper.object_kg)],
    },
    NumberField {
        name: "taxel_force_n",
        single: false,
        topic: Cover::TOPIC,
        of: |sample| {
            let force = |taxel: &TaxelReading| match taxel.status {
                TaxelStatus::Ok => taxel.force_n,
                _ => f64::NAN,
            };
            sample.taxels.iter().map(force).collect()
        },
    },
];

/// Error text of a name that no field of numbers has.
pub(crate) fn no_field(name: &str) -> String {
    let names: Vec<&str> = fields().into_iter().map(|field| field.name).collect();
    format!("no field is called {name:?}; allowed: {}", names.join(", "))
}

/// A field of a sample as numbers, where it is any.
trait Numbers {
    /// True for one number, false for a list of them, `None` for anything else.
    const SINGLE: Option<bool> = None;

    fn numbers(&self) -> Vec<f64> {
        Vec::new()
    }
}

impl Numbers for f64 {
    const SINGLE: Option<bool> = Some(true);

    fn numbers(&self) -> Vec<f64> {
        vec![*self]
    }
}

impl<const N: usize> Numbers for [f64; N] {
    const SINGLE: Option<bool> = Some(false);

    fn numbers(&self) -> Vec<f64> {
        self.to_vec()
    }
}

impl<const N: usize> Numbers for heapless::Vec<f64, N> {
    const SINGLE: Option<bool> = Some(false);

    fn numbers(&self) -> Vec<f64> {
        self.to_vec()
    }
}

macro_rules! no_numbers {
    ($($type:ty),* $(,)?) => { $(impl Numbers for $type {})* };
}

// Whole numbers and words have properties of their own, counts and readings come as forces.
no_numbers!(u64, [u32; STAGES.len()], SpeedLimit, Option<Law>, Option<ContactReaction>);

impl<const N: usize> Numbers for heapless::Vec<u16, N> {}
impl<const N: usize> Numbers for heapless::Vec<TaxelReading, N> {}

fn single<T: Numbers>(_: fn(&Sample) -> &T) -> Option<bool> {
    T::SINGLE
}

macro_rules! fields {
    (
        own $own:tt
        $(
            $(#[$record_doc:meta])* $record:ident $topic:literal $ros:literal {
                $($(#[$doc:meta])* $field:ident: $type:ty $(as $columns:tt)? $(, $word:ident)*;)*
            }
        )*
    ) => {
        /// All fields of numbers, in the order of the table.
        pub(crate) fn fields() -> Vec<NumberField> {
            let mut fields = MADE.to_vec();
            $($(
                if let Some(single) = single(|sample| &sample.$field) {
                    let of = |sample: &Sample| {
                        let mut numbers = sample.$field.numbers();
                        if [$(stringify!($word)),*].contains(&"from_zero") {
                            numbers.iter_mut().filter(|number| **number < 0.0).for_each(|number| *number = f64::NAN);
                        }
                        numbers
                    };
                    fields.push(NumberField { name: stringify!($field), single, topic: $topic, of });
                }
            )*)*
            fields
        }
    };
}

sample_table!(fields);

/// Doubles as bytes, for `numpy.frombuffer`.
pub(crate) fn bytes<'py>(py: Python<'py>, values: &[f64]) -> Bound<'py, PyBytes> {
    let bytes: Vec<u8> = values.iter().flat_map(|value| value.to_ne_bytes()).collect();
    PyBytes::new(py, &bytes)
}

#[pymethods]
impl State {
    /// Name of each field of numbers, and true if it is one number.
    #[staticmethod]
    fn fields() -> Vec<(&'static str, bool)> {
        fields().into_iter().map(|field| (field.name, field.single)).collect()
    }

    /// The numbers of a field.
    fn numbers<'py>(&self, py: Python<'py>, field: &str) -> PyResult<Bound<'py, PyBytes>> {
        let of = self::field(field).ok_or_else(|| PyAttributeError::new_err(no_field(field)))?.of;
        Ok(bytes(py, &of(&self.0)))
    }

    #[getter]
    fn tick(&self) -> u64 {
        self.0.tick
    }

    #[getter]
    fn overruns(&self) -> u64 {
        self.0.overruns
    }

    #[getter]
    fn mode(&self) -> &'static str {
        self.0.mode.name()
    }

    #[getter]
    fn law(&self) -> Option<&'static str> {
        self.0.law.map(|law| moca_msgs::Mode::from(law).name())
    }

    #[getter]
    fn fault(&self) -> Option<String> {
        self.0.fault.map(|fault| fault.to_string())
    }

    #[getter]
    fn target(&self) -> Option<(&'static str, &'static str)> {
        self.0.target.map(|target| (target.kind.name(), target.phase.name()))
    }

    /// The gripper; `None` without one.
    #[getter]
    fn gripper(&self) -> Option<gripper::Fields> {
        self.0.gripper.as_ref().map(gripper::fields)
    }
}
