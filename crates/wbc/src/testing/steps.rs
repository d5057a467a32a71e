//! Whole control steps to be measured: the robot of the paper around its home, moving, leant on.
//!
//! ```
//! use moca_wbc::testing::steps::{Case, Steps};
//!
//! let mut steps = Steps::new(Case::Corrected)?;
//! for robot in 0..Steps::ROBOTS {
//!     steps.step(robot)?;
//! }
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

use crate::robot::{MOCA_MOUNT, PANDA, PAPER_COVER};
use crate::{
    ControlError, ControlInput, ControlLaw, ControlOutput, ControllerState, Corrections, Parameters, Payload,
    RobotState, WholeBodyController,
};
use std::boxed::Box;
use std::error::Error;
use std::vec::Vec;

/// A law, with what it is given.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Case {
    /// Holds its posture; the robot estimates the wrench at its flange.
    HoldGiven,
    /// Holds its posture; the momentum observer estimates that wrench, as in all that follow.
    Hold,
    /// Impedance as printed in the paper.
    Literal,
    /// Impedance with every correction.
    Corrected,
    /// Follow-me.
    FollowMe,
}

impl Case {
    /// In the order in which they are shown.
    pub const ALL: [Self; 5] = [Self::HoldGiven, Self::Hold, Self::Literal, Self::Corrected, Self::FollowMe];

    /// As shown, and as asked for.
    pub const fn name(self) -> &'static str {
        match self {
            Self::HoldGiven => "hold-given",
            Self::Hold => "hold",
            Self::Literal => "literal",
            Self::Corrected => "corrected",
            Self::FollowMe => "follow-me",
        }
    }

    /// The case of this name.
    pub fn named(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|case| case.name() == name)
    }
}

type Controller = WholeBodyController<7, 11>;

/// A controller, and robots in different postures with their states.
#[derive(Clone, Debug)]
pub struct Steps {
    controller: Controller,
    law: ControlLaw,
    robots: Vec<(ControlInput<7, 11>, ControllerState<7>)>,
}

impl Steps {
    /// Number of robots.
    pub const ROBOTS: usize = 32;

    /// Every robot a few steps after it has entered the law.
    ///
    /// # Errors
    /// None that the tables of this crate give.
    pub fn new(case: Case) -> Result<Self, Box<dyn Error>> {
        let all =
            Corrections { null_space_damping: true, base_coupling: true, flange_wrench_feedforward: true };
        let (law, corrections) = match case {
            Case::HoldGiven | Case::Hold => (ControlLaw::Hold, Corrections::LITERAL),
            Case::Literal => (ControlLaw::Impedance, Corrections::LITERAL),
            Case::Corrected => (ControlLaw::Impedance, all),
            Case::FollowMe => (ControlLaw::FollowMe, Corrections::LITERAL),
        };
        let parameters = Parameters { corrections, ..Parameters::PAPER };
        let controller = Controller::new(&PANDA, &MOCA_MOUNT, &Payload::NONE, &PAPER_COVER, &parameters)?;
        let mut random = 1_u32;
        let mut about_zero = || {
            random = random.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            f64::from(random) / f64::from(u32::MAX) - 0.5
        };
        let mut robots = Vec::new();
        for _ in 0..Self::ROBOTS {
            let robot = RobotState {
                base_pose_world: [0.3, -0.2, 0.4],
                base_velocity_world: [0.1, -0.05, 0.2],
                q_rad: PANDA.home_rad.map(|q| q + 0.6 * about_zero()),
                dq_rad_s: core::array::from_fn(|_| 0.2 * about_zero()),
                torque_measured_nm: [0.0; 7],
                flange_wrench_world: (case == Case::HoldGiven).then_some([1.0; 6]),
            };
            robots.push((ControlInput::new(robot, [2.0; 11], 1e-3), controller.enter(law, &robot)?));
        }
        let mut steps = Self { controller, law, robots };
        for robot in 0..3 * Self::ROBOTS {
            steps.step(robot % Self::ROBOTS)?;
        }
        Ok(steps)
    }

    /// One step of one robot.
    ///
    /// # Errors
    /// None of these robots'.
    #[inline]
    pub fn step(&mut self, robot: usize) -> Result<ControlOutput<7>, ControlError> {
        let (input, state) = &mut self.robots[robot];
        self.controller.step(self.law, state, core::hint::black_box(input))
    }
}
