//! Keeps every contact of the cover under a force although its sensor is late: how deep each touched taxel is *now*,
//! how fast the person comes, and how fast that taxel may therefore still go outward. A [`BaseGuard`] takes the result,
//! and the base goes the nearest way that keeps all of it, its own limits first. `docs/math.md` derives the law.
//!
//! ```
//! use moca_wbc::contact_barrier::{BarrierInput, BarrierSettings, ContactBarrier, FoamCurve, TaxelSample};
//! use moca_wbc::robot::PAPER_COVER;
//! use moca_wbc::{BaseController, BaseGuard, BaseInput, Parameters};
//!
//! let foam = FoamCurve::Hyperbolic { stiffness_n_m: 2105.0, thickness_m: 0.015 };
//! let settings = BarrierSettings::new(foam, foam, 25.0, 0.015)?;
//! let mut barrier: ContactBarrier<11> = ContactBarrier::new(&PAPER_COVER, &settings)?;
//! let base: BaseController<11> = BaseController::new(&PAPER_COVER, &Parameters::PAPER)?;
//!
//! // forward at 0.1 m/s, and T6 in front is 12 ms ago found pressed with 12 N
//! let mut samples = [Some(TaxelSample { force_n: 0.0, age_s: 0.012 }); 11];
//! samples[5] = Some(TaxelSample { force_n: 12.0, age_s: 0.012 });
//! let input = BarrierInput::new(samples, [0.1, 0.0, 0.0], [3.0, 3.0, 6.0], 1e-3);
//! let contacts = barrier.update(&input)?;
//! assert!(contacts.depth_m[5] > foam.depth_m(12.0), "deeper by now");
//! assert!(contacts.outward_m_s[5] < 0.0, "and it has to give way");
//!
//! let mut state = base.enter();
//! let guard = BaseGuard { outward_m_s: Some(contacts.outward_m_s), ..BaseGuard::NONE };
//! let input = BaseInput { yaw_world_rad: 0.0, taxel_force_n: contacts.force_n, guard, dt_s: 1e-3 };
//! let back = base.step(&mut state, &input)?.velocity_body[0];
//! assert!((back + 0.003).abs() < 1e-12, "backwards as fast as 3 m/s² allow");
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```
//!
//! [`BaseGuard`]: crate::BaseGuard

use crate::cover_map::{BODY_M, on_one_side, squared};
use crate::error::{ControlError, finite};
use crate::guard::CoverOutline;
use crate::reach::ArmReach;
use crate::scalar::{Scalar, of};
use crate::state_check::check_step;
use moca_msgs::{ParameterError, TaxelPlacement};

mod orders;
mod track;

use orders::Orders;
use track::{Felt, Odometry, Track};
pub use track::{RECOVERS_S, SLOWEST_M_S};

/// Share of the force limit up to which the base itself may press.
pub const STOP_SHARE: f64 = 0.3165;
/// Share of the depth at the force limit from which on it makes room at the person's speed: what is left to the limit is for a
/// cover that reads a fifth too little, and for errors of the person's estimated speed over one age.
const YIELD_SHARE: f64 = 0.8;
/// Force of a reading from which on somebody touches, N.
pub const TOUCH_N: f64 = 1.0;
/// Fastest that a taxel makes room, m/s.
pub const RETREAT_M_S: f64 = 0.3;
/// Time constant in which a late base forgets how fast somebody came, s: who walks on comes again before it has made room twice.
const REMEMBER_S: f64 = 3.0;
/// Shortest time in which an error of the depth is taken back, s.
const RESPONSE_S: f64 = 0.08;
/// Neighbours of a coarse cover, further apart than [`BODY_M`], may feel one body if their nearest one is at most this much closer.
const UNEVEN: f64 = 1.2;
/// Way that a touched taxel goes back once its readings cannot be believed any more, m,
pub const BLIND_RETREAT_M: f64 = 0.03;
/// and when it stops trying, s after the last of them: something is behind it.
pub const BLIND_RETREAT_S: f64 = 0.6;

/// Points of [`FoamCurve::Points`].
pub const CURVE_POINTS: usize = 10;

/// Force of a foam over its compression.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum FoamCurve {
    /// F = k₀d/(1 − d/h).
    Hyperbolic {
        /// k₀, N/m.
        stiffness_n_m: f64,
        /// h, m.
        thickness_m: f64,
    },
    /// F = 100 N·(d/d₁₀₀)ⁿ.
    Power {
        /// d₁₀₀, m.
        depth_at_100n_m: f64,
        /// n.
        exponent: f64,
    },
    /// Straight lines from (0, 0) through what was measured, the last one going on.
    Points {
        /// Compression, m, rising.
        depth_m: [f64; CURVE_POINTS],
        /// Force there, N, rising.
        force_n: [f64; CURVE_POINTS],
    },
}

impl FoamCurve {
    /// Compression at a force in N, m.
    pub fn depth_m<T: Scalar>(&self, force_n: T) -> T {
        let force = force_n.max(T::zero());
        match *self {
            Self::Hyperbolic { stiffness_n_m, thickness_m } => {
                force * of(thickness_m) / (of::<T>(stiffness_n_m * thickness_m) + force)
            }
            Self::Power { depth_at_100n_m, exponent } => {
                of::<T>(depth_at_100n_m) * (force / of(100.0)).powf(of(1.0 / exponent))
            }
            Self::Points { depth_m, force_n } => {
                let ([from_n, from_m], m_n) = line(&force_n, &depth_m, force);
                of::<T>(from_m) + (force - of(from_n)) * of(m_n)
            }
        }
    }

    /// Force at a compression in m, N; no more than at 95 % of a hyperbolic foam's thickness.
    pub fn force_n<T: Scalar>(&self, depth_m: T) -> T {
        let depth = depth_m.max(T::zero());
        match *self {
            Self::Hyperbolic { stiffness_n_m, thickness_m } => {
                let share = (depth / of(thickness_m)).min(of(0.95));
                of::<T>(stiffness_n_m * thickness_m) * share / (T::one() - share)
            }
            Self::Power { depth_at_100n_m, exponent } => {
                of::<T>(100.0) * (depth / of(depth_at_100n_m)).powf(of(exponent))
            }
            Self::Points { depth_m, force_n } => {
                let ([from_m, from_n], n_m) = line(&depth_m, &force_n, depth);
                of::<T>(from_n) + (depth - of(from_m)) * of(n_m)
            }
        }
    }

    /// Stiffness at a compression in m, N/m; no more than at 95 % of a hyperbolic foam's thickness.
    pub fn slope_n_m<T: Scalar>(&self, depth_m: T) -> T {
        let depth = depth_m.max(T::zero());
        match *self {
            Self::Hyperbolic { stiffness_n_m, thickness_m } => {
                let left = T::one() - (depth / of(thickness_m)).min(of(0.95));
                of::<T>(stiffness_n_m) / (left * left)
            }
            Self::Power { depth_at_100n_m, exponent } => {
                of::<T>(100.0 * exponent / depth_at_100n_m)
                    * (depth / of(depth_at_100n_m)).powf(of(exponent - 1.0))
            }
            Self::Points { depth_m, force_n } => of(line(&depth_m, &force_n, depth).1),
        }
    }

    fn check(&self) -> Result<(), ParameterError> {
        let (first, second) = match *self {
            Self::Hyperbolic { stiffness_n_m, thickness_m } => (
                ("foam stiffness", stiffness_n_m, "N/m", 1.0, 1e9),
                ("foam thickness", thickness_m, "m", 1e-4, 1.0),
            ),
            Self::Power { depth_at_100n_m, exponent } => (
                ("foam depth at 100 N", depth_at_100n_m, "m", 1e-5, 1.0),
                ("foam exponent", exponent, "", 0.5, 10.0),
            ),
            Self::Points { depth_m, force_n } => {
                let (mut from_m, mut from_n) = (0.0, 0.0);
                for (depth_m, force_n) in depth_m.into_iter().zip(force_n) {
                    within("foam depth", depth_m, "m", from_m + 1e-6, 1.0)?;
                    within("foam force", force_n, "N", from_n + 1e-3, 1e6)?;
                    (from_m, from_n) = (depth_m, force_n);
                }
                return Ok(());
            }
        };
        for (name, value, unit, min, max) in [first, second] {
            within(name, value, unit, min, max)?;
        }
        Ok(())
    }
}

/// Returns start and slope of the straight line that spans `x` (points of `xs` and `ys`).
fn line<T: Scalar>(xs: &[f64; CURVE_POINTS], ys: &[f64; CURVE_POINTS], x: T) -> ([f64; 2], f64) {
    let mut from = [0.0; 2];
    let mut slope = 0.0;
    for (to_x, to_y) in xs.iter().zip(ys) {
        slope = (to_y - from[1]) / (to_x - from[0]);
        if x <= of(*to_x) {
            break;
        }
        from = [*to_x, *to_y];
    }
    (from, slope)
}

/// Settings of the barrier: cover, base and behaviour. SI units. [`Self::new`] gives the values measured with a simulated
/// robot; none is tuned to a single experiment.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct BarrierSettings {
    /// Foam curve of the reader's calibration: undone to get from a reading to a depth.
    pub reading: FoamCurve,
    /// The foam.
    pub foam: FoamCurve,
    /// Below this reading nothing touches, N.
    pub touch_n: f64,
    /// Largest force that a taxel does not read, N: its reader's threshold.
    pub hidden_n: f64,
    /// The base itself presses no deeper than this, m.
    pub stop_m: f64,
    /// From here on the base makes room at the person's speed, m.
    pub yield_m: f64,
    /// Force that these depths are of, N.
    pub force_limit_n: f64,
    /// A body that several plates feel is one body on as many plates in parallel, each as deep as it reads, and the force limit is
    /// shared among them; else it is taken for one that presses a seam.
    pub shared_plates: bool,
    /// Time in which an error of the depth is taken back T_r, s.
    pub response_s: f64,
    /// Time constant of the base's velocity servo τ, s.
    pub servo_s: f64,
    /// Delay of an order on its way to that servo D, s: the law counts in what it has ordered and the base has not gone.
    pub order_delay_s: f64,
    /// Damping over stiffness of the contact as a law feels it when the base leaves the person T_d, s: it does not flee.
    pub damping_s: f64,
    /// Share η of the base's deceleration that is counted on.
    pub braking_share: f64,
    /// Time over which estimates of the person's speed are averaged, s: a fast board's readings are each little to go by, and a
    /// slow one's are as late as that.
    pub speed_s: f64,
    /// Stiffness of the softest body that is counted on, N/m: it yields beside the foam, which so shows less of its speed.
    pub softest_n_m: f64,
    /// Error of such an estimate, m/s: the noise of a taxel over [`Self::speed_s`]. No smaller speed counts as leaving the
    /// person, or noise alone would take from every force that the law feels.
    pub speed_noise_m_s: f64,
    /// Time constant in which it is forgotten after a release, s.
    pub forget_s: f64,
    /// Time constant in which the fastest one is forgotten, s, which is believed meanwhile; 0: at once.
    pub remember_s: f64,
    /// Speed that a person is believed to have at the first reading, m/s: one reading cannot tell.
    pub first_speed_m_s: f64,
    /// Fastest that a person is believed to come, m/s.
    pub fastest_person_m_s: f64,
    /// Fastest retreat, m/s.
    pub retreat_m_s: f64,
    /// Speed at which a taxel closes in on a person after a release, m/s,
    pub creep_m_s: f64,
    /// for this long, s,
    pub creep_s: f64,
    /// and what it gains per second afterwards, m/s².
    pub recovery_m_s2: f64,
    /// Reach of the arm that holds its tool in the world, if there is one. A retreat begins to take the tool along where the
    /// reach begins to end, and takes it along completely where the reach has ended.
    pub reach: Option<ArmReach>,
}

impl BarrierSettings {
    /// For contacts under `force_limit_n` on `foam`, whose readings come from a calibration as `reading`, on a base
    /// whose servo has the time constant `servo_s`.
    ///
    /// # Errors
    /// A curve, force or time out of range.
    pub fn new(
        reading: FoamCurve,
        foam: FoamCurve,
        force_limit_n: f64,
        servo_s: f64,
    ) -> Result<Self, ParameterError> {
        reading.check()?;
        foam.check()?;
        within("force limit of the contact barrier", force_limit_n, "N", 1.0, 1000.0)?;
        within("time constant of the base's servo", servo_s, "s", 0.0, 1.0)?;
        Ok(Self {
            reading,
            foam,
            touch_n: TOUCH_N,
            hidden_n: 1.0,
            stop_m: foam.depth_m(STOP_SHARE * force_limit_n),
            yield_m: YIELD_SHARE * foam.depth_m(force_limit_n),
            force_limit_n,
            shared_plates: false,
            response_s: RESPONSE_S,
            servo_s,
            order_delay_s: 0.0,
            damping_s: 0.05,
            braking_share: 0.7,
            speed_s: 0.06,
            softest_n_m: 5e3,
            speed_noise_m_s: 0.01,
            forget_s: 1.0,
            remember_s: 0.0,
            first_speed_m_s: 0.1,
            fastest_person_m_s: 0.6,
            retreat_m_s: RETREAT_M_S,
            creep_m_s: 0.03,
            creep_s: 0.15,
            recovery_m_s2: 0.1,
            reach: None,
        })
    }

    /// For a base whose orders are `order_delay_s` late. Delay and time constant of the servo may together be off by `error_s`, and
    /// the slope of the depth as read by `slope_error` (r of `docs/math.md`): T_r grows until the loop is stable for any of
    /// them.
    ///
    /// # Errors
    /// A time or slope out of range.
    pub fn with_late_orders(
        self,
        order_delay_s: f64,
        error_s: f64,
        slope_error: f64,
    ) -> Result<Self, ParameterError> {
        within("delay of orders to the base", order_delay_s, "s", 0.0, 1.0)?;
        within("error of the base's delay", error_s, "s", 0.0, 1.0)?;
        within("error of the slope of the depth", slope_error, "", 0.0, 0.9)?;
        let response_s = RESPONSE_S.max(2.0 * error_s / (1.0 - slope_error));
        let remember_s = if order_delay_s > 0.0 { REMEMBER_S } else { 0.0 };
        Ok(Self { order_delay_s, response_s, remember_s, ..self })
    }

    /// Returns the force, N, that compresses the foam as deep as a reading says.
    fn pressed_n<T: Scalar>(&self, reading_n: T) -> T {
        self.foam.force_n(self.reading.depth_m(reading_n))
    }
}

/// A taxel's reading.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TaxelSample<T = f64> {
    /// Compression force, N, ≥ 0.
    pub force_n: T,
    /// Time since it was taken, s, ≥ 0.
    pub age_s: T,
}

/// One step's measurements.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct BarrierInput<const K: usize, T = f64> {
    /// Readings, T1 first; `None` where there is none that can be believed.
    pub samples: [Option<TaxelSample<T>>; K],
    /// Taxels that are touched too lightly for a reading.
    pub light: [bool; K],
    /// Measured velocity of the base, axes of B: m/s, m/s, rad/s.
    pub velocity_body: [T; 3],
    /// Deceleration of the base, m/s², m/s², rad/s².
    pub deceleration: [T; 3],
    /// Place of the tool that the arm holds in the world while the base makes room, axes of B, m; `None` for a base alone and for
    /// follow-me.
    pub tool_base_m: Option<[T; 2]>,
    /// Time since the last step, s, > 0.
    pub dt_s: T,
}

impl<const K: usize, T: Scalar> BarrierInput<K, T> {
    /// Without an arm that holds its tool in its place.
    pub fn new(
        samples: [Option<TaxelSample<T>>; K],
        velocity_body: [T; 3],
        deceleration: [T; 3],
        dt_s: T,
    ) -> Self {
        Self { samples, light: [false; K], velocity_body, deceleration, tool_base_m: None, dt_s }
    }

    fn check(&self, taxels: usize) -> Result<(), ControlError> {
        check_step(self.dt_s)?;
        finite("velocity_body", &self.velocity_body)?;
        finite("deceleration", &self.deceleration)?;
        finite("tool_base_m", self.tool_base_m.as_ref().map_or(&[], |tool| tool.as_slice()))?;
        for (index, sample) in self.samples.iter().take(taxels).enumerate() {
            let fine = sample.is_none_or(|s| s.force_n.is_finite() && s.age_s.is_finite());
            if !fine {
                return Err(ControlError::NotFinite { what: "taxel sample", index });
            }
        }
        Ok(())
    }
}

/// Bounds of the barrier for one step.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ContactLimits<const K: usize, T = f64> {
    /// Largest speed of each taxel outward, m/s: for [`crate::BaseGuard::outward_m_s`]. +∞ beyond the last taxel.
    pub outward_m_s: [T; K],
    /// As [`BarrierSettings::shared_plates`]: for [`crate::BaseGuard::one_body`].
    pub one_body: bool,
    /// Force now, N, never more than was felt: for the law, which so sees its own retreat at once.
    pub force_n: [T; K],
    /// Compression now, m; 0 where nothing touches.
    pub depth_m: [T; K],
    /// The person's own speed towards the cover, m/s, ≥ 0.
    pub person_m_s: [T; K],
    /// A touched taxel whose readings cannot be believed any more is still to go back: a robot that stops does so first.
    pub backs_off: bool,
    /// Velocity with which the tool has to go along because the arm has no more reach, axes of B, m/s: people first, then the
    /// tool's place.
    pub carried_body_m_s: [T; 2],
}

/// The barrier of a cover of up to `K` taxels, with what it remembers: 3 kB of odometry, which no step copies.
#[derive(Clone, Debug)]
pub struct ContactBarrier<const K: usize, T = f64> {
    outline: CoverOutline<K, T>,
    /// Places of the taxels, axes of B, m, and largest squared distance of two that detect one body.
    places: [[T; 2]; K],
    span_squared: T,
    settings: BarrierSettings,
    state: BarrierState<K, T>,
}

/// Memory of a [`ContactBarrier`] between steps.
#[derive(Clone, Debug)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct BarrierState<const K: usize, T = f64> {
    odometry: Odometry<T>,
    /// `None` for a base that obeys at once.
    orders: Option<Orders<T>>,
    #[cfg_attr(feature = "serde", serde(with = "serde_big_array::BigArray"))]
    tracks: [Track<T>; K],
}

impl<const K: usize, T: Scalar> ContactBarrier<K, T> {
    /// Nothing touches.
    ///
    /// # Errors
    /// More than `K` taxels, or a position or angle out of range.
    pub fn new(taxels: &[TaxelPlacement], settings: &BarrierSettings) -> Result<Self, ParameterError> {
        let outline = CoverOutline::new(taxels)?;
        let mut places = [[T::zero(); 2]; K];
        for (place, taxel) in places.iter_mut().zip(taxels) {
            *place = taxel.position_base_m.map(of);
        }
        Ok(Self {
            outline,
            places,
            span_squared: of(span_squared(taxels)),
            settings: *settings,
            state: BarrierState {
                odometry: Odometry::new(),
                orders: (settings.order_delay_s > 0.0).then(Orders::new),
                tracks: [Track::none(); K],
            },
        })
    }

    /// The cover's geometry.
    pub const fn outline(&self) -> &CoverOutline<K, T> {
        &self.outline
    }

    /// Returns its memory.
    pub const fn state(&self) -> &BarrierState<K, T> {
        &self.state
    }

    /// Goes on from where `state` was taken.
    pub fn restore(&mut self, state: &BarrierState<K, T>) {
        self.state.clone_from(state);
    }

    /// Takes the order that the base is sent after a step, axes of B: m/s, m/s, rad/s. The next step counts it as sent for its
    /// own time.
    ///
    /// # Errors
    /// A value is not finite; the order before stays in force.
    pub fn ordered(&mut self, velocity_body: &[T; 3]) -> Result<(), ControlError> {
        finite("ordered velocity", velocity_body)?;
        if let Some(orders) = &mut self.state.orders {
            orders.send(velocity_body);
        }
        Ok(())
    }

    /// Returns the order in force of a base whose orders are late, axes of B, m/s, m/s, rad/s; `None` for one that obeys at once.
    pub fn order_in_force(&self) -> Option<&[T; 3]> {
        self.state.orders.as_ref().map(Orders::last)
    }

    /// Forgets the orders: the base is told to stand.
    pub fn forget_orders(&mut self) {
        if let Some(orders) = &mut self.state.orders {
            *orders = Orders::new();
        }
    }

    /// One step.
    ///
    /// # Errors
    /// A number that is not finite, a step that is not positive; nothing is changed.
    pub fn update(&mut self, input: &BarrierInput<K, T>) -> Result<ContactLimits<K, T>, ControlError> {
        let taxels = self.outline.map().taxels();
        input.check(taxels)?;
        self.state.odometry.advance(&input.velocity_body, input.dt_s);
        let delay_s = of(self.settings.order_delay_s);
        let owed = self.state.orders.as_mut().map(|orders| {
            orders.advance(input.dt_s, delay_s);
            orders.owed(delay_s)
        });
        let mut limits = ContactLimits {
            outward_m_s: [of(f64::INFINITY); K],
            one_body: self.settings.shared_plates,
            force_n: [T::zero(); K],
            depth_m: [T::zero(); K],
            person_m_s: [T::zero(); K],
            backs_off: false,
            carried_body_m_s: [T::zero(); 2],
        };
        let mut gives_way = false;
        let share = |time_s: f64| (input.dt_s / of(time_s)).min(T::one());
        let forgotten = [share(self.settings.forget_s), share(self.settings.remember_s)];
        for i in 0..taxels {
            let is_new = self.state.tracks[i].is_new(input.samples[i], input.dt_s);
            let [body_n, plates] = if is_new { self.body_n(i, input) } else { [T::zero(); 2] };
            let way = |place: &[T; 3]| self.outline.outward(i, place);
            let BarrierState { odometry, tracks, .. } = &mut self.state;
            tracks[i].wait(input.dt_s, forgotten, way(odometry.now()));
            match input.samples[i] {
                None => tracks[i].lose(way(odometry.now())),
                Some(sample) if is_new => {
                    let way = way(odometry.at_age(sample.age_s));
                    tracks[i]
                        .take(&self.settings, &Felt { sample, light: input.light[i], body_n, plates, way });
                }
                Some(_) => tracks[i].find(),
            }
            if is_new && (self.state.tracks[i].touched() || input.light[i]) {
                self.hold(i, &input.velocity_body);
            }
            self.look(i, input.dt_s);
            let track = &self.state.tracks[i];
            let owed = owed.map(|owed| self.outline.outward(i, &owed));
            let held = self.held_limit(i, owed, input);
            if track.touched() {
                let way_now = self.outline.outward(i, self.state.odometry.now());
                let depth = track.depth_now(way_now);
                limits.depth_m[i] = depth;
                limits.person_m_s[i] = track.person_m_s();
                let relative = self.outline.outward(i, &input.velocity_body) + track.person_m_s();
                let leaving = relative + of(self.settings.speed_noise_m_s);
                let eased = depth + of::<T>(self.settings.damping_s) * leaving.min(T::zero());
                limits.force_n[i] = track.believed_n(&self.settings.foam, eased);
                limits.outward_m_s[i] = match input.samples[i] {
                    None => {
                        let most = track.blind_limit(&self.settings, way_now);
                        limits.backs_off |= most < T::zero();
                        most
                    }
                    Some(_) => self.touched_limit(i, depth, owed, input).min(held),
                };
            } else {
                limits.outward_m_s[i] = track.released_limit(&self.settings).min(held);
            }
            gives_way |= limits.outward_m_s[i] < T::zero();
        }
        if let (true, Some(reach), Some(tool)) = (gives_way, &self.settings.reach, &input.tool_base_m) {
            limits.carried_body_m_s = carried(reach, tool, &input.velocity_body);
        }
        Ok(limits)
    }

    /// b_i of a touched taxel: the base itself stops at one depth, and from another makes room at the person's speed. `owed` is
    /// the way outward of orders that the base has not carried out, m.
    fn touched_limit(&self, i: usize, depth: T, owed: Option<T>, input: &BarrierInput<K, T>) -> T {
        let s = &self.settings;
        let speed = self.outline.outward(i, &input.velocity_body);
        let person = self.state.tracks[i].person_m_s();
        let mut soon = depth + of::<T>(s.servo_s) * (speed + person);
        if let Some(owed) = owed {
            soon += owed + of::<T>(s.order_delay_s) * person;
        }
        let (stop_m, yield_m) = self.depths(i);
        let own = self.closing(i, stop_m - soon, input).max(T::zero());
        let room = self.closing(i, yield_m - soon, input) - person;
        own.min(room).max(of(-s.retreat_m_s))
    }

    /// Depths at which the base stops and makes room, m: of this taxel's part of the force limit.
    fn depths(&self, i: usize) -> (T, T) {
        let s = &self.settings;
        if !s.shared_plates {
            return (of(s.stop_m), of(s.yield_m));
        }
        let limit_n = of::<T>(s.force_limit_n) / self.state.tracks[i].plates();
        let stop_m = s.foam.depth_m(of::<T>(STOP_SHARE) * limit_n);
        (stop_m, of::<T>(YIELD_SHARE) * s.foam.depth_m(limit_n))
    }

    /// φ: speed outward of taxel `i` with so much way `left`, m/s.
    fn closing(&self, i: usize, left: T, input: &BarrierInput<K, T>) -> T {
        let linear = left / of(self.settings.response_s);
        if left <= T::zero() {
            return linear;
        }
        let deceleration = self.outline.deceleration(i, &input.deceleration);
        linear.min((of::<T>(2.0 * self.settings.braking_share) * deceleration * left).sqrt())
    }

    /// Somebody touches taxel `i`, and may press its neighbours on that side of the cover too, each of which hides its part:
    /// where the base stands or gives way, none of them goes further out from now on.
    fn hold(&mut self, i: usize, velocity_body: &[T; 3]) {
        let stands = self.outline.outward(i, velocity_body) <= of(SLOWEST_M_S);
        for j in 0..self.outline.map().taxels() {
            if self.is_beside(i, j) {
                let way = self.outline.outward(j, self.state.odometry.now());
                self.state.tracks[j].hold(stands.then_some(way), i == j);
            }
        }
    }

    /// While the base looks whether somebody still touches taxel `i`, nothing of that side goes further out, or it would
    /// turn about who does.
    fn look(&mut self, i: usize, dt_s: T) {
        if !self.state.tracks[i].looks(self.outline.outward(i, self.state.odometry.now())) {
            return;
        }
        for j in 0..self.outline.map().taxels() {
            if j != i && self.is_beside(i, j) {
                let way = self.outline.outward(j, self.state.odometry.now());
                self.state.tracks[j].stay(way, dt_s);
            }
        }
    }

    /// Returns true if a body that touches taxel `i` may press `j` on that side of the cover too.
    pub fn is_beside(&self, i: usize, j: usize) -> bool {
        let columns = self.outline.map().columns();
        let ([x, y, _], [other_x, other_y, _]) = (columns[i], columns[j]);
        on_one_side([x, y], [other_x, other_y])
            && squared(&self.places[i], &self.places[j]) <= self.span_squared
    }

    /// Speed outward of taxel `i` on its way to where the base goes no further, m/s.
    fn held_limit(&self, i: usize, owed: Option<T>, input: &BarrierInput<K, T>) -> T {
        let Some(far) = self.state.tracks[i].far() else { return of(f64::INFINITY) };
        let speed = self.outline.outward(i, &input.velocity_body);
        let left = far - self.outline.outward(i, self.state.odometry.now()) - owed.unwrap_or(T::zero());
        self.closing(i, left - of::<T>(self.settings.servo_s) * speed, input).max(T::zero())
    }

    /// Force of the body that taxel `i` feels, N. One that lies on a seam presses either taxel with a part of its force,
    /// and how deep it is follows from all of it; a neighbour that is touched lightly, or was just now, hides its part.
    /// No more than twice what the taxel feels itself: of two that share a body one feels half, and two hands so look no
    /// more than twice as stiff. Under [`BarrierSettings::shared_plates`] it is the taxel's own force, with the number of plates
    /// like this one that the body presses.
    fn body_n(&self, i: usize, input: &BarrierInput<K, T>) -> [T; 2] {
        let felt = |j: usize| {
            input.samples[j].map(|sample| sample.force_n).filter(|n| *n >= of(self.settings.touch_n))
        };
        let Some(own) = felt(i).map(|n| self.settings.pressed_n(n)) else { return [T::zero(), T::one()] };
        let mut all = own;
        for j in (0..self.outline.map().taxels()).filter(|j| *j != i) {
            if squared(&self.places[i], &self.places[j]) > self.span_squared {
                continue;
            }
            // one that has just been let go is so whether its reading has been taken in yet or not
            let track = &self.state.tracks[j];
            let hidden = input.light[j] || track.touched() || track.was_touched();
            if let Some(n) = felt(j).or_else(|| hidden.then(|| of(self.settings.hidden_n))) {
                all += self.settings.pressed_n(n);
            }
        }
        if self.settings.shared_plates { [own, all / own] } else { [all.min(own + own), T::one()] }
    }
}

/// Returns the velocity with which the tool goes along with a retreating base, axes of B, m/s. It is the part of its place's
/// velocity that leaves the tool further behind, all of it at the end of the reach. For any other motion of the base the tool
/// stays: it pulls the base along, and both would go on for ever.
fn carried<T: Scalar>(reach: &ArmReach, tool_base_m: &[T; 2], &[vx, vy, yaw_rate]: &[T; 3]) -> [T; 2] {
    let [x, y] = reach.place_base_m.map(of::<T>);
    let (share, [to_x, to_y]) = reach.used(tool_base_m);
    let towards = (vx - yaw_rate * y) * to_x + (vy + yaw_rate * x) * to_y;
    let along = share * towards.min(T::zero());
    [along * to_x, along * to_y]
}

/// Returns the largest squared distance of two taxels that detect one body, m².
fn span_squared(taxels: &[TaxelPlacement]) -> f64 {
    let nearest = |i: usize| {
        let others = taxels.iter().enumerate().filter(|(j, _)| *j != i);
        others.fold(f64::INFINITY, |least, (_, other)| {
            least.min(squared(&taxels[i].position_base_m, &other.position_base_m))
        })
    };
    let coarsest = (0..taxels.len()).map(nearest).filter(|d| d.is_finite()).fold(0.0, f64::max);
    (BODY_M * BODY_M).max(UNEVEN * UNEVEN * coarsest)
}

fn within(
    name: &'static str,
    value: f64,
    unit: &'static str,
    min: f64,
    max: f64,
) -> Result<(), ParameterError> {
    if (min..=max).contains(&value) { Ok(()) } else { Err(ParameterError { name, value, unit, min, max }) }
}
