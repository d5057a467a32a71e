//! Readings of a foam that recovers: what a taxel still shows after a lean is not a hand. Pure.
//!
//! A foam that was pressed for long stays compressed for seconds after the hand has gone. Its taxel then reads an eighth
//! of the force that has left, and would go on moving the base. Of each taxel the law therefore remembers what may be left:
//!
//! ṁ = (ρ·f − m)/T,   T = 2 s where m rises, 30 s where it falls, ρ = 0.2,
//!
//! and gives way to f from 2·m on, to nothing below m, and to 2·(f − m) in between, which is continuous. A hand that holds is far
//! above: f is 1/ρ times m. A hand that comes within seconds of another one's lean moves the base later, at m. Only the law
//! reads this. Barrier, speed limit and reactions, which slow the base and stop it, take every reading for a hand.
//!
//! ```
//! use moca_control::foam_recovery::FoamRecovery;
//!
//! let mut recovery = FoamRecovery::default();
//! let mut lean = [0.0; moca_control::robot::TAXELS];
//! lean[5] = 100.0;
//! for _ in 0..60_000 {
//!     assert!(recovery.felt(&lean, 1e-3) == lean, "who leans is felt");
//! }
//! lean[5] = 9.0;
//! assert!(recovery.felt(&lean, 1e-3) == [0.0; moca_control::robot::TAXELS], "who has gone is not");
//! ```

use crate::robot::TAXELS;
use serde::{Deserialize, Serialize};

/// ρ: share of a force that a foam may show after it, above its relaxing part (PU LD30: 0.186). Of a minute's lean of 100 N the
/// simulated one shows 0.127 within 50 ms and 0.063 after 2 s.
const SHARE: f64 = 0.2;
/// Time constants with which it comes and goes, s: faster and slower than the foam's own (ASSUMED: 2 s and 20 s), as what is left
/// is read with the board's noise.
const FILLS_S: f64 = 2.0;
const EMPTIES_S: f64 = 30.0;

/// Largest remains of past forces on each taxel, N.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct FoamRecovery {
    #[serde(with = "serde_big_array::BigArray")]
    left_n: [f64; TAXELS],
}

impl Default for FoamRecovery {
    fn default() -> Self {
        Self { left_n: [0.0; TAXELS] }
    }
}

impl FoamRecovery {
    /// Forces that a law gives way to, N, of those that the cover reads, N, `dt_s` s after the last ones.
    pub fn felt(&mut self, read_n: &[f64; TAXELS], dt_s: f64) -> [f64; TAXELS] {
        std::array::from_fn(|i| {
            let (read, left) = (read_n[i], &mut self.left_n[i]);
            let wanted = SHARE * read.max(0.0);
            let time_s = if wanted > *left { FILLS_S } else { EMPTIES_S };
            *left += (wanted - *left) * (dt_s / time_s).clamp(0.0, 1.0);
            read.min((2.0 * (read - *left)).max(0.0))
        })
    }
}

#[cfg(test)]
#[expect(clippy::float_cmp, reason = "no rounding: forces as they came, and zeros")]
mod tests {
    use super::*;

    fn on_first(force_n: f64) -> [f64; TAXELS] {
        std::array::from_fn(|i| if i == 0 { force_n } else { 0.0 })
    }

    /// After `lean_s` s of 100 N, `gone_s` s after them.
    fn after(lean_s: usize, gone_s: usize) -> FoamRecovery {
        let mut recovery = FoamRecovery::default();
        for (force_n, seconds) in [(100.0, lean_s), (0.0, gone_s)] {
            for _ in 0..1000 * seconds {
                let _ = recovery.felt(&on_first(force_n), 1e-3);
            }
        }
        recovery
    }

    #[test]
    fn untouched_cover_feels_every_force_as_it_is() {
        let forces = std::array::from_fn(|i| if i % 2 == 0 { 0.7 + i as f64 } else { 0.0 });
        assert_eq!(FoamRecovery::default().felt(&forces, 1e-3), forces);
    }

    #[test]
    fn remains_of_a_lean_are_dropped_while_the_foam_recovers() {
        for (gone_s, left_n) in [(0, 19.9), (2, 18.6), (10, 14.2)] {
            let recovery = after(60, gone_s);
            assert!(recovery.left_n[0] > left_n && recovery.left_n[0] < 20.0, "{gone_s} s: {recovery:?}");
            let mut low = recovery;
            assert_eq!(low.felt(&on_first(left_n), 1e-3), [0.0; TAXELS], "{gone_s} s");
            let mut high = recovery;
            assert_eq!(high.felt(&on_first(2.1 * left_n), 1e-3), on_first(2.1 * left_n), "{gone_s} s");
        }
        let mut between = after(60, 0);
        let [felt, ..] = between.felt(&on_first(25.0), 1e-3);
        assert!((felt - 10.0).abs() < 0.1, "{felt}");
    }

    #[test]
    fn knock_leaves_hardly_anything() {
        let mut recovery = FoamRecovery::default();
        for _ in 0..50 {
            assert_eq!(recovery.felt(&on_first(100.0), 1e-3), on_first(100.0));
        }
        assert!(recovery.left_n[0] < 0.55, "{recovery:?}");
        assert!(after(60, 180).left_n[0] < 0.06, "all is forgotten");
    }

    #[test]
    fn force_below_zero_and_a_stall_do_no_harm() {
        let mut recovery = after(60, 0);
        assert_eq!(recovery.felt(&on_first(-1.0), 1e9), on_first(-1.0));
        assert!(recovery.left_n.iter().all(|left| (0.0..20.0).contains(left)), "{recovery:?}");
    }
}
