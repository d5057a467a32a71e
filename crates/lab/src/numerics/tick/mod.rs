//! `moca-lab tick`: what a control step costs, hot, cold and live, and beside others.
//!
//! A loop of 1 kHz runs cold: between two steps the rest of the system has the caches. So a step is timed twice, one after
//! the other and with [`REPLACED_BYTES`] written in between, and what it needs of any machine is counted where valgrind is
//! installed: instructions, bytes of code and data. `--live S` runs the daemon's loop with the simulated robot and says
//! what its control stage took.
//!
//! `--anchor DIR` adds the whole-body tick on the data of an independent implementation, checked and timed. DIR holds
//! model.csv, params.csv, inputs.csv and ref.csv as `tests/peers/pinocchio/generate.py` writes them. One such tick: state →
//! kinematics, Jacobian, mass matrix, bias, task force, eq. (6), torques. The pose error is part of the anchor's law:
//! e = \[p_d − p; ½ Σ R_k × R_dk\]. `--peer COMMAND` puts others' ticks into the same table in the same run: the command
//! prints a JSON object a line, with `name`, `ns_min` and `ns_median`.

mod data;
mod steps;

use crate::study::{self, Answer, Column};
use anyhow::Context as _;
use data::{Anchor, Input};
use moca_experiments::{JOINTS, count};
use moca_wbc::ControlError;
use moca_wbc::linalg::times;
use moca_wbc::model::ArmModel;
use moca_wbc::opspace::{ArmDynamics, AxisWeight, BlockWeight, TaskDynamics, WholeBodyForce};
use nalgebra::{Matrix3, Vector3};
use serde::{Deserialize, Serialize};
use std::fmt::Write as _;
use std::hint::black_box;
use std::path::PathBuf;
use std::time::Instant;

/// Largest relative error that passes.
const TOLERANCE: f64 = 1e-9;
/// Timed passes over all inputs.
const PASSES: usize = 400;
/// Written between two cold steps: more than a core's own caches hold.
pub(crate) const REPLACED_BYTES: usize = 8 << 20;

/// Writes the limits of `.ci/size` as a table for the documents.
pub(crate) fn markdown() -> anyhow::Result<String> {
    let mut table =
        String::from("\n| step | instructions | code, bytes | data, bytes |\n|---|---|---|---|\n");
    for row in include_str!("../../../../../.ci/size.tsv").lines().skip(1) {
        let [case, instructions, code, _, data] = row.split('\t').collect::<Vec<_>>()[..] else {
            anyhow::bail!("{row}: no case with four numbers")
        };
        writeln!(table, "| {case} | {instructions} | {code} | {data} |")?;
    }
    Ok(table)
}

/// Prints the cost of a control step: hot, cold and live; with `--anchor` on the data of an independent implementation.
#[derive(clap::Args)]
pub(crate) struct Arguments {
    /// Folder with model.csv, params.csv, inputs.csv and ref.csv.
    #[arg(long)]
    anchor: Option<PathBuf>,
    /// A command that times others' ticks and prints a JSON object for each, with name, ns_min and ns_median.
    #[arg(long, value_name = "COMMAND", requires = "anchor")]
    peer: Vec<String>,
    /// Runs the live loop for so many seconds, 2 to 600.
    #[arg(long, value_name = "SECONDS")]
    live: Option<f64>,
    #[command(flatten)]
    answer: Answer,
    /// Only runs the steps of one case, for a program that watches.
    #[arg(long, hide = true)]
    marked: Option<String>,
}

#[derive(Serialize)]
struct Report {
    steps: Vec<steps::Row>,
    live: Option<steps::Live>,
    variants: Vec<Variant>,
    peers: Vec<Peer>,
}

#[derive(Serialize)]
struct Variant {
    name: &'static str,
    ns_least: f64,
    ns_median: f64,
    max_rel_error: f64,
}

/// Times of another implementation's tick, as its command prints them.
#[derive(Serialize, Deserialize)]
struct Peer {
    name: String,
    ns_min: f64,
    ns_median: f64,
}

/// Name of a tick, its least and median time, ns, and its largest relative error if it was checked.
type Tick = (String, f64, f64, Option<f64>);

const TICKS: &[Column<Tick>] = &[
    ("tick", |(name, ..)| name.clone()),
    ("ns least", |(_, least, ..)| format!("{least:.0}")),
    ("ns median", |(_, _, median, _)| format!("{median:.0}")),
    ("max rel. error", |(.., error)| error.map_or_else(String::new, |error| format!("{error:.1e}"))),
];

impl Report {
    fn ticks(&self) -> Vec<Tick> {
        let ours = |v: &Variant| (v.name.to_owned(), v.ns_least, v.ns_median, Some(v.max_rel_error));
        let theirs = |peer: &Peer| (peer.name.clone(), peer.ns_min, peer.ns_median, None);
        self.variants.iter().map(ours).chain(self.peers.iter().map(theirs)).collect()
    }
}

/// Errs if a tick is off by more than [`TOLERANCE`].
pub(crate) fn run(arguments: &Arguments) -> anyhow::Result<()> {
    if let Some(case) = &arguments.marked {
        return steps::marked(case);
    }
    let mut report =
        Report { steps: steps::measured()?, live: None, variants: Vec::new(), peers: Vec::new() };
    if let Some(folder) = &arguments.anchor {
        let anchor = Anchor::read(folder)?;
        let ticker = Ticker::new(&anchor)?;
        report.variants.push(measured("general-h", &ticker, &anchor, Ticker::general)?);
        // through the block form any other H would be wrong by a factor
        if anchor.block().is_some() {
            report.variants.push(measured("block-h", &ticker, &anchor, Ticker::block)?);
        }
        for command in &arguments.peer {
            report.peers.extend(peers(command)?);
        }
    }
    if let Some(seconds) = arguments.live {
        report.live = Some(steps::live(seconds)?);
    }
    arguments.answer.print(&report, || {
        let mut text = steps::table(&report.steps, report.live.as_ref());
        if arguments.anchor.is_some() {
            text += &format!("\n{}", study::table(TICKS, &report.ticks()));
        }
        Ok(text)
    })?;
    for Variant { name, max_rel_error, .. } in &report.variants {
        let passes = *max_rel_error <= TOLERANCE;
        anyhow::ensure!(passes, "{name} is off by {max_rel_error:.1e}, more than {TOLERANCE:.0e}");
    }
    Ok(())
}

fn peers(command: &str) -> anyhow::Result<Vec<Peer>> {
    let done = std::process::Command::new("sh").args(["-c", command]).output()?;
    anyhow::ensure!(done.status.success(), "{command}: {}", String::from_utf8_lossy(&done.stderr));
    let text = String::from_utf8(done.stdout)?;
    text.lines()
        .map(|line| serde_json::from_str(line).with_context(|| format!("{command} printed {line}")))
        .collect()
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
        passes.push(start.elapsed().as_secs_f64() * 1e9 / count(anchor.inputs.len()));
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
        let dynamics = self.model.dynamics(input.base_pose[2], &input.q, &input.dq);
        let kinematics = &dynamics.kinematics;
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
        let arm = ArmDynamics::new(&dynamics)?;
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
