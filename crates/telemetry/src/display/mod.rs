//! Messages for people, in a log and in a live viewer alike: the messages of a run, and when each is due.
//!
//! Two kinds: records of our own ([`crate::log::records`]), and the messages that every viewer of ROS 2 data knows: transforms,
//! poses, joint states, markers, sentences. Frames, units and names are those of the robot's URDF.
//!
//! Layers: [`crate::ros`] (messages of ROS 2) · `markers` (those for viewers) · `numbers` (ours in the same form) · `frames`,
//! `scene`, `sentences` (a sample as such messages) · [`Display`] (when).

mod frames;
mod markers;
mod numbers;
mod scene;
mod sentences;

use crate::{
    RobotDescription,
    log::{
        LogError,
        records::{
            BoardChange, Channel, Command, Contact, Cover, FaultChange, Gripper, Link, ModeChange, State,
            Target, Timing,
        },
        shown::shown,
    },
    ros::{
        Message,
        messages::{JointState, PoseStamped, TFMessage, Text, Time, WrenchStamped},
    },
};
use markers::{Log, Markers};
use moca_msgs::{Fault, Mode, STAGES, Sample, board::Diagnosis};

/// TFMessage that change.
const TF: &str = "/tf";
/// TFMessage that never change.
const TF_STATIC: &str = "/tf_static";
const FLANGE: &str = "/flange";
const FLANGE_DESIRED: &str = "/flange_desired";
const COVER_WRENCH: &str = "/cover_wrench";
const JOINT_STATES: &str = "/joint_states";
const BODIES: &str = "/scene/robot";
const TOUCH: &str = "/scene/touch";
const LOG: &str = "/log";
const URDF: &str = "/robot_description";

/// The time between loop and wall is looked at once in so many arrivals: one that comes late says nothing.
const ARRIVALS_PER_LOOK: u32 = 100;
/// Beyond this the two have drifted apart, ns: ticks were lost, or the clock was set.
const DRIFT_NS: u64 = 50_000_000;
/// A touch is drawn at most so often, ns.
const TOUCH_PERIOD_NS: u64 = 40_000_000;

/// Receiver of messages.
pub trait Sink {
    /// There will be records of this kind.
    fn offer_record<C: Channel + Message>(&mut self) -> Result<(), LogError>;

    /// There will be messages of this kind on `topic`.
    fn offer<M: Message>(&mut self, topic: &'static str) -> Result<(), LogError>;

    /// Takes a record of `time_ns`, loop time.
    fn record<C: Channel + Message>(&mut self, time_ns: u64, record: &C) -> Result<(), LogError>;

    /// Takes a message of `time_ns`, loop time.
    fn message<M: Message>(&mut self, topic: &'static str, time_ns: u64, message: &M)
    -> Result<(), LogError>;
}

/// Periods of messages, ns of loop time; a period of 0 is each tick.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Periods {
    /// The records.
    pub numbers_ns: u64,
    /// TFMessage, poses, joints, the cover's wrench.
    pub poses_ns: u64,
    /// Period of constant messages, for a viewer that connects later.
    pub fixed_ns: u64,
}

/// State that changes now and then: mode, fault, and state of the board.
type Situation = (Mode, Option<Fault>, Diagnosis);

/// Turns samples into the messages that are due.
pub struct Display {
    robot: RobotDescription,
    /// Unix time of loop time 0, ns.
    start_unix_ns: u64,
    /// Earliest Unix time of loop time 0 that arrivals since the last look had, ns, and how many there were.
    earliest: (u64, u32),
    periods: Periods,
    last: Option<Situation>,
    next_numbers_ns: u64,
    next_poses_ns: u64,
    next_touch_ns: u64,
    next_repeat_ns: u64,
    touched: bool,
    /// True once the gripper's records were announced; a robot without one has none.
    gripper: bool,
    /// Largest lateness, s, and stages, ns, since they were last shown.
    worst: (f64, [u32; STAGES.len()]),
    /// The last sample whose numbers were shown, as they were.
    shown: Sample,
}

impl Display {
    /// Shows `robot`, whose loop time 0 was at `start_unix_ns`.
    pub fn new(robot: &RobotDescription, start_unix_ns: u64, periods: Periods) -> Self {
        Self {
            robot: robot.clone(),
            start_unix_ns,
            earliest: (u64::MAX, 0),
            periods,
            last: None,
            next_numbers_ns: 0,
            next_poses_ns: 0,
            next_touch_ns: 0,
            next_repeat_ns: 0,
            touched: false,
            gripper: false,
            worst: Default::default(),
            shown: Sample::default(),
        }
    }

