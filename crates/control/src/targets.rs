//! Targets from other programs: which one counts, for how long, and what a touch does to it. Pure.
//!
//! One target counts at a time, the last that was taken. It ends with its age, with a touch, on request, and with the law
//! that it was given to; then the reference holds.

use crate::config::Config;
use crate::robot::{JOINTS, Parts};
use crate::supervisor::Touch;
use moca_msgs::robot::AnyArm;
use moca_msgs::target::{MAX_WAYPOINTS, Quantity, TargetKind, TargetPhase, check_trajectory};
use moca_msgs::{
    Outcome, Refusal, Request, RobotState, Target, TargetRefusal, TargetState, TimedTarget, TouchPolicy,
    Waypoint, seconds,
};
use moca_wbc::limits::REPULSION_BAND_RAD;
use moca_wbc::nalgebra::Vector3;
use moca_wbc::reference_generator::Workspace;
use moca_wbc::{ControlLaw, FlangePose, rotation};
use serde::{Deserialize, Serialize};

/// Smallest distance of the tool from the base, m.
const CLEARANCE_M: f64 = 0.03;

/// Decides which target counts.
#[derive(Clone, Debug)]
pub struct Targets {
    parts: Parts,
    joints: usize,
    /// Between which a posture may be wanted: nearer to the end of a joint's range the arm is pushed back.
    q_min_rad: [f64; JOINTS],
    q_max_rad: [f64; JOINTS],
    workspace: Workspace,
    state: TargetsState,
}

/// Memory of the targets between ticks.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
pub struct TargetsState {
    law: ControlLaw,
    shown: Option<TargetState>,
    active: Option<Active>,
    waypoints: heapless::Vec<Waypoint, MAX_WAYPOINTS>,
}

#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
struct Active {
    what: What,
    /// After which it is too old; `None` for a trajectory, which lives as long as its commander.
    until_ns: Option<u64>,
    touch: TouchPolicy,
    /// True if the controller has been told since the last change.
    told: bool,
}

#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
enum What {
    Target(Target),
    Trajectory {
        /// Loop time of its start, and as much later as it has been set aside.
        start_ns: u64,
        /// Since when somebody touches.
        aside_since_ns: Option<u64>,
    },
}

/// Order to the controller in one tick.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Order {
    /// Come to rest.
    Hold,
    /// Lead there.
    To(Target),
}

impl Targets {
    /// Builds the targets of the configured robot.
    pub fn new(config: &Config) -> Self {
        let arm = config.arm();
        let ways = arm.table.joint_origin[..arm.joints].iter().skip(1);
        let payload = config.robot.payload();
        let ways = ways.chain([&arm.table.flange_origin, &payload.tool_origin]);
        let reach_m = ways.map(|[x, y, z, ..]| Vector3::new(*x, *y, *z).norm()).sum();
        let mount = &config.robot.mount;
        let [x, y, z, ..] = arm.table.joint_origin.first().copied().unwrap_or_default();
        let shoulder = rotation::from_rpy(mount.rpy_rad) * Vector3::new(x, y, z);
        let [length, width, height] = config.robot.base.size_m;
        let workspace = Workspace {
            shoulder_base_m: (Vector3::from(mount.position_base_m) + shoulder).into(),
            reach_m,
            base_size_m: [length + 2.0 * CLEARANCE_M, width + 2.0 * CLEARANCE_M, height + CLEARANCE_M],
        };
        Self {
            parts: config.plant.parts,
            joints: arm.joints,
            q_min_rad: std::array::from_fn(|i| arm.table.q_min_rad[i] + free_of_ends(arm, i)),
            q_max_rad: std::array::from_fn(|i| arm.table.q_max_rad[i] - free_of_ends(arm, i)),
            workspace,
            state: TargetsState::default(),
        }
    }

    /// Returns the region in which a tool may be wanted.
    pub const fn workspace(&self) -> &Workspace {
        &self.workspace
    }

    /// True while a target leads the robot.
    pub const fn leads(&self) -> bool {
        self.state.active.is_some()
    }

    /// The last target since the law was entered.
    pub const fn shown(&self) -> Option<TargetState> {
        self.state.shown
    }

