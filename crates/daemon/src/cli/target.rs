//! `mocad target pose | twist | posture | base | trajectory`: leads flange, arm or base of a running robot.

use crate::cli::operator::{Arguments, Operator, Stopped, interrupted};
use crate::cli::remote::{LOOK_EVERY, Refused, news};
use crate::cli::word;
use anyhow::{Context, Result, bail, ensure};
use clap::{Args, Subcommand};
use moca_msgs::target::TargetPhase;
use moca_msgs::{
    ParameterValues, Request, Sample, Target, TargetState, TimedTarget, TouchPolicy, TwistAxes, Waypoint,
};
use moca_telemetry::net::wire::unix_now_ns;
use moca_telemetry::net::{Reply, Update};
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

/// Period at which a target is sent again: it would be too old after four of these.
const SEND_EVERY: Duration = Duration::from_millis(50);
/// A daemon that has not answered by then is given up.
const ANSWER_WITHIN: Duration = Duration::from_secs(3);

/// Target and its options.
#[derive(Args)]
pub struct TargetArguments {
    #[command(subcommand)]
    target: TargetCommand,
}

#[derive(Subcommand)]
enum TargetCommand {
    /// Lead the flange to a pose in the world, and wait until the reference is there.
    Pose {
        /// m.
        #[arg(value_names = ["X", "Y", "Z"], num_args = 3, required = true, allow_negative_numbers = true)]
        position: Vec<f64>,
        /// Unit quaternion; without it the flange keeps its orientation.
        #[arg(long, value_names = ["QX", "QY", "QZ", "QW"], num_args = 4, allow_negative_numbers = true)]
        quaternion: Option<Vec<f64>>,
        #[command(flatten)]
        how: How,
    },
    /// Move the flange with a twist.
    Twist {
        /// m/s and rad/s.
        #[arg(value_names = ["VX", "VY", "VZ", "WX", "WY", "WZ"], num_args = 6, required = true,
              allow_negative_numbers = true)]
        twist: Vec<f64>,
        /// In whose axes.
        #[arg(long, value_parser = word::<TwistAxes>(), default_value = "world")]
        axes: TwistAxes,
        /// For so long, s.
        #[arg(long, default_value_t = 1.0)]
        duration: f64,
        #[command(flatten)]
        how: How,
    },
    /// Lead the arm to a posture, and wait until the reference is there.
    Posture {
        /// Joint angles, rad, the first joint first.
        #[arg(value_name = "Q", num_args = 1..=8, required = true, allow_negative_numbers = true)]
        q: Vec<f64>,
        #[command(flatten)]
        how: How,
    },
    /// Drive the base, in follow-me or where there is no arm.
    Base {
        /// Forward, left, yaw: m/s, m/s, rad/s.
        #[arg(value_names = ["VX", "VY", "WZ"], num_args = 3, required = true, allow_negative_numbers = true)]
        velocity: Vec<f64>,
        /// For so long, s.
        #[arg(long, default_value_t = 1.0)]
        duration: f64,
        #[command(flatten)]
        how: How,
    },
    /// Lead the flange along poses and times, and wait until the reference is at the last one.
    Trajectory {
        /// Lines of `time,x,y,z,qx,qy,qz,qw` in s, m and a unit quaternion; lines that begin with # are none.
        file: PathBuf,
        #[command(flatten)]
        how: How,
    },
}

#[derive(Args)]
struct How {
    /// Effect of a touch on the target: it ends (wins), or is set aside until nobody touches (pass-through).
    #[arg(long, value_parser = word::<TouchPolicy>(), default_value = "wins")]
    touch: TouchPolicy,
    /// Arm first, and disarm in the end.
    #[arg(long)]
    arm: bool,
    /// Give up what has not been reached after so long, of a trajectory so long after its own time, s.
    #[arg(long, default_value_t = 60.0)]
    timeout: f64,
    #[command(flatten)]
    common: Arguments,
}

/// Request to the loop.
enum Wanted {
    /// Again and again, until it is reached or so long.
    Target(Target, Option<Duration>),
    Trajectory(Vec<Waypoint>),
}

impl Wanted {
    /// Returns the duration for which it is asked for, if not until it is reached.
    fn duration(&self) -> Option<Duration> {
        match self {
            Self::Target(_, duration) => *duration,
            Self::Trajectory(_) => None,
        }
    }

    /// Returns the duration of the target itself.
    fn own_time(&self) -> Duration {
        match self {
            Self::Target(_, duration) => duration.unwrap_or_default(),
            Self::Trajectory(waypoints) => {
                Duration::from_secs_f64(waypoints.last().map_or(0.0, |last| last.time_s.clamp(0.0, 1e6)))
            }
        }
    }
}

/// Leads, and waits for the end.
///
/// # Errors
/// As for the other commands; [`Stopped`] if the robot stopped, [`Refused`] if the target was, or a touch ended it.
pub fn run(arguments: &TargetArguments) -> Result<()> {
    let ended = interrupted()?;
    let how = arguments.target.how();
    let operator = Operator::connect(&how.common)?;
    let wanted = arguments.target.wanted(&operator)?;
    if how.arm {
        operator.ask(Request::Arm)?;
        news(operator.connection(), |sample| sample.mode.moves())?;
    }
    let timeout = seconds("--timeout", how.timeout)?;
    let led = lead(&operator, &wanted, how.touch, timeout, &ended);
    let last = if how.arm { Request::Disarm } else { Request::EndTarget };
    let ended = match led {
        // Whoever is gone, or stopped, has ended it already.
        Err(error) if error.is::<Stopped>() => return Err(error),
        _ => operator.ask(last),
    };
    operator.connection().release();
    let update = led?;
    ended?;
    operator.print(&update);
    Ok(())
}

