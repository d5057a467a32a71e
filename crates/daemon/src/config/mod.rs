//! Configuration: one documented TOML file, every mistake reported at once with its line, value, unit and range.

pub mod contact_limits;
pub mod schema;

use crate::runtime::realtime::Wishes;
use moca_msgs::robot::{ArmTable, FR3, MOCA_MOUNT, Mount, PANDA, PAPER_COVER, TaxelPlacement};
use moca_msgs::{ContactReaction, Corrections, ImpedanceGains, Law, Limits, Parameters};
use moca_tactile::CoverConfig;
use moca_tactile::calibration::CalibrationFile;
use moca_tactile::calibration::file::FileError;
use moca_tactile::cover::MaskPolicy;
use serde::{Deserialize, Serialize};
use std::fmt;
use std::net::SocketAddr;
use std::path::Path;
use toml::Spanned;
use toml::de::{DeTable, DeValue};

/// Joints of the arm this daemon drives.
pub const JOINTS: usize = 7;
/// Taxels of the cover this daemon reads.
pub const TAXELS: usize = 11;
/// `board.port` of the virtual Touch Board.
pub const VIRTUAL_PORT: &str = "virtual";
/// `board.port` that looks for a Touch Board's USB id.
pub(crate) const AUTO_PORT: &str = "auto";
/// The documented default configuration.
pub const DEFAULT_TOML: &str = include_str!("../../config/mocad.toml");

/// Everything that can be configured; see `config/mocad.toml` for units and ranges.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
#[expect(
    missing_docs,
    reason = "each field is documented once, in config/mocad.toml, and a test keeps the two together"
)]
pub struct Config {
    pub robot: String,
    #[serde(rename = "loop")]
    pub control_loop: LoopConfig,
    pub realtime: RealtimeConfig,
    pub plant: PlantConfig,
    pub geometry: GeometryConfig,
    pub board: BoardConfig,
    pub startup: StartupConfig,
    pub control: ControlConfig,
    pub limits: LimitsConfig,
    pub protection: ProtectionConfig,
    pub telemetry: TelemetryConfig,
    pub flight_recorder: FlightRecorderConfig,
    pub simulation: SimulationConfig,
}

