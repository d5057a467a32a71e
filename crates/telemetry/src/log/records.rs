//! The messages of a log that viewers read, one type for each channel. Units and frames as in [`moca_msgs::Sample`];
//! numbers have seven digits, a value that is not finite is `null` and read back as NaN.
//!
//! ```
//! use moca_telemetry::log::records::{Channel, Timing};
//! let message = r#"{"tick": 7, "lateness_s": null, "overruns": 0, "frames_good": 40, "frames_bad": 0}"#;
//! let timing: Timing = serde_json::from_str(message)?;
//! assert_eq!((Timing::TOPIC, timing.tick), ("/timing", 7));
//! assert!(timing.lateness_s.is_nan());
//! # Ok::<(), serde_json::Error>(())
//! ```

use crate::{audit::Asked, ros::message};
use moca_msgs::protection::{ContactKind, ContactPhase};
use moca_msgs::{
    ArmLink, ArmMode, BoardFault, ContactEvent, ContactReaction, Fault, GripperFault, GripperPhase,
    GripperState, Law, Mode, STAGES, Sample, SpeedLimit, SpeedLimitReason, TaxelReading, TaxelStatus,
    board::Diagnosis,
    sample_table,
    target::{TargetKind, TargetPhase, TargetState},
};
use schemars::{JsonSchema, generate::SchemaSettings};
use serde::{Deserialize, Deserializer, Serialize, de::Error};

/// A message with a channel of its own.
pub trait Channel: Serialize + JsonSchema {
    /// Topic of the channel.
    const TOPIC: &'static str;

    /// JSON schema without references, which viewers read best.
    fn schema() -> Result<Vec<u8>, serde_json::Error> {
        let settings = SchemaSettings::draft07().with(|s| s.inline_subschemas = true);
        serde_json::to_vec(&settings.into_generator().into_root_schema_for::<Self>())
    }
}

/// Channels of the Touch Boards' bytes as they came in, the first board's first: one message for
/// each tenth of a second or each read, its time the arrival of the first byte.
pub const SERIAL_TOPICS: [&str; 2] = ["/serial", "/serial/2"];
/// Channel of the daemon's own blocks of what its ticks were given.
pub const REPLAY_TOPIC: &str = "/replay";
/// Channel of what the daemon's loop remembered, in its own form: a log that begins in the middle of a run has it first.
pub const LOOP_STATE_TOPIC: &str = "/loop_state";

/// A number with seven significant digits; what is below a billionth of its unit is nothing.
pub fn seven_digits(value: f64) -> f64 {
    if value.abs() < 1e-9 {
        return 0.0;
    }
    short(value).unwrap_or_else(|| {
        // The text with so many digits is the shortest that reads back to the rounded number.
        format!("{value:.6e}").parse().unwrap_or(value)
    })
}

/// Powers of ten that a double holds exactly, up to what 1e-9 needs.
const TENS: [f64; 17] =
    [1e0, 1e1, 1e2, 1e3, 1e4, 1e5, 1e6, 1e7, 1e8, 1e9, 1e10, 1e11, 1e12, 1e13, 1e14, 1e15, 1e16];

/// Seven digits without a text: a whole number below 10^7 over a power of ten is the double that its text reads back to. `None`
/// where the seventh digit is not certain, or the number is a million or more.
fn short(value: f64) -> Option<f64> {
    let size = value.abs();
    let tens = TENS.iter().find(|tens| size * **tens >= 1e6)?;
    let scaled = size * tens;
    let whole = scaled.round();
    // The product is off by less than a millionth.
    let certain =
        ((scaled - scaled.trunc()) - 0.5).abs() > 1e-6 && (1_000_001.0..9_999_999.0).contains(&scaled);
    certain.then(|| (whole / tens).copysign(value))
}

/// A field of a sample as one column of a record, or two.
trait Columns {
    /// The columns.
    type In;

    fn split(&self) -> Self::In;
    fn join(columns: Self::In) -> Self;

    /// Rounds to the digits of a record.
    fn shorten(&mut self) {}
}

impl Columns for f64 {
    type In = (Self,);

    fn split(&self) -> Self::In {
        (*self,)
    }

    fn join((value,): Self::In) -> Self {
        value
    }

    fn shorten(&mut self) {
        *self = seven_digits(*self);
    }
}

impl Columns for u64 {
    type In = (Self,);

    fn split(&self) -> Self::In {
        (*self,)
    }

