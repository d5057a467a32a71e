//! `moca-lab soak`: hours of robot time in lock-step under random hands, requests, board faults and bad clients.

mod onlookers;

use crate::robustness::cover_speed::{Inertia, Pushes};
use crate::robustness::hands::{BLOW_TICKS, BURST, Deeds, FORCES_N, Hands};
use crate::robustness::watch::{Findings, Watch};
use crate::study::Answer;
use anyhow::{Context, Result, ensure};
use moca_experiments::unattended;
use moca_figures::progress::Progress;
use moca_lockstep::LockStep;
use moca_lockstep::simulated_robot::free_scene;
use moca_msgs::Law;
use moca_sim::VirtualBoardConfig;
use moca_tactile::Firmware;
use moca_telemetry::RobotDescription;
use moca_telemetry::log::{LogReader, LogWriter, Meta, Record};
use onlookers::Onlookers;
use serde::Serialize;
use std::fs::File;
use std::io::BufWriter;
use std::path::PathBuf;
use std::time::Instant;

/// Ten minutes of robot time.
const SEGMENT_TICKS: u64 = 600_000;
/// Ticks of each segment that go into a log that is read back: the first minute.
const LOGGED_TICKS: u64 = 60_000;

/// Most by which memory in use may grow after the first minute, KiB.
const GROWTH_MAX_KIB: u64 = 4 * 1024;

/// Hours of robot time under random hands, requests and board faults: limits, modes, memory, logs.
#[derive(clap::Args)]
pub(crate) struct Arguments {
    /// Robot time, h.
    #[arg(long, default_value_t = 8.0)]
    hours: f64,
    /// Seed of everything random.
    #[arg(long, default_value_t = 1)]
    seed: u64,
    #[command(flatten)]
    answer: Answer,
}

/// Findings of a soak.
#[derive(Debug, Default, Serialize)]
struct Report {
    ticks: u64,
    wall_s: f64,
    requests: u64,
    requests_refused: u64,
    clients_killed: u64,
    samples_dropped: u64,
    lines_lost: u64,
    #[serde(flatten)]
    deeds: Deeds,
    #[serde(flatten)]
    findings: Findings,
    in_use_first_kib: u64,
    in_use_last_kib: u64,
    samples_read_back: u64,
}

pub(crate) fn run(arguments: &Arguments) -> Result<()> {
    ensure!(
        arguments.hours > 0.0 && arguments.hours <= 1000.0,
        "--hours {}: allowed: up to 1000 h",
        arguments.hours
    );
    #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "checked above")]
    let ticks = (arguments.hours * 3.6e6) as u64;
    let report = soak(ticks, SEGMENT_TICKS, arguments.seed)?;
    arguments.answer.print(&report, || Ok(text(&report)))?;
    let (first_kib, last_kib) = (report.in_use_first_kib, report.in_use_last_kib);
    ensure!(
        last_kib.saturating_sub(first_kib) <= GROWTH_MAX_KIB,
        "memory in use grew from {first_kib} to {last_kib} KiB; allowed: by {GROWTH_MAX_KIB} KiB"
    );
    let violations = report.findings.violation_count;
    ensure!(violations == 0, "{violations} violations");
    Ok(())
}

