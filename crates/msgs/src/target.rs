//! Targets of other programs for flange, arm or base: their lifetime, and reasons for a refusal.
//!
//! ```
//! use moca_msgs::target::{Target, TimedTarget};
//! use moca_msgs::Request;
//!
//! let target = Target::BaseVelocity { velocity_body: [0.1, 0.0, 0.0] };
//! assert_eq!(TimedTarget::new(target).check(), Ok(()));
//! let target = Target::BaseVelocity { velocity_body: [f64::NAN, 0.0, 0.0] };
//! let refused = TimedTarget::new(target).check().unwrap_err();
//! assert_eq!(refused.to_string(), "base velocity x is not a finite number");
//! ```

use crate::params::ParameterValues;
use core::fmt;

/// Age at which a target expires and the reference holds, unless the target says otherwise, s.
pub const AGE_LIMIT_S: f64 = 0.2;
/// Range of that age, s.
pub const AGE_LIMITS_S: [f64; 2] = [0.02, 2.0];
/// Largest lead of a stamp over the daemon's clock, s: clocks of two machines differ.
pub const AHEAD_MAX_S: f64 = 0.05;
/// Most poses of one trajectory.
pub const MAX_WAYPOINTS: usize = 32;
/// Longest trajectory, s.
pub const TRAJECTORY_MAX_S: f64 = 600.0;
/// Largest speed of a target along an axis, m/s.
pub const SPEED_MAX_M_S: f64 = 0.25;
/// Largest speed of a target about an axis, rad/s.
pub const SPEED_MAX_RAD_S: f64 = 1.0;
/// Furthest place that a target may name along an axis of W, m.
pub const PLACE_MAX_M: f64 = 1e4;

/// In whose axes a twist is given.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub enum TwistAxes {
    /// W.
    #[default]
    World,
    /// B.
    Base,
    /// Those of the flange's reference.
    Flange,
}

crate::choice!(TwistAxes { World: "world", Base: "base", Flange: "flange" });

/// Target of another program.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub enum Target {
    /// The controlled frame at a pose in W.
    Pose {
        /// m.
        position_world: [f64; 3],
        /// Unit quaternion x, y, z, w.
        quaternion_world: [f64; 4],
    },
    /// A twist of the controlled frame, m/s and rad/s.
    Twist {
        /// In whose axes.
        axes: TwistAxes,
        /// Linear, angular.
        twist: [f64; 6],
    },
    /// The arm in a posture, rad: joints and flange go there together.
    Posture(ParameterValues),
    /// The base at a velocity in the axes of B: m/s, m/s, rad/s. In follow-me, or where there is no arm.
    BaseVelocity {
        /// Forward, left, yaw.
        velocity_body: [f64; 3],
    },
}

impl Target {
    /// Returns the kind of target, without its numbers.
    pub const fn kind(&self) -> TargetKind {
        match self {
            Self::Pose { .. } => TargetKind::Pose,
            Self::Twist { .. } => TargetKind::Twist,
            Self::Posture(_) => TargetKind::Posture,
            Self::BaseVelocity { .. } => TargetKind::BaseVelocity,
        }
    }
}

/// Effect of a touch on a target.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub enum TouchPolicy {
    /// It ends, and none is taken until nobody touches.
    #[default]
    TouchWins,
    /// It passes through while nobody touches: a touch sets it aside, and what comes after it counts again.
    PassThrough,
}

crate::choice!(TouchPolicy { TouchWins: "wins", PassThrough: "pass-through" });

/// A target with its time.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct TimedTarget {
    /// Target.
    pub target: Target,
    /// When it was decided, ns since the Unix epoch; 0 is when it reaches the daemon.
    pub stamp_unix_ns: u64,
    /// Age on arrival at the daemon, s. The daemon sets it.
    pub age_s: f64,
    /// Age at which it expires, s: [`AGE_LIMITS_S`]. Then the reference holds.
    pub age_limit_s: f64,
    /// Effect of a touch on it.
    pub touch: TouchPolicy,
}

