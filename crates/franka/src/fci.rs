//! The thread that owns the connection, and the loop's end of it.

use crate::count::Count;
use crate::limiter::TorqueLimiter;
use crate::mode::{Asked, Next, Phase, Said};
use crate::wrench::at_flange;
use crate::{JOINTS, Model, REPEATS_MAX};
use franka::robot::ActiveTorqueControl;
use franka::{Errors, FrankaError, RealtimeConfig, Robot, RobotMode, Torques};
use moca_msgs::{ArmLink, ArmMode, arm_errors};
use std::sync::atomic::{AtomicBool, AtomicU8, AtomicU16, AtomicU64, Ordering};
use std::sync::{Arc, OnceLock};
use std::thread::{JoinHandle, Thread};
use std::time::{Duration, Instant};
use triple_buffer::{Input, Output, triple_buffer};

/// Time between two attempts to reach the arm at first; it doubles up to the second.
const PAUSE: (Duration, Duration) = (Duration::from_millis(200), Duration::from_secs(2));

/// Longest wait for the arm's thread to end when the arm is dropped: longer than the client waits for the next state.
const DROP_WAIT: Duration = Duration::from_millis(1500);

/// Address and settings of an arm.
#[derive(Clone, Debug)]
pub struct Settings {
    /// Address of its controller, with a port if it is not FCI's own.
    pub host: String,
    /// Which arm the laws were given; another one is refused. `None` of an arm with a description of its own.
    pub model: Option<Model>,
    /// SCHED_FIFO priority of the thread, 1 at least: the client raises itself wherever it may.
    pub priority: u8,
    /// Joint torques, N·m, and forces and moments at the hand, N and N·m, above which the arm has a reflex.
    pub collision: ([f64; JOINTS], [f64; 6]),
    /// Longest wait for an order before the last one is repeated.
    pub answer_within: Duration,
    /// Mass that the controllers believe the arm carries, kg.
    pub carries_kg: f64,
}

/// Difference to what the arm was told in Desk from which on it is said, kg.
pub const CARRIES_APART_KG: f64 = 0.05;

/// One state of the arm, as much of it as a loop uses.
#[derive(Clone, Copy, Debug)]
pub struct ArmState {
    /// The arm's own count of milliseconds.
    pub count: u64,
    /// Joint angles, rad.
    pub q_rad: [f64; JOINTS],
    /// Joint rates, rad/s.
    pub dq_rad_s: [f64; JOINTS],
    /// Joint torques that it measures, N·m; with gravity, if [`Self::feels_gravity`].
    pub torque_nm: [f64; JOINTS],
    /// True if the measured torques include gravity, as those of every real arm do; a simulated arm measures without it.
    pub feels_gravity: bool,
    /// External wrench that the arm estimates, about the flange's origin, in the axes of its base: N, N·m.
    /// The estimate takes the base for standing.
    pub wrench_base: [f64; 6],
    /// Mode that the arm's state reports.
    pub said: Said,
    /// Mass of tool and load as entered in Desk, kg.
    pub carries_kg: f64,
    /// Share of the last commands that reached it in time.
    pub success_rate: f64,
    /// When it came.
    pub received: Instant,
}

/// Order of the loop, and the state for which it was computed.
#[derive(Clone, Copy, Debug)]
struct Order {
    answers: u64,
    /// `None`: the arm's own controller.
    torque_nm: Option<[f64; JOINTS]>,
}

#[derive(Default)]
struct Shared {
    mode: AtomicU8,
    /// Version of FCI; 0 before the arm has answered.
    version: AtomicU16,
    errors: AtomicU64,
    lost: AtomicU64,
    repeated: AtomicU64,
    recover: AtomicBool,
    ended: AtomicBool,
    /// The loop's thread, from its first wait on.
    waits: OnceLock<Thread>,
}

impl Shared {
    fn mode(&self) -> ArmMode {
        ArmMode::ALL.get(usize::from(self.mode.load(Ordering::Acquire))).copied().unwrap_or_default()
    }
}

