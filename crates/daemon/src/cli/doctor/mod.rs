//! `mocad doctor`: what is and is not real-time on this PC, beside the bare floor of an empty loop, and what to do
//! about it.
#![expect(clippy::print_stdout, reason = "this module is what the user sees on the terminal")]

use crate::config::Config;
use crate::robot::{ArmDriver, BaseDriver, PlantKind};
use crate::runtime::clock::Clock;
use crate::runtime::realtime::{self, Step};
use crate::runtime::schedule::Schedule;
use crate::runtime::timing::Distribution;
use anyhow::{Context, Result, anyhow, ensure};
use moca_figures::progress;
use std::fs;
use std::path::PathBuf;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

#[cfg(feature = "fci")]
mod arm;
#[cfg(feature = "ros2")]
mod base;
mod board;
mod finding;
mod network;
mod stops;

use finding::{Finding, print};

/// Without --seconds.
const LOOP_S: f64 = 5.0;
/// Duration with --robot, s: the 99th percentile is then over ten thousand states.
const ROBOT_S: f64 = 10.0;

/// Parts to measure.
#[derive(Debug, clap::Args)]
pub struct Arguments {
    /// Configuration whose rate and `[realtime]` settings are tried.
    #[arg(long, value_name = "FILE")]
    config: Option<PathBuf>,
    /// Duration of each loop or of listening to each part, s: 5, and with --robot 10.
    #[arg(long, value_name = "SECONDS")]
    seconds: Option<f64>,
    /// Pairs of an empty and a real loop, one after the other.
    #[arg(long, default_value_t = 1)]
    pairs: usize,
    /// Keep every core busy meanwhile.
    #[arg(long)]
    load: bool,
    /// Listen to the Touch Board for --seconds instead, and print a report of it to send back.
    #[arg(long)]
    board: bool,
    /// Look at the real robot that the configuration names, for --seconds: arm, base and the way to them. Nothing moves.
    #[arg(long)]
    robot: bool,
    /// Then hold the arm where it is for --seconds, to see which of the orders reach it.
    #[arg(long, requires = "robot")]
    hold: bool,
    /// Then drive the base forwards at 2 cm/s and fall silent, to see when it stops by itself.
    #[arg(long, requires = "robot")]
    drive: bool,
    /// Drive the base a few centimetres forward and back for a minute and a half instead, with everybody away, and measure the
    /// distance in which it stops.
    #[arg(long, conflicts_with_all = ["board", "robot"])]
    base: bool,
    /// Then write that distance into the configuration.
    #[arg(long, requires_all = ["base", "config"])]
    write: bool,
}

/// Lateness of one loop.
struct Lateness {
    steps: Vec<Step>,
    lateness: Distribution,
    overruns: u64,
}

/// Looks at the machine, then measures.
///
/// # Errors
/// A configuration with mistakes, a duration of no length, a simulation that cannot be built.
pub fn run(arguments: &Arguments) -> Result<()> {
    let mut config = match &arguments.config {
        Some(path) => Config::load(path).map_err(|error| anyhow!("{}:\n{error}", path.display()))?,
        None => Config::default(),
    };
    config.telemetry.listen.clear();
    let seconds = arguments.seconds.unwrap_or(if arguments.robot { ROBOT_S } else { LOOP_S });
    let length = Duration::try_from_secs_f64(seconds).context("--seconds")?;
    ensure!(length >= Duration::from_millis(100), "--seconds {seconds}: allowed: 0.1 s or more");

    if arguments.base {
        let file = arguments.config.as_deref().filter(|_| arguments.write);
        return stops::run(&config, file);
    }
    if arguments.board {
        return board::run(&config, length);
    }
    print("What this PC offers", &machine());
    if arguments.robot {
        return look_at_robot(&config, length, arguments);
    }
    println!(
        "\nWhat the loop gets ({} Hz, {} s each{})",
        config.control_loop.rate_hz,
        seconds,
        if arguments.load { ", every core busy" } else { "" }
    );
    println!("  lateness, µs         p50       p99     p99.9       max   missed slots");
    let idle = AtomicBool::new(false);
    std::thread::scope(|scope| {
        if arguments.load {
            for _ in 0..std::thread::available_parallelism().map_or(1, std::num::NonZero::get) {
                scope.spawn(|| {
                    while !idle.load(Ordering::Relaxed) {
                        std::hint::spin_loop();
                    }
                });
            }
        }
        let result = measure(&config, length, arguments.pairs);
        idle.store(true, Ordering::Relaxed);
        result
    })
}

