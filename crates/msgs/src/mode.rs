//! Modes of the supervisor, control laws, and the closed list of reasons to stop.
//!
//! ```
//! use moca_msgs::mode::{BoardFault, Clearing, Mode, Reaction};
//!
//! assert!(Mode::FollowMe.moves() && !Mode::Ready.moves());
//! let frozen = BoardFault::Frozen.of(1);
//! assert_eq!((frozen.board(), frozen.code()), (Some(1), "board-frozen"));
//! assert_eq!((frozen.reaction(), frozen.clearing()), (Reaction::ProtectiveStop, Clearing::Tare));
//! println!("{} {}", frozen.text(), frozen.remedy());
//! ```

use crate::TaxelStatus;
use core::fmt;

/// Which control law moves the robot once it is armed.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize), serde(rename_all = "kebab-case"))]
pub enum Law {
    /// Expanded Cartesian impedance, eqs. (6)–(11): the flange keeps its place, the base gives way.
    #[default]
    Impedance,
    /// Expanded follow-me, eqs. (12)–(16): base and arm follow the hand.
    FollowMe,
}

crate::choice!(Law { Impedance: "impedance", FollowMe: "follow-me" });

/// Mode of the supervisor. Only [`Mode::Impedance`] and [`Mode::FollowMe`] move the robot.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub enum Mode {
    /// Waiting for the first good state and the first good frame.
    #[default]
    Starting,
    /// Measuring the cover's zero; the robot holds still.
    Taring,
    /// Zero known, robot holds still, waiting to be armed.
    Ready,
    /// Expanded Cartesian impedance control.
    Impedance,
    /// Expanded follow-me control.
    FollowMe,
    /// Base commanded to zero, arm holds its posture. Left only by an explicit resume once the cause is gone.
    ProtectiveStop,
    /// No command can be trusted: the plant brakes. Left only by a restart.
    Fault,
}

impl Mode {
    /// Returns true if a control law drives the robot.
    pub const fn moves(self) -> bool {
        matches!(self, Self::Impedance | Self::FollowMe)
    }

    /// Name as shown to users.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Starting => "starting",
            Self::Taring => "taring",
            Self::Ready => "ready",
            Self::Impedance => "impedance",
            Self::FollowMe => "follow-me",
            Self::ProtectiveStop => "protective stop",
            Self::Fault => "fault",
        }
    }
}

impl From<Law> for Mode {
    fn from(law: Law) -> Self {
        match law {
            Law::Impedance => Self::Impedance,
            Law::FollowMe => Self::FollowMe,
        }
    }
}

/// Reaction of the supervisor to a fault.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Reaction {
    /// Base to zero within its limits, arm holds its posture.
    ProtectiveStop,
    /// The plant brakes; restart needed.
    Fault,
}

/// Fault of a board's stream of frames; [`Fault::Board`] says of which board. Logs keep the longer names.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub enum BoardFault {
    /// No good frame within the deadline.
    #[cfg_attr(feature = "serde", serde(rename = "BoardSilent"))]
    Silent,
    /// The port closed or vanished.
    #[cfg_attr(feature = "serde", serde(rename = "BoardLost"))]
    Lost,
    /// Well-formed frames, but the data has not changed: I2C to the sensor chip lost.
    #[cfg_attr(feature = "serde", serde(rename = "BoardFrozen"))]
    Frozen,
    /// The sensor chip reset (every value is 0, or the firmware says so), or the board did: its clock or numbers jump.
    #[cfg_attr(feature = "serde", serde(rename = "BoardReset"))]
    Reset,
    /// Threshold registers changed: another configuration, or bus garbage.
    #[cfg_attr(feature = "serde", serde(rename = "BoardThresholds"))]
    Thresholds,
    /// Every taxel of a board shifted alike: supply voltage or ground, not hands.
    #[cfg_attr(feature = "serde", serde(rename = "BoardCommonMode"))]
    CommonMode,
    /// The board is not the one that the calibration was made with.
    CalibrationMismatch,
    /// No good frame within the deadline, because this PC did not run the threads that bring it.
    HostStarved,
    /// Good frames come, but too seldom to be used.
    #[cfg_attr(feature = "serde", serde(rename = "BoardSlow"))]
    Slow,
    /// The sensor chip says that it does not measure: over-current, or an electrode out of its range.
    #[cfg_attr(feature = "serde", serde(rename = "BoardChip"))]
    Chip,
}

