//! The arm of a configuration as the controllers compute it: a posture a line in, pose of the flange on its base and mass
//! matrix out, as JSON. `tests/peers/arms` compares them with a foreign library's.

use moca_control::config::Config;
use moca_msgs::robot::{Mount, Payload};
use moca_wbc::ArmModel;
use std::error::Error;
use std::io::{BufRead as _, Write as _};
use std::path::Path;

fn main() -> Result<(), Box<dyn Error>> {
    let path = std::env::args().nth(1).ok_or("usage: arm_model CONFIG < postures")?;
    let config = Config::load(Path::new(&path))?;
    match config.arm().joints {
        6 => answer::<6>(&config),
        _ => answer::<7>(&config),
    }
}

fn answer<const N: usize>(config: &Config) -> Result<(), Box<dyn Error>> {
    let table = config.arm().table::<N>().ok_or("an arm of 6 or 7 joints")?;
    let on_the_ground = Mount { position_base_m: [0.0; 3], rpy_rad: [0.0; 3] };
    let model = ArmModel::<N, f64>::new(&table, &on_the_ground, &Payload::NONE)?;
    let mut out = std::io::stdout().lock();
    for line in std::io::stdin().lock().lines() {
        let q: Vec<f64> = line?.split_whitespace().map(str::parse).collect::<Result<_, _>>()?;
        let q_rad: [f64; N] = q.try_into().map_err(|_| "one angle for each joint")?;
        let dynamics = model.dynamics(0.0, &q_rad, &[0.0; N]);
        let kinematics = &dynamics.kinematics;
        let row = serde_json::json!({
            "position_m": kinematics.tool_position.as_slice(),
            // row by row
            "rotation": kinematics.tool_rotation.transpose().as_slice(),
            "mass": dynamics.mass.as_slice(),
        });
        writeln!(out, "{row}")?;
    }
    Ok(())
}
