//! A gripper on the flange: requests, its state, and its faults with a sentence and a remedy each.
//!
//! ```
//! use moca_msgs::gripper::{FRANKA_HAND, GripperRefusal, GripperRequest};
//!
//! let (width_m, speed_m_s) = (0.05, 0.05);
//! let grasp = GripperRequest::Grasp { width_m, speed_m_s, force_n: 40.0, tolerance_m: 0.005, mass_kg: 0.5 };
//! assert_eq!(grasp.check(&FRANKA_HAND), Ok(()));
//! let wide = GripperRequest::Move { width_m: 0.09, speed_m_s: 0.05 };
//! let refusal = wide.check(&FRANKA_HAND).unwrap_err();
//! assert_eq!(refusal.to_string(), "width of the gripper = 0.09 m; allowed: 0 to 0.08 m");
//! assert!(matches!(refusal, GripperRefusal::OutOfRange { .. }));
//! ```

use core::fmt;

/// Width up to which closed fingers have nothing between them, m.
pub const CLOSED_M: f64 = 5e-4;

/// Ranges and geometry of a gripper with two parallel fingers.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct GripperTable {
    /// Largest distance between the fingers, m.
    pub width_max_m: f64,
    /// Slowest and fastest change of that distance, m/s.
    pub speed_m_s: [f64; 2],
    /// Least and largest force of a grasp, N.
    pub force_n: [f64; 2],
    /// Largest mass of an object, kg.
    pub object_max_kg: f64,
    /// Middle between the fingertips in the flange's axes, m.
    pub tip_flange_m: [f64; 3],
    /// Direction in which the fingers close, in the flange's axes, unit.
    pub closing_flange: [f64; 3],
}

/// The Franka Hand, in which the fingers' axes are turned by -45° about the flange's z. Width, speed and continuous force: data
/// sheet; tip: Franka's description of the robot; mass: the arm's payload of 3 kg without the hand's 0.73.
pub const FRANKA_HAND: GripperTable = GripperTable {
    width_max_m: 0.08,
    speed_m_s: [0.001, 0.1],
    force_n: [1.0, 70.0],
    object_max_kg: 2.27,
    tip_flange_m: [0.0, 0.0, 0.1034],
    closing_flange: [core::f64::consts::FRAC_1_SQRT_2, core::f64::consts::FRAC_1_SQRT_2, 0.0],
};

/// Speed at which fingers open for a release and find their range, m/s.
pub const RELEASE_M_S: f64 = 0.05;

/// Least tolerance of a grasp, m.
const TOLERANCE_MIN_M: f64 = 1e-4;

/// A request to the gripper. The latest one counts: it ends the one before, from wherever the fingers are.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub enum GripperRequest {
    /// Open, close and open the fingers to find their range. It lets go of an object.
    Home,
    /// Move the fingers to a width. A larger one than the object's lets go of it.
    Move {
        /// Distance between the fingers, m.
        width_m: f64,
        /// Change of that distance, m/s.
        speed_m_s: f64,
    },
    /// Close the fingers on an object, and hold it with a force until told otherwise.
    Grasp {
        /// Width of the object, m.
        width_m: f64,
        /// Change of the distance between the fingers, m/s.
        speed_m_s: f64,
        /// Force of each finger, N.
        force_n: f64,
        /// Largest difference between that width and the object's, m.
        tolerance_m: f64,
        /// Mass of the object, which the laws carry from the moment in which it is held, kg; 0: not told.
        mass_kg: f64,
    },
    /// Open the fingers as far as they go.
    Release,
    /// Stop the fingers where they are. An object that is held stays held.
    Stop,
}

/// A number of a request to the gripper.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub enum GripperQuantity {
    /// Distance between the fingers.
    Width,
    /// Change of that distance.
    Speed,
    /// Force of a grasp.
    Force,
    /// Tolerance of a grasp's width.
    Tolerance,
    /// Mass of the object.
    Mass,
}

impl GripperTable {
    /// Returns the smallest and the largest value that a request may have, in the quantity's unit.
    pub const fn range(&self, quantity: GripperQuantity) -> [f64; 2] {
        match quantity {
            GripperQuantity::Width => [0.0, self.width_max_m],
            GripperQuantity::Speed => self.speed_m_s,
            GripperQuantity::Force => self.force_n,
            GripperQuantity::Tolerance => [TOLERANCE_MIN_M, self.width_max_m],
            GripperQuantity::Mass => [0.0, self.object_max_kg],
        }
    }
}