impl TimedTarget {
    /// Decided when it arrives, for [`AGE_LIMIT_S`]; a touch wins.
    pub const fn new(target: Target) -> Self {
        let touch = TouchPolicy::TouchWins;
        Self { target, stamp_unix_ns: 0, age_s: 0.0, age_limit_s: AGE_LIMIT_S, touch }
    }

    /// Checks what can be checked without knowing the robot.
    ///
    /// # Errors
    /// The first number that is wrong.
    pub fn check(&self) -> Result<(), TargetRefusal> {
        let [shortest, longest] = AGE_LIMITS_S;
        Quantity::AgeLimit.within(&[self.age_limit_s], shortest, longest)?;
        match &self.target {
            Target::Pose { position_world, quaternion_world } => check_pose(position_world, quaternion_world),
            Target::Twist { twist: [x, y, z, roll, pitch, yaw], .. } => {
                Quantity::LinearSpeed.within(&[*x, *y, *z], -SPEED_MAX_M_S, SPEED_MAX_M_S)?;
                Quantity::AngularSpeed.within(&[*roll, *pitch, *yaw], -SPEED_MAX_RAD_S, SPEED_MAX_RAD_S)
            }
            Target::Posture(q_rad) => Quantity::JointAngle.within(q_rad.as_slice(), -7.0, 7.0),
            Target::BaseVelocity { velocity_body } => Quantity::BaseVelocity.within(velocity_body, -3.0, 3.0),
        }
    }

    /// Checks how old it is, s.
    ///
    /// # Errors
    /// Older than it may be, or from the future.
    pub fn check_age(&self) -> Result<(), TargetRefusal> {
        Quantity::Age.within(&[self.age_s], -AHEAD_MAX_S, self.age_limit_s)
    }
}

fn check_pose(position_world: &[f64; 3], quaternion_world: &[f64; 4]) -> Result<(), TargetRefusal> {
    Quantity::Position.within(position_world, -PLACE_MAX_M, PLACE_MAX_M)?;
    Quantity::Quaternion.within(quaternion_world, -1.001, 1.001)?;
    let [x, y, z, w] = quaternion_world;
    // The length squared: this crate has no square root.
    Quantity::QuaternionSquared.within(&[x * x + y * y + z * z + w * w], 0.998, 1.002)
}

/// One pose of a trajectory.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct Waypoint {
    /// When, since the trajectory's start, s.
    pub time_s: f64,
    /// m, in W.
    pub position_world: [f64; 3],
    /// Unit quaternion x, y, z, w.
    pub quaternion_world: [f64; 4],
}

/// Checks a whole trajectory as far as it can be without knowing the robot.
///
/// # Errors
/// The first number that is wrong: no pose or too many, a time that does not rise, a way between two poses that is
/// faster than [`SPEED_MAX_M_S`] along an axis or [`SPEED_MAX_RAD_S`] about any.
pub fn check_trajectory(waypoints: &[Waypoint]) -> Result<(), TargetRefusal> {
    #[expect(clippy::cast_precision_loss, reason = "numbers of poses")]
    let [count, most] = [waypoints.len(), MAX_WAYPOINTS].map(|count| count as f64);
    Quantity::Waypoints.within(&[count], 1.0, most)?;
    for (i, waypoint) in waypoints.iter().enumerate() {
        check_pose(&waypoint.position_world, &waypoint.quaternion_world)?;
        let before = i.checked_sub(1).and_then(|before| waypoints.get(before));
        // The first one is approached at the reference's own speed.
        let earliest = before.map_or(0.0, |before| before.time_s + 1e-3);
        Quantity::WaypointTime.within(&[waypoint.time_s], earliest, TRAJECTORY_MAX_S)?;
        if let Some(before) = before {
            let seconds = waypoint.time_s - before.time_s;
            let speed: [f64; 3] = core::array::from_fn(|axis| {
                (waypoint.position_world[axis] - before.position_world[axis]) / seconds
            });
            Quantity::LinearSpeed.within(&speed, -SPEED_MAX_M_S, SPEED_MAX_M_S)?;
            let turn = angle_rad(&before.quaternion_world, &waypoint.quaternion_world);
            Quantity::TurnSpeed.within(&[turn / seconds], 0.0, SPEED_MAX_RAD_S)?;
        }
    }
    Ok(())
}

