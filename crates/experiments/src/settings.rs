//! One run of an experiment, completely described, and the scene and board that follow from it.

use anyhow::{Context, Result, ensure};
use moca_control::config::{
    AssumedModel, BarrierReadings, Config, HandConfig, OVERRIDE_MAX_M_S, ProtectionConfig, RecentrePolicy,
};
use moca_control::robot::FlangeSensorKind;
use moca_lockstep::TrueForces;
use moca_lockstep::simulated_robot;
use moca_msgs::Law;
use moca_msgs::robot::{BaseTable, TaxelPlacement};
use moca_sim::foam::{ElasticLaw, Foam};
use moca_sim::{BodyPart, Engine, Integrator, Mobility, Person, Scene, Shape, VirtualBoardConfig};
use moca_tactile::Firmware;

/// Averaging and holding period of the ideal sensor, ms.
const IDEAL_PERIOD_MS: f64 = 10.0;

/// Sensor of the cover.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Sensor {
    /// A stock Touch Board: bytes, age, noise, threshold.
    Stock,
    /// The true force, averaged and held over a period.
    Ideal,
    /// No cover: the controller is told zero.
    Off,
}

impl Sensor {
    /// Name of the sensor, as `--set sensor=` takes it.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Stock => "stock",
            Self::Ideal => "ideal",
            Self::Off => "off",
        }
    }
}

/// Person next to the robot. `None` takes the value of the body part.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct PersonSettings {
    /// Part of the body that is met.
    pub part: BodyPart,
    /// 0 is T1.
    pub taxel: usize,
    /// Gap to the cover at the start, m.
    pub gap_m: f64,
    /// Along the panel from the taxel's centre, m.
    pub offset_m: f64,
    /// Plates that the body presses at once, each by all of its depth, 1 to 3.
    pub plates: u8,
    /// Another one like this stands before the middle of this taxel.
    pub also: Option<usize>,
    /// Mass, kg.
    pub mass_kg: Option<f64>,
    /// Stiffness of the tissue, N/m.
    pub stiffness: Option<f64>,
    /// Damping of the tissue, N·s/m.
    pub damping: f64,
    /// Coulomb coefficient along the cover.
    pub friction: Option<f64>,
    /// Stiffness with which the person keeps the posture, N/m.
    pub posture_stiffness: Option<f64>,
    /// Damping of the posture, N·s/m.
    pub posture_damping: Option<f64>,
    /// Radius of leg, thigh or hand, m.
    pub radius_m: Option<f64>,
    /// Time from first contact to the step away, s.
    pub steps_away_s: f64,
    /// When walking and leaning begin, s after the run's start.
    pub at_s: f64,
    /// Walking speed towards the cover, m/s.
    pub walk_m_s: f64,
    /// Weight leant on the cover, N.
    pub lean_n: f64,
    /// True for a person who cannot move.
    pub fixed: bool,
}

impl PersonSettings {
    /// Stiffness of the tissue, N/m.
    pub fn tissue_stiffness(&self) -> f64 {
        self.stiffness.unwrap_or(self.part.data().1.stiffness_n_per_m)
    }

    /// Place along the panel from the taxel's centre, m: a flat body lies in the middle of the plates that it presses, so that no small
    /// slide changes which they are. `None` without such a taxel.
    fn offset_m(&self, cover: &[TaxelPlacement]) -> Option<f64> {
        let TaxelPlacement { position_base_m: [x, y], inward_angle_base_rad } = *cover.get(self.taxel)?;
        if self.plates < 2 {
            return Some(self.offset_m);
        }
        let (sin, cos) = inward_angle_base_rad.sin_cos();
        let of_side =
            cover.iter().filter(|taxel| (taxel.inward_angle_base_rad - inward_angle_base_rad).abs() < 1e-6);
        let along_m = |[of_x, of_y]: [f64; 2]| (of_x - x) * sin - (of_y - y) * cos;
        let mut plates_m: Vec<f64> = of_side.map(|taxel| along_m(taxel.position_base_m)).collect();
        plates_m.sort_by(|a, b| (a - self.offset_m).abs().total_cmp(&(b - self.offset_m).abs()));
        plates_m.truncate(usize::from(self.plates));
        #[expect(clippy::cast_precision_loss, reason = "three at most")]
        Some(plates_m.iter().sum::<f64>() / plates_m.len() as f64)
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
        let offset_m = self.offset_m(cover).context("no such taxel")?;
        let person = Person::before(cover, self.taxel, self.gap_m, offset_m, shape, tissue, mobility)
            .context("no such taxel")?;
        Ok(Person {
            friction: self.friction.unwrap_or(person.friction),
            starts_after_s: self.at_s,
            walk_m_s: self.walk_m_s,
            lean_n: self.lean_n,
            plates: self.plates.max(1),
            steps_away_after_s: (self.part != BodyPart::Wall).then_some(self.steps_away_s),
            ..person
        })
    }
}

