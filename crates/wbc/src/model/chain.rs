//! A serial arm in normal form: what its recursions run on, made once of a table.
//!
//! Every rotation between two joint axes is Rz(g)·Rx(twist)·Rz(b). A turn about an axis is the joint's own business: b is
//! added to the joint's angle and g to the one before, whose link takes the axes turned by g as its own. What is left of a
//! joint's place is a twist about x and an offset, which stays general: the common normals of Denavit and Hartenberg run
//! away where two axes are almost parallel. The inertias are regrouped with [`TurningInertia::parted`], from the last
//! link to link 0. Exact, both: only rounding tells a table from its normal form.
//!
//! No twist is negative: Rx(−t) is Rx(t) between two half turns about z, which change the signs of a joint's sine and cosine. The
//! root's axes are free, so that the first twist is a right angle. Where all are, and no offset has a part along the axis before, a
//! twist exchanges coordinates and needs no product: [`Square`].

use crate::rotation;
use crate::scalar::{Scalar, all, of};
use crate::spatial::{Inertia, Turn, TurningInertia, shifted};
use moca_msgs::robot::LinkInertial;
use moca_msgs::{ArmTable, Payload};
use nalgebra::{Matrix3, Vector3};

/// Sine of a twist below which two axes are parallel, and cosine below which they are square: what a π of a table leaves of them.
const PARALLEL: f64 = 1e-15;
/// 90°
const SQUARE: Turn<f64> = Turn { sin: 1.0, cos: 0.0 };

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
    /// Sign of the sine and the cosine of the turn by that angle.
    pub sense: T,
    /// About the x axis of the link before.
    pub twist: Turn<T>,
    /// From the origin of the link before, in its axes, m.
    pub offset: Vector3<T>,
}

/// Twist and offset of a joint, as the recursions pass them.
pub(crate) trait Seat<T: Scalar>: Copy {
    fn of(joint: &Joint<T>) -> Self;

    /// `axes`·Rx: those of the link before, twisted.
    fn twisted(&self, axes: &Matrix3<T>) -> Matrix3<T>;

    /// Rx·v: from twisted axes to those of the link before.
    fn outwards(&self, v: &Vector3<T>) -> Vector3<T>;

    /// Rxᵀ·v: the way back from [`Self::outwards`].
    fn inwards(&self, v: &Vector3<T>) -> Vector3<T>;

    /// Rx·I·Rxᵀ.
    fn tensor_outwards(&self, tensor: &[T; 6]) -> [T; 6];

    /// M·offset.
    fn offset_by(&self, matrix: &Matrix3<T>) -> Vector3<T>;

    /// offset × v.
    fn offset_cross(&self, v: &Vector3<T>) -> Vector3<T>;

    /// The tensor of a body with first moment h about the origin of the link before, h and the tensor in its axes.
    fn shifted(&self, tensor: &[T; 6], h: &Vector3<T>) -> [T; 6];

    /// A force and its moment, or a momentum and its own, about the origin of the link behind a joint that is turned by
    /// `turn`, in the axes of that link: about the origin of the link before, in its axes.
    #[inline]
    fn in_parent(
        &self,
        turn: &Turn<T>,
        (force, moment): (Vector3<T>, Vector3<T>),
    ) -> (Vector3<T>, Vector3<T>) {
        let force = self.outwards(&turn.about_z(&force));
        (force, self.outwards(&turn.about_z(&moment)) + self.offset_cross(&force))
    }

    /// Inertia about the origin of the link behind a joint, in its axes: about the origin of the link before, in its axes.
    #[inline]
    fn inertia_in_parent(&self, turn: &Turn<T>, inertia: &TurningInertia<T>) -> TurningInertia<T> {
        let first_moment = self.outwards(&turn.about_z(&inertia.first_moment));
        let rotational = self.tensor_outwards(&turn.tensor_about_z(&inertia.rotational));
        TurningInertia { rotational: self.shifted(&rotational, &first_moment), first_moment }
    }
}

