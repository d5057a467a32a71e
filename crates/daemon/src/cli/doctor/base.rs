//! `mocad doctor --robot`, the base: whether it is heard, obeys and stops by itself, and what is wrong if not.

use super::finding::Finding;
use crate::config::Config;
use crate::devices::ros2_base::{connect, settings, transport};
use anyhow::Result;
use moca_ros2::base::timeout::{AfterSilence, measure};
use std::sync::atomic::Ordering;
use std::time::{Duration, Instant};

/// Test speed for the base's time-out, m/s.
const SPEED_M_S: f64 = 0.02;
/// Nodes find each other in this time.
const DISCOVERY: Duration = Duration::from_secs(3);
/// Time that wheels and odometry may take beyond the time-out, s.
const SLACK_S: f64 = 0.25;
/// Clocks further apart than this refuse each other's stamps, s.
const CLOCKS_APART_S: f64 = 0.1;

/// Observations of a base.
struct Facts {
    seconds: f64,
    odometry: u64,
    refused: u64,
    garbled: u64,
    /// Oldest that its state ever was, s; infinite without any.
    oldest_s: f64,
    deadline_s: f64,
    offset_s: f64,
    stamped: bool,
    problems: Vec<String>,
    command_timeout_s: f64,
    after: Option<AfterSilence>,
}

/// Listens to the base for `length`; drives it at 2 cm/s, and falls silent, if asked.
///
/// # Errors
/// No network, or a topic whose name is none.
pub(super) fn look(config: &Config, length: Duration, drive: bool) -> Result<Vec<Finding>> {
    let length = length.max(DISCOVERY);
    let mut base = connect(config, |_| {})?;
    let (begin, mut oldest_s, mut problems) = (Instant::now(), f64::INFINITY, Vec::new());
    while begin.elapsed() < length {
        if let Some(state) = base.state() {
            oldest_s = state.age_s.max(if oldest_s.is_finite() { oldest_s } else { 0.0 });
        }
        // Only what was refused is told once; who else is on the network is told as long as it lasts.
        let found = base.problems();
        if begin.elapsed() + Duration::from_secs(1) > length {
            problems = found;
        }
        std::thread::sleep(Duration::from_millis(5));
    }
    let counts = base.counts();
    let of = |count: &std::sync::atomic::AtomicU64| count.load(Ordering::Relaxed);
    #[expect(clippy::cast_precision_loss, reason = "to be shown")]
    let offset_s = counts.clock_offset_ns.load(Ordering::Relaxed) as f64 * 1e-9;
    let (odometry, refused, garbled) = (of(&counts.odometry), of(&counts.refused), of(&counts.garbled));
    drop(base);
    let after = drive.then(|| -> Result<AfterSilence> {
        Ok(measure(transport(config)?.as_mut(), &settings(config), SPEED_M_S)?)
    });
    Ok(findings(&Facts {
        seconds: length.as_secs_f64(),
        odometry,
        refused,
        garbled,
        oldest_s,
        deadline_s: config.plant.base.deadline_s,
        offset_s,
        stamped: config.plant.base.ros2.stamped,
        problems,
        command_timeout_s: config.robot.base.command_timeout_s,
        after: after.transpose()?,
    }))
}

fn findings(facts: &Facts) -> Vec<Finding> {
    let of_network = |good, found: &str| Finding::new("base's network", good, found).or(NETWORK);
    let mut findings: Vec<Finding> =
        facts.problems.iter().map(|problem| of_network(false, problem)).collect();
    if findings.is_empty() {
        findings.push(of_network(true, "one base, no other writer, types as ours"));
    }
    #[expect(clippy::cast_precision_loss, reason = "counts of a few seconds")]
    let rate_hz = facts.odometry as f64 / facts.seconds;
    let heard = facts.odometry > 0;
    let [oldest_ms, allowed_ms] = [facts.oldest_s, facts.deadline_s].map(|age_s| 1e3 * age_s);
    let odometry = match heard {
        true => format!("{rate_hz:.1} Hz, {oldest_ms:.0} ms old at the most; allowed: {allowed_ms:.0} ms"),
        false => "none that can be used".into(),
    };
    let refused = format!("{} refused, {} invalid", facts.refused, facts.garbled);
    findings.extend([
        Finding::new("odometry", heard && oldest_ms <= allowed_ms, odometry).or(
            "plant.base.deadline_s is what the loop bears; a wired network, or a base that speaks more often",
        ),
        Finding::new("odometry refused", facts.refused + facts.garbled == 0, refused)
            .or("odometry that jumps, has no stamp or is old when it comes; the reason stands above"),
    ]);
    if heard {
        let apart = facts.offset_s.abs() > CLOCKS_APART_S;
        let found = format!("the base's stamps are {:+.3} s behind this PC's clock", facts.offset_s);
        findings.push(Finding::new("clocks", !(apart && facts.stamped), found).or(
            "a base that is sent stamped orders may refuse old ones: chrony on both, the base's PC as server",
        ));
    }
    findings.extend(facts.after.map(|after| timeout(after, facts.command_timeout_s)));
    findings
}

const NETWORK: &str = "the base's domain, names and types: plant.base.ros2; `ros2 topic info --verbose` on its PC names the nodes";

fn timeout(after: AfterSilence, expected_s: f64) -> Finding {
    let (good, found) = match after {
        AfterSilence::Stopped(s) => (
            s <= expected_s + SLACK_S,
            format!(
                "it stands {s:.2} s after the last order; robot.base.command_timeout_s says {expected_s} s"
            ),
        ),
        AfterSilence::DroveOn(s) => (false, format!("it still drives {s:.1} s after the last order")),
        AfterSilence::NeverDrove => (false, "it does not drive when it is ordered to".into()),
    };
    Finding::new("base's own time-out", good, found).or(
        "a PC that dies leaves it driving for so long: set its controller's time-out (cmd_vel_timeout, reference_timeout)",
    )
}
