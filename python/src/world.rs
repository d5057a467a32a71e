//! The simulated robot behind `Simulation` and `Batch`: the loop in lock-step, with or without a cover.

use anyhow::{Result, ensure};
use moca_control::config::Config;
use moca_control::plant::Plant;
use moca_control::tick::Ticked;
use moca_experiments::settings::Settings;
use moca_lockstep::simulated_robot::free_scene;
use moca_lockstep::touch_board::ByteCover;
use moca_lockstep::virtual_boards::board_config;
use moca_lockstep::{LockStep, MemoryBoards, NoCover};
use moca_msgs::{GripperState, Law, Request};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use std::path::Path;

/// A robot, its cover and its law, on the cheapest engine that can run it. Any thread may step it; the bits do not depend on the
/// thread.
pub(crate) enum World {
    Covered(Box<LockStep<ByteCover, MemoryBoards>>),
    Bare(Box<LockStep<Option<ByteCover>, NoCover>>),
}

impl World {
    /// # Errors
    /// A scene, board or parameter outside its range.
    pub(crate) fn new(config: &Config) -> Result<Self, String> {
        let mut scene = free_scene(config);
        scene.engine = scene.needed_engine();
        let world = if config.plant.parts.has_cover() {
            LockStep::with_board(config, &scene, board_config(config), None)
                .map(|world| Self::Covered(Box::new(world)))
        } else {
            LockStep::without_cover(config, &scene).map(|world| Self::Bare(Box::new(world)))
        };
        world.map_err(|error| format!("{error:#}"))
    }

    /// Steps one tick.
    pub(crate) fn tick(&mut self, request: Option<Request>) -> &Ticked {
        match self {
            Self::Covered(world) => world.tick(request),
            Self::Bare(world) => world.tick(request),
        }
    }

    /// Returns what the gripper reports now; `None` without one.
    pub(crate) fn gripper(&mut self) -> Option<GripperState> {
        match self {
            Self::Covered(world) => world.control.plant.gripper(),
            Self::Bare(world) => world.control.plant.gripper(),
        }
    }
}

/// The configuration in a file or in a text, or the built-in one.
///
/// # Errors
/// A missing file is Python's own exception, a mistake in it a `ValueError`.
pub(crate) fn configuration(path: Option<&Path>, toml: Option<&str>) -> PyResult<Config> {
    let wrong = |error: String| PyValueError::new_err(error);
    match (path, toml) {
        (None, None) => Ok(Config::default()),
        (Some(path), None) => {
            std::fs::metadata(path)
                .map_err(|error| std::io::Error::new(error.kind(), format!("{}: {error}", path.display())))?;
            Config::load(path).map_err(|error| wrong(format!("{}:\n{error}", path.display())))
        }
        (None, Some(text)) => Config::parse(text).map_err(|error| wrong(error.to_string())),
        (Some(_), Some(_)) => Err(wrong("a file or a text, not both".into())),
    }
}

/// The configuration with assignments as of `moca-lab experiment --set`.
///
/// # Errors
/// An unknown key, a value outside its range, or a key of what only an experiment has, such as a person.
pub(crate) fn varied(config: &Config, assignments: &[String]) -> Result<Config> {
    let mut settings = Settings::paper(Law::Impedance);
    settings.config = config.clone();
    let mut rest = settings.clone();
    for assignment in assignments {
        settings.set(assignment)?;
        rest.config = settings.config.clone();
        ensure!(
            settings == rest,
            "{assignment}: only an experiment has this; allowed: rows of the configuration"
        );
    }
    settings.check()?;
    Ok(settings.config)
}
