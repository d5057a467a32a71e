//! Tactile whole-body control of a mobile manipulator: an omnidirectional base under a torque-controlled arm, covered
//! with tactile taxels, that people may lean on. After Leonori, Gandarias, Ajoudani, "MOCA-S: A Sensitive Mobile
//! Collaborative Robotic Assistant exploiting Low-Cost Capacitive Tactile Cover and Whole-Body Control", RA-L 2022;
//! equation numbers are that paper's, with its misprints put right.
//!
//! # Which layer do I need?
//! 1. **A controller** for a loop: [`WholeBodyController`] (constant configuration), [`ControllerState`] (what it
//!    remembers; it is yours) and [`WholeBodyController::step`] (measurements in, command inside every limit out). A base
//!    without an arm is a [`BaseController`], an arm without a cover an [`ArmController`]; the whole is made of these two.
//! 2. **The laws** alone, to build another controller: [`opspace`], [`impedance`], [`follow_me`], [`admittance`],
//!    [`cover_map`], [`limits`], [`guard`], [`contact_barrier`], [`self_collision`], [`reach`],
//!    [`momentum_observer`].
//! 3. **The model** alone: [`ArmModel`] from a table of [`robot`]; [`ArmModel::kinematics`] gives poses and Jacobians in
//!    world axes, [`ArmModel::dynamics`] mass matrix and bias as well; [`coupled`] adds the physical base.
//! 4. **References from outside**: [`online_trajectory`] and [`reference_generator`] make of targets, however they come,
//!    a motion with bounded velocity, acceleration and jerk; [`ControllerState::lead`] lets a law follow it.
//! 5. **Analysis**: [`contact_stability`] answers whether a cover is stable against a body and how fast its base may go,
//!    [`loop_stability`] whether gains are stable with a period and a robot in a posture, [`joint_stiffness`] how stiff a
//!    joint can be held.
//!
//! Numbers of joints and taxels are const generics, the scalar is `f32` or `f64`. What a user needs of `moca-msgs` and
//! `nalgebra` is re-exported: one dependency is enough. Runnable: `cargo run -p moca-wbc --example impedance` and
//! `--example follow_me`.
//!
//! # Equation → function
//! | eq. | what | where |
//! |---|---|---|
//! | (2) | base admittance, exact zero-order hold | [`admittance::step`] |
//! | (3) | M = blkdiag(M_v, M_A), C q̇ + g of the arm | [`opspace::TaskDynamics::new`], [`model::Dynamics::bias`] |
//! | (4), (5) | cover wrench on the base | [`cover_wrench`], [`cover_map::CoverMap::wrench`] |
//! | (6), (7), (9) | weighted torques, η_B and η_A | [`opspace::BlockWeight`] |
//! | (6)–(8) | weighted torques, any diagonal H | [`opspace::AxisWeight`] |
//! | (10) | pose error, damping design, task wrench | [`impedance::pose_error`], [`impedance::damping`], [`impedance::wrench`] |
//! | (11) | null-space posture | [`impedance::posture_torque`] |
//! | (12)–(14) | what the base follows of a wrench on the arm | [`follow_me::moved`], [`follow_me::base_wrench`] |
//! | (15) | the arm's own task torques | [`opspace::ArmDynamics::torque`] |
//! | (16) | task wrench relative to the base | [`impedance::wrench`] |
//!
//! # Misprints of the paper
//! | eq. | this crate computes | because |
//! |---|---|---|
//! | (3) | M q̈ + bias = τ + τ_ext: the second "=" is a "+" | both columns must have ten rows |
//! | (6) | "ΛW" is Λ_W | W weighs torques, Λ is of the task |
//! | (7) | Λ_W = (J M⁻¹ W⁻¹ M⁻¹ Jᵀ)⁻¹ | the print inverts J, which is not square, and a pseudo-inverse misses J̄ᵀτ = F |
//! | (9) | H = blkdiag(η_B I_3, η_A I_7) | the print's lower right block has not the size of the arm |
//! | (10) | pose error [p_d − p; R log(RᵀR_d)], world axes | a pose is not a vector |
//! | (11) | the wrench of (4) is turned to world axes first | the base's coordinates are of the world |
//! | (12) | the flange's wrench about the arm base: m_z + p_x f_y − p_y f_x | about the flange the base turns wrongly |
//! | (13) | Ψ selects f_x, f_y and m_z: its last row is [0 0 0 0 0 1] | so says the text |
//! | (14) | the moment's row is [−r_y r_x]·R_BA, 1 | moment is r × f |
//!
//! # What the literal law leaves out
//! Each of [`moca_msgs::Corrections`] is off by default in the paper's experiments. Largest flange error in 3 s pushes
//! of 20 N at T1 and at T6 (closed loop of `tests/closed_loop.rs`): literal 4.7 and 10.4 mm; `null_space_damping` 1.1
//! and 1.8 mm; with `base_coupling` as well 0.30 and 0.38 mm. `flange_wrench_feedforward`: 15 N sideways at the flange
//! move it 8.8 mm and the base against the push; with it the flange moves 18.8 mm (its stiffness) and the base follows.
//!
//! # Signs and points
//! Every wrench is the one **on the robot**. A flange wrench is about the flange's origin in world axes; it is moved to
//! the arm base before eq. (12). The controlled frame E is the flange, or the tool if [`moca_msgs::Payload`] sets one.
//! The external wrench comes from the caller, else from the robot, else from the momentum observer, in that order.
//!
//! # What the base is refused
//! Guard, speed and acceleration limits take from the base's motion what eq. (6) has already counted on; left to the arm
//! it would throw it. [`opspace::ArmDynamics::torque_for_refused`]
//! gives the tool what the base does not do: `moca-lab lean` prints what is left of every lean and blow. A joint beyond
//! the arm's own speed limit, a flange beyond [`Limits`]' speed or pose error ends the law: [`Exceeded`], and the posture
//! is held.
//!
//! # Ends of the range
//! Each row is a test of `tests/extremes.rs`; `moca-lab extremes` prints condition numbers, errors and times.
//! | end | what to expect |
//! |---|---|
//! | arm upright (singular) | the direction that cannot move gets no torque; the arm folds out, and a joint that gets too fast ends the law |
//! | near it by 1e-2 … 1e-8 rad | error ≤ 16·ε·condition, bounded torques; singular to rounding at 1e-8 (f64), 1e-4 (f32) |
//! | η_B/η_A = 1e-3 … 1e3 | torques exact to 1e-14; below 0.01 the literal law lets base and servo chatter, bounded by the limits |
//! | M_v = 0.01 … 1000 kg | stable; with `null_space_damping` below 0.5 kg refused: it would chatter on any real servo |
//! | D_v = 0 | exact integration; stable in free air, never in contact with a delay ([`contact_stability`]) |
//! | steps of 0.1 … 10 ms | eq. (2) exact for D·dt/M to 1e5; later steps integrate 10 ms, limits credit one period |
//! | K_d = 1e5 N/m | rings at the torque-rate limit, flange within 1 mm, and within 0.2 mm from four starts of five |
//! | 1e4 N on a taxel | taken as `taxel_force_n`, and reported in [`LimitsHit`] |
//! | NaN or infinity in any input | [`ControlError`] naming the input; the state is as it was |
//! | quaternion q or −q | one rotation |
//! | orientation error of π | one of the two axes; its pull saturates and the reference turns at 1 rad/s |
//!
//! # What this crate refuses to know
//! A clock (time is an argument), an allocator, a port, a log, a file, the simulator, which taxel reading is still
//! fresh (the caller decides; stale is not zero), and any state but the one the caller passes in. It never hangs:
//! factorisations have a fixed size, and every iteration has a fixed bound.
//!
//! # Cost
//! `cargo bench -p moca-wbc` times steps and parts; `moca-lab tick` times them hot, cold and live, counts instructions and
//! bytes. `moca-lab bench` puts the tick next to Pinocchio's. `.ci/size` holds instructions and bytes to a file.
#![no_std]
#![forbid(unsafe_code)]
#![expect(clippy::needless_range_loop, reason = "matrix algorithms read as in the books: by index")]