    fn join((value,): Self::In) -> Self {
        value
    }
}

impl<const N: usize> Columns for [u32; N] {
    type In = (Self,);

    fn split(&self) -> Self::In {
        (*self,)
    }

    fn join((values,): Self::In) -> Self {
        values
    }
}

impl<const N: usize> Columns for [f64; N] {
    type In = (Self,);

    fn split(&self) -> Self::In {
        (*self,)
    }

    fn join((values,): Self::In) -> Self {
        values
    }

    fn shorten(&mut self) {
        self.iter_mut().for_each(Columns::shorten);
    }
}

impl<const N: usize> Columns for heapless::Vec<f64, N> {
    type In = (Vec<f64>,);

    fn split(&self) -> Self::In {
        (self.to_vec(),)
    }

    fn join((values,): Self::In) -> Self {
        bounded(values)
    }

    fn shorten(&mut self) {
        self.iter_mut().for_each(Columns::shorten);
    }
}

impl<const N: usize> Columns for heapless::Vec<u16, N> {
    type In = (Vec<u16>,);

    fn split(&self) -> Self::In {
        (self.to_vec(),)
    }

    fn join((values,): Self::In) -> Self {
        bounded(values)
    }
}

impl<const N: usize> Columns for heapless::Vec<TaxelReading, N> {
    type In = (Vec<f64>, Vec<TaxelStatus>);

    fn split(&self) -> Self::In {
        self.iter().map(|taxel| (taxel.force_n, taxel.status)).unzip()
    }

    fn join((forces, statuses): Self::In) -> Self {
        bounded(forces.into_iter().zip(statuses).map(|(force_n, status)| TaxelReading { force_n, status }))
    }

    fn shorten(&mut self) {
        self.iter_mut().for_each(|taxel| taxel.force_n.shorten());
    }
}

impl Columns for SpeedLimit {
    type In = (f64, SpeedLimitReason);

    fn split(&self) -> Self::In {
        (self.m_s, self.reason)
    }

    fn join((m_s, reason): Self::In) -> Self {
        Self { m_s, reason }
    }

    fn shorten(&mut self) {
        self.m_s.shorten();
    }
}

impl Columns for Option<Law> {
    type In = (String,);

    fn split(&self) -> Self::In {
        (self.map_or("", |law| Mode::from(law).name()).into(),)
    }

    fn join((name,): Self::In) -> Self {
        [Law::Impedance, Law::FollowMe].into_iter().find(|law| Mode::from(*law).name() == name)
    }
}

impl Columns for Option<ContactReaction> {
    type In = (String,);

    fn split(&self) -> Self::In {
        (name_of(*self),)
    }

    fn join((name,): Self::In) -> Self {
        named(&name)
    }
}

/// As many as a sample holds: a file from elsewhere may have more.
pub(super) fn bounded<T, const N: usize>(values: impl IntoIterator<Item = T>) -> heapless::Vec<T, N> {
    values.into_iter().take(N).collect()
}

/// A column of a record, in which a number that is not finite is `null`.
trait Column: Sized {
    fn read<'de, D: Deserializer<'de>>(d: D) -> Result<Self, D::Error>;
}

macro_rules! plain_columns {
    ($($type:ty),* $(,)?) => { $(
        impl Column for $type {
            fn read<'de, D: Deserializer<'de>>(d: D) -> Result<Self, D::Error> {
                Self::deserialize(d)
            }
        }
    )* };
}

plain_columns!(u64, [u32; STAGES.len()], String, SpeedLimitReason, Vec<u16>, Vec<TaxelStatus>);

impl Column for f64 {
    fn read<'de, D: Deserializer<'de>>(d: D) -> Result<Self, D::Error> {
        scalar(d)
    }
}

impl Column for Vec<f64> {
    fn read<'de, D: Deserializer<'de>>(d: D) -> Result<Self, D::Error> {
        list(d)
    }
}

impl<const N: usize> Column for [f64; N] {
    fn read<'de, D: Deserializer<'de>>(d: D) -> Result<Self, D::Error> {
        array(d)
    }
}

fn column<'de, D: Deserializer<'de>, C: Column>(d: D) -> Result<C, D::Error> {
    C::read(d)
}

