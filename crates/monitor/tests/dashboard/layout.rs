//! Nothing is clipped where the window is small.

use crate::bench::{Bench, parameter};
use egui::{Rect, Vec2};
use egui_kittest::kittest::{NodeT, Queryable};
use moca_msgs::Mode;
use moca_telemetry::ParameterForm;

/// A usual small window, halves of two usual screens, and a usual one.
const SIZES: [[f32; 2]; 4] = [[1160.0, 640.0], [960.0, 1040.0], [683.0, 700.0], [1280.0, 800.0]];

/// Labels of everything that reaches out of the window to the side, or over something that must be free.
fn outside(bench: &Bench, size: Vec2) -> Vec<String> {
    let window = Rect::from_min_size(egui::Pos2::ZERO, size).expand(1.0);
    let nodes = bench.harness.query_all_by(|node| node.label().is_some() || node.value().is_some());
    let reaches_out = nodes.filter(|node| {
        let rect = node.rect();
        rect.is_positive() && (rect.left() < window.left() || rect.right() > window.right())
    });
    reaches_out.map(|node| format!("{:?} {:?}", node.accesskit_node().label(), node.rect())).collect()
}

#[test]
fn nothing_reaches_out_of_a_small_window_on_any_page() {
    for size in SIZES.map(Vec2::from) {
        let mut bench = Bench::new();
        bench.harness.set_size(size);
        bench.daemon.borrow_mut().parameters = vec![
            parameter("control.gains.posture_stiffness", ParameterForm::Number, &[90.0; 7], true),
            parameter("board.port", ParameterForm::Text, &[], false),
        ];
        bench.frames(Mode::Impedance, None);
        for page in ["Plots", "3-D", "Loop", "Parameters", "Cover", "Calibrate"] {
            bench.click(page);
            // The table of taxels is wider than half of a small screen: there it scrolls to the side.
            if page == "Cover" && size.x < 900.0 {
                continue;
            }
            let outside = outside(&bench, size);
            assert!(outside.is_empty(), "{page} at {size}: {outside:#?}");
        }
    }
}

#[test]
fn every_button_of_the_top_row_is_free_and_the_numbers_are_in_sight() {
    for size in SIZES.map(Vec2::from) {
        let mut bench = Bench::new();
        bench.harness.set_size(size);
        bench.frames(Mode::Impedance, None);
        bench.frames(Mode::Impedance, None);
        let labels = [
            "impedance",
            "Tare",
            "Arm",
            "Disarm",
            "Resume",
            "Impedance",
            "Follow-me",
            "STOP (space)",
            "Dark",
        ];
        let rects: Vec<Rect> = labels.iter().map(|label| bench.harness.get_by_label(label).rect()).collect();
        for (index, rect) in rects.iter().enumerate() {
            for (other, label) in rects.iter().zip(labels).skip(index + 1) {
                let common = rect.intersect(*other);
                assert!(!common.is_positive(), "{} and {label} at {size}: {common:?}", labels[index]);
            }
        }
        if size.y > 600.0 && size.x > 900.0 {
            let last = bench.harness.get_by_label_contains("Speed limit").rect();
            assert!(last.bottom() <= size.y, "the last number at {size}: {last:?}");
        }
    }
}