/// The loop's end of an arm. Nothing here waits but [`Fci::receive`].
pub struct Fci {
    states: Output<Option<ArmState>>,
    orders: Input<Order>,
    shared: Arc<Shared>,
    thread: Option<JoinHandle<()>>,
    silent_since: Instant,
}

impl Fci {
    /// Starts the thread, which reaches the arm again and again. `say` hears in words what happens to the connection; it is
    /// not called while torque control runs.
    ///
    /// # Errors
    /// The thread could not be started.
    pub fn spawn(settings: Settings, say: impl FnMut(&str) + Send + 'static) -> std::io::Result<Self> {
        let (to_loop, states) = triple_buffer(&None);
        let (orders, from_loop) = triple_buffer(&Order { answers: 0, torque_nm: None });
        let shared = Arc::new(Shared::default());
        let mut worker = Worker {
            settings,
            states: to_loop,
            orders: from_loop,
            shared: Arc::clone(&shared),
            phase: Phase::default(),
            count: Count::default(),
            say: Box::new(say),
            said_last: String::new(),
        };
        let thread = std::thread::Builder::new().name("fci".into()).spawn(move || worker.run())?;
        Ok(Self { states, orders, shared, thread: Some(thread), silent_since: Instant::now() })
    }

    /// Waits for the next state, at most `timeout`, and gives its count; the newest counts.
    pub fn receive(&mut self, timeout: Duration) -> Option<u64> {
        self.shared.waits.get_or_init(std::thread::current);
        let deadline = Instant::now() + timeout;
        loop {
            if self.states.update()
                && let Some(state) = self.states.output_buffer()
            {
                self.silent_since = state.received;
                return Some(state.count);
            }
            let left = deadline.saturating_duration_since(Instant::now());
            if left.is_zero() {
                return None;
            }
            std::thread::park_timeout(left);
        }
    }

    /// The state that [`Self::receive`] last gave.
    pub fn state(&self) -> Option<&ArmState> {
        self.states.output_buffer().as_ref()
    }

    /// Its age, s.
    pub fn age_s(&self) -> f64 {
        self.silent_since.elapsed().as_secs_f64()
    }

    /// The version of FCI that the arm spoke when it last answered.
    pub fn version(&self) -> Option<u16> {
        Some(self.shared.version.load(Ordering::Relaxed)).filter(|version| *version > 0)
    }

    /// Returns the state of the arm and of the connection to it.
    pub fn link(&self) -> ArmLink {
        let shared = &self.shared;
        ArmLink {
            mode: shared.mode(),
            success_rate: self.state().map_or(0.0, |state| state.success_rate),
            lost: shared.lost.load(Ordering::Relaxed),
            repeated: shared.repeated.load(Ordering::Relaxed),
            errors: shared.errors.load(Ordering::Relaxed),
        }
    }

    /// Answers the newest state with torques **without** gravity, N·m; torque control starts if it does not run.
    pub fn drive(&mut self, torque_nm: &[f64; JOINTS]) {
        self.order(Some(*torque_nm));
    }

    /// Leaves the arm to its own controller.
    pub fn brake(&mut self) {
        self.order(None);
    }

    /// Asks for a recovery from a reflex; it begins with the arm's next state.
    pub fn recover(&mut self) {
        self.shared.recover.store(true, Ordering::Release);
    }

    fn order(&mut self, torque_nm: Option<[f64; JOINTS]>) {
        let answers = self.state().map_or(0, |state| state.count);
        self.orders.write(Order { answers, torque_nm });
        if let Some(thread) = &self.thread {
            thread.thread().unpark();
        }
    }
}

impl Drop for Fci {
    fn drop(&mut self) {
        self.shared.ended.store(true, Ordering::Release);
        if let Some(thread) = self.thread.take() {
            thread.thread().unpark();
            // It may be waiting for an arm that is silent, and a command's answer has no time-out: then it is left behind.
            let deadline = Instant::now() + DROP_WAIT;
            while !thread.is_finished() && Instant::now() < deadline {
                std::thread::sleep(Duration::from_millis(5));
            }
            if thread.is_finished() {
                let _ = thread.join();
            }
        }
    }
}

/// Why there is no connection.
struct Unreached {
    /// It answers, and is not to be driven.
    refused: bool,
    why: String,
}

