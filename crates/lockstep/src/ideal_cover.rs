//! An ideal cover for experiments: the true force, averaged over a period and held; no bytes, noise, threshold or zero.

use moca_control::cover::{CoverSource, CoverState};
use moca_control::robot::TAXELS;
use moca_msgs::board::Diagnosis;
use std::collections::VecDeque;

/// Forces averaged over a period.
#[derive(Clone, Copy, Debug)]
struct Mean {
    force_n: [f64; TAXELS],
    /// Middle of the period.
    at_ns: u64,
}

/// Averages what [`IdealCover::take_forces`] is told and shows it in steps.
#[derive(Clone, Debug)]
pub struct IdealCover {
    period_ticks: u64,
    delay_ticks: u64,
    sum_n: [f64; TAXELS],
    /// Sum of the times of the forces summed, ns.
    sum_ns: u128,
    summed: u64,
    ticks: u64,
    /// Means that are not shown yet, each with the tick in which it is.
    late: VecDeque<(u64, Mean)>,
    /// Mean that is shown; before the first the cover counts as untouched, with data of the instant.
    shown: Option<Mean>,
    /// It has not been read yet.
    is_new: bool,
    frames_good: u64,
}

impl IdealCover {
    /// A new value every `period_ticks` (0 is taken as 1), shown `delay_ticks` later.
    pub fn new(period_ticks: u64, delay_ticks: usize) -> Self {
        Self {
            period_ticks: period_ticks.max(1),
            delay_ticks: delay_ticks as u64,
            sum_n: [0.0; TAXELS],
            sum_ns: 0,
            summed: 0,
            ticks: 0,
            late: VecDeque::with_capacity(delay_ticks + 1),
            shown: None,
            is_new: false,
            frames_good: 1,
        }
    }

    /// Tells it the true forces at `now_ns`, N.
    pub fn take_forces(&mut self, now_ns: u64, force_n: &[f64]) {
        for (sum, force) in self.sum_n.iter_mut().zip(force_n) {
            *sum += force;
        }
        self.sum_ns += u128::from(now_ns);
        self.summed += 1;
        self.ticks += 1;
        if self.summed == self.period_ticks {
            #[expect(clippy::cast_precision_loss, reason = "a small count")]
            let force_n = self.sum_n.map(|sum| sum / self.summed as f64);
            let at_ns = u64::try_from(self.sum_ns / u128::from(self.summed)).unwrap_or(u64::MAX);
            self.late.push_back((self.ticks + self.delay_ticks, Mean { force_n, at_ns }));
            (self.sum_n, self.sum_ns, self.summed) = ([0.0; TAXELS], 0, 0);
            self.frames_good += 1;
        }
        if self.late.front().is_some_and(|(tick, _)| *tick <= self.ticks)
            && let Some((_, mean)) = self.late.pop_front()
        {
            (self.shown, self.is_new) = (Some(mean), true);
        }
    }
}

impl CoverSource for IdealCover {
    fn read(&mut self, now_ns: u64, felt: &mut CoverState) {
        (felt.board, felt.frames_good) = (Diagnosis::Frames, self.frames_good);
        let at_ns = self.shown.as_ref().map_or(now_ns, |mean| mean.at_ns);
        felt.poll.reading.sampled_at_ns = Some(at_ns);
        felt.poll.early.sampled_at_ns = Some(at_ns);
        if std::mem::take(&mut self.is_new)
            && let Some(mean) = &self.shown
        {
            for (taxel, &force_n) in felt.poll.reading.taxels.iter_mut().zip(&mean.force_n) {
                taxel.force_n = force_n;
            }
            felt.poll.forces = Ok(mean.force_n);
        }
    }

    fn start_tare(&mut self, _now_ns: u64) {}
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Force on T4 that is felt at `now_ns`, N, and its age, ns.
    fn read(cover: &mut IdealCover, felt: &mut CoverState, now_ns: u64) -> (f64, u64) {
        cover.read(now_ns, felt);
        let reading = &felt.poll.reading;
        (reading.taxels[3].force_n, now_ns - reading.sampled_at_ns.unwrap())
    }

    #[test]
    fn it_averages_over_its_period_and_holds() {
        let (mut cover, mut felt) = (IdealCover::new(2, 0), CoverState::NONE);
        let mut shown = Vec::new();
        for force_n in [2.0, 4.0, 6.0, 8.0, 0.0] {
            cover.take_forces(0, &[force_n; TAXELS]);
            shown.push(read(&mut cover, &mut felt, 0).0);
        }
        assert_eq!(shown, [0.0, 3.0, 3.0, 7.0, 7.0]);
    }

    #[test]
    fn held_mean_ages_from_middle_of_its_period() {
        let (mut cover, mut felt) = (IdealCover::new(3, 2), CoverState::NONE);
        let mut ages_ns = Vec::new();
        for now_ns in (0..10).map(|tick| 1_000 * tick) {
            cover.take_forces(now_ns, &[1.0; TAXELS]);
            ages_ns.push(read(&mut cover, &mut felt, now_ns).1);
        }
        // Complete one tick after its middle and shown two ticks later; nothing has been felt before.
        assert_eq!(ages_ns, [0, 0, 0, 0, 3_000, 4_000, 5_000, 3_000, 4_000, 5_000]);
    }

    #[test]
    fn a_delay_shows_the_same_values_later() {
        let (mut now, mut late) = (IdealCover::new(2, 0), IdealCover::new(2, 3));
        let (mut felt_now, mut felt_late) = (CoverState::NONE, CoverState::NONE);
        let mut shown = (Vec::new(), Vec::new());
        for i in 0..20u32 {
            let force_n = [f64::from(i); TAXELS];
            now.take_forces(u64::from(i), &force_n);
            late.take_forces(u64::from(i), &force_n);
            shown.0.push(read(&mut now, &mut felt_now, u64::from(i)).0);
            shown.1.push(read(&mut late, &mut felt_late, u64::from(i)).0);
        }
        assert_eq!(shown.0[..17], shown.1[3..]);
    }
}
