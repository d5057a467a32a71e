//! Stability of gains on the robot: the closed loop of every law in a posture, with the base's servo and the control rate.
//! Some milliseconds of work, so never in the loop: called when a file is read, and by the thread that receives a request.

use super::Config;
use super::live::changed;
use crate::robot::{JOINTS, Parts};
use moca_msgs::params::{CONTROLLER, Size};
use moca_msgs::robot::{AnyArm, LinkInertial};
use moca_msgs::{Corrections, Mount, ParameterValues, Parameters, Payload, TrueArm};
pub use moca_wbc::joint_stiffness::SPARE;
use moca_wbc::loop_stability::{ClosedLoop, Command, NO_GROWTH_PER_S};
use moca_wbc::opspace::ArmDynamics;
use moca_wbc::{ArmModel, ControlLaw};

/// Longest period that a controller counts, s.
const PERIOD_MAX_S: f64 = 0.01;
/// Error of the arm's masses that a compensation of unknown loads has to tolerate.
const UNKNOWN_SHARE: f64 = 0.25;
/// Halvings of the way to what is asked: to a 16000th of it.
const HALVINGS: u32 = 14;

/// Conditions of stability other than parameters and posture.
#[derive(Clone, Debug)]
pub struct Stability {
    arm: AnyArm,
    mount: Mount,
    /// Tool and load; with a gripper also those with its heaviest object.
    payloads: Vec<Payload>,
    servo_s: f64,
    parts: Parts,
    /// Time constant of the compensation of unknown loads, s; 0 for none.
    compensation_s: f64,
}

impl Stability {
    /// Builds the conditions of the configured robot.
    pub fn new(config: &Config) -> Self {
        let payload = config.robot.payload();
        let heaviest =
            config.plant.gripper.table().map(|gripper| {
                payload.with(&LinkInertial::point(gripper.object_max_kg, gripper.tip_flange_m))
            });
        Self {
            arm: *config.arm(),
            mount: config.robot.mount,
            payloads: std::iter::once(payload).chain(heaviest).collect(),
            servo_s: config.robot.base.servo_time_constant_s,
            parts: config.plant.parts,
            compensation_s: config.control.compensation.time_s,
        }
    }

    /// Returns true if every law stays stable at rest at `q_rad` with the compensation of unknown loads, on an arm whose masses are
    /// `UNKNOWN_SHARE` more or less than believed, or where there is no compensation.
    pub fn is_compensation_stable(&self, parameters: &Parameters<JOINTS>, q_rad: &[f64; JOINTS]) -> bool {
        match self.arm.joints {
            _ if !self.parts.has_arm() || self.compensation_s <= 0.0 => true,
            6 => self.is_compensation_stable_with::<6>(parameters, q_rad),
            7 => self.is_compensation_stable_with::<7>(parameters, q_rad),
            _ => false,
        }
    }

    fn is_compensation_stable_with<const N: usize>(
        &self,
        parameters: &Parameters<JOINTS>,
        q_rad: &[f64; JOINTS],
    ) -> bool {
        let Some(arm) = self.arm.table::<N>() else { return false };
        let q_rad = core::array::from_fn(|i| q_rad[i]);
        let parameters = parameters.resized::<N>();
        self.payloads.iter().all(|payload| {
            let closed = ClosedLoop::<N>::new(&arm, &self.mount, payload, self.servo_s, &parameters);
            // numbers that make no model are refused as such, elsewhere
            let Ok(closed) = closed else { return true };
            [1.0 - UNKNOWN_SHARE, 1.0 + UNKNOWN_SHARE].into_iter().all(|mass_scale| {
                let truth = TrueArm { mass_scale, ..TrueArm::AS_DESCRIBED }.applied(&self.arm);
                let plant = truth.table::<N>().map(|arm| ArmModel::new(&arm, &self.mount, payload));
                let Some(Ok(plant)) = plant else { return false };
                [ControlLaw::Impedance, ControlLaw::FollowMe, ControlLaw::Hold].into_iter().all(|law| {
                    let growth = closed.compensated_growth_per_s(law, &plant, self.compensation_s, &q_rad);
                    growth.is_ok_and(|growth_per_s| growth_per_s < NO_GROWTH_PER_S)
                })
            })
        })
    }