impl Unreached {
    fn by(host: &str, error: &FrankaError) -> Self {
        let refused = matches!(error, FrankaError::IncompatibleVersion { .. });
        Self { refused, why: explained(host, error) }
    }
}

/// Regular end of torque control.
enum Ended {
    /// It let go, or is over.
    ByTheLoop,
    /// The arm does something else.
    ByTheArm,
    /// The loop hangs.
    Unanswered,
}

struct Worker {
    settings: Settings,
    states: Input<Option<ArmState>>,
    orders: Output<Order>,
    shared: Arc<Shared>,
    phase: Phase,
    count: Count,
    say: Box<dyn FnMut(&str) + Send>,
    said_last: String,
}

impl Worker {
    fn run(&mut self) {
        let mut pause = PAUSE.0;
        while !self.over() {
            match self.connect() {
                Ok(robot) => {
                    pause = PAUSE.0;
                    let version = robot.server_version();
                    let (torque_nm, wrench) = self.settings.collision;
                    self.tell(&format!(
                        "the arm at {} answers (FCI {version}); it has a reflex above {torque_nm:?} N·m in a joint, {wrench:?} N \
                         and N·m at its hand",
                        self.settings.host
                    ));
                    let error = self.session(&robot);
                    self.phase.lost();
                    self.tell(&error.to_string());
                }
                Err(unreached) => {
                    self.phase.lost();
                    if unreached.refused {
                        self.phase.refused();
                    }
                    self.tell(&unreached.why);
                }
            }
            self.count.interrupt();
            self.show();
            if !self.over() {
                std::thread::park_timeout(pause);
            }
            pause = (2 * pause).min(PAUSE.1);
        }
    }

    fn connect(&self) -> Result<Robot, Unreached> {
        let Settings { host, model, .. } = &self.settings;
        let unreached = |error: FrankaError| Unreached::by(host, &error);
        // This raises the thread as far as it may; `Enforce` would refuse kernels that do well.
        let robot = Robot::new_with_log_size(host, RealtimeConfig::Ignore, 0).map_err(unreached)?;
        self.shared.version.store(robot.server_version(), Ordering::Relaxed);
        if let Some(why) = model.and_then(|model| another(host, robot.server_version(), model)) {
            return Err(Unreached { refused: true, why });
        }
        // Without the right to it the thread stays as it is, and the daemon's own steps have said so.
        let _ = franka::realtime::set_current_thread_scheduler_priority(self.settings.priority.max(1).into());
        let (torque_nm, wrench) = self.settings.collision;
        robot.set_collision_behavior_simple(torque_nm, torque_nm, wrench, wrench).map_err(unreached)?;
        Ok(robot)
    }

    /// Reads and obeys until the connection ends.
    fn session(&mut self, robot: &Robot) -> FrankaError {
        let mut first = true;
        loop {
            if self.over() {
                return FrankaError::Network("the loop has ended".into());
            }
            let state = match robot.read_once() {
                Ok(state) => state,
                Err(error) => return error,
            };
            if std::mem::take(&mut first)
                && (state.m_total - self.settings.carries_kg).abs() > CARRIES_APART_KG
            {
                self.tell(&self.other_load(&state));
            }
            let before = self.phase.mode();
            let asked = self.asked();
            let next = self.phase.state(said(state.robot_mode), bits(&state.current_errors), asked);
            self.publish(&state);
            if self.phase.mode() != before {
                self.tell(&described(self.phase.mode(), bits(&state.current_errors)));
            }
            let done = match next {
                Next::Start => self.torque(robot),
                Next::Recover => self.recover(robot),
                Next::Read | Next::Answer | Next::End => Ok(()),
            };
            if let Err(error) = done {
                return error;
            }
        }
    }

    fn other_load(&self, state: &franka::RobotState) -> String {
        let ([x, y, z], ours) = (state.F_x_Ctotal, self.settings.carries_kg);
        format!(
            "the arm carries {:.2} kg at ({x:.3}, {y:.3}, {z:.3}) m of its flange, as Desk says, the configuration {ours:.2} \
             kg: write robot.tool and robot.load as in Desk, or the laws take the difference for a push",
            state.m_total
        )
    }