/// Foam of the cover. What is `None` is as the material has it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FoamSettings {
    /// Law of the foam with its numbers.
    pub material: Foam,
    /// Plate gap at rest, m.
    pub thickness_m: Option<f64>,
    /// Initial stiffness of the hyperbolic law, N/m.
    pub stiffness: Option<f64>,
    /// Damping over stiffness, ms.
    pub damping_ms: Option<f64>,
}

impl FoamSettings {
    fn foam(&self) -> Foam {
        let mut foam = self.material;
        foam.gap_m = self.thickness_m.unwrap_or(foam.gap_m);
        foam.damping_time_s = self.damping_ms.map_or(foam.damping_time_s, |ms| 1e-3 * ms);
        if let (ElasticLaw::Hyperbolic { stiffness_n_per_m }, Some(stiffness)) =
            (&mut foam.elastic, self.stiffness)
        {
            *stiffness_n_per_m = stiffness;
        }
        foam
    }
}

/// One run, completely described.
#[derive(Clone, Debug, PartialEq)]
pub struct Settings {
    /// Configuration of the robot.
    pub config: Config,
    /// Source of the readings.
    pub sensor: Sensor,
    /// `None` is 10 ms for the ideal sensor and what the firmware takes for the virtual board.
    pub sensor_period_ms: Option<f64>,
    /// Source of the ideal sensor's mean.
    pub sensor_samples: TrueForces,
    /// Phase of the sensor against the motion, ms.
    pub sensor_phase_ms: f64,
    /// Standard deviation of one FDAT value, counts; `None` is that of the virtual board.
    pub noise_counts: Option<f64>,
    /// Firmware of the virtual board.
    pub firmware: Firmware,
    /// The robot is not told the true wrench at the flange: it has the momentum observer's, or its flange sensor's.
    pub flange_observed: bool,
    /// Foam of the cover.
    pub foam: FoamSettings,
    /// Person next to the robot.
    pub person: PersonSettings,
    /// Reading of the cover, relative to the true force.
    pub true_reading: f64,
    /// Inertia of the base about the vertical, kg·m²; `None` is that of its box.
    pub base_inertia: Option<f64>,
    /// Speed of the flange's target, m/s.
    pub speed_m_s: f64,
    /// Length of the run, s.
    pub duration_s: f64,
    /// Length of a scripted push, ramps included, s.
    pub push_s: f64,
    /// Length of each ramp of a push, s.
    pub ramp_s: f64,
    /// Forces of the scripted pushes over the paper's.
    pub push_scale: f64,
    /// Rest after a push, s.
    pub rest_s: f64,
    /// Physics step, ms.
    pub step_ms: f64,
    /// `None` is what the scene takes: the default, or under `accuracy` the leapfrog.
    pub integrator: Option<Integrator>,
    /// Engine of the scene.
    pub engine: Engine,
    /// The controller believes what commissioning of this robot measures; else what its configuration says.
    pub belief_measured: bool,
}

/// The paper's robot has no speed limit but its own, pushes as hard as its law does, and goes wherever it is pushed; limits
/// this high change no bit.
pub fn unprotected() -> ProtectionConfig {
    ProtectionConfig {
        override_speed_limit_m_s: OVERRIDE_MAX_M_S,
        override_statement: "the paper's experiments, simulated, as published".into(),
        uncovered_m: 100.0,
        contact_barrier: BarrierReadings::Off,
        ..ProtectionConfig::default()
    }
}