    /// Returns true if every law, hold included, is stable at rest at `q_rad` with a period [`SPARE`] times as long. A base without
    /// an arm always is.
    pub fn is_stable(&self, parameters: &Parameters<JOINTS>, q_rad: &[f64; JOINTS]) -> bool {
        match self.arm.joints {
            _ if !self.parts.has_arm() => true,
            6 => self.is_stable_with::<6>(parameters, q_rad),
            7 => self.is_stable_with::<7>(parameters, q_rad),
            _ => false,
        }
    }

    fn is_stable_with<const N: usize>(&self, parameters: &Parameters<JOINTS>, q_rad: &[f64; JOINTS]) -> bool {
        let Some(arm) = self.arm.table::<N>() else { return false };
        let mut parameters = parameters.resized::<N>();
        parameters.limits.period_s = (SPARE * parameters.limits.period_s).min(PERIOD_MAX_S);
        // An arm on a stand has the law that keeps the flange on the base, and no base to correct for.
        let laws: &[ControlLaw] = match self.parts {
            Parts::Arm => {
                parameters.corrections = Corrections::LITERAL;
                &[ControlLaw::FollowMe, ControlLaw::Hold]
            }
            _ => &[ControlLaw::Impedance, ControlLaw::FollowMe, ControlLaw::Hold],
        };
        let q_rad = core::array::from_fn(|i| q_rad[i]);
        self.payloads.iter().all(|payload| {
            let closed = ClosedLoop::<N>::new(&arm, &self.mount, payload, self.servo_s, &parameters);
            // parameters that are at odds with each other are refused as such, elsewhere
            closed.map_or(true, |closed| {
                laws.iter().all(|&law| {
                    let growth = closed.growth_per_s(law, Command::AtOnce, &q_rad);
                    growth.is_ok_and(|growth_per_s| growth_per_s < NO_GROWTH_PER_S)
                })
            })
        })
    }

    /// The first joint whose torque limit does not carry the arm in its posture, with the heaviest object in its gripper. Its number
    /// (0 is the first), the torque that gravity asks for and the limit, N·m.
    pub(super) fn too_heavy(&self, parameters: &Parameters<JOINTS>) -> Option<(usize, f64, f64)> {
        match self.arm.joints {
            _ if !self.parts.has_arm() => None,
            6 => self.too_heavy_with::<6>(parameters),
            7 => self.too_heavy_with::<7>(parameters),
            _ => None,
        }
    }

    /// Returns true if the arm is near a singularity in its posture.
    pub(super) fn is_singular(&self, parameters: &Parameters<JOINTS>) -> bool {
        match self.arm.joints {
            6 => self.is_singular_with::<6>(parameters),
            7 => self.is_singular_with::<7>(parameters),
            _ => false,
        }
    }

    fn is_singular_with<const N: usize>(&self, parameters: &Parameters<JOINTS>) -> bool {
        let Some(arm) = self.arm.table::<N>() else { return false };
        // numbers that make no model are refused as such, elsewhere
        let model = self.payloads.first().map(|payload| ArmModel::<N, f64>::new(&arm, &self.mount, payload));
        let Some(Ok(model)) = model else { return false };
        let q_rad: [f64; N] = core::array::from_fn(|i| parameters.gains.posture_rad[i]);
        let dynamics = model.dynamics(0.0, &q_rad, &[0.0; N]);
        ArmDynamics::new(&dynamics).is_ok_and(|arm| arm.is_singular())
    }

    fn too_heavy_with<const N: usize>(&self, parameters: &Parameters<JOINTS>) -> Option<(usize, f64, f64)> {
        let payload = self.payloads.last()?;
        // numbers that make no model are refused as such, elsewhere
        let model = ArmModel::<N, f64>::new(&self.arm.table::<N>()?, &self.mount, payload).ok()?;
        let q_rad: [f64; N] = core::array::from_fn(|i| parameters.gains.posture_rad[i]);
        let needed_nm = model.dynamics(0.0, &q_rad, &[0.0; N]).bias;
        (0..N)
            .map(|i| (i, needed_nm[i].abs(), parameters.limits.torque_nm[i]))
            .find(|(_, needed, most)| needed > most)
    }

