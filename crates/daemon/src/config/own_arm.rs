//! `[arm]`: an arm of one's own, from a URDF file or as a table, read where robot.arm is "own".

use super::load::read_text;
use super::urdf::{UrdfArm, read};
use crate::robot::{Arm, OWN_ARM};
use moca_msgs::robot::{AnyArm, ArmTable, LinkInertial, SpeedEnvelope};
use moca_msgs::{MAX_JOINTS, parameter_table};
use std::path::Path;

/// Posture stiffness of a joint whose motor has the torque of a Panda's shoulder, N·m/rad and N·m; less in proportion. ASSUMED
const POSTURE: (f64, f64) = (90.0, 87.0);
/// Posture damping for each N·m/rad of it, s. ASSUMED
const POSTURE_DAMPING_S: f64 = 1.0 / 9.0;
/// The numbers of joints that there are controllers for.
const JOINTS: std::ops::RangeInclusive<usize> = 6..=7;

parameter_table! {
    /// `[arm]`: lists go joint by joint from the base, or link by link. What is given beside a URDF replaces what it says.
    #[derive(Clone, Debug, PartialEq)]
    pub struct OwnArm in "arm" {
        /// What the arm is called; empty is the name in the URDF.
        name: String = String::new();
        /// URDF file, from the folder of this one; what is read from it stands in the lists below in a log.
        urdf: String = String::new();
        /// Link of the URDF that stands on the base; empty if no joint moves only one.
        base_link: String = String::new();
        /// Link of the URDF that is the flange; empty if only one carries none.
        tip_link: String = String::new();
        /// Frame of each joint in the link before, x, y, z, roll, pitch, yaw; it turns about its z axis.
        joint_origin: Vec<f64> = Vec::new()
            => [.range(-10.0, 10.0).units(&["m, rad"])];
        /// Frame of the flange in the last link: x, y, z, roll, pitch, yaw.
        flange_origin: Vec<f64> = Vec::new() => [.range(-10.0, 10.0).units(&["m, rad"])];
        /// Mass of each link, the one that stands on the base first.
        mass_kg: Vec<f64> = Vec::new() => [.range(0.0, 1000.0).units(&["kg"])];
        /// Centre of mass of each link in its frame: x, y, z.
        com_m: Vec<f64> = Vec::new() => [.range(-10.0, 10.0).units(&["m"])];
        /// Inertia of each link about its centre of mass, its own axes: xx, xy, xz, yy, yz, zz.
        inertia_com: Vec<f64> = Vec::new() => [.range(-1000.0, 1000.0).units(&["kg·m²"])];
        /// Lower end of each joint's range.
        q_min_rad: Vec<f64> = Vec::new() => [.range(-100.0, 100.0).units(&["rad"])];
        /// Upper end of each joint's range.
        q_max_rad: Vec<f64> = Vec::new() => [.range(-100.0, 100.0).units(&["rad"])];
        /// Largest speed of each joint.
        dq_max_rad_s: Vec<f64> = Vec::new() => [.range(0.01, 100.0).units(&["rad/s"])];
        /// Largest torque of each joint.
        torque_max_nm: Vec<f64> = Vec::new() => [.range(0.01, 1000.0).units(&["N·m"])];
        /// Posture in which the arm starts, away from singular ones.
        home_rad: Vec<f64> = Vec::new() => [.range(-7.0, 7.0).units(&["rad"])];
        /// Near the ends of its range a joint is no faster than √(2·deceleration·distance) less this; empty for no such limit.
        speed_offset_rad_s: Vec<f64> = Vec::new() => [.range(0.0, 100.0).units(&["rad/s"])];
        /// The deceleration in it.
        speed_deceleration_rad_s2: Vec<f64> = Vec::new() => [.range(0.01, 1000.0).units(&["rad/s²"])];
    }
}