impl Settings {
    /// The paper's law and gains, stock board, no scripted hand.
    pub fn paper(law: Law) -> Self {
        let mut config = Config::default();
        config.startup.law = law;
        config.simulation.hand = HandConfig::none();
        config.board.model = AssumedModel::Paper;
        config.protection = unprotected();
        config.control.recentre = RecentrePolicy::Always;
        config.control.corrections.null_space_damping = false;
        config.control.corrections.base_coupling = false;
        config.control.corrections.flange_wrench_feedforward = false;
        Self {
            config,
            sensor: Sensor::Stock,
            sensor_period_ms: None,
            sensor_samples: TrueForces::AtTicks,
            sensor_phase_ms: 0.0,
            noise_counts: None,
            firmware: Firmware::Stock2018,
            flange_observed: false,
            foam: FoamSettings {
                material: Foam::default(),
                thickness_m: None,
                stiffness: None,
                damping_ms: None,
            },
            person: PersonSettings { gap_m: 0.25, steps_away_s: 1.5, ..PersonSettings::default() },
            true_reading: 1.0,
            base_inertia: None,
            speed_m_s: 0.2,
            duration_s: 8.0,
            push_s: 3.0,
            ramp_s: 0.3,
            push_scale: 1.0,
            rest_s: 2.0,
            step_ms: 1.0,
            integrator: None,
            engine: Engine::default(),
            belief_measured: false,
        }
    }

    /// Gives the base the inertia of a box of its mass and size, or the one that is set. It never tilts: only the
    /// vertical axis acts, and the other two keep the box's proportions.
    pub fn box_inertia(&mut self) {
        let squares = |[x, y, z]: [f64; 3]| [y * y + z * z, x * x + z * z, x * x + y * y];
        let (standard, base) = (BaseTable::default(), &mut self.config.robot.base);
        let (ours, its) = (squares(base.size_m), squares(standard.size_m));
        let mut inertia = standard.inertia_com_diagonal;
        for (i, inertia) in inertia.iter_mut().enumerate() {
            *inertia *= base.mass_kg / standard.mass_kg * (ours[i] / its[i]);
        }
        let given = self.base_inertia.map_or(1.0, |about_vertical| about_vertical / inertia[2]);
        base.inertia_com_diagonal = inertia.map(|inertia| given * inertia);
    }

    /// Checks what single keys cannot know.
    ///
    /// # Errors
    /// Every number that the daemon's configuration refuses, and numbers that do not go together.
    pub fn check(&self) -> Result<()> {
        let mut mistakes = Vec::new();
        self.config.check(|_, message| mistakes.push(message));
        if let (Some(stiffness), ElasticLaw::Power { .. }) = (self.foam.stiffness, self.foam.material.elastic)
        {
            mistakes.push(format!(
                "foam.stiffness = {stiffness} N/m: {} follows a power law and has no initial stiffness; set foam.scale, \
                 or foam=collision-assumed",
                self.foam.material.name
            ));
        }
        if self.config.control.compensation.time_s > 0.0 && !self.flange_observed {
            mistakes.push(
                "compensation.time: it follows the momentum observer, which runs with flange=observed only"
                    .to_owned(),
            );
        }
        if self.push_s < 2.0 * self.ramp_s {
            mistakes.push(format!(
                "push_s = {} s is shorter than its two ramps of ramp_s = {} s",
                self.push_s, self.ramp_s
            ));
        }
        ensure!(mistakes.is_empty(), "{}", mistakes.join("\n"));
        Ok(())
    }

    /// The foam that force and plate gap are computed with.
    pub fn true_foam(&self) -> Foam {
        let truth = &self.config.simulation.truth.foam;
        match truth.kind.0 {
            Some(_) => simulated_robot::true_foam(&self.config),
            None => self.foam.foam().as_is(truth),
        }
    }

