//! Numbers over time: [`panel`] says which signals are plotted together, [`history`] keeps a minute of them, each in a
//! [`pyramid`] that never loses a spike, [`axis`] is the stretch of time that is shown, [`timing`] counts how late the
//! loop was in a [`histogram`] each.

pub mod axis;
pub mod histogram;
pub mod history;
pub mod panel;
pub mod pyramid;
pub mod timing;
