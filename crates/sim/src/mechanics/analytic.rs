//! Base and arm by the model of `moca-wbc`, people as masses: for scenes in which no two rigid bodies meet.
//!
//! The step is MuJoCo's: semi-implicit Euler, with the wheels' damping at the end of the step: "implicitfast", and "Euler"
//! as well, for they differ only where something else than a joint damps. `tests/engines.rs` compares both along whole trajectories.

use super::joint_limits::JointLimits;
use super::{BAD_ACCELERATION, BAD_POSITION, BAD_RATE, Mechanics, SINGULAR};
use crate::gripper::FlangePose;
use crate::mjcf::implicit_damping;
use crate::scene::Mobility;
use crate::{ModelSize, Scene, SimError};
use moca_msgs::robot::{ArmTable, LinkInertial, Mount, Payload};
use moca_wbc::ArmModel;
use moca_wbc::coupled::CoupledDynamics;
use moca_wbc::linalg::transpose_times;
use moca_wbc::opspace::WholeBodyForce;
use moca_wbc::rotation::from_rpy;

/// Coordinates of the base.
const BASE: usize = 3;
/// Numbers beyond this count as infinite, as MuJoCo has it.
const LARGEST: f64 = 1e10;

/// For the arm's number of joints.
pub(super) fn of(scene: &Scene) -> Result<Box<dyn Mechanics>, SimError> {
    if let Some(what) = scene.needs_mujoco() {
        return Err(SimError::NeedsMuJoCo { what });
    }
    match scene.arm.joints {
        6 => Ok(Box::new(Analytic::<6>::new(scene)?)),
        _ => Ok(Box::new(Analytic::<7>::new(scene)?)),
    }
}

/// Base and arm of `N` joints, and people.
#[derive(Debug)]
struct Analytic<const N: usize> {
    model: ArmModel<N, f64>,
    /// The parts of it, for another load.
    parts: (ArmTable<N>, Mount, Payload),
    limits: Option<JointLimits<N>>,
    people_kg: Vec<f64>,
    /// Damping of the wheels at the end of a step, N·s/m, N·s/m, N·m·s/rad.
    damping: [f64; BASE],
    /// Damping of the joints at the end of a step, N·m·s/rad.
    joint_damping: [f64; N],
    step_s: f64,
    time_s: f64,
    positions: Vec<f64>,
    rates: Vec<f64>,
    forces: Vec<f64>,
    bias: Vec<f64>,
    flange_wrench_world: [f64; 6],
    dynamics: CoupledDynamics<N, f64>,
    /// Place of the base to which the dynamics belong, m.
    base_world: [f64; 2],
    /// Scratch for the dense mass matrix.
    mass: Vec<f64>,
}

impl<const N: usize> Analytic<N> {
    fn new(scene: &Scene) -> Result<Self, SimError> {
        let refused = |error: moca_msgs::ParameterError| SimError::Model(error.to_string());
        let arm = scene.arm.table::<N>().ok_or(SimError::NeedsMuJoCo { what: "this arm" })?;
        let model = ArmModel::new(&arm, &scene.mount, &scene.payload).map_err(refused)?;
        let dynamics = CoupledDynamics::new(&model, &scene.base, (0.0, &[0.0; N]), (&[0.0; BASE], &[0.0; N]));
        let limits = scene.joint_limits.then(|| JointLimits::new(&arm, &dynamics, scene.physics_step_s));
        let people_kg: Vec<f64> = scene
            .people
            .iter()
            .filter_map(|person| match person.mobility {
                Mobility::Standing { mass_kg, .. } => Some(mass_kg),
                Mobility::Fixed => None,
            })
            .collect();
        let coordinates = BASE + N + 2 * people_kg.len();
        Ok(Self {
            model,
            parts: (arm, scene.mount, scene.payload),
            limits: limits.transpose()?,
            people_kg,
            damping: implicit_damping(scene),
            joint_damping: [0.0; N],
            step_s: scene.physics_step_s,
            time_s: 0.0,
            positions: vec![0.0; coordinates],
            rates: vec![0.0; coordinates],
            forces: vec![0.0; coordinates],
            bias: vec![0.0; coordinates],
            flange_wrench_world: [0.0; 6],
            dynamics,
            base_world: [0.0; 2],
            mass: vec![0.0; coordinates * coordinates],
        })
    }

