//! Requests to the daemon: by which control, and when.

use crate::bench::{Bench, Daemon, Fake, moving_log, sample};
use crate::logs::Memory;
use egui::{Key, Vec2};
use egui_kittest::kittest::Queryable;
use moca_msgs::{Law, Mode, Request};
use std::{cell::RefCell, rc::Rc};

#[test]
fn each_button_sends_its_command_when_it_makes_sense() {
    let cases = [
        ("Tare", Mode::Ready, Request::Tare),
        ("Tare", Mode::ProtectiveStop, Request::Tare),
        ("Arm", Mode::Ready, Request::Arm),
        ("Disarm", Mode::Impedance, Request::Disarm),
        ("Resume", Mode::ProtectiveStop, Request::Resume),
        ("Follow-me", Mode::Ready, Request::SelectLaw(Law::FollowMe)),
        ("Impedance", Mode::FollowMe, Request::SelectLaw(Law::Impedance)),
        ("STOP (space)", Mode::Impedance, Request::Stop),
        ("STOP (space)", Mode::Starting, Request::Stop),
    ];
    for (label, mode, request) in cases {
        let mut bench = Bench::in_mode(mode);
        bench.click(label);
        assert_eq!(bench.asked(), [request], "{label} in {}", mode.name());
    }
}

#[test]
fn a_button_that_makes_no_sense_does_nothing() {
    for (label, mode) in [
        ("Arm", Mode::Impedance),
        ("Tare", Mode::Impedance),
        ("Disarm", Mode::Ready),
        ("Resume", Mode::Ready),
    ] {
        let mut bench = Bench::in_mode(mode);
        bench.click(label);
        assert_eq!(bench.asked(), [], "{label} in {}", mode.name());
    }
}

#[test]
fn the_space_bar_stops_from_everywhere_and_does_nothing_else() {
    for mode in [Mode::Starting, Mode::Taring, Mode::Ready, Mode::Impedance, Mode::FollowMe] {
        let mut bench = Bench::in_mode(mode);
        bench.harness.key_press(Key::Space);
        bench.frames(mode, None);
        assert_eq!(bench.asked(), [Request::Stop], "in {}", mode.name());
    }
    // With the keyboard's focus on a button, space would press that button too.
    let mut bench = Bench::in_mode(Mode::Ready);
    bench.harness.get_by_label("Arm").focus();
    bench.frames(Mode::Ready, None);
    assert!(bench.harness.get_by_label("Arm").is_focused());
    bench.harness.key_press(Key::Space);
    bench.frames(Mode::Ready, None);
    assert_eq!(bench.asked(), [Request::Stop]);
    // Enter still presses it.
    bench.harness.key_press(Key::Enter);
    bench.frames(Mode::Ready, None);
    assert_eq!(bench.asked(), [Request::Arm]);
}

#[test]
fn space_bar_stops_on_every_page_and_while_typing() {
    for page in ["Plots", "Loop", "Parameters", "Cover", "Calibrate"] {
        let mut bench = Bench::in_mode(Mode::Impedance);
        bench.click("Pause plots");
        bench.click(page);
        bench.click("Open log");
        bench.harness.get_by_label("Path").focus();
        bench.frames(Mode::Impedance, None);
        bench.harness.key_press(Key::Space);
        bench.frames(Mode::Impedance, None);
        assert_eq!(bench.asked(), [Request::Stop], "on page {page}");
        assert!(bench.harness.query_by_label("STOP (space)").is_some(), "the button is there too");
    }
}

#[test]
fn stop_works_while_a_log_is_shown() {
    let mut bench = Bench::in_mode(Mode::FollowMe);
    bench.harness.state_mut().add(moving_log(), "run.mcap".into());
    bench.frames(Mode::FollowMe, None);
    bench.harness.get_by_label("log of logged robot").click();
    bench.frames(Mode::FollowMe, None);
    assert!(bench.shows("A recorded run of logged robot"), "the log is in front");
    assert!(bench.shows("test robot: follow-me"), "what the robot does is seen");
    bench.harness.get_by_label("STOP (space)").click();
    bench.frames(Mode::FollowMe, None);
    assert_eq!(bench.asked(), [Request::Stop]);
    bench.daemon.borrow_mut().down = Some("gone".into());
    bench.frames(Mode::FollowMe, None);
    bench.harness.get_by_label("STOP (space)").click();
    bench.frames(Mode::FollowMe, None);
    assert_eq!(bench.asked(), [], "there is nobody to stop");
}