    fn recover(&mut self, robot: &Robot) -> Result<(), FrankaError> {
        self.shared.recover.store(false, Ordering::Release);
        let recovered = robot.automatic_error_recovery();
        // Who asked again meanwhile asked for this one.
        self.shared.recover.store(false, Ordering::Release);
        self.count.interrupt();
        match recovered {
            Ok(()) => self.tell("the arm has recovered"),
            Err(error @ FrankaError::Network(_)) => return Err(error),
            Err(error) => self.tell(&format!("the arm does not recover: {error}")),
        }
        Ok(())
    }

    /// Torque control, until the loop lets go, the arm stops itself or the connection ends.
    fn torque(&mut self, robot: &Robot) -> Result<(), FrankaError> {
        let mut control = match robot.start_torque_control() {
            Ok(control) => control,
            Err(error @ FrankaError::Network(_)) => return Err(error),
            Err(error) => {
                self.phase.refused();
                self.show();
                self.tell(&format!("the arm refuses torque control: {error}"));
                return Ok(());
            }
        };
        self.phase.started();
        self.count.interrupt();
        let ended = self.follow(&mut control);
        // The arm's own controller takes over: torques that fade out would let the arm sink.
        drop(control);
        self.count.interrupt();
        match ended {
            Ok(Ended::ByTheLoop) => self.phase.ended(),
            Ok(Ended::ByTheArm) => {
                self.phase.cut_off();
                self.show();
            }
            Ok(Ended::Unanswered) => {
                self.phase.cut_off();
                self.show();
                self.tell(&format!(
                    "the loop did not answer {REPEATS_MAX} states of the arm: it is on its own controller until the loop lets go of it"
                ));
            }
            Err(FrankaError::Control(why)) => {
                self.phase.aborted();
                let errors = bits(&why.last_motion_errors);
                self.shared.errors.store(errors, Ordering::Relaxed);
                self.show();
                self.tell(&described(ArmMode::Reflex, errors));
            }
            Err(error) => return Err(error),
        }
        Ok(())
    }

    /// Answers state after state. No allocation, no lock.
    fn follow(&mut self, control: &mut ActiveTorqueControl<'_>) -> Result<Ended, FrankaError> {
        let (mut limiter, mut last, mut repeats) = (TorqueLimiter::new(), None, 0);
        loop {
            let (state, _) = control.read_once()?;
            let errors = bits(&state.current_errors);
            let asked = self.asked();
            let next = self.phase.state(said(state.robot_mode), errors, asked);
            self.publish(&state);
            if asked != Asked::Drive || self.over() {
                return Ok(Ended::ByTheLoop);
            }
            if next != Next::Answer {
                return Ok(Ended::ByTheArm);
            }
            let wanted = match self.answer(state.time.as_millis()) {
                Some(Order { torque_nm: None, .. }) => return Ok(Ended::ByTheLoop),
                Some(Order { torque_nm: Some(torque_nm), .. }) => {
                    repeats = 0;
                    torque_nm
                }
                None if repeats == REPEATS_MAX => return Ok(Ended::Unanswered),
                None => {
                    repeats += 1;
                    self.shared.repeated.fetch_add(1, Ordering::Relaxed);
                    last.unwrap_or(state.tau_J_d)
                }
            };
            let sent = limiter.limit(&wanted, &state.tau_J_d);
            last = Some(sent);
            control.write_once(&Torques::new(sent))?;
        }
    }

    /// The loop's order for the state with this count, if it comes in time.
    fn answer(&mut self, count: u64) -> Option<Order> {
        let deadline = Instant::now() + self.settings.answer_within;
        loop {
            let order = *self.orders.read();
            // An arm that began anew counts from zero: an order for an earlier one answers nothing.
            if order.answers == count || order.torque_nm.is_none() {
                return Some(order);
            }
            let left = deadline.saturating_duration_since(Instant::now());
            if left.is_zero() || self.over() {
                return None;
            }
            std::thread::park_timeout(left);
        }
    }

    fn asked(&mut self) -> Asked {
        match self.orders.read().torque_nm {
            Some(_) => Asked::Drive,
            None if self.shared.recover.load(Ordering::Acquire) => Asked::Recover,
            None => Asked::Brake,
        }
    }

