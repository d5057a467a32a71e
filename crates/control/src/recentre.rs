//! Motion of the base that nobody causes: the posture stiffness of the impedance law brings the base back under the arm, and in
//! follow-me the base follows what the observer's estimate of the flange wrench is off. Pure.
//!
//! With `control.recentre = "on-request"` that stiffness only resists. The base goes no faster than a hand's wrench alone moves
//! it, v = reactivity·f/D_v along each axis of B, and never the other way. Without a hand it comes to rest, and stays until
//! somebody presses Recentre: then it drives back at [`RECENTRE_M_S`] until it rests or is touched. A target from another
//! program leads the base like before: its commander is responsible. In follow-me v counts of the flange's wrench only what is
//! above 5 N and 2 N·m: the nearer the arm is to a singular posture, the more force the estimate makes of a small
//! torque. With `"always"` both laws are as published.

use crate::config::{Config, RecentrePolicy};
use crate::cover::CoverState;
use crate::robot::{JOINTS, TAXELS};
use crate::supervisor::Touch;
use moca_msgs::{Outcome, Parameters, PostureOffset, Refusal};
use moca_wbc::nalgebra::{Matrix3, Vector2, Vector3};
use moca_wbc::{BaseGuard, ControlLaw, ControlOutput, FlangePose, rotation};
use serde::{Deserialize, Serialize};

/// Speed of the cover's fastest point on the way back, m/s.
pub const RECENTRE_M_S: f64 = 0.03;
/// Wrench at the flange that counts as a hand, N and N·m: above what the observer's estimate is off.
const HAND_N: f64 = 5.0;
const HAND_NM: f64 = 2.0;
/// Time constant with which a base without a hand comes to rest, s.
const STOP_S: f64 = 0.1;
/// Slower than this the base is told to stand, m/s and rad/s.
const STANDS: f64 = 1e-3;
/// A base that the law moves no faster than [`STANDS`] for so long has arrived, s.
const ARRIVED_S: f64 = 1.0;
/// No bound: no base is as fast, m/s and rad/s.
const FREE: f64 = 1e3;

/// Pose of the tool on the base with the arm in its posture.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PosturePlace {
    /// Position, axes of B, m.
    pub position_base: Vector3<f64>,
    /// Axes of the tool, axes of B.
    pub rotation_base: Matrix3<f64>,
}

/// Decides whether the base may move without a hand.
#[derive(Clone, Debug)]
pub struct Recentre {
    policy: RecentrePolicy,
    place: Option<PosturePlace>,
    touched: bool,
    stance: Stance,
    state: RecentreState,
}

/// Base and tool in one tick, for [`Recentre::offset`].
#[derive(Clone, Copy, Debug)]
struct Stance {
    /// Place of the tool in the posture; `None` before the impedance law has run.
    place: Option<PosturePlace>,
    /// Place of the base in W, m; sine and cosine of its yaw.
    base_world: [f64; 2],
    heading: (f64, f64),
    tool: FlangePose,
    recentring: bool,
}

/// Memory from tick to tick.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct RecentreState {
    /// Least and largest velocity of the base without a request, axes of B.
    bounds_body: [[f64; 3]; 2],
    /// Wrenches of hands on the cover and at the flange, about the origin of B, axes of B: N, N, N·m.
    hands_base: [[f64; 3]; 2],
    /// True while a hand holds the flange.
    flange_held: bool,
    /// True while the base drives back on request.
    recentring: bool,
    /// Time for which it has stood meanwhile, s.
    stood_s: f64,
}

impl Recentre {
    /// As configured; `place` is `None` for a robot that lacks base, arm or cover.
    pub fn new(config: &Config, place: Option<PosturePlace>) -> Self {
        let policy = config.control.recentre;
        Self { policy, place, touched: false, stance: Stance::NONE, state: RecentreState::default() }
    }

    /// Memory from tick to tick.
    pub const fn state(&self) -> RecentreState {
        self.state
    }

    /// Continues from `state`.
    pub const fn restore(&mut self, state: &RecentreState) {
        self.state = *state;
    }

    /// Takes the tool's place for another posture.
    pub const fn set_place(&mut self, place: Option<PosturePlace>) {
        self.place = place;
    }

    /// Displacement of the base from where the posture wants it; `None` before the impedance law has run.
    pub fn offset(&self) -> Option<PostureOffset> {
        self.stance.place.as_ref().map(|place| self.stance.offset(place))
    }

    /// Forgets the request and the motion, because the law has ended.
    pub fn leave(&mut self) {
        (self.state, self.stance.place) = (RecentreState::default(), None);
    }

    /// Starts the way back.
    ///
    /// # Errors
    /// [`Refusal::Touched`] while a taxel feels a touch, [`Refusal::NoRobot`] where no arm stands on a base.
    pub fn request(&mut self, touch: Option<Touch>) -> Outcome {
        if self.place.is_none() {
            return Err(Refusal::NoRobot);
        }
        if let Some(Touch { taxel, force_n }) = touch {
            return Err(Refusal::Touched { taxel, force_n });
        }
        (self.state.recentring, self.state.stood_s) = (true, 0.0);
        Ok(())
    }

