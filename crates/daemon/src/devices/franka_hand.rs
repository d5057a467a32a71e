//! The Franka Hand as a gripper of the loop.

use crate::config::Config;
use crate::devices::gripper::{Gripper, GripperThread};
use crate::robot::GripperKind;
use anyhow::{Context, Result};
use moca_franka::Hand;
use moca_msgs::gripper::{FRANKA_HAND, GripperTable};
use moca_msgs::{GripperRequest, GripperState};

impl Gripper for Hand {
    fn table(&self) -> GripperTable {
        FRANKA_HAND
    }

    fn begin(&mut self, request: &GripperRequest) {
        Self::begin(self, request);
    }

    fn read(&mut self) -> Option<GripperState> {
        Self::read(self)
    }
}

/// Begins to reach the hand of the configured arm, if there is one; `say` hears in words what happens to the connection.
///
/// # Errors
/// A thread that cannot be started.
pub(crate) fn connect(
    config: &Config,
    say: impl FnMut(&str) + Send + 'static,
) -> Result<Option<GripperThread>> {
    if config.plant.gripper != GripperKind::Fci {
        return Ok(None);
    }
    // The arm's address may have a port, and the hand has another.
    let host = config.plant.arm.host.split(':').next().unwrap_or_default();
    GripperThread::spawn(Hand::new(host, say)).map(Some).context("the gripper's thread")
}
