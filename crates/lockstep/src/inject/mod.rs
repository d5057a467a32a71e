//! Faults on purpose: a seeded injector for tests, for the fault table and for `mocad run --inject NAME@SECONDS`.

mod cable;
mod cable_fault;
mod outside;
mod plant;
mod values;

pub use cable::Cable;
pub use cable_fault::CableFault;
pub use outside::OutsideFault;
pub use plant::{PlantFault, PlantSpoiler};
pub use values::STRUCK_TAXEL;

use moca_control::config::Config;
use moca_control::robot::{GripperKind, PlantKind};
use moca_tactile::Firmware;
use std::str::FromStr;

/// A fault by name.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Named {
    /// As on the command line.
    pub name: &'static str,
    /// Place and kind of the fault.
    pub site: FaultSite,
    /// In words.
    pub text: &'static str,
}

/// Place where a fault strikes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum FaultSite {
    /// Bytes or board, on the way to the loop.
    Cable(CableFault),
    /// The robot's state or its answer to a command.
    Plant(PlantFault),
    /// Disk, sockets, panel or settings.
    Outside(OutsideFault),
    /// The clock: this many control periods are missed at once.
    MissedSlots(u64),
}

macro_rules! named {
    ($($name:literal $site:expr, $text:literal;)*) => {
        /// Every fault that can be injected into a running loop.
        pub const FAULTS: &[Named] = &[$(Named { name: $name, site: $site, text: $text }),*];
    };
}

named! {
    "garbage" FaultSite::Cable(CableFault::Garbage), "random bytes between all lines";
    "torn-line" FaultSite::Cable(CableFault::TornLine), "every line of FDAT loses its second half";
    "byte-lost" FaultSite::Cable(CableFault::ByteLost), "a byte vanishes from one line in six";
    "bit-flipped" FaultSite::Cable(CableFault::BitFlipped), "a bit flips in one line in six";
    "nul-bytes" FaultSite::Cable(CableFault::NulBytes), "runs of zero bytes between lines";
    "no-newline" FaultSite::Cable(CableFault::NoNewline), "digits without an end instead of lines";
    "number-too-large" FaultSite::Cable(CableFault::NumberTooLarge), "FDAT holds a number beyond its range";
    "not-a-number" FaultSite::Cable(CableFault::NotANumber), "FDAT holds NaN";
    "column-missing" FaultSite::Cable(CableFault::ColumnMissing), "every line has a column too few";
    "column-extra" FaultSite::Cable(CableFault::ColumnExtra), "every line has a column too many";
    "line-repeated" FaultSite::Cable(CableFault::LineRepeated), "every line comes twice";
    "line-missing" FaultSite::Cable(CableFault::LineMissing), "no line of baselines any more";
    "touch-sketch" FaultSite::Cable(CableFault::TouchSketch), "the factory sketch's text instead of DataStream";
    "silent" FaultSite::Cable(CableFault::Silent), "the port stays open, no bytes come";
    "unplugged" FaultSite::Cable(CableFault::Unplugged), "the port closes";
    "replugged" FaultSite::Cable(CableFault::Replugged), "the port closes and opens again after 1 s";
    "port-refused" FaultSite::Cable(CableFault::PortRefused), "the port closes, opening it again is denied";
    "host-stall" FaultSite::Cable(CableFault::HostStall), "400 ms of bytes arrive in one burst";
    "frozen" FaultSite::Cable(CableFault::Frozen), "good frames whose values never change";
    "chip-reset" FaultSite::Cable(CableFault::ChipReset), "good frames of zeros; our firmware says that the chip was reset";
    "thresholds" FaultSite::Cable(CableFault::Thresholds), "the touch thresholds change (DataStream only)";
    "slow-board" FaultSite::Cable(CableFault::SlowBoard), "every other frame is missing";
    "taxel-stuck" FaultSite::Cable(CableFault::TaxelStuck), "T4 stays at one value";
    "taxel-dead" FaultSite::Cable(CableFault::TaxelDead), "T4 reads as if its plate were gone";
    "taxel-saturated" FaultSite::Cable(CableFault::TaxelSaturated), "T4 reads 0";
    "taxel-noisy" FaultSite::Cable(CableFault::TaxelNoisy), "T4 jumps by up to 20 counts";
    "taxel-drifting" FaultSite::Cable(CableFault::TaxelDrifting), "T4 drifts by 10 counts/s";
    "common-mode" FaultSite::Cable(CableFault::CommonMode), "every electrode drops by 12 counts at once";
    "joint-nan" FaultSite::Plant(PlantFault::JointNan), "a joint angle is NaN";
    "joint-rate-infinite" FaultSite::Plant(PlantFault::JointRateInfinite), "a joint rate is infinite";
    "joint-jump" FaultSite::Plant(PlantFault::JointJump), "a joint angle jumps by 0.5 rad within a tick";
    "base-nan" FaultSite::Plant(PlantFault::BaseNan), "the base's pose is NaN";
    "base-jump" FaultSite::Plant(PlantFault::BaseJump), "the base's pose jumps by 0.5 m within a tick";
    "plant-lost" FaultSite::Plant(PlantFault::Lost), "the robot stops answering";
    "command-refused" FaultSite::Plant(PlantFault::Refused), "the robot refuses every command";
    "arm-stale" FaultSite::Plant(PlantFault::ArmStale), "the arm's state stops being renewed";
    "base-stale" FaultSite::Plant(PlantFault::BaseStale), "the base's state stops being renewed";
    "missed-slot" FaultSite::MissedSlots(1), "one control period is missed";
    "missed-20-slots" FaultSite::MissedSlots(20), "20 control periods are missed at once";
    "missed-500-slots" FaultSite::MissedSlots(500), "500 control periods are missed at once";
    "disk-full" FaultSite::Outside(OutsideFault::DiskFull), "the disk of the log is full";
    "disk-slow" FaultSite::Outside(OutsideFault::DiskSlow), "each write to the disk of the log takes 10 ms";
    "subscriber-stalled" FaultSite::Outside(OutsideFault::SubscriberStalled), "a telemetry client stops reading";
    "subscriber-gone" FaultSite::Outside(OutsideFault::SubscriberGone), "a telemetry client hangs up";
    "socket-garbage" FaultSite::Outside(OutsideFault::SocketGarbage), "a telemetry client sends random bytes";
    "panel-gone" FaultSite::Outside(OutsideFault::PanelGone), "the panel that armed the robot is gone";
    "parameter-nan" FaultSite::Outside(OutsideFault::ParameterNan), "a virtual mass is set to NaN";
    "parameter-absurd" FaultSite::Outside(OutsideFault::ParameterAbsurd), "a virtual mass is set to 1e12 kg";
}

