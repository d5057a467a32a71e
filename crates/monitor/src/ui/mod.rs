//! How it looks: [`App`] lays out `top` (mode, reason, buttons), `robot` (from above, with its ring of taxels),
//! `gauges` and `plots`.

mod app;
mod gauges;
mod plots;
mod robot;
mod screenshot;
mod theme;
mod top;

pub use app::App;
pub use screenshot::Screenshot;
