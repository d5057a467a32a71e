//! Requests of an operator to the loop, and the answers.
//!
//! ```
//! use moca_msgs::{Mode, Outcome, Refusal, Request};
//!
//! /// What a robot that only stands answers.
//! fn answer(request: Request) -> Outcome {
//!     match request {
//!         Request::Stop => Ok(()),
//!         _ => Err(Refusal::Mode(Mode::Ready)),
//!     }
//! }
//! assert_eq!(answer(Request::Stop), Ok(()));
//! assert_eq!(answer(Request::Disarm), Err(Refusal::Mode(Mode::Ready)));
//! let refused = Request::Arm.refused(Refusal::Mode(Mode::Impedance));
//! assert_eq!(refused.to_string(), "not possible in mode impedance: it is armed already");
//! ```

use crate::params::{CONTROLLER, ParameterValues};
use crate::{GripperRefusal, GripperRequest, Law, Mode, TargetRefusal, TimedTarget, TouchPolicy, Waypoint};
use core::fmt;

/// Largest force of a [`Request::PressTaxel`], N.
pub const PRESS_FORCE_MAX_N: f64 = 200.0;
/// Furthest that a joint of a real arm may be from its posture when it is armed, rad.
pub const ARMING_POSTURE_RAD: f64 = 0.1;

/// A request to the loop. One commander at a time; `Stop` is taken from anyone.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub enum Request {
    /// Measure the cover's zero: in [`Mode::Ready`] or [`Mode::ProtectiveStop`], nobody touching.
    Tare,
    /// Hand the robot to the selected law: in [`Mode::Ready`].
    Arm,
    /// Back to [`Mode::Ready`] from a law.
    Disarm,
    /// Choose the law; while armed, switch to it.
    SelectLaw(Law),
    /// Protective stop, from any mode.
    Stop,
    /// Protective stop, because whoever armed the robot is gone; the daemon's own telemetry asks for it.
    OperatorLost,
    /// Leave [`Mode::ProtectiveStop`] for [`Mode::Ready`] once the cause is gone and the zero is valid.
    Resume,
    /// Simulation only: press a taxel with a steady force until told otherwise.
    PressTaxel {
        /// 0 is T1.
        taxel: u8,
        /// 0 lets go; N, 0 to 200.
        force_n: f64,
    },
    /// Take a taxel out of use, or back into it, while no law moves the robot. What a masked taxel means is
    /// configuration (`board.mask_policy`); a restart brings the configured masks back.
    MaskTaxel {
        /// 0 is T1.
        taxel: u8,
        /// True if it is out of use.
        masked: bool,
    },
    /// Change a parameter while the loop runs.
    SetParameter {
        /// Its place in the robot's description, which begins with [`crate::params::CONTROLLER`].
        parameter: u8,
        /// All of its elements; a flag is 1 or 0.
        values: ParameterValues,
    },
    /// Lead flange, arm or base to a target. It is one of many: 10 to 100 a second.
    Target(TimedTarget),
    /// One pose of a trajectory, in its turn; the last one starts it. The daemon's own telemetry makes them of one
    /// request.
    Waypoint {
        /// Which, from 0.
        index: u8,
        /// Number of all.
        count: u8,
        /// When and where.
        waypoint: Waypoint,
        /// Effect of a touch on the trajectory.
        touch: TouchPolicy,
    },
    /// End target, trajectory or recentring: the reference holds, the base rests.
    EndTarget,
    /// Drive the base back to where the arm is in its posture, slowly, until it is touched or there: in [`Mode::Impedance`].
    Recentre,
    /// Move the gripper's fingers, in any mode: arm and base do not move for it. It is answered when it begins, and its end is seen in
    /// [`crate::GripperState`].
    Gripper(GripperRequest),
}

impl Request {
    /// The modes in which it is taken; in every other it is refused with [`Refusal::Mode`]. Which of them is carried out
    /// depends on cover and robot too.
    pub const fn taken_in(&self) -> &'static [Mode] {
        use Mode::{Fault, FollowMe, Impedance, ProtectiveStop, Ready, Starting, Taring};
        match self {
            Self::Stop | Self::OperatorLost | Self::SelectLaw(_) => {
                &[Starting, Taring, Ready, Impedance, FollowMe, ProtectiveStop]
            }
            Self::Tare => &[Starting, Ready, ProtectiveStop],
            Self::Arm => &[Ready],
            Self::Disarm | Self::Target(_) | Self::Waypoint { .. } | Self::EndTarget => {
                &[Impedance, FollowMe]
            }
            Self::Recentre => &[Impedance],
            Self::Resume => &[ProtectiveStop],
            Self::MaskTaxel { .. } => &[Starting, Taring, Ready, ProtectiveStop, Fault],
            Self::PressTaxel { .. } | Self::SetParameter { .. } | Self::Gripper(_) => {
                &[Starting, Taring, Ready, Impedance, FollowMe, ProtectiveStop, Fault]
            }
        }
    }
}

