//! `mocad gripper home | move | grasp | release | stop | state`: the gripper of a running robot.
#![expect(clippy::print_stdout, reason = "this module is what the user sees on the terminal")]

use crate::cli::operator::{Arguments, Operator, interrupted};
use crate::cli::remote::{LOOK_EVERY, news};
use anyhow::{Result, bail};
use clap::{Args, Subcommand};
use moca_msgs::{GripperPhase, GripperRefusal, GripperRequest, GripperState, Request};
use std::fmt;
use std::sync::atomic::Ordering;

pub(crate) const EXIT_CODES: &str =
    "Exit codes of `grasp` and `state`: 0 an object is held, 7 none is. Ctrl-C stops the fingers.";

/// Request to the gripper.
#[derive(Subcommand)]
pub enum Command {
    /// Open, close and open the fingers to find their range. It lets go of an object.
    Home(Arguments),
    /// Move the fingers to a width. A larger one than the object's lets go of it.
    Move(MoveArguments),
    /// Close the fingers on an object and hold it. It stays held when this program ends.
    Grasp(GraspArguments),
    /// Open the fingers as far as they go.
    Release(Arguments),
    /// Stop the fingers. An object that is held stays held.
    Stop(Arguments),
    /// Say what the gripper does.
    State(Arguments),
}

/// Numbers of a motion.
#[derive(Args)]
pub struct MoveArguments {
    /// Distance between the fingers, m; a Franka Hand: 0 to 0.08.
    #[arg(value_name = "WIDTH", allow_negative_numbers = true)]
    width_m: f64,
    /// Change of that distance, m/s; a Franka Hand: 0.001 to 0.1.
    #[arg(long, value_name = "SPEED", allow_negative_numbers = true, default_value_t = 0.05)]
    speed: f64,
    #[command(flatten)]
    common: Arguments,
}

/// Numbers of a grasp.
#[derive(Args)]
pub struct GraspArguments {
    #[command(flatten)]
    to: MoveArguments,
    /// Force of each finger, N; a Franka Hand: 1 to 70.
    #[arg(long, value_name = "FORCE", allow_negative_numbers = true, default_value_t = 40.0)]
    force: f64,
    /// Largest difference between WIDTH and the object's, m; a Franka Hand: 0.0001 to 0.08.
    #[arg(long, value_name = "TOLERANCE", allow_negative_numbers = true, default_value_t = 0.005)]
    tolerance: f64,
    /// Mass of the object, which the arm carries from the moment in which it is held, kg; a Franka Hand: 0 to 2.27; 0: not told.
    #[arg(long, value_name = "MASS", allow_negative_numbers = true, default_value_t = 0.0)]
    mass: f64,
}

/// The gripper holds nothing: exit code 7.
#[derive(Debug)]
pub struct HoldsNothing(GripperState);

impl fmt::Display for HoldsNothing {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "the gripper holds nothing: {}", self.0)
    }
}

impl std::error::Error for HoldsNothing {}

/// Carries out one command.
///
/// # Errors
/// No daemon or no answer; refused, with the reason; [`HoldsNothing`] after a grasp and for a state.
pub(crate) fn run(command: &Command) -> Result<()> {
    match command {
        Command::Home(common) => request(GripperRequest::Home, common),
        Command::Move(MoveArguments { width_m, speed, common }) => {
            request(GripperRequest::Move { width_m: *width_m, speed_m_s: *speed }, common)
        }
        Command::Grasp(GraspArguments { to, force, tolerance, mass }) => {
            let &MoveArguments { width_m, speed: speed_m_s, ref common } = to;
            let (force_n, tolerance_m, mass_kg) = (*force, *tolerance, *mass);
            request(GripperRequest::Grasp { width_m, speed_m_s, force_n, tolerance_m, mass_kg }, common)
        }
        Command::Release(common) => request(GripperRequest::Release, common),
        Command::Stop(common) => request(GripperRequest::Stop, common),
        Command::State(common) => {
            let operator = Operator::look_on(common)?;
            held(state(&operator)?, operator.json())
        }
    }
}

/// Returns the newest state of the gripper.
fn state(operator: &Operator) -> Result<GripperState> {
    let update = news(operator.connection(), |_| true)?;
    match update.samples.last().and_then(|sample| sample.gripper) {
        Some(state) => Ok(state),
        None => bail!(GripperRefusal::NoGripper.to_string()),
    }
}

/// Asks, and waits until the fingers rest.
fn request(asked: GripperRequest, common: &Arguments) -> Result<()> {
    let ended = interrupted()?;
    let operator = Operator::connect(common)?;
    let before = state(&operator).map_or(0, |state| state.requests);
    operator.ask(Request::Gripper(asked)).inspect_err(|_| operator.connection().release())?;
    let state = loop {
        let update = operator.stay()?;
        let latest = update.samples.last().and_then(|sample| sample.gripper);
        // Samples from before the answer may come after it.
        let begun = latest.filter(|state| state.requests != before || state.phase == GripperPhase::Unknown);
        if let Some(state) = begun.filter(|state| state.phase != GripperPhase::Moving) {
            break state;
        }
        if ended.load(Ordering::Relaxed) {
            let stopped = operator.ask(Request::Gripper(GripperRequest::Stop));
            operator.connection().release();
            return stopped.and_then(|()| bail!("interrupted: the fingers were stopped"));
        }
        std::thread::sleep(LOOK_EVERY);
    };
    operator.connection().release();
    if matches!(asked, GripperRequest::Grasp { .. }) {
        return held(state, operator.json());
    }
    if let Some(fault) = state.fault {
        bail!("{fault}");
    }
    show(state, operator.json());
    Ok(())
}

/// Prints the state; it is an error where nothing is held.
fn held(state: GripperState, json: bool) -> Result<()> {
    if state.is_holding() || json {
        show(state, json);
    }
    if state.is_holding() { Ok(()) } else { Err(HoldsNothing(state).into()) }
}

fn show(state: GripperState, json: bool) {
    if json {
        println!("{}", super::status::gripper_json(&state));
    } else {
        println!("{state}");
    }
}
