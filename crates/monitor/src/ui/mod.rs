//! Layout of the window: [`App`] lays out `top` (mode, reason, buttons), `robot` with its ring of taxels, `gauges`, one of the
//! `pages` in the middle, and `playback` under a log. All presses of a frame are gathered in
//! `requests::PageRequests` and sent by the app at its end. [`FleetWindow`] lists several robots and lays out the one that is open.

mod app;
mod field;
mod files;
mod fleet;
mod gauges;
mod guard;
mod pages;
mod playback;
mod requests;
mod robot;
mod row;
mod screenshot;
mod tab;
mod theme;
mod toasts;
mod top;
mod view;

pub use app::App;
pub use fleet::{FleetWindow, Look, Open};
pub use pages::Page;
pub use screenshot::Screenshot;