const RESTART: &str = "read the log, remove the cause, restart the daemon";
const WAIT_FOR_TARE: &str = "wait until the tare has ended";

impl Request {
    /// Returns what to do where `mode` refuses it; `None` where no mode is in its way. A daemon without a good frame refuses
    /// a tare in a mode that takes one.
    pub const fn remedy_in(&self, mode: Mode) -> Option<&'static str> {
        use Mode::{Fault, FollowMe, Impedance, ProtectiveStop, Ready, Starting, Taring};
        Some(match (self, mode) {
            (Self::Stop | Self::OperatorLost, Fault) => {
                "the robot is stopped already; to go on, restart the daemon"
            }
            (Self::PressTaxel { .. } | Self::SetParameter { .. } | Self::Gripper(_), _) => return None,
            (Self::MaskTaxel { .. }, Impedance | FollowMe) => "disarm first",
            (Self::MaskTaxel { .. } | Self::Stop | Self::OperatorLost, _) => return None,
            (_, Fault) => RESTART,
            (Self::SelectLaw(_), _) => return None,
            (Self::Tare, Starting) => {
                "no good frame has come yet: check the board's cable and power, then tare again"
            }
            (Self::Tare, Taring) => "a tare is running: wait until it has ended",
            (Self::Tare, Impedance | FollowMe) => "disarm first",
            (Self::Arm, Starting) => "tare first",
            (Self::Arm, Taring) => WAIT_FOR_TARE,
            (Self::Arm, Impedance | FollowMe) => "it is armed already",
            (Self::Arm, ProtectiveStop) => "resume first",
            (Self::Disarm, Starting | Taring | Ready | ProtectiveStop) => "it is not armed",
            (Self::EndTarget, Starting | Taring | Ready | ProtectiveStop) => {
                "it is not armed: no target leads it"
            }
            (Self::Target(_) | Self::Waypoint { .. } | Self::Recentre, Starting) => "tare, then arm first",
            (Self::Target(_) | Self::Waypoint { .. } | Self::Recentre, Taring) => {
                "wait until the tare has ended, then arm"
            }
            (Self::Target(_) | Self::Waypoint { .. } | Self::Recentre, Ready) => "arm first",
            (Self::Target(_) | Self::Waypoint { .. } | Self::Recentre, ProtectiveStop) => {
                "resume, then arm first"
            }
            (Self::Recentre, FollowMe) => "select the law impedance first",
            (Self::Resume, Starting | Taring | Ready | Impedance | FollowMe) => "it is not stopped",
            (Self::Tare, Ready | ProtectiveStop)
            | (Self::Arm, Ready)
            | (Self::Resume, ProtectiveStop)
            | (Self::Recentre, Impedance)
            | (
                Self::Disarm | Self::Target(_) | Self::Waypoint { .. } | Self::EndTarget,
                Impedance | FollowMe,
            ) => {
                return None;
            }
        })
    }

    /// Returns in words why it was refused, with its values and what to do.
    pub const fn refused(self, refusal: Refusal) -> Refused {
        Refused { request: self, refusal }
    }
}

/// A few words, as in a log of requests: without the numbers of the moment.
impl fmt::Display for Request {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let number = |taxel: u8| u16::from(taxel) + 1;
        match *self {
            Self::Tare => f.write_str("tare"),
            Self::Arm => f.write_str("arm"),
            Self::Disarm => f.write_str("disarm"),
            Self::SelectLaw(law) => write!(f, "law {}", Mode::from(law).name()),
            Self::Stop => f.write_str("stop"),
            Self::OperatorLost => f.write_str("operator lost"),
            Self::Resume => f.write_str("resume"),
            Self::PressTaxel { taxel, .. } => write!(f, "press T{}", number(taxel)),
            Self::MaskTaxel { taxel, masked: true } => write!(f, "mask T{}", number(taxel)),
            Self::MaskTaxel { taxel, masked: false } => write!(f, "use T{}", number(taxel)),
            Self::SetParameter { parameter, .. } => match CONTROLLER.get(usize::from(parameter)) {
                Some(spec) => write!(f, "set {}", spec.name),
                None => write!(f, "set parameter {parameter}"),
            },
            Self::Target(timed) => write!(f, "lead {}", timed.target.kind().name()),
            Self::Waypoint { count, .. } => write!(f, "lead along {count} poses"),
            Self::EndTarget => f.write_str("end target"),
            Self::Recentre => f.write_str("recentre"),
            Self::Gripper(request) => write!(f, "gripper {}", request.name()),
        }
    }
}