    /// Unix time of loop time 0 as is known now, ns.
    pub const fn start_unix_ns(&self) -> u64 {
        self.start_unix_ns
    }

    /// Follows the wall clock: samples whose newest is of `newest_ns`, loop time, came at `now_unix_ns`. Of some that came
    /// late the time between loop and wall is too long, of none too short.
    pub fn follow_clock(&mut self, now_unix_ns: u64, newest_ns: u64) {
        let (earliest_ns, arrivals) = self.earliest;
        self.earliest = (earliest_ns.min(now_unix_ns.saturating_sub(newest_ns)), arrivals + 1);
        if self.earliest.1 == ARRIVALS_PER_LOOK {
            let (earliest_ns, _) = std::mem::replace(&mut self.earliest, (u64::MAX, 0));
            if earliest_ns.abs_diff(self.start_unix_ns) > DRIFT_NS {
                self.start_unix_ns = earliest_ns;
            }
        }
    }

    /// Says what there will be, and who the robot is.
    pub fn begin(&self, to: &mut impl Sink) -> Result<(), LogError> {
        to.offer_record::<State>()?;
        to.offer_record::<Command>()?;
        to.offer_record::<Cover>()?;
        to.offer_record::<Link>()?;
        to.offer_record::<Target>()?;
        to.offer_record::<Timing>()?;
        to.offer_record::<ModeChange>()?;
        to.offer_record::<FaultChange>()?;
        to.offer_record::<BoardChange>()?;
        to.offer_record::<Contact>()?;
        to.offer::<TFMessage>(TF)?;
        to.offer::<TFMessage>(TF_STATIC)?;
        to.offer::<Markers>(BODIES)?;
        to.offer::<Markers>(TOUCH)?;
        to.offer::<PoseStamped>(FLANGE)?;
        to.offer::<PoseStamped>(FLANGE_DESIRED)?;
        to.offer::<WrenchStamped>(COVER_WRENCH)?;
        to.offer::<JointState>(JOINT_STATES)?;
        to.offer::<Log>(LOG)?;
        to.offer::<Text>(URDF)?;
        if self.robot.urdf.is_empty() {
            return Ok(());
        }
        to.message(URDF, 0, &Text { data: self.robot.urdf.clone() })
    }

    /// Takes one sample; returns it as it is shown if its numbers were due, or shown because something happened. What changed
    /// or happened is said with its tick, and what is `again` to be said even if it did not change.
    pub fn sample(
        &mut self,
        sample: &Sample,
        again: bool,
        to: &mut impl Sink,
    ) -> Result<Option<&Sample>, LogError> {
        let time_ns = sample.time_ns;
        let (lateness_s, stages_ns) = &mut self.worst;
        *lateness_s = worse(*lateness_s, sample.lateness_s);
        stages_ns.iter_mut().zip(sample.stages_ns).for_each(|(worst, now)| *worst = now.max(*worst));
        let changed = self.changes(sample, again, to)?;
        for event in &sample.contact_events {
            to.record(time_ns, &Contact::new(sample.tick, event))?;
            to.message(LOG, time_ns, &sentences::contact(&self.stamp(time_ns), event))?;
        }
        self.scene(sample, to)?;
        let due = is_due(&mut self.next_numbers_ns, time_ns, self.periods.numbers_ns)
            || changed
            || !sample.contact_events.is_empty();
        if due {
            self.numbers(sample, to)?;
        }
        Ok(due.then_some(&self.shown))
    }

    fn stamp(&self, time_ns: u64) -> Time {
        Time::from_unix_ns(self.start_unix_ns.saturating_add(time_ns))
    }