impl TargetCommand {
    fn how(&self) -> &How {
        match self {
            Self::Pose { how, .. }
            | Self::Twist { how, .. }
            | Self::Posture { how, .. }
            | Self::Base { how, .. }
            | Self::Trajectory { how, .. } => how,
        }
    }

    fn wanted(&self, operator: &Operator) -> Result<Wanted> {
        Ok(match self {
            Self::Pose { position, quaternion, .. } => {
                let quaternion_world = match quaternion {
                    Some(quaternion) => exactly(quaternion)?,
                    None => present(operator)?.flange_quaternion_world,
                };
                Wanted::Target(Target::Pose { position_world: exactly(position)?, quaternion_world }, None)
            }
            Self::Twist { twist, axes, duration, .. } => Wanted::Target(
                Target::Twist { axes: *axes, twist: exactly(twist)? },
                Some(seconds("--duration", *duration)?),
            ),
            Self::Posture { q, .. } => {
                let q = ParameterValues::new(q).context("more joints than any arm has")?;
                Wanted::Target(Target::Posture(q), None)
            }
            Self::Base { velocity, duration, .. } => {
                let velocity_body = exactly(velocity)?;
                Wanted::Target(
                    Target::BaseVelocity { velocity_body },
                    Some(seconds("--duration", *duration)?),
                )
            }
            Self::Trajectory { file, .. } => Wanted::Trajectory(waypoints(file)?),
        })
    }
}

/// Follows a target to its end; the news it ended with.
fn lead(
    operator: &Operator,
    wanted: &Wanted,
    touch: TouchPolicy,
    timeout: Duration,
    ended: &AtomicBool,
) -> Result<Update> {
    let connection = operator.connection();
    let (begun, mut sent) = (Instant::now(), None::<Instant>);
    if let Wanted::Trajectory(waypoints) = wanted {
        connection.trajectory(touch, waypoints.clone());
    }
    let mut accepted = false;
    loop {
        if let Wanted::Target(target, _) = wanted
            && sent.is_none_or(|sent| sent.elapsed() >= SEND_EVERY)
        {
            let target = TimedTarget { stamp_unix_ns: unix_now_ns(), touch, ..TimedTarget::new(*target) };
            connection.request(Request::Target(target));
            sent = Some(Instant::now());
        }
        let update = operator.stay()?;
        for reply in answers(&update) {
            match reply.outcome {
                Ok(()) => accepted = true,
                Err(refusal) => return Err(Refused(reply.request.refused(refusal).to_string()).into()),
            }
        }
        operator.leave_if_stopped(&update)?;
        let state = update.samples.last().filter(|_| accepted).and_then(|sample| sample.target);
        ensure!(accepted || begun.elapsed() < ANSWER_WITHIN, "the daemon does not answer");
        let over = accepted && wanted.duration().is_some_and(|duration| begun.elapsed() >= duration);
        let most = timeout + wanted.own_time();
        if begun.elapsed() >= most {
            let how_far = state.map_or(0.0, |state| 100.0 * state.progress);
            bail!(Refused(format!(
                "not reached in {} s, {how_far:.0} % of it: --timeout",
                most.as_secs_f64()
            )));
        }
        if over || ended.load(Ordering::Relaxed) || has_ended(state)? {
            return if update.samples.is_empty() { news(connection, |_| true) } else { Ok(update) };
        }
        std::thread::sleep(LOOK_EVERY);
    }
}

fn answers(update: &Update) -> impl Iterator<Item = &Reply> {
    let replies = update.replies.iter();
    replies.filter(|reply| matches!(reply.request, Request::Target(_) | Request::Waypoint { .. }))
}

/// Returns true if the reference is there.
fn has_ended(state: Option<TargetState>) -> Result<bool> {
    match state.map(|state| state.phase) {
        Some(TargetPhase::Reached) => Ok(true),
        Some(phase @ TargetPhase::EndedByTouch) => Err(Refused(phase.name().into()).into()),
        _ => Ok(false),
    }
}

fn present(operator: &Operator) -> Result<Sample> {
    let update = news(operator.connection(), |_| true)?;
    update.samples.last().cloned().context("the daemon sends nothing new")
}

fn exactly<const N: usize>(values: &[f64]) -> Result<[f64; N]> {
    values.try_into().with_context(|| format!("{} numbers, {N} are needed", values.len()))
}

fn seconds(option: &str, seconds: f64) -> Result<Duration> {
    ensure!((0.05..=86_400.0).contains(&seconds), "{option} {seconds}: allowed: 0.05 to 86400 s");
    Ok(Duration::from_secs_f64(seconds))
}

/// The poses of a file.
fn waypoints(file: &Path) -> Result<Vec<Waypoint>> {
    let text = std::fs::read_to_string(file).with_context(|| file.display().to_string())?;
    let lines = text.lines().enumerate().map(|(i, line)| (i + 1, line.trim()));
    let mut waypoints = Vec::new();
    for (number, line) in lines.filter(|(_, line)| !line.is_empty() && !line.starts_with('#')) {
        let place = || format!("{}:{number}: allowed: time,x,y,z,qx,qy,qz,qw as numbers", file.display());
        let numbers = line.split(',').map(|number| number.trim().parse()).collect::<Result<Vec<f64>, _>>();
        let [time_s, x, y, z, qx, qy, qz, qw] = exactly(&numbers.with_context(place)?).with_context(place)?;
        waypoints.push(Waypoint { time_s, position_world: [x, y, z], quaternion_world: [qx, qy, qz, qw] });
    }
    if waypoints.is_empty() {
        bail!("{}: no poses", file.display());
    }
    Ok(waypoints)
}