/// Every reason to stop. Numbers of taxels, joints and boards count from 0 here and are shown from 1: T1….
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub enum Fault {
    /// The operator pressed stop.
    OperatorStop,
    /// A board sends nothing, or nothing that can be used.
    Board {
        /// 0 is the first.
        board: u8,
        /// Why.
        fault: BoardFault,
    },
    /// One taxel is unusable.
    TaxelInvalid {
        /// 0 is T1.
        taxel: u8,
        /// Why.
        status: TaxelStatus,
    },
    /// No valid zero.
    ZeroInvalid,
    /// NaN, infinity or an impossible value in the robot's state.
    StateInvalid,
    /// The plant stopped answering.
    PlantLost,
    /// The arm's state is older than its deadline.
    ArmStale,
    /// The base's state is older than its deadline.
    BaseStale,
    /// Whoever armed the robot from a panel is gone without giving the command back.
    OperatorLost,
    /// A controller refused its input or gave a value outside its limits.
    ControlRefused,
    /// A joint is faster than the arm allows where it is.
    JointSpeed {
        /// 0 is the first joint.
        joint: u8,
    },
    /// The flange is faster than `limits.flange_speed_m_s`.
    FlangeSpeed,
    /// The flange is further from where it is wanted than `limits.pose_error_m` or `limits.pose_error_rad`.
    PoseError,
    /// The arm stopped itself: a collision, a limit or the line; it says which.
    ArmReflex,
    /// The arm's user-stop device is pressed.
    ArmUserStopped,
    /// The arm answers but is not to be controlled: another version, no FCI, brakes closed.
    ArmRefused,
    /// A joint runs away with the arm stretched, below its speed limit.
    ArmStretched {
        /// 0 is the first joint.
        joint: u8,
    },
    /// The base needed a longer way to stop than its speed limit allows for.
    BaseLate,
    /// The flange sensor sends no new wrench: none at all, one older than its deadline, or the same bits again and again.
    FlangeSensorStale,
    /// A reading is outside the range of the flange sensor.
    FlangeSensorRange {
        /// 0 to 2 is force, 3 to 5 moment, along x, y, z of the sensor.
        axis: u8,
        /// Reading, mN or mN·m.
        milli: i32,
        /// Largest magnitude in range, mN or mN·m.
        milli_max: u32,
    },
    /// The flange sensor has no valid zero.
    FlangeZeroInvalid {
        /// Why.
        why: FlangeTare,
    },
}

/// Largest joint speed at which a flange sensor is tared, rad/s.
pub const FLANGE_TARE_SPEED_RAD_S: f64 = 0.02;
/// Largest standard deviation of each axis of a flange sensor that is tared, N and N·m. ASSUMED: a few times the noise of such sensors.
pub const FLANGE_TARE_NOISE: [f64; 2] = [3.0, 0.3];

/// Reason why a flange sensor has no zero.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub enum FlangeTare {
    /// It has not been tared, or its last tare was interrupted.
    Missing,
    /// The arm moved during the tare.
    Moved {
        /// 0 is the first joint.
        joint: u8,
        /// Speed, mrad/s.
        mrad_s: u32,
    },
    /// The wrench was not steady during the tare.
    Noisy {
        /// 0 to 2 is force, 3 to 5 moment, along x, y, z of the flange.
        axis: u8,
        /// Standard deviation, mN or mN·m.
        milli: u32,
    },
}