#[cfg(feature = "testing")]
extern crate std;

// A room is a folder, not a module: a path does not say in which folder its file lies. A room uses those above it.

mod error;

// math/
#[path = "math/linalg.rs"]
pub mod linalg;
#[path = "math/rotation.rs"]
pub mod rotation;
#[path = "math/scalar.rs"]
mod scalar;
#[path = "math/spatial.rs"]
mod spatial;
#[path = "math/square_root/mod.rs"]
pub mod square_root;

// model/
#[path = "model/chain.rs"]
mod chain;
#[path = "model/coupled.rs"]
pub mod coupled;
#[path = "model/cover_map.rs"]
pub mod cover_map;
#[path = "model/mod.rs"]
pub mod model;
#[path = "model/momentum_observer.rs"]
pub mod momentum_observer;
#[path = "model/opspace.rs"]
pub mod opspace;

// protect/
#[path = "protect/contact_barrier/mod.rs"]
pub mod contact_barrier;
#[path = "protect/contact_stability.rs"]
pub mod contact_stability;
#[path = "protect/guard.rs"]
pub mod guard;
#[path = "protect/joint_stiffness.rs"]
pub mod joint_stiffness;
#[path = "protect/limits.rs"]
pub mod limits;
#[path = "protect/reach.rs"]
pub mod reach;
#[path = "protect/self_collision/mod.rs"]
pub mod self_collision;
#[path = "protect/state_check.rs"]
mod state_check;

// reference/
#[path = "reference/online_trajectory.rs"]
pub mod online_trajectory;
#[path = "reference/mod.rs"]
pub mod reference;
#[path = "reference/reference_generator.rs"]
pub mod reference_generator;

// law/
#[path = "law/admittance.rs"]
pub mod admittance;
#[path = "law/controller/mod.rs"]
pub mod controller;
#[path = "law/follow_me.rs"]
pub mod follow_me;
#[path = "law/gains.rs"]
mod gains;
#[path = "law/impedance.rs"]
pub mod impedance;
#[path = "law/loop_stability.rs"]
pub mod loop_stability;

#[cfg(feature = "testing")]
pub mod testing;

#[cfg(doctest)]
#[doc = include_str!("../README.md")]
struct Readme;

pub use controller::{
    ArmController, ArmInput, ArmOutput, ArmState, BaseController, BaseInput, BaseOutput, BaseState,
    ControlInput, ControlLaw, ControlOutput, ControllerState, FlangePose, Target, WholeBodyController,
};
pub use cover_map::cover_wrench;
pub use error::ControlError;
pub use gains::GAIN_FILTER_S;
pub use guard::BaseGuard;
pub use limits::{Exceeded, LimitsHit};
pub use moca_msgs::{
    ArmTable, BaseTable, Corrections, ImpedanceGains, Law, Limits, Mount, ParameterError, Parameters,
    Payload, RobotCommand, RobotPart, RobotState, TaxelPlacement, TwistAxes, robot,
};
pub use model::ArmModel;
pub use nalgebra;
pub use scalar::Scalar;
