//! The daemon of MOCA-S: the only place where its parts meet.
//!
//! From the inside out:
//! 1. [`control`]: one tick: read the plant, read the cover, decide the mode, command, write ([`control::tick`]); which
//!    mode and why ([`control::supervisor`]), which law ([`control::law`]), how fast the base may go
//!    ([`control::protection`]). No thread, clock or file.
//! 2. [`runtime`]: callers of the tick: the wall clock ([`runtime::live`]), or a run that wants every tick now
//!    ([`moca_lockstep`]); and what runs beside it.
//! 3. [`devices`]: the real robots and ports there are. [`inject`]: faults on purpose that need a thread or a socket.
//! 4. [`record`]: what is kept of a run; [`runtime::replay`] runs it again.
//! 5. [`robot`]: arm, base, cover, tool and load as data. [`config`]: from a file to checked settings. [`calibration`]: counts to newtons, taxel by taxel.
//! 6. [`cli`]: what a user sees of it on a terminal.
//!
//! The loop refuses to know who watches it: samples leave through a bounded ring, requests arrive through another.

/// Version of this program and the processors that its loop is compiled for: logs carry both.
pub const VERSION: &str = if cfg!(target_feature = "avx512f") {
    concat!(env!("CARGO_PKG_VERSION"), "+x86-64-v4")
} else if cfg!(all(target_feature = "avx2", target_feature = "fma")) {
    concat!(env!("CARGO_PKG_VERSION"), "+x86-64-v3")
} else {
    concat!(env!("CARGO_PKG_VERSION"), "+x86-64")
};

/// Features that this program was built with.
pub fn features() -> Vec<&'static str> {
    let all = [
        ("sim", cfg!(feature = "sim")),
        ("board", cfg!(feature = "board")),
        ("fci", cfg!(feature = "fci")),
        ("ros2", cfg!(feature = "ros2")),
        ("ros2-zenoh", cfg!(feature = "ros2-zenoh")),
        ("tls", cfg!(feature = "tls")),
    ];
    all.into_iter().filter_map(|(name, there)| there.then_some(name)).collect()
}

pub mod calibration;
pub mod cli;
pub mod devices;
pub mod inject;
pub mod record;
pub mod runtime;

use moca_control as control;
use moca_control::{config, robot};
