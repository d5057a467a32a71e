//! Cap of the push into somebody where the cover is not calibrated: how far the base goes on once a taxel is touched. Pure.
//!
//! Without a calibration no reading says how deep a touch is, so the contact barrier is off. Odometry still says how far the base
//! has gone since the touch began. A law that is led on pushes harder and harder, for the arm's springs stretch: without a cap a leg
//! that cannot give way is pressed with a thousand newtons. So a touched taxel goes outward by no more than the way in which a
//! foam that is twice as stiff as the configured one takes up the force limit, and no further than where the base first stood or gave way.
//! A base that brakes late goes past that by what it is late. While a program leads the robot, the taxels around the corner of a touched
//! one count as touched too: a base that slides along somebody at a corner pushes its rounding into who stands there.

use crate::barrier;
use crate::config::{BarrierReadings, Config};
use crate::cover::CoverState;
use crate::robot::TAXELS;
use moca_msgs::{ParameterError, TaxelPlacement, TaxelStatus};
use moca_wbc::contact_barrier::{RECOVERS_S, SLOWEST_M_S};
use moca_wbc::cover_map::{BODY_M, SAME_SIDE};
use moca_wbc::guard::CoverOutline;
use serde::{Deserialize, Serialize};

/// Stiffness of the foam that is credible, over the configured one.
const CREDIBLE: f64 = 2.0;
/// Rounding of a way, m.
const ROUNDING_M: f64 = 1e-6;
/// Way of each touched taxel outward, and which of them have gone far enough.
#[derive(Clone, Debug)]
pub struct PushCap {
    outline: CoverOutline<TAXELS, f64>,
    /// Taxels around a corner of each, T1 first.
    around_corner: Vec<[bool; TAXELS]>,
    /// Way from the first reading of a touch to the force limit of a foam that stiff, m.
    travel_m: f64,
    servo_s: f64,
    /// Deceleration of the base's servo, m/s².
    deceleration_m_s2: f64,
    touched: [bool; TAXELS],
    state: PushCapState,
}

/// Memory of a [`PushCap`] between ticks.
#[derive(Clone, Copy, Debug, Serialize, Deserialize)]
pub struct PushCapState {
    /// Way of the base in its own axes since nobody was felt last, m, m, rad.
    way_body: [f64; 3],
    #[serde(with = "serde_big_array::BigArray")]
    held: [Option<Held>; TAXELS],
}

/// A taxel that is touched, or was just now.
#[derive(Clone, Copy, Debug, Serialize, Deserialize)]
struct Held {
    /// Way outward beyond which it does not go, m.
    far_m: f64,
    /// True once the base has stood or given way.
    stood: bool,
    /// Time since somebody was felt here, s.
    free_s: f64,
}

impl PushCap {
    /// As configured; `None` with the contact barrier on or explicitly off.
    ///
    /// # Errors
    /// A taxel's place out of range.
    pub fn new(config: &Config) -> Result<Option<Self>, ParameterError> {
        let (base, protection) = (&config.robot.base, &config.protection);
        let uncalibrated =
            protection.contact_barrier == BarrierReadings::Auto && barrier::curves(config).is_none();
        if !uncalibrated || !config.plant.parts.has_cover() {
            return Ok(None);
        }
        let foam = barrier::struck(&config.robot.cover);
        let limit_m: f64 = foam.depth_m(protection.force_limit_n / CREDIBLE);
        Ok(Some(Self {
            outline: CoverOutline::new(&config.robot.cover.placements())?,
            around_corner: around_corners(&config.robot.cover.placements()),
            travel_m: (limit_m - foam.depth_m(protection.threshold_force_n)).max(0.0),
            servo_s: base.servo_time_constant_s,
            deceleration_m_s2: base.acceleration_max_m_s2,
            touched: [false; TAXELS],
            state: PushCapState { way_body: [0.0; 3], held: [None; TAXELS] },
        }))
    }

    /// Returns its memory.
    pub const fn state(&self) -> PushCapState {
        self.state
    }

    /// Goes on from where `state` was taken.
    pub const fn restore(&mut self, state: &PushCapState) {
        self.state = *state;
    }

    /// Takes in which taxels are touched, confirmed or not.
    pub fn feel(&mut self, cover: &CoverState) {
        let taxels =
            cover.poll.reading.taxels.iter().zip(cover.poll.early.touched).zip(cover.poll.early.light);
        for (touched, ((taxel, early), light)) in self.touched.iter_mut().zip(taxels) {
            *touched = early || light || (taxel.status == TaxelStatus::Ok && taxel.force_n > 0.0);
        }
    }