/// The row at fault and what is wrong with it.
type Mistake = (&'static str, String);

impl OwnArm {
    /// The arm that the lists and the URDF describe together; `folder` is where the file with this section is.
    ///
    /// # Errors
    /// The first mistake.
    pub(super) fn arm(&self, folder: &Path) -> Result<Arm, Mistake> {
        let mut whole = self.clone();
        if !self.urdf.is_empty() {
            whole.fill(self.file(folder)?);
        }
        let table = whole.table()?;
        let name = if whole.name.is_empty() { "own arm".into() } else { whole.name };
        Ok(Arm { source: OWN_ARM.into(), name, table })
    }

    /// The section that gives `arm` back; empty for one that is built in.
    pub(super) fn of(arm: &Arm) -> Self {
        if arm.source != OWN_ARM {
            return Self::default();
        }
        let (table, joints) = (&arm.table.table, arm.table.joints);
        let links = || std::iter::once(&table.link0).chain(&table.links[..joints]);
        let envelope = |of: fn(&SpeedEnvelope<MAX_JOINTS>) -> &[f64; MAX_JOINTS]| {
            table.speed_envelope.as_ref().map_or(Vec::new(), |envelope| of(envelope)[..joints].to_vec())
        };
        Self {
            name: arm.name.clone(),
            urdf: String::new(),
            base_link: String::new(),
            tip_link: String::new(),
            joint_origin: table.joint_origin[..joints].concat(),
            flange_origin: table.flange_origin.to_vec(),
            mass_kg: links().map(|link| link.mass_kg).collect(),
            com_m: links().flat_map(|link| link.com_m).collect(),
            inertia_com: links().flat_map(|link| link.inertia_com).collect(),
            q_min_rad: table.q_min_rad[..joints].to_vec(),
            q_max_rad: table.q_max_rad[..joints].to_vec(),
            dq_max_rad_s: table.dq_max_rad_s[..joints].to_vec(),
            torque_max_nm: table.torque_max_nm[..joints].to_vec(),
            home_rad: table.home_rad[..joints].to_vec(),
            speed_offset_rad_s: envelope(|envelope| &envelope.offset_rad_s),
            speed_deceleration_rad_s2: envelope(|envelope| &envelope.deceleration_rad_s2),
        }
    }

    fn file(&self, folder: &Path) -> Result<UrdfArm, Mistake> {
        let path = folder.join(&self.urdf);
        let wrong = |message: String| ("arm.urdf", format!("arm.urdf = \"{}\": {message}", path.display()));
        let text = read_text(&path).map_err(|error| ("arm.urdf", format!("arm.urdf: {error}")))?;
        read(&text, &self.base_link, &self.tip_link).map_err(wrong)
    }

    /// Takes from `urdf` what the file with this section does not say.
    fn fill(&mut self, urdf: UrdfArm) {
        let links = || std::iter::once(&urdf.link0).chain(urdf.joints.iter().map(|joint| &joint.link));
        let all = |of: &dyn Fn(&super::urdf::Limit) -> Option<f64>| {
            urdf.joints.iter().map(|joint| of(&joint.limit)).collect::<Option<Vec<_>>>().unwrap_or_default()
        };
        let fill = |list: &mut Vec<f64>, of: Vec<f64>| {
            if list.is_empty() {
                *list = of;
            }
        };
        fill(&mut self.joint_origin, urdf.joints.iter().flat_map(|joint| joint.origin).collect());
        fill(&mut self.flange_origin, urdf.flange_origin.to_vec());
        fill(&mut self.mass_kg, links().map(|link| link.mass_kg).collect());
        fill(&mut self.com_m, links().flat_map(|link| link.com_m).collect());
        fill(&mut self.inertia_com, links().flat_map(|link| link.inertia_com).collect());
        fill(&mut self.q_min_rad, all(&|limit| Some(limit.range_rad?[0])));
        fill(&mut self.q_max_rad, all(&|limit| Some(limit.range_rad?[1])));
        fill(&mut self.dq_max_rad_s, all(&|limit| limit.speed_rad_s));
        fill(&mut self.torque_max_nm, all(&|limit| limit.torque_nm));
        if self.name.is_empty() {
            self.name = urdf.name;
        }
    }

    fn table(&self) -> Result<AnyArm, Mistake> {
        let joints = self.joint_origin.len() / 6;
        if self.joint_origin.is_empty() {
            return Err((
                "robot.arm",
                "robot.arm = \"own\" needs arm.urdf, or arm.joint_origin and what goes with it".into(),
            ));
        }
        if !self.joint_origin.len().is_multiple_of(6) || !JOINTS.contains(&joints) {
            let message = format!(
                "arm.joint_origin has {} numbers; six for each joint of an arm of {} or {} joints are allowed",
                self.joint_origin.len(),
                JOINTS.start(),
                JOINTS.end()
            );
            return Err(("arm.joint_origin", message));
        }
        let mut table = AnyArm::NONE.table;
        for (origin, six) in table.joint_origin.iter_mut().zip(self.joint_origin.as_chunks().0) {
            *origin = *six;
        }
        let flange = counted("arm.flange_origin", &self.flange_origin, 6, "x, y, z, roll, pitch, yaw")?;
        table.flange_origin.copy_from_slice(flange);
        self.put_links(&mut table, joints)?;
        for (row, list, place) in [
            ("arm.q_min_rad", &self.q_min_rad, &mut table.q_min_rad),
            ("arm.q_max_rad", &self.q_max_rad, &mut table.q_max_rad),
            ("arm.dq_max_rad_s", &self.dq_max_rad_s, &mut table.dq_max_rad_s),
            ("arm.torque_max_nm", &self.torque_max_nm, &mut table.torque_max_nm),
            ("arm.home_rad", &self.home_rad, &mut table.home_rad),
        ] {
            place[..joints].copy_from_slice(counted(row, list, joints, "one for each joint")?);
        }
        for i in 0..joints {
            let ([low, high], home) = ([table.q_min_rad[i], table.q_max_rad[i]], table.home_rad[i]);
            if low >= high {
                let message = format!(
                    "arm.q_min_rad = {low} rad of joint {} is not below arm.q_max_rad = {high} rad",
                    i + 1
                );
                return Err(("arm.q_min_rad", message));
            }
            if !(low..=high).contains(&home) {
                let message = format!(
                    "arm.home_rad = {home} rad of joint {} is outside its range, {low} to {high} rad",
                    i + 1
                );
                return Err(("arm.home_rad", message));
            }
            let stiffness = POSTURE.0 * (table.torque_max_nm[i] / POSTURE.1).min(1.0);
            table.posture_stiffness_nm_rad[i] = stiffness;
            table.posture_damping_nm_s_rad[i] = POSTURE_DAMPING_S * stiffness;
        }
        table.speed_envelope = self.envelope(joints)?;
        Ok(AnyArm { table, joints })
    }

    fn put_links(&self, table: &mut ArmTable<MAX_JOINTS>, joints: usize) -> Result<(), Mistake> {
        let links = joints + 1;
        let masses =
            counted("arm.mass_kg", &self.mass_kg, links, "one for each link, the first stands on the base")?;
        let coms = counted("arm.com_m", &self.com_m, 3 * links, "three for each link")?;
        let inertias = counted("arm.inertia_com", &self.inertia_com, 6 * links, "six for each link")?;
        let bodies = masses.iter().zip(coms.as_chunks().0).zip(inertias.as_chunks().0);
        for (i, ((mass_kg, com_m), inertia_com)) in bodies.enumerate() {
            let link = LinkInertial { mass_kg: *mass_kg, com_m: *com_m, inertia_com: *inertia_com };
            if i > 0 && link.mass_kg <= 0.0 {
                return Err((
                    "arm.mass_kg",
                    format!("arm.mass_kg = 0 kg of link {i}, which joint {i} moves"),
                ));
            }
            match i.checked_sub(1) {
                None => table.link0 = link,
                Some(joint) => table.links[joint] = link,
            }
        }
        Ok(())
    }

    fn envelope(&self, joints: usize) -> Result<Option<SpeedEnvelope<MAX_JOINTS>>, Mistake> {
        let (offsets, decelerations) = (&self.speed_offset_rad_s, &self.speed_deceleration_rad_s2);
        if offsets.is_empty() && decelerations.is_empty() {
            return Ok(None);
        }
        let mut envelope =
            SpeedEnvelope { offset_rad_s: [0.0; MAX_JOINTS], deceleration_rad_s2: [0.0; MAX_JOINTS] };
        let each = "one for each joint";
        envelope.offset_rad_s[..joints].copy_from_slice(counted(
            "arm.speed_offset_rad_s",
            offsets,
            joints,
            each,
        )?);
        let counted = counted("arm.speed_deceleration_rad_s2", decelerations, joints, each)?;
        envelope.deceleration_rad_s2[..joints].copy_from_slice(counted);
        Ok(Some(envelope))
    }
}

fn counted<'a>(row: &'static str, list: &'a [f64], count: usize, of: &str) -> Result<&'a [f64], Mistake> {
    if list.len() == count {
        return Ok(list);
    }
    Err((row, format!("{row} has {} numbers; {count} are needed, {of}", list.len())))
}