    /// Returns the forces on base and arm except the bias: external forces, wheel damping, flange wrench.
    fn force(&self) -> WholeBodyForce<N, f64> {
        let (base, arm) = self.forces[..BASE + N].split_at(BASE);
        let mut force = WholeBodyForce {
            base: std::array::from_fn(|i| base[i] - self.damping[i] * self.rates[i]),
            arm: std::array::from_fn(|i| arm[i] - self.joint_damping[i] * self.rates[BASE + i]),
        };
        let [fx, fy, fz, mx, my, mz] = self.flange_wrench_world;
        if self.flange_wrench_world.iter().any(|w| w.abs() > 0.0) {
            let kinematics = &self.dynamics.arm.kinematics;
            // about the tool, which the Jacobian is of
            let lever = kinematics.flange_position - kinematics.tool_position;
            let wrench = [
                fx,
                fy,
                fz,
                mx + lever.y * fz - lever.z * fy,
                my + lever.z * fx - lever.x * fz,
                mz + lever.x * fy - lever.y * fx,
            ];
            let on_base = kinematics.force_on_base(&wrench);
            for (sum, on_base) in force.base.iter_mut().zip(on_base) {
                *sum += on_base;
            }
            let on_arm = transpose_times(kinematics.arm_jacobian(), &wrench);
            for (sum, on_arm) in force.arm.iter_mut().zip(on_arm) {
                *sum += on_arm;
            }
        }
        force
    }

    fn arm_state(&self) -> ([f64; N], [f64; N]) {
        let of = |values: &[f64]| {
            let arm = &values[BASE..BASE + N];
            std::array::from_fn(|i| arm[i])
        };
        (of(&self.positions), of(&self.rates))
    }

    fn unstable(&self, warning: &'static str) -> SimError {
        SimError::Unstable { warning, time_s: self.time_s }
    }
}

fn usable(values: &[f64]) -> bool {
    // no early return: several at once
    values.iter().fold(true, |usable, value| usable & (value.abs() < LARGEST))
}

impl<const N: usize> Mechanics for Analytic<N> {
    fn time_s(&self) -> f64 {
        self.time_s
    }

    fn positions(&self) -> &[f64] {
        &self.positions
    }

    fn rates(&self) -> &[f64] {
        &self.rates
    }

    fn put(&mut self, first: usize, positions: &[f64], rates: &[f64]) {
        self.positions[first..first + positions.len()].copy_from_slice(positions);
        self.rates[first..first + rates.len()].copy_from_slice(rates);
    }

    fn drift(&mut self, dt_s: f64) {
        for (position, rate) in self.positions.iter_mut().zip(&self.rates) {
            *position += dt_s * rate;
        }
    }

    fn set_step_s(&mut self, step_s: f64) {
        self.step_s = step_s;
    }

    fn set_time_s(&mut self, time_s: f64) {
        self.time_s = time_s;
    }

    fn refresh(&mut self) {
        let (q, dq) = self.arm_state();
        let [x, y, yaw] = std::array::from_fn(|i| self.positions[i]);
        let base_rate: [f64; BASE] = std::array::from_fn(|i| self.rates[i]);
        self.dynamics.update(&self.model, (yaw, &q), (&base_rate, &dq));
        self.base_world = [x, y];
        self.bias[..BASE].copy_from_slice(&self.dynamics.base_bias);
        self.bias[BASE..BASE + N].copy_from_slice(&self.dynamics.arm.bias);
    }

    fn forces_mut(&mut self) -> &mut [f64] {
        &mut self.forces
    }

    fn set_damping(&mut self, first: usize, damping: &[f64]) {
        for (i, damping) in damping.iter().enumerate() {
            if let Some(joint) =
                (first + i).checked_sub(BASE).and_then(|joint| self.joint_damping.get_mut(joint))
            {
                *joint = *damping;
            }
        }
    }

    fn set_flange_wrench_world(&mut self, wrench: &[f64; 6]) {
        self.flange_wrench_world = *wrench;
    }