    /// Moves on by `dt_s` with the base's measured velocity, axes of B, m/s, m/s, rad/s, and blocks every taxel that could not stop any
    /// later, for a base that brakes within `limit` (m/s², m/s², rad/s²) and its own ability. `led`: a program moves the flange.
    pub fn advance(
        &mut self,
        velocity_body: [f64; 3],
        limit: [f64; 3],
        led: bool,
        dt_s: f64,
        blocked: &mut [bool; TAXELS],
    ) {
        let PushCapState { way_body, held } = &mut self.state;
        let touched = self.touched;
        if !touched.contains(&true) && held.iter().all(Option::is_none) {
            *way_body = [0.0; 3];
            return;
        }
        for (way, speed) in way_body.iter_mut().zip(velocity_body) {
            *way += speed * dt_s;
        }
        let brakes_m_s2 = limit[0].min(limit[1]).min(self.deceleration_m_s2);
        for (taxel, corner) in self.around_corner.iter().enumerate() {
            let speed_m_s = self.outline.outward(taxel, &velocity_body);
            let way_m = self.outline.outward(taxel, way_body);
            let held = &mut held[taxel];
            let beside = led && corner.iter().zip(touched).any(|(corner, touched)| *corner && touched);
            if touched[taxel] || beside {
                let start = Held { far_m: way_m + self.travel_m, stood: false, free_s: 0.0 };
                let held = held.get_or_insert(start);
                held.free_s = 0.0;
                if !held.stood && speed_m_s <= SLOWEST_M_S {
                    (held.stood, held.far_m) = (true, held.far_m.min(way_m));
                }
            }
            let Some(now) = held else { continue };
            let going_m_s = speed_m_s.max(0.0);
            let stopping_m = going_m_s * self.servo_s + going_m_s * going_m_s / (2.0 * brakes_m_s2);
            blocked[taxel] |= now.far_m - way_m <= stopping_m + ROUNDING_M;
            now.free_s += dt_s;
            if now.free_s > RECOVERS_S {
                *held = None;
            }
        }
    }
}