impl GripperQuantity {
    /// Name and unit.
    const fn words(self) -> [&'static str; 2] {
        match self {
            Self::Width => ["width of the gripper", "m"],
            Self::Speed => ["speed of the gripper", "m/s"],
            Self::Force => ["force of the gripper", "N"],
            Self::Tolerance => ["tolerance of the gripper", "m"],
            Self::Mass => ["mass of the object", "kg"],
        }
    }
}

/// Why a gripper does not take a request.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub enum GripperRefusal {
    /// The robot has no gripper.
    NoGripper,
    /// A number outside its range.
    OutOfRange {
        /// Quantity.
        quantity: GripperQuantity,
        /// Its value.
        value: f64,
        /// Smallest and largest value allowed.
        allowed: [f64; 2],
    },
    /// The gripper does not answer.
    Silent,
}

impl fmt::Display for GripperRefusal {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match *self {
            Self::NoGripper => f.write_str("the robot has no gripper: set plant.gripper, restart the daemon"),
            Self::OutOfRange { quantity, value, allowed: [min, max] } => {
                let [name, unit] = quantity.words();
                write!(f, "{name} = {value} {unit}; allowed: {min} to {max} {unit}")
            }
            Self::Silent => {
                f.write_str("the gripper does not answer: check its plug and power, then ask again")
            }
        }
    }
}

impl GripperRequest {
    /// Checks every number against the ranges of `gripper`; NaN is outside all of them.
    ///
    /// # Errors
    /// The first number out of its range.
    pub fn check(&self, gripper: &GripperTable) -> Result<(), GripperRefusal> {
        let within = |quantity, value: f64| {
            let allowed = gripper.range(quantity);
            if value >= allowed[0] && value <= allowed[1] {
                return Ok(());
            }
            Err(GripperRefusal::OutOfRange { quantity, value, allowed })
        };
        let moves = |width_m, speed_m_s| {
            within(GripperQuantity::Width, width_m)?;
            within(GripperQuantity::Speed, speed_m_s)
        };
        match *self {
            Self::Home | Self::Release | Self::Stop => Ok(()),
            Self::Move { width_m, speed_m_s } => moves(width_m, speed_m_s),
            Self::Grasp { width_m, speed_m_s, force_n, tolerance_m, mass_kg } => {
                moves(width_m, speed_m_s)?;
                within(GripperQuantity::Force, force_n)?;
                within(GripperQuantity::Tolerance, tolerance_m)?;
                within(GripperQuantity::Mass, mass_kg)
            }
        }
    }

    /// Name as in commands and logs.
    pub const fn name(&self) -> &'static str {
        match self {
            Self::Home => "home",
            Self::Move { .. } => "move",
            Self::Grasp { .. } => "grasp",
            Self::Release => "release",
            Self::Stop => "stop",
        }
    }
}

/// Activity of a gripper.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub enum GripperPhase {
    /// The fingers rest and hold nothing.
    #[default]
    Resting,
    /// The fingers move.
    Moving,
    /// An object of the width that was asked for is held.
    Holding,
    /// Not known: the gripper does not answer.
    Unknown,
}

impl GripperPhase {
    /// Name as shown to users.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Resting => "resting",
            Self::Moving => "moving",
            Self::Holding => "holding",
            Self::Unknown => "unknown",
        }
    }
}

/// Fault of a gripper. None of them stops arm or base.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub enum GripperFault {
    /// The fingers closed without an object.
    NothingGrasped,
    /// The object is wider than asked.
    TooLarge,
    /// The object is narrower than asked.
    TooSmall,
    /// The object that was held is gone.
    Lost,
    /// The fingers did not reach their width.
    Blocked,
    /// The gripper refused the request.
    Failed,
    /// Something else ended the motion.
    Aborted,
    /// The gripper does not answer.
    Unplugged,
}

impl GripperFault {
    /// Every fault.
    pub const ALL: [Self; 8] = [
        Self::NothingGrasped,
        Self::TooLarge,
        Self::TooSmall,
        Self::Lost,
        Self::Blocked,
        Self::Failed,
        Self::Aborted,
        Self::Unplugged,
    ];