    /// Returns the stable values of parameter `number` nearest to `asked`, on the straight way there from those in `present`, at
    /// rest at `q_rad`; no elements if those in `present` are not stable either. `None` if `asked` itself is
    /// stable.
    pub fn nearest_stable(
        &self,
        present: &Parameters<JOINTS>,
        number: usize,
        asked: &ParameterValues,
        q_rad: &[f64; JOINTS],
    ) -> Option<ParameterValues> {
        let before = present.get(number)?;
        let at = |share: f64| {
            let ends = before.as_slice().iter().zip(asked.as_slice());
            let values: Vec<f64> = ends.map(|(before, asked)| before + share * (asked - before)).collect();
            ParameterValues::new(&values).unwrap_or_default()
        };
        let stable = |share: f64| {
            changed(present, self.arm.joints, number, &at(share))
                .is_ok_and(|parameters| self.is_stable(&parameters, q_rad))
        };
        if stable(1.0) {
            return None;
        }
        if !stable(0.0) {
            return Some(ParameterValues::default());
        }
        Some(at(largest_share(stable)))
    }

    /// The element of a gain that alone is to blame for `parameters` that are not stable in their own posture; `None` where
    /// it takes several.
    pub(super) fn one_to_blame(
        &self,
        parameters: &Parameters<JOINTS>,
        defaults: &Parameters<JOINTS>,
    ) -> Option<OneToBlame> {
        let (joints, q_rad) = (self.arm.joints, &parameters.gains.posture_rad);
        for (number, row) in CONTROLLER.iter().enumerate() {
            let (values, default) = (parameters.get(number)?, defaults.get(number)?);
            let (values, default) = (values.as_slice(), default.as_slice());
            let count = if row.size == Size::Joints { joints } else { values.len() };
            for element in (0..count).filter(|element| (values[*element] - default[*element]).abs() > 0.0) {
                let with = |value: f64| {
                    let mut list = values.get(..count)?.to_vec();
                    list[element] = value;
                    ParameterValues::new(&list)
                };
                let asked = with(values[element])?;
                let Ok(mended) = changed(parameters, joints, number, &with(default[element])?) else {
                    continue;
                };
                if !self.is_stable(&mended, q_rad) {
                    continue;
                }
                let nearest = self.nearest_stable(&mended, number, &asked, q_rad)?;
                let nearest = *nearest.as_slice().get(element)?;
                let alone = count == 1;
                return Some(OneToBlame { number, element, alone, value: values[element], nearest });
            }
        }
        None
    }

    /// The gain that alone is to blame for `parameters` that are not stable in their own posture: its number, its value and
    /// what is nearest to that and stable; `None` where it takes several.
    pub(super) fn to_blame(
        &self,
        parameters: &Parameters<JOINTS>,
        defaults: &Parameters<JOINTS>,
    ) -> Option<(usize, ParameterValues, ParameterValues)> {
        let (joints, q_rad) = (self.arm.joints, &parameters.gains.posture_rad);
        let values = |of: &Parameters<JOINTS>, number: usize| {
            let elements = of.get(number)?;
            let all = elements.as_slice();
            let count = if CONTROLLER[number].size == Size::Joints { joints } else { all.len() };
            ParameterValues::new(all.get(..count)?)
        };
        (0..CONTROLLER.len()).find_map(|number| {
            let (value, default) = (values(parameters, number)?, values(defaults, number)?);
            let mended = changed(parameters, joints, number, &default).ok()?;
            if value == default || !self.is_stable(&mended, q_rad) {
                return None;
            }
            Some((number, value, self.nearest_stable(&mended, number, &value, q_rad)?))
        })
    }

