//! A serial arm in normal form: what its recursions run on, made once of a table.
//!
//! Every rotation between two joint axes is Rz(g)·Rx(twist)·Rz(b). A turn about an axis is the joint's own business: b is
//! added to the joint's angle and g to the one before, whose link takes the axes turned by g as its own. What is left of a
//! joint's place is a twist about x and an offset, which stays general: the common normals of Denavit and Hartenberg run
//! away where two axes are almost parallel. The inertias are regrouped with [`TurningInertia::parted`], from the last
//! link to link 0. Exact, both: only rounding tells a table from its normal form.

use crate::rotation;
use crate::scalar::{Scalar, all, of};
use crate::spatial::{Inertia, Turn, TurningInertia};
use moca_msgs::robot::LinkInertial;
use moca_msgs::{ArmTable, Payload};
use nalgebra::{Matrix3, Vector3};

/// Sine of a twist below which two axes are parallel: what a π of a table leaves of its sine.
const PARALLEL: f64 = 1e-15;

/// A fixed transform: place and axes of a child frame in its parent.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Placement<T> {
    pub rotation: Matrix3<T>,
    pub origin: Vector3<T>,
}

/// Frame of a joint on the link before.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Joint<T> {
    /// Added to the joint's angle, rad.
    pub zero: T,
    /// About the x axis of the link before.
    pub twist: Turn<T>,
    /// From the origin of the link before, in its axes, m.
    pub offset: Vector3<T>,
}

impl<T: Scalar> Joint<T> {
    /// A force and its moment, or a momentum and its own, about the origin of the link behind a joint that is turned by
    /// `turn`, in the axes of that link: about the origin of the link before, in its axes.
    #[inline]
    pub(crate) fn in_parent(
        &self,
        turn: &Turn<T>,
        (force, moment): (Vector3<T>, Vector3<T>),
    ) -> (Vector3<T>, Vector3<T>) {
        let force = self.twist.about_x(&turn.about_z(&force));
        (force, self.twist.about_x(&turn.about_z(&moment)) + self.offset.cross(&force))
    }
}

/// Constants of an arm of `N` revolute joints with its payload and tool.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Chain<const N: usize, T> {
    pub joints: [Joint<T>; N],
    pub links: [TurningInertia<T>; N],
    /// ∫ r·rᵀ dm of each link: xx, xy, xz, yy, yz, zz.
    pub second_moments: [[T; 6]; N],
    /// Flange in the last link.
    pub flange: Placement<T>,
    /// Tool frame E in the last link; the flange if there is no tool.
    pub tool: Placement<T>,
    /// Axes of the frame in which the first joint stands, in B. Its origin is A's.
    pub root_axes: Matrix3<T>,
    /// The vertical in the root's axes.
    pub up: Vector3<T>,
    /// Link 0 in the root's axes, with all that no joint turns.
    pub root_body: Inertia<T>,
}

impl<const N: usize> Chain<N, f64> {
    /// Builds the chain from checked tables; `arm_axes` are those of A in B.
    pub(crate) fn new(arm: &ArmTable<N>, payload: &Payload, arm_axes: &Matrix3<f64>) -> Self {
        let flange = Placement::of(&arm.flange_origin);
        let mut bodies = arm.links.map(|link| body(&link));
        if let Some(last) = bodies.last_mut() {
            *last = *last + body(&payload.inertial).rotated(&flange.rotation).moved(&flange.origin);
        }
        let mut joints = [Joint { zero: 0.0, twist: Turn::by(0.0), offset: Vector3::zeros() }; N];
        let mut root_axes = *arm_axes;
        let mut root_body = body(&arm.link0);
        for (i, origin) in arm.joint_origin.iter().enumerate() {
            let placement = Placement::of(origin);
            let (before, twist, after) = parted(&placement.rotation);
            let axes = about_z(before);
            joints[i] = Joint { zero: after, twist, offset: axes.tr_mul(&placement.origin) };
            match i.checked_sub(1) {
                Some(parent) => {
                    joints[parent].zero += before;
                    bodies[parent] = bodies[parent].rotated(&axes.transpose());
                }
                None => {
                    root_axes *= axes;
                    root_body = root_body.rotated(&axes.transpose());
                }
            }
        }
        let mut links = [TurningInertia::zero(); N];
        for i in (0..N).rev() {
            let (turning, rod) = TurningInertia::parted(&bodies[i]);
            links[i] = turning;
            let rod = rod.rotated(&about_x(&joints[i].twist)).moved(&joints[i].offset);
            let parent = i.checked_sub(1).map_or(&mut root_body, |parent| &mut bodies[parent]);
            *parent = *parent + rod;
        }
        Self {
            joints,
            second_moments: links.map(|link| link.second_moment()),
            links,
            tool: flange.then(&Placement::of(&payload.tool_origin)),
            flange,
            up: root_axes.row(2).transpose(),
            root_axes,
            root_body,
        }
    }

