//! The gripper: shown where there is one, and asked with what its fields say.

use crate::bench::{Bench, sample};
use crate::layout::{SIZES, buttons, outside};
use crate::logs::Memory;
use egui::{Key, Shape, Vec2};
use egui_kittest::kittest::Queryable;
use moca_monitor::logic::source::playback::Playback;
use moca_msgs::gripper::GripperQuantity;
use moca_msgs::{
    GripperFault, GripperPhase, GripperRefusal, GripperRequest, GripperState, Mode, Request, Sample,
};
use moca_telemetry::{
    RobotDescription,
    net::{Commander, Reply},
};

const GRASP: GripperRequest =
    GripperRequest::Grasp { width_m: 0.05, speed_m_s: 0.05, force_n: 40.0, tolerance_m: 0.005, mass_kg: 0.0 };
const MOVE: GripperRequest = GripperRequest::Move { width_m: 0.05, speed_m_s: 0.05 };
const LABELS: [(&str, GripperRequest); 5] = [
    ("Home", GripperRequest::Home),
    ("Open", GripperRequest::Release),
    ("Stop fingers", GripperRequest::Stop),
    ("Move to width", MOVE),
    ("Grasp", GRASP),
];

/// An open gripper at rest.
fn open() -> GripperState {
    GripperState {
        width_m: 0.08,
        width_max_m: 0.08,
        object_flange_m: [0.0, 0.0, 0.1],
        ..GripperState::default()
    }
}

/// A window on the page of a gripper in this state.
fn page(gripper: GripperState) -> Bench {
    let mut bench = Bench::new();
    bench.gripper = Some(gripper);
    bench.frames(Mode::Impedance, None);
    bench.click("Gripper");
    bench
}

/// Types a number into a field.
fn enter(bench: &mut Bench, field: &str, text: &str) {
    bench.harness.get_by_label(field).focus();
    bench.frames(Mode::Impedance, None);
    bench.harness.get_by_label(field).type_text(text);
    bench.frames(Mode::Impedance, None);
    bench.harness.key_press(Key::Enter);
    bench.frames(Mode::Impedance, None);
}

#[test]
fn page_of_gripper_is_there_only_where_there_is_one() {
    let mut bench = Bench::in_mode(Mode::Ready);
    assert!(bench.harness.query_by_label("Gripper").is_none());
    bench.gripper = Some(open());
    bench.frames(Mode::Ready, None);
    bench.click("Gripper");
    assert!(bench.shows("80.0 mm of 80.0") && bench.shows("none held") && bench.shows("resting"));
    // The next window begins with the same page, in front of a robot without a gripper.
    let mut memory = Memory::default();
    eframe::App::save(bench.harness.state_mut(), &mut memory);
    let mut bench = Bench::in_mode(Mode::Ready);
    let ctx = bench.harness.ctx.clone();
    bench.harness.state_mut().restore(&ctx, &memory);
    bench.frames(Mode::Ready, None);
    assert!(bench.shows("This robot has no gripper: set plant.gripper"));
    assert!(LABELS.iter().all(|(label, _)| bench.harness.query_by_label(label).is_none()));
    bench.click("Plots");
    assert!(bench.harness.query_by_label("Gripper").is_none());
}

#[test]
fn each_button_of_the_gripper_asks_in_every_mode() {
    for (label, request) in LABELS {
        for mode in [Mode::Starting, Mode::Ready, Mode::FollowMe, Mode::ProtectiveStop, Mode::Fault] {
            let mut bench = page(open());
            bench.frames(mode, None);
            bench.click(label);
            assert_eq!(bench.asked(), [Request::Gripper(request)], "{label} in {}", mode.name());
        }
    }
}

