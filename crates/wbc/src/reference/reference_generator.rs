//! From targets out of another program, 10 to 100 a second or one for all, to a reference that a law can follow at 1 kHz:
//! a pose and its twist, each axis within its bounds of velocity, acceleration and jerk ([`crate::online_trajectory`]).
//!
//! Translation is three axes. Rotation is three axes too, those of the frame in which everything is given: the way ahead
//! is the rotation vector of what is left, log(R_d·Rᵀ), and the angular velocity that the axes have turns R. The axes do
//! not wait for each other: a straight line is a sequence of poses along it.
//!
//! A reference never runs away from the tool: where it would come to rest further ahead than the leash, or outside the
//! [`Workspace`], it stops instead. What takes it back is not stopped.
//!
//! ```
//! use moca_wbc::reference_generator::{Goal, PoseGenerator, ReferenceBounds};
//!
//! let bounds = ReferenceBounds::DEFAULT;
//! let mut generator = PoseGenerator::<f64>::at_rest([0.5, 0.0, 0.8], [0.0, 0.0, 0.0, 1.0])?;
//! let goal = Goal::pose([0.6, 0.0, 0.8], [0.0, 0.0, 0.0, 1.0])?;
//! while !generator.has_reached(&goal) {
//!     generator.step(&goal, &bounds, 1e-3);
//! }
//! assert!((generator.position()[0] - 0.6).abs() < 1e-5);
//! # Ok::<(), moca_wbc::ControlError>(())
//! ```

use crate::error::{ControlError, finite};
use crate::online_trajectory::{ARRIVED, Axis, AxisBounds};
use crate::reference::{
    ERROR_SATURATION_M, ERROR_SATURATION_RAD, Pose, REFERENCE_SPEED_M_S, REFERENCE_SPEED_RAD_S,
};
use crate::rotation;
use crate::scalar::{Scalar, of};
use nalgebra::{Matrix3, Vector3};

/// Bounds on the motion of a reference.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct ReferenceBounds<T = f64> {
    /// Along each axis: m/s, m/s², m/s³.
    pub linear: AxisBounds<T>,
    /// About each axis: rad/s, rad/s², rad/s³.
    pub angular: AxisBounds<T>,
    /// Bounds of each joint, where a posture is the target: rad/s, rad/s², rad/s³.
    pub joint: AxisBounds<T>,
    /// Largest distance ahead of the tool at which it may come to rest, m.
    pub leash_m: T,
    /// Largest angle ahead of the tool at which it may come to rest, rad.
    pub leash_rad: T,
}

impl ReferenceBounds {
    /// The speeds of [`crate::reference`], reached in a third of a second; the leash is half of where the law's pull
    /// saturates.
    pub const DEFAULT: Self = Self {
        linear: AxisBounds { velocity: REFERENCE_SPEED_M_S, acceleration: 1.0, jerk: 20.0 },
        angular: AxisBounds { velocity: REFERENCE_SPEED_RAD_S, acceleration: 4.0, jerk: 80.0 },
        joint: AxisBounds { velocity: crate::reference::POSTURE_SPEED_RAD_S, acceleration: 2.0, jerk: 40.0 },
        leash_m: 0.5 * ERROR_SATURATION_M,
        leash_rad: 0.5 * ERROR_SATURATION_RAD,
    };

    /// In the scalar of a computation.
    pub fn cast<T: Scalar>(&self) -> ReferenceBounds<T> {
        let axis = |bounds: &AxisBounds| AxisBounds {
            velocity: of(bounds.velocity),
            acceleration: of(bounds.acceleration),
            jerk: of(bounds.jerk),
        };
        ReferenceBounds {
            linear: axis(&self.linear),
            angular: axis(&self.angular),
            joint: axis(&self.joint),
            leash_m: of(self.leash_m),
            leash_rad: of(self.leash_rad),
        }
    }
}

