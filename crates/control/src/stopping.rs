//! Measures the distance in which a base stops: a ladder of speeds, some stops each, forward and back.
//!
//! A delay cannot be told from a slow servo by what odometry shows of it, and a slow order never reaches the limit of the
//! deceleration. So the distance itself is measured, from the place that odometry reported when the order began to fall to the
//! place of rest. Odometry that is late makes the distance longer, which is the safe side. A base that does not go as it is told,
//! because it is braked or one of its signs is wrong, stops in no distance at all: its speed before the stops is looked at too.

use crate::config::Config;
use anyhow::{Result, ensure};

/// Speeds of the ladder, m/s.
pub const LADDER_M_S: [f64; 6] = [0.01, 0.02, 0.03, 0.05, 0.08, 0.12];
/// Stops at each of them.
pub const STOPS_EACH: usize = 8;
#[expect(clippy::cast_precision_loss, reason = "a small count")]
const COUNT: f64 = STOPS_EACH as f64;
/// One-sided tolerance factor of [`STOPS_EACH`] normal values: 95 % of all stops, with a confidence of 95 %.
const TOLERANCE: f64 = 3.19;
/// Time of even driving before a stop, and time after which a base is at rest, s.
const DRIVES_S: f64 = 0.8;
const RESTS_S: f64 = 1.2;
/// End of the even driving in which the base's speed is measured, s, and the share of its order that it may have, mean of a speed's
/// stops: odometry may be scaled, and noisy.
const LOOKED_AT_S: f64 = 0.3;
const OBEYED: std::ops::RangeInclusive<f64> = 0.5..=1.5;

/// Stopping distance from one speed.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Stop {
    /// m/s.
    pub speed_m_s: f64,
    /// Mean of the stops, m.
    pub mean_m: f64,
    /// Standard deviation of the stops, m.
    pub deviation_m: f64,
}

impl Stop {
    /// Upper bound S⁺, m.
    pub fn bound_m(&self) -> f64 {
        self.mean_m + TOLERANCE * self.deviation_m
    }
}

/// The ladder, tick by tick: an order for each reported place.
#[derive(Clone, Debug)]
pub struct Ladder {
    /// m/s², with which the orders rise and fall.
    acceleration_m_s2: f64,
    tick_s: f64,
    /// Stops so far, and the distance of each, m.
    stops: [[f64; STOPS_EACH]; LADDER_M_S.len()],
    done: usize,
    /// Time since this stop's start, s; the order, m/s; the place at which the look at the speed and the fall began, m.
    since_s: f64,
    order_m_s: f64,
    looked_m: Option<f64>,
    began_m: Option<f64>,
    /// Sum of the speeds of the present rung, m/s.
    speeds_m_s: f64,
}

impl Ladder {
    /// Orders change by at most `acceleration_m_s2`, as those of the law do.
    pub const fn new(acceleration_m_s2: f64, tick_s: f64) -> Self {
        Self {
            acceleration_m_s2,
            tick_s,
            stops: [[0.0; STOPS_EACH]; LADDER_M_S.len()],
            done: 0,
            since_s: 0.0,
            order_m_s: 0.0,
            looked_m: None,
            began_m: None,
            speeds_m_s: 0.0,
        }
    }

    /// Returns the order of this tick, m/s, for a base that odometry reports at `place_m`; `None` once the ladder has ended.
    ///
    /// # Errors
    /// A base that has not gone as it was told.
    pub fn tick(&mut self, place_m: f64) -> Result<Option<f64>> {
        let (rung, stop) = (self.done / STOPS_EACH, self.done % STOPS_EACH);
        let Some(&speed_m_s) = LADDER_M_S.get(rung) else { return Ok(None) };
        let forward = if stop.is_multiple_of(2) { 1.0 } else { -1.0 };
        self.since_s += self.tick_s;
        let wanted_m_s = if self.since_s <= DRIVES_S { forward * speed_m_s } else { 0.0 };
        if self.since_s > DRIVES_S - LOOKED_AT_S {
            self.looked_m.get_or_insert(place_m);
        }
        if self.since_s > DRIVES_S && self.began_m.is_none() {
            self.began_m = Some(place_m);
            self.speeds_m_s += forward * (place_m - self.looked_m.unwrap_or(place_m)) / LOOKED_AT_S;
        }
        let most_m_s = self.acceleration_m_s2 * self.tick_s;
        self.order_m_s += (wanted_m_s - self.order_m_s).clamp(-most_m_s, most_m_s);
        if self.since_s > DRIVES_S + RESTS_S
            && let Some(began_m) = self.began_m.take()
        {
            self.stops[rung][stop] = forward * (place_m - began_m);
            (self.done, self.since_s, self.looked_m) = (self.done + 1, 0.0, None);
            if self.done.is_multiple_of(STOPS_EACH) {
                obeyed(speed_m_s, std::mem::take(&mut self.speeds_m_s) / COUNT)?;
            }
        }
        Ok(Some(self.order_m_s))
    }

    /// Share of the stops that are complete.
    #[expect(clippy::cast_precision_loss, reason = "small counts")]
    pub const fn share(&self) -> f64 {
        self.done as f64 / (LADDER_M_S.len() * STOPS_EACH) as f64
    }

    /// Results of the speeds whose stops are complete.
    pub fn stops(&self) -> impl Iterator<Item = Stop> {
        let complete = self.done / STOPS_EACH;
        LADDER_M_S.into_iter().zip(&self.stops).take(complete).map(|(speed_m_s, distances)| {
            let mean_m = distances.iter().sum::<f64>() / COUNT;
            let squares: f64 = distances.iter().map(|distance| (distance - mean_m).powi(2)).sum();
            Stop { speed_m_s, mean_m, deviation_m: (squares / (COUNT - 1.0)).sqrt() }
        })
    }
}