#[test]
fn a_log_never_looks_like_a_robot_that_runs() {
    let mut bench = Bench::in_mode(Mode::Ready);
    assert!(bench.harness.query_by_label("ready").is_some(), "the banner of a robot is its mode");
    bench.harness.state_mut().add(moving_log(), "run.mcap".into());
    bench.frames(Mode::Ready, None);
    bench.harness.get_by_label("log of logged robot").click();
    bench.frames(Mode::Ready, None);
    assert!(bench.harness.query_by_label("recorded").is_some(), "the banner of a log");
    assert!(bench.harness.query_by_label("impedance").is_none());
    assert!(bench.shows("then in mode impedance"), "its mode is told beside it");
}

#[test]
fn only_a_picture_that_was_drawn_is_a_sign_of_life() {
    let mut bench = Bench::in_mode(Mode::Impedance);
    let signs = |bench: &Bench| std::mem::take(&mut bench.daemon.borrow_mut().signs_of_life);
    assert!(signs(&bench) > 0);
    // A window that takes in what comes and draws nothing: hidden, or hung in its driver.
    let ctx = bench.harness.ctx.clone();
    for _ in 0..10 {
        bench.harness.state_mut().update(&ctx);
    }
    assert_eq!(signs(&bench), 0);
    bench.harness.step();
    assert_eq!(signs(&bench), 1);
    // It draws often enough while nothing new comes, or the daemon would miss it.
    let delay = bench.harness.output().viewport_output[&egui::ViewportId::ROOT].repaint_delay;
    assert!(delay <= std::time::Duration::from_millis(500), "{delay:?}");
}

#[test]
fn several_robots_have_names_and_stop_stops_them_all() {
    let mut bench = Bench::in_mode(Mode::Impedance);
    let other = Rc::new(RefCell::new(Daemon { simulated: true, session: 1, ..Daemon::default() }));
    bench.harness.state_mut().add(Fake(Rc::clone(&other)), "127.0.0.1:7612".into());
    other.borrow_mut().samples.push_back(sample(0, Mode::Ready, None));
    bench.frames(Mode::Impedance, None);
    let count = bench.harness.query_all_by_label_contains("test robot: ").count();
    assert_eq!(count, 2, "one button for each robot");
    bench.harness.query_all_by_label_contains("test robot: ").nth(1).unwrap().click();
    let step = |bench: &mut Bench, tick| {
        other.borrow_mut().samples.push_back(sample(tick, Mode::Ready, None));
        bench.harness.step();
    };
    (1..3).for_each(|tick| step(&mut bench, tick));
    assert!(bench.harness.query_by_label("ready").is_some(), "the second robot is in front");
    // The next window, too, begins with the second one.
    let mut memory = Memory::default();
    eframe::App::save(bench.harness.state_mut(), &mut memory);
    bench.harness.query_all_by_label_contains("test robot: ").next().unwrap().click();
    bench.frames(Mode::Impedance, None);
    assert!(bench.harness.query_by_label("impedance").is_some(), "the first robot is in front");
    let ctx = bench.harness.ctx.clone();
    bench.harness.state_mut().restore(&ctx, &memory);
    (3..6).for_each(|tick| step(&mut bench, tick));
    assert!(bench.harness.query_by_label("ready").is_some(), "the second robot is in front again");
    bench.harness.get_by_label("Arm").click();
    (6..9).for_each(|tick| step(&mut bench, tick));
    assert_eq!(other.borrow_mut().asked, [Request::Arm]);
    assert_eq!(bench.asked(), [], "the first robot is not armed with it");
    other.borrow_mut().asked.clear();
    bench.harness.get_by_label("STOP (space)").click();
    bench.harness.step();
    bench.harness.step();
    assert_eq!((other.borrow().asked.clone(), bench.asked()), (vec![Request::Stop], vec![Request::Stop]));
}

#[test]
fn a_taxel_is_pushed_while_the_mouse_holds_it() {
    let mut bench = Bench::in_mode(Mode::Impedance);
    let at = bench.harness.get_by_label("Push T6").rect().center();
    bench.pointer(at, true);
    bench.frames(Mode::Impedance, None);
    bench.frames(Mode::Impedance, None);
    assert_eq!(
        bench.asked(),
        [Request::PressTaxel { taxel: 5, force_n: 20.0 }],
        "one request, however long it is held"
    );
    bench.pointer(at, false);
    bench.frames(Mode::Impedance, None);
    assert_eq!(bench.asked(), [Request::PressTaxel { taxel: 5, force_n: 0.0 }]);
}

#[test]
fn a_taxel_is_pushed_with_the_keyboard_too() {
    let mut bench = Bench::in_mode(Mode::Impedance);
    bench.harness.get_by_label("Push T3").focus();
    bench.frames(Mode::Impedance, None);
    bench.harness.key_down(Key::Enter);
    bench.frames(Mode::Impedance, None);
    assert_eq!(bench.asked(), [Request::PressTaxel { taxel: 2, force_n: 20.0 }]);
    bench.harness.key_up(Key::Enter);
    bench.frames(Mode::Impedance, None);
    assert_eq!(bench.asked(), [Request::PressTaxel { taxel: 2, force_n: 0.0 }]);
}