    /// Returns its memory.
    pub const fn state(&self) -> &TargetsState {
        &self.state
    }

    /// Goes on from there.
    pub fn restore(&mut self, state: &TargetsState) {
        self.state.clone_from(state);
    }

    /// Forgets everything, because the law that was led has ended or another one begins.
    pub fn enter(&mut self, law: ControlLaw) {
        if self.state.law != law || law == ControlLaw::Hold && self.state.shown.is_some() {
            self.state = TargetsState { law, ..TargetsState::default() };
        }
    }

    /// Answers a request that the supervisor permits, while `law` runs.
    ///
    /// # Errors
    /// Why the target is not taken; the one before goes on.
    pub fn take(
        &mut self,
        now_ns: u64,
        request: &Request,
        law: ControlLaw,
        base_velocity_max: &[f64; 3],
        robot: &RobotState<JOINTS>,
        touch: Option<Touch>,
    ) -> Outcome {
        match request {
            Request::Target(target) => {
                self.check(target, law, base_velocity_max, robot)?;
                self.untouched(target.touch, touch)?;
                let left_s = (target.age_limit_s - target.age_s).max(0.0);
                let until_ns = Some(now_ns + nanoseconds(left_s));
                self.begin(What::Target(target.target), until_ns, target.touch);
            }
            Request::Waypoint { index, count, waypoint, touch: policy } => {
                self.collect(*index, *count, waypoint, robot)?;
                if index + 1 == *count {
                    self.untouched(*policy, touch)?;
                    self.begin(What::Trajectory { start_ns: now_ns, aside_since_ns: None }, None, *policy);
                }
            }
            _ => self.end(TargetPhase::Ended),
        }
        Ok(())
    }

    /// Targets that a request leads to, as far as its numbers are those of a target: of a trajectory's pose the middle of the way
    /// from the one before it, and the pose.
    pub fn led_through(&self, request: &Request) -> [Option<Target>; 2] {
        match request {
            Request::Target(target) if target.check().is_ok() => [None, Some(target.target)],
            Request::Waypoint { waypoint, .. } if check_trajectory(&[*waypoint]).is_ok() => {
                let pose = |waypoints: &[Waypoint], time_s| pose_at(waypoints, time_s);
                let before = self.state.waypoints.last().filter(|before| before.time_s < waypoint.time_s);
                let middle = before
                    .and_then(|before| pose(&[*before, *waypoint], 0.5 * (before.time_s + waypoint.time_s)));
                [middle, pose(&[*waypoint], waypoint.time_s)]
            }
            _ => [None, None],
        }
    }

    fn untouched(&self, policy: TouchPolicy, touch: Option<Touch>) -> Outcome {
        match touch {
            Some(Touch { taxel, force_n }) if policy == TouchPolicy::TouchWins => {
                Err(Refusal::Touched { taxel, force_n })
            }
            _ => Ok(()),
        }
    }

    fn begin(&mut self, what: What, until_ns: Option<u64>, touch: TouchPolicy) {
        let told = self.state.active.is_some_and(|active| active.what == what && active.told);
        self.state.active = Some(Active { what, until_ns, touch, told });
        let kind = match what {
            What::Target(target) => target.kind(),
            What::Trajectory { .. } => TargetKind::Trajectory,
        };
        self.state.shown = Some(TargetState { kind, phase: TargetPhase::Moving, progress: 0.0 });
    }

    /// The reference holds from the next tick on.
    fn end(&mut self, phase: TargetPhase) {
        self.state.active = None;
        if let Some(shown) = &mut self.state.shown {
            shown.phase = phase;
        }
    }

