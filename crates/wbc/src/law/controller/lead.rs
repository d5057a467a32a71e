//! Memory of an external lead of a law.

use super::FlangePose;
use crate::online_trajectory::{Axis, AxisBounds};
use crate::reference_generator::{Goal, PoseGenerator, ReferenceBounds, TwistAxes, Workspace};
use crate::scalar::{Scalar, of};

/// Goal to which a tool or an arm is led.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Target<const N: usize, T = f64> {
    /// Nowhere: it comes to rest.
    Hold,
    /// A pose of the controlled frame E in W.
    Pose(FlangePose<T>),
    /// A twist of it, m/s and rad/s, until told otherwise.
    Twist {
        /// In whose axes.
        axes: TwistAxes,
        /// Linear, angular.
        twist: [T; 6],
    },
    /// A posture, rad: joints and tool go there together.
    Posture([T; N]),
}

/// Progress towards a target.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(
    feature = "serde",
    derive(serde::Serialize, serde::Deserialize),
    serde(bound = "T: crate::Scalar")
)]
pub(super) struct Lead<const N: usize, T> {
    pub(super) bounds: ReferenceBounds<T>,
    pub(super) workspace: Option<Workspace<T>>,
    pub(super) way: Way<N, T>,
    pub(super) reached: bool,
}

#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(
    feature = "serde",
    derive(serde::Serialize, serde::Deserialize),
    serde(bound = "T: crate::Scalar")
)]
pub(super) enum Way<const N: usize, T> {
    Tool {
        generator: PoseGenerator<T>,
        target: ToolTarget<T>,
    },
    Posture {
        #[cfg_attr(feature = "serde", serde(with = "serde_big_array::BigArray"))]
        axes: [Axis<T>; N],
        /// `None`: to rest.
        #[cfg_attr(feature = "serde", serde(with = "optional"))]
        target: Option<[T; N]>,
        /// Pose of the base when the target came: a tool that is led in W does not go along with it.
        base_pose_world: [T; 3],
    },
}

impl<const N: usize, T: Scalar> Way<N, T> {
    /// Returns true if the reference on this way stands.
    pub(super) fn rests(&self) -> bool {
        match self {
            Self::Tool { generator, .. } => generator.rests(),
            Self::Posture { axes, .. } => axes.iter().all(Axis::rests),
        }
    }
}

/// A goal in W, except a twist: in its own axes.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(
    feature = "serde",
    derive(serde::Serialize, serde::Deserialize),
    serde(bound = "T: crate::Scalar")
)]
pub(super) enum ToolTarget<T> {
    World(Goal<T>),
    Twist(TwistAxes, [T; 6]),
}

/// Most that a base which is led may do along an axis of B: m/s² and rad/s², m/s³ and rad/s³.
pub(super) const BASE_LEAD: [f64; 2] = [1.0, 10.0];

/// Commanded velocity of a base on its way to the one that was asked for, axes of B.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub(super) struct BaseLead<T> {
    /// Their positions are of no use.
    axes: [Axis<T>; 3],
    target: [T; 3],
}

impl<T: Scalar> BaseLead<T> {
    pub(super) fn to(self, target: [T; 3]) -> Self {
        Self { target, ..self }
    }

    pub(super) fn at_rest() -> Self {
        Self { axes: [Axis::at_rest(T::zero()); 3], target: [T::zero(); 3] }
    }

    /// One step; what was commanded before it and after it, and whether that is for good nothing.
    pub(super) fn advance(&mut self, velocity_max: &[T; 3], dt_s: T) -> ([T; 3], [T; 3], bool) {
        let before = self.axes.map(|axis| axis.velocity);
        for (i, axis) in self.axes.iter_mut().enumerate() {
            let [acceleration, jerk] = BASE_LEAD.map(of);
            // A limit of 0 leaves nothing to reach; a bound of 0 is none.
            let velocity = velocity_max[i].max(of(1e-9));
            let target = self.target[i].clamp(-velocity_max[i], velocity_max[i]);
            let bounds = AxisBounds { velocity, acceleration, jerk };
            axis.step_to_velocity(target, &bounds, dt_s);
        }
        let ended = self.target == [T::zero(); 3] && self.axes.iter().all(Axis::rests);
        (before, self.axes.map(|axis| axis.velocity), ended)
    }
}

/// serde's arrays end at 32 elements, and serde-big-array knows no options.
#[cfg(feature = "serde")]
mod optional {
    use serde::{Deserialize, Deserializer, Serialize, Serializer};

    #[derive(Serialize, Deserialize)]
    #[serde(bound = "T: crate::Scalar")]
    struct Array<const N: usize, T>(#[serde(with = "serde_big_array::BigArray")] [T; N]);

    pub(super) fn serialize<const N: usize, T: crate::Scalar, S: Serializer>(
        values: &Option<[T; N]>,
        serializer: S,
    ) -> Result<S::Ok, S::Error> {
        values.map(Array).serialize(serializer)
    }

    pub(super) fn deserialize<'de, const N: usize, T: crate::Scalar, D: Deserializer<'de>>(
        deserializer: D,
    ) -> Result<Option<[T; N]>, D::Error> {
        Ok(Option::<Array<N, T>>::deserialize(deserializer)?.map(|Array(values)| values))
    }
}
