//! Motion towards a side that no taxel covers: nobody is felt there, so it is slow and short. Pure.
//!
//! A side of the base's outline is covered by a taxel in use that is pressed within 45° of the way into it. The middle
//! of an uncovered side goes outward with the base's translation; a corner that two uncovered sides share, with its
//! turning too. The way counts from the last rest: nobody touches the cover, and the base stands of its own accord.
//!
//! Somebody who presses from the other side is felt, and gets the room that the contact barrier asks for over a longer
//! way: the one who is hurt for certain before the one who may stand there. Both ways are the same count, so that room
//! that was made is used up for the law.

use crate::config::Config;
use crate::cover::CoverState;
use crate::robot::TAXELS;
use moca_msgs::{TaxelPlacement, TaxelReading, TaxelStatus};
use serde::{Deserialize, Serialize};
use std::f64::consts::{FRAC_1_SQRT_2, FRAC_PI_2, PI};

/// Directions into the four sides, rad in B: front, left, rear, right.
const INTO: [f64; 4] = [PI, -FRAC_PI_2, 0.0, FRAC_PI_2];
/// The last of the way is gone in this time constant, s, or in five of the base's servo: it ends without overshoot.
const APPROACH_S: f64 = 0.1;
const SERVOS: f64 = 5.0;
/// Time for which the base has to stand untouched before the distance counts from zero again, s.
const REST_S: f64 = 0.5;
/// Slower than this it stands, m/s and rad/s.
const STANDS: f64 = 1e-3;
/// No bound: no base is as fast, m/s and rad/s.
const FREE: f64 = 1e3;

/// Displacement of the base towards its uncovered sides, and its bounds on further motion.
#[derive(Clone, Debug)]
pub struct Uncovered {
    speed_m_s: f64,
    most_m: f64,
    /// The longest way for somebody who presses, m.
    room_m: f64,
    approach_s: f64,
    /// Half the diagonal of the outline, m.
    corner_m: f64,
    /// Which sides each taxel covers while it is in use.
    covers: Vec<[bool; 4]>,
    usable: [bool; TAXELS],
    /// The sides that no taxel in use covers, as in [`INTO`].
    bare: [bool; 4],
    touched: bool,
    state: UncoveredState,
}

/// Memory of the uncovered sides between ticks.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct UncoveredState {
    /// Way of each side since the last rest, as in [`INTO`], m; and of the corners when turning either way, m.
    gone_m: [f64; 4],
    turned_m: [f64; 2],
    rested_s: f64,
    /// True if the guard limited the law's motion in the last tick.
    held: bool,
}

impl Uncovered {
    /// Builds the guard of the configured base and cover, with every taxel in use.
    pub fn new(config: &Config) -> Self {
        let [length, width, _] = config.robot.base.size_m;
        let covers: Vec<_> = config.robot.cover.placements().iter().map(sides_of).collect();
        let usable = [true; TAXELS];
        Self {
            speed_m_s: config.protection.uncovered_m_s,
            most_m: config.protection.uncovered_m,
            room_m: config.protection.uncovered_room_m.max(config.protection.uncovered_m),
            approach_s: APPROACH_S.max(SERVOS * config.robot.base.servo_time_constant_s),
            corner_m: 0.5 * length.hypot(width),
            bare: bare_sides(&covers, &usable),
            covers,
            usable,
            touched: false,
            state: UncoveredState::default(),
        }
    }

    /// Returns its memory.
    pub const fn state(&self) -> UncoveredState {
        self.state
    }

    /// Goes on from where `state` was taken.
    pub const fn restore(&mut self, state: &UncoveredState) {
        self.state = *state;
    }

    /// Takes in whether the guard kept the base from what the law wanted in this tick.
    pub const fn remember(&mut self, held: bool) {
        self.state.held = held;
    }

    /// Takes in which taxels are in use and whether anybody touches them.
    pub fn feel(&mut self, cover: &CoverState, touched: bool) {
        let taxels = &cover.poll.reading.taxels[..self.covers.len()];
        self.touched = touched;
        let is_usable = |taxel: &TaxelReading| taxel.status != TaxelStatus::Masked;
        // no early return: several at once
        let changed = |changed, (taxel, usable): (_, &bool)| changed | (is_usable(taxel) != *usable);
        if taxels.iter().zip(&self.usable).fold(false, changed) {
            for (usable, taxel) in self.usable.iter_mut().zip(taxels) {
                *usable = is_usable(taxel);
            }
            self.bare = bare_sides(&self.covers, &self.usable);
        }
    }

    /// The sides that no taxel covers: front, left, rear, right.
    pub const fn sides(&self) -> [bool; 4] {
        self.bare
    }

    /// The longest way gone towards an uncovered side since the last rest, m.
    pub fn way_m(&self) -> f64 {
        self.state.gone_m.iter().chain(&self.state.turned_m).fold(0.0, |most, way| most.max(*way))
    }