    fn check(
        &self,
        timed: &TimedTarget,
        law: ControlLaw,
        base_velocity_max: &[f64; 3],
        robot: &RobotState<JOINTS>,
    ) -> Result<(), TargetRefusal> {
        timed.check()?;
        timed.check_age()?;
        match &timed.target {
            Target::BaseVelocity { velocity_body } => {
                match (self.parts, law) {
                    (Parts::Arm, _) => return Err(TargetRefusal::NoSuchPart),
                    (Parts::Whole, ControlLaw::Impedance | ControlLaw::Hold) => {
                        return Err(TargetRefusal::NeedsFollowMe);
                    }
                    (Parts::Base, _) | (Parts::Whole, ControlLaw::FollowMe) => {}
                }
                let axes = velocity_body.iter().zip(base_velocity_max);
                Quantity::BaseVelocity.each_within(axes.map(|(v, most)| (*v, -most, *most)))
            }
            _ if !self.parts.has_arm() => Err(TargetRefusal::NoSuchPart),
            Target::Pose { position_world, .. } => self.check_place(position_world, robot),
            Target::Twist { .. } => Ok(()),
            Target::Posture(q_rad) => {
                let q_rad = q_rad.as_slice();
                #[expect(clippy::cast_precision_loss, reason = "numbers of joints")]
                let [given, joints] = [q_rad.len(), self.joints].map(|count| count as f64);
                Quantity::Joints.within(&[given], joints, joints)?;
                let ranges = self.q_min_rad.iter().zip(&self.q_max_rad);
                let joints = q_rad.iter().zip(ranges);
                Quantity::JointAngle.each_within(joints.map(|(q, (least, most))| (*q, *least, *most)))
            }
        }
    }

    /// Checks the place of a tool, relative to where the base stands.
    fn check_place(
        &self,
        position_world: &[f64; 3],
        robot: &RobotState<JOINTS>,
    ) -> Result<(), TargetRefusal> {
        let [x, y, yaw] = robot.base_pose_world;
        let from_base = [position_world[0] - x, position_world[1] - y, position_world[2]];
        let position_base = rotation::Heading::at(yaw).to_base(from_base);
        Quantity::Reach.within(&[self.workspace.distance(&position_base)], 0.0, self.workspace.reach_m)?;
        Quantity::DepthInBase.within(&[self.workspace.depth_in_base(&position_base)], 0.0, 0.0)
    }

    fn collect(
        &mut self,
        index: u8,
        count: u8,
        waypoint: &Waypoint,
        robot: &RobotState<JOINTS>,
    ) -> Result<(), TargetRefusal> {
        if !self.parts.has_arm() {
            return Err(TargetRefusal::NoSuchPart);
        }
        if index == 0 {
            // The poses of the one before are gone with it.
            if matches!(self.state.active, Some(Active { what: What::Trajectory { .. }, .. })) {
                self.end(TargetPhase::Ended);
            }
            self.state.waypoints.clear();
        }
        let waypoints = &mut self.state.waypoints;
        let in_turn = usize::from(index) == waypoints.len() && index < count;
        let collected =
            in_turn.then_some(()).ok_or(TargetRefusal::OutOfTurn).and_then(|()| match waypoints.last() {
                None => check_trajectory(&[*waypoint]),
                Some(before) => check_trajectory(&[*before, *waypoint]),
            });
        let collected = collected.and_then(|()| self.check_place(&waypoint.position_world, robot));
        let waypoints = &mut self.state.waypoints;
        let collected =
            collected.and_then(|()| waypoints.push(*waypoint).map_err(|_| TargetRefusal::OutOfTurn));
        if collected.is_err() {
            // What comes after it is out of turn too.
            waypoints.clear();
        }
        collected
    }

