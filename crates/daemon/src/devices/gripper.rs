//! A gripper of any make behind the loop: [`Gripper`] is its driver, [`GripperThread`] drives it from a thread of its own, and
//! [`WithGripper`] puts it on a robot. The loop never waits for it.

use crate::control::flange_sensor::FlangeSensor;
use crate::control::plant::{Datagram, Plant, PlantClock, Simulated, SourceAge};
use crate::robot::JOINTS;
use moca_msgs::gripper::GripperTable;
use moca_msgs::{
    Actuation, ArmLink, Fault, GripperFault, GripperPhase, GripperRefusal, GripperRequest, GripperState,
    Outcome, RobotState,
};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

/// Time between two looks at a gripper.
const LOOK_EVERY: Duration = Duration::from_millis(10);
/// Requests on their way; a gripper that has taken so many no more is silent.
const REQUESTS: usize = 16;
/// States on their way; the loop takes all of them in every tick.
const STATES: usize = 64;
/// Longest wait for a driver to return when its thread is dropped.
const DROP_WAIT: Duration = Duration::from_millis(1500);

/// Driver of a gripper with two parallel fingers. Its functions may take their time: they run on a thread of their own.
pub trait Gripper: Send + 'static {
    /// Returns the ranges of its requests.
    fn table(&self) -> GripperTable;

    /// Begins a request, which is within the ranges. It ends the one before. Nothing but a request opens the fingers.
    fn begin(&mut self, request: &GripperRequest);

    /// Returns what the gripper reports, or `None` if it does not answer. The count of requests and the object's mass are the thread's.
    fn read(&mut self) -> Option<GripperState>;
}

/// Thread that drives a [`Gripper`], seen from the loop: nothing here waits, locks or allocates.
pub struct GripperThread {
    table: GripperTable,
    requests: rtrb::Producer<GripperRequest>,
    states: rtrb::Consumer<GripperState>,
    /// Requests handed to the thread.
    handed: u32,
    /// Mass that the last grasp told, kg.
    told_kg: f64,
    /// State that came last.
    last: GripperState,
    ended: Arc<AtomicBool>,
    thread: Option<JoinHandle<()>>,
}

impl GripperThread {
    /// Starts the thread. What the gripper holds from before stays held.
    ///
    /// # Errors
    /// The thread could not be started.
    pub fn spawn(mut gripper: impl Gripper) -> std::io::Result<Self> {
        let table = gripper.table();
        let (requests, mut from_loop) = rtrb::RingBuffer::new(REQUESTS);
        let (mut to_loop, states) = rtrb::RingBuffer::new(STATES);
        let ended = Arc::new(AtomicBool::new(false));
        let told = Arc::clone(&ended);
        let silent = GripperState {
            width_max_m: table.width_max_m,
            phase: GripperPhase::Unknown,
            fault: Some(GripperFault::Unplugged),
            object_flange_m: table.tip_flange_m,
            ..GripperState::default()
        };
        let drive = move || {
            let (mut begun, mut last) = (0, silent);
            while !told.load(Ordering::Relaxed) {
                while let Ok(request) = from_loop.pop() {
                    gripper.begin(&request);
                    begun += 1;
                }
                let (phase, fault) = (silent.phase, silent.fault);
                let state = gripper.read().unwrap_or(GripperState { phase, fault, ..last });
                last = GripperState { requests: begun, ..state };
                // A loop that takes none of them hangs: the next one is as good.
                let _ = to_loop.push(last);
                std::thread::sleep(LOOK_EVERY);
            }
        };
        let thread = Some(std::thread::Builder::new().name("gripper".into()).spawn(drive)?);
        Ok(Self { table, requests, states, handed: 0, told_kg: 0.0, last: silent, ended, thread })
    }

    /// Returns the newest state; one that a request is on its way to moves.
    fn state(&mut self) -> GripperState {
        while let Ok(state) = self.states.pop() {
            let object_kg = self.object_kg(&state);
            self.last = GripperState { object_kg, object_flange_m: self.table.tip_flange_m, ..state };
        }
        if self.states.is_abandoned() {
            (self.last.phase, self.last.fault) = (GripperPhase::Unknown, Some(GripperFault::Unplugged));
        }
        let moves = self.last.requests != self.handed && self.last.phase != GripperPhase::Unknown;
        let (phase, fault) =
            if moves { (GripperPhase::Moving, None) } else { (self.last.phase, self.last.fault) };
        GripperState { requests: self.handed, phase, fault, ..self.last }
    }

