//! The gripper as an operator sees it: its state in words, and the numbers of the next motion with their ranges.

use super::format::number;
use moca_msgs::gripper::{GripperQuantity, GripperTable};
use moca_msgs::{GripperPhase, GripperRequest, GripperState};

/// Millimetres in a metre.
const MM: f64 = 1e3;

/// Returns the distance between the fingers in words.
pub fn width(state: &GripperState) -> String {
    match state.phase {
        GripperPhase::Unknown => "not known".into(),
        _ => format!("{} mm of {}", number(MM * state.width_m, 1), number(MM * state.width_max_m, 1)),
    }
}

/// Returns in words what is held.
pub fn object(state: &GripperState) -> String {
    match state.phase {
        GripperPhase::Unknown => "not known".into(),
        GripperPhase::Resting | GripperPhase::Moving => "none held".into(),
        GripperPhase::Holding if state.object_kg > 0.0 => {
            format!("held, {} kg carried", number(state.object_kg, 2))
        }
        GripperPhase::Holding => "held, its mass is not told".into(),
    }
}

/// Numbers of the next motion or grasp in the units of their fields.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Draft {
    /// Distance between the fingers, or width of the object.
    pub width_mm: f64,
    /// Change of that distance.
    pub speed_mm_s: f64,
    /// Force of each finger.
    pub force_n: f64,
    /// Largest difference between that width and the object's.
    pub tolerance_mm: f64,
    /// Mass of the object; 0 is not told.
    pub mass_kg: f64,
}

/// A field of a [`Draft`].
#[derive(Debug, PartialEq)]
pub struct Field<'a> {
    /// Name.
    pub name: &'static str,
    /// Unit of value and range.
    pub unit: &'static str,
    /// Smallest and largest value allowed.
    pub range: [f64; 2],
    /// Value.
    pub value: &'a mut f64,
}

impl Default for Draft {
    /// The numbers with which `mocad gripper grasp 0.05` begins.
    fn default() -> Self {
        Self { width_mm: 50.0, speed_mm_s: 50.0, force_n: 40.0, tolerance_mm: 5.0, mass_kg: 0.0 }
    }
}

impl Draft {
    /// Returns the fields with the ranges of `table`.
    pub fn fields(&mut self, table: &GripperTable) -> [Field<'_>; 5] {
        let Self { width_mm, speed_mm_s, force_n, tolerance_mm, mass_kg } = self;
        [
            ("Width", "mm", MM, GripperQuantity::Width, width_mm),
            ("Speed", "mm/s", MM, GripperQuantity::Speed, speed_mm_s),
            ("Force", "N", 1.0, GripperQuantity::Force, force_n),
            ("Tolerance", "mm", MM, GripperQuantity::Tolerance, tolerance_mm),
            ("Mass", "kg", 1.0, GripperQuantity::Mass, mass_kg),
        ]
        .map(|(name, unit, scale, quantity, value)| {
            let range = table.range(quantity).map(|bound| scale * bound);
            Field { name, unit, range, value }
        })
    }

    /// Returns the request that moves the fingers to the width.
    pub const fn motion(&self) -> GripperRequest {
        GripperRequest::Move { width_m: self.width_mm / MM, speed_m_s: self.speed_mm_s / MM }
    }

    /// Returns the request that grasps an object of the width.
    pub const fn grasp(&self) -> GripperRequest {
        GripperRequest::Grasp {
            width_m: self.width_mm / MM,
            speed_m_s: self.speed_mm_s / MM,
            force_n: self.force_n,
            tolerance_m: self.tolerance_mm / MM,
            mass_kg: self.mass_kg,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn state(phase: GripperPhase) -> GripperState {
        GripperState { width_m: 0.0502, width_max_m: 0.08, phase, ..GripperState::default() }
    }

    #[test]
    fn state_tells_width_object_and_mass_only_where_they_are_known() {
        let holding = state(GripperPhase::Holding);
        let carried = GripperState { object_kg: 0.456, ..holding };
        for (state, shown) in [
            (state(GripperPhase::Resting), ["50.2 mm of 80.0", "none held"]),
            (state(GripperPhase::Moving), ["50.2 mm of 80.0", "none held"]),
            (holding, ["50.2 mm of 80.0", "held, its mass is not told"]),
            (carried, ["50.2 mm of 80.0", "held, 0.46 kg carried"]),
            (state(GripperPhase::Unknown), ["not known", "not known"]),
        ] {
            assert_eq!([width(&state), object(&state)], shown, "{state:?}");
        }
    }

    #[test]
    fn both_ends_of_each_range_are_requests_that_are_taken() {
        let table = GripperState { width_max_m: 0.11, ..state(GripperPhase::Resting) }.table();
        let ranges = Draft::default().fields(&table).map(|field| field.range);
        assert_eq!(ranges, [[0.0, 110.0], [1.0, 100.0], [1.0, 70.0], [0.1, 110.0], [0.0, 2.27]]);
        for end in [0, 1] {
            let mut draft = Draft::default();
            draft.fields(&table).into_iter().for_each(|field| *field.value = field.range[end]);
            assert_eq!(draft.motion().check(&table), Ok(()), "{draft:?}");
            assert_eq!(draft.grasp().check(&table), Ok(()), "{draft:?}");
        }
        for place in 0..5 {
            for beyond in [-1e-3, f64::NAN, 1e3] {
                let mut draft = Draft::default();
                *draft.fields(&table)[place].value = beyond;
                assert!(draft.grasp().check(&table).is_err(), "{draft:?}");
                assert_eq!(draft.motion().check(&table).is_err(), place < 2, "{draft:?}");
            }
        }
    }

    #[test]
    fn draft_is_asked_for_in_si_units() {
        let draft = Draft { mass_kg: 0.5, ..Draft::default() };
        let (width_m, speed_m_s, force_n, tolerance_m, mass_kg) = (0.05, 0.05, 40.0, 0.005, 0.5);
        assert_eq!(draft.motion(), GripperRequest::Move { width_m, speed_m_s });
        assert_eq!(
            draft.grasp(),
            GripperRequest::Grasp { width_m, speed_m_s, force_n, tolerance_m, mass_kg }
        );
    }
}
