//! Every quantity of a reference file against the controller crate.
//!
//! The file carries its own arm, mount, base and cover in `meta`, and one set of inputs and results per configuration.

use crate::coupled::CoupledDynamics;
use crate::model::{ArmModel, Dynamics, Kinematics};
use crate::opspace::{ArmDynamics, AxisWeight, BlockWeight, TaskDynamics, WholeBodyForce};
use crate::{admittance, cover_wrench, follow_me, rotation};
use moca_msgs::robot::LinkInertial;
use moca_msgs::{ArmTable, BaseTable, Mount, Payload, TaxelPlacement};
use nalgebra::{Matrix3, Vector3};
use serde_json::Value;
use std::collections::BTreeMap;
use std::string::{String, ToString};
use std::{format, vec, vec::Vec};

/// Largest error that passes.
pub const TOLERANCE: f64 = 1e-11;

/// Returns true if an error is small enough; NaN is not.
///
/// ```
/// use moca_wbc::testing::reference_file::{TOLERANCE, passes};
///
/// assert!(passes(0.5 * TOLERANCE) && !passes(2.0 * TOLERANCE) && !passes(f64::NAN));
/// ```
pub fn passes(error: f64) -> bool {
    error <= TOLERANCE
}

/// Quantities that are given, not computed.
const INPUTS: [&str; 20] = [
    "q",
    "qd",
    "M_v",
    "eta_A",
    "eta_B",
    "F",
    "tau0",
    "H_diag_general",
    "F_taxel",
    "F_A_ext_at_EE",
    "R_d",
    "adm.v0",
    "adm.tau_v",
    "adm.D_v",
    "adm.dt",
    "case",
    "name",
    "note",
    "adm.M_v",
    "adm.note",
];

/// Largest error of each quantity over all configurations; `None` where nothing here computes it.
pub type Errors = BTreeMap<String, Option<f64>>;

/// A failure to read the file: where and what.
pub type Malformed = String;

/// Compares every quantity of `document` with this crate.
///
/// # Errors
/// What is missing or malformed in the file.
pub fn compare(document: &Value) -> Result<Errors, Malformed> {
    let meta = &document["meta"];
    match meta["joint_origin_xyz_rpy"].as_array().map(Vec::len) {
        Some(7) => compare_arm::<7>(document),
        Some(6) => compare_arm::<6>(document),
        other => Err(format!("meta.joint_origin_xyz_rpy has {other:?} joints, expected 6 or 7")),
    }
}

fn compare_arm<const N: usize>(document: &Value) -> Result<Errors, Malformed> {
    let robot = Robot::<N>::read(&document["meta"])?;
    let vectors = document["vectors"].as_array().ok_or("no list `vectors`")?;
    if vectors.is_empty() {
        return Err("the list `vectors` is empty".into());
    }
    let mut errors = Errors::new();
    for (index, vector) in vectors.iter().enumerate() {
        let computed = robot.compute(vector).map_err(|e| format!("vectors[{index}]: {e}"))?;
        for (name, reference) in flattened(vector) {
            if INPUTS.contains(&name.as_str()) {
                continue;
            }
            let error = match computed.get(name.as_str()) {
                Some(values) => {
                    Some(error(&name, values, &reference).map_err(|e| format!("vectors[{index}]: {e}"))?)
                }
                None => None,
            };
            let worst = errors.entry(name).or_insert(error);
            // a NaN must not be lost in a maximum
            *worst = match (*worst, error) {
                (Some(a), Some(b)) if a.is_nan() || b.is_nan() => Some(f64::NAN),
                (Some(a), Some(b)) => Some(a.max(b)),
                _ => None,
            };
        }
    }
    Ok(errors)
}

/// max|a − ref| / max(max|ref|, 1).
fn error(name: &str, values: &[f64], reference: &[f64]) -> Result<f64, Malformed> {
    if values.len() != reference.len() {
        return Err(format!("{name} has {} numbers, expected {}", reference.len(), values.len()));
    }
    // a quaternion and its negative are one rotation
    let sign = if name.starts_with("quat") && dot(values, reference) < 0.0 { -1.0 } else { 1.0 };
    let scale = reference.iter().fold(1.0_f64, |most, r| most.max(r.abs()));
    let mut worst = 0.0_f64;
    for (a, r) in values.iter().zip(reference) {
        let gap = (sign * a - r).abs() / scale;
        if gap.is_nan() {
            return Ok(f64::NAN);
        }
        worst = worst.max(gap);
    }
    Ok(worst)
}

