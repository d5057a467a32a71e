//! `moca-lab latency`: from touch to force, stage by stage, for each firmware of the board; how old a reading gets, how
//! fast the base may go with it, and whether such a cover is stable in contact with this controller.

use crate::picture::Width;
use crate::study::{self, Answer, Column};
use anyhow::Context as _;
use moca_control::config::Config;
use moca_experiments::TAXELS;
use moca_experiments::parallel::Count;
use moca_msgs::ImpedanceGains;
use moca_msgs::robot::{BaseTable, PAPER_COVER};
use moca_sim::board::{VirtualBoard, VirtualBoardConfig};
use moca_sim::foam::Foam;
use moca_tactile::Firmware;
use moca_tactile::board::STOCK_CHIP_AGE_MEAN_NS;
use moca_tactile::{Cover, CoverConfig, TareStatus};
use moca_wbc::contact_stability::{Contact, at_taxel, largest_speed, least_damping, margin, reading_delay_s};
use serde::{Deserialize, Serialize};
use std::path::{Path, PathBuf};
use std::process::Command;
use std::time::Instant;

/// Loop period, ns.
const TICK_NS: u64 = 1_000_000;
/// Stiffness of the body that is touched, N/m (ISO/TS 15066, a leg).
const TISSUE_N_M: f64 = 50_000.0;
/// Contact force that must not be exceeded, N.
const FORCE_LIMIT_N: f64 = 25.0;
/// The push of the measured chain, N.
const PUSH_N: f64 = 50.0;
/// Steps of the push against the board's phase.
const PHASES: u64 = 40;
/// USB is polled each millisecond.
const USB_MEAN_MS: f64 = 0.5;
/// Force that four counts of PU LD30 hide, N: protection.threshold_force_n.
const UNFELT_N: f64 = 5.2;
/// A still cover is watched for so long.
const HOLD_TICKS: u64 = 60_000;

/// From touch to force, stage by stage; whether the contact is stable and how fast the base may go.
#[derive(clap::Args)]
pub(crate) struct Arguments {
    #[command(flatten)]
    answer: Answer,
    /// Configuration whose protection.assessed_forces_n are printed; without it mocad's defaults.
    #[arg(long)]
    config: Option<PathBuf>,
    /// The program `firmware-sim` (crates/firmware-sim): measures the firmware itself, instruction by instruction, again;
    /// without it, what it measured last is shown.
    #[arg(long)]
    avr: Option<PathBuf>,
    /// Instead: speeds by physics, by the law and as simulated, as FOLDER/data/safe-speed.csv and as FOLDER/safe-speed-BOARD.svg.
    #[arg(long, value_name = "FOLDER")]
    map: Option<PathBuf>,
    /// Width of the figure of `--map`.
    #[arg(long, value_enum, default_value_t)]
    width: Width,
    /// Firmware image that `firmware-sim` runs.
    #[arg(long, default_value = "firmware/moca_touch/moca_touch.hex")]
    hex: PathBuf,
}

#[derive(Debug, Serialize)]
struct Report {
    boards: Vec<Board>,
    firmwares: Vec<Latency>,
    contacts: Vec<ContactReport>,
}

/// Ages of a board's readings, and the speeds that they allow.
#[derive(Debug, Serialize, Deserialize)]
struct Board {
    board: String,
    rate_hz: f64,
    /// Age of the data when a frame comes: the earliest time at which it can have been sampled counts.
    age_mean_ms: f64,
    age_worst_ms: f64,
    /// Age that a reading reaches before the next one comes.
    hold_worst_ms: f64,
    /// The delay T that limits the speed: one tick less.
    #[serde(default)]
    delay_ms: f64,
    /// Speed of the base at each assessed force.
    #[serde(default)]
    speeds: Vec<Speed>,
}

#[derive(Debug, Serialize, Deserialize)]
struct Speed {
    force_n: f64,
    m_s: f64,
}

/// Mean delay of each stage, ms, and the whole chain measured.
#[derive(Debug, Serialize)]
struct Latency {
    firmware: &'static str,
    /// Share of a step's reading after 0.1 s, relative to 10 s later: the foam creeps, it does not wait.
    foam_share_after_100_ms: f64,
    chip_filter_ms: f64,
    wait_for_read_ms: f64,
    read_and_print_ms: f64,
    usb_ms: f64,
    parse_us: f64,
    loop_ms: f64,
    sum_ms: f64,
    /// Step of 50 N on the virtual board until half of the force is read, mean over phases.
    measured_half_ms: f64,
    measured_half_worst_ms: f64,
    /// Until anything is felt.
    measured_first_ms: f64,
    period_ms: f64,
}

