//! Comparisons with reference results, and measures of a step, that this crate's tests and the laboratory share (feature
//! `testing`; needs std).
//!
//! ```
//! use moca_wbc::testing::reference_file;
//!
//! // a file of other results than ours would name the quantity and how far it is off
//! let empty = r#"{"meta": {}, "vectors": []}"#;
//! assert!(reference_file::compare(&serde_json::from_str(empty)?).is_err());
//! # Ok::<(), serde_json::Error>(())
//! ```

pub mod accuracy;
pub mod footprint;
mod numbers;
pub mod reference_file;
pub mod steps;

pub use numbers::Numbers;
