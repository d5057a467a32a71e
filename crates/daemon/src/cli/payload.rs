//! `mocad payload bare | identify`: the load at the flange, measured on a running robot.
#![expect(clippy::print_stdout, reason = "this module is what the user sees on the terminal")]

use crate::cli::configuration;
use crate::cli::operator::{Arguments, Operator, Stopped, interrupted};
use crate::cli::remote::{LOOK_EVERY, Refused, news, settled};
use crate::control::load_identification::{Belief, Identified, Measured, Sweeps, identify};
use anyhow::{Context, Result, bail, ensure};
use clap::{Args, Subcommand};
use moca_figures::progress::Progress;
use moca_msgs::target::TargetPhase;
use moca_msgs::{Mode, ParameterValues, Refusal, Request, Sample, Target, TargetRefusal, TimedTarget};
use moca_telemetry::RobotDescription;
use moca_telemetry::net::wire::unix_now_ns;
use serde::{Deserialize, Serialize};
use std::fs;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant, SystemTime};

/// Period at which the posture is sent on.
const SEND_EVERY: Duration = Duration::from_millis(20);

/// Measurement of what the flange carries. The arm turns through six postures for two and a half minutes and goes back. The reference
/// of each joint turns at 0.05 rad/s at most. Nobody may touch the robot.
#[derive(Subcommand)]
pub enum Command {
    /// Measure the bare flange: what is wrong with the arm's model.
    Bare {
        /// Write the measurement into this file.
        #[arg(long, value_name = "FILE")]
        out: PathBuf,
        /// Which daemon.
        #[command(flatten)]
        common: Arguments,
    },
    /// Measure the flange with its load, and print the load's mass and centre of mass.
    Identify(IdentifyArguments),
}

/// Options of an identification.
#[derive(Args)]
pub struct IdentifyArguments {
    /// The bare flange, as `mocad payload bare` measured it.
    #[arg(long, value_name = "FILE")]
    bare: PathBuf,
    /// Configuration of the robot.
    #[arg(long, value_name = "FILE")]
    config: Option<PathBuf>,
    /// Write the load into that configuration.
    #[arg(long, requires = "config")]
    write: bool,
    #[command(flatten)]
    common: Arguments,
}

/// File of a bare flange.
#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct BareFlange {
    /// When it was measured.
    date: String,
    /// Name of the arm.
    arm: String,
    /// Load that the controller counted with.
    believed: Belief,
    measured: Measured,
}

/// Carries out one command.
///
/// # Errors
/// As for the other commands; [`Refused`] if somebody touches the robot; a load that cannot be identified, and then nothing is written.
pub fn run(command: &Command) -> Result<()> {
    let date = humantime::format_rfc3339_seconds(SystemTime::now());
    match command {
        Command::Bare { out, common } => {
            // A folder that cannot be written is told before the arm moves. An earlier measurement stays until this one ends.
            let opened = fs::OpenOptions::new().append(true).create(true).open(out);
            drop(opened.with_context(|| out.display().to_string())?);
            let (arm, believed, measured) = measure(common)?;
            let bare = BareFlange { date: date.to_string(), arm, believed, measured };
            fs::write(out, toml::to_string(&bare)?).with_context(|| out.display().to_string())?;
            println!(
                "Written into {}. Now mount the load: mocad payload identify --bare {}",
                out.display(),
                out.display()
            );
        }
        Command::Identify(IdentifyArguments { bare, config, write, common }) => {
            let bare = read(bare)?;
            if let Some(path) = config {
                configuration::read(path)?;
            }
            let (arm, believed, measured) = measure(common)?;
            ensure!(bare.arm == arm, "the bare flange is of {}, this arm is {arm}", bare.arm);
            let load = identify(&bare.measured, &measured, bare.believed, believed)?;
            let note = format!(
                "measured {date}, rms residual {:.2} N, {:.3} N·m",
                load.residual[0], load.residual[1]
            );
            let [x, y, z] = load.com_m;
            println!(
                "Load of {:.3} kg at {x:.4}, {y:.4}, {z:.4} m in the flange's axes; {note}.",
                load.mass_kg
            );
            match config.as_deref().filter(|_| *write) {
                Some(path) => {
                    configuration::replace(path, &entered(&configuration::read(path)?, &load, &note)?)?;
                    println!("Written into {}. mocad counts with it from its next start on.", path.display());
                }
                None => println!(
                    "For the configuration (`--config FILE --write` enters it):\n{}",
                    entered("", &load, &note)?
                ),
            }
        }
    }
    Ok(())
}

fn read(path: &Path) -> Result<BareFlange> {
    let text = fs::read_to_string(path).with_context(|| path.display().to_string())?;
    toml::from_str(&text).with_context(|| format!("{} is not a file of `mocad payload bare`", path.display()))
}

/// `text` with the load in its section `[robot.load]`, as a point; everything else as it was.
fn entered(text: &str, load: &Identified, note: &str) -> Result<String> {
    let rounded = |value: f64| (value * 1e5).round() / 1e5;
    let mut mass = toml_edit::Value::from(rounded(load.mass_kg));
    mass.decor_mut().set_suffix(format!(" # {note}"));
    let values = |values: &[f64]| toml_edit::Value::from_iter(values.iter().map(|value| rounded(*value)));
    configuration::entered(
        text,
        &["robot", "load"],
        [("mass_kg", mass), ("com_m", values(&load.com_m)), ("inertia_com", values(&[0.0; 6]))],
    )
}

