//! `[plant.base.ros2]`: a base behind ROS 2.

use moca_msgs::parameter_table;

parameter_table! {
    /// `[plant.base.ros2]`: read only when plant.base.driver = "ros2".
    #[derive(Clone, Debug, PartialEq)]
    pub struct Ros2Config in "plant.base.ros2" {
        /// Domain of the base's nodes, their ROS_DOMAIN_ID.
        domain: u8 = 0 => [.range(0.0, 232.0)];
        /// The base's zenoh router where its nodes are on rmw_zenoh, such as "tcp/192.168.0.200:7447"; empty for DDS.
        router: String = String::new();
        /// Address of this PC on the base's network; empty for all networks: DDS finds its peers by multicast.
        interface: String = String::new();
        /// Topic of the velocity orders, with its namespace.
        cmd_vel: String = "/robot/robotnik_base_control/cmd_vel".into();
        /// True if the base expects TwistStamped: see `ros2 topic info`.
        stamped: bool = false;
        /// Frame named in a TwistStamped.
        frame: String = "base_link".into();
        /// Topic of the odometry, with its namespace.
        odom: String = "/robot/robotnik_base_control/odom".into();
        /// True if a lost order is sent again; a base whose reader is best-effort takes either.
        reliable_orders: bool = true;
        /// True if lost odometry is asked for again; needs a base that offers it.
        reliable_odom: bool = false;
        /// Rate of orders to the base.
        order_rate_hz: f64 = 100.0 => [.range(10.0, 1000.0).units(&["Hz"])];
        /// Without an order of the loop for so long the base is sent zero: before its own time-out.
        silence_s: f64 = 0.05 => [.range(0.005, 1.0).units(&["s"])];
    }
}
