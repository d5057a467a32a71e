//! Random hands, requests and board faults, and an operator who brings a stopped robot back.

use moca_control::config::Config;
use moca_experiments::TAXELS;
use moca_lockstep::inject::Random;
use moca_lockstep::touch_board::ByteCover;
use moca_lockstep::{LockStep, MemoryBoards};
use moca_msgs::params::CONTROLLER;
use moca_msgs::target::{Target, TimedTarget, TwistAxes};
use moca_msgs::{Law, Mode, ParameterValues, Request, Sample};
use moca_sim::board::BoardFailure;
use serde::Serialize;

/// Requests of one burst, one a tick: more than any queue on their way holds.
pub(super) const BURST: u32 = 150;
/// Largest force of an ordinary press, of a heavy one and of a blow, N.
pub(super) const FORCES_N: [u32; 3] = [80, 200, 200];
/// Length of a blow, ticks.
pub(super) const BLOW_TICKS: u64 = 50;
/// Ticks for which a target is renewed, and ticks between two of them.
const TARGET_TICKS: u64 = 1500;
const TARGET_EVERY: u64 = 50;
/// Largest linear and angular speed of a target, m/s and rad/s.
const TARGET_SPEED: f64 = 0.1;
/// Least and largest factor of a live change to a parameter's default.
const LIVE_FACTORS: [f64; 2] = [0.7, 1.4];
/// An operator waits so long between two tries, ticks.
const PATIENCE_TICKS: u64 = 1500;

/// Everything that was done.
#[derive(Debug, Default, Serialize)]
pub(super) struct Deeds {
    pub(super) presses: u64,
    pub(super) heavy_presses: u64,
    pub(super) blows: u64,
    pub(super) bursts: u64,
    pub(super) board_faults: u64,
    pub(super) targets: u64,
    pub(super) live_changes: u64,
}

/// The hands, the operator and the things that break.
pub(super) struct Hands {
    pub(super) random: Random,
    pub(super) deeds: Deeds,
    next_event: u64,
    pressed: [Option<u64>; TAXELS],
    heal_at: Option<u64>,
    unplugged: bool,
    stopped_since: Option<u64>,
    asked_at: u64,
    burst: u32,
    pub(super) onlookers_change: bool,
    /// Parameters that may be changed live, with their defaults; empty where nobody changes any.
    live: Vec<(u8, Vec<f64>)>,
    target: Option<(u64, Target)>,
    leads: bool,
    /// Only the operator acts: hands let go, nothing breaks.
    calm: bool,
}

impl Hands {
    pub(super) fn new(seed: u64) -> Self {
        let random = Random::new(seed);
        Self {
            random,
            deeds: Deeds::default(),
            next_event: 3000,
            pressed: [None; TAXELS],
            heal_at: None,
            unplugged: false,
            stopped_since: None,
            asked_at: 0,
            burst: 0,
            onlookers_change: false,
            live: Vec::new(),
            target: None,
            leads: false,
            calm: false,
        }
    }

    /// Another program leads the robot too, and parameters change while it runs.
    pub(super) fn with_programs(mut self, config: &Config) -> Self {
        let table = config.to_toml();
        let gains =
            (0u8..).zip(CONTROLLER).filter(|(_, row)| row.live && row.name.starts_with("control.gains."));
        self.live = gains.filter_map(|(i, row)| Some((i, defaults(&table, row.name)?))).collect();
        self.leads = true;
        self
    }

    /// Another robot, from its power-up.
    pub(super) fn begin_again(&mut self) {
        let fresh = Self::new(0);
        self.next_event = fresh.next_event;
        (self.pressed, self.heal_at, self.unplugged) = (fresh.pressed, None, false);
        (self.stopped_since, self.asked_at, self.burst, self.target) = (None, 0, 0, None);
    }

