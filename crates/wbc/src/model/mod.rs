//! Kinematics and dynamics of a serial arm on a yawing base: one set of recursions for any table of
//! [`moca_msgs::robot`], or of a URDF.
//!
//! [`ArmModel::new`] brings a table to normal form once (see `chain.rs`). [`ArmModel::dynamics`] then goes out along
//! the arm and back: poses and Jacobian in world axes, relative to the arm base's origin (A), so that they lose no
//! digits to the base's place in the world; forces and inertias in the links' own axes, where they turn for least.
//!
//! ```
//! use moca_wbc::robot::{MOCA_MOUNT, PANDA};
//! use moca_wbc::{ArmModel, Payload};
//!
//! let model: ArmModel<7, f64> = ArmModel::new(&PANDA, &MOCA_MOUNT, &Payload::NONE)?;
//! let dynamics = model.dynamics(0.0, &PANDA.home_rad, &[0.0; 7]);
//! assert_eq!(dynamics.mass, dynamics.mass.transpose());
//! assert_eq!(dynamics.bias.len(), 7);
//! assert!(dynamics.kinematics.tool_from_base().z > 1.0, "the flange is above a metre");
//! assert_eq!(model.kinematics(0.0, &PANDA.home_rad), dynamics.kinematics, "where no forces are needed");
//! # Ok::<(), moca_wbc::ParameterError>(())
//! ```

use crate::chain::{ABREAST, Abreast, Chain, Joint, Placement, Seat, Square};
use crate::rotation::Heading;
use crate::scalar::{Scalar, of};
use crate::spatial::{Inertia, Turn, TurningInertia, symmetric_times};
use moca_msgs::{ArmTable, Mount, ParameterError, Payload};
use nalgebra::{Matrix3, SMatrix, Vector3};

/// Standard gravity of the model, m/s², along −z of W.
pub const GRAVITY_M_S2: f64 = 9.81;

/// Constant model of an arm of `N` revolute joints, eight at most, with its mount, payload and tool.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ArmModel<const N: usize, T> {
    chain: Chain<N, T>,
    /// Arm base A in the mobile base B.
    mount: Placement<T>,
}

/// Poses of all links in one configuration: world axes, positions relative to the arm base's origin (A).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Kinematics<const N: usize, T> {
    /// Rotation of each joint of the normal form.
    turn: [Turn<T>; N],
    /// Axes of each link of the normal form.
    link_axes: [Matrix3<T>; N],
    /// Origin of each joint, m.
    joint_position: [Vector3<T>; N],
    jacobian: SMatrix<T, 6, N>,
    /// Heading of the base: from B to W.
    pub heading: Heading<T>,
    /// Axes of B.
    pub base_rotation: Matrix3<T>,
    /// A's origin relative to B's, m.
    pub arm_from_base: Vector3<T>,
    /// Tool frame E relative to A, m.
    pub tool_position: Vector3<T>,
    /// Axes of the tool frame E.
    pub tool_rotation: Matrix3<T>,
    /// Flange relative to A, m.
    pub flange_position: Vector3<T>,
}

/// Kinematics, and what the arm's masses make of them.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Dynamics<const N: usize, T> {
    /// Poses of all links.
    pub kinematics: Kinematics<N, T>,
    /// M_A: kg·m², joint by joint.
    pub mass: SMatrix<T, N, N>,
    /// M_AB: joint torque per base acceleration (world x, y, yaw).
    pub base_coupling: SMatrix<T, N, 3>,
    /// C q̇ + g of the arm on a standing base, N·m.
    pub bias: [T; N],
    /// Upward momentum of all that a joint moves, per joint rate, kg·m.
    lift: [T; N],
}

impl<const N: usize, T: Scalar> ArmModel<N, T> {
    /// Model of `arm` on `mount` with `payload` fused into its last link.
    ///
    /// # Errors
    /// The first number of a table that is not finite, or a mass outside 0 to 1000 kg.
    pub fn new(arm: &ArmTable<N>, mount: &Mount, payload: &Payload) -> Result<Self, ParameterError> {
        check_tables(arm, mount, payload)?;
        let [x, y, z] = mount.position_base_m;
        let [roll, pitch, yaw] = mount.rpy_rad;
        let mount = Placement::of(&[x, y, z, roll, pitch, yaw]);
        Ok(Self { chain: Chain::new(arm, payload, &mount.rotation).cast(), mount: mount.cast() })
    }