/// Region in B where a tool may be wanted: within the arm's reach, and not inside the base under it.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct Workspace<T = f64> {
    /// Around which the arm reaches, m.
    pub shoulder_base_m: [T; 3],
    /// Reach, m.
    pub reach_m: T,
    /// Length, width and height of the base with what the tool shall keep from it, m.
    pub base_size_m: [T; 3],
}

impl<T: Scalar> Workspace<T> {
    /// Distance from the shoulder, m.
    pub fn distance(&self, position_base_m: &[T; 3]) -> T {
        (Vector3::from(*position_base_m) - Vector3::from(self.shoulder_base_m)).norm()
    }

    /// Returns the depth of a point inside the base, m; 0 outside.
    pub fn depth_in_base(&self, [x, y, z]: &[T; 3]) -> T {
        let [length, width, height] = self.base_size_m;
        let half = of::<T>(0.5);
        (length * half - x.abs()).min(width * half - y.abs()).min(height - *z).max(T::zero())
    }

    /// Returns the distance of a point from the region, m; 0 inside.
    pub fn outside(&self, position_base_m: &[T; 3]) -> T {
        (self.distance(position_base_m) - self.reach_m)
            .max(T::zero())
            .max(self.depth_in_base(position_base_m))
    }
}

/// The axes of a twist.
pub use moca_msgs::TwistAxes;

/// Goal of a reference.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(
    feature = "serde",
    derive(serde::Serialize, serde::Deserialize),
    serde(bound = "T: crate::Scalar")
)]
pub enum Goal<T = f64> {
    /// To rest, as quickly as the bounds allow.
    Hold,
    /// A pose.
    Pose {
        /// m.
        position: Vector3<T>,
        /// Axes.
        rotation: Matrix3<T>,
    },
    /// A twist, until told otherwise: m/s, rad/s.
    Twist([T; 6]),
}

impl<T: Scalar> Goal<T> {
    /// A pose: m, and a unit quaternion x, y, z, w.
    ///
    /// # Errors
    /// A value that is not finite, a quaternion that is not of length 1.
    pub fn pose(position: [T; 3], quaternion: [T; 4]) -> Result<Self, ControlError> {
        finite("target position", &position)?;
        Ok(Self::Pose { position: position.into(), rotation: rotation::from_unit_quaternion(quaternion)? })
    }

    /// A twist: m/s, rad/s.
    ///
    /// # Errors
    /// A value that is not finite.
    pub fn twist(twist: [T; 6]) -> Result<Self, ControlError> {
        finite("target twist", &twist)?;
        Ok(Self::Twist(twist))
    }
}

/// Leash that holds a reference back; everything in its frame.
pub(crate) trait Leash<T> {
    /// The tool.
    fn actual(&self) -> (&Vector3<T>, &Matrix3<T>);
    /// Returns the distance of a place from the region of the reference, m.
    fn outside(&self, position: &[T; 3]) -> T;
    /// Returns the part of a twist that the leash allows.
    fn slowed(&self, twist: &[T; 6]) -> [T; 6];
    /// Returns the factor by which the joints would be faster with a twist than when led.
    fn joints_too_fast(&self, twist: &[T; 6]) -> T;
    /// Returns the factor by which the joints would be faster than when led, to make up for an error \[m; rad\].
    fn joints_beyond(&self, error: &[T; 6]) -> T;
}

/// Returns the goal, approached more slowly than with `twist` by that factor. A reference that stops at a pose slows down
/// all the while instead of keeping a speed.
fn slower<T: Scalar>(
    goal: &Goal<T>,
    bounds: &ReferenceBounds<T>,
    twist: &[T; 6],
    times: T,
) -> (Goal<T>, ReferenceBounds<T>) {
    if let Goal::Twist(_) = goal {
        return (Goal::Twist(twist.map(|v| v / times)), *bounds);
    }
    let of_bound = |v: &[T], most: T| v.iter().fold(T::zero(), |share, v| share.max(v.abs() / most));
    let share =
        of_bound(&twist[..3], bounds.linear.velocity).max(of_bound(&twist[3..], bounds.angular.velocity));
    let slower = |axis: AxisBounds<T>| AxisBounds { velocity: axis.velocity * share / times, ..axis };
    (*goal, ReferenceBounds { linear: slower(bounds.linear), angular: slower(bounds.angular), ..*bounds })
}

