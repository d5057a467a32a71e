//! `[arm]`: an arm of one's own, from a URDF file or as a table, read where robot.arm is "own".

use super::bodies::no_body;
use super::load::{NAME_MAX, read_text};
use super::urdf::{Given, Limit, UrdfArm, UrdfJoint, capsules, read};
use crate::robot::{Arm, OWN_ARM};
use moca_msgs::robot::{AnyArm, ArmTable, LinkCapsule, LinkInertial, SpeedEnvelope};
use moca_msgs::table::FieldValue;
use moca_msgs::{MAX_JOINTS, parameter_table};
use std::path::Path;

/// Posture stiffness of a joint whose motor has the torque of a Panda's shoulder, N·m/rad and N·m; less in proportion. ASSUMED
const POSTURE: (f64, f64) = (90.0, 87.0);
/// Posture damping for each N·m/rad of it, s. ASSUMED
const POSTURE_DAMPING_S: f64 = 1.0 / 9.0;
/// Shortest sum of the distances from joint to joint and to the flange that makes an arm, m.
const LENGTH_LEAST_M: f64 = 0.1;
/// The numbers of joints that there are controllers for.
const JOINTS: std::ops::RangeInclusive<usize> = 6..=7;
/// Most capsules of an arm: three numbers for each have to fit into a list.
const CAPSULES_MAX: usize = 16;

parameter_table! {
    /// `[arm]`: lists go joint by joint from the base, or link by link. What is given beside a URDF replaces what it says.
    #[derive(Clone, Debug, PartialEq)]
    pub struct OwnArm in "arm" {
        /// Name of the arm; empty is the name in the URDF.
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
        /// Link of each capsule, 0 is the one that stands on the base; empty is what the URDF's <collision> shapes give.
        capsule_link: Vec<usize> = Vec::new() => [.range(0.0, 7.0)];
        /// One end of each capsule in its link's frame: x, y, z.
        capsule_start_m: Vec<f64> = Vec::new() => [.range(-10.0, 10.0).units(&["m"])];
        /// The other end of each capsule.
        capsule_end_m: Vec<f64> = Vec::new() => [.range(-10.0, 10.0).units(&["m"])];
        /// Radius of each capsule.
        capsule_radius_m: Vec<f64> = Vec::new() => [.range(0.001, 1.0).units(&["m"])];
    }
}