/// A refused request; as text why, and what to do. Command line, dashboard and Python show it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Refused {
    request: Request,
    refusal: Refusal,
}

impl fmt::Display for Refused {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match (self.refusal, self.request) {
            (Refusal::Mode(mode), request) => match request.remedy_in(mode) {
                Some(remedy) => write!(f, "{}: {remedy}", self.refusal),
                None => self.refusal.fmt(f),
            },
            (Refusal::OutOfRange, Request::PressTaxel { taxel, force_n }) => write!(
                f,
                "T{} with {force_n} N is out of range; allowed: the cover's taxels (`status` lists them), 0 to \
                 {PRESS_FORCE_MAX_N} N",
                u16::from(taxel) + 1
            ),
            (Refusal::OutOfRange, Request::MaskTaxel { taxel, .. }) => write!(
                f,
                "the cover has no T{}; allowed: the cover's taxels (`status` lists them)",
                u16::from(taxel) + 1
            ),
            (refusal, _) => refusal.fmt(f),
        }
    }
}

/// Why a request was not carried out.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub enum Refusal {
    /// Not allowed in this mode.
    Mode(Mode),
    /// The cause of the stop is still there.
    CauseRemains(crate::Fault),
    /// No valid zero: tare first.
    ZeroInvalid,
    /// There is no robot to move.
    NoRobot,
    /// Only a simulated robot can be pressed by request.
    NotSimulated,
    /// A number outside its range (taxel 0 to the cover's last, force 0 to 200 N, a parameter's own).
    OutOfRange,
    /// No parameter has this number.
    NoSuchParameter,
    /// The parameter is read at the start only.
    NotLive,
    /// In its range, but not beside another parameter's present value.
    Conflict,
    /// In its range, but with it the robot's loop would not be stable at this rate and posture.
    Unstable {
        /// Nearest stable value on the straight way there from the present values; no elements if the present values are not stable
        /// either.
        nearest: ParameterValues,
    },
    /// A stop came after it and before its turn.
    Stopped,
    /// Another client holds the command.
    NotCommander,
    /// The loop did not answer in time.
    NoAnswer,
    /// The cover feels a touch: the robot would move at once.
    Touched {
        /// 0 is T1.
        taxel: u8,
        /// N.
        force_n: f64,
    },
    /// The arm is being recovered from its reflex.
    Recovering,
    /// An arm that is far from the posture that it would be brought to: base and elbow would move at once.
    FarFromPosture {
        /// The joint that is furthest; 0 is the first.
        joint: u8,
        /// Distance, rad.
        off_rad: f64,
    },
    /// A target that is not taken.
    Target(TargetRefusal),
    /// This connection only reads.
    ReadOnly,
    /// A request that the gripper does not take.
    Gripper(GripperRefusal),
}

impl From<TargetRefusal> for Refusal {
    fn from(refusal: TargetRefusal) -> Self {
        Self::Target(refusal)
    }
}

impl From<GripperRefusal> for Refusal {
    fn from(refusal: GripperRefusal) -> Self {
        Self::Gripper(refusal)
    }
}

