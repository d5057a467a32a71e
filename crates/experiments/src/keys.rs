//! Everything an experiment can be told with `--set key=value`: the rows of the daemon's configuration, by their dotted
//! names or the laboratory's short ones, and one table of what only an experiment has.

use crate::TAXELS;
use crate::settings::{self, Sensor, Settings};
use anyhow::{Context, Result, anyhow, bail, ensure};
use moca_control::config::{AssumedModel, BarrierReadings, Config, ProtectionConfig};
use moca_control::robot::FlangeSensorKind;
use moca_lockstep::TrueForces;
use moca_msgs::table::{FieldValue, ParameterKind, ParameterSpec, Size};
use moca_sim::foam::Foam;
use moca_sim::{BodyPart, Engine, Integrator};
use moca_tactile::Firmware;
use std::path::Path;

impl Settings {
    /// Applies assignments in their order.
    ///
    /// # Errors
    /// As for [`Settings::set`].
    pub fn set_all<A: AsRef<str>>(&mut self, assignments: impl IntoIterator<Item = A>) -> Result<()> {
        assignments.into_iter().try_for_each(|assignment| self.set(assignment.as_ref()))
    }

    /// Applies `key=value`.
    ///
    /// # Errors
    /// An unknown key (the message lists all), or a value that does not fit.
    pub fn set(&mut self, assignment: &str) -> Result<()> {
        let (name, value) = assignment
            .split_once('=')
            .with_context(|| format!("--set {assignment}: expected key=value, e.g. --set sensor=ideal"))?;
        let Some(key) = KEYS.iter().find(|key| key.name == name.trim()) else {
            let Some(row) = row(name.trim()) else {
                bail!("--set: unknown key {name}; known keys:\n{}", key_list());
            };
            let value = written(&mut self.config, row, value.trim())
                .with_context(|| format!("--set {assignment} ({})", about(row)))?;
            return self
                .config
                .set(row.name, &value)
                .map_err(|message| anyhow!("--set {assignment}: {message} ({})", about(row)));
        };
        (key.set)(self, value.trim()).with_context(|| {
            let unit = if key.unit.is_empty() { "no unit" } else { key.unit };
            format!("--set {assignment} ({}; {unit})", key.about)
        })
    }
}

struct Key {
    name: &'static str,
    unit: &'static str,
    about: &'static str,
    set: fn(&mut Settings, &str) -> Result<()>,
}

const fn key(
    name: &'static str,
    unit: &'static str,
    about: &'static str,
    set: fn(&mut Settings, &str) -> Result<()>,
) -> Key {
    Key { name, unit, about, set }
}

/// Key of a number: name, unit, sentence, range, field, and what follows from it.
macro_rules! number {
    ($name:literal, $unit:literal, $about:literal, $min:literal to $max:literal, $($place:ident).+ $(, then $after:ident)?) => {
        key($name, $unit, $about, |s, v| {
            s.$($place).+ = number(v, $min, $max)?.into();
            $(s.$after();)?
            Ok(())
        })
    };
}

/// Key of a choice: name, sentence, field, and its words with what each stands for.
macro_rules! words {
    ($name:literal, $about:literal, $($place:ident).+, $word:literal = $value:expr $(, $words:literal = $values:expr)+) => {
        key($name, concat!($word $(, "|", $words)+), $about, |s, v| {
            s.$($place).+ = word(v, &[($word, $value) $(, ($words, $values))+])?.into();
            Ok(())
        })
    };
}