    /// Returns the fault of a grasp whose fingers came to rest at `width_m`, where `asked_m` was asked for; `None` for a success.
    pub fn of_grasp(asked_m: f64, tolerance_m: f64, width_m: f64) -> Option<Self> {
        if width_m <= CLOSED_M {
            Some(Self::NothingGrasped)
        } else if width_m > asked_m + tolerance_m {
            Some(Self::TooLarge)
        } else if width_m < asked_m - tolerance_m {
            Some(Self::TooSmall)
        } else {
            None
        }
    }

    /// Stable code for logs and scripts.
    pub const fn code(self) -> &'static str {
        match self {
            Self::NothingGrasped => "nothing-grasped",
            Self::TooLarge => "object-too-large",
            Self::TooSmall => "object-too-small",
            Self::Lost => "object-lost",
            Self::Blocked => "fingers-blocked",
            Self::Failed => "gripper-failed",
            Self::Aborted => "gripper-aborted",
            Self::Unplugged => "gripper-unplugged",
        }
    }

    /// One sentence for the person in front of the robot.
    pub const fn text(self) -> &'static str {
        match self {
            Self::NothingGrasped => "The fingers closed on nothing.",
            Self::TooLarge => "The object is wider than asked.",
            Self::TooSmall => "The object is narrower than asked.",
            Self::Lost => "The object that was held is gone.",
            Self::Blocked => "Something stopped the fingers on their way.",
            Self::Failed => "The gripper refused the request.",
            Self::Aborted => "The gripper ended the motion early.",
            Self::Unplugged => "The gripper does not answer.",
        }
    }

    /// Remedy for the operator.
    pub const fn remedy(self) -> &'static str {
        match self {
            Self::NothingGrasped => "Put the object between the fingers; then grasp again.",
            Self::TooLarge | Self::TooSmall => {
                "Ask for the object's width, or a larger tolerance; then grasp again."
            }
            Self::Lost => "See where it fell. Grasp it again with more force.",
            Self::Blocked => "Take away what is between the fingers, or grasp it.",
            Self::Failed => "Home the gripper; then ask again.",
            Self::Aborted => "See who else commands it (Desk); then ask again.",
            Self::Unplugged => "Hold the object from below. Check the gripper's plug and power.",
        }
    }
}

impl fmt::Display for GripperFault {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{} {}", self.text(), self.remedy())
    }
}

/// State of a gripper at one tick.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct GripperState {
    /// Distance between the fingers, m.
    pub width_m: f64,
    /// Largest distance between them, m.
    pub width_max_m: f64,
    /// Activity.
    pub phase: GripperPhase,
    /// Requests taken since the start.
    pub requests: u32,
    /// Fault since the last request.
    pub fault: Option<GripperFault>,
    /// Mass of the held object as the grasp told it, kg; 0 where nothing is held or nothing was told.
    pub object_kg: f64,
    /// Middle between the fingertips in the flange's axes, where the laws count with that mass, m.
    pub object_flange_m: [f64; 3],
}

impl GripperState {
    /// Returns the ranges of its requests for a client: its own largest width, and a Franka Hand's other numbers.
    pub const fn table(&self) -> GripperTable {
        GripperTable { width_max_m: self.width_max_m, ..FRANKA_HAND }
    }

    /// Returns true if an object is held.
    pub const fn is_holding(&self) -> bool {
        matches!(self.phase, GripperPhase::Holding)
    }
}

/// `holding, 50.0 mm between the fingers, 0.5 kg carried`, and the fault's sentences.
impl fmt::Display for GripperState {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}, {:.1} mm between the fingers", self.phase.name(), 1e3 * self.width_m)?;
        if self.object_kg > 0.0 {
            write!(f, ", {} kg carried", self.object_kg)?;
        }
        self.fault.map_or(Ok(()), |fault| write!(f, ". {fault}"))
    }
}

#[cfg(test)]
mod tests {
    extern crate std;
    use super::*;
    use std::string::ToString;

    const GRASP: (f64, f64, f64, f64) = (0.05, 0.05, 40.0, 0.005);

    fn grasp((width_m, speed_m_s, force_n, tolerance_m): (f64, f64, f64, f64)) -> GripperRequest {
        GripperRequest::Grasp { width_m, speed_m_s, force_n, tolerance_m, mass_kg: 0.0 }
    }

