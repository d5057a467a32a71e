//! How it looks: [`App`] lays out `top` (mode, reason, buttons), `robot` with its ring of taxels, `gauges`, one of the
//! `pages` in the middle, and `playback` under a log. Everything that is pressed in a frame is gathered in
//! `requests::PageRequests` and sent by the app at its end.

mod app;
mod files;
mod gauges;
mod pages;
mod playback;
mod requests;
mod robot;
mod screenshot;
mod tab;
mod theme;
mod toasts;
mod top;
mod view;

pub use app::App;
pub use pages::Page;
pub use screenshot::Screenshot;
