//! `moca-lab soak`: hours of robot time in lock-step under random hands, requests, board faults and bad clients.
#![expect(clippy::print_stdout, reason = "this is what the command is for")]

mod onlookers;

use crate::rig::{JOINTS, TAXELS};
use anyhow::{Context, Result, ensure};
use moca_daemon::cli::progress::Progress;
use moca_daemon::config::{Config, HandConfig};
use moca_daemon::control::supervisor::EDGES;
use moca_daemon::devices::simulated_robot::free_scene;
use moca_daemon::devices::touch_board::ByteCover;
use moca_daemon::inject::Random;
use moca_daemon::runtime::lockstep::{LockStep, MemoryBoards};
use moca_msgs::robot::resized;
use moca_msgs::{Law, Mode, Request, Sample};
use moca_sim::VirtualBoardConfig;
use moca_sim::board::BoardFault;
use moca_telemetry::RobotDescription;
use moca_telemetry::log::{LogReader, LogWriter, Meta, Record};
use onlookers::Onlookers;
use serde::Serialize;
use std::collections::BTreeMap;
use std::fs::File;
use std::io::BufWriter;
use std::path::PathBuf;
use std::time::Instant;

/// Ten minutes of robot time.
const SEGMENT_TICKS: u64 = 600_000;
/// Of each segment the first minute goes into a log that is read back.
const LOGGED_TICKS: u64 = 60_000;
/// Longest list of violations that is worth reading.
const VIOLATIONS_MAX: usize = 10;
/// Requests of one burst, one a tick: more than any queue on their way holds.
const BURST: u32 = 150;
/// Largest force of an ordinary press, of a heavy one and of a blow, N.
const FORCES_N: [u32; 3] = [80, 200, 200];
/// How long a blow lasts, ticks.
const BLOW_TICKS: u64 = 50;

/// Hours of robot time under random hands, requests and board faults: limits, modes, memory, logs.
#[derive(clap::Args)]
pub(crate) struct Arguments {
    /// Robot time, h.
    #[arg(long, default_value_t = 8.0)]
    hours: f64,
    /// Seed of everything random.
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// Print JSON.
    #[arg(long)]
    json: bool,
}

/// What a soak found.
#[derive(Debug, Default, Serialize)]
struct Report {
    ticks: u64,
    wall_s: f64,
    presses: u64,
    requests: u64,
    requests_refused: u64,
    board_faults: u64,
    heavy_presses: u64,
    blows: u64,
    bursts: u64,
    clients_killed: u64,
    samples_dropped: u64,
    lines_lost: u64,
    stops: BTreeMap<&'static str, u64>,
    ticks_in_mode: BTreeMap<&'static str, u64>,
    largest_base_speed_m_s: f64,
    largest_base_acceleration_used: f64,
    largest_torque_used: f64,
    largest_torque_rate_used: f64,
    resident_first_kib: u64,
    resident_last_kib: u64,
    samples_read_back: u64,
    violations: Vec<String>,
}

pub(crate) fn run(arguments: &Arguments) -> Result<()> {
    ensure!(
        arguments.hours > 0.0 && arguments.hours <= 1000.0,
        "--hours {}: allowed: up to 1000 h",
        arguments.hours
    );
    #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "checked above")]
    let ticks = (arguments.hours * 3.6e6) as u64;
    let report = soak(ticks, arguments.seed)?;
    if arguments.json {
        println!("{}", serde_json::to_string_pretty(&report)?);
    } else {
        print(&report);
    }
    ensure!(report.violations.is_empty(), "{} violations", report.violations.len());
    Ok(())
}

