//! A Touch Board without hardware at a path of your choice, for a daemon that drives a real robot: presses come from standard
//! input, one `TAXEL NEWTON` a line.
//!
//! `cargo run -p moca-sim --example touch_board -- /tmp/touch-board`

use moca_sim::{PtyBoard, SharedForces, VirtualBoardConfig};
use moca_tactile::Firmware;
use std::error::Error;
use std::path::Path;
use std::sync::atomic::Ordering;

fn main() -> Result<(), Box<dyn Error>> {
    let path = std::env::args().nth(1).ok_or("give the path that mocad is to open as board.port")?;
    let forces = SharedForces::default();
    let config = VirtualBoardConfig { firmware: Firmware::Moca, ..VirtualBoardConfig::default() };
    let _board = PtyBoard::spawn(config, SharedForces::clone(&forces), Path::new(&path))?;
    for line in std::io::stdin().lines() {
        let line = line?;
        let (taxel, newton) = line.split_once(' ').ok_or("a line is a taxel and a force in N: 6 20")?;
        let taxel: usize = taxel.trim_start_matches('T').parse()?;
        let electrode = taxel.checked_sub(1).and_then(|electrode| forces.get(electrode));
        let electrode = electrode.ok_or("taxels are 1 to 12")?;
        electrode.store(newton.trim().parse::<f64>()?.to_bits(), Ordering::Relaxed);
    }
    Ok(())
}
