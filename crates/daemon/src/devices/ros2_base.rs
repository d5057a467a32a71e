//! A base behind ROS 2 under whatever arm there is: the arm's plant is asked for everything but the base.

use crate::config::Config;
use crate::control::flange_sensor::FlangeSensor;
use crate::control::plant::{Datagram, Plant, PlantClock, SourceAge};
use crate::robot::JOINTS;
use crate::runtime::realtime::Raised;
use anyhow::{Context, Result};
use moca_msgs::{
    Actuation, ArmLink, ArmMode, Fault, GripperRequest, GripperState, Outcome, RobotCommand, RobotState,
};
use moca_ros2::base::{BaseSettings, Reliable, Ros2Base};
use moca_ros2::network::Network;
use moca_ros2::transport::Transport;
use moca_wbc::rotation::{self, Heading};
use std::net::IpAddr;
use std::time::Duration;

/// Begins to serve the base that the configuration names; it may come later. `say` hears in sentences what is wrong on the
/// network.
///
/// # Errors
/// No network, or a topic whose name is none.
pub fn connect(config: &Config, say: impl FnMut(&str) + Send + 'static) -> Result<Ros2Base> {
    // A base that is not heard stops the robot, as a board does: its threads are raised as the board's are.
    let (_raised, _) = Raised::below(config.realtime.priority);
    Ros2Base::spawn(settings(config), transport(config)?, say).context("plant.base.driver = \"ros2\"")
}

/// The way to the base's network.
pub(crate) fn transport(config: &Config) -> Result<Box<dyn Transport + Send>> {
    let ros2 = &config.plant.base.ros2;
    let interface = Some(&ros2.interface).filter(|address| !address.is_empty());
    let interface = interface.map(|address| address.parse::<IpAddr>()).transpose();
    let network = Network {
        domain: u16::from(ros2.domain),
        interfaces: interface.context("plant.base.ros2.interface")?.into_iter().collect(),
        router: Some(&ros2.router).filter(|router| !router.is_empty()).cloned(),
        node: "mocad",
    };
    network.join().context("plant.base.driver = \"ros2\"")
}

/// The base that the configuration names.
pub(crate) fn settings(config: &Config) -> BaseSettings {
    let plant = &config.plant.base;
    let ros2 = &plant.ros2;
    BaseSettings {
        cmd_vel: ros2.cmd_vel.clone(),
        stamped: ros2.stamped,
        frame: ros2.frame.clone(),
        odom: ros2.odom.clone(),
        rate_hz: ros2.order_rate_hz,
        silence_s: ros2.silence_s,
        deadline_s: plant.deadline_s,
        reliable: Reliable { orders: ros2.reliable_orders, odom: ros2.reliable_odom },
        velocity_max: config.limits.base_velocity,
    }
}

/// An arm, or none at all, on a base behind ROS 2.
pub struct OnRos2Base<A> {
    arm: A,
    base: Ros2Base,
    base_age_s: f64,
}

impl<A> OnRos2Base<A> {
    /// `arm` believes to stand at the origin of W.
    pub const fn new(arm: A, base: Ros2Base) -> Self {
        Self { arm, base, base_age_s: f64::INFINITY }
    }
}

impl<A: Plant> Plant for OnRos2Base<A> {
    fn read(&mut self) -> Result<RobotState<JOINTS>, Fault> {
        let base = self.base.state();
        // The supervisor judges the age: a base that is not there leaves the arm its state.
        self.base_age_s = base.map_or(f64::INFINITY, |base| base.age_s);
        let mut state = self.arm.read()?;
        if let Some(base) = base {
            (state.base_pose_world, state.base_velocity_world) = (base.pose_world, base.velocity_world);
            let axes = Heading::at(base.pose_world[2]).matrix();
            state.flange_wrench_world =
                state.flange_wrench_world.map(|wrench| rotation::turned(&axes, &wrench));
        }
        Ok(state)
    }

    fn age(&self) -> SourceAge {
        SourceAge { base_s: self.base_age_s, ..self.arm.age() }
    }

    /// Without a real arm there is still a way to a base, and its age.
    fn link(&self) -> Option<ArmLink> {
        let no_arm = ArmLink { mode: ArmMode::NotThere, ..ArmLink::default() };
        Some(self.arm.link().unwrap_or(no_arm))
    }