#[expect(clippy::cast_precision_loss, reason = "a share")]
fn soak(ticks: u64, seed: u64) -> Result<Report> {
    let mut config = Config::default();
    config.simulation.hand = HandConfig::none();
    config.simulation.seed = seed;
    // The operator arms: every change of mode is then one row of the table and one sample.
    config.startup.arm = false;
    let board = VirtualBoardConfig { seed, ..VirtualBoardConfig::default() };
    let mut world = LockStep::with_board(&config, &free_scene(&config), board, None)?;
    let mut hands = Hands::new(seed);
    let mut watch = Watch::new(&config);
    let mut onlookers = Onlookers::new()?;
    let mut log = None;
    let mut report = Report::default();
    let started = Instant::now();
    let mut progress = Progress::new("soak");
    for tick in 0..ticks {
        if tick % SEGMENT_TICKS == 0 {
            log = Some(LoggedMinute::start(seed, tick)?);
        }
        let request = hands.act(tick, &mut world, &watch, &mut report);
        let (sample, outcome) = world.step(request);
        report.requests += u64::from(request.is_some());
        report.requests_refused += u64::from(matches!(outcome, Some(Err(_))));
        watch.look(&sample, &mut report);
        onlookers.see(&sample);
        if std::mem::take(&mut hands.onlookers_change) {
            onlookers.change(&mut hands.random)?;
        }
        if let Some(minute) = &mut log {
            minute.writer.sample(&sample)?;
        }
        if tick % SEGMENT_TICKS == LOGGED_TICKS.min(ticks) - 1
            && let Some(minute) = log.take()
        {
            report.samples_read_back += minute.read_back(&mut report.violations)?;
            report.resident_last_kib = resident_kib()?;
            if report.resident_first_kib == 0 {
                report.resident_first_kib = report.resident_last_kib;
            }
        }
        progress.at(tick as f64 / ticks as f64);
    }
    progress.end();
    report.ticks = ticks;
    report.clients_killed = onlookers.killed;
    (report.samples_dropped, report.lines_lost) = (onlookers.dropped, onlookers.lines_lost());
    report.wall_s = started.elapsed().as_secs_f64();
    Ok(report)
}

/// Whoever touches, asks and breaks things.
struct Hands {
    random: Random,
    next_event: u64,
    pressed: [Option<u64>; TAXELS],
    heal_at: Option<u64>,
    unplugged: bool,
    stopped_since: Option<u64>,
    asked_at: u64,
    burst: u32,
    onlookers_change: bool,
}

impl Hands {
    fn new(seed: u64) -> Self {
        let random = Random::new(seed);
        Self {
            random,
            next_event: 3000,
            pressed: [None; TAXELS],
            heal_at: None,
            unplugged: false,
            stopped_since: None,
            asked_at: 0,
            burst: 0,
            onlookers_change: false,
        }
    }

    fn after(&mut self, tick: u64, least: u64, most: u64) -> u64 {
        tick + least + self.random.bits() % (most - least)
    }

    fn act(
        &mut self,
        tick: u64,
        world: &mut LockStep<ByteCover, MemoryBoards>,
        watch: &Watch,
        report: &mut Report,
    ) -> Option<Request> {
        if self.heal_at.is_some_and(|at| tick >= at) {
            self.heal_at = None;
            world.feed[0].board().set_fault(None);
            if std::mem::take(&mut self.unplugged) {
                world.feed[0].replug();
            }
        }
        if let Some(taxel) = self.pressed.iter().position(|until| until.is_some_and(|until| tick >= until)) {
            self.pressed[taxel] = None;
            return Some(press(taxel, 0.0));
        }
        if let Some(left) = self.burst.checked_sub(1) {
            self.burst = left;
            return Some(self.hasty());
        }
        if tick >= self.next_event {
            self.next_event = self.after(tick, 200, 6000);
            return self.event(tick, world, report);
        }
        self.recover(tick, watch)
    }

    fn event(
        &mut self,
        tick: u64,
        world: &mut LockStep<ByteCover, MemoryBoards>,
        report: &mut Report,
    ) -> Option<Request> {
        match self.random.below(24) {
            0 => Some(Request::Stop),
            1 => Some(Request::Disarm),
            2 => Some(Request::Tare),
            3 => Some(Request::SelectLaw(Law::FollowMe)),
            4 | 5 => Some(Request::SelectLaw(Law::Impedance)),
            6 if self.heal_at.is_none() => {
                let faults = [BoardFault::I2cLost, BoardFault::ChipReset, BoardFault::Silent];
                world.feed[0].board().set_fault(Some(faults[self.random.below(faults.len())]));
                self.heal_at = Some(self.after(tick, 100, 3000));
                report.board_faults += 1;
                None
            }
            7 if self.heal_at.is_none() => {
                world.feed[0].unplug();
                self.unplugged = true;
                self.heal_at = Some(self.after(tick, 500, 3000));
                report.board_faults += 1;
                None
            }
            8 => {
                let mut garbage = [0; 64];
                garbage.fill_with(|| self.random.byte());
                world.feed[0].inject(&garbage);
                None
            }
            9 => {
                self.burst = BURST;
                report.bursts += 1;
                None
            }
            10 | 11 => {
                self.onlookers_change = true;
                None
            }
            kind => {
                let kind = if kind < 22 { 0 } else { kind - 21 };
                Some(self.press(kind, tick, report))
            }
        }
    }

