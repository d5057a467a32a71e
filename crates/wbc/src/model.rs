//! Kinematics and dynamics of a serial arm on a yawing base: one recursion for any table of [`moca_msgs::robot`].
//!
//! Everything is computed in world axes about the arm base's origin (A), so that Jacobian, mass matrix and bias need
//! no later rotation and lose no digits to the base's place in the world. The four passes over the joints are never
//! inlined: inside a whole step compilers stop unrolling their loops.
//!
//! ```
//! use moca_wbc::robot::{MOCA_MOUNT, PANDA};
//! use moca_wbc::{ArmModel, Payload};
//!
//! let model: ArmModel<7, f64> = ArmModel::new(&PANDA, &MOCA_MOUNT, &Payload::NONE)?;
//! let kinematics = model.kinematics(0.0, &PANDA.home_rad);
//! let inertias = model.link_inertias(&kinematics);
//! let mass = kinematics.mass_matrix(&inertias).arm;
//! assert_eq!(mass, mass.transpose());
//! assert_eq!(kinematics.bias(&inertias, &[0.0; 7]).len(), 7);
//! assert!(kinematics.tool_from_base().z > 1.0, "the flange is above a metre");
//! # Ok::<(), moca_wbc::ParameterError>(())
//! ```

use crate::rotation::{self, Heading};
use crate::scalar::{Scalar, all, of};
use crate::spatial::{Force, Inertia, Motion, rotate_symmetric};
use moca_msgs::robot::LinkInertial;
use moca_msgs::{ArmTable, Mount, ParameterError, Payload};
use nalgebra::{Matrix3, SMatrix, Vector3};

/// Standard gravity of the model, m/s², along −z of W.
pub const GRAVITY_M_S2: f64 = 9.81;

/// A fixed transform: place and axes of a child frame in its parent.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Placement<T> {
    rotation: Matrix3<T>,
    origin: Vector3<T>,
}

#[derive(Clone, Copy, Debug, PartialEq)]
struct Link<T> {
    mass: T,
    com: Vector3<T>,
    inertia_com: [T; 6],
}

/// Constant model of an arm of `N` revolute joints with its mount, payload and tool.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ArmModel<const N: usize, T> {
    joints: [Placement<T>; N],
    links: [Link<T>; N],
    link0: Link<T>,
    /// Flange in the last link.
    flange: Placement<T>,
    /// Tool frame E in the last link; the flange if there is no tool.
    tool: Placement<T>,
    /// Arm base A in the mobile base B.
    mount: Placement<T>,
}

/// Where everything is at one configuration: world axes, positions relative to the arm base's origin (A).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Kinematics<const N: usize, T> {
    /// Axes of each link.
    link_rotation: [Matrix3<T>; N],
    /// Origin of each joint, m.
    joint_position: [Vector3<T>; N],
    /// Twist about A per joint rate.
    joint_motion: [Motion<T>; N],
    /// Of the base: from B to W.
    pub heading: Heading<T>,
    /// Axes of B.
    pub base_rotation: Matrix3<T>,
    /// Axes of A.
    pub arm_rotation: Matrix3<T>,
    /// A's origin relative to B's, m.
    pub arm_from_base: Vector3<T>,
    /// Tool frame E relative to A, m.
    pub tool_position: Vector3<T>,
    /// Axes of the tool frame E.
    pub tool_rotation: Matrix3<T>,
    /// Flange relative to A, m.
    pub flange_position: Vector3<T>,
}

/// Mass matrix of the arm and what couples it to the base.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MassMatrix<const N: usize, T> {
    /// M_A: kg·m², joint by joint.
    pub arm: SMatrix<T, N, N>,
    /// M_AB: joint torque per base acceleration (world x, y, yaw).
    pub base_coupling: SMatrix<T, N, 3>,
}

/// Inertia of every link about A's origin, world axes.
#[derive(Clone, Copy, Debug)]
pub struct LinkInertias<const N: usize, T>([Inertia<T>; N]);

