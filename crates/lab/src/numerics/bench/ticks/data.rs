//! The anchor's CSV files.

use anyhow::{Context as _, bail};
use moca_experiments::JOINTS;
use moca_experiments::timed::ticks::{Input, Ticker};
use moca_msgs::robot::LinkInertial;
use moca_msgs::{ArmTable, Mount, Payload};
use moca_wbc::model::ArmModel;
use moca_wbc::opspace::{AxisWeight, BlockWeight};
use nalgebra::{Matrix3, Vector3};
use std::path::Path;

/// Ticks, their inputs and the torques of an independent implementation.
pub(super) struct Anchor {
    pub ticker: Ticker,
    pub inputs: Vec<Input>,
    pub references: Vec<[f64; 10]>,
}

/// One row of inputs.csv.
fn input(row: &mut Row) -> anyhow::Result<Input> {
    Ok(Input {
        base_pose: row.take()?,
        q: row.take()?,
        base_rate: row.take()?,
        dq: row.take()?,
        desired_rotation: Matrix3::from_row_slice(&row.take::<9>()?),
        desired_position: Vector3::from(row.take()?),
        twist: row.take()?,
        cover: row.take()?,
    })
}

impl Anchor {
    pub(super) fn read(folder: &Path) -> anyhow::Result<Self> {
        let mut parameters = rows(folder, "params.csv")?;
        let Some(row) = parameters.first_mut() else { bail!("params.csv is empty") };
        let mount = Mount { position_base_m: row.take()?, rpy_rad: [0.0; 3] };
        let model = ArmModel::new(&arm(&mut rows(folder, "model.csv")?)?, &mount, &Payload::NONE)?;
        let virtual_mass = row.take()?;
        let (weight_base, weight_arm) = (row.take()?, row.take()?);
        let (eta_base, eta_arm) = block(&weight_base, &weight_arm).unwrap_or((1.0, 1.0));
        let ticker = Ticker {
            model,
            virtual_mass,
            block: BlockWeight::new(eta_base, eta_arm),
            general: AxisWeight::new(weight_base, weight_arm)?,
            stiffness: row.take()?,
            damping: row.take()?,
            posture_stiffness: row.take()?,
            posture_damping: row.take()?,
            posture: row.take()?,
        };
        let anchor = Self {
            ticker,
            inputs: rows(folder, "inputs.csv")?.iter_mut().map(input).collect::<anyhow::Result<_>>()?,
            references: rows(folder, "ref.csv")?.iter_mut().map(Row::take).collect::<anyhow::Result<_>>()?,
        };
        if anchor.inputs.len() != anchor.references.len() || anchor.inputs.is_empty() {
            bail!(
                "inputs.csv has {} rows and ref.csv {}, expected as many and at least one",
                anchor.inputs.len(),
                anchor.references.len()
            );
        }
        Ok(anchor)
    }
}

/// η_B and η_A if H has one value per block, eq. (9).
#[expect(clippy::float_cmp, reason = "a block is a block only if its values are the same number")]
fn block(weight_base: &[f64; 3], weight_arm: &[f64; JOINTS]) -> Option<(f64, f64)> {
    let (base, arm) = (weight_base[0], weight_arm[0]);
    let same = weight_base.iter().all(|w| *w == base) && weight_arm.iter().all(|w| *w == arm);
    same.then_some((base, arm))
}

/// Joints and tool frame of model.csv as a table; rotations become fixed-axis angles.
fn arm(rows: &mut [Row]) -> anyhow::Result<ArmTable<JOINTS>> {
    if rows.len() != 8 {
        bail!("model.csv has {} rows, expected 7 joints and the tool frame", rows.len());
    }
    let mut arm = moca_msgs::robot::PANDA;
    arm.link0 = Payload::NONE.inertial;
    for (i, row) in rows.iter_mut().enumerate() {
        let origin = placement(row)?;
        if i == 7 {
            arm.flange_origin = origin;
            continue;
        }
        arm.joint_origin[i] = origin;
        let [mass_kg] = row.take()?;
        let com_m = row.take()?;
        let [xx, xy, xz, _, yy, yz, _, _, zz] = row.take()?;
        arm.links[i] = LinkInertial { mass_kg, com_m, inertia_com: [xx, xy, xz, yy, yz, zz] };
    }
    Ok(arm)
}

fn placement(row: &mut Row) -> anyhow::Result<[f64; 6]> {
    let r = Matrix3::from_row_slice(&row.take::<9>()?);
    let [x, y, z] = row.take()?;
    let cosine = r[(0, 0)].hypot(r[(1, 0)]);
    let pitch = (-r[(2, 0)]).atan2(cosine);
    Ok([x, y, z, r[(2, 1)].atan2(r[(2, 2)]), pitch, r[(1, 0)].atan2(r[(0, 0)])])
}

/// One row of numbers, taken from the left.
struct Row {
    name: String,
    values: Vec<f64>,
    at: usize,
}

impl Row {
    fn take<const D: usize>(&mut self) -> anyhow::Result<[f64; D]> {
        let rest = self.values.get(self.at..).unwrap_or_default();
        let Some(taken) = rest.first_chunk::<D>() else {
            bail!("{} has {} numbers, expected at least {}", self.name, self.values.len(), self.at + D)
        };
        self.at += D;
        Ok(*taken)
    }
}

fn rows(folder: &Path, name: &str) -> anyhow::Result<Vec<Row>> {
    let path = folder.join(name);
    let text = std::fs::read_to_string(&path).with_context(|| {
        format!("reading {}: tests/peers/pinocchio/generate.py writes it", path.display())
    })?;
    text.lines()
        .enumerate()
        .filter(|(_, line)| !line.trim().is_empty())
        .map(|(number, line)| {
            let name = format!("{} line {}", path.display(), number + 1);
            let values: Result<Vec<f64>, _> = line.split(',').map(|cell| cell.trim().parse()).collect();
            let values = values.with_context(|| format!("{name} holds something that is not a number"))?;
            if let Some(value) = values.iter().find(|value| !value.is_finite()) {
                bail!("{name} holds {value}, expected finite numbers");
            }
            Ok(Row { name, values, at: 0 })
        })
        .collect()
}