#[test]
fn typed_numbers_are_asked_for_and_bad_ones_are_not() {
    let mut bench = page(open());
    let fields = [("width", "62"), ("speed", "30"), ("force", "25"), ("tolerance", "3"), ("mass", "0.5")];
    for (field, text) in fields {
        enter(&mut bench, &format!("Gripper {field}"), text);
    }
    bench.click("Grasp");
    let (width_m, speed_m_s, force_n, tolerance_m, mass_kg) = (0.062, 0.03, 25.0, 0.003, 0.5);
    let grasp = GripperRequest::Grasp { width_m, speed_m_s, force_n, tolerance_m, mass_kg };
    assert_eq!(bench.asked(), [Request::Gripper(grasp)]);
    for (field, bad, good, range) in [
        ("width", "80.1", "62", "0 to 80 mm"),
        ("speed", "0.9", "30", "1 to 100 mm/s"),
        ("force", "71", "25", "1 to 70 N"),
        ("tolerance", "0", "3", "0.1 to 80 mm"),
        ("mass", "2.28", "0.5", "0 to 2.27 kg"),
    ] {
        let said = format!("Gripper {field}");
        let colour = |bench: &Bench| {
            let shapes = bench.harness.output().shapes.iter();
            let texts = shapes.filter_map(|clipped| match &clipped.shape {
                Shape::Text(text) if text.galley.text() == range => {
                    Some(text.galley.job.sections[0].format.color)
                }
                _ => None,
            });
            texts.collect::<Vec<_>>()
        };
        let before = colour(&bench);
        enter(&mut bench, &said, bad);
        assert_ne!(colour(&bench), before, "{range} is red");
        bench.click("Grasp");
        assert_eq!(bench.asked(), [], "{field} {bad}");
        bench.click("Move to width");
        let of_a_motion = ["width", "speed"].contains(&field);
        assert_eq!(bench.asked().is_empty(), of_a_motion, "{field} {bad}");
        enter(&mut bench, &said, good);
        bench.click("Grasp");
        assert_eq!(bench.asked(), [Request::Gripper(grasp)]);
    }
}

#[test]
fn own_gripper_opens_as_far_as_it_tells() {
    let mut bench = page(GripperState { width_max_m: 0.11, ..open() });
    assert!(bench.shows("0 to 110 mm"));
    enter(&mut bench, "Gripper width", "105");
    bench.click("Move to width");
    let request = GripperRequest::Move { width_m: 0.105, speed_m_s: 0.05 };
    assert_eq!(bench.asked(), [Request::Gripper(request)]);
}

#[test]
fn held_object_and_fault_are_told_on_every_page() {
    let held = GripperState { width_m: 0.05, phase: GripperPhase::Holding, object_kg: 0.5, ..open() };
    let mut bench = page(held);
    assert!(bench.shows("50.0 mm of 80.0") && bench.shows("held, 0.50 kg carried"));
    bench.click("Plots");
    assert!(bench.shows("object held, 0.50 kg carried"));
    let fault = GripperFault::Lost;
    bench.gripper = Some(GripperState { fault: Some(fault), ..open() });
    bench.frames(Mode::Impedance, None);
    assert!(!bench.shows("object held") && bench.shows(fault.text()) && bench.shows(fault.remedy()));
    bench.click("Gripper");
    assert_eq!(bench.harness.query_all_by_label_contains(fault.remedy()).count(), 2, "above and on its page");
}

#[test]
fn old_state_of_gripper_is_called_old_and_only_a_stop_is_asked() {
    let mut bench = page(open());
    assert!(!bench.shows("as last known"));
    bench.harness.run_steps(4);
    assert!(bench.shows("Gripper, as last known"));
    for (label, request) in LABELS {
        bench.harness.get_by_label(label).click();
        bench.harness.run_steps(2);
        let asked = bench.asked();
        assert_eq!(
            asked == [Request::Gripper(request)],
            request == GripperRequest::Stop,
            "{label}: {asked:?}"
        );
    }
}

