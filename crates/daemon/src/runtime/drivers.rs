//! Which of its robots a configuration wants driven, and whether this build can.

use crate::config::Config;
use crate::robot::{ArmDriver, BaseDriver, FlangeSensorKind, PlantKind};
use anyhow::{Result, bail};

/// A real robot that `mocad` drives.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Driven {
    /// A Franka arm, on a stand or a simulated base.
    Arm,
    /// A simulated arm on a base behind ROS 2.
    SimulatedArm,
    /// A base behind ROS 2, no arm.
    Base,
    /// A Franka arm on a base behind ROS 2.
    Whole,
}

/// Returns the robot that `plant.kind = "robot"` means.
///
/// # Errors
/// Parts and drivers that do not go together.
pub(crate) fn driven(config: &Config) -> Result<Driven> {
    let plant = &config.plant;
    if plant.flange_sensor == FlangeSensorKind::Own {
        bail!(
            "plant.flange_sensor = \"own\": `mocad` has no driver of a flange sensor; a program with one runs the loop with \
             `moca_daemon::runtime::run::with_plant`, and for `mocad` it is \"none\""
        );
    }
    let (arm, on_a_base) = (plant.parts.has_arm(), plant.parts.has_cover());
    Ok(match (plant.arm.driver, plant.base.driver) {
        (ArmDriver::Fci, _) if arm && !on_a_base => Driven::Arm,
        (ArmDriver::Fci, BaseDriver::Simulated) if arm => Driven::Arm,
        (ArmDriver::Fci, BaseDriver::Ros2) if arm => Driven::Whole,
        (ArmDriver::Simulated, BaseDriver::Ros2) if arm && on_a_base => Driven::SimulatedArm,
        (_, BaseDriver::Ros2) if !arm => Driven::Base,
        _ => bail!(
            "plant.kind = \"robot\": `mocad` drives an arm (plant.arm.driver = \"fci\") on a stand (plant.parts = \"arm\"), on \
             a base that is simulated or real (plant.base.driver = \"simulated\" or \"ros2\"), a simulated arm (plant.arm.driver = \
             \"simulated\") on a real base, or a base alone (plant.parts = \"base\"); a program with a driver of its own runs the loop with `moca_daemon::runtime::run::with_plant`"
        ),
    })
}

/// Checks that this build has the drivers and the access of a configuration.
///
/// # Errors
/// What it lacks, with the features to build it with.
pub fn check_build(config: &Config) -> Result<()> {
    let (port, tls) = (&config.board.port, &config.telemetry.tls);
    if !tls.is_empty() && !cfg!(feature = "tls") {
        bail!(
            "telemetry.tls = \"{tls}\" needs a build with the feature `tls` (cargo build --release --features tls); with \"\" \
             programs of other machines have no access"
        );
    }
    if config.plant.parts.has_cover() && !port.are_simulated() && !cfg!(feature = "board") {
        bail!(
            "board.port = \"{port}\" needs a build with the feature `board` (cargo build --release --features board); an arm \
             without a cover (plant.parts = \"arm\") needs no board"
        );
    }
    match config.plant.kind {
        PlantKind::None => Ok(()),
        PlantKind::Simulated if cfg!(feature = "sim") => Ok(()),
        PlantKind::Simulated => bail!(
            "plant.kind = \"simulated\" needs a build with the feature `sim` (cargo run --release); this build has no \
             simulation{}",
            if cfg!(feature = "board") { " and runs a Touch Board alone: plant.kind = \"none\"" } else { "" }
        ),
        PlantKind::Robot => {
            let (fci, ros2, sim) = (cfg!(feature = "fci"), cfg!(feature = "ros2"), cfg!(feature = "sim"));
            match driven(config)? {
                Driven::Arm if !fci => bail!(
                    "plant.arm.driver = \"fci\" needs a build with the feature `fci` (cargo build --release --features fci)"
                ),
                Driven::Base if !ros2 => bail!(
                    "plant.base.driver = \"ros2\" needs a build with the feature `ros2` (cargo build --release --features ros2)"
                ),
                Driven::Whole if !(fci && ros2) => bail!(
                    "plant.arm.driver = \"fci\" on plant.base.driver = \"ros2\" needs a build with both features (cargo build \
                     --release --features fci,ros2)"
                ),
                Driven::SimulatedArm if !(sim && ros2) => bail!(
                    "plant.arm.driver = \"simulated\" on plant.base.driver = \"ros2\" needs a build with both features (cargo \
                     build --release --features sim,ros2)"
                ),
                Driven::Arm | Driven::Base | Driven::Whole | Driven::SimulatedArm => Ok(()),
            }
        }
    }
}
