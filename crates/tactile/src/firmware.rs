//! Firmware of a board: it decides rate and age of the data, and a calibration is bound to it.

/// Worst age of FDAT when a stock board reads it over I²C, ns: 4.5 from the middle of the window to its last sample, 10 until
/// the next refresh, and the time of a scan.
pub const STOCK_CHIP_AGE_WORST_NS: u64 = 15_000_000;
/// The shortest time from the stamp, taken when the board begins to read the chip, to the arrival of the line: I²C read,
/// end of the text, packet. Measured in the firmware's simulation: `crates/firmware-sim`, `firmware-sim latency`.
pub const LEAST_TRANSPORT_NS: u64 = 1_200_000;

/// Firmware of a board.
///
/// ```
/// use moca_tactile::Firmware;
///
/// assert_eq!(Firmware::named("stock-2018"), Some(Firmware::Stock2018));
/// assert!(Firmware::Moca.worst_hold_ns() < 10_000_000, "a fifth of a stock board's");
/// assert!(Firmware::Stock2018.worst_hold_ns() > 55_000_000);
/// ```
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub enum Firmware {
    /// Our own, `firmware/moca_touch`: every refresh of the chip, stamped and checked.
    Moca,
    /// Stock DataStream of 2018–2020: 26 more I²C reads a frame, about 40.5 frames/s.
    Stock2018,
    /// Stock DataStream of 2015–2018: thresholds are not read back, about 67.5 frames/s, no auto-configuration.
    Stock2015,
    /// Pi Cap: 12 columns.
    PiCap,
}

moca_msgs::choice!(Firmware {
    Moca: "moca",
    Stock2018: "stock-2018",
    Stock2015: "stock-2015",
    PiCap: "pi-cap",
});

impl Firmware {
    /// Every firmware that is known.
    pub const ALL: [Self; 4] = [Self::Moca, Self::Stock2018, Self::Stock2015, Self::PiCap];

    /// Name in configurations and calibration files.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Moca => "moca",
            Self::Stock2018 => "stock-2018",
            Self::Stock2015 => "stock-2015",
            Self::PiCap => "pi-cap",
        }
    }

    /// The firmware with this name.
    pub fn named(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|firmware| firmware.name() == name)
    }

    /// Nominal time between two frames, ns. The real one is measured, never assumed. The Pi Cap's is not known; it is
    /// taken as the older stock sketch's.
    pub const fn frame_period_ns(self) -> u64 {
        match self {
            Self::Moca => 4_000_000,
            Self::Stock2015 | Self::PiCap => 14_800_000,
            Self::Stock2018 => 24_700_000,
        }
    }

    /// Worst time from a sample to the arrival of the next frame's data, ns: its age when it is read, the way of the
    /// line (of a stock board the `FDAT` line) to the host, and the interval. What a board is told to be capable of
    /// before it was measured; `moca-lab latency` measures it.
    pub const fn worst_hold_ns(self) -> u64 {
        match self {
            // 2.5 old when read, 1.2 and up to one poll on the way, reads 4 or 5 ms apart
            Self::Moca => 2_500_000 + LEAST_TRANSPORT_NS + 1_000_000 + 5_000_000,
            Self::Stock2018 | Self::Stock2015 | Self::PiCap => {
                let offset_ns = self.line_offset_ns();
                STOCK_CHIP_AGE_WORST_NS + offset_ns[3] + self.frame_period_ns()
            }
        }
    }

    /// When the end of each line of a stock frame reaches the host after the chip's data was read over I²C, ns. For
    /// 2018–2020 traced from the firmware (FDAT 16 ms, DIFF 20 ms); for the others inferred from the same print speed,
    /// 2 ms a line. Of our own firmware's one line, each entry says when that one comes.
    pub const fn line_offset_ns(self) -> [u64; 6] {
        match self {
            Self::Moca => [LEAST_TRANSPORT_NS; 6],
            Self::Stock2015 | Self::PiCap => {
                [2_000_000, 4_000_000, 6_000_000, 8_000_000, 10_000_000, 12_000_000]
            }
            Self::Stock2018 => [2_000_000, 8_000_000, 14_000_000, 16_000_000, 18_000_000, 20_000_000],
        }
    }
}