    /// Ends the way back: the base rests.
    pub const fn end(&mut self) {
        self.state.recentring = false;
    }

    /// Takes in whether the cover feels anybody, however lightly.
    pub fn feel(&mut self, cover: &CoverState) {
        let early = &cover.poll.early;
        self.touched = cover.poll.forces.as_ref().is_ok_and(|forces_n| Touch::is_in(forces_n))
            || early.touched.iter().chain(&early.light).any(|touched| *touched);
    }

    /// Bounds the base's motion in a tick of `law`; `led` while a target leads it.
    pub fn bound(
        &mut self,
        guard: &mut BaseGuard<TAXELS>,
        parameters: &Parameters<JOINTS>,
        (law, led): (ControlLaw, bool),
        dt_s: f64,
    ) {
        if law == ControlLaw::Hold {
            return self.leave();
        }
        let state = &mut self.state;
        if self.touched || state.flange_held || led || law == ControlLaw::FollowMe {
            state.recentring = false;
        }
        if state.recentring {
            guard.speed_m_s = Some(guard.speed_m_s.map_or(RECENTRE_M_S, |most| most.min(RECENTRE_M_S)));
        }
        let without_posture = law == ControlLaw::Impedance && self.place.is_none();
        if self.policy == RecentrePolicy::Always || without_posture || led || state.recentring {
            return;
        }
        let gains = &parameters.gains;
        let left = (1.0 - dt_s / STOP_S).max(0.0);
        let [mut least, mut most] = state.bounds_body;
        for i in 0..3 {
            let per_n = gains.reactivity / gains.virtual_damping[i].max(f64::MIN_POSITIVE);
            // Each hand alone or both: what the flange seems to feel, a load or a friction perhaps, never holds the base
            // against somebody who presses its cover.
            let [cover, flange] = state.hands_base.map(|wrench| per_n * wrench[i]);
            let shrunk = |bound: f64| if bound.abs() < STANDS { 0.0 } else { bound * left };
            least[i] = shrunk(least[i]).min(cover).min(flange).min(cover + flange).clamp(-FREE, 0.0);
            most[i] = shrunk(most[i]).max(cover).max(flange).max(cover + flange).clamp(0.0, FREE);
        }
        state.bounds_body = [least, most];
        // room for a detected person is not the law's motion
        guard.room_body = guard.room_body.or(guard.bounds_body).or(Some([[-FREE; 3], [FREE; 3]]));
        let [other_least, other_most] = guard.bounds_body.unwrap_or([[-FREE; 3], [FREE; 3]]);
        guard.bounds_body = Some([
            std::array::from_fn(|i| least[i].max(other_least[i])),
            std::array::from_fn(|i| most[i].min(other_most[i])),
        ]);
    }

    /// True if the base stands because nobody moves it: the guard then holds it against the posture's stiffness alone.
    pub fn stands(&self) -> bool {
        self.policy == RecentrePolicy::OnRequest
            && !self.state.recentring
            && self.state.bounds_body == RecentreState::default().bounds_body
    }

    /// Takes in what `law` made of the tick, the base being at this pose with this sine and cosine of its yaw.
    pub fn remember(
        &mut self,
        law: ControlLaw,
        ([x, y, _], heading): ([f64; 3], (f64, f64)),
        output: &ControlOutput<JOINTS>,
        dt_s: f64,
    ) {
        let flange = output.flange.position_world;
        let [fx, fy, fz, mx, my, mz] = output.flange_wrench_world;
        let (force_n, moment_nm) =
            ((fx * fx + fy * fy + fz * fz).sqrt(), (mx * mx + my * my + mz * mz).sqrt());
        let of_threshold = (force_n / HAND_N).max(moment_nm / HAND_NM);
        let held = of_threshold > 1.0;
        let counts = match law {
            _ if !held => 0.0,
            ControlLaw::FollowMe => 1.0 - 1.0 / of_threshold,
            ControlLaw::Hold | ControlLaw::Impedance => 1.0,
        };
        let moment = mz + (flange[0] - x) * fy - (flange[1] - y) * fx;
        let (sin, cos) = heading;
        let hand = [cos * fx + sin * fy, cos * fy - sin * fx, moment].map(|part| counts * part);
        let state = &mut self.state;
        state.flange_held = held;
        state.hands_base = [output.cover_wrench_base, hand];
        let velocity = output.command.base_velocity_body;
        if state.recentring {
            let stood = velocity.iter().all(|v| v.abs() < STANDS);
            state.stood_s = if stood { state.stood_s + dt_s } else { 0.0 };
            state.recentring = state.stood_s < ARRIVED_S;
        }
        // from the present motion on it comes to rest
        state.bounds_body[0] = std::array::from_fn(|i| state.bounds_body[0][i].min(velocity[i]).min(0.0));
        state.bounds_body[1] = std::array::from_fn(|i| state.bounds_body[1][i].max(velocity[i]).max(0.0));
        // written where it is: what is put together elsewhere is copied while it is still on its way to memory
        let stance = &mut self.stance;
        stance.place = self.place.filter(|_| law == ControlLaw::Impedance);
        (stance.base_world, stance.heading, stance.recentring) = ([x, y], heading, state.recentring);
        stance.tool = output.flange;
    }
}

