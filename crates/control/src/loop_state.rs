//! Memory of the loop between ticks that is not in the configuration: plain data that can be copied. A replay that begins in
//! the middle of a run begins with it.

use crate::barrier::{BarrierMemory, DoubtfulWay};
use crate::base_watch::BaseWatchState;
use crate::compensation::CompensationState;
use crate::flange_sensor::FlangeState;
use crate::foam_recovery::FoamRecovery;
use crate::protection::ProtectionState;
use crate::recentre::RecentreState;
use crate::robot::{JOINTS, TAXELS};
use crate::state_check::StateCheck;
use crate::supervisor::Supervisor;
use crate::targets::TargetsState;
use crate::uncalibrated::PushCapState;
use crate::uncovered::UncoveredState;
use moca_msgs::Parameters;
use moca_msgs::robot::LinkInertial;
use moca_tactile::Cover;
use moca_wbc::{ArmState, BaseState, ControllerState};
use serde::{Deserialize, Serialize};

/// Everything. It lives on the stack or in a ring: taking one allocates nothing.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct LoopState {
    /// The last measured state.
    pub state_check: StateCheck,
    /// The mode and what led to it.
    pub supervisor: Supervisor,
    /// A real arm is on its own controller.
    pub arm_released: bool,
    /// The law, its live parameters and what protects people.
    pub motion: MotionState,
    /// The cover behind a board, with its zero; `None` where there is none.
    pub cover: Option<Cover<TAXELS>>,
}

/// Memory of the controller and of the protection.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct MotionState {
    pub(super) controller: ControllerMemory,
    /// As the run has changed them; the period is the configuration's.
    #[serde(with = "by_number")]
    pub(super) parameters: Parameters<JOINTS>,
    pub(super) protection: ProtectionState,
    pub(super) barrier: Option<BarrierMemory>,
    pub(super) push_cap: Option<PushCapState>,
    pub(super) base_watch: Option<BaseWatchState>,
    pub(super) uncovered: Option<UncoveredState>,
    pub(super) targets: TargetsState,
    pub(super) recentre: RecentreState,
    pub(super) recovery: Option<FoamRecovery>,
    pub(super) compensation: Option<CompensationState>,
    /// Behind all else in a log.
    #[serde(skip)]
    pub beyond: Beyond,
}

/// Memory of what few robots have; a log of a robot without it keeps the form of those before there was any.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Beyond {
    /// Zero of the flange sensor.
    pub flange: Option<FlangeState>,
    /// Object in the hand, flange's axes.
    pub object: Option<LinkInertial>,
    /// Room that a late base made for doubtful touches.
    pub doubtful_way: Option<DoubtfulWay>,
}

/// Memory of the controller of a robot's parts: one variant each, with its conversions to and from a controller's own state.
macro_rules! memories {
    ($($name:ident($state:ty),)*) => {
        /// Memory of the controller of a robot's parts, for arms of each number of joints.
        #[derive(Clone, Copy, Debug, Serialize, Deserialize)]
        pub(super) enum ControllerMemory {
            $($name($state),)*
        }

        $(
            impl From<$state> for ControllerMemory {
                fn from(state: $state) -> Self {
                    Self::$name(state)
                }
            }

            impl TryFrom<&ControllerMemory> for $state {
                type Error = OtherRobot;

                fn try_from(memory: &ControllerMemory) -> Result<Self, OtherRobot> {
                    if let ControllerMemory::$name(state) = memory { Ok(*state) } else { Err(OtherRobot) }
                }
            }

            impl Memory for $state {}
        )*
    };
}

memories! {
    Whole6(Option<ControllerState<6>>),
    Whole7(Option<ControllerState<7>>),
    Base(BaseState),
    Arm6(Option<ArmState<6>>),
    Arm7(Option<ArmState<7>>),
}

/// State of a controller that a [`ControllerMemory`] can hold.
pub(super) trait Memory:
    Copy + Into<ControllerMemory> + for<'a> TryFrom<&'a ControllerMemory, Error = OtherRobot>
{
}

/// The state is that of a robot with other parts, joints or parameters.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct OtherRobot;

impl std::fmt::Display for OtherRobot {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str("the state of the loop is that of a robot with other parts, joints or parameters")
    }
}

impl std::error::Error for OtherRobot {}

/// Parameters as a list, in the order of their numbers.
mod by_number {
    use crate::robot::JOINTS;
    use moca_msgs::params::CONTROLLER;
    use moca_msgs::{ParameterValues, Parameters};
    use serde::de::{Deserialize, Deserializer, Error};
    use serde::ser::Serializer;

    pub(super) fn serialize<S: Serializer>(
        parameters: &Parameters<JOINTS>,
        serializer: S,
    ) -> Result<S::Ok, S::Error> {
        serializer.collect_seq((0..CONTROLLER.len()).map(|number| parameters.get(number).unwrap_or_default()))
    }

    pub(super) fn deserialize<'de, D: Deserializer<'de>>(
        deserializer: D,
    ) -> Result<Parameters<JOINTS>, D::Error> {
        let mut parameters = Parameters::PAPER.resized();
        for (number, values) in Vec::<ParameterValues>::deserialize(deserializer)?.iter().enumerate() {
            parameters.set(number, values).map_err(|_| D::Error::custom(format!("parameter {number}")))?;
        }
        Ok(parameters)
    }
}
