//! The messages of a log as ROS 2 messages of our own: live viewers plot the same numbers under the same names. Those of a
//! sample come from its table.

use crate::log::records::{BoardChange, Contact, FaultChange, Gripper, Link, ModeChange, Target};
use crate::ros::{message, names};
use moca_msgs::protection::{ContactKind, ContactPhase};
use moca_msgs::target::{TargetKind, TargetPhase};
use moca_msgs::{ArmMode, GripperPhase, Mode, SpeedLimitReason, TaxelStatus};

names!(
    ArmMode,
    Mode,
    SpeedLimitReason,
    TaxelStatus,
    ContactPhase,
    ContactKind,
    TargetKind,
    TargetPhase,
    GripperPhase
);

message! { "moca_msgs/msg/Link" Link {
    tick,
    arm_age_s,
    base_age_s,
    arm_mode,
    success_rate,
    lost,
    repeated,
    errors,
} }
message! { "moca_msgs/msg/Target" Target { tick, kind, phase, progress } }
message! { "moca_msgs/msg/Gripper" Gripper { tick, width_m, width_max_m, phase, requests, fault, object_kg, object_flange_m } }
message! { "moca_msgs/msg/Mode" ModeChange { tick, mode } }
message! { "moca_msgs/msg/Fault" FaultChange { tick, code, text, remedy, board, json } }
message! { "moca_msgs/msg/Board" BoardChange { tick, text, json } }
message! { "moca_msgs/msg/Contact" Contact {
    tick,
    taxel,
    phase,
    kind,
    started_ns,
    duration_s,
    peak_n,
    clamp_mean_n,
    clamp_max_n,
    impulse_n_s,
    crossed_n,
    reaction,
    excess_m_s,
} }