macro_rules! section {
    ($(#[$doc:meta])* $name:ident { $($field:ident : $type:ty = $default:expr),* $(,)? }) => {
        $(#[$doc])*
        #[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
        #[serde(default, deny_unknown_fields)]
        #[expect(missing_docs, reason = "each field is documented once, in config/mocad.toml, and a test keeps the two together")]
        pub struct $name { $(pub $field: $type),* }

        impl Default for $name {
            fn default() -> Self {
                Self { $($field: $default),* }
            }
        }
    };
}

section! {
    /// `[loop]`
    LoopConfig { rate_hz: u32 = 1000 }
}
section! {
    /// `[realtime]`
    RealtimeConfig { priority: u8 = 80, lock_memory: bool = true, cpu: i32 = -1, dma_latency: bool = true }
}
section! {
    /// `[plant]`
    PlantConfig { kind: PlantKind = PlantKind::Simulated, parts: Parts = Parts::Whole }
}
section! {
    /// `[geometry]`: which arm, and where arm and taxels sit on the base.
    GeometryConfig {
        arm: Arm = Arm::Panda,
        arm_position_m: [f64; 3] = MOCA_MOUNT.position_base_m,
        arm_rpy_rad: [f64; 3] = MOCA_MOUNT.rpy_rad,
        taxel_x_m: [f64; TAXELS] = PAPER_COVER.map(|taxel| taxel.position_base_m[0]),
        taxel_y_m: [f64; TAXELS] = PAPER_COVER.map(|taxel| taxel.position_base_m[1]),
        taxel_inward_rad: [f64; TAXELS] = PAPER_COVER.map(|taxel| taxel.inward_angle_base_rad),
    }
}
section! {
    /// `[board]`
    BoardConfig {
        port: String = VIRTUAL_PORT.into(),
        firmware: FirmwareConfig = FirmwareConfig::Moca,
        name: String = String::new(),
        calibration: String = String::new(),
        masked: Vec<usize> = Vec::new(),
        mask_policy: MaskPolicyConfig = MaskPolicyConfig::Stop,
        gauge: String = String::new(),
        gauge_baud: u32 = 115_200,
    }
}
section! {
    /// `[telemetry]`
    TelemetryConfig { listen: String = moca_telemetry::net::DEFAULT_ADDRESS.into() }
}
section! {
    /// `[flight_recorder]`
    FlightRecorderConfig { folder: String = crate::record::flight_recorder::AUTO_FOLDER.into() }
}
section! {
    /// `[startup]`
    StartupConfig { law: Law = Law::Impedance, tare: bool = true, arm: bool = true }
}
section! {
    /// `[control]`
    ControlConfig { gains: GainsConfig = GainsConfig::default(), corrections: CorrectionsConfig = CorrectionsConfig::default() }
}
section! {
    /// `[control.gains]`
    GainsConfig {
        virtual_mass: [f64; 3] = ImpedanceGains::PAPER.virtual_mass,
        virtual_damping: [f64; 3] = ImpedanceGains::PAPER.virtual_damping,
        stiffness: [f64; 6] = ImpedanceGains::PAPER.stiffness,
        damping_ratio: f64 = ImpedanceGains::PAPER.damping_ratio,
        eta_base: f64 = ImpedanceGains::PAPER.eta_base,
        eta_arm: f64 = ImpedanceGains::PAPER.eta_arm,
        posture_stiffness: [f64; JOINTS] = ImpedanceGains::PAPER.posture_stiffness,
        posture_damping: [f64; JOINTS] = ImpedanceGains::PAPER.posture_damping,
        posture_rad: [f64; JOINTS] = ImpedanceGains::PAPER.posture_rad,
        reactivity: f64 = ImpedanceGains::PAPER.reactivity,
    }
}
section! {
    /// `[control.corrections]`: on where a user is better served; the paper's experiments switch them off.
    CorrectionsConfig { null_space_damping: bool = true, base_coupling: bool = true, flange_feed: bool = false }
}
section! {
    /// `[limits]`
    LimitsConfig {
        torque_nm: [f64; JOINTS] = Limits::PANDA_ON_SUMMIT.torque_nm,
        torque_rate_nm_s: f64 = Limits::PANDA_ON_SUMMIT.torque_rate_nm_s,
        base_velocity: [f64; 3] = Limits::PANDA_ON_SUMMIT.base_velocity,
        base_acceleration: [f64; 3] = Limits::PANDA_ON_SUMMIT.base_acceleration,
        taxel_force_n: f64 = Limits::PANDA_ON_SUMMIT.taxel_force_n,
    }
}
section! {
    /// `[protection]`
    ProtectionConfig {
        force_limit_n: f64 = 25.0,
        unfelt_force_n: f64 = 5.2,
        contact_stiffness_n_m: f64 = 7783.0,
        contact_travel_m: f64 = 0.0031,
        assessed_forces_n: Vec<f64> = vec![25.0, 65.0, 130.0, 260.0],
        override_speed_limit_m_s: f64 = 0.0,
        override_statement: String = String::new(),
        thresholds: String = String::new(),
        reaction: ContactReaction = ContactReaction::StopDirection,
        slow_m_s: f64 = 0.01,
        retreat_m_s: f64 = 0.05,
        retreat_m: f64 = 0.10,
    }
}
section! {
    /// `[simulation]`
    SimulationConfig { seed: u64 = 1, hand: HandConfig = HandConfig::default() }
}
section! {
    /// `[simulation.hand]`
    HandConfig { taxels: Vec<usize> = vec![6, 2, 10], force_n: f64 = 20.0, every_s: f64 = 6.0, hold_s: f64 = 2.0 }
}

impl HandConfig {
    /// No scripted hand.
    pub fn none() -> Self {
        Self { taxels: Vec::new(), ..Self::default() }
    }
}

/// What a masked taxel means.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum MaskPolicyConfig {
    /// The robot does not move.
    Stop,
    /// The robot moves without feeling there.
    Unfelt,
}

/// What runs on the virtual Touch Board; a real one is recognised by what it sends.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum FirmwareConfig {
    /// Our own, `firmware/moca_touch`.
    #[serde(rename = "moca")]
    Moca,
    /// DataStream of 2018 to 2020.
    #[serde(rename = "stock-2018")]
    Stock2018,
    /// DataStream of 2015 to 2018.
    #[serde(rename = "stock-2015")]
    Stock2015,
}

impl From<FirmwareConfig> for moca_tactile::Firmware {
    fn from(firmware: FirmwareConfig) -> Self {
        match firmware {
            FirmwareConfig::Moca => Self::Moca,
            FirmwareConfig::Stock2018 => Self::Stock2018,
            FirmwareConfig::Stock2015 => Self::Stock2015,
        }
    }
}