    /// An ordinary press (0), a heavy one (1), or a blow (2).
    fn press(&mut self, kind: usize, tick: u64, report: &mut Report) -> Request {
        let taxel = self.random.below(TAXELS);
        let tenths = self.random.below(usize::try_from(10 * FORCES_N[kind]).unwrap_or(0));
        let force_n = f64::from(u32::try_from(tenths).unwrap_or(0)) / 10.0;
        self.pressed[taxel] = Some(if kind == 2 { tick + BLOW_TICKS } else { self.after(tick, 100, 4000) });
        *[&mut report.presses, &mut report.heavy_presses, &mut report.blows][kind] += 1;
        press(taxel, force_n)
    }

    /// What a script that has gone wild asks.
    fn hasty(&mut self) -> Request {
        match self.random.below(8) {
            0 => Request::Stop,
            1 => Request::Tare,
            2 => Request::Arm,
            3 => Request::Disarm,
            4 => Request::Resume,
            5 => Request::SelectLaw(Law::FollowMe),
            6 => Request::OperatorLost,
            _ => Request::SelectLaw(Law::Impedance),
        }
    }

    /// An operator who brings a stopped robot back once nobody touches it.
    fn recover(&mut self, tick: u64, watch: &Watch) -> Option<Request> {
        let Some(last) = &watch.last else { return None };
        if last.mode.moves() || matches!(last.mode, Mode::Starting | Mode::Taring) {
            self.stopped_since = None;
            return None;
        }
        let since = *self.stopped_since.get_or_insert(tick);
        let calm = self.pressed.iter().all(Option::is_none) && self.heal_at.is_none();
        if !calm || tick - since < 1500 || tick - self.asked_at < 1500 {
            return None;
        }
        self.asked_at = tick;
        match last.mode {
            Mode::Ready => Some(Request::Arm),
            // Every other try is a tare: a zero may have been lost.
            Mode::ProtectiveStop if self.random.one_in(2) => Some(Request::Tare),
            Mode::ProtectiveStop => Some(Request::Resume),
            _ => None,
        }
    }
}

fn press(taxel: usize, force_n: f64) -> Request {
    Request::PressTaxel { taxel: u8::try_from(taxel).unwrap_or(u8::MAX), force_n }
}

/// Whoever checks every tick.
struct Watch {
    last: Option<Sample>,
    torque_nm: [f64; JOINTS],
    torque_step_nm: f64,
    base_velocity: [f64; 3],
    base_step: [f64; 3],
}

impl Watch {
    fn new(config: &Config) -> Self {
        let limits = config.parameters().limits;
        let period_s = 1.0 / f64::from(config.control_loop.rate_hz);
        Self {
            last: None,
            torque_nm: resized(&limits.torque_nm),
            torque_step_nm: limits.torque_rate_nm_s * period_s,
            base_velocity: limits.base_velocity,
            base_step: limits.base_acceleration.map(|a| a * period_s),
        }
    }

    fn look(&mut self, sample: &Sample, report: &mut Report) {
        *report.ticks_in_mode.entry(sample.mode.name()).or_default() += 1;
        let [vx, vy, _] = sample.base_velocity_world;
        report.largest_base_speed_m_s = report.largest_base_speed_m_s.max(vx.hypot(vy));
        let mut wrong = Vec::new();
        let velocity = sample.base_velocity_command_body;
        for (velocity, limit) in velocity.iter().zip(self.base_velocity) {
            wrong
                .extend((velocity.abs() > limit).then(|| format!("base velocity {velocity} beyond {limit}")));
        }
        let mut share = 0.0_f64;
        for (torque, limit) in sample.arm_torque_nm.iter().zip(self.torque_nm) {
            share = share.max(torque.abs() / limit);
        }
        report.largest_torque_used = report.largest_torque_used.max(share);
        wrong.extend((share.is_nan() || share > 1.0).then(|| format!("torque at {share} of its limit")));
        if let Some(last) = &self.last {
            if last.mode != sample.mode {
                if !EDGES.contains(&(last.mode, sample.mode)) {
                    wrong.push(format!(
                        "from {:?} to {:?}, which no row of the table allows",
                        last.mode, sample.mode
                    ));
                }
                if let (Mode::ProtectiveStop | Mode::Fault, Some(fault)) = (sample.mode, sample.fault) {
                    *report.stops.entry(fault.code()).or_default() += 1;
                }
                wrong.extend((sample.mode == Mode::Fault).then(|| format!("fault {:?}", sample.fault)));
            }
            let ticks = f64::from(u32::try_from(sample.tick - last.tick).unwrap_or(u32::MAX));
            for (i, commanded) in velocity.iter().enumerate() {
                let used =
                    (commanded - last.base_velocity_command_body[i]).abs() / (self.base_step[i] * ticks);
                report.largest_base_acceleration_used = report.largest_base_acceleration_used.max(used);
                wrong
                    .extend((used > 1.0 + 1e-9).then(|| format!("base acceleration at {used} of its limit")));
            }
            for (now, before) in sample.arm_torque_nm.iter().zip(&last.arm_torque_nm) {
                let used = (now - before).abs() / (self.torque_step_nm * ticks);
                report.largest_torque_rate_used = report.largest_torque_rate_used.max(used);
                wrong.extend((used > 1.0 + 1e-9).then(|| format!("torque rate at {used} of its limit")));
            }
        }
        for text in wrong {
            if report.violations.len() < VIOLATIONS_MAX {
                report.violations.push(format!("tick {}: {text}", sample.tick));
            }
        }
        self.last = Some(sample.clone());
    }
}