/// Distance by which a reference would come to rest beyond its leash.
struct Ahead<T> {
    along: T,
    about: T,
    outside: T,
    joints: T,
}

/// A reference on its way: pose and twist in one frame, whose axes those of the twist are too.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(
    feature = "serde",
    derive(serde::Serialize, serde::Deserialize),
    serde(bound = "T: crate::Scalar")
)]
pub struct PoseGenerator<T = f64> {
    along: [Axis<T>; 3],
    /// Their positions are of no use: `rotation` is what they turn.
    about: [Axis<T>; 3],
    rotation: Matrix3<T>,
}

impl<T: Scalar> PoseGenerator<T> {
    /// At rest: m, and a unit quaternion x, y, z, w.
    ///
    /// # Errors
    /// A value that is not finite, a quaternion that is not of length 1.
    pub fn at_rest(position: [T; 3], quaternion: [T; 4]) -> Result<Self, ControlError> {
        finite("position", &position)?;
        let rotation = rotation::from_unit_quaternion(quaternion)?;
        Ok(Self::moving(&Pose { position: position.into(), rotation }, &[T::zero(); 6]))
    }

    /// From a reference that moves: m/s, rad/s.
    pub(crate) fn moving(pose: &Pose<T>, twist: &[T; 6]) -> Self {
        let axis = |i: usize| Axis::moving(if i < 3 { pose.position[i] } else { T::zero() }, twist[i]);
        Self { along: [0, 1, 2].map(axis), about: [3, 4, 5].map(axis), rotation: pose.rotation }
    }

    /// m.
    pub fn position(&self) -> [T; 3] {
        self.along.map(|axis| axis.position)
    }

    /// Axes.
    pub fn rotation(&self) -> &Matrix3<T> {
        &self.rotation
    }

    /// m/s, rad/s.
    pub fn twist(&self) -> [T; 6] {
        let [x, y, z] = self.along.map(|axis| axis.velocity);
        let [roll, pitch, yaw] = self.about.map(|axis| axis.velocity);
        [x, y, z, roll, pitch, yaw]
    }

    /// Returns true if it rests.
    pub fn rests(&self) -> bool {
        self.along.iter().chain(&self.about).all(Axis::rests)
    }

    /// Returns true if it rests at a goal, within [`ARRIVED`] along and about each axis; a twist is never reached.
    pub fn has_reached(&self, goal: &Goal<T>) -> bool {
        let near = of::<T>(2.0 * ARRIVED);
        self.rests()
            && match goal {
                Goal::Hold => true,
                Goal::Pose { position, rotation } => {
                    (Vector3::from(self.position()) - position).amax() <= near
                        && rotation::error(&self.rotation, rotation).amax() <= near
                }
                Goal::Twist(_) => false,
            }
    }

    /// Returns the place where it would come to rest if it were stopped now, m.
    pub fn rest_position(&self, bounds: &ReferenceBounds<T>) -> [T; 3] {
        self.along.map(|axis| axis.position + axis.stopping_way(&bounds.linear))
    }

    /// The rotation vector that it would still turn if it were stopped now, rad.
    fn rest_turn(&self, bounds: &ReferenceBounds<T>) -> Vector3<T> {
        Vector3::from(self.about.map(|axis| axis.stopping_way(&bounds.angular)))
    }

    /// Moves it along by `shift` m, at once: the frame has moved.
    pub(crate) fn carry(&mut self, [x, y]: [T; 2]) {
        self.along[0].position += x;
        self.along[1].position += y;
    }