    /// Axes and origin (m) of the arm base A in B.
    pub fn mount(&self) -> (&Matrix3<T>, &Vector3<T>) {
        (&self.mount.rotation, &self.mount.origin)
    }

    /// Forward kinematics at base yaw `yaw` and joint angles `q`, rad.
    pub fn kinematics(&self, yaw: T, q: &[T; N]) -> Kinematics<N, T> {
        let mut kinematics = Kinematics::unset();
        if self.chain.is_square {
            self.place::<Square<T>>(yaw, q, &mut kinematics);
        } else {
            self.place::<Joint<T>>(yaw, q, &mut kinematics);
        }
        kinematics
    }

    /// Kinematics, mass matrix and bias at base yaw `yaw`, joint angles `q`, rad, and joint rates `dq`, rad/s.
    pub fn dynamics(&self, yaw: T, q: &[T; N], dq: &[T; N]) -> Dynamics<N, T> {
        let mut dynamics = Dynamics::unset();
        self.dynamics_at(yaw, q, dq, &mut dynamics);
        dynamics
    }

    /// `out` becomes what [`ArmModel::dynamics`] gives: nothing is copied.
    #[inline]
    pub fn dynamics_at(&self, yaw: T, q: &[T; N], dq: &[T; N], out: &mut Dynamics<N, T>) {
        let place = (yaw, q);
        if self.chain.is_square {
            self.dynamics_by::<Square<T>>(place, (T::zero(), dq), out);
        } else {
            self.dynamics_by::<Joint<T>>(place, (T::zero(), dq), out);
        }
    }

    /// [`Self::dynamics_at`] on a base that turns, by the arm's kind of seats. Gives the composite of all links, and the force and
    /// moment on the chain's root, in its axes, about its origin; what of it nobody reads is not even computed where this is inlined.
    #[inline]
    fn dynamics_by<S: Seat<T>>(
        &self,
        (yaw, q): (T, &[T; N]),
        rates: (T, &[T; N]),
        out: &mut Dynamics<N, T>,
    ) -> (TurningInertia<T>, (Vector3<T>, Vector3<T>)) {
        let mut felt = [[T::zero(); ABREAST]; 6];
        self.place::<S>(yaw, q, &mut out.kinematics);
        self.feel::<S>(rates, &out.kinematics.turn, &mut felt);
        let (composite, wrench) = self.bear::<S>(&felt, out);
        let (root, turn) = (S::of(&self.chain.joints[0]), &out.kinematics.turn[0]);
        (root.inertia_in_parent(turn, &composite), root.in_parent(turn, wrench))
    }

    /// Out along the arm: where everything is. Written where it stands: returned, it would be copied.
    #[inline(never)]
    fn place<S: Seat<T>>(&self, yaw: T, q: &[T; N], out: &mut Kinematics<N, T>) {
        let chain = &self.chain;
        let angles: [T; N] = core::array::from_fn(|i| q[i] + chain.joints[i].zero);
        let (yawed, turns) = Turn::all(yaw, &angles);
        out.turn = core::array::from_fn(|i| turns[i].times(chain.joints[i].sense));
        out.heading = yawed.into();
        out.base_rotation = out.heading.matrix();
        out.arm_from_base = yawed.about_z(&self.mount.origin);
        let [x, y, z] = [0, 1, 2].map(|i| yawed.about_z(&chain.root_axes.column(i).into_owned()));
        let (mut axes, mut position) = (Matrix3::from_columns(&[x, y, z]), Vector3::zeros());
        for i in 0..N {
            let seat = S::of(&chain.joints[i]);
            position += seat.offset_by(&axes);
            axes = out.turn[i].frame_about_z(&seat.twisted(&axes));
            out.link_axes[i] = axes;
            out.joint_position[i] = position;
        }
        out.flange_position = position + axes * chain.flange.origin;
        out.tool_position = position + axes * chain.tool.origin;
        out.tool_rotation = axes * chain.tool.rotation;
        for i in 0..N {
            let axis = out.link_axes[i].column(2).into_owned();
            let linear = axis.cross(&(out.tool_position - out.joint_position[i]));
            out.jacobian.data.0[i] = [linear.x, linear.y, linear.z, axis.x, axis.y, axis.z];
        }
    }