    /// Moves on by `dt_s` with the base's measured velocity, axes of B, m/s, m/s, rad/s.
    pub fn advance(&mut self, [forward, left, yaw]: [f64; 3], dt_s: f64) {
        let (sides, state) = (self.sides(), &mut self.state);
        let speed_m_s = (forward * forward + left * left).sqrt();
        let rests = !state.held && !self.touched && speed_m_s < STANDS && yaw.abs() < STANDS;
        state.rested_s = if rests { state.rested_s + dt_s } else { 0.0 };
        if state.rested_s >= REST_S {
            (state.gone_m, state.turned_m) = ([0.0; 4], [0.0; 2]);
        }
        for ((gone_m, bare), m_s) in state.gone_m.iter_mut().zip(sides).zip([forward, left, -forward, -left])
        {
            *gone_m = if bare { (*gone_m + m_s * dt_s).max(0.0) } else { 0.0 };
        }
        let turns = corners(&sides);
        for (turned_m, rad_s) in state.turned_m.iter_mut().zip([yaw, -yaw]) {
            *turned_m = if turns { (*turned_m + self.corner_m * rad_s * dt_s).max(0.0) } else { 0.0 };
        }
    }

    /// Least and largest velocity along the axes of B, m/s, m/s, rad/s, for a base that brakes with `deceleration`;
    /// `None` where every side is covered.
    pub fn bounds_body(&self, deceleration: [f64; 3]) -> Option<[[f64; 3]; 2]> {
        self.bounds(deceleration, self.speed_m_s, self.most_m)
    }

    /// Returns the bounds for motion that makes room for a detected person.
    pub fn room_body(&self, deceleration: [f64; 3]) -> Option<[[f64; 3]; 2]> {
        self.bounds(deceleration, FREE, self.room_m)
    }

    fn bounds(&self, deceleration: [f64; 3], speed_m_s: f64, most_m: f64) -> Option<[[f64; 3]; 2]> {
        let sides = self.sides();
        if sides == [false; 4] {
            return None;
        }
        let most = |uncovered: bool, gone_m: f64, m_s2: f64| {
            if !uncovered {
                return FREE;
            }
            let left_m = (most_m - gone_m).max(0.0);
            speed_m_s.min(left_m / self.approach_s).min((m_s2 * left_m).sqrt())
        };
        let [x, y, yaw] = deceleration;
        let [front, left, rear, right] = std::array::from_fn(|side| {
            most(sides[side], self.state.gone_m[side], if side % 2 == 0 { x } else { y })
        });
        let turns = corners(&sides);
        let [to_left, to_right] = self.state.turned_m.map(|gone_m| {
            let corner_m = if turns { self.corner_m } else { 1.0 };
            most(turns, gone_m, yaw * corner_m) / corner_m
        });
        Some([[-rear, -right, -to_right], [front, left, to_left]])
    }
}

/// The sides that none of the usable taxels covers.
fn bare_sides(covers: &[[bool; 4]], usable: &[bool; TAXELS]) -> [bool; 4] {
    let mut bare = [true; 4];
    for (covers, _) in covers.iter().zip(usable).filter(|(_, usable)| **usable) {
        for (bare, covered) in bare.iter_mut().zip(covers) {
            *bare &= !covered;
        }
    }
    bare
}

/// The sides that a taxel covers, as in [`INTO`].
fn sides_of(taxel: &TaxelPlacement) -> [bool; 4] {
    INTO.map(|into| (taxel.inward_angle_base_rad - into).cos() >= FRAC_1_SQRT_2 - 1e-9)
}

/// Returns true if two neighbours of the four sides are uncovered.
fn corners(sides: &[bool; 4]) -> bool {
    (0..4).any(|side| sides[side] && sides[(side + 1) % 4])
}

#[cfg(test)]
#[expect(clippy::float_cmp, reason = "what is free and what is used up are exact")]
mod tests {
    use super::*;
    use crate::barrier::BaseMotion;
    use crate::robot::{CoverTable, JOINTS};
    use moca_msgs::RobotState;

    const DT_S: f64 = 1e-3;
    const BRAKES: [f64; 3] = [3.0, 3.0, 6.0];

    fn of(taxels: &[(f64, f64, f64)]) -> Uncovered {
        let mut config = Config::default();
        config.robot.cover = CoverTable {
            x_m: taxels.iter().map(|taxel| taxel.0).collect(),
            y_m: taxels.iter().map(|taxel| taxel.1).collect(),
            inward_rad: taxels.iter().map(|taxel| taxel.2).collect(),
            ..CoverTable::default()
        };
        Uncovered::new(&config)
    }

    fn moving(yaw_rad: f64, [vx, vy, yaw_rate]: [f64; 3]) -> RobotState<JOINTS> {
        let (sin, cos) = yaw_rad.sin_cos();
        RobotState {
            base_pose_world: [1.0, 2.0, yaw_rad],
            base_velocity_world: [cos * vx - sin * vy, sin * vx + cos * vy, yaw_rate],
            ..RobotState::at_rest([0.0; JOINTS])
        }
    }

