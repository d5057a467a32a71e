//! `moca-lab docs --only real-arm`: how far the flange is off in every experiment where the arm is not the one believed: without
//! the compensation of unknown loads, with it, and where four fifths of the friction are known besides.

use super::push::{self, Push};
use super::report::{collision_under_barrier, collision_with};
use anyhow::{Result, ensure};
use moca_control::config::{ControlConfig, ProtectionConfig};
use moca_experiments::closed_loop::{Loads, Rig, Row};
use moca_experiments::collision;
use moca_experiments::measure::rms;
use moca_experiments::parallel;
use moca_experiments::settings::{Sensor, Settings};
use moca_msgs::Law;
use moca_sim::Engine;
use std::fmt::Write as _;

/// Arms, by name and assignments.
const ARMS: [(&str, &[&str]); 6] = [
    ("as believed", &[]),
    ("10 % heavier", &["true.arm.mass_scale=1.1"]),
    ("tool of 1 kg", &["true.arm.tool_mass=1", "true.arm.tool_com=0,0,0.05"]),
    ("friction 1 N·m", &["true.arm.joint_friction=1"]),
    ("noise 0.3 N·m", &["true.arm.torque_noise=0.3"]),
    (
        "all of it",
        &[
            "true.arm.mass_scale=1.1",
            "true.arm.tool_mass=1",
            "true.arm.tool_com=0,0,0.05",
            "true.arm.joint_friction=1",
            "true.arm.torque_noise=0.3",
        ],
    ),
];
/// Compensations.
const COMPENSATIONS: [Compensation; 3] = [
    Compensation { name: "off", time_s: 0.0, known_friction: 0.0 },
    Compensation { name: "on", time_s: 0.5, known_friction: 0.0 },
    Compensation { name: "on, 80 % of the friction known", time_s: 0.5, known_friction: 0.8 },
];
/// Rest after a push, s.
const REST_S: f64 = 1.0;

/// Compensation of what the arm's model does not know.
#[derive(Clone, Copy, Debug)]
struct Compensation {
    name: &'static str,
    /// Time constant of unknown loads, s; 0 learns none.
    time_s: f64,
    /// Share of the arm's friction that is known and compensated at once.
    known_friction: f64,
}

impl Compensation {
    fn set(&self, settings: &mut Settings) -> Result<()> {
        settings.set(&format!("compensation.time={}", self.time_s))?;
        let friction_nm = self.known_friction * settings.config.simulation.truth.arm.joint_friction_nm;
        settings.config.control.compensation.friction_nm = vec![friction_nm; settings.config.arm().joints];
        Ok(())
    }
}

/// Motion of an experiment.
#[derive(Clone, Debug)]
enum Motion {
    Push(Push),
    /// The flange is led with this velocity, world axes, m/s, until half of the time.
    Led([f64; 3]),
    Collision,
}

/// An experiment and its settings.
#[derive(Clone, Debug)]
struct Experiment {
    name: String,
    settings: Settings,
    motion: Motion,
}

impl Experiment {
    fn of_push(name: &str, mut settings: Settings, push: Push) -> Self {
        settings.rest_s = REST_S;
        Self { name: name.to_owned(), settings, motion: Motion::Push(push) }
    }

    /// Every experiment that says how far the flange is off.
    fn all() -> Result<Vec<Self>> {
        let mut all = Vec::new();
        for taxel in 0..moca_experiments::TAXELS {
            let name = format!("push T{} 20 N", taxel + 1);
            all.push(Self::of_push(&name, corrected(Law::Impedance)?, push::single(&[taxel], 20.0)));
        }
        for (name, taxel) in [("push T1 20 N, literal", 0), ("push T6 20 N, literal", 5)] {
            all.push(Self::of_push(name, literal(Law::Impedance), push::single(&[taxel], 20.0)));
        }
        all.push(Self::of_push("push T1 10 N, follow-me", literal(Law::FollowMe), push::single(&[0], 10.0)));
        let lift = Push::taxels("lift", &[]).and_flange([0.0, 0.0, 15.0]);
        let sideways = Push::taxels("sideways", &[]).and_flange([0.0, 15.0, 0.0]);
        all.push(Self::of_push("flange +z 15 N", corrected(Law::Impedance)?, lift));
        all.push(Self::of_push("flange +y 15 N", corrected(Law::Impedance)?, sideways));
        let forward = Push::taxels("forward", &[]).and_flange([15.0, 0.0, 0.0]);
        all.push(Self::of_push("flange +x 15 N, follow-me", literal(Law::FollowMe), forward));
        for (law, name) in [(Law::Impedance, "impedance"), (Law::FollowMe, "follow-me")] {
            for (taxel, force_n, seconds) in [(9, 100.0, 10.0), (2, 40.0, 60.0)] {
                let name = format!("lean T{} {force_n} N, {seconds} s, {name}", taxel + 1);
                let mut settings = shipped(law);
                settings.push_s = seconds;
                all.push(Self::of_push(&name, settings, push::single(&[taxel], force_n)));
            }
        }
        let mut led = corrected(Law::Impedance)?;
        led.duration_s = 5.0;
        let name = "target led at 0.2 m/s".to_owned();
        all.push(Self { name, settings: led, motion: Motion::Led([0.0, 0.2, 0.0]) });
        for (name, mut settings) in [
            ("collision, literal", collision_with(Sensor::Ideal)),
            ("collision, barrier", collision_under_barrier()?),
        ] {
            settings.duration_s = 4.0;
            all.push(Self { name: name.to_owned(), settings, motion: Motion::Collision });
        }
        Ok(all)
    }

