//! Settings of a cover: wiring, calibration, masks, thresholds.

use crate::board::MAX_ELECTRODES;
use crate::datastream::ELECTRODES;
use crate::firmware::Firmware;
use crate::model::TaxelModel;
use crate::zero::ExpectedRest;

/// Most boards under one cover.
pub const MAX_BOARDS: usize = 2;
/// Contact begins at this many counts below zero. ASSUMED: about 5 N for PU and 5 σ of the stock noise.
pub const CONTACT_ON_COUNTS: f64 = 4.0;
/// Contact ends below this many counts below zero. ASSUMED.
pub const CONTACT_OFF_COUNTS: f64 = 2.0;

/// Wiring of a taxel.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct Electrode {
    /// 0 is the first board.
    pub board: u8,
    /// 0–11 on the board's own chip; 12–47 on further chips, twelve each, in the order of
    /// [`crate::touchline::LETTERS`].
    pub electrode: u8,
}

impl Electrode {
    /// The chip of its board.
    pub(super) fn bank(self) -> usize {
        usize::from(self.electrode) / ELECTRODES
    }

    /// The electrode of its chip.
    pub(super) fn of_bank(self) -> usize {
        usize::from(self.electrode) % ELECTRODES
    }

    pub(super) fn is_on(self, board: usize, bank: usize) -> bool {
        usize::from(self.board) == board && self.bank() == bank
    }
}

/// Treatment of a taxel that the operator masked.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub enum MaskPolicy {
    /// A masked taxel is a fault: the robot does not move.
    #[default]
    Stop,
    /// The robot moves without feeling there. The taxel still reports [`moca_msgs::TaxelStatus::Masked`].
    Ignore,
}

moca_msgs::choice!(MaskPolicy { Stop: "stop", Ignore: "ignore" });

/// Constant configuration of a cover.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct CoverConfig<const K: usize> {
    /// Number of taxels, at most `K`; entries of the lists below beyond it have no meaning.
    pub taxels: usize,
    /// T1 first. Default: twelve to a board, in order.
    #[cfg_attr(feature = "serde", serde(with = "serde_big_array::BigArray"))]
    pub wiring: [Electrode; K],
    /// Calibration, T1 first.
    #[cfg_attr(feature = "serde", serde(with = "serde_big_array::BigArray"))]
    pub models: [TaxelModel; K],
    /// Taxels out of use.
    #[cfg_attr(feature = "serde", serde(with = "serde_big_array::BigArray"))]
    pub masked: [bool; K],
    /// Meaning of a masked taxel.
    pub mask_policy: MaskPolicy,
    /// Reading at rest of each taxel when it was calibrated; `None` where the model was not measured. A tare elsewhere is refused.
    /// Counts scale with FDAT at rest, so a board that comes up with another gain still reads
    /// newtons.
    #[cfg_attr(feature = "serde", serde(with = "serde_big_array::BigArray"))]
    pub expected_rest: [Option<ExpectedRest>; K],
    /// Firmware that the calibration was made with; another one is a fault.
    pub calibrated_firmware: Option<Firmware>,
    /// Counts below zero at which contact begins.
    pub contact_on_counts: f64,
    /// Counts below zero under which contact ends.
    pub contact_off_counts: f64,
    /// No taxel reads more than this, N: near a plate's end a count is worth hundreds of newtons.
    pub force_max_n: f64,
}

impl<const K: usize> Default for CoverConfig<K> {
    fn default() -> Self {
        let electrode = |i: usize| Electrode {
            board: u8::try_from(i / ELECTRODES).unwrap_or(u8::MAX),
            electrode: u8::try_from(i % ELECTRODES).unwrap_or(u8::MAX),
        };
        Self {
            taxels: K,
            wiring: core::array::from_fn(electrode),
            models: [TaxelModel::default(); K],
            masked: [false; K],
            mask_policy: MaskPolicy::Stop,
            expected_rest: [None; K],
            calibrated_firmware: None,
            contact_on_counts: CONTACT_ON_COUNTS,
            contact_off_counts: CONTACT_OFF_COUNTS,
            force_max_n: f64::INFINITY,
        }
    }
}

/// Why a configuration makes no cover.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum CoverConfigError {
    /// A taxel (0 = T1) on a board or electrode that does not exist, or on one that another taxel has.
    Wiring {
        /// 0 is T1.
        taxel: usize,
    },
    /// Thresholds must satisfy 0 < off ≤ on, in counts.
    Thresholds {
        /// As configured.
        on_counts: f64,
        /// As configured.
        off_counts: f64,
    },
    /// The largest reading must be above 0 N.
    ForceMax(f64),
}

impl core::fmt::Display for CoverConfigError {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        match self {
            Self::Wiring { taxel } => write!(
                f,
                "T{} must have a board (0 to {}) and an electrode (0 to {}) of its own",
                taxel + 1,
                MAX_BOARDS - 1,
                MAX_ELECTRODES - 1
            ),
            Self::Thresholds { on_counts, off_counts } => {
                write!(f, "contact thresholds: 0 < off ≤ on counts, got on {on_counts} and off {off_counts}")
            }
            Self::ForceMax(force_n) => write!(f, "largest reading of a taxel: above 0 N, got {force_n} N"),
        }
    }
}

impl core::error::Error for CoverConfigError {}

impl<const K: usize> CoverConfig<K> {
    /// Which electrodes of which board carry taxels, and how many boards there are.
    pub(super) fn check(&self) -> Result<([[bool; MAX_ELECTRODES]; MAX_BOARDS], usize), CoverConfigError> {
        let (on_counts, off_counts) = (self.contact_on_counts, self.contact_off_counts);
        if !(off_counts > 0.0 && off_counts <= on_counts && on_counts.is_finite()) {
            return Err(CoverConfigError::Thresholds { on_counts, off_counts });
        }
        if self.force_max_n.is_nan() || self.force_max_n <= 0.0 {
            return Err(CoverConfigError::ForceMax(self.force_max_n));
        }
        let mut used = [[false; MAX_ELECTRODES]; MAX_BOARDS];
        let mut board_count = 1;
        for (taxel, wire) in self.wiring.iter().enumerate().take(self.taxels) {
            let board = usize::from(wire.board);
            let slot = used.get_mut(board).and_then(|b| b.get_mut(usize::from(wire.electrode)));
            match slot {
                Some(slot) if !*slot => *slot = true,
                _ => return Err(CoverConfigError::Wiring { taxel }),
            }
            board_count = board_count.max(board + 1);
        }
        Ok((used, board_count))
    }
}
