//! Error against run time, stiff and extreme cases, and what a scene does not need.

pub(crate) mod barrier;
pub(crate) mod bench;
pub(crate) mod economy;
pub(crate) mod extremes;
pub(crate) mod peers;
pub(crate) mod precision;
pub(crate) mod stability;
pub(crate) mod sweep;
pub(crate) mod tick;
pub(crate) mod vectors;
