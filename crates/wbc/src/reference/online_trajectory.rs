//! Online trajectory generation: from targets that come whenever they like to a motion whose velocity, acceleration and
//! jerk are bounded in every step.
//!
//! One [`Axis`] moves as a⁺ = a + j·dt, v⁺ = v + a⁺·dt, p⁺ = p + v⁺·dt with |j| ≤ J, |a| ≤ A, |v| ≤ V, and each step asks
//! only where it is now: no profile is planned, so a new target costs as much as the old one.
//!
//! **To a velocity.** An acceleration of (k + f)·J·dt, k whole and 0 ≤ f < 1, that falls by J·dt a step from now on changes
//! the velocity by s·J·dt² with s = (k + 1)(k/2 + f). Solved for the change that is wanted,
//! k = ⌊(√(1 + 8s) − 1)/2⌋ and f = s/(k + 1) − k/2, it is the largest acceleration that lands without overshoot: to the
//! bit of rounding in discrete time, not only in the limit. An acceleration that is already larger falls by J·dt, which
//! leaves the velocity that it ends with unchanged: who was within V stays there.
//!
//! **To a position.** From (v, a) the shortest way to rest is ramp, hold, ramp: down to −m at −J, hold, up at +J, where
//! m² = J·v + a²/2, or m = A with a hold where that is larger (mirrored where the ramp of a alone ends below 0). Its
//! displacement rises with v and with a. The next acceleration is the one that puts the point of rest on the target, and
//! where none does, the nearest that the bounds allow: full speed ahead, or the brake.
//!
//! ```
//! use moca_wbc::online_trajectory::{Axis, AxisBounds};
//!
//! let bounds = AxisBounds { velocity: 0.25, acceleration: 1.0, jerk: 20.0 };
//! let mut axis = Axis::<f64>::at_rest(0.0);
//! let mut steps = 0;
//! while !axis.rests_at(0.1) {
//!     axis.step_to_position(0.1 - axis.position, &bounds, 1e-3);
//!     assert!(axis.velocity.abs() <= 0.25 && axis.acceleration.abs() <= 1.0 && axis.position < 0.1 + 1e-6);
//!     steps += 1;
//! }
//! assert!((700..710).contains(&steps), "the quickest way takes V/A + A/J + 0.1 m/V = 0.7 s: {steps}");
//! ```

use crate::scalar::{Scalar, of};

/// Distance at which a target counts as reached, m or rad.
pub const ARRIVED: f64 = 1e-6;
/// Steps of the search for the acceleration whose point of rest is the target.
const SEARCH_STEPS: usize = 8;

/// Bounds of an axis: m or rad, per s, s² and s³; all above 0.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct AxisBounds<T = f64> {
    /// V.
    pub velocity: T,
    /// A.
    pub acceleration: T,
    /// J.
    pub jerk: T,
}

/// State of an axis: m or rad, per s and s².
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct Axis<T = f64> {
    /// p.
    pub position: T,
    /// v.
    pub velocity: T,
    /// a.
    pub acceleration: T,
}

impl<T: Scalar> Axis<T> {
    /// Stands at `position`.
    pub fn at_rest(position: T) -> Self {
        Self::moving(position, T::zero())
    }

    /// Passes `position` with a steady velocity, m/s or rad/s.
    pub fn moving(position: T, velocity: T) -> Self {
        Self { position, velocity, acceleration: T::zero() }
    }

    /// Returns true if it rests within [`ARRIVED`] of `position`.
    pub fn rests_at(&self, position: T) -> bool {
        self.rests() && (self.position - position).abs() <= of(ARRIVED)
    }

    /// Returns true if it rests.
    pub fn rests(&self) -> bool {
        self.velocity == T::zero() && self.acceleration == T::zero()
    }

    /// Returns the distance that it still travels if it is stopped as quickly as `bounds` allow, m or rad.
    pub fn stopping_way(&self, bounds: &AxisBounds<T>) -> T {
        stopping_way(self.velocity, self.acceleration, bounds)
    }