/// Value, unit and allowed range.
impl fmt::Display for FlangeTare {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match *self {
            Self::Missing => f.write_str("The flange sensor has no zero."),
            Self::Moved { joint, mrad_s } => write!(
                f,
                "Joint {} moved at {:.3} rad/s during the tare of the flange sensor; allowed: 0 to {FLANGE_TARE_SPEED_RAD_S} rad/s.",
                u16::from(joint) + 1,
                1e-3 * f64::from(mrad_s)
            ),
            Self::Noisy { axis, milli } => {
                let (name, unit) = wrench_axis(axis);
                let [force_n, moment_nm] = FLANGE_TARE_NOISE;
                let most = if axis < 3 { force_n } else { moment_nm };
                let deviation = 1e-3 * f64::from(milli);
                write!(
                    f,
                    "{name} of the flange sensor varied by {deviation:.3} {unit} during its tare; allowed: 0 to {most} {unit}."
                )
            }
        }
    }
}

/// Name and unit of an axis of a wrench.
fn wrench_axis(axis: u8) -> (&'static str, &'static str) {
    let name = ["fx", "fy", "fz", "mx", "my", "mz"].get(usize::from(axis)).unwrap_or(&"an axis");
    (name, if axis < 3 { "N" } else { "N·m" })
}

/// Action required before a stop can be resumed, in addition to removing its cause.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Clearing {
    /// Nothing.
    Resume,
    /// A tare, finished since the stop.
    Tare,
    /// Only a restart helps.
    Restart,
}

/// Declares the code of every fault once: a fault without one does not compile.
macro_rules! codes {
    ($type:ident { $($fault:ident: $code:literal),* $(,)? } $($other:pat => $its_code:expr)?) => {
        impl $type {
            /// Codes of its own variants.
            const CODES: &'static [&'static str] = &[$($code),*];

            /// Stable code for logs and scripts.
            pub const fn code(self) -> &'static str {
                match self {
                    $(Self::$fault { .. } => $code,)*
                    $($other => $its_code,)?
                }
            }
        }
    };
}

codes!(BoardFault {
    Silent: "board-silent",
    Lost: "board-lost",
    Frozen: "board-frozen",
    Reset: "board-reset",
    Thresholds: "board-thresholds",
    Chip: "board-chip",
    CommonMode: "board-common-mode",
    Slow: "board-slow",
    CalibrationMismatch: "calibration-mismatch",
    HostStarved: "host-starved",
});

codes!(Fault {
    OperatorStop: "operator-stop",
    TaxelInvalid: "taxel-invalid",
    ZeroInvalid: "zero-invalid",
    StateInvalid: "state-invalid",
    PlantLost: "plant-lost",
    ArmStale: "arm-stale",
    BaseStale: "base-stale",
    OperatorLost: "operator-lost",
    ControlRefused: "control-refused",
    JointSpeed: "joint-speed",
    FlangeSpeed: "flange-speed",
    PoseError: "pose-error",
    ArmStretched: "arm-stretched",
    ArmReflex: "arm-reflex",
    ArmUserStopped: "arm-user-stopped",
    ArmRefused: "arm-refused",
    BaseLate: "base-late",
    FlangeSensorStale: "flange-sensor-stale",
    FlangeSensorRange: "flange-sensor-range",
    FlangeZeroInvalid: "flange-zero-invalid",
} Fault::Board { fault, .. } => fault.code());

impl BoardFault {
    /// Returns this fault as one of `board`, 0 is the first.
    pub const fn of(self, board: u8) -> Fault {
        Fault::Board { board, fault: self }
    }

