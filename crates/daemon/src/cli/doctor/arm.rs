//! `mocad doctor --robot`, the arm: whether it can be driven, and what is wrong if not.

use super::finding::Finding;
use crate::config::Config;
use crate::devices::franka_arm::settings;
use crate::runtime::realtime;
use anyhow::{Context, Result, anyhow};
use moca_franka::mode::Said;
use moca_franka::{ArmState, CARRIES_APART_KG, Fci, JOINTS, Model};
use moca_msgs::arm_errors;
use moca_msgs::{ArmLink, ArmMode};
use std::sync::mpsc::{Receiver, channel};
use std::time::{Duration, Instant};

/// Longest wait for the arm.
const REACH_WITHIN: Duration = Duration::from_secs(5);
/// Longest wait for the next state.
const STATE_WITHIN: Duration = Duration::from_millis(100);
/// Worst period at the 99th percentile that a loop of 1 kHz can live with, ms.
const PERIOD_P99_MS: f64 = 1.5;
/// Share of states that may be lost.
const LOST_SHARE: f64 = 1e-3;
/// Share of orders that have to reach the arm in time.
const SUCCESS_RATE: f64 = 0.95;
/// Gains that hold the arm where it is: N·m/rad and N·m·s/rad, half of those in the arm's own examples.
const HOLD: ([f64; JOINTS], [f64; JOINTS]) =
    ([300.0, 300.0, 300.0, 300.0, 125.0, 75.0, 25.0], [25.0, 25.0, 25.0, 25.0, 15.0, 12.0, 7.0]);

/// Observations of an arm.
struct Facts {
    host: String,
    /// Version of FCI.
    version: Option<u16>,
    /// Messages of its driver, oldest first.
    said: Vec<String>,
    state: Option<ArmState>,
    link: ArmLink,
    states: u64,
    /// Median and 99th percentile of the time between two states, ms.
    period_ms: [f64; 2],
    carries_kg: f64,
    /// Least success rate while it was held, if it was asked to be and let itself be driven.
    held: Option<Option<f64>>,
}

/// Reaches the arm, listens to it for `length`, and holds it where it is for as long again if asked.
///
/// # Errors
/// A configuration that FCI cannot serve, or no thread.
pub(super) fn look(config: &Config, length: Duration, hold: bool) -> Result<Vec<Finding>> {
    // As the loop would hear it; threads of other parts must not inherit that.
    let on_its_own = || {
        let (_steps, _held) = realtime::apply(&config.realtime);
        look_in_time(config, length, hold)
    };
    std::thread::scope(|scope| {
        scope.spawn(on_its_own).join().map_err(|_| anyhow!("the measurement panicked"))?
    })
}

fn look_in_time(config: &Config, length: Duration, hold: bool) -> Result<Vec<Finding>> {
    let (say, said) = channel();
    let settings = settings(config)?;
    let (host, carries_kg) = (settings.host.clone(), settings.carries_kg);
    let mut arm =
        Fci::spawn(settings, move |text| drop(say.send(text.to_owned()))).context("the arm's thread")?;
    let begin = Instant::now();
    while begin.elapsed() < REACH_WITHIN && arm.receive(STATE_WITHIN).is_none() {}
    let (states, period_ms) = listen(&mut arm, length);
    let (state, link, version) = (arm.state().copied(), arm.link(), arm.version());
    let held = (hold && state.is_some()).then(|| held(&mut arm, length));
    drop(arm);
    let said = Receiver::try_iter(&said).collect();
    Ok(findings(&Facts { host, version, said, state, link, states, period_ms, carries_kg, held }))
}

/// States that came, and how far apart: median and 99th percentile, ms.
fn listen(arm: &mut Fci, length: Duration) -> (u64, [f64; 2]) {
    let (begin, mut before, mut periods_ms) = (Instant::now(), None, Vec::new());
    while arm.state().is_some() && begin.elapsed() < length {
        if arm.receive(STATE_WITHIN).is_some() {
            let now = arm.state().map(|state| state.received);
            let gap = now.zip(before).map(|(now, before): (Instant, Instant)| now.duration_since(before));
            periods_ms.extend(gap.map(|gap| 1e3 * gap.as_secs_f64()));
            before = now;
        }
    }
    periods_ms.sort_unstable_by(f64::total_cmp);
    let at = |percent: usize| periods_ms.get(periods_ms.len() * percent / 100).copied().unwrap_or(f64::NAN);
    (periods_ms.len() as u64, [at(50), at(99)])
}

/// Least success rate, or `None` if it did not let itself be driven.
fn held(arm: &mut Fci, length: Duration) -> Option<f64> {
    let home = arm.state()?.q_rad;
    let (begin, mut driven_since, mut least) = (Instant::now(), None, None);
    while begin.elapsed() < length {
        if arm.receive(STATE_WITHIN).is_none() {
            continue;
        }
        let (Some(&state), link) = (arm.state(), arm.link()) else { continue };
        arm.drive(&std::array::from_fn(|i| {
            HOLD.0[i] * (home[i] - state.q_rad[i]) - HOLD.1[i] * state.dq_rad_s[i]
        }));
        if link.mode == ArmMode::Torque {
            // The arm judges its last 100 orders.
            let since: Instant = *driven_since.get_or_insert_with(Instant::now);
            if since.elapsed() > Duration::from_millis(200) {
                least = Some(state.success_rate.min(least.unwrap_or(1.0)));
            }
        }
    }
    arm.brake();
    least
}

