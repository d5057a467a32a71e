//! A simulated robot resumes by itself after this PC was too busy to read its virtual board. Nobody stands beside it whom it
//! could surprise; a real robot, or a real board, waits for its operator.

use crate::config::Config;
use crate::robot::PlantKind;
use moca_msgs::{BoardFault, Fault, Mode, Request, Sample};

/// Ticks between two requests of its own.
const EVERY_TICKS: u64 = 100;

/// Asks for what ends a stop for [`BoardFault::HostStarved`]: a tare if one is owed, a resume, and arming if the robot was armed.
#[derive(Clone, Copy, Debug, Default)]
pub struct Recovery {
    allowed: bool,
    /// The configuration arms by itself once, and has not yet.
    arm_owed: bool,
    armed: bool,
    /// Mode of the tick before.
    before: Mode,
    stopped: Option<Stopped>,
    next_tick: u64,
    due: Option<Request>,
    count: u64,
}

/// A stop that it ends.
#[derive(Clone, Copy, Debug)]
struct Stopped {
    /// True if the robot is armed again in the end.
    arm: bool,
    /// True if a client has made a request since: then the client decides.
    left_to_client: bool,
    /// A tare has run that no resume has followed.
    tared: bool,
}

impl Recovery {
    /// Ends stops of a simulated robot with a virtual board, and of no other.
    pub fn of(config: &Config) -> Self {
        let allowed = config.plant.kind == PlantKind::Simulated && config.board.port.are_simulated();
        Self { allowed, arm_owed: config.startup.arm, ..Self::default() }
    }

    /// Stops that it has ended.
    pub const fn count(&self) -> u64 {
        self.count
    }

    /// Returns the request of the next tick: what a client asks, else its own.
    pub fn next(&mut self, asked: Option<Request>) -> Option<Request> {
        let own = self.due.take();
        let Some(asked) = asked else { return own };
        let commands = !matches!(
            asked,
            Request::PressTaxel { .. } | Request::SetParameter { .. } | Request::MaskTaxel { .. }
        );
        if let Some(stopped) = self.stopped.as_mut().filter(|_| commands) {
            stopped.left_to_client = true;
        }
        Some(asked)
    }

    /// Sees what the last tick came to.
    pub fn see(&mut self, sample: &Sample) {
        if !self.allowed {
            return;
        }
        let starved = matches!(sample.fault, Some(Fault::Board { fault: BoardFault::HostStarved, .. }));
        let before = std::mem::replace(&mut self.before, sample.mode);
        match (sample.mode, self.stopped) {
            (Mode::Impedance | Mode::FollowMe, stopped) => {
                self.ended(stopped);
                (self.armed, self.arm_owed) = (true, false);
            }
            // A stop that was there before has another cause first.
            (Mode::ProtectiveStop, None) if starved && before != Mode::ProtectiveStop => {
                let arm = self.armed || self.arm_owed;
                self.stopped = Some(Stopped { arm, left_to_client: false, tared: false });
            }
            (Mode::Ready, Some(stopped)) if !stopped.arm || stopped.left_to_client => {
                self.ended(self.stopped)
            }
            (Mode::ProtectiveStop, Some(stopped)) if starved || sample.fault == Some(Fault::ZeroInvalid) => {
                self.ask(sample, if starved || stopped.tared { Request::Resume } else { Request::Tare });
            }
            (Mode::Ready, Some(_)) => self.ask(sample, Request::Arm),
            // Another cause has come: somebody has to look.
            (Mode::ProtectiveStop | Mode::Fault | Mode::Starting, _) => self.stopped = None,
            (Mode::Ready, None) => self.armed = false,
            (Mode::Taring, _) => {
                if let Some(stopped) = &mut self.stopped {
                    stopped.tared = true;
                }
            }
        }
    }

    fn ended(&mut self, stopped: Option<Stopped>) {
        self.count += u64::from(stopped.is_some_and(|stopped| !stopped.left_to_client));
        self.stopped = None;
    }

