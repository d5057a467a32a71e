//! The shared vocabulary of MOCA-S: what one part may say to another, and nothing that any part does.
//!
//! Read in this order:
//! 1. [`robot`]: plain constant tables: arms, the base, the arm's mount, the taxels of the cover.
//! 2. [`state`]: what a plant measures ([`RobotState`]) and what it is told ([`Actuation`]).
//! 3. [`taxel`]: what the cover feels, with its age and its health; [`board`]: what is known of the board behind it.
//! 4. [`params`]: the controllers' parameters and their defaults; [`table`]: what a parameter's row is.
//! 5. [`mode`]: modes, faults, how each is cleared.
//! 6. [`protection`]: speed limit and contact events.
//! 7. [`target`]: where another program wants flange, arm or base.
//! 8. [`gripper`]: fingers on the flange, and what they hold.
//! 9. [`request`] and [`sample`]: what a client may ask and what it is shown.
//! 10. [`truth`]: how a simulated robot differs from the one that its controller believes in.
//!
//! # Conventions
//! SI units and radians. Frames: **W** world; **B** mobile base (x forward, y left, z up, origin on the floor at
//! the base's centre); **A** arm base (link 0); **E** flange. The suffix of a name says frame or unit where a
//! mix-up is possible: `wrench_base`, `age_s`. A wrench is \[force; moment\] **on the robot**; a planar wrench is
//! \[f_x N, f_y N, m_z N·m\] about the origin of its frame. Twists are \[linear; angular\].
//! Joint torques are what the motors give **including** gravity compensation: M q̈ + C q̇ + g = τ + τ_ext.
//!
//! This crate refuses to know: a clock, an allocator, linear algebra, and every other crate of the workspace.
#![no_std]
#![forbid(unsafe_code)]

#[cfg(feature = "alloc")]
extern crate alloc;

pub mod arm_errors;
pub mod board;
pub mod gripper;
pub mod link;
pub mod mode;
pub mod params;
pub mod protection;
pub mod request;
pub mod robot;
pub mod sample;
pub mod state;
pub mod table;
pub mod target;
pub mod taxel;
pub mod truth;

pub use gripper::{GripperFault, GripperPhase, GripperRefusal, GripperRequest, GripperState};
pub use link::{ArmLink, ArmMode, Link};
pub use mode::{BoardFault, Fault, Law, Mode, Reaction};
pub use params::{Corrections, ImpedanceGains, Limits, ParameterError, ParameterValues, Parameters};
pub use protection::{
    ContactEvent, ContactReaction, ContactRow, PostureOffset, SpeedLimit, SpeedLimitReason,
};
pub use request::{Outcome, Refusal, Request};
pub use robot::{ArmTable, BaseTable, Mount, Payload, TaxelPlacement};
pub use sample::{MAX_JOINTS, MAX_TAXELS, STAGES, Sample};
pub use state::{Actuation, RobotCommand, RobotState};
pub use target::{
    RobotPart, Target, TargetRefusal, TargetState, TimedTarget, TouchPolicy, TwistAxes, Waypoint,
};
pub use taxel::{CoverReading, TaxelReading, TaxelStatus};
pub use truth::{TrueArm, TrueBase, TrueFlangeSensor, TrueFoam, TrueFoamKind, TrueObject, TrueSensor, Truth};

/// A time of the loop, ns, as seconds.
///
/// ```
/// assert_eq!(moca_msgs::seconds(2_500_000_000), 2.5);
/// ```
pub const fn seconds(ns: u64) -> f64 {
    #[expect(clippy::cast_precision_loss, reason = "a loop runs for less than 2^53 ns, 104 days")]
    let ns = ns as f64;
    ns / 1e9
}

/// A time in seconds as the nearest ns; what lies outside of a `u64` ends there, and NaN is 0.
///
/// ```
/// assert_eq!(moca_msgs::nanoseconds(0.002_5), 2_500_000);
/// assert_eq!(moca_msgs::nanoseconds(1.6e-9), 2);
/// assert_eq!(moca_msgs::nanoseconds(-1.0), 0);
/// assert_eq!(moca_msgs::nanoseconds(f64::INFINITY), u64::MAX);
/// ```
#[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "saturates, as it says")]
#[expect(clippy::cast_precision_loss, reason = "a whole number that was one before")]
pub const fn nanoseconds(time_s: f64) -> u64 {
    let ns = time_s * 1e9;
    let whole = ns as u64;
    // `round` is not in `core`
    if ns - whole as f64 >= 0.5 { whole.saturating_add(1) } else { whole }
}
