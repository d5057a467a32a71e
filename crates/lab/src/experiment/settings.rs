//! Everything an experiment can be told with `--set key=value`: one table, so that help and errors cannot lag behind.

use anyhow::{Context, Result, bail, ensure};
use moca_daemon::config::{Config, HandConfig};
use moca_daemon::protection::OVERRIDE_MAX_M_S;
use moca_msgs::Law;
use moca_msgs::robot::{BaseTable, SUMMIT_XL, TaxelPlacement};
use moca_sim::foam::FoamLaw;
use moca_sim::{BaseServo, BodyPart, Integrator, Mobility, Person, Scene, Shape, VirtualBoardConfig};
use moca_tactile::datastream::SketchGeneration;

/// Averaging and holding period of the ideal sensor, ms.
const IDEAL_PERIOD_MS: f64 = 10.0;

/// What the controller feels the cover with.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Sensor {
    /// A stock Touch Board: bytes, age, noise, threshold.
    Stock,
    /// The true force, averaged and held over a period.
    Ideal,
    /// No cover: the controller is told zero.
    Off,
}

impl Sensor {
    pub(crate) const fn name(self) -> &'static str {
        match self {
            Self::Stock => "stock",
            Self::Ideal => "ideal",
            Self::Off => "off",
        }
    }
}

/// Who stands beside the robot. What is `None` is as the body part has it.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct PersonSettings {
    pub part: BodyPart,
    /// 0 is T1.
    pub taxel: usize,
    pub gap_m: f64,
    /// Along the panel from the taxel's centre, m.
    pub offset_m: f64,
    pub mass_kg: Option<f64>,
    pub stiffness: Option<f64>,
    pub damping: f64,
    pub posture_stiffness: Option<f64>,
    pub posture_damping: Option<f64>,
    pub radius_m: Option<f64>,
    pub steps_away_s: f64,
    /// When walking and leaning begin, s after the run's start.
    pub at_s: f64,
    /// Walking speed towards the cover, m/s.
    pub walk_m_s: f64,
    /// Weight leant on the cover, N.
    pub lean_n: f64,
    pub fixed: bool,
}

impl PersonSettings {
    /// Stiffness of the tissue, N/m.
    pub(crate) fn tissue_stiffness(&self) -> f64 {
        self.stiffness.unwrap_or(self.part.data().1.stiffness_n_per_m)
    }

    fn person(&self, cover: &[TaxelPlacement]) -> Result<Person> {
        let (mut shape, mut tissue, mut mobility) = self.part.data();
        if let (Shape::Cylinder { radius_m }, Some(radius)) = (&mut shape, self.radius_m) {
            *radius_m = radius;
        }
        tissue.stiffness_n_per_m = self.tissue_stiffness();
        tissue.damping_n_s_per_m = self.damping;
        if self.fixed {
            mobility = Mobility::Fixed;
        }
        if let Mobility::Standing { mass_kg, stiffness_n_per_m, damping_n_s_per_m } = &mut mobility {
            *mass_kg = self.mass_kg.unwrap_or(*mass_kg);
            *stiffness_n_per_m = self.posture_stiffness.unwrap_or(*stiffness_n_per_m);
            *damping_n_s_per_m = self.posture_damping.unwrap_or(*damping_n_s_per_m);
        }
        let person = Person::before(cover, self.taxel, self.gap_m, self.offset_m, shape, tissue, mobility)
            .context("no such taxel")?;
        Ok(Person {
            starts_after_s: self.at_s,
            walk_m_s: self.walk_m_s,
            lean_n: self.lean_n,
            steps_away_after_s: (self.part != BodyPart::Wall).then_some(self.steps_away_s),
            ..person
        })
    }
}

/// One run, completely described.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Settings {
    pub config: Config,
    pub sensor: Sensor,
    /// `None` is 10 ms for the ideal sensor and what the sketch takes for the stock board.
    pub sensor_period_ms: Option<f64>,
    pub sensor_delay_ms: f64,
    pub sensor_phase_ms: f64,
    pub noise_counts: Option<f64>,
    pub sketch: SketchGeneration,
    pub foam: FoamLaw,
    pub foam_scale: f64,
    pub person: PersonSettings,
    pub base: BaseTable,
    pub base_servo: BaseServo,
    /// Speed of the flange's target, m/s.
    pub speed_m_s: f64,
    pub duration_s: f64,
    pub push_s: f64,
    pub rest_s: f64,
    pub step_ms: f64,
    pub integrator: Integrator,
}