/// The row at fault and what is wrong with it.
type Mistake = (&'static str, String);

impl OwnArm {
    /// The arm that the lists and the URDF describe together; `folder` is where the file with this section is. Shapes of the URDF
    /// are read where `shaped`.
    ///
    /// # Errors
    /// Every mistake.
    pub(super) fn arm(&self, folder: &Path, shaped: bool) -> Result<Arm, Vec<Mistake>> {
        let (mut whole, mut links) = (self.clone(), Vec::new());
        if !self.urdf.is_empty() {
            let (text, urdf) = self.file(folder).map_err(|mistake| vec![mistake])?;
            if shaped && self.capsule_link.is_empty() {
                let capsules =
                    capsules(&text, &urdf.parts, folder.join(&self.urdf).parent().unwrap_or(folder));
                let mistake = |why| vec![("arm.urdf", format!("arm.urdf = \"{}\": {why}", self.urdf))];
                whole.take_capsules(&capsules.map_err(mistake)?);
            }
            links = urdf.joints.iter().map(|joint| joint.moves.clone()).collect();
            whole.fill(urdf).map_err(|why| {
                vec![("arm.urdf", format!("arm.urdf = \"{}\": {why}", folder.join(&self.urdf).display()))]
            })?;
        }
        let mut mistakes = whole.check_ranges();
        let table = whole.table(&links, &mut mistakes);
        let Some(table) = table.filter(|_| mistakes.is_empty()) else { return Err(mistakes) };
        let capsules = whole.capsules();
        let name = if whole.name.is_empty() { "own arm".into() } else { whole.name };
        if name.len() > NAME_MAX {
            let message = format!("arm.name has {} bytes; at most {NAME_MAX} are allowed", name.len());
            return Err(vec![("arm.name", message)]);
        }
        Ok(Arm { source: OWN_ARM.into(), name, table, capsules })
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
        let mut own = Self {
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
            ..Self::default()
        };
        own.take_capsules(&arm.capsules);
        own
    }

    fn take_capsules(&mut self, capsules: &[LinkCapsule]) {
        self.capsule_link = capsules.iter().map(|capsule| capsule.link).collect();
        self.capsule_start_m = capsules.iter().flat_map(|capsule| capsule.ends_m[0]).collect();
        self.capsule_end_m = capsules.iter().flat_map(|capsule| capsule.ends_m[1]).collect();
        self.capsule_radius_m = capsules.iter().map(|capsule| capsule.radius_m).collect();
    }

    /// Capsules of the lists, as many as every list has.
    fn capsules(&self) -> Vec<LinkCapsule> {
        let ends = self.capsule_start_m.as_chunks().0.iter().zip(self.capsule_end_m.as_chunks().0);
        let lists = self.capsule_link.iter().zip(ends).zip(&self.capsule_radius_m);
        lists
            .map(|((link, (start, end)), radius_m)| LinkCapsule {
                link: *link,
                ends_m: [*start, *end],
                radius_m: *radius_m,
            })
            .collect()
    }

    /// Finds lists of other lengths than that of the capsules' links, and links that are not there.
    fn check_capsules(&self, joints: usize, mistakes: &mut Vec<Mistake>) {
        let count = self.capsule_link.len();
        if let Some(link) = self.capsule_link.iter().find(|link| **link > joints) {
            let message =
                format!("arm.capsule_link = {link} is outside 0 to {joints}, the links of this arm");
            mistakes.push(("arm.capsule_link", message));
        }
        if count > CAPSULES_MAX {
            let message = format!(
                "arm.capsule_link has {count} capsules; at most {CAPSULES_MAX} are allowed: write fewer <collision> shapes, or set \
                 arm.capsule_link and what goes with it"
            );
            mistakes.push(("arm.capsule_link", message));
            return;
        }
        counted("arm.capsule_start_m", &self.capsule_start_m, 3 * count, "three for each capsule", mistakes);
        counted("arm.capsule_end_m", &self.capsule_end_m, 3 * count, "three for each capsule", mistakes);
        counted("arm.capsule_radius_m", &self.capsule_radius_m, count, "one for each capsule", mistakes);
    }

    /// Text of the URDF, and the arm in it.
    fn file(&self, folder: &Path) -> Result<(String, UrdfArm), Mistake> {
        let path = folder.join(&self.urdf);
        let wrong = |message: String| ("arm.urdf", format!("arm.urdf = \"{}\": {message}", path.display()));
        let text = read_text(&path).map_err(|error| ("arm.urdf", format!("arm.urdf: {error}")))?;
        let given = Given {
            mass: !self.mass_kg.is_empty(),
            com: !self.com_m.is_empty(),
            inertia: !self.inertia_com.is_empty(),
            range: !self.q_min_rad.is_empty() && !self.q_max_rad.is_empty(),
            speed: !self.dq_max_rad_s.is_empty(),
            torque: !self.torque_max_nm.is_empty(),
        };
        let arm = read(&text, &self.base_link, &self.tip_link, &given).map_err(wrong)?;
        Ok((text, arm))
    }

    /// Takes from `urdf` what the file with this section does not say.
    ///
    /// # Errors
    /// What neither says, with the key to set.
    fn fill(&mut self, urdf: UrdfArm) -> Result<(), String> {
        let links = || std::iter::once(&urdf.link0).chain(urdf.joints.iter().map(|joint| &joint.link));
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
        let joints = &urdf.joints;
        if self.q_min_rad.is_empty() || self.q_max_rad.is_empty() {
            let [low, high] = [0, 1].map(|end| move |limit: &Limit| Some(limit.range_rad?[end]));
            let keys = [("arm.q_min_rad", &low as &dyn Fn(&Limit) -> Option<f64>), ("arm.q_max_rad", &high)];
            let [low, high] = said(joints, keys, "rad")?;
            fill(&mut self.q_min_rad, low);
            fill(&mut self.q_max_rad, high);
        }
        if self.dq_max_rad_s.is_empty() {
            [self.dq_max_rad_s] = said(joints, [("arm.dq_max_rad_s", &|limit| limit.speed_rad_s)], "rad/s")?;
        }
        if self.torque_max_nm.is_empty() {
            [self.torque_max_nm] = said(joints, [("arm.torque_max_nm", &|limit| limit.torque_nm)], "N·m")?;
        }
        if self.name.is_empty() {
            self.name = urdf.name;
        }
        Ok(())
    }

    /// The mistakes in the rows' ranges, of what came from a URDF too.
    fn check_ranges(&self) -> Vec<Mistake> {
        let mut wrong = Vec::new();
        self.clone().each(&mut |row, field| {
            field.see(&mut |value| {
                if let FieldValue::Numbers(numbers) = value
                    && let Err(error) = row.check(numbers)
                {
                    wrong.push((row.name, error.to_string()));
                }
            });
        });
        wrong
    }

    /// `names` are those of the links that joints move, where a file has any.
    fn table(&self, names: &[String], mistakes: &mut Vec<Mistake>) -> Option<AnyArm> {
        let joints = self.joint_origin.len() / 6;
        if self.joint_origin.is_empty() {
            let message = "robot.arm = \"own\" needs arm.urdf, or arm.joint_origin and what goes with it";
            mistakes.push(("robot.arm", message.into()));
            return None;
        }
        if !self.joint_origin.len().is_multiple_of(6) || !JOINTS.contains(&joints) {
            let message = format!(
                "arm.joint_origin has {} numbers; six for each joint of an arm of {} or {} joints are allowed",
                self.joint_origin.len(),
                JOINTS.start(),
                JOINTS.end()
            );
            // Without the number of joints no other list can be judged.
            mistakes.push(("arm.joint_origin", message));
            return None;
        }
        let mut table = AnyArm::NONE.table;
        for (origin, six) in table.joint_origin.iter_mut().zip(self.joint_origin.as_chunks().0) {
            *origin = *six;
        }
        let frame = "x, y, z, roll, pitch, yaw";
        if let Some(flange) = counted("arm.flange_origin", &self.flange_origin, 6, frame, mistakes) {
            table.flange_origin.copy_from_slice(flange);
            let lengths_m = table.joint_origin[1..joints].iter().chain([&table.flange_origin]);
            let length_m: f64 = lengths_m.map(|[x, y, z, ..]| x.hypot(*y).hypot(*z)).sum();
            if length_m < LENGTH_LEAST_M {
                let message = format!(
                    "arm.joint_origin and arm.flange_origin: the links are {length_m} m long together; at least \
                     {LENGTH_LEAST_M} m are needed between the first joint and the flange"
                );
                mistakes.push(("arm.joint_origin", message));
            }
        }
        self.put_links(&mut table, joints, names, mistakes);
        for (row, list, place) in [
            ("arm.q_min_rad", &self.q_min_rad, &mut table.q_min_rad),
            ("arm.q_max_rad", &self.q_max_rad, &mut table.q_max_rad),
            ("arm.dq_max_rad_s", &self.dq_max_rad_s, &mut table.dq_max_rad_s),
            ("arm.torque_max_nm", &self.torque_max_nm, &mut table.torque_max_nm),
            ("arm.home_rad", &self.home_rad, &mut table.home_rad),
        ] {
            if let Some(list) = counted(row, list, joints, "one for each joint", mistakes) {
                place[..joints].copy_from_slice(list);
            }
        }
        self.check_joints(joints, mistakes);
        self.check_capsules(joints, mistakes);
        for i in 0..joints {
            let stiffness = POSTURE.0 * (table.torque_max_nm[i] / POSTURE.1).min(1.0);
            table.posture_stiffness_nm_rad[i] = stiffness;
            table.posture_damping_nm_s_rad[i] = POSTURE_DAMPING_S * stiffness;
        }
        table.speed_envelope = self.envelope(joints, mistakes);
        Some(AnyArm { table, joints })
    }

    /// Finds every joint with an empty range, or with a first posture outside its range.
    fn check_joints(&self, joints: usize, mistakes: &mut Vec<Mistake>) {
        for i in 0..joints {
            let (Some(low), Some(high)) = (self.q_min_rad.get(i), self.q_max_rad.get(i)) else { continue };
            let joint = i + 1;
            if low >= high {
                let message = format!(
                    "arm.q_min_rad = {low} rad of joint {joint} is not below arm.q_max_rad = {high} rad"
                );
                mistakes.push(("arm.q_min_rad", message));
            } else if let Some(home) = self.home_rad.get(i).filter(|home| !(low..=high).contains(home)) {
                let message = format!(
                    "arm.home_rad = {home} rad of joint {joint} is outside its range, {low} to {high} rad"
                );
                mistakes.push(("arm.home_rad", message));
            }
        }
    }

    fn put_links(
        &self,
        table: &mut ArmTable<MAX_JOINTS>,
        joints: usize,
        names: &[String],
        mistakes: &mut Vec<Mistake>,
    ) {
        let links = joints + 1;
        let each = "one for each link, the first stands on the base";
        let masses = counted("arm.mass_kg", &self.mass_kg, links, each, mistakes);
        let coms = counted("arm.com_m", &self.com_m, 3 * links, "three for each link", mistakes);
        let inertias =
            counted("arm.inertia_com", &self.inertia_com, 6 * links, "six for each link", mistakes);
        let (Some(masses), Some(coms), Some(inertias)) = (masses, coms, inertias) else { return };
        let bodies = masses.iter().zip(coms.as_chunks().0).zip(inertias.as_chunks().0);
        for (i, ((mass_kg, com_m), inertia_com)) in bodies.enumerate() {
            let link = LinkInertial { mass_kg: *mass_kg, com_m: *com_m, inertia_com: *inertia_com };
            let name = i.checked_sub(1).and_then(|moved| names.get(moved));
            let name = name.map_or_else(|| format!("link {i}"), |name| format!("link \"{name}\" (link {i})"));
            // what stands on the base may be a point mass, or nothing
            let point = i == 0 && link.inertia_com.iter().all(|value| *value == 0.0);
            if i > 0 && link.mass_kg <= 0.0 {
                let message = format!(
                    "arm.mass_kg = 0 kg of {name}, which joint {i} moves; set arm.mass_kg, above 0 kg, and arm.inertia_com \
                     with it"
                );
                mistakes.push(("arm.mass_kg", message));
            } else if !point && let Some(why) = no_body(&link.inertia_com) {
                let message = format!("arm.inertia_com of {name} {why}; set arm.inertia_com");
                mistakes.push(("arm.inertia_com", message));
            }
            match i.checked_sub(1) {
                None => table.link0 = link,
                Some(joint) => table.links[joint] = link,
            }
        }
    }

    fn envelope(&self, joints: usize, mistakes: &mut Vec<Mistake>) -> Option<SpeedEnvelope<MAX_JOINTS>> {
        let (offsets, decelerations) = (&self.speed_offset_rad_s, &self.speed_deceleration_rad_s2);
        if offsets.is_empty() && decelerations.is_empty() {
            return None;
        }
        let mut envelope =
            SpeedEnvelope { offset_rad_s: [0.0; MAX_JOINTS], deceleration_rad_s2: [0.0; MAX_JOINTS] };
        let each = "one for each joint";
        let offsets = counted("arm.speed_offset_rad_s", offsets, joints, each, mistakes);
        let decelerations = counted("arm.speed_deceleration_rad_s2", decelerations, joints, each, mistakes);
        envelope.offset_rad_s[..joints].copy_from_slice(offsets?);
        envelope.deceleration_rad_s2[..joints].copy_from_slice(decelerations?);
        Some(envelope)
    }
}

/// A limit that a URDF gives a joint, if it does.
type OfLimit<'a> = &'a dyn Fn(&Limit) -> Option<f64>;

/// Limits of every joint, by their keys, or which joints a URDF says nothing of and what to set.
fn said<const K: usize>(
    joints: &[UrdfJoint],
    keys: [(&str, OfLimit<'_>); K],
    unit: &str,
) -> Result<[Vec<f64>; K], String> {
    let lacks = |joint: &&UrdfJoint| keys.iter().any(|(_, of)| of(&joint.limit).is_none());
    let Some(first) = joints.iter().find(lacks) else {
        return Ok(keys.map(|(_, of)| joints.iter().filter_map(|joint| of(&joint.limit)).collect()));
    };
    let others = joints.iter().filter(lacks).count() - 1;
    let more = if others > 0 { format!(" and {others} more") } else { String::new() };
    let lists = keys.map(|(key, of)| {
        let values = joints.iter().map(|joint| of(&joint.limit));
        let values: Vec<String> =
            values.map(|value| value.map_or_else(|| "?".into(), |value| format!("{value:?}"))).collect();
        format!("{key} = [{}]", values.join(", "))
    });
    let what = match keys[0].0 {
        "arm.dq_max_rad_s" => "velocity is 0 or missing: not said",
        "arm.torque_max_nm" => "effort is 0 or missing: not said",
        _ if first.continuous => "continuous, so without a range",
        _ => "lower and upper are 0 or missing: not said",
    };
    let name = &first.name;
    Err(format!("joint \"{name}\"{more}: {what}; set {} {unit}, with numbers for ?", lists.join(" and ")))
}

/// Returns the list if it has `count` numbers; notes the mistake otherwise.
fn counted<'a>(
    row: &'static str,
    list: &'a [f64],
    count: usize,
    of: &str,
    mistakes: &mut Vec<Mistake>,
) -> Option<&'a [f64]> {
    if list.len() == count {
        return Some(list);
    }
    mistakes.push((row, format!("{row} has {} numbers; {count} are needed, {of}", list.len())));
    None
}
