//! `mocad tare | arm | disarm | stop | resume | recentre | law | status | watch | target | payload | gripper`: a running robot without a
//! screen.
#![expect(clippy::print_stdout, reason = "this module is what the user sees on the terminal")]

use crate::cli::gripper;
use crate::cli::operator::{Arguments, Operator, Stopped, interrupted};
use crate::cli::payload;
use crate::cli::remote::{LOOK_EVERY, news, settled};
use crate::cli::report::Report;
use crate::cli::status::Status;
use crate::cli::target::{self, TargetArguments};
use crate::cli::word;
use anyhow::{Result, bail};
use clap::{Args, Subcommand};
use moca_msgs::{Law, Mode, Request, Sample, TaxelStatus};
use moca_telemetry::net::{Commander, Link, Update};
use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::time::{Duration, Instant};

/// Request of an operator to a running daemon.
#[derive(Subcommand)]
pub enum Command {
    /// Measure the cover's zero, and wait until it is known. Nobody may touch the robot.
    Tare(Arguments),
    /// Hand the robot to its law, and hold the command until Ctrl-C, which disarms. If this program dies, the robot stops.
    Arm(ArmArguments),
    /// Take the robot back from its law: it holds still.
    Disarm(Arguments),
    /// Protective stop. Taken from anybody, whoever holds the command.
    Stop(Arguments),
    /// Leave the protective stop, once its cause is gone and the cover has a valid zero.
    Resume(Arguments),
    /// Drive the base slowly back under the arm, after somebody pushed it away. A touch ends it.
    Recentre(Arguments),
    /// Choose the law that arming starts; an armed robot changes to it.
    Law(LawArguments),
    /// Say what the robot is doing.
    Status(Arguments),
    /// A line a second and one at every change, until Ctrl-C.
    Watch(Arguments),
    /// Lead flange, arm or base to a target, and hold the command meanwhile.
    Target(TargetArguments),
    /// Measure what the flange carries.
    #[command(subcommand)]
    Payload(payload::Command),
    /// Move the gripper's fingers, grasp and let go, in any mode.
    #[command(subcommand, after_help = gripper::EXIT_CODES)]
    Gripper(gripper::Command),
}

/// Options of arming.
#[derive(Args)]
pub struct ArmArguments {
    /// Choose this law first.
    #[arg(long, value_parser = word::<Law>())]
    law: Option<Law>,
    /// Disarm by itself after so many seconds.
    #[arg(long, value_name = "SECONDS", value_parser = seconds)]
    duration: Option<Duration>,
    #[command(flatten)]
    common: Arguments,
}

/// Which law.
#[derive(Args)]
pub struct LawArguments {
    /// The flange keeps its place while the base gives way (impedance), or base and arm follow the hand (follow-me).
    #[arg(value_parser = word::<Law>())]
    law: Law,
    #[command(flatten)]
    common: Arguments,
}

fn seconds(text: &str) -> Result<Duration, String> {
    let allowed = || "allowed: 0.1 to 86400 s".to_owned();
    let seconds = text.parse().ok().filter(|seconds| (0.1..=86_400.0).contains(seconds));
    seconds.map(Duration::from_secs_f64).ok_or_else(allowed)
}

/// Carries out one command.
///
/// # Errors
/// No daemon or no answer; refused, with the reason; stopped, if the robot stopped meanwhile.
pub fn run(command: &Command) -> Result<()> {
    match command {
        Command::Tare(arguments) => tare(&Operator::connect(arguments)?),
        Command::Arm(arguments) => arm(arguments),
        Command::Disarm(arguments) => Operator::connect(arguments)?.once(Request::Disarm),
        Command::Stop(arguments) => Operator::stop(arguments),
        Command::Resume(arguments) => Operator::connect(arguments)?.once(Request::Resume),
        Command::Recentre(arguments) => recentre(arguments),
        Command::Law(LawArguments { law, common }) => {
            Operator::connect(common)?.once(Request::SelectLaw(*law))
        }
        Command::Status(arguments) => {
            let operator = Operator::look_on(arguments)?;
            operator.print(&settled(operator.connection())?.1);
            Ok(())
        }
        Command::Watch(arguments) => watch(&Operator::look_on(arguments)?),
        Command::Target(arguments) => target::run(arguments),
        Command::Payload(command) => payload::run(command),
        Command::Gripper(command) => gripper::run(command),
    }
}

/// Time after its answer in which a tare shows in samples, however late they come.
const TARE_SEEN: Duration = Duration::from_millis(300);

