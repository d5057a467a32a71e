//! The guard against self-collision that a configuration asks for.

use super::Config;
use moca_msgs::ParameterError;
use moca_wbc::ArmModel;
use moca_wbc::self_collision::{DISTANCES_M, SelfCollision, Solids};

impl Config {
    /// Solids of the robot: capsules of arm and tool, and the box of the base out to its taxels.
    pub fn solids(&self) -> Solids<'_> {
        let (tool, robot) = (&self.robot.tool, &self.robot);
        let [x0, y0, z0, x1, y1, z1] = tool.capsule_ends_m;
        let base_size_m = self.plant.parts.has_cover().then(|| {
            let furthest =
                |half: f64, places_m: &[f64]| 2.0 * places_m.iter().fold(half, |most, v| most.max(v.abs()));
            let [length, width, height] = robot.base.size_m;
            [furthest(0.5 * length, &robot.cover.x_m), furthest(0.5 * width, &robot.cover.y_m), height]
        });
        Solids {
            capsules: &robot.arm.capsules,
            tool: (tool.capsule_radius_m > 0.0)
                .then_some(([[x0, y0, z0], [x1, y1, z1]], tool.capsule_radius_m)),
            base_size_m,
        }
    }

    /// Guard of an arm of `N` joints; `None` where it is off or there is no such arm.
    ///
    /// # Errors
    /// The first number of the solids out of range.
    pub fn self_collision<const N: usize>(&self) -> Result<Option<SelfCollision<N, f64>>, ParameterError> {
        let least_m = self.control.self_collision.distance_m;
        let arm = self.arm().table::<N>().filter(|_| least_m > 0.0 && self.plant.parts.has_arm());
        arm.map(|arm| SelfCollision::new(&arm, &self.robot.mount, &self.solids(), least_m)).transpose()
    }
}

/// A guard needs capsules, and a posture that it allows.
pub(super) fn check(config: &Config, report: &mut dyn FnMut(&str, String)) {
    let (name, least_m) = ("control.self_collision.distance_m", config.control.self_collision.distance_m);
    if least_m <= 0.0 || !config.plant.parts.has_arm() {
        return;
    }
    let [least, most] = DISTANCES_M;
    if least_m < least {
        report(name, format!("{name} = {least_m} m is outside {least} to {most} m; 0 m is off"));
        return;
    }
    if config.robot.arm.capsules.is_empty() {
        let arm = &config.robot.arm.source;
        report(
            name,
            format!(
                "{name} = {least_m} m needs capsules, and robot.arm = \"{arm}\" has none; give arm.urdf with <collision> shapes, or \
                 arm.capsule_link and what goes with it, or set {name} to 0"
            ),
        );
        return;
    }
    let wrong = match config.arm().joints {
        6 => posture::<6>(config),
        7 => posture::<7>(config),
        _ => None,
    };
    if let Some(why) = wrong {
        report(name, format!("{name} = {least_m} m: {why}"));
    }
}

/// Reason why the guard cannot be built or does not allow the posture of the null space.
fn posture<const N: usize>(config: &Config) -> Option<String> {
    let guard = match config.self_collision::<N>() {
        Ok(guard) => guard?,
        Err(error) => return Some(error.to_string()),
    };
    let model =
        ArmModel::<N, f64>::new(&config.arm().table()?, &config.robot.mount, &config.robot.payload()).ok()?;
    let posture_rad = config.parameters().resized::<N>().gains.posture_rad;
    let nearest = guard.nearest(&model.kinematics(0.0, &posture_rad))?;
    let ([one, other], distance_m) = (nearest.parts, nearest.distance);
    (distance_m < guard.least()).then(|| {
        format!(
            "in control.gains.posture_rad {one} and {other} are {distance_m:.3} m apart; give a posture (arm.home_rad of an arm of your \
             own) in which they are further apart, or smaller capsules"
        )
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn told(toml: &str) -> Option<String> {
        Config::parse(toml).err().map(|error| error.to_string())
    }

    #[test]
    fn one_key_turns_the_guard_on() {
        let off = Config::default();
        assert!(off.self_collision::<7>().unwrap().is_none());
        let on = Config::parse("control.self_collision.distance_m = 0.02\n").unwrap();
        let guard = on.self_collision::<7>().unwrap().unwrap();
        assert!(guard.compares(0, 7) && !guard.compares(6, 7) && guard.pairs() > 40);
        assert!(on.self_collision::<6>().unwrap().is_none(), "the arm has seven joints");
        let base =
            Config::parse("plant.parts = \"base\"\ncontrol.self_collision.distance_m = 0.02\n").unwrap();
        assert!(base.self_collision::<7>().unwrap().is_none(), "no arm");
        let stand =
            Config::parse("plant.parts = \"arm\"\ncontrol.self_collision.distance_m = 0.02\n").unwrap();
        let alone = stand.self_collision::<7>().unwrap().unwrap();
        assert!(alone.pairs() < guard.pairs(), "no base");
    }

    #[test]
    fn box_of_the_base_reaches_out_to_the_taxels() {
        let mut config = Config::default();
        config.robot.cover.x_m[0] = -0.6;
        let [length, width, height] = config.solids().base_size_m.unwrap();
        let [_, own_width, own_height] = config.robot.base.size_m;
        assert!((length - 1.2).abs() < 1e-12 && width >= own_width && (height - own_height).abs() < 1e-12);
    }

    #[test]
    fn distance_or_posture_that_no_guard_allows_is_refused() {
        let why = told("control.self_collision.distance_m = 0.001\n").unwrap();
        assert!(
            why.contains("control.self_collision.distance_m = 0.001 m is outside 0.005 to 0.1 m; 0 m is off"),
            "{why}"
        );
        let why = told("robot.arm = \"ur10e\"\ncontrol.self_collision.distance_m = 0.02\n").unwrap();
        assert!(why.contains("needs capsules, and robot.arm = \"ur10e\" has none"), "{why}");
        let tool = "[robot.tool]\ncapsule_ends_m = [0.0, 0.0, 0.0, 0.0, 0.0, 1.0]\ncapsule_radius_m = 0.05\n";
        let why = told(&format!("control.self_collision.distance_m = 0.02\n{tool}")).unwrap();
        assert!(why.contains("in control.gains.posture_rad the tool and the base are -"), "{why}");
        assert_eq!(told(tool), None, "off, nobody asks");
    }
}