    /// Mass of the object that is held in `state`, kg. A gripper that is silent, or has not begun the last request yet, holds what it
    /// held.
    const fn object_kg(&self, state: &GripperState) -> f64 {
        match state.phase {
            _ if state.requests != self.handed => self.last.object_kg,
            GripperPhase::Unknown => self.last.object_kg,
            GripperPhase::Holding => self.told_kg,
            GripperPhase::Resting | GripperPhase::Moving => 0.0,
        }
    }

    /// Hands a request to the thread.
    fn request(&mut self, request: &GripperRequest) -> Result<(), GripperRefusal> {
        if self.state().phase == GripperPhase::Unknown {
            return Err(GripperRefusal::Silent);
        }
        request.check(&self.table)?;
        self.requests.push(*request).map_err(|_| GripperRefusal::Silent)?;
        if let GripperRequest::Grasp { mass_kg, .. } = request {
            self.told_kg = *mass_kg;
        }
        self.handed += 1;
        Ok(())
    }
}

impl Drop for GripperThread {
    fn drop(&mut self) {
        self.ended.store(true, Ordering::Relaxed);
        let Some(thread) = self.thread.take() else { return };
        // A driver that waits for a silent gripper is left behind.
        let deadline = Instant::now() + DROP_WAIT;
        while !thread.is_finished() && Instant::now() < deadline {
            std::thread::sleep(Duration::from_millis(5));
        }
        if thread.is_finished() {
            let _ = thread.join();
        }
    }
}

/// A robot with a gripper on its flange, or without one.
pub struct WithGripper<P> {
    robot: P,
    gripper: Option<GripperThread>,
}

impl<P> WithGripper<P> {
    /// Puts the gripper on the robot, if there is one.
    pub const fn new(robot: P, gripper: Option<GripperThread>) -> Self {
        Self { robot, gripper }
    }
}

impl<P: Plant> Plant for WithGripper<P> {
    fn read(&mut self) -> Result<RobotState<JOINTS>, Fault> {
        self.robot.read()
    }

    fn age(&self) -> SourceAge {
        self.robot.age()
    }

    fn link(&self) -> Option<ArmLink> {
        self.robot.link()
    }

    fn recover(&mut self) -> Outcome {
        self.robot.recover()
    }

    fn flange_sensor(&mut self) -> Option<&mut dyn FlangeSensor> {
        self.robot.flange_sensor()
    }

    fn gripper(&mut self) -> Option<GripperState> {
        self.gripper.as_mut().map(GripperThread::state)
    }

    fn request_gripper(&mut self, request: &GripperRequest) -> Outcome {
        Ok(self.gripper.as_mut().ok_or(GripperRefusal::NoGripper)?.request(request)?)
    }

    fn write(&mut self, actuation: &Actuation<JOINTS>, ticks: u64) -> Result<(), Fault> {
        self.robot.write(actuation, ticks)
    }

    fn simulated(&mut self) -> Option<&mut dyn Simulated> {
        self.robot.simulated()
    }

    fn is_exact(&mut self) -> bool {
        self.robot.is_exact()
    }
}

