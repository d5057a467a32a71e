//! MuJoCo's messages. Its own handler writes MUJOCO_LOG.TXT into whatever folder the program runs in.

use mujoco_rs::prelude::{MjLogMessage, MjtLogLevel, set_log_handler};
use std::sync::Once;

/// Warnings are read from `mjData` after every step; only what ends the process is worth a line.
fn handle(message: &MjLogMessage) {
    if message.level() == MjtLogLevel::mjLOG_ERROR {
        eprintln!("MuJoCo: {}", message.subject());
    }
}

/// Installs the handler once, before the first model is loaded.
pub(crate) fn install() {
    static INSTALLED: Once = Once::new();
    INSTALLED.call_once(|| {
        #[expect(unsafe_code, reason = "every use of MuJoCo in this crate comes after this call")]
        // SAFETY: `SimPlant::new` is the only entry to MuJoCo, and it waits here.
        unsafe {
            set_log_handler(handle);
        }
    });
}