#[test]
fn fingers_are_asked_by_the_commander_alone_and_never_of_a_log() {
    let mut bench = page(open());
    bench.daemon.borrow_mut().commander = Commander::Another;
    bench.frames(Mode::Impedance, None);
    for (label, _) in LABELS {
        bench.click(label);
    }
    assert_eq!(bench.asked(), []);
    let samples = (0..100).map(|tick| Sample { gripper: Some(open()), ..sample(tick, Mode::Ready, None) });
    let log = Playback::of(RobotDescription::paper("logged robot", true), samples.collect());
    bench.harness.state_mut().add(log, "run.mcap".into());
    bench.frames(Mode::Impedance, None);
    bench.harness.get_by_label("log of logged robot").click();
    bench.frames(Mode::Impedance, None);
    bench.frames(Mode::Impedance, None);
    assert!(bench.shows("80.0 mm of 80.0"));
    assert!(LABELS.iter().all(|(label, _)| bench.harness.query_by_label(label).is_none()));
}

#[test]
fn answer_of_gripper_says_begun_or_why_not() {
    let mut bench = page(open());
    let outcome = Err(GripperRefusal::OutOfRange {
        quantity: GripperQuantity::Force,
        value: 120.0,
        allowed: [1.0, 70.0],
    }
    .into());
    for (request, outcome, said) in [
        (GRASP, outcome, "Gripper grasp: refused, force of the gripper = 120 N; allowed: 1 to 70 N"),
        (GRASP, Ok(()), "Gripper grasp: begun"),
        (GripperRequest::Stop, Ok(()), "Gripper stop: done"),
    ] {
        bench.daemon.borrow_mut().replies.push(Reply { request: Request::Gripper(request), outcome });
        bench.frames(Mode::Impedance, None);
        assert!(bench.shows(said), "{said}");
    }
}

#[test]
fn page_of_gripper_fits_and_stands_still_in_every_window() {
    for size in SIZES.map(Vec2::from) {
        let mut bench = page(open());
        bench.harness.set_size(size);
        bench.frames(Mode::Impedance, None);
        bench.frames(Mode::Impedance, None);
        let before = buttons(&bench);
        for fault in GripperFault::ALL {
            bench.gripper = Some(GripperState { fault: Some(fault), ..open() });
            bench.frames(Mode::Impedance, None);
            assert_eq!(outside(&bench, size), Vec::<String>::new(), "{} at {size}", fault.code());
            for ((name, place), (_, moved)) in before.iter().zip(buttons(&bench)) {
                assert!((place.min - moved.min).abs().max_elem() < 0.5, "{name} at {size}, {}", fault.code());
            }
        }
        assert_eq!(before.len(), buttons(&bench).len());
        bench.harness.key_press(Key::Space);
        bench.frames(Mode::Impedance, None);
        assert_eq!(bench.asked(), [Request::Stop]);
    }
}

#[test]
fn fingers_in_3d_are_as_far_apart_as_the_gripper_says() {
    let lines = |gripper: Option<GripperState>| {
        let mut bench = Bench::new();
        bench.gripper = gripper;
        for _ in 0..3 {
            let flange_quaternion_world = [1.0, 0.0, 0.0, 0.0];
            let sample = sample(bench.tick, Mode::Impedance, None);
            let sample = Sample { gripper, flange_quaternion_world, ..sample };
            bench.daemon.borrow_mut().samples.push_back(sample);
            bench.harness.step();
        }
        bench.harness.get_by_label("3-D").click();
        bench.harness.run_steps(2);
        let shapes = bench.harness.output().shapes.iter();
        let lines = shapes.filter_map(|clipped| match clipped.shape {
            Shape::LineSegment { points, stroke } if (stroke.width - 5.0).abs() < 0.1 => Some(points),
            _ => None,
        });
        lines.collect::<Vec<_>>()
    };
    let none = lines(None).len();
    let apart = |width_m| {
        let drawn = lines(Some(GripperState { width_m, ..open() }));
        assert_eq!(drawn.len(), none + 2, "two fingers");
        drawn[none].iter().zip(drawn[none + 1]).map(|(one, other)| one.distance(other)).sum::<f32>()
    };
    let (closed, half, wide) = (apart(0.0), apart(0.04), apart(0.08));
    assert!(closed < 1.0 && half > closed + 1.0 && wide > half + 1.0, "{closed} {half} {wide}");
}