    /// Returns the gains that differ from the defaults, with the nearest values that are stable together, on the straight way
    /// from the defaults; `None` if the defaults are not stable either.
    pub(super) fn nearest_together(
        &self,
        parameters: &Parameters<JOINTS>,
        defaults: &Parameters<JOINTS>,
    ) -> Option<Vec<(usize, ParameterValues)>> {
        let (joints, q_rad) = (self.arm.joints, &parameters.gains.posture_rad);
        let blend = |number: usize, share: f64| {
            let (from, to) = (defaults.get(number)?, parameters.get(number)?);
            let count = if CONTROLLER[number].size == Size::Joints { joints } else { to.as_slice().len() };
            let ends = from.as_slice().iter().zip(to.as_slice()).take(count);
            ParameterValues::new(&ends.map(|(from, to)| from + share * (to - from)).collect::<Vec<_>>())
        };
        let other = |number: &usize| {
            !CONTROLLER[*number].name.ends_with("posture_rad") && blend(*number, 0.0) != blend(*number, 1.0)
        };
        let gains: Vec<usize> = (0..CONTROLLER.len()).filter(other).collect();
        let stable = |share: f64| {
            let mut all = *parameters;
            for &number in &gains {
                let Some(Ok(next)) =
                    blend(number, share).map(|values| changed(&all, joints, number, &values))
                else {
                    return false;
                };
                all = next;
            }
            self.is_stable(&all, q_rad)
        };
        if !stable(0.0) {
            return None;
        }
        let most = largest_share(stable);
        Some(gains.iter().filter_map(|&number| Some((number, blend(number, most)?))).collect())
    }
}

/// Returns the largest share of the way from a stable to an unstable point that is still `stable`, and a little less: typed
/// with four digits the value is stable too.
fn largest_share(stable: impl Fn(f64) -> bool) -> f64 {
    let (mut low, mut high) = (0.0, 1.0);
    for _ in 0..HALVINGS {
        let middle = 0.5 * (low + high);
        if stable(middle) {
            low = middle;
        } else {
            high = middle;
        }
    }
    0.999 * low
}

/// One number of a gain that makes the robot unstable.
pub(super) struct OneToBlame {
    /// Row of [`CONTROLLER`].
    pub(super) number: usize,
    /// Which element of it.
    pub(super) element: usize,
    alone: bool,
    /// Its value.
    pub(super) value: f64,
    /// Nearest value that is stable.
    pub(super) nearest: f64,
}