/// Every part that the configuration says is real.
fn look_at_robot(config: &Config, length: Duration, arguments: &Arguments) -> Result<()> {
    let plant = &config.plant;
    ensure!(
        plant.kind == PlantKind::Robot,
        "doctor --robot looks at a real robot: a configuration (--config) with plant.kind = \"robot\""
    );
    if plant.parts.has_arm() && plant.arm.driver == ArmDriver::Fci {
        let mut findings = look_at_arm(config, length, arguments.hold)?;
        findings.push(network::card_of(&plant.arm.host, usize::try_from(config.realtime.cpu).ok()));
        print("\nThe arm", &findings);
    }
    if plant.parts.has_cover() && plant.base.driver == BaseDriver::Ros2 {
        print("\nThe base", &look_at_base(config, length, arguments.drive)?);
    }
    Ok(())
}

#[cfg(feature = "fci")]
use arm::look as look_at_arm;
#[cfg(feature = "ros2")]
use base::look as look_at_base;

#[cfg(not(feature = "fci"))]
fn look_at_arm(_: &Config, _: Duration, _: bool) -> Result<Vec<Finding>> {
    Err(anyhow!("plant.arm.driver = \"fci\" needs a build with the feature `fci`"))
}

#[cfg(not(feature = "ros2"))]
fn look_at_base(_: &Config, _: Duration, _: bool) -> Result<Vec<Finding>> {
    Err(anyhow!("plant.base.driver = \"ros2\" needs a build with the feature `ros2`"))
}

fn measure(config: &Config, length: Duration, pairs: usize) -> Result<()> {
    let mut ratios = Vec::new();
    for pair in 0..pairs {
        let bar = progress::during("empty loop", length);
        let floor = on_a_thread_of_its_own(|| empty_loop(config, length))?;
        drop(bar);
        if pair == 0 {
            for step in floor.steps.iter().filter(|step| step.result.is_err()) {
                if let Err(error) = &step.result {
                    println!("  CARE {}: no ({error}); {}", step.what, REMEDY);
                }
            }
        }
        print_row("empty loop", &floor);
        #[cfg(feature = "sim")]
        {
            let bar = progress::during("simulated robot", length);
            let real = on_a_thread_of_its_own(|| simulated_loop(config, length))?;
            drop(bar);
            print_row("simulated robot", &real);
            ratios.push(real.lateness.quantile_us(0.999) / floor.lateness.quantile_us(0.999).max(1e-3));
        }
    }
    ratios.sort_unstable_by(f64::total_cmp);
    if let Some(median) = ratios.get(ratios.len() / 2) {
        println!(
            "\n  p99.9 of the robot's loop over the empty loop's, median of {} pairs: {median:.2}",
            ratios.len()
        );
    }
    Ok(())
}

const REMEDY: &str = "systemd/mocad.service grants it (LimitRTPRIO, LimitMEMLOCK, DeviceAllow); by hand: \
                      /etc/security/limits.d (rtprio 99, memlock unlimited) for the user's group";

fn on_a_thread_of_its_own(work: impl FnOnce() -> Result<Lateness> + Send) -> Result<Lateness> {
    std::thread::scope(|scope| scope.spawn(work).join().map_err(|_| anyhow!("the measured loop panicked"))?)
}

