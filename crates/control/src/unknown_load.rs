//! A load at the flange that nobody told, named from the drift of the momentum observer. Pure, and outside the loop: it changes no
//! command.
//!
//! A load beside the model pulls at the flange with a force that stays and points down. A person's hand can do the
//! same for some seconds, and a wrong arm model for ever, so the mass is said to be about right and nothing follows from it.

use moca_msgs::Sample;
use moca_wbc::model::GRAVITY_M_S2;
use std::fmt;

/// Time over which a wrench is averaged, s.
const WINDOW_S: f64 = 3.0;
/// Lightest load that is named, kg: what friction of 1 N·m in each joint can hide or feign at the reach of a Panda.
const LEAST_KG: f64 = 0.3;
/// Change of a load that is named once more, kg.
const CHANGED_KG: f64 = 0.3;
/// Largest deviation of a force along an axis within the window, N rms: beyond it somebody pushes.
const STEADY_N: f64 = 1.0;
/// Largest horizontal force of a load, as a share of its weight: what friction and a wrong arm model leave.
const SIDEWAYS: f64 = 0.5;
/// Speed of a joint that is at rest, rad/s.
const REST_RAD_S: f64 = 0.02;

/// Watch on the flange for a load that nobody told.
#[derive(Clone, Copy, Debug, Default)]
pub struct UnknownLoadWatch {
    /// Time of the window's first sample, ns; `None` before it.
    since_ns: Option<u64>,
    count: f64,
    mean_n: [f64; 3],
    squares: [f64; 3],
    /// Mass that was named last, kg; 0 for none.
    named_kg: f64,
}

/// A load at the flange that nobody told. It reads as a sentence with its remedy.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct UnknownLoad {
    /// Mass beside what the arm is believed to carry, kg; negative where it carries less.
    pub mass_kg: f64,
}

impl fmt::Display for UnknownLoad {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let more =
            if self.mass_kg > 0.0 { "unknown load of about" } else { "load lighter than told by about" };
        write!(
            f,
            "{more} {:.1} kg at the flange: tell `mocad gripper grasp` its mass, or measure it with `mocad payload identify`",
            self.mass_kg.abs()
        )
    }
}

impl UnknownLoadWatch {
    /// Takes in the next sample. Returns a load once: when it has pulled for a window of rest, and again when it has changed.
    pub fn see(&mut self, sample: &Sample) -> Option<UnknownLoad> {
        let [x, y, z, ..] = sample.flange_wrench_world;
        let is_touched = sample.taxels.iter().any(|taxel| taxel.force_n > 0.0);
        let rests = sample.dq_rad_s.iter().all(|speed| speed.abs() < REST_RAD_S);
        if sample.dq_rad_s.is_empty() || !sample.mode.moves() || is_touched || !rests {
            self.restart();
            return None;
        }
        let since_ns = *self.since_ns.get_or_insert(sample.time_ns);
        self.count += 1.0;
        for ((mean, squares), force) in self.mean_n.iter_mut().zip(&mut self.squares).zip([x, y, z]) {
            let off = force - *mean;
            *mean += off / self.count;
            *squares += off * (force - *mean);
        }
        #[expect(clippy::cast_precision_loss, reason = "seconds")]
        let passed_s = sample.time_ns.saturating_sub(since_ns) as f64 * 1e-9;
        if passed_s < WINDOW_S {
            return None;
        }
        let named = self.judge();
        self.restart();
        named
    }

    /// Begins a window.
    const fn restart(&mut self) {
        *self =
            Self { since_ns: None, count: 0.0, mean_n: [0.0; 3], squares: [0.0; 3], named_kg: self.named_kg };
    }