/// Faults of parts that not every robot has. They stop nothing, so they are not among [`FAULTS`].
pub const OF_PARTS: &[Named] = &[Named {
    name: "gripper-unplugged",
    site: FaultSite::Plant(PlantFault::GripperUnplugged),
    text: "the gripper stops answering",
}];

/// Errors of this program on purpose. They end a run, so they are not among [`FAULTS`], which a run survives.
pub const PANICS: &[Named] = &[
    Named { name: "panic-loop", site: FaultSite::Plant(PlantFault::Panic), text: "the loop's thread panics" },
    Named {
        name: "panic-client",
        site: FaultSite::Outside(OutsideFault::Panic),
        text: "the thread of the clients panics",
    },
];

/// A fault and when it strikes: `NAME@SECONDS`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Injection {
    /// The fault.
    pub fault: Named,
    /// Loop time of the strike, ns.
    pub at_ns: u64,
}

impl FromStr for Injection {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let (name, seconds) = text.split_once('@').ok_or("NAME@SECONDS, for example unplugged@10")?;
        let all = || FAULTS.iter().chain(OF_PARTS).chain(PANICS);
        let fault = all().find(|fault| fault.name == name).ok_or_else(|| {
            let names: Vec<&str> = all().map(|fault| fault.name).collect();
            format!("no fault is called {name:?}; there are: {}", names.join(", "))
        })?;
        let at = seconds.parse().map_err(|error: std::num::ParseFloatError| error.to_string());
        let at = at.and_then(|at| {
            std::time::Duration::try_from_secs_f64(at).map_err(|error| format!("{seconds} s: {error}"))
        })?;
        Ok(Self { fault: *fault, at_ns: u64::try_from(at.as_nanos()).map_err(|error| error.to_string())? })
    }
}

impl Named {
    /// Returns true if this fault can strike a run with `config`; another one would change nothing and say nothing.
    fn applies(&self, config: &Config) -> bool {
        let (plant, simulated) = (&config.plant, config.plant.kind == PlantKind::Simulated);
        let ports = &config.board.port;
        match self.site {
            FaultSite::Cable(fault) => {
                let stock = ports.are_simulated()
                    && ports.firmware_program().is_none()
                    && config.board.firmware != Firmware::Moca;
                plant.parts.has_cover() && (stock || fault.is_of_our_firmware())
            }
            FaultSite::Plant(fault) => {
                simulated
                    && (!fault.is_of_arm() || plant.parts.has_arm())
                    && (!fault.is_of_base() || plant.parts.has_cover())
                    && (fault != PlantFault::GripperUnplugged || plant.gripper == GripperKind::Simulated)
            }
            FaultSite::MissedSlots(_) => simulated,
            FaultSite::Outside(_) => true,
        }
    }
}

impl Injection {
    /// Checks that the fault can strike a run with `config`.
    ///
    /// # Errors
    /// It cannot: why, and the faults that can.
    pub fn check(&self, config: &Config) -> Result<(), String> {
        if self.fault.applies(config) {
            return Ok(());
        }
        let why = match self.fault.site {
            FaultSite::Cable(_) if !config.plant.parts.has_cover() => "a robot without a cover has no cable",
            FaultSite::Cable(_) => {
                "our firmware's line carries no thresholds (board.firmware = \"stock-2018\" simulates one that does)"
            }
            _ if config.plant.kind != PlantKind::Simulated => {
                "only a simulated robot can be made to fail (plant.kind)"
            }
            _ => "the robot lacks that part (plant.parts, plant.gripper)",
        };
        let apply =
            FAULTS.iter().chain(OF_PARTS).filter(|fault| fault.applies(config)).map(|fault| fault.name);
        let apply = apply.collect::<Vec<_>>().join(", ");
        Err(format!("--inject {}: {why}; these apply here: {apply}", self.fault.name))
    }
}

/// A small seeded generator (SplitMix64): the same seed spoils the same bytes.
#[derive(Clone, Debug)]
pub struct Random(u64);

impl Random {
    /// A generator of its own for each seed.
    pub const fn new(seed: u64) -> Self {
        Self(seed)
    }

    /// 64 random bits.
    pub const fn bits(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        z ^ (z >> 31)
    }

    /// A random byte.
    pub const fn byte(&mut self) -> u8 {
        self.bits().to_le_bytes()[0]
    }

    /// A number below `limit`; 0 if that is 0.
    pub fn below(&mut self, limit: usize) -> usize {
        let limit = u64::try_from(limit).unwrap_or(u64::MAX).max(1);
        usize::try_from(self.bits() % limit).unwrap_or(0)
    }

    /// True once in `n` times.
    pub fn one_in(&mut self, n: usize) -> bool {
        self.below(n) == 0
    }
}