/// Sleeps and wakes like the real loop, and does nothing in between.
fn empty_loop(config: &Config, length: Duration) -> Result<Lateness> {
    let clock = Clock::start()?;
    let (steps, _held) = realtime::apply(&config.realtime);
    let mut schedule = Schedule::starting_after(clock.now_ns(), config.period_ns());
    let end_ns = u64::try_from(length.as_nanos()).unwrap_or(u64::MAX);
    let (mut lateness, mut overruns) = (Distribution::new()?, 0);
    while schedule.deadline_ns() < end_ns {
        let deadline_ns = schedule.deadline_ns();
        let woken_ns = clock.sleep_until(deadline_ns);
        lateness.record(Duration::from_nanos(woken_ns.saturating_sub(deadline_ns)));
        overruns += schedule.advance(clock.now_ns());
    }
    Ok(Lateness { steps, lateness, overruns })
}

#[cfg(feature = "sim")]
fn simulated_loop(config: &Config, length: Duration) -> Result<Lateness> {
    use crate::runtime::live::{self, Shared};
    use crate::runtime::tick_source::Timer;
    use crate::runtime::timing::Timing;
    let clock = Clock::start()?;
    let mut robot = crate::runtime::assemble::assemble(config, clock, None, Default::default())?;
    let (steps, _held) = realtime::apply(&config.realtime);
    let shared = Shared::default();
    let (mut rings, samples, ports) = crate::runtime::clients::rings(&shared);
    drop((samples, ports));
    let started_ns = Duration::from_nanos(clock.now_ns());
    let mut timing = Timing::new()?;
    let report = live::run(
        &mut robot.control,
        &mut Timer::new(clock, config.period_ns()),
        &mut timing,
        Some(started_ns + length),
        &mut rings,
        &shared,
    );
    Ok(Lateness { steps, lateness: timing.lateness, overruns: report.overruns })
}

fn print_row(name: &str, measured: &Lateness) {
    let at = |quantile| measured.lateness.quantile_us(quantile);
    let (p50, p99, p999, max) = (at(0.5), at(0.99), at(0.999), at(1.0));
    println!("  {name:<15} {p50:>9.0} {p99:>9.0} {p999:>9.0} {max:>9.0} {:>14}", measured.overruns);
}

/// Returns the findings about this PC.
fn machine() -> Vec<Finding> {
    let read = |path: &str| fs::read_to_string(path).map(|text| text.trim().to_owned()).ok();
    let preempt = read("/sys/kernel/realtime").as_deref() == Some("1");
    let throttle = read("/proc/sys/kernel/sched_rt_runtime_us");
    let governor = read("/sys/devices/system/cpu/cpu0/cpufreq/scaling_governor");
    let performs = governor.as_deref().is_none_or(|governor| governor == "performance");
    let isolated = read("/sys/devices/system/cpu/isolated").filter(|cores| !cores.is_empty());
    let bare = !read("/proc/cpuinfo").is_some_and(|text| text.contains("hypervisor"));
    let throttled = throttle.as_deref() != Some("-1");
    let throttle = throttle.map_or("unknown".into(), |us| format!("sched_rt_runtime_us = {us}"));
    let board = crate::devices::ports::look();
    vec![
        Finding::new("kernel", preempt, if preempt { "PREEMPT_RT" } else { "no PREEMPT_RT" })
            .or("install your distribution's real-time kernel; a stock one is late by milliseconds under load"),
        Finding::new("hardware", bare, if bare { "no hypervisor" } else { "a virtual machine" })
            .or("run the robot on bare metal: a halted virtual processor wakes late, whatever the guest does"),
        Finding::new("real-time throttling", !throttled, throttle).or(
            "harmless while a tick takes far less than its period; sysctl kernel.sched_rt_runtime_us=-1 lifts it",
        ),
        Finding::new("frequency governor", performs, governor.unwrap_or("none (fixed frequency)".into()))
            .or("cpupower frequency-set -g performance"),
        Finding::new("isolated cores", isolated.is_some(), isolated.unwrap_or("none".into()))
            .or("optional: boot with isolcpus=N nohz_full=N and set realtime.cpu = N"),
        Finding::new("Touch Board", board.is_ok(), board.unwrap_or_else(Into::into))
            .or("the simulation has a virtual one"),
    ]
}