/// Which robot is driven.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum PlantKind {
    /// MuJoCo.
    Simulated,
    /// No robot: the cover alone.
    None,
}

/// Which arm stands on the base: kinematics, inertias and joint ranges.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Arm {
    /// Franka Emika Panda.
    Panda,
    /// Franka Research 3.
    Fr3,
}

/// Which parts the robot has. What it lacks is neither simulated, started nor shown.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Parts {
    /// Base with cover, and arm.
    Whole,
    /// The base with its cover: both laws follow the hand.
    Base,
    /// The arm on a stand, without a cover: both laws hold the flange where it is.
    Arm,
}

impl Parts {
    /// Whether there is a base, and with it a cover.
    pub const fn has_cover(self) -> bool {
        !matches!(self, Self::Arm)
    }

    /// Whether there is an arm.
    pub const fn has_arm(self) -> bool {
        !matches!(self, Self::Base)
    }
}

impl Default for Config {
    fn default() -> Self {
        Self {
            robot: "moca".into(),
            control_loop: LoopConfig::default(),
            realtime: RealtimeConfig::default(),
            plant: PlantConfig::default(),
            geometry: GeometryConfig::default(),
            board: BoardConfig::default(),
            startup: StartupConfig::default(),
            control: ControlConfig::default(),
            limits: LimitsConfig::default(),
            protection: ProtectionConfig::default(),
            telemetry: TelemetryConfig::default(),
            flight_recorder: FlightRecorderConfig::default(),
            simulation: SimulationConfig::default(),
        }
    }
}

impl Config {
    /// Control period, ns.
    pub fn period_ns(&self) -> u64 {
        1_000_000_000 / u64::from(self.control_loop.rate_hz.max(1))
    }

    /// How the cover reads its board: calibration, masks.
    ///
    /// # Errors
    /// A calibration file that cannot be read, is of another board, or does not name every taxel.
    pub fn cover(&self) -> Result<CoverConfig<TAXELS>, FileError> {
        let mut cover = CoverConfig {
            mask_policy: match self.board.mask_policy {
                MaskPolicyConfig::Stop => MaskPolicy::Stop,
                MaskPolicyConfig::Unfelt => MaskPolicy::Unfelt,
            },
            ..CoverConfig::default()
        };
        for &taxel in &self.board.masked {
            if let Some(masked) = taxel.checked_sub(1).and_then(|i| cover.masked.get_mut(i)) {
                *masked = true;
            }
        }
        if !self.board.calibration.is_empty() {
            CalibrationFile::read(Path::new(&self.board.calibration))?.apply(&self.board.name, &mut cover)?;
        }
        Ok(cover)
    }

    /// Where telemetry listens, if anywhere; checked by [`Config::check`].
    pub fn telemetry_address(&self) -> Option<SocketAddr> {
        self.telemetry.listen.parse().ok()
    }

    /// What to ask of the operating system.
    pub fn realtime(&self) -> Wishes {
        let r = &self.realtime;
        Wishes {
            priority: r.priority,
            lock_memory: r.lock_memory,
            cpu: usize::try_from(r.cpu).ok(),
            dma_latency: r.dma_latency,
        }
    }