fn dot(a: &[f64], b: &[f64]) -> f64 {
    a.iter().zip(b).map(|(a, b)| a * b).sum()
}

struct Robot<const N: usize> {
    model: ArmModel<N, f64>,
    base: BaseTable,
    covers: Vec<(String, Vec<TaxelPlacement>)>,
}

struct Inputs<const N: usize> {
    base: [f64; 3],
    q: [f64; N],
    base_rate: [f64; 3],
    dq: [f64; N],
    wrench: [f64; 6],
    null: WholeBodyForce<N, f64>,
}

type Computed = BTreeMap<&'static str, Vec<f64>>;

impl<const N: usize> Robot<N> {
    fn read(meta: &Value) -> Result<Self, Malformed> {
        let mut arm = ArmTable::<N> {
            joint_origin: [[0.0; 6]; N],
            flange_origin: [0.0; 6],
            links: [Payload::NONE.inertial; N],
            link0: inertial(&meta["link0"], "I").unwrap_or(Payload::NONE.inertial),
            q_min_rad: [-7.0; N],
            q_max_rad: [7.0; N],
            dq_max_rad_s: [0.0; N],
            speed_envelope: None,
            torque_max_nm: [0.0; N],
            home_rad: [0.0; N],
            posture_stiffness_nm_rad: [0.0; N],
            posture_damping_nm_s_rad: [0.0; N],
        };
        for i in 0..N {
            arm.joint_origin[i] = array(&meta["joint_origin_xyz_rpy"][i], "joint_origin_xyz_rpy")?;
            arm.links[i] = inertial(&meta["panda_inertials"][i], "I_com_xx_xy_xz_yy_yz_zz")?;
        }
        let flange: [f64; 3] = array(&meta["flange_xyz"], "flange_xyz")?;
        arm.flange_origin[..3].copy_from_slice(&flange);
        let mount = Mount { position_base_m: array(&meta["r_BA"], "r_BA")?, rpy_rad: [0.0; 3] };
        let base = &meta["base"];
        let mut covers = Vec::new();
        for (name, table) in meta["taxels"].as_object().into_iter().flatten() {
            covers.push((name.clone(), taxels(table)?));
        }
        Ok(Self {
            model: ArmModel::new(&arm, &mount, &Payload::NONE).map_err(|e| e.to_string())?,
            base: BaseTable {
                mass_kg: number(&base["mass"], "base.mass")?,
                com_m: array(&base["com"], "base.com")?,
                inertia_com_diagonal: array(&base["I_com_diag"], "base.I_com_diag")?,
                ..moca_msgs::robot::SUMMIT_XL
            },
            covers,
        })
    }

    fn compute(&self, vector: &Value) -> Result<Computed, Malformed> {
        let (base, q) = split::<N>(vector, "q")?;
        let (base_rate, dq) = split::<N>(vector, "qd")?;
        let (null_base, null_arm) = split::<N>(vector, "tau0")?;
        let null = WholeBodyForce { base: null_base, arm: null_arm };
        let inputs = Inputs { base, q, base_rate, dq, wrench: array(&vector["F"], "F")?, null };
        let dynamics = self.model.dynamics(base[2], &q, &dq);
        let kinematics = &dynamics.kinematics;
        let mut out = Computed::new();
        self.kinematics(&inputs, kinematics, &mut out);
        self.dynamics(&inputs, &dynamics, &mut out);
        self.torques(vector, &inputs, &dynamics, &mut out)?;
        self.in_arm_axes(vector, &inputs, &mut out)?;
        self.cover(vector, &mut out)?;
        orientation(vector, kinematics, &mut out)?;
        admitted(vector, &mut out)?;
        Ok(out)
    }