    /// Source of the wrench at the flange, as the key `flange` names it.
    pub const fn flange_source(&self) -> &'static str {
        match (self.config.plant.flange_sensor, self.flange_observed) {
            (FlangeSensorKind::None, false) => "true",
            (FlangeSensorKind::None, true) => "observed",
            (FlangeSensorKind::Simulated | FlangeSensorKind::Own, _) => "sensor",
        }
    }

    /// The scene without anybody in it.
    pub fn free_scene(&self) -> Scene {
        let scene = simulated_robot::free_scene(&self.config);
        Scene {
            flange_sensor: !self.flange_observed,
            foam: self.true_foam(),
            physics_step_s: 1e-3 * self.step_ms,
            integrator: self.integrator.unwrap_or(scene.integrator),
            engine: self.engine,
            ..scene
        }
    }

    /// Returns the scene with the person next to the cover.
    pub fn collision_scene(&self) -> Result<Scene> {
        let cover = self.config.robot.cover.placements();
        let mut people = vec![self.person.person(&cover)?];
        if let Some(taxel) = self.person.also {
            people.push(PersonSettings { taxel, offset_m: 0.0, ..self.person }.person(&cover)?);
        }
        Ok(Scene { people, ..self.free_scene() })
    }

    /// Period of the sensor, ms.
    pub fn period_ms(&self) -> f64 {
        #[expect(clippy::cast_precision_loss, reason = "some milliseconds")]
        let of_firmware_ms = 1e-6 * self.firmware.frame_period_ns() as f64;
        let usual_ms = if self.sensor == Sensor::Stock { of_firmware_ms } else { IDEAL_PERIOD_MS };
        self.sensor_period_ms.unwrap_or(usual_ms)
    }

    /// Shows what the sensor feels by a share of its period later.
    pub fn shift_phase(&mut self, share: f64) {
        self.sensor_phase_ms += share * self.period_ms();
    }

    /// The virtual board of this run.
    pub fn board(&self) -> VirtualBoardConfig {
        VirtualBoardConfig {
            firmware: self.firmware,
            foam: self.true_foam().stiffened(1.0 / self.true_reading),
            noise_counts: self.noise_counts,
            #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "1 to 1000 ms")]
            frame_period_ns: self.sensor_period_ms.map(|ms| (1e6 * ms) as u64),
            seed: self.config.simulation.seed,
            ..VirtualBoardConfig::default()
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn flat_body_lies_in_the_middle_of_its_plates() {
        let [front_m, side_m] = [0.2586, 0.2445];
        for (taxel, plates, offset_m, expected_m) in [
            ("T6", 1, 0.03, [0.0, 0.03]),
            ("T6", 3, 0.0, [0.0, 0.0]),
            ("T6", 2, 0.01, [0.0, 0.5 * front_m]),
            ("T6", 2, -0.01, [0.0, -0.5 * front_m]),
            // at the end of a side its other plates are on one side of it
            ("T7", 3, 0.0, [0.0, front_m]),
            ("T11", 2, 0.0, [-0.5 * side_m, 0.0]),
            ("T11", 3, 0.0, [-side_m, 0.0]),
            ("T1", 3, 0.0, [side_m, 0.0]),
        ] {
            let mut settings = Settings::paper(moca_msgs::Law::Impedance);
            settings
                .set_all([
                    format!("person.taxel={taxel}"),
                    format!("person.plates={plates}"),
                    format!("person.offset={offset_m}"),
                ])
                .unwrap();
            let cover = settings.config.robot.cover.placements();
            let person = settings.collision_scene().unwrap().people[0];
            let middle = Person::before(
                &cover,
                settings.person.taxel,
                settings.person.gap_m,
                0.0,
                person.shape,
                person.tissue,
                person.mobility,
            )
            .unwrap();
            let [x, y] = [0, 1].map(|axis| person.position_world[axis] - middle.position_world[axis]);
            let off_m = (x - expected_m[0]).hypot(y - expected_m[1]);
            assert!(off_m < 1e-3, "{plates} plates at {taxel}: {x} and {y} m");
        }
    }
}
