//! How it looks: [`App`] lays out `top` (mode, reason, buttons), `robot` (from above, with its ring of taxels),
//! `gauges`, the [`Page`] in the middle (`plots`, `timing`, `parameters`, `cover`, `calibrate`), and `playback` for a recorded run.

mod app;
mod calibrate;
mod cover;
mod files;
mod gauges;
mod page;
mod parameters;
mod playback;
mod plots;
mod robot;
mod screenshot;
mod theme;
mod timing;
mod top;
mod view;

pub use app::App;
pub use page::Page;
pub use screenshot::Screenshot;
use view::View;