    fn kinematics(&self, inputs: &Inputs<N>, kinematics: &Kinematics<N, f64>, out: &mut Computed) {
        let [x, y, _] = inputs.base;
        let tool = kinematics.tool_from_base() + Vector3::new(x, y, 0.0);
        out.insert("p_ee", tool.as_slice().to_vec());
        out.insert("R_ee", transposed(kinematics.tool_rotation.as_slice(), 3));
        out.insert("quat_ee_xyzw", rotation::to_quaternion(&kinematics.tool_rotation).to_vec());
        let columns = [kinematics.base_jacobian().as_slice(), kinematics.arm_jacobian().as_slice()].concat();
        out.insert("J", transposed(&columns, 6));
        let rate = kinematics.jacobian_rate_times_velocity(&inputs.base_rate, &inputs.dq);
        out.insert("Jdot_qd", rate.to_vec());
    }

    fn dynamics(&self, inputs: &Inputs<N>, dynamics: &Dynamics<N, f64>, out: &mut Computed) {
        let gravity = dynamics.gravity();
        out.insert("M_A", dynamics.mass.as_slice().to_vec());
        out.insert("coriolis_A", dynamics.bias.iter().zip(gravity).map(|(all, g)| all - g).collect());
        out.insert("gravity_A", gravity.to_vec());
        out.insert("nle_A", dynamics.bias.to_vec());
        let plant = CoupledDynamics::new(
            &self.model,
            &self.base,
            (inputs.base[2], &inputs.q),
            (&inputs.base_rate, &inputs.dq),
        );
        let mut full = Vec::with_capacity((N + 3) * (N + 3));
        for i in 0..3 {
            full.extend((0..3).map(|j| plant.base[(i, j)]));
            full.extend((0..N).map(|j| plant.arm.base_coupling[(j, i)]));
        }
        for i in 0..N {
            full.extend((0..3).map(|j| plant.arm.base_coupling[(i, j)]));
            full.extend((0..N).map(|j| plant.arm.mass[(i, j)]));
        }
        out.insert("M_full", full);
        out.insert("bias_full", [&plant.base_bias[..], &plant.arm.bias].concat());
    }

    /// eqs. (6)–(9), with the identities that every weight must keep.
    fn torques(
        &self,
        vector: &Value,
        inputs: &Inputs<N>,
        dynamics: &Dynamics<N, f64>,
        out: &mut Computed,
    ) -> Result<(), Malformed> {
        let arm = ArmDynamics::new(dynamics).map_err(|e| e.to_string())?;
        let task = TaskDynamics::new(array(&vector["M_v"], "M_v")?, &arm);
        let (eta_base, eta_arm) = (number(&vector["eta_B"], "eta_B")?, number(&vector["eta_A"], "eta_A")?);
        let (weight_base, weight_arm) = split::<N>(vector, "H_diag_general")?;
        let block = |wrench: &[f64; 6], null: &WholeBodyForce<N, f64>, eta: f64| {
            let weighted = BlockWeight::new(eta, eta_arm).factor(&task)?;
            Ok::<_, crate::ControlError>(weighted.force(wrench, null))
        };
        let general = AxisWeight::new(weight_base, weight_arm).map_err(|e| e.to_string())?;
        let law = |which: usize, wrench: &[f64; 6], null: &WholeBodyForce<N, f64>| {
            match which {
                0 => block(wrench, null, eta_base),
                1 => general.force(&task, wrench, null),
                _ => block(wrench, null, eta_arm),
            }
            .map_err(|e| e.to_string())
        };
        let (mut missed, mut leaked) = (Vec::new(), Vec::new());
        for (which, name) in ["tau_c", "tau_c_general_H", "tau_c_H_identity"].into_iter().enumerate() {
            let force = law(which, &inputs.wrench, &inputs.null)?;
            out.insert(name, joined(&force));
            let achieved = task.wrench(&force).map_err(|e| e.to_string())?;
            missed.push(largest_gap(&achieved, &inputs.wrench));
            let null_only = law(which, &[0.0; 6], &inputs.null)?;
            leaked.push(largest_gap(&task.acceleration(&null_only), &[0.0; 6]));
        }
        out.insert("resid_JbarT_tau_minus_F", missed);
        out.insert("resid_null_accel", leaked);
        Ok(())
    }