    fn rows(&self, arm: usize, compensation: &Compensation) -> Result<Vec<Row>> {
        let mut settings = self.settings.clone();
        settings.engine = Engine::Analytic;
        // a second on the armed robot before the experiment: the first load is taken in
        settings.set_all(["flange=observed", "sensor.phase_ms=1000"])?;
        settings.set_all(ARMS[arm].1)?;
        compensation.set(&mut settings)?;
        let rig = match &self.motion {
            Motion::Push(push) => {
                let mut rig = Rig::start(&settings, &settings.free_scene())?;
                let (length_s, ramp_s) = (settings.push_s, settings.ramp_s);
                rig.run_for(length_s, |t_s| push.at(t_s, length_s, ramp_s))?;
                rig.run_for(settings.rest_s, |_| Loads::default())?;
                rig
            }
            Motion::Led(velocity) => {
                let mut rig = Rig::start(&settings, &settings.free_scene())?;
                rig.move_target(*velocity)?;
                rig.run_for(0.5 * settings.duration_s, |_| Loads::default())?;
                rig.move_target([0.0; 3])?;
                rig.run_for(0.5 * settings.duration_s, |_| Loads::default())?;
                rig
            }
            Motion::Collision => collision::once(&settings)?,
        };
        ensure!(rig.stopped.is_none(), "{}, {}: {:?}", self.name, ARMS[arm].0, rig.stopped);
        Ok(rig.rows)
    }

    /// A hand at the flange moves it off its target: its error is the difference from the arm as believed without compensation.
    fn is_pushed_at_flange(&self) -> bool {
        matches!(&self.motion, Motion::Push(push) if push.loads.flange_world.iter().any(|f| f.abs() > 0.0))
    }

    /// Row of the table for one compensation.
    fn row(&self, compensation: &Compensation) -> Result<String> {
        let spring = self.is_pushed_at_flange().then(|| self.rows(0, &COMPENSATIONS[0])).transpose()?;
        let mut out = format!("| {} | {} |", self.name, compensation.name);
        for arm in 0..ARMS.len() {
            let [rms_mm, most_mm] = errors_mm(&self.rows(arm, compensation)?, spring.as_deref());
            // Writing to a string cannot fail.
            let _ = write!(out, " {rms_mm:.2} | {most_mm:.1} |");
        }
        Ok(out)
    }
}

/// RMS and largest distance of the flange from its target, or of that from the one in `spring`, mm.
fn errors_mm(rows: &[Row], spring: Option<&[Row]>) -> [f64; 2] {
    let off =
        |row: &Row| std::array::from_fn::<f64, 3, _>(|i| row.flange_world[i] - row.flange_desired_world[i]);
    let distance = |[x, y, z]: [f64; 3]| (x * x + y * y + z * z).sqrt();
    let errors_m: Vec<f64> = match spring {
        None => rows.iter().map(|row| distance(off(row))).collect(),
        Some(spring) => {
            let apart = |(a, b): (&Row, &Row)| {
                let (a, b) = (off(a), off(b));
                distance(std::array::from_fn(|i| a[i] - b[i]))
            };
            rows.iter().zip(spring).map(apart).collect()
        }
    };
    [1e3 * rms(errors_m.iter().copied()), 1e3 * errors_m.iter().copied().fold(0.0, f64::max)]
}

