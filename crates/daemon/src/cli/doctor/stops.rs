//! `mocad doctor --base`: the distance in which the base stops. Under the contact barrier the speed limit follows from it.
#![expect(clippy::print_stdout, reason = "this module is what the user sees on the terminal")]

use crate::cli::configuration;
use crate::config::Config;
use crate::control::stopping::{self, LADDER_M_S, STOPS_EACH, Stop};
use crate::robot::{BaseDriver, PlantKind};
use anyhow::{Result, bail, ensure};
use std::path::Path;
use std::time::SystemTime;

/// Measures the base of `config`, prints the result, and writes it into `file`.
///
/// # Errors
/// No base to drive, one that does not answer, or a file that the result makes invalid; the file then is as it was.
pub(super) fn run(config: &Config, file: Option<&Path>) -> Result<()> {
    ensure!(
        config.plant.parts.has_cover(),
        "doctor --base drives a base: plant.parts = \"whole\" or \"base\""
    );
    let simulated = match (config.plant.kind, config.plant.base.driver) {
        (PlantKind::None, _) | (PlantKind::Robot, BaseDriver::Own) => {
            bail!("doctor --base drives a simulated base or one behind ROS 2 (plant.kind, plant.base.driver)")
        }
        (PlantKind::Simulated, _) | (PlantKind::Robot, BaseDriver::Simulated) => true,
        (PlantKind::Robot, BaseDriver::Ros2) => false,
    };
    let stops = if simulated { simulated_stops(config)? } else { real_stops(config)? };
    let date = humantime::format_rfc3339_seconds(SystemTime::now());
    let what = if simulated { "simulated base" } else { "base" };
    let mut believed = config.clone();
    let count = LADDER_M_S.len() * STOPS_EACH;
    stopping::believe(&mut believed, &stops, format!("{date}, {what}, {count} stops"));

    println!(
        "Stopping distance of the {what}, from the order to the rest ({STOPS_EACH} stops at each speed)"
    );
    println!("  speed, m/s   mean, mm   deviation, mm   bound, mm");
    for stop in &stops {
        let (mean, deviation) = (1e3 * stop.mean_m, 1e3 * stop.deviation_m);
        println!("  {:>10.3} {mean:>10.2} {deviation:>15.3} {:>11.2}", stop.speed_m_s, 1e3 * stop.bound_m());
    }
    match file {
        Some(path) => {
            configuration::replace(path, &entered(&configuration::read(path)?, &believed)?)?;
            println!("\nWritten into {}.", path.display());
        }
        None => println!(
            "\nFor the configuration (`--config FILE --write` enters it):\n{}",
            entered("", &believed)?
        ),
    }
    Ok(())
}

/// `text` with what `believed` says of the base's stops in its section `[protection]`; everything else as it was.
fn entered(text: &str, believed: &Config) -> Result<String> {
    let p = &believed.protection;
    let rounded = |value: f64, digits: i32| (value * 10_f64.powi(digits)).ceil() / 10_f64.powi(digits);
    let all = |values: &[f64], digits| {
        toml_edit::Value::from_iter(values.iter().map(|value| rounded(*value, digits)))
    };
    configuration::entered(
        text,
        &["protection"],
        [
            ("order_delay_ms", rounded(p.order_delay_ms, 2).into()),
            ("order_delay_error_ms", rounded(p.order_delay_error_ms, 2).into()),
            ("stopping_speed_m_s", all(&p.stopping_speed_m_s, 4)),
            ("stopping_distance_m", all(&p.stopping_distance_m, 6)),
            ("stopping_measured", p.stopping_measured.as_str().into()),
        ],
    )
}

#[cfg(feature = "sim")]
fn simulated_stops(config: &Config) -> Result<Vec<Stop>> {
    use moca_lockstep::simulated_robot::{free_scene, stops};
    stops(config, &free_scene(config))
}