impl Stance {
    const NONE: Self = Self {
        place: None,
        base_world: [0.0; 2],
        heading: (0.0, 1.0),
        tool: FlangePose { position_world: [0.0; 3], quaternion_world: [0.0, 0.0, 0.0, 1.0] },
        recentring: false,
    };

    /// Displacement of the base that would bring the tool to its `place` in the posture.
    fn offset(&self, place: &PosturePlace) -> PostureOffset {
        let &Self { place: _, base_world: [x, y], heading: (sin, cos), tool, recentring } = self;
        let axes = rotation::from_quaternion(tool.quaternion_world);
        // the yaw in W at which the tool on the base would be turned least from where it is
        let turned = |i: usize, j: usize| axes.row(i).dot(&place.rotation_base.row(j));
        let toward = Vector2::new(turned(0, 0) + turned(1, 1), turned(1, 0) - turned(0, 1));
        let angle_rad = (cos * toward.y - sin * toward.x).atan2(cos * toward.x + sin * toward.y);
        let toward = toward.try_normalize(0.0).unwrap_or(Vector2::new(cos, sin));
        let [tool_x, tool_y, _] = tool.position_world;
        let posture = place.position_base;
        let wanted = Vector2::new(
            toward.x * posture.x - toward.y * posture.y,
            toward.y * posture.x + toward.x * posture.y,
        );
        let distance_m = Vector2::new(tool_x - wanted.x - x, tool_y - wanted.y - y).norm();
        PostureOffset { distance_m, angle_rad, recentring }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::controller::WITHOUT_PARTS;

    const DT_S: f64 = 1e-3;

    /// Bounds of a base that stands in `law` under `flange_wrench_world`, with the default gains.
    fn bounds(
        policy: RecentrePolicy,
        law: ControlLaw,
        flange_wrench_world: [f64; 6],
    ) -> Option<[[f64; 3]; 2]> {
        let mut config = Config::default();
        config.control.recentre = policy;
        let place = PosturePlace { position_base: Vector3::zeros(), rotation_base: Matrix3::identity() };
        let mut recentre = Recentre::new(&config, Some(place));
        let output = ControlOutput { flange_wrench_world, ..WITHOUT_PARTS };
        recentre.remember(law, ([0.0; 3], (0.0, 1.0)), &output, DT_S);
        let mut guard = BaseGuard::NONE;
        recentre.bound(&mut guard, &config.parameters(), (law, false), DT_S);
        guard.bounds_body
    }

    #[test]
    fn base_follows_no_error_of_the_estimate() {
        let stands = Some([[0.0; 3]; 2]);
        for law in [ControlLaw::FollowMe, ControlLaw::Impedance] {
            assert_eq!(bounds(RecentrePolicy::OnRequest, law, [4.0, 0.0, 0.0, 0.0, 0.0, 1.9]), stands);
            assert_eq!(bounds(RecentrePolicy::Always, law, [4.0, 0.0, 0.0, 0.0, 0.0, 1.9]), None);
        }
    }

    #[test]
    fn follow_me_counts_what_is_above_the_threshold() {
        let most = |wrench| bounds(RecentrePolicy::OnRequest, ControlLaw::FollowMe, wrench).unwrap();
        let [[_, least_y, _], [most_x, ..]] = most([15.0, -20.0, 0.0, 0.0, 0.0, 0.0]);
        // 25 N, of which 20 count: 12 N forwards and 16 N to the right, at 80 N·s/m
        assert!((most_x - 12.0 / 80.0).abs() < 1e-12 && (least_y + 16.0 / 80.0).abs() < 1e-12);
        // a moment alone is a hand as well: 4 N·m, of which 2 count, at 60 N·m·s/rad
        let [_, [.., most_yaw]] = most([0.0, 0.0, 0.0, 0.0, 0.0, 4.0]);
        assert!((most_yaw - 2.0 / 60.0).abs() < 1e-12);
    }

    #[test]
    fn impedance_counts_the_whole_hand() {
        let [_, [most_x, ..]] =
            bounds(RecentrePolicy::OnRequest, ControlLaw::Impedance, [15.0, 0.0, 0.0, 0.0, 0.0, 0.0])
                .unwrap();
        assert!((most_x - 15.0 / 80.0).abs() < 1e-12);
    }
}
