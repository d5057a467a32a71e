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

use crate::contact_barrier::{BarrierInput, BarrierSettings, ContactBarrier, FoamCurve, TaxelSample};
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
    /// Impedance with every correction under a contact barrier that nobody touches, as in the next two.
    BarrierNobody,
    /// T6 is touched.
    BarrierTouched,
    /// T2 and T9 are pressed against each other, so that no way keeps both rows.
    BarrierBetween,
}

impl Case {
    /// In the order in which they are shown.
    pub const ALL: [Self; 8] = [
        Self::HoldGiven,
        Self::Hold,
        Self::Literal,
        Self::Corrected,
        Self::FollowMe,
        Self::BarrierNobody,
        Self::BarrierTouched,
        Self::BarrierBetween,
    ];

    /// As shown, and as asked for.
    pub const fn name(self) -> &'static str {
        match self {
            Self::HoldGiven => "hold-given",
            Self::Hold => "hold",
            Self::Literal => "literal",
            Self::Corrected => "corrected",
            Self::FollowMe => "follow-me",
            Self::BarrierNobody => "barrier-nobody",
            Self::BarrierTouched => "barrier-touched",
            Self::BarrierBetween => "barrier-between",
        }
    }

    /// Returns each taxel's force under a barrier, N.
    fn felt_n(self) -> Option<[f64; 11]> {
        let pressed: &[usize] = match self {
            Self::BarrierNobody => &[],
            Self::BarrierTouched => &[5],
            Self::BarrierBetween => &[1, 8],
            _ => return None,
        };
        Some(core::array::from_fn(|i| if pressed.contains(&i) { 20.0 } else { 0.0 }))
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
    robots: Vec<Robot>,
}

#[derive(Clone, Debug)]
struct Robot {
    input: ControlInput<7, 11>,
    state: ControllerState<7>,
    felt: Option<Felt>,
}

/// Readings of a cover with a barrier.
#[derive(Clone, Debug)]
struct Felt {
    barrier: ContactBarrier<11>,
    force_n: [f64; 11],
    /// Steps that the robot has gone: of 250 readings a second one step in four has a new one.
    steps: u32,
}

impl Felt {
    fn new(force_n: [f64; 11], steps: u32) -> Result<Self, Box<dyn Error>> {
        let foam = FoamCurve::Hyperbolic { stiffness_n_m: 2105.0, thickness_m: 0.015 };
        let barrier = ContactBarrier::new(&PAPER_COVER, &BarrierSettings::new(foam, foam, 25.0, 0.015)?)?;
        Ok(Self { barrier, force_n, steps })
    }

    #[inline]
    fn limit(&mut self, input: &mut ControlInput<7, 11>) -> Result<(), ControlError> {
        self.steps += 1;
        let age_s = f64::from(3 + self.steps % 4) * input.dt_s;
        let samples = self.force_n.map(|force_n| Some(TaxelSample { force_n, age_s }));
        // in the axes of W: what a step costs does not depend on it
        let velocity = input.robot.base_velocity_world;
        let measured = BarrierInput::new(samples, velocity, [3.0, 3.0, 6.0], input.dt_s);
        let contacts = self.barrier.update(&measured)?;
        input.taxel_force_n = contacts.force_n;
        input.guard.outward_m_s = Some(contacts.outward_m_s);
        Ok(())
    }
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
            Case::Corrected | Case::BarrierNobody | Case::BarrierTouched | Case::BarrierBetween => {
                (ControlLaw::Impedance, all)
            }
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
        for number in 0..Self::ROBOTS {
            let robot = RobotState {
                base_pose_world: [0.3, -0.2, 0.4],
                base_velocity_world: [0.1, -0.05, 0.2],
                q_rad: PANDA.home_rad.map(|q| q + 0.6 * about_zero()),
                dq_rad_s: core::array::from_fn(|_| 0.2 * about_zero()),
                torque_measured_nm: [0.0; 7],
                flange_wrench_world: (case == Case::HoldGiven).then_some([1.0; 6]),
            };
            robots.push(Robot {
                input: ControlInput::new(robot, [2.0; 11], 1e-3),
                state: controller.enter(law, &robot)?,
                felt: case.felt_n().map(|force_n| Felt::new(force_n, u32::try_from(number)?)).transpose()?,
            });
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
        let Robot { input, state, felt } = &mut self.robots[robot];
        if let Some(felt) = felt {
            felt.limit(input)?;
        }
        self.controller.step(self.law, state, core::hint::black_box(input))
    }
}
