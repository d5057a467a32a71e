//! Whether gains suit the robot: the closed loop of both laws in a posture, with the base's servo and the control rate.
//! Some milliseconds of work, so never in the loop: asked when a file is read, and by the thread that a request comes to.

use super::Config;
use super::live::changed;
use crate::robot::{JOINTS, Parts};
use moca_msgs::params::{CONTROLLER, Size};
use moca_msgs::robot::AnyArm;
use moca_msgs::{Corrections, Law, Mount, ParameterValues, Parameters, Payload};
use moca_wbc::loop_stability::{ClosedLoop, Command, NO_GROWTH_PER_S};

/// The loop must be stable with a period this many times its own: a margin for what the linearised loop leaves out.
pub const SPARE: f64 = 1.25;
/// Longest period that a controller counts, s.
const PERIOD_MAX_S: f64 = 0.01;
/// Halvings of the way to what is asked: to a 16000th of it.
const HALVINGS: u32 = 14;

/// What stability depends on besides parameters and posture.
#[derive(Clone, Debug)]
pub struct Stability {
    arm: AnyArm,
    mount: Mount,
    payload: Payload,
    servo_s: f64,
    parts: Parts,
}

impl Stability {
    /// Of the configured robot.
    pub fn new(config: &Config) -> Self {
        Self {
            arm: *config.arm(),
            mount: config.robot.mount,
            payload: config.robot.payload(),
            servo_s: config.robot.base.servo_time_constant_s,
            parts: config.plant.parts,
        }
    }

    /// Whether both laws are stable at rest at `q_rad`, with a period [`SPARE`] times as long to spare. A base without an
    /// arm always is.
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
        let laws: &[Law] = match self.parts {
            Parts::Arm => {
                parameters.corrections = Corrections::LITERAL;
                &[Law::FollowMe]
            }
            _ => &[Law::Impedance, Law::FollowMe],
        };
        let q_rad = core::array::from_fn(|i| q_rad[i]);
        let closed = ClosedLoop::<N>::new(&arm, &self.mount, &self.payload, self.servo_s, &parameters);
        // parameters that are at odds with each other are refused as such, elsewhere
        closed.map_or(true, |closed| {
            laws.iter().all(|&law| {
                let growth = closed.growth_per_s(law, Command::AtOnce, &q_rad);
                growth.is_ok_and(|growth_per_s| growth_per_s < NO_GROWTH_PER_S)
            })
        })
    }

    /// What is nearest to `asked` of the values of parameter `number` that are stable, on the straight way there from
    /// those in `present`, at rest at `q_rad`; no elements if those in `present` are not stable either. `None` where
    /// `asked` itself is.
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
        let (mut low, mut high) = (0.0, 1.0);
        for _ in 0..HALVINGS {
            let middle = 0.5 * (low + high);
            if stable(middle) {
                low = middle;
            } else {
                high = middle;
            }
        }
        // A little less, so that the value is still stable when somebody types it with four digits.
        Some(at(0.999 * low))
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
    fn a_file_is_told_which_gain_is_to_blame_and_what_the_robot_bears() {
        let mistakes = |text: &str| Config::parse(text).unwrap_err().mistakes;
        let said = mistakes("[control.gains]\nstiffness = [800.0, 800.0, 800.0, 2e4, 40.0, 40.0]\n");
        println!("{said:?}");
        assert_eq!(said.len(), 1, "{said:?}");
        assert!(
            said[0].starts_with(
                "line 2: control.gains.stiffness = [800.0, 800.0, 800.0, 20000.0, 40.0, 40.0] is not stable"
            ),
            "{said:?}"
        );
        assert!(said[0].contains("on the way there [800.0, 800.0, 800.0,"), "{said:?}");
        // too slow for the default gains: none of them alone is to blame
        let said = mistakes("[loop]\nrate_hz = 100\n");
        assert!(said[0].contains("control.gains: not stable in") && said[0].contains("100 Hz"), "{said:?}");
        assert!(
            Config::parse("[plant]\nkind = \"none\"\n[board]\nport = \"auto\"\n[loop]\nrate_hz = 100\n")
                .is_ok()
        );
        // what is out of range is said instead
        let said = mistakes("[control.gains]\nstiffness = [2e5, 800.0, 800.0, 2e4, 40.0, 40.0]\n");
        assert!(said.len() == 1 && said[0].contains("is outside"), "{said:?}");
    }
}
