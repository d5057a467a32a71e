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
    ContactEvent, ContactReaction, ContactRow, Fault, GripperState, Law, Link, Mode, PostureOffset,
    SpeedLimit, TargetState, TaxelReading,
};
use heapless::Vec;

/// Most arm joints a sample can carry.
pub const MAX_JOINTS: usize = 8;
/// Most taxels a cover can have (four boards of 12).
pub const MAX_TAXELS: usize = 48;

/// Stages of a tick, in the order in which the data flows. Writing to a simulated robot includes its physics.
pub const STAGES: [&str; 5] = ["read state", "cover", "control", "write plant", "publish"];

/// The table of a sample's fields, handed to the macro `$to`. A crate that shows, writes, reads or exports samples expands it
/// into its own types. So a new field is one row here and the line that computes it.
///
/// Fields of `own` have no column of their own in a log. The others are in groups, each of which is one record of a log: its sentence, its name, its
/// topic and its ROS message. A row is a field's sentence with its unit, its name, its type and words about it:
/// - `as { … }` says what the record has in its place; else the record has the same name and type.
/// - `later`: records of earlier versions lack it.
/// - `from_zero`: a negative number means that the value is not known.
#[macro_export]
macro_rules! sample_table {
    ($to:ident) => {
        $to! {
            own {
                /// Tick count since the loop started.
                tick: u64;
                /// Loop time of this tick, ns.
                time_ns: u64;
                /// Mode after this tick.
                mode: Mode;
                /// Why the robot is stopped, if it is.
                fault: Option<Fault>;
                /// The last target from another program since the law was entered.
                target: Option<TargetState>;
                /// Displacement of the base from where the arm's posture wants it; `None` unless the impedance law runs. Not in logs, a
                /// replay computes it.
                posture: Option<PostureOffset>;
                /// Health of the board, from its port and its bytes.
                board: Diagnosis;
                /// Events of contacts in this tick, oldest first.
                contact_events: Vec<ContactEvent, MAX_CONTACT_EVENTS>;
                /// Rows of the contact barrier, one for each of the first taxels that it limits; not in logs, a replay computes them.
                contact_rows: Vec<ContactRow, MAX_CONTACT_ROWS>;
                /// Connection to a real robot; `None` for a simulated one.
                link: Option<Link>;
                /// The gripper; `None` without one.
                gripper: Option<GripperState>;
            }

            /// Measured state of the plant.
            State "/state" "moca_msgs/msg/State" {
                /// Pose of the base in the world: m, m, rad.
                base_pose_world: [f64; 3];
                /// Its rate: m/s, m/s, rad/s.
                base_velocity_world: [f64; 3];
                /// Speed of the fastest point of the cover, m/s.
                cover_speed_m_s: f64, later;
                /// Way towards a side that no taxel covers since the base last rested, m.
                uncovered_way_m: f64, later;
                /// Joint angles, rad.
                q_rad: Vec<f64, MAX_JOINTS> as { q_rad: Vec<f64> };
                /// Joint rates, rad/s.
                dq_rad_s: Vec<f64, MAX_JOINTS> as { dq_rad_s: Vec<f64> };
                /// Flange position in the world, m.
                flange_position_world: [f64; 3];
                /// Flange orientation in the world, quaternion x, y, z, w.
                flange_quaternion_world: [f64; 4];
                /// Desired flange position in the world, m.
                flange_desired_position_world: [f64; 3];
                /// Desired flange orientation in the world, quaternion x, y, z, w.
                flange_desired_quaternion_world: [f64; 4];
                /// External wrench on the robot about the flange, world axes: N, N·m.
                flange_wrench_world: [f64; 6];
            }

            /// Commands to the robot.
            Command "/command" "moca_msgs/msg/Command" {
                /// Base velocity in the base's own axes: m/s, m/s, rad/s.
                base_velocity_command_body: [f64; 3] as { base_velocity_body: [f64; 3] };
                /// Joint torques, gravity included, N·m.
                arm_torque_nm: Vec<f64, MAX_JOINTS> as { arm_torque_nm: Vec<f64> };
                /// Speed limit in force.
                speed_limit: SpeedLimit as {
                    /// Largest speed that any point of the cover was allowed, m/s.
                    #[serde(default)]
                    speed_limit_m_s: f64,
                    /// Why.
                    #[serde(default)]
                    #[schemars(with = "String")]
                    speed_limit_reason: SpeedLimitReason
                };
                /// The selected law, impedance or follow-me; empty where it is not known.
                law: Option<Law> as { #[serde(default)] law: String };
                /// Reaction to a contact in force; empty without one.
                contact_reaction: Option<ContactReaction> as { #[serde(default)] contact_reaction: String };
            }

            /// Readings of the cover, T1 first.
            Cover "/cover" "moca_msgs/msg/Cover" {
                /// Readings of the taxels, T1 first.
                taxels: Vec<TaxelReading, MAX_TAXELS> as {
                    /// Force of each taxel, N; meaningful only where the status is Ok.
                    force_n: Vec<f64>,
                    /// Health of each taxel.
                    #[schemars(with = "Vec<String>")]
                    status: Vec<TaxelStatus>
                };
                /// Raw FDAT counts.
                counts: Vec<u16, MAX_TAXELS> as { counts: Vec<u16> };
                /// Cover wrench in the base's own axes about its origin: N, N, N·m.
                cover_wrench_base: [f64; 3] as { wrench_base: [f64; 3] };
                /// Age of the data, s; negative before the first good frame.
                frame_age_s: f64, from_zero;
                /// Measured frame rate, Hz.
                frame_rate_hz: f64;
            }

            /// Timing of the loop: the worst since the record before.
            Timing "/timing" "moca_msgs/msg/Timing" {
                /// Lateness of the latest wake-up, s.
                lateness_s: f64;
                /// Missed slots so far.
                overruns: u64;
                /// Longest duration of each stage, ns: read state, cover, control, write plant, publish.
                stages_ns: [u32; STAGES.len()], later;
                /// Good frames so far.
                frames_good: u64;
                /// Rejected frames so far.
                frames_bad: u64;
            }
        }
    };
}

macro_rules! sample {
    (
        own { $($(#[$own_doc:meta])* $own:ident: $own_type:ty;)* }
        $(
            $(#[$record_doc:meta])* $record:ident $topic:literal $ros:literal {
                $($(#[$doc:meta])* $field:ident: $type:ty $(as $columns:tt)? $(, $word:ident)*;)*
            }
        )*
    ) => {
        /// Everything about one tick. Fixed size, no pointers: it crosses threads through a bounded ring. Its fields are the rows
        /// of [`sample_table`](crate::sample_table).
        #[derive(Clone, Debug, Default, PartialEq)]
        #[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
        pub struct Sample {
            $($(#[$own_doc])* pub $own: $own_type,)*
            $($($(#[$doc])* pub $field: $type,)*)*
        }
    };
}

sample_table!(sample);

impl Sample {
    /// Distance of the flange from where it is wanted, m.
    ///
    /// ```
    /// let flange_position_world = [0.3, 0.0, 0.4];
    /// assert_eq!(moca_msgs::Sample { flange_position_world, ..Default::default() }.flange_error_m(), 0.5);
    /// ```
    pub fn flange_error_m(&self) -> f64 {
        let axes = self.flange_position_world.iter().zip(self.flange_desired_position_world);
        libm::sqrt(axes.map(|(at, wanted)| (at - wanted) * (at - wanted)).sum())
    }
}
