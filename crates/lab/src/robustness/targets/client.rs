//! A program that asks for whatever comes to its mind.

use super::Outcome;
use crate::robustness::self_collision::{in_ball, share, twist};
use moca_control::config::Config;
use moca_control::targets::Targets;
use moca_experiments::JOINTS;
use moca_lockstep::inject::Random;
use moca_msgs::target::{SPEED_MAX_M_S, SPEED_MAX_RAD_S};
use moca_msgs::{
    ArmTable, Law, Outcome as Answer, ParameterValues, Refusal, Request, Sample, Target, TargetRefusal,
    TimedTarget, TouchPolicy, TwistAxes, Waypoint,
};
use moca_wbc::limits::REPULSION_BAND_RAD;
use moca_wbc::reference_generator::Workspace;
use moca_wbc::rotation;

/// Ticks between two targets of a program that renews them as the command line does.
const RENEWED_EVERY: u64 = 50;
/// Poses of one trajectory at most.
const POSES_MAX: usize = 6;

/// Subject of a program's requests.
enum Whim {
    /// A target that is repeated.
    Steady(Target),
    /// One of two, in turn, each so many ticks.
    Jump([Target; 2], u64),
    /// Another pose in every tick.
    Flood,
    /// Poses that are sent, one a tick; then it waits.
    Trajectory(Vec<Waypoint>),
    /// A target that no robot could follow.
    Nonsense(TimedTarget),
    /// Nothing: what it led to grows old.
    Silence,
    /// An end, then nothing.
    End,
}

pub(super) struct Client {
    random: Random,
    law: Law,
    arm: ArmTable<JOINTS>,
    workspace: Workspace,
    whim: Whim,
    /// Ticks since it began, and at which it ends.
    tick: u64,
    until: u64,
}

impl Client {
    pub(super) fn new(config: &Config, law: Law, arm: ArmTable<JOINTS>, seed: u64) -> Self {
        let workspace = *Targets::new(config).workspace();
        let random = Random::new(seed);
        Self { random, law, arm, workspace, whim: Whim::Silence, tick: 0, until: 100 }
    }

    /// Returns the request of this tick.
    pub(super) fn ask(&mut self, sample: &Sample) -> Option<Request> {
        if self.tick >= self.until {
            self.tick = 0;
            self.until = 200 + self.random.bits() % 5000;
            self.whim = self.another(sample);
        }
        let tick = self.tick;
        self.tick += 1;
        if matches!(self.whim, Whim::Flood) {
            return Some(Request::Target(TimedTarget::new(self.pose(sample))));
        }
        let due = tick.is_multiple_of(RENEWED_EVERY);
        match &self.whim {
            Whim::Steady(target) => due.then(|| Request::Target(TimedTarget::new(*target))),
            Whim::Jump(targets, each) => {
                let [one, other] = *targets;
                let target = if (tick / each).is_multiple_of(2) { one } else { other };
                tick.is_multiple_of(*each).then(|| Request::Target(TimedTarget::new(target)))
            }
            Whim::Trajectory(waypoints) => {
                let index = u8::try_from(tick).ok()?;
                let waypoint = *waypoints.get(usize::from(index))?;
                let count = u8::try_from(waypoints.len()).ok()?;
                Some(Request::Waypoint { index, count, waypoint, touch: TouchPolicy::TouchWins })
            }
            Whim::Nonsense(target) => due.then_some(Request::Target(*target)),
            Whim::End => (tick == 0).then_some(Request::EndTarget),
            Whim::Flood | Whim::Silence => None,
        }
    }

    /// Takes the answer.
    pub(super) fn hear(&self, request: Option<Request>, answer: Option<Answer>, outcome: &mut Outcome) {
        let (Some(request), Some(answer)) = (request, answer) else { return };
        let nonsense = matches!(self.whim, Whim::Nonsense(_));
        match answer {
            Ok(()) => {
                let kind = match request {
                    Request::Target(TimedTarget { target, .. }) => target.kind().name(),
                    Request::Waypoint { .. } => "trajectory",
                    _ => "end",
                };
                outcome.taken += 1;
                outcome.kinds.insert(kind);
                if nonsense {
                    outcome.wrong.push(format!("taken: {request:?}"));
                }
            }
            // Whatever it is, it is about the target and says so.
            Err(Refusal::Target(refusal)) if nonsense || self.may_be_refused(&request, refusal) => {
                outcome.refused += 1;
            }
            Err(refusal) => outcome.wrong.push(format!("{request:?}: {refusal}")),
        }
    }

    /// Returns true for targets drawn blindly that may be refused: a pose inside the base, too little time, a held base.
    fn may_be_refused(&self, request: &Request, refusal: TargetRefusal) -> bool {
        match request {
            Request::Target(TimedTarget { target: Target::BaseVelocity { .. }, .. }) => {
                self.law == Law::Impedance && refusal == TargetRefusal::NeedsFollowMe
            }
            Request::Target(TimedTarget { target: Target::Pose { .. }, .. }) | Request::Waypoint { .. } => {
                let said = refusal.to_string();
                ["distance from the arm's shoulder", "depth inside the base", "out of turn"]
                    .iter()
                    .any(|known| said.contains(known))
                    || refusal == TargetRefusal::OutOfTurn
            }
            _ => false,
        }
    }

    fn another(&mut self, sample: &Sample) -> Whim {
        match self.random.below(14) {
            0..=3 => Whim::Steady(self.pose(sample)),
            4 => {
                let each = [1, 10, 100, 700][self.random.below(4)];
                Whim::Jump([self.pose(sample), self.pose(sample)], each)
            }
            5 => {
                self.until = self.until.min(1000);
                Whim::Flood
            }
            6 | 7 => Whim::Steady(twist(&mut self.random)),
            8 | 9 => Whim::Steady(self.posture()),
            10 => Whim::Trajectory(self.trajectory(sample)),
            11 => Whim::Steady(self.base()),
            12 => {
                self.until = self.until.min(500);
                Whim::Nonsense(self.nonsense(sample))
            }
            _ => {
                self.until = self.until.min(1000);
                if self.random.one_in(2) { Whim::Silence } else { Whim::End }
            }
        }
    }