#[cfg(not(feature = "sim"))]
fn simulated_stops(_: &Config) -> Result<Vec<Stop>> {
    bail!("a simulated base needs a build with the feature `sim`")
}

#[cfg(feature = "ros2")]
fn real_stops(config: &Config) -> Result<Vec<Stop>> {
    use crate::devices::ros2_base::connect;
    use moca_figures::progress::Progress;
    use std::time::{Duration, Instant};
    let mut base = connect(config, |said| println!("  {said}"))?;
    let period = Duration::from_secs_f64(1.0 / f64::from(config.control_loop.rate_hz));
    let begin = Instant::now();
    while base.state().is_none_or(|state| state.age_s > config.plant.base.deadline_s) {
        ensure!(begin.elapsed() < DISCOVERY, "the base sends no odometry: `mocad doctor --robot` says why");
        std::thread::sleep(period);
    }
    std::thread::sleep(LOOKED_UP);
    let problems = base.problems();
    ensure!(problems.is_empty(), "nothing is driven:\n  {}", problems.join("\n  "));
    println!(
        "The base drives up to 0.1 m forward and back, at up to {} m/s. Keep away from it.",
        LADDER_M_S[5]
    );
    let mut bar = Progress::new("stops");
    let mut next = Instant::now();
    let result = climb(config, |forward_m_s, share| {
        base.order([forward_m_s, 0.0, 0.0]);
        bar.at(share);
        next += period;
        std::thread::sleep(next.saturating_duration_since(Instant::now()));
        base.state().map(|state| (state.pose_world, state.age_s))
    });
    base.order([0.0; 3]);
    std::thread::sleep(ENDS);
    bar.end();
    result
}

#[cfg(not(feature = "ros2"))]
fn real_stops(_: &Config) -> Result<Vec<Stop>> {
    bail!(
        "plant.base.driver = \"ros2\" needs a build with the feature `ros2` (cargo build --release --features ros2)"
    )
}

/// Time after which the publishers of the topics are known: they are looked up once a second.
#[cfg(feature = "ros2")]
const LOOKED_UP: std::time::Duration = std::time::Duration::from_secs(2);
/// Nodes find each other in this time, and the last order is on its way after this one.
#[cfg(feature = "ros2")]
const DISCOVERY: std::time::Duration = std::time::Duration::from_secs(5);
#[cfg(feature = "ros2")]
const ENDS: std::time::Duration = std::time::Duration::from_millis(300);
/// Furthest from its start that a base is driven on, m: the ladder needs 0.12.
#[cfg(any(feature = "ros2", test))]
const FURTHEST_M: f64 = 0.3;

