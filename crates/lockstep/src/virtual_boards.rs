//! The virtual Touch Boards under a simulated cover, as the configuration asks for them.

use crate::simulated_robot::true_foam;
use anyhow::{Result, anyhow};
use moca_control::config::Config;
use moca_sim::VirtualBoardConfig;

/// Checks that virtual Touch Boards, which have no further chips, can read the whole cover.
///
/// # Errors
/// A taxel on an electrode that they do not have.
pub fn fit(config: &Config) -> Result<()> {
    config.robot.cover.beyond_one_chip().map_or(Ok(()), |message| Err(anyhow!(message)))
}

/// The virtual board with this number (0 is the first): each has noise, a phase and a clock of its own.
pub fn nth_board(first: VirtualBoardConfig, number: usize) -> VirtualBoardConfig {
    /// Two boards are not switched on in the same moment.
    const PHASE_NS: u64 = 1_700_000;
    /// The second board's clock wraps after five seconds.
    const CLOCK_US: u32 = u32::MAX - 5_000_000;
    let (n, count) = (u64::try_from(number).unwrap_or(0), u32::try_from(number).unwrap_or(0));
    VirtualBoardConfig {
        seed: first.seed.wrapping_add(n),
        first_read_ns: first.first_read_ns + n * PHASE_NS,
        clock_start_us: first.clock_start_us.wrapping_add(count.wrapping_mul(CLOCK_US)),
        ..first
    }
}

/// The virtual Touch Board under the cover that the configuration asks for.
pub fn board_config(config: &Config) -> VirtualBoardConfig {
    VirtualBoardConfig {
        firmware: config.board.firmware,
        seed: config.simulation.seed,
        foam: true_foam(config),
        ..Default::default()
    }
}