impl Settings {
    /// The paper's law and gains, stock board, no scripted hand.
    pub(crate) fn paper(law: Law) -> Self {
        let mut config = Config::default();
        config.startup.law = law;
        config.simulation.hand = HandConfig::none();
        // The paper's robot has no speed limit but its own; a limit this high changes no bit.
        config.protection.override_speed_limit_m_s = OVERRIDE_MAX_M_S;
        config.protection.override_statement = "the paper's experiments, simulated, as published".into();
        config.control.corrections.null_space_damping = false;
        config.control.corrections.base_coupling = false;
        config.control.corrections.flange_feed = false;
        Self {
            config,
            sensor: Sensor::Stock,
            sensor_period_ms: None,
            sensor_delay_ms: 0.0,
            sensor_phase_ms: 0.0,
            noise_counts: None,
            sketch: SketchGeneration::From2018,
            foam: FoamLaw::default(),
            foam_scale: 1.0,
            person: PersonSettings { gap_m: 0.25, steps_away_s: 1.5, ..PersonSettings::default() },
            base: SUMMIT_XL,
            base_servo: BaseServo::default(),
            speed_m_s: 0.2,
            duration_s: 8.0,
            push_s: 3.0,
            rest_s: 2.0,
            step_ms: 1.0,
            integrator: Integrator::default(),
        }
    }

    /// Applies `key=value`.
    ///
    /// # Errors
    /// An unknown key (the message lists all), or a value that does not fit.
    pub(crate) fn set(&mut self, assignment: &str) -> Result<()> {
        let (name, value) = assignment
            .split_once('=')
            .with_context(|| format!("--set {assignment}: expected key=value, e.g. --set sensor=ideal"))?;
        let Some(key) = KEYS.iter().find(|key| key.name == name.trim()) else {
            bail!("--set: unknown key {name}; known keys:\n{}", key_list());
        };
        (key.set)(self, value.trim())
            .with_context(|| format!("--set {} ({}; {})", assignment, key.about, key.unit))
    }

    /// Checks what single keys cannot know.
    ///
    /// # Errors
    /// Every number that the daemon's configuration refuses.
    pub(crate) fn check(&self) -> Result<()> {
        let mut mistakes = Vec::new();
        self.config.check(|_, message| mistakes.push(message));
        ensure!(mistakes.is_empty(), "{}", mistakes.join("\n"));
        Ok(())
    }

    /// The scene without anybody in it; the flange is measured.
    pub(crate) fn free_scene(&self) -> Scene {
        Scene {
            flange_sensor: true,
            foam: self.foam,
            foam_scale: self.foam_scale,
            control_period_s: 1.0 / f64::from(self.config.control_loop.rate_hz),
            physics_step_s: 1e-3 * self.step_ms,
            integrator: self.integrator,
            base: self.base,
            mount: self.config.mount(),
            cover: self.config.taxels(),
            base_servo: self.base_servo,
            arm_posture_rad: self.config.control.gains.posture_rad,
            ..Scene::default()
        }
    }

    /// The same scene with the person beside the cover.
    pub(crate) fn collision_scene(&self) -> Result<Scene> {
        Ok(Scene { people: vec![self.person.person(&self.config.taxels())?], ..self.free_scene() })
    }

    /// Period of the sensor, ms.
    pub(crate) fn period_ms(&self) -> f64 {
        #[expect(clippy::cast_precision_loss, reason = "some milliseconds")]
        let of_sketch_ms = 1e-6 * self.sketch.frame_period_ns() as f64;
        let usual_ms = if self.sensor == Sensor::Stock { of_sketch_ms } else { IDEAL_PERIOD_MS };
        self.sensor_period_ms.unwrap_or(usual_ms)
    }