// A key stays on one row where it fits.
#[rustfmt::skip]
const KEYS: &[Key] = &[
    key("protection", "off|default|FILE", "[protection] as published (off), as shipped (default), or of a configuration file", protection),
    words!("sensor", "what the controller feels the cover with", sensor,
        "stock" = Sensor::Stock, "ideal" = Sensor::Ideal, "off" = Sensor::Off),
    key("law", "paper|barrier", "the law as published, or as a calibrated cover has it: the contact barrier with its speed limit and both \
        corrections (after sensor)", law),
    number!("sensor.period_ms", "ms", "ideal sensor: averaging and holding period; stock board: period of a frame",
        1.0 to 1000.0, sensor_period_ms),
    words!("sensor.samples", "ideal sensor: the mean of the forces at the control's ticks, or of the physics steps whatever the control's \
        rate", sensor_samples, "ticks" = TrueForces::AtTicks, "steps" = TrueForces::OfSteps),
    key("sensor.delay_ms", "ms", "true.sensor.extra_age_ms by its old name", |s, v| s.set(&format!("true.sensor.extra_age_ms={v}"))),
    number!("sensor.phase_ms", "ms", "how much later the motion starts against the sensor's clock", 0.0 to 1000.0, sensor_phase_ms),
    number!("sensor.noise", "counts", "stock board: standard deviation of one FDAT value", 0.0 to 100.0, noise_counts),
    words!("sensor.firmware", "virtual board: what runs on it", firmware,
        "moca" = Firmware::Moca, "stock-2018" = Firmware::Stock2018, "stock-2015" = Firmware::Stock2015),
    key("flange", "true|observed|sensor", "wrench at the flange: the true one, the momentum observer's, or the simulated sensor's", flange),
    words!("belief", "what the controller believes of its base: the configuration's, or the stopping distance that commissioning of this \
        robot measures", belief_measured, "default" = false, "measured" = true),
    number!("step_ms", "ms", "physics step", 1e-3 to 100.0, step_ms),
    words!("integrator", "integrator; the analytic engine has Euler and implicitfast, which are one there, and leapfrog, of second order",
        integrator, "euler" = Integrator::Euler, "rk4" = Integrator::RungeKutta4, "implicit" = Integrator::Implicit,
        "implicitfast" = Integrator::ImplicitFast, "leapfrog" = Integrator::Leapfrog),
    words!("engine", "what integrates: MuJoCo, or the model of base and arm with people as masses, in less time", engine,
        "mujoco" = Engine::MuJoCo, "analytic" = Engine::Analytic),
    words!("foam", "foam of the cover", foam.material, "pu" = Foam::PU_LD30, "cc" = Foam::CC, "pe5" = Foam::PE5, "pe3" = Foam::PE3,
        "collision-assumed" = Foam::COLLISION_ASSUMED),
    key("foam.scale", "", "true.foam.scale by its old name", |s, v| s.set(&format!("true.foam.scale={v}"))),
    number!("foam.thickness", "m", "plate gap at rest; the hyperbolic law's h", 1e-3 to 0.1, foam.thickness_m),
    number!("foam.stiffness", "N/m", "initial stiffness k_0 of collision-assumed, before foam.scale", 10.0 to 1e6, foam.stiffness),
    number!("foam.damping_ms", "ms", "damping of the foam over its stiffness", 0.0 to 1000.0, foam.damping_ms),
    words!("person.kind", "who stands there; the keys below change single properties", person.part,
        "leg" = BodyPart::Leg, "thigh" = BodyPart::Thigh, "hand" = BodyPart::Hand, "wall" = BodyPart::Wall),
    key("person.taxel", "T1…T11", "taxel the person stands before", |s, v| { s.person.taxel = taxel(v)?; Ok(()) }),
    number!("person.gap", "m", "gap to the cover at the start", 0.0 to 5.0, person.gap_m),
    number!("person.offset", "m", "how far along the panel from the taxel's centre", -1.0 to 1.0, person.offset_m),
    words!("person.plates", "rigid plates that the body presses at once, each by all of its depth, in the middle of which it lies", person.plates,
        "1" = 1_u8, "2" = 2_u8, "3" = 3_u8),
    number!("person.mass", "kg", "mass", 0.1 to 1e4, person.mass_kg),
    number!("person.stiffness", "N/m", "stiffness of the tissue", 1.0 to 1e9, person.stiffness),
    number!("person.damping", "N·s/m", "damping of the tissue", 0.0 to 1e5, person.damping),
    number!("person.friction", "", "Coulomb coefficient along the cover", 0.0 to 2.0, person.friction),
    number!("person.posture_stiffness", "N/m", "stiffness of the posture", 0.0 to 1e7, person.posture_stiffness),
    number!("person.posture_damping", "N·s/m", "damping of the posture", 0.0 to 1e5, person.posture_damping),
    number!("person.radius", "m", "radius of leg, thigh or hand", 0.005 to 100.0, person.radius_m),
    number!("person.at_s", "s", "when walking and leaning begin", 0.0 to 3600.0, person.at_s),
    number!("person.walk", "m/s", "walking speed towards the cover", 0.0 to 5.0, person.walk_m_s),
    number!("person.lean", "N", "weight leant on the cover until the step away", 0.0 to 1000.0, person.lean_n),
    number!("person.steps_away_s", "s", "time from first contact to the step away", 0.0 to 1000.0, person.steps_away_s),
    key("person.fixed", "true|false", "cannot move: held against a wall", |s, v| { s.person.fixed = flag(v)?; Ok(()) }),
    key("base.size", "m,m,m", "length, width, height: its inertia is the box's; the cover stays", base_size),
    number!("base.mass", "kg", "mass of the base; its inertia grows with it", 1.0 to 1e5, config.robot.base.mass_kg, then box_inertia),
    number!("base.inertia", "kg·m²", "about the vertical, instead of the box's", 0.01 to 1e6, base_inertia, then box_inertia),
    key("base.servo_ms", "ms", "time constant of the base's velocity servo", |s, v| {
        s.config.robot.base.servo_time_constant_s = 1e-3 * number(v, 0.1, 1e4)?;
        Ok(())
    }),
    key("base.acceleration", "m/s²[,rad/s²]", "what the base's servo can do: along x and y, yaw", base_acceleration),
    number!("speed", "m/s", "speed of the flange's target in y (collision)", 0.0 to 0.25, speed_m_s),
    number!("duration", "s", "length of the collision run", 0.1 to 3600.0, duration_s),
    number!("push_s", "s", "length of a push, its two ramps included", 0.01 to 3600.0, push_s),
    number!("push.scale", "", "forces of the scripted pushes over the paper's", 0.0 to 10.0, push_scale),
    number!("ramp_s", "s", "each of the two ramps of a push", 1e-3 to 1000.0, ramp_s),
    number!("rest_s", "s", "pause between pushes", 0.0 to 3600.0, rest_s),
];