/// The record of one group of [`moca_msgs::sample_table`]. Its rows become, one by one, columns of the record and how a field of
/// the sample goes there and back.
macro_rules! record {
    (
        { $(#[$doc:meta])* $field:ident: $type:ty, later; $($rest:tt)* }
        $head:tt [$($columns:tt)*] [$($fields:tt)*]
    ) => {
        record! {
            { $($rest)* } $head
            [$($columns)* { $(#[$doc])* #[serde(default)] $field: $type }] [$($fields)* $field($field)]
        }
    };
    (
        { $(#[$doc:meta])* $field:ident: $type:ty $(, $word:ident)*; $($rest:tt)* }
        $head:tt [$($columns:tt)*] [$($fields:tt)*]
    ) => {
        record! {
            { $($rest)* } $head
            [$($columns)* { $(#[$doc])* $field: $type }] [$($fields)* $field($field)]
        }
    };
    (
        { $(#[$doc:meta])* $field:ident: $type:ty as { $(#[$meta:meta])* $a:ident: $a_type:ty }; $($rest:tt)* }
        $head:tt [$($columns:tt)*] [$($fields:tt)*]
    ) => {
        record! {
            { $($rest)* } $head
            [$($columns)* { $(#[$doc])* $(#[$meta])* $a: $a_type }] [$($fields)* $field($a)]
        }
    };
    (
        {
            $(#[$doc:meta])* $field:ident: $type:ty as {
                $(#[$a_meta:meta])* $a:ident: $a_type:ty,
                $(#[$b_meta:meta])* $b:ident: $b_type:ty
            };
            $($rest:tt)*
        }
        $head:tt [$($columns:tt)*] [$($fields:tt)*]
    ) => {
        record! {
            { $($rest)* } $head
            [$($columns)* { $(#[$a_meta])* $a: $a_type } { $(#[$b_meta])* $b: $b_type }]
            [$($fields)* $field($a, $b)]
        }
    };
    (
        {} { $(#[$record_doc:meta])* $record:ident $topic:literal $ros:literal }
        [$({ $(#[$meta:meta])* $column:ident: $type:ty })*] [$($field:ident($($part:ident),+))*]
    ) => {
        $(#[$record_doc])*
        #[derive(Clone, Debug, Serialize, Deserialize, JsonSchema)]
        pub struct $record {
            /// Tick count.
            pub tick: u64,
            $($(#[$meta])* #[serde(deserialize_with = "column")] pub $column: $type,)*
        }

        impl From<&Sample> for $record {
            fn from(sample: &Sample) -> Self {
                $(let ($($part,)+) = Columns::split(&sample.$field);)*
                Self { tick: sample.tick, $($column),* }
            }
        }

        impl $record {
            /// Gives a sample the fields of this record.
            pub(super) fn give(self, sample: &mut Sample) {
                let Self { tick: _, $($column),* } = self;
                $(sample.$field = Columns::join(($($part,)+));)*
            }

            /// Rounds the fields of this record in a sample.
            pub(super) fn shorten(sample: &mut Sample) {
                $(Columns::shorten(&mut sample.$field);)*
            }
        }

        impl Channel for $record {
            const TOPIC: &'static str = $topic;
        }

        message! { $ros $record { tick, $($column),* } }
    };
}

macro_rules! records {
    (
        own $own:tt
        $($(#[$doc:meta])* $record:ident $topic:literal $ros:literal $rows:tt)*
    ) => {
        $(record! { $rows { $(#[$doc])* $record $topic $ros } [] [] })*
    };
}

sample_table!(records);

/// Something that happened to a contact of one taxel.
#[derive(Clone, Debug, Serialize, Deserialize, JsonSchema)]
pub struct Contact {
    /// Tick count.
    pub tick: u64,
    /// Taxel number; T1 is 1.
    pub taxel: u8,
    /// Started, LimitCrossed, Finished, Lost or NoRoom.
    #[schemars(with = "String")]
    pub phase: ContactPhase,
    /// Transient up to 0.5 s, else QuasiStatic.
    #[schemars(with = "String")]
    pub kind: ContactKind,
    /// Loop time at which it was first felt, ns.
    pub started_ns: u64,
    /// Time since then, s.
    #[serde(deserialize_with = "scalar")]
    pub duration_s: f64,
    /// Largest force, N.
    #[serde(deserialize_with = "scalar")]
    pub peak_n: f64,
    /// Mean force after the first 0.5 s, N.
    #[serde(deserialize_with = "scalar")]
    pub clamp_mean_n: f64,
    /// Largest force after the first 0.5 s, N.
    #[serde(deserialize_with = "scalar")]
    pub clamp_max_n: f64,
    /// Time integral of the force, N·s.
    #[serde(deserialize_with = "scalar")]
    pub impulse_n_s: f64,
    /// The user's limit that it has crossed, N; 0 if none.
    #[serde(deserialize_with = "scalar")]
    pub crossed_n: f64,
    /// Reaction to it; empty without one.
    pub reaction: String,
    /// Excess of a NoRoom event: ordered outward speed over the contact barrier's bound, m/s.
    #[serde(default, deserialize_with = "scalar")]
    pub excess_m_s: f64,
}

impl Contact {
    /// `event`, which a sample of `tick` carried.
    pub fn new(tick: u64, event: &ContactEvent) -> Self {
        Self {
            tick,
            taxel: event.taxel.saturating_add(1),
            phase: event.phase,
            kind: event.kind,
            started_ns: event.started_ns,
            duration_s: event.duration_s,
            peak_n: event.peak_n,
            clamp_mean_n: event.clamp_mean_n,
            clamp_max_n: event.clamp_max_n,
            impulse_n_s: event.impulse_n_s,
            crossed_n: event.crossed_n.unwrap_or(0.0),
            reaction: name_of(event.reaction),
            excess_m_s: event.excess_m_s,
        }
    }

    /// The event.
    pub fn event(&self) -> ContactEvent {
        ContactEvent {
            taxel: self.taxel.saturating_sub(1),
            phase: self.phase,
            kind: self.kind,
            started_ns: self.started_ns,
            duration_s: self.duration_s,
            peak_n: self.peak_n,
            clamp_mean_n: self.clamp_mean_n,
            clamp_max_n: self.clamp_max_n,
            impulse_n_s: self.impulse_n_s,
            crossed_n: (self.crossed_n > 0.0).then_some(self.crossed_n),
            reaction: named(&self.reaction),
            excess_m_s: self.excess_m_s,
        }
    }
}

/// The way to a real robot; nothing of a simulated one.
#[derive(Clone, Debug, Serialize, Deserialize, JsonSchema)]
pub struct Link {
    /// Tick count.
    pub tick: u64,
    /// Age of the arm's state, s.
    #[serde(deserialize_with = "scalar")]
    pub arm_age_s: f64,
    /// Age of the base's state, s.
    #[serde(deserialize_with = "scalar")]
    pub base_age_s: f64,
    /// Mode of the arm.
    #[schemars(with = "String")]
    pub arm_mode: ArmMode,
    /// Share of the last commands that reached it in time, as it says itself.
    #[serde(deserialize_with = "scalar")]
    pub success_rate: f64,
    /// Its states that never came, since the start.
    pub lost: u64,
    /// Orders that were repeated because none came in time, since the start.
    pub repeated: u64,
    /// Its error flags, bit 0 is the first of its list.
    pub errors: u64,
}

impl Link {
    /// `link`, which a sample of `tick` carried.
    pub const fn new(tick: u64, link: &moca_msgs::Link) -> Self {
        let ArmLink { mode: arm_mode, success_rate, lost, repeated, errors } = link.arm;
        let (arm_age_s, base_age_s) = (link.arm_age_s, link.base_age_s);
        Self { tick, arm_age_s, base_age_s, arm_mode, success_rate, lost, repeated, errors }
    }

    /// Returns the link as the sample carried it.
    pub const fn link(&self) -> moca_msgs::Link {
        let Self { tick: _, arm_age_s, base_age_s, arm_mode: mode, success_rate, lost, repeated, errors } =
            *self;
        moca_msgs::Link { arm_age_s, base_age_s, arm: ArmLink { mode, success_rate, lost, repeated, errors } }
    }
}

/// Progress of the last target from another program; nothing before the first.
#[derive(Clone, Debug, Serialize, Deserialize, JsonSchema)]
pub struct Target {
    /// Tick count.
    pub tick: u64,
    /// Kind of the target.
    #[schemars(with = "String")]
    pub kind: TargetKind,
    /// Progress of it.
    #[schemars(with = "String")]
    pub phase: TargetPhase,
    /// Share of a trajectory's time that has passed, 0 to 1; of everything else 1 when it is reached.
    #[serde(deserialize_with = "scalar")]
    pub progress: f64,
}

impl Target {
    /// `target`, which a sample of `tick` carried.
    pub const fn new(tick: u64, target: &TargetState) -> Self {
        Self { tick, kind: target.kind, phase: target.phase, progress: target.progress }
    }

    /// Returns the state as the sample carried it.
    pub const fn state(&self) -> TargetState {
        TargetState { kind: self.kind, phase: self.phase, progress: self.progress }
    }
}

/// The gripper; nothing of a robot without one.
#[derive(Clone, Debug, Serialize, Deserialize, JsonSchema)]
pub struct Gripper {
    /// Tick count.
    pub tick: u64,
    /// Distance between the fingers, m.
    #[serde(deserialize_with = "scalar")]
    pub width_m: f64,
    /// Largest distance between them, m.
    #[serde(deserialize_with = "scalar")]
    pub width_max_m: f64,
    /// Resting, Moving, Holding or Unknown.
    #[schemars(with = "String")]
    pub phase: GripperPhase,
    /// Requests taken since the start.
    pub requests: u32,
    /// Code of the fault since the last request; empty without one.
    pub fault: String,
    /// Mass of the held object as the grasp told it, kg; 0 for none.
    #[serde(deserialize_with = "scalar")]
    pub object_kg: f64,
    /// Middle between the fingertips in the flange's axes, m.
    pub object_flange_m: [f64; 3],
}

impl Gripper {
    /// `gripper`, which a sample of `tick` carried.
    pub fn new(tick: u64, gripper: &GripperState) -> Self {
        let GripperState { width_m, width_max_m, phase, requests, fault, object_kg, object_flange_m } =
            *gripper;
        Self {
            tick,
            width_m,
            width_max_m,
            phase,
            requests,
            fault: fault.map_or("", GripperFault::code).into(),
            object_kg,
            object_flange_m,
        }
    }

    /// Returns the state as the sample carried it.
    pub fn state(&self) -> GripperState {
        let Self { tick: _, width_m, width_max_m, phase, requests, ref fault, object_kg, object_flange_m } =
            *self;
        let fault = GripperFault::ALL.into_iter().find(|one| one.code() == fault);
        GripperState { width_m, width_max_m, phase, requests, fault, object_kg, object_flange_m }
    }
}

/// A change of mode.
#[derive(Clone, Debug, Serialize, Deserialize, JsonSchema)]
pub struct ModeChange {
    /// First tick in the new mode.
    pub tick: u64,
    /// The new mode.
    #[schemars(with = "String")]
    pub mode: Mode,
}

/// A fault that came up, or was cleared.
#[derive(Clone, Debug, Serialize, Deserialize, JsonSchema)]
pub struct FaultChange {
    /// First tick of the change.
    pub tick: u64,
    /// Stable code; empty when the fault was cleared.
    pub code: String,
    /// Event.
    pub text: String,
    /// Remedy.
    pub remedy: String,
    /// Number of the board whose fault it is, 1 is the first; 0 where it is of no board.
    #[serde(default)]
    pub board: u8,
    /// The fault in the form this library reads back.
    pub json: String,
}

impl FaultChange {
    /// A change to `fault`, `None` when cleared.
    pub fn new(tick: u64, fault: Option<Fault>) -> Result<Self, serde_json::Error> {
        let json = match fault {
            Some(Fault::Board { fault, .. }) => serde_json::to_string(&fault),
            other => serde_json::to_string(&other),
        };
        Ok(Self {
            tick,
            code: fault.map_or("", Fault::code).into(),
            text: fault.map_or("", Fault::text).into(),
            remedy: fault.map_or("", Fault::remedy).into(),
            board: fault.and_then(Fault::board).map_or(0, |board| board.saturating_add(1)),
            json: json?,
        })
    }

    /// The fault, `None` when cleared. One of a board in a log of a time with one board is of the first.
    pub fn fault(&self) -> Result<Option<Fault>, serde_json::Error> {
        match serde_json::from_str::<BoardFault>(&self.json) {
            Ok(fault) => Ok(Some(fault.of(self.board.saturating_sub(1)))),
            Err(_) => serde_json::from_str(&self.json),
        }
    }
}

/// A change of what is known of the Touch Board.
#[derive(Clone, Debug, Serialize, Deserialize, JsonSchema)]
pub struct BoardChange {
    /// First tick of the change.
    pub tick: u64,
    /// State of the board, and its remedy.
    pub text: String,
    /// The diagnosis in the form this library reads back.
    pub json: String,
}

impl BoardChange {
    /// A change to `board`.
    pub fn new(tick: u64, board: Diagnosis) -> Result<Self, serde_json::Error> {
        Ok(Self { tick, text: board.text().into(), json: serde_json::to_string(&board)? })
    }

    /// The diagnosis.
    pub fn board(&self) -> Result<Diagnosis, serde_json::Error> {
        serde_json::from_str(&self.json)
    }
}

/// The robot's description, once at the start.
#[derive(Clone, Debug, Serialize, Deserialize, JsonSchema)]
pub struct Robot {
    /// Unix time of loop time 0, ns.
    pub start_unix_ns: u64,
    /// Name of the robot.
    pub name: String,
    /// The description in the form this library reads back.
    pub json: String,
}

macro_rules! channels {
    ($($record:ident => $topic:literal),* $(,)?) => {
        $(impl Channel for $record { const TOPIC: &'static str = $topic; })*
    };
}

/// A parameter that was changed while the loop ran.
#[derive(Clone, Debug, Serialize, Deserialize, JsonSchema)]
pub struct ParameterChange {
    /// First tick with the new value.
    pub tick: u64,
    /// Dotted name as in the configuration file.
    pub name: String,
    /// Its elements.
    #[serde(deserialize_with = "list")]
    pub values: Vec<f64>,
}

/// Message of a driver of a real arm or base: where it was reached, why it refuses, which other nodes are on its network.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub struct DriverWords {
    /// In sentences.
    pub text: String,
}

/// Configuration of the run, once at the start.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub struct Configuration {
    /// Version of the daemon.
    pub version: String,
    /// The whole configuration as a file would have it.
    pub toml: String,
    /// The calibration file's text; empty where there is none.
    pub calibration: String,
    /// The text of the file of contact limits; empty where there is none.
    #[serde(default)]
    pub contact_limits: String,
}

channels! {
    Robot => "/robot",
    Contact => "/contact",
    Link => "/link",
    Target => "/target",
    Gripper => "/gripper",
    ModeChange => "/mode",
    FaultChange => "/fault",
    BoardChange => "/board",
    ParameterChange => "/parameter",
    DriverWords => "/driver",
    Asked => "/audit",
    Configuration => "/configuration",
}

/// Name of a reaction as a log shows it.
fn name_of(reaction: Option<ContactReaction>) -> String {
    reaction.map_or("", ContactReaction::name).into()
}

fn named(name: &str) -> Option<ContactReaction> {
    ContactReaction::ALL.into_iter().find(|reaction| reaction.name() == name)
}

fn scalar<'de, D: Deserializer<'de>>(d: D) -> Result<f64, D::Error> {
    Ok(Option::deserialize(d)?.unwrap_or(f64::NAN))
}

fn list<'de, D: Deserializer<'de>>(d: D) -> Result<Vec<f64>, D::Error> {
    let values = Vec::<Option<f64>>::deserialize(d)?;
    Ok(values.into_iter().map(|v| v.unwrap_or(f64::NAN)).collect())
}

fn array<'de, D: Deserializer<'de>, const N: usize>(d: D) -> Result<[f64; N], D::Error> {
    list(d)?.try_into().map_err(|v: Vec<f64>| Error::invalid_length(v.len(), &"an array of fixed length"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn seven_digits_are_those_of_the_text() {
        let text = |value: f64| -> f64 { format!("{value:.6e}").parse().unwrap() };
        let mut state = 1_u64;
        for exponent in -9..13 {
            for number in 0..20_000 {
                state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
                let share = f64::from(u32::try_from(state >> 32).unwrap()) / f64::from(u32::MAX);
                // Every tenth lies half way between two numbers of seven digits, or next to it.
                let half = f64::from(1_000_000 + number * 449) + 0.5 + (share - 0.5) * 1e-9;
                let digits = if number % 10 == 0 { half * 1e-6 } else { 1.0 + 9.0 * share };
                let value = digits * 10_f64.powi(exponent) * if number % 2 == 0 { 1.0 } else { -1.0 };
                assert_eq!(seven_digits(value).to_bits(), text(value).to_bits(), "{value:e}");
            }
        }
        for value in [1.0, 0.5, 1e-9, 9.999_999_4, 9.999_999_5, 9_999_999.4, 1e6, 1e7, f64::MAX] {
            assert_eq!(seven_digits(value).to_bits(), text(value).to_bits(), "{value:e}");
        }
        assert_eq!(seven_digits(-9e-10).to_bits(), 0.0_f64.to_bits());
        assert!(seven_digits(f64::NAN).is_nan() && seven_digits(f64::INFINITY).is_infinite());
    }
}