    /// One sentence for the person in front of the robot.
    pub const fn text(self) -> &'static str {
        match self {
            Self::Silent => "No good frame from the Touch Board within its deadline.",
            Self::Lost => "The Touch Board's port closed: unplugged, or it lost power.",
            Self::Frozen => {
                "The Touch Board sends frames, but its data is frozen: I2C to the sensor chip lost."
            }
            Self::Reset => "The Touch Board or its sensor chip was reset.",
            Self::Chip => {
                "The Touch Board's sensor chip does not measure: over-current, or an electrode out of its range."
            }
            Self::Thresholds => "The Touch Board's threshold registers changed: bus garbage or a new sketch.",
            Self::CommonMode => {
                "Every taxel of a Touch Board shifted alike: its supply or ground, not hands."
            }
            Self::CalibrationMismatch => "The calibration was made with another sketch than the board runs.",
            Self::HostStarved => "This PC was too busy to read the Touch Board within its deadline.",
            Self::Slow => "The Touch Board's frames come too seldom to be used.",
        }
    }

    const fn clearing(self) -> Clearing {
        match self {
            Self::Silent | Self::Slow | Self::HostStarved | Self::CalibrationMismatch => Clearing::Resume,
            Self::Lost | Self::Frozen | Self::Reset | Self::Thresholds | Self::Chip | Self::CommonMode => {
                Clearing::Tare
            }
        }
    }

    const fn remedy(self) -> &'static str {
        match self {
            Self::Silent => "Check cable and power; when frames come again: resume.",
            Self::Slow => "Check the board's sketch and this PC's load; when frames come in time: resume.",
            Self::HostStarved => "End other programs (`mocad doctor` says what else helps); then resume.",
            Self::Lost => "Check cable and power; when frames come again: tare, then resume.",
            Self::Frozen | Self::Reset | Self::Thresholds | Self::Chip => {
                "Power-cycle the board; when frames are good: tare, then resume."
            }
            Self::CommonMode => "Check the board's supply and ground; then tare and resume.",
            Self::CalibrationMismatch => {
                "Flash the sketch named in the calibration file, or calibrate again; then resume."
            }
        }
    }
}

impl Fault {
    /// Returns true if `code` is [`Fault::code`] of a fault.
    pub fn has_code(code: &str) -> bool {
        Self::CODES.iter().chain(BoardFault::CODES).any(|known| *known == code)
    }

    /// Returns the board that it is of, 0 is the first; `None` where it is of none.
    pub const fn board(self) -> Option<u8> {
        match self {
            Self::Board { board, .. } => Some(board),
            _ => None,
        }
    }