/// Angle of the turn that takes one orientation to the other, 0 to π.
fn angle_rad(a: &[f64; 4], b: &[f64; 4]) -> f64 {
    let likeness: f64 = a.iter().zip(b).map(|(a, b)| a * b).sum();
    2.0 * libm::acos(likeness.abs().min(1.0))
}

/// A number of a target.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub enum Quantity {
    /// m.
    Position,
    /// An element of a quaternion.
    Quaternion,
    /// Squared length of one.
    QuaternionSquared,
    /// m/s.
    LinearSpeed,
    /// rad/s.
    AngularSpeed,
    /// rad/s, about whatever axis leads from pose to pose.
    TurnSpeed,
    /// rad.
    JointAngle,
    /// Number of joints.
    Joints,
    /// m/s, m/s, rad/s.
    BaseVelocity,
    /// s.
    Age,
    /// s.
    AgeLimit,
    /// Number of poses.
    Waypoints,
    /// s.
    WaypointTime,
    /// m, of a pose from the arm's shoulder.
    Reach,
    /// m, of a pose inside the base.
    DepthInBase,
}

impl Quantity {
    const fn words(self) -> (&'static str, &'static str) {
        match self {
            Self::Position => ("position", "m"),
            Self::Quaternion => ("quaternion element", ""),
            Self::QuaternionSquared => ("squared length of the quaternion", ""),
            Self::LinearSpeed => ("linear speed", "m/s"),
            Self::AngularSpeed => ("angular speed", "rad/s"),
            Self::TurnSpeed => ("speed of turning", "rad/s"),
            Self::JointAngle => ("joint angle", "rad"),
            Self::Joints => ("number of joints", ""),
            Self::BaseVelocity => ("base velocity", "m/s or rad/s"),
            Self::Age => ("age of the target", "s"),
            Self::AgeLimit => ("age limit", "s"),
            Self::Waypoints => ("number of poses", ""),
            Self::WaypointTime => ("time of a pose", "s"),
            Self::Reach => ("distance from the arm's shoulder", "m"),
            Self::DepthInBase => ("depth inside the base", "m"),
        }
    }

    /// Name of one of several, after a space; nothing where there is only one.
    const fn element(self, index: u8) -> &'static str {
        let names: &[&str] = match self {
            Self::Position | Self::LinearSpeed | Self::AngularSpeed => &[" x", " y", " z"],
            Self::Quaternion => &[" x", " y", " z", " w"],
            Self::BaseVelocity => &[" x", " y", " yaw"],
            Self::JointAngle => &[" J1", " J2", " J3", " J4", " J5", " J6", " J7", " J8"],
            _ => &[],
        };
        if (index as usize) < names.len() { names[index as usize] } else { "" }
    }

    /// Errs on the first of `values` that is not from `min` to `max`.
    ///
    /// # Errors
    /// That one, with the range.
    pub fn within(self, values: &[f64], min: f64, max: f64) -> Result<(), TargetRefusal> {
        self.each_within(values.iter().map(|value| (*value, min, max)))
    }

    /// Errs on the first value that is not from its own least to its own most.
    ///
    /// # Errors
    /// That one, with its range.
    pub fn each_within(self, values: impl Iterator<Item = (f64, f64, f64)>) -> Result<(), TargetRefusal> {
        for (index, (value, min, max)) in values.enumerate() {
            let index = u8::try_from(index).unwrap_or(u8::MAX);
            if !value.is_finite() {
                return Err(TargetRefusal::NotFinite { quantity: self, index });
            }
            if !(min..=max).contains(&value) {
                return Err(TargetRefusal::OutOfRange { quantity: self, index, value, min, max });
            }
        }
        Ok(())
    }
}

/// Part of a robot that another one may come too near to.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub enum RobotPart {
    /// Floor under the base.
    Floor,
    /// Base with its cover.
    Base,
    /// Link of the arm; 0 is the one that stands on the base.
    Link(u8),
    /// Tool at the flange.
    Tool,
}

impl fmt::Display for RobotPart {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Floor => f.write_str("the floor"),
            Self::Base => f.write_str("the base"),
            Self::Link(link) => write!(f, "link {link}"),
            Self::Tool => f.write_str("the tool"),
        }
    }
}

