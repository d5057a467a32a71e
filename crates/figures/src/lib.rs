//! Figures: panels with axes, maps of coloured cells and free drawings, as SVG.
//!
//! One engine for the documents, the lab's `--out` folders, its report and the calibration's residuals. It needs no other
//! crate: the lab renders the SVG as PNG and PDF. [`progress`] is a bar on a terminal.
//!
//! ```
//! use moca_figures::{Drawing, Panel, Scale, Series};
//!
//! let error = Series::dots(0, "Euler", vec![[1e-4, 3e-5], [1e-3, 3e-4], [1e-2, 3e-3]]);
//! let panel = Panel {
//!     x_scale: Scale::Log,
//!     y_scale: Scale::Log,
//!     series: vec![error],
//!     ..Panel::new("error over step", "step [s]", "error [m]")
//! };
//! let mut drawing = Drawing::new(600.0, 300.0);
//! panel.draw(&mut drawing, [0.0, 0.0], [600.0, 300.0]);
//! assert!(drawing.svg().contains("10⁻³"));
//! ```

mod axis;
mod drawing;
mod map;
mod panel;
pub mod progress;

pub use axis::{Scale, number};
pub use drawing::{Anchor, BLACK, Colour, Drawing, GREY, PALETTE, RED, text_px, wrapped};
pub use map::Map;
pub use panel::{Panel, Series};

/// Residuals (reference, model − reference) as dots about zero, thinned to at most 2000; both in `unit`.
pub fn residuals(title: &str, unit: &str, points: &[(f64, f64)]) -> Drawing {
    let cloud = points.iter().step_by(points.len() / 2000 + 1).map(|&(x, y)| [x, y]).collect();
    let panel = Panel {
        series: vec![Series::cloud(0, cloud)],
        levels: vec![(0.0, "")],
        ..Panel::new(title, &format!("reference [{unit}]"), &format!("model − reference [{unit}]"))
    };
    let mut drawing = Drawing::new(640.0, 420.0);
    panel.draw(&mut drawing, [0.0, 6.0], [640.0, 408.0]);
    drawing
}