    /// Judges a full window.
    fn judge(&mut self) -> Option<UnknownLoad> {
        let steady = self.squares.iter().all(|squares| (squares / self.count).sqrt() <= STEADY_N);
        let [x, y, z] = self.mean_n;
        if !steady || f64::hypot(x, y) > SIDEWAYS * z.abs().max(LEAST_KG * GRAVITY_M_S2) {
            return None;
        }
        let mass_kg = -z / GRAVITY_M_S2;
        if mass_kg.abs() < LEAST_KG {
            self.named_kg = 0.0;
            return None;
        }
        if (mass_kg - self.named_kg).abs() < CHANGED_KG {
            return None;
        }
        self.named_kg = mass_kg;
        Some(UnknownLoad { mass_kg })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use moca_msgs::{Mode, TaxelReading, TaxelStatus};

    /// Feeds `seconds` of samples to the watch, from loop time `start_s`, and returns the masses that it names, kg.
    #[expect(
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss,
        clippy::cast_precision_loss,
        reason = "some seconds"
    )]
    fn fed(
        watch: &mut UnknownLoadWatch,
        start_s: f64,
        seconds: f64,
        sample: impl Fn(f64) -> Sample,
    ) -> Vec<f64> {
        let ticks = (seconds * 1e3) as u64;
        let start_ns = (start_s * 1e9) as u64;
        let samples = (0..ticks).map(|tick| {
            let time_ns = start_ns + tick * 1_000_000;
            Sample { time_ns, ..sample(tick as f64 * 1e-3) }
        });
        samples.filter_map(|sample| watch.see(&sample)).map(|load| load.mass_kg).collect()
    }

    fn pulled(force_n: [f64; 3]) -> Sample {
        let [x, y, z] = force_n;
        Sample {
            mode: Mode::Impedance,
            dq_rad_s: [0.0; 7].into_iter().collect(),
            flange_wrench_world: [x, y, z, 0.0, 0.0, 0.0],
            ..Sample::default()
        }
    }

    #[test]
    fn load_is_named_once_and_again_when_it_changes() {
        let mut watch = UnknownLoadWatch::default();
        let near = |named: &[f64], wanted: &[f64]| {
            assert_eq!(named.len(), wanted.len(), "{named:?}");
            assert!(named.iter().zip(wanted).all(|(one, other)| (one - other).abs() < 1e-9), "{named:?}");
        };
        near(&fed(&mut watch, 0.0, 2.9, |_| pulled([1.0, 0.0, -9.81])), &[]);
        near(&fed(&mut watch, 2.9, 8.0, |_| pulled([1.0, 0.0, -9.81])), &[1.0]);
        near(&fed(&mut watch, 20.0, 9.0, |_| pulled([1.0, 0.0, -1.2 * 9.81])), &[]);
        near(&fed(&mut watch, 40.0, 9.0, |_| pulled([1.0, 0.0, -1.5 * 9.81])), &[1.5]);
        near(&fed(&mut watch, 60.0, 9.0, |_| pulled([0.0; 3])), &[]);
        near(&fed(&mut watch, 80.0, 9.0, |_| pulled([0.0, 0.0, -1.5 * 9.81])), &[1.5]);
        near(&fed(&mut watch, 100.0, 9.0, |_| pulled([0.0, 0.0, 0.5 * 9.81])), &[-0.5]);
    }

    #[test]
    fn push_touch_motion_and_friction_are_no_load() {
        let quiet = |sample: &dyn Fn(f64) -> Sample| {
            let named = fed(&mut UnknownLoadWatch::default(), 0.0, 12.0, sample);
            assert!(named.is_empty(), "{named:?}: {:?}", sample(0.0));
        };
        let load = [0.0, 0.0, -9.81];
        quiet(&|_| pulled([0.0, 0.0, -0.29 * 9.81]));
        quiet(&|_| pulled([5.0, 0.0, -9.81]));
        quiet(&|_| pulled([0.0, 20.0, 0.0]));
        quiet(&|t| pulled([0.0, 0.0, -9.81 + 2.0 * (5.0 * t).sin()]));
        quiet(&|t| pulled([2.0 * (5.0 * t).sin(), 0.0, -9.81]));
        quiet(&|_| Sample { mode: Mode::Ready, ..pulled(load) });
        quiet(&|_| Sample { dq_rad_s: [0.0, 0.0, -0.03].into_iter().collect(), ..pulled(load) });
        quiet(&|_| Sample { dq_rad_s: [].into_iter().collect(), ..pulled(load) });
        let touched = TaxelReading { force_n: 1.0, status: TaxelStatus::Ok };
        quiet(&|_| Sample { taxels: [touched].into_iter().collect(), ..pulled(load) });
        let mut watch = UnknownLoadWatch::default();
        let twitches = |t: f64| {
            let speed_rad_s = if (t % 2.9) < 1e-3 { 0.1 } else { 0.0 };
            Sample { dq_rad_s: [speed_rad_s].into_iter().collect(), ..pulled(load) }
        };
        assert!(fed(&mut watch, 0.0, 12.0, twitches).is_empty(), "no window is whole");
    }

    #[test]
    fn load_is_a_sentence_with_its_remedy() {
        let said = |mass_kg| UnknownLoad { mass_kg }.to_string();
        assert!(
            said(1.04).starts_with(
                "unknown load of about 1.0 kg at the flange: tell `mocad gripper grasp` its mass"
            )
        );
        assert!(said(-0.52).starts_with("load lighter than told by about 0.5 kg at the flange: "));
    }
}