    /// The virtual board of this run.
    pub(crate) fn board(&self) -> VirtualBoardConfig {
        VirtualBoardConfig {
            sketch: self.sketch,
            foam: self.foam,
            foam_scale: self.foam_scale,
            noise_counts: self.noise_counts,
            #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "1 to 1000 ms")]
            frame_period_ns: self.sensor_period_ms.map(|ms| (1e6 * ms) as u64),
            seed: self.config.simulation.seed,
            ..VirtualBoardConfig::default()
        }
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

const KEYS: &[Key] = &[
    key("sensor", "stock|ideal|off", "what the controller feels the cover with", |s, v| {
        s.sensor = word(v, &[("stock", Sensor::Stock), ("ideal", Sensor::Ideal), ("off", Sensor::Off)])?;
        Ok(())
    }),
    key(
        "sensor.period_ms",
        "ms",
        "ideal sensor: averaging and holding period; stock board: period of a frame",
        |s, v| some(&mut s.sensor_period_ms, v, 1.0, 1000.0),
    ),
    key("sensor.delay_ms", "ms", "further delay, either sensor", |s, v| {
        store(&mut s.sensor_delay_ms, v, 0.0, 1000.0)
    }),
    key("sensor.phase_ms", "ms", "how much later the motion starts against the sensor's clock", |s, v| {
        store(&mut s.sensor_phase_ms, v, 0.0, 1000.0)
    }),
    key("sensor.noise", "counts", "stock board: standard deviation of one FDAT value", |s, v| {
        s.noise_counts = Some(number(v, 0.0, 100.0)?);
        Ok(())
    }),
    key("sensor.sketch", "2015|2018", "stock board: generation of the sketch", |s, v| {
        s.sketch = word(v, &[("2015", SketchGeneration::From2015), ("2018", SketchGeneration::From2018)])?;
        Ok(())
    }),
    key("seed", "", "seed of the board's noise", |s, v| {
        s.config.simulation.seed = v.parse().context("expected a whole number")?;
        Ok(())
    }),
    key("m_v", "kg[,kg,kg·m²]", "virtual mass, eq. (2); one number sets x and y", |s, v| {
        planar(&mut s.config.control.gains.virtual_mass, v, 0.01, 1000.0)
    }),
    key("d_v", "N·s/m[,N·s/m,N·m·s/rad]", "virtual damping, eq. (2); one number sets x and y", |s, v| {
        planar(&mut s.config.control.gains.virtual_damping, v, 0.0, 1e5)
    }),
    key("k_d", "N/m[,N·m/rad]", "stiffness of the flange, eq. (10): linear, angular", |s, v| {
        let k = &mut s.config.control.gains.stiffness;
        for (i, value) in numbers(v, 2, 0.0, 1e5)?.into_iter().enumerate() {
            k[3 * i..3 * i + 3].fill(value);
        }
        Ok(())
    }),
    key("zeta", "", "damping ratio of the flange, eq. (10)", |s, v| {
        store(&mut s.config.control.gains.damping_ratio, v, 0.0, 5.0)
    }),
    key("eta_b", "", "weight of the base, eq. (9)", |s, v| {
        store(&mut s.config.control.gains.eta_base, v, 1e-3, 1e3)
    }),
    key("eta_a", "", "weight of the arm, eq. (9)", |s, v| {
        store(&mut s.config.control.gains.eta_arm, v, 1e-3, 1e3)
    }),
    key("k_0", "N·m/rad, 7 numbers or 1", "null-space posture stiffness, eq. (11)", |s, v| {
        joints(&mut s.config.control.gains.posture_stiffness, v, 1e4)
    }),
    key("d_0", "N·m·s/rad, 7 numbers or 1", "null-space posture damping, eq. (11)", |s, v| {
        joints(&mut s.config.control.gains.posture_damping, v, 1e3)
    }),
    key("reactivity", "", "scale of the cover's wrench on the base", |s, v| {
        store(&mut s.config.control.gains.reactivity, v, 0.0, 10.0)
    }),
    key("null_space_damping", "true|false", "correction 2 of the literal law", |s, v| {
        flag(&mut s.config.control.corrections.null_space_damping, v)
    }),
    key("base_coupling", "true|false", "correction 3 of the literal law", |s, v| {
        flag(&mut s.config.control.corrections.base_coupling, v)
    }),
    key("flange_feed", "true|false", "correction 1 of the literal law", |s, v| {
        flag(&mut s.config.control.corrections.flange_feed, v)
    }),
    key("limit.base_velocity", "m/s[,m/s,rad/s]", "largest commanded base speed", |s, v| {
        planar(&mut s.config.limits.base_velocity, v, 0.0, 3.0)
    }),
    key("limit.base_acceleration", "m/s²[,m/s²,rad/s²]", "largest commanded base acceleration", |s, v| {
        planar(&mut s.config.limits.base_acceleration, v, 0.01, 50.0)
    }),
    key("rate_hz", "Hz", "control rate", |s, v| {
        s.config.control_loop.rate_hz = v.parse().context("expected a whole number")?;
        Ok(())
    }),
    key("step_ms", "ms", "physics step", |s, v| store(&mut s.step_ms, v, 1e-3, 100.0)),
    key("integrator", "euler|rk4|implicit|implicitfast", "MuJoCo's integrator", |s, v| {
        s.integrator = word(
            v,
            &[
                ("euler", Integrator::Euler),
                ("rk4", Integrator::RungeKutta4),
                ("implicit", Integrator::Implicit),
                ("implicitfast", Integrator::ImplicitFast),
            ],
        )?;
        Ok(())
    }),
    key("foam", "pu|cc|pe5|pe3|collision-assumed", "foam of the cover", |s, v| {
        s.foam = word(
            v,
            &[
                ("pu", FoamLaw::PuLd30),
                ("cc", FoamLaw::Cc),
                ("pe5", FoamLaw::Pe5),
                ("pe3", FoamLaw::Pe3),
                ("collision-assumed", FoamLaw::CollisionAssumed),
            ],
        )?;
        Ok(())
    }),
    key("foam.scale", "", "stiffness of the foam over its law's", |s, v| {
        store(&mut s.foam_scale, v, 1e-3, 1e5)
    }),
    key(
        "person.kind",
        "leg|thigh|hand|wall",
        "who stands there; the keys below change single properties",
        |s, v| {
            s.person.part = word(
                v,
                &[
                    ("leg", BodyPart::Leg),
                    ("thigh", BodyPart::Thigh),
                    ("hand", BodyPart::Hand),
                    ("wall", BodyPart::Wall),
                ],
            )?;
            Ok(())
        },
    ),
    key("person.taxel", "T1…T11", "taxel the person stands before", |s, v| {
        s.person.taxel = taxel(v)?;
        Ok(())
    }),
    key("person.gap", "m", "gap to the cover at the start", |s, v| store(&mut s.person.gap_m, v, 0.0, 5.0)),
    key("person.offset", "m", "how far along the panel from the taxel's centre", |s, v| {
        store(&mut s.person.offset_m, v, -1.0, 1.0)
    }),
    key("person.mass", "kg", "mass", |s, v| some(&mut s.person.mass_kg, v, 0.1, 1e4)),
    key("person.stiffness", "N/m", "stiffness of the tissue", |s, v| {
        some(&mut s.person.stiffness, v, 1.0, 1e9)
    }),
    key("person.damping", "N·s/m", "damping of the tissue", |s, v| {
        store(&mut s.person.damping, v, 0.0, 1e5)
    }),
    key("person.posture_stiffness", "N/m", "stiffness of the posture", |s, v| {
        some(&mut s.person.posture_stiffness, v, 0.0, 1e7)
    }),
    key("person.posture_damping", "N·s/m", "damping of the posture", |s, v| {
        some(&mut s.person.posture_damping, v, 0.0, 1e5)
    }),
    key("person.radius", "m", "radius of leg, thigh or hand", |s, v| {
        some(&mut s.person.radius_m, v, 0.005, 100.0)
    }),
    key("person.at_s", "s", "when walking and leaning begin", |s, v| {
        store(&mut s.person.at_s, v, 0.0, 3600.0)
    }),
    key("person.walk", "m/s", "walking speed towards the cover", |s, v| {
        store(&mut s.person.walk_m_s, v, 0.0, 5.0)
    }),
    key("person.lean", "N", "weight leant on the cover until the step away", |s, v| {
        store(&mut s.person.lean_n, v, 0.0, 1000.0)
    }),
    key("person.steps_away_s", "s", "time from first contact to the step away", |s, v| {
        store(&mut s.person.steps_away_s, v, 0.0, 1000.0)
    }),
    key("person.fixed", "true|false", "cannot move: held against a wall", |s, v| {
        flag(&mut s.person.fixed, v)
    }),
    key("mount.position", "m,m,m", "arm base in the axes of B", |s, v| {
        list(&mut s.config.geometry.arm_position_m, v, -5.0, 5.0)
    }),
    key("mount.rpy", "rad,rad,rad", "its axes in B: roll, pitch, yaw", |s, v| {
        list(&mut s.config.geometry.arm_rpy_rad, v, -7.0, 7.0)
    }),
    key("taxels.x", "m, 11 numbers", "centres of the taxels in B, T1 first: forward", |s, v| {
        list(&mut s.config.geometry.taxel_x_m, v, -5.0, 5.0)
    }),
    key("taxels.y", "m, 11 numbers", "centres of the taxels in B, T1 first: left", |s, v| {
        list(&mut s.config.geometry.taxel_y_m, v, -5.0, 5.0)
    }),
    key("taxels.inward", "rad, 11 numbers", "direction of a press in B", |s, v| {
        list(&mut s.config.geometry.taxel_inward_rad, v, -7.0, 7.0)
    }),
    key("base.mass", "kg", "mass of the base; its inertia grows with it", |s, v| {
        let mass_kg = number(v, 1.0, 1e5)?;
        let scale = mass_kg / SUMMIT_XL.mass_kg;
        s.base.inertia_com_diagonal = SUMMIT_XL.inertia_com_diagonal.map(|inertia| scale * inertia);
        s.base.mass_kg = mass_kg;
        Ok(())
    }),
    key("base.servo_ms", "ms", "time constant of the base's velocity servo", |s, v| {
        s.base_servo.time_constant_s = 1e-3 * number(v, 0.1, 1e4)?;
        Ok(())
    }),
    key(
        "base.acceleration",
        "m/s²[,rad/s²]",
        "what the base's servo can do: along x and y, yaw",
        |s, v| {
            let values = numbers(v, 2, 1e-3, 1e4)?;
            s.base_servo.acceleration_max_m_s2 = values[0];
            if let Some(yaw) = values.get(1) {
                s.base_servo.yaw_acceleration_max_rad_s2 = *yaw;
            }
            Ok(())
        },
    ),
    key("q_0", "rad, 7 numbers", "posture of the arm, at the start and in eq. (11)", |s, v| {
        list(&mut s.config.control.gains.posture_rad, v, -7.0, 7.0)
    }),
    key("limit.torque", "N·m, 7 numbers or 1", "largest commanded joint torque", |s, v| {
        joints(&mut s.config.limits.torque_nm, v, 1e3)
    }),
    key("limit.torque_rate", "N·m/s", "fastest change of a joint torque", |s, v| {
        store(&mut s.config.limits.torque_rate_nm_s, v, 1.0, 1e5)
    }),
    key("speed", "m/s", "speed of the flange's target in y (collision)", |s, v| {
        store(&mut s.speed_m_s, v, 0.0, 0.25)
    }),
    key("duration", "s", "length of the collision run", |s, v| store(&mut s.duration_s, v, 0.1, 3600.0)),
    key("push_s", "s", "length of a push, its two ramps of 0.3 s included", |s, v| {
        store(&mut s.push_s, v, 0.6, 3600.0)
    }),
    key("rest_s", "s", "pause between pushes", |s, v| store(&mut s.rest_s, v, 0.0, 3600.0)),
];

/// Every key with its unit and meaning, one a line.
pub(crate) fn key_list() -> String {
    KEYS.iter()
        .map(|key| format!("  {:26} {:32} {}", key.name, key.unit, key.about))
        .collect::<Vec<_>>()
        .join("\n")
}

/// `T6` or `6` as an index from 0.
pub(crate) fn taxel(text: &str) -> Result<usize> {
    let number: usize = text.trim_start_matches(['T', 't']).parse().context("expected a taxel, T1 to T11")?;
    ensure!((1..=11).contains(&number), "taxel {number} is outside T1 to T11");
    Ok(number - 1)
}

fn number(text: &str, min: f64, max: f64) -> Result<f64> {
    let value: f64 = text.parse().with_context(|| format!("'{text}' is not a number"))?;
    ensure!(value >= min && value <= max, "{value} is outside {min} to {max}");
    Ok(value)
}

fn store(place: &mut f64, text: &str, min: f64, max: f64) -> Result<()> {
    *place = number(text, min, max)?;
    Ok(())
}

fn some(place: &mut Option<f64>, text: &str, min: f64, max: f64) -> Result<()> {
    *place = Some(number(text, min, max)?);
    Ok(())
}

fn numbers(text: &str, most: usize, min: f64, max: f64) -> Result<Vec<f64>> {
    let values = text.split(',').map(|part| number(part.trim(), min, max)).collect::<Result<Vec<_>>>()?;
    ensure!(values.len() <= most, "{} numbers where at most {most} are expected", values.len());
    Ok(values)
}

fn list<const N: usize>(place: &mut [f64; N], text: &str, min: f64, max: f64) -> Result<()> {
    let values = numbers(text, N, min, max)?;
    *place = values.try_into().ok().with_context(|| format!("expected {N} numbers"))?;
    Ok(())
}

fn planar(place: &mut [f64; 3], text: &str, min: f64, max: f64) -> Result<()> {
    match numbers(text, 3, min, max)?[..] {
        [linear] => place[..2].fill(linear),
        [x, y, yaw] => *place = [x, y, yaw],
        _ => bail!("expected one number or three"),
    }
    Ok(())
}

fn joints(place: &mut [f64; 7], text: &str, max: f64) -> Result<()> {
    match numbers(text, 7, 0.0, max)?[..] {
        [all] => place.fill(all),
        [a, b, c, d, e, f, g] => *place = [a, b, c, d, e, f, g],
        _ => bail!("expected one number or seven"),
    }
    Ok(())
}

fn flag(place: &mut bool, text: &str) -> Result<()> {
    *place = word(text, &[("true", true), ("false", false), ("on", true), ("off", false)])?;
    Ok(())
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

    #[test]
    fn an_unknown_key_lists_every_key() {
        let error = Settings::paper(Law::Impedance).set("person.wieght=3").unwrap_err().to_string();
        assert!(KEYS.iter().all(|key| error.contains(key.name)), "{error}");
    }

    #[test]
    fn a_value_outside_its_range_names_value_and_range() {
        let mut settings = Settings::paper(Law::Impedance);
        for (assignment, part) in [
            ("m_v=nan", "outside 0.01 to 1000"),
            ("speed=fast", "'fast' is not a number"),
            ("sensor=none", "stock, ideal, off"),
            ("person.taxel=T12", "outside T1 to T11"),
            ("d_v=1,2", "one number or three"),
            ("sensor", "expected key=value"),
        ] {
            let error = format!("{:#}", settings.set(assignment).unwrap_err());
            assert!(error.contains(part), "{assignment}: {error}");
        }
        assert_eq!(settings, Settings::paper(Law::Impedance));
    }

    #[test]
    #[expect(clippy::float_cmp, reason = "a set number is stored as it is")]
    fn every_parameter_of_the_table_can_be_set() {
        let mut settings = Settings::paper(Law::Impedance);
        for assignment in [
            "m_v=2",
            "d_v=10,20,30",
            "k_d=500,20",
            "eta_b=2",
            "k_0=50",
            "person.taxel=T4",
            "foam=cc",
            "base.servo_ms=30",
        ] {
            settings.set(assignment).unwrap();
        }
        let gains = &settings.config.control.gains;
        assert_eq!(gains.virtual_mass, [2.0, 2.0, 2.0]);
        assert_eq!(gains.virtual_damping, [10.0, 20.0, 30.0]);
        assert_eq!(gains.stiffness, [500.0, 500.0, 500.0, 20.0, 20.0, 20.0]);
        assert_eq!((settings.person.taxel, settings.foam), (3, FoamLaw::Cc));
        settings.check().unwrap();
    }
}
