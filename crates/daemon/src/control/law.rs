//! From mode and forces to a command: which law runs in which mode.

use crate::config::{JOINTS, Parts, TAXELS};
use crate::control::cover::CoverState;
use crate::control::protection::{Protected, Protection};
use moca_msgs::params::CONTROLLER;
use moca_msgs::{
    Actuation, Fault, Mode, Outcome, ParameterValues, Parameters, Refusal, RobotState, TaxelStatus,
};
use moca_wbc::{ControlError, ControlInput, ControlLaw, ControlOutput, Controller, ControllerState};

/// The controller with the state it carries from tick to tick.
pub struct Motion {
    controller: Controller<JOINTS, TAXELS>,
    parameters: Parameters<JOINTS>,
    protection: Protection,
    parts: Parts,
    state: Option<ControllerState<JOINTS>>,
}

impl Motion {
    /// Not yet entered: the first command starts from the measured state. `parameters` are those of `controller`.
    pub const fn new(
        controller: Controller<JOINTS, TAXELS>,
        parameters: Parameters<JOINTS>,
        protection: Protection,
        parts: Parts,
    ) -> Self {
        Self { controller, parameters, protection, parts, state: None }
    }

    /// Which parts of the robot it moves.
    pub const fn parts(&self) -> Parts {
        self.parts
    }

    /// What protects the people around the base in the tick at `now_ns`; once a tick, before [`Motion::command`].
    ///
    /// # Errors
    /// [`Fault::ControlRefused`] for a speed that is none, which the configuration's check keeps away.
    pub fn protect(&mut self, now_ns: u64, cover: &CoverState, mode: Mode) -> Result<Protected, Fault> {
        let protected = if self.parts.has_cover() {
            self.protection.update(now_ns, cover, &self.parameters.limits, mode.moves())
        } else {
            Protected::default()
        };
        self.controller.set_guard(protected.guard).map_err(|_| Fault::ControlRefused)?;
        Ok(protected)
    }

    /// Speed of the fastest point of the cover at the base's measured velocity, m/s; 0 without a cover.
    pub fn cover_speed_m_s(&self, robot: &RobotState<JOINTS>) -> f64 {
        if self.parts.has_cover() { self.protection.cover_speed_m_s(robot) } else { 0.0 }
    }

    /// Changes a parameter (its number in [`CONTROLLER`]) from the next step on; gains reach the law through a filter.
    ///
    /// # Errors
    /// No such parameter, not live, out of range, or at odds with another one; nothing is changed.
    pub fn set_parameter(&mut self, number: usize, values: &ParameterValues) -> Outcome {
        match CONTROLLER.get(number) {
            Some(spec) if spec.live => {}
            Some(_) => return Err(Refusal::NotLive),
            None => return Err(Refusal::NoSuchParameter),
        }
        let mut wanted = self.parameters;
        wanted.set(number, values)?;
        self.controller.set_parameters(&wanted).map_err(|_| Refusal::Conflict)?;
        self.parameters = wanted;
        Ok(())
    }

    /// Forgets targets and controller state: the next command is entered anew from the measured state.
    pub fn leave(&mut self) {
        self.state = None;
    }

    /// Moves the target of the running law with `twist` \[m/s; rad/s\], axes of the law's reference, until told
    /// otherwise. A law that has not been entered yet has no target to move.
    ///
    /// # Errors
    /// A value that is not finite.
    pub fn set_target_twist(&mut self, twist: [f64; 6]) -> Result<(), ControlError> {
        self.state.as_mut().map_or(Ok(()), |state| state.set_target_twist(twist))
    }

    /// One tick's command in `mode`, `dt_s` after the last one.
    ///
    /// # Errors
    /// The fault to stop with; the order of that tick must then be [`Actuation::Brake`].
    pub fn command(
        &mut self,
        mode: Mode,
        robot: &RobotState<JOINTS>,
        forces: &Result<[f64; TAXELS], (usize, TaxelStatus)>,
        dt_s: f64,
    ) -> Result<ControlOutput<JOINTS>, Fault> {
        let law = match mode {
            Mode::Impedance => ControlLaw::Impedance,
            Mode::FollowMe => ControlLaw::FollowMe,
            Mode::Starting | Mode::Taring | Mode::Ready | Mode::ProtectiveStop | Mode::Fault => {
                ControlLaw::Hold
            }
        };
        // Standing still needs no cover; a law never runs on a force that is not there.
        let taxel_force_n = match (law, *forces) {
            (ControlLaw::Hold, _) => [0.0; TAXELS],
            (_, Ok(forces)) => forces,
            (_, Err((taxel, status))) => {
                return Err(Fault::TaxelInvalid { taxel: u8::try_from(taxel).unwrap_or(u8::MAX), status });
            }
        };
        let state = match &mut self.state {
            Some(state) => state,
            None => self.state.insert(self.controller.enter(law, robot).map_err(|_| Fault::StateInvalid)?),
        };
        let input = ControlInput { robot: *robot, taxel_force_n, flange_wrench_world: None, dt_s };
        let output = match (self.parts, law) {
            (Parts::Whole, _) | (Parts::Arm, ControlLaw::Hold) => self.controller.step(law, state, &input),
            // On a stand the flange's place in the world and on the base are one.
            (Parts::Arm, _) => self.controller.step(ControlLaw::FollowMe, state, &input),
            (Parts::Base, _) => self.controller.step_base(law, state, &input),
        };
        output.map_err(|_| Fault::ControlRefused)
    }
}

/// The order that carries a controller's output, or the brake when there is none.
pub fn actuation(output: Option<&ControlOutput<JOINTS>>) -> Actuation<JOINTS> {
    output.map_or(Actuation::Brake, |output| Actuation::Drive(output.command))
}
