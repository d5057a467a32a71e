//! A base behind ROS 2 under whatever arm there is: the arm's plant is asked for everything but the base.

use crate::config::Config;
use crate::control::plant::{Datagram, Plant, PlantClock, SourceAge};
use crate::robot::JOINTS;
use crate::runtime::realtime::Raised;
use anyhow::{Context, Result};
use moca_msgs::{Actuation, ArmLink, Fault, Outcome, RobotCommand, RobotState};
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

    fn link(&self) -> Option<ArmLink> {
        self.arm.link()
    }

    fn recover(&mut self) -> Outcome {
        self.arm.recover()
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
    use moca_ros2::messages::{Odometry, Quaternion, Time, Twist};
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