    fn publish(&mut self, state: &franka::RobotState) {
        let count = state.time.as_millis();
        self.count.take(count);
        self.shared.lost.store(self.count.lost(), Ordering::Relaxed);
        self.shared.errors.store(bits(&state.current_errors), Ordering::Relaxed);
        if self.phase.mode() != ArmMode::Reflex {
            // Recovered by somebody else, or never one: the next one is not to be recovered by an old wish.
            self.shared.recover.store(false, Ordering::Release);
        }
        // Before the state: whoever sees that knows what the arm does.
        self.store_mode();
        let down = state.O_ddP_O.iter().map(|part| part * part).sum::<f64>();
        self.states.write(Some(ArmState {
            count,
            q_rad: state.q,
            dq_rad_s: state.dq,
            torque_nm: state.tau_J,
            feels_gravity: down > 1.0,
            wrench_base: at_flange(&state.O_F_ext_hat_K, &state.O_T_EE, &state.F_T_EE, &state.EE_T_K),
            said: said(state.robot_mode),
            carries_kg: state.m_total,
            success_rate: state.control_command_success_rate,
            received: Instant::now(),
        }));
        self.wake();
    }

    /// Shows the mode to the loop and wakes it.
    fn show(&self) {
        self.store_mode();
        self.wake();
    }

    fn store_mode(&self) {
        let mode = ArmMode::ALL.iter().position(|mode| *mode == self.phase.mode());
        self.shared.mode.store(mode.and_then(|mode| u8::try_from(mode).ok()).unwrap_or(0), Ordering::Release);
    }

    fn wake(&self) {
        if let Some(waits) = self.shared.waits.get() {
            waits.unpark();
        }
    }

    /// Each attempt to reach an arm that is not there ends alike: that is said once.
    fn tell(&mut self, text: &str) {
        if self.said_last != text {
            (self.say)(text);
            text.clone_into(&mut self.said_last);
        }
    }

    fn over(&self) -> bool {
        self.shared.ended.load(Ordering::Acquire)
    }
}

const fn said(mode: RobotMode) -> Said {
    match mode {
        RobotMode::Other => Said::Other,
        RobotMode::Idle => Said::Idle,
        RobotMode::Move => Said::Moves,
        RobotMode::Guiding => Said::Guided,
        RobotMode::Reflex => Said::Reflex,
        RobotMode::UserStopped => Said::UserStopped,
        RobotMode::AutomaticErrorRecovery => Said::Recovers,
    }
}

fn bits(errors: &Errors) -> u64 {
    errors.0.iter().enumerate().fold(0, |all, (bit, set)| all | (u64::from(*set) << bit))
}

/// A mode and its errors in words.
fn described(mode: ArmMode, errors: u64) -> String {
    let mut text = format!("the arm: {}", mode.name());
    for error in arm_errors::set_in(errors) {
        text += &format!(". {} ({}) {}", error.text, error.name, error.remedy);
    }
    text
}

/// Returns an error text if the arm is not the model that the laws were given.
fn another(host: &str, version: u16, wanted: Model) -> Option<String> {
    let found = Model::of_version(version).filter(|found| *found != wanted)?;
    Some(format!(
        "the arm at {host} is a {} (FCI {version}), the configuration's a {} (FCI {}), whose masses and limits are others: write \
         robot.arm = \"{}\", or the other arm's address in plant.arm.host",
        found.name(),
        wanted.name(),
        wanted.version(),
        found.key()
    ))
}

/// Why the arm could not be reached, and what to do.
pub(crate) fn explained(host: &str, error: &FrankaError) -> String {
    match error {
        FrankaError::IncompatibleVersion { server_version, .. } => format!(
            "the arm at {host} speaks FCI {server_version}; this program speaks 10 (a Franka Research 3 with robot system 5.9.0 or \
             newer, as libfranka 0.18 and later) and 5 (a Panda with robot system 4.2.1 or newer, as libfranka 0.9): install one \
             of these in Desk"
        ),
        error => format!("the arm at {host} cannot be reached: {error}"),
    }
}
