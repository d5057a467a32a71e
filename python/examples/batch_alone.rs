//! CPU time of the robots of a batch without Python and without threads, per step of 20 ticks with a target of the base:
//! `cargo run --release --manifest-path python/Cargo.toml --example batch_alone -- ROBOTS STEPS`.

use moca_control::config::Config;
use moca_lockstep::LockStep;
use moca_lockstep::simulated_robot::free_scene;
use moca_lockstep::virtual_boards::board_config;
use moca_msgs::{Request, Target, TimedTarget, TouchPolicy};

fn cpu_s() -> f64 {
    let stat = std::fs::read_to_string("/proc/self/schedstat").unwrap_or_default();
    stat.split(' ').next().and_then(|ns| ns.parse::<f64>().ok()).unwrap_or(f64::NAN) * 1e-9
}

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let mut arguments = std::env::args().skip(1);
    let robots: u64 = arguments.next().ok_or("ROBOTS STEPS")?.parse()?;
    let steps: u32 = arguments.next().ok_or("ROBOTS STEPS")?.parse()?;
    let mut worlds = Vec::new();
    for seed in 0..robots {
        let mut config = Config::parse("startup.law = \"follow-me\"\nsimulation.hand.taxels = []\n")?;
        config.simulation.seed = seed;
        let mut scene = free_scene(&config);
        scene.engine = scene.needed_engine();
        let mut world = LockStep::with_board(&config, &scene, board_config(&config), None)?;
        while !world.tick(None).sample.mode.moves() {}
        worlds.push(world);
    }
    let mut velocity = 0.0_f64;
    let before = cpu_s();
    for step in 0..steps {
        let velocity_body = [0.2 * f64::from(step).sin(), 0.2 * f64::from(step).cos(), 0.0];
        let target = Target::BaseVelocity { velocity_body };
        let timed = TimedTarget {
            target,
            stamp_unix_ns: 0,
            age_s: 0.0,
            age_limit_s: 0.2,
            touch: TouchPolicy::PassThrough,
        };
        for world in &mut worlds {
            world.tick(Some(Request::Target(timed)));
            for _ in 1..20 {
                velocity = world.tick(None).sample.base_velocity_world[0];
            }
        }
    }
    let us = 1e6 * (cpu_s() - before) / (f64::from(steps) * worlds.len() as f64);
    println!("{us:.1} us of CPU a step of one robot ({robots} robots, last speed {velocity:.3} m/s)");
    Ok(())
}
