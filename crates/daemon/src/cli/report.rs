//! Output of a run on the terminal: one line a second, every change of mode, and the summary.

use crate::config::{AUTO_PORT, Config};
use crate::control::protection;
use crate::control::stage::Stage;
use crate::robot::{Parts, PlantKind};
use crate::runtime::clients::description;
use crate::runtime::notice::{Notice, Summary};
use moca_msgs::board::Diagnosis;
use moca_msgs::protection::ContactPhase;
use moca_msgs::{BoardFault, Fault, Law, Mode, Sample, SpeedLimitReason, seconds};
use moca_telemetry::RobotDescription;
use std::fmt;
use std::sync::Arc;

/// Importance of a line.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, clap::ValueEnum)]
pub enum Level {
    /// The robot needs a restart.
    Error,
    /// The robot stopped, or waits for something.
    Warning,
    /// Everything: changes of mode, and a line a second.
    #[default]
    Info,
}

/// One line for the terminal or the journal.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Line {
    level: Level,
    text: String,
}

impl fmt::Display for Line {
    /// Under systemd with the journal's priority before it, sd-daemon(3).
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        if std::env::var_os("JOURNAL_STREAM").is_some() {
            let priority = match self.level {
                Level::Error => 3,
                Level::Warning => 4,
                Level::Info => 6,
            };
            write!(f, "<{priority}>")?;
        }
        f.write_str(&self.text)
    }
}

/// Turns samples into lines.
#[derive(Debug, Default)]
pub struct Report {
    level: Level,
    mode: Option<Mode>,
    fault: Option<Fault>,
    board: Option<Diagnosis>,
    robot: Arc<RobotDescription>,
    /// The operating system refused the loop its priority.
    rights_missing: bool,
    /// The robot ends stops for a busy PC by itself, and has ended so many.
    recovers: bool,
    recovered: u64,
    /// The base was found later than measured.
    late: bool,
    next_status_s: f64,
    time_s: f64,
}

const STATUS_EVERY_S: f64 = 1.0;
const BOARD_SETTLED_S: f64 = 1.0;

impl Report {
    /// Shows what matters at least as much as `level`.
    pub fn new(level: Level) -> Self {
        Self { level, ..Self::default() }
    }

    /// Shows everything about this robot.
    pub(super) fn of(robot: Arc<RobotDescription>) -> Self {
        Self { robot, ..Self::default() }
    }

    /// Lines to print for this sample; usually none.
    pub fn lines(&mut self, sample: &Sample) -> Vec<Line> {
        let time_s = seconds(sample.time_ns);
        self.time_s = time_s;
        let mut lines = Vec::new();
        if self.mode.replace(sample.mode) != Some(sample.mode) || self.fault != sample.fault {
            let before = std::mem::replace(&mut self.fault, sample.fault);
            let level = match (sample.mode, sample.fault) {
                (Mode::Fault, _) => Level::Error,
                (_, Some(_)) => Level::Warning,
                (_, None) => Level::Info,
            };
            let why = why(sample.fault, |fault| self.robot.fault_text(fault));
            let more = self.about_starving(before, sample);
            let text = format!("{} mode: {}{why}{more}", at(time_s), sample.mode.name());
            lines.push(Line { level, text });
        }
        let late = sample.speed_limit.reason == SpeedLimitReason::BaseLate;
        if late && !std::mem::replace(&mut self.late, late) {
            let text = format!(
                "{} the base stops later than was measured: no faster than {:.3} m/s from now on; measure it again: `mocad doctor \
                 --base --write`",
                at(time_s),
                sample.speed_limit.m_s
            );
            lines.push(Line { level: Level::Warning, text });
        }
        // A port takes a moment to open and a board to speak: only a state that lasts is worth a line.
        let well = matches!(sample.board, Diagnosis::Frames | Diagnosis::NoBoard);
        let settled = time_s >= BOARD_SETTLED_S && !well;
        if settled && self.board.replace(sample.board) != Some(sample.board) {
            let text = format!("{} board: {}", at(time_s), self.robot.board_text(sample.board));
            lines.push(Line { level: Level::Warning, text });
        }
        if well {
            self.board = None;
        }
        let events = sample.contact_events.iter().filter(|event| event.phase != ContactPhase::Started);
        lines.extend(events.map(|event| {
            let level = if event.phase.is_warning() { Level::Warning } else { Level::Info };
            Line { level, text: format!("{} contact {event}", at(time_s)) }
        }));
        if time_s >= self.next_status_s {
            self.next_status_s = (time_s / STATUS_EVERY_S).floor() * STATUS_EVERY_S + STATUS_EVERY_S;
            lines.push(Line { level: Level::Info, text: status(sample) });
        }
        lines.retain(|line| line.level <= self.level);
        lines
    }