    /// Back along the arm: M_A and M_AB by composite bodies, each in its own link's axes, and joint torques from what the
    /// links feel. Gives the composite of all links, and the force and moment on them, in the axes of the first.
    #[inline(never)]
    fn bear<S: Seat<T>>(
        &self,
        felt: &Abreast<6, T>,
        out: &mut Dynamics<N, T>,
    ) -> (TurningInertia<T>, (Vector3<T>, Vector3<T>)) {
        let kinematics = &out.kinematics;
        let mut composite = TurningInertia::zero();
        let (mut pull, mut twist) = (Vector3::zeros(), Vector3::zeros());
        for i in (0..N).rev() {
            let [fx, fy, fz, mx, my, mz] = core::array::from_fn(|c| felt[c][i]);
            pull += Vector3::new(fx, fy, fz);
            twist += Vector3::new(mx, my, mz);
            out.bias[i] = twist.z;
            composite = composite + self.chain.link(i);
            // momentum about the joint that a unit rate of it gives to everything beyond it
            let (axes, [_, _, xz, _, yz, zz]) = (&kinematics.link_axes[i], composite.rotational);
            let force = axes.column(1) * composite.first_moment.x - axes.column(0) * composite.first_moment.y;
            let moment = axes * Vector3::new(xz, yz, zz);
            let lever = kinematics.arm_from_base + kinematics.joint_position[i];
            out.base_coupling.data.0[0][i] = force.x;
            out.base_coupling.data.0[1][i] = force.y;
            out.base_coupling.data.0[2][i] = moment.z + lever.x * force.y - lever.y * force.x;
            out.lift[i] = force.z;
            let moment = moment + (kinematics.joint_position[i] - kinematics.tool_position).cross(&force);
            let momentum = [force.x, force.y, force.z, moment.x, moment.y, moment.z];
            out.mass.data.0[i][i] = zz;
            for k in 0..i {
                let value = crate::linalg::dot(&kinematics.jacobian.data.0[k], &momentum);
                out.mass.data.0[k][i] = value;
                out.mass.data.0[i][k] = value;
            }
            if i > 0 {
                let (seat, turn) = (S::of(&self.chain.joints[i]), &kinematics.turn[i]);
                composite = seat.inertia_in_parent(turn, &composite);
                (pull, twist) = seat.in_parent(turn, (pull, twist));
            }
        }
        (composite, (pull, twist))
    }

    /// Out along the arm that is in its place: what each link feels by Newton–Euler with zero joint accelerations on a base that turns
    /// at `yaw_rate`, constant. Only motions wait for those of the link before; what they cost is computed of all links at once.
    #[inline(never)]
    fn feel<S: Seat<T>>(&self, (yaw_rate, dq): (T, &[T; N]), turn: &[Turn<T>; N], felt: &mut Abreast<6, T>) {
        const { assert!(N <= ABREAST, "an arm has eight joints at most") }
        let chain = &self.chain;
        let mut omega = chain.up * yaw_rate;
        let mut alpha = Vector3::zeros();
        let mut acceleration = self.root_acceleration(yaw_rate);
        let mut motions = [[T::zero(); ABREAST]; 9];
        for i in 0..N {
            let seat = S::of(&chain.joints[i]);
            let turn = turn[i].back();
            let into = |v: &Vector3<T>| turn.about_z(&seat.inwards(v));
            acceleration = into(&(acceleration + seat.offset_by(&by_turning(&omega, &alpha))));
            omega = into(&omega);
            alpha = into(&alpha);
            alpha.x += omega.y * dq[i];
            alpha.y -= omega.x * dq[i];
            omega.z += dq[i];
            for axis in 0..3 {
                motions[axis][i] = omega[axis];
                motions[3 + axis][i] = alpha[axis];
                motions[6 + axis][i] = acceleration[axis];
            }
        }
        feel_abreast(&motions, &chain.moments, felt);
    }

    /// Acceleration of A's origin on a base that turns at `yaw_rate`, in the chain's root axes. Gravity is an upward
    /// acceleration of everything.
    fn root_acceleration(&self, yaw_rate: T) -> Vector3<T> {
        let lever = &self.mount.origin;
        let inwards = Vector3::new(lever.x, lever.y, T::zero()) * (-yaw_rate * yaw_rate);
        self.chain.up * of::<T>(GRAVITY_M_S2) + self.chain.root_axes.tr_mul(&inwards)
    }

