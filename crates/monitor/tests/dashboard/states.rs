//! Display of a robot that is whole, in parts, faulty, silent or away.

use crate::bench::{Bench, parameter, sample};
use egui_kittest::kittest::Queryable;
use moca_msgs::{
    ArmLink, ArmMode, BoardFault, ContactRow, Fault, Link, Mode, ParameterValues, Refusal, Request, Sample,
    TaxelStatus,
    board::{Diagnosis, OpenFailure},
};
use moca_telemetry::{
    ParameterForm, ParameterValue,
    net::{Commander, Reply},
};

#[test]
fn an_arm_without_a_cover_shows_nothing_of_one() {
    let of_a_cover = ["Press and hold a taxel to push with", "Frame age", "Cover speed", "Speed limit"];
    for no_cover in [false, true] {
        let mut bench = Bench::new();
        bench.daemon.borrow_mut().no_cover = no_cover;
        bench.frames(Mode::Impedance, None);
        for text in of_a_cover {
            assert_eq!(bench.shows(text), !no_cover, "{text}");
        }
        assert!(bench.shows("Loop lateness"));
    }
}

#[test]
fn it_works_without_a_daemon_and_when_one_comes_and_goes() {
    let mut bench = Bench::new();
    bench.daemon.borrow_mut().down = Some("nobody listens".into());
    bench.harness.step();
    assert!(bench.shows("no daemon") && bench.shows("nobody listens") && bench.shows("cargo run --release"));

    bench.daemon.borrow_mut().down = None;
    bench.frames(Mode::Impedance, None);
    assert!(bench.shows("impedance") && bench.shows("test robot") && !bench.shows("no daemon"));

    bench.daemon.borrow_mut().down = Some("the daemon closed the connection".into());
    bench.harness.step();
    assert!(bench.shows("no daemon"));
    assert!(bench.harness.get_by_label("Push T6").rect().area() > 0.0, "the last picture stays");

    bench.daemon.borrow_mut().down = None;
    bench.daemon.borrow_mut().session += 1;
    bench.tick = 0;
    bench.frames(Mode::Ready, None);
    assert!(bench.shows("ready"));
    assert_eq!(bench.harness.state().model().history.len(), 3, "a new daemon starts a new history");
}

#[test]
fn bare_side_displacement_stands_next_to_its_limit() {
    let mut bench = Bench::new();
    bench.frames(Mode::Impedance, None);
    assert!(!bench.shows("Uncovered way"), "a daemon that says no limit has none");
    let most = parameter("protection.uncovered_m", ParameterForm::Number, &[0.1], false);
    bench.daemon.borrow_mut().parameters = vec![most];
    bench.frames(Mode::Impedance, None);
    assert!(bench.shows("Uncovered way 0.00 m of 0.10"));
}

#[test]
fn cover_page_shows_barrier_of_touched_taxel() {
    let mut bench = Bench::in_mode(Mode::Impedance);
    bench.click("Cover");
    assert!(!bench.shows("Contact barrier"), "nobody touches it");
    let row = ContactRow {
        taxel: 5,
        depth_m: 0.004_21,
        person_m_s: 0.117,
        allowed_m_s: -0.141,
        outward_m_s: -0.082,
        excess_m_s: 0.059,
    };
    let mut touched = sample(bench.tick, Mode::Impedance, None);
    touched.contact_rows.push(row).unwrap();
    bench.daemon.borrow_mut().samples.push_back(touched);
    bench.harness.step();
    for text in
        ["Contact barrier", "Allowed m/s", "Too fast m/s", "4.2", "0.117", "−0.141", "−0.082", "0.059"]
    {
        assert!(bench.shows(text), "{text}");
    }
    bench.tick += 1;
    bench.frames(Mode::Impedance, None);
    assert!(!bench.shows("Contact barrier"), "it let go");
}

#[test]
fn a_gain_that_is_refused_is_shown_with_what_the_robot_bears() {
    let mut bench = Bench::new();
    let damping = parameter("control.gains.damping_ratio", ParameterForm::Number, &[0.9], true);
    bench.daemon.borrow_mut().parameters = vec![damping];
    bench.frames(Mode::Impedance, None);
    let [values, nearest] = [5.0, 2.125].map(|value| ParameterValues::new(&[value]).unwrap());
    let request = Request::SetParameter { parameter: 0, values };
    bench.daemon.borrow_mut().replies.push(Reply { request, outcome: Err(Refusal::Unstable { nearest }) });
    bench.frames(Mode::Impedance, None);
    assert!(bench.shows("not stable with this robot at this rate and posture; on the way there 2.125"));
}

#[test]
fn samples_that_stop_coming_are_shown_as_old() {
    let mut bench = Bench::in_mode(Mode::Impedance);
    bench.harness.run_steps(4);
    assert!(bench.shows("no samples") && bench.shows("what is shown is old"));
    bench.click("STOP (space)");
    assert_eq!(bench.asked(), [Request::Stop], "stop works all the same");
}