    /// One step of `dt_s` towards `velocity`, or towards the nearest one within the bounds.
    pub fn step_to_velocity(&mut self, velocity: T, bounds: &AxisBounds<T>, dt_s: T) {
        let velocity = velocity.clamp(-bounds.velocity, bounds.velocity);
        let acceleration = self.acceleration_to_velocity(velocity, bounds, dt_s);
        self.advance(acceleration, dt_s);
        // What is left is rounding.
        let change = bounds.jerk * dt_s;
        let rounding = of::<T>(1e-9) * change * dt_s + of::<T>(4.0) * T::default_epsilon() * bounds.velocity;
        if (self.velocity - velocity).abs() <= rounding && self.acceleration.abs() <= change {
            self.velocity = velocity;
            if velocity == T::zero() {
                self.acceleration = T::zero();
            }
        }
    }

    /// One step of `dt_s` towards a target that is `ahead` m or rad away. That distance is the caller's to measure: on a
    /// rotation it is no difference of positions.
    pub fn step_to_position(&mut self, ahead: T, bounds: &AxisBounds<T>, dt_s: T) {
        // At the target, and one step of jerk away from rest.
        let (change, to_rest) = (bounds.jerk * dt_s, -self.velocity / dt_s);
        let nearly_rests = to_rest.abs() <= change && (to_rest - self.acceleration).abs() <= change;
        if ahead.abs() <= of(ARRIVED) && nearly_rests {
            (self.velocity, self.acceleration) = (T::zero(), to_rest);
            return;
        }
        let most = self.acceleration_to_velocity(bounds.velocity, bounds, dt_s);
        let least = self.acceleration_to_velocity(-bounds.velocity, bounds, dt_s);
        let beyond = |acceleration: T| {
            let velocity = self.velocity + acceleration * dt_s;
            velocity * dt_s + stopping_way(velocity, acceleration, bounds) - ahead
        };
        self.advance(root(beyond, least, most), dt_s);
    }

    fn advance(&mut self, acceleration: T, dt_s: T) {
        self.acceleration = acceleration;
        self.velocity += acceleration * dt_s;
        self.position += self.velocity * dt_s;
    }

    /// The next acceleration on the quickest way to `velocity`.
    fn acceleration_to_velocity(&self, velocity: T, bounds: &AxisBounds<T>, dt_s: T) -> T {
        let change = bounds.jerk * dt_s;
        let gap = velocity - self.velocity;
        let s = gap.abs() / (change * dt_s);
        let half = of::<T>(0.5);
        let k = (((T::one() + of::<T>(8.0) * s).sqrt() - T::one()) * half).floor();
        let landing = (k * half + s / (k + T::one())) * change;
        let landing = landing.min(bounds.acceleration).copysign(gap);
        self.acceleration + (landing - self.acceleration).clamp(-change, change)
    }
}

/// See [`Axis::stopping_way`].
fn stopping_way<T: Scalar>(v: T, a: T, bounds: &AxisBounds<T>) -> T {
    let AxisBounds { acceleration: most, jerk, .. } = *bounds;
    let (half, sixth) = (of::<T>(0.5), of::<T>(1.0 / 6.0));
    if v + half * a * a.abs() / jerk < T::zero() {
        return -stopping_way(-v, -a, bounds);
    }
    let peak = (jerk * v + half * a * a).max(T::zero()).sqrt().min(most);
    let t = (a + peak) / jerk;
    let falling = t * (v + t * (half * a - sixth * jerk * t));
    let left = v + t * (a - half * jerk * t);
    let rising = peak * peak * peak / jerk / jerk * sixth;
    let held = ((left - half * peak * peak / jerk) / most).max(T::zero());
    falling + held * (left - half * most * held) + rising
}

/// Returns the zero of a rising function between `low` and `high`, or the nearer end. (Illinois' false position.)
fn root<T: Scalar>(f: impl Fn(T) -> T, mut low: T, mut high: T) -> T {
    let (mut f_low, mut f_high) = (f(low), f(high));
    if f_high <= T::zero() {
        return high;
    }
    if f_low >= T::zero() {
        return low;
    }
    let half = of::<T>(0.5);
    for _ in 0..SEARCH_STEPS {
        let middle = (low * f_high - high * f_low) / (f_high - f_low);
        let f_middle = f(middle);
        if f_middle > T::zero() {
            (high, f_high, f_low) = (middle, f_middle, f_low * half);
        } else {
            (low, f_low, f_high) = (middle, f_middle, f_high * half);
        }
    }
    low
}