/// A minute of log, written and read back.
struct LoggedMinute {
    path: PathBuf,
    writer: LogWriter<BufWriter<File>>,
}

impl LoggedMinute {
    fn start(seed: u64, tick: u64) -> Result<Self> {
        let name = format!("moca-soak-{}-{seed}-{tick}.mcap", std::process::id());
        let path = std::env::temp_dir().join(name);
        let file = File::create_new(&path).with_context(|| path.display().to_string())?;
        let meta = Meta { description: RobotDescription::paper("soak", true), start_unix_ns: 0 };
        Ok(Self { path, writer: LogWriter::new(BufWriter::new(file), &meta)? })
    }

    fn read_back(self, violations: &mut Vec<String>) -> Result<u64> {
        let written = self.writer.finish()?.displayed;
        let mut reader = LogReader::open(&self.path)?;
        let read = reader.by_ref().filter(|record| matches!(record, Record::Sample(_))).count() as u64;
        if read != written || reader.cut().is_some() {
            violations.push(format!("log: {read} of {written} samples came back, {:?}", reader.cut()));
        }
        std::fs::remove_file(&self.path)?;
        Ok(read)
    }
}

/// Memory of this process, KiB.
fn resident_kib() -> Result<u64> {
    let status = std::fs::read_to_string("/proc/self/status")?;
    let line =
        status.lines().find_map(|line| line.strip_prefix("VmRSS:")).context("VmRSS in /proc/self/status")?;
    Ok(line.split_whitespace().next().unwrap_or_default().parse()?)
}

fn print(report: &Report) {
    let seconds = report.ticks / 1000;
    println!(
        "{:.2} h of robot time in {:.0} s; {} presses, {} requests ({} refused), {} board faults",
        f64::from(u32::try_from(seconds).unwrap_or(u32::MAX)) / 3600.0,
        report.wall_s,
        report.presses,
        report.requests,
        report.requests_refused,
        report.board_faults
    );
    println!(
        "{} heavy presses, {} blows of {BLOW_TICKS} ms (up to {} N), {} bursts of {BURST} requests, {} clients killed, {} samples \
         not sent, {} lines that a stalled terminal did not take",
        report.heavy_presses,
        report.blows,
        FORCES_N[2],
        report.bursts,
        report.clients_killed,
        report.samples_dropped,
        report.lines_lost
    );
    println!("stops             {:?}", report.stops);
    println!("ticks in mode     {:?}", report.ticks_in_mode);
    println!("largest base speed {:.3} m/s", report.largest_base_speed_m_s);
    println!(
        "largest share of a limit: torque {:.3}, torque rate {:.3}, base acceleration {:.3}",
        report.largest_torque_used, report.largest_torque_rate_used, report.largest_base_acceleration_used
    );
    println!(
        "memory            {} KiB after the first minute, {} KiB at the end",
        report.resident_first_kib, report.resident_last_kib
    );
    println!("log               {} samples written and read back", report.samples_read_back);
    println!("violations        {}", report.violations.len());
    for violation in &report.violations {
        println!("  {violation}");
    }
}

#[cfg(test)]
mod tests {
    #[test]
    fn two_minutes_of_everything_at_once_exceed_no_limit() {
        let report = super::soak(120_000, 3).unwrap();
        assert!(report.violations.is_empty(), "{:#?}", report.violations);
        assert!(
            report.presses > 5
                && !report.stops.is_empty()
                && report.samples_read_back >= super::LOGGED_TICKS / 20,
            "{report:?}"
        );
        assert!(report.ticks_in_mode["impedance"] > 5_000, "{report:?}");
        assert!(report.heavy_presses > 0 && report.blows > 0 && report.bursts > 0, "{report:?}");
    }
}
