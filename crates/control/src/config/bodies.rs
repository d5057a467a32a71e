//! Inertias that a body can have.

use super::Config;
use moca_wbc::nalgebra::Matrix3;

/// Largest part of the sum of the principal moments by which an inertia may miss what a body can have: the last digits of a
/// file.
const ROUNDING: f64 = 1e-6;
/// Least principal moment of what a joint moves, kg·m²: a ball of 0.1 g and 0.2 mm.
const LEAST: f64 = 1e-12;

/// Reason why no moving body has the inertia xx, xy, xz, yy, yz, zz about its centre of mass; `None` if one can.
pub(super) fn no_body([xx, xy, xz, yy, yz, zz]: &[f64; 6]) -> Option<String> {
    let matrix = Matrix3::new(*xx, *xy, *xz, *xy, *yy, *yz, *xz, *yz, *zz);
    let mut principal: [f64; 3] = matrix.symmetric_eigenvalues().into();
    principal.sort_by(f64::total_cmp);
    let [least, middle, most] = principal;
    let slack = ROUNDING * (least + middle + most).abs();
    let possible = least >= LEAST && most <= least + middle + slack;
    if possible {
        return None;
    }
    if most == 0.0 && least == 0.0 {
        return Some("is 0, as of a point; what a joint moves has an inertia".into());
    }
    let [least, middle, most] =
        principal.map(|moment| if moment == 0.0 { "0".to_owned() } else { format!("{moment:.4e}") });
    Some(format!(
        "has the principal moments {least}, {middle} and {most} kg·m²; a body's are at least {LEAST:e} kg·m², and none is larger \
         than the other two together"
    ))
}

/// Tool and load: a point mass or a body.
pub(super) fn carried(config: &Config, report: &mut dyn FnMut(&str, String)) {
    let (tool, load) = (&config.robot.tool, &config.robot.load);
    for (key, mass_kg, inertia_com) in [
        ("robot.tool.inertia_com", tool.mass_kg, &tool.inertia_com),
        ("robot.load.inertia_com", load.mass_kg, &load.inertia_com),
    ] {
        let point = inertia_com.iter().all(|value| *value == 0.0);
        if mass_kg > 0.0
            && !point
            && let Some(why) = no_body(inertia_com)
        {
            report(key, format!("{key} {why}; correct it, or write zeros for a point mass"));
        } else if mass_kg <= 0.0 && !point {
            let mass = key.replace("inertia_com", "mass_kg");
            report(
                key,
                format!("{key} is that of a body without mass; set {mass}, above 0 kg, or write zeros"),
            );
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn impossible_inertia_is_named_by_its_principal_moments() {
        assert_eq!(no_body(&[0.02, 0.0, 0.0, 0.02, 0.0, 0.02]), None);
        // a thin plate, in turned axes
        assert_eq!(no_body(&[1.5, 0.5, 0.0, 1.5, 0.0, 3.0]), None);
        for (wrong, said) in [
            ([0.0; 6], "is 0, as of a point; what a joint moves has an inertia"),
            ([0.0, 0.0, 0.0, 0.0, 0.0, 1.0], "has the principal moments 0, 0 and 1.0000e0 kg·m²"),
            ([1.0, 0.0, 0.0, 1.0, 0.0, 2.1], "none is larger than the other two together"),
            ([1.0, 2.0, 0.0, 1.0, 0.0, 1.0], "a body's are at least 1e-12 kg·m²"),
            ([1e-14, 0.0, 0.0, 1e-14, 0.0, 1e-14], "a body's are at least 1e-12 kg·m²"),
        ] {
            let why = no_body(&wrong).unwrap();
            assert!(why.contains(said), "{wrong:?}: {why}");
        }
    }

    #[test]
    fn tool_is_a_point_mass_or_a_body() {
        let told = |toml: &str| Config::parse(toml).err().map(|error| error.to_string());
        assert_eq!(told("[robot.tool]\nmass_kg = 0.5\n"), None, "a point mass");
        assert_eq!(
            told("[robot.tool]\nmass_kg = 0.5\ninertia_com = [1e-3, 0.0, 0.0, 1e-3, 0.0, 1e-3]\n"),
            None
        );
        let wrong =
            told("[robot.load]\nmass_kg = 0.5\ninertia_com = [1e-3, 0.0, 0.0, 1e-3, 0.0, 9e-3]\n").unwrap();
        assert!(wrong.starts_with("line 3: robot.load.inertia_com has the principal moments"), "{wrong}");
        let no_mass = told("[robot.tool]\ninertia_com = [1e-3, 0.0, 0.0, 1e-3, 0.0, 1e-3]\n").unwrap();
        assert!(no_mass.contains("set robot.tool.mass_kg, above 0 kg"), "{no_mass}");
    }
}
