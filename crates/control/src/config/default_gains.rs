//! Gains of the arm that nobody has written: as stiff as inertia, control rate and robot allow, at most those of its table.

use super::Config;
use super::stability::Stability;
use crate::robot::{JOINTS, PlantKind};
use moca_msgs::{ImpedanceGains, Parameters};
use moca_wbc::{ArmModel, joint_stiffness};

/// The gains that are chosen here, by their keys.
const STIFFNESS: &str = "control.gains.stiffness";
const POSTURE_STIFFNESS: &str = "control.gains.posture_stiffness";
const POSTURE_DAMPING: &str = "control.gains.posture_damping";
/// Halvings before nothing more is tried.
const HALVINGS: usize = 14;

/// `config` with the gains of its own arm, rate and robot.
pub(super) fn defaults(config: &Config) -> Config {
    let mut defaults = config.clone();
    defaults.control.gains = ImpedanceGains::for_arm(&config.arm().table);
    defaults.limits = Config::with_arm(config.robot.arm.clone()).limits;
    settle(&mut defaults, |_| false);
    defaults
}

/// Lowers gains that are not `written` until the robot is stable in its posture. What is stable stays as it is; what no gain
/// that may be lowered makes stable stays too, and is refused as it is.
pub(super) fn settle(config: &mut Config, written: impl Fn(&str) -> bool) {
    let stability = Stability::new(config);
    let stable = |config: &Config| {
        let parameters = config.parameters();
        stability.is_stable(&parameters, &parameters.gains.posture_rad)
    };
    // an arm that its motors do not carry is at no rest, whatever its gains
    let too_heavy = || stability.too_heavy(&config.parameters()).is_some();
    if config.plant.kind == PlantKind::None || stable(config) || too_heavy() {
        return;
    }
    let before = config.control.gains;
    if !written(POSTURE_STIFFNESS) && !written(POSTURE_DAMPING) {
        bound_posture(config);
    }
    if stable(config) {
        return;
    }
    let bounded = config.control.gains;
    // a light wrist first: its rotations are the fastest motions
    for axes in [3..6, 0..6] {
        config.control.gains = bounded;
        for _ in 0..HALVINGS {
            let gains = &mut config.control.gains;
            if !written(STIFFNESS) {
                gains.stiffness[axes.clone()].iter_mut().for_each(|stiffness| *stiffness *= 0.5);
            }
            if axes.start == 0 {
                for (key, list) in [
                    (POSTURE_STIFFNESS, &mut gains.posture_stiffness),
                    (POSTURE_DAMPING, &mut gains.posture_damping),
                ] {
                    if !written(key) {
                        list.iter_mut().for_each(|gain| *gain *= 0.5);
                    }
                }
            }
            if stable(config) {
                return;
            }
        }
    }
    config.control.gains = before;
}

/// Lowers posture gains joint by joint to what inertia and rate allow in the posture.
fn bound_posture(config: &mut Config) {
    let most = match config.arm().joints {
        6 => largest_damping::<6>(config),
        7 => largest_damping::<7>(config),
        _ => None,
    };
    let gains = &mut config.control.gains;
    for (i, most) in most.into_iter().flatten().enumerate() {
        let share = most / gains.posture_damping[i];
        if share < 1.0 {
            gains.posture_damping[i] *= share;
            gains.posture_stiffness[i] *= share;
        }
    }
}

/// Largest damping of each joint in the posture, N·m·s/rad.
fn largest_damping<const N: usize>(config: &Config) -> Option<[f64; JOINTS]> {
    let Parameters { gains, limits, .. } = config.parameters();
    let arm = config.arm().table::<N>()?;
    // numbers that make no model are refused as such, elsewhere
    let model = ArmModel::<N, f64>::new(&arm, &config.robot.mount, &config.robot.payload()).ok()?;
    let q_rad: [f64; N] = std::array::from_fn(|i| gains.posture_rad[i]);
    let mass = model.dynamics(0.0, &q_rad, &[0.0; N]).mass;
    let most = joint_stiffness::largest_damping(&mass, limits.period_s);
    Some(std::array::from_fn(|i| most.get(i).copied().unwrap_or(f64::INFINITY)))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn parsed(toml: &str) -> Config {
        Config::parse(toml).unwrap_or_else(|error| panic!("{toml}: {error}"))
    }

    #[test]
    fn stable_defaults_stay_and_others_are_lowered_until_they_are() {
        let panda = Config::default().control.gains;
        assert_eq!(parsed("[robot]\narm = \"panda\"\n").control.gains, panda);
        for rate_hz in [100, 200, 250, 333, 500] {
            for arm in ["panda", "fr3", "ur10e"] {
                let config = parsed(&format!("[robot]\narm = \"{arm}\"\n[loop]\nrate_hz = {rate_hz}\n"));
                let (lowered, parameters) = (config.control.gains, config.parameters());
                let stability = Stability::new(&config);
                assert!(stability.is_stable(&parameters, &lowered.posture_rad), "{arm} {rate_hz} Hz");
                let table = ImpedanceGains::for_arm(&config.arm().table);
                let lists = [
                    (&lowered.stiffness[..], &table.stiffness[..]),
                    (&lowered.posture_damping[..], &table.posture_damping[..]),
                ];
                for (lowered, of_table) in lists {
                    assert!(
                        lowered.iter().zip(of_table).all(|(low, table)| low <= table),
                        "{arm} {rate_hz} Hz"
                    );
                }
            }
        }
        let slow = parsed("[loop]\nrate_hz = 100\n").control.gains;
        assert!(slow.posture_damping[6] < 0.5 * panda.posture_damping[6], "{slow:?}");
        assert!(slow.posture_damping[1] > 0.9 * panda.posture_damping[1], "the shoulder is heavy: {slow:?}");
    }

    #[test]
    #[expect(clippy::float_cmp, reason = "kept as it was written")]
    fn gain_that_is_written_is_not_lowered() {
        let stiff = "[control.gains]\nstiffness = [800.0, 800.0, 800.0, 2e4, 40.0, 40.0]\n";
        let refused = Config::parse(stiff).unwrap_err().to_string();
        assert!(
            refused.contains("control.gains.stiffness, number 4 of its list, = 20000 N·m/rad"),
            "{refused}"
        );
        let kept = parsed(
            "[control.gains]\nstiffness = [300.0, 300.0, 300.0, 7.0, 7.0, 7.0]\n[loop]\nrate_hz = 200\n",
        );
        assert_eq!(kept.control.gains.stiffness, [300.0, 300.0, 300.0, 7.0, 7.0, 7.0]);
    }

    #[test]
    fn lowered_gains_are_written_and_read_back() {
        let config = parsed("[robot]\narm = \"ur10e\"\n[loop]\nrate_hz = 200\n");
        assert_eq!(parsed(&toml::to_string(&config.to_toml()).unwrap()), config);
    }
}
