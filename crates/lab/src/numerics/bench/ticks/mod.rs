//! Whole-body tick on the data of an independent implementation, in turns with others' ticks on the same data.
//!
//! The folder holds model.csv, params.csv, inputs.csv and ref.csv as `tests/peers/pinocchio/generate.py` writes them, and the
//! program `tick` of the others. One such tick: state → kinematics, Jacobian, mass matrix, bias, task force, eq. (6), torques.
//! The pose error is part of the data's law: e = \[p_d − p; ½ Σ R_k × R_dk\].

mod data;

use super::{Found, Row, larger};
use anyhow::{Context as _, Result, ensure};
use data::{Anchor, Input};
use moca_experiments::{JOINTS, count};
use moca_wbc::ControlError;
use moca_wbc::linalg::times;
use moca_wbc::model::{ArmModel, Dynamics};
use moca_wbc::opspace::{ArmDynamics, AxisWeight, BlockWeight, TaskDynamics, WholeBodyForce};
use nalgebra::{Matrix3, Vector3};
use serde::Deserialize;
use std::hint::black_box;
use std::path::Path;
use std::process::Command;
use std::time::Instant;

/// Largest relative error of a torque.
const TOLERANCE: f64 = 1e-9;
/// Passes over all inputs in a turn.
const PASSES: usize = 20;
/// Peers of this part and the command that installs and builds them.
pub(super) const MISSING: &str =
    "Pinocchio, CasADi and CppADCodeGen: `tests/peers/pinocchio/time target/anchor` installs and builds them";

/// Time of another implementation's tick, as its program prints it.
#[derive(Deserialize)]
struct Peer {
    name: String,
    ns_median: f64,
    rel_error: f64,
}

/// Rows of our tick next to each peer's, or the name of what is missing in `folder`.
pub(super) fn found(folder: &Path, turns: usize) -> Result<Found> {
    let program = folder.join("tick");
    if !program.exists() {
        return Ok(Found { missing: vec![MISSING], ..Found::default() });
    }
    let anchor = Anchor::read(folder)?;
    let ticker = Ticker::new(&anchor)?;
    let mut rows: Vec<Row> = Vec::new();
    for _ in 0..turns {
        let ours = [passes(&ticker, &anchor, Ticker::general)?, passes(&ticker, &anchor, Ticker::block)?];
        for (i, peer) in peers(&program, folder)?.into_iter().enumerate() {
            let (law, tick) =
                if peer.name.ends_with("general-h") { ("any H", &ours[0]) } else { ("block H", &ours[1]) };
            if rows.len() == i {
                let what = format!("our whole-body tick, {law}");
                rows.push(Row::new(what, peer.name, "of the largest torque", TOLERANCE));
            }
            rows[i].ratios.push(peer.ns_median / tick.ns_median);
            rows[i].raise_error(tick.rel_error);
            rows[i].raise_error(peer.rel_error);
        }
    }
    Ok(Found { rows, ..Found::default() })
}

fn peers(program: &Path, folder: &Path) -> Result<Vec<Peer>> {
    let done = Command::new(program).arg(folder).arg(PASSES.to_string()).output()?;
    ensure!(done.status.success(), "{}: {}", program.display(), String::from_utf8_lossy(&done.stderr));
    let text = String::from_utf8(done.stdout)?;
    text.lines()
        .map(|line| {
            serde_json::from_str(line).with_context(|| format!("{} printed {line}", program.display()))
        })
        .collect()
}

/// Time and largest relative error of our own tick.
struct Own {
    ns_median: f64,
    rel_error: f64,
}

fn passes(
    ticker: &Ticker,
    anchor: &Anchor,
    tick: impl Fn(
        &Ticker,
        &mut Dynamics<JOINTS, f64>,
        &Input,
    ) -> Result<WholeBodyForce<JOINTS, f64>, ControlError>,
) -> Result<Own> {
    let mut room = Dynamics::unset();
    let mut rel_error = 0.0_f64;
    for (input, reference) in anchor.inputs.iter().zip(&anchor.references) {
        rel_error = larger(rel_error, relative_error(&tick(ticker, &mut room, input)?, reference));
    }
    let mut ns = Vec::with_capacity(PASSES);
    for _ in 0..PASSES {
        let start = Instant::now();
        for input in &anchor.inputs {
            black_box(tick(black_box(ticker), black_box(&mut room), black_box(input))?);
        }
        ns.push(start.elapsed().as_secs_f64() * 1e9 / count(anchor.inputs.len()));
    }
    ns.sort_by(f64::total_cmp);
    Ok(Own { ns_median: ns[PASSES / 2], rel_error })
}