    fn recover(&mut self) -> Outcome {
        self.arm.recover()
    }

    fn flange_sensor(&mut self) -> Option<&mut dyn FlangeSensor> {
        self.arm.flange_sensor()
    }

    fn gripper(&mut self) -> Option<GripperState> {
        self.arm.gripper()
    }

    fn request_gripper(&mut self, request: &GripperRequest) -> Outcome {
        self.arm.request_gripper(request)
    }

    fn write(&mut self, actuation: &Actuation<JOINTS>, ticks: u64) -> Result<(), Fault> {
        let (velocity_body, arm) = match actuation {
            Actuation::Drive(command) => {
                let arm = RobotCommand { base_velocity_body: [0.0; 3], ..*command };
                (command.base_velocity_body, Actuation::Drive(arm))
            }
            Actuation::Brake => ([0.0; 3], Actuation::Brake),
        };
        // The base first: it stops whatever the arm says.
        self.base.order(velocity_body);
        self.arm.write(&arm, ticks)
    }
}

impl<A: PlantClock> PlantClock for OnRos2Base<A> {
    fn receive(&mut self, timeout: Duration) -> Datagram {
        self.arm.receive(timeout)
    }
}

#[cfg(test)]
#[expect(clippy::float_cmp, reason = "values that are handed on unchanged")]
mod tests {
    use super::*;
    use moca_ros2::cdr;
    use moca_ros2::messages::{Odometry, Quaternion, Time, Twist, TwistStamped};
    use moca_ros2::transport::memory::Memory;
    use std::sync::mpsc;

    /// Stands at home with 1 N along its x axis, and remembers the last order.
    struct Arm(RobotState<JOINTS>, Option<Actuation<JOINTS>>);

    impl Plant for Arm {
        fn read(&mut self) -> Result<RobotState<JOINTS>, Fault> {
            Ok(self.0)
        }

        fn age(&self) -> SourceAge {
            SourceAge { arm_s: 0.004, base_s: 0.0 }
        }

        fn write(&mut self, actuation: &Actuation<JOINTS>, _: u64) -> Result<(), Fault> {
            self.1 = Some(*actuation);
            Ok(())
        }
    }

    fn odometry() -> Vec<u8> {
        let mut message = Odometry::default();
        message.header.stamp = Time::from_unix_ns(1_700_000_000_000_000_000);
        message.pose.pose.position.x = 2.0;
        message.pose.pose.orientation = Quaternion::about_z(std::f64::consts::FRAC_PI_2);
        message.twist.twist.linear.x = 0.5;
        cdr::encode(&message)
    }

    fn robot(waiting: Vec<Vec<u8>>) -> (OnRos2Base<Arm>, mpsc::Receiver<Vec<u8>>) {
        let config = Config::default();
        let (heard, sent) = mpsc::channel();
        let memory = Memory { heard: Some(heard), waiting, ..Memory::default() };
        let base = Ros2Base::spawn(settings(&config), Box::new(memory), |_| {}).unwrap();
        let mut state = RobotState::at_rest([0.1; JOINTS]);
        state.flange_wrench_world = Some([1.0, 0.0, 0.0, 0.0, 0.0, 0.0]);
        (OnRos2Base::new(Arm(state, None), base), sent)
    }

    #[test]
    fn the_base_is_the_odometrys_and_the_arm_its_own() {
        let (mut robot, _sent) = robot(vec![odometry()]);
        while robot.base.state().is_none() {
            std::thread::yield_now();
        }
        let state = robot.read().unwrap();
        assert_eq!(state.q_rad, [0.1; JOINTS]);
        assert_eq!(state.base_pose_world[0].to_bits(), 2.0_f64.to_bits());
        // Driving forwards while looking along y.
        assert!(state.base_pose_world[1] > 0.0 && (state.base_velocity_world[1] - 0.5).abs() < 1e-12);
        assert!((state.flange_wrench_world.unwrap()[1] - 1.0).abs() < 1e-12);
        assert!(robot.age().base_s < f64::INFINITY && robot.age().arm_s == 0.004);
    }