/// A base that was told to go at `ordered_m_s` went at `driven_m_s`, by its odometry.
fn obeyed(ordered_m_s: f64, driven_m_s: f64) -> Result<()> {
    ensure!(
        OBEYED.contains(&(driven_m_s / ordered_m_s)),
        "told to go at {ordered_m_s} m/s the base goes at {driven_m_s:.4} m/s by its odometry; allowed: {} to {} of what it is told. \
         Is it braked or on the charger? Do its orders and its odometry point the same way?",
        OBEYED.start(),
        OBEYED.end()
    );
    Ok(())
}

/// Lets `config` believe what was measured; `measured` says when and of what. The law's delay is the part of the distance that grows
/// with the speed, less the lag of the servo that is believed already.
pub fn believe(config: &mut Config, stops: &[Stop], measured: String) {
    let acceleration_m_s2 = config.limits.base_acceleration[0];
    let lag_s =
        |stop: &Stop, distance_m: f64| distance_m / stop.speed_m_s - 0.5 * stop.speed_m_s / acceleration_m_s2;
    let lags_s = || stops.iter().map(|stop| lag_s(stop, stop.mean_m));
    #[expect(clippy::cast_precision_loss, reason = "a small count")]
    let mean_s = lags_s().sum::<f64>() / stops.len().max(1) as f64;
    let most_s = stops.iter().map(|stop| lag_s(stop, stop.bound_m())).fold(mean_s, f64::max);
    let p = &mut config.protection;
    p.order_delay_ms = 1e3 * (mean_s - config.robot.base.servo_time_constant_s).clamp(0.0, 0.5);
    p.order_delay_error_ms = 1e3 * (most_s - mean_s).clamp(0.0, 0.5);
    (p.stopping_speed_m_s, p.stopping_distance_m) = (Vec::new(), Vec::new());
    let mut longest_m = 0.0;
    for stop in stops {
        longest_m = stop.bound_m().max(longest_m + 1e-6);
        p.stopping_speed_m_s.push(stop.speed_m_s);
        p.stopping_distance_m.push(longest_m);
    }
    p.stopping_measured = measured;
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::collections::VecDeque;

    const TICK_S: f64 = 1e-3;

    /// A base of first order whose orders are late and whose odometry is.
    fn measured(order_ticks: usize, servo_s: f64, odometry_ticks: usize) -> Vec<Stop> {
        let mut ladder = Ladder::new(3.0, TICK_S);
        let mut orders: VecDeque<f64> = vec![0.0; order_ticks].into();
        let mut shown: VecDeque<f64> = vec![0.0; odometry_ticks].into();
        let (mut place_m, mut speed_m_s) = (0.0, 0.0);
        loop {
            shown.push_back(place_m);
            let Some(order_m_s) = ladder.tick(shown.pop_front().unwrap()).unwrap() else {
                return ladder.stops().collect();
            };
            orders.push_back(order_m_s);
            speed_m_s += (1.0 - (-TICK_S / servo_s).exp()) * (orders.pop_front().unwrap() - speed_m_s);
            place_m += TICK_S * speed_m_s;
        }
    }

    #[test]
    fn ladder_measures_delay_lag_and_fall_of_the_order() {
        for (order_ticks, servo_s, odometry_ticks) in
            [(0, 0.015, 0), (50, 0.015, 0), (100, 0.1, 0), (50, 0.05, 20)]
        {
            let stops = measured(order_ticks, servo_s, odometry_ticks);
            assert_eq!(stops.len(), LADDER_M_S.len());
            #[expect(clippy::cast_precision_loss, reason = "some ticks")]
            let late_s = TICK_S * (order_ticks + odometry_ticks) as f64 + servo_s;
            for stop in stops {
                let expected_m = stop.speed_m_s * late_s + stop.speed_m_s * stop.speed_m_s / 6.0;
                let off_m = stop.mean_m - expected_m;
                // a tick is how long an order is in force
                assert!(off_m.abs() < 1.1 * TICK_S * stop.speed_m_s + 1e-5, "{stop:?}: {expected_m}");
                assert!(stop.bound_m() - stop.mean_m < 1e-5, "every stop is the same: {stop:?}");
            }
        }
    }

    #[test]
    fn base_that_does_not_go_as_told_has_no_stopping_distance() {
        for (share, passes) in
            [(1.0, true), (0.6, true), (1.4, true), (0.4, false), (1.6, false), (0.0, false), (-1.0, false)]
        {
            let (mut ladder, mut place_m) = (Ladder::new(3.0, TICK_S), 0.0);
            let result = loop {
                match ladder.tick(place_m) {
                    Ok(Some(order_m_s)) => place_m += TICK_S * share * order_m_s,
                    Ok(None) => break Ok(()),
                    Err(error) => break Err(error),
                }
            };
            assert_eq!(result.is_ok(), passes, "{share}: {result:?}");
            if let Err(error) = result {
                assert!(error.to_string().contains("told to go at 0.01 m/s"), "{error}");
                assert!((ladder.share() - 1.0 / 6.0).abs() < 1e-12, "after the slowest speed");
            }
        }
    }

    #[test]
    fn ladder_stays_within_a_few_centimetres() {
        let mut ladder = Ladder::new(3.0, TICK_S);
        let (mut place_m, mut least_m, mut most_m) = (0.0_f64, 0.0_f64, 0.0_f64);
        while let Some(order_m_s) = ladder.tick(place_m).unwrap() {
            place_m += TICK_S * order_m_s;
            (least_m, most_m) = (least_m.min(place_m), most_m.max(place_m));
        }
        assert!(most_m - least_m < 0.12, "{least_m} to {most_m} m");
    }
}