    /// The arm's table.
    pub const fn arm(&self) -> &'static ArmTable<JOINTS> {
        match self.geometry.arm {
            Arm::Panda => &PANDA,
            Arm::Fr3 => &FR3,
        }
    }

    /// Where the arm sits on the base.
    pub fn mount(&self) -> Mount {
        Mount { position_base_m: self.geometry.arm_position_m, rpy_rad: self.geometry.arm_rpy_rad }
    }

    /// Where the taxels sit on the base, T1 first.
    pub fn taxels(&self) -> [TaxelPlacement; TAXELS] {
        let g = &self.geometry;
        std::array::from_fn(|i| TaxelPlacement {
            position_base_m: [g.taxel_x_m[i], g.taxel_y_m[i]],
            inward_angle_base_rad: g.taxel_inward_rad[i],
        })
    }

    /// The controllers' parameters.
    pub fn parameters(&self) -> Parameters<JOINTS> {
        let g = &self.control.gains;
        let c = &self.control.corrections;
        let l = &self.limits;
        Parameters {
            gains: ImpedanceGains {
                virtual_mass: g.virtual_mass,
                virtual_damping: g.virtual_damping,
                stiffness: g.stiffness,
                damping_ratio: g.damping_ratio,
                eta_base: g.eta_base,
                eta_arm: g.eta_arm,
                posture_stiffness: g.posture_stiffness,
                posture_damping: g.posture_damping,
                posture_rad: g.posture_rad,
                reactivity: g.reactivity,
            },
            corrections: Corrections {
                null_space_damping: c.null_space_damping,
                base_coupling: c.base_coupling,
                flange_feed: c.flange_feed,
            },
            limits: Limits {
                torque_nm: l.torque_nm,
                torque_rate_nm_s: l.torque_rate_nm_s,
                base_velocity: l.base_velocity,
                base_acceleration: l.base_acceleration,
                taxel_force_n: l.taxel_force_n,
                period_s: 1.0 / f64::from(self.control_loop.rate_hz.max(1)),
            },
        }
    }

    /// Reads and checks a file.
    ///
    /// # Errors
    /// Every mistake in it, or why it could not be read.
    pub fn load(path: &Path) -> Result<Self, ConfigError> {
        let text = std::fs::read_to_string(path)
            .map_err(|error| ConfigError { mistakes: vec![format!("{}: {error}", path.display())] })?;
        Self::parse(&text)
    }

    /// Parses and checks a configuration; what it does not name keeps its default.
    ///
    /// # Errors
    /// Every mistake in it, each with its line.
    pub fn parse(text: &str) -> Result<Self, ConfigError> {
        let root = DeTable::parse(text).map_err(|error| ConfigError {
            mistakes: vec![located(text, error.span().map(|s| s.start), error.message())],
        })?;
        let mut mistakes = Vec::new();
        let known = toml::Table::try_from(Self::default())
            .map_err(|error| ConfigError { mistakes: vec![error.to_string()] })?;
        unknown_keys(text, root.get_ref(), &known, "", &mut mistakes);
        if !mistakes.is_empty() {
            return Err(ConfigError { mistakes });
        }
        let config: Self = toml::from_str(text).map_err(|error| ConfigError {
            mistakes: vec![located(text, error.span().map(|s| s.start), error.message())],
        })?;
        config.check(|path, message| {
            let position = position_of(root.get_ref(), path);
            mistakes.push(located(text, position, &message));
        });
        if mistakes.is_empty() { Ok(config) } else { Err(ConfigError { mistakes }) }
    }

    /// Reports every value outside its range as (dotted path, message).
    pub fn check(&self, mut report: impl FnMut(&str, String)) {
        crate::config::schema::check(self, |error| report(error.name, error.to_string()));
        let hand = &self.simulation.hand;
        if hand.hold_s > hand.every_s - PRESS_RAMPS_S {
            let (path, most_s) = ("simulation.hand.hold_s", hand.every_s - PRESS_RAMPS_S);
            report(path, format!("{path} = {} s is longer than every_s - 0.7 = {most_s} s", hand.hold_s));
        }
        crate::control::protection::check(&self.protection, &mut report);
        let listen = &self.telemetry.listen;
        if !listen.is_empty() && !listen.parse::<SocketAddr>().is_ok_and(|address| address.ip().is_loopback())
        {
            report(
                "telemetry.listen",
                format!(
                    "telemetry.listen = {listen:?}; allowed: a loopback address with a port, or \"\" for none"
                ),
            );
        }
        if self.plant.kind == PlantKind::None && self.board.port == VIRTUAL_PORT {
            let allowed = "allowed: \"auto\" or a path when plant.kind = \"none\"";
            report("board.port", format!("board.port = \"virtual\" needs a simulated robot; {allowed}"));
        }
        if self.plant.kind == PlantKind::None && self.plant.parts != Parts::Whole {
            let message = "plant.parts names parts of a robot; plant.kind = \"none\" has none: leave it out";
            report("plant.parts", message.into());
        }
        if !self.plant.parts.has_cover() && self.board.port != VIRTUAL_PORT {
            let message = "board.port: plant.parts = \"arm\" has no cover and reads no board: leave it out";
            report("board.port", message.into());
        }
        if self.board.port.is_empty() {
            report("board.port", "board.port is empty; allowed: \"virtual\", \"auto\" or a path".into());
        }
    }
}

/// What the ramps of a scripted press take, s, with a moment of rest.
const PRESS_RAMPS_S: f64 = 0.7;

