//! Identification of the load at the flange: six postures, each swept slowly to and fro, first with the bare flange, then with the load.
//!
//! The momentum observer estimates the wrench at the flange beside what the arm's model explains. A load of mass m at c adds the force
//! F = (0, 0, −m g) and the torque c × F. Two other things are in the estimate. Friction of the joints turns round with the
//! motion, so the mean over a sweep to and fro is free of it. What is wrong with the arm's model is there without the load too, so
//! the difference to the bare flange is free of that.
//!
//! ```
//! use moca_control::load_identification::{Belief, Sweeps, identify};
//!
//! // A flange that turns as the sweeps ask, and feels nothing: what is carried is what was believed.
//! # use moca_msgs::Sample;
//! let mut sample = Sample { flange_quaternion_world: [1.0, 0.0, 0.0, 0.0], ..Sample::default() };
//! sample.q_rad.extend_from_slice(&[0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7]).unwrap();
//! let mut sweeps = Sweeps::from(&sample)?;
//! while let Some(posture_rad) = sweeps.step(&sample)? {
//!     sample.time_ns += 10_000_000;
//!     sample.q_rad.copy_from_slice(&posture_rad);
//! }
//! let bare = sweeps.measured(&[0.0; 6])?;
//! assert!(identify(&bare, &bare, Belief::default(), Belief::default()).unwrap_err().to_string().contains("turn"));
//! # Ok::<(), anyhow::Error>(())
//! ```

use anyhow::{Result, bail, ensure};
use moca_msgs::{MAX_JOINTS, Sample};
use moca_wbc::model::GRAVITY_M_S2;
use moca_wbc::nalgebra::{Matrix3, Vector3};
use moca_wbc::rotation;

use serde::{Deserialize, Serialize};

/// Offsets of the last three joints from the posture at the start, rad: they turn the flange against gravity.
const OFFSETS_RAD: [[f64; 3]; 6] =
    [[0.0, 0.0, 0.0], [0.5, 0.0, 0.0], [-0.5, 0.0, 0.0], [0.0, 0.5, 0.0], [0.0, -0.5, 0.0], [0.0, 0.0, 0.8]];
/// Postures in which the flange is measured.
pub const POSTURES: usize = OFFSETS_RAD.len();
/// Half of a sweep, rad: every joint turns by so much to either side of a posture.
const SWEEP_RAD: f64 = 0.1;
/// Share of a sweep, around its middle, in which the joints are believed to have their speed.
const MEASURED_SHARE: f64 = 0.6;
/// Speed of every joint in a sweep, and of the fastest one between postures, rad/s.
const SWEEP_RAD_S: f64 = 0.04;
const BETWEEN_RAD_S: f64 = 0.05;
/// Longest time between two samples that the reference moves on for, s.
const LONGEST_S: f64 = 0.05;
/// Largest way of a joint from its reference, rad.
const BEHIND_RAD: f64 = 0.3;
/// Least sine of the angle, rms over the postures, by which gravity leaves any axis of the flange: below it the centre of mass along
/// that axis is not seen.
const TURNED: f64 = 0.15;
/// Lightest load that is told from none, kg.
const LIGHTEST_KG: f64 = 0.02;
/// Largest residual of a measurement that one rigid load explains, rms: N and N·m.
const RESIDUAL: [f64; 2] = [4.0, 0.4];

/// Mean of a quantity over one direction of a sweep.
#[derive(Clone, Copy, Debug, Default)]
struct Mean {
    count: f64,
    wrench_world: [f64; 6],
    rotation_world: Matrix3<f64>,
}

impl Mean {
    fn take(&mut self, sample: &Sample) {
        self.count += 1.0;
        for (sum, value) in self.wrench_world.iter_mut().zip(sample.flange_wrench_world) {
            *sum += value;
        }
        self.rotation_world += rotation::from_quaternion(sample.flange_quaternion_world);
    }
}

