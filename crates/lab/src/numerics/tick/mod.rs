//! `moca-lab tick --anchor DIR`: the whole-body tick on the data of an independent implementation, checked and timed.
//!
//! DIR holds model.csv, params.csv, inputs.csv and ref.csv as `tests/peers/pinocchio/generate.py` writes them. One tick: state →
//! kinematics, Jacobian, mass matrix, bias, task force, eq. (6), torques. The pose error is part of the anchor's law:
//! e = \[p_d − p; ½ Σ R_k × R_dk\].

mod data;

use crate::rig::JOINTS;
use data::{Anchor, Input};
use moca_wbc::ControlError;
use moca_wbc::linalg::times;
use moca_wbc::model::ArmModel;
use moca_wbc::opspace::{ArmDynamics, AxisWeight, BlockWeight, TaskDynamics, WholeBodyForce};
use nalgebra::{Matrix3, Vector3};
use serde::Serialize;
use std::hint::black_box;
use std::path::PathBuf;
use std::time::Instant;

/// Largest relative error that passes.
const TOLERANCE: f64 = 1e-9;
/// Timed passes over all inputs.
const PASSES: usize = 400;

/// Times the control tick against the data of an independent implementation.
#[derive(clap::Args)]
pub(crate) struct Arguments {
    /// Folder with model.csv, params.csv, inputs.csv and ref.csv.
    #[arg(long)]
    anchor: PathBuf,
    /// One JSON object instead of a table.
    #[arg(long)]
    json: bool,
}

#[derive(Serialize)]
struct Report {
    variants: Vec<Variant>,
}

#[derive(Serialize)]
struct Variant {
    name: &'static str,
    ns_least: f64,
    ns_median: f64,
    max_rel_error: f64,
}

/// Errs if a tick is off by more than [`TOLERANCE`].
#[expect(clippy::print_stdout, reason = "the answer of a command")]
pub(crate) fn run(arguments: &Arguments) -> anyhow::Result<()> {
    let anchor = Anchor::read(&arguments.anchor)?;
    let ticker = Ticker::new(&anchor)?;
    let mut variants = vec![measured("general-h", &ticker, &anchor, Ticker::general)?];
    // through the block form any other H would be wrong by a factor
    if anchor.block().is_some() {
        variants.push(measured("block-h", &ticker, &anchor, Ticker::block)?);
    }
    let report = Report { variants };
    if arguments.json {
        println!("{}", serde_json::to_string(&report)?);
    } else {
        println!("{:16} {:>10} {:>10} {:>14}", "tick", "ns least", "ns median", "max rel. error");
        for Variant { name, ns_least, ns_median, max_rel_error } in &report.variants {
            println!("{name:16} {ns_least:10.0} {ns_median:10.0} {max_rel_error:14.1e}");
        }
    }
    for Variant { name, max_rel_error, .. } in &report.variants {
        let passes = *max_rel_error <= TOLERANCE;
        anyhow::ensure!(passes, "{name} is off by {max_rel_error:.1e}, more than {TOLERANCE:.0e}");
    }
    Ok(())
}

fn measured(
    name: &'static str,
    ticker: &Ticker,
    anchor: &Anchor,
    tick: impl Fn(&Ticker, &Input) -> Result<WholeBodyForce<JOINTS, f64>, ControlError>,
) -> anyhow::Result<Variant> {
    let mut max_rel_error = 0.0_f64;
    for (input, reference) in anchor.inputs.iter().zip(&anchor.references) {
        let error = relative_error(&tick(ticker, input)?, reference);
        // f64::max would drop a NaN
        max_rel_error = if error <= max_rel_error { max_rel_error } else { error };
    }
    let mut passes = Vec::with_capacity(PASSES);
    for _ in 0..PASSES {
        let start = Instant::now();
        for input in &anchor.inputs {
            black_box(tick(black_box(ticker), black_box(input))?);
        }
        passes.push(start.elapsed().as_secs_f64() * 1e9 / data::count(anchor.inputs.len()));
    }
    passes.sort_by(f64::total_cmp);
    Ok(Variant { name, ns_least: passes[0], ns_median: passes[PASSES / 2], max_rel_error })
}

/// max|τ − ref| / max|ref| of one row.
fn relative_error(force: &WholeBodyForce<JOINTS, f64>, reference: &[f64; 10]) -> f64 {
    let scale = reference.iter().fold(0.0_f64, |most, r| most.max(r.abs()));
    let mut worst = 0.0;
    for (value, reference) in force.base.iter().chain(&force.arm).zip(reference) {
        let error = (value - reference).abs() / scale;
        worst = if error <= worst { worst } else { error };
    }
    worst
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
    fn block(&self, input: &Input) -> Result<WholeBodyForce<JOINTS, f64>, ControlError> {
        self.tick(input, |task, wrench, null| Ok(self.block.factor(task)?.force(wrench, null)))
    }

    #[inline]
    fn general(&self, input: &Input) -> Result<WholeBodyForce<JOINTS, f64>, ControlError> {
        self.tick(input, |task, wrench, null| self.general.force(task, wrench, null))
    }

    #[inline]
    fn tick(
        &self,
        input: &Input,
        law: impl Fn(
            &TaskDynamics<'_, 7, f64>,
            &[f64; 6],
            &WholeBodyForce<JOINTS, f64>,
        ) -> Result<WholeBodyForce<JOINTS, f64>, ControlError>,
    ) -> Result<WholeBodyForce<JOINTS, f64>, ControlError> {
        let kinematics = self.model.kinematics(input.base_pose[2], &input.q);
        let inertias = self.model.link_inertias(&kinematics);
        let (base, arm) = (kinematics.base_jacobian(), kinematics.arm_jacobian());
        let tool = kinematics.tool_from_base() + Vector3::new(input.base_pose[0], input.base_pose[1], 0.0);
        let error =
            pose_error(&(input.desired_position - tool), &kinematics.tool_rotation, &input.desired_rotation);
        let (of_base, of_arm) = (times(&base, &input.base_rate), times(&arm, &input.dq));
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
        let mass = kinematics.mass_matrix(&inertias).arm;
        let arm = ArmDynamics::new(arm, &mass)?;
        let task = TaskDynamics::new(base, self.virtual_mass, &arm);
        let mut force = law(&task, &wrench, &null)?;
        let bias = kinematics.bias(&inertias, &input.dq);
        force.arm.iter_mut().zip(bias).for_each(|(torque, bias)| *torque += bias);
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
