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

use moca_msgs::protection::{ContactKind, ContactPhase};
use moca_msgs::{
    ArmLink, ArmMode, ContactEvent, ContactReaction, Fault, Law, Mode, SpeedLimit, SpeedLimitReason,
    TaxelStatus,
    board::Diagnosis,
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
    // The text with so many digits is the shortest that reads back to the rounded number.
    format!("{value:.6e}").parse().unwrap_or(value)
}

/// What the plant measured.
#[derive(Clone, Debug, Serialize, Deserialize, JsonSchema)]
pub struct State {
    /// Tick count.
    pub tick: u64,
    /// Pose of the base in the world: m, m, rad.
    #[serde(deserialize_with = "array")]
    pub base_pose_world: [f64; 3],
    /// Its rate: m/s, m/s, rad/s.
    #[serde(deserialize_with = "array")]
    pub base_velocity_world: [f64; 3],
    /// Speed of the fastest point of the cover, m/s.
    #[serde(default, deserialize_with = "scalar")]
    pub cover_speed_m_s: f64,
    /// Way towards a side that no taxel covers since the base last rested, m.
    #[serde(default, deserialize_with = "scalar")]
    pub uncovered_way_m: f64,
    /// Joint angles, rad.
    #[serde(deserialize_with = "list")]
    pub q_rad: Vec<f64>,
    /// Joint rates, rad/s.
    #[serde(deserialize_with = "list")]
    pub dq_rad_s: Vec<f64>,
    /// Flange position in the world, m.
    #[serde(deserialize_with = "array")]
    pub flange_position_world: [f64; 3],
    /// Flange orientation in the world, quaternion x, y, z, w.
    #[serde(deserialize_with = "array")]
    pub flange_quaternion_world: [f64; 4],
    /// Desired flange position in the world, m.
    #[serde(deserialize_with = "array")]
    pub flange_desired_position_world: [f64; 3],
    /// Desired flange orientation in the world, quaternion x, y, z, w.
    #[serde(deserialize_with = "array")]
    pub flange_desired_quaternion_world: [f64; 4],
    /// External wrench on the robot about the flange, world axes: N, N·m.
    #[serde(deserialize_with = "array")]
    pub flange_wrench_world: [f64; 6],
}

/// What the robot was told.
#[derive(Clone, Debug, Serialize, Deserialize, JsonSchema)]
pub struct Command {
    /// Tick count.
    pub tick: u64,
    /// Base velocity in the base's own axes: m/s, m/s, rad/s.
    #[serde(deserialize_with = "array")]
    pub base_velocity_body: [f64; 3],
    /// Joint torques, gravity included, N·m.
    #[serde(deserialize_with = "list")]
    pub arm_torque_nm: Vec<f64>,
    /// Largest speed that any point of the cover was allowed, m/s.
    #[serde(default, deserialize_with = "scalar")]
    pub speed_limit_m_s: f64,
    /// Why.
    #[serde(default)]
    #[schemars(with = "String")]
    pub speed_limit_reason: SpeedLimitReason,
    /// The selected law, impedance or follow-me; empty where it is not known.
    #[serde(default)]
    pub law: String,
    /// Reaction to a contact in force; empty without one.
    #[serde(default)]
    pub contact_reaction: String,
}

impl Command {
    /// The speed limit.
    pub fn speed_limit(&self) -> SpeedLimit {
        SpeedLimit { m_s: self.speed_limit_m_s, reason: self.speed_limit_reason }
    }

    /// The selected law.
    pub fn law(&self) -> Option<Law> {
        [Law::Impedance, Law::FollowMe].into_iter().find(|law| Mode::from(*law).name() == self.law)
    }

    /// The reaction to a contact.
    pub fn contact_reaction(&self) -> Option<ContactReaction> {
        named(&self.contact_reaction)
    }
}

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
    /// Of NoRoom: how much faster outward the taxel was ordered than the contact barrier allows, m/s.
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
    /// What the arm does.
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

    /// What the sample carried.
    pub const fn link(&self) -> moca_msgs::Link {
        let Self { tick: _, arm_age_s, base_age_s, arm_mode: mode, success_rate, lost, repeated, errors } =
            *self;
        moca_msgs::Link { arm_age_s, base_age_s, arm: ArmLink { mode, success_rate, lost, repeated, errors } }
    }
}