/// A cover in contact with this controller.
#[derive(Debug, Serialize)]
struct ContactReport {
    reading: String,
    foam: &'static str,
    /// Foam and tissue in series at 25 N, N/m.
    stiffness_n_m: f64,
    /// Total delay T of the contact stability law, s.
    delay_s: f64,
    /// Taxels (T1 = 1) whose contact is stable at the paper's gains.
    stable_taxels: Vec<usize>,
    /// Virtual damping at T6 (a pure translation) with which it would be, N·s/m.
    damping_needed: f64,
    /// Virtual damping there is, N·s/m.
    damping: f64,
    /// Largest approach at which a contact stays under 25 N, m/s.
    largest_speed_m_s: f64,
}

/// Measures, computes, prints.
pub(crate) fn run(arguments: &Arguments) -> anyhow::Result<()> {
    let config = match &arguments.config {
        Some(path) => Config::load(path)?,
        None => Config::default(),
    };
    let (forces_n, base) = (&config.protection.assessed_forces_n, &config.robot.base);
    if let Some(folder) = &arguments.map {
        return super::map::run(forces_n, folder, arguments.width);
    }
    let firmware = match &arguments.avr {
        Some(program) => simulated_firmware(program, &arguments.hex)?,
        None => measured_before()?,
    };
    let report = report(all_boards(firmware, forces_n, base)?, base)?;
    arguments.answer.print(&report, || Ok(as_text(&report, forces_n, base)))
}

/// Boards that can be bought or flashed.
const BOARDS: [Firmware; 3] = [Firmware::Stock2018, Firmware::Stock2015, Firmware::Moca];

fn report(boards: Vec<Board>, base: &BaseTable) -> anyhow::Result<Report> {
    let mut count = Count::new("latency", BOARDS.len());
    let one = |firmware| {
        let latency = latency(firmware);
        count.one_more();
        latency
    };
    let firmwares = BOARDS.into_iter().map(one).collect::<anyhow::Result<_>>()?;
    let mut contacts = Vec::new();
    for foam in [Foam::PU_LD30, Foam::COLLISION_ASSUMED] {
        contacts.push(contact("ideal, 10 ms".to_owned(), &foam, reading_delay_s(0.0, 0.010, 1e-3), base)?);
        for board in &boards {
            contacts.push(contact(board.board.clone(), &foam, 1e-3 * board.delay_ms, base)?);
        }
    }
    Ok(Report { boards, firmwares, contacts })
}

/// The virtual boards and the firmware's simulation, with what each allows.
fn all_boards(firmware: Vec<Board>, forces_n: &[f64], base: &BaseTable) -> anyhow::Result<Vec<Board>> {
    let mut boards = BOARDS.into_iter().map(held).collect::<anyhow::Result<Vec<_>>>()?;
    boards.extend(firmware);
    for board in &mut boards {
        board.delay_ms = board.hold_worst_ms - milliseconds(TICK_NS);
        board.speeds = speeds(forces_n, 1e-3 * board.delay_ms, base)?;
    }
    Ok(boards)
}

/// Output of `firmware-sim latency --json` for the checked-in firmware; `.ci/firmware` compares it with a new run.
fn measured_before() -> anyhow::Result<Vec<Board>> {
    const PRINTED: &str = include_str!("../../../../firmware/moca_touch/latency.json");
    serde_json::from_str(PRINTED).context("firmware/moca_touch/latency.json")
}

/// The first table as a document shows it.
pub(crate) fn markdown() -> anyhow::Result<String> {
    let config = Config::default();
    let (forces_n, base) = (&config.protection.assessed_forces_n, &config.robot.base);
    let mut boards = all_boards(measured_before()?, forces_n, base)?;
    // What the chip's own times say is for the firmware's page; a loop knows only what it reads.
    boards.retain(|board| !board.board.ends_with("exact"));
    Ok(table(&boards, forces_n))
}

