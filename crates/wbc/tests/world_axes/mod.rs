//! A second implementation of the model, as in the books: every link as its table has it, every recursion with spatial
//! vectors about the arm base in world axes (Featherstone 2008). It shares only rotations with the crate.
#![allow(clippy::needless_range_loop, unreachable_pub, reason = "tests")]

use core::ops::{Add, AddAssign};
use moca_wbc::nalgebra::{Matrix3, SMatrix, Vector3};
use moca_wbc::robot::LinkInertial;
use moca_wbc::rotation;
use moca_wbc::{ArmTable, BaseTable, Mount, Payload};

type V = Vector3<f64>;

/// Spatial velocity or acceleration about the arm base.
#[derive(Clone, Copy)]
struct Motion {
    angular: V,
    linear: V,
}

/// Spatial force or momentum about the arm base.
#[derive(Clone, Copy)]
pub struct Force {
    force: V,
    moment: V,
}

impl Motion {
    const ZERO: Self = Self { angular: V::new(0.0, 0.0, 0.0), linear: V::new(0.0, 0.0, 0.0) };

    fn scaled(&self, s: f64) -> Self {
        Self { angular: self.angular * s, linear: self.linear * s }
    }

    fn cross(&self, other: &Self) -> Self {
        Self {
            angular: self.angular.cross(&other.angular),
            linear: self.angular.cross(&other.linear) + self.linear.cross(&other.angular),
        }
    }

    fn cross_force(&self, h: &Force) -> Force {
        Force {
            force: self.angular.cross(&h.force),
            moment: self.angular.cross(&h.moment) + self.linear.cross(&h.force),
        }
    }

    fn dot(&self, f: &Force) -> f64 {
        self.angular.dot(&f.moment) + self.linear.dot(&f.force)
    }
}

impl Add for Motion {
    type Output = Self;
    fn add(self, other: Self) -> Self {
        Self { angular: self.angular + other.angular, linear: self.linear + other.linear }
    }
}

impl Force {
    const ZERO: Self = Self { force: V::new(0.0, 0.0, 0.0), moment: V::new(0.0, 0.0, 0.0) };
}

impl AddAssign for Force {
    fn add_assign(&mut self, other: Self) {
        self.force += other.force;
        self.moment += other.moment;
    }
}

/// Mass, mass × centre and rotational inertia about the arm base.
#[derive(Clone, Copy)]
struct Body {
    mass: f64,
    first_moment: V,
    rotational: Matrix3<f64>,
}

impl Body {
    fn of(link: &LinkInertial, axes: &Matrix3<f64>, origin: &V) -> Self {
        let com = origin + axes * V::from(link.com_m);
        let [xx, xy, xz, yy, yz, zz] = link.inertia_com;
        let own = axes * Matrix3::new(xx, xy, xz, xy, yy, yz, xz, yz, zz) * axes.transpose();
        let steiner = Matrix3::identity() * com.dot(&com) - com * com.transpose();
        Self {
            mass: link.mass_kg,
            first_moment: com * link.mass_kg,
            rotational: own + steiner * link.mass_kg,
        }
    }

    fn times(&self, v: &Motion) -> Force {
        Force {
            force: v.linear * self.mass + v.angular.cross(&self.first_moment),
            moment: self.rotational * v.angular + self.first_moment.cross(&v.linear),
        }
    }

    fn rate_of_momentum(&self, velocity: &Motion, acceleration: &Motion) -> Force {
        let mut rate = self.times(acceleration);
        rate += velocity.cross_force(&self.times(velocity));
        rate
    }
}

impl Add for Body {
    type Output = Self;
    fn add(self, other: Self) -> Self {
        Self {
            mass: self.mass + other.mass,
            first_moment: self.first_moment + other.first_moment,
            rotational: self.rotational + other.rotational,
        }
    }
}

const NONE: Body = Body {
    mass: 0.0,
    first_moment: V::new(0.0, 0.0, 0.0),
    rotational: Matrix3::new(0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0),
};

/// An arm at one configuration.
pub struct Arm<const N: usize> {
    positions: [V; N],
    motions: [Motion; N],
    bodies: [Body; N],
    link0: Body,
    base_axes: Matrix3<f64>,
    pub arm_from_base: V,
    pub tool_position: V,
    pub tool_axes: Matrix3<f64>,
}

fn placed([x, y, z, roll, pitch, yaw]: [f64; 6]) -> (Matrix3<f64>, V) {
    (rotation::from_rpy([roll, pitch, yaw]), V::new(x, y, z))
}

impl<const N: usize> Arm<N> {
    pub fn at(table: &ArmTable<N>, mount: &Mount, payload: &Payload, yaw: f64, q: &[f64; N]) -> Self {
        let base_axes = rotation::from_rpy([0.0, 0.0, yaw]);
        let arm_axes = base_axes * rotation::from_rpy(mount.rpy_rad);
        let (mut axes, mut position) = (arm_axes, V::zeros());
        let mut arm = Self {
            positions: [V::zeros(); N],
            motions: [Motion::ZERO; N],
            bodies: [NONE; N],
            link0: Body::of(&table.link0, &arm_axes, &V::zeros()),
            base_axes,
            arm_from_base: base_axes * V::from(mount.position_base_m),
            tool_position: V::zeros(),
            tool_axes: Matrix3::zeros(),
        };
        for i in 0..N {
            let (turn, step) = placed(table.joint_origin[i]);
            position += axes * step;
            axes = axes * turn * rotation::from_rpy([0.0, 0.0, q[i]]);
            let axis = axes.column(2).into_owned();
            arm.positions[i] = position;
            arm.motions[i] = Motion { angular: axis, linear: position.cross(&axis) };
            arm.bodies[i] = Body::of(&table.links[i], &axes, &position);
        }
        let (turn, step) = placed(table.flange_origin);
        position += axes * step;
        axes *= turn;
        arm.bodies[N - 1] = arm.bodies[N - 1] + Body::of(&payload.inertial, &axes, &position);
        let (turn, step) = placed(payload.tool_origin);
        arm.tool_position = position + axes * step;
        arm.tool_axes = axes * turn;
        arm
    }

