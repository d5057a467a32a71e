//! Figures: charts, and how they are drawn.

pub(crate) mod chart;
pub(crate) mod drawing;