/// max|τ − ref| / max|ref| of one row.
fn relative_error(force: &WholeBodyForce<JOINTS, f64>, reference: &[f64; 10]) -> f64 {
    let scale = reference.iter().fold(0.0_f64, |most, r| most.max(r.abs()));
    let values = force.base.iter().chain(&force.arm).zip(reference);
    values.fold(0.0, |worst, (value, reference)| larger(worst, (value - reference).abs() / scale))
}

/// The anchor's model and parameters.
struct Ticker {
    model: ArmModel<JOINTS, f64>,
    virtual_mass: [f64; 3],
    block: BlockWeight<f64>,
    general: AxisWeight<JOINTS, f64>,
    stiffness: [f64; 6],
    damping: [f64; 6],
    posture_stiffness: [f64; JOINTS],
    posture_damping: [f64; JOINTS],
    posture: [f64; JOINTS],
}

impl Ticker {
    fn new(anchor: &Anchor) -> anyhow::Result<Self> {
        let (eta_base, eta_arm) = anchor.block().unwrap_or((1.0, 1.0));
        Ok(Self {
            model: ArmModel::new(&anchor.arm, &anchor.mount, &moca_msgs::Payload::NONE)?,
            virtual_mass: anchor.virtual_mass,
            block: BlockWeight::new(eta_base, eta_arm),
            general: AxisWeight::new(anchor.weight_base, anchor.weight_arm)?,
            stiffness: anchor.stiffness,
            damping: anchor.damping,
            posture_stiffness: anchor.posture_stiffness,
            posture_damping: anchor.posture_damping,
            posture: anchor.posture,
        })
    }

    #[inline]
    fn block(
        &self,
        room: &mut Dynamics<JOINTS, f64>,
        input: &Input,
    ) -> Result<WholeBodyForce<JOINTS, f64>, ControlError> {
        self.tick(room, input, |task, wrench, null| {
            let mut weighted = self.block.of(task);
            weighted.factorise()?;
            Ok(weighted.force(wrench, null))
        })
    }

    #[inline]
    fn general(
        &self,
        room: &mut Dynamics<JOINTS, f64>,
        input: &Input,
    ) -> Result<WholeBodyForce<JOINTS, f64>, ControlError> {
        self.tick(room, input, |task, wrench, null| self.general.force(task, wrench, null))
    }

    #[inline]
    fn tick(
        &self,
        dynamics: &mut Dynamics<JOINTS, f64>,
        input: &Input,
        law: impl Fn(
            &TaskDynamics<'_, JOINTS, f64>,
            &[f64; 6],
            &WholeBodyForce<JOINTS, f64>,
        ) -> Result<WholeBodyForce<JOINTS, f64>, ControlError>,
    ) -> Result<WholeBodyForce<JOINTS, f64>, ControlError> {
        self.model.dynamics_at(input.base_pose[2], &input.q, &input.dq, dynamics);
        let (dynamics, kinematics) = (&*dynamics, &dynamics.kinematics);
        let tool = kinematics.tool_from_base() + Vector3::new(input.base_pose[0], input.base_pose[1], 0.0);
        let error =
            pose_error(&(input.desired_position - tool), &kinematics.tool_rotation, &input.desired_rotation);
        let of_base = kinematics.twist_from_base(&input.base_rate);
        let of_arm = times(kinematics.arm_jacobian(), &input.dq);
        let wrench = core::array::from_fn(|i| {
            self.damping[i] * (input.twist[i] - of_base[i] - of_arm[i]) + self.stiffness[i] * error[i]
        });
        let posture = moca_wbc::impedance::posture_torque(
            &self.posture_stiffness,
            &self.posture_damping,
            &self.posture,
            &input.q,
            &input.dq,
        );
        let null = WholeBodyForce { base: input.cover, arm: posture };
        let mut arm = ArmDynamics::unset(dynamics);
        arm.factorise()?;
        let task = TaskDynamics::new(self.virtual_mass, &arm);
        let mut force = law(&task, &wrench, &null)?;
        force.arm.iter_mut().zip(dynamics.bias).for_each(|(torque, bias)| *torque += bias);
        Ok(force)
    }
}

#[inline]
fn pose_error(linear: &Vector3<f64>, actual: &Matrix3<f64>, desired: &Matrix3<f64>) -> [f64; 6] {
    let mut angular = Vector3::zeros();
    for k in 0..3 {
        angular += actual.column(k).cross(&desired.column(k));
    }
    let angular = angular * 0.5;
    [linear.x, linear.y, linear.z, angular.x, angular.y, angular.z]
}