impl<const N: usize, T: Scalar> ArmModel<N, T> {
    /// Model of `arm` on `mount` with `payload` fused into its last link.
    ///
    /// # Errors
    /// The first number of a table that is not finite, or a mass outside 0 to 1000 kg.
    pub fn new(arm: &ArmTable<N>, mount: &Mount, payload: &Payload) -> Result<Self, ParameterError> {
        check_tables(arm, mount, payload)?;
        let flange = Placement::of(&arm.flange_origin);
        let mut links = arm.links;
        if let Some(last) = links.last_mut() {
            *last = fuse(last, &payload.inertial, &flange);
        }
        let [x, y, z] = mount.position_base_m;
        let [roll, pitch, yaw] = mount.rpy_rad;
        let tool = flange.then(&Placement::of(&payload.tool_origin));
        Ok(Self {
            joints: arm.joint_origin.map(|origin| Placement::of(&origin).cast()),
            links: links.map(|link| Link::of(&link)),
            link0: Link::of(&arm.link0),
            flange: flange.cast(),
            tool: tool.cast(),
            mount: Placement::of(&[x, y, z, roll, pitch, yaw]).cast(),
        })
    }

    /// Axes and origin (m) of the arm base A in B.
    pub fn mount(&self) -> (&Matrix3<T>, &Vector3<T>) {
        (&self.mount.rotation, &self.mount.origin)
    }

    /// Forward kinematics at base yaw `yaw` and joint angles `q`, rad.
    #[inline(never)]
    pub fn kinematics(&self, yaw: T, q: &[T; N]) -> Kinematics<N, T> {
        let heading = Heading::at(yaw);
        let base_rotation = heading.matrix();
        let arm_rotation = base_rotation * self.mount.rotation;
        let mut link_rotation = [Matrix3::zeros(); N];
        let mut joint_position = [Vector3::zeros(); N];
        let mut joint_motion = [Motion::zero(); N];
        let (mut axes, mut position) = (arm_rotation, Vector3::zeros());
        for i in 0..N {
            let joint = &self.joints[i];
            position += axes * joint.origin;
            axes = turned_about_z(&(axes * joint.rotation), q[i]);
            link_rotation[i] = axes;
            joint_position[i] = position;
            joint_motion[i] = Motion::revolute(&axes.column(2).into_owned(), &position);
        }
        Kinematics {
            link_rotation,
            joint_position,
            joint_motion,
            heading,
            base_rotation,
            arm_rotation,
            arm_from_base: base_rotation * self.mount.origin,
            tool_position: position + axes * self.tool.origin,
            tool_rotation: axes * self.tool.rotation,
            flange_position: position + axes * self.flange.origin,
        }
    }

    /// Inertia of every link at `kinematics`.
    #[inline(never)]
    pub fn link_inertias(&self, kinematics: &Kinematics<N, T>) -> LinkInertias<N, T> {
        let mut inertias = [Inertia::zero(); N];
        for i in 0..N {
            inertias[i] = self.links[i].inertia(&kinematics.link_rotation[i], &kinematics.joint_position[i]);
        }
        LinkInertias(inertias)
    }

    /// Inertia of link 0, which stands on the base, about A's origin, world axes.
    pub(crate) fn link0_inertia(&self, kinematics: &Kinematics<N, T>) -> Inertia<T> {
        self.link0.inertia(&kinematics.arm_rotation, &Vector3::zeros())
    }
}

impl<const N: usize, T: Scalar> Kinematics<N, T> {
    fn axis(&self, joint: usize) -> Vector3<T> {
        self.joint_motion[joint].angular
    }

    /// J_A: twist of E \[m/s; rad/s\] in world axes per joint rate.
    #[inline]
    pub fn arm_jacobian(&self) -> SMatrix<T, 6, N> {
        let mut columns = [[T::zero(); 6]; N];
        for i in 0..N {
            let axis = self.axis(i);
            let linear = axis.cross(&(self.tool_position - self.joint_position[i]));
            columns[i] = [linear.x, linear.y, linear.z, axis.x, axis.y, axis.z];
        }
        SMatrix::from(columns)
    }

