//! A base with a cover: eq. (2) on anything that is driven by velocities.

use super::lead::BaseLead;
use super::{LONGEST_STEP_S, check};
use crate::admittance::admitted;
use crate::error::{ControlError, finite};
use crate::gains::BaseGains;
use crate::guard::{BaseGuard, CoverOutline};
use crate::limits::{BaseLimits, LimitsHit};
use crate::rotation::Heading;
use crate::scalar::{Scalar, of};
use crate::state_check::check_step;
use moca_msgs::{ParameterError, Parameters, TaxelPlacement};

/// Admittance of a base under a cover of up to `K` taxels.
///
/// ```
/// use moca_wbc::robot::PAPER_COVER;
/// use moca_wbc::{BaseController, BaseInput, BaseGuard, Parameters};
///
/// let controller: BaseController<11> = BaseController::new(&PAPER_COVER, &Parameters::PAPER)?;
/// let mut state = controller.enter();
/// let mut input = BaseInput { yaw_world_rad: 0.0, taxel_force_n: [0.0; 11], guard: BaseGuard::NONE, dt_s: 1e-3 };
/// input.taxel_force_n[5] = 20.0; // a hand on T6, in front
/// let output = controller.step(&mut state, &input)?;
/// assert!(output.velocity_body[0] < 0.0, "the base gives way backwards");
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Clone, Copy, Debug)]
pub struct BaseController<const K: usize, T = f64> {
    outline: CoverOutline<K, T>,
    pub(super) gains: BaseGains<T>,
    pub(super) limits: BaseLimits<T>,
}

/// Memory of a [`BaseController`] between steps.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct BaseState<T = f64> {
    pub(super) gains: BaseGains<T>,
    /// v_d of eq. (2) as last commanded: axes of B.
    pub(super) velocity_body: [T; 3],
    /// External lead of the base.
    pub(super) lead: Option<BaseLead<T>>,
}

impl<T: Scalar> BaseState<T> {
    /// Drives the base with `velocity_body` (axes of B: m/s, m/s, rad/s) until told otherwise: what the cover feels is
    /// added to it. It is reached within the base's speed limits at 1 m/s² and rad/s², 10 m/s³ and rad/s³.
    ///
    /// # Errors
    /// A value that is not finite.
    pub fn lead(&mut self, velocity_body: [T; 3]) -> Result<(), ControlError> {
        finite("target base velocity", &velocity_body)?;
        let lead = self.lead.unwrap_or_else(BaseLead::at_rest);
        self.lead = Some(lead.to(velocity_body));
        Ok(())
    }

    /// Moves what leads the base on by one step: its velocity (axes of B) before and after; `None` without one.
    pub(super) fn advance_lead(&mut self, velocity_max: &[T; 3], dt_s: T) -> Option<([T; 3], [T; 3])> {
        let lead = self.lead.as_mut()?;
        let (before, after, ended) = lead.advance(velocity_max, dt_s);
        if ended {
            self.lead = None;
        }
        Some((before, after))
    }
}

/// One step's measurements of a base.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct BaseInput<const K: usize, T = f64> {
    /// Heading of B in W, rad.
    pub yaw_world_rad: T,
    /// Compression force of each taxel, N, T1 first; what is beyond the last taxel is not looked at.
    pub taxel_force_n: [T; K],
    /// Guard of the people around the base in this step.
    pub guard: BaseGuard<K, T>,
    /// Time since the last step, s, > 0.
    pub dt_s: T,
}

/// One step's result.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct BaseOutput<T = f64> {
    /// Velocity command, axes of B: m/s, m/s, rad/s.
    pub velocity_body: [T; 3],
    /// Cover wrench, eq. (4): \[N, N, N·m\] in B about its origin.
    pub cover_wrench_base: [T; 3],
    /// Limits that were met.
    pub limits: LimitsHit,
}

impl<const K: usize, T: Scalar> BaseController<K, T> {
    /// Builds the controller. Of the parameters only the base's are used: virtual mass and damping, reactivity, limits of base and taxels.
    ///
    /// # Errors
    /// The first number of the table or of the parameters that is not finite or out of range.
    pub fn new<const N: usize>(
        taxels: &[TaxelPlacement],
        parameters: &Parameters<N>,
    ) -> Result<Self, ParameterError> {
        check(parameters)?;
        Ok(Self {
            outline: CoverOutline::new(taxels)?,
            gains: BaseGains::from(&parameters.gains),
            limits: BaseLimits::from(&parameters.limits),
        })
    }

    /// Returns the controller with other parameters for the same state. Gains reach the law through a first-order filter;
    /// limits hold from the next step on.
    ///
    /// # Errors
    /// The first parameter out of range.
    pub fn with_parameters<const N: usize>(
        &self,
        parameters: &Parameters<N>,
    ) -> Result<Self, ParameterError> {
        check(parameters)?;
        Ok(Self {
            gains: BaseGains::from(&parameters.gains),
            limits: BaseLimits::from(&parameters.limits),
            ..*self
        })
    }