    /// eqs. (12)–(15): what the file gives in the axes of the arm base.
    fn in_arm_axes(&self, vector: &Value, inputs: &Inputs<N>, out: &mut Computed) -> Result<(), Malformed> {
        let (rotation, position) = self.model.mount();
        // with the base turned back by the mount's yaw, world axes are those of A
        let yaw = -rotation[(1, 0)].atan2(rotation[(0, 0)]);
        let dynamics = self.model.dynamics(yaw, &inputs.q, &inputs.dq);
        let kinematics = &dynamics.kinematics;
        out.insert("J_A", transposed(kinematics.arm_jacobian().as_slice(), 6));
        out.insert("p_ee_A", kinematics.tool_position.as_slice().to_vec());
        let arm = ArmDynamics::new(&dynamics).map_err(|e| e.to_string())?;
        let torque = arm.torque(&inputs.wrench, &inputs.null.arm).map_err(|e| e.to_string())?;
        out.insert("tau_A_eq15", torque.to_vec());
        let external: [f64; 6] = array(&vector["F_A_ext_at_EE"], "F_A_ext_at_EE")?;
        let paper = self.cover_sum(vector, "paper")?;
        let about_arm = follow_me::moved(&external, &kinematics.tool_position);
        for (name, wrench) in
            [("tau_v_ext_eq12_literal_point", external), ("tau_v_ext_eq12_moved_to_A", about_arm)]
        {
            let led = follow_me::base_wrench(rotation, position, &wrench);
            out.insert(name, paper.iter().zip(led).map(|(a, b)| a + b).collect());
        }
        Ok(())
    }

    fn cover(&self, vector: &Value, out: &mut Computed) -> Result<(), Malformed> {
        out.insert("tau_v_ext_paper", self.cover_sum(vector, "paper")?);
        out.insert("tau_v_ext_ring", self.cover_sum(vector, "ring")?);
        Ok(())
    }

    fn cover_sum(&self, vector: &Value, cover: &str) -> Result<Vec<f64>, Malformed> {
        let (_, taxels) = self
            .covers
            .iter()
            .find(|(name, _)| name == cover)
            .ok_or(format!("no cover `{cover}` in meta.taxels"))?;
        let forces = numbers(&vector["F_taxel"], "F_taxel")?;
        if forces.len() != taxels.len() {
            return Err(format!("F_taxel has {} numbers for {} taxels", forces.len(), taxels.len()));
        }
        let mut sum = vec![0.0; 3];
        for (taxel, force) in taxels.iter().zip(forces) {
            let wrench = cover_wrench(&[*taxel], &[force]);
            sum.iter_mut().zip(wrench).for_each(|(sum, one)| *sum += one);
        }
        Ok(sum)
    }
}

fn orientation<const N: usize>(
    vector: &Value,
    kinematics: &Kinematics<N, f64>,
    out: &mut Computed,
) -> Result<(), Malformed> {
    let desired = numbers(&vector["R_d"], "R_d")?;
    if desired.len() != 9 {
        return Err(format!("R_d has {} numbers, expected 9", desired.len()));
    }
    let desired = Matrix3::from_row_slice(&desired);
    out.insert("e_o_world_log", rotation::error(&kinematics.tool_rotation, &desired).as_slice().to_vec());
    out.insert("quat_d_xyzw", rotation::to_quaternion(&desired).to_vec());
    Ok(())
}

/// Velocity after `dt_s` under a force that is held, damping taken at the step's start.
pub fn explicit_euler(velocity: f64, force: f64, mass: f64, damping: f64, dt_s: f64) -> f64 {
    velocity + dt_s / mass * (force - damping * velocity)
}

/// Takes a step with the damping at the step's end.
pub fn implicit_euler(velocity: f64, force: f64, mass: f64, damping: f64, dt_s: f64) -> f64 {
    (velocity + dt_s / mass * force) / (1.0 + dt_s * damping / mass)
}