/// The sweeps, sample by sample: a posture to be led to for each. It has no clock but the samples'.
#[derive(Clone, Debug)]
pub struct Sweeps {
    joints: usize,
    start_rad: [f64; MAX_JOINTS],
    /// Reference of the joints, rad.
    at_rad: [f64; MAX_JOINTS],
    /// Three legs for each posture: to the start of its sweep, over it, and back. The last one leads home.
    leg: usize,
    last_ns: Option<u64>,
    means: [[Mean; 2]; POSTURES],
}

impl Sweeps {
    /// Begins where the arm stands.
    ///
    /// # Errors
    /// An arm of fewer than three joints, or none.
    pub fn from(sample: &Sample) -> Result<Self> {
        let joints = sample.q_rad.len();
        ensure!(joints >= 3, "an arm of {joints} joints: a load is identified with 3 joints or more");
        let mut start_rad = [0.0; MAX_JOINTS];
        start_rad[..joints].copy_from_slice(&sample.q_rad);
        Ok(Self { joints, start_rad, at_rad: start_rad, leg: 0, last_ns: None, means: Default::default() })
    }

    /// Share of the legs that is done, 0 to 1.
    pub fn share(&self) -> f64 {
        #[expect(clippy::cast_precision_loss, reason = "small counts")]
        let share = self.leg as f64 / (3 * POSTURES + 1) as f64;
        share
    }

    /// Posture of the middle of a sweep, rad.
    fn posture_rad(&self, posture: usize) -> [f64; MAX_JOINTS] {
        let mut q_rad = self.start_rad;
        for (q, offset) in q_rad[self.joints - 3..self.joints].iter_mut().zip(OFFSETS_RAD[posture]) {
            *q += offset;
        }
        q_rad
    }

    /// End of the present leg, rad; `None` after the last one.
    fn end_rad(&self) -> Option<[f64; MAX_JOINTS]> {
        let posture = self.leg / 3;
        if posture == POSTURES {
            return self.leg.is_multiple_of(3).then_some(self.start_rad);
        }
        let side = if self.leg % 3 == 1 { SWEEP_RAD } else { -SWEEP_RAD };
        let mut q_rad = self.posture_rad(posture);
        // Neighbours turn against each other, so that the flange stays near its place.
        for (joint, q) in q_rad[..self.joints].iter_mut().enumerate() {
            *q += if joint % 2 == 0 { side } else { -side };
        }
        Some(q_rad)
    }

    /// Takes the next sample in, and returns the posture to lead to, rad; `None` once the arm is back.
    ///
    /// # Errors
    /// A joint that stays behind.
    pub fn step(&mut self, sample: &Sample) -> Result<Option<heapless::Vec<f64, MAX_JOINTS>>> {
        let Some(end_rad) = self.end_rad() else { return Ok(None) };
        for (joint, (q, at)) in sample.q_rad.iter().zip(self.at_rad).enumerate() {
            ensure!(
                (q - at).abs() <= BEHIND_RAD,
                "J{} is at {q:.2} rad, {at:.2} rad is wanted; allowed: {BEHIND_RAD} rad apart. Is something in its way?",
                joint + 1
            );
        }
        if !self.leg.is_multiple_of(3) {
            let middle_rad = self.posture_rad(self.leg / 3);
            if (self.at_rad[0] - middle_rad[0]).abs() <= MEASURED_SHARE * SWEEP_RAD {
                self.means[self.leg / 3][self.leg % 3 - 1].take(sample);
            }
        }
        let since_ns =
            sample.time_ns.saturating_sub(self.last_ns.replace(sample.time_ns).unwrap_or(sample.time_ns));
        #[expect(clippy::cast_precision_loss, reason = "below a second")]
        let dt_s = (since_ns as f64 * 1e-9).min(LONGEST_S);
        let speed_rad_s = if self.leg.is_multiple_of(3) { BETWEEN_RAD_S } else { SWEEP_RAD_S };
        let left_rad = self.at_rad.iter().zip(end_rad).map(|(at, end)| (end - at).abs()).fold(0.0, f64::max);
        let way_rad = speed_rad_s * dt_s;
        if left_rad <= way_rad {
            (self.at_rad, self.leg) = (end_rad, self.leg + 1);
        } else {
            for (at, end) in self.at_rad.iter_mut().zip(end_rad) {
                *at += (end - *at) * way_rad / left_rad;
            }
        }
        Ok(Some(self.at_rad[..self.joints].iter().copied().collect()))
    }