/// Leads the arm through the sweeps. Returns the name of the arm, the load that it counts with, and what was measured.
fn measure(common: &Arguments) -> Result<(String, Belief, Measured)> {
    let ended = interrupted()?;
    let operator = Operator::connect(common)?;
    let robot = settled(operator.connection())?.0;
    ensure!(robot.has_arm(), "this robot has no arm");
    let before = news(operator.connection(), |_| true)?;
    let was_armed = before.samples.last().is_some_and(|sample| sample.mode.moves());
    if !was_armed {
        operator.ask(Request::Arm)?;
    }
    let measured = news(operator.connection(), |sample| sample.mode.moves())
        .and_then(|update| update.samples.last().cloned().context("the daemon sends nothing new"))
        .and_then(|first| sweep(&operator, &robot, &first, &ended));
    let left = match &measured {
        // Whoever is gone, or stopped, has ended it already.
        Err(error) if error.is::<Stopped>() => Ok(()),
        _ => operator.ask(if was_armed { Request::EndTarget } else { Request::Disarm }),
    };
    operator.connection().release();
    let measured = measured?;
    left?;
    Ok((robot.arm_name.clone(), believed(&robot), measured))
}

/// Load that the running controller counts with.
fn believed(robot: &RobotDescription) -> Belief {
    let com_m = robot.numbers("robot.load.com_m").and_then(|com_m| com_m.try_into().ok());
    Belief { mass_kg: robot.number("robot.load.mass_kg").unwrap_or(0.0), com_m: com_m.unwrap_or([0.0; 3]) }
}

fn sweep(
    operator: &Operator,
    robot: &RobotDescription,
    first: &Sample,
    ended: &AtomicBool,
) -> Result<Measured> {
    let mut sweeps = Sweeps::from(first)?;
    let (mut bar, mut sent) = (Progress::new("postures"), None::<Instant>);
    let mut posture_rad = sweeps.step(first)?;
    while let Some(q_rad) = &posture_rad {
        ensure!(!ended.load(Ordering::Relaxed), "interrupted: nothing is measured");
        if sent.is_none_or(|sent| sent.elapsed() >= SEND_EVERY) {
            let q_rad = ParameterValues::new(q_rad).context("more joints than any arm has")?;
            let target =
                TimedTarget { stamp_unix_ns: unix_now_ns(), ..TimedTarget::new(Target::Posture(q_rad)) };
            operator.connection().request(Request::Target(target));
            sent = Some(Instant::now());
        }
        let update = operator.stay()?;
        for reply in &update.replies {
            // A busy machine sends two at once, and the newer one counts.
            let overtaken = Err(Refusal::Target(TargetRefusal::Overtaken));
            if matches!(reply.request, Request::Target(_)) && reply.outcome != overtaken {
                reply.outcome.map_err(|refusal| Refused(reply.request.refused(refusal).to_string()))?;
            }
        }
        operator.leave_if_stopped(&update)?;
        for sample in &update.samples {
            undisturbed(sample)?;
            posture_rad = sweeps.step(sample)?;
        }
        bar.at(sweeps.share());
        std::thread::sleep(LOOK_EVERY);
    }
    bar.end();
    let origin = robot.numbers("robot.tool.origin").and_then(|origin| origin.try_into().ok());
    sweeps.measured(&origin.unwrap_or([0.0; 6]))
}

/// # Errors
/// [`Refused`]: somebody touches the robot, or it is in a law in which it gives way to a load.
fn undisturbed(sample: &Sample) -> Result<()> {
    if let Some((taxel, touched)) = (1..).zip(&sample.taxels).find(|(_, taxel)| taxel.force_n > 0.0) {
        bail!(Refused(format!("T{taxel} feels {:.1} N: nobody may touch the robot", touched.force_n)));
    }
    if sample.mode != Mode::Impedance {
        bail!(Refused(format!("not possible in mode {}: `mocad law impedance`", sample.mode.name())));
    }
    if sample.target.is_some_and(|target| target.phase == TargetPhase::EndedByTouch) {
        bail!(Refused(TargetPhase::EndedByTouch.name().into()));
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::Config;

    #[test]
    fn load_is_entered_beside_what_the_file_says() {
        let load =
            Identified { mass_kg: 1.234_567_8, com_m: [0.01, -0.02, 0.033_333_3], residual: [0.5, 0.02] };
        let text = "# ours\n[robot.load]\nmass_kg = 3.0\ninertia_com = [1e-3, 0.0, 0.0, 1e-3, 0.0, 1e-3]\n[board]\nport = \"simulated\"\n";
        let new = entered(text, &load, "measured today").unwrap();
        assert!(new.starts_with("# ours\n[robot.load]\nmass_kg = 1.23457 # measured today\n"), "{new}");
        assert!(new.ends_with("[board]\nport = \"simulated\"\n"), "{new}");
        for text in [new, entered("", &load, "measured today").unwrap()] {
            let read = Config::parse(&text).unwrap().robot.load;
            assert_eq!(
                (read.mass_kg, read.com_m, read.inertia_com),
                (1.234_57, [0.01, -0.02, 0.033_33], [0.0; 6])
            );
        }
        assert!(entered("[robot]\nload = 3", &load, "").is_err());
    }

    #[test]
    fn only_an_untouched_robot_in_impedance_is_measured() {
        let mut sample = Sample { mode: Mode::Impedance, ..Sample::default() };
        undisturbed(&sample).unwrap();
        sample.taxels.push(Default::default()).unwrap();
        undisturbed(&sample).unwrap();
        sample.taxels[0].force_n = 3.0;
        assert_eq!(
            undisturbed(&sample).unwrap_err().to_string(),
            "refused: T1 feels 3.0 N: nobody may touch the robot"
        );
        let follows = Sample { mode: Mode::FollowMe, ..Sample::default() };
        assert!(undisturbed(&follows).unwrap_err().to_string().contains("mocad law impedance"));
    }
}