impl OneToBlame {
    /// Its place in the gain's list, for people.
    pub(super) fn place(&self) -> String {
        match CONTROLLER[self.number].size {
            _ if self.alone => String::new(),
            Size::Joints => format!(" of joint {}", self.element + 1),
            _ => format!(", number {} of its list,", self.element + 1),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn number(name: &str) -> usize {
        CONTROLLER.iter().position(|row| row.name.ends_with(name)).unwrap()
    }

    fn nearest(config: &Config, name: &str, values: &[f64]) -> Option<Vec<f64>> {
        let present = config.parameters();
        let asked = ParameterValues::new(values).unwrap();
        let home = present.gains.posture_rad;
        let nearest = Stability::new(config).nearest_stable(&present, number(name), &asked, &home);
        nearest.map(|values| values.as_slice().to_vec())
    }

    #[test]
    fn what_let_the_arm_run_away_is_refused_with_what_it_bears() {
        let config = Config::default();
        for (name, values) in [
            ("gains.stiffness", &[1e5; 6][..]),
            ("gains.stiffness", &[2e4; 6]),
            ("posture_stiffness", &[1e4; 7]),
            ("posture_damping", &[1e3; 7]),
        ] {
            let stable = nearest(&config, name, values).unwrap_or_else(|| panic!("{name} {values:?}"));
            println!("{name} = {values:?}: {stable:.1?}");
            assert_eq!(nearest(&config, name, &stable), None, "{name}: {stable:?} is not stable");
            let present = config.parameters().get(number(name)).unwrap();
            let further: Vec<f64> = stable
                .iter()
                .zip(present.as_slice())
                .zip(values)
                .map(|((stable, before), asked)| stable + 0.01 * (asked - before))
                .collect();
            assert!(nearest(&config, name, &further).is_some(), "{name}: {further:?} is stable, too");
        }
        assert_eq!(nearest(&config, "reactivity", &[3.0]), None);
        assert_eq!(nearest(&config, "reactivity", &[10.0]), None);
        assert_eq!(nearest(&config, "null_space_damping", &[0.0]), None);
    }

    #[test]
    fn arm_too_heavy_for_its_motors_is_refused_by_joint() {
        let load = |mass_kg: f64| Config::parse(&format!("[robot.load]\nmass_kg = {mass_kg}\n"));
        assert!(load(3.0).is_ok());
        let said = load(60.0).unwrap_err().to_string();
        assert!(
            said.starts_with("control.gains.posture_rad: joint 2 needs ")
                && said.contains("limits.torque_nm has 87 N·m"),
            "{said}"
        );
        let needed_nm: f64 = said.split_once("needs ").unwrap().1.split_once(' ').unwrap().0.parse().unwrap();
        assert!((150.0..250.0).contains(&needed_nm), "60 kg at a third of a metre: {said}");
        let weak =
            Config::parse("[limits]\ntorque_nm = [87.0, 87.0, 87.0, 5.0, 12.0, 12.0, 12.0]\n").unwrap_err();
        assert!(
            weak.to_string().contains("joint 4 needs") && weak.to_string().contains("has 5 N·m"),
            "{weak}"
        );
        assert!(Config::parse("[robot.load]\nmass_kg = 60.0\n[plant]\nparts = \"base\"\n").is_ok());
    }

    #[test]
    fn heaviest_object_of_a_gripper_counts_like_a_load() {
        use crate::robot::GripperKind;
        let mut config = Config::default();
        let home = config.parameters().gains.posture_rad;
        let needed = |config: &Config| {
            let mut weak = config.parameters();
            weak.limits.torque_nm = [1.0; JOINTS];
            let (joint, needed_nm, _) = Stability::new(config).too_heavy(&weak).unwrap();
            assert_eq!(joint, 1, "joint 1 turns about the vertical");
            needed_nm
        };
        let bare_nm = needed(&config);
        config.plant.gripper = GripperKind::Simulated;
        let gripper_nm = needed(&config);
        assert!(gripper_nm > bare_nm + 5.0, "2.27 kg: {bare_nm} N·m without, {gripper_nm} with");
        config.plant.gripper = GripperKind::None;
        let tip = moca_msgs::gripper::FRANKA_HAND.tip_flange_m;
        (config.robot.load.mass_kg, config.robot.load.com_m) = (2.27, tip);
        assert_eq!(needed(&config).to_bits(), gripper_nm.to_bits());
        // The load makes a stiff posture less stable and a stiff flange more: both ends count.
        let loaded = config.clone();
        (config.robot.load.mass_kg, config.robot.load.com_m) = (0.0, [0.0; 3]);
        let bare = config.clone();
        config.plant.gripper = GripperKind::Simulated;
        let stable = |stiffness: f64, posture: f64| {
            [&bare, &loaded, &config].map(|config| {
                let mut parameters = config.parameters();
                parameters.gains.stiffness.iter_mut().for_each(|k| *k *= stiffness);
                parameters.gains.posture_stiffness.iter_mut().for_each(|k| *k *= posture);
                Stability::new(config).is_stable(&parameters, &home)
            })
        };
        assert_eq!(stable(1.0, 1.0), [true, true, true]);
        assert_eq!(stable(1.0, 69.0), [true, false, false]);
        assert_eq!(stable(61.0, 1.0), [false, true, false]);
    }

    #[test]
    fn gains_unstable_together_are_named_with_stable_values() {
        let mut config = Config::default();
        let defaults = config.parameters();
        config.control.gains.stiffness = [1e5; 6];
        config.control.gains.posture_stiffness[..7].fill(1e4);
        let parameters = config.parameters();
        let stability = Stability::new(&config);
        let home = parameters.gains.posture_rad;
        assert!(!stability.is_stable(&parameters, &home));
        assert!(stability.to_blame(&parameters, &defaults).is_none(), "each alone is too much");
        let nearest = stability.nearest_together(&parameters, &defaults).unwrap();
        assert_eq!(nearest.len(), 2, "{nearest:?}");
        let mut mended = parameters;
        for (number, values) in &nearest {
            mended = changed(&mended, 7, *number, values).unwrap();
        }
        assert!(stability.is_stable(&mended, &home), "{nearest:?}");
    }

    #[test]
    fn parts_and_joints_count() {
        let mut config = Config::default();
        for parts in [Parts::Whole, Parts::Arm] {
            config.plant.parts = parts;
            assert!(nearest(&config, "gains.stiffness", &[1e5; 6]).is_some(), "{parts:?}");
            assert!(
                nearest(&config, "gains.stiffness", &[1000.0, 1000.0, 1000.0, 60.0, 60.0, 60.0]).is_none()
            );
        }
        config.plant.parts = Parts::Base;
        assert!(nearest(&config, "gains.stiffness", &[1e5; 6]).is_none(), "there is no arm");
        let six = Config::parse("[robot]\narm = \"ur10e\"\n").unwrap();
        assert!(nearest(&six, "gains.stiffness", &[1e5; 6]).is_some());
        let heavier_than_a_panda = &[1e4; 6];
        assert!(nearest(&six, "posture_stiffness", heavier_than_a_panda).is_none());
    }

    #[test]
    fn from_gains_that_are_not_stable_nothing_unstable_is_near() {
        let mut config = Config::default();
        config.control.gains.stiffness = [1e5; 6];
        assert_eq!(nearest(&config, "damping_ratio", &[0.8]), Some(Vec::new()));
        assert_eq!(nearest(&config, "gains.stiffness", &[800.0, 800.0, 800.0, 40.0, 40.0, 40.0]), None);
    }

    #[test]
    fn unstable_gain_is_named_with_nearest_stable_value() {
        let mistakes = |text: &str| Config::parse(text).unwrap_err().mistakes;
        let said = mistakes("[control.gains]\nstiffness = [800.0, 800.0, 800.0, 2e4, 40.0, 40.0]\n");
        println!("{said:?}");
        assert_eq!(said.len(), 1, "{said:?}");
        assert!(
            said[0].starts_with(
                "line 2: control.gains.stiffness, number 4 of its list, = 20000 N·m/rad is not stable at loop.rate_hz = \
                 1000 Hz in control.gains.posture_rad; the nearest stable value is "
            ),
            "{said:?}"
        );
        let nearest: f64 = said[0].rsplit_once(" is ").unwrap().1.split_once(' ').unwrap().0.parse().unwrap();
        let list = format!("[control.gains]\nstiffness = [800.0, 800.0, 800.0, {nearest}, 40.0, 40.0]\n");
        assert!(Config::parse(&list).is_ok() && nearest > 40.0, "what is named is stable: {list}");
        let of_joint = number("posture_damping");
        let one = OneToBlame { number: of_joint, element: 4, alone: false, value: 900.0, nearest: 9.0 };
        assert_eq!(one.place(), " of joint 5");
        // two numbers that are too large: the whole list is to blame
        let said = mistakes("[control.gains]\nstiffness = [800.0, 800.0, 800.0, 2e4, 2e4, 40.0]\n");
        assert!(said[0].contains("on the way there [800.0, 800.0, 800.0,"), "{said:?}");
        // several gains that are each too large: none of them alone is to blame
        let said = mistakes(
            "[control.gains]\nstiffness = [800.0, 800.0, 800.0, 2e4, 2e4, 40.0]\n\
             posture_damping = [1e3, 1e3, 1e3, 1e3, 1e3, 1e3, 1e3]\n",
        );
        assert!(said[0].contains("control.gains: not stable in") && said[0].contains("1000 Hz"), "{said:?}");
        assert!(
            Config::parse("[plant]\nkind = \"none\"\n[board]\nport = \"auto\"\n[loop]\nrate_hz = 100\n")
                .is_ok()
        );
        // what is out of range is said instead
        let said = mistakes("[control.gains]\nstiffness = [2e5, 800.0, 800.0, 2e4, 40.0, 40.0]\n");
        assert!(said.len() == 1 && said[0].contains("is outside"), "{said:?}");
    }
}