    /// In the scalar of the computation.
    pub(crate) fn cast<T: Scalar>(&self) -> Chain<N, T> {
        let turn = |turn: &Turn<f64>| Turn { sin: of(turn.sin), cos: of(turn.cos) };
        Chain {
            joints: self.joints.map(|joint| Joint {
                zero: of(joint.zero),
                twist: turn(&joint.twist),
                offset: joint.offset.map(of),
            }),
            links: self.links.map(|link| TurningInertia {
                first_moment: link.first_moment.map(of),
                rotational: all(&link.rotational),
            }),
            second_moments: self.second_moments.map(|moments| all(&moments)),
            flange: self.flange.cast(),
            tool: self.tool.cast(),
            root_axes: self.root_axes.map(of),
            up: self.up.map(of),
            root_body: Inertia {
                mass: of(self.root_body.mass),
                first_moment: self.root_body.first_moment.map(of),
                rotational: all(&self.root_body.rotational),
            },
        }
    }
}

impl Placement<f64> {
    /// From x, y, z m; roll, pitch, yaw rad.
    pub(crate) fn of(origin: &[f64; 6]) -> Self {
        let [x, y, z, roll, pitch, yaw] = *origin;
        Self { rotation: rotation::from_rpy([roll, pitch, yaw]), origin: Vector3::new(x, y, z) }
    }

    fn then(&self, child: &Self) -> Self {
        Self { rotation: self.rotation * child.rotation, origin: self.origin + self.rotation * child.origin }
    }

    pub(crate) fn cast<T: Scalar>(&self) -> Placement<T> {
        Placement { rotation: self.rotation.map(of), origin: self.origin.map(of) }
    }
}

/// Turn about z that a link's axes take over from a joint at `origin` on it: from the normal form's axes to the table's.
pub(crate) fn turn_before(origin: &[f64; 6]) -> Matrix3<f64> {
    about_z(parted(&Placement::of(origin).rotation).0)
}

/// R = Rz(before)·Rx(twist)·Rz(after), |before| ≤ π/2.
fn parted(r: &Matrix3<f64>) -> (f64, Turn<f64>, f64) {
    let (x, y) = (r[(0, 2)], -r[(1, 2)]);
    let (sin, before) = match nalgebra::ComplexField::hypot(x, y) {
        sin if sin < PARALLEL => (0.0, 0.0),
        sin if y < 0.0 => (-sin, nalgebra::RealField::atan2(-x, -y)),
        sin => (sin, nalgebra::RealField::atan2(x, y)),
    };
    let twist = Turn { sin, cos: r[(2, 2)] };
    let left = about_x(&twist.back()) * about_z(-before) * r;
    (before, twist, nalgebra::RealField::atan2(left[(1, 0)], left[(0, 0)]))
}

fn about_x(turn: &Turn<f64>) -> Matrix3<f64> {
    turn.frame_about_x(&Matrix3::identity())
}

fn about_z(angle: f64) -> Matrix3<f64> {
    Turn::by(angle).frame_about_z(&Matrix3::identity())
}

/// Inertia of a link about its frame's origin.
fn body(link: &LinkInertial) -> Inertia<f64> {
    Inertia::about(link.mass_kg, &Vector3::from(link.com_m), &link.inertia_com)
}