/// Why not, and what to do.
impl fmt::Display for Refusal {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let text = match *self {
            Self::Mode(mode) => return write!(f, "not possible in mode {}", mode.name()),
            Self::CauseRemains(fault) => return write!(f, "the cause remains. {fault}"),
            Self::Touched { taxel, force_n } => {
                let number = u16::from(taxel) + 1;
                return write!(f, "T{number} feels {force_n:.1} N: let go of the cover first");
            }
            Self::Target(refusal) => return refusal.fmt(f),
            Self::Gripper(refusal) => return refusal.fmt(f),
            Self::FarFromPosture { joint, off_rad } => {
                let number = u16::from(joint) + 1;
                return write!(
                    f,
                    "joint {number} is {off_rad:.2} rad from control.gains.posture_rad; allowed: 0 to {ARMING_POSTURE_RAD} \
                     rad: guide the arm there, or set posture_rad to where it is"
                );
            }
            Self::Recovering => "the arm is being recovered from its reflex: resume again when it is idle",
            Self::ZeroInvalid => "the cover or the flange sensor has no valid zero: tare first",
            Self::NoRobot => "the daemon runs a cover without a robot",
            Self::NotSimulated => "only a simulated robot can be pushed by request",
            Self::OutOfRange => "a number is out of range",
            Self::NoSuchParameter => "the daemon has no such parameter",
            Self::NotLive => "it is read at the start only: change the configuration file",
            Self::Conflict => {
                "it does not go with another parameter (null_space_damping needs a virtual mass of 0.5 kg or more)"
            }
            Self::Unstable { .. } => "not stable with this robot at this rate and posture",
            Self::Stopped => "a stop came before its turn",
            Self::NotCommander => "another client has the command: close it, or let it give the command back",
            Self::NoAnswer => "the daemon does not answer",
            Self::ReadOnly => {
                "this connection may not do this: use the operators' socket, or a certificate of a higher role"
            }
        };
        f.write_str(text)
    }
}

/// The loop's answer.
pub type Outcome = Result<(), Refusal>;

#[cfg(test)]
mod tests {
    extern crate std;
    use super::*;
    use crate::Target;
    use std::string::ToString;

    const MODES: [Mode; 7] = [
        Mode::Starting,
        Mode::Taring,
        Mode::Ready,
        Mode::Impedance,
        Mode::FollowMe,
        Mode::ProtectiveStop,
        Mode::Fault,
    ];

    fn requests() -> [Request; 16] {
        let waypoint =
            Waypoint { time_s: 0.0, position_world: [0.0; 3], quaternion_world: [0.0, 0.0, 0.0, 1.0] };
        [
            Request::Tare,
            Request::Arm,
            Request::Disarm,
            Request::SelectLaw(Law::Impedance),
            Request::SelectLaw(Law::FollowMe),
            Request::Stop,
            Request::OperatorLost,
            Request::Resume,
            Request::PressTaxel { taxel: 0, force_n: 1.0 },
            Request::MaskTaxel { taxel: 0, masked: true },
            Request::SetParameter { parameter: 0, values: ParameterValues::default() },
            Request::Target(TimedTarget::new(Target::BaseVelocity { velocity_body: [0.0; 3] })),
            Request::Waypoint { index: 0, count: 2, waypoint, touch: TouchPolicy::TouchWins },
            Request::EndTarget,
            Request::Recentre,
            Request::Gripper(GripperRequest::Home),
        ]
    }

    #[test]
    fn every_refused_pair_of_request_and_mode_has_a_remedy() {
        for request in requests() {
            for mode in MODES {
                let taken = request.taken_in().contains(&mode);
                let before_the_first_frame = (request, mode) == (Request::Tare, Mode::Starting);
                assert_eq!(
                    request.remedy_in(mode).is_none(),
                    taken && !before_the_first_frame,
                    "{request:?} in {mode:?}"
                );
            }
        }
    }

    #[test]
    fn a_remedy_is_a_request_that_the_mode_takes() {
        let named = [("disarm", Request::Disarm), ("resume", Request::Resume), ("arm first", Request::Arm)];
        for request in requests() {
            for mode in MODES {
                let remedy = request.remedy_in(mode).unwrap_or_default();
                let first = named.iter().find(|(name, _)| remedy.starts_with(name));
                if let Some((_, first)) = first {
                    assert!(first.taken_in().contains(&mode), "{request:?} in {mode:?}: {remedy}");
                }
            }
        }
    }

    #[test]
    fn a_number_out_of_range_is_named_with_unit_and_range() {
        let text = Request::PressTaxel { taxel: 98, force_n: 10.0 }.refused(Refusal::OutOfRange).to_string();
        assert!(text.starts_with("T99 with 10 N is out of range") && text.contains("0 to 200 N"), "{text}");
        let text = Request::MaskTaxel { taxel: 98, masked: true }.refused(Refusal::OutOfRange).to_string();
        assert!(text.starts_with("the cover has no T99"), "{text}");
    }
}