    /// Input of a momentum observer: the arm's generalised momentum p = M_A q̇_A + M_AB q̇_B = S_i·h_i, N·m·s, and its drift
    /// Cᵀq̇ = ∂T/∂q, N·m, the momentum that each joint's moving axis carries, (v_i × S_i)·h_i. The base moves at
    /// `base_velocity_world` (m/s, m/s, rad/s).
    pub fn momentum(
        &self,
        kinematics: &Kinematics<N, T>,
        base_velocity_world: &[T; 3],
        dq: &[T; N],
    ) -> ([T; N], [T; N]) {
        if self.chain.is_square {
            self.momentum_by::<Square<T>>(kinematics, base_velocity_world, dq)
        } else {
            self.momentum_by::<Joint<T>>(kinematics, base_velocity_world, dq)
        }
    }

    #[inline(never)]
    fn momentum_by<S: Seat<T>>(
        &self,
        kinematics: &Kinematics<N, T>,
        base_velocity_world: &[T; 3],
        dq: &[T; N],
    ) -> ([T; N], [T; N]) {
        let chain = &self.chain;
        let [vx, vy, yaw_rate] = kinematics.heading.to_base(*base_velocity_world);
        let lever = &self.mount.origin;
        let of_arm_base = Vector3::new(vx - yaw_rate * lever.y, vy + yaw_rate * lever.x, T::zero());
        let mut velocity = chain.root_axes.tr_mul(&of_arm_base);
        let mut omega = chain.up * yaw_rate;
        let mut twists = [(Vector3::zeros(), Vector3::zeros()); N];
        for i in 0..N {
            let (seat, turn) = (S::of(&chain.joints[i]), kinematics.turn[i].back());
            velocity = turn.about_z(&seat.inwards(&(velocity - seat.offset_cross(&omega))));
            omega = turn.about_z(&seat.inwards(&omega));
            omega.z += dq[i];
            twists[i] = (velocity, omega);
        }
        let (mut momentum, mut drift) = ([T::zero(); N], [T::zero(); N]);
        let (mut linear, mut angular) = (Vector3::zeros(), Vector3::zeros());
        for i in (0..N).rev() {
            let (body, turn) = (chain.link(i), &kinematics.turn[i]);
            let (v, w) = &twists[i];
            // a turning link has no first moment along its axis
            let (hx, hy) = (body.first_moment.x, body.first_moment.y);
            let of_velocity = Vector3::new(hy * v.z, -hx * v.z, hx * v.y - hy * v.x);
            linear += Vector3::new(-hy * w.z, hx * w.z, hy * w.x - hx * w.y);
            angular += symmetric_times(&body.rotational, w) + of_velocity;
            momentum[i] = angular.z;
            drift[i] = w.y * angular.x - w.x * angular.y + v.y * linear.x - v.x * linear.y;
            (linear, angular) = S::of(&chain.joints[i]).in_parent(turn, (linear, angular));
        }
        (momentum, drift)
    }

    /// [`crate::coupled::CoupledDynamics`] without what stands on the base: `arm` becomes kinematics, arm, coupling, and
    /// bias of the arm on a base that turns at `yaw_rate`, constant. Gives what the base carries; what of it nobody reads is
    /// not even computed where this is inlined.
    #[inline]
    pub(crate) fn on_moving_base(
        &self,
        (yaw, q): (T, &[T; N]),
        (yaw_rate, dq): (T, &[T; N]),
        arm: &mut Dynamics<N, T>,
    ) -> Load<T> {
        let chain = &self.chain;
        let (place, rates) = ((yaw, q), (yaw_rate, dq));
        let (composite, (mut force, mut moment)) = if chain.is_square {
            self.dynamics_by::<Square<T>>(place, rates, arm)
        } else {
            self.dynamics_by::<Joint<T>>(place, rates, arm)
        };
        let standing = &chain.root_body;
        let omega = chain.up * yaw_rate;
        let acceleration = self.root_acceleration(yaw_rate);
        let turning = symmetric_times(&standing.rotational, &omega);
        force += acceleration * standing.mass + omega.cross(&omega.cross(&standing.first_moment));
        moment += standing.first_moment.cross(&acceleration) + omega.cross(&turning);
        let all = *standing
            + Inertia {
                mass: T::zero(),
                first_moment: composite.first_moment,
                rotational: composite.rotational,
            };
        let force = chain.root_axes * force;
        Load {
            inertia: all.rotated(&chain.root_axes).moved(&self.mount.origin),
            moment: chain.root_axes * moment + self.mount.origin.cross(&force),
            force,
        }
    }
}