    /// Returns advice about a PC that was too busy, and the number of times that a simulated robot resumed.
    fn about_starving(&mut self, before: Option<Fault>, sample: &Sample) -> String {
        let starved = |fault| matches!(fault, Some(Fault::Board { fault: BoardFault::HostStarved, .. }));
        let mut text = String::new();
        if starved(sample.fault) && self.rights_missing {
            text += " This run has no real-time rights: `mocad doctor` says how to get them.";
        }
        if starved(sample.fault) && self.recovers {
            text += " A simulated robot resumes by itself.";
        }
        if starved(before) && sample.mode == Mode::Ready && self.recovers {
            self.recovered += 1;
            text += &format!(" (this PC was too busy; resumed, {} so far)", times(self.recovered));
        }
        text
    }
}

/// `once`, `2 times`.
fn times(count: u64) -> String {
    if count == 1 { "once".into() } else { format!("{count} times") }
}

/// Loop time as every line begins with it.
fn at(time_s: f64) -> String {
    format!("[{time_s:7.2} s]")
}

/// Returns the lines of one notice for a terminal; usually none.
pub fn lines_of(report: &mut Report, notice: Notice<'_>) -> Vec<String> {
    let under = |title: &str, text: String| vec![format!("  {title:<11} {text}")];
    match notice {
        Notice::Begins { config, lock_step } => {
            report.robot = Arc::new(description(config));
            report.recovers = config.plant.kind == PlantKind::Simulated && config.board.port.are_simulated();
            introduction(config, lock_step)
        }
        Notice::NoRobot => under("plant", "none: the cover alone, nothing moves".into()),
        Notice::Simulated { config, mujoco } => simulated(config, mujoco),
        Notice::Board { port: None, .. } => under("board", "virtual Touch Board in memory".into()),
        Notice::Board { port: Some(port), simulated } => {
            let port = if port == AUTO_PORT { "the only Touch Board on USB" } else { port };
            under("board", format!("{port}{}", if simulated { " (virtual Touch Board)" } else { "" }))
        }
        Notice::Telemetry(address) => {
            under("telemetry", format!("{address} (dashboard: cargo run --release --bin moca-monitor)"))
        }
        Notice::Recording(path) => under("record", path.display().to_string()),
        Notice::RealTime(step) => match &step.result {
            Ok(()) => under("real time", format!("{}: yes", step.what)),
            Err(error) => {
                report.rights_missing |= step.is_priority;
                under("real time", format!("{}: no ({error})", step.what))
            }
        },
        Notice::Runs => vec!["Ctrl-C stops it.".into()],
        Notice::Sample(sample) => report.lines(sample).iter().map(ToString::to_string).collect(),
        Notice::Parameter(change) => {
            vec![format!("[tick {}] parameter {} = {:?}", change.tick, change.name, change.values)]
        }
        Notice::FaultLog(path) => vec![format!("  the seconds before it: {}", path.display())],
        Notice::Trouble(words) => vec![Line { level: Level::Warning, text: words.into() }.to_string()],
        Notice::Driver(words) => {
            let text = format!("{} {words}", at(report.time_s));
            vec![Line { level: Level::Warning, text }.to_string()]
        }
        Notice::Recorded(summary) => {
            let mut lines = vec![format!(
                "recorded {} samples and {} bytes of the board",
                summary.samples, summary.serial_bytes
            )];
            if summary.dropped > 0 {
                let lost = summary.dropped;
                lines.push(format!(
                    "  {lost} ticks or reads of the board found no room on their way to the disk"
                ));
            }
            lines
        }
        Notice::Ended(summary) => vec![summary.to_string()],
    }
}

