//! Motion of the base after the hand has left, with either `control.recentre`, and the way back on request.

use anyhow::{Context, Result, ensure};
use moca_control::config::RecentrePolicy;
use moca_control::plant::Simulated;
use moca_experiments::closed_loop::armed;
use moca_experiments::unattended;
use moca_lockstep::simulated_robot::free_scene;
use moca_lockstep::touch_board::ByteCover;
use moca_lockstep::{LockStep, MemoryBoards};
use moca_msgs::{Law, Request, Sample};
use moca_sim::{Engine, VirtualBoardConfig};

/// Leans on one taxel (1 is T1), N, with which the base goes furthest from under the arm.
const LEANS: [(Law, RecentrePolicy, usize, f64); 8] = [
    (Law::Impedance, RecentrePolicy::OnRequest, 1, 40.0),
    (Law::Impedance, RecentrePolicy::OnRequest, 3, 40.0),
    (Law::Impedance, RecentrePolicy::OnRequest, 6, 100.0),
    (Law::Impedance, RecentrePolicy::OnRequest, 9, 20.0),
    (Law::Impedance, RecentrePolicy::OnRequest, 11, 100.0),
    (Law::Impedance, RecentrePolicy::Always, 3, 40.0),
    (Law::FollowMe, RecentrePolicy::OnRequest, 3, 40.0),
    (Law::FollowMe, RecentrePolicy::OnRequest, 6, 40.0),
];
/// Ways back: taxel and force of the lean before it, and the taxel that is touched on the way.
const WAYS_BACK: [(usize, f64, usize); 1] = [(3, 40.0, 6)];
/// Force of the touch that ends the way back, N.
const TOUCH_N: f64 = 15.0;
/// Duration of a lean, s, and of what is watched after it.
const LEAN_S: f64 = 20.0;
const AFTER_S: f64 = 30.0;
/// Rise of the force, s.
const RAMP_S: f64 = 0.5;
/// Time in which the base rests and a touch has ended the way back, s.
const REST_S: f64 = 2.0;
/// Longest way back, s.
const BACK_S: f64 = 120.0;
/// Way back before the touch, s.
const TOUCH_AFTER_S: f64 = 5.0;
/// Slower than this the base rests, m/s and rad/s, as in the campaign of attacks.
const RESTS: f64 = 5e-3;

/// Motion of the base after a lean.
#[derive(Clone, Copy, Debug)]
struct Left {
    pushed_m: f64,
    after_m: f64,
    rests_after_s: f64,
    /// Displacement from 2 s after the hand has left to the end, m.
    later_m: f64,
}

/// The base's way back on request.
#[derive(Clone, Copy, Debug)]
struct Back {
    before_m: f64,
    after_m: f64,
    seconds: f64,
    fastest_m_s: f64,
    /// Way in the direction of the motion from a touch on, m.
    beyond_touch_m: f64,
    touch_ended_it: bool,
}

struct World {
    world: LockStep<ByteCover, MemoryBoards>,
    period_s: f64,
    last: Sample,
}

impl World {
    fn armed(law: Law, policy: RecentrePolicy) -> Result<Self> {
        let mut config = unattended(law);
        config.control.recentre = policy;
        let scene = moca_sim::Scene { engine: Engine::Analytic, ..free_scene(&config) };
        let mut world = LockStep::with_board(&config, &scene, VirtualBoardConfig::default(), None)?;
        let last = armed(&mut world)?;
        Ok(Self { world, period_s: 1.0 / f64::from(config.control_loop.rate_hz), last })
    }

    fn step(&mut self, request: Option<Request>) -> &Sample {
        self.last.clone_from(&self.world.tick(request).sample);
        &self.last
    }

    /// Lets `seconds` pass and shows each sample.
    fn pass(&mut self, seconds: f64, mut see: impl FnMut(f64, &Sample)) {
        let mut t_s = 0.0;
        while t_s < seconds {
            self.step(None);
            t_s += self.period_s;
            see(t_s, &self.last);
        }
    }

    fn press(&mut self, taxel: usize, force_n: f64) -> Result<()> {
        ensure!(self.world.control.plant.press(taxel - 1, force_n).is_ok(), "no T{taxel}");
        Ok(())
    }

    fn lean(&mut self, taxel: usize, force_n: f64) -> Result<()> {
        let mut t_s = 0.0;
        while t_s < LEAN_S {
            self.press(taxel, force_n * (t_s / RAMP_S).min(1.0))?;
            self.step(None);
            t_s += self.period_s;
        }
        ensure!(self.last.mode.moves(), "T{taxel}, {force_n} N: {:?}", self.last.fault);
        self.press(taxel, 0.0)
    }
}