    /// Moves with `velocity` (axes of B), or as fast as its bounds let it, for `seconds`.
    fn go(uncovered: &mut Uncovered, velocity: [f64; 3], seconds: f64) {
        let mut t_s = 0.0;
        while t_s < seconds {
            let bounds = uncovered.bounds_body(BRAKES).unwrap_or([[-FREE; 3], [FREE; 3]]);
            let allowed = std::array::from_fn(|i| velocity[i].clamp(bounds[0][i], bounds[1][i]));
            uncovered.advance(BaseMotion::of(&moving(0.7, allowed)).velocity_body, DT_S);
            uncovered.remember(allowed != velocity);
            t_s += DT_S;
        }
    }

    #[test]
    fn the_sides_without_a_taxel_follow_from_the_cover() {
        let ring = [(0.5, 0.0, PI), (0.0, 0.4, -FRAC_PI_2), (-0.5, 0.0, 0.0), (0.0, -0.4, FRAC_PI_2)];
        assert_eq!(Uncovered::new(&Config::default()).sides(), [false, false, true, false]);
        assert_eq!(of(&ring).sides(), [false; 4]);
        assert_eq!(of(&ring).bounds_body(BRAKES), None);
        assert_eq!(of(&ring[..1]).sides(), [false, true, true, true]);
        // a taxel on a corner covers both sides, one that is pressed 50° off its side only the other
        assert_eq!(of(&[(0.5, 0.4, -0.75 * PI)]).sides(), [false, false, true, true]);
        assert_eq!(of(&[(0.5, 0.4, -130.0_f64.to_radians())]).sides(), [true, false, true, true]);
        let mut masked = Uncovered::new(&Config::default());
        let mut cover = CoverState::NONE;
        for taxel in &mut cover.poll.reading.taxels[4..7] {
            taxel.status = TaxelStatus::Masked;
        }
        masked.feel(&cover, false);
        assert_eq!(masked.sides(), [true, false, true, false]);
    }

    #[test]
    fn displacement_towards_bare_side_ends_at_its_bound() {
        let mut uncovered = Uncovered::new(&Config::default());
        let [least, most] = uncovered.bounds_body(BRAKES).unwrap();
        assert_eq!((least[1], least[2], most), (-FREE, -FREE, [FREE; 3]), "the covered sides are free");
        go(&mut uncovered, [-0.05, 0.3, 0.8], 10.0);
        let way_m = uncovered.way_m();
        assert!(way_m > 0.0999 && way_m <= 0.1, "{way_m} m");
        assert!(uncovered.bounds_body(BRAKES).unwrap()[0][0] > -1e-3);
        // as fast as this, it brakes within the way
        let mut fast = Uncovered::new(&Config::default());
        go(&mut fast, [-3.0, 0.0, 0.0], 3.0);
        assert!(fast.way_m() <= 0.1, "{} m", fast.way_m());
        // whoever presses in front is given more, out of the same count
        let [least, _] = uncovered.room_body(BRAKES).unwrap();
        assert!(least[0] < -1.0 && least[1] == -FREE, "{least:?}");
        uncovered.state.gone_m[2] = 1.0;
        assert!(uncovered.room_body(BRAKES).unwrap()[0][0].abs() < 1e-9, "a metre and no more");
        uncovered.state.gone_m[2] = way_m;
        // what it comes back is gained again
        go(&mut uncovered, [0.05, 0.0, 0.0], 1.0);
        assert!((uncovered.way_m() - (way_m - 0.05)).abs() < 1e-4, "{} m", uncovered.way_m());
    }

    #[test]
    fn two_bare_sides_share_a_corner_that_turns_outward_as_well() {
        let mut front_only = of(&[(0.489, 0.0, PI)]);
        go(&mut front_only, [0.0, 0.0, 0.5], 10.0);
        assert!(front_only.way_m() > 0.099 && front_only.way_m() <= 0.1, "{}", front_only.way_m());
        let mut left_and_right = of(&[(0.0, 0.388, -FRAC_PI_2), (0.0, -0.388, FRAC_PI_2)]);
        go(&mut left_and_right, [0.0, 0.0, 0.5], 10.0);
        assert_eq!(left_and_right.way_m(), 0.0, "the taxels beside a bare side feel its corner");
    }

    #[test]
    fn bare_side_displacement_restarts_after_untouched_rest() {
        let after = |touched: bool, held: bool, velocity: [f64; 3], seconds: f64| {
            let mut uncovered = Uncovered::new(&Config::default());
            go(&mut uncovered, [-0.05, 0.0, 0.0], 5.0);
            uncovered.feel(&CoverState::NONE, touched);
            uncovered.remember(held);
            let mut t_s = 0.0;
            while t_s < seconds {
                uncovered.advance(BaseMotion::of(&moving(0.7, velocity)).velocity_body, DT_S);
                t_s += DT_S;
            }
            uncovered.way_m()
        };
        assert_eq!(after(false, false, [0.0; 3], 0.6), 0.0);
        assert!(after(false, false, [0.0; 3], 0.4) > 0.09, "too short");
        assert!(after(true, false, [0.0; 3], 2.0) > 0.09, "somebody touches it");
        assert!(after(false, true, [0.0; 3], 2.0) > 0.09, "the guard holds it");
        assert!(after(false, false, [0.0, 0.1, 0.0], 2.0) > 0.09, "it moves");
    }
}