fn introduction(config: &Config, lock_step: bool) -> Vec<String> {
    let law = match (config.plant.parts, config.startup.law) {
        (Parts::Base, _) => "admittance of the base alone (the base gives way)",
        (Parts::Arm, _) => "Cartesian impedance of the arm alone (the flange keeps its place)",
        (Parts::Whole, Law::Impedance) => {
            "expanded Cartesian impedance (the flange keeps its place, the base gives way)"
        }
        (Parts::Whole, Law::FollowMe) => "expanded follow-me (base and arm follow the hand)",
    };
    let pace = if lock_step { "in lock-step, as fast as possible" } else { "live" };
    let mut lines = vec![
        format!("mocad {}: robot {:?}", crate::VERSION, config.robot.name),
        format!("  controller  {law}, {} Hz, {pace}", config.control_loop.rate_hz),
    ];
    if config.plant.parts.has_cover() {
        lines.push(format!("  protection  {}", protection::introduction(config)));
    }
    lines.extend(config.uncalibrated().map(|uncalibrated| format!("  cover       {uncalibrated}")));
    lines
}

fn simulated(config: &Config, mujoco: &str) -> Vec<String> {
    let (arm, base) = (&config.robot.arm.name, &config.robot.base_name);
    let robot = match config.plant.parts {
        Parts::Whole => format!("{arm} on {base}"),
        Parts::Base => format!("{base} without an arm"),
        Parts::Arm => format!("{arm} on a stand, no cover"),
    };
    let mut lines =
        vec![format!("  plant       simulated {robot} (MuJoCo {mujoco}): nothing moves but the simulation")];
    let hand = &config.simulation.hand;
    if config.plant.parts.has_cover() && !hand.taxels.is_empty() {
        let taxels: Vec<String> = hand.taxels.iter().map(|taxel| format!("T{taxel}")).collect();
        lines.push(format!(
            "  hand        a scripted hand presses {} with {} N, every {} s (--no-hand: nobody does)",
            taxels.join(", "),
            hand.force_n,
            hand.every_s
        ));
    }
    lines
}

/// The cause of a stop, with its code.
fn why(fault: Option<Fault>, text: impl Fn(Fault) -> String) -> String {
    fault.map_or_else(String::new, |fault| format!(" ({}) {}", fault.code(), text(fault)))
}

/// `impedance`, `protective stop (host-starved)`
fn mode(sample: &Sample) -> String {
    let fault = sample.fault.map_or_else(String::new, |fault| format!(" ({})", fault.code()));
    format!("{}{fault}", sample.mode.name())
}

/// Mode and fault first, then only of the parts that there are: an arm alone has no base and no board, a base alone no flange.
fn status(sample: &Sample) -> String {
    let mut parts = vec![mode(sample)];
    if sample.board != Diagnosis::NoBoard {
        parts.push(format!("base {}", pose(&sample.base_pose_world)));
        parts.push(format!("limit {}", sample.speed_limit));
    }
    if !sample.q_rad.is_empty() {
        parts.push(format!("flange off by {:.1} mm", 1e3 * sample.flange_error_m()));
    }
    if sample.board != Diagnosis::NoBoard {
        parts.push(format!("cover: {}", pressed(sample)));
        parts.push(match sample.frame_age_s {
            age_s if age_s < 0.0 => "board: no frame yet".to_owned(),
            age_s => format!("board: {:.1} Hz, {:.0} ms old", sample.frame_rate_hz, 1e3 * age_s),
        });
    }
    parts.push(format!("late {:.2} ms", 1e3 * sample.lateness_s));
    format!("{} {}", at(seconds(sample.time_ns)), parts.join(" | "))
}

fn pressed(sample: &Sample) -> String {
    let pressed: Vec<String> = sample
        .taxels
        .iter()
        .enumerate()
        .filter(|(_, taxel)| taxel.force_n > 0.0)
        .map(|(i, taxel)| format!("T{} {:.1} N", i + 1, taxel.force_n))
        .collect();
    if pressed.is_empty() { "untouched".to_owned() } else { pressed.join(", ") }
}

/// `x …, y …, yaw …` of a base pose, without a minus sign before zero.
pub(super) fn pose(base_pose_world: &[f64; 3]) -> String {
    let rounded = |value: f64, digits: f64| (value * digits).round() / digits + 0.0;
    let [x, y, yaw] = base_pose_world;
    let (x, y, yaw) = (rounded(*x, 1e3), rounded(*y, 1e3), rounded(yaw.to_degrees(), 1e1));
    format!("x {x:+.3} m, y {y:+.3} m, yaw {yaw:+.1}°")
}