fn flange(s: &mut Settings, text: &str) -> Result<()> {
    let none = FlangeSensorKind::None;
    (s.flange_observed, s.config.plant.flange_sensor) = word(
        text,
        &[
            ("true", (false, none)),
            ("observed", (true, none)),
            ("sensor", (true, FlangeSensorKind::Simulated)),
        ],
    )?;
    Ok(())
}

fn protection(s: &mut Settings, text: &str) -> Result<()> {
    s.config.protection = match text {
        "off" => settings::unprotected(),
        "default" => ProtectionConfig::default(),
        path => Config::load(Path::new(path))?.protection,
    };
    Ok(())
}

fn law(s: &mut Settings, text: &str) -> Result<()> {
    let barrier = word(text, &[("paper", false), ("barrier", true)])?;
    let corrections = &mut s.config.control.corrections;
    (corrections.null_space_damping, corrections.base_coupling) = (barrier, barrier);
    s.config.protection = if barrier { ProtectionConfig::default() } else { settings::unprotected() };
    if barrier && s.sensor == Sensor::Stock {
        s.config.board.model = AssumedModel::PuLd30;
        s.config.protection.contact_barrier = BarrierReadings::PuLd30;
    } else if barrier {
        s.config.protection.contact_barrier = BarrierReadings::Foam;
    }
    Ok(())
}

fn base_size(s: &mut Settings, text: &str) -> Result<()> {
    let values = numbers(text, 3, 0.1, 10.0)?;
    s.config.robot.base.size_m = values.try_into().ok().context("expected 3 numbers")?;
    s.box_inertia();
    Ok(())
}

fn base_acceleration(s: &mut Settings, text: &str) -> Result<()> {
    let values = numbers(text, 2, 1e-3, 1e4)?;
    let base = &mut s.config.robot.base;
    base.acceleration_max_m_s2 = values[0];
    if let Some(yaw) = values.get(1) {
        base.yaw_acceleration_max_rad_s2 = *yaw;
    }
    Ok(())
}

/// The row of the configuration with this dotted or short name.
fn row(name: &str) -> Option<&'static ParameterSpec> {
    let mut found = None;
    Config::default().each(&mut |row, _| {
        if row.name == name || (row.lab == name && !name.is_empty()) {
            found = Some(row);
        }
    });
    found
}

fn about(row: &ParameterSpec) -> String {
    let units = if row.units.is_empty() { "no unit".into() } else { row.units.join(",") };
    format!("{}; {units}", row.description)
}