    #[test]
    fn mass_beyond_the_payload_names_the_object() {
        let heavy = |mass_kg| {
            let (width_m, speed_m_s, force_n, tolerance_m) = GRASP;
            GripperRequest::Grasp { width_m, speed_m_s, force_n, tolerance_m, mass_kg }.check(&FRANKA_HAND)
        };
        assert_eq!(heavy(2.27), Ok(()));
        for (bad, said) in [(2.28, "2.28"), (-1e-3, "-0.001"), (f64::NAN, "NaN")] {
            let expected = std::format!("mass of the object = {said} kg; allowed: 0 to 2.27 kg");
            assert_eq!(heavy(bad).unwrap_err().to_string(), expected);
        }
    }

    #[test]
    fn request_outside_of_a_range_names_value_unit_and_range() {
        let (width, speed, force, tolerance) = GRASP;
        let ends = [(0.0, 0.001, 1.0, 1e-4), (0.08, 0.1, 70.0, 0.08)];
        assert!(ends.into_iter().all(|end| grasp(end).check(&FRANKA_HAND).is_ok()));
        for (bad, said) in [
            ((-1e-9, speed, force, tolerance), "width of the gripper = -0.000000001 m; allowed: 0 to 0.08 m"),
            ((0.0801, speed, force, tolerance), "width of the gripper = 0.0801 m; allowed: 0 to 0.08 m"),
            ((width, 0.0, force, tolerance), "speed of the gripper = 0 m/s; allowed: 0.001 to 0.1 m/s"),
            ((width, 0.11, force, tolerance), "speed of the gripper = 0.11 m/s; allowed: 0.001 to 0.1 m/s"),
            ((width, speed, 0.0, tolerance), "force of the gripper = 0 N; allowed: 1 to 70 N"),
            ((width, speed, f64::NAN, tolerance), "force of the gripper = NaN N; allowed: 1 to 70 N"),
            ((width, speed, force, 0.0), "tolerance of the gripper = 0 m; allowed: 0.0001 to 0.08 m"),
        ] {
            assert_eq!(grasp(bad).check(&FRANKA_HAND).unwrap_err().to_string(), said);
        }
        let fast = GripperRequest::Move { width_m: 0.0, speed_m_s: f64::INFINITY };
        assert!(fast.check(&FRANKA_HAND).is_err());
        for plain in [GripperRequest::Home, GripperRequest::Release, GripperRequest::Stop] {
            assert_eq!(plain.check(&FRANKA_HAND), Ok(()), "{}", plain.name());
        }
    }

    #[test]
    fn end_of_a_grasp_is_judged_by_the_width() {
        let of = |width_m| GripperFault::of_grasp(0.05, 0.005, width_m);
        assert_eq!(of(0.0), Some(GripperFault::NothingGrasped));
        assert_eq!(of(CLOSED_M), Some(GripperFault::NothingGrasped));
        assert_eq!(of(0.0449), Some(GripperFault::TooSmall));
        assert_eq!((of(0.0451), of(0.05), of(0.0549)), (None, None, None));
        assert_eq!(of(0.0551), Some(GripperFault::TooLarge));
        assert_eq!(GripperFault::of_grasp(0.0, 0.005, 0.0), Some(GripperFault::NothingGrasped));
    }

    #[test]
    fn every_fault_has_a_code_a_sentence_and_a_remedy() {
        let faults = GripperFault::ALL;
        for (i, fault) in faults.iter().enumerate() {
            assert!(
                faults[..i].iter().all(|other| other.code() != fault.code() && other.text() != fault.text())
            );
            assert!(fault.text().ends_with('.') && fault.remedy().ends_with('.'), "{fault}");
        }
        let held = GripperState { width_m: 0.05, phase: GripperPhase::Holding, ..GripperState::default() };
        assert!(held.is_holding() && !GripperState::default().is_holding());
        assert_eq!(held.to_string(), "holding, 50.0 mm between the fingers");
        let heavy = GripperState { object_kg: 0.5, ..held };
        assert_eq!(heavy.to_string(), "holding, 50.0 mm between the fingers, 0.5 kg carried");
        let lost = GripperState { phase: GripperPhase::Moving, fault: Some(GripperFault::Lost), ..held };
        assert!(lost.to_string().ends_with(
            "fingers. The object that was held is gone. See where it fell. Grasp it again with more force."
        ));
    }
}