#[test]
fn fault_shows_remedy_and_names_taxel() {
    let mut bench = Bench::new();
    bench.frames(Mode::ProtectiveStop, Some(BoardFault::Lost.of(0)));
    assert!(bench.shows(BoardFault::Lost.of(0).text()) && bench.shows(BoardFault::Lost.of(0).remedy()));
}

#[test]
fn a_refusal_and_another_commander_are_told() {
    let mut bench = Bench::in_mode(Mode::Ready);
    let refused = Reply { request: Request::Arm, outcome: Err(Refusal::ZeroInvalid) };
    bench.daemon.borrow_mut().replies.push(refused);
    bench.frames(Mode::Ready, None);
    assert!(bench.shows("Arm: refused, the cover or the flange sensor has no valid zero"));

    bench.daemon.borrow_mut().commander = Commander::Another;
    bench.frames(Mode::Ready, None);
    assert!(bench.shows("another dashboard has the command"));
    bench.click("Arm");
    assert_eq!(bench.asked(), []);
    bench.click("STOP (space)");
    assert_eq!(bench.asked(), [Request::Stop], "anyone may stop");
}

fn text(name: &str, value: &str) -> moca_telemetry::ParameterDescription {
    let value = ParameterValue::Text(value.into());
    moca_telemetry::ParameterDescription { value, ..parameter(name, ParameterForm::Text, &[], false) }
}

#[test]
fn a_cover_alone_shows_no_arm_no_flange_and_nothing_to_arm() {
    let of_a_robot = ["Flange force", "Base pose", "Base speed", "Franka", "flange force"];
    let mut bench = Bench::in_mode(Mode::Ready);
    assert!(of_a_robot.iter().all(|text| bench.shows(text)));
    bench.daemon.borrow_mut().parameters = vec![text("plant.kind", "none")];
    bench.daemon.borrow_mut().session += 1;
    bench.frames(Mode::Ready, None);
    for text in of_a_robot {
        assert!(!bench.shows(text), "{text}");
    }
    for button in ["Arm", "Disarm", "Resume", "Follow-me"] {
        assert!(bench.harness.query_by_label(button).is_none(), "{button}");
    }
    assert!(bench.shows("cover alone") && bench.shows("Frame age"));
    assert!(bench.harness.query_by_label("Plot Taxel forces in N").is_some());
    assert!(bench.harness.query_by_label("Plot Base force in N").is_none());
    bench.click("Tare");
    assert_eq!(bench.asked(), [Request::Tare]);
}

#[test]
fn what_was_masked_is_called_masked_with_its_number() {
    let mut bench = Bench::in_mode(Mode::Ready);
    assert!(!bench.shows("masked"));
    bench.masked = Some(3);
    bench.frames(Mode::Ready, None);
    assert!(bench.shows("masked: T4"));
    let fault = Fault::TaxelInvalid { taxel: 3, status: TaxelStatus::Masked };
    bench.frames(Mode::ProtectiveStop, Some(fault));
    assert!(bench.shows("T4 is masked") && !bench.shows("unusable"));
    let fault = Fault::TaxelInvalid { taxel: 10, status: TaxelStatus::Dead };
    bench.frames(Mode::ProtectiveStop, Some(fault));
    assert!(bench.shows("T11 is dead"));
}

#[test]
fn a_port_that_does_not_exist_is_named() {
    let mut bench = Bench::in_mode(Mode::Ready);
    bench.daemon.borrow_mut().parameters = vec![text("board.port", "/dev/ttyACM7")];
    bench.board = Diagnosis::NotOpen(OpenFailure::NotFound);
    bench.frames(Mode::Starting, None);
    assert!(bench.shows("port /dev/ttyACM7 does not exist"));
    bench.daemon.borrow_mut().parameters = vec![text("board.port", "auto")];
    bench.frames(Mode::Starting, None);
    assert!(bench.shows("No Touch Board found"));
}

#[test]
fn answer_stays_until_dismissed_or_read() {
    let mut bench = Bench::in_mode(Mode::Ready);
    let refusal = Refusal::CauseRemains(Fault::TaxelInvalid { taxel: 4, status: TaxelStatus::Noisy });
    let reply = Reply { request: Request::Resume, outcome: Err(refusal) };
    bench.daemon.borrow_mut().replies.push(reply);
    bench.frames(Mode::Ready, None);
    let text = "Resume: refused, the cause remains. T5 is noisy. Check the taxel's plate and wire; then tare and resume.";
    let shown = bench.harness.get_by_label(text).rect();
    assert!(shown.height() > 30.0, "it has the lines that it needs: {shown:?}");
    bench.click("×");
    assert!(!bench.shows("Resume: refused"));
    bench.daemon.borrow_mut().replies.push(Reply { request: Request::Arm, outcome: Ok(()) });
    bench.frames(Mode::Ready, None);
    assert!(bench.shows("Arm: done"));
    (0..20).for_each(|_| bench.frames(Mode::Ready, None));
    assert!(!bench.shows("Arm: done"));
}