fn findings(facts: &Facts) -> Vec<Finding> {
    let Some(state) = &facts.state else { return vec![unreached(facts)] };
    let version = facts.version.map_or(String::new(), |version| {
        let model = Model::of_version(version).map_or("an arm", Model::name);
        format!(": {model}, FCI {version}")
    });
    let ArmLink { lost, repeated, errors, .. } = facts.link;
    let errors = arm_errors::set_in(errors).map(|error| {
        Finding::new("arm's error", false, format!("{}: {}", error.name, error.text)).or(error.remedy)
    });
    let all = facts.states + lost;
    #[expect(clippy::cast_precision_loss, reason = "counts of a few seconds")]
    let lost_share = lost as f64 / all.max(1) as f64;
    let ([p50, p99], ours_kg, desk_kg) = (facts.period_ms, facts.carries_kg, state.carries_kg);
    let period = format!(
        "p50 {p50:.2} ms, p99 {p99:.2} ms of {} states; allowed: p99 {PERIOD_P99_MS} ms",
        facts.states
    );
    let states = format!("{lost} of {all}; allowed: {} %", 100.0 * LOST_SHARE);
    let load = format!("{desk_kg:.2} kg in Desk, {ours_kg:.2} kg in the configuration");
    let held = facts.held.map(|success| {
        let found = success.map_or("it did not let itself be driven".into(), |rate| {
            format!(
                "success rate {rate:.3} at the least; allowed: {SUCCESS_RATE} or more; {repeated} of ours repeated"
            )
        });
        Finding::new("orders that arrive", success.is_some_and(|rate| rate >= SUCCESS_RATE), found)
            .or("look at what is said of states and of this PC")
    });
    let first =
        [Finding::new("arm", true, format!("answers at {}{version}", facts.host)), mode(state, facts.link)];
    let then = [
        Finding::new("states lost", lost_share <= LOST_SHARE, states)
            .or("a network card of its own for the arm, its own cable, no switch; not a USB adapter"),
        Finding::new("period of the states", p99 <= PERIOD_P99_MS, period).or(
            "this PC wakes late: a real-time kernel, the card's interrupts away from the loop's core, nothing else at work",
        ),
        Finding::new("load", (desk_kg - ours_kg).abs() <= CARRIES_APART_KG, load).or(
            "write robot.tool and robot.load as in Desk, or plant.arm.payload = \"arm\"; the laws take the difference for a push",
        ),
    ];
    first.into_iter().chain(errors).chain(then).chain(held).collect()
}

fn unreached(facts: &Facts) -> Finding {
    let said = facts.said.last().cloned().unwrap_or_else(|| format!("nothing answers at {}", facts.host));
    Finding::new("arm", false, said).or(match facts.link.mode {
        ArmMode::Refused => {
            "arm, robot.arm and the arm's system (Desk, Settings, System) have to fit this program"
        }
        _ => {
            "the arm's power and cable, plant.arm.host, this PC's address on the same network; FCI activated in Desk"
        }
    })
}

fn mode(state: &ArmState, link: ArmLink) -> Finding {
    let (found, remedy) = match state.said {
        Said::Idle => ("ready", ""),
        Said::Recovers => ("recovers from a reflex", "wait until it has recovered, then look again"),
        Said::Moves if link.mode.follows() => ("driven by this program", ""),
        Said::Moves => ("another program drives it", "end the other program, or release its control in Desk"),
        Said::Other => {
            ("brakes closed, or not in execution", "Desk: unlock the brakes, activate FCI, execution mode")
        }
        Said::Guided => ("guided by hand", "let go of its buttons; execution mode in Desk"),
        Said::Reflex => {
            ("stopped by its own reflex", "free whoever is caught; `mocad resume` recovers it, or Desk")
        }
        Said::UserStopped => ("its user stop is pressed", "release it; the lights turn from yellow to blue"),
    };
    Finding::new("arm's mode", remedy.is_empty(), found).or(remedy)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn answering(said: Said, mode: ArmMode) -> Facts {
        let state = ArmState {
            count: 1,
            q_rad: [0.0; JOINTS],
            dq_rad_s: [0.0; JOINTS],
            torque_nm: [0.0; JOINTS],
            feels_gravity: true,
            wrench_base: [0.0; 6],
            said,
            carries_kg: 0.0,
            success_rate: 1.0,
            received: Instant::now(),
        };
        Facts {
            host: "172.16.0.2".into(),
            version: Some(5),
            said: Vec::new(),
            state: Some(state),
            link: ArmLink { mode, ..ArmLink::default() },
            states: 10_000,
            period_ms: [1.0, 1.1],
            carries_kg: 0.0,
            held: None,
        }
    }

    #[test]
    fn only_an_arm_on_its_own_controller_or_driven_by_us_is_ready() {
        for said in Said::ALL {
            let of = |mode| findings(&answering(said, mode)).iter().all(|finding| finding.good);
            assert_eq!(of(ArmMode::Idle), said == Said::Idle, "{said:?}");
            assert_eq!(of(ArmMode::Torque), matches!(said, Said::Idle | Said::Moves), "{said:?}");
        }
    }

    #[test]
    fn which_arm_answers_and_the_version_that_it_speaks_are_said() {
        let findings = findings(&answering(Said::Idle, ArmMode::Idle));
        let text = &findings[0].found;
        assert!(text.contains("172.16.0.2: Franka Emika Panda, FCI 5"), "{text}");
    }
}