    /// Returns the order to the controller in the tick at `now_ns`, if it is new. `reached` is true if the reference rests where
    /// it was led.
    pub fn advance(&mut self, now_ns: u64, touched: bool, reached: bool) -> Option<Order> {
        let mut active = self.state.active?;
        if active.until_ns.is_some_and(|until_ns| now_ns > until_ns) {
            let there = self.state.shown.is_some_and(|shown| shown.phase == TargetPhase::Reached);
            self.end(if there { TargetPhase::Reached } else { TargetPhase::Aged });
            return Some(Order::Hold);
        }
        if touched && active.touch == TouchPolicy::TouchWins {
            self.end(TargetPhase::EndedByTouch);
            return Some(Order::Hold);
        }
        let shown = self.state.shown.as_mut()?;
        if touched {
            let order = (shown.phase != TargetPhase::SetAside).then_some(Order::Hold);
            shown.phase = TargetPhase::SetAside;
            active.told = false;
            if let What::Trajectory { aside_since_ns, .. } = &mut active.what {
                aside_since_ns.get_or_insert(now_ns);
            }
            self.state.active = Some(active);
            return order;
        }
        let order = match active.what {
            What::Target(target) => {
                let there = active.told
                    && reached
                    && !matches!(target, Target::Twist { .. } | Target::BaseVelocity { .. });
                shown.phase = if there { TargetPhase::Reached } else { TargetPhase::Moving };
                shown.progress = f64::from(u8::from(there));
                (!active.told).then_some(Order::To(target))
            }
            What::Trajectory { start_ns, aside_since_ns } => {
                // It goes on where it was, and not where it would be.
                let start_ns =
                    start_ns + aside_since_ns.map_or(0, |since_ns| now_ns.saturating_sub(since_ns));
                active.what = What::Trajectory { start_ns, aside_since_ns: None };
                let waypoints = &self.state.waypoints;
                let time_s = seconds(now_ns.saturating_sub(start_ns));
                let end_s = waypoints.last().map_or(0.0, |last| last.time_s);
                let over = time_s >= end_s;
                shown.progress = if over { 1.0 } else { time_s / end_s };
                shown.phase =
                    if over && reached && active.told { TargetPhase::Reached } else { TargetPhase::Moving };
                let order = (!over || !active.told).then(|| pose_at(waypoints, time_s)).flatten();
                // The last pose is told once.
                active.told = over;
                order.map(Order::To)
            }
        };
        if !matches!(active.what, What::Trajectory { .. }) {
            active.told = true;
        }
        self.state.active = Some(active);
        order
    }
}

/// Returns the smallest distance of a posture from the ends of a joint's range, rad.
fn free_of_ends(arm: &AnyArm, joint: usize) -> f64 {
    REPULSION_BAND_RAD.min(0.5 * (arm.table.q_max_rad[joint] - arm.table.q_min_rad[joint]))
}

/// The pose of a trajectory at a time, s: straight between its poses, turning about a fixed axis.
fn pose_at(waypoints: &[Waypoint], time_s: f64) -> Option<Target> {
    let next = waypoints.partition_point(|waypoint| waypoint.time_s <= time_s);
    let (Some(after), Some(before)) =
        (waypoints.get(next), next.checked_sub(1).and_then(|i| waypoints.get(i)))
    else {
        let end = if next == 0 { waypoints.first() } else { waypoints.last() }?;
        let Waypoint { position_world, quaternion_world, .. } = *end;
        return Some(Target::Pose { position_world, quaternion_world });
    };
    let share = (time_s - before.time_s) / (after.time_s - before.time_s);
    let [from, to] = [before, after].map(|waypoint| rotation::from_quaternion(waypoint.quaternion_world));
    let turn = rotation::error(&from, &to) * share;
    let (from_m, to_m) = (before.position_world, after.position_world);
    Some(Target::Pose {
        position_world: std::array::from_fn(|i| from_m[i] + share * (to_m[i] - from_m[i])),
        quaternion_world: rotation::to_quaternion(&(rotation::exp(&turn) * from)),
    })
}

/// A target for an arm of `N` joints; `None` for the base's.
pub fn arm_target<const N: usize>(order: &Order) -> Option<moca_wbc::Target<N>> {
    Some(match *order {
        Order::Hold => moca_wbc::Target::Hold,
        Order::To(Target::Pose { position_world, quaternion_world }) => {
            moca_wbc::Target::Pose(FlangePose { position_world, quaternion_world })
        }
        Order::To(Target::Twist { axes, twist }) => moca_wbc::Target::Twist { axes, twist },
        Order::To(Target::Posture(q_rad)) => {
            let mut posture = [0.0; N];
            posture.iter_mut().zip(q_rad.as_slice()).for_each(|(to, from)| *to = *from);
            moca_wbc::Target::Posture(posture)
        }
        Order::To(Target::BaseVelocity { .. }) => return None,
    })
}

fn nanoseconds(seconds: f64) -> u64 {
    #[expect(
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss,
        reason = "an age limit, checked before"
    )]
    let ns = (seconds * 1e9) as u64;
    ns
}
