//! The newest state of the robot, as every page sees it.

use moca_msgs::Sample;
use moca_telemetry::{RobotDescription, calibration::CalibrationProgress, net::Commander};
use std::{collections::VecDeque, sync::Arc, time::Duration};
use tokio::time::Instant;

/// State older than this is not shown as live.
pub(crate) const FRESH: Duration = Duration::from_millis(200);
/// Batches whose largest forces are kept for pages that have not drawn them: 0.6 s.
const KNOCKS_MAX: usize = 64;

/// Largest forces of one batch, N, T1 first.
#[derive(Clone, Debug)]
struct Knock {
    number: u64,
    force_n: Vec<f64>,
}

/// The newest state.
#[derive(Clone, Debug, Default)]
pub(crate) struct Look {
    /// The robot, `None` while the daemon is away.
    pub(crate) robot: Option<Arc<RobotDescription>>,
    /// Why the daemon is away.
    pub(crate) why: String,
    /// The newest sample.
    pub(crate) sample: Sample,
    /// When it came.
    pub(crate) at: Option<Instant>,
    /// Counts stops, asked for and seen: a press that began before the newest one arms nothing.
    pub(crate) stops: u64,
    /// Number of the newest stop that the daemon has answered.
    pub(crate) stop_answered: u64,
    /// Progress of a calibration.
    pub(crate) calibration: CalibrationProgress,
    /// Notices of the daemon to its owner, newest last.
    pub(crate) notice: String,
    /// Holder of the command as the gateway's watching connection sees it.
    pub(crate) commander: Commander,
    knocks: VecDeque<Knock>,
    batches: u64,
}

impl Look {
    /// Tells if the newest sample may be shown as live.
    pub(crate) fn is_fresh(&self, now: Instant) -> bool {
        self.robot.is_some() && self.at.is_some_and(|at| now.saturating_duration_since(at) < FRESH)
    }

    /// Tells if a law moves the robot.
    pub(crate) fn moves(&self) -> bool {
        self.robot.is_some() && self.sample.mode.moves()
    }

    /// Takes a batch: the newest sample, and the largest force of each taxel in any of them.
    pub(crate) fn take(&mut self, samples: &[Sample], now: Instant) {
        let Some(newest) = samples.last() else { return };
        let mut force_n = vec![0.0_f64; newest.taxels.len()];
        for sample in samples {
            for (most, taxel) in force_n.iter_mut().zip(&sample.taxels) {
                *most = most.max(taxel.force_n);
            }
        }
        self.batches += 1;
        self.knocks.push_back(Knock { number: self.batches, force_n });
        if self.knocks.len() > KNOCKS_MAX {
            self.knocks.pop_front();
        }
        self.sample.clone_from(newest);
        self.at = Some(now);
    }

    /// Largest force of each taxel in the batches after number `since`, N, and the newest batch's number: a knock must not
    /// fall between two pictures.
    pub(crate) fn force_since(&self, since: u64) -> (u64, Vec<f64>) {
        let mut force_n: Vec<f64> = self.sample.taxels.iter().map(|taxel| taxel.force_n).collect();
        for knock in self.knocks.iter().filter(|knock| knock.number > since) {
            for (most, force) in force_n.iter_mut().zip(&knock.force_n) {
                *most = most.max(*force);
            }
        }
        (self.batches, force_n)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use moca_msgs::{TaxelReading, TaxelStatus};

    fn sample(force_n: f64) -> Sample {
        let mut sample = Sample::default();
        sample.taxels.extend([TaxelReading { force_n, status: TaxelStatus::Ok }; 2]);
        sample
    }

    #[test]
    fn knock_of_5_ms_between_two_pictures_shows_its_peak() {
        let mut look = Look::default();
        let quiet: Vec<Sample> = (0..10).map(|_| sample(0.0)).collect();
        let mut knocked = quiet.clone();
        knocked[3..8].fill(sample(80.0));
        look.take(&quiet, Instant::now());
        let (first, force_n) = look.force_since(0);
        assert_eq!(force_n, [0.0, 0.0]);
        look.take(&knocked, Instant::now());
        look.take(&quiet, Instant::now());
        let (second, force_n) = look.force_since(first);
        assert_eq!(force_n, [80.0, 80.0]);
        assert_eq!(look.force_since(second).1, [0.0, 0.0], "and only once");
    }

    #[test]
    fn state_of_an_absent_or_silent_daemon_is_never_fresh() {
        let now = Instant::now();
        let mut look = Look { at: Some(now), ..Look::default() };
        assert!(!look.is_fresh(now), "no daemon");
        look.robot = Some(Arc::default());
        assert!(look.is_fresh(now));
        assert!(!look.is_fresh(now + FRESH));
    }
}