/// Every mistake of one file.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ConfigError {
    /// One line each.
    pub mistakes: Vec<String>,
}

impl fmt::Display for ConfigError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}", self.mistakes.join("\n"))
    }
}

impl std::error::Error for ConfigError {}

pub(crate) fn unknown_keys(
    text: &str,
    table: &DeTable<'_>,
    known: &toml::Table,
    path: &str,
    mistakes: &mut Vec<String>,
) {
    for (key, value) in table {
        let name = key.get_ref().as_ref();
        match (known.get(name), value.get_ref()) {
            (None, _) => {
                let allowed: Vec<&str> = known.keys().map(String::as_str).collect();
                let message = format!("unknown key {path}{name}; allowed here: {}", allowed.join(", "));
                mistakes.push(located(text, Some(key.span().start), &message));
            }
            (Some(toml::Value::Table(inner)), DeValue::Table(sub)) => {
                unknown_keys(text, sub, inner, &format!("{path}{name}."), mistakes);
            }
            _ => {}
        }
    }
}

pub(crate) fn position_of(table: &DeTable<'_>, path: &str) -> Option<usize> {
    let (first, rest) = path.split_once('.').map_or((path, None), |(first, rest)| (first, Some(rest)));
    let (key, value): (_, &Spanned<DeValue<'_>>) =
        table.iter().find(|(key, _)| key.get_ref().as_ref() == first)?;
    match (rest, value.get_ref()) {
        (Some(rest), DeValue::Table(sub)) => position_of(sub, rest),
        _ => Some(key.span().start),
    }
}

pub(crate) fn located(text: &str, position: Option<usize>, message: &str) -> String {
    match position {
        Some(position) => {
            let line = 1 + text.bytes().take(position).filter(|&byte| byte == b'\n').count();
            format!("line {line}: {message}")
        }
        None => message.to_owned(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn keys(table: &toml::Table, path: &str, out: &mut Vec<String>) {
        for (key, value) in table {
            match value {
                toml::Value::Table(sub) => keys(sub, &format!("{path}{key}."), out),
                _ => out.push(format!("{path}{key}")),
            }
        }
    }

    #[test]
    fn the_documented_file_names_every_field_and_gives_the_defaults() {
        assert_eq!(Config::parse(DEFAULT_TOML), Ok(Config::default()));
        let (mut documented, mut known) = (Vec::new(), Vec::new());
        keys(&DEFAULT_TOML.parse().unwrap(), "", &mut documented);
        keys(&toml::Table::try_from(Config::default()).unwrap(), "", &mut known);
        documented.sort();
        known.sort();
        assert_eq!(documented, known);
    }

    #[test]
    fn every_mistake_is_reported_with_line_value_and_range() {
        let text = "[loop]\nrate_hz = 5\n[control.gains]\nvirtual_mass = [4.0, nan, 2.0]\neta_base = inf\n";
        let error = Config::parse(text).unwrap_err();
        assert_eq!(
            error.mistakes,
            [
                "line 4: control.gains.virtual_mass = NaN kg is outside 0.01 to 1000 kg",
                "line 5: control.gains.eta_base = inf is outside 0.001 to 1000",
                "line 2: loop.rate_hz = 5 Hz is outside 100 to 10000 Hz",
            ]
        );
    }

    #[test]
    fn unknown_keys_are_all_named_with_what_is_allowed() {
        let error = Config::parse("[board]\nprot = \"x\"\n[loops]\n").unwrap_err();
        assert_eq!(error.mistakes.len(), 2);
        assert!(
            error.mistakes[0].contains(
                "line 2: unknown key board.prot; allowed here: calibration, firmware, gauge, gauge_baud, mask_policy, masked, name, port"
            ),
            "{error}"
        );
        assert!(error.mistakes[1].contains("unknown key loops"), "{error}");
    }

    #[test]
    fn a_wrong_type_and_broken_syntax_name_their_line() {
        assert!(
            Config::parse("\n[loop]\nrate_hz = \"fast\"\n").unwrap_err().mistakes[0].starts_with("line 3:")
        );
        assert!(Config::parse("[loop\n").unwrap_err().mistakes[0].starts_with("line 1:"));
    }

    #[test]
    fn a_file_names_only_what_it_changes() {
        let config = Config::parse("[board]\nport = \"/dev/ttyACM0\"\n").unwrap();
        assert_eq!(config.board.port, "/dev/ttyACM0");
        assert_eq!(config.control, ControlConfig::default());
    }
}
