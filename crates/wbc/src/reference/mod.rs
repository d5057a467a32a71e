//! References: where the tool is wanted, and how far and fast that may pull.
//!
//! ```
//! use moca_wbc::reference::{ERROR_SATURATION_M, REFERENCE_SPEED_M_S};
//!
//! let pull_n = 800.0 * ERROR_SATURATION_M;
//! assert!(pull_n <= 80.0, "at the paper's stiffness a blocked flange is pulled no harder");
//! assert!(REFERENCE_SPEED_M_S <= 0.25, "a target further away is approached at this speed");
//! ```

use crate::error::{ControlError, finite};
use crate::rotation;
use crate::scalar::{Scalar, all, between, of};
use nalgebra::{Matrix3, Vector3};

/// Largest position error the law acts on, m: the pull on a blocked or fleeing tool saturates there.
pub const ERROR_SATURATION_M: f64 = 0.1;
/// Largest orientation error the law acts on, rad: a target half a turn away pulls no harder.
pub const ERROR_SATURATION_RAD: f64 = 0.5;
/// Speed at which the reference travels to a pose target, m/s, and largest linear twist target.
pub const REFERENCE_SPEED_M_S: f64 = 0.25;
/// Rate at which the twist falls where a base is held back, and rises again, m/s².
const REFERENCE_M_S2: f64 = 2.0;
/// Turning speed of the reference, rad/s, and largest angular twist target.
pub const REFERENCE_SPEED_RAD_S: f64 = 1.0;
/// Speed at which the null-space posture travels to the configured one, rad/s.
pub const POSTURE_SPEED_RAD_S: f64 = 0.5;

/// A pose: position, m, and axes.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(
    feature = "serde",
    derive(serde::Serialize, serde::Deserialize),
    serde(bound = "T: crate::Scalar")
)]
pub(crate) struct Pose<T> {
    pub position: Vector3<T>,
    pub rotation: Matrix3<T>,
}

/// A direction of the plane in which the base was refused what the law wanted, and how fast it went that way, axes of
/// the reference.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(
    feature = "serde",
    derive(serde::Serialize, serde::Deserialize),
    serde(bound = "T: crate::Scalar")
)]
pub(crate) struct HeldBack<T> {
    direction: [T; 2],
    speed: T,
}

impl<T: Scalar> HeldBack<T> {
    /// From the velocities of the tool \[m/s, m/s\] that the base wanted and was given; `None` where they are the same.
    pub(crate) fn between(wanted: [T; 2], given: [T; 2]) -> Option<Self> {
        let [x, y] = [wanted[0] - given[0], wanted[1] - given[1]];
        let length = (x * x + y * y).sqrt();
        (length > of(crate::guard::STANDSTILL)).then(|| {
            let direction = [x / length, y / length];
            Self { direction, speed: (direction[0] * given[0] + direction[1] * given[1]).max(T::zero()) }
        })
    }

    /// `velocity` no faster in that direction than the base: who is led waits for whoever is in the way.
    pub(crate) fn slowed(&self, mut velocity: Vector3<T>) -> Vector3<T> {
        let [x, y] = self.direction;
        let ahead = (x * velocity.x + y * velocity.y - self.speed).max(T::zero());
        velocity.x -= ahead * x;
        velocity.y -= ahead * y;
        velocity
    }
}

/// Target pose and twist of the tool frame, and the reference on its way there; in W for the impedance law, in B for
/// follow-me.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(
    feature = "serde",
    derive(serde::Serialize, serde::Deserialize),
    serde(bound = "T: crate::Scalar")
)]
pub(crate) struct Reference<T> {
    target: Pose<T>,
    twist: [T; 6],
    /// The twist on its way to what a held-back base leaves of it.
    given: [T; 6],
    /// Velocity along the plane at which the base takes it along, m/s.
    carried: [T; 2],
    /// Pose that the law is given.
    pub now: Pose<T>,
}

impl<T: Scalar> Reference<T> {
    /// Holds `pose`.
    pub(crate) fn hold(pose: Pose<T>) -> Self {
        Self {
            target: pose,
            twist: [T::zero(); 6],
            given: [T::zero(); 6],
            carried: [T::zero(); 2],
            now: pose,
        }
    }

    pub(crate) fn set_pose(&mut self, position: [T; 3], quaternion: [T; 4]) -> Result<(), ControlError> {
        finite("target position", &position)?;
        let rotation = rotation::from_unit_quaternion(quaternion)?;
        self.target = Pose { position: Vector3::from(position), rotation };
        (self.twist, self.given) = ([T::zero(); 6], [T::zero(); 6]);
        Ok(())
    }