impl<T: Scalar> Seat<T> for Joint<T> {
    #[inline]
    fn of(joint: &Self) -> Self {
        *joint
    }

    #[inline]
    fn twisted(&self, axes: &Matrix3<T>) -> Matrix3<T> {
        self.twist.frame_about_x(axes)
    }

    #[inline]
    fn outwards(&self, v: &Vector3<T>) -> Vector3<T> {
        self.twist.about_x(v)
    }

    #[inline]
    fn inwards(&self, v: &Vector3<T>) -> Vector3<T> {
        self.twist.back().about_x(v)
    }

    #[inline]
    fn tensor_outwards(&self, tensor: &[T; 6]) -> [T; 6] {
        self.twist.tensor_about_x(tensor)
    }

    #[inline]
    fn offset_by(&self, matrix: &Matrix3<T>) -> Vector3<T> {
        matrix * self.offset
    }

    #[inline]
    fn offset_cross(&self, v: &Vector3<T>) -> Vector3<T> {
        self.offset.cross(v)
    }

    #[inline]
    fn shifted(&self, tensor: &[T; 6], h: &Vector3<T>) -> [T; 6] {
        shifted(tensor, h, &self.offset)
    }
}

/// A twist of exactly 90°, which exchanges coordinates, and an offset without a part along the axis before.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Square<T> {
    x: T,
    y: T,
}

impl<T: Scalar> Seat<T> for Square<T> {
    #[inline]
    fn of(joint: &Joint<T>) -> Self {
        Self { x: joint.offset.x, y: joint.offset.y }
    }

    #[inline]
    fn twisted(&self, axes: &Matrix3<T>) -> Matrix3<T> {
        Matrix3::from_columns(&[axes.column(0).into_owned(), axes.column(2).into_owned(), -axes.column(1)])
    }

    #[inline]
    fn outwards(&self, v: &Vector3<T>) -> Vector3<T> {
        Vector3::new(v.x, -v.z, v.y)
    }

    #[inline]
    fn inwards(&self, v: &Vector3<T>) -> Vector3<T> {
        Vector3::new(v.x, v.z, -v.y)
    }

    #[inline]
    fn tensor_outwards(&self, &[xx, xy, xz, yy, yz, zz]: &[T; 6]) -> [T; 6] {
        [xx, -xz, xy, zz, -yz, yy]
    }

    #[inline]
    fn offset_by(&self, matrix: &Matrix3<T>) -> Vector3<T> {
        matrix.column(0) * self.x + matrix.column(1) * self.y
    }

    #[inline]
    fn offset_cross(&self, v: &Vector3<T>) -> Vector3<T> {
        Vector3::new(self.y * v.z, -self.x * v.z, self.x * v.y - self.y * v.x)
    }

    #[inline]
    fn shifted(&self, &[xx, xy, xz, yy, yz, zz]: &[T; 6], h: &Vector3<T>) -> [T; 6] {
        let (x, y) = (h.x * self.x, h.y * self.y);
        let (x, y) = (x + x, y + y);
        [
            xx + y,
            xy - (h.x * self.y + h.y * self.x),
            xz - h.z * self.x,
            yy + x,
            yz - h.z * self.y,
            zz + (x + y),
        ]
    }
}

/// Links that are taken side by side, two registers of doubles: room for those of any arm.
pub(crate) const ABREAST: usize = 8;
/// C numbers of each link, each link's in a lane of their own.
pub(crate) type Abreast<const C: usize, T> = [[T; ABREAST]; C];

/// Numbers of each link, side by side; lanes without a link are zero.
fn abreast<const N: usize, const C: usize>(of_links: &[[f64; C]; N]) -> Abreast<C, f64> {
    core::array::from_fn(|c| core::array::from_fn(|i| of_links.get(i).map_or(0.0, |numbers| numbers[c])))
}

