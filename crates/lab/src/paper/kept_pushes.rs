//! The paper's pushes under the contact barrier, beside the same law without it.

use super::push::{self, Push};
use super::pushes;
use anyhow::Result;
use moca_control::barrier;
use moca_experiments::closed_loop::Rig;
use moca_experiments::parallel;
use moca_experiments::settings::Settings;
use moca_msgs::robot::TaxelPlacement;

/// A motion within this share of the one without the barrier is the same.
const SAME: f64 = 0.05;
/// A difference shorter than this is none, m.
const NOISE_M: f64 = 0.005;
/// With what lever a turn counts as a way, m: about a taxel's.
const LEVER_M: f64 = 0.5;
/// Noise of a taxel that is pressed with 15 N, m: a count of our firmware's board.
const READING_M: f64 = 0.0003;
/// Taxels that are no further apart feel one body, m.
const BODY_M: f64 = 0.3;

/// Base displacements of each push from home: one after the other they would begin where the one before has left the robot, with the
/// barrier elsewhere than without it.
fn displacements((settings, pushes): &(Settings, [Push; 5])) -> Result<[[f64; 3]; 5]> {
    Ok(pushes.each_ref().map(|push| {
        let mut rig = Rig::start(settings, &settings.free_scene()).unwrap();
        let outcome = push::run(&mut rig, settings, std::slice::from_ref(push)).unwrap().pop();
        outcome.unwrap_or_else(|| panic!("{}: {:?}", push.name, rig.stopped)).base_displacement
    }))
}

/// Result of a push without the barrier and with it.
#[derive(Debug)]
struct Pair {
    name: String,
    /// Largest force of one body on the cover, N.
    body_n: f64,
    without: [f64; 3],
    with: [f64; 3],
    /// True if the base pressed against the pressing hand when there was no barrier.
    pressed_back: bool,
}

impl Pair {
    fn way_m([x, y, yaw]: [f64; 3]) -> f64 {
        x.hypot(y).hypot(LEVER_M * yaw)
    }

    fn is_same(&self) -> bool {
        let apart_m = Self::way_m(std::array::from_fn(|i| self.with[i] - self.without[i]));
        apart_m < NOISE_M.max(SAME * Self::way_m(self.without))
    }
}

/// Largest sum of the forces on taxels that may feel one body, N.
fn body_n(push: &Push, cover: &[TaxelPlacement]) -> f64 {
    let force_n = |i: usize| push.loads.taxel_n.get(i).copied().unwrap_or(0.0);
    let apart_m = |i: usize, j: usize| {
        let [a, b] = [i, j].map(|k| cover[k].position_base_m);
        (a[0] - b[0]).hypot(a[1] - b[1])
    };
    let of = |i: usize| {
        (0..cover.len()).filter(|&j| apart_m(i, j) < BODY_M && force_n(i) > 0.0).map(force_n).sum::<f64>()
    };
    (0..cover.len()).map(of).fold(0.0, f64::max)
}

/// Returns true if the base mostly moved into one of the pressing hands.
fn pressed_back(push: &Push, cover: &[TaxelPlacement], moved: [f64; 3]) -> bool {
    let [x, y, _] = moved;
    let pressed = cover.iter().zip(push.loads.taxel_n).filter(|(_, force_n)| *force_n > 0.0);
    pressed.map(|(taxel, _)| taxel.inward_angle_base_rad).any(|inward_rad| {
        let (sin, cos) = inward_rad.sin_cos();
        x * cos + y * sin < -0.5 * Pair::way_m(moved)
    })
}

fn pairs() -> Vec<Pair> {
    let runs = pushes::under_barrier().unwrap();
    let moved = parallel::run("pushes", &runs, displacements).unwrap();
    let pair_of = |(settings, pushes): &(Settings, [Push; 5]), moved: &[[[f64; 3]; 5]]| {
        let cover = settings.config.robot.cover.placements();
        let pair = |(i, push): (usize, &Push)| Pair {
            name: push.name.clone(),
            body_n: body_n(push, &cover),
            without: moved[0][i],
            with: moved[1][i],
            pressed_back: pressed_back(push, &cover, moved[0][i]),
        };
        pushes.iter().enumerate().map(pair).collect::<Vec<_>>()
    };
    runs.iter().step_by(2).zip(moved.chunks(2)).flat_map(|(run, moved)| pair_of(run, moved)).collect()
}

#[test]
fn light_pushes_move_base_as_without_barrier() {
    // Slow pushes that reach the depth where the base stops pressing, and the one from which on it makes room.
    let config = &pushes::under_barrier().unwrap()[1].0.config;
    let [stop_n, yield_n] = barrier::slow_pushes_n(config, READING_M).unwrap().unwrap();
    assert!(stop_n < 8.0, "the base presses somebody with {stop_n} N");
    let pairs = pairs();
    assert_eq!(pairs.len(), 10);
    for pair in &pairs {
        let of_without = Pair::way_m(pair.with) / Pair::way_m(pair.without);
        if pair.is_same() {
            continue;
        }
        if pair.pressed_back && pair.body_n > stop_n {
            assert!(of_without < 0.5, "{}: {pair:?}", pair.name);
        } else {
            assert!(pair.body_n > yield_n && of_without > 1.4, "{}: {pair:?}", pair.name);
        }
    }
    let same = pairs.iter().filter(|pair| pair.is_same()).count();
    assert_eq!(same, 4, "of ten: two at the flange alone, and those of 10 N on one body: {pairs:?}");
}