/// The taxels of another side that may feel the body that touches a taxel, taxel by taxel.
fn around_corners(taxels: &[TaxelPlacement]) -> Vec<[bool; TAXELS]> {
    let beside = |a: &TaxelPlacement, b: &TaxelPlacement| {
        let [dx, dy] = [0, 1].map(|axis| a.position_base_m[axis] - b.position_base_m[axis]);
        let same_side = (a.inward_angle_base_rad - b.inward_angle_base_rad).cos() > SAME_SIDE;
        !same_side && dx.hypot(dy) <= BODY_M
    };
    let row = |a| std::array::from_fn(|other| taxels.get(other).is_some_and(|b| beside(a, b)));
    taxels.iter().map(row).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::barrier::BaseMotion;
    use crate::robot::JOINTS;
    use moca_msgs::RobotState;

    const DT_S: f64 = 1e-3;
    /// In front.
    const FRONT: usize = 5;

    fn cap() -> PushCap {
        PushCap::new(&Config::default()).unwrap().unwrap()
    }

    fn touched(taxel: usize) -> CoverState {
        let mut cover = CoverState::NONE;
        cover.poll.reading.taxels[taxel].force_n = 10.0;
        cover
    }

    fn forward(speed_m_s: f64, yaw_rad: f64) -> RobotState<JOINTS> {
        RobotState {
            base_pose_world: [1.0, 2.0, yaw_rad],
            base_velocity_world: [speed_m_s * yaw_rad.cos(), speed_m_s * yaw_rad.sin(), 0.0],
            ..RobotState::at_rest([0.0; JOINTS])
        }
    }

    /// The taxels that are blocked after some steps.
    fn steps(cap: &mut PushCap, robot: &RobotState<JOINTS>, steps: u32) -> [bool; TAXELS] {
        let mut blocked = [false; TAXELS];
        for _ in 0..steps {
            blocked = [false; TAXELS];
            cap.advance(BaseMotion::of(robot).velocity_body, [3.0; 3], false, DT_S, &mut blocked);
        }
        blocked
    }

    const FRONT_ALONE: [bool; TAXELS] = {
        let mut taxels = [false; TAXELS];
        taxels[FRONT] = true;
        taxels
    };
    const NONE: [bool; TAXELS] = [false; TAXELS];

    #[test]
    fn cap_is_for_an_uncalibrated_cover_under_a_law_as_shipped() {
        let there = |change: fn(&mut Config)| {
            let mut config = Config::default();
            change(&mut config);
            PushCap::new(&config).unwrap().is_some()
        };
        assert!(there(|_| ()));
        assert!(!there(|config| config.board.calibration = "cover.toml".into()), "the barrier is on");
        assert!(!there(|config| config.protection.contact_barrier = BarrierReadings::PuLd30));
        assert!(!there(|config| config.protection.contact_barrier = BarrierReadings::Off));
        assert!(
            there(|config| config.protection.override_speed_limit_m_s = 0.1),
            "another limit is no other cover"
        );
    }

    /// The way is the one in which a foam twice as stiff as the configured one takes up the force limit.
    #[test]
    fn base_that_meets_somebody_goes_on_by_that_way_and_no_further() {
        let config = Config::default();
        let foam = barrier::struck(&config.robot.cover);
        let (from_m, to_m): (f64, f64) = (foam.depth_m(5.2), foam.depth_m(12.5));
        for (yaw_rad, speed_m_s) in [(0.0, 0.03), (2.0, 0.03), (0.0, 0.006)] {
            let mut cap = cap();
            cap.feel(&CoverState::NONE);
            assert_eq!(steps(&mut cap, &forward(speed_m_s, yaw_rad), 500), NONE, "nobody is felt");
            cap.feel(&touched(FRONT));
            let [mut way_m, mut at_m_s] = [0.0, speed_m_s];
            for _ in 0..2000 {
                let blocked = steps(&mut cap, &forward(at_m_s, yaw_rad), 1);
                assert!(blocked == NONE || blocked == FRONT_ALONE);
                way_m += at_m_s * DT_S;
                let ordered_m_s = if blocked[FRONT] { 0.0 } else { speed_m_s };
                let least_m_s = at_m_s - 3.0 * DT_S;
                at_m_s += ((ordered_m_s - at_m_s) * DT_S / config.robot.base.servo_time_constant_s)
                    .max(least_m_s - at_m_s);
            }
            // a tick until the touch is taken in, and one until the order is
            assert!(way_m <= to_m - from_m + 2.0 * speed_m_s * DT_S, "{way_m} m");
            assert!(way_m > 0.6 * (to_m - from_m), "{way_m} m of {}", to_m - from_m);
        }
    }

    #[test]
    fn touched_taxel_comes_back_to_its_place_and_is_free_later() {
        let mut cap = cap();
        cap.feel(&touched(FRONT));
        assert_eq!(
            steps(&mut cap, &forward(0.0, 0.0), 1),
            FRONT_ALONE,
            "who touches a base that stands has come"
        );
        assert_eq!(steps(&mut cap, &forward(-0.02, 0.0), 1000), NONE, "pushed back by 20 mm");
        assert_eq!(steps(&mut cap, &forward(0.02, 0.0), 980), NONE, "it may come back by so much");
        assert_eq!(steps(&mut cap, &forward(0.02, 0.0), 20), FRONT_ALONE);
        let state = cap.state();
        cap.feel(&CoverState::NONE);
        assert_eq!(steps(&mut cap, &forward(0.0, 0.0), 1990), FRONT_ALONE, "he may still be there");
        assert_eq!(steps(&mut cap, &forward(0.0, 0.0), 20), NONE);
        cap.restore(&state);
        assert_eq!(steps(&mut cap, &forward(0.0, 0.0), 1), FRONT_ALONE);
    }

    /// T4 is the last of the left side, T5 the first of the front.
    #[test]
    fn led_base_does_not_slide_its_corner_into_somebody() {
        for led in [false, true] {
            let mut cap = cap();
            let mut blocked = NONE;
            for taxel in [3, 2] {
                cap.feel(&touched(taxel));
                for _ in 0..2100 {
                    blocked = NONE;
                    cap.advance([0.01, 0.0, 0.0], [3.0; 3], led, DT_S, &mut blocked);
                }
                assert!(blocked[taxel], "the base stands before it");
                assert_eq!(blocked[4], led && taxel == 3, "T5, T{} touched", taxel + 1);
            }
        }
    }

    #[test]
    fn touch_too_light_for_a_force_counts() {
        for light in [false, true] {
            let mut cap = cap();
            let mut cover = CoverState::NONE;
            *(if light { &mut cover.poll.early.light } else { &mut cover.poll.early.touched }) = FRONT_ALONE;
            cap.feel(&cover);
            assert_eq!(steps(&mut cap, &forward(0.0, 0.0), 1), FRONT_ALONE);
        }
    }
}
