//! How it looks: [`App`] lays out `top` (mode, reason, buttons), `robot` (from above, with its ring of taxels),
//! `gauges`, `plots`, and
//! `playback` for a recorded run.

mod app;
mod gauges;
mod playback;
mod plots;
mod robot;
mod screenshot;
mod theme;
mod top;

pub use app::App;
pub use screenshot::Screenshot;
