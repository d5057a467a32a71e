//! Makes the parts of a tick as the configuration asks for them.

use crate::config::{Config, contact_limits};
use crate::law::Motion;
use crate::protection::Protection;
use crate::robot::{PlantKind, TAXELS};
use crate::supervisor::{Automatic, Supervisor};
use anyhow::{Context, Result};
use moca_tactile::CoverConfig;

/// The supervisor that the configuration asks for.
pub fn supervisor(config: &Config) -> Supervisor {
    let simulated = config.plant.kind == PlantKind::Simulated;
    let automatic = Automatic { tare: config.startup.tare, arm: config.startup.arm && simulated };
    let supervisor = Supervisor::new(config.startup.law, automatic);
    if config.plant.kind == PlantKind::None { supervisor.without_robot() } else { supervisor }
}

/// The cover that the configuration asks for.
///
/// # Errors
/// The calibration file cannot be used.
pub fn cover_config(config: &Config) -> Result<CoverConfig<TAXELS>> {
    config.cover().with_context(|| format!("board.calibration = {:?}", config.board.calibration))
}

/// The controller and the protection that the configuration asks for.
///
/// # Errors
/// A parameter outside its range, every mistake in the file of contact limits.
pub fn motion(config: &Config) -> Result<Motion> {
    let thresholds = &config.protection.thresholds;
    let limits = if thresholds.is_empty() {
        [contact_limits::ContactLimits::default(); TAXELS]
    } else {
        contact_limits::load(thresholds.as_ref(), config.robot.cover.count())?
    };
    Ok(Motion::new(config, Protection::new(config, limits)?)?)
}