    pub(crate) fn set_twist(&mut self, twist: [T; 6]) -> Result<(), ControlError> {
        finite("target twist", &twist)?;
        let (linear, angular) = split(&twist);
        let linear = shortened(&linear, of(REFERENCE_SPEED_M_S));
        let angular = shortened(&angular, of(REFERENCE_SPEED_RAD_S));
        self.twist = [linear.x, linear.y, linear.z, angular.x, angular.y, angular.z];
        self.given = self.twist;
        Ok(())
    }

    /// Takes target and reference along at `velocity` m/s along the plane, from now on.
    pub(crate) const fn carry(&mut self, velocity: [T; 2]) {
        self.carried = velocity;
    }

    fn is_carried(&self) -> bool {
        self.carried != [T::zero(); 2]
    }

    /// Is where a generator has it, with its twist.
    pub(crate) fn follow(&mut self, pose: Pose<T>, twist: [T; 6]) {
        *self = Self { carried: self.carried, target: pose, twist: [T::zero(); 6], given: twist, now: pose };
    }

    /// Twist the law is given, m/s and rad/s.
    pub(crate) fn given(&self) -> [T; 6] {
        let mut given = self.given;
        if self.is_carried() {
            given[0] += self.carried[0];
            given[1] += self.carried[1];
        }
        given
    }

    /// The linear twist, not faster where the base is held back; what it changes by comes at [`REFERENCE_M_S2`].
    fn slow_down(&mut self, held_back: Option<&HeldBack<T>>, dt_s: T) -> Vector3<T> {
        let (wanted, angular) = split(&self.twist);
        let wanted = held_back.map_or(wanted, |held_back| held_back.slowed(wanted));
        let (given, _) = split(&self.given);
        let gap = wanted - given;
        let step = shortened(&gap, of::<T>(REFERENCE_M_S2) * dt_s);
        let linear = if step == gap { wanted } else { given + step };
        self.given = [linear.x, linear.y, linear.z, angular.x, angular.y, angular.z];
        linear
    }

    /// Moves target and reference on by `dt_s`. Both wait while the tool is as far behind as the law pulls, and while the
    /// base is held back.
    pub(crate) fn advance(&mut self, actual: &Pose<T>, held_back: Option<&HeldBack<T>>, dt_s: T) {
        if self.is_carried() {
            let shift = Vector3::new(self.carried[0], self.carried[1], T::zero()) * dt_s;
            self.target.position += shift;
            self.now.position += shift;
        }
        if self.now == self.target && self.twist == [T::zero(); 6] {
            return;
        }
        let near = (self.now.position - actual.position).norm_squared()
            < of(ERROR_SATURATION_M * ERROR_SATURATION_M);
        let (_, angular) = split(&self.twist);
        let is_turning = angular != Vector3::zeros();
        // most that are led keep their axes: what only a turn asks for waits for one
        let turns_near = (is_turning || self.now.rotation != self.target.rotation)
            && rotation::error(&actual.rotation, &self.now.rotation).norm() < of(ERROR_SATURATION_RAD);
        let linear = self.slow_down(held_back, dt_s);
        if near {
            self.target.position += linear * dt_s;
            let gap = self.target.position - self.now.position;
            let mut step = shortened(&gap, of::<T>(REFERENCE_SPEED_M_S) * dt_s);
            if let Some(held_back) = held_back
                && self.twist == [T::zero(); 6]
            {
                step = held_back.slowed(step / dt_s) * dt_s;
            }
            self.now.position = if step == gap { self.target.position } else { self.now.position + step };
        }
        if turns_near {
            if is_turning {
                self.target.rotation = turned(&self.target.rotation, &(angular * dt_s));
            }
            let gap = rotation::error(&self.now.rotation, &self.target.rotation);
            let step = shortened(&gap, of::<T>(REFERENCE_SPEED_RAD_S) * dt_s);
            self.now.rotation =
                if step == gap { self.target.rotation } else { turned(&self.now.rotation, &step) };
        }
    }
}

/// Shortens both halves of a pose error to what the law acts on; whether it had to.
#[inline]
pub(crate) fn saturated<T: Scalar>(error: &[T; 6]) -> ([T; 6], bool) {
    let (linear, angular) = split(error);
    let (l, a) = (shortened(&linear, of(ERROR_SATURATION_M)), shortened(&angular, of(ERROR_SATURATION_RAD)));
    ([l.x, l.y, l.z, a.x, a.y, a.z], l != linear || a != angular)
}