    /// Means of the sweeps. `tool_origin` is `robot.tool.origin`: the estimate is about the tool frame.
    ///
    /// # Errors
    /// A sweep of which there is no sample.
    pub fn measured(&self, tool_origin: &[f64; 6]) -> Result<Measured> {
        let [x, y, z, roll, pitch, yaw] = *tool_origin;
        let of_tool = rotation::from_rpy([roll, pitch, yaw]);
        let mut measured = Measured { postures: Vec::new() };
        for [to, fro] in &self.means {
            if to.count == 0.0 || fro.count == 0.0 {
                bail!("no sample of a sweep: is the connection to the daemon too slow?");
            }
            let mean = |of: &dyn Fn(&Mean) -> f64| 0.5 * (of(to) / to.count + of(fro) / fro.count);
            let rotation_world =
                Matrix3::from_fn(|i, j| mean(&|one| one.rotation_world[(i, j)])) * of_tool.transpose();
            let of_wrench = |i: usize| mean(&|one| one.wrench_world[i]);
            let force_n = Vector3::from_fn(|i, _| of_wrench(i));
            let torque_nm = Vector3::from_fn(|i, _| of_wrench(3 + i))
                + (rotation_world * Vector3::new(x, y, z)).cross(&force_n);
            measured.postures.push(Wrench {
                force_world_n: force_n.into(),
                torque_world_nm: torque_nm.into(),
                flange_axes_world: rotation_world.into(),
            });
        }
        Ok(measured)
    }
}

/// Mean wrench at the flange in one posture.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Wrench {
    /// World axes, N.
    pub force_world_n: [f64; 3],
    /// About the flange, world axes, N·m.
    pub torque_world_nm: [f64; 3],
    /// Axes x, y, z of the flange in the world; means, so not quite of unit length.
    pub flange_axes_world: [[f64; 3]; 3],
}

/// Means of every posture's sweep.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Measured {
    /// In the order of the sweeps.
    pub postures: Vec<Wrench>,
}

/// Load that the controller counted with while it measured (`robot.load`).
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Belief {
    /// kg.
    pub mass_kg: f64,
    /// Centre of mass in the flange's axes, m.
    pub com_m: [f64; 3],
}

impl Belief {
    fn first_moment_kg_m(&self) -> Vector3<f64> {
        Vector3::from(self.com_m) * self.mass_kg
    }
}

/// Identified load.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Identified {
    /// Mass, kg; 0 where it is too light to be told from none.
    pub mass_kg: f64,
    /// Centre of mass in the flange's axes, m.
    pub com_m: [f64; 3],
    /// Force and torque that one rigid load does not explain, rms over postures and axes: N and N·m.
    pub residual: [f64; 2],
}

