#![doc = include_str!("../README.md")]
#![no_std]
#![forbid(unsafe_code)]
#![expect(clippy::needless_range_loop, reason = "matrix algorithms read as in the books: by index")]

mod factor;
mod lanes;
mod metric;
mod row;
mod scalar;
mod solution;

pub use metric::Metric;
pub use row::Row;
pub use scalar::Scalar;
pub use solution::{Active, QpError, Side, Solution, WorkingSet};
