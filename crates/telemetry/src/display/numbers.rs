//! The messages of a log as ROS 2 messages of our own: live viewers plot the same numbers under the same names.

use crate::log::records::{
    BoardChange, Command, Contact, Cover, FaultChange, Link, ModeChange, State, Target, Timing,
};
use crate::ros::{message, names};
use moca_msgs::protection::{ContactKind, ContactPhase};
use moca_msgs::target::{TargetKind, TargetPhase};
use moca_msgs::{ArmMode, Mode, SpeedLimitReason, TaxelStatus};

names!(ArmMode, Mode, SpeedLimitReason, TaxelStatus, ContactPhase, ContactKind, TargetKind, TargetPhase);

message! { "moca_msgs/msg/State" State {
    tick,
    base_pose_world,
    base_velocity_world,
    cover_speed_m_s,
    uncovered_way_m,
    q_rad,
    dq_rad_s,
    flange_position_world,
    flange_quaternion_world,
    flange_desired_position_world,
    flange_desired_quaternion_world,
    flange_wrench_world,
} }
message! { "moca_msgs/msg/Command" Command {
    tick,
    base_velocity_body,
    arm_torque_nm,
    speed_limit_m_s,
    speed_limit_reason,
    law,
    contact_reaction,
} }
message! { "moca_msgs/msg/Cover" Cover {
    tick,
    force_n,
    status,
    counts,
    wrench_base,
    frame_age_s,
    frame_rate_hz,
} }
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
message! { "moca_msgs/msg/Timing" Timing {
    tick,
    lateness_s,
    overruns,
    stages_ns,
    frames_good,
    frames_bad,
} }
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
