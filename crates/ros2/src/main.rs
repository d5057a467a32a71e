//! moca-ros2: a running robot for ROS 2 nodes.
#![allow(clippy::print_stdout, clippy::print_stderr, reason = "a program that says what it does")]

use clap::Parser;
use moca_ros2::bridge::{Bridge, BridgeSettings};
use moca_ros2::network::Network;
use moca_telemetry::net::{Address, Connection};
use std::net::IpAddr;

/// Shows a running robot to ROS 2 nodes, and takes tare, arm, disarm, stop and resume from them as services.
#[derive(Parser)]
#[command(name = "moca-ros2", version)]
struct Arguments {
    /// The daemon: HOST:PORT or unix:/PATH; without it the one of this machine.
    #[arg(long, value_name = "ADDRESS")]
    address: Option<Address>,
    /// ROS_DOMAIN_ID of the nodes.
    #[arg(long, value_name = "N", default_value_t = 0, value_parser = clap::value_parser!(u16).range(0..=232))]
    domain: u16,
    /// Address of this PC on the nodes' network; without it all of its networks. May be given more than once.
    #[arg(long, value_name = "IP")]
    interface: Vec<IpAddr>,
    /// Zenoh router of nodes on rmw_zenoh, such as tcp/192.168.0.200:7447; without it they are on DDS.
    #[arg(long, value_name = "ROUTER", conflicts_with = "interface")]
    router: Option<String>,
    /// Namespace of topics and services.
    #[arg(long, default_value = "/moca")]
    prefix: String,
    /// Send no transforms: the base's own node says where base_link is.
    #[arg(long)]
    no_tf: bool,
}

fn main() -> anyhow::Result<()> {
    let arguments: Arguments = moca_manual::parse("moca-ros2", &[]);
    let address = arguments.address.unwrap_or_else(Address::of_this_machine);
    let daemon = Connection::spawn(address.clone(), || {})?;
    let settings = BridgeSettings { prefix: arguments.prefix, tf: !arguments.no_tf };
    let network = Network {
        domain: arguments.domain,
        interfaces: arguments.interface,
        router: arguments.router,
        node: "moca",
    };
    let mut bridge = Bridge::new(network.join()?, settings)?;
    println!("{address} for ROS 2, domain {}", arguments.domain);
    loop {
        bridge.step(&daemon, |what| eprintln!("{address}: {what}"))?;
    }
}
