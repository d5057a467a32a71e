//! `moca-lab latency`: from touch to force, stage by stage, for each generation of the board's sketch; whether such a
//! cover is stable in contact with this controller, and how fast the base may go.

use moca_msgs::ImpedanceGains;
use moca_msgs::robot::{PAPER_COVER, SUMMIT_XL};
use moca_sim::board::{VirtualBoard, VirtualBoardConfig};
use moca_sim::foam::Foam;
use moca_tactile::board::CHIP_FILTER_AGE_NS;
use moca_tactile::Firmware;
use moca_tactile::{Cover, CoverConfig, TareStatus};
use moca_wbc::contact_stability::{Contact, at_taxel, largest_speed, least_damping, margin, reading_delay_s};
use serde::Serialize;
use std::fmt::Write;
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

/// Arguments of `moca-lab latency`.
#[derive(clap::Args)]
pub(crate) struct Arguments {
    /// Prints one JSON object instead of tables.
    #[arg(long)]
    json: bool,
}

#[derive(Debug, Serialize)]
struct Report {
    sketches: Vec<Latency>,
    contacts: Vec<ContactReport>,
}

/// Mean delay of each stage, ms, and the whole chain measured.
#[derive(Debug, Serialize)]
struct Latency {
    sketch: &'static str,
    /// How much of a step's reading has come after 0.1 s, relative to 10 s later: the foam creeps, it does not wait.
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
    /// Age of the data when a frame is complete.
    age_ms: f64,
    period_ms: f64,
}

