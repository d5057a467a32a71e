//! Readings of the cover.
//!
//! ```
//! use moca_msgs::{CoverReading, TaxelReading, TaxelStatus};
//!
//! let mut reading = CoverReading::<2>::UNKNOWN;
//! assert_eq!(reading.forces(), Err((0, TaxelStatus::NoZero)), "not known is not zero");
//! reading.taxels = [TaxelReading { force_n: 12.0, status: TaxelStatus::Ok }; 2];
//! reading.sampled_at_ns = Some(1_000_000);
//! assert_eq!(reading.forces(), Ok([12.0; 2]));
//! assert_eq!(reading.age_s(3_000_000), Some(0.002));
//! ```

/// Health of one taxel at one frame. A taxel that is not `Ok` has no force; that is a fault with a policy, never
/// "no contact".
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub enum TaxelStatus {
    /// Reading valid (a force below the contact threshold reads exactly 0 and is still valid).
    Ok,
    /// No valid zero: never tared, or the board was re-enumerated since.
    #[default]
    NoZero,
    /// Reading older than the deadline.
    Stale,
    /// FDAT at an end of its range (0 or 1023).
    Saturated,
    /// Bit-identical for too many frames while its neighbours move.
    Stuck,
    /// Reads as an open electrode: no plate, or a broken wire.
    Dead,
    /// More noise than the calibration was made with.
    Noisy,
    /// Slow drift beyond the budget.
    Drifted,
    /// Taken out of use by the operator.
    Masked,
}

impl TaxelStatus {
    /// Name as shown to users.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Ok => "ok",
            Self::NoZero => "not tared",
            Self::Stale => "stale",
            Self::Saturated => "at its end",
            Self::Stuck => "stuck",
            Self::Dead => "dead",
            Self::Noisy => "noisy",
            Self::Drifted => "drifted",
            Self::Masked => "masked",
        }
    }
}

/// One taxel's reading.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct TaxelReading {
    /// Compression force, N, ≥ 0. Meaningful only if `status` is [`TaxelStatus::Ok`].
    pub force_n: f64,
    /// Health.
    pub status: TaxelStatus,
}

/// The whole cover at one instant: `K` taxels in the order of the cover's table.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CoverReading<const K: usize> {
    /// T1 first.
    pub taxels: [TaxelReading; K],
    /// When the chip sampled the data, ns of loop time; `None` before the first good frame.
    pub sampled_at_ns: Option<u64>,
}

impl<const K: usize> CoverReading<K> {
    /// A cover that has said nothing yet: no zero, no age.
    pub const UNKNOWN: Self =
        Self { taxels: [TaxelReading { force_n: 0.0, status: TaxelStatus::NoZero }; K], sampled_at_ns: None };

    /// Forces in newtons if every taxel is valid, else the first bad taxel (0 = T1) and its status.
    pub fn forces(&self) -> Result<[f64; K], (usize, TaxelStatus)> {
        let mut forces = [0.0; K];
        for (i, taxel) in self.taxels.iter().enumerate() {
            if taxel.status != TaxelStatus::Ok {
                return Err((i, taxel.status));
            }
            forces[i] = taxel.force_n;
        }
        Ok(forces)
    }

    /// Age of the data at `now_ns`, s; `None` before the first good frame.
    pub fn age_s(&self, now_ns: u64) -> Option<f64> {
        #[expect(clippy::cast_precision_loss, reason = "ages are far below 2^53 ns")]
        self.sampled_at_ns.map(|t| now_ns.saturating_sub(t) as f64 * 1e-9)
    }
}