/// Moves `posture` towards `target` at no more than [`POSTURE_SPEED_RAD_S`].
pub(crate) fn approach_posture<const N: usize, T: Scalar>(posture: &mut [T; N], target: &[f64; N], dt_s: T) {
    let most = of::<T>(POSTURE_SPEED_RAD_S) * dt_s;
    for (now, target) in posture.iter_mut().zip(all::<N, T>(target)) {
        *now += between(target - *now, -most, most);
    }
}

fn split<T: Scalar>([vx, vy, vz, wx, wy, wz]: &[T; 6]) -> (Vector3<T>, Vector3<T>) {
    (Vector3::new(*vx, *vy, *vz), Vector3::new(*wx, *wy, *wz))
}

/// `v`, or a vector of length `most` that points the same way.
fn shortened<T: Scalar>(v: &Vector3<T>, most: T) -> Vector3<T> {
    let square = v.norm_squared();
    if square > most * most { v * (most / square.sqrt()) } else { *v }
}

/// `rotation` turned by a rotation vector in the outer axes, and made orthonormal again.
fn turned<T: Scalar>(rotation: &Matrix3<T>, by: &Vector3<T>) -> Matrix3<T> {
    rotation::from_quaternion(rotation::to_quaternion(&(rotation::exp(by) * rotation)))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn who_is_led_without_a_turn_keeps_its_axes_to_the_bit() {
        let rotation = rotation::exp(&Vector3::new(0.3_f64, -1.1, 0.7));
        let mut reference = Reference::hold(Pose { position: Vector3::zeros(), rotation });
        reference.set_twist([0.1, 0.0, 0.02, 0.0, 0.0, 0.0]).unwrap();
        for _ in 0..1000 {
            let actual = reference.now;
            reference.advance(&actual, None, 1e-3);
        }
        assert!((reference.now.position.x - 0.1).abs() < 1e-3, "{:?}", reference.now.position);
        assert_eq!(reference.now.rotation, rotation);
        assert_eq!(reference.target.rotation, rotation);
        reference.set_twist([0.0, 0.0, 0.0, 0.0, 0.0, 0.2]).unwrap();
        for _ in 0..1000 {
            let actual = reference.now;
            reference.advance(&actual, None, 1e-3);
        }
        let turned = rotation::error(&rotation, &reference.now.rotation);
        assert!((turned - Vector3::new(0.0, 0.0, 0.2)).norm() < 1e-9, "{turned:?}");
    }

    #[test]
    fn who_is_led_waits_for_a_base_that_is_held_back() {
        let start = Pose { position: Vector3::zeros(), rotation: Matrix3::identity() };
        let run = |held_back: Option<HeldBack<f64>>| {
            let mut reference = Reference::hold(start);
            reference.set_twist([0.2, 0.1, 0.05, 0.0, 0.0, 0.0]).unwrap();
            (0..1000).for_each(|_| reference.advance(&reference.now.clone(), held_back.as_ref(), 1e-3));
            reference.now.position
        };
        let near = |a: Vector3<f64>, b: [f64; 3]| (a - Vector3::from(b)).norm() < 1e-9;
        assert!(near(run(None), [0.2, 0.1, 0.05]));
        // it wanted 0.15 m/s along x and got 0.03: along y and z the reference goes on; slowing down takes its way
        let slowing_m = |from: f64| (0.2 - from).powi(2) / (2.0 * REFERENCE_M_S2) - 0.5e-3 * (0.2 - from);
        let x = 0.03 + slowing_m(0.03);
        assert!(
            (run(HeldBack::between([0.15, 0.02], [0.03, 0.02])) - Vector3::new(x, 0.1, 0.05)).norm() < 1e-4
        );
        // a base that gives way does not take the reference back
        let x = slowing_m(0.0);
        assert!(
            (run(HeldBack::between([0.15, 0.0], [-0.1, 0.0])) - Vector3::new(x, 0.1, 0.05)).norm() < 1e-4
        );
        // refused the way back, it may be led forward
        assert!(near(run(HeldBack::between([-0.15, 0.0], [-0.03, 0.0])), [0.2, 0.1, 0.05]));
        assert_eq!(HeldBack::between([0.1, 0.0], [0.1, 0.0]), None);
    }
}