#[test]
fn a_push_ends_when_the_mouse_leaves_the_window() {
    let mut bench = Bench::in_mode(Mode::Impedance);
    let at = bench.harness.get_by_label("Push T1").rect().center();
    bench.pointer(at, true);
    bench.frames(Mode::Impedance, None);
    assert_eq!(bench.asked().len(), 1);
    bench.harness.remove_cursor();
    bench.pointer(at + Vec2::new(5000.0, 0.0), false);
    bench.frames(Mode::Impedance, None);
    assert_eq!(bench.asked(), [Request::PressTaxel { taxel: 0, force_n: 0.0 }]);
}

#[test]
fn a_real_robot_cannot_be_pushed_with_the_mouse() {
    let mut bench = Bench::new();
    bench.daemon.borrow_mut().simulated = false;
    bench.frames(Mode::Impedance, None);
    let at = bench.harness.get_by_label("Push T6").rect().center();
    bench.pointer(at, true);
    bench.frames(Mode::Impedance, None);
    assert_eq!(bench.asked(), []);
}

#[test]
fn mask_button_toggles_unless_robot_moves() {
    let mut bench = Bench::in_mode(Mode::Ready);
    bench.click("Cover");
    for taxel in 0..11 {
        bench.click(&format!("Mask T{}", taxel + 1));
        assert_eq!(bench.asked(), [Request::MaskTaxel { taxel, masked: true }]);
    }
    bench.masked = Some(3);
    bench.frames(Mode::Ready, None);
    bench.click("Use T4");
    assert_eq!(bench.asked(), [Request::MaskTaxel { taxel: 3, masked: false }]);
    bench.frames(Mode::Impedance, None);
    bench.click("Mask T1");
    assert_eq!(bench.asked(), [], "while a law moves the robot");
    assert!(bench.shows("Disarm to change masks"));
}

#[test]
fn the_jog_pad_leads_while_it_is_held_and_ends_when_let_go() {
    let jogs =
        |asked: &[Request]| asked.iter().filter(|request| matches!(request, Request::Target(_))).count();
    let mut bench = Bench::in_mode(Mode::Impedance);
    bench.click("3-D");
    let place = bench.harness.get_by_label("+y").rect().center();
    bench.pointer(place, true);
    (0..5).for_each(|_| bench.frames(Mode::Impedance, None));
    let asked = bench.asked();
    assert!(jogs(&asked) >= 2, "again and again: {asked:?}");
    let Some(Request::Target(first)) = asked.iter().find(|request| matches!(request, Request::Target(_)))
    else {
        panic!("no target")
    };
    let twist = [0.0, 0.05, 0.0, 0.0, 0.0, 0.0];
    assert_eq!(first.target, moca_msgs::Target::Twist { axes: moca_msgs::TwistAxes::World, twist });
    bench.pointer(place, false);
    bench.frames(Mode::Impedance, None);
    assert!(bench.asked().contains(&Request::EndTarget));
    bench.frames(Mode::Impedance, None);
    assert_eq!(bench.asked(), [], "and then nothing");

    // no law, no jog
    let mut bench = Bench::in_mode(Mode::Ready);
    bench.click("3-D");
    let place = bench.harness.get_by_label("+y").rect().center();
    bench.pointer(place, true);
    bench.frames(Mode::Ready, None);
    assert_eq!(jogs(&bench.asked()), 0);
}

#[test]
fn plate_in_3d_is_pressed_until_the_mouse_lets_go() {
    let mut bench = Bench::in_mode(Mode::Impedance);
    bench.click("3-D");
    bench.asked();
    let picture = bench.harness.get_by_label("The robot in 3-D").rect();
    let mut plates = std::collections::BTreeSet::new();
    for i in 0..196_u8 {
        let part = egui::vec2(f32::from(i % 14) + 0.5, f32::from(i / 14) + 0.5) / 14.0;
        let place = picture.min + part * picture.size();
        bench.pointer(place, true);
        bench.frames(Mode::Impedance, None);
        let pressed = bench.asked();
        bench.pointer(place, false);
        bench.frames(Mode::Impedance, None);
        let released = bench.asked();
        let Some(&Request::PressTaxel { taxel, force_n }) = pressed.first() else {
            assert!(pressed.is_empty() && released.is_empty(), "{pressed:?}");
            continue;
        };
        assert!(force_n > 0.0);
        assert_eq!(released, [Request::PressTaxel { taxel, force_n: 0.0 }]);
        plates.insert(taxel);
    }
    assert!(plates.len() >= 3, "seen from a corner: {plates:?}");
}