    /// One sentence for the person in front of the robot.
    pub const fn text(self) -> &'static str {
        match self {
            Self::OperatorStop => "Stopped by the operator.",
            Self::Board { fault, .. } => fault.text(),
            Self::TaxelInvalid { .. } => "A taxel is unusable.",
            Self::ZeroInvalid => "The cover has no valid zero.",
            Self::StateInvalid => "The robot's state holds a value that is not a number or not possible.",
            Self::PlantLost => "The robot stopped answering.",
            Self::ArmStale => "The arm's state has not been renewed within its deadline.",
            Self::BaseStale => "The base's state has not been renewed within its deadline.",
            Self::OperatorLost => "The panel that armed the robot is gone.",
            Self::ControlRefused => "The controller refused its input.",
            Self::JointSpeed { .. } => "A joint moved faster than the arm allows.",
            Self::FlangeSpeed => "The flange moved faster than its limit.",
            Self::PoseError => "The flange was further from where it is wanted than its limit.",
            Self::ArmStretched { .. } => "The arm is stretched and could not hold the flange.",
            Self::ArmReflex => "The arm stopped by its own reflex.",
            Self::ArmUserStopped => "The arm's user stop is pressed.",
            Self::ArmRefused => "The arm answers, but it does not let itself be controlled.",
            Self::BaseLate => "The base stopped later than its measured stopping distance says.",
            Self::FlangeSensorStale => "The flange sensor sends no new wrench.",
            Self::FlangeSensorRange { .. } => "A reading is outside the flange sensor's range.",
            Self::FlangeZeroInvalid { .. } => "The flange sensor has no valid zero.",
        }
    }

    /// Returns the reaction of the supervisor.
    pub const fn reaction(self) -> Reaction {
        match self.clearing() {
            Clearing::Restart => Reaction::Fault,
            Clearing::Resume | Clearing::Tare => Reaction::ProtectiveStop,
        }
    }

    /// Returns the action that the supervisor requires before it resumes; [`Fault::remedy`] describes the same one.
    pub const fn clearing(self) -> Clearing {
        match self {
            Self::Board { fault, .. } => fault.clearing(),
            Self::OperatorStop
            | Self::OperatorLost
            | Self::ArmStale
            | Self::BaseStale
            | Self::ArmReflex
            | Self::ArmUserStopped
            | Self::ArmRefused
            | Self::JointSpeed { .. }
            | Self::FlangeSpeed
            | Self::PoseError
            | Self::ArmStretched { .. }
            | Self::BaseLate
            | Self::FlangeSensorStale
            | Self::FlangeSensorRange { .. } => Clearing::Resume,
            Self::TaxelInvalid { .. } | Self::ZeroInvalid | Self::FlangeZeroInvalid { .. } => Clearing::Tare,
            Self::StateInvalid | Self::PlantLost | Self::ControlRefused => Clearing::Restart,
        }
    }

    /// Returns true if a tare may end the fault: the zero is wrong, or the tare itself finds out. A tare is not refused then.
    pub const fn a_tare_may_end_it(self) -> bool {
        use crate::TaxelStatus::{Dead, Drifted, NoZero, Noisy, Stuck};
        match self {
            Self::ZeroInvalid
            | Self::FlangeZeroInvalid { .. }
            | Self::Board { fault: BoardFault::CommonMode, .. } => true,
            Self::TaxelInvalid { status, .. } => matches!(status, Dead | Drifted | NoZero | Noisy | Stuck),
            _ => false,
        }
    }

    /// Returns true if a part of the robot is missing: a robot that has not moved yet waits for it.
    pub const fn is_absence(self) -> bool {
        matches!(
            self,
            Self::ArmStale
                | Self::BaseStale
                | Self::FlangeSensorStale
                | Self::ArmUserStopped
                | Self::ArmRefused
        )
    }

    /// Returns the remedy for the operator.
    pub const fn remedy(self) -> &'static str {
        match self {
            Self::OperatorStop => "Resume when it is safe.",
            Self::JointSpeed { .. } | Self::FlangeSpeed | Self::PoseError => {
                "See what pushed or blocked the arm, and the gains; resume when it is safe."
            }
            Self::ArmStretched { .. } => {
                "Bend the elbow: lead the arm closer to the base, or change control.gains.posture_rad; then resume."
            }
            Self::ArmStale | Self::BaseStale => {
                "Check the robot's network and drives; when states come again: resume."
            }
            Self::FlangeSensorStale => {
                "Check the flange sensor's cable and driver; when its wrench comes again: resume."
            }
            Self::FlangeSensorRange { .. } => {
                "Free anyone caught, take the load off the sensor, and check its reading and range; then resume."
            }
            Self::FlangeZeroInvalid { .. } => {
                "Let the arm stand, with nothing touching its tool, and tare, then resume."
            }
            Self::ArmReflex => "Free anyone caught. Press Resume once to recover the arm, again to continue.",
            Self::ArmUserStopped => "Release the user stop when it is safe; then resume.",
            Self::ArmRefused => "Unlock the brakes and activate FCI in Desk, read the log; then resume.",
            Self::BaseLate => {
                "It is slower until its stopping distance is measured again (`mocad doctor --base --write`); resume when it is safe."
            }
            Self::OperatorLost => "Connect a panel; resume when it is safe.",
            Self::Board { fault, .. } => fault.remedy(),
            Self::TaxelInvalid { status: TaxelStatus::Saturated, .. } => {
                "Free anyone who presses there. If nobody does, check its plate and wire; then tare and resume."
            }
            Self::TaxelInvalid { .. } => "Check the taxel's plate and wire; then tare and resume.",
            Self::ZeroInvalid => "Step away from the cover and tare, then resume.",
            Self::StateInvalid | Self::PlantLost | Self::ControlRefused => {
                "Read the log, remove the cause, restart the daemon."
            }
        }
    }
}