    /// The cover's geometry, to say what a guard has to.
    pub fn outline(&self) -> &CoverOutline<K, T> {
        &self.outline
    }

    /// State of a base that stands still.
    pub fn enter(&self) -> BaseState<T> {
        BaseState { gains: self.gains, velocity_body: [T::zero(); 3], lead: None }
    }

    /// One step: the base gives way to its cover, eqs. (2) and (4).
    ///
    /// # Errors
    /// An input or a result that is not finite, a step that is not positive. `state` is then as it was.
    pub fn step(
        &self,
        state: &mut BaseState<T>,
        input: &BaseInput<K, T>,
    ) -> Result<BaseOutput<T>, ControlError> {
        let heading = Heading::at(input.yaw_world_rad);
        self.run(state, input, &input.guard, |cover_wrench_base, state, dt_s| {
            let force = heading.to_world(cover_wrench_base).map(|f| state.gains.reactivity * f);
            let before = heading.to_world(state.velocity_body);
            heading.to_base(self.admitted(state, &heading, &before, &force, dt_s))
        })
    }

    /// One step to a standstill with the allowed deceleration; of the guard only [`BaseGuard::outward_m_s`] is kept, so
    /// that the base may still make room.
    ///
    /// # Errors
    /// As for [`Self::step`].
    pub fn hold(
        &self,
        state: &mut BaseState<T>,
        input: &BaseInput<K, T>,
    ) -> Result<BaseOutput<T>, ControlError> {
        let room = input.guard.room();
        self.run(state, input, &room, |_, state, _| {
            state.lead = None;
            [T::zero(); 3]
        })
    }

    /// eq. (2) about the velocity with which the base is led, if it is; world axes.
    #[inline]
    pub(super) fn admitted(
        &self,
        state: &mut BaseState<T>,
        heading: &Heading<T>,
        before: &[T; 3],
        force: &[T; 3],
        dt_s: T,
    ) -> [T; 3] {
        let Some((led_before, led)) = state.advance_lead(self.limits.velocity_max(), dt_s) else {
            return admitted(&state.gains, before, force, dt_s).0;
        };
        let (led_before, led) = (heading.to_world(led_before), heading.to_world(led));
        let own: [T; 3] = core::array::from_fn(|i| before[i] - led_before[i]);
        let (own, _) = admitted(&state.gains, &own, force, dt_s);
        core::array::from_fn(|i| own[i] + led[i])
    }

    fn run(
        &self,
        state: &mut BaseState<T>,
        input: &BaseInput<K, T>,
        guard: &BaseGuard<K, T>,
        wanted_body: impl FnOnce([T; 3], &mut BaseState<T>, T) -> [T; 3],
    ) -> Result<BaseOutput<T>, ControlError> {
        check_step(input.dt_s)?;
        finite("yaw_world_rad", &[input.yaw_world_rad])?;
        self.check_cover(&input.taxel_force_n, &input.guard)?;
        let mut limits = LimitsHit::default();
        let cover_wrench_base = self.cover_wrench(&input.taxel_force_n, &mut limits);
        let dt_s = input.dt_s.min(of(LONGEST_STEP_S));
        let mut next = *state;
        next.gains.approach(&self.gains, dt_s);
        let wanted = wanted_body(cover_wrench_base, &mut next, dt_s);
        next.velocity_body = self.limited(guard, &wanted, &next.velocity_body, dt_s, &mut limits);
        finite("base velocity command", &next.velocity_body)?;
        *state = next;
        Ok(BaseOutput { velocity_body: state.velocity_body, cover_wrench_base, limits })
    }

    /// Wrench of the taxels' forces, as far as they are believed, in B. eq. (4)
    #[inline]
    pub(super) fn cover_wrench(&self, taxel_force_n: &[T; K], hit: &mut LimitsHit) -> [T; 3] {
        self.outline.map().sum(taxel_force_n.iter().map(|force| self.limits.taxel_force(*force, hit)))
    }

    /// Errs on the first number of a cover's forces or of a guard that cannot be computed with.
    pub(super) fn check_cover(
        &self,
        taxel_force_n: &[T; K],
        guard: &BaseGuard<K, T>,
    ) -> Result<(), ControlError> {
        let taxels = self.outline.map().taxels();
        finite("taxel_force_n", &taxel_force_n[..taxels])?;
        guard.check(taxels)
    }

    /// `wanted` inside the base's limits and the guard, axes of B.
    pub(super) fn limited(
        &self,
        guard: &BaseGuard<K, T>,
        wanted: &[T; 3],
        before: &[T; 3],
        dt_s: T,
        hit: &mut LimitsHit,
    ) -> [T; 3] {
        self.limits.guarded_velocity(&self.outline, guard, wanted, before, dt_s, hit)
    }
}
