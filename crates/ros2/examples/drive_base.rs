//! Drives a base slowly over DDS, or over zenoh if a router is given, and says what came back: orders at the loop's rate
//! for a while, then none at all.
//!
//!     cargo run -p moca-ros2 --features dds --example drive_base -- 42 /cmd_vel /odom twist 5 0.02
//!     cargo run -p moca-ros2 --features dds,zenoh --example drive_base -- 42 /cmd_vel /odom twist 5 0.02 tcp/127.0.0.1:7447
//!
//! Domain, topics, `twist` or `stamped`, seconds, m/s, router. The last line is JSON, for `.ci/ros2`.
#![allow(clippy::print_stdout, clippy::print_stderr, reason = "a program")]

use moca_ros2::base::{BaseSettings, Reliable, Ros2Base};
use moca_ros2::network::Network;
use std::sync::atomic::Ordering::Relaxed;
use std::time::{Duration, Instant};

/// Silence of the loop at the end, to see the base stop.
const SILENT: Duration = Duration::from_secs(1);

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let [domain, cmd_vel, odom, kind, seconds, speed_m_s, router @ ..] = &arguments[..] else {
        return Err("give DOMAIN CMD_VEL ODOM twist|stamped SECONDS SPEED_M_S [ROUTER]".into());
    };
    let (domain, router) = (domain.parse()?, router.first().cloned());
    let transport = Network { domain, interfaces: Vec::new(), router, node: "drive_base" }.join()?;
    let settings = BaseSettings {
        cmd_vel: cmd_vel.clone(),
        stamped: kind == "stamped",
        frame: "base_link".into(),
        odom: odom.clone(),
        rate_hz: 100.0,
        silence_s: 0.05,
        deadline_s: 0.1,
        reliable: Reliable::default(),
        velocity_max: [1.5, 1.5, 2.0],
    };
    let speed_m_s: f64 = speed_m_s.parse()?;
    let mut base = Ros2Base::spawn(settings, transport, |text| eprintln!("{text}"))?;
    let end = Instant::now() + Duration::from_secs_f64(seconds.parse()?);
    let (mut stale, mut was_stale, mut heard) = (0, true, false);
    while Instant::now() < end {
        let fresh = base.state().is_some_and(|state| state.age_s < 0.1);
        // Without odometry nothing is driven, as in the daemon.
        base.order([if fresh { speed_m_s } else { 0.0 }, 0.0, 0.0]);
        stale += u32::from(heard && !fresh && !was_stale);
        (heard, was_stale) = (heard || fresh, !fresh);
        std::thread::sleep(Duration::from_millis(1));
    }
    let problems = base.problems();
    std::thread::sleep(SILENT);
    let pose = base.state().map(|state| state.pose_world).unwrap_or_default();
    let counts = base.counts();
    println!(
        "{{\"sent\": {}, \"unsent\": {}, \"odometry\": {}, \"refused\": {}, \"garbled\": {}, \"silences\": {}, \
              \"stale\": {stale}, \"pose\": {pose:?}, \"problems\": {problems:?}}}",
        counts.sent.load(Relaxed),
        counts.unsent.load(Relaxed),
        counts.odometry.load(Relaxed),
        counts.refused.load(Relaxed),
        counts.garbled.load(Relaxed),
        counts.silences.load(Relaxed)
    );
    Ok(())
}