/// The law as published, with an ideal cover.
fn literal(law: Law) -> Settings {
    Settings { sensor: Sensor::Ideal, ..Settings::paper(law) }
}

/// The law with both corrections, under which the flange is claimed to be off by less than a millimetre.
fn corrected(law: Law) -> Result<Settings> {
    let mut settings = literal(law);
    settings.set_all(["null_space_damping=true", "base_coupling=true"])?;
    Ok(settings)
}

/// The robot as it ships, without a calibration.
fn shipped(law: Law) -> Settings {
    let mut settings = literal(law);
    settings.config.control = ControlConfig::default();
    settings.config.protection = ProtectionConfig::default();
    settings
}

/// The table of every experiment.
pub(crate) fn markdown() -> Result<String> {
    let all = Experiment::all()?.into_iter();
    let cases: Vec<(Experiment, Compensation)> =
        all.flat_map(|one| COMPENSATIONS.map(|compensation| (one.clone(), compensation))).collect();
    let rows = parallel::run("arms", &cases, |(one, compensation)| one.row(compensation))?;
    let mut out = String::from("| experiment | compensation |");
    for (arm, _) in ARMS {
        let _ = write!(out, " {arm}: RMS, mm | largest, mm |");
    }
    out += "\n|---|---|";
    out += &"---|---|".repeat(ARMS.len());
    out.push('\n');
    for row in rows {
        out += &row;
        out.push('\n');
    }
    Ok(out)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn named(name: &str) -> Experiment {
        Experiment::all().unwrap().into_iter().find(|one| one.name == name).unwrap()
    }

    /// All of them take minutes: one push is run.
    #[test]
    fn push_on_real_arm_matches_its_row() {
        let Some(shown) = crate::docs::shown("real-arm") else { return };
        for compensation in COMPENSATIONS {
            let row = named("push T1 20 N").row(&compensation).unwrap();
            let row = crate::docs::as_shown("real-arm", &format!("{row}\n"));
            let row = row.lines().last().unwrap().to_owned();
            assert!(shown.lines().any(|line| line == row), "`moca-lab docs --only real-arm`: {row}");
        }
    }

    #[test]
    fn compensation_halves_error_and_keeps_the_spring() {
        let (push, lift) = (named("push T6 20 N"), named("flange +z 15 N"));
        let all = ARMS.len() - 1;
        let [off, on, known] = COMPENSATIONS;
        let error = |compensation| errors_mm(&push.rows(all, compensation).unwrap(), None)[0];
        let (without, with, best) = (error(&off), error(&on), error(&known));
        assert!(without > 10.0 && with < 3.0 && best < 1.0, "{without} {with} {best} mm RMS");
        let lifted = |compensation| errors_mm(&lift.rows(0, compensation).unwrap(), None)[1];
        let (spring, compensated) = (lifted(&off), lifted(&on));
        assert!(compensated > 0.85 * spring, "a hand still lifts the flange: {spring} {compensated} mm");
        let spring = lift.rows(0, &off).unwrap();
        let lifted = |compensation| errors_mm(&lift.rows(all, compensation).unwrap(), Some(&spring))[0];
        let (hidden, known) = (lifted(&on), lifted(&known));
        assert!(
            hidden > 3.0 && known < 3.0,
            "friction hides a hand less where it is known: {hidden} {known} mm RMS"
        );
    }

    #[test]
    fn friction_believed_too_large_hunts_within_its_bound() {
        let mut push = named("push T1 20 N");
        let off = errors_mm(&push.rows(0, &COMPENSATIONS[0]).unwrap(), None)[1];
        push.settings.config.control.compensation.friction_nm = vec![1.0; push.settings.config.arm().joints];
        let mut settings = push.settings.clone();
        settings.engine = Engine::Analytic;
        settings.set_all(["flange=observed", "sensor.phase_ms=1000"]).unwrap();
        let mut rig = Rig::start(&settings, &settings.free_scene()).unwrap();
        let Motion::Push(hand) = &push.motion else { panic!("a push") };
        rig.run_for(settings.push_s, |t_s| hand.at(t_s, settings.push_s, settings.ramp_s)).unwrap();
        assert!(rig.stopped.is_none(), "{:?}", rig.stopped);
        let hunts = errors_mm(&rig.rows, None)[1];
        assert!(off < 1.0 && hunts > 3.0 && hunts < 10.0, "{off} {hunts} mm");
    }
}