    /// Lets go of everything, heals everything, and leaves only the operator.
    pub(super) fn calm_down(&mut self, tick: u64) {
        self.calm = true;
        self.target = None;
        self.burst = 0;
        self.heal_at = self.heal_at.map(|_| tick);
        for until in self.pressed.iter_mut().flatten() {
            *until = tick;
        }
    }

    /// The opposite of [`Self::calm_down`].
    pub(super) fn wake_up(&mut self, tick: u64) {
        self.calm = false;
        self.next_event = tick;
    }

    /// Returns true if nobody touches the robot.
    pub(super) fn touches_nothing(&self) -> bool {
        self.pressed.iter().all(Option::is_none)
    }

    fn after(&mut self, tick: u64, least: u64, most: u64) -> u64 {
        tick + least + self.random.bits() % (most - least)
    }

    /// Returns the request of this tick; `last` is the sample of the one before.
    pub(super) fn act(
        &mut self,
        tick: u64,
        world: &mut LockStep<ByteCover, MemoryBoards>,
        last: Option<&Sample>,
    ) -> Option<Request> {
        if self.heal_at.is_some_and(|at| tick >= at) {
            self.heal_at = None;
            world.feed[0].board().set_fault(None);
            if std::mem::take(&mut self.unplugged) {
                world.feed[0].replug();
            }
        }
        if let Some(taxel) = self.pressed.iter().position(|until| until.is_some_and(|until| tick >= until)) {
            self.pressed[taxel] = None;
            return Some(press(taxel, 0.0));
        }
        if let Some(left) = self.burst.checked_sub(1) {
            self.burst = left;
            return Some(self.hasty());
        }
        if tick >= self.next_event && !self.calm {
            self.next_event = self.after(tick, 200, 6000);
            return self.event(tick, world);
        }
        if let Some((until, target)) = self.target {
            self.target = self.target.filter(|_| tick < until);
            if tick.is_multiple_of(TARGET_EVERY) {
                return Some(Request::Target(TimedTarget::new(target)));
            }
        }
        self.recover(tick, last)
    }

    fn event(&mut self, tick: u64, world: &mut LockStep<ByteCover, MemoryBoards>) -> Option<Request> {
        match self.random.below(if self.leads { 32 } else { 24 }) {
            0 => Some(Request::Stop),
            1 => Some(Request::Disarm),
            2 => Some(Request::Tare),
            3 => Some(Request::SelectLaw(Law::FollowMe)),
            4 | 5 => Some(Request::SelectLaw(Law::Impedance)),
            6 if self.heal_at.is_none() => {
                let faults = [BoardFailure::I2cLost, BoardFailure::ChipReset, BoardFailure::Silent];
                world.feed[0].board().set_fault(Some(faults[self.random.below(faults.len())]));
                self.heal_at = Some(self.after(tick, 100, 3000));
                self.deeds.board_faults += 1;
                None
            }
            7 if self.heal_at.is_none() => {
                world.feed[0].unplug();
                self.unplugged = true;
                self.heal_at = Some(self.after(tick, 500, 3000));
                self.deeds.board_faults += 1;
                None
            }
            8 => {
                let mut garbage = [0; 64];
                garbage.fill_with(|| self.random.byte());
                world.feed[0].inject(&garbage);
                None
            }
            9 => {
                self.burst = BURST;
                self.deeds.bursts += 1;
                None
            }
            10 | 11 => {
                self.onlookers_change = true;
                None
            }
            24..29 => self.lead(tick),
            29 if self.random.one_in(2) => Some(Request::Recentre),
            29 => Some(Request::EndTarget),
            30.. => self.change_live(),
            kind => {
                let kind = if kind < 22 { 0 } else { kind - 21 };
                Some(self.press(kind, tick))
            }
        }
    }