fn tare(operator: &Operator) -> Result<()> {
    let before = news(operator.connection(), |_| true)?;
    operator.ask(Request::Tare)?;
    // A robot without a cover tares within a tick, which may have come with the answer.
    let answered = Instant::now();
    news(operator.connection(), |sample| sample.mode == Mode::Taring || answered.elapsed() > TARE_SEEN)?;
    let update = news(operator.connection(), |sample| sample.mode != Mode::Taring)?;
    // Nothing moves: whoever comes next may have the command.
    operator.connection().release();
    operator.print(&update);
    match (before.samples.last(), update.samples.last()) {
        (Some(before), Some(after)) if tared(before, after) => Ok(()),
        (_, Some(after)) => Err(Stopped::because(after).into()),
        (_, None) => bail!("the daemon sends nothing new"),
    }
}

/// A tare ends where it began, or in a mode that has a zero.
fn tared(before: &Sample, after: &Sample) -> bool {
    let zero = after.taxels.iter().all(|taxel| taxel.status != TaxelStatus::NoZero);
    match after.mode {
        Mode::Ready | Mode::Impedance | Mode::FollowMe => true,
        Mode::ProtectiveStop => before.mode == Mode::ProtectiveStop && before.fault == after.fault && zero,
        Mode::Starting | Mode::Taring | Mode::Fault => false,
    }
}

/// Drives the base back and stays until it is there: a robot that moves has somebody who watches over it.
fn recentre(arguments: &Arguments) -> Result<()> {
    let ended = interrupted()?;
    let operator = Operator::connect(arguments)?;
    operator.ask(Request::Recentre)?;
    let goes = |sample: &Sample| sample.posture.is_some_and(|posture| posture.recentring);
    let mut update = news(operator.connection(), goes).or_else(|_| news(operator.connection(), |_| true))?;
    while update.samples.last().is_none_or(goes) && !ended.load(Ordering::Relaxed) {
        std::thread::sleep(LOOK_EVERY);
        update = operator.stay()?;
        operator.leave_if_stopped(&update)?;
    }
    let answer = operator.ask(Request::EndTarget);
    let update = news(operator.connection(), |_| true)?;
    operator.connection().release();
    answer?;
    operator.print(&update);
    Ok(())
}

/// Arms and stays: a robot that moves has somebody who watches over it.
fn arm(arguments: &ArmArguments) -> Result<()> {
    let ended = interrupted()?;
    let operator = Operator::connect(&arguments.common)?;
    if let Some(law) = arguments.law {
        operator.ask(Request::SelectLaw(law))?;
    }
    // A law may have been chosen, and who has commanded and is gone would stop a robot that moves already.
    operator.ask(Request::Arm).inspect_err(|_| operator.connection().release())?;
    if !operator.json() {
        println!("armed; this program holds the command, and the robot stops if it dies. Ctrl-C disarms.");
    }
    let until = arguments.duration.map(|duration| Instant::now() + duration);
    let mut lines = Lines::new(&operator);
    let mut armed = false;
    while !ended.load(Ordering::Relaxed) && until.is_none_or(|until| Instant::now() < until) {
        let update = operator.stay()?;
        lines.print(&update);
        operator.leave_if_stopped(&update)?;
        armed |= update.samples.iter().any(|sample| sample.mode.moves());
        if armed && update.status.commander != Commander::You {
            return Err(Stopped::new("this program was silent for too long and has lost the command").into());
        }
        std::thread::sleep(LOOK_EVERY);
    }
    operator.once(Request::Disarm)
}

fn watch(operator: &Operator) -> Result<()> {
    let mut lines = Lines::new(operator);
    loop {
        let update = operator.connection().poll();
        if let Link::Down { reason } = &update.link {
            bail!("the daemon hung up: {reason}");
        }
        lines.print(&update);
        std::thread::sleep(LOOK_EVERY);
    }
}

/// Output while samples come: as on the daemon's own terminal, or the status as JSON at the same times.
struct Lines<'a> {
    operator: &'a Operator,
    report: Report,
}

impl<'a> Lines<'a> {
    fn new(operator: &'a Operator) -> Self {
        Self { operator, report: Report::of(Arc::clone(operator.robot())) }
    }

    fn print(&mut self, update: &Update) {
        for sample in &update.samples {
            let lines = self.report.lines(sample);
            if self.operator.json() && !lines.is_empty() {
                println!("{}", Status::new(self.operator.robot(), sample, update.status.commander).json());
            } else {
                lines.iter().for_each(|line| println!("{line}"));
            }
        }
        update.notices.iter().filter(|_| !self.operator.json()).for_each(|notice| println!("{notice}"));
    }
}
