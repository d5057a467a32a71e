//! An ideal cover for experiments: the true force, averaged over a period and held; no bytes, noise, threshold or zero.

use crate::config::TAXELS;
use crate::control::cover::{CoverSource, CoverState};
use crate::control::supervisor::Zero;
use moca_msgs::board::Diagnosis;
use moca_msgs::{CoverReading, TaxelReading, TaxelStatus};
use moca_tactile::cover::EarlyContact;
use std::collections::VecDeque;

/// Averages what [`IdealCover::feel`] is told and shows it in steps.
#[derive(Clone, Debug)]
pub struct IdealCover {
    period_ticks: u64,
    delay_ticks: usize,
    sum_n: [f64; TAXELS],
    summed: u64,
    held: [f64; TAXELS],
    delayed: VecDeque<[f64; TAXELS]>,
    frames: u64,
}

impl IdealCover {
    /// A new value every `period_ticks` (0 is taken as 1), shown `delay_ticks` later.
    pub fn new(period_ticks: u64, delay_ticks: usize) -> Self {
        Self {
            period_ticks: period_ticks.max(1),
            delay_ticks,
            sum_n: [0.0; TAXELS],
            summed: 0,
            held: [0.0; TAXELS],
            delayed: VecDeque::with_capacity(delay_ticks + 1),
            frames: 0,
        }
    }

    /// Tells it the true forces of one tick, N.
    pub fn feel(&mut self, force_n: [f64; TAXELS]) {
        for (sum, force) in self.sum_n.iter_mut().zip(force_n) {
            *sum += force;
        }
        self.summed += 1;
        if self.summed == self.period_ticks {
            #[expect(clippy::cast_precision_loss, reason = "a small count")]
            let mean = self.sum_n.map(|sum| sum / self.summed as f64);
            self.held = mean;
            (self.sum_n, self.summed) = ([0.0; TAXELS], 0);
            self.frames += 1;
        }
        self.delayed.push_back(self.held);
        if self.delayed.len() > self.delay_ticks + 1 {
            self.delayed.pop_front();
        }
    }
}

impl CoverSource for IdealCover {
    fn read(&mut self, now_ns: u64) -> CoverState {
        let shown = if self.delayed.len() > self.delay_ticks { self.delayed[0] } else { [0.0; TAXELS] };
        let taxels = shown.map(|force_n| TaxelReading { force_n, status: TaxelStatus::Ok });
        CoverState {
            reading: CoverReading { taxels, sampled_at_ns: Some(now_ns) },
            forces: Ok(shown),
            early: EarlyContact { touched: [false; TAXELS], sampled_at_ns: Some(now_ns) },
            fault: None,
            zero: Zero::Valid,
            counts: [0; TAXELS],
            board: Diagnosis::Frames,
            frames_good: self.frames + 1,
            frames_bad: 0,
            rate_hz: 0.0,
        }
    }

    fn start_tare(&mut self, _now_ns: u64) {}
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn it_averages_over_its_period_and_holds() {
        let mut cover = IdealCover::new(2, 0);
        let mut shown = Vec::new();
        for force_n in [2.0, 4.0, 6.0, 8.0, 0.0] {
            cover.feel([force_n; TAXELS]);
            shown.push(cover.read(0).reading.taxels[3].force_n);
        }
        assert_eq!(shown, [0.0, 3.0, 3.0, 7.0, 7.0]);
    }

    #[test]
    fn a_delay_shows_the_same_values_later() {
        let (mut now, mut late) = (IdealCover::new(2, 0), IdealCover::new(2, 3));
        let mut shown = (Vec::new(), Vec::new());
        for i in 0..20 {
            let force_n = [f64::from(i); TAXELS];
            now.feel(force_n);
            late.feel(force_n);
            shown.0.push(now.read(0).reading.taxels[0].force_n);
            shown.1.push(late.read(0).reading.taxels[0].force_n);
        }
        assert_eq!(shown.0[..17], shown.1[3..]);
    }
}