/// A value as in a configuration file. Of a list, fewer numbers than it has set all elements of one unit each: one
/// number for `m/s,m/s,rad/s` sets x and y.
fn written(config: &mut Config, row: &ParameterSpec, text: &str) -> Result<toml::Value> {
    let whole = |number: f64| match row.kind {
        #[expect(clippy::cast_possible_truncation, reason = "whole")]
        ParameterKind::Integer if number % 1.0 == 0.0 => toml::Value::Integer(number as i64),
        _ => toml::Value::Float(number),
    };
    match row.kind {
        ParameterKind::Text | ParameterKind::Choice(_) => return Ok(text.into()),
        ParameterKind::Flag => {
            return Ok(flag(text)?.into());
        }
        ParameterKind::Number | ParameterKind::Integer => {}
    }
    let number = |text: &str| text.trim().parse::<f64>().with_context(|| format!("'{text}' is not a number"));
    let given = text.split(',').map(number).collect::<Result<Vec<_>>>()?;
    match (row.size, &given[..]) {
        (Size::One, [one]) => return Ok(whole(*one)),
        (Size::One, _) => bail!("{} numbers where one is expected", given.len()),
        (Size::AtMost(_), _) => return Ok(given.into_iter().map(whole).collect::<Vec<_>>().into()),
        (Size::Exactly(_) | Size::Joints, _) => {}
    }
    let (mut present, joints) = (Vec::new(), config.arm().joints);
    config.each(&mut |other, field| {
        if other.name == row.name {
            field.see(&mut |value| {
                if let FieldValue::Numbers(numbers) = value {
                    let count = if row.size == Size::Joints { joints } else { numbers.len() };
                    present = numbers[..count].to_vec();
                }
            });
        }
    });
    if given.len() == present.len() {
        return Ok(given.into_iter().map(whole).collect::<Vec<_>>().into());
    }
    let mut group = 0;
    for (i, element) in present.iter_mut().enumerate() {
        group += usize::from(i > 0 && row.unit(i) != row.unit(i - 1));
        if let Some(number) = given.get(group) {
            *element = *number;
        }
    }
    ensure!(
        given.len() <= group + 1,
        "expected {} numbers, or up to {} (one for each unit)",
        present.len(),
        group + 1
    );
    Ok(present.into_iter().map(whole).collect::<Vec<_>>().into())
}

/// Every key with its unit and meaning, one a line.
fn key_list() -> String {
    let line = |name: &str, unit: &str, about: &str| format!("  {name:26} {unit:32} {about}");
    let mut lines: Vec<_> = KEYS.iter().map(|key| line(key.name, key.unit, key.about)).collect();
    Config::default().each(&mut |row, _| {
        let name = if row.lab.is_empty() { row.name } else { row.lab };
        lines.push(line(name, &row.units.join(","), row.description));
    });
    lines.join("\n")
}

/// `T6` or `6` as an index from 0.
pub fn taxel(text: &str) -> Result<usize> {
    let number: usize = text
        .trim_start_matches(['T', 't'])
        .parse()
        .with_context(|| format!("expected a taxel, T1 to T{TAXELS}"))?;
    ensure!((1..=TAXELS).contains(&number), "taxel {number} is outside T1 to T{TAXELS}");
    Ok(number - 1)
}

fn number(text: &str, min: f64, max: f64) -> Result<f64> {
    let value: f64 = text.parse().with_context(|| format!("'{text}' is not a number"))?;
    ensure!(value >= min && value <= max, "{value} is outside {min} to {max}");
    Ok(value)
}

fn numbers(text: &str, most: usize, min: f64, max: f64) -> Result<Vec<f64>> {
    let values = text.split(',').map(|part| number(part.trim(), min, max)).collect::<Result<Vec<_>>>()?;
    ensure!(values.len() <= most, "{} numbers where at most {most} are expected", values.len());
    Ok(values)
}

fn flag(text: &str) -> Result<bool> {
    word(text, &[("true", true), ("false", false), ("on", true), ("off", false)])
}