impl fmt::Display for Summary<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let last = self.last;
        writeln!(f, "summary")?;
        writeln!(f, "  mode         {}{}", last.mode.name(), why(last.fault, |fault| fault.to_string()))?;
        writeln!(
            f,
            "  ticks        {} in {:.2} s of robot time, {:.2} times real time",
            self.ticks,
            seconds(last.time_ns),
            seconds(last.time_ns) / self.wall.as_secs_f64().max(1e-9)
        )?;
        if last.board != Diagnosis::NoBoard {
            writeln!(f, "  base         {}", pose(&last.base_pose_world))?;
            writeln!(f, "  speed limit  {}", last.speed_limit)?;
            writeln!(
                f,
                "  board        {} good frames, {} bad, {:.1} Hz; age p50 {:.1} ms, p99 {:.1} ms",
                last.frames_good,
                last.frames_bad,
                last.frame_rate_hz,
                1e-3 * self.timing.frame_age.quantile_us(0.5),
                1e-3 * self.timing.frame_age.quantile_us(0.99),
            )?;
        }
        write!(f, "{}", self.timing)?;
        if let Some(by_stage) = self.overruns_by_stage {
            write!(f, "  overruns     {} slots skipped", by_stage.iter().sum::<u64>())?;
            for (stage, count) in Stage::ALL.iter().zip(by_stage).filter(|(_, count)| *count > 0) {
                write!(f, ", {count} after a long {}", stage.name())?;
            }
            writeln!(f)?;
        }
        if self.recoveries > 0 {
            let times = times(self.recoveries);
            writeln!(f, "  this PC      was too busy {times}; the simulated robot resumed by itself")?;
        }
        match self.allocations {
            Some(count) => writeln!(f, "  allocations  {count} on the loop thread after warm-up")?,
            None => writeln!(f, "  allocations  not measured: the run ended before warm-up was over")?,
        }
        writeln!(f, "  clients      {} samples dropped", self.samples_dropped)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::runtime::realtime::Step;

    fn lines(report: &mut Report, time_s: u64, mode: Mode, fault: Option<Fault>) -> String {
        let sample = Sample { time_ns: time_s * 1_000_000_000, mode, fault, ..Sample::default() };
        lines_of(report, Notice::Sample(&sample)).join("\n")
    }

    #[test]
    fn every_line_of_a_second_says_mode_and_fault() {
        let mut report = Report::new(Level::Info);
        let modes = [
            (Mode::Impedance, None, "] impedance | "),
            (
                Mode::ProtectiveStop,
                Some(BoardFault::HostStarved.of(0)),
                "] protective stop (host-starved) | ",
            ),
            (Mode::Fault, Some(Fault::PlantLost), "] fault (plant-lost) | "),
        ];
        for (time_s, (mode, fault, expected)) in (0..).zip(modes) {
            lines(&mut report, 2 * time_s, mode, fault);
            let second = lines(&mut report, 2 * time_s + 1, mode, fault);
            assert!(second.contains(expected), "{second}");
        }
    }

    #[test]
    fn advice_about_rights_is_given_where_they_are_missing() {
        for (result, missing) in [(Ok(()), false), (Err(std::io::ErrorKind::PermissionDenied.into()), true)] {
            let mut report = Report::new(Level::Info);
            let step = Step { what: "SCHED_FIFO 40".into(), result, is_priority: true };
            lines_of(&mut report, Notice::RealTime(&step));
            let text = lines(&mut report, 0, Mode::ProtectiveStop, Some(BoardFault::HostStarved.of(0)));
            assert_eq!(text.contains("no real-time rights"), missing, "{text}");
        }
    }

    #[test]
    fn a_simulated_robot_that_resumed_says_how_often() {
        let mut report = Report::new(Level::Info);
        lines_of(&mut report, Notice::Begins { config: &Config::default(), lock_step: false });
        for expected in ["resumed, once so far", "resumed, 2 times so far"] {
            let stop = lines(&mut report, 1, Mode::ProtectiveStop, Some(BoardFault::HostStarved.of(0)));
            assert!(stop.contains("resumes by itself"), "{stop}");
            let ready = lines(&mut report, 1, Mode::Ready, None);
            assert!(ready.contains(expected), "{ready}");
        }
    }
}
