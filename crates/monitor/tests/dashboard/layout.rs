//! Nothing is clipped where the window is small.

use crate::bench::{Bench, parameter, sample};
use egui::{Rect, Role, Vec2};
use egui_kittest::kittest::{NodeT, Queryable};
use moca_msgs::{BoardFault, Fault, Mode, TaxelStatus};
use moca_telemetry::calibration::{CalibrationFit, CalibrationProgress, FittedModel};
use moca_telemetry::{ParameterForm, net::Commander};

/// A usual small window, halves of two usual screens, and a usual one.
pub(crate) const SIZES: [[f32; 2]; 4] = [[1160.0, 640.0], [960.0, 1040.0], [683.0, 700.0], [1280.0, 800.0]];

/// Labels of everything that reaches out of the window to the side, or over something that must be free.
pub(crate) fn outside(bench: &Bench, size: Vec2) -> Vec<String> {
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
fn top_row_buttons_and_numbers_are_unobscured() {
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

/// Every text that is drawn, and where.
fn texts(bench: &Bench) -> Vec<(String, Rect)> {
    let shapes = bench.harness.output().shapes.iter();
    let text = |shape: &egui::Shape| match shape {
        egui::Shape::Text(text) => Some((text.galley.text().to_owned(), text.visual_bounding_rect())),
        _ => None,
    };
    shapes.filter_map(|clipped| text(&clipped.shape)).collect()
}

/// Pairs of texts that are drawn over each other.
fn overlapping(texts: &[(String, Rect)]) -> Vec<(&str, &str)> {
    let pairs =
        texts.iter().enumerate().flat_map(|(i, one)| texts[i + 1..].iter().map(move |two| (one, two)));
    let over = pairs.filter(|((_, one), (_, two))| one.shrink(0.5).intersects(two.shrink(0.5)));
    over.map(|((one, _), (two, _))| (one.as_str(), two.as_str())).collect()
}

/// Three frames of a robot whose taxels are pressed, T1 being 0, and whose loop woke late.
fn pressed(bench: &mut Bench, taxels: &[usize]) {
    for _ in 0..3 {
        let mut next = sample(bench.tick, Mode::Impedance, None);
        taxels.iter().for_each(|taxel| next.taxels[*taxel].force_n = 12.3);
        next.lateness_s = 0.019_493;
        bench.tick += 1;
        bench.daemon.borrow_mut().samples.push_back(next);
        bench.harness.step();
    }
}

#[test]
fn no_text_of_a_picture_or_a_table_is_written_over_another() {
    for size in SIZES.map(Vec2::from) {
        let mut bench = Bench::new();
        bench.harness.set_size(size);
        pressed(&mut bench, &[5]);
        let of_the_front: Vec<_> = texts(&bench)
            .into_iter()
            .filter(|(text, rect)| {
                rect.right() < 400.0 && ["T5", "T6", "T7", "12.3 N", "T6  12.3 N"].contains(&text.as_str())
            })
            .collect();
        assert!(of_the_front.len() >= 3, "{of_the_front:?}");
        assert!(overlapping(&of_the_front).is_empty(), "{size}: {of_the_front:?}");

        bench.click("3-D");
        pressed(&mut bench, &[4, 5, 6]);
        let forces: Vec<_> = texts(&bench)
            .into_iter()
            .filter(|(text, rect)| text.ends_with(" 12.3 N") && rect.left() > 400.0)
            .collect();
        assert_eq!(forces.len(), 3);
        assert!(overlapping(&forces).is_empty(), "{size}: {forces:?}");

        bench.click("Loop");
        pressed(&mut bench, &[]);
        let late: Vec<_> =
            texts(&bench).into_iter().filter(|(text, _)| text.parse::<f64>().is_ok()).collect();
        assert!(late.iter().filter(|(text, _)| text == "19493").count() >= 1, "{late:?}");
        assert!(overlapping(&late).is_empty(), "{size}: {:?}", overlapping(&late));
    }
}

/// Every button, check box and tab of the window, in order, with its name.
pub(crate) fn buttons(bench: &Bench) -> Vec<(String, Rect)> {
    let roles = [Role::Button, Role::CheckBox, Role::RadioButton, Role::Slider];
    let nodes = bench.harness.query_all_by(|node| roles.contains(&node.role()) && node.label().is_some());
    nodes.map(|node| (node.accesskit_node().label().unwrap_or_default(), node.rect())).collect()
}

#[test]
fn words_of_health_are_not_written_over_each_other() {
    for size in [SIZES[0], SIZES[2]].map(Vec2::from) {
        for status in [TaxelStatus::Stale, TaxelStatus::NoZero] {
            let mut bench = Bench::new();
            bench.harness.set_size(size);
            bench.frames(Mode::Ready, None);
            for _ in 0..3 {
                let mut next = sample(bench.tick, Mode::Ready, None);
                next.taxels.iter_mut().for_each(|taxel| taxel.status = status);
                bench.tick += 1;
                bench.daemon.borrow_mut().samples.push_back(next);
                bench.harness.step();
            }
            let of_taxels = |(text, rect): &(String, Rect)| {
                rect.right() < 560.0
                    && (text.contains(status.name()) || text.starts_with('T') && text.len() <= 3)
            };
            let shown: Vec<_> = texts(&bench).into_iter().filter(of_taxels).collect();
            assert!(shown.len() >= 11, "{shown:?}");
            assert!(overlapping(&shown).is_empty(), "{size}, {status:?}: {:?}", overlapping(&shown));
        }
    }
}

/// Regression test: a reason of two lines moved every button by 17 points, and a click on one hit another.
#[test]
fn no_button_moves_when_a_text_changes() {
    let faults = [
        BoardFault::HostStarved.of(0),
        BoardFault::Chip.of(0),
        Fault::ArmRefused,
        Fault::StateInvalid,
        Fault::TaxelInvalid { taxel: 9, status: TaxelStatus::Masked },
    ];
    for size in SIZES.map(Vec2::from) {
        let mut bench = Bench::new();
        bench.harness.set_size(size);
        bench.frames(Mode::Ready, None);
        bench.frames(Mode::Ready, None);
        let before = buttons(&bench);
        assert!(before.len() > 20, "{before:?}");
        let compare = |bench: &Bench, what: &str| {
            let now = buttons(bench);
            for ((name, rect), (other, moved)) in before.iter().zip(&now) {
                // What is written on one may change, where it is may not.
                let off = (rect.min - moved.min).abs().max_elem();
                assert!(off < 0.5, "{name} is {other} at {size}, {what}: {rect:?} is {moved:?}");
            }
            assert_eq!(before.len(), now.len(), "at {size}, {what}");
        };
        for fault in faults {
            bench.frames(Mode::ProtectiveStop, Some(fault));
            compare(&bench, fault.code());
        }
        bench.frames(Mode::FollowMe, None);
        compare(&bench, "armed");
        bench.daemon.borrow_mut().commander = Commander::Another;
        bench.frames(Mode::Impedance, None);
        compare(&bench, "another commander");
        bench.harness.run_steps(4);
        compare(&bench, "silent");
        bench.daemon.borrow_mut().down =
            Some("the daemon closed the connection, and a long reason follows ".repeat(3));
        bench.harness.step();
        compare(&bench, "down");
    }
}

#[test]
fn text_without_room_is_cut_off_and_whole_in_its_label() {
    let mut bench = Bench::new();
    bench.harness.set_size(Vec2::new(683.0, 700.0));
    bench.daemon.borrow_mut().down = Some("word ".repeat(200));
    bench.harness.step();
    assert!(bench.shows("trying again"), "the end of the text is there for a screen reader");
    let reason = bench.harness.get_by_label_contains("trying again").rect();
    assert!(reason.height() <= 46.0, "{reason:?}");
}

#[test]
fn everything_larger_still_fits_into_the_window() {
    // A window of 1160 by 640 points with everything 1.3 times as large.
    let size = Vec2::new(1160.0, 640.0) / 1.3;
    let mut bench = Bench::new();
    bench.harness.set_size(size);
    bench.frames(Mode::Impedance, None);
    bench.frames(Mode::Impedance, None);
    let outside = outside(&bench, size);
    assert!(outside.is_empty(), "{outside:#?}");
    let ctx = bench.harness.ctx.clone();
    for (wanted, zoom) in [(1.3, 1.3), (f32::NAN, 0.7), (100.0, 2.5)] {
        bench.harness.state_mut().zoom(&ctx, wanted);
        bench.frames(Mode::Impedance, None);
        assert!((ctx.zoom_factor() - zoom).abs() < 1e-6, "{wanted}");
    }
}

/// Texts of which the window shows a part only.
fn clipped(bench: &Bench) -> Vec<String> {
    let shapes = bench.harness.output().shapes.iter();
    let cut = shapes.filter_map(|clipped| match &clipped.shape {
        egui::Shape::Text(text) => {
            let rect = text.visual_bounding_rect();
            let seen = clipped.clip_rect.expand(1.0).contains_rect(rect) || !rect.is_positive();
            (!seen).then(|| format!("{:?} {rect:?} in {:?}", text.galley.text(), clipped.clip_rect))
        }
        _ => None,
    });
    cut.collect()
}

/// Regression test: a flange in front of a pressed taxel pushed its number out of the picture.
#[test]
fn numbers_of_a_pressed_taxel_stay_in_the_picture() {
    for size in SIZES.map(Vec2::from) {
        let mut bench = Bench::new();
        bench.harness.set_size(size);
        for flange_m in [0.3, 0.5, 0.7, 0.9, 1.1] {
            for _ in 0..3 {
                let mut next = sample(bench.tick, Mode::Impedance, None);
                next.taxels.iter_mut().for_each(|taxel| taxel.force_n = 12.3);
                let [x, y, _] = next.base_pose_world;
                next.flange_position_world = [x + flange_m, y, 1.0];
                bench.tick += 1;
                bench.daemon.borrow_mut().samples.push_back(next);
                bench.harness.step();
            }
            let cut: Vec<_> = clipped(&bench)
                .into_iter()
                .filter(|text| text.contains("12.3 N") || text.starts_with("\"T"))
                .collect();
            assert!(cut.is_empty(), "{size}, flange at {flange_m} m: {cut:?}");
        }
    }
}

#[test]
fn calibrate_page_uses_the_room_of_a_large_window() {
    let size = Vec2::new(1920.0, 1080.0);
    let mut bench = Bench::new();
    bench.harness.set_size(size);
    bench.frames(Mode::Ready, None);
    bench.click("Calibrate");
    let model = |name: &str| FittedModel {
        name: name.into(),
        usable: true,
        rmse_n: 1.23,
        worst_n: 4.0,
        force_max_n: 80.0,
        residuals: vec![[10.0, 0.5], [70.0, -1.0]],
        ..FittedModel::default()
    };
    let models = ["line-with-intercept", "line-through-zero", "monotone", "compensated"].map(model).to_vec();
    bench.daemon.borrow_mut().calibration =
        CalibrationProgress::Fitted(CalibrationFit { taxel: 0, rest_counts: 719.6, models });
    bench.frames(Mode::Ready, None);
    bench.frames(Mode::Ready, None);
    assert_eq!(outside(&bench, size), Vec::<String>::new());
    assert_eq!(clipped(&bench), Vec::<String>::new());
    // The steps have 640 points, the residuals stand next to them and fill the rest down to the window's end.
    let first = bench.harness.get_by_label_contains("Choose a taxel, or all").rect();
    let all = texts(&bench);
    let place = |text: &str| all.iter().find(|(shown, _)| shown == text).unwrap().1;
    let (force, residual) = (place("reference force N"), place("model − reference N"));
    let steps_end = first.left() + 640.0;
    assert!((steps_end..steps_end + 40.0).contains(&residual.left()), "{residual:?} after {steps_end}");
    let middle = 0.5 * (steps_end + size.x);
    assert!((force.center().x - middle).abs() < 60.0, "{force:?} under the middle {middle}");
    assert!(force.bottom() > size.y - 60.0, "{force:?}");
    assert!(place("RMSE N").right() < steps_end && place("valid to N").right() < steps_end);
}