    pub fn jacobian(&self) -> SMatrix<f64, 6, N> {
        SMatrix::from(core::array::from_fn::<[f64; 6], N, _>(|i| {
            let axis = self.motions[i].angular;
            let linear = axis.cross(&(self.tool_position - self.positions[i]));
            [linear.x, linear.y, linear.z, axis.x, axis.y, axis.z]
        }))
    }

    /// M_A, M_AB and the gravity torques.
    pub fn mass(&self) -> (SMatrix<f64, N, N>, SMatrix<f64, N, 3>, [f64; N]) {
        let (mut mass, mut coupling, mut gravity) = (SMatrix::zeros(), SMatrix::zeros(), [0.0; N]);
        let mut composite = NONE;
        for j in (0..N).rev() {
            composite = composite + self.bodies[j];
            let momentum = composite.times(&self.motions[j]);
            for i in 0..=j {
                mass[(i, j)] = self.motions[i].dot(&momentum);
                mass[(j, i)] = mass[(i, j)];
            }
            for (axis, value) in self.planar(&momentum).into_iter().enumerate() {
                coupling[(j, axis)] = value;
            }
            gravity[j] = self.motions[j].dot(&composite.times(&Self::against_gravity()));
        }
        (mass, coupling, gravity)
    }

    /// C q̇ + g on a standing base.
    pub fn bias(&self, dq: &[f64; N]) -> [f64; N] {
        self.newton_euler(dq, Motion::ZERO, Self::against_gravity()).0
    }

    /// ∂T/∂q.
    pub fn momentum_drift(&self, base_rate: &[f64; 3], dq: &[f64; N]) -> [f64; N] {
        let mut velocity = self.base_motion(base_rate);
        let (mut rates, mut momenta) = ([Motion::ZERO; N], [Force::ZERO; N]);
        for i in 0..N {
            velocity = velocity + self.motions[i].scaled(dq[i]);
            rates[i] = velocity.cross(&self.motions[i]);
            momenta[i] = self.bodies[i].times(&velocity);
        }
        let (mut drift, mut total) = ([0.0; N], Force::ZERO);
        for i in (0..N).rev() {
            total += momenta[i];
            drift[i] = rates[i].dot(&total);
        }
        drift
    }

    /// Base block of the mass matrix, bias of base and arm.
    pub fn coupled(
        &self,
        base: &BaseTable,
        rate: &[f64; 3],
        dq: &[f64; N],
    ) -> (Matrix3<f64>, [f64; 3], [f64; N]) {
        let [xx, yy, zz] = base.inertia_com_diagonal;
        let own = LinkInertial {
            mass_kg: base.mass_kg,
            com_m: base.com_m,
            inertia_com: [xx, 0.0, 0.0, yy, 0.0, zz],
        };
        let standing = Body::of(&own, &self.base_axes, &-self.arm_from_base) + self.link0;
        let all = self.bodies.iter().fold(standing, |sum, body| sum + *body);
        let mut block = Matrix3::zeros();
        for axis in 0..3 {
            let unit = core::array::from_fn(|i| if i == axis { 1.0 } else { 0.0 });
            block.set_column(axis, &V::from(self.planar(&all.times(&self.base_motion(&unit)))));
        }
        let velocity = self.base_motion(rate);
        // at constant rates the base's yaw axis is carried along
        let carried = V::new(rate[0], rate[1], 0.0).cross(&V::new(0.0, 0.0, rate[2]));
        let acceleration = Motion { angular: V::zeros(), linear: carried } + Self::against_gravity();
        let (torque, mut force) = self.newton_euler(dq, velocity, acceleration);
        force += standing.rate_of_momentum(&velocity, &acceleration);
        (block, self.planar(&force), torque)
    }

    fn against_gravity() -> Motion {
        Motion { angular: V::zeros(), linear: V::new(0.0, 0.0, moca_wbc::model::GRAVITY_M_S2) }
    }

    fn base_motion(&self, rate: &[f64; 3]) -> Motion {
        let angular = V::new(0.0, 0.0, rate[2]);
        Motion { angular, linear: V::new(rate[0], rate[1], 0.0) + angular.cross(&self.arm_from_base) }
    }

    fn planar(&self, f: &Force) -> [f64; 3] {
        let lever = &self.arm_from_base;
        [f.force.x, f.force.y, f.moment.z + lever.x * f.force.y - lever.y * f.force.x]
    }

    fn newton_euler(&self, dq: &[f64; N], velocity: Motion, acceleration: Motion) -> ([f64; N], Force) {
        let (mut velocity, mut acceleration) = (velocity, acceleration);
        let mut forces = [Force::ZERO; N];
        for i in 0..N {
            let rate = self.motions[i].scaled(dq[i]);
            acceleration = acceleration + velocity.cross(&rate);
            velocity = velocity + rate;
            forces[i] = self.bodies[i].rate_of_momentum(&velocity, &acceleration);
        }
        let (mut torque, mut total) = ([0.0; N], Force::ZERO);
        for i in (0..N).rev() {
            total += forces[i];
            torque[i] = self.motions[i].dot(&total);
        }
        (torque, total)
    }
}