/// How the last target from another program stands; nothing before the first.
#[derive(Clone, Debug, Serialize, Deserialize, JsonSchema)]
pub struct Target {
    /// Tick count.
    pub tick: u64,
    /// What is led, and how.
    #[schemars(with = "String")]
    pub kind: TargetKind,
    /// How it stands.
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

    /// What the sample carried.
    pub const fn state(&self) -> TargetState {
        TargetState { kind: self.kind, phase: self.phase, progress: self.progress }
    }
}

/// What the cover felt, T1 first.
#[derive(Clone, Debug, Serialize, Deserialize, JsonSchema)]
pub struct Cover {
    /// Tick count.
    pub tick: u64,
    /// Force of each taxel, N; meaningful only where the status is Ok.
    #[serde(deserialize_with = "list")]
    pub force_n: Vec<f64>,
    /// Health of each taxel.
    #[schemars(with = "Vec<String>")]
    pub status: Vec<TaxelStatus>,
    /// Raw FDAT counts.
    pub counts: Vec<u16>,
    /// Cover wrench in the base's own axes about its origin: N, N, N·m.
    #[serde(deserialize_with = "array")]
    pub wrench_base: [f64; 3],
    /// Age of the data, s; negative before the first good frame.
    #[serde(deserialize_with = "scalar")]
    pub frame_age_s: f64,
    /// Measured frame rate, Hz.
    #[serde(deserialize_with = "scalar")]
    pub frame_rate_hz: f64,
}

/// How well the loop kept time: the worst since the record before.
#[derive(Clone, Debug, Serialize, Deserialize, JsonSchema)]
pub struct Timing {
    /// Tick count.
    pub tick: u64,
    /// How late the latest tick woke, s.
    #[serde(deserialize_with = "scalar")]
    pub lateness_s: f64,
    /// Missed slots so far.
    pub overruns: u64,
    /// How long each stage took at most, ns: read state, cover, control, write plant, publish.
    #[serde(default)]
    pub stages_ns: [u32; 5],
    /// Good frames so far.
    pub frames_good: u64,
    /// Rejected frames so far.
    pub frames_bad: u64,
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
    /// What happened.
    pub text: String,
    /// What to do about it.
    pub remedy: String,
    /// Number of the board whose fault it is, 1 is the first; 0 where it is of no board.
    #[serde(default)]
    pub board: u8,
    /// The fault in the form this library reads back.
    pub json: String,
}

impl FaultChange {
    /// A change to `fault`, `None` when cleared, of `board` (0 is the first).
    pub fn new(tick: u64, fault: Option<Fault>, board: Option<u8>) -> Result<Self, serde_json::Error> {
        Ok(Self {
            tick,
            code: fault.map_or("", Fault::code).into(),
            text: fault.map_or("", Fault::text).into(),
            remedy: fault.map_or("", Fault::remedy).into(),
            board: board.map_or(0, |board| board.saturating_add(1)),
            json: serde_json::to_string(&fault)?,
        })
    }

    /// The fault, `None` when cleared.
    pub fn fault(&self) -> Result<Option<Fault>, serde_json::Error> {
        serde_json::from_str(&self.json)
    }
}

/// A change of what is known of the Touch Board.
#[derive(Clone, Debug, Serialize, Deserialize, JsonSchema)]
pub struct BoardChange {
    /// First tick of the change.
    pub tick: u64,
    /// What is known, and what to do about it.
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

/// What a driver of a real arm or base said: where it was reached, why it refuses, who else is on its network.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub struct DriverWords {
    /// In sentences.
    pub text: String,
}

/// How the run was configured, once at the start.
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
    State => "/state",
    Command => "/command",
    Contact => "/contact",
    Link => "/link",
    Target => "/target",
    Cover => "/cover",
    Timing => "/timing",
    ModeChange => "/mode",
    FaultChange => "/fault",
    BoardChange => "/board",
    ParameterChange => "/parameter",
    DriverWords => "/driver",
    Configuration => "/configuration",
}

/// Name of a reaction as a log shows it.
pub(super) fn name_of(reaction: Option<ContactReaction>) -> String {
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