    #[test]
    fn a_base_that_never_spoke_is_old_and_leaves_the_arm_its_state() {
        let (mut robot, _sent) = robot(Vec::new());
        assert_eq!(robot.read().unwrap().q_rad, [0.1; JOINTS]);
        assert_eq!(robot.age(), SourceAge { arm_s: 0.004, base_s: f64::INFINITY });
        assert_eq!(robot.link().map(|arm| arm.mode), Some(ArmMode::NotThere), "clients are shown its age");
    }

    /// A simulated robot whose base is heard of at 50 Hz only, carried on for `most_ns` at the most.
    #[cfg(feature = "sim")]
    struct Heard {
        robot: moca_lockstep::simulated_robot::SimulatedRobot,
        last: moca_ros2::base::odometry::BaseReading,
        most_ns: u64,
        now_ns: u64,
    }

    #[cfg(feature = "sim")]
    impl Plant for Heard {
        fn read(&mut self) -> Result<RobotState<JOINTS>, Fault> {
            const ODOMETRY_NS: u64 = 20_000_000;
            let mut state = self.robot.read()?;
            if self.now_ns.is_multiple_of(ODOMETRY_NS) {
                let [vx, vy, yaw_rate] = state.base_velocity_world;
                let (sin, cos) = state.base_pose_world[2].sin_cos();
                self.last = moca_ros2::base::odometry::BaseReading {
                    measured_ns: self.now_ns,
                    pose_world: state.base_pose_world,
                    velocity_body: [cos * vx + sin * vy, cos * vy - sin * vx, yaw_rate],
                };
            }
            (state.base_pose_world, state.base_velocity_world) =
                self.last.predicted(self.now_ns, self.most_ns);
            self.now_ns += 1_000_000;
            Ok(state)
        }

        fn write(&mut self, actuation: &Actuation<JOINTS>, ticks: u64) -> Result<(), Fault> {
            self.robot.write(actuation, ticks)
        }
    }

    /// A cover that is pushed at its left side.
    #[cfg(feature = "sim")]
    struct Pushed(crate::control::cover::CoverState);

    #[cfg(feature = "sim")]
    impl crate::control::cover::CoverSource for Pushed {
        fn read(&mut self, now_ns: u64, felt: &mut crate::control::cover::CoverState) {
            self.0.reading.sampled_at_ns = Some(now_ns);
            self.0.frames_good += 1;
            *felt = self.0;
        }

        fn start_tare(&mut self, _now_ns: u64) {
            self.0.zero = crate::control::supervisor::Zero::Valid;
        }
    }

    /// Largest step of a joint's torque from one tick to the next while the base is pushed away, N·m.
    #[cfg(feature = "sim")]
    fn torque_step_nm(most_ns: u64) -> f64 {
        use crate::control::stage::Untimed;
        use crate::control::supervisor::Zero;
        use crate::control::tick::ControlLoop;
        use crate::control::tick_input::Slot;
        use moca_lockstep::simulated_robot::{SimulatedRobot, free_scene};
        use moca_msgs::{Mode, TaxelReading, TaxelStatus};
        let mut config = Config::default();
        config.protection.override_speed_limit_m_s = 0.5;
        config.protection.override_statement = "this cover's rate is not what is tested".into();
        let robot = SimulatedRobot::new(&config, &free_scene(&config), Vec::new()).unwrap();
        let plant = Heard { robot, last: Default::default(), most_ns, now_ns: 0 };
        let none = crate::control::cover::CoverState::NONE;
        let mut cover = Pushed(crate::control::cover::CoverState {
            frames_good: 1,
            rate_hz: 250.0,
            zero: Zero::Invalid,
            ..none
        });
        cover.0.poll.reading.taxels.fill(TaxelReading { force_n: 0.0, status: TaxelStatus::Ok });
        let (supervisor, motion) = (
            crate::runtime::assemble::supervisor(&config),
            crate::runtime::assemble::motion(&config).unwrap(),
        );
        let mut control = ControlLoop::new(plant, cover, supervisor, motion, 1e-3);
        let (mut before, mut most_nm) = (None, 0.0_f64);
        for tick in 0..3000_u64 {
            let pushes = tick >= 1000;
            let force_n = if pushes { 20.0 } else { 0.0 };
            control.cover.0.poll.reading.taxels[1].force_n = force_n;
            control.cover.0.poll.forces =
                Ok(std::array::from_fn(|taxel| if taxel == 1 { force_n } else { 0.0 }));
            let slot = Slot { tick, now_ns: tick * 1_000_000, ticks: 1, ..Slot::default() };
            let sample = &control.tick(&slot, None, &mut Untimed).sample;
            let torque_nm = sample.arm_torque_nm.clone();
            // From when it moves on: the push itself is a step in both.
            if tick >= 1500 {
                assert_eq!((sample.mode, sample.fault), (Mode::Impedance, None), "tick {tick}");
                for (now, before) in torque_nm.iter().zip(before.iter().flatten()) {
                    let (now, before): (&f64, &f64) = (now, before);
                    most_nm = most_nm.max((now - before).abs());
                }
            }
            before = Some(torque_nm);
            if tick == 2999 {
                assert!(sample.base_pose_world[1].abs() > 0.05, "it gives way: {:?}", sample.base_pose_world);
            }
        }
        most_nm
    }