fn table(boards: &[Board], forces_n: &[f64]) -> String {
    let forces: String = forces_n.iter().map(|force_n| format!(" at {force_n} N |")).collect();
    let mut out =
        format!("| board | rate Hz | age on arrival, mean / worst ms | oldest ms | T ms |{forces}\n");
    out += &format!("|---|---|---|---|---|{}\n", "---|".repeat(forces_n.len()));
    for Board { board, rate_hz, age_mean_ms, age_worst_ms, hold_worst_ms, delay_ms, speeds } in boards {
        let speeds: String = speeds.iter().map(|speed| format!(" {:.3} m/s |", speed.m_s)).collect();
        out += &format!(
            "| {board} | {rate_hz:.1} | {age_mean_ms:.1} / {age_worst_ms:.1} | {hold_worst_ms:.1} | {delay_ms:.1} |{speeds}\n"
        );
    }
    out
}

/// Ages of a still cover's readings on the virtual board.
fn held(firmware: Firmware) -> anyhow::Result<Board> {
    let mut board = VirtualBoard::new(VirtualBoardConfig { firmware, ..Default::default() })?;
    let mut cover = Cover::<TAXELS>::new(CoverConfig::default())?;
    let (mut last, mut early, mut ages_ms, mut hold_worst_ms) = (None, None, Vec::new(), 0.0f64);
    for tick in 1..=HOLD_TICKS {
        let now_ns = tick * TICK_NS;
        board.advance(now_ns, &[0.0; TAXELS], &mut |line| cover.push(0, line, now_ns));
        let poll = cover.poll(now_ns);
        if poll.reading.sampled_at_ns != last {
            last = poll.reading.sampled_at_ns;
            ages_ms.extend(last.map(|sampled_ns| milliseconds(now_ns.saturating_sub(sampled_ns))));
        }
        if poll.early.sampled_at_ns != early {
            if let Some(sampled_ns) = early {
                hold_worst_ms = hold_worst_ms.max(milliseconds(now_ns.saturating_sub(sampled_ns)));
            }
            early = poll.early.sampled_at_ns;
        }
    }
    let rate_hz = cover.boards().next().map_or(0.0, moca_tactile::board::BoardMonitor::rate_hz);
    Ok(Board {
        board: firmware.name().to_owned(),
        rate_hz,
        age_mean_ms: mean(&ages_ms),
        age_worst_ms: ages_ms.iter().copied().fold(0.0, f64::max),
        hold_worst_ms,
        delay_ms: 0.0,
        speeds: Vec::new(),
    })
}

/// Measures the firmware itself by a separate program: its simulator is GPL-3 and must not be linked here.
fn simulated_firmware(program: &Path, hex: &Path) -> anyhow::Result<Vec<Board>> {
    let output = Command::new(program)
        .args(["latency", "--json", "--hex"])
        .arg(hex)
        .output()
        .with_context(|| format!("run {}", program.display()))?;
    anyhow::ensure!(
        output.status.success(),
        "{}: {}",
        program.display(),
        String::from_utf8_lossy(&output.stderr)
    );
    serde_json::from_slice(&output.stdout).with_context(|| format!("what {} printed", program.display()))
}

/// Largest speed at which an impact of each force is not exceeded, for the default foam before a leg.
fn speeds(forces_n: &[f64], delay_s: f64, base: &BaseTable) -> anyhow::Result<Vec<Speed>> {
    let at = |force_n: f64| -> anyhow::Result<f64> {
        let (contact, travel_m) = stiffness(&Foam::PU_LD30, force_n, delay_s, base);
        let felt_n = force_n - UNFELT_N;
        Ok(largest_speed(felt_n, travel_m, base.acceleration_max_m_s2, &contact)?)
    };
    forces_n
        .iter()
        .map(|&force_n| {
            // The stiffness counts at the force itself, and foam stiffens: a speed that keeps a smaller force keeps this.
            let mut m_s = at(force_n)?;
            let mut smaller_n = 10.0;
            while smaller_n < force_n {
                m_s = m_s.max(at(smaller_n)?);
                smaller_n += 5.0;
            }
            Ok(Speed { force_n, m_s })
        })
        .collect()
}