    fn ask(&mut self, sample: &Sample, request: Request) {
        let Some(stopped) = self.stopped.as_mut().filter(|stopped| !stopped.left_to_client) else { return };
        if sample.tick >= self.next_tick {
            stopped.tared = false;
            self.next_tick = sample.tick + EVERY_TICKS;
            self.due = Some(request);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::control::supervisor::{Automatic, Facts, Supervisor, Zero};
    use moca_msgs::Law;

    const GOOD: Facts = Facts {
        cover_seen: true,
        cover_fault: None,
        zero: Zero::Valid,
        zero_fault: Fault::ZeroInvalid,
        plant_fault: None,
        far_joint: None,
        touch: None,
    };
    const STARVED: Facts = Facts { cover_fault: Some(BoardFault::HostStarved.of(0)), ..GOOD };

    struct Bench {
        supervisor: Supervisor,
        recovery: Recovery,
        tick: u64,
        own: Vec<Request>,
    }

    impl Bench {
        fn new(config: &Config) -> Self {
            let automatic = Automatic { tare: true, arm: config.startup.arm };
            let supervisor = Supervisor::new(Law::Impedance, automatic);
            Self { supervisor, recovery: Recovery::of(config), tick: 0, own: Vec::new() }
        }

        /// Runs a number of ticks, each given `facts`, the first one a client's request; a tare takes two.
        fn run(&mut self, ticks: u64, facts: Facts, mut asked: Option<Request>) -> Mode {
            for _ in 0..ticks {
                let client = asked.take();
                let request = self.recovery.next(client);
                self.own.extend(request.filter(|_| client.is_none()));
                let taring = self.supervisor.mode() == Mode::Taring;
                let zero = if taring && self.tick.is_multiple_of(2) { Zero::Taring } else { facts.zero };
                let mode = self.supervisor.step(&Facts { zero, ..facts }, request).mode;
                let fault = self.supervisor.cause();
                self.recovery.see(&Sample { tick: self.tick, mode, fault, ..Sample::default() });
                self.tick += 1;
            }
            self.supervisor.mode()
        }
    }

    fn armed() -> Bench {
        let mut bench = Bench::new(&Config::default());
        assert_eq!(bench.run(10, GOOD, None), Mode::Impedance);
        bench
    }

    #[test]
    fn a_starved_simulation_arms_again_once_frames_come() {
        let mut bench = armed();
        for round in 1..=3 {
            assert_eq!(bench.run(250, STARVED, None), Mode::ProtectiveStop, "as long as it is starved");
            assert_eq!(bench.run(250, GOOD, None), Mode::Impedance);
            assert_eq!(bench.recovery.count(), round);
        }
        assert!(bench.own.len() <= 30, "it asks now and then: {}", bench.own.len());
    }

    #[test]
    fn a_tare_that_starving_broke_off_is_made_up_for() {
        let mut bench = Bench::new(&Config::default());
        bench.run(1, Facts { zero: Zero::Invalid, ..GOOD }, None);
        let no_zero = Facts { zero: Zero::Invalid, ..STARVED };
        assert_eq!(bench.run(100, no_zero, None), Mode::ProtectiveStop);
        assert_eq!(bench.run(600, GOOD, None), Mode::Impedance);
        assert_eq!(bench.recovery.count(), 1);
    }

    #[test]
    fn a_client_that_stops_it_meanwhile_has_the_say() {
        for request in [Request::Stop, Request::Disarm, Request::OperatorLost] {
            let mut bench = armed();
            bench.run(50, STARVED, None);
            bench.run(1, STARVED, Some(request));
            assert_eq!(bench.run(500, GOOD, None), Mode::ProtectiveStop, "{request:?}");
            assert_eq!(bench.recovery.count(), 0);
        }
    }

    #[test]
    fn no_other_stop_is_ended() {
        for fault in [BoardFault::Silent.of(0), BoardFault::Lost.of(0), BoardFault::Slow.of(0)] {
            let mut bench = armed();
            bench.run(50, Facts { cover_fault: Some(fault), ..GOOD }, None);
            assert_eq!(bench.run(500, GOOD, None), Mode::ProtectiveStop, "{fault:?}");
        }
        let mut bench = armed();
        bench.run(1, GOOD, Some(Request::Stop));
        assert_eq!(bench.run(500, GOOD, None), Mode::ProtectiveStop);
        bench.run(500, STARVED, None);
        assert_eq!(
            bench.run(500, GOOD, None),
            Mode::ProtectiveStop,
            "an operator's stop, whatever follows it"
        );
        let mut bench = armed();
        bench.run(1, GOOD, Some(Request::Disarm));
        bench.run(50, STARVED, None);
        assert_eq!(bench.run(500, GOOD, None), Mode::Ready, "a robot that nobody had armed stays disarmed");
    }

    #[test]
    fn a_real_robot_or_a_real_board_waits_for_its_operator() {
        let simulated = Config::default();
        let mut real_board = simulated.clone();
        real_board.board.port = "/dev/ttyACM0".into();
        let [mut real_plant, mut no_plant] = [simulated.clone(), simulated];
        real_plant.plant.kind = PlantKind::Robot;
        no_plant.plant.kind = PlantKind::None;
        for config in [real_board, real_plant, no_plant] {
            let mut bench = Bench::new(&config);
            bench.run(10, GOOD, None);
            bench.run(50, STARVED, None);
            assert_eq!(bench.run(1000, GOOD, None), Mode::ProtectiveStop);
            assert!(bench.own.is_empty(), "{:?}", bench.own);
        }
    }
}