    #[test]
    #[cfg(feature = "sim")]
    fn extrapolated_odometry_reduces_torque_steps() {
        let [staircase, carried_on] = [0, 100_000_000].map(torque_step_nm);
        let said =
            format!("{carried_on:.2} N·m instead of {staircase:.2} N·m, {:.2} of it", carried_on / staircase);
        println!("{said}");
        assert!(carried_on < 0.5 * staircase, "{said}");
        let docs = include_str!("../../../../docs/robot.md");
        assert!(docs.contains(&said), "docs/robot.md does not say: {said}");
    }

    #[test]
    fn every_shipped_base_gets_its_message_type() {
        let order = |name: &str| {
            let folder = concat!(env!("CARGO_MANIFEST_DIR"), "/../../examples/robots/");
            let config = Config::load(std::path::Path::new(&format!("{folder}{name}"))).unwrap();
            let (heard, sent) = mpsc::channel();
            let memory = Memory { heard: Some(heard), ..Memory::default() };
            let mut base = Ros2Base::spawn(settings(&config), Box::new(memory), |_| {}).unwrap();
            base.order([0.1, 0.2, 0.3]);
            (settings(&config).cmd_vel, sent.recv().unwrap())
        };
        let moves = |twist: &Twist| (twist.linear.array(), twist.angular.array());
        let expected = ([0.1, 0.2, 0.0], [0.0, 0.0, 0.3]);
        let (topic, payload) = order("mecanum-ros2.toml");
        let stamped: TwistStamped = cdr::decode(&payload).unwrap();
        assert_eq!((&*topic, moves(&stamped.twist)), ("/mecanum_drive_controller/reference", expected));
        assert_eq!(stamped.header.frame_id, "base_link");
        assert!(stamped.header.stamp.unix_ns() > 0, "the controller drops orders that are too old");
        let (topic, payload) = order("holonomic-ros2.toml");
        assert_eq!((&*topic, moves(&cdr::decode(&payload).unwrap())), ("/cmd_vel", expected));
    }

    #[test]
    fn the_base_gets_the_velocity_and_the_arm_the_torque() {
        let (mut robot, sent) = robot(Vec::new());
        let mut command = RobotCommand {
            base_velocity_body: [0.1, 0.2, 0.3],
            arm_torque_nm: [4.0; JOINTS],
            arm_gravity_nm: [1.0; JOINTS],
        };
        robot.write(&Actuation::Drive(command), 1).unwrap();
        let first: Twist = cdr::decode(&sent.recv().unwrap()).unwrap();
        assert_eq!((first.linear.array(), first.angular.array()), ([0.1, 0.2, 0.0], [0.0, 0.0, 0.3]));
        command.base_velocity_body = [0.0; 3];
        assert_eq!(robot.arm.1, Some(Actuation::Drive(command)), "the arm's own base stands");
        robot.write(&Actuation::Brake, 1).unwrap();
        assert_eq!(robot.arm.1, Some(Actuation::Brake));
        let zero = |payload: Vec<u8>| cdr::decode::<Twist>(&payload) == Ok(Twist::default());
        assert!(sent.iter().any(zero), "a brake is a base at rest");
    }
}