    /// J_B: twist of E in world axes per rate of the base's pose (world x, y, yaw).
    #[inline]
    pub fn base_jacobian(&self) -> SMatrix<T, 6, 3> {
        let lever = self.tool_from_base();
        let (zero, one) = (T::zero(), T::one());
        SMatrix::from([
            [one, zero, zero, zero, zero, zero],
            [zero, one, zero, zero, zero, zero],
            [-lever.y, lever.x, zero, zero, zero, one],
        ])
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
            let rate = self.axis(i) * dq[i];
            alpha += omega.cross(&rate);
            omega += rate;
        }
        let step = self.tool_position - point;
        acceleration += alpha.cross(&step) + omega.cross(&omega.cross(&step));
        [acceleration.x, acceleration.y, acceleration.z, alpha.x, alpha.y, alpha.z]
    }

    /// M_A and M_AB by composite rigid bodies.
    #[inline(never)]
    pub fn mass_matrix(&self, inertias: &LinkInertias<N, T>) -> MassMatrix<N, T> {
        let mut arm = [[T::zero(); N]; N];
        let mut coupling = [[T::zero(); N]; 3];
        let mut composite = Inertia::zero();
        for j in (0..N).rev() {
            composite = composite + inertias.0[j];
            let momentum = composite.times(&self.joint_motion[j]);
            for i in 0..=j {
                let value = self.joint_motion[i].dot(&momentum);
                arm[i][j] = value;
                arm[j][i] = value;
            }
            coupling[0][j] = momentum.force.x;
            coupling[1][j] = momentum.force.y;
            coupling[2][j] = self.planar(&momentum)[2];
        }
        MassMatrix { arm: SMatrix::from(arm), base_coupling: SMatrix::from(coupling) }
    }

    /// C q̇ + g of the arm on a standing base, N·m.
    #[inline]
    pub fn bias(&self, inertias: &LinkInertias<N, T>, dq: &[T; N]) -> [T; N] {
        self.newton_euler(inertias, dq, Motion::zero(), Self::against_gravity()).0
    }

    /// C q̇ of the arm on a standing base, N·m.
    pub fn coriolis(&self, inertias: &LinkInertias<N, T>, dq: &[T; N]) -> [T; N] {
        self.newton_euler(inertias, dq, Motion::zero(), Motion::zero()).0
    }

    /// Gravity torques of the arm, N·m.
    #[inline]
    pub fn gravity(&self, inertias: &LinkInertias<N, T>) -> [T; N] {
        let up = of::<T>(GRAVITY_M_S2);
        let mut composite = Inertia::zero();
        let mut torque = [T::zero(); N];
        for i in (0..N).rev() {
            composite = composite + inertias.0[i];
            let force = Vector3::new(T::zero(), T::zero(), up * composite.mass);
            let moment = composite.first_moment.cross(&Vector3::new(T::zero(), T::zero(), up));
            torque[i] = self.joint_motion[i].dot(&Force { force, moment });
        }
        torque
    }

    /// Acceleration that stands for gravity: the whole robot pushed upwards.
    pub(crate) fn against_gravity() -> Motion<T> {
        Motion { angular: Vector3::zeros(), linear: Vector3::new(T::zero(), T::zero(), of(GRAVITY_M_S2)) }
    }

    /// Twist of A about its own origin for a base rate (world x, y, yaw).
    pub(crate) fn base_motion(&self, rate: &[T; 3]) -> Motion<T> {
        let angular = Vector3::new(T::zero(), T::zero(), rate[2]);
        let linear = Vector3::new(rate[0], rate[1], T::zero()) + angular.cross(&self.arm_from_base);
        Motion { angular, linear }
    }

    /// A force about A's origin as a planar wrench about B's origin, world axes: \[f_x, f_y, m_z\].
    #[inline]
    pub(crate) fn planar(&self, f: &Force<T>) -> [T; 3] {
        let lever = &self.arm_from_base;
        [f.force.x, f.force.y, f.moment.z + lever.x * f.force.y - lever.y * f.force.x]
    }

    /// Recursive Newton–Euler with zero joint accelerations: joint torques, and the force on the arm base, for a given
    /// twist and acceleration of A.
    #[inline(never)]
    pub(crate) fn newton_euler(
        &self,
        inertias: &LinkInertias<N, T>,
        dq: &[T; N],
        base_velocity: Motion<T>,
        base_acceleration: Motion<T>,
    ) -> ([T; N], Force<T>) {
        let (mut velocity, mut acceleration) = (base_velocity, base_acceleration);
        let mut forces = [Force::zero(); N];
        for i in 0..N {
            let rate = self.joint_motion[i].scaled(dq[i]);
            acceleration = acceleration + velocity.cross(&rate);
            velocity = velocity + rate;
            forces[i] = inertias.0[i].rate_of_momentum(&velocity, &acceleration);
        }
        let mut torque = [T::zero(); N];
        let mut total = Force::zero();
        for i in (0..N).rev() {
            total += forces[i];
            torque[i] = self.joint_motion[i].dot(&total);
        }
        (torque, total)
    }

    /// Generalised momentum of the arm, p = M_A q̇_A + M_AB q̇_B, and Cᵀq̇, both N·m(·s): what a momentum observer
    /// needs. Cᵀq̇ is the momentum carried by each joint's moving axis, (v_i × S_i)·h_i.
    pub fn momentum(
        &self,
        inertias: &LinkInertias<N, T>,
        base_velocity_world: &[T; 3],
        dq: &[T; N],
    ) -> ([T; N], [T; N]) {
        let mut velocity = self.base_motion(base_velocity_world);
        let mut axis_rate = [Motion::zero(); N];
        let mut momenta = [Force::zero(); N];
        for i in 0..N {
            let axis = self.joint_motion[i];
            velocity = velocity + axis.scaled(dq[i]);
            axis_rate[i] = velocity.cross(&axis);
            momenta[i] = inertias.0[i].times(&velocity);
        }
        let (mut p, mut drift) = ([T::zero(); N], [T::zero(); N]);
        let mut total = Force::zero();
        for i in (0..N).rev() {
            total += momenta[i];
            p[i] = self.joint_motion[i].dot(&total);
            drift[i] = axis_rate[i].dot(&total);
        }
        (p, drift)
    }
}