fn admitted(vector: &Value, out: &mut Computed) -> Result<(), Malformed> {
    let given = &vector["adm"];
    let dt = number(&given["dt"], "adm.dt")?;
    let mass: [f64; 3] = array(&vector["M_v"], "M_v")?;
    let damping: [f64; 3] = array(&given["D_v"], "adm.D_v")?;
    let velocity: [f64; 3] = array(&given["v0"], "adm.v0")?;
    let force: [f64; 3] = array(&given["tau_v"], "adm.tau_v")?;
    let after = |step: fn(f64, f64, f64, f64, f64) -> f64| {
        (0..3).map(|i| step(velocity[i], force[i], mass[i], damping[i], dt)).collect()
    };
    out.insert("adm.v1_exact", after(admittance::step));
    // What the work-precision diagrams compare it with.
    out.insert("adm.v1_euler", after(explicit_euler));
    out.insert("adm.v1_semi", after(implicit_euler));
    Ok(())
}

fn joined<const N: usize>(force: &WholeBodyForce<N, f64>) -> Vec<f64> {
    force.base.iter().chain(&force.arm).copied().collect()
}

fn largest_gap(a: &[f64; 6], b: &[f64; 6]) -> f64 {
    // f64::max would drop a NaN
    a.iter().zip(b).fold(0.0, |most, (a, b)| if (a - b).abs() <= most { most } else { (a - b).abs() })
}

/// Column-major numbers with `rows` rows, row by row.
fn transposed(columns: &[f64], rows: usize) -> Vec<f64> {
    (0..rows).flat_map(|row| columns.iter().skip(row).step_by(rows).copied()).collect()
}

/// Every leaf of one configuration, nested lists flattened row by row, nested objects with a dot.
fn flattened(vector: &Value) -> Vec<(String, Vec<f64>)> {
    let mut out = Vec::new();
    for (name, value) in vector.as_object().into_iter().flatten() {
        if value.is_object() {
            out.extend(
                flattened(value).into_iter().map(|(inner, values)| (format!("{name}.{inner}"), values)),
            );
        } else if let Ok(values) = numbers(value, name) {
            out.push((name.clone(), values));
        }
    }
    out
}

fn numbers(value: &Value, name: &str) -> Result<Vec<f64>, Malformed> {
    match value {
        Value::Array(items) => {
            let mut out = Vec::new();
            for item in items {
                out.extend(numbers(item, name)?);
            }
            Ok(out)
        }
        Value::Number(_) => Ok(vec![number(value, name)?]),
        _ => Err(format!("{name} is not a number or a list of numbers")),
    }
}

fn number(value: &Value, name: &str) -> Result<f64, Malformed> {
    value.as_f64().ok_or_else(|| format!("{name} is not a number"))
}

fn array<const D: usize>(value: &Value, name: &str) -> Result<[f64; D], Malformed> {
    let values = numbers(value, name)?;
    let count = values.len();
    values.try_into().map_err(|_| format!("{name} has {count} numbers, expected {D}"))
}

fn split<const N: usize>(vector: &Value, name: &str) -> Result<([f64; 3], [f64; N]), Malformed> {
    let values = numbers(&vector[name], name)?;
    match values.split_first_chunk::<3>() {
        Some((base, arm)) if arm.len() == N => {
            let mut joints = [0.0; N];
            joints.copy_from_slice(arm);
            Ok((*base, joints))
        }
        _ => Err(format!("{name} has {} numbers, expected {}", values.len(), N + 3)),
    }
}

fn inertial(value: &Value, inertia: &str) -> Result<LinkInertial, Malformed> {
    Ok(LinkInertial {
        mass_kg: number(&value["mass"], "mass")?,
        com_m: array(&value["com"], "com")?,
        inertia_com: array(&value[inertia], inertia)?,
    })
}

fn taxels(table: &Value) -> Result<Vec<TaxelPlacement>, Malformed> {
    let angles = numbers(&table["phi"], "taxels.phi")?;
    angles
        .into_iter()
        .enumerate()
        .map(|(i, inward_angle_base_rad)| {
            Ok(TaxelPlacement { position_base_m: array(&table["r"][i], "taxels.r")?, inward_angle_base_rad })
        })
        .collect()
}
