//! The paper's pushes under the contact barrier, beside the same law without it.

use super::push::{self, Outcome, Push};
use super::pushes;
use anyhow::{Context, Result};
use moca_control::barrier;
use moca_experiments::closed_loop::Rig;
use moca_experiments::parallel;
use moca_experiments::settings::Settings;
use moca_msgs::Law;
use moca_msgs::robot::TaxelPlacement;
use std::fmt::Write as _;

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

/// One of the experiments with the barrier off or on.
#[derive(Clone, Copy, Debug)]
pub(super) struct Run {
    law: Law,
    barrier: &'static str,
}

impl Run {
    pub(super) const ALL: [Self; 4] = [
        Self { law: Law::Impedance, barrier: "off" },
        Self { law: Law::Impedance, barrier: "pu-ld30" },
        Self { law: Law::FollowMe, barrier: "off" },
        Self { law: Law::FollowMe, barrier: "pu-ld30" },
    ];

    pub(super) fn settings(&self) -> Result<Settings> {
        let mut settings = Settings::paper(self.law);
        let barrier = format!("barrier={}", self.barrier);
        settings.set_all(["board.model=pu-ld30", "sensor.firmware=moca", &barrier])?;
        Ok(settings)
    }

    pub(super) fn pushes(&self) -> [Push; 5] {
        if self.law == Law::Impedance { pushes::pushes_b1() } else { pushes::pushes_b2() }
    }

    /// Each push from home: one after the other they would begin where the one before has left the robot, with the barrier
    /// elsewhere than without it.
    fn outcomes(&self) -> Result<Vec<Outcome>> {
        let settings = self.settings()?;
        let alone = |push: &Push| -> Result<Outcome> {
            let mut rig = Rig::start(&settings, &settings.free_scene())?;
            let outcome = push::run(&mut rig, &settings, std::slice::from_ref(push))?.pop();
            outcome.with_context(|| format!("{}: {}", push.name, rig.stopped.unwrap_or_default()))
        };
        self.pushes().iter().map(alone).collect()
    }
}

/// Result of a push without the barrier and with it.
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

    /// Why the barrier changes the motion: slow pushes of so many N reach the depths where the base stops and yields.
    fn why(&self, [stop_n, yield_n]: [f64; 2]) -> &'static str {
        if self.is_same() {
            "the same"
        } else if self.pressed_back && self.body_n > stop_n {
            "no pressing back"
        } else if self.body_n > yield_n {
            "room is made"
        } else {
            "**not explained**"
        }
    }

    fn line(&self, depths_n: [f64; 2]) -> String {
        let moved = |[x, y, yaw]: [f64; 3]| format!("({x:.3} m, {y:.3} m, {yaw:.3} rad)");
        let percent = 100.0 * Self::way_m(self.with) / Self::way_m(self.without).max(NOISE_M);
        format!(
            "| {} | {:.0} N | {} | {} | {percent:.0} % | {} |",
            self.name,
            self.body_n,
            moved(self.without),
            moved(self.with),
            self.why(depths_n)
        )
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

fn pairs() -> Result<Vec<Pair>> {
    let outcomes = parallel::run("pushes", &Run::ALL, Run::outcomes, |_| ());
    let outcomes = outcomes.into_iter().collect::<Result<Vec<_>>>()?;
    let mut pairs = Vec::new();
    for (run, both) in Run::ALL.iter().step_by(2).zip(outcomes.chunks(2)) {
        let cover = run.settings()?.config.robot.cover.placements();
        let [without, with] = both else { continue };
        for (push, (without, with)) in run.pushes().iter().zip(without.iter().zip(with)) {
            let moved = without.base_displacement;
            pairs.push(Pair {
                name: push.name.clone(),
                body_n: body_n(push, &cover),
                without: moved,
                with: with.base_displacement,
                pressed_back: pressed_back(push, &cover, moved),
            });
        }
    }
    Ok(pairs)
}

/// Slow pushes that reach the depth where the base stops pressing, and the one from which on it makes room, N.
fn depths_n() -> Result<[f64; 2]> {
    barrier::slow_pushes_n(&Run::ALL[1].settings()?.config, READING_M)?.context("a barrier")
}

/// The table.
pub(crate) fn markdown() -> Result<String> {
    let depths_n = depths_n()?;
    let mut out = String::from(
        "| push | by one body | without the barrier | with it | as far | |\n|---|---|---|---|---|---|\n",
    );
    for pair in pairs()? {
        // Writing to a string cannot fail.
        let _ = writeln!(out, "{}", pair.line(depths_n));
    }
    Ok(out)
}

#[cfg(test)]
#[test]
fn light_pushes_move_base_as_without_barrier() {
    let [stop_n, yield_n] = depths_n().unwrap();
    println!("the base stops pressing at {stop_n:.1} N of a slow push and makes room from {yield_n:.1} N on");
    let pairs = pairs().unwrap();
    assert_eq!(pairs.len(), 10);
    let mut same = 0;
    for pair in pairs {
        println!("{}", pair.line([stop_n, yield_n]));
        assert_ne!(pair.why([stop_n, yield_n]), "**not explained**", "{}", pair.name);
        same += usize::from(pair.is_same());
    }
    assert_eq!(same, 4, "of ten: two at the flange alone, and those of 10 N on one body");
}