    /// An ordinary press (0), a heavy one (1), or a blow (2).
    fn press(&mut self, kind: usize, tick: u64) -> Request {
        let taxel = self.random.below(TAXELS);
        let tenths = self.random.below(usize::try_from(10 * FORCES_N[kind]).unwrap_or(0));
        let force_n = f64::from(u32::try_from(tenths).unwrap_or(0)) / 10.0;
        self.pressed[taxel] = Some(if kind == 2 { tick + BLOW_TICKS } else { self.after(tick, 100, 4000) });
        let deeds = &mut self.deeds;
        *[&mut deeds.presses, &mut deeds.heavy_presses, &mut deeds.blows][kind] += 1;
        press(taxel, force_n)
    }

    /// Another program leads the flange, or the base, for a while.
    fn lead(&mut self, tick: u64) -> Option<Request> {
        let mut speed =
            || (f64::from(u32::try_from(self.random.below(2001)).unwrap_or(0)) / 1000.0 - 1.0) * TARGET_SPEED;
        let twist: [f64; 6] = std::array::from_fn(|_| speed());
        let target = if self.random.one_in(3) {
            Target::BaseVelocity { velocity_body: [twist[0], twist[1], twist[5]] }
        } else {
            Target::Twist { axes: TwistAxes::World, twist }
        };
        self.target = Some((tick + TARGET_TICKS, target));
        self.deeds.targets += 1;
        Some(Request::Target(TimedTarget::new(target)))
    }

    /// Somebody turns a knob while the robot moves.
    fn change_live(&mut self) -> Option<Request> {
        let row = self.random.below(self.live.len());
        let [least, most] = LIVE_FACTORS;
        let share = f64::from(u32::try_from(self.random.below(1001)).unwrap_or(0)) / 1000.0;
        let (parameter, values) = self.live.get(row)?;
        let changed: Vec<f64> = values.iter().map(|value| value * (least + share * (most - least))).collect();
        self.deeds.live_changes += 1;
        Some(Request::SetParameter { parameter: *parameter, values: ParameterValues::new(&changed)? })
    }

    /// Returns the request of a script that has gone wild.
    pub(super) fn hasty(&mut self) -> Request {
        match self.random.below(8) {
            0 => Request::Stop,
            1 => Request::Tare,
            2 => Request::Arm,
            3 => Request::Disarm,
            4 => Request::Resume,
            5 => Request::SelectLaw(Law::FollowMe),
            6 => Request::OperatorLost,
            _ => Request::SelectLaw(Law::Impedance),
        }
    }

    /// An operator who brings a stopped robot back once nobody touches it.
    fn recover(&mut self, tick: u64, last: Option<&Sample>) -> Option<Request> {
        let last = last?;
        if last.mode.moves() || matches!(last.mode, Mode::Starting | Mode::Taring) {
            self.stopped_since = None;
            return None;
        }
        let since = *self.stopped_since.get_or_insert(tick);
        let calm = self.touches_nothing() && self.heal_at.is_none();
        if !calm || tick - since < PATIENCE_TICKS || tick - self.asked_at < PATIENCE_TICKS {
            return None;
        }
        self.asked_at = tick;
        match last.mode {
            Mode::Ready => Some(Request::Arm),
            // Every other try is a tare: a zero may have been lost.
            Mode::ProtectiveStop if self.random.one_in(2) => Some(Request::Tare),
            Mode::ProtectiveStop => Some(Request::Resume),
            _ => None,
        }
    }
}

/// A press with the hand that stays until another one.
pub(super) fn press(taxel: usize, force_n: f64) -> Request {
    Request::PressTaxel { taxel: u8::try_from(taxel).unwrap_or(u8::MAX), force_n }
}

/// The numbers of a setting.
fn defaults(table: &toml::Table, name: &str) -> Option<Vec<f64>> {
    let (section, key) = name.rsplit_once('.')?;
    let section = section.split('.').try_fold(table, |table, key| table.get(key)?.as_table())?;
    match section.get(key)? {
        toml::Value::Float(one) => Some(vec![*one]),
        toml::Value::Array(list) => list.iter().map(toml::Value::as_float).collect(),
        _ => None,
    }
}