    fn quaternion(&mut self) -> [f64; 4] {
        let v: [f64; 4] = in_ball(&mut self.random);
        let length = v.iter().map(|x| x * x).sum::<f64>().sqrt();
        v.map(|x| x / length)
    }

    /// Anywhere within reach, or a little beyond it, turned anyhow.
    fn pose(&mut self, sample: &Sample) -> Target {
        let Workspace { shoulder_base_m, reach_m, .. } = self.workspace;
        let ball: [f64; 3] = in_ball(&mut self.random);
        let from_base: [f64; 3] = std::array::from_fn(|i| shoulder_base_m[i] + 1.02 * reach_m * ball[i]);
        let [x, y, yaw] = sample.base_pose_world;
        let [fx, fy, fz] = rotation::Heading::at(yaw).to_world(from_base);
        Target::Pose { position_world: [x + fx, y + fy, fz], quaternion_world: self.quaternion() }
    }

    fn posture(&mut self) -> Target {
        let (low, high) = (self.arm.q_min_rad, self.arm.q_max_rad);
        let corner = self.random.one_in(4);
        let q: [f64; JOINTS] = std::array::from_fn(|i| {
            let share = share(&mut self.random);
            let share = if corner { share.signum() } else { share };
            // Nearer to its end the range pushes back.
            0.5 * (low[i] + high[i] + share * (high[i] - low[i] - 2.001 * REPULSION_BAND_RAD))
        });
        Target::Posture(ParameterValues::new(&q).unwrap_or_default())
    }

    fn base(&mut self) -> Target {
        let most = [0.5, 0.5, 0.8];
        Target::BaseVelocity { velocity_body: most.map(|most| most * share(&mut self.random)) }
    }

    fn trajectory(&mut self, sample: &Sample) -> Vec<Waypoint> {
        let [mut x, mut y, mut z] = sample.flange_desired_position_world;
        let (mut time_s, mut way_s, mut before) = (0.0, 0.0_f64, None);
        let count = 2 + self.random.below(POSES_MAX - 1);
        (0..count)
            .map(|_| {
                let quaternion_world = self.quaternion();
                // At 0.8 of the fastest that is allowed.
                let turn_rad = before.map_or(0.0, |before| angle_rad(&before, &quaternion_world));
                time_s += way_s.max(turn_rad / (0.8 * SPEED_MAX_RAD_S));
                before = Some(quaternion_world);
                let waypoint = Waypoint { time_s, position_world: [x, y, z], quaternion_world };
                let way: [f64; 3] = in_ball(&mut self.random).map(|v: f64| 0.4 * v);
                way_s = way.iter().fold(0.05, |most, v| v.abs().max(most)) / (0.8 * SPEED_MAX_M_S);
                [x, y, z] = [x + way[0], y + way[1], z + way[2]];
                waypoint
            })
            .collect()
    }

    /// Each of them is refused.
    fn nonsense(&mut self, sample: &Sample) -> TimedTarget {
        let Target::Pose { position_world, quaternion_world } = self.pose(sample) else {
            return TimedTarget { age_s: 9.0, ..TimedTarget::new(twist(&mut self.random)) };
        };
        let [x, y, _] = sample.base_pose_world;
        let at = |position_world| Target::Pose { position_world, quaternion_world };
        let turned = |quaternion_world| Target::Pose { position_world, quaternion_world };
        let twist = |twist| Target::Twist { axes: TwistAxes::World, twist };
        let posture = |q: &[f64]| Target::Posture(ParameterValues::new(q).unwrap_or_default());
        let mut beyond = self.arm.home_rad;
        beyond[3] = 0.5;
        let targets = [
            at([f64::NAN, y, 0.5]),
            at([x, f64::INFINITY, 0.5]),
            at([x + 2.5, y, 0.8]),
            at([x, y, 0.2]),
            turned([0.0; 4]),
            turned([f64::NAN; 4]),
            turned([2.0, 0.0, 0.0, 0.0]),
            twist([0.3, 0.0, 0.0, 0.0, 0.0, 0.0]),
            twist([0.0, 0.0, 0.0, 0.0, -1.1, 0.0]),
            twist([0.0, 0.0, f64::NAN, 0.0, 0.0, 0.0]),
            posture(&beyond),
            posture(&[f64::NAN; JOINTS]),
            posture(&[0.0; JOINTS - 1]),
            Target::BaseVelocity { velocity_body: [f64::NAN, 0.0, 0.0] },
            Target::BaseVelocity { velocity_body: [0.0, 0.0, 9.0] },
        ];
        let drawn = self.random.below(targets.len() + 3);
        let good = TimedTarget::new(twist([0.1, 0.0, 0.0, 0.0, 0.0, 0.0]));
        match targets.get(drawn) {
            Some(target) => TimedTarget::new(*target),
            None if drawn == targets.len() => TimedTarget { age_s: 0.21, ..good },
            None if drawn == targets.len() + 1 => TimedTarget { age_s: -0.06, ..good },
            None => TimedTarget { age_limit_s: 60.0, ..good },
        }
    }
}

/// Angle of the turn from one orientation to the other, rad.
fn angle_rad(a: &[f64; 4], b: &[f64; 4]) -> f64 {
    2.0 * a.iter().zip(b).map(|(a, b)| a * b).sum::<f64>().abs().min(1.0).acos()
}