impl<P: PlantClock> PlantClock for WithGripper<P> {
    fn receive(&mut self, timeout: Duration) -> Datagram {
        self.robot.receive(timeout)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::control::flange_sensor::FlangeReading;
    use crate::control::plant::NoRobot;
    use moca_msgs::gripper::FRANKA_HAND;
    use std::sync::Mutex;
    use std::thread::ThreadId;

    /// A hand whose state a test writes; it remembers its requests and the thread that began them.
    #[derive(Clone, Default)]
    struct Scripted {
        reports: Arc<Mutex<Option<GripperState>>>,
        begun: Arc<Mutex<Vec<(GripperRequest, ThreadId)>>>,
        /// Held by a test that lets the driver hang.
        hangs: Arc<Mutex<()>>,
    }

    impl Gripper for Scripted {
        fn table(&self) -> GripperTable {
            FRANKA_HAND
        }

        fn begin(&mut self, request: &GripperRequest) {
            self.begun.lock().unwrap().push((*request, std::thread::current().id()));
        }

        fn read(&mut self) -> Option<GripperState> {
            let _hangs = self.hangs.lock().unwrap();
            *self.reports.lock().unwrap()
        }
    }

    /// An arm with a sensor at its flange.
    struct Feels;

    impl FlangeSensor for Feels {
        fn latest(&mut self) -> Option<FlangeReading> {
            Some(FlangeReading { wrench: [1.0; 6], age_s: 0.0 })
        }
    }

    impl Plant for Feels {
        fn read(&mut self) -> Result<RobotState<JOINTS>, Fault> {
            Err(Fault::StateInvalid)
        }

        fn write(&mut self, _: &Actuation<JOINTS>, _: u64) -> Result<(), Fault> {
            Ok(())
        }

        fn flange_sensor(&mut self) -> Option<&mut dyn FlangeSensor> {
            Some(self)
        }
    }

    #[test]
    fn flange_sensor_of_the_arm_is_felt_with_a_gripper_on_it() {
        let mut robot = WithGripper::new(Feels, None);
        assert!(robot.flange_sensor().is_some_and(|sensor| sensor.latest().is_some()));
        assert!(robot.gripper().is_none());
    }

    fn held() -> GripperState {
        GripperState {
            width_m: 0.05,
            width_max_m: 0.08,
            phase: GripperPhase::Holding,
            ..GripperState::default()
        }
    }

    fn on(hand: &Scripted) -> WithGripper<NoRobot> {
        WithGripper::new(NoRobot::at([0.5; JOINTS]), Some(GripperThread::spawn(hand.clone()).unwrap()))
    }

    fn holding() -> (Scripted, WithGripper<NoRobot>) {
        let hand = Scripted::default();
        *hand.reports.lock().unwrap() = Some(held());
        let mut robot = on(&hand);
        wait(&mut robot, |state| state.is_holding());
        (hand, robot)
    }

    fn wait(robot: &mut WithGripper<NoRobot>, until: impl Fn(&GripperState) -> bool) -> GripperState {
        for _ in 0..10_000 {
            let state = robot.gripper().unwrap();
            if until(&state) {
                return state;
            }
            std::thread::sleep(Duration::from_millis(1));
        }
        panic!("never: {:?}", robot.gripper())
    }

    const RELEASE: GripperRequest = GripperRequest::Release;

    #[test]
    fn told_mass_is_held_as_long_as_the_object() {
        let (hand, mut robot) = holding();
        let report = |phase| *hand.reports.lock().unwrap() = Some(GripperState { phase, ..held() });
        let grasp = GripperRequest::Grasp {
            width_m: 0.05,
            speed_m_s: 0.05,
            force_n: 40.0,
            tolerance_m: 0.005,
            mass_kg: 0.5,
        };
        let mass = |state: &GripperState| (state.object_kg, state.object_flange_m);
        let (tip, none) = (FRANKA_HAND.tip_flange_m, 0.0);
        assert_eq!(mass(&robot.gripper().unwrap()), (none, tip), "held from before: nobody told its mass");
        report(GripperPhase::Moving);
        robot.request_gripper(&grasp).unwrap();
        assert_eq!(mass(&robot.gripper().unwrap()), (none, tip), "the fingers do not hold it yet");
        report(GripperPhase::Holding);
        wait(&mut robot, |state| state.object_kg > 0.0);
        assert_eq!(mass(&robot.gripper().unwrap()), (0.5, tip));
        // A stop that the hand has not begun yet moves, and the object stays held.
        let hangs = hand.hangs.lock().unwrap();
        robot.request_gripper(&GripperRequest::Stop).unwrap();
        let state = robot.gripper().unwrap();
        assert_eq!((state.phase, state.object_kg), (GripperPhase::Moving, 0.5));
        drop(hangs);
        wait(&mut robot, |state| state.is_holding());
        *hand.reports.lock().unwrap() = None;
        let state = wait(&mut robot, |state| state.phase == GripperPhase::Unknown);
        assert_eq!(mass(&state), (0.5, tip), "an unplugged hand does not open");
        report(GripperPhase::Holding);
        let state = wait(&mut robot, |state| state.is_holding());
        assert_eq!(mass(&state), (0.5, tip));
        report(GripperPhase::Resting);
        let state = wait(&mut robot, |state| state.phase == GripperPhase::Resting);
        assert_eq!(mass(&state), (none, tip));
    }

    #[test]
    fn request_is_begun_by_another_thread_and_moves_until_reported() {
        let (hand, mut robot) = holding();
        let hangs = hand.hangs.lock().unwrap();
        assert_eq!(robot.request_gripper(&RELEASE), Ok(()));
        let state = robot.gripper().unwrap();
        assert_eq!((state.phase, state.requests), (GripperPhase::Moving, 1), "nobody has looked at it yet");
        *hand.reports.lock().unwrap() = Some(GripperState { phase: GripperPhase::Resting, ..held() });
        drop(hangs);
        let state = wait(&mut robot, |state| state.phase != GripperPhase::Moving);
        assert_eq!((state.phase, state.requests), (GripperPhase::Resting, 1));
        let begun = hand.begun.lock().unwrap();
        assert!(begun.len() == 1 && begun[0].0 == RELEASE && begun[0].1 != std::thread::current().id());
    }

    #[test]
    fn restarted_daemon_finds_the_object_held() {
        let (hand, robot) = holding();
        drop(robot);
        let mut again = on(&hand);
        let state = wait(&mut again, |state| state.phase != GripperPhase::Unknown);
        assert_eq!(state, GripperState { object_flange_m: FRANKA_HAND.tip_flange_m, ..held() });
        assert!(hand.begun.lock().unwrap().is_empty(), "neither the end nor the start asks for anything");
    }

    #[test]
    fn silent_hand_is_unplugged_and_is_found_again() {
        let (hand, mut robot) = holding();
        *hand.reports.lock().unwrap() = None;
        let state = wait(&mut robot, |state| state.phase == GripperPhase::Unknown);
        assert_eq!(
            (state.fault, state.width_m.to_bits()),
            (Some(GripperFault::Unplugged), 0.05_f64.to_bits())
        );
        assert_eq!(robot.request_gripper(&RELEASE), Err(GripperRefusal::Silent.into()));
        assert!(robot.read().is_ok() && robot.write(&Actuation::Brake, 1).is_ok(), "arm and base go on");
        *hand.reports.lock().unwrap() = Some(held());
        wait(&mut robot, |state| state.is_holding());
        assert_eq!(robot.request_gripper(&RELEASE), Ok(()));
    }

    #[test]
    fn bad_request_never_reaches_the_driver() {
        let (hand, mut robot) = holding();
        let wide = GripperRequest::Move { width_m: f64::NAN, speed_m_s: 0.05 };
        assert!(robot.request_gripper(&wide).is_err());
        assert_eq!(robot.request_gripper(&RELEASE), Ok(()));
        wait(&mut robot, |state| state.is_holding());
        assert_eq!(hand.begun.lock().unwrap().len(), 1);
    }

    #[test]
    fn hanging_driver_holds_nobody_up_and_its_queue_is_bounded() {
        let (hand, mut robot) = holding();
        let hangs = hand.hangs.lock().unwrap();
        let taken = (0..100_000).take_while(|_| robot.request_gripper(&RELEASE).is_ok()).count();
        // The thread may have taken some that came before it hung.
        assert!((REQUESTS..100_000).contains(&taken), "{taken}");
        assert_eq!(robot.gripper().unwrap().phase, GripperPhase::Moving);
        drop(hangs);
        wait(&mut robot, |state| state.is_holding());
        assert_eq!(hand.begun.lock().unwrap().len(), taken);
    }

    #[test]
    fn driver_that_ends_is_a_gripper_that_does_not_answer() {
        let (hand, mut robot) = holding();
        let poisoned = std::thread::spawn({
            let reports = Arc::clone(&hand.reports);
            move || {
                let _reports = reports.lock().unwrap();
                panic!("so that the driver panics too")
            }
        });
        assert!(poisoned.join().is_err());
        let state = wait(&mut robot, |state| state.phase == GripperPhase::Unknown);
        assert_eq!(state.fault, Some(GripperFault::Unplugged));
    }
}