/// Load of all links with link 0: the inertia in B about its origin, and the force that keeps them on a base that turns at a
/// constant rate, axes of B, about its origin.
pub(crate) struct Load<T> {
    pub inertia: Inertia<T>,
    pub force: Vector3<T>,
    pub moment: Vector3<T>,
}

/// Forces and moments that keep links on their paths: about their origins, in their axes. `motions` are ω, α, and the acceleration of
/// the origin; `moments` are those of [`Chain::moments`].
///
/// Acceleration of a body's points: that of its origin and U = \[α\]× + \[ω\]×². Then f = U·h, and the moment about the origin is
/// h × a and the skew part of U·Σ, Σ its second moments.
#[inline]
fn feel_abreast<T: Scalar>(motions: &Abreast<9, T>, moments: &Abreast<8, T>, felt: &mut Abreast<6, T>) {
    for i in 0..ABREAST {
        let [wx, wy, wz, ax, ay, az, x, y, z] = core::array::from_fn(|c| motions[c][i]);
        let [hx, hy, xx, xy, xz, yy, yz, zz] = core::array::from_fn(|c| moments[c][i]);
        let u = by_turning(&Vector3::new(wx, wy, wz), &Vector3::new(ax, ay, az));
        let row = |i: usize, [a, b, c]: [T; 3]| u[(i, 0)] * a + u[(i, 1)] * b + u[(i, 2)] * c;
        let (of_x, of_y, of_z) = ([xx, xy, xz], [xy, yy, yz], [xz, yz, zz]);
        // a turning link has no first moment along its axis
        let wrench = [
            u[(0, 0)] * hx + u[(0, 1)] * hy,
            u[(1, 0)] * hx + u[(1, 1)] * hy,
            u[(2, 0)] * hx + u[(2, 1)] * hy,
            row(2, of_y) - row(1, of_z) + hy * z,
            row(0, of_z) - row(2, of_x) - hx * z,
            row(1, of_x) - row(0, of_y) + (hx * y - hy * x),
        ];
        for (felt, value) in felt.iter_mut().zip(wrench) {
            felt[i] = value;
        }
    }
}

/// U = \[α\]× + \[ω\]×².
#[inline]
fn by_turning<T: Scalar>(w: &Vector3<T>, a: &Vector3<T>) -> Matrix3<T> {
    let (xx, yy, zz) = (w.x * w.x, w.y * w.y, w.z * w.z);
    let (xy, xz, yz) = (w.x * w.y, w.x * w.z, w.y * w.z);
    Matrix3::new(
        -(yy + zz),
        xy - a.z,
        xz + a.y,
        xy + a.z,
        -(xx + zz),
        yz - a.x,
        xz - a.y,
        yz + a.x,
        -(xx + yy),
    )
}

impl<const N: usize, T: Scalar> Kinematics<N, T> {
    #[inline]
    fn unset() -> Self {
        let zero = T::zero();
        let (turn, vector, matrix) =
            (Turn { sin: zero, cos: zero }, Vector3::new(zero, zero, zero), [[zero; 3]; 3]);
        Self {
            turn: [turn; N],
            link_axes: [matrix.into(); N],
            joint_position: [vector; N],
            jacobian: [[zero; 6]; N].into(),
            heading: Heading::unset(),
            base_rotation: matrix.into(),
            arm_from_base: vector,
            tool_position: vector,
            tool_rotation: matrix.into(),
            flange_position: vector,
        }
    }

    /// Axes and origin (relative to A, m) of a link of the normal form, in world axes; of link 0 those of B, at A.
    #[inline]
    pub(crate) fn link(&self, link: usize) -> (&Matrix3<T>, Vector3<T>) {
        match link.checked_sub(1) {
            Some(joint) => (&self.link_axes[joint], self.joint_position[joint]),
            None => (&self.base_rotation, Vector3::zeros()),
        }
    }

    /// Axis and origin of a joint, world axes, relative to A, m.
    #[inline]
    pub(crate) fn joint(&self, joint: usize) -> (Vector3<T>, &Vector3<T>) {
        (self.link_axes[joint].column(2).into_owned(), &self.joint_position[joint])
    }

    /// Origin of each joint relative to A's, world axes, m.
    pub fn joint_positions(&self) -> &[Vector3<T>; N] {
        &self.joint_position
    }

    /// J_A: twist of E \[m/s; rad/s\] in world axes per joint rate.
    pub fn arm_jacobian(&self) -> &SMatrix<T, 6, N> {
        &self.jacobian
    }

