//! What runs on a board: it decides rate and age of the data, and a calibration is bound to it.

/// Firmware of a board.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Firmware {
    /// Our own, `firmware/moca_touch`: every refresh of the chip, stamped and checked.
    #[default]
    Moca,
    /// Stock DataStream of 2018–2020: 26 more I²C reads a frame, about 40.5 frames/s.
    Stock2018,
    /// Stock DataStream of 2015–2018: thresholds are not read back, about 67.5 frames/s, no auto-configuration.
    Stock2015,
    /// Pi Cap: 12 columns.
    PiCap,
}

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

    /// When the end of each line of a stock frame reaches the host after the chip's data was read over I²C, ns. For
    /// 2018–2020 traced from the firmware (FDAT 16 ms, DIFF 20 ms); for the others inferred from the same print speed,
    /// 2 ms a line. Of our own firmware's one line, each entry says when that one comes.
    pub const fn line_offset_ns(self) -> [u64; 6] {
        match self {
            Self::Moca => [crate::board::LEAST_TRANSPORT_NS; 6],
            Self::Stock2015 | Self::PiCap => {
                [2_000_000, 4_000_000, 6_000_000, 8_000_000, 10_000_000, 12_000_000]
            }
            Self::Stock2018 => [2_000_000, 8_000_000, 14_000_000, 16_000_000, 18_000_000, 20_000_000],
        }
    }
}