/// Foam and tissue in series at a force, and how far they yield between the force that is not felt and this one.
fn stiffness(foam: &Foam, force_n: f64, delay_s: f64, base: &BaseTable) -> (Contact, f64) {
    let foam_n_m = foam.stiffness_n_per_m(foam.deformation_m(force_n));
    let contact = Contact {
        stiffness_n_m: foam_n_m * TISSUE_N_M / (foam_n_m + TISSUE_N_M),
        damping_n_s_m: 0.0,
        delay_s,
        servo_s: base.servo_time_constant_s,
    };
    let foam_m = foam.deformation_m(force_n) - foam.deformation_m(UNFELT_N);
    (contact, foam_m + (force_n - UNFELT_N) / TISSUE_N_M)
}

/// Mean age of FDAT when the board reads it, ns.
const fn chip_age_mean_ns(firmware: Firmware) -> u64 {
    match firmware {
        // 1.5 of the window and half of the millisecond between two reads
        Firmware::Moca => 2_000_000,
        Firmware::Stock2015 | Firmware::Stock2018 | Firmware::PiCap => STOCK_CHIP_AGE_MEAN_NS,
    }
}

fn latency(firmware: Firmware) -> anyhow::Result<Latency> {
    let period_ms = milliseconds(firmware.frame_period_ns());
    let print_ms = milliseconds(firmware.line_offset_ns()[5]);
    let chip_filter_ms = milliseconds(chip_age_mean_ns(firmware));
    let mut first = Vec::new();
    let mut half = Vec::new();
    let mut parse_us = Vec::new();
    let mut foam_share = 0.0;
    for phase in 0..PHASES {
        let step = Step::measure(firmware, phase)?;
        first.push(step.first_ms);
        half.push(step.half_ms);
        parse_us.push(step.parse_us);
        foam_share = step.share_after_100_ms;
    }
    let parse_us = parse_us.into_iter().fold(f64::INFINITY, f64::min);
    let (usb_ms, loop_ms) = (USB_MEAN_MS, 0.5 * milliseconds(TICK_NS));
    Ok(Latency {
        firmware: firmware.name(),
        foam_share_after_100_ms: foam_share,
        chip_filter_ms,
        wait_for_read_ms: period_ms / 2.0,
        read_and_print_ms: print_ms,
        usb_ms,
        parse_us,
        loop_ms,
        sum_ms: chip_filter_ms + period_ms / 2.0 + print_ms + usb_ms + 1e-3 * parse_us + loop_ms,
        measured_half_ms: mean(&half),
        measured_half_worst_ms: half.iter().copied().fold(0.0, f64::max),
        measured_first_ms: mean(&first),
        period_ms,
    })
}

/// One push, from a still cover, through bytes.
struct Step {
    first_ms: f64,
    half_ms: f64,
    share_after_100_ms: f64,
    parse_us: f64,
}

impl Step {
    fn measure(firmware: Firmware, phase: u64) -> anyhow::Result<Self> {
        let mut board =
            VirtualBoard::new(VirtualBoardConfig { firmware, seed: phase + 1, ..Default::default() })?;
        let mut cover = Cover::<TAXELS>::new(CoverConfig::default())?;
        // spread over one frame and one refresh of the chip, which are not commensurable
        let step_ns = 3_000_000_000 + phase * 1_700_000;
        let (mut now_ns, mut parse_ns, mut frames) = (0, 0, 0u32);
        let mut forces = Vec::new();
        cover.start_tare(0);
        while now_ns < step_ns + 10_000_000_000 {
            let mut force_n = [0.0; TAXELS];
            // the push falls between two ticks: the board's time runs on its own
            if now_ns >= step_ns {
                force_n[5] = PUSH_N;
            }
            now_ns += TICK_NS;
            let start = Instant::now();
            let mut lines = 0;
            board.advance(now_ns, &force_n, &mut |line| {
                cover.push(0, line, now_ns);
                lines += 1;
            });
            if lines > 0 {
                parse_ns += start.elapsed().as_nanos();
                frames += lines;
            }
            let poll = cover.poll(now_ns);
            if now_ns > step_ns {
                let force_n = poll.forces.map_or(0.0, |forces| forces[5]);
                forces.push((milliseconds(now_ns - step_ns), force_n));
            }
        }
        anyhow::ensure!(matches!(cover.tare_status(), TareStatus::Done(_)), "{:?}", cover.tare_status());
        let after = |from_ms: f64, to_ms: f64| {
            mean(&forces.iter().filter(|f| (from_ms..to_ms).contains(&f.0)).map(|f| f.1).collect::<Vec<_>>())
        };
        let lines_a_frame = if firmware == Firmware::Moca { 1.0 } else { 6.0 };
        let settled_n = after(100.0, 250.0);
        let reached = |level_n: f64| forces.iter().find(|f| f.1 > level_n).map_or(f64::NAN, |f| f.0);
        #[expect(clippy::cast_precision_loss, reason = "seconds in ns")]
        let parse_us = parse_ns as f64 * 1e-3 / f64::from(frames) * lines_a_frame;
        Ok(Self {
            first_ms: reached(0.0),
            half_ms: reached(0.5 * settled_n),
            share_after_100_ms: settled_n / after(9_500.0, 10_000.0),
            parse_us,
        })
    }
}