    /// Mode, fault and board; whether one changed.
    fn changes(&mut self, sample: &Sample, again: bool, to: &mut impl Sink) -> Result<bool, LogError> {
        let (tick, time_ns, at) = (sample.tick, sample.time_ns, self.stamp(sample.time_ns));
        let now = (sample.mode, sample.fault, sample.board);
        let last = self.last.replace(now);
        let new_mode = last.is_none_or(|(mode, ..)| mode != sample.mode);
        if again || new_mode {
            to.record(time_ns, &ModeChange { tick, mode: sample.mode })?;
        }
        if new_mode {
            to.message(LOG, time_ns, &sentences::mode(&at, sample.mode))?;
        }
        let new_fault = last.and_then(|(_, fault, _)| fault) != sample.fault;
        if again || new_fault {
            to.record(time_ns, &FaultChange::new(tick, sample.fault)?)?;
        }
        if new_fault {
            to.message(LOG, time_ns, &sentences::fault(&at, &self.robot, sample.fault))?;
        }
        if again || last.is_none_or(|(.., board)| board != sample.board) {
            to.record(time_ns, &BoardChange::new(tick, sample.board)?)?;
        }
        Ok(last != Some(now))
    }

    /// Writes the messages of a three-dimensional view.
    fn scene(&mut self, sample: &Sample, to: &mut impl Sink) -> Result<(), LogError> {
        let (time_ns, at) = (sample.time_ns, self.stamp(sample.time_ns));
        let repeat = is_due(&mut self.next_repeat_ns, time_ns, self.periods.fixed_ns);
        if repeat {
            to.message(TF_STATIC, time_ns, &frames::fixed(&self.robot, &at))?;
            to.message(BODIES, time_ns, &scene::bodies(&self.robot, &at))?;
        }
        // Once more after the release, which takes the arrows away.
        let touched = scene::is_touched(sample);
        let moves = (touched || self.touched) && is_due(&mut self.next_touch_ns, time_ns, TOUCH_PERIOD_NS);
        if repeat || moves {
            self.touched = touched;
            to.message(TOUCH, time_ns, &scene::touch(&self.robot, sample, &at))?;
        }
        if is_due(&mut self.next_poses_ns, time_ns, self.periods.poses_ns) {
            to.message(TF, time_ns, &frames::moving(&self.robot, sample, &at))?;
            to.message(COVER_WRENCH, time_ns, &frames::cover_wrench(sample, &at))?;
            if frames::has_arm(&self.robot) {
                to.message(JOINT_STATES, time_ns, &frames::joints(sample, &at))?;
                to.message(FLANGE, time_ns, &frames::flange(sample, &at))?;
                to.message(FLANGE_DESIRED, time_ns, &frames::flange_desired(sample, &at))?;
            }
        }
        Ok(())
    }

    fn numbers(&mut self, sample: &Sample, to: &mut impl Sink) -> Result<(), LogError> {
        let (lateness_s, stages_ns) = std::mem::take(&mut self.worst);
        self.shown = shown(&Sample { lateness_s, stages_ns, ..sample.clone() });
        let shown = &self.shown;
        let time_ns = shown.time_ns;
        to.record(time_ns, &State::from(shown))?;
        to.record(time_ns, &Command::from(shown))?;
        to.record(time_ns, &Cover::from(shown))?;
        if let Some(link) = &shown.link {
            to.record(time_ns, &Link::new(shown.tick, link))?;
        }
        if let Some(target) = &shown.target {
            to.record(time_ns, &Target::new(shown.tick, target))?;
        }
        if let Some(gripper) = &shown.gripper {
            if !std::mem::replace(&mut self.gripper, true) {
                to.offer_record::<Gripper>()?;
            }
            to.record(time_ns, &Gripper::new(shown.tick, gripper))?;
        }
        to.record(time_ns, &Timing::from(shown))
    }
}

/// Returns true if a message is due that comes once in `period_ns`, at whole multiples of it.
fn is_due(next_ns: &mut u64, time_ns: u64, period_ns: u64) -> bool {
    let due = time_ns >= *next_ns;
    if due {
        *next_ns = time_ns - time_ns.checked_rem(period_ns).unwrap_or(0) + period_ns;
    }
    due
}

/// The larger of two; what is no number stays one.
fn worse(a: f64, b: f64) -> f64 {
    if a.is_nan() || b.is_nan() { f64::NAN } else { a.max(b) }
}