/// The ladder with a base behind `drive`, which takes an order (m/s) and the share of the ladder that is done, and returns pose and
/// age of the odometry one tick later; `None` if there is none.
///
/// # Errors
/// Odometry that is missing or older than the configuration allows, and a base that is driven away or does not go as it is told.
#[cfg(any(feature = "ros2", test))]
fn climb(config: &Config, mut drive: impl FnMut(f64, f64) -> Option<([f64; 3], f64)>) -> Result<Vec<Stop>> {
    use anyhow::Context as _;
    let mut ladder = stopping::Ladder::new(
        config.limits.base_acceleration[0],
        1.0 / f64::from(config.control_loop.rate_hz),
    );
    let deadline_s = config.plant.base.deadline_s;
    let (mut start, mut place_m) = (None, 0.0);
    while let Some(forward_m_s) = ladder.tick(place_m)? {
        let ([x, y, yaw], age_s) =
            drive(forward_m_s, ladder.share()).context("the base has stopped sending odometry")?;
        ensure!(
            age_s <= deadline_s,
            "odometry is {:.0} ms old; allowed: {:.0} ms (plant.base.deadline_s)",
            1e3 * age_s,
            1e3 * deadline_s
        );
        let [x0, y0, yaw0] = *start.get_or_insert([x, y, yaw]);
        place_m = yaw0.cos() * (x - x0) + yaw0.sin() * (y - y0);
        ensure!(
            (x - x0).hypot(y - y0) <= FURTHEST_M,
            "the base is {:.2} m from where it started; allowed: {FURTHEST_M} m. Do its odometry and its orders point the same way?",
            (x - x0).hypot(y - y0)
        );
    }
    Ok(ladder.stops().collect())
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::collections::VecDeque;

    /// A base at `yaw` whose orders are `late` ticks late, and its odometry `age_s` old.
    fn climbed(yaw: f64, late: usize, age_s: f64) -> Result<Vec<Stop>> {
        let config = Config::default();
        let tick_s = 1.0 / f64::from(config.control_loop.rate_hz);
        let mut orders: VecDeque<f64> = vec![0.0; late].into();
        let mut way_m = 0.0;
        climb(&config, |order_m_s, share| {
            assert!((0.0..=1.0).contains(&share), "{share}");
            orders.push_back(order_m_s);
            way_m += tick_s * orders.pop_front().unwrap();
            Some(([2.0 + yaw.cos() * way_m, -1.0 + yaw.sin() * way_m, yaw], age_s))
        })
    }

    #[test]
    fn distance_of_a_late_base_is_measured_along_its_own_axis() {
        for (yaw, late, late_s) in [(0.0, 0, 0.0), (2.3, 50, 0.05), (-1.0, 100, 0.1)] {
            for stop in climbed(yaw, late, 0.01).unwrap() {
                let expected_m = stop.speed_m_s * late_s + stop.speed_m_s.powi(2) / 6.0;
                assert!((stop.mean_m - expected_m).abs() < 2e-3 * stop.speed_m_s + 1e-5, "{yaw}: {stop:?}");
            }
        }
    }

    #[test]
    fn base_that_is_not_heard_or_runs_away_is_driven_no_further() {
        let message = |result: Result<Vec<Stop>>| result.unwrap_err().to_string();
        assert!(message(climbed(0.0, 0, 5.0)).contains("5000 ms old; allowed"));
        assert!(message(climb(&Config::default(), |_, _| None)).contains("stopped sending"));
        let stands = climb(&Config::default(), |_, _| Some(([0.0; 3], 0.0)));
        assert!(message(stands).contains("told to go at 0.01 m/s the base goes at 0.0000 m/s"));
        let mut x = 0.0;
        let driven = climb(&Config::default(), |_, _| {
            x += 1e-3;
            Some(([x, 0.0, 0.0], 0.0))
        });
        assert!(message(driven).contains("0.30 m from where it started; allowed: 0.3 m"));
    }

    #[test]
    fn result_is_entered_beside_what_the_file_says() {
        let mut config = Config::default();
        let stops = [(0.01, 1e-3), (0.02, 3e-3)].map(|(speed_m_s, mean_m)| Stop {
            speed_m_s,
            mean_m,
            deviation_m: 1e-4,
        });
        stopping::believe(&mut config, &stops, "2026-11-26, test".into());
        let text = "# ours\n[protection]\nplates = 2 # seam\nstopping_measured = \"old\"\n[board]\nport = \"simulated\"\n";
        let new = entered(text, &config).unwrap();
        assert!(new.starts_with("# ours\n[protection]\nplates = 2 # seam\n"), "{new}");
        assert!(!new.contains("old") && new.ends_with("[board]\nport = \"simulated\"\n"), "{new}");
        let read = Config::parse(&new).unwrap().protection;
        assert_eq!((read.plates, read.stopping_measured.as_str()), (2, "2026-11-26, test"));
        assert_eq!(read.stopping_speed_m_s, [0.01, 0.02]);
        for (read, stop) in read.stopping_distance_m.iter().zip(&stops) {
            assert!((0.0..2e-6).contains(&(read - stop.bound_m())), "rounded to the safe side: {read}");
        }
        assert!(entered("protection = 3", &config).is_err() && entered("[", &config).is_err());
    }
}