/// A cover in contact with this controller.
#[derive(Debug, Serialize)]
struct ContactReport {
    reading: String,
    foam: &'static str,
    /// Foam and tissue in series at 25 N, N/m.
    stiffness_n_m: f64,
    /// Total delay T of the law in controllers.md, s.
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
#[expect(clippy::print_stdout, reason = "the command's output")]
pub(crate) fn run(arguments: &Arguments) -> anyhow::Result<()> {
    let report = report()?;
    if arguments.json {
        println!("{}", serde_json::to_string_pretty(&report)?);
    } else {
        print!("{}", as_text(&report));
    }
    Ok(())
}

fn report() -> anyhow::Result<Report> {
    use Firmware::{PiCap, Stock2015, Stock2018};
    let sketches: Vec<Latency> =
        [Stock2015, Stock2018, PiCap].into_iter().map(latency).collect::<anyhow::Result<_>>()?;
    let mut contacts = Vec::new();
    for foam in [Foam::PU_LD30, Foam::COLLISION_ASSUMED] {
        contacts.push(contact("ideal, 10 ms".to_owned(), &foam, 0.0, 0.010)?);
        for sketch in &sketches {
            let (age_s, period_s) = (1e-3 * sketch.age_ms, 1e-3 * sketch.period_ms);
            contacts.push(contact(format!("sketch {}", sketch.sketch), &foam, age_s, period_s)?);
        }
    }
    Ok(Report { sketches, contacts })
}

fn latency(sketch: Firmware) -> anyhow::Result<Latency> {
    let period_ms = milliseconds(sketch.frame_period_ns());
    let print_ms = milliseconds(sketch.line_offset_ns()[5]);
    let chip_filter_ms = milliseconds(CHIP_FILTER_AGE_NS);
    let mut first = Vec::new();
    let mut half = Vec::new();
    let mut parse_us = Vec::new();
    let mut foam_share = 0.0;
    for phase in 0..PHASES {
        let step = Step::measure(sketch, phase)?;
        first.push(step.first_ms);
        half.push(step.half_ms);
        parse_us.push(step.parse_us);
        foam_share = step.share_after_100_ms;
    }
    let parse_us = parse_us.into_iter().fold(f64::INFINITY, f64::min);
    let (usb_ms, loop_ms) = (USB_MEAN_MS, 0.5 * milliseconds(TICK_NS));
    Ok(Latency {
        sketch: sketch.name(),
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
        age_ms: chip_filter_ms + print_ms,
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
    fn measure(sketch: Firmware, phase: u64) -> anyhow::Result<Self> {
        let mut board =
            VirtualBoard::new(VirtualBoardConfig { sketch, seed: phase + 1, ..Default::default() })?;
        let mut cover = Cover::<11>::new(CoverConfig::default())?;
        // spread over one frame and one refresh of the chip, which are not commensurable
        let step_ns = 3_000_000_000 + phase * 1_700_000;
        let (mut now_ns, mut parse_ns, mut frames) = (0, 0, 0u32);
        let mut forces = Vec::new();
        cover.start_tare(0);
        while now_ns < step_ns + 10_000_000_000 {
            let mut force_n = [0.0; 11];
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
        let settled_n = after(100.0, 250.0);
        let reached = |level_n: f64| forces.iter().find(|f| f.1 > level_n).map_or(f64::NAN, |f| f.0);
        #[expect(clippy::cast_precision_loss, reason = "seconds in ns")]
        let parse_us = parse_ns as f64 * 1e-3 / f64::from(frames) * 6.0;
        Ok(Self {
            first_ms: reached(0.0),
            half_ms: reached(0.5 * settled_n),
            share_after_100_ms: settled_n / after(9_500.0, 10_000.0),
            parse_us,
        })
    }
}

fn contact(reading: String, foam: &Foam, age_s: f64, period_s: f64) -> anyhow::Result<ContactReport> {
    let gains = ImpedanceGains::PAPER;
    let deformation_m = foam.deformation_m(FORCE_LIMIT_N);
    let foam_n_m = foam.stiffness_n_per_m(deformation_m);
    let contact = Contact {
        stiffness_n_m: foam_n_m * TISSUE_N_M / (foam_n_m + TISSUE_N_M),
        damping_n_s_m: foam.damping_time_s * foam_n_m,
        delay_s: reading_delay_s(age_s, period_s, 1e-9 * TICK_NS as f64),
        servo_s: SUMMIT_XL.servo_time_constant_s,
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
        largest_speed_m_s: largest_speed(FORCE_LIMIT_N, travel_m, SUMMIT_XL.acceleration_max_m_s2, &contact)?,
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

fn as_text(report: &Report) -> String {
    let mut out = String::new();
    // writing to a String cannot fail
    let _ = writeln!(
        out,
        "FROM TOUCH TO FORCE: mean delay of each stage [ms]\n\n{:<12}{:>12}{:>10}{:>14}{:>6}{:>12}{:>7}{:>8}   \
         measured to half / worst / first felt",
        "sketch", "chip filter", "wait", "I2C + print", "USB", "parse [us]", "loop", "sum"
    );
    for l in &report.sketches {
        let _ = writeln!(
            out,
            "{:<12}{:>12.1}{:>10.2}{:>14.1}{:>6.1}{:>12.1}{:>7.1}{:>8.1}   {:.1} / {:.1} / {:.1}",
            l.sketch,
            l.chip_filter_ms,
            l.wait_for_read_ms,
            l.read_and_print_ms,
            l.usb_ms,
            l.parse_us,
            l.loop_ms,
            l.sum_ms,
            l.measured_half_ms,
            l.measured_half_worst_ms,
            l.measured_first_ms,
        );
    }
    let share = report.sketches.first().map_or(0.0, |l| 100.0 * l.foam_share_after_100_ms);
    let _ = writeln!(
        out,
        "\nFoam: no delay of its own, it creeps: after 0.1 s a held 50 N reads {share:.0} % of what it reads after \
         10 s.\nChip: 10 ms mean of 1 ms samples, refreshed every 10 ms (5 to 15 ms old when read). Wait: half a \
         frame. Timing of 2018-2020\nis traced from the firmware, the other two are inferred from its print speed. \
         Measured: {PUSH_N} N steps on the virtual\nboard at {PHASES} phases, bytes to 1 kHz loop; parse includes the \
         board's own emission.\n\nIN CONTACT with {} N/m of tissue at {FORCE_LIMIT_N} N, gains of the paper's text, \
         servo {:.0} ms, braking {} m/s2\n\n{:<19}{:<22}{:>10}{:>9}{:>14}{:>12}{:>14}  stable taxels",
        TISSUE_N_M,
        1e3 * SUMMIT_XL.servo_time_constant_s,
        SUMMIT_XL.acceleration_max_m_s2,
        "reading",
        "foam",
        "k [N/m]",
        "T [ms]",
        "D needed, T6",
        "D there is",
        "largest speed"
    );
    for c in &report.contacts {
        let stable = match c.stable_taxels.as_slice() {
            [] => "none: NOT SAFE with these gains".to_owned(),
            taxels => taxels.iter().map(|t| format!("T{t}")).collect::<Vec<_>>().join(" "),
        };
        let _ = writeln!(
            out,
            "{:<19}{:<22}{:>10.0}{:>9.1}{:>14.0}{:>12.0}{:>10.3} m/s  {stable}",
            c.reading,
            c.foam,
            c.stiffness_n_m,
            1e3 * c.delay_s,
            c.damping_needed,
            c.damping,
            c.largest_speed_m_s
        );
    }
    let _ = writeln!(
        out,
        "\nOne-dimensional and up to 16 % on the safe side of simulation; the paper's gains sit on its boundary. A \
         speed is the\nsmaller of the small-signal bound F/(k(T + servo)) and of stopping within the way that foam \
         and tissue yield."
    );
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_measured_chain_is_the_sum_of_its_stages() {
        for sketch in [Firmware::Stock2015, Firmware::Stock2018] {
            let latency = latency(sketch).unwrap();
            // USB is not simulated: bytes arrive with the tick
            let expected_ms = latency.sum_ms - latency.usb_ms;
            assert!((latency.measured_half_ms - expected_ms).abs() < 3.0, "{latency:?}");
            assert!(latency.measured_half_worst_ms > latency.measured_half_ms);
        }
    }

    #[test]
    fn an_older_reading_allows_less_speed_and_needs_more_damping() {
        let at = |age_s, period_s| contact(String::new(), &Foam::PU_LD30, age_s, period_s).unwrap();
        let (fast, slow) = (at(0.0, 0.010), at(0.030, 0.0247));
        assert!(slow.largest_speed_m_s < fast.largest_speed_m_s);
        assert!(slow.damping_needed > fast.damping_needed);
        assert!(slow.stable_taxels.is_empty(), "a stock board is outside what these gains bear: {slow:?}");
    }
}