/// Why the robot stands and what to do about it; a taxel is named.
impl fmt::Display for Fault {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match *self {
            Self::TaxelInvalid { taxel, status: TaxelStatus::Masked } => write!(
                f,
                "T{} is masked, and board.mask_policy stops the robot for it: take it into use again, then resume.",
                u16::from(taxel) + 1
            ),
            Self::TaxelInvalid { taxel, status } => {
                write!(f, "T{} is {}. {}", u16::from(taxel) + 1, status.name(), self.remedy())
            }
            Self::FlangeZeroInvalid { why } => write!(f, "{why} {}", self.remedy()),
            Self::FlangeSensorRange { axis, milli, milli_max } => {
                let (name, unit) = wrench_axis(axis);
                let [read, most] = [f64::from(milli), f64::from(milli_max)].map(|milli| 1e-3 * milli);
                let remedy = self.remedy();
                write!(
                    f,
                    "The flange sensor read {name} = {read:.3} {unit}; its range: -{most} to {most} {unit}. {remedy}"
                )
            }
            _ => write!(f, "{} {}", self.text(), self.remedy()),
        }
    }
}

#[cfg(test)]
mod tests {
    extern crate std;

    use super::*;
    use crate::TaxelStatus;
    use std::string::ToString;

    #[test]
    fn the_text_of_a_stop_says_what_resuming_demands() {
        let mut faults = [
            Fault::OperatorStop,
            BoardFault::Silent.of(1),
            BoardFault::Lost.of(1),
            BoardFault::Frozen.of(1),
            BoardFault::Reset.of(1),
            BoardFault::Thresholds.of(1),
            BoardFault::Chip.of(1),
            BoardFault::CommonMode.of(1),
            BoardFault::CalibrationMismatch.of(1),
            Fault::ZeroInvalid,
            Fault::StateInvalid,
            Fault::PlantLost,
            Fault::ArmStale,
            Fault::BaseStale,
            Fault::OperatorLost,
            Fault::ControlRefused,
            BoardFault::HostStarved.of(1),
            BoardFault::Slow.of(1),
            Fault::ArmReflex,
            Fault::ArmUserStopped,
            Fault::ArmRefused,
            Fault::TaxelInvalid { taxel: 3, status: TaxelStatus::Noisy },
            Fault::JointSpeed { joint: 2 },
            Fault::FlangeSpeed,
            Fault::PoseError,
            Fault::ArmStretched { joint: 3 },
            Fault::BaseLate,
            Fault::FlangeSensorStale,
            Fault::FlangeSensorRange { axis: 4, milli: -31_000, milli_max: 30_000 },
            Fault::FlangeZeroInvalid { why: FlangeTare::Missing },
        ];
        let pressed = Fault::TaxelInvalid { taxel: 3, status: TaxelStatus::Saturated };
        assert!(pressed.to_string().starts_with("T4 is at its end. Free anyone who presses there."));
        assert_eq!(faults.len(), Fault::CODES.len() + BoardFault::CODES.len());
        faults.sort_by_key(|fault| fault.code());
        for pair in faults.windows(2) {
            assert_ne!(pair[0].code(), pair[1].code());
        }
        for fault in faults {
            assert!(Fault::has_code(fault.code()), "{}", fault.code());
            assert_eq!(
                fault.board(),
                BoardFault::CODES.contains(&fault.code()).then_some(1),
                "{}",
                fault.code()
            );
            let remedy = fault.remedy();
            let says = (
                remedy.contains("tare"),
                (remedy.contains("resume") || remedy.contains("Resume")),
                remedy.contains("restart"),
            );
            let demanded = match fault.clearing() {
                Clearing::Resume => (false, true, false),
                Clearing::Tare => (true, true, false),
                Clearing::Restart => (false, false, true),
            };
            assert_eq!(says, demanded, "{}: {}", fault.code(), fault.remedy());
            if fault.a_tare_may_end_it() {
                assert_eq!(fault.clearing(), Clearing::Tare, "{}", fault.code());
            }
            if fault.is_absence() {
                assert_eq!(fault.clearing(), Clearing::Resume, "{}: nothing is left to clear", fault.code());
            }
        }
    }
}
