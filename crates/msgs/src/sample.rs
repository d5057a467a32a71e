//! One tick as a client sees it.
//!
//! ```
//! use moca_msgs::{Mode, Sample};
//!
//! let sample = Sample::default();
//! assert_eq!(sample.mode, Mode::Starting);
//! assert!(sample.taxels.is_empty() && sample.q_rad.is_empty(), "no cover and no arm known yet");
//! ```

use crate::board::Diagnosis;
use crate::protection::{MAX_CONTACT_EVENTS, MAX_CONTACT_ROWS};
use crate::{
    ContactEvent, ContactReaction, ContactRow, Fault, Law, Link, Mode, SpeedLimit, TargetState, TaxelReading,
};
use heapless::Vec;

/// Most arm joints a sample can carry.
pub const MAX_JOINTS: usize = 8;
/// Most taxels a cover can have (four boards of 12).
pub const MAX_TAXELS: usize = 48;

/// Stages of a tick, in the order in which the data flows. Writing to a simulated robot includes its physics.
pub const STAGES: [&str; 5] = ["read state", "cover", "control", "write plant", "publish"];

/// Everything about one tick. Fixed size, no pointers: it crosses threads through a bounded ring.
#[derive(Clone, Debug, Default, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct Sample {
    /// Tick count since the loop started.
    pub tick: u64,
    /// Loop time of this tick, ns.
    pub time_ns: u64,
    /// Mode after this tick.
    pub mode: Mode,
    /// Why the robot is stopped, if it is.
    pub fault: Option<Fault>,
    /// The board whose fault it is, 0 is the first; `None` where it is of no board.
    pub fault_board: Option<u8>,
    /// The selected law, which arming starts; `None` in a log that does not say.
    pub law: Option<Law>,
    /// Pose of B in W: m, m, rad.
    pub base_pose_world: [f64; 3],
    /// Rate of the pose: m/s, m/s, rad/s.
    pub base_velocity_world: [f64; 3],
    /// Speed of the fastest point of the cover, m/s: what the speed limit limits.
    pub cover_speed_m_s: f64,
    /// Way of the base towards a side that no taxel covers since it last rested, m; 0 where all are covered.
    pub uncovered_way_m: f64,
    /// Commanded base velocity in the axes of B: m/s, m/s, rad/s.
    pub base_velocity_command_body: [f64; 3],
    /// Joint angles, rad.
    pub q_rad: Vec<f64, MAX_JOINTS>,
    /// Joint rates, rad/s.
    pub dq_rad_s: Vec<f64, MAX_JOINTS>,
    /// Commanded joint torques, gravity included, N·m.
    pub arm_torque_nm: Vec<f64, MAX_JOINTS>,
    /// Flange position in W, m.
    pub flange_position_world: [f64; 3],
    /// Flange orientation in W as a unit quaternion x, y, z, w.
    pub flange_quaternion_world: [f64; 4],
    /// Desired flange position in W, m.
    pub flange_desired_position_world: [f64; 3],
    /// Desired flange orientation in W as a unit quaternion x, y, z, w.
    pub flange_desired_quaternion_world: [f64; 4],
    /// External wrench on the robot about the flange origin, world axes \[N; N·m\]; zero where none is known.
    pub flange_wrench_world: [f64; 6],
    /// The last target from another program since the law was entered.
    pub target: Option<TargetState>,
    /// Cover wrench, eq. (4): \[N, N, N·m\] in B about its origin.
    pub cover_wrench_base: [f64; 3],
    /// Cover, T1 first.
    pub taxels: Vec<TaxelReading, MAX_TAXELS>,
    /// Raw FDAT counts, T1 first.
    pub counts: Vec<u16, MAX_TAXELS>,
    /// Age of the cover's data at this tick, s; negative before the first good frame.
    pub frame_age_s: f64,
    /// Measured frame rate, Hz; 0 before it is known.
    pub frame_rate_hz: f64,
    /// Good frames so far.
    pub frames_good: u64,
    /// Rejected frames so far.
    pub frames_bad: u64,
    /// What the board's port and bytes say about it.
    pub board: Diagnosis,
    /// Speed limit in force.
    pub speed_limit: SpeedLimit,
    /// Reaction to a contact in force.
    pub contact_reaction: Option<ContactReaction>,
    /// What happened to contacts in this tick, oldest first.
    pub contact_events: Vec<ContactEvent, MAX_CONTACT_EVENTS>,
    /// What the contact barrier says of the first taxels that it has a say in; not in logs, a replay finds it again.
    pub contact_rows: Vec<ContactRow, MAX_CONTACT_ROWS>,
    /// How late this tick woke, s; 0 in lock-step.
    pub lateness_s: f64,
    /// Missed slots so far.
    pub overruns: u64,
    /// How long each stage of the tick before took, ns, in the order of [`STAGES`]; all 0 where nobody timed it.
    pub stages_ns: [u32; STAGES.len()],
    /// The way to a real robot; `None` of a simulated one.
    pub link: Option<Link>,
}