#[expect(clippy::cast_precision_loss, reason = "a share")]
fn soak(ticks: u64, segment_ticks: u64, seed: u64) -> Result<Report> {
    let mut config = unattended(Law::Impedance);
    config.simulation.seed = seed;
    // The operator arms: every change of mode is then one row of the table and one sample.
    config.startup.arm = false;
    let mut hands = Hands::new(seed);
    let mut onlookers = Onlookers::new()?;
    let mut report = Report { ticks, ..Report::default() };
    let started = Instant::now();
    let mut progress = Progress::new("soak");
    let mut watch = Watch::new(&config)?;
    let period_s = 1.0 / f64::from(config.control_loop.rate_hz);
    for (segment, begin) in (0..ticks).step_by(usize::try_from(segment_ticks)?).enumerate() {
        // Every firmware in its turn, each robot from its power-up.
        let firmware = Firmware::ALL[segment % Firmware::ALL.len()];
        let board = VirtualBoardConfig { seed, firmware, ..VirtualBoardConfig::default() };
        let mut world = LockStep::with_board(&config, &free_scene(&config), board, None)?;
        let mut log = Some(LoggedMinute::start(seed, begin)?);
        hands.begin_again();
        watch.begin_again();
        let mut inertia = Inertia::default();
        let length = segment_ticks.min(ticks - begin);
        for tick in 0..length {
            let request = hands.act(tick, &mut world, watch.last.as_ref());
            let (sample, outcome) = world.step(request);
            report.requests += u64::from(request.is_some());
            report.requests_refused += u64::from(matches!(outcome, Some(Err(_))));
            let plant = &mut world.control.plant.world;
            let inertia_world = inertia.after(plant, period_s);
            let pushes = Pushes { taxel_force_n: plant.taxel_force_mean_n(), inertia_world };
            watch.look(&sample, request, !hands.touches_nothing(), &pushes);
            onlookers.see(&sample);
            if std::mem::take(&mut hands.onlookers_change) {
                onlookers.change(&mut hands.random)?;
            }
            if let Some(minute) = &mut log {
                minute.writer.sample(&sample)?;
            }
            if tick == LOGGED_TICKS.min(length) - 1
                && let Some(minute) = log.take()
            {
                report.samples_read_back += minute.read_back(&mut watch.findings)?;
                report.in_use_last_kib = in_use_kib();
                if report.in_use_first_kib == 0 {
                    report.in_use_first_kib = report.in_use_last_kib;
                }
            }
            progress.at((begin + tick) as f64 / ticks as f64);
        }
    }
    progress.end();
    report.findings = watch.findings;
    report.deeds = hands.deeds;
    report.clients_killed = onlookers.killed;
    (report.samples_dropped, report.lines_lost) = (onlookers.dropped, onlookers.lines_lost());
    report.wall_s = started.elapsed().as_secs_f64();
    Ok(report)
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

    fn read_back(self, findings: &mut Findings) -> Result<u64> {
        let written = self.writer.finish()?.displayed;
        let mut reader = LogReader::open(&self.path)?;
        let read = reader.by_ref().filter(|record| matches!(record, Record::Sample(_))).count() as u64;
        if read != written || reader.cut().is_some() {
            findings.violation(format!("log: {read} of {written} samples came back, {:?}", reader.cut()));
        }
        std::fs::remove_file(&self.path)?;
        Ok(read)
    }
}

/// Memory that this process has allocated and not freed, KiB. Resident memory says less: an allocator keeps up to 28 MB of each
/// thread that has compressed a log, and where it falls is chance.
pub(crate) fn in_use_kib() -> u64 {
    #[expect(unsafe_code, reason = "no safe crate has it")]
    // SAFETY: mallinfo2 has no precondition and may be called from any thread.
    let memory = unsafe { nix::libc::mallinfo2() };
    (memory.uordblks + memory.hblkhd) as u64 / 1024
}

fn text(report: &Report) -> String {
    let Report { requests, requests_refused, clients_killed, samples_dropped, lines_lost, .. } = report;
    let Report { wall_s, in_use_first_kib, in_use_last_kib, samples_read_back, .. } = report;
    let Deeds { presses, board_faults, heavy_presses, blows, bursts, .. } = &report.deeds;
    let found = &report.findings;
    let hours = f64::from(u32::try_from(report.ticks / 1000).unwrap_or(u32::MAX)) / 3600.0;
    let violations: String = found.violations.iter().map(|violation| format!("  {violation}\n")).collect();
    format!(
        "{hours:.2} h of robot time in {wall_s:.0} s; {presses} presses, {requests} requests ({requests_refused} refused), \
         {board_faults} board faults\n\
         {heavy_presses} heavy presses, {blows} blows of {BLOW_TICKS} ms (up to {} N), {bursts} bursts of {BURST} requests, \
         {clients_killed} clients killed, {samples_dropped} samples not sent, {lines_lost} lines that a stalled terminal did not \
         take\n\
         stops             {:?}\n\
         ticks in mode     {:?}\n\
         largest base speed {:.3} m/s\n\
         largest share of a limit: torque {:.3}, torque rate {:.3}, base acceleration {:.3}, joint speed {:.3}\n\
         memory in use     {in_use_first_kib} KiB after the first minute, {in_use_last_kib} KiB at the end\n\
         log               {samples_read_back} samples written and read back\n\
         violations        {}\n{violations}",
        FORCES_N[2],
        found.stops,
        found.ticks_in_mode,
        found.largest_base_speed_m_s,
        found.largest_torque_used,
        found.largest_torque_rate_used,
        found.largest_base_acceleration_used,
        found.largest_joint_speed_used,
        found.violation_count
    )
}

#[cfg(test)]
mod tests {
    use moca_tactile::Firmware;

    #[test]
    fn two_minutes_of_everything_at_once_exceed_no_limit() {
        let segment = 120_000 / Firmware::ALL.len() as u64;
        let report = super::soak(120_000, segment, 3).unwrap();
        let (deeds, found) = (&report.deeds, &report.findings);
        assert!(found.violations.is_empty(), "{:#?}", found.violations);
        assert!(
            deeds.presses > 5 && !found.stops.is_empty() && report.samples_read_back >= segment / 20,
            "{report:?}"
        );
        assert!(found.ticks_in_mode["impedance"] > 5_000, "{report:?}");
        assert!(deeds.heavy_presses > 0 && deeds.blows > 0 && deeds.bursts > 0, "{report:?}");
    }
}
