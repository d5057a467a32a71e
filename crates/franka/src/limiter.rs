//! The last limit before a torque leaves this PC: no change that the arm would take for a jump, whatever was lost on the way.
//!
//! The arm compares each torque with the last one that *reached* it. Which that was, its state says; but an order that was
//! sent in answer to the state before may still arrive in between. So an order stays near both.
//!
//! ```
//! use moca_franka::limiter::{TorqueLimiter, CHANGE_NM};
//!
//! let mut limiter = TorqueLimiter::new();
//! let sent = limiter.limit(&[5.0; 7], &[0.0; 7]);
//! assert_eq!(sent, [CHANGE_NM; 7]);
//! // It was lost: the arm still has 0 N·m.
//! assert_eq!(limiter.limit(&[5.0; 7], &[0.0; 7]), [CHANGE_NM; 7]);
//! assert_eq!(limiter.limit(&[f64::NAN; 7], &[0.0; 7]), [CHANGE_NM; 7], "no number: the last one again");
//! ```

use crate::JOINTS;

/// Largest change that the arm takes from one millisecond to the next, N·m (1000 N·m/s).
pub const ARM_CHANGE_NM: f64 = 1.0;
/// Largest change that is sent, N·m: the arm's state is in single precision.
pub const CHANGE_NM: f64 = 0.99;

/// Remembers what was sent last.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct TorqueLimiter {
    last: Option<[f64; JOINTS]>,
}

impl TorqueLimiter {
    /// Nothing has been sent yet.
    pub const fn new() -> Self {
        Self { last: None }
    }

    /// `wanted` N·m without gravity, as near as it may come: no further than [`CHANGE_NM`] from `received`, the torque that
    /// the arm says it has (its `tau_J_d`), and from the last one sent. What is not a number changes nothing.
    pub fn limit(&mut self, wanted: &[f64; JOINTS], received: &[f64; JOINTS]) -> [f64; JOINTS] {
        let last = self.last.unwrap_or(*received);
        let sent = core::array::from_fn(|i| {
            let (has, sent) = (received[i], last[i]);
            if !has.is_finite() {
                return sent;
            }
            let wanted = if wanted[i].is_finite() { wanted[i] } else { sent };
            let (low, high) = (has.max(sent) - CHANGE_NM, has.min(sent) + CHANGE_NM);
            // They are apart only if the arm has what was never sent: then its own word counts.
            if low <= high { wanted.clamp(low, high) } else { wanted.clamp(has - CHANGE_NM, has + CHANGE_NM) }
        });
        self.last = Some(sent);
        sent
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// SplitMix64.
    struct Random(u64);

    impl Random {
        fn bits(&mut self) -> u64 {
            self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
            let mut z = self.0;
            z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
            z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
            z ^ (z >> 31)
        }

        fn below(&mut self, limit: u64) -> u64 {
            self.bits() % limit
        }

        fn torque(&mut self) -> f64 {
            #[expect(clippy::cast_precision_loss, reason = "a random number")]
            let unit = (self.bits() >> 11) as f64 / (1_u64 << 53) as f64;
            match self.below(100) {
                0 => f64::NAN,
                1 => f64::INFINITY,
                _ => 174.0 * (unit - 0.5),
            }
        }
    }

    /// An arm that judges each torque by the last that reached it, on a line that loses one to three datagrams in a row in
    /// either direction and delivers orders a period late.
    struct Line {
        arm_nm: [f64; JOINTS],
        late: Option<[f64; JOINTS]>,
        states_lost: u64,
        orders_lost: u64,
        worst_nm: f64,
        taken: u64,
    }

    impl Line {
        fn arrive(&mut self, torque: [f64; JOINTS]) {
            for (now, torque) in self.arm_nm.iter_mut().zip(torque) {
                self.worst_nm = self.worst_nm.max((torque - *now).abs());
                *now = torque;
            }
            self.taken += 1;
        }

        fn lost(left: &mut u64, random: &mut Random) -> bool {
            if *left == 0 && random.below(10) == 0 {
                *left = 1 + random.below(3);
            }
            let lost = *left > 0;
            *left = left.saturating_sub(1);
            lost
        }

        fn tick(&mut self, limiter: &mut TorqueLimiter, random: &mut Random) {
            // The state is made before an order that is late arrives.
            #[expect(clippy::cast_possible_truncation, reason = "as on the wire")]
            let said = self.arm_nm.map(|torque| f64::from(torque as f32));
            if let Some(late) = self.late.take() {
                self.arrive(late);
            }
            if Self::lost(&mut self.states_lost, random) {
                return;
            }
            let wanted = core::array::from_fn(|_| random.torque());
            let sent = limiter.limit(&wanted, &said);
            assert!(sent.iter().all(|torque| torque.is_finite()));
            match (Self::lost(&mut self.orders_lost, random), random.below(8)) {
                (true, _) => {}
                (false, 0) => self.late = Some(sent),
                (false, _) => self.arrive(sent),
            }
        }
    }

    fn run(ticks: u64) -> Line {
        let (mut limiter, mut random) = (TorqueLimiter::new(), Random(17));
        let mut line = Line {
            arm_nm: [0.0; JOINTS],
            late: None,
            states_lost: 0,
            orders_lost: 0,
            worst_nm: 0.0,
            taken: 0,
        };
        for _ in 0..ticks {
            line.tick(&mut limiter, &mut random);
        }
        line
    }

    /// `cargo test --release -p moca-franka -- --ignored --nocapture` runs ten million.
    #[test]
    fn no_torque_that_reaches_the_arm_is_a_jump_whatever_is_lost() {
        let line = run(200_000);
        assert!(line.worst_nm <= ARM_CHANGE_NM, "{} N·m in a millisecond", line.worst_nm);
        assert!(line.taken > 100_000 && line.worst_nm > 0.9 * ARM_CHANGE_NM, "a line that shows nothing");
    }

    #[test]
    #[ignore = "ten million ticks: for a release build"]
    fn ten_million_ticks() {
        let line = run(10_000_000);
        println!("{} orders arrived; largest change {:.6} N·m", line.taken, line.worst_nm);
        assert!(line.worst_nm <= ARM_CHANGE_NM, "{} N·m in a millisecond", line.worst_nm);
    }

    #[test]
    fn arm_with_unsent_torque_is_followed_from_it() {
        let mut limiter = TorqueLimiter::new();
        limiter.limit(&[0.0; JOINTS], &[0.0; JOINTS]);
        let sent = limiter.limit(&[0.0; JOINTS], &[10.0; JOINTS]);
        assert!(sent.iter().all(|torque| (torque - (10.0 - CHANGE_NM)).abs() < 1e-12), "{sent:?}");
    }
}