    /// J_B: twist of E in world axes per rate of the base's pose (world x, y, yaw).
    pub fn base_jacobian(&self) -> SMatrix<T, 6, 3> {
        let unit = |axis| core::array::from_fn(|i| if i == axis { T::one() } else { T::zero() });
        SMatrix::from([
            self.twist_from_base(&unit(0)),
            self.twist_from_base(&unit(1)),
            self.twist_from_base(&unit(2)),
        ])
    }

    /// J_B·v: twist of E in world axes from a base velocity (world x, y, yaw).
    #[inline]
    pub fn twist_from_base(&self, &[vx, vy, yaw_rate]: &[T; 3]) -> [T; 6] {
        let (lever, zero) = (self.tool_from_base(), T::zero());
        [vx - lever.y * yaw_rate, vy + lever.x * yaw_rate, zero, zero, zero, yaw_rate]
    }

    /// J_Bᵀ·F: what a wrench at E, world axes, is on a planar base (world x, y, yaw).
    #[inline]
    pub fn force_on_base(&self, &[fx, fy, _, _, _, mz]: &[T; 6]) -> [T; 3] {
        let lever = self.tool_from_base();
        [fx, fy, mz + lever.x * fy - lever.y * fx]
    }

    /// E relative to B's origin, world axes, m.
    #[inline]
    pub fn tool_from_base(&self) -> Vector3<T> {
        self.arm_from_base + self.tool_position
    }

    /// J̇·q̇: acceleration of E \[m/s²; rad/s²\] in world axes at zero joint and base accelerations.
    pub fn jacobian_rate_times_velocity(&self, base_velocity_world: &[T; 3], dq: &[T; N]) -> [T; 6] {
        let mut omega = Vector3::new(T::zero(), T::zero(), base_velocity_world[2]);
        let mut alpha = Vector3::zeros();
        let mut acceleration = omega.cross(&omega.cross(&self.arm_from_base));
        let mut point = Vector3::zeros();
        for i in 0..N {
            let step = self.joint_position[i] - point;
            acceleration += alpha.cross(&step) + omega.cross(&omega.cross(&step));
            point = self.joint_position[i];
            let rate = self.link_axes[i].column(2) * dq[i];
            alpha += omega.cross(&rate);
            omega += rate;
        }
        let step = self.tool_position - point;
        acceleration += alpha.cross(&step) + omega.cross(&omega.cross(&step));
        [acceleration.x, acceleration.y, acceleration.z, alpha.x, alpha.y, alpha.z]
    }
}

impl<const N: usize, T: Scalar> Dynamics<N, T> {
    /// Room for [`ArmModel::dynamics_at`], all zero.
    #[inline]
    pub fn unset() -> Self {
        Self {
            kinematics: Kinematics::unset(),
            mass: [[T::zero(); N]; N].into(),
            base_coupling: [[T::zero(); N]; 3].into(),
            bias: [T::zero(); N],
            lift: [T::zero(); N],
        }
    }

    /// Gravity torques of the arm, N·m.
    #[inline]
    pub fn gravity(&self) -> [T; N] {
        self.lift.map(|lift| lift * of(GRAVITY_M_S2))
    }
}

fn check_tables<const N: usize>(
    arm: &ArmTable<N>,
    mount: &Mount,
    payload: &Payload,
) -> Result<(), ParameterError> {
    let within = |name, unit, values: &[f64], min: f64, max: f64| match values
        .iter()
        .find(|&&value| !(value >= min && value <= max))
    {
        None => Ok(()),
        Some(&value) => Err(ParameterError { name, value, unit, min, max }),
    };
    for origin in arm.joint_origin.iter().chain([&arm.flange_origin, &payload.tool_origin]) {
        within("frame origin", "m, rad", origin, -10.0, 10.0)?;
    }
    within("mount position", "m", &mount.position_base_m, -10.0, 10.0)?;
    within("mount orientation", "rad", &mount.rpy_rad, -10.0, 10.0)?;
    for link in arm.links.iter().chain([&arm.link0, &payload.inertial]) {
        within("link mass", "kg", &[link.mass_kg], 0.0, 1000.0)?;
        within("link centre of mass", "m", &link.com_m, -10.0, 10.0)?;
        within("link inertia", "kg·m²", &link.inertia_com, -1000.0, 1000.0)?;
    }
    Ok(())
}