/// The load of which `loaded` was measured, with `bare` measured without it. What the controller believed in either may differ.
///
/// # Errors
/// Postures that do not turn the flange against gravity, a flange that is lighter than it was bare, and wrenches that no rigid load
/// explains: somebody pushed.
pub fn identify(
    bare: &Measured,
    loaded: &Measured,
    believed_bare: Belief,
    believed_loaded: Belief,
) -> Result<Identified> {
    ensure!(
        bare.postures.len() == POSTURES && loaded.postures.len() == POSTURES,
        "{} and {} postures; allowed: {POSTURES}",
        bare.postures.len(),
        loaded.postures.len()
    );
    #[expect(clippy::cast_precision_loss, reason = "a small count")]
    let count = POSTURES as f64;
    let differences = || {
        loaded.postures.iter().zip(&bare.postures).map(|(with, without)| {
            let apart = |a: [f64; 3], b: [f64; 3]| Vector3::from(a) - Vector3::from(b);
            (
                apart(with.force_world_n, without.force_world_n),
                apart(with.torque_world_nm, without.torque_world_nm),
                Matrix3::from(with.flange_axes_world),
            )
        })
    };
    // A load at rest: F = (0, 0, −m g), and (R c) × F is m g (−(R c)_y, (R c)_x, 0).
    let mass_kg = -differences().map(|(force_n, ..)| force_n.z).sum::<f64>() / (count * GRAVITY_M_S2);
    let (mut normal, mut right) = (Matrix3::zeros(), Vector3::zeros());
    for (_, torque_nm, rotation_world) in differences() {
        let (x, y) = (rotation_world.row(0).transpose(), rotation_world.row(1).transpose());
        normal += (x * x.transpose() + y * y.transpose()) * (GRAVITY_M_S2 * GRAVITY_M_S2);
        right += (x * torque_nm.y - y * torque_nm.x) * GRAVITY_M_S2;
    }
    let seen = (normal.symmetric_eigenvalues().min() / (count * GRAVITY_M_S2 * GRAVITY_M_S2)).max(0.0).sqrt();
    let Some(inverse) = normal.try_inverse().filter(|_| seen >= TURNED) else {
        bail!(
            "the postures turn the flange against gravity by a sine of {seen:.3} about some axis; allowed: {TURNED} or more. Begin \
             in another posture."
        )
    };
    let moment_kg_m = inverse * right;

    let mut squares = [0.0; 2];
    for (force_n, torque_nm, rotation_world) in differences() {
        let weight_n = Vector3::new(0.0, 0.0, -mass_kg * GRAVITY_M_S2);
        let down = Vector3::new(0.0, 0.0, -GRAVITY_M_S2);
        squares[0] += (force_n - weight_n).norm_squared();
        squares[1] += (torque_nm - (rotation_world * moment_kg_m).cross(&down)).norm_squared();
    }
    let residual = squares.map(|square| (square / (3.0 * count)).sqrt());
    for ((residual, most), unit) in residual.into_iter().zip(RESIDUAL).zip(["N", "N·m"]) {
        ensure!(
            residual <= most,
            "{residual:.2} {unit} rms are not those of a rigid load; allowed: {most} {unit}. Nobody may touch the arm; then measure again."
        );
    }
    let mass_kg = mass_kg + believed_loaded.mass_kg - believed_bare.mass_kg;
    let moment_kg_m = moment_kg_m + believed_loaded.first_moment_kg_m() - believed_bare.first_moment_kg_m();
    ensure!(
        mass_kg > -LIGHTEST_KG,
        "the flange is {:.3} kg lighter than it was bare: measure it bare again",
        -mass_kg
    );
    let found = mass_kg >= LIGHTEST_KG;
    let com_m = if found { (moment_kg_m / mass_kg).into() } else { [0.0; 3] };
    Ok(Identified { mass_kg: if found { mass_kg } else { 0.0 }, com_m, residual })
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Flange of a robot whose arm is `heavier`, N, with the load of `mass_kg` at `com_m`, led through the sweeps.
    fn led(mass_kg: f64, com_m: [f64; 3], heavier_n: f64, tool_origin: &[f64; 6]) -> Measured {
        let mut sample = Sample::default();
        sample.q_rad.extend_from_slice(&[0.0, 0.1, 0.2, 0.3]).unwrap();
        let feel = |sample: &mut Sample| {
            let q = &sample.q_rad;
            let flange = rotation::from_rpy([q[1] - 0.1, q[2] - 0.2, q[3] - 0.3]);
            let [x, y, z, roll, pitch, yaw] = *tool_origin;
            let force_n = Vector3::new(0.0, 0.0, -GRAVITY_M_S2 * mass_kg);
            let arm = flange * (Vector3::from(com_m) - Vector3::new(x, y, z));
            let torque_nm = arm.cross(&force_n);
            sample.flange_quaternion_world =
                rotation::to_quaternion(&(flange * rotation::from_rpy([roll, pitch, yaw])));
            sample.flange_wrench_world =
                [heavier_n, 0.0, force_n.z - heavier_n, torque_nm.x + heavier_n, torque_nm.y, torque_nm.z];
        };
        feel(&mut sample);
        let mut sweeps = Sweeps::from(&sample).unwrap();
        let start = sample.q_rad.clone();
        while let Some(posture_rad) = sweeps.step(&sample).unwrap() {
            sample.time_ns += 20_000_000;
            sample.q_rad.copy_from_slice(&posture_rad);
            feel(&mut sample);
        }
        assert_eq!(sample.q_rad, start, "and back");
        assert!((sweeps.share() - 1.0).abs() < 1e-12);
        sweeps.measured(tool_origin).unwrap()
    }

    const FLANGE: [f64; 6] = [0.0; 6];
    const COM_M: [f64; 3] = [0.03, -0.02, 0.1];

    fn told(bare: &Measured, loaded: &Measured) -> String {
        identify(bare, loaded, Belief::default(), Belief::default()).unwrap_err().to_string()
    }

    #[test]
    fn load_is_the_difference_to_the_bare_flange() {
        for tool in [FLANGE, [0.01, 0.02, 0.1, 0.3, -0.2, 0.5]] {
            let bare = led(0.0, COM_M, 2.0, &tool);
            let found =
                identify(&bare, &led(1.5, COM_M, 2.0, &tool), Belief::default(), Belief::default()).unwrap();
            assert!((found.mass_kg - 1.5).abs() < 1e-9, "{found:?}");
            for (com, truth) in found.com_m.iter().zip(COM_M) {
                assert!((com - truth).abs() < 1e-6, "{found:?}");
            }
            assert!(found.residual.iter().all(|residual| *residual < 1e-6), "{found:?}");
        }
    }

    #[test]
    fn what_the_controller_counted_with_is_added() {
        let bare = led(0.0, COM_M, 0.0, &FLANGE);
        let counted = Belief { mass_kg: 1.0, com_m: COM_M };
        let found = identify(&bare, &led(0.5, [0.0; 3], 0.0, &FLANGE), Belief::default(), counted).unwrap();
        assert!((found.mass_kg - 1.5).abs() < 1e-9 && (found.com_m[2] - 0.1 / 1.5).abs() < 1e-6, "{found:?}");
        let found = identify(&bare, &bare, Belief::default(), Belief::default()).unwrap();
        assert_eq!((found.mass_kg, found.com_m), (0.0, [0.0; 3]), "nothing is told from nothing");
        let said = identify(&bare, &bare, counted, Belief::default()).unwrap_err().to_string();
        assert!(said.starts_with("the flange is 1.000 kg lighter than it was bare"), "{said}");
    }

    #[test]
    fn wrenches_of_no_load_are_refused() {
        let (bare, loaded) = (led(0.0, COM_M, 0.0, &FLANGE), led(1.0, COM_M, 0.0, &FLANGE));
        let mut pushed = loaded.clone();
        pushed.postures[2].force_world_n[0] += 20.0;
        assert!(told(&bare, &pushed).contains("4.71 N rms are not those of a rigid load; allowed: 4 N"));
        let mut twisted = loaded.clone();
        twisted.postures[2].torque_world_nm[2] += 2.0;
        assert!(
            told(&bare, &twisted).contains("0.47 N·m rms are not those of a rigid load; allowed: 0.4 N·m")
        );
        let mut short = loaded;
        short.postures.pop();
        assert_eq!(told(&bare, &short), "6 and 5 postures; allowed: 6");
    }

    #[test]
    fn arm_that_cannot_be_measured_says_why() {
        let mut sample = Sample::default();
        sample.q_rad.extend_from_slice(&[0.0, 0.0]).unwrap();
        assert!(Sweeps::from(&sample).unwrap_err().to_string().contains("an arm of 2 joints"));
        sample.q_rad.push(0.0).unwrap();
        let mut sweeps = Sweeps::from(&sample).unwrap();
        assert!(sweeps.measured(&FLANGE).unwrap_err().to_string().contains("no sample of a sweep"));
        sample.q_rad[2] = 0.31;
        let blocked = sweeps.step(&sample).unwrap_err().to_string();
        assert!(
            blocked.starts_with("J3 is at 0.31 rad, 0.00 rad is wanted; allowed: 0.3 rad apart"),
            "{blocked}"
        );
    }
}