fn left(&(law, policy, taxel, force_n): &(Law, RecentrePolicy, usize, f64)) -> Result<Left> {
    let mut world = World::armed(law, policy)?;
    let start = world.last.base_pose_world;
    world.lean(taxel, force_n)?;
    let let_go = world.last.base_pose_world;
    let mut rested = let_go;
    let mut left = Left { pushed_m: distance(start, let_go), after_m: 0.0, rests_after_s: 0.0, later_m: 0.0 };
    world.pass(AFTER_S, |t_s, sample| {
        let pose = sample.base_pose_world;
        left.after_m = left.after_m.max(distance(let_go, pose));
        if sample.base_velocity_world.iter().any(|v| v.abs() > RESTS) {
            left.rests_after_s = t_s;
        }
        if t_s <= REST_S {
            rested = pose;
        }
        left.later_m = left.later_m.max(distance(rested, pose));
    });
    ensure!(world.last.mode.moves(), "T{taxel}, {force_n} N, after it: {:?}", world.last.fault);
    Ok(left)
}

fn back(&(taxel, force_n, touched): &(usize, f64, usize)) -> Result<Back> {
    let off_m = |sample: &Sample| sample.posture.map(|posture| posture.distance_m).context("no posture");
    let recentres = |sample: &Sample| sample.posture.is_some_and(|posture| posture.recentring);
    let mut back = Back {
        before_m: 0.0,
        after_m: 0.0,
        seconds: 0.0,
        fastest_m_s: 0.0,
        beyond_touch_m: 0.0,
        touch_ended_it: false,
    };
    for touch in [false, true] {
        let mut world = World::armed(Law::Impedance, RecentrePolicy::OnRequest)?;
        world.lean(taxel, force_n)?;
        world.pass(REST_S, |_, _| {});
        back.before_m = off_m(&world.last)?;
        world.step(Some(Request::Recentre));
        if touch {
            world.pass(TOUCH_AFTER_S, |_, _| {});
            ensure!(recentres(&world.last), "T{taxel}, {force_n} N: the way back is too short to touch");
            let (from, velocity) = (world.last.base_pose_world, world.last.base_velocity_world);
            let speed = velocity[0].hypot(velocity[1]);
            world.press(touched, TOUCH_N)?;
            world.pass(REST_S, |_, sample| {
                let to = sample.base_pose_world;
                let along = (0..2).map(|i| (to[i] - from[i]) * velocity[i] / speed).sum::<f64>();
                back.beyond_touch_m = back.beyond_touch_m.max(along);
            });
            world.press(touched, 0.0)?;
            world.pass(REST_S, |_, _| {});
            let rest = |sample: &Sample| sample.base_velocity_world.iter().all(|v| v.abs() < RESTS);
            back.touch_ended_it = !recentres(&world.last) && rest(&world.last);
        } else {
            while recentres(&world.last) || back.seconds == 0.0 {
                back.fastest_m_s = back.fastest_m_s.max(world.step(None).cover_speed_m_s);
                back.seconds += world.period_s;
                ensure!(back.seconds < BACK_S, "T{taxel}, {force_n} N: not back after {BACK_S} s");
            }
            back.after_m = off_m(&world.last)?;
        }
    }
    Ok(back)
}

fn distance(a: [f64; 3], b: [f64; 3]) -> f64 {
    (a[0] - b[0]).hypot(a[1] - b[1])
}

mod tests {
    use super::*;
    use moca_control::recentre::RECENTRE_M_S;
    use moca_experiments::parallel;

    #[test]
    fn base_without_a_hand_rests_in_2_s_and_0_15_m_and_stays() {
        let leans: Vec<_> = LEANS.into_iter().filter(|lean| lean.1 == RecentrePolicy::OnRequest).collect();
        let lefts = parallel::run("after a lean", &leans, left).unwrap();
        for (lean, left) in leans.iter().zip(lefts) {
            assert!(left.pushed_m > 0.1, "{lean:?}: {left:?}");
            assert!(left.rests_after_s < REST_S && left.after_m < 0.15, "{lean:?}: {left:?}");
            assert!(left.later_m < 0.005, "{lean:?}: {left:?}");
        }
    }

    #[test]
    fn published_law_brings_the_base_back_by_itself() {
        let left = left(&(Law::Impedance, RecentrePolicy::Always, 3, 40.0)).unwrap();
        assert!(left.after_m > 0.3 && left.rests_after_s > REST_S, "{left:?}");
    }

    #[test]
    fn way_back_keeps_its_speed_and_ends_at_a_touch() {
        for (way, back) in WAYS_BACK.iter().zip(parallel::run("ways back", &WAYS_BACK, back).unwrap()) {
            // The arm moves its base against the servo, by less than a micrometre a second here.
            assert!(back.fastest_m_s <= RECENTRE_M_S + 1e-5, "{way:?}: {back:?}");
            assert!(back.fastest_m_s > 0.5 * RECENTRE_M_S, "{way:?}: it never moved: {back:?}");
            assert!(back.after_m < 0.25 * back.before_m, "{way:?}: {back:?}");
            // At that speed a reading's age and the servo's lag are a few millimetres.
            assert!(back.touch_ended_it && back.beyond_touch_m < 0.01, "{way:?}: {back:?}");
        }
    }
}
