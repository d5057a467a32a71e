//! What to show and what to ask, without a screen.
//!
//! [`Model`] takes in what a [`Source`] delivers · [`History`] keeps a minute of signals, each in a [`Pyramid`] that
//! never loses a spike · [`playback`] makes a log a source, [`recording`] makes one · [`panel`] says which signals are
//! plotted together, [`axis`] which stretch of time · [`timing`] counts how late the loop was, in [`histogram`]s · [`action`] says what
//! may be asked when · [`arm`] finds where the arm's joints are · [`hand`] presses a simulated taxel · [`words`] turns numbers and states into text.

pub mod action;
pub mod arm;
pub mod axis;
pub mod hand;
pub mod histogram;
pub mod history;
pub mod model;
pub mod panel;
pub mod playback;
pub mod pyramid;
pub mod recording;
pub mod timing;
pub mod words;

pub use action::Action;
pub use axis::TimeAxis;
pub use histogram::Histogram;
pub use history::History;
pub use model::{Model, Source};
pub use panel::{Panel, Signal};
pub use playback::Playback;
pub use pyramid::Pyramid;
pub use recording::Recording;
pub use timing::Timing;
