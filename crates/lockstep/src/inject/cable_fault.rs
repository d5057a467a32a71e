//! The faults of a cable, by name.

/// Fault on the cable.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[expect(missing_docs, reason = "each is described once, in the table of inject/mod.rs")]
pub enum CableFault {
    Garbage,
    TornLine,
    ByteLost,
    BitFlipped,
    NulBytes,
    NoNewline,
    NumberTooLarge,
    NotANumber,
    ColumnMissing,
    ColumnExtra,
    LineRepeated,
    LineMissing,
    TouchSketch,
    Silent,
    Unplugged,
    Replugged,
    PortRefused,
    HostStall,
    Frozen,
    ChipReset,
    Thresholds,
    SlowBoard,
    TaxelStuck,
    TaxelDead,
    TaxelSaturated,
    TaxelNoisy,
    TaxelDrifting,
    CommonMode,
}

impl CableFault {
    /// Returns true if our firmware's line can show this fault: it carries no thresholds.
    pub const fn is_of_our_firmware(self) -> bool {
        !matches!(self, Self::Thresholds)
    }
}