fn contact(reading: String, foam: &Foam, delay_s: f64, base: &BaseTable) -> anyhow::Result<ContactReport> {
    let gains = ImpedanceGains::PAPER;
    let deformation_m = foam.deformation_m(FORCE_LIMIT_N);
    let foam_n_m = foam.stiffness_n_per_m(deformation_m);
    let contact = Contact {
        damping_n_s_m: foam.damping_time_s * foam_n_m,
        ..stiffness(foam, FORCE_LIMIT_N, delay_s, base).0
    };
    let mut stable_taxels = Vec::new();
    for (i, taxel) in PAPER_COVER.iter().enumerate() {
        let mass = at_taxel(&gains.virtual_mass, taxel);
        let damping = at_taxel(&gains.virtual_damping, taxel);
        if margin(mass, damping, &contact)?.stable {
            stable_taxels.push(i + 1);
        }
    }
    let travel_m = deformation_m + FORCE_LIMIT_N / TISSUE_N_M;
    let front = &PAPER_COVER[5];
    Ok(ContactReport {
        reading,
        foam: foam.name,
        stiffness_n_m: contact.stiffness_n_m,
        delay_s: contact.delay_s,
        stable_taxels,
        damping_needed: least_damping(at_taxel(&gains.virtual_mass, front), &contact)?,
        damping: at_taxel(&gains.virtual_damping, front),
        largest_speed_m_s: largest_speed(FORCE_LIMIT_N, travel_m, base.acceleration_max_m_s2, &contact)?,
    })
}

fn milliseconds(nanoseconds: u64) -> f64 {
    #[expect(clippy::cast_precision_loss, reason = "seconds in ns")]
    let nanoseconds = nanoseconds as f64;
    nanoseconds * 1e-6
}

fn mean(values: &[f64]) -> f64 {
    #[expect(clippy::cast_precision_loss, reason = "small counts")]
    let count = values.len().max(1) as f64;
    values.iter().sum::<f64>() / count
}

const FIRMWARES: &[Column<Latency>] = &[
    ("firmware", |l| l.firmware.into()),
    ("chip filter", |l| format!("{:.1}", l.chip_filter_ms)),
    ("wait", |l| format!("{:.2}", l.wait_for_read_ms)),
    ("I2C + print", |l| format!("{:.1}", l.read_and_print_ms)),
    ("USB", |l| format!("{:.1}", l.usb_ms)),
    ("parse, µs", |l| format!("{:.1}", l.parse_us)),
    ("loop", |l| format!("{:.1}", l.loop_ms)),
    ("sum", |l| format!("{:.1}", l.sum_ms)),
    ("measured to half", |l| format!("{:.1}", l.measured_half_ms)),
    ("worst", |l| format!("{:.1}", l.measured_half_worst_ms)),
    ("first felt", |l| format!("{:.1}", l.measured_first_ms)),
];

const CONTACTS: &[Column<ContactReport>] = &[
    ("reading", |c| c.reading.clone()),
    ("foam", |c| c.foam.into()),
    ("k, N/m", |c| format!("{:.0}", c.stiffness_n_m)),
    ("T, ms", |c| format!("{:.1}", 1e3 * c.delay_s)),
    ("D needed, T6", |c| format!("{:.0}", c.damping_needed)),
    ("D there is", |c| format!("{:.0}", c.damping)),
    ("largest speed, m/s", |c| format!("{:.3}", c.largest_speed_m_s)),
    ("stable taxels", |c| match c.stable_taxels.as_slice() {
        [] => "none: NOT SAFE with these gains".into(),
        taxels => taxels.iter().map(|t| format!("T{t}")).collect::<Vec<_>>().join(" "),
    }),
];

