//! The command log of a lock-step run: one CSV row a tick, every number written so that it reads back to the same bits.

use moca_msgs::Sample;
use std::io::{self, Write};

/// Writes the header.
///
/// # Errors
/// The writer's.
pub fn write_header(out: &mut impl Write) -> io::Result<()> {
    writeln!(out, "tick,mode,base_vx_m_s,base_vy_m_s,base_wz_rad_s,arm_torque_nm...")
}

/// Writes one tick.
///
/// # Errors
/// The writer's.
pub fn write_row(out: &mut impl Write, sample: &Sample) -> io::Result<()> {
    write!(out, "{},{}", sample.tick, sample.mode.name())?;
    for value in sample.base_velocity_command_body.iter().chain(&sample.arm_torque_nm) {
        write!(out, ",{value}")?;
    }
    writeln!(out)
}