#[test]
fn arrows_have_a_legend() {
    let mut bench = Bench::in_mode(Mode::Impedance);
    for text in ["base force", "base moment", "flange force", "flange", "desired"] {
        assert!(bench.harness.query_by_label(text).is_some(), "{text}");
    }
    bench.daemon.borrow_mut().no_cover = true;
    bench.frames(Mode::Impedance, None);
}

#[test]
fn robot_view_in_3d_turns_with_mouse() {
    let mut bench = Bench::in_mode(Mode::Impedance);
    bench.click("3-D");
    let drawn = |bench: &Bench| -> Vec<egui::Pos2> {
        let shapes = bench.harness.output().shapes.iter();
        let corners = shapes.filter_map(|clipped| match &clipped.shape {
            egui::Shape::Mesh(mesh) if mesh.vertices.len() == 4 => {
                Some(mesh.vertices.iter().map(|vertex| vertex.pos).collect::<Vec<_>>())
            }
            _ => None,
        });
        corners.flatten().collect()
    };
    let middle = bench.harness.get_by_label("The robot in 3-D").rect();
    let before = drawn(&bench);
    assert!(before.iter().filter(|p| middle.contains(**p)).count() >= 4 * 20, "base and plates are drawn");
    bench.pointer(middle.center(), true);
    bench.harness.hover_at(middle.center() + egui::vec2(80.0, 30.0));
    bench.frames(Mode::Impedance, None);
    bench.pointer(middle.center() + egui::vec2(80.0, 30.0), false);
    bench.frames(Mode::Impedance, None);
    assert_ne!(drawn(&bench), before, "it was turned");
    bench.click("Top");
    let above = drawn(&bench);
    bench.click("Corner");
    assert_eq!(drawn(&bench), before, "and back");
    assert_ne!(above, before);
}

/// The view in 3-D looks as old as its data, like every other view.
#[test]
fn veil_over_old_data_covers_the_view_in_3d() {
    let mut bench = Bench::in_mode(Mode::Impedance);
    bench.click("3-D");
    // Filled rectangles that let light through and cover the whole view, and are drawn after every body of it.
    let veils = |bench: &Bench| {
        let view = bench.harness.get_by_label("The robot in 3-D").rect();
        let shapes = &bench.harness.output().shapes;
        let body = |shape: &egui::Shape| match shape {
            egui::Shape::Mesh(mesh) => mesh.vertices.iter().any(|vertex| view.contains(vertex.pos)),
            _ => false,
        };
        let last = shapes.iter().rposition(|clipped| body(&clipped.shape)).unwrap();
        let veil = |clipped: &&egui::epaint::ClippedShape| match &clipped.shape {
            egui::Shape::Rect(rect) => {
                rect.rect.expand(1.0).contains_rect(view)
                    && clipped.clip_rect.expand(1.0).contains_rect(view)
                    && (100..255).contains(&rect.fill.a())
            }
            _ => false,
        };
        shapes[last..].iter().filter(veil).count()
    };
    assert_eq!(veils(&bench), 0, "fresh data");
    bench.harness.run_steps(4);
    assert!(bench.shows("what is shown is old"));
    assert_eq!(veils(&bench), 1, "old data");
    bench.frames(Mode::Impedance, None);
    assert_eq!(veils(&bench), 0, "it goes on");
}

#[test]
fn ages_of_arm_and_base_stand_next_to_deadlines() {
    let mut bench = Bench::new();
    let deadline =
        |part: &str, s| parameter(&format!("plant.{part}.deadline_s"), ParameterForm::Number, &[s], false);
    bench.daemon.borrow_mut().parameters = vec![deadline("arm", 0.01), deadline("base", 0.1)];
    bench.frames(Mode::Impedance, None);
    assert!(!bench.shows("state age"), "a simulated robot is not far away");
    let of = |mode| Link { arm_age_s: 0.002, base_age_s: 0.034, arm: ArmLink { mode, ..ArmLink::default() } };
    for (mode, has_arm) in [(ArmMode::Torque, true), (ArmMode::NotThere, false)] {
        let linked = Sample { link: Some(of(mode)), ..sample(bench.tick, Mode::Impedance, None) };
        bench.daemon.borrow_mut().samples.push_back(linked);
        bench.tick += 1;
        bench.harness.step();
        bench.harness.step();
        assert!(bench.shows("Base state age 34 ms of 100"), "{mode:?}");
        assert_eq!(bench.shows("Arm state age 2 ms of 10"), has_arm);
        assert_eq!(bench.shows("Arm torque control, success rate"), has_arm);
        assert_eq!(bench.shows("success rate"), has_arm);
    }
}

#[test]
fn an_armed_robot_says_so_with_its_law() {
    for (mode, law) in [(Mode::Impedance, "impedance"), (Mode::FollowMe, "follow-me")] {
        let bench = Bench::in_mode(mode);
        assert!(
            bench.harness.query_by_label("ARMED").is_some() && bench.harness.query_by_label(law).is_some()
        );
    }
    let bench = Bench::in_mode(Mode::Ready);
    assert!(bench.harness.query_by_label("ARMED").is_none());
}