    /// One step of `dt_s` to a goal, without a leash.
    pub fn step(&mut self, goal: &Goal<T>, bounds: &ReferenceBounds<T>, dt_s: T) {
        self.step_along(goal, bounds, dt_s);
        self.step_about(goal, bounds, dt_s);
    }

    /// One step of `dt_s` on a leash.
    pub(crate) fn step_on_leash(
        &mut self,
        goal: &Goal<T>,
        bounds: &ReferenceBounds<T>,
        leash: &impl Leash<T>,
        dt_s: T,
    ) {
        let before = *self;
        self.step(goal, bounds, dt_s);
        let times = leash.joints_too_fast(&self.twist());
        if times > T::one() {
            let (goal, bounds) = slower(goal, bounds, &self.twist(), times);
            *self = before;
            self.step(&goal, &bounds, dt_s);
        }
        let twist = self.twist();
        let left = leash.slowed(&twist);
        if left != twist {
            *self = before;
            self.step(&Goal::Twist(left), bounds, dt_s);
        }
        let (ahead, ahead_before) = (self.ahead(bounds, leash), before.ahead(bounds, leash));
        if ahead.along > ahead_before.along
            || ahead.outside > ahead_before.outside
            || ahead.joints > ahead_before.joints
        {
            self.along = before.along;
            self.step_along(&Goal::Hold, bounds, dt_s);
        }
        if ahead.about > ahead_before.about || ahead.joints > ahead_before.joints {
            (self.about, self.rotation) = (before.about, before.rotation);
            self.step_about(&Goal::Hold, bounds, dt_s);
        }
    }

    fn ahead(&self, bounds: &ReferenceBounds<T>, leash: &impl Leash<T>) -> Ahead<T> {
        let (actual_position, actual_rotation) = leash.actual();
        let rest = self.rest_position(bounds);
        let along = Vector3::from(rest) - actual_position;
        let about = rotation::error(actual_rotation, &self.rotation) + self.rest_turn(bounds);
        let beyond = |length: T, most: T| (length - most).max(T::zero());
        Ahead {
            along: beyond(along.norm(), bounds.leash_m),
            about: beyond(about.norm(), bounds.leash_rad),
            outside: leash.outside(&rest),
            joints: leash.joints_beyond(&[along.x, along.y, along.z, about.x, about.y, about.z]),
        }
    }

    fn step_along(&mut self, goal: &Goal<T>, bounds: &ReferenceBounds<T>, dt_s: T) {
        for (i, axis) in self.along.iter_mut().enumerate() {
            match goal {
                Goal::Hold => axis.step_to_velocity(T::zero(), &bounds.linear, dt_s),
                Goal::Pose { position, .. } => {
                    axis.step_to_position(position[i] - axis.position, &bounds.linear, dt_s);
                }
                Goal::Twist(twist) => axis.step_to_velocity(twist[i], &bounds.linear, dt_s),
            }
        }
    }

    fn step_about(&mut self, goal: &Goal<T>, bounds: &ReferenceBounds<T>, dt_s: T) {
        let ahead = match goal {
            Goal::Pose { rotation, .. } => rotation::error(&self.rotation, rotation),
            Goal::Hold | Goal::Twist(_) => Vector3::zeros(),
        };
        for (i, axis) in self.about.iter_mut().enumerate() {
            match goal {
                Goal::Hold => axis.step_to_velocity(T::zero(), &bounds.angular, dt_s),
                Goal::Pose { .. } => axis.step_to_position(ahead[i], &bounds.angular, dt_s),
                Goal::Twist(twist) => axis.step_to_velocity(twist[i + 3], &bounds.angular, dt_s),
            }
        }
        let turn = Vector3::from(self.about.map(|axis| axis.velocity)) * dt_s;
        if turn != Vector3::zeros() {
            let turned = rotation::exp(&turn) * self.rotation;
            self.rotation = rotation::from_quaternion(rotation::to_quaternion(&turned));
        }
    }
}