/// Constants of an arm of `N` revolute joints with its payload and tool.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Chain<const N: usize, T> {
    pub joints: [Joint<T>; N],
    /// Every joint is [`Square`].
    pub is_square: bool,
    /// Rotational inertia of each link, that of its [`TurningInertia`].
    rotational: [[T; 6]; N],
    /// First moments of the links along x and y, and their second moments ∫ r·rᵀ dm: xx, xy, xz, yy, yz, zz.
    pub moments: Abreast<8, T>,
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
        let mut joints = [Joint { zero: 0.0, sense: 1.0, twist: SQUARE, offset: Vector3::zeros() }; N];
        let mut root_axes = *arm_axes;
        let mut root_body = body(&arm.link0);
        for (i, origin) in arm.joint_origin.iter().enumerate() {
            let placement = Placement::of(origin);
            let Some(parent) = i.checked_sub(1) else {
                let axes = placement.rotation * about_x(&SQUARE.back());
                joints[i].offset = axes.tr_mul(&placement.origin);
                root_axes *= axes;
                root_body = root_body.rotated(&axes.transpose());
                continue;
            };
            let Parted { before, sense, twist, after } = parted(&placement.rotation);
            let axes = about_z(before) * half_turns(sense);
            joints[i] = Joint { zero: after, sense, twist, offset: axes.tr_mul(&placement.origin) };
            joints[parent].zero += before;
            joints[parent].sense *= sense;
            bodies[parent] = bodies[parent].rotated(&axes.transpose());
        }
        let is_square = joints.iter().all(|joint| joint.twist == SQUARE && joint.offset.z == 0.0);
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
            is_square,
            moments: abreast(&links.map(|link| {
                let [hx, hy, _] = link.first_moment.into();
                let [xx, xy, xz, yy, yz, zz] = link.second_moment();
                [hx, hy, xx, xy, xz, yy, yz, zz]
            })),
            rotational: links.map(|link| link.rotational),
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
                sense: of(joint.sense),
                twist: turn(&joint.twist),
                offset: joint.offset.map(of),
            }),
            is_square: self.is_square,
            rotational: self.rotational.map(|rotational| all(&rotational)),
            moments: self.moments.map(|moments| all(&moments)),
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

impl<const N: usize, T: Scalar> Chain<N, T> {
    /// Inertia of a link that turns with its joint.
    #[inline]
    pub(crate) fn link(&self, i: usize) -> TurningInertia<T> {
        let first_moment = Vector3::new(self.moments[0][i], self.moments[1][i], T::zero());
        TurningInertia { first_moment, rotational: self.rotational[i] }
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
    let Parted { before, sense, .. } = parted(&Placement::of(origin).rotation);
    about_z(before) * half_turns(sense)
}

/// R = Rz(before)·S·Rx(twist)·S·Rz(after), S = diag(sense, sense, 1), |before| ≤ π/2, no twist negative.
struct Parted {
    before: f64,
    sense: f64,
    twist: Turn<f64>,
    after: f64,
}

fn parted(r: &Matrix3<f64>) -> Parted {
    let (x, y) = (r[(0, 2)], -r[(1, 2)]);
    let (sin, sense, before) = match nalgebra::ComplexField::hypot(x, y) {
        sin if sin < PARALLEL => (0.0, 1.0, 0.0),
        sin if y < 0.0 => (sin, -1.0, nalgebra::RealField::atan2(-x, -y)),
        sin => (sin, 1.0, nalgebra::RealField::atan2(x, y)),
    };
    let cos = r[(2, 2)];
    let twist = if cos.abs() < PARALLEL { SQUARE } else { Turn { sin, cos } };
    let left = about_x(&twist.back()) * half_turns(sense) * about_z(-before) * r;
    let left = half_turns(sense) * left;
    Parted { before, sense, twist, after: nalgebra::RealField::atan2(left[(1, 0)], left[(0, 0)]) }
}

fn half_turns(sense: f64) -> Matrix3<f64> {
    Matrix3::from_diagonal(&Vector3::new(sense, sense, 1.0))
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