fn word<T: Copy>(text: &str, allowed: &[(&str, T)]) -> Result<T> {
    let names = || allowed.iter().map(|(name, _)| *name).collect::<Vec<_>>().join(", ");
    allowed
        .iter()
        .find(|(name, _)| *name == text)
        .map(|(_, value)| *value)
        .with_context(|| format!("'{text}' is not one of {}", names()))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::free_scene;
    use moca_msgs::Law;
    use moca_msgs::robot::{AnyArm, FR3, SUMMIT_XL};
    use moca_sim::Scene;
    use moca_sim::foam::ElasticLaw;

    #[test]
    fn protection_is_as_published_as_shipped_or_a_file_s() {
        let mut settings = Settings::paper(Law::Impedance);
        let published = settings.config.protection.clone();
        settings.set("protection=default").unwrap();
        assert_eq!(settings.config.protection, ProtectionConfig::default());
        settings.set("protection=off").unwrap();
        assert_eq!(settings.config.protection, published);
        let path = std::env::temp_dir().join(format!("moca-protection-{}.toml", std::process::id()));
        std::fs::write(&path, "[protection]\nforce_limit_n = 60.0\n").unwrap();
        settings.set(&format!("protection={}", path.display())).unwrap();
        std::fs::remove_file(&path).unwrap();
        assert!((settings.config.protection.force_limit_n - 60.0).abs() < 1e-12);
        assert!(settings.config.protection.override_statement.is_empty());
        let refused = format!("{:#}", settings.set("protection=nowhere.toml").unwrap_err());
        assert!(refused.contains("nowhere.toml"), "{refused}");
    }

    #[test]
    fn an_unknown_key_lists_every_key() {
        let error = Settings::paper(Law::Impedance).set("person.wieght=3").unwrap_err().to_string();
        assert!(KEYS.iter().all(|key| error.contains(key.name)), "{error}");
        assert!(error.contains("m_v ") && error.contains("simulation.hand.force_n"), "{error}");
    }

    #[test]
    fn a_value_outside_its_range_names_value_and_range() {
        let mut settings = Settings::paper(Law::Impedance);
        for (assignment, part) in [
            ("m_v=nan", "outside 0.01 to 1000"),
            ("speed=fast", "'fast' is not a number"),
            ("sensor=none", "stock, ideal, off"),
            ("person.taxel=T12", "outside T1 to T11"),
            ("d_v=1,2,3,4", "expected 3 numbers, or up to 2 (one for each unit)"),
            ("sensor", "expected key=value"),
        ] {
            let error = format!("{:#}", settings.set(assignment).unwrap_err());
            assert!(error.contains(part), "{assignment}: {error}");
        }
        assert_eq!(settings, Settings::paper(Law::Impedance));
    }

    fn with(assignments: &[&str]) -> Settings {
        let mut settings = Settings::paper(Law::Impedance);
        settings.set_all(assignments).unwrap();
        settings.check().unwrap();
        settings
    }

    fn scene(assignments: &[&str]) -> Scene {
        with(assignments).free_scene()
    }

    /// Parameters of arm, base, cover, controller, human and foam, and the numbers of the experiments.
    #[test]
    #[expect(clippy::float_cmp, reason = "a set number is stored as it is")]
    fn every_parameter_of_the_table_can_be_set() {
        let rows = [
            // The arm and its limits.
            "arm=fr3",
            "limit.torque=80,80,80,80,10,10,10",
            "limit.torque_rate=900",
            // The base, where arm and taxels sit on it.
            "base.size=1,0.8,0.5",
            "base.mass=120",
            "base.inertia=20",
            "base.servo_ms=30",
            "base.acceleration=2,5",
            "mount.position=0.1,0,0.5",
            "mount.rpy=0,0,0.1",
            "taxels.x=-0.3,-0.1,0.1,0.3,0.5,0.5,0.5,-0.3,-0.1,0.1,0.3",
            "taxels.y=0.4,0.4,0.4,0.4,0.2,0,-0.2,-0.4,-0.4,-0.4,-0.4",
            "taxels.inward=-1.5,-1.5,-1.5,-1.5,3,3,3,1.5,1.5,1.5,1.5",
            // The gains.
            "m_v=2",
            "d_v=10,20,30",
            "k_d=500,20",
            "zeta=0.7",
            "eta_a=2",
            "eta_b=2",
            "k_0=50",
            "d_0=5",
            // The human.
            "person.mass=60",
            "person.stiffness=40000",
            "person.radius=0.08",
            "person.posture_stiffness=500",
            "person.posture_damping=200",
            "person.steps_away_s=2",
            "person.taxel=T4",
            // The foam.
            "foam=collision-assumed",
            "foam.scale=2",
            "foam.thickness=0.02",
            "foam.damping_ms=2",
            "belief=measured",
            // The experiments.
            "sensor=ideal",
            "sensor.period_ms=20",
            "sensor.delay_ms=5",
            "null_space_damping=true",
            "base_coupling=true",
            "flange_wrench_feedforward=true",
            "q_0=0,-0.7,0,-2.3,0,1.5,0.7",
            "push_s=2",
            "ramp_s=0.2",
            "push.scale=0.5",
            "speed=0.1",
        ];
        for row in rows {
            assert_ne!(with(&[row]), with(&[]), "{row}");
        }
        let (plain, stiffer) =
            (with(&["foam=collision-assumed"]), with(&["foam=collision-assumed", "foam.stiffness=3000"]));
        assert_ne!(plain.free_scene(), stiffer.free_scene());
        let gains = with(&["d_v=10,20,30", "k_d=500,20"]).config.control.gains;
        assert_eq!(gains.virtual_damping, [10.0, 20.0, 30.0]);
        assert_eq!(gains.stiffness, [500.0, 500.0, 500.0, 20.0, 20.0, 20.0]);
        let gains = with(&["m_v=3", "control.gains.stiffness=700"]).config.control.gains;
        assert_eq!(
            (gains.virtual_mass, gains.stiffness[2..4].to_vec()),
            ([3.0, 3.0, 2.0], vec![700.0, 40.0])
        );
    }

    #[test]
    fn a_scene_without_settings_is_the_paper_s_robot() {
        let base = Scene { flange_sensor: true, ..free_scene() };
        assert_eq!(scene(&[]), base);
    }

    #[test]
    fn foam_keys_give_same_scene_in_any_order() {
        let keys = ["foam.thickness=0.02", "foam.stiffness=3000", "foam.damping_ms=2", "foam.scale=2"];
        let before = with(&[&keys[..], &["foam=collision-assumed"]].concat());
        let after = with(&[&["foam=collision-assumed"], &keys[..]].concat());
        assert_eq!(before, after);
        let foam = before.free_scene().foam;
        let expected = Foam {
            gap_m: 0.02,
            elastic: ElasticLaw::Hyperbolic { stiffness_n_per_m: 6000.0 },
            damping_time_s: 0.002,
            ..Foam::COLLISION_ASSUMED
        };
        assert_eq!(foam, expected);
        assert_eq!(before.board().foam, foam);
        // A foam of the paper has no damper of its own, and takes one.
        assert_eq!(scene(&["foam=cc"]).foam, Foam::CC);
        assert_eq!(scene(&["foam=cc", "foam.damping_ms=1"]).foam, Foam { damping_time_s: 0.001, ..Foam::CC });
    }

    #[test]
    fn the_inertia_of_the_base_is_its_box_s_unless_it_is_given() {
        let size = scene(&["base.size=1,0.5,0.4", "base.mass=60"]).base;
        let of_box = [0.25 + 0.16, 1.0 + 0.16, 1.0 + 0.25].map(|square| 60.0 / 12.0 * square);
        for (inertia, of_box) in size.inertia_com_diagonal.into_iter().zip(of_box) {
            assert!((inertia - of_box).abs() < 1e-12, "{inertia} {of_box}");
        }
        assert_eq!((size.size_m, size.mass_kg), ([1.0, 0.5, 0.4], 60.0));
        let given = scene(&["base.inertia=20"]).base;
        assert!((given.inertia_com_diagonal[2] - 20.0).abs() < 1e-12, "{given:?}");
        assert_eq!((given.size_m, given.mass_kg), (SUMMIT_XL.size_m, SUMMIT_XL.mass_kg));
    }

    /// Every key of the truth by its name in the laboratory and in a file of the daemon.
    #[test]
    fn keys_of_truth_change_plant_and_no_belief() {
        let keys = [
            ("base.order_delay_ms", "base.order_delay_ms", "50"),
            ("base.order_jitter_ms", "base.order_jitter_ms", "10"),
            ("base.order_period_ms", "base.order_period_ms", "20"),
            ("base.servo_ms", "base.servo_ms", "100"),
            ("base.acceleration", "base.acceleration_m_s2", "2"),
            ("base.deceleration", "base.deceleration_m_s2", "1"),
            ("base.odometry_scale", "base.odometry_scale", "0.95"),
            ("base.odometry_delay_ms", "base.odometry_delay_ms", "30"),
            ("base.odometry_noise", "base.odometry_noise_m_s", "0.003"),
            ("base.odometry_rate_hz", "base.odometry_rate_hz", "50"),
            ("arm.mass_scale", "arm.mass_scale", "1.1"),
            ("arm.joint_friction", "arm.joint_friction_nm", "1"),
            ("arm.torque_noise", "arm.torque_noise_nm", "0.3"),
            ("arm.tool_mass", "arm.tool_mass_kg", "1"),
            ("arm.tool_com", "arm.tool_com_m", "0,0,0.05"),
            ("foam.scale", "foam.scale", "1.5"),
            ("foam.kind", "foam.kind", "cc"),
            ("foam.creep", "foam.creep", "0.1"),
            ("sensor.extra_age_ms", "sensor.extra_age_ms", "5"),
            ("flange_sensor.bias_n", "flange_sensor.bias_n", "1,2,3"),
            ("flange_sensor.bias_nm", "flange_sensor.bias_nm", "1,2,3"),
            ("flange_sensor.noise_n", "flange_sensor.noise_n", "0.5"),
            ("flange_sensor.noise_nm", "flange_sensor.noise_nm", "0.02"),
            ("flange_sensor.drift_n_s", "flange_sensor.drift_n_s", "0.01"),
            ("flange_sensor.drift_nm_s", "flange_sensor.drift_nm_s", "0.001"),
            ("flange_sensor.delay_ms", "flange_sensor.delay_ms", "5"),
        ];
        let mut rows = 0;
        Config::default().simulation.truth.each(&mut |row, _| {
            if row.lab.is_empty() {
                return; // of a gripper, which no experiment has
            }
            rows += 1;
            assert!(keys.iter().any(|(lab, file, _)| {
                row.lab == format!("true.{lab}") && row.name == format!("simulation.true.{file}")
            }));
        });
        assert_eq!(rows, keys.len());
        for (lab, file, value) in keys {
            let changed = with(&[&format!("true.{lab}={value}")]);
            assert_eq!(changed, with(&[&format!("simulation.true.{file}={value}")]), "{lab}");
            // the boards are older, not the world
            assert_eq!(changed.free_scene() == scene(&[]), lab.starts_with("sensor"), "{lab}");
            let believed = |mut config: Config| {
                config.simulation.truth = moca_msgs::Truth::default();
                config
            };
            assert_eq!(believed(changed.config), with(&[]).config, "{lab}");
        }
    }

    #[test]
    fn controller_and_plant_have_the_arm_that_is_asked_for() {
        let settings = with(&["arm=fr3"]);
        assert_eq!((settings.free_scene().arm, settings.config.arm()), (AnyArm::of(&FR3), &AnyArm::of(&FR3)));
    }

    #[test]
    fn a_new_value_outside_its_range_names_value_unit_and_range() {
        for (assignment, parts) in [
            ("foam.thickness=0.2", ["0.2 is outside 0.001 to 0.1", "; m)"]),
            ("foam.stiffness=1", ["1 is outside 10 to 1000000", "; N/m)"]),
            ("foam.damping_ms=-1", ["-1 is outside 0 to 1000", "; ms)"]),
            ("base.size=0.05,1,1", ["0.05 is outside 0.1 to 10", "; m,m,m)"]),
            ("base.inertia=0", ["0 is outside 0.01 to 1000000", "; kg·m²)"]),
            ("push.scale=11", ["11 is outside 0 to 10", "; no unit)"]),
            ("ramp_s=nan", ["NaN is outside 0.001 to 1000", "; s)"]),
            ("arm=ur11", ["\"ur11\"", "no unit)"]),
        ] {
            let error = format!("{:#}", Settings::paper(Law::Impedance).set(assignment).unwrap_err());
            assert!(parts.iter().all(|part| error.contains(part)), "{assignment}: {error}");
        }
    }

    #[test]
    fn numbers_that_do_not_go_together_are_refused() {
        for (assignment, part) in [
            ("foam.stiffness=3000", "foam.stiffness = 3000 N/m: PU LD30 follows a power law"),
            ("ramp_s=2", "push_s = 3 s is shorter than its two ramps of ramp_s = 2 s"),
        ] {
            let mut settings = Settings::paper(Law::Impedance);
            settings.set(assignment).unwrap();
            let error = settings.check().unwrap_err().to_string();
            assert!(error.contains(part), "{assignment}: {error}");
        }
    }
}