fn as_text(report: &Report, forces_n: &[f64], base: &BaseTable) -> String {
    let share = report.firmwares.first().map_or(0.0, |l| 100.0 * l.foam_share_after_100_ms);
    let [boards, firmwares, contacts] = [
        table(&report.boards, forces_n),
        study::table(FIRMWARES, &report.firmwares),
        study::table(CONTACTS, &report.contacts),
    ];
    let (servo_ms, braking_m_s2) = (1e3 * base.servo_time_constant_s, base.acceleration_max_m_s2);
    format!(
        "HOW OLD A READING GETS, AND HOW FAST THE BASE MAY GO WITH IT\n\n{boards}\n\
         Age: from the earliest time at which the chip can have sampled it. Oldest: the age that a reading reaches \
         before the next one\n(of a stock board its FDAT line, which may slow the base down before DIFF confirms it). \
         T: one tick less. Speed: smaller of\n(F - {UNFELT_N} N)/(k (T + servo)) and of stopping at {braking_m_s2} m/s2 within the \
         way that PU LD30 and {TISSUE_N_M} N/m of tissue yield up to F.\nThe forces are protection.assessed_forces_n: \
         yours, not a limit of this program.\n\n\
         FROM TOUCH TO FORCE: mean delay of each stage, ms\n\n{firmwares}\n\
         Foam: no delay of its own, it creeps: after 0.1 s a held 50 N reads {share:.0} % of what it reads after \
         10 s.\nChip, stock: 10 ms mean of 1 ms samples, refreshed every 10 ms (5 to 15 ms old when read); moca: 4 ms. \
         Wait: half a frame.\nTiming of stock-2018 is traced from the firmware, of stock-2015 inferred from its print \
         speed, of moca simulated. \
         Measured: {PUSH_N} N steps on the virtual\nboard at {PHASES} phases, bytes to 1 kHz loop; parse includes the \
         board's own emission.\n\nIN CONTACT with {TISSUE_N_M} N/m of tissue at {FORCE_LIMIT_N} N, gains of the paper's text, \
         servo {servo_ms:.0} ms, braking {braking_m_s2} m/s2\n\n{contacts}\n\
         One-dimensional and up to 16 % on the safe side of simulation; the paper's gains sit on its boundary. A \
         speed is the\nsmaller of the small-signal bound F/(k(T + servo)) and of stopping within the way that foam \
         and tissue yield.\n"
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_measured_chain_is_the_sum_of_its_stages() {
        for firmware in BOARDS {
            let latency = latency(firmware).unwrap();
            // USB is not simulated for a stock board: bytes arrive with the tick
            let expected_ms = latency.sum_ms - latency.usb_ms;
            assert!((latency.measured_half_ms - expected_ms).abs() < 3.0, "{latency:?}");
            assert!(latency.measured_half_worst_ms > latency.measured_half_ms);
        }
    }

    #[test]
    fn firmware_timing_matches_its_virtual_board() {
        for firmware in BOARDS {
            let board = held(firmware).unwrap();
            let said_ms = milliseconds(firmware.worst_hold_ns());
            println!("{board:?}, said {said_ms} ms");
            // a tick rounds up
            assert!((-1.0..=1.5).contains(&(board.hold_worst_ms - said_ms)), "{board:?}, said {said_ms} ms");
        }
    }

    #[test]
    fn a_larger_force_never_allows_less_speed() {
        let speeds = speeds(&[25.0, 65.0, 130.0, 260.0], 0.009, &Config::default().robot.base).unwrap();
        assert!(speeds.windows(2).all(|pair| pair[0].m_s <= pair[1].m_s && pair[0].m_s > 0.0), "{speeds:?}");
    }

    #[test]
    fn an_older_reading_allows_less_speed_and_needs_more_damping() {
        let at =
            |delay_s| contact(String::new(), &Foam::PU_LD30, delay_s, &Config::default().robot.base).unwrap();
        let (fast, slow) = (at(0.009), at(0.0537));
        assert!(slow.largest_speed_m_s < fast.largest_speed_m_s);
        assert!(slow.damping_needed > fast.damping_needed);
        assert!(slow.stable_taxels.is_empty(), "a stock board is outside what these gains bear: {slow:?}");
    }
}