    fn step(&mut self) -> Result<(), SimError> {
        for (values, warning) in [(&self.positions, BAD_POSITION), (&self.rates, BAD_RATE)] {
            if !usable(values) {
                return Err(self.unstable(warning));
            }
        }
        self.refresh();
        let mut force = self.force();
        if let Some(limits) = &self.limits {
            let (q, dq) = self.arm_state();
            if let Some(torque) = limits.torque_nm(&self.dynamics, &force, &q, &dq) {
                for (sum, torque) in force.arm.iter_mut().zip(torque) {
                    *sum += torque;
                }
            }
        }
        let h = self.step_s;
        let (base, arm) = self
            .dynamics
            .acceleration(
                &force,
                (&self.damping.map(|damping| h * damping), &self.joint_damping.map(|damping| h * damping)),
            )
            .ok_or_else(|| self.unstable(SINGULAR))?;
        if !(usable(&base) && usable(&arm)) {
            return Err(self.unstable(BAD_ACCELERATION));
        }
        let (of_base, rest) = self.rates.split_at_mut(BASE);
        let (of_arm, people) = rest.split_at_mut(N);
        for (rates, accelerations) in [(of_base, &base[..]), (of_arm, &arm[..])] {
            for (rate, acceleration) in rates.iter_mut().zip(accelerations) {
                *rate += h * acceleration;
            }
        }
        for (i, mass_kg) in self.people_kg.iter().enumerate() {
            for axis in [2 * i, 2 * i + 1] {
                people[axis] += h * (self.forces[BASE + N + axis] / mass_kg);
            }
        }
        for (position, rate) in self.positions.iter_mut().zip(&self.rates) {
            *position += h * rate;
        }
        self.time_s += h;
        Ok(())
    }

    fn bias(&self) -> &[f64] {
        &self.bias
    }

    fn mass_matrix(&mut self) -> &[f64] {
        let n = self.positions.len();
        let CoupledDynamics { arm, base, .. } = &self.dynamics;
        for i in 0..BASE {
            for j in 0..BASE {
                self.mass[i * n + j] = base[(i, j)];
            }
            for j in 0..N {
                let coupled = arm.base_coupling[(j, i)];
                (self.mass[i * n + BASE + j], self.mass[(BASE + j) * n + i]) = (coupled, coupled);
            }
        }
        for i in 0..N {
            for j in 0..N {
                self.mass[(BASE + i) * n + BASE + j] = arm.mass[(i, j)];
            }
        }
        for (k, mass_kg) in self.people_kg.iter().enumerate() {
            for axis in 0..2 {
                let i = BASE + N + 2 * k + axis;
                self.mass[i * n + i] = *mass_kg;
            }
        }
        &self.mass
    }

    fn flange_pose(&self) -> Option<FlangePose> {
        let kinematics = &self.dynamics.arm.kinematics;
        let [x, y, z]: [f64; 3] = (kinematics.arm_from_base + kinematics.flange_position).into();
        let [_, _, _, roll, pitch, yaw] = self.parts.2.tool_origin;
        let axes = kinematics.tool_rotation * from_rpy([roll, pitch, yaw]).transpose();
        let axes_world = std::array::from_fn(|row| std::array::from_fn(|column| axes[(row, column)]));
        Some(FlangePose { position_world: [self.base_world[0] + x, self.base_world[1] + y, z], axes_world })
    }

    fn set_load(&mut self, load: &LinkInertial) -> Result<(), SimError> {
        let (arm, mount, payload) = &self.parts;
        self.model = ArmModel::new(arm, mount, &payload.with(load))
            .map_err(|error| SimError::Model(error.to_string()))?;
        Ok(())
    }

    fn size(&self) -> ModelSize {
        let heap = 4 * self.positions.len() + self.mass.len() + self.people_kg.len();
        ModelSize {
            dofs: self.positions.len(),
            bodies: 2 + N + 1 + self.people_kg.len(),
            geoms: 0,
            sensors: 0,
            model_bytes: size_of_val(&self.model) + size_of_val(&self.limits),
            data_bytes: size_of::<Self>() + 8 * heap,
            arena_bytes: 0,
            arena_used_bytes: 0,
        }
    }
}
