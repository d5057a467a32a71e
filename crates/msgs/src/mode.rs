//! Modes of the supervisor, control laws, and the closed list of reasons to stop.

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
    /// Whether a control law drives the robot.
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

/// What the supervisor does about a fault.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Reaction {
    /// Base to zero within its limits, arm holds its posture.
    ProtectiveStop,
    /// The plant brakes; restart needed.
    Fault,
}

/// Every reason to stop. Taxel numbers count from 0 here and are shown as T1….
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub enum Fault {
    /// The operator pressed stop.
    OperatorStop,
    /// No good frame within the deadline.
    BoardSilent,
    /// The port closed or vanished.
    BoardLost,
    /// Well-formed frames, but the data has not changed: I2C to the sensor chip lost.
    BoardFrozen,
    /// Every value is 0: the sensor chip reset.
    BoardReset,
    /// Threshold registers changed: another configuration, or bus garbage.
    BoardThresholds,
    /// Every taxel of a board shifted alike: supply voltage or ground, not hands.
    BoardCommonMode,
    /// The board is not the one that the calibration was made with.
    CalibrationMismatch,
    /// One taxel is unusable.
    TaxelInvalid {
        /// 0 is T1.
        taxel: u8,
        /// Why.
        status: crate::TaxelStatus,
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
    /// The sensor chip says that it does not measure: over-current, or an electrode out of its range.
    BoardChip,
}

impl Fault {
    /// Stable code for logs and scripts.
    pub const fn code(self) -> &'static str {
        match self {
            Self::OperatorStop => "operator-stop",
            Self::BoardSilent => "board-silent",
            Self::BoardLost => "board-lost",
            Self::BoardFrozen => "board-frozen",
            Self::BoardReset => "board-reset",
            Self::BoardThresholds => "board-thresholds",
            Self::BoardChip => "board-chip",
            Self::BoardCommonMode => "board-common-mode",
            Self::CalibrationMismatch => "calibration-mismatch",
            Self::TaxelInvalid { .. } => "taxel-invalid",
            Self::ZeroInvalid => "zero-invalid",
            Self::StateInvalid => "state-invalid",
            Self::PlantLost => "plant-lost",
            Self::ArmStale => "arm-stale",
            Self::BaseStale => "base-stale",
            Self::OperatorLost => "operator-lost",
            Self::ControlRefused => "control-refused",
        }
    }

    /// One sentence for the person in front of the robot.
    pub const fn text(self) -> &'static str {
        match self {
            Self::OperatorStop => "Stopped by the operator.",
            Self::BoardSilent => "No good frame from the Touch Board within its deadline.",
            Self::BoardLost => "The Touch Board's port closed: unplugged, or it lost power.",
            Self::BoardFrozen => {
                "The Touch Board sends frames, but its data is frozen: I2C to the sensor chip lost."
            }
            Self::BoardReset => "The Touch Board's sensor chip was reset.",
            Self::BoardChip => {
                "The Touch Board's sensor chip does not measure: over-current, or an electrode out of its range."
            }
            Self::BoardThresholds => {
                "The Touch Board's threshold registers changed: bus garbage or a new sketch."
            }
            Self::BoardCommonMode => {
                "Every taxel of a Touch Board shifted alike: its supply or ground, not hands."
            }
            Self::CalibrationMismatch => "The calibration was made with another sketch than the board runs.",
            Self::TaxelInvalid { .. } => "A taxel is unusable.",
            Self::ZeroInvalid => "The cover has no valid zero.",
            Self::StateInvalid => "The robot's state holds a value that is not a number or not possible.",
            Self::PlantLost => "The robot stopped answering.",
            Self::ArmStale => "The arm's state has not been renewed within its deadline.",
            Self::BaseStale => "The base's state has not been renewed within its deadline.",
            Self::OperatorLost => "The panel that armed the robot is gone.",
            Self::ControlRefused => "The controller refused its input.",
        }
    }

    /// What the supervisor does.
    pub const fn reaction(self) -> Reaction {
        match self {
            Self::StateInvalid | Self::PlantLost | Self::ControlRefused => Reaction::Fault,
            _ => Reaction::ProtectiveStop,
        }
    }

    /// How the operator clears it.
    pub const fn remedy(self) -> &'static str {
        match self {
            Self::OperatorStop => "Resume when it is safe.",
            Self::ArmStale | Self::BaseStale => {
                "Check the robot's network and drives; when states come again: resume."
            }
            Self::OperatorLost => "Connect a panel; resume when it is safe.",
            Self::BoardSilent | Self::BoardLost => {
                "Check cable and power; when frames come again: tare, then resume."
            }
            Self::BoardFrozen | Self::BoardReset | Self::BoardThresholds | Self::BoardChip => {
                "Power-cycle the board; when frames are good: tare, then resume."
            }
            Self::BoardCommonMode => "Check the board's supply and ground; then tare and resume.",
            Self::CalibrationMismatch => {
                "Flash the sketch named in the calibration file, or calibrate again."
            }
            Self::TaxelInvalid { .. } => "Check the taxel's plate and wire; then tare and resume.",
            Self::ZeroInvalid => "Step away from the cover and tare, then resume.",
            Self::StateInvalid | Self::PlantLost | Self::ControlRefused => {
                "Read the log, remove the cause, restart the daemon."
            }
        }
    }
}