impl<const N: usize, T: Scalar> LinkInertias<N, T> {
    /// Inertia of all links together about A's origin.
    pub(crate) fn total(&self) -> Inertia<T> {
        self.0.iter().fold(Inertia::zero(), |sum, link| sum + *link)
    }
}

impl Placement<f64> {
    fn of(origin: &[f64; 6]) -> Self {
        let [x, y, z, roll, pitch, yaw] = *origin;
        Self { rotation: rotation::from_rpy([roll, pitch, yaw]), origin: Vector3::new(x, y, z) }
    }

    fn then(&self, child: &Self) -> Self {
        Self { rotation: self.rotation * child.rotation, origin: self.origin + self.rotation * child.origin }
    }

    fn cast<T: Scalar>(&self) -> Placement<T> {
        Placement { rotation: self.rotation.map(of), origin: self.origin.map(of) }
    }
}

impl<T: Scalar> Link<T> {
    fn of(link: &LinkInertial) -> Self {
        Self {
            mass: of(link.mass_kg),
            com: Vector3::from(all(&link.com_m)),
            inertia_com: all(&link.inertia_com),
        }
    }

    #[inline]
    fn inertia(&self, axes: &Matrix3<T>, origin: &Vector3<T>) -> Inertia<T> {
        let com = origin + axes * self.com;
        Inertia::about(self.mass, &com, &rotate_symmetric(axes, &self.inertia_com))
    }
}

/// R·Rz(angle).
#[inline]
fn turned_about_z<T: Scalar>(r: &Matrix3<T>, angle: T) -> Matrix3<T> {
    let (s, c) = angle.sin_cos();
    let (x, y) = (r.column(0), r.column(1));
    Matrix3::from_columns(&[x * c + y * s, y * c - x * s, r.column(2).into_owned()])
}

/// `link` with `payload`, given in flange axes, fixed to it.
fn fuse(link: &LinkInertial, payload: &LinkInertial, flange: &Placement<f64>) -> LinkInertial {
    let mass_kg = link.mass_kg + payload.mass_kg;
    if payload.mass_kg <= 0.0 {
        return *link;
    }
    let com_link = Vector3::from(link.com_m);
    let com_payload = flange.origin + flange.rotation * Vector3::from(payload.com_m);
    let com = (com_link * link.mass_kg + com_payload * payload.mass_kg) / mass_kg;
    let of_link = Inertia::about(link.mass_kg, &(com_link - com), &link.inertia_com);
    let turned = rotate_symmetric(&flange.rotation, &payload.inertia_com);
    let of_payload = Inertia::about(payload.mass_kg, &(com_payload - com), &turned);
    LinkInertial { mass_kg, com_m: com.into(), inertia_com: (of_link + of_payload).rotational }
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