/// Why a target is not taken.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub enum TargetRefusal {
    /// A value is not finite.
    NotFinite {
        /// Refused quantity.
        quantity: Quantity,
        /// Place in it, from 0.
        index: u8,
    },
    /// A number outside its range.
    OutOfRange {
        /// Refused quantity.
        quantity: Quantity,
        /// Place in it, from 0.
        index: u8,
        /// Given value.
        value: f64,
        /// Least.
        min: f64,
        /// Most.
        max: f64,
    },
    /// The impedance law keeps the flange in W: no base can be driven away from it.
    NeedsFollowMe,
    /// There is no arm, or no base, to be led.
    NoSuchPart,
    /// A newer one came before the loop took it.
    Overtaken,
    /// More at once than the loop takes.
    TooMany {
        /// Largest number of targets under way.
        most: u8,
    },
    /// A pose of a trajectory came out of its turn.
    OutOfTurn,
    /// Two parts of the robot would be too near to each other where the target leads.
    TooNear {
        /// The two parts.
        parts: [RobotPart; 2],
        /// Distance between them, m; less than 0 where they would overlap.
        distance_m: f64,
        /// Smallest allowed distance, m.
        least_m: f64,
    },
}

impl fmt::Display for TargetRefusal {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match *self {
            Self::NotFinite { quantity, index } => {
                write!(f, "{}{} is not a finite number", quantity.words().0, quantity.element(index))
            }
            Self::OutOfRange { quantity, index, value, min, max } => {
                let ((name, unit), element) = (quantity.words(), quantity.element(index));
                if unit.is_empty() {
                    return write!(f, "{name}{element} = {value} is outside {min} to {max}");
                }
                write!(f, "{name}{element} = {value:.6} {unit} is outside {min:.6} to {max:.6} {unit}")
            }
            Self::NeedsFollowMe => f.write_str(
                "the impedance law keeps the flange in the world: choose follow-me to drive the base",
            ),
            Self::NoSuchPart => f.write_str("the robot has no such part"),
            Self::Overtaken => f.write_str("a newer target came before its turn"),
            Self::TooMany { most } => write!(f, "too many at once: {most} may be on their way to the loop"),
            Self::OutOfTurn => f.write_str("a pose of a trajectory came out of its turn"),
            Self::TooNear { parts: [one, other], distance_m, least_m } => write!(
                f,
                "{one} and {other} would be {distance_m:.3} m apart, at least {least_m:.3} m are allowed: choose a target further \
                 away from {other}"
            ),
        }
    }
}

/// Kind of a target, without its numbers.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub enum TargetKind {
    /// [`Target::Pose`].
    Pose,
    /// [`Target::Twist`].
    Twist,
    /// [`Target::Posture`].
    Posture,
    /// [`Target::BaseVelocity`].
    BaseVelocity,
    /// Poses and times.
    Trajectory,
}

impl TargetKind {
    /// As users read it.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Pose => "pose",
            Self::Twist => "twist",
            Self::Posture => "posture",
            Self::BaseVelocity => "base velocity",
            Self::Trajectory => "trajectory",
        }
    }
}

/// Progress of a target.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub enum TargetPhase {
    /// The reference is on its way.
    Moving,
    /// The reference is there.
    Reached,
    /// It is too old: the reference holds.
    Aged,
    /// Set aside while the cover feels a touch.
    SetAside,
    /// A touch has ended it.
    EndedByTouch,
    /// Whoever commands has ended it.
    Ended,
}

impl TargetPhase {
    /// As users read it.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Moving => "moving",
            Self::Reached => "reached",
            Self::Aged => "too old",
            Self::SetAside => "set aside by a touch",
            Self::EndedByTouch => "ended by a touch",
            Self::Ended => "ended",
        }
    }
}

/// The last target and how it stands.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct TargetState {
    /// Kind of the target.
    pub kind: TargetKind,
    /// Progress of the target.
    pub phase: TargetPhase,
    /// Share of a trajectory's time that has passed, 0 to 1; of everything else 1 when it is reached.
    pub progress: f64,
}
