//! `moca-lab docs --only flange-wrench`: experiment B2 with the wrench at the flange from its sensor, from the momentum observer, and
//! the true one; how far each is off, axis by axis.

use super::push;
use super::pushes::pushes_b2;
use anyhow::{Result, ensure};
use moca_experiments::closed_loop::{Loads, Rig};
use moca_experiments::measure::rms;
use moca_experiments::parallel;
use moca_experiments::settings::{Sensor, Settings};
use moca_msgs::Law;
use moca_sim::Engine;
use std::fmt::Write as _;

/// Sources of the wrench, by name and assignment.
const SOURCES: [(&str, &str); 3] =
    [("true", "flange=true"), ("observer", "flange=observed"), ("sensor", "flange=sensor")];
/// Errors of the sensor. ASSUMED: magnitudes of the data sheets of 6-axis sensors for collaborative arms of 300 N and 30 N·m, with 100
/// readings a second, while they warm up; of no product.
const SENSOR: &[&str] = &[
    "true.flange_sensor.bias_n=12,-7,20",
    "true.flange_sensor.bias_nm=0.5,-0.3,0.2",
    "true.flange_sensor.noise_n=0.1",
    "true.flange_sensor.noise_nm=0.005",
    "true.flange_sensor.drift_n_s=0.005",
    "true.flange_sensor.drift_nm_s=0.0005",
    "true.flange_sensor.delay_ms=10",
];
/// Mass of the tool, kg, and its centre of mass in the flange's axes, m.
const TOOL: (f64, [f64; 3]) = (1.0, [0.0, 0.0, 0.05]);
/// Rate, rad/s, and time, s, with which the flange turns about the world's x axis.
const TURN: (f64, f64) = (0.4, 2.0);
/// Rest after the turn, s.
const REST_S: f64 = 1.0;

/// Arm of a run.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
struct Arm {
    name: &'static str,
    tool_is_believed: bool,
    /// Assignments of the truth.
    truth: &'static [&'static str],
    /// The flange turns after the tare and before the pushes.
    turns: bool,
}

const UNKNOWN_TOOL: &[&str] = &["true.arm.tool_mass=1", "true.arm.tool_com=0,0,0.05"];
const ARMS: [Arm; 6] = [
    Arm { name: "as believed", tool_is_believed: false, truth: &[], turns: false },
    Arm {
        name: "friction 1 N·m",
        tool_is_believed: false,
        truth: &["true.arm.joint_friction=1"],
        turns: false,
    },
    Arm { name: "believed tool of 1 kg", tool_is_believed: true, truth: &[], turns: false },
    Arm { name: "believed tool of 1 kg, turned", tool_is_believed: true, truth: &[], turns: true },
    Arm { name: "unknown tool of 1 kg", tool_is_believed: false, truth: UNKNOWN_TOOL, turns: false },
    Arm { name: "unknown tool of 1 kg, turned", tool_is_believed: false, truth: UNKNOWN_TOOL, turns: true },
];

/// Errors of a run, and the way of its base in B2-i.
#[derive(Clone, Copy, Debug)]
struct Errors {
    /// Root mean square of each axis, N and N·m.
    rms: [f64; 6],
    /// Largest of each axis, N and N·m.
    most: [f64; 6],
    base_m: f64,
}

impl Errors {
    fn of(arm: &Arm, source: &str) -> Result<Self> {
        let mut settings = Settings { sensor: Sensor::Ideal, ..Settings::paper(Law::FollowMe) };
        settings.engine = Engine::Analytic;
        settings.set_all(SENSOR)?;
        settings.set_all([source, "sensor.phase_ms=1000"])?;
        settings.set_all(arm.truth)?;
        if arm.tool_is_believed {
            let tool = &mut settings.config.robot.tool;
            (tool.mass_kg, tool.com_m) = TOOL;
        }
        let mut rig = Rig::start(&settings, &settings.free_scene())?;
        if arm.turns {
            rig.set_target_twist([0.0, 0.0, 0.0, TURN.0, 0.0, 0.0])?;
            rig.run_for(TURN.1, |_| Loads::default())?;
            rig.set_target_twist([0.0; 6])?;
            rig.run_for(REST_S, |_| Loads::default())?;
        }
        let first = rig.rows.len();
        let outcomes = push::run(&mut rig, &settings, &pushes_b2())?;
        ensure!(rig.stopped.is_none(), "{}, {source}: {:?}", arm.name, rig.stopped);
        let off = |axis: usize| {
            rig.rows[first..]
                .iter()
                .map(move |row| (row.flange_wrench_felt_world[axis] - row.flange_wrench_world[axis]).abs())
        };
        Ok(Self {
            rms: std::array::from_fn(|axis| rms(off(axis))),
            most: std::array::from_fn(|axis| off(axis).fold(0.0, f64::max)),
            base_m: outcomes[0].base_displacement[0],
        })
    }
}

/// The table of every arm and source.
pub(crate) fn markdown() -> Result<String> {
    let cases: Vec<_> = ARMS.iter().flat_map(|arm| SOURCES.map(|source| (arm, source))).collect();
    let rows = parallel::run("flange wrenches", &cases, |(arm, source)| Errors::of(arm, source.1))?;
    let mut out = String::from("| arm | wrench from |");
    for (axis, unit) in [("fx", "N"), ("fy", "N"), ("fz", "N"), ("mx", "N·m"), ("my", "N·m"), ("mz", "N·m")]
    {
        // Writing to a string cannot fail.
        let _ = write!(out, " {axis}: RMS, {unit} | {axis}: largest, {unit} |");
    }
    out += " B2-i: way of the base, m |\n|---|---|";
    out += &"---|".repeat(13);
    out.push('\n');
    for ((arm, (source, _)), errors) in cases.iter().zip(rows) {
        let _ = write!(out, "| {} | {source} |", arm.name);
        for (axis, (rms, most)) in errors.rms.iter().zip(errors.most).enumerate() {
            let digits = if axis < 3 { 2 } else { 3 };
            let _ = write!(out, " {rms:.digits$} | {most:.digits$} |");
        }
        let _ = writeln!(out, " {:.3} |", errors.base_m);
    }
    Ok(out)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn tare_hides_unknown_weight_until_flange_turns() {
        let [.., believed, unknown, unknown_turned] = ARMS;
        let force = |arm: &Arm| {
            let [x, y, z, ..] = Errors::of(arm, "flange=sensor").unwrap().rms;
            (x * x + y * y + z * z).sqrt()
        };
        let (believed, unknown, turned) = (force(&believed), force(&unknown), force(&unknown_turned));
        assert!(believed < 1.0 && unknown < 1.0, "{believed} {unknown} N");
        // |W - R W| of a turn by 0.8 rad
        let weight_n = 9.81 * TOOL.0 * 2.0 * (0.5 * TURN.0 * TURN.1).sin();
        assert!((turned / weight_n - 1.0).abs() < 0.1, "{turned} of {weight_n} N");
    }

    #[test]
    fn sensor_is_nearer_than_observer_under_friction() {
        let rms = |source: &str| Errors::of(&ARMS[1], source).unwrap().rms;
        let (sensor, observer) = (rms("flange=sensor"), rms("flange=observed"));
        for axis in 0..3 {
            assert!(sensor[axis] < observer[axis], "axis {axis}: {sensor:?} {observer:?}");
        }
    }
}
